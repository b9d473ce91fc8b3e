"""
Amazon Rekognition: a DetectLabels response as detections, and a runner around a boto3 client.

Three habits of Rekognition decide which names a detection gets (seen in responses of its label
models 2.0 and 3.0):

- One object comes as several labels with the very same box: "Adult", "Female", "Person" and
  "Woman". They are merged into one detection. Its label is the most specific name, which is the
  one with the most ancestors; the others are aliases.
- Parents are in no dependable order, and many are no kinds of the thing: "Face" and "Skateboard"
  have the parent "Person", "Car Wheel" has "Car", "Wheel" has "Machine". A parent therefore serves
  as alias only where it is the last word or words of the name ("Sports Car" is a "Car", "Car Wheel"
  a "Wheel"), and for kinds of car and person that do not say so, such as "Coupe". What remains
  without a prior is measured as an unknown object, and is no reference.
- The young carry their elders' names: "Girl" comes with "Teen", "Boy" with "Person". Where a box
  has a name of young age, only names of that age are kept, so that a baby is never given the size
  of an adult, nor a teenager that of a child.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO
from typing import Any, NamedTuple, cast

import attrs

from imgscale._checks import as_float, as_known_image_size, is_between, number_error
from imgscale._reading import cut, quoted
from imgscale._typing import Box, ImageArray, ImageSize
from imgscale.detection import Detection
from imgscale.detectors._convert import has_area_in, make_detection
from imgscale.picture import upright_rgb

__all__ = ["RekognitionDetector", "from_rekognition"]

_SIDES = ("Left", "Top", "Width", "Height")
# Names of one age each, the most telling first: a "Girl" that is a "Teen" too is a teenager.
_AGES = (
    frozenset({"newborn", "infant", "baby"}),
    frozenset({"toddler"}),
    frozenset({"teen", "teenager"}),
    frozenset({"child", "kid", "boy", "girl"}),
    frozenset({"puppy", "kitten"}),
)
# Kinds whose names do not end with what they are.
_KINDS = {
    "car": {
        "cab",
        "convertible",
        "coupe",
        "hatchback",
        "roadster",
        "sedan",
        "station wagon",
        "taxi",
    },
    "person": {"adult", "female", "male", "man", "woman"},
}
_FARTHEST = 2.0  # ratios beyond it are pixels
_MOST_BYTES = 5_242_880  # of Image.Bytes
_QUALITIES = (95, 85, 75)


_Options = tuple[tuple[str, Any], ...]


class _Instance(NamedTuple):
    """One box under one name."""

    place: str
    name: str
    aliases: tuple[str, ...]
    parents: tuple[str, ...]
    xyxy: Box
    score: float


def from_rekognition(response: Any, *, image_size: Sequence[int]) -> list[Detection]:
    """
    Turn the response of Amazon Rekognition's DetectLabels into detections.

    Labels without instances (scenes, concepts) have no box and are skipped. Instances with the
    very same box are one object and become one detection.

    Parameters
    ----------
    response : dict
        What `detect_labels` of boto3 returns, or the JSON that the AWS command line prints, read
        with `json.loads`. Only "Labels" is read, and of each label Name, Instances, Confidence,
        Aliases and Parents; all but Name and BoundingBox may be missing.
    image_size : (width, height)
        Size of the picture in pixels, its EXIF orientation applied: Rekognition does so too.

    Returns
    -------
    list of Detection
        One for each distinct box, in the order of the response, in pixels and cut at the picture's
        border. `label` and `aliases` are names as Rekognition spells them, chosen as described at
        the top of this module; `score` is the instance's Confidence / 100, the label's where that
        is missing, 1 where both are.

    Raises
    ------
    ValueError, TypeError
        If the response is of another operation, or an entry breaks a law; the message names the
        place, such as "Labels[3].Instances[0]".

    Notes
    -----
    x1 = Left width, y1 = Top height, x2 = x1 + Width width, y2 = y1 + Height height, with the
    picture's width and height in pixels.

    Examples
    --------
    >>> from imgscale.detectors.rekognition import from_rekognition
    >>> box = {"Left": 0.5, "Top": 0.25, "Width": 0.125, "Height": 0.5}
    >>> instances = [{"BoundingBox": box, "Confidence": 98.0}]
    >>> person = {"Name": "Person", "Instances": instances, "Aliases": [{"Name": "Human"}]}
    >>> man = {"Name": "Man", "Instances": instances, "Parents": [{"Name": "Person"}]}
    >>> response = {"Labels": [person, man, {"Name": "Urban", "Instances": []}]}
    >>> (found,) = from_rekognition(response, image_size=(1280, 720))
    >>> found.label, found.aliases, found.xyxy, found.score
    ('Man', ('Person', 'Human'), (640.0, 180.0, 800.0, 540.0), 0.98)
    """
    size = as_known_image_size(image_size)
    return [_detection(group, size) for group in _objects(response, size)]


def _as_options(value: Mapping[str, Any] | _Options) -> _Options:
    pairs = cast("tuple[object, ...]", value) if isinstance(value, tuple) else (None,)
    if all(isinstance(pair, tuple) for pair in pairs):
        value = dict(cast("_Options", value))  # of a detector that attrs.evolve() starts from
    return copy.deepcopy(tuple(_mapping("`options`", value).items()))


def _check_options(_: object, __: object, value: _Options) -> None:
    if "Image" in dict(value):
        msg = "`options` must leave Image to the detector, which sends the picture; got one."
        raise ValueError(msg)


def _check_client(_: object, __: object, value: object) -> None:
    if not callable(getattr(value, "detect_labels", None)):
        msg = (
            f"`client` must have a method detect_labels; got {type(value).__name__}. Make one with "
            'boto3.client("rekognition").'
        )
        raise TypeError(msg)


@attrs.frozen(eq=False)
class RekognitionDetector:
    """
    Detects objects with Amazon Rekognition, through a client that you built.

    Called with a picture, (H, W, 3) uint8 RGB, its orientation applied, it returns a list of
    `Detection`. The picture is sent as JPEG: at quality 95, else 85 or 75, and where that exceeds
    the 5 242 880 bytes that Rekognition takes, at half the size until it does not; boxes come back
    as ratios, so they fit the picture all the same. Boxes without an area inside the picture are
    left out. Errors of the client, such as missing rights, come through as they are.

    Attributes
    ----------
    client : object
        A boto3 client for "rekognition", or anything with its method `detect_labels`.
    options : tuple of (str, object)
        Further arguments of `detect_labels`, passed on unchanged: MinConfidence, MaxLabels,
        Features, Settings. Given as a mapping, which is copied; none is set here.

    Raises
    ------
    TypeError
        If the client has no `detect_labels`.
    ValueError
        If the options hold Image.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> import numpy as np
    >>> from imgscale.detectors.rekognition import RekognitionDetector
    >>> box = {"Left": 0.5, "Top": 0.25, "Width": 0.125, "Height": 0.5}
    >>> answer = {"Labels": [{"Name": "Car", "Instances": [{"BoundingBox": box}]}]}
    >>> client = SimpleNamespace(detect_labels=lambda **request: answer)  # boto3.client(...)
    >>> detector = RekognitionDetector(client, options={"MinConfidence": 80})
    >>> detector(np.zeros((360, 640, 3), dtype=np.uint8))[0].xyxy
    (320.0, 90.0, 400.0, 270.0)
    """

    client: Any = attrs.field(repr=False, validator=_check_client)
    options: _Options = attrs.field(
        default=(), kw_only=True, converter=_as_options, validator=_check_options
    )

    def __call__(self, image: ImageArray, /) -> list[Detection]:
        """Detect objects."""
        pixels = upright_rgb(image)
        size = (pixels.shape[1], pixels.shape[0])
        picture = {"Bytes": _as_jpeg(pixels)}
        response = self.client.detect_labels(Image=picture, **dict(self.options))
        groups = _objects(response, size)
        return [_detection(group, size) for group in groups if has_area_in(group[0].xyxy, size)]


def _as_jpeg(image: ImageArray) -> bytes:
    """Encode a picture within Rekognition's limit of bytes, as well as that allows."""
    from PIL import Image  # noqa: PLC0415 - 20 ms that reading a response does not need

    picture = Image.fromarray(image)
    while True:
        for quality in _QUALITIES:
            file = BytesIO()
            picture.save(file, "JPEG", quality=quality)
            if file.tell() <= _MOST_BYTES:
                return file.getvalue()
        half = (max(1, picture.width // 2), max(1, picture.height // 2))
        picture = picture.resize(half, Image.Resampling.BOX)


def _objects(response: Any, size: ImageSize) -> list[list[_Instance]]:
    """Group the instances that have the very same box: they are one object."""
    groups: dict[Box, list[_Instance]] = {}
    for instance in _instances(response, size):
        groups.setdefault(instance.xyxy, []).append(instance)
    return list(groups.values())


def _detection(group: list[_Instance], size: ImageSize) -> Detection:
    """Make one detection of one object's instances; see the top of the module for its names."""
    kept = sorted(_of_one_age(group), key=lambda instance: -len(instance.parents))
    known = [name for instance in kept for name in (instance.name, *instance.aliases)]
    broader = [name for instance in kept for name in _kinds(instance)]
    label, *aliases = dict.fromkeys([*known, *broader])
    first = kept[0]
    x1, y1, x2, y2 = first.xyxy
    if x1 == x2 or y1 == y2:
        msg = (
            f"{first.place}.BoundingBox must have a positive Width and Height; got {first.xyxy} in "
            "pixels. Leave such entries out."
        )
        raise ValueError(msg)
    return make_detection(
        first.place, label, first.xyxy, image_size=size, score=first.score, aliases=aliases
    )


def _of_one_age(group: list[_Instance]) -> list[_Instance]:
    """Keep the names of young age, where there are any."""
    for ages in _AGES:
        young = [instance for instance in group if instance.name.casefold() in ages]
        if young:
            return young
    return group


def _kinds(instance: _Instance) -> list[str]:
    """Find the parents that the name ends with, the longest first: a "Sports Car" is a "Car"."""
    name = instance.name.casefold()
    kinds = [
        parent
        for parent in instance.parents
        if name.endswith(f" {parent.casefold()}") or name in _KINDS.get(parent.casefold(), ())
    ]
    return sorted(kinds, key=len, reverse=True)


def _instances(response: Any, size: ImageSize) -> Iterator[_Instance]:
    """Read every box of every label."""
    for index, entry in enumerate(_labels(response)):
        place = f"Labels[{index}]"
        label = _mapping(place, entry)
        if "Label" in label:
            msg = (
                f"{place} must be a label of DetectLabels; got one of GetLabelDetection, which "
                "reads videos. Pass one moment of it: {'Labels': [entry['Label'] for entry in "
                "response['Labels'] if entry['Timestamp'] == moment]}."
            )
            raise ValueError(msg)
        for number, instance in enumerate(_entries(place, label, "Instances")):
            yield _instance(f"{place}.Instances[{number}]", place, label, instance, size)


def _instance(
    place: str, label_place: str, label: Mapping[str, Any], entry: Any, size: ImageSize
) -> _Instance:
    """Read one box and the names of its label."""
    instance = _mapping(place, entry)
    name = label.get("Name")
    if not isinstance(name, str) or not name.strip():
        msg = f"{label_place}.Name must be a string that is not blank; got {quoted(name)}."
        raise TypeError(msg)
    confidence = instance.get("Confidence")
    if confidence is None:
        confidence = label.get("Confidence")
    return _Instance(
        place,
        name,
        _names(label_place, label, "Aliases"),
        _names(label_place, label, "Parents"),
        _box(place, instance.get("BoundingBox"), size),
        1.0 if confidence is None else _percent(place, confidence) / 100,
    )


def _labels(response: Any) -> Sequence[Any]:
    """Find the labels of a response."""
    if not isinstance(response, Mapping):
        hint = " Read it with json.loads() first." if isinstance(response, (str, bytes)) else ""
        msg = (
            "`response` must be the dict that DetectLabels returns; got "
            f"{type(response).__name__}.{hint}"
        )
        raise TypeError(msg)
    found = cast("Mapping[str, Any]", response)
    if "Labels" not in found:
        keys = cut(", ".join(map(str, found))) or "none"
        msg = (
            f"`response` must hold Labels, as DetectLabels returns them; got the keys {keys}. "
            "Other operations are not read; Features, where given, must include GENERAL_LABELS."
        )
        raise ValueError(msg)
    if found["Labels"] is None:
        msg = "response.Labels must be a list; got None."
        raise TypeError(msg)
    return _entries("response", found, "Labels")


def _mapping(place: str, value: Any) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        msg = f"{place} must be a dict; got {type(value).__name__}."
        raise TypeError(msg)
    return cast("Mapping[str, Any]", value)


def _entries(place: str, record: Mapping[str, Any], key: str) -> Sequence[Any]:
    """Read a list that may be missing."""
    value = record.get(key)
    if value is None:
        return ()
    if not isinstance(value, (list, tuple)):
        msg = f"{place}.{key} must be a list; got {type(value).__name__}."
        raise TypeError(msg)
    return cast("Sequence[Any]", value)


def _names(place: str, label: Mapping[str, Any], key: str) -> tuple[str, ...]:
    """Read names, given as {"Name": name} or bare."""
    names: list[str] = []
    for index, entry in enumerate(_entries(place, label, key)):
        name: Any = entry
        if isinstance(entry, Mapping):
            name = cast("Mapping[str, Any]", entry).get("Name")
        if not isinstance(name, str) or not name.strip():
            msg = f'{place}.{key}[{index}] must be a name or {{"Name": name}}; got {quoted(entry)}.'
            raise TypeError(msg)
        names.append(name)
    return tuple(names)


def _box(place: str, value: Any, size: ImageSize) -> Box:
    """Read a box of ratios in pixels of the picture."""
    place = f"{place}.BoundingBox"
    box = _mapping(place, value)
    missing = [side for side in _SIDES if side not in box]
    if missing:
        msg = f"{place} must hold Left, Top, Width and Height; it lacks {', '.join(missing)}."
        raise ValueError(msg)
    left, top, width, height = (_ratio(place, side, box[side]) for side in _SIDES)
    return (
        left * size[0],
        top * size[1],
        (left + width) * size[0],
        (top + height) * size[1],
    )


def _ratio(place: str, side: str, value: Any) -> float:
    """Read a share of the picture's size; objects may go on beyond the picture."""
    ratio = as_float(value)
    lowest = -_FARTHEST if side in {"Left", "Top"} else 0.0
    if not is_between(ratio, lowest, _FARTHEST):
        name = f"{place}.{side}"
        remedy = "Boxes in pixels go through Detection.from_xywh()."
        raise number_error(name, "a ratio of the picture's size", ratio, remedy)
    return ratio


def _percent(place: str, value: Any) -> float:
    number = as_float(value)
    if not is_between(number, 0, 100):
        name = f"{place}.Confidence"
        raise number_error(name, "between 0 and 100", number)
    return number
