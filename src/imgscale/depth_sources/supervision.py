"""
Depth maps of roboflow's supervision, read and written.

Depth that ultralytics predicts needs no adapter: ``DepthMap(result.depth.data.cpu().numpy(),
kind="metric", scale_rel_std=0.15)``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from imgscale._checks import check_type
from imgscale._depth_values import valid_depths
from imgscale._optional import require
from imgscale._typing import DepthKind
from imgscale.depth_map import DepthMap

__all__ = ["from_supervision", "to_supervision"]

_DISPARITY = "disparity_px"
_KINDS: dict[str, DepthKind] = {
    "depth_m": "metric",
    _DISPARITY: "affine_inverse",
    "relative_inverse": "affine_inverse",
}


def from_supervision(
    depth_map: Any, *, image_size: Sequence[int] | None = None, scale_rel_std: float = 0.0
) -> DepthMap:
    """
    Turn a `supervision.DepthMap` into a depth map.

    =====================  ==================  ====================================================
    its kind               becomes             because
    =====================  ==================  ====================================================
    depth_m                "metric"            it is z-depth in metres
    disparity_px, camera   "metric"            z = fx_px baseline_m / (disparity + doffs_px)
    disparity_px alone     "affine_inverse"    disparity + doffs_px is the inverse depth up to a
                                               factor, and doffs_px is not known
    relative_inverse       "affine_inverse"    it is the inverse depth up to a factor and a shift,
                                               where its network is one such as MiDaS, DPT or Depth
                                               Anything 1 and 2
    =====================  ==================  ====================================================

    Parameters
    ----------
    depth_map : supervision.DepthMap
        The map. It is neither imported nor changed: anything with `to_float`, `kind` and `camera`
        will do.
    image_size : (width, height), optional
        Size in pixels of the picture that boxes refer to; the map's own size where omitted.
    scale_rel_std : float
        Relative standard error of the scale of metric depth, >= 0: 0 for LiDAR and calibrated
        stereo, about 0.15 for networks that predict metres.

    Returns
    -------
    DepthMap
        The map, NaN where it has no depth. Metres out of disparity are float64, other values keep
        their float32.

    Raises
    ------
    TypeError
        If it, or the camera of its disparity, is something else.
    ValueError
        If its kind is unknown or it holds no depth at all.

    Notes
    -----
    A free shift takes references at two depths or more. Disparity of a pair that is known to have
    its principal points in one place has none: ``DepthMap(depth_map.to_float(), kind="inverse")``.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> import numpy as np
    >>> from imgscale.depth_sources.supervision import from_supervision
    >>> camera = SimpleNamespace(fx_px=1000.0, baseline_m=0.1, doffs_px=0.0)
    >>> theirs = SimpleNamespace(  # such as supervision.DepthMap.from_pfm(...)
    ...     kind="disparity_px", camera=camera, to_float=lambda: np.array([[20.0, np.nan]]))
    >>> from_supervision(theirs).values
    array([[ 5., nan]])
    """
    kind = _kind_of(depth_map)
    values, camera = depth_map.to_float(), depth_map.camera
    if kind != _DISPARITY or camera is None:
        return DepthMap(
            values, kind=_KINDS[kind], image_size=image_size, scale_rel_std=scale_rel_std
        )
    if not all(hasattr(camera, name) for name in ("fx_px", "baseline_m", "doffs_px")):
        msg = f"`depth_map.camera` must be a supervision.DepthCamera; got {type(camera).__name__}."
        raise TypeError(msg)
    return DepthMap.from_disparity(
        values,
        focal_px=camera.fx_px,
        baseline_m=camera.baseline_m,
        doffs_px=camera.doffs_px,
        image_size=image_size,
        scale_rel_std=scale_rel_std,
    )


def _kind_of(depth_map: Any) -> str:
    """Read the kind of a map, or say that it is none."""
    parts = [hasattr(depth_map, name) for name in ("kind", "camera")]
    if not (all(parts) and callable(getattr(depth_map, "to_float", None))):
        msg = (
            f"`depth_map` must be a supervision.DepthMap; got {type(depth_map).__name__}. Arrays "
            "go through DepthMap(values, kind=...)."
        )
        raise TypeError(msg)
    kind = getattr(depth_map.kind, "value", depth_map.kind)
    if not isinstance(kind, str) or kind not in _KINDS:
        msg = f"`depth_map.kind` must be one of {', '.join(_KINDS)}; got {kind!r}."
        raise ValueError(msg)
    return kind


def to_supervision(depth: DepthMap) -> Any:
    """
    Turn a depth map into a `supervision.DepthMap`.

    Parameters
    ----------
    depth : DepthMap
        Metric, inverse or affine inverse depth.

    Returns
    -------
    supervision.DepthMap
        Kind "depth_m" for metric depth, else "relative_inverse"; float32, NaN where there is no
        depth. Affine inverse depth with values below 0, which supervision takes for none, is
        shifted so that its farthest value is 0: its shift is unknown anyway. The size of the
        picture and the error of the scale have no place there.

    Raises
    ------
    MissingDependencyError
        If supervision is not installed.
    TypeError
        If it is no `DepthMap`.
    ValueError
        If the depth is relative: supervision has no such kind.

    Examples
    --------
    >>> import numpy as np
    >>> from imgscale import DepthMap
    >>> from imgscale.depth_sources.supervision import to_supervision
    >>> to_supervision(DepthMap([[2.5]], kind="metric")).kind  # doctest: +SKIP
    <DepthKind.DEPTH_M: 'depth_m'>
    """
    check_type("depth", depth, DepthMap)
    if depth.kind == "relative":
        msg = (
            '`depth` must be metric or inverse; got kind "relative", which supervision does not '
            "have. Put it into metres first: model.to_metric(depth, camera)."
        )
        raise ValueError(msg)
    supervision = require("supervision", extra="supervision", purpose="Making its DepthMap")
    values = np.where(valid_depths(depth.values, depth.kind), depth.values, np.nan)
    if depth.kind == "metric":
        return supervision.DepthMap(values, kind="depth_m")
    values = values - min(0.0, float(np.nanmin(values)))
    return supervision.DepthMap(values, kind="relative_inverse")
