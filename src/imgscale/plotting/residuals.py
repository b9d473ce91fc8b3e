"""How far each reference agrees with the scale, and how much it weighs."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from imgscale._checks import check_type
from imgscale._optional import require
from imgscale.estimate import central_scores, log_interval, percent
from imgscale.laws import LAWS
from imgscale.model import ScaleModel
from imgscale.plotting._canvas import (
    BLUE,
    INK,
    PURPOSE,
    VERMILION,
    check_axes,
    legible,
    points_of,
)
from imgscale.plotting._wording import shortened
from imgscale.prior_choice import rows_along
from imgscale.reference import OUTLIER, Reference, numbered_labels
from imgscale.standing import height_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_residuals"]

_GREY = "#6E6E6E"
# Of a new figure, in inches.
_WIDTH, _ROW, _FRAME = 9.0, 0.3, 1.5
# Letters of the words at the right and of a name at most, their sizes in points, and the width of
# one to its size. So many letters fit across axes of usual width.
_ROOM, _NAME, _LETTERS, _ASPECT = 41, 24, (4.0, 9.0), 0.52
_ACROSS = 43
# Area of a marker that carries all, and of one that carries nothing, in square points.
_LARGEST, _LEAST = 260.0, 14.0
# Changes of k that the axis names, in per cent.
_TICKS = (
    -95, -90, -80, -70, -60, -50, -40, -30, -20, -15, -10, -5, -2, -1, -0.5, 0,
    0.5, 1, 2, 5, 10, 15, 20, 30, 40, 50, 70, 100, 150, 200, 300, 500, 900, 1900, 4900,
)  # fmt: skip
_MOST_TICKS, _TICK_LETTERS = 9, 7


class _Row(NamedTuple):
    """One line of the picture: the k of one witness over the model's."""

    name: str
    log_ratio: float
    log_std: float
    weight: float
    words: str
    colour: str
    used: bool


class _Layout(NamedTuple):
    """Where words go and how large they are."""

    letters: float  # in points
    per_line: int  # letters across the axes
    words: float  # share of the axes at the right
    low: float  # log ratios that are shown
    high: float

    @property
    def most_ticks(self) -> int:
        """How many ticks are told apart."""
        fitting = (1 - self.words) * self.per_line / _TICK_LETTERS
        return max(2, min(_MOST_TICKS, int(fitting)))


def draw_residuals(model: ScaleModel, *, level: float = 0.9, ax: Axes | None = None) -> Axes:
    """
    Draw what each reference says of the scale beside what all say together.

    Each row is the k that one reference gives by itself, in per cent of the model's, with the
    interval that its prior, its box and its depth leave; the band is the model's k. A reference at
    +10 % is, by the model, smaller than its prior by as much. Filled marks carried the fit, by the
    share that their area shows, diamonds are what was told of the camera; crosses are rejected
    outliers; hollow marks took no part, and the words at the right say why. What has no k (no
    prior, no depth) is listed below.

    Parameters
    ----------
    model : ScaleModel
        The scale of the image.
    level : float
        Probability of the intervals and the band, above 0 and below 1.
    ax : matplotlib Axes, optional
        Where to draw; a new figure as high as the rows need where omitted.

    Returns
    -------
    matplotlib Axes
        The axes; save with ``ax.figure.savefig(path)``.

    Raises
    ------
    ValueError
        If the level is no probability.
    TypeError
        If `model` is no model.
    MissingDependencyError
        If matplotlib is not installed.

    Notes
    -----
    ``log(k_i / k)`` with the variance ``(s / H)^2 + (t / H)^2 + v + u``: the spread s between
    individuals and the error t of the mean H of the kind that the reference was taken for, the told
    variance v of box and depth, and the noise u of the depths where the fit learned it. The z-score
    is that of the model, against all *other* references. Where a shift or a horizon is fitted too,
    own k are those at its best value, and the band, which holds its error, may be wider than bars.

    Examples
    --------
    >>> import imgscale as ims
    >>> from imgscale.plotting import draw_residuals
    >>> street = [ims.Detection("person", (310, 344, 388, 576)),
    ...           ims.Detection("person", (840, 352, 880, 480)),
    ...           ims.Detection("car", (520, 369, 700, 507))]
    >>> model = ims.fit(street, ims.GroundPlane(image_size=(1280, 720)))
    >>> ax = draw_residuals(model)  # doctest: +SKIP
    """
    check_type("model", model, ScaleModel)
    _, score = central_scores(level)
    rows = _rows(model)
    notes = _notes(model)
    count = len(rows) + len(notes)
    axes = _new_axes(count) if ax is None else check_axes(ax)
    layout = _layout(axes, count, _range(model, rows, score))
    _draw_band(axes, model, level, layout, len(rows))
    for place, row in enumerate(rows):
        _draw_row(axes, place, row, score, layout)
    _draw_notes(axes, len(rows), notes, layout)
    _set_scales(axes, rows, len(notes), layout)
    _write_headings(axes, model, level, layout)
    return cast("Axes", axes)


def _rows(model: ScaleModel) -> list[_Row]:
    """Collect everything that has a k, the largest first."""
    names = numbered_labels([ref.label for ref in model.references])
    rows = [
        _of_reference(model, name, ref)
        for name, ref in zip(names, model.references, strict=True)
        if math.isfinite(ref.k)
    ]
    return sorted([*rows, *_told(model)], key=lambda row: -row.log_ratio)


def _of_reference(model: ScaleModel, name: str, ref: Reference) -> _Row:
    mean_m, std_m, mean_std_m = _taken_for(model, ref)
    learned = model.depth_rel or 0.0
    return _Row(
        name=name,
        log_ratio=math.log(ref.k / model.k * mean_m / ref.prior_m),
        log_std=math.hypot(std_m / mean_m, mean_std_m / mean_m, ref.noise_rel, learned),
        weight=ref.weight,
        words=_words(ref),
        colour=BLUE if ref.used else VERMILION if ref.reason == OUTLIER else _GREY,
        used=ref.used,
    )


def _taken_for(model: ScaleModel, ref: Reference) -> tuple[float, float, float]:
    """Size of the kind of thing that a reference was taken for, in metres."""
    if ref.taken_as:
        for row in rows_along(ref.prior_label, ref.axis, model.priors):
            if (row.spans, row.mean_m) == (ref.taken_as, ref.taken_as_m):
                return row.mean_m, row.std_m, row.mean_std_m
    return ref.prior_m, ref.prior_std_m, ref.prior_mean_std_m


def _words(ref: Reference) -> str:
    """Say how much a reference weighs, how far it is from the others, or why it took no part."""
    score = "" if math.isnan(ref.z_score) else f", z {ref.z_score:+.1f}"
    if ref.used:
        kind = f"; {ref.taken_as.split(':')[0]}" if ref.taken_as else ""
        text = f"weight {100 * ref.weight:.0f} %{score}{kind}"
        return textwrap.shorten(text, _ROOM, placeholder=" ...")
    if ref.reason == OUTLIER:
        wrong = 100 * (1 - ref.taken_as_probability)
        sure = "over 99 %" if wrong > 99.5 else f"{wrong:.0f} %"
        return f"outlier: wrong with {sure}{score}"
    return f"not used: {ref.reason}"


def _told(model: ScaleModel) -> list[_Row]:
    """Make a row of what was told of k itself: the focal length, or the camera's height."""
    camera, ground = model.camera, model.ground
    if camera and model.camera_is_witness:
        error = math.hypot(camera.focal_rel_std, model.scale_rel_std)
        weight = max(0.0, 1 - sum(ref.weight for ref in model.references))
        words = f"weight {100 * weight:.0f} %" if model.shared is None else "given"
        ratio = 1 / (camera.focal_px * model.k)
        return [_Row("focal length", math.log(ratio), error, weight, words, _GREY, used=True)]
    if model.kind == "ground_plane" and ground and ground.camera_height_m:
        log_height, variance = height_of(ground)
        log_ratio = log_height - math.log(model.k)
        return [
            _Row("camera height", log_ratio, math.sqrt(variance), 0.0, "given", _GREY, used=True)
        ]
    return []


def _notes(model: ScaleModel) -> list[str]:
    """List what has no k, by the reason why, in lines."""
    names = numbered_labels([ref.label for ref in model.references])
    found: dict[str, list[str]] = {}
    for name, ref in zip(names, model.references, strict=True):
        if not math.isfinite(ref.k):
            found.setdefault(ref.reason or "no finite distance", []).append(name)
    lines: list[str] = []
    for reason, of_reason in sorted(found.items()):
        text = f"{reason}: {', '.join(of_reason)}"
        lines += textwrap.wrap(text, 96, subsequent_indent="    ")
    return lines


def _new_axes(count: int) -> Any:
    figure = require("matplotlib.figure", extra="plot", purpose=PURPOSE)
    height = _FRAME + _ROW * max(count, 3)
    axes = figure.Figure(figsize=(_WIDTH, height), dpi=100).add_axes(
        (0.17, 0.85 / height, 0.81, 1 - 1.25 / height)
    )
    axes.figure.set_facecolor("white")
    return axes


def _layout(axes: Any, count: int, span: tuple[float, float]) -> _Layout:
    """Choose letters that fit into a row and leave room for the words."""
    width, height = points_of(axes)
    fitting = min(0.72 * height / max(count, 1), width / _ACROSS)
    letters = min(max(fitting, _LETTERS[0]), _LETTERS[1])
    per_line = max(1, int(width / (_ASPECT * letters)))
    return _Layout(letters, per_line, min((_ROOM + 2) / per_line, 0.6), *span)


def _range(model: ScaleModel, rows: Sequence[_Row], score: float) -> tuple[float, float]:
    """Log ratios that the axis shows: all marks, with intervals unless they are very wide."""
    reaches = [(row.log_ratio, score * min(row.log_std, 1.0)) for row in rows]
    reaches.append((0.0, max(score * min(model.k_std / model.k, 1.0), 0.01)))
    low = min(mark - reach for mark, reach in reaches)
    high = max(mark + reach for mark, reach in reaches)
    return (low - 0.04 * (high - low), high + 0.04 * (high - low))


def _draw_band(axes: Any, model: ScaleModel, level: float, layout: _Layout, count: int) -> None:
    """Shade the model's own k beside the rows."""
    ends = [math.log(end / model.k) for end in log_interval(model.k, model.k_std, level)]
    low, high = max(ends[0], layout.low), min(ends[1], layout.high)
    axes.fill_betweenx([-0.6, count - 0.5], low, high, color="#CFE3F1", linewidth=0, zorder=0)
    axes.plot([0.0, 0.0], [-0.6, count - 0.5], color=BLUE, linewidth=1, zorder=0.5)


def _draw_row(axes: Any, place: int, row: _Row, score: float, layout: _Layout) -> None:
    """Draw one witness with its interval and its words."""
    ends = [row.log_ratio - score * row.log_std, row.log_ratio + score * row.log_std]
    axes.plot(
        [max(ends[0], layout.low), min(ends[1], layout.high)], [place, place], color=row.colour,
        linewidth=1.4, solid_capstyle="butt", zorder=2,
    )  # fmt: skip
    area = (_LEAST + (_LARGEST - _LEAST) * row.weight) * (layout.letters / _LETTERS[1]) ** 2
    if row.colour == VERMILION:
        axes.scatter(row.log_ratio, place, s=3 * _LEAST, marker="X", color=row.colour, zorder=3)
    else:
        axes.scatter(
            row.log_ratio, place, s=area if row.used else 2 * _LEAST, edgecolors=row.colour,
            marker="D" if row.used and row.colour == _GREY else "o" if row.used else "s",
            facecolors=row.colour if row.used else "white", linewidths=1.2, zorder=3,
        )  # fmt: skip
    axes.text(
        1 - layout.words + 0.02, place, row.words, transform=axes.get_yaxis_transform(),
        va="center", ha="left", fontsize=layout.letters, parse_math=False, clip_on=True,
        color=INK if row.used else row.colour,
    )  # fmt: skip


def _draw_notes(axes: Any, first: int, notes: Sequence[str], layout: _Layout) -> None:
    """List below the rows what has none."""
    families, _ = legible(notes)
    for place, note in enumerate(notes, first):
        axes.text(
            0.01, place, note, transform=axes.get_yaxis_transform(), va="center", ha="left",
            fontsize=layout.letters, fontfamily=families, color=_GREY, parse_math=False,
        )  # fmt: skip
    if notes and first:
        axes.axhline(first - 0.5, color="#BBBBBB", linewidth=0.8)


def _set_scales(axes: Any, rows: Sequence[_Row], n_notes: int, layout: _Layout) -> None:
    """Name the rows and write the axis in per cent of k."""
    low, high, letters = layout.low, layout.high, layout.letters
    axes.set_xlim(low, low + (high - low) / (1 - layout.words))
    axes.set_ylim(len(rows) + n_notes - 0.4, -0.6)
    families, names = legible([shortened(row.name, _NAME) for row in rows])
    axes.set_yticks(
        range(len(rows)), names, fontsize=letters, fontfamily=families, parse_math=False
    )
    ticks = _ticks(low, high, layout.most_ticks)
    axes.set_xticks(
        [math.log1p(tick / 100) for tick in ticks],
        [f"{tick:+g} %" if tick else "0 %" for tick in ticks],
        fontsize=letters,
    )
    axes.spines["bottom"].set_bounds(low, high)
    axes.tick_params(axis="y", length=0)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)


def _write_headings(axes: Any, model: ScaleModel, level: float, layout: _Layout) -> None:
    """Say what the axis is, and k; who sets another title replaces it."""
    law = LAWS[model.kind]
    label = f"own k ({law.k_meaning}) against the model's; bars and band: {percent(level)}"
    title = str(model).split(" from ")[0].rstrip(",")
    label, title = (textwrap.fill(text, layout.per_line) for text in (label, title))
    axes.set_xlabel(label, fontsize=layout.letters, loc="left")
    axes.set_title(title, fontsize=layout.letters, parse_math=False)


def _ticks(low: float, high: float, most: int) -> list[float]:
    """Choose changes in per cent that are told apart, 0 among them."""
    inside = [tick for tick in _TICKS if low < math.log1p(tick / 100) < high]
    least = (high - low) / most
    kept = [0.0]
    for tick in sorted(inside, key=abs):
        place = math.log1p(tick / 100)
        if all(abs(place - math.log1p(other / 100)) >= least for other in kept):
            kept.append(tick)
    return sorted(kept)
