"""What the labels of objects say, in full and in short."""

from __future__ import annotations

import math
from collections.abc import Sequence
from textwrap import wrap

import attrs

from imgscale._format import PER_METRE, digits_for
from imgscale.detection import Detection
from imgscale.estimate import SizeEstimate, percent
from imgscale.flags import Flag, flag_words
from imgscale.model import ScaleModel
from imgscale.observations import NO_PRIOR, PARTIAL
from imgscale.reference import OUTLIER, numbered_labels

# What a label says beside a size; whether it was a reference the box tells, the rest is the
# model's. A reason that says the same is said once.
_NOTED = (
    Flag.PARTIAL
    | Flag.MIXED_DEPTH
    | Flag.MEAN_DEPTH
    | Flag.EXTRAPOLATED
    | Flag.BEYOND_HORIZON
    | Flag.PRIOR_USED
)
_SAID_BY = {PARTIAL: Flag.PARTIAL}
_AXIS_WORDS = {"height": "high", "width": "wide", "diameter": "across"}
# Letters in a line of a label, and in its name.
_LINE, _NAME = 30, 56


@attrs.frozen
class Ruling:
    """
    How sizes are written.

    Attributes
    ----------
    unit : str
        A key of `PER_METRE`.
    level : float
        Probability of the intervals.
    tell_axis : bool
        True where the axis is said of every size, since there are several.
    """

    unit: str
    level: float
    tell_axis: bool


def object_names(detections: Sequence[Detection], model: ScaleModel | None) -> list[str]:
    """
    Give objects of one label numbers, as the model's text does where they are its own.

    Parameters
    ----------
    detections : sequence of Detection
        The objects.
    model : ScaleModel or None
        The scale of the image.

    Returns
    -------
    list of str
        A name for each.
    """
    if model is not None:
        own = numbered_labels([ref.label for ref in model.references])
        keys = [(ref.label, ref.xyxy) for ref in model.references]
        names = dict(zip(keys, own, strict=True))
        if len(names) == len(keys) and all((d.label, d.xyxy) in names for d in detections):
            return [names[d.label, d.xyxy] for d in detections]
    return numbered_labels([detection.label for detection in detections])


def rejections(
    detections: Sequence[Detection], estimates: Sequence[SizeEstimate], model: ScaleModel | None
) -> list[str]:
    """
    Say of each object of known size why it did not carry the fit.

    Parameters
    ----------
    detections : sequence of Detection
        The objects.
    estimates : sequence of SizeEstimate
        Their sizes, which know of outliers alone.
    model : ScaleModel or None
        The scale of the image, which knows of all.

    Returns
    -------
    list of str
        `Reference.reason`; empty where it did, or has no known size.
    """
    references = () if model is None else model.references
    given = {(ref.label, ref.xyxy): ref.reason for ref in references if ref.reason != NO_PRIOR}
    return [
        given.get((detection.label, detection.xyxy), "")
        or (OUTLIER if Flag.OUTLIERS in estimate.flags else "")
        for detection, estimate in zip(detections, estimates, strict=True)
    ]


def label_texts(name: str, estimate: SizeEstimate, reason: str, ruling: Ruling) -> tuple[str, str]:
    """
    Write a label.

    Parameters
    ----------
    name : str
        The object's name.
    estimate : SizeEstimate
        Its size.
    reason : str
        Why it did not carry the fit, where it might have.
    ruling : Ruling
        How sizes are written.

    Returns
    -------
    full, short : str
        Lines with name, size, interval, and reservations in the words of `flag_words`; and one line
        with name and size.
    """
    if math.isnan(estimate.size_m):
        size = line = _why_none(estimate)
        notes: list[str] = []
    else:
        axis = f" {_AXIS_WORDS[estimate.axis]}" if ruling.tell_axis else ""
        size = f"{_number(estimate.size_m, estimate, ruling.unit)} {ruling.unit}{axis}"
        line = size + _interval(estimate, ruling)
        notes = flag_words(estimate.flags & _NOTED & ~_SAID_BY.get(reason, Flag(0)))
    short = f"{shortened(name, _LINE // 2)} {size}"
    if reason and reason != size:
        notes.insert(0, f"not used: {reason}")
        short += f", {reason}"
    return "\n".join([*wrap(shortened(name, _NAME), _LINE), line, *notes]), short


def legend_title(estimates: Sequence[SizeEstimate], level: float) -> str:
    """
    Say what the numbers are.

    Parameters
    ----------
    estimates : sequence of SizeEstimate
        The sizes.
    level : float
        Probability of the intervals.

    Returns
    -------
    str
        For example "height (90 % interval)"; empty where there are no numbers.
    """
    if all(math.isnan(estimate.size_m) for estimate in estimates):
        return ""
    axes = {estimate.axis for estimate in estimates}
    return f"{axes.pop() if len(axes) == 1 else 'size'} ({percent(level)} interval)"


def shortened(name: str, most: int) -> str:
    """Cut a name in the middle; its end may be a number that tells it from others."""
    return name if len(name) <= most else f"{name[: most - 6]}…{name[-5:]}"


def _why_none(estimate: SizeEstimate) -> str:
    """Say why there is no size."""
    if Flag.BEYOND_HORIZON in estimate.flags:
        return flag_words(Flag.BEYOND_HORIZON)[0]
    lacks_depth = Flag.NO_DEPTH in estimate.flags or math.isnan(estimate.depth)
    return flag_words(Flag.NO_DEPTH)[0] if lacks_depth else "unknown"


def _interval(estimate: SizeEstimate, ruling: Ruling) -> str:
    """Write the interval in brackets; nothing where there is none."""
    low, high = estimate.interval(ruling.level)
    if math.isnan(low) or math.isnan(high) or low == high:
        return ""
    start = _number(low, estimate, ruling.unit)
    if math.isinf(high):
        return f" (above {start})"
    return f" ({start} to {_number(high, estimate, ruling.unit)})"


def _number(metres: float, estimate: SizeEstimate, unit: str) -> str:
    """Write a length to the digits that the error of the size justifies."""
    value, std = (PER_METRE[unit] * number for number in (metres, estimate.std_m))
    if not (math.isfinite(std) and std > 0):
        return f"{value:.2g}" if math.isinf(std) else f"{value:.4g}"
    text = f"{value:.{digits_for(std)}f}"
    return text if float(text) or not value else f"{value:.1g}"
