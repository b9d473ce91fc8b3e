"""Depth files: what is read of each format, bit for bit, and what is refused."""

import os
import re
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from imgscale import Camera, DepthMap
from imgscale.depth_sources.files import read_depth, read_values

DATA = Path(
    os.environ.get("IMGSCALE_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data"
)
LIDAR = DATA / "kitti" / "object" / "training" / "lidar_depth" / "000008.png"
DISPARITY = DATA / "kitti" / "scene_flow_2015" / "training" / "disp_occ_0" / "000046_10.png"
MILLIMETRES = DATA / "unidepth_demo" / "depth.png"
NYU = DATA / "nyuv2_sample" / "Depth" / "0.npy"
PFM = DATA / "middlebury2014" / "Motorcycle" / "disp0GT.pfm"


def needs(path):
    return pytest.mark.skipif(not path.is_file(), reason=f"no {path}")


# no two rows, columns or bytes alike, and a missing pixel
COUNTS = np.array([[0, 1, 255, 256], [257, 5120, 30000, 40000], [65535, 2, 3, 4]], dtype=np.uint16)
FLOATS = COUNTS.astype(np.float32) + np.float32(0.25)


def png(values, *, colour_type=0):
    """Encode big-endian 16-bit samples by the PNG specification, with no filter."""
    height, width = values.shape[:2]
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in values)

    def chunk(name, content):
        check = zlib.crc32(name + content)
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", check)

    header = struct.pack(">IIBBBBB", width, height, 16, colour_type, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


def pfm(values, *, byte_order="<", scale=1.0, line_end=b"\n"):
    height, width = values.shape[:2]
    sign = -1 if byte_order == "<" else 1
    lines = (
        b"Pf" if values.ndim == 2 else b"PF",
        f"{width} {height}".encode(),
        f"{sign * scale}".encode(),
    )
    header = b"".join(line + line_end for line in lines)
    return header + values[::-1].astype(f"{byte_order}f4").tobytes()


def written(folder, name, content):
    path = folder / name
    path.write_bytes(content)
    return path


def saved(folder, name, array):
    path = folder / name
    np.save(path, array)
    return path


def without_zeros(values):
    return np.where(values > 0, values, np.nan).astype(np.float64)


# --- PNG ---


def test_a_16_bit_png_is_divided_by_its_scale_and_0_is_missing(tmp_path):
    path = written(tmp_path, "depth.png", png(COUNTS))
    values = read_values(path, scale=256)
    assert values.dtype == np.float64
    np.testing.assert_array_equal(values, without_zeros(COUNTS / 256))


@pytest.mark.parametrize(
    ("path", "scale"),
    [
        pytest.param(LIDAR, 256, id="KITTI LiDAR", marks=needs(LIDAR)),
        pytest.param(DISPARITY, 256, id="KITTI disparity", marks=needs(DISPARITY)),
        pytest.param(MILLIMETRES, 1000, id="millimetres", marks=needs(MILLIMETRES)),
    ],
)
def test_real_png_files_are_read_as_opencv_reads_them(path, scale):
    cv2 = pytest.importorskip("cv2")
    theirs = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert theirs.dtype == np.uint16
    np.testing.assert_array_equal(read_values(path, scale=scale), without_zeros(theirs / scale))


def test_8_bit_pictures_are_refused(tmp_path):
    from PIL import Image  # noqa: PLC0415 - here only

    grey = Image.fromarray((COUNTS % 256).astype(np.uint8))
    for mode in ("L", "P"):
        grey.convert(mode).save(tmp_path / "depth.png")
        with pytest.raises(ValueError, match=r"depth\.png must hold more than 8 bits .* uint8"):
            read_values(tmp_path / "depth.png", scale=256)
    grey.convert("1").save(tmp_path / "depth.png")
    with pytest.raises(ValueError, match=r"depth\.png must hold real numbers; got dtype bool"):
        read_values(tmp_path / "depth.png", scale=256)


def test_colour_of_8_or_16_bits_is_refused(tmp_path):
    from PIL import Image  # noqa: PLC0415 - here only

    colour = np.stack([COUNTS] * 3, axis=2)
    written(tmp_path, "16.png", png(colour, colour_type=2))
    Image.fromarray((colour % 256).astype(np.uint8)).save(tmp_path / "8.png")
    for name in ("16.png", "8.png"):
        with pytest.raises(
            ValueError, match=r"must hold one channel, \(H, W\); got shape \(3, 4, "
        ):
            read_values(tmp_path / name, scale=256)


def test_a_jpeg_that_calls_itself_png_is_refused(tmp_path):
    from PIL import Image  # noqa: PLC0415 - here only

    Image.new("L", (8, 8)).save(tmp_path / "depth.png", format="JPEG")
    with pytest.raises(ValueError, match=r"depth\.png cannot be read as PNG"):
        read_values(tmp_path / "depth.png", scale=256)


# --- NumPy ---


@pytest.mark.parametrize("dtype", ["<f2", "<f4", ">f4", "<f8", ">f8"])
def test_floats_of_every_size_and_byte_order_are_kept(dtype, tmp_path):
    stored = (COUNTS % 1000 + 0.5).astype(dtype)
    values = read_values(saved(tmp_path, "depth.npy", stored))
    np.testing.assert_array_equal(values, stored.astype(np.float64))
    assert values.dtype == np.float64


@pytest.mark.parametrize("dtype", ["u2", ">u2", "i2", "i4", "u4", "i8"])
def test_integers_of_every_size_need_a_scale(dtype, tmp_path):
    stored = np.array([[0, 1000], [2500, 32000]]).astype(dtype)
    path = saved(tmp_path, "depth.npy", stored)
    np.testing.assert_array_equal(read_values(path, scale=1000), [[np.nan, 1.0], [2.5, 32.0]])
    with pytest.raises(
        ValueError, match=r"`scale` must be given.*KITTI 256, millimetres 1000, TUM"
    ):
        read_values(path)


@pytest.mark.parametrize("kind", ["relative", "inverse", "affine_inverse"])
def test_integers_that_are_known_up_to_a_factor_need_no_scale(kind, tmp_path):
    path = saved(tmp_path, "depth.npy", np.array([[1000, 2500]], dtype=np.uint16))
    np.testing.assert_array_equal(read_depth(path, kind=kind).values, [[1000.0, 2500.0]])
    np.testing.assert_array_equal(read_depth(path, kind=kind, scale=10).values, [[100.0, 250.0]])
    with pytest.raises(ValueError, match="`scale` must be given"):
        read_depth(path, kind="metric")


def test_negative_integers_are_missing_as_opencvs_matcher_stores_them(tmp_path):
    path = saved(tmp_path, "disparity.npy", np.array([[-16, 320]], dtype=np.int16))
    np.testing.assert_array_equal(read_values(path, scale=16), [[np.nan, 20.0]])


def test_infinite_floats_are_missing_and_negative_ones_stay(tmp_path):
    path = saved(tmp_path, "depth.npy", np.array([[np.inf, -np.inf, np.nan, -1.0, 0.0]]))
    np.testing.assert_array_equal(read_values(path), [[np.nan, np.nan, np.nan, -1.0, 0.0]])


def test_a_scale_divides_floats_too(tmp_path):
    path = saved(tmp_path, "millimetres.npy", np.array([[2500.0]], dtype=np.float32))
    np.testing.assert_array_equal(read_values(path, scale=1000), [[2.5]])


@pytest.mark.parametrize(
    ("array", "message"),
    [
        pytest.param(np.array([[{}]], dtype=object), "got dtype object", id="pickled objects"),
        pytest.param(np.ones((1, 4, 5)), r"got shape \(1, 4, 5\)", id="three axes"),
        pytest.param(np.ones(4), r"got shape \(4,\)", id="one axis"),
        pytest.param(np.ones((0, 4)), r"got shape \(0, 4\)", id="no row"),
        pytest.param(np.ones((2, 2), dtype=complex), "got dtype complex128", id="complex"),
        pytest.param(np.ones((2, 2), dtype=bool), "got dtype bool", id="truth values"),
        pytest.param(np.array([["a"]]), "got dtype <U1", id="text"),
        pytest.param(np.ones((2, 2), dtype=np.uint8), "more than 8 bits", id="8 bits"),
    ],
)
def test_arrays_that_are_no_map_are_refused_by_file(array, message, tmp_path):
    path = saved(tmp_path, "depth.npy", array)
    with pytest.raises(ValueError, match=rf"depth\.npy .*{message}"):
        read_values(path, scale=1)


def test_the_only_array_of_an_archive_is_read_and_one_of_several_by_its_name(tmp_path):
    np.savez(tmp_path / "one.npz", FLOATS)
    np.savez_compressed(tmp_path / "two.npz", depth=FLOATS, colour=np.array([{}], dtype=object))
    np.testing.assert_array_equal(read_values(tmp_path / "one.npz"), FLOATS)
    np.testing.assert_array_equal(read_values(tmp_path / "two.npz", key="depth"), FLOATS)
    for key in (None, "Depth"):
        message = rf"`key` must be one of its arrays, colour, depth; got {key!r}"
        with pytest.raises(ValueError, match=message):
            read_values(tmp_path / "two.npz", key=key)


def test_scikit_images_own_archive_gives_its_motorcycle():
    ski = pytest.importorskip("skimage")
    archive = Path(ski.__file__).parent / "data" / "motorcycle_disp.npz"
    _, _, disparity = ski.data.stereo_motorcycle()
    theirs = np.where(np.isfinite(disparity), disparity, np.nan)
    np.testing.assert_array_equal(read_values(archive), theirs)


def test_a_key_for_a_file_without_names_is_refused(tmp_path):
    path = saved(tmp_path, "depth.npy", FLOATS)
    with pytest.raises(ValueError, match=r"`key` must be omitted but for \.npz files; got 'a'"):
        read_values(path, key="a")


@needs(NYU)
def test_nyus_depth_in_metres_is_a_map_at_once():
    depth = read_depth(NYU, kind="metric")
    np.testing.assert_array_equal(depth.values, np.load(NYU))
    assert depth.image_size == (640, 480)


# --- PFM ---


@pytest.mark.parametrize("byte_order", ["<", ">"])
@pytest.mark.parametrize("line_end", [b"\n", b"\r\n", b" "], ids=["unix", "windows", "one line"])
def test_a_pfm_is_turned_the_right_way_up(byte_order, line_end, tmp_path):
    content = pfm(FLOATS, byte_order=byte_order, line_end=line_end)
    values = read_values(written(tmp_path, "disp.pfm", content))
    np.testing.assert_array_equal(values, FLOATS)


def test_data_that_begin_like_white_space_are_not_taken_for_the_header(tmp_path):
    stored = np.frombuffer(b"\n\n\r\n \t\n ", dtype="<f4").reshape(1, 2)
    values = read_values(written(tmp_path, "disp.pfm", pfm(stored)))
    np.testing.assert_array_equal(values, stored)


def test_a_pfm_that_opencv_wrote_is_read(tmp_path):
    cv2 = pytest.importorskip("cv2")
    assert cv2.imwrite(str(tmp_path / "disp.pfm"), FLOATS)
    np.testing.assert_array_equal(read_values(tmp_path / "disp.pfm"), FLOATS)


@needs(PFM)
def test_middleburys_disparity_is_what_opencv_reads_but_for_the_headers_scale():
    # the header says -0.003922, 1 / 255, by which OpenCV divides; calib.txt says 7 to 65 px
    cv2 = pytest.importorskip("cv2")
    theirs = cv2.imread(str(PFM), cv2.IMREAD_UNCHANGED) * 0.003922
    ours = read_values(PFM)
    np.testing.assert_allclose(ours, np.where(np.isfinite(theirs), theirs, np.nan), rtol=1e-6)


@needs(PFM)
def test_middleburys_disparity_lies_in_the_range_of_its_calibration():
    calibration = dict(
        line.split("=") for line in PFM.with_name("calib.txt").read_text().split("\n") if line
    )
    disparity = read_values(PFM)
    assert disparity.shape == (int(calibration["height"]), int(calibration["width"]))
    assert float(calibration["vmin"]) <= np.nanmin(disparity)
    assert np.nanmax(disparity) <= float(calibration["vmax"])
    assert 0.9 < np.isfinite(disparity).mean() < 1  # missing values are inf there


@pytest.mark.parametrize(
    ("content", "message"),
    [
        pytest.param(pfm(FLOATS)[:-1], "4 x 3 values must take 48 bytes; got 47", id="cut"),
        pytest.param(pfm(FLOATS) + b"\n", "must take 48 bytes; got more than 48", id="too long"),
        pytest.param(b"P5\n4 3\n255\n" + bytes(12), "must begin with Pf", id="PGM"),
        pytest.param(
            b"Pf\n4 3\nlittle\n" + bytes(48), "must be a number .* got little", id="no scale"
        ),
        pytest.param(pfm(FLOATS, scale=0.0), "must not be 0; got -0.0", id="scale 0"),
        pytest.param(pfm(FLOATS, scale=np.nan), "must not be 0; got nan", id="scale NaN"),
        pytest.param(b"", "must begin with Pf", id="empty"),
        pytest.param(pfm(np.dstack([FLOATS] * 3)), r"got shape \(3, 4, 3\)", id="colour"),
    ],
)
def test_what_is_no_grey_pfm_is_refused(content, message, tmp_path):
    path = written(tmp_path, "disp.pfm", content)
    with pytest.raises(ValueError, match=rf"disp\.pfm .*{message}"):
        read_values(path)


# --- TIFF ---


def test_a_float_tiff_that_pillow_wrote_is_read(tmp_path):
    from PIL import Image  # noqa: PLC0415 - here only

    Image.fromarray(FLOATS).save(tmp_path / "depth.tif")
    np.testing.assert_array_equal(read_values(tmp_path / "depth.tif"), FLOATS)


def test_a_double_tiff_that_opencv_wrote_is_read(tmp_path):
    cv2 = pytest.importorskip("cv2")
    assert cv2.imwrite(str(tmp_path / "depth.tiff"), FLOATS.astype(np.float64))
    np.testing.assert_array_equal(read_values(tmp_path / "depth.tiff"), FLOATS)


@pytest.mark.parametrize("dtype", ["f2", "f4", ">f4", "f8"])
def test_floats_of_every_size_are_read_from_tiff(dtype, tmp_path):
    tifffile = pytest.importorskip("tifffile")
    stored = (COUNTS % 1000 + 0.5).astype(dtype)
    tifffile.imwrite(tmp_path / "depth.tif", stored)
    np.testing.assert_array_equal(read_values(tmp_path / "depth.tif"), stored)


@pytest.mark.parametrize("dtype", ["u2", "u4"])
def test_integers_in_tiff_need_a_scale(dtype, tmp_path):
    tifffile = pytest.importorskip("tifffile")
    tifffile.imwrite(tmp_path / "depth.tif", COUNTS.astype(dtype))
    values = read_values(tmp_path / "depth.tif", scale=5000)
    np.testing.assert_array_equal(values, without_zeros(COUNTS / 5000))
    with pytest.raises(ValueError, match=r"`scale` must be given, as .*depth\.tif holds integers"):
        read_values(tmp_path / "depth.tif")


def test_a_tiff_of_several_pages_is_refused(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    tifffile.imwrite(tmp_path / "depth.tif", np.stack([FLOATS] * 5), photometric="minisblack")
    with pytest.raises(ValueError, match=r"one channel, \(H, W\); got shape \(5, 3, 4\)"):
        read_values(tmp_path / "depth.tif")


# --- any file ---


@pytest.mark.parametrize("name", ["depth.png", "depth.npy", "depth.npz", "depth.pfm", "depth.tif"])
def test_a_missing_file_is_not_found_and_a_broken_one_is_named(name, tmp_path):
    with pytest.raises(FileNotFoundError, match=re.escape(name)):
        read_values(tmp_path / name, scale=1)
    for content in (b"", b"hello", png(COUNTS)[:50], b"\x93NUMPY\x01\0", b"PK\x03\x04", b"II*\0"):
        path = written(tmp_path, name, content)
        with pytest.raises(ValueError, match=re.escape(f"{name} cannot be read as ")):
            read_values(path, scale=1)


@pytest.mark.parametrize("name", ["depth.exr", "depth", "depth.png.gz"])
def test_another_ending_is_refused_with_the_list(name):
    listed = r"must end in \.npy, \.npz, \.pfm, \.png, \.tif or \.tiff"
    with pytest.raises(ValueError, match=listed):
        read_values(name)


def test_endings_in_capitals_and_paths_as_text_are_read(tmp_path):
    path = written(tmp_path, "DEPTH.PNG", png(COUNTS))
    np.testing.assert_array_equal(read_values(str(path), scale=1), without_zeros(COUNTS))


@pytest.mark.parametrize("scale", [0, -256, float("nan"), "256", True])
def test_a_scale_that_is_no_positive_number_is_refused(scale, tmp_path):
    path = written(tmp_path, "depth.png", png(COUNTS))
    with pytest.raises((ValueError, TypeError), match="`scale` must be finite and positive; got "):
        read_values(path, scale=scale)


# --- into a map ---


def test_a_map_takes_kind_image_size_and_error_of_scale(tmp_path):
    path = written(tmp_path, "depth.png", png(COUNTS))
    depth = read_depth(path, kind="metric", scale=1000, image_size=(8, 6), scale_rel_std=0.1)
    np.testing.assert_array_equal(depth.values, without_zeros(COUNTS / 1000))
    assert (depth.kind, depth.image_size, depth.scale_rel_std) == ("metric", (8, 6), 0.1)


def test_disparity_and_distance_along_the_ray_go_through_the_maps_own_constructors(tmp_path):
    path = written(tmp_path, "disparity.png", png(COUNTS))
    disparity = read_values(path, scale=256)
    depth = DepthMap.from_disparity(disparity, focal_px=700.0, baseline_m=0.5)
    np.testing.assert_allclose(depth.values, 350 / without_zeros(COUNTS / 256), rtol=1e-12)
    camera = Camera(2.0, focal_rel_std=0.0)
    z = DepthMap.from_ray_distance(read_values(path, scale=256), camera).values
    # the pixel in row 1, column 2 is half a pixel right of the centre: 1 / sqrt(1 + 0.25**2)
    assert z[1, 2] == pytest.approx(30000 / 256 / (1 + 0.0625) ** 0.5, rel=1e-12)


def test_the_kind_is_always_said(tmp_path):
    with pytest.raises(TypeError, match="kind"):
        read_depth(tmp_path / "depth.png", scale=256)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kind": "depth"}, "`kind` must be one of"),
        ({"kind": "metric", "image_size": (3, 4)}, "`image_size` must be"),
        ({"kind": "metric", "scale_rel_std": -1.0}, "`scale_rel_std` must be"),
    ],
    ids=["kind", "transposed size", "negative error"],
)
def test_what_a_map_refuses_is_refused_by_file(options, message, tmp_path):
    path = saved(tmp_path, "depth.npy", FLOATS)
    with pytest.raises(ValueError, match=message):
        read_depth(path, **options)


def test_a_map_without_any_value_is_refused_by_file(tmp_path):
    path = written(tmp_path, "depth.png", png(np.zeros((3, 4), dtype=np.uint16)))
    with pytest.raises(
        ValueError, match=r"depth\.png: `values` must hold a finite, positive number"
    ):
        read_depth(path, kind="metric", scale=256)
