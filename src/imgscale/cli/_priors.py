"""The command ``imgscale priors``."""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from difflib import get_close_matches
from typing import Any

from imgscale._format import text_table
from imgscale.cli._messages import OK, FailedError
from imgscale.object_prior import ObjectPrior, normal_label
from imgscale.prior_rows import COLUMNS, write_row
from imgscale.priors import PriorTable


def run(options: Any) -> int:
    """List the table, or the rows of one label."""
    table = PriorTable.default(options.region)
    label = " ".join(options.label)
    rows = list(table.lookup(label) if label else table)
    if not rows:
        raise FailedError(_no_such_label(label, table))
    if options.csv:
        writer = csv.writer(sys.stdout, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(write_row(row) for row in rows)
    else:
        print(_details(rows) if label else _overview(rows))
    return OK


def _no_such_label(label: str, table: PriorTable) -> str:
    names = sorted({name for prior in table for name in prior.names})
    near = get_close_matches(normal_label(label), names, n=5, cutoff=0.6)
    hint = f"near: {', '.join(near)}" if near else "nothing near it"
    return f'LABEL must be in the table; got "{label}", {hint}. `imgscale priors` lists all.'


def _overview(rows: Sequence[ObjectPrior]) -> str:
    """Lay out all rows, a line each."""
    return f"{_numbers(rows)}\n\n`imgscale priors LABEL` tells names and sources."


def _details(rows: Sequence[ObjectPrior]) -> str:
    """Lay out the rows of one label, with their sources."""
    aliases = list(dict.fromkeys(name for row in rows for name in row.aliases))
    lines = [_numbers(rows), ""]
    lines += [f"also called: {', '.join(aliases)}"] if aliases else []
    for number, row in enumerate(rows, start=1):
        lines.append(f"row {number}: {row.spans}".rstrip(": "))
        lines.append(f"    {row.source}{_of(row)}")
    return "\n".join(lines)


def _of(row: ObjectPrior) -> str:
    year = "" if row.year is None else f"; {row.year}"
    return year if row.n is None else f"{year}; {row.n} individuals"


def _numbers(rows: Sequence[ObjectPrior]) -> str:
    header = ("label", "axis", "mean m", "spread m", "error of mean m", "share")
    cells = [
        (
            row.label,
            row.axis,
            *(f"{n:g}" for n in (row.mean_m, row.std_m, row.mean_std_m, row.share)),
        )
        for row in rows
    ]
    return text_table(header, cells)
