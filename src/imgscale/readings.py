"""
How well other readings of a model's depths fit its references.

Reference i has ``log H_i - log p_i = log k + log d_i + u_c + e_i``. A reading is another column of
log d_i, or more noise; all readings of one model are compared on the same sizes and pixels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from imgscale._typing import FloatArray
from imgscale.claims import Claims
from imgscale.core.posterior import fit_grid, log_evidence
from imgscale.core.segments import MIN_VARIANCE, LogObservations, Parts, normalised
from imgscale.model import ScaleModel

# Where the nearest reference may lie before a shifted horizon, in spreads of D, and how densely.
_SHIFT_RANGE, _SHIFT_CASES = (1e-3, 1e2), 41


class LogK(NamedTuple):
    """
    The posterior of log k as weighted points.

    Attributes
    ----------
    points, weight : (P,) ndarray of float64
        Values of log k and their weights, which sum to 1.
    """

    points: FloatArray
    weight: FloatArray

    @property
    def mean(self) -> float:
        """Mean of log k."""
        return float(self.weight @ self.points)

    @property
    def std(self) -> float:
        """Standard deviation of log k."""
        return math.sqrt(float(self.weight @ (self.points - self.mean) ** 2))


def evidence(
    claims: Claims, log_distance: FloatArray, more_var: FloatArray | float = 0.0
) -> FloatArray:
    """
    Compute how probable readings of the depths make what was seen, one reference in 20 being wrong.

    Parameters
    ----------
    claims : Claims
        What the references claim.
    log_distance : (R, N) ndarray of float
        Log of d under each reading.
    more_var : float or (R, N) ndarray of float
        Variance that a reading adds to the noise.

    Returns
    -------
    (R,) ndarray of float64
        Log of the likelihood up to one constant; log k (a flat prior), the offsets of labels and
        the noise of depths are integrated out.
    """
    by_case = _grid(claims, log_distance, more_var).reshape(-1, claims.depth_var.size)
    total: FloatArray = np.logaddexp.reduce(by_case + np.log(claims.case_weight), axis=1)
    return total


def log_k_of(claims: Claims) -> LogK:
    """
    Find what the claims say of log k, one reference in 20 being wrong.

    Parameters
    ----------
    claims : Claims
        What the references claim, of a kind without a shift.

    Returns
    -------
    LogK
        The posterior.
    """
    grid = fit_grid(_observations(claims, claims.log_distance[None], 0.0))
    points: list[FloatArray] = []
    log_weight: list[FloatArray] = []
    for case, weight in enumerate(claims.case_weight):
        at, log_density = grid.on_grid(case)
        points.append(at)
        log_weight.append(log_density + np.log((at[1] - at[0]) * weight))
    return LogK(np.concatenate(points), normalised(np.concatenate(log_weight), 0))


def chi_square(claims: Claims, log_distance: FloatArray, basis: FloatArray) -> FloatArray:
    """
    Measure how far the references disagree, for each case of the depth noise.

    Parameters
    ----------
    claims : Claims
        What the references claim.
    log_distance : (N,) ndarray of float
        Log of d.
    basis : (N, F) ndarray of float
        Directions that are free: ones for log k.

    Returns
    -------
    (K,) ndarray of float64
        ``min_b (r - B b)' S^-1 (r - B b)``, of N - F degrees of freedom; S holds the offsets of
        labels.
    """
    residual = claims.log_scale - log_distance
    found = np.empty(claims.depth_var.size)
    for case, depth_var in enumerate(claims.depth_var):
        left = _whitened(claims.covariance(depth_var), np.column_stack([residual, basis]))
        rest = _remainder(left[:, 0], left[:, 1:])
        found[case] = rest @ rest
    return found


def score_against(claims: Claims, log_distance: FloatArray) -> FloatArray:
    """
    Test the model's reading of the depths against another, for each case of the depth noise.

    Parameters
    ----------
    claims : Claims
        What the references claim.
    log_distance : (N,) ndarray of float
        Log of d under the other reading.

    Returns
    -------
    (K,) ndarray of float64
        Standard normal where the model's reading is right, and shifted up by the distance of both
        readings where the other is; -inf where they are the same. It is the logarithm of the
        likelihood ratio, brought to mean 0 and variance 1.
    """
    residual = claims.log_scale - claims.log_distance
    apart = log_distance - claims.log_distance
    columns = np.column_stack([residual, apart, np.ones_like(residual)])
    score = np.full(claims.depth_var.size, -np.inf)
    for case, depth_var in enumerate(claims.depth_var):
        seen, wanted, ones = _whitened(claims.covariance(depth_var), columns).T
        contrast = _remainder(wanted, ones[:, None])
        length = float(np.linalg.norm(contrast))
        if length > 1e-9 * float(np.linalg.norm(wanted)):
            score[case] = float(contrast @ seen) / length
    return score


def normal_below(score: FloatArray) -> FloatArray:
    """
    Compute the probability of a standard normal quantity to be below a score.

    Parameters
    ----------
    score : ndarray of float
        The scores.

    Returns
    -------
    ndarray of float64
        Probabilities, 0 to 1.
    """
    from scipy import special  # noqa: PLC0415 - tens of milliseconds of import

    probability: FloatArray = special.ndtr(score)
    return probability


def chi_square_above(chi2: FloatArray, freedom: int) -> FloatArray:
    """
    Compute the probability of a chi-square to be above a value.

    Parameters
    ----------
    chi2 : ndarray of float
        The values.
    freedom : int
        Degrees of freedom, positive.

    Returns
    -------
    ndarray of float64
        Probabilities, 0 to 1.
    """
    from scipy import special  # noqa: PLC0415 - tens of milliseconds of import

    probability: FloatArray = special.chdtrc(freedom, chi2)
    return probability


def shifted(inverse_depth: FloatArray) -> tuple[FloatArray, FloatArray]:
    """
    Spread what the log distances may be where the shift of the inverse depth is unknown.

    Parameters
    ----------
    inverse_depth : (N,) ndarray of float
        Values of D, not all the same.

    Returns
    -------
    log_distance : (B, N) ndarray of float64
        Log of d for B shifts.
    slope : (B, N) ndarray of float64
        Its derivative by the logarithm of the nearest reference's distance from the horizon.
    """
    low, spread = float(inverse_depth.min()), float(np.ptp(inverse_depth))
    farthest = max(_SHIFT_RANGE[1], 5 * float(np.abs(inverse_depth).max()) / spread)
    gap = spread * np.geomspace(_SHIFT_RANGE[0], farthest, _SHIFT_CASES)[:, None]
    beyond = inverse_depth - low + gap
    return -np.log(beyond), -gap / beyond


def log_slant(model: ScaleModel) -> FloatArray | None:
    """
    Compute how much longer the ray to each candidate is than its z-depth.

    Parameters
    ----------
    model : ScaleModel
        The model.

    Returns
    -------
    (N,) ndarray of float64 or None
        Log of ray over z at the centres of the boxes, ``log(1 + tan_x^2 + tan_y^2) / 2``; None
        without a camera or principal point, or where values are no distances.
    """
    camera, size = model.camera, model.image_size
    if camera is None or model.kind not in {"metric", "relative"}:
        return None
    if (camera.cx is None or camera.cy is None) and size is None:
        return None
    centre = [
        middle if given is None else given
        for given, middle in zip((camera.cx, camera.cy), np.array(size or (0, 0)) / 2, strict=True)
    ]
    boxes = np.array([ref.xyxy for ref in model.references if ref.candidate])
    tangent = ((boxes[:, :2] + boxes[:, 2:]) / 2 - centre) / camera.focal_px
    slant: FloatArray = 0.5 * np.log1p((tangent**2).sum(axis=1))
    return slant


def _grid(claims: Claims, log_distance: FloatArray, more_var: FloatArray | float) -> FloatArray:
    """Evidence of each reading and, within it, of each case of the noise."""
    return log_evidence(fit_grid(_observations(claims, log_distance, more_var)))


def _observations(
    claims: Claims, log_distance: FloatArray, more_var: FloatArray | float
) -> LogObservations:
    """Pose every reading, under every case of the noise, as an image of its own."""
    readings, rows = len(log_distance), claims.size
    cases = claims.depth_var.size
    images = readings * cases
    row = np.tile(np.arange(rows), images)
    number = np.repeat(np.arange(images), rows)
    added = np.broadcast_to(more_var, log_distance.shape)[:, None, :]
    noise = claims.noise_var + np.where(claims.firm, 0.0, claims.depth_var[:, None]) + added
    noise = noise.ravel()
    distance = np.repeat(log_distance, cases, axis=0).ravel()
    kinds = Parts(
        claims.kinds.share[row],
        claims.kinds.mean[row] - distance[:, None],
        np.maximum(claims.kinds.variance[row] + noise[:, None], MIN_VARIANCE),
    )
    return LogObservations(
        y=claims.log_scale[row] - distance,
        variance=np.maximum(claims.size_var[row] + noise, MIN_VARIANCE),
        tau=claims.tau[row],
        image=number,
        group=claims.group[row] + (int(claims.group.max()) + 1) * number,
        firm=claims.firm[row],
        mixture=kinds,
    )


def _whitened(covariance: FloatArray, columns: FloatArray) -> FloatArray:
    """Turn columns into ones whose errors are independent and of variance 1."""
    white = np.linalg.solve(np.linalg.cholesky(covariance), columns)
    return np.asarray(white, dtype=np.float64)


def _remainder(column: FloatArray, basis: FloatArray) -> FloatArray:
    """Take the directions of a basis out of a column."""
    fitted = basis @ np.linalg.lstsq(basis, column)[0]
    return np.asarray(column - fitted, dtype=np.float64)
