"""A record of a long run: JSON lines, one per picture, under a first line with the options."""

from __future__ import annotations

import json
from os import PathLike
from pathlib import Path
from typing import Any, cast

from imgscale.errors import FitError

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
    ValueError
        If the file is no record, or was made with other options.
    OSError
        If it cannot be read or written.
    """
    file = Path(path)
    header = json.loads(json.dumps({"imgscale": _SCHEMA, "options": options}))
    text = file.read_bytes() if file.exists() else b""
    whole = text[: text.rfind(b"\n") + 1]
    if not whole:
        if text[: len(_BEGIN)] != _BEGIN[: len(text)]:
            raise ValueError(_no_record(file, 1))
        file.write_text(json.dumps(header) + "\n", encoding="utf-8")
        return frozenset()
    lines = [_parsed(file, number, line) for number, line in enumerate(whole.splitlines(), 1)]
    _check_header(file, lines[0], header)
    if len(whole) < len(text):
        with file.open("r+b") as opened:
            opened.truncate(len(whole))
    nameless = [number for number, line in enumerate(lines[1:], 2) if "path" not in line]
    if nameless:
        raise ValueError(_no_record(file, nameless[0]))
    return frozenset(str(line["path"]) for line in lines[1:] if not _failed(line))


def read_record(path: str | PathLike[str]) -> list[dict[str, Any]]:
    """
    Read the record of a run of `measure_many`.

    Parameters
    ----------
    path : path
        The file that was given as ``record``.

    Returns
    -------
    list of dict
        What `Outcome.to_dict` gave for each picture, the last where one was tried again, in the
        order of the first tries. A last line without an end is left out.

    Raises
    ------
    ValueError
        If the file is no record.
    OSError
        If it cannot be read.
    """
    file = Path(path)
    whole, _, _ = file.read_bytes().rpartition(b"\n")
    lines = [_parsed(file, number, line) for number, line in enumerate(whole.splitlines(), 1)]
    if not lines or lines[0].get("imgscale") != _SCHEMA:
        raise ValueError(_no_record(file, 1))
    return list({str(line.get("path")): line for line in lines[1:]}.values())


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
    with Path(path).open("a", encoding="utf-8") as opened:
        opened.write(json.dumps(row) + "\n")


def _parsed(file: Path, number: int, line: bytes) -> dict[str, Any]:
    try:
        row = json.loads(line)
    except ValueError as error:
        raise ValueError(_no_record(file, number)) from error
    if not isinstance(row, dict):
        raise ValueError(_no_record(file, number))  # noqa: TRY004 - a file's content
    return cast("dict[str, Any]", row)


def _check_header(file: Path, found: dict[str, Any], wanted: dict[str, Any]) -> None:
    if found.get("imgscale") != _SCHEMA or not isinstance(found.get("options"), dict):
        raise ValueError(_no_record(file, 1))
    theirs, ours = found["options"], wanted["options"]
    differing = sorted(
        name for name in theirs.keys() | ours.keys() if theirs.get(name) != ours.get(name)
    )
    if differing:
        msg = (
            f"`record` must have been made with the same options; {file} was made with other "
            f"{', '.join(differing)}. Give another file, or the options of that run."
        )
        raise ValueError(msg)


def _no_record(file: Path, number: int) -> str:
    return (
        f"`record` must be a file that `measure_many` wrote; {file} is not, see line {number}. "
        "Give another file."
    )
