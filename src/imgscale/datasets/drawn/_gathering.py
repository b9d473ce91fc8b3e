"""A canvas and the truth become a scene, with boxes as a detector gives them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imgscale._typing import Box
from imgscale.datasets.drawn._canvas import Canvas
from imgscale.datasets.drawn.camera import DrawnCamera
from imgscale.datasets.drawn.scene import DrawnScene
from imgscale.depth import DepthMap
from imgscale.detection import Detection
from imgscale.noise import Noise
from imgscale.priors import PriorTable

BY_HAND = Noise(box_px=1.5)  # how well a person draws a box


def gather(
    canvas: Canvas,
    boxes: Sequence[tuple[str, Box]],
    truth: Sequence[tuple[float, float]],
    priors: PriorTable,
    noise: Noise,
    rng: np.random.Generator | None,
) -> DrawnScene:
    """Make a scene of a canvas and of the label, exact box, size and distance of each thing."""
    return DrawnScene(
        image=np.rint(255 * np.clip(canvas.colours, 0, 1)).astype(np.uint8),
        detections=tuple(_seen(label, box, canvas.camera, noise, rng) for label, box in boxes),
        sizes_m=tuple(size for size, _ in truth),
        distances_m=tuple(distance for _, distance in truth),
        masks=tuple(canvas.owner == number for number in range(len(boxes))),
        depth=DepthMap(canvas.z, kind="metric"),
        viewpoint=canvas.camera,
        priors=priors,
        noise=Noise(box_px=0.0) if rng is None else noise,
    )


def _seen(
    label: str, box: Box, camera: DrawnCamera, noise: Noise, rng: np.random.Generator | None
) -> Detection:
    """Box a thing as a detector does, within the picture; what is cut is marked partial."""
    x1, y1, x2, y2 = box if rng is None else _moved(box, noise, rng)
    width, height = camera.image_size
    inside = (max(x1, 0.0), max(y1, 0.0), min(x2, float(width)), min(y2, float(height)))
    if inside[0] >= inside[2] or inside[1] >= inside[3]:
        msg = (
            f"`things` must be in view; the {label} would be at columns {box[0]:.0f} to "
            f"{box[2]:.0f}, rows {box[1]:.0f} to {box[3]:.0f} of {width} x {height}."
        )
        raise ValueError(msg)
    cut = box[0] < 0 or box[1] < 0 or box[2] > width or box[3] > height
    return Detection(label, inside, partial=cut)


def _moved(box: Box, noise: Noise, rng: np.random.Generator) -> Box:
    """Move the edges of a box as `Noise` means it: its extents err by both parts together."""
    x1, y1, x2, y2 = box
    across, along = (
        rng.normal(0.0, math.hypot(noise.box_px, noise.box_rel * extent) / math.sqrt(2), 2)
        for extent in (x2 - x1, y2 - y1)
    )
    left, right = sorted((x1 + float(across[0]), x2 + float(across[1])))
    top, bottom = sorted((y1 + float(along[0]), y2 + float(along[1])))
    return (left, top, right, bottom)
