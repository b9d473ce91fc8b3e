"""
The robust estimator of log k, iteratively re-weighted least squares: fast, and right in the median.

The label's offset is integrated out in closed form: with W the sum of a label's weights, the label
weighs 1 / (1 / W + tau^2). See `imgscale.core.segments` for the model.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from imgscale._typing import BoolArray, FloatArray, IntArray
from imgscale.core.blocks import Block, fit_block, scatter
from imgscale.core.segments import LogFit, LogObservations, Subjects, View

# References that are solved at once: the arrays of a block of them stay in the processor's cache.
_CELLS = 49_152
_ROUNDING = 1e-13


def fit_robust(obs: LogObservations) -> LogFit:
    """
    Estimate log k of every image by iteratively re-weighted least squares.

    It starts at the weighted median and re-weights by Tukey's biweight. Where most references
    disagree, none can be told to be wrong: an excess variance, common to all, then takes up their
    scatter. Firm witnesses are never rejected or widened.

    Parameters
    ----------
    obs : LogObservations
        The references; every image has at least one.

    Returns
    -------
    LogFit
        The estimates.

    Notes
    -----
    Tukey's biweight is ``(1 - (r / 4.685)^2)^2`` inside ``|r| < 4.685`` and 0 outside, r in
    standard errors. The excess variance is ``M^2 (1 - (2 / m)^2)`` where m, the median absolute
    deviation in standard errors, exceeds 2; M is that of the logarithms. The interval of two
    references that exclude each other therefore holds both.
    """
    fit = LogFit(
        log_k=np.empty(obs.n_images),
        log_std=np.empty(obs.n_images),
        trust=np.empty_like(obs.y),
        weight=np.empty_like(obs.y),
        share=np.empty_like(obs.y),
    )
    apart = np.empty(obs.n_images, dtype=np.bool_)
    for images, rows in _blocks(obs):
        found = fit_block(_block(obs, rows))
        fit.log_k[images], fit.log_std[images] = found.log_k, found.log_std
        apart[images] = found.disagree
        fit.trust[rows], fit.weight[rows], fit.share[rows] = found.trust, found.weight, found.share
    return fit._replace(disagree=apart)


def disagree(obs: LogObservations) -> BoolArray:
    """
    Tell where references disagree by much more than their errors.

    Parameters
    ----------
    obs : LogObservations
        The references.

    Returns
    -------
    (n_images,) ndarray of bool
        True where the median absolute deviation exceeds 2.5 standard errors.
    """
    result = np.empty(obs.n_images, dtype=np.bool_)
    for images, rows in _blocks(obs):
        result[images] = scatter(_block(obs, rows)).disagree
    return result


def _blocks(obs: LogObservations) -> Iterator[tuple[IntArray, IntArray]]:
    """List images of as many references each, and the rows of these, label by label, (q, m)."""
    counts = np.bincount(obs.image)
    if counts.size == 1:
        yield np.zeros(1, dtype=np.intp), np.argsort(obs.group, kind="stable")[:, None]
        return
    order = np.lexsort((obs.group, obs.image))
    first = np.cumsum(counts) - counts
    for count in np.unique(counts[counts > 0]).tolist():
        images = np.flatnonzero(counts == count)
        width = max(_CELLS // count, 1)
        for start in range(0, images.size, width):
            some = images[start : start + width]
            yield some, order[first[some] + np.arange(count)[:, None]]


def _block(obs: LogObservations, rows: IntArray) -> Block:
    """Gather some rows."""
    firm = obs.firm[rows]
    return Block(
        obs.y[rows],
        obs.variance[rows],
        obs.tau[rows],
        obs.group[rows],
        firm if firm.any() else None,
    )


def log_k_std(obs: LogObservations, share: FloatArray) -> FloatArray:
    """
    Propagate the declared errors into log k, for any estimator that weighs its references.

    Parameters
    ----------
    obs : LogObservations
        The references.
    share : (N,) ndarray of float
        Share of each reference in log k.

    Returns
    -------
    (n_images,) ndarray of float64
        ``sqrt(sum_i share_i^2 v_i + sum_c (sum_{i in c} share_i)^2 tau_c^2)``.
    """
    by_group = np.bincount(obs.group, share)
    own = np.bincount(obs.image, share**2 * obs.variance, obs.n_images)
    # each member adds share_i * (sum of its group), which adds up to the square of that sum
    shared = np.bincount(obs.image, share * by_group[obs.group] * obs.tau**2, obs.n_images)
    std: FloatArray = np.sqrt(own + shared)
    return std


def view_from_others(obs: LogObservations, fit: LogFit, subjects: Subjects) -> View:
    """
    Tell what all other references say of log k and of a label's offset, for any objects.

    Parameters
    ----------
    obs : LogObservations
        The references.
    fit : LogFit
        Their fit.
    subjects : Subjects
        The objects.

    Returns
    -------
    View
        Closed form of the Gaussian posterior of (log k, u): one case.

    Notes
    -----
    With A, m the weight and mean of log k from other labels and W, y those of the label's other
    references, D = A + W + A W tau^2 gives var(log k) = (1 + W tau^2) / D, var(u) = tau^2 (A + W)
    / D and cov(log k, u) = -tau^2 W / D.
    """
    weight, n_groups = fit.weight, obs.n_groups
    n_images = max(obs.n_images, int(subjects.image.max(initial=-1)) + 1)
    # one more group, empty, for the labels without references: index -1
    label_weight: FloatArray = np.bincount(obs.group, weight, n_groups + 1).astype(np.float64)
    label_sum = np.bincount(obs.group, weight * obs.y, n_groups + 1)
    tau_of_group = np.zeros(n_groups + 1)
    tau_of_group[obs.group] = obs.tau
    # information on log k of a label whose references weigh W together
    shrink = 1 + label_weight * tau_of_group**2
    image_of_group = np.zeros(n_groups + 1, dtype=np.intp)
    image_of_group[obs.group] = obs.image
    total: FloatArray = np.bincount(image_of_group, label_weight / shrink, n_images).astype(
        np.float64
    )
    total_sum = np.bincount(image_of_group, label_sum / shrink, n_images)

    image, group = subjects.image, subjects.group
    other = _remainder(total[image], (label_weight / shrink)[group])
    other_sum = np.where(other > 0, total_sum[image] - (label_sum / shrink)[group], 0.0)
    own = subjects.own >= 0
    own_weight = np.where(own, weight[subjects.own], 0.0)
    own_y = np.where(own, obs.y[subjects.own], 0.0)
    mates = _remainder(label_weight[group], own_weight)
    mates_sum = label_sum[group] - own_weight * own_y
    with np.errstate(invalid="ignore", divide="ignore"):
        mates_mean = np.where(mates > 0, mates_sum / mates, 0.0)
    return _two_by_two(other, other_sum, mates, mates_mean, subjects.tau**2)


def _remainder(total: FloatArray, part: FloatArray) -> FloatArray:
    """Subtract, and take what rounding leaves of equal numbers for nothing."""
    left = total - part
    return np.where(left > _ROUNDING * total, left, 0.0)


def _two_by_two(
    other: FloatArray,
    other_sum: FloatArray,
    own_weight: FloatArray,
    own_mean: FloatArray,
    tau2: FloatArray,
) -> View:
    """Posterior of (log k, u) from other labels' references and the label's own."""
    det = other + own_weight + other * own_weight * tau2
    alone = det == 0  # nothing is known of log k, and of u no more than its prior
    det = np.where(alone, np.nan, det)
    log_k = (other_sum * (1 + own_weight * tau2) + own_weight * own_mean) / det
    offset = tau2 * own_weight * (other * own_mean - other_sum) / det
    columns = (
        np.zeros_like(det),
        log_k,
        (1 + own_weight * tau2) / det,
        np.where(alone, 0.0, offset),
        np.where(alone, tau2, tau2 * (other + own_weight) / det),
        np.where(alone, 0.0, -tau2 * own_weight / det),
    )
    return View(*(column[:, None] for column in columns))
