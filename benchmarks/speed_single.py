"""Rows of the table: one picture, detections in, a model with interval and references out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from skimage.measure import ransac
from speed_peers import has
from speed_rounds import Row, Run, Timing, timed, traced_peak

import imgscale as ims

COUNTS = (3, 10, 30)
_PREDICTED = 10
_LEAST_RATIO = {3: 15.0, 10: 10.0, 30: 6.0}
_POSTERIOR_RATIO = 1 / 5
_LABELS = {"car": 1.5, "person": 1.72, "bus": 3.1}
_FOCAL_PX, _HEIGHT_M, _HORIZON, _IMAGE_SIZE = 1200.0, 1.6, 500.0, (1920, 1080)
_DEPTH_REL, _SPREAD = 0.06, 0.1
_HUBER = "scipy least_squares(huber)"
# "fit, noise told" knows the error of the depths, as its peers do; the others learn it.
_FITS: Mapping[str, Mapping[str, object]] = {
    "robust, noise told": {"method": "robust", "noise": ims.Noise(depth_rel=_DEPTH_REL)},
    "robust": {"method": "robust"},
    "posterior, noise told": {"method": "posterior", "noise": ims.Noise(depth_rel=_DEPTH_REL)},
    "posterior": {"method": "posterior"},
}
FloatArray = NDArray[np.float64]


class OneScale:
    """A model for `skimage.measure.ransac`: y = log k."""

    def __init__(self, log_k: float) -> None:
        self.log_k = log_k

    @classmethod
    def from_estimate(cls, data: FloatArray) -> OneScale:
        """Take the median of some."""
        return cls(float(np.median(data)))

    def residuals(self, data: FloatArray) -> FloatArray:
        """Tell how far off others are."""
        distance: FloatArray = np.abs(data - self.log_k).ravel()
        return distance


def rows(rounds: int, *, quick: bool) -> list[Row]:
    """Time metric depths beside what is at hand for robust fits."""
    return [row for count in COUNTS[: 1 if quick else None] for row in _of_count(count, rounds)]


def kind_rows(rounds: int, *, quick: bool) -> list[Row]:
    """Time `fit` and `predict` by kind of depth."""
    counts = (_PREDICTED,) if quick else COUNTS
    return [row for count in counts for row in _of_kinds(count, rounds)]


def _of_count(count: int, rounds: int) -> Iterator[Row]:
    detections, z_m = objects(count)
    depth = depths(z_m)["metric"]
    calls: dict[str, Run] = {
        name: partial(_fitted, detections, depth, options) for name, options in _FITS.items()
    }
    others = dict(peers(detections, z_m))
    took = _timed(calls | others, rounds)
    size = f"n = {count}"
    least = _LEAST_RATIO[count]
    for name in ("robust, noise told", "robust"):
        yield Row(f"fit, {name}", size, took[name], _HUBER, took[_HUBER], least)
    for other in list(others)[1:]:
        first = "robust, noise told"
        yield Row(f"fit, {first}", size, took[first], other, took[other])
    for name in ("posterior, noise told", "posterior"):
        robust = name.replace("posterior", "robust")
        same = f"our {robust}"
        yield Row(f"fit, {name}", size, took[name], same, took[robust], _POSTERIOR_RATIO)
        yield Row(f"fit, {name}", size, took[name], _HUBER, took[_HUBER])


def _of_kinds(count: int, rounds: int) -> Iterator[Row]:
    detections, z_m = objects(count)
    calls: dict[str, Run] = {_HUBER: dict(peers(detections, z_m))[_HUBER]}
    for kind, depth in depths(z_m).items():
        for method in ("robust", "posterior"):
            calls[f"fit, {kind}, {method}"] = partial(ims.fit, detections, depth, method=method)
            if count == _PREDICTED:
                model = ims.fit(detections, depth, method=method)
                again = None if kind == "ground_plane" else depth
                calls[f"predict, {kind}, {method}"] = partial(ims.predict, model, detections, again)
    took = _timed(calls, rounds)
    for name, timing in took.items():
        if name != _HUBER:
            yield Row(name, f"n = {count}", timing, _HUBER, took[_HUBER])


def _timed(calls: Mapping[str, Run], rounds: int) -> dict[str, Timing]:
    peaks = {name: traced_peak(call) for name, call in calls.items()}
    return timed(calls, rounds, peaks=peaks)


def _fitted(
    detections: list[ims.Detection], depth: ims.Depth, options: Mapping[str, object]
) -> object:
    model = ims.fit(detections, depth, **options)  # type: ignore[arg-type]
    return model.k, model.k_std, model.references, model.flags


def objects(count: int) -> tuple[list[ims.Detection], FloatArray]:
    """Stand things on a plane before a level camera; their boxes and z-depths."""
    rng = np.random.default_rng(count)
    z_m = rng.uniform(5.0, 40.0, count)
    found: list[ims.Detection] = []
    for index, z in enumerate(z_m):
        label, size_m = list(_LABELS.items())[index % len(_LABELS)]
        pixels = _FOCAL_PX * size_m / z * rng.lognormal(0.0, 0.05)
        foot = _HORIZON + _FOCAL_PX * _HEIGHT_M / z
        left = rng.uniform(100, 1700)
        found.append(ims.Detection(label, (left, foot - pixels, left + 0.5 * pixels, foot)))
    return found, z_m


def depths(z_m: FloatArray) -> dict[str, ims.Depth]:
    """Give the same distances as every kind of depth that is fitted in its own way."""
    shifted = 90 / z_m + 3
    return {
        "metric": ims.ObjectDepths(z_m, kind="metric", image_size=_IMAGE_SIZE),
        "affine_inverse": ims.ObjectDepths(shifted, kind="affine_inverse", image_size=_IMAGE_SIZE),
        "ground_plane": ims.GroundPlane(image_size=_IMAGE_SIZE),
    }


def peers(detections: list[ims.Detection], z_m: FloatArray) -> Iterator[tuple[str, Run]]:
    """
    Fit log k by what others have, columns ready.

    None gives an interval that holds the error of a label's mean size, and none but the last two
    fits any other; RANSAC tells which references it believes.
    """
    pixels = np.array([found.xyxy[3] - found.xyxy[1] for found in detections])
    log_k = np.log([_LABELS[found.label] for found in detections]) - np.log(z_m * pixels)
    ones = np.ones((log_k.size, 1))
    start = [float(np.median(log_k))]
    yield (
        _HUBER,
        lambda: least_squares(lambda unknown: (unknown[0] - log_k) / _SPREAD, start, loss="huber"),
    )
    if has("sklearn"):
        yield from _of_sklearn(ones, log_k)
    if has("statsmodels"):
        from statsmodels.api import RLM  # noqa: PLC0415 - a peer that may be missing

        yield "statsmodels RLM", lambda: RLM(log_k, ones).fit().conf_int()
    least = min(2, log_k.size)
    data = log_k[:, None]
    yield (
        "skimage ransac",
        lambda: ransac(data, OneScale, least, 2.5 * _SPREAD, max_trials=100, rng=0),
    )


def _of_sklearn(ones: FloatArray, log_k: FloatArray) -> Iterator[tuple[str, Callable[[], object]]]:
    from sklearn.linear_model import (  # noqa: PLC0415 - a peer that may be missing
        HuberRegressor,
        LinearRegression,
        RANSACRegressor,
    )

    huber = HuberRegressor(fit_intercept=False)
    yield "sklearn HuberRegressor", lambda: huber.fit(ones, log_k)
    estimator = RANSACRegressor(
        LinearRegression(fit_intercept=False),
        min_samples=1,
        residual_threshold=2.5 * _SPREAD,
        random_state=0,
    )
    yield "sklearn RANSACRegressor", lambda: estimator.fit(ones, log_k)
