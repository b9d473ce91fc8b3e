"""Mixtures of Gaussians: what is known of a log size while several explanations are open."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from imgscale._typing import FloatArray

LARGEST_SCORE = 3.5
# Quantiles are kept at these standard scores. Those of a Gaussian lie on a straight line, so that
# linear interpolation between them is exact; of any other shape they keep tails and asymmetry.
SCORES: FloatArray = np.linspace(-LARGEST_SCORE, LARGEST_SCORE, 29)
MEDIAN = SCORES.size // 2
# The distribution is first evaluated at so many places, then closer where the mass is.
_ABSCISSAE = 49
_REACH = 4.5
# The lightest components are left out, all together less than this.
_NEGLIGIBLE = 3e-6
_MISSING = 1e-3
_SAFE = 1e-12
# More components than this are merged where they differ by less than 0.15 standard deviations in
# their means, and less than 19 % in these: quantiles move by 0.4 % of the width at most.
_MANY, _SAME_MEAN, _SAME_LOG_STD = 300, 0.15, 0.25 * math.log(2)
_OFF = 0.618


class Mixture(NamedTuple):
    """
    Weighted Gaussians, one row of them for each of M quantities.

    Attributes
    ----------
    weight : (M, C) ndarray of float64
        Weights, which sum to 1 in each row, or to less where the rest lies at infinity.
    mean, variance : (M, C) ndarray of float64
        Of each component; all NaN where nothing is known.
    """

    weight: FloatArray
    mean: FloatArray
    variance: FloatArray

    def quantiles(self) -> FloatArray:
        """
        Compute the quantiles at the standard scores `SCORES`.

        Returns
        -------
        (M, 29) ndarray of float64
            Increasing along each row; inf beyond the finite mass, NaN where nothing is known.
        """
        if self.weight.shape[1] == 1:
            return self.mean + np.sqrt(self.variance) * SCORES
        rows = [_quantiles(*row) for row in zip(self.weight, self.mean, self.variance, strict=True)]
        return np.array(rows, dtype=np.float64).reshape(-1, SCORES.size)


def half_width(quantiles: FloatArray) -> FloatArray:
    """
    Compute half the width of the central 68.3 %: for a Gaussian its standard deviation.

    Parameters
    ----------
    quantiles : (M, 29) ndarray of float
        Quantiles at `SCORES`.

    Returns
    -------
    (M,) ndarray of float64
        The half widths; inf where the upper end is.
    """
    one = int(np.searchsorted(SCORES, 1.0))
    low, high = quantiles[:, -1 - one], quantiles[:, one]
    return np.where(np.isposinf(high), np.inf, high - np.where(np.isposinf(low), 0.0, low)) / 2


def _merged(
    weight: FloatArray, mean: FloatArray, std: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Merge components that are nearly the same, keeping mean and variance."""
    # counted from the ends, and from no round number, so that shifted mixtures merge alike
    size = np.floor(np.log(std / std.max()) / _SAME_LOG_STD + _OFF)
    width = _SAME_MEAN * std.max() * np.exp(size * _SAME_LOG_STD)
    place = np.floor((mean - mean.min()) / width + _OFF)
    order = np.lexsort((place, size))
    new = (np.diff(size[order], prepend=np.nan) != 0) | (np.diff(place[order], prepend=np.nan) != 0)
    starts = np.flatnonzero(new)
    total = np.add.reduceat(weight[order], starts)
    middle = np.add.reduceat((weight * mean)[order], starts) / total
    group = np.cumsum(new) - 1
    spread = std[order] ** 2 + (mean[order] - middle[group]) ** 2
    variance = np.add.reduceat(weight[order] * spread, starts) / total
    return total, middle, np.sqrt(variance)


def _quantiles(weight: FloatArray, mean: FloatArray, variance: FloatArray) -> FloatArray:
    """Invert the cumulative distribution in standard scores, in which it is nearly straight."""
    from scipy import special  # noqa: PLC0415 - tens of milliseconds of import

    missing = 1 - float(weight.sum())
    order = np.argsort(weight)
    heavy = order[np.searchsorted(np.cumsum(weight[order]), _NEGLIGIBLE) :]
    weight, mean, std = weight[heavy], mean[heavy], np.sqrt(variance[heavy])
    if not mean.size or np.isnan(mean).any():
        return np.full(SCORES.size, np.nan)
    std = np.maximum(std, _SAFE * (1 + np.abs(mean)))
    if mean.size > _MANY:
        weight, mean, std = _merged(weight, mean, std)
    low, high = float((mean - _REACH * std).min()), float((mean + _REACH * std).max())
    at: FloatArray = np.linspace(low, high, _ABSCISSAE)
    wanted = np.linspace(-_REACH, _REACH, _ABSCISSAE)
    known: FloatArray = np.empty(0)
    scores: FloatArray = np.empty(0)
    for targets in (
        wanted,
        wanted,
        wanted,
        SCORES,
        SCORES,
    ):  # each looks closer where the mass was found
        below: FloatArray = weight @ special.ndtr((at - mean[:, None]) / std[:, None])
        order = np.argsort(np.concatenate([known, at]), kind="stable")
        known = np.concatenate([known, at])[order]
        new: FloatArray = special.ndtri(np.clip(below, _SAFE, 1 - _SAFE))
        scores = np.maximum.accumulate(np.concatenate([scores, new])[order])
        rising = np.concatenate([[True], np.diff(scores) > _SAFE])
        at = np.interp(targets, scores[rising], known[rising])
    found = at
    if missing > _MISSING:
        found = np.where(special.ndtr(SCORES) > 1 - missing, np.inf, found)
    return found
