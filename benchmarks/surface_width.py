"""
Show how much results depend on the width of what the sampler takes for one surface.

The motorcycle scene: the front rim (nominal 0.485 m) from the rear tyre. With KITTI's LiDAR maps
(IMGSCALE_DATA, or ../shared/data beside the checkout): sizes from labelled boxes and the true focal
length against the labelled heights.
"""

import os
from pathlib import Path

import numpy as np
from PIL import Image

import imgscale as ims
from imgscale import sampling
from imgscale.datasets import motorcycle

WIDTHS = (0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.10, 0.15)
RIM_M = 0.485
DATA = Path(os.environ.get("IMGSCALE_DATA", Path(__file__).parents[2] / "shared" / "data"))
KITTI = DATA / "kitti" / "object" / "training"
CLASSES = {"Car", "Van", "Truck", "Pedestrian", "Cyclist", "Tram", "Misc"}


def rim() -> tuple[float, float]:
    """Size the rim; return its relative error and the upper half of its 90 % interval."""
    scene = motorcycle.load()
    depth = scene.depth
    model = ims.fit(scene.detections, depth, scene.priors, noise=scene.noise)
    size = ims.predict(model, scene.detections, depth)[1]
    return size.size_m / RIM_M - 1, size.interval(0.9)[1] / size.size_m - 1


def lidar_errors() -> list[float]:
    """Compare sizes of labelled boxes on LiDAR maps with their labels, in log."""
    errors: list[float] = []
    for path in sorted((KITTI / "lidar_depth").glob("*.png")):
        with Image.open(path) as image:
            depth = ims.DepthMap(np.asarray(image) / 256.0, kind="metric")
        calibration = (KITTI / "calib" / f"{path.stem}.txt").read_text(encoding="utf-8")
        rows = [line.split() for line in calibration.splitlines()]
        focal_px = next(float(row[1]) for row in rows if row and row[0] == "P2:")
        labels = (KITTI / "label_2" / f"{path.stem}.txt").read_text(encoding="utf-8")
        for row in (line.split() for line in labels.splitlines()):
            box = tuple(float(cell) for cell in row[4:8])
            seen = row[0] in CLASSES and float(row[1]) == 0 and int(row[2]) <= 1
            if not seen or box[3] - box[1] < 25:
                continue
            sample = sampling.sample_surface(
                depth.values, box, kind="metric", image_size=depth.image_size, nearness=-1
            )
            size_m = sample.value * (box[3] - box[1]) / focal_px
            errors.append(float(np.log(size_m / float(row[8]))))
    return errors


def main() -> None:
    """Print one row per width."""
    print("width   rim error  90 % interval   LiDAR boxes: n  median |error|  > 10 %")
    shipped = sampling._SURFACE_LOG_WIDTH
    for width in WIDTHS:
        sampling._SURFACE_LOG_WIDTH = width
        error, half = rim()
        line = f"{width:.2f}{'*' if width == shipped else ' '}   {error:+8.1%}  {half:+12.1%}"
        errors = np.abs(lidar_errors())
        if errors.size:
            line += f" {errors.size:18d} {np.median(errors):14.1%} {np.mean(errors > 0.1):8.0%}"
        print(line)
    sampling._SURFACE_LOG_WIDTH = shipped
    print("* as shipped")


if __name__ == "__main__":
    main()
