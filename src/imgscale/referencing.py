"""What each detection said of the scale: its share, its residual, its posterior size."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from imgscale._typing import FloatArray, IntArray
from imgscale.core.evidence import REJECTED
from imgscale.core.predictive import explained, in_parts, measured
from imgscale.core.sighting import log_scales
from imgscale.core.solving import Cases, Estimate
from imgscale.core.witnesses import Sized
from imgscale.detection import Detection
from imgscale.observations import Observations
from imgscale.posing import Posed
from imgscale.prior_choice import rows_along
from imgscale.priors import PriorTable
from imgscale.reference import OUTLIER, Reference, references_of_columns

__all__ = ["Belief", "explain_references"]

# What a detection that is no candidate gets: posterior size and its error, z-score, weight, and the
# probability of what it is taken as.
_ABSENT = np.array([[math.nan], [math.nan], [math.nan], [0.0], [math.nan]])


class Belief(NamedTuple):
    """
    How the candidates are taken.

    Attributes
    ----------
    trust : (N,) ndarray of float64
        How far each is believed.
    kind : (N,) ndarray of int
        The row of its label that it is taken for.
    probability : (N,) ndarray of float64
        Probability that it is sound and of that kind.
    """

    trust: FloatArray
    kind: IntArray
    probability: FloatArray


def explain_references(
    detections: Sequence[Detection],
    obs: Observations,
    priors: PriorTable,
    posed: Posed,
    cases: Cases,
    estimate: Estimate,
    belief: Belief | None = None,
) -> tuple[Reference, ...]:
    """
    Explain every detection.

    Parameters
    ----------
    detections : sequence of Detection
        The objects.
    obs : Observations
        Their columns.
    priors : PriorTable
        Sizes by label.
    posed : Posed
        The problem that they pose.
    cases : Cases
        Its solutions, whose witnesses begin with the candidates.
    estimate : Estimate
        Their summary.
    belief : Belief, optional
        How they are taken, where that was found elsewhere.

    Returns
    -------
    tuple of Reference
        One per detection.
    """
    rows = obs.eligible
    if belief is None:
        of_kinds = estimate.kinds[: rows.size]
        belief = Belief(estimate.trust[: rows.size], of_kinds.argmax(axis=1), of_kinds.max(axis=1))
    log_own = log_scales(posed.objects, cases.best)[0][0] + posed.objects.log_pixels
    said = np.repeat(_ABSENT, len(detections), axis=1)
    said[:, rows] = _said(posed.candidates, log_own[rows], cases, estimate, belief)
    posterior_m, posterior_std_m, z_score, weight, probability = said.tolist()
    reason = list(obs.reason)
    for row in rows[belief.trust < REJECTED].tolist():
        reason[row] = OUTLIER
    taken_as, taken_as_m = _taken_as(
        obs, priors, dict(zip(rows.tolist(), belief.kind.tolist(), strict=True))
    )
    return references_of_columns(
        label=[detection.label for detection in detections],
        prior_label=obs.known_as,
        xyxy=[detection.xyxy for detection in detections],
        foot_xy=map(tuple, obs.feet.tolist()),
        axis=obs.axis,
        pixels=obs.pixels.tolist(),
        depth=obs.depth.tolist(),
        metres_per_pixel=(obs.prior_m / obs.pixels).tolist(),
        k=(obs.prior_m / np.exp(log_own)).tolist(),
        prior_m=obs.prior_m.tolist(),
        prior_std_m=obs.prior_std_m.tolist(),
        prior_mean_std_m=obs.prior_mean_std_m.tolist(),
        taken_as=taken_as,
        taken_as_m=taken_as_m,
        taken_as_probability=probability,
        noise_rel=np.sqrt(obs.noise_var).tolist(),
        posterior_m=posterior_m,
        posterior_std_m=posterior_std_m,
        z_score=z_score,
        weight=weight,
        mixed=obs.mixed.tolist(),
        reason=reason,
    )


def _taken_as(
    obs: Observations, priors: PriorTable, likely: Mapping[int, int]
) -> tuple[list[str], list[float]]:
    """Name the kind of thing that each is taken for, where it may be several, and its mean size."""
    words: list[str] = []
    means: list[float] = []
    for row, (name, axis) in enumerate(zip(obs.known_as, obs.axis, strict=True)):
        kinds = rows_along(name, axis, priors)
        own = kinds[likely.get(row, 0)] if kinds else None
        words.append(own.spans if own and row in likely and len(kinds) > 1 else "")
        means.append(own.mean_m if own else math.nan)
    return words, means


def _said(
    candidates: Sized, log_own: FloatArray, cases: Cases, estimate: Estimate, belief: Belief
) -> FloatArray:
    """Gather what the solutions say of candidates of the size `log_own` for k = 1."""
    own = np.arange(log_own.size)
    rejected = belief.trust < REJECTED
    log_size, log_std, z_score = np.empty((3, own.size))
    cases, parts = in_parts(cases, candidates)
    for here in parts:
        log_size[here], log_std[here], z_score[here] = explained(cases, candidates.rows(here), here)
        lost = here[rejected[here]]
        if lost.size:  # its prior does not hold for it: what is left is its measurement
            log_std[lost] = measured(cases, candidates.rows(lost)).half_width()
            log_size[lost] = estimate.log_k[0] + log_own[lost]
    posterior_m = np.exp(log_size)
    return np.array(
        [
            posterior_m,
            posterior_m * log_std,
            z_score,
            estimate.share[: own.size],
            belief.probability,
        ]
    )
