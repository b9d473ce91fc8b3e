"""The depths of the pixels of one object: those of its surface, without what else is among them."""

from __future__ import annotations

from typing import Any

import numpy as np

from imgscale._typing import BoolArray, FloatArray

# One surface, as for the sampler: depths within 6 % of each other.
SURFACE_LOG_WIDTH = 0.06
# It goes on where the next 6 % of depth hold this share of what its fullest 6 % hold. With 20 % of
# background in the mask, 1.25 to 7 times as far, the areas of boards turned by 0 to 30 degrees err
# by 1.4 % at most; the pixels as they are give 8 to 880 % too much.
_GOES_ON = 0.1


def surface_distances(
    distance: FloatArray, mask: BoolArray, log_surface: float
) -> FloatArray | None:
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

    Returns
    -------
    (P,) ndarray of float64 or None
        One for each pixel of the mask: its own, or where that is not known or lies apart from the
        surface, that of the nearest pixel on it. None where there is no such pixel.
    """
    from scipy import ndimage  # noqa: PLC0415 - tens of milliseconds of import

    on_surface = mask & (distance > 0)
    on_surface[on_surface] = _goes_on(np.log(distance[on_surface]) - log_surface)
    if not on_surface.any():
        return None
    if on_surface[mask].all():
        return distance[mask]
    transform: Any = ndimage.distance_transform_edt
    nearest = transform(~on_surface, return_distances=False, return_indices=True)
    filled: FloatArray = distance[tuple(nearest)]
    return filled[mask]


def _goes_on(off: FloatArray) -> BoolArray:
    """Tell which log distances from a surface lie on it: those with no gap in between."""
    steps = np.round(off / SURFACE_LOG_WIDTH)
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
