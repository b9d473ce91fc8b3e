"""Many pictures: a stream past bad files, a record that is resumed, detections made before."""

import contextlib
import json
import os
import subprocess
import sys
import traceback
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import imgscale as ims
from imgscale.depth_sources import OneDistance

DOOR = ims.Detection("door", (20, 10, 40, 60))  # 50 px high
BOX = ims.Detection("box", (60, 40, 90, 70))  # 30 px
OPTIONS = {
    "priors": ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.02)]),
    "noise": ims.Noise(depth_rel=0.01),
}


def flat(image):
    height, width, _ = image.shape
    return ims.DepthMap([[4.0]], kind="relative", image_size=(width, height))


def pictures(folder, count):
    """Grey pictures, the number in their grey."""
    paths = []
    for number in range(count):
        path = folder / f"{number}.png"
        Image.fromarray(np.full((80, 120, 3), number, np.uint8)).save(path)
        paths.append(path)
    return paths


class Counting:
    """A detector that counts its pictures and fails on some."""

    def __init__(self, *bad):
        self.bad = bad
        self.seen = []

    def __call__(self, image):
        self.seen.append(int(image[0, 0, 0]))
        if self.seen[-1] in self.bad:
            raise RuntimeError(f"cannot look at {self.seen[-1]}")
        return [DOOR, BOX]


def run(paths, detector, **options):
    return list(ims.measure_many(paths, detector=detector, depth_source=flat, **OPTIONS | options))


def rows(record):
    return [json.loads(line) for line in record.read_text().splitlines()][1:]


# --- the stream ---


def test_every_picture_gives_what_measure_gives(tmp_path):
    paths = pictures(tmp_path, 3)
    outcomes = run(paths, Counting())
    assert [outcome.path for outcome in outcomes] == [str(path) for path in paths]
    for path, outcome in zip(paths, outcomes, strict=True):
        alone = ims.measure(path, detector=Counting(), depth_source=flat, **OPTIONS)
        assert outcome.measurement == alone
        assert outcome.error is None


def test_results_come_as_they_are_made_and_pictures_are_asked_for_one_by_one(tmp_path):
    detector, asked = Counting(), []

    def paths():
        for path in pictures(tmp_path, 5):
            asked.append(path)
            yield path

    stream = ims.measure_many(paths(), detector=detector, depth_source=flat, **OPTIONS)
    assert asked == detector.seen == []
    next(stream)
    next(stream)
    assert len(asked) == 2
    assert detector.seen == [0, 1]


def test_bad_pictures_do_not_stop_the_others(tmp_path):
    paths = pictures(tmp_path, 4)
    paths[0].write_bytes(b"this is no picture")
    missing = tmp_path / "missing.png"
    outcomes = run([*paths, missing], Counting(2))
    assert [type(outcome.error).__name__ for outcome in outcomes] == [
        "FileError",
        "NoneType",
        "RuntimeError",
        "NoneType",
        "FileNotFoundError",
    ]
    assert [outcome.measurement is None for outcome in outcomes] == [True, False, True, False, True]


def test_a_picture_without_references_is_an_outcome_too(tmp_path):
    (outcome,) = run(pictures(tmp_path, 1), lambda _: [BOX])
    assert isinstance(outcome.error, ims.FitError)


def test_an_interrupt_is_not_swallowed(tmp_path):
    def interrupted(_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(pictures(tmp_path, 1), interrupted)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"method": "exact"}, "`method` must be one of"),
        ({"axis": "length"}, "`axis` must be one of"),
        ({"priors": [1]}, "`priors` must be a PriorTable"),
        ({"use_prior": "yes"}, "`use_prior` must be a bool"),
        ({"detector": [DOOR]}, "`detector` must be a function of the picture, or a mapping"),
        ({"detector": {Path("a.png"): [DOOR]}}, "`detector` must have paths for keys, as strings"),
        ({"depth_source": 3.0}, "`depth_source` must be a function"),
        ({"paths": "photo.jpg"}, "`paths` must be a sequence of paths"),
        ({"colour": "red"}, "`options` must be those of `measure`; got colour"),
    ],
)
def test_a_wrong_option_is_refused_before_the_first_picture(change, message):
    arguments = {"paths": ["a.png"], "detector": Counting(), "depth_source": flat} | change
    with pytest.raises((TypeError, ValueError), match=message):
        ims.measure_many(arguments.pop("paths"), **arguments)


# --- detections made before ---


def test_detections_are_looked_up_by_ever_shorter_ends_of_the_path(tmp_path):
    folder = tmp_path / "camera 1"
    folder.mkdir()
    first, second, third = pictures(folder, 3)
    known = {
        str(first): [DOOR],
        "camera 1/1.png": [DOOR, BOX],
        "1.png": [],
        "2.png": [DOOR, BOX, BOX],
    }
    outcomes = run([first, second, third], known)
    assert [len(outcome.measurement.detections) for outcome in outcomes] == [1, 2, 3]


def test_a_picture_without_detections_of_its_own_is_not_given_anothers(tmp_path):
    (path,) = pictures(tmp_path, 1)
    (outcome,) = run([path], {"camera 2/0.png": [DOOR]})
    assert isinstance(outcome.error, LookupError)
    assert str(path) in str(outcome.error)


def test_depths_made_before_are_looked_up_too(tmp_path):
    paths = pictures(tmp_path, 1)
    depths = {"0.png": ims.ObjectDepths([4.0, 8.0], kind="relative")}
    (outcome,) = ims.measure_many(
        paths, detector={"0.png": [DOOR, BOX]}, depth_source=depths, **OPTIONS
    )
    door, box = outcome.measurement.estimates
    assert box.metres_per_pixel == pytest.approx(2 * door.metres_per_pixel, rel=1e-12)


# --- the record ---


def test_the_record_holds_every_picture_with_its_sizes_or_its_error(tmp_path):
    record = tmp_path / "sizes.jsonl"
    paths = pictures(tmp_path, 3)
    outcomes = run(paths, Counting(1), record=record)
    first, second, third = rows(record)
    assert first == json.loads(json.dumps(outcomes[0].to_dict()))
    assert first["objects"][1]["size_m"] == outcomes[0].measurement.estimates[1].size_m
    assert second == {
        "path": str(paths[1]),
        "error": {"type": "RuntimeError", "message": "cannot look at 1"},
    }
    assert third["path"] == str(paths[2])


def test_a_second_run_does_what_is_left_and_tries_failures_again(tmp_path):
    record = tmp_path / "sizes.jsonl"
    paths = pictures(tmp_path, 5)
    run(paths[:3], Counting(1), record=record)
    again = Counting()
    outcomes = run(paths, again, record=record)
    assert again.seen == [1, 3, 4]
    assert [outcome.path for outcome in outcomes] == [str(paths[i]) for i in (1, 3, 4)]
    assert [row["path"] for row in rows(record)] == [str(paths[i]) for i in (0, 1, 2, 1, 3, 4)]
    assert run(paths, again, record=record) == []


def test_a_run_that_is_killed_loses_nothing_that_was_done(tmp_path):
    record = tmp_path / "sizes.jsonl"
    paths = pictures(tmp_path, 4)
    script = f"""
import os, imgscale as ims
def detector(image):
    if image[0, 0, 0] == 2:
        os._exit(9)
    return [ims.Detection("door", (20, 10, 40, 60))]
for _ in ims.measure_many({[str(p) for p in paths]}, detector=detector, record={str(record)!r},
        depth_source=lambda image: ims.DepthMap([[4.0]], kind="relative", image_size=(120, 80)),
        priors=ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.02)]),
        noise=ims.Noise(depth_rel=0.01)):
    pass
"""
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 9
    assert [row["path"] for row in rows(record)] == [str(path) for path in paths[:2]]
    again = Counting()
    run(paths, again, record=record)
    assert again.seen == [2, 3]


@pytest.mark.parametrize("cut", [1, 20, 200])
def test_a_half_written_last_line_is_done_again(tmp_path, cut):
    record = tmp_path / "sizes.jsonl"
    paths = pictures(tmp_path, 3)
    run(paths, Counting(), record=record)
    whole = record.read_bytes()
    record.write_bytes(whole[:-cut])
    again = Counting()
    run(paths, again, record=record)
    assert again.seen == [2]
    assert record.read_bytes() == whole


def test_a_record_made_with_other_options_is_refused(tmp_path):
    record = tmp_path / "sizes.jsonl"
    paths = pictures(tmp_path, 1)
    run(paths, Counting(), record=record)
    before = record.read_bytes()
    other = {"method": "robust", "noise": ims.Noise(depth_rel=0.02)}
    with pytest.raises(ValueError, match="was made with other method, noise"):
        run(paths, Counting(), record=record, **other)
    assert record.read_bytes() == before
    spelled_out = {"method": "posterior", "axis": "height", "camera": None}
    assert run(paths, Counting(), record=record, **spelled_out) == []


@pytest.mark.parametrize(
    "content", ["label,size\ncar,1.5\n", "not even a line", "[1, 2]\n", '{"imgscale": 99}\n', "\n"]
)
def test_a_file_that_is_no_record_is_refused_and_left_alone(tmp_path, content):
    file = tmp_path / "notes.txt"
    file.write_text(content)
    with pytest.raises(ValueError, match=r"`record` must be a file that `measure_many` wrote"):
        run(pictures(tmp_path, 1), Counting(), record=file)
    assert file.read_text() == content


def test_a_broken_line_in_the_middle_is_named(tmp_path):
    record = tmp_path / "sizes.jsonl"
    paths = pictures(tmp_path, 2)
    run(paths, Counting(), record=record)
    lines = record.read_text().splitlines()
    record.write_text("\n".join([lines[0], lines[1][:40], lines[2]]) + "\n")
    with pytest.raises(ValueError, match="see line 2"):
        run(paths, Counting(), record=record)


# --- progress ---


def test_nothing_is_printed_where_there_is_no_terminal(tmp_path, capfd):
    run(pictures(tmp_path, 2), Counting())
    assert capfd.readouterr() == ("", "")


def test_a_terminal_shows_how_far_it_is(tmp_path):
    pytest.importorskip("tqdm")
    pty, termios = pytest.importorskip("pty"), pytest.importorskip("termios")
    paths = [str(path) for path in pictures(tmp_path, 2)]
    script = Path(tmp_path / "script.py")
    script.write_text(f"""
import imgscale as ims
for outcome in ims.measure_many({paths},
        detector=lambda image: [ims.Detection("door", (20, 10, 40, 60))],
        depth_source=lambda image: ims.DepthMap([[4.0]], kind="relative", image_size=(120, 80))):
    assert outcome.error is None, outcome.error
""")
    ours, theirs = pty.openpty()
    termios.tcsetwinsize(theirs, (24, 80))
    with subprocess.Popen([sys.executable, str(script)], stderr=theirs) as process:
        os.close(theirs)
        shown = b""
        with contextlib.suppress(OSError):  # Linux's way of saying that the other end is closed
            while chunk := os.read(ours, 1024):
                shown += chunk
    os.close(ours)
    assert process.returncode == 0, shown
    assert b"2/2" in shown


# --- what must not happen in silence ---


def test_one_entry_does_not_serve_two_pictures(tmp_path):
    paths = []
    for camera in ("cam1", "cam2"):
        (tmp_path / camera).mkdir()
        paths += pictures(tmp_path / camera, 1)
    record = tmp_path / "sizes.jsonl"
    first, second = run(paths, {"0.png": [DOOR]}, record=record)
    assert first.measurement is not None
    assert "must tell" in str(second.error)
    assert str(paths[0]) in str(second.error)
    (again,) = run(paths, {"0.png": [DOOR]}, record=record)
    assert "must tell" in str(again.error)
    both = run(paths, {"cam1/0.png": [DOOR], "cam2/0.png": [DOOR, BOX]})
    assert [len(outcome.measurement.detections) for outcome in both] == [1, 2]


def test_no_sizes_at_all_are_not_the_shipped_sizes_in_a_record(tmp_path):
    record = tmp_path / "sizes.jsonl"
    paths = pictures(tmp_path, 1)
    run(paths, Counting(), record=record, priors=ims.PriorTable([]))
    with pytest.raises(ValueError, match="made with other priors"):
        run(paths, Counting(), record=record, priors=None)


def test_another_depth_source_of_this_package_is_noticed(tmp_path):
    record = tmp_path / "sizes.jsonl"
    paths = pictures(tmp_path, 1)

    def sized_at(distance_m):
        source = OneDistance(distance_m)
        options = {"detector": Counting(), "depth_source": source, "record": record}
        return list(ims.measure_many(paths, **options, **OPTIONS))

    sized_at(1.0)
    assert sized_at(1.0) == []
    with pytest.raises(ValueError, match="made with other depth_source"):
        sized_at(50.0)


@pytest.mark.parametrize("bad", [3, b"a.png", None, np.zeros((2, 2, 3), np.uint8)], ids=str)
def test_what_is_no_path_is_an_outcome_and_the_next_one_follows(tmp_path, bad):
    record = tmp_path / "sizes.jsonl"
    (good,) = pictures(tmp_path, 1)
    first, second = run([bad, good], Counting(), record=record)
    assert isinstance(first.error, TypeError)
    assert "`paths` must hold paths" in str(first.error)
    assert second.measurement is not None
    assert len(rows(record)) == 2


@pytest.mark.parametrize("paths", [None, 7, b"a.png"])
def test_what_is_no_sequence_of_paths_is_refused_at_once(paths):
    with pytest.raises(TypeError, match="`paths` must be a sequence"):
        ims.measure_many(paths, detector=Counting(), depth_source=flat)


def test_failed_outcomes_do_not_keep_their_pictures(tmp_path):
    (outcome,) = run(pictures(tmp_path, 1), lambda _: [BOX])
    error, held = outcome.error, []
    while error:
        for frame, _ in traceback.walk_tb(error.__traceback__):
            held += [value for value in frame.f_locals.values() if isinstance(value, np.ndarray)]
        error = error.__cause__ or error.__context__
    assert held == []


@pytest.mark.parametrize("length", [1, 5, 10])
def test_a_header_that_was_cut_is_written_anew(tmp_path, length):
    record = tmp_path / "sizes.jsonl"
    paths = pictures(tmp_path, 1)
    run(paths, Counting(), record=record)
    whole = record.read_bytes()
    record.write_bytes(whole[:length])
    run(paths, Counting(), record=record)
    assert record.read_bytes() == whole


def test_an_outcome_is_a_measurement_or_an_error():
    for given in ({}, {"measurement": object(), "error": ValueError("no")}):
        with pytest.raises(ValueError, match="`measurement` or `error` must be given"):
            ims.Outcome(path="a.png", **given)


def test_pictures_without_references_are_not_tried_again_and_the_record_reads_back(tmp_path):
    record = tmp_path / "sizes.jsonl"
    paths = pictures(tmp_path, 3)

    def sees(image):
        return [DOOR, BOX] if image[0, 0, 0] else [BOX]

    first = run(paths[:2], sees, record=record)
    assert isinstance(first[0].error, ims.FitError)
    (broken,) = run([tmp_path / "missing.png"], sees, record=record)
    assert run(paths[:2], sees, record=record) == []
    Image.fromarray(np.full((80, 120, 3), 9, np.uint8)).save(tmp_path / "missing.png")
    (mended,) = run([tmp_path / "missing.png"], sees, record=record)
    read = ims.read_record(record)
    assert [row["path"] for row in read] == [*map(str, paths[:2]), str(tmp_path / "missing.png")]
    assert read[0]["error"]["type"] == "FitError"
    assert broken.error is not None
    assert read[2] == json.loads(json.dumps(mended.to_dict()))


@pytest.mark.parametrize("content", ["", "a,b\n", "{}\n"])
def test_what_is_no_record_is_not_read(tmp_path, content):
    file = tmp_path / "notes.txt"
    file.write_text(content)
    with pytest.raises(ValueError, match="`record` must be a file that `measure_many` wrote"):
        ims.read_record(file)
