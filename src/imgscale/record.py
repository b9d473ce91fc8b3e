"""A record of a long run: JSON lines, one per picture, under a first line with the options."""

from __future__ import annotations

import json
import sys
from collections.abc import Generator
from contextlib import contextmanager
from os import PathLike, fspath
from pathlib import Path
from typing import Any, cast

from imgscale._reading import MAX_BYTES, cut, parse_json, read_bytes
from imgscale.errors import FileError, FitError

__all__ = ["append", "read_record", "resume"]

_SCHEMA = 1
_BEGIN = b'{"imgscale"'


def resume(path: str | PathLike[str], options: dict[str, Any]) -> frozenset[str]:
    """
    Begin a record, or find out what one holds already.

    A last line without an end, as a killed run leaves it, is cut off: that picture is done again.

    Parameters
    ----------
    path : path
        The record; made where it is missing or empty.
    options : dict
        What the results hang on, in types that `json` writes.

    Returns
    -------
    frozenset of str
        Pictures that are done: measured, or without what a fit needs.

    Raises
    ------
    FileError
        If the file is no record.
    ValueError
        If it was made with other options.
    OSError
        If it cannot be read or written.
    """
    file = Path(path)
    header = json.loads(json.dumps({"imgscale": _SCHEMA, "options": options}))
    # what a long run has written may have any length: it is the user's own
    text = read_bytes(file, sys.maxsize) if file.exists() else b""
    whole = text[: text.rfind(b"\n") + 1]
    if not whole:
        if text[: len(_BEGIN)] != _BEGIN[: len(text)]:
            raise FileError(_no_record(file, 1))
        with _named(file):
            file.write_text(json.dumps(header) + "\n", encoding="utf-8")
        return frozenset()
    first, rows = _parsed(file, whole)
    _check_header(file, first, header)
    if len(whole) < len(text):
        with _named(file), file.open("r+b") as opened:
            opened.truncate(len(whole))
    return frozenset(row["path"] for row in rows if not _failed(row))


def read_record(path: str | PathLike[str], *, max_bytes: int = MAX_BYTES) -> list[dict[str, Any]]:
    """
    Read the record of a run of `measure_many`.

    Parameters
    ----------
    path : path
        The file that was given as ``record``.
    max_bytes : int
        Greatest length of the file.

    Returns
    -------
    list of dict
        What `Outcome.to_dict` gave for each picture, the last where one was tried again, in the
        order of the first tries. A last line without an end is left out.

    Raises
    ------
    FileError
        If the file is no record, or longer than `max_bytes`.
    OSError
        If it cannot be read.
    """
    file = Path(path)
    whole, _, _ = read_bytes(file, max_bytes).rpartition(b"\n")
    _, rows = _parsed(file, whole)
    return list({row["path"]: row for row in rows}.values())


def _failed(line: dict[str, Any]) -> bool:
    """Tell whether a picture may fare better another time."""
    return "error" in line and line["error"].get("type") != FitError.__name__


def append(path: str | PathLike[str], row: dict[str, Any]) -> None:
    """
    Write one line, and let go of the file, so that nothing is lost where the run ends early.

    Parameters
    ----------
    path : path
        The record.
    row : dict
        What to write, in types that `json` writes.
    """
    with _named(path), Path(path).open("a", encoding="utf-8") as opened:
        opened.write(json.dumps(row, allow_nan=False) + "\n")


@contextmanager
def _named(path: str | PathLike[str]) -> Generator[None]:
    """Name the file where the system's error does not, as that of a full disk."""
    try:
        yield
    except OSError as error:
        error.filename = error.filename or fspath(path)
        raise


def _parsed(file: Path, whole: bytes) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Read the first line with the options, and those of the pictures."""
    rows = [_row(file, number, line) for number, line in enumerate(whole.splitlines(), 1)]
    if not rows:
        raise FileError(_no_record(file, 1))
    return rows[0], rows[1:]


def _row(file: Path, number: int, line: bytes) -> dict[str, Any]:
    try:
        row: object = parse_json(line)
    except ValueError as error:
        raise FileError(_no_record(file, number)) from error
    if not isinstance(row, dict):
        raise FileError(_no_record(file, number))
    found = cast("dict[str, Any]", row)
    if not (_is_header(found) if number == 1 else _is_picture(found)):
        raise FileError(_no_record(file, number))
    return found


def _is_header(row: dict[str, Any]) -> bool:
    schema: object = row.get("imgscale")
    is_ours = schema == _SCHEMA and not isinstance(schema, bool)
    return is_ours and isinstance(row.get("options"), dict)


def _is_picture(row: dict[str, Any]) -> bool:
    return isinstance(row.get("path"), str) and isinstance(row.get("error", {}), dict)


def _check_header(file: Path, found: dict[str, Any], wanted: dict[str, Any]) -> None:
    theirs, ours = found["options"], wanted["options"]
    differing = sorted(
        name for name in theirs.keys() | ours.keys() if theirs.get(name) != ours.get(name)
    )
    if differing:
        msg = (
            f"`record` must have been made with the same options; {file} was made with other "
            f"{cut(', '.join(differing))}. Give another file, or the options of that run."
        )
        raise ValueError(msg)


def _no_record(file: Path, number: int) -> str:
    return (
        f"`record` must be a file that `measure_many` wrote; {file} is not, see line {number}. "
        "Give another file."
    )
