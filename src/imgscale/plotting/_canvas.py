"""What every picture here is drawn with: axes of a photo's shape, colours, lines, lettering."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from imgscale._checks import array_summary, check_type
from imgscale._optional import require
from imgscale._typing import FloatArray, ImageSize
from imgscale.picture import Picture, upright_rgb

PURPOSE = "Drawing"

# Okabe and Ito's colours ("Color Universal Design", 2002), told apart with every common colour
# blindness. Of the pairs of their set, blue and orange keep the largest distance under all three.
SKY_BLUE = "#56B4E9"
ORANGE = "#E69F00"
BLUE = "#0072B2"
VERMILION = "#D55E00"
WHITE = "#FFFFFF"
INK = "#202020"

# Sides of a new figure, in inches: lettering in points then has one size against the picture.
_LONGER, _SHORTER, _LONGEST = 10.0, 4.0, 40.0
_LEAST_DPI = 100.0
# Lettering on axes with a diagonal of so many points, and its bounds, in points.
_DIAGONAL, _LETTERS, _LEAST_LETTERS = 700.0, 9.0, 5.5


def check_photo(image: Picture | NDArray[Any]) -> NDArray[Any]:
    """
    Take a photo of any usual form.

    Parameters
    ----------
    image : path, PIL image or ndarray
        A file or PIL image, which is turned upright, or an array as it is: (H, W), (H, W, 3) or
        (H, W, 4), uint8 or float from 0 to 1.

    Returns
    -------
    ndarray
        Grey, RGB or RGBA.

    Raises
    ------
    TypeError
        If it is no picture.
    ValueError
        If it is of another shape, dtype or range.
    OSError
        If a file is missing or no picture.
    """
    if not isinstance(image, np.ndarray):
        return upright_rgb(image)
    law = "`image` must be (H, W), (H, W, 3) or (H, W, 4), uint8 or float from 0 to 1"
    array = cast("NDArray[Any]", image)
    if np.ma.is_masked(array):
        msg = f"{law}, with no masked entry; got a masked array. Fill it first: image.filled(0)."
        raise ValueError(msg)
    if not (2 <= array.ndim <= 3 and array.shape[2:] in {(), (3,), (4,)} and array.size):
        msg = f"{law}; got shape {array.shape}."
        raise ValueError(msg)
    if array.dtype == np.uint8:
        return array
    if array.dtype.kind != "f":
        msg = f"{law}; got {array_summary(array)}. Scale it first."
        raise ValueError(msg)
    low, high = float(array.min()), float(array.max())
    if not (low >= 0 and high <= 1):
        msg = f"{law}; got values from {low:.4g} to {high:.4g}. Scale it first."
        raise ValueError(msg)
    return array


def photo_size(photo: NDArray[Any]) -> ImageSize:
    """Return (width, height) of what `check_photo` returned."""
    return (photo.shape[1], photo.shape[0])


def picture_axes(
    photo: NDArray[Any] | None, image_size: ImageSize, ax: object, *, zoom: float = 1.0
) -> Any:
    """
    Make or take axes and show the photo, where there is one.

    Its pixel (x, y) is centred at (x, y), so that a box's edges lie half a pixel lower.

    Parameters
    ----------
    photo : ndarray or None
        What `check_photo` returned.
    image_size : (width, height)
        The size that it must have, in pixels.
    ax : matplotlib Axes or None
        Axes given.
    zoom : float
        Enlarges a new figure, while letters keep their size in points.

    Returns
    -------
    matplotlib Axes
        Axes in pixels of the photo.

    Raises
    ------
    TypeError
        If `ax` is something else.
    ValueError
        If the photo is of another size.
    """
    width, height = image_size
    if photo is not None and photo_size(photo) != image_size:
        seen = photo_size(photo)
        msg = (
            f"`image` must have the size of the fitted image, {width} x {height}; got {seen[0]} x "
            f"{seen[1]}. Resize it, or fit boxes of this one."
        )
        raise ValueError(msg)
    axes = _new_axes(width, height, zoom) if ax is None else check_axes(ax)
    if photo is not None:
        ceiling = 255 if photo.dtype == np.uint8 else 1
        axes.imshow(photo, cmap="gray", vmin=0, vmax=ceiling, aspect="equal")
        axes.set_axis_off()
    elif not axes.has_data():
        axes.set(xticks=[], yticks=[], aspect="equal", facecolor="#D0D0D0")
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
    return axes


def _new_axes(width: int, height: int, zoom: float) -> Any:
    """Make a figure that a photo fills and that keeps its pixels, without pyplot's state."""
    figure = require("matplotlib.figure", extra="plot", purpose=PURPOSE)
    longer, shorter = max(width, height), min(width, height)
    inches = zoom * min(max(_LONGER, _SHORTER * longer / shorter), _LONGEST)
    dpi = max(_LEAST_DPI, longer / inches)
    # Renderers cut to whole pixels: a hair more keeps the last one.
    sides = [(round(side * dpi * inches / longer) + 0.01) / dpi for side in (width, height)]
    return figure.Figure(figsize=sides, dpi=dpi).add_axes((0, 0, 1, 1))


def check_axes(ax: object) -> Any:
    """Return axes; raise for anything else, such as the array that `subplots` gives."""
    axes = require("matplotlib.axes", extra="plot", purpose=PURPOSE)
    return check_type("ax", ax, axes.Axes, " Of `subplots`, pass one.")


def cell_centres(
    shape: tuple[int, int], image_size: ImageSize, step: int = 1
) -> tuple[FloatArray, FloatArray]:
    """
    Find where the values of a map lie in the picture.

    Parameters
    ----------
    shape : (rows, columns)
        Those of the map.
    image_size : (width, height)
        Size of the picture, whatever that of the map is.
    step : int
        Take every so many rows and columns.

    Returns
    -------
    x, y : ndarray of float64
        Columns and rows in pixels, in which the first pixel is centred at 0.5.
    """
    x, y = (
        (np.arange(cells, dtype=np.float64)[::step] + 0.5) * (length / cells)
        for cells, length in zip(shape[::-1], image_size, strict=True)
    )
    return x, y


def add_legend(axes: Any, handles: Sequence[Any], *, title: str = "", **where: Any) -> Any:
    """
    Say what is what, on a dark plate like all lettering.

    Parameters
    ----------
    axes : matplotlib Axes
        Where to draw; a legend already there is replaced.
    handles : sequence of matplotlib artists
        What is explained, with their labels.
    title : str
        A line above.
    **where : Any
        Further keywords of ``Axes.legend``.

    Returns
    -------
    matplotlib Legend
        The legend, over all else.
    """
    letters = letter_size(axes)
    legend = axes.legend(
        handles=handles, title=title, fontsize=letters, title_fontsize=letters, facecolor=INK,
        edgecolor=WHITE, labelcolor=WHITE, framealpha=0.85, fancybox=False, **where,
    )  # fmt: skip
    legend.get_title().set_color(WHITE)
    legend.set_zorder(5)
    return legend


def letter_size(axes: Any) -> float:
    """Size of lettering that suits the axes as they stand, in points."""
    width, height = points_of(axes)
    return max(_LEAST_LETTERS, min(_LETTERS, _LETTERS * float(np.hypot(width, height)) / _DIAGONAL))


def points_of(axes: Any) -> tuple[float, float]:
    """Width and height of axes on paper, in points, after their aspect is applied."""
    axes.apply_aspect()
    extent = axes.get_window_extent()
    scale = 72 / axes.figure.dpi
    return (float(extent.width * scale), float(extent.height * scale))


def ruler(figure: Any) -> Any:
    """Make a renderer that measures letters; the figure's own may hold a picture of many pixels."""
    agg = require("matplotlib.backends.backend_agg", extra="plot", purpose=PURPOSE)
    return agg.RendererAgg(1, 1, figure.dpi)


def stroke(width: float, colour: str = INK) -> list[Any]:
    """
    Edge a line or text all along, so that it is seen on light and on dark.

    Parameters
    ----------
    width : float
        Width of line and edge together, in points.
    colour : str
        Colour of the edge.

    Returns
    -------
    list
        For the ``path_effects`` of an artist. The edge is solid also where the line is dashed.
    """
    effects = require("matplotlib.patheffects", extra="plot", purpose=PURPOSE)
    solid = {"dash_offset": 0, "dash_list": None}
    edge = effects.Stroke(linewidth=width, foreground=colour, dashes=solid)
    return [edge, effects.Normal()]


def lettering(axes: Any, colour: str) -> dict[str, Any]:
    """
    White letters on a dark plate, legible on any photo: keywords for ``Axes.text``.

    Parameters
    ----------
    axes : matplotlib Axes
        Where it is written: it sets the size.
    colour : str
        Colour of the plate's edge.

    Returns
    -------
    dict
        Colour, size, plate; "$" is no formula.
    """
    plate = {"facecolor": INK, "edgecolor": colour, "alpha": 0.85, "pad": 2.0, "linewidth": 1.0}
    return {
        "color": WHITE,
        "fontsize": letter_size(axes),
        "linespacing": 1.2,
        "parse_math": False,
        "bbox": plate,
    }


def legible(texts: Sequence[str]) -> tuple[list[str], list[str]]:
    """
    Find the fonts for texts in any script.

    Parameters
    ----------
    texts : sequence of str
        What is to be written.

    Returns
    -------
    families : list of str
        Font families that hold the letters, for an artist's ``fontfamily``.
    texts : list of str
        The texts, on one line each; letters that no installed font holds are spelt as code points.
    """
    rc: Any = require("matplotlib", extra="plot", purpose=PURPOSE).rcParams
    families = list(rc["font.family"])
    lines = [" ".join(text.split()) for text in texts]
    missing = set("".join(lines)) - _letters_of(families)
    for family, letters in _installed() if missing else ():
        if letters & missing:
            families.append(family)
            missing -= letters
        if not missing:
            break
    spelt = str.maketrans({c: c.encode("unicode_escape").decode() for c in missing})
    return families, [line.translate(spelt) for line in lines]


def _letters_of(families: Sequence[str]) -> set[str]:
    """Letters that families hold among them."""
    manager = require("matplotlib.font_manager", extra="plot", purpose=PURPOSE)
    asked = [manager.FontProperties(family=[family]) for family in families]
    fonts = [manager.get_font(manager.findfont(family)) for family in asked]
    return {letter for font in fonts for letter in _letters(font)}


def _installed() -> Iterator[tuple[str, set[str]]]:
    """Go through the plain installed fonts: family and letters; fonts of pictures are left out."""
    manager = require("matplotlib.font_manager", extra="plot", purpose=PURPOSE)
    for entry in sorted(manager.fontManager.ttflist, key=lambda entry: str(entry.name)):
        if entry.style == "normal" and entry.weight in {400, "normal", "regular"}:
            font = manager.get_font(entry.fname)
            if font.scalable and "LastResort" not in font.postscript_name:
                yield entry.name, _letters(font)


def _letters(font: Any) -> set[str]:
    return {chr(code) for code in font.get_charmap()}
