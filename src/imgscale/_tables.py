"""CSV tables, the package's own and the user's. The parser is loaded when a table is used."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from io import StringIO
from os import PathLike
from typing import Any, NamedTuple


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


def shipped_table(name: str) -> Table:
    """Read a table of the package, also where that is a zip file."""
    from importlib.resources import files  # noqa: PLC0415 - 7 ms of import

    return _parse((files("imgscale") / "tables" / name).read_text(encoding="utf-8"), name)


def read_table(path: str | PathLike[str]) -> Table:
    """Read a user's table."""
    from pathlib import Path  # noqa: PLC0415 - 5 ms of import

    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        msg = f"{path} must be UTF-8; got byte {error.object[error.start]:#x} at {error.start}."
        raise ValueError(msg) from error
    return _parse(text, str(path))


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
    columns = tuple(reader.fieldnames or ())
    if len(set(columns)) < len(columns):
        msg = f"{name} must name each column once; got {', '.join(columns)}."
        raise ValueError(msg)
    records = [(reader.line_num, dict[str, Any](record)) for record in reader]
    return Table(name, columns, records)
