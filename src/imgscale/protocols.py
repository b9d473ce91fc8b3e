"""The two things that a user plugs in; any function of this shape is one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from imgscale._typing import ImageArray
from imgscale.camera import Camera
from imgscale.depth import Depth
from imgscale.detection import Detection

__all__ = ["DepthSource", "Detector"]


@runtime_checkable
class Detector(Protocol):
    """
    Finds objects in an image.

    Called with an image, (H, W, 3) uint8 RGB with its orientation applied, it returns a sequence
    of `Detection` in pixels of that image.
    """

    def __call__(self, image: ImageArray, /) -> Sequence[Detection]:
        """Detect objects."""
        ...


@runtime_checkable
class DepthSource(Protocol):
    """
    Gives the depth of an image.

    Called with an image, (H, W, 3) uint8 RGB with its orientation applied, it returns a
    `DepthMap`, `ObjectDepths` or `GroundPlane`; or a pair of that and the `Camera` that it found
    out, or None.
    """

    def __call__(self, image: ImageArray, /) -> Depth | tuple[Depth, Camera | None]:
        """Give the depth."""
        ...
