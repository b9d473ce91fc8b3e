"""
Small drawn scenes in which everything is known: to try things out, to teach and to test.

A pinhole camera sees flat, upright silhouettes that stand on level ground, or fruit on a table.
Picture, boxes, masks and depth come from the same geometry, so sizes, distances and the camera are
exact, and a measurement can be compared with the truth. With an `rng` the boxes err as those of a
detector do.

`street`, `camera_trap`, `camera_trap_poles`, `hallway` and `table_top` are ready; `draw` makes a
scene of your own from `Thing` objects.
"""

from __future__ import annotations

from imgscale.datasets.drawn._silhouettes import SHAPES
from imgscale.datasets.drawn.camera import DrawnCamera
from imgscale.datasets.drawn.drawing import draw
from imgscale.datasets.drawn.scene import DrawnScene
from imgscale.datasets.drawn.scenes import (
    camera_trap,
    camera_trap_poles,
    hallway,
    street,
    table_top,
)
from imgscale.datasets.drawn.thing import Thing

__all__ = [
    "SHAPES",
    "DrawnCamera",
    "DrawnScene",
    "Thing",
    "camera_trap",
    "camera_trap_poles",
    "draw",
    "hallway",
    "street",
    "table_top",
]
