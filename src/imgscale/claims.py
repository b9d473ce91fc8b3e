"""What the references of a model claim of k, as columns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imgscale._typing import BoolArray, FloatArray, IntArray
from imgscale.core.segments import MIN_VARIANCE, Parts, normalised
from imgscale.core.witnesses import noise_cases
from imgscale.laws import LAWS
from imgscale.model import ScaleModel
from imgscale.prior_choice import log_kinds, log_moments, mean_key, rows_along
from imgscale.reference import Reference
from imgscale.standing import scene_of, stance_of, viewpoint


class Claims(NamedTuple):
    """
    The candidates among a model's references as columns.

    Attributes
    ----------
    log_scale : (N,) ndarray of float64
        Log of prior size over pixels, as a level camera would show them; the mean over the kinds
        of thing that the label may be.
    kinds : Parts
        The same for each kind, (N, J), with the variance of the size alone.
    size_var, noise_var : (N,) ndarray of float64
        Variances of the log size, all kinds together, and of the log of d p as far as it was told.
    tau : (N,) ndarray of float64
        Standard deviation of the label's shared offset.
    group : (N,) ndarray of int
        Number of the label and axis.
    firm : (N,) ndarray of bool
        True for a camera.
    inverse_depth : (N,) ndarray of float64
        D of the one law ``p / H = (D + b) / k``, as the model's kind reads the depths.
    depth_var, case_weight : (K,) ndarray of float64
        What the noise of the depths may be beyond what was told, and how probable that is.
    """

    log_scale: FloatArray
    kinds: Parts
    size_var: FloatArray
    noise_var: FloatArray
    tau: FloatArray
    group: IntArray
    firm: BoolArray
    inverse_depth: FloatArray
    depth_var: FloatArray
    case_weight: FloatArray

    @property
    def size(self) -> int:
        """Number of rows."""
        return self.log_scale.size

    @property
    def log_distance(self) -> FloatArray:
        """Log of d where there is no shift, (N,)."""
        return -np.log(self.inverse_depth)

    def covariance(self, depth_var: float) -> FloatArray:
        """
        Compute the covariance of the own log k.

        Parameters
        ----------
        depth_var : float
            Variance of the log depths beyond what was told.

        Returns
        -------
        (N, N) ndarray of float64
            ``diag(v) + tau_i tau_j`` where i and j share a label.
        """
        own = self.size_var + self.noise_var + np.where(self.firm, 0.0, depth_var)
        together = self.group[:, None] == self.group
        shared = np.where(together, np.outer(self.tau, self.tau), 0.0)
        covariance: FloatArray = np.diag(np.maximum(own, MIN_VARIANCE)) + shared
        return covariance


def claims_of(model: ScaleModel) -> Claims:
    """
    Collect what the candidates among a model's references claim, without the camera.

    Parameters
    ----------
    model : ScaleModel
        The model.

    Returns
    -------
    Claims
        One row for each candidate, used or rejected, in their order.
    """
    refs = [ref for ref in model.references if ref.candidate]
    keys = [mean_key(ref.prior_label, ref.axis, model.priors) for ref in refs]
    numbers = {key: number for number, key in enumerate(dict.fromkeys(keys))}
    rows = [rows_along(ref.prior_label, ref.axis, model.priors) for ref in refs]
    columns = [
        (ref.pixels, ref.depth, ref.noise_rel, ref.prior_m, ref.prior_std_m, ref.prior_mean_std_m)
        for ref in refs
    ]
    pixels, depth, noise, mean_m, std_m, mean_std_m = np.array(columns).reshape(-1, 6).T
    size_log, size_var = log_moments(mean_m, std_m)
    log_pixels = np.log(pixels) + _log_tilt(model, refs)
    kinds = log_kinds(rows)
    cases = noise_cases(1, unknown_noise=model.unknown_noise)
    return Claims(
        log_scale=size_log - log_pixels,
        kinds=kinds._replace(mean=kinds.mean - log_pixels[:, None]),
        size_var=size_var,
        noise_var=noise**2,
        tau=mean_std_m / mean_m,
        group=np.array([numbers[key] for key in keys], dtype=np.intp),
        firm=np.zeros(len(refs), dtype=np.bool_),
        inverse_depth=LAWS[model.kind].inverse_depth(depth),
        depth_var=cases.depth_var.ravel(),
        case_weight=normalised(cases.log_prior.ravel(), 0),
    )


def with_focal(claims: Claims, focal_px: float, rel_std: float) -> Claims:
    """
    Add a camera to the claims of metric depth, where k = 1 / f.

    Parameters
    ----------
    claims : Claims
        What the references claim.
    focal_px : float
        Focal length in pixels.
    rel_std : float
        Its relative standard error, that of the map's scale included.

    Returns
    -------
    Claims
        One more row, the last, at the distance 1.
    """
    width = claims.kinds.share.shape[1]
    share = np.eye(1, width)
    more = Parts(share, np.full_like(share, -math.log(focal_px)), np.full_like(share, rel_std**2))
    kinds = Parts(*(np.concatenate(pair) for pair in zip(claims.kinds, more, strict=True)))
    return claims._replace(
        log_scale=np.append(claims.log_scale, -math.log(focal_px)),
        kinds=kinds,
        size_var=np.append(claims.size_var, rel_std**2),
        noise_var=np.append(claims.noise_var, 0.0),
        tau=np.append(claims.tau, 0.0),
        group=np.append(claims.group, claims.group.max(initial=-1) + 1),
        firm=np.append(claims.firm, True),
        inverse_depth=np.append(claims.inverse_depth, 1.0),
    )


def _log_tilt(model: ScaleModel, refs: Sequence[Reference]) -> FloatArray:
    """Log of what a level camera would show of upright objects over what a tilted one does."""
    view = viewpoint(model.kind, model.ground, model.camera, model.image_size, model.noise)
    if view is None:
        return np.zeros(len(refs))
    horizon = scene_of(view).horizon if model.plane is None else model.plane.horizon_px - view.cy
    boxes = np.array([ref.xyxy for ref in refs], dtype=np.float64).reshape(-1, 4)
    upright = np.array([ref.axis == "height" for ref in refs], dtype=np.bool_)
    stance = stance_of(view, boxes, boxes[:, 2:] * np.nan, upright, np.zeros(len(refs)))
    by_depth: FloatArray = stance.tilts(np.full((1, len(refs)), horizon)).by_depth[0]
    return by_depth
