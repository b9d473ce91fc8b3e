"""What every converter of detections obeys, whatever its backend."""

import copy
import inspect
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType, SimpleNamespace
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import imgscale as ims
from imgscale import detectors

SIZE = (1024, 512)  # powers of two: ratios of whole eighths of a pixel are exact
ODD_SIZE = (1242, 375)


class Thing(NamedTuple):
    """An object as it truly is; its box may be one that no detection can have."""

    label: str
    xyxy: tuple[float, float, float, float]
    score: float = 1.0
    mask: Any = None
    track_id: int | None = None


@dataclass(frozen=True)
class Backend:
    """How one backend tells of objects, and the function that reads it."""

    # (things, size, **how) -> what the backend gives, and options of the converter. `how` holds
    # told (whether the size is known), dtype (of arrays) and digits (of printed numbers).
    encode: Callable[..., tuple[Any, dict[str, Any]]]
    convert: Callable[..., Any]
    argument: str  # the converter's name for what the backend gives
    place: str  # of one object, in messages
    grid: float = 1 / 8  # boxes on it come back exactly, in px
    digits: int | None = None  # decimals that its files are usually printed with
    error: Callable[[int], float] = lambda _: 0.0  # of an edge by then, in px of such a side
    optional: frozenset[str] = frozenset()  # members that may be missing
    cannot: Mapping[str, str] = field(default_factory=dict)  # which law, and why

    def read(self, things, size=SIZE, **how):
        given, options = self.encode(things, size, **how)
        return self.convert(given, **options)

    def where(self, index):
        return self.place.format(index=index, number=index + 1)


# --- the shapes of the backends ---


def column(things, name, dtype=np.float64):
    return np.array([getattr(thing, name) for thing in things], dtype=dtype)


def boxes(things, dtype=np.float64):
    return column(things, "xyxy", dtype).reshape(-1, 4)


def masks(things):
    if not any(thing.mask is not None for thing in things):
        return None
    return np.stack([thing.mask for thing in things])


def numbered(things):
    """Tell every name once, and each thing's number among them."""
    names = list(dict.fromkeys(thing.label for thing in things))
    return names, [names.index(thing.label) for thing in things]


def ratios(thing, size, digits=None):
    """Left, top, width and height as shares of the picture's."""
    x1, y1, x2, y2 = thing.xyxy
    exact = (x1 / size[0], y1 / size[1], (x2 - x1) / size[0], (y2 - y1) / size[1])
    return exact if digits is None else tuple(round(ratio, digits) for ratio in exact)


def printed(number, digits):
    return repr(float(number)) if digits is None else f"{number:.{digits}f}"


def only(found):
    """Take the one picture's detections."""
    (detections,) = found.values()
    return detections


def rekognition(things, size, **_):
    sides = ("Left", "Top", "Width", "Height")
    labels = []
    for thing in things:
        box = dict(zip(sides, ratios(thing, size), strict=True))
        instances = [{"BoundingBox": box, "Confidence": 100 * thing.score}]
        names = {"Parents": [{"Name": "Thing"}], "Aliases": [{"Name": "It"}]}
        labels.append({"Name": thing.label, "Instances": instances} | names)
    return {"Labels": labels}, {"image_size": size}


def supervision(things, size, *, told=True, dtype=np.float64, **_):
    names, numbers = numbered(things)
    tracked = any(thing.track_id is not None for thing in things)
    found = SimpleNamespace(
        xyxy=boxes(things, dtype),
        mask=masks(things),
        confidence=column(things, "score", dtype),
        class_id=np.array(numbers, dtype=np.int64),
        tracker_id=column(things, "track_id", np.int64) if tracked else None,
        data={},
    )
    return found, {"class_names": names, "image_size": size if told else None}


def supervision_names(things, size, **how):
    """Names in the data, as those of its own readers put them there that know names."""
    found, options = supervision(things, size, **how)
    found.class_id = None
    found.data["class_name"] = np.array([thing.label for thing in things], dtype=np.str_)
    return found, {"image_size": options["image_size"]}


def without_fraction(number):
    return int(number) if math.isfinite(number) else number


def pipeline(things, size, *, told=True, **_):
    corners = ("xmin", "ymin", "xmax", "ymax")
    items = []
    for thing in things:
        box = dict(zip(corners, map(without_fraction, thing.xyxy), strict=True))
        items.append({"score": thing.score, "label": thing.label, "box": box})
    return items, {"image_size": size if told else None}


def transformers(things, size, *, told=True, dtype=np.float64, **_):
    names, numbers = numbered(things)
    found = {
        "scores": column(things, "score", dtype),
        "labels": np.array(numbers, dtype=np.int64),
        "boxes": boxes(things, dtype),
    }
    return found, {"id2label": dict(enumerate(names)), "image_size": size if told else None}


def zero_shot(things, size, **how):
    found, options = transformers(things, size, **how)
    del found["labels"]
    found["text_labels"] = [thing.label for thing in things]
    return found, {"image_size": options["image_size"]}


def run_lengths(mask):
    """Count runs, off and on by turns, down the columns, pixel by pixel."""
    lengths, last = [0], False
    for pixel in mask.T.ravel().tolist():
        if pixel is not last:
            lengths.append(0)
            last = pixel
        lengths[-1] += 1
    return {"size": list(mask.shape), "counts": lengths}


def coco_entry(thing, number):
    x1, y1, x2, y2 = thing.xyxy
    entry = {"image_id": 9, "category_id": number, "bbox": [x1, y1, x2 - x1, y2 - y1]}
    entry |= {"score": thing.score}
    return entry if thing.mask is None else entry | {"segmentation": run_lengths(thing.mask)}


def coco(things, size, *, told=True, **_):
    names, numbers = numbered(things)
    picture = {"id": 9, "file_name": "a.jpg"}
    picture |= {"width": size[0], "height": size[1]} if told else {}
    dataset = {
        "images": [picture],
        "categories": [{"id": number, "name": name} for number, name in enumerate(names)],
        "annotations": list(map(coco_entry, things, numbers)),
    }
    return dataset, {"masks": masks(things) is not None}


def coco_results(things, size, **how):
    dataset, options = coco(things, size, **how)
    return dataset.pop("annotations"), {"dataset": dataset, **options}


def outline(thing):
    """Corners of a box, or of the mask that `ell` makes in it."""
    x1, y1, x2, y2 = thing.xyxy
    if thing.mask is None:
        return [(x1, y1), (x2, y1), (x2, y2), (x1, y2)]
    x, y = (x1 + x2) // 2, (y1 + y2) // 2
    return [(x1, y1), (x, y1), (x, y), (x2, y), (x2, y2), (x1, y2)]


def coco_polygons(things, size, **how):
    dataset, _ = coco([thing._replace(mask=None) for thing in things], size, **how)
    for entry, thing in zip(dataset["annotations"], things, strict=True):
        entry["segmentation"] = [np.ravel(outline(thing)).tolist()]
    return dataset, {"masks": True}


def megadetector(things, size, *, digits=None, **_):
    names, numbers = numbered(things)
    found = [
        {"category": str(number), "conf": thing.score, "bbox": list(ratios(thing, size, digits))}
        for thing, number in zip(things, numbers, strict=True)
    ]
    data = {
        "images": [{"file": "a.jpg", "detections": found}],
        "detection_categories": {str(number): name for number, name in enumerate(names)},
    }
    return data, {"image_sizes": {"a.jpg": size}}


def add(parent, tag, text=None):
    child = ET.SubElement(parent, tag)
    child.text = text
    return child


def pascal_voc(things, size, *, told=True, first=1, digits=0, **_):
    annotation = ET.Element("annotation")
    if told:
        picture = add(annotation, "size")
        for tag, length in zip(("width", "height"), size, strict=True):
            add(picture, tag, str(length))
    for thing in things:
        entry = add(annotation, "object")
        add(entry, "name", thing.label)
        bounds = add(entry, "bndbox")
        x1, y1, x2, y2 = thing.xyxy
        corners = (x1 + first, y1 + first, x2, y2)
        for tag, number in zip(("xmin", "ymin", "xmax", "ymax"), corners, strict=True):
            add(bounds, tag, printed(number, digits))
    return ET.tostring(annotation, encoding="unicode"), {"one_based": first == 1}


def pascal_voc_outlines(things, size, *, digits=None, **how):
    return pascal_voc(things, size, first=0, digits=digits, **how)


def yolo_line(number, shares, thing, digits):
    return " ".join([str(number), *(printed(share, digits) for share in shares), repr(thing.score)])


def yolo(things, size, *, digits=None, **_):
    names, numbers = numbered(things)
    lines = []
    for thing, number in zip(things, numbers, strict=True):
        left, top, width, height = ratios(thing, size)
        centred = (left + width / 2, top + height / 2, width, height)
        lines.append(yolo_line(number, centred, thing, digits))
    return "\n".join(lines), {"image_size": size, "class_names": names}


def yolo_polygons(things, size, *, digits=None, **_):
    names, numbers = numbered(things)
    lines = [
        yolo_line(number, np.ravel(np.divide(outline(thing), size)), thing, digits)
        for thing, number in zip(things, numbers, strict=True)
    ]
    return "\n".join(lines), {"image_size": size, "class_names": names, "polygons": True}


def kitti(things, size, *, told=True, digits=None, **_):
    lines = []
    for thing in things:
        corners = " ".join(printed(number, digits) for number in thing.xyxy)
        unknown = "-1 -1 -1 -1000 -1000 -1000 -10"
        lines.append(f"{thing.label} -1 -1 -10 {corners} {unknown} {thing.score!r}")
    return "\n".join(lines), {"image_size": size if told else None}


def ultralytics(things, size, *, dtype=np.float64, **_):
    names, numbers = numbered(things)
    tracked = any(thing.track_id is not None for thing in things)
    found = SimpleNamespace(
        xyxy=boxes(things, dtype),
        conf=column(things, "score", dtype),
        cls=np.array(numbers, dtype=dtype),
        id=column(things, "track_id", dtype) if tracked else None,
    )
    pixels = masks(things)
    result = SimpleNamespace(
        boxes=found,
        masks=None if pixels is None else SimpleNamespace(data=pixels.astype(np.uint8)),
        names=dict(enumerate(names)),
        orig_shape=size[::-1],
    )
    return result, {}


def torchvision(things, size, *, told=True, dtype=np.float64, **_):
    names, numbers = numbered(things)
    output = {
        "boxes": boxes(things, dtype),
        "labels": np.array(numbers, dtype=np.int64) + 1,
        "scores": column(things, "score", dtype),
    }
    options = {"categories": ["__background__", *names], "image_size": size if told else None}
    if masks(things) is not None:
        output["masks"] = np.where(masks(things), dtype(0.75), dtype(0.25))[:, np.newaxis]
        options["mask_threshold"] = 0.5
    return output, options


# --- the backends, and what each cannot carry ---

LAWS = (
    *("scores", "masks", "boxes without masks", "empty masks", "tracks", "fractions", "float32"),
    *("unknown size", "before pixel 0", "inverted boxes"),
)

NO_SCORES = {"scores": "annotations of the format are certain"}
NO_MASKS = dict.fromkeys(("masks", "empty masks"), "the format has boxes alone")
NO_TRACKS = {"tracks": "the format has no identities"}
NO_FLOAT32 = {"float32": "its numbers are text or Python's own"}
NO_FRACTIONS = {"fractions": "the format has whole pixels"}
ALWAYS_TOLD = {"unknown size": "its size is part of it or must be told"}
OUTLINES = {
    "boxes without masks": "a box is the outline of its polygon",
    "empty masks": "a polygon with a box has an area",
}


def from_coco(dataset, **options):
    return only(detectors.from_coco(dataset, **options))


def from_coco_results(results, *, dataset, **options):
    return only(detectors.from_coco(dataset, results, **options))


def from_megadetector(data, **options):
    return only(detectors.from_megadetector(data, **options))


BACKENDS = {
    "rekognition": Backend(
        rekognition,
        detectors.from_rekognition,
        argument="response",
        place="Labels[{index}].Instances[0]",
        error=lambda side: 1e-12 * side,  # a ratio of a size, and back
        optional=frozenset({"Instances", "Confidence", "Parents", "Aliases"}),
        cannot=NO_MASKS | NO_TRACKS | NO_FLOAT32 | ALWAYS_TOLD,
    ),
    "supervision": Backend(
        supervision,
        detectors.from_supervision,
        argument="detections",
        place="detections[{index}]",
        optional=frozenset({"mask", "confidence", "tracker_id"}),
    ),
    "supervision with names": Backend(
        supervision_names,
        detectors.from_supervision,
        argument="detections",
        place="detections[{index}]",
        optional=frozenset({"mask", "confidence", "class_id", "tracker_id"}),
    ),
    "transformers pipeline": Backend(
        pipeline,
        detectors.from_transformers,
        argument="results",
        place="results[{index}]",
        grid=1,
        error=lambda _: 1.0,  # it cuts the fraction off
        cannot=NO_MASKS | NO_TRACKS | NO_FLOAT32 | NO_FRACTIONS,
    ),
    "transformers": Backend(
        transformers,
        detectors.from_transformers,
        argument="results",
        place="results[{index}]",
        cannot=NO_MASKS | NO_TRACKS,
    ),
    "transformers zero-shot": Backend(
        zero_shot,
        detectors.from_transformers,
        argument="results",
        place="results[{index}]",
        cannot=NO_MASKS | NO_TRACKS,
    ),
    "coco": Backend(
        coco,
        from_coco,
        argument="dataset",
        place="annotations[{index}]",
        error=lambda side: 1e-12 * side,  # the right edge is left + width
        optional=frozenset({"score", "segmentation"}),
        cannot=NO_TRACKS | NO_FLOAT32,
    ),
    "coco results": Backend(
        coco_results,
        from_coco_results,
        argument="results",
        place="results[{index}]",
        error=lambda side: 1e-12 * side,
        optional=frozenset({"score", "segmentation"}),
        cannot=NO_TRACKS | NO_FLOAT32,
    ),
    "coco polygons": Backend(
        coco_polygons,
        from_coco,
        argument="dataset",
        place="annotations[{index}]",
        error=lambda side: 1e-12 * side,
        optional=frozenset({"score", "segmentation"}),
        cannot=NO_TRACKS
        | NO_FLOAT32
        | OUTLINES
        | {"unknown size": "a polygon is drawn in a picture of known size"},
    ),
    "megadetector": Backend(
        megadetector,
        from_megadetector,
        argument="data",
        place="detections[{index}]",
        digits=4,
        error=lambda side: 1.01e-4 * side,  # left and width, each rounded by half
        cannot=NO_MASKS | NO_TRACKS | NO_FLOAT32 | ALWAYS_TOLD,
    ),
    "pascal voc": Backend(
        pascal_voc,
        detectors.from_pascal_voc,
        argument="xml",
        place="object[{index}]",
        grid=1,
        digits=0,
        error=lambda _: 0.5,
        cannot=NO_SCORES
        | NO_MASKS
        | NO_TRACKS
        | NO_FLOAT32
        | NO_FRACTIONS
        | {"before pixel 0": "the format counts from 1, and a smaller number tells a misuse"},
    ),
    "pascal voc outlines": Backend(
        pascal_voc_outlines,
        detectors.from_pascal_voc,
        argument="xml",
        place="object[{index}]",
        digits=2,
        error=lambda _: 0.0051,
        cannot=NO_SCORES | NO_MASKS | NO_TRACKS | NO_FLOAT32,
    ),
    "yolo": Backend(
        yolo,
        detectors.from_yolo,
        argument="text",
        place="line {number}",
        digits=6,
        error=lambda side: 0.76e-6 * side,  # a centre and half a width, each rounded by half
        cannot=NO_MASKS | NO_TRACKS | NO_FLOAT32 | ALWAYS_TOLD,
    ),
    "yolo polygons": Backend(
        yolo_polygons,
        detectors.from_yolo,
        argument="text",
        place="line {number}",
        digits=6,
        error=lambda side: 0.51e-6 * side,
        cannot=NO_TRACKS
        | NO_FLOAT32
        | ALWAYS_TOLD
        | OUTLINES
        | {"inverted boxes": "corners of a polygon have no order"},
    ),
    "kitti": Backend(
        kitti,
        detectors.from_kitti,
        argument="text",
        place="line {number}",
        digits=2,
        error=lambda _: 0.0051,
        cannot=NO_MASKS | NO_TRACKS | NO_FLOAT32,
    ),
    "ultralytics": Backend(
        ultralytics,
        detectors.from_ultralytics,
        argument="result",
        place="result[{index}]",
        optional=frozenset({"id", "masks"}),
        cannot=ALWAYS_TOLD,
    ),
    "torchvision": Backend(
        torchvision,
        detectors.from_torchvision,
        argument="output",
        place="output[{index}]",
        optional=frozenset({"masks"}),
        cannot=NO_TRACKS,
    ),
}


def every(law=None, *, can=True):
    """Go through the backends that can carry what a law is about, or through those that cannot."""
    assert law is None or law in LAWS
    return pytest.mark.parametrize(
        "backend",
        [
            pytest.param(backend, id=name)
            for name, backend in BACKENDS.items()
            if law is None or (law not in backend.cannot) is can
        ],
    )


def some(count, *, grid=1 / 8, size=SIZE, seed=7):
    """Objects of random places, sizes and scores, on a grid of so many pixels."""
    random = np.random.default_rng(seed)
    labels = ("person", "car", "person", "truck")
    things = []
    for index in range(count):
        width, height = (int(random.integers(8, 100) / grid) * grid for _ in range(2))
        x = int(random.uniform(0, size[0] - width) / grid) * grid
        y = int(random.uniform(0, size[1] - height) / grid) * grid
        score = int(random.integers(0, 65)) / 64  # exact as per cent and as float32
        things.append(Thing(labels[index % 4], (x, y, x + width, y + height), score))
    return things


def ell(xyxy, size=SIZE):
    """An L-shaped mask: all of its box but the right upper quarter."""
    x1, y1, x2, y2 = map(int, xyxy)
    mask = np.zeros(size[::-1], dtype=np.bool_)
    mask[y1:y2, x1:x2] = True
    mask[y1 : (y1 + y2) // 2, (x1 + x2) // 2 : x2] = False
    return mask


def with_everything(count, backend):
    """Objects with all that a backend carries."""
    things = some(count, grid=1)
    if "masks" not in backend.cannot:
        things = [thing._replace(mask=ell(thing.xyxy)) for thing in things]
    if "tracks" not in backend.cannot:
        things = [thing._replace(track_id=number) for number, thing in enumerate(things)]
    return things


def test_every_converter_of_the_package_is_here():
    converters = {getattr(detectors, name) for name in detectors.__all__ if name[:5] == "from_"}
    assert {function.__name__ for function in converters} == {
        re.sub("_results$", "", backend.convert.__name__) for backend in BACKENDS.values()
    }


def test_what_a_backend_cannot_carry_is_a_law_with_a_reason():
    for backend in BACKENDS.values():
        assert set(backend.cannot) <= set(LAWS)
        assert all(len(reason.split()) > 3 for reason in backend.cannot.values())


# --- what comes back ---


@every()
@pytest.mark.parametrize("count", [0, 1, 50])
def test_detections_come_as_a_list_of_the_same_length_and_order(backend, count):
    things = some(count, grid=backend.grid)
    found = backend.read(things)
    assert type(found) is list
    assert {type(detection) for detection in found} <= {ims.Detection}
    assert [detection.label for detection in found] == [thing.label for thing in things]


@every()
def test_boxes_on_the_grid_of_the_format_come_back_exactly(backend):
    things = some(50, grid=backend.grid)
    found = backend.read(things)
    assert [detection.xyxy for detection in found] == [thing.xyxy for thing in things]
    assert {type(number) for detection in found for number in detection.xyxy} == {float}


@every()
def test_boxes_come_back_to_the_digits_that_the_format_is_usually_printed_with(backend):
    things = some(50, grid=1e-7, size=ODD_SIZE)
    found = backend.read(things, ODD_SIZE, digits=backend.digits)
    lost = np.abs([detection.xyxy for detection in found] - boxes(things)).max(axis=0)
    assert (lost <= [backend.error(side) for side in ODD_SIZE * 2]).all()


@every("fractions")
def test_fractions_of_a_pixel_are_kept(backend):
    (found,) = backend.read([Thing("car", (10.125, 20.25, 110.875, 70.5))])
    assert found.xyxy == (10.125, 20.25, 110.875, 70.5)


@every("float32")
def test_float32_boxes_and_scores_keep_their_own_value(backend):
    things = [thing._replace(score=0.999 * thing.score) for thing in some(50, grid=1e-3)]
    found = backend.read(things, dtype=np.float32)
    assert [list(d.xyxy) for d in found] == boxes(things, np.float32).tolist()
    assert [d.score for d in found] == column(things, "score", np.float32).tolist()
    assert {type(number) for d in found for number in (*d.xyxy, d.score)} == {float}


@every("scores")
def test_scores_are_shares_of_one(backend):
    things = some(50, grid=backend.grid)
    things[0], things[1] = things[0]._replace(score=0.0), things[1]._replace(score=1.0)
    found = backend.read(things)
    assert [detection.score for detection in found] == [thing.score for thing in things]


@every("scores", can=False)
def test_what_has_no_scores_is_certain(backend):
    found = backend.read(some(3, grid=backend.grid))
    assert [detection.score for detection in found] == [1.0, 1.0, 1.0]


@every("masks")
def test_masks_are_boolean_of_the_pictures_shape_and_equal(backend):
    corners = [(10, 20, 110, 70), (300, 100, 333, 210), (1000, 500, 1024, 512)]
    things = [Thing("car", xyxy, 0.5, ell(xyxy)) for xyxy in corners]
    for detection, thing in zip(backend.read(things), things, strict=True):
        assert detection.mask.dtype == np.bool_
        assert detection.mask.shape == (SIZE[1], SIZE[0])
        assert np.array_equal(detection.mask, thing.mask)


@every("boxes without masks")
def test_boxes_without_masks_have_none(backend):
    found = backend.read(some(2, grid=backend.grid))
    assert [detection.mask for detection in found] == [None, None]


@every("empty masks")
def test_a_mask_without_a_pixel_leaves_the_box_alone(backend):
    first, second = some(2, grid=1)
    nothing = np.zeros((SIZE[1], SIZE[0]), dtype=np.bool_)
    things = [first._replace(mask=nothing), second._replace(mask=ell(second.xyxy))]
    found = backend.read(things)
    assert [detection.mask is None for detection in found] == [True, False]
    assert [detection.xyxy for detection in found] == [first.xyxy, second.xyxy]


@every("tracks")
def test_track_ids_are_whole_numbers(backend):
    things = [thing._replace(track_id=40 + index) for index, thing in enumerate(some(3))]
    ids = [detection.track_id for detection in backend.read(things)]
    assert [(number, type(number)) for number in ids] == [(40, int), (41, int), (42, int)]


@every()
def test_without_a_tracker_there_are_no_track_ids(backend):
    found = backend.read(some(2, grid=backend.grid))
    assert [detection.track_id for detection in found] == [None, None]


STRANGE_LABELS = (
    "Straßenbahn",
    "猫",
    "ÅNGSTRÖM",
    "e\u0301le\u0301phant",
    "🚲",
    "<&>\"'",
    "a\u2019b",
    "0",
)


@every()
def test_labels_are_spelt_as_given(backend):
    things = [
        thing._replace(label=label)
        for thing, label in zip(some(8, grid=backend.grid), STRANGE_LABELS, strict=True)
    ]
    labels = [detection.label for detection in backend.read(things)]
    assert labels == list(STRANGE_LABELS)
    assert {type(label) for label in labels} == {str}


@every()
def test_fit_takes_what_comes_back(backend):
    found = backend.read(some(8, grid=backend.grid))
    depth = ims.DepthMap([[4.0]], kind="relative", image_size=SIZE)
    model = ims.fit(found, depth, method="robust")
    assert [reference.label for reference in model.references] == [d.label for d in found]
    assert sum(reference.used for reference in model.references) >= 4


LABELS = st.text(st.characters(categories=["L", "N", "P", "S"]), min_size=1, max_size=6)
SHARES = st.floats(0, 1)


@st.composite
def scenes(draw):
    """A picture's size and objects anywhere in it, no two in the very same place."""
    size = tuple(draw(st.integers(16, 1300)) for _ in range(2))
    things = []
    for _ in range(draw(st.integers(0, 6))):
        corners = []
        for side in size:
            length = 4 + draw(SHARES) * (side - 4)
            start = draw(SHARES) * (side - length)
            corners.append((start, min(start + length, side)))
        (x1, x2), (y1, y2) = corners
        things.append(Thing(draw(LABELS), (x1, y1, x2, y2), draw(SHARES)))
    return size, list({thing.xyxy: thing for thing in things}.values())


@every()
@settings(max_examples=30, deadline=None)
@given(scene=scenes())
def test_whatever_is_in_a_picture_comes_back(backend, scene):
    size, things = scene
    found = backend.read(things, size, digits=backend.digits)
    assert [detection.label for detection in found] == [thing.label for thing in things]
    if "scores" not in backend.cannot:
        assert [d.score for d in found] == pytest.approx([t.score for t in things], abs=1e-12)
    for detection, thing in zip(found, things, strict=True):
        lost = np.abs(np.subtract(detection.xyxy, thing.xyxy))
        assert (lost <= [backend.error(side) + 1e-12 * side for side in size * 2]).all()


# --- what goes in is left alone ---


def parts(value):
    """Tell the members of what a backend gives, by key, index or name."""
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, (list, tuple)):
        return dict(enumerate(value))
    return dict(vars(value)) if isinstance(value, SimpleNamespace) else {}


def locked(value):
    """Make it so that whoever writes to it is stopped."""
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
        return value
    if isinstance(value, dict):
        return MappingProxyType({key: locked(part) for key, part in value.items()})
    if isinstance(value, (list, tuple)):
        return tuple(map(locked, value))
    for name, part in parts(value).items():
        setattr(value, name, locked(part))
    return value


def contents(value):
    """Tell all that is in it, to compare with later."""
    if isinstance(value, np.ndarray):
        return (value.dtype, value.shape, value.tobytes())
    inside = parts(value)
    return {key: contents(part) for key, part in inside.items()} if inside else repr(value)


def arrays(value):
    """Go through the arrays in it."""
    if isinstance(value, np.ndarray):
        yield value
    for part in parts(value).values():
        yield from arrays(part)


@every()
def test_what_cannot_be_written_to_is_read_all_the_same(backend):
    things = with_everything(3, backend)
    given, options = backend.encode(things, SIZE)
    assert backend.convert(locked(given), **options) == backend.read(things)


@every()
def test_what_is_read_is_not_written_to(backend):
    given, options = backend.encode(with_everything(3, backend), SIZE)
    before = contents((given, options))
    backend.convert(given, **options)
    assert contents((given, options)) == before


@every()
def test_detections_do_not_change_with_what_they_were_read_from(backend):
    things = with_everything(3, backend)
    given, options = backend.encode(things, SIZE)
    found = backend.convert(given, **options)
    for array in arrays(given):
        array[...] = 0
    assert found == backend.read(things)


# --- the picture's border ---

BEYOND = {
    "right": ((1000.0, 100.0, 1034.0, 200.0), (1000.0, 100.0, 1024.0, 200.0)),
    "below": ((100.0, 400.0, 200.0, 520.0), (100.0, 400.0, 200.0, 512.0)),
    "left": ((-10.0, 100.0, 50.0, 200.0), (0.0, 100.0, 50.0, 200.0)),
    "above": ((100.0, -8.0, 200.0, 100.0), (100.0, 0.0, 200.0, 100.0)),
}


@every()
@pytest.mark.parametrize("side", ["right", "below"])
def test_a_box_that_ends_beyond_the_border_is_cut_at_it(backend, side):
    drawn, cut = BEYOND[side]
    (found,) = backend.read([Thing("car", drawn)])
    assert found.xyxy == cut


@every("before pixel 0")
@pytest.mark.parametrize("side", ["left", "above"])
def test_a_box_that_starts_before_the_border_is_cut_at_it(backend, side):
    drawn, cut = BEYOND[side]
    (found,) = backend.read([Thing("car", drawn)])
    assert found.xyxy == cut


@every("before pixel 0", can=False)
def test_a_box_that_starts_before_the_first_pixel_is_refused_where_it_tells_a_misuse(backend):
    refused(backend, xyxy=(-10.0, 100.0, 50.0, 200.0))


@every("unknown size")
def test_a_box_is_not_cut_where_the_size_is_unknown(backend):
    drawn, _ = BEYOND["right"]
    (found,) = backend.read([Thing("car", drawn)], told=False)
    assert found.xyxy == drawn


@every("masks")
def test_a_cut_box_keeps_its_mask(backend):
    drawn, cut = BEYOND["right"]
    if "boxes without masks" in backend.cannot:
        drawn = cut  # a polygon is its box
    (found,) = backend.read([Thing("car", drawn, 1.0, ell(cut))])
    assert found.xyxy == cut
    assert np.array_equal(found.mask, ell(cut))


# --- boxes and scores that are none ---


def refused(backend, message="", **changes):
    """Spoil the second of three objects: a ValueError must name its place."""
    things = some(3, grid=backend.grid)
    things[1] = things[1]._replace(**changes)
    with pytest.raises(ValueError, match=re.escape(backend.where(1))) as caught:
        backend.read(things)
    assert type(caught.value) is ValueError
    assert message in str(caught.value)


@every()
@pytest.mark.parametrize(
    "box",
    [
        pytest.param((1034.0, 100.0, 1064.0, 200.0), id="right"),
        pytest.param((100.0, 514.0, 200.0, 524.0), id="below"),
        pytest.param((1024.0, 100.0, 1064.0, 200.0), id="touching the border"),
    ],
)
def test_a_box_wholly_outside_is_refused_by_its_place(backend, box):
    refused(backend, "the box must overlap the picture, 1024 x 512 px", xyxy=box)


@every("before pixel 0")
def test_a_box_wholly_before_the_first_pixel_is_refused_by_its_place(backend):
    box = (-40.0, 100.0, -10.0, 200.0)
    refused(backend, "the box must overlap the picture, 1024 x 512 px", xyxy=box)


@every("inverted boxes")
@pytest.mark.parametrize(
    "box",
    [
        pytest.param((50.0, 20.0, 10.0, 70.0), id="x"),
        pytest.param((10.0, 70.0, 50.0, 20.0), id="y"),
    ],
)
def test_an_inverted_box_is_refused_by_its_place(backend, box):
    refused(backend, xyxy=box)


@every()
@pytest.mark.parametrize(
    "box",
    [
        pytest.param((10.0, 20.0, 10.0, 70.0), id="no width"),
        pytest.param((10.0, 20.0, 50.0, 20.0), id="no height"),
        pytest.param((10.0, 20.0, 10.0, 20.0), id="a point"),
    ],
)
def test_a_box_without_area_is_refused_by_its_place(backend, box):
    refused(backend, xyxy=box)


@every()
@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_a_box_that_is_not_finite_is_refused_by_its_place(backend, number):
    for corner in range(4):
        box = [10.0, 20.0, 50.0, 70.0]
        box[corner] = number
        refused(backend, xyxy=tuple(box))


@every("scores")
def test_a_score_that_is_no_share_of_one_is_refused_by_its_place(backend):
    for score in (-0.25, 1.02, 97.0, math.nan, math.inf):
        refused(backend, score=score)


# --- what is no result at all ---

MISSING = object()
# A backquoted name, an entry, a line, an element, a member.
NAMES_SOMETHING = re.compile(r"`\w[^`]*`|\w\[\d+\]|line \d|<\w+>|\w\.\w+ must")


def fault(error):
    """Tell why a user could not act on an error; nothing where one could."""
    if not (isinstance(error, ims.ImgscaleError) or type(error) in {ValueError, TypeError}):
        return f"foreign {error!r}"
    return "" if NAMES_SOMETHING.search(str(error)) else f"names nothing: {error!r}"


def attempt(backend, given, options):
    """Read something: what came back, or None and the fault of the refusal."""
    try:
        return backend.convert(given, **options), ""
    except Exception as error:  # noqa: BLE001 - whatever it is, it is looked at
        return None, fault(error)


@every()
def test_what_is_no_result_is_refused_by_the_arguments_name(backend):
    _, options = backend.encode(some(2), SIZE)
    none = () if backend is BACKENDS["coco results"] else (None,)  # there it means annotations
    for garbage in (7, object(), *none):
        with pytest.raises((ValueError, TypeError), match=f"`{backend.argument}`") as caught:
            backend.convert(garbage, **options)
        assert not fault(caught.value)


@every()
@pytest.mark.parametrize("garbage", ["text", [], {}, [7], [[]], [{}], {"a": 1, 2: 3}], ids=repr)
def test_a_result_of_another_shape_is_refused_or_empty(backend, garbage):
    _, options = backend.encode(some(2), SIZE)
    found, wrong = attempt(backend, garbage, options)
    assert not wrong
    assert found is None or (garbage, found) == ([], [])  # a list of results may be empty


def paths(value, path=()):
    """Go through all that a result holds, in lists to the first entry."""
    if path:
        yield path
    inside = {} if isinstance(value, tuple) else parts(value)
    for key in list(inside)[: 1 if isinstance(value, list) else None]:
        yield from paths(inside[key], (*path, key))


def changed(value, path, new):
    """Copy a result with something else in one place, or with nothing."""
    value = whole = copy.deepcopy(value)
    for key in path[:-1]:
        value = parts(value)[key]
    if isinstance(value, SimpleNamespace):
        value = vars(value)
    if new is MISSING:
        del value[path[-1]]
    else:
        value[path[-1]] = new
    return whole


PLACES = [
    pytest.param(backend, path, id=f"{name}: {'.'.join(map(str, path))}")
    for name, backend in BACKENDS.items()
    for path in paths(backend.encode(with_everything(2, backend), SIZE)[0])
]


def what_is_wrong(old, key, backend):
    """Make what has no place where the old value was."""
    wrong = [7, "text", [], {}, [None], math.nan]
    wrong += [] if key in backend.optional else [None] if isinstance(key, int) else [None, MISSING]
    if isinstance(old, np.ndarray):
        wrong += [old[:-1], np.float64(3)]
        wrong += [np.full(old.shape, "text")] if old.dtype.kind != "U" else []
        wrong += [np.full(old.shape, None)] if key not in backend.optional else []
    for new in wrong:
        number = isinstance(old, float) and new == 7
        same = type(new) is type(old) and not isinstance(new, (np.ndarray, float))
        name = key == "file_name" or (key == 0 and new == "text")  # names may come bare
        nothing = key == "segmentation" and new in ([], {})
        if not (number or same or name or nothing):
            yield new


def outcomes(backend, path, replacements):
    """Put one thing after the other in one place: what was read, and faults of refusals."""
    given, options = backend.encode(with_everything(2, backend), SIZE)
    tried = [attempt(backend, changed(given, path, new), options) for new in replacements]
    return [found for found, _ in tried if found is not None], [
        wrong for _, wrong in tried if wrong
    ]


@pytest.mark.parametrize(("backend", "path"), PLACES)
def test_a_member_of_another_type_or_missing_is_refused(backend, path):
    old, _ = backend.encode(with_everything(2, backend), SIZE)
    for key in path:
        old = parts(old)[key]
    assert outcomes(backend, path, what_is_wrong(old, path[-1], backend)) == ([], [])


@pytest.mark.parametrize(
    ("backend", "path"), [p for p in PLACES if p.values[1][-1] in p.values[0].optional]
)
def test_a_member_that_is_optional_may_be_none_or_missing(backend, path):
    read, faults = outcomes(backend, path, [None, MISSING])
    assert {len(found) for found in read} == {1 if path[-1] == "Instances" else 2}
    assert faults == []


NAMES_OF_OPTIONS = ("class_names", "id2label", "categories", "image_size", "image_sizes")


@every()
def test_an_option_of_another_type_is_refused_by_its_name(backend):
    given, options = backend.encode(some(2, grid=1), SIZE)
    for name in options.keys() & NAMES_OF_OPTIONS:
        for wrong in (7, 2.5, "car", [], {}):
            with pytest.raises((ValueError, TypeError), match=f"`{name}`") as caught:
                backend.convert(given, **options | {name: wrong})
            assert not fault(caught.value)


WORDS = [
    pytest.param(BACKENDS[name], number, id=f"{name}: word {number}")
    for name in ("yolo", "yolo polygons", "kitti")
    for number in range(len(BACKENDS[name].encode(some(1), SIZE)[0].split()))
    if (name, number) != ("kitti", 0)  # the label
]


@pytest.mark.parametrize(("backend", "number"), WORDS)
def test_a_word_that_is_no_number_is_refused_by_its_line(backend, number):
    given, options = backend.encode(some(3), SIZE)
    for word in ("text", "nan", "inf", "-inf", "1e999", "1,5", "½"):
        lines = [line.split() for line in given.splitlines()]
        lines[1][number] = word
        with pytest.raises(ValueError, match=backend.where(1)) as caught:
            backend.convert("\n".join(map(" ".join, lines)), **options)
        assert type(caught.value) is ValueError


@pytest.mark.parametrize("name", ["pascal voc", "pascal voc outlines"])
@pytest.mark.parametrize("tag", ["name", "bndbox", "xmin", "ymin", "xmax", "ymax"])
def test_an_element_that_is_missing_or_no_number_is_refused_by_its_object(name, tag):
    backend = BACKENDS[name]
    given, options = backend.encode(some(3, grid=1), SIZE)
    for text in (MISSING, "") if tag in {"name", "bndbox"} else (MISSING, "", "text", "nan", "inf"):
        tree = ET.fromstring(given)  # noqa: S314 - our own text
        parent = next(p for p in tree.findall("object")[1].iter() if p.find(tag) is not None)
        element = parent.find(tag)
        if text is MISSING:
            parent.remove(element)
        else:
            element.clear()
            element.text = text
        with pytest.raises(ValueError, match=r"object\[1\]") as caught:
            backend.convert(ET.tostring(tree, encoding="unicode"), **options)
        assert type(caught.value) is ValueError


@pytest.mark.parametrize("name", ["rekognition", "transformers pipeline", "coco", "megadetector"])
def test_a_whole_number_that_is_no_float_is_refused_by_its_place(name):
    refused(BACKENDS[name], score=10**400)


# Polygons are drawn in the picture, and masks of ultralytics brought to it.
@pytest.mark.parametrize(
    "name", ["supervision", "supervision with names", "coco", "coco results", "torchvision"]
)
def test_a_mask_of_another_picture_is_refused_by_its_place(name):
    backend = BACKENDS[name]
    things = [thing._replace(mask=ell(thing.xyxy)) for thing in some(3, grid=1)]
    given, options = backend.encode(things, SIZE)
    if "image_size" in options:
        options["image_size"] = (1100, 600)
    else:
        dataset = options.get("dataset", given)
        dataset["images"][0] |= {"width": 1100, "height": 600}
    with pytest.raises(ValueError, match=r"\[0\]") as caught:
        backend.convert(given, **options)
    assert not fault(caught.value)


def test_all_but_the_results_are_told_by_name():
    for name in detectors.__all__:
        if not name.startswith(("from_", "read_")):
            continue
        first, *others = inspect.signature(getattr(detectors, name)).parameters.values()
        positional = {option.name for option in others if option.kind is not option.KEYWORD_ONLY}
        assert positional <= {"results", "results_path"}  # COCO's are in two files
        sizes = {option.name for option in others if "size" in option.name}
        assert sizes <= {"image_size", "image_sizes"}
        assert first.default is first.empty


CLASSES = {
    "supervision": ("class_id",),
    "transformers": ("labels",),
    "coco": ("annotations", 0, "category_id"),
    "coco results": (0, "category_id"),
    "megadetector": ("images", 0, "detections", 0, "category"),
    "ultralytics": ("boxes", "cls"),
    "torchvision": ("labels",),
}


@pytest.mark.parametrize("name", ["supervision", "transformers", "yolo", "ultralytics"])
def test_names_under_strings_as_json_has_them_are_told_from_whole_numbers(name):
    backend = BACKENDS[name]
    given, options = backend.encode(some(3), SIZE)
    in_json = {"0": "person", "1": "car"}
    if name == "ultralytics":
        given.names = in_json
    else:
        options["id2label" if name == "transformers" else "class_names"] = in_json
    with pytest.raises(ValueError, match=re.escape(backend.where(0))) as caught:
        backend.convert(given, **options)
    remedy = "Keys must be whole numbers: {int(key): name for key, name in names.items()}."
    assert str(caught.value).endswith(f"names for '0', '1'. {remedy}")


@pytest.mark.parametrize("number", [99, -1, 0.5])
@pytest.mark.parametrize("name", CLASSES)
def test_a_class_without_a_name_is_refused_by_its_place(name, number):
    backend, path = BACKENDS[name], CLASSES[name]
    given, options = backend.encode(some(1), SIZE)
    new = number if 0 in path else np.array([number])
    with pytest.raises((ValueError, TypeError), match=re.escape(backend.where(0))) as caught:
        backend.convert(changed(given, path, new), **options)
    assert not fault(caught.value)


@pytest.mark.parametrize(
    ("name", "path"), [("supervision", ("tracker_id",)), ("ultralytics", ("boxes", "id"))]
)
@pytest.mark.parametrize("number", [0.5, math.nan, math.inf])
def test_a_track_id_that_is_no_whole_number_is_refused_by_its_place(name, path, number):
    backend = BACKENDS[name]
    given, options = backend.encode([some(1)[0]._replace(track_id=3)], SIZE)
    with pytest.raises(ValueError, match=re.escape(backend.where(0))) as caught:
        backend.convert(changed(given, path, np.array([number])), **options)
    assert not fault(caught.value)
