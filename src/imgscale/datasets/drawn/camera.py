"""The pinhole camera that sees a drawn scene."""

from __future__ import annotations

import math

import attrs
import numpy as np
from numpy.typing import ArrayLike

from imgscale._checks import as_float, as_known_image_size, finite, positive
from imgscale._typing import FloatArray, ImageSize

__all__ = ["DrawnCamera"]

NEAREST_M = 0.05


@attrs.frozen(kw_only=True)
class DrawnCamera:
    """
    A pinhole camera above level ground, tilted downward and a little sideways.

    Attributes
    ----------
    image_size : (width, height)
        Size of the picture in pixels; the principal point is its centre.
    focal_px : float
        Focal length in pixels, positive.
    height_m : float
        Height above the ground in metres, positive.
    pitch_deg : float
        Tilt of the optical axis below the horizontal, in degrees; 90 looks straight down.
    roll_deg : float
        Slope of the horizon, in degrees, by which it falls to the right.

    Raises
    ------
    ValueError
        If a number breaks its law.

    Examples
    --------
    >>> from imgscale.datasets.drawn import DrawnCamera
    >>> camera = DrawnCamera(image_size=(640, 480), focal_px=500.0, height_m=1.5)
    >>> camera.horizon_px
    240.0
    >>> camera.project([(0.0, 0.0, 5.0)])
    array([[320., 390.]])
    """

    image_size: ImageSize = attrs.field(converter=as_known_image_size)
    focal_px: float = attrs.field(converter=as_float, validator=positive)
    height_m: float = attrs.field(converter=as_float, validator=positive)
    pitch_deg: float = attrs.field(default=0.0, converter=as_float, validator=finite)
    roll_deg: float = attrs.field(default=0.0, converter=as_float, validator=finite)

    @property
    def horizon_px(self) -> float:
        """Row of the horizon in the middle column, in pixels; far off the picture near 90."""
        pitch, roll = math.radians(self.pitch_deg), math.radians(self.roll_deg)
        return self.image_size[1] / 2 - self.focal_px * math.tan(pitch) / math.cos(roll)

    @property
    def axes(self) -> FloatArray:
        """The camera's x, y and z axis as rows, each to the right, down and ahead: (3, 3)."""
        pitch, roll = math.radians(self.pitch_deg), math.radians(self.roll_deg)
        right = np.array([1.0, 0.0, 0.0])
        below = np.array([0.0, math.cos(pitch), -math.sin(pitch)])
        ahead = np.array([0.0, math.sin(pitch), math.cos(pitch)])
        cos, sin = math.cos(roll), math.sin(roll)
        return np.stack([right * cos - below * sin, right * sin + below * cos, ahead])

    def in_camera(self, points: ArrayLike) -> FloatArray:
        """
        Give places in the camera's own axes.

        Parameters
        ----------
        points : (N, 3) array_like of float
            Metres to the right, up from the ground, and ahead, from the point below the camera.

        Returns
        -------
        (N, 3) ndarray of float64
            Metres along the camera's x, y and z axis; the last is the z-depth.
        """
        right, up, ahead = np.asarray(points, dtype=np.float64).T
        seen: FloatArray = np.stack([right, self.height_m - up, ahead], axis=-1) @ self.axes.T
        return seen

    def project(self, points: ArrayLike) -> FloatArray:
        """
        Find the pixel at which places are seen.

        Parameters
        ----------
        points : (N, 3) array_like of float
            Metres to the right, up from the ground, and ahead, from the point below the camera.

        Returns
        -------
        (N, 2) ndarray of float64
            Columns and rows, in pixels.

        Raises
        ------
        ValueError
            If a place is not before the camera.
        """
        seen = self.in_camera(points)
        if not (seen[:, 2] > NEAREST_M).all():
            msg = (
                f"`points` must lie more than {NEAREST_M} m before the camera; got a z-depth of "
                f"{float(seen[:, 2].min()):.3g} m."
            )
            raise ValueError(msg)
        centre = np.array(self.image_size, dtype=np.float64) / 2
        pixels: FloatArray = centre + self.focal_px * seen[:, :2] / seen[:, 2:]
        return pixels
