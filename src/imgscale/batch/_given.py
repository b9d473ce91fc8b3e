"""What data frames and Arrow tables share: names of columns, and values refused by their place."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from imgscale._checks import check_choice
from imgscale._depth_values import METRIC_SCALES, VALUE_KINDS, refuse_integers, valid_depths
from imgscale._typing import BoolArray, DepthKind, FloatArray

Place: TypeAlias = Callable[[int], str]  # from the position of an object to words for its place


def check_names(asked: Mapping[str, object], there: Iterable[object], added: Sequence[str]) -> None:
    """
    Raise unless the columns asked for are there and those to be added are not.

    Parameters
    ----------
    asked : mapping of str to object
        Names of columns by the argument that gave them; that of "partial" may be None.
    there : iterable of object
        The names that the table has.
    added : sequence of str
        The names that the result adds.

    Raises
    ------
    TypeError
        If a name is no string.
    ValueError
        If a column is missing, or one would be there twice.
    """
    known = list(there)
    for argument, name in asked.items():
        if name is None and argument == "partial":  # the only one that may be left out
            continue
        if not isinstance(name, str):
            msg = f"`{argument}` must be the name of a column; got {name!r}."
            raise TypeError(msg)
        if known.count(name) != 1:
            seen = f"{known.count(name)} of that name" if name in known else _listed(known)
            msg = f'`{argument}` must name one column of the table; got "{name}" and {seen}.'
            raise ValueError(msg)
    taken = [name for name in added if name in known]
    if taken:
        msg = (
            f"The table must not have columns yet that the result adds; got {_listed(taken)}. "
            "Rename or drop them first."
        )
        raise ValueError(msg)


def _listed(names: Sequence[object]) -> str:
    """List a few names."""
    some = ", ".join(f'"{name}"' for name in names[:8])
    return f"{some or 'none'}{', ...' if len(names) > 8 else ''}"


def check_extents(values: FloatArray, name: str, place: Place) -> None:
    """
    Raise unless every extent is a finite, positive number of pixels.

    Parameters
    ----------
    values : (N,) ndarray of float
        The extents; NaN where there is none.
    name : str
        Name of their column.
    place : callable
        Words for the place of an object.

    Raises
    ------
    ValueError
        If one is not.
    """
    lawful: BoolArray = (values > 0) & (values < np.inf)
    if not lawful.all():
        row = int(np.argmin(lawful))
        msg = (
            f"`pixels` must be finite and positive; got {_seen(values[row])} in column "
            f'"{name}", {place(row)}. Leave out objects without an extent.'
        )
        raise ValueError(msg)


def check_depths(
    values: NDArray[Any], kind: DepthKind, name: str, place: Place, *, as_integers: bool
) -> None:
    """
    Raise unless every depth is lawful for its kind, or not known.

    Parameters
    ----------
    values : (N,) ndarray of float or int
        The depths; NaN where they are not known.
    kind : str
        Their kind.
    name : str
        Name of their column.
    place : callable
        Words for the place of an object.
    as_integers : bool
        Whether the column holds integers, which metres are not.

    Raises
    ------
    ValueError
        If one is not.
    """
    check_choice("kind", kind, VALUE_KINDS)
    if kind == "metric" and as_integers:
        refuse_integers(name, np.empty(0, dtype=np.int64), METRIC_SCALES)
    lawful: BoolArray = valid_depths(values, kind) | np.isnan(values)
    if not lawful.all():
        row = int(np.argmin(lawful))
        law = "finite" if kind == "affine_inverse" else "finite and positive"
        msg = (
            f"`depth` must be {law}, or null where it is not known; got {_seen(values[row])} in "
            f'column "{name}", {place(row)}.'
        )
        raise ValueError(msg)


def _seen(value: Any) -> str:
    return "NaN or null" if np.isnan(value) else str(value.item())
