"""
References as they are: some of them are wrong, and how probable that makes what was seen.

One in twenty is taken to be wrong: mislabelled, by half its size or so either way, or cut, hidden,
a child or sitting, and then about two thirds of its prior's size.
"""

from __future__ import annotations

import math

import numpy as np

from imgscale._typing import FloatArray
from imgscale.core.segments import LogFit, LogObservations, sum_by

# Reasoned, not fitted: detectors' labels and boxes fail in some per cent of cases. With more of
# them the interval of a single sound reference would reach much further down.
GROSS, GROSS_STD = 0.02, 0.5
SMALLER, SMALLER_BY, SMALLER_STD = 0.03, 0.4, 0.25
SOUND = 1 - GROSS - SMALLER
# A reference is rejected where the odds are ten to one that it is wrong.
REJECTED = 0.1
_ROOT_TWO_PI = math.sqrt(2 * math.pi)
_TINY = float(np.finfo(np.float64).tiny)


def outlier_density(residual: FloatArray, variance: FloatArray) -> FloatArray:
    """
    Compute the density of references that are wrong, times their probability.

    Parameters
    ----------
    residual : ndarray of float
        Observed minus expected log k: above 0 where an object shows less than its prior says.
    variance : ndarray of float
        Variance of the noise that they have besides.

    Returns
    -------
    ndarray of float64
        ``0.02 L(r; v + 0.5^2) + 0.03 N(r - 0.4; v + 0.25^2)`` times sqrt(2 pi), with the Laplace
        density ``L(r; 2 b^2) = exp(-|r| / b) / (2 b)``: wrong units and labels have no bounds.
    """
    scale = np.sqrt((variance + GROSS_STD**2) / 2)
    smaller = variance + SMALLER_STD**2
    either_way: FloatArray = np.exp(-np.abs(residual) / scale) * (_ROOT_TWO_PI / (2 * scale))
    one_sided = np.exp(-0.5 * (residual - SMALLER_BY) ** 2 / smaller) / np.sqrt(smaller)
    return GROSS * either_way + SMALLER * one_sided


def robust_evidence(obs: LogObservations, fit: LogFit) -> FloatArray:
    """
    Compute the evidence of each image's references about a robust fit, by Laplace's method.

    The labels' offsets are integrated out, with the references that are probably sound.

    Parameters
    ----------
    obs : LogObservations
        The references.
    fit : LogFit
        Their robust fit.

    Returns
    -------
    (n_images,) ndarray of float64
        Log of the likelihood, log k integrated out.
    """
    residual = obs.y - fit.log_k[obs.image]
    total = obs.variance + obs.tau**2
    sound = np.where(obs.firm, 1.0, SOUND) * np.exp(-0.5 * residual**2 / total) / np.sqrt(total)
    wrong = np.where(obs.firm, 0.0, outlier_density(residual, total))
    either = np.maximum(sound + wrong, _TINY)
    # the share of each reference that is wrong costs its own density, and tells nothing of k
    log_row = np.log(either) - sound / either * (0.5 * np.log(obs.variance / total))
    log_row += sound / either * 0.5 * residual**2 / total
    weight = sound / either / obs.variance
    image, tau = obs.of_groups()
    group_weight = sum_by(obs.group, weight)
    mates = sum_by(obs.group, weight * residual) ** 2 * tau**2 / (1 + tau**2 * group_weight)
    quadratic = sum_by(obs.image, weight * residual**2) - sum_by(image, mates)
    evidence: FloatArray = (
        sum_by(obs.image, log_row)
        - 0.5 * (quadratic + sum_by(image, np.log1p(tau**2 * group_weight)))
        + np.log(fit.log_std)
    )
    return evidence
