"""The ground plane as a fit found it."""

from __future__ import annotations

import math

import attrs

from imgscale._checks import non_negative_number
from imgscale._typing import ImageSize
from imgscale.depth import GroundPlane

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

    def as_prior(
        self, image_size: ImageSize, *, jitter_px: float = 0.0, jitter_deg: float = 0.0
    ) -> GroundPlane:
        """
        Take the plane for what is known beforehand of another picture by the same camera.

        Parameters
        ----------
        image_size : (width, height)
            Size of the image in pixels.
        jitter_px, jitter_deg : float
            How far horizon and roll move from picture to picture, >= 0: 0 for a camera that stands
            still, some pixels and a degree for one that drives.

        Returns
        -------
        GroundPlane
            To be given to `fit`, which then finds what that picture has of its own.

        Raises
        ------
        ValueError
            If `jitter_px` or `jitter_deg` is not finite and >= 0, or `image_size` breaks its law.
        TypeError
            If one of them is no number.

        Examples
        --------
        >>> from imgscale import FittedPlane
        >>> plane = FittedPlane(camera_height_m=1.65, camera_height_std_m=0.03, horizon_px=180.0,
        ...                     horizon_std_px=3.0, roll_deg=0.2, roll_std_deg=0.1)
        >>> plane.as_prior((1242, 375), jitter_px=4.0).horizon_std_px
        5.0
        """
        horizon_px = non_negative_number("jitter_px", jitter_px)
        roll_deg = non_negative_number("jitter_deg", jitter_deg)
        return GroundPlane(
            image_size=image_size,
            horizon_px=self.horizon_px,
            horizon_std_px=math.hypot(self.horizon_std_px, horizon_px),
            camera_height_m=self.camera_height_m,
            camera_height_std_m=self.camera_height_std_m,
            roll_deg=self.roll_deg,
            roll_std_deg=math.hypot(self.roll_std_deg, roll_deg),
        )
