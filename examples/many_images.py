"""
Many pictures, some of them broken
==================================

`measure_many` goes through a folder as a stream, past pictures that fail. With a record every
result is on disk as soon as it is there, and a run that was cut short goes on where it ended.
"""

import csv
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import imgscale as ims
from imgscale.datasets.drawn import DrawnCamera, Thing, draw
from imgscale.depth_sources import OnGround

# %%
# Six drawn streets stand for your folder: two people, a car, and a statue of another height each
# time. Boxes by file name are what `imgscale.detectors.read_coco` and its like return.

folder, rng = tempfile.TemporaryDirectory(), np.random.default_rng(8)
view = DrawnCamera(image_size=(640, 360), focal_px=520, height_m=1.6)
paths = [Path(folder.name, f"street{number}.png") for number in range(1, 7)]
boxes, truth = dict[str, tuple[ims.Detection, ...]](), rng.uniform(1.8, 3.2, len(paths))
for path, height in zip(paths, truth, strict=True):
    people = [Thing("person", x, rng.uniform(5, 9), rng.normal(1.73, 0.09)) for x in (-1.5, 0)]
    things = [*people, Thing("car", -4, 14, 1.5), Thing("statue", 2.5, rng.uniform(8, 12), height)]
    street = draw(view, things, ground="street", rng=rng)
    plt.imsave(path, street.image)
    boxes[path.name] = street.detections
paths[2].write_bytes(paths[2].read_bytes()[:5000])  # the copying of this one was cut short

# %%
# The first run ends early. The second takes up what is missing and tries the broken one again.

record, ground = Path(folder.name, "record.jsonl"), OnGround(camera_height_m=1.6)
for run in (paths[:4], paths):
    for done in ims.measure_many(run, detector=boxes, depth_source=ground, record=record):
        print(f"{Path(done.path).name}: {str(done.error or 'measured').rpartition(': ')[2]}")

# %%
# The record as one table, for pandas or a spreadsheet, and the statues in it beside their truth.

seen = ims.read_record(record)
rows = [{"picture": Path(at["path"]).name, **row} for at in seen for row in at.get("objects", ())]
with Path(folder.name, "sizes.csv").open("w", newline="", encoding="utf-8") as file:
    writer = csv.DictWriter(file, rows[0])
    writer.writeheader()
    writer.writerows(rows)
statues = {row["picture"]: row for row in rows if row["label"] == "statue"}
low, size, high = ([row[f"{end}_m"] for row in statues.values()] for end in ("low", "size", "high"))
fig, ax = plt.subplots(figsize=(7, 4), layout="constrained")
ax.plot([path.name for path in paths], truth, "k_", markersize=16, label="drawn")
ax.plot(list(statues), size, "o", label="measured")
ax.vlines(list(statues), low, high, linewidth=6, alpha=0.4, label="90 % interval")
ax.legend(title="height of the statue, m", loc="upper center")
folder.cleanup()
