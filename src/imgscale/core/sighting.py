"""
What references and other objects look like under each case of what is not known.

Depth and foot are two witnesses of an object's distance: on the ground plane they are averaged by
their precisions, off it the depth stands alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from imgscale._typing import BoolArray, FloatArray, IntArray
from imgscale.core.segments import MIN_VARIANCE, LogObservations, Parts, Subjects
from imgscale.core.stance import Stance
from imgscale.core.witnesses import Nuisance, Sized, numbered, repeated

# One object in ten that might stand on the plane does not, or shows no foot.
_OFF_PLANE = 0.1
# A reference seen above the horizon is wrong, one in twenty, and tells next to nothing of k: it
# counts as one as tall as the camera is high, within a factor of e.
_BEYOND = float(np.finfo(np.float64).max)
_LOST_LOG_WEIGHT, _LOST_VAR = math.log(0.05), 1.0


class Sighting(NamedTuple):
    """
    What objects look like under each case, for H ways in which they may stand there.

    The first way is to stand on the plane, the second, where there is one, to be off it.

    Attributes
    ----------
    log_size : (H, K, N) ndarray of float64
        Log of d p, the size for k = 1; NaN without a distance, inf where it is not finite.
    variance : (H, K, N) ndarray of float64
        Its variance.
    log_weight : (H, K, N) ndarray of float64
        Log density of the foot's row, seen from the depth, times the probability of that way.
    """

    log_size: FloatArray
    variance: FloatArray
    log_weight: FloatArray

    @property
    def evidence(self) -> FloatArray:
        """Log density of each object's foot, (K, N)."""
        total: FloatArray = np.logaddexp.reduce(self.log_weight, axis=0)
        return total

    @property
    def share(self) -> FloatArray:
        """Probability of each way, (H, K, N)."""
        return np.exp(self.log_weight - self.evidence)


class Comparison(NamedTuple):
    """
    Depth and foot of objects side by side, (K, N) each.

    Attributes
    ----------
    by_depth, by_foot : (K, N) ndarray of float64
        Log of d p from either; NaN without it, inf where it is not finite.
    depth_var, foot_var : (K, N) ndarray of float64
        Variances of the log distances.
    below : (K, N) ndarray of float64
        Rows of the foot below the horizon; 1 where it is not below.
    shared_var : (K, N) ndarray of float64
        What the lower edge of the box, which ends the extent and is the foot, takes off the
        variance of log(d p) by the foot.
    has_both : (K, N) ndarray of bool
        Where the object has a depth, and a foot below the horizon.
    """

    by_depth: FloatArray
    by_foot: FloatArray
    depth_var: FloatArray
    foot_var: FloatArray
    below: FloatArray
    shared_var: FloatArray
    has_both: BoolArray

    @property
    def apart(self) -> FloatArray:
        """By how much depth and foot disagree, log(d p) from either; 0 where there are not both."""
        with np.errstate(invalid="ignore"):
            return np.where(self.has_both, self.by_depth - self.by_foot, 0.0)

    @property
    def total_var(self) -> FloatArray:
        """Variance of that."""
        return np.maximum(self.depth_var + self.foot_var, MIN_VARIANCE)


def compare(objects: Sized, stance: Stance, nuisance: Nuisance) -> Comparison:
    """
    Compare depths and feet under each case.

    Parameters
    ----------
    objects : Sized
        N objects.
    stance : Stance
        Where they lie in the image.
    nuisance : Nuisance
        K cases of the plane.

    Returns
    -------
    Comparison
        Where there is no plane, the feet are not known.
    """
    image = objects.image
    horizon = np.zeros((1, image.size)) if nuisance.horizon is None else nuisance.horizon[:, image]
    tilts = stance.tilts(horizon, _log_focal(nuisance, image))
    by_depth = objects.by_depth(nuisance) + np.where(objects.firm, 0.0, tilts.by_depth)
    depth_var = np.maximum(objects.noise_under(nuisance) - stance.box_var, 0.0)
    nothing = np.full_like(by_depth, np.nan)
    if nuisance.slope is None or nuisance.gap is None:
        no = np.zeros(by_depth.shape, dtype=np.bool_)
        return Comparison(by_depth, nothing, depth_var, nothing, nothing, nothing, no)
    gap, slope = nuisance.gap[:, image], nuisance.slope[:, image]
    by_depth = np.where(stance.is_height, gap, by_depth)
    by_depth = by_depth - stance.lean_horizon * horizon - stance.lean_slope * slope
    rows = stance.below_horizon(horizon, slope)
    below = np.where(rows > 0, rows, 1.0)
    by_foot = objects.log_pixels + tilts.by_foot - np.log(below) + gap
    return Comparison(
        by_depth=by_depth,
        by_foot=np.where(rows <= 0, np.inf, np.where(np.isnan(rows), np.nan, by_foot)),
        depth_var=depth_var,
        # a foot within its error of the horizon tells no more than that it is far
        foot_var=stance.foot_var / (below**2 + stance.foot_var) + stance.relief_var,
        below=below,
        # e in the edge: log p + e / p and log d - e / below; half of the extent's variance is e's
        shared_var=np.where(
            stance.upright,
            stance.box_var * np.exp(objects.log_pixels) * below / (below**2 + stance.foot_var),
            0.0,
        ),
        has_both=np.isfinite(by_depth) & (rows > 0),
    )


def sight(objects: Sized, nuisance: Nuisance) -> Sighting:
    """
    Look at objects under each case.

    Parameters
    ----------
    objects : Sized
        N objects.
    nuisance : Nuisance
        K cases.

    Returns
    -------
    Sighting
        One way, unless both depths and feet are known.

    Notes
    -----
    On the plane depth and foot are averaged by their precisions 1 / s_z^2 and 1 / s_g^2 and the
    difference of their logs has the variance s_z^2 + s_g^2; off it the depth stands alone and the
    foot is anywhere in the image. Densities are those of the foot's row. An error of the box's
    lower edge makes an object taller and nearer at once, which nearly cancels where it is as high
    as the camera.
    """
    stance = objects.stance
    if stance is None or nuisance.horizon is None:
        by_depth = objects.by_depth(nuisance)
        one_way = np.zeros((1, *by_depth.shape))
        return Sighting(by_depth[None], objects.noise_under(nuisance)[None], one_way)
    seen = compare(objects, stance, nuisance)
    depth, foot = np.isfinite(seen.by_depth), ~np.isnan(seen.by_foot)
    one_way = np.zeros((1, *depth.shape))
    if not (depth & foot).any():  # one witness of distance each
        log_size = np.where(foot, seen.by_foot, seen.by_depth)
        variance = np.where(foot, seen.foot_var - seen.shared_var, seen.depth_var)
        variance = np.maximum(variance + stance.box_var, 0.0)
        return Sighting(log_size[None], variance[None], one_way)
    either = depth & foot
    towards_foot = np.where(seen.has_both, seen.depth_var / seen.total_var, 0.0)
    log_plane = -0.5 * (seen.apart**2 / seen.total_var + np.log(2 * np.pi * seen.total_var))
    log_plane += math.log1p(-_OFF_PLANE) - np.log(seen.below)
    size_on = np.where(depth, seen.by_depth - towards_foot * seen.apart, seen.by_foot)
    size_on = np.where(depth | foot, size_on, seen.by_depth)
    size_off = np.where(depth, seen.by_depth, size_on)
    var_on = np.where(depth, (1 - towards_foot) * seen.depth_var, seen.foot_var)
    var_on -= np.where(foot, np.where(depth, towards_foot, 1.0) * seen.shared_var, 0.0)
    log_off = math.log(_OFF_PLANE) - np.log(stance.span_px)
    return Sighting(
        log_size=np.stack([size_on, size_off]),
        variance=np.maximum(np.stack([var_on, seen.depth_var]) + stance.box_var, 0.0),
        log_weight=np.stack(
            [
                np.where(either, np.where(seen.has_both, log_plane, -np.inf), 0.0),
                np.where(either, log_off, -np.inf),
            ]
        ),
    )


def log_scales(objects: Sized, nuisance: Nuisance) -> tuple[FloatArray, FloatArray]:
    """
    Compute metres per pixel and z-depth for k = 1.

    Parameters
    ----------
    objects : Sized
        N objects.
    nuisance : Nuisance
        K cases.

    Returns
    -------
    log_scale, log_range : (K, N) ndarray of float64
        Logs of metres per pixel and of z-depth over focal length; NaN where the object has no
        finite distance.
    """
    seen = sight(objects, nuisance)
    log_size = (seen.share * seen.log_size).sum(axis=0)
    log_scale = np.where(np.isfinite(log_size), log_size - objects.log_pixels, np.nan)
    if objects.stance is None or nuisance.horizon is None:
        return log_scale, log_scale
    image = objects.image
    tilts = objects.stance.tilts(nuisance.horizon[:, image], _log_focal(nuisance, image))
    by_foot = np.isnan(objects.inverse_depth)
    return log_scale, log_scale - np.where(
        by_foot, tilts.by_foot - tilts.log_secant, tilts.by_depth
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
    sighting = sight(witnesses, nuisance)
    log_size, noise_var = sighting.log_size, sighting.variance
    lost: BoolArray = log_size > _BEYOND
    if lost.any():
        gap = 0.0 if nuisance.gap is None else nuisance.gap[:, witnesses.image]
        log_size = np.where(lost, gap, log_size)
        noise_var = np.where(lost, _LOST_VAR, noise_var)
    middle, spread = log_size[0], noise_var[0]
    if len(log_size) > 1:
        share = sighting.share
        middle = (share * log_size).sum(axis=0)
        spread = (share * (noise_var + (log_size - middle) ** 2)).sum(axis=0)
    n_images, n_groups = nuisance.shift.shape[1], int(witnesses.group.max(initial=-1)) + 1
    count = nuisance.n_cases
    return LogObservations(
        y=(witnesses.prior_log - middle).ravel(),
        variance=np.maximum(witnesses.prior_var + spread, MIN_VARIANCE).ravel(),
        tau=repeated(witnesses.tau, count),
        image=numbered(witnesses.image, count, n_images),
        group=numbered(witnesses.group, count, n_groups),
        firm=repeated(witnesses.firm, count),
        mixture=_kinds(witnesses.prior, sighting, log_size, noise_var),
    )


def _kinds(prior: Parts, sighting: Sighting, log_size: FloatArray, noise_var: FloatArray) -> Parts:
    """Log k by each kind of thing that a label may be, in each way (H, K, N) to stand there."""
    ways, count, rows = log_size.shape
    shape = (count * rows, prior.share.shape[1] * ways)
    by_way = [part.transpose(1, 2, 0)[:, :, None, :] for part in (log_size, noise_var)]
    share, mean, variance = (part[:, :, None] for part in prior)
    if ways > 1:
        share = share * sighting.share.transpose(1, 2, 0)[:, :, None, :]
    elif count > 1:
        share = np.tile(share, (count, 1, 1))
    return Parts(
        share=share.reshape(shape),
        mean=(mean - by_way[0]).reshape(shape),
        variance=np.maximum(variance + by_way[1], MIN_VARIANCE).reshape(shape),
    )


def plane_evidence(objects: Sized, nuisance: Nuisance) -> FloatArray:
    """
    Compute the evidence of the objects' feet.

    Parameters
    ----------
    objects : Sized
        N objects of n_images images.
    nuisance : Nuisance
        K cases.

    Returns
    -------
    (K, n_images) ndarray of float64
        Log of the likelihood; 0 without a plane.
    """
    total = np.zeros_like(nuisance.shift)
    if nuisance.gap is None:
        return total
    sighting = sight(objects, nuisance)
    lost: BoolArray = sighting.log_size[0] > _BEYOND
    of_row = sighting.evidence + np.where(lost, _LOST_LOG_WEIGHT, 0.0)
    np.add.at(total.T, objects.image, of_row.T)
    return total


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
        image=numbered(subjects.image, count, n_images),
        group=numbered(subjects.group, count, n_groups),
        tau=repeated(subjects.tau, count),
        own=numbered(own, count, witnesses.image.size),
    )


def _log_focal(nuisance: Nuisance, image: IntArray) -> FloatArray | float:
    """Log of the focal length over the told one, for each case and object."""
    return 0.0 if nuisance.log_focal is None else nuisance.log_focal[:, image]
