"""Rows of the table: importing the library, in fresh interpreters and interleaved."""

from __future__ import annotations

import statistics
import subprocess
import sys
from pathlib import Path

from import_time import seconds
from speed_rounds import Row, Timing

_LEAST_RATIO = 1 / 1.4
_NUMPY = "import numpy"
_OURS = ("import imgscale", "from imgscale import fit, predict")
_PEAK = "; print(next(x for x in open('/proc/self/status') if x.startswith('VmHWM')).split()[1])"


def rows(rounds: int, *, quick: bool) -> list[Row]:
    """
    Time imports beside that of numpy, less a bare interpreter's start.

    Parameters
    ----------
    rounds : int
        How many: three times as many count, as other programs lengthen them; one writes bytecode.
    quick : bool
        Whether only as many count.

    Returns
    -------
    list of Row
        The package alone, and with what is loaded when it is first asked for.
    """
    codes = {"": "pass", **{code: code for code in (_NUMPY, *_OURS)}}
    took: dict[str, list[float]] = {name: [] for name in codes}
    for _ in range(1 + rounds * (1 if quick else 3)):
        for name, code in codes.items():
            took[name].append(seconds(code))
    bare = statistics.median(took[""][1:])
    timings = {
        name: Timing(tuple(one - bare for one in took[name][1:]), peak=_peak(name))
        for name in (_NUMPY, *_OURS)
    }
    goals = (_LEAST_RATIO, None)
    return [
        Row(name, "", timings[name], _NUMPY, timings[_NUMPY], goal)
        for name, goal in zip(_OURS, goals, strict=True)
    ]


def _peak(code: str) -> float | None:
    """Most memory of an interpreter that runs some code, beyond that of a bare one."""
    if not Path("/proc/self/status").is_file():
        return None
    peaks = [
        int(
            subprocess.run(
                [sys.executable, "-Ic", c + _PEAK], check=True, capture_output=True
            ).stdout
        )
        for c in ("pass", code)
    ]
    return 1024.0 * (peaks[1] - peaks[0])
