"""Measure the most memory that a call holds for a while, in a fresh process, whoever takes it."""

from __future__ import annotations

import ctypes
import gc
import multiprocessing
import multiprocessing.connection
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np
from speed_rounds import Run

# Makes the calls of one size, by name: a function of a module, so that another process finds it.
Maker: TypeAlias = Callable[..., dict[str, Run]]

_STATUS, _RESET = Path("/proc/self/status"), Path("/proc/self/clear_refs")
_WARM_UP = 300


def peak_memory(maker: Maker, names: Sequence[str], size: int) -> dict[str, float]:
    """
    Measure calls one by one, each in a process of its own.

    Parameters
    ----------
    maker : callable
        From a size and the names that are wanted to the calls.
    names : sequence of str
        Which.
    size : int
        The size.

    Returns
    -------
    dict
        Bytes beyond what was held before and is in the result, by name; empty where the system
        does not tell.
    """
    if not sys.platform.startswith("linux"):
        return {}
    return {name: _in_a_process(maker, name, size) for name in names}


def _in_a_process(maker: Maker, name: str, size: int) -> float:
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_measure, args=(sender, maker, name, size))
    process.start()
    sender.close()
    try:
        return float(receiver.recv())
    finally:
        process.join()


def _measure(
    sender: multiprocessing.connection.Connection, maker: Maker, name: str, size: int
) -> None:
    maker(min(size, _WARM_UP), (name,))[name]()
    call = maker(size, (name,))[name]
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    _RESET.write_text("5", encoding="ascii")  # the peak begins anew
    before = _status("VmRSS")
    result = call()
    sender.send(max(0, _status("VmHWM") - before - _size(result)))


def _size(result: object) -> int:
    """Bytes of the arrays of a result."""
    if isinstance(result, np.ndarray):
        return result.nbytes
    return sum(map(_size, result)) if isinstance(result, tuple | list) else 0


def _status(field: str) -> int:
    """Read a line of the process's state, in bytes."""
    line = next(
        line for line in _STATUS.read_text(encoding="ascii").splitlines() if line.startswith(field)
    )
    return 1024 * int(line.split()[1])
