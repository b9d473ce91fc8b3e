"""
The one core: from references, and what is not known of their depths, to log k.

Each case of the nuisances (shift, depth noise) is solved by one of two solvers, the fast robust one
or the exact posterior; prior and evidence weigh the cases. Arrays only, many images at once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imgscale._typing import BoolArray, FloatArray
from imgscale.core.estimator import disagree, fit_robust
from imgscale.core.evidence import robust_evidence
from imgscale.core.posterior import GridFit, believe, fit_grid, log_evidence
from imgscale.core.segments import MIN_VARIANCE, LogFit, LogObservations, normalised
from imgscale.core.shift import shift_cases
from imgscale.core.witnesses import (
    Nuisance,
    Sized,
    crossed,
    middle_case,
    noise_cases,
    observe_under,
)


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
    """

    witnesses: Sized
    n_images: int
    has_shift: bool
    unknown_noise: bool
    exact: bool


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
    shift : (n_images,) ndarray of float64
        The best shift, 0 where there is none.
    """

    witnesses: Sized
    nuisance: Nuisance
    obs: LogObservations
    fit: LogFit
    grid: GridFit | None
    kinds: FloatArray
    log_weight: FloatArray
    shift: FloatArray

    @property
    def weight(self) -> FloatArray:
        """Probability of each case, (K, n_images)."""
        return normalised(self.log_weight, 0)


class Estimate(NamedTuple):
    """
    One number for everything: what is reported of the images.

    Attributes
    ----------
    log_k : (n_images,) ndarray of float64
        Log of the scale constant, at the shift.
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
    nuisance = noise_cases(problem.n_images, unknown_noise=problem.unknown_noise)
    if not problem.has_shift:
        return _solve_cases(problem, nuisance)
    best, shifts = shift_cases(
        problem.witnesses, problem.n_images, unknown_noise=problem.unknown_noise
    )
    return _solve_cases(problem, crossed(nuisance, shifts))._replace(shift=best)


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
        shift=np.zeros(1),
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
    middle = cases.shift
    shift_var = (weight * (nuisance.shift - middle) ** 2).sum(axis=0)
    log_k = cases.fit.log_k.reshape(weight.shape)
    log_k_var = cases.fit.log_std.reshape(weight.shape) ** 2
    centre = (weight * log_k).sum(axis=0)
    log_k_var = (weight * (log_k_var + (log_k - centre) ** 2)).sum(axis=0)
    covariance = (weight * (log_k - centre) * (nuisance.shift - middle)).sum(axis=0)
    spread = np.sqrt(log_k_var * shift_var)
    log_noise = np.log(np.maximum(nuisance.depth_var, MIN_VARIANCE))[:, None]
    at_shift = cases
    if problem.has_shift:
        noise = noise_cases(problem.n_images, unknown_noise=problem.unknown_noise)
        fixed = Nuisance(middle[None, :], np.zeros(1), np.zeros((1, problem.n_images)))
        at_shift = _solve_cases(problem, crossed(noise, fixed))
    weight = at_shift.weight
    of_row = weight[:, problem.witnesses.image]
    rows = of_row.shape

    def mixed(column: FloatArray) -> FloatArray:
        result: FloatArray = (of_row * column.reshape(rows)).sum(axis=0)
        return result

    one = middle_case(middle[None, :], unknown_noise=problem.unknown_noise)
    return Estimate(
        log_k=(weight * at_shift.fit.log_k.reshape(weight.shape)).sum(axis=0),
        shift=middle,
        shift_std=np.sqrt(shift_var),
        correlation=np.where(spread > 0, covariance / np.where(spread > 0, spread, 1.0), 0.0),
        depth_rel=np.exp((cases.weight * log_noise).sum(axis=0) / 2),
        inconsistent=disagree(observe_under(problem.witnesses, one)),
        trust=mixed(at_shift.fit.trust),
        precision=mixed(at_shift.fit.weight),
        share=mixed(at_shift.fit.share),
        kinds=(of_row[:, :, None] * at_shift.kinds).sum(axis=0),
    )


def _solve_cases(problem: Problem, nuisance: Nuisance) -> Cases:
    """Solve every case by the problem's solver."""
    obs = observe_under(problem.witnesses, nuisance)
    if problem.exact:
        grid = fit_grid(obs)
        fit, kinds = believe(obs, grid)
        evidence = log_evidence(grid)
    else:
        grid, fit = None, fit_robust(obs)
        kinds = fit.trust[:, None] * obs.kinds.share
        evidence = robust_evidence(obs, fit)
    return Cases(
        witnesses=problem.witnesses,
        nuisance=nuisance,
        obs=obs,
        fit=fit,
        grid=grid,
        kinds=kinds.reshape(nuisance.depth_var.size, -1, kinds.shape[1]),
        log_weight=nuisance.log_prior + evidence.reshape(nuisance.log_prior.shape),
        shift=np.zeros(problem.n_images),
    )
