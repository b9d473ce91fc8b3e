"""Mixtures of Gaussians: what is known of a log size while several explanations are open."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from imgscale._typing import BoolArray, FloatArray, IntArray

LARGEST_SCORE = 3.5
# Quantiles are kept at these standard scores. Those of a Gaussian lie on a straight line, so that
# linear interpolation between them is exact; of any other shape they keep tails and asymmetry.
SCORES: FloatArray = np.linspace(-LARGEST_SCORE, LARGEST_SCORE, 29)
MEDIAN = SCORES.size // 2
_ONE = np.array([-1.0, 1.0])
_FARTHEST = 4.5


def _normal(scores: FloatArray) -> FloatArray:
    """Probability below standard scores."""
    return np.array([math.erfc(-score / math.sqrt(2)) / 2 for score in scores.tolist()])


# A component counts first as atoms at these scores, which reach beyond `SCORES`. Half of what is
# between two of them belongs to either, and the tails to the outermost.
_ATOMS: FloatArray = np.arange(-4.0, 4.5)
_HALVES, _TAIL = np.diff(_normal(_ATOMS)) / 2, _normal(_ATOMS[:1])
_AFTER: FloatArray = np.concatenate([_HALVES, _TAIL])
_MASS: FloatArray = np.concatenate([_TAIL, _HALVES]) + _AFTER
# Rows are looked up at once, each so much higher than the one before, on a lattice so fine: no sum
# of the two is rounded, and no row depends on its place.
_ROW, _LATTICE = 32.0, 2.0**20
# One more step, which cubes the error, is enough for scores that are off by less.
_CLOSE = 1e-3
_EXACT, _ROUNDING = 1e-9, 1e-15
# Those that need more than two steps take no more than these, which halve their bracket at least.
_AT_MOST = 100
# Rows are solved so many at once that their arrays stay in the processor's cache.
_CELLS = 32_768
_COMPONENTS = 262_144
# The lightest of many components are left out, all together less than this.
_FEW, _NEGLIGIBLE = 8, 3e-6
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

    def quantiles(self, scores: FloatArray = SCORES) -> FloatArray:
        """
        Compute quantiles.

        Parameters
        ----------
        scores : (S,) ndarray of float
            The standard scores, increasing, at which they are wanted.

        Returns
        -------
        (M, S) ndarray of float64
            Increasing along each row; inf beyond the finite mass, NaN where nothing is known.
        """
        if self.weight.shape[1] == 1:
            return self.mean + np.sqrt(self.variance) * scores
        found = np.empty((len(self.weight), scores.size))
        rows = max(1, _COMPONENTS // max(1, self.weight.shape[1]))
        for start in range(0, len(found), rows):
            some = slice(start, start + rows)
            found[some] = _quantiles(
                self.weight[some], self.mean[some], self.variance[some], scores
            )
        return found

    def half_width(self) -> FloatArray:
        """
        Compute half the width of the central 68.3 %: for a Gaussian its standard deviation.

        Returns
        -------
        (M,) ndarray of float64
            The half widths; inf where the upper end is.
        """
        return half_between(*self.quantiles(_ONE).T)


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
    return half_between(quantiles[:, -1 - one], quantiles[:, one])


def half_between(low: FloatArray, high: FloatArray) -> FloatArray:
    """
    Compute half the width of an interval that may be open.

    Parameters
    ----------
    low, high : (M,) ndarray of float
        The ends.

    Returns
    -------
    (M,) ndarray of float64
        The half widths; inf where the upper end is.
    """
    return np.where(np.isposinf(high), np.inf, high - np.where(np.isposinf(low), 0.0, low)) / 2


def _merged(
    weight: FloatArray, mean: FloatArray, std: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Merge components that are nearly the same, keeping mean and variance."""
    weight, mean, std = (column[weight > 0] for column in (weight, mean, std))
    # counted from the middle, so that neither shifts nor the lightest components matter
    centre = (weight * mean).sum() / weight.sum()
    size = np.floor(np.log(std / std.max()) / _SAME_LOG_STD + _OFF)
    width = _SAME_MEAN * std.max() * np.exp(size * _SAME_LOG_STD)
    place = np.floor((mean - centre) / width + _OFF)
    order = np.lexsort((place, size))
    new = (np.diff(size[order], prepend=np.nan) != 0) | (np.diff(place[order], prepend=np.nan) != 0)
    starts = np.flatnonzero(new)
    total = np.add.reduceat(weight[order], starts)
    middle = np.add.reduceat((weight * mean)[order], starts) / total
    group = np.cumsum(new) - 1
    spread = std[order] ** 2 + (mean[order] - middle[group]) ** 2
    variance = np.add.reduceat(weight[order] * spread, starts) / total
    return total, middle, np.sqrt(variance)


class _Components(NamedTuple):
    """
    Components of R rows, ready to be evaluated at many places.

    Attributes
    ----------
    weight, mean, per_std, height : (C, R, 1) or (C, E) ndarray of float64
        Weight, mean, 1 / standard deviation, and weight / standard deviation.
    """

    weight: FloatArray
    mean: FloatArray
    per_std: FloatArray
    height: FloatArray


def _quantiles(
    weight: FloatArray, mean: FloatArray, variance: FloatArray, scores: FloatArray
) -> FloatArray:
    """Quantiles of rows that may be unknown, or have mass at infinity."""
    unknown = np.isnan(mean + variance)
    total = weight.sum(axis=1)
    if unknown.any() or not total.min(initial=1.0) > _NEGLIGIBLE:
        known: BoolArray = np.where(unknown, 0.0, weight).sum(axis=1) > _NEGLIGIBLE
        known &= ~(np.where(unknown, weight, 0.0).sum(axis=1) > _NEGLIGIBLE)
        parts = [np.where(unknown, 0.0, part)[known] for part in (weight, mean, variance)]
        found = np.full((len(weight), scores.size), np.nan)
        if known.any():
            found[known] = _quantiles(parts[0], parts[1], parts[2], scores)
        return found
    std = np.maximum(np.sqrt(variance), _SAFE * (1 + np.abs(mean)))
    found = _of_mixed(weight, mean, std, total, scores)
    missing = 1 - total[:, None]
    if missing.max(initial=0.0) > _MISSING:
        found[(missing > _MISSING) & (1 - missing < _normal(scores))] = np.inf
    return found


def _of_mixed(
    weight: FloatArray, mean: FloatArray, std: FloatArray, total: FloatArray, scores: FloatArray
) -> FloatArray:
    """Quantiles of rows, of those that are one Gaussian in closed form."""
    solve = _in_blocks if mean.shape[1] <= _FEW else _of_many
    mixed = weight.max(axis=1) < np.maximum(total, 1.0) - _EXACT
    if mixed.all():
        return solve(weight, mean, std, scores)
    row = np.arange(len(weight))
    alone = weight.argmax(axis=1)
    found = mean[row, alone, None] + std[row, alone, None] * scores
    if mixed.any():
        found[mixed] = solve(weight[mixed], mean[mixed], std[mixed], scores)
    return found


def _of_many(
    weight: FloatArray, mean: FloatArray, std: FloatArray, scores: FloatArray
) -> FloatArray:
    """Quantiles of rows of many components: of the heavy ones, merged where these are many too."""
    count, weight, mean, std = _heaviest(weight, mean, std)
    found = np.empty((len(weight), scores.size))
    rows = np.flatnonzero(count <= _MANY)
    if rows.size:
        width = int(count[rows].max())
        parts = [part[rows, -width:] for part in (weight, mean, std)]
        found[rows] = _in_blocks(parts[0], parts[1], parts[2], scores)
    for row in np.flatnonzero(count > _MANY).tolist():
        kept = slice(-int(count[row]), None)
        merged = _merged(weight[row, kept], mean[row, kept], std[row, kept])
        few, middle, width_of = (part[None] for part in merged)
        found[row] = _in_blocks(few, middle, width_of, scores)[0]
    return found


def _heaviest(
    weight: FloatArray, mean: FloatArray, std: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Leave the lightest components out: how many are left, at the end of each row."""
    row = np.arange(len(weight))[:, None]
    # single precision, so that rounding does not decide between equals
    order = np.argsort(weight.astype(np.float32), axis=1, kind="stable")
    weight = weight[row, order]
    upto = np.cumsum(weight, axis=1)
    heavy = upto > _NEGLIGIBLE
    weight = np.where(heavy, weight, 0.0)
    weight *= upto[:, -1:] / np.cumsum(weight, axis=1)[:, -1:]
    count = heavy.sum(axis=1)
    order = order[:, -int(count.max(initial=1)) :]
    return count, weight[:, -order.shape[1] :], mean[row, order], std[row, order]


def _in_blocks(
    weight: FloatArray, mean: FloatArray, std: FloatArray, scores: FloatArray
) -> FloatArray:
    """Quantiles of rows, so many at once as the cache holds."""
    size = max(1, _CELLS // (scores.size * weight.shape[1]))
    if len(weight) <= size:
        return _inverted(weight, mean, std, scores)
    found = np.empty((len(weight), scores.size))
    for start in range(0, len(found), size):
        some = slice(start, start + size)
        found[some] = _inverted(weight[some], mean[some], std[some], scores)
    return found


def _inverted(
    weight: FloatArray, mean: FloatArray, std: FloatArray, scores: FloatArray
) -> FloatArray:
    """Invert the cumulative distribution in standard scores, in which it is nearly straight."""
    with np.errstate(all="ignore"):
        parts = _Components(*(part.T[:, :, None] for part in (weight, mean, 1 / std, weight / std)))
        low, high = _bracket(weight, mean, std, scores)
        at = np.minimum(np.maximum(_start(weight, mean, std, scores), low), high)
        # two steps for all, that no row depends on the others
        at, _ = _step(at, low, high, scores, parts)
        at, is_found = _step(at, low, high, scores, parts)
        if is_found.all():
            return np.maximum.accumulate(at, axis=1)
        row, column = np.nonzero(~is_found)
        x, below, above = at[row, column], low[row, column], high[row, column]
        for _ in range(_AT_MOST):
            x, is_found = _step(x, below, above, scores[column], _of_rows(parts, row))
            at[row, column] = x
            left = np.flatnonzero(~is_found)
            if not left.size:
                break
            row, column = row[left], column[left]
            x, below, above = x[left], below[left], above[left]
    return np.maximum.accumulate(at, axis=1)


def _of_rows(parts: _Components, rows: IntArray) -> _Components:
    """Take the components of some rows, which may be repeated."""
    return _Components(*(part[:, rows, 0] for part in parts))


def _bracket(
    weight: FloatArray, mean: FloatArray, std: FloatArray, wanted: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Quantiles of a mixture lie among those of its components, if it lacks no mass."""
    ends = mean[:, :, None] + std[:, :, None] * wanted
    lacks = weight.sum(axis=1) < 1 - _EXACT
    nothing = weight == 0
    if not (lacks.any() or nothing.any()):
        return ends.min(axis=1), ends.max(axis=1)
    high = np.where(nothing[:, :, None], -np.inf, ends).max(axis=1)
    top = np.where(nothing, -np.inf, mean + _FARTHEST * std).max(axis=1)
    high[lacks] = top[lacks, None]
    return np.where(nothing[:, :, None], np.inf, ends).min(axis=1), high


def _start(weight: FloatArray, mean: FloatArray, std: FloatArray, wanted: FloatArray) -> FloatArray:
    """Quantiles, roughly: those of the components' atoms."""
    from scipy import special  # noqa: PLC0415 - tens of milliseconds of import

    count = len(weight)
    at = mean[:, :, None] + std[:, :, None] * _ATOMS
    at[weight == 0] = np.inf  # the last, beyond all that is looked up
    at = at.reshape(count, -1)
    order = np.argsort(at, axis=1, kind="stable")
    order += at.shape[1] * np.arange(count)[:, None]
    mass = (weight[:, :, None] * _MASS).ravel()[order]
    upto = np.cumsum(mass, axis=1)
    middle = (upto - (weight[:, :, None] * _AFTER).ravel()[order]) / upto[:, -1:]
    scores = special.ndtri(np.minimum(np.maximum(middle, _ROUNDING), 1 - _ROUNDING))
    scores = np.maximum.accumulate(np.rint(scores * _LATTICE) / _LATTICE, axis=1)
    row = _ROW * np.arange(count)[:, None]
    return np.interp(wanted + row, (scores + row).ravel(), at.ravel()[order].ravel())


def _evaluated(at: FloatArray, parts: _Components) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Probability below; density times sqrt(2 pi), and minus the slope of that."""
    from scipy import special  # noqa: PLC0415 - tens of milliseconds of import

    z = (at - parts.mean) * parts.per_std
    terms = special.ndtr(z)
    terms *= parts.weight
    below: FloatArray = terms.sum(axis=0)
    np.multiply(z, z, out=terms)
    terms *= -0.5
    np.exp(terms, out=terms)
    terms *= parts.height
    density: FloatArray = terms.sum(axis=0)
    terms *= z
    terms *= parts.per_std
    fall: FloatArray = terms.sum(axis=0)
    return below, density, fall


def _step(
    at: FloatArray, low: FloatArray, high: FloatArray, wanted: FloatArray, parts: _Components
) -> tuple[FloatArray, BoolArray]:
    """
    Come closer to the wanted scores, and tell which are found; narrows the bracket in place.

    Halley's step x - r / (1 - r b / 2), where r is Newton's step and b = g'' / g' of the score g;
    the middle of the bracket where that leads outside.
    """
    from scipy import special  # noqa: PLC0415 - tens of milliseconds of import

    below, density, fall = _evaluated(at, parts)
    score = special.ndtri(np.minimum(np.maximum(below, _ROUNDING), 1 - _ROUNDING))
    gap = score - wanted
    np.copyto(low, at, where=gap < 0)
    np.copyto(high, at, where=gap > 0)
    slope = density * np.exp(0.5 * score * score)
    newton = gap / slope
    bend = 0.5 * newton * (score * slope - fall / density)
    new = at - newton / (1 - np.minimum(np.maximum(bend, -0.5), 0.5))
    size = np.abs(gap)
    is_found = size < _CLOSE
    inside = (new >= low) & (new <= high)
    if not inside.all():
        is_found &= inside | (size < _EXACT)
        new = np.where(inside, new, np.where(is_found, at, 0.5 * (low + high)))
    is_found |= np.abs(new - at) <= _ROUNDING * np.abs(at)
    return new, is_found
