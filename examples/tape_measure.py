"""
A tape measure between any two pixels
=====================================

A size need not be that of a box. `distance` lays a tape between two pixels, through space and not
across the picture; `extent` measures what an outline or a mask encloses, its area too.
"""

import matplotlib.pyplot as plt
import numpy as np

import imgscale as ims
from imgscale.datasets import motorcycle
from imgscale.measuring import distance, extent

# %%
# The scale comes from the rear tyre, a 120/90-16. A tape that does not run across the view needs
# the focal length besides, so the camera is given.

scene = motorcycle.load()
depth = scene.depth
model = ims.fit(scene.detections, depth, scene.priors, camera=scene.camera, noise=scene.noise)

# %%
# Two tapes. From wheel to wheel it is about 1.4 m on motorcycles of this size. From the seat to the
# bench is a step across the picture and a long one into the garage.

tapes = {"wheelbase": ((200, 320), (584, 371)), "seat to bench": ((285, 225), (232, 166))}
lengths = {name: distance(model, *ends, depth) for name, ends in tapes.items()}
for name, length in lengths.items():
    low, high = length.interval(0.9)
    print(f"{name}: {length}, 90 % within {low:.2f} to {high:.2f} m")

# %%
# The rear rim, outlined by an ellipse. A 16-inch rim is 0.406 m where the tyre sits, and 0.434 m
# with a lip of 14 mm on either side. It is not quite seen from the side, so its width is less.

angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
outline = np.column_stack([200 + 55 * np.cos(angle), 320 + 57 * np.sin(angle)])
rim = extent(model, outline, depth)
print("rear rim:", rim)

# %%
# Where the tapes and the outline lie. The bench is hidden by the motorcycle in part: a pixel has
# the depth of what is seen at it, and MIXED_DEPTH would tell where two surfaces meet.

fig, ax = plt.subplots(figsize=(9.6, 6.5), layout="constrained")
ax.imshow(scene.image)
ax.fill(*outline.T, fill=False, edgecolor="white", linewidth=2)
dark = {"facecolor": "#202020", "edgecolor": "none", "alpha": 0.8, "pad": 3}
ax.text(200, 385, f"area {rim.area}", color="white", ha="center", va="top", bbox=dark)
for name, ends in tapes.items():
    x, y = np.transpose(ends)
    ax.plot(x, y, "o-", color="white", markersize=5, linewidth=2)
    ax.text(x.mean(), y.mean(), str(lengths[name]), color="white", ha="center", bbox=dark)
ax.set_axis_off()
