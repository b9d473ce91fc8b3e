"""The verb `distance`: a tape measure between two pixels, in three dimensions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgscale._checks import as_flag, check_type
from imgscale._depth_values import valid_depths
from imgscale._typing import BoolArray, FloatArray, ImageSize
from imgscale.camera import Camera
from imgscale.core.mixture import MEDIAN, SCORES, half_width
from imgscale.core.predictive import scale_under
from imgscale.core.solving import Cases
from imgscale.core.stance import Stance
from imgscale.core.tape import Ends, Lens, length_quantiles, log_length
from imgscale.core.witnesses import UNKNOWN_DEPTH_REL, Nuisance
from imgscale.depth import DepthMap, GroundPlane, ObjectDepths
from imgscale.detection import Detection
from imgscale.flags import Flag, flags_where
from imgscale.laws import LAWS
from imgscale.lookup import Lookup, Solved, look_up, solved
from imgscale.measuring._given import given_array
from imgscale.model import ScaleModel
from imgscale.noise import Noise
from imgscale.object_depth import object_depths
from imgscale.posing import view_of
from imgscale.quantity import Quantity
from imgscale.sampling import OTHER_LOG_GAP, SURFACE_LOG_WIDTH
from imgscale.sizing import HIGH, LOW, TWO_STD, is_far_off, map_share
from imgscale.standing import Viewpoint, stance_of

__all__ = ["distance"]

# Depth is read in a window of 6 pixels of the map, or 16 where that has none; a pixel's own depth
# stands where this share of its neighbours is on its surface: a corner of a box has 4 of 9.
_REACHES, _SUPPORT = (3.0, 8.0), 0.4
_SAME_LOG_DEPTH = 1e-9


def distance(
    model: ScaleModel,
    p1: Sequence[float] | NDArray[Any],
    p2: Sequence[float] | NDArray[Any],
    depth: DepthMap | GroundPlane | None = None,
    *,
    camera: Camera | None = None,
    same_object: bool = False,
    same_scale: bool = False,
) -> Quantity:
    """
    Measure the distance of two points in space, with a tape between two pixels.

    Parameters
    ----------
    model : ScaleModel
        The scale of the image.
    p1, p2 : (2,) sequence of float
        The pixels, (x, y) with the left edge of the first one at 0. On a ground plane they are
        points of the ground.
    depth : DepthMap, optional
        The map, of the model's kind; to be left out where that is the ground plane.
    camera : Camera, optional
        Focal length and principal point, where the model has none or others. Points of one depth
        need none. With metric depth, on a ground plane and where it is tilted it must be the
        model's, as it is part of the fit.
    same_object : bool
        Both points are of one object, at which the map errs alike. By default the depths of the two
        err independently, each as `Noise.depth_rel` or the references say.
    same_scale : bool
        Vouch that another map than the fitted one has the same scale.

    Returns
    -------
    Quantity
        In metres; NaN with a flag where a point has no depth, or on a ground plane lies above the
        horizon.

    Raises
    ------
    ValueError
        If a point is outside the image, `depth` is missing, or the focal length is needed and
        missing.
    TypeError
        If an argument is of the wrong type, as `ObjectDepths` are, which know nothing of pixels.
    DepthMismatchError
        If `depth` is of another kind or image size than the model's, another ground plane or,
        unless the kind is metric, another map.

    Notes
    -----
    A pinhole camera puts the pixel (u, v) of the relative distance d at (k d (u - cx),
    k d (v - cy), f k d); the camera's pitch does not matter, d being along its axis. On the ground
    plane d follows from the horizon and the camera's height, and the pitch from the horizon and f.
    With metric depth f k d is the depth itself.

    The depth of a pixel is its own where its neighbours share it, else that of the dominant
    surface around it; MIXED_DEPTH tells where two meet. `value` is the distance of the points as
    they are seen. Its distribution takes the joint one of k, shift, horizon and focal length, the
    errors of both depths, and the error of the separation of the pixels, `Noise.box_px` as for the
    edges of a box. Where the points are no farther apart than these errors the length is no
    log-normal: the interval begins at the length that is left without what is only noise, at 0 for
    neighbouring pixels. Points apart in depth by less than its error seem farther apart than they
    are; `same_object` takes what the map errs alike out.

    Examples
    --------
    >>> import numpy as np
    >>> import imgscale as ims
    >>> from imgscale.measuring import distance
    >>> depth = ims.DepthMap(np.full((480, 640), 4.0), kind="relative")
    >>> door = ims.Detection("door", (100, 50, 180, 250))
    >>> table = ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.02)])
    >>> model = ims.fit([door], depth, table, noise=ims.Noise(depth_rel=0.01))
    >>> print(distance(model, (300, 100), (420, 260), depth))
    2.00 +- 0.04 m
    """
    check_type("same_object", as_flag(same_object), bool)
    lookup = look_up(model, depth, same_scale=same_scale)
    lookup.check_plane()
    usable = lookup.depth
    if isinstance(usable, ObjectDepths):
        msg = (
            "`depth` must be a DepthMap, in which the depths of two pixels can be looked up; got "
            "ObjectDepths, one value per object."
        )
        raise TypeError(msg)
    size = usable.image_size
    points = np.array([_point(name, p, size) for name, p in (("p1", p1), ("p2", p2))])
    camera = _camera(model, camera, size)
    found = solved(model)
    if isinstance(usable, DepthMap):
        seen = _depths_at(lookup, usable, points, found, same_object=same_object)
    else:
        seen = _feet_at(model, points, found, same_object=same_object)
    if not np.isfinite(seen.best).all():
        return Quantity(value=math.nan, std=math.nan, unit="m", flags=seen.flags)
    if np.array_equal(points[0], points[1]):
        return Quantity(
            value=0.0, std=0.0, unit="m", flags=seen.flags, quantiles=(0.0,) * SCORES.size
        )
    apart = bool(abs(seen.best[0] - seen.best[1]) > _SAME_LOG_DEPTH)
    if apart and camera is None and model.kind != "metric":
        raise ValueError(_focal_missing(model))
    return _length(lookup, found.cases, _ends(model, points, camera, size, seen), camera, seen)


def _camera(model: ScaleModel, camera: Camera | None, size: ImageSize) -> Camera | None:
    """Choose the camera, and check that it belongs to the picture."""
    if camera is None:
        return model.camera
    check_type("camera", camera, Camera).check_image_size(size)
    if camera == model.camera:
        return camera
    why = {
        "ground_plane": "on a ground plane, where it is part of the fit",
        "metric": "with metric depth, where its focal length tells k",
    }.get(model.kind, "where it is tilted, as the fit corrects references for that")
    if model.kind in {"ground_plane", "metric"} or camera.is_tilted:
        msg = (
            f"`camera` must be the model's {why}; got another. Give it to `fit`: fit(detections, "
            "depth, camera=...)."
        )
        raise ValueError(msg)
    return camera


def _centre(camera: Camera | None, size: ImageSize) -> tuple[float, float]:
    """Tell the principal point: the camera's, else the middle of the image."""
    cx = size[0] / 2 if camera is None or camera.cx is None else camera.cx
    cy = size[1] / 2 if camera is None or camera.cy is None else camera.cy
    return cx, cy


class _Points(NamedTuple):
    """
    What is seen of two points: log d under each case (K, 2), and of the best one (2,).

    The variances of its error are own ones (K, 2) and common ones (K,).
    """

    log_distance: FloatArray
    best: FloatArray
    own_var: FloatArray
    common_var: FloatArray
    flags: Flag


def _point(name: str, value: ArrayLike, size: ImageSize) -> tuple[float, float]:
    """Check a pixel."""
    array = given_array(name, "two numbers (x, y)", value)
    if array.shape != (2,) or array.dtype.kind not in "fiu":
        msg = f"`{name}` must be two numbers (x, y) in pixels; got {value!r}."
        raise ValueError(msg)
    x, y = float(array[0]), float(array[1])
    if not (math.isfinite(x) and math.isfinite(y)):
        msg = f"`{name}` must be finite; got {(x, y)}."
        raise ValueError(msg)
    if not (0 <= x <= size[0] and 0 <= y <= size[1]):
        msg = (
            f"`{name}` must lie in the image, {size[0]} x {size[1]} px; got {(x, y)}. Pixels are "
            "(x, y), the column first."
        )
        raise ValueError(msg)
    return x, y


def _depths_at(
    lookup: Lookup, depth: DepthMap, points: FloatArray, found: Solved, *, same_object: bool
) -> _Points:
    """Look two pixels up in a map."""
    model, cases = lookup.model, found.cases
    value, spread_var, mixed = _read(depth, points, model.shift)
    inverse = LAWS[model.kind].inverse_depth(value)
    told = 0.0 if model.noise.depth_rel is None else model.noise.depth_rel**2
    unknown = model.noise.depth_rel is None
    if unknown and model.depth_rel is None:  # fitted to depths whose noise was told
        told += UNKNOWN_DEPTH_REL**2
    of_map = told + (cases.nuisance.depth_var[:, 0] if unknown else 0.0)
    of_map = np.broadcast_to(of_map, (cases.nuisance.n_cases,))
    # with metric depth the lens holds the error of the fitted map's scale
    other = lookup.other_var - (model.scale_rel_std**2 if _metric_other(lookup) else 0.0)
    best = _log_distance(inverse, cases.best.shift)[0]
    under = _log_distance(inverse, cases.nuisance.shift)
    flags = {
        Flag.NO_DEPTH: bool(np.isnan(value).any()),
        Flag.MIXED_DEPTH: bool(mixed.any()),
        Flag.BEYOND_HORIZON: bool(np.isinf(best).any()),
        Flag.EXTRAPOLATED: bool(cases.best.shift.any())
        and bool(is_far_off(best, found.references, cases).any()),
    }
    own = spread_var + (0.0 if same_object else of_map[:, None])
    return _Points(
        log_distance=under,
        best=best,
        own_var=np.broadcast_to(own, under.shape),
        common_var=of_map * same_object + other,
        flags=flags_where(flags),
    )


def _metric_other(lookup: Lookup) -> bool:
    """Tell whether it is another map than the fitted one, in metres."""
    return lookup.other_map and lookup.model.kind == "metric"


def _log_distance(inverse: FloatArray, shift: FloatArray) -> FloatArray:
    """Log of d = 1 / (D + b) for each case; NaN without a depth, inf beyond the horizon."""
    shifted = inverse + shift[:, :1]
    with np.errstate(divide="ignore", invalid="ignore"):
        logs: FloatArray = -np.log(np.where(shifted < 0, 0.0, shifted))
    return logs


def _read(
    depth: DepthMap, points: FloatArray, shift: float
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Depths of pixels, the variances of the logs of the surfaces there, and where two meet."""
    height, width = depth.values.shape
    per_pixel = np.array([depth.image_size[0] / width, depth.image_size[1] / height])
    values, variances = np.full(2, np.nan), np.zeros(2)
    mixed = np.zeros(2, dtype=np.bool_)
    for row, point in enumerate(points):
        for reach in _REACHES:
            box = np.concatenate([point - reach * per_pixel, point + reach * per_pixel])
            found = object_depths([Detection("point", box)], depth, Noise(depth_rel=0.0))
            if not math.isnan(found.value[0]):
                values[row], mixed[row] = found.value[0], found.mixed[0]
                variances[row] = found.rel_std[0] ** 2
                break
        own, meet = _own_depth(depth, point / per_pixel, shift)
        values[row] = values[row] if math.isnan(own) else own
        mixed[row] |= meet
    return values, variances, mixed


def _own_depth(depth: DepthMap, place: FloatArray, shift: float) -> tuple[float, bool]:
    """
    Look at the pixel of the map at a place, and at its neighbours.

    Returns
    -------
    float
        Its depth, NaN where its neighbours do not share it.
    bool
        True where two surfaces meet here: a click within a pixel of an edge may be of either.
    """
    height, width = depth.values.shape
    column, row = min(int(place[0]), width - 1), min(int(place[1]), height - 1)
    around = depth.values[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
    around = around[valid_depths(around, depth.kind)].astype(np.float64)
    own = float(depth.values[row, column])
    with np.errstate(divide="ignore", invalid="ignore"):
        law = LAWS[depth.kind]
        logs = np.log(law.inverse_depth(around) + shift)
        off = np.abs(logs - np.log(law.inverse_depth(own) + shift))
    seen = logs[np.isfinite(logs)]
    meet = bool(seen.size and np.ptp(seen) > OTHER_LOG_GAP)
    if not valid_depths(np.array([own]), depth.kind)[0]:
        return math.nan, meet
    return (own if (off <= SURFACE_LOG_WIDTH).mean() >= _SUPPORT else math.nan), meet


def _feet_at(model: ScaleModel, points: FloatArray, found: Solved, *, same_object: bool) -> _Points:
    """Look two points of the ground up in the fitted plane."""
    cases = found.cases
    view = cast("Viewpoint", view_of(model))  # a ground plane has one
    both = np.zeros(2, dtype=np.bool_)
    stance = stance_of(view, np.tile(points, 2), points, both, np.zeros(2))
    best = _on_plane(stance, cases.best)[0][0]
    under, below = _on_plane(stance, cases.nuisance)
    of_foot = stance.foot_var / (below**2 + stance.foot_var)
    flags = {
        Flag.BEYOND_HORIZON: bool(np.isinf(best).any()),
        Flag.EXTRAPOLATED: bool(is_far_off(best, found.references, cases).any()),
    }
    relief = stance.relief_var * (not same_object)
    return _Points(
        log_distance=under,
        best=best,
        own_var=of_foot + relief,
        common_var=np.full(len(under), float(stance.relief_var[0]) * same_object),
        flags=flags_where(flags),
    )


def _on_plane(stance: Stance, nuisance: Nuisance) -> tuple[FloatArray, FloatArray]:
    """Log of d of feet for each case, inf beyond the horizon; and their rows below it."""
    columns = (nuisance.horizon, nuisance.slope, nuisance.gap, nuisance.log_focal)
    horizon, slope, gap, log_focal = (
        np.zeros((1, 1)) if column is None else column[:, :1] for column in columns
    )
    rows = stance.below_horizon(horizon, slope)
    below = np.where(rows > 0, rows, 1.0)
    log_secant = stance.tilts(horizon + np.zeros(2), log_focal).log_secant
    return np.where(rows > 0, gap + log_secant - np.log(below), np.inf), below


def _ends(
    model: ScaleModel, points: FloatArray, camera: Camera | None, size: ImageSize, seen: _Points
) -> Ends:
    """Put the points where the core takes them."""
    apart = math.dist(points[0], points[1])
    noise = model.noise
    return Ends(
        xy=points - np.array(_centre(camera, size)),
        log_distance=seen.log_distance,
        own_var=seen.own_var,
        common_var=seen.common_var,
        separation_var=noise.box_px**2 + (noise.box_rel * apart) ** 2,
    )


def _lens(lookup: Lookup, camera: Camera | None, nuisance: Nuisance) -> Lens:
    """Tell what is known of the focal length, where it is needed."""
    model, zero = lookup.model, np.zeros(nuisance.n_cases)
    if model.kind == "metric":
        if camera is None or lookup.other_map:  # the depth is the depth, whatever k is
            return Lens(zero, -1.0, model.scale_rel_std, undone=lookup.other_map)
        share = map_share(model.scale_rel_std, camera.focal_rel_std)
        log_focal = zero + share * math.log(camera.focal_px)
        return Lens(log_focal, share - 1.0, math.sqrt(share) * camera.focal_rel_std)
    if camera is None:  # and both at one depth
        return Lens(zero + np.inf)
    log_focal = zero + math.log(camera.focal_px)
    if camera == model.camera and nuisance.log_focal is not None:
        return Lens(log_focal + nuisance.log_focal[:, 0])
    return Lens(log_focal, std=camera.focal_rel_std)


def _focal_missing(model: ScaleModel) -> str:
    """Say what a focal length is needed for."""
    if model.kind == "ground_plane":
        return (
            "`camera` must be known to measure along the view; the fit had none, and p1 and p2 are "
            "not equally far (nor in one row, unless roll_deg=0.0, roll_std_deg=0.0 of the "
            "GroundPlane say so). Give it to `fit`: fit(detections, depth, camera=Camera(focal_px, "
            "focal_rel_std=...))."
        )
    return (
        f'`camera` must be given to measure between two depths of kind "{model.kind}", which tell '
        "lengths along the view only with a focal length; got None, and p1 and p2 are not equally "
        "far. Pass camera=Camera(focal_px, focal_rel_std=...), from the calibration or "
        "Camera.from_exif(photo)."
    )


def _length(
    lookup: Lookup, cases: Cases, ends: Ends, camera: Camera | None, seen: _Points
) -> Quantity:
    """Measure with all that is known."""
    log_k = np.array([math.log(lookup.model.k)])
    lens = _lens(lookup, camera, cases.best)
    log_focal = lens.log_focal + lens.by_scale * log_k
    value = float(np.exp(log_length(log_k, seen.best[None], ends.xy[None], log_focal)[0]))
    lens = _lens(lookup, camera, cases.nuisance)
    quantiles = length_quantiles(scale_under(cases), ends, lens)
    # the likeliest solution's length is no median where others, far from it, weigh more together
    if not quantiles[LOW] <= value <= quantiles[HIGH] and math.isfinite(quantiles[MEDIAN]):
        value = float(quantiles[MEDIAN])
    beyond = Flag.BEYOND_HORIZON if np.isinf(quantiles[TWO_STD]) else Flag(0)
    return Quantity(
        value=value,
        std=float(half_width(quantiles[None])[0]),
        unit="m",
        flags=seen.flags | beyond,
        quantiles=tuple(quantiles.tolist()),
    )
