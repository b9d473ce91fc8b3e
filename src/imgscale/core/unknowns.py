"""
What is not known of a ground plane: its unknowns, their prior, and what they make of the objects.

The unknowns of an image are log(f - y0), the distance of its median foot from the horizon; the
slope of the plane; where depths are given too, log(camera height / k) and, where those have a
shift, its logarithm as in `imgscale.core.shift`; last, where the focal length was told with an
error, its logarithm over what was told.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from imgscale._typing import FloatArray
from imgscale.core.estimator import fit_robust
from imgscale.core.evidence import robust_evidence
from imgscale.core.segments import median_by
from imgscale.core.shift import ShiftScale, shift_scales
from imgscale.core.sighting import observe_under, plane_evidence
from imgscale.core.stance import Stance
from imgscale.core.witnesses import Nuisance, Sized

# Photos at large point up or down by what Student's distribution with so many degrees says.
HORIZON_DOF = 3.0


class Scene(NamedTuple):
    """
    What is known beforehand of horizon and plane, the same for all images.

    Attributes
    ----------
    horizon, horizon_std : float
        Row of the horizon below the principal point, and its standard error.
    is_given : bool
        True where somebody told them; else they hold for photos at large, which some leave by far.
    slope, slope_std : float
        Mean and standard deviation of the cross-fall and of the camera's roll together.
    has_plane : bool
        True where objects stand on a plane; else the horizon only tells the camera's tilt.
    has_depth : bool
        True where there are depths too.
    span : float
        Height of the image in pixels.
    focal_rel_std : float
        Relative standard error of the focal length; 0 where it is exact or not known at all.
    cross : float
        Off-diagonal entry of the precision matrix of horizon and slope.
    """

    horizon: float
    horizon_std: float
    is_given: bool
    slope: float
    slope_std: float
    has_plane: bool
    has_depth: bool
    span: float
    focal_rel_std: float = 0.0
    cross: float = 0.0

    def joined(self, horizon: float, slope: float, precision: tuple[float, float, float]) -> Scene:
        """
        Add what is known from elsewhere.

        Parameters
        ----------
        horizon, slope : float
            Its centre.
        precision : tuple of float
            Its precision matrix: (horizon, horizon and slope, slope).

        Returns
        -------
        Scene
            Both together, as normal distributions.
        """
        own = np.array([[self.horizon_std**-2, self.cross], [self.cross, self.slope_std**-2]])
        more = np.array([precision[:2], precision[1:]])
        centre = own @ [self.horizon, self.slope] + more @ [horizon, slope]
        both = own + more
        place = np.linalg.solve(both, centre)
        return self._replace(
            horizon=float(place[0]),
            horizon_std=float(both[0, 0]) ** -0.5,
            is_given=True,
            slope=float(place[1]),
            slope_std=float(both[1, 1]) ** -0.5,
            cross=float(both[0, 1]),
        )


class Unknowns(NamedTuple):
    """
    The unknowns of many images.

    Attributes
    ----------
    witnesses : Sized
        References, the camera among them.
    bystanders : Sized
        Other objects whose depth and foot tell of the plane.
    scene : Scene
        What is known beforehand.
    noise : Nuisance
        One case of the depths' noise for each image.
    foot : (n,) ndarray of float64
        Median row of the feet.
    shifts : ShiftScale or None
        The scale of the shifts, where they are unknown.
    """

    witnesses: Sized
    bystanders: Sized
    scene: Scene
    noise: Nuisance
    foot: FloatArray
    shifts: ShiftScale | None

    @property
    def n_images(self) -> int:
        """Number of images."""
        return int(self.foot.size)

    @property
    def dimensions(self) -> int:
        """Number of unknowns of an image: 2 to 5."""
        has_focal = self.scene.focal_rel_std > 0
        return 2 + self.scene.has_depth + (self.shifts is not None) + has_focal

    def nuisance(self, theta: FloatArray) -> Nuisance:
        """
        Turn values of the unknowns into cases.

        Parameters
        ----------
        theta : (K, n, d) ndarray of float
            The values.

        Returns
        -------
        Nuisance
            K cases.
        """
        zero = np.zeros(theta.shape[:2])
        return Nuisance(
            shift=zero if self.shifts is None else self.shifts.shift(theta[..., 3]),
            depth_var=zero + self.noise.depth_var,
            log_prior=zero,
            horizon=self.foot - np.exp(theta[..., 0]),
            slope=theta[..., 1],
            gap=theta[..., 2] if self.scene.has_depth else zero,
            log_focal=theta[..., -1] if self.scene.focal_rel_std else None,
        )

    def log_prior(self, theta: FloatArray) -> FloatArray:
        """
        Compute the log of the prior density.

        Parameters
        ----------
        theta : (K, n, d) ndarray of float
            Values of the unknowns.

        Returns
        -------
        (K, n) ndarray of float64
            Up to a constant.
        """
        scene = self.scene
        apart = self.foot - np.exp(theta[..., 0]) - scene.horizon
        askew = theta[..., 1] - scene.slope
        square = (apart / scene.horizon_std) ** 2
        if not scene.is_given:
            square = (HORIZON_DOF + 1) * np.log1p(square / HORIZON_DOF)
        square = square + (askew / scene.slope_std) ** 2 + 2 * scene.cross * apart * askew
        if scene.focal_rel_std:
            square = square + (theta[..., -1] / scene.focal_rel_std) ** 2
        log_prior: FloatArray = theta[..., 0] - square / 2  # dy0 = exp(theta) dtheta
        if self.shifts is not None:
            shift = self.shifts.shift(theta[..., 3])
            log_prior = log_prior + theta[..., 3] - (shift / self.shifts.width) ** 2 / 2
        return log_prior

    def log_likelihood(self, nuisance: Nuisance) -> FloatArray:
        """
        Compute the evidence of sizes, by the robust solver, and of feet.

        Parameters
        ----------
        nuisance : Nuisance
            K cases.

        Returns
        -------
        (K, n) ndarray of float64
            Up to a constant.
        """
        obs = observe_under(self.witnesses, nuisance)
        evidence = robust_evidence(obs, fit_robust(obs)).reshape(nuisance.shift.shape)
        for part in (self.witnesses, self.bystanders):
            evidence = evidence + plane_evidence(part, nuisance)
        return evidence

    def blurred(self, noise: float) -> Unknowns:
        """
        Add noise to all depths and feet.

        Parameters
        ----------
        noise : float
            Its relative standard deviation.

        Returns
        -------
        Unknowns
            The same unknowns, less well seen.
        """
        return self._replace(
            witnesses=_blurred(self.witnesses, noise), bystanders=_blurred(self.bystanders, noise)
        )


def unknowns_of(
    witnesses: Sized, bystanders: Sized, scene: Scene, noise: Nuisance, *, has_shift: bool
) -> Unknowns:
    """
    Set the unknowns up, each case of the noise as an image of its own.

    Parameters
    ----------
    witnesses : Sized
        References of n images, the camera among them, each with its stance.
    bystanders : Sized
        Other objects.
    scene : Scene
        What is known beforehand.
    noise : Nuisance
        K cases of the noise.
    has_shift : bool
        True where the shift of the inverse depth is unknown too.

    Returns
    -------
    Unknowns
        Of K n images, case by case.
    """
    levels, n_images = noise.shift.shape
    everyone, others = (part.tiled(levels, n_images) for part in (witnesses, bystanders))
    return Unknowns(
        witnesses=everyone,
        bystanders=others,
        scene=scene,
        noise=with_columns(noise, lambda column: column.reshape(1, -1)),
        foot=_median_foot(everyone, others, levels * n_images, scene),
        shifts=shift_scales(everyone, levels * n_images) if has_shift else None,
    )


def stance_of(objects: Sized) -> Stance:
    """
    Look up where objects lie.

    Parameters
    ----------
    objects : Sized
        Objects of a problem with a plane.

    Returns
    -------
    Stance
        Their stance.

    Raises
    ------
    AssertionError
        If the problem was posed without.
    """
    if objects.stance is None:
        msg = "a plane needs objects with a stance"
        raise AssertionError(msg)
    return objects.stance


def with_columns(nuisance: Nuisance, change: Callable[[FloatArray], FloatArray]) -> Nuisance:
    """
    Change all columns that there are.

    Parameters
    ----------
    nuisance : Nuisance
        The cases.
    change : callable
        What is done to each column.

    Returns
    -------
    Nuisance
        The changed cases.
    """
    columns = [None if column is None else change(column) for column in nuisance]
    return Nuisance(*columns)  # type: ignore[arg-type]  # its first three are arrays


def _blurred(objects: Sized, noise: float) -> Sized:
    stance = stance_of(objects)
    return objects._replace(
        noise_var=objects.noise_var + np.where(objects.firm, 0.0, noise**2),
        stance=stance._replace(relief_var=stance.relief_var + noise**2),
    )


def _median_foot(witnesses: Sized, bystanders: Sized, n_images: int, scene: Scene) -> FloatArray:
    """
    Median row of the feet of each image; without feet a row well below the horizon.

    Any number of other objects may hang above the horizon: it is no higher than the farthest
    reference's.
    """
    of_references = stance_of(witnesses).foot
    feet = np.concatenate([of_references, stance_of(bystanders).foot])
    image = np.concatenate([witnesses.image, bystanders.image])
    known = ~np.isnan(feet)
    median = median_by(
        np.append(image[known], np.arange(n_images)),
        np.append(feet[known], np.full(n_images, scene.horizon + scene.span / 2)),
        np.append(np.ones(int(known.sum())), np.full(n_images, 1e-9)),
        n_images,
    )
    farthest = np.full(n_images, np.inf)
    np.fmin.at(farthest, witnesses.image, of_references)
    lowest: FloatArray = np.where(np.isinf(farthest), median, np.maximum(median, farthest))
    return lowest
