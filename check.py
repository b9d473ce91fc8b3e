"""
Run everything a commit must pass, in the present environment; nothing is installed.

``python check.py`` runs the core; ``python check.py --full`` also what needs extras and takes
longer: the documentation, the examples and the benchmarks.
"""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parent
PYTHON = sys.executable
PUBLIC = sorted(
    str(path.relative_to(ROOT))
    for path in (ROOT / "src").rglob("*.py")
    if not path.name.startswith("_")
)
EXAMPLES, BENCHMARKS = (
    sorted(str(path.relative_to(ROOT)) for path in (ROOT / folder).glob("*.py"))
    for folder in ("examples", "benchmarks")
)
# These take options, hours or packages of their own.
APART = ("calibration", "fuzz", "load", "mutants", "speed")

CORE: Sequence[tuple[str, ...]] = (
    (PYTHON, "-m", "ruff", "check", "."),
    (PYTHON, "-m", "ruff", "format", "--check", "."),
    (PYTHON, "-m", "mypy"),
    (PYTHON, "-m", "pyright", "--pythonpath", PYTHON),
    (PYTHON, "-c", "from importlinter.cli import lint_imports_command as run; run()"),
    (PYTHON, "-m", "numpydoc", "lint", *PUBLIC),
    (PYTHON, "-m", "pytest", "-n", "auto", "--dist", "loadfile"),
)
FULL: Sequence[tuple[str, ...]] = (
    *((PYTHON, example) for example in EXAMPLES),
    *((PYTHON, path) for path in BENCHMARKS if not Path(path).stem.startswith(APART)),
    (PYTHON, "benchmarks/speed.py", "--quick"),
    (PYTHON, "-m", "sphinx", "-W", "-q", "docs", "docs/_build"),
)


def main(arguments: Sequence[str]) -> int:
    """Run the commands, all of them, and return 1 if one failed."""
    unknown = set(arguments) - {"--full"}
    if unknown:
        print(f"unknown option: {' '.join(sorted(unknown))}; there is only --full")
        return 2
    failed: list[str] = []
    for command in (*FULL, *CORE) if arguments else CORE:
        title = " ".join(Path(word).name if word == PYTHON else word for word in command)[:90]
        print(f"\n--- {title}", flush=True)
        if subprocess.run(command, cwd=ROOT, check=False).returncode:
            failed.append(title)
    if failed:
        print("\nfailed:", *failed, sep="\n  ")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
