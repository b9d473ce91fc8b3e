"""
The seam: detections, depth, priors and noise become columns, with one reason per row.

It is the only way from objects to arrays, for `fit`, `predict` and `leave_one_out` alike, so that
they cannot sample, measure or select differently.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from imgscale._typing import BoolArray, FloatArray, ImageSize, IntArray, SizeAxis
from imgscale.core.segments import Parts
from imgscale.depth import Depth, GroundPlane, ObjectDepths, check_depth_type
from imgscale.detection import Detection
from imgscale.extent import extent_rel_std, outside_image, pixel_extent, touches_border
from imgscale.laws import LAWS
from imgscale.noise import Noise
from imgscale.object_depth import DepthColumns, foot_depths, object_depths
from imgscale.object_prior import SIZE_AXES
from imgscale.prior_choice import (
    MeanKey,
    PriorChoice,
    choose_prior,
    log_kinds,
    mean_key_of,
    prior_label,
)
from imgscale.priors import PriorTable
from imgscale.standing import feet_of
from imgscale.thickness import surface_depth, view_extent

__all__ = ["Observations", "observe"]

Extents: TypeAlias = Mapping[SizeAxis, FloatArray]

NO_PRIOR = "no prior"
PARTIAL = "partial"
NO_DEPTH = "no depth"
OFF_GROUND = "not on the ground"


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
    inverse_depth : (N,) ndarray of float64
        The D of the one law ``p / H = (D + b) / k``; NaN without depth.
    box_var, depth_var : (N,) ndarray of float64
        Variances of the logarithms of pixels and depth, as far as they were told.
    unknown_noise : bool
        True where nobody told how much the depths err besides.
    prior_m, prior_std_m, prior_mean_std_m : (N,) ndarray of float64
        The label's prior along the axis, moments of the mixture; NaN without one.
    kinds : Parts
        Log sizes of the kinds of thing that the label may be, (N, J); NaN without a prior.
    group : (N,) ndarray of int
        Number of the row's label and axis, which share one mean; -1 without a prior.
    mixed, partial : (N,) ndarray of bool
        Two surfaces in the box; box cut by the border or marked partial.
    boxes : (N, 4) ndarray of float64
        The boxes.
    feet : (N, 2) ndarray of float64
        Column and row where each object meets the ground; NaN where it does not, or where that is
        not asked for.
    reason : tuple of str
        Why a row cannot be a reference, empty where it can.
    """

    axis: tuple[SizeAxis, ...]
    pixels: FloatArray
    depth: FloatArray
    inverse_depth: FloatArray
    box_var: FloatArray
    depth_var: FloatArray
    unknown_noise: bool
    prior_m: FloatArray
    prior_std_m: FloatArray
    prior_mean_std_m: FloatArray
    kinds: Parts
    group: IntArray
    mixed: BoolArray
    partial: BoolArray
    boxes: FloatArray
    feet: FloatArray
    reason: tuple[str, ...]

    @property
    def noise_var(self) -> FloatArray:
        """The variance of log(d p)."""
        return self.box_var + self.depth_var

    @property
    def upright(self) -> BoolArray:
        """Where the extent is measured along the vertical."""
        return np.array([axis == "height" for axis in self.axis], dtype=np.bool_)

    @property
    def eligible(self) -> IntArray:
        """The rows that can be references."""
        return np.flatnonzero([not reason for reason in self.reason])


def observe(
    detections: Sequence[Detection],
    depth: Depth,
    priors: PriorTable,
    noise: Noise,
    *,
    ground: GroundPlane | None = None,
    axis: SizeAxis | None = None,
    k: float | None = None,
) -> Observations:
    """
    Turn detections and depth into columns.

    Parameters
    ----------
    detections : sequence of Detection
        The objects.
    depth : DepthMap, ObjectDepths or GroundPlane
        Their depth.
    priors : PriorTable
        Sizes by label.
    noise : Noise
        Errors of boxes and depths.
    ground : GroundPlane, optional
        The plane on which they stand, beside their depth.
    axis : str, optional
        Measure every object along this axis. Where omitted, each is measured along the axis of
        its label's most precise prior.
    k : float, optional
        The scale constant, where it is known: it tells the thickness of objects without a prior.

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
    depth = check_depth_type(depth)
    ground = depth if isinstance(depth, GroundPlane) else ground
    boxes = _boxes(detections)
    _check_in_image(boxes, depth, masked=any(d.mask is not None for d in detections))
    _check_masks(detections, depth)
    extents: Extents = {name: pixel_extent(boxes, name) for name in SIZE_AXES}
    choice = [
        choose_prior(prior_label(detection, priors), _extents_of(extents, row), priors, noise, axis)
        for row, detection in enumerate(detections)
    ]
    pixels = np.array([extents[c.axis][i] for i, c in enumerate(choice)], dtype=np.float64)
    feet = np.full((len(detections), 2), np.nan)
    if ground:
        stands = np.array(
            [
                all(row.on_ground for row in priors.lookup(prior_label(d, priors)))
                for d in detections
            ],
            dtype=np.bool_,
        )
        feet = feet_of(detections, stands, ground.image_size)
    depths = (
        foot_depths(feet[:, 1], noise)
        if isinstance(depth, GroundPlane)
        else object_depths(detections, depth, noise)
    )
    if isinstance(depth, ObjectDepths) and depth.depth_at == "centre":
        depths = _on_surface(depths, detections, extents, priors, noise, k)
    marked = np.array([detection.partial for detection in detections], dtype=np.bool_)
    partial = (
        marked if depth.image_size is None else marked | touches_border(boxes, depth.image_size)
    )
    return Observations(
        axis=tuple(c.axis for c in choice),
        pixels=pixels,
        depth=depths.value,
        inverse_depth=LAWS[depth.kind].inverse_depth(depths.value),
        box_var=extent_rel_std(pixels, noise.box_px, noise.box_rel) ** 2,
        depth_var=depths.rel_std**2,
        unknown_noise=depths.unknown_noise,
        prior_m=np.array([c.mean_m for c in choice], dtype=np.float64),
        prior_std_m=np.array([c.std_m for c in choice], dtype=np.float64),
        prior_mean_std_m=np.array([c.mean_std_m for c in choice], dtype=np.float64),
        kinds=log_kinds([c.rows for c in choice]),
        group=_groups(detections, priors, choice),
        mixed=depths.mixed,
        partial=partial,
        boxes=boxes,
        feet=feet,
        reason=tuple(
            _reason(c, cut, value)
            for c, cut, value in zip(choice, partial, depths.value, strict=True)
        ),
    )


def _boxes(detections: Sequence[Detection]) -> FloatArray:
    return np.array([d.xyxy for d in detections], dtype=np.float64).reshape(-1, 4)


def _check_in_image(boxes: FloatArray, depth: Depth, *, masked: bool) -> None:
    # a mask is of pixels, whatever its box looks like
    if boxes.size and not masked and boxes.min() >= 0 and boxes.max() <= 1:
        msg = (
            f"`xyxy` must be in pixels; got {tuple(boxes[0].tolist())} and the like, all in the "
            "first pixel. Ratios of the image's size go through Detection.from_ratios()."
        )
        raise ValueError(msg)
    if depth.image_size is None or not boxes.size:
        return
    beyond = np.flatnonzero(outside_image(boxes, depth.image_size))
    if beyond.size:
        index = int(beyond[0])
        width, height = depth.image_size
        msg = (
            f"`xyxy` must lie in the image, {width} x {height} px; got "
            f"{tuple(boxes[index].tolist())} at index {index}. {_remedy(boxes, depth.image_size)}"
        )
        raise ValueError(msg)


def _remedy(boxes: FloatArray, image_size: ImageSize) -> str:
    """Say what boxes beyond the image look like."""
    largest = (float(boxes[:, 2].max()), float(boxes[:, 3].max()))
    width, height = image_size
    if not outside_image(boxes, (height, width)).any():
        return (
            "All boxes fit the image turned by 90 degrees: apply its EXIF orientation once, before "
            "detector and depth."
        )
    as_corners = np.column_stack([boxes[:, :2], boxes[:, 2:] - boxes[:, :2]])
    if (as_corners[:, :2] < as_corners[:, 2:]).all() and not outside_image(
        as_corners, image_size
    ).any():
        return (
            "They would fit if what was given as width and height were the right lower corner: "
            "corners go through Detection(), not Detection.from_xywh()."
        )
    return (
        f"If the boxes belong to a larger image ({largest[0]:.0f} x {largest[1]:.0f} or more) than "
        "the depth map, pass its image_size=(width, height) to the depth, or scale the boxes to "
        "the picture; clip boxes that a detector drew beyond the border: Detection.with_box()."
    )


def _check_masks(detections: Sequence[Detection], depth: Depth) -> None:
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


def _extents_of(extents: Extents, row: int) -> dict[SizeAxis, float]:
    """Extent of one object along each axis."""
    return {name: float(extent[row]) for name, extent in extents.items()}


def _on_surface(
    depths: DepthColumns,
    detections: Sequence[Detection],
    extents: Extents,
    priors: PriorTable,
    noise: Noise,
    k: float | None,
) -> DepthColumns:
    """Take half the extents along the view off the depths of centres."""
    scale = np.full(len(detections), math.nan) if k is None else k * depths.value
    long_m = np.full(len(detections), math.nan)
    for i, detection in enumerate(detections):
        pixels = _extents_of(extents, i)
        own = choose_prior(prior_label(detection, priors), pixels, priors, noise, None)
        told = [(row.share, row.depth_extent_m) for row in own.rows if row.depth_extent_m]
        if own.rows:
            scale[i] = own.mean_m / pixels[own.axis]
        if told:
            long_m[i] = sum(share * length for share, length in told) / sum(s for s, _ in told)
    extent_m, std_m = view_extent(scale * extents["width"], long_m)
    # an object without a prior is no reference: its depth may stay that of its centre
    value, rel_std = surface_depth(depths.value, np.nan_to_num(extent_m), np.nan_to_num(std_m))
    return depths._replace(value=value, rel_std=np.hypot(depths.rel_std, rel_std))


def _groups(
    detections: Sequence[Detection], priors: PriorTable, choice: Sequence[PriorChoice]
) -> IntArray:
    """Give every label (aliases are one) and axis, which share one mean, a number."""
    numbers: dict[MeanKey, int] = {}
    groups = np.full(len(detections), -1, dtype=np.intp)
    for i, (detection, witness) in enumerate(zip(detections, choice, strict=True)):
        key = mean_key_of(detection, witness.axis, priors)
        if key:
            groups[i] = numbers.setdefault(key, len(numbers))
    return groups


def _reason(witness: PriorChoice, partial: np.bool_, depth: np.float64) -> str:
    if math.isnan(witness.mean_m):
        return NO_PRIOR
    if partial:
        return PARTIAL
    if not math.isnan(depth):
        return ""
    return NO_DEPTH if witness.on_ground else OFF_GROUND
