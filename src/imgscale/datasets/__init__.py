"""Published data as the package's own types."""

from __future__ import annotations

from imgscale.datasets import kitti, motorcycle, paper

__all__ = ["kitti", "motorcycle", "paper"]
