"""
Medians of many short columns at once.

Wide blocks are sorted by a network, which costs two passes over the rows for each comparison
whatever the number of columns; narrow ones by numpy's sort. Batcher's odd-even merge sort: K. E.
Batcher, "Sorting networks and their applications", AFIPS 32 (1968).
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
from numpy.typing import NDArray

from imgscale._typing import FloatArray, IntArray

# From so many columns on a network is faster, for so many rows at most.
_WIDE, _TALL = 64, 128
# Shares of a half that differ by less are rounding.
_TIE = 1e-9


def column_medians(values: FloatArray) -> FloatArray:
    """
    Compute the median of each column.

    Parameters
    ----------
    values : (q, m) ndarray of float
        Finite values.

    Returns
    -------
    (m,) ndarray of float64
        The medians; the mean of both middle values where q is even.
    """
    size, width = values.shape
    lower, upper = (size - 1) // 2, size // 2
    if width < _WIDE or size > _TALL:
        ordered = np.sort(values, axis=0)
        middle: FloatArray = (ordered[lower] + ordered[upper]) / 2
        return middle
    rows = list(values)
    for low, high in _comparisons(size, lower, upper):
        first, second = rows[low], rows[high]
        rows[low], rows[high] = np.minimum(first, second), np.maximum(first, second)
    median: FloatArray = (rows[lower] + rows[upper]) / 2
    return median


def weighted_column_medians(values: FloatArray, weights: FloatArray) -> FloatArray:
    """
    Compute the weighted median of each column.

    Parameters
    ----------
    values, weights : (q, m) ndarray of float
        Finite values and their weights, positive.

    Returns
    -------
    (m,) ndarray of float64
        The medians; the mean of both values where two share the middle.
    """
    size, width = values.shape
    if size == 1:
        alone: FloatArray = values[0]
        return alone
    if width < _WIDE or size > _TALL:
        order = np.argsort(values, axis=0)
        flat = order * width + np.arange(width, dtype=np.intp)
        ordered, weight = values.ravel()[flat], weights.ravel()[flat]
    else:
        ordered, weight = _sorted_together(values, weights)
    for row in range(1, size):  # a cumulative sum, many times as fast as cumsum(axis=0)
        weight[row] += weight[row - 1]
    half, column, ends = weight[-1] / 2, np.arange(width, dtype=np.intp), ordered.ravel()
    # the last row is never below: there all the weight is reached
    lower = np.add.reduce(weight[:-1] < half * (1 - 2 * _TIE), axis=0, dtype=np.intp)
    upper = np.add.reduce(weight[:-1] <= half * (1 + 2 * _TIE), axis=0, dtype=np.intp)
    median: FloatArray = (ends[lower * width + column] + ends[upper * width + column]) / 2
    return median


def column_order(keys: IntArray) -> IntArray:
    """
    Find the order that brings equal keys of each column together.

    Parameters
    ----------
    keys : (q, m) ndarray of int
        Keys, 0 or more, below 2**40.

    Returns
    -------
    (q, m) ndarray of int
        Rows by increasing key.
    """
    size, width = keys.shape
    if width < _WIDE or size > _TALL:
        order: IntArray = np.argsort(keys, axis=0, kind="stable")
        return order
    bits = (size - 1).bit_length()
    rows: list[NDArray[np.int64]] = list(
        (keys.astype(np.int64) << bits) | np.arange(size, dtype=np.int64)[:, None]
    )
    for low, high in _comparisons(size, 0, size - 1):
        first, second = rows[low], rows[high]
        rows[low], rows[high] = np.minimum(first, second), np.maximum(first, second)
    found: IntArray = np.stack(rows) & ((1 << bits) - 1)
    return found


def _sorted_together(values: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sort columns by a network; the last bits of each number, below its rounding, name its row."""
    size, width = values.shape
    bits = (size - 1).bit_length()
    number = np.arange(size, dtype=np.int64)[:, None]
    whole: NDArray[np.int64] = values.view(np.int64)
    tagged: FloatArray = ((whole >> bits << bits) | number).view(np.float64)
    rows: list[FloatArray] = list(tagged)
    for low, high in _comparisons(size, 0, size - 1):
        first, second = rows[low], rows[high]
        rows[low], rows[high] = np.minimum(first, second), np.maximum(first, second)
    flat = (np.stack(rows).view(np.int64) & ((1 << bits) - 1)) * width + np.arange(
        width, dtype=np.intp
    )
    return values.ravel()[flat], weights.ravel()[flat]


@cache
def _comparisons(size: int, first: int, last: int) -> tuple[tuple[int, int], ...]:
    """List the comparisons of a sorting network that matter for the ranks first to last."""
    needed = set(range(first, last + 1))
    kept: list[tuple[int, int]] = []
    for pair in reversed(list(_merge_sort(size))):
        if needed.intersection(pair):
            needed.update(pair)
            kept.append(pair)
    return tuple(reversed(kept))


def _merge_sort(size: int) -> Iterator[tuple[int, int]]:
    """List the comparisons of Batcher's odd-even merge sort."""
    length = 1
    while length < size:
        step = length
        while step >= 1:
            for start in range(step % length, size - step, 2 * step):
                for low in range(start, min(start + step, size - step)):
                    if low // (2 * length) == (low + step) // (2 * length):
                        yield low, low + step
            step //= 2
        length *= 2
