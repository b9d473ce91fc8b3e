"""What files of detections need: members of JSON, numbers of text, masks out of polygons."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeGuard, cast

from numpy.typing import NDArray

from imgscale._checks import as_known_image_size
from imgscale._reading import cut, number_of, quoted
from imgscale._typing import BoolArray, ImageSize


def as_table(name: str, value: Any) -> Mapping[str, Any]:
    """Return a JSON object; raise under its name where it is something else."""
    if not isinstance(value, Mapping):
        msg = f"`{name}` must be a mapping (an object in JSON); got {_seen(value)}."
        raise TypeError(msg)
    return cast("Mapping[str, Any]", value)


def member(entry: Any, name: str) -> Any:
    """Take one member of a JSON object."""
    known = as_table("entry", entry)
    if name not in known:
        listed = ", ".join(f"`{key}`" for key in known) or "nothing"
        msg = cut(f"`{name}` must be there; got {listed}.")
        raise ValueError(msg)
    return known[name]


def members(entry: Any, name: str) -> Sequence[Any]:
    """Take a member that is a list."""
    return as_list(name, member(entry, name))


def as_list(name: str, value: object) -> Sequence[Any]:
    """Return a list; raise under its name where it is something else."""
    if not _is_list(value):
        msg = f"`{name}` must be a list; got {_seen(value)}."
        raise TypeError(msg)
    return value


def _is_list(value: object) -> TypeGuard[Sequence[Any]]:
    return isinstance(value, Sequence) and not isinstance(value, (str, bytes))


def identity(entry: Any, name: str) -> int | str:
    """Take a member that names something: a whole number or a string."""
    value = member(entry, name)
    if isinstance(value, bool) or not isinstance(value, (int, str)):
        msg = f"`{name}` must be a whole number or a string; got {_seen(value)}."
        raise TypeError(msg)
    return value


def told_size(entry: Mapping[str, Any]) -> ImageSize | None:
    """Take `width` and `height` of a picture; None where they are absent or not positive."""
    size: tuple[Any, Any] = (entry.get("width"), entry.get("height"))
    return None if any(map(_is_unknown, size)) else as_known_image_size(size)


def _is_unknown(length: Any) -> bool:
    """Files write 0 or -1 for a size that nobody looked up."""
    return length is None or (isinstance(length, (int, float)) and length <= 0)


def _seen(value: object) -> str:
    return quoted(value) if isinstance(value, (str, int, float)) else type(value).__name__


def finite_word(name: str, word: str) -> float:
    """Read a finite number out of text; raise under its name where it is none."""
    number = number_of(word)
    if not math.isfinite(number):
        msg = f"{name} must be a finite number; got {quoted(word)}."
        raise ValueError(msg)
    return number


def polygon_mask(points: NDArray[Any], image_size: ImageSize) -> BoolArray:
    """
    Fill a polygon, by the even-odd rule.

    Parameters
    ----------
    points : (N, 2) ndarray of float
        Corners x, y in pixels, N at least 3.
    image_size : (width, height)
        Size of the picture.

    Returns
    -------
    (height, width) ndarray of bool
        True on the pixels whose centre, half a pixel from their corner, is inside.
    """
    import skimage as ski  # noqa: PLC0415 - loads its parts on use

    width, height = image_size
    draw: Any = ski.draw  # untyped
    mask: BoolArray = draw.polygon2mask((height, width), points[:, ::-1] - 0.5)
    return mask
