"""CSV tables, the package's own and the user's. The parser is loaded when a table is used."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from io import StringIO
from os import PathLike
from typing import Any, NamedTuple

from imgscale._reading import cut, read_text
from imgscale.errors import FileError

# What spreadsheets take for the beginning of a formula; the last four are full-width.
_BEGIN_FORMULA = tuple("=+-@\t\r\n\uff1d\uff0b\uff0d\uff20")


class Table(NamedTuple):
    """
    A parsed table.

    Attributes
    ----------
    name : str
        The file's name, for messages.
    columns : tuple of str
        The header.
    records : list of (int, dict)
        Line number and cells of each row; a row that is too long has the key "".
    """

    name: str
    columns: tuple[str, ...]
    records: list[tuple[int, dict[str, Any]]]


def as_cell(text: str) -> str:
    """Write a text so that no spreadsheet takes it for a formula: behind an apostrophe."""
    return f"'{text}" if _is_formula(text) else text


def of_cell(cell: str) -> str:
    """Take away the apostrophe that `as_cell` wrote."""
    return cell[1:] if cell.startswith("'") and _is_formula(cell[1:]) else cell


def _is_formula(text: str) -> bool:
    # with apostrophes before it, so that a text that has some comes back as it was
    return text.lstrip("'").startswith(_BEGIN_FORMULA)


def shipped_table(name: str) -> Table:
    """Read a table of the package, also where that is a zip file."""
    from importlib.resources import files  # noqa: PLC0415 - 7 ms of import

    return _parse((files("imgscale") / "tables" / name).read_text(encoding="utf-8"), name)


def read_table(path: str | PathLike[str], max_bytes: int) -> Table:
    """Read a user's table."""
    return _parse(read_text(path, max_bytes), str(path))


def write_table(
    path: str | PathLike[str], columns: Sequence[str], rows: Iterable[Sequence[str]]
) -> None:
    """Write a table that `read_table` reads back."""
    import csv  # noqa: PLC0415 - 2 ms of import
    from pathlib import Path  # noqa: PLC0415 - 5 ms of import

    with Path(path).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)


def _parse(text: str, name: str) -> Table:
    import csv  # noqa: PLC0415 - 2 ms of import

    reader = csv.DictReader(StringIO(text, newline=""), restkey="")
    try:
        columns = tuple(reader.fieldnames or ())
        records = [(reader.line_num, dict[str, Any](record)) for record in reader]
    except csv.Error as error:  # such as of a cell without end
        msg = f"{name} must be a CSV table; line {reader.line_num}: {error}."
        raise FileError(msg) from error
    if len(set(columns)) < len(columns):
        msg = f"{name} must name each column once; got {', '.join(columns)}."
        raise FileError(cut(msg))
    return Table(name, columns, records)
