"""
Results of ultralytics models, read by duck typing: the package is never imported.

Conventions there: boxes are float pixels of the picture, x1, y1, x2, y2; class numbers come as
floats; masks have the size of the network's input, in which the picture stands centred between
grey bars; pictures as arrays are BGR. Reads the attributes of `Results` of ultralytics 8.1 to 8.4.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, cast

import attrs
import numpy as np

from imgscale._checks import as_float, as_known_image_size, share
from imgscale._typing import BoolArray, ImageArray, ImageSize, IntArray
from imgscale.detection import Detection
from imgscale.detectors._convert import (
    as_numbers,
    has_area_in,
    known_classes,
    make_detection,
    whole_number,
)
from imgscale.picture import upright_rgb

__all__ = ["UltralyticsDetector", "from_ultralytics"]


def from_ultralytics(result: Any) -> list[Detection]:
    """
    Turn one `Results` of an ultralytics model into detections.

    Parameters
    ----------
    result : ultralytics.engine.results.Results
        What the model said of one picture, ``model(image)[0]``, of a detecting, segmenting, pose or
        tracking model. Tensors may live on any device.

    Returns
    -------
    list of Detection
        One per box, in order, with its mask where there is one, in the picture's shape, and with
        its `track_id` where the model tracks. Where a mask is empty the box stands alone.

    Raises
    ------
    ValueError
        If the result has no upright boxes (oriented boxes, a class of the whole picture), a class
        without a name, a part of another shape, or an entry that is no detection.
    TypeError
        If it is a list of results, as the model returns, or something else.

    Notes
    -----
    Depth of an ultralytics depth model, ``result.depth``, is metric::

        DepthMap(result.depth.data.cpu().numpy(), kind="metric", scale_rel_std=0.15)

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> import numpy as np
    >>> from imgscale.detectors.ultralytics import from_ultralytics
    >>> boxes = SimpleNamespace(
    ...     xyxy=np.array([[10.5, 20.0, 110.5, 70.0]]),
    ...     conf=np.array([0.9]),
    ...     cls=np.array([2.0]),
    ...     id=None,
    ... )
    >>> result = SimpleNamespace(boxes=boxes, masks=None, names={2: "car"}, orig_shape=(480, 640))
    >>> from_ultralytics(result)[0].xyxy
    (10.5, 20.0, 110.5, 70.0)
    """
    boxes = _boxes(result)
    size = _size(result)
    corners = as_numbers("result.boxes.xyxy", boxes.xyxy, ("n", 4))
    count = len(corners)
    scores = as_numbers("result.boxes.conf", boxes.conf, (count,))
    classes = as_numbers("result.boxes.cls", boxes.cls, (count,))
    absent: list[Any] = [None] * count
    tracks = absent if boxes.id is None else as_numbers("result.boxes.id", boxes.id, (count,))
    segments: Any = getattr(result, "masks", None)
    masks = absent if segments is None else _masks(segments, count, size)
    rows = zip(corners, scores, classes, tracks, masks, strict=True)
    return [
        make_detection(
            f"result[{i}]",
            _name(result, number, f"result[{i}]"),
            box,
            score=score,
            mask=mask,
            track_id=None if track is None else whole_number(f"result[{i}]", "id", track),
            image_size=size,
        )
        for i, (box, score, number, track, mask) in enumerate(rows)
    ]


def _boxes(result: Any) -> Any:
    """Fetch the upright boxes or say what the result has instead."""
    if isinstance(result, (list, tuple)):
        msg = (
            "`result` must be of one picture; got a list, one per picture, as the model returns. "
            "Pass result[0]."
        )
        raise TypeError(msg)
    if not hasattr(result, "boxes") or not hasattr(result, "orig_shape"):
        msg = f"`result` must be an ultralytics Results; got {type(result).__name__}."
        raise TypeError(msg)
    if all(hasattr(result.boxes, name) for name in ("xyxy", "conf", "cls", "id")):
        return result.boxes
    if result.boxes is not None:
        msg = f"`result.boxes` must be ultralytics Boxes; got {type(result.boxes).__name__}."
        raise TypeError(msg)
    if getattr(result, "obb", None) is not None:
        msg = (
            "`result` must have upright boxes; got oriented ones (obb). The size of an object is "
            "measured along the picture's axes: use a detecting or segmenting model."
        )
        raise ValueError(msg)
    msg = "`result` must have boxes; got none. Use a detecting, segmenting or pose model."
    raise ValueError(msg)


def _size(result: Any) -> ImageSize:
    """Read the picture's size."""
    try:
        height, width = result.orig_shape
        return as_known_image_size((width, height))
    except (TypeError, ValueError) as error:
        msg = f"`result.orig_shape` must be (height, width) in pixels; got {result.orig_shape!r}."
        raise ValueError(msg) from error


def _name(result: Any, number: Any, place: str) -> str:
    """Name a class."""
    known = getattr(result, "names", None)
    names = cast("Mapping[int, str]", known if isinstance(known, Mapping) else {})
    whole = whole_number(place, "cls", number)
    if whole not in names:
        msg = f"{place}: `names` must have class {whole}; got names for {known_classes(names)}"
        raise ValueError(msg)
    return names[whole]


def _masks(segments: Any, count: int, size: ImageSize) -> Iterator[BoolArray]:
    """
    Bring masks from the network's input to the picture.

    The polygons beside them, `masks.xy`, lose holes and join or lose the parts of an object.
    """
    data = getattr(segments, "data", segments)
    masks: BoolArray = as_numbers("result.masks.data", data, (count, "H", "W")) > 0
    shape, padded = size[::-1], masks.shape[1:]
    gain = min(padded[0] / shape[0], padded[1] / shape[1])
    rows, columns = (_shown_at(*lengths, gain) for lengths in zip(shape, padded, strict=True))
    for mask in masks:
        yield mask[rows[:, np.newaxis], columns]


def _shown_at(length: int, padded: int, gain: float) -> IntArray:
    """Tell for each pixel of the picture which pixel of the padded input shows its middle."""
    resized = round(length * gain)
    bar = round((padded - resized) / 2 - 0.1)  # the first of two bars is the narrower one
    middles = (np.arange(length) + 0.5) * (resized / length) + bar
    return middles.astype(np.intp)


def _check_model(_: object, __: attrs.Attribute[Any], value: object) -> None:
    if not callable(value):
        msg = (
            f"`model` must be callable with a picture; got {type(value).__name__}. Load one with "
            "ultralytics.YOLO(weights)."
        )
        raise TypeError(msg)


@attrs.frozen(eq=False)
class UltralyticsDetector:
    """
    Run an ultralytics model; it satisfies `Detector`.

    The model gets the picture as BGR, the order that it takes arrays for. Boxes without an area
    inside the picture are left out.

    Attributes
    ----------
    model : ultralytics.YOLO
        The model, loaded; on the device where it is.
    threshold : float
        Boxes with a lower score are not reported, 0 to 1.

    Raises
    ------
    ValueError
        If the threshold is not between 0 and 1.
    TypeError
        If the model cannot be called.

    Examples
    --------
    >>> from imgscale.detectors.ultralytics import UltralyticsDetector
    >>> from ultralytics import YOLO  # doctest: +SKIP
    >>> detector = UltralyticsDetector(YOLO(weights), threshold=0.5)  # doctest: +SKIP
    """

    model: Any = attrs.field(repr=False, validator=_check_model)
    threshold: float = attrs.field(kw_only=True, converter=as_float, validator=share)

    def __call__(self, image: ImageArray, /) -> list[Detection]:
        """
        Detect objects.

        Parameters
        ----------
        image : (H, W, 3) ndarray of uint8
            The upright picture, RGB.

        Returns
        -------
        list of Detection
            What overlaps the picture, in the model's order.

        Raises
        ------
        ValueError, TypeError
            If it is no such picture, or the model says something else than `from_ultralytics`
            reads.
        """
        bgr = np.ascontiguousarray(upright_rgb(image)[..., ::-1])
        (result,) = self.model(bgr, conf=self.threshold, verbose=False)
        size = (bgr.shape[1], bgr.shape[0])
        corners = as_numbers("result.boxes.xyxy", _boxes(result).xyxy, ("n", 4))
        inside = [has_area_in(box, size) for box in corners.tolist()]
        return from_ultralytics(result[inside])
