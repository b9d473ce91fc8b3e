"""Which rows of the prior table an object is compared with, and along which axis."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import chain
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from imgscale._typing import FloatArray, IntArray, SizeAxis
from imgscale.core.segments import Parts
from imgscale.detection import Detection
from imgscale.noise import Noise
from imgscale.object_prior import SIZE_AXES, ObjectPrior
from imgscale.priors import (
    MeanKey,
    PriorTable,
    SizePrior,
    log_moments,
    moments_of,
)

__all__ = [
    "NOTHING_KNOWN",
    "MeanKey",
    "PriorColumns",
    "SizePrior",
    "choose_prior",
    "columns_of",
    "log_kinds",
    "log_moments",
    "mean_key",
    "mean_key_of",
    "moments_of",
    "prior_label",
    "rows_along",
    "size_along",
]

# By axis, for labels without a prior.
NOTHING_KNOWN: Mapping[SizeAxis, SizePrior] = MappingProxyType(
    {axis: moments_of((), axis) for axis in SIZE_AXES}
)


def choose_prior(
    label: str,
    extents_px: Mapping[SizeAxis, float],
    priors: PriorTable,
    noise: Noise,
    axis: SizeAxis | None,
) -> SizePrior:
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
    SizePrior
        Without rows where the table does not know the label.
    """
    if axis:
        return size_along(label, axis, priors)
    choices = tuple(priors.sizes(label).values()) or (NOTHING_KNOWN[SIZE_AXES[0]],)
    if len(choices) == 1:
        return choices[0]

    def error(prior: SizePrior) -> float:
        box = math.hypot(noise.box_px / extents_px[prior.axis], noise.box_rel)
        return math.hypot(prior.std_m / prior.mean_m, prior.mean_std_m / prior.mean_m, box)

    return min(choices, key=error)


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
    if detection.label in priors:
        return detection.label
    return next((name for name in detection.aliases if name in priors), detection.label)


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
    return size_along(label, axis, priors).key


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
    return size_along(label, axis, priors).rows


def size_along(label: str, axis: SizeAxis, priors: PriorTable) -> SizePrior:
    """
    Find what is known of a label along an axis.

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
    SizePrior
        Without rows where nothing is known.
    """
    return priors.sizes(label).get(axis) or NOTHING_KNOWN[axis]


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
    sizes = [moments_of(rows, SIZE_AXES[0]) for rows in choices]
    return columns_of(sizes, np.arange(len(sizes))).kinds


class PriorColumns(NamedTuple):
    """
    Priors of objects.

    Attributes
    ----------
    mean_m, std_m, mean_std_m : (N,) ndarray of float64
        Moments of the mixture, in metres; NaN without a prior.
    log_mean, log_var, tau : (N,) ndarray of float64
        Mean and variance of the log size, all kinds together, and relative error of the mean.
    kinds : Parts
        Log sizes of the kinds of thing that each may be, (N, J): the share 0 where an object has
        fewer kinds, NaN where it has none.
    """

    mean_m: FloatArray
    std_m: FloatArray
    mean_std_m: FloatArray
    log_mean: FloatArray
    log_var: FloatArray
    tau: FloatArray
    kinds: Parts


def columns_of(sizes: Sequence[SizePrior], number: IntArray) -> PriorColumns:
    """
    Put the priors of objects into columns.

    Parameters
    ----------
    sizes : sequence of SizePrior
        The priors.
    number : (N,) ndarray of int
        Which of them each object has.

    Returns
    -------
    PriorColumns
        One row for each object.
    """
    width = max([len(size.kinds) for size in sizes], default=0) or 1
    rows = [
        (
            *(size.mean_m, size.std_m, size.mean_std_m, size.log_mean, size.log_var, size.tau),
            *chain.from_iterable(size.kinds),
            *(0.0 if size.kinds else math.nan,) * 3 * (width - len(size.kinds)),
        )
        for size in sizes
    ]
    table = np.array(rows, dtype=np.float64).reshape(-1, 6 + 3 * width)[number]
    share, mean, variance = (table[:, first::3] for first in (6, 7, 8))
    mean_m, std_m, mean_std_m, log_mean, log_var, tau = table[:, :6].T
    kinds = Parts(share, mean, variance)
    return PriorColumns(mean_m, std_m, mean_std_m, log_mean, log_var, tau, kinds)
