"""A picture as everything here looks at it: upright RGB bytes."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from imgscale._typing import ImageArray, ImageSize

if TYPE_CHECKING:
    from PIL.Image import Image as PillowImage

__all__ = ["Picture", "size_of", "upright_rgb"]


class PillowPicture(Protocol):
    """What an annotation says of `PIL.Image.Image`, which would take 20 ms to import."""

    def getexif(self) -> Any:
        """Read the EXIF record."""
        ...


Picture: TypeAlias = str | PathLike[str] | ImageArray | PillowPicture


def upright_rgb(image: object) -> ImageArray:
    """
    Read a picture with its orientation applied.

    Parameters
    ----------
    image : path, (H, W, 3) ndarray of uint8 or PIL image
        The picture. The EXIF orientation of a file or PIL image is applied; an array is taken as
        it is, and not copied.

    Returns
    -------
    (H, W, 3) ndarray of uint8
        The upright picture, RGB.

    Raises
    ------
    TypeError
        If it is no picture.
    ValueError
        If an array is not (H, W, 3) uint8, or the picture has more than 8 bits per channel, is
        broken or larger than Pillow opens.
    OSError
        If a file is missing or no picture.
    """
    if isinstance(image, np.ndarray):
        array = cast("NDArray[Any]", image)
        if array.dtype != np.uint8 or array.ndim != 3 or array.shape[2] != 3 or not array.size:
            msg = (
                f"`image` must be (H, W, 3) uint8 RGB; got {array.shape} {array.dtype}. Convert it "
                "first, or pass the file's path."
            )
            raise ValueError(msg)
        return array
    from PIL import Image, ImageOps  # noqa: PLC0415 - 20 ms that most users do not need

    if isinstance(image, (str, PathLike)):
        try:
            with Image.open(Path(cast("str | PathLike[str]", image))) as opened:
                return _eight_bits(ImageOps.exif_transpose(opened))
        except Image.DecompressionBombError as error:
            msg = f"`image` is too large to be opened: {error} Raise PIL.Image.MAX_IMAGE_PIXELS."
            raise ValueError(msg) from error
        except SyntaxError as error:  # Pillow's way of saying that a file is broken
            msg = f"`image` must be a whole picture; {image} is broken: {error}."
            raise ValueError(msg) from error
    if isinstance(image, Image.Image):
        return _eight_bits(ImageOps.exif_transpose(image))
    msg = f"`image` must be a path, an array or a PIL image; got {type(image).__name__}."
    raise TypeError(msg)


def size_of(image: object) -> ImageSize:
    """
    Read the size of a picture of which nothing else counts.

    Parameters
    ----------
    image : (H, W, 3) or (H, W) ndarray
        The picture.

    Returns
    -------
    (width, height)
        Its size in pixels.

    Raises
    ------
    TypeError
        If it is no array.
    ValueError
        If it is no picture.
    """
    if not isinstance(image, np.ndarray):
        msg = f"`image` must be a picture, (H, W, 3); got {type(image).__name__}."
        raise TypeError(msg)
    shape = cast("NDArray[Any]", image).shape
    if not (len(shape) == 2 or (len(shape) == 3 and shape[2] == 3)) or 0 in shape:
        msg = f"`image` must be a picture, (H, W, 3); got shape {shape}."
        raise ValueError(msg)
    return shape[1], shape[0]


def _eight_bits(image: PillowImage) -> ImageArray:
    """Turn a picture into RGB; deeper ones would be clipped."""
    if image.mode[0] in "IF":
        msg = f'`image` must have 8 bits per channel; got mode "{image.mode}". Scale it first.'
        raise ValueError(msg)
    return np.asarray(image.convert("RGB"))
