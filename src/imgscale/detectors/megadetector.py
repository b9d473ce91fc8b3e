"""
Detections from the batch results of MegaDetector: camera-trap pictures, format 1.0 to 1.6.

A box is left, top, width and height as ratios of the picture that MegaDetector saw. See
https://lila.science/megadetector-output-format. The flat lists with boxes in pixels that other
packages of that name write are another format.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from operator import itemgetter
from os import PathLike
from pathlib import Path, PureWindowsPath
from typing import Any, cast

from imgscale._checks import as_float, as_image_size, four_numbers, is_between, within
from imgscale._reading import MAX_BYTES, in_file, quoted, read_json
from imgscale._typing import Box, ImageSize
from imgscale.detection import Detection
from imgscale.detectors._convert import make_detection
from imgscale.detectors._files import (
    as_list,
    as_table,
    identity,
    member,
    members,
    told_size,
)
from imgscale.errors import FileError
from imgscale.picture import opened_picture

__all__ = ["from_megadetector", "read_megadetector"]

# MegaDetector's own categories that a classifier of animals has no say in.
_NO_ANIMALS = ("person", "vehicle")

# EXIF orientations: a turn of the picture, which MegaDetector undoes, and a mirroring, which it
# does not (visualization_utils.open_image, as of version 10).
_TURNED, _QUARTER_TURNED, _MIRRORED = (3, 6, 8), (6, 8), (2, 4, 5, 7)


def read_megadetector(
    path: str | PathLike[str],
    *,
    image_folder: str | PathLike[str] | None = None,
    max_bytes: int = MAX_BYTES,
) -> dict[str, list[Detection]]:
    """
    Read a file of MegaDetector's results.

    Parameters
    ----------
    path : str or path-like
        The JSON file.
    image_folder : str or path-like, optional
        The folder that `file` in the results starts from. The sizes of pictures are then read
        from them where the results do not tell; only headers are read, and only of pictures with
        detections. MegaDetector turns pictures upright by their EXIF orientation first, and so
        are these sizes.
    max_bytes : int
        Greatest length of the JSON file. Parsed, it takes up to 30 times that in memory.

    Returns
    -------
    dict of str to list of Detection
        As `from_megadetector` gives it.

    Raises
    ------
    FileError
        If the file is not JSON, holds a name twice in an object, a NaN or an infinite number, is
        longer than `max_bytes`, or holds what `from_megadetector` refuses; if a picture cannot be
        read, or is of a kind that MegaDetector does not turn upright: mirrored, or grey and
        turned. The message names the file.
    OSError
        If the file cannot be opened.
    """
    data = read_json(path, max_bytes)
    with in_file(path):
        sizes = {} if image_folder is None else _read_sizes(data, Path(image_folder))
        return from_megadetector(data, image_sizes=sizes)


def from_megadetector(
    data: Mapping[str, Any], *, image_sizes: Mapping[str, Sequence[int]] | None = None
) -> dict[str, list[Detection]]:
    """
    Convert MegaDetector's results.

    MegaDetector writes boxes of very low confidence: choose by `score` before sizing anything.

    Parameters
    ----------
    data : mapping
        The parsed results: `images` (`file`, `detections`, perhaps `width`, `height` and
        `failure`), `detection_categories` and perhaps `classification_categories`.
    image_sizes : mapping of str to (width, height), optional
        Sizes by `file`, with either kind of slash, in pixels, of the upright pictures. Only
        pictures with detections need one, and only where the results do not tell it. One camera's
        pictures are all alike: ``dict.fromkeys(files, (2048, 1536))``.

    Returns
    -------
    dict of str to list of Detection
        For every picture that MegaDetector has looked at its detections by `file`, written with
        forward slashes, in the order of the results, empty where it found none. Pictures that it
        could not read ("failure") are left out: nobody looked at them. The label is the most
        probable class of a classifier, whatever its confidence, with the detector's category as
        alias; without classes, and for "person" and "vehicle", it is the category. The score is
        the detector's.

    Raises
    ------
    ValueError
        If something required is missing, a category unknown, a file double or a video, a box
        empty or no ratio (more than 5 % outside 0 to 1), or a size unknown or contradictory. The
        message names the entry.
    TypeError
        If something has another type than the format's.

    Examples
    --------
    >>> from imgscale.detectors.megadetector import from_megadetector
    >>> data = {
    ...     "detection_categories": {"1": "animal"},
    ...     "classification_categories": {"0": "fox"},
    ...     "images": [
    ...         {
    ...             "file": "a.jpg",
    ...             "detections": [
    ...                 {
    ...                     "category": "1",
    ...                     "conf": 0.93,
    ...                     "bbox": [0.25, 0.5, 0.125, 0.25],
    ...                     "classifications": [["0", 0.9]],
    ...                 }
    ...             ],
    ...         }
    ...     ],
    ... }
    >>> [fox] = from_megadetector(data, image_sizes={"a.jpg": (2048, 1536)})["a.jpg"]
    >>> fox.label, fox.aliases, fox.xyxy
    ('fox', ('animal',), (512.0, 768.0, 768.0, 1152.0))
    """
    tables = _tables(data)
    given = as_table("image_sizes", image_sizes or {})
    sizes = {_slashed(file): size for file, size in given.items()}
    found: dict[str, list[Detection]] = {}
    for index, image in enumerate(members(data, "images")):
        with within(f"images[{index}]"):
            file, entries = _slashed(identity(image, "file")), _entries(image)
            if file in found:
                msg = f"`file` must be its own; {file!r} came before."
                raise ValueError(msg)
            if entries:
                size = _size(image, file, sizes)
                found[file] = [
                    _detection(f"detections[{number}]", entry, size, *tables)
                    for number, entry in enumerate(entries)
                ]
            elif entries is not None:
                found[file] = []
    return found


def _tables(data: Any) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """Take the names of the categories and, empty where there are none, of the classes."""
    if isinstance(data, list):
        msg = (
            "`data` must be an object with `images` and `detection_categories`; got a list. "
            "Boxes of a flat list in pixels go through Detection(label, (x1, y1, x2, y2))."
        )
        raise TypeError(msg)
    categories = as_table(
        "detection_categories", member(as_table("data", data), "detection_categories")
    )
    classes = as_table("classification_categories", data.get("classification_categories") or {})
    return categories, classes


def _slashed(file: object) -> str:
    """Write a name with forward slashes; the format allows Windows' separators anywhere."""
    return PureWindowsPath(str(file)).as_posix()


def _entries(image: Mapping[str, Any]) -> Sequence[Any] | None:
    """Take the detections of one image; None where it could not be looked at."""
    if image.get("failure") is not None and not image.get("detections"):
        return None
    entries = members(image, "detections")
    if "frame_rate" in image or "frames_processed" in image:
        msg = (
            "the file must be a picture; got a video, whose boxes lie in several frames. Leave "
            "it out, or detect in its frames, saved as pictures."
        )
        raise ValueError(msg)
    return entries


def _size(image: Mapping[str, Any], file: str, image_sizes: Mapping[str, Any]) -> ImageSize:
    told, given = told_size(image), as_image_size(image_sizes.get(file))
    if told and given and told != given:
        msg = (
            f"`image_sizes` must agree with the results; got {given} for {file!r}, which has "
            f"{told} there. Is the size that of the upright picture?"
        )
        raise ValueError(msg)
    size = given or told
    if size is None:
        msg = (
            f"the size of {file!r} must be known; the results do not tell it. Give `image_sizes` "
            "(from_megadetector) or `image_folder` (read_megadetector)."
        )
        raise ValueError(msg)
    return size


def _detection(
    place: str,
    entry: Any,
    size: ImageSize,
    categories: Mapping[str, Any],
    classes: Mapping[str, Any],
) -> Detection:
    with within(place):
        names = _names(entry, categories, classes)
        box = _corners(member(entry, "bbox"), size)
        score = member(entry, "conf")
    return make_detection(place, names[0], box, image_size=size, score=score, aliases=names[1:])


def _names(
    entry: Any, categories: Mapping[str, Any], classes: Mapping[str, Any]
) -> tuple[str, ...]:
    """Label and aliases."""
    category = _look_up(categories, member(entry, "category"), "detection_categories")
    rated = entry.get("classifications")
    if not rated or category in _NO_ANIMALS:
        return (category,)
    best, _ = max(map(_rated_class, as_list("classifications", rated)), key=itemgetter(1))
    return (_look_up(classes, best, "classification_categories"), category)


def _rated_class(pair: Any) -> tuple[Any, float]:
    lawful = isinstance(pair, (list, tuple)) and len(cast("Sequence[Any]", pair)) == 2
    key, confidence = cast("tuple[Any, Any]", pair) if lawful else (None, math.nan)
    number: object = as_float(confidence)
    if not isinstance(number, float) or not math.isfinite(number):
        msg = f"`classifications` must be pairs of a class and a confidence; got {quoted(pair)}."
        raise ValueError(msg)
    return key, number


def _look_up(table: Mapping[str, Any], key: Any, name: str) -> str:
    is_name = isinstance(key, (int, str)) and not isinstance(key, bool)
    if not is_name or str(key) not in table:  # some tools write numbers, the format has strings
        msg = f"the category must be one of `{name}`; got {quoted(key)}."
        raise ValueError(msg)
    label = table[str(key)]
    if not isinstance(label, str):
        msg = f"`{name}` must name its categories by strings; got {quoted(label)}."
        raise TypeError(msg)
    return label


def _corners(bbox: Any, size: ImageSize) -> Box:
    x, y, width, height = four_numbers("bbox", "four ratios (left, top, width, height)", bbox)
    if not all(is_between(ratio, -0.05, 1.05) for ratio in (x, y, x + width, y + height)):
        msg = (
            "`bbox` must be left, top, width and height as ratios of the picture's size; got "
            f"{[x, y, width, height]}."
        )
        raise ValueError(msg)
    if not (width > 0 and height > 0):
        msg = (
            f"`bbox` must have a positive width and height; got {[x, y, width, height]}. Leave "
            "such entries out."
        )
        raise ValueError(msg)
    return (x * size[0], y * size[1], (x + width) * size[0], (y + height) * size[1])


def _read_sizes(data: Any, folder: Path) -> dict[str, ImageSize]:
    """Sizes of the pictures that need one."""
    sizes: dict[str, ImageSize] = {}
    for index, image in enumerate(members(data, "images")):
        with within(f"images[{index}]"):
            file = _slashed(identity(image, "file"))
            if _entries(image) and not told_size(image):
                sizes[file] = _read_size(_inside(folder, file))
    return sizes


def _inside(folder: Path, file: str) -> Path:
    """Join a name of the results to the folder, which a name such as ../a.jpg must not leave."""
    path = Path(os.path.normpath(folder / file))
    if not path.is_relative_to(os.path.normpath(folder)):
        msg = f"`file` must lie in the folder of the pictures, {folder}; got {quoted(file)}."
        raise ValueError(msg)
    return path


def _read_size(path: Path) -> ImageSize:
    from PIL import ExifTags  # noqa: PLC0415 - 20 ms that most users do not need

    try:
        with opened_picture(path) as picture:
            width, height = picture.size
            orientation = picture.getexif().get(ExifTags.Base.Orientation, 1)
            colour = picture.mode == "RGB"
    except (OSError, FileError) as error:
        msg = f"{path} must be a picture, to read its size; got: {error}."
        raise FileError(msg) from error
    if orientation in _MIRRORED or (orientation in _TURNED and not colour):
        msg = (
            f"{path} must be a picture that MegaDetector turns upright; it leaves EXIF orientation "
            f"{orientation} of a mirrored or a grey one, and its boxes lie otherwise. Turn the "
            "file itself and detect again."
        )
        raise ValueError(msg)
    return (height, width) if orientation in _QUARTER_TURNED else (width, height)
