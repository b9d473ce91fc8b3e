"""What the prior table knows of the labels of a batch, as columns to be looked up by code."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from imgscale._checks import as_array
from imgscale._typing import FloatArray, IntArray, SizeAxis
from imgscale.core.segments import Parts
from imgscale.prior_choice import log_kinds, log_moments, mean_key, moments_of, rows_along
from imgscale.priors import PriorTable


class Labels(NamedTuple):
    """
    Priors of L labels along one axis; the last row, which the code -1 finds, knows nothing.

    Attributes
    ----------
    mean_m : (L + 1,) ndarray of float64
        Mean size in metres; NaN without a prior.
    log_mean, log_var : (L + 1,) ndarray of float64
        Moments of the log size; NaN without a prior.
    tau : (L + 1,) ndarray of float64
        Standard deviation of the label's shared offset.
    group : (L + 1,) ndarray of int
        Number of the mean that labels share (aliases are one); -1 without a prior.
    kinds : Parts
        Log sizes of the kinds of thing, (L + 1, J).
    """

    mean_m: FloatArray
    log_mean: FloatArray
    log_var: FloatArray
    tau: FloatArray
    group: IntArray
    kinds: Parts


def labels_of(names: Sequence[str], priors: PriorTable, axis: SizeAxis) -> Labels:
    """
    Look up labels.

    Parameters
    ----------
    names : sequence of str
        The labels.
    priors : PriorTable
        Sizes by label.
    axis : str
        The axis along which the objects are measured.

    Returns
    -------
    Labels
        One row for each and one more.
    """
    rows = [*(rows_along(name, axis, priors) for name in names), ()]
    choices = [moments_of(found, axis) for found in rows]
    keys = [mean_key(name, axis, priors) for name in names]
    numbers = {key: number for number, key in enumerate(dict.fromkeys(filter(None, keys)))}
    mean_m, std_m, mean_std_m = np.array(
        [(choice.mean_m, choice.std_m, choice.mean_std_m) for choice in choices]
    ).T
    log_mean, log_var = log_moments(mean_m, std_m)
    return Labels(
        mean_m=mean_m,
        log_mean=log_mean,
        log_var=log_var,
        tau=mean_std_m / mean_m,
        group=np.array([-1 if key is None else numbers[key] for key in [*keys, None]]),
        kinds=log_kinds(rows),
    )


def coded(label: ArrayLike, names: Sequence[str] | None) -> tuple[IntArray, Sequence[str]]:
    """
    Turn labels into codes.

    Parameters
    ----------
    label : (N,) array_like of str or int
        Labels, or codes into `names`.
    names : sequence of str or None
        What the codes stand for.

    Returns
    -------
    codes : (N,) ndarray of int
        From -1, no label, to ``len(names) - 1``, as they came or new.
    names : sequence of str
        What they stand for.

    Raises
    ------
    TypeError
        If a label is no string, or codes come without names.
    ValueError
        If a code names no label.
    """
    array = as_array("label", "one label per object", label)
    if names is not None:
        return _checked_codes(array, names), names
    if array.size and array.dtype.kind in "iu":
        msg = "`labels` must name what the codes of `label` stand for; got None."
        raise TypeError(msg)
    numbers: dict[object, int] = {}
    codes = np.array([numbers.setdefault(name, len(numbers)) for name in array.tolist()], np.intp)
    for name in numbers:
        if not isinstance(name, str):
            msg = f"`label` must be strings, or codes into `labels`; got {name!r}."
            raise TypeError(msg)
    return codes, [str(name) for name in numbers]


def _checked_codes(codes: IntArray, names: Sequence[str]) -> IntArray:
    if codes.size and codes.dtype.kind not in "iu":
        msg = f"`label` must be integer codes where `labels` names them; got {codes.dtype}."
        raise TypeError(msg)
    for index, name in enumerate(cast("Sequence[object]", names)):
        if not isinstance(name, str):
            msg = f"`labels` must be strings; got {name!r} at index {index}."
            raise TypeError(msg)
    if codes.size and not -1 <= int(codes.min()) <= int(codes.max()) < len(names):
        bad = int(np.flatnonzero((codes < -1) | (codes >= len(names)))[0])
        msg = (
            f"`label` must hold codes from -1, no label, to {len(names) - 1}, the last of "
            f"`labels`; got {codes[bad]} at index {bad}."
        )
        raise ValueError(msg)
    return codes
