"""
Everything in a photo from one tyre
===================================

One object of known size is enough. In this photo, which scikit-image carries, it is the rear tyre
of a motorcycle: its code 120/90-16 says 16 inches of rim and twice 90 % of 120 mm, 0.622 m.
"""

import matplotlib.pyplot as plt

import imgscale as ims
from imgscale.datasets import motorcycle
from imgscale.plotting import draw_scale_bar, draw_sizes

# %%
# Six boxes drawn by hand, and the raw disparity of a stereo pair. Disparity (plus doffs, the
# difference of the principal points) is inverse depth up to a factor, and is declared so.

scene = motorcycle.load()
depth = ims.DepthMap(scene.shifted_disparity, kind="inverse")

# %%
# What is known: the tyre, with 12 mm of wear and load, and how much boxes and disparities err.

tyre = ims.ObjectPrior("rear tyre", 0.622, 0.012)
noise = ims.Noise(box_px=1.5, depth_rel=0.01)
model = ims.fit(scene.detections, depth, ims.PriorTable([tyre]), camera=scene.camera, noise=noise)
print(model)

# %%
# The constant k of raw disparity is the distance of the two cameras. The published one, 0.193 m,
# would make the tyre 0.43 m high, which no tyre of that code is: the picture knows better.

published = motorcycle.PUBLISHED_BASELINE_M
print(f"baseline published {published:.3f} m, found {model.k:.3f} +- {model.k_std:.3f} m")
print(f"the tyre by the published one: {0.622 * published / model.k:.2f} m\n")

# %%
# Every other box follows, each with its interval. The front rim, for one, is an 18-inch rim, which
# is about 0.485 m high at its lip.

sizes = ims.predict(model, scene.detections, depth)
for size in sizes:
    low, high = size.interval(0.9)
    print(f"{size.label:12} {size.size_m:.3f} m, 90 % within {low:.3f} to {high:.3f} m")

# %%
# A scale bar holds at one distance only, so it is drawn at an object and says at which one.

fig, ax = plt.subplots(figsize=(9.6, 6.5), layout="constrained")
draw_sizes(scene.image, scene.detections, sizes, ax=ax)
draw_scale_bar(model, depth, scene.detections[0], ax=ax)
