"""The most probable ground plane of an image: a coarse search, then robust Gauss-Newton steps."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from imgscale._typing import FloatArray, IntArray
from imgscale.core.estimator import fit_robust
from imgscale.core.segments import LogObservations, median_by, sum_by
from imgscale.core.sighting import compare, observe_under, sight
from imgscale.core.unknowns import HORIZON_DOF, Unknowns, stance_of
from imgscale.core.witnesses import Nuisance, Sized, numbered

# Where the search starts: log of the median foot's distance from the horizon, in heights of the
# image, slopes in standard deviations, and the shift; the best two starts are followed.
_STARTS = np.linspace(math.log(0.02), math.log(8.0), 25)
_SLOPE_STARTS = np.array([-2.4, -1.2, 0.0, 1.2, 2.4])
_SHIFT_STARTS = np.linspace(math.log(0.02), math.log(20.0), 9)
_FOLLOWED = 2
_NEAREST, _FARTHEST = 1e-4, 50.0
# The noise of the first steps, which takes up how far the start is off; it shrinks by 5 once
# steps are smaller than it.
_FIRST_NOISE, _COOLING, _STEPS = 0.1, 0.2, 50
_PATIENCE = 6
# Noise below this share of the errors is none, and steps below this share have arrived.
_QUIET, _ARRIVED = 0.05, 1e-4
_LARGEST_STEP, _LARGEST_SLOPE_STEP = 0.5, 0.02
_PERTURBATION = 1e-5


class Peak(NamedTuple):
    """
    Most probable unknowns and their errors.

    Attributes
    ----------
    theta : (n, d) ndarray of float64
        The unknowns of each image.
    root : (n, d, d) ndarray of float64
        A lower root of their covariance.
    """

    theta: FloatArray
    root: FloatArray

    @property
    def log_volume(self) -> FloatArray:
        """Log of the volume of the errors, (n,)."""
        volume: FloatArray = np.log(np.einsum("nii->ni", self.root)).sum(axis=1)
        return volume


def starts(unknowns: Unknowns) -> FloatArray:
    """
    Find the best of a grid of values.

    Parameters
    ----------
    unknowns : Unknowns
        The unknowns of n images.

    Returns
    -------
    (3, n, d) ndarray of float64
        The best two, of different slopes, and the horizon that was to be expected.
    """
    slopes = unknowns.scene.slope + _SLOPE_STARTS * unknowns.scene.slope_std
    axes = [_STARTS + math.log(unknowns.scene.span), slopes]
    if unknowns.shifts is not None:
        axes = [axes[0][::2], axes[1], _SHIFT_STARTS]
    grid = [part.reshape(-1, 1) for part in np.meshgrid(*axes, indexing="ij")]
    theta = np.zeros((len(grid[0]), unknowns.n_images, unknowns.dimensions))
    theta[..., 0], theta[..., 1] = grid[0], grid[1]
    if unknowns.shifts is not None:
        theta[..., 3] = grid[2]
    if unknowns.scene.has_depth:
        theta[..., 2] = _median_gap(unknowns, unknowns.nuisance(theta))
    seen = unknowns.blurred(_FIRST_NOISE)
    weight = seen.log_likelihood(seen.nuisance(theta)) + unknowns.log_prior(theta)
    everyone = np.arange(unknowns.n_images)
    best: list[FloatArray] = []
    values: list[FloatArray] = []
    for slope in axes[1]:
        among = np.flatnonzero(theta[:, 0, 1] == slope)
        rows = among[np.argmax(weight[among], axis=0)]
        best.append(weight[rows, everyone])
        values.append(theta[rows, everyone])
    order = np.argsort(-np.array(best), axis=0)[:_FOLLOWED]
    followed = np.take_along_axis(np.array(values), order[:, :, None], axis=0)
    expected = followed[:1].copy()
    nearest = _NEAREST * unknowns.scene.span
    expected[0, :, 0] = np.log(np.maximum(unknowns.foot - unknowns.scene.horizon, nearest))
    expected[0, :, 1] = unknowns.scene.slope
    if unknowns.scene.has_depth:
        expected[..., 2] = _median_gap(unknowns, unknowns.nuisance(expected))
    return np.concatenate([followed, expected])


def climb(unknowns: Unknowns, theta: FloatArray) -> Peak:
    """
    Improve the unknowns by re-weighted Gauss-Newton steps.

    Parameters
    ----------
    unknowns : Unknowns
        The unknowns of n images.
    theta : (n, d) ndarray of float
        Where to start.

    Returns
    -------
    Peak
        The most probable values; log k and the labels' offsets are integrated out.
    """
    noise, waited = _FIRST_NOISE, 0
    quiet = _QUIET * _least_std(unknowns, theta)
    largest = np.full(theta.shape[1], _LARGEST_STEP)
    largest[1] = _LARGEST_SLOPE_STEP
    information = np.empty(0)
    scale = np.ones_like(theta)
    for _ in range(_STEPS):
        step, information = _step(unknowns.blurred(noise), theta)
        theta = bounded(unknowns, theta + np.clip(step, -largest, largest))
        scale = np.sqrt(np.einsum("nii->ni", information))
        if noise == 0 and np.all(np.abs(step) * scale < _ARRIVED):
            break
        waited += 1
        if np.abs(step / largest).max() < 2 * noise or waited == _PATIENCE:
            noise, waited = noise * _COOLING, 0
        noise = noise if noise > quiet else 0.0
    scaled = information / (scale[:, :, None] * scale[:, None, :])
    root = np.linalg.cholesky(np.linalg.inv(scaled)) / scale[:, :, None]
    return Peak(theta, root)


def bounded(unknowns: Unknowns, theta: FloatArray) -> FloatArray:
    """
    Keep the horizon where pictures have it.

    Parameters
    ----------
    unknowns : Unknowns
        The unknowns.
    theta : (..., d) ndarray of float
        Their values.

    Returns
    -------
    (..., d) ndarray of float64
        The median foot 1e-4 to 50 heights of the image from the horizon.
    """
    inside = theta.copy()
    limits = math.log(_NEAREST * unknowns.scene.span), math.log(_FARTHEST * unknowns.scene.span)
    inside[..., 0] = np.clip(theta[..., 0], *limits)
    return inside


def log_mass(unknowns: Unknowns, peak: Peak) -> FloatArray:
    """
    Compute the probability about a peak, by Laplace's method.

    Parameters
    ----------
    unknowns : Unknowns
        The unknowns of n images.
    peak : Peak
        Their peak.

    Returns
    -------
    (n,) ndarray of float64
        Its log, up to a constant.
    """
    theta = peak.theta[None]
    density = unknowns.log_likelihood(unknowns.nuisance(theta)) + unknowns.log_prior(theta)
    log_mass: FloatArray = (density + unknowns.noise.log_prior)[0] + peak.log_volume
    return log_mass


def _median_gap(unknowns: Unknowns, nuisance: Nuisance) -> FloatArray:
    """Median of how far depths and feet disagree; without both, what the camera's height says."""
    count, n_images = nuisance.n_cases, unknowns.n_images
    nuisance = nuisance._replace(gap=np.zeros_like(nuisance.shift))
    first = n_images * np.arange(count)[:, None]
    segments: list[IntArray] = []
    values: list[FloatArray] = []
    weights: list[FloatArray] = []
    for part in (unknowns.witnesses, unknowns.bystanders):
        seen = compare(part, stance_of(part), nuisance)
        segments.append((part.image + first)[seen.has_both])
        values.append(seen.apart[seen.has_both])
        weights.append(1 / seen.total_var[seen.has_both])
    segments.append(np.arange(count * n_images))
    values.append(_height_gap(unknowns.witnesses, nuisance))
    weights.append(np.full(count * n_images, 1e-3))
    gap = median_by(
        np.concatenate(segments),
        np.concatenate(values),
        np.concatenate(weights),
        count * n_images,
    )
    return gap.reshape(count, -1)


def _height_gap(witnesses: Sized, nuisance: Nuisance) -> FloatArray:
    """Log of the camera's height as it was told, over k as depths alone say it."""
    count, n_images = nuisance.shift.shape
    is_height = stance_of(witnesses).is_height
    height = np.zeros(n_images)
    height[witnesses.image[is_height]] = witnesses.prior_log[is_height]
    sized = witnesses.rows(~is_height)
    if not sized.image.size:  # depths and feet alone must tell
        return np.tile(height, count)
    by_depth = compare(sized, stance_of(sized), nuisance).by_depth
    own_k = sized.prior_log - np.where(np.isfinite(by_depth), by_depth, 0.0)
    place = numbered(sized.image, count, n_images)
    log_k = median_by(place, own_k.ravel(), np.ones(place.size), count * n_images)
    gap: FloatArray = np.tile(height, count) - log_k
    return gap


def _least_std(unknowns: Unknowns, theta: FloatArray) -> float:
    """Error of the most precise witness."""
    nuisance = unknowns.nuisance(theta[None])
    least = float(observe_under(unknowns.witnesses, nuisance).total_std.min())
    for part in (unknowns.witnesses, unknowns.bystanders):
        seen = compare(part, stance_of(part), nuisance)
        least = min(least, math.sqrt(seen.total_var[seen.has_both].min(initial=math.inf)))
    return least


def _step(unknowns: Unknowns, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute one step and the information on the unknowns."""
    size = theta.shape[1]
    moves = np.concatenate([np.zeros((1, size)), np.eye(size), -np.eye(size)])
    nuisance = unknowns.nuisance(theta + _PERTURBATION * moves[:, None, :])
    matrix, gradient = _sizes(unknowns, nuisance)
    parts = [_feet(part, nuisance) for part in (unknowns.witnesses, unknowns.bystanders)]
    for more_matrix, more_gradient in (*parts, _prior(unknowns, theta)):
        matrix[:, 1:, 1:] += more_matrix
        gradient[:, 1:] += more_gradient
    step = np.linalg.solve(matrix, gradient[..., None])[..., 0]
    cross = matrix[:, 1:, 0]
    information = matrix[:, 1:, 1:] - cross[:, :, None] * cross[:, None, :] / matrix[:, :1, :1]
    return np.asarray(step[:, 1:], dtype=np.float64), information


def _sizes(unknowns: Unknowns, nuisance: Nuisance) -> tuple[FloatArray, FloatArray]:
    """Set up the normal equations of log k and unknowns from sizes, offsets integrated out."""
    moved = observe_under(unknowns.witnesses, nuisance)
    y = moved.y.reshape(nuisance.n_cases, -1)
    here = slice(y.shape[1])  # the first case
    obs = LogObservations(
        y=moved.y[here],
        variance=moved.variance[here],
        tau=moved.tau[here],
        image=moved.image[here],
        group=moved.group[here],
        firm=moved.firm[here],
    )
    fit = fit_robust(obs)
    rows = np.concatenate([-np.ones((1, y.shape[1])), _slopes(y)]).T
    residual, weight = y[0] - fit.log_k[obs.image], fit.trust / obs.variance
    image, tau = obs.of_groups()
    shrink = tau**2 / (1 + tau**2 * sum_by(obs.group, weight))
    sums = sum_by(obs.group, weight[:, None] * rows)
    left = sum_by(obs.group, weight * residual)
    matrix = sum_by(obs.image, (weight[:, None] * rows)[:, :, None] * rows[:, None, :])
    matrix -= sum_by(image, (shrink[:, None] * sums)[:, :, None] * sums[:, None, :])
    gradient = -sum_by(obs.image, (weight * residual)[:, None] * rows)
    gradient += sum_by(image, (shrink * left)[:, None] * sums)
    matrix[:, 0, 0] = np.maximum(matrix[:, 0, 0], 1e-12)
    return matrix, gradient


def _feet(objects: Sized, nuisance: Nuisance) -> tuple[FloatArray, FloatArray]:
    """Set up those of the unknowns from what depths and feet say of each other."""
    size, n_images = (nuisance.n_cases - 1) // 2, nuisance.shift.shape[1]
    matrix, gradient = np.zeros((n_images, size, size)), np.zeros((n_images, size))
    seen = compare(objects, stance_of(objects), nuisance)
    both = np.all(seen.has_both, axis=0)
    if not both.any():
        return matrix, gradient
    share = sight(objects, nuisance.cases(np.array([0]))).share[0, 0]
    weight = np.where(both, share / seen.total_var[0], 0.0)
    rows = np.where(both, _slopes(seen.apart), 0.0).T
    weighted = weight[:, None] * rows
    np.add.at(matrix, objects.image, weighted[:, :, None] * rows[:, None, :])
    np.add.at(gradient, objects.image, -weighted * seen.apart[0][:, None])
    return matrix, gradient


def _prior(unknowns: Unknowns, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Set up those of the unknowns from their prior."""
    scene, size = unknowns.scene, theta.shape[1]
    matrix, gradient = np.zeros((len(theta), size, size)), np.zeros((len(theta), size))
    below = np.exp(theta[:, 0])
    apart = unknowns.foot - below - scene.horizon
    precision = np.full(below.size, scene.horizon_std**-2)
    if not scene.is_given:  # Student's distribution as a weight
        square = apart**2 * precision
        precision = precision * (HORIZON_DOF + 1) / (HORIZON_DOF + square)
    askew = theta[:, 1] - scene.slope
    matrix[:, 0, 0] = precision * below**2 + 1e-9
    gradient[:, 0] = (precision * apart + scene.cross * askew) * below
    matrix[:, 1, 1] = scene.slope_std**-2
    gradient[:, 1] = -(askew * scene.slope_std**-2 + scene.cross * apart)
    matrix[:, 0, 1] = matrix[:, 1, 0] = -scene.cross * below
    if scene.has_depth:
        matrix[:, 2, 2] = 1e-6
    if scene.focal_rel_std:
        matrix[:, -1, -1] = scene.focal_rel_std**-2
        gradient[:, -1] = -theta[:, -1] * scene.focal_rel_std**-2
    if unknowns.shifts is not None:
        shift = unknowns.shifts.shift(theta[:, 3])
        change = unknowns.shifts.spread * np.exp(theta[:, 3])
        matrix[:, 3, 3] = (change / unknowns.shifts.width) ** 2 + 1e-9
        gradient[:, 3] = -shift * change / unknowns.shifts.width**2
    return matrix, gradient


def _slopes(values: FloatArray) -> FloatArray:
    """Derive (d, N) from values here, a little beyond and a little before (1 + 2 d, N)."""
    size = (len(values) - 1) // 2
    slopes: FloatArray = (values[1 : 1 + size] - values[1 + size :]) / (2 * _PERTURBATION)
    return slopes
