"""
The one core: from references, and what is not known of their depths and plane, to log k.

Each case of the nuisances (shift, depth noise, plane) is solved by one of two solvers, the fast
robust one or the exact posterior; prior and evidence weigh the cases. Arrays only, many images at
once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imgscale._typing import BoolArray, FloatArray
from imgscale.core.estimator import disagree, fit_robust
from imgscale.core.evidence import robust_evidence
from imgscale.core.plane import plane_cases, tilt_cases
from imgscale.core.posterior import GridFit, believe, fit_grid, log_evidence
from imgscale.core.segments import MIN_VARIANCE, LogFit, LogObservations, normalised
from imgscale.core.shift import shift_cases
from imgscale.core.sighting import observe_under, plane_evidence
from imgscale.core.unknowns import Scene
from imgscale.core.witnesses import UNKNOWN_DEPTH_REL, Nuisance, Sized, crossed, noise_cases

# Levels of noise that no case stands for any more are less probable by this (its log).
_LEFT_OUT = 12.0


class Problem(NamedTuple):
    """
    What is to be solved.

    Attributes
    ----------
    witnesses : Sized
        References of n_images images; every image has at least one.
    n_images : int
        Number of images.
    has_shift : bool
        True where the shift of the inverse depth is unknown.
    unknown_noise : bool
        True where nobody told the noise of the depths.
    exact : bool
        Solve by the exact posterior; else by the robust estimator.
    scene : Scene or None
        What is known of plane and tilt; None where neither counts.
    bystanders : Sized or None
        Objects that are no references, whose feet tell of the plane all the same.
    """

    witnesses: Sized
    n_images: int
    has_shift: bool
    unknown_noise: bool
    exact: bool
    scene: Scene | None = None
    bystanders: Sized | None = None

    @property
    def plane(self) -> Scene | None:
        """The scene, where it has a plane."""
        return self.scene if self.scene and self.scene.has_plane else None


class Cases(NamedTuple):
    """
    The solutions of all cases.

    Attributes
    ----------
    witnesses : Sized
        The references.
    nuisance : Nuisance
        The K cases.
    obs : LogObservations
        The references under each case.
    fit : LogFit
        The solution of each case.
    grid : GridFit or None
        The posteriors; None where the solver was the robust one.
    kinds : (K, N, J) ndarray of float64
        Probability that each reference is sound and of the kind j of its label.
    log_weight : (K, n_images) ndarray of float64
        Log of prior times evidence.
    best : Nuisance
        One case: the best shift, 0 where there is none, and the best plane.
    """

    witnesses: Sized
    nuisance: Nuisance
    obs: LogObservations
    fit: LogFit
    grid: GridFit | None
    kinds: FloatArray
    log_weight: FloatArray
    best: Nuisance

    @property
    def weight(self) -> FloatArray:
        """Probability of each case, (K, n_images)."""
        return normalised(self.log_weight, 0)

    def of_levels(self, levels: Nuisance) -> FloatArray:
        """
        Compute the evidence of each level of noise of one image.

        Parameters
        ----------
        levels : Nuisance
            Cases of the noise alone.

        Returns
        -------
        (L,) ndarray of float64
            Log of the likelihood, everything else integrated out.
        """
        evidence = np.full(levels.n_cases, self.log_weight.max() - _LEFT_OUT)
        for number, noise_var in enumerate(levels.depth_var[:, 0]):
            own = self.nuisance.depth_var[:, 0] == noise_var
            if own.any():
                total = np.logaddexp.reduce(self.log_weight[own, 0])
                evidence[number] = max(total, evidence[number])
        return evidence - levels.log_prior[:, 0]


class PlaneEstimate(NamedTuple):
    """
    Horizon and plane of the images, and their standard deviations.

    Attributes
    ----------
    horizon, horizon_std : (n_images,) ndarray of float64
        Row of the horizon below the principal point.
    slope, slope_std : (n_images,) ndarray of float64
        How far the plane falls off sideways.
    log_height, log_height_std : (n_images,) ndarray of float64
        Log of the camera's height.
    correlation : (n_images,) ndarray of float64
        Correlation of log k and the horizon.
    """

    horizon: FloatArray
    horizon_std: FloatArray
    slope: FloatArray
    slope_std: FloatArray
    log_height: FloatArray
    log_height_std: FloatArray
    correlation: FloatArray


class Estimate(NamedTuple):
    """
    One number for everything: what is reported of the images.

    Attributes
    ----------
    log_k : (n_images,) ndarray of float64
        Log of the scale constant, at the best shift and plane.
    shift, shift_std : (n_images,) ndarray of float64
        Shift of the inverse depth and its standard deviation.
    correlation : (n_images,) ndarray of float64
        Correlation of log k and shift.
    depth_rel : (n_images,) ndarray of float64
        Noise of the depths beyond what was told, where that is not known.
    inconsistent : (n_images,) ndarray of bool
        True where the references disagree by much more than their errors.
    trust, precision, share : (N,) ndarray of float64
        How far each reference was believed, the precision and the share in log k that it kept.
    kinds : (N, J) ndarray of float64
        Probability that it is sound and of the kind j of its label.
    plane : PlaneEstimate or None
        Where there is one.
    """

    log_k: FloatArray
    shift: FloatArray
    shift_std: FloatArray
    correlation: FloatArray
    depth_rel: FloatArray
    inconsistent: BoolArray
    trust: FloatArray
    precision: FloatArray
    share: FloatArray
    kinds: FloatArray
    plane: PlaneEstimate | None


def solve(problem: Problem) -> Cases:
    """
    Solve every case.

    Parameters
    ----------
    problem : Problem
        The references and what is not known.

    Returns
    -------
    Cases
        The solutions.
    """
    noise = noise_cases(problem.n_images, unknown_noise=problem.unknown_noise)
    if problem.plane:
        nobody = problem.witnesses.rows(np.zeros(0, dtype=np.intp))
        best, cases = plane_cases(
            problem.witnesses,
            nobody if problem.bystanders is None else problem.bystanders,
            problem.plane,
            noise,
            has_shift=problem.has_shift,
        )
        return _solve_cases(problem, cases, best)
    best = _nothing_else(problem.n_images)
    if not (problem.has_shift or problem.scene):
        return _solve_cases(problem, noise, best)
    others = best
    if problem.has_shift:
        level = _levelled(problem.witnesses, problem.scene)
        shift, others = shift_cases(level, problem.n_images, unknown_noise=problem.unknown_noise)
        best = best._replace(shift=shift[None])
    if problem.scene:
        exact = problem.scene._replace(horizon_std=0.0, focal_rel_std=0.0)
        others = _tilted(others, tilt_cases(problem.scene, problem.n_images))
        best = _tilted(best, tilt_cases(exact, problem.n_images))
    return _solve_cases(problem, crossed(noise, others), best)


def closed_form_cases(witnesses: Sized, nuisance: Nuisance, fit: LogFit) -> Cases:
    """
    Take an estimate that was found in closed form for the one case.

    Parameters
    ----------
    witnesses : Sized
        References of one image.
    nuisance : Nuisance
        One case.
    fit : LogFit
        The estimate.

    Returns
    -------
    Cases
        The case.
    """
    kinds = fit.trust[:, None] * witnesses.prior.share
    return Cases(
        witnesses=witnesses,
        nuisance=nuisance,
        obs=observe_under(witnesses, nuisance),
        fit=fit,
        grid=None,
        kinds=kinds[None],
        log_weight=np.zeros((1, 1)),
        best=nuisance,
    )


def estimate(problem: Problem, cases: Cases) -> Estimate:
    """
    Sum the cases up.

    Parameters
    ----------
    problem : Problem
        What was solved.
    cases : Cases
        Its solutions.

    Returns
    -------
    Estimate
        The numbers to report.
    """
    weight, nuisance = cases.weight, cases.nuisance
    log_k = cases.fit.log_k.reshape(weight.shape)
    log_k_var = cases.fit.log_std.reshape(weight.shape) ** 2
    shift = _moments(weight, log_k, log_k_var, nuisance.shift, cases.best.shift[0])
    log_noise = np.log(np.maximum(nuisance.depth_var, MIN_VARIANCE))
    noise = noise_cases(problem.n_images, unknown_noise=problem.unknown_noise)
    at_best = cases
    if problem.has_shift or problem.scene:
        at_best = _solve_cases(problem, crossed(noise, cases.best), cases.best)
    weight = at_best.weight

    def mixed(column: FloatArray, cases_weight: FloatArray) -> FloatArray:
        by_case = column.reshape(*cases_weight.shape, *column.shape[1:])
        if len(by_case) == 1:
            alone: FloatArray = by_case[0]
            return alone
        result: FloatArray = (cases_weight * by_case).sum(axis=0)
        return result

    log_k_best = mixed(at_best.fit.log_k, weight)
    of_row = weight[:, problem.witnesses.image]
    return Estimate(
        log_k=log_k_best,
        shift=cases.best.shift[0],
        shift_std=shift.std,
        correlation=shift.correlation,
        depth_rel=np.exp((cases.weight * log_noise).sum(axis=0) / 2),
        inconsistent=_disagree(problem, cases),
        trust=mixed(at_best.fit.trust, of_row),
        precision=mixed(at_best.fit.weight, of_row),
        share=mixed(at_best.fit.share, of_row),
        kinds=(of_row[:, :, None] * at_best.kinds).sum(axis=0),
        plane=_plane(cases, log_k, log_k_var, log_k_best) if problem.plane else None,
    )


def _disagree(problem: Problem, cases: Cases) -> BoolArray:
    """Tell where references disagree, at the best shift and plane and the middle of the noise."""
    one_case = cases.nuisance.n_cases == 1 and not problem.scene
    if one_case and cases.fit.disagree is not None:
        return cases.fit.disagree
    middle = cases.best._replace(
        depth_var=np.full_like(cases.best.shift, UNKNOWN_DEPTH_REL**2 * problem.unknown_noise)
    )
    return disagree(cases.obs if one_case else observe_under(problem.witnesses, middle))


class _Moments(NamedTuple):
    """Standard deviation of a nuisance, and its correlation with log k."""

    std: FloatArray
    correlation: FloatArray


def _moments(
    weight: FloatArray,
    log_k: FloatArray,
    log_k_var: FloatArray,
    values: FloatArray,
    middle: FloatArray,
) -> _Moments:
    """Sum up a nuisance, about its best value, over all cases."""
    centre = (weight * log_k).sum(axis=0)
    variance = (weight * (values - middle) ** 2).sum(axis=0)
    covariance = (weight * (log_k - centre) * (values - middle)).sum(axis=0)
    spread = np.sqrt((weight * (log_k_var + (log_k - centre) ** 2)).sum(axis=0) * variance)
    correlation = np.where(spread > 0, covariance / np.where(spread > 0, spread, 1.0), 0.0)
    return _Moments(np.sqrt(variance), correlation)


def _plane(
    cases: Cases, log_k: FloatArray, log_k_var: FloatArray, log_k_best: FloatArray
) -> PlaneEstimate:
    """Sum the plane up."""
    nuisance, best, weight = cases.nuisance, cases.best, cases.weight
    columns = (nuisance.horizon, nuisance.slope, nuisance.gap, best.horizon, best.slope, best.gap)
    horizon, slope, gap, best_horizon, best_slope, best_gap = (
        np.zeros((1, 1)) if column is None else column for column in columns
    )
    of_horizon = _moments(weight, log_k, log_k_var, horizon, best_horizon[0])
    log_height = log_k_best + best_gap[0]
    height_var = (weight * (log_k_var + (log_k + gap - log_height) ** 2)).sum(axis=0)
    return PlaneEstimate(
        horizon=best_horizon[0],
        horizon_std=of_horizon.std,
        slope=best_slope[0],
        slope_std=_moments(weight, log_k, log_k_var, slope, best_slope[0]).std,
        log_height=log_height,
        log_height_std=np.sqrt(height_var),
        correlation=of_horizon.correlation,
    )


def _nothing_else(n_images: int) -> Nuisance:
    """Make the one case of no shift."""
    zero = np.zeros((1, n_images))
    return Nuisance(zero, zero, zero)


def _levelled(witnesses: Sized, scene: Scene | None) -> Sized:
    """Show objects as a level camera would, by the tilt as it is known beforehand."""
    if scene is None or witnesses.stance is None:
        return witnesses
    tilts = witnesses.stance.tilts(np.full((1, witnesses.image.size), scene.horizon))
    upright = np.where(witnesses.firm, 0.0, tilts.by_depth[0])
    return witnesses._replace(log_pixels=witnesses.log_pixels + upright, stance=None)


def _tilted(others: Nuisance, tilt: Nuisance) -> Nuisance:
    """Combine cases of the shift with cases of the tilt."""
    both = crossed(tilt, others)
    repeated = [
        None if column is None else np.repeat(column, others.n_cases, axis=0)
        for column in (tilt.horizon, tilt.log_focal)
    ]
    return both._replace(horizon=repeated[0], log_focal=repeated[1])


def _solve_cases(problem: Problem, nuisance: Nuisance, best: Nuisance) -> Cases:
    """Solve every case by the problem's solver."""
    obs = observe_under(problem.witnesses, nuisance)
    if problem.exact:
        grid = fit_grid(obs)
        fit, kinds = believe(obs, grid)
        evidence = log_evidence(grid)
    else:
        grid, fit = None, fit_robust(obs)
        kinds = fit.trust[:, None] * obs.kinds.share
        # one case alone needs no weighing
        evidence = robust_evidence(obs, fit) if nuisance.n_cases > 1 else np.zeros(fit.log_k.size)
    log_weight = nuisance.log_prior + evidence.reshape(nuisance.log_prior.shape)
    for objects in (problem.witnesses, problem.bystanders):
        if objects is not None:
            log_weight = log_weight + plane_evidence(objects, nuisance)
    n_kinds = problem.witnesses.prior.share.shape[1]
    n_ways = kinds.shape[1] // n_kinds
    return Cases(
        witnesses=problem.witnesses,
        nuisance=nuisance,
        obs=obs,
        fit=fit,
        grid=grid,
        # a kind of thing may stand there in several ways
        kinds=kinds.reshape(nuisance.n_cases, -1, n_kinds, n_ways).sum(axis=3),
        log_weight=log_weight,
        best=best,
    )
