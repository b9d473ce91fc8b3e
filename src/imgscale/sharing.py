"""The verb `fit_shared`: one camera, many frames."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, TypedDict

import attrs
import numpy as np

from imgscale._checks import check_iterable, check_type
from imgscale._typing import FitMethod, FloatArray, IntArray
from imgscale.columns import objects_of
from imgscale.core.pooling import (
    PooledRows,
    Totals,
    common_offsets,
    judged_rows,
    level_weights,
    pooled_rows,
    totals,
)
from imgscale.core.solving import Problem, estimate, solve
from imgscale.core.witnesses import Nuisance, Sized, noise_cases
from imgscale.depth import GroundPlane
from imgscale.detection import Detection
from imgscale.errors import FitError
from imgscale.fitting import fit_observed, observe_references
from imgscale.frame import Frame
from imgscale.model import ScaleModel
from imgscale.noise import Noise
from imgscale.object_prior import ObjectPrior, normal_label
from imgscale.observations import Observations
from imgscale.posing import Setting, problem_of, problem_of_columns, view_of
from imgscale.prior_choice import MeanKey, mean_key_of
from imgscale.priors import PriorTable
from imgscale.shared_scale import SharedReference, SharedScale
from imgscale.standing import JITTERS

__all__ = ["fit_shared"]

# Without track ids an object is taken to be seen in so many frames.
_REPEATS = 10
# A frame of a sequence, whose objects are largely those of its neighbours, tells as much of a noise
# as so many independent ones.
_INDEPENDENT = 0.3
# References that are pooled: more tell no more, as the labels' means are not known so well.
_MOST_ROWS = 1500
_LEAST_WEIGHT = 1e-9


def fit_shared(
    frames: Iterable[Frame],
    priors: PriorTable | None = None,
    *,
    ground: GroundPlane | None = None,
    method: FitMethod = "posterior",
    noise: Noise = Noise(),  # noqa: B008 - frozen
) -> list[ScaleModel]:
    """
    Fit many frames of one camera together.

    Parameters
    ----------
    frames : iterable of Frame
        The frames, all with depth of one kind. They are read one after the other; of a frame its
        detections and references are kept, not its depth map and masks.
    priors : PriorTable, optional
        Sizes by label; the shipped table where omitted.
    ground : GroundPlane, optional
        A second witness of distance beside each frame's depth, as for `fit`.
    method : str
        "posterior" or "robust".
    noise : Noise
        Errors of boxes and depths. Where `Noise.depth_rel` is None, the noise of the source is
        learned over its frames.

    Returns
    -------
    list of ScaleModel
        One per frame, in their order. With metric depth all share k (but for what each frame's own
        plane adds where a `ground` tells the camera's height), with a `GroundPlane` camera height,
        horizon and roll; depth of the other kinds has a scale of its own in every frame,
        which shares the deviation of the labels' mean sizes from the table's alone: the model's
        `priors` are then moved by it.

    Raises
    ------
    FitError
        If there is no reference in any frame or, where frames have a scale of their own, in one.
    ValueError
        If there is no frame, the frames differ in their kind of depth or camera, or an argument
        breaks its law.
    TypeError
        If an argument is of the wrong type.

    Notes
    -----
    All references of one label share its offset in the whole call. Those of one `track_id` share
    their own deviation too: r of them weigh ``1 / (r s^2 + noise)`` each; an object without one is
    taken to be seen in 10 frames, or in all if there are fewer. Beyond 1500 references frames are
    thinned out evenly.

    Examples
    --------
    >>> import imgscale as ims
    >>> def frame(z, pixels):
    ...     door = ims.Detection("door", (100, 50, 180, 50 + pixels), track_id=1)
    ...     return ims.Frame([door], ims.ObjectDepths([z], kind="metric"))
    >>> table = ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.02)])
    >>> models = ims.fit_shared([frame(4.0, 250), frame(5.0, 200), frame(8.0, 125)], table)
    >>> print(models[0])
    k = 0.00200 +- 0.00006 1/px (1 / focal length) from 1 of 1 reference and those of 2 other frames
    """
    table = PriorTable.default() if priors is None else priors
    check_iterable("frames", frames, "Frame")
    kept = [_keep(frame, table, ground=ground, method=method, noise=noise) for frame in frames]
    _check_alike(kept)
    kept = _with_noise_learned(kept)
    if kept[0].setting.kind in {"metric", "ground_plane"}:
        kept = _with_scale_shared(kept)
    else:
        kept = _with_offsets_shared(kept)
    return [fit_observed(frame.detections, frame.obs, frame.setting) for frame in kept]


class _Kept(NamedTuple):
    """What is kept of a frame."""

    name: str
    detections: tuple[Detection, ...]
    obs: Observations
    setting: Setting


def _keep(
    frame: Frame,
    priors: PriorTable,
    *,
    ground: GroundPlane | None,
    method: FitMethod,
    noise: Noise,
) -> _Kept:
    """Read a frame, and let its map and masks go."""
    check_type("frames", frame, Frame, " Wrap detections and depth as Frame(detections, depth).")
    if method not in {"posterior", "robust"}:
        msg = f'`method` must be "posterior" or "robust" for frames that share; got {method!r}.'
        raise ValueError(msg)
    obs, setting = observe_references(
        frame.detections,
        frame.depth,
        priors,
        ground=ground,
        camera=frame.camera,
        method=method,
        noise=noise,
    )
    light = tuple(attrs.evolve(detection, mask=None) for detection in frame.detections)
    return _Kept(frame.name, light, obs, setting)


def _check_alike(kept: Sequence[_Kept]) -> None:
    """Raise unless the frames can share."""
    if not kept:
        msg = "`frames` must hold at least one frame; got none."
        raise ValueError(msg)
    sized = next((frame for frame in kept if frame.setting.image_size), kept[0])
    for index, frame in enumerate(kept):
        for name in ("kind", "camera", "ground", "scale_rel_std", "image_size"):
            other = sized if name == "image_size" else kept[0]
            first, own = (getattr(one.setting, name) for one in (other, frame))
            if name == "image_size" and own is None:
                continue
            if first != own:
                msg = (
                    f"`frames` must be of one camera and one kind of depth; got {name} {own} in "
                    f'frame {index} "{frame.name}" and {first} in the first. Call fit_shared for '
                    "each camera."
                )
                raise ValueError(msg)


def _with_noise_learned(kept: list[_Kept]) -> list[_Kept]:
    """Learn the noise of the depths over all frames, where nobody told it."""
    problems: list[Problem] = []
    for frame in _thinned(kept):
        if frame.obs.unknown_noise and frame.obs.eligible.size:
            try:
                problems.append(problem_of(frame.detections, frame.obs, frame.setting))
            except FitError:  # a frame that cannot be fitted alone
                continue
    if not problems:
        return kept
    levels = noise_cases(1, unknown_noise=True)
    log_evidence = [solve(problem._replace(exact=False)).of_levels(levels) for problem in problems]
    weight = level_weights(np.array(log_evidence).T, levels.log_prior[:, 0], _INDEPENDENT)
    depth_rel = math.exp(float(weight @ np.log(levels.depth_var[:, 0])) / 2)
    return [_told(frame, depth_rel) for frame in kept]


def _told(frame: _Kept, depth_rel: float) -> _Kept:
    """Tell a frame how much its depths err."""
    noise = attrs.evolve(frame.setting.noise, depth_rel=depth_rel)
    obs = frame.obs
    return frame._replace(
        obs=obs._replace(depth_var=obs.depth_var + depth_rel**2, unknown_noise=False),
        setting=frame.setting._replace(noise=noise, depth_rel=depth_rel),
    )


class _Pool(NamedTuple):
    """References of all frames as one image."""

    witnesses: Sized
    keys: list[MeanKey | None]
    frame: IntArray
    repeats: FloatArray


def _pool(kept: Sequence[_Kept], problems: Sequence[Sized]) -> _Pool:
    """Join the references of frames, with common numbers for their labels."""
    keys: dict[MeanKey | None, int] = {}
    groups: list[int] = []
    tracks: list[tuple[object, ...] | None] = []
    for frame in kept:
        for row, key in zip(map(int, frame.obs.eligible), _keys(frame), strict=True):
            groups.append(keys.setdefault(key, len(keys)))
            track = frame.detections[row].track_id
            tracks.append(None if track is None else (key, track))
    joined = problems[0]
    for other in problems[1:]:
        joined = joined.joined(other)
    seen = Counter(track for track in tracks if track is not None)
    untracked = float(min(_REPEATS, len(kept)))
    return _Pool(
        witnesses=joined._replace(
            group=np.array(groups, dtype=np.intp), image=np.zeros(len(groups), dtype=np.intp)
        ),
        keys=list(keys),
        frame=np.repeat(np.arange(len(kept)), [frame.obs.eligible.size for frame in kept]),
        repeats=np.array([untracked if t is None else float(seen[t]) for t in tracks]),
    )


def _thinned(kept: Sequence[_Kept]) -> list[_Kept]:
    """Take evenly spread frames that have references, with no more of these than are pooled."""
    with_references = [frame for frame in kept if frame.obs.eligible.size]
    if not with_references:
        msg = "`frames` must hold at least one reference: an object with a prior and a depth."
        raise FitError(msg)
    count = sum(frame.obs.eligible.size for frame in with_references)
    return with_references[:: max(1, math.ceil(count / _MOST_ROWS))]


def _eligible(frame: _Kept, jitter_px: float) -> Sized:
    """Columns of a frame's references, as seen by depth or foot alone."""
    setting = frame.setting
    if setting.kind != "ground_plane":
        setting = setting._replace(ground=None)
    view = view_of(setting)
    view = view and view._replace(jitter_px=jitter_px)
    return objects_of(frame.obs, view).rows(frame.obs.eligible)


def _pooled_problem(pool: _Pool, setting: Setting) -> Problem:
    """Pose the problem of all frames as one image."""
    if setting.kind != "ground_plane":
        setting = setting._replace(ground=None)
    return problem_of_columns(pool.witnesses, setting)


def _with_scale_shared(kept: Sequence[_Kept]) -> list[_Kept]:
    """Let every frame know what the others say of k and of the plane."""
    pooled = _thinned(kept)
    jitter_px = _jitter(pooled)
    pool = _pool(pooled, [_eligible(frame, jitter_px) for frame in pooled])
    problem = _pooled_problem(pool, kept[0].setting)
    cases = solve(problem)
    found = estimate(problem, cases)
    rows = pooled_rows(pool.witnesses, pool.repeats, cases, found)
    everyone = totals(rows, pool.witnesses.group, len(pool.keys))
    origin = _origin(cases.best)
    informed: list[_Kept] = []
    number = 0
    for frame in kept:
        is_pooled = number < len(pooled) and frame is pooled[number]
        own = pool.frame == (number if is_pooled else -1)
        number += is_pooled
        groups = pool.witnesses.group[own]
        part = rows.rows(own)
        others = everyone.without(totals(part, groups, len(pool.keys)))
        keys = [pool.keys[int(group)] for group in groups]
        if not is_pooled:  # thinned out: its references weigh nothing
            columns = _eligible(frame, jitter_px)
            part = judged_rows(columns, cases.best, float(found.log_k[0]))
            keys = _keys(frame)
        of_own = [_row(part, row, key, origin) for row, key in enumerate(keys)]
        shared = SharedScale(
            n_frames=len(kept),
            own=tuple(of_own),
            others=_others(others, pool.keys, origin),
            jitter_px=jitter_px,
            inconsistent=bool(found.inconsistent[0]),
            **_plane(others, cases.best),
        )
        informed.append(frame._replace(setting=frame.setting._replace(shared=shared)))
    return informed


def _origin(best: Nuisance) -> FloatArray:
    """Horizon and slope at which derivatives were taken."""
    if best.horizon is None or best.slope is None:
        return np.zeros(2)
    return np.array([best.horizon[0, 0], best.slope[0, 0]])


def _row(rows: PooledRows, row: int, key: MeanKey | None, origin: FloatArray) -> SharedReference:
    """Put one reference into plain numbers, its log k as though horizon and slope were 0."""
    label, axis = _named(key)
    return SharedReference(
        label=label,
        axis=axis,
        log_k=float(rows.log_k[row] - rows.lean[row] @ origin),
        precision=float(rows.precision[row]),
        lean=(float(rows.lean[row, 0]), float(rows.lean[row, 1])),
        trust=float(rows.trust[row]),
        kind=int(rows.kind[row]),
        kind_probability=float(rows.kind_probability[row]),
    )


def _keys(frame: _Kept) -> list[MeanKey | None]:
    """Look up the mean sizes that a frame's references rest on."""
    return [
        mean_key_of(frame.detections[row], frame.obs.axis[row], frame.setting.priors)
        for row in map(int, frame.obs.eligible)
    ]


def _others(
    sums: Totals, keys: Sequence[MeanKey | None], origin: FloatArray
) -> tuple[SharedReference, ...]:
    """Put the sums of other frames into one row for each label."""
    rows: list[SharedReference] = []
    for number, key in enumerate(keys):
        weight = float(sums.weight[number])
        if weight > _LEAST_WEIGHT:
            label, axis = _named(key)
            lean = sums.lean[number] / weight
            rows.append(
                SharedReference(
                    label=label,
                    axis=axis,
                    log_k=float(sums.log_k[number] / weight - lean @ origin),
                    precision=weight,
                    lean=(float(lean[0]), float(lean[1])),
                )
            )
    return tuple(rows)


def _named(key: MeanKey | None) -> MeanKey:
    if key is None:
        msg = "a reference has a prior, and that a label"
        raise AssertionError(msg)
    return key


class _PlaneFields(TypedDict):
    """What `SharedScale` says of the plane."""

    horizon: float
    slope: float
    plane_precision: tuple[float, float, float]


def _plane(sums: Totals, best: Nuisance) -> _PlaneFields:
    """Tell what the scatter of other frames' references says of horizon and slope."""
    if best.horizon is None or best.slope is None:
        return {"horizon": 0.0, "slope": 0.0, "plane_precision": (0.0, 0.0, 0.0)}
    shift, precision = sums.plane()
    return {
        "horizon": float(best.horizon[0, 0] + shift[0]),
        "slope": float(best.slope[0, 0] + shift[1]),
        "plane_precision": (
            float(precision[0, 0]),
            float(precision[0, 1]),
            float(precision[1, 1]),
        ),
    }


def _jitter(pooled: Sequence[_Kept]) -> float:
    """Learn how far the horizon moves from frame to frame, in pixels."""
    setting = pooled[0].setting
    if setting.kind != "ground_plane" or setting.image_size is None:
        return 0.0
    levels = np.array(JITTERS) * max(setting.image_size)
    evidence: list[float] = []
    for level in map(float, levels):
        pool = _pool(pooled, [_eligible(frame, level) for frame in pooled])
        cases = solve(_pooled_problem(pool, setting)._replace(exact=False))
        evidence.append(float(np.logaddexp.reduce(cases.log_weight[:, 0])))
    weight = level_weights(np.array(evidence)[:, None], np.zeros(levels.size), _INDEPENDENT)
    return math.sqrt(float(weight @ levels**2))


def _with_offsets_shared(kept: list[_Kept]) -> list[_Kept]:
    """Move the means of all labels by what the frames say of them together."""
    pooled = _thinned(kept)
    pool = _pool(pooled, [_eligible(frame, 0.0) for frame in pooled])
    rows: PooledRows | None = None
    for number, frame in enumerate(pooled):
        problem = problem_of(frame.detections, frame.obs, frame.setting)
        cases = solve(problem)
        own = pool.frame == number
        found = estimate(problem, cases)
        references = problem.witnesses.rows(np.arange(int(own.sum())))
        part = pooled_rows(references, pool.repeats[own], cases, found)
        rows = part if rows is None else rows.joined(part)
    if rows is None:
        return kept
    tau = np.zeros(len(pool.keys))
    tau[pool.witnesses.group] = pool.witnesses.tau
    offsets = common_offsets(rows, pool.witnesses.group, pool.frame, tau)
    priors = _moved(kept[0].setting.priors, dict(zip(pool.keys, offsets.tolist(), strict=True)))
    return [
        frame._replace(
            obs=frame.obs.with_priors(priors), setting=frame.setting._replace(priors=priors)
        )
        for frame in kept
    ]


def _moved(priors: PriorTable, offsets: Mapping[MeanKey | None, float]) -> PriorTable:
    """Move the mean sizes of some labels by a factor."""
    rows: list[ObjectPrior] = []
    for prior in priors:
        offset = offsets.get((normal_label(prior.label), prior.axis), 0.0)
        factor = math.exp(-offset)  # an offset of log k: the table's mean is too large by it
        moved = attrs.evolve(
            prior,
            mean_m=prior.mean_m * factor,
            std_m=prior.std_m * factor,
            mean_std_m=prior.mean_std_m * factor,
        )
        rows.append(moved if offset else prior)
    return PriorTable(rows)
