"""Files that were cut, flipped and spliced: a result, or one error that names the file."""

import copy
import io
import json
import logging
import struct
import tempfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import imgscale as ims
from imgscale.depth_sources.files import read_depth, read_values
from imgscale.detectors import (
    from_coco,
    from_megadetector,
    from_rekognition,
    read_coco,
    read_kitti,
    read_megadetector,
    read_pascal_voc,
    read_yolo,
)
from imgscale.picture import upright_rgb

SIZE = (64, 48)
VALUES = np.linspace(1.0, 9.0, 12, dtype=np.float32).reshape(3, 4)


def npy():
    file = io.BytesIO()
    np.save(file, VALUES)
    return file.getvalue()


def npz():
    file = io.BytesIO()
    np.savez_compressed(file, depth=VALUES)
    return file.getvalue()


def png():
    def chunk(name, content):
        check = zlib.crc32(name + content)
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", check)

    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in VALUES)
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 4, 3, 16, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def tiff():
    tifffile = pytest.importorskip("tifffile")
    file = io.BytesIO()
    tifffile.imwrite(file, VALUES)
    return file.getvalue()


def photo(form):
    from PIL import ExifTags, Image  # noqa: PLC0415 - here only

    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = 6
    if form == "JPEG":
        exif[ExifTags.IFD.Exif] = {ExifTags.Base.FocalLengthIn35mmFilm: 28}
    file = io.BytesIO()
    pixels = np.random.default_rng(1).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(file, form, exif=exif)
    return file.getvalue()


COCO = {
    "images": [{"id": 1, "file_name": "a.jpg", "width": 64, "height": 48}],
    "categories": [{"id": 2, "name": "car"}],
    "annotations": [
        {"image_id": 1, "category_id": 2, "bbox": [1, 2, 30, 40.5], "score": 0.5, "iscrowd": 0,
         "segmentation": [[1, 2, 30, 2, 30, 40]]},
        {"image_id": 1, "category_id": 2, "bbox": [1, 2, 30, 40], "iscrowd": 1,
         "segmentation": {"size": [48, 64], "counts": [100, 2972]}},
        {"image_id": 1, "category_id": 2, "bbox": [0, 0, 64, 48], "iscrowd": 1,
         "segmentation": {"size": [48, 64], "counts": "T3ll2"}},
    ],
}  # fmt: skip
MEGADETECTOR = {
    "detection_categories": {"1": "animal", "2": "person"},
    "classification_categories": {"0": "fox", "1": "hare"},
    "images": [
        {"file": "a.jpg", "width": 64, "height": 48, "detections": [
            {"category": "1", "conf": 0.9, "bbox": [0.1, 0.2, 0.3, 0.4],
             "classifications": [["0", 0.7], ["1", 0.2]]}]},
        {"file": "b.jpg", "failure": "no picture", "detections": None},
    ],
}  # fmt: skip
BOX = {"Left": 0.5, "Top": 0.25, "Width": 0.125, "Height": 0.5}
REKOGNITION = {
    "Labels": [
        {"Name": "Man", "Confidence": 99.0, "Parents": [{"Name": "Person"}], "Aliases": [],
         "Instances": [{"BoundingBox": BOX, "Confidence": 98.5}]},
        {"Name": "Urban", "Instances": []},
    ]
}  # fmt: skip
VOC = (
    '<?xml version="1.0" encoding="utf-8"?><annotation><size><width>64</width><height>48</height>'
    "</size><object><name>dog</name><truncated>1</truncated><bndbox><xmin>1</xmin><ymin>11</ymin>"
    "<xmax>40</xmax><ymax>47</ymax></bndbox></object></annotation>"
)
KITTI = "Car 0 0 1.9 38 18 42 20.5 1.67 1.87 3.69 -16.5 2.4 58.5 1.57 0.75\n"
RECORD = (
    b'{"imgscale": 1, "options": {"axis": "height"}}\n'
    b'{"path": "a.jpg", "error": {"type": "FitError", "message": "no reference"}}\n'
    b'{"path": "b.jpg", "k": 0.25, "k_std": 0.01, "shift": 0.0, "flags": [], "objects": []}\n'
)
PRIORS = "label,aliases,mean_m,std_m,on_ground,year\nbüste,'=a; b,1.5,0.1,true,2020\nc,,2,1,,\n"

# the reader of each file, and a lawful one
FILES = {
    "a.npy": (read_values, npy),
    "a.npz": (lambda path: read_values(path, key="depth"), npz),
    "a.pfm": (
        lambda path: read_depth(path, kind="affine_inverse"),
        lambda: b"Pf\n4 3\n-1.0\n" + VALUES.tobytes(),
    ),
    "a.png": (lambda path: read_values(path, scale=256), png),
    "a.tif": (lambda path: read_values(path, scale=1), tiff),
    "a.json": (lambda path: read_coco(path, masks=True), lambda: json.dumps(COCO).encode()),
    "b.json": (
        lambda path: read_megadetector(path, image_folder=path.parent),
        lambda: json.dumps(MEGADETECTOR).encode(),
    ),
    "a.xml": (read_pascal_voc, VOC.encode),
    "a.txt": (lambda path: read_kitti(path, image_size=SIZE), KITTI.encode),
    "b.txt": (
        lambda path: read_yolo(path, image_size=SIZE, class_names=["car"], polygons=True),
        lambda: b"0 0.5 0.5 0.25 0.5 0.75\n0 0.1 0.1 0.5 0.1 0.5 0.5\n",
    ),
    "a.jsonl": (ims.read_record, lambda: RECORD),
    "a.csv": (ims.PriorTable.from_csv, PRIORS.encode),
    "a.jpg": (upright_rgb, lambda: photo("JPEG")),
    "b.png": (upright_rgb, lambda: photo("PNG")),
    "b.tif": (upright_rgb, lambda: photo("TIFF")),
    "c.jpg": (ims.Camera.from_exif, lambda: photo("JPEG")),
}


@pytest.fixture(scope="module")
def folder():
    with tempfile.TemporaryDirectory() as made:
        yield Path(made)


@pytest.fixture(autouse=True)
def quiet():
    logging.getLogger("tifffile").disabled = True
    yield
    logging.getLogger("tifffile").disabled = False


@st.composite
def damaged(draw, lawful, others):
    """Draw a file that was cut, had bits flipped, bytes put in, or got a piece of another."""
    content = bytearray(lawful)
    for _ in range(draw(st.integers(1, 4))):
        place = draw(st.integers(0, len(content)))
        what = draw(st.sampled_from(["cut", "flip", "put", "number", "splice", "drop"]))
        if what == "cut":
            del content[place:]
        elif what == "flip" and place < len(content):
            content[place] ^= 1 << draw(st.integers(0, 7))
        elif what == "put":
            content[place:place] = draw(st.binary(min_size=1, max_size=6))
        elif what == "number":  # lengths and offsets
            width = draw(st.sampled_from([1, 2, 4, 8]))
            value = draw(st.sampled_from([0, 1, 2 ** (8 * width - 1) - 1, 2 ** (8 * width) - 1]))
            order = draw(st.sampled_from(["little", "big"]))
            content[place : place + width] = value.to_bytes(width, order)
        elif what == "splice":
            other = draw(st.sampled_from(others))
            start = draw(st.integers(0, len(other)))
            content[place:] = other[start:]
        else:
            del content[place : place + draw(st.integers(1, 9))]
    return bytes(content)


@pytest.mark.parametrize("name", FILES)
def test_the_file_that_is_damaged_below_is_lawful(folder, name):
    read, lawful = FILES[name]
    (folder / name).write_bytes(lawful())
    assert read(folder / name) is not None


@pytest.mark.parametrize("name", FILES)
def test_a_damaged_file_gives_a_result_or_an_error_that_names_it(folder, name):
    read, make = FILES[name]
    lawful, path = make(), folder / name
    others = [lawful, *(content() for key, (_, content) in FILES.items() if key[2:] == name[2:])]

    @settings(derandomize=True, max_examples=120, deadline=None)
    @given(damaged(lawful, others))
    def check(content):
        path.write_bytes(content)
        # a photo without a focal length is a lawful file, and no answer
        expected = ValueError if name == "c.jpg" else ims.FileError
        told = name
        try:
            read(path)
        except expected as error:
            told = str(error)
        assert name in told
        assert len(told) < 20_000

    check()


# --- values of any kind at any place ---


ODD = (
    st.none()
    | st.booleans()
    | st.sampled_from([0, -1, 1, 0.5, 10**18, 10**400, -1e308, float("nan"), float("inf")])
    | st.sampled_from(["", " ", "1", "nan", "car", "x" * 2000, "\ud800", "\0", "../a.jpg"])
    | st.sampled_from([[], {}, [[]], [1, 2, 3, 4], ["1", 2, 3, 4], {"Name": "a"}, [True] * 4])
)


def places(value, path=()):
    """List the path to every member of a document."""
    yield path
    members = (
        value
        if isinstance(value, dict)
        else dict(enumerate(value if isinstance(value, list) else ()))
    )
    for key, member in members.items():
        yield from places(member, (*path, key))


def changed(document, path, value):
    """Put a value at one place of a document."""
    if not path:
        return value
    made = copy.deepcopy(document)
    *above, last = path
    parent = made
    for key in above:
        parent = parent[key]
    parent[last] = value
    return made


def variants(document):
    """Draw documents with one member of another kind."""
    found = [path for path in places(document) if path]
    return st.builds(changed, st.just(document), st.sampled_from(found), ODD)


def model():
    detections = [ims.Detection("car", (1, 2, 30, 40)), ims.Detection("person", (40, 2, 50, 40))]
    return ims.fit(detections, ims.ObjectDepths([5.0, 6.0], kind="metric"))


def result_or_law(convert, document):
    before, found, told = copy.deepcopy(document), None, ""
    try:
        found = convert(document)
    except (TypeError, ValueError) as error:
        told = str(error)
    assert len(told) < 2000
    assert repr(document) == repr(before)  # equality knows no NaN
    return found


@settings(derandomize=True, max_examples=250, deadline=None)
@given(variants(COCO))
def test_any_value_in_coco_gives_detections_or_names_its_law(document):
    found = result_or_law(lambda it: from_coco(it, masks=True), document)
    for one in (one for some in (found or {}).values() for one in some):
        assert np.isfinite(one.xyxy).all()


@settings(derandomize=True, max_examples=250, deadline=None)
@given(variants(MEGADETECTOR))
def test_any_value_in_megadetectors_results_gives_detections_or_names_its_law(document):
    result_or_law(from_megadetector, document)


@settings(derandomize=True, max_examples=250, deadline=None)
@given(variants(REKOGNITION))
def test_any_value_in_a_response_of_rekognition_gives_detections_or_names_its_law(document):
    result_or_law(lambda it: from_rekognition(it, image_size=SIZE), document)


MODEL = json.loads(json.dumps(model().to_dict()))
MODEL["priors"] = MODEL["priors"][:3]


@settings(derandomize=True, max_examples=400, deadline=None)
@given(variants(MODEL))
@example({**MODEL, "k": True})
@example({**MODEL, "k": 10**400})
@example({**MODEL, "mse_m2": "0.1"})
@example({**MODEL, "focal_px": "700"})
@example({**MODEL, "image_size": ["640", "480"]})
def test_any_value_in_a_record_of_a_model_gives_a_model_or_names_its_law(document):
    found = result_or_law(ims.ScaleModel.from_dict, document)
    if found is not None:
        text = json.dumps(found.to_dict(), allow_nan=False)
        assert ims.ScaleModel.from_dict(json.loads(text)) == found
        assert str(found)
