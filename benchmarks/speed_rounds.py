"""Time calls in turn, so that a busy machine is as busy for each, and lay the figures out."""

from __future__ import annotations

import math
import statistics
import time
import tracemalloc
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

Run: TypeAlias = Callable[[], object]
Clock: TypeAlias = Callable[[], float]

# A round repeats a short call until it takes so long.
_SHORTEST_S = 0.02
_LONG_S = 5.0
_MS, _US, _MEGA = 1e3, 1e6, 1e6
HEADINGS = ("what", "size", "ours", "peer", "the peer's", "times as fast", "goal", "extra memory")


@dataclass(frozen=True)
class Timing:
    """
    What a call took.

    Attributes
    ----------
    seconds : tuple of float
        Of one call, in each round.
    references : float
        How many references the call goes through; 0 where it is the call that counts.
    peak : float or None
        Most memory that it held beside its inputs and its result, in bytes.
    """

    seconds: tuple[float, ...]
    references: float = 0
    peak: float | None = None

    @property
    def unit_s(self) -> tuple[float, ...]:
        """Seconds for one reference, or for the call, in each round."""
        return tuple(second / (self.references or 1) for second in self.seconds)

    @property
    def million_per_s(self) -> float:
        """Median speed, in millions of references a second."""
        return 1 / (_MEGA * statistics.median(self.unit_s))

    def __str__(self) -> str:
        if self.references:
            speed = self.million_per_s
            return f"{speed:.1f} M/s" if speed >= 1 else f"{speed:.2g} M/s"
        seconds = statistics.median(self.seconds)
        return f"{_US * seconds:.0f} us" if seconds < 1 / _MS else f"{_MS * seconds:.3g} ms"


@dataclass(frozen=True)
class Row:
    """
    One line of the table.

    Attributes
    ----------
    what, size : str
        What was timed, on how much.
    ours : Timing
        The library's figure.
    peer : str
        What stands beside it.
    beside : Timing
        The peer's figure, from the same rounds.
    least_ratio, least_speed, most_memory : float or None
        Goals: times as fast as the peer, millions of references a second, and bytes.
    """

    what: str
    size: str
    ours: Timing
    peer: str
    beside: Timing
    least_ratio: float | None = None
    least_speed: float | None = None
    most_memory: float | None = None

    @property
    def ratios(self) -> list[float]:
        """How many times as fast as the peer, in each round."""
        return [
            theirs / mine for mine, theirs in zip(self.ours.unit_s, self.beside.unit_s, strict=True)
        ]

    @property
    def cells(self) -> tuple[str, ...]:
        """The line under `HEADINGS`."""
        ratios = self.ratios
        spread = (
            f"{_short(statistics.median(ratios))} ({_short(min(ratios))} to {_short(max(ratios))})"
        )
        memory = f"{_bytes(self.ours.peak)} / {_bytes(self.beside.peak)}"
        goals = "; ".join(self._goals())
        return (
            self.what,
            self.size,
            str(self.ours),
            self.peer,
            str(self.beside),
            spread,
            goals,
            "" if memory == "- / -" else memory,
        )

    def _goals(self) -> list[str]:
        goals: list[str] = []
        if self.least_ratio is not None:
            reached = statistics.median(self.ratios) >= self.least_ratio
            goals.append(f"{_short(self.least_ratio)}{_verdict(reached)}")
        if self.least_speed is not None:
            reached = self.ours.million_per_s >= self.least_speed
            goals.append(f"{self.least_speed:g} M/s{_verdict(reached)}")
        if self.most_memory is not None and self.ours.peak is not None:
            reached = self.ours.peak <= self.most_memory
            goals.append(f"{_bytes(self.most_memory)}{_verdict(reached)}")
        return goals


def timed(
    calls: Mapping[str, Run],
    rounds: int,
    *,
    references: Mapping[str, float] | None = None,
    peaks: Mapping[str, float] | None = None,
    clock: Clock = time.process_time,
) -> dict[str, Timing]:
    """
    Time calls in turn, round after round.

    Parameters
    ----------
    calls : mapping of str to callable
        What to time, by name.
    rounds : int
        How often each has its turn; a first one, which warms up, does not count.
    references : mapping of str to float, optional
        How many references a call goes through, where that counts.
    peaks : mapping of str to float, optional
        The memory that each held, measured before.
    clock : callable
        Seconds; the processor's by default, which other programs do not lengthen.

    Returns
    -------
    dict
        A `Timing` for each call.
    """
    repeats = {name: _repeats(call, clock) for name, call in calls.items()}
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            start = clock()
            for _ in range(repeats[name]):
                call()
            seconds[name].append((clock() - start) / repeats[name])
    return {
        name: Timing(tuple(took), (references or {}).get(name, 0), (peaks or {}).get(name))
        for name, took in seconds.items()
    }


def _repeats(call: Run, clock: Clock) -> int:
    """Warm up, and tell how often to call in one round."""
    took = _SHORTEST_S
    for _ in range(2):  # the first imports and compiles
        start = clock()
        call()
        took = clock() - start
        if took > _LONG_S:
            break
    return max(1, math.ceil(_SHORTEST_S / max(took, 1e-7)))


def traced_peak(call: Run) -> float:
    """
    Measure the most memory that numpy and Python held during a call, and for its time alone.

    Parameters
    ----------
    call : callable
        What to run; once before, to warm up.

    Returns
    -------
    float
        Bytes beyond what was held before and is in the result.
    """
    call()
    tracemalloc.start()
    try:
        tracemalloc.reset_peak()
        result = call()
        after, peak = tracemalloc.get_traced_memory()
        del result
        return float(peak - after)
    finally:
        tracemalloc.stop()


def plain(rows: Sequence[Row]) -> str:
    """Lay rows out for a terminal."""
    lines = [HEADINGS, *(row.cells for row in rows)]
    widths = [max(len(line[place]) for line in lines) for place in range(len(HEADINGS))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in lines
    )


def markdown(rows: Sequence[Row]) -> str:
    """Lay rows out for a page."""
    lines = [HEADINGS, ("---",) * len(HEADINGS), *(row.cells for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _short(number: float) -> str:
    """Round to two digits, without an exponent."""
    return f"{number:.2g}" if number < 100 else f"{float(f'{number:.2g}'):.0f}"


def _bytes(size: float | None) -> str:
    if size is None:
        return "-"
    return f"{size / 1e6:.0f} MB" if size >= 1e6 else f"{size / 1e3:.0f} kB"


def _verdict(reached: bool) -> str:  # noqa: FBT001 - what it says
    return "" if reached else ", missed"
