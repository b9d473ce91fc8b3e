"""Depth from a laser scanner: its points, projected into the picture."""

from __future__ import annotations

from collections.abc import Sequence

import attrs
import numpy as np
from numpy.typing import ArrayLike

from imgscale._checks import array_summary, as_known_image_size, own_floats
from imgscale._typing import FloatArray, ImageArray, ImageSize
from imgscale.depth import DepthMap
from imgscale.picture import size_of

__all__ = ["LidarDepth", "depth_from_points"]

# How far the projection's third row may be from unit length: calibrations are printed with seven
# digits or more.
_UNIT_LENGTH_WITHIN = 1e-3


def depth_from_points(
    points: ArrayLike, projection: ArrayLike, image_size: Sequence[int]
) -> DepthMap:
    """
    Project points into a picture; where several meet in a pixel, the nearest holds.

    Parameters
    ----------
    points : (N, 3) array_like of float
        Points x, y, z in metres, in the sensor's frame. Those that are not finite, lie behind the
        camera or miss the picture are left out.
    projection : (3, 4) array_like of float
        Takes such a point to the picture: for KITTI ``P2 @ R0_rect @ Tr_velo_to_cam``, with the
        latter two made 4 x 4. Its third row gives metres, so its first three numbers have length 1.
        Pixel centres are whole numbers, as in the calibrations of KITTI, OpenCV and ROS.
    image_size : (width, height)
        Size of the picture in pixels.

    Returns
    -------
    DepthMap
        Metric z-depth in the camera's frame, NaN where no point falls: of a scanner of 64 lines
        some 4 % of the pixels are filled, and sampling needs no more. A scanner that sits beside
        the camera also sees past things: a few far points shine through near ones.

    Raises
    ------
    ValueError
        If a shape or the projection breaks its law, or no point falls into the picture.
    TypeError
        If the arrays hold no real numbers.

    Notes
    -----
    (u z, v z, z) = projection @ (x, y, z, 1); the pixel is the one whose centre is next to (u, v).

    Examples
    --------
    A point 8 m ahead and 1 m to the right, one behind it, seen with a focal length of 4 px:

    >>> from imgscale.depth_sources.lidar import depth_from_points
    >>> projection = [[4, 0, 1, 0], [0, 4, 1, 0], [0, 0, 1, 0]]
    >>> depth_from_points([[2, 0, 8], [4, 0, 16]], projection, (3, 2)).values
    array([[nan, nan, nan],
           [nan, nan,  8.]])
    """
    return _project(_as_points(points), _as_projection(projection), as_known_image_size(image_size))


def _project(points: FloatArray, projection: FloatArray, image_size: ImageSize) -> DepthMap:
    width, height = image_size
    # Nothing is a point that is not finite; far ones may overflow on their way.
    with np.errstate(all="ignore"):
        scaled: FloatArray = points @ projection[:, :3].T + projection[:, 3]
        z = scaled[:, 2]
        columns = np.floor(scaled[:, 0] / z + 0.5)
        rows = np.floor(scaled[:, 1] / z + 0.5)
        ahead = np.isfinite(z) & (z > 0)
        seen = ahead & (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    if not seen.any():
        msg = (
            f"`points` must fall into the picture, {width} x {height} px; of {len(z)} points "
            f"{np.count_nonzero(ahead)} are ahead of the camera and none is in it. Is `projection` "
            "that from the sensor's frame, P2 @ R0_rect @ Tr_velo_to_cam?"
        )
        raise ValueError(msg)
    depth = np.full((height, width), np.inf)
    np.minimum.at(depth, (rows[seen].astype(np.intp), columns[seen].astype(np.intp)), z[seen])
    depth[np.isinf(depth)] = np.nan
    return DepthMap(depth, kind="metric")


def _own_float64(name: str, values: ArrayLike, shape_law: str) -> FloatArray:
    """Copy real values into a read-only array of float64."""
    array: FloatArray = own_floats(name, values, 2, shape_law).astype(np.float64, copy=False)
    array.flags.writeable = False
    return array


def _as_points(points: ArrayLike) -> FloatArray:
    sensor = _own_float64("points", points, "(N, 3)")
    if sensor.shape[1] != 3:
        msg = (
            f"`points` must have shape (N, 3); got {sensor.shape}. Leave out what is not x, y, z: "
            "points[:, :3]."
        )
        raise ValueError(msg)
    return sensor


def _as_projection(projection: ArrayLike) -> FloatArray:
    matrix = _own_float64("projection", projection, "(3, 4)")
    if matrix.shape != (3, 4) or not np.isfinite(matrix).all():
        seen = f"shape {matrix.shape}" if matrix.shape != (3, 4) else "a number that is not"
        msg = f"`projection` must have shape (3, 4) and finite numbers; got {seen}."
        raise ValueError(msg)
    length = float(np.linalg.norm(matrix[2, :3]))
    if abs(length - 1) > _UNIT_LENGTH_WITHIN:
        msg = (
            "`projection` must give metres in its third row, whose first three numbers then have "
            f"length 1; got {length:g}. Divide the matrix by it."
        )
        raise ValueError(msg)
    return matrix


@attrs.frozen(eq=False)
class LidarDepth:
    """
    One scan as a `DepthSource`, for the picture taken with it.

    Attributes
    ----------
    points : (N, 3) ndarray of float64
        As for `depth_from_points`; a copy, read-only.
    projection : (3, 4) ndarray of float64
        As for `depth_from_points`; a copy, read-only.

    Raises
    ------
    ValueError
        If a shape or the projection breaks its law.
    TypeError
        If the arrays hold no real numbers.

    Examples
    --------
    >>> import numpy as np
    >>> from imgscale.depth_sources.lidar import LidarDepth
    >>> source = LidarDepth([[2, 0, 8]], [[4, 0, 1, 0], [0, 4, 1, 0], [0, 0, 1, 0]])
    >>> source(np.zeros((2, 3, 3), dtype=np.uint8)).image_size
    (3, 2)
    """

    points: FloatArray = attrs.field(converter=_as_points, repr=array_summary)
    projection: FloatArray = attrs.field(converter=_as_projection, repr=array_summary)

    def __call__(self, image: ImageArray, /) -> DepthMap:
        """
        Give the depth of a picture.

        Parameters
        ----------
        image : (H, W, 3) ndarray of uint8
            The picture; only its size counts.

        Returns
        -------
        DepthMap
            As `depth_from_points` gives it.

        Raises
        ------
        TypeError, ValueError
            If `image` is no picture, or no point falls into it.
        """
        return _project(self.points, self.projection, size_of(image))
