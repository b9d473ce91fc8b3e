"""
References and other objects while shift and noise of their depths are still open.

A `Nuisance` is a grid of values of these two; under each of them the references are plain
observations of log k (`imgscale.core.segments`), so that one core solves every kind of depth.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from imgscale._typing import BoolArray, FloatArray, IntArray
from imgscale.core.segments import MIN_VARIANCE, LogObservations, Parts, Subjects

# Depth noise that nobody told: 5 % within a factor of 2.2, what stereo and networks give, on a grid
# from 1 to 53 %.
UNKNOWN_DEPTH_REL = 0.05
_UNKNOWN_FACTOR = 2.2
_NOISE_SCORES = np.linspace(-2.0, 3.0, 9)


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
        columns: list[Any] = [
            Parts(*(kind[rows] for kind in column)) if isinstance(column, Parts) else column[rows]
            for column in self
        ]
        return Sized(*columns)

    def log_size(self, nuisance: Nuisance) -> FloatArray:
        """
        Compute the log of d p, the size for k = 1.

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
            log_size = self.log_pixels - np.log(np.where(inverse < 0, 0.0, inverse))
        return np.where(self.firm, 0.0, log_size)

    def noise_under(self, nuisance: Nuisance) -> FloatArray:
        """
        Compute the variance of log(d p) with the part that was not told.

        Parameters
        ----------
        nuisance : Nuisance
            The cases.

        Returns
        -------
        (K, N) ndarray of float64
            One row for each case.
        """
        return self.noise_var + np.where(self.told, 0.0, nuisance.depth_var[:, None])


class Nuisance(NamedTuple):
    """
    K cases of what is not known of the depths, and how probable each is.

    Attributes
    ----------
    shift : (K, n_images) ndarray of float64
        The shift b of the inverse depth.
    depth_var : (K,) ndarray of float64
        Variance of the log depths beyond what was told.
    log_prior : (K, n_images) ndarray of float64
        Log of the probability of each case, up to a constant.
    """

    shift: FloatArray
    depth_var: FloatArray
    log_prior: FloatArray


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
        depth_var=size**2,
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
    noise_var = UNKNOWN_DEPTH_REL**2 * unknown_noise
    return Nuisance(
        shift=shift,
        depth_var=np.full(shift.shape[0], noise_var),
        log_prior=np.zeros_like(shift),
    )


def crossed(noise: Nuisance, shifts: Nuisance) -> Nuisance:
    """
    Combine cases of the noise with cases of the shift.

    Parameters
    ----------
    noise : Nuisance
        K cases of the noise.
    shifts : Nuisance
        B cases of the shift.

    Returns
    -------
    Nuisance
        The K B cases.
    """
    count, repeats = shifts.depth_var.size, noise.depth_var.size
    return Nuisance(
        shift=np.tile(shifts.shift, (repeats, 1)),
        depth_var=np.repeat(noise.depth_var, count),
        log_prior=np.repeat(noise.log_prior, count, axis=0)
        + np.tile(shifts.log_prior, (repeats, 1)),
    )


def observe_under(witnesses: Sized, nuisance: Nuisance) -> LogObservations:
    """
    Turn references into observations of log k, one image for each case and image.

    Parameters
    ----------
    witnesses : Sized
        N references of n_images images in n_groups groups.
    nuisance : Nuisance
        K cases.

    Returns
    -------
    LogObservations
        K N rows, case by case; image number ``case * n_images + image``, groups likewise.
    """
    count = nuisance.depth_var.size
    log_size = witnesses.log_size(nuisance).ravel()
    noise_var = witnesses.noise_under(nuisance).ravel()
    prior = Parts(*(np.tile(column, (count, 1)) for column in witnesses.prior))
    kinds = Parts(
        share=prior.share,
        mean=prior.mean - log_size[:, None],
        variance=np.maximum(prior.variance + noise_var[:, None], MIN_VARIANCE),
    )
    n_images, n_groups = nuisance.shift.shape[1], int(witnesses.group.max(initial=-1)) + 1
    return LogObservations(
        y=np.tile(witnesses.prior_log, count) - log_size,
        variance=np.maximum(np.tile(witnesses.prior_var, count) + noise_var, MIN_VARIANCE),
        tau=np.tile(witnesses.tau, count),
        image=_numbered(witnesses.image, count, n_images),
        group=_numbered(witnesses.group, count, n_groups),
        firm=np.tile(witnesses.firm, count),
        mixture=kinds,
    )


def subjects_under(
    subjects: Sized, own: IntArray, witnesses: Sized, nuisance: Nuisance
) -> Subjects:
    """
    Give objects the numbers that `observe_under` gives references.

    Parameters
    ----------
    subjects : Sized
        M objects.
    own : (M,) ndarray of int
        Which reference each was; -1 for none.
    witnesses : Sized
        The references.
    nuisance : Nuisance
        K cases.

    Returns
    -------
    Subjects
        K M rows, case by case.
    """
    count, n_images = nuisance.shift.shape
    n_groups = int(witnesses.group.max(initial=-1)) + 1
    return Subjects(
        image=_numbered(subjects.image, count, n_images),
        group=_numbered(subjects.group, count, n_groups),
        tau=np.tile(subjects.tau, count),
        own=_numbered(own, count, witnesses.image.size),
    )


def _numbered(number: IntArray, count: int, step: int) -> IntArray:
    """Repeat numbers for each case, shifted by `step`; -1 stays."""
    shifted = number + step * np.arange(count)[:, None]
    numbered: IntArray = np.where(number < 0, -1, shifted).ravel()
    return numbered
