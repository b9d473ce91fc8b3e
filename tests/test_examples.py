"""Every example runs as it is, without network and files, and finds what was drawn."""

import ast
import contextlib
import csv
import importlib.util
import io
import json
import os
import re
import runpy
import socket
import statistics
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import imgscale as ims
from imgscale.datasets import drawn

pytest.importorskip("matplotlib")

EXAMPLES = Path(__file__).parents[1] / "examples"
NAMES = sorted(path.stem for path in EXAMPLES.glob("*.py"))
LONGEST = 60
# What runs only where an extra is installed.
NEEDS = {"parquet_with_ray": "ray", "stereo_pair": "cv2", "supervision_pipeline": "supervision"}
# Ray deprecates defaults of its own.
OTHERS_WARN = {"parquet_with_ray": "ray.data.context"}
_RUNS = {}


def no_network(*_, **__):
    raise AssertionError("an example asked for the network")


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run an example once in this process: its variables, what it printed, how many figures."""

    def once(name):
        if NEEDS.get(name) and not importlib.util.find_spec(NEEDS[name]):
            pytest.skip(f"{name} needs {NEEDS[name]}")
        if name in _RUNS:
            return _RUNS[name]
        import matplotlib as mpl  # noqa: PLC0415 - may be missing
        import matplotlib.pyplot as plt  # noqa: PLC0415

        mpl.use("Agg")
        monkeypatch.chdir(tmp_path)
        monkeypatch.delenv("IMGSCALE_DATA", raising=False)
        monkeypatch.setattr(sys, "argv", [name])
        monkeypatch.setenv("RAY_AUTH_MODE", "disabled")  # or it writes to the home folder
        monkeypatch.setattr(socket.socket, "connect", no_network)
        monkeypatch.setattr(socket, "getaddrinfo", no_network)
        before, printed = dict(mpl.rcParams), io.StringIO()
        try:
            with contextlib.redirect_stdout(printed), warnings.catch_warnings():
                if name in OTHERS_WARN:
                    module = re.escape(OTHERS_WARN[name])
                    warnings.filterwarnings("ignore", category=DeprecationWarning, module=module)
                found = runpy.run_path(str(EXAMPLES / f"{name}.py"))
            figures = [plt.figure(number) for number in plt.get_fignums()]
            for figure in figures:
                figure.canvas.draw()
        finally:
            plt.close("all")
        assert dict(mpl.rcParams) == before
        assert list(tmp_path.iterdir()) == []
        return _RUNS.setdefault(name, (found, printed.getvalue(), figures))

    return once


# --- all of them ---


@pytest.mark.parametrize("name", NAMES)
def test_runs_without_warnings_network_and_files_and_gives_a_picture(name, run):
    _, printed, figures = run(name)
    assert printed.strip()
    assert figures
    assert all(figure.axes for figure in figures)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_runs_as_a_script_and_prints_the_same(name, run, tmp_path):
    _, printed, _ = run(name)
    others = OTHERS_WARN.get(name)
    quiet = ["-W", f"ignore::DeprecationWarning:{others}"] if others else []
    done = subprocess.run(
        [sys.executable, "-W", "error", *quiet, str(EXAMPLES / f"{name}.py")],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        cwd=tmp_path,
        env={**os.environ, "MPLBACKEND": "Agg", "RAY_AUTH_MODE": "disabled"},
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert done.stdout == printed


@pytest.mark.parametrize("name", NAMES)
def test_is_one_lesson_of_sixty_lines_with_a_title(name):
    text = (EXAMPLES / f"{name}.py").read_text(encoding="utf-8")
    title, line, blank, *told = (ast.get_docstring(ast.parse(text)) or "").splitlines()
    assert len(text.splitlines()) <= LONGEST
    assert line == "=" * len(title)
    assert blank == ""
    assert told
    assert "\n# %%\n" in text
    assert "plt.show" not in text


# --- motorcycle ---


def test_the_tyre_sizes_the_rim_and_finds_the_baseline(run):
    found, printed, (figure,) = run("motorcycle")
    rim = found["sizes"][1]
    low, high = rim.interval(0.9)
    assert low < 0.485 < high  # an 18 inch rim at its lip
    assert "baseline published 0.193 m, found 0.282 +- 0.008 m" in printed
    assert "the tyre by the published one: 0.43 m" in printed
    assert any("only at" in text.get_text() for text in figure.axes[0].texts)


# --- a face ---


def test_the_face_sizes_the_patch_with_a_reservation(run):
    found, printed, _ = run("face_as_reference")
    low, high = found["size"].interval(0.9)
    assert low < 0.1016 < high  # patches of crews are 4 inches wide
    assert "9 to 15" in printed
    assert ims.Flag.SINGLE_REFERENCE in found["result"].model.flags
    assert found["result"].model.references[0].label == "lbp frontal face"


# --- people on a ground plane ---


def test_the_plane_and_all_sizes_are_those_drawn(run):
    found, _, (figure,) = run("people_on_a_ground_plane")
    plane, scene = found["model"].plane, found["scene"]
    height, horizon = scene.viewpoint.height_m, scene.viewpoint.horizon_px
    assert abs(plane.camera_height_m - height) < plane.camera_height_std_m
    assert abs(plane.horizon_px - horizon) < plane.horizon_std_px
    for size, drawn_m, away_m in zip(
        found["sizes"], scene.sizes_m, scene.distances_m, strict=True
    ):  # fmt: skip
        low, high = size.interval(0.9)
        assert low < drawn_m < high
        assert size.distance_m == pytest.approx(away_m, rel=0.05)
    assert found["sizes"][-1].size_m == pytest.approx(2.6, rel=0.03)
    assert len(figure.axes) == 2


# --- the relative depth of a network ---


def test_factor_and_shift_are_found(run):
    found, _, _ = run("relative_depth_network")
    model, scene = found["model"], found["scene"]
    assert abs(model.k - 8.0 / scene.viewpoint.focal_px) < model.k_std
    assert abs(model.shift - 0.4) < model.shift_std
    low, high = found["statue"].interval(0.9)
    assert low < scene.sizes_m[-1] < high
    assert ims.suspect(model) == ()


def test_the_wrong_kind_gives_absurd_sizes_and_is_named(run):
    found, printed, _ = run("relative_depth_network")
    scale, scene = found["scale"], found["scene"]
    near, _, far = (
        metres * seen.height_px
        for metres, seen in zip(scale[:3], scene.detections[:3], strict=True)
    )
    assert near < 1.0
    assert far > 3.0
    assert [suspicion.cause for suspicion in ims.suspect(found["wrong_model"])] == [
        "depth of another picture"
    ]
    assert "depth of another picture: the 5 references disagree" in printed


# --- a coin and food ---


def test_food_is_in_its_intervals_and_the_parallax_as_large_as_told(run):
    found, printed, _ = run("coin_and_food")
    scene = found["scene"]
    ratios = {}
    for size, true_m in zip(found["sizes"], scene.sizes_m, strict=True):
        low, high = size.interval(0.9)
        assert low < true_m < high
        ratios[size.label] = size.size_m / true_m
    assert ratios["biscuit"] == pytest.approx(1.0, abs=0.03)
    table_m, coin_m = scene.viewpoint.height_m, scene.distances_m[0]
    for name, middle_m in zip(("apple", "orange", "plum"), scene.distances_m[2:], strict=True):
        nearer = coin_m / middle_m  # by the pinhole law
        assert 1.03 < nearer < 1.09
        assert nearer - 0.02 < ratios[name] < nearer + 0.05
    assert found["height_m"] == pytest.approx(table_m, rel=0.04)
    assert printed.count("as a ball") == 3


def test_the_correction_and_the_area_come_out_right(run):
    found, _, _ = run("coin_and_food")
    scene, height_m = found["scene"], found["height_m"]
    for size, true_m in list(zip(found["sizes"], scene.sizes_m, strict=True))[2:]:
        ball_m = size.size_m / (1 + size.size_m / (2 * height_m))
        assert abs(ball_m - true_m) < 0.6 * abs(size.size_m - true_m)
    low, high = found["area"].interval(0.9)
    assert low < 3.14159 / 4 * scene.sizes_m[1] ** 2 < high
    assert found["area"].unit == "m2"


# --- the camera trap ---


def test_the_pole_finds_the_camera(run):
    found, printed, _ = run("camera_trap")
    plane, view = found["model"].plane, found["setup"].viewpoint
    assert plane.camera_height_m == pytest.approx(view.height_m, rel=0.03)
    assert abs(plane.horizon_px - view.horizon_px) < 2 * plane.horizon_std_px
    assert abs(plane.roll_deg - view.roll_deg) < 2 * plane.roll_std_deg
    assert "12 of 12 references" in printed


def test_every_animal_has_a_row_with_its_height_and_distance(run):
    found, printed, _ = run("camera_trap")
    header = printed.index("picture,label")
    table, (summary,) = printed[header:].splitlines()[:-1], printed.splitlines()[-1:]
    rows = list(csv.DictReader(table))
    assert len(rows) == len(found["inside"]) > 15
    assert all(0 < float(row["low_m"]) <= float(row["high_m"]) < 2 for row in rows)
    assert {row["label"] for row in rows} == {"roe deer", "wild boar", "fox"}
    assert summary.startswith(f"{sum(found['inside'])} of {len(rows)} heights drawn")


def test_animals_are_in_their_intervals_and_their_distances_right(run):
    found, _, _ = run("camera_trap")
    view, kept = found["setup"].viewpoint, found["kept"]
    height_errors, distance_errors, inside = [], [], []
    for scene in found["pictures"]:
        sizes = ims.predict(kept, scene.detections)
        truth = zip(sizes, scene.detections, scene.sizes_m, scene.distances_m, strict=True)
        for size, seen, true_m, z_m in truth:
            low, high = size.interval(0.9)
            inside.append(low <= true_m <= high)
            height_errors.append(abs(size.size_m / true_m - 1))
            x = ((seen.xyxy[0] + seen.xyxy[2]) / 2 - 480) / view.focal_px
            y = (seen.xyxy[3] - 270) / view.focal_px
            over_ground = (z_m**2 * (1 + x**2 + y**2) - view.height_m**2) ** 0.5
            distance = found["over_ground_m"](seen, size.distance_m)
            distance_errors.append(abs(distance / over_ground - 1))
    assert inside == found["inside"]
    assert statistics.mean(inside) >= 0.8
    assert statistics.median(height_errors) < 0.05
    assert statistics.median(distance_errors) < 0.05


def test_the_saved_model_measures_alike(run):
    found, _, _ = run("camera_trap")
    assert found["kept"] == found["model"]
    animals = [seen for scene in found["pictures"] for seen in scene.detections]
    together = ims.predict(found["model"], animals)
    # a picture by itself says the same as all pictures at once
    single = [ims.predict(found["kept"], [animal])[0] for animal in animals[:5]]
    assert [size.interval() for size in single] == [
        pytest.approx(size.interval(), rel=1e-9) for size in together[:5]
    ]


# --- the CCTV still ---


def test_the_interval_of_the_person_holds_the_truth_and_is_narrow(run):
    found, printed, _ = run("court")
    low, high = found["person"].interval(0.95)
    assert low <= found["still"].sizes_m[-1] <= high
    assert (high - low) / 2 < 0.06
    assert f"{low:.2f} to {high:.2f} m" in printed


@pytest.mark.slow
def test_the_interval_of_the_person_holds_the_truth_for_other_hands_too(run):
    found, _, _ = run("court")
    given = (found["ground"], found["doors"])
    options = {"camera": found["camera"], "noise": found["noise"]}
    inside = []
    for seed in range(60):
        still = drawn.hallway(rng=np.random.default_rng(seed))
        model = ims.fit(still.detections, *given, **options)
        low, high = ims.predict(model, still.detections)[-1].interval(0.95)
        inside.append(low <= still.sizes_m[-1] <= high)
    assert statistics.mean(inside) >= 0.9


def test_each_door_is_found_from_the_other(run):
    found, printed, _ = run("court")
    for door, tape in zip(found["left_out"][:2], found["doors"], strict=True):
        low, high = door.interval(0.95)
        assert low <= tape.mean_m <= high
        assert (high - low) / 2 < 0.15
    assert printed.count("agrees with the tape") == 2


def test_the_error_budget_is_told(run):
    _, printed, _ = run("court")
    assert "k has a standard error of" in printed
    assert "of its variance" in printed
    assert "k would be narrowed most by" in printed


def test_the_record_repeats_the_measurement(run):
    found, _, _ = run("court")
    record = json.loads(found["record"])
    assert ims.ScaleModel.from_dict(record) == found["model"]
    assert found["again"] == found["person"]
    assert all("steel tape" in prior["source"] for prior in record["priors"])
    references = {ref["label"]: ref for ref in record["references"]}
    assert references["person"]["reason"] == "no prior"
    assert all(references[name]["weight"] > 0.1 for name in ("door A", "door B"))
