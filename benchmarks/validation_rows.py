"""The rows of the validation: every run that is reported, and which part of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

from validation_runs import Boxes, Damage, Run


class Section(NamedTuple):
    """A group of rows and what they show."""

    name: str
    title: str


NOISE = Section(
    "noise",
    "Depth noise of 0 to 20 %, of which the library is told or not. L: each known object from the "
    "others of\nits image and from its class. U: objects of unknown class from Car, Pedestrian, "
    "Cyclist.",
)
CENTRE = Section(
    "centre", "The depth of objects' centres instead of their near faces, uncorrected and declared."
)
KINDS = Section(
    "kinds",
    "Depth with an unknown factor per image; affine also with an unknown shift of the inverse "
    "depth, of\nspread .03 or .1 1/m. 'unfused': without the class of the object itself.",
)
DAMAGE = Section(
    "damage",
    "One reference in five damaged: cut by 40 % from above or below, of a wrong class, or either "
    "(mixed);\nobjects to be sized whole. x: ratio to the same run with sound references.",
)
COUNT = Section("references", "By the number of references, at 5 % depth noise.")
DETECTORS = Section(
    "detectors",
    "Boxes and classes of detectors (score >= 0.5, overlap with a label >= 0.5); the labels' depth "
    "+ 5 %.",
)
LIDAR = Section(
    "lidar",
    "Depth maps (KITTI: from LiDAR) end to end; few, to be read with care. lidar-k: log(k f), its "
    "error and coverage.",
)
SECTIONS = (NOISE, CENTRE, KINDS, DAMAGE, COUNT, DETECTORS, LIDAR)


@dataclass(frozen=True, kw_only=True)
class Row:
    """One line of the table: a run, or the part of it with one class or number of references."""

    name: str
    section: Section
    run: Run
    clean: Run | None = None
    """The same with sound references, where a ratio is reported."""
    label: str | None = None
    references: tuple[int, int] | None = None
    """The fewest and the most."""

    @property
    def is_part(self) -> bool:
        """Whether it leaves objects of its run out."""
        return self.label is not None or self.references is not None


_PROTOCOLS: tuple[Literal["L", "U"], ...] = ("L", "U")
_DAMAGES: tuple[Damage, ...] = ("mixed", "cut", "swap")
_DETECTORS: tuple[Boxes, ...] = ("frustum", "zenuity")
_COUNTS = {"1": (1, 1), "2": (2, 2), "3to5": (3, 5), "6up": (6, 10**6)}


def all_rows() -> list[Row]:
    """List all rows, in the order of the table."""
    parts = (_noise(), _centre(), _kinds(), _damage(), _counts(), _detectors(), _lidar())
    return [row for part in parts for row in part]


def _noise() -> Iterator[Row]:
    for told in (True, False):
        for protocol in _PROTOCOLS:
            for percent in (0, 5, 10, 20):
                run = Run(protocol=protocol, depth_noise=percent / 100, told=told)
                word = "told" if told else "untold"
                yield Row(name=f"{protocol}-{word}-{percent}", section=NOISE, run=run)


def _centre() -> Iterator[Row]:
    for protocol in _PROTOCOLS:
        raw = Run(protocol=protocol, depth="centre")
        corrected = Run(protocol=protocol, depth="corrected")
        yield Row(name=f"{protocol}-centre-raw", section=CENTRE, run=raw)
        yield Row(name=f"{protocol}-centre-corrected", section=CENTRE, run=corrected)


def _kinds() -> Iterator[Row]:
    for percent in (0, 5):
        run = Run(protocol="L", kind="inverse", depth_noise=percent / 100)
        yield Row(name=f"L-inverse-{percent}", section=KINDS, run=run)
    for percent in (0, 5):
        run = Run(protocol="L", kind="relative", depth_noise=percent / 100)
        yield Row(name=f"L-relative-{percent}", section=KINDS, run=run)
    for shift_std in (0.03, 0.1):
        yield from _affine(shift_std)


def _affine(shift_std: float) -> Iterator[Row]:
    word = f"affine{shift_std:.2f}".replace("0.", ".")
    for percent in (0, 5):
        run = _affine_run("L", shift_std, percent / 100)
        name = f"L-{word}-{percent}"
        yield Row(name=name, section=KINDS, run=run)
        for label in ("Car", "Pedestrian"):
            yield Row(name=f"{name}-{label}", section=KINDS, run=run, label=label)
    unfused = _affine_run("L", shift_std, 0.05, use_prior=False)
    yield Row(name=f"L-{word}-5-unfused", section=KINDS, run=unfused)
    yield Row(name=f"U-{word}-5", section=KINDS, run=_affine_run("U", shift_std, 0.05))


def _affine_run(
    protocol: Literal["L", "U"], shift_std: float, depth_noise: float, *, use_prior: bool = True
) -> Run:
    return Run(
        protocol=protocol,
        kind="affine_inverse",
        shift_std=shift_std,
        depth_noise=depth_noise,
        use_prior=use_prior,
        fewest=2,  # two unknowns
    )


def _damaged(protocol: Literal["L", "U"], damage: Damage, percent: int) -> Run:
    return Run(protocol=protocol, depth_noise=percent / 100, damage=damage)


def _damage() -> Iterator[Row]:
    for protocol in _PROTOCOLS:
        for percent in (0, 5):
            clean = _damaged(protocol, "none", percent)
            for damage in _DAMAGES:
                name = f"{protocol}-{damage}-{percent}"
                run = _damaged(protocol, damage, percent)
                yield Row(name=name, section=DAMAGE, run=run, clean=clean)


def _counts() -> Iterator[Row]:
    told = {p: Run(protocol=p, depth_noise=0.05) for p in _PROTOCOLS}
    runs = {
        "L-told-5": (told["L"], None),
        "U-told-5": (told["U"], None),
        "U-mixed-5": (_damaged("U", "mixed", 5), _damaged("U", "none", 5)),
    }
    for name, (run, clean) in runs.items():
        for word, counts in _COUNTS.items():
            title = f"{name}-refs{word}"
            yield Row(name=title, section=COUNT, run=run, clean=clean, references=counts)


def _detectors() -> Iterator[Row]:
    for boxes in _DETECTORS:
        for use_prior in (True, False):
            run = Run(protocol="L", depth_noise=0.05, boxes=boxes, use_prior=use_prior)
            yield Row(name=f"{boxes}-{_fused(use_prior=use_prior)}", section=DETECTORS, run=run)


def _lidar() -> Iterator[Row]:
    scale = Run(protocol="k", depth="map", told=False)
    yield Row(name="lidar-k", section=LIDAR, run=scale)
    for boxes in ("label", *_DETECTORS):
        for use_prior in (True, False):
            run = Run(protocol="L", depth="map", told=False, boxes=boxes, use_prior=use_prior)
            name = f"lidar-{boxes}-{_fused(use_prior=use_prior)}"
            yield Row(name=name, section=LIDAR, run=run)


def _fused(*, use_prior: bool) -> str:
    return "fused" if use_prior else "unfused"
