"""
Show what the sampler's constants do: to rendered scenes, LiDAR maps of traffic, a stereo photo.

An error is the log of the sampled depth over the depth at which the object's height fills its box:
that of a size from the true focal length. The rendered objects are boxes put together like cars,
vans, people and cyclists, before walls, clutter and ground, with 0-5 % noise and holes; how often
each scene occurs is not known. The LiDAR maps are KITTI's (IMGSCALE_DATA, or ../shared/data beside
the checkout). A plain order statistic is a window without end.
"""

import itertools
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import numpy as np
import skimage as ski
from numpy.typing import NDArray
from PIL import Image

from imgscale import sampling
from imgscale.datasets import motorcycle

Floats = NDArray[np.float64]
Box = tuple[float, float, float, float]
DATA = Path(os.environ.get("IMGSCALE_DATA", Path(__file__).parents[2] / "shared" / "data"))
KITTI = DATA / "kitti" / "object" / "training"
DETECTORS = DATA / "kitti" / "detections"
SCENES = ("clean", "windows", "see-through", "occluder", "both", "sparse", "sparse both")
PER_SCENE = 800
FOCAL_PX, CAMERA_M, TYRE_M, RIM_M = 720.0, 1.65, 0.622, 0.485
# Height, width, length in metres, and parts as shares of length (-.5 .5), height (0 1), width.
AXLES = ((-0.4, -0.25, 0, 0.35, -0.5, 0.5), (0.25, 0.4, 0, 0.35, -0.5, 0.5))
CAR = ((-0.5, 0.5, 0.15, 0.58, -0.5, 0.5), (-0.38, 0.22, 0.5, 1, -0.42, 0.42), *AXLES)
VAN = ((-0.5, 0.5, 0.12, 0.5, -0.5, 0.5), (-0.5, 0.38, 0.5, 1, -0.48, 0.48), *AXLES)
LEGS = ((-0.3, -0.05, 0, 0.5, -0.3, 0), (0.05, 0.35, 0, 0.5, 0, 0.3))
WHEELS = ((-0.5, -0.15, 0, 0.38, -0.05, 0.05), (0.15, 0.5, 0, 0.38, -0.05, 0.05))
BODY = ((-0.2, 0.2, 0.45, 0.85, -0.4, 0.4), (-0.13, 0.13, 0.84, 1, -0.16, 0.16))
SHAPES = {
    "car": ((1.5, 1.65, 4.0), CAR),
    "van": ((2.4, 1.9, 5.5), VAN),
    "person": ((1.75, 0.65, 0.8), (*LEGS, *BODY)),
    "cyclist": ((1.74, 0.6, 1.75), (*WHEELS, LEGS[1], *BODY)),
}
WIDTH, ORDER, CORE = "SURFACE_LOG_WIDTH", "_ORDER_STATISTIC", "_CORE_SHARE"
RULES: dict[str, dict[str, float]] = {
    "as shipped": {CORE: sampling._CORE_SHARE},
    **{f"plain, {q:.0%}": {WIDTH: math.inf, ORDER: q} for q in (0.1, 0.25, 0.3, 0.5)},
    **{f"window {w:.0%}": {WIDTH: w} for w in (0.03, 0.04, 0.08, 0.1, 0.15)},
    **{f"order {q:.0%}": {ORDER: q} for q in (0.1, 0.5)},
    **{f"core {share:.0%}": {CORE: share} for share in (0.3, 0.4, 0.6, 0.7, 1.0)},
}


class Case(NamedTuple):
    """An object in a depth map, and the depth at which its height fills the box."""

    values: Floats
    box: Box
    depth_m: float
    mask: NDArray[np.bool_] | None = None


def corners(parts: Floats, size: Floats, place: Floats) -> Floats:
    """Place the corners of the parts before the camera: x, y, z in its frame."""
    index = np.array([(a, b, c) for a in (0, 1) for b in (2, 3) for c in (4, 5)])
    along, up, across = parts[:, index].reshape(-1, 3).T * size[[2, 0, 1]][:, None]
    cos, sin = math.cos(place[3]), math.sin(place[3])
    x, z = along * cos + across * sin, across * cos - along * sin
    return np.stack([x + place[0], place[1] - up, z + place[2]])


def depth_of(part: Floats, size: Floats, place: Floats, x: Floats, y: Floats) -> Floats:
    """Find where the rays x, y, 1 enter one part, inf where they miss."""
    cos, sin = math.cos(place[3]), math.sin(place[3])
    eye = (place[2] * sin - place[0] * cos, place[1], -place[0] * sin - place[2] * cos)
    ray = (x * cos - sin, -y, x * sin + cos)
    enter, leave = np.full(x.shape, -np.inf), np.full(x.shape, np.inf)
    for axis, length in enumerate(size[[2, 0, 1]]):
        low, high = ((part[2 * axis + end] * length - eye[axis]) / ray[axis] for end in (0, 1))
        enter = np.maximum(enter, np.minimum(low, high))
        leave = np.minimum(leave, np.maximum(low, high))
    return np.where((enter <= leave) & (enter > 0), enter, np.inf)


def relief(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    """Draw a smooth field of unit spread."""
    return ski.transform.resize(rng.normal(size=(4, 4)), shape, order=1, anti_aliasing=False)


def background(rng: np.random.Generator, depth_m: float, ground: Floats) -> Floats:
    """Put a wall, or clutter at several depths, 1.1 to 4 times as far, on the ground."""
    shape = ground.shape
    edges = np.sort(rng.uniform(0, shape[1], rng.integers(3, 8) * rng.integers(2)))
    far = depth_m * np.exp(rng.uniform(np.log(1.1), np.log(4), edges.size + 1))
    behind = far[np.searchsorted(edges, np.arange(shape[1]))] * np.exp(0.1 * relief(rng, shape))
    return np.minimum(np.maximum(behind, 1.08 * depth_m), np.maximum(ground, 0.3 * depth_m))


def lattice(rng: np.random.Generator, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Open 30-60 % of the map in a regular pattern."""
    row, column = 2 * np.pi * np.indices(shape) / np.reshape(shape, (2, 1, 1))
    turns, lean = rng.integers(3, 9, 2), rng.uniform(-1, 1, 2)
    wave = np.sin(turns[0] * column + lean[0] * row) + np.sin(turns[1] * row + lean[1] * column)
    return wave < np.quantile(wave, rng.uniform(0.3, 0.6))


def occluder(rng: np.random.Generator, box: Box, depth_m: float, shape: tuple[int, ...]) -> Floats:
    """Put a pole, something at one side or grass on 10-45 % of the core, inf elsewhere."""
    row, column = np.indices(shape) + 0.5
    row, column = (row - box[1]) / (box[3] - box[1]), (column - box[0]) / (box[2] - box[0])
    core = (np.abs(row - 0.5) < 0.25) & (np.abs(column - 0.5) < 0.25)
    near = rng.uniform(0.3, 0.9)
    for _ in range(100):
        kind = rng.integers(3)
        if kind < 2:  # a side is a pole whose middle is the box's edge
            middle, half = (rng.uniform(), 0.15) if kind else (rng.integers(2), 0.75)
            cover = np.abs(column - middle) < rng.uniform(0.15 * half, half)
        else:
            tops = rng.uniform(0.25, 0.75) * (1 + 0.25 * rng.normal(size=shape[1]))
            cover = (row > 1 - tops) & (rng.uniform(size=shape) < rng.uniform(0.5, 1))
        if 0.1 <= cover[core].mean() <= 0.45:
            depths = rng.uniform(near, 0.95 if kind == 2 else near, shape)
            return np.where(cover, depth_m * depths, np.inf)
    return np.full(shape, np.inf)


def degraded(rng: np.random.Generator, values: Floats, *, sparse: bool) -> Floats:
    """Add noise of 0-5 %, part of it smooth, and holes; of a sparse map keep 4 %, in lines."""
    shape, turn = values.shape, rng.uniform(0, np.pi / 2)
    noise = math.cos(turn) * rng.normal(size=shape) + math.sin(turn) * relief(rng, shape)
    values = values * np.exp(rng.uniform(0, 0.05) * noise)
    row, column = rng.integers(shape[0]), rng.integers(shape[1])
    values[row : row + shape[0] // 5, column : column + shape[1] // 5] = np.nan
    if sparse:
        lines = (np.arange(shape[0]) + rng.integers(5)) % 5 == 0
        values[~(lines[:, None] & (rng.uniform(size=shape) < 0.2))] = np.nan
    return values


def placed(rng: np.random.Generator, name: str, *, whole: bool) -> tuple[Floats, ...]:
    """Place an object on the ground: size in pixels, depth; maps of z, of height, of the ground."""
    size, parts = map(np.array, SHAPES[name])
    distance = np.exp(rng.uniform(np.log(7), np.log(40)))
    place = np.array([rng.uniform(-0.4, 0.4) * distance, CAMERA_M, distance, rng.uniform(-4, 4)])
    points = corners(parts, size, place)
    image = FOCAL_PX * points[:2] / points[2]
    extent = np.ptp(image, axis=1)
    step = 1.0 if whole else max(1.0, *(extent / (90, 60)))
    ends = image.min(axis=1) - 0.2 * extent, image.max(axis=1) + 0.2 * extent
    x, y = np.meshgrid(*(np.arange(*each, step) / FOCAL_PX for each in np.transpose(ends)))
    values = np.min([depth_of(part, size, place, x, y) for part in parts], axis=0)
    up = (CAMERA_M - y * np.where(np.isfinite(values), values, 0)) / size[0]
    return extent / step, FOCAL_PX * size[0] / extent[1], values, up, CAMERA_M / np.maximum(y, 1e-3)


def rendered(rng: np.random.Generator, scene: str) -> Case:
    """Render one object with what stands before and behind it."""
    name = rng.choice(list(SHAPES))
    extent, depth_m, values, up, ground = placed(rng, name, whole="sparse" in scene)
    mask = np.isfinite(values)
    if scene in {"windows", "both", "sparse both"} and name in {"car", "van"}:
        values[mask & (up > 0.75 - 0.5 * rng.uniform(0.2, 0.3)) & (up < 0.95)] = np.inf
    if scene == "see-through":
        values[lattice(rng, values.shape)] = np.inf
    values = np.where(np.isfinite(values), values, background(rng, depth_m, ground))
    box = np.repeat([0.2, 1.2], 2) * np.tile(extent, 2) + 0.5  # the rays are the pixels' centres
    if scene in {"occluder", "both", "sparse both"}:
        hidden = occluder(rng, tuple(box), depth_m, values.shape)
        values, mask = np.minimum(values, hidden), mask & np.isinf(hidden)
    if scene in {"windows", "see-through", "both", "sparse both"}:  # a detector's box, loose
        error = 0.05 * rng.normal(size=4) + rng.uniform(-0.02, 0.08) * np.array([-1, -1, 1, 1])
        box += error * np.tile(extent, 2)
    return Case(degraded(rng, values, sparse="sparse" in scene), tuple(box), depth_m, mask)


def overlap(first: Box, second: Box) -> float:
    """Intersection over union."""
    sides = np.minimum(first[2:], second[2:]) - np.maximum(first[:2], second[:2])
    shared = np.prod(np.maximum(sides, 0))
    both = sum((box[2] - box[0]) * (box[3] - box[1]) for box in (first, second))
    return float(shared / (both - shared))


def rows_of(path: Path) -> list[list[str]]:
    """Read the words of each line, none where there is no file."""
    return (
        []
        if not path.exists()
        else [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
    )


def detections(frame: str) -> Iterator[tuple[str, Box]]:
    """Read the boxes of both detectors in one frame, of score 0.3 on."""
    for row in rows_of(DETECTORS / "frustum_pointnets_val.txt"):
        if Path(row[0]).stem == frame and float(row[2]) >= 0.3:
            yield "frustum", tuple(map(float, row[3:7]))
    for row in rows_of(DETECTORS / "zenuity" / f"{frame}.txt"):
        if float(row[-1]) >= 0.3:
            yield "zenuity", tuple(map(float, row[4:8]))


def lidar_cases() -> Iterator[tuple[str, Case]]:
    """Pair labelled objects, untruncated and at least 25 px high, with LiDAR maps."""
    for path in sorted((KITTI / "lidar_depth").glob("*.png")):
        with Image.open(path) as image:
            values = np.asarray(image) / 256.0
        calibration = rows_of(KITTI / "calib" / f"{path.stem}.txt")
        focal_px = next(float(row[1]) for row in calibration if row and row[0] == "P2:")
        found = list(detections(path.stem))
        for row in rows_of(KITTI / "label_2" / f"{path.stem}.txt"):
            box = tuple(map(float, row[4:8]))
            if row[0] == "DontCare" or float(row[1]) != 0 or box[3] - box[1] < 25:
                continue
            hidden = int(row[2]) > 1
            ranked = [] if hidden else sorted(found, key=lambda each: overlap(each[1], box))
            best = dict(each for each in ranked if overlap(each[1], box) >= 0.5)
            for group, each in [("hidden" if hidden else "labels", box), *best.items()]:
                yield group, Case(values, each, focal_px * float(row[8]) / (each[3] - each[1]))


def errors(cases: list[Case], constants: dict[str, float], *, masked: bool = False) -> Floats:
    """Sample all with constants of the sampler changed: log errors, and 1 where flagged mixed."""
    result = []
    with mock.patch.multiple(sampling, **constants):
        for values, box, depth_m, mask in cases:
            given = {"image_size": values.shape[::-1], "mask": mask if masked else None}
            sample = sampling.sample_surface(values, box, kind="metric", nearness=-1, **given)
            result.append((math.log(sample.value / depth_m), float(sample.mixed)))
    return np.array(result)


def rim_error(constants: dict[str, float]) -> float:
    """Size the motorcycle's front rim from its rear tyre, relative to the nominal rim."""
    scene = motorcycle.load()
    drawn = [each.xyxy for each in scene.detections if each.label in {"rear tyre", "front rim"}]
    cases = [Case(1 / scene.shifted_disparity, box, 1 / (box[3] - box[1])) for box in drawn]
    tyre, rim = errors(cases, constants)[:, 0]  # their sizes, up to one factor
    return math.exp(rim - tyre) * TYRE_M / RIM_M - 1


def print_table(groups: dict[str, list[Case]]) -> None:
    """Print one row per rule: median |error|, bias, mean |error|, shares 10 and 20 % off."""
    print(f"{'':17s}" + "".join(f"{f'{k}, n {len(v)}':>25s}" for k, v in groups.items()))
    print(" " * 17 + f"{'med bias mean >10 >20':>25s}" * len(groups))
    rows = [(name, rule, False) for name, rule in RULES.items()]
    if next(iter(groups.values()))[0].mask is not None:
        rows += [(f"mask, {name}", RULES[name], True) for name in ("as shipped", "plain, 25%")]
    for name, rule, masked in rows:
        line = f"{name:17s}"
        for cases in groups.values():
            logs = 100 * errors(cases, rule, masked=masked)[:, 0]
            size, bias = np.abs(logs), np.median(logs)
            line += f"{np.median(size):6.1f}{bias:+6.1f}{size.mean():5.1f}"
            line += "".join(f"{100 * np.mean(size > limit):4.0f}" for limit in (10, 20))
        print(line)


def print_mixed(cases: list[Case]) -> None:
    """Print how well MIXED_DEPTH tells depths that are more than 10 % off, by its thresholds."""
    print("gap  share  flagged  wrong if so, if not  found of wrong  spread if so, if not")
    for gap, share in itertools.product((1.1, 1.25, 1.5), (0.2, 0.3, 0.4, 0.5)):
        result = errors(cases, {"OTHER_LOG_GAP": math.log(gap), "_OTHER_SHARE": share})
        logs, mixed = result[:, 0], result[:, 1] > 0
        wrong = np.abs(logs) > 0.1
        shares = [mixed.mean(), wrong[mixed].mean(), wrong[~mixed].mean(), mixed[wrong].mean()]
        spreads = [1.4826 * np.median(np.abs(part)) for part in (logs[mixed], logs[~mixed])]
        row = "{:4.0%} {:5.0%} {:8.0%} {:12.0%} {:7.1%} {:15.0%} {:13.1%} {:7.1%}"
        print(row.format(gap - 1, share, *shares, *spreads))


def main() -> None:
    """Print the tables."""
    rng = np.random.default_rng(0)
    scenes = {name: [rendered(rng, name) for _ in range(PER_SCENE)] for name in SCENES}
    print("Rendered scenes: |error| in %, its median, bias, mean, and the share of wrong ones")
    scenes["all"] = [case for name in SCENES for case in scenes[name]]
    for names in (SCENES[:3], SCENES[3:5], (*SCENES[5:], "all")):
        print_table({name: scenes[name] for name in names})
    print("\nMIXED_DEPTH, all rendered scenes: over 10 % off (wrong), robust spread of log errors")
    print_mixed(scenes["all"])
    print("\nThe motorcycle's front rim from its rear tyre")
    for name, rule in RULES.items():
        print(f"{name:17s}{rim_error(rule):+6.1%}")
    lidar: dict[str, list[Case]] = {}
    for group, case in lidar_cases():
        lidar.setdefault(group, []).append(case)
    print("\nLiDAR maps: label boxes, those of largely hidden objects, and detectors' boxes")
    for names in (("labels", "hidden"), ("frustum", "zenuity")) if lidar else ():
        print_table({name: lidar[name] for name in names})
    print("" if lidar else f"none in {DATA}")


if __name__ == "__main__":
    main()
