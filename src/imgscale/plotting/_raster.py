"""The scale at every pixel, and how far to trust it. Numbers alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imgscale._checks import check_type
from imgscale._typing import BoolArray, FloatArray, ImageSize
from imgscale.depth import DepthMap, GroundPlane
from imgscale.laws import LAWS
from imgscale.model import ScaleModel
from imgscale.plotting._canvas import cell_centres
from imgscale.plotting._plane import PlaneView
from imgscale.sizing import FAR_OFF

# Longer side of a ground plane's map.
_GROUND_CELLS = 800
# A map is drawn as points where fewer of its pixels than this have neighbours to the left and
# above: LiDAR has whole rows now and then, and nothing between them.
_SPARSE = 0.5
# Share of the pixels at the least value of a map that tells of a cut there, as of the sky.
_LEAST_FLOOR = 0.01


class Raster(NamedTuple):
    """
    Metres per pixel all over the picture.

    Attributes
    ----------
    scale : (H, W) ndarray of float64
        In m/px; NaN where there is none.
    image_size : (width, height)
        Size of the picture in pixels, whatever that of the raster is.
    far : (H, W) ndarray of bool
        True where a fitted shift or horizon alone tells the scale, far from all references.
    floor : (H, W) ndarray of bool
        True at the map's least value, where that may stand for all that is farther.
    """

    scale: FloatArray
    image_size: ImageSize
    far: BoolArray
    floor: BoolArray

    @property
    def seen(self) -> BoolArray:
        """True where there is a scale."""
        return np.isfinite(self.scale)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top in the picture's plot."""
        width, height = self.image_size
        return (-0.5, width - 0.5, height - 0.5, -0.5)

    @property
    def is_sparse(self) -> bool:
        """True where values stand alone, as those of LiDAR do."""
        seen = self.seen
        beside = seen[:, 1:] & seen[:, :-1]
        full = np.count_nonzero(beside[1:] & beside[:-1])
        return bool(full < _SPARSE * np.count_nonzero(seen))


def raster_of(
    model: ScaleModel, depth: DepthMap | GroundPlane | None, *, same_scale: bool
) -> Raster:
    """
    Compute the scale, of the depth map's pixels or of the ground's.

    Parameters
    ----------
    model : ScaleModel
        The model.
    depth : DepthMap, GroundPlane or None
        Its depth.
    same_scale : bool
        True where another map has the scale of the fitted one.

    Returns
    -------
    Raster
        The scale.

    Raises
    ------
    TypeError
        If the model needs a map and `depth` is none.
    ValueError
        If no pixel has a scale.
    DepthMismatchError
        If `depth` is not that of the model.
    """
    if model.kind == "ground_plane":
        if depth is not None:
            model.check_depth(depth, same_scale=same_scale)
        raster = _ground_raster(model)
    else:
        remedy = " The scale between objects is known from a map alone."
        shown = check_type("depth", depth, DepthMap, remedy)
        model.check_depth(shown, same_scale=same_scale)
        shifted = LAWS[model.kind].has_shift
        known = [ref.depth for ref in model.references if ref.candidate and shifted]
        scale = model.metres_per_pixel(shown.values)
        floor = _floor(shown) & np.isfinite(scale)
        far = _far_off(scale, model.metres_per_pixel(known)) & ~floor
        raster = Raster(scale, shown.image_size, far, floor)
    if not raster.seen.any():
        msg = "`model` must give some pixel a scale; got none: " + (
            "the horizon is below the picture."
            if model.kind == "ground_plane"
            else "the fitted shift puts all depths beyond infinity."
        )
        raise ValueError(msg)
    return raster


def _ground_raster(model: ScaleModel) -> Raster:
    """Compute the scale of the ground on a raster fine enough to be looked at."""
    view = PlaneView.of(model)
    width, height = view.image_size
    share = min(1.0, _GROUND_CELLS / max(width, height))
    shape = (max(2, round(share * height)), max(2, round(share * width)))
    x, y = cell_centres(shape, view.image_size)
    scale = view.metres_per_pixel(x, y[:, None])
    feet = np.array([ref.foot_xy for ref in model.references if ref.candidate]).reshape(-1, 2)
    far = _far_off(scale, view.metres_per_pixel(*feet.T))
    return Raster(scale, view.image_size, far, np.zeros_like(far))


def _far_off(scale: FloatArray, known: FloatArray) -> BoolArray:
    """Mark where `predict` would flag something EXTRAPOLATED, by the scales at the references."""
    known = known[np.isfinite(known)]
    if not known.size:
        return np.zeros(scale.shape, dtype=np.bool_)
    far: BoolArray = (scale < known.min() / FAR_OFF) | (scale > known.max() * FAR_OFF)
    return far


def _floor(depth: DepthMap) -> BoolArray:
    """Mark the least value where so many pixels have it that it is where the map was cut off."""
    values = depth.values
    floor: BoolArray = values == np.min(values, where=np.isfinite(values), initial=np.inf)
    if depth.kind == "affine_inverse" and _LEAST_FLOOR < np.mean(floor) < 1:
        return floor
    return np.zeros_like(floor)
