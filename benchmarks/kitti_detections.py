"""Boxes of real detectors on KITTI's images, and which of the labelled objects they are of."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from kitti_layout import LayoutError, read_lines
from validation_scenes import Box, FloatArray, Thing, in_full_view

_SCORE_FROM = 0.5
_OVERLAP_FROM = 0.5
_FRUSTUM = "frustum_pointnets_val.txt"
_FRUSTUM_TYPES = {"1": "Pedestrian", "2": "Car", "3": "Cyclist"}


class Found(NamedTuple):
    """One box of a detector."""

    label: str
    box: Box
    score: float


def read_detections(folder: Path | None) -> dict[str, dict[str, list[Found]]]:
    """Read what there is: by detector and image, the boxes with a fair score."""
    detections: dict[str, dict[str, list[Found]]] = {}
    if folder is None:
        return detections
    if (folder / _FRUSTUM).is_file():
        found = detections["frustum"] = {}
        for image, item in _read(folder / _FRUSTUM, _frustum_box):
            found.setdefault(image, []).append(item)
    if (folder / "zenuity").is_dir():
        found = detections["zenuity"] = {}
        for path in sorted((folder / "zenuity").glob("*.txt")):
            found[path.stem] = [item for _, item in _read(path, _kitti_box)]
    return detections


def match(
    things: Sequence[Thing], found: Sequence[Found], image_size: tuple[int, int]
) -> tuple[Thing, ...]:
    """
    Give objects the boxes and labels under which they were found, the best overlaps first.

    A box at the image's border may be cut there, as everybody can see: it is left out.
    """
    found = [item for item in found if in_full_view(item.box, image_size)]
    if not things or not found:
        return ()
    overlap = _overlaps([thing.box for thing in things], [item.box for item in found])
    matched: dict[int, Thing] = {}
    while overlap.max() >= _OVERLAP_FROM:
        row, column = np.unravel_index(np.argmax(overlap), overlap.shape)
        item = found[int(column)]
        matched[int(row)] = replace(things[int(row)], label=item.label, box=item.box)
        overlap[row, :] = overlap[:, column] = 0.0
    return tuple(matched[row] for row in sorted(matched))


def _read(
    path: Path, read: Callable[[list[str]], tuple[str, Found]]
) -> Iterator[tuple[str, Found]]:
    """Read the boxes of a file whose score is fair, with the image that the line names."""
    for number, line in enumerate(read_lines(path), start=1):
        if not line.strip():
            continue
        try:
            image, item = read(line.split())
        except (ValueError, KeyError, IndexError) as error:
            msg = f"{path}, line {number}: not a detection: {error}."
            raise LayoutError(msg) from error
        if item.score >= _SCORE_FROM:
            yield image, item


def _frustum_box(words: list[str]) -> tuple[str, Found]:
    """Read ``path type confidence x1 y1 x2 y2``."""
    box = _box(words[3:7])
    return Path(words[0]).stem, Found(_FRUSTUM_TYPES[words[1]], box, float(words[2]))


def _kitti_box(words: list[str]) -> tuple[str, Found]:
    """Read a line of KITTI's result format, whose last column is the score; it names no image."""
    return "", Found(words[0], _box(words[4:8]), float(words[-1]))


def _box(words: list[str]) -> Box:
    left, top, right, bottom = (float(word) for word in words)
    return (left, top, right, bottom)


def _overlaps(ones: Sequence[Box], others: Sequence[Box]) -> FloatArray:
    """Intersection over union of every pair."""
    a, b = np.array(ones)[:, None, :], np.array(others)[None, :, :]
    low, high = np.maximum(a[..., :2], b[..., :2]), np.minimum(a[..., 2:], b[..., 2:])
    common = np.prod(np.maximum(high - low, 0.0), axis=-1)
    area_a, area_b = (np.prod(box[..., 2:] - box[..., :2], axis=-1) for box in (a, b))
    overlap: FloatArray = common / (area_a + area_b - common)
    return overlap
