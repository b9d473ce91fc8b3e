"""
A camera trap: heights and distances of animals
===============================================

A camera that does not move sees one ground plane. On the day it is put up somebody carries a pole
of 1 m through the scene; later pictures are measured by boxes alone. All pictures are drawn here.
"""

import json
import math

import matplotlib.pyplot as plt
import numpy as np

import imgscale as ims
from imgscale.datasets import drawn
from imgscale.plotting import draw_ground_plane, draw_sizes

# %%
# Set-up day: the pole at twelve places, all its boxes fitted as though they were of one picture.

rng, size = np.random.default_rng(7), (960, 540)
setup = drawn.camera_trap_poles(rng=rng)
pole = ims.PriorTable([ims.ObjectPrior("pole", 1.0, 0.002, source="checked with a steel tape")])
camera = ims.Camera(710.0, focal_rel_std=0.02)  # by the maker, for distances
ground = ims.GroundPlane(image_size=size)
model = ims.fit(setup.detections, ground, pole, camera=camera, noise=setup.noise)
print(model, f"(drawn {setup.viewpoint.height_m} m, row {setup.viewpoint.horizon_px:.0f})")
saved = json.dumps(model.to_dict())  # keep this with the pictures

# %%
# Any day after: a table of sizes from the saved model. A tape lies along the ground, not along the
# camera's axis: at the edge of a picture the two distances differ by a fifth.

kept = ims.ScaleModel.from_dict(json.loads(saved))


def over_ground_m(seen: ims.Detection, z_m: float | None) -> float:
    """Turn the distance along the camera's axis into that over the ground."""
    x1, _, x2, y2 = seen.xyxy
    x, y = ((x1 + x2) / 2 - size[0] / 2) / camera.focal_px, (y2 - size[1] / 2) / camera.focal_px
    return math.sqrt(((z_m or math.nan) * math.hypot(1.0, x, y)) ** 2 - kept.k**2)


inside, pictures = [], [drawn.camera_trap(rng=rng) for _ in range(10)]
print("picture,label,height_m,low_m,high_m,distance_m")
for number, scene in enumerate(pictures, start=1):
    sizes = ims.predict(kept, scene.detections)
    for seen, found, true_m in zip(scene.detections, sizes, scene.sizes_m, strict=True):
        low, high = found.interval(0.9)
        numbers = (found.size_m, low, high, over_ground_m(seen, found.distance_m))
        print(number, found.label, *(f"{metres:.2f}" for metres in numbers), sep=",")
        inside.append(low <= true_m <= high)
print(f"{sum(inside)} of {len(inside)} heights drawn are in their 90 % intervals")

# %%
fig, (top, bottom) = plt.subplots(2, figsize=(9.6, 10.8), layout="constrained")
draw_ground_plane(kept, image=setup.image, ax=top)
last = pictures[-1]
draw_sizes(last.image, last.detections, ims.predict(kept, last.detections), ax=bottom)
