"""
The paper's two estimators of k, in closed form.

Singh and Shrivastava, "Determining Image Scale in Real-World Units Using Natural Objects Present
in Image", EasyChair preprint, 2023.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgscale._typing import FloatArray


def mean_ratio(x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """
    Average the objects' own k (section 3 of the paper, figure 3.14).

    Parameters
    ----------
    x : (N, ...) array_like of float
        Depth times pixels, ``d * p``, positive, of N objects of one image or of several.
    y : (N, ...) array_like of float
        Known sizes H, in metres, positive.

    Returns
    -------
    k : (...) ndarray of float64
        ``mean(H / (d p))``.
    shares : (N, ...) ndarray of float64
        How much of k each object gave, ``dlog(k) / dlog(k_i)``; they sum to 1.

    Examples
    --------
    >>> k, shares = mean_ratio([100.0, 100.0], [1.0, 3.0])
    >>> float(k), shares.tolist()
    (0.02, [0.25, 0.75])
    """
    own_k = np.asarray(y, dtype=np.float64) / np.asarray(x, dtype=np.float64)
    total: FloatArray = np.add.reduce(own_k, axis=0)
    return total / len(own_k), own_k / total


def least_squares(x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """
    Fit ``H = k * d * p`` by ordinary least squares through the origin.

    Parameters
    ----------
    x : (N, ...) array_like of float
        Depth times pixels, ``d * p``, positive, of N objects of one image or of several.
    y : (N, ...) array_like of float
        Known sizes H, in metres, positive.

    Returns
    -------
    k : (...) ndarray of float64
        ``sum(x y) / sum(x^2)``.
    shares : (N, ...) ndarray of float64
        How much of k each object gave, ``dlog(k) / dlog(k_i)``; they sum to 1.

    Examples
    --------
    >>> k, shares = least_squares([100.0, 200.0], [2.0, 4.0])
    >>> float(k), shares.tolist()
    (0.02, [0.2, 0.8])
    """
    predictor, of_x = _near_one(x)
    sizes, of_y = _near_one(y)
    products = predictor * sizes
    total: FloatArray = np.add.reduce(products, axis=0)
    k: FloatArray = np.ldexp(total / np.add.reduce(predictor**2, axis=0), of_y - of_x)
    return k, products / total


def _near_one(values: ArrayLike) -> tuple[FloatArray, NDArray[np.int32]]:
    """Take the power of 2 of the largest out of each image, exactly: squares do not overflow."""
    array = np.asarray(values, dtype=np.float64)
    power: NDArray[np.int32] = np.frexp(np.max(array, axis=0, initial=0.0))[1]
    return np.ldexp(array, -power), power
