"""What is shipped: contents of the wheel and the sdist, their metadata, and the lock file."""

import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
NAME = f"imgscale-{PROJECT['version']}"
INFO = f"{NAME}.dist-info"
LOCK = ROOT / "requirements-dev.txt"
NEVER_RELEASED = "sphinx-basic-ng"  # betas alone; the documentation's theme needs it
LEFT_OUT = re.compile(
    r"__pycache__|\.pyc$|\.(hypothesis|pytest|mypy|ruff|import_linter)|\.benchmarks|\.venv|\.git/"
    r"|(^|/)(build|dist|_build|gallery|data)/|egg-info|\.so$|\.(npy|npz|pfm|tiff?|png|zip)$"
)


def build(source, target):
    """Build as installers do, without fetching anything."""
    pytest.importorskip("hatchling", reason="hatchling builds it")
    made = subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-d", str(target)],
        cwd=source, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    (wheel,), (sdist,) = target.glob("*.whl"), target.glob("*.tar.gz")
    return wheel, sdist


def contents(wheel):
    with zipfile.ZipFile(wheel) as file:
        return {name: file.read(name) for name in file.namelist()}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    return build(ROOT, tmp_path_factory.mktemp("dist"))


@pytest.fixture(scope="module")
def wheel(built):
    return contents(built[0])


@pytest.fixture(scope="module")
def sdist(built):
    with tarfile.open(built[1]) as file:
        members = [member for member in file if member.isfile()]
        return {member.name: file.extractfile(member).read() for member in members}


def ours(folder):
    """Files of a folder of the project, caches left out."""
    paths = [path for path in (ROOT / folder).rglob("*") if path.is_file()]
    names = {path.relative_to(ROOT / folder).as_posix() for path in paths}
    return {name for name in names if "__pycache__" not in name}


def test_the_wheel_holds_the_package_its_tables_and_its_mark_of_types_and_nothing_else(wheel):
    inside = {name.partition("/")[2] for name in wheel if name.startswith("imgscale/")}
    assert inside == ours("src/imgscale")
    assert inside > {"py.typed", "tables/README.md"}
    assert any(re.fullmatch(r"tables/priors_\d{4}_\d\d\.csv", name) for name in inside)
    others = {name for name in wheel if not name.startswith("imgscale/")}
    parts = ("METADATA", "WHEEL", "RECORD", "entry_points.txt", "licenses/LICENSE")
    assert others == {f"{INFO}/{part}" for part in parts}


def test_the_wheel_is_for_every_machine(wheel):
    tags = wheel[f"{INFO}/WHEEL"].decode()
    assert "Root-Is-Purelib: true" in tags
    assert "Tag: py3-none-any" in tags


def test_the_metadata_is_that_of_the_project(wheel):
    told = Parser().parsestr(wheel[f"{INFO}/METADATA"].decode())
    assert (told["Name"], told["Version"]) == ("imgscale", PROJECT["version"])
    assert told["Requires-Python"] == PROJECT["requires-python"]
    assert told["License-Expression"] == "BSD-3-Clause"
    assert told.get_all("License-File") == ["LICENSE"]
    assert told["Description-Content-Type"] == "text/markdown"
    assert told.get_payload().strip() == (ROOT / "README.md").read_text(encoding="utf-8").strip()
    assert set(told.get_all("Provides-Extra")) == set(PROJECT["optional-dependencies"])
    needs = [need for need in told.get_all("Requires-Dist") if "extra ==" not in need]
    assert sorted(needs) == sorted(PROJECT["dependencies"])


def test_the_licence_and_the_command_are_in_the_wheel(wheel):
    assert wheel[f"{INFO}/licenses/LICENSE"] == (ROOT / "LICENSE").read_bytes()
    assert "imgscale = imgscale.cli:main" in wheel[f"{INFO}/entry_points.txt"].decode()


def test_the_sdist_holds_what_one_needs_to_test_and_document_it_and_no_more(sdist):
    names = {name.removeprefix(f"{NAME}/") for name in sdist}
    loose = {name for name in names if "/" not in name}
    assert loose == {
        ".gitignore", "CHANGELOG.md", "CITATION.cff", "LICENSE", "PKG-INFO", "README.md",
        "SECURITY.md", "check.py", "pyproject.toml", "requirements-dev.txt",
    }  # fmt: skip
    folders = {name.partition("/")[0] for name in names - loose}
    assert folders == {"src", "tests", "docs", "examples", "benchmarks"}
    assert {name.removeprefix("src/") for name in names if name.startswith("src/")} == ours("src")


@pytest.mark.parametrize("made", ["wheel", "sdist"])
def test_no_cache_no_data_of_others_and_no_path_of_a_machine_is_shipped(made, request):
    files = request.getfixturevalue(made)
    assert [name for name in files if LEFT_OUT.search(name)] == []
    assert sum(map(len, files.values())) < 10e6
    home, here = str(Path.home()).encode(), str(ROOT).encode()
    places = [here] if len(home) < 6 else [here, home]  # "/root" is also an end of words
    assert [name for name, text in files.items() if any(place in text for place in places)] == []


@pytest.mark.slow
def test_the_sdist_builds_the_same_wheel(built, wheel, tmp_path):
    with tarfile.open(built[1]) as file:
        file.extractall(tmp_path, filter="data")
    again, _ = build(tmp_path / NAME, tmp_path / "again")
    assert contents(again) == wheel


# --- the lock file of development ---


def locked():
    """Every pin: requirement as it stands, and its hashes."""
    text = LOCK.read_text(encoding="utf-8").replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line and not line.lstrip().startswith("#")]
    pins = [line.split("--hash=") for line in lines]
    return [(Requirement(pin.strip()), [one.strip() for one in hashes]) for pin, *hashes in pins]


def wanted():
    """What the lock file is made from: dependencies and the groups dev and docs."""
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    groups = groups["dependency-groups"]

    def of(name):
        for need in groups[name]:
            yield from of(need["include-group"]) if isinstance(need, dict) else [need]

    return [Requirement(need) for need in {*PROJECT["dependencies"], *of("dev"), *of("docs")}]


def test_every_locked_version_is_exact_released_and_has_its_hashes():
    assert len(locked()) > 50
    for need, hashes in locked():
        (pin,) = need.specifier
        assert pin.operator == "==", need
        assert not Version(pin.version).is_prerelease or need.name == NEVER_RELEASED, need
        assert hashes, need
        assert all(re.fullmatch(r"sha256:[0-9a-f]{64}", one) for one in hashes), need


def test_the_locked_versions_are_those_that_the_project_asks_for():
    versions = {}
    for need, _ in locked():
        (pin,) = need.specifier
        versions.setdefault(need.name, []).append(pin.version)
    for need in wanted():
        name = re.sub(r"[-_.]+", "-", need.name).lower()
        assert versions.get(name), need
        assert all(version in need.specifier for version in versions[name]), need


def test_the_lock_file_names_no_address():
    assert not re.search(r"https?:|file:|index|/\w+/", LOCK.read_text(encoding="utf-8"))
