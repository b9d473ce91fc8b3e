"""``imgscale measure --out``: what is written, where, and never over what it is made from."""

import csv
import json
import os
import re
import stat
import sys
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

import imgscale as ims
from imgscale.cli import main
from imgscale.cli._outputs import columns

DOOR, CRATE = (100, 48, 180, 240), (320, 120, 400, 216)


def photo(path, size=(640, 480)):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", size, "#667755").save(path)
    return path


def measure_arguments(path, *labels):
    words = ["measure", str(path), "--ground-plane"]
    for label, box in zip(labels or ("door", "crate"), (DOOR, CRATE), strict=True):
        words.append(f"--box={label}={','.join(map(str, box))}")
    return words


def several(folder, names):
    """Photos with a door each, and the arguments that measure them."""
    for name in names:
        photo(folder / "in" / name)
    dataset = {
        "images": [{"id": i, "file_name": name} for i, name in enumerate(names)],
        "categories": [{"id": 1, "name": "door"}],
        "annotations": [
            {"image_id": i, "category_id": 1, "bbox": [100, 48, 80, 192]} for i in range(len(names))
        ],
    }
    (folder / "found.json").write_text(json.dumps(dataset))
    return ["measure", str(folder / "in"), "--ground-plane", "--detections",
            str(folder / "found.json"), "--format", "coco"]  # fmt: skip


def python_api(labels=("door", "crate")):
    boxes = [ims.Detection(label, box) for label, box in zip(labels, (DOOR, CRATE), strict=True)]
    return ims.measure(
        np.zeros((480, 640, 3), dtype=np.uint8),
        detector=lambda _: boxes,
        depth_source=lambda _: ims.GroundPlane(image_size=(640, 480)),
    )


def read_csv(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


# --- numbers ---


@pytest.mark.parametrize(("unit", "level"), [("m", 0.9), ("cm", 0.5), ("ft", 0.99)])
def test_the_table_read_back_is_what_python_gives(tmp_path, unit, level):
    out = tmp_path / "sizes.csv"
    words = [*measure_arguments(photo(tmp_path / "a.jpg")), "--out", str(out)]
    assert main([*words, "--unit", unit, "--level", str(level)]) == 0
    rows = read_csv(out)
    assert tuple(rows[0]) == columns(unit)
    theirs = python_api().table(unit=unit, level=level)
    for ours, row in zip(rows, theirs, strict=True):
        assert ours.pop("photo") == str(tmp_path / "a.jpg")
        assert ours.keys() == row.keys()
        for name, value in row.items():
            expected = "" if value is None else value
            assert (float(ours[name]) if isinstance(expected, float) else ours[name]) == expected


def test_the_record_read_back_is_what_python_gives(tmp_path):
    out = tmp_path / "sizes.json"
    assert main([*measure_arguments(photo(tmp_path / "a.jpg")), "--out", str(out)]) == 0
    [record] = json.loads(out.read_text(encoding="utf-8"))
    theirs = json.loads(json.dumps(python_api().to_dict()))
    assert record.pop("level") == 0.9
    assert record == theirs | {"name": str(tmp_path / "a.jpg")}
    assert ims.ScaleModel.from_dict(record["model"]) == python_api().model


def test_records_follow_unit_and_level(tmp_path):
    out = tmp_path / "sizes.json"
    words = measure_arguments(photo(tmp_path / "a.jpg"))
    assert main([*words, "--unit", "in", "--level", "0.5", "--out", str(out)]) == 0
    [record] = json.loads(out.read_text(encoding="utf-8"))
    assert record["objects"] == python_api().table(unit="in", level=0.5)


def test_what_is_not_known_is_an_empty_cell(tmp_path):
    depth = np.full((480, 640), np.nan)
    depth[:, :200] = 3.0
    np.save(tmp_path / "d.npy", depth)
    words = measure_arguments(photo(tmp_path / "a.jpg"))
    words[2:3] = ["--depth", str(tmp_path / "d.npy"), "--kind", "relative"]
    outs = [tmp_path / "sizes.csv", tmp_path / "sizes.json"]
    assert main([*words, "--out", str(outs[0]), "--out", str(outs[1])]) == 0
    crate = read_csv(outs[0])[1]
    assert [crate[name] for name in ("size_m", "low_m", "high_m", "distance_m")] == [""] * 4
    assert crate["flags"] == "NO_DEPTH"
    assert "NaN" not in outs[1].read_text()


@pytest.mark.parametrize(
    "label",
    ["=1+1", "+1", "-x", "@sum", "=cmd|' /C calc'!A0", "\uff1d1", "\uff0b1", "\uff0dx", "\uff20s"],
)
def test_a_label_never_becomes_a_formula(tmp_path, label):
    out = tmp_path / "sizes.csv"
    words = measure_arguments(photo(tmp_path / "a.jpg"), "door", label)
    assert main([*words, "--out", str(out)]) == 0
    assert read_csv(out)[1]["label"] == f"'{label}"


def test_labels_of_any_language_and_with_commas_survive(tmp_path):
    out = tmp_path / "sizes.csv"
    words = measure_arguments(photo(tmp_path / "a.jpg"), "door", 'Größe, "außen"')
    assert main([*words, "--out", str(out)]) == 0
    assert read_csv(out)[1]["label"] == 'Größe, "außen"'


def test_coordinates_left_of_the_photo_stay_numbers(tmp_path):
    out = tmp_path / "sizes.csv"
    words = [*measure_arguments(photo(tmp_path / "a.jpg")), "--box", "thing=-0.5,10,40,90"]
    assert main([*words, "--out", str(out)]) == 0
    assert float(read_csv(out)[2]["x1"]) == -0.5


# --- pictures and pages ---


def test_the_picture_shows_the_photo_with_its_sizes(tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    out = tmp_path / "sizes.png"
    assert main([*measure_arguments(photo(tmp_path / "a.jpg")), "--out", str(out)]) == 0
    with Image.open(out) as picture:
        assert picture.format == "PNG"
        assert picture.width / picture.height == pytest.approx(640 / 480, rel=0.01)
        pixels = np.asarray(picture.convert("RGB"), dtype=np.float64)
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 20  # boxes and words on one colour


def test_several_photos_give_a_picture_each_named_after_it(tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    words = several(tmp_path, ["1/x.jpg", "2/x.jpg"])
    assert main([*words, "--out", str(tmp_path / "sizes.png")]) == 0
    names = {path.name for path in tmp_path.glob("*.png")}
    assert names == {"sizes_1_x.png", "sizes_2_x.png"}


def test_pictures_that_would_have_one_name_are_an_error(tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    words = several(tmp_path, ["x.jpg", "x.png"])
    assert main([*words, "--out", str(tmp_path / "sizes.png")]) == 2
    assert "must tell" in capsys.readouterr().err


def test_pictures_do_not_go_among_the_photos(tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    words = several(tmp_path, ["1/x.jpg", "2/x.jpg"])
    assert main([*words, "--out", str(tmp_path / "in" / "sizes.png")]) == 2
    assert "whose photos are measured" in capsys.readouterr().err


class Loads(HTMLParser):
    """What a page would ask for."""

    def __init__(self):
        super().__init__()
        self.found = []

    def handle_starttag(self, _, attributes):
        self.found += [value for name, value in attributes if name in ("src", "href", "srcset")]


def test_the_page_holds_every_photo_and_asks_for_nothing(tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    words = several(tmp_path, ["a.jpg", "b.jpg"])
    out = tmp_path / "sizes.html"
    assert main([*words, "--unit", "cm", "--out", str(out)]) == 0
    text = out.read_text(encoding="utf-8")
    page = Loads()
    page.feed(text)
    assert all(value.startswith(("data:", "#")) for value in page.found)
    assert sum(value.startswith("data:image") for value in page.found) >= 2
    assert "a.jpg" in text
    assert "b.jpg" in text
    assert re.search(r"\d cm", text)


# --- files ---


def test_several_outs_are_all_written_and_nothing_is_printed(tmp_path, capsys):
    outs = [tmp_path / "a.csv", tmp_path / "a.json", tmp_path / "b.csv"]
    words = measure_arguments(photo(tmp_path / "a.jpg"))
    assert main([*words, *(word for out in outs for word in ("--out", str(out)))]) == 0
    assert all(out.stat().st_size for out in outs)
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "")
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "a.csv", "a.jpg", "a.json", "b.csv",
    ]  # fmt: skip


def test_files_have_the_rights_that_new_files_have(tmp_path):
    (tmp_path / "plain").touch()
    words = measure_arguments(photo(tmp_path / "a.jpg"))
    assert main([*words, "--out", str(tmp_path / "a.csv")]) == 0
    rights = [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("plain", "a.csv")]
    assert rights[0] == rights[1]


def test_an_old_result_stays_where_nothing_could_be_measured(tmp_path, capsys):
    out = tmp_path / "sizes.csv"
    out.write_text("old")
    words = measure_arguments(photo(tmp_path / "a.jpg"), "thing", "other thing")
    assert main([*words, "--out", str(out)]) == 1
    assert out.read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 2
    assert "--reference" in capsys.readouterr().err


def test_a_result_takes_the_place_of_an_old_one_when_it_is_whole(tmp_path, monkeypatch):
    out = tmp_path / "sizes.csv"
    out.write_text("old")
    seen = []
    real = ims.Measurement.table

    def table(*arguments, **options):
        seen.append(out.read_text())
        return real(*arguments, **options)

    monkeypatch.setattr(ims.Measurement, "table", table)
    words = several(tmp_path, ["a.jpg", "b.jpg"])
    assert main([*words, "--out", str(out)]) == 0
    assert seen == ["old", "old"]
    assert len(read_csv(out)) == 2


def test_a_full_disk_leaves_nothing_half_done(tmp_path, monkeypatch, capsys):
    def full(*_):
        msg = "No space left on device"
        raise OSError(28, msg)

    words = measure_arguments(photo(tmp_path / "a.jpg"))
    monkeypatch.setattr("imgscale.cli._outputs.JsonWriter._put", full)
    outs = ["--out", str(tmp_path / "sizes.json"), "--out", str(tmp_path / "sizes.csv")]
    assert main([*words, *outs]) == 1
    error = f"imgscale: {tmp_path / 'sizes.json'}: No space left on device\n"
    assert capsys.readouterr().err == error
    assert [path.name for path in tmp_path.iterdir()] == ["a.jpg"]


def test_what_cannot_be_written_of_one_photo_costs_that_photo_alone(tmp_path, monkeypatch, capsys):
    real = ims.Measurement.to_dict

    def broken(measurement):
        if measurement.name.endswith("b.jpg"):
            raise ZeroDivisionError
        return real(measurement)

    words = several(tmp_path, ["a.jpg", "b.jpg", "c.jpg"])
    monkeypatch.setattr(ims.Measurement, "to_dict", broken)
    for name in ("s.csv", "s.json"):
        words += ["--out", str(tmp_path / name)]
    assert main(words) == 1
    error = f"imgscale: {tmp_path / 'in' / 'b.jpg'}: ZeroDivisionError\n"
    assert capsys.readouterr().err == error
    in_csv = [row["photo"] for row in read_csv(tmp_path / "s.csv")]
    in_json = [record["name"] for record in json.loads((tmp_path / "s.json").read_text())]
    assert in_csv == in_json == [str(tmp_path / "in" / name) for name in ("a.jpg", "c.jpg")]


@pytest.mark.parametrize(("error", "code"), [(KeyboardInterrupt, 130), (ZeroDivisionError, 1)])
def test_a_page_that_comes_to_nothing_does_not_cost_the_others(
    tmp_path, monkeypatch, capsys, error, code
):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")

    def broken(*_, **__):
        raise error

    monkeypatch.setattr("imgscale.report.html_page", broken)
    words = measure_arguments(photo(tmp_path / "a.jpg"))
    for name in ("s.html", "s.csv", "s.json"):
        words += ["--out", str(tmp_path / name)]
    assert main(words) == code
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.jpg", "s.csv", "s.json"]
    assert capsys.readouterr().err.count("imgscale: ") == (error is ZeroDivisionError)


# a byte that is no UTF-8, as Python hands such names on
@pytest.mark.skipif(sys.platform != "linux", reason="file names of any bytes")
@pytest.mark.parametrize("out", ["s.csv", "s.json", "s.html", "s.png", None])
def test_names_that_are_no_text_are_written_as_escapes(tmp_path, capsys, out):
    if out in ("s.html", "s.png"):
        pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    words = measure_arguments(photo(tmp_path / "a\udcff.jpg"), "door", "crate\ud800")
    more = [] if out is None else ["--out", str(tmp_path / out)]
    assert main([*words, *more]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    text = (tmp_path / out).read_bytes() if out else captured.out.encode()
    if out != "s.png":
        assert b"a\\udcff.jpg" in text
        assert b"crate\\ud800" in text


def test_a_result_through_a_link_goes_where_that_leads(tmp_path):
    (tmp_path / "far").mkdir()
    link = tmp_path / "sizes.csv"
    link.symlink_to(tmp_path / "far" / "there.csv")
    assert main([*measure_arguments(photo(tmp_path / "a.jpg")), "--out", str(link)]) == 0
    assert link.is_symlink()
    assert len(read_csv(tmp_path / "far" / "there.csv")) == 2


def test_a_picture_does_not_go_beside_the_only_photo_of_a_folder(tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    words = several(tmp_path, ["a.jpg"])
    assert main([*words, "--out", str(tmp_path / "in" / "sizes.png")]) == 2
    assert "whose photos are measured" in capsys.readouterr().err


@pytest.mark.parametrize("out", ["a.png", "a.html"])
def test_without_matplotlib_it_is_told_before_the_work(tmp_path, monkeypatch, capsys, out):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    words = [*measure_arguments(photo(tmp_path / "x.jpg")), "--out", str(tmp_path / "b.csv")]
    assert main([*words, "--out", str(tmp_path / out)]) == 1
    assert "install it with `pip install 'imgscale[plot]'`" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["x.jpg"]


@pytest.mark.parametrize(
    ("out", "message"),
    [
        ("a.xlsx", "must end in .csv or .json or .png or .html; got"),
        ("none", "must end in"),
        ("no/such/a.csv", "must be in a folder that exists; there is no"),
        ("folder.csv", "is a folder"),
        ("a.jpg/x.csv", "must be in a folder that exists"),
        ("depth.png", "must not be an input"),
        ("link.csv", "must not be an input"),
    ],
)
def test_where_nothing_can_be_written_is_told_before_the_work(tmp_path, capsys, out, message):
    if out.endswith(".png"):
        pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    photo(tmp_path / "a.jpg")
    Image.fromarray(np.full((480, 640), 4000, np.uint16)).save(tmp_path / "depth.png")
    (tmp_path / "folder.csv").mkdir()
    os.link(tmp_path / "a.jpg", tmp_path / "link.csv")
    before = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    words = measure_arguments(tmp_path / "a.jpg")
    words[2:3] = ["--depth", str(tmp_path / "depth.png"), "--kind", "metric", "--scale", "1000"]
    assert main([*words, "--out", str(tmp_path / out)]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith("imgscale: --out ")
    assert message in line
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == before


def test_photos_and_detections_are_never_overwritten(tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    photo(tmp_path / "a.png")
    words = measure_arguments(tmp_path / "a.png")
    assert main([*words, "--out", str(tmp_path / "a.png")]) == 2
    words = several(tmp_path, ["a.jpg"])
    assert main([*words, "--out", str(tmp_path / "found.json")]) == 2
    assert capsys.readouterr().err.count("must not be an input") == 2


def test_one_file_for_two_results_is_an_error(tmp_path, capsys):
    words = measure_arguments(photo(tmp_path / "a.jpg"))
    twice = ["--out", str(tmp_path / "x.csv"), "--out", str(tmp_path / "." / "x.csv")]
    assert main([*words, *twice]) == 2
    assert "must name each file once" in capsys.readouterr().err
