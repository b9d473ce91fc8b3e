"""
A depth map put into metres by one known object
===============================================

Structure from motion, raw disparity and most depth networks tell how far things are only up to a
factor. One object of known size in the picture fixes it, and `ScaleModel.to_metric` turns the whole
map into metres. Here the map is the raw disparity of the motorcycle that scikit-image carries.
"""

import matplotlib.pyplot as plt
import numpy as np

import imgscale as ims
from imgscale.datasets import motorcycle

# %%
# Disparity plus the difference of the principal points (doffs) is inverse depth up to a factor.
# Only the rear tyre is known: a 120/90-16 is 16 inches of rim and twice 90 % of 120 mm high.

scene = motorcycle.load()
depth = ims.DepthMap(scene.shifted_disparity, kind="inverse")
tyre = ims.ObjectPrior("rear tyre", 0.622, 0.012)
noise = ims.Noise(box_px=1.5, depth_rel=0.01)  # boxes by hand, a good disparity
model = ims.fit(scene.detections, depth, ims.PriorTable([tyre]), noise=noise)
print(model)

# %%
# A distance needs the focal length too: Z = focal length x metres per pixel. The new map carries
# the error of its scale, which is that of the tyre's size and box.

metric = model.to_metric(depth, scene.camera)
nearest, farthest = np.nanpercentile(metric.values, [1, 99])
print(f"{nearest:.2f} to {farthest:.2f} m, as a whole within {metric.scale_rel_std:.1%}")

# %%
# The check: the same disparity with the published baseline of the two cameras. The two maps differ
# by one factor everywhere, and that is k over this baseline. With the published one the tyre would
# be 0.43 m high, which no 120/90-16 is.

published = ims.DepthMap.from_disparity(
    scene.shifted_disparity,
    focal_px=scene.camera.focal_px,
    baseline_m=motorcycle.PUBLISHED_BASELINE_M,
)
ratio = metric.values / published.values
print(f"ratio of the maps {np.nanmin(ratio):.3f} to {np.nanmax(ratio):.3f}")
print(f"k / published baseline {model.k / motorcycle.PUBLISHED_BASELINE_M:.3f}")

# %%
# Metres for every pixel; white is where the disparity is missing.

fig, ax = plt.subplots(figsize=(9, 5.4), layout="constrained")
shown = ax.imshow(metric.values, cmap="viridis_r", vmin=nearest, vmax=farthest)
fig.colorbar(shown, label="distance along the optical axis, m", shrink=0.8)
dark = {"facecolor": "#202020", "edgecolor": "none", "alpha": 0.75, "pad": 2}
for x, y in ((150, 320), (535, 160), (250, 60), (610, 65), (660, 250), (450, 465)):
    ax.plot(x, y, "wo", markersize=6, markeredgecolor="black")
    ax.text(x + 9, y, f"{metric.values[y, x]:.2f} m", color="white", va="center", bbox=dark)
ax.set_axis_off()
