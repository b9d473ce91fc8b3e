"""
The exact posterior of log k on a grid: arrays only, many images at once.

The model is that of `segments`, with references of which some are wrong. A reference of label c
sees v = log k + u_c, and its likelihood is

    g_i(v) = 0.95 sum_j w_j N(y_ij - v; v_ij) + outliers(y_i - v),

where j runs over the kinds of thing that the label may be, N(.; variance) is the normal density and
the outliers are those of `evidence`. With g_c the product over a label's references, the likelihood
of log k is the product over the labels of g_c convolved with N(0, tau_c^2). Where a label has one
reference, its convolution is known in closed form.

Every image has a grid of its own, which depends on no other image. Images with grids of one size
are solved together.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imgscale._typing import BoolArray, FloatArray, IntArray
from imgscale.core.lattice import (
    Lattice,
    Likelihood,
    Offsets,
    Ordered,
    Scratch,
    in_order,
    likelihood,
    picked,
    starts,
    summed,
)
from imgscale.core.segments import LogFit, LogObservations, Subjects, View, normalised, shares_of_k

# The grid: at most 0.4 standard deviations of the sharpest label apart, and 0.8 of those of log k;
# where they are more than half of those apart, objects see points between them too.
_STEP, _STEP_OF_K, _COARSE = 0.4, 0.8, 0.5
_LARGEST_GRID = 8192
# How far it reaches, in standard deviations, and for outliers.
_REACH = 5.0
_OUTLIER_REACH = 3.0
# Grids of more points than this are first looked at on every fourth, and then laid where the log
# likelihood is less than 27 below its largest. Each reference may be left out, which is up to 9.
_LOOK, _COARSER, _LOWEST_OF_LOOK = 104, 4, 27.0
_LARGEST_LOOK = 2048
# How far the offset of a label may move its grid, in standard deviations.
_OFFSET_REACH = 7.0
# A firm witness this much sharper than a label's references stands on points of its own.
_SHARPER, _LARGEST_APART = 0.25, 1024
# Offsets wider than this are convolved with the grid even for one reference.
_WIDEST_ALONE = 1.0
# Log likelihoods are cut off here, relative to their largest: exp() of them is still a number.
_LOWEST = -600.0
# Points whose weight is less than the best one's by this factor (its log) are left out.
_NEGLIGIBLE = 21.0
# Numbers that are worked on at once.
_BLOCK = 60_000
_TINY = float(np.finfo(np.float64).tiny)


class Piece(NamedTuple):
    """
    Images with grids of the same size G: n images, N references, C labels of which S are shared.

    Attributes
    ----------
    block : Ordered
        The references.
    own_var : (n,) ndarray of float64
        Variance added to every reference where the points cannot resolve them; 0 as a rule.
    scale : Lattice
        Values of log k, n rows.
    label : Lattice
        Values of v = log k + u, a row for each label.
    is_same : bool
        True where those of the labels are those of their images.
    is_coarse : bool
        True where objects see points between these, too.
    shared : (S,) ndarray of int
        Labels with several references and an offset: these see v, all others log k.
    log_density : (n, G) ndarray of float64
        Log likelihood of log k.
    log_row : (N, G) ndarray of float64
        Log likelihood of each reference.
    log_group : (S, G) ndarray of float64
        The sum of it over the label's.
    log_shared : (S, G) ndarray of float64
        The same as a function of log k, the offset integrated out.
    """

    block: Ordered
    own_var: FloatArray
    scale: Lattice
    label: Lattice
    is_same: bool
    is_coarse: bool
    shared: IntArray
    log_density: FloatArray
    log_row: FloatArray
    log_group: FloatArray
    log_shared: FloatArray


class GridFit(NamedTuple):
    """
    Posteriors of log k of many images, each on a grid of its own.

    Attributes
    ----------
    log_evidence, mean, std : (n_images,) ndarray of float64
        Log of the likelihood with log k integrated out; mean and standard deviation of log k.
    kinds : (N, J) ndarray of float64
        Probability that each reference is sound and of the kind j of its label.
    n_references : (n_images,) ndarray of int
        Number of references.
    laid : tuple
        Images, references and points of each piece.
    kept : tuple of Piece
        What is there, where there is but one piece. Many are evaluated again when they are looked
        at: to keep them takes more time and memory, unless one looks often.
    of_piece, image, group, row : ndarray of int
        In which piece each image is, and the number there of each image, group and reference.
    """

    log_evidence: FloatArray
    mean: FloatArray
    std: FloatArray
    kinds: FloatArray
    n_references: IntArray
    laid: tuple[tuple[IntArray, Ordered, Grid], ...]
    kept: tuple[Piece, ...]
    of_piece: IntArray
    image: IntArray
    group: IntArray
    row: IntArray

    def piece(self, number: int) -> Piece:
        """
        Evaluate a piece, or take it where it is known.

        Parameters
        ----------
        number : int
            Which.

        Returns
        -------
        Piece
            What is there.
        """
        if self.kept:
            return self.kept[number]
        _, block, grid = self.laid[number]
        return _evaluated(block, grid, Scratch())[0]

    def keeping(self) -> GridFit:
        """
        Evaluate all pieces, to be looked at more than once.

        Returns
        -------
        GridFit
            The same, with every piece.
        """
        return self._replace(kept=tuple(self.piece(number) for number in range(len(self.laid))))

    def on_grid(self, image: int) -> tuple[FloatArray, FloatArray]:
        """
        Look at one posterior.

        Parameters
        ----------
        image : int
            Which image.

        Returns
        -------
        points, log_density : (G,) ndarray of float64
            Values of log k, equally spaced, and the log of the likelihood there.
        """
        piece, row = self.piece(int(self.of_piece[image])), self.image[image : image + 1]
        return piece.scale.rows(row).points[0], piece.log_density[row[0]]


def fit_grid(obs: LogObservations) -> GridFit:
    """
    Evaluate the posterior of log k of every image.

    Parameters
    ----------
    obs : LogObservations
        The references; every image has at least one.

    Returns
    -------
    GridFit
        The posteriors.
    """
    block = in_order(obs)
    n_images, n_groups = block.image_size.size, block.group.size
    log_evidence, mean, std = np.empty((3, n_images))
    n_kinds = obs.kinds.share.shape[1]
    kinds = np.empty((obs.y.size, n_kinds))
    of_piece, image = np.empty((2, n_images), dtype=np.intp)
    group, row = np.empty(n_groups, dtype=np.intp), np.empty(obs.y.size, dtype=np.intp)
    work, pieces = Scratch(), _laid(block)
    piece: Piece | None = None
    for number, (which, part, grid) in enumerate(pieces):
        piece, seen = _evaluated(part, grid, work)
        below = piece.log_density - piece.log_density.max(axis=1, keepdims=True)
        density = np.exp(np.maximum(below, _LOWEST))
        total, first, second = (density @ piece.scale.powers.T).T
        first, second = first / total, second / total
        step = piece.scale.step
        log_evidence[which] = piece.log_density.max(axis=1) + np.log(total * step)
        mean[which] = piece.scale.centre + step * first
        std[which] = step * np.sqrt(second - first**2)
        weight = _weights(piece, density / total[:, None], work)
        kinds[part.row] = seen.expected(weight, n_kinds, work)
        of_piece[which], image[which] = number, np.arange(which.size)
        group[part.group], row[part.row] = np.arange(part.group.size), np.arange(part.row.size)
    return GridFit(
        log_evidence=log_evidence,
        mean=mean,
        std=std,
        kinds=kinds,
        n_references=block.image_size,
        laid=pieces,
        kept=(piece,) if piece is not None and len(pieces) == 1 else (),
        of_piece=of_piece,
        image=image,
        group=group,
        row=row,
    )


def log_evidence(fit: GridFit) -> FloatArray:
    """
    Tell the evidence of each image's references.

    Parameters
    ----------
    fit : GridFit
        The posteriors.

    Returns
    -------
    (n_images,) ndarray of float64
        Log of the likelihood, log k integrated out.
    """
    return fit.log_evidence


def believe(obs: LogObservations, fit: GridFit) -> tuple[LogFit, FloatArray]:
    """
    Summarise the posteriors: how far each reference was believed, and k from those that were.

    Parameters
    ----------
    obs : LogObservations
        The references.
    fit : GridFit
        Their posteriors.

    Returns
    -------
    summary : LogFit
        Log k is the mean of the references' own, weighted by the precisions that they kept.
    kinds : (N, J) ndarray of float64
        Probability that each is sound and of the kind j of its label.
    """
    part = obs.kinds
    kept = fit.kinds / part.variance
    precision = kept.sum(axis=1)
    share = shares_of_k(obs, precision)
    believed = precision > 0
    own = (kept * part.mean).sum(axis=1)
    own_k = np.where(believed, own / np.where(believed, precision, 1.0), obs.y)
    log_k: FloatArray = np.bincount(obs.image, share * own_k, fit.mean.size).astype(np.float64)
    summary = LogFit(
        log_k=log_k,
        log_std=fit.std,
        trust=fit.kinds.sum(axis=1),
        weight=precision,
        share=share,
    )
    return summary, fit.kinds


def view_on_grid(fit: GridFit, subjects: Subjects) -> View:
    """
    Tell what all other references say of log k and of a label's offset, for any objects.

    Parameters
    ----------
    fit : GridFit
        The posteriors.
    subjects : Subjects
        The objects.

    Returns
    -------
    View
        A case for each point of a window that holds all the mass. To objects that share the offset
        of other references the points are those of v = log k + u, with log k given v; to others
        those of log k. The weights hold the evidence of the references.
    """
    piece_of = fit.of_piece[subjects.image]
    parts: list[tuple[IntArray, View]] = []
    for number in np.unique(piece_of):
        here = np.flatnonzero(piece_of == number)
        image, group, own = (
            column[here] for column in (subjects.image, subjects.group, subjects.own)
        )
        parts.append(
            (
                here,
                _view(
                    fit.piece(int(number)),
                    Subjects(
                        image=fit.image[image],
                        group=np.where(group >= 0, fit.group[group], -1),
                        tau=subjects.tau[here],
                        own=np.where(own >= 0, fit.row[own], -1),
                    ),
                ),
            )
        )
    if len(parts) == 1:
        return parts[0][1]
    width = max((part.log_weight.shape[1] for _, part in parts), default=1)
    view = View(*np.zeros((6, subjects.image.size, width)))
    for here, part in parts:
        more = width - part.log_weight.shape[1]
        for column, own_column in zip(view, part, strict=True):
            column[here] = np.pad(own_column, ((0, 0), (0, more)), mode="edge")
        view.log_weight[here, width - more :] = -np.inf
    return view


# --- where the points are --------------------------------------------------------------------


class Grid(NamedTuple):
    """Where the points of n images are: first and last, number, and whether a firm one is apart."""

    first: FloatArray
    last: FloatArray
    size: IntArray
    step: FloatArray
    apart: BoolArray
    coarse: BoolArray

    def rows(self, rows: IntArray) -> Grid:
        """
        Take some images.

        Parameters
        ----------
        rows : (m,) ndarray of int
            Which.

        Returns
        -------
        Grid
            Their points.
        """
        return Grid(
            first=self.first[rows],
            last=self.last[rows],
            size=self.size[rows],
            step=self.step[rows],
            apart=self.apart[rows],
            coarse=self.coarse[rows],
        )

    @property
    def kind(self) -> IntArray:
        """Number that is the same for grids that can be solved together."""
        kind: IntArray = self.size + (self.apart + 2 * self.coarse) * (2 * _LARGEST_GRID)
        return kind

    @property
    def lattice(self) -> Lattice:
        """The points, in rows of one size."""
        size = int(self.size[0])
        return Lattice((self.first + self.last) / 2, (self.last - self.first) / (size - 1), size)


def _laid(block: Ordered) -> tuple[tuple[IntArray, Ordered, Grid], ...]:
    """Lay all grids: which images, their references, and their points, of one size."""
    grid = _looked_at(block, _grid(block))
    return tuple(
        (which, picked(block, which), grid.rows(which)) for which in _blocks(block, grid.kind)
    )


def _blocks(block: Ordered, kind: IntArray) -> list[IntArray]:
    """Split images into sets of one kind whose numbers fit into the processor's cache."""
    if kind.size == 1:
        return [np.zeros(1, dtype=np.intp)]
    order = np.argsort(kind, kind="stable")
    ordered, rows = kind[order], block.image_size[order]
    new = np.flatnonzero(ordered[1:] != ordered[:-1]) + 1
    parts: list[IntArray] = []
    for first, end in zip([0, *new], [*new, order.size], strict=True):
        height = max(1, _BLOCK // int(ordered[first] % (2 * _LARGEST_GRID)))
        number = starts(rows[first:end]) // height
        cuts = np.flatnonzero(number[1:] != number[:-1]) + 1
        parts += np.split(order[first:end], cuts)
    return parts


def _grid(block: Ordered) -> Grid:
    """Place each image's points."""
    rows, tau, images = block.rows, block.group_tau, block.image_first
    groups, first_group = block.group_first, block.image_first_group
    used = rows.kinds.share[:, :-1] > 0
    mean, variance = (column[:, :-1] for column in rows.kinds[1:])
    least_var = np.where(used, variance, np.inf).min(axis=1)
    low = np.where(used, mean, np.inf).min(axis=1)
    high = np.where(used, mean, -np.inf).max(axis=1)
    fallible = np.add.reduceat(~rows.firm, images, dtype=np.intp)
    reach = _REACH * np.sqrt(np.minimum.reduceat(least_var + rows.tau**2, images))
    reach += np.where(fallible > 0, _OUTLIER_REACH / np.maximum(fallible, 1), 0.0)
    first = np.minimum.reduceat(low, images) - reach
    last = np.maximum.reduceat(high, images) + reach
    information = np.add.reduceat(1 / least_var, groups)
    label_std = 1 / np.sqrt(np.maximum.reduceat(information, first_group))
    k_std = 1 / np.sqrt(np.add.reduceat(1 / (1 / information + tau**2), first_group))
    step = np.minimum(_STEP * label_std, _STEP_OF_K * k_std)
    no = np.zeros(images.size, dtype=np.bool_)
    grid = Grid(first, last, fallible, step, no, step > _COARSE * k_std)
    if rows.firm.any():
        return _firm(block, grid, least_var, information)
    return grid._replace(size=_sizes((last - first) / step, _LARGEST_GRID))


def _firm(block: Ordered, grid: Grid, least_var: FloatArray, information: FloatArray) -> Grid:
    """Leave no other place than that of the firm witnesses, but for the labels' offsets."""
    rows, images, first_group = block.rows, block.image_first, block.image_first_group
    tau = block.group_tau
    weight = np.where(rows.firm, 1 / least_var, 0.0)
    total = np.add.reduceat(weight, images)
    is_firm = total > 0
    total = np.where(is_firm, total, 1.0)
    place, firm_std = np.add.reduceat(weight * rows.y, images) / total, 1 / np.sqrt(total)
    most = np.maximum.reduceat(tau, first_group)
    own_reach = np.where(is_firm, 2 * _REACH * firm_std, np.inf)
    reach = own_reach + _REACH * most
    first, last = np.maximum(grid.first, place - reach), np.minimum(grid.last, place + reach)
    # points of v: each label with an offset is as sharp as that and its references together
    sharpness = np.where(tau > 0, information + 1 / np.where(tau > 0, tau, 1.0) ** 2, 0.0)
    sharpest = np.sqrt(np.maximum.reduceat(sharpness, first_group))
    steps = np.maximum(2 * own_reach / grid.step, 2 * _OFFSET_REACH * most * sharpest / _COARSE)
    points = _sizes(steps, _LARGEST_APART + 1)
    apart = (firm_std * sharpest < _SHARPER) & (most > 0) & (points <= _LARGEST_APART) & is_firm
    together = _sizes((last - first) / grid.step, _LARGEST_GRID)
    return grid._replace(
        first=np.where(apart, place - own_reach, first),
        last=np.where(apart, place + own_reach, last),
        size=np.where(apart, points, together),
        apart=apart,
    )


def _sizes(steps: FloatArray, largest: int) -> IntArray:
    """Numbers of points, rounded up to a few sizes."""
    wanted = np.minimum(np.ceil(np.minimum(steps, largest)) + 1, largest)
    unit = np.exp2(np.maximum(np.floor(np.log2(wanted)) - 3, 3))
    sizes: IntArray = np.minimum(np.ceil(wanted / unit) * unit, largest).astype(np.intp)
    return sizes


def _looked_at(block: Ordered, grid: Grid) -> Grid:
    """Lay large grids closer to where the mass is."""
    large = ((grid.size > _LOOK) & ~grid.apart).nonzero()[0]
    if not large.size:
        return grid
    rough, some, work = grid.rows(large), picked(block, large), Scratch()
    steps = (rough.last - rough.first) / (_COARSER * rough.step)
    rough = rough._replace(size=_sizes(steps, _LARGEST_LOOK))
    first, last = np.empty((2, large.size))
    for which in _blocks(some, rough.size):
        part = picked(some, which)
        first[which], last[which] = _found(part, rough.rows(which).lattice, work)
    # beyond those the labels' offsets may lie
    most = np.maximum.reduceat(some.rows.tau, some.image_first)
    half = (last - first) / 2
    margin = np.sqrt(half**2 + (_OFFSET_REACH * most) ** 2) - half
    first, last = np.maximum(rough.first, first - margin), np.minimum(rough.last, last + margin)
    all_first, all_last, size = grid.first.copy(), grid.last.copy(), grid.size.copy()
    all_first[large], all_last[large] = first, last
    size[large] = _sizes((last - first) / rough.step, _LARGEST_GRID)
    return grid._replace(first=all_first, last=all_last, size=size)


def _found(block: Ordered, at: Lattice, work: Scratch) -> tuple[FloatArray, FloatArray]:
    """Find the ends of the ranges in which log k lies."""
    rows, groups, tau_var = block.rows, block.group_first, block.rows.tau**2
    # references of one label say less together than independent ones
    alone = np.add.reduceat(1 / (rows.variance + tau_var), groups)
    shared = 1 / (1 / np.add.reduceat(1 / rows.variance, groups) + tau_var[groups])
    less = np.minimum(shared / alone, 1.0)[rows.group]
    at_row = at.rows(rows.image)
    unresolved = np.maximum(at_row.step**2 - rows.variance, tau_var)
    log_row = likelihood(rows, at_row, unresolved, np.zeros(less.size), work).density
    np.log(log_row, out=log_row)
    log_row *= less[:, None]
    log_density = summed(log_row, block.image_size)
    window = log_density > log_density.max(axis=1, keepdims=True) - _LOWEST_OF_LOOK
    low = window.argmax(axis=1) - 1
    high = at.size - window[:, ::-1].argmax(axis=1)
    middle = (at.size - 1) / 2
    return at.centre + at.step * (low - middle), at.centre + at.step * (high - middle)


# --- what is there ---------------------------------------------------------------------------


def _evaluated(block: Ordered, grid: Grid, work: Scratch) -> tuple[Piece, Likelihood]:
    """Evaluate the likelihoods of images with grids of one size."""
    rows, scale, tau = block.rows, grid.lattice, block.group_tau
    too_coarse = scale.step > grid.step * 1.001
    own_var = np.where(too_coarse, block.image_size * (scale.step / _STEP) ** 2, 0.0)
    is_shared = (tau > 0) & ((block.group_size > 1) | (tau > _WIDEST_ALONE))
    shared, by_label = is_shared.nonzero()[0], is_shared[rows.group]
    is_same = not grid.apart[0]
    at, label = scale.rows(rows.image), scale.rows(block.group_image)
    if not is_same:
        label = _apart(block, label)
        at = at.replaced(label.rows(rows.group), by_label)
    seen = likelihood(rows, at, own_var[rows.image], np.where(by_label, 0.0, rows.tau), work)
    log_row = np.log(seen.density, out=work.array("log_row", *seen.density.shape))
    piece = Piece(
        block=block, own_var=own_var, scale=scale, label=label, is_same=is_same,
        is_coarse=bool(grid.coarse[0]), shared=shared,
        log_density=log_row, log_row=log_row, log_group=log_row[:0], log_shared=log_row[:0],
    )  # fmt: skip
    if shared.size:
        of_shared = work.rows("shared", log_row, by_label.nonzero()[0])
        log_group = summed(of_shared, block.group_size[shared])
        log_shared = _integrated(_offsets(piece, shared, work), log_group)
        piece = piece._replace(log_group=log_group, log_shared=log_shared)
        # in the place of its first reference stands the label, in those of the others nothing
        log_row = work.array("terms", *log_row.shape)
        np.copyto(log_row, piece.log_row)
        log_row[by_label] = 0.0
        log_row[block.group_first[shared]] = log_shared
    return piece._replace(log_density=summed(log_row, block.image_size)), seen


def _apart(block: Ordered, at: Lattice) -> Lattice:
    """Points of v for labels whose image has a firm witness that is much sharper."""
    tau = block.group_tau
    reach = np.where(tau > 0, _OFFSET_REACH * tau, 1.0)
    step = np.maximum(2 * reach / (at.size - 1), at.step)
    return Lattice(at.centre, step, at.size)


def _offsets(piece: Piece, groups: IntArray, work: Scratch) -> Offsets:
    """Offsets of some labels."""
    return Offsets(
        tau=piece.block.group_tau[groups],
        scale=piece.scale.rows(piece.block.group_image[groups]),
        label=piece.label.rows(groups),
        is_same=piece.is_same,
        work=work,
    )


def _integrated(offsets: Offsets, log_group: FloatArray) -> FloatArray:
    """Log of functions of log k from those of v, the offset integrated out."""
    peak = log_group.max(axis=1, keepdims=True)
    total = offsets.of_scale(np.exp(np.maximum(log_group - peak, _LOWEST)))
    log_shared = np.log(np.maximum(total, _TINY, out=total))
    log_shared += peak
    return log_shared


def _weights(piece: Piece, density: FloatArray, work: Scratch) -> FloatArray:
    """Weight of each point for each reference."""
    block = piece.block
    if not piece.shared.size:
        return work.rows("weight", density, block.rows.image)
    others = _others(piece, block.group_image[piece.shared], piece.log_shared)
    peak = others.max(axis=1, keepdims=True)
    seen = _offsets(piece, piece.shared, work).of_label(np.exp(np.maximum(others - peak, _LOWEST)))
    log_weight = np.log(np.maximum(seen, _TINY)) + piece.log_group
    every = np.concatenate([density, normalised(log_weight, 1)])
    source = block.group_image.copy()
    source[piece.shared] = len(density) + np.arange(piece.shared.size)
    return work.rows("weight", every, source[block.rows.group])


def _others(piece: Piece, image: IntArray, log_shared: FloatArray) -> FloatArray:
    """Log likelihood of log k from all other labels of the image."""
    return piece.log_density[image] - log_shared


# --- how objects see it ----------------------------------------------------------------------


def _view(piece: Piece, subjects: Subjects) -> View:
    """Look at objects of one piece."""
    block, own = piece.block, subjects.own >= 0
    known = (subjects.group >= 0) & (subjects.tau > 0)
    # an own reference that was the only one of its label leaves nothing known of the offset
    mates = np.where(known, block.group_size[subjects.group], 0) - (own & known)
    offset = mates > 0
    by_v, by_k = np.flatnonzero(offset), np.flatnonzero(~offset)
    size = piece.scale.size
    log_seen, points, mean, variance = np.empty((4, offset.size, size))
    log_seen[by_k] = piece.log_density[subjects.image[by_k]]
    points[by_k] = mean[by_k] = piece.scale.rows(subjects.image[by_k]).points
    variance[by_k] = 0.0
    step = piece.scale.step[subjects.image]
    if by_v.size:
        groups, which = np.unique(subjects.group[by_v], return_inverse=True)
        step[by_v] = piece.label.step[subjects.group[by_v]]
        for column, value in zip(
            (log_seen, points, mean, variance), _label_view(piece, groups), strict=True
        ):
            column[by_v] = value[which]
    log_seen[own] -= _own(piece, subjects.own[own], offset[own])
    if piece.is_coarse:
        step = step / 2
        log_seen, points, mean, variance = map(_between, (log_seen, points, mean, variance))
        variance = np.maximum(variance, 0.0)
    window, fill = _window(log_seen)
    log_seen, points, mean, variance = (
        np.take_along_axis(column, window, axis=1) for column in (log_seen, points, mean, variance)
    )
    log_seen[fill] = -np.inf
    alone = (block.image_size[subjects.image] == own)[:, None]
    known_v = offset[:, None]
    return View(
        log_weight=np.where(alone, 0.0, log_seen + np.log(step)[:, None]),
        log_k=np.where(alone, np.nan, mean),
        log_k_var=np.where(alone, np.nan, variance),
        offset=np.where(alone, 0.0, points - mean),
        offset_var=np.where(alone | ~known_v, subjects.tau[:, None] ** 2, variance),
        covariance=np.where(alone, 0.0, -variance),
    )


def _own(piece: Piece, row: IntArray, by_label: BoolArray) -> FloatArray:
    """Log likelihood of references, as functions of v or of log k."""
    place = _place(piece)[piece.block.rows.group[row]]
    integrated = np.flatnonzero((place >= 0) & ~by_label)
    log_row = piece.log_row[row]
    log_row[integrated] = piece.log_shared[place[integrated]]
    return log_row


def _place(piece: Piece) -> IntArray:
    """Look up the number of each label among the shared ones, -1 for the others."""
    place = np.full(piece.block.group.size, -1)
    place[piece.shared] = np.arange(piece.shared.size)
    return place


def _label_view(
    piece: Piece, groups: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """
    Look at labels with an offset.

    Returns
    -------
    log_seen : (C, G) ndarray of float64
        Log likelihood of v from all references of the image.
    points, mean, variance : (C, G) ndarray of float64
        Values of v; mean and variance of log k given v.
    """
    block = piece.block
    place = _place(piece)
    log_group, log_shared = np.empty((2, groups.size, piece.scale.size))
    many = np.flatnonzero(place[groups] >= 0)
    log_group[many] = piece.log_group[place[groups[many]]]
    log_shared[many] = piece.log_shared[place[groups[many]]]
    single = np.flatnonzero(place[groups] < 0)
    if single.size:
        row = block.group_first[groups[single]]
        log_shared[single] = piece.log_row[row]
        log_group[single] = _of_label(piece, groups[single], row)
    offsets = _offsets(piece, groups, Scratch())
    others = _others(piece, block.group_image[groups], log_shared)
    peak = others.max(axis=1, keepdims=True)
    density = np.exp(np.maximum(others - peak, _LOWEST))
    x = offsets.scale.step[:, None] * piece.scale.powers[1]
    moments = offsets.of_label(np.concatenate([density, density * x, density * x**2]))
    total, first, second = np.split(moments, 3)
    total = np.maximum(total, _TINY)
    mean = first / total
    variance = np.maximum(second / total - mean**2, 0.0)
    log_seen = np.log(total) + peak + log_group
    return log_seen, offsets.label.points, mean + offsets.scale.centre[:, None], variance


def _of_label(piece: Piece, groups: IntArray, row: IntArray) -> FloatArray:
    """Log likelihood of v from references that are the only ones of their labels."""
    rows = piece.block.rows
    alone = rows.taken(row, rows.image[row], rows.group[row])
    own_var, nothing = piece.own_var[alone.image], np.zeros(row.size)
    seen = likelihood(alone, piece.label.rows(groups), own_var, nothing, Scratch())
    return np.log(seen.density)


def _between(values: FloatArray) -> FloatArray:
    """Interpolate between points, by the polynomial through the six nearest."""
    size: int = values.shape[1]
    finer = np.empty((len(values), 2 * size - 1))
    between = np.zeros((len(values), size - 1))
    at: IntArray = np.arange(size - 1)
    first: IntArray = np.minimum(np.maximum(at - 2, 0), size - 6)
    x: FloatArray = (at - first).astype(np.float64) + 0.5
    for node in range(6):
        weight: FloatArray = np.ones(size - 1)
        for other in range(6):
            if other != node:
                np.multiply(weight, (x - other) / (node - other), out=weight)
        column: FloatArray = values[:, first + node]
        np.add(between, weight * column, out=between)
    finer[:, ::2], finer[:, 1::2] = values, between
    return finer


def _window(log_values: FloatArray) -> tuple[IntArray, BoolArray]:
    """Columns that hold all the mass of each row, as many in every row; and which are only fill."""
    heavy = log_values > log_values.max(axis=1, keepdims=True) - _NEGLIGIBLE
    size = log_values.shape[1]
    first, last = np.argmax(heavy, axis=1), size - np.argmax(heavy[:, ::-1], axis=1)
    width = int((last - first).max(initial=1))
    window: IntArray = np.minimum(first, size - width)[:, None] + np.arange(width)
    return window, (window < first[:, None]) | (window >= last[:, None])
