"""Which further reference would narrow k most."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import attrs
import numpy as np

from imgscale._typing import SizeAxis
from imgscale.budget import learned_var, own_variances, scale_budget
from imgscale.extent import extent_rel_std
from imgscale.model import ScaleModel
from imgscale.object_prior import SIZE_AXES, normal_label
from imgscale.observations import NO_PRIOR
from imgscale.prior_choice import MeanKey, choose_prior, log_moments, mean_key
from imgscale.reference import numbered_labels

__all__ = ["NextReference"]

# Labels of the shipped table that are often in view and have a narrow size. Rows of a user's own,
# without a source, are proposed too.
_COMMON = frozenset(
    normal_label(label)
    for label in (
        "person", "man", "woman", "car", "bicycle", "bicycle wheel", "car tire", "bus", "door",
        "stair step", "kitchen counter", "dining table", "desk", "washing machine", "light switch",
        "licence plate", "stop sign", "traffic light", "traffic cone", "brick", "a4 sheet",
        "id card", "wine bottle", "drinks can", "compact disc", "soccer ball", "eur pallet",
        "wheelie bin",
    )
)  # fmt: skip
_NEW_LABELS = 3
# What a tape measure reaches on an object.
_ON_SITE_REL = 0.005
# And on a camera's mast; and what a horizon or vanishing lines in the picture tell.
_HEIGHT_REL, _HORIZON_PX = 0.02, 5.0


@attrs.frozen(kw_only=True)
class NextReference:
    """
    One more reference, and what it would make of k.

    Attributes
    ----------
    what : str
        The reference, in words.
    label : str
        Its label; empty for a measurement of the camera.
    k_rel_std_after : float
        Relative standard error of k with it, >= 0.
    """

    what: str
    label: str
    k_rel_std_after: float


def next_references(model: ScaleModel) -> tuple[NextReference, ...]:
    """
    Rank further references by how far they would narrow k.

    Parameters
    ----------
    model : ScaleModel
        The model.

    Returns
    -------
    tuple of NextReference
        The best first: one more of each label used, the best three labels of the table besides
        (common ones, and those of the user's own), and objects in view without a prior, measured
        on site to 0.5 %; on a ground plane the camera's height and the horizon too.

    Notes
    -----
    A label whose references weigh W together carries the information ``1 / (1 / W + tau^2)`` on
    log k, and a new reference adds its 1 / v to W: it is taken to lie at the median scale of
    the objects in view, and to have the references' median depth error. With the information I now
    and I' then, the part of the variance of log k that the declared errors explain falls to I / I'
    of it; the rest, see `ScaleBudget`, stays.
    """
    used = [ref for ref in model.references if ref.used]
    weights: dict[MeanKey | None, list[float]] = {}
    for ref in used:
        key = mean_key(ref.prior_label, ref.axis, model.priors)
        group = weights.setdefault(key, [0.0, ref.prior_mean_std_m / ref.prior_m])
        group[0] += 1 / max(float(own_variances(model, ref).sum()), 1e-12)
    now = sum(_information(*group) for group in weights.values()) + _of_camera(model)
    budget = scale_budget(model)
    # more references tell more of a plane's horizon too
    rest = budget.rest**2 + (0.0 if model.kind == "ground_plane" else budget.shift**2)
    declared = budget.rel_std**2 - rest

    def after(old: Sequence[float], variance: float) -> float:
        gained = _information(old[0] + 1 / max(variance, 1e-12), old[1]) - _information(*old)
        return math.sqrt(declared * now / (now + gained) + rest)

    depth_var = _depth_var(model)
    found = [
        NextReference(
            what=f"another {label}",
            label=label,
            k_rel_std_after=after(weights[key], _typical_var(model, label, depth_var)[0]),
        )
        for key, label in {
            mean_key(ref.prior_label, ref.axis, model.priors): ref.prior_label for ref in used
        }.items()
    ]
    fresh: list[NextReference] = []
    for label in _fresh_labels(model, {key[0] for key in weights if key}):
        variance, tau = _typical_var(model, label, depth_var)
        what = f"{_article(label)} {label} (the first)"
        k_after = after([0.0, tau], variance)
        fresh.append(NextReference(what=what, label=label, k_rel_std_after=k_after))
    found += _ranked(fresh)[:_NEW_LABELS]
    names = numbered_labels([ref.label for ref in model.references])
    for name, ref in zip(names, model.references, strict=True):
        if ref.reason == NO_PRIOR and not math.isnan(ref.depth):
            box = extent_rel_std(np.array([ref.pixels]), model.noise.box_px, model.noise.box_rel)
            variance = _ON_SITE_REL**2 + float(box[0]) ** 2 + depth_var
            what = f"the {name}, measured on site to {100 * _ON_SITE_REL:g} %"
            k_after = after([0.0, 0.0], variance)
            found.append(NextReference(what=what, label=ref.label, k_rel_std_after=k_after))
    return tuple(_ranked([*found, *_of_plane(model)]))


def _of_plane(model: ScaleModel) -> list[NextReference]:
    """Tell what a measured camera height, or a known horizon, would make of k."""
    if model.kind != "ground_plane" or not model.plane:
        return []
    of_k = model.k_std / model.k
    height = 1 / math.hypot(1 / of_k, 1 / _HEIGHT_REL) if of_k else 0.0
    ratio = 1 / (1 + (model.plane.horizon_std_px / _HORIZON_PX) ** 2)
    horizon = of_k * math.sqrt(1 - model.correlation**2 * (1 - ratio))
    return [
        NextReference(
            what=f"the camera's height, measured to {100 * _HEIGHT_REL:g} %",
            label="",
            k_rel_std_after=height,
        ),
        NextReference(
            what=f"the horizon, known to {_HORIZON_PX:g} px", label="", k_rel_std_after=horizon
        ),
    ]


def _information(weight: float, tau: float) -> float:
    """Information on log k of a label whose references weigh so much."""
    return 1 / (1 / weight + tau**2) if weight else 0.0


def _of_camera(model: ScaleModel) -> float:
    """Information of the camera, where it is a witness."""
    if not (model.camera_is_witness and model.camera):
        return 0.0
    return 1 / max(model.camera.focal_rel_std**2 + model.scale_rel_std**2, 1e-12)


def _depth_var(model: ScaleModel) -> float:
    """Variance of a further depth: the median of the references used."""
    depths = [own_variances(model, ref)[2] for ref in model.references if ref.used]
    told = (model.noise.depth_rel or 0.0) ** 2 + learned_var(model)
    return float(np.median(depths)) if depths else told


def _typical_var(model: ScaleModel, label: str, depth_var: float) -> tuple[float, float]:
    """Variance of log k from an object of a label at the median scale, and its label's tau."""
    scales = model.metres_per_pixel([ref.depth for ref in model.references])
    # without any depth boxes are taken as exact
    scale = 0.0 if np.isnan(scales).all() else float(np.nanmedian(scales))
    extents: dict[SizeAxis, float] = dict.fromkeys(SIZE_AXES, math.inf)
    for row in model.priors.lookup(label):
        if scale:
            extents[row.axis] = row.mean_m / scale
    choice = choose_prior(label, extents, model.priors, model.noise, None)
    size = float(log_moments(choice.mean_m, choice.std_m)[1])
    pixels = np.array([extents[choice.axis]])
    box = float(extent_rel_std(pixels, model.noise.box_px, model.noise.box_rel)[0]) ** 2
    return size + box + depth_var, choice.mean_std_m / choice.mean_m


def _fresh_labels(model: ScaleModel, seen: set[str]) -> list[str]:
    """Labels of the table that are worth looking for, without those already used."""
    return [
        row.label
        for row in {normal_label(row.label): row for row in model.priors}.values()
        if normal_label(row.label) not in seen
        and (normal_label(row.label) in _COMMON or not row.source)
    ]


def _ranked(references: Iterable[NextReference]) -> list[NextReference]:
    return sorted(references, key=lambda reference: reference.k_rel_std_after)


def _article(label: str) -> str:
    return "an" if label[0].casefold() in "aeiou" else "a"
