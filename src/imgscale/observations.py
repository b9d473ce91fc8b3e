"""
The seam: detections, depth, priors and noise become columns, with one reason per row.

It is the only way from objects to arrays, for `fit`, `predict` and `leave_one_out` alike, so that
they cannot sample, measure or select differently.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import attrs
import numpy as np

from imgscale._typing import BoolArray, FloatArray, ImageSize, IntArray, SizeAxis
from imgscale.depth import Depth, DepthMap, GroundPlane, ObjectDepths, check_depth_type
from imgscale.detection import Detection
from imgscale.extent import extent_rel_std, outside_image, pixel_extent, touches_border
from imgscale.laws import LAWS
from imgscale.noise import UNKNOWN_DEPTH_REL, Noise
from imgscale.object_prior import SIZE_AXES, ObjectPrior, normal_label
from imgscale.priors import PriorTable
from imgscale.sampling import DepthSample, sample_surface

__all__ = ["Observations", "observe"]

MeanKey: TypeAlias = tuple[str, SizeAxis]

NO_PRIOR = "no prior"
PARTIAL = "partial"
NO_DEPTH = "no depth"


class Observations(NamedTuple):
    """
    Hold detections as columns, one row each.

    Attributes
    ----------
    axis : tuple of str
        The axis that each row measures.
    pixels : (N,) ndarray of float64
        Extent along it, in pixels.
    depth : (N,) ndarray of float64
        Depth in the unit given, NaN where there is none.
    log_size : (N,) ndarray of float64
        log(d p): the log of the size for k = 1; NaN without depth.
    box_var, depth_var : (N,) ndarray of float64
        Variances of the logarithms of pixels and depth.
    prior_m, prior_std_m, prior_mean_std_m : (N,) ndarray of float64
        The label's prior along the axis, moments of the mixture; NaN without one.
    group : (N,) ndarray of int
        Number of the row's label and axis, which share one mean; -1 without a prior.
    mixed, partial : (N,) ndarray of bool
        Two surfaces in the box; box cut by the border or marked partial.
    reason : tuple of str
        Why a row cannot be a reference, empty where it can.
    """

    axis: tuple[SizeAxis, ...]
    pixels: FloatArray
    depth: FloatArray
    log_size: FloatArray
    box_var: FloatArray
    depth_var: FloatArray
    prior_m: FloatArray
    prior_std_m: FloatArray
    prior_mean_std_m: FloatArray
    group: IntArray
    mixed: BoolArray
    partial: BoolArray
    reason: tuple[str, ...]

    @property
    def noise_var(self) -> FloatArray:
        """The variance of log(d p)."""
        return self.box_var + self.depth_var

    @property
    def prior_var(self) -> FloatArray:
        """Variance of log size between individuals, ``s^2 = log(1 + (std / mean)^2)``."""
        return np.log1p((self.prior_std_m / self.prior_m) ** 2)

    @property
    def prior_log(self) -> FloatArray:
        """Mean of log size, ``log(mean) - s^2 / 2``."""
        return np.log(self.prior_m) - self.prior_var / 2

    @property
    def tau(self) -> FloatArray:
        """Standard deviation of the label's shared offset of log size."""
        return self.prior_mean_std_m / self.prior_m

    @property
    def eligible(self) -> IntArray:
        """The rows that can be references."""
        return np.flatnonzero([not reason for reason in self.reason])


def with_image_size(
    depth: DepthMap | ObjectDepths, image_size: ImageSize | None
) -> DepthMap | ObjectDepths:
    """
    Tell depth the size of its image where it does not know it.

    Parameters
    ----------
    depth : DepthMap or ObjectDepths
        The depth.
    image_size : (width, height) or None
        Size of the image in pixels, as the camera or the model knows it.

    Returns
    -------
    DepthMap or ObjectDepths
        The same depth, with an `image_size` where there is one.
    """
    if isinstance(depth, DepthMap) or depth.image_size or not image_size:
        return depth
    return attrs.evolve(depth, image_size=image_size)


def observe(
    detections: Sequence[Detection],
    depth: Depth,
    priors: PriorTable,
    noise: Noise,
    *,
    axis: SizeAxis | None = None,
) -> Observations:
    """
    Turn detections and depth into columns.

    Parameters
    ----------
    detections : sequence of Detection
        The objects.
    depth : DepthMap or ObjectDepths
        Their depth.
    priors : PriorTable
        Sizes by label.
    noise : Noise
        Errors of boxes and depths.
    axis : str, optional
        Measure every object along this axis. Where omitted, each is measured along the axis of
        its label's most precise prior.

    Returns
    -------
    Observations
        One row per detection.

    Raises
    ------
    ValueError
        If a box or mask does not belong to the image, or there is not one depth per detection.
    TypeError
        If depth is not one of the depth types.
    """
    depth = usable_depth(depth)
    boxes = _boxes(detections)
    _check_in_image(boxes, depth)
    _check_masks(detections, depth)
    extents: dict[SizeAxis, FloatArray] = {name: pixel_extent(boxes, name) for name in SIZE_AXES}
    choice = [_witness(d.label, i, extents, priors, noise, axis) for i, d in enumerate(detections)]
    pixels = np.array([extents[c.axis][i] for i, c in enumerate(choice)], dtype=np.float64)
    values, depth_rel, mixed = _depths(detections, depth, noise)
    with np.errstate(invalid="ignore"):
        log_size = np.log(LAWS[depth.kind].relative_distance(values) * pixels)
    marked = np.array([detection.partial for detection in detections], dtype=np.bool_)
    partial = (
        marked if depth.image_size is None else marked | touches_border(boxes, depth.image_size)
    )
    return Observations(
        axis=tuple(c.axis for c in choice),
        pixels=pixels,
        depth=values,
        log_size=log_size,
        box_var=extent_rel_std(pixels, noise.box_px, noise.box_rel) ** 2,
        depth_var=depth_rel**2,
        prior_m=np.array([c.mean_m for c in choice], dtype=np.float64),
        prior_std_m=np.array([c.std_m for c in choice], dtype=np.float64),
        prior_mean_std_m=np.array([c.mean_std_m for c in choice], dtype=np.float64),
        group=_groups(detections, priors, choice),
        mixed=mixed,
        partial=partial,
        reason=tuple(
            _reason(c, cut, value) for c, cut, value in zip(choice, partial, values, strict=True)
        ),
    )


def mean_key(label: str, axis: SizeAxis, priors: PriorTable) -> MeanKey | None:
    """
    Name the mean size that objects of a label share along an axis.

    Parameters
    ----------
    label : str
        The label, or one of its aliases.
    axis : str
        The axis.
    priors : PriorTable
        Sizes by label.

    Returns
    -------
    tuple of str or None
        The table's label and the axis; None without a prior.
    """
    rows = [row for row in priors.lookup(label) if row.axis == axis]
    return (normal_label(rows[0].label), axis) if rows else None


def usable_depth(depth: object) -> DepthMap | ObjectDepths:
    """
    Return depth of a type and kind that can be fitted.

    Parameters
    ----------
    depth : object
        What was given as depth.

    Returns
    -------
    DepthMap or ObjectDepths
        The same.

    Raises
    ------
    TypeError
        If it is no depth.
    ValueError
        If it is a depth that this version does not fit.
    """
    known = check_depth_type(depth)
    if isinstance(known, GroundPlane):
        msg = (
            "`depth` must be a DepthMap or ObjectDepths in this version; got a GroundPlane. "
            "Sizes from the ground plane alone are not fitted yet."
        )
        raise ValueError(msg)  # noqa: TRY004 - a lawful type whose turn has not come
    if LAWS[known.kind].has_shift:
        msg = (
            f'`depth` must be of kind "metric", "relative" or "inverse" in this version; got '
            f'"{known.kind}". Its unknown shift is not fitted yet.'
        )
        raise ValueError(msg)
    return known


class _Witness(NamedTuple):
    """One axis of one label: moments of its mixture, in metres."""

    axis: SizeAxis
    mean_m: float
    std_m: float
    mean_std_m: float


def _boxes(detections: Sequence[Detection]) -> FloatArray:
    return np.array([d.xyxy for d in detections], dtype=np.float64).reshape(-1, 4)


def _check_in_image(boxes: FloatArray, depth: DepthMap | ObjectDepths) -> None:
    if depth.image_size is None or not boxes.size:
        return
    beyond = np.flatnonzero(outside_image(boxes, depth.image_size))
    if beyond.size:
        index = int(beyond[0])
        width, height = depth.image_size
        msg = (
            f"`xyxy` must lie in the image, {width} x {height} px; got "
            f"{tuple(boxes[index].tolist())} at index {index}. If the boxes belong to an image of "
            "another size than the depth map, pass its image_size=(width, height) to the depth; "
            "clip boxes that a detector drew beyond the border."
        )
        raise ValueError(msg)


def _check_masks(detections: Sequence[Detection], depth: DepthMap | ObjectDepths) -> None:
    if depth.image_size is None:
        return
    width, height = depth.image_size
    for index, detection in enumerate(detections):
        if detection.mask is not None and detection.mask.shape != (height, width):
            msg = (
                f"`mask` must have the shape of the image, {(height, width)}; "
                f"got {detection.mask.shape} at index {index}."
            )
            raise ValueError(msg)


def _witness(
    label: str,
    index: int,
    extents: dict[SizeAxis, FloatArray],
    priors: PriorTable,
    noise: Noise,
    axis: SizeAxis | None,
) -> _Witness:
    """Choose the axis whose prior and box together err least, or take the one asked for."""
    rows = priors.lookup(label)
    axes: list[SizeAxis] = (
        [axis] if axis else [name for name in SIZE_AXES if any(r.axis == name for r in rows)]
    )
    witnesses = [_moments([row for row in rows if row.axis == name], name) for name in axes]

    def error(witness: _Witness) -> float:
        box = extent_rel_std(extents[witness.axis][index : index + 1], noise.box_px, noise.box_rel)
        return math.hypot(
            witness.std_m / witness.mean_m, witness.mean_std_m / witness.mean_m, float(box[0])
        )

    return min(witnesses, key=error) if witnesses else _moments([], "height")


def _moments(rows: Sequence[ObjectPrior], axis: SizeAxis) -> _Witness:
    """
    Mean, spread and error of the mean of a mixture of sizes.

    The spread holds the distance between the parts: ``sum w (std^2 + mean^2) - mean^2``.
    """
    if not rows:
        return _Witness(axis, math.nan, math.nan, math.nan)
    if len(rows) == 1:
        return _Witness(axis, rows[0].mean_m, rows[0].std_m, rows[0].mean_std_m)
    total = sum(row.share for row in rows)
    mean_m = sum(row.share * row.mean_m for row in rows) / total
    variance = sum(row.share * (row.std_m**2 + (row.mean_m - mean_m) ** 2) for row in rows) / total
    mean_std_m = sum(row.share * row.mean_std_m for row in rows) / total
    return _Witness(axis, mean_m, math.sqrt(variance), mean_std_m)


def _depths(
    detections: Sequence[Detection], depth: DepthMap | ObjectDepths, noise: Noise
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Depth, its relative error and whether two surfaces share the box, for each detection."""
    count = len(detections)
    if isinstance(depth, ObjectDepths):
        if len(depth) != count:
            msg = (
                f"`depth` must hold one value per detection, {count}; got {len(depth)}. "
                "NaN stands for an unknown depth."
            )
            raise ValueError(msg)
        told = 0.0 if depth.rel_std is not None else UNKNOWN_DEPTH_REL
        own = np.full(count, depth.rel_std or 0.0)
        mixed = np.zeros(count, dtype=np.bool_)
        values = depth.values.astype(np.float64)
    else:
        told = UNKNOWN_DEPTH_REL
        samples = [_sample(detection, depth) for detection in detections]
        values = np.array([sample.value for sample in samples], dtype=np.float64)
        own = np.array([sample.rel_std for sample in samples], dtype=np.float64)
        mixed = np.array([sample.mixed for sample in samples], dtype=np.bool_)
    depth_rel = told if noise.depth_rel is None else noise.depth_rel
    return values, np.hypot(own, depth_rel), mixed


def _sample(detection: Detection, depth: DepthMap) -> DepthSample:
    return sample_surface(
        depth.values,
        detection.xyxy,
        kind=depth.kind,
        image_size=depth.image_size,
        nearness=1 if LAWS[depth.kind].inverse else -1,
        mask=detection.mask,
    )


def _groups(
    detections: Sequence[Detection], priors: PriorTable, choice: Sequence[_Witness]
) -> IntArray:
    """Give every label (aliases are one) and axis, which share one mean, a number."""
    numbers: dict[MeanKey, int] = {}
    groups = np.full(len(detections), -1, dtype=np.intp)
    for i, (detection, witness) in enumerate(zip(detections, choice, strict=True)):
        key = mean_key(detection.label, witness.axis, priors)
        if key:
            groups[i] = numbers.setdefault(key, len(numbers))
    return groups


def _reason(witness: _Witness, partial: np.bool_, depth: np.float64) -> str:
    if math.isnan(witness.mean_m):
        return NO_PRIOR
    if partial:
        return PARTIAL
    return NO_DEPTH if math.isnan(depth) else ""
