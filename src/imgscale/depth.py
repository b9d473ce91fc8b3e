"""Depth as people have it: a map, one value per object, or a ground plane."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias

import attrs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgscale._checks import (
    array_summary,
    as_array,
    as_image_size,
    as_known_image_size,
    as_optional_float,
    check_choice,
    finite,
    non_negative,
    own_floats,
    positive,
    restore,
)
from imgscale._depth_values import (
    METRIC_SCALES,
    as_given,
    check_kind,
    refuse_integers,
    valid_depths,
)
from imgscale._typing import AnyFloatArray, DepthKind, FloatArray, ImageSize
from imgscale.depth_map import DepthMap

__all__ = ["Depth", "DepthMap", "GroundPlane", "ObjectDepths", "check_depth_type"]


def _as_object_depths(values: ArrayLike) -> NDArray[Any]:
    """Take an array as it comes; numbers typed by hand are metres, be they whole or not."""
    array = as_given(values)
    by_hand = not isinstance(values, np.ndarray) and array.dtype.kind in "iu"
    return array.astype(np.float64) if by_hand else array


def _check_depth_at(_: object, __: attrs.Attribute[Any], value: str) -> None:
    check_choice("depth_at", value, ("surface", "centre"))


@attrs.frozen(eq=False)
class ObjectDepths:
    """
    One depth per detection, for those who have no map. Equal only to itself, as a `DepthMap` is.

    Attributes
    ----------
    values : (N,) ndarray of float
        Depth of each detection, in the order of the detections; NaN where it is not known.
        Copied and made read-only.
    kind : str
        What the values are, as in `DepthMap`.
    image_size : (width, height) or None
        Size of the image in pixels. Without it, boxes cut by the image's border are not noticed.
    depth_at : str
        "surface": the values are those of the visible near surface, as maps give them. "centre":
        they are those of the objects' centres (3-D boxes, tracks, radar); `fit` and `predict` then
        take off half the extent along the view, from the prior's `depth_extent_m` and the shape of
        the box. Only for metric depth.
    rel_std : float or None
        Relative standard error of each value, >= 0, to which a `Noise.depth_rel` that is given adds
        in quadrature; None leaves it to `Noise.depth_rel` alone.

    Raises
    ------
    ValueError
        If a value is infinite or, unless the kind is "affine_inverse", not positive, or if the
        depth of centres is not metric.

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
    kind: DepthKind = attrs.field(kw_only=True, validator=check_kind)
    image_size: ImageSize | None = attrs.field(default=None, kw_only=True, converter=as_image_size)
    rel_std: float | None = attrs.field(
        default=None,
        kw_only=True,
        converter=as_optional_float,
        validator=attrs.validators.optional(non_negative),
    )
    depth_at: Literal["surface", "centre"] = attrs.field(
        default="surface", kw_only=True, validator=_check_depth_at
    )

    def __attrs_post_init__(self) -> None:
        if self.depth_at == "centre" and self.kind != "metric":
            msg = (
                '`depth_at` must be "surface" unless the kind is "metric"; got "centre" with '
                f'"{self.kind}". Metres can only be taken off metres.'
            )
            raise ValueError(msg)
        if self.kind == "metric":
            refuse_integers("values", self.values, METRIC_SCALES)
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

    def __setstate__(self, state: tuple[None, dict[str, Any]]) -> None:
        restore(self, state)

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


_LARGEST_ROLL_DEG = 45.0


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
        Its standard error, in pixels, >= 0; 0.5 % of the longer side where a horizon comes without.
    camera_height_m : float or None
        Height of the camera above the plane, in metres, positive. None: not known.
    camera_height_std_m : float or None
        Its standard error, in metres, >= 0; 2 % where a height comes without it.
    roll_deg : float or None
        Slope of the horizon, in degrees, -45 to 45, by which it falls to the right: the camera's
        roll and the ground's cross-fall together. None: not known, 0 within 2 degrees.
    roll_std_deg : float or None
        Its standard error, in degrees, >= 0; 0.5 where a roll comes without it.

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

    roll_deg: float | None = attrs.field(
        default=None,
        kw_only=True,
        converter=as_optional_float,
        validator=attrs.validators.optional(finite),
    )
    roll_std_deg: float | None = attrs.field(
        default=None,
        kw_only=True,
        converter=as_optional_float,
        validator=attrs.validators.optional(non_negative),
    )

    def __attrs_post_init__(self) -> None:
        if self.roll_deg is not None and abs(self.roll_deg) > _LARGEST_ROLL_DEG:
            msg = f"`roll_deg` must be between -45 and 45; got {self.roll_deg}."
            raise ValueError(msg)
        pairs = (
            ("horizon_px", self.horizon_px, self.horizon_std_px),
            ("camera_height_m", self.camera_height_m, self.camera_height_std_m),
            ("roll_deg", self.roll_deg, self.roll_std_deg),
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
