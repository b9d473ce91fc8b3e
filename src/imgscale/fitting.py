"""The verb `fit`: from the known objects of one image to its scale constant."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypedDict, get_args

import numpy as np

from imgscale._checks import check_choice, check_type
from imgscale._typing import DepthKind, FitMethod
from imgscale.camera import Camera
from imgscale.core.predictive import scale_of
from imgscale.core.solving import Estimate, PlaneEstimate, Problem, estimate
from imgscale.depth import Depth, DepthMap, GroundPlane, check_depth_type
from imgscale.detection import Detection, check_detections
from imgscale.fitted_plane import FittedPlane
from imgscale.laws import LAWS
from imgscale.model import ScaleModel
from imgscale.noise import Noise
from imgscale.object_depth import with_image_size
from imgscale.observations import Observations, observe
from imgscale.posing import Setting, pose, solve_by, view_of
from imgscale.priors import PriorTable
from imgscale.reference import Reference
from imgscale.referencing import Belief, explain_references
from imgscale.reservations import reservations
from imgscale.shared_scale import SharedScale

__all__ = ["fit"]

METHODS: tuple[FitMethod, ...] = get_args(FitMethod)


def fit(
    detections: Sequence[Detection],
    depth: Depth,
    priors: PriorTable | None = None,
    *,
    ground: GroundPlane | None = None,
    camera: Camera | None = None,
    method: FitMethod = "posterior",
    noise: Noise = Noise(),  # noqa: B008 - frozen
) -> ScaleModel:
    """
    Find the scale constant k of one image from objects of roughly known size.

    Parameters
    ----------
    detections : sequence of Detection
        The objects in the image, known and unknown ones.
    depth : DepthMap, ObjectDepths or GroundPlane
        Their depth, of any kind. A `GroundPlane` says that there is none: all stand on one plane,
        and the row of its foot tells the distance of each.
    priors : PriorTable, optional
        Sizes by label; the shipped table, ``PriorTable.default()``, where omitted.
    ground : GroundPlane, optional
        A second witness of distance beside the depth: where objects stand. The plane is fitted
        too; objects that are off it fall back to their depth ("posterior", "robust").
    camera : Camera, optional
        With metric depth, its focal length is one more witness of k ("posterior", "robust").
        For every kind it gives distances, and its pitch, told or inferred from the horizon,
        corrects the pixels of upright objects.
    method : str
        "posterior" is exact: the probability of every k, with references of which some are wrong
        and labels that stand for several things. "robust" is the fast one: it weighs references by
        their errors and rejects outliers; right in the median, but of few references of which one
        is wrong its interval says too little. "mean_ratio" (the mean of the objects' own k) and
        "least_squares" (of H on d p, through the origin) are the paper's; they reject nothing that
        has a prior and a depth and is not partial.
    noise : Noise
        Errors of boxes and depths.

    Returns
    -------
    ScaleModel
        The model, with one `Reference` for every detection.

    Raises
    ------
    FitError
        If no detection can be a reference and no camera fixes k, or if a shift is to be fitted to
        references all at one depth.
    ValueError
        If an argument breaks its law.
    TypeError
        If an argument is of the wrong type.

    Notes
    -----
    Height per pixel = k * depth; k is 1 / focal length for metric depth and the stereo baseline
    in metres for raw disparity. The solvers take ``log H_i = log k + log(d_i p_i) + noise`` with
    one shared deviation per label; "posterior" takes one reference in twenty to be wrong (cut,
    hidden, mislabelled). Where `noise` does not tell the depths' error, it is log-normal about 5 %
    within a factor of 2.2, learned from the residuals and averaged over. For "affine_inverse" depth
    k and the shift b are fitted together, ``d = 1 / (D + b)``, with a prior on b about 0 as wide as
    the values are large. On a ground plane ``d = 1 / (y - y0 - r x)``, k is the camera's height and
    horizon y0 and slope r are fitted with it, with priors that suit photos at large: the horizon
    within some degrees of the middle, the height 1.7 m within a factor of 2, the slope 2 degrees.

    References
    ----------
    .. [1] S. Singh and R. S. Shrivastava, "Determining Image Scale in Real-World Units Using
       Natural Objects Present in Image", EasyChair preprint, 2023.

    Examples
    --------
    >>> import imgscale as ims
    >>> detections = [ims.Detection("door", (100, 50, 180, 250)),
    ...               ims.Detection("statue", (300, 80, 400, 230))]
    >>> depth = ims.ObjectDepths([4.0, 4.0], kind="relative", rel_std=0.01)
    >>> model = ims.fit(detections, depth, ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.02)]))
    >>> print(model)
    k = 0.00250 +- 0.00004 m per px and depth unit (depth unit / focal length) from 1 of 1
    reference; without a prior: statue
    >>> ims.fit(detections[1:], ims.ObjectDepths([4.0], kind="relative"))
    Traceback (most recent call last):
        ...
    imgscale.errors.FitError: `detections` must hold at least one reference: an object with a
    prior and a depth, in full view; got statue (no prior). Add sizes with
    PriorTable.default().with_prior(ObjectPrior(label, mean_m, std_m)).
    """
    detections = check_detections(detections)
    obs, setting = observe_references(
        detections, depth, priors, ground=ground, camera=camera, method=method, noise=noise
    )
    return fit_observed(detections, obs, setting)


class FitOptions(TypedDict, total=False):
    """The keyword arguments of `fit`, for functions that pass them on."""

    ground: GroundPlane | None
    camera: Camera | None
    method: FitMethod
    noise: Noise


def observe_references(
    detections: Sequence[Detection],
    depth: Depth,
    priors: PriorTable | None = None,
    *,
    ground: GroundPlane | None = None,
    camera: Camera | None = None,
    method: FitMethod = "posterior",
    noise: Noise = Noise(),  # noqa: B008 - frozen
) -> tuple[Observations, Setting]:
    """
    Check the arguments of `fit` and turn them into columns.

    Parameters
    ----------
    detections : sequence of Detection
        As for `fit`.
    depth : DepthMap or ObjectDepths
        As for `fit`.
    priors : PriorTable, optional
        As for `fit`.
    ground : GroundPlane, optional
        As for `fit`.
    camera : Camera, optional
        As for `fit`.
    method : str
        As for `fit`.
    noise : Noise
        As for `fit`.

    Returns
    -------
    obs : Observations
        One row per detection.
    setting : Setting
        What the model keeps.

    Raises
    ------
    ValueError
        If an argument breaks its law.
    TypeError
        If an argument is of the wrong type.
    """
    usable = check_depth_type(depth)
    check_options(priors, ground, camera, method, noise)
    _check_together(usable, ground, camera, method)
    for other in (camera, ground):
        usable = with_image_size(usable, other.image_size if other else None)
    table = PriorTable.default() if priors is None else priors
    setting = Setting(
        kind=usable.kind,
        method=method,
        priors=table,
        noise=noise,
        camera=camera,
        ground=usable if isinstance(usable, GroundPlane) else ground,
        image_size=usable.image_size,
        fingerprint=usable.fingerprint if isinstance(usable, DepthMap) else None,
        scale_rel_std=usable.scale_rel_std if isinstance(usable, DepthMap) else 0.0,
    )
    view_of(setting)  # a tilt without a principal point is refused before anything is read
    return observe(detections, usable, table, noise, ground=setting.ground), setting


def fit_observed(
    detections: Sequence[Detection], obs: Observations, setting: Setting
) -> ScaleModel:
    """
    Fit k to the rows of `obs` that have no reason against them.

    Parameters
    ----------
    detections : sequence of Detection
        The objects, for their labels and boxes.
    obs : Observations
        Their columns.
    setting : Setting
        The options of the fit.

    Returns
    -------
    ScaleModel
        The model.

    Raises
    ------
    FitError
        If the references do not fix the scale.
    """
    posed = pose(detections, obs, setting)
    cases = solve_by(setting.method, posed.problem)
    found = estimate(posed.problem, cases)
    log_k = float(found.log_k[0])
    references = explain_references(
        detections, obs, setting.priors, posed, cases, found, _belief(setting.shared)
    )
    plane = _plane(found.plane, setting)
    shift = _shift(found, plane, setting.kind)
    return ScaleModel(
        k=math.exp(log_k),
        k_std=math.exp(log_k) * float(scale_of(cases).half_width()[0]),
        **shift,
        plane=plane,
        mean_depth=_mean_depth(references, setting.kind, shift["shift"]),
        references=references,
        flags=reservations(detections, references, obs, found, setting),
        depth_rel=_depth_rel(found, posed.problem, setting),
        **setting.kept(),
    )


def _depth_rel(found: Estimate, problem: Problem, setting: Setting) -> float | None:
    """Report the noise that was learned: from this image, or from all frames of its source."""
    if problem.unknown_noise:
        return float(found.depth_rel[0])
    return setting.depth_rel


def _belief(shared: SharedScale | None) -> Belief | None:
    """Look up how many frames took the references, if they did."""
    if shared is None:
        return None
    return Belief(
        trust=np.array([row.trust for row in shared.own], dtype=np.float64),
        kind=np.array([row.kind for row in shared.own], dtype=np.intp),
        probability=np.array([row.kind_probability for row in shared.own], dtype=np.float64),
    )


class _Shift(TypedDict):
    """The shift of the inverse depth, as a model carries it."""

    shift: float
    shift_std: float
    correlation: float


def _shift(found: Estimate, plane: FittedPlane | None, kind: DepthKind) -> _Shift:
    """Report the shift; that of a ground plane's rows is minus the horizon."""
    if kind == "ground_plane" and plane and found.plane:
        return {
            "shift": -plane.horizon_px,
            "shift_std": plane.horizon_std_px,
            "correlation": -float(found.plane.correlation[0]),
        }
    return {
        "shift": float(found.shift[0]),
        "shift_std": float(found.shift_std[0]),
        "correlation": float(found.correlation[0]),
    }


def _plane(found: PlaneEstimate | None, setting: Setting) -> FittedPlane | None:
    """Report the plane in pixels of the image, metres and degrees."""
    view = view_of(setting) if found else None
    if found is None or view is None:
        return None
    height_m, slope = math.exp(float(found.log_height[0])), float(found.slope[0])
    # in the middle column, not that of the principal point
    middle = slope * (view.image_size[0] / 2 - view.cx)
    return FittedPlane(
        camera_height_m=height_m,
        camera_height_std_m=height_m * float(found.log_height_std[0]),
        horizon_px=view.cy + float(found.horizon[0]) + middle,
        horizon_std_px=float(found.horizon_std[0]),
        roll_deg=math.degrees(math.atan(slope)),
        roll_std_deg=math.degrees(float(found.slope_std[0]) / (1 + slope**2)),
    )


def check_options(
    priors: PriorTable | None,
    ground: GroundPlane | None,
    camera: Camera | None,
    method: str,
    noise: Noise,
) -> None:
    """
    Raise where an option breaks its law, whatever the picture.

    Parameters
    ----------
    priors : PriorTable or None
        As for `fit`.
    ground : GroundPlane or None
        As for `fit`.
    camera : Camera or None
        As for `fit`.
    method : str
        As for `fit`.
    noise : Noise
        As for `fit`.

    Raises
    ------
    ValueError
        If the method is unknown.
    TypeError
        If an argument is of the wrong type.
    """
    check_choice("method", method, METHODS)
    if priors is not None:
        check_type("priors", priors, PriorTable, " Wrap rows as PriorTable([...]).")
    if camera is not None:
        check_type("camera", camera, Camera)
    check_type("noise", noise, Noise)
    if ground is not None:
        check_type("ground", ground, GroundPlane)


def _check_together(
    depth: Depth, ground: GroundPlane | None, camera: Camera | None, method: str
) -> None:
    """Raise where options do not go together."""
    if ground is not None:
        if isinstance(depth, GroundPlane):
            msg = "`ground` must be None where `depth` is the GroundPlane itself; got both."
            raise ValueError(msg)
        if depth.image_size and depth.image_size != ground.image_size:
            msg = (
                f"`ground.image_size` must be that of the depth, {depth.image_size}; got "
                f"{ground.image_size}. Both belong to one image."
            )
            raise ValueError(msg)
        if method in {"mean_ratio", "least_squares"}:
            msg = (
                f'`ground` must be None for method "{method}"; only "posterior" and "robust" fit a '
                "plane."
            )
            raise ValueError(msg)
    if LAWS[depth.kind].has_shift and method in {"mean_ratio", "least_squares"}:
        msg = (
            f'`method` must be "posterior" or "robust" for depth of kind "{depth.kind}", whose '
            f'shift is unknown; got "{method}".'
        )
        raise ValueError(msg)
    if camera is not None:
        if camera.is_tilted and method in {"mean_ratio", "least_squares"}:
            msg = (
                f'`camera.pitch_deg` must be 0 for method "{method}"; got {camera.pitch_deg}. Only '
                '"posterior" and "robust" correct a tilt.'
            )
            raise ValueError(msg)
        camera.check_image_size(depth.image_size)
        camera.check_image_size(ground.image_size if ground else None)


def _mean_depth(references: Sequence[Reference], kind: DepthKind, shift: float) -> float:
    """Mean of the used references' depths, averaged as distances (the paper's fig. 3.17)."""
    law = LAWS[kind]
    depths = np.array([ref.depth for ref in references if ref.used], dtype=np.float64)
    with np.errstate(divide="ignore"):
        distances = law.relative_distance(depths, shift).tolist()
    finite = [distance for distance in distances if 0 < distance < math.inf]
    return law.value_at(math.fsum(finite) / len(finite), shift) if finite else math.nan
