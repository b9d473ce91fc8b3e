"""How many pixels an object spans along an axis, and how well that is known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imgscale._typing import BoolArray, Box, FloatArray, ImageSize, SizeAxis

# A box that leaves less than one pixel to the border may be cut there. Formats whose last pixel is
# inclusive end at size - 1.
_BORDER_PX = 1.0


def pixel_extents(boxes: FloatArray) -> dict[SizeAxis, FloatArray]:
    """
    Measure boxes along every axis.

    Parameters
    ----------
    boxes : (N, 4) ndarray of float
        Boxes x1, y1, x2, y2, in pixels.

    Returns
    -------
    dict of str to (N,) ndarray of float
        Extents in pixels, positive, for "height", "width" and "diameter". A circle seen from the
        side is an ellipse whose long axis keeps the diameter, so that this is the longer side of
        the box.
    """
    x1, y1, x2, y2 = boxes.T
    width, height = x2 - x1, y2 - y1
    return {"height": height, "width": width, "diameter": np.maximum(width, height)}


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


def touches_border(boxes: Sequence[Box], image_size: ImageSize | None) -> list[bool]:
    """
    Tell which boxes end at the image's border, where the object may go on.

    Parameters
    ----------
    boxes : sequence of tuple of float
        Boxes (x1, y1, x2, y2), in pixels.
    image_size : (width, height) or None
        Size of the image in pixels; where it is not known, none is taken to end there.

    Returns
    -------
    list of bool
        True where less than a whole pixel of background is left on the left or above, and at most
        one on the right or below, where boxes of inclusive formats end.
    """
    if image_size is None:
        return [False] * len(boxes)
    right, bottom = image_size[0] - _BORDER_PX, image_size[1] - _BORDER_PX
    return [
        x1 < _BORDER_PX or y1 < _BORDER_PX or x2 >= right or y2 >= bottom
        for x1, y1, x2, y2 in boxes
    ]


def _beyond(boxes: FloatArray, image_size: ImageSize) -> FloatArray:
    """Pixels by which boxes reach beyond the image, negative inside it."""
    width, height = image_size
    x1, y1, x2, y2 = boxes.T
    beyond: FloatArray = np.maximum(np.maximum(x2 - width, y2 - height), -np.minimum(x1, y1))
    return beyond
