"""One depth per detection, from any source of depth, with what is known of its error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import attrs
import numpy as np

from imgscale._typing import BoolArray, FloatArray, ImageSize
from imgscale.depth import Depth, DepthMap, ObjectDepths
from imgscale.detection import Detection
from imgscale.laws import LAWS
from imgscale.noise import Noise
from imgscale.sampling import DepthSample, sample_surface
from imgscale.standing import RELIEF_REL


class DepthColumns(NamedTuple):
    """
    Depths of detections.

    Attributes
    ----------
    value : (N,) ndarray of float64
        In the unit given; NaN where there is none.
    rel_std : (N,) ndarray of float64
        Relative standard error, as far as it was told.
    unknown_noise : bool
        True where nobody told how much they err besides.
    mixed : (N,) ndarray of bool
        True where two surfaces share the box.
    """

    value: FloatArray
    rel_std: FloatArray
    unknown_noise: bool
    mixed: BoolArray


def with_image_size(depth: Depth, image_size: ImageSize | None) -> Depth:
    """
    Tell depth the size of its image where it does not know it.

    Parameters
    ----------
    depth : DepthMap, ObjectDepths or GroundPlane
        The depth.
    image_size : (width, height) or None
        Size of the image in pixels, as the camera or the model knows it.

    Returns
    -------
    DepthMap, ObjectDepths or GroundPlane
        The same depth, with an `image_size` where there is one.
    """
    if not isinstance(depth, ObjectDepths) or depth.image_size or not image_size:
        return depth
    return attrs.evolve(depth, image_size=image_size)


def object_depths(
    detections: Sequence[Detection], depth: DepthMap | ObjectDepths, noise: Noise
) -> DepthColumns:
    """
    Read one depth for each detection.

    Parameters
    ----------
    detections : sequence of Detection
        The objects.
    depth : DepthMap or ObjectDepths
        Their depth.
    noise : Noise
        What was told of its error.

    Returns
    -------
    DepthColumns
        One row per detection.

    Raises
    ------
    ValueError
        If there is not one depth per detection.
    """
    count = len(detections)
    if isinstance(depth, ObjectDepths):
        if len(depth) != count:
            msg = (
                f"`depth` must hold one value per detection, {count}; got {len(depth)}. "
                "NaN stands for an unknown depth."
            )
            raise ValueError(msg)
        unknown = noise.depth_rel is None and depth.rel_std is None
        rel_std = np.full(count, math.hypot(depth.rel_std or 0.0, noise.depth_rel or 0.0))
        mixed = np.zeros(count, dtype=np.bool_)
        values = np.asarray(depth.values, dtype=np.float64)
    else:
        unknown = noise.depth_rel is None
        origin = _origin(depth)
        samples = [_sample(detection, depth, origin) for detection in detections]
        values = np.array([sample.value for sample in samples], dtype=np.float64)
        own = np.array([sample.rel_std for sample in samples], dtype=np.float64)
        rel_std = np.hypot(own, noise.depth_rel or 0.0)
        mixed = np.array([sample.mixed for sample in samples], dtype=np.bool_)
    return DepthColumns(values, rel_std, unknown, mixed)


def foot_depths(rows: FloatArray, noise: Noise) -> DepthColumns:
    """
    Take the rows of feet for depths.

    Parameters
    ----------
    rows : (N,) ndarray of float
        Row of each foot; NaN where it is not in view.
    noise : Noise
        What was told of its error.

    Returns
    -------
    DepthColumns
        One row per detection.
    """
    rel_std = RELIEF_REL if noise.depth_rel is None else noise.depth_rel
    nothing = np.zeros(rows.size, dtype=np.bool_)
    return DepthColumns(rows, np.full(rows.size, rel_std), unknown_noise=False, mixed=nothing)


def _origin(depth: DepthMap) -> float:
    """Where a shift is unknown, take the farthest pixel for ten times as far as the nearest."""
    if not LAWS[depth.kind].has_shift:
        return 0.0
    low, high = depth.valid_range
    return low - ((high - low) / 9 or 1.0)


def _sample(detection: Detection, depth: DepthMap, origin: float) -> DepthSample:
    return sample_surface(
        depth.values,
        detection.xyxy,
        kind=depth.kind,
        image_size=depth.image_size,
        nearness=1 if LAWS[depth.kind].inverse else -1,
        origin=origin,
        mask=detection.mask,
    )
