"""
One depth per object from a depth map: that of the visible surface the box outlines.

A box also holds background, which draws a mean or median back, and now and then an occluder, which
draws a low percentile forward. The sampler therefore looks at the core of the box (or at the mask),
finds the dominant surface there, the log-depth window that holds most pixels, and takes the depth
a quarter of the way into it. On rendered scenes a plain quartile of the depths is more than 10 %
wrong on half of the objects behind an occluder, the median on half of those one sees through; the
fullest window on 5 and 10 %. Windows in log depth and order statistics are the same for z, s * z
and 1 / z, so every version of one map gives the same sizes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from imgscale._typing import (
    AnyFloatArray,
    BoolArray,
    Box,
    DepthKind,
    FloatArray,
    ImageSize,
    IntArray,
)

# The central half of the box each way. Shares from 0.4 to 0.6 do alike; 0.3 loses objects one can
# see through, 0.7 and more lose to occluders (benchmarks/sampling.py prints all figures here).
_CORE_SHARE = 0.5
# One surface: depths within 6 % of each other. From 3 to 15 % LiDAR maps of traffic give the same
# error, 2.0 % in the median; rendered scenes have 5 to 8 % of their depths wrong by more than 10 %,
# fewest for wide windows, but on a spoked wheel 8 % and more take the hub for the tyre.
SURFACE_LOG_WIDTH = 0.06
# The outline of an object is its near face, so the near quarter of the surface: against the true
# depth 0.1 errs by -0.3 %, 0.25 by +0.3 %, 0.5 by +1.4 % on rendered objects.
_ORDER_STATISTIC = 0.25
# Another surface: more than 10 % nearer or farther, on at least 40 % of the pixels. That finds 82 %
# of the depths wrong by more than 10 %; of those it flags 18 % are wrong, of the others 2 %.
# The flagged are not noisier but more often gross, so it is a flag and not a spread.
OTHER_LOG_GAP = math.log(1.1)
_OTHER_SHARE = 0.4
# More pixels than this say nothing more about one depth.
_MAX_PIXELS = 16384
# Where the search for the fullest window looks first: at one in so many pixels.
_STRIDE = 16


class DepthSample(NamedTuple):
    """
    The depth of one object.

    Attributes
    ----------
    value : float
        A value of the map, NaN where the object has no valid pixel.
    rel_std : float
        Relative spread of the surface it was taken from, NaN where there is none.
    mixed : bool
        True where another surface fills a good part of the pixels.
    """

    value: float
    rel_std: float
    mixed: bool


def sample_surface(
    values: AnyFloatArray,
    box: Box,
    *,
    kind: DepthKind,
    image_size: ImageSize,
    nearness: int,
    origin: float = 0.0,
    mask: BoolArray | None = None,
) -> DepthSample:
    """
    Sample the surface that a box outlines.

    Parameters
    ----------
    values : (H, W) ndarray of float
        The depth map.
    box : tuple of float
        Corners x1, y1, x2, y2 in pixels of the image.
    kind : str
        Kind of the depth values, which says which of them are valid.
    image_size : (width, height)
        Size of the image; the box is scaled from it to the map.
    nearness : int
        1 where larger values are nearer, -1 where they are farther.
    origin : float
        Value from which ratios of depths count; 0 but where a shift is unknown.
    mask : (image height, image width) ndarray of bool, optional
        The object's pixels; all of them inside the box are then used, not the core.

    Returns
    -------
    DepthSample
        NaN where no pixel is valid.
    """
    if mask is not None:
        on_object = pixels_on_mask(values, box, mask, image_size)
        if on_object.size:  # else it is thinner than a pixel of the map
            thin = on_object[:: max(1, on_object.size // _MAX_PIXELS)]
            return _dominant(_sorted_depths(thin, kind), nearness, origin)
    for share in (_CORE_SHARE, 1.0):  # the whole box only where the core has no depth at all
        window = values[map_window(values.shape, box, image_size, share)]
        seen = _sorted_depths(_thinned(window), kind)
        if seen.size:
            break
    return _dominant(seen, nearness, origin)


def map_window(
    shape: tuple[int, ...], box: Box, image_size: ImageSize, share: float = 1.0
) -> tuple[slice, slice]:
    """
    Find the pixels of a map whose centres lie in a box, or in its middle.

    Parameters
    ----------
    shape : tuple of int
        Shape (H, W) of the map.
    box : tuple of float
        Corners x1, y1, x2, y2 in pixels of the image.
    image_size : (width, height)
        Size of the image; the box is scaled from it to the map.
    share : float
        The central share of the box, each way, that counts.

    Returns
    -------
    rows, columns : slice
        At least one of each: of a box without a pixel's centre, the pixel that holds its own.
    """

    def span(low: float, high: float, size: int, length: int) -> tuple[int, int]:
        scale = length / size
        margin = (1 - share) / 2 * (high - low)
        first = math.ceil((low + margin) * scale - 0.5)
        last = math.ceil((high - margin) * scale - 0.5)
        if last <= first:  # smaller than a pixel of the map: the pixel that holds its centre
            first = math.floor((low + high) / 2 * scale)
            last = first + 1
        first = min(max(first, 0), length - 1)
        return first, max(min(last, length), first + 1)

    x1, y1, x2, y2 = box
    return slice(*span(y1, y2, image_size[1], shape[0])), slice(
        *span(x1, x2, image_size[0], shape[1])
    )


def pixels_on_mask(
    values: AnyFloatArray, box: Box, mask: BoolArray, image_size: ImageSize
) -> AnyFloatArray:
    """
    Collect the map's pixels whose centres lie on an object's mask, in its box.

    Parameters
    ----------
    values : (H, W) ndarray of float
        The map.
    box : tuple of float
        Corners x1, y1, x2, y2 in pixels of the image.
    mask : (image height, image width) ndarray of bool
        The object's pixels.
    image_size : (width, height)
        Size of the image.

    Returns
    -------
    (N,) ndarray of float
        Their values, in the order of rows.
    """
    rows, columns = map_window(values.shape, box, image_size)
    if mask.shape == values.shape:
        return values[rows, columns][mask[rows, columns]]
    row_centres = _centres(rows, image_size[1] / values.shape[0])
    column_centres = _centres(columns, image_size[0] / values.shape[1])
    return values[rows, columns][mask[np.ix_(row_centres, column_centres)]]


def _centres(span: slice, scale: float) -> IntArray:
    """Find the image's pixels that hold the centres of the map's."""
    indices: FloatArray = (np.arange(span.start, span.stop, dtype=np.float64) + 0.5) * scale
    return indices.astype(np.intp)


def _thinned(window: AnyFloatArray) -> AnyFloatArray:
    """Leave out rows and columns of a large window alike."""
    step = max(1, math.isqrt(window.size // _MAX_PIXELS))
    return window[::step, ::step]


def _sorted_depths(pixels: AnyFloatArray, kind: DepthKind) -> FloatArray:
    """Sort the pixels that are depths, in their own precision, which numpy sorts fastest."""
    ordered: AnyFloatArray = pixels.astype(pixels.dtype.newbyteorder("="), order="C").reshape(-1)
    ordered.sort()  # NaN last
    number = ordered.dtype.type
    floor = number(-math.inf if kind == "affine_inverse" else 0)
    first = int(ordered.searchsorted(floor, side="right"))
    return ordered[first : int(ordered.searchsorted(number(math.inf)))].astype(np.float64)


def _dominant(seen: FloatArray, nearness: int, origin: float) -> DepthSample:
    """Find the log-depth window that holds most pixels, the nearest of equals, and sample it."""
    if not seen.size:
        return DepthSample(math.nan, math.nan, mixed=False)
    log_depth: FloatArray = np.log(seen - origin)
    if nearness > 0:  # from near to far
        seen, log_depth = seen[::-1], np.ascontiguousarray(-log_depth[::-1])
    start, count = _fullest_window(log_depth)
    index = start + int(_ORDER_STATISTIC * (count - 1))
    away = log_depth - log_depth[index]
    nearer = int(away.searchsorted(-OTHER_LOG_GAP))
    farther = away.size - int(away.searchsorted(OTHER_LOG_GAP, side="right"))
    return DepthSample(
        value=float(seen[index]),
        rel_std=_spread(log_depth[start : start + count]),
        mixed=(nearer + farther) / away.size >= _OTHER_SHARE,
    )


def _fullest_window(log_depth: FloatArray) -> tuple[int, int]:
    """
    Find the first of the windows of one width that hold most of some sorted numbers.

    A window that begins at one of every few numbers holds fewer than so many less than the
    fullest. What is left is bisected, one comparison of all numbers a step: a search for the end
    of every window would take several times as long as all the rest.
    """
    size = log_depth.size
    limits: FloatArray = log_depth + SURFACE_LOG_WIDTH
    starts = np.arange(0, size, _STRIDE)
    least = int((log_depth.searchsorted(limits[::_STRIDE], side="right") - starts).max())
    most = min(least + _STRIDE - 1, size)
    while least < most:
        count = (least + most + 1) // 2
        if (log_depth[count - 1 :] <= limits[: size - count + 1]).any():
            least = count
        else:
            most = count - 1
    return int((log_depth[least - 1 :] <= limits[: size - least + 1]).argmax()), least


def _spread(numbers: FloatArray) -> float:
    """Compute their standard deviation as `np.std` does, with less around it."""
    off: FloatArray = numbers - np.add.reduce(numbers) / numbers.size
    off *= off
    return math.sqrt(np.add.reduce(off) / numbers.size)
