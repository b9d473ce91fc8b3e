"""
Sizes from the two pictures of a stereo camera
==============================================

`StereoDepth` matches a rectified pair with OpenCV (extra `stereo`), and the calibration tells
metres without any object of known size. One known object is still worth its box: it checks the
calibration, and this published one does not hold.
"""

import matplotlib.pyplot as plt
import skimage as ski

import imgscale as ims
from imgscale.datasets import motorcycle
from imgscale.depth_sources.stereo import StereoDepth, stereo_disparity
from imgscale.plotting import draw_sizes

# %%
# Two pictures, the calibration as Middlebury publishes it, and boxes drawn by hand on the left one.

left, right, _ = ski.data.stereo_motorcycle()
scene = motorcycle.load()
camera, noise, doffs_px = scene.camera, scene.noise, 31.086

# %%
# The pair alone, without a single prior: the scale is 1 / focal length.

stereo = StereoDepth(camera.focal_px, motorcycle.PUBLISHED_BASELINE_M, doffs_px)
metric = stereo(left, right)
alone = ims.fit(scene.detections, metric, ims.PriorTable([]), camera=camera, noise=noise)
print(*ims.predict(alone, scene.detections, metric), sep="\n")

# %%
# The tyre's code says 120/90-16, so 0.622 m. Given that prior, the fit reports the conflict; it
# keeps to the calibration, because nobody told it to doubt that.

both = ims.fit(scene.detections, metric, scene.priors, camera=camera, noise=noise)
print(ims.explain(both))

# %%
# Doubt it: the disparity is inverse depth whatever the baseline, and k *is* the baseline.

disparity = stereo_disparity(left, right) + doffs_px
inverse = ims.DepthMap(disparity, kind="inverse")
model = ims.fit(scene.detections, inverse, scene.priors, camera=camera, noise=noise)
print(model)
sizes = ims.predict(model, scene.detections, inverse)

# %%
# The sizes with the baseline that was found.

fig, ax = plt.subplots(figsize=(9.6, 6.5), layout="constrained")
draw_sizes(left, scene.detections, sizes, ax=ax)

# %%
# What OpenCV matched. White is what only one camera sees, or what looks alike in several places.

fig, ax = plt.subplots(figsize=(7, 4.3), layout="constrained")
fig.colorbar(ax.imshow(disparity), label="disparity + doffs, px", shrink=0.8)
ax.set_axis_off()
