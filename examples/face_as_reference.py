"""
A face as reference
===================

Faces vary little in size, and a face detector finds them without a download. Here the face of an
astronaut tells how large the mission patch on her suit is, taken to be as far away as the face.
"""

from typing import Any

import matplotlib.pyplot as plt
import skimage as ski

import imgscale as ims
from imgscale.depth_sources import OneDistance
from imgscale.detectors import FaceDetector
from imgscale.plotting import draw_sizes

# %%
# `measure` runs the whole chain: a detector and a depth source are functions of the picture. The
# patch was boxed by hand; a detector of your own would return both.

faces, patch = FaceDetector(), ims.Detection("mission patch", (133, 348, 208, 423))
astronaut: Any = ski.data.astronaut  # untyped there
image = astronaut()
result = ims.measure(
    image,
    detector=lambda picture: [*faces(picture), patch],
    depth_source=OneDistance(),
)
print(result.model)

# %%
# The label of the face says what its box spans: the shipped table knows how high the boxes of this
# very detector are, and how much faces differ.

prior = ims.PriorTable.default().lookup(result.detections[0].label)[0]
print(f"{prior.label}: {prior.mean_m} +- {prior.std_m} m ({prior.spans})")

# %%
# One reference, so one interval that holds all there is to doubt: the spread of faces, the boxes,
# and 5 % for what is said to be equally far and is not quite. The flag says that nothing checks it.

size = result.estimates[1]
low, high = size.interval(0.9)
print(f"{size.label}: {100 * size.size_m:.0f} cm, 90 % within {100 * low:.0f} to {100 * high:.0f}")
print("reservations:", size.flags.name or "none", "| of the model:", result.model.flags.name)

# %%
# Where it breaks: a child's face is smaller, a face nearer than the thing beside it makes the thing
# look smaller than it is, by the ratio of the distances.

fig, ax = plt.subplots(figsize=(7, 7), layout="constrained")
draw_sizes(image, result.detections, result.estimates, unit="cm", ax=ax)
