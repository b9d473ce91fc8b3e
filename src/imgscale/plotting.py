"""Pictures of results. Functions take ``ax=None`` and return the axes; nothing is shown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from imgscale._optional import require
from imgscale._typing import ImageArray
from imgscale.detection import Detection
from imgscale.estimate import SizeEstimate
from imgscale.flags import Flag

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_sizes"]

# Okabe and Ito's sky blue and orange are told apart with every common colour blindness.
_REFERENCE_COLOUR = "#56B4E9"
_UNKNOWN_COLOUR = "#E69F00"
_PURPOSE = "Drawing"
_PIXELS_PER_INCH = 100


def draw_sizes(
    image: ImageArray,
    detections: Sequence[Detection],
    estimates: Sequence[SizeEstimate],
    *,
    level: float = 0.9,
    ax: Axes | None = None,
) -> Axes:
    """
    Draw boxes with their sizes on a photo.

    References have a solid blue box, other objects a dashed orange one. Each carries its label,
    its size and the half width of its interval.

    Parameters
    ----------
    image : (H, W, 3) ndarray of uint8
        The photo.
    detections : sequence of Detection
        The objects.
    estimates : sequence of SizeEstimate
        Their sizes, in the same order.
    level : float
        Probability of the interval, above 0 and below 1.
    ax : matplotlib Axes, optional
        Where to draw; a new figure of the photo's shape where omitted.

    Returns
    -------
    matplotlib Axes
        The axes; save with ``ax.figure.savefig(path)``.

    Raises
    ------
    ValueError
        If there is not one estimate per detection.
    MissingDependencyError
        If matplotlib is not installed.
    """
    if len(detections) != len(estimates):
        msg = f"`estimates` must hold one per detection, {len(detections)}; got {len(estimates)}."
        raise ValueError(msg)
    patches = require("matplotlib.patches", extra="plot", purpose=_PURPOSE)
    lines = require("matplotlib.lines", extra="plot", purpose=_PURPOSE)
    axes: Any = _photo_axes(image.shape[1], image.shape[0]) if ax is None else ax
    axes.imshow(image)
    axes.set_axis_off()
    # lower boxes first, so that the label of an upper one may give way upwards
    order = sorted(range(len(detections)), key=lambda i: -detections[i].xyxy[1])
    taken: list[Any] = []
    for index in order:
        detection, estimate = detections[index], estimates[index]
        known = Flag.REFERENCE in estimate.flags
        colour = _REFERENCE_COLOUR if known else _UNKNOWN_COLOUR
        x1, y1, x2, y2 = detection.xyxy
        box = patches.Rectangle(
            (x1 - 0.5, y1 - 0.5), x2 - x1, y2 - y1, fill=False, edgecolor=colour, linewidth=2,
            linestyle="-" if known else "--",
        )  # fmt: skip
        axes.add_patch(box)
        taken.append(_place_text(axes, detection, _size_text(estimate, level), colour, taken))
    handles = [
        lines.Line2D([], [], color=_REFERENCE_COLOUR, linewidth=2, label="known size (reference)"),
        lines.Line2D([], [], color=_UNKNOWN_COLOUR, linewidth=2, linestyle="--", label="measured"),
    ]
    axes.legend(handles=handles, loc="lower left", fontsize=9, framealpha=0.9)
    return cast("Axes", axes)


def _photo_axes(width: int, height: int) -> Any:
    """Make axes that a photo fills, without the global state of pyplot."""
    figure_module = require("matplotlib.figure", extra="plot", purpose=_PURPOSE)
    inches = 10.0
    figure = figure_module.Figure(figsize=(inches, inches * height / width), dpi=_PIXELS_PER_INCH)
    agg = require("matplotlib.backends.backend_agg", extra="plot", purpose=_PURPOSE)
    agg.FigureCanvasAgg(figure)  # a canvas that can measure text; it stays with the figure
    return figure.add_axes((0, 0, 1, 1))


def _size_text(estimate: SizeEstimate, level: float) -> str:
    if np.isnan(estimate.size_m):
        return f"{estimate.label}\nno depth"
    low, high = estimate.interval(level)
    return f"{estimate.label}\n{estimate.size_m:.2f} m ({low:.2f} to {high:.2f})"


def _place_text(ax: Any, detection: Detection, text: str, colour: str, taken: Sequence[Any]) -> Any:
    """Write a label beside or inside its box, at the place that covers least; return its extent."""
    x1, y1, x2, y2 = detection.xyxy
    gap = 6
    places = (
        (x1, y1 - gap, "left", "bottom"),
        (x2, y1 - gap, "right", "bottom"),
        (x1, y2 + gap, "left", "top"),
        (x2, y2 + gap, "right", "top"),
        (x2 + gap, y1, "left", "top"),
        (x1 - gap, y1, "right", "top"),
        (x1 + gap, y1 + gap, "left", "top"),
    )
    label = ax.text(
        x1, y1, text, color="white", fontsize=9, linespacing=1.2,
        bbox={"facecolor": "#202020", "edgecolor": colour, "alpha": 0.85, "pad": 2},
    )  # fmt: skip
    renderer = ax.figure.canvas.get_renderer()
    frame = ax.get_window_extent(renderer)

    def extent_at(place: tuple[float, float, str, str]) -> Any:
        x, y, horizontal, vertical = place
        label.set_position((x, y))
        label.set(horizontalalignment=horizontal, verticalalignment=vertical)
        return label.get_window_extent(renderer).padded(4)

    def cost(place: tuple[float, float, str, str]) -> float:
        extent = extent_at(place)
        outside = extent.width * extent.height - _common_area(extent, frame)
        return float(10 * outside + sum(_common_area(extent, other) for other in taken))

    return extent_at(min(places, key=cost))


def _common_area(a: Any, b: Any) -> float:
    """Area that two extents share, in square display pixels."""
    width = min(a.x1, b.x1) - max(a.x0, b.x0)
    height = min(a.y1, b.y1) - max(a.y0, b.y0)
    return float(max(0.0, width) * max(0.0, height))
