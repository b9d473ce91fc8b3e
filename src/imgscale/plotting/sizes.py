"""The photo with every object's size on it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, cast

import attrs
import numpy as np
from numpy.typing import NDArray

from imgscale._checks import check_choice, check_iterable, check_type
from imgscale._format import PER_METRE
from imgscale._optional import require
from imgscale._typing import Box, FloatArray
from imgscale.detection import Detection, check_detections
from imgscale.estimate import SizeEstimate, central_scores
from imgscale.extent import outside_image
from imgscale.flags import Flag
from imgscale.model import ScaleModel
from imgscale.picture import Picture
from imgscale.plotting._canvas import (
    ORANGE,
    PURPOSE,
    SKY_BLUE,
    WHITE,
    add_legend,
    check_photo,
    legible,
    letter_size,
    lettering,
    photo_size,
    picture_axes,
    points_of,
    ruler,
    stroke,
)
from imgscale.plotting._labels import place_labels, place_panel
from imgscale.plotting._wording import (
    Ruling,
    label_texts,
    legend_title,
    object_names,
    rejections,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_sizes"]


@attrs.frozen
class _Style:
    """How objects of one standing are drawn: never told apart by colour alone."""

    colour: str
    line: str
    words: str


_KNOWN = _Style(SKY_BLUE, "-", "known size (reference)")
_MEASURED = _Style(ORANGE, "--", "measured")
_REJECTED = _Style(WHITE, "-.", "known size, not used")
_UNSIZED = _Style(ORANGE, ":", "no size")
_STYLES = (_KNOWN, _MEASURED, _REJECTED, _UNSIZED)

# A figure of its own grows until there is room for all words.
_ZOOMS = (1.5, 2.0)
# A plate reaches beyond its letters by so many points.
_PLATE = 2.5
# A legend that would take more of the picture is left out.
_MOST_LEGEND = 0.2


def draw_sizes(
    image: Picture | NDArray[Any],
    detections: Sequence[Detection],
    estimates: Sequence[SizeEstimate],
    *,
    model: ScaleModel | None = None,
    unit: str = "m",
    level: float = 0.9,
    ax: Axes | None = None,
) -> Axes:
    """
    Draw boxes with their sizes on a photo.

    References have a solid blue box, measured objects a dashed orange one, and objects of known
    size that were not used a dash-dotted white one, each with its size and interval, or the reason
    why there is none. Labels stand near their objects and never on each other. Where there is no
    room the label is shortened to name and size, and then to the object's place in the list from 1
    ("#7"). They are arranged anew whenever the axes are drawn in another size.

    Parameters
    ----------
    image : path, PIL image, or (H, W), (H, W, 3) or (H, W, 4) ndarray
        The photo. That of a file or PIL image is turned upright as its EXIF record says; an array
        is uint8, or float from 0 to 1, and taken as it is.
    detections : sequence of Detection
        The objects, in pixels of the photo.
    estimates : sequence of SizeEstimate
        Their sizes, in the same order.
    model : ScaleModel, optional
        What `fit` returned: it tells which objects it could not use, and why. Without it only
        outliers are known.
    unit : str
        Unit of the sizes: "m", "cm", "mm", "in" or "ft".
    level : float
        Probability of the interval, above 0 and below 1.
    ax : matplotlib Axes, optional
        Where to draw, of any size; a new figure of the photo's shape where omitted.

    Returns
    -------
    matplotlib Axes
        The axes; save with ``ax.figure.savefig(path)``. A new figure has at least the photo's
        pixels, and no fewer than 1000 along its longer side.

    Raises
    ------
    TypeError
        If an argument is of the wrong type.
    ValueError
        If there is not one estimate per detection, of the same label; if a box lies beyond the
        photo; if the photo is of another shape or range, or of another size than the model's; if
        the unit is unknown or the level no probability.
    OSError
        If a file is missing or no picture.
    MissingDependencyError
        If matplotlib is not installed.

    Examples
    --------
    >>> from imgscale.datasets import motorcycle
    >>> from imgscale.plotting import draw_sizes
    >>> import imgscale as ims
    >>> scene = motorcycle.load()
    >>> model = ims.fit(scene.detections, scene.depth, scene.priors, noise=scene.noise)
    >>> sizes = ims.predict(model, scene.detections, scene.depth)
    >>> ax = draw_sizes(scene.image, scene.detections, sizes, unit="cm")  # doctest: +SKIP
    >>> ax.figure.savefig("sizes.png")  # doctest: +SKIP
    """
    if model is not None:
        check_type("model", model, ScaleModel)
    photo = check_photo(image)
    size = (model.image_size if model else None) or photo_size(photo)
    check_choice("unit", unit, tuple(PER_METRE))
    central_scores(level)
    detections = check_detections(detections)
    estimates = _check_estimates(estimates, detections)
    _check_boxes([detection.xyxy for detection in detections], size)
    several = len({estimate.axis for estimate in estimates}) > 1
    objects = _objects(detections, estimates, model, Ruling(unit, level, several))
    title = legend_title(estimates, level)
    picture = _picture(picture_axes(photo, size, ax), objects, title)
    for zoom in _ZOOMS:
        if ax is not None or picture.complete:
            break
        axes = picture_axes(photo, size, None, zoom=zoom)
        picture = _picture(axes, objects, title, picture.sizes)
    return cast("Axes", picture.axes)


@attrs.frozen
class _Object:
    """One object as it is to be drawn: its wordings, the fullest first."""

    box: Box
    style: _Style
    wordings: tuple[str, str, str]


def _objects(
    detections: Sequence[Detection],
    estimates: Sequence[SizeEstimate],
    model: ScaleModel | None,
    ruling: Ruling,
) -> list[_Object]:
    """Join what is known of each object."""
    _, names = legible(object_names(detections, model))
    reasons = rejections(detections, estimates, model)
    rows = zip(names, detections, estimates, reasons, strict=True)
    found: list[_Object] = []
    for number, (name, detection, estimate, reason) in enumerate(rows, start=1):
        full, short = label_texts(name, estimate, reason, ruling)
        item = _Object(detection.xyxy, _style(estimate, reason), (full, short, f"#{number}"))
        found.append(item)
    return found


def _check_estimates(
    estimates: Iterable[SizeEstimate], detections: Sequence[Detection]
) -> list[SizeEstimate]:
    check_iterable("estimates", estimates, "SizeEstimate")
    checked = [check_type("estimates", estimate, SizeEstimate) for estimate in estimates]
    if len(checked) != len(detections):
        msg = f"`estimates` must hold one per detection, {len(detections)}; got {len(checked)}."
        raise ValueError(msg)
    for index, (estimate, detection) in enumerate(zip(checked, detections, strict=True)):
        if estimate.label != detection.label:
            msg = (
                f"`estimates` must be in the order of the detections; got {estimate.label!r} at "
                f"index {index}, where the detection is {detection.label!r}."
            )
            raise ValueError(msg)
    return checked


def _check_boxes(boxes: Sequence[Box], image_size: tuple[int, int]) -> None:
    array = np.array(boxes, dtype=np.float64).reshape(-1, 4)
    beyond = np.flatnonzero(outside_image(array, image_size)).tolist() if boxes else []
    if beyond:
        index, (width, height) = beyond[0], image_size
        msg = (
            f"`detections` must lie in the image, {width} x {height} px; got {boxes[index]} at "
            f"index {index}. Draw on the photo that they were found in, or scale them to this one: "
            "Detection.with_box()."
        )
        raise ValueError(msg)


def _style(estimate: SizeEstimate, reason: str) -> _Style:
    if reason:
        return _REJECTED
    if Flag.REFERENCE in estimate.flags:
        return _KNOWN
    return _UNSIZED if math.isnan(estimate.size_m) else _MEASURED


@attrs.define
class _Picture:
    """Labels of one photo, arranged again whenever its axes are drawn in another size."""

    axes: Any
    objects: Sequence[_Object]
    texts: Sequence[Any]
    leaders: Sequence[Any]
    sizes: FloatArray
    legend: Any
    arranged: object = None
    complete: bool = False

    def draw(self, _: object) -> None:
        """
        Arrange the labels anew where the axes have changed.

        Parameters
        ----------
        _ : object
            The renderer.
        """
        if self.arranged != self._view():
            self.arrange()

    def _view(self) -> object:
        return (*points_of(self.axes), *self.axes.viewLim.bounds)

    def arrange(self) -> None:
        """Put every label in its place."""
        self.arranged = self._view()
        size = points_of(self.axes)
        boxes = self._boxes(size)
        places = place_labels(size, boxes, self.sizes, self._place_legend(size, boxes))
        for index, place in enumerate(places):
            text, line = self.texts[index], self.leaders[index]
            text.set_visible(place.wording >= 0)
            line.set_visible(place.leader is not None)
            text.set_text(self.objects[index].wordings[place.wording])
            text.set_position(
                ((place.rect[0] + _PLATE) / size[0], (place.rect[1] + _PLATE) / size[1])
            )
            if place.leader:
                line.set_data(*(np.array(place.leader) / size).T)
        self.complete = all(place.wording == 0 for place in places)

    def _boxes(self, size: tuple[float, float]) -> FloatArray:
        """Boxes in points from the lower left corner of the axes."""
        corners = np.array([item.box for item in self.objects]).reshape(-1, 2, 2) - 0.5
        shares = (self.axes.transData - self.axes.transAxes).transform(corners.reshape(-1, 2))
        ends = (shares * size).reshape(-1, 2, 2)
        found: FloatArray = np.concatenate([ends.min(axis=1), ends.max(axis=1)], axis=1)
        return found

    def _place_legend(self, size: tuple[float, float], boxes: FloatArray) -> list[Box]:
        """Put the legend where it hides least; leave it out where it takes too much room."""
        if self.legend is None:
            return []
        extent = self.legend.get_window_extent(ruler(self.axes.figure))
        scale = 72 / self.axes.figure.dpi
        width, height = extent.width * scale, extent.height * scale
        self.legend.set_visible(width * height <= _MOST_LEGEND * size[0] * size[1])
        place = place_panel(size, (width, height), boxes)
        if place is None or not self.legend.get_visible():
            self.legend.set_visible(False)
            return []
        self.legend.set_loc((place[0] / size[0], place[1] / size[1]))
        return [place]


def _picture(
    axes: Any, objects: Sequence[_Object], title: str, sizes: FloatArray | None = None
) -> _Picture:
    """Draw boxes and labels."""
    for item in objects:
        _draw_box(axes, item)
    families, _ = legible([item.wordings[0] for item in objects])
    texts = [_text(axes, item, families) for item in objects]
    leaders = [_leader(axes, item.style.colour) for item in objects]
    sizes = _measure(axes, texts, objects) if sizes is None else sizes
    picture = _Picture(axes, objects, texts, leaders, sizes, _legend(axes, objects, title))
    artist = require("matplotlib.artist", extra="plot", purpose=PURPOSE).Artist()
    artist.draw = picture.draw
    artist.set_zorder(-math.inf)  # drawn first, so that the others stand where it puts them
    artist.set_in_layout(False)
    axes.add_artist(artist)
    picture.arrange()
    return picture


def _text(axes: Any, item: _Object, families: Sequence[str]) -> Any:
    """Prepare a label; it follows the axes, not the axes their labels."""
    look = lettering(axes, item.style.colour) | {"fontfamily": families, "va": "bottom"}
    text = axes.text(0, 0, item.wordings[0], transform=axes.transAxes, **look)
    text.set_in_layout(False)
    return text


def _draw_box(axes: Any, item: _Object) -> None:
    """Draw an object's box; pixel centres have whole coordinates in matplotlib."""
    patches = require("matplotlib.patches", extra="plot", purpose=PURPOSE)
    width = letter_size(axes) / 4.5
    x1, y1, x2, y2 = item.box
    box = patches.Rectangle(
        (x1 - 0.5, y1 - 0.5), x2 - x1, y2 - y1, fill=False, edgecolor=item.style.colour,
        linewidth=width, linestyle=item.style.line, path_effects=stroke(1.8 * width),
    )  # fmt: skip
    axes.add_patch(box)


def _measure(axes: Any, texts: Sequence[Any], objects: Sequence[_Object]) -> FloatArray:
    """Size of each label with its plate in each wording, in points."""
    scale, renderer = 72 / axes.figure.dpi, ruler(axes.figure)
    extents: list[tuple[float, float]] = []
    for text, item in zip(texts, objects, strict=True):
        for words in item.wordings:
            text.set_text(words)
            extent = text.get_window_extent(renderer)
            extents.append((extent.width, extent.height))
    array = np.array(extents, dtype=np.float64).reshape(-1, 3, 2)
    return array * float(scale) + 2 * _PLATE


def _leader(axes: Any, colour: str) -> Any:
    """Prepare the line from a label to its box, under the labels."""
    lines = require("matplotlib.lines", extra="plot", purpose=PURPOSE)
    width = letter_size(axes) / 9
    line = lines.Line2D(
        [], [], color=colour, linewidth=width, marker="o", markevery=[1], markersize=3 * width,
        markeredgewidth=0, transform=axes.transAxes, path_effects=stroke(2.5 * width), zorder=2.5,
    )  # fmt: skip
    line.set_in_layout(False)
    return axes.add_artist(line)


def _legend(axes: Any, objects: Sequence[_Object], title: str) -> Any:
    """Explain the styles that occur; None where nothing does."""
    styles = [style for style in _STYLES if any(item.style is style for item in objects)]
    if not styles:
        return None
    lines = require("matplotlib.lines", extra="plot", purpose=PURPOSE)
    width = letter_size(axes) / 4.5
    handles = [
        lines.Line2D([], [], color=s.colour, linestyle=s.line, linewidth=width, label=s.words)
        for s in styles
    ]
    legend = add_legend(axes, handles, title=title, handlelength=2.6, borderaxespad=0)
    legend.set_in_layout(False)
    return legend
