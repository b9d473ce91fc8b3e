"""Read a folder in the native layout of KITTI's object benchmark into scenes."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import kitti_detections
import numpy as np
from kitti_layout import Folders, LayoutError, read_lines
from PIL import Image
from validation_scenes import Box, FloatArray, Scene, Thing, in_full_view, is_high

_USUAL_SIZE = (1242, 375)
_NEAREST_M = 2.0
_MOST_OCCLUDED = 1
_LIDAR_UNITS_PER_M = 256.0
# As published, for all its cars; pitch and the slope of the road move the true one by some percent.
_CAMERA_HEIGHT_M = 1.65


@dataclass(frozen=True)
class _Frame:
    """What holds for a whole image."""

    drive: str
    time: int
    image_size: tuple[int, int]
    focal_px: float
    horizon_px: float
    """The row of the principal point: the horizon of a level camera on a level road."""
    shift_z_m: float
    """What z in camera 2 has over z in the rectified camera 0, in which labels are."""


def read_scenes(folders: Folders) -> list[Scene]:
    """Read all images of the folders."""
    frames = _read_frames(folders.frames)
    detections = kitti_detections.read_detections(folders.detections)
    paths = sorted(folders.labels.glob("*.txt"))
    if not paths:
        msg = f"no labels: {folders.labels} holds no *.txt."
        raise LayoutError(msg)
    scenes = []
    for path in paths:
        frame = frames.get(path.stem) or _frame_of_files(path.stem, folders)
        things = _read_things(path, frame)
        scenes.append(
            Scene(
                name=path.stem,
                drive=frame.drive,
                time=frame.time,
                image_size=frame.image_size,
                focal_px=frame.focal_px,
                camera_height_m=_CAMERA_HEIGHT_M,
                horizon_px=frame.horizon_px,
                things=things,
                detected={
                    name: kitti_detections.match(things, found.get(path.stem, ()), frame.image_size)
                    for name, found in detections.items()
                },
                read_depth_map=_depth_map_reader(path.stem, folders.lidar),
            )
        )
    return scenes


def _read_frames(path: Path | None) -> dict[str, _Frame]:
    if path is None:
        return {}
    rows = csv.DictReader(read_lines(path))
    try:
        return {row["frame"]: _frame_of_row(row) for row in rows}
    except (KeyError, ValueError, TypeError) as error:
        msg = f"{path}: a column or number is missing or wrong: {error}."
        raise LayoutError(msg) from error


def _frame_of_row(row: Mapping[str, str]) -> _Frame:
    return _Frame(
        drive=row["drive"],
        time=int(row["raw_frame"]),
        image_size=(int(row["width"]), int(row["height"])),
        focal_px=float(row["fy"]),
        horizon_px=float(row["cy"]),
        shift_z_m=float(row["tz"]),
    )


def _frame_of_files(name: str, folders: Folders) -> _Frame:
    """Take the camera from the calibration, the size from the image; a drive of its own."""
    path = folders.calib / f"{name}.txt"
    if not path.is_file():
        msg = f"no calibration: {path} is missing."
        raise LayoutError(msg)
    lines = (line.split() for line in read_lines(path))
    numbers = next((words[1:] for words in lines if words and words[0] == "P2:"), [])
    try:
        projection = np.array(numbers, dtype=np.float64).reshape(3, 4)
    except ValueError as error:
        msg = f"{path}: P2 must be twelve numbers: {error}."
        raise LayoutError(msg) from error
    size = _USUAL_SIZE
    if (folders.images / f"{name}.png").is_file():
        with Image.open(folders.images / f"{name}.png") as image:
            size = image.size
    return _Frame(
        drive=name,
        time=0,
        image_size=size,
        focal_px=float(projection[1, 1]),
        horizon_px=float(projection[1, 2]),
        shift_z_m=float(projection[2, 3]),
    )


def _read_things(path: Path, frame: _Frame) -> tuple[Thing, ...]:
    """Read the labelled objects that are fit to be references and targets."""
    things: list[Thing] = []
    for number, line in enumerate(read_lines(path), start=1):
        try:
            thing = _read_thing(line.split(), len(things), frame)
        except (ValueError, IndexError) as error:
            msg = f"{path}, line {number}: not a KITTI label: {error}."
            raise LayoutError(msg) from error
        if thing is not None:
            things.append(thing)
    return tuple(things)


def _read_thing(words: list[str], index: int, frame: _Frame) -> Thing | None:
    """Read one label; None where the object is not seen whole, or too small, or too near."""
    if not words or words[0] == "DontCare":
        return None
    label, (truncation, occlusion) = words[0], (float(word) for word in words[1:3])
    box = _box(words[4:8])
    height, width, length, _, _, z, yaw = (float(word) for word in words[8:15])
    if truncation > 0 or occlusion > _MOST_OCCLUDED:
        return None
    if not (in_full_view(box, frame.image_size) and is_high(box)):
        return None
    half = abs(length / 2 * math.sin(yaw)) + abs(width / 2 * math.cos(yaw))
    centre = z + frame.shift_z_m
    if centre - half < _NEAREST_M:
        return None
    track = " ".join((label, *words[8:11]))  # the sizes of one object are the same in all images
    return Thing(index, label, box, height, surface_m=centre - half, centre_m=centre, track=track)


def _box(words: list[str]) -> Box:
    left, top, right, bottom = (float(word) for word in words)
    return (left, top, right, bottom)


def _depth_map_reader(name: str, folder: Path | None) -> partial[FloatArray] | None:
    if folder is None or not (folder / f"{name}.png").is_file():
        return None
    return partial(_read_depth_map, folder / f"{name}.png")


def _read_depth_map(path: Path) -> FloatArray:
    with Image.open(path) as image:
        return np.asarray(image, dtype=np.float64) / _LIDAR_UNITS_PER_M
