"""What the solutions say of sizes: every answer is a mixture over the cases."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imgscale._typing import FloatArray, IntArray
from imgscale.core.estimator import log_k_std, view_from_others
from imgscale.core.mixture import MEDIAN, SCORES, Mixture
from imgscale.core.posterior import log_evidence, view_on_grid
from imgscale.core.segments import View, normalised
from imgscale.core.sighting import Sighting, observe_under, sight, subjects_under
from imgscale.core.solving import Cases
from imgscale.core.witnesses import Sized

# Variances below this are rounding.
_LEAST = 1e-24
# Where widths are compared: scores from 1 to 2, the 68 to 95 % intervals.
_UPPER = np.arange(MEDIAN + 4, MEDIAN + 9)
_LOWER = SCORES.size - 1 - _UPPER
# Points of a grid are widened to 0.6 steps: a Gaussian of theirs is then smooth within 1e-4.
_BLEND = 0.6**2


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
    return measured(cases, _images(cases))


def scale_under(cases: Cases) -> Mixture:
    """
    Tell what is known of log k of one image under each case, for what is no size k d p.

    Parameters
    ----------
    cases : Cases
        The solutions of one image.

    Returns
    -------
    Mixture
        One row for each case. Its weights are joint ones: they sum to 1 over all rows.
    """
    view, _ = _seen_by_strangers(cases, _images(cases))
    log_weight = view.log_weight - view.log_weight.max()
    weight, mean, variance = (
        column[:, 0] for column in _blended(log_weight, view.log_k, view.log_k_var)
    )
    return Mixture(weight / weight.sum(), mean, variance)


def _images(cases: Cases) -> Sized:
    """Make an object for each image whose size is its k."""
    n_images = cases.log_weight.shape[1]
    zeros, sure = np.zeros(n_images), np.ones(n_images, dtype=np.bool_)
    return cases.witnesses._replace(
        inverse_depth=zeros, log_pixels=zeros, noise_var=zeros, tau=zeros,
        image=np.arange(n_images), group=np.full(n_images, -1), told=sure, firm=sure, stance=None,
    )  # fmt: skip


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
    view, seen = _seen_by_strangers(cases, subjects)
    log_weight = view.log_weight + seen.log_weight[..., None]
    log_weight = log_weight - log_weight.max(axis=(0, 1, 3), keepdims=True)
    clouds: list[Mixture] = []
    for way in range(len(seen.log_size)):
        log_size: FloatArray = seen.log_size[way]
        finite = np.isfinite(log_size)
        mean = view.log_k + np.where(finite, log_size, 0.0)[..., None]
        cloud = _blended(log_weight[way], mean, view.log_k_var + seen.variance[way][..., None])
        # where there is no depth, nothing is known; beyond the horizon the size has no bound
        lost = np.where(np.isposinf(log_size), np.inf, np.nan)[..., None]
        clouds.append(cloud._replace(mean=np.where(finite[..., None], mean, lost)))
    return _mix(clouds)


def _seen_by_strangers(cases: Cases, subjects: Sized) -> tuple[View, Sighting]:
    """Look at objects that share no label's offset with the references."""
    nobody = np.full(subjects.group.size, -1)
    strangers = subjects._replace(group=nobody, tau=np.zeros(subjects.tau.size))
    view, seen = _look(cases, strangers, nobody)
    if cases.grid is None:  # log k as it was fitted, with the error that was declared
        image = (
            subjects.image + cases.log_weight.shape[1] * np.arange(cases.nuisance.n_cases)[:, None]
        )
        log_k, log_std = cases.fit.log_k[image], cases.fit.log_std[image]
        view = view._replace(log_k=log_k[..., None], log_k_var=log_std[..., None] ** 2)
    return view, seen


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
    seen = sight(references, cases.nuisance)
    alone = references.noise_var - common_var  # what is its own error, in no way that of k
    common = seen.variance - alone
    variance = np.maximum(log_k_var + seen.variance - 2 * share * common, 0.0)
    mean = log_k + seen.log_size
    weight = normalised(cases.log_weight, 0)[:, references.image] * seen.share
    return _mix(
        [
            Mixture(*(part[..., None] for part in way))
            for way in zip(weight, mean, variance, strict=True)
        ]
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
    view, seen = _look(cases, subjects, own)
    kinds: list[Mixture] = []  # with the logs of the weights
    for way in range(len(seen.log_size)):
        log_size: FloatArray = seen.log_size[way]
        alone = np.isnan(view.log_k) | ~np.isfinite(log_size)[..., None]
        log_weight = view.log_weight + seen.log_weight[way][..., None]
        noise_var = seen.variance[way][..., None]
        for share, kind_mean, kind_var in zip(*(part.T for part in subjects.prior), strict=True):
            a, b = kind_mean[:, None] - view.offset, view.log_k + log_size[..., None]
            var_a, var_b = kind_var[:, None] + view.offset_var, view.log_k_var + noise_var
            spread = np.where(alone, 1.0, np.maximum(var_a + var_b + 2 * view.covariance, _LEAST))
            gap = np.where(alone, 0.0, b - a)
            gain = np.where(alone, 0.0, (var_a + view.covariance) / spread)
            with np.errstate(divide="ignore"):
                log_share = np.log(share)[:, None]
            kinds.append(
                Mixture(
                    log_weight + log_share - 0.5 * (gap**2 / spread + np.log(spread)),
                    a + gain * gap,
                    np.maximum(var_a - gain * (var_a + view.covariance), 0.0),
                )
            )
    peak = np.max([_peak(kind.weight) for kind in kinds], axis=0)
    return _mix([_blended(kind.weight - peak, kind.mean, kind.variance) for kind in kinds])


def with_priors(cases: Cases, subjects: Sized, own: IntArray) -> FloatArray:
    """
    Compute the quantiles of log sizes with the objects' own priors, never wider than those.

    Parameters
    ----------
    cases : Cases
        The solutions.
    subjects : Sized
        The objects, all with priors.
    own : (M,) ndarray of int
        Which reference each was; -1 for none.

    Returns
    -------
    (M, 29) ndarray of float64
        Quantiles at the standard scores. Where a measurement contradicts a prior so much that
        both together are wider, the prior stands alone.
    """
    together = fused(cases, subjects, own).quantiles()
    alone = prior_alone(subjects).quantiles()
    wider = (together[:, _UPPER] - together[:, _LOWER]) > (alone[:, _UPPER] - alone[:, _LOWER])
    return np.where(np.any(wider, axis=1, keepdims=True), alone, together)


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
    view, _ = _look(cases, candidates, own, declared=True)
    shape = (cases.nuisance.n_cases, -1)
    alone = observe_under(candidates, cases.nuisance)
    observed = alone.y.reshape(shape)[..., None]
    own_var = alone.variance.reshape(shape)[..., None]
    residual = observed - view.log_k - view.offset
    variance = view.log_k_var + view.offset_var + 2 * view.covariance + own_var
    weight = np.exp(view.log_weight - _peak(view.log_weight))
    mixture = _mix([Mixture(weight, residual, variance)])
    mean = (mixture.weight * mixture.mean).sum(axis=1)
    spread = mixture.variance + (mixture.mean - mean[:, None]) ** 2
    z_scores: FloatArray = mean / np.sqrt((mixture.weight * spread).sum(axis=1))
    return z_scores


def _look(
    cases: Cases, subjects: Sized, own: IntArray, *, declared: bool = False
) -> tuple[View, Sighting]:
    """View of each object (K, M, C), and what it looks like (H, K, M)."""
    seen = sight(subjects, cases.nuisance)
    if subjects.stance is None or not subjects.stance.is_new.all():
        # a foot that was a witness of the plane is in the weights of the cases
        is_new = False if subjects.stance is None else subjects.stance.is_new
        known = seen.log_weight - np.where(is_new, 0.0, seen.evidence)
        seen = seen._replace(log_weight=known)
    columns = subjects_under(subjects, own, cases.witnesses, cases.nuisance)
    if cases.grid is not None:
        view = view_on_grid(cases.grid, columns)
        log_prior = (cases.log_weight - log_evidence(cases.grid).reshape(cases.log_weight.shape))[
            :, subjects.image
        ]
    else:
        fit = cases.fit
        if declared:  # by the errors as they were told, so that a disagreement shows
            fit = fit._replace(weight=fit.trust / cases.obs.variance)
        view = view_from_others(cases.obs, fit, columns)
        log_prior = cases.log_weight[:, subjects.image]
    view = View(*(column.reshape(*seen.log_size.shape[1:], column.shape[1]) for column in view))
    return view._replace(log_weight=view.log_weight + log_prior[..., None]), seen


def _blended(log_weight: FloatArray, mean: FloatArray, variance: FloatArray) -> Mixture:
    """
    Make a mixture (K, M, C), whose components may be points of a grid, smooth along C.

    Points are widened to 0.6 of their spacing, and the weights w sharpened by as much: with D
    second differences and t the added variance in squared steps,
    w - D(t w) / 2 + D D((t / 24 + t^2 / 8) w) undoes it.
    """
    weight = np.exp(log_weight)
    if mean.shape[2] == 1:
        return Mixture(weight, mean, variance)
    spacing = np.gradient(mean, axis=2) ** 2
    added = np.maximum(_BLEND * spacing - variance, 0.0)
    t = added / np.maximum(spacing, _LEAST)
    sharper = (
        weight
        - _second_difference(t * weight) / 2
        + _second_difference(_second_difference((t / 24 + t**2 / 8) * weight))
    )
    return Mixture(np.maximum(sharper, 0.0), mean, variance + added)


def _second_difference(values: FloatArray) -> FloatArray:
    """Second difference along the last axis, beyond whose ends the values are 0."""
    padded = np.pad(values, ((0, 0), (0, 0), (1, 1)))
    difference: FloatArray = padded[..., 2:] - 2 * values + padded[..., :-2]
    return difference


def _peak(log_weight: FloatArray) -> FloatArray:
    """Largest log weight of each object over all cases."""
    peak: FloatArray = log_weight.max(axis=(0, 2), keepdims=True)
    return peak


def _mix(clouds: Sequence[Mixture]) -> Mixture:
    """Gather all cases of each object in one row; what lies at infinity weighs, and is left out."""
    n_subjects = clouds[0].mean.shape[1]

    def rows(column: FloatArray) -> FloatArray:
        by_object = np.moveaxis(column, 1, 0)
        return by_object.reshape(n_subjects, column.shape[0] * column.shape[2])

    weight, mean, variance = (
        np.concatenate([rows(part) for part in parts], axis=1)
        for parts in zip(*clouds, strict=True)
    )
    weight = weight / weight.sum(axis=1, keepdims=True)
    infinite = np.isposinf(mean)
    return Mixture(
        weight=np.where(infinite, 0.0, weight),
        mean=np.where(infinite, 0.0, mean),
        variance=variance,
    )
