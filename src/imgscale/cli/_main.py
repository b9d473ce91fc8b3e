"""Runs a command: errors become one line and an exit code."""

from __future__ import annotations

import io
import os
import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, cast

from imgscale.cli._messages import (
    CLOSED_PIPE,
    FAILED,
    INTERRUPTED,
    WRONG_USAGE,
    WrongUsageError,
    complain,
    in_words,
)
from imgscale.cli._parser import parse

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """
    Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        The words after the program's name; those of the process where omitted.

    Returns
    -------
    int
        Exit code: 0 where all went well; 1 where something could not be done, a photo be measured
        or a label be found; 2 where the command or a file for all photos is wrong and nothing was
        begun; 130 after Ctrl-C; 141 where the reader of the output has gone.

    Raises
    ------
    SystemExit
        With 2 for words that are no command, with 0 for ``--help`` and ``--version``.

    Examples
    --------
    >>> from imgscale.cli import main
    >>> main(["priors", "door"])
    label    axis  mean m  spread m  error of mean m  share
    -----  ------  ------  --------  ---------------  -----
    door   height    2.01      0.06             0.02      1
    <BLANKLINE>
    row 1: leaf of an interior or front door; ...
    0
    """
    _open_closed()
    _show_any_text()
    try:
        options = parse(arguments)
        code = _run(options.command, options)
        sys.stdout.flush()
    except BrokenPipeError:
        _leave_pipe()
        return CLOSED_PIPE
    return code


def _run(command: str, options: Any) -> int:
    """Run one command; its module is imported here."""
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            module: Any = import_module(f"imgscale.cli._{command}")
            return cast("int", module.run(options))
    except BrokenPipeError:
        raise
    except KeyboardInterrupt:
        return INTERRUPTED
    except WrongUsageError as error:
        complain(in_words(error))
        return WRONG_USAGE
    except Exception as error:  # noqa: BLE001 - whatever it is, a script gets a line and a code
        complain(in_words(error))
        return FAILED


def _open_closed() -> None:
    """Let what is told where nobody listens (``>&-``) go to nowhere."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            nowhere = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - to the end
            setattr(sys, name, nowhere)


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    """Tell a warning in one line, without the place in somebody's source."""
    complain(f"warning: {message}")


def _show_any_text() -> None:
    """Let a terminal that cannot show a label show its escapes instead of failing."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
            stream.reconfigure(errors="backslashreplace")


def _leave_pipe() -> None:
    """Send what is left to nowhere, so that nothing more is said when the process ends."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):  # a stream without a file
        return
