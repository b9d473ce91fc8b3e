"""
A drawn world for the examples: what a pinhole camera sees of upright things on level ground.

Everything is known in it, so that an example can compare what it finds with the truth.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

import imgscale as ims

Box = tuple[float, float, float, float]
Place = tuple[float, float, float]
"""Metres to the right, up from the ground, and ahead, from the point below the camera."""

_MARGIN_PX = 12
_GROUND_M = 0.02  # how far the ground of the camera trap is from level: grass and dips
_SPECIES = {  # mean height, its spread between animals, and length, in metres
    "roe deer": (0.92, 0.09, 1.1),
    "wild boar": (0.78, 0.09, 1.3),
    "fox": (0.44, 0.04, 0.7),
}


class DrawnCamera(NamedTuple):
    """A camera above level ground, tilted downward and a little sideways."""

    image_size: tuple[int, int]
    focal_px: float
    height_m: float
    pitch_deg: float
    roll_deg: float

    @property
    def horizon_px(self) -> float:
        """Row of the horizon in the middle column, in pixels."""
        pitch, roll = math.radians(self.pitch_deg), math.radians(self.roll_deg)
        return self.image_size[1] / 2 - self.focal_px * math.tan(pitch) / math.cos(roll)

    def project(self, points: ArrayLike) -> NDArray[np.float64]:
        """Find the column and the row at which each of many places is seen."""
        right, up, ahead = np.asarray(points, dtype=np.float64).T
        down = self.height_m - up
        pitch, roll = math.radians(self.pitch_deg), math.radians(self.roll_deg)
        z_depth = ahead * math.cos(pitch) + down * math.sin(pitch)
        below = down * math.cos(pitch) - ahead * math.sin(pitch)
        column = right * math.cos(roll) - below * math.sin(roll)
        row = right * math.sin(roll) + below * math.cos(roll)
        seen = np.stack([column, row], axis=-1) / z_depth[:, None]
        return np.array(self.image_size) / 2 + self.focal_px * seen

    def box(self, place: Place, height_m: float, width_m: float) -> Box:
        """Box an upright, flat thing whose foot is at a place, without any error."""
        right, up, ahead = place
        corners = [
            (right + side * width_m / 2, up + part * height_m, ahead)
            for side in (-1, 1)
            for part in (0, 1)
        ]
        seen = self.project(corners)
        x1, y1 = seen.min(axis=0).tolist()
        x2, y2 = seen.max(axis=0).tolist()
        return (x1, y1, x2, y2)

    def shows(self, box: Box) -> bool:
        """Tell whether a box is in full view."""
        x1, y1, x2, y2 = box
        width, height = (length - _MARGIN_PX for length in self.image_size)
        return min(x1, y1) > _MARGIN_PX and x2 < width and y2 < height


def blurred(box: Box, rng: np.random.Generator, *, box_px: float, box_rel: float = 0.0) -> Box:
    """Move the edges of a box as `imgscale.Noise` means it: its extents err by both together."""
    x1, y1, x2, y2 = box
    across, along = (
        rng.normal(0.0, math.hypot(box_px, box_rel * extent) / math.sqrt(2), 2)
        for extent in (x2 - x1, y2 - y1)
    )
    left, right = sorted((x1 + float(across[0]), x2 + float(across[1])))
    return (left, y1 + float(along[0]), right, y2 + float(along[1]))


class DrawnAnimal(NamedTuple):
    """An animal as a detector boxes it, its height, and its distance over the ground."""

    detection: ims.Detection
    height_m: float
    distance_m: float


def draw_poles(
    camera: DrawnCamera, rng: np.random.Generator, *, box_px: float, box_rel: float
) -> list[ims.Detection]:
    """Carry a pole of 1 m to a dozen places: left, middle and right at four distances."""
    poles = []
    for ahead in (3.0, 5.0, 8.0, 12.0):
        for side in (-0.4, 0.0, 0.4):
            box = camera.box((side * ahead, rng.normal(0.0, _GROUND_M), ahead), 1.0, 0.1)
            seen = blurred(box, rng, box_px=box_px, box_rel=box_rel)
            poles.append(ims.Detection("pole", seen))
    return poles


def draw_animals(
    camera: DrawnCamera, rng: np.random.Generator, *, box_px: float, box_rel: float
) -> list[DrawnAnimal]:
    """Draw the one, two or three animals of a picture, anywhere in view, at any angle."""
    animals: list[DrawnAnimal] = []
    wanted = rng.integers(1, 4)
    while len(animals) < wanted:
        species = str(rng.choice(list(_SPECIES)))
        mean, spread, length = _SPECIES[species]
        height, ahead = rng.normal(mean, spread), rng.uniform(2.5, 14.0)
        right, up = ahead * rng.uniform(-0.6, 0.6), rng.normal(0.0, _GROUND_M)
        box = camera.box((right, up, ahead), height, length * rng.uniform(0.4, 1.0))
        if camera.shows(box):
            seen = blurred(box, rng, box_px=box_px, box_rel=box_rel)
            animals.append(
                DrawnAnimal(ims.Detection(species, seen), height, math.hypot(right, ahead))
            )
    return animals
