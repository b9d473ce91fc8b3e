"""
Median, quartiles and any other quantile of the depths in boxes or under masks, exactly.

Medians of boxes are what most programs call an object's depth. They are quick to write with
`np.nanmedian` and slow to run: it copies the pixels that are depths apart, and selects one number
at a time. Here numpy selects on the bits of the numbers: those of positive floats, read as
integers, have the floats' order, with what is no depth at both ends, so nothing is set apart. `fit`
and `predict` do not use medians: a box also holds background (see `imgscale.sampling`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgscale._checks import as_array, check_type
from imgscale._typing import AnyFloatArray, BoolArray, Box, FloatArray
from imgscale.depth_map import DepthMap
from imgscale.detection import Detection, check_detections
from imgscale.extent import outside_image
from imgscale.sampling import map_window, pixels_on_mask

__all__ = ["box_quantiles"]

_BOX_LAW = "boxes of shape (N, 4), x1, y1, x2, y2 each, or Detection objects"


class _Region(NamedTuple):
    box: Box
    mask: BoolArray | None


def box_quantiles(
    depth: DepthMap,
    boxes: Sequence[Detection] | ArrayLike,
    q: float | Sequence[float] | FloatArray = 0.5,
) -> FloatArray:
    """
    Compute quantiles of the depths in boxes.

    Parameters
    ----------
    depth : DepthMap
        The map.
    boxes : sequence of Detection, or (N, 4) array_like of float
        Detections, or corners x1, y1, x2, y2; half-open pixels of the image, scaled to the map. A
        map's pixel belongs to a box, and to the mask of a detection that has one, if its centre
        does; to a box without a centre in it, the pixel that holds the box's own; to a mask
        without one, none. Boxes may overlap.
    q : float or (Q,) array_like of float
        One quantile or several, in any order, from 0 to 1: 0.5 is the median.

    Returns
    -------
    (N,) or (N, Q) ndarray of float64
        The quantiles, one row per box, in the map's unit; NaN where no pixel has a depth.

    Raises
    ------
    ValueError
        If a box is inverted, not finite or beyond the image, a mask not of its shape, or a
        quantile not between 0 and 1.
    TypeError
        If the depth is no map, or boxes or quantiles are no numbers.

    Notes
    -----
    Of n depths in ascending order, v[0] to v[n - 1], the quantile is v at the place ``q (n - 1)``,
    linear between neighbours: the mean of the two middle ones for the median of an even number.
    That is numpy's method "linear", its default, on the pixels that are depths.

    Examples
    --------
    >>> import numpy as np
    >>> import imgscale as ims
    >>> from imgscale.order_statistics import box_quantiles
    >>> values = np.array([[2.0, 3.0, 0.0, 9.0], [np.nan, 5.0, 7.0, 9.0]])
    >>> depth = ims.DepthMap(values, kind="metric")
    >>> box_quantiles(depth, [(0, 0, 3, 2), (3, 0, 4, 2)])
    array([4., 9.])
    >>> box_quantiles(depth, [ims.Detection("car", (0, 0, 3, 2))], q=[0.25, 0.75])
    array([[2.75, 5.5 ]])
    >>> box_quantiles(depth, [(0, 0, 6, 2)])
    Traceback (most recent call last):
        ...
    ValueError: `boxes` must lie in the image, 4 x 2 px; got (0.0, 0.0, 6.0, 2.0) at index 0. Clip
    them, or tell the map the size of their image: DepthMap(..., image_size=(width, height)).
    """
    check_type("depth", depth, DepthMap, " Put an array into a DepthMap with its kind.")
    wanted = _as_shares(q)
    order = _order_of(depth)
    with np.errstate(over="ignore"):  # of wider floats, what is too large is no depth
        rows = [
            _quantiles(keys, wanted.ravel().tolist(), order)
            for keys in _keys_of(depth, _regions(boxes, depth), order)
        ]
    found: FloatArray = np.array(rows, dtype=np.float64).reshape(-1, *wanted.shape)
    return found


# --- what was given ---


def _as_shares(q: float | Sequence[float] | FloatArray) -> FloatArray:
    shares = as_array("q", "a number from 0 to 1, or several", q)
    if shares.dtype.kind not in "fiu":
        msg = f"`q` must be a number from 0 to 1, or several; got {q!r}."
        raise TypeError(msg)
    if shares.ndim > 1 or not ((shares >= 0) & (shares <= 1)).all():
        msg = f"`q` must be a number from 0 to 1, or several in a row; got {q!r}."
        raise ValueError(msg)
    return shares.astype(np.float64)


def _regions(boxes: Sequence[Detection] | ArrayLike, depth: DepthMap) -> list[_Region]:
    """Read boxes or detections, and check them against the image."""
    given: Any = boxes
    if isinstance(boxes, Iterable) and not isinstance(boxes, (np.ndarray, str, bytes)):
        given = list(boxes)
        if any(isinstance(item, Detection) for item in given):
            detections = check_detections(given)
            regions = [_Region(item.xyxy, item.mask) for item in detections]
            _check_boxes(np.array([region.box for region in regions]), depth)
            _check_masks(regions, depth)
            return regions
    corners = as_array("boxes", _BOX_LAW, given)
    if not corners.size:
        return []
    if corners.dtype.kind not in "fiu":
        msg = f"`boxes` must be {_BOX_LAW}; got dtype {corners.dtype}."
        raise TypeError(msg)
    if corners.ndim != 2 or corners.shape[1] != 4:
        msg = f"`boxes` must be {_BOX_LAW}; got shape {corners.shape}."
        raise ValueError(msg)
    _check_boxes(corners.astype(np.float64), depth)
    return [_Region((x1, y1, x2, y2), None) for x1, y1, x2, y2 in corners.tolist()]


def _check_boxes(boxes: FloatArray, depth: DepthMap) -> None:
    lawful = np.isfinite(boxes).all(axis=1) & (boxes[:, :2] < boxes[:, 2:]).all(axis=1)
    if not lawful.all():
        index = int(np.flatnonzero(~lawful)[0])
        msg = (
            f"`boxes` must be finite, with x1 < x2 and y1 < y2; got {tuple(boxes[index].tolist())} "
            f"at index {index}."
        )
        raise ValueError(msg)
    beyond = np.flatnonzero(outside_image(boxes, depth.image_size))
    if beyond.size:
        index = int(beyond[0])
        width, height = depth.image_size
        msg = (
            f"`boxes` must lie in the image, {width} x {height} px; got "
            f"{tuple(boxes[index].tolist())} at index {index}. Clip them, or tell the map the size "
            "of their image: DepthMap(..., image_size=(width, height))."
        )
        raise ValueError(msg)


def _check_masks(regions: Sequence[_Region], depth: DepthMap) -> None:
    width, height = depth.image_size
    for index, region in enumerate(regions):
        if region.mask is not None and region.mask.shape != (height, width):
            msg = (
                f"`mask` must have the shape of the image, {(height, width)}; got "
                f"{region.mask.shape} at index {index}."
            )
            raise ValueError(msg)


# --- floats as integers of the same order ---


class _Order(NamedTuple):
    """
    How the bits of one map's floats are ordered when they are read as integers.

    Where depths are positive, as unsigned ones: zero, depths, infinity and NaN, and at last all
    that has a sign. Where depths may be negative, as signed ones, see `_flips`.
    """

    number: np.dtype[Any]
    integer: np.dtype[Any]
    infinite: np.integer[Any]  # depths are below
    nothing: np.integer[Any] | None  # and above this, where there may be numbers below


def _order_of(depth: DepthMap) -> _Order:
    own = depth.values.dtype
    number = own.newbyteorder("=") if own.itemsize <= 8 else np.dtype(np.float64)
    signed = depth.kind == "affine_inverse"
    integer = np.dtype(f"{'i' if signed else 'u'}{number.itemsize}")
    infinite: Any = np.array(math.inf, dtype=number).view(integer)[()]
    if signed:
        return _Order(number, integer, infinite, ~infinite)
    return _Order(number, integer, infinite, None if depth.gaps_are_nan else integer.type(0))


def _keys_of(
    depth: DepthMap, regions: Sequence[_Region], order: _Order
) -> Iterable[NDArray[np.integer[Any]]]:
    """
    Copy the pixels of each region and read their bits as integers.

    All share one room, each overwrites the last: fresh memory would cost as much as the selection.
    """
    values = depth.values
    windows = [map_window(values.shape, region.box, depth.image_size) for region in regions]
    room: AnyFloatArray = np.empty(max((values[w].size for w in windows), default=0), order.number)
    for region, window in zip(regions, windows, strict=True):
        if region.mask is None:
            pixels = values[window]
        else:
            pixels = pixels_on_mask(values, region.box, region.mask, depth.image_size)
        own = room[: pixels.size]
        # in the order of memory: no order of pixels matters here
        near = pixels.T if pixels.strides[0] < pixels.strides[-1] else pixels
        np.copyto(own.reshape(near.shape), near, casting="same_kind")
        yield own.view(order.integer)


def _flips(keys: Any) -> Any:
    """
    Find the bits that give negative floats the order of integers, and take it back.

    Floats keep a sign and a magnitude: as they are, the most negative comes last of them.
    """
    return (keys >> (8 * keys.dtype.itemsize - 1)) & np.iinfo(keys.dtype).max


# --- selection ---


def _quantiles(
    keys: NDArray[np.integer[Any]], shares: Sequence[float], order: _Order
) -> list[float]:
    """Compute quantiles of the depths among pixels; their keys change places."""
    flipped = keys.dtype.kind == "i" and bool(keys.size) and bool(keys.min() < 0)
    if flipped:
        keys ^= _flips(keys)
    first = 0 if order.nothing is None else int(np.count_nonzero(keys <= order.nothing))
    count = int(np.count_nonzero(keys < order.infinite)) - first
    if not count:
        return [math.nan] * len(shares)
    places = [(count - 1) * share for share in shares]
    ranks = sorted({first + math.ceil(place) for place in places})
    _select(keys, ranks, 0, keys.size)

    def number_of(key: np.integer[Any]) -> float:
        return float((key ^ _flips(key) if flipped else key).view(order.number))

    known: dict[int, tuple[float, float]] = {}
    start = 0
    for rank in ranks:  # of what lies between two of them, the largest comes before the second
        before = keys[start:rank].max() if rank > first else keys[rank]
        known[rank] = number_of(before), number_of(keys[rank])
        start = rank
    return [_between(*known[first + math.ceil(place)], share=place % 1) for place in places]


def _select(keys: NDArray[Any], ranks: Sequence[int], start: int, stop: int) -> None:
    """
    Put the numbers of some ranks into their places.

    One rank a call, on a part of a contiguous array: for several at once, `partition` leaves the
    processor's vectors and takes ten times as long.
    """
    if not ranks:
        return
    middle = len(ranks) // 2
    rank = ranks[middle]
    keys[start:stop].partition(rank - start)
    _select(keys, ranks[:middle], start, rank)
    _select(keys, ranks[middle + 1 :], rank + 1, stop)


def _between(below: float, above: float, *, share: float) -> float:
    """Go a share of the way from one number to the next; 0 stands for all of it."""
    if share == 0:
        return above
    if share == 0.5 and math.isfinite(below + above):
        return (below + above) / 2
    if not math.isfinite(above - below):
        return below * (1 - share) + above * share
    if share > 0.5:
        return above - (above - below) * (1 - share)
    return below + (above - below) * share
