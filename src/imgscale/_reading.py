"""Files that anyone may have written: regular, of limited length, named in errors."""

from __future__ import annotations

import errno
import math
import os
import re
import reprlib
import stat
from collections.abc import Generator
from contextlib import contextmanager
from os import PathLike
from typing import Any, BinaryIO, cast

from imgscale.errors import FileError

MAX_BYTES = 500_000_000
"""Bytes of a text file that are read where the caller gives no other limit."""

_SHOWN = 1000  # characters of a message that may quote what a file holds
_KINDS = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
# Python's `float` takes "1_000", "\u0661" and "infinity" too, which no format has.
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.ASCII | re.IGNORECASE)


def _short_repr() -> reprlib.Repr:
    short = reprlib.Repr()
    short.maxstring = short.maxlong = short.maxother = 200
    short.maxlist = short.maxtuple = short.maxdict = 10
    short.maxlevel = 3
    return short


quoted = _short_repr().repr
"""Writes a value for a message, as `repr` does but shortened in the middle and in depth."""


def cut(text: str) -> str:
    """
    Shorten a message in the middle, so that a gigabyte of a file is never quoted whole.

    Parameters
    ----------
    text : str
        The message.

    Returns
    -------
    str
        The message, or where it has more than 1000 characters its two ends.
    """
    half = _SHOWN // 2
    return text if len(text) <= _SHOWN else f"{text[:half]} [...] {text[-half:]}"


@contextmanager
def in_file(path: object) -> Generator[None]:
    """Turn an error about what a file holds into a `FileError` that names the file first."""
    try:
        yield
    except FileError:
        raise  # it names one
    except (ArithmeticError, MemoryError, RecursionError, TypeError, ValueError) as error:
        raise FileError(cut(f"{path}: {_cause(error)}")) from error


@contextmanager
def decoding(path: object, what: str) -> Generator[None]:
    """Turn whatever another library raises of a broken file into a `FileError`."""
    try:
        yield
    except FileError:
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.errno == errno.EIO:
            raise  # the disk's; others are of places that a broken file leads to
        raise FileError(cut(f"{path} cannot be read as {what}: {_cause(error)}")) from error


def _cause(error: Exception) -> str:
    return str(error) or type(error).__name__


def check_limit(name: str, limit: object) -> None:
    """Raise unless a limit is a whole number above 0."""
    if isinstance(limit, bool) or not isinstance(limit, int):
        msg = f"`{name}` must be a whole number above 0; got {limit!r}."
        raise TypeError(msg)
    if limit <= 0:
        msg = f"`{name}` must be a whole number above 0; got {limit}."
        raise ValueError(msg)


def open_file(path: str | PathLike[str]) -> BinaryIO:
    """
    Open a regular file for reading bytes.

    Parameters
    ----------
    path : str or path-like
        The file.

    Returns
    -------
    file
        The open file.

    Raises
    ------
    FileError
        If it is a folder, a pipe or a device: those have no end, or wait for one; if its name is
        none, or longer than the system takes.
    TypeError
        If the path is none.
    OSError
        If there is no such file, or it may not be read.
    """
    given = cast("object", path)
    if not isinstance(given, (str, bytes, PathLike)):
        msg = f"`path` must be a string or path-like; got {quoted(given)}."
        raise TypeError(msg)
    with in_file(ascii(path)):  # what no system takes for a name, such as one with a NUL
        try:
            kind = stat.S_IFMT(os.stat(path).st_mode)  # noqa: PTH116 - not of an integer
        except OSError as error:
            if error.errno != errno.ENAMETOOLONG:
                raise
            msg = f"{quoted(str(path))} cannot be a file: {error.strerror}."
            raise FileError(msg) from error
    if kind != stat.S_IFREG:
        msg = f"{path} must be a regular file; got {_KINDS.get(kind, 'a device')}."
        raise FileError(msg)
    return open(path, "rb")  # noqa: PTH123 - the caller closes it


def read_bytes(path: str | PathLike[str], max_bytes: int = MAX_BYTES) -> bytes:
    """
    Read a regular file of limited length.

    Parameters
    ----------
    path : str or path-like
        The file.
    max_bytes : int
        Its greatest length in bytes.

    Returns
    -------
    bytes
        What it holds.

    Raises
    ------
    FileError
        If it is longer, or no regular file.
    OSError
        If it cannot be opened.
    """
    check_limit("max_bytes", max_bytes)
    with open_file(path) as file:
        length = os.fstat(file.fileno()).st_size
        if length > max_bytes:
            msg = (
                f"{path} must hold at most {max_bytes} bytes; got {length}. Give a larger "
                "`max_bytes` where you trust it."
            )
            raise FileError(msg)
        return file.read(length)


def read_text(path: str | PathLike[str], max_bytes: int = MAX_BYTES) -> str:
    """
    Read a text file in UTF-8, with or without a byte order mark.

    Parameters
    ----------
    path : str or path-like
        The file.
    max_bytes : int
        Its greatest length in bytes.

    Returns
    -------
    str
        The text, with its line ends as they are.

    Raises
    ------
    FileError
        If it is no UTF-8, longer than the limit, or no regular file.
    OSError
        If it cannot be opened.
    """
    content = read_bytes(path, max_bytes)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        msg = f"{path} must be UTF-8; got byte {content[error.start]:#x} at {error.start}."
        raise FileError(msg) from error


def read_json(path: str | PathLike[str], max_bytes: int = MAX_BYTES) -> Any:
    """
    Parse a file of JSON.

    Parameters
    ----------
    path : str or path-like
        The file.
    max_bytes : int
        Its greatest length in bytes. What is parsed takes up to 30 times the memory.

    Returns
    -------
    object
        What it holds.

    Raises
    ------
    FileError
        As `parse_json`, or if it is longer than the limit or no regular file.
    OSError
        If it cannot be opened.
    """
    content = read_bytes(path, max_bytes)
    try:
        return parse_json(content)
    except ValueError as error:
        raise FileError(cut(f"{path} must hold JSON; got: {error}.")) from error


def parse_json(content: str | bytes) -> Any:
    """
    Parse JSON as its standard has it: names once in an object, and numbers that are finite.

    Parameters
    ----------
    content : str or bytes
        The text; bytes in UTF-8, UTF-16 or UTF-32.

    Returns
    -------
    object
        What it holds.

    Raises
    ------
    ValueError
        If it is no JSON, nests too deeply, has one name twice in an object, or holds NaN, Infinity
        or a number beyond all floats.
    """
    import json  # noqa: PLC0415 - 2 ms that a fit does not need

    try:
        return json.loads(
            content,
            parse_constant=_refuse_constant,
            parse_float=_finite,
            object_pairs_hook=_each_once,
        )
    except (json.JSONDecodeError, _NotStrictError):
        raise
    except UnicodeDecodeError as error:
        msg = f"a byte at {error.start} that is no text in UTF-8"
        raise ValueError(msg) from error
    except RecursionError as error:
        msg = "too deep a nesting"
        raise ValueError(msg) from error
    except ValueError as error:  # Python limits the digits of a whole number
        msg = "too long a number"
        raise ValueError(msg) from error


class _NotStrictError(ValueError):
    """Raised for what Python's parser takes and JSON has not."""


def _refuse_constant(name: str) -> None:
    msg = f"{name}, which JSON has no number for"
    raise _NotStrictError(msg)


def _finite(digits: str) -> float:
    number = float(digits)
    if math.isinf(number):
        msg = f"the number {digits[:40]}, which is beyond all floats"
        raise _NotStrictError(msg)
    return number


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        last = {name: place for place, (name, _) in enumerate(pairs)}
        name = next(name for place, (name, _) in enumerate(pairs) if last[name] != place)
        msg = f"the name {name[:100]!r} twice in one object"
        raise _NotStrictError(msg)
    return found


def number_of(word: str) -> float:
    """
    Read a decimal number out of a text file.

    Parameters
    ----------
    word : str
        The text: a sign, ASCII digits, a point and an exponent.

    Returns
    -------
    float
        The number; infinite where it is beyond all floats, NaN where the text is no number.
    """
    return float(word) if _NUMBER.fullmatch(word) else math.nan
