"""The figures as a table to read and as JSON to compare."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from validation_goals import Goal
from validation_rows import Row
from validation_scores import Scores
from validation_sections import DAMAGE, SECTIONS, Section

_LEGEND = """\
Relative error of heights in %: median +- its standard error (drives resampled), mean, 90th
percentile, bias (median of the signed error); c50, c90, c95: how many % of the 50, 90 and 95 %
intervals hold the truth. On the same objects the median error of: the paper's mean ratio with the
same table, without the object's class; the mean of its class; its pixels and depth with the true
focal length."""
_HEADER = (
    f"{'row':26}{'n':>7}{'median':>13}{'mean':>7}{'p90':>7}{'bias':>7}{'c50':>7}{'c90':>13}"
    f"{'c95':>7}{'paper':>8}{'class':>7}{'focal':>7}"
)
_RATIO_HEADER = f"{'x median':>10}{'x mean':>8}"


def table(rows: Sequence[Row], scores: Mapping[str, Scores]) -> Iterator[str]:
    """Lay the rows out, section by section."""
    yield _LEGEND
    for section in SECTIONS:
        inside = [row for row in rows if row.section == section]
        if inside:
            yield from _section(section, inside, scores)


def goal_list(goals: Sequence[Goal]) -> Iterator[str]:
    """List the goals with what was reached."""
    yield ""
    yield "Goals"
    for goal in goals:
        low = f"{goal.low:.2f} to " if goal.low else "at most "
        reached = "-" if math.isnan(goal.value) else f"{goal.value:.2f}"
        yield f"  {goal.verdict:8}{goal.text:46}{reached:>8}   {low}{goal.high:.2f}"
    passed, failed = (sum(goal.verdict == word for goal in goals) for word in ("pass", "FAIL"))
    yield f"  {passed} passed, {failed} failed, {len(goals) - passed - failed} not run"


def write_json(
    path: Path,
    meta: Mapping[str, Any],
    rows: Sequence[Row],
    scores: Mapping[str, Scores],
    goals: Sequence[Goal],
) -> None:
    """Write the figures of the table."""
    record = {
        "meta": meta,
        "rows": [
            {
                "id": row.name,
                "section": row.section.name,
                "unit": "px" if row.in_pixels else "%",
                **asdict(scores[row.name]),
            }
            for row in rows
            if row.name in scores
        ],
        "left_out": [row.name for row in rows if row.name not in scores],
        "goals": [{**asdict(goal), "verdict": goal.verdict} for goal in goals],
    }
    path.write_text(json.dumps(_plain(record), indent=1) + "\n", encoding="utf-8")


def _section(section: Section, rows: Sequence[Row], scores: Mapping[str, Scores]) -> Iterator[str]:
    with_ratio = any(row.clean is not None for row in rows)
    yield ""
    yield section.title
    yield _HEADER + (_RATIO_HEADER if with_ratio else "")
    for row in rows:
        if row.name in scores:
            yield _line(row.name, scores[row.name], with_ratio=with_ratio)
    left_out = [row.name for row in rows if row.name not in scores]
    if left_out:
        yield f"left out, no data: {', '.join(left_out)}"
    if section == DAMAGE:
        yield from _clean_lines(rows, scores)
    for row in rows:
        if row.name in scores and not row.is_part:
            yield from _footnote(row.name, scores[row.name])


def _line(name: str, reached: Scores, *, with_ratio: bool) -> str:
    median = f"{reached.median:.2f}{_error(reached.median_se, 2)}"
    coverage = f"{reached.coverage_90:.1f}{_error(reached.coverage_90_se, 1)}"
    line = (
        f"{name:26}{reached.n:7d}{median:>13}{_number(reached.mean, 7)}{_number(reached.p90, 7)}"
        f"{_number(reached.bias, 7)}{_number(reached.coverage_50, 7, 1)}{coverage:>13}"
        f"{_number(reached.coverage_95, 7, 1)}{_number(reached.paper, 8)}"
        f"{_number(reached.class_mean, 7)}{_number(reached.true_focal, 7)}"
    )
    if with_ratio:
        line += _number(reached.median_ratio, 10) + _number(reached.mean_ratio, 8)
    return line


def _clean_lines(rows: Sequence[Row], scores: Mapping[str, Scores]) -> Iterator[str]:
    """Name the errors that the ratios refer to, each once."""
    first = {row.clean: row.name for row in reversed(rows) if row.name in scores and row.clean}
    for name in reversed(list(first.values())):
        reached = scores[name]
        yield (
            f"sound references, objects of {name}: median {reached.clean_median:.2f}, "
            f"mean {reached.clean_mean:.2f}"
        )


def _footnote(name: str, reached: Scores) -> Iterator[str]:
    if reached.refused_images:
        yield f"{name}: {reached.refused_images} images refused, with {reached.refused} objects"
    if reached.unanswered:
        yield f"{name}: {reached.unanswered} objects without an answer"


def _error(value: float, digits: int) -> str:
    return "" if math.isnan(value) else f" +-{value:.{digits}f}"


def _number(value: float, width: int, digits: int = 2) -> str:
    text = "-" if math.isnan(value) else f"{value:.{digits}f}"
    return f"{text:>{width}}"


def _plain(value: Any) -> Any:
    """Turn what JSON has no word for into null."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return round(value, 4) if math.isfinite(value) else None
    return value
