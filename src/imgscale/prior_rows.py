"""Priors as rows of a CSV table, and back."""

from __future__ import annotations

import math
import re
from typing import Any

from imgscale._reading import cut, number_of, quoted
from imgscale._tables import Table, as_cell, of_cell
from imgscale._typing import Region, SizeAxis
from imgscale.errors import FileError
from imgscale.object_prior import ObjectPrior, normal_label

__all__ = ["COLUMNS", "read_rows", "write_row"]

COLUMNS = (
    "label", "aliases", "axis", "mean_m", "std_m", "mean_std_m", "on_ground", "depth_extent_m",
    "share", "region", "source", "year", "n", "spans",
)  # fmt: skip
_NUMBERS: dict[str, type[float | int]] = {
    "mean_m": float, "std_m": float, "mean_std_m": float, "depth_extent_m": float, "share": float,
    "year": int, "n": int,
}  # fmt: skip


_SHOWN = 100  # bad rows that a message names
_WHOLE = re.compile(r"[+-]?\d{1,18}", re.ASCII)


def read_rows(table: Table, region: Region) -> list[ObjectPrior]:
    """
    Read the rows that hold in a region.

    Parameters
    ----------
    table : Table
        The table.
    region : str
        Where rows of this region exist for a label and axis, they replace the world's.

    Returns
    -------
    list of ObjectPrior
        The rows.

    Raises
    ------
    FileError
        If a column is missing or unknown, or a row breaks a law; up to 100 bad rows are named.
    """
    columns = set(table.columns)
    wrong = [
        f"{word} {', '.join(sorted(found))}"
        for word, found in (
            ("no", {"label", "mean_m", "std_m"} - columns),
            ("unknown", columns - set(COLUMNS)),
        )
        if found
    ]
    if wrong:
        msg = f"{table.name} must have the columns of a prior table; got {'; '.join(wrong)}."
        raise FileError(cut(msg))
    rows: list[ObjectPrior] = []
    problems: list[str] = []
    for line, record in table.records:
        try:
            rows.append(_parse_row(record))
        except (ValueError, TypeError) as error:
            problems.append(cut(f"line {line}: {error}"))
    if problems:
        more = len(problems) - _SHOWN
        listed = " | ".join([*problems[:_SHOWN], *([f"and {more} more"] if more > 0 else [])])
        msg = f"{table.name} must hold lawful rows; got {len(problems)} bad: {listed}"
        raise FileError(msg)
    return _rows_of_region(rows, region, table.name)


def _rows_of_region(rows: list[ObjectPrior], region: Region, name: str) -> list[ObjectPrior]:
    """Keep a region's own rows and, where it has none, the world's."""

    def key(row: ObjectPrior) -> tuple[str, SizeAxis]:
        return normal_label(row.label), row.axis

    regions: dict[tuple[str, SizeAxis], set[str]] = {}
    for row in rows:
        regions.setdefault(key(row), set()).add(row.region)
    lost = sorted(label for (label, _), found in regions.items() if not found & {"world", region})
    if lost:
        msg = (
            f'{name} must have a row for region "world" or "{region}" of every label; '
            f"got none for {', '.join(lost)}. Read the file with its region."
        )
        raise FileError(cut(msg))
    return [
        row for row in rows if row.region == (region if region in regions[key(row)] else "world")
    ]


def _parse_number(column: str, number: type[float | int], cell: str) -> float:
    if math.isnan(number_of(cell)) or (number is int and not _WHOLE.fullmatch(cell)):
        law = "a whole number" if number is int else "a number"
        msg = f"`{column}` must be {law}; got {quoted(cell)}."
        raise ValueError(msg)
    return number(cell)


def _parse_row(record: dict[str, Any]) -> ObjectPrior:
    """Turn the cells of one line into a prior; empty cells take the defaults."""
    if record.get("") is not None or None in record.values():
        msg = "a row must have as many cells as the header."
        raise ValueError(msg)
    stripped = ((column, cell.strip()) for column, cell in record.items())
    cells: dict[str, Any] = {column: of_cell(cell) for column, cell in stripped if cell}
    for column, number in _NUMBERS.items():
        if column in cells:
            cells[column] = _parse_number(column, number, cells[column])
    if "aliases" in cells:
        cells["aliases"] = [part.strip() for part in cells["aliases"].split(";") if part.strip()]
    if "on_ground" in cells:
        words = {"true": True, "false": False}
        if cells["on_ground"].lower() not in words:
            msg = f"`on_ground` must be true or false; got {quoted(cells['on_ground'])}."
            raise ValueError(msg)
        cells["on_ground"] = words[cells["on_ground"].lower()]
    missing = sorted({"label", "mean_m", "std_m"} - cells.keys())
    if missing:
        msg = f"a row must give {', '.join(missing)}."
        raise ValueError(msg)
    return ObjectPrior(**cells)


def write_row(prior: ObjectPrior) -> list[str]:
    """
    Write a prior as cells.

    Parameters
    ----------
    prior : ObjectPrior
        The prior.

    Returns
    -------
    list of str
        One cell for each of `COLUMNS`; empty where there is no value.
    """
    return [_cell(prior, column) for column in COLUMNS]


def _cell(prior: ObjectPrior, column: str) -> str:
    value = getattr(prior, column)
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if column in _NUMBERS:
        return str(value)
    return as_cell("; ".join(prior.aliases) if column == "aliases" else str(value))
