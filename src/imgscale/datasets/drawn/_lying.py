"""Discs and balls on a table, as a camera straight above sees them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from imgscale._typing import Box, FloatArray
from imgscale.datasets.drawn._canvas import Canvas
from imgscale.datasets.drawn._silhouettes import Colour, oval
from imgscale.datasets.drawn.camera import DrawnCamera

_LIGHT: FloatArray = np.array([-0.45, -0.5, -0.74])
_STALK: Colour = (0.30, 0.28, 0.12)
_SHADOW: Colour = (0.2, 0.13, 0.08)


class Lying(NamedTuple):
    """A disc or a ball; one without thickness is a ball."""

    label: str
    right_m: float
    ahead_m: float
    diameter_m: float
    colour: Colour
    inner: Colour = (0.0, 0.0, 0.0)
    thickness_m: float | None = None

    @property
    def widest_m(self) -> float:
        """How high its widest part is above the table."""
        return self.diameter_m / 2 if self.thickness_m is None else self.thickness_m


def lying_box(camera: DrawnCamera, thing: Lying) -> Box:
    """Box a disc by its upper rim, a ball by the planes through the camera that touch it."""
    middle = camera.in_camera([(thing.right_m, thing.widest_m, thing.ahead_m)])[0].tolist()
    radius, focal = thing.diameter_m / 2, camera.focal_px
    edges: list[list[float]] = []
    for offset, length in zip(middle[:2], camera.image_size, strict=True):
        if thing.thickness_m is None:
            angle = math.atan2(offset, middle[2])
            half = math.asin(radius / math.hypot(offset, middle[2]))
            tangents = [math.tan(angle - half), math.tan(angle + half)]
        else:
            tangents = [(offset - radius) / middle[2], (offset + radius) / middle[2]]
        edges.append([length / 2 + focal * tangent for tangent in tangents])
    return (edges[0][0], edges[1][0], edges[0][1], edges[1][1])


def lay(canvas: Canvas, things: list[Lying]) -> None:
    """Paint things that do not touch, and under them their shadows."""
    for thing in things:
        moved = thing._replace(right_m=thing.right_m + 0.006, ahead_m=thing.ahead_m - 0.006)
        canvas.fill(_circle(canvas.camera, moved, 1.04, 0.0), _SHADOW, 0.35)
    for number, thing in enumerate(things):
        (_ball if thing.thickness_m is None else _disc)(canvas, thing, number)


def _disc(canvas: Canvas, thing: Lying, number: int) -> None:
    """Paint a flat round thing: its edge, its body, what is within."""
    body: FloatArray = np.array(thing.colour)
    rim = _circle(canvas.camera, thing, 1.0, thing.widest_m)
    place, cover = canvas.fill(rim, 0.8 * body)
    for share, colour in ((0.9, body), (0.72, np.array(thing.inner))):
        canvas.fill(_circle(canvas.camera, thing, share, thing.widest_m), colour)
    z = canvas.camera.height_m - thing.widest_m
    canvas.own(place, cover > 0.5, np.full(cover.shape, z), number)


def _ball(canvas: Canvas, thing: Lying, number: int) -> None:
    """Paint a sphere, lit from the upper left."""
    x1, y1, x2, y2 = lying_box(canvas.camera, thing)
    place = (slice(max(int(y1) - 2, 0), int(y2) + 3), slice(max(int(x1) - 2, 0), int(x2) + 3))
    shape, radius = canvas.z[place].shape, thing.diameter_m / 2
    middle = canvas.camera.in_camera([(thing.right_m, radius, thing.ahead_m)])[0]
    sight: FloatArray = canvas.camera.axes @ canvas.rays[:, *place].reshape(3, -1)  # x', y' and 1
    along, length2 = middle @ sight, (sight**2).sum(axis=0)
    inside = along**2 - length2 * (middle @ middle - radius**2)
    z = (along - np.sqrt(np.maximum(inside, 0.0))) / length2
    light = np.clip(_LIGHT @ (sight * z - middle[:, None]) / radius, 0.0, 1.0)
    tone = (0.42 + 0.62 * light)[:, None] * np.array(thing.colour) + 0.35 * light[:, None] ** 24
    gap_m = inside / length2 / thing.diameter_m  # of the ray from the sphere's edge, near it
    cover = np.clip(gap_m * canvas.camera.focal_px / middle[2] + 0.5, 0.0, 1.0)
    canvas.blend(place, cover.reshape(shape), np.clip(tone, 0, 1).reshape(*shape, 3))
    canvas.own(place, (inside >= 0).reshape(shape), z.reshape(shape), number)
    canvas.fill(_circle(canvas.camera, thing, 0.05, thing.diameter_m), _STALK, 0.8)


def _circle(camera: DrawnCamera, thing: Lying, share: float, up_m: float) -> FloatArray:
    """Project a level circle around a thing, so many times as wide as it."""
    radius = share * thing.diameter_m / 2
    ring = oval(thing.right_m, thing.ahead_m, radius, radius)
    return camera.project(np.column_stack([ring[:, 0], np.full(len(ring), up_m), ring[:, 1]]))
