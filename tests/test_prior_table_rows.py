"""Every row of the shipped prior table, and the table as a whole."""

import csv
import io
import math
import re
from collections import defaultdict
from importlib.resources import files

import pytest

COLUMNS = [
    "label",
    "aliases",
    "axis",
    "mean_m",
    "std_m",
    "mean_std_m",
    "on_ground",
    "depth_extent_m",
    "share",
    "region",
    "source",
    "year",
    "n",
    "spans",
]

# A web address, a repository path, a standard, a data set, or a size code computed.
CITATION = re.compile(
    r"[\w-]+\.(com|org|net|gov|edu|info|art|app|dev|co\.uk|gov\.uk|org\.uk|de|at|eu|"
    r"ca|cn|in|site|hk|jp|es|us|za|ltd|hr|nl|io|am|edu\.hk|or\.jp|com\.br|co\.za|ee|"
    r"ru|army\.mil)\b"
    r"|\b[A-Za-z][\w.-]+/[A-Za-z][\w.-]+"
    r"|\b(ISO|EN|IEC|MUTCD|ITTF|FIVB) ?\d*\b"
    r"|\b(ANSUR II|NCD-RisC|CDC|SUN RGB-D|ScanNet|nuScenes|Argoverse 2|Waymo|Lyft)\b"
    r"|\bpubmed \d+|\bInt\. Agrophys\. \d+|\bby definition\b"
    r"|\bcomputed from (the size codes|six size codes|seven size codes|bead)\b"
)


def read_table():
    path = files("imgscale") / "tables" / "priors_2026_11.csv"
    text = path.read_text(encoding="utf-8")
    assert "\r" not in text
    return list(csv.DictReader(io.StringIO(text), strict=True))


ROWS = read_table()


def row_id(row):
    return f"{row['label']}/{row['axis']}/{row['region']}"


def select(label, axis, region="world"):
    return [
        row for row in ROWS if (row["label"], row["axis"], row["region"]) == (label, axis, region)
    ]


def only_mean(label, axis, region="world"):
    (row,) = select(label, axis, region)
    return float(row["mean_m"])


def aliases_of(row):
    return [name for name in row["aliases"].split("; ") if name]


def normal(name):
    return re.sub(r"[_-]", " ", name.casefold())


@pytest.mark.parametrize("row", ROWS, ids=row_id)
def test_row(row):
    assert list(row) == COLUMNS
    assert all(isinstance(value, str) for value in row.values())

    mean, std, mean_std, share = (
        float(row[name]) for name in ("mean_m", "std_m", "mean_std_m", "share")
    )
    assert all(math.isfinite(value) for value in (mean, std, mean_std, share))
    assert 0.004 <= mean <= 30
    assert std > 0
    assert 0.0001 <= std / mean <= 1.3
    assert 0 <= mean_std <= mean / 2
    assert 0 < share <= 1
    if row["depth_extent_m"]:
        assert 0 < float(row["depth_extent_m"]) <= 40

    assert row["axis"] in {"height", "width", "diameter"}
    assert row["region"] in {"world", "eu", "us"}
    assert row["on_ground"] in {"true", "false"}
    if row["year"]:
        assert 1950 <= int(row["year"]) <= 2026
    if row["n"]:
        assert int(row["n"]) >= 1

    for name in [row["label"], *aliases_of(row)]:
        assert name == normal(name)
        assert name == " ".join(name.split())
        assert name

    assert row["spans"].strip()
    assert "kitti" not in row["source"].casefold()
    if row["source"].startswith("nominal"):
        assert std / mean >= 0.02 or "definition" in row["source"]
    else:
        assert CITATION.search(row["source"]), row["source"]


def test_size_of_the_table():
    assert len(ROWS) >= 150
    assert len({row["label"] for row in ROWS}) >= 120


def test_shares_sum_to_one():
    total = defaultdict(float)
    for row in ROWS:
        total[row["label"], row["axis"], row["region"]] += float(row["share"])
    wrong = {key: value for key, value in total.items() if abs(value - 1) > 1e-9}
    assert not wrong


def test_every_label_and_axis_has_a_world_row():
    everywhere = {(row["label"], row["axis"]) for row in ROWS}
    world = {(r["label"], r["axis"]) for r in ROWS if r["region"] == "world"}
    assert everywhere == world


def test_a_name_means_one_label():
    labels = {row["label"] for row in ROWS}
    owners = defaultdict(set)
    for row in ROWS:
        names = aliases_of(row)
        assert len(names) == len(set(names))
        for name in names:
            owners[name].add(row["label"])
    assert not labels & set(owners)
    assert not {name: own for name, own in owners.items() if len(own) > 1}


def test_rows_of_a_label_have_the_same_aliases():
    aliases = defaultdict(set)
    for row in ROWS:
        aliases[row["label"]].add(row["aliases"])
    assert not {label: found for label, found in aliases.items() if len(found) > 1}


def test_no_row_stands_twice():
    keys = [(row_id(row), row["mean_m"], row["spans"]) for row in ROWS]
    assert len(keys) == len(set(keys))


@pytest.mark.parametrize(
    "name",
    ["train", "car", "person", "traffic signal", "truck", "wheel", "pedestrian"],
)
def test_the_common_names_are_found(name):
    known = {row["label"] for row in ROWS}
    known |= {alias for row in ROWS for alias in aliases_of(row)}
    assert name in known


@pytest.mark.parametrize(
    ("label", "axis", "expected"),
    [
        ("id card", "diameter", 0.0856),
        ("a4 sheet", "diameter", 0.297),
        ("20 foot container", "height", 2.591),
        ("tennis ball", "diameter", 0.067),
        ("table tennis ball", "diameter", 0.040),
        ("us quarter", "diameter", 0.02426),
        ("1 euro coin", "diameter", 0.02325),
        ("iris", "diameter", 0.0117),
        ("compact disc", "diameter", 0.120),
        ("eur pallet", "height", 0.144),
    ],
)
def test_well_known_size(label, axis, expected):
    assert only_mean(label, axis) == pytest.approx(expected, rel=1e-3)


def test_basketball_has_its_legal_circumference():
    assert 0.749 <= math.pi * only_mean("basketball", "diameter") <= 0.78


def test_a_common_tyre_by_its_code_is_within_the_spread():
    diameter = (25.4 * 16 + 2 * 205 * 0.55) / 1000  # 205/55R16
    for region in ("world", "eu"):
        (row,) = select("car tire", "diameter", region)
        assert abs(diameter - float(row["mean_m"])) <= float(row["std_m"])


def test_a_region_replaces_the_world():
    assert only_mean("licence plate", "width", "eu") == 0.52
    assert only_mean("licence plate", "width", "us") == 0.3048
    eu, world, us = (only_mean("car", "height", r) for r in ("eu", "world", "us"))
    assert eu < world < us


@pytest.mark.parametrize("region", ["world", "eu", "us"])
def test_a_person_is_mostly_a_standing_adult(region):
    rows = sorted(select("person", "height", region), key=lambda r: -float(r["share"]))
    assert float(rows[0]["share"]) >= 0.7
    assert 1.6 < float(rows[0]["mean_m"]) < 1.8
    assert all(float(row["mean_m"]) < 1.5 for row in rows[1:])
