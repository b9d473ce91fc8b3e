"""Published data as the package's own types, a photo to try, and drawn scenes with their truth."""

from __future__ import annotations

from imgscale.datasets import drawn, kitti, motorcycle, paper

__all__ = ["drawn", "kitti", "motorcycle", "paper"]
