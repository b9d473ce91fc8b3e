"""One object per row of a data frame of pandas, polars or pyarrow, and the same frame back."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from imgscale._optional import require
from imgscale._typing import BoolArray, DepthKind, FitMethod, ImageSize, IntArray, SizeAxis
from imgscale.batch._given import check_depths, check_extents, check_names
from imgscale.batch.arrow import codes_of
from imgscale.batch.columns import REASONS, BatchResult, fit_columns
from imgscale.noise import Noise
from imgscale.priors import PriorTable

__all__ = ["fit_table"]

FrameT = TypeVar("FrameT")

# Columns that the result adds: of the object's image, then of the object.
_OF_IMAGE = ("k", "k_std")
_OF_OBJECT = ("size_m", "std_m", "low_m", "high_m", "weight")
_ADDED = (*_OF_IMAGE, *_OF_OBJECT, "reason", "flags", "model_flags")


def fit_table(
    frame: FrameT,
    priors: PriorTable | None = None,
    *,
    kind: DepthKind,
    image_id: str = "image_id",
    label: str = "label",
    pixels: str = "pixels",
    depth: str = "depth",
    partial: str | None = None,
    axis: SizeAxis = "height",
    image_size: ImageSize | None = None,
    noise: Noise = Noise(),  # noqa: B008 - frozen
    method: FitMethod = "robust",
    level: float = 0.9,
) -> FrameT:
    """
    Fit and size the objects of many images, one object per row.

    Needs the extra `frames`, and the library whose frame it is.

    Parameters
    ----------
    frame : pandas.DataFrame, polars.DataFrame or pyarrow.Table
        A row per object, in any order. It is not changed.
    priors : PriorTable, optional
        Sizes by label; the shipped table, ``PriorTable.default()``, where omitted.
    kind : str
        What the depths are: "metric", "relative", "inverse" or "affine_inverse".
    image_id : str
        Column that tells the images apart, never null: integers, the fast way, strings or
        categories.
    label : str
        Column of labels, strings or categories; null is an object without a prior.
    pixels : str
        Column of extents along `axis`, in pixels, finite and positive, never null.
    depth : str
        Column of depths, finite and, unless the kind is "affine_inverse", positive; null or NaN
        where it is not known.
    partial : str, optional
        Column of truth values, True for objects that are cut or hidden; none is where omitted.
    axis : str
        "height", "width" or "diameter": along which the extents are.
    image_size : (width, height), optional
        Size of all images in pixels, as for `fit_columns`.
    noise : Noise
        Errors of boxes and depths.
    method : str
        As for `fit`.
    level : float
        Probability that an interval holds the size, above 0 and below 1.

    Returns
    -------
    frame
        Of the same type: the same rows and columns, of pandas with the same index, and, of the
        object's image, ``k``, ``k_std`` (NaN where no object can be a reference) and
        ``model_flags`` (bits of `Flag`); of the object, ``size_m``, ``std_m``, ``low_m`` and
        ``high_m`` (the ends of the interval), in metres, NaN where they cannot be said, ``weight``
        (its share in k), ``reason`` (why it was not used: "no prior", "partial", "no depth",
        "outlier", "one depth", which all references have where a shift is to be fitted; empty where
        it was) and ``flags``.

    Raises
    ------
    TypeError
        If an argument, or a column, is of the wrong type.
    ValueError
        If a value breaks its law, a column is missing, or there is one already that the result
        adds.
    MissingDependencyError
        Without narwhals.

    See Also
    --------
    fit_columns : The same on numpy columns.

    Examples
    --------
    >>> import pandas as pd
    >>> import imgscale as ims
    >>> from imgscale.batch import fit_table
    >>> objects = pd.DataFrame({
    ...     "image_id": ["a.jpg", "a.jpg", "b.jpg"],
    ...     "label": ["door", "statue", "statue"],
    ...     "pixels": [200.0, 150.0, 90.0],
    ...     "depth": [4.0, 4.0, 6.0],
    ... })
    >>> door = ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.02)])
    >>> sized = fit_table(objects, door, kind="relative")
    >>> sized[["image_id", "label", "size_m", "reason"]].round(2)
      image_id   label  size_m    reason
    0    a.jpg    door     2.0
    1    a.jpg  statue     1.5  no prior
    2    b.jpg  statue     NaN  no prior
    """
    nw: Any = require("narwhals", extra="frames", purpose="fit_table")
    given = _eager(nw, frame)
    asked = {
        "image_id": image_id,
        "label": label,
        "pixels": pixels,
        "depth": depth,
        "partial": partial,
    }
    check_names(asked, given.columns, _ADDED)
    values, depths = _numbers("pixels", given[pixels]), _numbers("depth", given[depth])
    check_extents(values, pixels, _place)
    whole = given[depth].dtype.is_integer()
    check_depths(depths, kind, depth, _place, as_integers=whole)
    codes, names = _labels(nw, given[label])
    found = fit_columns(
        _ids(nw, given[image_id]),
        codes,
        values,
        depths,
        priors,
        kind=kind,
        labels=names,
        axis=axis,
        image_size=image_size,
        partial=_truths(nw, given[partial]) if partial is not None else None,
        noise=noise,
        method=method,
        level=level,
    )
    sized: FrameT = _with_results(nw, given, found)
    return sized


def _place(index: int) -> str:
    return f"row {index}"


def _eager(nw: Any, frame: object) -> Any:
    """Wrap a frame whose rows are there."""
    try:
        given = nw.from_native(frame, pass_through=True)
    except nw.exceptions.DuplicateError as error:
        columns: Any = getattr(frame, "columns", ())
        msg = f"`frame` must not have two columns of one name; got {list(columns)}."
        raise ValueError(msg) from error
    if isinstance(given, nw.LazyFrame):
        msg = (
            f"`frame` must hold its rows; got the {type(frame).__name__} of "
            f"{type(frame).__module__.partition('.')[0]}, which is lazy. Collect it first: "
            "fit_table(frame.collect(), ...)."
        )
        raise TypeError(msg)
    owners = nw.Implementation.PANDAS, nw.Implementation.POLARS, nw.Implementation.PYARROW
    if not (isinstance(given, nw.DataFrame) and given.implementation in owners):
        msg = (
            "`frame` must be a data frame of pandas or polars, or a table of pyarrow; got "
            f"{type(frame).__name__}. Plain arrays go through fit_columns()."
        )
        raise TypeError(msg)
    return given


def _numbers(argument: str, column: Any) -> NDArray[Any]:
    """Turn a column into numbers, null into NaN; integers without nulls stay integers."""
    if column.null_count() == len(column):  # of any type: nobody told
        return np.full(len(column), np.nan)
    if not column.dtype.is_numeric():
        msg = (
            f'`{argument}` must name a column of numbers; got {column.dtype} in "{column.name}". '
            "Convert that column first."
        )
        raise TypeError(msg)
    array: NDArray[Any] = column.to_numpy()
    return array if array.dtype.kind in "fiu" else array.astype(np.float64)  # decimals


def _truths(nw: Any, column: Any) -> BoolArray:
    """Turn a column into truth values; null is none."""
    if column.null_count():
        msg = (
            f'`partial` must be True or False; got null in column "{column.name}", '
            f"{_first_null(column)}."
        )
        raise ValueError(msg)
    if len(column) and column.dtype != nw.Boolean:
        msg = (
            f"`partial` must name a column of truth values; got {column.dtype} in "
            f'"{column.name}". Convert that column first.'
        )
        raise TypeError(msg)
    return np.asarray(column.to_numpy(), dtype=np.bool_)


def _ids(nw: Any, column: Any) -> IntArray:
    """Give every image a number."""
    if column.null_count():
        msg = (
            f'`image_id` must tell the image of every object; got null in column "{column.name}", '
            f"{_first_null(column)}."
        )
        raise ValueError(msg)
    if column.dtype.is_integer():
        array: IntArray = column.to_numpy()
        return array
    if len(column) == 0:  # of any type
        return np.empty(0, dtype=np.intp)
    if column.dtype not in _texts(nw):
        msg = (
            f"`image_id` must name a column of integers or strings; got {column.dtype} in "
            f'"{column.name}". Convert that column first.'
        )
        raise TypeError(msg)
    return _codes(nw, column)[0]


def _labels(nw: Any, column: Any) -> tuple[IntArray, list[str]]:
    """Give every label a number, -1 for null."""
    if column.null_count() == len(column):  # of any type: nobody told
        return np.full(len(column), -1, dtype=np.intp), []
    if column.dtype in _texts(nw):
        codes, names = _codes(nw, column)
        if all(isinstance(name, str) for name in names):
            return codes, names
    msg = f'`label` must name a column of strings; got {column.dtype} in "{column.name}".'
    raise TypeError(msg)


def _texts(nw: Any) -> tuple[Any, ...]:
    return (nw.String, nw.Categorical, nw.Enum)


def _first_null(column: Any) -> str:
    return _place(int(column.is_null().to_numpy().argmax()))


def _codes(nw: Any, column: Any) -> tuple[IntArray, list[Any]]:
    """Give distinct values numbers, -1 for null, by the fastest means of the frame's library."""
    native, library = column.to_native(), column.implementation.to_native_namespace()
    if column.implementation.is_pandas():
        codes, names = library.factorize(native)
        return codes, names.tolist()
    if column.implementation.is_pyarrow():
        codes, names = codes_of(library, native)
        return codes, names.to_pylist()
    texts = column.cast(nw.String)
    names = texts.drop_nulls().unique(maintain_order=True).to_list()
    numbers = texts.cast(nw.Enum(names)).to_native().to_physical()
    codes = nw.from_native(numbers, series_only=True).cast(nw.Int64).fill_null(-1).to_numpy()
    return codes, names


def _with_results(nw: Any, given: Any, found: BatchResult) -> Any:
    """Add what was found, in the frame's own types."""
    images, rows = found
    columns: dict[str, Any] = {name: getattr(images, name)[rows.image] for name in _OF_IMAGE}
    columns |= {name: getattr(rows, name) for name in _OF_OBJECT}
    columns |= {"flags": rows.flags, "model_flags": images.flags[rows.image]}
    backend = given.implementation
    made = {name: nw.new_series(name, column, backend=backend) for name, column in columns.items()}
    words = nw.new_series("reason", list(REASONS), nw.String, backend=backend)
    made["reason"] = words[rows.reason]
    return given.with_columns(*(made[name] for name in _ADDED)).to_native()
