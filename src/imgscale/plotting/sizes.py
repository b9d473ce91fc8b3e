"""Pictures of results. Functions take ``ax=None`` and return the axes; nothing is shown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

from imgscale._format import digits_for
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
_INCHES = 10.0
_LEAST_DPI = 100.0


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
    its size and its interval.

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
    extents = [_display_extent(axes, detection) for detection in detections]
    labels: list[Any] = []
    for index, (detection, estimate) in enumerate(zip(detections, estimates, strict=True)):
        known = Flag.REFERENCE in estimate.flags
        colour = _REFERENCE_COLOUR if known else _UNKNOWN_COLOUR
        x1, y1, x2, y2 = detection.xyxy
        box = patches.Rectangle(
            (x1 - 0.5, y1 - 0.5), x2 - x1, y2 - y1, fill=False, edgecolor=colour, linewidth=2,
            linestyle="-" if known else "--",
        )  # fmt: skip
        axes.add_patch(box)
        others = [*extents[:index], *extents[index + 1 :]]
        text = _size_text(estimate, level)
        labels.append(_place_text(axes, extents[index], text, colour, labels, others))
    handles = [
        lines.Line2D([], [], color=_REFERENCE_COLOUR, linewidth=2, label="known size (reference)"),
        lines.Line2D([], [], color=_UNKNOWN_COLOUR, linewidth=2, linestyle="--", label="measured"),
    ]
    axes.legend(handles=handles, loc="lower left", fontsize=9, framealpha=0.9)
    return cast("Axes", axes)


def _photo_axes(width: int, height: int) -> Any:
    """Make axes that a photo fills pixel by pixel, without the global state of pyplot."""
    figure_module = require("matplotlib.figure", extra="plot", purpose=_PURPOSE)
    longer = max(width, height)
    size = (_INCHES * width / longer, _INCHES * height / longer)
    figure = figure_module.Figure(figsize=size, dpi=max(_LEAST_DPI, longer / _INCHES))
    return figure.add_axes((0, 0, 1, 1))


def _size_text(estimate: SizeEstimate, level: float) -> str:
    """Write label, size and interval, to the digits that its error justifies."""
    if math.isnan(estimate.size_m):
        return f"{estimate.label}\nno depth"
    low, high = estimate.interval(level)
    digits = digits_for(estimate.std_m) if estimate.std_m > 0 else 3
    return (
        f"{estimate.label}\n{estimate.size_m:.{digits}f} m ({low:.{digits}f} to {high:.{digits}f})"
    )


def _display_extent(ax: Any, detection: Detection) -> Any:
    """Give the box in the picture's own pixels, y upwards."""
    transforms = require("matplotlib.transforms", extra="plot", purpose=_PURPOSE)
    x1, y1, x2, y2 = detection.xyxy
    return transforms.Bbox(ax.transData.transform([(x1, y2), (x2, y1)]))


def _place_text(
    ax: Any, box: Any, text: str, colour: str, labels: Sequence[Any], boxes: Sequence[Any]
) -> Any:
    """Write a label beside or inside its box, at the place that covers least; return its extent."""
    gap = 0.05 * ax.figure.dpi
    places = (
        (box.x0, box.y1 + gap, "left", "bottom"),
        (box.x1, box.y1 + gap, "right", "bottom"),
        (box.x0, box.y0 - gap, "left", "top"),
        (box.x1, box.y0 - gap, "right", "top"),
        (box.x1 + gap, box.y1, "left", "top"),
        (box.x0 - gap, box.y1, "right", "top"),
        (box.x0 + gap, box.y1 - gap, "left", "top"),
    )
    label = ax.text(
        0,
        0,
        text,
        color="white",
        fontsize=9,
        linespacing=1.2,
        parse_math=False,
        transform=ax.transAxes,
        bbox={"facecolor": "#202020", "edgecolor": colour, "alpha": 0.85, "pad": 2},
    )
    frame = ax.get_window_extent()

    def extent_at(place: tuple[float, float, str, str]) -> Any:
        x, y, horizontal, vertical = place
        label.set_position(ax.transAxes.inverted().transform((x, y)))
        label.set(horizontalalignment=horizontal, verticalalignment=vertical)
        return label.get_window_extent().padded(gap)

    def cost(place: tuple[float, float, str, str]) -> float:
        extent = extent_at(place)
        outside = extent.width * extent.height - _common_area(extent, frame)
        on_labels = sum(_common_area(extent, other) for other in labels)
        on_boxes = sum(_common_area(extent, other) for other in boxes)
        return float(10 * outside + 3 * on_labels + on_boxes)

    return extent_at(min(places, key=cost))


def _common_area(a: Any, b: Any) -> float:
    """Area that two extents share, in square pixels of the picture."""
    width = min(a.x1, b.x1) - max(a.x0, b.x0)
    height = min(a.y1, b.y1) - max(a.y0, b.y0)
    return float(max(0.0, width) * max(0.0, height))
