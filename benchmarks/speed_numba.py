"""
The robust estimator of metric depth as one compiled loop: how fast it could be on one thread.

It does what `imgscale.batch.fit_columns` does and gives the same numbers: weighted median, excess
variance, Tukey's biweight to convergence with the labels' offsets integrated out, then every row's
size with its interval. It needs numba; the library does not.
"""

from __future__ import annotations

import math
import statistics
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from speed_columns import Columns, Sizes

import imgscale as ims
from imgscale.implied_focal import LARGEST_PHOTO_PX
from imgscale.laws import PLAUSIBLE_FOCAL

_SHORTEST, _LONGEST = PLAUSIBLE_FOCAL
_TUKEY_C, _MAD_TO_STD = 4.685, 1.4826
_WIDEN_MAD, _REPORT_MAD = 2.0, 2.5
# Squares of steps in standard errors, after which none is needed: the next would be smaller by as
# much again, or the same once more.
_MAX_STEPS, _LAST_STEP, _LAST_PLAIN_STEP = 120, 1e-16, 1e-24
# Newton's steps begin within a quarter of the standard error, where the equation is steep.
_NEAR, _STEEP = 0.25**2, 0.1
_MIN_VARIANCE, _REJECTED, _TIE = 1e-12, 0.1, 1e-9
_MANY = 32  # from here on the places are first sorted at longer distances
_SINGLE, _ONE_LABEL, _OUTLIERS, _INCONSISTENT, _REFERENCE, _NO_DEPTH, _IMPLAUSIBLE = (
    flag.value
    for flag in (
        ims.Flag.SINGLE_REFERENCE,
        ims.Flag.SINGLE_LABEL,
        ims.Flag.OUTLIERS,
        ims.Flag.INCONSISTENT,
        ims.Flag.REFERENCE,
        ims.Flag.NO_DEPTH,
        ims.Flag.IMPLAUSIBLE_FOCAL,
    )
)
_NO_PRIOR_REASON, _NO_DEPTH_REASON, _OUTLIER_REASON = 1, 3, 4

# Nothing is allocated in the loop, and no references to arrays are counted: that halves the time.
_loop_over = njit(error_model="numpy", _nrt=False)
_part = njit(error_model="numpy", _nrt=False, inline="always")

Floats = NDArray[np.float64]
Places = NDArray[np.intp]
Whole = NDArray[np.int32]


class Images(NamedTuple):
    """The columns of images; see `imgscale.batch.ImageColumns`."""

    k: Floats
    k_std: Floats
    flags: Whole
    n_objects: Whole
    n_candidates: Whole
    n_used: Whole


class Rows(NamedTuple):
    """The columns of rows; see `imgscale.batch.RowColumns`."""

    image: Whole
    size_m: Floats
    std_m: Floats
    low_m: Floats
    high_m: Floats
    weight: Floats
    reason: NDArray[np.int8]
    flags: Whole


class Errors(NamedTuple):
    """Noise as it was told, and the score of the intervals' upper end."""

    box_px: float
    box_rel: float
    depth_var: float
    score: float


class Work(NamedTuple):
    """The references of one image, and room to work on them."""

    row: Places
    group: Places
    order: Places
    merged: Places
    y: Floats
    noise_var: Floats
    precision: Floats
    total_var: Floats
    scratch: Floats
    trust: Floats
    share: Floats
    tau2: Floats
    sums: Floats
    group_of: Places
    seen_in: Places


def robust(
    columns: Columns, prior: Sizes, noise: ims.Noise, level: float = 0.9
) -> tuple[NDArray[np.int64], Images, Rows]:
    """
    Fit all images and size all rows.

    Parameters
    ----------
    columns : Columns
        The references, their ids ascending.
    prior : Sizes
        Prior of each label.
    noise : Noise
        Errors of boxes and depths, told.
    level : float
        Probability of the intervals.

    Returns
    -------
    image_id : (M,) ndarray of int64
        The ids.
    images : Images
        One row per image.
    rows : Rows
        One row per reference.
    """
    score = statistics.NormalDist().inv_cdf((1 + level) / 2)
    errors = Errors(noise.box_px, noise.box_rel, (noise.depth_rel or 0.0) ** 2, score)
    starts = _starts(columns.image_id)
    images, rows = _new_images(starts), _new_rows(columns.image_id.size)
    work = _new_work(int(np.diff(starts).max(initial=1)), prior.tau.size)
    _loop(starts, columns, prior, errors, work, images, rows)
    return columns.image_id[starts[:-1]], images, rows


@njit(error_model="numpy")
def _starts(image_id: NDArray[np.int64]) -> Places:
    """Find where images start, and the end."""
    count = 0
    for row in range(image_id.size):
        count += row == 0 or image_id[row] != image_id[row - 1]
    starts = np.empty(count + 1, np.intp)
    count = 0
    for row in range(image_id.size):
        if row == 0 or image_id[row] != image_id[row - 1]:
            starts[count] = row
            count += 1
    starts[count] = image_id.size
    return starts


@_loop_over
def _loop(
    starts: Places,
    columns: Columns,
    prior: Sizes,
    errors: Errors,
    work: Work,
    images: Images,
    rows: Rows,
) -> None:
    for image in range(starts.size - 1):
        first, last = starts[image], starts[image + 1]
        count, n_groups, largest = _gather(image, first, last, columns, prior, errors, work, rows)
        images.n_candidates[image] = count
        if count:
            _fit(image, count, n_groups, work, images, rows)
            implied = 1 / images.k[image]
            longest = _LONGEST * max(largest, LARGEST_PHOTO_PX)
            if implied < _SHORTEST * largest or implied > longest:
                images.flags[image] |= _IMPLAUSIBLE
        _size(image, first, last, columns, errors, work, images, rows)


def _new_images(starts: Places) -> Images:
    count = starts.size - 1
    nothing, none = np.full(count, np.nan), np.zeros(count, np.int32)
    counts = (starts[1:] - starts[:-1]).astype(np.int32)
    return Images(nothing, nothing.copy(), none, counts, none.copy(), none.copy())


def _new_rows(count: int) -> Rows:
    room = np.empty((4, count))
    return Rows(
        np.empty(count, np.int32),
        room[0],
        room[1],
        room[2],
        room[3],
        np.zeros(count),
        np.zeros(count, np.int8),
        np.zeros(count, np.int32),
    )


def _new_work(most: int, n_labels: int) -> Work:
    whole, room = np.empty((4, most), np.intp), np.empty((7, most))
    return Work(
        whole[0], whole[1], whole[2], whole[3],
        room[0], room[1], room[2], room[3], room[4], room[5], room[6],
        np.empty(n_labels), np.empty((4, n_labels)),
        np.empty(n_labels, np.intp), np.full(n_labels, -1, np.intp),
    )  # fmt: skip


@_part
def _gather(
    image: int,
    first: int,
    last: int,
    columns: Columns,
    prior: Sizes,
    errors: Errors,
    work: Work,
    rows: Rows,
) -> tuple[int, int, float]:
    """Turn an image's rows into observations of log k; count them and their labels."""
    count, n_groups, largest = 0, 0, 0.0
    for row in range(first, last):
        pixels, depth, label = columns.pixels[row], columns.depth[row], columns.label[row]
        rows.image[row] = image
        largest = max(largest, pixels)
        noise_var = (errors.box_px / pixels) ** 2 + errors.box_rel**2 + errors.depth_var
        work.noise_var[row - first] = noise_var
        if label < 0 or math.isnan(prior.log_mean[label]):
            rows.reason[row] = _NO_PRIOR_REASON
        elif math.isnan(depth):
            rows.reason[row] = _NO_DEPTH_REASON
        else:
            if work.seen_in[label] != image:
                work.seen_in[label], work.group_of[label] = image, n_groups
                work.tau2[n_groups] = prior.tau[label] ** 2
                n_groups += 1
            group = work.group_of[label]
            variance = max(prior.log_var[label] + noise_var, _MIN_VARIANCE)
            work.row[count], work.group[count] = row, group
            work.y[count] = prior.log_mean[label] - math.log(pixels * depth)
            work.total_var[count] = variance + work.tau2[group]
            work.precision[count] = variance
            work.scratch[count] = 1 / work.total_var[count]
            count += 1
    return count, n_groups, largest


@_part
def _fit(image: int, count: int, n_groups: int, work: Work, images: Images, rows: Rows) -> None:
    centre = _weighted_median(work.y, work.scratch, work.order, count)
    excess, deviation = _widening(work, count, centre)
    for place in range(count):
        work.precision[place] = 1 / (work.precision[place] + excess)
        work.scratch[place] = 1 / (_TUKEY_C**2 * (work.total_var[place] + excess))
    log_k = _solve(work, count, n_groups, centre)
    images.k[image] = math.exp(log_k)
    images.k_std[image] = images.k[image] * math.sqrt(_share(work, count, n_groups, log_k))
    used, n_labels, before = 0, 1, -1
    for place in range(count):
        row = work.row[place]
        rows.weight[row] = work.share[place]
        if work.trust[place] < _REJECTED:
            rows.reason[row] = _OUTLIER_REASON
            rows.flags[row] |= _OUTLIERS
            images.flags[image] |= _OUTLIERS
            continue
        if work.share[place] > 0:
            rows.flags[row] |= _REFERENCE
        if used and work.group[place] != before:
            n_labels = 2
        before = work.group[place]
        used += 1
    images.n_used[image] = used
    if used == 1:
        images.flags[image] |= _SINGLE
    elif used > 1 and n_labels == 1:
        images.flags[image] |= _ONE_LABEL
    if deviation > _REPORT_MAD:
        images.flags[image] |= _INCONSISTENT


@_part
def _size(
    image: int,
    first: int,
    last: int,
    columns: Columns,
    errors: Errors,
    work: Work,
    images: Images,
    rows: Rows,
) -> None:
    """Size an image's rows; the errors of a reference are in k already, by its share."""
    k = images.k[image]
    log_k_var = (images.k_std[image] / k) ** 2
    for row in range(first, last):
        depth = columns.depth[row]
        if math.isnan(depth):
            rows.flags[row] |= _NO_DEPTH
        variance = log_k_var + work.noise_var[row - first] * (1 - 2 * rows.weight[row])
        log_std = math.sqrt(0.0 if variance < 0 else variance)  # NaN stays
        size_m = k * depth * columns.pixels[row]
        factor = math.exp(errors.score * log_std)
        rows.size_m[row] = size_m
        rows.std_m[row] = size_m * log_std
        rows.low_m[row] = size_m / factor
        rows.high_m[row] = size_m * factor


@_loop_over
def _sort(values: Floats, order: Places, count: int) -> None:
    """Sort places by their values by insertion, many of them in Shell's way."""
    gap = 1
    while gap < count // _MANY:
        gap = 3 * gap + 1
    while gap:
        for last in range(gap, count):
            place, spot = order[last], last
            while spot >= gap and values[order[spot - gap]] > values[place]:
                order[spot] = order[spot - gap]
                spot -= gap
            order[spot] = place
        gap //= 3


@_part
def _weighted_median(values: Floats, weights: Floats, order: Places, count: int) -> float:
    """Weighted median of values; the mean of both where two share the middle."""
    total = 0.0
    for place in range(count):
        order[place] = place
        total += weights[place]
    _sort(values, order, count)
    below, position = 0, 0.0
    while below < count - 1:
        position += weights[order[below]] / total
        if position >= 0.5 - _TIE:
            break
        below += 1
    upto = min(below + 1, count - 1) if position <= 0.5 + _TIE else below
    return (values[order[below]] + values[order[upto]]) / 2


@_part
def _middle(values: Floats, order: Places, count: int) -> float:
    return (values[order[(count - 1) // 2]] + values[order[count // 2]]) / 2


@_part
def _widening(work: Work, count: int, centre: float) -> tuple[float, float]:
    """Excess variance, and the median absolute deviation in standard errors."""
    deviation, order, merged = work.scratch, work.order, work.merged
    for place in range(count):
        deviation[place] = abs(work.y[place] - centre)
    low, high = 0, count - 1  # what is farthest is first or last
    for spot in range(count - 1, -1, -1):
        if deviation[order[low]] > deviation[order[high]]:
            merged[spot] = order[low]
            low += 1
        else:
            merged[spot] = order[high]
            high -= 1
    raw = _MAD_TO_STD * _middle(deviation, merged, count)
    for place in range(count):
        deviation[place] /= math.sqrt(work.total_var[place])
    _sort(deviation, merged, count)
    relative = _MAD_TO_STD * _middle(deviation, merged, count)
    return raw**2 * (1 - (_WIDEN_MAD / max(relative, _WIDEN_MAD)) ** 2), relative


@_part
def _solve(work: Work, count: int, n_groups: int, log_k: float) -> float:
    """
    Re-weight until nothing moves.

    Near the solution it takes Newton's steps on the same equation: with w the weights and W, S the
    sums of w and of w (y - log k) of a label, sum S / (1 + W tau^2) = 0.
    """
    y, precision, scale, sums, tau2 = work.y, work.precision, work.scratch, work.sums, work.tau2
    for _ in range(_MAX_STEPS):
        for group in range(n_groups):
            sums[0, group] = sums[1, group] = sums[2, group] = sums[3, group] = 0.0
        for place in range(count):
            group, residual = work.group[place], y[place] - log_k
            root = max(0.0, 1 - residual**2 * scale[place])
            weight = root**2 * precision[place]
            slope = 4 * root * residual * scale[place] * precision[place]
            sums[0, group] += weight
            sums[1, group] += weight * residual
            sums[2, group] += slope
            sums[3, group] += slope * residual - weight
        information, gradient, slope = 0.0, 0.0, 0.0
        for group in range(n_groups):
            shrink = 1 / (1 + sums[0, group] * tau2[group])
            information += sums[0, group] * shrink
            gradient += sums[1, group] * shrink
            bend = sums[1, group] * sums[2, group] * tau2[group] * shrink
            slope += (sums[3, group] - bend) * shrink
        step, limit = gradient / information, _LAST_PLAIN_STEP
        if step**2 * information < _NEAR and slope < -_STEEP * information:
            step, limit = -gradient / slope, _LAST_STEP
        log_k += step
        if step**2 * information <= limit:
            break
    return log_k


@_part
def _share(work: Work, count: int, n_groups: int, log_k: float) -> float:
    """Find the references' shares in log k; return its variance."""
    sums, tau2 = work.sums, work.tau2
    for group in range(n_groups):
        sums[0, group] = 0.0
    for place in range(count):
        root = max(0.0, 1 - (work.y[place] - log_k) ** 2 * work.scratch[place])
        work.trust[place] = root**2
        work.share[place] = work.trust[place] * work.precision[place]
        sums[0, work.group[place]] += work.share[place]
    information, variance = 0.0, 0.0
    for group in range(n_groups):
        information += sums[0, group] / (1 + sums[0, group] * tau2[group])
    for group in range(n_groups):
        sums[1, group] = 1 / (information * (1 + sums[0, group] * tau2[group]))
        variance += (sums[0, group] * sums[1, group]) ** 2 * tau2[group]
    for place in range(count):
        work.share[place] *= sums[1, work.group[place]]
        variance += work.share[place] ** 2 / work.precision[place]
    return variance
