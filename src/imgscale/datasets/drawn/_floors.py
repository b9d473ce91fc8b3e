"""What things stand on, painted where each pixel's ray meets it: grounds, a hall, a table."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Literal, NamedTuple, TypeAlias, get_args

import numpy as np

from imgscale._typing import FloatArray
from imgscale.datasets.drawn._silhouettes import Colour
from imgscale.datasets.drawn.camera import DrawnCamera

Ground: TypeAlias = Literal["plain", "street", "meadow", "hall"]
GROUNDS: tuple[Ground, ...] = get_args(Ground)
_HAZE: Colour = (0.86, 0.91, 0.95)
_HAZE_M = 90.0  # two thirds of the colour are lost over this distance


def rays_of(camera: DrawnCamera) -> FloatArray:
    """Metres to the right, down and ahead for a metre of z-depth, at every pixel: (3, H, W)."""
    width, height = camera.image_size
    x = (np.arange(width) + 0.5 - width / 2) / camera.focal_px
    y = (np.arange(height) + 0.5 - height / 2) / camera.focal_px
    sight = np.stack([*np.meshgrid(x, y), np.ones((height, width))])
    turned: FloatArray = np.tensordot(camera.axes.T, sight, axes=1)
    return turned


def hazy(colour: FloatArray, distance_m: float | FloatArray) -> FloatArray:
    """Pale a colour with distance."""
    left = np.exp(-np.asarray(distance_m) / _HAZE_M)
    left = left[..., None] if left.ndim else left
    paled: FloatArray = np.array(_HAZE) + left * (colour - np.array(_HAZE))
    return paled


def _mix(below: FloatArray, colour: Colour, share: FloatArray) -> FloatArray:
    """Lay a colour over others by a share, 0 to 1."""
    mixed: FloatArray = below + share[..., None] * (np.array(colour) - below)
    return mixed


def _band(value: FloatArray, low: float, high: float, pixel: FloatArray) -> FloatArray:
    """Share of a pixel of so many metres that lies between two limits."""
    inside: FloatArray = np.clip((value - low) / pixel + 0.5, 0, 1)
    return inside * np.clip((high - value) / pixel + 0.5, 0, 1)


def _lines(value: FloatArray, spacing: float, width: float, pixel: FloatArray) -> FloatArray:
    """Share of a pixel that is covered by lines at even distances."""
    off = np.abs((value / spacing + 0.5) % 1 - 0.5) * spacing
    lines: FloatArray = np.clip((width / 2 - off) / pixel + 0.5, 0, 1)
    return lines * np.minimum(1.0, width / pixel)


class _Floor(NamedTuple):
    """Where each pixel's ray meets the ground: places, and the metres that a pixel spans there."""

    right: FloatArray
    ahead: FloatArray
    across: FloatArray
    along: FloatArray


def _open_ground(
    camera: DrawnCamera, paint: Callable[[_Floor], FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Paint level ground under the sky; its colours and z-depths."""
    right, down, ahead = rays_of(camera)
    seen = down > 1e-6
    z = np.where(seen, camera.height_m / np.where(seen, down, 1.0), np.nan)
    near = np.where(seen, np.minimum(z, 1e4), 1.0)
    across = near / camera.focal_px
    floor = _Floor(right * near, ahead * near, across, across * near / camera.height_m)
    high = np.clip(-down / np.hypot(right, ahead), 0.0, None)
    sky = _mix(np.broadcast_to(_HAZE, (*z.shape, 3)), (0.52, 0.70, 0.89), 1 - np.exp(-3.5 * high))
    return np.where(seen[..., None], hazy(paint(floor), near), sky), z


def _plain_floor(floor: _Floor) -> FloatArray:
    return np.broadcast_to((0.74, 0.73, 0.70), (*floor.right.shape, 3))


def _street_floor(floor: _Floor) -> FloatArray:
    """Lay a pavement, a road from left to right, another pavement and a lawn."""
    colours = np.broadcast_to((0.50, 0.62, 0.38), (*floor.right.shape, 3))
    bands: Sequence[tuple[float, float, Colour]] = (
        (-100.0, 20.0, (0.72, 0.70, 0.67)),
        (10.0, 17.0, (0.43, 0.44, 0.46)),
        (9.85, 10.0, (0.84, 0.83, 0.80)),
        (17.0, 17.15, (0.84, 0.83, 0.80)),
    )
    for low, high, colour in bands:
        colours = _mix(colours, colour, _band(floor.ahead, low, high, floor.along))
    dashes = _lines(floor.right, 4.0, 1.8, floor.across)
    middle = _band(floor.ahead, 13.43, 13.57, floor.along)
    colours = _mix(colours, (0.93, 0.93, 0.90), dashes * middle)
    joints = np.maximum(
        _lines(floor.right, 1.2, 0.015, floor.across), _lines(floor.ahead, 1.2, 0.015, floor.along)
    )
    paved = _band(floor.ahead, -100.0, 9.85, floor.along)
    return _mix(colours, (0.52, 0.50, 0.48), 0.6 * joints * paved)


def _meadow_floor(floor: _Floor) -> FloatArray:
    """Mottle grass; the mottles fade where they become finer than a pixel."""
    x, y = floor.right, floor.ahead
    waves = sum(
        np.sin(a * x + b * y + c) * np.exp(-(abs(a) * floor.across + abs(b) * floor.along))
        for a, b, c in ((0.7, 0.4, 0.3), (1.9, -1.1, 1.0), (-3.1, 4.3, 2.0), (9.0, 7.0, 0.4),
                        (-17.0, 21.0, 1.7), (31.0, -27.0, 0.2))
    )  # fmt: skip
    grass = np.broadcast_to((0.44, 0.55, 0.29), (*x.shape, 3))
    return _mix(grass, (0.60, 0.64, 0.36), np.clip(0.3 + 0.16 * np.asarray(waves), 0, 1))


_HALL_WIDTH_M, _HALL_LENGTH_M, _HALL_HEIGHT_M = 4.4, 6.02, 2.9


def _hall(camera: DrawnCamera) -> tuple[FloatArray, FloatArray]:
    """Paint a hall: tiles, three walls with a skirting, a ceiling."""
    right, down, ahead = rays_of(camera)
    with np.errstate(divide="ignore"):
        planes = np.stack([
            camera.height_m / down,
            _HALL_LENGTH_M / ahead,
            _HALL_WIDTH_M / 2 / right,
            -_HALL_WIDTH_M / 2 / right,
            (camera.height_m - _HALL_HEIGHT_M) / down,
        ])  # fmt: skip
    planes[planes <= 0] = np.inf
    first, z = planes.argmin(axis=0), planes.min(axis=0)
    x, up, y = right * z, camera.height_m - down * z, ahead * z
    pixel = z / camera.focal_px
    tiles = np.broadcast_to((0.75, 0.72, 0.66), (*z.shape, 3))
    seams = np.maximum(_lines(x, 0.4, 0.012, pixel), _lines(y, 0.4, 0.012, pixel))
    tiles = _mix(tiles, (0.56, 0.53, 0.48), 0.8 * seams)
    tones = np.array([(0, 0, 0), (0.85, 0.86, 0.83), (0.76, 0.78, 0.76), (0.79, 0.81, 0.79),
                      (0.93, 0.93, 0.92)])  # fmt: skip
    walls = _mix(tones[first], (0.45, 0.43, 0.40), _band(up, -1.0, 0.09, pixel))
    return np.where((first == 0)[..., None], tiles, walls), z


_FLOORS: Mapping[Ground, Callable[[_Floor], FloatArray]] = {
    "plain": _plain_floor,
    "street": _street_floor,
    "meadow": _meadow_floor,
}


@functools.lru_cache(maxsize=8)
def ground_of(camera: DrawnCamera, ground: Ground) -> tuple[FloatArray, FloatArray]:
    """Paint a scene without anything in it, once; its colours and z-depths."""
    return _hall(camera) if ground == "hall" else _open_ground(camera, _FLOORS[ground])


def table_of(camera: DrawnCamera) -> tuple[FloatArray, FloatArray]:
    """Paint planks, seen from straight above; their colours and z-depths."""
    places = rays_of(camera) * camera.height_m
    right, ahead = places[0], places[2]
    plank = np.floor(ahead / 0.11)
    grain = np.sin(900 * ahead + 3 * np.sin(14 * right + 5 * plank)) * np.sin(33 * right + plank)
    tone = 0.5 + 0.22 * np.sin(2.4 * plank) + 0.1 * grain
    wood = np.broadcast_to((0.80, 0.66, 0.48), (*places.shape[1:], 3))
    pixel = np.full(places.shape[1:], camera.height_m / camera.focal_px)
    joints = 0.6 * _lines(ahead, 0.11, 0.001, pixel)
    planks = _mix(_mix(wood, (0.67, 0.52, 0.35), tone), (0.35, 0.25, 0.16), joints)
    z: FloatArray = np.full(places.shape[1:], camera.height_m)
    return planks, z
