"""
A CCTV still: a person's height, with an interval that can be defended
======================================================================

Two doors and the height of the lens were measured on site with a steel tape; the maker tells the
focal length within 3 %. The still is drawn, and what is told of it is never quite what was drawn.
"""

import json

import matplotlib.pyplot as plt
import numpy as np

import imgscale as ims
from imgscale.datasets import drawn
from imgscale.plotting import draw_sizes

# %%
# All that is given, with how well it is known. Boxes by hand err by 1.5 px; an indoor floor is flat
# within 0.5 % of the camera's height.

still = drawn.hallway(rng=np.random.default_rng(1))
tape = "steel tape, mean of three readings"
readings = {"door A": 2.031, "door B": 2.043}
doors = ims.PriorTable([ims.ObjectPrior(*row, 0.003, source=tape) for row in readings.items()])
size = (1280, 720)
ground = ims.GroundPlane(image_size=size, camera_height_m=2.60, camera_height_std_m=0.03)
camera = ims.Camera(912.0, focal_rel_std=0.03, image_size=size)
noise = ims.Noise(box_px=1.5, depth_rel=0.005)

# %%
# The height, and what its error is made of.

model = ims.fit(still.detections, ground, doors, camera=camera, noise=noise)
person = ims.predict(model, still.detections)[-1]
low, high = person.interval(0.95)
print(f"{person.size_m:.2f} m, with 95 % probability {low:.2f} to {high:.2f} m", end=" ")
print(f"(drawn {still.sizes_m[-1]} m, in shoes)\n")
print(ims.explain(model, [person]))

# %%
# The check: each door is sized as though nobody had measured it, and compared with the tape.

left_out = ims.leave_one_out(still.detections, ground, doors, camera=camera, noise=noise)
for door, prior in zip(left_out[:2], doors, strict=True):
    shortest, tallest = door.interval(0.95)
    verdict = "agrees with" if shortest <= prior.mean_m <= tallest else "contradicts"
    print(f"{door.label} from the other: {shortest:.2f} to {tallest:.2f} m,", end=" ")
    print(f"which {verdict} the tape, {prior.mean_m} m")

# %%
# The record repeats the measurement elsewhere: priors with their sources, options, each weight.

record = json.dumps(model.to_dict(), indent=2)
again = ims.predict(ims.ScaleModel.from_dict(json.loads(record)), still.detections)[-1]
print(f"a record of {len(record)} characters, by imgscale {ims.__version__}: {again.size_m:.2f} m")

fig, ax = plt.subplots(figsize=(9.6, 5.4), layout="constrained")
draw_sizes(still.image, still.detections, [*left_out[:2], person], level=0.95, ax=ax)
