"""What the fixture priors must reach on KITTI, and whether they do."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from validation_rows import Row
from validation_scores import Scores

_NOISY = (5, 10, 20)


@dataclass(frozen=True)
class Goal:
    """One bound; `value` is NaN where its row was not run."""

    text: str
    value: float
    low: float
    high: float

    @property
    def verdict(self) -> str:
        """Whether the value is within the bounds."""
        if np.isnan(self.value):
            return "not run"
        as_printed = round(self.value, 2)
        return "pass" if self.low <= as_printed <= self.high else "FAIL"


def mean_coverage(scores: Mapping[str, Scores]) -> float:
    """Mean coverage of 90 % intervals over the rows that are told of their noise, if all ran."""
    names = [f"{protocol}-told-{percent}" for protocol in "LU" for percent in _NOISY]
    return float(np.mean([_figure(scores, name, "coverage_90") for name in names]))


def goals(rows: Mapping[str, Row], scores: Mapping[str, Scores]) -> list[Goal]:
    """List all goals, with what was reached."""
    parts = (
        _errors(scores),
        _coverage(scores),
        _against_class_mean(rows, scores),
        _damage(scores),
        _detectors(scores),
        _feet(scores),
        _ground(scores),
        _pooled(scores),
    )
    return [goal for part in parts for goal in part]


def _figure(scores: Mapping[str, Scores], name: str, figure: str) -> float:
    return float(getattr(scores[name], figure)) if name in scores else float("nan")


def _bound(
    scores: Mapping[str, Scores], name: str, figure: str, high: float, low: float = 0.0
) -> Goal:
    return Goal(f"{name} {figure}", _figure(scores, name, figure), low, high)


_MEDIANS = {
    "L-told-0": 3.4,
    "L-told-5": 4.2,
    "L-told-10": 4.8,
    "L-told-20": 5.3,
    "U-told-0": 4.5,
    "U-told-5": 6.2,
    "U-told-10": 9.8,
    "U-told-20": 16.5,
    "L-centre-corrected": 3.6,
    "U-centre-corrected": 4.5,
    "L-affine.03-0-Car": 4.3,
    "L-affine.03-0-Pedestrian": 3.3,
    "L-affine.03-5-Car": 4.8,
    "L-affine.03-5-Pedestrian": 4.2,
}
_FOOT_MEDIANS = {
    "L-foot-told-0": 3.4,
    "L-foot-told-5": 4.1,
    "L-foot-told-10": 4.5,
    "L-foot-told-20": 4.8,
    "U-foot-told-0": 4.2,
    "U-foot-told-5": 5.9,
    "U-foot-told-10": 8.1,
    "U-foot-told-20": 10.0,
    "frustum-foot-fused": 4.4,
    "zenuity-foot-fused": 5.1,
}
_GROUND_MEDIANS = {
    "ground-fused": 4.7,
    "ground-unfused": 6.6,
    "pooled-ground-fused": 4.3,
    "pooled-ground-unfused": 5.1,
    "pooled-camera-height": 5.0,
    "pooled-camera-horizon": 6.0,
}
_POOLED_MEDIANS = {
    "pooled-k-told-0": 2.2,
    "pooled-k-told-5": 2.2,
    "pooled-k-tracks-told-0": 1.8,
    "pooled-k-tracks-told-5": 1.8,
    "pooled-height-unfused-0": 2.2,
}


def _errors(scores: Mapping[str, Scores]) -> Iterator[Goal]:
    for name, high in _MEDIANS.items():
        yield _bound(scores, name, "median", high)


def _coverage(scores: Mapping[str, Scores]) -> Iterator[Goal]:
    for percent in (0, *_NOISY):
        yield _bound(scores, f"L-told-{percent}", "coverage_90", 94.5, 87.0)
    for percent in (0, *_NOISY):
        yield _bound(scores, f"U-told-{percent}", "coverage_90", 97.0 if percent else 98.0, 87.0)
    for percent in (0, *_NOISY):
        yield _bound(scores, f"L-told-{percent}", "coverage_50", 60.0, 46.0)
    for protocol in "LU":
        for percent in (0, 5, 10):
            yield _bound(scores, f"{protocol}-untold-{percent}", "coverage_90", 98.0, 86.0)
    yield Goal("mean coverage_90 of told rows with noise", mean_coverage(scores), 89.0, 94.0)


def _against_class_mean(rows: Mapping[str, Row], scores: Mapping[str, Scores]) -> Iterator[Goal]:
    """Whoever uses the class of the object must not be worse than its mean alone."""
    for name, reached in scores.items():
        run = rows[name].run
        whole = not rows[name].is_part and run.boxes == "label" and run.depth != "map"
        if whole and run.uses_prior:
            yield Goal(f"{name} median below class_mean", reached.median, 0.0, reached.class_mean)


def _damage(scores: Mapping[str, Scores]) -> Iterator[Goal]:
    for percent in (0, 5):
        for damage in ("mixed", "cut", "swap"):
            name = f"L-{damage}-{percent}"
            yield _bound(scores, name, "median_ratio", 1.20)
            yield _bound(scores, name, "mean_ratio", 1.25)
            yield _bound(scores, name, "coverage_90", 100.0, 88.0)
    for percent, high in ((0, 1.4), (5, 1.25)):
        for damage in ("mixed", "cut", "swap"):
            yield _bound(scores, f"U-{damage}-{percent}", "median_ratio", high)


def _detectors(scores: Mapping[str, Scores]) -> Iterator[Goal]:
    for boxes, high in (("frustum", 4.6), ("zenuity", 5.3)):
        yield _bound(scores, f"{boxes}-fused", "median", high)
        yield _bound(scores, f"{boxes}-fused", "coverage_90", 94.0, 86.0)


def _feet(scores: Mapping[str, Scores]) -> Iterator[Goal]:
    for name, high in _FOOT_MEDIANS.items():
        yield _bound(scores, name, "median", high)
    for protocol in "LU":
        for percent in (0, *_NOISY):
            yield _bound(scores, f"{protocol}-foot-drive-{percent}", "coverage_90", 98.0, 86.0)


def _ground(scores: Mapping[str, Scores]) -> Iterator[Goal]:
    for name, high in _GROUND_MEDIANS.items():
        yield _bound(scores, name, "median", high)
    for name in ("ground-fused", "ground-unfused"):
        yield _bound(scores, name, "coverage_90", 97.0, 88.0)


def _pooled(scores: Mapping[str, Scores]) -> Iterator[Goal]:
    for name, high in _POOLED_MEDIANS.items():
        yield _bound(scores, name, "median", high)
        if name.startswith("pooled-k"):
            yield _bound(scores, name, "coverage_90", 96.0, 84.0)
