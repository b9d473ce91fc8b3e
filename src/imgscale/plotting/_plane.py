"""How a ground plane is seen: where places on it lie in the picture, and how long a pixel is."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from imgscale._typing import FloatArray, ImageSize
from imgscale.camera import Camera
from imgscale.model import ScaleModel


class PlaneView(NamedTuple):
    """
    How the ground plane of a model is seen.

    Places on the ground are metres to the right and ahead of the point below the camera, ahead
    being where the optical axis points.

    Attributes
    ----------
    image_size : (width, height)
        Size of the image in pixels.
    cx, cy : float
        Principal point in pixels.
    horizon : float
        Row of the horizon below the principal point, in its column, in pixels.
    slope : float
        How far the horizon falls per column.
    height_m : float
        Height of the camera above the plane, in metres.
    focal_px : float
        Focal length in pixels; infinite where it is not known, as for a level camera.
    """

    image_size: ImageSize
    cx: float
    cy: float
    horizon: float
    slope: float
    height_m: float
    focal_px: float

    @classmethod
    def of(cls, model: ScaleModel, camera: Camera | None = None) -> PlaneView:
        """
        Take the plane out of a model.

        Parameters
        ----------
        model : ScaleModel
            The model.
        camera : Camera, optional
            The camera; the model's own where omitted.

        Returns
        -------
        PlaneView
            The view.

        Raises
        ------
        ValueError
            If the model has no plane, or the camera belongs to another size of picture.
        """
        size = model.image_size or (model.ground.image_size if model.ground else None)
        if model.plane is None or size is None:
            msg = (
                f'`model` must have a ground plane; got a "{model.kind}" model without one. Fit '
                f"it with ground=GroundPlane(image_size={size or '(width, height)'})."
            )
            raise ValueError(msg)
        camera = camera or model.camera
        if camera:
            camera.check_image_size(size)
        cx = size[0] / 2 if camera is None or camera.cx is None else camera.cx
        cy = size[1] / 2 if camera is None or camera.cy is None else camera.cy
        slope = math.tan(math.radians(model.plane.roll_deg))
        focal_px = camera.focal_px if camera else model.focal_px
        return cls(
            image_size=size,
            cx=cx,
            cy=cy,
            horizon=model.plane.horizon_px - cy + slope * (cx - size[0] / 2),
            slope=slope,
            height_m=model.plane.camera_height_m,
            focal_px=math.inf if focal_px is None else focal_px,
        )

    @property
    def secant(self) -> float:
        """1 over the share of the ground's vertical along the image's rows: 1 if level."""
        return math.sqrt(1 + self.slope**2 + (self.horizon / self.focal_px) ** 2)

    def below_horizon(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """
        Compute how far points lie below the horizon.

        Parameters
        ----------
        x, y : array_like of float
            Points in pixels.

        Returns
        -------
        ndarray of float64
            Rows; negative above the horizon.
        """
        across = np.asarray(x, dtype=np.float64) - self.cx
        return np.asarray(y, dtype=np.float64) - self.cy - self.horizon - self.slope * across

    def metres_per_pixel(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """
        Compute the scale where a pixel sees the ground.

        Parameters
        ----------
        x, y : array_like of float
            Points in pixels.

        Returns
        -------
        ndarray of float64
            The z-depth over the focal length, in m/px; NaN from the horizon upward.
        """
        below = self.below_horizon(x, y)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = self.height_m * self.secant / below
        return np.where(below > 0, scale, np.nan)

    @property
    def frame(self) -> FloatArray:
        """Unit vectors to the right, down and ahead along the ground, as the camera sees them."""
        down = np.array([-self.slope, 1.0, -self.horizon / self.focal_px]) / self.secant
        ahead = np.array([0.0, 0.0, 1.0]) - down[2] * down
        ahead /= math.sqrt(ahead @ ahead)
        right = np.asarray(np.cross(down, ahead), dtype=np.float64)
        return np.stack([right, down, ahead])

    def in_camera(self, right: ArrayLike, ahead: ArrayLike) -> FloatArray:
        """
        Put places on the ground into the camera's coordinates.

        Parameters
        ----------
        right, ahead : array_like of float
            Places, in metres.

        Returns
        -------
        (..., 3) ndarray of float64
            Positions: x to the right, y down and z along the optical axis, in metres.
        """
        across, down, along = self.frame
        sideways: FloatArray = np.asarray(right, dtype=np.float64)[..., None] * across
        forward: FloatArray = np.asarray(ahead, dtype=np.float64)[..., None] * along
        place: FloatArray = sideways + self.height_m * down + forward
        return place

    def project(self, right: ArrayLike, ahead: ArrayLike) -> FloatArray:
        """
        Find where places on the ground are seen.

        Parameters
        ----------
        right, ahead : array_like of float
            Places in front of the camera, in metres.

        Returns
        -------
        (..., 2) ndarray of float64
            Columns and rows, in pixels.
        """
        points = self.in_camera(right, ahead)
        centre: FloatArray = np.array([self.cx, self.cy])
        seen: FloatArray = self.focal_px * points[..., :2] / points[..., 2:] + centre
        return seen

    def ground_at(self, x: ArrayLike, y: ArrayLike) -> FloatArray:
        """
        Find the place on the ground that a pixel sees.

        Parameters
        ----------
        x, y : array_like of float
            Points in pixels, below the horizon.

        Returns
        -------
        (..., 2) ndarray of float64
            Metres to the right and ahead.
        """
        columns, rows = np.broadcast_arrays(
            np.asarray(x, dtype=np.float64) - self.cx, np.asarray(y, dtype=np.float64) - self.cy
        )
        rays = np.stack([columns, rows, np.full(rows.shape, self.focal_px)], axis=-1)
        across, down, along = self.frame
        depth = self.height_m / (rays @ down)
        return np.stack([rays @ across * depth, rays @ along * depth], axis=-1)

    def in_picture(
        self, start: FloatArray, direction: FloatArray, low: float, high: float
    ) -> tuple[float, float] | None:
        """
        Clip a straight line in space to what the picture shows.

        Parameters
        ----------
        start, direction : (3,) ndarray of float
            The line is ``start + t * direction``, in the camera's coordinates.
        low, high : float
            Range of t.

        Returns
        -------
        tuple of float or None
            The range of t that is in the picture; None where nothing is.
        """
        width, height = self.image_size
        focal = self.focal_px
        # inside each border is where a linear function of the point is positive
        borders = np.array(
            [
                [focal, 0, self.cx],
                [-focal, 0, width - self.cx],
                [0, focal, self.cy],
                [0, -focal, height - self.cy],
                [0, 0, focal],
            ]
        )
        for here, change in zip(borders @ start, borders @ direction, strict=True):
            if change > 0:
                low = max(low, -here / change)
            elif change < 0:
                high = min(high, -here / change)
            elif here < 0:
                return None
        return (low, high) if low < high else None
