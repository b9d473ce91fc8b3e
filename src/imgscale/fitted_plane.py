"""The ground plane as a fit found it."""

from __future__ import annotations

import attrs

__all__ = ["FittedPlane"]


@attrs.frozen(kw_only=True)
class FittedPlane:
    """
    Where the camera is above the ground plane.

    Attributes
    ----------
    camera_height_m : float
        Height of the camera above the plane, in metres.
    camera_height_std_m : float
        Its standard error, in metres.
    horizon_px : float
        Row of the horizon in the image's middle column, in pixels from the top; may lie outside.
    horizon_std_px : float
        Its standard error, in pixels.
    roll_deg : float
        Slope of the horizon, degrees by which it falls to the right: the camera's roll and the
        cross-fall of the ground together.
    roll_std_deg : float
        Its standard error, in degrees.
    """

    camera_height_m: float
    camera_height_std_m: float
    horizon_px: float
    horizon_std_px: float
    roll_deg: float
    roll_std_deg: float
