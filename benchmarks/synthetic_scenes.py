"""Random scenes that obey the assumptions of the fixture priors: coverage must be right here."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from synthetic_maps import are_apart, paint
from validation_priors import PROTOTYPE
from validation_runs import Boxes, Run
from validation_scenes import Scene, Thing

_IMAGE_SIZES = ((1242, 375), (1920, 1080), (1280, 960), (640, 480))
_FOCAL_PX = (500.0, 2000.0)
_DEPTH_M = (4.0, 60.0)
_CAMERA_HEIGHT_M = (1.2, 3.0)
_OBJECTS = (2, 12)
_UNKNOWN_HEIGHT_M = (0.5, 3.5)
_ON_GROUND_SHARE = 0.7
_FOUND_SHARE = 0.9
_DETECTORS: tuple[Boxes, ...] = ("frustum", "zenuity")
# Mean heights keep this far from the limits of the filter, so that whether an object is taken
# hardly depends on how tall it is for its class.
_LEAST_PX = 45.0
_LARGEST_SHARE = 0.5
_ROOM = 1.8
_MARGIN_PX = 8.0
_CLEAR_PX = 2.0


class _Kind(NamedTuple):
    """How often a class is drawn, and its length and width in metres."""

    share: float
    length_m: float
    width_m: float


_KINDS = {
    "Car": _Kind(0.4, 4.3, 1.8),
    "Van": _Kind(0.1, 5.0, 1.9),
    "Truck": _Kind(0.07, 9.0, 2.5),
    "Pedestrian": _Kind(0.2, 0.3, 0.6),
    "Cyclist": _Kind(0.1, 1.8, 0.6),
    "Tram": _Kind(0.03, 15.0, 2.6),
    "Misc": _Kind(0.1, 2.5, 1.5),
}


class _Camera(NamedTuple):
    """What holds for a whole image."""

    focal_px: float
    image_size: tuple[int, int]
    height_m: float
    offsets: Mapping[str, float]
    """By class: how far the mean of this place is from the table's, in log."""


def make_scenes(count: int, seed: int) -> list[Scene]:
    """Make images, each a drive of its own."""
    return [_make_scene(number, np.random.default_rng([seed, number])) for number in range(count)]


def _make_scene(number: int, rng: np.random.Generator) -> Scene:
    camera = _Camera(
        focal_px=_log_uniform(rng, *_FOCAL_PX),
        image_size=_IMAGE_SIZES[rng.integers(len(_IMAGE_SIZES))],
        height_m=rng.uniform(*_CAMERA_HEIGHT_M),
        offsets={name: rng.normal(0.0, law.mean_spread) for name, law in PROTOTYPE.items()},
    )
    shares = np.array([kind.share for kind in _KINDS.values()])
    count = rng.integers(_OBJECTS[0], _OBJECTS[1] + 1)
    labels = [str(label) for label in rng.choice(list(_KINDS), size=count, p=shares)]
    true = [_make_thing(index, label, camera, rng) for index, label in enumerate(labels)]
    known = [thing for thing in true if thing.label in PROTOTYPE]
    name = f"synthetic-{number}"
    painter = partial(paint, true, camera.image_size, [number])
    return Scene(
        name=name,
        drive=name,
        image_size=camera.image_size,
        focal_px=camera.focal_px,
        things=tuple(_boxed(thing, "label", camera, rng) for thing in true),
        detected={
            boxes: tuple(
                _boxed(thing, boxes, camera, rng) for thing in known if rng.random() < _FOUND_SHARE
            )
            for boxes in _DETECTORS
        },
        read_depth_map=painter if are_apart([thing.box for thing in true]) else None,
    )


def _make_thing(index: int, label: str, camera: _Camera, rng: np.random.Generator) -> Thing:
    """Make an object with its exact box."""
    law, kind = PROTOTYPE.get(label), _KINDS[label]
    mean_m = law.mean_m if law else _log_uniform(rng, *_UNKNOWN_HEIGHT_M)
    log_var = math.log1p(law.spread**2) if law else 0.0
    log_height = rng.normal(math.log(mean_m) - log_var / 2, math.sqrt(log_var))
    height_m = math.exp(log_height + camera.offsets.get(label, 0.0))
    surface_m = _depth(mean_m, camera, rng)
    yaw = rng.uniform(-math.pi, math.pi)
    along = kind.length_m * abs(math.sin(yaw)) + kind.width_m * abs(math.cos(yaw))
    across = kind.length_m * abs(math.cos(yaw)) + kind.width_m * abs(math.sin(yaw))
    scale = camera.focal_px / surface_m
    bottom = _foot_row(scale, mean_m, camera, rng)
    width = camera.image_size[0]
    half = min(across * scale, width - 2 * _MARGIN_PX) / 2
    middle = rng.uniform(_MARGIN_PX + half, width - _MARGIN_PX - half)
    box = (middle - half, bottom - height_m * scale, middle + half, bottom)
    return Thing(index, label, box, height_m, surface_m, centre_m=surface_m + along / 2)


def _depth(mean_m: float, camera: _Camera, rng: np.random.Generator) -> float:
    """Draw a depth at which objects of this class are neither too small nor too large."""
    size = camera.focal_px * mean_m
    nearest = max(_DEPTH_M[0], size / (_LARGEST_SHARE * camera.image_size[1]))
    return _log_uniform(rng, nearest, min(_DEPTH_M[1], size / _LEAST_PX))


def _foot_row(scale: float, mean_m: float, camera: _Camera, rng: np.random.Generator) -> float:
    """Draw where the object stands: mostly on the ground, where that is in view."""
    height = camera.image_size[1]
    highest, lowest = _MARGIN_PX + _ROOM * mean_m * scale, height - _MARGIN_PX
    on_ground = height / 2 + scale * camera.height_m
    if highest <= on_ground <= lowest and rng.random() < _ON_GROUND_SHARE:
        return on_ground
    return rng.uniform(highest, lowest)


def _boxed(thing: Thing, boxes: Boxes, camera: _Camera, rng: np.random.Generator) -> Thing:
    """Give an object the box that labels or a detector would, with the errors that runs assume."""
    left, top, right, bottom = thing.box
    noise = Run(protocol="L", boxes=boxes).noise
    edge = math.hypot(noise.box_px, noise.box_rel * thing.pixels) / math.sqrt(2)
    height = camera.image_size[1]
    top = max(top + rng.normal(0.0, edge), _CLEAR_PX)
    bottom = min(bottom + rng.normal(0.0, edge), height - _CLEAR_PX)
    return replace(thing, box=(left, top, right, bottom))


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))
