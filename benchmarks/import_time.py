"""
Time ``import imgscale`` against ``import numpy``, in fresh interpreters, interleaved.

Prints the medians less a bare interpreter's start, their ratio, and what must not be loaded.
"""

import os
import statistics
import subprocess
import sys
import time

ROUNDS = 15
HEAVY = ("scipy", "skimage", "PIL", "matplotlib", "csv", "statistics")
# Installed packages have their bytecode; a checkout gets it in the first round, which is dropped.
ENVIRONMENT = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}


def seconds(code: str) -> float:
    """Run one fresh interpreter and return its wall time."""
    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True, env=ENVIRONMENT)
    return time.perf_counter() - start


def main() -> None:
    """Measure and print."""
    codes = {"bare": "pass", "numpy": "import numpy", "imgscale": "import imgscale"}
    times: dict[str, list[float]] = {name: [] for name in codes}
    for _ in range(ROUNDS + 1):
        for name, code in codes.items():
            times[name].append(seconds(code))
    median = {name: statistics.median(values[1:]) for name, values in times.items()}
    numpy_s, imgscale_s = (median[name] - median["bare"] for name in ("numpy", "imgscale"))
    print(f"import numpy     {numpy_s * 1000:6.1f} ms")
    print(f"import imgscale  {imgscale_s * 1000:6.1f} ms")
    print(f"ratio            {imgscale_s / numpy_s:6.2f}")
    code = f"import sys, imgscale; print([m for m in {HEAVY} if m in sys.modules])"
    print("loaded besides:", end=" ", flush=True)
    subprocess.run([sys.executable, "-c", code], check=True)


if __name__ == "__main__":
    main()
