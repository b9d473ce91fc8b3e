"""The law `p / H = (D + b) / k` of every kind, against fractions and its own definition."""

import math
from fractions import Fraction

import numpy as np
import pytest

from imgscale.laws import LAWS, PLAUSIBLE_FOCAL

# The table of docs/theory.md: whether a larger value is nearer, and whether the shift is unknown.
KINDS = {
    "metric": (False, False),
    "relative": (False, False),
    "inverse": (True, False),
    "affine_inverse": (True, True),
    "ground_plane": (True, True),
}
VALUES = [Fraction(5, 4), Fraction(3), Fraction(70)]
SHIFTS = [Fraction(0), Fraction(1), Fraction(-1, 128), Fraction(5, 2)]
every_kind = pytest.mark.parametrize("kind", KINDS)
every_shift = pytest.mark.parametrize("shift", SHIFTS, ids=str)


def exact_inverse_depth(kind, value):
    return value if KINDS[kind][0] else 1 / value


def exact_distance(kind, value, shift):
    return 1 / (exact_inverse_depth(kind, value) + shift)


def floats(numbers):
    return [float(number) for number in numbers]


def test_the_laws_are_those_of_the_table():
    assert {kind: (law.inverse, law.has_shift) for kind, law in LAWS.items()} == KINDS
    assert all(law.kind == kind for kind, law in LAWS.items())


def test_k_is_a_length_where_depth_is_inverse_and_one_over_pixels_where_it_is_metric():
    assert LAWS["metric"].k_unit == "1/px"
    assert {law.k_unit for law in LAWS.values() if law.inverse} == {"m"}


@every_kind
def test_inverse_depth_is_linear_in_nearness(kind):
    found = LAWS[kind].inverse_depth(np.array(floats(VALUES)))
    assert found.tolist() == pytest.approx(
        floats(exact_inverse_depth(kind, value) for value in VALUES), rel=1e-15
    )


@every_kind
def test_inverse_depth_keeps_what_is_unknown(kind):
    assert np.isnan(LAWS[kind].inverse_depth(math.nan))


@every_kind
@every_shift
def test_relative_distance_is_one_over_shifted_inverse_depth(kind, shift):
    found = LAWS[kind].relative_distance(floats(VALUES), float(shift))
    assert found.tolist() == pytest.approx(
        floats(exact_distance(kind, value, shift) for value in VALUES), rel=1e-14
    )


@every_kind
def test_without_a_shift_it_is_none(kind):
    law = LAWS[kind]
    for value in floats(VALUES):
        assert law.relative_distance(value) == law.relative_distance(value, 0.0)
        distance = float(law.relative_distance(value))
        assert law.value_at(distance) == law.value_at(distance, 0.0)
        assert law.value_at(distance) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize("kind", ["metric", "relative"])
def test_a_depth_without_a_shift_is_its_own_distance_to_the_last_bit(kind):
    depths = np.random.default_rng(0).uniform(1e-3, 1e3, 500)
    assert np.array_equal(LAWS[kind].relative_distance(depths), depths)


@every_kind
@every_shift
def test_value_at_inverts_relative_distance(kind, shift):
    for value in VALUES:
        distance = float(exact_distance(kind, value, shift))
        assert LAWS[kind].value_at(distance, float(shift)) == pytest.approx(float(value), rel=1e-13)


@every_kind
@every_shift
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_scale_map_holds_k_times_the_distance_in_its_own_precision(kind, shift, dtype):
    k = Fraction(3, 8)
    scale = np.full(len(VALUES), np.nan, dtype)
    LAWS[kind].scale_into(scale, np.array(floats(VALUES), dtype), float(k), float(shift))
    expected = floats(k * exact_distance(kind, value, shift) for value in VALUES)
    np.testing.assert_allclose(scale, expected, rtol=4 * np.finfo(dtype).eps)


@every_kind
def test_the_law_gives_the_pixels_that_an_object_shows(kind):
    k, height, value, shift = Fraction(1, 700), Fraction(7, 4), Fraction(10), Fraction(1, 32)
    pixels = height * (exact_inverse_depth(kind, value) + shift) / k
    scale = np.empty(1)
    LAWS[kind].scale_into(scale, np.array([float(value)]), float(k), float(shift))
    assert scale[0] * float(pixels) == pytest.approx(float(height), rel=1e-14)


@pytest.mark.parametrize("kind", ["affine_inverse", "ground_plane"])
def test_far_away_a_single_precision_scale_map_keeps_the_small_difference(kind):
    value, shift = np.float32(1000.0), -999.9999
    scale = np.empty(1, np.float32)
    LAWS[kind].scale_into(scale, np.array([value]), 1.0, shift)
    assert scale[0] == pytest.approx(1 / (1000 - 999.9999), rel=1e-6)


def test_plausible_focal_lengths_are_fields_of_view_of_118_to_9_and_a_half_degrees():
    view = [math.degrees(2 * math.atan(0.5 / focal)) for focal in PLAUSIBLE_FOCAL]
    assert view == pytest.approx([118, 9.5], abs=0.1)
