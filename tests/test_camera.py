"""The camera, its EXIF record, and the noise of boxes and depths."""

import math
import pickle
import re

import attrs
import numpy as np
import pytest
from PIL import ExifTags, Image

from imgscale import Camera, Noise

FULL_FRAME_DIAGONAL_MM = 43.2666  # sqrt(36^2 + 24^2), as printed in any photo handbook


def write_photo(path, size, *, f35=None, orientation=None, taken=None):
    """Write a photo as a phone would, with only the EXIF tags asked for."""
    exif = Image.Exif()
    if orientation is not None:
        exif[ExifTags.Base.Orientation] = orientation
    record = {}
    if f35 is not None:
        record[ExifTags.Base.FocalLengthIn35mmFilm] = f35
    if taken is not None:
        tags = (ExifTags.Base.ExifImageWidth, ExifTags.Base.ExifImageHeight)
        record.update(
            {tag: side for tag, side in zip(tags, taken, strict=True) if side is not None}
        )
    if record:
        exif[ExifTags.IFD.Exif] = record
    Image.new("RGB", size, "grey").save(path, exif=exif)
    return path


# --- Camera ---


def test_camera_keeps_its_numbers():
    camera = Camera(
        721.5, focal_rel_std=0.01, cx=609.6, cy=172.9, image_size=(1242, 375), pitch_deg=-2.0,
        pitch_std_deg=0.5,
    )  # fmt: skip
    assert (camera.focal_px, camera.focal_rel_std) == (721.5, 0.01)
    assert (camera.cx, camera.cy) == (609.6, 172.9)
    assert camera.image_size == (1242, 375)
    assert (camera.pitch_deg, camera.pitch_std_deg) == (-2.0, 0.5)


def test_only_the_focal_length_and_its_error_are_needed():
    camera = Camera(721.5, focal_rel_std=0.0)
    assert (camera.cx, camera.cy, camera.image_size) == (None, None, None)
    assert (camera.pitch_deg, camera.pitch_std_deg) == (0.0, 0.0)


def test_focal_error_must_be_said():
    with pytest.raises(TypeError, match="focal_rel_std"):
        Camera(721.5)


def test_camera_takes_one_positional_argument():
    with pytest.raises(TypeError, match="positional"):
        Camera(721.5, 0.0)


@pytest.mark.parametrize("number", [int, np.float32, np.float64, np.int64, np.uint16, np.float16])
def test_numpy_numbers_become_python_floats(number):
    camera = Camera(
        number(512), focal_rel_std=number(0), cx=number(3), cy=number(4), pitch_deg=number(1),
        pitch_std_deg=number(2),
    )  # fmt: skip
    numbers = attrs.astuple(camera, filter=lambda attribute, _: attribute.name != "image_size")
    assert numbers == (512.0, 0.0, 3.0, 4.0, 1.0, 2.0)
    assert {type(value) for value in numbers} == {float}


def test_cameras_are_equal_by_value_hashable_and_pickle():
    one, other = (Camera(700, focal_rel_std=0.0, image_size=(4, 3)) for _ in range(2))
    assert one == other
    assert hash(one) == hash(other)
    assert one != Camera(701, focal_rel_std=0.0, image_size=(4, 3))
    assert pickle.loads(pickle.dumps(one)) == one  # noqa: S301 - our own bytes


def test_camera_cannot_be_set():
    camera = Camera(700.0, focal_rel_std=0.0)
    with pytest.raises(attrs.exceptions.FrozenInstanceError):
        camera.focal_px = 800.0


@pytest.mark.parametrize("value", [0.0, -721.5, math.nan, math.inf, 0])
def test_focal_length_that_is_not_positive_is_refused(value):
    with pytest.raises(ValueError, match=r"`focal_px` must be finite and positive; got "):
        Camera(value, focal_rel_std=0.0)


@pytest.mark.parametrize("name", ["focal_rel_std", "pitch_std_deg"])
@pytest.mark.parametrize("value", [-0.1, math.nan, math.inf])
def test_unlawful_standard_error_is_refused(name, value):
    options = {"focal_rel_std": 0.0, name: value}
    with pytest.raises(ValueError, match=f"`{name}` must be finite and not negative; got {value}"):
        Camera(700.0, **options)


@pytest.mark.parametrize("name", ["cx", "cy", "pitch_deg"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_number_that_is_not_finite_is_refused(name, value):
    with pytest.raises(ValueError, match=f"`{name}` must be finite; got {value}"):
        Camera(700.0, focal_rel_std=0.0, **{name: value})


@pytest.mark.parametrize("name", ["focal_px", "focal_rel_std", "cx", "cy", "pitch_deg"])
@pytest.mark.parametrize("value", ["700", True, [700.0], 3j])
def test_value_that_is_no_number_is_a_type_error(name, value):
    options = {"focal_px": 700.0, "focal_rel_std": 0.0, name: value}
    with pytest.raises(TypeError, match=re.escape(f"got {value!r}")) as caught:
        Camera(**options)
    assert f"`{name}` must be" in str(caught.value)


@pytest.mark.parametrize("name", ["focal_px", "focal_rel_std", "pitch_deg", "pitch_std_deg"])
def test_none_is_no_number_where_a_number_is_needed(name):
    options = {"focal_px": 700.0, "focal_rel_std": 0.0, name: None}
    with pytest.raises(TypeError, match=f"`{name}` must be .*; got None"):
        Camera(**options)


@pytest.mark.parametrize("pitch", [90.0, -90.0, 91.0, 180.0])
def test_camera_looking_straight_down_or_beyond_is_refused(pitch):
    with pytest.raises(ValueError, match=f"`pitch_deg` must be between -90 and 90; got {pitch}"):
        Camera(700.0, focal_rel_std=0.0, pitch_deg=pitch)


@pytest.mark.parametrize("pitch", [-89.9, 0, 20, 89.9])
def test_pitch_below_90_degrees_is_lawful(pitch):
    assert Camera(700.0, focal_rel_std=0.0, pitch_deg=pitch).pitch_deg == pitch


@pytest.mark.parametrize(
    ("own", "measured"),
    [
        pytest.param((1242, 375), (1242, 375), id="same"),
        pytest.param(None, (1242, 375), id="camera's unknown"),
        pytest.param((1242, 375), None, id="picture's unknown"),
    ],
)
def test_camera_goes_with_a_picture_of_its_own_or_unknown_size(own, measured):
    Camera(700.0, focal_rel_std=0.0, image_size=own).check_image_size(measured)


@pytest.mark.parametrize("measured", [(621, 187), (375, 1242)])
def test_camera_of_a_picture_of_another_size_is_refused(measured):
    law = re.escape(
        f"`camera.image_size` must be that of the image, {measured}; got (1242, 375). "
        "A resized picture's focal length scales with it"
    )
    with pytest.raises(ValueError, match=law):
        Camera(700.0, focal_rel_std=0.0, image_size=(1242, 375)).check_image_size(measured)


# --- EXIF ---


def test_36_mm_on_a_3_by_2_picture_is_as_many_pixels_as_the_picture_is_wide(tmp_path):
    camera = Camera.from_exif(write_photo(tmp_path / "a.jpg", (600, 400), f35=36))
    assert camera.focal_px == pytest.approx(600.0, rel=1e-12)


@pytest.mark.parametrize(
    ("size", "f35"),
    [
        pytest.param((400, 300), 26, id="phone 4:3"),
        pytest.param((300, 400), 26, id="phone upright"),
        pytest.param((640, 360), 24, id="16:9"),
        pytest.param((300, 200), 50, id="3:2"),
        pytest.param((300, 200), 200, id="tele"),
    ],
)
def test_35_mm_equivalent_compares_diagonals(tmp_path, size, f35):
    camera = Camera.from_exif(write_photo(tmp_path / "a.jpg", size, f35=f35))
    expected = f35 * math.hypot(*size) / FULL_FRAME_DIAGONAL_MM
    assert camera.focal_px == pytest.approx(expected, rel=1e-6)
    assert camera.image_size == size
    assert camera.focal_rel_std == pytest.approx(0.04)
    assert (camera.cx, camera.cy, camera.pitch_deg) == (None, None, 0.0)
    assert type(camera.focal_px) is float


@pytest.mark.parametrize("orientation", range(1, 9))
def test_image_size_is_that_of_the_upright_picture(tmp_path, orientation):
    photo = write_photo(tmp_path / "a.jpg", (400, 300), f35=26, orientation=orientation)
    camera = Camera.from_exif(photo)
    # EXIF: from 5 on, row 0 of the file is a side of the scene and not its top or bottom
    assert camera.image_size == ((300, 400) if orientation > 4 else (400, 300))
    assert camera.focal_px == pytest.approx(26 * 500 / FULL_FRAME_DIAGONAL_MM, rel=1e-6)


def test_photo_resized_as_a_whole_has_its_focal_length_scaled(tmp_path):
    full = write_photo(tmp_path / "full.jpg", (800, 600), f35=26, taken=(800, 600))
    half = write_photo(tmp_path / "half.jpg", (400, 300), f35=26, taken=(800, 600))
    ratio = Camera.from_exif(full).focal_px / Camera.from_exif(half).focal_px
    assert ratio == pytest.approx(2.0, rel=1e-12)


def test_photo_turned_in_its_pixels_is_no_crop(tmp_path):
    photo = write_photo(tmp_path / "a.jpg", (300, 400), f35=26, taken=(800, 600))
    assert Camera.from_exif(photo).image_size == (300, 400)


def test_rounding_of_a_thumbnails_size_is_no_crop(tmp_path):
    photo = write_photo(tmp_path / "a.jpg", (401, 300), f35=26, taken=(4000, 3000))
    assert Camera.from_exif(photo).image_size == (401, 300)


@pytest.mark.parametrize(
    "size",
    [
        pytest.param((400, 225), id="16:9"),
        pytest.param((300, 300), id="square"),
        pytest.param((412, 300), id="3 % of the height gone"),
    ],
)
def test_cropped_photo_is_refused_with_both_sizes(tmp_path, size):
    photo = write_photo(tmp_path / "a.jpg", size, f35=26, taken=(4000, 3000))
    law = (
        r"must have the aspect ratio it was taken with, 4000 x 3000; "
        rf"got {size[0]} x {size[1]}\..*focal length.*by hand"
    )
    with pytest.raises(ValueError, match=law):
        Camera.from_exif(photo)


@pytest.mark.parametrize("taken", [(4000, None), (None, 3000), (0, 0), (4000, 0)])
def test_record_without_both_sides_of_the_picture_cannot_tell_a_crop(tmp_path, taken):
    photo = write_photo(tmp_path / "a.jpg", (300, 300), f35=26, taken=taken)
    assert Camera.from_exif(photo).image_size == (300, 300)


@pytest.mark.parametrize("f35", [pytest.param(None, id="missing"), 0])
def test_photo_without_a_35_mm_equivalent_is_refused_with_the_remedy(tmp_path, f35):
    photo = write_photo(tmp_path / "holiday.jpg", (400, 300), f35=f35, orientation=1)
    law = r"holiday\.jpg must carry FocalLengthIn35mmFilm in its EXIF record; got none\."
    with pytest.raises(ValueError, match=law) as caught:
        Camera.from_exif(photo)
    assert "Camera(focal_px, focal_rel_std=...)" in str(caught.value)


@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_picture_without_any_exif_is_refused(tmp_path, suffix):
    path = tmp_path / f"plain.{suffix}"
    Image.new("RGB", (40, 30)).save(path)
    with pytest.raises(ValueError, match="must carry FocalLengthIn35mmFilm"):
        Camera.from_exif(path)


def test_exif_is_read_from_a_path_given_as_text(tmp_path):
    photo = write_photo(tmp_path / "a.jpg", (600, 400), f35=36)
    assert Camera.from_exif(str(photo)) == Camera.from_exif(photo)


def test_missing_photo_is_a_file_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        Camera.from_exif(tmp_path / "nowhere.jpg")


# --- Noise ---


def test_noise_is_one_pixel_and_an_unknown_depth_error_unless_told():
    assert Noise() == Noise(box_px=1.0, box_rel=0.0, depth_rel=None)


def test_numpy_noise_becomes_python_floats():
    noise = Noise(np.float32(2), np.float64(0.25), np.int64(0))
    assert attrs.astuple(noise) == (2.0, 0.25, 0.0)
    assert {type(number) for number in attrs.astuple(noise)} == {float}


def test_noise_is_frozen_equal_by_value_and_hashable():
    noise = Noise(depth_rel=0.1)
    assert noise != Noise(depth_rel=0.2)
    assert hash(noise) == hash(Noise(depth_rel=0.1))
    with pytest.raises(attrs.exceptions.FrozenInstanceError):
        noise.box_px = 3.0


@pytest.mark.parametrize("name", ["box_px", "box_rel", "depth_rel"])
@pytest.mark.parametrize("value", [-0.1, math.nan, math.inf, -math.inf])
def test_unlawful_noise_is_refused(name, value):
    with pytest.raises(ValueError, match=f"`{name}` must be finite and not negative; got {value}"):
        Noise(**{name: value})


@pytest.mark.parametrize("name", ["box_px", "box_rel", "depth_rel"])
@pytest.mark.parametrize("value", ["1", True, [1.0]])
def test_noise_that_is_no_number_is_a_type_error(name, value):
    with pytest.raises(
        TypeError, match=re.escape(f"must be finite and not negative; got {value!r}")
    ):
        Noise(**{name: value})


@pytest.mark.parametrize("name", ["box_px", "box_rel"])
def test_box_noise_may_be_zero_but_not_none(name):
    assert getattr(Noise(**{name: 0}), name) == 0.0
    with pytest.raises(TypeError, match=f"`{name}` must be .*; got None"):
        Noise(**{name: None})


# --- intrinsics as networks give them ---


@pytest.mark.parametrize("of_size", [(1, 1), (504, 378), (1920, 1440), None])
def test_a_matrix_of_any_picture_size_gives_the_pixels_of_the_photo(of_size):
    size = (960, 720)
    width, height = of_size or size
    matrix = np.array(
        [[800 / 960 * width, 0, width / 2], [0, 800 / 720 * height, height / 3], [0, 0, 1]]
    )
    camera = Camera.from_matrix(matrix, focal_rel_std=0.2, image_size=size, of_size=of_size)
    assert (camera.focal_px, camera.cx, camera.cy) == pytest.approx((800, 480, 240), rel=1e-12)
    assert (camera.focal_rel_std, camera.image_size) == (0.2, size)


def test_the_focal_length_of_a_matrix_is_the_vertical_one():
    matrix = [[790.0, 0, 480], [0, 800.0, 360], [0, 0, 1]]
    assert Camera.from_matrix(matrix, focal_rel_std=0.0, image_size=(960, 720)).focal_px == 800.0


def test_a_matrix_of_a_stretched_picture_needs_to_be_told_so():
    matrix = [[420.0, 0, 252], [0, 420.0, 252], [0, 0, 1]]  # of a square network input
    with pytest.raises(ValueError, match=r"fx and fy alike .* as `of_size`"):
        Camera.from_matrix(matrix, focal_rel_std=0.1, image_size=(960, 720), of_size=(504, 504))


@pytest.mark.parametrize(
    "matrix",
    [
        np.eye(4),
        [[800, 0, 480], [0, 800, 360]],
        [[800, 0, 480], [3, 800, 360], [0, 0, 1]],
        [[800, 300, 480], [0, 800, 360], [0, 0, 1]],
        [[800, 0, 0], [0, 800, 0], [480, 360, 1]],
        [[800, 0, 480], [0, 800, 360], [0, 0, 2]],
    ],
)
def test_what_is_no_matrix_of_intrinsics_is_refused(matrix):
    with pytest.raises(ValueError, match=r"`matrix` must"):
        Camera.from_matrix(matrix, focal_rel_std=0.1, image_size=(960, 720))


@pytest.mark.parametrize("focal", [0.0, -5.0, math.nan, math.inf])
def test_a_matrix_without_a_focal_length_is_refused(focal):
    matrix = [[focal, 0, 480], [0, focal, 360], [0, 0, 1]]
    with pytest.raises(ValueError, match="`focal_px` must be finite and positive"):
        Camera.from_matrix(matrix, focal_rel_std=0.1, image_size=(960, 720))


@pytest.mark.parametrize("of_size", [(0, 1), (504.5, 378), "504x378"])
def test_a_wrong_size_of_the_matrix_is_refused_by_its_name(of_size):
    matrix = [[800, 0, 480], [0, 800, 360], [0, 0, 1]]
    with pytest.raises(ValueError, match=r"`of_size` must be \(width, height\)"):
        Camera.from_matrix(matrix, focal_rel_std=0.1, image_size=(960, 720), of_size=of_size)
