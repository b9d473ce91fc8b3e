"""Metres per pixel all over the photo."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from imgscale._checks import check_choice, check_type
from imgscale._format import PER_METRE
from imgscale._optional import require
from imgscale._typing import BoolArray, FloatArray, IntArray
from imgscale.depth import DepthMap, GroundPlane
from imgscale.flags import Flag, flag_words
from imgscale.laws import LAWS
from imgscale.model import ScaleModel
from imgscale.picture import Picture
from imgscale.plotting._canvas import (
    INK,
    PURPOSE,
    WHITE,
    add_legend,
    cell_centres,
    check_photo,
    letter_size,
    picture_axes,
    points_of,
    ruler,
    stroke,
)
from imgscale.plotting._raster import Raster, raster_of
from imgscale.plotting.scale_bar import round_length

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_scale_map"]

# Matplotlib's default: perceptually uniform, and lightness alone tells its values apart.
_COLOURS = "viridis"
# Opacity over a photo, and how pale that is, under colours and under points.
_COVER = 0.6
_PALE, _PALEST = 0.3, 0.6
# The range of colours is that of this share of the pixels; where it spans more than a factor of
# `_WIDE`, colours go with the logarithm.
_SHOWN, _WIDE = 0.98, 4.0
_LEAST_CONTOURS, _MOST_CONTOURS = 4, 9
# Longer side of the map that contours are taken from.
_CONTOUR_CELLS = 400
_MOST_POINTS = 60000
# Neighbours further apart than this ratio are of two surfaces, with no contour between them.
_JUMP = 1.06
# Noise is smoothed for contours by a Gaussian of so many cells; what that moves by more than this
# ratio is at an edge.
_SMOOTH, _MOVED = 1.5, 1.015
# Stripes over what has no scale, and thin lines far from the references: width in points; grey and
# opacity of each, from 0 to 255.
_MISSING = (4.0, ((105, 150), (225, 150)))
_FAR = (1.0, ((32, 110), (255, 110), *[(0, 0)] * 9))


def draw_scale_map(
    model: ScaleModel,
    depth: DepthMap | GroundPlane | None = None,
    *,
    image: Picture | NDArray[Any] | None = None,
    unit: str | None = None,
    same_scale: bool = False,
    ax: Axes | None = None,
) -> Axes:
    """
    Draw how long a pixel is, all over the photo: colours with contour lines.

    Pixels without depth, or beyond what a fitted shift puts at infinity, are hatched. Thin lines
    lie where a shift was fitted and objects would be flagged `EXTRAPOLATED`: over twice as near or
    as far as all references; and where many pixels of an affine map have its least value, which is
    how networks give the sky: what is seen there is that far or farther.

    Maps of which most pixels are missing, as LiDAR gives them, are drawn as points, with nothing in
    between and no contours. The photo below is grey, so that colours tell the scale alone.

    Parameters
    ----------
    model : ScaleModel
        The scale of the image.
    depth : DepthMap or None
        The map that the model was fitted to, or for metric depth any map of that camera; of another
        size than the image if need be. None for a ground-plane model: the scale where pixels see
        the ground, and nothing from the horizon upward.
    image : path, PIL image or ndarray, optional
        The photo, as `draw_sizes` takes it; the map alone, or over what is on `ax`, where omitted.
    unit : str, optional
        "m", "cm", "mm", "ft" or "in" per pixel; mm, cm or m as fits where omitted.
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
    TypeError
        If `depth` is no map.
    ValueError
        If `depth` is missing or has no valid pixel in the picture, or `image` is of another size.
    DepthMismatchError
        If `depth` is not that of the model.
    MissingDependencyError
        If matplotlib is not installed.

    Notes
    -----
    Metres per pixel are k d, for lengths parallel to the picture. Contours lie at 1, 2, 5, 10, ...
    or, where fewer than four of these are in the picture, at multiples of one of them.

    Examples
    --------
    >>> import imgscale as ims
    >>> from imgscale.datasets import motorcycle
    >>> from imgscale.plotting import draw_scale_map
    >>> scene = motorcycle.load()
    >>> model = ims.fit(scene.detections, scene.depth, scene.priors)
    >>> ax = draw_scale_map(model, scene.depth, image=scene.image)  # doctest: +SKIP
    """
    check_type("model", model, ScaleModel)
    check_type("same_scale", same_scale, bool)
    if unit is not None:
        check_choice("unit", unit, tuple(PER_METRE))
    raster = raster_of(model, depth, same_scale=same_scale)
    pale = _PALEST if raster.is_sparse else _PALE
    below = None if image is None else _grey(check_photo(image), pale)
    axes = picture_axes(below, raster.image_size, ax)
    low, high = _range(raster)
    unit = unit or _unit(math.sqrt(low * high))
    norm = _norm(low, high)
    over_photo = image is not None or bool(axes.images)
    opacity = _COVER if over_photo and not raster.is_sparse else 1.0
    if raster.is_sparse:
        _draw_points(axes, raster, norm)
    else:
        _draw_colours(axes, raster, norm, opacity)
        _draw_contours(axes, raster, contour_levels(low, high, unit), unit)
    _add_key(axes, norm, opacity, unit)
    _add_missing(axes, raster, model)
    return cast("Axes", axes)


def contour_levels(low: float, high: float, unit: str = "m") -> list[float]:
    """
    Choose round values in a range.

    Parameters
    ----------
    low, high : float
        The range, positive, in metres.
    unit : str
        The unit in which values are round.

    Returns
    -------
    list of float
        1, 2, 5, 10, ... where at least four of these are in the range, powers of ten where they
        are more than nine; else multiples of a 1, 2, or 5. In metres, rising.
    """
    per_metre = PER_METRE[unit]
    low, high = low * per_metre, high * per_metre
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for leads in ((1, 2, 5), (1,)):
        rounds = [float(f"{lead}e{power}") for power in powers for lead in leads]
        inside = [value for value in rounds if low < value < high]
        if len(inside) <= _MOST_CONTOURS:
            break
    if len(inside) < _LEAST_CONTOURS and high > low:
        step = round_length((high - low) / 6)
        first, last = math.floor(low / step) + 1, math.ceil(high / step) - 1
        inside = [step * number for number in range(first, last + 1)]
    return [value / per_metre for value in inside]


def _grey(photo: NDArray[Any], pale: float) -> NDArray[Any]:
    """Take the colours out of a photo, and make it pale."""
    channels = np.atleast_3d(photo)[..., :3]
    grey: NDArray[Any] = channels.mean(axis=2, dtype=np.float32)
    brightest = 255 if photo.dtype == np.uint8 else 1
    return np.clip(pale + (1 - pale) * grey / brightest, 0, 1)


def _range(raster: Raster) -> tuple[float, float]:
    """Find the range of nearly all that is known well, of everything where nothing is."""
    near = raster.seen & ~raster.far & ~raster.floor
    known = raster.scale[near if near.any() else raster.seen]
    some = known[:: math.ceil(known.size / _MOST_POINTS)]
    low, high = np.quantile(some, [(1 - _SHOWN) / 2, (1 + _SHOWN) / 2])
    return float(low), float(high)


def _unit(typical: float) -> str:
    """Choose the unit in which metres per pixel read best."""
    return "mm" if typical < 0.02 else "cm" if typical < 2 else "m"


def _norm(low: float, high: float) -> Any:
    """Map scales to colours."""
    colours = require("matplotlib.colors", extra="plot", purpose=PURPOSE)
    if high / low < 1.02:
        low, high = low / 1.01, high * 1.01
    return (colours.LogNorm if high / low > _WIDE else colours.Normalize)(low, high)


def _draw_colours(axes: Any, raster: Raster, norm: Any, opacity: float) -> None:
    """Colour the pixels, none of them mixed with its neighbours."""
    axes.imshow(
        np.ma.masked_invalid(raster.scale), cmap=_COLOURS, norm=norm, alpha=opacity,
        extent=raster.extent, interpolation="nearest", zorder=1,
    )  # fmt: skip


def _draw_points(axes: Any, raster: Raster, norm: Any) -> None:
    """Draw each value as a point, some of them where there are very many."""
    rows, columns = np.nonzero(raster.seen)
    kept = slice(None, None, math.ceil(rows.size / _MOST_POINTS))
    x, y = cell_centres(raster.scale.shape, raster.image_size)
    pitch = points_of(axes)[0] / raster.scale.shape[1]
    side = min(max(2.0 * pitch, 1.5), 6.0)
    axes.scatter(
        x[columns[kept]] - 0.5, y[rows[kept]] - 0.5, s=side**2,
        c=raster.scale[rows[kept], columns[kept]], cmap=_COLOURS, norm=norm, linewidths=0,
        zorder=1.1,
    )  # fmt: skip


def _draw_contours(axes: Any, raster: Raster, levels: list[float], unit: str) -> None:
    """Draw lines of equal scale, not across missing pixels, with their values."""
    step = math.ceil(max(raster.scale.shape) / _CONTOUR_CELLS)
    coarse = raster.scale[::step, ::step]
    if not levels or min(coarse.shape) < 2:
        return
    x, y = cell_centres(raster.scale.shape, raster.image_size, step)
    lines = axes.contour(
        x - 0.5, y - 0.5, _smoothed(coarse), levels=levels, colors=WHITE,
        linewidths=1.2, zorder=1.2,
    )  # fmt: skip
    lines.set_path_effects(stroke(2.4))
    texts = {level: f"{_number(level, unit)} {unit}/px" for level in levels}
    labels = axes.clabel(lines, fmt=texts, fontsize=letter_size(axes), colors=WHITE, inline=True)
    frame, renderer = axes.get_window_extent(), ruler(axes.figure)
    shown: list[Any] = []
    for label in labels:
        label.set_path_effects(stroke(2.5))
        extent = label.get_window_extent(renderer)
        clear = frame.x0 <= extent.x0 and extent.x1 <= frame.x1 and not extent.count_overlaps(shown)
        label.set_visible(clear)
        shown += [extent] if clear else []


def _smoothed(scale: FloatArray) -> Any:
    """Average each surface for itself; what is missing or at an edge stays masked."""
    import skimage as ski  # noqa: PLC0415 - loads its parts on use

    gaussian: Any = cast("Any", ski.filters).gaussian  # untyped there
    lost = ~np.isfinite(scale) | _jumps(scale)
    options = {"sigma": _SMOOTH, "truncate": 2.0, "mode": "nearest", "preserve_range": True}
    share = gaussian((~lost).astype(np.float64), **options)
    total = gaussian(np.where(lost, 0.0, scale), **options)
    with np.errstate(invalid="ignore", divide="ignore"):
        average = total / share
        moved = np.abs(np.log(average / scale)) > math.log(_MOVED)
    return np.ma.masked_where(lost | moved, average)


def _jumps(scale: FloatArray) -> BoolArray:
    """Mark values beside which another surface begins."""
    jumps = np.zeros(scale.shape, dtype=np.bool_)
    for axis in (0, 1):
        apart = np.abs(np.diff(np.log(scale), axis=axis)) > math.log(_JUMP)
        before, after = [(0, 0), (0, 0)], [(0, 0), (0, 0)]
        before[axis], after[axis] = (0, 1), (1, 0)
        jumps |= np.pad(apart, before) | np.pad(apart, after)
    return jumps


def _number(level: float, unit: str) -> str:
    return f"{level * PER_METRE[unit]:.4g}"


def _key_colours(norm: Any, opacity: float) -> Any:
    """Colours as they look on a photo of middling grey."""
    cm = require("matplotlib.cm", extra="plot", purpose=PURPOSE)
    colours = require("matplotlib.colors", extra="plot", purpose=PURPOSE)
    solid = cm.ScalarMappable(cmap=_COLOURS).to_rgba(np.linspace(0, 1, 256))[:, :3]
    below = _PALE + (1 - _PALE) / 2
    seen = colours.ListedColormap(opacity * solid + (1 - opacity) * below)
    return cm.ScalarMappable(norm, seen)


def _add_key(axes: Any, norm: Any, opacity: float, unit: str) -> None:
    """Lay a colour bar on a dark plate in the lower right corner."""
    patches = require("matplotlib.patches", extra="plot", purpose=PURPOSE)
    ticker = require("matplotlib.ticker", extra="plot", purpose=PURPOSE)
    size = letter_size(axes)
    width, height = points_of(axes)
    wide, tall = min(16 * size, 0.8 * width) / width, 3.6 * size / height
    gap_x, gap_y = 6 / width, 6 / height
    left, bottom = 1 - wide - gap_x, gap_y
    axes.add_patch(
        patches.Rectangle(
            (left, bottom), wide, tall, transform=axes.transAxes, facecolor=INK, edgecolor=WHITE,
            zorder=4,
        )
    )  # fmt: skip
    inside = (left + 0.07 * wide, bottom + 0.42 * tall, 0.86 * wide, 0.22 * tall)
    bar_axes = axes.inset_axes(inside, zorder=5)
    bar = axes.figure.colorbar(
        _key_colours(norm, opacity), cax=bar_axes, orientation="horizontal", extend="both"
    )
    ticks = contour_levels(norm.vmin, norm.vmax, unit)
    ticks = ticks[:: math.ceil(len(ticks) / 5)]
    bar.set_ticks(ticks, labels=[_number(tick, unit) for tick in ticks])
    bar_axes.xaxis.set_minor_locator(ticker.NullLocator())
    bar_axes.tick_params(colors=WHITE, labelsize=0.9 * size, length=2, pad=1)
    bar_axes.set_title(f"scale, {unit} per pixel", color=WHITE, fontsize=size, pad=2)
    bar.outline.set_edgecolor(WHITE)


def _add_missing(axes: Any, raster: Raster, model: ScaleModel) -> None:
    """Hatch what has no scale or a doubtful one, and say so."""
    missing = ~raster.seen
    if raster.is_sparse:
        line2d = require("matplotlib.lines", extra="plot", purpose=PURPOSE)
        text = f"depth at these points; none at {_share(missing)} of the pixels"
        point = line2d.Line2D([], [], marker=".", linestyle="", color=WHITE, label=text)
        add_legend(axes, [point], loc="lower left")
        return
    handles: list[Any] = []
    if missing.any() and model.kind != "ground_plane":  # whose sky needs no word
        _hatch(axes, raster, missing, *_MISSING)
        what = "scale" if LAWS[model.kind].has_shift else "depth"
        handles.append(_patch("////", WHITE, "#808080", f"no {what} ({_share(missing)})"))
    if raster.far.any():
        _hatch(axes, raster, raster.far, *_FAR)
        text = f"{flag_words(Flag.EXTRAPOLATED)[0]} ({_share(raster.far)})"
        handles.append(_patch("///", INK, "#B0B0B0", text))
    if raster.floor.any():
        _hatch(axes, raster, raster.floor, *_FAR, falling=True)
        text = f"the map's least value: so far or farther ({_share(raster.floor)})"
        handles.append(_patch("\\\\\\", INK, "#B0B0B0", text))
    if handles:
        add_legend(axes, handles, loc="lower left")


def _share(where: BoolArray) -> str:
    percent = 100 * np.count_nonzero(where) / where.size
    return f"{percent:.0f} %" if percent >= 0.5 else "below 1 %"


def _patch(hatch: str, lines: str, ground: str, text: str) -> Any:
    patches = require("matplotlib.patches", extra="plot", purpose=PURPOSE)
    return patches.Patch(facecolor=ground, edgecolor=lines, hatch=hatch, linewidth=0, label=text)


def _hatch(
    axes: Any,
    raster: Raster,
    where: BoolArray,
    pitch: float,
    stripes: Sequence[tuple[int, int]],
    *,
    falling: bool = False,
) -> None:
    """Lay diagonal stripes over pixels: each a grey and an opacity, so many points wide."""
    rows, columns = where.shape
    wide = max(1, round(pitch * columns / points_of(axes)[0]))
    across: IntArray = np.arange(columns, dtype=np.intp) * (-1 if falling else 1)
    diagonals: IntArray = np.arange(rows, dtype=np.intp)[:, None] + across
    looks = np.array(stripes, dtype=np.uint8)[diagonals // wide % len(stripes)]
    shade = np.stack([looks[..., 0]] * 3 + [np.where(where, looks[..., 1], 0)], axis=-1)
    axes.imshow(shade, extent=raster.extent, interpolation="nearest", zorder=1.05)
