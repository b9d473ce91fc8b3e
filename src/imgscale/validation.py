"""Is it right on my photos? Every known object is sized from the others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Unpack

import numpy as np

from imgscale._checks import check_type
from imgscale.depth import Depth
from imgscale.detection import Detection, check_detections
from imgscale.errors import FitError
from imgscale.estimate import SizeEstimate
from imgscale.fitting import FitOptions, fit_observed, observe_references
from imgscale.prediction import estimate_observed
from imgscale.priors import PriorTable

__all__ = ["leave_one_out"]

_LEFT_OUT = "left out"


def leave_one_out(
    detections: Sequence[Detection],
    depth: Depth,
    priors: PriorTable | None = None,
    *,
    use_prior: bool = False,
    **fit_options: Unpack[FitOptions],
) -> list[SizeEstimate]:
    """
    Size every reference from the others of its image.

    Parameters
    ----------
    detections : sequence of Detection
        The objects in the image.
    depth : DepthMap or ObjectDepths
        Their depth.
    priors : PriorTable, optional
        Sizes by label; the shipped table where omitted.
    use_prior : bool
        Fuse each measurement with the object's own prior, as `predict` does.
    **fit_options
        The keyword arguments of `fit`.

    Returns
    -------
    list of SizeEstimate
        One per detection, in their order, along the axis through which it is a witness. An object
        that cannot be a reference is sized from all references, as by `predict`.

    Raises
    ------
    FitError
        If leaving one out leaves nothing to fit.
    ValueError
        If an argument breaks its law.
    TypeError
        If an argument is of the wrong type.

    Examples
    --------
    >>> import imgscale as ims
    >>> detections = [ims.Detection("door", (100, 50, 180, 250)),
    ...               ims.Detection("table", (300, 80, 400, 155))]
    >>> depth = ims.ObjectDepths([4.0, 4.0], kind="relative", rel_std=0.01)
    >>> priors = ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.02),
    ...                          ims.ObjectPrior("table", 0.74, 0.02)])
    >>> for estimate in ims.leave_one_out(detections, depth, priors):
    ...     print(estimate)
    door: height 1.97 +- 0.07 m
    table: height 0.750 +- 0.017 m
    """
    check_type("use_prior", use_prior, bool)
    detections = check_detections(detections)
    obs, setting = observe_references(detections, depth, priors, **fit_options)
    nobody = np.full(len(detections), -1, dtype=np.intp)  # none of them was in its own fit
    estimates = estimate_observed(
        fit_observed(detections, obs, setting), detections, obs, own=nobody, use_prior=use_prior
    )
    for row in (int(index) for index in obs.eligible):
        reasons = list(obs.reason)
        reasons[row] = _LEFT_OUT
        try:
            model = fit_observed(detections, obs._replace(reason=tuple(reasons)), setting)
        except FitError as error:
            msg = (
                "`detections` must hold at least two references to leave one out; "
                f"got {detections[row].label} alone."
            )
            raise FitError(msg) from error
        left_out = estimate_observed(model, detections, obs, own=nobody, use_prior=use_prior)
        estimates[row] = left_out[row]
    return estimates
