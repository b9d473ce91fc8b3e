"""What a fit asks the core: the problem posed by detections, or once more by a model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from imgscale._typing import DepthKind, FitMethod, FloatArray, ImageSize
from imgscale.camera import Camera
from imgscale.columns import (
    bystanders_of,
    chosen,
    firm_witnesses,
    in_groups,
    objects_of,
    references_of,
    shared_keys,
    shared_witnesses,
    with_firm,
)
from imgscale.core.blocks import REPORT_SCATTER
from imgscale.core.closed_form import least_squares, mean_ratio
from imgscale.core.estimator import log_k_std
from imgscale.core.segments import LogFit
from imgscale.core.sighting import observe_under
from imgscale.core.solving import Cases, Problem, closed_form_cases, solve
from imgscale.core.unknowns import Scene
from imgscale.core.witnesses import Sized, middle_case
from imgscale.depth import GroundPlane
from imgscale.detection import Detection
from imgscale.errors import FitError
from imgscale.laws import LAWS
from imgscale.model import ScaleModel
from imgscale.noise import Noise
from imgscale.observations import NO_DEPTH, NO_PRIOR, OFF_GROUND, PARTIAL, Observations
from imgscale.prior_choice import MeanKey
from imgscale.priors import PriorTable
from imgscale.reference import numbered_labels
from imgscale.shared_scale import SharedScale
from imgscale.standing import Viewpoint, scene_of, viewpoint

# Inverse depths that differ by less, relative to the largest, are rounding of one.
SAME_DEPTH = 1e-9


class Setting(NamedTuple):
    """
    What a model keeps of the call that made it; the fields are those of `ScaleModel`.

    Attributes
    ----------
    kind, method, priors, noise, camera, ground : object
        As in `ScaleModel`.
    image_size, fingerprint, scale_rel_std, shared : object
        As in `ScaleModel`.
    depth_rel : float or None
        Noise of the depths as it was learned over many frames; `noise` then tells it.
    """

    kind: DepthKind
    method: FitMethod
    priors: PriorTable
    noise: Noise
    camera: Camera | None
    ground: GroundPlane | None
    image_size: ImageSize | None
    fingerprint: int | None
    scale_rel_std: float
    shared: SharedScale | None = None
    depth_rel: float | None = None

    def kept(self) -> dict[str, Any]:
        """
        List what the model keeps as it is.

        Returns
        -------
        dict
            By the names of the model's fields.
        """
        kept = self._asdict()
        del kept["depth_rel"]
        return kept


class Posed(NamedTuple):
    """
    Detections as the solver sees them.

    Attributes
    ----------
    objects : Sized
        All of them.
    candidates : Sized
        Those that can be references, as they are by themselves, in the problem's groups.
    problem : Problem
        What is to be solved, of one image.
    """

    objects: Sized
    candidates: Sized
    problem: Problem


def pose(detections: Sequence[Detection], obs: Observations, setting: Setting) -> Posed:
    """
    Turn the rows that have no reason against them into a problem for the solver.

    Parameters
    ----------
    detections : sequence of Detection
        The objects.
    obs : Observations
        Their columns.
    setting : Setting
        The options of the fit.

    Returns
    -------
    Posed
        The problem, and the columns that it is made of.

    Raises
    ------
    FitError
        If the references do not fix the scale.
    """
    view = view_of(setting)
    objects, others = objects_of(obs, view), obs.eligible
    if setting.shared:
        keys = shared_keys(setting.shared, setting.priors)
        candidates = in_groups(objects, detections, obs, keys, setting.priors).rows(others)
        witnesses = shared_witnesses(
            setting.shared, keys, setting.priors, has_stance=view is not None
        )
        others = others[:0]
    else:
        candidates = witnesses = chosen(objects, others)
    height = setting.ground and setting.ground.camera_height_m
    if setting.kind == "affine_inverse":  # feet and depths alone do not tell its shift
        height = None
    if not (witnesses.image.size or camera_counts(setting) or height):
        raise FitError(_no_reference(detections, obs))
    problem = problem_of_columns(
        witnesses,
        setting,
        unknown_noise=obs.unknown_noise,
        bystanders=bystanders_of(objects, others) if view else None,
    )
    return Posed(objects, candidates, problem)


def problem_of(detections: Sequence[Detection], obs: Observations, setting: Setting) -> Problem:
    """
    Pose the problem of a fit, as `pose` does, for those who need nothing else.

    Parameters
    ----------
    detections : sequence of Detection
        The objects.
    obs : Observations
        Their columns.
    setting : Setting
        The options of the fit.

    Returns
    -------
    Problem
        Of one image.

    Raises
    ------
    FitError
        If the references do not fix the scale.
    """
    return pose(detections, obs, setting).problem


def problem_of_columns(
    witnesses: Sized,
    setting: Setting,
    *,
    unknown_noise: bool = False,
    bystanders: Sized | None = None,
) -> Problem:
    """
    Pose a problem of one image by its references and, where there are any, its other objects.

    Parameters
    ----------
    witnesses : Sized
        The references.
    setting : Setting
        The options of the fit.
    unknown_noise : bool
        True where nobody told the noise of the depths.
    bystanders : Sized, optional
        Objects that only tell of the plane.

    Returns
    -------
    Problem
        With what is known of the camera.

    Raises
    ------
    FitError
        If the references do not tell shift and scale apart.
    """
    camera = setting.camera if camera_counts(setting) else None
    has_shift = LAWS[setting.kind].has_shift and setting.kind != "ground_plane"
    if has_shift and setting.ground is None:
        check_separable(witnesses.inverse_depth)
    firm = firm_witnesses(camera, setting.ground, setting.scale_rel_std)
    return Problem(
        witnesses=with_firm(witnesses, firm),
        n_images=1,
        has_shift=has_shift,
        unknown_noise=unknown_noise,
        exact=setting.method == "posterior",
        scene=_scene(view_of(setting), setting.shared),
        bystanders=bystanders,
    )


def _scene(view: Viewpoint | None, shared: SharedScale | None) -> Scene | None:
    """Tell what is known beforehand of the plane, from other frames too."""
    if view is None:
        return None
    scene = scene_of(view)
    if shared and any(shared.plane_precision):
        return scene.joined(shared.horizon, shared.slope, shared.plane_precision)
    return scene


def view_of(source: Setting | ScaleModel) -> Viewpoint | None:
    """
    Gather what counts of camera and plane.

    Parameters
    ----------
    source : Setting or ScaleModel
        What holds them.

    Returns
    -------
    Viewpoint or None
        None where there is neither a plane nor a tilt.
    """
    view = viewpoint(source.kind, source.ground, source.camera, source.image_size, source.noise)
    if view and source.shared:
        return view._replace(jitter_px=source.shared.jitter_px)
    return view


def problem_of_model(model: ScaleModel) -> tuple[Problem, list[MeanKey | None]]:
    """
    Pose the problem that a model solved.

    Parameters
    ----------
    model : ScaleModel
        The model.

    Returns
    -------
    problem : Problem
        Of one image; its rows are the model's candidates in their order and the camera.
    keys : list
        The mean size that each group shares.
    """
    view = view_of(model)
    columns = references_of(model, view)
    problem = Problem(
        witnesses=columns.witnesses,
        n_images=1,
        has_shift=LAWS[model.kind].has_shift and model.kind != "ground_plane",
        unknown_noise=model.unknown_noise,
        exact=model.method == "posterior",
        scene=_scene(view, model.shared),
        bystanders=columns.bystanders,
    )
    return problem, columns.keys


def check_joint(method: str) -> None:
    """
    Raise where a method has no joint fit of k and sizes.

    Parameters
    ----------
    method : str
        The method.

    Raises
    ------
    ValueError
        If it is one of the paper's.
    """
    if method not in {"robust", "posterior"}:
        msg = (
            f'`use_prior` must be False for method "{method}"; only "posterior" and "robust" fit '
            "jointly."
        )
        raise ValueError(msg)


def check_separable(inverse_depth: FloatArray) -> None:
    """
    Raise where references cannot tell the shift of the inverse depth from the scale.

    Parameters
    ----------
    inverse_depth : (N,) ndarray of float
        Inverse depths of the references.

    Raises
    ------
    FitError
        If there are fewer than two different ones.
    """
    spread = float(np.ptp(inverse_depth))
    if spread <= SAME_DEPTH * float(np.abs(inverse_depth).max()):
        msg = (
            "`detections` must hold at least two references at different depths to fit the scale "
            f"and the shift of an inverse depth; got {inverse_depth.size} at "
            f"{float(inverse_depth[0]):g}. Add a reference nearer or farther, or pass depth of "
            'kind "inverse" where its shift is known to be 0.'
        )
        raise FitError(msg)


def camera_counts(setting: Setting) -> bool:
    """
    Tell whether the camera's focal length is a witness of k: with metric depth, for both solvers.

    Parameters
    ----------
    setting : Setting
        The options of the fit.

    Returns
    -------
    bool
        True where it is.
    """
    fitted = setting.method in {"robust", "posterior"}
    return setting.camera is not None and setting.kind == "metric" and fitted


def solve_by(method: FitMethod, problem: Problem) -> Cases:
    """
    Solve a problem of one image by any method.

    Parameters
    ----------
    method : str
        The method.
    problem : Problem
        The problem.

    Returns
    -------
    Cases
        Its solutions.
    """
    if method in {"robust", "posterior"}:
        return solve(problem)
    witnesses = problem.witnesses
    nuisance = middle_case(np.zeros((1, 1)), unknown_noise=problem.unknown_noise)
    log_obs = observe_under(witnesses, nuisance)
    closed_form = mean_ratio if method == "mean_ratio" else least_squares
    log_mean = witnesses.prior_log + witnesses.prior_var / 2
    log_size = witnesses.by_depth(nuisance)[0]
    k, share = closed_form(np.exp(log_size), np.exp(log_mean))
    # its error is the declared one or, where that is more, the scatter
    own_k = log_mean - log_size
    chi2 = float(np.sum(((own_k - math.log(k)) / log_obs.total_std) ** 2))
    scatter = max(1.0, chi2 / max(1, own_k.size - 1))
    fit = LogFit(
        log_k=np.array([math.log(k)]),
        log_std=math.sqrt(scatter) * log_k_std(log_obs, share),
        trust=np.ones_like(share),
        weight=1 / log_obs.variance,
        share=share,
        disagree=np.array([scatter > REPORT_SCATTER**2]),
    )
    return closed_form_cases(witnesses, nuisance, fit)


def _no_reference(detections: Sequence[Detection], obs: Observations) -> str:
    """Say what was seen and what to add."""
    seen = [
        f"{name} ({reason})"
        for name, reason in zip(
            numbered_labels([detection.label for detection in detections]), obs.reason, strict=True
        )
    ]
    more = f" and {len(seen) - 5} more" if len(seen) > 5 else ""
    remedies = {
        NO_PRIOR: "Add sizes with PriorTable.default().with_prior(ObjectPrior(label, mean_m, "
        "std_m)).",
        PARTIAL: "Partial objects show only a part of their size.",
        NO_DEPTH: "Check that the map has valid depth inside the boxes.",
        OFF_GROUND: "On a ground plane only objects that stand on it are references.",
    }
    given = "".join(f" {text}" for reason, text in remedies.items() if reason in obs.reason)
    return (
        "`detections` must hold at least one reference: an object with a prior and a depth, in "
        f"full view; got {', '.join(seen[:5]) or 'no detection'}{more}.{given}"
    )
