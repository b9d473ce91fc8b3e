"""One image per row, its objects in lists: a pure function of Arrow tables, for engines to map."""

from __future__ import annotations

from functools import partial as partial_of
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from imgscale._optional import require
from imgscale._typing import BoolArray, DepthKind, FitMethod, ImageSize, IntArray, SizeAxis
from imgscale.batch._given import check_depths, check_extents, check_names
from imgscale.batch.columns import REASONS, BatchResult, fit_columns
from imgscale.noise import Noise
from imgscale.priors import PriorTable

__all__ = ["fit_arrow"]

TableT = TypeVar("TableT")

_PER_IMAGE = {"k": np.nan, "k_std": np.nan, "flags": 0, "n_used": 0}  # without an object
_PER_OBJECT = ("size_m", "low_m", "high_m", "weight", "reason")
_LARGEST_OFFSET = 2**31 - 1  # of lists that are not large


def fit_arrow(
    table: TableT,
    priors: PriorTable | None = None,
    *,
    kind: DepthKind,
    label: str = "label",
    pixels: str = "pixels",
    depth: str = "depth",
    partial: str | None = None,
    axis: SizeAxis = "height",
    image_size: ImageSize | None = None,
    noise: Noise = Noise(),  # noqa: B008 - frozen
    method: FitMethod = "robust",
    level: float = 0.9,
) -> TableT:
    """
    Fit and size the objects of many images, one image per row.

    No state, no order between rows, nothing written: a function for the `map_batches` of Ray, the
    `mapInArrow` of Spark and Dask. Needs the extra `arrow`.

    Parameters
    ----------
    table : pyarrow.Table
        A row per image. The columns named below are lists, as long as each other in every row,
        with an entry per object; null and empty lists are images without objects. Lists of every
        Arrow type, sliced and in chunks. Other columns are passed on as they are.
    priors : PriorTable, optional
        Sizes by label; the shipped table, ``PriorTable.default()``, where omitted.
    kind : str
        What the depths are: "metric", "relative", "inverse" or "affine_inverse".
    label : str
        Column of labels, strings or dictionaries of them; null is an object without a prior.
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
    pyarrow.Table
        The same rows and columns, and ``k`` and ``k_std`` (double, NaN where no object can be a
        reference), ``flags`` (int64, bits of `Flag`), ``n_used`` (int64, references used), and
        lists of double with an entry per object: ``size_m``, ``low_m`` and ``high_m`` (the ends of
        the interval, in metres; NaN where they cannot be said), ``weight`` (share in k), and of
        string: ``reason`` (why it was not used, one of `REASONS`, empty where it was). Lists are
        null where that of `pixels` is, and large lists where it is one.

    Raises
    ------
    TypeError
        If an argument, or a column, is of the wrong type.
    ValueError
        If a value breaks its law, lists of one row differ in length, a column is missing, or there
        is one already that the result adds.
    MissingDependencyError
        Without pyarrow.

    See Also
    --------
    fit_columns : The same on numpy columns, a row per object.

    Examples
    --------
    >>> import pyarrow as pa
    >>> import imgscale as ims
    >>> from imgscale.batch import fit_arrow
    >>> photos = pa.table({
    ...     "file": ["a.jpg", "b.jpg"],
    ...     "label": [["door", "statue"], []],
    ...     "pixels": [[200.0, 150.0], []],
    ...     "depth": [[4.0, 4.0], []],
    ... })
    >>> door = ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.02)])
    >>> sized = fit_arrow(photos, door, kind="relative")
    >>> [[round(size, 2) for size in sizes] for sizes in sized["size_m"].to_pylist()]
    [[2.0, 1.5], []]
    >>> sized["reason"].to_pylist()
    [['', 'no prior'], []]
    """
    pa: Any = require("pyarrow", extra="arrow", purpose="fit_arrow")
    given: Any = table  # pyarrow is not typed
    _check_table(pa, given)
    asked = {"label": label, "pixels": pixels, "depth": depth, "partial": partial}
    check_names(asked, given.column_names, (*_PER_IMAGE, *_PER_OBJECT))
    lists = {
        name: _read(pa, name, given.column(column))
        for name, column in asked.items()
        if column is not None
    }
    extents = lists["pixels"]
    _check_lengths(lists, asked)
    values = _numbers(pa, "pixels", pixels, extents.values)
    depths = _numbers(pa, "depth", depth, lists["depth"].values)
    place = partial_of(_place, extents)
    check_extents(values, pixels, place)
    whole = pa.types.is_integer(lists["depth"].values.type)
    check_depths(depths, kind, depth, place, as_integers=whole)
    codes, names = _codes_of_labels(pa, label, lists["label"].values)
    found = fit_columns(
        np.repeat(np.arange(extents.lengths.size), extents.lengths),
        codes,
        values,
        depths,
        priors,
        kind=kind,
        labels=names,
        axis=axis,
        image_size=image_size,
        partial=_truths(pa, partial, lists["partial"]) if partial is not None else None,
        noise=noise,
        method=method,
        level=level,
    )
    sized: TableT = _with_results(pa, given, extents, found)
    return sized


class _Lists(NamedTuple):
    """
    One column of lists, as it is in memory: all entries in a row, and how many each image has.

    Attributes
    ----------
    values : pyarrow.ChunkedArray
        The entries.
    lengths : (M,) ndarray of int
        How many each row has.
    is_null : (M,) ndarray of bool
        Where there is no list.
    is_large : bool
        Whether offsets are of 64 bits.
    """

    values: Any
    lengths: IntArray
    is_null: BoolArray
    is_large: bool


def _check_table(pa: Any, table: Any) -> None:
    if not isinstance(table, pa.Table):
        msg = (
            f"`table` must be a pyarrow.Table; got {type(table).__name__}. Make one of a batch by "
            'pyarrow.Table.from_batches([batch]); Ray gives them with batch_format="pyarrow".'
        )
        raise TypeError(msg)


def _read(pa: Any, argument: str, column: Any) -> _Lists:
    """Take a column of lists apart, whatever its chunks and slices are."""
    kinds, pc = pa.types, require("pyarrow.compute", extra="arrow", purpose="fit_arrow")
    large = kinds.is_large_list(column.type) or kinds.is_large_list_view(column.type)
    plain = kinds.is_list(column.type) or kinds.is_list_view(column.type)
    if not (large or plain or kinds.is_fixed_size_list(column.type)):
        msg = (
            f"`{argument}` must name a column of lists, one per image; got {column.type}. For a "
            "row per object there is fit_table()."
        )
        raise TypeError(msg)
    lengths = pc.fill_null(pc.list_value_length(column), 0).to_numpy()
    return _Lists(
        values=pc.list_flatten(column),
        lengths=lengths.astype(np.intp, copy=False),
        is_null=column.is_null().to_numpy(),
        is_large=large,
    )


def _check_lengths(lists: dict[str, _Lists], names: dict[str, str | None]) -> None:
    """Raise where the lists of one row differ in length."""
    extents = lists["pixels"]
    for argument, other in lists.items():
        unequal = other.lengths != extents.lengths
        if unequal.any():
            row = int(np.argmax(unequal))
            msg = (
                f"`{argument}` must have as many entries as `pixels` in every row; got "
                f'{other.lengths[row]} in column "{names[argument]}" and {extents.lengths[row]} in '
                f'"{names["pixels"]}", row {row}. Null stands for an entry that is not known.'
            )
            raise ValueError(msg)


def _numbers(pa: Any, argument: str, name: str, values: Any) -> NDArray[Any]:
    """Turn entries into an array, null into NaN; integers without nulls stay integers."""
    kinds = pa.types
    if kinds.is_null(values.type):
        return np.full(len(values), np.nan)
    if kinds.is_decimal(values.type):
        values = values.cast(pa.float64())
    if not (kinds.is_integer(values.type) or kinds.is_floating(values.type)):
        msg = f'`{argument}` must hold numbers; got lists of {values.type} in column "{name}".'
        raise TypeError(msg)
    array: NDArray[Any] = values.to_numpy()
    return array


def _truths(pa: Any, name: str, lists: _Lists) -> BoolArray:
    """Turn entries into truth values; null is none."""
    if lists.values.null_count:
        index = int(np.argmax(lists.values.is_null().to_numpy()))
        msg = (
            f'`partial` must be True or False; got null in column "{name}", {_place(lists, index)}.'
        )
        raise ValueError(msg)
    if not (pa.types.is_boolean(lists.values.type) or len(lists.values) == 0):
        msg = f'`partial` must hold truth values; got {lists.values.type} in column "{name}".'
        raise TypeError(msg)
    array: BoolArray = lists.values.to_numpy().astype(np.bool_, copy=False)
    return array


def codes_of(pa: Any, column: Any) -> tuple[IntArray, Any]:
    """
    Give every distinct value of a column a number.

    Parameters
    ----------
    pa : module
        The module `pyarrow`.
    column : pyarrow.ChunkedArray
        The column, plain or of dictionaries.

    Returns
    -------
    codes : (N,) ndarray of int
        Places in `names`, -1 for null.
    names : pyarrow.Array
        The values.
    """
    kinds = pa.types
    if kinds.is_dictionary(column.type) and any(c.dictionary.null_count for c in column.chunks):
        column = column.cast(column.type.value_type)  # null by two ways
    encoded = column if kinds.is_dictionary(column.type) else column.dictionary_encode()
    chunks = encoded.unify_dictionaries().chunks
    places = [chunk.indices for chunk in chunks]
    indices = pa.chunked_array(places, encoded.type.index_type).cast(pa.int32())
    codes: IntArray = indices.fill_null(-1).to_numpy()
    return codes, chunks[0].dictionary if chunks else pa.array([], pa.string())


def _codes_of_labels(pa: Any, name: str, values: Any) -> tuple[IntArray, list[str]]:
    """Give every label a number, -1 for null."""
    if pa.types.is_null(values.type):
        return np.full(len(values), -1, dtype=np.intp), []
    codes, names = codes_of(pa, values)
    kinds = pa.types
    texts = (kinds.is_string, kinds.is_large_string, kinds.is_string_view)
    if not any(is_text(names.type) for is_text in texts):
        msg = f'`label` must hold strings; got lists of {values.type} in column "{name}".'
        raise TypeError(msg)
    return codes, names.to_pylist()


def _place(lists: _Lists, index: int) -> str:
    """Name the place of an entry."""
    ends = np.cumsum(lists.lengths)
    row = int(np.searchsorted(ends, index, side="right"))
    return f"row {row}, entry {index - int(ends[row] - lists.lengths[row])}"


def _around(pa: Any, lists: _Lists, values: Any) -> Any:
    """Cut other entries into lists of the same lengths."""
    offsets = np.concatenate([[0], np.cumsum(lists.lengths)])
    is_large = lists.is_large or offsets[-1] > _LARGEST_OFFSET
    made, width = (pa.LargeListArray, pa.int64()) if is_large else (pa.ListArray, pa.int32())
    return made.from_arrays(pa.array(offsets, width), values, mask=pa.array(lists.is_null))


def _with_results(pa: Any, table: Any, extents: _Lists, found: BatchResult) -> Any:
    """Add what was found, per image and per object."""
    images, rows = found
    for name, missing in _PER_IMAGE.items():
        column = np.full(table.num_rows, missing)
        column[images.image_id] = getattr(images, name)  # images without objects are not in it
        table = table.append_column(name, pa.array(column))
    entries = {name: pa.array(getattr(rows, name)) for name in _PER_OBJECT}
    entries["reason"] = pa.array(REASONS).take(entries["reason"])
    for name, values in entries.items():
        table = table.append_column(name, _around(pa, extents, values))
    return table
