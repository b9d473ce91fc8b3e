"""Pictures of results. Functions take ``ax=None`` and return the axes; nothing is shown."""

from __future__ import annotations

from imgscale.plotting.sizes import draw_sizes

__all__ = ["draw_sizes"]
