"""
References and other objects while the shift and noise of their depths and the plane are still open.

A `Nuisance` holds cases of what is not known; under each of them the references are plain
observations of log k (`imgscale.core.segments`), so that one core solves every kind of depth.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np

from imgscale._typing import BoolArray, FloatArray, IntArray
from imgscale.core.segments import Parts
from imgscale.core.stance import Stance

# Depth noise that nobody told: 5 % within a factor of 2.2, what stereo and networks give, on a grid
# from 1 to 53 %.
UNKNOWN_DEPTH_REL = 0.05
_UNKNOWN_FACTOR = 2.2
_NOISE_SCORES = np.linspace(-2.0, 3.0, 9)

ArrayT = TypeVar("ArrayT", FloatArray, BoolArray)


class Sized(NamedTuple):
    """
    Objects as columns: what was seen of each, and the prior of its size.

    Attributes
    ----------
    inverse_depth : (N,) ndarray of float64
        D of the one law ``p / H = (D + b) / k``; NaN where it is not known.
    log_pixels : (N,) ndarray of float64
        Log of the extent in pixels.
    noise_var : (N,) ndarray of float64
        Variance of log(d p), as far as it was told.
    prior : Parts
        Log sizes of the kinds of thing that the label may be; NaN without a prior.
    prior_log, prior_var : (N,) ndarray of float64
        Mean and variance of the log size, all kinds together.
    tau : (N,) ndarray of float64
        Standard deviation of the label's shared offset.
    image, group : (N,) ndarray of int
        Image, and (image, label); -1 for a label without references.
    told : (N,) ndarray of bool
        True where the noise of the depth was told, whatever is not known of others'.
    firm : (N,) ndarray of bool
        True for a camera, whose own log k is `prior_log`.
    stance : Stance or None
        Where the boxes lie, where a ground plane or a tilt counts.
    """

    inverse_depth: FloatArray
    log_pixels: FloatArray
    noise_var: FloatArray
    prior: Parts
    prior_log: FloatArray
    prior_var: FloatArray
    tau: FloatArray
    image: IntArray
    group: IntArray
    told: BoolArray
    firm: BoolArray
    stance: Stance | None = None

    def rows(self, rows: IntArray | BoolArray) -> Sized:
        """
        Take some rows.

        Parameters
        ----------
        rows : (M,) ndarray of int or bool
            Which.

        Returns
        -------
        Sized
            The rows.
        """
        return Sized(*(_picked(column, rows) for column in self))

    def joined(self, more: Sized) -> Sized:
        """
        Add rows.

        Parameters
        ----------
        more : Sized
            The rows.

        Returns
        -------
        Sized
            First these, then those.
        """
        width = max(self.prior.share.shape[1], more.prior.share.shape[1])
        first, second = (part._replace(prior=_widened(part.prior, width)) for part in (self, more))
        return Sized(*(_joined(*pair) for pair in zip(first, second, strict=True)))

    def tiled(self, count: int, n_images: int) -> Sized:
        """
        Repeat the objects as those of other images.

        Parameters
        ----------
        count : int
            How often.
        n_images : int
            Number of images.

        Returns
        -------
        Sized
            Image i of the repetition j has the number ``i + j n_images``, groups likewise.
        """
        n_groups = int(self.group.max(initial=-1)) + 1
        repeated = self.rows(np.tile(np.arange(self.image.size), count))
        return repeated._replace(
            image=numbered(self.image, count, n_images),
            group=numbered(self.group, count, n_groups),
        )

    def by_depth(self, nuisance: Nuisance) -> FloatArray:
        """
        Compute the log of d p from the depths, the size for k = 1.

        Parameters
        ----------
        nuisance : Nuisance
            The cases.

        Returns
        -------
        (K, N) ndarray of float64
            One row for each case; NaN without a depth, inf where the law has no finite distance.
        """
        inverse = self.inverse_depth + nuisance.shift[:, self.image]
        with np.errstate(invalid="ignore", divide="ignore"):
            log_size = self.log_pixels - np.log(np.maximum(inverse, 0.0))
        log_size[:, self.firm] = 0.0
        return log_size

    def noise_under(self, nuisance: Nuisance) -> FloatArray:
        """
        Compute the variance of log(d p) from the depths with the part that was not told.

        Parameters
        ----------
        nuisance : Nuisance
            The cases.

        Returns
        -------
        (K, N) ndarray of float64
            One row for each case.
        """
        return self.noise_var + nuisance.depth_var[:, self.image] * ~self.told


class Nuisance(NamedTuple):
    """
    K cases of what is not known of depths and plane, and how probable each is.

    Attributes
    ----------
    shift : (K, n_images) ndarray of float64
        The shift b of the inverse depth.
    depth_var : (K, n_images) ndarray of float64
        Variance of the log depths beyond what was told.
    log_prior : (K, n_images) ndarray of float64
        Log of the probability of each case, up to a constant.
    horizon : (K, n_images) ndarray of float64 or None
        Row of the horizon below the principal point; None where no tilt is known.
    slope, gap : (K, n_images) ndarray of float64 or None
        How far the plane falls off sideways, and log(camera height / k); None without a plane.
    log_focal : (K, n_images) ndarray of float64 or None
        Log of the focal length over the one that was told; None where that is exact.
    """

    shift: FloatArray
    depth_var: FloatArray
    log_prior: FloatArray
    horizon: FloatArray | None = None
    slope: FloatArray | None = None
    gap: FloatArray | None = None
    log_focal: FloatArray | None = None

    @property
    def n_cases(self) -> int:
        """Number of cases."""
        return len(self.shift)

    def cases(self, rows: IntArray | BoolArray) -> Nuisance:
        """
        Take some cases.

        Parameters
        ----------
        rows : (K,) ndarray of int or bool
            Which.

        Returns
        -------
        Nuisance
            The cases.
        """
        return Nuisance(*(_picked(column, rows) for column in self))


def noise_cases(n_images: int, *, unknown_noise: bool) -> Nuisance:
    """
    Spread the cases of the depth noise.

    Parameters
    ----------
    n_images : int
        Number of images.
    unknown_noise : bool
        True where nobody told the noise: it is then log-normal about 5 %.

    Returns
    -------
    Nuisance
        Without a shift.
    """
    scores = _NOISE_SCORES if unknown_noise else np.zeros(1)
    size = UNKNOWN_DEPTH_REL * np.exp(math.log(_UNKNOWN_FACTOR) * scores) * unknown_noise
    return Nuisance(
        shift=np.zeros((scores.size, n_images)),
        depth_var=np.repeat(size[:, None] ** 2, n_images, axis=1),
        log_prior=np.repeat(-(scores[:, None] ** 2) / 2, n_images, axis=1),
    )


def middle_case(shift: FloatArray, *, unknown_noise: bool) -> Nuisance:
    """
    Take the middle case of the noise alone, for what needs no more.

    Parameters
    ----------
    shift : (K, n_images) ndarray of float
        Shifts.
    unknown_noise : bool
        True where nobody told the noise, which is then 5 %.

    Returns
    -------
    Nuisance
        K cases, equally probable.
    """
    return Nuisance(
        shift=shift,
        depth_var=np.full_like(shift, UNKNOWN_DEPTH_REL**2 * unknown_noise),
        log_prior=np.zeros_like(shift),
    )


def crossed(noise: Nuisance, others: Nuisance) -> Nuisance:
    """
    Combine cases of the noise with cases of everything else.

    Parameters
    ----------
    noise : Nuisance
        K cases of the noise.
    others : Nuisance
        B cases of shift and plane.

    Returns
    -------
    Nuisance
        The K B cases.
    """
    count, repeats = others.n_cases, noise.n_cases
    tiled = [None if column is None else np.tile(column, (repeats, 1)) for column in others]
    both = Nuisance(*tiled)  # type: ignore[arg-type]  # its first three are arrays
    return both._replace(
        depth_var=np.repeat(noise.depth_var, count, axis=0),
        log_prior=both.log_prior + np.repeat(noise.log_prior, count, axis=0),
    )


def repeated(column: ArrayT, count: int) -> ArrayT:
    """
    Repeat a column for each case.

    Parameters
    ----------
    column : (N,) ndarray
        The column.
    count : int
        How often.

    Returns
    -------
    (count N,) ndarray
        Case by case; the column itself for one case.
    """
    return column if count == 1 else cast("ArrayT", np.tile(column, count))


def numbered(number: IntArray, count: int, step: int) -> IntArray:
    """
    Repeat numbers for each case.

    Parameters
    ----------
    number : (N,) ndarray of int
        The numbers; -1 stays.
    count : int
        How often.
    step : int
        What is added from one case to the next.

    Returns
    -------
    (count N,) ndarray of int
        The numbers, case by case.
    """
    if count == 1:
        return number
    shifted = number + step * np.arange(count)[:, None]
    result: IntArray = np.where(number < 0, -1, shifted).ravel()
    return result


def _picked(column: Any, rows: IntArray | BoolArray) -> Any:
    """Take rows of a column, of a table of columns or of nothing."""
    if column is None:
        return None
    if isinstance(column, tuple):
        parts = cast("tuple[FloatArray, ...]", column)
        kind = cast("Any", type(cast("object", column)))
        return kind(*(part[rows] for part in parts))
    return column[rows]


def _widened(kinds: Parts, width: int) -> Parts:
    """Add kinds of the weight 0."""
    more = width - kinds.share.shape[1]
    if not more:
        return kinds
    share = np.pad(kinds.share, ((0, 0), (0, more)))
    mean, variance = (
        np.concatenate([column, np.repeat(column[:, -1:], more, axis=1)], axis=1)
        for column in (kinds.mean, kinds.variance)
    )
    return Parts(share, mean, variance)


def _joined(first: Any, second: Any) -> Any:
    """Join two columns, tables of columns or nothings."""
    if first is None:
        return None
    if isinstance(first, tuple):
        pairs = zip(cast("tuple[FloatArray, ...]", first), second, strict=True)
        kind = cast("Any", type(cast("object", first)))
        return kind(*(np.concatenate(pair) for pair in pairs))
    return np.concatenate([first, second])
