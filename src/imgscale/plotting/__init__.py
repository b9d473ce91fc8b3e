"""Pictures of results. Functions take ``ax=None`` and return the axes; nothing is shown."""

from __future__ import annotations

from imgscale.plotting.ground import draw_ground_plane
from imgscale.plotting.residuals import draw_residuals
from imgscale.plotting.scale_bar import draw_scale_bar
from imgscale.plotting.scale_map import draw_scale_map
from imgscale.plotting.sizes import draw_sizes

__all__ = [
    "draw_ground_plane",
    "draw_residuals",
    "draw_scale_bar",
    "draw_scale_map",
    "draw_sizes",
]
