"""Where objects stand: their feet, the camera's tilt, and what is known of both beforehand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imgscale._typing import BoolArray, DepthKind, FloatArray, ImageSize
from imgscale.camera import Camera
from imgscale.core.stance import Stance
from imgscale.core.unknowns import Scene
from imgscale.depth import GroundPlane
from imgscale.detection import Detection
from imgscale.noise import Noise

# Photos at large. The horizon lies this far from the middle, in longer sides of the image (7
# degrees for a usual lens, with the tails of Student's distribution), the camera at 1.7 m within a
# factor of 2: hand, car, trap, lamp post.
HORIZON_STD = 0.12
CAMERA_HEIGHT_M, CAMERA_HEIGHT_FACTOR = 1.7, 2.0
# Roll of the camera and cross-fall of the ground together.
SLOPE_STD = math.tan(math.radians(2.0))
# Feet stand on kerbs and in dips, 3 % of the camera's height, and on slopes, of 0.15 % of the
# longer side (0.1 degrees for a usual lens).
RELIEF_REL, SLOPE_REL = 0.03, 0.0015
# How far the horizon may move between the frames of one camera, in longer sides of the image.
JITTERS = (0.0, 0.001, 0.002, 0.004, 0.008)
# What is given without its error.
_GIVEN_HORIZON_STD, _GIVEN_HEIGHT_REL, _GIVEN_ROLL_STD_DEG = 0.005, 0.02, 0.5
_LEAST_SLOPE_STD = 1e-6
_LEAST_STD_PX = 1e-6
# A focal length known better than this is exact; one that may be off by e tells no tilt anyway.
_FOCAL_REL = (1e-6, 1.0)


class Viewpoint(NamedTuple):
    """
    What counts of camera and plane.

    Attributes
    ----------
    image_size : (width, height)
        Size of the image in pixels.
    cx, cy : float
        Principal point in pixels.
    camera : Camera or None
        The camera.
    ground : GroundPlane or None
        The plane, where there is one.
    alone : bool
        True where the plane is the only source of distances.
    noise : Noise
        Errors of boxes and, where the plane is alone, of its distances.
    jitter_px : float
        What the feet's rows err besides, as the frames of one camera showed.
    """

    image_size: ImageSize
    cx: float
    cy: float
    camera: Camera | None
    ground: GroundPlane | None
    alone: bool
    noise: Noise
    jitter_px: float = 0.0


def viewpoint(
    kind: DepthKind,
    ground: GroundPlane | None,
    camera: Camera | None,
    image_size: ImageSize | None,
    noise: Noise,
) -> Viewpoint | None:
    """
    Gather what counts of camera and plane.

    Parameters
    ----------
    kind : str
        The kind of depth.
    ground : GroundPlane or None
        The plane.
    camera : Camera or None
        The camera.
    image_size : (width, height) or None
        Size of the image in pixels.
    noise : Noise
        Errors of boxes and depths.

    Returns
    -------
    Viewpoint or None
        None where there is neither a plane nor a tilt.

    Raises
    ------
    ValueError
        If the camera is tilted and nobody knows its principal point.
    """
    if ground is None and not (camera and camera.is_tilted):
        return None
    size = image_size or (ground.image_size if ground else None)
    if size is None:
        msg = (
            "`camera.image_size` must be given with a pitch, which turns about the image's centre; "
            "got None. Pass Camera(..., image_size=(width, height))."
        )
        raise ValueError(msg)
    cx = camera.cx if camera and camera.cx is not None else size[0] / 2
    cy = camera.cy if camera and camera.cy is not None else size[1] / 2
    return Viewpoint(size, cx, cy, camera, ground, kind == "ground_plane", noise)


def scene_of(view: Viewpoint) -> Scene:
    """
    Tell what is known beforehand of horizon and plane.

    Parameters
    ----------
    view : Viewpoint
        Camera and plane.

    Returns
    -------
    Scene
        The horizon given, the camera's pitch, both together, or photos at large.
    """
    longer = max(view.image_size)
    told: list[tuple[float, float]] = []
    ground, camera = view.ground, view.camera
    focal_rel_std = _focal_rel_std(camera)
    if ground and ground.horizon_px is not None:
        std = ground.horizon_std_px
        told.append(
            (ground.horizon_px - view.cy, _GIVEN_HORIZON_STD * longer if std is None else std)
        )
    if camera and camera.is_tilted:
        pitch = math.radians(camera.pitch_deg)
        row = -camera.focal_px * math.tan(pitch)
        std = camera.focal_px * math.radians(camera.pitch_std_deg) / math.cos(pitch) ** 2
        # beside a plane the horizon is what is looked for, and the pitch tells it by way of f
        told.append((row, math.hypot(std, row * focal_rel_std) if ground else std))
    if ground:
        told = [(row, max(std, _LEAST_STD_PX * longer)) for row, std in told]
    horizon, horizon_std = view.image_size[1] / 2 - view.cy, HORIZON_STD * longer
    if len(told) == 1:
        horizon, horizon_std = told[0]
    elif told:
        precision = sum(std**-2 for _, std in told)
        horizon = sum(row * std**-2 for row, std in told) / precision
        horizon_std = precision**-0.5
    slope, slope_std = 0.0, SLOPE_STD
    if ground and ground.roll_deg is not None:
        std = _GIVEN_ROLL_STD_DEG if ground.roll_std_deg is None else ground.roll_std_deg
        slope = math.tan(math.radians(ground.roll_deg))
        slope_std = max(math.radians(std), _LEAST_SLOPE_STD)
    return Scene(
        horizon=horizon,
        horizon_std=horizon_std,
        is_given=bool(told),
        slope=slope,
        slope_std=slope_std,
        has_plane=ground is not None,
        has_depth=not view.alone,
        span=float(view.image_size[1]),
        focal_rel_std=focal_rel_std,
    )


def _focal_rel_std(camera: Camera | None) -> float:
    """Tell the error of the focal length where it can matter."""
    least, largest = _FOCAL_REL
    if camera is None or camera.focal_rel_std < least:
        return 0.0
    return min(camera.focal_rel_std, largest)


def height_of(ground: GroundPlane) -> tuple[float, float]:
    """
    Tell what is known beforehand of the camera's height.

    Parameters
    ----------
    ground : GroundPlane
        The plane.

    Returns
    -------
    log_height, variance : float
        Log of the height in metres, and its variance.
    """
    if ground.camera_height_m is None:
        return math.log(CAMERA_HEIGHT_M), math.log(CAMERA_HEIGHT_FACTOR) ** 2
    std = ground.camera_height_std_m
    relative = _GIVEN_HEIGHT_REL if std is None else std / ground.camera_height_m
    return math.log(ground.camera_height_m), relative**2


def feet_of(
    detections: Sequence[Detection], stands: BoolArray, image_size: ImageSize
) -> FloatArray:
    """
    Find where objects meet the ground.

    Parameters
    ----------
    detections : sequence of Detection
        The objects.
    stands : (N,) ndarray of bool
        Which of them may stand on the ground.
    image_size : (width, height)
        Size of the image in pixels.

    Returns
    -------
    (N, 2) ndarray of float64
        Column and row of each foot: the middle of the box's lower edge, or the mask's lowest
        pixels. NaN where it is not in view.
    """
    feet = np.full((len(detections), 2), np.nan)
    for row, detection in enumerate(detections):
        x1, _, x2, y2 = detection.xyxy
        if not stands[row] or detection.partial or y2 >= image_size[1] - 1:
            continue
        feet[row] = (x1 + x2) / 2, y2
        if detection.mask is not None:
            lowest = int(np.flatnonzero(detection.mask.any(axis=1))[-1])
            feet[row] = np.flatnonzero(detection.mask[lowest]).mean() + 0.5, lowest + 1
    return feet


def stance_of(
    view: Viewpoint, boxes: FloatArray, feet: FloatArray, upright: BoolArray, box_var: FloatArray
) -> Stance:
    """
    Describe where objects lie in the image.

    Parameters
    ----------
    view : Viewpoint
        Camera and plane.
    boxes : (N, 4) ndarray of float
        Their boxes.
    feet : (N, 2) ndarray of float
        Columns and rows of their feet.
    upright : (N,) ndarray of bool
        True where the extent is measured along the vertical.
    box_var : (N,) ndarray of float
        Variance of the log extents in pixels.

    Returns
    -------
    Stance
        About the principal point.
    """
    count, noise = len(boxes), view.noise
    # each of a box's two edges errs by its half of the extent's variance
    edge_var = (noise.box_px**2 + (noise.box_rel * (boxes[:, 3] - boxes[:, 1])) ** 2) / 2
    told = view.alone and noise.depth_rel is not None
    relief = noise.depth_rel if told and noise.depth_rel is not None else RELIEF_REL
    slope_px = 0.0 if told else SLOPE_REL * max(view.image_size)
    return Stance(
        foot=feet[:, 1] - view.cy,
        lateral=np.where(np.isnan(feet[:, 0]), 0.0, feet[:, 0] - view.cx),
        top=boxes[:, 1] - view.cy,
        middle=(boxes[:, 1] + boxes[:, 3]) / 2 - view.cy,
        foot_var=edge_var + slope_px**2 + view.jitter_px**2,
        relief_var=np.full(count, relief**2),
        box_var=box_var,
        focal_px=np.full(count, view.camera.focal_px if view.camera else np.nan),
        span_px=np.full(count, float(view.image_size[1])),
        upright=upright,
        is_height=np.zeros(count, dtype=np.bool_),
        is_new=np.zeros(count, dtype=np.bool_),
        lean_horizon=np.zeros(count),
        lean_slope=np.zeros(count),
    )
