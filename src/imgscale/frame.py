"""One image of many: what was detected in it, its depth and its camera."""

from __future__ import annotations

from typing import Any

import attrs

from imgscale.camera import Camera
from imgscale.depth import Depth, check_depth_type
from imgscale.detection import Detection, check_detections

__all__ = ["Frame"]


def _check_depth(_: object, __: attrs.Attribute[Any], value: object) -> None:
    check_depth_type(value)


def _check_camera(_: object, __: attrs.Attribute[Any], value: object) -> None:
    if not (value is None or isinstance(value, Camera)):
        msg = f"`camera` must be a Camera; got {type(value).__name__}."
        raise TypeError(msg)


@attrs.frozen(eq=False)
class Frame:
    """
    What belongs to one image. Equal only to itself, as a `DepthMap` is.

    Attributes
    ----------
    detections : tuple of Detection
        The objects.
    depth : DepthMap, ObjectDepths or GroundPlane
        The image's depth.
    camera : Camera or None
        What is known of the camera.
    name : str
        The image's name, for messages and tables.

    Examples
    --------
    >>> from imgscale import Detection, Frame, ObjectDepths
    >>> Frame([Detection("car", (0, 0, 9, 9))], ObjectDepths([7.0], kind="metric"), name="a").name
    'a'
    """

    detections: tuple[Detection, ...] = attrs.field(converter=check_detections)
    depth: Depth = attrs.field(validator=_check_depth)
    camera: Camera | None = attrs.field(default=None, kw_only=True, validator=_check_camera)
    name: str = attrs.field(default="", kw_only=True)
