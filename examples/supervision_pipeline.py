"""
Sizes in a pipeline of supervision
==================================

`supervision` (extra `supervision`) carries the boxes of many detectors as `sv.Detections`.
`from_supervision` takes them, `with_sizes` writes the sizes back into their `data`, where filters,
annotators and sinks find them.
"""

import matplotlib.pyplot as plt
import numpy as np
import supervision as sv

import imgscale as ims
from imgscale.datasets import drawn
from imgscale.detectors.supervision import from_supervision, with_sizes

# %%
# A drawn street stands for your picture, your detector and your depth network: inverse depth up to
# a factor and a shift, as MiDaS or Depth Anything give it, with a noise of 3 %.

rng = np.random.default_rng(3)
noise = ims.Noise(box_px=1.5)
street = drawn.street(rng=rng, noise=noise)
depth = street.depth_as("affine_inverse", rel_std=0.03, rng=rng)
found = sv.Detections(  # as sv.Detections.from_transformers(...) and its like return them
    xyxy=np.array([one.xyxy for one in street.detections]),
    class_id=np.array([0, 0, 0, 1, 1, 2]),
    data={"class_name": np.array([one.label for one in street.detections])},
)

# %%
# Three people and two cars are known; the statue is not.

detections = from_supervision(found)
model = ims.fit(detections, depth, noise=noise)
sized = with_sizes(found, ims.predict(model, detections, depth))
print(model)
print({name: column.round(2).tolist() for name, column in sized.data.items() if "_m" in name})

# %%
# Sizes filter like any other column.

tall = sized[sized.data["height_low_m"] > 2]
print(f"surely more than 2 m: {', '.join(tall.data['class_name'])}, drawn with 2.6 m")

# %%
# And the annotators of supervision draw them.

ends = zip(sized.data["height_low_m"], sized.data["height_high_m"], strict=True)
labels = [f"{low:.1f} to {high:.1f} m" for low, high in ends]
picture = sv.BoxAnnotator(thickness=2).annotate(street.image.copy(), sized)
picture = sv.LabelAnnotator(text_padding=4, smart_position=True).annotate(picture, sized, labels)
fig, ax = plt.subplots(figsize=(9.6, 5.4), layout="constrained")
ax.imshow(picture)
ax.set_axis_off()
