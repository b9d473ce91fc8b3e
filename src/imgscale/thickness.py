"""
From the depth of an object's centre to that of the near surface that its box outlines.

The box of an upright thing is the outline of its near face, so that k d p with the centre's depth
is too large, cars by 8 to 10 %. Half the extent along the view lies between the two. How far that
is depends on how the thing is turned, and the box shows it: seen end on a car is narrow and deep,
from the side wide and shallow.
"""

from __future__ import annotations

import numpy as np

from imgscale._typing import FloatArray

# Ground plans are rectangles, turned any way; the shorter side is a fifth of the longer one (a
# bus), as long (a chair) or anything between, all ratios alike. The visible width is known within
# 12 %, most of which is the height's own spread.
_TURNS = np.deg2rad(np.linspace(0.0, 90.0, 31))
_SLIMNESS = np.geomspace(0.2, 1.0, 15)
_WIDTH_STD = 0.12


def view_extent(visible_m: FloatArray, long_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """
    Estimate extents along the view from visible widths.

    Parameters
    ----------
    visible_m : (N,) ndarray of float
        Visible widths, in metres.
    long_m : (N,) ndarray of float
        Lengths of the ground plans' longer sides, in metres; NaN where they are not known.

    Returns
    -------
    extent_m, std_m : (N,) ndarray of float64
        Posterior mean and standard deviation of the extent.

    Notes
    -----
    A plan l x w turned by psi shows ``V = l sin + w cos`` and reaches ``E = l cos + w sin`` along
    the view. psi and log(w / l) are uniform; V is log-normal about the visible width. Where l is
    not known all sizes are alike, and E is V times the mean of E / V.
    """
    turn, slim = np.meshgrid(_TURNS, _SLIMNESS)
    shown = (np.sin(turn) + slim * np.cos(turn)).ravel()
    reach = (np.cos(turn) + slim * np.sin(turn)).ravel()
    unknown = np.isnan(long_m)
    miss = np.log((visible_m / np.where(unknown, 1.0, long_m))[:, None] / shown)
    log_weight = np.where(unknown[:, None], 0.0, -0.5 * (miss / _WIDTH_STD) ** 2)
    weight = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    longest = np.where(unknown[:, None], visible_m[:, None] / shown, long_m[:, None])
    extent = longest * reach
    mean = (weight * extent).sum(axis=1)
    variance = (weight * extent**2).sum(axis=1) - mean**2
    return mean, np.sqrt(np.maximum(variance, 0.0))


def surface_depth(
    centre_m: FloatArray, extent_m: FloatArray, extent_std_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """
    Move depths from centres to near surfaces.

    Parameters
    ----------
    centre_m : (N,) ndarray of float
        Z-depth of the centres, in metres; NaN where it is not known.
    extent_m, extent_std_m : (N,) ndarray of float
        Extent along the view and its standard deviation, in metres.

    Returns
    -------
    depth_m : (N,) ndarray of float64
        ``z - E / 2``; at least half of z.
    rel_std : (N,) ndarray of float64
        Its relative standard error from that of the extent.
    """
    depth_m: FloatArray = np.maximum(centre_m - extent_m / 2, centre_m / 2)
    return depth_m, extent_std_m / 2 / depth_m
