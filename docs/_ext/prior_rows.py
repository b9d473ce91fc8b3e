"""The directive ``prior-rows``: every row of the shipped table of sizes, with its source."""

from __future__ import annotations

import csv
from html import escape
from importlib.resources import files
from itertools import groupby
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from imgscale.object_prior import SHIPPED

# A group begins with this label of the table, whose rows stand in the order of the groups.
_GROUPS = {
    "person": "People",
    "car": "Vehicles and wheels",
    "traffic light": "In the street",
    "door": "Buildings and bricks",
    "dining table": "Furniture and appliances",
    "tv": "Screens and devices",
    "a4 sheet": "Paper, cards, money and discs",
    "bottle": "Bottles and dishes",
    "soccer ball": "Sport",
    "eur pallet": "Freight and small parts",
    "tree": "Trees and animals",
    "apple": "Fruit",
}
_HEAD = "".join(
    f"<th>{words}</th>" for words in ("label", "what the box spans", "mean, spread", "source")
)
Row = dict[str, str]


class PriorRows(SphinxDirective):
    """Sections of tables, one row of HTML for each row of the table."""

    def run(self) -> list[nodes.Node]:
        """Read the shipped table, and depend on it."""
        path = files("imgscale") / "tables" / SHIPPED
        self.env.note_dependency(str(path))
        rows = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))
        missing = _GROUPS.keys() - {row["label"] for row in rows}
        if missing:
            msg = f"the table has no row of {', '.join(sorted(missing))}"
            raise self.error(msg)
        groups = _grouped(rows)
        return [_jumps(groups), *(self._section(title, members) for title, members in groups)]

    def _section(self, title: str, rows: list[Row]) -> nodes.section:
        section = nodes.section("", nodes.title("", title), ids=[nodes.make_id(title)])
        self.state.document.note_implicit_target(section)
        section += nodes.raw("", _table(rows), format="html")
        return section


def _jumps(groups: list[tuple[str, list[Row]]]) -> nodes.raw:
    """One line that leads to each group."""
    links = (f'<a href="#{nodes.make_id(title)}">{escape(title)}</a>' for title, _ in groups)
    return nodes.raw("", f"<p>{' · '.join(links)}</p>", format="html")


def _grouped(rows: list[Row]) -> list[tuple[str, list[Row]]]:
    groups: list[tuple[str, list[Row]]] = []
    for row in rows:
        title = _GROUPS.get(row["label"])
        if title and (not groups or groups[-1][0] != title):
            groups.append((title, []))
        groups[-1][1].append(row)
    return groups


def _table(rows: list[Row]) -> str:
    body = "".join(
        f"<tbody>{''.join(_cells(row, first=index == 0) for index, row in enumerate(kin))}</tbody>"
        for kin in (list(found) for _, found in groupby(rows, key=lambda row: row["label"]))
    )
    return f'<table class="prior-rows"><thead><tr>{_HEAD}</tr></thead>{body}</table>'


def _cells(row: Row, *, first: bool) -> str:
    """One row; label and aliases stand in the first of their rows."""
    aliases = f"<br><small>{escape(row['aliases'])}</small>" if row["aliases"] else ""
    name = f"<b>{escape(row['label'])}</b>{aliases}" if first else ""
    year = f" ({row['year']})" if row["year"] and row["year"] not in row["source"] else ""
    sample = f" n = {row['n']}." if row["n"] else ""
    cells = (
        name,
        f"{escape(row['spans'])}<br><small>{_remarks(row)}</small>",
        _numbers(row),
        f"<small>{escape(row['source'])}{year}.{sample}</small>",
    )
    return f"<tr>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"


def _remarks(row: Row) -> str:
    """Axis, region, share and what else is not the rule."""
    share = float(row["share"] or 1)
    remarks = [
        row["axis"],
        row["region"] if row["region"] != "world" else "",
        f"{share * 100:.0f} % of them" if share < 1 else "",
        f"{row['depth_extent_m']} m deep" if row["depth_extent_m"] else "",
        "not on the ground" if row["on_ground"] == "false" else "",
    ]
    return ", ".join(filter(None, remarks))


def _numbers(row: Row) -> str:
    mean = f"{row['mean_m']} ± {row['std_m']} m"
    own = row["mean_std_m"]
    return f"{mean}<br><small>mean ± {own}</small>" if own and float(own) else mean


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("prior-rows", PriorRows)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
