"""A scale bar that says at which depth it holds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import attrs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgscale._checks import as_array, check_choice, check_type, positive_number
from imgscale._depth_values import valid_depths
from imgscale._format import PER_METRE
from imgscale._typing import BoolArray, ImageSize
from imgscale.depth import Depth, DepthMap, check_depth_type
from imgscale.detection import Detection
from imgscale.estimate import SizeEstimate
from imgscale.extent import extent_rel_std
from imgscale.flags import Flag, flag_names, flag_words
from imgscale.model import ScaleModel
from imgscale.picture import Picture
from imgscale.plotting._canvas import (
    ORANGE,
    WHITE,
    cell_centres,
    check_photo,
    legible,
    lettering,
    photo_size,
    picture_axes,
    points_of,
    ruler,
    stroke,
)
from imgscale.plotting._plane import PlaneView
from imgscale.plotting._wording import shortened
from imgscale.prediction import predict
from imgscale.standing import RELIEF_REL

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_scale_bar"]

# Of the picture's width: what a bar aims at, and what it may be at most.
_USUAL_SHARE, _LARGEST_SHARE = 0.2, 0.95
# A pixel's depth is that of the surface within so many longer sides, at least so many pixels of
# the map.
_NEIGHBOURHOOD, _LEAST_PIXELS = 0.005, 1.5
# Gaps in points: from the marker to the bar, from the bar to its label, to the border.
_GAP, _LABEL_GAP, _MARGIN = 10.0, 7.0, 6.0
# Letters of an object's name.
_NAME = 30
# A distance known better than this has three digits.
_SURE = 0.01
# What is said of the place; a pixel has no box in which two surfaces could be.
_NOTED = Flag.MIXED_DEPTH | Flag.EXTRAPOLATED
_TWO_SURFACES = "two surfaces meet here"


class PointScale(NamedTuple):
    """
    The scale at one place.

    Attributes
    ----------
    metres_per_pixel : float
        For lengths parallel to the picture, in m/px.
    rel_std : float
        Its relative standard error.
    distance_m : float or None
        z-depth in metres; None where no focal length is known.
    flags : Flag
        Reservations.
    """

    metres_per_pixel: float
    rel_std: float
    distance_m: float | None
    flags: Flag = Flag(0)


def draw_scale_bar(
    model: ScaleModel,
    depth: Depth | None,
    at: Detection | ArrayLike,
    *,
    image: Picture | NDArray[Any] | None = None,
    length_m: float | None = None,
    unit: str | None = None,
    same_scale: bool = False,
    ax: Axes | None = None,
) -> Axes:
    """
    Draw a scale bar for one place in the photo, and say at which distance it holds.

    What lies nearer or farther has another scale: a bar is right at one depth. Its label tells that
    depth, in metres where a focal length is known, and the standard error of the bar's length.

    Parameters
    ----------
    model : ScaleModel
        The scale of the image.
    depth : DepthMap, ObjectDepths, GroundPlane or None
        Depth of the model's kind; None for the ground plane. `ObjectDepths` hold one value, that of
        the object.
    at : (x, y) or Detection
        A pixel, whose depth is that of the surface within half a per cent of the longer side; on a
        ground plane a pixel is a place on the ground. Or an object, which is as far as `predict`
        says.
    image : path, PIL image or ndarray, optional
        The photo, as `draw_sizes` takes it; an empty picture, or what is on `ax`, where omitted.
    length_m : float, optional
        Length of the bar in metres, positive; where omitted the one of 1, 2, 5, 10, ... that is
        nearest to a fifth of the picture's width.
    unit : str, optional
        "m", "cm", "mm", "ft" or "in"; mm, cm, m or km as fits where omitted.
    same_scale : bool
        Vouch that another map than the fitted one has the same scale.
    ax : matplotlib Axes, optional
        Where to draw, in pixels of the photo; a new figure of its shape where omitted.

    Returns
    -------
    matplotlib Axes
        The axes; save with ``ax.figure.savefig(path)``.

    Raises
    ------
    ValueError
        If there is no depth at the place, it is outside the picture, or a bar of `length_m` is.
    TypeError
        If an argument is of the wrong type.
    DepthMismatchError
        If `depth` is not that of the model.
    MissingDependencyError
        If matplotlib is not installed.

    Notes
    -----
    The bar is parallel to the picture and level: `length_m` over metres per pixel, k d, long.

    Examples
    --------
    >>> from imgscale.datasets import motorcycle
    >>> from imgscale.plotting import draw_scale_bar
    >>> import imgscale as ims
    >>> scene = motorcycle.load()
    >>> model = ims.fit(scene.detections, scene.depth, scene.priors, camera=scene.camera)
    >>> bottle = scene.detections[3]
    >>> ax = draw_scale_bar(model, scene.depth, bottle, image=scene.image)  # doctest: +SKIP
    """
    check_type("model", model, ScaleModel)
    check_type("same_scale", same_scale, bool)
    if unit is not None:
        check_choice("unit", unit, tuple(PER_METRE))
    if length_m is not None:
        length_m = positive_number("length_m", length_m)
    if depth is not None:
        model.check_depth(check_depth_type(depth), same_scale=same_scale)
    photo = None if image is None else check_photo(image)
    size = _picture_size(model, depth, photo)
    target = at if isinstance(at, Detection) else _pixel(at, size)
    scale = scale_at(model, depth, target, size, same_scale=same_scale)
    length_m = _length(scale.metres_per_pixel * size[0], length_m, unit)
    axes = picture_axes(photo, size, ax)
    lines = _label(length_m, unit, scale, target)
    _draw_bar(axes, _Bar(target, length_m / scale.metres_per_pixel, lines, size))
    return cast("Axes", axes)


def round_length(length: float) -> float:
    """
    Find the nearest of 1, 2, 5, 10, 20, ... by its ratio.

    Parameters
    ----------
    length : float
        Positive number.

    Returns
    -------
    float
        1, 2 or 5 times a power of ten.
    """
    power = math.floor(math.log10(length))
    near = [float(f"{lead}e{power + more}") for more in (0, 1) for lead in (1, 2, 5)]
    return min(near, key=lambda number: abs(math.log(number / length)))


def length_text(length_m: float, unit: str | None = None) -> str:
    """
    Write a length in the unit that reads best, or in a given one.

    Parameters
    ----------
    length_m : float
        The length in metres.
    unit : str, optional
        A key of `PER_METRE`.

    Returns
    -------
    str
        For example "50 cm".
    """
    if unit is None:
        units = (("km", 1e-3, 1e3), ("m", 1.0, 1.0), ("cm", 1e2, 1e-2), ("mm", 1e3, 0.0))
        unit, factor = next(
            (name, factor) for name, factor, least in units if length_m >= least * (1 - 1e-9)
        )
    else:
        factor = PER_METRE[unit]
    return f"{length_m * factor:.4g} {unit}"


def scale_at(
    model: ScaleModel,
    depth: Depth | None,
    target: Detection | tuple[float, float],
    image_size: ImageSize,
    *,
    same_scale: bool,
) -> PointScale:
    """
    Find the scale at an object or a pixel.

    Parameters
    ----------
    model : ScaleModel
        The model.
    depth : DepthMap, ObjectDepths, GroundPlane or None
        Its depth.
    target : Detection or (x, y)
        The place.
    image_size : (width, height)
        Size of the image in pixels.
    same_scale : bool
        True where another map has the scale of the fitted one.

    Returns
    -------
    PointScale
        The scale there.

    Raises
    ------
    ValueError
        If there is no depth there.
    TypeError
        If a pixel is asked for where there is no map.
    """
    if isinstance(target, Detection):
        estimate = predict(model, [target], depth, axis="width", same_scale=same_scale)[0]
        if math.isnan(estimate.metres_per_pixel):
            msg = (
                f"`at` must be an object with a finite distance; got {target.label!r} at "
                f"{target.xyxy}, flagged {', '.join(flag_names(estimate.flags))}. Name another "
                "object, or a pixel (x, y) with depth."
            )
            raise ValueError(msg)
        return _of_estimate(estimate, target.width_px, model)
    if model.kind == "ground_plane":
        return _on_ground(model, target)
    if not isinstance(depth, DepthMap):
        msg = (
            f"`at` must be a Detection unless `depth` is a map; got {target} with "
            f"{'None' if depth is None else type(depth).__name__}."
        )
        raise TypeError(msg)
    return _at_pixel(model, depth, target, image_size, same_scale=same_scale)


def _picture_size(model: ScaleModel, depth: Depth | None, photo: NDArray[Any] | None) -> ImageSize:
    """Size of the picture, from whoever knows it."""
    size = model.image_size or (depth.image_size if depth is not None else None)
    if size is None and model.ground:
        size = model.ground.image_size
    if size is None and photo is not None:
        size = photo_size(photo)
    if size is None:
        msg = "`image` must be given where neither model nor depth know the image's size; got None."
        raise ValueError(msg)
    return size


def _pixel(at: ArrayLike, image_size: ImageSize) -> tuple[float, float]:
    """Take a pixel inside the picture."""
    width, height = image_size
    law = f"a pixel (x, y) inside the picture, {width} x {height}, or a Detection"
    point = as_array("at", law, at)
    lawful = point.shape == (2,) and point.dtype.kind in "fiu"
    if not (lawful and 0 <= point[0] <= width and 0 <= point[1] <= height):
        seen = repr(at) if point.size <= 4 else f"shape {point.shape}"
        msg = f"`at` must be {law}; got {seen}."
        raise ValueError(msg)
    return (float(point[0]), float(point[1]))


def _of_estimate(estimate: SizeEstimate, width_px: float, model: ScaleModel) -> PointScale:
    """Take the scale from a predicted width, less the error of its pixels."""
    box = extent_rel_std(np.array([width_px]), model.noise.box_px, model.noise.box_rel)
    # a reference's own size holds that error in part or not at all: there it stays
    of_box = 0.0 if Flag.REFERENCE in estimate.flags else float(box[0])
    variance = (estimate.std_m / estimate.size_m) ** 2 - of_box**2
    return PointScale(
        estimate.metres_per_pixel,
        math.sqrt(max(variance, 0.0)),
        estimate.distance_m,
        estimate.flags,
    )


def _at_pixel(
    model: ScaleModel,
    depth: DepthMap,
    point: tuple[float, float],
    image_size: ImageSize,
    *,
    same_scale: bool,
) -> PointScale:
    """Ask `predict` for something as wide as the picture, of which only the pixel is seen."""
    width, height = image_size
    mask = _neighbourhood(point, depth, image_size)
    whole = Detection("(point)", (0, 0, width, height), mask=mask, partial=True)
    estimate = predict(model, [whole], depth, axis="width", same_scale=same_scale)[0]
    if math.isnan(estimate.metres_per_pixel) or not _seen(depth, mask).any():
        msg = f"`at` must be a pixel with depth nearby; got {point}.{_nearest(depth, point)}"
        raise ValueError(msg)
    return _of_estimate(estimate, width, model)


def _neighbourhood(point: tuple[float, float], depth: DepthMap, image_size: ImageSize) -> BoolArray:
    """Mark the pixels of the image that are near a point."""
    width, height = image_size
    rows, columns = depth.values.shape
    mask = np.zeros((height, width), dtype=np.bool_)
    spans: list[slice] = []
    for place, length, cells in zip(point, image_size, (columns, rows), strict=True):
        reach = max(_NEIGHBOURHOOD * max(image_size), _LEAST_PIXELS * length / cells)
        first = min(max(math.floor(place - reach), 0), length - 1)
        spans.append(slice(first, max(math.ceil(place + reach), first + 1)))
    mask[spans[1], spans[0]] = True
    return mask


def _seen(depth: DepthMap, mask: BoolArray) -> BoolArray:
    """Tell which values of the map on a mask are depths."""
    x, y = cell_centres(depth.values.shape, depth.image_size)
    on_mask = mask[np.ix_(y.astype(np.intp), x.astype(np.intp))]
    return valid_depths(depth.values[on_mask], depth.kind)


def _nearest(depth: DepthMap, point: tuple[float, float]) -> str:
    """Name the nearest pixel with depth."""
    x, y = cell_centres(depth.values.shape, depth.image_size)
    rows, columns = np.nonzero(valid_depths(depth.values, depth.kind))
    nearest = int(np.argmin((x[columns] - point[0]) ** 2 + (y[rows] - point[1]) ** 2))
    return f" The nearest one is at ({x[columns[nearest]]:.0f}, {y[rows[nearest]]:.0f})."


def _on_ground(model: ScaleModel, point: tuple[float, float]) -> PointScale:
    """Take a pixel for a place on the ground."""
    view = PlaneView.of(model)
    below = float(view.below_horizon(*point))
    if below <= 0:
        msg = (
            f"`at` must lie on the ground, below the horizon at row {point[1] - below:.0f}; got "
            f"{point}."
        )
        raise ValueError(msg)
    plane: Any = model.plane
    of_k, of_horizon = model.k_std / model.k, model.shift_std / below
    across = point[0] - view.image_size[0] / 2
    of_roll = math.radians(plane.roll_std_deg) * (1 + view.slope**2) * across / below
    relief = RELIEF_REL if model.noise.depth_rel is None else model.noise.depth_rel
    together = of_k**2 + of_horizon**2 - 2 * model.correlation * of_k * of_horizon
    scale = float(view.metres_per_pixel(*point))
    return PointScale(
        scale,
        math.sqrt(max(together, 0.0) + of_roll**2 + relief**2),
        scale * view.focal_px if math.isfinite(view.focal_px) else None,
    )


def _length(width_m: float, length_m: float | None, unit: str | None) -> float:
    """Choose the bar's length, or check the one given."""
    if length_m is None:
        per_metre = 1.0 if unit is None else PER_METRE[unit]
        return round_length(_USUAL_SHARE * width_m * per_metre) / per_metre
    if length_m > _LARGEST_SHARE * width_m:
        msg = (
            f"`length_m` must fit into the picture, which is {width_m:.3g} m wide at this depth; "
            f"got {length_m}."
        )
        raise ValueError(msg)
    return length_m


def _label(
    length_m: float, unit: str | None, scale: PointScale, target: Detection | tuple[float, float]
) -> list[str]:
    """Say how long the bar is, how sure that is, and where it holds."""
    percent = 100 * scale.rel_std
    error = f"{percent:.2g} %" if percent < 99.5 else "more than 100 %"
    digits = 3 if scale.rel_std < _SURE else 2
    distance = "" if scale.distance_m is None else f"{float(f'{scale.distance_m:.{digits}g}'):g} m"
    if isinstance(target, Detection):
        name = shortened(target.label, _NAME)
        place = f"at the {name}, at {distance}" if distance else f"at the {name}"
    else:
        place = f"at {distance or 'this distance'}"
    noted = scale.flags & _NOTED
    notes = flag_words(noted)
    if Flag.MIXED_DEPTH in noted and not isinstance(target, Detection):
        notes = [_TWO_SURFACES, *flag_words(noted & ~Flag.MIXED_DEPTH)]
    return [f"{length_text(length_m, unit)} +- {error}", f"only {place}", *notes]


@attrs.frozen
class _Bar:
    """A bar to be drawn."""

    target: Detection | tuple[float, float]
    length_px: float
    lines: Sequence[str]
    image_size: ImageSize

    @property
    def box(self) -> tuple[float, float, float, float]:
        """What the bar must not cover."""
        if isinstance(self.target, Detection):
            return self.target.xyxy
        return (*self.target, *self.target)


def _draw_bar(axes: Any, bar: _Bar) -> None:
    """Draw the marker, the bar beside it, and its label."""
    x1, y1, x2, y2 = bar.box
    width, height = bar.image_size
    middle = ((x1 + x2) / 2, (y1 + y2) / 2)
    points = points_of(axes)[0] / width
    margin, gap, label_gap = (length / points for length in (_MARGIN, _GAP, _LABEL_GAP))
    axes.plot(
        middle[0] - 0.5, middle[1] - 0.5, marker="o", markersize=7, markerfacecolor="none",
        markeredgecolor=ORANGE, markeredgewidth=2, path_effects=stroke(3.4), zorder=3.1,
        scalex=False, scaley=False,
    )  # fmt: skip
    families, lines = legible(bar.lines)
    look = lettering(axes, WHITE) | {"fontfamily": families, "ha": "center", "zorder": 3}
    label = axes.text(0, 0, "\n".join(lines), **look)
    extent = label.get_window_extent(ruler(axes.figure))
    room, half = (
        side * 72 / axes.figure.dpi / points for side in (extent.height, extent.width / 2)
    )
    y, downward = _row(y1, y2, height, gap, label_gap + room + margin)
    left = min(max(middle[0] - bar.length_px / 2, margin), width - margin - bar.length_px)
    axes.plot(
        [left - 0.5, left + bar.length_px - 0.5], [y - 0.5] * 2, color=WHITE, linewidth=3,
        solid_capstyle="butt", marker="|", markersize=9, markeredgewidth=1.6,
        path_effects=stroke(5.0), zorder=3, scalex=False, scaley=False,
    )  # fmt: skip
    centre = min(max(left + bar.length_px / 2, half + margin), width - half - margin)
    label.set(va="top" if downward else "bottom")
    label.set_position((centre - 0.5, y - 0.5 + (label_gap if downward else -label_gap)))


def _row(top: float, bottom: float, height: float, gap: float, room: float) -> tuple[float, bool]:
    """Choose the bar's row, and whether its label is below it: under the thing, else above it."""
    if bottom + gap + room <= height:
        return bottom + gap, True
    if top - gap - room >= 0:
        return top - gap, False
    return max(height - gap / 2 - room, 0.0), True
