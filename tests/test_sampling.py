"""Which pixel of a depth map stands for an object: surfaces, gaps, masks and invariance."""

import math
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from imgscale import DepthMap
from imgscale.sampling import map_window, sample_surface

DATA = Path(os.environ.get("IMGSCALE_DATA", Path(__file__).parents[2] / "shared" / "data"))
FULL = (0.0, 0.0, 40.0, 40.0)  # a box over a 40 x 40 map, whose core is [10:30, 10:30]
CORE = (slice(10, 30), slice(10, 30))


def sample(values, box=FULL, *, kind="metric", image_size=None, mask=None):
    """Sample as the library does, the side of nearness given by the kind."""
    values = np.asarray(values, dtype=np.float64)
    height, width = values.shape
    return sample_surface(
        values,
        box,
        kind=kind,
        image_size=image_size or (width, height),
        nearness=-1 if kind in {"metric", "relative"} else 1,
        mask=mask,
    )


def with_core(*parts, outside=99.0):
    """Fill a map whose 400 core pixels hold each depth on its number of pixels."""
    assert sum(count for _, count in parts) == 400
    filled = np.concatenate([np.full(count, depth) for depth, count in parts])
    values = np.full((40, 40), outside)
    values[CORE] = np.random.default_rng(0).permutation(filled).reshape(20, 20)
    return values


# --- one surface ---


def test_a_flat_surface_has_its_own_depth_without_spread():
    found = sample(np.full((40, 40), 4.25))
    assert (found.value, found.mixed) == (4.25, False)
    assert found.rel_std == pytest.approx(0.0, abs=1e-12)


def test_numbers_come_back_as_plain_python():
    found = sample(np.full((40, 40), 4.25))
    assert (type(found.value), type(found.rel_std), type(found.mixed)) == (float, float, bool)


def test_only_the_central_half_of_the_box_counts():
    values = np.full((40, 40), 1.0)
    values[CORE] = 3.0
    found = sample(values)
    assert (found.value, found.mixed) == (3.0, False)


def test_the_core_ends_exactly_at_a_quarter_of_the_box():
    values = np.full((32, 32), math.nan)
    values[10:14, 10:14] = 3.0  # the core of the box below
    values[9, :] = values[14, :] = 1.0  # one row beyond it on either side
    values[:, 9] = values[:, 14] = 1.0
    found = sample(values, (8, 8, 16, 16))
    assert found.value == 3.0
    assert found.rel_std == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("left", "first"),
    [pytest.param(10.4, 10, id="centre inside"), pytest.param(10.6, 11, id="centre outside")],
)
@pytest.mark.parametrize("upright", [False, True], ids=["columns", "rows"])
def test_a_pixel_belongs_to_the_core_if_its_centre_does(left, first, upright):
    values = np.full((40, 40), 3.05)  # of the same surface: one such pixel would show as spread
    values[:, first : first + 4] = 3.0
    box = (left - 2, 4, left + 6, 36)  # its core is 4 px wide and begins at `left`
    if upright:
        values, box = values.T, (box[1], box[0], box[3], box[2])
    found = sample(values, box)
    assert found.value == 3.0
    assert found.rel_std == pytest.approx(0.0, abs=1e-12)
    for column in (first, first + 3):  # each of the four counts
        other = np.full((40, 40), 3.0)
        other[:, column] = 3.05
        spread = sample(other.T if upright else other, box).rel_std
        assert spread == pytest.approx(math.sqrt(0.25 * 0.75) * math.log(3.05 / 3), rel=1e-9)


@pytest.mark.parametrize("count", range(1, 13))
def test_the_depth_is_the_lower_quartile_counted_from_the_near_side(count):
    depths = 4.0 * (1 + 0.003 * np.arange(count))
    expected = np.quantile(depths, 0.25, method="lower")
    values = np.full((1, 60), math.nan)
    values[0, 20 : 20 + count] = np.random.default_rng(count).permutation(depths)
    assert sample(values, (0, 0, 60, 1)).value == expected
    assert sample(1 / values, (0, 0, 60, 1), kind="inverse").value == 1 / expected


def test_columns_follow_x_and_rows_follow_y():
    values = np.full((30, 60), 50.0)
    values[4:8, 40:52] = 6.0
    assert sample(values, (40, 4, 52, 8)).value == 6.0
    assert sample(values, (4, 4, 8, 28)).value == 50.0


def test_the_depth_is_taken_a_quarter_of_the_way_into_the_surface():
    depths = 4.0 * (1 + 0.0001 * np.arange(400))  # 4 % deep: one surface
    values = with_core(*((depth, 1) for depth in depths))
    found = sample(values)
    assert found.value == pytest.approx(depths[99], rel=2e-4)
    assert np.quantile(depths, 0.2) < found.value < np.quantile(depths, 0.3)


def test_spread_of_the_surface_is_that_of_its_log_depths():
    found = sample(with_core((4.0, 200), (4.0 * 1.02, 200)))
    assert found.rel_std == pytest.approx(math.log(1.02) / 2, rel=1e-9)


def test_a_slanted_surface_is_still_the_surface():
    ramp = np.linspace(4.0, 4.2, 20)
    values = np.full((40, 40), 30.0)
    values[CORE] = ramp[np.newaxis, :]
    found = sample(values)
    assert 4.0 < found.value < 4.1
    assert not found.mixed


# --- what else is in the box ---


def test_background_does_not_draw_the_depth_back():
    found = sample(with_core((5.0, 300), (40.0, 100)))
    assert (found.value, found.mixed) == (5.0, False)


def test_an_occluder_does_not_draw_the_depth_forward():
    found = sample(with_core((5.0, 300), (1.5, 100)))
    assert (found.value, found.mixed) == (5.0, False)


def test_scattered_background_does_not_add_up_to_a_surface():
    far = tuple((20.0 * 1.1**i, 10) for i in range(25))
    found = sample(with_core((5.0, 150), *far))
    assert found.value == 5.0
    assert found.mixed


@pytest.mark.parametrize(
    "parts",
    [
        pytest.param(((5.0, 240), (1.5, 160)), id="occluder on 40 %"),
        pytest.param(((5.0, 240), (40.0, 160)), id="background on 40 %"),
        pytest.param(((5.0, 240), (1.5, 80), (40.0, 80)), id="20 % of each"),
    ],
)
def test_a_large_part_on_another_surface_is_reported_as_mixed(parts):
    found = sample(with_core(*parts))
    assert (found.value, found.mixed) == (5.0, True)


@pytest.mark.parametrize(
    "parts",
    [
        pytest.param(((5.0, 244), (1.5, 156)), id="occluder on 39 %"),
        pytest.param(((5.0, 244), (40.0, 156)), id="background on 39 %"),
        pytest.param(((5.0, 244), (1.5, 78), (40.0, 78)), id="19.5 % of each"),
        pytest.param(((5.0, 320), (1.5, 40), (40.0, 40)), id="10 % of each"),
    ],
)
def test_a_small_part_on_either_side_is_not_mixed(parts):
    found = sample(with_core(*parts))
    assert (found.value, found.mixed) == (5.0, False)


@pytest.mark.parametrize(("apart", "mixed"), [(1.09, False), (1.11, True), (1.2, True)])
@pytest.mark.parametrize("nearer", [False, True], ids=["farther", "nearer"])
def test_parts_of_one_object_less_than_a_tenth_apart_are_not_mixed(apart, nearer, mixed):
    found = sample(with_core((5.0, 240), (5.0 / apart if nearer else 5.0 * apart, 160)))
    assert (found.value, found.mixed) == (5.0, mixed)


def test_of_two_equal_surfaces_the_nearer_is_taken():
    found = sample(with_core((5.0, 200), (9.0, 200)))
    assert (found.value, found.mixed) == (5.0, True)


def test_missing_pixels_are_no_surface():
    values = with_core((5.0, 100), (math.nan, 100), (0.0, 100), (-1.0, 50), (math.inf, 50))
    found = sample(values)
    assert (found.value, found.mixed) == (5.0, False)


# --- gaps ---


def test_a_map_filled_to_four_percent_gives_the_surface():
    rng = np.random.default_rng(5)
    values = np.full((200, 200), math.nan)
    filled = rng.random(values.shape) < 0.04
    values[filled] = 60.0
    box = (40, 40, 160, 160)
    on_object = np.zeros_like(filled)
    on_object[50:150, 50:150] = True  # the object leaves a rim of background in its box
    values[filled & on_object] = rng.uniform(7.5, 7.6, np.count_nonzero(filled & on_object))
    found = sample(values, box)
    assert 7.5 <= found.value <= 7.6
    assert not found.mixed


def test_where_the_core_is_empty_the_whole_box_serves():
    values = np.full((40, 40), math.nan)
    values[2, 3] = 8.0
    assert sample(values).value == 8.0


def test_one_valid_pixel_in_the_core_beats_many_around_it():
    values = np.full((40, 40), 2.0)
    values[CORE] = math.nan
    values[20, 20] = 8.0
    assert sample(values).value == 8.0


@pytest.mark.parametrize("missing", [math.nan, math.inf, -math.inf, 0.0, -3.0])
@pytest.mark.parametrize("kind", ["metric", "relative", "inverse"])
def test_an_object_without_a_valid_pixel_has_no_depth(missing, kind):
    values = np.full((40, 40), missing)
    values[30:, 30:] = 5.0  # depth elsewhere in the map
    found = sample(values, (2, 2, 25, 25), kind=kind)
    assert math.isnan(found.value)
    assert math.isnan(found.rel_std)
    assert not found.mixed


# --- maps and images of different sizes ---


@pytest.mark.parametrize(
    ("image_size", "box"),
    [
        pytest.param((32, 32), (8, 8, 16, 16), id="same"),
        pytest.param((128, 128), (32, 32, 64, 64), id="image four times larger"),
        pytest.param((128, 64), (32, 16, 64, 32), id="squeezed"),
        pytest.param((16, 16), (4, 4, 8, 8), id="image smaller than the map"),
    ],
)
def test_the_box_is_scaled_to_the_map(image_size, box):
    values = np.full((32, 32), math.nan)
    values[10:14, 10:14] = 3.0
    values[9, :] = values[14, :] = 1.0
    values[:, 9] = values[:, 14] = 1.0
    found = sample(values, box, image_size=image_size)
    assert found.value == 3.0
    assert found.rel_std == pytest.approx(0.0, abs=1e-12)


@given(x=st.floats(0.01, 3.99), y=st.floats(0.01, 3.99), size=st.floats(0.001, 0.2))
def test_a_box_smaller_than_a_map_pixel_takes_the_pixel_that_holds_its_centre(x, y, size):
    values = 10.0 * np.arange(1, 5)[:, np.newaxis] + np.arange(4)
    for centre in (x, y):  # clear of the borders between pixels
        assume(abs(centre - round(centre)) > size)
    box = tuple(100 * edge for edge in (x - size / 2, y - size / 2, x + size / 2, y + size / 2))
    assert sample(values, box, image_size=(400, 400)).value == values[int(y), int(x)]


def test_a_thin_pole_between_pixel_centres_is_found():
    values = np.full((40, 40), 30.0)
    values[:, 20] = 6.0
    assert sample(values, (20.6, 4, 20.9, 36)).value == 6.0


def test_missing_pixels_are_not_filled_from_their_neighbours():
    values = np.full((4, 4), 7.0)
    values[2, 1] = math.nan
    assert math.isnan(sample(values, (110, 210, 120, 230), image_size=(400, 400)).value)


@pytest.mark.parametrize(
    ("box", "inside"),
    [
        pytest.param((-1, -1, 8, 8), (slice(0, 7), slice(0, 7)), id="left top"),
        pytest.param((32, 32, 41, 41), (slice(33, 40), slice(33, 40)), id="right bottom"),
        pytest.param((30, 10, 50, 20), (slice(12, 18), slice(35, 40)), id="half outside"),
    ],
)
def test_a_box_over_the_border_is_sampled_inside_the_map(box, inside):
    values = np.full((40, 40), 20.0)
    values[inside] = 7.0
    found = sample(values, box)
    assert (found.value, found.mixed) == (7.0, False)


@pytest.mark.parametrize(
    ("box", "place"),
    [
        pytest.param((40.1, 10.2, 40.9, 10.8), (10, 39), id="right"),
        pytest.param((-0.9, 10.2, -0.1, 10.8), (10, 0), id="left"),
        pytest.param((10.2, 40.1, 10.8, 40.9), (39, 10), id="below"),
        pytest.param((10.2, -0.9, 10.8, -0.1), (0, 10), id="above"),
    ],
)
def test_a_box_a_pixel_beyond_the_border_takes_the_pixel_beside_it(box, place):
    values = np.full((40, 40), 20.0)
    values[place] = 7.0
    assert sample(values, box).value == 7.0


def test_a_map_of_one_pixel_serves_every_box():
    assert sample([[5.0]], (10, 10, 90, 90), image_size=(100, 100)).value == 5.0


def test_a_huge_box_gives_the_surface_too():
    rng = np.random.default_rng(2)
    values = rng.uniform(8.0, 8.1, (900, 1200))
    values[:, 560:640] = 1.0  # a pole through the middle
    found = sample(values, (0, 0, 1200, 900))
    assert 8.0 <= found.value <= 8.1
    assert not found.mixed


# --- masks ---


def test_a_mask_keeps_an_occluder_out():
    values = with_core((5.0, 100), (1.5, 300))
    found = sample(values, mask=values == 5.0)
    assert (found.value, found.mixed) == (5.0, False)
    assert found.rel_std == pytest.approx(0.0, abs=1e-12)


def test_a_mask_is_used_on_the_whole_box_not_only_its_core():
    values = np.full((40, 40), 2.0)
    mask = np.zeros((40, 40), np.bool_)
    mask[2:5, 2:38] = True
    values[mask] = 6.0
    assert sample(values, mask=mask).value == 6.0


def test_a_mask_beyond_the_box_is_cut_by_the_box():
    values = np.full((40, 40), 9.0)
    values[15:20, 15:20] = 4.0
    found = sample(values, (15, 15, 20, 20), mask=np.ones((40, 40), np.bool_))
    assert (found.value, found.mixed) == (4.0, False)


def test_an_object_without_depth_on_its_mask_takes_none_from_around_it():
    values = np.full((40, 40), 5.0)
    mask = np.zeros((40, 40), np.bool_)
    mask[15:20, 15:20] = True
    values[mask] = math.nan
    assert math.isnan(sample(values, mask=mask).value)


@pytest.mark.parametrize("factor", [2, 4])
def test_a_mask_of_the_image_serves_a_smaller_map(factor):
    values = np.full((40, 40), 2.0)
    values[5:15, 25:35] = 6.0
    mask = np.zeros((40 * factor, 40 * factor), np.bool_)
    mask[5 * factor : 15 * factor, 25 * factor : 35 * factor] = True
    size = (40 * factor, 40 * factor)
    box = (20 * factor, 0, 40 * factor, 20 * factor)
    found = sample(values, box, image_size=size, mask=mask)
    assert found.value == 6.0
    assert found.rel_std == pytest.approx(0.0, abs=1e-12)


def test_a_mask_of_the_image_serves_a_larger_map():
    values = np.full((40, 40), 2.0)
    values[10:20, 30:40] = 6.0
    mask = np.zeros((20, 20), np.bool_)
    mask[5:10, 15:20] = True
    found = sample(values, (10, 0, 20, 20), image_size=(20, 20), mask=mask)
    assert found.value == 6.0
    assert found.rel_std == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("upright", [False, True], ids=["columns", "rows"])
def test_a_map_pixel_is_on_the_mask_if_its_centre_is(upright):
    values = np.full((20, 40), 6.0)
    values[:, 30] = 3.0  # in the image, columns 120 to 123 with their centre in column 122
    box = (116, 0, 124, 40)
    for end, expected in ((122, 6.0), (123, 3.0)):  # of equal surfaces the nearer is taken
        mask = np.zeros((40, 160), np.bool_)
        mask[:, :end] = True
        found = (
            sample(values.T, (0, 116, 40, 124), image_size=(40, 160), mask=mask.T)
            if upright
            else sample(values, box, image_size=(160, 40), mask=mask)
        )
        assert found.value == expected


def test_a_mask_thinner_than_a_map_pixel_still_finds_a_depth_as_its_box_would():
    values = np.full((20, 20), 6.0)
    mask = np.zeros((200, 200), np.bool_)
    mask[40:160, 101:104] = True  # a pole 3 px wide; a pixel of the map is 10 px wide
    box = (101, 40, 104, 160)
    assert sample(values, box, image_size=(200, 200)).value == 6.0
    assert sample(values, box, image_size=(200, 200), mask=mask).value == 6.0


# --- every version of one map gives the same pixel ---


def scene(seed):
    """Make a scene of surfaces, slopes, noise and gaps, as z-depth."""
    rng = np.random.default_rng(seed)
    surfaces = rng.uniform(1.5, 60.0, 4)
    z = surfaces[rng.choice(4, (40, 40), p=[0.45, 0.3, 0.15, 0.1])]
    z = z * np.exp(rng.normal(0, 0.02, z.shape)) + np.linspace(0, 1, 40)
    z[rng.random(z.shape) < rng.uniform(0, 0.97)] = math.nan
    return z


@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 10_000), factor=st.floats(1e-4, 1e4), masked=st.booleans())
def test_scaling_and_inverting_the_map_sample_the_same_pixel(seed, factor, masked):
    z = scene(seed)
    mask = np.random.default_rng(seed).random(z.shape) < 0.5 if masked else None
    box = (3.3, 2.1, 37.9, 33.3)
    metric = sample(z, box, mask=mask)
    relative = sample(factor * z, box, kind="relative", mask=mask)
    inverse = sample(factor / z, box, kind="inverse", mask=mask)
    if math.isnan(metric.value):
        assert math.isnan(relative.value)
        assert math.isnan(inverse.value)
        return
    assert relative.value / factor == pytest.approx(metric.value, rel=1e-12)
    assert factor / inverse.value == pytest.approx(metric.value, rel=1e-12)
    assert relative.rel_std == pytest.approx(metric.rel_std, rel=1e-6, abs=1e-12)
    assert inverse.rel_std == pytest.approx(metric.rel_std, rel=1e-6, abs=1e-12)
    assert metric.mixed == relative.mixed == inverse.mixed


@settings(deadline=None, max_examples=100)
@given(
    z=arrays(np.float64, (8, 8), elements=st.floats(0.5, 80.0)),
    factor=st.floats(1e-3, 1e3),
)
def test_invariance_holds_for_any_map(z, factor):
    box = (0, 0, 8, 8)
    metric = sample(z, box).value
    relative = sample(factor * z, box, kind="relative").value
    inverse = sample(factor / z, box, kind="inverse").value
    assert relative / factor == pytest.approx(metric, rel=1e-12)
    assert factor / inverse == pytest.approx(metric, rel=1e-12)


@settings(deadline=None, max_examples=100)
@given(z=arrays(np.float64, (8, 8), elements=st.floats(0.5, 80.0)), seed=st.integers(0, 99))
def test_the_sample_is_a_value_of_the_core_and_forgets_the_order_of_pixels(z, seed):
    core = z[2:6, 2:6]
    shuffled = z.copy()
    shuffled[2:6, 2:6] = np.random.default_rng(seed).permutation(core.ravel()).reshape(4, 4)
    found = sample(z, (0, 0, 8, 8))
    assert found.value in core
    assert sample(shuffled, (0, 0, 8, 8)).value == found.value


@settings(deadline=None, max_examples=50)
@given(seed=st.integers(0, 10_000))
def test_mirrored_scenes_have_the_same_depth(seed):
    z = scene(seed)
    straight, mirrored = sample(z).value, sample(z[::-1, ::-1]).value
    assert straight == pytest.approx(mirrored, rel=0, abs=0, nan_ok=True)


def test_lidar_on_real_cars_lies_on_the_near_half_of_their_3d_labels():
    folder = DATA / "kitti" / "object" / "training"
    maps = sorted((folder / "lidar_depth").glob("*.png"))
    if not maps:
        pytest.skip(f"no KITTI LiDAR maps in {DATA}; set IMGSCALE_DATA")
    from PIL import Image  # noqa: PLC0415 - only where there is data

    places, pairs = [], []
    for file in maps:
        with Image.open(file) as image:
            z = np.asarray(image) / 256
        DepthMap(z, kind="metric")  # 4 % filled, and lawful
        for line in (folder / "label_2" / f"{file.stem}.txt").read_text().splitlines():
            kind, *words = line.split()
            cut, hidden, _, x1, y1, x2, y2, _, width, length, _, _, centre, yaw = map(float, words)
            if kind != "Car" or cut > 0 or hidden > 1 or y2 - y1 < 25:
                continue
            near = centre - abs(length / 2 * math.sin(yaw)) - abs(width / 2 * math.cos(yaw))
            found = sample(z, (x1, y1, x2, y2))
            with np.errstate(divide="ignore"):
                inverse = sample(3 / z, (x1, y1, x2, y2), kind="inverse")
            pairs.append((found.value, 3 / inverse.value))
            places.append((found.value - near) / (centre - near))  # 0 nearest corner, 1 centre
    assert len(places) >= 10
    assert np.allclose(*np.transpose(pairs), rtol=1e-12, atol=0)
    assert all(-0.2 < place < 0.5 for place in places)


# --- the definition, written out ---


def written_out(values, nearness, origin):
    """Try every window, one pixel after another."""
    far = sorted((value for value in values), key=lambda value: -nearness * value)
    logs = [-nearness * math.log(value - origin) for value in far]
    inside = [sum(start <= log <= start + 0.06 for log in logs) for start in logs]
    count = max(inside)
    start = inside.index(count)
    place = start + int(0.25 * (count - 1))
    others = sum(abs(log - logs[place]) > math.log(1.1) for log in logs)
    return far[place], np.std(logs[start : start + count]), others / len(logs) >= 0.4


def pixels(rng, size, scatter):
    """Depths of two or three surfaces, and some anywhere."""
    places = rng.choice(rng.uniform(1, 20, 3), size)
    depths = places * np.exp(rng.normal(0, scatter, size))
    return np.where(rng.random(size) < 0.2, rng.uniform(1, 20, size), depths)


@pytest.mark.parametrize("size", [1, 2, 3, 16, 17, 31, 33, 64, 130])
@pytest.mark.parametrize(
    ("kind", "nearness", "origin"),
    [
        ("metric", -1, 0.0),
        ("inverse", 1, 0.0),
        ("affine_inverse", 1, -3.0),
        ("affine_inverse", 1, 0.5),
    ],
)
@pytest.mark.parametrize("scatter", [0.005, 0.02, 0.2])
def test_the_sample_is_that_of_all_windows_tried_in_turn(size, kind, nearness, origin, scatter):
    rng = np.random.default_rng([size, round(1000 * scatter)])
    for _ in range(2):
        values = pixels(rng, size, scatter)
        found = sample_surface(
            values[None, :],
            (0.0, 0.0, float(size), 1.0),
            kind=kind,
            image_size=(size, 1),
            nearness=nearness,
            origin=origin,
            mask=np.ones((1, size), dtype=np.bool_),
        )
        value, spread, mixed = written_out(values.tolist(), nearness, origin)
        assert found.value == value
        assert found.rel_std == pytest.approx(spread, abs=1e-12)
        assert found.mixed == mixed


@pytest.mark.parametrize("size", [5, 16, 48, 160])
def test_of_windows_with_equally_many_pixels_the_nearest_is_taken(size):
    depths = np.tile(2.0 * 1.2 ** np.arange(5), size)
    found = sample_surface(
        depths[None, :],
        (0.0, 0.0, float(depths.size), 1.0),
        kind="metric",
        image_size=(depths.size, 1),
        nearness=-1,
        mask=np.ones((1, depths.size), dtype=np.bool_),
    )
    assert (found.value, found.mixed) == (2.0, True)


@pytest.mark.parametrize(
    ("kind", "valid"),
    [
        ("metric", [2.0]),
        ("relative", [2.0]),
        ("inverse", [2.0]),
        ("affine_inverse", [-5.0, 0.0, 2.0]),
    ],
)
def test_only_values_that_are_depths_of_the_kind_are_seen(kind, valid):
    values = np.array([[-5.0, 0.0, 2.0, math.inf, math.nan, -math.inf]])
    found = sample_surface(
        values,
        (0.0, 0.0, 6.0, 1.0),
        kind=kind,
        image_size=(6, 1),
        nearness=1,
        origin=-6.0,
        mask=np.ones((1, 6), dtype=np.bool_),
    )
    expected = written_out(valid, 1, -6.0)
    assert found.value == expected[0]
    assert found.mixed == expected[2]


@pytest.mark.parametrize("away", [-30.0, -8.0, -3.0, 9.0, 12.0, 50.0])
@pytest.mark.parametrize("side", [0.2, 1.0, 2.0, 3.0])
def test_the_window_of_a_box_beside_the_map_is_the_nearest_pixel(away, side):
    rows, columns = map_window((9, 9), (away, 2.0, away + side, 4.0), (9, 9))
    assert (rows, columns) == (slice(2, 4), slice(0, 1) if away < 0 else slice(8, 9))


@pytest.mark.parametrize("size", [17, 18, 19, 20, 33, 34, 35, 36])
def test_one_near_pixel_leaves_the_whole_of_the_surface_behind_it(size):
    depths = np.append(1.0, 2 * np.exp(np.linspace(0, 0.05, size - 1)))
    box, mask = (0.0, 0.0, float(size), 1.0), np.ones((1, size), dtype=np.bool_)
    found = sample_surface(
        depths[None, :], box, kind="metric", image_size=(size, 1), nearness=-1, mask=mask
    )
    assert found.value == depths[1 + (size - 2) // 4]
    assert found.rel_std == pytest.approx(np.std(np.log(depths[1:])), rel=1e-9)
