"""A drawn picture with all that is known of it."""

from __future__ import annotations

import math
from typing import Literal

import attrs
import numpy as np

from imgscale._checks import (
    check_choice,
    finite_number,
    is_between,
    number_error,
    positive_number,
)
from imgscale._typing import BoolArray, FloatArray, ImageArray
from imgscale.camera import Camera
from imgscale.datasets.drawn.camera import DrawnCamera
from imgscale.depth import DepthMap
from imgscale.detection import Detection
from imgscale.noise import Noise
from imgscale.priors import PriorTable

__all__ = ["DrawnScene"]

_STRAIGHT_DOWN_DEG = 89.0
_NOISE_PX = 60  # about how far errors of a drawn depth reach


@attrs.frozen(eq=False, kw_only=True)
class DrawnScene:
    """
    A drawn picture, all that `fit` and `predict` take, and the truth.

    Attributes
    ----------
    image : (H, W, 3) ndarray of uint8
        The picture.
    detections : tuple of Detection
        The things in it, their boxes exact or with the errors asked for.
    sizes_m : tuple of float
        Their true heights, or diameters for what lies on a table, in metres.
    distances_m : tuple of float
        Their true z-depths, along the camera's axis, in metres: that of the middle of the foot, for
        what lies on a table that of its widest part.
    masks : tuple of (H, W) ndarray of bool
        Their visible pixels.
    depth : DepthMap
        The exact z-depth of every pixel in metres; NaN in the sky.
    viewpoint : DrawnCamera
        The camera that saw it.
    priors : PriorTable
        Sizes that are known of things in it.
    noise : Noise
        The errors of the boxes; zero where they are exact.
    """

    image: ImageArray
    detections: tuple[Detection, ...]
    sizes_m: tuple[float, ...]
    distances_m: tuple[float, ...]
    masks: tuple[BoolArray, ...]
    depth: DepthMap
    viewpoint: DrawnCamera
    priors: PriorTable
    noise: Noise

    @property
    def camera(self) -> Camera:
        """The exact camera; without its pitch where it looks straight down on a table."""
        view = self.viewpoint
        pitch = view.pitch_deg if abs(view.pitch_deg) < _STRAIGHT_DOWN_DEG else 0.0
        return Camera(view.focal_px, focal_rel_std=0.0, image_size=view.image_size, pitch_deg=pitch)

    def depth_as(
        self,
        kind: Literal["relative", "inverse", "affine_inverse"],
        *,
        factor: float = 8.0,
        shift: float = -0.4,
        rel_std: float = 0.0,
        rng: np.random.Generator | None = None,
    ) -> DepthMap:
        """
        Give the depth as other sources would.

        Parameters
        ----------
        kind : str
            "relative": factor x Z. "inverse": factor / Z. "affine_inverse": factor / Z + shift, or
            0 where that is negative, as MiDaS or Depth Anything give it; 0 in the sky.
        factor : float
            The factor, positive, which nobody is told.
        shift : float
            The shift, which nobody is told either.
        rel_std : float
            Relative standard error of Z, from which a smooth error is drawn, >= 0.
        rng : numpy Generator, optional
            For that error; without one there is none.

        Returns
        -------
        DepthMap
            A map in single precision.

        Raises
        ------
        ValueError
            If the kind is none of these or a number breaks its law.

        Notes
        -----
        The law of inverse kinds is p / H = (v + b) / k with v the value of the map: so b is minus
        `shift` here, and k is `factor` over the focal length.

        Examples
        --------
        >>> from imgscale.datasets import drawn
        >>> scene = drawn.street()
        >>> values = scene.depth_as("affine_inverse", factor=8.0, shift=-0.4).values
        >>> z = scene.depth.values[400, 400]
        >>> round(float(values[400, 400]), 3) == round(float(8.0 / z - 0.4), 3)
        True
        """
        check_choice("kind", kind, ("relative", "inverse", "affine_inverse"))
        factor, shift = positive_number("factor", factor), finite_number("shift", shift)
        if not is_between(rel_std, 0, math.inf):
            raise number_error("rel_std", "finite and not negative", rel_std)  # noqa: EM101 - a name
        z = np.asarray(self.depth.values, dtype=np.float64)
        if rng is not None:
            z = z * np.exp(rel_std * _smooth_noise(z.shape, rng))
        values = factor * z if kind == "relative" else factor / z
        if kind == "affine_inverse":
            values = np.nan_to_num(np.maximum(values + shift, 0.0))
        return DepthMap(values.astype(np.float32), kind=kind, image_size=self.depth.image_size)


def _smooth_noise(shape: tuple[int, ...], rng: np.random.Generator) -> FloatArray:
    """Draw a smooth field of mean 0 and standard deviation 1."""
    from scipy.ndimage import zoom  # noqa: PLC0415 - 50 ms that few need

    coarse = rng.normal(size=[max(length // _NOISE_PX, 2) for length in shape])
    factors = [length / size for length, size in zip(shape, coarse.shape, strict=True)]
    field: FloatArray = zoom(coarse, factors, order=3)
    noise: FloatArray = (field - field.mean()) / field.std()
    return noise
