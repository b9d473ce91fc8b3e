"""The verb `predict`: from a model to the sizes of objects, with intervals."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import Literal

import numpy as np

from imgscale._checks import check_choice, check_type
from imgscale._typing import IntArray, SizeAxis
from imgscale.columns import in_groups, objects_of
from imgscale.depth import Depth, ObjectDepths
from imgscale.detection import Detection, check_detections
from imgscale.errors import FitError
from imgscale.estimate import SizeEstimate
from imgscale.flags import Flag
from imgscale.laws import LAWS
from imgscale.lookup import look_up, references_seen
from imgscale.model import ScaleModel
from imgscale.object_prior import SIZE_AXES
from imgscale.observations import Observations, observe
from imgscale.posing import check_joint, problem_of_model, solve_by, view_of
from imgscale.prior_choice import MeanKey
from imgscale.sizing import Wanted, distances, gather, row_flags, size_up

__all__ = ["predict"]

_REMEDY = 'pass the map, or depth="mean" for the paper\'s rule.'


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
    depth : DepthMap, ObjectDepths, GroundPlane or "mean"
        Their depth, of the model's kind; to be left out where that is the ground plane. "mean" is
        the paper's rule for objects without a depth: all lie at the mean depth of the references,
        and the interval takes their scatter.
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
    log H = log k + log(d p), with the distribution of log k plus the errors of box and depth. A
    detection that was a reference shares its errors with k, which its interval takes into account;
    it is flagged REFERENCE. With `use_prior` its row is the posterior of the joint fit. A prior is
    not fused with a partial object, which it does not describe, nor with a rejected reference;
    where a measurement contradicts it so much that both together are wider, the prior stands alone.

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
    statue: height 1.500 +- 0.031 m
    >>> ims.predict(model, detections)
    Traceback (most recent call last):
        ...
    ValueError: `depth` is missing; pass the map, or depth="mean" for the paper's rule.
    """
    check_choice("axis", axis, SIZE_AXES)
    check_type("model", model, ScaleModel)
    check_type("use_prior", use_prior, bool)
    detections = check_detections(detections)
    shared_flags = Flag(0)
    if isinstance(depth, str):
        _check_rule(depth)
        depth = _at_mean_depth(model, len(detections))
        shared_flags = Flag.MEAN_DEPTH
    lookup = look_up(model, depth, same_scale=same_scale, remedy=_REMEDY)
    obs = lookup.with_errors(
        observe(
            detections,
            lookup.depth,
            model.priors,
            model.noise,
            ground=model.ground,
            axis=axis,
            k=model.k,
        )
    )
    problem, keys = problem_of_model(model)
    wanted = _wanted(model, detections, obs, keys, use_prior=use_prior)
    cases = solve_by(model.method, problem)
    sizes = size_up(cases, wanted)
    return gather(
        detections,
        obs,
        sizes,
        row_flags(obs, wanted, sizes, cases, references_seen(model, problem), shared_flags),
        distances(model, obs.depth, sizes, wanted.log_k, other_map=lookup.other_map),
    )


def _check_rule(word: str) -> None:
    if word != "mean":
        msg = f'`depth` must be a DepthMap, ObjectDepths or "mean"; got {word!r}.'
        raise ValueError(msg)


def _at_mean_depth(model: ScaleModel, count: int) -> ObjectDepths:
    """Give every object the references' mean depth, with their scatter as its error."""
    if model.kind == "ground_plane":
        msg = (
            '`depth` must be left out for a ground-plane model; got "mean". The feet of objects '
            "tell their distances."
        )
        raise ValueError(msg)
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
        if ref.candidate:
            places[ref.label, ref.xyxy, ref.depth].append(index)
    own = np.full(len(detections), -1, dtype=np.intp)
    for row, detection in enumerate(detections):
        found = places.get((detection.label, detection.xyxy, float(obs.depth[row])))
        if found:
            own[row] = found.pop(0)
    return own


def _wanted(
    model: ScaleModel,
    detections: Sequence[Detection],
    obs: Observations,
    keys: Sequence[MeanKey | None],
    *,
    use_prior: bool,
) -> Wanted:
    """Gather what is to be sized."""
    if use_prior:
        check_joint(model.method)
    own = _own_rows(model, detections, obs)
    subjects = objects_of(obs, view_of(model))
    if subjects.stance:
        seen = {(ref.label, ref.xyxy) for ref in model.references}
        is_new = np.array([(d.label, d.xyxy) not in seen for d in detections], dtype=np.bool_)
        subjects = subjects._replace(stance=subjects.stance._replace(is_new=is_new))
    refs = [None if index < 0 else model.references[index] for index in map(int, own)]
    same_axis = np.array(
        [ref is not None and ref.axis == axis for ref, axis in zip(refs, obs.axis, strict=True)],
        dtype=np.bool_,
    )
    rejected = np.array([ref is not None and not ref.used for ref in refs], dtype=np.bool_)
    share = np.array([0.0 if ref is None else ref.weight for ref in refs])
    # a model's candidates are the rows of its problem
    place = np.cumsum([*(ref.candidate for ref in model.references), False]) - 1
    return Wanted(
        subjects=in_groups(subjects, detections, obs, keys, model.priors),
        own=np.where(same_axis, place[own], -1),
        share=share,
        common_var=obs.depth_var + np.where(same_axis, obs.box_var, 0.0),
        # the prior of a whole object says nothing of a visible part or a rejected reference
        fuse=use_prior & ~(np.isnan(obs.prior_m) | obs.partial | rejected),
        rejected=rejected,
        log_k=np.full(own.size, math.log(model.k)),
    )
