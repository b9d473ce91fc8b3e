"""
The robust estimator of log k, and what it says of each object: arrays only, many images at once.

Every reference i of an image is one observation of log k,

    y_i = log(H_i / (d_i p_i)) = log k + u_c + e_i,    e_i ~ N(0, v_i),    u_c ~ N(0, tau_c^2),

where u_c, the deviation of the label's mean from the table's, is shared by all references of the
label c. It is integrated out in closed form: with W the sum of a label's weights, the label weighs
1 / (1 / W + tau^2).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imgscale._typing import BoolArray, FloatArray, IntArray

# Tukey's biweight: 95 % as efficient as least squares where the noise is Gaussian.
_TUKEY_C = 4.685
# Makes the median absolute deviation estimate a standard deviation.
_MAD_TO_STD = 1.4826
# Median absolute deviations, in standard errors, from which on the result is widened and from which
# on it is reported: two sound references reach them in 6 and 2 of 100 images, more in fewer.
_WIDEN_MAD = 2.0
_REPORT_MAD = 2.5
_MAX_STEPS = 100
_STEP_TOLERANCE = 1e-13
# Relative errors below 1e-6 count as 1e-6: no weight is infinite.
MIN_VARIANCE = 1e-12
_ROUNDING = 1e-13


class LogObservations(NamedTuple):
    """
    References of many images as columns.

    Attributes
    ----------
    y : (N,) ndarray of float64
        Log k as each reference alone gives it.
    variance : (N,) ndarray of float64
        Variance of its own noise: spread of individuals, box and depth; at least `MIN_VARIANCE`.
    tau : (N,) ndarray of float64
        Standard deviation of its label's shared offset.
    image : (N,) ndarray of int
        Which image it belongs to, 0 to n_images - 1.
    group : (N,) ndarray of int
        Which (image, label) it belongs to, 0 to n_groups - 1.
    firm : (N,) ndarray of bool
        True for a witness that is no label's affair, as a camera: its declared error stands,
        whatever the others say.
    """

    y: FloatArray
    variance: FloatArray
    tau: FloatArray
    image: IntArray
    group: IntArray
    firm: BoolArray

    @property
    def n_images(self) -> int:
        """Number of images."""
        return int(self.image.max(initial=-1)) + 1

    @property
    def total_std(self) -> FloatArray:
        """Standard deviation of y about log k, label offset included."""
        return np.sqrt(self.variance + self.tau**2)


class LogFit(NamedTuple):
    """
    Estimates of log k for many images.

    Attributes
    ----------
    log_k : (n_images,) ndarray of float64
        The estimate.
    log_std : (n_images,) ndarray of float64
        Its standard error.
    inconsistent : (n_images,) ndarray of bool
        True where the references disagree by much more than their errors; log_std is then widened.
    trust : (N,) ndarray of float64
        How far each reference was believed, 0 (an outlier) to 1.
    weight : (N,) ndarray of float64
        Precision that each reference kept: its trust over its variance, widened where they
        disagree.
    share : (N,) ndarray of float64
        Share of each reference in log k; they sum to 1 in every image.
    """

    log_k: FloatArray
    log_std: FloatArray
    inconsistent: BoolArray
    trust: FloatArray
    weight: FloatArray
    share: FloatArray


class OthersView(NamedTuple):
    """
    What all other references of its image say of each object, before its own prior and pixels.

    Attributes
    ----------
    log_k, log_k_var : (N,) ndarray of float64
        Mean and variance of log k.
    offset, offset_var : (N,) ndarray of float64
        Mean and variance of the label's offset u.
    covariance : (N,) ndarray of float64
        Covariance of log k and u. Without any other reference log k is NaN and u its prior.
    """

    log_k: FloatArray
    log_k_var: FloatArray
    offset: FloatArray
    offset_var: FloatArray
    covariance: FloatArray


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
    start = _segment_median(obs.y, obs.total_std**-2, obs.image, obs.n_images)
    excess, inconsistent = _excess_variance(obs, start)
    excess_of_row = np.where(obs.firm, 0.0, excess[obs.image])
    widened = obs._replace(variance=obs.variance + excess_of_row)
    log_k = start
    trust, share = np.ones_like(obs.y), np.zeros_like(obs.y)
    for _ in range(_MAX_STEPS):
        residual = (obs.y - log_k[obs.image]) / (widened.total_std * _TUKEY_C)
        trust = np.where(obs.firm, 1.0, np.maximum(0.0, 1 - residual**2) ** 2)
        share = _shares(widened, trust / widened.variance)
        step = np.bincount(obs.image, share * (obs.y - log_k[obs.image]), obs.n_images)
        log_k = log_k + step
        if np.all(np.abs(step) <= _STEP_TOLERANCE):
            break
    return LogFit(
        log_k=log_k,
        log_std=log_k_std(widened, share),
        inconsistent=inconsistent,
        trust=trust,
        weight=trust / widened.variance,
        share=share,
    )


def _excess_variance(obs: LogObservations, centre: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Variance, common to an image's references, beyond their errors; and whether to tell."""
    deviation = np.abs(obs.y - centre[obs.image])
    equal = np.ones_like(deviation)
    raw = _segment_median(deviation, equal, obs.image, obs.n_images)
    relative = _segment_median(deviation / obs.total_std, equal, obs.image, obs.n_images)
    beyond_chance = np.maximum(_MAD_TO_STD * relative, _WIDEN_MAD)
    excess: FloatArray = (_MAD_TO_STD * raw) ** 2 * (1 - (_WIDEN_MAD / beyond_chance) ** 2)
    return excess, beyond_chance > _REPORT_MAD


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


class Subjects(NamedTuple):
    """
    Objects that are to be seen from the references of their image.

    Attributes
    ----------
    image, group : (M,) ndarray of int
        Image and (image, label) of each object; -1 for a label without references.
    tau : (M,) ndarray of float64
        Standard deviation of the label's offset for each object.
    own_weight, own_y : (M,) ndarray of float64
        What the object itself gave to the fit and must not be told again; 0 where it was no
        reference.
    """

    image: IntArray
    group: IntArray
    tau: FloatArray
    own_weight: FloatArray
    own_y: FloatArray


def view_from_others(obs: LogObservations, weight: FloatArray, subjects: Subjects) -> OthersView:
    """
    Tell what all other references say of log k and of a label's offset, for any objects.

    Parameters
    ----------
    obs : LogObservations
        The references.
    weight : (N,) ndarray of float
        The precision that each kept in the fit.
    subjects : Subjects
        The objects.

    Returns
    -------
    OthersView
        Closed form of the two-dimensional Gaussian posterior of (log k, u).

    Notes
    -----
    With A, m the weight and mean of log k from other labels and W, y those of the label's other
    references, D = A + W + A W tau^2 gives var(log k) = (1 + W tau^2) / D, var(u) = tau^2 (A + W)
    / D and cov(log k, u) = -tau^2 W / D.
    """
    n_groups = int(obs.group.max(initial=-1)) + 1
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
    mates = _remainder(label_weight[group], subjects.own_weight)
    mates_sum = label_sum[group] - subjects.own_weight * subjects.own_y
    with np.errstate(invalid="ignore", divide="ignore"):
        mates_mean = np.where(mates > 0, mates_sum / mates, 0.0)
    return _two_by_two(other, other_sum, mates, mates_mean, subjects.tau**2)


def fuse_with_prior(
    view: OthersView,
    prior_log: FloatArray,
    prior_var: FloatArray,
    log_size: FloatArray,
    noise_var: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """
    Combine an object's prior with its measurement, which are correlated through label and k.

    Parameters
    ----------
    view : OthersView
        What all other references say.
    prior_log, prior_var : (M,) ndarray of float
        Mean and variance between individuals of the log size.
    log_size, noise_var : (M,) ndarray of float
        Measured log(d p) and its variance; NaN where there is no depth.

    Returns
    -------
    mean, variance : (M,) ndarray of float64
        Of log size. The prior alone where there is no other reference or no depth.

    Notes
    -----
    The best linear combination of A = prior_log - u and B = log k + log_size, whose covariance is
    -cov(log k, u).
    """
    alone = np.isnan(view.log_k) | np.isnan(log_size)
    a, b = prior_log - view.offset, view.log_k + log_size
    var_a, var_b = prior_var + view.offset_var, view.log_k_var + noise_var
    cov = -view.covariance
    spread = var_a + var_b - 2 * cov
    gain = np.where(alone | (spread <= 0), 0.0, (var_a - cov) / spread)
    mean = np.where(alone, a, a + gain * (b - a))
    return mean, np.where(alone, var_a, var_a - gain * (var_a - cov))


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
) -> OthersView:
    """Posterior of (log k, u) from other labels' references and the label's own."""
    det = other + own_weight + other * own_weight * tau2
    alone = det == 0  # nothing is known of log k, and of u no more than its prior
    det = np.where(alone, np.nan, det)
    log_k = (other_sum * (1 + own_weight * tau2) + own_weight * own_mean) / det
    offset = tau2 * own_weight * (other * own_mean - other_sum) / det
    return OthersView(
        log_k=log_k,
        log_k_var=(1 + own_weight * tau2) / det,
        offset=np.where(alone, 0.0, offset),
        offset_var=np.where(alone, tau2, tau2 * (other + own_weight) / det),
        covariance=np.where(alone, 0.0, -tau2 * own_weight / det),
    )


def _shares(obs: LogObservations, weight: FloatArray) -> FloatArray:
    """Share of each reference in log k, from the precisions that they kept."""
    group_weight = np.bincount(obs.group, weight)
    information = weight / (1 + group_weight[obs.group] * obs.tau**2)
    return information / np.bincount(obs.image, information, obs.n_images)[obs.image]


def _segment_median(
    values: FloatArray, weights: FloatArray, segment: IntArray, n_segments: int
) -> FloatArray:
    """Weighted median of each segment; the mean of both where two values share the middle."""
    order = np.lexsort((values, segment))
    ordered, ordered_segment = values[order], segment[order]
    total = np.bincount(segment, weights, n_segments)[ordered_segment]
    position = np.cumsum(weights[order] / total) - ordered_segment  # 0 to 1 in each segment
    ends = np.cumsum(np.bincount(ordered_segment, minlength=n_segments)) - 1
    below = np.bincount(ordered_segment, position < 0.5 - 1e-9, n_segments).astype(np.intp)
    upto = np.bincount(ordered_segment, position <= 0.5 + 1e-9, n_segments).astype(np.intp)
    starts = np.concatenate(([0], ends[:-1] + 1))
    lower = np.minimum(starts + below, ends)
    upper = np.minimum(starts + upto, ends)
    return (ordered[lower] + ordered[upper]) / 2
