"""Converters and validators: each states the law of a value, the value seen and the remedy."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar, cast

import attrs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgscale._reading import cut, quoted
from imgscale._typing import AnyFloatArray, ImageSize

T = TypeVar("T")

_LEAST, _MOST = 1e-100, 1e100  # of a number whose square is taken: it must be a number, too
_MOST_PIXELS = 10**9  # of a side: products of sides are exact, and floats
_LONGEST_TEXT = 1000  # characters of a label: no detector's name is so long, a broken file's may be


@contextmanager
def within(place: object) -> Generator[None]:
    """Put the place, a file or an entry, before the message of an error raised inside."""
    try:
        yield
    except (TypeError, ValueError) as error:
        kind = TypeError if isinstance(error, TypeError) else ValueError
        raise kind(cut(f"{place}: {error}")) from error


def as_float(value: float) -> float:
    """Turn real numbers into `float`; leave anything else for the validator to name."""
    try:
        return float(value) if _is_real(value) else value
    except OverflowError:  # an integer beyond all floats
        return math.inf if value > 0 else -math.inf


def _is_real(value: object) -> bool:
    if isinstance(value, (bool, np.bool_)):
        return False
    return isinstance(value, (int, float, np.integer, np.floating))


def as_optional_float(value: float | None) -> float | None:
    """Apply `as_float` except to None."""
    return None if value is None else as_float(value)


def is_between(value: object, low: float, high: float) -> bool:
    """Tell whether a converted value is a number from `low` to `high`."""
    return isinstance(value, float) and low <= value <= high


def number_error(name: str, law: str, value: object, remedy: str = "") -> Exception:
    """Build the error for a number that breaks its law: TypeError where it is no number."""
    msg = f"`{name}` must be {law}; got {quoted(value)}.{' ' + remedy if remedy else ''}"
    return ValueError(msg) if isinstance(value, float) else TypeError(msg)


def positive_number(name: str, value: float) -> float:
    """Return a number as `float`; raise unless it is finite and above zero."""
    number = as_float(value)
    if not (_is_real(number) and 0 < number < math.inf):
        raise number_error(name, "finite and positive", number)
    return number


def finite_number(name: str, value: float) -> float:
    """Return a number as `float`; raise unless it is finite."""
    number = as_float(value)
    if not (_is_real(number) and math.isfinite(number)):
        raise number_error(name, "finite", number)
    return number


def positive(_: object, attribute: attrs.Attribute[Any], value: float) -> None:
    """Validate a finite number above zero, from 1e-100 to 1e100."""
    positive_number(attribute.name, value)
    if not _LEAST <= value <= _MOST:
        raise number_error(attribute.name, "between 1e-100 and 1e100", value)


def non_negative_number(name: str, value: float) -> float:
    """Return a number as `float`; raise unless it is at or above zero, and at most 1e100."""
    number = as_float(value)
    if not (_is_real(number) and 0 <= number < math.inf):
        raise number_error(name, "finite and not negative", number)
    if number > _MOST:
        raise number_error(name, "at most 1e100", number)
    return number


def non_negative(_: object, attribute: attrs.Attribute[Any], value: float) -> None:
    """Validate a finite number at or above zero, at most 1e100."""
    non_negative_number(attribute.name, value)


def share(_: object, attribute: attrs.Attribute[Any], value: float) -> None:
    """Validate a number from 0 to 1."""
    if not is_between(value, 0, 1):
        raise number_error(attribute.name, "between 0 and 1", value)


def finite(_: object, attribute: attrs.Attribute[Any], value: float) -> None:
    """Validate a finite number, of at most 1e100."""
    finite_number(attribute.name, value)
    if abs(value) > _MOST:
        raise number_error(attribute.name, "between -1e100 and 1e100", value)


def text(_: object, attribute: attrs.Attribute[Any], value: object) -> None:
    """Validate a string that is not blank, of at most 1000 characters."""
    if not isinstance(value, str):
        msg = f"`{attribute.name}` must be a string; got {quoted(value)}."
        raise TypeError(msg)
    if len(value) > _LONGEST_TEXT:
        msg = (
            f"`{attribute.name}` must have at most {_LONGEST_TEXT} characters; got {len(value)}: "
            f"{quoted(value)}."
        )
        raise ValueError(msg)
    if not value.strip():
        msg = f"`{attribute.name}` must not be blank; got {quoted(value)}."
        raise ValueError(msg)


def as_flag(value: bool | np.bool_) -> bool:  # noqa: FBT001 - a converter
    """Turn numpy's truth values into `bool`; leave anything else for the validator to name."""
    return bool(value) if isinstance(value, np.bool_) else value


def nan_as_none(value: float | None) -> float | None:
    """Let two NaN be equal where records are compared."""
    return None if value is None or math.isnan(value) else value


def nans_as_none(values: tuple[float, ...] | None) -> tuple[float | None, ...] | None:
    """Let two rows of numbers be equal where those that are not known are the same."""
    return None if values is None else tuple(nan_as_none(value) for value in values)


def restore(frozen: object, state: tuple[None, dict[str, Any]]) -> None:
    """Fill a frozen object from its pickle or copy, with arrays that are read-only again."""
    for name, value in state[1].items():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False  # which numpy's own copies forget
        object.__setattr__(frozen, name, value)


def true_or_false(_: object, attribute: attrs.Attribute[Any], value: object) -> None:
    """Validate a truth value; words and numbers are not taken for one."""
    if not isinstance(value, bool):
        msg = f"`{attribute.name}` must be True or False; got {quoted(value)}."
        raise TypeError(msg)


def check_type(name: str, value: object, wanted: type[T], remedy: str = "") -> T:
    """Return a value of the type wanted; raise under its name otherwise."""
    if not isinstance(value, wanted):
        msg = f"`{name}` must be a {wanted.__name__}; got {type(value).__name__}.{remedy}"
        raise TypeError(msg)
    return value


def check_iterable(name: str, value: object, item: str) -> None:
    """Raise unless a value can be gone through."""
    if not isinstance(value, Iterable):
        msg = (
            f"`{name}` must be a sequence of {item} objects; got {type(value).__name__}. Put a "
            "single one in a list."
        )
        raise TypeError(msg)


def check_choice(name: str, value: object, allowed: Sequence[str]) -> None:
    """Raise unless `value` is one of `allowed`."""
    if not (isinstance(value, str) and value in allowed):
        listed = ", ".join(f'"{choice}"' for choice in allowed)
        msg = f"`{name}` must be one of {listed}; got {quoted(value)}."
        raise ValueError(msg)


def as_image_size(value: Sequence[int] | None, name: str = "image_size") -> ImageSize | None:
    """Turn (width, height) into a tuple of two positive ints."""
    if value is None:
        return None
    try:
        width, height = value
        real = _is_real(width) and _is_real(height)
        size = (int(width), int(height)) if real else (0, 0)
        lawful = size == (width, height) and 0 < min(size) <= max(size) <= _MOST_PIXELS
    except (TypeError, ValueError, OverflowError):
        lawful = False
        size = (0, 0)
    if not lawful:
        msg = (
            f"`{name}` must be (width, height), two positive whole numbers of pixels, "
            f"at most 1e9; got {quoted(value)}."
        )
        raise ValueError(msg)
    return size


def as_known_image_size(value: Sequence[int]) -> ImageSize:
    """Turn (width, height) into a tuple of two positive ints; None is refused."""
    size = as_image_size(value)
    if size is None:
        msg = "`image_size` must be (width, height); got None."
        raise ValueError(msg)
    return size


def as_array(name: str, law: str, values: ArrayLike) -> NDArray[Any]:
    """Turn nested sequences into an array, or say under its name that they are not one."""
    if _hides_values(values):
        msg = (
            f"`{name}` must be {law}, with no masked entry; got a masked array. Fill it first: "
            "array.filled(value)."
        )
        raise ValueError(msg)
    try:
        return np.asarray(values)
    except ValueError as error:
        msg = f"`{name}` must be {law}; got rows of unequal length."
        raise ValueError(msg) from error


def _hides_values(values: object) -> bool:
    """Tell whether an entry is masked: numpy takes what lies under a mask for a value."""
    if isinstance(values, (list, tuple)):
        items = cast("Sequence[object]", values)
        nested = (list, tuple, np.ma.MaskedArray)
        return any(
            isinstance(item, nested) and _hides_values(cast("object", item)) for item in items
        )
    return bool(np.ma.is_masked(values))


def four_numbers(name: str, law: str, values: ArrayLike) -> tuple[float, float, float, float]:
    """Turn four real numbers into a tuple, or say under its name what they must be."""
    array = as_array(name, law, values)
    listed: list[Any] = list(cast("Any", values)) if isinstance(values, (list, tuple)) else []
    # numpy makes 1 of True where numbers stand beside it
    has_truth = any(isinstance(value, bool) for value in listed)
    if array.shape != (4,) or array.dtype.kind not in "fiu" or has_truth:
        seen = quoted(values) if array.size <= 8 else f"shape {array.shape}"
        msg = f"`{name}` must be {law}; got {seen}."
        raise ValueError(msg)
    a, b, c, d = (float(number) for number in array)
    return (a, b, c, d)


def own_floats(name: str, values: ArrayLike, ndim: int, shape_law: str) -> AnyFloatArray:
    """Copy real values into a read-only array; float dtypes stay, integers become float64."""
    array = as_array(name, f"an array of shape {shape_law}", values)
    if array.dtype.kind not in "fiu":
        msg = (
            f"`{name}` must hold real numbers; got dtype {array.dtype}. NaN stands for an unknown "
            "value."
        )
        raise TypeError(msg)
    if array.ndim != ndim or array.size == 0:
        msg = f"`{name}` must have shape {shape_law} and hold something; got {array.shape}."
        raise ValueError(msg)
    owned: AnyFloatArray = array.astype(array.dtype if array.dtype.kind == "f" else np.float64)
    owned.flags.writeable = False
    return owned


def array_summary(array: NDArray[Any] | None) -> str:
    """Write an array as its shape and dtype, for reprs."""
    return "None" if array is None else f"<{array.shape} {array.dtype}>"
