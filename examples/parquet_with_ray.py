"""
Parquet to Parquet with Ray
===========================

`fit_arrow` takes an Arrow table with a picture per row and gives it back with the sizes. It keeps
no state, so an engine may map it over files: here Ray (extra `ray`) on two cores of one machine. On
a cluster only `ray.init()` differs.
"""

import logging
import tempfile
from functools import partial

import matplotlib.pyplot as plt
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import ray

import imgscale as ims
from imgscale.batch import fit_arrow

# %%
# Drawn numbers stand for what your detector and your depth network gave: 2000 pictures of three
# people, a car and a statue each, in lists. Boxes err by 1 px and inverse depths by 4 %.

rng, folder = np.random.default_rng(2), tempfile.TemporaryDirectory(prefix="ray")
true_m = rng.normal([1.68, 1.68, 1.68, 1.6, 2.4], [0.09, 0.09, 0.09, 0.1, 0.3], (2000, 5))
away_m = rng.uniform(5, 30, true_m.shape)
pixels = rng.normal(900 * true_m / away_m, 1.0)
inverse = 500 / away_m * rng.lognormal(0, 0.04, true_m.shape)
lists = {"pixels": [*pixels], "depth": [*inverse], "true_m": [*true_m]}
pictures = pa.table({"label": [["person"] * 3 + ["car", "statue"]] * 2000, **lists})
for part in range(4):
    pq.write_table(pictures.slice(500 * part, 500), f"{folder.name}/found{part}.parquet")

# %%
# The job is `fit_arrow` with all that holds for every picture. Ray hands it the files in pieces.

table = ims.PriorTable([ims.ObjectPrior("person", 1.68, 0.09), ims.ObjectPrior("car", 1.6, 0.1)])
job = partial(fit_arrow, priors=table, kind="inverse", noise=ims.Noise(depth_rel=0.04))
logging.disable(logging.WARNING)  # Ray tells how far it is
with ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False):
    found = ray.data.read_parquet(folder.name).map_batches(job, batch_format="pyarrow")
    found.write_parquet(f"{folder.name}/sized")
logging.disable(logging.NOTSET)

# %%
# What Ray wrote: your columns, those of the picture and, in lists again, those of its objects.

sized = pq.read_table(f"{folder.name}/sized")
print(*(f"{field.name}: {field.type}" for field in sized.schema), sep="\n")
true, low, high = (np.array(sized[c].to_pylist())[:, 4] for c in ("true_m", "low_m", "high_m"))
print(f"{((low < true) & (true < high)).mean():.0%} of the statues are in their intervals")
fig, ax = plt.subplots(figsize=(7, 4), layout="constrained")
some = np.argsort(true)[20::33]
ax.vlines(range(60), low[some], high[some], linewidth=4, alpha=0.4, label="90 % interval")
ax.plot(true[some], "k_", label="drawn")
ax.legend(title="height of 60 statues, m", loc="upper left")
folder.cleanup()
