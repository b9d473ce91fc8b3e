"""What was told of the camera, beside what references and depth say of it without that."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal, TypeAlias

import attrs
import numpy as np

from imgscale._format import with_error
from imgscale._typing import FitMethod
from imgscale.camera import Camera
from imgscale.columns import camera_witness, without_focal
from imgscale.core.mixture import MEDIAN, half_width
from imgscale.core.predictive import scale_of
from imgscale.core.solving import Problem, estimate
from imgscale.depth import GroundPlane
from imgscale.posing import solve_by
from imgscale.standing import height_of

__all__ = ["Conflict"]

Pose: TypeAlias = Callable[[Camera | None, GroundPlane | None], Problem]

_CONFLICT_Z = 3.0


@attrs.frozen(kw_only=True)
class Conflict:
    """
    A quantity of the camera on which the user and the picture disagree.

    Attributes
    ----------
    what : str
        "focal length" (in pixels) or "camera height" (in metres).
    told, told_rel_std : float
        As it was told, and its relative standard error.
    implied, implied_rel_std : float
        As references and depth say it.
    """

    what: Literal["focal length", "camera height"]
    told: float
    told_rel_std: float
    implied: float
    implied_rel_std: float

    @property
    def z_score(self) -> float:
        """By how many standard errors the logs differ."""
        error = math.hypot(self.told_rel_std, self.implied_rel_std)
        return math.log(self.implied / self.told) / error if error else math.inf

    def __str__(self) -> str:
        unit = "px" if self.what == "focal length" else "m"
        told = with_error(self.told, self.told * self.told_rel_std)
        implied = with_error(self.implied, self.implied * self.implied_rel_std)
        return (
            f"the {self.what} was told as {told} {unit}, references and depth say {implied} "
            f"{unit}, {abs(self.z_score):.1f} standard errors apart"
        )


def conflicts(
    camera: Camera | None,
    ground: GroundPlane | None,
    scale_rel_std: float,
    method: FitMethod,
    pose: Pose,
) -> tuple[Conflict, ...]:
    """
    Compare what was told of the camera with what everything else says.

    Parameters
    ----------
    camera : Camera or None
        The camera, where metric depth makes its focal length comparable.
    ground : GroundPlane or None
        The plane.
    scale_rel_std : float
        Relative standard error of the metric depth's scale.
    method : str
        The estimator.
    pose : callable
        Poses the same problem with another camera and plane.

    Returns
    -------
    tuple of Conflict
        Those of more than 3 standard errors.
    """
    found: list[Conflict] = []
    solver: FitMethod = "robust" if method == "posterior" else method
    if camera:
        problem = pose(camera, ground)
        if method in {"robust", "posterior"}:  # where it is a witness
            silent = without_focal(problem.witnesses, has_plane=ground is not None)
            problem = problem._replace(witnesses=silent)
        scale = scale_of(solve_by(solver, problem._replace(exact=False))).quantiles()
        found.append(
            Conflict(
                what="focal length",
                told=camera.focal_px,
                told_rel_std=math.sqrt(camera_witness(camera, scale_rel_std).variance),
                implied=math.exp(-float(scale[0, MEDIAN])),
                implied_rel_std=float(half_width(scale)[0]),
            )
        )
    if ground and ground.camera_height_m is not None:
        without = attrs.evolve(ground, camera_height_m=None, camera_height_std_m=None)
        problem = pose(camera, without)._replace(exact=False)
        plane = estimate(problem, solve_by(solver, problem)).plane
        if plane:
            found.append(
                Conflict(
                    what="camera height",
                    told=ground.camera_height_m,
                    told_rel_std=math.sqrt(height_of(ground)[1]),
                    implied=math.exp(float(plane.log_height[0])),
                    implied_rel_std=float(plane.log_height_std[0]),
                )
            )
    return tuple(one for one in found if np.abs(one.z_score) > _CONFLICT_Z)
