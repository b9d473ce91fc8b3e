"""Depth as people have it: a map, one value per object, or a ground plane; its kind declared."""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, cast

import attrs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgscale._checks import (
    array_summary,
    as_array,
    as_float,
    as_image_size,
    as_known_image_size,
    as_optional_float,
    check_choice,
    check_type,
    finite,
    finite_number,
    non_negative,
    own_floats,
    positive,
    positive_number,
)
from imgscale._typing import AnyFloatArray, BoolArray, DepthKind, FloatArray, ImageSize
from imgscale.camera import Camera

__all__ = [
    "Depth",
    "DepthMap",
    "GroundPlane",
    "ObjectDepths",
    "check_depth_type",
    "valid_depths",
]

VALUE_KINDS: tuple[DepthKind, ...] = ("metric", "relative", "inverse", "affine_inverse")
_FINGERPRINT_SAMPLES = 4096
_METRIC_SCALES = "KITTI 256, millimetres 1000, TUM 5000"


def valid_depths(values: AnyFloatArray, kind: DepthKind) -> BoolArray:
    """
    Tell which values are depths and which mean "missing".

    Parameters
    ----------
    values : ndarray of float
        Depth values of any shape.
    kind : str
        Their kind.

    Returns
    -------
    ndarray of bool
        True where a value is finite and, unless the kind is "affine_inverse", positive.
    """
    finite_values = np.isfinite(values)
    if kind == "affine_inverse":
        return finite_values
    with np.errstate(invalid="ignore"):
        return finite_values & (values > 0)


def _refuse_integers(name: str, values: ArrayLike, scales: str) -> None:
    dtype = as_array(name, "an array of numbers", values).dtype
    if dtype.kind in "iu":
        msg = (
            f"`{name}` must be floating point; got dtype {dtype}, as files store scaled depth. "
            f"Divide by the file's scale first: {scales}."
        )
        raise ValueError(msg)


def _as_given(values: ArrayLike) -> NDArray[Any]:
    """Take the values as they come; they are checked and copied where their kind is known."""
    if isinstance(values, np.ma.MaskedArray):
        masked: Any = cast("Any", values)
        missing = np.nan if masked.dtype.kind == "f" else 0
        return np.asarray(masked.filled(missing))
    return as_array("values", "an array of numbers", values)


def _check_not_transposed(image_size: ImageSize | None, shape: tuple[int, ...]) -> None:
    if image_size is not None and image_size == shape and shape[0] != shape[1]:
        msg = (
            f"`image_size` must be (width, height); got {image_size}, which is the map's (height, "
            f"width). Pass {image_size[::-1]}."
        )
        raise ValueError(msg)


def _as_object_depths(values: ArrayLike) -> NDArray[Any]:
    """Take an array as it comes; numbers typed by hand are metres, be they whole or not."""
    array = _as_given(values)
    by_hand = not isinstance(values, np.ndarray) and array.dtype.kind in "iu"
    return array.astype(np.float64) if by_hand else array


def _check_kind(_: object, __: attrs.Attribute[Any], value: str) -> None:
    check_choice("kind", value, VALUE_KINDS)


@attrs.frozen(eq=False)
class DepthMap:
    """
    A depth value for every pixel, of a kind that the caller declares.

    ==================  =========================================  ==================
    kind                what the values are                        valid values
    ==================  =========================================  ==================
    "metric"            z-depth in metres, along the optical axis  finite, > 0
    "relative"          z-depth up to an unknown factor            finite, > 0
    "inverse"           inverse z-depth up to a factor: raw        finite, > 0
                        disparity + doffs
    "affine_inverse"    inverse z-depth up to a factor and a       finite
                        shift: MiDaS, Depth Anything relative
    ==================  =========================================  ==================

    Any other value (NaN, inf, 0, negative) means that the pixel has no depth.

    Attributes
    ----------
    values : (H, W) ndarray of float
        The depths; copied and made read-only.
    kind : str
        What they are, see above. It is never guessed.
    image_size : (width, height)
        Size of the image that boxes refer to, in pixels; the map's own size where omitted. Boxes
        are scaled to the map, the map is never resized.
    scale_rel_std : float
        Relative standard error of the map's scale as a whole, >= 0: 0 for LiDAR and calibrated
        stereo, about 0.15 for networks that predict metres.

    Raises
    ------
    ValueError
        If the kind is unknown, no value is valid, or metric depth comes as integers.

    Examples
    --------
    >>> import numpy as np
    >>> from imgscale import DepthMap
    >>> DepthMap(np.full((480, 640), 2.5), kind="metric").image_size
    (640, 480)
    >>> DepthMap(np.full((480, 640), 2500, dtype=np.uint16), kind="metric")
    Traceback (most recent call last):
        ...
    ValueError: `values` must be floating point; got dtype uint16, as files store scaled depth.
    Divide by the file's scale first: KITTI 256, millimetres 1000, TUM 5000.
    """

    values: AnyFloatArray = attrs.field(converter=_as_given, repr=array_summary)
    kind: DepthKind = attrs.field(kw_only=True, validator=_check_kind)
    _image_size: ImageSize | None = attrs.field(
        default=None, kw_only=True, converter=as_image_size, alias="image_size"
    )
    scale_rel_std: float = attrs.field(
        default=0.0, kw_only=True, converter=as_float, validator=non_negative
    )

    def __attrs_post_init__(self) -> None:
        if self.kind == "metric":
            _refuse_integers("values", self.values, _METRIC_SCALES)
        owned = own_floats("values", self.values, 2, "(H, W)")
        _check_not_transposed(self._image_size, owned.shape)
        if not valid_depths(owned, self.kind).any():
            law = "finite" if self.kind == "affine_inverse" else "finite, positive"
            msg = (
                f'`values` must hold a {law} number; got none, so this "{self.kind}" map is empty.'
            )
            raise ValueError(msg)
        object.__setattr__(self, "values", owned)  # frozen: once, while it is being made

    @property
    def image_size(self) -> ImageSize:
        """Size (width, height) of the image that boxes refer to, in pixels."""
        height, width = self.values.shape
        return self._image_size or (width, height)

    @property
    def fingerprint(self) -> int:
        """Checksum of the shape and some thousand values: tells two maps apart cheaply."""
        step = max(1, math.isqrt(self.values.size // _FINGERPRINT_SAMPLES))
        sample = np.ascontiguousarray(self.values[::step, ::step], dtype=np.float64)
        return zlib.crc32(sample.tobytes(), zlib.crc32(repr(self.values.shape).encode()))

    @classmethod
    def from_disparity(
        cls,
        disparity: ArrayLike,
        *,
        focal_px: float,
        baseline_m: float,
        doffs_px: float = 0.0,
        image_size: Sequence[int] | None = None,
    ) -> DepthMap:
        """
        Turn the disparity of a calibrated stereo pair into metric depth.

        Parameters
        ----------
        disparity : (H, W) array_like of float
            Disparity in pixels of the left image; NaN, inf, 0 and negative values mean none.
        focal_px : float
            Focal length in pixels, positive.
        baseline_m : float
            Distance of the two cameras in metres, positive.
        doffs_px : float
            Difference of the principal points, x_right - x_left, in pixels (Middlebury's doffs).
        image_size : (width, height), optional
            Size of the image that boxes refer to; the map's own size where omitted.

        Returns
        -------
        DepthMap
            Metric depth, NaN where there is no disparity.

        Raises
        ------
        ValueError
            If a number breaks its law, or the disparity comes as integers.

        Notes
        -----
        Z = focal_px * baseline_m / (disparity + doffs_px).

        Examples
        --------
        >>> from imgscale import DepthMap
        >>> DepthMap.from_disparity([[20.0]], focal_px=700.0, baseline_m=0.5).values
        array([[17.5]])
        """
        focal = positive_number("focal_px", focal_px)
        baseline = positive_number("baseline_m", baseline_m)
        doffs = finite_number("doffs_px", doffs_px)
        _refuse_integers("disparity", disparity, "KITTI 256, OpenCV's SGBM 16")
        pixels = own_floats("disparity", disparity, 2, "(H, W)").astype(np.float64)
        shifted = pixels + doffs
        with np.errstate(invalid="ignore"):
            seen = np.isfinite(pixels) & (pixels > 0) & (shifted > 0)
        depth = np.full(pixels.shape, np.nan)
        depth[seen] = focal * baseline / shifted[seen]
        return cls(depth, kind="metric", image_size=image_size)

    @classmethod
    def from_ray_distance(cls, values: ArrayLike, camera: Camera) -> DepthMap:
        """
        Turn distances along each pixel's ray into metric z-depth.

        Parameters
        ----------
        values : (H, W) array_like of float
            Euclidean distances from the camera, in metres; missing where not finite or <= 0.
        camera : Camera
            Focal length and principal point, in pixels of `camera.image_size`, or of the map
            where that is None.

        Returns
        -------
        DepthMap
            Metric depth along the optical axis.

        Raises
        ------
        ValueError
            If the values come as integers or none is valid.

        Notes
        -----
        z = r / sqrt(1 + ((x - cx) / f)^2 + ((y - cy) / f)^2), x and y at pixel centres. Taking r
        for z errs by 15 to 18 % at the edge of a phone's picture.

        Examples
        --------
        A wall 2 m in front of the camera, seen 45 degrees to the side:

        >>> from imgscale import Camera, DepthMap
        >>> camera = Camera(1.0, focal_rel_std=0.0, cx=0.5, cy=0.5)
        >>> DepthMap.from_ray_distance([[2.0, 2.0 * 2**0.5]], camera).values
        array([[2., 2.]])
        """
        check_type("camera", camera, Camera)
        _refuse_integers("values", values, "millimetres 1000")
        distance = own_floats("values", values, 2, "(H, W)").astype(np.float64)
        height, width = distance.shape
        _check_not_transposed(camera.image_size, distance.shape)
        size = camera.image_size or (width, height)
        cx = size[0] / 2 if camera.cx is None else camera.cx
        cy = size[1] / 2 if camera.cy is None else camera.cy
        x: FloatArray = (np.arange(width, dtype=np.float64) + 0.5) * (size[0] / width)
        y: FloatArray = (np.arange(height, dtype=np.float64) + 0.5) * (size[1] / height)
        tan_x = (x - cx)[np.newaxis, :] / camera.focal_px
        tan_y = (y - cy)[:, np.newaxis] / camera.focal_px
        return cls(distance / np.sqrt(1 + tan_x**2 + tan_y**2), kind="metric", image_size=size)


@attrs.frozen(eq=False)
class ObjectDepths:
    """
    One depth per detection, for those who have no map.

    Attributes
    ----------
    values : (N,) ndarray of float
        Depth of each detection, in the order of the detections; NaN where it is not known.
        Copied and made read-only.
    kind : str
        What the values are, as in `DepthMap`.
    image_size : (width, height) or None
        Size of the image in pixels. Without it, boxes cut by the image's border are not noticed.
    rel_std : float or None
        Relative standard error of each value, >= 0; None leaves it to `Noise.depth_rel`.

    Raises
    ------
    ValueError
        If a value is infinite or, unless the kind is "affine_inverse", not positive.

    Examples
    --------
    >>> from imgscale import ObjectDepths
    >>> len(ObjectDepths([12.5, float("nan")], kind="metric"))
    2
    >>> ObjectDepths([12.5, 0.0], kind="metric")
    Traceback (most recent call last):
        ...
    ValueError: `values` must be finite and positive, or NaN where unknown; got 0.0 at index 1.
    """

    values: AnyFloatArray = attrs.field(converter=_as_object_depths, repr=array_summary)
    kind: DepthKind = attrs.field(kw_only=True, validator=_check_kind)
    image_size: ImageSize | None = attrs.field(default=None, kw_only=True, converter=as_image_size)
    rel_std: float | None = attrs.field(
        default=None,
        kw_only=True,
        converter=as_optional_float,
        validator=attrs.validators.optional(non_negative),
    )

    def __attrs_post_init__(self) -> None:
        if self.kind == "metric":
            _refuse_integers("values", self.values, _METRIC_SCALES)
        owned = own_object_depths(self.values)
        unlawful = ~(np.isnan(owned) | valid_depths(owned, self.kind))
        if unlawful.any():
            index = int(np.flatnonzero(unlawful)[0])
            law = "finite" if self.kind == "affine_inverse" else "finite and positive"
            msg = (
                f"`values` must be {law}, or NaN where unknown; "
                f"got {float(owned[index])} at index {index}."
            )
            raise ValueError(msg)
        object.__setattr__(self, "values", owned)  # frozen: once, while it is being made

    def __len__(self) -> int:
        return int(self.values.size)


def own_object_depths(values: ArrayLike) -> FloatArray:
    """
    Copy one depth per detection into a read-only array; an empty list is lawful.

    Parameters
    ----------
    values : (N,) array_like of float
        The depths.

    Returns
    -------
    (N,) ndarray of float64
        The copy.
    """
    array = as_array("values", "one depth per detection", values)
    if array.shape == (0,):
        return np.empty(0)
    owned = own_floats("values", array, 1, "(N,), one depth per detection").astype(np.float64)
    owned.flags.writeable = False
    return owned


@attrs.frozen
class GroundPlane:
    """
    No depth at all: objects stand on one plane, and their foot rows tell the distance.

    Attributes
    ----------
    image_size : (width, height)
        Size of the image in pixels.
    horizon_px : float or None
        Row of the horizon, in pixels from the top; may lie outside the image. None: not known.
    horizon_std_px : float or None
        Its standard error, in pixels, >= 0.
    camera_height_m : float or None
        Height of the camera above the plane, in metres, positive. None: not known.
    camera_height_std_m : float or None
        Its standard error, in metres, >= 0.

    Raises
    ------
    ValueError
        If a number breaks its law, or a standard error comes without its value.

    Examples
    --------
    >>> from imgscale import GroundPlane
    >>> GroundPlane(image_size=(1920, 1080)).kind
    'ground_plane'
    """

    image_size: ImageSize = attrs.field(kw_only=True, converter=as_known_image_size)
    horizon_px: float | None = attrs.field(
        default=None,
        kw_only=True,
        converter=as_optional_float,
        validator=attrs.validators.optional(finite),
    )
    horizon_std_px: float | None = attrs.field(
        default=None,
        kw_only=True,
        converter=as_optional_float,
        validator=attrs.validators.optional(non_negative),
    )
    camera_height_m: float | None = attrs.field(
        default=None,
        kw_only=True,
        converter=as_optional_float,
        validator=attrs.validators.optional(positive),
    )
    camera_height_std_m: float | None = attrs.field(
        default=None,
        kw_only=True,
        converter=as_optional_float,
        validator=attrs.validators.optional(non_negative),
    )

    def __attrs_post_init__(self) -> None:
        pairs = (
            ("horizon_px", self.horizon_px, self.horizon_std_px),
            ("camera_height_m", self.camera_height_m, self.camera_height_std_m),
        )
        for name, value, std in pairs:
            if value is None and std is not None:
                msg = f"`{name}` must be given with its standard error; got None +- {std}."
                raise ValueError(msg)

    @property
    def kind(self) -> Literal["ground_plane"]:
        """The kind of depth that this is."""
        return "ground_plane"


Depth: TypeAlias = DepthMap | ObjectDepths | GroundPlane


def check_depth_type(value: object) -> Depth:
    """
    Raise unless a value is one of the depth types.

    Parameters
    ----------
    value : object
        What was given as depth.

    Returns
    -------
    DepthMap, ObjectDepths or GroundPlane
        The same.

    Raises
    ------
    TypeError
        If it is something else, naming the remedy.
    """
    if not isinstance(value, (DepthMap, ObjectDepths, GroundPlane)):
        msg = (
            f"`depth` must be a DepthMap, ObjectDepths or GroundPlane, whose `kind` says what the "
            f"numbers are; got {type(value).__name__}. Wrap one value per detection as "
            "ObjectDepths(values, kind=...), a map as DepthMap(values, kind=...)."
        )
        raise TypeError(msg)
    return value
