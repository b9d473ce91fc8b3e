"""Threads, processes, long loops, large maps and interrupts: the same numbers, and none is lost."""

import copy
import gc
import importlib
import importlib.util
import pickle
import random
import signal
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path

import attrs
import numpy as np
import pytest
from PIL import Image

import imgscale as ims
from imgscale.object_prior import normal_label

# What threads and processes do. A file of its own, which spawned processes can import.
WORK = """
import multiprocessing, struct, sys, threading
import attrs
import numpy as np
import imgscale as ims

HEIGHTS = {"person": 1.72, "car": 1.5, "door": 2.0, "bicycle": 1.05, "statue": 1.3}
Z = np.array([4.0, 7.5, 12.0, 18.0, 9.0])
KINDS = {
    "metric": lambda z: z, "relative": lambda z: z / 3,
    "inverse": lambda z: 50 / z, "affine_inverse": lambda z: 50 / z + 3,
}
SIZE, PLANE = (1200, 800), ims.GroundPlane(image_size=(1200, 800))
BOXES = [
    ims.Detection(
        label, (100 + 200 * i, 400 + (1500 - 1000 * m) / z, 180 + 200 * i, 400 + 1500 / z)
    )
    for i, ((label, m), z) in enumerate(zip(HEIGHTS.items(), Z))
]
PICTURE = np.full((800, 1200, 3), 90, np.uint8)


def surface(kind):
    values = np.full((400, 600), 25.0)
    for box, z in zip(BOXES, Z):
        x1, y1, x2, y2 = (int(end / 2) for end in box.xyxy)
        values[y1:y2, x1:x2] = z
    values = KINDS[kind](values)
    values[::7, ::5] = np.nan
    return ims.DepthMap(values, kind=kind, image_size=SIZE)


TABLE = ims.PriorTable(ims.PriorTable.default().priors)
DEPTHS = [ims.ObjectDepths(of(Z), kind=kind, image_size=SIZE) for kind, of in KINDS.items()]
DEPTHS += [surface(kind) for kind in KINDS] + [PLANE]
TOLD, CAMERA = ims.Noise(depth_rel=0.05), ims.Camera(1000.0, focal_rel_std=0.02)


def fitted(depth, method, **options):
    model = ims.fit(BOXES, depth, TABLE, method=method, **options)
    of = () if isinstance(depth, ims.GroundPlane) else (depth,)
    fused = [ims.predict(model, BOXES, *of, use_prior=True)] if method == "posterior" else []
    return model, ims.predict(model, BOXES, *of), *fused


def columns(kind, method):
    from imgscale.batch import fit_columns
    pixels = [box.xyxy[3] - box.xyxy[1] for box in BOXES]
    found = fit_columns(np.repeat([3, 8], 5), list(HEIGHTS) * 2, pixels * 2,
                        np.tile(KINDS[kind](Z), 2), TABLE, kind=kind, noise=TOLD, method=method)
    return [*found.images, *found.rows]


def job(number):
    kind, depth = list(KINDS)[number % 4], DEPTHS[number % 9]
    found = [fitted(depth, method, noise=TOLD) for method in ("robust", "posterior")]
    if depth.kind not in {"affine_inverse", "ground_plane"}:
        found += [fitted(depth, method) for method in ("mean_ratio", "least_squares", "robust")]
    if number == 1:  # noise to be learned, a second witness, another camera
        found += [fitted(depth, "posterior"), fitted(depth, "robust", ground=PLANE)]
        found += [fitted(DEPTHS[0], "posterior", camera=CAMERA, noise=TOLD)]
        found += [ims.leave_one_out(BOXES, DEPTHS[2], TABLE, noise=TOLD)]
    found += [columns(kind, method) for method in ("robust", "posterior")]
    result = ims.measure(PICTURE, detector=BOXES, depth_source=depth, noise=TOLD)
    return bytes_of([found, result.model, result.estimates, str(ims.explain(result.model))])


def bytes_of(value):
    if attrs.has(type(value)):
        return b"".join(bytes_of(getattr(value, f.name)) for f in attrs.fields(type(value)))
    if isinstance(value, tuple | list):
        return b"".join(map(bytes_of, value))
    if isinstance(value, np.ndarray):
        return value.tobytes()
    return struct.pack("<d", value) if isinstance(value, float) else repr(value).encode()


JOBS = range(9)


def in_threads(count=8):
    found, errors, start = {}, [], threading.Barrier(count)

    def run(first):
        start.wait()
        try:
            for number in (*JOBS[first:], *JOBS[:first]):
                found[first, number] = job(number)
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=run, args=(first,)) for first in range(count)]
    for thread in threads: thread.start()
    for thread in threads: thread.join()
    if errors: raise errors[0]
    return [[found[first, number] for number in JOBS] for first in range(count)]


def in_processes(count=3):
    with multiprocessing.get_context("spawn").Pool(count) as pool:
        return [pool.map(job, JOBS, chunksize=1)]


if __name__ == "__main__":
    import pickle
    found = {"threads": in_threads, "processes": in_processes}[sys.argv[1]]()
    sys.stdout.buffer.write(pickle.dumps(found))
"""
# Sizes pictures into a record, and says so of each.
STREAM = """
import sys, time
import imgscale as ims
paths, record, wait = sys.argv[3:], sys.argv[1], float(sys.argv[2])
def detector(image):
    time.sleep(wait)
    height = 30 + int(image[0, 0, 0])
    return [ims.Detection("door", (20, 10, 40, 60)), ims.Detection("box", (60, 5, 90, 5 + height))]
def depth(image):
    return ims.DepthMap([[4.0]], kind="relative", image_size=(120, 80))
doors = ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.02)])
for outcome in ims.measure_many(paths, detector=detector, depth_source=depth, record=record,
                                priors=doors, noise=ims.Noise(depth_rel=0.01)):
    print(outcome.path, flush=True)
"""
DOOR = ims.Detection("door", (20, 10, 40, 60))
OPTIONS = {
    "priors": ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.02)]),
    "noise": ims.Noise(depth_rel=0.01),
}


# --- threads and processes ---


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    path = tmp_path_factory.mktemp("work") / "work.py"
    path.write_text(WORK)
    spec = importlib.util.spec_from_file_location("work", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def alone(work):
    return [work.job(number) for number in work.JOBS]


def elsewhere(work, how):
    done = subprocess.run(
        [sys.executable, "-W", "error", work.__file__, how],
        capture_output=True, check=False, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr.decode()
    return pickle.loads(done.stdout)  # noqa: S301 - our own


@pytest.mark.slow
def test_threads_whose_first_calls_meet_in_a_new_process_give_the_same_bytes(work, alone):
    assert elsewhere(work, "threads") == [alone] * 8


@pytest.mark.slow
def test_spawned_processes_give_the_same_bytes(work, alone):
    assert elsewhere(work, "processes") == [alone]


def test_the_bytes_that_are_compared_hold_every_number(work):
    boxes, depth = work.BOXES, work.DEPTHS[1]
    model = ims.fit(boxes, depth, work.TABLE, method="robust")
    other = attrs.evolve(model, k_std=np.nextafter(model.k_std, 1.0))
    assert work.bytes_of(model) != work.bytes_of(other)
    assert work.bytes_of(model) == work.bytes_of(copy.deepcopy(model))


def test_threads_that_first_need_a_lazily_loaded_module_do_not_meet_it_half_loaded():
    code = """
import threading
import imgscale as ims
start, found = threading.Barrier(8), []
def run(name):
    start.wait()
    found.append(callable(getattr(ims, name)))
names = ["fit", "predict", "measure", "measure_many", "explain", "fit_shared", "suspect", "Noise"]
threads = [threading.Thread(target=run, args=(name,)) for name in names]
for thread in threads: thread.start()
for thread in threads: thread.join()
print(found.count(True))
"""
    for _ in range(3):
        done = subprocess.run(
            [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True
        )
        assert (done.stdout.split(), done.stderr) == (["8"], "")


# --- long loops and large inputs ---


def benchmark(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "benchmarks")
    return importlib.import_module("load")


@pytest.mark.slow
def test_fits_in_a_loop_hold_no_more_memory_than_the_first_ones(monkeypatch):
    load = benchmark(monkeypatch)
    for number in range(5000):  # the last labels are remembered, and no more than 4096
        normal_label(f"thing {number}")
    held = []
    for first in (5000, 6000):
        for number in range(first, first + 1001):
            load.fit_once(number)
        gc.collect()
        held.append((sys.getallocatedblocks(), len(gc.get_objects())))
    (blocks, objects), (more_blocks, more_objects) = held
    assert more_blocks - blocks < 200  # one object kept by each fit would be 1000
    assert more_objects - objects < 20


@pytest.mark.slow
def test_the_benchmark_of_the_load_runs_in_small():
    script = Path(__file__).parents[1] / "benchmarks" / "load.py"
    options = ["--fits", "50", "--megapixels", "0.5", "--boxes", "20"]
    done = subprocess.run(
        [sys.executable, str(script), *options], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "fits" in done.stdout
    assert "boxes" in done.stdout


def peak(call):
    """The most memory that a call held, and what it gave."""
    gc.collect()
    tracemalloc.start()
    try:
        found = call()
        return tracemalloc.get_traced_memory()[1], found
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("kind", ["metric", "relative", "inverse", "affine_inverse"])
def test_a_map_is_copied_once_and_boxes_on_it_take_no_memory_for_its_pixels(kind):
    side = 2000
    values = np.repeat(np.linspace(60, 4, side, dtype=np.float32)[:, None], side, axis=1)
    values[::3, ::5] = np.nan
    made, depth = peak(lambda: ims.DepthMap(values, kind=kind))
    assert made < 1.01 * values.nbytes + 100_000
    boxes = [
        ims.Detection(label, (10.0 * i, 30.0 * i, 10.0 * i + 150, 30.0 * i + 300))
        for i, label in enumerate(["person", "car", "door", "thing"] * 10)
    ]
    options = {"noise": ims.Noise(depth_rel=0.05), "method": "robust"}
    ims.predict(ims.fit(boxes, depth, **options), boxes, depth)
    used, model = peak(lambda: ims.fit(boxes, depth, **options))
    used_again, _ = peak(lambda: ims.predict(model, boxes, depth))
    assert max(used, used_again) < values.nbytes / 4


@pytest.mark.slow
@pytest.mark.parametrize("told", [True, False])
def test_memory_for_many_references_stays_below_a_bound(told):
    # what all references need at once, under every level of noise, would be gigabytes
    rng = np.random.default_rng(0)
    z, names = rng.uniform(4, 40, 1200), ["person", "car", "door", "bicycle"]
    heights = rng.lognormal(0.3, 0.1, z.size) * 1000 / z
    boxes = [
        ims.Detection(names[i % 4], (10.0, 10.0, 60.0, 10.0 + height))
        for i, height in enumerate(heights)
    ]
    depth = ims.ObjectDepths(z, kind="relative", rel_std=0.05 if told else None)
    used, model = peak(lambda: ims.fit(boxes, depth))
    assert used < 450e6
    assert all(np.isfinite(ref.posterior_m) for ref in model.references)


# --- interrupts ---


def pictures(folder, count):
    paths = []
    for number in range(count):
        path = folder / f"{number}.png"
        Image.fromarray(np.full((80, 120, 3), number, np.uint8)).save(path)
        paths.append(str(path))
    return paths


def stream(record, wait, paths, **options):
    return subprocess.Popen(
        [sys.executable, "-c", STREAM, str(record), str(wait), *paths],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options,
    )  # fmt: skip


def whole_run(tmp_path, paths):
    record = tmp_path / "whole.jsonl"
    _, errors = stream(record, 0, paths).communicate(timeout=60)
    assert errors == ""
    return record.read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("by", ["SIGINT", "SIGKILL"])
def test_a_process_that_is_stopped_at_any_moment_loses_no_finished_picture(tmp_path, by):
    paths = pictures(tmp_path, 12)
    whole = whole_run(tmp_path, paths)
    for attempt in range(2):
        record = tmp_path / f"{attempt}.jsonl"
        with stream(record, 0.004, paths) as process:
            said = [process.stdout.readline() for _ in range(1 + 4 * attempt)]
            time.sleep(random.uniform(0, 0.03))  # noqa: S311 - any moment will do
            process.send_signal(getattr(signal, by))
            rest, errors = process.communicate(timeout=60)
        said = "".join([*said, rest]).split()
        if process.returncode:
            assert by == "SIGKILL" or errors.rstrip().endswith("KeyboardInterrupt")
        kept = [row["path"] for row in ims.read_record(record)]
        assert kept[: len(said)] == said
        assert len(kept) <= len(said) + 1
        _, errors = stream(record, 0, paths).communicate(timeout=60)
        assert errors == ""
        assert record.read_bytes() == whole


def flat(image):
    return ims.DepthMap([[4.0]], kind="relative", image_size=image.shape[1::-1])


def run(paths, detector, record):
    return ims.measure_many(paths, detector=detector, depth_source=flat, record=record, **OPTIONS)


def test_a_stream_that_is_closed_early_is_taken_up_where_it_ended(tmp_path):
    paths, record = pictures(tmp_path, 5), tmp_path / "sizes.jsonl"
    outcomes = run(paths, lambda _: [DOOR], record)
    seen = [next(outcomes).path, next(outcomes).path]
    outcomes.close()
    assert [row["path"] for row in ims.read_record(record)] == seen == paths[:2]
    assert [outcome.path for outcome in run(paths, lambda _: [DOOR], record)] == paths[2:]


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit, GeneratorExit])
def test_what_stops_the_program_leaves_finished_pictures_in_the_record(tmp_path, error):
    paths, record = pictures(tmp_path, 4), tmp_path / "sizes.jsonl"

    def detector(image):
        if image[0, 0, 0] == 2:
            raise error
        return [DOOR]

    found = []
    with pytest.raises(error):
        found.extend(run(paths, detector, record))
    assert [row["path"] for row in ims.read_record(record)] == paths[:2]
    assert len(list(run(paths, lambda _: [DOOR], record))) == 2


def test_detectors_that_raise_do_not_end_the_stream(tmp_path):
    paths, record = pictures(tmp_path, 3), tmp_path / "sizes.jsonl"

    class OddError(Exception):
        def __str__(self):
            raise RuntimeError("no words")

    errors = {0: MemoryError(), 1: RecursionError("\ud800 deep"), 2: OddError()}

    def detector(image):
        raise errors[int(image[0, 0, 0])]

    outcomes = list(run(paths, detector, record))
    assert [outcome.error for outcome in outcomes] == list(errors.values())
    assert [row["error"]["type"] for row in ims.read_record(record)] == [
        "MemoryError",
        "RecursionError",
        "OddError",
    ]


def test_a_record_that_cannot_be_written_is_named_and_holds_what_was_given(tmp_path):
    pytest.importorskip("resource")
    paths = pictures(tmp_path, 12)
    whole = whole_run(tmp_path, paths)
    header = whole.index(b"\n") + 1
    rows = [len(line) + 1 for line in whole[header:].splitlines()]
    record = tmp_path / "full.jsonl"
    for room, kept in ((header // 2, None), (header + sum(rows[:3]) + rows[3] // 2, 3)):
        code = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({room}, {room}))"
        done = subprocess.run(
            [sys.executable, "-c", code + STREAM, str(record), "0", *paths],
            capture_output=True, text=True, check=False, timeout=60,
        )  # fmt: skip
        assert done.returncode == 1
        assert done.stderr.splitlines()[-1].startswith("OSError: ")
        assert str(record) in done.stderr.splitlines()[-1]
        assert done.stdout.split() == paths[: kept or 0]
        if kept:
            assert [row["path"] for row in ims.read_record(record)] == paths[:kept]
    _, errors = stream(record, 0, paths).communicate(timeout=60)
    assert errors == ""
    assert record.read_bytes() == whole
