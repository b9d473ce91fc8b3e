"""
The relative depth of a network
===============================

MiDaS and Depth Anything give inverse depth up to a factor *and a shift*. Both are fitted, if the
map is declared as what it is. The street is drawn, and so is its map, with smooth errors of 3 %.
"""

import matplotlib.pyplot as plt
import numpy as np

import imgscale as ims
from imgscale.datasets import drawn
from imgscale.plotting import draw_scale_map

# %%
# Such values are large where it is near, and 0 in the sky; neither metres nor their inverse.

rng = np.random.default_rng(1)
scene = drawn.street(rng=rng)
depth = scene.depth_as("affine_inverse", factor=8.0, shift=-0.4, rel_std=0.03, rng=rng)
print(f"values from {depth.values.min():.2f} to {depth.values.max():.2f}")

# %%
# People and cars, near and far, fix factor and shift together; that takes references at two
# distances at least. What was drawn: a factor of 8 over the focal length, and a shift of 0.4 back.

model = ims.fit(scene.detections, depth)
print(model)
print(f"drawn: k {8.0 / scene.viewpoint.focal_px:.4f}, shift 0.4")
statue = ims.predict(model, scene.detections, depth)[-1]
low, high = statue.interval(0.9)
print(f"statue {low:.2f} to {high:.2f} m (drawn {scene.sizes_m[-1]:.2f})")

# %%
# Declared "inverse", the shift is taken as 0. No k fits then: by the same k the near people would
# be children and the far one a giant. `suspect` says that these depths cannot be right.

wrong = ims.DepthMap(depth.values, kind="inverse")
wrong_model = ims.fit(scene.detections, wrong)
scale = [size.metres_per_pixel for size in ims.predict(wrong_model, scene.detections, wrong)]
for seen, metres in list(zip(scene.detections, scale, strict=True))[:3]:
    print(f"{seen.label} would be {metres * seen.height_px:.2f} m high")
for suspicion in ims.suspect(wrong_model):
    print(suspicion)
print("flags:", wrong_model.flags.name)

# %%
# With the right kind, the whole picture has a scale: how many metres a pixel spans, all over it.
# In the sky and far away, where the network gives 0, it means only "not nearer than this".

fig, (top, bottom) = plt.subplots(2, figsize=(9.6, 11), layout="constrained")
top.imshow(depth.values, cmap="gray")
top.set_title("What the network gives")
top.set_axis_off()
draw_scale_map(model, depth, image=scene.image, ax=bottom)
