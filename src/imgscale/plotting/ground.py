"""The ground plane over the photo: its horizon and a grid of squares."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from imgscale._checks import check_type, positive_number
from imgscale._format import with_error
from imgscale._optional import require
from imgscale._typing import FloatArray
from imgscale.camera import Camera
from imgscale.estimate import central_scores, percent
from imgscale.model import ScaleModel
from imgscale.picture import Picture
from imgscale.plotting._canvas import (
    INK,
    ORANGE,
    PURPOSE,
    SKY_BLUE,
    WHITE,
    add_legend,
    check_photo,
    letter_size,
    lettering,
    picture_axes,
    points_of,
    stroke,
)
from imgscale.plotting._plane import PlaneView

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_ground_plane"]

# Sides of squares, each a multiple of the one before.
_SIDES = (1, 5, 20, 100, 500, 2000)
# Lines this near to each other, in points, are not drawn; from three times as far they are solid.
_CROWDED, _CLEAR = 5.0, 15.0
_FAINTEST = 0.06
# Distances that are written: 1, 2, 5, 10, ... m.
_LABELLED = tuple(lead * 10**power for power in range(5) for lead in (1, 2, 5))
# Pieces of a line that runs away from the viewer, each of its own opacity.
_PIECES = 12
# Poles: each that many times as high as the one before, the least in heights of letters.
_POLE_RATIO, _LEAST_POLE = 0.66, 1.5


class Line(NamedTuple):
    """
    A piece of the grid.

    Attributes
    ----------
    ends : (2, 2) ndarray of float64
        Columns and rows of its ends, in pixels.
    opacity : float
        0 to 1.
    side : int
        Side of the squares it bounds, in metres.
    """

    ends: FloatArray
    opacity: float
    side: int


def draw_ground_plane(
    model: ScaleModel,
    *,
    image: Picture | NDArray[Any] | None = None,
    camera: Camera | None = None,
    extent_m: float | None = None,
    level: float = 0.9,
    ax: Axes | None = None,
) -> Axes:
    """
    Draw the horizon and a grid of one-metre squares on the ground.

    Farther away, where squares of 1 m would crowd, those of 5, 20, 100 m go on. Without a focal
    length nobody knows how long a square looks: poles of 1 m then stand in its place (of 0.1 or
    10 m for cameras below 1 m or above 10 m), which the camera's height and the horizon tell alone.

    Parameters
    ----------
    model : ScaleModel
        A model with a ground plane, as the only witness of distance or beside a depth.
    image : path, PIL image or ndarray, optional
        The photo, as `draw_sizes` takes it; an empty picture, or what is on `ax`, where omitted.
    camera : Camera, optional
        Focal length and principal point, in pixels; the model's where omitted. Better give it to
        `fit`, whose sizes then heed the tilt of the camera too.
    extent_m : float, optional
        How far ahead the grid goes at most, in metres, positive; as far as lines can be told apart
        where omitted.
    level : float
        Probability of the band about the horizon, above 0 and below 1.
    ax : matplotlib Axes, optional
        Where to draw, in pixels of the photo; a new figure of its shape where omitted.

    Returns
    -------
    matplotlib Axes
        The axes; save with ``ax.figure.savefig(path)``.

    Raises
    ------
    ValueError
        If the model has no ground plane, or an argument breaks its law.
    MissingDependencyError
        If matplotlib is not installed.

    Notes
    -----
    With the horizon y0 + r u and the camera's height h, the ground's downward normal is ``n = (-r,
    1, -y0 / f) / s``, s its length, and a pixel (u, v) about the principal point sees it at the
    z-depth ``f h s / (v - y0 - r u)``. `fit` and `predict` leave r^2 out of s. Distances are those
    along the ground, ahead of the point below the camera.

    Examples
    --------
    >>> import imgscale as ims
    >>> from imgscale.plotting import draw_ground_plane
    >>> street = [ims.Detection("person", (310, 344, 388, 576)),
    ...           ims.Detection("person", (840, 352, 880, 480)),
    ...           ims.Detection("car", (520, 369, 700, 507))]
    >>> model = ims.fit(street, ims.GroundPlane(image_size=(1280, 720)))
    >>> camera = ims.Camera(1000.0, focal_rel_std=0.04)
    >>> ax = draw_ground_plane(model, camera=camera)  # doctest: +SKIP
    """
    check_type("model", model, ScaleModel)
    if camera is not None:
        check_type("camera", camera, Camera)
    if extent_m is not None:
        extent_m = positive_number("extent_m", extent_m)
    view = PlaneView.of(model, camera)
    _, score = central_scores(level)
    photo = None if image is None else check_photo(image)
    axes = picture_axes(photo, view.image_size, ax)
    handles = [_draw_horizon(axes, model, view, score, level)]
    if math.isfinite(view.focal_px):
        lines = grid_lines(view, points_of(axes)[0] / view.image_size[0], extent_m)
        handles += _draw_lines(axes, lines)
        _label_distances(axes, view, lines, extent_m)
    else:
        handles.append(_draw_poles(axes, view))
    plane: Any = model.plane
    height = with_error(plane.camera_height_m, plane.camera_height_std_m)
    add_legend(axes, handles, title=f"camera {height} m above the ground", loc="lower right")
    return cast("Axes", axes)


def grid_lines(view: PlaneView, points_per_pixel: float, extent_m: float | None) -> list[Line]:
    """
    Find the lines of the grid, each as far as it is told apart from its neighbours.

    Parameters
    ----------
    view : PlaneView
        The plane.
    points_per_pixel : float
        Size of the image's pixels on paper.
    extent_m : float or None
        How far ahead the grid goes at most.

    Returns
    -------
    list of Line
        Clipped to the picture.
    """
    near = _nearest(view)
    lines: list[Line] = []
    for side, larger in zip(_SIDES, (*_SIDES[1:], 0), strict=True):
        reach = _reach(view, side * points_per_pixel / _CROWDED)
        if extent_m is not None:
            reach = min(reach, extent_m)
        if reach > near:
            fade = _Fade(view, side * points_per_pixel)
            across = _transversals(view, near, reach, side, larger, fade)
            lines += across
            if across:
                lines += _receding(view, near, reach, side, larger, fade)
    return lines


def _nearest(view: PlaneView) -> float:
    """Find how far ahead the nearest ground in the picture is; inf where there is none."""
    width, height = view.image_size
    corners_x, corners_y = np.array([0, width, 0, width]), np.array([height, height, 0, 0])
    seen = view.below_horizon(corners_x, corners_y) > 0
    if not seen.any():
        return math.inf
    return float(view.ground_at(corners_x[seen], corners_y[seen])[:, 1].min())


def _reach(view: PlaneView, scale: float) -> float:
    """Find how far ahead 1 m of ground is `1 / scale` pixels deep."""
    _, down, along = view.frame
    # rows are f h s / z below the horizon, and z changes by along[2] for each metre ahead
    z_depth = math.sqrt(view.focal_px * view.height_m * view.secant * along[2] * scale)
    return float((z_depth - view.height_m * down[2]) / along[2])


class _Fade(NamedTuple):
    """How solid lines of one side are."""

    view: PlaneView
    points: float  # on paper, of a side that looks as long as a pixel per metre

    def opacity(self, ahead: float) -> float:
        _, down, along = self.view.frame
        z = self.view.height_m * down[2] + ahead * along[2]
        rows = self.view.focal_px * self.view.height_m * self.view.secant * along[2] / z**2
        clear = (float(rows) * self.points - _CROWDED) / (_CLEAR - _CROWDED)
        return min(max(clear, _FAINTEST), 1.0)


def _multiples(low: float, high: float, side: int, larger: int) -> list[int]:
    """List multiples of a side that larger squares do not draw; the zero line is of all."""
    numbers = range(math.ceil(low / side) * side, math.floor(high / side) * side + 1, side)
    return [number for number in numbers if not number or not larger or number % larger]


def _transversals(
    view: PlaneView, near: float, reach: float, side: int, larger: int, fade: _Fade
) -> list[Line]:
    """Lines across the view."""
    lines: list[Line] = []
    for ahead in _multiples(near, reach, side, larger):
        ends = transversal(view, ahead)
        if ends is not None:
            lines.append(Line(ends, fade.opacity(ahead), side))
    return lines


def transversal(view: PlaneView, ahead: float) -> FloatArray | None:
    """
    Find the line across the picture at a distance.

    Parameters
    ----------
    view : PlaneView
        The plane.
    ahead : float
        The distance along the ground, in metres.

    Returns
    -------
    (2, 2) ndarray of float64 or None
        Columns and rows of its left and right end; None where it is not in the picture.
    """
    span = view.in_picture(view.in_camera(0.0, ahead), view.frame[0], -math.inf, math.inf)
    return None if span is None else view.project(np.array(span), ahead)


def _receding(
    view: PlaneView, near: float, reach: float, side: int, larger: int, fade: _Fade
) -> list[Line]:
    """Lines that run to the vanishing point, in pieces that grow fainter."""
    width, height = view.image_size
    edge = view.project(0.0, reach)[1]
    corners = view.ground_at([0, width, 0, width], [edge, edge, height, height])[:, 0]
    lines: list[Line] = []
    for right in _multiples(float(corners.min()), float(corners.max()), side, larger):
        span = view.in_picture(view.in_camera(right, 0.0), view.frame[2], near, reach)
        if span is None:
            continue
        # equal steps in the picture, about
        low, high = (view.project(right, ahead) for ahead in span)
        rows = np.linspace(low, high, _PIECES + 1)
        places = view.ground_at(rows[:, 0], rows[:, 1])[:, 1]
        lines += [
            Line(rows[i : i + 2], fade.opacity(float(places[i : i + 2].mean())), side)
            for i in range(_PIECES)
        ]
    return lines


def _draw_lines(axes: Any, lines: list[Line]) -> list[Any]:
    """Draw the grid, dark under light; return what stands for it in the legend."""
    collections = require("matplotlib.collections", extra="plot", purpose=PURPOSE)
    line2d = require("matplotlib.lines", extra="plot", purpose=PURPOSE)
    if not lines:
        return []
    sides = sorted({line.side for line in lines})
    ends = [line.ends - 0.5 for line in lines]
    widths = np.array([0.9 if line.side == sides[0] else 1.4 for line in lines])
    opacity = np.array([line.opacity for line in lines])
    for colour, more, share in ((INK, 1.2, 0.55), (WHITE, 0.0, 1.0)):
        axes.add_collection(
            collections.LineCollection(
                ends, colors=colour, linewidths=widths + more, alpha=opacity * share, zorder=2.1
            ),
            autolim=False,
        )
    text = f"squares of {', '.join(map(str, sides))} m" if len(sides) > 1 else f"{sides[0]} m"
    handle = line2d.Line2D([], [], color=WHITE, linewidth=1.4, path_effects=stroke(2.6), label=text)
    return [handle]


def _label_distances(axes: Any, view: PlaneView, lines: list[Line], extent_m: float | None) -> None:
    """Write distances at the left ends of lines, where there is room."""
    collections = require("matplotlib.collections", extra="plot", purpose=PURPOSE)
    if not lines:
        return
    room = 1.9 * letter_size(axes) * view.image_size[0] / points_of(axes)[0]
    lowest = math.inf
    marked: list[FloatArray] = []
    for ahead in _LABELLED:
        ends = transversal(view, ahead)
        if ends is None or (extent_m is not None and ahead > extent_m):
            continue
        x, y = ends[0] + 0.03 * (ends[1] - ends[0])
        above = float(view.below_horizon(x, y)) < room / 2
        if above or lowest - y < room or not room < y < view.image_size[1] - room:
            continue
        lowest = y
        marked.append(ends - 0.5)
        axes.text(
            x - 0.5, y - 0.5, f"{ahead} m", ha="left", va="center", zorder=2.3,
            **lettering(axes, WHITE),
        )  # fmt: skip
    axes.add_collection(
        collections.LineCollection(
            marked, colors=SKY_BLUE, linewidths=1.4, path_effects=stroke(2.4), zorder=2.2
        ),
        autolim=False,
    )


def _draw_horizon(axes: Any, model: ScaleModel, view: PlaneView, score: float, level: float) -> Any:
    """Draw the horizon with its interval; return what stands for it in the legend."""
    width, height = view.image_size
    plane: Any = model.plane
    columns = np.linspace(0, width, 65)
    from_middle = columns - width / 2
    rows = plane.horizon_px + view.slope * from_middle
    roll_std = math.radians(plane.roll_std_deg) * (1 + view.slope**2)
    error = score * np.hypot(plane.horizon_std_px, roll_std * from_middle)
    shown = columns - 0.5, rows - error - 0.5, rows + error - 0.5
    axes.fill_between(*shown, color=ORANGE, alpha=0.3, linewidth=0, zorder=2.05)
    row = with_error(plane.horizon_px, plane.horizon_std_px)
    text = f"horizon, row {row}; band {percent(level)}"
    if not (rows.max() > 0 and rows.min() < height):
        text += f" ({'above' if rows.max() <= 0 else 'below'} the picture)"
    (line,) = axes.plot(
        columns - 0.5, rows - 0.5, color=ORANGE, linewidth=2, path_effects=stroke(3.2), zorder=2.5,
        label=text, scalex=False, scaley=False,
    )  # fmt: skip
    return line


def _draw_poles(axes: Any, view: PlaneView) -> Any:
    """Stand poles on the ground, from near to far; return what stands for them in the legend."""
    width, height = view.image_size
    length = 10.0 ** math.floor(math.log10(view.height_m))
    per_point = width / points_of(axes)[0]
    least = _LEAST_POLE * letter_size(axes) * per_point
    below = float(view.below_horizon(width / 2, 0.97 * height))
    feet: list[float] = []
    while below * length / view.height_m > least and len(feet) < 9:
        feet.append(below)
        below *= _POLE_RATIO
    for index, depth in enumerate(feet):
        x = width * (0.1 + 0.8 * index / max(len(feet) - 1, 1))
        foot = view.cy + view.horizon + view.slope * (x - view.cx) + depth
        top = foot - depth * length / view.height_m
        axes.plot(
            [x - 0.5] * 2, [foot - 0.5, top - 0.5], color=SKY_BLUE, linewidth=2.2, marker="_",
            markersize=7, markeredgewidth=2.2, path_effects=stroke(3.8), zorder=2.2,
            scalex=False, scaley=False,
        )  # fmt: skip
    line2d = require("matplotlib.lines", extra="plot", purpose=PURPOSE)
    text = f"poles of {length:g} m; squares on the ground need camera="
    return line2d.Line2D(
        [], [], color=SKY_BLUE, linewidth=2.2, path_effects=stroke(3.8), label=text
    )
