"""Files and responses of ill will: one error that names the file and the cause, and soon."""

import io
import json
import os
import struct
import sys
import time
import tracemalloc
import zipfile
import zlib
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import imgscale as ims
from imgscale.depth_sources.files import read_depth, read_values
from imgscale.detectors import (
    from_coco,
    from_megadetector,
    from_pascal_voc,
    from_rekognition,
    from_yolo,
    read_coco,
    read_kitti,
    read_megadetector,
    read_pascal_voc,
    read_yolo,
)
from imgscale.object_prior import ObjectPrior
from imgscale.picture import upright_rgb

SIZE = (640, 480)
READERS = {
    "map.npy": read_values,
    "map.npz": read_values,
    "map.pfm": read_values,
    "map.png": read_values,
    "map.tif": read_values,
    "coco.json": read_coco,
    "mega.json": read_megadetector,
    "voc.xml": read_pascal_voc,
    "kitti.txt": read_kitti,
    "yolo.txt": lambda path: read_yolo(path, image_size=SIZE, class_names=["car"]),
    "priors.csv": ims.PriorTable.from_csv,
    "record.jsonl": ims.read_record,
    "photo.jpg": upright_rgb,
    "exif.jpg": ims.Camera.from_exif,
}
LINES = ("kitti.txt", "yolo.txt")
BOX = {"Left": 0.5, "Top": 0.25, "Width": 0.125, "Height": 0.5}
DATASET = {
    "images": [{"id": 1, "file_name": "a.jpg", "width": 64, "height": 48}],
    "categories": [{"id": 2, "name": "car"}],
    "annotations": [{"image_id": 1, "category_id": 2, "bbox": [1, 2, 30, 40]}],
}
RESULTS = {
    "detection_categories": {"1": "animal"},
    "images": [
        {
            "file": "a.jpg",
            "width": 64,
            "height": 48,
            "detections": [{"category": "1", "conf": 0.9, "bbox": [0.1, 0.2, 0.3, 0.4]}],
        }
    ],
}


def written(folder, name, content):
    path = folder / name
    path.write_bytes(content)
    return path


def npy(shape, descr="'<f4'", data=b"", *, version=1):
    header = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    length = struct.pack("<H" if version == 1 else "<I", len(header))
    return b"\x93NUMPY" + bytes([version, 0]) + length + header + data


def png(width, height, rows=b"", *, depth=16):
    def chunk(name, content):
        check = zlib.crc32(name + content)
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", check)

    header = struct.pack(">IIBBBBB", width, height, depth, 0, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


def zipped(**members):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return file.getvalue()


@contextmanager
def little(most_bytes=20_000_000, most_seconds=5.0):
    """Fail where more memory or time was taken."""
    tracemalloc.start()
    begin = time.perf_counter()
    try:
        yield
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < most_bytes
    assert time.perf_counter() - begin < most_seconds


# --- no regular file, an empty one, one that is missing ---


@pytest.mark.parametrize("name", READERS)
def test_a_folder_in_the_place_of_a_file_is_named(tmp_path, name):
    (tmp_path / name).mkdir()
    with pytest.raises(ims.FileError, match=f"{name} must be a regular file; got a folder"):
        READERS[name](tmp_path / name)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names on this system")
@pytest.mark.parametrize("name", READERS)
def test_a_pipe_that_nobody_writes_to_is_refused_and_not_waited_for(tmp_path, name):
    os.mkfifo(tmp_path / name)
    with pytest.raises(ims.FileError, match=f"{name} must be a regular file; got a pipe"):
        READERS[name](tmp_path / name)


@pytest.mark.parametrize("name", READERS)
def test_a_missing_file_is_the_systems_own_error(tmp_path, name):
    with pytest.raises(FileNotFoundError, match=name):
        READERS[name](tmp_path / name)


@pytest.mark.parametrize("name", [name for name in READERS if name not in LINES])
def test_an_empty_file_is_named(tmp_path, name):
    with pytest.raises(ims.FileError, match=name):
        READERS[name](written(tmp_path, name, b""))


@pytest.mark.parametrize("name", LINES)
def test_an_empty_file_of_lines_holds_no_object(tmp_path, name):
    assert READERS[name](written(tmp_path, name, b"")) == []


@pytest.mark.parametrize("name", READERS)
def test_a_name_that_no_system_has_is_a_file_error(tmp_path, name):
    with pytest.raises(ims.FileError, match="null"):
        READERS[name](tmp_path / f"a\0{name}")


@pytest.mark.parametrize("name", READERS)
def test_a_name_longer_than_the_system_takes_is_a_short_file_error(tmp_path, name):
    with pytest.raises(ims.FileError, match="name too long") as refused:
        READERS[name](tmp_path / ("a" * 5000 + name))
    assert len(str(refused.value)) < 500


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("content", [b"\x80 nothing \x7f" * 50, b"\xff\xfe\0\0", b"\0" * 999])
def test_bytes_that_mean_nothing_are_refused_by_name(tmp_path, name, content):
    with pytest.raises(ims.FileError, match=name) as caught:
        READERS[name](written(tmp_path, name, content))
    assert len(str(caught.value)) < 1500


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have names of text alone")
@pytest.mark.parametrize("name", READERS)
def test_a_file_whose_name_is_no_utf_8_is_read_like_any_other(tmp_path, name):
    path = os.fsdecode(os.fsencode(tmp_path) + b"/\xff\xfe" + name.encode())
    Path(path).write_bytes(b"\0\0\0")
    with pytest.raises(ims.FileError, match=name):
        READERS[name](path)


# --- limits ---


@pytest.mark.parametrize(
    ("name", "content"),
    [
        pytest.param("a.npy", npy("(10**9, 10**9)".replace("10**9", "1000000000")), id="NPY"),
        pytest.param("a.npy", npy("(99999999999999999999, 3)"), id="NPY beyond 64 bits"),
        pytest.param("a.npz", zipped(a=npy("(1000000, 1000000)")), id="NPZ"),
        pytest.param("a.pfm", b"Pf\n4294967296 4294967296\n-1\n", id="PFM beyond 64 bits"),
        pytest.param("a.pfm", b"Pf\n100000 100000\n-1\n" + bytes(64), id="PFM"),
        pytest.param("a.png", png(100_000, 100_000), id="PNG"),
    ],
)
def test_absurd_dimensions_are_refused_before_memory_is_taken(tmp_path, name, content):
    read_values(written(tmp_path, "small.pfm", b"Pf 1 1 -1 \0\0\x80\x3f"))  # imports are done
    path = written(tmp_path, name, content)
    law = r"must hold at most 200000000 values; got \d+ x \d+\. Give a larger `max_pixels`"
    with little(), pytest.raises(ims.FileError, match=rf"{name} {law}"):
        read_values(path, scale=1)


def test_absurd_dimensions_of_a_tiff_are_refused_before_memory_is_taken(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.ones((4, 4), np.float32))
    with tifffile.TiffFile(path, mode="r+b") as tiff:
        for tag in ("ImageWidth", "ImageLength", "RowsPerStrip"):
            tiff.pages[0].tags[tag].overwrite(60_000)
    with little(), pytest.raises(ims.FileError, match="at most 200000000 values; got 60000 x"):
        read_values(path)


@pytest.mark.parametrize("ending", ["npy", "npz", "pfm", "png", "tif"])
def test_the_limit_of_values_is_the_callers_to_set(tmp_path, ending):
    path = tmp_path / f"a.{ending}"
    values = np.full((4, 5), 7.0, np.float32)
    if ending == "npy":
        np.save(path, values)
    elif ending == "npz":
        np.savez(path, values)
    elif ending == "pfm":
        path.write_bytes(b"Pf 5 4 -1\n" + values.tobytes())
    elif ending == "png":
        path.write_bytes(png(5, 4, (b"\0" + values[0].astype(">u2").tobytes()) * 4))
    else:
        pytest.importorskip("tifffile").imwrite(path, values)
    assert (read_values(path, scale=1, max_pixels=20) == 7).all()
    with pytest.raises(ims.FileError, match="at most 19 values; got 5 x 4"):
        read_values(path, scale=1, max_pixels=19)
    with pytest.raises(ims.FileError, match="at most 19 values"):
        read_depth(path, kind="metric", scale=1, max_pixels=19)


@pytest.mark.parametrize(("limit", "kind"), [(0, ValueError), (1e9, TypeError), (True, TypeError)])
def test_a_limit_is_a_whole_number_above_0(tmp_path, limit, kind):
    path = written(tmp_path, "a.json", b"{}")
    with pytest.raises(kind, match="`max_bytes` must be a whole number above 0"):
        read_coco(path, max_bytes=limit)
    with pytest.raises(kind, match="`max_pixels` must be a whole number above 0"):
        read_values(tmp_path / "a.npy", max_pixels=limit)


@pytest.mark.parametrize(
    "name", ["coco.json", "mega.json", "voc.xml", "kitti.txt", "priors.csv", "record.jsonl"]
)
def test_a_longer_file_than_the_limit_is_not_read(tmp_path, name):
    path = tmp_path / name
    with path.open("wb") as file:
        file.truncate(600_000_000)  # takes no place on the disk
    with little(), pytest.raises(ims.FileError, match=rf"{name} must hold at most 500000000 bytes"):
        READERS[name](path)
    with pytest.raises(ims.FileError, match=r"at most 9 bytes; got 600000000.*`max_bytes`"):
        READERS[name](path, max_bytes=9)


def test_a_longer_file_of_yolo_than_the_limit_is_not_read(tmp_path):
    path = written(tmp_path, "a.txt", b"0 0.5 0.5 0.25 0.5")
    options = {"image_size": SIZE, "class_names": ["car"]}
    assert len(read_yolo(path, **options, max_bytes=18)) == 1
    with pytest.raises(ims.FileError, match="at most 17 bytes; got 18"):
        read_yolo(path, **options, max_bytes=17)


def test_a_bomb_of_a_picture_is_refused_by_name(tmp_path):
    path = written(tmp_path, "a.png", png(20_000, 20_000, depth=8))
    with little(), pytest.raises(ims.FileError, match=r"a\.png is too large .*MAX_IMAGE_PIXELS"):
        upright_rgb(path)


def test_a_deflated_strip_of_a_tiff_that_swells_is_refused(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.ones((1, 4), np.float32))
    bomb = zlib.compress(bytes(100_000_000))
    with tifffile.TiffFile(path, mode="r+b") as tiff:
        tags = tiff.pages[0].tags
        tags["StripOffsets"].overwrite(path.stat().st_size)
        tags["StripByteCounts"].overwrite(len(bomb))
        tags["Compression"].overwrite(8)
    with path.open("ab") as file:
        file.write(bomb)
    with little(), pytest.raises(ims.FileError, match=r"a\.tif .*at most 16 bytes; got more"):
        read_values(path)


def test_an_archive_that_holds_more_than_its_array_is_refused(tmp_path):
    content = zipped(a=npy("(1, 2)", data=bytes(100_000_000)))
    with little(), pytest.raises(ims.FileError, match="must take 8 bytes; got more than 8"):
        read_values(written(tmp_path, "a.npz", content))


# --- NumPy's files ---


def test_pickled_objects_are_never_loaded(tmp_path):
    class Harm:
        def __reduce__(self):
            return (os.mkdir, (str(tmp_path / "harm"),))

    np.save(tmp_path / "a.npy", np.array([[Harm()]], dtype=object))
    np.savez(tmp_path / "a.npz", np.array([[Harm()]], dtype=object))
    for name in ("a.npy", "a.npz"):
        with pytest.raises(ims.FileError, match=rf"{name} must hold real numbers; got dtype obj"):
            read_values(tmp_path / name)
    assert not (tmp_path / "harm").exists()


@pytest.mark.parametrize(
    "content",
    [
        pytest.param(npy("(1, 2)", data=bytes(7)), id="cut"),
        pytest.param(npy("(1, 2)", data=bytes(9)), id="too long"),
        pytest.param(npy("(1, -2)", data=bytes(8)), id="negative length"),
        pytest.param(npy("(1, 2)", "[('a', '<f4')]", bytes(8)), id="fields"),
        pytest.param(npy("(1, 2)", "'<U99999999'", bytes(8)), id="text"),
        pytest.param(npy("(1, 2)", "'f4,f4'", bytes(16)), id="types by comma"),
        pytest.param(npy("(1, 2)", "'<f3'", bytes(6)), id="no such type"),
        pytest.param(npy("(" + "1," * 4000 + ")", data=bytes(4)), id="4000 axes"),
        pytest.param(npy("(" + "(" * 3000, data=bytes(4)), id="nested header"),
        pytest.param(npy("('\\d', 2)", data=bytes(8)), id="odd escape"),
        pytest.param(npy("(1, 2)", data=bytes(8), version=2)[:14], id="no header"),
        pytest.param(b"\x93NUMPY\x02\x00\xff\xff\xff\xff", id="header of 4 GB"),
        pytest.param(b"\x93NUMPY\x09\x00" + bytes(99), id="version 9"),
    ],
)
def test_a_broken_array_is_named(tmp_path, content):
    with little(), pytest.raises(ims.FileError, match=r"a\.npy"):
        read_values(written(tmp_path, "a.npy", content))
    with pytest.raises(ims.FileError, match=r"a\.npz"):
        read_values(written(tmp_path, "a.npz", zipped(a=content)))


@pytest.mark.parametrize("version", [(1, 0), (2, 0), (3, 0)])
@pytest.mark.parametrize("order", ["C", "F"])
def test_every_version_and_order_that_numpy_writes_is_read(tmp_path, version, order):
    values = np.arange(1.0, 7.0).reshape((2, 3), order=order)
    with (tmp_path / "a.npy").open("wb") as file:
        np.lib.format.write_array(file, values, version=version)
    np.testing.assert_array_equal(read_values(tmp_path / "a.npy"), values)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_two_arrays_of_one_name_are_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        for value in (b"\0\0\x80\x3f", b"\0\0\0\x40"):
            archive.writestr("a.npy", npy("(1, 1)", data=value))
    for key in (None, "a"):
        with pytest.raises(ims.FileError, match=r"a\.npz .*`key` must be one of its arrays"):
            read_values(tmp_path / "a.npz", key=key)


def test_an_archive_with_a_flipped_bit_is_refused(tmp_path):
    np.savez(tmp_path / "a.npz", np.full((8, 8), 5.0))
    content = bytearray((tmp_path / "a.npz").read_bytes())
    content[content.index(struct.pack("<d", 5.0)) + 7] ^= 1
    with pytest.raises(ims.FileError, match=r"a\.npz .*CRC"):
        read_values(written(tmp_path, "a.npz", bytes(content)))


# --- other maps and pictures ---


@pytest.mark.parametrize("scale", [b"inf", b"-1e999", b"nan", b"1_0", b"0", b"-", b"\xb2"])
def test_a_pfm_with_an_odd_scale_is_refused(tmp_path, scale):
    content = b"Pf\n1 1\n" + scale + b"\n\0\0\x80\x3f"
    with pytest.raises(ims.FileError, match=r"a\.pfm .*its scale"):
        read_values(written(tmp_path, "a.pfm", content))


def test_a_nan_that_signals_is_missing_like_any_other(tmp_path):
    path = written(tmp_path, "a.pfm", b"Pf 2 1 -1 \x01\0\xa0\x7f\0\0\x80\x3f")
    np.testing.assert_array_equal(read_values(path), [[np.nan, 1.0]])


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif"])
def test_a_picture_cut_anywhere_is_refused_by_name(tmp_path, name):
    from PIL import Image  # noqa: PLC0415 - here only

    noise = np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8)
    Image.fromarray(noise).save(tmp_path / name)
    content = (tmp_path / name).read_bytes()
    # the marker behind JPEG's pixels, and the tags behind TIFF's, may be lost
    whole = len(content) - (20 if name == "a.png" else 10)
    for length in range(0, whole, max(1, whole // 60)):
        with pytest.raises(ims.FileError, match=name):
            upright_rgb(written(tmp_path, name, content[:length]))


def test_a_depth_png_with_a_wrong_check_sum_is_refused(tmp_path):
    content = bytearray(png(4, 1, b"\0" + bytes(range(8))))
    content[20] ^= 1
    with pytest.raises(ims.FileError, match=r"a\.png cannot be read as PNG"):
        read_values(written(tmp_path, "a.png", bytes(content)), scale=1)


def test_a_tiff_without_its_values_is_refused(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.ones((4, 4), np.float32))
    with tifffile.TiffFile(path, mode="r+b") as tiff:
        tiff.pages[0].tags["StripByteCounts"].overwrite(0)
    with pytest.raises(ims.FileError, match=r"a\.tif"):
        read_values(path)


def test_a_tiff_that_tells_of_millions_of_strips_and_has_two_is_refused_soon(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.ones((6, 4), np.float32), rowsperstrip=3, compression="zlib")
    assert (read_values(path) == 1).all()
    with tifffile.TiffFile(path, mode="r+b") as tiff:
        tiff.pages[0].tags["ImageLength"].overwrite(40_000_000)
    with little(), pytest.raises(ims.FileError, match=r"a\.tif .*parts of its values are missing"):
        read_values(path)


def test_exif_numbers_without_sense_are_refused_by_name(tmp_path):
    from PIL import ExifTags, Image  # noqa: PLC0415 - here only

    for value in ("fifty", (28, 28), b"\0"):
        exif = Image.Exif()
        exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = value
        Image.new("RGB", (8, 6)).save(tmp_path / "a.jpg", exif=exif)
        with pytest.raises(ValueError, match=r"a\.jpg"):
            ims.Camera.from_exif(tmp_path / "a.jpg")


# --- JSON ---


JSON = {
    "NaN": (b'{"images": NaN}', "NaN, which JSON has no number for"),
    "infinity": (b'{"images": [-Infinity]}', "-Infinity, which"),
    "beyond floats": (b'{"images": [1e999]}', "1e999, which is beyond all floats"),
    "twice": (b'{"images": [], "images": []}', "the name 'images' twice in one object"),
    "deep": (b"[" * 100_000, "too deep a nesting"),
    "deep objects": (b'{"a":' * 100_000, "too deep a nesting"),
    "digits": (b"[" + b"9" * 5000 + b"]", "too long a number"),
    "cut": (b'{"images": [{"id": 1', "Expecting"),
    "not text": (b'{"images": "\xff"}', "a byte at 12 that is no text"),
    "two": (b"{} {}", "Extra data"),
}


@pytest.mark.parametrize("case", JSON)
@pytest.mark.parametrize("read", [read_coco, read_megadetector])
def test_json_that_is_none_is_refused_by_name_and_cause(tmp_path, case, read):
    content, cause = JSON[case]
    with pytest.raises(ims.FileError, match=rf"a\.json must hold JSON; got: .*{cause}"):
        read(written(tmp_path, "a.json", content))


@pytest.mark.parametrize("case", JSON)
def test_a_record_with_a_line_that_is_no_json_is_refused(tmp_path, case):
    content, _ = JSON[case]
    path = written(tmp_path, "a.jsonl", b'{"imgscale": 1, "options": {}}\n' + content + b"\n")
    with pytest.raises(ims.FileError, match=r"a\.jsonl is not, see line 2"):
        ims.read_record(path)


@pytest.mark.parametrize(
    "line",
    [b"7", b"{}", b'{"path": 3}', b'{"path": "a.jpg", "error": "none"}', b'{"error": {}}'],
)
def test_a_record_with_a_line_that_no_run_writes_is_refused(tmp_path, line):
    path = written(tmp_path, "a.jsonl", b'{"imgscale": 1, "options": {}}\n' + line + b"\n")
    with pytest.raises(ims.FileError, match="see line 2"):
        ims.read_record(path)


@pytest.mark.parametrize("schema", [b"true", b"2", b'"1"', b"null"])
def test_a_record_of_another_schema_is_refused(tmp_path, schema):
    content = b'{"imgscale": ' + schema + b', "options": {}}\n'
    with pytest.raises(ims.FileError, match="see line 1"):
        ims.read_record(written(tmp_path, "a.jsonl", content))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-32"])
def test_json_is_read_in_every_encoding_of_its_standard(tmp_path, encoding):
    path = written(tmp_path, "a.json", json.dumps(DATASET).encode(encoding))
    assert read_coco(path) == from_coco(DATASET)


@pytest.mark.parametrize(
    "change",
    [
        {"bbox": ["1", 2, 30, 40]},
        {"bbox": [True, 2, 30, 40]},
        {"bbox": [1, 2, 10**400, 40]},
        {"bbox": [[1], 2, 30, 40]},
        {"bbox": {"x": list(range(9999))}},
        {"bbox": "x" * 10**6},
        {"image_id": True},
        {"image_id": ["x" * 10**6]},
        {"category_id": 2.0},
        {"category_id": "y" * 10**6},
        {"score": "0.9"},
        {"score": True},
        {"score": 10**400},
        {"iscrowd": "0"},
        {"iscrowd": [0]},
    ],
    ids=lambda change: next(iter(change)),
)
def test_words_and_truth_values_are_no_numbers_of_coco(change):
    entry = DATASET["annotations"][0] | change
    with pytest.raises((TypeError, ValueError), match=r"^annotations\[0\]: ") as caught:
        from_coco({**DATASET, "annotations": [entry]})
    assert len(str(caught.value)) < 1500


@pytest.mark.parametrize(
    "change",
    [
        {"conf": "0.9"},
        {"conf": True},
        {"bbox": ["0.1", 0.2, 0.3, 0.4]},
        {"bbox": [0.1, 0.2, 0.3, True]},
        {"category": True},
        {"category": ["1"]},
        {"classifications": [["1", "0.9"]]},
        {"classifications": [["1", True]]},
        {"classifications": [["1", float("nan")]]},
        {"classifications": ["19"]},
        {"classifications": [{"1": 1, "2": 2}]},
    ],
    ids=str,
)
def test_words_and_truth_values_are_no_numbers_of_megadetector(change):
    data = json.loads(json.dumps(RESULTS)) | {"classification_categories": {"1": "fox"}}
    data["images"][0]["detections"][0] |= change
    with pytest.raises((TypeError, ValueError), match=r"^images\[0\]: detections\[0\]: "):
        from_megadetector(data)


@pytest.mark.parametrize("value", ["0.5", True, None, float("nan"), 10**400, [0.5], {}])
def test_words_and_truth_values_are_no_ratios_of_rekognition(value):
    instance = {"BoundingBox": {**BOX, "Left": value}}
    with pytest.raises((TypeError, ValueError), match=r"Labels\[0\]\.Instances\[0\]"):
        from_rekognition({"Labels": [{"Name": "Car", "Instances": [instance]}]}, image_size=SIZE)


def test_a_name_of_results_that_leaves_the_folder_of_pictures_is_not_followed(tmp_path):
    from PIL import Image  # noqa: PLC0415 - here only

    (tmp_path / "photos").mkdir()
    Image.new("RGB", (64, 48)).save(tmp_path / "secret.png")
    Image.new("RGB", (64, 48)).save(tmp_path / "photos" / "a.png")
    entry = {"detections": RESULTS["images"][0]["detections"]}
    outside = (
        "../secret.png",
        "..\\secret.png",
        str(tmp_path / "secret.png"),
        "b/../../secret.png",
    )
    for file in (*outside, "a.png", str(tmp_path / "photos" / "a.png")):
        data = {**RESULTS, "images": [{**entry, "file": file}]}
        path = written(tmp_path, "a.json", json.dumps(data).encode())
        if file in outside:
            with pytest.raises(ims.FileError, match=r"a\.json: .*must lie in the folder"):
                read_megadetector(path, image_folder=tmp_path / "photos")
        else:
            assert len(read_megadetector(path, image_folder=tmp_path / "photos")) == 1


# --- masks ---


def with_mask(segmentation, size=(64, 48)):
    image = {"id": 1, "file_name": "a.jpg", "width": size[0], "height": size[1]}
    entry = DATASET["annotations"][0] | {"segmentation": segmentation}
    return {**DATASET, "images": [image], "annotations": [entry, entry]}


def test_masks_of_a_picture_of_any_size_do_not_fill_the_memory():
    shape = [[1, 2, 30, 2, 30, 40]]
    with little(), pytest.raises(ValueError, match="`max_mask_bytes`; 4000000000 are left"):
        from_coco(with_mask(shape, (10**6, 10**6)), masks=True)
    limit = 64 * 48
    with pytest.raises(ValueError, match=r"annotations\[1\]: .*`max_mask_bytes`; 0 are left"):
        from_coco(with_mask(shape), masks=True, max_mask_bytes=limit)
    (found,) = from_coco(with_mask(shape), masks=True, max_mask_bytes=2 * limit).values()
    assert [one.mask.shape for one in found] == [(48, 64)] * 2


@pytest.mark.parametrize(
    "counts",
    ["o" * 10**6, "o" * 13 + "0", [64 * 48 + 1, -1], [True, 64 * 48 - 1], [10**30], ["3072"]],
    ids=["no end", "too long", "negative", "truth value", "huge", "text"],
)
def test_run_lengths_without_sense_are_refused_soon(counts):
    data = with_mask({"size": [48, 64], "counts": counts})
    with little(most_seconds=2.0), pytest.raises(ValueError, match=r"annotations\[0\]: `counts`"):
        from_coco(data, masks=True)


# --- XML ---


LAUGHS = "".join(f'<!ENTITY l{n + 1} "{f"&l{n};" * 10}">' for n in range(9))
XML = {
    "laughs": f'<!DOCTYPE a [<!ENTITY l0 "ha">{LAUGHS}]><annotation>&l9;</annotation>',
    "external": '<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]><annotation>&x;</annotation>',
    "elsewhere": '<!DOCTYPE annotation SYSTEM "http://127.0.0.1:9/x.dtd"><annotation/>',
}


@pytest.mark.parametrize("case", XML)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_a_document_type_is_refused_before_its_entities_count(tmp_path, case, encoding):
    path = written(tmp_path, "a.xml", XML[case].encode(encoding))
    with little(), pytest.raises(ims.FileError, match=r"a\.xml: .*DOCTYPE"):
        read_pascal_voc(path)


@pytest.mark.parametrize(
    ("content", "cause"),
    [
        (b"<annotation>" + b"<a>" * 200_000, "well-formed"),
        (b"<annotation><object>", "well-formed"),
        (b'<?xml version="1.0" encoding="no-such"?><annotation/>', "well-formed"),
        (b'<?xml version="1.0" encoding="utf-8"?><annotation>\xff</annotation>', "well-formed"),
        (b"<annotation>\0</annotation>", "well-formed"),
        (b"<" + b"a" * 10**6 + b"/>", "must be an <annotation>"),
        (b"<annotation>&undefined;</annotation>", "well-formed"),
    ],
    ids=["deep", "cut", "encoding", "bytes", "NUL", "long name", "entity"],
)
def test_xml_that_is_none_is_refused_by_name(tmp_path, content, cause):
    with pytest.raises(ims.FileError, match=rf"a\.xml: .*{cause}") as caught:
        read_pascal_voc(written(tmp_path, "a.xml", content))
    assert len(str(caught.value)) < 1500


def test_xml_of_a_million_levels_that_close_is_read_or_refused():
    deep = "<a>" * 200_000 + "</a>" * 200_000
    assert from_pascal_voc(f"<annotation>{deep}</annotation>") == []


# --- numbers in text ---


@pytest.mark.parametrize(
    "word", ["1_0", "\u0661", "\uff11", "nan", "inf", "0x1", "1e999", "1,5", ""]
)
def test_what_only_python_takes_for_a_number_is_none(tmp_path, word):
    columns = f"Car 0 0 1.9 388 182 {word or '-'} 203 1.67 1.87 3.69 -16.5 2.4 58.5 1.57"
    with pytest.raises(ims.FileError, match=r"a\.txt: line 1: "):
        read_kitti(written(tmp_path, "a.txt", columns.encode()))
    with pytest.raises(ValueError, match=r"^line 1: "):
        from_yolo(f"0 0.5 0.5 0.25 {word or '-'}", image_size=SIZE, class_names=["car"])
    with pytest.raises(ValueError, match=r"^line 1: "):
        from_yolo(f"{word or '-'} 0.5 0.5 0.25 0.5", image_size=SIZE, class_names=["car"])
    corners = f"<xmin>{word}</xmin><ymin>1</ymin><xmax>999</xmax><ymax>99</ymax>"
    with pytest.raises(ValueError, match=r"^object\[0\]: <xmin> must be a finite number"):
        from_pascal_voc(
            f"<annotation><object><name>a</name><bndbox>{corners}</bndbox></object></annotation>"
        )
    row = f'label,mean_m,std_m\npole,"{word}",0.1\n'.encode()
    with pytest.raises(ims.FileError, match=r"a\.csv must hold lawful rows; got 1 bad: line 2"):
        ims.PriorTable.from_csv(written(tmp_path, "a.csv", row))


# --- tables ---


@pytest.mark.parametrize(
    ("content", "cause"),
    [
        (b'label,mean_m,std_m\n"' + b"x" * 200_000 + b'",1,1\n', "field larger than"),
        (b"label,mean_m,std_m\npole,1,0.1\n\xff", "must be UTF-8; got byte 0xff at 30"),
        (b"label,mean_m,std_m,label\n", "each column once"),
        (b"a" * 10**5 + b"\n", "must have the columns"),
        (b"label,mean_m,std_m\n" + b"pole,0,1\n" * 5000, "got 5000 bad: .* and 4900 more"),
        (b"label,mean_m,std_m,year\npole,1,0.1," + b"9" * 5000, "`year` must be a whole number"),
        (b"label,mean_m,std_m\n" + b"x" * 5000 + b",1,0.1\n", "at most 1000 characters"),
    ],
    ids=["field", "bytes", "twice", "columns", "rows", "digits", "label"],
)
def test_a_table_that_is_none_is_refused_by_name(tmp_path, content, cause):
    with pytest.raises(ims.FileError, match=rf"a\.csv .*{cause}") as caught:
        ims.PriorTable.from_csv(written(tmp_path, "a.csv", content))
    assert len(str(caught.value)) < 20_000


def test_names_that_contradict_are_told_with_the_file(tmp_path):
    content = b"label,aliases,mean_m,std_m\npole,rod,1,0.1\nmast,rod,2,0.1\n"
    with pytest.raises(ims.FileError, match=r'a\.csv: .*"rod" for "pole"'):
        ims.PriorTable.from_csv(written(tmp_path, "a.csv", content))


# --- labels ---


def test_a_label_has_at_most_a_thousand_characters():
    assert ims.Detection("x" * 1000, (1, 2, 3, 4)).label == "x" * 1000
    longest = "x" * 10**8
    for make in (
        lambda: ims.Detection(longest, (1, 2, 3, 4)),
        lambda: ims.Detection("a", (1, 2, 3, 4), aliases=[longest]),
        lambda: ObjectPrior(longest, 1.0, 0.1),
    ):
        with pytest.raises(ValueError, match="at most 1000 characters; got 100000000") as caught:
            make()
        assert len(str(caught.value)) < 1500


def test_errors_cut_what_they_quote_of_a_response():
    long = "x" * 10**7
    responses = (
        {"Labels": [{"Name": long, "Instances": [{"BoundingBox": BOX}]}]},
        {"Labels": [{"Name": " " * 10**7, "Instances": [{"BoundingBox": BOX}]}]},
        {"Labels": [{"Name": "a", "Aliases": [[long]], "Instances": [{"BoundingBox": BOX}]}]},
        {long: 1},
    )
    for response in responses:
        with pytest.raises((TypeError, ValueError)) as caught:
            from_rekognition(response, image_size=SIZE)
        assert len(str(caught.value)) < 1500


def test_a_file_error_is_a_value_error_and_pickles():
    import pickle  # noqa: PLC0415 - here only

    error = pickle.loads(pickle.dumps(ims.FileError("a.png: broken")))  # noqa: S301 - our own
    assert isinstance(error, (ims.ImgscaleError, ValueError))
    assert str(error) == "a.png: broken"
