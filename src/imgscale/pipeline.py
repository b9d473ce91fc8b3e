"""The whole chain on one picture: detect, read depth, fit, predict."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike, fspath

from imgscale._typing import FitMethod, ImageSize, SizeAxis
from imgscale.camera import Camera
from imgscale.depth import Depth, GroundPlane, check_depth_type
from imgscale.detection import Detection, check_detections
from imgscale.fitting import fit
from imgscale.measurement import Measurement
from imgscale.noise import Noise
from imgscale.picture import Picture, upright_rgb
from imgscale.prediction import predict
from imgscale.priors import PriorTable
from imgscale.protocols import DepthSource, Detector

__all__ = ["measure"]

_PAIR = 2  # a depth and a camera


def measure(
    image: Picture,
    *,
    detector: Detector | Sequence[Detection],
    depth_source: DepthSource | Depth,
    priors: PriorTable | None = None,
    ground: GroundPlane | None = None,
    camera: Camera | None = None,
    method: FitMethod = "posterior",
    noise: Noise = Noise(),  # noqa: B008 - frozen
    axis: SizeAxis = "height",
    use_prior: bool = False,
) -> Measurement:
    """
    Size everything that a detector sees in a picture.

    Parameters
    ----------
    image : path, (H, W, 3) ndarray of uint8 or PIL image
        The picture. A file's or PIL image's EXIF orientation is applied once, before anything
        looks at it; an array is taken as it is.
    detector : Detector or sequence of Detection
        Gives the detections of an RGB array; or the detections themselves, where you have them.
    depth_source : DepthSource, DepthMap, ObjectDepths or GroundPlane
        Gives the depth of an RGB array, or the depth and the camera that a network saw; or the
        depth itself.
    priors : PriorTable, optional
        Sizes by label; the shipped table where omitted.
    ground : GroundPlane, optional
        As for `fit`.
    camera : Camera, optional
        As for `fit`. Where omitted, the one that the depth source gives, if it gives one.
    method : str
        As for `fit`.
    noise : Noise
        As for `fit`.
    axis : str
        As for `predict`.
    use_prior : bool
        As for `predict`.

    Returns
    -------
    Measurement
        Model, sizes, detections and depth.

    Raises
    ------
    FitError
        If no detection can be a reference.
    TypeError
        If `image` is no picture, `detector` gives no detections or `depth_source` no depth.
    ValueError
        If an argument breaks its law.
    OSError
        If the file is missing or no picture.

    Examples
    --------
    Any function is a detector or a depth source, and so is what it would return:

    >>> import numpy as np
    >>> import imgscale as ims
    >>> image = np.zeros((480, 640, 3), dtype=np.uint8)
    >>> result = ims.measure(
    ...     image,
    ...     detector=[ims.Detection("door", (100, 50, 180, 250))],
    ...     depth_source=lambda image: ims.DepthMap(np.full(image.shape[:2], 4.0), kind="relative"),
    ... )
    >>> result.image_size
    (640, 480)
    """
    pixels = upright_rgb(image)
    size = (pixels.shape[1], pixels.shape[0])
    # a copy for each, which it may draw on
    detections = _detections(detector(pixels.copy()) if callable(detector) else detector)
    seen = depth_source(pixels.copy()) if callable(depth_source) else depth_source
    depth, own_camera = _with_camera(seen)
    _check_depth(depth, size)
    camera = camera or own_camera
    model = fit(detections, depth, priors, ground=ground, camera=camera, method=method, noise=noise)
    estimates = predict(model, detections, depth, axis=axis, use_prior=use_prior)
    return Measurement(
        model=model,
        estimates=tuple(estimates),
        detections=detections,
        depth=depth,
        image_size=size,
        name=fspath(image) if isinstance(image, (str, PathLike)) else "",
    )


def _detections(found: Sequence[Detection]) -> tuple[Detection, ...]:
    """Raise in the detector's name where it gave no detections."""
    try:
        return check_detections(found)
    except TypeError as error:
        msg = (
            "`detector` must be or return a sequence of Detection objects, an empty one where it "
            f"sees nothing; {error}"
        )
        raise TypeError(msg) from error


def _with_camera(seen: Depth | tuple[Depth, Camera | None]) -> tuple[Depth, Camera | None]:
    """Tell what a depth source gave: a depth, or a pair of that and a camera."""
    if not isinstance(seen, tuple):
        return seen, None
    if len(seen) != _PAIR:
        msg = (
            "`depth_source` must return a depth, or a pair of depth and camera; got a tuple of "
            f"{len(seen)}."
        )
        raise TypeError(msg)
    return seen


def _check_depth(depth: Depth, size: ImageSize) -> None:
    """Raise where a source gave no depth, or that of another picture."""
    check_depth_type(depth)
    if size != depth.image_size == size[::-1]:
        msg = (
            f"`depth_source` must give depth as upright as the picture, {size[0]} x {size[1]} px; "
            f"got image_size={depth.image_size}. Transpose the map, values.T, or apply the EXIF "
            "orientation before its depth is made."
        )
        raise ValueError(msg)
    if depth.image_size not in {None, size}:
        msg = (
            f"`depth_source` must give depth for the picture, {size[0]} x {size[1]} px; got "
            f"image_size={depth.image_size}. Pass image_size=(width, height) of the picture to a "
            "DepthMap of another size."
        )
        raise ValueError(msg)
