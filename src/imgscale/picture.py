"""A picture as everything here looks at it: upright RGB bytes."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from os import PathLike
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from imgscale._reading import decoding, open_file
from imgscale._typing import ImageArray, ImageSize
from imgscale.errors import FileError

if TYPE_CHECKING:
    from PIL.Image import Image as PillowImage

__all__ = ["Picture", "opened_picture", "size_of", "upright_rgb"]


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
        If an array is not (H, W, 3) uint8, or a PIL image has more than 8 bits per channel.
    FileError
        If a file is no picture, broken or cut off, has more than 8 bits per channel, or more
        pixels than Pillow opens: twice `PIL.Image.MAX_IMAGE_PIXELS`, 178 956 970 where nobody
        changed it.
    OSError
        If a file is missing or may not be read.
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
        path = cast("str | PathLike[str]", image)
        with opened_picture(path) as opened, decoding(path, "a picture"):
            return _eight_bits(ImageOps.exif_transpose(opened))
    if isinstance(image, Image.Image):
        return _eight_bits(ImageOps.exif_transpose(image))
    msg = f"`image` must be a path, an array or a PIL image; got {type(image).__name__}."
    raise TypeError(msg)


@contextmanager
def opened_picture(path: str | PathLike[str]) -> Generator[PillowImage]:
    """
    Open a picture's file; its pixels are decoded when they are asked for.

    Parameters
    ----------
    path : str or path-like
        The file.

    Yields
    ------
    PIL image
        The picture as the file has it.

    Raises
    ------
    FileError
        If it is no picture, or has more pixels than Pillow opens.
    OSError
        If it is missing or may not be read.
    """
    from PIL import Image  # noqa: PLC0415 - 20 ms that most users do not need

    with open_file(path) as file:
        with decoding(path, "a picture"):
            try:
                opened = Image.open(file)
            except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
                msg = f"{path} is too large to be opened: {error} Raise PIL.Image.MAX_IMAGE_PIXELS."
                raise FileError(msg) from error
        with opened:
            yield opened


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
