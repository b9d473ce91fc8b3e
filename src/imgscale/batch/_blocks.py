"""A slab whose sizes are log-normal: images of as many references each, side by side in blocks."""

from __future__ import annotations

import numpy as np

from imgscale._typing import BoolArray, FloatArray, IntArray
from imgscale.batch._slab import (
    OUTLIER,
    ImageResults,
    Options,
    RowResults,
    Slab,
    image_flags,
    log_extent,
    noise_var,
)
from imgscale.core.blocks import Block, BlockFit, fit_block, share_out
from imgscale.core.closed_form import least_squares, mean_ratio
from imgscale.core.evidence import REJECTED
from imgscale.core.ordering import column_order
from imgscale.core.segments import MIN_VARIANCE
from imgscale.flags import Flag

# Cells of a block: its arrays stay in the processor's cache.
_CELLS = 49_152
_REFERENCE, _OUTLIERS = Flag.REFERENCE.value, Flag.OUTLIERS.value


def fit_slab(
    slab: Slab,
    candidates: IntArray | None,
    options: Options,
    images: ImageResults,
    rows: RowResults,
) -> None:
    """
    Fit every image with a candidate, and size its candidates.

    Parameters
    ----------
    slab : Slab
        The objects.
    candidates : (C,) ndarray of int or None
        Those that can be references, in order; None where all can.
    options : Options
        What holds for all.
    images : ImageResults
        Where the models go.
    rows : RowResults
        Where the sizes go.
    """
    count = images.n_candidates
    first = slab.first if candidates is None else np.cumsum(count) - count
    for size in np.flatnonzero(np.bincount(count, minlength=1)).tolist():
        if not size:
            continue
        these = np.flatnonzero(count == size)
        width = max(_CELLS // size, 1)
        for start in range(0, these.size, width):
            some = these[start : start + width]
            places = first[some] + np.arange(size)[:, None]
            members = places if candidates is None else candidates[places]
            _fit_block(slab, some, members, options, images, rows)


def _fit_block(
    slab: Slab,
    some: IntArray,
    members: IntArray,
    options: Options,
    images: ImageResults,
    rows: RowResults,
) -> None:
    """Fit the images `some`, whose candidates are `members` (q, m)."""
    labels, code = options.labels, slab.code[members]
    if len(members) > 1:
        order = column_order(labels.group[code]) * some.size + np.arange(some.size)
        members, code = members.ravel()[order], code.ravel()[order]
    log_size, pixels = log_extent(slab, members, options.law)
    noise = noise_var(pixels, options)
    block = Block(
        y=labels.log_mean[code] - log_size,
        variance=np.maximum(labels.log_var[code] + noise, MIN_VARIANCE),
        tau=labels.tau[code],
        group=labels.group[code],
    )
    if options.method == "robust":
        fit = fit_block(block)
    else:
        fit = _closed(block, log_size, np.log(labels.mean_m[code]), options)
    images.k[some] = np.exp(fit.log_k)
    images.k_std[some] = images.k[some] * fit.log_std
    rejected = fit.trust < REJECTED
    n_used = len(members) - np.add.reduce(rejected, axis=0, dtype=np.int32)
    image_flags(
        images, some, n_used,
        single_label=_single_label(block.group, rejected), disagree=fit.disagree,
    )  # fmt: skip
    _size(members, log_size, noise, fit, rejected, options.score, rows)


def _closed(block: Block, log_size: FloatArray, log_mean: FloatArray, options: Options) -> BlockFit:
    """Fit by one of the paper's methods, to arithmetic means."""
    closed_form = mean_ratio if options.method == "mean_ratio" else least_squares
    k, share = closed_form(np.exp(log_size), np.exp(log_mean))
    return share_out(block._replace(y=log_mean - log_size), np.log(k), share)


def _single_label(group: IntArray, rejected: BoolArray) -> BoolArray:
    """Tell where all that was used is of one label; neighbours are of one label."""
    single: BoolArray = np.logical_and.reduce(group[1:] == group[:-1], axis=0)
    doubtful = np.flatnonzero(np.logical_or.reduce(rejected, axis=0) & ~single)
    if doubtful.size:
        group, rejected = group[:, doubtful], rejected[:, doubtful]
        lowest = np.where(rejected, group.max(), group).min(axis=0)
        single[doubtful] = lowest == np.where(rejected, -1, group).max(axis=0)
    return single


def _size(
    members: IntArray,
    log_size: FloatArray,
    noise: FloatArray,
    fit: BlockFit,
    rejected: BoolArray,
    score: float,
    rows: RowResults,
) -> None:
    """Size the candidates, whose errors are in k by their shares."""
    variance = fit.log_std**2 + noise * (1 - 2 * fit.share)
    rows.put(members, fit.log_k + log_size, np.maximum(variance, 0.0), score)
    rows.weight[members] = fit.share
    rows.flags[members] = np.where(rejected, _OUTLIERS, (fit.share > 0) * _REFERENCE)
    out = members[rejected]
    if out.size:
        rows.reason[out] = OUTLIER
