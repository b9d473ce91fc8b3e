"""Which rows of the prior table an object is compared with, and along which axis."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from imgscale._typing import FloatArray, SizeAxis
from imgscale.core.segments import Parts
from imgscale.detection import Detection
from imgscale.extent import extent_rel_std
from imgscale.noise import Noise
from imgscale.object_prior import SIZE_AXES, ObjectPrior, normal_label
from imgscale.priors import PriorTable

MeanKey: TypeAlias = tuple[str, SizeAxis]


class PriorChoice(NamedTuple):
    """
    One axis of one label.

    Attributes
    ----------
    axis : str
        The axis.
    rows : tuple of ObjectPrior
        The rows of the table, one for each kind of thing that the label may be; empty without.
    mean_m, std_m, mean_std_m : float
        Moments of the mixture, in metres; NaN without a prior.
    """

    axis: SizeAxis
    rows: tuple[ObjectPrior, ...]
    mean_m: float
    std_m: float
    mean_std_m: float

    @property
    def on_ground(self) -> bool:
        """True where the lower edge of the box is where the object stands, as far as is known."""
        return all(row.on_ground for row in self.rows)


def choose_prior(
    label: str,
    extents_px: Mapping[SizeAxis, float],
    priors: PriorTable,
    noise: Noise,
    axis: SizeAxis | None,
) -> PriorChoice:
    """
    Choose the axis whose prior and box together err least, or take the one asked for.

    Parameters
    ----------
    label : str
        The label, or one of its aliases.
    extents_px : mapping of str to float
        The object's extent along each axis, in pixels.
    priors : PriorTable
        Sizes by label.
    noise : Noise
        Errors of the box.
    axis : str or None
        The axis asked for.

    Returns
    -------
    PriorChoice
        Without rows where the table does not know the label.
    """
    names: tuple[SizeAxis, ...] = (axis,) if axis else SIZE_AXES
    choices = [moments_of(rows_along(label, name, priors), name) for name in names]
    choices = [choice for choice in choices if choice.rows] or choices[:1]

    def error(choice: PriorChoice) -> float:
        pixels = np.array([extents_px[choice.axis]])
        box = float(extent_rel_std(pixels, noise.box_px, noise.box_rel)[0])
        return math.hypot(choice.std_m / choice.mean_m, choice.mean_std_m / choice.mean_m, box)

    return min(choices, key=error) if len(choices) > 1 else choices[0]


def prior_label(detection: Detection, priors: PriorTable) -> str:
    """
    Find the name under which the table knows an object.

    Parameters
    ----------
    detection : Detection
        The object.
    priors : PriorTable
        Sizes by label.

    Returns
    -------
    str
        Its label, or the first of its aliases that is known where the label is not.
    """
    return next((name for name in detection.names if name in priors), detection.label)


def mean_key(label: str, axis: SizeAxis, priors: PriorTable) -> MeanKey | None:
    """
    Name the mean size that objects of a label share along an axis.

    Parameters
    ----------
    label : str
        The label, or one of its aliases.
    axis : str
        The axis.
    priors : PriorTable
        Sizes by label.

    Returns
    -------
    tuple of str or None
        The table's label and the axis; None without a prior.
    """
    rows = rows_along(label, axis, priors)
    return (normal_label(rows[0].label), axis) if rows else None


def mean_key_of(detection: Detection, axis: SizeAxis, priors: PriorTable) -> MeanKey | None:
    """
    Name the mean size that an object shares with others along an axis.

    Parameters
    ----------
    detection : Detection
        The object.
    axis : str
        The axis.
    priors : PriorTable
        Sizes by label.

    Returns
    -------
    tuple of str or None
        As `mean_key` of the name under which the table knows it.
    """
    return mean_key(prior_label(detection, priors), axis, priors)


def rows_along(label: str, axis: SizeAxis, priors: PriorTable) -> tuple[ObjectPrior, ...]:
    """
    Find the rows of a label along an axis.

    Parameters
    ----------
    label : str
        The label, or one of its aliases.
    axis : str
        The axis.
    priors : PriorTable
        Sizes by label.

    Returns
    -------
    tuple of ObjectPrior
        The rows, one for each kind of thing that the label may be.
    """
    return tuple(row for row in priors.lookup(label) if row.axis == axis)


def log_kinds(choices: Sequence[Sequence[ObjectPrior]]) -> Parts:
    """
    Turn the rows of objects' priors into log-normal sizes.

    Parameters
    ----------
    choices : sequence of sequences of ObjectPrior
        The rows of each object, none where it has no prior.

    Returns
    -------
    Parts
        Of shape (N, J): shares that sum to 1, ``mu = log(mean) - s^2 / 2`` and
        ``s^2 = log(1 + (std / mean)^2)``; NaN where there is no row.
    """
    width = max((len(rows) for rows in choices), default=1) or 1
    columns = np.zeros((3, len(choices), width))
    columns[:, [not rows for rows in choices]] = np.nan
    for index, rows in enumerate(choices):
        total = sum(row.share for row in rows)
        for place, row in enumerate(rows):
            log_mean, log_var = log_moments(row.mean_m, row.std_m)
            columns[:, index, place] = row.share / total, log_mean, log_var
    return Parts(*columns)


def log_moments(
    mean_m: FloatArray | float, std_m: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """
    Turn a mean and a standard deviation into those of the logarithm of a log-normal size.

    Parameters
    ----------
    mean_m, std_m : float or ndarray of float
        Arithmetic mean and standard deviation, in metres.

    Returns
    -------
    log_mean, log_var : float64 or ndarray of float64
        ``log(mean) - s^2 / 2`` and ``s^2 = log(1 + (std / mean)^2)``.
    """
    log_var: FloatArray = np.log1p((np.asarray(std_m, dtype=np.float64) / mean_m) ** 2)
    return np.log(mean_m) - log_var / 2, log_var


def moments_of(rows: Sequence[ObjectPrior], axis: SizeAxis) -> PriorChoice:
    """
    Compute mean, spread and error of the mean of a mixture of sizes.

    Parameters
    ----------
    rows : sequence of ObjectPrior
        The kinds of thing.
    axis : str
        Their axis.

    Returns
    -------
    PriorChoice
        The spread holds the distance between the parts: ``sum w (std^2 + mean^2) - mean^2``.
    """
    if not rows:
        return PriorChoice(axis, (), math.nan, math.nan, math.nan)
    if len(rows) == 1:
        return PriorChoice(axis, tuple(rows), rows[0].mean_m, rows[0].std_m, rows[0].mean_std_m)
    total = sum(row.share for row in rows)
    mean_m = sum(row.share * row.mean_m for row in rows) / total
    variance = sum(row.share * (row.std_m**2 + (row.mean_m - mean_m) ** 2) for row in rows) / total
    mean_std_m = sum(row.share * row.mean_std_m for row in rows) / total
    return PriorChoice(axis, tuple(rows), mean_m, math.sqrt(variance), mean_std_m)
