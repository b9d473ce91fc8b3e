"""The examples run as they are, and find what was drawn."""

import contextlib
import csv
import io
import json
import os
import runpy
import statistics
import subprocess
import sys
from pathlib import Path

import pytest

import imgscale as ims

EXAMPLES = Path(__file__).parents[1] / "examples"


def run_in_process(name, output):
    """Run an example with a file to write to; its variables and what it printed."""
    printed = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(printed):
        patch.syspath_prepend(EXAMPLES)
        patch.setattr(sys, "argv", [name, str(output)])
        found = runpy.run_path(str(EXAMPLES / name))
    return found, printed.getvalue()


@pytest.fixture(scope="module")
def trap(tmp_path_factory):
    output = tmp_path_factory.mktemp("trap") / "animals.csv"
    return *run_in_process("fixed_camera.py", output), output


@pytest.fixture(scope="module")
def court(tmp_path_factory):
    output = tmp_path_factory.mktemp("court") / "record.json"
    return *run_in_process("court.py", output), output


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "written"), [("fixed_camera.py", "animals.csv"), ("court.py", "record.json")]
)
def test_runs_alone_without_warnings_and_matplotlib_and_again_alike(
    name, written, tmp_path, request
):
    blocked = tmp_path / "blocked"
    blocked.mkdir()
    (blocked / "matplotlib.py").write_text("raise ImportError", encoding="utf-8")
    paths = [str(blocked), *filter(None, [os.environ.get("PYTHONPATH")])]
    folder = {variable: str(tmp_path) for variable in ("TMPDIR", "TEMP", "TMP")}
    done = subprocess.run(
        [sys.executable, "-W", "error", str(EXAMPLES / name)],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        cwd=tmp_path,
        env={**os.environ, **folder, "PYTHONPATH": os.pathsep.join(paths)},
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    _, _, before = request.getfixturevalue("trap" if name == "fixed_camera.py" else "court")
    assert (tmp_path / written).read_bytes() == before.read_bytes()


# --- the camera trap ---


def test_the_pole_finds_the_camera(trap):
    found, printed, _ = trap
    plane, drawn = found["model"].plane, found["trap"]
    assert plane.camera_height_m == pytest.approx(drawn.height_m, rel=0.03)
    assert abs(plane.horizon_px - drawn.horizon_px) < 2 * plane.horizon_std_px
    assert abs(plane.roll_deg - drawn.roll_deg) < 2 * plane.roll_std_deg
    assert "12 of 12 references" in printed


def test_animals_are_in_their_intervals(trap):
    found, _, _ = trap
    assert statistics.mean(found["inside"]) >= 0.8
    assert statistics.median(found["height_errors"]) < 0.04
    assert statistics.median(found["distance_errors"]) < 0.05


def test_every_animal_has_a_row(trap):
    found, printed, output = trap
    with output.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == sum(map(len, found["pictures"])) > 40
    assert all(
        0 < float(row["low_m"]) <= float(row["height_m"]) <= float(row["high_m"]) < 2
        and 1 < float(row["distance_m"]) < 25
        for row in rows
    )
    assert {row["label"] for row in rows} == {"roe deer", "wild boar", "fox"}
    assert f"{sum(found['inside'])} of {len(rows)} true heights" in printed


def test_the_saved_model_measures_alike(trap):
    found, _, _ = trap
    assert found["kept"] == found["model"]
    animals = [animal.detection for picture in found["pictures"] for animal in picture]
    together = ims.predict(found["model"], animals)
    assert together == ims.predict(found["kept"], animals)
    # a picture by itself says the same as all pictures at once
    single = [ims.predict(found["kept"], [animal])[0] for animal in animals[:5]]
    assert [size.interval() for size in single] == [
        pytest.approx(size.interval(), rel=1e-9) for size in together[:5]
    ]


# --- the CCTV still ---


def test_the_interval_of_the_person_holds_the_truth_and_is_narrow(court):
    found, printed, _ = court
    low, high = found["suspect"].interval(0.95)
    assert low <= found["TRUE_HEIGHT_M"] <= high
    assert (high - low) / 2 < 0.06
    assert f"{low:.2f} to {high:.2f} m" in printed


def test_each_door_is_found_from_the_other(court):
    found, printed, _ = court
    for door, tape in zip(found["doors"], found["priors"], strict=True):
        low, high = door.interval(0.95)
        assert low <= tape.mean_m <= high
        assert (high - low) / 2 < 0.15
    assert printed.count("agrees with the tape") == 2


def test_the_record_repeats_the_measurement(court):
    found, _, output = court
    record = json.loads(output.read_text(encoding="utf-8"))
    assert record["imgscale"] == ims.__version__
    model = ims.ScaleModel.from_dict(record["model"])
    assert model == found["model"]
    assert ims.predict(model, found["detections"])[-1] == found["suspect"] == found["again"]
    assert all("steel tape" in prior["source"] for prior in record["model"]["priors"])
    references = {ref["label"]: ref for ref in record["model"]["references"]}
    assert references["suspect"]["reason"] == "no prior"
    assert all(references[name]["weight"] > 0.1 for name in ("door A", "door B"))
    assert record["explanation"]["summary"] == str(model)
