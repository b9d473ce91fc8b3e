"""
A coin sizes the food beside it
===============================

Seen from above, all on the table is about equally far, so a coin gives the scale. But fruit is not
flat: its widest part is nearer and looks larger. How much, and what to do? The table is drawn.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

import imgscale as ims
from imgscale.datasets import drawn
from imgscale.depth_sources import OneDistance
from imgscale.measuring import extent
from imgscale.plotting import draw_sizes

# %%
# `depth_rel` tells how far things are off the common distance: 8 % suits fruit at arm's length.
# The intervals hold the truth, though their middles are too large for all that is not flat.

scene = drawn.table_top(rng=np.random.default_rng(4))
depth = OneDistance()(scene.image)
coin = ims.PriorTable(ims.PriorTable.default().lookup("2 euro coin"))
round_things = ims.Noise(box_px=1.5, depth_rel=0.08)
model = ims.fit(scene.detections, depth, coin, noise=round_things)
sizes = ims.predict(model, scene.detections, depth, axis="diameter")
for size, true_m in list(zip(sizes, scene.sizes_m, strict=True))[1:]:
    low, high = (1000 * end for end in size.interval(0.9))
    print(f"{size.label:7} {low:2.0f} to {high:3.0f} mm (drawn {1000 * true_m:.0f}),", end=" ")
    print(f"middle {100 * (size.size_m / true_m - 1):+.0f} %")

# %%
# The flat biscuit is right. Fruit comes out too large by its radius over the distance of its
# middle, 4 to 8 % here, and by 2 % more where a ball off the centre looks longer. The focal length
# tells the camera's height h, and so takes the larger part off: a ball that seems to be s wide is
# s / (1 + s / 2h).

height_m = scene.camera.focal_px * model.k
for size, true_m in list(zip(sizes, scene.sizes_m, strict=True))[2:]:
    ball_m = size.size_m / (1 + size.size_m / (2 * height_m))
    print(f"{size.label:7} as a ball {1000 * ball_m:.0f} mm (drawn {1000 * true_m:.0f})")

# %%
# With a mask there is an area too. It is for flat things that face the camera, as the biscuit does.

flat = ims.fit(scene.detections, depth, coin, noise=ims.Noise(box_px=1.5, depth_rel=0.01))
area = extent(flat, scene.masks[1], depth).area
low, high = (1e4 * end for end in area.interval(0.9))
print(f"biscuit {low:.1f} to {high:.1f} cm2", end=" ")
print(f"(drawn {1e4 * math.pi / 4 * scene.sizes_m[1] ** 2:.1f})")

# %%
# A larger coin or a bank card narrows all of this: the coin is 52 px wide and its box errs by 1.5.

fig, ax = plt.subplots(figsize=(9, 6.75), layout="constrained")
draw_sizes(scene.image, scene.detections, sizes, unit="cm", ax=ax)
