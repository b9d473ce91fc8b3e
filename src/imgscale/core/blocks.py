"""
Robust estimates for many images of as many references each, side by side.

The arrays are (q, m): q references down, m images across. One image is a block of one column, a
batch is cut into blocks that fit into the processor's cache; see `imgscale.core.estimator`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from imgscale._typing import BoolArray, FloatArray, IntArray
from imgscale.core.ordering import column_medians, weighted_column_medians

# Tukey's biweight: 95 % as efficient as least squares where the noise is Gaussian.
TUKEY_C = 4.685
# Makes the median absolute deviation estimate a standard deviation.
_MAD_TO_STD = 1.4826
# Median absolute deviations, in standard errors, from which on the result is widened and from which
# on it is reported: two sound references reach them in 6 and 2 of 100 images, more in fewer.
_WIDEN_MAD = 2.0
_REPORT_MAD = 2.5
# The same for estimates that reject nothing: the root of chi-square over its degrees of freedom.
REPORT_SCATTER = 2.0
# Steps of all images side by side; the few that need more, as many as this, go on alone.
_SECANT_STEPS, _MAX_STEPS = 4, 200
# Re-weighting falls short by this where the noise is Gaussian.
_FIRST_GAIN = 1.15
# A step by the secant is at most five times that of re-weighting, later, between bounds, a hundred
# times; where the secant leads nowhere, three steps are made in one.
_CAREFUL, _BOLD = (0.2, 1.0), (0.01, 3.0)
# A step this small, in standard errors of log k, is the last: the next would be its square.
_LAST_STEP, _LAST_PLAIN_STEP = 1e-7, 1e-12
# Blocks with fewer columns sum their labels by counting, wider ones row by row.
_WIDE = 64


class Block(NamedTuple):
    """
    References of m images, q of each.

    Attributes
    ----------
    y : (q, m) ndarray of float64
        Log k as each reference alone gives it.
    variance : (q, m) ndarray of float64
        Variance of its own noise.
    tau : (q, m) ndarray of float64
        Standard deviation of its label's shared offset.
    group : (q, m) ndarray of int
        Label of each within its image; those of one label are neighbours.
    firm : (q, m) ndarray of bool or None
        Witnesses that are never rejected or widened; None where there are none.
    """

    y: FloatArray
    variance: FloatArray
    tau: FloatArray
    group: IntArray
    firm: BoolArray | None = None

    def columns(self, columns: IntArray) -> Block:
        """
        Take some images.

        Parameters
        ----------
        columns : (n,) ndarray of int
            Which.

        Returns
        -------
        Block
            The images.
        """
        firm = None if self.firm is None else self.firm[:, columns]
        parts: list[Any] = [*(column[:, columns] for column in self[:4]), firm]
        return Block(*parts)


class BlockFit(NamedTuple):
    """
    Estimates of log k for a block.

    Attributes
    ----------
    log_k, log_std : (m,) ndarray of float64
        The estimates and their standard errors.
    disagree : (m,) ndarray of bool
        True where the median absolute deviation exceeds 2.5 standard errors.
    trust, weight, share : (q, m) ndarray of float64
        As in `imgscale.core.segments.LogFit`.
    """

    log_k: FloatArray
    log_std: FloatArray
    disagree: BoolArray
    trust: FloatArray
    weight: FloatArray
    share: FloatArray


def fit_block(block: Block) -> BlockFit:
    """
    Estimate log k of every image of a block.

    Parameters
    ----------
    block : Block
        The references.

    Returns
    -------
    BlockFit
        The estimates; see `imgscale.core.estimator.fit_robust`.
    """
    seen = scatter(block)
    total, excess = seen.total, seen.excess
    if excess is not None:
        more = excess if block.firm is None else np.where(block.firm, 0.0, excess)
        block, total = block._replace(variance=block.variance + more), total + more
    groups = _Groups(block.group, block.tau**2)
    log_k = _Ascent(block, total, groups).climb(seen.centre)
    trust = trusted(block.y - log_k, total, block.firm)
    weight = trust / block.variance
    of_group = groups.total(weight.copy())
    reduced = groups.reduced / (1 + of_group * groups.square)
    information: FloatArray = np.add.reduce(of_group * reduced, axis=0)
    share = weight * groups.spread(reduced / information)
    by_group = of_group * reduced / information
    spread = np.add.reduce(share**2 * block.variance, axis=0)
    spread += np.add.reduce(by_group**2 * groups.square, axis=0)
    return BlockFit(log_k, np.sqrt(spread), seen.disagree, trust, weight, share)


def share_out(block: Block, log_k: FloatArray, share: FloatArray) -> BlockFit:
    """
    Complete an estimate in closed form, whose references are all believed.

    Parameters
    ----------
    block : Block
        The references.
    log_k : (m,) ndarray of float
        The estimate.
    share : (q, m) ndarray of float
        Share of each reference in it.

    Returns
    -------
    BlockFit
        Its error is the declared one or, where that is more, the scatter: the root of chi-square
        over q - 1. References disagree where that is twice their errors.
    """
    chi2: FloatArray = np.add.reduce(
        (block.y - log_k) ** 2 / (block.variance + block.tau**2), axis=0
    )
    scatter2 = np.maximum(chi2 / max(len(share) - 1, 1), 1.0)
    groups = _Groups(block.group, block.tau**2)
    by_group = groups.total(share.copy()) * groups.reduced
    spread = np.add.reduce(share**2 * block.variance, axis=0)
    spread += np.add.reduce(by_group**2 * groups.square, axis=0)
    return BlockFit(
        log_k=log_k,
        log_std=np.sqrt(scatter2 * spread),
        disagree=scatter2 > REPORT_SCATTER**2,
        trust=np.ones_like(share),
        weight=1 / block.variance,
        share=share,
    )


def trusted(residual: FloatArray, variance: FloatArray, firm: BoolArray | None) -> FloatArray:
    """
    Weigh residuals by Tukey's biweight.

    Parameters
    ----------
    residual : (q, m) ndarray of float
        Observed minus estimated log k.
    variance : (q, m) ndarray of float
        Its variance.
    firm : (q, m) ndarray of bool or None
        Witnesses that are always believed.

    Returns
    -------
    (q, m) ndarray of float64
        ``(1 - r^2 / (4.685^2 v))^2``, 0 beyond 4.685 standard errors.
    """
    inside = np.maximum(1 - residual**2 / (TUKEY_C**2 * variance), 0.0)
    trust: FloatArray = inside * inside
    return trust if firm is None else np.where(firm, 1.0, trust)


class Scatter(NamedTuple):
    """
    How far the references of a block are apart.

    Attributes
    ----------
    centre : (m,) ndarray of float64
        Weighted median of each image.
    total : (q, m) ndarray of float64
        Variance of each reference with that of its label's offset.
    excess : (m,) ndarray of float64 or None
        Variance, common to an image's references, beyond their errors:
        ``M^2 (1 - (2 / m)^2)`` where m, the median absolute deviation in standard errors, exceeds
        2; M is that of the logarithms. None where no image has one.
    disagree : (m,) ndarray of bool
        True where m exceeds 2.5.
    """

    centre: FloatArray
    total: FloatArray
    excess: FloatArray | None
    disagree: BoolArray


def scatter(block: Block) -> Scatter:
    """
    Measure how far the references are apart.

    Parameters
    ----------
    block : Block
        The references.

    Returns
    -------
    Scatter
        One column for each image.
    """
    total = block.variance + block.tau**2
    centre = weighted_column_medians(block.y, 1 / total)
    deviation = np.abs(block.y - centre)
    relative = _MAD_TO_STD * column_medians(deviation / np.sqrt(total))
    beyond = relative > _WIDEN_MAD
    if not beyond.any():
        return Scatter(centre, total, None, beyond)
    wide = np.flatnonzero(beyond)
    raw = _MAD_TO_STD * column_medians(deviation[:, wide])
    excess = np.zeros(centre.size)
    excess[wide] = raw**2 * (1 - (_WIDEN_MAD / relative[wide]) ** 2)
    return Scatter(centre, total, excess, relative > _REPORT_MAD)


class _Groups:
    """The labels of a block, for sums over the references of one label."""

    def __init__(self, group: IntArray, square: FloatArray) -> None:
        size, width = group.shape
        same = group[1:] == group[:-1]
        self.alone = not same.any()
        self.narrow = width < _WIDE
        # 1 where a label's total stands, 0 elsewhere
        self.reduced: FloatArray | float = 1.0
        self.square = square
        if self.alone:
            return
        if self.narrow:
            slot: IntArray = np.zeros(group.shape, dtype=np.intp)
            slot[1:] = np.cumsum(~same, axis=0)
            place = slot * width + np.arange(width, dtype=np.intp)
            self._place = place.ravel()
            self.square = np.zeros(group.shape)
            self.square.ravel()[self._place] = square.ravel()
            return
        self.reduced = np.ones(group.shape)
        np.subtract(1.0, same, out=self.reduced[:-1])
        self._same = same.astype(np.float64)
        self._joined = [row for row in range(size - 1) if same[row].any()]

    def total(self, rows: FloatArray) -> FloatArray:
        """
        Sum over each label.

        Parameters
        ----------
        rows : (q, m) ndarray of float
            What to sum; it may be overwritten.

        Returns
        -------
        (q, m) ndarray of float64
            The sums, where `reduced` is not 0; parts of sums elsewhere.
        """
        if self.alone:
            return rows
        if self.narrow:
            total = np.bincount(self._place, rows.ravel(), rows.size)
            return np.asarray(total, dtype=np.float64).reshape(rows.shape)
        for row in self._joined:
            rows[row + 1] += self._same[row] * rows[row]
        return rows

    def spread(self, totals: FloatArray) -> FloatArray:
        """
        Tell every reference what stands at its label's total.

        Parameters
        ----------
        totals : (q, m) ndarray of float
            What to tell, 0 where no total stands; it may be overwritten.

        Returns
        -------
        (q, m) ndarray of float64
            One value for each reference.
        """
        if self.alone:
            return totals
        if self.narrow:
            spread: FloatArray = totals.ravel()[self._place].reshape(totals.shape)
            return spread
        for row in reversed(self._joined):
            totals[row] += self._same[row] * totals[row + 1]
        return totals


def _middle(lower: FloatArray, upper: FloatArray, other: FloatArray) -> FloatArray:
    """Middle of bounds; where one of them is not known, another value."""
    known = np.isfinite(lower) & np.isfinite(upper)
    return np.where(known, np.where(known, lower, 0.0) / 2 + np.where(known, upper, 0.0) / 2, other)


def _next_step(
    step: FloatArray,
    before: FloatArray,
    gradient: FloatArray,
    curvature: FloatArray,
    flattest: float,
    gain: float,
) -> tuple[FloatArray, BoolArray]:
    """Step by the secant or, where that is too flat, by re-weighting; and if it is the last."""
    change = (before - gradient) * step
    sound = change > flattest * curvature * step**2
    nowhere = curvature == 0
    plain = gain * gradient / np.where(nowhere, 1.0, curvature)
    new = np.where(sound, gradient / np.where(sound, change, 1.0) * step**2, plain)
    limit = np.where(sound, _LAST_STEP, _LAST_PLAIN_STEP)
    is_last = np.abs(new) * np.sqrt(curvature) <= limit
    if nowhere.any():  # no reference counts there: half of the way back
        new, is_last = np.where(nowhere, -step / 2, new), is_last & ~nowhere
    return new, is_last


class _Ascent:
    """Re-weighted least squares, accelerated by the secant method."""

    def __init__(self, block: Block, total: FloatArray, groups: _Groups) -> None:
        self.block, self.total, self.groups = block, total, groups
        self.precision = 1 / block.variance
        self.cut = 1 / (TUKEY_C**2 * total)
        self._residual, self._weight, self._reduced = (np.empty_like(total) for _ in range(3))

    def climb(self, start: FloatArray) -> FloatArray:
        """
        Follow the gradient to where it vanishes; the few images that need more steps alone.

        Parameters
        ----------
        start : (m,) ndarray of float
            Log k to start at.

        Returns
        -------
        (m,) ndarray of float64
            Log k.
        """
        log_k, is_last = start, np.zeros(start.shape, dtype=np.bool_)
        gradient, curvature = self._slope(log_k)
        step = _FIRST_GAIN * gradient / curvature
        for _ in range(_SECANT_STEPS):
            log_k = log_k + step
            before = gradient
            gradient, curvature = self._slope(log_k)
            step, is_last = _next_step(step, before, gradient, curvature, *_CAREFUL)
            if is_last.all():
                return log_k + step
        rest = np.flatnonzero(~is_last)
        log_k = log_k + step
        log_k[rest] = self._columns(rest).enclose(log_k[rest], step[rest], gradient[rest])
        return log_k

    def enclose(self, log_k: FloatArray, step: FloatArray, before: FloatArray) -> FloatArray:
        """
        Go on between the last places where the gradient led upwards and downwards.

        Parameters
        ----------
        log_k : (m,) ndarray of float
            Where the last step led.
        step, before : (m,) ndarray of float
            That step, and the gradient before it.

        Returns
        -------
        (m,) ndarray of float64
            Log k.
        """
        lower = np.where(before > 0, log_k - step, -np.inf)
        upper = np.where(before < 0, log_k - step, np.inf)
        for _ in range(_MAX_STEPS):
            gradient, curvature = self._slope(log_k)
            lower = np.where(gradient > 0, log_k, lower)
            upper = np.where(gradient < 0, log_k, upper)
            step, is_last = _next_step(step, before, gradient, curvature, *_BOLD)
            new = log_k + step
            outside = ((new < lower) | (new > upper)) & ~is_last
            if outside.any():
                step = np.where(outside, _middle(lower, upper, new) - log_k, step)
            if is_last.all():
                break
            log_k, before = log_k + step, gradient
            if 4 * np.count_nonzero(~is_last) < is_last.size:
                rest = np.flatnonzero(~is_last)
                part = self._columns(rest)
                log_k[rest] = part.enclose(log_k[rest], step[rest], gradient[rest])
                return log_k
        return log_k + step

    def _columns(self, columns: IntArray) -> _Ascent:
        block = self.block.columns(columns)
        groups = _Groups(block.group, block.tau**2)
        return _Ascent(block, self.total[:, columns], groups)

    def _slope(self, log_k: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gradient by log k, and the curvature that re-weighting takes for it."""
        residual, weight, reduced = self._residual, self._weight, self._reduced
        np.subtract(self.block.y, log_k, out=residual)
        np.multiply(residual, residual, out=weight)
        np.multiply(weight, self.cut, out=weight)
        np.subtract(1.0, weight, out=weight)
        np.maximum(weight, 0.0, out=weight)
        if self.block.firm is not None:
            weight[self.block.firm] = 1.0
        np.multiply(weight, weight, out=weight)
        np.multiply(weight, self.precision, out=weight)
        np.multiply(residual, weight, out=residual)
        groups = self.groups
        of_group = groups.total(weight)
        np.multiply(of_group, groups.square, out=reduced)
        np.add(reduced, 1.0, out=reduced)
        np.divide(groups.reduced, reduced, out=reduced)
        np.multiply(of_group, reduced, out=of_group)
        curvature: FloatArray = np.add.reduce(of_group, axis=0)
        pull = groups.total(residual)
        np.multiply(pull, reduced, out=pull)
        gradient: FloatArray = np.add.reduce(pull, axis=0)
        return gradient, curvature
