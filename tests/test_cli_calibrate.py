"""``imgscale calibrate`` and ``measure --model``: a camera trap, drawn with exact geometry."""

import csv
import json
import math
import os
import statistics
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

import imgscale as ims
from imgscale.cli import main

# --- a pinhole of the test's own: axes x right, y down, z ahead; ground at y = HEIGHT_M ---

WIDTH, HEIGHT = 1600, 900
FOCAL_PX, HEIGHT_M, PITCH = 1200.0, 1.1, math.radians(6.0)
HORIZON = HEIGHT / 2 - FOCAL_PX * math.tan(PITCH)


def seen(right, up, ahead):
    """Column, row and z-depth of a point."""
    down = HEIGHT_M - up
    z = ahead * math.cos(PITCH) + down * math.sin(PITCH)
    y = down * math.cos(PITCH) - ahead * math.sin(PITCH)
    return WIDTH / 2 + FOCAL_PX * right / z, HEIGHT / 2 + FOCAL_PX * y / z, z


def box_of(right, ahead, height, width):
    """Box of a flat upright thing, and the z-depth of its foot."""
    corners = [seen(right + side * width / 2, up, ahead) for side in (-1, 1) for up in (0, height)]
    xs, ys = [c[0] for c in corners], [c[1] for c in corners]
    return (min(xs), min(ys), max(xs), max(ys)), seen(right, 0, ahead)[2]


POLES = [(side * ahead, ahead) for ahead in (4.0, 6.0, 9.0, 13.0) for side in (-0.35, 0.0, 0.35)]
ANIMALS = [  # right, ahead, height, length
    (-1.0, 5.0, 0.45, 0.8), (0.5, 7.0, 0.92, 1.1), (2.0, 8.5, 0.75, 1.2), (-3.0, 11.0, 0.9, 0.7),
]  # fmt: skip


def blank(path, size=(WIDTH, HEIGHT), **options):
    Image.new("RGB", size, "#667755").save(path, **options)


def write_setup(folder, poles=POLES, label="pole", size=(WIDTH, HEIGHT)):
    """Photos of the pole, three a photo, and their annotations in COCO's format."""
    folder.mkdir()
    images, annotations = [], []
    for index, (right, ahead) in enumerate(poles):
        photo = index // 3
        if index % 3 == 0:
            name = f"setup_{photo}.jpg"
            blank(folder / name, size)
            images.append({"id": photo, "file_name": name, "width": size[0], "height": size[1]})
        x1, y1, x2, y2 = box_of(right, ahead, 1.0, 0.08)[0]
        annotations.append(
            {"image_id": photo, "category_id": 1, "bbox": [x1, y1, x2 - x1, y2 - y1]}
        )
    found = {"images": images, "annotations": annotations, "categories": [{"id": 1, "name": label}]}
    (folder.parent / f"{folder.name}.json").write_text(json.dumps(found))


def write_animals(folder):
    """Later photos in two subfolders, and MegaDetector's file without their sizes."""
    entries = []
    for index, (right, ahead, height, length) in enumerate(ANIMALS):
        name = f"card_{index % 2}/IMG_{index}.JPG"
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        blank(folder / name, format="JPEG")
        x1, y1, x2, y2 = box_of(right, ahead, height, length)[0]
        ratios = [x1 / WIDTH, y1 / HEIGHT, (x2 - x1) / WIDTH, (y2 - y1) / HEIGHT]
        junk = {"category": "1", "conf": 0.03, "bbox": [0.1, 0.1, 0.2, 0.2]}
        entries.append(
            {
                "file": name.replace("/", "\\"),  # as Windows writes it
                "detections": [{"category": "1", "conf": 0.9, "bbox": ratios}, junk],
            }
        )
    blank(folder / "card_1/IMG_9.JPG", format="JPEG")
    entries.append({"file": "card_1/IMG_9.JPG", "detections": []})
    entries.append({"file": "deleted.JPG", "detections": [junk]})
    found = {"images": entries, "detection_categories": {"1": "animal"}}
    (folder.parent / f"{folder.name}.json").write_text(json.dumps(found))


@pytest.fixture(scope="module")
def trap(tmp_path_factory):
    """A folder with set-up day, its model, and later photos."""
    folder = tmp_path_factory.mktemp("trap")
    write_setup(folder / "setup")
    write_animals(folder / "photos")
    code = main(
        ["calibrate", str(folder / "setup"), "--detections", str(folder / "setup.json"), "--format",
         "coco", "--reference", "pole=1.0+-0.002", "--focal-px", str(FOCAL_PX), "--focal-rel-std",
         "0.01", "--out", str(folder / "model.json")]
    )  # fmt: skip
    assert code == 0
    return folder


def measure_animals(trap, *more):
    return main(
        ["measure", str(trap / "photos"), "--model", str(trap / "model.json"), "--detections",
         str(trap / "photos.json"), "--format", "megadetector", "--min-score", "0.2", *more]
    )  # fmt: skip


def test_the_model_has_the_drawn_camera(trap):
    model = ims.ScaleModel.from_dict(json.loads((trap / "model.json").read_text()))
    plane = model.plane
    assert plane.camera_height_m == pytest.approx(HEIGHT_M, rel=0.01)
    assert plane.horizon_px == pytest.approx(HORIZON, abs=3)
    assert plane.roll_deg == pytest.approx(0, abs=0.2)
    assert abs(plane.horizon_px - HORIZON) < 2 * plane.horizon_std_px
    assert [ref.used for ref in model.references] == [True] * len(POLES)


def test_the_model_is_that_of_one_fit_to_all_photos(trap):
    boxes = [ims.Detection("pole", box_of(*place, 1.0, 0.08)[0]) for place in POLES]
    pole = ims.ObjectPrior("pole", 1.0, 0.0, mean_std_m=0.002, source="--reference pole=1.0+-0.002")
    theirs = ims.fit(
        boxes,
        ims.GroundPlane(image_size=(WIDTH, HEIGHT)),
        ims.PriorTable.default().with_prior(pole),
        camera=ims.Camera(FOCAL_PX, focal_rel_std=0.01, image_size=(WIDTH, HEIGHT)),
    )
    ours = ims.ScaleModel.from_dict(json.loads((trap / "model.json").read_text()))
    assert ours.k == pytest.approx(theirs.k, rel=1e-9)
    assert ours.k_std == pytest.approx(theirs.k_std, rel=1e-9)
    assert ours.priors == theirs.priors


def test_every_animal_gets_its_height_and_its_distance(trap, tmp_path):
    out = tmp_path / "animals.csv"
    assert measure_animals(trap, "--out", str(out)) == 0
    with out.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["label"] for row in rows] == ["animal"] * len(ANIMALS)
    by_number = {int(row["photo"].rpartition("_")[2][0]): row for row in rows}
    errors = []
    for index, (right, ahead, height, length) in enumerate(ANIMALS):
        row = by_number[index]
        z = box_of(right, ahead, height, length)[1]
        assert float(row["low_m"]) < height < float(row["high_m"])
        assert float(row["distance_m"]) == pytest.approx(z, rel=0.03)
        errors.append(abs(float(row["size_m"]) / height - 1))
    assert statistics.median(errors) < 0.01
    assert max(errors) < 0.03


def test_the_numbers_are_those_of_predict(trap, tmp_path):
    out = tmp_path / "animals.json"
    assert measure_animals(trap, "--out", str(out)) == 0
    model = ims.ScaleModel.from_dict(json.loads((trap / "model.json").read_text()))
    records = {
        record["name"].rpartition("IMG_")[2]: record for record in json.loads(out.read_text())
    }
    assert set(records) == {"0.JPG", "1.JPG", "2.JPG", "3.JPG", "9.JPG"}
    assert records["9.JPG"]["objects"] == []
    for index, animal in enumerate(ANIMALS):
        detection = ims.Detection("animal", box_of(*animal)[0], score=0.9)
        [theirs] = ims.predict(model, [detection])
        [ours] = records[f"{index}.JPG"]["objects"]
        assert ours["size_m"] == pytest.approx(theirs.size_m, rel=1e-9)
        assert ours["distance_m"] == pytest.approx(theirs.distance_m, rel=1e-9)


def test_the_text_tells_the_scale_once_and_every_photo(trap, capsys):
    assert measure_animals(trap, "--unit", "cm", "--level", "0.95") == 0
    text = capsys.readouterr().out
    assert text.count("camera height)") == 1
    assert text.count("95 % interval") == len(ANIMALS)
    assert text.count("IMG_") == len(ANIMALS) + 1
    assert text.splitlines()[-1] == "nothing"


def test_what_was_found_is_told_with_errors(trap, tmp_path, capsys):
    setup = [str(trap / "setup"), "--detections", str(trap / "setup.json"), "--format", "coco"]
    out = tmp_path / "m.json"
    assert main(["calibrate", *setup, "--reference", "pole=100cm", "--out", str(out)]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    lines = captured.out.splitlines()
    [height] = [line for line in lines if line.startswith("camera height")]
    value, error = (float(word) for word in height.split()[2:5:2])
    assert abs(value - HEIGHT_M) < 3 * error
    assert "no focal length" in captured.out
    assert sum(line.startswith("setup_") for line in lines) == len(POLES)
    assert lines[-1] == f"wrote {out}"


def test_a_pole_that_leans_is_named(tmp_path, capsys):
    poles = [*POLES[:5], (0.3, 6.5)]
    write_setup(tmp_path / "leaning", poles)
    found = json.loads((tmp_path / "leaning.json").read_text())
    x, y, width, height = found["annotations"][5]["bbox"]
    found["annotations"][5]["bbox"] = [x, y + height / 3, width, height * 2 / 3]
    (tmp_path / "leaning.json").write_text(json.dumps(found))
    code = main(
        ["calibrate", str(tmp_path / "leaning"), "--detections", str(tmp_path / "leaning.json"),
         "--format", "coco", "--reference", "pole=1.0", "--out", str(tmp_path / "m.json")]
    )  # fmt: skip
    assert code == 0
    text = capsys.readouterr().out
    assert [line for line in text.splitlines() if "not used: outlier" in line] == [
        line for line in text.splitlines() if line.startswith("setup_1.jpg")
    ][-1:]


def test_only_references_that_were_told_count(trap, tmp_path):
    # a child who carries the pole: as a "person" of the table it would be far off
    found = json.loads((trap / "setup.json").read_text())
    found["categories"].append({"id": 2, "name": "person"})
    for index, (right, ahead) in enumerate(POLES):
        x1, y1, x2, y2 = box_of(right + 0.3, ahead, 1.2, 0.4)[0]
        found["annotations"].append(
            {"image_id": index // 3, "category_id": 2, "bbox": [x1, y1, x2 - x1, y2 - y1]}
        )
    (tmp_path / "both.json").write_text(json.dumps(found))
    setup = ["calibrate", str(trap / "setup"), "--detections", str(tmp_path / "both.json"),
             "--format", "coco", "--out", str(tmp_path / "m.json")]  # fmt: skip
    assert main([*setup, "--reference", "pole=1.0"]) == 0
    model = ims.ScaleModel.from_dict(json.loads((tmp_path / "m.json").read_text()))
    assert {ref.label for ref in model.references} == {"pole"}
    assert main(setup) == 0  # without a reference, whatever the table knows
    model = ims.ScaleModel.from_dict(json.loads((tmp_path / "m.json").read_text()))
    assert {ref.label for ref in model.references if ref.used} == {"person"}


def test_one_pole_alone_is_taken_with_reservations(tmp_path, capsys):
    blank(tmp_path / "a.jpg")
    box = ",".join(str(number) for number in box_of(0.0, 6.0, 1.0, 0.08)[0])
    words = ["calibrate", str(tmp_path / "a.jpg"), "--box", f"pole={box}", "--reference", "pole=1"]
    assert main([*words, "--out", str(tmp_path / "m.json")]) == 0
    text = capsys.readouterr().out
    assert "reservations: SINGLE_REFERENCE ASSUMED_HORIZON" in text
    assert "show a reference near and far" in text
    assert main([*words, "--horizon", str(HORIZON), "--out", str(tmp_path / "m.json")]) == 0
    assert "ASSUMED_HORIZON" not in capsys.readouterr().out
    model = ims.ScaleModel.from_dict(json.loads((tmp_path / "m.json").read_text()))
    assert model.camera_height_m == pytest.approx(HEIGHT_M, rel=0.05)


def exif(focal_mm):
    record = Image.Exif()
    record[0x8769] = {0xA405: focal_mm}
    return record


def test_the_focal_length_comes_from_exif_and_must_be_one(tmp_path, capsys):
    write_setup(tmp_path / "setup")
    for photo in (tmp_path / "setup").iterdir():
        blank(photo, exif=exif(28))
    arguments = calibrate_arguments(tmp_path, "--reference", "pole=1")
    assert main(arguments) == 0
    model = ims.ScaleModel.from_dict(json.loads((tmp_path / "m.json").read_text()))
    assert model.camera.focal_px == pytest.approx(
        28 * math.hypot(WIDTH, HEIGHT) / math.hypot(36, 24)
    )
    assert main([*arguments, "--no-exif"]) == 0
    assert ims.ScaleModel.from_dict(json.loads((tmp_path / "m.json").read_text())).camera is None
    blank(tmp_path / "setup" / "setup_2.jpg", exif=exif(50))
    capsys.readouterr()
    assert main(arguments) == 2
    assert "must all be taken with one focal length" in capsys.readouterr().err


def error_of(capsys, *arguments, code):
    assert main(list(arguments)) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    return captured.err


def calibrate_arguments(folder, *more):
    return ["calibrate", str(folder / "setup"), "--detections", str(folder / "setup.json"),
            "--format", "coco", "--out", str(folder / "m.json"), *more]  # fmt: skip


def test_photos_of_two_sizes_are_refused(tmp_path, capsys):
    write_setup(tmp_path / "setup")
    blank(tmp_path / "setup" / "setup_1.jpg", (800, 450))
    found = json.loads((tmp_path / "setup.json").read_text())
    for entry in found["images"]:
        del entry["width"], entry["height"]
    (tmp_path / "setup.json").write_text(json.dumps(found))
    error = error_of(capsys, *calibrate_arguments(tmp_path, "--reference", "pole=1.0"), code=2)
    assert "must all be of one size" in error
    assert error.count("\n") == 1


def test_every_broken_set_up_photo_is_named_and_no_model_written(tmp_path, capsys):
    write_setup(tmp_path / "setup")
    for number in (0, 2):
        (tmp_path / "setup" / f"setup_{number}.jpg").write_bytes(b"no picture")
    error = error_of(capsys, *calibrate_arguments(tmp_path, "--reference", "pole=1.0"), code=1)
    assert [line.count("setup_0.jpg") > 0 for line in error.splitlines()] == [True, False, False]
    assert "2 of 4 set-up photos could not be read; no model was written." in error
    assert not (tmp_path / "m.json").exists()


def test_of_set_up_photos_the_size_alone_is_read(tmp_path):
    write_setup(tmp_path / "setup")
    for path in (tmp_path / "setup").iterdir():
        path.write_bytes(path.read_bytes()[:900])  # the header, and no whole pixels
    assert main(calibrate_arguments(tmp_path, "--reference", "pole=1.0")) == 0


def test_nothing_of_known_size_is_told(tmp_path, capsys):
    write_setup(tmp_path / "setup", label="thing of mine")
    error = error_of(capsys, *calibrate_arguments(tmp_path), code=1)
    assert '--reference "LABEL=SIZE"' in error
    error = error_of(capsys, *calibrate_arguments(tmp_path, "--reference", "pole=1"), code=2)
    assert error.startswith('imgscale: --reference "pole" must be something that was detected; ')
    assert error.endswith("there is thing of mine.\n")


def test_a_photo_of_another_size_does_not_stop_the_others(trap, tmp_path, capsys):
    write_animals(tmp_path / "photos")
    blank(tmp_path / "photos/card_0/IMG_0.JPG", (800, 600), format="JPEG")
    code = main(
        ["measure", str(tmp_path / "photos"), "--model", str(trap / "model.json"), "--detections",
         str(tmp_path / "photos.json"), "--format", "megadetector", "--min-score", "0.2"]
    )  # fmt: skip
    captured = capsys.readouterr()
    assert code == 1
    assert captured.out.count("animal ") == len(ANIMALS) - 1
    [line] = captured.err.splitlines()
    assert "IMG_0.JPG: " in line
    assert "1600 x 900 px; got 800 x 600" in line


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[]", "is none."),
        ("{", "must hold JSON; got: Expecting property name"),
        ("{}", "must have schema"),
        ("[" * 100_000, "must hold JSON; got: "),
        (None, "No such file"),
    ],
)
def test_what_is_no_model_is_refused(trap, tmp_path, capsys, content, message):
    path = tmp_path / "model.json"
    if content is not None:
        path.write_text(content)
    error = error_of(
        capsys, "measure", str(trap / "photos"), "--model", str(path), "--detections",
        str(trap / "photos.json"), "--format", "megadetector", code=2,
    )  # fmt: skip
    assert "--model must be a file of `imgscale calibrate`" in error
    assert message in error


@pytest.mark.parametrize(
    "error", [KeyError("k"), IndexError, OverflowError, RecursionError, AttributeError("x")]
)
def test_a_model_file_that_breaks_its_reader_is_refused(trap, monkeypatch, capsys, error):
    def broken(_):
        raise error

    monkeypatch.setattr(ims.ScaleModel, "from_dict", broken)
    told = error_of(
        capsys, "measure", str(trap / "photos"), "--model", str(trap / "model.json"),
        "--detections", str(trap / "photos.json"), "--format", "megadetector", code=2,
    )  # fmt: skip
    assert told.startswith(
        f"imgscale: --model must be a file of `imgscale calibrate`; {trap / 'model.json'} is none"
    )
    assert told.count("\n") == 1


@pytest.mark.skipif(os.name != "posix", reason="pipes of POSIX")
@pytest.mark.parametrize("command", ["calibrate", "demo"])
def test_a_reader_that_goes_away_does_not_cost_the_file(tmp_path, command):
    if command == "demo":
        pytest.importorskip("matplotlib", reason="matplotlib is not installed")
        words, out = ["demo", "--out", str(tmp_path / "demo.png")], tmp_path / "demo.png"
    else:
        write_setup(tmp_path / "setup")
        words, out = calibrate_arguments(tmp_path, "--reference", "pole=1"), tmp_path / "m.json"
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as gone:
        done = subprocess.run(
            [sys.executable, "-m", "imgscale", *words],
            stdout=gone, stderr=subprocess.PIPE, text=True, check=False, timeout=120,
        )  # fmt: skip
    assert (done.returncode, done.stderr) == (141, "")
    assert out.stat().st_size


def test_a_model_of_a_depth_map_is_refused(trap, tmp_path, capsys):
    doors = [ims.Detection("door", (100, 50, 180, 250))]
    model = ims.fit(doors, ims.DepthMap(np.full((480, 640), 4.0), kind="metric"))
    (tmp_path / "model.json").write_text(json.dumps(model.to_dict()))
    error = error_of(
        capsys, "measure", str(trap / "photos"), "--model", str(tmp_path / "model.json"),
        "--detections", str(trap / "photos.json"), "--format", "megadetector", code=2,
    )  # fmt: skip
    assert 'of depth of kind "metric"' in error


@pytest.mark.parametrize(
    "more",
    [
        ["--reference", "pole=1.0"], ["--focal-px", "1000"], ["--method", "robust"],
        ["--camera-height", "1"], ["--box-std-px", "2"], ["--region", "eu"], ["--no-exif"],
    ],
    ids=lambda more: more[0],
)  # fmt: skip
def test_what_the_model_has_decided_cannot_be_told_again(trap, capsys, more):
    arguments = ["measure", str(trap / "photos"), "--model", str(trap / "model.json"),
                 "--detections", str(trap / "photos.json"), "--format", "megadetector"]  # fmt: skip
    error = error_of(capsys, *arguments, *more, code=2)
    assert error.startswith(f"imgscale: {more[0]} must be left out with --model")
