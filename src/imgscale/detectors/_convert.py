"""What every converter needs: columns of a result, boxes within the picture, errors by place."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Never, cast

import attrs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgscale._checks import as_float, four_numbers, within
from imgscale._tensors import as_numpy
from imgscale._typing import Box, ImageSize
from imgscale.detection import Detection

_SHOWN_KEYS = 5


def column(results: Mapping[str, Any], name: str, key: str, law: str, remedy: str) -> Sequence[Any]:
    """
    Fetch one column of a detector's dict as a list.

    Parameters
    ----------
    results : mapping
        The dict of tensors, arrays or lists.
    name : str
        Its name, for the message.
    key : str
        The column.
    law, remedy : str
        What the dict must have, and what to do where it has not, for the message.

    Returns
    -------
    list
        Its entries.

    Raises
    ------
    ValueError
        If there is no such column.
    """
    values: Any = results.get(key)
    # `tolist` knows every number type, device and gradient
    listed: object = values.tolist() if hasattr(values, "tolist") else values
    got = type(listed).__name__
    is_column = not isinstance(listed, (str, bytes)) and isinstance(listed, Sequence)
    if not is_column:
        msg = f'`{name}` must have {law}; got {list(results)}, "{key}" being {got}. {remedy}'
        raise ValueError(msg)
    return cast("Sequence[Any]", listed)


def has_area_in(xyxy: Sequence[float], image_size: ImageSize) -> bool:
    """
    Tell whether a runner should report a box: models give flat ones, and some beyond the border.

    Parameters
    ----------
    xyxy : (4,) sequence of float
        Corners x1, y1, x2, y2 in pixels.
    image_size : (width, height)
        Size of the picture in pixels.

    Returns
    -------
    bool
        False where it is flat or wholly outside. True for what is no box, inverted or not a
        number: its converter refuses that by its place.
    """
    x1, y1, x2, y2 = xyxy
    width, height = image_size
    is_flat = x1 == x2 or y1 == y2
    is_outside = x2 <= 0 or y2 <= 0 or x1 >= width or y1 >= height
    return not (is_flat or is_outside)


def make_detection(
    place: str,
    label: str,
    xyxy: Sequence[float] | NDArray[Any],
    *,
    image_size: ImageSize | None = None,
    score: float = 1.0,
    mask: ArrayLike | None = None,
    partial: bool = False,
    track_id: int | str | None = None,
    aliases: Sequence[str] = (),
) -> Detection:
    """
    Make a detection of one entry of a detector's output.

    Parameters
    ----------
    place : str
        Where the entry stands, for messages: "result[3]".
    label : str
        What the object is.
    xyxy : (4,) sequence of float
        Its corners in pixels.
    image_size : (width, height), optional
        Where known, the box is cut at the picture's border, and a mask must have its shape.
    score : float
        As for `Detection`.
    mask : (H, W) array_like of bool, optional
        As for `Detection`; one that is empty inside the box, as detectors give now and then, is
        left out.
    partial : bool
        As for `Detection`.
    track_id : int or str, optional
        As for `Detection`.
    aliases : sequence of str
        As for `Detection`.

    Returns
    -------
    Detection
        The detection.

    Raises
    ------
    ValueError, TypeError
        As `Detection` does, naming the place; also for a box wholly outside the picture.
    """
    with within(place):
        box = four_numbers("xyxy", "four numbers (x1, y1, x2, y2)", xyxy)
        made = Detection(
            label, box, score=score, partial=partial, track_id=track_id, aliases=aliases
        )
        inside = box if image_size is None else _clip(box, image_size)
        if inside is None:
            _raise_outside(box, image_size)
        made = made if inside == box else made.with_box(inside)
        return made if mask is None else _with_mask(made, mask, image_size)


def _clip(xyxy: Box, image_size: ImageSize) -> Box | None:
    """Cut a box at the picture's border, as detectors draw a little beyond it; None if outside."""
    x1, y1, x2, y2 = xyxy
    width, height = image_size
    inside = (max(x1, 0.0), max(y1, 0.0), min(x2, float(width)), min(y2, float(height)))
    return inside if inside[0] < inside[2] and inside[1] < inside[3] else None


def _raise_outside(box: Box, image_size: ImageSize | None) -> Never:
    width, height = image_size or (0, 0)
    msg = (
        f"the box must overlap the picture, {width} x {height} px; got {box}. Is it in pixels of "
        "another picture, or of a resized one?"
    )
    raise ValueError(msg)


def _with_mask(made: Detection, mask: ArrayLike, image_size: ImageSize | None) -> Detection:
    """Add the mask, unless it is empty inside the box."""
    pixels = as_numpy(mask)
    if image_size and pixels.shape != image_size[::-1]:
        msg = f"`mask` must have the shape of the picture, {image_size[::-1]}; got {pixels.shape}."
        raise ValueError(msg)
    x1, y1, x2, y2 = made.xyxy
    rows = slice(max(0, math.floor(y1)), max(0, math.ceil(y2)))
    columns = slice(max(0, math.floor(x1)), max(0, math.ceil(x2)))
    is_empty = pixels.ndim == 2 and not pixels[rows, columns].any()
    return made if is_empty else attrs.evolve(made, mask=pixels)


def as_numbers(name: str, values: Any, shape: Sequence[int | str]) -> NDArray[Any]:
    """
    Turn a foreign column into an array of numbers, or say under its name what it must be.

    Parameters
    ----------
    name : str
        Its name, for the message.
    values : tensor, array or list
        The column.
    shape : sequence of int or str
        Its lawful shape; a letter stands for any length.

    Returns
    -------
    ndarray
        The same, of its own number type.

    Raises
    ------
    ValueError
        If it is something else.
    """
    try:
        array = as_numpy(values)
    except ValueError:  # rows of unequal length
        array = np.empty((), dtype=object)
    lengths = zip(array.shape, shape, strict=False)
    if (
        array.ndim != len(shape)
        or array.dtype.kind not in "biuf"
        or any(length != law for length, law in lengths if isinstance(law, int))
        or array.size < len(array)  # entries that hold nothing
    ):
        seen = f"{array.shape} {array.dtype}" if array.ndim else type(values).__name__
        msg = f"`{name}` must have shape ({', '.join(map(str, shape))}), of numbers; got {seen}."
        raise ValueError(msg)
    return array


def whole_number(place: str, name: str, number: Any) -> int:
    """
    Read a number that counts classes or tracks, which some backends give as a float.

    Parameters
    ----------
    place : str
        Where it stands, for the message: "result[3]".
    name : str
        Its name, for the message.
    number : number
        What the backend gives.

    Returns
    -------
    int
        The same.

    Raises
    ------
    ValueError
        If it is not whole.
    """
    value: object = as_float(number)
    if not (isinstance(value, float) and value.is_integer()):
        msg = f"{place}: `{name}` must be a whole number; got {value!r}."
        raise ValueError(msg)
    return int(number)


def known_classes(names: Mapping[Any, str]) -> str:
    """
    Tell which classes have names, for the message that one has none.

    Parameters
    ----------
    names : mapping
        The names by class number.

    Returns
    -------
    str
        The first keys, with a full stop behind them, and what to do where they are strings.
    """
    keys = list(names)
    listed = ", ".join(map(repr, keys[:_SHOWN_KEYS])) or "none"
    more = ", ..." if len(keys) > _SHOWN_KEYS else ""
    remedy = (
        " Keys must be whole numbers: {int(key): name for key, name in names.items()}."
        if any(isinstance(key, str) for key in keys)
        else ""
    )
    return f"{listed}{more}.{remedy}"
