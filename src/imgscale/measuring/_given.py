"""Arrays as they are given."""

from __future__ import annotations

from typing import Any

from numpy.typing import ArrayLike, NDArray

from imgscale._checks import as_array


def given_array(name: str, law: str, value: ArrayLike) -> NDArray[Any]:
    """
    Turn what was given into an array.

    Parameters
    ----------
    name, law : str
        The argument and what it must be, for messages.
    value : array_like
        The value.

    Returns
    -------
    ndarray
        The array.

    Raises
    ------
    ValueError
        If it is none, or masks some of its entries: what lies under a mask is no value.
    """
    return as_array(name, law, value)
