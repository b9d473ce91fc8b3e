"""What every measurement begins with: the model, a depth that belongs to it, its solutions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imgscale._checks import as_flag, check_type
from imgscale.core.solving import Cases, Problem
from imgscale.core.witnesses import UNKNOWN_DEPTH_REL, Sized
from imgscale.depth import Depth, DepthMap, GroundPlane
from imgscale.errors import DepthMismatchError
from imgscale.model import ScaleModel
from imgscale.object_depth import with_image_size
from imgscale.observations import Observations
from imgscale.posing import problem_of_model, solve_by


class Lookup(NamedTuple):
    """
    A model and the depth that is measured with.

    Attributes
    ----------
    model : ScaleModel
        The model.
    depth : DepthMap, ObjectDepths or GroundPlane
        The depth, with the image's size where that is known.
    other_map : bool
        True where it is another map than the fitted one.
    """

    model: ScaleModel
    depth: Depth
    other_map: bool

    @property
    def other_var(self) -> float:
        """Variance of the log scales of two maps: k holds that of the fitted one."""
        if not (self.other_map and isinstance(self.depth, DepthMap)):
            return 0.0
        return self.model.scale_rel_std**2 + self.depth.scale_rel_std**2

    def with_errors(self, obs: Observations) -> Observations:
        """
        Add the errors of depths that no single object tells.

        Parameters
        ----------
        obs : Observations
            The objects.

        Returns
        -------
        Observations
            With the noise that nobody told where the model was fitted to depths whose noise was,
            and the errors of the scales of two maps.
        """
        variance = obs.depth_var + self.other_var
        if obs.unknown_noise and self.model.depth_rel is None:
            variance = variance + UNKNOWN_DEPTH_REL**2
        return obs._replace(depth_var=variance)

    def check_plane(self) -> None:
        """
        Raise where another ground plane was given than the fitted one, which alone is looked up.

        Raises
        ------
        DepthMismatchError
            If it differs.
        """
        if isinstance(self.depth, GroundPlane) and self.depth != self.model.ground:
            msg = (
                f"`depth` must be the model's ground plane, {self.model.ground}, which the fit "
                f"completed; got {self.depth}. Leave it out, or fit anew with the other."
            )
            raise DepthMismatchError(msg)


def look_up(
    model: ScaleModel,
    depth: Depth | None,
    *,
    same_scale: bool,
    remedy: str = "pass the map of the model's kind.",
) -> Lookup:
    """
    Check depth against a model.

    Parameters
    ----------
    model : ScaleModel
        The model.
    depth : DepthMap, ObjectDepths, GroundPlane or None
        The depth; None where a ground plane is the model's.
    same_scale : bool
        Vouch that another map than the fitted one has the same scale.
    remedy : str
        What to do where the depth is missing.

    Returns
    -------
    Lookup
        Both.

    Raises
    ------
    ValueError
        If the depth is missing.
    DepthMismatchError
        If it is not the model's.
    """
    check_type("model", model, ScaleModel)
    check_type("same_scale", as_flag(same_scale), bool)
    if model.kind == "ground_plane" and model.ground and depth is None:
        depth = model.ground
    if depth is None:
        msg = f"`depth` is missing; {remedy}"
        raise ValueError(msg)
    model.check_depth(depth, same_scale=same_scale)
    usable = with_image_size(depth, model.image_size)
    other = isinstance(usable, DepthMap) and usable.fingerprint != model.fingerprint
    return Lookup(model, usable, other)


def references_seen(model: ScaleModel, problem: Problem) -> Sized:
    """
    Collect the references that tell how far from the camera a model was fitted.

    Parameters
    ----------
    model : ScaleModel
        The model.
    problem : Problem
        Its problem, as `problem_of_model` poses it.

    Returns
    -------
    Sized
        Its references. Of frames fitted together, whose rows say only what all found of k, those
        of this frame that were used; none where it had none.
    """
    if model.shared and problem.bystanders is not None:
        return problem.bystanders.rows(np.flatnonzero([ref.used for ref in model.references]))
    return problem.witnesses.rows(np.flatnonzero(~problem.witnesses.firm))


class Solved(NamedTuple):
    """
    The solutions of a model.

    Attributes
    ----------
    cases : Cases
        All of them.
    references : Sized
        The references that tell how far from the camera it was fitted.
    """

    cases: Cases
    references: Sized


def solved(model: ScaleModel) -> Solved:
    """
    Solve the problem of a model once more, with all that is not known.

    Parameters
    ----------
    model : ScaleModel
        The model.

    Returns
    -------
    Solved
        The solutions.
    """
    problem = problem_of_model(model)[0]
    return Solved(solve_by(model.method, problem), references_seen(model, problem))
