"""From detections to the solver's columns: what one image, or one model, gives the core."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imgscale._typing import FloatArray, IntArray
from imgscale.camera import Camera
from imgscale.core.segments import Parts
from imgscale.core.stance import Stance
from imgscale.core.witnesses import Sized
from imgscale.depth import GroundPlane
from imgscale.detection import Detection
from imgscale.extent import extent_rel_std
from imgscale.laws import LAWS
from imgscale.model import ScaleModel
from imgscale.observations import Observations
from imgscale.prior_choice import (
    MeanKey,
    columns_of,
    log_moments,
    mean_key,
    mean_key_of,
    size_along,
)
from imgscale.priors import PriorTable
from imgscale.reference import Reference
from imgscale.shared_scale import SharedScale
from imgscale.standing import Viewpoint, height_of, stance_of

# A rejected reference of a shared scale weighs nothing.
_LEAST_PRECISION = 1e-9
# What tells nothing has this variance.
_NOTHING_VAR = 1e6


class FirmWitness(NamedTuple):
    """
    What is known of the camera: with metric depth k = 1 / f, with a plane its height.

    Attributes
    ----------
    log_value, variance : float
        Log of 1 / focal length (errors of the map's scale included) or of the height in metres.
    is_height : bool
        True for the height.
    """

    log_value: float
    variance: float
    is_height: bool


def camera_witness(camera: Camera, scale_rel_std: float) -> FirmWitness:
    """
    Ask a camera for log k.

    Parameters
    ----------
    camera : Camera
        The camera.
    scale_rel_std : float
        Relative standard error of the metric depth's scale.

    Returns
    -------
    FirmWitness
        What it says.
    """
    variance = camera.focal_rel_std**2 + scale_rel_std**2
    return FirmWitness(-float(np.log(camera.focal_px)), variance, is_height=False)


def firm_witnesses(
    camera: Camera | None, ground: GroundPlane | None, scale_rel_std: float
) -> list[FirmWitness]:
    """
    Gather what is known beforehand of the camera.

    Parameters
    ----------
    camera : Camera or None
        The camera, where its focal length is a witness of k.
    ground : GroundPlane or None
        The plane, where there is one.
    scale_rel_std : float
        Relative standard error of the metric depth's scale.

    Returns
    -------
    list of FirmWitness
        None, one or both.
    """
    firm = [camera_witness(camera, scale_rel_std)] if camera else []
    if ground:
        firm.append(FirmWitness(*height_of(ground), is_height=True))
    return firm


def objects_of(obs: Observations, view: Viewpoint | None) -> Sized:
    """
    Turn the observations of one image into columns.

    Parameters
    ----------
    obs : Observations
        The objects.
    view : Viewpoint or None
        Camera and plane, where they count.

    Returns
    -------
    Sized
        One row each, of image 0, grouped by label.
    """
    alone = view is not None and view.alone
    return _sized(
        inverse_depth=np.full_like(obs.depth, np.nan) if alone else obs.inverse_depth,
        pixels=obs.pixels,
        noise_var=obs.noise_var,
        kinds=obs.kinds,
        prior_log=obs.prior_log,
        prior_var=obs.prior_var,
        tau=obs.tau,
        group=obs.group,
        unknown_noise=obs.unknown_noise,
        stance=stance_of(view, obs.boxes, obs.feet, obs.upright, obs.box_var) if view else None,
    )


def references_of(model: ScaleModel, view: Viewpoint | None) -> ModelColumns:
    """
    Turn the references of a model into the columns that it was fitted to.

    Parameters
    ----------
    model : ScaleModel
        The model.
    view : Viewpoint or None
        Camera and plane, where they count.

    Returns
    -------
    ModelColumns
        Its references, what is known of the camera, and its other objects.
    """
    told = model.camera if model.camera_is_witness else None
    firm = firm_witnesses(told, model.ground, model.scale_rel_std)
    if model.shared:
        keys = shared_keys(model.shared, model.priors)
        witnesses = shared_witnesses(model.shared, keys, model.priors, has_stance=view is not None)
        everyone = _of_references(model.references, model, view) if view else None
        return ModelColumns(with_firm(witnesses, firm), everyone, keys)
    candidates = [ref for ref in model.references if ref.candidate]
    others = [ref for ref in model.references if not ref.candidate]
    ref_keys = [mean_key(ref.prior_label, ref.axis, model.priors) for ref in candidates]
    keys = list(dict.fromkeys(ref_keys))
    witnesses = _of_references(candidates, model, view)._replace(
        group=np.array([keys.index(key) for key in ref_keys], dtype=np.intp)
    )
    bystanders = _of_references(others, model, view) if view else None
    return ModelColumns(with_firm(witnesses, firm), bystanders, keys)


class ModelColumns(NamedTuple):
    """
    The columns of a model.

    Attributes
    ----------
    witnesses : Sized
        One row for each candidate among its references, and what is known of the camera.
    bystanders : Sized or None
        Its other objects, where they tell of a plane or a tilt.
    keys : list
        The mean size that each group shares, in the order of the groups.
    """

    witnesses: Sized
    bystanders: Sized | None
    keys: list[MeanKey | None]


def _of_references(refs: Sequence[Reference], model: ScaleModel, view: Viewpoint | None) -> Sized:
    """Columns of some of a model's references, without their groups."""
    sizes = [size_along(ref.prior_label, ref.axis, model.priors) for ref in refs]
    moments = [(ref.prior_m, ref.prior_std_m, ref.prior_mean_std_m) for ref in refs]
    mean_m, std_m, mean_std_m = np.array(moments, dtype=np.float64).reshape(-1, 3).T
    prior_log, prior_var = log_moments(mean_m, std_m)
    depth = np.array([ref.depth for ref in refs], dtype=np.float64)
    pixels = np.array([ref.pixels for ref in refs], dtype=np.float64)
    alone = view is not None and view.alone
    stance = None
    if view:
        noise = model.noise
        stance = stance_of(
            view,
            np.array([ref.xyxy for ref in refs], dtype=np.float64).reshape(-1, 4),
            np.array([ref.foot_xy for ref in refs], dtype=np.float64).reshape(-1, 2),
            np.array([ref.axis == "height" for ref in refs], dtype=np.bool_),
            extent_rel_std(pixels, noise.box_px, noise.box_rel) ** 2,
        )
    return _sized(
        inverse_depth=depth * np.nan if alone else LAWS[model.kind].inverse_depth(depth),
        pixels=pixels,
        noise_var=np.array([ref.noise_rel for ref in refs], dtype=np.float64) ** 2,
        kinds=columns_of(sizes, np.arange(len(sizes))).kinds,
        prior_log=prior_log,
        prior_var=prior_var,
        tau=mean_std_m / mean_m,
        group=np.full(depth.size, -1, dtype=np.intp),
        unknown_noise=model.unknown_noise,
        stance=stance,
    )


def in_groups(
    subjects: Sized,
    detections: Sequence[Detection],
    obs: Observations,
    keys: Sequence[MeanKey | None],
    priors: PriorTable,
) -> Sized:
    """
    Give objects the group numbers of a model's references.

    Parameters
    ----------
    subjects : Sized
        The objects.
    detections : sequence of Detection
        The same objects.
    obs : Observations
        Their observations.
    keys : sequence
        The mean size that each group shares.
    priors : PriorTable
        Sizes by label.

    Returns
    -------
    Sized
        With -1 where no reference shares the label.
    """
    numbers = {key: number for number, key in enumerate(keys)}
    groups = [
        numbers.get(mean_key_of(detection, axis, priors), -1)
        for detection, axis in zip(detections, obs.axis, strict=True)
    ]
    return subjects._replace(group=np.array(groups, dtype=np.intp))


def chosen(objects: Sized, rows: IntArray) -> Sized:
    """
    Select rows and number their groups without gaps.

    Parameters
    ----------
    objects : Sized
        Objects with priors.
    rows : (N,) ndarray of int
        Which of them.

    Returns
    -------
    Sized
        The rows.
    """
    if rows.size == objects.image.size:
        return objects  # whose groups were numbered so
    picked = objects.rows(rows)
    group = picked.group.tolist()
    numbers = {old: new for new, old in enumerate(sorted(set(group)))}
    return picked._replace(group=np.array([numbers[old] for old in group], dtype=np.intp))


def shared_witnesses(
    shared: SharedScale, keys: Sequence[MeanKey | None], priors: PriorTable, *, has_stance: bool
) -> Sized:
    """
    Turn what the frames of one camera say together into columns.

    Parameters
    ----------
    shared : SharedScale
        What they say.
    keys : sequence
        The mean size that each group shares.
    priors : PriorTable
        Sizes by label.
    has_stance : bool
        True where a plane or a tilt counts.

    Returns
    -------
    Sized
        One firm row for each of the frame's own references, and for each label of the others.
    """
    rows = [*shared.own, *shared.others]
    group = [keys.index(mean_key(row.label, row.axis, priors)) for row in rows]
    variance = np.array([1 / max(row.precision, _LEAST_PRECISION) for row in rows])
    log_k = np.array([row.log_k for row in rows])
    sizes = [size_along(row.label, row.axis, priors) for row in rows]
    count, ones = len(rows), np.ones((len(rows), 1))
    lean = np.array([row.lean for row in rows], dtype=np.float64).reshape(-1, 2)
    return Sized(
        inverse_depth=np.ones(count),
        log_pixels=np.zeros(count),
        noise_var=np.zeros(count),
        prior=Parts(ones, log_k[:, None], variance[:, None]),
        prior_log=log_k,
        prior_var=variance,
        tau=np.array([size.tau for size in sizes], dtype=np.float64),
        image=np.zeros(count, dtype=np.intp),
        group=np.array(group, dtype=np.intp),
        told=np.ones(count, dtype=np.bool_),
        firm=np.ones(count, dtype=np.bool_),
        stance=Stance.nowhere(count, lean=lean) if has_stance else None,
    )


def shared_keys(shared: SharedScale, priors: PriorTable) -> list[MeanKey | None]:
    """
    List the labels of a shared scale.

    Parameters
    ----------
    shared : SharedScale
        What the frames of one camera say together.
    priors : PriorTable
        Sizes by label.

    Returns
    -------
    list
        The mean size that each group shares.
    """
    rows = [*shared.own, *shared.others]
    return list(dict.fromkeys(mean_key(row.label, row.axis, priors) for row in rows))


def bystanders_of(objects: Sized, witnesses: IntArray) -> Sized:
    """
    Select the objects that only tell of the plane.

    Parameters
    ----------
    objects : Sized
        All objects.
    witnesses : (N,) ndarray of int
        The references among them.

    Returns
    -------
    Sized
        The others, of no group.
    """
    is_other = np.ones(objects.image.size, dtype=np.bool_)
    is_other[witnesses] = False
    others = objects._replace(group=np.full_like(objects.group, -1))
    return others.rows(is_other)


def with_firm(witnesses: Sized, firm: Sequence[FirmWitness]) -> Sized:
    """
    Add what is known of the camera to the references of one image.

    Parameters
    ----------
    witnesses : Sized
        The references, none or more.
    firm : sequence of FirmWitness
        What is known.

    Returns
    -------
    Sized
        One more row for each, at the end, which is firm.
    """
    for told in firm:
        share = np.zeros((1, witnesses.prior.share.shape[1]))
        share[0, 0] = 1.0
        mean, variance = np.full_like(share, told.log_value), np.full_like(share, told.variance)
        row = Sized(
            inverse_depth=np.ones(1),
            log_pixels=np.zeros(1),
            noise_var=np.zeros(1),
            prior=Parts(share, mean, variance),
            prior_log=np.array([told.log_value]),
            prior_var=np.array([told.variance]),
            tau=np.zeros(1),
            image=np.zeros(1, dtype=np.intp),
            group=np.array([witnesses.group.max(initial=-1) + 1], dtype=np.intp),
            told=np.ones(1, dtype=np.bool_),
            firm=np.ones(1, dtype=np.bool_),
            stance=witnesses.stance and Stance.nowhere(1, is_height=told.is_height),
        )
        witnesses = witnesses.joined(row)
    return witnesses


def _sized(
    *,
    inverse_depth: FloatArray,
    pixels: FloatArray,
    noise_var: FloatArray,
    kinds: Parts,
    prior_log: FloatArray,
    prior_var: FloatArray,
    tau: FloatArray,
    group: IntArray,
    unknown_noise: bool,
    stance: Stance | None,
) -> Sized:
    """Columns of one image."""
    return Sized(
        inverse_depth=inverse_depth,
        log_pixels=np.log(pixels),
        noise_var=noise_var,
        prior=kinds,
        prior_log=prior_log,
        prior_var=prior_var,
        tau=tau,
        image=np.zeros(group.size, dtype=np.intp),
        group=group,
        told=np.full(group.size, not unknown_noise),
        firm=np.zeros(group.size, dtype=np.bool_),
        stance=stance,
    )


def without_focal(witnesses: Sized, *, has_plane: bool) -> Sized:
    """
    Take the word from a focal length.

    Parameters
    ----------
    witnesses : Sized
        References and what is known of the camera, as `with_firm` joined them.
    has_plane : bool
        True where the camera's height comes last, after its focal length.

    Returns
    -------
    Sized
        The same with a focal length that tells nothing.
    """
    row = witnesses.image.size - 1 - has_plane
    variance, kinds = witnesses.prior_var.copy(), witnesses.prior.variance.copy()
    variance[row] = kinds[row] = _NOTHING_VAR
    return witnesses._replace(prior_var=variance, prior=witnesses.prior._replace(variance=kinds))
