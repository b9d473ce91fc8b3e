"""From detections to the solver's columns: what one image, or one model, gives the core."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from imgscale._typing import FloatArray, IntArray
from imgscale.camera import Camera
from imgscale.core.segments import Parts
from imgscale.core.witnesses import Sized
from imgscale.detection import Detection
from imgscale.laws import LAWS
from imgscale.model import ScaleModel
from imgscale.observations import Observations
from imgscale.prior_choice import MeanKey, log_kinds, log_moments, mean_key, rows_along
from imgscale.priors import PriorTable


class CameraWitness(NamedTuple):
    """
    What a camera says of log k: with metric depth, k = 1 / f.

    Attributes
    ----------
    log_k, variance : float
        Log of 1 / focal length and its variance, the map's scale error included.
    """

    log_k: float
    variance: float


def camera_witness(camera: Camera, scale_rel_std: float) -> CameraWitness:
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
    CameraWitness
        What it says.
    """
    variance = camera.focal_rel_std**2 + scale_rel_std**2
    return CameraWitness(-float(np.log(camera.focal_px)), variance)


def objects_of(obs: Observations) -> Sized:
    """
    Turn the observations of one image into columns.

    Parameters
    ----------
    obs : Observations
        The objects.

    Returns
    -------
    Sized
        One row each, of image 0, grouped by label.
    """
    return _sized(
        inverse_depth=obs.inverse_depth,
        pixels=obs.pixels,
        noise_var=obs.noise_var,
        kinds=obs.kinds,
        moments=np.stack([obs.prior_m, obs.prior_std_m, obs.prior_mean_std_m]),
        group=obs.group,
        unknown_noise=obs.unknown_noise,
    )


def references_of(model: ScaleModel) -> tuple[Sized, list[MeanKey | None]]:
    """
    Turn the references of a model into the columns that it was fitted to.

    Parameters
    ----------
    model : ScaleModel
        The model.

    Returns
    -------
    witnesses : Sized
        One row for each candidate among its references, and the camera's.
    keys : list
        The mean size that each group shares, in the order of the groups.
    """
    refs = [ref for ref in model.references if ref.candidate]
    ref_keys = [mean_key(ref.label, ref.axis, model.priors) for ref in refs]
    keys = list(dict.fromkeys(ref_keys))
    rows = [rows_along(ref.label, ref.axis, model.priors) for ref in refs]
    moments = [(ref.prior_m, ref.prior_std_m, ref.prior_mean_std_m) for ref in refs]
    depth = np.array([ref.depth for ref in refs], dtype=np.float64)
    witnesses = _sized(
        inverse_depth=LAWS[model.kind].inverse_depth(depth),
        pixels=np.array([ref.pixels for ref in refs], dtype=np.float64),
        noise_var=np.array([ref.noise_rel for ref in refs], dtype=np.float64) ** 2,
        kinds=log_kinds(rows),
        moments=np.array(moments, dtype=np.float64).reshape(-1, 3).T,
        group=np.array([keys.index(key) for key in ref_keys], dtype=np.intp),
        unknown_noise=model.depth_rel is not None,
    )
    if model.camera_is_witness and model.camera:
        witnesses = with_camera(witnesses, camera_witness(model.camera, model.scale_rel_std))
    return witnesses, keys


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
        numbers.get(mean_key(detection.label, axis, priors), -1)
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
    picked = objects.rows(rows)
    return picked._replace(group=np.unique(picked.group, return_inverse=True)[1].astype(np.intp))


def with_camera(witnesses: Sized, camera: CameraWitness) -> Sized:
    """
    Add a camera to the references of one image.

    Parameters
    ----------
    witnesses : Sized
        The references, none or more.
    camera : CameraWitness
        What the camera says.

    Returns
    -------
    Sized
        One more row, the last, which is firm.
    """
    share = np.zeros((1, witnesses.prior.share.shape[1]))
    share[0, 0] = 1.0
    row = Sized(
        inverse_depth=np.ones(1),
        log_pixels=np.zeros(1),
        noise_var=np.zeros(1),
        prior=Parts(share, np.full_like(share, camera.log_k), np.full_like(share, camera.variance)),
        prior_log=np.array([camera.log_k]),
        prior_var=np.array([camera.variance]),
        tau=np.zeros(1),
        image=np.zeros(1, dtype=np.intp),
        group=np.array([witnesses.group.max(initial=-1) + 1], dtype=np.intp),
        told=np.ones(1, dtype=np.bool_),
        firm=np.ones(1, dtype=np.bool_),
    )
    joined: list[Any] = [
        Parts(*(np.concatenate(pair) for pair in zip(column, more, strict=True)))
        if isinstance(column, Parts)
        else np.concatenate([column, more])
        for column, more in zip(list[Any](witnesses), list[Any](row), strict=True)
    ]
    return Sized(*joined)


def _sized(
    *,
    inverse_depth: FloatArray,
    pixels: FloatArray,
    noise_var: FloatArray,
    kinds: Parts,
    moments: FloatArray,
    group: IntArray,
    unknown_noise: bool,
) -> Sized:
    """Columns of one image."""
    mean_m, std_m, mean_std_m = moments
    prior_log, prior_var = log_moments(mean_m, std_m)
    return Sized(
        inverse_depth=inverse_depth,
        log_pixels=np.log(pixels),
        noise_var=noise_var,
        prior=kinds,
        prior_log=prior_log,
        prior_var=prior_var,
        tau=mean_std_m / mean_m,
        image=np.zeros(group.size, dtype=np.intp),
        group=group,
        told=np.full(group.size, not unknown_noise),
        firm=np.zeros(group.size, dtype=np.bool_),
    )
