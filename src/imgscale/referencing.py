"""What each detection said of the scale: its share, its residual, its posterior size."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imgscale._typing import BoolArray, FloatArray
from imgscale.detection import Detection
from imgscale.estimator import (
    LogFit,
    LogObservations,
    OthersView,
    Subjects,
    fuse_with_prior,
    view_from_others,
)
from imgscale.observations import Observations
from imgscale.reference import OUTLIER, Reference

__all__ = ["explain_references"]


def explain_references(
    detections: Sequence[Detection],
    obs: Observations,
    log_obs: LogObservations,
    solution: LogFit,
) -> tuple[Reference, ...]:
    """
    Explain every detection.

    Parameters
    ----------
    detections : sequence of Detection
        The objects.
    obs : Observations
        Their columns.
    log_obs : LogObservations
        The solver's columns: the eligible rows in their order and, last, the camera if it counts.
    solution : LogFit
        The fit.

    Returns
    -------
    tuple of Reference
        One per detection.
    """
    rows = obs.eligible
    count = rows.size
    tau, group = log_obs.tau[:count], log_obs.group[:count]

    def view(weight: FloatArray) -> OthersView:
        own = Subjects(
            image=log_obs.image[:count],
            group=group,
            tau=tau,
            own_weight=weight[:count],
            own_y=log_obs.y[:count],
        )
        return view_from_others(log_obs, weight, own)

    # residuals by the declared errors, so that a disagreement shows
    others = view(solution.trust / log_obs.variance)
    predicted = others.log_k + others.offset
    predicted_var = others.log_k_var + others.offset_var + 2 * others.covariance
    z_score = (log_obs.y[:count] - predicted) / np.sqrt(predicted_var + log_obs.variance[:count])
    outlier = solution.trust[:count] == 0
    measured = solution.log_k[0] + obs.log_size[rows]
    fused, fused_var = fuse_with_prior(
        view(solution.weight), obs.prior_log[rows], obs.prior_var[rows], obs.log_size[rows],
        obs.noise_var[rows],
    )  # fmt: skip
    # an outlier's prior does not hold for it: what is left is its measurement
    posterior = np.where(outlier, measured, fused)
    posterior_var = np.where(outlier, solution.log_std[0] ** 2 + obs.noise_var[rows], fused_var)

    columns = {
        "posterior_m": np.exp(posterior),
        "posterior_std_m": np.exp(posterior) * np.sqrt(posterior_var),
        "z_score": z_score,
        "precision": solution.weight[:count],
        "weight": solution.share[:count],
    }
    place = {int(row): index for index, row in enumerate(rows)}
    return tuple(
        _reference(detection, obs, row, place.get(row), columns, outlier)
        for row, detection in enumerate(detections)
    )


def _reference(
    detection: Detection,
    obs: Observations,
    row: int,
    place: int | None,
    columns: dict[str, FloatArray],
    outlier: BoolArray,
) -> Reference:
    """Gather one row; `place` is its place among the candidates."""
    absent = {"precision": 0.0, "weight": 0.0}
    own = {
        name: absent.get(name, math.nan) if place is None else float(values[place])
        for name, values in columns.items()
    }
    reason = obs.reason[row] if place is None else (OUTLIER if outlier[place] else "")
    return Reference(
        label=detection.label,
        xyxy=detection.xyxy,
        axis=obs.axis[row],
        pixels=float(obs.pixels[row]),
        depth=float(obs.depth[row]),
        metres_per_pixel=float(obs.prior_m[row] / obs.pixels[row]),
        k=float(obs.prior_m[row] / math.exp(obs.log_size[row])),
        prior_m=float(obs.prior_m[row]),
        prior_std_m=float(obs.prior_std_m[row]),
        prior_mean_std_m=float(obs.prior_mean_std_m[row]),
        noise_rel=math.sqrt(obs.noise_var[row]),
        mixed=bool(obs.mixed[row]),
        reason=reason,
        **own,
    )
