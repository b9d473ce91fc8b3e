"""
Ask whether intervals hold what they promise where the truth is drawn from the model's own priors.

Ranks (Talts et al. 2018): k, the shift, sizes, errors of labels' means, noise and wrong references
are drawn as the library supposes them. The place of the truth in the distribution that `fit` and
`predict` give, 0 to 1, must then be uniform; Neyman's smooth test looks for what is not. Coverage:
how often 90 % intervals hold the truth, by number of references, and where the world is worse than
supposed. ``--into docs/calibration.md`` puts the tables there; all takes about six minutes.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import imgscale as ims
from imgscale import standing
from imgscale.batch import BatchResult, fit_columns
from imgscale.core import evidence
from imgscale.core.mixture import SCORES

Floats = NDArray[np.float64]
# A calibrated distribution fails the test once in a thousand times.
FALSE_ALARM = 1e-3
# Means, spreads and errors of means in metres. No shipped table has these labels.
KNOWN = {"post": (1.2, 0.08, 0.04), "rail": (0.9, 0.05, 0.03), "gate": (2.1, 0.15, 0.08)}
LABELS = (*KNOWN, "thing")
TABLE = ims.PriorTable(
    [ims.ObjectPrior(label, mean, std, mean_std_m=off) for label, (mean, std, off) in KNOWN.items()]
)
BOX_PX, DEPTH_REL, FOCAL_PX, FOCAL_REL = 1.0, 0.05, 1200.0, 0.03
DECLARED = evidence.GROSS + evidence.SMALLER
IMAGE_SIZE = (1280, 960)
# Unknown objects in each image; the ranks are those of the first.
THINGS = 3
_NORMAL = NormalDist()
_Z90 = _NORMAL.inv_cdf(0.95)
# So much shows so many pixels where it is farthest: the error of a box, which is told relative to
# what was seen of it, is small.
_LEAST_M, _LEAST_PX = 0.5, 80.0
_PROBE_PX = 1e6
# Ends of the intervals that are asked of `fit_columns`: more in the tails, where widths show.
_EDGES = (0.03, 0.1, 0.25, 0.5)
_BINS = np.array([0.0, *_EDGES, *(1 - edge for edge in _EDGES[-2::-1]), 1.0])


class World(NamedTuple):
    """How images are drawn; the defaults are what the library supposes."""

    kind: str
    counts: tuple[int, ...] = (2, 3, 4, 5, 6, 8)
    wrong: float = DECLARED
    """Share of references that are wrong."""
    spread: float = 1.0
    """Spread of individuals over that declared."""
    told: bool = True
    """Whether the library is told how much the depths err."""
    camera: bool = False
    """Whether it is told the focal length."""


class Drawn(NamedTuple):
    """Images as columns, in each the references first; and what is true."""

    image: NDArray[np.intp]
    code: NDArray[np.intp]
    pixels: Floats
    depth: Floats
    size: Floats
    k: Floats
    """One of each image."""

    def first_things(self) -> NDArray[np.intp]:
        """Find the rows of each image's first unknown object."""
        return np.flatnonzero(self.code == len(KNOWN))[::THINGS]


class Ranks(NamedTuple):
    """What was found of one world."""

    size: Floats
    """Places of the truth in the distributions of unknown objects, 0 to 1, one of each image."""
    k: Floats
    """The same of k; NaN where its distribution was not looked at."""


class Coverage(NamedTuple):
    """How often 90 % intervals hold the truth."""

    k: float
    size: float


# --- worlds ----------------------------------------------------------------------------------


def log_prior(label: str) -> tuple[float, float, float]:
    """Mean and standard deviation of the log size, and that of the label's offset."""
    mean, std, mean_std = KNOWN[label]
    variance = math.log1p((std / mean) ** 2)
    return math.log(mean) - variance / 2, math.sqrt(variance), mean_std / mean


def draw(rng: np.random.Generator, world: World, n_images: int) -> Drawn:
    """
    Draw images with depths.

    The depths are given and the pixels drawn, as the likelihood has it: the depths' noise is in
    them. Any k will do, as the posterior moves with it, unless a camera tells of it.
    """
    counts = rng.choice(world.counts, n_images)
    image = np.repeat(np.arange(n_images), counts + THINGS)
    first = np.concatenate([[0], np.cumsum(counts + THINGS)[:-1]])
    is_thing = np.arange(image.size) - first[image] >= counts[image]
    code = np.where(is_thing, len(KNOWN), rng.integers(len(KNOWN), size=image.size))
    size = _sizes(rng, world, code, image, n_images)
    depth, apparent = _depths(rng, world, image, is_thing)
    if world.camera:
        k = np.exp(FOCAL_REL * rng.normal(size=n_images)) / FOCAL_PX
    else:
        k = np.minimum.reduceat(apparent, first) * _LEAST_M / _LEAST_PX
    noise = _depth_noise(rng, world, n_images)[image]
    exact = size * apparent / k[image]
    error = np.hypot(noise, BOX_PX / exact) * rng.normal(size=image.size)
    error -= np.where(is_thing, 0.0, _excess(rng, world.wrong, image.size))
    return Drawn(image, code, exact * np.exp(error), depth, size, k)


def _sizes(
    rng: np.random.Generator,
    world: World,
    code: NDArray[np.intp],
    image: NDArray[np.intp],
    n_images: int,
) -> Floats:
    """Draw sizes: of known things about means that are off together, of others anything."""
    mean, std, tau = np.array([*map(log_prior, KNOWN), (0.25, 0.5 / world.spread, 0.0)]).T
    offset = tau * rng.normal(size=(n_images, len(LABELS)))
    own = world.spread * std[code] * rng.normal(size=code.size)
    sizes: Floats = np.exp(mean[code] + offset[image, code] + own)
    return sizes


def _depths(
    rng: np.random.Generator, world: World, image: NDArray[np.intp], is_thing: NDArray[np.bool_]
) -> tuple[Floats, Floats]:
    """Draw depths, things within the range of the references; and D + b, 1 / distance."""
    place = rng.uniform(math.log(0.04), math.log(0.25), image.size)
    low, high = np.full((2, image[-1] + 1), [[np.inf], [-np.inf]])
    np.minimum.at(low, image[~is_thing], place[~is_thing])
    np.maximum.at(high, image[~is_thing], place[~is_thing])
    inverse = np.exp(np.where(is_thing, np.clip(place, low[image], high[image]), place))
    if world.kind != "affine_inverse":
        return (inverse if world.kind == "inverse" else 1 / inverse), inverse
    inverse += 0.1 * rng.normal(size=image[-1] + 1)[image]
    shift = [_shift(rng, inverse[(image == number) & ~is_thing]) for number in range(image[-1] + 1)]
    return inverse, inverse + np.array(shift)[image]


def _shift(rng: np.random.Generator, values: Floats) -> float:
    """Draw a shift from the library's prior, which is as wide as the depths are large."""
    width = max(abs(float(np.median(values))), float(values.std()))
    while True:
        shift = width * rng.normal()
        if 1e-3 < (values.min() + shift) / np.ptp(values) < 1e2:
            return shift


def _depth_noise(rng: np.random.Generator, world: World, n_images: int) -> Floats:
    """Draw how much depths err: as told, or as the library supposes where it is not."""
    scores = rng.normal(size=n_images)
    while (beyond := (scores < -2) | (scores > 3)).any():
        scores = np.where(beyond, rng.normal(size=n_images), scores)
    return DEPTH_REL * (np.ones(n_images) if world.told else 2.2**scores)


def _excess(rng: np.random.Generator, share: float, count: int) -> Floats:
    """Draw by how much references show less than they should: log, 0 for sound ones."""
    gross = share * evidence.GROSS / DECLARED
    which = rng.choice(3, count, p=[1 - share, gross, share - gross])
    either_way = evidence.GROSS_STD / math.sqrt(2) * rng.laplace(size=count)
    smaller = evidence.SMALLER_BY + evidence.SMALLER_STD * rng.normal(size=count)
    return np.choose(which, [np.zeros(count), either_way, smaller])


class OnGround(NamedTuple):
    """A picture of a ground plane; what is true of the unknown objects and of the camera."""

    detections: list[ims.Detection]
    size: Floats
    camera_height_m: float


GROUND = ims.GroundPlane(image_size=IMAGE_SIZE)


def draw_on_ground(rng: np.random.Generator, world: World) -> OnGround:
    """
    Draw a picture of a ground plane.

    What does not fit into the picture is drawn anew as a whole: what is left out then depends on
    what is seen alone, and the posterior of what is seen stays right.
    """
    width, height = IMAGE_SIZE
    while True:
        labels = [*rng.choice(list(KNOWN), rng.choice(world.counts)), *["thing"] * THINGS]
        code = np.array([LABELS.index(label) for label in labels])
        size = _sizes(rng, world, code, np.zeros_like(code), 1)
        horizon = height / 2 + standing.HORIZON_STD * width * rng.standard_t(3)
        camera_m = standing.CAMERA_HEIGHT_M * standing.CAMERA_HEIGHT_FACTOR ** rng.normal()
        x, foot = rng.uniform(30, width - 30, code.size), rng.uniform(0.3, 0.98, code.size) * height
        # a thing as near as a reference: that unknown things do not hang above the horizon is
        # nothing that the library takes for granted
        foot[-THINGS:] = np.maximum(foot[-THINGS:], foot[:-THINGS].min())
        below = foot - horizon - standing.SLOPE_STD * rng.normal() * (x - width / 2)
        relief = np.exp(standing.RELIEF_REL * rng.normal(size=code.size))
        pixels = size * below / (camera_m * relief)
        row = foot + standing.SLOPE_REL * width * rng.normal(size=code.size)
        shown = np.where(code < len(KNOWN), np.exp(-_excess(rng, world.wrong, code.size)), 1.0)
        edges = np.array([row - pixels * shown, row])
        top, low = edges + BOX_PX / math.sqrt(2) * rng.normal(size=(2, code.size))
        if below.min() > 3 and top.min() > 2 and low.max() < height - 2 and (low - top).min() > 8:
            boxes = np.stack([x - 5, top, x + 5, low], axis=1)
            pairs = zip(labels, boxes, strict=True)
            seen = [ims.Detection(label, box) for label, box in pairs]
            return OnGround(seen, size[-THINGS:], camera_m)


# --- ranks -----------------------------------------------------------------------------------


def rank(estimate: ims.SizeEstimate, truth: float) -> float:
    """Find the place of the truth in the distribution of a size, 0 to 1."""
    if estimate.quantiles_m is None:
        return _NORMAL.cdf(math.log(truth / estimate.size_m) * estimate.size_m / estimate.std_m)
    if math.isnan(estimate.size_m):
        return math.nan
    with np.errstate(divide="ignore"):
        logs = np.nan_to_num(np.log(estimate.quantiles_m), posinf=700.0, neginf=-700.0)
    score = np.interp(math.log(truth), logs, SCORES)
    return _NORMAL.cdf(float(score))


def uniformity(ranks: Floats) -> float:
    """Test that ranks are uniform, by Neyman's smooth test of order 4; the p-value."""
    x = 2 * ranks - 1
    legendre = [x, (3 * x**2 - 1) / 2, (5 * x**3 - 3 * x) / 2, (35 * x**4 - 30 * x**2 + 3) / 8]
    half = sum((2 * j + 3) * part.sum() ** 2 for j, part in enumerate(legendre)) / (2 * x.size)
    return float(math.exp(-half) * (1 + half))  # chi-square of 4 degrees of freedom


def _noise(world: World) -> ims.Noise:
    return ims.Noise(box_px=BOX_PX, depth_rel=DEPTH_REL if world.told else None)


def ranks_in_columns(world: World, method: str, n_images: int, seed: int = 0) -> Ranks:
    """Rank the sizes that `fit_columns` gives by its intervals of four levels: in eight bins."""
    rng = np.random.default_rng([seed, n_images])
    drawn = draw(rng, world, n_images)
    rows = drawn.first_things()
    truth, place = drawn.size[rows], np.zeros(rows.size, dtype=int)
    for edge in _EDGES:
        found = _fitted_columns(drawn, world, method, max(1 - 2 * edge, 1e-9))
        place += truth > found.rows.low_m[rows]
        place += (edge < 0.5) & (truth > found.rows.high_m[rows])
    return Ranks(_in_bins(rng, place), np.full(n_images, np.nan))


def _in_bins(rng: np.random.Generator, place: NDArray[np.intp]) -> Floats:
    """Put ranks of which only the bin is known anywhere in it: uniform ones stay so."""
    ranks: Floats = _BINS[place] + np.diff(_BINS)[place] * rng.uniform(size=place.size)
    return ranks


def _fitted_columns(drawn: Drawn, world: World, method: str, level: float) -> BatchResult:
    return fit_columns(
        drawn.image,
        drawn.code,
        drawn.pixels,
        drawn.depth,
        TABLE,
        kind=world.kind,
        labels=LABELS,
        noise=_noise(world),
        method=method,
        level=level,
    )


def ranks_in_pictures(
    world: World,
    method: str,
    n_images: int,
    seed: int = 0,
    *,
    change: Callable[[ims.SizeEstimate], ims.SizeEstimate] = lambda estimate: estimate,
) -> Ranks:
    """Rank the sizes that `fit` and `predict` give, and k; `change` alters what they say."""
    rng = np.random.default_rng([seed, n_images])
    return Ranks(*np.array(list(_ranked(rng, world, method, n_images, change))).T)


def _ranked(
    rng: np.random.Generator,
    world: World,
    method: str,
    n_images: int,
    change: Callable[[ims.SizeEstimate], ims.SizeEstimate],
) -> Iterator[list[float]]:
    for estimates, sizes in _pictures(rng, world, method, n_images):
        pairs = zip(map(change, estimates), sizes, strict=True)
        yield [rank(estimate, size) for estimate, size in pairs]


def _pictures(
    rng: np.random.Generator, world: World, method: str, n_images: int
) -> Iterator[tuple[list[ims.SizeEstimate], list[float]]]:
    """Estimate the first unknown object of each picture, and k; and tell what is true."""
    if world.kind == "ground_plane":
        for _ in range(n_images):
            drawn = draw_on_ground(rng, world)
            model = ims.fit(drawn.detections, GROUND, TABLE, method=method, noise=_noise(world))
            thing = ims.predict(model, drawn.detections[-THINGS:])[0]
            yield [thing, _height_of(model)], [drawn.size[0], drawn.camera_height_m]
        return
    drawn = draw(rng, world, n_images)
    camera = ims.Camera(FOCAL_PX, focal_rel_std=FOCAL_REL) if world.camera else None
    probe, at = _probe(world.kind)
    for number in range(n_images):
        rows = np.flatnonzero(drawn.image == number)
        heights = zip(drawn.code[rows], drawn.pixels[rows], strict=True)
        seen = [ims.Detection(LABELS[code], (0, 0, 10, height)) for code, height in heights]
        depths = ims.ObjectDepths(drawn.depth[rows], kind=world.kind, rel_std=DEPTH_REL)
        # the depths' error is told beside them, so that a depth without one shows k itself
        noise = ims.Noise(box_px=BOX_PX, depth_rel=0.0)
        model = ims.fit(seen, depths, TABLE, camera=camera, method=method, noise=noise)
        thing = ims.predict(model, seen, depths)[-THINGS]
        yield (
            [thing, *ims.predict(model, *probe)],
            [drawn.size[rows[-THINGS]], drawn.k[number] * at],
        )


def _height_of(model: ims.ScaleModel) -> ims.SizeEstimate:
    """Say how high the camera is, as one reads it off the model: k +- its standard error."""
    return ims.SizeEstimate(
        label="camera",
        axis="height",
        size_m=model.k,
        std_m=model.k_std,
        metres_per_pixel=math.nan,
        depth=math.nan,
        distance_m=None,
        flags=model.flags,
    )


def _probe(kind: str) -> tuple[tuple[list[ims.Detection], ims.ObjectDepths], float]:
    """Make an object without errors, so near that no shift counts; and its size over k."""
    near = 1e-6 if kind in {"metric", "relative"} else 1e6
    seen = [ims.Detection("probe", (0, 0, 10, _PROBE_PX))]
    return (seen, ims.ObjectDepths([near], kind=kind)), _PROBE_PX * 1e-6


# --- coverage --------------------------------------------------------------------------------


def coverage(world: World, method: str, n_images: int, seed: int = 0) -> Coverage:
    """Count how often 90 % intervals hold the truth: of k, and of the objects that got one."""
    rng = np.random.default_rng([seed, n_images])
    if world.kind == "ground_plane" or world.camera:
        ranks = np.array(list(_ranked(rng, world, method, n_images, lambda same: same)))
        held = (abs(column[~np.isnan(column)] - 0.5) <= 0.45 for column in ranks.T[::-1])
        return Coverage(*(float(np.mean(column)) for column in held))
    drawn = draw(rng, world, n_images)
    found = _fitted_columns(drawn, world, method, 0.9)
    log_error = np.log(found.images.k / drawn.k)
    things = (drawn.code == len(KNOWN)) & ~np.isnan(found.rows.low_m)
    low, high, truth = (
        column[things] for column in (found.rows.low_m, found.rows.high_m, drawn.size)
    )
    return Coverage(
        k=float(np.mean(abs(log_error) <= _Z90 * found.images.k_std / found.images.k)),
        size=float(np.mean((low <= truth) & (truth <= high))),
    )


# --- tables ----------------------------------------------------------------------------------

COUNTS = (1, 2, 3, 5, 10, 30)
DECLARED_WRONG = f"{DECLARED:.0%} wrong, as supposed"
WORSE: dict[str, dict[str, float]] = {
    "none wrong": {"wrong": 0.0},
    DECLARED_WRONG: {},
    "10% wrong": {"wrong": 0.1},
    "20% wrong": {"wrong": 0.2},
    "40% wrong": {"wrong": 0.4},
    "spread half of that declared": {"spread": 0.5},
    "spread double": {"spread": 2.0},
}
_FEW = (DECLARED_WRONG, "20% wrong", "40% wrong", "spread double")
_AFFINE, _PLANE = World("affine_inverse"), World("ground_plane", (2, 3, 4, 5, 6))
_CAMERA = World("metric", camera=True)


class Covered(NamedTuple):
    """A block of the table of coverage."""

    world: World
    method: str
    n_images: int
    counts: tuple[int, ...]
    worse: tuple[str, ...] = tuple(WORSE)


COVERED = {
    "one-law": (
        Covered(World("relative"), "posterior", 500, COUNTS),
        Covered(World("relative"), "robust", 4000, COUNTS),
    ),
    "camera": (Covered(_CAMERA, "posterior", 150, COUNTS[:4], _FEW),),
    "affine": (
        Covered(_AFFINE, "posterior", 100, COUNTS[1:5]),
        Covered(_AFFINE, "robust", 500, COUNTS[1:]),
    ),
    "plane": (
        Covered(_PLANE, "posterior", 60, COUNTS[1:5], _FEW),
        Covered(_PLANE, "robust", 100, COUNTS[1:5], _FEW),
    ),
}


def coverage_lines(blocks: Sequence[Covered]) -> list[str]:
    """Lay the coverage of some blocks out, in % of k / of unknown objects."""
    lines = [f"| method | references | {' | '.join(map(str, COUNTS))} |", "| --- " * 8 + "|"]
    for world, method, n_images, counts, names in blocks:
        for name in names:
            cells = dict.fromkeys(COUNTS, "")
            for count in counts:
                drawn = world._replace(counts=(count,), **WORSE[name])
                found = coverage(drawn, method, n_images, seed=count)
                cells[count] = f"{100 * found.k:.0f} / {100 * found.size:.0f}"
            lines.append(f"| {method} | {name} | {' | '.join(cells.values())} |")
        error = 100 * math.sqrt(0.09 / n_images)
        lines.append(f"| | *{n_images} images a cell, +- {error:.1f} of k* " + "| " * 6 + "|")
    return lines


class Ranked(NamedTuple):
    """A line of the table of ranks."""

    name: str
    world: World
    method: str
    n_images: int
    rank: Callable[[World, str, int, int], Ranks]


RANKED = (
    Ranked("metric, relative, inverse", World("relative"), "posterior", 2000, ranks_in_columns),
    Ranked("the same, by `fit`", World("relative"), "posterior", 500, ranks_in_pictures),
    Ranked("noise not told", World("relative", told=False), "posterior", 400, ranks_in_columns),
    Ranked("metric, with a camera", _CAMERA, "posterior", 400, ranks_in_pictures),
    Ranked("affine inverse", _AFFINE, "posterior", 300, ranks_in_pictures),
    Ranked("ground plane", _PLANE, "posterior", 250, ranks_in_pictures),
    Ranked("metric, relative, inverse", World("relative"), "robust", 20_000, ranks_in_columns),
    Ranked("none wrong", World("relative", wrong=0.0), "robust", 20_000, ranks_in_columns),
    Ranked("affine inverse", _AFFINE, "robust", 1000, ranks_in_columns),
    Ranked("ground plane", _PLANE, "robust", 400, ranks_in_pictures),
)


def power(
    n_images: int, *, narrower: float = 0.85, beside: float = 0.0, in_bins: bool = False
) -> float:
    """Tell how often the test finds intervals too narrow, or off by some standard deviations."""
    rng, rounds = np.random.default_rng(0), 400
    scores = rng.normal(size=(rounds, n_images)) / narrower + beside
    points = np.linspace(-8, 8, 4001)
    shares = np.array([_NORMAL.cdf(point) for point in points])
    ranks = [np.interp(row, points, shares) for row in scores]
    if in_bins:
        ranks = [_in_bins(rng, np.searchsorted(_BINS, row) - 1) for row in ranks]
    return float(np.mean([uniformity(row) < FALSE_ALARM for row in ranks]))


def rank_lines() -> list[str]:
    """Lay the tests of ranks out."""
    lines = [
        "| depth | method | of | images | in 50 % | in 90 % | mean score | spread | p | finds |",
        "| --- " * 10 + "|",
    ]
    for seed, (name, world, method, n_images, rank_them) in enumerate(RANKED):
        found = rank_them(world, method, n_images, seed)
        for what, ranks in found._asdict().items():
            known = ranks[~np.isnan(ranks)]
            if known.size:
                finds = power(known.size, in_bins=rank_them is ranks_in_columns)
                cells = (*_shares(known), f"{finds:.0%}")
                texts = " | ".join((name, method, what, str(known.size), *cells))
                lines.append(f"| {texts} |")
    return lines


def _shares(ranks: Floats) -> tuple[str, ...]:
    """Describe ranks: share in the central intervals, mean and spread of the scores, p-value."""
    scores = np.array([_NORMAL.inv_cdf(min(max(float(one), 1e-4), 1 - 1e-4)) for one in ranks])
    within = [f"{100 * np.mean(abs(ranks - 0.5) <= half):.1f}" for half in (0.25, 0.45)]
    p_value = uniformity(ranks)
    text = f"{p_value:.2f}" if p_value >= 0.01 else f"{p_value:.0e}"
    failed = "" if p_value >= FALSE_ALARM else ", not calibrated"
    return (*within, f"{scores.mean():+.2f}", f"{scores.std():.2f}", text + failed)


def filled(page: str, section: str, lines: Sequence[str]) -> str:
    """Replace the table that stands between the comments of a section."""
    begin, end = f"<!-- calibration: {section} -->", f"<!-- end of {section} -->"
    before, _, rest = page.partition(begin)
    _, found, after = rest.partition(end)
    if not found:
        msg = f"The page must hold {begin} and, behind it, {end}; it does not."
        raise ValueError(msg)
    table = "\n".join(lines)
    return f"{before}{begin}\n\n{table}\n\n{end}{after}"


def main(arguments: Sequence[str]) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        prog="calibration.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--only", choices=("ranks", *COVERED), action="append", help="a table")
    parser.add_argument("--into", type=Path, help="page whose tables are to be replaced")
    options = parser.parse_args(arguments)
    for section in options.only or ("ranks", *COVERED):
        start = time.perf_counter()
        lines = rank_lines() if section == "ranks" else coverage_lines(COVERED[section])
        if options.into:
            page = options.into.read_text(encoding="utf-8")
            options.into.write_text(filled(page, section, lines), encoding="utf-8")
        print(section, *lines, sep="\n", flush=True)
        print(f"{section}: {time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
