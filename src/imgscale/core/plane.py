"""
Cases of the unknown ground plane.

They are spread about its most probable place, evenly rather than at random, and each has the weight
that its density there asks for.
"""

from __future__ import annotations

import math

import numpy as np

from imgscale._typing import FloatArray
from imgscale.core.peak import Peak, bounded, climb, log_mass, starts
from imgscale.core.segments import normalised
from imgscale.core.unknowns import Scene, Unknowns, unknowns_of, with_columns
from imgscale.core.witnesses import Nuisance, Sized, crossed

_NODES = 11
# Cases for 2 to 5 unknowns, half as many for each of several levels of noise: three in five as
# wide as the errors, the others 2.5 times.
_CASES = {2: 48, 3: 72, 4: 112, 5: 160}
_WIDE, _WIDE_SHARE = 2.5, 0.4
# Cases less probable than the best one by this factor (its log) are left out.
_NEGLIGIBLE = 9.0
_GOLDEN = (math.sqrt(5) - 1) / 2


def tilt_cases(scene: Scene, n_images: int) -> Nuisance:
    """
    Spread cases of the camera's tilt, by Gauss and Hermite's rule.

    Parameters
    ----------
    scene : Scene
        What is known of the horizon and of the focal length.
    n_images : int
        Number of images.

    Returns
    -------
    Nuisance
        One case where both are known exactly, eleven where one of them is, else eleven pairs.

    Notes
    -----
    The pitch was told, so that the horizon y0 moves with the focal length f. What differs from one
    upright object to the other goes with y0 / f^2, in which the errors of both add up: the eleven
    lie along that. Across it only 1 / cos T changes, of which two cases tell the variance.
    """
    by_focal = scene.horizon * scene.focal_rel_std
    both = math.hypot(scene.horizon_std, by_focal)
    cos, sin = (scene.horizon_std / both, by_focal / both) if both else (1.0, 0.0)
    nodes, weights = np.polynomial.hermite_e.hermegauss(_NODES if both else 1)
    pair = [-1.0, 1.0] if scene.horizon_std and scene.focal_rel_std else [0.0]
    along, across = np.repeat(nodes, len(pair))[:, None], np.tile(pair, nodes.size)[:, None]
    zero = np.zeros((along.size, n_images))
    log_focal = zero + scene.focal_rel_std * (cos * across - sin * along)
    horizon = scene.horizon + scene.horizon_std * (cos * along + sin * across)
    return Nuisance(
        shift=zero,
        depth_var=zero,
        log_prior=zero + np.log(np.repeat(weights, len(pair)))[:, None],
        horizon=horizon * np.exp(log_focal),
        log_focal=log_focal if scene.focal_rel_std else None,
    )


def plane_cases(
    witnesses: Sized, bystanders: Sized, scene: Scene, noise: Nuisance, *, has_shift: bool
) -> tuple[Nuisance, Nuisance]:
    """
    Spread cases of the plane over where feet, sizes and the prior allow it.

    Parameters
    ----------
    witnesses : Sized
        References, the camera among them, each with its stance.
    bystanders : Sized
        Other objects whose depth and foot tell of the plane.
    scene : Scene
        What is known beforehand.
    noise : Nuisance
        Cases of the depths' noise.
    has_shift : bool
        True where the shift of the inverse depth is unknown too.

    Returns
    -------
    best : Nuisance
        One case: the most probable values, by robust weights.
    cases : Nuisance
        Cases of everything, noise included.
    """
    levels, n_images = noise.shift.shape
    unknowns = unknowns_of(witnesses, bystanders, scene, noise, has_shift=has_shift)
    first = starts(unknowns)
    # each start is followed as though it were an image of its own
    again = crossed(_alike(len(first), n_images), noise)
    followed = unknowns_of(witnesses, bystanders, scene, again, has_shift=has_shift)
    found = climb(followed, first.reshape(-1, unknowns.dimensions))
    mass = log_mass(followed, found).reshape(len(first), -1)
    which = np.argmax(mass, axis=0) * unknowns.n_images + np.arange(unknowns.n_images)
    peak = Peak(found.theta[which], found.root[which])
    level = normalised(mass.max(axis=0).reshape(levels, n_images), 0)
    theta = (level[:, :, None] * peak.theta.reshape(levels, n_images, -1)).sum(axis=0)
    best = unknowns.nuisance(np.tile(theta, (levels, 1))[None])
    cases = _around(unknowns, peak, _CASES[unknowns.dimensions] // (1 if levels == 1 else 2))
    log_weight = (unknowns.log_likelihood(cases) + cases.log_prior).reshape(-1, n_images)
    likely = (log_weight > log_weight.max(axis=0) - _NEGLIGIBLE).any(axis=1)
    return (
        with_columns(best, lambda column: column[:, :n_images]),
        with_columns(cases, lambda column: column.reshape(-1, n_images)).cases(likely),
    )


def _alike(count: int, n_images: int) -> Nuisance:
    """Make cases that differ in nothing."""
    zero = np.zeros((count, n_images))
    return Nuisance(zero, zero, zero)


def _around(unknowns: Unknowns, peak: Peak, count: int) -> Nuisance:
    """Spread cases around the most probable values."""
    has_focal = unknowns.scene.focal_rel_std > 0
    scores, log_density = _cloud(unknowns.dimensions - has_focal, count)
    if has_focal:
        scores, log_density = _with_focal(scores, log_density)
    points = bounded(unknowns, peak.theta + np.einsum("nij,qj->qni", peak.root, scores))
    log_prior = unknowns.log_prior(points) + unknowns.noise.log_prior
    return unknowns.nuisance(points)._replace(
        log_prior=log_prior + peak.log_volume - log_density[:, None]
    )


def _with_focal(scores: FloatArray, log_density: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Add scores of the focal length, none wide: its prior has no far tails."""
    from scipy import special  # noqa: PLC0415 - tens of milliseconds of import

    focal = special.ndtri(_GOLDEN * np.arange(1, len(scores) + 1) % 1)
    return np.column_stack([scores, focal]), log_density - 0.5 * focal**2


def _cloud(dimensions: int, count: int) -> tuple[FloatArray, FloatArray]:
    """Spread standard scores evenly, and the log of their density up to a constant."""
    from scipy import special  # noqa: PLC0415 - tens of milliseconds of import

    # the generalised golden ratios, an additive recurrence of low discrepancy
    root = 2.0
    for _ in range(60):
        root = (1 + root) ** (1 / (dimensions + 1))
    step = root ** -np.arange(1.0, dimensions + 1)
    scores: FloatArray = special.ndtri((0.5 + step * np.arange(1, count + 1)[:, None]) % 1)
    wide = np.arange(count) % 5 < 5 * _WIDE_SHARE
    scores[wide] *= _WIDE
    square = 0.5 * (scores**2).sum(axis=1)
    narrow = (1 - _WIDE_SHARE) * np.exp(-square)
    broad = _WIDE_SHARE * np.exp(-square / _WIDE**2) / _WIDE**dimensions
    return scores, np.log(narrow + broad)
