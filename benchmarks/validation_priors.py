"""The tables of sizes that the validation runs with."""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeAlias

import imgscale as ims

TableName: TypeAlias = Literal["default", "prototype"]


class Law(NamedTuple):
    """A class's mean height in metres, and two relative spreads: of individuals, of the mean."""

    mean_m: float
    spread: float
    mean_spread: float


# Set on labels of this kind, so that the bounds that goals state say something about the method
# alone; the shipped table comes from other sources and shows what a user gets.
PROTOTYPE = {
    "Car": Law(1.515, 0.085, 0.03),
    "Van": Law(2.2, 0.145, 0.06),
    "Truck": Law(3.2, 0.13, 0.08),
    "Pedestrian": Law(1.75, 0.07, 0.02),
    "Cyclist": Law(1.735, 0.06, 0.02),
    "Tram": Law(3.5, 0.06, 0.04),
}


def prior_table(name: TableName) -> ims.PriorTable:
    """Load the shipped table for Europe, or make the one that the goals are stated for."""
    shipped = ims.PriorTable.default("eu")
    if name == "default":
        return shipped
    return ims.PriorTable(
        [
            ims.ObjectPrior(
                label,
                law.mean_m,
                law.mean_m * law.spread,
                mean_std_m=law.mean_m * law.mean_spread,
                depth_extent_m=_depth_extent(shipped, label),
            )
            for label, law in PROTOTYPE.items()
        ]
    )


def class_mean(priors: ims.PriorTable, label: str) -> float:
    """Mean height of a class, over the kinds of it that the table tells apart."""
    rows = _heights(priors, label)
    return sum(row.share * row.mean_m for row in rows) / sum(row.share for row in rows)


def _depth_extent(shipped: ims.PriorTable, label: str) -> float | None:
    """Take the extent along the view from published dimensions, never from labels."""
    rows = [(row.share, row.depth_extent_m) for row in _heights(shipped, label)]
    known = [(share, extent) for share, extent in rows if extent is not None]
    if not known:
        return None
    return sum(share * extent for share, extent in known) / sum(share for share, _ in known)


def _heights(priors: ims.PriorTable, label: str) -> list[ims.ObjectPrior]:
    return [row for row in priors.lookup(label) if row.axis == "height"]
