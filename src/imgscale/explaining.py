"""The verb `explain`: what a scale rests on, what limits it, and what would help."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import attrs

from imgscale._checks import check_iterable, check_type, nan_as_none
from imgscale.budget import ScaleBudget, SizeBudget, scale_budget, size_budget
from imgscale.camera import Camera
from imgscale.claims import claims_of
from imgscale.conflicts import Conflict, conflicts
from imgscale.core.solving import Problem
from imgscale.depth import GroundPlane
from imgscale.estimate import SizeEstimate
from imgscale.flags import Flag
from imgscale.implied_focal import FocalCheck, check_focal
from imgscale.model import ScaleModel
from imgscale.next_references import NextReference, next_references
from imgscale.observations import NO_DEPTH, NO_PRIOR, OFF_GROUND, PARTIAL
from imgscale.posing import problem_of_model
from imgscale.reference import OUTLIER, Reference, numbered_labels
from imgscale.suspicion import Suspicion, suspect

__all__ = ["CarryingReference", "Explanation", "RejectedReference", "explain"]

_REASONS = {
    PARTIAL: "partial: its box is cut by the border or marked so, and shows a part of its size",
    NO_DEPTH: "no depth: there is no valid depth on it",
    OFF_GROUND: "not on the ground: its foot tells no distance",
}
# So many of each kind are written out.
_MOST_CARRIED, _MOST_SIZES, _MOST_NEXT = 4, 4, 3
# Parts of the variance below this are not worth a word.
_LEAST_SHARE = 0.02
# Nor is a reference that narrows k by less.
_LEAST_GAIN = 0.03
_WORDS = {
    "individuals": "the spread of individuals",
    "mean_sizes": "mean sizes of labels",
    "boxes": "boxes",
    "depths": "depths",
    "camera": "the camera",
    "frames": "the references of all frames",
    "shift": "the shift of the depth",
    "rest": "open alternatives",
}
_OWN_WORDS = {"scale": "k", "box": "its own box", "depth": "its own depth", "rest": "the rest"}


@attrs.frozen(kw_only=True)
class CarryingReference:
    """
    A reference that carried the fit.

    Attributes
    ----------
    name : str
        Its label, numbered where several detections share it.
    weight : float
        Its share in k, 0 to 1.
    k_ratio : float
        The k that it alone gives over the model's.
    z_score : float
        Its residual against all other references in standard errors; NaN where there is no other.
    taken_as : str
        The kind of thing that it was taken for, empty where its label is of one kind.
    """

    name: str
    weight: float
    k_ratio: float
    z_score: float = attrs.field(eq=nan_as_none)
    taken_as: str


@attrs.frozen(kw_only=True)
class RejectedReference:
    """
    A detection with a prior that did not carry the fit.

    Attributes
    ----------
    name : str
        Its label, numbered where several detections share it.
    why : str
        Why not, in words.
    """

    name: str
    why: str


@attrs.frozen(kw_only=True)
class Explanation:
    """
    What a model rests on, what limits it, and what would help; print it.

    Attributes
    ----------
    summary : str
        The model in one sentence.
    carried : tuple of CarryingReference
        The references that carried the fit, the heaviest first.
    rejected : tuple of RejectedReference
        Detections with a prior that did not.
    without_prior : tuple of str
        Names of the detections without a prior.
    on_ground : bool
        True where k is the height of the camera above a ground plane.
    k_budget : ScaleBudget
        What the error of k is made of.
    budgets : tuple of SizeBudget
        What the error of each estimate is made of, in their order.
    suspicions : tuple of Suspicion
        Reasons to think that the fit was given something wrong.
    focal : FocalCheck or None
        What references and metric depth say of the focal length, beside the camera's; None for
        other kinds and without references.
    conflicts : tuple of Conflict
        Where what was told of the camera disagrees with references and depth by more than 3
        standard errors, as the model is flagged.
    next_references : tuple of NextReference
        Which further reference would narrow k most, the best first.
    """

    summary: str
    carried: tuple[CarryingReference, ...]
    rejected: tuple[RejectedReference, ...]
    without_prior: tuple[str, ...]
    on_ground: bool
    k_budget: ScaleBudget
    budgets: tuple[SizeBudget, ...]
    suspicions: tuple[Suspicion, ...]
    focal: FocalCheck | None
    conflicts: tuple[Conflict, ...]
    next_references: tuple[NextReference, ...]

    def to_dict(self) -> dict[str, Any]:
        """
        Turn the explanation into built-in types that `json` writes.

        Returns
        -------
        dict
            One entry for each attribute; floats that are not finite become None.
        """
        return attrs.asdict(self, value_serializer=_plain)

    def __str__(self) -> str:
        lines = [f"{self.summary}."]
        if self.carried:
            texts = [_carried_text(reference) for reference in self.carried]
            lines.append(f"Carried by {_listed(texts, _MOST_CARRIED)}.")
        if self.rejected:
            texts = [f"{reference.name} ({reference.why})" for reference in self.rejected]
            lines.append(f"Not used: {'; '.join(texts)}.")
        words = {**_WORDS, "shift": "the horizon"} if self.on_ground else _WORDS
        split = _split(self.k_budget.shares, words)
        lines.append(f"k has a standard error of {_percent(self.k_budget.rel_std)}{split}.")
        names = numbered_labels([budget.label for budget in self.budgets])
        own_words = {**_OWN_WORDS, "depth": "its own foot"} if self.on_ground else _OWN_WORDS
        pairs = zip(names, self.budgets, strict=True)
        texts = [_size_text(name, budget, own_words) for name, budget in pairs]
        lines += texts[:_MOST_SIZES]
        hidden = len(texts) - _MOST_SIZES
        if hidden > 0:
            lines.append(f"And {hidden} more {'size' if hidden == 1 else 'sizes'}.")
        lines += [f"Suspicion: {suspicion}" for suspicion in self.suspicions]
        lines += [f"Conflict: {conflict}." for conflict in self.conflicts]
        lines.append(self._advice())
        return "\n".join(lines)

    def _advice(self) -> str:
        """Say which further references would help."""
        helpful = self.k_budget.rel_std * (1 - _LEAST_GAIN)
        texts = [
            f"{reference.what} (to {_percent(reference.k_rel_std_after)})"
            for reference in self.next_references
            if reference.k_rel_std_after < helpful
        ]
        if not texts:
            return "No further reference would narrow k by much."
        return f"k would be narrowed most by {_listed(texts[:_MOST_NEXT], _MOST_NEXT)}."


def explain(model: ScaleModel, estimates: Iterable[SizeEstimate] = ()) -> Explanation:
    """
    Explain a model, and sizes by it: what they rest on, what limits them, what would help.

    Parameters
    ----------
    model : ScaleModel
        What `fit` returned.
    estimates : iterable of SizeEstimate
        What `predict` returned for it, or some of that.

    Returns
    -------
    Explanation
        Everything as records, and as text by `print`.

    Raises
    ------
    TypeError
        If an argument is of the wrong type.

    Examples
    --------
    >>> import imgscale as ims
    >>> detections = [ims.Detection("door", (100, 50, 180, 250)),
    ...               ims.Detection("crate", (300, 150, 400, 250)),
    ...               ims.Detection("statue", (500, 80, 600, 230))]
    >>> depth = ims.ObjectDepths([4.0, 5.0, 4.0], kind="relative", rel_std=0.01)
    >>> table = ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.02),
    ...                         ims.ObjectPrior("crate", 1.25, 0.05)])
    >>> model = ims.fit(detections, depth, table)
    >>> print(ims.explain(model, ims.predict(model, detections, depth)[2:]))
    k = 0.00250 +- 0.00004 m per px and depth unit (depth unit / focal length) from 2 of 2
    references; without a prior: statue.
    Carried by door (89 %, its own k the same), crate (11 %, its own k the same).
    k has a standard error of 1.4 %; of its variance the spread of individuals 49 %, depths 40 %,
    boxes 10 %.
    statue: its height has a standard error of 1.9 %; of its variance k 58 %, its own depth 29 %,
    its own box 13 %.
    k would be narrowed most by the statue, measured on site to 0.5 % (to 0.97 %), another door (to
    1 %), another crate (to 1.3 %).
    """
    check_type("model", model, ScaleModel)
    estimates = _check_estimates(estimates)
    names = numbered_labels([ref.label for ref in model.references])
    pairs = list(zip(names, model.references, strict=True))
    carried = [_carried(name, ref, model.k) for name, ref in pairs if ref.used]
    return Explanation(
        summary=str(model),
        carried=tuple(sorted(carried, key=lambda reference: -reference.weight)),
        rejected=tuple(
            RejectedReference(name=name, why=_why(ref, model.k))
            for name, ref in pairs
            if not ref.used and ref.reason != NO_PRIOR
        ),
        without_prior=tuple(name for name, ref in pairs if ref.reason == NO_PRIOR),
        on_ground=model.kind == "ground_plane",
        k_budget=scale_budget(model),
        budgets=tuple(size_budget(model, estimate) for estimate in estimates),
        suspicions=suspect(model),
        focal=check_focal(model, claims_of(model)),
        conflicts=_conflicts(model),
        next_references=next_references(model),
    )


def _check_estimates(estimates: Iterable[SizeEstimate]) -> list[SizeEstimate]:
    check_iterable("estimates", estimates, "SizeEstimate")
    return [
        check_type("estimates", estimate, SizeEstimate, " Pass what `predict` returned.")
        for estimate in estimates
    ]


def _carried(name: str, ref: Reference, k: float) -> CarryingReference:
    return CarryingReference(
        name=name, weight=ref.weight, k_ratio=ref.k / k, z_score=ref.z_score, taken_as=ref.taken_as
    )


def _why(ref: Reference, k: float) -> str:
    """Say why a detection with a prior did not carry the fit."""
    if ref.reason != OUTLIER:
        return _REASONS[ref.reason]
    apart = "" if math.isnan(ref.z_score) else f", {abs(ref.z_score):.1f} standard errors"
    wrong = 1 - ref.taken_as_probability
    sure = "over 99 %" if wrong > 0.995 else f"{100 * wrong:.0f} %"
    return f"outlier: it says k {_ratio(ref.k / k)}{apart} from the others; wrong with {sure}"


def _ratio(ratio: float) -> str:
    """Write a ratio of two k."""
    if ratio >= 2:
        return f"{ratio:.2g} times as large"
    change = 100 * (ratio - 1)
    if abs(change) < 0.05:
        return "the same"
    digits = 0 if abs(change) >= 9.5 else 1
    return f"{abs(change):.{digits}f} % {'higher' if change > 0 else 'lower'}"


def _carried_text(reference: CarryingReference) -> str:
    taken = f", taken as {reference.taken_as.split(':')[0]}" if reference.taken_as else ""
    return (
        f"{reference.name} ({100 * reference.weight:.0f} %{taken}, its own k "
        f"{_ratio(reference.k_ratio)})"
    )


def _size_text(name: str, budget: SizeBudget, words: Mapping[str, str]) -> str:
    if math.isnan(budget.rel_std):
        return f"{name}: its {budget.axis} is not known."
    split = _split(budget.shares, words)
    return f"{name}: its {budget.axis} has a standard error of {_percent(budget.rel_std)}{split}."


def _conflicts(model: ScaleModel) -> tuple[Conflict, ...]:
    """Compare once more what was told of the camera, where the model is flagged."""
    if Flag.CAMERA_CONFLICT not in model.flags:
        return ()

    def pose(camera: Camera | None, ground: GroundPlane | None) -> Problem:
        return problem_of_model(attrs.evolve(model, camera=camera, ground=ground))[0]

    camera = model.camera if model.kind == "metric" else None
    return conflicts(camera, model.ground, model.scale_rel_std, model.method, pose)


def _split(shares: Mapping[str, float], words: Mapping[str, str]) -> str:
    """Write the shares of a variance that matter, the largest first."""
    ranked = sorted(shares.items(), key=lambda item: -item[1])
    texts = [f"{words[name]} {100 * part:.0f} %" for name, part in ranked if part >= _LEAST_SHARE]
    return f"; of its variance {', '.join(texts)}" if texts else ""


def _listed(texts: Sequence[str], most: int) -> str:
    hidden = len(texts) - most
    return ", ".join(texts[:most]) + (f" and {hidden} more" if hidden > 0 else "")


def _percent(value: float) -> str:
    """Write a relative error with two digits."""
    return f"{100 * value:.2g} %"


def _plain(_: object, __: object, value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
