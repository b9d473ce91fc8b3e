"""Optional packages that are absent, broken or too old: who minds, and what they are told."""

import importlib
import re
import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import skimage as ski

import imgscale as ims
from imgscale import _optional, batch, depth_sources, detectors, plotting
from imgscale.cli import main
from imgscale.report import html_page

PYPROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"
PEOPLE = [ims.Detection("person", (60, 40, 110, 200)), ims.Detection("box", (20, 150, 60, 190))]
PICTURE = np.ascontiguousarray(ski.data.astronaut()[:256, 100:356])
PLANE = ims.GroundPlane(image_size=(256, 256))
FLAT = ims.DepthMap(np.linspace(2, 4, 16).reshape(4, 4), kind="metric", image_size=(256, 256))
PHOTO = PYPROJECT.parent / "docs" / "images" / "motorcycle.jpg"


def metric():
    camera = ims.Camera(300.0, focal_rel_std=0.01, image_size=(256, 256))
    return ims.fit(PEOPLE, FLAT, camera=camera)


def page():
    found = ims.measure(PICTURE, detector=PEOPLE, depth_source=FLAT)
    return html_page([(found, PICTURE)])


def frame():
    """A frame of pandas, and one of nothing where that is absent."""
    pd = pytest.importorskip("pandas") if find_spec("narwhals") else ModuleType("pandas")
    columns = {"image_id": ["a"] * 2, "label": ["door", "vase"], "pixels": [200.0, 90.0]}
    return pd.DataFrame(columns | {"depth": [4.0, 4.0]}) if find_spec("narwhals") else None


def table():
    if not find_spec("pyarrow"):
        return None
    pa = importlib.import_module("pyarrow")
    columns = {"label": [["door", "vase"]], "pixels": [[200.0, 90.0]], "depth": [[4.0, 4.0]]}
    return pa.table(columns)


FRAME, TABLE = frame(), table()
NEED = {
    "draw_sizes": (
        lambda: plotting.draw_sizes(PICTURE, PEOPLE, ims.predict(metric(), PEOPLE, FLAT)),
        "matplotlib",
    ),
    "draw_scale_bar": (
        lambda: plotting.draw_scale_bar(metric(), FLAT, at=PEOPLE[0]),
        "matplotlib",
    ),
    "draw_scale_map": (lambda: plotting.draw_scale_map(metric(), FLAT), "matplotlib"),
    "draw_residuals": (lambda: plotting.draw_residuals(metric()), "matplotlib"),
    "draw_ground_plane": (
        lambda: plotting.draw_ground_plane(ims.fit(PEOPLE, PLANE)),
        "matplotlib",
    ),
    "html_page": (page, "matplotlib"),
    "fit_table": (lambda: batch.fit_table(FRAME, kind="relative"), "narwhals"),
    "fit_arrow": (lambda: batch.fit_arrow(TABLE, kind="relative"), "pyarrow"),
    "boxes to supervision": (lambda: detectors.to_supervision(PEOPLE), "supervision"),
    "maps to supervision": (lambda: depth_sources.to_supervision(FLAT), "supervision"),
    "stereo_disparity": (
        lambda: depth_sources.stereo_disparity(PICTURE, np.roll(PICTURE, -8, axis=1)),
        "cv2",
    ),
}
EXTRAS = {
    "matplotlib": "plot",
    "narwhals": "frames",
    "pyarrow": "arrow",
    "supervision": "supervision",
    "cv2": "stereo",
    "boto3": "aws",
    "tqdm": "progress",
    "ray": "ray",
    "torch": "transformers",
}
NOT_IMPORTED = {"aws", "progress", "ray"}  # what users bring, and a bar that is left out
INSTALLED = {package for package in EXTRAS if find_spec(package)}


def extras():
    return tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]["optional-dependencies"]


@pytest.fixture
def hide(monkeypatch):
    """Make a package absent, and whatever of it was imported."""

    def hidden(package):
        for name in list(sys.modules):
            if name.partition(".")[0] == package:
                monkeypatch.delitem(sys.modules, name)
        monkeypatch.setitem(sys.modules, package, None)

    return hidden


# --- absent ---


def test_every_extra_is_hidden_here():
    assert set(EXTRAS.values()) == set(extras()) - {"all"}


@pytest.mark.parametrize("package", EXTRAS)
def test_without_a_package_those_who_need_it_name_the_pip_line_and_all_others_work(package, hide):
    hide(package)
    minded = {}
    for name, (call, needed) in NEED.items():
        if needed != package and needed not in INSTALLED:
            continue
        try:
            call()
        except ims.MissingDependencyError as error:
            minded[name] = str(error)
    line = f"'{package}'; install it with `pip install 'imgscale[{EXTRAS[package]}]'`."
    others = [text for text in minded.values() if not text.endswith(f" optional package {line}")]
    assert others == []
    assert set(minded) == {name for name, (_, needed) in NEED.items() if needed == package}
    assert minded or EXTRAS[package] in {*NOT_IMPORTED, "transformers"}


@pytest.mark.parametrize("ending", ["png", "html"])
def test_the_command_line_names_the_pip_line_before_it_measures(ending, hide, tmp_path, capsys):
    hide("matplotlib")
    out = tmp_path / f"sizes.{ending}"
    words = ["measure", str(PHOTO), "--ground-plane", "--box", "person=10,10,90,200"]
    assert main([*words, "--out", str(out)]) != 0
    assert "`pip install 'imgscale[plot]'`" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


BARE = """
import importlib, pkgutil, sys
sys.modules.update(dict.fromkeys(HIDDEN))
import imgscale as ims
from imgscale.cli import main
for module in pkgutil.walk_packages(ims.__path__, "imgscale."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
words = ["measure", PHOTO, "--ground-plane", "--detections", "found", "--format", "transformers"]
codes = [main([*words, "--out", f"sizes.{ending}"]) for ending in ("csv", "json")]
found = ims.measure_many([PHOTO], detector=lambda _: [ims.Detection("person", (10, 10, 90, 200))],
                         depth_source=lambda image: ims.GroundPlane(image_size=image.shape[1::-1]),
                         progress=True)
sizes = [round(one.measurement.estimates[0].size_m, 1) for one in found]
print(codes, sizes, [name for name in HIDDEN if sys.modules[name]])
"""


@pytest.mark.slow
def test_without_any_extra_all_modules_import_and_photos_are_measured(tmp_path):
    (tmp_path / "found").mkdir()
    box = {"xmin": 10, "ymin": 10, "xmax": 90, "ymax": 200}
    (tmp_path / "found" / "motorcycle.json").write_text(
        f'[{{"score": 1, "label": "person", "box": {box}}}]'.replace("'", '"')
    )
    code = f"HIDDEN, PHOTO = {set(EXTRAS)!r}, {str(PHOTO)!r}\n{BARE}"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True, text=True, check=True, cwd=tmp_path,
    )  # fmt: skip
    assert re.fullmatch(r"\[0, 0\] \[1\.\d\] \[\]", done.stdout.splitlines()[-1])
    assert "1." in (tmp_path / "sizes.csv").read_text()


# --- half there ---


@pytest.fixture
def stand_in(tmp_path, monkeypatch):
    """Put a package of one module, or a folder without any, in front of all others."""

    def made(package, code):
        for name in list(sys.modules):
            if name.partition(".")[0] == package:
                monkeypatch.delitem(sys.modules, name)
        monkeypatch.syspath_prepend(tmp_path)
        (tmp_path / package).mkdir()
        if code is not None:
            (tmp_path / package / "__init__.py").write_text(code, encoding="utf-8")

    yield made
    for name in [name for name in sys.modules if name.partition(".")[0] in EXTRAS]:
        if str(tmp_path) in str(getattr(sys.modules[name], "__path__", "")):
            del sys.modules[name]


ERRORS = {
    "a library of the system": "raise ImportError('libGL.so.1: cannot open shared object file')",
    "another ABI": "raise AttributeError('_ARRAY_API not found')",
    "what it needs": "import no_such_package_zq",
}


@pytest.mark.parametrize("code", ERRORS.values(), ids=ERRORS)
@pytest.mark.parametrize("entry", ["stereo_disparity", "maps to supervision", "draw_residuals"])
def test_a_package_that_lacks_something_is_told_with_its_own_words(entry, code, stand_in):
    call, package = NEED[entry]
    stand_in(package, code)
    line = f"`pip install --force-reinstall 'imgscale[{EXTRAS[package]}]'`."
    law = f"'{package}', which is there but cannot be imported (.*); install it anew with "
    with pytest.raises(ims.MissingDependencyError, match=law + re.escape(line)) as caught:
        call()
    assert str(caught.value.__cause__) in str(caught.value)


def test_a_folder_of_a_packages_name_is_not_the_package(stand_in, monkeypatch):
    stand_in("leftover_zq", None)
    law = re.escape("'leftover_zq'; install it with `pip install 'imgscale[plot]'`.")
    with pytest.raises(ims.MissingDependencyError, match=law):
        _optional.require("leftover_zq", extra="plot", purpose="A test")
    monkeypatch.delitem(sys.modules, "leftover_zq", raising=False)


# --- too old ---


def stated(extra):
    """The least version that an extra asks for, by the file that says so."""
    return re.search(r">=([\d.]+)$", extras()[extra][-1])[1]


@pytest.mark.parametrize(
    "version", ["2.0", "3.8", "3.8.4", "3.8.4rc1+local", "0"], ids=lambda v: f"version {v}"
)
def test_a_package_that_is_too_old_is_told_with_the_version_it_takes(version, stand_in):
    stand_in("matplotlib", f"__version__ = {version!r}\n")
    law = f"from version {stated('plot')}; got {version}. Upgrade it with `pip install 'imgscale["
    with pytest.raises(ims.MissingDependencyError, match=re.escape(law)):
        _optional.require("matplotlib", extra="plot", purpose="A test")


@pytest.mark.parametrize(
    "version", ["3.9", "3.9.0", "3.10.1", "10.0", "3.9.dev0+cpu", "unknown", None]
)
def test_a_package_that_is_new_enough_or_does_not_tell_is_taken(version, stand_in):
    stand_in("matplotlib", f"__version__ = {version!r}\n")
    found = _optional.require("matplotlib", extra="plot", purpose="A test")
    assert found.__version__ == version
