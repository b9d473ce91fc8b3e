"""Rows of the table: many images at once, from columns to columns."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from speed_columns import LABELS, NOISE, Columns, Sizes, draw, shuffled
from speed_columns import sizes as prior_sizes
from speed_memory import peak_memory
from speed_peers import (
    has,
    one_by_one,
    pandas_apply,
    pandas_least_squares,
    pandas_mean_ratio,
    pandas_sizes,
    polars_least_squares,
)
from speed_rounds import Row, Run, Timing, timed

import imgscale as ims
from imgscale._typing import FitMethod
from imgscale.batch import fit_columns

SIZES, LARGEST = (10_000, 100_000, 1_000_000), 10_000_000
PER_IMAGE = (2, 5, 10, 30, 100)
# What takes long is timed on so many images, and told by the reference all the same.
_SOME = {"posterior": 2_000, "noise untold": 2_000, "one by one": 60, "pandas apply": 200}
_LEAST_SPEED = {10_000: 3.0, 1_000_000: 10.0, 10_000_000: 8.0}
_MOST_MEMORY = 0.6
_POSTERIOR_SPEED, _UNSORTED_SPEED = 0.8, 4.0
_CLOSED_RATIO, _NUMBA_RATIO = 2.0, 1 / 1.5
# Of the largest only these; the columns and what is made of them need so much memory.
_LARGEST_NAMES = ("robust", "least squares", "pandas least squares", "numba")
_LARGEST_NEEDS = 14e9
_REFERENCES = 1_000_000


class Peer(NamedTuple):
    """
    What stands beside a call of ours.

    Attributes
    ----------
    name : str
        Its name among the calls.
    title : str
        What the table calls it.
    least_ratio : float or None
        The goal, times as fast.
    """

    name: str
    title: str
    least_ratio: float | None = None


PANDAS = Peer("pandas least squares", "pandas groupby.agg, least squares")
POLARS = Peer("polars", "polars group_by, least squares")
NUMBA = Peer("numba", "numba, the same loop", _NUMBA_RATIO)
BESIDE: Mapping[str, tuple[Peer, ...]] = {
    "robust": (
        NUMBA,
        PANDAS,
        Peer("pandas sizes", "the same, sizes by map"),
        POLARS,
        Peer("pandas apply", "pandas.apply, least_squares(huber)"),
        Peer("one by one", "a loop of fit and predict"),
    ),
    "least squares": (PANDAS._replace(least_ratio=_CLOSED_RATIO), POLARS),
    "mean ratio": (Peer("pandas mean ratio", "pandas groupby.agg, mean ratio", _CLOSED_RATIO),),
    "robust, ids unsorted": (Peer("pandas unsorted", "pandas groupby.agg, ids unsorted"),),
    "posterior": (Peer("robust", "our robust"),),
    "noise untold": (Peer("robust", "our robust, noise told"),),
}
_TITLES = {
    "noise untold": "robust, noise untold",
}
NAMES = tuple(dict.fromkeys([*BESIDE, *(peer.name for peers in BESIDE.values() for peer in peers)]))


def rows(rounds: int, *, quick: bool) -> list[Row]:
    """Time batches by number of images; all but the largest."""
    return [row for n_images in SIZES[: 1 if quick else None] for row in of_size(n_images, rounds)]


def largest_rows(rounds: int, *, quick: bool) -> list[Row]:
    """Time the largest batch, where there is the memory for it."""
    if quick or _available() < _LARGEST_NEEDS:
        return []
    return of_size(LARGEST, rounds)


def density_rows(rounds: int, *, quick: bool) -> list[Row]:
    """Time batches of as many references, by how many are in an image."""
    if not has("numba"):
        return []
    references = _REFERENCES // (50 if quick else 1)
    return [of_density(per_image, references, rounds) for per_image in PER_IMAGE]


def of_size(n_images: int, rounds: int) -> list[Row]:
    """Compare everything on so many images."""
    names = _names(n_images)
    weighed = [name for name in names if name in _SOME or n_images >= max(SIZES)]
    peaks = peak_memory(calls, weighed, n_images)
    made = calls(n_images, names)
    columns = draw(n_images)
    counts = {name: _references(columns, n_images, name) for name in names}
    nbytes = columns.nbytes
    del columns
    took = timed(made, rounds, references=counts, peaks=peaks)
    size = f"{n_images:.0e} images".replace("e+0", "e")
    return [
        _row(what, size, took, peer, n_images, nbytes, first=place == 0)
        for what, peers in BESIDE.items()
        for place, peer in enumerate(peer for peer in peers if peer.name in names)
        if what in names
    ]


def of_density(per_image: int, references: int, rounds: int) -> Row:
    """Compare the robust batch with the compiled loop, all images alike."""
    n_images = references // per_image
    made = calls(n_images, ("robust", "numba"), per_image)
    took = timed(made, rounds, references=dict.fromkeys(made, n_images * per_image))
    size = f"{n_images:,} images of {per_image}"
    return Row("robust", size, took["robust"], NUMBA.title, took["numba"], NUMBA.least_ratio)


def calls(n_images: int, names: Sequence[str], per_image: int | None = None) -> dict[str, Run]:
    """
    Make calls on drawn images.

    Parameters
    ----------
    n_images : int
        How many images.
    names : sequence of str
        Which calls, out of `NAMES`.
    per_image : int, optional
        References in each image.

    Returns
    -------
    dict
        The calls by name; all of one size share their columns.
    """
    drawn: dict[str, Columns] = {}

    def columns_for(name: str) -> Columns:
        if "unsorted" in name:
            return drawn.setdefault("unsorted", shuffled(columns_for("")))
        few = _SOME.get(name, n_images)
        if few < n_images:
            return drawn.setdefault(name, draw(few, per_image))
        return drawn.setdefault("", draw(n_images, per_image))

    priors, prior = ims.PriorTable.default(), prior_sizes()
    return {name: partial(_MAKERS[name], columns_for(name), priors, prior) for name in names}


def _ours(
    columns: Columns,
    priors: ims.PriorTable,
    _: Sizes,
    *,
    method: FitMethod = "robust",
    noise: ims.Noise = NOISE,
) -> object:
    return fit_columns(
        *columns,
        priors,
        kind="metric",
        labels=LABELS,
        noise=noise,
        method=method,
    )


def _compiled(columns: Columns, _: ims.PriorTable, prior: Sizes) -> object:
    import speed_numba  # noqa: PLC0415 - a peer that may be missing

    return speed_numba.robust(columns, prior, NOISE)


def _peer(call: Callable[[Columns, Sizes], object]) -> Callable[..., object]:
    return lambda columns, _, prior: call(columns, prior)


_MAKERS: Mapping[str, Callable[..., object]] = {
    "robust": _ours,
    "least squares": partial(_ours, method="least_squares"),
    "mean ratio": partial(_ours, method="mean_ratio"),
    "robust, ids unsorted": _ours,
    "posterior": partial(_ours, method="posterior"),
    "noise untold": partial(_ours, noise=ims.Noise(box_px=NOISE.box_px)),
    "numba": _compiled,
    "pandas least squares": _peer(pandas_least_squares),
    "pandas mean ratio": _peer(pandas_mean_ratio),
    "pandas sizes": _peer(pandas_sizes),
    "pandas unsorted": _peer(pandas_least_squares),
    "polars": _peer(polars_least_squares),
    "pandas apply": _peer(pandas_apply),
    "one by one": lambda columns, priors, _: one_by_one(columns, priors),
}


def _names(n_images: int) -> tuple[str, ...]:
    """Choose what is timed on so many images, with the packages that are there."""
    names = _LARGEST_NAMES if n_images >= LARGEST else NAMES
    if n_images > min(SIZES):  # told by the reference, and no faster on more
        names = tuple(name for name in names if name not in _SOME)
    packages = ("pandas", "polars", "numba")
    absent = tuple(package for package in packages if not has(package))
    return tuple(name for name in names if not name.startswith(absent or ("?",)))


def _references(columns: Columns, n_images: int, name: str) -> int:
    few = _SOME.get(name, n_images)
    return draw(few).image_id.size if few < n_images else columns.image_id.size


def _row(
    what: str,
    size: str,
    took: Mapping[str, Timing],
    peer: Peer,
    n_images: int,
    nbytes: int,
    *,
    first: bool,
) -> Row:
    least_speed = {
        "robust": _LEAST_SPEED.get(n_images),
        "posterior": _POSTERIOR_SPEED,
        "robust, ids unsorted": _UNSORTED_SPEED,
    }.get(what)
    return Row(
        _TITLES.get(what, what),
        size,
        took[what],
        peer.title,
        took[peer.name],
        least_ratio=peer.least_ratio,
        least_speed=least_speed if first else None,
        most_memory=_MOST_MEMORY * nbytes if what == "robust" and first else None,
    )


def _available() -> float:
    """Memory that is free, in bytes; 0 where the system does not tell."""
    path = Path("/proc/meminfo")
    if not path.is_file():
        return 0.0
    lines = dict(line.split(":") for line in path.read_text(encoding="ascii").splitlines())
    return 1024 * float(lines["MemAvailable"].split()[0])
