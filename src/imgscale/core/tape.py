"""
The distance of two points in space: a tape measure held between two pixels.

A point at the pixel (x, y), counted from the principal point, with the distance d of the law lies
at ``k d (x, y, f)``, f being the focal length (the pinhole camera: R. Hartley and A. Zisserman,
Multiple View Geometry, 2nd ed. 2004, section 6.1). With the ranges r = d |(x, y, f)| of two points
and the angle T between their rays the length is

    L = 2 k sqrt(r1 r2) sqrt(sinh^2 z + sin^2(T / 2)),    z = log(r1 / r2) / 2,

the law of cosines. Errors e1, e2 of the log depths move it by (e1 + e2) / 2 as a whole and z by
(e1 - e2) / 2. Where z is smaller than its error nothing but noise is seen of it: |z| is then taken
for normal about its observed value with what falls below 0 put at 0, and so is the separation of
the pixels. An interval of L so made holds a true z of 0 and a true z of several errors alike,
which neither a log-normal nor a flat prior of the two points does.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from imgscale._typing import BoolArray, FloatArray, IntArray
from imgscale.core.mixture import SCORES, Mixture

# As many points, evenly spread over all that is not known, stand for its distribution.
_POINTS = 4096
# Additive recurrences of the generalised golden ratio of three dimensions are evenly spread.
_RATIO = 1.2207440846057594
_LEAST_STEP = 1e-4
# An error of z below this is none.
_LEAST_STD = 1e-12


class Ends(NamedTuple):
    """
    Two points of a picture, under K cases of what is not known of their depths.

    Attributes
    ----------
    xy : (2, 2) ndarray of float64
        Column and row of each, in pixels from the principal point.
    log_distance : (K, 2) ndarray of float64
        Log of d, the metres per pixel for k = 1; inf where there is no finite one.
    own_var : (K, 2) ndarray of float64
        Variances of the errors of the log depths that each point has for itself.
    common_var : (K,) ndarray of float64
        Variance of the error that both share.
    separation_var : float
        Variance of the separation of the two pixels, in square pixels.
    """

    xy: FloatArray
    log_distance: FloatArray
    own_var: FloatArray
    common_var: FloatArray
    separation_var: float

    @property
    def separation(self) -> float:
        """Separation of the two pixels."""
        return math.dist(self.xy[0], self.xy[1])


class Lens(NamedTuple):
    """
    What is known of the focal length f: ``log f = log_focal + by_scale * log k + s``.

    With metric depth f k d is the depth itself, whose scale errs by s.

    Attributes
    ----------
    log_focal : (K,) ndarray of float64
        The part that does not hang on k, for each case; inf where all is at one depth, and f is not
        needed.
    by_scale : float
        The part that does: 0, or with metric depth between -1 and 0.
    std : float
        Standard deviation of s.
    undone : bool
        True where s is an error of the map that k was fitted to, and not of the map of the points.
    """

    log_focal: FloatArray
    by_scale: float = 0.0
    std: float = 0.0
    undone: bool = False


def log_length(
    log_k: FloatArray, log_distance: FloatArray, xy: FloatArray, log_focal: FloatArray
) -> FloatArray:
    """
    Compute the log of the distance of two points.

    Parameters
    ----------
    log_k : (N,) ndarray of float
        Log of the scale constant.
    log_distance : (N, 2) ndarray of float
        Log of d of both points.
    xy : (N, 2, 2) ndarray of float
        Their columns and rows, from the principal point.
    log_focal : (N,) ndarray of float
        Log of the focal length; inf where both are at one depth.

    Returns
    -------
    (N,) ndarray of float64
        Log of the distance in metres: -inf where the points are one, inf where one has no finite
        distance.
    """
    log_size, gap, square = _seen(log_distance, xy, log_focal)
    return log_k + log_size + _log_chord(gap, square)


def length_quantiles(scale: Mixture, ends: Ends, lens: Lens) -> FloatArray:
    """
    Compute the quantiles of the distance of two points at the standard scores `SCORES`.

    Parameters
    ----------
    scale : Mixture
        Log k under each of K cases, with joint weights.
    ends : Ends
        The points.
    lens : Lens
        The focal length.

    Returns
    -------
    (29,) ndarray of float64
        In metres, from 0 to inf. As far as a truth of z = 0 is not excluded at a quantile's
        probability, the quantile is that of the length at z = 0.
    """
    from scipy import special  # noqa: PLC0415 - tens of milliseconds of import

    drawn, scores = _drawn(scale, ends, lens), _scores()
    quantiles = _found(drawn, ends, lens, scores, scores[:, 2])
    gap: FloatArray = np.abs(_look(drawn, drawn.log_k, ends.xy)[1])
    score: FloatArray = gap / np.maximum(drawn.gap_std, _LEAST_STD)
    none: FloatArray = 2 * special.ndtr(-score)  # as large a |z| where the truth is 0
    may_be_none: BoolArray = special.ndtr(SCORES) < float(none.mean())
    if may_be_none.any():
        across = _found(drawn, ends, lens, scores, None)
        quantiles = np.where(may_be_none, np.minimum(across, quantiles), quantiles)
    return quantiles


class _Drawn(NamedTuple):
    """Points of what is known of k, and of two points in space under their cases."""

    log_k: FloatArray
    log_k_var: FloatArray
    log_distance: FloatArray
    own_var: FloatArray
    common_var: FloatArray
    log_focal: FloatArray
    by_scale: float

    @property
    def gap_std(self) -> FloatArray:
        """Standard deviation of z; 0 where it is not looked at."""
        return np.where(np.isinf(self.log_focal), 0.0, np.sqrt(self.own_var.sum(axis=1)) / 2)


def _look(
    drawn: _Drawn, log_k: FloatArray, xy: FloatArray, off: FloatArray | float = 0.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """See the points with another k, other pixels, another focal length."""
    log_focal = drawn.log_focal + drawn.by_scale * log_k + off
    return _seen(drawn.log_distance, np.broadcast_to(xy, (log_k.size, 2, 2)), log_focal)


def _drawn(scale: Mixture, ends: Ends, lens: Lens) -> _Drawn:
    """Draw components of log k by their weights, at even steps."""
    total: FloatArray = np.cumsum(scale.weight.ravel())
    steps: FloatArray = (np.arange(_POINTS, dtype=np.float64) + 0.5) / _POINTS * total[-1]
    found: IntArray = np.searchsorted(total, steps, side="right")
    chosen: IntArray = np.minimum(found, total.size - 1)
    case: IntArray = chosen // scale.weight.shape[1]
    return _Drawn(
        log_k=scale.mean.ravel()[chosen],
        log_k_var=scale.variance.ravel()[chosen],
        log_distance=ends.log_distance[case],
        own_var=ends.own_var[case],
        common_var=ends.common_var[case],
        log_focal=lens.log_focal[case],
        by_scale=lens.by_scale,
    )


def _found(
    drawn: _Drawn, ends: Ends, lens: Lens, scores: FloatArray, of_gap: FloatArray | None
) -> FloatArray:
    """Quantiles of the length with z moved by its error or, without scores of that, to 0."""
    off, xy = lens.std * scores[:, 0], _moved(ends, scores[:, 1])
    total: FloatArray = drawn.own_var.sum(axis=1)
    # unequal errors: what moves z moves the whole as well
    skew = (drawn.own_var[:, 0] - drawn.own_var[:, 1]) / np.where(total > 0, total, 1.0)

    def log_length_at(log_k: FloatArray) -> FloatArray:
        log_size, gap, square = _look(drawn, log_k, xy, off)
        error = -np.abs(gap) if of_gap is None else drawn.gap_std * of_gap
        moved = np.maximum(np.abs(gap) + error, 0.0)
        return log_k + log_size + _log_chord(moved, square) + np.sign(gap) * skew * error

    step = np.maximum(np.sqrt(drawn.log_k_var), _LEAST_STEP)
    rise = _difference(log_length_at(drawn.log_k + step), log_length_at(drawn.log_k - step))
    one_depth = np.isinf(drawn.log_focal)
    shared: FloatArray = np.where(one_depth, total / 2, (1 - skew**2) * total / 4)
    variance = (rise / (2 * step)) ** 2 * drawn.log_k_var + shared + drawn.common_var
    return _quantiles(log_length_at(drawn.log_k) - off * lens.undone, variance)


def _seen(
    log_distance: FloatArray, xy: FloatArray, log_focal: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Log of twice the mean range for k = 1, z, and the square of the sine of half the angle."""
    flat = np.isinf(log_focal)
    focal = np.exp(np.where(flat, 0.0, log_focal))
    rays = np.concatenate([xy, np.broadcast_to(focal[:, None, None], (*xy.shape[:2], 1))], axis=2)
    norm = np.sqrt((rays**2).sum(axis=2))
    log_range = log_distance + np.log(norm)
    unit = rays / norm[..., None]
    turn: FloatArray = ((unit[:, 0] - unit[:, 1]) ** 2).sum(axis=1) / 4
    with np.errstate(invalid="ignore"):  # two points beyond the horizon
        gap = (log_range[:, 0] - log_range[:, 1]) / 2
    # at one depth the length is k d times the separation of the pixels
    level: FloatArray = np.where(flat[:, None], log_distance, log_range).mean(axis=1)
    square: FloatArray = np.where(flat, ((xy[:, 0] - xy[:, 1]) ** 2).sum(axis=1) / 4, turn)
    gap = np.where(flat | ~np.isfinite(gap), 0.0, gap)
    return math.log(2) + level, gap, square


def _log_chord(gap: FloatArray, square: FloatArray) -> FloatArray:
    """Log of sqrt(sinh^2 z + sin^2(T / 2)); -inf where both are 0."""
    with np.errstate(divide="ignore", over="ignore"):
        return np.asarray(0.5 * np.log(np.sinh(gap) ** 2 + square), dtype=np.float64)


def _difference(first: FloatArray, second: FloatArray) -> FloatArray:
    """First minus second, 0 where neither is finite."""
    finite = np.isfinite(first) & np.isfinite(second)
    return np.where(finite, first, 0.0) - np.where(finite, second, 0.0)


def _scores() -> FloatArray:
    """Spread standard scores evenly in three dimensions."""
    from scipy import special  # noqa: PLC0415 - tens of milliseconds of import

    step = _RATIO ** -np.arange(1.0, 4.0)
    scores: FloatArray = special.ndtri((0.5 + step * np.arange(1, _POINTS + 1)[:, None]) % 1)
    return scores


def _moved(ends: Ends, scores: FloatArray) -> FloatArray:
    """Move the pixels apart and together by the error of their separation."""
    seen, var = ends.separation, ends.separation_var
    if seen == 0:
        return np.broadcast_to(ends.xy, (scores.size, 2, 2))
    # an error across makes them seem farther apart than they are
    middle = math.sqrt(max(seen**2 - var, 0.0))
    share = np.maximum(middle + math.sqrt(var) * scores, 0.0) / seen
    centre: FloatArray = ends.xy.mean(axis=0)
    moved: FloatArray = centre + share[:, None, None] * (ends.xy - centre)
    return moved


def _quantiles(log_mean: FloatArray, variance: FloatArray) -> FloatArray:
    """Quantiles of a mixture of equal weights, some of whose logs may lie at either infinity."""
    from scipy import special  # noqa: PLC0415 - tens of milliseconds of import

    none: BoolArray = np.isneginf(log_mean)
    lost: BoolArray = np.isposinf(log_mean)
    nothing, rest = float(none.mean()), ~none
    if not rest.any():
        return np.zeros(SCORES.size)
    finite = np.where(lost, 0.0, log_mean)[rest]
    weight = np.where(lost[rest], 0.0, 1 / rest.sum())
    if lost[rest].all():
        quantiles = np.full(SCORES.size, np.inf)
    else:
        quantiles = Mixture(weight[None], finite[None], variance[rest][None]).quantiles()[0]
    if nothing:
        above = np.maximum((special.ndtr(SCORES) - nothing) / (1 - nothing), 0.0)
        quantiles = _read_at(quantiles, np.asarray(special.ndtri(above)))
    with np.errstate(over="ignore"):
        found: FloatArray = np.exp(quantiles)
    return found


def _read_at(quantiles: FloatArray, scores: FloatArray) -> FloatArray:
    """Read quantiles of logs at other scores; -inf below all."""
    finite = np.isfinite(quantiles)
    if not finite.any():
        return np.where(np.isneginf(scores), -np.inf, np.inf)
    inside = np.interp(scores, SCORES[finite], quantiles[finite])
    inside = np.where(scores > SCORES[finite][-1], quantiles[-1], inside)
    return np.where(np.isneginf(scores), -np.inf, inside)
