"""The rows of the validation: every run that is reported, and which part of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from validation_outcomes import CAMERA_HEIGHT, HORIZON
from validation_runs import Boxes, Damage, Run
from validation_sections import (
    CENTRE,
    COUNT,
    DAMAGE,
    DETECTORS,
    FOOT,
    GROUND,
    KINDS,
    LEARNED,
    LIDAR,
    NOISE,
    POOLED,
    Section,
)


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
    in_pixels: bool = False
    """Whether its errors are pixels, not relative."""

    @property
    def is_part(self) -> bool:
        """Whether it leaves objects of its run out."""
        return self.label is not None or self.references is not None


_PROTOCOLS: tuple[Literal["L", "U"], ...] = ("L", "U")
_DAMAGES: tuple[Damage, ...] = ("mixed", "cut", "swap")
_DETECTORS: tuple[Boxes, ...] = ("frustum", "zenuity")
_PERCENTS = (0, 5, 10, 20)
_COUNTS = {"1": (1, 1), "2": (2, 2), "3to5": (3, 5), "6up": (6, 10**6)}


def all_rows() -> list[Row]:
    """List all rows, in the order of the table."""
    parts = (
        _noise(),
        _centre(),
        _kinds(),
        _damage(),
        _counts(),
        _detectors(),
        _lidar(),
        _foot(),
        _ground(),
        _pooled(),
        _learned(),
    )
    return [row for part in parts for row in part]


def _noise() -> Iterator[Row]:
    for told in (True, False):
        for protocol in _PROTOCOLS:
            for percent in _PERCENTS:
                run = Run(protocol=protocol, depth_noise=percent / 100, told=told)
                name = f"{protocol}-{_told(told=told)}-{percent}"
                yield Row(name=name, section=NOISE, run=run)


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


def _foot() -> Iterator[Row]:
    for told in (True, False):
        for protocol in _PROTOCOLS:
            for percent in _PERCENTS:
                run = Run(protocol=protocol, depth_noise=percent / 100, told=told, foot=True)
                name = f"{protocol}-foot-{_told(told=told)}-{percent}"
                yield Row(name=name, section=FOOT, run=run)
    for boxes in _DETECTORS:
        for use_prior in (True, False):
            run = Run(protocol="L", depth_noise=0.05, boxes=boxes, use_prior=use_prior, foot=True)
            yield Row(name=f"{boxes}-foot-{_fused(use_prior=use_prior)}", section=FOOT, run=run)


def _ground() -> Iterator[Row]:
    for use_prior in (True, False):
        run = _ground_run("L", use_prior=use_prior)
        yield Row(name=f"ground-{_fused(use_prior=use_prior)}", section=GROUND, run=run)
    yield from _camera_rows("ground", GROUND, _ground_run("k"))


def _pooled() -> Iterator[Row]:
    for tracks in (False, True):
        for told in (True, False):
            for percent in (0, 5):
                noise = percent / 100
                run = Run(protocol="k", depth_noise=noise, told=told, pooled=True, tracks=tracks)
                words = ("pooled-k", *(["tracks"] * tracks), _told(told=told), str(percent))
                yield Row(name="-".join(words), section=POOLED, run=run)
    for use_prior in (True, False):
        for percent in (0, 5):
            run = Run(protocol="L", depth_noise=percent / 100, use_prior=use_prior, pooled=True)
            name = f"pooled-height-{_fused(use_prior=use_prior)}-{percent}"
            yield Row(name=name, section=POOLED, run=run)
    for use_prior in (True, False):
        run = _ground_run("L", use_prior=use_prior, pooled=True)
        yield Row(name=f"pooled-ground-{_fused(use_prior=use_prior)}", section=POOLED, run=run)
    yield from _camera_rows("pooled", POOLED, _ground_run("k", pooled=True))


def _learned() -> Iterator[Row]:
    for foot in (False, True):
        for protocol in _PROTOCOLS:
            for percent in _PERCENTS:
                noise = percent / 100
                run = Run(protocol=protocol, depth_noise=noise, told=False, learned=True, foot=foot)
                name = f"{protocol}-{'foot-' * foot}drive-{percent}"
                yield Row(name=name, section=LEARNED, run=run)


def _ground_run(
    protocol: Literal["L", "k"], *, use_prior: bool = True, pooled: bool = False
) -> Run:
    return Run(
        protocol=protocol,
        kind="ground_plane",
        told=False,
        use_prior=use_prior,
        pooled=pooled,
        fewest=2,  # two unknowns
    )


def _camera_rows(word: str, section: Section, run: Run) -> Iterator[Row]:
    """List what a fit to the ground plane says of the camera."""
    name = f"{word}-camera"
    yield Row(name=f"{name}-height", section=section, run=run, label=CAMERA_HEIGHT)
    yield Row(name=f"{name}-horizon", section=section, run=run, label=HORIZON, in_pixels=True)


def _told(*, told: bool) -> str:
    return "told" if told else "untold"


def _fused(*, use_prior: bool) -> str:
    return "fused" if use_prior else "unfused"
