"""The benchmarks run in small: validation, on scenes and in KITTI's layout, and speed."""

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import imgscale as ims
from imgscale.batch import fit_columns

pytestmark = pytest.mark.slow
BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
BENCHMARK = BENCHMARKS / "kitti.py"


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


@pytest.fixture
def benchmark(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module


@pytest.mark.parametrize("path", sorted(BENCHMARKS.glob("*.py")), ids=lambda path: path.stem)
def test_every_benchmark_can_be_imported(path, benchmark):
    if path.stem == "speed_numba":
        pytest.importorskip("numba", reason="a yardstick of the bench group")
    if path.stem == "fuzz":
        pytest.importorskip("atheris", reason="built for few Python versions")
    benchmark(path.stem)


def bad_columns(speed_columns, per_image):
    """Images with outliers, things without a prior and missing depths, some without anything."""
    columns = speed_columns.draw(400, per_image)
    rng = np.random.default_rng(7)
    lost, unknown, wrong = rng.random((3, columns.image_id.size)) < [[0.1], [0.1], [0.2]]
    return columns._replace(
        image_id=3 * columns.image_id - 50,
        label=np.where(unknown, -1, columns.label).astype(np.int16),
        pixels=columns.pixels * np.where(wrong, rng.lognormal(0, 1.5, lost.size), 1.0),
        depth=np.where(lost, np.nan, columns.depth),
    )


@pytest.mark.parametrize("per_image", [None, 1, 2, 150])
def test_the_compiled_loop_gives_the_numbers_of_the_batch(per_image, benchmark):
    pytest.importorskip("numba", reason="a yardstick of the bench group")
    speed_columns, speed_numba = benchmark("speed_columns"), benchmark("speed_numba")
    columns = bad_columns(speed_columns, per_image)
    noise = speed_columns.NOISE
    ours = fit_columns(*columns, kind="metric", labels=speed_columns.LABELS, noise=noise, level=0.8)
    image_id, images, rows = speed_numba.robust(columns, speed_columns.sizes(), noise, level=0.8)
    assert np.array_equal(image_id, ours.images.image_id)
    for theirs, table in ((images, ours.images), (rows, ours.rows)):
        for name, column in theirs._asdict().items():
            assert column == pytest.approx(getattr(table, name), rel=1e-9, abs=1e-9, nan_ok=True)
    assert np.isnan(images.k).any() == (per_image != 150)
    assert (rows.reason == 4).any() == (per_image not in {1, 2})


@pytest.mark.parametrize("n_images", [1, 30])
def test_peers_fit_the_same_scales(n_images, benchmark):
    for package in ("pandas", "polars"):
        pytest.importorskip(package, reason="a peer of the bench group")
    speed_columns, peers = benchmark("speed_columns"), benchmark("speed_peers")
    columns, prior = speed_columns.draw(n_images), speed_columns.sizes()

    def ours(method):
        options = {"kind": "metric", "labels": speed_columns.LABELS, "method": method}
        return fit_columns(*columns, **options)

    squares, mean = ours("least_squares"), ours("mean_ratio")
    assert peers.pandas_least_squares(columns, prior) == pytest.approx(squares.images.k)
    assert sorted(peers.polars_least_squares(columns, prior)) == pytest.approx(
        sorted(squares.images.k)
    )
    assert peers.pandas_sizes(columns, prior) == pytest.approx(squares.rows.size_m)
    assert peers.pandas_mean_ratio(columns, prior) == pytest.approx(mean.images.k)
    # robust of another kind: alike within the error
    robust = ours("robust").images
    apart = np.log(peers.pandas_apply(columns, prior) / robust.k)
    assert (np.abs(apart) < 4 * robust.k_std / robust.k).mean() > 0.9


def test_one_by_one_sizes_the_same_objects(benchmark):
    speed_columns, peers = benchmark("speed_columns"), benchmark("speed_peers")
    columns, priors = speed_columns.draw(4), ims.PriorTable.default()
    options = {"kind": "metric", "labels": speed_columns.LABELS, "noise": speed_columns.NOISE}
    sizes = [size for image in peers.one_by_one(columns, priors) for size in image]
    found = fit_columns(*columns, priors, **options).rows
    assert [size.size_m for size in sizes] == pytest.approx(found.size_m)


def test_single_peers_find_the_same_scale(benchmark):
    for package in ("sklearn", "statsmodels"):
        pytest.importorskip(package, reason="a peer of the bench group")
    speed_single = benchmark("speed_single")
    detections, z_m = speed_single.objects(10)
    found = {name: call() for name, call in speed_single.peers(detections, z_m)}
    log_k = [
        found["scipy least_squares(huber)"].x[0],
        found["sklearn HuberRegressor"].coef_[0],
        found["sklearn RANSACRegressor"].estimator_.coef_[0],
        found["statsmodels RLM"].mean(),
        found["skimage ransac"][0].log_k,
    ]
    # a focal length of 1200 px, sizes that err by 5 %
    assert log_k == pytest.approx([-np.log(1200)] * 5, abs=0.1)


def test_every_call_of_the_batch_can_be_timed(benchmark):
    for package in ("pandas", "polars", "numba"):
        pytest.importorskip(package, reason="a peer of the bench group")
    speed_batch, speed_rounds = benchmark("speed_batch"), benchmark("speed_rounds")
    took = speed_rounds.timed(speed_batch.calls(20, speed_batch.NAMES), rounds=1)
    assert set(took) == set(speed_batch.NAMES)
    assert all(timing.seconds[0] > 0 for timing in took.values())


def test_rows_tell_ratios_and_missed_goals(benchmark):
    speed_rounds = benchmark("speed_rounds")
    ours = speed_rounds.Timing((1.0, 2.0, 4.0), references=4e6, peak=3e6)
    peer = speed_rounds.Timing((2.0, 6.0, 20.0), references=4e6)
    row = speed_rounds.Row("fit", "n", ours, "peer", peer, 3.5, 1.0, most_memory=4e6)
    line = (
        "| fit | n | 2.0 M/s | peer | 0.67 M/s | 3 (2 to 5) | 3.5, missed; 1 M/s; 4 MB | 3 MB / - |"
    )
    assert speed_rounds.markdown([row]).splitlines()[-1] == line
    assert speed_rounds.plain([row]).splitlines()[-1].split() == line.replace("|", "").split()


def test_a_scale_map_is_timed_beside_a_copy(benchmark):
    rows = benchmark("speed_maps").map_rows(1, quick=True)
    assert {row.peer for row in rows} == {"np.copyto"}
    assert all(row.ratios[0] > 0 for row in rows)
    assert all(row.ours.peak >= 375 * 1242 * 4 for row in rows)  # the map itself


def test_boxes_are_timed_beside_numpy(benchmark):
    rows = benchmark("speed_maps").box_rows(1, quick=True)
    assert {"np.nanmedian", "np.nanpercentile"} <= {row.peer for row in rows}
    assert all(row.ratios[0] > 0 for row in rows)


def test_every_kind_of_depth_is_timed(benchmark):
    rows = benchmark("speed_single").kind_rows(1, quick=True)
    kinds = ("metric", "affine_inverse", "ground_plane")
    named = [
        f"{verb}, {kind}, {method}"
        for kind in kinds
        for method in ("robust", "posterior")
        for verb in ("fit", "predict")
    ]
    assert [row.what for row in rows] == named


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="/proc tells the memory")
def test_memory_is_that_of_the_call(benchmark):
    speed_memory = benchmark("speed_memory")
    peaks = speed_memory.peak_memory(megabytes, ["sum"], 50)
    assert peaks["sum"] == pytest.approx(50e6, rel=0.05)


def megabytes(size, _):
    ones = np.ones(int(size * 1e6), np.int8)

    def in_two_steps():
        more = ones + 1
        return ones + more

    return {"sum": in_two_steps}


def test_the_table_of_a_section_goes_into_a_page(benchmark):
    page = "Before.\n<!-- speed: map -->\nold\n<!-- end of map -->\nAfter.\n"
    filled = benchmark("speed")._filled(page, "map", "new")
    assert filled == "Before.\n<!-- speed: map -->\n\nnew\n\n<!-- end of map -->\nAfter.\n"
    with pytest.raises(ValueError, match="must hold <!-- speed: boxes -->"):
        benchmark("speed")._filled(filled, "boxes", "new")


def test_the_page_has_a_place_for_every_table(benchmark):
    page = (BENCHMARKS.parent / "docs" / "performance.md").read_text(encoding="utf-8")
    for section in benchmark("speed")._SECTIONS:
        assert f"\nanew of {section}\n" in benchmark("speed")._filled(
            page, section, f"anew of {section}"
        )


def test_one_command_prints_the_table():
    done = subprocess.run(
        [sys.executable, str(BENCHMARKS / "speed.py"), "--quick", "--only", "import", "--markdown"],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        env=os.environ,
    )
    assert done.returncode == 0, done.stderr
    heading, rule, *rows = done.stdout.splitlines()
    assert [line.count("|") for line in (heading, rule, *rows)] == [9] * 4
    assert rows[0].startswith("| import imgscale |")
