"""
A folder of KITTI: many frames of one camera
============================================

`imgscale.datasets.kitti` reads the object benchmark as frames: boxes, metric depth and camera.
`fit_shared` gives them one scale. As the depth is in metres, k times the focal length has to be 1.
``KITTI_ROOT=folder python kitti_folder.py`` reads your own copy; without it a tiny one is drawn.
"""

import os
import tempfile
from itertools import islice
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import imgscale as ims
from imgscale.datasets import drawn, kitti

# %%
# The tiny copy: `label_2` and `calib` of 40 frames, all that depth from labels needs. Sizes vary as
# those of a street do, and KITTI counts pixels from the middle of the first one.

folder, rng = tempfile.TemporaryDirectory(), np.random.default_rng(2015)
view = drawn.DrawnCamera(image_size=(1242, 375), focal_px=721.5, height_m=1.65)
for number in range(40):
    text = {"calib": "P2: 721.5 0 620.5 0 0 721.5 187 0 0 0 1 0", "label_2": ""}
    for kind, mean, std, long in 2 * (("Car", 1.53, 0.13, 4.2), ("Pedestrian", 1.73, 0.1, 0.5)):
        h, z, side = rng.normal(mean, std), rng.uniform(8, 40), rng.uniform(-0.5, 0.5)
        x = side * z
        ends = view.project([(x - long / 2, h, z), (x + long / 2, 0, z)]).ravel() - 0.5
        box = " ".join(f"{edge:.2f}" for edge in ends)
        text["label_2"] += f"{kind} 0 0 0 {box} {h:.2f} 1 {long} {x:.2f} 1.65 {z + 0.5:.2f} 0\n"
    for part, lines in text.items():
        path = Path(folder.name, part, f"{number:06}.txt")
        path.parent.mkdir(exist_ok=True)
        path.write_text(lines, encoding="utf-8")

# %%
# KITTI was recorded with several calibrations: the frames of the first one are kept. The fit is not
# told the focal length, because that is what it is tested by.

read = kitti.object_frames(os.environ.get("KITTI_ROOT", folder.name), depth="labels")
frames = list(islice(read, 300))
camera = next(frame.camera for frame in frames if frame.camera)
own = [ims.Frame(f.detections, f.depth, name=f.name) for f in frames if f.camera == camera]
models = ims.fit_shared(own, ims.PriorTable.default(region="eu"))
found, std = camera.focal_px * models[0].k, camera.focal_px * models[0].k_std
print(models[0], f"k x focal length = {found:.3f} +- {std:.3f} from {len(own)} frames", sep="\n")

# %%
# Dots: what each reference says alone. Band: what they say together, with 95 %.

fig, ax = plt.subplots(figsize=(8, 4.5), layout="constrained")
used = [ref for model in models for ref in model.references if ref.used]
ax.scatter([ref.depth for ref in used], [ref.k * camera.focal_px for ref in used], s=14, alpha=0.5)
ax.axhspan(found - 2 * std, found + 2 * std, color="black", alpha=0.25)
ax.set(xlabel="distance, m", ylabel="k x focal length")
folder.cleanup()
