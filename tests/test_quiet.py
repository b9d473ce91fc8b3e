"""No network, and no file that the caller did not name: imports, fits, pictures, commands."""

import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
WATCH = """
import os, sys
SEEN = []
def watch(event, arguments):
    network = event.startswith("socket.") and event != "socket.__new__"
    process = event in {"subprocess.Popen", "os.system", "os.exec", "os.posix_spawn"}
    made = event in {"os.mkdir", "os.rename", "os.remove", "os.link", "os.symlink", "os.truncate"}
    written = event == "open" and arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
    if network or process or made or written:
        SEEN.append((event, str(arguments[0])))
sys.addaudithook(watch)
import socket
def refuse(*_, **__):
    raise AssertionError("the network was asked for")
socket.create_connection = socket.getaddrinfo = refuse
socket.socket = type("Refused", (socket.socket,), {"__init__": refuse})
"""
MEASURE = """
import numpy as np
import imgscale as ims
from imgscale.datasets import motorcycle
scene = motorcycle.load()
model = ims.fit(scene.detections, scene.depth, scene.priors, noise=scene.noise)
ims.predict(model, scene.detections, scene.depth)
people = [ims.Detection("person", (9, 9, 60, 90)), ims.Detection("person", (70, 9, 120, 90))]
ims.leave_one_out(people, ims.ObjectDepths([2, 2], kind="relative"))
ims.ScaleModel.from_dict(model.to_dict())
model._repr_html_(), ims.explain(model), ims.PriorTable.default()
from imgscale import batch, measuring, detectors, depth_sources, datasets
from imgscale.detectors import FaceDetector
import skimage as ski
ims.measure(ski.data.astronaut(), detector=FaceDetector(), depth_source=depth_sources.OneDistance())
"""
DRAW = """
from imgscale.plotting import draw_residuals, draw_sizes
from imgscale.report import html_page
found = ims.measure(scene.image, detector=scene.detections, depth_source=scene.depth,
                    priors=scene.priors, noise=scene.noise)
draw_sizes(scene.image, scene.detections, found.estimates).figure.canvas.draw()
draw_residuals(model).figure.canvas.draw()
html_page([(found, scene.image)])
"""
TELL = "\nprint(*SEEN, sep='\\n')"
COMMAND = "from imgscale.cli import main; code = main({}); assert code == 0, code"
PHOTO = str(ROOT / "docs" / "images" / "motorcycle.jpg")
WORDS = ["measure", PHOTO, "--ground-plane", "--box", "person=10,10,90,200"]

needs_matplotlib = pytest.mark.skipif(not find_spec("matplotlib"), reason="matplotlib is absent")


@pytest.fixture
def alone(tmp_path):
    """Run code where home, temporary and working folders are empty; tell all that it touched."""
    homes = ("HOME", "TMPDIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME")
    folders = {name: tmp_path / name.lower() for name in homes}
    for folder in (*folders.values(), tmp_path / "cwd"):
        folder.mkdir()
    environment = os.environ | {name: str(folder) for name, folder in folders.items()}
    environment["PYTHONDONTWRITEBYTECODE"] = "1"
    if find_spec("matplotlib"):  # its own cache of fonts is its own business
        import matplotlib as mpl  # noqa: PLC0415

        environment["MPLCONFIGDIR"] = mpl.get_cachedir()

    def run(code):
        done = subprocess.run(
            [sys.executable, "-c", WATCH + code + TELL],
            capture_output=True, text=True, check=False, cwd=tmp_path / "cwd", env=environment,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        touched = re.findall(r"^\('([\w.]+)', '(.*)'\)$", done.stdout, flags=re.MULTILINE)
        of_fonts = environment.get("MPLCONFIGDIR")
        touched = [(event, path) for event, path in touched if path != of_fonts]
        files = {path.name for path in tmp_path.rglob("*") if path.is_file()}
        return touched, files

    return run


def test_the_watch_sees_the_network_processes_and_files(alone):
    code = """
import pathlib, subprocess
for ask in (socket.socket, lambda: socket.create_connection(("127.0.0.1", 9))):
    try: ask()
    except AssertionError: pass
    else: raise SystemExit("not refused")
from _socket import gethostbyname
gethostbyname("127.0.0.1")
subprocess.run([sys.executable, "-c", ""])
pathlib.Path("made.txt").write_text("made")
"""
    touched, files = alone(code)
    assert {event for event, _ in touched} >= {"socket.gethostbyname", "subprocess.Popen", "open"}
    assert files == {"made.txt"}


def test_an_import_touches_nothing(alone):
    every = """
import importlib, pkgutil, imgscale
for module in pkgutil.walk_packages(imgscale.__path__, "imgscale."):
    if not module.name.endswith("__main__"): importlib.import_module(module.name)
"""
    assert alone(every) == ([], set())


@pytest.mark.slow
def test_fitting_predicting_explaining_and_records_touch_nothing(alone):
    assert alone(MEASURE) == ([], set())


@pytest.mark.slow
@needs_matplotlib
def test_pictures_and_pages_touch_nothing(alone):
    assert alone(MEASURE + DRAW) == ([], set())


@pytest.mark.slow
@pytest.mark.parametrize("words", [WORDS, ["priors", "person"]], ids=["measure", "priors"])
def test_a_command_that_prints_touches_nothing(words, alone):
    assert alone(COMMAND.format(words)) == ([], set())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "named"),
    [
        ([*WORDS, "--out", "sizes.csv", "--out", "sizes.json"], {"sizes.csv", "sizes.json"}),
        pytest.param([*WORDS, "--out", "a.html"], {"a.html"}, marks=needs_matplotlib),
        pytest.param([*WORDS, "--out", "a.png"], {"a.png"}, marks=needs_matplotlib),
        pytest.param(["demo"], {"imgscale_demo.png"}, marks=needs_matplotlib),
    ],
    ids=["tables", "page", "picture", "demo"],
)
def test_a_command_leaves_the_files_that_were_named_alone(words, named, alone):
    touched, files = alone(COMMAND.format(words))
    assert files == named
    assert {event for event, _ in touched} <= {"open", "os.rename", "os.remove", "os.mkdir"}
    stems = {name.partition(".")[0] for name in named}
    written = {Path(path).name for event, path in touched if event == "open"}
    assert all(any(stem in name for stem in stems) for name in written)
