"""
The unknown shift of an inverse depth: where it may lie, found by zooming in on the evidence.

The nearest-to-horizon reference must lie before the horizon, so that ``c = min(D) + b`` is
positive; log c runs over the whole line, and evidence and prior are smooth in it. All is in units
of the spread of D, whatever the scaling and offset of the input.
"""

from __future__ import annotations

import numpy as np

from imgscale._typing import FloatArray
from imgscale.estimator import fit_robust
from imgscale.evidence import robust_evidence
from imgscale.witnesses import Nuisance, Sized, middle_case, observe_under

_COARSE = 41
_FINE = 17
_NEAREST, _FARTHEST = 1e-3, 1e2
# Cases less probable than the best one by this factor (its log) are left out.
_NEGLIGIBLE = 13.0
_RESOLVED = 14
_MAX_ZOOMS = 12


def shift_cases(witnesses: Sized, n_images: int, *, unknown_noise: bool) -> Nuisance:
    """
    Spread cases of the shift over where the references allow it.

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
    Nuisance
        17 cases of the shift, for the middle case of the noise.

    Notes
    -----
    The prior of b is normal about 0 with the larger of the median size and the standard deviation
    of D: it shrinks towards no shift and gives way to data.
    """
    nearest, spread, width = _scales(witnesses, n_images)
    low = np.full(n_images, np.log(_NEAREST))
    high = np.log(np.maximum(_FARTHEST, 5 * width / spread))
    for _ in range(_MAX_ZOOMS):
        log_c = np.linspace(low, high, _COARSE)
        log_weight = _weigh(witnesses, log_c, nearest, spread, width, unknown_noise=unknown_noise)
        likely = log_weight > log_weight.max(axis=0) - _NEGLIGIBLE
        first = np.maximum(np.argmax(likely, axis=0) - 1, 0)
        last = np.minimum(_COARSE - np.argmax(likely[::-1], axis=0), _COARSE - 1)
        column = np.arange(n_images)
        low, high = log_c[first, column], log_c[last, column]
        if np.all(likely.sum(axis=0) >= _RESOLVED):
            break
    log_c = np.linspace(low, high, _FINE)
    shift = spread * np.exp(log_c) - nearest
    return Nuisance(
        shift=shift,
        depth_var=np.zeros(_FINE),
        log_prior=_log_prior(shift, log_c, width),
    )


def nearest_inverse_depth(witnesses: Sized, n_images: int) -> FloatArray:
    """
    Find the smallest D of each image, of the reference nearest to the horizon.

    Parameters
    ----------
    witnesses : Sized
        References.
    n_images : int
        Number of images.

    Returns
    -------
    (n_images,) ndarray of float64
        The values.
    """
    return _scales(witnesses, n_images)[0]


def _scales(witnesses: Sized, n_images: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Smallest D of each image, its spread, and the width of the shift's prior."""
    columns: list[tuple[float, float, float]] = []
    for image in range(n_images):
        inverse = witnesses.inverse_depth[(witnesses.image == image) & ~witnesses.firm]
        width = max(abs(float(np.median(inverse))), float(inverse.std()))
        columns.append((float(inverse.min()), float(np.ptp(inverse)), width))
    nearest, spread, width = np.array(columns).T
    return nearest, spread, width


def _weigh(
    witnesses: Sized,
    log_c: FloatArray,
    nearest: FloatArray,
    spread: FloatArray,
    width: FloatArray,
    *,
    unknown_noise: bool,
) -> FloatArray:
    """Log of prior times evidence of each case and image, by the robust solver."""
    shift = spread * np.exp(log_c) - nearest
    cases = middle_case(shift, unknown_noise=unknown_noise)
    obs = observe_under(witnesses, cases)
    evidence = robust_evidence(obs, fit_robust(obs)).reshape(shift.shape)
    return evidence + _log_prior(shift, log_c, width)


def _log_prior(shift: FloatArray, log_c: FloatArray, width: FloatArray) -> FloatArray:
    """Log of the prior density of log c."""
    return log_c - 0.5 * (shift / width) ** 2
