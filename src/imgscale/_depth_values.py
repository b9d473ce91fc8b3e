"""What depth values must be, whatever holds them."""

from __future__ import annotations

import math
from typing import Any, cast

import attrs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgscale._checks import as_array, check_choice
from imgscale._typing import AnyFloatArray, BoolArray, DepthKind, ImageSize

VALUE_KINDS: tuple[DepthKind, ...] = ("metric", "relative", "inverse", "affine_inverse")
_SAME_SHAPE = 0.05  # two shapes are each other's turned by 90 degrees to 5 %
METRIC_SCALES = "KITTI 256, millimetres 1000, TUM 5000"


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


def refuse_integers(name: str, values: ArrayLike, scales: str) -> None:
    """Raise where values come as a file stores them."""
    if isinstance(values, np.ma.MaskedArray):
        values = as_given(cast("Any", values))
    dtype = as_array(name, "an array of numbers", values).dtype
    if dtype.kind in "iu":
        msg = (
            f"`{name}` must be floating point; got dtype {dtype}, as files store scaled depth. "
            f"Divide by the file's scale first: {scales}."
        )
        raise ValueError(msg)


def as_given(values: ArrayLike) -> NDArray[Any]:
    """Take the values as they come; they are checked and copied where their kind is known."""
    if isinstance(values, np.ma.MaskedArray):
        masked: Any = cast("Any", values)
        missing = np.nan if masked.dtype.kind == "f" else 0
        return np.asarray(masked.filled(missing))
    return as_array("values", "an array of numbers", values)


def check_not_transposed(image_size: ImageSize | None, shape: tuple[int, ...]) -> None:
    """Raise where a map's (height, width) was given as (width, height), or it lies on its side."""
    if image_size is None or shape[0] == shape[1]:
        return
    if image_size == shape:
        msg = (
            f"`image_size` must be (width, height); got {image_size}, which is the map's (height, "
            f"width). Pass {image_size[::-1]}, or transpose the map: values.T."
        )
        raise ValueError(msg)
    turned = (image_size[0] > image_size[1]) != (shape[1] > shape[0])
    if (
        turned
        and abs(math.log(image_size[0] * shape[1] / (image_size[1] * shape[0]))) < _SAME_SHAPE
    ):
        msg = (
            f"`values` must be as upright as the image, {image_size[0]} x {image_size[1]}; got a "
            f"map of {shape[1]} x {shape[0]}, which lies on its side. Apply the EXIF orientation "
            "to the picture before its depth is made, or give `image_size` as (width, height)."
        )
        raise ValueError(msg)


def check_kind(_: object, __: attrs.Attribute[Any], value: str) -> None:
    """Validate a kind of depth values."""
    check_choice("kind", value, VALUE_KINDS)
