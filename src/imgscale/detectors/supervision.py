"""
Detections of roboflow's supervision, read and written; measured sizes as its data columns.

Boxes are read as half-open pixels, as detectors give them. Boxes that were made of masks by
`supervision.mask_to_xyxy` end on their last pixel: give it ``coordinate_convention="exclusive"``.
"""

from __future__ import annotations

import copy
from collections.abc import Hashable, Mapping, Sequence
from contextlib import suppress
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from imgscale._checks import as_image_size, check_iterable, check_type
from imgscale._optional import require
from imgscale._typing import BoolArray, FloatArray
from imgscale.detection import Detection, check_detections
from imgscale.detectors._convert import known_classes, make_detection, whole_number
from imgscale.estimate import SizeEstimate

__all__ = ["from_supervision", "to_supervision", "with_sizes"]

_NAMES = "class_name"  # the library's own key in `data`
_UNTRACKED = -1  # what its trackers give to a detection that belongs to no track yet


def from_supervision(
    detections: Any,
    *,
    class_names: Mapping[int, str] | Sequence[str] | None = None,
    image_size: Sequence[int] | None = None,
) -> list[Detection]:
    """
    Turn a `supervision.Detections` into detections.

    Parameters
    ----------
    detections : supervision.Detections
        The detections of one picture. It is neither imported nor changed: anything with `xyxy`,
        `mask`, `confidence`, `class_id`, `tracker_id` and `data` will do.
    class_names : mapping of int to str or sequence of str, optional
        Name of each class id. Used where ``data["class_name"]`` is missing.
    image_size : (width, height), optional
        Size of the picture in pixels. Where given, boxes are cut at its border.

    Returns
    -------
    list of Detection
        One for each, in their order. Boxes and scores keep their exact values, float32 or not;
        without `confidence` the score is 1. A mask, be it a `CompactMask`, becomes an (H, W) array
        of bool; one that is empty in its box is left out, and depth is then read in the box.
        `track_id` is the tracker's id as int, None where that is negative: untracked.

    Raises
    ------
    TypeError
        If it is something else, a name is no string, or a mask not boolean.
    ValueError
        If a class has no name, a column not one entry for each box, or an entry is no detection;
        the message names its place, such as "detections[3]".

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> import numpy as np
    >>> from imgscale.detectors.supervision import from_supervision
    >>> found = SimpleNamespace(  # such as supervision.Detections.from_inference(...)
    ...     xyxy=np.array([[10.0, 20.0, 110.0, 70.0]]), mask=None, confidence=np.array([0.75]),
    ...     class_id=np.array([2]), tracker_id=None, data={})
    >>> (car,) = from_supervision(found, class_names={2: "car"})
    >>> car.label, car.xyxy, car.score
    ('car', (10.0, 20.0, 110.0, 70.0), 0.75)
    """
    _check_supervision(detections)
    size = as_image_size(image_size)
    labels = _labels(detections, class_names)
    return [
        make_detection(
            f"detections[{index}]",
            labels[index],
            box,
            image_size=size,
            score=1.0 if detections.confidence is None else detections.confidence[index],
            mask=None if detections.mask is None else detections.mask[index],
            track_id=None if detections.tracker_id is None else _track_id(detections, index),
        )
        for index, box in enumerate(detections.xyxy)
    ]


def to_supervision(detections: Sequence[Detection]) -> Any:
    """
    Turn detections into a `supervision.Detections`.

    Parameters
    ----------
    detections : sequence of Detection
        The detections of one picture.

    Returns
    -------
    supervision.Detections
        `xyxy` and `confidence` as float64, `class_id` numbering the labels as they first appear,
        ``data["class_name"]`` the labels, `mask` an (N, H, W) array of bool where they have masks,
        `tracker_id` where track ids are whole numbers, -1 for detections without one. Track ids
        that are strings, aliases and `partial` have no place there and are left out.

    Raises
    ------
    MissingDependencyError
        If supervision is not installed.
    TypeError
        If an item is no detection.
    ValueError
        If some have a mask and others none, or masks differ in shape.

    Examples
    --------
    >>> from imgscale import Detection
    >>> from imgscale.detectors.supervision import to_supervision
    >>> to_supervision([Detection("car", (10, 20, 110, 70))]).xyxy  # doctest: +SKIP
    array([[ 10.,  20., 110.,  70.]])
    """
    known = check_detections(detections)
    supervision = require(
        "supervision", extra="supervision", purpose="Making Detections of supervision"
    )
    labels = [detection.label for detection in known]
    ids = {label: number for number, label in enumerate(dict.fromkeys(labels))}
    return supervision.Detections(
        xyxy=np.array([detection.xyxy for detection in known], dtype=np.float64).reshape(-1, 4),
        mask=_masks(known),
        confidence=np.array([detection.score for detection in known], dtype=np.float64),
        class_id=np.array([ids[label] for label in labels], dtype=np.intp),
        tracker_id=_tracker_ids(known),
        data={_NAMES: np.array(labels, dtype=np.str_)},
    )


def with_sizes(detections: Any, estimates: Sequence[SizeEstimate], *, level: float = 0.9) -> Any:
    """
    Write measured sizes beside the detections that they belong to.

    Parameters
    ----------
    detections : supervision.Detections
        The detections of one picture. They are not changed.
    estimates : sequence of SizeEstimate
        Their sizes, one for each in their order, as `predict` gives them.
    level : float
        Probability that an interval holds the size, above 0 and below 1.

    Returns
    -------
    supervision.Detections
        A shallow copy with further columns in `data`, float64 in metres: "height_m" and the ends
        of its interval, "height_low_m" and "height_high_m"; likewise "width" and "diameter" where
        an estimate is along them. NaN where there is no size, or not along that axis. Without any
        detection the three columns of the height are there, empty.

    Raises
    ------
    TypeError
        If it is something else, or an item is no estimate.
    ValueError
        If they differ in number, or the level is no probability.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> import numpy as np
    >>> from imgscale import Flag, SizeEstimate
    >>> from imgscale.detectors.supervision import with_sizes
    >>> found = SimpleNamespace(  # such as supervision.Detections.from_inference(...)
    ...     xyxy=np.array([[10.0, 20.0, 110.0, 70.0]]), mask=None, confidence=None,
    ...     class_id=np.array([2]), tracker_id=None, data={})
    >>> car = SizeEstimate(label="car", axis="height", size_m=1.5, std_m=0.06,
    ...                    metres_per_pixel=0.03, depth=7.0, distance_m=None, flags=Flag(0))
    >>> sized = with_sizes(found, [car])
    >>> {name: float(column[0].round(2)) for name, column in sized.data.items()}
    {'height_m': 1.5, 'height_low_m': 1.4, 'height_high_m': 1.6}
    """
    _check_supervision(detections)
    check_iterable("estimates", estimates, "SizeEstimate")
    known = [check_type("estimates", estimate, SizeEstimate) for estimate in estimates]
    if len(known) != len(detections.xyxy):
        msg = (
            f"`estimates` must be one for each of the {len(detections.xyxy)} detections; got "
            f"{len(known)}. Predict for all that from_supervision() gave, in their order."
        )
        raise ValueError(msg)
    sized = copy.copy(detections)
    sized.data = {**detections.data, **_size_columns(known, level)}
    return sized


def _check_supervision(value: Any) -> None:
    fields = ("xyxy", "mask", "confidence", "class_id", "tracker_id", "data")
    if not all(hasattr(value, field) for field in fields):
        msg = (
            f"`detections` must be one supervision.Detections; got {type(value).__name__}. Results "
            "of other libraries have converters of their own."
        )
        raise TypeError(msg)
    data: object = value.data
    if not isinstance(data, Mapping):
        msg = f"`detections` must hold a dict as `data`; got {type(data).__name__}."
        raise TypeError(msg)
    columns = {field: getattr(value, field) for field in fields[1:-1]}
    columns[_NAMES] = cast("Mapping[str, Any]", data).get(_NAMES)
    count = _length("xyxy", value.xyxy)
    for name, column in columns.items():  # plain attributes, which anybody may have set
        length = count if column is None else _length(name, column)
        if length != count:
            msg = f"`detections` must hold one `{name}` for each of {count} boxes; got {length}."
            raise ValueError(msg)


def _length(name: str, column: Any) -> int:
    """Count the entries of a column; text and dicts have a length too, but are none."""
    got = type(column).__name__
    with suppress(TypeError):  # a number, or an array without rows
        if not isinstance(column, (str, bytes, Mapping)):
            return len(column)
    msg = f"`detections` must hold an array as `{name}`; got {got}."
    raise TypeError(msg)


def _labels(detections: Any, class_names: Mapping[int, str] | Sequence[str] | None) -> list[Any]:
    """Find the name of each detection, in its data or by its class id."""
    names = detections.data.get(_NAMES)
    if names is not None:
        return [str(name) if isinstance(name, str) else name for name in names]
    if len(detections.xyxy) == 0:
        return []
    if class_names is None or detections.class_id is None:
        got = "neither" if detections.class_id is None else "class ids alone"
        msg = (
            '`detections` must carry names in data["class_name"], or class ids together with '
            f"`class_names`; got {got}. Pass the model's names: class_names=..."
        )
        raise ValueError(msg)
    known = _as_mapping(class_names)
    return [
        _name_of(known, class_id, f"detections[{index}]")
        for index, class_id in enumerate(detections.class_id)
    ]


def _as_mapping(class_names: Mapping[int, str] | Sequence[str]) -> Mapping[Any, str]:
    """Turn a sequence into a mapping, in which -1 is not the last name."""
    if isinstance(class_names, Mapping):
        return cast("Mapping[Any, str]", class_names)
    if isinstance(class_names, str):
        msg = f"`class_names` must map ids to names, or list them; got the string {class_names!r}."
        raise TypeError(msg)
    check_iterable("class_names", class_names, "str")
    return dict(enumerate(class_names))


def _name_of(names: Mapping[Any, str], class_id: Any, place: str) -> str:
    if not isinstance(class_id, Hashable) or class_id not in names:
        msg = (
            f"`class_names` must name class {class_id} of {place}; got names for "
            f"{known_classes(names)}"
        )
        raise ValueError(msg)
    return names[class_id]


def _track_id(detections: Any, index: int) -> int | None:
    """Read a tracker's id as int; a negative one stands for no track."""
    number = detections.tracker_id[index]
    if number is None:
        return None
    track = whole_number(f"detections[{index}]", "tracker_id", number)
    return None if track < 0 else track


def _masks(detections: Sequence[Detection]) -> BoolArray | None:
    """Stack masks, which all or none must have."""
    masks = [detection.mask for detection in detections]
    given = [mask for mask in masks if mask is not None]
    if not given:
        return None
    if len(given) < len(masks):
        index = next(number for number, mask in enumerate(masks) if mask is None)
        msg = (
            f"`detections` must all have masks or none; got none at index {index}. Drop the "
            "others' with attrs.evolve(detection, mask=None)."
        )
        raise ValueError(msg)
    shapes = list(dict.fromkeys(mask.shape for mask in given))
    if len(shapes) > 1:
        msg = f"`detections` must have masks of one shape; got {shapes[0]} and {shapes[1]}."
        raise ValueError(msg)
    return np.stack(given)


def _tracker_ids(detections: Sequence[Detection]) -> NDArray[np.intp] | None:
    ids = [detection.track_id for detection in detections]
    if any(isinstance(name, str) for name in ids) or all(number is None for number in ids):
        return None
    return np.array([_UNTRACKED if number is None else number for number in ids], dtype=np.intp)


def _size_columns(estimates: Sequence[SizeEstimate], level: float) -> dict[str, FloatArray]:
    """Make three columns for each axis that is measured."""
    columns: dict[str, FloatArray] = {}
    for axis in dict.fromkeys(estimate.axis for estimate in estimates) or ("height",):
        rows = np.full((3, len(estimates)), np.nan)
        for index, estimate in enumerate(estimates):
            if estimate.axis == axis:
                rows[:, index] = estimate.size_m, *estimate.interval(level)
        columns.update(zip((f"{axis}_m", f"{axis}_low_m", f"{axis}_high_m"), rows, strict=True))
    return columns
