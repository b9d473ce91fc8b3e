"""
Run many fits in a loop, and size many boxes on one large map: what memory and time they take.

``python benchmarks/load.py`` is a small run. The full one takes an hour:
``python benchmarks/load.py --fits 1000000 --megapixels 100 --boxes 10000``.

The loop takes every kind of depth and every method in turn, with new numbers and a new unknown
label each time. The memory of the process is printed at ten points; after the first it must not
grow, beyond what the allocator keeps.

The map is of float32 numbers, the boxes 100 to 500 px high; one in ten, or every one, has a known
size. Memory is the most that a call held beyond the map, the boxes and its result, in a process of
its own; it must not grow with the number of pixels. With 10 000 boxes on 100 megapixels "robust"
must stay below 50 MB and "posterior" below 200 MB where one in ten is known; where all are,
below 2 GB.
"""

from __future__ import annotations

import argparse
import gc
import math
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from speed_memory import peak_memory
from speed_rounds import Run

import imgscale as ims
from imgscale._typing import DepthKind, FitMethod

HEIGHTS_M = {"person": 1.72, "car": 1.5, "door": 2.0, "bicycle": 1.05}
CHEAP_KINDS: tuple[DepthKind, ...] = ("metric", "relative", "inverse")
CHEAP_METHODS: tuple[FitMethod, ...] = ("robust", "least_squares", "mean_ratio")
# On the large map: share of the boxes whose size is known, method, call.
CALLS: tuple[tuple[float, FitMethod, str], ...] = (
    (0.1, "robust", "map"),
    (0.1, "robust", "fit"),
    (0.1, "robust", "predict"),
    (0.1, "posterior", "fit"),
    (0.1, "posterior", "predict"),
    (1.0, "posterior", "fit"),
)
_POINTS = 10
_FOCAL_PX = 1000.0
_TOLD = ims.Noise(depth_rel=0.05)


# --- the loop ---


def turn(number: int) -> tuple[DepthKind, FitMethod]:
    """
    Choose what one fit of the loop takes: mostly what is fast, all in turn.

    Parameters
    ----------
    number : int
        Which fit.

    Returns
    -------
    kind, method : str
        As for `imgscale.fit`.
    """
    if number % 500 == 0:
        return "affine_inverse", "posterior"
    if number % 50 == 0:
        return CHEAP_KINDS[number // 50 % 3], "posterior"
    return CHEAP_KINDS[number % 3], CHEAP_METHODS[number // 3 % 3]


def fit_once(number: int) -> float:
    """
    Draw a picture of known things and one unknown, fit it and, every tenth time, size them.

    Parameters
    ----------
    number : int
        Which fit; the seed of its numbers.

    Returns
    -------
    float
        The scale, or the size of the unknown thing in metres.
    """
    kind, method = turn(number)
    z = [4.0 + (number * 0.7 + 3.7 * place) % 17 for place in range(5)]
    heights = [*(height * _FOCAL_PX for height in HEIGHTS_M.values()), 900.0]
    labels = [*HEIGHTS_M, f"thing {number}"]
    detections = [
        ims.Detection(label, (100.0 * place, 10.0, 100.0 * place + 60.0, 10.0 + height / away))
        for place, (label, height, away) in enumerate(zip(labels, heights, z, strict=True))
    ]
    far = kind in {"metric", "relative"}
    depth = ims.ObjectDepths([away if far else 50 / away for away in z], kind=kind)
    model = ims.fit(detections, depth, method=method, noise=_TOLD)
    if number % 10:
        return model.k
    return ims.predict(model, detections, depth)[-1].size_m


def loop(fits: int) -> Iterator[tuple[int, int, int]]:
    """
    Fit again and again.

    Parameters
    ----------
    fits : int
        How often.

    Yields
    ------
    done : int
        Fits so far, ten times.
    held : int
        Memory of the process, in bytes; 0 where the system does not tell.
    objects : int
        Objects that the garbage collector watches.
    """
    for number in range(fits):
        if not math.isfinite(fit_once(number)):
            msg = f"fit {number} has no answer"
            raise ArithmeticError(msg)
        if (number + 1) * _POINTS // fits > number * _POINTS // fits:
            gc.collect()
            yield number + 1, held(), len(gc.get_objects())


def held() -> int:
    """
    Read how much memory the process holds.

    Returns
    -------
    int
        Bytes; 0 where the system does not tell.
    """
    pages = Path("/proc/self/statm")
    return 4096 * int(pages.read_text(encoding="ascii").split()[1]) if pages.exists() else 0


# --- the large map ---


def large_calls(
    megapixels: float, known: float, method: FitMethod, n_boxes: int, names: tuple[str, ...]
) -> dict[str, Run]:
    """
    Draw a large map and boxes on it, ready to be fitted and sized.

    Parameters
    ----------
    megapixels : float
        Pixels of the map, in millions.
    known : float
        Share of the boxes whose size is known, 0 to 1.
    method : str
        As for `imgscale.fit`.
    n_boxes : int
        How many boxes.
    names : tuple of str
        Which calls are wanted: "map", "fit", "predict".

    Returns
    -------
    dict of str to callable
        The calls.
    """
    side = round(1000 * math.sqrt(megapixels))
    slope = np.linspace(60, 4, side, dtype=np.float32)[:, np.newaxis]
    values = np.repeat(slope, side, axis=1)
    detections = _boxes(np.random.default_rng(5), side, n_boxes, known)
    if names == ("map",):
        return {"map": partial(_owned, values)}
    depth = ims.DepthMap(values, kind="relative")
    fit = partial(ims.fit, detections, depth, method=method, noise=_TOLD)
    if names == ("fit",):
        return {"fit": fit}
    return {"predict": partial(ims.predict, fit(), detections, depth)}


def _owned(values: np.ndarray) -> np.ndarray:
    return ims.DepthMap(values, kind="relative").values


def _boxes(rng: np.random.Generator, side: int, n_boxes: int, known: float) -> list[ims.Detection]:
    labels = list(HEIGHTS_M)
    detections: list[ims.Detection] = []
    for number in range(n_boxes):
        width, x, y = rng.uniform(0.1, 0.5) * 1000, *rng.uniform(0, 1, 2)
        width = min(width, side / 4)
        left, top = x * (side - width), y * (side - width)
        label = labels[number % 4] if rng.random() < known else "thing"
        detections.append(ims.Detection(label, (left, top, left + width / 2, top + width)))
    return detections


def _peaks(megapixels: float, n_boxes: int) -> Iterator[str]:
    """Lay out time and memory of every call on the large map."""
    pixels = 1e6 * megapixels
    for known, method, name in CALLS:
        maker = partial(large_calls, megapixels, known, method)
        call = maker(n_boxes, (name,))[name]
        start = time.perf_counter()
        call()
        seconds = time.perf_counter() - start
        del call
        used = peak_memory(maker, (name,), n_boxes).get(name, math.nan)
        yield (
            f"{name:9}{method:11}{known:>7.0%}{seconds:>10.2f}{used / 1e6:>10.0f}"
            f"{used / pixels:>14.2f}"
        )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fits", type=int, default=2000, help="fits in the loop, at least 10")
    parser.add_argument("--megapixels", type=float, default=4.0, help="size of the map")
    parser.add_argument("--boxes", type=int, default=300, help="boxes on the map")
    options = parser.parse_args()
    print(f"{options.fits} fits\n{'done':>9}{'held, MB':>10}{'objects':>10}{'seconds':>10}")
    start = time.perf_counter()
    for done, memory, objects in loop(options.fits):
        seconds = time.perf_counter() - start
        print(f"{done:9}{memory / 1e6:10.1f}{objects:10}{seconds:10.0f}", flush=True)
    print(f"\n{options.boxes} boxes on {options.megapixels:g} megapixels of float32")
    print(f"{'call':9}{'method':11}{'known':>7}{'seconds':>10}{'MB':>10}{'bytes a pixel':>14}")
    for line in _peaks(options.megapixels, options.boxes):
        print(line, flush=True)


if __name__ == "__main__":
    main()
