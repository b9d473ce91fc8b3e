"""`fit` and `predict` for many images at once, on plain columns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from imgscale._checks import (
    as_array,
    as_image_size,
    check_choice,
    check_type,
    non_negative_number,
)
from imgscale._depth_values import (
    METRIC_SCALES,
    VALUE_KINDS,
    as_given,
    refuse_integers,
    valid_depths,
)
from imgscale._typing import (
    BoolArray,
    DepthKind,
    FitMethod,
    FloatArray,
    ImageSize,
    IntArray,
    SizeAxis,
)
from imgscale.batch import _blocks, _cases
from imgscale.batch._labels import coded, labels_of
from imgscale.batch._slab import (
    CodeArray,
    ImageResults,
    Options,
    RowResults,
    Slab,
    WholeArray,
    log_extent,
    noise_var,
)
from imgscale.core.witnesses import UNKNOWN_DEPTH_REL
from imgscale.estimate import central_scores
from imgscale.fitting import METHODS
from imgscale.flags import Flag
from imgscale.implied_focal import LARGEST_PHOTO_PX
from imgscale.laws import LAWS, PLAUSIBLE_FOCAL
from imgscale.noise import Noise
from imgscale.object_prior import SIZE_AXES
from imgscale.priors import PriorTable

__all__ = ["REASONS", "BatchResult", "ImageColumns", "RowColumns", "fit_columns"]

# Why an object was not used, by the codes in `RowColumns.reason`.
REASONS = ("", "no prior", "partial", "no depth", "outlier", "one depth")

# Objects that are worked on at once.
_SLAB = 1_048_576
_RANGE = "from 1e-100 to 1e100"
_LEAST, _MOST = 1e-100, 1e100  # of pixels and depths, whose ratios and squares must be numbers


_T = TypeVar("_T")


def _by_identity(kind: type[_T]) -> type[_T]:
    """Compare tuples of arrays by identity: of arrays, equality is no one truth."""
    for name in ("__eq__", "__ne__", "__hash__"):
        setattr(kind, name, getattr(object, name))
    return kind


@_by_identity
class ImageColumns(NamedTuple):
    """
    The models of M images, by increasing id.

    Attributes
    ----------
    image_id : (M,) ndarray
        The ids, each once.
    k, k_std : (M,) ndarray of float64
        As in `ScaleModel`; NaN where no object of the image can be a reference.
    shift : (M,) ndarray of float64
        Shift of the inverse depth; 0 for kinds without one.
    flags : (M,) ndarray of int32
        Reservations, bits of `Flag`.
    n_objects, n_candidates, n_used : (M,) ndarray of int32
        Objects of the image, those that can be references, and those that were used.
    """

    image_id: np.ndarray[Any, np.dtype[Any]]
    k: FloatArray
    k_std: FloatArray
    shift: FloatArray
    flags: WholeArray
    n_objects: WholeArray
    n_candidates: WholeArray
    n_used: WholeArray


@_by_identity
class RowColumns(NamedTuple):
    """
    What was found of N objects, in the order given.

    Attributes
    ----------
    image : (N,) ndarray of int
        Place of its image in `ImageColumns`.
    size_m, std_m : (N,) ndarray of float64
        As in `SizeEstimate`, k d p and its standard error, in metres; NaN where it cannot be said.
    low_m, high_m : (N,) ndarray of float64
        Ends of the interval, in metres.
    weight : (N,) ndarray of float64
        Share in k, 0 to 1; 0 where it was no candidate.
    reason : (N,) ndarray of int8
        Why it was not used, a code into `REASONS`.
    flags : (N,) ndarray of int32
        Reservations, bits of `Flag`.
    """

    image: WholeArray
    size_m: FloatArray
    std_m: FloatArray
    low_m: FloatArray
    high_m: FloatArray
    weight: FloatArray
    reason: CodeArray
    flags: WholeArray


@_by_identity
class BatchResult(NamedTuple):
    """
    What `fit_columns` found. Equal only to itself, and so are its columns.

    Attributes
    ----------
    images : ImageColumns
        One row for each image.
    rows : RowColumns
        One row for each object.
    """

    images: ImageColumns
    rows: RowColumns


def fit_columns(
    image_id: ArrayLike,
    label: ArrayLike,
    pixels: ArrayLike,
    depth: ArrayLike,
    priors: PriorTable | None = None,
    *,
    kind: DepthKind,
    labels: Sequence[str] | None = None,
    axis: SizeAxis = "height",
    image_size: ImageSize | None = None,
    partial: ArrayLike | None = None,
    depth_rel_std: float | None = None,
    noise: Noise = Noise(),  # noqa: B008 - frozen
    method: FitMethod = "robust",
    level: float = 0.9,
) -> BatchResult:
    """
    Find the scale of many images and size their objects, all in columns.

    The numbers are those of `fit` and `predict` with `ObjectDepths`, image by image; a reference is
    sized as what it was, along the same axis. An image without a reference is no error here.

    Parameters
    ----------
    image_id : (N,) array_like
        Which image each object is in: integers, strings or dates. In order is faster.
    label : (N,) array_like of str or int
        The label of each object, or its code in `labels`, which is faster; -1 has none.
    pixels : (N,) array_like of float
        Extents along `axis`, in pixels, finite and positive.
    depth : (N,) array_like of float
        Depths of the objects' near surfaces; NaN where they are not known.
    priors : PriorTable, optional
        Sizes by label; the shipped table, ``PriorTable.default()``, where omitted. Rows along other
        axes are not used.
    kind : str
        What the depths are: "metric", "relative", "inverse" or "affine_inverse".
    labels : sequence of str, optional
        What the codes of `label` stand for.
    axis : str
        "height", "width" or "diameter".
    image_size : (width, height), optional
        Size of all images in pixels. It serves to tell an implausible focal length; without it, the
        images are taken to be at least as large as their largest extent.
    partial : (N,) array_like of bool, optional
        True for objects that are cut by the border or hidden in part.
    depth_rel_std : float, optional
        Relative standard error of the depths, as in `ObjectDepths`.
    noise : Noise
        Errors of boxes and depths. Where the depths' is told, here or above, a fit is nine times as
        fast.
    method : str
        As for `fit`.
    level : float
        Probability that an interval holds the size, above 0 and below 1.

    Returns
    -------
    BatchResult
        Columns for images and objects.

    Raises
    ------
    TypeError
        If an argument is of the wrong type.
    ValueError
        If an argument breaks its law; the first bad row is named.

    Notes
    -----
    Images are solved side by side, those of as many references together, in slabs of a million
    objects, so that the memory needed beside input and output does not grow with the batch.

    Examples
    --------
    >>> import imgscale as ims
    >>> from imgscale.batch import fit_columns
    >>> doors = ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.02)])
    >>> found = fit_columns([7, 7, 8], ["door", "statue", "statue"], [200.0, 150.0, 90.0],
    ...                     [4.0, 4.0, 6.0], doors, kind="relative",
    ...                     noise=ims.Noise(depth_rel=0.01))
    >>> found.images.image_id, found.images.k.round(6), found.images.n_used
    (array([7, 8]), array([0.0025,    nan]), array([1, 0], dtype=int32))
    >>> found.rows.size_m.round(3), [REASONS[code] for code in found.rows.reason]
    (array([2. , 1.5, nan]), ['', 'no prior', 'no prior'])
    """
    columns = _checked(image_id, label, pixels, depth, partial, kind, labels)
    options = _options(
        kind, columns.names, priors, axis, image_size, depth_rel_std, noise, method, level
    )
    order, starts = _images(columns.image_id)
    _keep_memory()
    images, counts = _new_images(starts, columns.code.size), np.diff(starts)
    rows = _new_rows(columns.code.size)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for first, last in _slabs(starts):
            here = slice(int(starts[first]), int(starts[last]))
            chosen = here if order is None else order[here]
            slab = Slab(
                code=columns.code[chosen],
                pixels=_extents(columns.pixels[chosen], here, order),
                depth=_depths(columns.depth[chosen], kind, here, order),
                partial=None if columns.partial is None else columns.partial[chosen],
                first=starts[first:last] - starts[first],
                counts=counts[first:last],
            )
            _solve(slab, options, images.part(slice(first, last)), rows, chosen)
    return _gathered(columns.image_id, order, starts, images, rows)


class _Columns(NamedTuple):
    """The arguments as arrays of one length."""

    image_id: np.ndarray[Any, np.dtype[Any]]
    code: IntArray
    names: Sequence[str]
    pixels: np.ndarray[Any, np.dtype[Any]]
    depth: np.ndarray[Any, np.dtype[Any]]
    partial: BoolArray | None


def _checked(
    image_id: ArrayLike,
    label: ArrayLike,
    pixels: ArrayLike,
    depth: ArrayLike,
    partial: ArrayLike | None,
    kind: DepthKind,
    labels: Sequence[str] | None,
) -> _Columns:
    """Turn the columns into arrays; numbers are checked slab by slab."""
    check_choice("kind", kind, VALUE_KINDS)
    code, names = coded(label, labels)
    given: dict[str, Any] = {
        "image_id": _as_ids(image_id),
        "label": code,
        "pixels": as_given(pixels),
        "depth": as_given(depth),
    }
    if partial is not None:
        given["partial"] = as_array("partial", "booleans", partial)
    count = int(given["image_id"].size)
    for name, array in given.items():
        if array.shape != (count,):
            msg = (
                f"`{name}` must be one value per object, {(count,)} as `image_id`; got the shape "
                f"{array.shape}."
            )
            raise ValueError(msg)
        wanted = {"pixels": "fiu", "depth": "fiu", "partial": "b"}.get(name)
        if count and wanted and array.dtype.kind not in wanted:
            law = "booleans" if wanted == "b" else "real numbers"
            msg = f"`{name}` must be {law}; got {array.dtype}."
            raise TypeError(msg)
    if kind == "metric" and isinstance(depth, np.ndarray):
        refuse_integers("depth", given["depth"], METRIC_SCALES)
    return _Columns(
        given["image_id"], code, names, given["pixels"], given["depth"], given.get("partial")
    )


def _as_ids(image_id: ArrayLike) -> np.ndarray[Any, np.dtype[Any]]:
    """Turn ids into an array that can be sorted."""
    ids = as_array("image_id", "one id per object", image_id)
    is_other = ids.dtype.kind == "O" and not all(isinstance(one, str) for one in ids.flat)
    if is_other or ids.dtype.kind in "cV":  # which have no order
        got = "other objects" if is_other else f"dtype {ids.dtype}"
        msg = f"`image_id` must be integers or strings; got {got}."
        raise TypeError(msg)
    if ids.dtype.kind in "fM" and np.isnan(ids).any():
        seen, at = ids[np.isnan(ids)][0], np.isnan(ids).argmax()
        msg = f"`image_id` must tell the image of each object; got {seen} at index {at}."
        raise ValueError(msg)
    return ids


def _options(
    kind: DepthKind,
    names: Sequence[str],
    priors: PriorTable | None,
    axis: SizeAxis,
    image_size: ImageSize | None,
    depth_rel_std: float | None,
    noise: Noise,
    method: str,
    level: float,
) -> Options:
    """Check what holds for all images."""
    check_choice("axis", axis, SIZE_AXES)
    check_choice("method", method, METHODS)
    check_type("noise", noise, Noise)
    told = None if depth_rel_std is None else non_negative_number("depth_rel_std", depth_rel_std)
    table = PriorTable.default() if priors is None else priors
    check_type("priors", table, PriorTable, " Wrap rows as PriorTable([...]).")
    law, unknown_noise = LAWS[kind], told is None and noise.depth_rel is None
    depth_var = (told or 0.0) ** 2 + (noise.depth_rel or 0.0) ** 2
    if unknown_noise and method in {"mean_ratio", "least_squares"}:
        depth_var = UNKNOWN_DEPTH_REL**2  # which these do not learn
    if law.has_shift and method in {"mean_ratio", "least_squares"}:
        msg = (
            f'`method` must be "posterior" or "robust" for depth of kind "{kind}", whose shift is '
            f'unknown; got "{method}".'
        )
        raise ValueError(msg)
    return Options(
        law=law,
        labels=labels_of(names, table, axis),
        noise=noise,
        depth_var=depth_var,
        unknown_noise=unknown_noise,
        method=method,
        image_size=as_image_size(image_size),
        score=central_scores(level)[1],
    )


def _images(image_id: np.ndarray[Any, np.dtype[Any]]) -> tuple[IntArray | None, IntArray]:
    """Find the order that sorts the ids, None where they are sorted; and where images start."""
    count, order = image_id.size, None
    if (image_id[1:] < image_id[:-1]).any():
        order = np.argsort(image_id)
        image_id = image_id[order]
    starts = np.flatnonzero(image_id[1:] != image_id[:-1]) + 1
    return order, np.concatenate([[0], starts, [count]] if count else [[0]]).astype(np.intp)


def _keep_memory() -> None:
    """
    Let the allocator keep what slabs give back: without it, a batch takes twice as long.

    glibc returns freed arrays of some 100 kB to the system, to be cleared page by page when they
    are wanted again, until it has seen a larger one freed. This one is never touched.
    """
    np.empty(_SLAB * 4)


def _slabs(starts: IntArray) -> Iterator[tuple[int, int]]:
    """Cut the images into slabs of about `_SLAB` objects, one image at least."""
    first, n_images = 0, starts.size - 1
    while first < n_images:
        limit = int(starts[first]) + _SLAB
        last = int(np.searchsorted(starts, limit, side="right")) - 1
        last = max(last, first + 1)
        yield first, last
        first = last


def _new_images(starts: IntArray, n_objects: int) -> ImageResults:
    """Make room for the models."""
    count = starts.size - 1
    whole = np.int32 if n_objects <= np.iinfo(np.int32).max else np.int64
    return ImageResults(
        k=np.full(count, np.nan),
        k_std=np.full(count, np.nan),
        shift=np.zeros(count),
        flags=np.zeros(count, dtype=np.int32),
        n_candidates=np.zeros(count, dtype=whole),
        n_used=np.zeros(count, dtype=whole),
    )


def _new_rows(count: int) -> RowResults:
    """Make room for the sizes."""
    return RowResults(
        size_m=np.empty(count),
        std_m=np.empty(count),
        low_m=np.empty(count),
        high_m=np.empty(count),
        weight=np.zeros(count),
        reason=np.zeros(count, dtype=np.int8),
        flags=np.zeros(count, dtype=np.int32),
    )


def _extents(pixels: Any, here: slice, order: IntArray | None) -> FloatArray:
    """Take a slab's extents, positive and finite."""
    bad = ~((pixels >= _LEAST) & (pixels <= _MOST))
    if bad.any():
        lawful = bool(((pixels > 0) & np.isfinite(pixels)).all())
        _refuse("pixels", _RANGE if lawful else "finite and positive", pixels, bad, here, order)
    return np.asarray(pixels, dtype=np.float64)


def _depths(depth: Any, kind: DepthKind, here: slice, order: IntArray | None) -> FloatArray:
    """Take a slab's depths, valid ones or NaN."""
    size = np.abs(depth)
    bad = ~(np.isnan(depth) | valid_depths(depth, kind))
    lawful = not bad.any()
    bad |= size > _MOST
    if kind != "affine_inverse":  # which may be 0
        bad |= size < _LEAST
    if bad.any():
        law = "finite" if kind == "affine_inverse" else "finite and positive"
        _refuse(
            "depth", f"{_RANGE if lawful else law}, or NaN where unknown", depth, bad, here, order
        )
    return np.asarray(depth, dtype=np.float64)


def _refuse(
    name: str, law: str, values: Any, bad: BoolArray, here: slice, order: IntArray | None
) -> None:
    """Name the first bad row of a slab."""
    place = int(np.flatnonzero(bad)[0])
    row = here.start + place if order is None else int(order[here][place])
    msg = f"`{name}` must be {law}; got {values[place]} at index {row}."
    raise ValueError(msg)


def _solve(
    slab: Slab,
    options: Options,
    images: ImageResults,
    rows: RowResults,
    chosen: slice | IntArray,
) -> None:
    """Fit a slab and size its objects."""
    reason = slab.reasons(options.labels)
    candidates = np.flatnonzero(reason == 0) if reason.any() else None
    images.n_candidates[:] = (
        slab.counts if candidates is None else np.add.reduceat(reason == 0, slab.first, dtype=int)
    )
    local = rows.part(chosen) if isinstance(chosen, slice) else _new_rows(reason.size)
    local.reason[:] = reason
    solver = _cases if _has_cases(options) else _blocks
    solver.fit_slab(slab, candidates, options, images, local)
    _judge_focal(slab, options, images)
    if candidates is not None:
        _finish(slab, reason, options, images, local)
    if not isinstance(chosen, slice):
        columns: list[Any] = list(rows)
        for column, values in zip(columns, local, strict=True):
            column[chosen] = values


def _finish(
    slab: Slab, reason: CodeArray, options: Options, images: ImageResults, rows: RowResults
) -> None:
    """Size what is no reference, and flag it; cases have sized it already."""
    others = np.flatnonzero(reason)
    if not _has_cases(options):
        image = np.repeat(np.arange(slab.first.size), slab.counts)[others]
        log_size, pixels = log_extent(slab, others, options.law)
        rel_std = images.k_std[image] / images.k[image]
        variance = rel_std**2 + noise_var(pixels, options)
        rows.put(others, np.log(images.k[image]) + log_size, variance, options.score)
    unknown = np.isnan(slab.depth[others])
    rows.flags[others] |= np.where(unknown, Flag.NO_DEPTH.value, 0).astype(np.int32)
    if slab.partial is not None:
        cut = slab.partial[others]
        rows.flags[others] |= np.where(cut, Flag.PARTIAL.value, 0).astype(np.int32)


def _has_cases(options: Options) -> bool:
    """Tell whether the noise, the shift or k itself is averaged over."""
    if options.method == "robust":
        return options.unknown_noise or options.law.has_shift
    return options.method == "posterior"


def _judge_focal(slab: Slab, options: Options, images: ImageResults) -> None:
    """Flag focal lengths, 1 / k of metric depth, that belong to no camera that takes photos."""
    if options.law.kind != "metric":
        return
    if options.image_size:
        smallest = largest = np.array([float(max(options.image_size))])
    else:
        smallest = np.maximum.reduceat(slab.pixels, slab.first)
        largest = np.maximum(smallest, LARGEST_PHOTO_PX)
    implied = 1 / images.k
    off = (implied < PLAUSIBLE_FOCAL[0] * smallest) | (implied > PLAUSIBLE_FOCAL[1] * largest)
    images.flags[off] |= Flag.IMPLAUSIBLE_FOCAL.value


def _gathered(
    image_id: np.ndarray[Any, np.dtype[Any]],
    order: IntArray | None,
    starts: IntArray,
    images: ImageResults,
    rows: RowResults,
) -> BatchResult:
    """Put the results together."""
    counts = np.diff(starts)
    first = starts[:-1]
    models = ImageColumns(
        image_id=image_id[first if order is None else order[first]],
        k=images.k,
        k_std=images.k_std,
        shift=images.shift,
        flags=images.flags,
        n_objects=counts.astype(images.n_used.dtype),
        n_candidates=images.n_candidates,
        n_used=images.n_used,
    )
    image = np.repeat(np.arange(counts.size, dtype=images.n_used.dtype), counts)
    if order is not None:
        unsorted = np.empty_like(image)
        unsorted[order] = image
        image = unsorted
    return BatchResult(models, RowColumns(image, *rows))
