"""Is it right on my photos? Every known object is sized from the others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Unpack

import numpy as np

from imgscale._checks import check_type
from imgscale._typing import FitMethod, IntArray
from imgscale.columns import objects_of
from imgscale.core.solving import Problem, estimate
from imgscale.core.witnesses import Sized
from imgscale.depth import Depth
from imgscale.detection import Detection, check_detections
from imgscale.errors import FitError
from imgscale.estimate import SizeEstimate
from imgscale.fitting import FitOptions, observe_references
from imgscale.flags import Flag
from imgscale.observations import Observations
from imgscale.posing import check_joint, check_separable, problem_of, solve_by, view_of
from imgscale.priors import PriorTable
from imgscale.sizing import Sizes, Wanted, distances, gather, row_flags, size_up

__all__ = ["leave_one_out"]

# References times references that are solved at once, for memory.
_ROWS_AT_ONCE = 4000


def leave_one_out(
    detections: Sequence[Detection],
    depth: Depth,
    priors: PriorTable | None = None,
    *,
    use_prior: bool = False,
    **fit_options: Unpack[FitOptions],
) -> list[SizeEstimate]:
    """
    Size every reference from the others of its image.

    Parameters
    ----------
    detections : sequence of Detection
        The objects in the image.
    depth : DepthMap or ObjectDepths
        Their depth.
    priors : PriorTable, optional
        Sizes by label; the shipped table where omitted.
    use_prior : bool
        Fuse each measurement with the object's own prior, as `predict` does.
    **fit_options
        The keyword arguments of `fit`.

    Returns
    -------
    list of SizeEstimate
        One per detection, in their order, along the axis through which it is a witness. An object
        that cannot be a reference is sized from all references, as by `predict`.

    Raises
    ------
    FitError
        If leaving one out leaves nothing to fit.
    ValueError
        If an argument breaks its law.
    TypeError
        If an argument is of the wrong type.

    Examples
    --------
    >>> import imgscale as ims
    >>> detections = [ims.Detection("door", (100, 50, 180, 250)),
    ...               ims.Detection("table", (300, 80, 400, 155))]
    >>> depth = ims.ObjectDepths([4.0, 4.0], kind="relative", rel_std=0.01)
    >>> priors = ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.02),
    ...                          ims.ObjectPrior("table", 0.74, 0.02)])
    >>> for estimate in ims.leave_one_out(detections, depth, priors):
    ...     print(estimate)
    door: height 1.97 +- 0.07 m
    table: height 0.750 +- 0.018 m
    """
    check_type("use_prior", use_prior, bool)
    detections = check_detections(detections)
    obs, setting = observe_references(detections, depth, priors, **fit_options)
    if use_prior:
        check_joint(setting.method)
    problem = problem_of(detections, obs, setting)
    rows = obs.eligible
    _check_enough([detections[int(row)].label for row in rows], problem)
    cases = solve_by(setting.method, problem)
    references = problem.witnesses.rows(np.flatnonzero(~problem.witnesses.firm))
    found = estimate(problem, cases)
    nobody = np.full(len(detections), -1, dtype=np.intp)  # none of them was in its own fit
    wanted = Wanted(
        subjects=objects_of(obs, view_of(setting))._replace(group=_groups(obs)),
        own=nobody,
        common_var=np.zeros(nobody.size),
        share=np.zeros(nobody.size),
        fuse=use_prior & ~(np.isnan(obs.prior_m) | obs.partial),
        rejected=np.zeros(nobody.size, dtype=np.bool_),
        log_k=np.full(nobody.size, found.log_k[0]),
    )
    rest = np.setdiff1d(np.arange(nobody.size), rows)
    sizes = Sizes.unknown(nobody.size).updated(rest, size_up(cases, wanted.rows(rest)))
    for places in _chunks(problem, rows.size, setting.method):
        part = _sizes_without(problem, places, setting.method, wanted.rows(rows[places]))
        sizes = sizes.updated(rows[places], part)
    return gather(
        detections,
        obs,
        sizes,
        row_flags(obs, wanted, sizes, cases, references, Flag(0)),
        distances(setting, obs.depth, sizes, wanted.log_k),
    )


def _groups(obs: Observations) -> IntArray:
    """Give the objects' labels the numbers that its problem gives them; -1 for others."""
    numbers = {
        int(group): number for number, group in enumerate(np.unique(obs.group[obs.eligible]))
    }
    return np.array([numbers.get(int(group), -1) for group in obs.group], dtype=np.intp)


def _check_enough(labels: Sequence[str], problem: Problem) -> None:
    """Raise where leaving one out leaves too few."""
    firm = problem.witnesses.firm
    if len(labels) == 1 and not firm.any():
        msg = (
            "`detections` must hold at least two references to leave one out; "
            f"got {labels[0]} alone."
        )
        raise FitError(msg)
    if problem.has_shift and not problem.plane:
        for row in np.flatnonzero(~firm):
            check_separable(np.delete(problem.witnesses.inverse_depth, row))


def _chunks(problem: Problem, count: int, method: FitMethod) -> Iterator[IntArray]:
    """Split the references into runs that are left out in one go."""
    rows = max(problem.witnesses.image.size, 1)
    size = max(1, _ROWS_AT_ONCE // rows) if method in {"robust", "posterior"} else 1
    for start in range(0, count, size):
        yield np.arange(start, min(start + size, count), dtype=np.intp)


def _seen_without(problem: Problem, places: IntArray) -> Sized | None:
    """Let those left out tell of the plane all the same, with the bystanders of all images."""
    if problem.bystanders is None:
        return None
    nobody = np.full(places.size, -1, dtype=np.intp)
    left_out = problem.witnesses.rows(places)._replace(group=nobody)
    return problem.bystanders.tiled(places.size, 1).joined(
        left_out._replace(image=np.arange(places.size))
    )


def _sizes_without(problem: Problem, places: IntArray, method: FitMethod, wanted: Wanted) -> Sizes:
    """Size references of a problem, each from all others, as images of their own."""
    everyone = np.arange(problem.witnesses.image.size)
    others = [np.delete(everyone, place) for place in places]
    witnesses = problem.witnesses.rows(np.concatenate(others))
    image = np.repeat(np.arange(places.size), everyone.size - 1)
    n_groups = int(problem.witnesses.group.max()) + 1
    numbers, group = np.unique(witnesses.group + n_groups * image, return_inverse=True)
    own = wanted.subjects.group + n_groups * np.arange(places.size)
    number = np.minimum(np.searchsorted(numbers, own), numbers.size - 1)
    left = problem._replace(
        witnesses=witnesses._replace(image=image, group=group.astype(np.intp)),
        n_images=places.size,
        bystanders=_seen_without(problem, places),
    )
    cases = solve_by(method, left)
    found = estimate(left, cases)
    subjects = wanted.subjects._replace(
        image=np.arange(places.size), group=np.where(numbers[number] == own, number, -1)
    )
    return size_up(cases, wanted._replace(subjects=subjects, log_k=found.log_k))
