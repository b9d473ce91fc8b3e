"""Pixels along an axis, the image's border, and the one law behind every kind of depth."""

import math
from typing import get_args

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from imgscale._typing import DepthKind
from imgscale.extent import extent_rel_std, outside_image, pixel_extents, touches_border
from imgscale.laws import LAWS, PLAUSIBLE_FOCAL

SIZE = (100, 60)
INSIDE = (10.0, 10.0, 50.0, 40.0)


def boxes(*rows):
    return np.array(rows, dtype=np.float64).reshape(-1, 4)


def moved(place, value):
    """Return the box inside the image with one of its edges elsewhere."""
    box = list(INSIDE)
    box[place] = value
    return boxes(box)


# --- extent ---


@pytest.mark.parametrize(
    ("axis", "expected"),
    [("height", [30.0, 80.0]), ("width", [40.0, 20.0]), ("diameter", [40.0, 80.0])],
)
def test_extent_runs_along_its_axis_and_a_diameter_is_the_longer_side(axis, expected):
    rows = boxes((10, 10, 50, 40), (0, 0, 20, 80))
    assert pixel_extents(rows)[axis].tolist() == expected


@pytest.mark.parametrize("axis", ["height", "width", "diameter"])
def test_no_box_has_no_extent(axis):
    assert pixel_extents(boxes())[axis].shape == (0,)


@pytest.mark.parametrize("axis", ["height", "width", "diameter"])
def test_extent_does_not_depend_on_where_the_box_lies(axis):
    here, there = boxes((10, 10, 50, 40)), boxes((17, 13, 57, 43))
    assert pixel_extents(here)[axis] == pixel_extents(there)[axis]


def test_box_errors_add_in_quadrature():
    found = extent_rel_std(np.array([10.0, 100.0]), 0.3, 0.04)
    assert found == pytest.approx([0.05, math.sqrt(0.003**2 + 0.04**2)], rel=1e-12)


def test_a_pixel_matters_ten_times_more_on_an_object_ten_times_smaller():
    small, large = extent_rel_std(np.array([10.0, 100.0]), 1.0, 0.0)
    assert small == pytest.approx(10 * large)
    assert small == pytest.approx(0.1)


def test_exact_boxes_have_no_error():
    assert extent_rel_std(np.array([10.0]), 0.0, 0.0).tolist() == [0.0]


# --- the border ---


@pytest.mark.parametrize(
    ("place", "edge"),
    [
        pytest.param(0, -1.01, id="left"),
        pytest.param(1, -1.01, id="top"),
        pytest.param(2, 101.01, id="right"),
        pytest.param(3, 61.01, id="bottom"),
    ],
)
def test_a_box_more_than_a_pixel_beyond_any_side_is_outside(place, edge):
    assert outside_image(moved(place, edge), SIZE).tolist() == [True]


@pytest.mark.parametrize(
    ("place", "edge"),
    [
        pytest.param(0, -1.0, id="left"),
        pytest.param(1, -1.0, id="top"),
        pytest.param(2, 101.0, id="right"),
        pytest.param(3, 61.0, id="bottom"),
    ],
)
def test_a_box_up_to_a_pixel_beyond_a_side_is_a_detectors_rounding(place, edge):
    assert outside_image(moved(place, edge), SIZE).tolist() == [False]
    assert touches_border(moved(place, edge), SIZE) == [True]


def test_width_and_height_are_not_swapped():
    wide = boxes((10, 10, 90, 40))
    assert outside_image(wide, (100, 60)).tolist() == [False]
    assert outside_image(wide, (60, 100)).tolist() == [True]
    assert touches_border(wide, (100, 60)) == [False]


@pytest.mark.parametrize(
    ("place", "edge"),
    [
        pytest.param(0, 0.0, id="left"),
        pytest.param(0, 0.99, id="almost left"),
        pytest.param(1, 0.0, id="top"),
        pytest.param(2, 100.0, id="right"),
        pytest.param(2, 99.0, id="right, last pixel inclusive"),
        pytest.param(3, 60.0, id="bottom"),
        pytest.param(3, 59.0, id="bottom, last pixel inclusive"),
    ],
)
def test_a_box_that_ends_at_a_side_touches_it(place, edge):
    assert touches_border(moved(place, edge), SIZE) == [True]


@pytest.mark.parametrize(
    ("place", "edge"),
    [
        pytest.param(0, 1.0, id="left"),
        pytest.param(1, 1.0, id="top"),
        pytest.param(2, 98.9, id="right"),
        pytest.param(3, 58.9, id="bottom"),
    ],
)
def test_a_box_with_a_pixel_of_background_beside_it_touches_nothing(place, edge):
    assert touches_border(moved(place, edge), SIZE) == [False]


def test_each_box_is_judged_by_itself():
    rows = boxes(INSIDE, (0, 5, 9, 9), (5, 5, 120, 9))
    assert touches_border(rows, SIZE) == [False, True, True]
    assert outside_image(rows, SIZE).tolist() == [False, False, True]


def test_no_box_is_neither_outside_nor_at_the_border():
    assert outside_image(boxes(), SIZE).shape == (0,)
    assert touches_border(boxes(), SIZE) == []


def test_where_the_size_of_the_image_is_not_known_no_box_touches_its_border():
    assert touches_border([INSIDE, (0.0, 0.0, 9.0, 9.0)], None) == [False, False]


@given(
    x=st.floats(-20, 120),
    y=st.floats(-20, 80),
    width=st.floats(0.5, 60),
    height=st.floats(0.5, 60),
)
def test_a_box_outside_also_touches_the_border(x, y, width, height):
    rows = boxes((x, y, x + width, y + height))
    assert not outside_image(rows, SIZE)[0] or touches_border(rows, SIZE)[0]


# --- the laws ---


def test_every_kind_has_its_law_under_its_own_name():
    assert set(LAWS) == set(get_args(DepthKind))
    assert all(law.kind == kind for kind, law in LAWS.items())


def test_larger_values_are_nearer_for_inverse_kinds_and_for_foot_rows():
    inverse = {kind for kind, law in LAWS.items() if law.inverse}
    assert inverse == {"inverse", "affine_inverse", "ground_plane"}


def test_the_shift_is_unknown_for_affine_maps_and_for_the_horizon():
    shifted = {kind for kind, law in LAWS.items() if law.has_shift}
    assert shifted == {"affine_inverse", "ground_plane"}


@pytest.mark.parametrize(
    ("kind", "unit", "meaning"),
    [
        ("metric", "1/px", "focal length"),
        ("inverse", "m", "baseline"),
        ("affine_inverse", "m", "baseline"),
        ("ground_plane", "m", "camera height"),
    ],
)
def test_k_is_the_physical_number_of_the_design(kind, unit, meaning):
    assert LAWS[kind].k_unit == unit
    assert meaning in LAWS[kind].k_meaning


def test_laws_cannot_be_set():
    with pytest.raises(AttributeError):
        LAWS["metric"].inverse = True


@pytest.mark.parametrize(
    ("kind", "value", "shift", "k"),
    [
        pytest.param("metric", 17.5, 0.0, 1 / 700, id="metres, k = 1 / focal length"),
        pytest.param("relative", 35.0, 0.0, 0.5 / 700, id="half metres, k = 0.5 / focal length"),
        pytest.param("inverse", 20.0, 0.0, 0.5, id="disparity, k = baseline"),
        pytest.param("affine_inverse", 13.0, 7.0, 0.5, id="disparity less 7, k = baseline"),
        pytest.param("ground_plane", 260.0, -200.0, 1.5, id="foot 60 px under the horizon"),
    ],
)
def test_height_per_pixel_is_k_times_relative_distance(kind, value, shift, k):
    # focal length 700 px, baseline 0.5 m, object at 17.5 m; or camera 1.5 m above the ground
    expected = 1.5 / 60 if kind == "ground_plane" else 17.5 / 700
    assert k * LAWS[kind].relative_distance(value, shift) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("kind", sorted(LAWS))
def test_relative_distance_keeps_the_shape_and_is_float64(kind):
    values = np.array([[2.0, 4.0, 8.0]], dtype=np.float32)
    found = LAWS[kind].relative_distance(values)
    assert found.dtype == np.float64
    assert found.shape == (1, 3)
    expected = 1 / values if LAWS[kind].inverse else values
    assert found == pytest.approx(expected.astype(np.float64), rel=1e-12)


@pytest.mark.parametrize("kind", ["metric", "relative", "inverse"])
def test_missing_values_have_no_distance(kind):
    assert math.isnan(LAWS[kind].relative_distance(np.array([math.nan]))[0])


@pytest.mark.parametrize("kind", sorted(LAWS))
@given(distance=st.floats(1e-3, 1e4), part=st.floats(-5.0, 0.9))
def test_value_at_and_relative_distance_invert_each_other(kind, distance, part):
    shift = part / distance
    if not LAWS[kind].inverse:
        assume(1 / distance > shift)
    value = LAWS[kind].value_at(distance, shift)
    assert type(value) is float
    back = float(LAWS[kind].relative_distance(value, shift))
    assert back == pytest.approx(distance, rel=1e-12)


@pytest.mark.parametrize("kind", sorted(LAWS))
def test_the_shift_is_zero_unless_given(kind):
    law = LAWS[kind]
    assert law.value_at(4.0) == law.value_at(4.0, 0.0) == (0.25 if law.inverse else 4.0)
    assert law.relative_distance(law.value_at(4.0)) == 4.0


@pytest.mark.parametrize("kind", sorted(LAWS))
@given(value=st.floats(1e-3, 1e4), shift=st.floats(0.0, 10.0))
def test_pixels_per_metre_are_linear_in_inverse_depth_plus_shift(kind, value, shift):
    inverse_depth = value if LAWS[kind].inverse else 1 / value
    pixels_per_metre = 1 / float(LAWS[kind].relative_distance(value, shift))
    assert pixels_per_metre == pytest.approx(inverse_depth + shift, rel=1e-12)


def test_plausible_focal_lengths_are_those_of_the_design():
    assert PLAUSIBLE_FOCAL == (0.3, 6.0)


@pytest.mark.parametrize("fov_deg", [118.0, 9.6, 60.0])
def test_plausible_focal_lengths_hold_every_photo_lens(fov_deg):
    low, high = PLAUSIBLE_FOCAL
    focal_in_sides = 0.5 / math.tan(math.radians(fov_deg / 2))
    assert low <= focal_in_sides * (1 + 1e-3)
    assert focal_in_sides <= high


@pytest.mark.parametrize("factor", [100.0, 256.0, 1000.0])
def test_no_mistaken_unit_leaves_a_normal_lens_plausible(factor):
    low, high = PLAUSIBLE_FOCAL
    assert not low <= factor * 1.0 <= high
    assert not low <= 1.0 / factor <= high
