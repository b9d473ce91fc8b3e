"""What the solutions say of sizes: every answer is a mixture over the cases."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from imgscale._typing import BoolArray, FloatArray, IntArray
from imgscale.core.estimator import log_k_std, view_from_others
from imgscale.core.mixture import SCORES, Mixture, half_between
from imgscale.core.posterior import log_evidence, view_on_grid
from imgscale.core.segments import MIN_VARIANCE, Subjects, View, normalised
from imgscale.core.sighting import Sighting, observe_under, sight, subjects_under
from imgscale.core.solving import Cases
from imgscale.core.witnesses import Nuisance, Sized

# Variances below this are rounding.
_LEAST = 1e-24
# Where widths are compared: scores from 1 to 2, the 68 to 95 % intervals; and the median.
_OF_WIDTHS: FloatArray = SCORES[(np.abs(SCORES) >= 1) & (np.abs(SCORES) <= 2)]
_FEW_SCORES: FloatArray = np.sort(np.append(_OF_WIDTHS, 0.0))
_MIDDLE = _FEW_SCORES.size // 2
# Points of a grid are widened to 0.6 steps: a Gaussian of theirs is then smooth within 1e-4.
_BLEND = 0.6**2
# Objects are looked at so many at once that their components stay below this, yet never one by one;
# of a posterior grid about so many points count.
_COMPONENTS, _LEAST_AT_ONCE, _POINTS = 1_000_000, 16, 100


def in_parts(cases: Cases, subjects: Sized) -> tuple[Cases, list[IntArray]]:
    """
    Cut objects into as many at once as memory allows to look at, each under every case.

    Parameters
    ----------
    cases : Cases
        The solutions.
    subjects : Sized
        The objects.

    Returns
    -------
    cases : Cases
        The same, with what every part of one image's objects looks at.
    parts : list of ndarray of int
        Rows of each part.
    """
    points = 1 if cases.grid is None else _POINTS
    width: int = len(cases.log_weight) * points * subjects.prior.share.shape[1]
    at_once = max(_LEAST_AT_ONCE, _COMPONENTS // max(width, SCORES.size))
    rows: IntArray = np.arange(subjects.image.size, dtype=np.intp)
    parts = [rows[start : start + at_once] for start in range(0, rows.size, at_once)]
    if cases.grid is not None and cases.log_weight.shape[1] == 1 and len(parts) > 1:
        cases = cases._replace(grid=cases.grid.keeping())
    return cases, parts


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
    if cases.grid is not None:
        return measured(cases, _images(cases))
    weight = normalised(cases.log_weight, 0).T
    log_k, log_std = (part.reshape(cases.log_weight.shape).T for part in cases.fit[:2])
    return Mixture(weight, log_k, log_std**2)


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
        column[:, 0] for column in _blended(np.exp(log_weight), view.log_k, view.log_k_var)
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
    mean = view.log_k + seen.log_size[..., None]
    variance = view.log_k_var + seen.variance[..., None]
    if mean.shape[0] * mean.shape[1] * mean.shape[3] == 1:  # one Gaussian, if it is anywhere
        known = np.where(np.isposinf(mean), np.nan, mean)[0, 0]
        return Mixture(np.ones_like(known), known, variance[0, 0])
    weight = _relative(view.log_weight + seen.log_weight[..., None])
    finite = np.isfinite(seen.log_size)
    if finite.all():
        return _mix(*_blended(weight, mean, variance))
    # where there is no depth, nothing is known; beyond the horizon the size has no bound
    lost = np.where(np.isposinf(seen.log_size), np.inf, np.nan)[..., None]
    mean = view.log_k + np.where(finite, seen.log_size, 0.0)[..., None]
    weight, mean, variance = _blended(weight, mean, variance)
    return _mix(weight, np.where(finite[..., None], mean, lost), variance)


def _seen_by_strangers(cases: Cases, subjects: Sized) -> tuple[View, Sighting]:
    """Look at objects that share no label's offset with the references."""
    if cases.grid is None:  # log k as it was fitted, with the error that was declared
        shape = cases.log_weight.shape
        log_k, log_std, log_weight = (
            part.reshape(shape)[:, subjects.image, None]
            for part in (cases.fit.log_k, cases.fit.log_std, cases.log_weight)
        )
        nothing = np.zeros_like(log_k)
        view = View(log_weight, log_k, log_std**2, nothing, nothing, nothing)
        return view, _news(subjects, cases.nuisance)
    nobody = np.full(subjects.group.size, -1)
    strangers = subjects._replace(group=nobody, tau=np.zeros(subjects.tau.size))
    look = _look(cases, strangers, nobody)
    return _view(cases, look), look.seen


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
    if len(mean) * len(log_k) == 1:
        return Mixture(np.ones_like(mean[0].T), mean[0].T, variance[0].T)
    weight = normalised(cases.log_weight, 0)[:, references.image] * seen.share
    return _mix(weight[..., None], mean[..., None], variance[..., None])


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
    look = _look(cases, subjects, own)
    return _fused(look, _view(cases, look))


def _fused(look: _Look, view: View) -> Mixture:
    """Fuse what the others say with the objects' own priors: (H, J, K, M, C)."""
    seen = look.seen
    log_size, noise_var = (part[:, None, :, :, None] for part in (seen.log_size, seen.variance))
    share, kind_mean, kind_var = (part.T[:, None, :, None] for part in look.subjects.prior)
    a, b = kind_mean - view.offset, view.log_k + log_size
    var_a, var_b = kind_var + view.offset_var, view.log_k_var + noise_var
    spread = np.maximum(var_a + var_b + 2 * view.covariance, _LEAST)
    gap = b - a
    gain = (var_a + view.covariance) / spread
    alone = ~np.isfinite(b)
    if alone.any():
        spread, gap, gain = (
            np.where(alone, value, part) for value, part in ((1.0, spread), (0.0, gap), (0.0, gain))
        )
    with np.errstate(divide="ignore"):
        log_weight = view.log_weight + np.log(share) - 0.5 * (gap**2 / spread + np.log(spread))
    mean = a + gain * gap
    variance = np.maximum(var_a - gain * (var_a + view.covariance), 0.0)
    log_weight = log_weight + seen.log_weight[:, None, :, :, None]
    return _mix(*_blended(_relative(log_weight), mean, variance))


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
    look = _look(cases, subjects, own)
    return _with_priors(look, _view(cases, look), SCORES)


def _with_priors(look: _Look, view: View, scores: FloatArray) -> FloatArray:
    """Quantiles at scores with the objects' own priors, never wider than those."""
    together, alone = _quantiles_of_both(_fused(look, view), prior_alone(look.subjects), scores)
    upper = np.flatnonzero((scores >= 1) & (scores <= _OF_WIDTHS[-1]))
    lower = scores.size - 1 - upper
    wider = (together[:, upper] - together[:, lower]) > (alone[:, upper] - alone[:, lower])
    worse = wider.any(axis=1)
    if worse.any():
        together[worse] = alone[worse]
    return together


def _quantiles_of_both(
    first: Mixture, second: Mixture, scores: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Quantiles of two mixtures, at once where they have as many components."""
    if first.mean.shape != second.mean.shape or first.mean.shape[1] == 1:
        return first.quantiles(scores), second.quantiles(scores)
    together = Mixture(*(np.concatenate(pair) for pair in zip(first, second, strict=True)))
    both = together.quantiles(scores)
    return both[: len(both) // 2], both[len(both) // 2 :]


class Explained(NamedTuple):
    """
    What the solutions say of candidates.

    Attributes
    ----------
    log_size, log_std : (M,) ndarray of float64
        Median of their log sizes with their own priors, as of `with_priors`, and half the width of
        the central 68.3 %.
    z_score : (M,) ndarray of float64
        Observed minus expected log k by all other references of its image, in standard errors; NaN
        where there is no other.
    """

    log_size: FloatArray
    log_std: FloatArray
    z_score: FloatArray


def explained(cases: Cases, candidates: Sized, own: IntArray) -> Explained:
    """
    Size candidates with their own priors, and compare them with all others of their image.

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
    Explained
        Both.
    """
    look = _look(cases, candidates, own)
    view = _view(cases, look)
    declared = _view(cases, look, declared=True) if _is_widened(cases) else view
    quantiles = _with_priors(look, view, _FEW_SCORES)
    return Explained(
        log_size=quantiles[:, _MIDDLE].copy(),
        log_std=half_between(quantiles[:, _MIDDLE - 1], quantiles[:, _MIDDLE + 1]),
        z_score=_residuals(cases, look, declared),
    )


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


def _residuals(cases: Cases, look: _Look, view: View) -> FloatArray:
    """Compare what references say with what all others do."""
    observed, own_var = _observed(cases, look)
    residual = observed - view.log_k - view.offset
    variance = view.log_k_var + view.offset_var + 2 * view.covariance + own_var
    if len(residual) * residual.shape[2] == 1:
        alone: FloatArray = residual[0, :, 0] / np.sqrt(variance[0, :, 0])
        return alone
    weight, residual, variance = _mix(_relative(view.log_weight), residual, variance)
    mean = (weight * residual).sum(axis=1)
    spread = variance + (residual - mean[:, None]) ** 2
    z_scores: FloatArray = mean / np.sqrt((weight * spread).sum(axis=1))
    return z_scores


def _observed(cases: Cases, look: _Look) -> tuple[FloatArray, FloatArray]:
    """Log k as each reference alone gives it, and its variance, (K, M, 1) each."""
    seen, references = look.seen, look.subjects
    if len(seen.log_size) == 1 and np.isfinite(seen.log_size).all():
        variance = np.maximum(references.prior_var + seen.variance[0], MIN_VARIANCE)
        return (references.prior_log - seen.log_size[0])[..., None], variance[..., None]
    alone = observe_under(references, cases.nuisance)
    shape = (cases.nuisance.n_cases, -1, 1)
    return alone.y.reshape(shape), alone.variance.reshape(shape)


class _Look(NamedTuple):
    """Objects (M), what they look like (H, K, M), and their numbers in each case (K M)."""

    subjects: Sized
    seen: Sighting
    columns: Subjects


def _look(cases: Cases, subjects: Sized, own: IntArray) -> _Look:
    """Look at objects under each case."""
    columns = subjects_under(subjects, own, cases.witnesses, cases.nuisance)
    return _Look(subjects, _news(subjects, cases.nuisance), columns)


def _news(subjects: Sized, nuisance: Nuisance) -> Sighting:
    """See what the weights of the cases do not hold: not the foot of a witness of the plane."""
    seen = sight(subjects, nuisance)
    if subjects.stance is None or subjects.stance.is_new.all():
        return seen
    known = seen.log_weight - np.where(subjects.stance.is_new, 0.0, seen.evidence)
    return seen._replace(log_weight=known)


def _is_widened(cases: Cases) -> bool:
    """Tell where an excess variance, or anything else, changes the errors as they were told."""
    told: FloatArray = cases.fit.trust / cases.obs.variance
    return cases.grid is None and not np.array_equal(told, cases.fit.weight)


def _view(cases: Cases, look: _Look, *, declared: bool = False) -> View:
    """View of each object (K, M, C); by the errors as they were told, to show disagreement."""
    shape, image = cases.log_weight.shape, look.subjects.image
    if cases.grid is not None:
        view = view_on_grid(cases.grid, look.columns)
        log_prior = (cases.log_weight - log_evidence(cases.grid).reshape(shape))[:, image]
    else:
        fit = cases.fit
        if declared:
            fit = fit._replace(weight=fit.trust / cases.obs.variance)
        view = view_from_others(cases.obs, fit, look.columns)
        log_prior = cases.log_weight[:, image]
    view = View(*(part.reshape(len(log_prior), image.size, part.shape[1]) for part in view))
    return view._replace(log_weight=view.log_weight + log_prior[..., None])


def _blended(
    weight: FloatArray, mean: FloatArray, variance: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """
    Make components (..., C), which may be points of a grid, smooth along C.

    Points are widened to 0.6 of their spacing, and the weights w sharpened by as much: with D
    second differences and t the added variance in squared steps,
    w - D(t w) / 2 + D D((t / 24 + t^2 / 8) w) undoes it.
    """
    if mean.shape[-1] == 1:
        return weight, mean, variance
    there = weight > 0  # what fills the rows of shorter grids counts for nothing
    spacing = _spacing(mean, there) ** 2
    added = np.maximum(_BLEND * spacing - variance, 0.0)
    if not added.any():
        return weight, mean, variance
    t = added / np.maximum(spacing, _LEAST)
    sharper = _second_difference((t / 24 + t**2 / 8) * weight)
    sharper -= t * weight / 2
    sharper = weight + _second_difference(sharper * there)
    return np.maximum(sharper, 0.0) * there, mean, variance + added


def _spacing(values: FloatArray, there: BoolArray) -> FloatArray:
    """Mean distance to those of the two neighbours that are there; 0 without any."""
    near: BoolArray = there[..., 1:] & there[..., :-1]
    step = np.where(near, np.diff(values), 0.0)
    spacing = np.zeros_like(values)
    spacing[..., 1:] = step
    spacing[..., :-1] += step
    both = near[..., 1:] & near[..., :-1]
    spacing[..., 1:-1] /= np.where(both, 2.0, 1.0)
    return spacing


def _second_difference(values: FloatArray) -> FloatArray:
    """Second difference along the last axis, beyond whose ends the values are 0."""
    difference = -2 * values
    difference[..., 1:] += values[..., :-1]
    difference[..., :-1] += values[..., 1:]
    return difference


def _relative(log_weight: FloatArray) -> FloatArray:
    """Weights (..., K, M, C) over the largest of each object."""
    others = (*range(log_weight.ndim - 2), log_weight.ndim - 1)
    weight: FloatArray = np.exp(log_weight - log_weight.max(axis=others, keepdims=True))
    return weight


def _mix(weight: FloatArray, mean: FloatArray, variance: FloatArray) -> Mixture:
    """
    Gather all components (..., M, C) of each object in one row, weights as large as they may be.

    What lies at infinity weighs, and is left out.
    """
    weight, mean, variance = (
        _by_object(np.broadcast_to(part, np.broadcast_shapes(weight.shape, mean.shape)))
        for part in (weight, mean, variance)
    )
    weight = weight / weight.sum(axis=1, keepdims=True)
    infinite: BoolArray = np.isposinf(mean)
    if infinite.any():
        weight, mean = np.where(infinite, 0.0, weight), np.where(infinite, 0.0, mean)
    return Mixture(weight, mean, variance)


def _by_object(column: FloatArray) -> FloatArray:
    """Rows (M, ...) of components (..., M, C)."""
    count, size = column.shape[-2:]
    n_cases = math.prod(column.shape[:-2])
    rows: FloatArray = column.reshape(n_cases, count, size).transpose(1, 0, 2)
    return rows.reshape(count, n_cases * size)
