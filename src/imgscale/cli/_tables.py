"""Results as text, for a terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence

from imgscale._format import PER_METRE, digits_for, text_table
from imgscale.cli._messages import shown
from imgscale.cli._outputs import Style
from imgscale.estimate import SizeEstimate
from imgscale.flags import Flag, flag_names
from imgscale.model import ScaleModel
from imgscale.reference import numbered_labels


def noted_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Lay out rows whose last cell is a note, to the left and without a title."""
    top, line, *lines = text_table(header, [row[:-1] for row in rows]).splitlines()
    noted = [f"{text}  {row[-1]}".rstrip() for text, row in zip(lines, rows, strict=True)]
    return "\n".join([top, line, *noted])


def sizes_table(estimates: Sequence[SizeEstimate], style: Style) -> str:
    """Lay out sizes, to the digits that their errors justify."""
    axis = estimates[0].axis
    header = ("object", f"{axis} {style.unit}", f"{100 * style.level:g} % interval", "distance m")
    names = numbered_labels([estimate.label for estimate in estimates])
    rows = [
        (shown(name), *_size(estimate, style), _distance(estimate), _notes(estimate))
        for name, estimate in zip(names, estimates, strict=True)
    ]
    return noted_table(header, rows)


def _size(estimate: SizeEstimate, style: Style) -> tuple[str, str]:
    factor = PER_METRE[style.unit]
    size, std = estimate.size_m * factor, estimate.std_m * factor
    if math.isnan(size):
        return ("unknown", "-")
    form = f".{digits_for(std)}f" if math.isfinite(std) and std > 0 else ".4g"
    low, high = (format(end * factor, form) for end in estimate.interval(style.level))
    return (format(size, form), f"{low} to {high}")


def _distance(estimate: SizeEstimate) -> str:
    distance = estimate.distance_m
    if distance is None or math.isnan(distance):
        return "-"
    return f"{distance:.{2 if distance < 10 else 1 if distance < 100 else 0}f}"


def _notes(estimate: SizeEstimate) -> str:
    return " ".join(flag_names(estimate.flags))


def scale_text(model: ScaleModel) -> str:
    """Tell what a scale rests on, and what is to be said against it."""
    lines = [shown(str(model))]
    if model.camera is not None:
        percent = 100 * model.camera.focal_rel_std
        lines.append(f"focal length {model.camera.focal_px:.0f} px within {percent:.3g} %")
    if model.flags != Flag(0):
        lines.append(f"reservations: {' '.join(flag_names(model.flags))}")
    return "\n".join(lines)
