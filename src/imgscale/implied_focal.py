"""The focal length that metric depth and known sizes imply, beside the one given or plausible."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, TypeAlias

import attrs
import numpy as np

from imgscale._checks import nan_as_none
from imgscale._typing import FloatArray, ImageSize
from imgscale.claims import Claims
from imgscale.laws import PLAUSIBLE_FOCAL
from imgscale.model import ScaleModel
from imgscale.readings import log_k_of, normal_below
from imgscale.reference import Reference

UnitCause: TypeAlias = Literal[
    "millimetres",
    "centimetres",
    "KITTI's 16-bit scale",
    "TUM's scale",
    "sizes in centimetres",
]

# How many times the true focal length each mistake makes of it.
UNITS: dict[UnitCause, float] = {
    "millimetres": 1000.0,
    "centimetres": 100.0,
    "KITTI's 16-bit scale": 256.0,
    "TUM's scale": 5000.0,
    "sizes in centimetres": 0.01,
}
# A unit is named within this many errors of its factor, or within a quarter of it: the nearest two
# factors are 2.56 apart.
_UNIT_Z, _UNIT_TOLERANCE = 2.6, 0.25
# The focal length of most photos, in units of the longer image side, within a factor of 4.
_USUAL_FOCAL, _USUAL_FACTOR = 0.8, 4.0
LARGEST_PHOTO_PX = 20_000.0
_RANGE = PLAUSIBLE_FOCAL[1] / PLAUSIBLE_FOCAL[0]


@attrs.frozen(kw_only=True)
class FocalCheck:
    """
    What references and metric depth imply of the focal length, and what it should be.

    Attributes
    ----------
    implied_px, implied_rel_std : float
        Focal length by the references alone, 1 / k, in pixels, and its relative standard error.
    given_px, given_rel_std : float
        The camera's, with the error of the depth map's scale; NaN without a camera.
    low_px, high_px : float
        Focal lengths of cameras that take photos of this size, in pixels.
    p_value : float
        Probability that the references put it at or beyond the camera's, two-sided; without a
        camera, that it is plausible.
    """

    implied_px: float
    implied_rel_std: float
    given_px: float = attrs.field(eq=nan_as_none)
    given_rel_std: float = attrs.field(eq=nan_as_none)
    low_px: float
    high_px: float
    p_value: float

    @property
    def has_camera(self) -> bool:
        """True where a camera tells what it should be."""
        return not math.isnan(self.given_px)

    @property
    def factor(self) -> float:
        """The implied focal length over the camera's."""
        return self.implied_px / self.given_px

    @property
    def log_std(self) -> float:
        """Standard error of the log of that factor."""
        return math.hypot(self.implied_rel_std, self.given_rel_std if self.has_camera else 0.0)

    @property
    def z_score(self) -> float:
        """The log of that factor in standard errors; NaN without a camera."""
        return math.log(self.factor) / self.log_std if self.has_camera else math.nan

    def units(self) -> list[UnitCause]:
        """
        List the mistakes of unit that explain the implied focal length.

        Returns
        -------
        list of str
            The best first: nearest to the camera's focal length or, without one, to what most
            photos have; none where no unit explains it.
        """
        if self.has_camera:
            reach = max(_UNIT_Z * self.log_std, _UNIT_TOLERANCE)
            off = {name: abs(math.log(self.factor / UNITS[name])) for name in UNITS}
            return sorted((name for name in UNITS if off[name] < reach), key=off.__getitem__)
        usual = _USUAL_FOCAL * math.sqrt(self.low_px * self.high_px / math.prod(PLAUSIBLE_FOCAL))
        off = {name: abs(math.log(self.implied_px / UNITS[name] / usual)) for name in UNITS}
        reach = math.log(_USUAL_FACTOR) + math.log(self.high_px / self.low_px / _RANGE) / 2
        return sorted((name for name in UNITS if off[name] < reach), key=off.__getitem__)


def plausible_focal(
    image_size: ImageSize | None, references: Sequence[Reference]
) -> tuple[float, float]:
    """
    Tell the focal lengths of cameras that take photos of a size.

    Parameters
    ----------
    image_size : (width, height) or None
        Size of the photo in pixels, where it is known.
    references : sequence of Reference
        What is in it.

    Returns
    -------
    low, high : float
        In pixels: 0.3 and 6 times the longer image side or, where the size is not known, of a
        photo between what the boxes reach and 20 000 pixels.
    """
    if image_size:
        smallest = largest = float(max(image_size))
    else:
        smallest = max((max(ref.xyxy) for ref in references), default=0.0)
        largest = max(smallest, LARGEST_PHOTO_PX)
    return PLAUSIBLE_FOCAL[0] * smallest, PLAUSIBLE_FOCAL[1] * largest


def check_focal(model: ScaleModel, claims: Claims) -> FocalCheck | None:
    """
    Compare the focal length that the references imply with what it should be.

    Parameters
    ----------
    model : ScaleModel
        The model.
    claims : Claims
        What its references claim.

    Returns
    -------
    FocalCheck or None
        None where the depth is not metric or there is no reference. A camera whose focal length is
        below all plausible ones is left out: it is not in pixels.
    """
    if model.kind != "metric" or not claims.size:
        return None
    log_k = log_k_of(claims)
    low, high = plausible_focal(model.image_size, model.references)
    camera = model.camera if model.camera and model.camera.focal_px >= low else None
    given_px, given_std = math.nan, math.nan
    if camera:
        given_px = camera.focal_px
        given_std = math.hypot(camera.focal_rel_std, model.scale_rel_std)
        below = _probability_below(log_k.points, log_k.weight, -math.log(given_px), given_std)
        p_value = min(1.0, 2 * min(below, 1 - below))
    else:
        inside = (-log_k.points >= math.log(low)) & (-log_k.points <= math.log(high))
        p_value = float(log_k.weight[inside].sum())
    return FocalCheck(
        implied_px=math.exp(-log_k.mean),
        implied_rel_std=log_k.std,
        given_px=given_px,
        given_rel_std=given_std,
        low_px=low,
        high_px=high,
        p_value=max(p_value, 0.0),
    )


def _probability_below(points: FloatArray, weight: FloatArray, limit: float, std: float) -> float:
    """Probability that a quantity is below a limit that is known within an error."""
    score = np.sign(limit - points) * np.inf if std == 0 else (limit - points) / std
    return float(weight @ normal_below(np.where(np.isnan(score), 0.0, score)))
