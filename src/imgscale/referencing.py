"""What each detection said of the scale: its share, its residual, its posterior size."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imgscale._typing import BoolArray, FloatArray, IntArray
from imgscale.core.mixture import MEDIAN, half_width
from imgscale.core.predictive import measured, residuals, with_priors
from imgscale.core.sighting import log_scales
from imgscale.core.solving import Cases, Estimate
from imgscale.core.witnesses import Sized
from imgscale.detection import Detection
from imgscale.observations import Observations
from imgscale.prior_choice import prior_label, rows_along
from imgscale.priors import PriorTable
from imgscale.reference import OUTLIER, Reference

__all__ = ["Belief", "explain_references"]

# A reference is rejected where the odds are ten to one that it is wrong.
_REJECTED = 0.1
# What a detection that is no candidate gets.
_ABSENT = {
    "posterior_m": math.nan,
    "posterior_std_m": math.nan,
    "z_score": math.nan,
    "weight": 0.0,
    "taken_as_probability": math.nan,
}


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
    objects: Sized,
    candidates: Sized,
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
    objects : Sized
        All of them as columns.
    candidates : Sized
        The eligible rows, with their own priors.
    cases : Cases
        The solutions; its witnesses begin with the same rows.
    estimate : Estimate
        Their summary.
    belief : Belief, optional
        How they are taken, where that was found elsewhere.

    Returns
    -------
    tuple of Reference
        One per detection.
    """
    if belief is None:
        of_kinds = estimate.kinds[: obs.eligible.size]
        trust = estimate.trust[: obs.eligible.size]
        belief = Belief(trust, of_kinds.argmax(axis=1), of_kinds.max(axis=1))
    columns = _columns(obs, candidates, cases, estimate, belief)
    own_k = obs.prior_m / np.exp(log_scales(objects, cases.best)[0][0] + objects.log_pixels)
    place = {int(row): index for index, row in enumerate(obs.eligible)}
    references: list[Reference] = []
    for row, detection in enumerate(detections):
        index = place.get(row)
        known_as = prior_label(detection, priors)
        kinds = rows_along(known_as, obs.axis[row], priors)
        likely = 0 if index is None else int(columns["kind"][index])
        references.append(
            Reference(
                label=detection.label,
                prior_label=known_as,
                xyxy=detection.xyxy,
                axis=obs.axis[row],
                pixels=float(obs.pixels[row]),
                depth=float(obs.depth[row]),
                metres_per_pixel=float(obs.prior_m[row] / obs.pixels[row]),
                k=float(own_k[row]),
                foot_xy=(float(obs.feet[row, 0]), float(obs.feet[row, 1])),
                prior_m=float(obs.prior_m[row]),
                prior_std_m=float(obs.prior_std_m[row]),
                prior_mean_std_m=float(obs.prior_mean_std_m[row]),
                taken_as=kinds[likely].spans if len(kinds) > 1 and index is not None else "",
                taken_as_m=kinds[likely].mean_m if kinds else math.nan,
                noise_rel=math.sqrt(obs.noise_var[row]),
                mixed=bool(obs.mixed[row]),
                reason=obs.reason[row] if index is None else OUTLIER * bool(columns["out"][index]),
                **{
                    name: absent if index is None else float(columns[name][index])
                    for name, absent in _ABSENT.items()
                },
            )
        )
    return tuple(references)


def _columns(
    obs: Observations, candidates: Sized, cases: Cases, estimate: Estimate, belief: Belief
) -> dict[str, FloatArray | IntArray | BoolArray]:
    """Gather what the solutions say of the candidates."""
    own = np.arange(obs.eligible.size)
    log_scale = log_scales(candidates, cases.best)[0][0]
    rejected = belief.trust < _REJECTED
    quantiles = with_priors(cases, candidates, own)
    log_size = quantiles[:, MEDIAN].copy()
    if rejected.any():  # its prior does not hold for it: what is left is its measurement
        lost = candidates.rows(rejected)
        quantiles[rejected] = measured(cases, lost).quantiles()
        log_size[rejected] = estimate.log_k[0] + (log_scale + candidates.log_pixels)[rejected]
    posterior_m = np.exp(log_size)
    return {
        "posterior_m": posterior_m,
        "posterior_std_m": posterior_m * half_width(quantiles),
        "z_score": residuals(cases, candidates, own),
        "weight": estimate.share[own],
        "taken_as_probability": belief.probability,
        "kind": belief.kind,
        "out": rejected,
    }
