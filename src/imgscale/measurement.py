"""Everything that came out of one picture, and its rows for tables and files."""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import attrs

from imgscale._checks import check_choice
from imgscale._format import PER_METRE, text_table
from imgscale._html import element, joined
from imgscale._typing import ImageSize
from imgscale.depth import Depth
from imgscale.detection import Detection
from imgscale.estimate import SizeEstimate, central_scores, size_texts, sizes_table
from imgscale.flags import Flag, flag_names
from imgscale.model import MOST_ROWS, ScaleModel, summary_html
from imgscale.reference import numbered_labels

__all__ = ["Measurement"]

Row: TypeAlias = dict[str, Any]


@attrs.frozen(kw_only=True)
class Measurement:
    """
    Everything that came out of one picture.

    Attributes
    ----------
    model : ScaleModel
        Its scale.
    estimates : tuple of SizeEstimate
        One per detection.
    detections : tuple of Detection
        What the detector saw.
    depth : DepthMap, ObjectDepths or GroundPlane
        What the depth source gave.
    image_size : (width, height)
        Size of the upright picture in pixels.
    name : str
        The picture's path; empty where it came as an array.
    """

    model: ScaleModel
    estimates: tuple[SizeEstimate, ...]
    detections: tuple[Detection, ...]
    depth: Depth = attrs.field(eq=False)
    image_size: ImageSize
    name: str = ""

    def table(self, *, unit: str = "m", level: float = 0.9) -> list[Row]:
        """
        List what is known of every object, ready for a data frame or a CSV file.

        Parameters
        ----------
        unit : str
            Unit of the sizes: "m", "cm", "mm", "in" or "ft".
        level : float
            Probability that the interval holds the size, above 0 and below 1.

        Returns
        -------
        list of dict
            One row per detection, in their order. ``label``; ``axis``; ``size_<unit>`` with
            ``low_<unit>`` and ``high_<unit>``; ``distance_m``, the z-depth in metres; ``x1``,
            ``y1``, ``x2``, ``y2`` in pixels; ``score``; ``track_id``; ``flags`` and
            ``model_flags``, reservations about this size and about the scale of all, words with
            spaces between. None where a number is not known, or where an interval has no upper end.

        Raises
        ------
        ValueError
            If the unit is unknown or the level no probability.

        Examples
        --------
        >>> import numpy as np
        >>> import imgscale as ims
        >>> door = ims.Detection("door", (100, 50, 180, 250))
        >>> result = ims.measure(
        ...     np.zeros((480, 640, 3), dtype=np.uint8),
        ...     detector=lambda image: [door, ims.Detection("box", (300, 200, 330, 250))],
        ...     depth_source=lambda image: ims.DepthMap([[4.0]], kind="relative",
        ...                                             image_size=(640, 480)),
        ...     priors=ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.02)]),
        ...     noise=ims.Noise(depth_rel=0.01),
        ... )
        >>> row = result.table(unit="cm")[1]
        >>> row["label"], round(row["size_cm"]), round(row["low_cm"]), round(row["high_cm"])
        ('box', 50, 47, 52)
        """
        check_choice("unit", unit, tuple(PER_METRE))
        central_scores(level)  # without detections nobody else would look at it
        return [
            self._row(estimate, detection, unit, level)
            for estimate, detection in zip(self.estimates, self.detections, strict=True)
        ]

    def _row(self, estimate: SizeEstimate, detection: Detection, unit: str, level: float) -> Row:
        low, high = estimate.interval(level)
        sizes = {"size": estimate.size_m, "low": low, "high": high}
        return {
            "label": estimate.label,
            "axis": estimate.axis,
            **{f"{name}_{unit}": _known(size * PER_METRE[unit]) for name, size in sizes.items()},
            "distance_m": _known(estimate.distance_m),
            **dict(zip(("x1", "y1", "x2", "y2"), detection.xyxy, strict=True)),
            "score": detection.score,
            "track_id": detection.track_id,
            "flags": " ".join(flag_names(estimate.flags)),
            "model_flags": " ".join(flag_names(self.model.flags)),
        }

    def to_dict(self) -> dict[str, Any]:
        """
        Turn the measurement into built-in types that `json` writes.

        Returns
        -------
        dict
            ``name``, ``image_size``, ``model`` (what `ScaleModel.to_dict` gives, with priors,
            options and every reference) and ``objects`` (what `table` gives). Masks and the depth
            map are left out.
        """
        return {
            "name": self.name,
            "image_size": list(self.image_size),
            "model": self.model.to_dict(),
            "objects": self.table(),
        }

    def __str__(self) -> str:
        header = ("object", "size", "90 % interval", "distance m", "")
        rows = [
            (
                row["label"],
                *(text.replace("±", "+-") or "-" for text in size_texts(estimate, "m", 0.9)),
                "-" if row["distance_m"] is None else f"{row['distance_m']:.3g}",
                row["flags"],
            )
            for row, estimate in zip(self.table(), self.estimates, strict=True)
        ]
        words = ", ".join(flag_names(self.model.flags))
        reservations = f"\nreservations, see explain(): {words}" if words else ""
        return f"{self.model}{reservations}\n{text_table(header, rows)}"

    def _repr_html_(self) -> str:
        names = numbered_labels([estimate.label for estimate in self.estimates])
        # what the scale says of others before what it rests on
        order = sorted(range(len(names)), key=lambda row: _is_known(self.estimates[row]))
        sizes = sizes_table(
            [names[row] for row in order], [self.estimates[row] for row in order], most=MOST_ROWS
        )
        heading = [element("p", element("strong", self.name))] if self.name else []
        return joined((*heading, summary_html(self.model), sizes))


def _is_known(estimate: SizeEstimate) -> bool:
    return bool(estimate.flags & (Flag.REFERENCE | Flag.OUTLIERS))


def _known(value: float | None) -> float | None:
    """Files have None for what is not known."""
    return None if value is None or not math.isfinite(value) else value
