"""From solutions to `SizeEstimate`: for `predict` and `leave_one_out` alike."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from imgscale._typing import BoolArray, FloatArray, IntArray
from imgscale.core.mixture import MEDIAN, SCORES, half_width
from imgscale.core.predictive import in_parts, measured, measured_again, with_priors
from imgscale.core.sighting import log_scales
from imgscale.core.solving import Cases
from imgscale.core.witnesses import Sized
from imgscale.detection import Detection
from imgscale.estimate import SizeEstimate
from imgscale.flags import Flag
from imgscale.model import ScaleModel
from imgscale.observations import Observations
from imgscale.posing import Setting

# Beyond the horizon is told where the 95 % interval reaches it.
TWO_STD = int(np.searchsorted(SCORES, 2.0))
# The central 92 % of a size's distribution.
LOW, HIGH = (int(np.searchsorted(SCORES, score)) for score in (-1.75, 1.75))
# How many times as near or far as the references' range a shift is not trusted.
FAR_OFF = 2.0


class Wanted(NamedTuple):
    """
    Objects to be sized.

    Attributes
    ----------
    subjects : Sized
        The objects.
    own : (M,) ndarray of int
        Which reference each was, along the same axis; -1 for none.
    common_var : (M,) ndarray of float64
        Variance of the errors that a reference shares with k, as far as it was told.
    share : (M,) ndarray of float64
        Share of the object in log k, 0 where it was no reference.
    fuse : (M,) ndarray of bool
        Where the object's own prior is fused with the measurement.
    rejected : (M,) ndarray of bool
        Where the object was a reference that was rejected.
    log_k : (M,) ndarray of float64
        Log of the scale constant of each object's image.
    """

    subjects: Sized
    own: IntArray
    common_var: FloatArray
    share: FloatArray
    fuse: BoolArray
    rejected: BoolArray
    log_k: FloatArray

    def rows(self, rows: IntArray) -> Wanted:
        """
        Take some rows.

        Parameters
        ----------
        rows : (M,) ndarray of int
            Which.

        Returns
        -------
        Wanted
            The rows.
        """
        columns: list[Any] = [column[rows] for column in self[1:]]
        return Wanted(self.subjects.rows(rows), *columns)


class Sizes(NamedTuple):
    """
    Sizes of objects.

    Attributes
    ----------
    size_m, std_m : (M,) ndarray of float64
        Median and standard error, in metres; NaN where it cannot be said.
    quantiles_m : (M, 29) ndarray of float64
        Quantiles at the standard scores, in metres.
    metres_per_pixel : (M,) ndarray of float64
        Scale at each object; NaN where there is none.
    range_per_focal : (M,) ndarray of float64
        Its z-depth over the focal length, in m/px.
    is_normal : bool
        True where the logs of the sizes are all normal.
    """

    size_m: FloatArray
    std_m: FloatArray
    quantiles_m: FloatArray
    metres_per_pixel: FloatArray
    range_per_focal: FloatArray
    is_normal: bool = True

    @classmethod
    def unknown(cls, count: int) -> Sizes:
        """
        Make a table in which nothing is known yet.

        Parameters
        ----------
        count : int
            Number of rows.

        Returns
        -------
        Sizes
            All NaN.
        """
        nothing = np.full(count, np.nan)
        return cls(nothing, nothing, np.full((count, SCORES.size), np.nan), nothing, nothing)

    def updated(self, rows: IntArray, part: Sizes) -> Sizes:
        """
        Replace some rows.

        Parameters
        ----------
        rows : (M,) ndarray of int
            Which.
        part : Sizes
            Their new values.

        Returns
        -------
        Sizes
            The table with the new rows.
        """
        columns: list[Any] = [column.copy() for column in self[:-1]]
        for column, values in zip(columns, part[:-1], strict=True):
            column[rows] = values
        return Sizes(*columns)._replace(is_normal=self.is_normal and part.is_normal)


def size_up(cases: Cases, wanted: Wanted) -> Sizes:
    """
    Size objects, so many at once as memory allows.

    Parameters
    ----------
    cases : Cases
        The solutions of their images.
    wanted : Wanted
        The objects.

    Returns
    -------
    Sizes
        One row each: without a prior the median is exactly k d p, where one witness tells d and
        k d p is not far off in the distribution of the size.
    """
    cases, rows = in_parts(cases, wanted.subjects)
    if len(rows) <= 1:
        return _size_up(cases, wanted)
    parts = [_size_up(cases, wanted.rows(part)) for part in rows]
    arrays = zip(*(part[:-1] for part in parts), strict=True)
    columns: list[Any] = [np.concatenate(column) for column in arrays]
    is_normal = all(part.is_normal for part in parts)
    return Sizes(*columns)._replace(is_normal=is_normal)


def _size_up(cases: Cases, wanted: Wanted) -> Sizes:
    """Size objects."""
    subjects = wanted.subjects
    log_scale, log_range = (wanted.log_k + logs[0] for logs in log_scales(subjects, cases.best))
    log_size = log_scale + subjects.log_pixels
    by_prior = wanted.fuse
    quantiles = _quantiles(cases, wanted)
    # k d p of the likeliest solution is no median where others, far from it, weigh more together
    far_off = (log_size < quantiles[:, LOW]) | (log_size > quantiles[:, HIGH])
    by_median = (_has_both(subjects) | far_off) & ~by_prior & ~np.isnan(log_size)
    if by_median.any() or by_prior.any():
        median = np.where(np.isfinite(quantiles[:, MEDIAN]), quantiles[:, MEDIAN], np.nan)
        log_scale = np.where(by_median, median - subjects.log_pixels, log_scale)
        log_size = np.where(by_median | by_prior, median, log_size)
    one_kind = subjects.prior.share.shape[1] == 1 or not by_prior.any()
    is_normal = cases.grid is None and len(cases.log_weight) == 1 and one_kind
    size_m = np.exp(log_size)
    unknown = np.isnan(size_m)[:, None]
    return Sizes(
        size_m=size_m,
        std_m=size_m * half_width(quantiles),
        quantiles_m=np.where(unknown, np.nan, _exp(quantiles)),
        metres_per_pixel=np.exp(log_scale),
        range_per_focal=np.exp(log_range),
        is_normal=is_normal,
    )


def _quantiles(cases: Cases, wanted: Wanted) -> FloatArray:
    """Quantiles of log sizes: fused with priors, of references, and of all others."""
    subjects = wanted.subjects
    again = ~wanted.fuse & (wanted.share > 0)
    plain = ~(wanted.fuse | again)
    if plain.all():
        return measured(cases, subjects).quantiles()
    quantiles = np.empty((wanted.own.size, SCORES.size))
    if plain.any():
        quantiles[plain] = measured(cases, subjects.rows(plain)).quantiles()
    if again.any():
        rows = subjects.rows(again), wanted.share[again], wanted.common_var[again]
        quantiles[again] = measured_again(cases, *rows).quantiles()
    fuse = wanted.fuse
    if fuse.any():
        quantiles[fuse] = with_priors(cases, subjects.rows(fuse), wanted.own[fuse])
    return quantiles


def _exp(logs: FloatArray) -> FloatArray:
    """Sizes of logs; those beyond all numbers are infinite."""
    with np.errstate(over="ignore"):
        return np.exp(logs)


def _has_both(subjects: Sized) -> BoolArray:
    """Tell which objects have a depth and a foot."""
    if subjects.stance is None:
        return np.zeros(subjects.image.size, dtype=np.bool_)
    both: BoolArray = np.isfinite(subjects.inverse_depth) & ~np.isnan(subjects.stance.foot)
    return both


def row_flags(
    obs: Observations,
    wanted: Wanted,
    sizes: Sizes,
    cases: Cases,
    references: Sized,
    shared: Flag,
) -> list[Flag]:
    """
    Collect each row's reservations.

    Parameters
    ----------
    obs : Observations
        The objects.
    wanted : Wanted
        What was wanted of them.
    sizes : Sizes
        Their sizes.
    cases : Cases
        The solutions that they rest on.
    references : Sized
        The references that tell how far from the camera these were fitted.
    shared : Flag
        Reservations that hold for all.

    Returns
    -------
    list of Flag
        One per object.
    """
    columns = {
        Flag.REFERENCE: (wanted.share > 0) & ~wanted.rejected,
        Flag.OUTLIERS: wanted.rejected,
        Flag.PRIOR_USED: wanted.fuse,
        Flag.NO_DEPTH: np.isnan(obs.depth),
        Flag.MIXED_DEPTH: obs.mixed,
        Flag.PARTIAL: obs.partial,
    }
    if cases.best.shift.any() or cases.best.gap is not None:
        own = np.log(sizes.range_per_focal) - wanted.log_k
        columns[Flag.EXTRAPOLATED] = is_far_off(own, references, cases)
        columns[Flag.BEYOND_HORIZON] = ~np.isnan(obs.depth) & (
            np.isnan(sizes.metres_per_pixel) | np.isposinf(sizes.quantiles_m[:, TWO_STD])
        )
    bits = np.full(obs.pixels.size, shared.value)
    for flag, column in columns.items():
        bits |= np.where(column, flag.value, 0)
    return [Flag(value) for value in bits.tolist()]


def is_far_off(log_range: FloatArray, references: Sized, cases: Cases) -> BoolArray:
    """
    Tell what is more than twice as near or as far as any reference.

    Parameters
    ----------
    log_range : (M,) ndarray of float64
        Log of the z-depths over the focal length, for k = 1; NaN where there is none.
    references : Sized
        The references, none or more.
    cases : Cases
        The solutions.

    Returns
    -------
    (M,) ndarray of bool
        False everywhere without references.
    """
    seen = log_scales(references, cases.best)[1][0]
    seen = seen[~np.isnan(seen)]
    if not seen.size:
        return np.zeros(log_range.size, dtype=np.bool_)
    reach = np.log(FAR_OFF)
    far_off: BoolArray = (log_range < seen.min() - reach) | (log_range > seen.max() + reach)
    return far_off


def distances(
    source: ScaleModel | Setting,
    depth: FloatArray,
    sizes: Sizes,
    log_k: FloatArray,
    *,
    other_map: bool = False,
) -> FloatArray | None:
    """
    Compute z-depths: focal length x k d, or what metric depth itself says.

    Parameters
    ----------
    source : ScaleModel or Setting
        What tells the kind of depth, the camera and the error of the map's scale.
    depth : (M,) ndarray of float
        Depth of each object.
    sizes : Sizes
        Their sizes and scales.
    log_k : (M,) ndarray of float
        Log of the scale constant of each.
    other_map : bool
        True where the depths are of another map than the fitted one.

    Returns
    -------
    (M,) ndarray of float64 or None
        In metres; None where no focal length is known.
    """
    camera = source.camera
    if source.kind != "metric":
        return None if camera is None else camera.focal_px * sizes.range_per_focal
    if camera is None or other_map:
        return depth
    share = map_share(source.scale_rel_std, camera.focal_rel_std)
    distance: FloatArray = depth * (camera.focal_px * np.exp(log_k)) ** share
    return distance


def map_share(scale_rel_std: float, focal_rel_std: float) -> float:
    """
    Share out f k of metric depth: the error of the map's scale times the focal length's.

    Parameters
    ----------
    scale_rel_std, focal_rel_std : float
        Relative standard errors of the map's scale and of the focal length.

    Returns
    -------
    float
        The part of log (f k) that the map takes for an error of its own, 0 to 1.
    """
    map_var = scale_rel_std**2
    return map_var / (map_var + focal_rel_std**2) if map_var else 0.0


def gather(
    detections: Sequence[Detection],
    obs: Observations,
    sizes: Sizes,
    flags: Sequence[Flag],
    distance_m: FloatArray | None,
) -> list[SizeEstimate]:
    """
    Gather columns into results.

    Parameters
    ----------
    detections : sequence of Detection
        The objects.
    obs : Observations
        Their columns.
    sizes : Sizes
        Their sizes.
    flags : sequence of Flag
        Their reservations.
    distance_m : (M,) ndarray of float or None
        Their z-depths in metres, where a focal length is known.

    Returns
    -------
    list of SizeEstimate
        One per object.
    """
    return [
        SizeEstimate(
            label=detection.label,
            axis=obs.axis[row],
            size_m=float(sizes.size_m[row]),
            std_m=float(sizes.std_m[row]),
            metres_per_pixel=float(sizes.metres_per_pixel[row]),
            depth=float(obs.depth[row]),
            distance_m=None if distance_m is None else float(distance_m[row]),
            flags=flags[row],
            quantiles_m=None if sizes.is_normal else tuple(sizes.quantiles_m[row].tolist()),
        )
        for row, detection in enumerate(detections)
    ]
