"""Where the error of k, and of every size, comes from."""

from __future__ import annotations

import math

import attrs
import numpy as np

from imgscale._checks import nan_as_none
from imgscale._typing import FloatArray, SizeAxis
from imgscale.estimate import SizeEstimate
from imgscale.extent import extent_rel_std
from imgscale.laws import LAWS
from imgscale.model import ScaleModel
from imgscale.prior_choice import MeanKey, log_moments, mean_key, moments_of, rows_along
from imgscale.reference import Reference
from imgscale.shared_scale import SharedScale

__all__ = ["ScaleBudget", "SizeBudget"]

_LEAST_VAR = 1e-12


@attrs.frozen(kw_only=True)
class ScaleBudget:
    """
    What the error of the scale is made of: relative standard errors whose squares add up.

    Attributes
    ----------
    individuals : float
        Spread of individuals about the mean size of their label, relative, >= 0; NaN for a size
        that is not known.
    mean_sizes : float
        Errors of the labels' mean sizes, which their references share.
    boxes : float
        Errors of the references' boxes.
    depths : float
        Errors of the references' depths, told and learned.
    camera : float
        Error of the focal length and of the metric depth's scale; 0 where it was no witness.
    frames : float
        Errors of all references of a shared scale, its own and those of other frames.
    shift : float
        What the unknown shift of an inverse depth adds; on a ground plane the unknown horizon.
    rest : float
        What the errors above do not explain: references that disagree, open alternatives (which
        reference is wrong, which kind of thing it is, how large the noise is).
    """

    individuals: float = attrs.field(eq=nan_as_none)
    mean_sizes: float = attrs.field(eq=nan_as_none)
    boxes: float = attrs.field(eq=nan_as_none)
    depths: float = attrs.field(eq=nan_as_none)
    camera: float = attrs.field(eq=nan_as_none)
    frames: float = attrs.field(eq=nan_as_none)
    shift: float = attrs.field(eq=nan_as_none)
    rest: float = attrs.field(eq=nan_as_none)

    @property
    def rel_std(self) -> float:
        """The relative standard error as a whole: the root of the sum of squares."""
        return math.hypot(*attrs.astuple(self))

    @property
    def shares(self) -> dict[str, float]:
        """Share of each part in the variance, 0 to 1; all 0 where there is no error."""
        total = self.rel_std**2 or 1.0
        return {name: part**2 / total for name, part in attrs.asdict(self).items()}


@attrs.frozen(kw_only=True)
class SizeBudget:
    """
    What the error of one size is made of: relative standard errors whose squares add up.

    Attributes
    ----------
    label : str
        The object's label.
    axis : str
        "height", "width" or "diameter".
    scale : ScaleBudget
        The part of the scale at its place, split up further.
    box : float
        Error of its own box, relative, >= 0; NaN for a size that is not known.
    depth : float
        Error of its own depth.
    rest : float
        What these do not explain: a depth that was replaced by a mean, tails of the distribution.
    """

    label: str
    axis: SizeAxis
    scale: ScaleBudget
    box: float = attrs.field(eq=nan_as_none)
    depth: float = attrs.field(eq=nan_as_none)
    rest: float = attrs.field(eq=nan_as_none)

    @property
    def rel_std(self) -> float:
        """The relative standard error as a whole: the root of the sum of squares."""
        return math.hypot(self.scale.rel_std, self.box, self.depth, self.rest)

    @property
    def shares(self) -> dict[str, float]:
        """Share of "scale", "box", "depth" and "rest" in the variance, 0 to 1."""
        total = self.rel_std**2 or 1.0
        parts = {"scale": self.scale.rel_std, "box": self.box, "depth": self.depth}
        return {name: part**2 / total for name, part in {**parts, "rest": self.rest}.items()}


def scale_budget(model: ScaleModel) -> ScaleBudget:
    """
    Split the variance of log k.

    Parameters
    ----------
    model : ScaleModel
        The model.

    Returns
    -------
    ScaleBudget
        Parts whose squares sum to ``(k_std / k)^2``.

    Notes
    -----
    With the share a_i of each reference in k the declared errors give
    ``sum_i a_i^2 (s_i^2 + box_i^2 + depth_i^2) + sum_c (sum_{i in c} a_i)^2 tau_c^2``. A shift of
    which log k has the correlation r adds r^2 of the variance. Where k is known worse than that,
    the difference is `rest`; where better, all parts are scaled down alike.
    """
    total = (model.k_std / model.k) ** 2
    return _scale_budget([*_declared(model), model.correlation**2 * total], total)


def size_budget(model: ScaleModel, estimate: SizeEstimate) -> SizeBudget:
    """
    Split the variance of one log size.

    Parameters
    ----------
    model : ScaleModel
        The model.
    estimate : SizeEstimate
        The size, by that model.

    Returns
    -------
    SizeBudget
        Parts whose squares sum to ``(std_m / size_m)^2``; all NaN for a size that is not known.
        Where that is more than the errors of scale, box and depth, the difference is `rest`; where
        it is less, as where the object's own prior was used, all parts are scaled down alike.
    """
    total = (estimate.std_m / estimate.size_m) ** 2
    if not math.isfinite(total):
        nan = math.nan
        nothing = ScaleBudget(**dict.fromkeys(attrs.fields_dict(ScaleBudget), nan))
        return SizeBudget(
            label=estimate.label, axis=estimate.axis, scale=nothing, box=nan, depth=nan, rest=nan
        )
    box = _box_var(model, estimate.size_m / estimate.metres_per_pixel)
    depth = _told_depth_var(model, estimate) + learned_var(model)
    of_k, of_shift = _scale_vars_at(model, estimate.depth)
    scale = of_k + of_shift
    (scale, box, depth), rest = _filling([scale, box, depth], total)
    return SizeBudget(
        label=estimate.label,
        axis=estimate.axis,
        scale=_scale_budget([*_declared(model), min(of_shift, scale)], scale),
        box=math.sqrt(box),
        depth=math.sqrt(depth),
        rest=math.sqrt(rest),
    )


def own_variances(model: ScaleModel, ref: Reference) -> FloatArray:
    """
    Split the variance of the log k that one reference gives, but for its label's offset.

    Parameters
    ----------
    model : ScaleModel
        The model.
    ref : Reference
        One of its candidates.

    Returns
    -------
    (3,) ndarray of float64
        Variances of the individual's size, of its box and of its depth. The size is of the kind of
        thing that the reference was taken for.
    """
    rows = rows_along(ref.prior_label, ref.axis, model.priors)
    kind = min(rows, key=lambda row: abs(row.mean_m - ref.taken_as_m), default=None)
    mean_m, std_m = (kind.mean_m, kind.std_m) if kind else (ref.prior_m, ref.prior_std_m)
    size = float(log_moments(mean_m, std_m)[1])
    box = _box_var(model, ref.pixels)
    depth = max(ref.noise_rel**2 - box, 0.0) + learned_var(model)
    return np.array([size, box, depth])


def learned_var(model: ScaleModel) -> float:
    """
    Look up the variance of depths that this image alone told.

    Parameters
    ----------
    model : ScaleModel
        The model.

    Returns
    -------
    float
        0 where it was told, or learned over many frames: it is then in the references' noise.
    """
    return (model.depth_rel or 0.0) ** 2 if model.unknown_noise else 0.0


def _told_depth_var(model: ScaleModel, estimate: SizeEstimate) -> float:
    """Variance of an object's log depth as told, of the detection given to `fit` where it was."""
    for ref in model.references:
        if (ref.label, ref.depth) == (estimate.label, estimate.depth):
            return max(ref.noise_rel**2 - _box_var(model, ref.pixels), 0.0)
    return (model.noise.depth_rel or 0.0) ** 2


def _box_var(model: ScaleModel, pixels: float) -> float:
    """Relative variance of an extent."""
    error = extent_rel_std(np.array([pixels]), model.noise.box_px, model.noise.box_rel)
    return float(error[0]) ** 2


def _declared(model: ScaleModel) -> list[float]:
    """Variances of individuals, mean sizes, boxes, depths, camera and frames, as declared."""
    if model.shared:
        return _shared(model, model.shared)
    refs = [ref for ref in model.references if ref.candidate]
    own = np.zeros(3)
    shared: dict[object, float] = {}
    for ref in refs:
        own += ref.weight**2 * own_variances(model, ref)
        key = mean_key(ref.prior_label, ref.axis, model.priors)
        shared[key] = shared.get(key, 0.0) + ref.weight * ref.prior_mean_std_m / ref.prior_m
    camera = 0.0
    if model.camera_is_witness and model.camera:
        share = max(0.0, 1 - sum(ref.weight for ref in refs))
        camera = share**2 * (model.camera.focal_rel_std**2 + model.scale_rel_std**2)
    size, box, depth = (float(part) for part in own)
    return [size, sum(part**2 for part in shared.values()), box, depth, camera, 0.0]


def _shared(model: ScaleModel, shared: SharedScale) -> list[float]:
    """Variances of mean sizes, camera and all frames' references in log k."""
    weights: dict[MeanKey | None, float] = {}
    for row in (*shared.own, *shared.others):
        key = mean_key(row.label, row.axis, model.priors)
        weights[key] = weights.get(key, 0.0) + row.precision
    taus = {key: _tau(model, key) for key in weights}
    information = {
        key: 1 / (1 / weight + taus[key] ** 2) for key, weight in weights.items() if weight > 0
    }
    camera_var = math.inf
    if model.camera_is_witness and model.camera:
        camera_var = max(model.camera.focal_rel_std**2 + model.scale_rel_std**2, _LEAST_VAR)
    total = (sum(information.values()) + 1 / camera_var) or 1.0
    shares = {key: own / total for key, own in information.items()}
    mean_sizes = sum((share * taus[key]) ** 2 for key, share in shares.items())
    frames = sum(share**2 / weights[key] for key, share in shares.items())
    camera = (1 / camera_var / total) ** 2 * camera_var if math.isfinite(camera_var) else 0.0
    return [0.0, mean_sizes, 0.0, 0.0, camera, frames]


def _tau(model: ScaleModel, key: MeanKey | None) -> float:
    """Relative error of a label's mean size."""
    if key is None:
        return 0.0
    moments = moments_of(rows_along(*key, model.priors), key[1])
    return moments.mean_std_m / moments.mean_m


def _scale_vars_at(model: ScaleModel, depth: float) -> tuple[float, float]:
    """
    Split the relative variance of metres per pixel at a depth: k with the shift known, the shift.

    With d = 1 / (D + b) the variance of log k - d b is (1 - r^2) s_k^2 + (r s_k - d s_b)^2.
    """
    of_k = model.k_std / model.k
    if not LAWS[model.kind].has_shift or math.isnan(depth):
        return of_k**2, 0.0
    of_shift = model.shift_std * float(LAWS[model.kind].relative_distance(depth, model.shift))
    left = (1 - model.correlation**2) * of_k**2
    return left, (model.correlation * of_k - of_shift) ** 2


def _scale_budget(declared: list[float], total: float) -> ScaleBudget:
    """Fit declared variances into the one that was found."""
    parts, rest = _filling(declared, total)
    individuals, mean_sizes, boxes, depths, camera, frames, shift = map(math.sqrt, parts)
    return ScaleBudget(
        individuals=individuals,
        mean_sizes=mean_sizes,
        boxes=boxes,
        depths=depths,
        camera=camera,
        frames=frames,
        shift=shift,
        rest=math.sqrt(rest),
    )


def _filling(parts: list[float], total: float) -> tuple[list[float], float]:
    """Scale variances down to a total, or tell what is left of it."""
    known = math.fsum(parts)
    if known > total:
        return [part * total / known for part in parts], 0.0
    return parts, total - known
