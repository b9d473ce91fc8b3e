"""
The wrong map found out: whether depths, sizes and camera of a fit belong together at all.

A reading of the depths is suspected where the references reject it at a level of 1 % and another
reading explains them better even if one reference in twenty is wrong: so a mislabelled reference is
hardly ever taken for a wrong map.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, TypeAlias

import attrs
import numpy as np

from imgscale._checks import check_type, nan_as_none
from imgscale._format import with_error
from imgscale._typing import DepthKind, FloatArray
from imgscale.claims import Claims, claims_of, with_focal
from imgscale.implied_focal import UNITS, FocalCheck, UnitCause, check_focal, plausible_focal
from imgscale.laws import LAWS
from imgscale.model import ScaleModel
from imgscale.readings import (
    chi_square,
    chi_square_above,
    evidence,
    log_slant,
    normal_below,
    score_against,
    shifted,
)
from imgscale.reference import numbered_labels

__all__ = ["Suspicion", "suspect"]

Cause: TypeAlias = (
    Literal[
        "inverse given as depth",
        "depth given as inverse",
        "ray distance given as z-depth",
        "depth of another picture",
        "stale focal length or resized picture",
        "focal length not in pixels",
        "unknown unit",
    ]
    | UnitCause
)

_LEVEL = 0.01
# Rays differ from z by few per cent, as the mean sizes of a place do: they must be far more likely.
_RAY_LEVEL, _RAY_ODDS = 0.001, math.log(3.0)
# Depths of two pictures at one place differ by a factor of 2, and a stale focal length by 1.6.
_OTHER_PICTURE_STD, _STALE_STD = 0.7, 0.5
# A focal length farther off is no stale one but a wrong unit.
_LARGEST_STALE = 5.0
# Residual tests need two degrees of freedom: of two references either may be wrong.
_LEAST_FREEDOM = 2
# The others agree without one reference where their chi-square is no rarer than this.
_AGREE = 0.05


@attrs.frozen(kw_only=True)
class Suspicion:
    """
    One reason to think that a fit was given something wrong.

    Attributes
    ----------
    cause : str
        "inverse given as depth", "depth given as inverse", "ray distance given as z-depth", "depth
        of another picture", "millimetres", "centimetres", "KITTI's 16-bit scale", "TUM's scale",
        "sizes in centimetres", "unknown unit", "stale focal length or resized picture" or "focal
        length not in pixels".
    evidence : float
        Natural logarithm of how many times more probable it makes what was seen than the reading
        that was declared, one reference in twenty being wrong under both; NaN where it is not one
        definite alternative.
    p_value : float
        Probability that a right map looks as wrong as this, 0 to 1; NaN where nothing is random.
    detail : str
        One sentence with the numbers, and the remedy.
    """

    cause: Cause
    evidence: float = attrs.field(eq=nan_as_none)
    p_value: float = attrs.field(eq=nan_as_none)
    detail: str

    def __str__(self) -> str:
        return f"{self.cause}: {self.detail}"


def suspect(model: ScaleModel) -> tuple[Suspicion, ...]:
    """
    Find out whether a model was fitted to the wrong map, unit or focal length.

    Parameters
    ----------
    model : ScaleModel
        The model. All its candidates count, also those that were taken for outliers: a wrong map
        makes outliers.

    Returns
    -------
    tuple of Suspicion
        None as a rule. One reading of the depths at most, then one of the scale at most.

    Notes
    -----
    With y the logs of size over pixels and S their covariance (individuals, labels' offsets, boxes,
    depths), any two readings x and x' of the log distances are compared by the likelihood ratio of
    y with log k integrated out. Under the declared one ``(x' - x)' P (y - x)`` is normal with the
    variance ``(x' - x)' P (x' - x)``, where P is S^-1 with the direction of log k projected out,
    which gives the p-value; the disagreement as a whole, ``(y - x)' P (y - x)``, is a chi-square of
    n - 1 degrees of freedom. p-values must be below 1 %, for rays 0.1 %. The evidence has no such
    Gaussian tails: as in `fit`, one reference in twenty is wrong. Depths of another picture are
    taken to be off by a factor of 2, one standard deviation.

    With metric depth the focal length implied, 1 / k, is compared with the camera's or, without
    one, with 0.3 to 6 times the longer image side. Where the noise of the depths was not told,
    everything is averaged over what it may be. "affine_inverse" depth is tested for disagreement
    alone, "ground_plane" models not at all.

    Examples
    --------
    Disparities given as depth:

    >>> import imgscale as ims
    >>> from imgscale.suspicion import suspect
    >>> doors = [ims.Detection("door", (100 * i, 50, 100 * i + 60, 50 + height))
    ...          for i, height in enumerate([300, 150, 75])]
    >>> right = ims.ObjectDepths([4.0, 8.0, 16.0], kind="relative")
    >>> wrong = ims.ObjectDepths([0.25, 0.125, 0.0625], kind="relative")
    >>> suspect(ims.fit(doors, right))
    ()
    >>> [suspicion.cause for suspicion in suspect(ims.fit(doors, wrong))]
    ['inverse given as depth']
    """
    check_type("model", model, ScaleModel)
    claims = claims_of(model)
    found = _wrong_reading(model, claims) if claims.size >= 2 else []
    return tuple(found + _wrong_scale(model, claims, found))


def _wrong_reading(model: ScaleModel, claims: Claims) -> list[Suspicion]:
    """Try other readings of the depths, the definite ones first."""
    if model.kind == "ground_plane":
        return []
    if LAWS[model.kind].has_shift:
        return _disagreement_with_shift(model, claims)
    chi2 = chi_square(claims, claims.log_distance, np.ones((claims.size, 1)))
    p_value = _disagreement(model, claims, chi2)
    p_swap = _mean_over(claims, normal_below(-score_against(claims, -claims.log_distance)))
    rays = _ray_suspicion(model, claims)
    if min(p_value, p_swap) >= _LEVEL:
        return rays
    declared, swapped, noisier = evidence(
        claims,
        np.stack([claims.log_distance, -claims.log_distance, claims.log_distance]),
        np.array([[0.0], [0.0], [_OTHER_PICTURE_STD**2]]),
    )
    if p_swap < _LEVEL and swapped > max(declared, noisier):
        return [_swap_suspicion(model.kind, float(swapped - declared), p_swap)]
    if rays or p_value >= _LEVEL or noisier <= declared:
        return rays
    return [_other_picture(model, claims, chi2, p_value, float(noisier - declared))]


def _disagreement_with_shift(model: ScaleModel, claims: Claims) -> list[Suspicion]:
    """Test the disagreement alone, at the shift that fits best."""
    distances, slopes = shifted(claims.inverse_depth)
    ones = np.ones((claims.size, 1))
    best = np.array([chi_square(claims, row, ones) for row in distances]).argmin(axis=0)
    chi2 = np.empty(best.size)
    for case, b in enumerate(best):
        chi2[case] = chi_square(claims, distances[b], np.column_stack([ones, slopes[b]]))[case]
    p_value = _disagreement(model, claims, chi2)
    if p_value >= _LEVEL:
        return []
    declared = float(np.logaddexp.reduce(evidence(claims, distances)))
    noisier = float(np.logaddexp.reduce(evidence(claims, distances, _OTHER_PICTURE_STD**2)))
    if noisier <= declared:
        return []
    return [_other_picture(model, claims, chi2, p_value, noisier - declared)]


def _freedom(model: ScaleModel, claims: Claims) -> int:
    """Degrees of freedom of the residuals: log k is fitted, and the shift where there is one."""
    return claims.size - 1 - LAWS[model.kind].has_shift


def _disagreement(model: ScaleModel, claims: Claims, chi2: FloatArray) -> float:
    """Probability of references that disagree as much; 1 where there are too few to tell."""
    freedom = _freedom(model, claims)
    if freedom < _LEAST_FREEDOM:
        return 1.0
    return _mean_over(claims, chi_square_above(chi2, freedom))


def _swap_suspicion(kind: DepthKind, gain: float, p_value: float) -> Suspicion:
    """Say that the values are those of the other kind."""
    if LAWS[kind].inverse:
        cause: Cause = "depth given as inverse"
        text, remedy = "depth", 'kind="relative", or "metric" where they are metres'
    else:
        cause = "inverse given as depth"
        text, remedy = "inverse depth", 'kind="inverse", or "affine_inverse" for a network\'s'
    return Suspicion(
        cause=cause,
        evidence=gain,
        p_value=p_value,
        detail=f"read as {text} the values make the known sizes {_odds(gain)} times more probable "
        f"({_chance(p_value)} by chance); pass {remedy}.",
    )


def _ray_suspicion(model: ScaleModel, claims: Claims) -> list[Suspicion]:
    """Try distances along the ray; with metric depth the camera is a witness."""
    slant = log_slant(model)
    if slant is None:
        return []
    stale = np.zeros(claims.size)
    if model.kind == "metric" and model.camera:
        error = math.hypot(model.camera.focal_rel_std, model.scale_rel_std)
        claims = with_focal(claims, model.camera.focal_px, error)
        slant, stale = np.append(slant, 0.0), np.append(stale, _STALE_STD**2)
    along_ray = claims.log_distance - slant
    p_value = _mean_over(claims, normal_below(-score_against(claims, along_ray)))
    if p_value >= _RAY_LEVEL:
        return []
    readings = np.stack([claims.log_distance, along_ray, claims.log_distance, claims.log_distance])
    other = np.where(claims.firm, 0.0, _OTHER_PICTURE_STD**2)
    none = np.zeros(claims.size)
    found = evidence(claims, readings, np.stack([none, none, stale, other]))
    if found[1] < np.delete(found, 1).max() + _RAY_ODDS:
        return []
    gain = float(found[1] - found[0])
    detail = (
        f"read as distances along the ray the values make the known sizes {_odds(gain)} times more "
        f"probable ({_chance(p_value)} by chance); pass DepthMap.from_ray_distance(values, camera)."
    )
    cause: Cause = "ray distance given as z-depth"
    return [Suspicion(cause=cause, evidence=gain, p_value=p_value, detail=detail)]


def _other_picture(
    model: ScaleModel, claims: Claims, chi2: FloatArray, p_value: float, gain: float
) -> Suspicion:
    """Say how much the references disagree."""
    usual = int(claims.case_weight.argmax())
    ratio = math.sqrt(float(chi2[usual]) / _freedom(model, claims))
    noise = f", depths within {math.sqrt(claims.depth_var[usual]):.0%}" if chi2.size > 1 else ""
    detail = (
        f"the {claims.size} references disagree by {ratio:.1f} times their errors{noise} "
        f"({_chance(p_value)} by chance); pass the depth of this very picture, or look for "
        f"{_culprit(model, claims)}."
    )
    cause: Cause = "depth of another picture"
    return Suspicion(cause=cause, evidence=gain, p_value=p_value, detail=detail)


def _culprit(model: ScaleModel, claims: Claims) -> str:
    """Name the one reference without which the others agree, if there is one."""
    if LAWS[model.kind].has_shift:
        return "references that are wrong"
    names = numbered_labels([ref.label for ref in model.references])
    candidates = [name for name, ref in zip(names, model.references, strict=True) if ref.candidate]
    agreement: list[float] = []
    for row in np.eye(claims.size):
        free = np.column_stack([np.ones(claims.size), row])  # k, and whatever this one is
        chi2 = chi_square(claims, claims.log_distance, free)
        agreement.append(_mean_over(claims, chi_square_above(chi2, claims.size - 2)))
    best = int(np.argmax(agreement))
    if agreement[best] < _AGREE:
        return "references that are wrong"
    return f"what is wrong with {candidates[best]}, without which the others agree"


def _wrong_scale(model: ScaleModel, claims: Claims, found: Sequence[Suspicion]) -> list[Suspicion]:
    """Compare the focal length with what it should be."""
    suspicions: list[Suspicion] = []
    low, _ = plausible_focal(model.image_size, model.references)
    if model.camera and model.camera.focal_px < low:
        detail = (
            f"the camera's focal length of {model.camera.focal_px:g} px would be that of a "
            f"fish-eye, below {low:.0f} px; multiply millimetres by the image's width in pixels "
            "over the sensor's in millimetres."
        )
        cause: Cause = "focal length not in pixels"
        suspicions.append(
            Suspicion(cause=cause, evidence=math.nan, p_value=math.nan, detail=detail)
        )
    check = check_focal(model, claims)
    if check is None or check.p_value >= _LEVEL:
        return suspicions
    if any(other.cause == "inverse given as depth" for other in found):
        return suspicions  # which as depth has no focal length
    units: list[UnitCause] = [unit for unit in check.units() if UNITS[unit] > 1 or not found]
    if units:
        return [*suspicions, _unit_suspicion(check, units)]
    return suspicions if found else [*suspicions, _focal_suspicion(check)]


def _unit_suspicion(check: FocalCheck, units: Sequence[UnitCause]) -> Suspicion:
    """Say which unit the depths or the sizes are in."""
    best = units[0]
    factor = UNITS[best]
    gain = math.nan
    if check.has_camera:
        left = math.log(check.factor / factor) / check.log_std
        gain = (check.z_score**2 - left**2) / 2
    what, by = ("depths", factor) if factor > 1 else ("sizes of the priors", 1 / factor)
    others = "".join(f", by {UNITS[name]:g} if in {name}" for name in units[1:])
    return Suspicion(
        cause=best,
        evidence=gain,
        p_value=check.p_value,
        detail=f"{_implied(check)}, and {check.implied_px / factor:.0f} px if the {what} are "
        f"divided by {by:g}{others}.",
    )


def _focal_suspicion(check: FocalCheck) -> Suspicion:
    """Say how far the focal length is off."""
    is_stale = check.has_camera and 1 / _LARGEST_STALE < check.factor < _LARGEST_STALE
    if not is_stale:
        return Suspicion(
            cause="unknown unit",
            evidence=math.nan,
            p_value=check.p_value,
            detail=f"{_implied(check)}; put depths and prior sizes into metres.",
        )
    return Suspicion(
        cause="stale focal length or resized picture",
        evidence=math.nan,
        p_value=check.p_value,
        detail=f"{_implied(check)}: {check.factor:.2f} times as long ({_chance(check.p_value)} by "
        "chance); pass the focal length of the picture as it is, in its own pixels.",
    )


def _implied(check: FocalCheck) -> str:
    """Say what the references imply of the focal length and what was expected."""
    seen = with_error(check.implied_px, check.implied_px * check.implied_rel_std)
    if check.has_camera:
        given = with_error(check.given_px, check.given_px * check.given_rel_std)
        return f"known sizes and depths imply a focal length of {seen} px, the camera says {given}"
    return (
        f"known sizes and depths imply a focal length of {seen} px, where photos have "
        f"{check.low_px:.0f} to {check.high_px:.0f}"
    )


def _mean_over(claims: Claims, values: FloatArray) -> float:
    """Average over what the noise of the depths may be."""
    return float(claims.case_weight @ values)


def _odds(gain: float) -> str:
    """Write a likelihood ratio."""
    return f"{math.exp(gain):.2g}" if gain < math.log(1e6) else "more than a million"


def _chance(p_value: float) -> str:
    """Write a small probability."""
    return f"p = {p_value:.1g}" if p_value >= 1e-6 else "p < 1e-6"
