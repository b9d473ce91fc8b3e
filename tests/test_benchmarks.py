"""The validation benchmark runs in small, on synthetic scenes and on a folder in KITTI's layout."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow
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


@pytest.fixture(scope="module")
def with_ground(tmp_path_factory):
    out = tmp_path_factory.mktemp("ground") / "out.json"
    rows = "U-told-20,U-foot-told-20,ground-fused,pooled-k*,pooled-*-fused*,pooled-camera*"
    done = run("--images", 20, "--rows", rows, "--jobs", 2, "--json", out)
    assert done.returncode == 0, done.stderr
    return {row["id"]: row for row in json.loads(out.read_text(encoding="utf-8"))["rows"]}


def test_feet_say_more_than_bad_depths(with_ground):
    depth_alone, with_feet = (with_ground[name] for name in ("U-told-20", "U-foot-told-20"))
    assert with_feet["n"] == depth_alone["n"]
    assert with_feet["median"] < depth_alone["median"]


def test_the_ground_plane_is_compared_with_the_true_camera(with_ground):
    height, horizon = (with_ground[f"pooled-camera-{word}"] for word in ("height", "horizon"))
    assert (height["unit"], horizon["unit"]) == ("%", "px")
    assert height["n"] == horizon["n"] == 1  # one drive of ten images
    assert height["median"] < 15
    assert horizon["median"] < 25


def test_a_whole_drive_says_more_than_one_image(with_ground):
    assert with_ground["pooled-k-told-5"]["n"] == with_ground["pooled-k-tracks-told-5"]["n"] == 1
    assert with_ground["pooled-k-told-5"]["median"] < 5
    for name in ("pooled-height-fused-0", "pooled-ground-fused"):
        assert with_ground[name]["median"] < with_ground[name]["class_mean"]


def test_two_processes_reach_the_same_figures(tmp_path):
    records = []
    for jobs in (1, 2):
        out = tmp_path / f"{jobs}.json"
        rows = "L-told-5,U-mixed-5,lidar-k,pooled-k-told-5,U-drive-20"
        done = run("--images", 20, "--rows", rows, "--jobs", jobs, "--json", out)
        assert done.returncode == 0, done.stderr
        records.append(json.loads(out.read_text(encoding="utf-8")))
    assert records[0] == records[1]


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


def test_frames_of_one_drive_are_pooled(folder, tmp_path):
    labels = folder / "training" / "label_2"
    for frame in range(2, 10):
        same = (labels / f"{frame % 2:06d}.txt").read_text(encoding="utf-8")
        (labels / f"{frame:06d}.txt").write_text(same, encoding="utf-8")
    lines = [f"{frame:06d},somewhere,{9 - frame},1242,375,700,180,0" for frame in range(10)]
    header = "frame,drive,raw_frame,width,height,fy,cy,tz"
    (folder / "frames.csv").write_text("\n".join([header, *lines, ""]), encoding="utf-8")
    out = tmp_path / "out.json"
    rows = "pooled-k-tracks-told-0,pooled-height-unfused-0"
    done = run("--root", folder, "--rows", rows, "--json", out)
    assert done.returncode == 0, done.stderr
    rows = {row["id"]: row for row in json.loads(out.read_text(encoding="utf-8"))["rows"]}
    assert rows["pooled-k-tracks-told-0"]["n"] == 1
    assert rows["pooled-height-unfused-0"]["n"] == 30
    # all cars are 1.5 m high where the table's mean is 1.515
    assert rows["pooled-height-unfused-0"]["median"] < 1.5


@pytest.mark.parametrize("arguments", [("--root", "nowhere"), ("--rows", "nonsense")])
def test_what_cannot_be_run_is_refused_with_a_message(arguments):
    done = run(*arguments)
    assert done.returncode == 2
    assert "kitti.py: " in done.stderr
