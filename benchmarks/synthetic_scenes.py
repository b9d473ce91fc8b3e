"""Random scenes that obey the assumptions of the fixture priors: coverage must be right here."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
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
# Objects of known class stand on the ground, others now and then hang or lie somewhere else.
_UNKNOWN_ON_GROUND_SHARE = 0.7
_ROLL_DEG = 2.0
# Kerbs and bumps move feet by this much of the camera's height; three times that is kept in view.
_RELIEF = 0.02
_RELIEF_ROOM = 1.06
_FOUND_SHARE = 0.9
_DETECTORS: tuple[Boxes, ...] = ("frustum", "zenuity")
# Mean heights keep this far from the limits of the filter, so that whether an object is taken
# hardly depends on how tall it is for its class.
_LEAST_PX = 45.0
_LARGEST_SHARE = 0.5
_ROOM = 1.8
_MARGIN_PX = 8.0
_CLEAR_PX = 2.0
# The images of a drive, and the objects that pass through them.
_FRAMES = 10
_CAST = 15


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
    """What holds for a whole image, or for all images of a drive."""

    focal_px: float
    image_size: tuple[int, int]
    height_m: float
    slope: float
    """By how much the ground falls off to the right."""
    offsets: Mapping[str, float]
    """By class: how far the mean of this place is from the table's, in log."""

    @property
    def horizon_px(self) -> float:
        """The row of the horizon, in the middle column."""
        return self.image_size[1] / 2


class _Body(NamedTuple):
    """A physical object, wherever it stands."""

    label: str
    height_m: float
    mean_m: float
    """Of its class; where that is not known, the height itself."""
    track: str


def make_scenes(count: int, seed: int) -> list[Scene]:
    """Make images: half of them each a drive of its own, the others in drives of ten."""
    drives = count // (2 * _FRAMES)
    singles = range(count - drives * _FRAMES)
    scenes = [_make_single(number, np.random.default_rng([seed, number])) for number in singles]
    for number in range(drives):
        scenes += _make_drive(number, np.random.default_rng([seed, number, 1]))
    return scenes


def _make_single(number: int, rng: np.random.Generator) -> Scene:
    camera = _make_camera(rng)
    count = int(rng.integers(_OBJECTS[0], _OBJECTS[1] + 1))
    bodies = _make_bodies(count, camera, rng)
    name = f"synthetic-{number}"
    return _make_scene((name, name, 0), bodies, camera, rng)


def _make_drive(number: int, rng: np.random.Generator) -> list[Scene]:
    """Make images of one camera, through which the same objects pass."""
    camera = _make_camera(rng)
    cast = _make_bodies(_CAST, camera, rng)
    scenes = []
    for time in range(_FRAMES):
        count = rng.integers(_OBJECTS[0], _OBJECTS[1] + 1)
        seen = [cast[place] for place in rng.choice(_CAST, size=count, replace=False)]
        drive = f"synthetic-drive-{number}"
        scenes.append(_make_scene((f"{drive}-{time}", drive, time), seen, camera, rng))
    return scenes


def _make_camera(rng: np.random.Generator) -> _Camera:
    return _Camera(
        focal_px=_log_uniform(rng, *_FOCAL_PX),
        image_size=_IMAGE_SIZES[rng.integers(len(_IMAGE_SIZES))],
        height_m=rng.uniform(*_CAMERA_HEIGHT_M),
        slope=math.tan(math.radians(rng.normal(0.0, _ROLL_DEG))),
        offsets={name: rng.normal(0.0, law.mean_spread) for name, law in PROTOTYPE.items()},
    )


def _make_bodies(count: int, camera: _Camera, rng: np.random.Generator) -> list[_Body]:
    shares = np.array([kind.share for kind in _KINDS.values()])
    labels = [str(label) for label in rng.choice(list(_KINDS), size=count, p=shares)]
    return [_make_body(label, f"{label}-{n}", camera, rng) for n, label in enumerate(labels)]


def _make_body(label: str, track: str, camera: _Camera, rng: np.random.Generator) -> _Body:
    law = PROTOTYPE.get(label)
    if law is None:
        height_m = _log_uniform(rng, *_UNKNOWN_HEIGHT_M)
        return _Body(label, height_m, height_m, track)
    log_var = math.log1p(law.spread**2)
    log_height = rng.normal(math.log(law.mean_m) - log_var / 2, math.sqrt(log_var))
    return _Body(label, math.exp(log_height + camera.offsets[label]), law.mean_m, track)


def _make_scene(
    names: tuple[str, str, int], bodies: Sequence[_Body], camera: _Camera, rng: np.random.Generator
) -> Scene:
    """Make the image of a name, a drive and a time in it."""
    name, drive, time = names
    true = [_place(index, body, camera, rng) for index, body in enumerate(bodies)]
    known = [thing for thing in true if thing.label in PROTOTYPE]
    painter = partial(paint, true, camera.image_size, name)
    return Scene(
        name=name,
        drive=drive,
        time=time,
        image_size=camera.image_size,
        focal_px=camera.focal_px,
        camera_height_m=camera.height_m,
        horizon_px=camera.horizon_px,
        things=tuple(_boxed(thing, "label", camera, rng) for thing in true),
        detected={
            boxes: tuple(
                _boxed(thing, boxes, camera, rng) for thing in known if rng.random() < _FOUND_SHARE
            )
            for boxes in _DETECTORS
        },
        read_depth_map=painter if are_apart([thing.box for thing in true]) else None,
    )


def _place(index: int, body: _Body, camera: _Camera, rng: np.random.Generator) -> Thing:
    """Put an object somewhere, with its exact box."""
    kind = _KINDS[body.label]
    surface_m = _depth(body, camera, rng)
    yaw = rng.uniform(-math.pi, math.pi)
    along = kind.length_m * abs(math.sin(yaw)) + kind.width_m * abs(math.cos(yaw))
    across = kind.length_m * abs(math.cos(yaw)) + kind.width_m * abs(math.sin(yaw))
    scale = camera.focal_px / surface_m
    width = camera.image_size[0]
    half = min(across * scale, width - 2 * _MARGIN_PX) / 2
    middle = rng.uniform(_MARGIN_PX + half, width - _MARGIN_PX - half)
    bottom = _foot_row(scale, middle, body, camera, rng)
    box = (middle - half, bottom - body.height_m * scale, middle + half, bottom)
    centre_m = surface_m + along / 2
    return Thing(index, body.label, box, body.height_m, surface_m, centre_m, body.track)


def _depth(body: _Body, camera: _Camera, rng: np.random.Generator) -> float:
    """Draw a depth at which objects of this class are neither too small nor too large."""
    size = camera.focal_px * body.mean_m
    width, height = camera.image_size
    nearest = max(_DEPTH_M[0], size / (_LARGEST_SHARE * height))
    if body.label in PROTOTYPE:  # far enough for the whole object to be in view on the ground
        room = height / 2 - _MARGIN_PX - abs(camera.slope) * width / 2
        above = _ROOM * body.mean_m - camera.height_m
        nearest = max(nearest, camera.focal_px * max(_RELIEF_ROOM * camera.height_m, above) / room)
    return _log_uniform(rng, nearest, min(_DEPTH_M[1], size / _LEAST_PX))


def _foot_row(
    scale: float, column: float, body: _Body, camera: _Camera, rng: np.random.Generator
) -> float:
    """Draw where the object stands: on the ground, where that is in view, or anywhere."""
    width, height = camera.image_size
    highest, lowest = _MARGIN_PX + _ROOM * body.mean_m * scale, height - _MARGIN_PX
    below = camera.height_m * scale * math.exp(rng.normal(0.0, _RELIEF))
    on_ground = camera.horizon_px + camera.slope * (column - width / 2) + below
    stands = body.label in PROTOTYPE or rng.random() < _UNKNOWN_ON_GROUND_SHARE
    if stands and highest <= on_ground <= lowest:
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
