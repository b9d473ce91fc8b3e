"""Run the library over scenes, in one process or in several, with the same result."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat
from multiprocessing import get_context

from validation_outcomes import Outcomes, Part, gather
from validation_protocols import Setting
from validation_runs import Run
from validation_scenes import Scene
from validation_work import Unit, units_of, work


class Validation:
    """
    Scenes, a table of sizes and a method; remembers what it has run.

    To be closed: with more than one job it keeps processes.
    """

    def __init__(self, scenes: Sequence[Scene], setting: Setting, jobs: int = 1) -> None:
        self.scenes = scenes
        self.setting = setting
        self._done: dict[Run, Outcomes] = {}
        self._pool: ProcessPoolExecutor | None = None
        if jobs > 1:
            context = get_context("spawn")
            self._pool = ProcessPoolExecutor(jobs, context, _begin, (scenes, setting))

    def close(self) -> None:
        """End its processes."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def outcomes(self, run: Run) -> Outcomes:
        """Run it, once."""
        if run not in self._done:
            start = time.perf_counter()
            self._done[run] = gather(self._parts(run))
            seconds = time.perf_counter() - start
            print(f"{seconds:7.1f} s  {run.summary}", file=sys.stderr, flush=True)
        return self._done[run]

    def _parts(self, run: Run) -> list[Part]:
        """Work through the units, the largest first; their order in the result stays."""
        units = units_of(self.scenes, run)
        if self._pool is None:
            return [work(self.scenes, self.setting, run, unit) for unit in units]
        order = sorted(range(len(units)), key=lambda place: -len(units[place]))
        tasks = [units[place] for place in order]
        chunk = 1 + len(tasks) // 100
        done = self._pool.map(_work_here, repeat(run), tasks, chunksize=chunk)
        parts = dict(zip(order, done, strict=True))
        return [parts[place] for place in range(len(units))]


# What the processes of a pool work on, given to each once, when it begins.
_given: dict[str, tuple[Sequence[Scene], Setting]] = {}


def _begin(scenes: Sequence[Scene], setting: Setting) -> None:
    _given["work"] = (scenes, setting)


def _work_here(run: Run, unit: Unit) -> Part:
    return work(*_given["work"], run, unit)
