"""A depth value for every pixel; its kind declared."""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from functools import cached_property
from typing import Any, Literal

import attrs
import numpy as np
from numpy.typing import ArrayLike

from imgscale._checks import (
    array_summary,
    as_float,
    as_image_size,
    check_choice,
    check_type,
    finite_number,
    non_negative,
    own_floats,
    positive_number,
    restore,
)
from imgscale._depth_values import (
    METRIC_SCALES,
    as_given,
    check_kind,
    check_not_transposed,
    refuse_integers,
    valid_depths,
)
from imgscale._typing import AnyFloatArray, DepthKind, FloatArray, ImageSize
from imgscale.camera import Camera

__all__ = ["DepthMap"]

_FINGERPRINT_SAMPLES = 4096


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

    Any other value (NaN, inf, 0, negative) means that the pixel has no depth. Maps are equal only
    to themselves.

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

    values: AnyFloatArray = attrs.field(converter=as_given, repr=array_summary)
    kind: DepthKind = attrs.field(kw_only=True, validator=check_kind)
    _image_size: ImageSize | None = attrs.field(
        default=None, kw_only=True, converter=as_image_size, alias="image_size"
    )
    scale_rel_std: float = attrs.field(
        default=0.0, kw_only=True, converter=as_float, validator=non_negative
    )

    def __attrs_post_init__(self) -> None:
        if self.kind == "metric":
            refuse_integers("values", self.values, METRIC_SCALES)
        owned = own_floats("values", self.values, 2, "(H, W)")
        check_not_transposed(self._image_size, owned.shape)
        object.__setattr__(self, "values", owned)  # frozen: once, while it is being made
        if not self._holds_depth():
            law = "finite" if self.kind == "affine_inverse" else "finite, positive"
            msg = (
                f'`values` must hold a {law} number; got none, so this "{self.kind}" map is empty.'
            )
            raise ValueError(msg)

    def __setstate__(self, state: tuple[None, dict[str, Any]]) -> None:
        restore(self, state)

    def _holds_depth(self) -> bool:
        high = self._extremes[1]
        if math.isfinite(high) and (high > 0 or self.kind == "affine_inverse"):
            return True  # as it is with all maps but those with infinite values
        return bool(valid_depths(self.values, self.kind).any())

    @property
    def image_size(self) -> ImageSize:
        """Size (width, height) of the image that boxes refer to, in pixels."""
        height, width = self.values.shape
        return self._image_size or (width, height)

    @property
    def valid_range(self) -> tuple[float, float]:
        """Smallest and largest depth value of the map, in its unit."""
        return self._extremes if self.gaps_are_nan else self._valid_range

    @property
    def gaps_are_nan(self) -> bool:
        """True where every pixel without a depth is NaN, none 0, negative or infinite."""
        low, high = self._extremes
        return high < math.inf and low > (-math.inf if self.kind == "affine_inverse" else 0)

    @property
    def fingerprint(self) -> int:
        """Checksum of the shape and some thousand values: tells two maps apart cheaply."""
        return self._fingerprint

    # What does not change is found once: a map of 4K takes milliseconds to go through.

    @cached_property
    def _extremes(self) -> tuple[float, float]:
        low = np.fmin.reduce(self.values, axis=None)
        return float(low), float(np.fmax.reduce(self.values, axis=None))

    @cached_property
    def _valid_range(self) -> tuple[float, float]:
        seen = self.values[valid_depths(self.values, self.kind)]
        return float(seen.min()), float(seen.max())

    @cached_property
    def _fingerprint(self) -> int:
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
        scale_rel_std: float = 0.0,
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
        scale_rel_std : float
            Relative standard error of focal length times baseline, >= 0.

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
        refuse_integers("disparity", disparity, "KITTI 256, OpenCV's SGBM 16")
        pixels = own_floats("disparity", as_given(disparity), 2, "(H, W)").astype(np.float64)
        shifted = pixels + doffs
        with np.errstate(invalid="ignore"):
            seen = np.isfinite(pixels) & (pixels > 0) & (shifted > 0)
        depth = np.full(pixels.shape, np.nan)
        depth[seen] = focal * baseline / shifted[seen]
        return cls(depth, kind="metric", image_size=image_size, scale_rel_std=scale_rel_std)

    @classmethod
    def from_ray_distance(
        cls,
        values: ArrayLike,
        camera: Camera,
        *,
        kind: Literal["metric", "relative"] = "metric",
        scale_rel_std: float = 0.0,
    ) -> DepthMap:
        """
        Turn distances along each pixel's ray into z-depth.

        Parameters
        ----------
        values : (H, W) array_like of float
            Euclidean distances from the camera, in metres or up to a factor; missing where not
            finite or <= 0.
        camera : Camera
            Focal length and principal point, in pixels of `camera.image_size`, or of the map
            where that is None.
        kind : str
            "metric", or "relative" where the distances are known up to a factor.
        scale_rel_std : float
            Relative standard error of their scale as a whole, >= 0.

        Returns
        -------
        DepthMap
            Depth along the optical axis.

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
        check_choice("kind", kind, ("metric", "relative"))
        if kind == "metric":
            refuse_integers("values", values, "millimetres 1000")
        distance = own_floats("values", as_given(values), 2, "(H, W)").astype(np.float64)
        height, width = distance.shape
        check_not_transposed(camera.image_size, distance.shape)
        size = camera.image_size or (width, height)
        cx = size[0] / 2 if camera.cx is None else camera.cx
        cy = size[1] / 2 if camera.cy is None else camera.cy
        x: FloatArray = (np.arange(width, dtype=np.float64) + 0.5) * (size[0] / width)
        y: FloatArray = (np.arange(height, dtype=np.float64) + 0.5) * (size[1] / height)
        tan_x = (x - cx)[np.newaxis, :] / camera.focal_px
        tan_y = (y - cy)[:, np.newaxis] / camera.focal_px
        z = distance / np.sqrt(1 + tan_x**2 + tan_y**2)
        return cls(z, kind=kind, image_size=size, scale_rel_std=scale_rel_std)
