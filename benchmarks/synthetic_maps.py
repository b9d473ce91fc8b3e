"""Depth maps of synthetic scenes: a far wall, and every object a slab before it."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from itertools import combinations

import numpy as np
from validation_scenes import Box, FloatArray, Thing

_WALL_M = 100.0
# Surfaces recede behind their nearest edge by about this much, relative to the depth.
_RECESS = 0.01


def are_apart(boxes: Sequence[Box]) -> bool:
    """Tell whether no box hides a part of another, so that each shows its own depth."""
    return not any(_overlap(one, other) for one, other in combinations(boxes, 2))


def paint(things: Sequence[Thing], image_size: tuple[int, int], name: str) -> FloatArray:
    """Paint z-depth in metres over the image, the same for the same name."""
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    width, height = image_size
    depth: FloatArray = np.full((height, width), _WALL_M)
    for thing in things:
        left, top, right, bottom = (round(edge) for edge in thing.box)
        window = depth[top:bottom, left:right]
        window[:] = thing.surface_m * (1 + _RECESS * np.abs(rng.standard_normal(window.shape)))
    return depth


def _overlap(one: Box, other: Box) -> bool:
    return min(one[2], other[2]) > max(one[0], other[0]) and min(one[3], other[3]) > max(
        one[1], other[1]
    )
