"""
Output of torchvision's detection models, read by duck typing: the package is never imported.

Conventions there: boxes are float pixels of the tensor that went in, x1, y1, x2, y2; label 0 is the
background, so the first object has number 1; masks are probabilities in the picture's shape.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

from imgscale._checks import (
    as_image_size,
    as_optional_float,
    check_iterable,
    is_between,
    number_error,
)
from imgscale._typing import BoolArray
from imgscale.detection import Detection
from imgscale.detectors._convert import as_numbers, column, make_detection

__all__ = ["from_torchvision"]


def from_torchvision(
    output: Mapping[str, Any],
    *,
    categories: Sequence[str],
    mask_threshold: float | None = None,
    image_size: Sequence[int] | None = None,
) -> list[Detection]:
    """
    Turn one picture's output of a torchvision detection model into detections.

    Parameters
    ----------
    output : dict
        "boxes" (n, 4) in pixels, "labels" (n,) numbers, "scores" (n,) and, of Mask R-CNN, "masks"
        (n, 1, H, W) from 0 to 1. Tensors may have any floating type, live on any device and require
        gradients.
    categories : sequence of str
        The name of each label number, the background's first, as ``weights.meta["categories"]``
        has them. COCO's holes, "N/A", are kept as they come: no prior knows them.
    mask_threshold : float, optional
        A pixel belongs to the object where its mask is at least this, above 0 and at most 1;
        torchvision suggests 0.5. Needed where the output has masks.
    image_size : (width, height), optional
        Size in pixels of the picture that went into the model. Where given, boxes are cut at its
        border.

    Returns
    -------
    list of Detection
        One per box, in order, with its mask where there is one. Where no pixel of a mask reaches
        the threshold the box stands alone.

    Raises
    ------
    ValueError
        If a part is missing or of another shape, a label has no name, or the categories do not
        begin with the background.
    TypeError
        If the output is a list, one per picture, as the model returns, or something else, or if
        masks come without a threshold.

    Examples
    --------
    >>> import numpy as np
    >>> from imgscale.detectors.torchvision import from_torchvision
    >>> output = {
    ...     "boxes": np.array([[10.5, 20.0, 110.5, 70.0]]),
    ...     "labels": np.array([1]),
    ...     "scores": np.array([0.9]),
    ... }
    >>> from_torchvision(output, categories=["__background__", "person"])[0].label
    'person'
    """
    boxes, labels, scores = (_column(output, key) for key in ("boxes", "labels", "scores"))
    if not len(boxes) == len(labels) == len(scores):
        msg = (
            "`output` must have one label and one score per box; got "
            f"{len(boxes)} boxes, {len(labels)} labels and {len(scores)} scores."
        )
        raise ValueError(msg)
    size = as_image_size(image_size)
    names = _names(labels, categories)
    masks = _masks(output, mask_threshold, len(boxes))
    return [
        make_detection(
            f"output[{i}]",
            names[i],
            boxes[i],
            score=scores[i],
            mask=None if masks is None else masks[i],
            image_size=size,
        )
        for i in range(len(boxes))
    ]


def _column(output: Any, key: str) -> Any:
    """Fetch a tensor, array or list as a list; `tolist` knows every type, device and gradient."""
    if not isinstance(output, Mapping):
        remedy = " Pass output[0]." if isinstance(output, list) else ""
        kind = type(cast("object", output)).__name__
        msg = f"`output` must be one picture's dict; got {kind}.{remedy}"
        raise TypeError(msg)
    return column(
        cast("Mapping[str, Any]", output),
        "output",
        key,
        '"boxes", "labels" and "scores"',
        "A model in training mode returns losses: call model.eval().",
    )


def _names(labels: Sequence[Any], categories: Sequence[str]) -> list[str]:
    """Name each label number, sure that 0 is the background's."""
    check_iterable("categories", categories, "str")
    known = list(categories)
    if not known or str(known[0]).strip("_").casefold() != "background":
        msg = (
            "`categories` must begin with the background, whose label is 0; got "
            f'{known[:2]}. Put "__background__" before the first object.'
        )
        raise ValueError(msg)
    for index, label in enumerate(labels):
        if not isinstance(label, int) or not 0 <= label < len(known):
            msg = (
                f"output[{index}]: `categories` must name label {label!r}; got "
                f"{len(known)} of them. Take the list of the model's own weights."
            )
            raise ValueError(msg)
    return [known[label] for label in labels]


def _masks(output: Mapping[str, Any], threshold: float | None, count: int) -> BoolArray | None:
    """Cut probabilities into masks, (n, H, W)."""
    if output.get("masks") is None:
        return None
    level = as_optional_float(threshold)
    if not (level and is_between(level, 0, 1)):
        law = "above 0 and at most 1 where the output has masks"
        raise number_error("mask_threshold", law, level, "torchvision suggests 0.5.")  # noqa: EM101 - a name
    shares = as_numbers('output["masks"]', output["masks"], (count, 1, "H", "W"))
    return shares[:, 0] >= level
