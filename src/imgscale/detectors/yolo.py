"""
Detections from YOLO's text files: one picture, one line per object.

A line is the class and the box's centre x, y, width and height as ratios of the picture's size,
and the confidence where a detector wrote it: ``class x y w h [confidence]``. Segmentations and
oriented boxes are polygons instead: ``class x1 y1 x2 y2 ... [confidence]``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike

import numpy as np

from imgscale._checks import as_known_image_size, check_iterable, check_type, within
from imgscale._reading import MAX_BYTES, in_file, number_of, quoted, read_text
from imgscale._typing import BoolArray, Box, FloatArray, ImageSize
from imgscale.detection import Detection
from imgscale.detectors._convert import known_classes, make_detection
from imgscale.detectors._files import polygon_mask

__all__ = ["from_yolo", "read_yolo"]

# Detectors draw a little beyond the border.
_OVERHANG = 0.05


def read_yolo(
    path: str | PathLike[str],
    *,
    image_size: Sequence[int],
    class_names: Sequence[str] | Mapping[int, str],
    polygons: bool = False,
    max_bytes: int = MAX_BYTES,
) -> list[Detection]:
    """
    Read a YOLO text file.

    Parameters
    ----------
    path : str or path-like
        The file.
    image_size : (width, height)
        As for `from_yolo`.
    class_names : sequence of str, or mapping of int to str
        As for `from_yolo`.
    polygons : bool
        As for `from_yolo`.
    max_bytes : int
        Greatest length of the file.

    Returns
    -------
    list of Detection
        As `from_yolo` gives it.

    Raises
    ------
    FileError
        If the file is not text in UTF-8, longer than `max_bytes`, or holds what `from_yolo`
        refuses; the message names the file.
    ValueError, TypeError
        If an argument breaks its law.
    OSError
        If the file cannot be opened. Some tools write none for a picture without objects.
    """
    size, names = as_known_image_size(image_size), _names(class_names)
    with in_file(path):
        text = read_text(path, max_bytes)
        return from_yolo(text, image_size=size, class_names=names, polygons=polygons)


def from_yolo(
    text: str,
    *,
    image_size: Sequence[int],
    class_names: Sequence[str] | Mapping[int, str],
    polygons: bool = False,
) -> list[Detection]:
    """
    Convert the text of a YOLO file.

    Parameters
    ----------
    text : str
        The lines. Empty ones are passed over.
    image_size : (width, height)
        Size of the picture in pixels.
    class_names : sequence of str, or mapping of int to str
        The name of every class, by its number, as in the data set's YAML file.
    polygons : bool
        Whether lines of more than six numbers are polygons. They are not told from keypoints or
        track ids by their length, so such lines are an error without it.

    Returns
    -------
    list of Detection
        One per line, in order, score 1 where there is no confidence. A polygon gives its bounding
        box and a mask, none where it is too small to hold the centre of a pixel. Boxes are cut at
        the picture's border.

    Raises
    ------
    ValueError
        If a line has other than the right count of numbers, a number is no ratio (more than 5 %
        outside 0 to 1), the class has no name, or a box is empty or wholly outside the picture.
        The message names the line.
    TypeError
        If an argument has another type.

    Examples
    --------
    >>> from imgscale.detectors.yolo import from_yolo
    >>> [car] = from_yolo("0 0.5 0.5 0.25 0.5 0.9", image_size=(640, 480), class_names=["car"])
    >>> car.xyxy, car.score
    ((240.0, 120.0, 400.0, 360.0), 0.9)
    """
    lines = check_type("text", text, str, " Read the file with read_yolo().").splitlines()
    size = as_known_image_size(image_size)
    names = _names(class_names)
    return [
        _detection(f"line {number}", line.split(), size, names, polygons=polygons)
        for number, line in enumerate(lines, start=1)
        if line.strip()
    ]


def _names(class_names: Sequence[str] | Mapping[int, str]) -> dict[int, str]:
    if isinstance(class_names, Mapping):
        return dict(class_names)
    if isinstance(class_names, str):
        msg = f"`class_names` must be a list of names; got the string {class_names!r}."
        raise TypeError(msg)
    check_iterable("class_names", class_names, "str")
    return dict(enumerate(class_names))


def _detection(
    place: str, words: list[str], size: ImageSize, names: Mapping[int, str], *, polygons: bool
) -> Detection:
    with within(place):
        label = _label(words[0], names)
        numbers = _numbers(words[1:])
        mask: BoolArray | None = None
        if len(numbers) in {4, 5}:
            box, score = _box(numbers[:4], size), numbers[4:]
        elif polygons and len(numbers) >= 6:
            corners = len(numbers) // 2 * 2
            box, mask = _outline(numbers[:corners], size)
            score = numbers[corners:]
        else:
            raise ValueError(_wrong_count(len(words), polygons=polygons))
    return make_detection(
        place, label, box, image_size=size, score=float(score[0]) if score.size else 1.0, mask=mask
    )


def _label(word: str, names: Mapping[int, str]) -> str:
    number = number_of(word)
    if number not in names:
        msg = (
            f"the class must be a number with a name in `class_names`; got {quoted(word)} and "
            f"names for {known_classes(names)}"
        )
        raise ValueError(msg)
    return names[int(number)]


def _numbers(words: Sequence[str]) -> FloatArray:
    """Read ratios of the picture's size, and perhaps a confidence."""
    numbers = np.array([number_of(word) for word in words], dtype=np.float64)
    if np.isnan(numbers).any():
        msg = f"a line must hold numbers; got {quoted(' '.join(words))}."
        raise ValueError(msg)
    off = ~((numbers >= -_OVERHANG) & (numbers <= 1 + _OVERHANG))
    if off.any():
        msg = (
            "the numbers behind the class must be ratios of the picture's size and a confidence, "
            f"0 to 1; got {numbers[off][0]:g}. Divide pixels by the size, leave out track ids."
        )
        raise ValueError(msg)
    return numbers


def _wrong_count(count: int, *, polygons: bool) -> str:
    remedy = (
        ""
        if polygons
        else " Segmentations and oriented boxes need polygons=True; of keypoints and track ids "
        "keep the first five."
    )
    return f"a line must have 5 numbers, or 6 with the confidence; got {count}.{remedy}"


def _box(ratios: FloatArray, size: ImageSize) -> Box:
    x, y, width, height = (float(ratio) for ratio in ratios)
    if not (width > 0 and height > 0):
        msg = f"a box must have a positive width and height; got {width:g} and {height:g}."
        raise ValueError(msg)
    return (
        (x - width / 2) * size[0],
        (y - height / 2) * size[1],
        (x + width / 2) * size[0],
        (y + height / 2) * size[1],
    )


def _outline(ratios: FloatArray, size: ImageSize) -> tuple[Box, BoolArray]:
    points = ratios.reshape(-1, 2) * size
    (left, top), (right, bottom) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return (left, top, right, bottom), polygon_mask(points, size)
