"""
Time the library beside what one would use instead, and print one table.

``python benchmarks/speed.py`` takes a quarter of an hour and, for the largest batch, 14 GB of
memory (it is left out where there is less); ``--quick`` takes a minute. ``--only`` chooses parts:

- single: one picture, by number of references;
- kinds: one picture, by kind of depth;
- batch: 1e4 to 1e6 images of 8 references on average, as columns; largest: 1e7;
- density: a million references in images of 2 to 100;
- boxes and map: depth in boxes, and a map in metres per pixel;
- import: ``import imgscale``.

Calls that stand in one line were timed in turn, in one process and on one thread, by the
processor's clock, imports by the wall's. "Times as fast" is the median of the ratios of all rounds,
and their range. "Extra memory" is the most that a call held beside its inputs and its result. Peers
that are not installed are left out: ``pip install --group bench`` has them all.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

_ONE_THREAD = dict.fromkeys(
    (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "NUMBA_NUM_THREADS",
        "POLARS_MAX_THREADS",
    ),
    "1",
)
_SECTIONS = {
    "single": ("speed_single", "rows"),
    "kinds": ("speed_single", "kind_rows"),
    "batch": ("speed_batch", "rows"),
    "density": ("speed_batch", "density_rows"),
    "largest": ("speed_batch", "largest_rows"),
    "boxes": ("speed_maps", "box_rows"),
    "map": ("speed_maps", "map_rows"),
    "import": ("speed_import", "rows"),
}
_ROUNDS, _FEWEST_ROUNDS = 7, 3


def main(arguments: Sequence[str]) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        prog="speed.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="small sizes, few rounds")
    parser.add_argument("--only", choices=_SECTIONS, action="append", help="a part of the table")
    parser.add_argument("--markdown", action="store_true", help="print the table for a page")
    parser.add_argument("--into", type=Path, help="page whose tables are to be replaced")
    options = parser.parse_args(arguments)
    if any(os.environ.get(name) != "1" for name in _ONE_THREAD):  # libraries read them once
        os.execve(  # noqa: S606 - itself again
            sys.executable, [sys.executable, *sys.orig_argv[1:]], os.environ | _ONE_THREAD
        )
    from speed_rounds import Row, markdown, plain  # noqa: PLC0415 - after the threads

    rounds = _FEWEST_ROUNDS if options.quick else _ROUNDS
    found: list[Row] = []
    for section in options.only or _SECTIONS:
        start = time.perf_counter()
        module, function = _SECTIONS[section]
        rows = getattr(import_module(module), function)(rounds, quick=options.quick)
        found += rows
        if options.into and rows:
            page = options.into.read_text(encoding="utf-8")
            options.into.write_text(_filled(page, section, markdown(rows)), encoding="utf-8")
        print(f"{section}: {time.perf_counter() - start:.0f} s", file=sys.stderr)
    print((markdown if options.markdown else plain)(found))
    return 0


def _filled(page: str, section: str, table: str) -> str:
    """Replace the table that stands between the comments of a section."""
    begin, end = f"<!-- speed: {section} -->", f"<!-- end of {section} -->"
    before, _, rest = page.partition(begin)
    _, found, after = rest.partition(end)
    if not found:
        msg = f"The page must hold {begin} and, behind it, {end}; it does not."
        raise ValueError(msg)
    return f"{before}{begin}\n\n{table}\n\n{end}{after}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
