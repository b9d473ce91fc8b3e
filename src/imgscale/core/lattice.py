"""
What references say of log k at equally spaced points, many images at once: arrays only.

The densities are those of `posterior`. On equally spaced points the exponents of Gaussians are
parabolas of the points' numbers, so that one product of matrices gives them all; the offsets of
labels are convolutions.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from imgscale._typing import BoolArray, FloatArray, IntArray
from imgscale.core.evidence import GROSS, GROSS_STD, SMALLER, SMALLER_BY, SMALLER_STD, SOUND
from imgscale.core.segments import LogObservations, Parts

# Kernels of labels' offsets reach 6 standard deviations; those of a variance below half a squared
# step keep only that variance.
_KERNEL_REACH = 6.0
_NARROW = 0.5
# So few rows are convolved one by one, more of them side by side.
_FEW = 16
# Numbers of matrices that are worked on at once.
_MATRICES = 100_000
# Logs of densities are at least this.
_LEAST_LOG = -700.0
_ROOT_TWO_PI = math.sqrt(2 * math.pi)
_TINY = float(np.finfo(np.float64).tiny)


class Scratch:
    """
    Memory for intermediate results, used again by one block of images after the other.

    New memory costs more than what is computed in it. What one block leaves there is lost with the
    next.
    """

    def __init__(self) -> None:
        self._buffers: dict[str, FloatArray] = {}

    def array(self, name: str, *shape: int) -> FloatArray:
        """
        Give an array of any content.

        Parameters
        ----------
        name : str
            What for; the same memory is given again under the same name.
        *shape : int
            Its shape.

        Returns
        -------
        ndarray of float64
            The array.
        """
        size = math.prod(shape)
        buffer = self._buffers.get(name)
        if buffer is None or buffer.size < size:
            buffer = self._buffers[name] = np.empty(size)
        return buffer[:size].reshape(shape)

    def rows(self, name: str, values: FloatArray, rows: IntArray) -> FloatArray:
        """
        Copy some rows.

        Parameters
        ----------
        name : str
            What for.
        values : (N, G) ndarray of float64
            All rows.
        rows : (M,) ndarray of int
            Which.

        Returns
        -------
        (M, G) ndarray of float64
            The copy.
        """
        out = self.array(name, rows.size, values.shape[1])
        # "clip" writes to `out` without another copy
        np.take(values, rows, axis=0, out=out, mode="clip")
        return out


class Lattice(NamedTuple):
    """
    Equally spaced points, as many in each of R rows.

    Attributes
    ----------
    centre : (R,) ndarray of float64
        Middle of the points.
    step : (R,) ndarray of float64
        Their spacing.
    size : int
        Their number G.
    """

    centre: FloatArray
    step: FloatArray
    size: int

    @property
    def powers(self) -> FloatArray:
        """Tell powers 0 to 2 of the points' numbers, counted from the middle, (3, G)."""
        return _powers(self.size)

    @property
    def points(self) -> FloatArray:
        """The points, (R, G)."""
        points: FloatArray = self.centre[:, None] + self.step[:, None] * self.powers[1]
        return points

    def rows(self, rows: IntArray) -> Lattice:
        """
        Take some rows.

        Parameters
        ----------
        rows : (M,) ndarray of int
            Which.

        Returns
        -------
        Lattice
            Their points.
        """
        return Lattice(self.centre[rows], self.step[rows], self.size)

    def replaced(self, by: Lattice, where: BoolArray) -> Lattice:
        """
        Exchange some rows.

        Parameters
        ----------
        by : Lattice
            Other points, as many.
        where : (R,) ndarray of bool
            Which rows are theirs.

        Returns
        -------
        Lattice
            The points.
        """
        return Lattice(
            np.where(where, by.centre, self.centre),
            np.where(where, by.step, self.step),
            self.size,
        )


class Rows(NamedTuple):
    """
    References as the grids need them.

    Attributes
    ----------
    y, variance, tau : (N,) ndarray of float64
        As in `LogObservations`.
    image, group : (N,) ndarray of int
        Image and (image, label) of each, in increasing order.
    firm : (N,) ndarray of bool
        As there.
    kinds : Parts
        Sound references of each kind, and the wrong that look smaller, (N, J + 1).
    """

    y: FloatArray
    variance: FloatArray
    tau: FloatArray
    image: IntArray
    group: IntArray
    firm: BoolArray
    kinds: Parts

    def taken(self, rows: IntArray, image: IntArray, group: IntArray) -> Rows:
        """
        Take some rows under other numbers.

        Parameters
        ----------
        rows : (M,) ndarray of int
            Which.
        image, group : (M,) ndarray of int
            Their new numbers.

        Returns
        -------
        Rows
            The rows.
        """
        columns = (self.y[rows], self.variance[rows], self.tau[rows])
        kinds = Parts(*(column.take(rows, axis=0) for column in self.kinds))
        return Rows(*columns, image, group, self.firm[rows], kinds)


class Ordered(NamedTuple):
    """
    References in the order of their images and labels.

    Attributes
    ----------
    rows : Rows
        The references; images and groups are numbered from 0 in the order in which they come.
    row : (N,) ndarray of int
        Which reference of all each is.
    group : (n_groups,) ndarray of int
        Which group of all each is.
    image_size, group_size : ndarray of int
        Number of references of each image and of each group.
    image_first, group_first : ndarray of int
        First reference of each.
    image_groups, image_first_group : (n_images,) ndarray of int
        Number of groups of each image, and the first of them.
    """

    rows: Rows
    row: IntArray
    group: IntArray
    image_size: IntArray
    group_size: IntArray
    image_first: IntArray
    group_first: IntArray
    image_groups: IntArray
    image_first_group: IntArray

    @property
    def group_image(self) -> IntArray:
        """Image of each group."""
        return self.rows.image[self.group_first]

    @property
    def group_tau(self) -> FloatArray:
        """Standard deviation of each label's offset."""
        return self.rows.tau[self.group_first]


class Likelihood(NamedTuple):
    """
    What N references say at the points of their lattices.

    Attributes
    ----------
    density : (N, G) ndarray of float64
        Their densities, times sqrt(2 pi).
    parts : (P, G) ndarray of float64
        The Gaussians in them.
    row, kind : (P,) ndarray of int
        Reference and kind of each; the kind J is that of the wrong that look smaller.
    """

    density: FloatArray
    parts: FloatArray
    row: IntArray
    kind: IntArray

    def expected(self, weight: FloatArray, n_kinds: int, work: Scratch) -> FloatArray:
        """
        Compute the probability of every kind.

        Parameters
        ----------
        weight : (N, G) ndarray of float
            Weight of each point for each reference; they sum to 1. Overwritten.
        n_kinds : int
            Number of kinds J.
        work : Scratch
            Memory to work in.

        Returns
        -------
        (N, J) ndarray of float64
            The probabilities.
        """
        kinds = np.zeros((len(weight), n_kinds))
        weight /= self.density
        ends = _ends(self.kind, n_kinds)
        for kind in range(n_kinds):
            part = slice(ends[kind], ends[kind + 1])
            row = self.row[part]
            own = weight if row.size == len(weight) else work.rows("own", weight, row)
            kinds[row, kind] = np.einsum("rg,rg->r", self.parts[part], own)
        return kinds


def starts(size: IntArray) -> IntArray:
    """
    Tell where segments that lie beside each other start.

    Parameters
    ----------
    size : (n,) ndarray of int
        Their sizes.

    Returns
    -------
    (n,) ndarray of int
        Their first elements.
    """
    first: IntArray = size.cumsum() - size
    return first


def in_order(obs: LogObservations) -> Ordered:
    """
    Bring references into the order of images and labels.

    Parameters
    ----------
    obs : LogObservations
        The references.

    Returns
    -------
    Ordered
        All of them.
    """
    image, group = obs.image, obs.group
    row = np.arange(obs.y.size)
    if (group[1:] < group[:-1]).any() or (image[1:] < image[:-1]).any():
        row = np.lexsort((group, image))
        image, group = image[row], group[row]
    is_new = np.ones(row.size, dtype=np.bool_)
    np.not_equal(group[1:], group[:-1], out=is_new[1:])
    first = is_new.nonzero()[0]
    rows = Rows(*obs[:6], _with_wrong(obs)).taken(row, image, is_new.cumsum() - 1)
    sizes = (np.bincount(image), np.bincount(rows.group), np.bincount(image[first]))
    return _ordered(rows, row, group[first], *sizes)


def picked(block: Ordered, images: IntArray) -> Ordered:
    """
    Take the references of some images.

    Parameters
    ----------
    block : Ordered
        The references.
    images : (n,) ndarray of int
        Which images; all of them in their order.

    Returns
    -------
    Ordered
        Theirs, in that order.
    """
    if images.size == block.image_size.size:
        return block
    image_size, image_groups = block.image_size[images], block.image_groups[images]
    row = _ranges(block.image_first[images], image_size)
    groups = _ranges(block.image_first_group[images], image_groups)
    group_size = block.group_size[groups]
    image = np.repeat(np.arange(images.size), image_size)
    group = np.repeat(np.arange(groups.size), group_size)
    rows = block.rows.taken(row, image, group)
    sizes = (image_size, group_size, image_groups)
    return _ordered(rows, block.row[row], block.group[groups], *sizes)


def likelihood(
    rows: Rows, at: Lattice, own_var: FloatArray, offset_std: FloatArray, work: Scratch
) -> Likelihood:
    """
    Compute what each reference says.

    Parameters
    ----------
    rows : Rows
        N references.
    at : Lattice
        N rows of points.
    own_var : (N,) ndarray of float
        Variance added to their own.
    offset_std : (N,) ndarray of float
        Standard deviation of an offset that each has for itself: the densities are convolved with
        it, exactly.
    work : Scratch
        Memory to work in, where the result stays.

    Returns
    -------
    Likelihood
        The densities of y given log k.
    """
    kind, row = (rows.kinds.share.T > 0).nonzero()
    share, mean, variance = (column[row, kind] for column in rows.kinds)
    variance += (own_var + offset_std * offset_std)[row]
    apart, step, half = at.centre[row] - mean, at.step[row], -0.5 / variance
    parabola = np.empty((row.size, 3))
    parabola[:, 0] = np.log(share / np.sqrt(variance)) + half * apart * apart
    parabola[:, 1] = 2 * half * apart * step
    parabola[:, 2] = half * step * step
    parts = np.matmul(parabola, at.powers, out=work.array("parts", row.size, at.size))
    np.maximum(parts, _LEAST_LOG, out=parts)  # exp() is slow where its result is no normal number
    np.exp(parts, out=parts)
    density = _gross(rows, at, own_var, offset_std, work)
    ends = _ends(kind, rows.kinds.share.shape[1])
    for first, end in itertools.pairwise(ends):
        _add(density, row[first:end], parts[first:end], work)
    np.maximum(density, _TINY, out=density)
    return Likelihood(density, parts, row, kind)


def summed(rows: FloatArray, size: IntArray) -> FloatArray:
    """
    Sum the rows of each segment.

    Parameters
    ----------
    rows : (N, G) ndarray of float64
        The rows.
    size : (n_segments,) ndarray of int
        How many of them each segment has, one after the other.

    Returns
    -------
    (n_segments, G) ndarray of float64
        The sums.
    """
    same = len(rows) // size.size
    if (size == same).all():
        equal: FloatArray = rows.reshape(size.size, same, rows.shape[1]).sum(axis=1)
        return equal
    total: FloatArray = np.add.reduceat(rows, starts(size), axis=0)
    return total


class Offsets(NamedTuple):
    """
    The offsets of C labels: v = log k + u.

    Attributes
    ----------
    tau : (C,) ndarray of float64
        Standard deviation of each.
    scale, label : Lattice
        Points of log k and of v.
    is_same : bool
        True where both are the same points.
    work : Scratch
        Memory to work in.
    """

    tau: FloatArray
    scale: Lattice
    label: Lattice
    is_same: bool
    work: Scratch

    def of_scale(self, of_label: FloatArray) -> FloatArray:
        """
        Integrate the offsets out.

        Parameters
        ----------
        of_label : (C, G) ndarray of float64
            Functions of v.

        Returns
        -------
        (C, G) ndarray of float64
            Their convolutions with the offsets' densities, at the points of log k.
        """
        if self.is_same:
            return _smoothed(of_label, self.tau / self.scale.step, self.work)
        weighted = of_label * self.label.step[:, None]
        result = np.empty_like(weighted)
        for part in self._parts():
            result[part] = np.matmul(self._matrix(part), weighted[part, :, None])[:, :, 0]
        return result

    def of_label(self, of_scale: FloatArray) -> FloatArray:
        """
        Convolve functions of log k.

        Parameters
        ----------
        of_scale : (C, G) or (K C, G) ndarray of float64
            The functions; those of each label K times, one set after the other.

        Returns
        -------
        (K C, G) ndarray of float64
            Their convolutions with the offsets' densities, at the points of v.
        """
        count = len(of_scale) // self.tau.size
        if self.is_same:
            return _smoothed(of_scale, np.tile(self.tau / self.scale.step, count), self.work)
        shape = (count, self.tau.size, 1, self.scale.size)
        weighted = of_scale.reshape(shape) * self.scale.step[:, None, None]
        result = np.empty_like(weighted)
        for part in self._parts():
            result[:, part] = np.matmul(weighted[:, part], self._matrix(part))
        return result.reshape(len(of_scale), -1)

    def _parts(self) -> Iterator[slice]:
        """Split the labels into parts whose matrices fit into the cache."""
        height = max(1, _MATRICES // self.scale.size**2)
        for start in range(0, self.tau.size, height):
            yield slice(start, start + height)

    def _matrix(self, part: slice) -> FloatArray:
        """Densities of offsets from each point of v to each of log k, (labels, G, G)."""
        tau = self.tau[part, None, None]
        scores = (self.scale.points[part, :, None] - self.label.points[part, None, :]) / tau
        scores *= scores
        scores *= -0.5
        np.exp(scores, out=scores)
        scores /= _ROOT_TWO_PI * tau
        return scores


def _smoothed(values: FloatArray, std_steps: FloatArray, work: Scratch) -> FloatArray:
    """Convolve rows with normal densities; they count as 0 beyond their ends."""
    rows, size = values.shape
    reach = np.minimum(np.maximum(np.ceil(_KERNEL_REACH * std_steps), 1), size - 1)
    longest = int(reach.max())
    at, variance = np.arange(longest + 1), std_steps[:, None] ** 2
    kernel = np.exp(-0.5 * at**2 / np.maximum(variance, _NARROW))
    kernel[at > reach[:, None]] = 0.0
    kernel /= 2 * kernel.sum(axis=1, keepdims=True) - 1
    narrow = std_steps**2 < _NARROW
    kernel[narrow] = 0.0
    kernel[narrow, 0], kernel[narrow, 1] = 1 - variance[narrow, 0], variance[narrow, 0] / 2
    if rows < _FEW:
        both = np.concatenate([kernel[:, :0:-1], kernel], axis=1)
        pairs = zip(values, both, strict=True)
        return np.array([np.correlate(*pair, "full")[longest : longest + size] for pair in pairs])
    # along the rows, so that each weight of a kernel lies beside those of the others
    padded = work.array("padded", size + 2 * longest, rows)
    padded[:longest] = padded[longest + size :] = 0.0
    padded[longest : longest + size] = values.T
    weight, pair = np.ascontiguousarray(kernel.T), work.array("pair", size, rows)
    total = work.array("total", size, rows)
    np.multiply(padded[longest : longest + size], weight[0], out=total)
    for distance in range(1, longest + 1):
        low, high = longest - distance, longest + distance
        np.add(padded[low : low + size], padded[high : high + size], out=pair)
        pair *= weight[distance]
        total += pair
    return np.ascontiguousarray(total.T)


def _add(total: FloatArray, to: IntArray, values: FloatArray, work: Scratch) -> None:
    """Add rows to some of others."""
    if to.size == len(total):
        total += values
        return
    sums = work.rows("sums", total, to)
    sums += values
    total[to] = sums


def _gross(
    rows: Rows, at: Lattice, own_var: FloatArray, offset_std: FloatArray, work: Scratch
) -> FloatArray:
    """Laplace densities of the wrong, either way, convolved with normal densities."""
    scale = np.sqrt((rows.variance + own_var + GROSS_STD**2) / 2)
    offset = offset_std / scale
    amount = np.where(rows.firm, 0.0, GROSS * _ROOT_TWO_PI / 2) / scale * np.exp(offset**2 / 2)
    line = np.empty((scale.size, 2))
    line[:, 0], line[:, 1] = (at.centre - rows.y) / scale, at.step / scale
    away = np.matmul(line, at.powers[:2], out=work.array("density", scale.size, at.size))
    np.abs(away, out=away)
    blunt = (offset * amount > 0).nonzero()[0]
    tip = _blunted(work.rows("away", away, blunt), offset[blunt, None], work) if blunt.size else 1.0
    np.negative(away, out=away)
    np.exp(away, out=away)
    away *= amount[:, None]
    if blunt.size:
        tip *= work.rows("away", away, blunt)
        away[blunt] = tip
    return away


def _blunted(away: FloatArray, offset: FloatArray, work: Scratch) -> FloatArray:
    """
    Compute what a convolution with N(0, s^2) makes of exp(-|r|), over exp(s^2 / 2 - |r|).

    It is Phi(z - s) + exp(2 z s) Phi(-z - s) with z = |r| / s, which is written with the ratio
    M(t) = Phi(-t) / phi(t), so that nothing overflows. Overwrites its first argument.
    """
    ends, ratio, free = (work.array(name, 2, *away.shape) for name in ("ends", "ratio", "free"))
    away /= offset
    np.add(away, offset, out=ends[0])
    away -= offset
    np.abs(away, out=ends[1])
    _mills(ends, free, ratio)
    far: FloatArray = ratio[0]
    near: FloatArray = ratio[1]
    np.copysign(near, away, out=near)
    far -= near
    density: FloatArray = ends[0]
    with np.errstate(over="ignore"):  # of what lies infinitely far: its density is 0
        np.multiply(away, away, out=density)
    density *= -0.5
    np.exp(density, out=density)
    far *= density
    far *= 1 / _ROOT_TWO_PI
    far += away >= 0
    return far


def _mills(t: FloatArray, k: FloatArray, out: FloatArray) -> None:
    """Put the ratio of a normal tail beyond t >= 0 to the density there into `out`, to 1e-7."""
    # Abramowitz and Stegun, Handbook of Mathematical Functions, 26.2.17
    np.multiply(t, 0.2316419, out=k)
    k += 1
    np.reciprocal(k, out=k)
    np.multiply(k, 1.330274429, out=out)
    for coefficient in (-1.821255978, 1.781477937, -0.356563782, 0.319381530):
        out += coefficient
        out *= k


def _ordered(
    rows: Rows,
    row: IntArray,
    group: IntArray,
    image_size: IntArray,
    group_size: IntArray,
    image_groups: IntArray,
) -> Ordered:
    """Add where everything starts."""
    return Ordered(
        rows=rows,
        row=row,
        group=group,
        image_size=image_size,
        group_size=group_size,
        image_first=starts(image_size),
        group_first=starts(group_size),
        image_groups=image_groups,
        image_first_group=starts(image_groups),
    )


@functools.lru_cache(maxsize=64)
def _powers(size: int) -> FloatArray:
    """Powers 0 to 2 of numbers about 0."""
    number = np.arange(size) - (size - 1) / 2
    powers: FloatArray = np.array([np.ones(size), number, number * number], dtype=np.float64)
    return powers


def _ends(kind: IntArray, n_kinds: int) -> list[int]:
    """Where each kind starts, and the end."""
    return [int(end) for end in np.searchsorted(kind, np.arange(n_kinds + 1))]


def _ranges(first: IntArray, size: IntArray) -> IntArray:
    """Numbers in ranges that start there."""
    before = starts(size)
    return np.arange(int(size.sum())) + np.repeat(first - before, size)


def _with_wrong(obs: LogObservations) -> Parts:
    """Kinds of sound references, and the wrong that look smaller as one more."""
    part = obs.kinds
    n, n_kinds = part.share.shape
    share, mean, variance = np.empty((3, n, n_kinds + 1))
    np.multiply(part.share, np.where(obs.firm, 1.0, SOUND)[:, None], out=share[:, :-1])
    mean[:, :-1], variance[:, :-1] = part.mean, part.variance
    share[:, -1] = np.where(obs.firm, 0.0, SMALLER)
    mean[:, -1], variance[:, -1] = obs.y - SMALLER_BY, obs.variance + SMALLER_STD**2
    return Parts(share, mean, variance)
