"""What is written of hostile texts: no formula in a table, no script in a page, no NaN in JSON."""

import csv
import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

import imgscale as ims
from imgscale._tables import as_cell, of_cell
from imgscale.cli import main

FORMULAS = ("=1+1", "+1", "-1", "@sum(a1)", "\t=1", "\r=1", "\n=1", "=cmd|' /C calc'!A0", "\uff1d1")
SCRIPTS = (
    "<script>alert(1)</script>", '"><img src=x onerror=alert(1)>', "</title><script>alert(1)",
    "</pre><svg onload=alert(1)>", "javascript:alert(1)", "' onmouseover='alert(1)", "]]>", "-->",
)  # fmt: skip


def strict(text):
    """Parse JSON as its standard has it."""

    def refuse(name):
        raise AssertionError(name)

    return json.loads(text, parse_constant=refuse)


# --- tables ---


@pytest.mark.parametrize("text", [*FORMULAS, *(f"'{text}" for text in FORMULAS), "''=1"])
def test_a_text_that_begins_a_formula_stands_behind_an_apostrophe(text):
    cell = as_cell(text)
    assert cell.startswith("'")
    assert of_cell(cell) == text


@given(st.text())
def test_no_cell_begins_a_formula_and_each_comes_back(text):
    cell = as_cell(text)
    assert not cell.startswith(("=", "+", "-", "@", "\t", "\r", "\n"))
    assert of_cell(cell) == text


@pytest.mark.parametrize("text", ["car", "a=1", "it's", "'quoted'", "", "1-2", "x@y"])
def test_an_ordinary_text_is_written_as_it_is(text):
    assert as_cell(text) == of_cell(text) == text


@pytest.mark.parametrize("text", [text for text in FORMULAS if text[0] not in "\t\r\n"])
def test_a_table_of_priors_holds_no_formula_and_comes_back(tmp_path, text):
    table = ims.PriorTable(
        [ims.ObjectPrior(text, 1.5, 0.1, aliases=(f"{text}x",), source=text, spans=text)]
    )
    table.to_csv(tmp_path / "a.csv")
    with (tmp_path / "a.csv").open(encoding="utf-8", newline="") as file:
        (row,) = csv.DictReader(file)
    texts = ("label", "aliases", "source", "spans")
    assert [row[name][0] for name in texts] == ["'"] * 4
    assert (float(row["mean_m"]), float(row["std_m"])) == (1.5, 0.1)
    assert ims.PriorTable.from_csv(tmp_path / "a.csv") == table


def photo(folder, name="a.png"):
    Image.new("RGB", (640, 480)).save(folder / name)
    return name


@pytest.mark.parametrize("text", ["=1+1", "-2+3", "@sum(a1)", "+1"])
def test_the_command_writes_no_formula_and_numbers_stay_numbers(tmp_path, monkeypatch, text):
    monkeypatch.chdir(tmp_path)
    name = photo(tmp_path, f"{text}.png")
    words = ["--one-distance", "--box=person=10,20,100,300", f"--box={text}=-0.5,50,300,200"]
    assert main(["measure", "--out", "a.csv", *words, "--", name]) == 0
    with Path("a.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["photo"] for row in rows] == [f"'{name}"] * 2
    assert rows[1]["label"] == f"'{text}"
    assert float(rows[1]["x1"]) == -0.5
    for row in rows:
        assert not [cell for cell in row.values() if re.match(r"[=+@\t\r\n]|-(?!\d)", cell)]


def test_the_command_writes_priors_without_formulas():
    command = [sys.executable, "-m", "imgscale", "priors", "--csv"]
    text = subprocess.run(command, check=True, capture_output=True, encoding="utf-8").stdout
    rows = list(csv.reader(text.splitlines()))
    assert len(rows) > 100
    assert not [cell for row in rows for cell in row if cell.startswith(("=", "+", "-", "@"))]


# --- JSON ---


def measured(label="door", depth=np.nan):
    values = np.full((480, 640), 3.0)
    values[:, 320:] = depth
    boxes = [ims.Detection("person", (10, 20, 100, 300)), ims.Detection(label, (400, 9, 600, 99))]
    return ims.measure(
        np.zeros((480, 640, 3), np.uint8),
        detector=lambda _: boxes,
        depth_source=lambda _: ims.DepthMap(values, kind="metric"),
    )


def test_what_is_not_known_is_null_in_every_json():
    found = measured()
    assert np.isnan(found.estimates[1].size_m)
    for written in (found.to_dict(), found.table(), found.model.to_dict()):
        text = json.dumps(written)
        assert strict(text) == json.loads(json.dumps(written, allow_nan=False))
        assert not re.search(r"\b(NaN|-?Infinity)\b", text)


@pytest.mark.parametrize("label", [*SCRIPTS, "NaN", "\ud800", "\0", "a\u2028b"])
def test_a_record_of_any_label_is_json_lines(tmp_path, label):
    image = photo(tmp_path)
    boxes = [ims.Detection("person", (10, 20, 100, 300)), ims.Detection(label, (400, 9, 600, 99))]
    outcomes = ims.measure_many(
        [tmp_path / image],
        detector=lambda _: boxes,
        depth_source=lambda _: ims.ObjectDepths([3.0, np.nan], kind="relative"),
        record=tmp_path / "a.jsonl",
        progress=False,
    )
    assert [outcome.error for outcome in outcomes] == [None]
    lines = (tmp_path / "a.jsonl").read_text(encoding="ascii").splitlines()
    assert len([strict(line) for line in lines]) == 2
    (row,) = ims.read_record(tmp_path / "a.jsonl")
    assert row["objects"][1]["label"] == label


# --- pages ---


class Elements(HTMLParser):
    """The names of elements and attributes of a page, and where its links lead."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.attributes, self.links = set(), set(), set()
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.attributes |= {name for name, _ in attrs}
        self.links |= {value for name, value in attrs if name in {"href", "src"}}


@pytest.mark.parametrize("text", [*SCRIPTS, *FORMULAS])
def test_a_page_has_no_element_or_attribute_of_a_label_or_title(text):
    pytest.importorskip("matplotlib")
    from imgscale.report import html_page  # noqa: PLC0415 - needs matplotlib

    image = np.zeros((480, 640, 3), np.uint8)
    plain = Elements(html_page([(measured("thing", 4.0), image)], title="Title"))
    hostile = Elements(html_page([(measured(text, 4.0), image)], title=text))
    assert hostile.tags == plain.tags
    assert hostile.attributes == plain.attributes
    assert all(link.startswith(("data:image/", "#")) for link in hostile.links)


@settings(max_examples=20, deadline=None)
@given(st.text(min_size=1, max_size=40).filter(str.strip))
def test_what_a_notebook_shows_has_the_elements_of_any_other_label(text):
    def shown(label):
        return Elements(measured(label, 4.0)._repr_html_())

    hostile, plain = shown(text), shown("thing")
    assert hostile.tags == plain.tags
    assert hostile.attributes == plain.attributes
