"""
The seam: detections, depth, priors and noise become columns, with one reason per row.

It is the only way from objects to arrays, for `fit`, `predict` and `leave_one_out` alike, so that
they cannot sample, measure or select differently.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from typing import NamedTuple, TypeAlias, TypedDict

import numpy as np

from imgscale._reading import quoted
from imgscale._typing import BoolArray, FloatArray, ImageSize, IntArray, SizeAxis
from imgscale.core.segments import Parts
from imgscale.depth import Depth, GroundPlane, ObjectDepths, check_depth_type
from imgscale.detection import Detection
from imgscale.errors import FitError
from imgscale.extent import extent_rel_std, outside_image, pixel_extents, touches_border
from imgscale.laws import LAWS
from imgscale.noise import Noise
from imgscale.object_depth import DepthColumns, foot_depths, object_depths
from imgscale.prior_choice import (
    NOTHING_KNOWN,
    SizePrior,
    choose_prior,
    columns_of,
    prior_label,
    size_along,
)
from imgscale.priors import PriorTable
from imgscale.standing import feet_of
from imgscale.thickness import surface_depth, view_extent

__all__ = ["Observations", "observe"]

Extents: TypeAlias = Mapping[SizeAxis, float]

NO_PRIOR = "no prior"
PARTIAL = "partial"
NO_DEPTH = "no depth"
OFF_GROUND = "not on the ground"

_LARGEST_LOG = 700.0  # its exponential is 1e304: some room to the ends of all floats


class Observations(NamedTuple):
    """
    Hold detections as columns, one row each.

    Attributes
    ----------
    known_as : tuple of str
        The name under which the table of priors was asked for each row.
    prior : tuple of SizePrior
        What it knows of each along its axis.
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
    prior_log, prior_var, tau : (N,) ndarray of float64
        Mean and variance of the log size, all kinds together, and relative error of the label's
        mean.
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

    known_as: tuple[str, ...]
    prior: tuple[SizePrior, ...]
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
    prior_log: FloatArray
    prior_var: FloatArray
    tau: FloatArray
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
        return np.array([row for row, why in enumerate(self.reason) if not why], dtype=np.intp)

    def with_priors(self, priors: PriorTable) -> Observations:
        """
        Compare the objects with other sizes of the same labels.

        Parameters
        ----------
        priors : PriorTable
            The table that was read, with its sizes moved.

        Returns
        -------
        Observations
            The same objects along the same axes.
        """
        known = zip(self.known_as, self.axis, strict=True)
        prior = tuple([size_along(name, axis, priors) for name, axis in known])
        return self._replace(prior=prior, **_prior_columns(prior))


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
    FitError
        If numbers are so large or small that no ratio of theirs can be told.
    """
    depth = check_depth_type(depth)
    boxes, at_border = _boxes(detections, depth.image_size)
    known_as = tuple([prior_label(detection, priors) for detection in detections])
    extents = _extents(boxes)
    prior = [
        choose_prior(name, own, priors, noise, axis)
        for name, own in zip(known_as, extents, strict=True)
    ]
    feet = _feet(detections, known_as, priors, depth if isinstance(depth, GroundPlane) else ground)
    if isinstance(depth, GroundPlane):
        depths = foot_depths(feet[:, 1], noise)
    else:
        depths = object_depths(detections, depth, noise)
    if isinstance(depth, ObjectDepths) and depth.depth_at == "centre":
        depths = _on_surface(depths, known_as, extents, priors, noise, k)
    pixels = np.array([own[row.axis] for own, row in zip(extents, prior, strict=True)], np.float64)
    inverse_depth = LAWS[depth.kind].inverse_depth(depths.value)
    sizes = _prior_columns(prior)
    _check_magnitudes(
        detections,
        pixels,
        _log_inverse(inverse_depth, depth.kind),
        (sizes["prior_log"], np.full(pixels.size, np.nan if k is None else np.log(k))),
    )
    partial = [d.partial or cut for d, cut in zip(detections, at_border, strict=True)]
    return Observations(
        known_as=known_as,
        prior=tuple(prior),
        axis=tuple([row.axis for row in prior]),
        pixels=pixels,
        depth=depths.value,
        inverse_depth=inverse_depth,
        box_var=extent_rel_std(pixels, noise.box_px, noise.box_rel) ** 2,
        depth_var=depths.rel_std**2,
        unknown_noise=depths.unknown_noise,
        **sizes,
        mixed=depths.mixed,
        partial=np.array(partial, dtype=np.bool_),
        boxes=boxes,
        feet=feet,
        reason=tuple(map(_reason, prior, partial, depths.value.tolist())),
    )


def _log_inverse(inverse_depth: FloatArray, kind: str) -> FloatArray:
    """Take the logarithm of D; where a shift comes to it, of the largest."""
    known = np.abs(inverse_depth)
    if kind in {"affine_inverse", "ground_plane"}:
        known = np.where(np.isnan(known), np.nan, np.fmax.reduce(known, initial=0.0))
    logs: FloatArray = np.log(np.where(known == 0, np.nan, known))
    if kind == "affine_inverse" and (np.abs(logs) > _LARGEST_LOG / 3).any():
        msg = (
            "`depth` with an unknown shift must have values whose largest lies between 1e-100 and "
            f"1e100; got {np.nanmax(known):g}. Rescale them."
        )
        raise FitError(msg)
    return logs


def _check_magnitudes(
    detections: Sequence[Detection],
    pixels: FloatArray,
    log_inverse: FloatArray,
    known: tuple[FloatArray, FloatArray],
) -> None:
    """Raise where sizes, pixels, depths and k cannot be multiplied or divided."""
    log_pixels, (log_m, log_k) = np.log(pixels), known
    for logs in (
        log_pixels - log_inverse,  # d p
        log_m - log_pixels,  # metres per pixel of a reference
        log_m - log_pixels + log_inverse,  # its own k
        log_k - log_inverse,  # metres per pixel of what is measured
        log_k - log_inverse + log_pixels,  # its size
    ):
        beyond = np.abs(logs) > _LARGEST_LOG
        if beyond.any():
            row = int(np.argmax(beyond))
            msg = (
                f"`detections`[{row}] ({quoted(detections[row].label)}) must have a size, pixels "
                "and depth whose ratios lie between 1e-304 and 1e304; got "
                f"{pixels[row]:g} px and log(1 / depth) = {log_inverse[row]:.0f}. Check the units."
            )
            raise FitError(msg)


def _boxes(
    detections: Sequence[Detection], image_size: ImageSize | None
) -> tuple[FloatArray, list[bool]]:
    """Gather the boxes, and which of them end at the border; raise where they cannot be."""
    corners = [detection.xyxy for detection in detections]
    boxes = np.fromiter(chain.from_iterable(corners), np.float64).reshape(-1, 4)
    at_border = touches_border(corners, image_size)
    _check_in_pixels(boxes, detections)
    if image_size:
        if any(at_border):  # as is whatever reaches beyond it
            _check_in_image(boxes, image_size)
        _check_masks(detections, image_size)
    return boxes, at_border


def _extents(boxes: FloatArray) -> list[Extents]:
    """Measure each object along each axis."""
    extents = {axis: column.tolist() for axis, column in pixel_extents(boxes).items()}
    sides = zip(extents["height"], extents["width"], extents["diameter"], strict=True)
    return [{"height": tall, "width": wide, "diameter": long} for tall, wide, long in sides]


def _check_in_pixels(boxes: FloatArray, detections: Sequence[Detection]) -> None:
    """Raise where the boxes look like ratios."""
    # a mask is of pixels, whatever its box looks like
    if not (boxes.size and all(0 <= number <= 1 for number in boxes.flat)):
        return
    if all(detection.mask is None for detection in detections):
        msg = (
            f"`xyxy` must be in pixels; got {tuple(boxes[0].tolist())} and the like, all in the "
            "first pixel. Ratios of the image's size go through Detection.from_ratios()."
        )
        raise ValueError(msg)


def _check_in_image(boxes: FloatArray, image_size: ImageSize) -> None:
    """Raise where boxes reach beyond the image."""
    (beyond,) = outside_image(boxes, image_size).nonzero()
    if beyond.size:
        index = int(beyond[0])
        width, height = image_size
        msg = (
            f"`xyxy` must lie in the image, {width} x {height} px; got "
            f"{tuple(boxes[index].tolist())} at index {index}. {_remedy(boxes, image_size)}"
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


def _check_masks(detections: Sequence[Detection], image_size: ImageSize) -> None:
    """Raise where a mask is not of the image."""
    width, height = image_size
    for index, detection in enumerate(detections):
        if detection.mask is not None and detection.mask.shape != (height, width):
            msg = (
                f"`mask` must have the shape of the image, {(height, width)}; "
                f"got {detection.mask.shape} at index {index}."
            )
            raise ValueError(msg)


def _feet(
    detections: Sequence[Detection],
    known_as: Sequence[str],
    priors: PriorTable,
    ground: GroundPlane | None,
) -> FloatArray:
    """Find where objects meet the ground, where that is asked for."""
    if ground is None:
        return np.full((len(detections), 2), np.nan)
    stands = [all(row.on_ground for row in priors.lookup(name)) for name in known_as]
    return feet_of(detections, np.array(stands, dtype=np.bool_), ground.image_size)


def _on_surface(
    depths: DepthColumns,
    known_as: Sequence[str],
    extents: Sequence[Extents],
    priors: PriorTable,
    noise: Noise,
    k: float | None,
) -> DepthColumns:
    """Take half the extents along the view off the depths of centres."""
    scale = np.full(len(known_as), math.nan) if k is None else k * depths.value
    long_m = np.full(len(known_as), math.nan)
    for i, (name, pixels) in enumerate(zip(known_as, extents, strict=True)):
        own = choose_prior(name, pixels, priors, noise, None)
        told = [(row.share, row.depth_extent_m) for row in own.rows if row.depth_extent_m]
        if own.rows:
            scale[i] = own.mean_m / pixels[own.axis]
        if told:
            long_m[i] = sum(share * length for share, length in told) / sum(s for s, _ in told)
    width_px = np.array([own["width"] for own in extents], dtype=np.float64)
    extent_m, std_m = view_extent(scale * width_px, long_m)
    # an object without a prior is no reference: its depth may stay that of its centre
    value, rel_std = surface_depth(depths.value, np.nan_to_num(extent_m), np.nan_to_num(std_m))
    return depths._replace(value=value, rel_std=np.hypot(depths.rel_std, rel_std))


class _PriorFields(TypedDict):
    """The columns that priors alone fill."""

    prior_m: FloatArray
    prior_std_m: FloatArray
    prior_mean_std_m: FloatArray
    prior_log: FloatArray
    prior_var: FloatArray
    tau: FloatArray
    kinds: Parts
    group: IntArray


def _prior_columns(prior: Sequence[SizePrior]) -> _PriorFields:
    """Put what is known of each object into columns."""
    group, distinct = _groups(prior)
    sizes = columns_of(distinct, group)
    return {
        "prior_m": sizes.mean_m,
        "prior_std_m": sizes.std_m,
        "prior_mean_std_m": sizes.mean_std_m,
        "prior_log": sizes.log_mean,
        "prior_var": sizes.log_var,
        "tau": sizes.tau,
        "kinds": sizes.kinds,
        "group": group,
    }


def _groups(prior: Iterable[SizePrior]) -> tuple[IntArray, list[SizePrior]]:
    """
    Give every label (aliases are one) and axis, which share one mean, a number; -1 without a prior.

    The list has the prior of each number and, where -1 looks it up, last that of nothing.
    """
    distinct = {row.key: row for row in prior if row.key}
    numbers = {key: number for number, key in enumerate(distinct)}
    group = np.array([-1 if row.key is None else numbers[row.key] for row in prior], dtype=np.intp)
    return group, [*distinct.values(), NOTHING_KNOWN["height"]]


def _reason(prior: SizePrior, partial: bool, depth: float) -> str:  # noqa: FBT001 - a column
    if not prior.rows:
        return NO_PRIOR
    if partial:
        return PARTIAL
    if not math.isnan(depth):
        return ""
    return NO_DEPTH if prior.on_ground else OFF_GROUND
