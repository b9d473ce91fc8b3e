"""How many pixels an object spans along an axis, and how well that is known."""

from __future__ import annotations

import numpy as np

from imgscale._typing import BoolArray, FloatArray, ImageSize, SizeAxis

# A box that leaves less than one pixel to the border may be cut there. Formats whose last pixel is
# inclusive end at size - 1.
_BORDER_PX = 1.0


def pixel_extent(boxes: FloatArray, axis: SizeAxis) -> FloatArray:
    """
    Measure boxes along an axis.

    Parameters
    ----------
    boxes : (N, 4) ndarray of float
        Boxes x1, y1, x2, y2, in pixels.
    axis : str
        "height", "width" or "diameter". A circle seen from the side is an ellipse whose long axis
        keeps the diameter, so that one is the longer side of the box.

    Returns
    -------
    (N,) ndarray of float
        Extents in pixels, positive.
    """
    width = boxes[:, 2] - boxes[:, 0]
    height = boxes[:, 3] - boxes[:, 1]
    if axis == "diameter":
        return np.maximum(width, height)
    return height if axis == "height" else width


def extent_rel_std(pixels: FloatArray, box_px: float, box_rel: float) -> FloatArray:
    """
    Compute the relative standard error of extents.

    Parameters
    ----------
    pixels : (N,) ndarray of float
        Extents in pixels, positive.
    box_px, box_rel : float
        The box error in pixels and relative to the extent.

    Returns
    -------
    (N,) ndarray of float
        ``sqrt((box_px / pixels)^2 + box_rel^2)``.
    """
    return np.hypot(box_px / pixels, box_rel)


def outside_image(boxes: FloatArray, image_size: ImageSize) -> BoolArray:
    """
    Tell which boxes reach more than a pixel beyond the image.

    Parameters
    ----------
    boxes : (N, 4) ndarray of float
        Boxes x1, y1, x2, y2, in pixels.
    image_size : (width, height)
        Size of the image in pixels.

    Returns
    -------
    (N,) ndarray of bool
        True where the box cannot have been drawn on this image.
    """
    return _beyond(boxes, image_size) > _BORDER_PX


def touches_border(boxes: FloatArray, image_size: ImageSize) -> BoolArray:
    """
    Tell which boxes end at the image's border, where the object may go on.

    Parameters
    ----------
    boxes : (N, 4) ndarray of float
        Boxes x1, y1, x2, y2, in pixels.
    image_size : (width, height)
        Size of the image in pixels.

    Returns
    -------
    (N,) ndarray of bool
        True where less than a whole pixel of background is left on the left or above, and at most
        one on the right or below, where boxes of inclusive formats end.
    """
    width, height = image_size
    return (
        (boxes[:, :2] < _BORDER_PX).any(axis=1)
        | (boxes[:, 2] >= width - _BORDER_PX)
        | (boxes[:, 3] >= height - _BORDER_PX)
    )


def _beyond(boxes: FloatArray, image_size: ImageSize) -> FloatArray:
    """Pixels by which boxes reach beyond the image, negative inside it."""
    over: FloatArray = boxes[:, 2:] - np.asarray(image_size, dtype=np.float64)
    beyond: FloatArray = np.maximum(over.max(axis=1), -boxes[:, :2].min(axis=1))
    return beyond
