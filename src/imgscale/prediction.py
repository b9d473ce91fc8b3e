"""The verb `predict`: from a model to the sizes of objects, with intervals."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import Literal

import numpy as np

from imgscale._checks import check_choice, check_type
from imgscale._typing import BoolArray, FloatArray, IntArray, SizeAxis
from imgscale.depth import Depth, DepthMap, ObjectDepths
from imgscale.detection import Detection, check_detections
from imgscale.errors import FitError
from imgscale.estimate import SizeEstimate
from imgscale.estimator import LogObservations, Subjects, fuse_with_prior, view_from_others
from imgscale.flags import Flag, flags_where
from imgscale.laws import LAWS
from imgscale.model import ScaleModel
from imgscale.object_prior import SIZE_AXES
from imgscale.observations import (
    MeanKey,
    Observations,
    mean_key,
    observe,
    usable_depth,
    with_image_size,
)
from imgscale.reference import OUTLIER, Reference

__all__ = ["predict"]


def predict(
    model: ScaleModel,
    detections: Sequence[Detection],
    depth: Depth | Literal["mean"] | None = None,
    *,
    axis: SizeAxis = "height",
    use_prior: bool = False,
    same_scale: bool = False,
) -> list[SizeEstimate]:
    """
    Size objects with a fitted model.

    Parameters
    ----------
    model : ScaleModel
        The scale of the image.
    detections : sequence of Detection
        The objects, known or unknown.
    depth : DepthMap, ObjectDepths or "mean"
        Their depth, of the model's kind. "mean" is the paper's rule for objects without a depth:
        all lie at the mean depth of the references, and the interval takes their scatter.
    axis : str
        "height", "width" or "diameter" (the longer side of the box).
    use_prior : bool
        Fuse the measurement with the object's own prior, where its label has one. The default is
        the pure measurement, k d p.
    same_scale : bool
        Vouch that another map than the fitted one has the same scale.

    Returns
    -------
    list of SizeEstimate
        One per detection, in their order; NaN with a flag where an object has no depth.

    Raises
    ------
    ValueError
        If `depth` is missing or an argument breaks its law.
    TypeError
        If an argument is of the wrong type.
    DepthMismatchError
        If `depth` is of another kind or image size than the model's or, unless the kind is metric,
        another map.
    FitError
        If ``depth="mean"`` and the model has fewer than two references, or all at one depth.

    Notes
    -----
    log H = log k + log(d p), with the variance of log k plus those of box and depth. A detection
    that was a reference shares its errors with k, which its variance takes into account; it is
    flagged REFERENCE. With `use_prior` its row is the posterior of the joint fit. A prior is not
    fused with a partial object, which it does not describe, nor with a rejected reference.

    Examples
    --------
    >>> import imgscale as ims
    >>> detections = [ims.Detection("door", (100, 50, 180, 250)),
    ...               ims.Detection("statue", (300, 80, 400, 230))]
    >>> depth = ims.ObjectDepths([4.0, 4.0], kind="relative", rel_std=0.01)
    >>> model = ims.fit(detections, depth, ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.02)]))
    >>> for estimate in ims.predict(model, detections, depth):
    ...     print(estimate)
    door: height 2.000 +- 0.020 m (REFERENCE)
    statue: height 1.500 +- 0.029 m
    >>> ims.predict(model, detections)
    Traceback (most recent call last):
        ...
    ValueError: `depth` is missing; pass the map, or depth="mean" for the paper's rule.
    """
    check_choice("axis", axis, SIZE_AXES)
    check_type("model", model, ScaleModel)
    check_type("use_prior", use_prior, bool)
    check_type("same_scale", same_scale, bool)
    detections = check_detections(detections)
    if depth is None:
        msg = '`depth` is missing; pass the map, or depth="mean" for the paper\'s rule.'
        raise ValueError(msg)
    shared_flags = Flag(0)
    if isinstance(depth, str):
        _check_rule(depth)
        depth = _at_mean_depth(model, len(detections))
        shared_flags = Flag.MEAN_DEPTH
    model.check_depth(depth, same_scale=same_scale)
    usable = with_image_size(usable_depth(depth), model.image_size)
    obs = observe(detections, usable, model.priors, model.noise, axis=axis)
    other_map = False
    if isinstance(usable, DepthMap) and usable.fingerprint != model.fingerprint:
        other_map = True  # k holds the scale error of the fitted map, and this one has its own
        scale_var = model.scale_rel_std**2 + usable.scale_rel_std**2
        obs = obs._replace(depth_var=obs.depth_var + scale_var)
    return estimate_observed(
        model,
        detections,
        obs,
        own=_own_rows(model, detections, obs),
        use_prior=use_prior,
        flags=shared_flags,
        other_map=other_map,
    )


def estimate_observed(
    model: ScaleModel,
    detections: Sequence[Detection],
    obs: Observations,
    *,
    own: IntArray,
    use_prior: bool,
    flags: Flag = Flag(0),  # noqa: B008 - an immutable member
    other_map: bool = False,
) -> list[SizeEstimate]:
    """
    Size the rows of observations.

    Parameters
    ----------
    model : ScaleModel
        The scale of the image.
    detections : sequence of Detection
        The objects, for their labels and boxes.
    obs : Observations
        Their columns, one row each.
    own : (N,) ndarray of int
        Which of the model's references each row was, -1 for none.
    use_prior : bool
        Fuse the measurement with the objects' own priors.
    flags : Flag
        Reservations that hold for all.
    other_map : bool
        True where the depths are of another map than the fitted one.

    Returns
    -------
    list of SizeEstimate
        One per row.

    Raises
    ------
    ValueError
        If `use_prior` is asked of a model without a joint fit.
    """
    if use_prior and model.method != "robust":
        msg = f'`use_prior` must be False for method "{model.method}"; only "robust" fits jointly.'
        raise ValueError(msg)
    mine = [None if index < 0 else model.references[index] for index in map(int, own)]
    share = np.array([0.0 if ref is None else ref.weight for ref in mine])
    same_axis = np.array(
        [ref is not None and ref.axis == axis for ref, axis in zip(mine, obs.axis, strict=True)],
        dtype=np.bool_,
    )
    log_size = math.log(model.k) + obs.log_size
    # what a reference's own errors e did to k: var(log k - share e + e)
    common = obs.depth_var + np.where(same_axis, obs.box_var, 0.0)
    variance = (model.k_std / model.k) ** 2 + obs.noise_var - 2 * share * common
    fused = np.zeros(own.size, dtype=np.bool_)
    if use_prior:
        # the prior of a whole object says nothing of a visible part or a rejected reference
        rejected = [ref is not None and ref.reason == OUTLIER for ref in mine]
        fused = ~(np.isnan(obs.prior_m) | obs.partial | np.array(rejected, dtype=np.bool_))
        joint = _with_prior(model, detections, obs, np.where(same_axis, own, -1))
        log_size, variance = np.where(fused, joint, (log_size, variance))
    size_m = np.exp(log_size)
    std_m = size_m * np.sqrt(np.maximum(variance, 0.0))
    row_flags = _row_flags(obs, share > 0, fused, flags)
    distance = _distances(model, obs, other_map=other_map)
    return _estimates(model, detections, obs, size_m, std_m, row_flags, distance)


def _check_rule(word: str) -> None:
    if word != "mean":
        msg = f'`depth` must be a DepthMap, ObjectDepths or "mean"; got {word!r}.'
        raise ValueError(msg)


def _at_mean_depth(model: ScaleModel, count: int) -> ObjectDepths:
    """Give every object the references' mean depth, with their scatter as its error."""
    used = [ref.depth for ref in model.references if ref.used]
    if len(used) < 2:
        msg = (
            'depth="mean" must rest on at least two references, whose scatter is its error; '
            f"got {len(used)}."
        )
        raise FitError(msg)
    logs = np.log(LAWS[model.kind].relative_distance(np.array(used), model.shift))
    # of a new object, and of a scatter that few depths show: Student's 95 % quantile over the
    # normal's, by its Cornish-Fisher expansion
    if np.ptp(logs) == 0:
        msg = (
            'depth="mean" must rest on references at different depths, whose scatter is its '
            f"error; got {len(used)} at {used[0]:g}."
        )
        raise FitError(msg)
    dof = logs.size - 1
    small_sample = 1 + 0.926 / dof + 0.863 / dof**2 + 0.598 / dof**3
    scatter = float(np.std(logs, ddof=1)) * math.sqrt(1 + 1 / logs.size)
    return ObjectDepths(
        np.full(count, model.mean_depth),
        kind=model.kind,
        image_size=model.image_size,
        rel_std=scatter * small_sample,
    )


def _own_rows(model: ScaleModel, detections: Sequence[Detection], obs: Observations) -> IntArray:
    """Find the reference that each detection was: same label, box and depth; else -1."""
    places: defaultdict[tuple[object, ...], list[int]] = defaultdict(list)
    for index, ref in enumerate(model.references):
        if ref.reason in {"", OUTLIER}:
            places[ref.label, ref.xyxy, ref.depth].append(index)
    own = np.full(len(detections), -1, dtype=np.intp)
    for row, detection in enumerate(detections):
        found = places.get((detection.label, detection.xyxy, float(obs.depth[row])))
        if found:
            own[row] = found.pop(0)
    return own


def _with_prior(
    model: ScaleModel, detections: Sequence[Detection], obs: Observations, own: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Mean and variance of log size from prior, measurement and all other references."""
    log_obs, weight, keys = _joint_fit(model)
    numbers = {key: number for number, key in enumerate(keys)}
    groups = [
        numbers.get(mean_key(detection.label, axis, model.priors), -1)
        for detection, axis in zip(detections, obs.axis, strict=True)
    ]
    own_precision = np.array([ref.precision for ref in model.references] + [0.0])[own]
    subjects = Subjects(
        image=np.zeros(own.size, dtype=np.intp),
        group=np.array(groups, dtype=np.intp),
        tau=obs.tau,
        own_weight=own_precision,
        own_y=np.where(own_precision > 0, obs.prior_log - obs.log_size, 0.0),
    )
    view = view_from_others(log_obs, weight, subjects)
    return fuse_with_prior(view, obs.prior_log, obs.prior_var, obs.log_size, obs.noise_var)


def _joint_fit(
    model: ScaleModel,
) -> tuple[LogObservations, FloatArray, list[MeanKey | None]]:
    """Rebuild the witnesses of log k, their precisions and the mean that each group shares."""
    refs = [ref for ref in model.references if ref.precision > 0]
    ref_keys = [mean_key(ref.label, ref.axis, model.priors) for ref in refs]
    keys = list(dict.fromkeys(ref_keys))
    y = [math.log(ref.k) - _log_var(ref) / 2 for ref in refs]
    tau = [ref.prior_mean_std_m / ref.prior_m for ref in refs]
    weight = [ref.precision for ref in refs]
    group = [keys.index(key) for key in ref_keys]
    if model.camera_precision and model.camera:
        y.append(-math.log(model.camera.focal_px))
        tau.append(0.0)
        weight.append(model.camera_precision)
        group.append(len(keys))
    precision = np.array(weight, dtype=np.float64)
    log_obs = LogObservations(
        y=np.array(y, dtype=np.float64),
        variance=1 / precision,
        tau=np.array(tau, dtype=np.float64),
        image=np.zeros(precision.size, dtype=np.intp),
        group=np.array(group, dtype=np.intp),
        firm=np.zeros(precision.size, dtype=np.bool_),
    )
    return log_obs, precision, keys


def _log_var(ref: Reference) -> float:
    """Variance of log size between individuals, which sets the median apart from the mean."""
    return math.log1p((ref.prior_std_m / ref.prior_m) ** 2)


def _row_flags(
    obs: Observations, is_reference: BoolArray, fused: BoolArray, flags: Flag
) -> list[Flag]:
    """Collect each row's reservations."""
    columns = {
        Flag.REFERENCE: is_reference,
        Flag.PRIOR_USED: fused,
        Flag.NO_DEPTH: np.isnan(obs.depth),
        Flag.MIXED_DEPTH: obs.mixed,
        Flag.PARTIAL: obs.partial,
    }
    return [
        flags | flags_where({flag: bool(column[row]) for flag, column in columns.items()})
        for row in range(obs.pixels.size)
    ]


def _estimates(
    model: ScaleModel,
    detections: Sequence[Detection],
    obs: Observations,
    size_m: FloatArray,
    std_m: FloatArray,
    flags: Sequence[Flag],
    distance: FloatArray | None,
) -> list[SizeEstimate]:
    """Gather the columns into results."""
    scale = model.metres_per_pixel(obs.depth)
    return [
        SizeEstimate(
            label=detection.label,
            axis=obs.axis[row],
            size_m=float(size_m[row]),
            std_m=float(std_m[row]),
            metres_per_pixel=float(scale[row]),
            depth=float(obs.depth[row]),
            distance_m=None if distance is None else float(distance[row]),
            flags=flags[row],
        )
        for row, detection in enumerate(detections)
    ]


def _distances(model: ScaleModel, obs: Observations, *, other_map: bool) -> FloatArray | None:
    """z-depths in metres: focal length x metres per pixel, or what metric depth itself says."""
    if model.kind != "metric":
        focal_px = model.focal_px
        return None if focal_px is None else focal_px * model.metres_per_pixel(obs.depth)
    if model.camera is None or other_map:
        return obs.depth
    # f k is the map's scale error times the focal length's: the map takes its share of it
    map_var, focal_var = model.scale_rel_std**2, model.camera.focal_rel_std**2
    share = map_var / (map_var + focal_var) if map_var else 0.0
    distance: FloatArray = obs.depth * (model.camera.focal_px * model.k) ** share
    return distance
