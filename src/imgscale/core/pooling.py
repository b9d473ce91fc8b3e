"""
What references of many frames of one camera say together, arrays only.

The frames are first solved as one image, which tells how far each reference is believed. Repeated
views of one object share its own deviation from the mean, so that r of them weigh as
``1 / (r s^2 + noise)`` each; the sums of these weights are all that another frame needs to know.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from imgscale._typing import BoolArray, FloatArray, IntArray
from imgscale.core.evidence import SOUND, outlier_density
from imgscale.core.segments import MIN_VARIANCE, normalised
from imgscale.core.sighting import log_scales, observe_under
from imgscale.core.solving import Cases, Estimate
from imgscale.core.witnesses import Nuisance, Sized

# Steps of the numerical derivatives, in pixels and slope.
_STEP_PX, _STEP_SLOPE = 1e-3, 1e-6
_LEAST_TRUST = 1e-6


class PooledRows(NamedTuple):
    """
    References of all frames, as they are believed.

    Attributes
    ----------
    log_k : (N,) ndarray of float64
        Log k as each gives it, at the best plane.
    precision : (N,) ndarray of float64
        Its inverse variance, repeats taken into account.
    lean : (N, 2) ndarray of float64
        Its derivatives by horizon and slope.
    trust : (N,) ndarray of float64
        How far it is believed.
    kind : (N,) ndarray of int
        The kind of thing that it most probably is.
    kind_probability : (N,) ndarray of float64
        Probability that it is sound and of that kind.
    """

    log_k: FloatArray
    precision: FloatArray
    lean: FloatArray
    trust: FloatArray
    kind: IntArray
    kind_probability: FloatArray

    def rows(self, rows: BoolArray) -> PooledRows:
        """
        Take some rows.

        Parameters
        ----------
        rows : (N,) ndarray of bool
            Which.

        Returns
        -------
        PooledRows
            The rows.
        """
        columns: list[Any] = [column[rows] for column in self]
        return PooledRows(*columns)

    def joined(self, more: PooledRows) -> PooledRows:
        """
        Add rows.

        Parameters
        ----------
        more : PooledRows
            The rows.

        Returns
        -------
        PooledRows
            First these, then those.
        """
        columns: list[Any] = [np.concatenate(pair) for pair in zip(self, more, strict=True)]
        return PooledRows(*columns)


class Totals(NamedTuple):
    """
    Sums over references: all that others need to know of them.

    Attributes
    ----------
    weight, log_k : (C,) ndarray of float64
        Precision of each label and the sum of log k, weighted.
    lean : (C, 2) ndarray of float64
        Weighted sum of the derivatives.
    square : (C, 2, 2) ndarray of float64
        Weighted sum of their products.
    cross : (C, 2) ndarray of float64
        Weighted sum of the derivatives times log k.
    """

    weight: FloatArray
    log_k: FloatArray
    lean: FloatArray
    square: FloatArray
    cross: FloatArray

    def without(self, part: Totals) -> Totals:
        """
        Take some references out.

        Parameters
        ----------
        part : Totals
            Their sums.

        Returns
        -------
        Totals
            The sums over the rest.
        """
        return Totals(*(whole - own for whole, own in zip(self, part, strict=True)))

    def plane(self) -> tuple[FloatArray, FloatArray]:
        """
        Tell what the scatter of the references says of horizon and slope.

        Returns
        -------
        shift : (2,) ndarray of float64
            By how much they lie off those at which the derivatives were taken.
        precision : (2, 2) ndarray of float64
            Precision matrix.
        """
        weight = np.maximum(self.weight, np.finfo(np.float64).tiny)
        precision = (
            self.square - self.lean[:, :, None] * self.lean[:, None, :] / weight[:, None, None]
        ).sum(axis=0)
        gradient = (self.cross - self.lean * (self.log_k / weight)[:, None]).sum(axis=0)
        shift = np.asarray(-np.linalg.pinv(precision) @ gradient, dtype=np.float64)
        return shift, np.asarray(precision, dtype=np.float64)


def level_weights(log_evidence: FloatArray, log_prior: FloatArray, share: float) -> FloatArray:
    """
    Weigh the levels of a noise by what all frames say.

    Parameters
    ----------
    log_evidence : (L, n_frames) ndarray of float
        Log of the evidence of each level.
    log_prior : (L,) ndarray of float
        Log of its probability beforehand.
    share : float
        How much a frame tells, compared with independent ones.

    Returns
    -------
    (L,) ndarray of float64
        Probabilities.
    """
    return normalised(log_prior + share * log_evidence.sum(axis=1), 0)


def pooled_rows(witnesses: Sized, repeats: FloatArray, cases: Cases, found: Estimate) -> PooledRows:
    """
    Resolve the references of all frames.

    Parameters
    ----------
    witnesses : Sized
        N references, as one image.
    repeats : (N,) ndarray of float
        How often its object was seen.
    cases : Cases
        The solutions; its first N rows are the references.
    found : Estimate
        Their summary.

    Returns
    -------
    PooledRows
        One row for each.
    """
    rows = np.arange(witnesses.image.size)
    trust, kinds = found.trust[rows], np.maximum(found.kinds[rows], 0.0)
    share = kinds / np.maximum(kinds.sum(axis=1, keepdims=True), _LEAST_TRUST)
    share = np.where((trust > _LEAST_TRUST)[:, None], share, witnesses.prior.share)
    mean = (share * witnesses.prior.mean).sum(axis=1)
    within = (share * witnesses.prior.variance).sum(axis=1)
    between = (share * (witnesses.prior.mean - mean[:, None]) ** 2).sum(axis=1)
    # what each kept: with the scatter beyond the errors, by the robust solver with all its kinds
    kept = found.precision[rows]
    variance = trust / np.maximum(kept, _LEAST_TRUST) + (0.0 if cases.grid is None else between)
    variance = variance + (repeats - 1) * (within + between)
    best = cases.best
    log_size = log_scales(witnesses, best)[0][0] + witnesses.log_pixels
    usable = np.isfinite(log_size) & (kept > 0)
    return PooledRows(
        log_k=np.where(usable, mean - log_size, 0.0),
        precision=np.where(usable, trust / np.maximum(variance, MIN_VARIANCE), 0.0),
        lean=np.where(usable[:, None], _lean(witnesses, best), 0.0),
        trust=trust,
        kind=kinds.argmax(axis=1),
        kind_probability=kinds.max(axis=1),
    )


def judged_rows(witnesses: Sized, best: Nuisance, log_k: float) -> PooledRows:
    """
    Judge references by a scale that others found, without giving them weight.

    Parameters
    ----------
    witnesses : Sized
        N references of one image, of which the noise is told.
    best : Nuisance
        The best case.
    log_k : float
        Log of the scale constant.

    Returns
    -------
    PooledRows
        Of precision 0.
    """
    obs = observe_under(witnesses._replace(group=np.arange(witnesses.image.size)), best)
    shared_var = witnesses.tau**2
    variance = obs.kinds.variance + shared_var[:, None]
    residual = obs.kinds.mean - log_k
    density = SOUND * obs.kinds.share * np.exp(-0.5 * residual**2 / variance) / np.sqrt(variance)
    n_kinds = witnesses.prior.share.shape[1]
    n_ways = density.shape[1] // n_kinds  # in which each kind of thing may stand there
    kinds = density.reshape(len(density), n_kinds, n_ways).sum(axis=2)
    wrong = outlier_density(obs.y - log_k, obs.variance + shared_var)
    kinds = kinds / (kinds.sum(axis=1) + wrong)[:, None]
    zero = np.zeros(obs.y.size)
    return PooledRows(
        log_k=zero + log_k,
        precision=zero,
        lean=np.zeros((obs.y.size, 2)),
        trust=kinds.sum(axis=1),
        kind=kinds.argmax(axis=1),
        kind_probability=kinds.max(axis=1),
    )


def totals(rows: PooledRows, group: IntArray, n_groups: int) -> Totals:
    """
    Sum references up by their labels.

    Parameters
    ----------
    rows : PooledRows
        The references.
    group : (N,) ndarray of int
        Their labels.
    n_groups : int
        Number of labels.

    Returns
    -------
    Totals
        The sums.
    """

    def by_label(values: FloatArray) -> FloatArray:
        result = np.zeros((n_groups, *values.shape[1:]))
        np.add.at(result, group, values)
        return result

    weight = rows.precision
    return Totals(
        weight=by_label(weight),
        log_k=by_label(weight * rows.log_k),
        lean=by_label(weight[:, None] * rows.lean),
        square=by_label(weight[:, None, None] * rows.lean[:, :, None] * rows.lean[:, None, :]),
        cross=by_label((weight * rows.log_k)[:, None] * rows.lean),
    )


def common_offsets(
    rows: PooledRows, group: IntArray, frame: IntArray, tau: FloatArray
) -> FloatArray:
    """
    Estimate the labels' offsets that frames share, each frame having a scale of its own.

    Parameters
    ----------
    rows : PooledRows
        The references.
    group, frame : (N,) ndarray of int
        Label and frame of each.
    tau : (C,) ndarray of float
        Standard deviation of each label's offset.

    Returns
    -------
    (C,) ndarray of float64
        The offsets: the most probable ones, by least squares.
    """
    n_groups, n_frames = tau.size, int(frame.max(initial=-1)) + 1
    weight = np.zeros((n_frames, n_groups))
    sums = np.zeros((n_frames, n_groups))
    np.add.at(weight, (frame, group), rows.precision)
    np.add.at(sums, (frame, group), rows.precision * rows.log_k)
    total = np.maximum(weight.sum(axis=1), np.finfo(np.float64).tiny)
    # log k of each frame eliminated
    matrix = np.diag(weight.sum(axis=0)) - weight.T @ (weight / total[:, None])
    gradient = sums.sum(axis=0) - weight.T @ (sums.sum(axis=1) / total)
    free = tau > 0
    offsets = np.zeros(n_groups)
    inner = matrix[np.ix_(free, free)] + np.diag(tau[free] ** -2.0)
    offsets[free] = np.linalg.solve(inner, gradient[free])
    return offsets


def _lean(witnesses: Sized, best: Nuisance) -> FloatArray:
    """Derive each log k by horizon and slope, (N, 2); 0 without a plane."""
    lean = np.zeros((witnesses.image.size, 2))
    if best.horizon is None or best.slope is None:
        return lean
    horizon, slope = best.horizon, best.slope
    moves = (
        (_STEP_PX, {"horizon": horizon + _STEP_PX}, {"horizon": horizon - _STEP_PX}),
        (_STEP_SLOPE, {"slope": slope + _STEP_SLOPE}, {"slope": slope - _STEP_SLOPE}),
    )
    for column, (step, up, down) in enumerate(moves):
        above, below = (log_scales(witnesses, best._replace(**move))[0][0] for move in (up, down))
        lean[:, column] = -(above - below) / (2 * step)
    return lean
