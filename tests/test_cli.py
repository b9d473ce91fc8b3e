"""The command line as a whole: help, messages, exit codes, Ctrl-C, pipes, priors, the demo."""

import argparse
import csv
import io
import json
import os
import re
import signal
import subprocess
import sys
import threading
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import imgscale as ims
from imgscale.cli import main
from imgscale.cli._messages import OPTIONS
from imgscale.cli._options import FORMATS
from imgscale.cli._parser import make_parser

COMMANDS = ("measure", "calibrate", "priors", "demo")
HAS_TERMINATION = os.name == "posix"


def photo(path, size=(640, 480)):
    Image.new("RGB", size, "#667755").save(path)
    return path


def run(*words, cwd, code=None, **options):
    """Run the command line in a process of its own."""
    start = ["-m", "imgscale"] if code is None else ["-c", code]
    return subprocess.run(
        [sys.executable, *start, *words],
        capture_output=True,
        text=True,
        check=False,
        cwd=cwd,
        timeout=120,
        **options,
    )


def two_photos(folder):
    """A whole and a broken photo, and the words that measure both."""
    photo(folder / "good.jpg")
    (folder / "broken.jpg").write_bytes(b"\xff\xd8\xff no picture")
    found = [
        {"score": 1, "label": "door", "box": {"xmin": 100, "ymin": 48, "xmax": 180, "ymax": 240}}
    ]
    for name in ("good", "broken"):
        (folder / f"{name}.json").write_text(json.dumps(found))
    return ["measure", str(folder / "broken.jpg"), str(folder / "good.jpg"), "--ground-plane",
            "--detections", str(folder), "--format", "transformers"]  # fmt: skip


# --- help ---


def options_of(command):
    """Every option that a command's parser knows, and the parser."""
    [commands] = [a for a in make_parser()._actions if isinstance(a, argparse._SubParsersAction)]
    parser = commands.choices[command]
    return parser, [word for action in parser._actions for word in action.option_strings]


@pytest.mark.parametrize("command", COMMANDS)
def test_help_lists_every_option_says_what_it_does_and_has_examples(command, capsys):
    with pytest.raises(SystemExit) as caught:
        main([command, "--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    parser, options = options_of(command)
    assert all(option in text for option in options)
    assert all(action.help for action in parser._actions)
    assert text.startswith(f"usage: imgscale {command}")
    assert text.count(f"imgscale {command}") >= 2
    assert "examples" in text


@pytest.mark.parametrize("command", COMMANDS)
def test_the_examples_of_help_are_words_that_the_parser_takes(command, capsys):
    with pytest.raises(SystemExit):
        main([command, "--help"])
    text = capsys.readouterr().out.partition("examples\n")[2].replace("\\\n", " ")
    lines = [line.strip() for line in text.splitlines() if line.startswith("  ")]
    examples = [line for line in lines if line.startswith(f"imgscale {command}")]
    assert examples
    for example in examples:
        words = re.split(r"  +[a-z]| > ", re.sub(r"(?<=\S) +(?=-)", " ", example))[0].split()
        assert make_parser().parse_args([word.strip('"') for word in words[1:]]).command == command


def test_exit_codes_are_documented(capsys):
    with pytest.raises(SystemExit):
        main(["measure", "--help"])
    codes = capsys.readouterr().out.partition("exit codes")[2]
    assert re.findall(r"^  (\d+) ", codes, re.MULTILINE) == ["0", "1", "2", "130", "141"]


def test_every_format_that_help_names_has_a_reader():
    from imgscale.cli._inputs import SINGLE, WHOLE  # noqa: PLC0415 - what only runs load

    assert sorted([*SINGLE, *WHOLE]) == sorted(FORMATS)


def test_the_version_is_that_of_the_package(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["--version"])
    assert caught.value.code == 0
    assert capsys.readouterr().out == f"imgscale {ims.__version__}\n"


HEAVY = ("skimage", "scipy", "matplotlib", "PIL", "tqdm", "csv", "imgscale.detectors")


def test_help_loads_nothing_heavy(tmp_path):
    code = (
        "import sys\nfrom imgscale.cli import main\n"
        "try: main(['measure', '--help'])\nexcept SystemExit: pass\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)"
    )
    assert run(cwd=tmp_path, code=code).stderr.strip() == "[]"


# --- messages ---


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "imgscale: the following arguments are required: COMMAND"),
        (["measur"], "invalid choice: 'measur'"),
        (["measure"], "the following arguments are required: PHOTO"),
        (["measure", "a.jpg"], "--depth --ground-plane --one-distance --model is required"),
        (["measure", "a.jpg", "--ground-plane", "--depth", "d"], "--depth: not allowed with"),
        (["measure", "a.jpg", "--ground", "--box", "a=1,2,3,4"], "is required"),  # no short forms
        (["measure", "a.jpg", "--ground-plane", "--reference", "pole=1,0"], "--reference: must"),
        (["measure", "a.jpg", "--ground-plane", "--box", "1,2,3,4"], "--box: must be LABEL="),
        (["measure", "a.jpg", "--ground-plane", "--level", "90"], "--level: must be a probability"),
        (["measure", "a.jpg", "--ground-plane", "--level", "0.9999999999999"], "a probability"),
        (["measure", "a.jpg", "--ground-plane", "--focal-px", "nan"], "--focal-px: must be"),
        (["measure", "a.jpg", "--ground-plane", "--focal-px", "7_00"], "--focal-px: must be"),
        (["measure", "a.jpg", "--ground-plane", "--focal-px", "1e-300"], "--focal-px: must be"),
        (["measure", "a.jpg", "--ground-plane", "--box-std-px", "1e308"], "--box-std-px: must be"),
        (["measure", "a.jpg", "--ground-plane", "--box-rel-std", "11"], "--box-rel-std: must be"),
        (["measure", "a.jpg", "--ground-plane", "--horizon", "1e300"], "--horizon: must be"),
        (["measure", "a.jpg", "--ground-plane", "--min-score", "20"], "--min-score: must be"),
        (["measure", "a.jpg", "--depth", "d", "--kind", "disparity"], "--kind: invalid choice"),
        (["measure", "a.jpg", "--ground-plane", "--unit", "yd"], "--unit: invalid choice: 'yd'"),
        (["calibrate", "a.jpg", "--box", "pole=1,2,3,4"], "required: --out"),
        (["demo", "--nonsense"], "unrecognized arguments: --nonsense"),
        (["demo", "--ot", "x.png"], "unrecognized arguments: --ot x.png; did you mean --out"),
    ],
)  # fmt: skip
def test_words_that_make_no_sense_are_refused_with_the_usage(words, message, capsys):
    with pytest.raises(SystemExit) as caught:
        main(words)
    assert caught.value.code == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    *usage, last = captured.err.splitlines()
    assert usage[0].startswith("usage: imgscale")
    assert last.startswith("imgscale: ")
    assert message in last
    assert re.search(r"See `imgscale( \w+)? --help`\.$", last)


def test_one_bad_photo_does_not_stop_the_others(tmp_path, capsys):
    code = main(two_photos(tmp_path))
    captured = capsys.readouterr()
    assert code == 1
    [line] = captured.err.splitlines()
    assert line.startswith("imgscale: ")
    assert str(tmp_path / "broken.jpg") in line
    assert captured.out.startswith(str(tmp_path / "good.jpg"))


def test_a_photo_that_is_not_there_is_named_once(tmp_path, capsys):
    words = ["measure", str(tmp_path / "no.jpg"), "--ground-plane", "--box", "door=1,2,30,40"]
    assert main(words) == 1
    assert (
        capsys.readouterr().err == f"imgscale: {tmp_path / 'no.jpg'}: No such file or directory\n"
    )


def test_messages_name_options_and_not_python(tmp_path, capsys):
    words = ["measure", str(photo(tmp_path / "a.jpg")), "--ground-plane"]
    assert main([*words, "--box", "gate=930,309,1110,523"]) == 1
    assert main([*words, "--box", "thing=30,30,110,223"]) == 1
    beyond, unknown = capsys.readouterr().err.splitlines()
    assert "Detection.with_box" not in beyond
    assert unknown.endswith('Add sizes with --reference "LABEL=SIZE" or --priors FILE.')


@pytest.mark.parametrize(
    "words",
    [
        ["--ground-plane", "--box", "thing=1,2,30,40"],
        ["--ground-plane", "--box", "door=930,309,1110,523"],
        ["--one-distance", "--detections", "none.json", "--format", "transformers"],
        ["--depth", "bad.png", "--kind", "metric", "--box", "door=1,2,30,40"],
        ["--depth", "empty.npy", "--kind", "metric", "--box", "door=1,2,30,40"],
    ],
)
@pytest.mark.parametrize("name", ["a.jpg", "deep.png", "broken.jpg"])
def test_no_message_has_words_of_python(tmp_path, capsys, monkeypatch, words, name):
    monkeypatch.chdir(tmp_path)
    photo(tmp_path / "a.jpg")
    Image.new("I;16", (640, 480)).save("deep.png")
    Path("broken.jpg").write_bytes(b"no picture")
    Path("none.json").write_text("[]")
    Path("bad.png").write_bytes(b"\x89PNG\r\n\x1a\n no picture")
    np.save("empty.npy", np.full((480, 640), np.nan))
    assert main(["measure", name, *words]) == 1
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith(f"imgscale: {name}: ")
    assert not re.search(r"`\w+`|\(\)|codec|object at|_io|sys\.", line)


def test_every_word_that_is_translated_is_still_in_the_library():
    source = Path(ims.__file__).parent
    texts = [p.read_text() for p in source.rglob("*.py") if p.parent.name != "cli"]
    whole = re.sub(r'"\s*f?"', "", "\n".join(texts))
    assert [words for words in OPTIONS if words not in whole] == []


def test_warnings_are_one_line_each_too(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("PIL.Image.MAX_IMAGE_PIXELS", 640 * 480 - 1)
    words = ["measure", str(photo(tmp_path / "a.jpg")), "--ground-plane", "--box", "door=1,2,3,9"]
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        shown = warnings.showwarning
        assert main(words) == 0
        assert warnings.showwarning is shown
    lines = capsys.readouterr().err.splitlines()
    assert lines
    assert all(line.startswith("imgscale: warning: Image size") for line in lines)


@pytest.mark.skipif(not HAS_TERMINATION, reason="a shell of POSIX")
@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
@pytest.mark.parametrize(("command", "code"), [("priors --csv", 0), ("priors xyzzy", 1)])
def test_closed_streams_are_no_error(tmp_path, closed, command, code):
    line = f'"{sys.executable}" -m imgscale {command} {closed}'
    done = subprocess.run(
        ["/bin/sh", "-c", line], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == code
    assert "Traceback" not in done.stderr
    assert done.stdout == "" or ("2>&-" in closed and code == 0)


@pytest.mark.parametrize(
    "content",
    [b"{", b"\xff\xfe\xfa", b"[" * 100_000, b"[" + b"1" * 5000 + b"]", b"[1]", b'{"images": 1}'],
    ids=["broken", "bytes", "deep", "long", "list", "member"],
)
@pytest.mark.parametrize("form", ["coco", "megadetector", "rekognition", "transformers"])
def test_files_that_cannot_be_read_are_told_without_words_of_python(
    tmp_path, capsys, content, form
):
    (tmp_path / "found.json").write_bytes(content)
    words = ["measure", str(photo(tmp_path / "a.jpg")), "--ground-plane", "--detections",
             str(tmp_path / "found.json"), "--format", form]  # fmt: skip
    assert main(words) in (1, 2)
    [line] = capsys.readouterr().err.splitlines()
    assert "found.json" in line
    assert not re.search(r"codec|<.*object|_io|sys\.|recursion|Error", line)


def test_what_steers_a_terminal_is_shown_and_not_sent(tmp_path, capsys):
    words = ["measure", str(photo(tmp_path / "a.jpg")), "--ground-plane", "--box",
             "door=100,48,180,240", "--box", "\x1b[2Jgate\n=320,120,400,216"]  # fmt: skip
    assert main(words) == 0
    text = capsys.readouterr().out
    assert "\x1b" not in text
    assert "\\x1b[2Jgate" in text


def test_a_terminal_of_few_letters_shows_escapes(tmp_path):
    photo(tmp_path / "a.jpg")
    done = run(
        "measure", "a.jpg", "--ground-plane", "--box", "door=100,48,180,240", "--box",
        "Größe=320,120,400,216", cwd=tmp_path, env={**os.environ, "PYTHONIOENCODING": "ascii"},
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert "Gr\\xf6\\xdfe" in done.stdout


def test_an_error_that_nobody_expected_is_one_line_too(tmp_path, capsys, monkeypatch):
    def broken(*_, **__):
        raise ZeroDivisionError

    monkeypatch.setattr("imgscale.cli._measure.measure", broken)
    words = ["measure", str(photo(tmp_path / "a.jpg")), "--ground-plane", "--box", "door=1,2,3,9"]
    assert main(words) == 1
    assert capsys.readouterr().err == f"imgscale: {tmp_path / 'a.jpg'}: ZeroDivisionError\n"


# --- what is printed ---


def test_the_table_has_size_interval_and_unit(tmp_path, capsys):
    words = ["measure", str(photo(tmp_path / "a.jpg")), "--ground-plane", "--box",
             "door=100,48,180,240", "--box", "crate=320,120,400,216"]  # fmt: skip
    assert main([*words, "--unit", "cm", "--level", "0.5"]) == 0
    lines = capsys.readouterr().out.splitlines()
    boxes = [
        ims.Detection("door", (100, 48, 180, 240)),
        ims.Detection("crate", (320, 120, 400, 216)),
    ]
    model = ims.fit(boxes, ims.GroundPlane(image_size=(640, 480)))
    crate = ims.predict(model, boxes)[1]
    assert lines[0] == str(tmp_path / "a.jpg")
    assert lines[1] == str(model)
    assert "reservations: SINGLE_REFERENCE" in lines[2]
    assert re.split("  +", lines[3]) == ["object", "height cm", "50 % interval", "distance m"]
    size, interval = re.split("  +", lines[6])[1:3]
    low, high = (float(word) for word in interval.split(" to "))
    assert float(size) == pytest.approx(100 * crate.size_m, abs=5)
    assert (low, high) == pytest.approx(tuple(100 * end for end in crate.interval(0.5)), abs=5)
    assert lines[5].endswith("REFERENCE")


def test_results_go_to_standard_output_and_nothing_else(tmp_path):
    done = run(*two_photos(tmp_path), cwd=tmp_path)
    assert done.returncode == 1
    assert "imgscale:" not in done.stdout
    assert len(done.stderr.splitlines()) == 1


# --- stopped ---


def boxed_photos(folder, names=("a.jpg", "b.jpg", "c.jpg", "d.jpg", "e.jpg")):
    found = {
        "images": [{"id": i, "file_name": name} for i, name in enumerate(names)],
        "categories": [{"id": 1, "name": "door"}],
        "annotations": [
            {"image_id": i, "category_id": 1, "bbox": [100, 48, 80, 192]} for i in range(len(names))
        ],
    }
    (folder / "in").mkdir()
    for name in names:
        photo(folder / "in" / name)
    (folder / "found.json").write_text(json.dumps(found))
    return ["measure", "in", "--ground-plane", "--detections", "found.json", "--format", "coco"]


def test_ctrl_c_keeps_what_is_finished(tmp_path, monkeypatch):
    import imgscale.cli._measure as command  # noqa: PLC0415 - what only runs load

    real, calls = command.measure, []

    def stopped(image, **options):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return real(image, **options)

    monkeypatch.chdir(tmp_path)
    words = boxed_photos(tmp_path)
    monkeypatch.setattr(command, "measure", stopped)
    assert main([*words, "--out", "sizes.csv", "--out", "sizes.json"]) == 130
    with (tmp_path / "sizes.csv").open(newline="") as file:
        assert [row["photo"] for row in csv.DictReader(file)] == ["in/a.jpg", "in/b.jpg"]
    assert len(json.loads((tmp_path / "sizes.json").read_text())) == 2
    assert not list(tmp_path.glob(".*"))


@pytest.mark.slow
@pytest.mark.skipif(not HAS_TERMINATION, reason="signals of POSIX")
def test_a_real_interrupt_ends_quietly_with_130(tmp_path):
    words = boxed_photos(tmp_path, [f"{number:03}.jpg" for number in range(300)])
    started = subprocess.Popen(
        [sys.executable, "-m", "imgscale", *words], env={**os.environ, "PYTHONUNBUFFERED": "1"},
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    limit = threading.Timer(60, started.kill)
    limit.start()
    try:
        assert started.stdout.readline()  # the first photo is done, some hundred are not
        started.send_signal(signal.SIGINT)
        _, error = started.communicate(timeout=60)
    finally:
        limit.cancel()
        started.kill()
    assert started.returncode == 130
    assert "Traceback" not in error


@pytest.mark.skipif(not HAS_TERMINATION, reason="pipes of POSIX")
def test_a_reader_that_goes_away_ends_it_quietly(tmp_path):
    with subprocess.Popen(
        [sys.executable, "-m", "imgscale", "priors"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as started:  # fmt: skip
        started.stdout.close()
        error = started.stderr.read()
        assert started.wait(60) == 141
    assert error == ""


# --- priors ---


def test_priors_lists_every_row_of_the_table(capsys):
    assert main(["priors"]) == 0
    lines = capsys.readouterr().out.splitlines()
    table = ims.PriorTable.default()
    assert len(lines) == len(table) + 4
    for line, row in zip(lines[2:], table, strict=False):
        assert line.startswith(f"{row.label} ")
        assert float(line.split()[-4]) == row.mean_m


@pytest.mark.parametrize("region", ["world", "eu", "us"])
def test_the_rows_of_a_label_have_their_source(capsys, region):
    assert main(["priors", "licence", "plate", "--region", region]) == 0
    text = capsys.readouterr().out
    for row in ims.PriorTable.default(region).lookup("licence plate"):
        assert f"{row.mean_m:g}" in text
        assert row.source in text
        assert all(alias in text for alias in row.aliases)


def test_an_alias_finds_its_label(capsys):
    assert main(["priors", "Human"]) == 0
    assert "person" in capsys.readouterr().out


def test_an_unknown_label_is_an_error_that_names_the_nearest(capsys):
    assert main(["priors", "lisence plate"]) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    [line] = captured.err.splitlines()
    assert '"lisence plate", near: licence plate' in line
    assert main(["priors", "xyzzy"]) == 1
    assert "nothing near it" in capsys.readouterr().err


def test_the_table_that_priors_writes_is_one_that_measure_reads(tmp_path, capsys):
    assert main(["priors", "--csv", "--region", "eu"]) == 0
    text = capsys.readouterr().out
    (tmp_path / "mine.csv").write_text(text, encoding="utf-8")
    assert ims.PriorTable.from_csv(tmp_path / "mine.csv", region="eu") == ims.PriorTable.default(
        "eu"
    )
    assert len(list(csv.reader(io.StringIO(text)))) == len(ims.PriorTable.default("eu")) + 1


# --- the demo ---


def test_the_demo_writes_a_page(tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    out = tmp_path / "demo.html"
    assert main(["demo", "--out", str(out)]) == 0
    assert capsys.readouterr().out.endswith(f"wrote {out}\n")
    text = out.read_text(encoding="utf-8")
    assert "rear tyre" in text
    assert "data:image" in text


@pytest.mark.parametrize("out", ["demo", "demo.pdf", "no/such/demo.png"])
def test_where_the_demo_cannot_write_it_says_so_first(tmp_path, capsys, out):
    assert main(["demo", "--out", str(tmp_path / out)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("imgscale: --out must ")


# --- the package and its entry points ---


def test_python_m_and_the_script_are_the_same(tmp_path):
    script = Path(sys.executable).with_name("imgscale")
    if not script.exists():
        pytest.skip("the package's script is not installed beside this interpreter")
    ours = run("priors", "door", cwd=tmp_path)
    theirs = subprocess.run([script, "priors", "door"], capture_output=True, text=True, check=False)
    assert (ours.returncode, ours.stdout) == (0, theirs.stdout)


def test_bars_are_for_terminals_only(tmp_path, monkeypatch, capsys):
    pytest.importorskip("tqdm", reason="tqdm is not installed")
    monkeypatch.chdir(tmp_path)
    assert main([*boxed_photos(tmp_path), "--out", "sizes.csv"]) == 0
    assert capsys.readouterr().err == ""


def test_depth_of_another_photo_beside_a_named_folder_is_not_taken(tmp_path, capsys):
    photo(tmp_path / "a.jpg")
    (tmp_path / "depth").mkdir()
    np.save(tmp_path / "depth" / "b.npy", np.ones((4, 4)))
    words = ["measure", str(tmp_path / "a.jpg"), "--depth", str(tmp_path / "depth"), "--kind",
             "relative", "--box", "door=1,2,30,40"]  # fmt: skip
    assert main(words) == 2
    assert "has no a.npy or a.npz or" in capsys.readouterr().err
