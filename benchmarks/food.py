"""
Measure round food beside a coin: the diameter from the picture against that of the volume.

``python benchmarks/food.py --root FOLDER`` reads ECUSTFD (Liang and Li, arXiv:1705.07632), a folder
with ``Annotations`` and ``density.csv``; without ``--root`` it draws balls and coins on a plate in
perspective, whose sizes are known. The coin of 25.0 mm is the only reference, and everything is
taken to be at one distance. A row's "width", "height" and "longer" are the sizes of the box along
each axis, compared with the diameter of the ball that has the food's volume, (6 V / pi)^(1/3):
median error, median absolute error, and how often the 90 % interval holds the truth.

What limits it, in ECUSTFD:

- From above (T) a ball's outline is nearer than the coin: one distance makes it 1 / sqrt(1 - D / Z)
  times too large, D / Z its diameter over the camera's distance from the coin: 10 to 17 % here. The
  rows "lifted" put the ball where it is, by the size found first. That takes the distance, so a
  focal length: the pictures have lost theirs, and 0.9 of the longer side stands for it (a 31 mm
  lens on full frame). 10 % more of it makes sizes 1.5 % larger.
- Boxes are drawn about 2.5 px outside the outline on every side (seen on 18 pictures). Of a coin of
  66 px that is 8 %, of the food 2 to 3 %, so that sizes come out 5 % too small. The rows "tight"
  draw all boxes in by it.
- From the side (S) the coin stands on its rim and faces the camera, some centimetres before or
  behind the food: an error of either sign, of which the picture tells nothing.
- Food is no ball: most lies flat, so that its height from the side is the least of its extents.

With everything at one distance ``Noise(depth_rel=0.08)`` is honest for both views; lifted,
``Noise(box_px=3.0, depth_rel=0.03)``.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

import imgscale as ims
from imgscale.depth_sources.assumed import OneDistance
from imgscale.detectors.pascal_voc import read_pascal_voc

COIN_M = 0.025
# Median box at most 1.16 times as long as wide, from above and from the side. Pears are that too,
# but taper: no ball has both their volume and their width.
ROUND = ("apple", "lemon", "litchi", "orange", "peach", "plum")
VIEWS = {"T": "above", "S": "side"}
Axis = Literal["width", "height", "diameter"]
Sizes = dict[Axis, ims.SizeEstimate]
FloatArray = NDArray[np.float64]
AXES: dict[Axis, str] = {"width": "width", "height": "height", "diameter": "longer"}
_SLACK_PX = 2.5
_FOCAL_SHARE = 0.9
_PICTURE = re.compile(r"([a-z_]+\d+)([ST])\(\d+\)")
_SEED, _BALLS = 20261122, 40

PRIORS = ims.PriorTable(
    [ims.ObjectPrior("coin", COIN_M, 0.00005, axis="diameter", on_ground=False, source="nominal")]
)


class FolderError(Exception):
    """The folder does not hold what it should."""


@dataclass(frozen=True)
class Portion:
    """One food beside its coin in one picture."""

    food: str
    view: str
    coin: ims.Detection
    thing: ims.Detection
    image_size: tuple[int, int]
    diameter_m: float

    @property
    def focal_px(self) -> float:
        """The focal length that stands for the one that is not known."""
        return _FOCAL_SHARE * max(self.image_size)


@dataclass(frozen=True)
class Treatment:
    """What is done with boxes and depths before they are measured."""

    name: str
    views: str
    slack_px: float
    lifted: bool
    noise: ims.Noise


@dataclass(frozen=True)
class Row:
    """Errors of one food along the axes, relative to the truth."""

    treatment: str
    view: str
    food: str
    n: int
    median: dict[str, float]
    absolute: dict[str, float]
    coverage_90: dict[str, float]


_FLAT, _LIFTED = ims.Noise(depth_rel=0.08), ims.Noise(box_px=3.0, depth_rel=0.03)
REAL = (
    Treatment("one distance", "TS", 0.0, lifted=False, noise=_FLAT),
    Treatment("tight", "TS", _SLACK_PX, lifted=False, noise=_FLAT),
    Treatment("tight, lifted", "T", _SLACK_PX, lifted=True, noise=_LIFTED),
)
DRAWN = (
    Treatment("one distance", "T", 0.0, lifted=False, noise=_FLAT),
    Treatment("lifted", "T", 0.0, lifted=True, noise=ims.Noise(depth_rel=0.005)),
)


def main(arguments: Sequence[str]) -> int:
    """Measure and print; return 2 where it cannot begin."""
    parser = argparse.ArgumentParser(prog="food.py", description=__doc__)
    parser.add_argument("--root", type=Path, help="folder of ECUSTFD")
    parser.add_argument("--box-noise", type=float, default=1.0, help="of drawn boxes, in pixels")
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args(arguments)
    try:
        counts, portions = _portions(options)
    except FolderError as error:
        print(f"food.py: {error}", file=sys.stderr)
        return 2
    rows = list(_rows(portions, REAL if options.root else DRAWN))
    print("\n".join([_heading(counts, len(portions)), "", *_table(rows)]))
    if options.json:
        record = {"meta": counts, "rows": [asdict(row) for row in rows]}
        options.json.write_text(json.dumps(record, indent=1), encoding="utf-8")
    return 0


def _portions(options: argparse.Namespace) -> tuple[dict[str, object], list[Portion]]:
    if options.root:
        return _read(options.root)
    portions = list(_drawn(options.box_noise))
    return {"source": "drawn", "pictures": len(portions), "with_coin": len(portions)}, portions


def _read(root: Path) -> tuple[dict[str, object], list[Portion]]:
    """Read annotations and volumes; pictures without exactly one coin are counted and left."""
    volumes = _volumes(root / "density.csv")
    paths = sorted((root / "Annotations").glob("*.xml"))
    if not paths:
        msg = f"{root} must hold Annotations/*.xml of ECUSTFD; there are none."
        raise FolderError(msg)
    portions: list[Portion] = []
    with_coin = 0
    for path in paths:
        detections = read_pascal_voc(path)
        coins = [detection for detection in detections if detection.label == "coin"]
        if len(coins) == 1:
            with_coin += 1
            portions += _of_picture(path, coins[0], detections, volumes)
    return {"source": "ECUSTFD", "pictures": len(paths), "with_coin": with_coin}, portions


def _volumes(path: Path) -> dict[tuple[str, str], float]:
    """Read volumes in cubic metres by portion and food."""
    if not path.is_file():
        msg = f"{path} must hold the volumes; there is no such file."
        raise FolderError(msg)
    with path.open(encoding="utf-8", newline="") as file:
        # the header says mm^3, the values are cm^3
        return {
            (row["id"], row["type"]): float(row["volume(mm^3)"]) * 1e-6
            for row in csv.DictReader(file)
        }


def _of_picture(
    path: Path,
    coin: ims.Detection,
    detections: Sequence[ims.Detection],
    volumes: dict[tuple[str, str], float],
) -> Iterator[Portion]:
    match = _PICTURE.fullmatch(path.stem)
    if match is None:
        msg = f"{path.name} must be called like apple001S(1).xml."
        raise FolderError(msg)
    width, height = re.findall(r"<(?:width|height)>(\d+)<", path.read_text(encoding="utf-8"))
    for detection in detections:
        if detection.label not in ROUND:
            continue
        if (match[1], detection.label) not in volumes:
            msg = f"density.csv must hold the volume of every food; {path.stem} has none."
            raise FolderError(msg)
        diameter_m = (6 * volumes[match[1], detection.label] / math.pi) ** (1 / 3)
        size = (int(width), int(height))
        yield Portion(detection.label, match[2], coin, detection, size, diameter_m)


def _drawn(box_noise_px: float) -> Iterator[Portion]:
    """Draw balls on a plane with a coin beside them, seen from straight above."""
    rng = np.random.default_rng(_SEED)
    size = (816, 612)
    focal_px = _FOCAL_SHARE * max(size)
    for _ in range(_BALLS):
        distance_m, diameter_m = rng.uniform(0.28, 0.40), rng.uniform(0.035, 0.085)
        coin = _seen(rng.uniform([-0.1, -0.07, 0], [-0.08, 0.07, 0]), COIN_M, distance_m, flat=True)
        centre = (*rng.uniform(-0.01, 0.01, 2), diameter_m / 2)
        ball = _seen(centre, diameter_m, distance_m, flat=False)
        middle = np.tile(np.array(size) / 2, 2)
        boxes = [
            middle + focal_px * box + box_noise_px * rng.standard_normal(4) / math.sqrt(2)
            for box in (coin, ball)
        ]
        coin_seen, ball_seen = map(ims.Detection, ("coin", "ball"), boxes)
        yield Portion("ball", "T", coin_seen, ball_seen, size, diameter_m)


def _seen(
    centre: Sequence[float] | FloatArray, diameter_m: float, distance_m: float, *, flat: bool
) -> FloatArray:
    """Project a coin or a ball: x1, y1, x2, y2 over the focal length, from the middle."""
    x, y, up = centre
    z, radius = distance_m - up, diameter_m / 2
    if flat:
        return np.array([x - radius, y - radius, x + radius, y + radius]) / z
    squared = z * z - radius * radius  # of the planes through the camera that touch the ball
    spans = [radius * math.sqrt(side * side + squared) for side in (x, y)]
    corners = [x * z - spans[0], y * z - spans[1], x * z + spans[0], y * z + spans[1]]
    return np.array(corners) / squared


def _rows(portions: Sequence[Portion], treatments: Sequence[Treatment]) -> Iterator[Row]:
    for treatment in treatments:
        for view in treatment.views:
            seen = [portion for portion in portions if portion.view == view]
            sizes = [_measured(portion, treatment) for portion in seen]
            foods = sorted({portion.food for portion in seen})
            for food in [*foods, "all"] if len(foods) > 1 else foods:
                chosen = [
                    (portion, size)
                    for portion, size in zip(seen, sizes, strict=True)
                    if food in {portion.food, "all"}
                ]
                yield _row(treatment.name, view, food, chosen)


def _measured(portion: Portion, treatment: Treatment) -> Sizes:
    """Size one portion along every axis, by the coin alone."""
    slack = treatment.slack_px * np.array([1, 1, -1, -1])
    detections = [thing.with_box(thing.xyxy + slack) for thing in (portion.coin, portion.thing)]
    depth = OneDistance()(np.empty((*portion.image_size[::-1], 3), dtype=np.uint8))
    sizes, distance_m = _sized(portion, detections, depth, treatment.noise)
    if not treatment.lifted:
        return sizes
    apparent_m = math.sqrt(sizes["width"].size_m * sizes["height"].size_m)
    depths = [1.0, _lifted(apparent_m, distance_m)]
    lifted = ims.ObjectDepths(depths, kind="relative", image_size=portion.image_size)
    return _sized(portion, detections, lifted, treatment.noise)[0]


def _sized(
    portion: Portion, detections: Sequence[ims.Detection], depth: ims.Depth, noise: ims.Noise
) -> tuple[Sizes, float]:
    """Size the food along every axis; also tell the distance of the coin."""
    camera = ims.Camera(portion.focal_px, focal_rel_std=0.1, image_size=portion.image_size)
    model = ims.fit(detections, depth, PRIORS, camera=camera, noise=noise)
    sizes: Sizes = {}
    distance_m = math.nan
    for axis in AXES:
        coin, sizes[axis] = ims.predict(model, detections, depth, axis=axis)
        distance_m = coin.distance_m or math.nan
    return sizes, distance_m


def _lifted(apparent_m: float, distance_m: float) -> float:
    """
    Find the depth of a ball's outline over that of the plane on which it lies.

    With one distance a ball below the camera comes out D0 = D / sqrt(1 - D / Z). So
    D / D0 = sqrt(1 + u^2) - u with u = D0 / (2 Z).
    """
    u = apparent_m / (2 * distance_m)
    return math.sqrt(1 + u * u) - u


def _row(
    treatment: str,
    view: str,
    food: str,
    chosen: Sequence[tuple[Portion, Sizes]],
) -> Row:
    median: dict[str, float] = {}
    absolute: dict[str, float] = {}
    coverage: dict[str, float] = {}
    for axis, name in AXES.items():
        errors = [100 * (sizes[axis].size_m / portion.diameter_m - 1) for portion, sizes in chosen]
        held = [_holds(sizes[axis], portion.diameter_m) for portion, sizes in chosen]
        median[name] = float(np.median(errors))
        absolute[name] = float(np.median(np.abs(errors)))
        coverage[name] = 100 * sum(held) / len(held)
    return Row(treatment, VIEWS[view], food, len(chosen), median, absolute, coverage)


def _holds(size: ims.SizeEstimate, truth_m: float) -> bool:
    low, high = size.interval(0.9)
    return low <= truth_m <= high


def _heading(counts: dict[str, object], portions: int) -> str:
    drawn = counts["source"] == "drawn"
    source = "DRAWN balls and coins (no --root given), not real data" if drawn else "ECUSTFD"
    return (
        f"{source}: {counts['pictures']} pictures, {counts['with_coin']} with one coin, {portions} "
        f"portions of round food; imgscale {ims.__version__}"
    )


def _table(rows: Sequence[Row]) -> list[str]:
    head = "".join(f"{f'{name} % (abs) [90 %]':>25}" for name in AXES.values())
    lines = [f"{'treatment':15}{'view':7}{'food':8}{'n':>4}{head}"]
    for row in rows:
        cells = (
            f"{row.median[name]:+.1f} ({row.absolute[name]:.1f}) [{row.coverage_90[name]:.0f}]"
            for name in AXES.values()
        )
        start = f"{row.treatment:15}{row.view:7}{row.food:8}{row.n:>4}"
        lines.append(start + "".join(f"{cell:>25}" for cell in cells))
    return lines


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
