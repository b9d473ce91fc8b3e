"""
The paper's experiment on its own kind of pictures, with the truth beside it.

    python paper_on_kitti.py --root FOLDER [--depth labels|lidar] [--frames 300]

FOLDER is that of KITTI's object benchmark, which everybody downloads for themselves: label_2, calib
and image_2, and velodyne for `--depth lidar`. Without it, what the paper prints is recomputed from
the numbers that it prints.

The paper takes objects of known mean height (Table 3.2), one k for each picture, the mean of
height / (pixels x depth), and sizes everything by k x depth x pixels. On KITTI each object is sized
from the others of its picture, by these steps and by imgscale's.
"""

import argparse
from collections.abc import Iterable
from pathlib import Path

import numpy as np

import imgscale as ims
from imgscale.datasets import kitti, paper

SMALLEST_PX = 25  # KITTI's own evaluation leaves out what is smaller
TABLE, OURS = ims.PriorTable.paper(), ims.PriorTable.default(region="eu")


def main() -> None:
    """Do what the command line asks for."""
    parser = argparse.ArgumentParser(description="The paper's experiment on KITTI.")
    parser.add_argument("--root", type=Path, help="KITTI's object benchmark")
    parser.add_argument("--depth", choices=("labels", "lidar"), default="labels")
    parser.add_argument("--frames", type=int, default=300, help="how many, evenly spread")
    options = parser.parse_args()
    if options.root is None:
        recompute_the_paper()
        print("\nOn real pictures: python paper_on_kitti.py --root FOLDER_OF_KITTI")
        return
    if options.frames < 1:
        parser.error(f"--frames must be 1 or more; got {options.frames}")
    names = frame_names(options.root, options.depth, options.frames)
    compare_on(kitti.object_frames(options.root, names or None, depth=options.depth))


def frame_names(root: Path, depth: str, count: int) -> list[str]:
    """Choose so many frames, or all where there are fewer, evenly spread."""
    found = "velodyne/*.bin" if depth == "lidar" else "label_2/*.txt"
    for folder in (root, root / "training"):
        names = sorted(path.stem for path in folder.glob(found))
        if names:
            chosen = np.linspace(0, len(names) - 1, min(count, len(names)))
            return [names[index] for index in np.rint(chosen).astype(int)]
    return []


def recompute_the_paper() -> None:
    """Repeat figures 3.14 to 3.18 with one k for each picture, the method's own rule."""
    print(f"{'':10}  k (cm)                 mean squared error (cm2)")
    print(f"{'picture':10}  printed   recomputed   printed  with this k  each left out")
    for name, printed in paper.PUBLISHED.items():
        frame, heights = paper.frame(name), paper.actual_heights(name)
        given = (frame.detections, frame.depth, heights)
        model = ims.fit(*given, method="mean_ratio")
        left_out = [size.size_m for size in ims.leave_one_out(*given, method="mean_ratio")]
        mse_m2 = np.mean(np.subtract(left_out, [prior.mean_m for prior in heights]) ** 2)
        print(
            f"{name:10}  {printed.k_mean:.6f}  {100 * model.k:.6f} {printed.mse_cm2:11.0f}"
            f" {1e4 * model.mse_m2:12.0f} {1e4 * mse_m2:14.0f}"
        )
    print("An error of 0 is what each object's own k gives: it returns the height that went in.")


def compare_on(frames: Iterable[kitti.KittiFrame]) -> None:
    """Size every object from the others of its picture, both ways, and print how well."""
    scales, rows, without = [], [], 0
    for frame in frames:
        given = (frame.detections, frame.depth)
        try:
            theirs = ims.leave_one_out(*given, TABLE, method="mean_ratio")
            ours = ims.leave_one_out(*given, OURS, use_prior=True)
        except ims.FitError:  # fewer than two objects of known height
            without += 1
            continue
        models = ims.fit(*given, TABLE, method="mean_ratio"), ims.fit(*given, OURS)
        scales.append([model.k * frame.camera.focal_px for model in models])
        for true, one, other in zip(frame.objects, theirs, ours, strict=True):
            seen = true.detection
            if not seen.partial and seen.height_px >= SMALLEST_PX:
                in_table = any(name in TABLE for name in seen.names)
                low, high = other.interval(0.9)
                inside = low <= true.height_m <= high
                rows.append((in_table, true.height_m, one.size_m, other.size_m, inside))
    print(f"{len(scales)} pictures hold two objects of known height or more, {without} do not.\n")
    if not scales:
        return
    print(f"{'':44}{'paper':>10}{'imgscale':>10}")
    low, middle, high = np.quantile(scales, [0.05, 0.5, 0.95], axis=0)
    print_row("k x focal length, in truth 1: median", middle)
    print_row("  of 90 % of the pictures, from", low)
    print_row("  to", high)
    print_group("in the paper's table", [row for row in rows if row[0]])
    print_group("not in it, most of them in imgscale's", [row for row in rows if not row[0]])
    print("\nBy its own k each object of the paper's table has the error 0, as the paper prints.")


def print_group(title: str, rows: list[tuple[float, ...]]) -> None:
    """Print the errors of some objects."""
    columns = np.array(rows, dtype=float).reshape(-1, 5).T
    good = np.isfinite(columns).all(axis=0)
    _, truth, *sizes, inside = columns[:, good]
    print(f"{np.count_nonzero(good)} objects {title}:")
    if good.any():
        errors = [size - truth for size in sizes]
        print_row("  median error, %", [100 * np.median(np.abs(e) / truth) for e in errors], 1)
        print_row("  mean squared error, cm2", [1e4 * np.mean(e**2) for e in errors], 0)
        print(f"  90 % intervals that hold the truth, %{100 * inside.mean():27.0f}")


def print_row(title: str, values: list[float], digits: int = 2) -> None:
    """Print one line of the table."""
    print(f"{title:44}" + "".join(f"{value:10.{digits}f}" for value in values))


if __name__ == "__main__":
    main()
