"""What is known of the camera: focal length, principal point, tilt."""

from __future__ import annotations

import math
from collections.abc import Sequence
from os import PathLike

import attrs
import numpy as np
from numpy.typing import ArrayLike

from imgscale._checks import (
    as_float,
    as_image_size,
    as_known_image_size,
    as_optional_float,
    finite,
    non_negative,
    own_floats,
    positive,
)
from imgscale._reading import decoding
from imgscale._typing import ImageSize
from imgscale.picture import opened_picture

__all__ = ["Camera"]

# Diagonal of the 36 x 24 mm frame. The 35 mm equivalent is defined by the diagonal, some makers
# use the width: on a 4:3 picture the two differ by 4 %.
_FULL_FRAME_DIAGONAL_MM = math.hypot(36.0, 24.0)
_EQUIVALENT_REL_STD = 0.04
_LARGEST_STRETCH = 0.05  # networks guess fx and fy apart, up to some per cent


@attrs.frozen
class Camera:
    """
    Intrinsics of a pinhole camera, for the picture as it is measured.

    Resizing a picture scales its focal length in pixels with it. Undistort wide-angle pictures
    first: a pinhole is assumed.

    Attributes
    ----------
    focal_px : float
        Focal length in pixels, finite and positive.
    focal_rel_std : float
        Its relative standard error, >= 0: 0 for a calibration, about 0.04 for EXIF.
    cx, cy : float or None
        Principal point in pixels, with the left edge of the first pixel at 0 (calibrations that
        put its centre at 0, as OpenCV's, need 0.5 added); the image's centre where None.
    image_size : (width, height) or None
        Size in pixels of the picture that the focal length belongs to.
    pitch_deg : float
        Tilt of the optical axis below the horizontal, in degrees, -90 to 90; 0 with the standard
        error 0 means that nobody told.
    pitch_std_deg : float
        Its standard error, in degrees, >= 0.

    Raises
    ------
    ValueError
        If a value breaks its law.

    Examples
    --------
    >>> from imgscale import Camera
    >>> Camera(721.5, focal_rel_std=0.0).focal_px
    721.5
    >>> Camera(-721.5, focal_rel_std=0.0)
    Traceback (most recent call last):
        ...
    ValueError: `focal_px` must be finite and positive; got -721.5.
    """

    focal_px: float = attrs.field(converter=as_float, validator=positive)
    focal_rel_std: float = attrs.field(kw_only=True, converter=as_float, validator=non_negative)
    cx: float | None = attrs.field(
        default=None,
        kw_only=True,
        converter=as_optional_float,
        validator=attrs.validators.optional(finite),
    )
    cy: float | None = attrs.field(
        default=None,
        kw_only=True,
        converter=as_optional_float,
        validator=attrs.validators.optional(finite),
    )
    image_size: ImageSize | None = attrs.field(default=None, kw_only=True, converter=as_image_size)
    pitch_deg: float = attrs.field(default=0.0, kw_only=True, converter=as_float, validator=finite)
    pitch_std_deg: float = attrs.field(
        default=0.0, kw_only=True, converter=as_float, validator=non_negative
    )

    def __attrs_post_init__(self) -> None:
        if abs(self.pitch_deg) >= 90:
            msg = f"`pitch_deg` must be between -90 and 90; got {self.pitch_deg}."
            raise ValueError(msg)

    @property
    def is_tilted(self) -> bool:
        """True where a pitch is told: 0 with the standard error 0 means that it is not."""
        return bool(self.pitch_deg or self.pitch_std_deg)

    def check_image_size(self, image_size: ImageSize | None) -> None:
        """
        Raise if the camera is known to belong to another size of picture.

        Parameters
        ----------
        image_size : (width, height) or None
            Size of the picture that is measured.

        Raises
        ------
        ValueError
            If both sizes are known and differ.
        """
        if self.image_size and image_size and self.image_size != image_size:
            msg = (
                f"`camera.image_size` must be that of the image, {image_size}; got "
                f"{self.image_size}. A resized picture's focal length scales with it, a cropped "
                "picture's principal point moves, and the EXIF orientation of a turned one is to "
                "be applied."
            )
            raise ValueError(msg)

    @classmethod
    def from_matrix(
        cls,
        matrix: ArrayLike,
        *,
        focal_rel_std: float,
        image_size: Sequence[int],
        of_size: Sequence[int] | None = None,
    ) -> Camera:
        """
        Read the focal length and principal point out of a matrix of intrinsics.

        Parameters
        ----------
        matrix : (3, 3) array_like of float
            [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], in pixels of a picture of size `of_size`. cx and
            cy count from the left edge of the first pixel: add 0.5 px where they count from its
            centre.
        focal_rel_std : float
            Relative standard error of the focal length, >= 0.
        image_size : (width, height)
            Size in pixels of the picture that is measured.
        of_size : (width, height), optional
            Size of the picture that the matrix refers to: a network's input, or (1, 1) where the
            intrinsics are shares of the picture. `image_size` where omitted.

        Returns
        -------
        Camera
            With fy as its focal length, which heights go with, in pixels of the picture.

        Raises
        ------
        ValueError
            If the matrix is not of that form, or fx and fy differ by more than 5 % in the picture:
            it was stretched then, or `of_size` is wrong.

        Examples
        --------
        A network that gives shares of the picture:

        >>> from imgscale import Camera
        >>> shares = [[0.9375, 0, 0.5], [0, 1.25, 0.5], [0, 0, 1]]
        >>> Camera.from_matrix(shares, focal_rel_std=0.1, image_size=(640, 480), of_size=(1, 1))
        Camera(focal_px=600.0, focal_rel_std=0.1, cx=320.0, cy=240.0, image_size=(640, 480),
               pitch_deg=0.0, pitch_std_deg=0.0)
        """
        rows = own_floats("matrix", matrix, 2, "(3, 3)").astype(np.float64)
        if rows.shape != (3, 3) or not np.array_equal(
            rows[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]], [0, 0, 0, 0, 1]
        ):
            msg = (
                "`matrix` must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]; got "
                f"{rows.tolist() if rows.size <= 16 else rows.shape}."
            )
            raise ValueError(msg)
        width, height = as_known_image_size(image_size)
        of_width, of_height = as_image_size(of_size, "of_size") or (width, height)
        fx, cx = (float(number) * width / of_width for number in (rows[0, 0], rows[0, 2]))
        fy, cy = (float(number) * height / of_height for number in (rows[1, 1], rows[1, 2]))
        camera = cls(fy, focal_rel_std=focal_rel_std, cx=cx, cy=cy, image_size=(width, height))
        if abs(fx / fy - 1) > _LARGEST_STRETCH:
            msg = (
                f"`matrix` must have fx and fy alike in the picture; got {fx:g} and {fy:g} px at "
                f"{width} x {height}. Give the size that it refers to as `of_size`."
            )
            raise ValueError(msg)
        return camera

    @classmethod
    def from_exif(cls, path: str | PathLike[str]) -> Camera:
        """
        Read the focal length from a photo's EXIF record.

        The 35 mm equivalent focal length f35 gives ``f35 * diagonal_px / 43.27 mm``, with a
        standard error of 4 %: makers differ in whether they compare diagonals or widths.

        Parameters
        ----------
        path : str or path-like
            The photo, as the camera wrote it or resized as a whole.

        Returns
        -------
        Camera
            With `image_size` of the upright picture.

        Raises
        ------
        FileError
            If the file is no picture, or its record is broken.
        OSError
            If there is no such file, or it may not be read.
        ValueError
            If the record is missing, or the picture has another aspect ratio than the record
            says: then it was cropped and its focal length in pixels is not known.
        """
        from PIL import ExifTags  # noqa: PLC0415 - 20 ms that most users do not need

        with opened_picture(path) as image, decoding(path, "a picture"):
            width, height = image.size
            turned = image.getexif().get(ExifTags.Base.Orientation, 1) >= 5
            record = image.getexif().get_ifd(ExifTags.IFD.Exif)
            focal_mm, *taken = (float(record.get(entry, 0)) for entry in _exif_entries())
        if not 0 < focal_mm < math.inf:
            msg = (
                f"{path} must carry FocalLengthIn35mmFilm in its EXIF record; got none. "
                "Give the focal length by hand: Camera(focal_px, focal_rel_std=...)."
            )
            raise ValueError(msg)
        if all(taken) and not _same_shape((width, height), (taken[0], taken[1])):
            msg = (
                f"{path} must have the aspect ratio it was taken with, {taken[0]:.0f} x "
                f"{taken[1]:.0f}; got {width} x {height}. Give the focal length of a cropped "
                "picture by hand."
            )
            raise ValueError(msg)
        focal_px = focal_mm * math.hypot(width, height) / _FULL_FRAME_DIAGONAL_MM
        size = (height, width) if turned else (width, height)
        return cls(focal_px, focal_rel_std=_EQUIVALENT_REL_STD, image_size=size)


def _exif_entries() -> tuple[int, ...]:
    from PIL.ExifTags import Base  # noqa: PLC0415 - 20 ms that most users do not need

    return (Base.FocalLengthIn35mmFilm, Base.ExifImageWidth, Base.ExifImageHeight)


def _same_shape(size: tuple[float, float], taken: tuple[float, float]) -> bool:
    """Compare aspect ratios, blind to a quarter turn, to 1 %."""
    ours, theirs = (max(pair) / min(pair) for pair in (size, taken))
    return abs(ours / theirs - 1) < 0.01
