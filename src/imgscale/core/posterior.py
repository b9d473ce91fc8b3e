"""
The exact posterior of log k on a grid: arrays only, many images at once.

The model is that of `segments`, with references of which some are wrong. A reference of label c
sees v = log k + u_c, and its likelihood is

    g_i(v) = 0.95 sum_j w_j N(y_ij - v; v_ij) + outliers(y_i - v),

where j runs over the kinds of thing that the label may be, N(.; variance) is the normal density and
the outliers are those of `evidence`. With g_c the product over a label's references, the likelihood
of log k is the product over the labels of g_c convolved with N(0, tau_c^2).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from imgscale._typing import FloatArray, IntArray
from imgscale.core.evidence import SOUND, outlier_density
from imgscale.core.segments import (
    LogFit,
    LogObservations,
    Subjects,
    View,
    normalised,
    shares_of_k,
    sum_by,
)

# The grid: 0.4 standard deviations of the sharpest label apart, and wide enough for outliers.
_STEP = 0.4
_LARGEST_GRID = 8192
_REACH = 5.0
_OUTLIER_REACH = 3.0
# Kernels of labels' offsets reach 5 standard deviations; those of a variance below half a squared
# step keep only that variance.
_KERNEL_REACH = 5.0
_NARROW = 0.5
# Log likelihoods are cut off here, relative to their largest: exp() of them is still a number.
_LOWEST = -600.0
# Points whose weight is less than the best one's by this factor (its log) are left out.
_NEGLIGIBLE = 21.0
# Numbers that are worked on at once.
_BLOCK = 200_000
_TINY = float(np.finfo(np.float64).tiny)


class GridFit(NamedTuple):
    """
    Posteriors of log k of many images, each on a grid of its own of G points.

    Attributes
    ----------
    points : (n_images, G) ndarray of float64
        Values of log k, equally spaced.
    least_var : (n_images,) ndarray of float64
        Variance added to every reference where the points cannot resolve them; 0 as a rule.
    n_references : (n_images,) ndarray of int
        Number of references.
    log_density : (n_images, G) ndarray of float64
        Log likelihood of log k.
    log_row : (N, G) ndarray of float64
        Log likelihood of each reference at the points as values of v.
    log_group : (n_groups, G) ndarray of float64
        The label's sum of it.
    log_seen, seen_mean, seen_var : (n_groups, G) ndarray of float64
        What all other labels say of v: its log likelihood, and log k given v.
    """

    points: FloatArray
    least_var: FloatArray
    n_references: IntArray
    log_density: FloatArray
    log_row: FloatArray
    log_group: FloatArray
    log_seen: FloatArray
    seen_mean: FloatArray
    seen_var: FloatArray

    @property
    def step(self) -> FloatArray:
        """Spacing of each image's grid."""
        return self.points[:, 1] - self.points[:, 0]


def fit_grid(obs: LogObservations) -> GridFit:
    """
    Evaluate the posterior of log k of every image.

    Parameters
    ----------
    obs : LogObservations
        The references; every image has at least one.

    Returns
    -------
    GridFit
        The posteriors.
    """
    points, least = _grid(obs)
    step = points[:, 1] - points[:, 0]
    log_row = np.empty((obs.y.size, points.shape[1]))
    for rows in _blocks(obs.y.size, points.shape[1] * obs.kinds.share.shape[1]):
        sound, wrong = _densities(obs, rows, points[obs.image[rows]], least[obs.image[rows]])
        log_row[rows] = np.log(np.maximum(sound.sum(axis=2) + wrong, _TINY))
    log_group = sum_by(obs.group, log_row)
    log_group = np.maximum(log_group, log_group.max(axis=1, keepdims=True) + _LOWEST)
    image, tau = obs.of_groups()
    log_shared = _log_smoothed(log_group, tau / step[image])
    log_density = sum_by(image, log_shared)
    log_seen, seen_mean, seen_var = _seen(
        log_density[image] - log_shared, points[image], tau / step[image]
    )
    return GridFit(
        points=points,
        least_var=least,
        n_references=np.bincount(obs.image, minlength=obs.n_images),
        log_density=log_density,
        log_row=log_row,
        log_group=log_group,
        log_seen=log_seen,
        seen_mean=seen_mean,
        seen_var=seen_var,
    )


def log_evidence(fit: GridFit) -> FloatArray:
    """
    Compute the evidence of each image's references.

    Parameters
    ----------
    fit : GridFit
        The posteriors.

    Returns
    -------
    (n_images,) ndarray of float64
        Log of the likelihood, log k integrated out.
    """
    peak = fit.log_density.max(axis=1)
    total = np.exp(fit.log_density - peak[:, None]).sum(axis=1) * fit.step
    evidence: FloatArray = peak + np.log(total)
    return evidence


def view_on_grid(fit: GridFit, subjects: Subjects) -> View:
    """
    Tell what all other references say of log k and of a label's offset, for any objects.

    Parameters
    ----------
    fit : GridFit
        The posteriors.
    subjects : Subjects
        The objects.

    Returns
    -------
    View
        A case for each point of a window that holds all the mass. To objects of a label with
        references the points are those of v = log k + u, with log k given v; to others those of
        log k. The weights hold the evidence of the references.
    """
    known, own = (subjects.group >= 0)[:, None], subjects.own >= 0
    image = subjects.image[:, None]
    # a label's references speak of v; to other labels all speak of log k, and u is independent
    by_label = np.concatenate([fit.log_seen + fit.log_group, fit.log_density])
    source = np.where(known[:, 0], subjects.group, len(fit.log_group) + subjects.image)
    log_seen = by_label[source]
    log_seen[own] -= fit.log_row[subjects.own[own]]
    window = _window(log_seen)
    points, group = fit.points[image, window], np.maximum(subjects.group, 0)[:, None]
    mean = np.where(known, fit.seen_mean[group, window], points)
    variance = np.where(known, fit.seen_var[group, window], 0.0)
    # where there is no other reference nothing is known of log k, and of u no more than its prior
    alone = (fit.n_references[subjects.image] == own)[:, None]
    log_weight = np.take_along_axis(log_seen, window, axis=1) + np.log(fit.step[image])
    return View(
        log_weight=np.where(alone, 0.0, log_weight),
        log_k=np.where(alone, np.nan, mean),
        log_k_var=np.where(alone, np.nan, variance),
        offset=np.where(alone, 0.0, points - mean),
        offset_var=np.where(alone | ~known, subjects.tau[:, None] ** 2, variance),
        covariance=np.where(alone, 0.0, -variance),
    )


def believe(obs: LogObservations, fit: GridFit) -> tuple[LogFit, FloatArray]:
    """
    Summarise the posteriors: how far each reference was believed, and k from those that were.

    Parameters
    ----------
    obs : LogObservations
        The references.
    fit : GridFit
        Their posteriors.

    Returns
    -------
    summary : LogFit
        Log k is the mean of the references' own, weighted by the precisions that they kept.
    kinds : (N, J) ndarray of float64
        Probability that each is sound and of the kind j of its label.
    """
    log_weight = (fit.log_seen + fit.log_group)[obs.group]
    window = _window(log_weight)
    weight = normalised(np.take_along_axis(log_weight, window, axis=1), 1)
    part = obs.kinds
    kinds = np.empty_like(part.share)
    for rows in _blocks(obs.y.size, window.shape[1] * part.share.shape[1]):
        v = fit.points[obs.image[rows, None], window[rows]]
        sound, wrong = _densities(obs, rows, v, fit.least_var[obs.image[rows]])
        total = np.maximum(sound.sum(axis=2) + wrong, _TINY)
        kinds[rows] = np.einsum("ng,ngj->nj", weight[rows] / total, sound)
    trust = kinds.sum(axis=1)
    precision = (kinds / part.variance).sum(axis=1)
    own = np.where(precision > 0, (kinds / part.variance * part.mean).sum(axis=1), 0.0)
    share = shares_of_k(obs, precision)
    own_k = np.where(precision > 0, own / np.where(precision > 0, precision, 1.0), obs.y)
    density = normalised(fit.log_density, 1)
    mean = (density * fit.points).sum(axis=1)
    variance = (density * (fit.points - mean[:, None]) ** 2).sum(axis=1)
    summary = LogFit(
        log_k=sum_by(obs.image, share * own_k),
        log_std=np.sqrt(variance),
        trust=trust,
        weight=precision,
        share=share,
    )
    return summary, kinds


def _blocks(count: int, size: int) -> Iterator[slice]:
    """Split rows of a size into blocks that fit into the processor's cache."""
    height = max(1, _BLOCK // size)
    for start in range(0, count, height):
        yield slice(start, start + height)


def _densities(
    obs: LogObservations, rows: slice, v: FloatArray, added_var: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Densities of references that are sound, of each kind (R, G, J), and wrong (R, G), at v."""
    part, firm = obs.kinds, obs.firm[rows]
    variance = (part.variance[rows] + added_var[:, None])[:, None, :]
    share = part.share[rows] * np.where(firm, 1.0, SOUND)[:, None]
    residual = part.mean[rows][:, None, :] - v[:, :, None]
    sound = (share[:, None, :] / np.sqrt(variance)) * np.exp(-0.5 * residual**2 / variance)
    wrong = outlier_density(obs.y[rows][:, None] - v, (obs.variance[rows] + added_var)[:, None])
    return sound, np.where(firm[:, None], 0.0, wrong)


def _window(log_values: FloatArray) -> IntArray:
    """Columns that hold all the mass of each row, as many in every row."""
    heavy = log_values > log_values.max(axis=1, keepdims=True) - _NEGLIGIBLE
    size = log_values.shape[1]
    first, last = np.argmax(heavy, axis=1), size - np.argmax(heavy[:, ::-1], axis=1)
    width = int((last - first).max(initial=1))
    window: IntArray = np.minimum(first, size - width)[:, None] + np.arange(width)
    return window


def _seen(
    log_density: FloatArray, points: FloatArray, std_steps: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Log likelihood of v = log k + u, and mean and variance of log k given v."""
    if not std_steps.any():
        return log_density, points, np.zeros_like(points)
    peak = log_density.max(axis=1, keepdims=True)
    density = np.exp(np.maximum(log_density - peak, _LOWEST))
    centre = (density * points).sum(axis=1, keepdims=True) / density.sum(axis=1, keepdims=True)
    x = points - centre
    moments = np.concatenate([density, density * x, density * x**2])
    total, first, second = np.split(_smoothed(moments, np.tile(std_steps, 3)), 3)
    total = np.maximum(total, _TINY)
    mean = first / total
    return np.log(total) + peak, mean + centre, np.maximum(second / total - mean**2, 0.0)


def _log_smoothed(log_values: FloatArray, std_steps: FloatArray) -> FloatArray:
    """Convolve functions that are given by their logarithms with normal densities."""
    if not std_steps.any():
        return log_values
    peak = log_values.max(axis=1, keepdims=True)
    smooth = _smoothed(np.exp(log_values - peak), std_steps)
    result: FloatArray = np.log(np.maximum(smooth, _TINY)) + peak
    return result


def _smoothed(values: FloatArray, std_steps: FloatArray) -> FloatArray:
    """Convolve rows with normal densities; they count as 0 beyond their ends."""
    rows, size = values.shape
    reach = max(1, min(math.ceil(_KERNEL_REACH * float(std_steps.max())), size - 1))
    at = np.arange(-reach, reach + 1)
    variance = std_steps[:, None] ** 2
    narrow = variance < _NARROW
    kernel = np.exp(-0.5 * at**2 / np.where(narrow, 1.0, variance))
    kernel /= kernel.sum(axis=1, keepdims=True)
    three = np.where(at == 0, 1 - variance, np.where(np.abs(at) == 1, variance / 2, 0.0))
    kernel = np.where(narrow, three, kernel)
    padded = np.zeros((rows, size + 2 * reach))
    padded[:, reach : reach + size] = values
    windows = np.lib.stride_tricks.sliding_window_view(padded, kernel.shape[1], axis=1)
    result: FloatArray = np.einsum("rgt,rt->rg", windows, kernel)
    return result


def _grid(obs: LogObservations) -> tuple[FloatArray, FloatArray]:
    """Place each image's points; and the least variance that they can resolve."""
    part = obs.kinds
    low = np.where(part.share > 0, part.mean, np.inf).min(axis=1)
    high = np.where(part.share > 0, part.mean, -np.inf).max(axis=1)
    std = np.sqrt(np.where(part.share > 0, part.variance, np.inf).min(axis=1))
    n_images = obs.n_images
    fallible = np.bincount(obs.image, ~obs.firm, n_images)
    sharpest = np.full(n_images, np.inf)
    np.minimum.at(sharpest, obs.image, np.hypot(std, obs.tau))
    reach = _REACH * sharpest + np.where(
        fallible > 0, _OUTLIER_REACH / np.maximum(fallible, 1), 0.0
    )
    first, last = np.full(n_images, np.inf), np.full(n_images, -np.inf)
    np.minimum.at(first, obs.image, low)
    np.maximum.at(last, obs.image, high)
    first, last = first - reach, last + reach
    # a firm witness leaves no other place, but for the labels' offsets
    offset = np.zeros(n_images)
    np.maximum.at(offset, obs.image, _REACH * obs.tau)
    firm_reach = np.where(obs.firm, 2 * _REACH * std + offset[obs.image], np.inf)
    np.maximum.at(first, obs.image, obs.y - firm_reach)
    np.minimum.at(last, obs.image, obs.y + firm_reach)
    information = np.bincount(obs.group, 1 / std**2)
    image, _ = obs.of_groups()
    least_std = np.full(n_images, np.inf)
    np.minimum.at(least_std, image, 1 / np.sqrt(information))
    wanted = np.ceil((last - first) / (_STEP * least_std)) + 1
    count = int(min(max(wanted.max(), 16), _LARGEST_GRID))
    points = np.linspace(first, last, count, axis=1)
    step = points[:, 1] - points[:, 0]
    members = np.bincount(obs.group).max(initial=1)
    too_fine = step > _STEP * least_std * 1.001
    return points, np.where(too_fine, members * (step / _STEP) ** 2, 0.0)
