"""
Time a million images through frames, Arrow tables and Ray, Parquet to Parquet, beside plain runs.

Needs the extras `frames` and `ray`, pandas and polars; without them it says so and ends. All run in
turn in one session, Ray on as many processes as `--cpus` says; its start is told apart. Medians of
`--rounds` rounds, in seconds and in nanoseconds an object.
"""

import argparse
import logging
import os
import statistics
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

import imgscale as ims
from imgscale.batch import fit_arrow, fit_columns, fit_table

NEEDS = ("pandas", "polars", "pyarrow", "narwhals", "ray")
LABELS = {"person": 1.675, "car": 1.6, "bus": 3.1, "traffic light": 0.9, "statue": 2.5}
OPTIONS: dict[str, Any] = {"kind": "metric", "noise": ims.Noise(depth_rel=0.05)}
FILES = 20


def columns(n_images: int) -> dict[str, np.ndarray]:
    """Draw two to eight objects an image: ids, codes of labels, extents and depths."""
    rng = np.random.default_rng(0)
    counts = rng.integers(2, 9, n_images)
    code = rng.integers(0, len(LABELS), counts.sum()).astype(np.int16)
    depth = rng.uniform(5, 50, code.size)
    size_m = np.array(list(LABELS.values()))[code] * rng.lognormal(0, 0.08, code.size)
    pixels = 1200 * size_m / depth
    pixels[rng.random(code.size) < 0.1] *= 0.5  # hidden in part
    return {
        "image_id": np.repeat(np.arange(n_images), counts),
        "label": code,
        "pixels": pixels,
        "depth": depth,
    }


def in_rows(data: dict[str, np.ndarray]) -> Any:
    """Make an Arrow table with an object per row, labels as strings."""
    import pyarrow as pa  # noqa: PLC0415 - may be missing

    names = pa.array(list(LABELS)).take(pa.array(data["label"]))
    return pa.table({**data, "label": names})


def in_lists(data: dict[str, np.ndarray]) -> Any:
    """Make an Arrow table with an image per row."""
    import pyarrow as pa  # noqa: PLC0415 - may be missing

    rows = in_rows(data)
    ids, starts = np.unique(data["image_id"], return_index=True)
    offsets = pa.array(np.append(starts, len(rows)), pa.int32())
    lists = {
        name: pa.ListArray.from_arrays(offsets, rows[name].combine_chunks())
        for name in ("label", "pixels", "depth")
    }
    return pa.table({"image_id": ids, **lists})


def file_by_file(job: Callable[[Any], Any], source: Path, target: Path) -> None:
    """Map a function over Parquet files in this process."""
    import pyarrow.parquet as pq  # noqa: PLC0415 - may be missing

    target.mkdir(exist_ok=True)
    for path in sorted(source.iterdir()):
        pq.write_table(job(pq.read_table(path)), target / path.name)


def by_ray(job: Callable[[Any], Any], source: Path, target: Path) -> None:
    """Map a function over Parquet files by Ray."""
    import ray  # noqa: PLC0415 - may be missing

    found = ray.data.read_parquet(str(source))
    found.map_batches(job, batch_format="pyarrow").write_parquet(str(target), mode="overwrite")


@contextmanager
def engine(cpus: int, folder: str) -> Iterator[float]:
    """Start Ray, tell how long that took, and stop it."""
    import ray  # noqa: PLC0415 - may be missing

    os.environ.setdefault("RAY_AUTH_MODE", "disabled")
    logging.disable(logging.WARNING)  # it tells how far it is
    warnings.simplefilter("ignore", DeprecationWarning)  # of its own defaults
    start = time.perf_counter()
    ray.init(
        address="local",
        num_cpus=cpus,
        include_dashboard=False,
        object_store_memory=2**30,
        log_to_driver=False,
        _temp_dir=folder,
    )
    try:
        yield time.perf_counter() - start
    finally:
        ray.shutdown()
        logging.disable(logging.NOTSET)


def calls(data: dict[str, np.ndarray], folder: Path) -> dict[str, Callable[[], object]]:
    """All that is timed, by what it is called in the table."""
    import polars as pl  # noqa: PLC0415 - may be missing
    import pyarrow.parquet as pq  # noqa: PLC0415 - may be missing

    rows, lists = in_rows(data), in_lists(data)
    pandas_rows, polars_rows = rows.to_pandas(), pl.from_arrow(rows)
    source = folder / "found"
    source.mkdir()
    each = -(-len(lists) // FILES)
    for part in range(FILES):
        pq.write_table(lists.slice(part * each, each), source / f"{part:02d}.parquet")
    job = partial(fit_arrow, **OPTIONS)
    ids, code, pixels, depth = data.values()
    return {
        "fit_columns": lambda: fit_columns(
            ids, code, pixels, depth, labels=list(LABELS), **OPTIONS
        ),
        "fit_table, pandas": lambda: fit_table(pandas_rows, **OPTIONS),
        "fit_table, polars": lambda: fit_table(polars_rows, **OPTIONS),
        "fit_table, pyarrow": lambda: fit_table(rows, **OPTIONS),
        "fit_arrow": lambda: job(lists),
        "Parquet to Parquet, no work": lambda: file_by_file(lambda t: t, source, folder / "copy"),
        "Parquet to Parquet, fit_arrow": lambda: file_by_file(job, source, folder / "plain"),
        "Parquet to Parquet, Ray": lambda: by_ray(job, source, folder / "ray"),
    }


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("--images", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--cpus", type=int, default=2)
    asked = parser.parse_args()
    missing = [name for name in NEEDS if not find_spec(name)]
    if missing:
        print(
            f"not run, for lack of {', '.join(missing)}: pip install 'imgscale[frames,ray]' polars"
        )
        return 0
    data = columns(asked.images)
    times: dict[str, list[float]] = {}
    with (
        tempfile.TemporaryDirectory(prefix="ray") as folder,
        engine(asked.cpus, f"{folder}/r") as started,
    ):
        timed = calls(data, Path(folder))
        for _ in range(asked.rounds):
            for name, call in timed.items():
                start = time.perf_counter()
                call()
                times.setdefault(name, []).append(time.perf_counter() - start)
    count = data["label"].size
    print(f"{asked.images} images, {count} objects; {started:.1f} s to start Ray on {asked.cpus}")
    print(f"{'':32}{'median':>10}{'best':>10}")
    for name, values in times.items():
        median = statistics.median(values)
        print(f"{name:32}{median:8.2f} s{min(values):8.2f} s{1e9 * median / count:8.0f} ns/object")
    return 0


if __name__ == "__main__":
    sys.exit(main())
