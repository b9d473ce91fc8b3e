"""What a run shows the library of one scene: boxes, labels and depths, with their noise."""

from __future__ import annotations

import functools
import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from validation_runs import Damage, Run
from validation_scenes import KNOWN, NO_LABEL, REFERENCES, UNKNOWN, Box, FloatArray, Scene, Thing

import imgscale as ims

SEED = 20261
# Unknown factors of depth lie within this factor of 1.
_LARGEST_FACTOR = 100.0
_DAMAGED_SHARE = 0.2
_CUT_SHARE = 0.4
_HALF = 0.5
_SWAPPED = ("Car", "Van", "Pedestrian", "Cyclist")


@dataclass(frozen=True)
class View:
    """The objects of one image that take part in a run."""

    scene: Scene
    run: Run
    references: tuple[Thing, ...]
    targets: tuple[Thing, ...]
    """In the protocols that leave one out, the same as the references."""
    learned: float | None = None
    """The depth noise that the drive showed, where the run asks for it."""

    @property
    def noise(self) -> ims.Noise:
        """What the library is told of the errors."""
        noise = self.run.noise
        if self.learned is None:
            return noise
        return ims.Noise(box_px=noise.box_px, box_rel=noise.box_rel, depth_rel=self.learned)

    @property
    def ground(self) -> ims.GroundPlane:
        """The plane on which objects stand, of which nothing is known."""
        return ims.GroundPlane(image_size=self.scene.image_size)

    def depth(self, things: Sequence[Thing]) -> ims.Depth:
        """Give the depth of some of the objects."""
        if self.run.kind == "ground_plane":
            return self.ground
        if self.run.depth == "map":
            return _depth_map(self.scene)
        options: dict[str, Any] = {}
        if self.run.depth == "corrected":
            options["depth_at"] = "centre"
        return ims.ObjectDepths(
            self.depth_values(things),
            kind=self.run.kind,
            image_size=self.scene.image_size,
            **options,
        )

    def depth_values(self, things: Sequence[Thing]) -> FloatArray:
        """Draw what a source of depth says of some of the objects, always the same."""
        surface = self.run.depth == "surface"
        true = np.array([thing.surface_m if surface else thing.centre_m for thing in things])
        noise = _stream(self.scene, "depth").standard_normal(_count(self.scene))
        metres = true * np.exp(self.run.depth_noise * noise[[thing.index for thing in things]])
        source = _stream(self.scene, "scale")
        factor = math.exp(source.uniform(-1.0, 1.0) * math.log(_LARGEST_FACTOR))
        shift = self.run.shift_std * source.standard_normal()
        values: dict[str, FloatArray] = {
            "metric": metres,
            "relative": factor * metres,
            "inverse": factor / metres,
            "affine_inverse": factor * (1 / metres + shift),
        }
        return values[self.run.kind]

    def reference_detections(self, things: Sequence[Thing]) -> list[ims.Detection]:
        """Show references, damaged where the run says so."""
        damage = self.run.damage
        if damage is None or damage == "none":
            tracks = self.run.tracks
            return [
                _detection(thing.label, thing.box, thing.track if tracks else None)
                for thing in things
            ]
        draws = _stream(self.scene, "damage").random((_count(self.scene), 4))
        return [_detection(*_damaged(thing, damage, draws[thing.index])) for thing in things]

    def target_detections(self, things: Sequence[Thing]) -> list[ims.Detection]:
        """Show targets, always whole; in protocol U their class is not known."""
        unknown = self.run.protocol == "U"
        return [_detection(NO_LABEL if unknown else thing.label, thing.box) for thing in things]


def view_of(scene: Scene, run: Run) -> View | None:
    """Choose the objects that take part; None where the image has too few."""
    if run.depth == "map" and scene.read_depth_map is None:
        return None
    references = _labelled(scene, run, REFERENCES if run.protocol == "U" else KNOWN)
    if run.protocol == "U":
        targets = _labelled(scene, run, UNKNOWN)
        enough = len(references) >= run.fewest and bool(targets)
    else:
        targets = references
        enough = len(references) >= run.fewest + (run.protocol == "L")
    return View(scene, run, references, targets) if enough else None


def frame_of(scene: Scene, run: Run) -> View | None:
    """Choose the objects of one image on which a fit of many rests; None where it has none."""
    references = _labelled(scene, run, REFERENCES if run.protocol == "U" else KNOWN)
    return View(scene, run, references, references) if references else None


def _labelled(scene: Scene, run: Run, labels: Sequence[str]) -> tuple[Thing, ...]:
    """Choose objects by the class that the source of their boxes gives them."""
    things = scene.things if run.boxes == "label" else scene.detected.get(run.boxes, ())
    return tuple(thing for thing in things if thing.label in labels)


def _stream(scene: Scene, purpose: str) -> np.random.Generator:
    """Start random numbers that depend on nothing but the image and what they are for."""
    words = (zlib.crc32(word.encode()) for word in (scene.name, purpose))
    return np.random.default_rng([SEED, *words])


def _count(scene: Scene) -> int:
    """Count the objects of the image, also those that take no part: each has its own noise."""
    return len(scene.things)


@functools.cache
def _detection(label: str, box: Box, track: str | None = None) -> ims.Detection:
    return ims.Detection(label, box, track_id=track)


@functools.lru_cache(maxsize=4)
def _depth_map(scene: Scene) -> ims.DepthMap:
    if scene.read_depth_map is None:
        msg = f"scene {scene.name} has no depth map"
        raise ValueError(msg)
    return ims.DepthMap(scene.read_depth_map(), kind="metric")


def _damaged(thing: Thing, damage: Damage, draw: FloatArray) -> tuple[str, Box]:
    """Now and then cut the box from one side, or mistake the class."""
    hit, which, side, other = (float(number) for number in draw)
    if hit >= _DAMAGED_SHARE:
        return thing.label, thing.box
    if damage == "cut" or (damage == "mixed" and which < _HALF):
        left, top, right, bottom = thing.box
        lost = _CUT_SHARE * (bottom - top)
        if side < _HALF:
            return thing.label, (left, top + lost, right, bottom)
        return thing.label, (left, top, right, bottom - lost)
    others = [label for label in _SWAPPED if label != thing.label]
    return others[int(other * len(others))], thing.box
