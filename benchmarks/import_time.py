"""
Time ``import imgscale`` against ``import numpy``, in fresh interpreters, interleaved.

Prints the medians less a bare interpreter's start, their ratio to numpy's, and what must not be
loaded. The package loads what every user builds and the rest when it is first asked for; the last
row asks for `fit` and `predict`.
"""

import statistics
import subprocess
import sys
import time

ROUNDS = 31
HEAVY = ("scipy", "skimage", "PIL", "matplotlib", "pandas", "csv", "statistics")
CODES = {
    "bare": "pass",
    "import numpy": "import numpy",
    "import numpy, attrs": "import numpy, attrs",
    "import imgscale": "import imgscale",
    "from imgscale import fit, predict": "from imgscale import fit, predict",
}


def seconds(code: str) -> float:
    """Run one fresh interpreter, apart from the user's settings, and return its wall time."""
    start = time.perf_counter()
    subprocess.run([sys.executable, "-I", "-c", code], check=True)
    return time.perf_counter() - start


def medians(rounds: int) -> dict[str, float]:
    """Time each of `CODES` and return the medians less a bare interpreter's."""
    # A checkout gets its bytecode in the first round, which is dropped.
    times: dict[str, list[float]] = {name: [] for name in CODES}
    for _ in range(rounds + 1):
        for name, code in CODES.items():
            times[name].append(seconds(code))
    median = {name: statistics.median(values[1:]) for name, values in times.items()}
    return {name: value - median["bare"] for name, value in median.items() if name != "bare"}


def main() -> None:
    """Measure and print."""
    median = medians(ROUNDS)
    for name, value in median.items():
        print(f"{name:36}{value * 1000:6.1f} ms {value / median['import numpy']:6.2f}")
    code = f"import sys, imgscale; print([m for m in {HEAVY} if m in sys.modules])"
    print("loaded besides:", end=" ", flush=True)
    subprocess.run([sys.executable, "-I", "-c", code], check=True)


if __name__ == "__main__":
    main()
