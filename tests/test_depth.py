"""Depth maps, depths per object, the ground plane and frames: conversions and refusals."""

import math
import os
import pickle
import re
from pathlib import Path

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

import imgscale as ims
from imgscale import Camera, DepthMap, Detection, Frame, GroundPlane, ObjectDepths
from imgscale._depth_values import valid_depths

VALUE_KINDS = ("metric", "relative", "inverse", "affine_inverse")
POSITIVE_KINDS = VALUE_KINDS[:3]
DATA = Path(os.environ.get("IMGSCALE_DATA", Path(__file__).parents[2] / "shared" / "data"))
CLONE = pickle.loads  # of our own bytes only


# --- DepthMap: construction ---


@pytest.mark.parametrize("kind", VALUE_KINDS)
def test_map_keeps_values_and_kind_and_takes_its_own_size(kind):
    values = np.arange(1.0, 7.0).reshape(2, 3)
    depth = DepthMap(values, kind=kind)
    assert np.array_equal(depth.values, values)
    assert depth.kind == kind
    assert depth.image_size == (3, 2)
    assert depth.scale_rel_std == 0.0


def test_map_of_another_size_keeps_the_image_size_as_two_ints():
    depth = DepthMap(np.ones((2, 3)), kind="relative", image_size=np.array([1920, 1080]))
    assert depth.image_size == (1920, 1080)
    assert [type(number) for number in depth.image_size] == [int, int]


def test_whole_floats_are_a_lawful_image_size():
    assert DepthMap([[1.0]], kind="relative", image_size=(640.0, 480.0)).image_size == (640, 480)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_floating_dtypes_stay(dtype):
    assert DepthMap(np.ones((2, 2), dtype), kind="metric").values.dtype == dtype


def test_raw_lists_become_float64():
    assert DepthMap([[1.0, 2.0]], kind="metric").values.dtype == np.float64


@pytest.mark.parametrize("kind", ["relative", "inverse", "affine_inverse"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int32])
def test_integers_without_an_absolute_scale_become_float64(kind, dtype):
    values = np.array([[1, 2], [3, 250]], dtype)
    depth = DepthMap(values, kind=kind)
    assert depth.values.dtype == np.float64
    assert np.array_equal(depth.values, values)


def test_later_edits_of_the_callers_array_do_not_show():
    values = np.full((2, 2), 3.0)
    depth = DepthMap(values, kind="metric")
    values[:] = 99.0
    assert np.array_equal(depth.values, np.full((2, 2), 3.0))


def test_values_are_read_only_and_leave_the_callers_writable():
    values = np.full((2, 2), 3.0)
    depth = DepthMap(values, kind="metric")
    with pytest.raises(ValueError, match="read-only"):
        depth.values[0, 0] = 1.0
    values[0, 0] = 1.0


@pytest.mark.parametrize("name", ["values", "kind", "image_size", "scale_rel_std"])
def test_map_fields_cannot_be_set(name):
    depth = DepthMap([[1.0]], kind="metric")
    with pytest.raises(AttributeError):
        setattr(depth, name, None)


def test_maps_are_compared_by_identity_and_can_be_keys():
    one, other = DepthMap([[1.0]], kind="metric"), DepthMap([[1.0]], kind="metric")
    assert one == one  # noqa: PLR0124 - identity is the point
    assert one != other
    assert len({one, other}) == 2


def test_map_survives_pickling():
    depth = DepthMap([[1.0, math.nan]], kind="inverse", image_size=(20, 10), scale_rel_std=0.1)
    clone = CLONE(pickle.dumps(depth))
    assert np.array_equal(clone.values, depth.values, equal_nan=True)
    assert (clone.kind, clone.image_size, clone.scale_rel_std) == ("inverse", (20, 10), 0.1)


def test_map_can_be_evolved():
    depth = attrs.evolve(DepthMap([[1.0]], kind="metric", image_size=(4, 4)), scale_rel_std=0.15)
    assert (depth.image_size, depth.scale_rel_std) == ((4, 4), 0.15)


def test_repr_shows_the_shape_not_the_values():
    text = repr(DepthMap(np.ones((480, 640)), kind="metric"))
    assert "(480, 640) float64" in text
    assert len(text) < 200


def test_kind_must_be_named():
    with pytest.raises(TypeError, match="kind"):
        DepthMap([[1.0]])


# --- DepthMap: refusals ---


@pytest.mark.parametrize("kind", ["disparity", "depth", "ground_plane", "Metric", "", None, 3])
def test_unknown_kind_is_refused_with_the_choices(kind):
    law = (
        r'`kind` must be one of "metric", "relative", "inverse", "affine_inverse"; '
        rf"got {re.escape(repr(kind))}"
    )
    with pytest.raises(ValueError, match=law):
        DepthMap([[1.0]], kind=kind)
    with pytest.raises(ValueError, match=law):
        ObjectDepths([1.0], kind=kind)


@pytest.mark.parametrize("dtype", [np.uint16, np.int32, np.uint8, np.int64])
def test_integer_metric_depth_is_refused_naming_256_and_1000(dtype):
    values = np.full((4, 4), 200, dtype)
    with pytest.raises(ValueError, match=f"floating point; got dtype {np.dtype(dtype)}") as caught:
        DepthMap(values, kind="metric")
    assert "KITTI 256" in str(caught.value)
    assert "millimetres 1000" in str(caught.value)


@pytest.mark.parametrize("kind", POSITIVE_KINDS)
@pytest.mark.parametrize("missing", [math.nan, math.inf, -math.inf, 0.0, -1.0])
def test_map_without_a_valid_value_is_refused(kind, missing):
    law = rf'`values` must hold a finite, positive number; got none, so this "{kind}" map is empty'
    with pytest.raises(ValueError, match=law):
        DepthMap(np.full((3, 3), missing), kind=kind)


@pytest.mark.parametrize("missing", [math.nan, math.inf, -math.inf])
def test_affine_map_without_a_finite_value_is_refused(missing):
    with pytest.raises(ValueError, match="must hold a finite number; got none"):
        DepthMap(np.full((3, 3), missing), kind="affine_inverse")


@pytest.mark.parametrize("value", [0.0, -3.5])
def test_affine_map_may_hold_zero_and_negative_values(value):
    assert DepthMap([[value]], kind="affine_inverse").values[0, 0] == value


@pytest.mark.parametrize("kind", POSITIVE_KINDS)
def test_one_valid_pixel_is_enough(kind):
    values = np.full((3, 3), math.nan)
    values[1, 2] = 4.0
    assert DepthMap(values, kind=kind).values[1, 2] == 4.0


@pytest.mark.parametrize(
    "shape",
    [
        pytest.param((), id="number"),
        pytest.param((5,), id="row"),
        pytest.param((4, 4, 1), id="one channel"),
        pytest.param((1, 4, 4), id="batch of one"),
        pytest.param((0, 5), id="no rows"),
        pytest.param((5, 0), id="no columns"),
    ],
)
def test_map_of_another_shape_is_refused(shape):
    law = re.escape(f"`values` must have shape (H, W) and hold something; got {shape}")
    with pytest.raises(ValueError, match=law):
        DepthMap(np.ones(shape), kind="relative")


@pytest.mark.parametrize(
    ("values", "dtype"),
    [
        pytest.param([["1.0", "2.0"]], "<U3", id="strings"),
        pytest.param([[True, False]], "bool", id="bools"),
        pytest.param([[1.0, None]], "object", id="none"),
        pytest.param([[1j, 2.0]], "complex128", id="complex"),
    ],
)
@pytest.mark.parametrize("kind", ["metric", "relative"])
def test_values_that_are_no_real_numbers_are_a_type_error(values, dtype, kind):
    law = re.escape(f"`values` must hold real numbers; got dtype {dtype}")
    with pytest.raises(TypeError, match=law):
        DepthMap(values, kind=kind)


@pytest.mark.parametrize("build", [DepthMap, ObjectDepths])
def test_ragged_lists_are_refused_by_name(build):
    with pytest.raises((TypeError, ValueError), match="`values` must"):
        build([[1.0, 2.0], [3.0]], kind="relative")


@pytest.mark.parametrize(
    "size",
    [
        pytest.param((0, 480), id="zero"),
        pytest.param((640, -1), id="negative"),
        pytest.param((640.5, 480), id="fraction"),
        pytest.param((math.nan, 480), id="nan"),
        pytest.param((math.inf, 480), id="inf"),
        pytest.param((480, 640, 3), id="array shape"),
        pytest.param((640,), id="one"),
        pytest.param(640, id="a number"),
        pytest.param("640x480", id="string"),
        pytest.param(("640", "480"), id="strings"),
        pytest.param((None, 480), id="none"),
        pytest.param((True, True), id="bools"),
    ],
)
@pytest.mark.parametrize(
    "build",
    [
        pytest.param(lambda size: DepthMap([[1.0]], kind="metric", image_size=size), id="map"),
        pytest.param(lambda size: ObjectDepths([1.0], kind="metric", image_size=size), id="list"),
        pytest.param(lambda size: GroundPlane(image_size=size), id="ground"),
        pytest.param(lambda size: Camera(1.0, focal_rel_std=0.0, image_size=size), id="camera"),
    ],
)
def test_unlawful_image_size_is_refused(build, size):
    law = "`image_size` must be (width, height), two positive whole numbers of pixels, at most 1e9"
    with pytest.raises(ValueError, match=re.escape(f"{law}; got {size!r}")):
        build(size)


@pytest.mark.parametrize("std", [-0.1, math.nan, math.inf])
def test_unlawful_scale_error_is_refused(std):
    law = f"`scale_rel_std` must be finite and not negative; got {std}"
    with pytest.raises(ValueError, match=law):
        DepthMap([[1.0]], kind="metric", scale_rel_std=std)


@pytest.mark.parametrize("std", ["0.1", True])
def test_scale_error_that_is_no_number_is_a_type_error(std):
    with pytest.raises(TypeError, match=rf"`scale_rel_std` must be .*; got {std!r}"):
        DepthMap([[1.0]], kind="metric", scale_rel_std=std)


@pytest.mark.parametrize("kind", VALUE_KINDS)
def test_validity_follows_the_table_of_the_design(kind):
    values = np.array([[math.nan, math.inf, -math.inf, 0.0, -1.0, 1e-300, 2.0]])
    expected = [False, False, False, kind == "affine_inverse", kind == "affine_inverse", True, True]
    assert valid_depths(values, kind).tolist() == [expected]


# --- the fingerprint ---


def test_fingerprint_is_the_same_for_the_same_map():
    values = np.random.default_rng(1).uniform(1, 50, (200, 300))
    prints = {DepthMap(values.copy(), kind="relative").fingerprint for _ in range(3)}
    assert len(prints) == 1


def test_fingerprint_tells_scaled_shifted_and_reshaped_maps_apart():
    values = np.random.default_rng(1).uniform(1, 50, (200, 300))
    others = [values, 2 * values, values + 1e-9, values[::-1], values.reshape(300, 200)]
    prints = {DepthMap(other, kind="relative").fingerprint for other in others}
    assert len(prints) == len(others)


def test_fingerprint_of_a_small_map_sees_every_pixel():
    values = np.ones((20, 30))
    plain = DepthMap(values, kind="relative").fingerprint
    for place in ((0, 0), (7, 13), (19, 29)):
        changed = values.copy()
        changed[place] = 1.5
        assert DepthMap(changed, kind="relative").fingerprint != plain


def test_fingerprint_is_that_of_maps_with_missing_pixels_too():
    values = np.full((10, 10), math.nan)
    values[0, 0] = 1.0
    one, other = (DepthMap(values, kind="relative").fingerprint for _ in range(2))
    assert one == other


# --- disparity ---


@settings(deadline=None)
@given(
    disparity=st.floats(0.1, 500),
    focal_px=st.floats(100, 5000),
    baseline_m=st.floats(0.01, 2),
    doffs_px=st.floats(-0.05, 200),
)
def test_disparity_becomes_depth_by_the_stereo_law(disparity, focal_px, baseline_m, doffs_px):
    depth = DepthMap.from_disparity(
        [[disparity]], focal_px=focal_px, baseline_m=baseline_m, doffs_px=doffs_px
    )
    assert depth.kind == "metric"
    expected = focal_px * baseline_m / (disparity + doffs_px)
    assert depth.values[0, 0] == pytest.approx(expected, rel=1e-12)


def test_missing_disparities_become_nan_even_where_doffs_would_make_them_positive():
    disparity = [[math.inf, math.nan, 0.0, -1.0, -math.inf, 10.0]]
    depth = DepthMap.from_disparity(disparity, focal_px=1000.0, baseline_m=0.2, doffs_px=30.0)
    assert np.isnan(depth.values[0, :5]).all()
    assert depth.values[0, 5] == pytest.approx(1000 * 0.2 / 40)


def test_points_beyond_infinity_are_missing():
    depth = DepthMap.from_disparity(
        [[4.0, 5.0, 6.0]], focal_px=100.0, baseline_m=1.0, doffs_px=-5.0
    )
    assert np.isnan(depth.values[0, :2]).all()
    assert depth.values[0, 2] == pytest.approx(100.0)


def test_disparity_without_any_match_is_refused():
    with pytest.raises(ValueError, match='"metric" map is empty'):
        DepthMap.from_disparity([[math.inf, 0.0]], focal_px=700.0, baseline_m=0.5)


def test_disparity_keeps_the_image_size_and_leaves_the_callers_array_alone():
    disparity = np.array([[20.0, -1.0]])
    depth = DepthMap.from_disparity(
        disparity, focal_px=700.0, baseline_m=0.5, image_size=(1242, 375)
    )
    assert depth.image_size == (1242, 375)
    assert disparity.tolist() == [[20.0, -1.0]]
    assert depth.values.dtype == np.float64


@pytest.mark.parametrize("dtype", [np.int16, np.uint16, np.uint8])
def test_integer_disparity_is_refused_naming_the_files_scales(dtype):
    law = f"`disparity` must be floating point; got dtype {np.dtype(dtype)}"
    with pytest.raises(ValueError, match=law) as caught:
        DepthMap.from_disparity(np.ones((2, 2), dtype), focal_px=700.0, baseline_m=0.5)
    assert "KITTI 256" in str(caught.value)
    assert "SGBM 16" in str(caught.value)


@pytest.mark.parametrize("name", ["focal_px", "baseline_m"])
@pytest.mark.parametrize("value", [0.0, -0.5, math.nan, math.inf])
def test_unlawful_stereo_geometry_is_refused_by_name(name, value):
    numbers = {"focal_px": 700.0, "baseline_m": 0.5, name: value}
    with pytest.raises(ValueError, match=f"`{name}` must be finite and positive; got {value}"):
        DepthMap.from_disparity([[20.0]], **numbers)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_doffs_that_are_not_finite_are_refused(value):
    with pytest.raises(ValueError, match=f"`doffs_px` must be finite; got {value}"):
        DepthMap.from_disparity([[20.0]], focal_px=700.0, baseline_m=0.5, doffs_px=value)


@pytest.mark.parametrize("name", ["focal_px", "baseline_m", "doffs_px"])
def test_stereo_geometry_given_as_text_is_a_type_error(name):
    numbers = {"focal_px": 700.0, "baseline_m": 0.5, name: "0.5"}
    with pytest.raises(TypeError, match=f"`{name}` must be finite.*; got '0.5'"):
        DepthMap.from_disparity([[20.0]], **numbers)


def test_disparity_of_another_shape_is_refused_by_name():
    with pytest.raises(ValueError, match=r"`disparity` must have shape \(H, W\)"):
        DepthMap.from_disparity(np.ones((2, 2, 3)), focal_px=700.0, baseline_m=0.5)


def test_middlebury_motorcycle_has_the_published_range_of_depth():
    ski = pytest.importorskip("skimage")
    _, _, disparity = ski.data.stereo_motorcycle()
    depth = DepthMap.from_disparity(
        disparity, focal_px=994.978, baseline_m=0.193001, doffs_px=31.086
    )
    seen = depth.values[np.isfinite(depth.values)]
    assert depth.values.shape == (500, 741)
    assert depth.image_size == (741, 500)
    assert depth.values.size - seen.size == 27_226  # the pixels that the scene marks with inf
    assert np.median(seen) == pytest.approx(2.75, abs=0.005)
    assert seen.min() == pytest.approx(2.11, abs=0.005)
    assert seen.max() == pytest.approx(5.02, abs=0.005)


def test_motorcycle_without_doffs_lies_where_its_makers_say_it_does_not():
    ski = pytest.importorskip("skimage")
    _, _, disparity = ski.data.stereo_motorcycle()
    depth = DepthMap.from_disparity(disparity, focal_px=994.978, baseline_m=0.193001)
    seen = depth.values[np.isfinite(depth.values)]
    assert (seen.min(), seen.max()) == pytest.approx((3.2, 26.7), abs=0.06)


def test_kitti_disparity_puts_a_car_where_its_3d_label_does():
    folder = DATA / "kitti" / "scene_flow_2015" / "training"
    file = folder / "disp_occ_0" / "000046_10.png"
    if not file.is_file():
        pytest.skip(f"no KITTI scene flow in {DATA}; set IMGSCALE_DATA")
    with Image.open(file) as image:
        stored = np.asarray(image)
    with pytest.raises(ValueError, match="KITTI 256"):
        DepthMap.from_disparity(stored, focal_px=721.5377, baseline_m=0.53273)
    depth = DepthMap.from_disparity(stored / 256, focal_px=721.5377, baseline_m=0.53273)
    assert np.array_equal(np.isnan(depth.values), stored == 0)
    words = (folder / "label_2_matched" / "000046_10.txt").read_text().split()
    x1, y1, x2, y2, _, width, length, _, _, z, yaw = (float(word) for word in words[4:15])
    reach = abs(length / 2 * math.sin(yaw)) + abs(width / 2 * math.cos(yaw))
    middle = depth.values[int(y1 + y2) // 2, int(x1 + 0.3 * (x2 - x1)) : int(x2 - 0.3 * (x2 - x1))]
    assert z - 1.03 * reach < np.nanmedian(middle) < z  # on the near half of the labelled car


# --- distance along the ray ---


@pytest.mark.parametrize(
    ("image_size", "shape"),
    [
        pytest.param((40, 30), (30, 40), id="map of the image's size"),
        pytest.param((400, 300), (30, 40), id="map ten times smaller"),
        pytest.param((400, 300), (60, 40), id="map squeezed in one direction"),
        pytest.param(None, (30, 40), id="camera of the map"),
    ],
)
@pytest.mark.parametrize("centred", [True, False])
def test_ray_distances_of_known_points_become_their_z(image_size, shape, centred):
    rng = np.random.default_rng(3)
    width, height = image_size or (shape[1], shape[0])
    cx, cy = (width / 2, height / 2) if centred else (0.3 * width, 0.8 * height)
    focal_px = 0.7 * width
    camera = Camera(
        focal_px,
        focal_rel_std=0.0,
        cx=None if centred else cx,
        cy=None if centred else cy,
        image_size=image_size,
    )
    z = rng.uniform(1.0, 40.0, shape)
    # where the centre of each pixel of the map lies in the image, one by one
    x = np.array([[(j + 0.5) / shape[1] * width for j in range(shape[1])]] * shape[0])
    y = np.array([[(i + 0.5) / shape[0] * height] * shape[1] for i in range(shape[0])])
    points = np.stack([z * (x - cx) / focal_px, z * (y - cy) / focal_px, z], axis=-1)
    depth = DepthMap.from_ray_distance(np.linalg.norm(points, axis=-1), camera)
    assert depth.kind == "metric"
    assert depth.image_size == (width, height)
    assert depth.values == pytest.approx(z, rel=1e-12)


def test_ray_through_the_principal_point_is_the_depth_itself():
    camera = Camera(500.0, focal_rel_std=0.0, cx=2.5, cy=1.5)
    values = np.full((3, 5), 7.0)
    depth = DepthMap.from_ray_distance(values, camera)
    assert depth.values[1, 2] == 7.0
    assert (np.delete(depth.values.ravel(), 7) < 7.0).all()


def test_ray_at_45_degrees_is_root_two_longer_than_its_depth():
    camera = Camera(100.0, focal_rel_std=0.0, cx=0.5, cy=0.5)
    values = np.full((101, 101), math.sqrt(2))
    depth = DepthMap.from_ray_distance(values, camera)
    assert depth.values[0, 100] == pytest.approx(1.0, rel=1e-12)
    assert depth.values[100, 0] == pytest.approx(1.0, rel=1e-12)
    assert depth.values[100, 100] == pytest.approx(math.sqrt(2 / 3), rel=1e-12)


def test_missing_ray_distances_stay_missing():
    camera = Camera(100.0, focal_rel_std=0.0)
    values = np.array([[math.nan, math.inf, 0.0, -1.0, 2.0]])
    depth = DepthMap.from_ray_distance(values, camera)
    assert valid_depths(depth.values, "metric").tolist() == [[False, False, False, False, True]]


def test_integer_ray_distances_are_refused():
    camera = Camera(100.0, focal_rel_std=0.0)
    with pytest.raises(ValueError, match=r"floating point; got dtype uint16.*millimetres 1000"):
        DepthMap.from_ray_distance(np.ones((2, 2), np.uint16), camera)


def test_ray_distances_without_a_valid_one_are_refused():
    with pytest.raises(ValueError, match='"metric" map is empty'):
        DepthMap.from_ray_distance([[math.nan]], Camera(100.0, focal_rel_std=0.0))


# --- one depth per object ---


@pytest.mark.parametrize("kind", VALUE_KINDS)
def test_object_depths_keep_values_kind_and_length(kind):
    depth = ObjectDepths([12.5, math.nan, 3], kind=kind, image_size=(640, 480), rel_std=0.1)
    assert np.array_equal(depth.values, [12.5, math.nan, 3.0], equal_nan=True)
    assert depth.values.dtype == np.float64
    assert (len(depth), depth.kind, depth.image_size) == (3, kind, (640, 480))
    assert depth.rel_std == 0.1


def test_object_depths_know_neither_image_nor_error_unless_told():
    depth = ObjectDepths([1.0], kind="metric")
    assert depth.image_size is None
    assert depth.rel_std is None


def test_no_object_has_no_depth():
    depth = ObjectDepths([], kind="metric")
    assert len(depth) == 0
    assert depth.values.shape == (0,)


def test_unknown_depths_alone_are_lawful():
    assert len(ObjectDepths([math.nan, math.nan], kind="relative")) == 2


def test_later_edits_of_the_callers_depths_do_not_show():
    values = np.array([1.0, 2.0])
    depth = ObjectDepths(values, kind="metric")
    values[:] = 9.0
    assert depth.values.tolist() == [1.0, 2.0]
    with pytest.raises(ValueError, match="read-only"):
        depth.values[0] = 5.0


def test_object_depths_are_compared_by_identity_and_can_be_keys():
    one, other = (ObjectDepths([1.0, 2.0], kind="metric") for _ in range(2))
    assert one != other
    assert len({one, other}) == 2


@pytest.mark.parametrize(
    "build",
    [
        pytest.param(lambda: ObjectDepths([1.0], "metric"), id="kind of depths"),
        pytest.param(lambda: DepthMap([[1.0]], "metric"), id="kind of a map"),
        pytest.param(lambda: GroundPlane((640, 480)), id="image size of a plane"),
        pytest.param(lambda: Frame((), ObjectDepths([], kind="metric"), None), id="camera"),
        pytest.param(lambda: DepthMap.from_disparity([[9.0]], 700.0, 0.5), id="stereo numbers"),
    ],
)
def test_options_must_be_named(build):
    with pytest.raises(TypeError, match="positional"):
        build()


def test_object_depths_cannot_be_set():
    depth = ObjectDepths([1.0], kind="metric")
    with pytest.raises(attrs.exceptions.FrozenInstanceError):
        depth.values = np.array([2.0])


def test_numpy_relative_error_becomes_a_python_float():
    assert type(ObjectDepths([1.0], kind="metric", rel_std=np.float32(0.5)).rel_std) is float


@pytest.mark.parametrize("kind", POSITIVE_KINDS)
@pytest.mark.parametrize("bad", [0.0, -2.0, math.inf, -math.inf])
def test_unlawful_object_depth_is_refused_with_its_place_and_the_remedy(kind, bad):
    law = (
        "`values` must be finite and positive, or NaN where unknown; "
        rf"got {re.escape(str(bad))} at index 2\."
    )
    with pytest.raises(ValueError, match=law):
        ObjectDepths([1.0, math.nan, bad, 0.0], kind=kind)


def test_affine_object_depths_may_be_zero_or_negative_but_not_infinite():
    assert ObjectDepths([0.0, -1.0], kind="affine_inverse").values.tolist() == [0.0, -1.0]
    with pytest.raises(ValueError, match=r"must be finite, or NaN .*; got inf at index 1"):
        ObjectDepths([0.0, math.inf], kind="affine_inverse")


@pytest.mark.parametrize(
    ("values", "shape"),
    [
        pytest.param(4.0, "()", id="a number"),
        pytest.param([[1.0, 2.0]], "(1, 2)", id="a row of a table"),
        pytest.param(np.ones((0, 3)), "(0, 3)", id="an empty table"),
    ],
)
def test_object_depths_of_another_shape_are_refused(values, shape):
    law = re.escape(
        f"`values` must have shape (N,), one depth per detection and hold something; got {shape}"
    )
    with pytest.raises(ValueError, match=law):
        ObjectDepths(values, kind="metric")


@pytest.mark.parametrize(
    "values",
    [
        pytest.param(["4.0"], id="strings"),
        pytest.param([4.0, None], id="none for unknown"),
        pytest.param([True, False], id="bools"),
        pytest.param("12.5", id="one string"),
    ],
)
def test_object_depths_that_are_no_numbers_are_a_type_error(values):
    with pytest.raises(TypeError, match="`values` must hold real numbers; got dtype"):
        ObjectDepths(values, kind="metric")


@pytest.mark.parametrize("std", [-0.1, math.nan, math.inf])
def test_unlawful_relative_error_is_refused(std):
    law = f"`rel_std` must be finite and not negative; got {std}"
    with pytest.raises(ValueError, match=law):
        ObjectDepths([1.0], kind="metric", rel_std=std)


# --- the ground plane ---


def test_ground_plane_needs_only_the_image():
    ground = GroundPlane(image_size=(1920, 1080))
    assert ground.kind == "ground_plane"
    assert ground.image_size == (1920, 1080)
    assert ground.horizon_px is None
    assert ground.camera_height_m is None


def test_ground_plane_keeps_what_is_known_as_python_floats():
    ground = GroundPlane(
        image_size=(1920, 1080),
        horizon_px=np.int64(-40),
        horizon_std_px=np.float32(5),
        camera_height_m=3,
        camera_height_std_m=0,
    )
    numbers = (
        ground.horizon_px,
        ground.horizon_std_px,
        ground.camera_height_m,
        ground.camera_height_std_m,
    )
    assert numbers == (-40.0, 5.0, 3.0, 0.0)
    assert {type(number) for number in numbers} == {float}


def test_equal_ground_planes_are_equal_and_hash_alike():
    one, other = (GroundPlane(image_size=(10, 10), horizon_px=4.0) for _ in range(2))
    assert one == other
    assert hash(one) == hash(other)
    assert one != GroundPlane(image_size=(10, 10), horizon_px=5.0)


def test_ground_plane_cannot_be_set():
    ground = GroundPlane(image_size=(10, 10))
    with pytest.raises(attrs.exceptions.FrozenInstanceError):
        ground.horizon_px = 3.0


def test_ground_plane_without_an_image_is_refused():
    with pytest.raises((TypeError, ValueError), match=r"`image_size` must be \(width, height\)"):
        GroundPlane(image_size=None)
    with pytest.raises(TypeError, match="image_size"):
        GroundPlane()


@pytest.mark.parametrize(
    ("name", "value", "law"),
    [
        pytest.param("horizon_px", math.nan, "finite", id="nan horizon"),
        pytest.param("horizon_px", math.inf, "finite", id="infinite horizon"),
        pytest.param("camera_height_m", 0.0, "finite and positive", id="camera on the ground"),
        pytest.param("camera_height_m", -1.5, "finite and positive", id="camera below the ground"),
        pytest.param("camera_height_m", math.inf, "finite and positive", id="satellite"),
    ],
)
def test_unlawful_ground_plane_is_refused(name, value, law):
    with pytest.raises(ValueError, match=f"`{name}` must be {law}; got {value}"):
        GroundPlane(image_size=(10, 10), **{name: value})


@pytest.mark.parametrize(
    ("value", "std"), [("horizon_px", "horizon_std_px"), ("camera_height_m", "camera_height_std_m")]
)
@pytest.mark.parametrize("bad", [-1.0, math.nan, math.inf])
def test_unlawful_standard_error_of_the_ground_plane_is_refused(value, std, bad):
    with pytest.raises(ValueError, match=f"`{std}` must be finite and not negative; got {bad}"):
        GroundPlane(image_size=(10, 10), **{value: 2.0, std: bad})


@pytest.mark.parametrize(
    ("value", "std"), [("horizon_px", "horizon_std_px"), ("camera_height_m", "camera_height_std_m")]
)
def test_standard_error_without_its_value_is_refused(value, std):
    law = rf"`{value}` must be given with its standard error; got None \+- 5\.0"
    with pytest.raises(ValueError, match=law):
        GroundPlane(image_size=(10, 10), **{std: 5.0})


@pytest.mark.parametrize("name", ["horizon_px", "camera_height_m"])
def test_ground_plane_given_as_text_is_a_type_error(name):
    with pytest.raises(TypeError, match=f"`{name}` must be .*; got '3.0'"):
        GroundPlane(image_size=(10, 10), **{name: "3.0"})


# --- where depth is used ---


@pytest.mark.parametrize(
    "depth",
    [
        pytest.param([4.0], id="list"),
        pytest.param(np.array([4.0]), id="array"),
        pytest.param(4.0, id="number"),
        pytest.param(None, id="nothing"),
    ],
)
def test_raw_depths_are_refused_by_fit_with_the_remedy(depth):
    detections = [Detection("door", (1, 1, 5, 9))]
    with pytest.raises(TypeError, match=r"`depth` must be a .*; got \w+\.") as caught:
        ims.fit(detections, depth)
    assert "ObjectDepths(values, kind=...)" in str(caught.value)


# --- frames ---


def test_frame_keeps_its_parts_and_turns_the_detections_into_a_tuple():
    detections = [Detection("car", (0, 0, 9, 9))]
    depth, camera = ObjectDepths([7.0], kind="metric"), Camera(700.0, focal_rel_std=0.0)
    frame = Frame(detections, depth, camera=camera, name="a")
    detections.clear()
    assert frame.detections == (Detection("car", (0, 0, 9, 9)),)
    assert frame.depth is depth
    assert frame.camera is camera
    assert frame.name == "a"


@pytest.mark.parametrize(
    "depth",
    [
        pytest.param(DepthMap([[1.0]], kind="relative"), id="map"),
        pytest.param(ObjectDepths([], kind="inverse"), id="list"),
        pytest.param(GroundPlane(image_size=(10, 10)), id="ground"),
    ],
)
def test_frame_takes_every_form_of_depth(depth):
    frame = Frame((), depth)
    assert frame.depth is depth
    assert (frame.camera, frame.name) == (None, "")


def test_frames_are_compared_by_identity_and_can_be_keys():
    depth = ObjectDepths([], kind="metric")
    assert Frame((), depth) != Frame((), depth)
    assert len({Frame((), depth), Frame((), depth)}) == 2


def test_frame_fields_cannot_be_set():
    frame = Frame((), ObjectDepths([], kind="metric"))
    with pytest.raises(attrs.exceptions.FrozenInstanceError):
        frame.name = "b"


def test_frame_refuses_what_is_no_detection_naming_its_place():
    detections = [Detection("car", (0, 0, 9, 9)), ("car", (0, 0, 9, 9))]
    law = r"`detections` must hold Detection objects; got \('car', \(0, 0, 9, 9\)\) at index 1"
    with pytest.raises(TypeError, match=law):
        Frame(detections, ObjectDepths([7.0, 7.0], kind="metric"))


@pytest.mark.parametrize("depth", [pytest.param([7.0], id="list"), None])
def test_frame_refuses_raw_depths(depth):
    law = "`depth` must be a DepthMap, ObjectDepths or GroundPlane.*; got "
    with pytest.raises(TypeError, match=law + type(depth).__name__):
        Frame([Detection("car", (0, 0, 9, 9))], depth)


def test_ray_distances_up_to_a_factor_stay_relative_and_carry_their_scale_error():
    camera = Camera(500.0, focal_rel_std=0.0, cx=4.0, cy=3.0)
    distance = np.linspace(2.0, 3.0, 48).reshape(6, 8)
    metric = DepthMap.from_ray_distance(distance, camera, scale_rel_std=0.15)
    relative = DepthMap.from_ray_distance(7 * distance, camera, kind="relative")
    assert (metric.kind, metric.scale_rel_std, relative.kind) == ("metric", 0.15, "relative")
    assert relative.values == pytest.approx(7 * metric.values, rel=1e-12)
    with pytest.raises(ValueError, match="`kind` must be one of"):
        DepthMap.from_ray_distance(distance, camera, kind="inverse")
