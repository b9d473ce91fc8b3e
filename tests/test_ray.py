"""A real Ray on this machine maps `fit_arrow` over Parquet files, and leaves nothing behind."""

import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import imgscale as ims
from imgscale.batch import fit_arrow

pytest.importorskip("ray", reason="ray is not installed")
pytest.importorskip("ray.data", reason="ray.data is not complete", exc_type=ImportError)
pa = pytest.importorskip("pyarrow", reason="pyarrow is not installed")

# Ray's defaults are, in part, what Ray deprecates.
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings(r"ignore::DeprecationWarning:ray\.data\.context"),
]

BENCHMARK = Path(__file__).parents[1] / "benchmarks" / "ray_run.py"
JOB = partial(
    fit_arrow,
    priors=ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.03), ims.ObjectPrior("car", 1.5, 0.1)]),
    kind="metric",
    noise=ims.Noise(depth_rel=0.03),
)


def processes_of_ray():
    """Numbers of the processes of a Ray that are there."""
    names = ("raylet", "gcs_server", "ray::")
    found = set()
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            command = (folder / "cmdline").read_bytes().decode(errors="replace")
        except OSError:  # gone meanwhile
            continue
        if any(name in command.split("\0")[0] for name in names):
            found.add(int(folder.name))
    return found


@pytest.fixture(scope="module")
def engine():
    """Ray with two processes, for as long as the tests of this file run."""
    import ray  # noqa: PLC0415 - may be missing

    before = processes_of_ray()
    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory(prefix="ray") as folder:
        patch.setenv("RAY_AUTH_MODE", "disabled")
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        ray.init(
            address="local",
            num_cpus=2,
            include_dashboard=False,
            object_store_memory=128 * 2**20,
            log_to_driver=False,
            _node_ip_address="127.0.0.1",
            _temp_dir=folder,  # short: the names of sockets have 107 characters at most
        )
        try:
            yield ray
        finally:
            ray.shutdown()
    assert processes_of_ray() <= before


def some_images(n_images, seed=0):
    rng = np.random.default_rng(seed)
    rows = []
    for image in range(n_images):
        count = int(rng.integers(0, 7))
        label = rng.choice(["door", "car", "statue"], count)
        true_m = np.select([label == "door", label == "car"], [2.0, 1.5], 2.6)
        depth = rng.uniform(4, 40, count)
        pixels = 700 * true_m / depth * np.exp(rng.normal(0, 0.04, count))
        lists = {"label": label.tolist(), "pixels": pixels.tolist(), "depth": depth.tolist()}
        if image % 11 == 5:
            lists = dict.fromkeys(lists)
        rows.append({"file": f"{image:05d}.jpg", **lists})
    return pa.Table.from_pylist(rows)


def without_nan(value):
    if isinstance(value, list):
        return [without_nan(one) for one in value]
    return None if value != value else value  # noqa: PLR0124 - NaN


def rows_of(table):
    by_file = sorted(table.to_pylist(), key=lambda row: row["file"])
    return [{name: without_nan(value) for name, value in row.items()} for row in by_file]


@pytest.fixture(scope="module")
def files(engine, tmp_path_factory):
    """What went in, as one table, and the folder of what came out."""
    import pyarrow.parquet as pq  # noqa: PLC0415 - may be missing

    folder = tmp_path_factory.mktemp("parquet")
    table = some_images(600)
    (folder / "in").mkdir()
    for part in range(3):
        path = folder / "in" / f"part{part}.parquet"
        pq.write_table(table.slice(200 * part, 200), path, row_group_size=70)
    images = engine.data.read_parquet(str(folder / "in"))
    images.map_batches(JOB, batch_format="pyarrow").write_parquet(str(folder / "out"))
    return table, folder / "out"


def test_parquet_to_parquet_gives_what_one_call_gives(files):
    import pyarrow.parquet as pq  # noqa: PLC0415 - may be missing

    table, out = files
    found, wanted = pq.read_table(out), JOB(table)
    assert found.column_names == wanted.column_names
    for got, row in zip(rows_of(found), rows_of(wanted), strict=True):
        assert got.keys() == row.keys()
        assert got["file"] == row["file"]
        assert got["reason"] == row["reason"]
        for name in ("label", "pixels", "depth"):
            assert got[name] == row[name]
        for name in ("k", "k_std", "flags", "n_used", "size_m", "low_m", "high_m", "weight"):
            numbers = (np.array(values[name], dtype=np.float64) for values in (got, row))
            np.testing.assert_allclose(*numbers, rtol=1e-12)


def test_parquet_to_parquet_keeps_the_types(files):
    import pyarrow.parquet as pq  # noqa: PLC0415 - may be missing

    table, out = files
    found, wanted = pq.read_table(out).schema, JOB(table).schema
    assert [field.type for field in found] == [field.type for field in wanted]


def test_an_image_alone_in_its_batch_is_fitted_like_any_other(engine, files):
    table, _ = files
    few = engine.data.from_arrow(table.slice(0, 12))
    mapped = few.map_batches(JOB, batch_format="pyarrow", batch_size=1).take_all()
    for got, wanted in zip(mapped, JOB(table.slice(0, 12)).to_pylist(), strict=True):
        assert got["n_used"] == wanted["n_used"]
        assert got["k"] == pytest.approx(wanted["k"], rel=1e-12, nan_ok=True)


def test_what_is_refused_is_named_through_ray(engine):
    bad = pa.table({"label": [["door"]], "pixels": [[-3.0]], "depth": [[4.0]]})
    with pytest.raises(Exception, match=r"finite and positive; got -3\.0.*row 0, entry 0"):
        engine.data.from_arrow(bad).map_batches(JOB, batch_format="pyarrow").take_all()


def test_the_benchmark_runs_in_small():
    for name in ("narwhals", "pandas", "polars"):
        pytest.importorskip(name, reason=f"{name} is not installed")
    done = subprocess.run(
        [sys.executable, str(BENCHMARK), "--images", "300", "--rounds", "1"],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    title, _, *rows = done.stdout.splitlines()
    assert title.startswith("300 images, ")
    assert [row[:32].strip() for row in rows] == [
        "fit_columns",
        "fit_table, pandas",
        "fit_table, polars",
        "fit_table, pyarrow",
        "fit_arrow",
        "Parquet to Parquet, no work",
        "Parquet to Parquet, fit_arrow",
        "Parquet to Parquet, Ray",
    ]
