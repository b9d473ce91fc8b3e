"""Upright things as a camera sees them."""

from __future__ import annotations

import numpy as np

from imgscale._typing import Box, FloatArray
from imgscale.datasets.drawn._canvas import Canvas
from imgscale.datasets.drawn._floors import hazy
from imgscale.datasets.drawn._silhouettes import SILHOUETTES, Colour, oval
from imgscale.datasets.drawn.camera import NEAREST_M, DrawnCamera
from imgscale.datasets.drawn.thing import Thing


def box_of(camera: DrawnCamera, thing: Thing) -> Box:
    """Box the whole thing exactly, in view or not."""
    corners = np.concatenate([outline for _, outline in _outlines(camera, thing)])
    x1, y1 = corners.min(axis=0).tolist()
    x2, y2 = corners.max(axis=0).tolist()
    return (x1, y1, x2, y2)


def stand(canvas: Canvas, thing: Thing, number: int) -> None:
    """Paint a thing with its shadow."""
    _shadow(canvas, thing)
    shape = SILHOUETTES[thing.drawn_as]
    main = shape.main if thing.colour is None else thing.colour
    tones = {"main": main, "dark": tuple(0.72 * part for part in main)}
    covered = np.zeros(canvas.z.shape)
    for role, outline in _outlines(canvas.camera, thing):
        colour = np.array(tones[role] if isinstance(role, str) else role)
        place, cover = canvas.cover(outline)
        lit = np.linspace(1.06, 0.94, cover.shape[1])[None, :, None]
        canvas.blend(place, cover, hazy(np.clip(colour * lit, 0, 1), thing.ahead_m))
        covered[place] = 1 - (1 - covered[place]) * (1 - cover)
    everywhere = (slice(None), slice(None))
    canvas.own(everywhere, covered > 0.5, thing.ahead_m / canvas.rays[2], number)


def _outlines(camera: DrawnCamera, thing: Thing) -> list[tuple[str | Colour, FloatArray]]:
    """Project the parts of a thing."""
    outlines: list[tuple[str | Colour, FloatArray]] = []
    for role, points in SILHOUETTES[thing.drawn_as].parts:
        x, y = points.T
        across = (0.5 - x if thing.mirrored else x - 0.5) * thing.drawn_width_m
        up = thing.up_m + y * thing.height_m
        places = np.column_stack([thing.right_m + across, up, np.full(len(x), thing.ahead_m)])
        outlines.append((role, camera.project(places)))
    return outlines


def _shadow(canvas: Canvas, thing: Thing) -> None:
    if thing.up_m > 0.05 or thing.drawn_as == "door":
        return
    across, along = 0.55 * thing.drawn_width_m, min(0.16 * thing.drawn_width_m, 0.4)
    for share in (1.0, 0.8):
        ring = oval(thing.right_m, thing.ahead_m, share * across, share * along)
        places = np.column_stack([ring[:, 0], np.zeros(len(ring)), ring[:, 1]])
        if (canvas.camera.in_camera(places)[:, 2] > NEAREST_M).all():
            canvas.fill(canvas.camera.project(places), (0.1, 0.1, 0.12), 0.21)
