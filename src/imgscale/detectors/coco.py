"""
Detections from COCO: annotations of many pictures, and detectors' results on them.

A box is left, top, width and height in continuous pixels. See https://cocodataset.org/#format-data
and https://cocodataset.org/#format-results.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any

import numpy as np

from imgscale._checks import as_array, four_numbers, within
from imgscale._reading import MAX_BYTES, check_limit, in_file, quoted, read_json
from imgscale._typing import BoolArray, Box, ImageSize
from imgscale.detection import Detection
from imgscale.detectors._convert import make_detection
from imgscale.detectors._files import (
    as_list,
    as_table,
    identity,
    member,
    members,
    polygon_mask,
    told_size,
)

__all__ = ["from_coco", "read_coco"]

_MAX_MASK_BYTES = 4_000_000_000

_Picture = tuple[str, ImageSize | None]

# A box that leaves the picture by more than this share of its side is suspected of being corners.
_FAR_OUT = 0.05
_LONGEST_RUN_BITS = 60


def read_coco(
    path: str | PathLike[str],
    results_path: str | PathLike[str] | None = None,
    *,
    masks: bool = False,
    max_bytes: int = MAX_BYTES,
    max_mask_bytes: int = _MAX_MASK_BYTES,
) -> dict[str, list[Detection]]:
    """
    Read a COCO file of annotations, or one of results with the pictures' file.

    Parameters
    ----------
    path : str or path-like
        The JSON file with `images`, `categories` and, without `results_path`, `annotations`.
    results_path : str or path-like, optional
        The JSON file with a detector's list of results on those pictures.
    masks : bool
        Whether to read `segmentation` too, see `from_coco`.
    max_bytes : int
        Greatest length of a file in bytes; COCO's own for 2017 have 470 000 000. Parsed, a file
        takes up to 30 times its length in memory.
    max_mask_bytes : int
        As for `from_coco`.

    Returns
    -------
    dict of str to list of Detection
        As `from_coco` gives it. Entries without an area are refused: `from_coco` tells how to
        leave them out of the parsed file.

    Raises
    ------
    FileError
        If a file is not JSON, holds a name twice in an object, a NaN or an infinite number, is
        longer than `max_bytes`, or holds what `from_coco` refuses; the message names the file.
    OSError
        If a file cannot be opened.
    """
    dataset = read_json(path, max_bytes)
    if results_path is None:
        with in_file(path):
            return from_coco(dataset, masks=masks, max_mask_bytes=max_mask_bytes)
    with in_file(results_path):
        results = as_list("results", read_json(results_path, max_bytes))
    with in_file(f"{results_path} on {path}"):
        return from_coco(dataset, results, masks=masks, max_mask_bytes=max_mask_bytes)


def from_coco(
    dataset: Mapping[str, Any],
    results: Sequence[Mapping[str, Any]] | None = None,
    *,
    masks: bool = False,
    max_mask_bytes: int = _MAX_MASK_BYTES,
) -> dict[str, list[Detection]]:
    """
    Convert COCO's annotations, or a detector's results on the same pictures.

    A crowd (`iscrowd` 1) outlines a group and not one object: it is kept as a partial detection,
    so that it is never a reference. `supercategory` is not read: it is a theme ("kitchen") or, in
    many exports, the project's name, and not a kind that the object belongs to.

    Parameters
    ----------
    dataset : mapping
        With `images` (`id`, `file_name`, and `width` and `height` where known), `categories`
        (`id`, `name`) and, where no results are given, `annotations` (`image_id`, `category_id`,
        `bbox`, perhaps `score`, `segmentation`, `iscrowd`).
    results : sequence of mapping, optional
        A detector's results (`image_id`, `category_id`, `bbox`, `score`, perhaps
        `segmentation`), to be taken in place of the annotations.
    masks : bool
        Whether to turn `segmentation` (polygons, run lengths, compressed run lengths) into
        masks, which needs the pictures' sizes in `images`. Each has the shape of its whole
        picture: a thousand of 640 x 480 pixels fill 300 MB. A mask that is empty in its box, as
        of a polygon too small to hold the centre of a pixel, is left out; depth is then read in
        the box.
    max_mask_bytes : int
        Most memory that all masks together may take, above 0: a file can claim any size of its
        pictures.

    Returns
    -------
    dict of str to list of Detection
        For every image its detections by `file_name`, in the order of the file and empty where
        there are none. Boxes are cut at the border of pictures whose size the dataset tells.

    Raises
    ------
    ValueError
        If something required is missing, an id unknown or double, a box empty, wholly outside
        its picture or evidently given by its corners, a mask not of its picture's size or beyond
        `max_mask_bytes`. The
        message names the entry.
    TypeError
        If something has another type than COCO's.

    Notes
    -----
    Two annotations of COCO's own instances_train2017.json have a height of 0
    (github.com/cocodataset/cocoapi, issue 355), and other files have such too. Leave them out::

        dataset["annotations"] = [a for a in dataset["annotations"] if min(a["bbox"][2:]) > 0]

    Examples
    --------
    >>> from imgscale.detectors.coco import from_coco
    >>> dataset = {
    ...     "images": [{"id": 7, "file_name": "street.jpg", "width": 640, "height": 480}],
    ...     "categories": [{"id": 3, "name": "car"}],
    ... }
    >>> car = {"image_id": 7, "category_id": 3, "bbox": [10, 20, 100, 50], "score": 0.9}
    >>> from_coco(dataset, [car])["street.jpg"][0].xyxy
    (10.0, 20.0, 110.0, 70.0)

    Results without a dataset need the names of the categories, and any name for each picture:

    >>> names = {3: "car"}
    >>> found = from_coco(
    ...     {
    ...         "images": [{"id": i, "file_name": str(i)} for i in {car["image_id"]}],
    ...         "categories": [{"id": i, "name": name} for i, name in names.items()],
    ...     },
    ...     [car],
    ... )
    >>> found["7"][0].label
    'car'
    """
    check_limit("max_mask_bytes", max_mask_bytes)
    pictures, labels = _pictures(dataset), _labels(dataset)
    left = max_mask_bytes
    found: dict[str, list[Detection]] = {name: [] for name, _ in pictures.values()}
    source = "annotations" if results is None else "results"
    entries = members(dataset, source) if results is None else as_list(source, results)
    for index, entry in enumerate(entries):
        place = f"{source}[{index}]"
        with within(place):
            name, size = _look_up(pictures, entry, "image_id", "images")
            label = _look_up(labels, entry, "category_id", "categories")
            box = _corners(member(entry, "bbox"), size)
            is_crowd = _is_crowd(entry.get("iscrowd"))
            mask = _mask(entry.get("segmentation"), size, left) if masks else None
        left -= 0 if mask is None else mask.size
        score = entry.get("score")
        found[name].append(
            make_detection(
                place,
                label,
                box,
                image_size=size,
                score=1.0 if score is None else score,
                mask=mask,
                partial=is_crowd,
            )
        )
    return found


def _pictures(dataset: Any) -> dict[int | str, _Picture]:
    """Name and size of every image by its id."""
    if isinstance(dataset, list):
        msg = (
            "`dataset` must be an object with `images` and `categories`; got a list. Results are "
            "the second argument."
        )
        raise TypeError(msg)
    pictures: dict[int | str, _Picture] = {}
    names: set[str] = set()
    for index, entry in enumerate(members(as_table("dataset", dataset), "images")):
        with within(f"images[{index}]"):
            key, name = identity(entry, "id"), str(identity(entry, "file_name"))
            if key in pictures or name in names:
                msg = f"`id` and `file_name` must be its own; {key!r} or {name!r} came before."
                raise ValueError(msg)
            pictures[key] = (name, told_size(entry))
            names.add(name)
    return pictures


def _labels(dataset: Mapping[str, Any]) -> dict[int | str, str]:
    """Name of every category by its id."""
    labels: dict[int | str, str] = {}
    for index, entry in enumerate(members(dataset, "categories")):
        with within(f"categories[{index}]"):
            key = identity(entry, "id")
            if key in labels:
                msg = f"`id` must be its own; {key!r} came before."
                raise ValueError(msg)
            labels[key] = member(entry, "name")
    return labels


def _look_up(table: Mapping[int | str, Any], entry: Any, name: str, where: str) -> Any:
    key = identity(entry, name)
    if key not in table:
        msg = f"`{name}` must be an id of `{where}`; got {key!r}. Is it of another dataset?"
        raise ValueError(msg)
    return table[key]


def _corners(bbox: Any, size: ImageSize | None) -> Box:
    x, y, width, height = four_numbers("bbox", "four numbers (left, top, width, height)", bbox)
    if not (width > 0 and height > 0):
        msg = (
            f"`bbox` must have a positive width and height; got {[x, y, width, height]}. Leave "
            'such entries out: [a for a in entries if min(a["bbox"][2:]) > 0].'
        )
        raise ValueError(msg)
    if size and _looks_like_corners((x, y, width, height), size):
        msg = (
            f"`bbox` must be left, top, width and height inside the picture, {size[0]} x "
            f"{size[1]} px; got {[x, y, width, height]}, which fits as corners x1, y1, x2, y2: "
            "then write [x1, y1, x2 - x1, y2 - y1]."
        )
        raise ValueError(msg)
    return (x, y, x + width, y + height)


def _looks_like_corners(xywh: Box, size: ImageSize) -> bool:
    x, y, width, height = xywh
    slack = 1 + _FAR_OUT
    far_out = x + width > slack * size[0] or y + height > slack * size[1]
    return far_out and x < width <= slack * size[0] and y < height <= slack * size[1]


def _is_crowd(value: Any) -> bool:
    if value not in (None, 0, 1):
        msg = f"`iscrowd` must be 0 or 1; got {quoted(value)}."
        raise ValueError(msg)
    return bool(value)


def _mask(segmentation: Any, size: ImageSize | None, most: int) -> BoolArray | None:
    """Draw a segmentation in its picture; None where there is none."""
    if not segmentation:
        return None
    if not size:
        msg = "masks need the picture's `width` and `height` in `images`; got none."
        raise ValueError(msg)
    if math.prod(size) > most:
        msg = (
            f"masks must fit into `max_mask_bytes`; {most} are left for one of {size[0]} x "
            f"{size[1]}. Give more, or masks=False."
        )
        raise ValueError(msg)
    if isinstance(segmentation, Mapping):
        return _run_length_mask(segmentation, size)
    polygons = as_list("segmentation", segmentation)
    mask: BoolArray = np.any([_polygon(points, size) for points in polygons], axis=0)
    return mask


def _polygon(points: Any, size: ImageSize) -> BoolArray:
    law = "polygons, each a flat list x1, y1, x2, y2, ... of three finite corners or more"
    flat = as_array("segmentation", law, points)
    numbers = flat.ndim == 1 and flat.size >= 6 and not flat.size % 2 and flat.dtype.kind in "fiu"
    if not (numbers and np.isfinite(flat).all()):
        msg = f"`segmentation` must be {law}; got shape {flat.shape} and dtype {flat.dtype}."
        raise ValueError(msg)
    return polygon_mask(flat.reshape(-1, 2), size)


def _run_length_mask(segmentation: Any, size: ImageSize) -> BoolArray:
    """Unroll lengths of runs, off and on by turns, down the columns one after the other."""
    shape, told = size[::-1], list(members(segmentation, "size"))
    if told != list(shape):
        msg = f"`size` must be the picture's height and width, {list(shape)}; got {quoted(told)}."
        raise ValueError(msg)
    counts = member(segmentation, "counts")
    compressed = isinstance(counts, (str, bytes))
    runs = _run_lengths(counts) if compressed else as_list("counts", counts)
    if not all(type(run) is int and run >= 0 for run in runs) or sum(runs) != math.prod(shape):
        msg = (
            "`counts` must be whole numbers that sum to height x width, "
            f"{shape[0]} x {shape[1]}; got {len(runs)} that do not."
        )
        raise ValueError(msg)
    on = np.arange(len(runs)) % 2 == 1
    return np.repeat(on, runs).reshape(size).T


def _run_lengths(text: str | bytes) -> list[int]:
    """
    Read compressed lengths of runs.

    A number is written as characters of six bits above "0": five of value, lowest first, and one
    that says that more follow; the last one's fifth bit is the sign. From the fourth number on
    the difference to the one before the last is written.
    """
    runs: list[int] = []
    value = shift = 0
    for character in text.decode("latin-1") if isinstance(text, bytes) else text:
        bits = ord(character) - ord("0")
        if not 0 <= bits < 64:
            msg = f"`counts` must hold characters from '0' to 'o'; got {character!r}."
            raise ValueError(msg)
        value |= (bits & 31) << shift
        shift += 5
        if shift > _LONGEST_RUN_BITS:
            msg = "`counts` must hold numbers that some picture has; got one without end."
            raise ValueError(msg)
        if bits < 32:
            value -= (1 << shift) if bits & 16 else 0
            runs.append(value + runs[-2] if len(runs) > 2 else value)
            value = shift = 0
    if shift:
        msg = "`counts` must end with a whole number; it is cut off."
        raise ValueError(msg)
    return runs
