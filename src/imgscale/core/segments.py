"""
The plain columns that every solver works on: references of many images as segments of one array.

Every reference i of an image is one observation of log k,

    y_i = log(H_i / (d_i p_i)) = log k + u_c + e_i,    e_i ~ N(0, v_i),    u_c ~ N(0, tau_c^2),

where u_c, the deviation of the label's mean from the table's, is shared by all references of the
label c. H_i is the label's prior: one size, or a mixture of the kinds of thing it stands for.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imgscale._typing import BoolArray, FloatArray, IntArray

# Relative errors below 1e-6 count as 1e-6: no weight is infinite.
MIN_VARIANCE = 1e-12


class Parts(NamedTuple):
    """
    The kinds of thing that a label may stand for (adult, child, sitting), as a mixture.

    Attributes
    ----------
    share : (N, J) ndarray of float64
        Their weights, which sum to 1 in each row; 0 fills the rows of labels with fewer kinds.
    mean : (N, J) ndarray of float64
        Mean of each kind.
    variance : (N, J) ndarray of float64
        Variance of each kind.
    """

    share: FloatArray
    mean: FloatArray
    variance: FloatArray


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
    mixture : Parts or None
        The kinds whose moments `y` and `variance` are; None where each label has one.
    """

    y: FloatArray
    variance: FloatArray
    tau: FloatArray
    image: IntArray
    group: IntArray
    firm: BoolArray
    mixture: Parts | None = None

    @property
    def n_images(self) -> int:
        """Number of images."""
        return int(self.image.max(initial=-1)) + 1

    @property
    def n_groups(self) -> int:
        """Number of (image, label) pairs."""
        return int(self.group.max(initial=-1)) + 1

    @property
    def kinds(self) -> Parts:
        """The mixture, of one kind where there is none."""
        one = np.ones((self.y.size, 1))
        return self.mixture or Parts(one, self.y[:, None], self.variance[:, None])

    @property
    def total_std(self) -> FloatArray:
        """Standard deviation of y about log k, label offset included."""
        return np.sqrt(self.variance + self.tau**2)

    def of_groups(self) -> tuple[IntArray, FloatArray]:
        """
        Look up what the references of a group have in common.

        Returns
        -------
        image : (n_groups,) ndarray of int
            Image of each group.
        tau : (n_groups,) ndarray of float64
            Standard deviation of its offset.
        """
        image, tau = np.zeros(self.n_groups, dtype=np.intp), np.zeros(self.n_groups)
        image[self.group], tau[self.group] = self.image, self.tau
        return image, tau


class LogFit(NamedTuple):
    """
    Estimates of log k for many images.

    Attributes
    ----------
    log_k : (n_images,) ndarray of float64
        The estimate.
    log_std : (n_images,) ndarray of float64
        Its standard error.
    trust : (N,) ndarray of float64
        How far each reference was believed, 0 (an outlier) to 1.
    weight : (N,) ndarray of float64
        Precision that each reference kept: its trust over its variance, widened where they
        disagree.
    share : (N,) ndarray of float64
        Share of each reference in log k; they sum to 1 in every image.
    disagree : (n_images,) ndarray of bool or None
        True where the references disagree by much more than their errors; None where that was not
        asked.
    """

    log_k: FloatArray
    log_std: FloatArray
    trust: FloatArray
    weight: FloatArray
    share: FloatArray
    disagree: BoolArray | None = None


class Subjects(NamedTuple):
    """
    Objects that are to be seen from the references of their image.

    Attributes
    ----------
    image, group : (M,) ndarray of int
        Image and (image, label) of each object; -1 for a label without references.
    tau : (M,) ndarray of float64
        Standard deviation of the label's offset for each object.
    own : (M,) ndarray of int
        Which reference the object itself was, that must not be told again; -1 for none.
    """

    image: IntArray
    group: IntArray
    tau: FloatArray
    own: IntArray


class View(NamedTuple):
    """
    What the references of its image say of each object, before its own prior and pixels.

    The posterior of (log k, u) is a mixture of C Gaussians.

    Attributes
    ----------
    log_weight : (M, C) ndarray of float64
        Log of the weight of each case, up to a factor common to the row.
    log_k, log_k_var : (M, C) ndarray of float64
        Mean and variance of log k.
    offset, offset_var : (M, C) ndarray of float64
        Mean and variance of the label's offset u.
    covariance : (M, C) ndarray of float64
        Covariance of log k and u. Without any other reference log k is NaN and u its prior.
    """

    log_weight: FloatArray
    log_k: FloatArray
    log_k_var: FloatArray
    offset: FloatArray
    offset_var: FloatArray
    covariance: FloatArray


def normalised(log_weight: FloatArray, axis: int) -> FloatArray:
    """
    Turn logs of weights into weights that sum to 1.

    Parameters
    ----------
    log_weight : ndarray of float
        The logs, up to a constant.
    axis : int
        The axis along which they sum to 1.

    Returns
    -------
    ndarray of float64
        The weights.
    """
    weight = np.exp(log_weight - log_weight.max(axis=axis, keepdims=True))
    result: FloatArray = weight / weight.sum(axis=axis, keepdims=True)
    return result


def shares_of_k(obs: LogObservations, weight: FloatArray) -> FloatArray:
    """
    Compute the share of each reference in log k.

    Parameters
    ----------
    obs : LogObservations
        The references.
    weight : (N,) ndarray of float
        The precision that each kept.

    Returns
    -------
    (N,) ndarray of float64
        Shares, which sum to 1 in each image. The offset integrated out, a label whose references
        weigh W together weighs 1 / (1 / W + tau^2).
    """
    group_weight = np.bincount(obs.group, weight)
    information = weight / (1 + group_weight[obs.group] * obs.tau**2)
    return information / np.bincount(obs.image, information, obs.n_images)[obs.image]


def sum_by(segment: IntArray, rows: FloatArray) -> FloatArray:
    """
    Sum the rows of each segment.

    Parameters
    ----------
    segment : (N,) ndarray of int
        Segment of each row; every number from 0 to the largest occurs.
    rows : (N, ...) ndarray of float
        The rows.

    Returns
    -------
    (n_segments, ...) ndarray of float64
        The sums.
    """
    order = np.argsort(segment, kind="stable")
    starts = np.flatnonzero(np.diff(segment[order], prepend=-1))
    total: FloatArray = np.add.reduceat(rows[order], starts, axis=0)
    return total


def median_by(
    segment: IntArray, values: FloatArray, weights: FloatArray, n_segments: int
) -> FloatArray:
    """
    Compute the weighted median of each segment.

    Parameters
    ----------
    segment : (N,) ndarray of int
        Segment of each value.
    values, weights : (N,) ndarray of float
        The values and their weights, positive.
    n_segments : int
        Number of segments.

    Returns
    -------
    (n_segments,) ndarray of float64
        The medians; the mean of both values where two share the middle.
    """
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
