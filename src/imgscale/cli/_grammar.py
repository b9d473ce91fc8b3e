"""
The small grammars of the command line: sizes, references, boxes.

    reference   LABEL=SIZE[+-ERROR][ AXIS]       pole=1.0   pole=100cm+-2mm   plate=52cm width
    size        NUMBER[UNIT], or feet and inches: 6ft 2in; metres without a unit
    error       as the size, or a percentage:     door=2.03+-0.5%
    box         LABEL=X1,Y1,X2,Y2                statue=100,60,190,330

What could be read in two ways is refused: decimal commas, a unit on one of size and error alone,
a number that is more likely centimetres.
"""

from __future__ import annotations

import re
from argparse import ArgumentTypeError
from typing import cast

from imgscale._format import PER_METRE
from imgscale._typing import SizeAxis
from imgscale.detection import Detection
from imgscale.object_prior import SIZE_AXES, ObjectPrior

# As a steel tape, with how it is held and read.
DEFAULT_REL_STD = 0.005
# More metres than that without a unit are rather centimetres or millimetres.
_MOST_BARE_METRES = 20.0

_NUMBER = r"(?:\d+(?:\.\d*)?|\.\d+)"
_UNITS = "|".join(sorted(PER_METRE, key=len, reverse=True))
_LENGTH = re.compile(rf"({_NUMBER})\s*({_UNITS})?")
_FEET_AND_INCHES = re.compile(rf"({_NUMBER})\s*ft\s*({_NUMBER})\s*in")
_PERCENT = re.compile(rf"({_NUMBER})\s*%")


def reference(text: str) -> ObjectPrior:
    """Read ``LABEL=SIZE[+-ERROR][ AXIS]``."""
    label, words = _labelled(text, "LABEL=SIZE, as in pole=1.0")
    words, axis = _without_axis(words)
    size_text, *error_texts = [part.strip() for part in re.split(r"\+-|\+/-|±", words)]
    if len(error_texts) > 1:
        msg = f"must have one error; got {text!r}"
        raise ArgumentTypeError(msg)
    size, unit = _length(size_text, text)
    if unit is None and size > _MOST_BARE_METRES:
        msg = (
            f"must say the unit of {size:g}, which would be metres: {label}={size:g}cm, or "
            f"{label}={size:g}m"
        )
        raise ArgumentTypeError(msg)
    std = size * DEFAULT_REL_STD if not error_texts else _error(error_texts[0], size, unit, text)
    try:
        return ObjectPrior(
            label, size, 0.0, mean_std_m=std, axis=axis, source=f"--reference {text}"
        )
    except ValueError as error:
        raise ArgumentTypeError(str(error).replace("`mean_m`", "the size")) from error


def box(text: str) -> Detection:
    """Read ``LABEL=X1,Y1,X2,Y2``."""
    label, words = _labelled(text, "LABEL=X1,Y1,X2,Y2, as in statue=100,60,190,330")
    numbers = [part.strip() for part in words.split(",")]
    if len(numbers) != 4 or not all(re.fullmatch(rf"-?{_NUMBER}", part) for part in numbers):
        msg = (
            "must be LABEL=X1,Y1,X2,Y2, four numbers of pixels with points for decimals; got "
            f"{text!r}"
        )
        raise ArgumentTypeError(msg)
    x1, y1, x2, y2 = (float(part) for part in numbers)
    if not (x1 < x2 and y1 < y2):
        msg = (
            f"must have X1 below X2 and Y1 below Y2: two corners, no width and height; got {text!r}"
        )
        raise ArgumentTypeError(msg)
    return Detection(label, (x1, y1, x2, y2))


def _labelled(text: str, law: str) -> tuple[str, str]:
    """Part a label from what is said of it: at the last "=", as sizes have none."""
    label, sign, rest = (part.strip() for part in text.rpartition("="))
    if not (sign and label and rest):
        msg = f"must be {law}; got {text!r}"
        raise ArgumentTypeError(msg)
    return label, rest


def _without_axis(words: str) -> tuple[str, SizeAxis]:
    """Take the axis from the end; a height is meant without one."""
    for axis in SIZE_AXES:
        rest = words.removesuffix(axis)
        if rest != words and rest[-1:].isspace():
            return rest.strip(), axis
    return words, "height"


def _length(words: str, text: str) -> tuple[float, str | None]:
    """Read a length in metres, and the unit that it was given in."""
    if "," in words:
        msg = f"must have a point for decimals, and no thousands' separators; got {text!r}"
        raise ArgumentTypeError(msg)
    if feet := _FEET_AND_INCHES.fullmatch(words):
        return float(feet[1]) / PER_METRE["ft"] + float(feet[2]) / PER_METRE["in"], "ft"
    if (found := _LENGTH.fullmatch(words)) is None:
        msg = (
            f"must be LABEL=SIZE[UNIT][+-ERROR[UNIT]][ AXIS], with a unit of {', '.join(PER_METRE)}"
            f" and an axis of {', '.join(SIZE_AXES)}; got {text!r}"
        )
        raise ArgumentTypeError(msg)
    return float(found[1]) / PER_METRE[found[2] or "m"], cast("str | None", found[2])


def _error(words: str, size: float, unit: str | None, text: str) -> float:
    """Read the error of a size, in metres."""
    if found := _PERCENT.fullmatch(words):
        error = size * float(found[1]) / 100
    else:
        error, own_unit = _length(words, text)
        if (own_unit is None) != (unit is None):
            msg = f"must have a unit on size and error, or on none; got {text!r}"
            raise ArgumentTypeError(msg)
    if error >= size:
        msg = f"must have an error below the size; got {text!r}"
        raise ArgumentTypeError(msg)
    return error
