"""
Detections out of KITTI's label files and of results in their format.

A line is ``type truncated occluded alpha x1 y1 x2 y2 height width length x y z rotation_y``;
results have a score behind it. Coordinates stay as they are. Labels have pixel centres at whole
numbers, half a pixel less than the package's own: `imgscale.datasets.kitti` adds it, here nothing
does, as results follow whatever their detector follows. The 2-D boxes of labels are projections of
3-D boxes: they are continuous, ``y2 - y1`` pixels high, and amodal. They outline the whole of an
object that another one hides in part, but end at the picture's border.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from os import PathLike

import attrs

from imgscale._checks import as_float, as_image_size, check_type, is_between, nan_as_none, within
from imgscale._reading import MAX_BYTES, in_file, read_text
from imgscale._typing import ImageSize
from imgscale.detection import Detection
from imgscale.detectors._convert import make_detection
from imgscale.detectors._files import finite_word

__all__ = ["KittiObject", "from_kitti", "objects_from_kitti", "read_kitti"]

_COLUMNS = (
    *("type", "truncated", "occluded", "alpha", "x1", "y1", "x2", "y2"),
    *("height", "width", "length", "x", "y", "z", "rotation_y"),
)
_NO_OBJECT = "DontCare"
# What stands where a result does not tell a number.
_UNKNOWN = {"truncated": -1.0, "alpha": -10.0, "rotation_y": -10.0}
_UNKNOWN_SIZE, _UNKNOWN_PLACE = -1.0, -1000.0
_UNKNOWN_LOCATION = (math.nan, math.nan, math.nan)
_LOGISTIC = "0.5 * (1 + math.tanh(score / 2))"  # for messages: it cannot overflow
# Visible, partly occluded, largely occluded, unknown.
_OCCLUSIONS = (0, 1, 2, 3)
_HIDDEN_FROM = 2


def _tuple_key(values: tuple[float, ...]) -> tuple[float | None, ...]:
    return tuple(nan_as_none(value) for value in values)


@attrs.frozen(kw_only=True)
class KittiObject:
    """
    One object of a KITTI file: its box in the picture and in space.

    Lengths are in metres in the rectified frame of camera 0: x right, y down, z ahead. NaN where a
    result file does not tell.

    Attributes
    ----------
    detection : Detection
        Label, 2-D box, score and whether it is partial.
    height_m, width_m, length_m : float
        Size of the object, positive or NaN.
    location : tuple of float
        The middle of its bottom face, x, y, z.
    rotation_y : float
        Its turn about the vertical, in radians; 0 where its length lies along x.
    truncated : float
        Share that lies outside the picture, 0 to 1.
    occluded : int or None
        0 visible, 1 partly and 2 largely occluded, 3 unknown; None where the file does not tell.
    alpha : float
        Observation angle in radians.

    Examples
    --------
    >>> from imgscale.detectors.kitti import objects_from_kitti
    >>> line = "Car 0 0 1.9 388 182 424 203 1.67 1.87 3.69 -16.5 2.4 58.5 1.57"
    >>> [car] = objects_from_kitti(line)
    >>> car.detection.label, car.height_m, round(car.surface_depth_m(), 2)
    ('Car', 1.67, 56.65)
    """

    detection: Detection
    height_m: float = attrs.field(eq=nan_as_none)
    width_m: float = attrs.field(eq=nan_as_none)
    length_m: float = attrs.field(eq=nan_as_none)
    location: tuple[float, float, float] = attrs.field(eq=_tuple_key)
    rotation_y: float = attrs.field(eq=nan_as_none)
    truncated: float = attrs.field(eq=nan_as_none)
    occluded: int | None
    alpha: float = attrs.field(eq=nan_as_none)

    def surface_depth_m(self, tz: float = 0.0) -> float:
        """
        Tell the z-depth of the nearest corner: of the near face, which the 2-D box outlines.

        Parameters
        ----------
        tz : float
            What z in the camera has over z in camera 0, in metres: P2[2, 3] for camera 2, some mm.

        Returns
        -------
        float
            ``z + tz - (length |sin rotation_y| + width |cos rotation_y|) / 2``; NaN where that is
            not known or not ahead of the camera.
        """
        sine, cosine = abs(math.sin(self.rotation_y)), abs(math.cos(self.rotation_y))
        nearest = self.location[2] + tz - (self.length_m * sine + self.width_m * cosine) / 2
        return nearest if nearest > 0 else math.nan


def read_kitti(
    path: str | PathLike[str],
    *,
    image_size: Sequence[int] | None = None,
    to_score: Callable[[float], float] | None = None,
    max_bytes: int = MAX_BYTES,
) -> list[Detection]:
    """
    Read a KITTI label or result file.

    Parameters
    ----------
    path : str or path-like
        The file.
    image_size : (width, height), optional
        As for `from_kitti`.
    to_score : callable, optional
        As for `from_kitti`.
    max_bytes : int
        Greatest length of the file.

    Returns
    -------
    list of Detection
        As `from_kitti` gives it.

    Raises
    ------
    FileError
        If the file is not text in UTF-8, longer than `max_bytes`, or holds what `from_kitti`
        refuses; the message names the file.
    ValueError
        If an argument breaks its law.
    OSError
        If the file cannot be opened.
    """
    as_image_size(image_size)
    with in_file(path):
        text = read_text(path, max_bytes)
        return from_kitti(text, image_size=image_size, to_score=to_score)


def from_kitti(
    text: str,
    *,
    image_size: Sequence[int] | None = None,
    to_score: Callable[[float], float] | None = None,
) -> list[Detection]:
    """
    Turn the text of a KITTI label or result file into detections.

    Parameters
    ----------
    text : str
        What the file holds. "DontCare" lines are regions without labels, not objects: left out.
    image_size : (width, height), optional
        Where given, boxes are cut at the picture's border.
    to_score : callable, optional
        Maps the score of a result to 0 to 1, for files whose scores are no probabilities: KITTI
        allows any number. Logits take ``lambda score: 0.5 * (1 + math.tanh(score / 2))``.

    Returns
    -------
    list of Detection
        One per object, in the order of the file. `partial` where the object is truncated, largely
        occluded (2) or its occlusion unknown (3); not where the file does not tell (-1).
        A "Pedestrian" has the alias "person".

    Raises
    ------
    ValueError
        If a line is no line of KITTI, a box lies wholly outside the picture or `to_score` fails;
        the message names the line.
    TypeError
        If `text` is no string.

    Examples
    --------
    >>> from imgscale.detectors.kitti import from_kitti
    >>> [found] = from_kitti("Car -1 -1 -10 388 182 424 203 -1 -1 -1 -1000 -1000 -1000 -10 0.98")
    >>> found.label, found.xyxy, found.score, found.partial
    ('Car', (388.0, 182.0, 424.0, 203.0), 0.98, False)
    >>> from_kitti("Car 388 182 424 203")
    Traceback (most recent call last):
        ...
    ValueError: line 1: a label must have 15 columns, a result 16; got 5.
    """
    objects = objects_from_kitti(text, image_size=image_size, to_score=to_score)
    return [one.detection for one in objects]


def objects_from_kitti(
    text: str,
    *,
    image_size: Sequence[int] | None = None,
    to_score: Callable[[float], float] | None = None,
) -> list[KittiObject]:
    """
    Turn the text of a KITTI label or result file into objects with their boxes in space.

    Parameters
    ----------
    text : str
        What the file holds.
    image_size : (width, height), optional
        As for `from_kitti`.
    to_score : callable, optional
        As for `from_kitti`.

    Returns
    -------
    list of KittiObject
        One per object, in the order of the file.

    Raises
    ------
    ValueError, TypeError
        As `from_kitti` does.
    """
    lines = check_type("text", text, str, " Read the file with read_kitti().").splitlines()
    size = as_image_size(image_size)
    rows = [(f"line {number}", line.split()) for number, line in enumerate(lines, start=1)]
    for place, words in rows:
        with within(place):
            _check_columns(words)
    return [
        _object(place, words, size, to_score)
        for place, words in rows
        if words and words[0] != _NO_OBJECT
    ]


def _check_columns(words: list[str]) -> None:
    if len(words) in {0, 15, 16}:
        return
    remedy = " Tracking labels have frame and track in front: leave those out."
    msg = (
        f"a label must have 15 columns, a result 16; got {len(words)}."
        f"{remedy if len(words) > 16 else ''}"
    )
    raise ValueError(msg)


def _object(
    place: str,
    words: list[str],
    image_size: ImageSize | None,
    to_score: Callable[[float], float] | None,
) -> KittiObject:
    with within(place):
        row = {name: finite_word(name, word) for name, word in zip(_COLUMNS[1:], words[1:15])}  # noqa: B905 - 16 columns of results
        score = _score(words[15], to_score) if len(words) > 15 else 1.0
        height, width, length = (_size(row, name) for name in ("height", "width", "length"))
        truncated = _told(row, "truncated", 0, 1)
        alpha, turn = (_told(row, name, -math.tau, math.tau) for name in ("alpha", "rotation_y"))
        occluded = _occlusion(row["occluded"])
    location = (row["x"], row["y"], row["z"])
    detection = make_detection(
        place,
        words[0],
        (row["x1"], row["y1"], row["x2"], row["y2"]),
        image_size=image_size,
        score=score,
        partial=truncated > 0 or (occluded or 0) >= _HIDDEN_FROM,
        aliases=("person",) if words[0] == "Pedestrian" else (),
    )
    return KittiObject(
        detection=detection,
        height_m=height,
        width_m=width,
        length_m=length,
        location=_UNKNOWN_LOCATION if _UNKNOWN_PLACE in location else location,
        rotation_y=turn,
        truncated=truncated,
        occluded=occluded,
        alpha=alpha,
    )


def _told(row: dict[str, float], name: str, low: float, high: float) -> float:
    """Give a number in its range, NaN for the one that means that it is not told."""
    value = row[name]
    if value == _UNKNOWN[name]:
        return math.nan
    if not low <= value <= high:
        unknown = _UNKNOWN[name]
        msg = (
            f"{name} must be between {low:g} and {high:g}, or {unknown:g} where it is not known; "
            f"got {value:g}."
        )
        raise ValueError(msg)
    return value


def _size(row: dict[str, float], name: str) -> float:
    value = row[name]
    if value == _UNKNOWN_SIZE:
        return math.nan
    if value <= 0:
        msg = f"{name} must be positive, or -1 where it is not known; got {value:g}."
        raise ValueError(msg)
    return value


def _occlusion(value: float) -> int | None:
    if value == -1:
        return None
    if value not in _OCCLUSIONS:
        msg = f"occluded must be 0, 1, 2, 3, or -1 where it is not told; got {value:g}."
        raise ValueError(msg)
    return int(value)


def _score(word: str, to_score: Callable[[float], float] | None) -> float:
    given = finite_word("score", word)
    if to_score is None:
        score, remedy = given, f"Pass `to_score`, a function that maps it: logits by {_LOGISTIC}."
    else:
        score, remedy = _mapped(given, to_score), f"`to_score` made that of {given:g}."
    if not is_between(score, 0, 1):
        msg = f"the score must be a number between 0 and 1; got {score!r}. {remedy}"
        raise ValueError(msg)
    return score


def _mapped(given: float, to_score: Callable[[float], float]) -> float:
    try:
        return as_float(to_score(given))
    except (ArithmeticError, TypeError, ValueError) as error:
        msg = (
            f"`to_score` must return a number between 0 and 1 for {given:g}; it failed: {error}. "
            f"{_LOGISTIC} maps logits without overflow."
        )
        raise ValueError(msg) from error
