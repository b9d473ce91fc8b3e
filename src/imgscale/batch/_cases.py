"""
A slab whose answers are averaged over what is not known: posteriors, untold noise, shifts.

The same core as for one image, some thousand images at once.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from imgscale._typing import BoolArray, FloatArray, IntArray
from imgscale.batch._slab import (
    ONE_DEPTH,
    OUTLIER,
    ImageResults,
    Options,
    RowResults,
    Slab,
    image_flags,
    noise_var,
)
from imgscale.core.evidence import REJECTED
from imgscale.core.predictive import scale_of
from imgscale.core.segments import Parts
from imgscale.core.sighting import log_scales
from imgscale.core.solving import Cases, Estimate, Problem, estimate, solve
from imgscale.core.witnesses import Sized
from imgscale.estimate import quantile_columns
from imgscale.flags import Flag
from imgscale.posing import SAME_DEPTH
from imgscale.sizing import FAR_OFF, TWO_STD, Sizes, Wanted, size_up

# Objects that are solved at once.
_PART = 4096


def fit_slab(
    slab: Slab,
    candidates: IntArray | None,
    options: Options,
    images: ImageResults,
    rows: RowResults,
) -> None:
    """
    Fit every image that can be fitted, and size all its objects.

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
    everything = np.arange(slab.code.size) if candidates is None else candidates
    candidate = np.zeros(slab.code.size, dtype=np.bool_)
    candidate[everything] = True
    if options.law.has_shift:
        _leave_out_flat(slab, candidate, images, rows)
    for column in rows[:4]:
        column[:] = np.nan
    for first, last in _parts(slab):
        here = slice(int(slab.first[first]), int(slab.first[last - 1] + slab.counts[last - 1]))
        part = Slab(
            slab.code[here], slab.pixels[here], slab.depth[here], None,
            slab.first[first:last] - slab.first[first], slab.counts[first:last],
        )  # fmt: skip
        _fit_part(
            part,
            candidate[here],
            options,
            images.part(slice(first, last)),
            rows.part(here),
        )


def _parts(slab: Slab) -> list[tuple[int, int]]:
    """Cut a slab into groups of images."""
    ends = slab.first + slab.counts
    cuts = [0]
    while cuts[-1] < ends.size:
        limit = int(slab.first[cuts[-1]]) + _PART
        cuts.append(max(int(np.searchsorted(ends, limit, side="right")), cuts[-1] + 1))
    return list(pairwise(cuts))


def _leave_out_flat(
    slab: Slab, candidate: BoolArray, images: ImageResults, rows: RowResults
) -> None:
    """Leave out images whose references, all at one depth, do not tell shift and scale apart."""
    highest = np.maximum.reduceat(np.where(candidate, slab.depth, -np.inf), slab.first)
    lowest = np.minimum.reduceat(np.where(candidate, slab.depth, np.inf), slab.first)
    with np.errstate(invalid="ignore"):
        spread = highest - lowest
        flat = ~(spread > SAME_DEPTH * np.maximum(np.abs(highest), np.abs(lowest)))
    lost = np.repeat(flat, slab.counts) & candidate
    rows.reason[lost] = ONE_DEPTH
    candidate[lost] = False
    images.n_candidates[flat] = 0


def _fit_part(
    slab: Slab,
    candidate: BoolArray,
    options: Options,
    images: ImageResults,
    rows: RowResults,
) -> None:
    """Fit and size some images."""
    used = np.flatnonzero(images.n_candidates)
    if not used.size:
        return
    number = np.full(slab.first.size, -1, dtype=np.intp)
    number[used] = np.arange(used.size)
    image = np.repeat(number, slab.counts)
    known = (image >= 0) & ~np.isnan(slab.depth)
    objects = _sized(slab, image, options)
    witnesses = objects.rows(candidate)
    groups = witnesses.group + witnesses.image * options.labels.group.size
    witnesses = witnesses._replace(group=np.unique(groups, return_inverse=True)[1].astype(np.intp))
    problem = Problem(
        witnesses=witnesses,
        n_images=used.size,
        has_shift=options.law.has_shift,
        unknown_noise=options.unknown_noise,
        exact=options.method == "posterior",
    )
    cases = solve(problem)
    found = estimate(problem, cases)
    rejected = found.trust < REJECTED
    _put_models(images, used, cases, found, witnesses, rejected, options)
    share, out = np.zeros(candidate.size), np.zeros(candidate.size, dtype=np.bool_)
    share[candidate], out[candidate] = found.share, rejected
    rows.weight[:] = share
    rows.reason[out] = OUTLIER
    rows.flags[:] = np.where(out, Flag.OUTLIERS.value, np.where(share > 0, Flag.REFERENCE.value, 0))
    wanted = Wanted(
        subjects=objects.rows(known),
        own=np.full(int(known.sum()), -1, dtype=np.intp),
        common_var=objects.noise_var[known],
        share=share[known],
        fuse=np.zeros(int(known.sum()), dtype=np.bool_),
        rejected=out[known],
        log_k=found.log_k[image[known]],
    )
    sizes = size_up(cases, wanted)
    _put_sizes(rows, np.flatnonzero(known), sizes, options.score)
    if options.law.has_shift:
        _flag_shifted(rows, np.flatnonzero(known), sizes, wanted, witnesses, cases)


def _sized(slab: Slab, image: IntArray, options: Options) -> Sized:
    """Turn objects into columns of the core."""
    labels, code, count = options.labels, slab.code, slab.code.size
    return Sized(
        inverse_depth=options.law.inverse_depth(slab.depth),
        log_pixels=np.log(slab.pixels),
        noise_var=noise_var(slab.pixels, options),
        prior=Parts(*(column[code] for column in labels.kinds)),
        prior_log=labels.log_mean[code],
        prior_var=labels.log_var[code],
        tau=labels.tau[code],
        image=image,
        group=labels.group[code],
        told=np.full(count, not options.unknown_noise),
        firm=np.zeros(count, dtype=np.bool_),
    )


def _put_models(
    images: ImageResults,
    used: IntArray,
    cases: Cases,
    found: Estimate,
    witnesses: Sized,
    rejected: BoolArray,
    options: Options,
) -> None:
    """Write the models."""
    images.k[used] = np.exp(found.log_k)
    images.k_std[used] = images.k[used] * scale_of(cases).half_width()
    if options.law.has_shift:
        images.shift[used] = found.shift
    sound = ~rejected
    n_used = np.bincount(witnesses.image[sound], minlength=used.size)
    group, image = witnesses.group[sound], witnesses.image[sound]
    # groups are numbered image by image
    highest, lowest = np.full(used.size, -1), np.full(used.size, witnesses.group.size)
    np.maximum.at(highest, image, group)
    np.minimum.at(lowest, image, group)
    image_flags(
        images, used, n_used.astype(images.n_used.dtype),
        single_label=highest == lowest, disagree=found.inconsistent,
    )  # fmt: skip


def _put_sizes(rows: RowResults, known: IntArray, sizes: Sizes, score: float) -> None:
    """Write sizes and the ends of their intervals."""
    rows.size_m[known], rows.std_m[known] = sizes.size_m, sizes.std_m
    low, high = quantile_columns(sizes.quantiles_m, score)
    rows.low_m[known] = np.minimum(low, sizes.size_m)
    rows.high_m[known] = np.maximum(high, sizes.size_m)


def _flag_shifted(
    rows: RowResults,
    known: IntArray,
    sizes: Sizes,
    wanted: Wanted,
    witnesses: Sized,
    cases: Cases,
) -> None:
    """Flag what is far from the references of its image, or beyond its horizon."""
    seen, count = log_scales(witnesses, cases.best)[1][0], cases.log_weight.shape[1]
    nearest, farthest = np.full(count, np.inf), np.full(count, -np.inf)
    at_all = ~np.isnan(seen)
    np.minimum.at(nearest, witnesses.image[at_all], seen[at_all])
    np.maximum.at(farthest, witnesses.image[at_all], seen[at_all])
    image = wanted.subjects.image
    own: FloatArray = np.log(sizes.range_per_focal) - wanted.log_k
    reach = np.log(FAR_OFF)
    far_off = (own < nearest[image] - reach) | (own > farthest[image] + reach)
    far_off &= cases.best.shift[0, image] != 0
    beyond = np.isnan(sizes.metres_per_pixel) | np.isposinf(sizes.quantiles_m[:, TWO_STD])
    rows.flags[known[far_off]] |= Flag.EXTRAPOLATED.value
    rows.flags[known[beyond & (cases.best.shift[0, image] != 0)]] |= Flag.BEYOND_HORIZON.value
