"""Silhouettes: parts from the back to the front, in any unit, x to the right and y upward."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from imgscale._typing import FloatArray

Colour: TypeAlias = tuple[float, float, float]


class Silhouette(NamedTuple):
    """Parts of a thing with their colours, in a box of width and height 1, and its proportion."""

    parts: tuple[tuple[str | Colour, FloatArray], ...]
    main: Colour
    aspect: float


def _silhouette(main: Colour, *parts: tuple[str | Colour, ArrayLike]) -> Silhouette:
    """Put parts into the box of 1 that they fill."""
    outlines = [np.asarray(points, dtype=np.float64) for _, points in parts]
    corners = np.concatenate(outlines)
    low, extent = corners.min(axis=0), np.ptp(corners, axis=0)
    scaled = tuple(
        (colour, (points - low) / extent)
        for (colour, _), points in zip(parts, outlines, strict=True)
    )
    return Silhouette(scaled, main, float(extent[0] / extent[1]))


def oval(x: float, y: float, across: float, along: float) -> FloatArray:
    """Outline an ellipse by its middle and half axes."""
    angle = np.linspace(0.0, 2 * math.pi, 48, endpoint=False)
    return np.stack([x + across * np.cos(angle), y + along * np.sin(angle)], axis=-1)


def _block(left: float, low: float, right: float, high: float) -> ArrayLike:
    return [(left, low), (right, low), (right, high), (left, high)]


def _leg(x: float, hip: float, thick: float, hoof: tuple[float, float]) -> ArrayLike:
    """Outline a leg that narrows from the hip down; a hoof is its left and right end from x."""
    return [(x, hip), (x + thick, hip), (x + hoof[1], 0.0), (x + hoof[0], 0.0)]


_SKIN, _HAIR, _DARK = (0.87, 0.68, 0.55), (0.29, 0.21, 0.16), (0.17, 0.18, 0.21)
_GLASS, _STEEL, WHITE = (0.72, 0.82, 0.88), (0.72, 0.73, 0.74), (0.95, 0.95, 0.93)
_FUR, _LEAF, _BARK = (0.64, 0.42, 0.26), (0.36, 0.52, 0.30), (0.42, 0.33, 0.25)


def _person() -> Silhouette:
    return _silhouette(
        (0.25, 0.44, 0.66),
        (_DARK, [(-0.15, 0.86), (0.0, 0.86), (-0.03, 0.06), (-0.13, 0.06)]),
        (_DARK, [(0.15, 0.86), (0.0, 0.86), (0.03, 0.06), (0.13, 0.06)]),
        ((0.12, 0.1, 0.1), [(-0.17, 0), (-0.02, 0), (-0.02, 0.06), (-0.06, 0.1), (-0.13, 0.1)]),
        ((0.12, 0.1, 0.1), [(0.17, 0), (0.02, 0), (0.02, 0.06), (0.06, 0.1), (0.13, 0.1)]),
        (_SKIN, oval(-0.23, 0.76, 0.035, 0.055)),
        (_SKIN, oval(0.23, 0.76, 0.035, 0.055)),
        ("dark", [(-0.19, 1.43), (-0.26, 0.78), (-0.2, 0.78), (-0.12, 1.3)]),
        ("dark", [(0.19, 1.43), (0.26, 0.78), (0.2, 0.78), (0.12, 1.3)]),
        ("main", [(-0.06, 1.49), (-0.19, 1.44), (-0.14, 0.84), (0.14, 0.84), (0.19, 1.44),
                  (0.06, 1.49)]),
        (_SKIN, _block(-0.05, 1.45, 0.05, 1.56)),
        (_HAIR, oval(0.0, 1.64, 0.095, 0.11)),
        (_SKIN, oval(0.0, 1.615, 0.082, 0.105)),
        (_HAIR, [(-0.085, 1.65), (-0.06, 1.72), (0.0, 1.74), (0.06, 1.72), (0.085, 1.65),
                 (0.03, 1.69), (-0.04, 1.69)]),
    )  # fmt: skip


def _car() -> Silhouette:
    wheels = [
        (colour, oval(x, 0.33, radius, radius))
        for x in (-1.3, 1.35)
        for colour, radius in ((_DARK, 0.33), (_STEEL, 0.2), ((0.5, 0.51, 0.53), 0.06))
    ]
    return _silhouette(
        (0.70, 0.22, 0.20),
        ("main", [(-2.1, 0.3), (2.14, 0.3), (2.2, 0.5), (2.17, 0.72), (1.95, 0.86), (1.05, 0.98),
                  (0.35, 1.46), (0.1, 1.52), (-0.95, 1.52), (-1.3, 1.44), (-1.85, 1.0),
                  (-2.12, 0.94), (-2.18, 0.6)]),
        (_GLASS, [(0.85, 1.0), (0.28, 1.4), (0.05, 1.44), (-0.25, 1.44), (-0.25, 0.98)]),
        (_GLASS, [(-0.35, 1.44), (-0.9, 1.44), (-1.18, 1.38), (-1.55, 1.03), (-0.35, 0.98)]),
        ("dark", _block(-0.33, 0.36, -0.27, 0.96)),
        ("dark", _block(-0.6, 0.84, -0.42, 0.88)),
        ((0.98, 0.9, 0.6), [(2.17, 0.72), (1.95, 0.84), (1.9, 0.74)]),
        ((0.55, 0.1, 0.1), [(-2.12, 0.94), (-2.16, 0.74), (-2.02, 0.78), (-2.0, 0.92)]),
        *wheels,
    )  # fmt: skip


def _door() -> Silhouette:
    panels = [
        ("dark", _block(x, low, x + 0.26, high))
        for x in (0.14, 0.5)
        for low, high in ((0.18, 0.9), (1.08, 1.85))
    ]
    return _silhouette(
        (0.47, 0.33, 0.23), ("main", _block(0, 0, 0.9, 2.03)), *panels,
        (_STEEL, oval(0.82, 1.0, 0.035, 0.035)),
    )  # fmt: skip


def _pole() -> Silhouette:
    bands = [("main" if n % 2 else WHITE, _block(0, n / 10, 0.07, (n + 1) / 10)) for n in range(10)]
    return _silhouette((0.78, 0.16, 0.14), *bands)


def _bottle() -> Silhouette:
    return _silhouette(
        (0.20, 0.42, 0.30),
        ("main", [(-3.6, 0), (3.6, 0), (3.7, 0.5), (3.7, 16), (3.0, 19), (1.4, 22), (1.3, 28),
                  (-1.3, 28), (-1.4, 22), (-3.0, 19), (-3.7, 16), (-3.7, 0.5)]),
        (WHITE, _block(-3.7, 6, 3.7, 13)),
        ((0.75, 0.62, 0.3), _block(-1.5, 27, 1.5, 30)),
    )  # fmt: skip


def _statue() -> Silhouette:
    person = [
        ("dark" if colour == "dark" else "main", points * (0.9, 1.75) + (0.15, 0.85))
        for colour, points in _person().parts
    ]
    return _silhouette(
        (0.42, 0.55, 0.48),
        ((0.66, 0.65, 0.62), _block(0.0, 0.0, 1.2, 0.14)),
        ((0.72, 0.71, 0.68), _block(0.1, 0.14, 1.1, 0.8)),
        ((0.62, 0.61, 0.58), _block(0.04, 0.8, 1.16, 0.88)),
        ((0.55, 0.5, 0.36), _block(0.35, 0.35, 0.85, 0.6)),
        *person,
    )


def _tree() -> Silhouette:
    crown = [
        (_LEAF, oval(x, y, r, 0.9 * r))
        for x, y, r in ((-0.9, 2.9, 0.9), (0.9, 2.8, 0.95), (0.0, 3.3, 1.2), (0.0, 4.1, 0.95))
    ]
    lights = [
        ((0.43, 0.59, 0.35), oval(x, y, r, 0.8 * r))
        for x, y, r in ((-0.8, 3.1, 0.5), (0.2, 4.3, 0.55), (-0.2, 3.4, 0.6))
    ]
    return _silhouette(
        _LEAF, (_BARK, [(-0.25, 0), (0.25, 0), (0.13, 2.6), (-0.13, 2.6)]), *crown, *lights
    )


def _cone() -> Silhouette:
    return _silhouette(
        (0.92, 0.42, 0.12),
        (_DARK, _block(-20, 0, 20, 4)),
        ("main", [(-14, 4), (14, 4), (3, 72), (-3, 72)]),
        (WHITE, [(-10.5, 26), (10.5, 26), (8, 41), (-8, 41)]),
    )


def _roe_deer() -> Silhouette:
    legs = [
        (_FUR if n % 2 else (0.5, 0.33, 0.21), _leg(x, 0.45, 0.1, (0.01, 0.05)))
        for n, x in enumerate((-0.42, -0.34, 0.2, 0.28))
    ]
    return _silhouette(
        _FUR,
        *legs,
        ("main", oval(-0.02, 0.52, 0.43, 0.15)),
        ((0.93, 0.9, 0.84), oval(-0.42, 0.55, 0.05, 0.07)),
        ("main", [(0.2, 0.62), (0.38, 0.42), (0.52, 0.78), (0.42, 0.86)]),
        ("main", oval(0.5, 0.82, 0.085, 0.055)),
        ("main", oval(0.58, 0.79, 0.065, 0.035)),
        (_DARK, oval(0.63, 0.79, 0.016, 0.018)),
        ("main", [(0.42, 0.85), (0.36, 0.97), (0.46, 0.87)]),
        ("main", [(0.46, 0.86), (0.47, 0.98), (0.51, 0.86)]),
        (_DARK, oval(0.51, 0.835, 0.012, 0.013)),
    )


def _wild_boar() -> Silhouette:
    legs = [(_DARK, _leg(x, 0.35, 0.13, (0.02, 0.08))) for x in (-0.5, -0.38, 0.12, 0.24)]
    return _silhouette(
        (0.34, 0.28, 0.24),
        *legs,
        ("main", oval(-0.08, 0.5, 0.52, 0.25)),
        ("main", oval(0.16, 0.56, 0.3, 0.24)),
        ("main", [(0.3, 0.74), (0.25, 0.34), (0.62, 0.28), (0.7, 0.36), (0.52, 0.6)]),
        ((0.5, 0.4, 0.36), oval(0.68, 0.325, 0.03, 0.045)),
        ("dark", [(0.3, 0.7), (0.33, 0.84), (0.42, 0.66)]),
        (WHITE, [(0.58, 0.36), (0.62, 0.43), (0.61, 0.34)]),
        ("dark", [(-0.58, 0.55), (-0.62, 0.3), (-0.59, 0.3), (-0.54, 0.5)]),
        (_DARK, oval(0.47, 0.53, 0.014, 0.014)),
    )


def _fox() -> Silhouette:
    legs = [((0.3, 0.2, 0.15), _leg(x, 0.2, 0.06, (0.01, 0.04))) for x in (-0.2, -0.13, 0.12, 0.19)]
    return _silhouette(
        (0.78, 0.42, 0.17),
        *legs,
        ("main", [(-0.22, 0.28), (-0.4, 0.16), (-0.56, 0.12), (-0.5, 0.22), (-0.24, 0.34)]),
        (WHITE, [(-0.5, 0.135), (-0.56, 0.12), (-0.52, 0.19)]),
        ("main", oval(0.0, 0.26, 0.25, 0.085)),
        ("main", [(0.14, 0.22), (0.24, 0.3), (0.3, 0.4), (0.16, 0.33)]),
        ("main", oval(0.29, 0.36, 0.075, 0.055)),
        (WHITE, [(0.28, 0.31), (0.42, 0.32), (0.31, 0.355)]),
        (_DARK, oval(0.415, 0.325, 0.013, 0.012)),
        ("main", [(0.22, 0.39), (0.22, 0.47), (0.28, 0.41)]),
        ("main", [(0.28, 0.4), (0.31, 0.47), (0.33, 0.39)]),
    )


def _house() -> Silhouette:
    windows = [
        (_GLASS, _block(x, y, x + 0.9, y + 1.3)) for x in (0.9, 2.7, 5.4, 7.2) for y in (1.0, 4.0)
    ]
    return _silhouette(
        (0.86, 0.79, 0.68), ("main", _block(0, 0, 9, 6.2)), ((0.62, 0.35, 0.28), [
            (-0.4, 6.1), (9.4, 6.1), (7.6, 8.6), (1.4, 8.6)]), *windows,
        ((0.4, 0.3, 0.25), _block(4.0, 0.0, 5.0, 2.2)),
    )  # fmt: skip


SILHOUETTES: Mapping[str, Silhouette] = {
    "person": _person(),
    "car": _car(),
    "door": _door(),
    "pole": _pole(),
    "bottle": _bottle(),
    "statue": _statue(),
    "tree": _tree(),
    "traffic cone": _cone(),
    "roe deer": _roe_deer(),
    "wild boar": _wild_boar(),
    "fox": _fox(),
    "house": _house(),
}
SHAPES: tuple[str, ...] = tuple(SILHOUETTES)
