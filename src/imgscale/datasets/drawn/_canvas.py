"""A picture in the making: what is painted last hides what was there."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from imgscale._typing import BoolArray, FloatArray
from imgscale.datasets.drawn._floors import rays_of
from imgscale.datasets.drawn.camera import DrawnCamera

Place: TypeAlias = tuple[slice, slice]  # rows and columns of a part of the picture
_SUB = 5  # outlines are drawn so many times finer, for smooth edges


class Canvas:
    """Colours 0 to 1, z-depth, and whose each pixel is: -1 where it is nobody's."""

    def __init__(self, camera: DrawnCamera, colours: FloatArray, z: FloatArray) -> None:
        self.camera = camera
        self.colours, self.z = colours.copy(), z.copy()
        self.owner = np.full(z.shape, -1)
        self.rays = rays_of(camera)

    def cover(self, outline: FloatArray) -> tuple[Place, FloatArray]:
        """Say how much of each pixel lies within an outline in pixels, on the part it touches."""
        from PIL import Image, ImageDraw  # noqa: PLC0415 - 20 ms that most users do not need

        height, width = self.z.shape
        low, high = np.floor(outline.min(axis=0)), np.ceil(outline.max(axis=0))
        left, right = (int(np.clip(x, 0, width)) for x in (low[0], high[0]))
        top, bottom = (int(np.clip(y, 0, height)) for y in (low[1], high[1]))
        fine = Image.new("L", ((right - left) * _SUB, (bottom - top) * _SUB))
        corners = (outline - (left, top)) * _SUB - 0.5  # PIL counts from the pixels' centres
        if fine.width and fine.height:
            ImageDraw.Draw(fine).polygon(corners.ravel().tolist(), fill=1)
        parts = np.asarray(fine).reshape(bottom - top, _SUB, right - left, _SUB)
        cover = parts.mean(axis=(1, 3), dtype=np.float64)
        return (slice(top, bottom), slice(left, right)), cover

    def blend(self, place: Place, cover: FloatArray, colour: FloatArray) -> None:
        """Lay a colour over a part by shares, 0 to 1."""
        part = self.colours[place]
        part += cover[..., None] * (colour - part)

    def fill(
        self, outline: FloatArray, colour: ArrayLike, alpha: float = 1.0
    ) -> tuple[Place, FloatArray]:
        """Lay a colour over what lies within an outline; how much of each pixel that is."""
        place, cover = self.cover(outline)
        self.blend(place, alpha * cover, np.asarray(colour, dtype=np.float64))
        return place, cover

    def own(self, place: Place, where: BoolArray, z: FloatArray, number: int) -> None:
        """Give pixels of a part to a thing, with its z-depth."""
        self.z[place][where] = z[where]
        self.owner[place][where] = number
