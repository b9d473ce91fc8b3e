"""What the validation asks of an image: its objects, with their true heights and depths."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Box: TypeAlias = tuple[float, float, float, float]
FloatArray: TypeAlias = NDArray[np.float64]

# The labels that count as known, whatever else a table of sizes may hold.
KNOWN = ("Car", "Van", "Truck", "Pedestrian", "Cyclist", "Tram")
# The known ones from which objects of unknown class are sized.
REFERENCES = ("Car", "Pedestrian", "Cyclist")
# The classes taken as unknown there, and the label they are given, which no table has.
UNKNOWN = ("Van", "Truck", "Tram", "Misc", "Person_sitting")
NO_LABEL = "unknown"

_BORDER_PX = 2.0
_LOWEST_PX = 25.0


@dataclass(frozen=True, slots=True)
class Thing:
    """One object, as the source of the box saw it and as it is."""

    index: int
    """Its place among the objects of the image: the same in every row, so that noise is too."""
    label: str
    """Its class, as the source of the box says."""
    box: Box
    height_m: float
    """Its true height."""
    surface_m: float
    """The true z-depth of its nearest vertical edge."""
    centre_m: float
    """The true z-depth of its centre."""
    track: str = ""
    """Names it in all images of its drive."""

    @property
    def pixels(self) -> float:
        """The height of its box."""
        return self.box[3] - self.box[1]


@dataclass(frozen=True, eq=False)
class Scene:
    """One image."""

    name: str
    drive: str
    """Images of one drive are not independent: they are drawn together in the bootstrap."""
    time: int
    """Its place in the order of its drive."""
    image_size: tuple[int, int]
    focal_px: float
    camera_height_m: float
    """Above the ground, as far as it is known, like the next."""
    horizon_px: float
    """The row of the horizon."""
    things: tuple[Thing, ...]
    detected: Mapping[str, tuple[Thing, ...]] = field(default_factory=dict)
    """By detector: those of the objects that it found, with its boxes and labels."""
    read_depth_map: Callable[[], FloatArray] | None = None
    """Reads a map of z-depth in metres, where there is one."""


def in_full_view(box: Box, image_size: tuple[int, int]) -> bool:
    """Tell whether a box keeps clear of the image's border."""
    left, top, right, bottom = box
    width, height = image_size
    return (
        min(left, top) >= _BORDER_PX
        and right <= width - _BORDER_PX
        and bottom <= height - _BORDER_PX
    )


def is_high(box: Box) -> bool:
    """Tell whether a box is high enough for its height to mean something."""
    return box[3] - box[1] >= _LOWEST_PX
