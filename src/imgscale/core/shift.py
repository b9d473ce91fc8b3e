"""
The unknown shift of an inverse depth: where it may lie, found by robust Gauss-Newton.

The reference nearest to the horizon lies before it, so that ``c = min(D) + b`` is positive; log c
runs over the whole line, and log k is nearly linear in it. All is in units of the spread of D,
whatever the scaling and offset of the input.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imgscale._typing import FloatArray
from imgscale.core.blocks import trusted
from imgscale.core.estimator import fit_robust
from imgscale.core.evidence import robust_evidence
from imgscale.core.segments import LogObservations, sum_by
from imgscale.core.sighting import observe_under
from imgscale.core.witnesses import Nuisance, Sized, middle_case

# Where c may lie, in units of the spread of D; farther where the prior of b is wider.
_NEAREST, _FARTHEST = 1e-3, 1e2
_STARTS, _COARSE, _FINE = 25, 41, 17
_FINE_REACH = 5.0
# The noise of the first steps, which takes up how far the start is off; it shrinks by 5 a step.
_FIRST_NOISE, _COOLING, _STEPS = 0.3, 0.2, 30
_CONVERGED = 1e-9
# Cases less probable than the best one by this factor (its log) are left out.
_NEGLIGIBLE = 12.0
_LEFT_OUT = 1000.0
_TINY = 1e-300


def shift_cases(
    witnesses: Sized, n_images: int, *, unknown_noise: bool
) -> tuple[FloatArray, Nuisance]:
    """
    Spread cases of the shift over where the references and the prior allow it.

    Parameters
    ----------
    witnesses : Sized
        References, at least two of each image at different inverse depths.
    n_images : int
        Number of images.
    unknown_noise : bool
        True where nobody told the noise of the depths.

    Returns
    -------
    best : (n_images,) ndarray of float64
        The most probable shift, by robust weights.
    cases : Nuisance
        Cases of the shift, dense about the best one, without noise of the depths.

    Notes
    -----
    The prior of b is normal about 0 with the larger of the median size and the standard deviation
    of D: it shrinks towards no shift and gives way to data.
    """
    scale = shift_scales(witnesses, n_images)
    starts = np.linspace(scale.low, scale.high, _STARTS)
    log_c, std = _newton(witnesses, scale, _best(witnesses, scale, starts), unknown_noise)
    fine = log_c + std * np.linspace(-_FINE_REACH, _FINE_REACH, _FINE)[:, None]
    cases = np.concatenate([np.linspace(scale.low, scale.high, _COARSE), fine])
    cases = np.sort(np.clip(cases, scale.low, scale.high), axis=0)
    shift = scale.shift(cases)
    # the trapezoidal rule: each case stands for the stretch around it, db = c dlog(c)
    stretch = np.maximum(np.gradient(cases, axis=0), _TINY)
    log_prior = _log_prior(shift, scale) + cases + np.log(stretch)
    log_weight = log_prior + _evidence(witnesses, shift, 0.0, unknown_noise=unknown_noise)
    likely = log_weight > log_weight.max(axis=0) - _NEGLIGIBLE
    # an image's cases do not depend on the other images
    log_prior = np.where(likely, log_prior, log_prior - _LEFT_OUT)
    spread = Nuisance(shift, np.zeros_like(shift), log_prior)
    return scale.shift(log_c), spread.cases(likely.any(axis=1))


class ShiftScale(NamedTuple):
    """
    The scale of each image's shift, whatever the scaling and offset of its depths.

    Attributes
    ----------
    nearest : (n_images,) ndarray of float64
        Smallest inverse depth D of a reference.
    spread : (n_images,) ndarray of float64
        Spread of D.
    width : (n_images,) ndarray of float64
        Standard deviation of the prior of the shift.
    low, high : (n_images,) ndarray of float64
        Bounds of log c.
    """

    nearest: FloatArray
    spread: FloatArray
    width: FloatArray
    low: FloatArray
    high: FloatArray

    def shift(self, log_c: FloatArray) -> FloatArray:
        """
        Compute the shift.

        Parameters
        ----------
        log_c : (..., n_images) ndarray of float
            Log of (smallest D + b) / spread.

        Returns
        -------
        (..., n_images) ndarray of float64
            The shift b.
        """
        return self.spread * np.exp(log_c) - self.nearest


def shift_scales(witnesses: Sized, n_images: int) -> ShiftScale:
    """
    Scale the shift of each image.

    Parameters
    ----------
    witnesses : Sized
        References, at least one of each image.
    n_images : int
        Number of images.

    Returns
    -------
    ShiftScale
        The scales.
    """
    columns: list[tuple[float, float, float]] = []
    for image in range(n_images):
        inverse = witnesses.inverse_depth[(witnesses.image == image) & ~witnesses.firm]
        width = max(abs(float(np.median(inverse))), float(inverse.std())) or 1.0
        # one reference, or all at one depth: something else must tell the shift
        spread = float(np.ptp(inverse)) or width
        columns.append((float(inverse.min()), spread, width))
    nearest, spread_, width_ = np.array(columns).T
    low = np.full(n_images, np.log(_NEAREST))
    high = np.log(np.maximum(_FARTHEST, 5 * width_ / spread_))
    return ShiftScale(nearest, spread_, width_, low, high)


def _log_prior(shift: FloatArray, scale: ShiftScale) -> FloatArray:
    """Log of the prior density of the shift."""
    log_prior: FloatArray = -0.5 * (shift / scale.width) ** 2
    return log_prior


def _best(witnesses: Sized, scale: ShiftScale, starts: FloatArray) -> FloatArray:
    """Best of some values of log c, seen through the noise that their distance makes."""
    shift = scale.shift(starts)
    evidence = _evidence(witnesses, shift, _FIRST_NOISE, unknown_noise=False)
    found = np.argmax(evidence + _log_prior(shift, scale), axis=0)
    best: FloatArray = starts[found, np.arange(found.size)]
    return best


def _evidence(
    witnesses: Sized, shift: FloatArray, noise: float, *, unknown_noise: bool
) -> FloatArray:
    """Evidence of shifts (K, n_images) by the robust solver, with some more noise."""
    obs = observe_under(witnesses, middle_case(shift, unknown_noise=unknown_noise))
    obs = obs._replace(variance=obs.variance + noise**2)
    evidence: FloatArray = robust_evidence(obs, fit_robust(obs)).reshape(shift.shape)
    return evidence


def _newton(
    witnesses: Sized,
    scale: ShiftScale,
    log_c: FloatArray,
    unknown_noise: bool,  # noqa: FBT001
) -> tuple[FloatArray, FloatArray]:
    """Improve log c together with log k by re-weighted Gauss-Newton steps; and its error."""
    noise, std = _FIRST_NOISE, np.ones_like(log_c)
    log_k: FloatArray | None = None
    moves = np.ones(log_c.size, dtype=np.bool_)
    for _ in range(_STEPS):
        shift = scale.shift(log_c)
        obs = observe_under(witnesses, middle_case(shift[None], unknown_noise=unknown_noise))
        obs = obs._replace(variance=obs.variance + noise**2)
        log_k = fit_robust(obs).log_k if log_k is None else log_k
        # d y / d log c = c / (D + b)
        slope = np.exp(log_c)[obs.image] * scale.spread[obs.image]
        slope /= witnesses.inverse_depth + shift[obs.image]
        step_k, step_c, own_std = _step(obs, log_k, slope, log_c, shift, scale)
        # an image that has arrived stays, however long the others take
        std = np.where(moves, own_std, std)
        log_k = np.where(moves, log_k + step_k, log_k)
        log_c = np.where(moves, np.clip(log_c + step_c, scale.low, scale.high), log_c)
        noise *= _COOLING
        if noise < _CONVERGED:
            moves &= np.abs(step_c) >= _CONVERGED
            if not moves.any():
                break
    return log_c, std


def _step(
    obs: LogObservations,
    log_k: FloatArray,
    slope: FloatArray,
    log_c: FloatArray,
    shift: FloatArray,
    scale: ShiftScale,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """One step of log k and log c, at most 1 long, and the standard error of log c."""
    residual = obs.y - log_k[obs.image]
    weight = trusted(residual, obs.variance + obs.tau**2, None) / obs.variance
    image, tau = obs.of_groups()
    shrink = tau**2 / (1 + tau**2 * sum_by(obs.group, weight))

    def product(a: FloatArray, b: FloatArray) -> FloatArray:
        # with the labels' offsets integrated out
        mates = sum_by(obs.group, weight * a) * sum_by(obs.group, weight * b)
        return sum_by(obs.image, weight * a * b) - sum_by(image, shrink * mates)

    one = np.ones_like(residual)
    # residual = y(log c) - log k falls with log k and rises with log c
    kk, kc, cc = product(one, one), -product(one, slope), product(slope, slope)
    gradient_k, gradient_c = product(one, residual), -product(slope, residual)
    c = scale.spread * np.exp(log_c)
    cc = cc + (c / scale.width) ** 2
    gradient_c = gradient_c - shift * c / scale.width**2
    kk = np.maximum(kk, _TINY)
    information = np.maximum(cc - kc**2 / kk, _TINY)
    step_c = np.clip((gradient_c - kc / kk * gradient_k) / information, -1.0, 1.0)
    step_k = (gradient_k - kc * step_c) / kk
    return step_k, step_c, 1 / np.sqrt(information)
