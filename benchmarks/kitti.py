"""
Measure errors and coverage on KITTI's object labels, real detections and LiDAR maps.

``python benchmarks/kitti.py --root FOLDER`` reads a folder in KITTI's native layout (label_2 and
calib in FOLDER, FOLDER/training or FOLDER/object/training; optional: frames.csv, detections,
lidar_depth). Without ``--root`` the same rows run on synthetic scenes, which need no data. A full
run takes long: ``--jobs 2`` works in two processes, ``--rows`` and ``--images`` take a part.
"""

from __future__ import annotations

import argparse
import fnmatch
import sys
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import kitti_scenes
import numpy as np
import synthetic_scenes
from kitti_layout import LayoutError, find_folders, read_lines
from validation_goals import Goal, goals, mean_coverage
from validation_jobs import Validation
from validation_priors import prior_table
from validation_protocols import Setting
from validation_report import goal_list, table, write_json
from validation_rows import Row, all_rows
from validation_scenes import Scene
from validation_scores import Scores, score
from validation_views import SEED

import imgscale as ims

_SYNTHETIC_IMAGES = 20


class UsageError(Exception):
    """The command line asks for what there is not."""


def main(arguments: Sequence[str]) -> int:
    """Run the validation; return 2 where it cannot begin."""
    options = _parser().parse_args(arguments)
    start = time.perf_counter()
    try:
        rows = _chosen_rows(options.rows)
        scenes = _scenes(options)
        _check_writable(options.json)
    except (UsageError, LayoutError) as error:
        print(f"kitti.py: {error}", file=sys.stderr)
        return 2
    print("kitti.py", *arguments)
    print(_heading(options, scenes))
    print()
    setting = Setting(prior_table(options.priors), options.method)
    with closing(Validation(scenes, setting, options.jobs)) as validation:
        scores = _scores(validation, rows)
    print("\n".join(table(rows, scores)))
    coverage = mean_coverage(scores)
    if not np.isnan(coverage):
        print(f"\nMean coverage of 90 % intervals over told rows with noise: {coverage:.1f} %")
    reached: list[Goal] = []
    if options.root and options.priors == "prototype":
        reached = goals({row.name: row for row in rows}, scores)
        print("\n".join(goal_list(reached)))
    if options.json:
        write_json(options.json, _meta(options, scenes), rows, scores, reached)
    print(f"\n{time.perf_counter() - start:.0f} s")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="kitti.py", description=__doc__)
    parser.add_argument("--root", type=Path, help="folder in KITTI's layout")
    parser.add_argument("--drives", type=Path, help="file with the drives to take, one a line")
    parser.add_argument("--priors", choices=("default", "prototype"), default="prototype")
    parser.add_argument("--method", choices=("robust", "posterior"), help="default: that of fit")
    parser.add_argument("--rows", help="rows to run, by name or pattern, with commas: 'L-told-*'")
    parser.add_argument("--images", type=_count, help="take so many images, evenly spread")
    parser.add_argument("--jobs", type=_count, default=1, help="processes, for the same figures")
    parser.add_argument("--json", type=Path, help="file for the figures")
    return parser


def _count(text: str) -> int:
    number = int(text)
    if number < 1:
        msg = f"must be at least 1, got {number}"
        raise argparse.ArgumentTypeError(msg)
    return number


def _chosen_rows(patterns: str | None) -> list[Row]:
    rows = all_rows()
    if patterns is None:
        return rows
    names = [row.name for row in rows]
    chosen: set[str] = set()
    for pattern in patterns.split(","):
        found = fnmatch.filter(names, pattern.strip())
        if not found:
            msg = f"--rows: no row is called {pattern!r}; there are {', '.join(names)}."
            raise UsageError(msg)
        chosen.update(found)
    return [row for row in rows if row.name in chosen]


def _scenes(options: argparse.Namespace) -> list[Scene]:
    if options.root is None:
        if options.drives:
            msg = "--drives needs --root: synthetic scenes have no drives."
            raise UsageError(msg)
        return synthetic_scenes.make_scenes(options.images or _SYNTHETIC_IMAGES, SEED)
    scenes = kitti_scenes.read_scenes(find_folders(options.root))
    if options.drives:
        wanted = {line.strip() for line in read_lines(options.drives)}
        scenes = [scene for scene in scenes if scene.drive in wanted]
    if not scenes:
        msg = "--drives: none of these drives is there."
        raise UsageError(msg)
    if options.images and options.images < len(scenes):
        places = np.linspace(0, len(scenes) - 1, options.images).round().astype(int)
        scenes = [scenes[place] for place in places]
    return scenes


def _check_writable(path: Path | None) -> None:
    """Find out before the work whether its result can be kept."""
    if path is not None and (path.is_dir() or not path.absolute().parent.is_dir()):
        msg = f"--json: {path} is no file in an existing folder."
        raise UsageError(msg)


def _scores(validation: Validation, rows: Sequence[Row]) -> dict[str, Scores]:
    scores = {row.name: score(validation, row) for row in rows}
    return {name: reached for name, reached in scores.items() if reached is not None}


def _heading(options: argparse.Namespace, scenes: Sequence[Scene]) -> str:
    meta = _meta(options, scenes)
    source = "KITTI" if options.root else "SYNTHETIC scenes (no --root given), not real data"
    first = (
        f"{source}: {meta['frames']} images of {meta['drives']} drives with {meta['objects']} "
        f"objects fit for use; priors: {meta['priors']}; method: {meta['method']}; "
        f"seed {meta['seed']}; imgscale {meta['imgscale']}"
    )
    parts = [f"images with boxes of {boxes}: {number}" for boxes, number in _detections(scenes)]
    parts = parts or ["no detections"]
    maps = _depth_maps(scenes)
    parts.append(f"images with a depth map: {maps}" if maps else "no depth maps")
    if options.root and meta["drives"] == meta["frames"]:
        parts.append("each image counts as a drive of its own")
    lines = [first, "; ".join(parts)]
    if not options.root:
        lines.append(
            "Heights follow the prototype priors; detections and maps are simulated. At 0 % noise "
            "the library is\ntold 1.5 %, so only from 5 % on must coverage agree with its level. "
            "Known objects stand on the ground,\nothers not always."
        )
    return "\n".join(lines)


def _detections(scenes: Sequence[Scene]) -> list[tuple[str, int]]:
    """Count by detector the images in which it found an object."""
    detectors = sorted({boxes for scene in scenes for boxes in scene.detected})
    return [(name, sum(bool(scene.detected.get(name)) for scene in scenes)) for name in detectors]


def _depth_maps(scenes: Sequence[Scene]) -> int:
    return sum(scene.read_depth_map is not None for scene in scenes)


def _meta(options: argparse.Namespace, scenes: Sequence[Scene]) -> dict[str, object]:
    return {
        "source": "KITTI" if options.root else "synthetic",
        "frames": len(scenes),
        "drives": len({scene.drive for scene in scenes}),
        "objects": sum(len(scene.things) for scene in scenes),
        "detections": dict(_detections(scenes)),
        "depth_maps": _depth_maps(scenes),
        "priors": options.priors,
        "method": options.method or "default of fit",
        "seed": SEED,
        "imgscale": ims.__version__,
    }


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
