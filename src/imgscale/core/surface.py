"""The depths of the pixels of one object: those of its surface, without what else is among them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from imgscale._typing import BoolArray, FloatArray

# A surface goes on where the next step of depth holds this share of what its fullest step holds.
# With 20 % of background in the mask, 1.25 to 7 times as far, and steps of 6 %, the areas of boards
# turned by 0 to 30 degrees err by 1.4 % at most; the pixels as they are give 8 to 880 % too much.
_GOES_ON = 0.1


class Surface(NamedTuple):
    """
    The depths of an object.

    Attributes
    ----------
    distance : (P,) ndarray of float64
        Distance of each of its pixels.
    share : float
        Share of the pixels with a depth that lie on its surface, above 0.
    """

    distance: FloatArray
    share: float


def surface_distances(
    distance: FloatArray, mask: BoolArray, log_surface: float, log_width: float
) -> Surface | None:
    """
    Take the distances of an object's pixels.

    Parameters
    ----------
    distance : (h, w) ndarray of float
        Distance of each pixel, NaN where it is not known.
    mask : (h, w) ndarray of bool
        The object's pixels.
    log_surface : float
        Log of a distance on its surface.
    log_width : float
        How far apart in log distance the pixels of one surface lie.

    Returns
    -------
    Surface or None
        For each pixel of the mask its own distance, or where that is not known or lies apart from
        the surface, that of the nearest pixel on it. None where there is no such pixel.
    """
    from scipy import ndimage  # noqa: PLC0415 - tens of milliseconds of import

    on_surface = mask & (distance > 0)
    known = on_surface.sum()
    off = np.log(distance[on_surface]) - log_surface
    on_surface[on_surface] = _goes_on(off, log_width)
    if not on_surface.any():
        return None
    share = float(on_surface.sum() / known)
    if on_surface[mask].all():
        return Surface(distance[mask], share)
    transform: Any = ndimage.distance_transform_edt
    nearest = transform(~on_surface, return_distances=False, return_indices=True)
    filled: FloatArray = distance[tuple(nearest)]
    return Surface(filled[mask], share)


def _goes_on(off: FloatArray, log_width: float) -> BoolArray:
    """Tell which log distances from a surface lie on it: those with no gap in between."""
    steps = np.round(off / log_width)
    numbers, counts = np.unique(steps, return_counts=True)
    seen = dict(zip(numbers.tolist(), counts.tolist(), strict=True))
    least = _GOES_ON * max(seen.get(step, 0) for step in (-1.0, 0.0, 1.0))
    nearest = farthest = 0.0
    while seen.get(nearest - 1, 0) > least:
        nearest -= 1
    while seen.get(farthest + 1, 0) > least:
        farthest += 1
    on_surface: BoolArray = (steps >= nearest) & (steps <= farthest)
    return on_surface
