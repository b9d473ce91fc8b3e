"""
Object detectors of Hugging Face transformers.

Their boxes are half-open pixels of the upright picture, x1, y1, x2, y2. The pipeline cuts them to
whole numbers; the post-processing below it keeps the fractions. Tried with transformers 5.23.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import attrs

from imgscale._checks import as_float, as_image_size, share
from imgscale._optional import require
from imgscale._typing import ImageArray, ImageSize
from imgscale.detection import Detection
from imgscale.detectors._convert import column, has_area_in, known_classes, make_detection
from imgscale.picture import upright_rgb

__all__ = ["TransformersDetector", "from_transformers"]

_CORNERS = ("xmin", "ymin", "xmax", "ymax")
_REMEDY = "Pass model outputs through the image processor's post_process_object_detection() first."


def from_transformers(
    results: Sequence[Mapping[str, Any]] | Mapping[str, Any],
    *,
    id2label: Mapping[int, str] | None = None,
    image_size: Sequence[int] | None = None,
) -> list[Detection]:
    """
    Turn what a detector said of one picture into detections.

    Parameters
    ----------
    results : list of dict, or dict
        Either the list of an "object-detection" or "zero-shot-object-detection" pipeline, each
        item with "score", "label" and "box". Or one picture's dict of the post-processing, with
        "boxes" (n, 4) in pixels, "scores" (n,) and "labels" (n,), or "text_labels" of a zero-shot
        detector. Tensors may have any floating type, live on any device and require gradients.
    id2label : mapping from int to str, optional
        Names of the labels, as `model.config.id2label` has them; needed by the dict unless it
        carries "text_labels".
    image_size : (width, height), optional
        Size of the upright picture in pixels. Where given, boxes are cut at its border, beyond
        which these detectors draw.

    Returns
    -------
    list of Detection
        One per entry, in order.

    Raises
    ------
    ValueError
        If the results are those of several pictures, an entry lacks a part, or a box lies wholly
        outside the picture.
    TypeError
        If `results` is neither a list nor a dict.

    Notes
    -----
    The pipeline truncates each edge to a whole pixel, which moves it by up to 1 px, evenly spread:
    0.41 px of standard error in a height, as much as 1.4 % of an object that is 30 px high. Prefer
    `TransformersDetector`, which keeps the fractions; else ``Noise(box_px=...)`` should hold the
    detector's own error and 0.41 px, added in quadrature.

    Examples
    --------
    >>> from imgscale.detectors.transformers import from_transformers
    >>> box = {"xmin": 159, "ymin": 120, "xmax": 479, "ymax": 359}
    >>> (car,) = from_transformers([{"score": 0.93, "label": "car", "box": box}])
    >>> car.label, car.xyxy
    ('car', (159.0, 120.0, 479.0, 359.0))
    """
    size = as_image_size(image_size)
    if isinstance(results, Mapping):
        return _from_columns(results, id2label, size)
    if not isinstance(results, (list, tuple)):
        msg = (
            "`results` must be a pipeline's list or a post-processed dict; got "
            f"{type(results).__name__}. {_REMEDY}"
        )
        raise TypeError(msg)
    entries = cast("Sequence[Any]", results)
    return [_from_entry(f"results[{i}]", entry, size) for i, entry in enumerate(entries)]


def _from_entry(place: str, entry: Any, size: ImageSize | None) -> Detection:
    """Read one item of a pipeline's list."""
    if _is_whole_picture(entry):
        msg = f"`results` must be of one picture; got a list of several. Pass {place} alone."
        raise ValueError(msg)
    try:
        box = [entry["box"][corner] for corner in _CORNERS]
        label, score = entry["label"], entry["score"]
    except (KeyError, TypeError, IndexError) as error:
        msg = (
            f'{place} must have "score", "label" and "box" with "xmin", "ymin", "xmax" and "ymax"; '
            f"got {entry!r}."
        )
        raise ValueError(msg) from error
    return make_detection(place, label, box, score=score, image_size=size)


def _is_whole_picture(entry: object) -> bool:
    """Tell the results of one picture among several from one object's."""
    return isinstance(entry, list) or (isinstance(entry, Mapping) and "boxes" in entry)


def _from_columns(
    results: Mapping[str, Any], id2label: Mapping[int, str] | None, size: ImageSize | None
) -> list[Detection]:
    """Read the dict of boxes, scores and labels that post-processing gives for a picture."""
    boxes, scores = _column(results, "boxes"), _column(results, "scores")
    names = _names(results, id2label)
    if not len(boxes) == len(scores) == len(names):
        msg = (
            "`results` must have one score and one label per box; got "
            f"{len(boxes)} boxes, {len(scores)} scores and {len(names)} labels."
        )
        raise ValueError(msg)
    return [
        make_detection(f"results[{i}]", name, box, score=score, image_size=size)
        for i, (name, box, score) in enumerate(zip(names, boxes, scores, strict=True))
    ]


def _column(results: Mapping[str, Any], key: str) -> Any:
    return column(results, "results", key, '"boxes", "scores" and "labels"', _REMEDY)


def _names(results: Mapping[str, Any], id2label: Mapping[int, str] | None) -> Any:
    """Name each label."""
    if results.get("text_labels") is not None:
        return _column(results, "text_labels")
    labels = _column(results, "labels")
    known = id2label if isinstance(id2label, Mapping) else None
    if known is None:
        msg = (
            f"`id2label` must map numbers to names where labels are numbers; got {id2label!r}. "
            "Pass id2label=model.config.id2label."
        )
        raise ValueError(msg)
    for index, label in enumerate(labels):
        if not isinstance(label, int) or label not in known:
            msg = (
                f"results[{index}]: `id2label` must name label {label!r}, as that of the model "
                f"that detected does; got names for {known_classes(known)}"
            )
            raise ValueError(msg)
    return [known[label] for label in labels]


def _check_processor(_: object, __: attrs.Attribute[Any], value: object) -> None:
    if not hasattr(value, "post_process_object_detection"):
        msg = (
            "`image_processor` must have post_process_object_detection(); got "
            f"{type(value).__name__}. Take AutoImageProcessor's for the same checkpoint, and "
            "from_transformers() for zero-shot detectors."
        )
        raise TypeError(msg)


@attrs.frozen(eq=False)
class TransformersDetector:
    """
    Run an object detector of transformers; it satisfies `Detector`.

    The model stays on its device and in its number type; pictures follow it. Boxes keep their
    fractions and are cut at the picture's border; those without an area inside the picture are left
    out.

    Attributes
    ----------
    model : AutoModelForObjectDetection
        The model, loaded, in evaluation mode.
    image_processor : AutoImageProcessor
        The image processor of the same checkpoint.
    threshold : float
        Boxes with a lower score are not reported, 0 to 1.

    Raises
    ------
    ValueError
        If the threshold is not between 0 and 1.
    TypeError
        If the model has no configuration, or the image processor cannot post-process object
        detection.

    Examples
    --------
    With the `pipe` of ``transformers.pipeline("object-detection", model=...)``:

    >>> detector = TransformersDetector(
    ...     pipe.model, pipe.image_processor, threshold=0.5
    ... )  # doctest: +SKIP
    """

    model: Any = attrs.field(repr=False)
    image_processor: Any = attrs.field(repr=False, validator=_check_processor)
    threshold: float = attrs.field(kw_only=True, converter=as_float, validator=share)

    def __attrs_post_init__(self) -> None:
        if not hasattr(self.model, "config"):
            msg = (
                f"`model` must have a configuration, `config`; got {type(self.model).__name__}. "
                "Load one with AutoModelForObjectDetection, or pass a pipeline's `pipe.model`."
            )
            raise TypeError(msg)

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
            If it is no such picture.
        MissingDependencyError
            If PyTorch is not installed.
        """
        torch = require("torch", extra="transformers", purpose="TransformersDetector")
        picture = upright_rgb(image)
        size = (picture.shape[1], picture.shape[0])
        inputs = self.image_processor(
            images=picture, return_tensors="pt", input_data_format="channels_last"
        ).to(self.model.device, self.model.dtype)
        with torch.inference_mode():
            outputs = self.model(**inputs)
        (found,) = self.image_processor.post_process_object_detection(
            outputs, threshold=self.threshold, target_sizes=[size[::-1]]
        )
        inside = [has_area_in(box, size) for box in found["boxes"].tolist()]
        seen = {key: found[key][inside] for key in ("boxes", "scores", "labels")}
        return _from_columns(seen, self.model.config.id2label, size)
