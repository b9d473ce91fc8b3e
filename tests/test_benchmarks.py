"""The validation benchmark runs in small, on synthetic scenes and on a folder in KITTI's layout."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[1] / "benchmarks" / "kitti.py"


def run(*arguments):
    return subprocess.run(
        [sys.executable, str(BENCHMARK), *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


@pytest.fixture(scope="module")
def synthetic(tmp_path_factory):
    out = tmp_path_factory.mktemp("validation") / "out.json"
    rows = "L-told-5,L-told-10,U-told-5,L-untold-5,L-affine*,L-mixed-5"
    done = run("--images", 40, "--rows", rows, "--json", out)
    assert done.returncode == 0, done.stderr
    return {row["id"]: row for row in json.loads(out.read_text(encoding="utf-8"))["rows"]}


def test_synthetic_intervals_cover_as_they_say(synthetic):
    # some 300 objects of 40 images that share a scale: a standard error of about 2 points
    covered = [synthetic[name]["coverage_90"] for name in ("L-told-5", "L-told-10", "U-told-5")]
    assert all(82 <= share <= 97 for share in covered)


def test_synthetic_sizes_beat_the_class_mean(synthetic):
    for name, row in synthetic.items():
        if name.startswith("L-") and name.endswith("-5"):
            assert row["median"] < row["class_mean"]


def test_no_object_is_lost_without_a_word(synthetic):
    # with a fitted shift an object may lie beyond the horizon, which is counted
    metric = [row for name, row in synthetic.items() if "affine" not in name]
    assert all(row["unanswered"] == row["refused"] == 0 for row in metric)
    assert synthetic["L-told-5"]["n"] == synthetic["L-told-10"]["n"] > 100


@pytest.fixture
def folder(tmp_path):
    labels, calib = tmp_path / "training" / "label_2", tmp_path / "training" / "calib"
    labels.mkdir(parents=True)
    calib.mkdir()
    for frame, z in enumerate((12.0, 20.0)):
        rows = [
            f"Car 0.00 0 0 {200 + 200 * i} 150 {300 + 200 * i} {150 + 700 * 1.5 / z:.2f} "
            f"1.50 1.70 4.00 0.0 1.6 {z + 0.85} 0.0"
            for i in range(3)
        ]
        rows.append("Car 0.50 0 0 0 150 100 250 1.50 1.70 4.00 0.0 1.6 9.0 0.0")
        rows.append("DontCare -1 -1 -10 1 1 50 50 -1 -1 -1 -1000 -1000 -1000 -10")
        (labels / f"{frame:06d}.txt").write_text("\n".join(rows) + "\n", encoding="utf-8")
        projection = "700 0 600 0 0 700 180 0 0 0 1 0"
        (calib / f"{frame:06d}.txt").write_text(f"P2: {projection}\n", encoding="utf-8")
    return tmp_path


def test_a_folder_in_kittis_layout_is_read(folder, tmp_path):
    out = tmp_path / "out.json"
    done = run("--root", folder, "--rows", "L-told-0", "--json", out)
    assert done.returncode == 0, done.stderr
    record = json.loads(out.read_text(encoding="utf-8"))
    [row] = record["rows"]
    # truncated objects and DontCare are neither targets nor references
    assert (record["meta"]["frames"], row["n"]) == (2, 6)
    # boxes are those of the near face, 1.5 m high, so the true focal length makes no error
    assert row["true_focal"] == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("arguments", [("--root", "nowhere"), ("--rows", "nonsense")])
def test_what_cannot_be_run_is_refused_with_a_message(arguments):
    done = run(*arguments)
    assert done.returncode == 2
    assert "kitti.py: " in done.stderr
