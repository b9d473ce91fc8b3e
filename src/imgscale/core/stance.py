"""
Where objects lie in the image: what a ground plane and a tilted camera make of that.

Rows and columns count from the principal point, rows downward. With the horizon at row y0 and a
plane that falls off sideways by the slope r, an object whose foot is at (x, y) is at the distance
``h / (y - y0 - r x)`` in focal lengths, h being the camera's height above the plane.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imgscale._typing import BoolArray, FloatArray


class Tilts(NamedTuple):
    """
    What a tilted camera does.

    Attributes
    ----------
    by_depth, by_foot : (K, N) ndarray of float64
        What is to be added to log(d p), d from z-depth and from the foot.
    log_secant : (K, N) ndarray of float64
        Log of 1 / cos(pitch).
    """

    by_depth: FloatArray
    by_foot: FloatArray
    log_secant: FloatArray


class Stance(NamedTuple):
    """
    Boxes as a plane and a tilt see them, one row for each object.

    Attributes
    ----------
    foot : (N,) ndarray of float64
        Row at which the object meets the ground; NaN where it does not, or not in view.
    lateral : (N,) ndarray of float64
        Column there.
    top, middle : (N,) ndarray of float64
        Rows of the box's upper edge and middle.
    foot_var : (N,) ndarray of float64
        Variance of the foot's row, in square pixels: the box's lower edge, and slopes.
    relief_var : (N,) ndarray of float64
        Variance of the log distance besides: kerbs and bumps, relative to the camera's height.
    box_var : (N,) ndarray of float64
        Variance of the log extent in pixels.
    focal_px : (N,) ndarray of float64
        Focal length; NaN where it is not known, and then no tilt is corrected.
    span_px : (N,) ndarray of float64
        Rows over which the feet of objects off the plane are spread.
    upright : (N,) ndarray of bool
        True where the extent is measured along the vertical.
    is_height : (N,) ndarray of bool
        True for a row that tells the camera's height itself.
    is_new : (N,) ndarray of bool
        True where the foot was not yet a witness of the plane.
    lean_horizon, lean_slope : (N,) ndarray of float64
        For a row that sums up other frames: how its log k changes with horizon and slope.
    """

    foot: FloatArray
    lateral: FloatArray
    top: FloatArray
    middle: FloatArray
    foot_var: FloatArray
    relief_var: FloatArray
    box_var: FloatArray
    focal_px: FloatArray
    span_px: FloatArray
    upright: BoolArray
    is_height: BoolArray
    is_new: BoolArray
    lean_horizon: FloatArray
    lean_slope: FloatArray

    @classmethod
    def nowhere(
        cls, count: int, *, is_height: bool = False, lean: FloatArray | None = None
    ) -> Stance:
        """
        Make rows that are no objects: what is known of the camera, or from other frames.

        Parameters
        ----------
        count : int
            Number of rows.
        is_height : bool
            True where they tell the camera's height.
        lean : (N, 2) ndarray of float, optional
            How their log k changes with horizon and slope.

        Returns
        -------
        Stance
            The rows.
        """
        nowhere, zero = np.full(count, np.nan), np.zeros(count)
        no = np.zeros(count, dtype=np.bool_)
        change = np.zeros((count, 2)) if lean is None else lean
        return cls(
            foot=nowhere,
            lateral=zero,
            top=zero,
            middle=zero,
            foot_var=zero,
            relief_var=zero,
            box_var=zero,
            focal_px=nowhere,
            span_px=np.ones(count),
            upright=no,
            is_height=np.full(count, is_height),
            is_new=no,
            lean_horizon=change[:, 0],
            lean_slope=change[:, 1],
        )

    def below_horizon(self, horizon: FloatArray, slope: FloatArray) -> FloatArray:
        """
        Compute how far feet lie below the horizon.

        Parameters
        ----------
        horizon : (K, N) ndarray of float
            Row of the horizon below the principal point, for each case and object.
        slope : (K, N) ndarray of float
            How far the horizon falls per column.

        Returns
        -------
        (K, N) ndarray of float64
            Rows, negative above it; NaN without a foot.
        """
        return self.foot - horizon - slope * self.lateral

    def tilts(self, horizon: FloatArray, log_focal: FloatArray | float = 0.0) -> Tilts:
        """
        Compute what a tilted camera does to extents in pixels.

        Parameters
        ----------
        horizon : (K, N) ndarray of float
            Row of the horizon below the principal point, for each case and object.
        log_focal : (K, N) ndarray of float
            Log of the focal length over the one that was told.

        Returns
        -------
        Tilts
            0 without a focal length, inf where an upright object cannot be seen so.

        Notes
        -----
        With the pitch T, ``tan T = -y0 / f``, an upright object at z-depth Z spans ``p = f H / Z
        cos T (1 - tan T y / f)``, y being its middle row. From the foot ``p (1 + tan^2 T) / (1 -
        tan T y / f)``, y being its upper row, obeys the law of the level camera exactly; across,
        1 / cos T takes the place of that factor.
        """
        level = np.isnan(self.focal_px)
        focal = np.where(level, 1.0, self.focal_px) * np.exp(log_focal)
        tangent = np.where(level, 0.0, -horizon / focal)
        square = 1 + tangent**2
        with np.errstate(divide="ignore"):
            middle, top = (
                np.log(np.maximum(1 - tangent * row / focal, 0.0))
                for row in (self.middle, self.top)
            )
        log_secant = 0.5 * np.log(square)
        return Tilts(
            by_depth=np.where(self.upright, log_secant - middle, 0.0),
            by_foot=np.where(self.upright, 2 * log_secant - top, log_secant),
            log_secant=log_secant,
        )
