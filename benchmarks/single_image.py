"""
Time one picture: `fit` and `predict` by kind of depth and number of objects, beside a peer.

The peer is what one would write by hand: `scipy.optimize.least_squares` with Huber's loss on log k,
detections and depths already turned into columns, without an interval. All are timed in turn in one
process; medians in milliseconds, and the ratio of `fit` to the peer.
"""

import statistics
import time
from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.optimize import least_squares

import imgscale as ims

ROUNDS = 15
COUNTS = (3, 10, 30)
FOCAL_PX, HEIGHT_M, HORIZON = 1200.0, 1.6, 500.0
IMAGE_SIZE = (1920, 1080)
LABELS = {"car": 1.5, "person": 1.72, "bus": 3.1}


def objects(count: int) -> tuple[list[ims.Detection], np.ndarray]:
    """Stand things on a plane before a level camera; their boxes and z-depths."""
    rng = np.random.default_rng(count)
    z_m = rng.uniform(5.0, 40.0, count)
    found = []
    for index, z in enumerate(z_m):
        label, size_m = list(LABELS.items())[index % len(LABELS)]
        pixels = FOCAL_PX * size_m / z * rng.lognormal(0.0, 0.05)
        foot = HORIZON + FOCAL_PX * HEIGHT_M / z
        left = rng.uniform(100, 1700)
        found.append(ims.Detection(label, (left, foot - pixels, left + 0.5 * pixels, foot)))
    return found, z_m


def depths(z_m: np.ndarray) -> dict[str, ims.Depth]:
    """Give the same distances as every kind of depth."""
    return {
        "metric": ims.ObjectDepths(z_m, kind="metric", image_size=IMAGE_SIZE),
        "relative": ims.ObjectDepths(z_m / 7, kind="relative", image_size=IMAGE_SIZE),
        "inverse": ims.ObjectDepths(90 / z_m, kind="inverse", image_size=IMAGE_SIZE),
        "affine_inverse": ims.ObjectDepths(
            90 / z_m + 3, kind="affine_inverse", image_size=IMAGE_SIZE
        ),
        "ground_plane": ims.GroundPlane(image_size=IMAGE_SIZE),
    }


def peer(detections: list[ims.Detection], z_m: np.ndarray) -> Callable[[], object]:
    """Fit log k by scipy's robust least squares, columns ready."""
    pixels = np.array([found.xyxy[3] - found.xyxy[1] for found in detections])
    log_k = np.log([LABELS[found.label] for found in detections]) - np.log(z_m * pixels)
    return lambda: least_squares(
        lambda unknown: (unknown[0] - log_k) / 0.06, np.log([1e-3]), loss="huber"
    )


def median_ms(calls: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Time calls in turn; the first round, which warms up, does not count."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(ROUNDS + 1):
        for name, call in calls.items():
            start = time.perf_counter()
            call()
            times[name].append(time.perf_counter() - start)
    return {name: 1e3 * statistics.median(values[1:]) for name, values in times.items()}


def main() -> None:
    """Measure and print."""
    print(f"{'n':>3}  {'kind of depth':15}{'method':10}{'fit':>9}{'predict':>9}{'fit / peer':>11}")
    for count in COUNTS:
        detections, z_m = objects(count)
        calls = {"peer": peer(detections, z_m)}
        for kind, depth in depths(z_m).items():
            for method in ("robust", "posterior"):
                model = ims.fit(detections, depth, method=method)
                name = f"{kind:15}{method:10}"
                calls[name] = partial(ims.fit, detections, depth, method=method)
                calls[f"{name}predict"] = partial(ims.predict, model, detections, depth)
        took = median_ms(calls)
        for name, value in took.items():
            if name == "peer":
                print(f"{count:3}  {'(least_squares, Huber)':25}{value:9.2f}")
            elif not name.endswith("predict"):
                ratio = value / took["peer"]
                print(f"{count:3}  {name}{value:9.2f}{took[f'{name}predict']:9.2f}{ratio:11.1f}")


if __name__ == "__main__":
    main()
