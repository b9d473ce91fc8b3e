"""The verb `fit`: from the known objects of one image to its scale constant."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, TypedDict, get_args

import numpy as np

from imgscale._checks import check_choice, check_type
from imgscale._typing import DepthKind, FitMethod, ImageSize, IntArray
from imgscale.camera import Camera
from imgscale.closed_form import least_squares, mean_ratio
from imgscale.depth import Depth, DepthMap, GroundPlane, ObjectDepths
from imgscale.detection import Detection, check_detections
from imgscale.errors import FitError
from imgscale.estimator import MIN_VARIANCE, LogFit, LogObservations, fit_robust, log_k_std
from imgscale.flags import Flag, flags_where
from imgscale.laws import LAWS, PLAUSIBLE_FOCAL
from imgscale.model import ScaleModel
from imgscale.noise import Noise
from imgscale.observations import (
    NO_DEPTH,
    NO_PRIOR,
    PARTIAL,
    Observations,
    observe,
    usable_depth,
    with_image_size,
)
from imgscale.priors import PriorTable
from imgscale.reference import OUTLIER, Reference, numbered_labels
from imgscale.referencing import explain_references

__all__ = ["fit"]

METHODS: tuple[FitMethod, ...] = get_args(FitMethod)
# References whose mean square residual is this much above their errors' are reported.
_INCONSISTENT_SCATTER = 4.0
_CONFLICT_Z = 3.0
_LARGEST_PHOTO_PX = 20_000.0


def fit(
    detections: Sequence[Detection],
    depth: Depth,
    priors: PriorTable | None = None,
    *,
    ground: GroundPlane | None = None,
    camera: Camera | None = None,
    method: FitMethod = "robust",
    noise: Noise = Noise(),  # noqa: B008 - frozen
) -> ScaleModel:
    """
    Find the scale constant k of one image from objects of roughly known size.

    Parameters
    ----------
    detections : sequence of Detection
        The objects in the image, known and unknown ones.
    depth : DepthMap or ObjectDepths
        Their depth, of kind "metric", "relative" or "inverse".
    priors : PriorTable, optional
        Sizes by label; the shipped table, ``PriorTable.default()``, where omitted.
    ground : GroundPlane, optional
        Not supported in this version.
    camera : Camera, optional
        With metric depth, ``method="robust"`` takes its focal length as one more witness of k.
        For every kind it gives distances. Its pitch must be 0 in this version.
    method : str
        "robust" weighs references by their errors and rejects outliers. "mean_ratio" (the mean of
        the objects' own k) and "least_squares" (of H on d p, through the origin) are the paper's;
        they reject nothing that has a prior and a depth and is not partial.
    noise : Noise
        Errors of boxes and depths.

    Returns
    -------
    ScaleModel
        The model, with one `Reference` for every detection.

    Raises
    ------
    FitError
        If no detection can be a reference and no camera fixes k.
    ValueError
        If an argument breaks its law.
    TypeError
        If an argument is of the wrong type.

    Notes
    -----
    Height per pixel = k * depth; k is 1 / focal length for metric depth and the stereo baseline
    in metres for raw disparity. The robust method solves ``log H_i = log k + log(d_i p_i) +
    noise`` with one shared deviation per label integrated out.

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


class Setting(NamedTuple):
    """
    What a model keeps of the call that made it; the fields are those of `ScaleModel`.

    Attributes
    ----------
    kind, method, priors, noise, camera, image_size, fingerprint, scale_rel_std : object
        As in `ScaleModel`.
    """

    kind: DepthKind
    method: FitMethod
    priors: PriorTable
    noise: Noise
    camera: Camera | None
    image_size: ImageSize | None
    fingerprint: int | None
    scale_rel_std: float


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
    method: FitMethod = "robust",
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
    usable = usable_depth(depth)
    _check_options(usable, priors, ground, camera, method, noise)
    usable = with_image_size(usable, camera.image_size if camera else None)
    table = PriorTable.default() if priors is None else priors
    setting = Setting(
        kind=usable.kind,
        method=method,
        priors=table,
        noise=noise,
        camera=camera,
        image_size=usable.image_size,
        fingerprint=usable.fingerprint if isinstance(usable, DepthMap) else None,
        scale_rel_std=usable.scale_rel_std if isinstance(usable, DepthMap) else 0.0,
    )
    return observe(detections, usable, table, noise), setting


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
        If there is no reference and no camera to fix k.
    """
    rows = obs.eligible
    witness = _camera_witness(setting)
    log_obs = _log_observations(obs, rows, witness)
    if not log_obs.y.size:
        raise FitError(_no_reference(detections, obs))
    if setting.method == "robust":
        solution = fit_robust(log_obs)
    else:
        solution = _fit_closed_form(obs, rows, log_obs, setting.method)
    log_k = float(solution.log_k[0])
    references = explain_references(detections, obs, log_obs, solution)
    return ScaleModel(
        k=math.exp(log_k),
        k_std=math.exp(log_k) * float(solution.log_std[0]),
        shift=0.0,
        shift_std=0.0,
        mean_depth=_mean_depth(references, setting.kind),
        references=references,
        flags=_flags(references, obs, log_obs, solution, setting),
        camera_precision=float(solution.weight[-1]) if witness else 0.0,
        **setting._asdict(),
    )


def _check_options(
    depth: DepthMap | ObjectDepths,
    priors: PriorTable | None,
    ground: GroundPlane | None,
    camera: Camera | None,
    method: str,
    noise: Noise,
) -> None:
    """Raise where an option breaks its law."""
    check_choice("method", method, METHODS)
    if priors is not None:
        check_type("priors", priors, PriorTable, " Wrap rows as PriorTable([...]).")
    if camera is not None:
        check_type("camera", camera, Camera)
    check_type("noise", noise, Noise)
    if ground is not None:
        msg = "`ground` must be None in this version; a second witness is not fitted yet."
        raise ValueError(msg)
    if camera is not None:
        camera.check_image_size(depth.image_size)
        if camera.pitch_deg or camera.pitch_std_deg:
            msg = (
                f"`camera.pitch_deg` must be 0 in this version; got {camera.pitch_deg} +- "
                f"{camera.pitch_std_deg}. Tilted cameras are not corrected yet."
            )
            raise ValueError(msg)


def _camera_witness(setting: Setting) -> tuple[float, float] | None:
    """Let the camera be a witness where it is one: of k with metric depth, for the robust fit."""
    if setting.camera is None or setting.kind != "metric" or setting.method != "robust":
        return None
    return _camera_says(setting.camera, setting.scale_rel_std)


def _camera_says(camera: Camera, scale_rel_std: float) -> tuple[float, float]:
    """Give log k and its variance by the focal length: with metric depth, k = 1 / f."""
    return -math.log(camera.focal_px), camera.focal_rel_std**2 + scale_rel_std**2


def _log_observations(
    obs: Observations, rows: IntArray, witness: tuple[float, float] | None
) -> LogObservations:
    """Columns of the solver: the references of one image and, last, the camera."""
    y = obs.prior_log[rows] - obs.log_size[rows]
    variance = obs.prior_var[rows] + obs.noise_var[rows]
    tau, group = obs.tau[rows], obs.group[rows]
    firm = np.zeros(y.size, dtype=np.bool_)
    if witness:
        y, variance = np.append(y, witness[0]), np.append(variance, witness[1])
        tau, group = np.append(tau, 0.0), np.append(group, group.max(initial=-1) + 1)
        firm = np.append(firm, np.True_)
    return LogObservations(
        y=y,
        variance=np.maximum(variance, MIN_VARIANCE),
        tau=tau,
        image=np.zeros(y.size, dtype=np.intp),
        group=group,
        firm=firm,
    )


def _fit_closed_form(
    obs: Observations, rows: IntArray, log_obs: LogObservations, method: FitMethod
) -> LogFit:
    """Apply the paper's estimators; their error is the declared one or, where more, the scatter."""
    estimate = mean_ratio if method == "mean_ratio" else least_squares
    k, share = estimate(np.exp(obs.log_size[rows]), obs.prior_m[rows])
    own_k = np.log(obs.prior_m[rows]) - obs.log_size[rows]
    chi2 = float(np.sum(((own_k - math.log(k)) / log_obs.total_std) ** 2))
    scatter = max(1.0, chi2 / max(1, rows.size - 1))
    return LogFit(
        log_k=np.array([math.log(k)]),
        log_std=math.sqrt(scatter) * log_k_std(log_obs, share),
        inconsistent=np.array([scatter > _INCONSISTENT_SCATTER]),
        trust=np.ones_like(share),
        weight=1 / log_obs.variance,
        share=share,
    )


def _mean_depth(references: Sequence[Reference], kind: DepthKind) -> float:
    """Mean of the used references' depths, averaged as distances (the paper's fig. 3.17)."""
    depths = np.array([ref.depth for ref in references if ref.used])
    if not depths.size:
        return math.nan
    return LAWS[kind].value_at(float(LAWS[kind].relative_distance(depths).mean()))


def _flags(
    references: Sequence[Reference],
    obs: Observations,
    log_obs: LogObservations,
    solution: LogFit,
    setting: Setting,
) -> Flag:
    """Collect the model's reservations."""
    used = [index for index, ref in enumerate(references) if ref.used]
    labels = {int(obs.group[index]) for index in used}
    has_camera = bool(log_obs.firm.any())
    return flags_where(
        {
            Flag.SINGLE_REFERENCE: len(used) == 1 and not has_camera,
            Flag.SINGLE_LABEL: len(used) > 1 and len(labels) == 1 and not has_camera,
            Flag.OUTLIERS: any(ref.reason == OUTLIER for ref in references),
            Flag.INCONSISTENT: bool(solution.inconsistent[0]),
            Flag.CAMERA_CONFLICT: _camera_conflicts(obs, solution, setting),
            Flag.IMPLAUSIBLE_FOCAL: _implausible_focal(references, solution, setting),
            Flag.MIXED_DEPTH: any(bool(obs.mixed[index]) for index in used),
        }
    )


def _camera_conflicts(obs: Observations, solution: LogFit, setting: Setting) -> bool:
    """Compare the camera with what all references of metric depth say together without it."""
    if setting.camera is None or setting.kind != "metric" or not obs.eligible.size:
        return False
    if setting.method == "robust":
        solution = fit_robust(_log_observations(obs, obs.eligible, None))
    camera_y, camera_var = _camera_says(setting.camera, setting.scale_rel_std)
    error = math.hypot(math.sqrt(camera_var), float(solution.log_std[0]))
    return abs(camera_y - float(solution.log_k[0])) > _CONFLICT_Z * error


def _implausible_focal(references: Sequence[Reference], solution: LogFit, setting: Setting) -> bool:
    """Tell whether the implied or the given focal length belongs to no camera that takes photos."""
    if setting.image_size:
        smallest = largest = float(max(setting.image_size))
    else:  # somewhere between the boxes and the largest photos
        smallest = max((max(ref.xyxy) for ref in references), default=0.0)
        largest = max(smallest, _LARGEST_PHOTO_PX)
    low, high = PLAUSIBLE_FOCAL[0] * smallest, PLAUSIBLE_FOCAL[1] * largest
    # a camera's may be that of a telephoto or a crop, but never as short as its millimetres
    too_short = setting.camera is not None and setting.camera.focal_px < low
    implied = math.exp(-float(solution.log_k[0]))
    return too_short or (setting.kind == "metric" and not low <= implied <= high)


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
    }
    given = "".join(f" {text}" for reason, text in remedies.items() if reason in obs.reason)
    return (
        "`detections` must hold at least one reference: an object with a prior and a depth, in "
        f"full view; got {', '.join(seen[:5]) or 'no detection'}{more}.{given}"
    )
