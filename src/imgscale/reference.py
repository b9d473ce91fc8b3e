"""What one detection said of the scale."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import attrs

from imgscale._checks import nan_as_none, nans_as_none
from imgscale._typing import Box, SizeAxis

__all__ = ["OUTLIER", "Reference", "numbered_labels", "references_of_columns"]

OUTLIER = "outlier"


# an image has one for each detection: without slots they are made in half the time
@attrs.frozen(slots=False)
class Reference:
    """
    What one detection given to `fit` said of the scale.

    Attributes
    ----------
    label : str
        Its label.
    prior_label : str
        The name under which the table of priors was asked: its label, or one of its aliases.
    xyxy : tuple of float
        Its box, in pixels.
    foot_xy : tuple of float
        Column and row at which it meets the ground, in pixels; NaN where it does not, or where no
        ground plane took part.
    axis : str
        The axis through which it is a witness.
    pixels : float
        Its extent along that axis, in pixels.
    depth : float
        Its depth, in the unit of the depth given; NaN where there is none.
    metres_per_pixel : float
        Its own height per pixel, prior mean over pixels, in m/px; NaN without a prior.
    k : float
        The k that it alone gives, NaN without prior or depth.
    prior_m, prior_std_m, prior_mean_std_m : float
        Its prior: mean, spread between individuals and standard error of the mean, in metres, of
        the mixture where the label has several rows; NaN without a prior.
    taken_as : str
        The kind of thing that it was taken for, where its label may be several (adult, child,
        sitting): what the box of that row of the table spans; empty where there is one.
    taken_as_m : float
        Mean size of that row, in metres; NaN without a prior.
    taken_as_probability : float
        Probability that it is sound and of that kind; NaN where it is no candidate.
    noise_rel : float
        Relative standard error of box and depth together, as far as it was told; NaN without a
        depth.
    posterior_m, posterior_std_m : float
        Its size in the light of all references, in metres; NaN where it is no candidate.
    z_score : float
        Residual of log size against all other references, in standard errors; NaN where there is
        no other.
    weight : float
        Its share in k, 0 to 1; shares sum to 1 (with the camera's, where that is a witness).
    mixed : bool
        True where two surfaces share its box, so that the depth may be that of the other.
    reason : str
        Why it was not used: "no prior", "partial", "no depth", "not on the ground" or
        "outlier"; empty where it was.
    """

    label: str
    prior_label: str
    xyxy: Box
    foot_xy: tuple[float, float] = attrs.field(eq=nans_as_none)
    axis: SizeAxis
    pixels: float = attrs.field(eq=nan_as_none)
    depth: float = attrs.field(eq=nan_as_none)
    metres_per_pixel: float = attrs.field(eq=nan_as_none)
    k: float = attrs.field(eq=nan_as_none)
    prior_m: float = attrs.field(eq=nan_as_none)
    prior_std_m: float = attrs.field(eq=nan_as_none)
    prior_mean_std_m: float = attrs.field(eq=nan_as_none)
    taken_as: str
    taken_as_m: float = attrs.field(eq=nan_as_none)
    taken_as_probability: float = attrs.field(eq=nan_as_none)
    noise_rel: float = attrs.field(eq=nan_as_none)
    posterior_m: float = attrs.field(eq=nan_as_none)
    posterior_std_m: float = attrs.field(eq=nan_as_none)
    z_score: float = attrs.field(eq=nan_as_none)
    weight: float = attrs.field(eq=nan_as_none)
    mixed: bool
    reason: str

    @property
    def used(self) -> bool:
        """True where it carried the fit."""
        return not self.reason

    @property
    def candidate(self) -> bool:
        """True where it was given to the solver, which used or rejected it."""
        return self.reason in {"", OUTLIER}


_FIELDS = [field.name for field in attrs.fields(Reference)]


def references_of_columns(**columns: Iterable[Any]) -> tuple[Reference, ...]:
    """
    Make a reference of each row.

    Parameters
    ----------
    **columns : iterable
        One for each field, under its name and of its type, all equally long.

    Returns
    -------
    tuple of Reference
        In the order of the rows.
    """
    return tuple(map(Reference, *[columns[name] for name in _FIELDS]))


def numbered_labels(labels: Sequence[str]) -> list[str]:
    """
    Tell objects of one label apart by a number.

    Parameters
    ----------
    labels : sequence of str
        Labels in order.

    Returns
    -------
    list of str
        "car 1", "car 2"; a label that occurs once stays as it is.
    """
    totals = Counter(labels)
    seen: Counter[str] = Counter()
    names: list[str] = []
    for label in labels:
        seen[label] += 1
        names.append(f"{label} {seen[label]}" if totals[label] > 1 else label)
    return names
