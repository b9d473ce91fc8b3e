"""Figures of one row: errors, coverage, their standard errors, and others on the same objects."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from validation_jobs import Validation
from validation_outcomes import LEVELS, Outcomes
from validation_rows import Row
from validation_scenes import FloatArray
from validation_views import SEED

_RESAMPLES = 200


@dataclass(frozen=True, kw_only=True)
class Scores:
    """
    Figures of one row, NaN where there is none.

    Errors are in percent, or in pixels where the row says so; coverages are in percent.
    """

    n: int
    """Answers: objects sized, or images or drives whose scale was found."""
    images: int
    drives: int
    median: float
    """Of the absolute relative error, as the next two."""
    median_se: float
    mean: float
    p90: float
    bias: float
    """Median of the signed error."""
    coverage_50: float
    coverage_90: float
    coverage_90_se: float
    coverage_95: float
    paper: float
    """Median error on the same objects of the paper's estimator, as the next two."""
    class_mean: float
    true_focal: float
    median_ratio: float
    """Error over that with sound references, on the same objects; no percentage."""
    mean_ratio: float
    clean_median: float
    clean_mean: float
    refused_images: int
    refused: int
    """Objects of images that the library declined to fit, in the whole run."""
    unanswered: int
    """Objects without an answer, in the whole run."""


def score(validation: Validation, row: Row) -> Scores | None:
    """Run a row; None where it has no object."""
    outcomes = validation.outcomes(row.run)
    part = _part(outcomes, row)
    if not part.any():
        return None
    errors = np.abs(outcomes.error[part])
    covered = outcomes.covered[part]
    median_se, coverage_se = _standard_errors(errors, covered[:, 1], outcomes.drive[part])
    unit = 1.0 if row.in_pixels else 100.0
    coverage = dict(zip(LEVELS, (100 * covered.mean(axis=0)).tolist(), strict=True))
    ratios = _ratios(validation, row, outcomes, part)
    return Scores(
        n=errors.size,
        images=np.unique(outcomes.key[part, 0]).size,
        drives=np.unique(outcomes.drive[part]).size,
        median=unit * float(np.median(errors)),
        median_se=unit * median_se,
        mean=unit * float(np.mean(errors)),
        p90=unit * float(np.percentile(errors, 90)),
        bias=unit * float(np.median(outcomes.error[part])),
        coverage_50=coverage[0.5],
        coverage_90=coverage[0.9],
        coverage_90_se=100 * coverage_se,
        coverage_95=coverage[0.95],
        paper=_median(_paper_errors(validation, row, outcomes)[part]),
        class_mean=_median(outcomes.class_error[part]),
        true_focal=_median(outcomes.focal_error[part]),
        median_ratio=ratios.median,
        mean_ratio=ratios.mean,
        clean_median=ratios.clean_median,
        clean_mean=ratios.clean_mean,
        refused_images=outcomes.refused_images,
        refused=outcomes.refused,
        unanswered=outcomes.unanswered,
    )


class _Ratios(NamedTuple):
    median: float = float("nan")
    mean: float = float("nan")
    clean_median: float = float("nan")
    clean_mean: float = float("nan")


def _part(outcomes: Outcomes, row: Row) -> NDArray[np.bool_]:
    part = np.ones(outcomes.error.size, dtype=np.bool_)
    if row.label is not None:
        part &= outcomes.label == row.label
    if row.references is not None:
        fewest, most = row.references
        part &= (outcomes.references >= fewest) & (outcomes.references <= most)
    return part


def _paper_errors(validation: Validation, row: Row, outcomes: Outcomes) -> FloatArray:
    run = row.run.by_paper()
    if run is None:
        return np.full(outcomes.error.size, np.nan)
    return _aligned(validation.outcomes(run), outcomes)


def _ratios(
    validation: Validation, row: Row, outcomes: Outcomes, part: NDArray[np.bool_]
) -> _Ratios:
    if row.clean is None:
        return _Ratios()
    clean = np.abs(_aligned(validation.outcomes(row.clean), outcomes)[part])
    errors = np.abs(outcomes.error[part])[np.isfinite(clean)]
    clean = clean[np.isfinite(clean)]
    if not clean.size:
        return _Ratios()
    median, mean = float(np.median(clean)), float(np.mean(clean))
    return _Ratios(
        median=float(np.median(errors)) / median,
        mean=float(np.mean(errors)) / mean,
        clean_median=100 * median,
        clean_mean=100 * mean,
    )


def _aligned(other: Outcomes, outcomes: Outcomes) -> FloatArray:
    """Errors of another run on the objects of this one, NaN where it has no answer."""
    errors = dict(zip(map(tuple, other.key.tolist()), other.error.tolist(), strict=True))
    keys = map(tuple, outcomes.key.tolist())
    return np.array([errors.get(key, np.nan) for key in keys], dtype=np.float64)


def _median(errors: FloatArray) -> float:
    """Median size of errors, in percent, NaN unless there are any."""
    known = np.abs(errors[np.isfinite(errors)])
    return 100 * float(np.median(known)) if known.size else float("nan")


def _standard_errors(
    errors: FloatArray, covered: NDArray[np.bool_], drive: NDArray[np.str_]
) -> tuple[float, float]:
    """Of the median and of a coverage, by resampling whole drives; NaN if there is but one."""
    names, group = np.unique(drive, return_inverse=True)
    if names.size < 2:
        return float("nan"), float("nan")
    order = np.argsort(errors)
    errors, covered, group = errors[order], covered[order], group[order]
    rng = np.random.default_rng(SEED)
    figures = []
    for _ in range(_RESAMPLES):
        drawn = np.bincount(rng.integers(names.size, size=names.size), minlength=names.size)
        weight = np.cumsum(drawn[group])
        middle = int(np.searchsorted(weight, weight[-1] / 2))
        figures.append((errors[middle], covered @ drawn[group] / weight[-1]))
    median_se, coverage_se = np.std(figures, axis=0, ddof=1).tolist()
    return median_se, coverage_se
