"""
Measure how often a wrong map, unit or focal length is found out, and how often a right one is.

``python benchmarks/wrong_map.py --root FOLDER`` draws references from images in KITTI's layout (see
kitti.py), without ``--root`` from synthetic scenes. Depths err by 5 %, which the library
is told unless a row says otherwise.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import kitti_scenes
import numpy as np
import synthetic_scenes
from kitti_layout import LayoutError, find_folders
from pooled_rays import BOX_PX, DEPTH_REL, log_slant, pooled
from validation_priors import prior_table
from validation_scenes import KNOWN, FloatArray, Scene, Thing
from validation_views import SEED, _damaged

import imgscale as ims
from imgscale.suspicion import suspect

_COUNTS = (3, 5, 10)
_FOCAL_REL = 0.01
_SYNTHETIC_IMAGES = 150
# The depths of informative subsets differ by this factor.
_SPREAD = 1.5


@dataclass(frozen=True)
class Picture:
    """References as the library is shown them."""

    things: tuple[Thing, ...]
    depths: FloatArray
    kind: str
    image_size: tuple[int, int]
    focal_px: float
    has_camera: bool = False
    told: bool = True
    """Whether the library is told how much the depths err."""

    def model(self, priors: ims.PriorTable) -> ims.ScaleModel:
        """Fit it."""
        camera = ims.Camera(self.focal_px, focal_rel_std=_FOCAL_REL) if self.has_camera else None
        return ims.fit(
            [ims.Detection(thing.label, thing.box) for thing in self.things],
            ims.ObjectDepths(self.depths, kind=self.kind, image_size=self.image_size),
            priors,
            camera=camera,
            method="robust",
            noise=ims.Noise(box_px=BOX_PX, depth_rel=DEPTH_REL if self.told else None),
        )


Mistake = Callable[[Picture, FloatArray, np.random.Generator], Picture]


def _damage(picture: Picture, _: FloatArray, rng: np.random.Generator) -> Picture:
    """Cut or mistake one reference in five."""
    draws = rng.random((len(picture.things), 4))
    pairs = [
        _damaged(thing, "mixed", draw) for thing, draw in zip(picture.things, draws, strict=True)
    ]
    things = [replace(t, label=p[0], box=p[1]) for t, p in zip(picture.things, pairs, strict=True)]
    return replace(picture, things=tuple(things))


def _with_camera(picture: Picture, *_: object) -> Picture:
    return replace(picture, has_camera=True)


def _untold(picture: Picture, *_: object) -> Picture:
    return replace(picture, told=False)


def _inverse(picture: Picture, *_: object) -> Picture:
    return replace(picture, depths=1 / picture.depths)


def _as_inverse(picture: Picture, *_: object) -> Picture:
    return replace(picture, kind="inverse")


def _other(picture: Picture, elsewhere: FloatArray, _: np.random.Generator) -> Picture:
    """Take depths of another image."""
    return replace(picture, depths=elsewhere)


def _millimetres(picture: Picture, *_: object) -> Picture:
    return replace(picture, depths=1000 * picture.depths)


def _ray(picture: Picture, *_: object) -> Picture:
    slant = log_slant(picture.things, picture.image_size, picture.focal_px)
    return replace(picture, depths=picture.depths * np.exp(slant), has_camera=True)


def _stale(factor: float) -> Mistake:
    def mistake(picture: Picture, _: FloatArray, rng: np.random.Generator) -> Picture:
        wrong = picture.focal_px * factor ** rng.choice([-1, 1])
        return replace(picture, focal_px=wrong, has_camera=True)

    return mistake


@dataclass(frozen=True)
class Row:
    """One mistake: what is done, in which order, and the causes that name it."""

    name: str
    mistakes: tuple[Mistake, ...]
    causes: tuple[str, ...] = ()
    spread: float = 1.0
    """Only subsets whose depths differ by so much."""


_INVERSE, _STALE = ("inverse given as depth",), ("stale focal length or resized picture",)
ROWS = (
    Row("right", ()),
    Row("right, camera", (_with_camera,)),
    Row("right, 20 % damaged", (_damage,)),
    Row("right, 20 % damaged, camera", (_damage, _with_camera)),
    Row("right, noise not told", (_untold,)),
    Row("inverse for depth", (_inverse,), _INVERSE),
    Row(f"  where depths differ by {_SPREAD}", (_inverse,), _INVERSE, _SPREAD),
    Row("  20 % damaged", (_damage, _inverse), _INVERSE),
    Row("  noise not told", (_untold, _inverse), _INVERSE),
    Row("depth for inverse", (_as_inverse,), ("depth given as inverse",)),
    Row("another picture's", (_other,), ("depth of another picture",)),
    Row("  noise not told", (_untold, _other), ("depth of another picture",)),
    Row("millimetres", (_millimetres,), ("millimetres",)),
    Row("millimetres, camera", (_millimetres, _with_camera), ("millimetres",)),
    Row("focal length x 1.2", (_stale(1.2),), _STALE),
    Row("focal length x 1.3", (_stale(1.3),), _STALE),
    Row("focal length x 1.5", (_stale(1.5),), _STALE),
    Row("ray for z, camera", (_ray,), ("ray distance given as z-depth",)),
)


def main(arguments: Sequence[str]) -> int:
    """Run the benchmark; return 2 where it cannot begin."""
    parser = argparse.ArgumentParser(prog="wrong_map.py", description=__doc__)
    parser.add_argument("--root", type=Path, help="folder in KITTI's layout")
    parser.add_argument("--subsets", type=int, default=50, help="draws of references of each size")
    options = parser.parse_args(arguments)
    start = time.perf_counter()
    try:
        scenes = _scenes(options.root)
    except LayoutError as error:
        print(f"wrong_map.py: {error}", file=sys.stderr)
        return 2
    source = "KITTI" if options.root else "SYNTHETIC scenes (no --root given), not real data"
    print(f"{source}: {len(scenes)} images, {options.subsets} subsets of each size, seed {SEED}")
    print("Found out, under the right name (in brackets: under any name), %\n")
    priors = prior_table("prototype")
    print("".join([f"{'':32}", *(f"{f'n = {count}':>16}" for count in _COUNTS)]))
    for row in ROWS:
        cells = [_cell(row, _subsets(scenes, n, row, options.subsets), priors) for n in _COUNTS]
        print(f"{row.name:32}" + "".join(f"{cell:>16}" for cell in cells))
    print("\n" + pooled(scenes))
    print(f"\n{time.perf_counter() - start:.0f} s")
    return 0


def _scenes(root: Path | None) -> list[Scene]:
    if root is None:
        return synthetic_scenes.make_scenes(_SYNTHETIC_IMAGES, SEED)
    return kitti_scenes.read_scenes(find_folders(root))


def _subsets(
    scenes: Sequence[Scene], count: int, row: Row, draws: int
) -> list[tuple[Picture, FloatArray, np.random.Generator]]:
    """Draw references, and as many depths of another image; the same for every row."""
    rng = np.random.default_rng([SEED, count])
    rich = [scene for scene in scenes if len(_known(scene)) >= count]
    found: list[tuple[Picture, FloatArray, np.random.Generator]] = []
    while rich and len(found) < draws:
        scene, other = rich[rng.integers(len(rich))], scenes[rng.integers(len(scenes))]
        places = rng.choice(len(_known(scene)), count, replace=False)
        noise = np.exp(DEPTH_REL * rng.standard_normal(count))
        there = [thing.surface_m for thing in other.things] or [1.0]
        elsewhere = rng.choice(there, count, replace=len(there) < count) * noise
        stream = np.random.default_rng([SEED, count, int(rng.integers(2**31))])
        things = tuple(_known(scene)[place] for place in places)
        true = np.array([thing.surface_m for thing in things])
        if other.drive == scene.drive or true.max() < row.spread * true.min():
            continue
        picture = Picture(things, true * noise, "metric", scene.image_size, scene.focal_px)
        found.append((picture, elsewhere, stream))
    return found


def _known(scene: Scene) -> list[Thing]:
    return [thing for thing in scene.things if thing.label in KNOWN]


def _cell(
    row: Row,
    subsets: Sequence[tuple[Picture, FloatArray, np.random.Generator]],
    priors: ims.PriorTable,
) -> str:
    named = any_name = 0
    for picture, elsewhere, rng in subsets:
        shown = picture
        for mistake in row.mistakes:
            shown = mistake(shown, elsewhere, rng)
        causes = {suspicion.cause for suspicion in suspect(shown.model(priors))}
        named += bool(causes & set(row.causes))
        any_name += bool(causes)
    if not subsets:
        return "-"
    share = f"({100 * any_name / len(subsets):.1f})"
    return f"{100 * named / len(subsets):.1f} {share}" if row.causes else share


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
