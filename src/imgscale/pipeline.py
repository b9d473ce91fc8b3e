"""The whole chain on one picture: detect, read depth, fit, predict."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import attrs
import numpy as np
from numpy.typing import NDArray

from imgscale._typing import FitMethod, ImageArray, ImageSize, SizeAxis
from imgscale.camera import Camera
from imgscale.depth import Depth, check_depth_type
from imgscale.detection import Detection, check_detections
from imgscale.estimate import SizeEstimate
from imgscale.fitting import fit
from imgscale.model import ScaleModel
from imgscale.noise import Noise
from imgscale.prediction import predict
from imgscale.priors import PriorTable
from imgscale.protocols import DepthSource, Detector

if TYPE_CHECKING:
    from PIL.Image import Image as PillowImage

__all__ = ["Measurement", "measure"]


@attrs.frozen
class Measurement:
    """
    Everything that came out of one picture.

    Attributes
    ----------
    model : ScaleModel
        Its scale.
    estimates : tuple of SizeEstimate
        One per detection.
    detections : tuple of Detection
        What the detector saw.
    depth : DepthMap or ObjectDepths
        What the depth source gave.
    image_size : (width, height)
        Size of the upright picture in pixels.
    """

    model: ScaleModel
    estimates: tuple[SizeEstimate, ...]
    detections: tuple[Detection, ...]
    depth: Depth = attrs.field(eq=False)
    image_size: ImageSize


def measure(
    image: str | PathLike[str] | ImageArray | PillowImage,
    *,
    detector: Detector,
    depth_source: DepthSource,
    priors: PriorTable | None = None,
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
    detector : Detector
        Gives the detections of an RGB array.
    depth_source : DepthSource
        Gives the depth of an RGB array.
    priors : PriorTable, optional
        Sizes by label; the shipped table where omitted.
    camera : Camera, optional
        As for `fit`.
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
        If `image` is no picture.
    ValueError
        If an argument breaks its law.

    Examples
    --------
    Any function is a detector or a depth source:

    >>> import numpy as np
    >>> import imgscale as ims
    >>> image = np.zeros((480, 640, 3), dtype=np.uint8)
    >>> result = ims.measure(
    ...     image,
    ...     detector=lambda image: [ims.Detection("door", (100, 50, 180, 250))],
    ...     depth_source=lambda image: ims.DepthMap(np.full(image.shape[:2], 4.0), kind="relative"),
    ... )
    >>> result.image_size
    (640, 480)
    """
    pixels = _upright_rgb(image)
    # a copy for each, which it may draw on
    detections = check_detections(detector(pixels.copy()))
    depth = check_depth_type(depth_source(pixels.copy()))
    size = (pixels.shape[1], pixels.shape[0])
    if depth.image_size not in {None, size}:
        msg = (
            f"`depth_source` must give depth for the picture, {size[0]} x {size[1]} px; got "
            f"image_size={depth.image_size}. Pass image_size=(width, height) of the picture to a "
            "DepthMap of another size."
        )
        raise ValueError(msg)
    model = fit(detections, depth, priors, camera=camera, method=method, noise=noise)
    estimates = predict(model, detections, depth, axis=axis, use_prior=use_prior)
    return Measurement(
        model=model,
        estimates=tuple(estimates),
        detections=detections,
        depth=depth,
        image_size=size,
    )


def _upright_rgb(image: object) -> ImageArray:
    """Read a picture as (H, W, 3) uint8 RGB with its orientation applied."""
    if isinstance(image, np.ndarray):
        array = cast("NDArray[Any]", image)
        if array.dtype != np.uint8 or array.ndim != 3 or array.shape[2] != 3:
            msg = (
                f"`image` must be (H, W, 3) uint8 RGB; got {array.shape} {array.dtype}. Convert it "
                "first, or pass the file's path."
            )
            raise ValueError(msg)
        return array
    from PIL import Image, ImageOps  # noqa: PLC0415 - 20 ms that most users do not need

    if isinstance(image, (str, PathLike)):
        with Image.open(Path(cast("str | PathLike[str]", image))) as opened:
            return _eight_bits(ImageOps.exif_transpose(opened))
    if isinstance(image, Image.Image):
        return _eight_bits(ImageOps.exif_transpose(image))
    msg = f"`image` must be a path, an array or a PIL image; got {type(image).__name__}."
    raise TypeError(msg)


def _eight_bits(image: PillowImage) -> ImageArray:
    """Turn a picture into RGB; deeper ones would be clipped."""
    if image.mode[0] in "IF":
        msg = f'`image` must have 8 bits per channel; got mode "{image.mode}". Scale it first.'
        raise ValueError(msg)
    return np.asarray(image.convert("RGB"))
