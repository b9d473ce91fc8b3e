"""Rows of the table: depths in boxes, and a depth map in metres per pixel, by `box_depths.py`."""

from __future__ import annotations

from collections.abc import Iterable

import box_depths
from speed_rounds import Row, Timing

_LEAST_RATIOS = {"np.nanmedian": 6.0, "np.copyto": 1 / 1.3}
_GAPS = (0.0, 0.1)


def box_rows(rounds: int, *, quick: bool) -> list[Row]:
    """Compare 30 boxes, with and without gaps in the map."""
    return [
        row
        for shape in box_depths.SHAPES[: 1 if quick else None]
        for missing in _GAPS
        for row in _rows(box_depths._box_pairs(shape, missing, rounds))
    ]


def map_rows(rounds: int, *, quick: bool) -> list[Row]:
    """Compare the scale map with a copy of the map."""
    shapes = box_depths.SHAPES[: 1 if quick else None]
    return [row for shape in shapes for row in _rows(box_depths._map_pairs(shape, rounds))]


def _rows(pairs: Iterable[box_depths._Pair]) -> list[Row]:
    return [
        Row(
            pair.what,
            pair.size,
            Timing(tuple(pair.seconds[0]), peak=pair.peaks[0]),
            pair.peer,
            Timing(tuple(pair.seconds[1]), peak=pair.peaks[1]),
            _LEAST_RATIOS.get(pair.peer),
        )
        for pair in pairs
    ]
