"""The verb `extent`: height, width, longest extent and area of a region."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import attrs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgscale._depth_values import valid_depths
from imgscale._typing import BoolArray, FloatArray, ImageSize, IntArray, SizeAxis
from imgscale.columns import objects_of
from imgscale.core.outline import Outline, outline_of_pixels, outline_of_polygon
from imgscale.core.segments import Parts
from imgscale.core.sighting import log_scales
from imgscale.core.surface import Surface, surface_distances
from imgscale.depth import Depth, DepthMap, ObjectDepths
from imgscale.detection import Detection
from imgscale.extent import extent_rel_std
from imgscale.flags import Flag
from imgscale.laws import LAWS
from imgscale.lookup import Lookup, Solved, look_up, solved
from imgscale.measuring._given import given_array
from imgscale.model import ScaleModel
from imgscale.noise import Noise
from imgscale.observations import Observations, observe
from imgscale.posing import view_of
from imgscale.quantity import Extent, Quantity
from imgscale.sampling import SURFACE_LOG_WIDTH
from imgscale.sizing import Sizes, Wanted, distances, row_flags, size_up

__all__ = ["extent"]

# Polygons and the pixels in them differ by less than this much of a pixel along the outline.
_OUTLINE_PX = 1.0
# A polygon is rasterised for the check alone where the picture's size is not known, so finely.
_CHECK_PX = 256.0
# Corners beyond this are no pixels.
_LARGEST_PX = 1e6
# Where more than a quarter of the pixels that somebody marked lie apart from the surface, there is
# another one; a box, which holds background anyway, needs more. Up to 20 % areas err by 1.4 %.
_OTHER_SHARE = 0.25
_ROWS: tuple[SizeAxis, ...] = ("height", "width", "width", "width")


def extent(
    model: ScaleModel,
    mask_or_polygon: ArrayLike,
    depth: Depth | None = None,
    *,
    same_scale: bool = False,
) -> Extent:
    """
    Measure height, width, longest extent and area of a region.

    Parameters
    ----------
    model : ScaleModel
        The scale of the image.
    mask_or_polygon : (H, W) array_like of bool, or (N, 2) array_like of float
        True on the region's pixels, in the shape of the image; or the corners (x, y) of its outline
        in pixels, with the left edge of the first one at 0.
    depth : DepthMap, ObjectDepths or GroundPlane, optional
        The depth, of the model's kind; to be left out where that is the ground plane, on which the
        lowest row of the region stands. `ObjectDepths` hold one value.
    same_scale : bool
        Vouch that another map than the fitted one has the same scale.

    Returns
    -------
    Extent
        NaN with a flag where the region has no depth.

    Raises
    ------
    ValueError
        If the region is empty, does not belong to the image, or its outline crosses itself; or if
        `depth` is missing.
    TypeError
        If an argument is of the wrong type.
    DepthMismatchError
        As for `predict`, and if `depth` is another ground plane than the model's.

    Notes
    -----
    Height and width are those of the bounding box, by the depth of the surface that fills the
    region, just as `predict` has them for a detection with that mask. The longest extent is the
    greatest distance of two corners of its pixels, or of the polygon (maximum Feret diameter), by
    the same depth. The area is the sum of the squares of the pixels' own metres per pixel, that of
    a silhouette that faces the camera: a surface seen at the angle A has 1 / cos A times as much.
    Pixels without depth, and those apart from the surface in depth (background that the mask took
    along), count with the depth of the nearest pixel on it; MIXED_DEPTH tells where these are more
    than a quarter. An error of the outline moves both sides of the region alike, so that its area
    errs by half the perimeter times `Noise.box_px`, and its longest extent as the diagonal of a box
    does.

    A region is taken for a new object: where it was a reference, its error counts in k once more,
    and the interval is rather too wide.

    Examples
    --------
    >>> import numpy as np
    >>> import imgscale as ims
    >>> from imgscale.measuring import extent
    >>> depth = ims.DepthMap(np.full((480, 640), 4.0), kind="relative")
    >>> door = ims.Detection("door", (100, 50, 180, 250))
    >>> table = ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.02)])
    >>> model = ims.fit([door], depth, table, noise=ims.Noise(depth_rel=0.01))
    >>> triangle = extent(model, [(300, 100), (420, 100), (300, 260)], depth)
    >>> print(triangle.area)
    0.96 +- 0.05 m2
    >>> print(triangle)
    height 1.600 +- 0.033 m, width 1.200 +- 0.026 m, longest 2.00 +- 0.04 m, area 0.96 +- 0.05 m2
    """
    lookup = look_up(model, depth, same_scale=same_scale)
    lookup.check_plane()
    region = _region(mask_or_polygon, lookup.depth.image_size)
    if isinstance(lookup.depth, ObjectDepths) and len(lookup.depth) != 1:
        msg = f"`depth` must hold one value, that of the region; got {len(lookup.depth)}."
        raise ValueError(msg)
    return extent_of(lookup, solved(model), region, lookup.depth)


class Region(NamedTuple):
    """
    A region of the picture.

    Attributes
    ----------
    outline : Outline
        Its outline.
    mask : (H, W) ndarray of bool or None
        Its pixels; None where the centre of none lies in it.
    """

    outline: Outline
    mask: BoolArray | None


def _region(value: ArrayLike, size: ImageSize | None) -> Region:
    """Take a mask or a polygon."""
    array = given_array("mask_or_polygon", "a mask (H, W) or a polygon (N, 2)", value)
    if array.dtype == np.bool_:
        return _of_mask(array, size)
    if array.dtype.kind in "fiu" and array.ndim == 2 and array.shape[1] == 2:
        return _of_polygon(array.astype(np.float64), size)
    remedy = "Compare a mask of numbers first: mask > 0."
    if array.ndim == 3 and array.shape[1:] == (1, 2):
        remedy = "Take the middle axis out of an OpenCV contour: contour[:, 0]."
    msg = (
        "`mask_or_polygon` must be a boolean mask of shape (H, W) or a polygon of shape (N, 2); "
        f"got shape {array.shape} and dtype {array.dtype}. {remedy}"
    )
    raise TypeError(msg)


def _of_mask(mask: NDArray[Any], size: ImageSize | None) -> Region:
    """Take a mask."""
    import skimage as ski  # noqa: PLC0415 - loads its parts on use

    if mask.ndim != 2 or (size and mask.shape != size[::-1]):
        shape = size[::-1] if size else "(H, W)"
        msg = (
            f"`mask_or_polygon` must have the shape of the image, {shape}, where it is a mask; got "
            f"{mask.shape}."
        )
        raise ValueError(msg)
    if not mask.any():
        msg = "`mask_or_polygon` must be True somewhere; got an empty mask."
        raise ValueError(msg)
    measure: Any = ski.measure  # untyped there
    return region_of_pixels(measure.regionprops(mask.astype(np.uint8))[0], mask.shape)


def region_of_pixels(part: Any, shape: tuple[int, ...]) -> Region:
    """
    Take one of scikit-image's regions.

    Parameters
    ----------
    part : RegionProperties
        The region.
    shape : (H, W)
        Shape of the image.

    Returns
    -------
    Region
        With its mask in the whole image.
    """
    top, left, bottom, right = (int(number) for number in part.bbox)
    pixels: BoolArray = np.asarray(part.image, dtype=np.bool_)
    mask = np.zeros(shape, dtype=np.bool_)
    mask[top:bottom, left:right] = pixels
    return Region(outline_of_pixels(pixels, left, top, float(part.perimeter_crofton)), mask)


def _of_polygon(corners: FloatArray, size: ImageSize | None) -> Region:
    """Take a polygon."""
    if len(corners) < 3 or not np.isfinite(corners).all():
        msg = (
            "`mask_or_polygon` must have at least three corners, all finite, where it is a "
            f"polygon; got {len(corners)}."
        )
        raise ValueError(msg)
    _check_corners(corners, size)
    outline, mask = outline_of_polygon(corners), _filled(corners, size)
    if outline is None or min(np.ptp(corners, axis=0)) < 1 or _crosses(outline, corners, mask):
        msg = (
            "`mask_or_polygon` must enclose an area, a pixel high and wide at least, and not cross "
            f"itself where it is a polygon; got {corners[:5].tolist()}"
            f"{' and so on' if len(corners) > 5 else ''}."
        )
        raise ValueError(msg)
    return Region(outline, mask if mask is not None and mask.any() else None)


def _check_corners(corners: FloatArray, size: ImageSize | None) -> None:
    """Raise where a polygon reaches more than a pixel beyond the picture."""
    high = np.array(size, dtype=np.float64) + 1 if size else _LARGEST_PX
    low = -1.0 if size else -_LARGEST_PX
    out = (corners < low) | (corners > high)
    if out.any():
        where = f"the image, {size[0]} x {size[1]} px" if size else "a picture"
        corner = tuple(corners[out.any(axis=1)][0].tolist())
        msg = f"`mask_or_polygon` must lie in {where}; got the corner {corner}."
        raise ValueError(msg)


def _crosses(outline: Outline, corners: FloatArray, mask: BoolArray | None) -> bool:
    """Tell whether a polygon encloses some of its area more than once, or not at all."""
    scale = 1.0
    if mask is None:
        scale = _CHECK_PX / float(np.ptp(corners, axis=0).max())
        own = (corners - corners.min(axis=0)) * scale
        mask = _filled(own, (int(_CHECK_PX) + 1, int(_CHECK_PX) + 1))
    pixels = 0.0 if mask is None else float(mask.sum())
    off = abs(pixels - outline.area_px * scale**2)
    return off > _OUTLINE_PX * outline.perimeter_px * scale


def _filled(corners: FloatArray, size: ImageSize | None) -> BoolArray | None:
    """Mark the pixels whose centres lie in a polygon."""
    import skimage as ski  # noqa: PLC0415 - loads its parts on use

    if size is None:
        return None
    draw: Any = ski.draw  # untyped there
    return np.asarray(draw.polygon2mask(size[::-1], corners[:, ::-1] - 0.5), dtype=np.bool_)


def extent_of(lookup: Lookup, found: Solved, region: Region, depth: Depth) -> Extent:
    """
    Measure one region.

    Parameters
    ----------
    lookup : Lookup
        Model and depth.
    found : Solved
        The solutions of the model.
    region : Region
        The region.
    depth : DepthMap, ObjectDepths or GroundPlane
        Its own depth: that of the look-up or, of several `ObjectDepths`, the one.

    Returns
    -------
    Extent
        What is known of it.
    """
    # rows for height, width, longest extent and the root of the area
    model, noise = lookup.model, lookup.model.noise
    detection = Detection("region", region.outline.box, mask=region.mask)
    obs = observe(
        [detection], depth, model.priors, noise, ground=model.ground, axis="height", k=model.k
    )
    obs = lookup.with_errors(_four(obs))
    surface = _surface(lookup, region.mask, float(obs.inverse_depth[0]))
    if surface:  # the area as though it were all in one plane
        obs.inverse_depth[3] = float((surface.distance**2).mean()) ** -0.5 - model.shift
        obs = obs._replace(mixed=obs.mixed | (surface.share < 1 - _OTHER_SHARE))
    # a tilted camera shows heights shorter than widths
    logs = log_scales(objects_of(obs, view_of(model)), found.cases.best)[0][0]
    stretch = math.exp(logs[0] - logs[1]) if np.isfinite(logs[:2]).all() else 1.0
    obs = _with_pixels(obs, region.outline, stretch, noise)
    wanted = _wanted(model, obs)
    sizes = size_up(found.cases, wanted)
    flags = row_flags(obs, wanted, sizes, found.cases, found.references, Flag(0))
    z_m = distances(model, obs.depth, sizes, wanted.log_k, other_map=lookup.other_map)
    return Extent(
        height=_quantity(sizes, 0, flags),
        width=_quantity(sizes, 1, flags),
        longest=_quantity(sizes, 2, flags),
        area=_squared(_quantity(sizes, 3, flags)),
        metres_per_pixel=float(sizes.metres_per_pixel[0]),
        depth=float(obs.depth[0]),
        distance_m=None if z_m is None else float(z_m[0]),
    )


def _four(obs: Observations) -> Observations:
    """Repeat one object for each of what is measured of it."""

    def again(column: Any) -> Any:
        if isinstance(column, Parts):
            return Parts(*(np.repeat(part, 4, axis=0) for part in column))
        if isinstance(column, tuple):
            return cast("tuple[object, ...]", column) * 4
        return column if isinstance(column, bool) else np.repeat(column, 4, axis=0)

    columns: list[Any] = [again(column) for column in obs]
    return Observations(*columns)._replace(axis=_ROWS)


def _with_pixels(obs: Observations, outline: Outline, stretch: float, noise: Noise) -> Observations:
    """Count what is measured in pixels across the view, heights as they stand."""
    x1, y1, x2, y2 = outline.box
    root = math.sqrt(stretch * outline.area_px)
    pixels = np.array([y2 - y1, x2 - x1, outline.longest(stretch), root])
    box_var = extent_rel_std(pixels, noise.box_px, noise.box_rel) ** 2
    of_longest = noise.box_px * outline.longest_by_box(stretch) / pixels[2]
    of_root = noise.box_px * outline.perimeter_px / outline.area_px / 4
    box_var[2:] = np.array([of_longest, of_root]) ** 2 + noise.box_rel**2
    return obs._replace(pixels=pixels, box_var=box_var)


def _wanted(model: ScaleModel, obs: Observations) -> Wanted:
    """Ask for measurements of something new."""
    count = obs.pixels.size
    subjects = objects_of(obs, view_of(model))
    if subjects.stance:
        seen = tuple(obs.boxes[0]) in {ref.xyxy for ref in model.references}
        is_new = np.full(count, not seen)
        subjects = subjects._replace(stance=subjects.stance._replace(is_new=is_new))
    nobody, no = np.full(count, -1, dtype=np.intp), np.zeros(count, dtype=np.bool_)
    return Wanted(
        subjects=subjects._replace(group=nobody),
        own=nobody,
        common_var=obs.depth_var,
        share=np.zeros(count),
        fuse=no,
        rejected=no,
        log_k=np.full(count, math.log(model.k)),
    )


def _quantity(sizes: Sizes, row: int, flags: Sequence[Flag]) -> Quantity:
    """Gather one row."""
    return Quantity(
        value=float(sizes.size_m[row]),
        std=float(sizes.std_m[row]),
        unit="m",
        flags=flags[row],
        quantiles=None if sizes.is_normal else tuple(sizes.quantiles_m[row].tolist()),
    )


def _squared(root: Quantity) -> Quantity:
    """Make an area of its root: its log errs by twice as much."""
    squares = root.quantiles and tuple(number * number for number in root.quantiles)
    return attrs.evolve(
        root,
        value=root.value * root.value,
        std=2 * root.value * root.std,
        unit="m2",
        quantiles=squares,
    )


def _surface(lookup: Lookup, mask: BoolArray | None, inverse_depth: float) -> Surface | None:
    """Take the distances of the region's pixels, from a surface at an inverse depth on."""
    depth, shift = lookup.depth, lookup.model.shift
    if not isinstance(depth, DepthMap) or mask is None or not inverse_depth + shift > 0:
        return None
    window = _window(mask)
    law, values = LAWS[depth.kind], _values_at(depth, window)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = law.relative_distance(values, shift)
    distance = np.where(valid_depths(values, depth.kind), distance, np.nan)
    log_surface = -math.log(inverse_depth + shift)
    return surface_distances(distance, mask[window], log_surface, SURFACE_LOG_WIDTH)


def _window(mask: BoolArray) -> tuple[slice, slice]:
    """Rows and columns that hold a mask."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def _values_at(depth: DepthMap, window: tuple[slice, slice]) -> FloatArray:
    """Values of the map at the centres of the image's pixels."""

    def places(span: slice, length: int, size: int) -> IntArray:
        centres: FloatArray = np.arange(span.start, span.stop, dtype=np.float64) + 0.5
        return (centres * length / size).astype(np.intp)

    height, width = depth.values.shape
    rows = places(window[0], height, depth.image_size[1])
    columns = places(window[1], width, depth.image_size[0])
    return depth.values[np.ix_(rows, columns)].astype(np.float64)
