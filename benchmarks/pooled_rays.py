"""Find ray distances given as z-depth in whole drives, where one image shows little of them."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np
from validation_priors import PROTOTYPE
from validation_scenes import KNOWN, FloatArray, Scene, Thing
from validation_views import SEED

DEPTH_REL = 0.05
BOX_PX = 1.5
# A box recurs so often in a drive: its individual size is one draw, not so many.
_REPEATS = 10
_POOLED_T = 3.0
_INFORMATIVE_STD = 0.3


def log_slant(things: Sequence[Thing], image_size: tuple[int, int], focal_px: float) -> FloatArray:
    """Log of ray over z at the centres of boxes."""
    boxes = np.array([thing.box for thing in things]).reshape(-1, 4)
    offset = (boxes[:, :2] + boxes[:, 2:]) / 2 - np.array(image_size) / 2
    slant: FloatArray = 0.5 * np.log1p(((offset / focal_px) ** 2).sum(axis=1))
    return slant


def pooled(scenes: Sequence[Scene]) -> str:
    """Look for ray distances in whole drives: residuals that fall with the log of ray over z."""
    drives: Mapping[str, list[Scene]] = defaultdict(list)
    for scene in scenes:
        drives[scene.drive].append(scene)
    tests = [_slope(group, ray=True) + _slope(group, ray=False) for group in drives.values()]
    found = np.array([test for test in tests if not math.isnan(test[1])]).reshape(-1, 4)
    informative = found[found[:, 1] < _INFORMATIVE_STD]
    lines = [
        f"{name}: {len(part)} drives, found {100 * np.mean(part[:, 0] > _POOLED_T):.0f} %, "
        f"false alarms {100 * np.mean(part[:, 2] > _POOLED_T):.0f} %"
        for name, part in (("all", found), (f"std < {_INFORMATIVE_STD}", informative))
        if len(part)
    ]
    return "Ray for z, pooled over a drive (slope on log ray / z, t > 3)\n" + "\n".join(lines)


def _slope(scenes: Sequence[Scene], *, ray: bool) -> tuple[float, float]:
    """Compute t value and error of the slope, with log k and the labels' offsets."""
    rng = np.random.default_rng(SEED)
    rows: list[tuple[float, float, float, int]] = []
    for scene in scenes:
        things = tuple([thing for thing in scene.things if thing.label in KNOWN])
        slants = log_slant(things, scene.image_size, scene.focal_px)
        for thing, slant in zip(things, slants, strict=True):
            law = PROTOTYPE[thing.label]
            seen = law.mean_m / (thing.pixels * thing.surface_m)
            residual = math.log(seen) + DEPTH_REL * rng.standard_normal() - slant * ray
            variance = _REPEATS * law.spread**2 + (BOX_PX / thing.pixels) ** 2 + DEPTH_REL**2
            rows.append((residual, slant, variance, list(PROTOTYPE).index(thing.label)))
    if len(rows) < 3:
        return math.nan, math.nan
    residual, slant, variance, label = np.array(rows).T
    design = np.column_stack([slant, np.ones_like(slant), label[:, None] == range(len(PROTOTYPE))])
    information = design.T @ (design / variance[:, None])
    information[2:, 2:] += np.diag([law.mean_spread**-2 for law in PROTOTYPE.values()])
    covariance = np.linalg.pinv(information)
    slope = (covariance @ (design.T @ (residual / variance)))[0]
    std = math.sqrt(covariance[0, 0])
    return -slope / std, std
