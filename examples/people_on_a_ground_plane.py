"""
People on a ground plane: sizes without any depth
=================================================

Who stands lower in the picture stands nearer. On level ground that alone is a measure of distance:
no depth map is needed. The scene is drawn, so that the truth is known.
"""

import matplotlib.pyplot as plt
import numpy as np

import imgscale as ims
from imgscale.datasets import drawn
from imgscale.plotting import draw_ground_plane, draw_sizes

# %%
# Three people, two cars, a statue, boxed as a good detector does: edges err by about 1.5 px. The
# shipped table knows how high people and cars are and how much they differ.

scene = drawn.street(rng=np.random.default_rng(2))
camera = ims.Camera(820.0, focal_rel_std=0.04, image_size=(960, 540))  # as EXIF tells it
model = ims.fit(scene.detections, ims.GroundPlane(image_size=(960, 540)), camera=camera)
print(model)

# %%
# The fit finds where the camera was: its height above the ground, which is the constant k, and the
# horizon. Whatever reaches up to the horizon is as high as the camera.

truth = scene.viewpoint
if plane := model.plane:
    height, row = plane.camera_height_m, plane.horizon_px
    print(f"camera {height:.2f} +- {plane.camera_height_std_m:.2f} m up ({truth.height_m} drawn)")
    print(f"horizon in row {row:.0f} +- {plane.horizon_std_px:.0f} ({truth.horizon_px:.0f} drawn)")

# %%
# With both, everything that stands on the ground has a size, the statue too. Distances need the
# focal length besides; sizes hardly do.

sizes = ims.predict(model, scene.detections)
for size, drawn_m, away_m in zip(sizes, scene.sizes_m, scene.distances_m, strict=True):
    low, high = size.interval(0.9)
    print(f"{size.label:7} {low:.2f} to {high:.2f} m (drawn {drawn_m:.2f}),", end=" ")
    print(f"{size.distance_m:4.1f} m away (drawn {away_m:.1f})")

# %%
# The horizon and a grid of one-metre squares show whether to believe it: the grid should lie on the
# ground as the pavement does. Where it breaks: a slope, stairs, a foot that is hidden.

fig, (top, bottom) = plt.subplots(2, figsize=(9.6, 10.8), layout="constrained")
draw_sizes(scene.image, scene.detections, sizes, ax=top)
draw_ground_plane(model, image=scene.image, camera=camera, ax=bottom)
