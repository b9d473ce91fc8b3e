"""What the solutions say of sizes: every answer is a mixture over the cases."""

from __future__ import annotations

import numpy as np

from imgscale._typing import FloatArray, IntArray
from imgscale.estimator import log_k_std, view_from_others
from imgscale.mixture import Mixture
from imgscale.posterior import view_on_grid
from imgscale.segments import View, normalised
from imgscale.solving import Cases
from imgscale.witnesses import Sized, subjects_under

# Variances below this are rounding.
_LEAST = 1e-24


def scale_of(cases: Cases) -> Mixture:
    """
    Tell what is known of log k.

    Parameters
    ----------
    cases : Cases
        The solutions.

    Returns
    -------
    Mixture
        One row for each image.
    """
    n_images = cases.log_weight.shape[1]
    zeros, sure = np.zeros(n_images), np.ones(n_images, dtype=np.bool_)
    images = cases.witnesses._replace(
        inverse_depth=zeros, log_pixels=zeros, noise_var=zeros, tau=zeros,
        image=np.arange(n_images), group=np.full(n_images, -1), told=sure, firm=sure,
    )  # fmt: skip
    return measured(cases, images)


def measured(cases: Cases, subjects: Sized) -> Mixture:
    """
    Tell what is known of the log sizes k d p of objects, without their priors.

    Parameters
    ----------
    cases : Cases
        The solutions.
    subjects : Sized
        The objects.

    Returns
    -------
    Mixture
        One row for each object; mass beyond the horizon is missing.
    """
    nobody = np.full(subjects.group.size, -1)
    strangers = subjects._replace(group=nobody, tau=np.zeros(subjects.tau.size))
    view, log_size, noise_var = _look(cases, strangers, nobody)
    if cases.grid is None:  # log k as it was fitted, with the error that was declared
        image = subjects.image + cases.log_weight.shape[1] * np.arange(len(log_size))[:, None]
        log_k, log_std = cases.fit.log_k[image], cases.fit.log_std[image]
        view = view._replace(log_k=log_k[..., None], log_k_var=log_std[..., None] ** 2)
    finite = np.where(np.isposinf(log_size), 0.0, log_size)
    mean, variance = _widened(
        cases,
        subjects,
        view.log_weight,
        view.log_k + finite[..., None],
        view.log_k_var,
        noise_var,
    )
    return _mix(view.log_weight, np.where(np.isposinf(log_size)[..., None], np.inf, mean), variance)


def measured_again(
    cases: Cases, references: Sized, share: FloatArray, common_var: FloatArray
) -> Mixture:
    """
    Tell what is known of the log sizes k d p of references, whose errors are in k already.

    Parameters
    ----------
    cases : Cases
        The solutions.
    references : Sized
        The references.
    share : (M,) ndarray of float
        Share of each in log k.
    common_var : (M,) ndarray of float
        Variance, as far as it was told, of the errors that it shares with k.

    Returns
    -------
    Mixture
        One row for each; every reference is taken for what it was believed to be.

    Notes
    -----
    The errors e of a reference are in k by its share: var(log k - share e + e) = var(log k) +
    (1 - 2 share) var(e).
    """
    shape = cases.log_weight.shape
    log_k = cases.fit.log_k.reshape(shape)[:, references.image]
    log_std = cases.fit.log_std if cases.grid is None else log_k_std(cases.obs, cases.fit.share)
    log_k_var = log_std.reshape(shape)[:, references.image] ** 2
    noise_var = references.noise_under(cases.nuisance)
    common = common_var + noise_var - references.noise_var
    variance = np.maximum(log_k_var + noise_var - 2 * share * common, 0.0)
    return _mix(
        cases.log_weight[:, references.image, None],
        (log_k + references.log_size(cases.nuisance))[..., None],
        variance[..., None],
    )


def fused(cases: Cases, subjects: Sized, own: IntArray) -> Mixture:
    """
    Tell what is known of the log sizes of objects with their own priors.

    Parameters
    ----------
    cases : Cases
        The solutions.
    subjects : Sized
        The objects.
    own : (M,) ndarray of int
        Which reference each was, that its prior is not told twice; -1 for none.

    Returns
    -------
    Mixture
        One row for each object; NaN without a prior.

    Notes
    -----
    In each case the best linear combination of A = prior - u and B = log k + log(d p), whose
    covariance is -cov(log k, u).
    """
    view, log_size, noise_var = _look(cases, subjects, own)
    alone = np.isnan(view.log_k) | ~np.isfinite(log_size)[..., None]
    parts: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    for share, kind_mean, kind_var in zip(*(column.T for column in subjects.prior), strict=True):
        a, b = kind_mean[:, None] - view.offset, view.log_k + log_size[..., None]
        var_a, var_b = kind_var[:, None] + view.offset_var, view.log_k_var + noise_var[..., None]
        spread = np.where(alone, 1.0, np.maximum(var_a + var_b + 2 * view.covariance, _LEAST))
        gap = np.where(alone, 0.0, b - a)
        gain = np.where(alone, 0.0, (var_a + view.covariance) / spread)
        log_weight = view.log_weight - 0.5 * (gap**2 / spread + np.log(spread))
        variance = var_a - gain * (var_a + view.covariance)
        parts.append((log_weight + _log(share)[:, None], a + gain * gap, variance))
    log_weight, mean, variance = (
        np.concatenate(column, axis=2) for column in zip(*parts, strict=True)
    )
    nothing = np.zeros_like(noise_var)
    mean, variance = _widened(cases, subjects, log_weight, mean, variance, nothing)
    return _mix(log_weight, mean, variance)


def prior_alone(subjects: Sized) -> Mixture:
    """
    Tell what the priors alone say of objects.

    Parameters
    ----------
    subjects : Sized
        The objects.

    Returns
    -------
    Mixture
        Of their log sizes.
    """
    return Mixture(
        weight=subjects.prior.share,
        mean=subjects.prior.mean,
        variance=subjects.prior.variance + subjects.tau[:, None] ** 2,
    )


def residuals(cases: Cases, candidates: Sized, own: IntArray) -> FloatArray:
    """
    Compare references with all others of their image.

    Parameters
    ----------
    cases : Cases
        The solutions.
    candidates : Sized
        References.
    own : (M,) ndarray of int
        Their numbers.

    Returns
    -------
    (M,) ndarray of float64
        Observed minus expected log k, in standard errors; NaN where there is no other reference.
    """
    view, _, _ = _look(cases, candidates, own, declared=True)
    shape = (cases.nuisance.depth_var.size, -1)
    observed = cases.obs.y.reshape(shape)[:, own][..., None]
    own_var = cases.obs.variance.reshape(shape)[:, own][..., None]
    residual = observed - view.log_k - view.offset
    variance = view.log_k_var + view.offset_var + 2 * view.covariance + own_var
    mixture = _mix(view.log_weight, residual, np.broadcast_to(variance, residual.shape))
    mean = (mixture.weight * mixture.mean).sum(axis=1)
    spread = mixture.variance + (mixture.mean - mean[:, None]) ** 2
    z_scores: FloatArray = mean / np.sqrt((mixture.weight * spread).sum(axis=1))
    return z_scores


def _look(
    cases: Cases, subjects: Sized, own: IntArray, *, declared: bool = False
) -> tuple[View, FloatArray, FloatArray]:
    """View of each object (K, M, C), its log(d p) and the noise of that (K, M)."""
    log_size = subjects.log_size(cases.nuisance)
    noise_var = subjects.noise_under(cases.nuisance)
    columns = subjects_under(subjects, own, cases.witnesses, cases.nuisance)
    if cases.grid is not None:
        view = view_on_grid(cases.grid, columns)
        log_prior = cases.nuisance.log_prior[:, subjects.image]
    else:
        fit = cases.fit
        if declared:  # by the errors as they were told, so that a disagreement shows
            fit = fit._replace(weight=fit.trust / cases.obs.variance)
        view = view_from_others(cases.obs, fit, columns)
        log_prior = cases.log_weight[:, subjects.image]
    view = View(*(column.reshape(*log_size.shape, column.shape[1]) for column in view))
    return view._replace(log_weight=view.log_weight + log_prior[..., None]), log_size, noise_var


def _widened(
    cases: Cases,
    subjects: Sized,
    log_weight: FloatArray,
    mean: FloatArray,
    variance: FloatArray,
    added: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """
    Add variance to components that may be points of a grid.

    Points are widened until they overlap and drawn together so much that mean and variance of
    the whole stay what they are.
    """
    if cases.grid is None:
        return mean, np.maximum(variance + added[..., None], 0.0)
    step = cases.grid.step.reshape(cases.log_weight.shape)[:, subjects.image][..., None]
    given = np.maximum(added[..., None], (step / 2) ** 2 - variance)
    weight = normalised(log_weight, 2)
    centre = (weight * mean).sum(axis=2, keepdims=True)
    between = (weight * (mean - centre) ** 2).sum(axis=2, keepdims=True)
    excess = (weight * (given - added[..., None])).sum(axis=2, keepdims=True)
    kept = np.maximum(1 - excess / np.maximum(between, _LEAST), 0.0)
    return centre + (mean - centre) * np.sqrt(kept), variance + given


def _mix(log_weight: FloatArray, mean: FloatArray, variance: FloatArray) -> Mixture:
    """Gather all cases of each object in one row; what lies at infinity weighs, and is left out."""
    n_subjects = mean.shape[1]

    def rows(column: FloatArray) -> FloatArray:
        return np.moveaxis(column, 1, 0).reshape(n_subjects, -1)

    weight, mean = normalised(rows(log_weight), 1), rows(mean)
    infinite = np.isposinf(mean)
    return Mixture(
        weight=np.where(infinite, 0.0, weight),
        mean=np.where(infinite, 0.0, mean),
        variance=rows(variance),
    )


def _log(values: FloatArray) -> FloatArray:
    """Logarithm, -inf for 0."""
    with np.errstate(divide="ignore"):
        return np.log(values)
