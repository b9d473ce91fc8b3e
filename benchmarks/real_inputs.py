"""
Measure the chain on real inputs: detectors' boxes on LiDAR maps, stereo pairs, labels for truth.

``python benchmarks/real_inputs.py --root FOLDER`` reads a folder with KITTI's object benchmark in
``kitti/object`` (calib, label_2 and, as 16-bit PNG of metres x 256, ``lidar_depth``), boxes of
detectors in ``kitti/detections`` and one pair of Scene Flow 2015 in ``kitti/scene_flow_2015``.
Without it the stereo pair that scikit-image carries is measured alone (extra "stereo").

k of metric depth is 1 / focal length, so k x focal length is 1 where all is right. No camera is
given to the fit: the sizes of the objects alone say it.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import skimage as ski

import imgscale as ims
from imgscale.datasets import kitti, motorcycle
from imgscale.depth_sources import read_depth, stereo_disparity
from imgscale.detectors import objects_from_kitti, read_kitti

# How much the boxes err, as measured on all frames of these detectors.
BOXES = {
    "labels": ims.Noise(),
    "frustum_pointnets_val": ims.Noise(box_px=2, box_rel=0.04),
    "zenuity": ims.Noise(box_px=2, box_rel=0.06),
}
TYPES = {"1": "Pedestrian", "2": "Car", "3": "Cyclist"}
LEAST_SCORE = 0.5
PAIR, FOCAL_PX, BASELINE_M = "000046_10", 721.5377, 0.53273
DOFFS_PX = 31.086  # of the motorcycle


def main() -> None:
    """Print what the command line asks for."""
    parser = argparse.ArgumentParser(description="The chain on real inputs.")
    parser.add_argument("--root", type=Path, help="the folder, see the top of this file")
    root = parser.parse_args().root
    if root:
        measure_lidar(root / "kitti")
        measure_scene_flow(root / "kitti" / "scene_flow_2015")
    measure_motorcycle()


def measure_lidar(root: Path) -> None:
    """Print k x focal length of every frame that has a LiDAR map, by detector."""
    priors = ims.PriorTable.default(region="eu")
    training = root / "object" / "training"
    print("LiDAR maps: k x focal length by frame, with the boxes of each detector")
    for detector, noise in BOXES.items():
        products: dict[str, float] = {}
        for path in sorted((training / "lidar_depth").glob("*.png")):
            depth = read_depth(path, kind="metric", scale=256)
            seen = list(detections_by(detector, root, path.stem, depth.image_size))
            if seen:
                model = ims.fit(seen, depth, priors, noise=noise)
                products[path.stem] = model.k * focal_px(training / "calib" / f"{path.stem}.txt")
        listed = "  ".join(f"{name} {product:.3f}" for name, product in products.items())
        print(f"  {detector}: median {np.median(list(products.values())):.3f} of {listed}")


def detections_by(
    detector: str, root: Path, name: str, size: tuple[int, int]
) -> Iterator[ims.Detection]:
    """Read what a detector saw in a frame."""
    if detector == "frustum_pointnets_val":
        for line in (root / "detections" / f"{detector}.txt").read_text().splitlines():
            image, kind, score, *corners = line.split()
            if Path(image).stem == name and float(score) >= LEAST_SCORE:
                box = np.clip(np.array(corners, dtype=float), 0, [*size, *size])
                yield ims.Detection(TYPES[kind], box, score=float(score))
        return
    labels = root / "object" / "training" / "label_2"
    folder = labels if detector == "labels" else root / "detections" / detector
    yield from read_kitti(folder / f"{name}.txt", image_size=size)


def focal_px(calib: Path) -> float:
    """Read the focal length of camera 2."""
    rows = dict(line.split(":", 1) for line in calib.read_text().splitlines() if ":" in line)
    return float(rows["P2"].split()[0])


def measure_scene_flow(root: Path) -> None:
    """Print heights of the labelled objects of a pair, from its pictures and from the truth."""
    label = root / "training" / "label_2_matched" / f"{PAIR}.txt"
    objects = [item for item in objects_from_kitti(label.read_text()) if not item.detection.partial]
    priors = ims.PriorTable.default(region="eu")
    print(f"Scene Flow {PAIR}, heights with the camera known")
    for source in ("disparity", "stereo"):
        seen = [item.detection for item in objects]
        frame = kitti.scene_flow_frame(
            root, PAIR, seen, depth=source, focal_px=FOCAL_PX, baseline_m=BASELINE_M
        )
        alone = ims.fit(frame.detections, frame.depth, priors)
        model = ims.fit(frame.detections, frame.depth, priors, camera=frame.camera)
        sizes = ims.predict(model, frame.detections, frame.depth)
        for item, size in zip(objects, sizes, strict=True):
            low, high = size.interval(0.9)
            print(
                f"  {source}: {size.label} {size.size_m:.3f} m, 90 % {low:.2f} to {high:.2f}, true "
                f"{item.height_m:.2f}; k x focal length without the camera {alone.k * FOCAL_PX:.3f}"
            )


def measure_motorcycle() -> None:
    """Print sizes from the two pictures alone beside those from the published disparity."""
    scene = motorcycle.load()
    left, right, _ = ski.data.stereo_motorcycle()
    matched = ims.DepthMap(stereo_disparity(left, right) + DOFFS_PX, kind="inverse")
    print("Motorcycle: size from the two pictures, from the published disparity, difference")
    columns: list[list[ims.SizeEstimate]] = []
    for depth in (matched, scene.depth):
        model = ims.fit(scene.detections, depth, scene.priors, noise=scene.noise)
        columns.append(ims.predict(model, scene.detections, depth))
    for ours, published in zip(*columns, strict=True):
        off = 100 * (ours.size_m / published.size_m - 1)
        print(f"  {ours.label:12} {ours.size_m:.3f}  {published.size_m:.3f} m  {off:+.2f} %")


if __name__ == "__main__":
    main()
