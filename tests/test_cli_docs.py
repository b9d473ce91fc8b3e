"""The page on the command line: each of its sessions runs and prints what stands there."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("matplotlib", reason="matplotlib is not installed")

SCRIPT = Path(sys.executable).with_name("imgscale")
PAGE = (Path(__file__).parents[1] / "docs" / "command_line.md").read_text(encoding="utf-8")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        os.name != "posix" or not SCRIPT.exists(),
        reason="needs a POSIX shell and the package's script beside this interpreter",
    ),
]


def sessions():
    """Every command of the page with what it prints."""
    for block in re.findall(r"```console\n(.*?)```", PAGE, re.DOTALL):
        for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
            command = re.match(r"(?:.*\\\n)*.*\n", part)[0]
            yield command.rstrip("\n"), part[len(command) :]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the files that the page's Python writes."""
    folder = tmp_path_factory.mktemp("page")
    [code] = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    subprocess.run([sys.executable, "-W", "error", "-c", code], cwd=folder, check=True, timeout=120)
    return folder


def test_the_page_shows_every_command():
    shown = [command.split()[1] for command, _ in sessions() if command.startswith("imgscale")]
    assert {"measure", "calibrate", "priors", "demo"} == set(shown)


@pytest.mark.parametrize(("command", "printed"), list(sessions()))
def test_a_session_prints_what_the_page_says(folder, command, printed):
    path = os.pathsep.join([str(SCRIPT.parent), os.environ.get("PATH", "")])
    done = subprocess.run(
        ["/bin/sh", "-c", command],
        cwd=folder,
        env={**os.environ, "PATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.stdout == printed


def test_what_the_page_keeps_is_there(folder):
    assert {"sizes.csv", "sizes.html", "sizes.png", "model.json", "demo.html"} <= {
        path.name for path in folder.iterdir()
    }
