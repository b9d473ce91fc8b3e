"""Scale bar, scale map and residuals: lengths against closed forms, words against the numbers."""

import math
import re
from functools import cache
from itertools import combinations, pairwise

import numpy as np
import pytest
import skimage as ski
from hypothesis import given
from hypothesis import strategies as st

import imgscale as ims
from imgscale.datasets import motorcycle

pytest.importorskip("matplotlib", reason="matplotlib is not installed")

from matplotlib.colors import LogNorm
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure

from imgscale.plotting.residuals import draw_residuals
from imgscale.plotting.scale_bar import draw_scale_bar, length_text, round_length
from imgscale.plotting.scale_map import contour_levels, draw_scale_map

WIDTH, HEIGHT = 640, 480
FOCAL = 500.0
CAMERA = ims.Camera(FOCAL, focal_rel_std=0.02)
DOOR = ims.Detection("door", (100, 100, 180, 300))
TABLE = ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.04)])


def metric(values, **options):
    """A metric map with its camera alone: k is 1 / focal length."""
    depth = ims.DepthMap(np.asarray(values, dtype=float), kind="metric", **options)
    return ims.fit([], depth, camera=CAMERA), depth


@cache
def wall():
    return metric(np.full((HEIGHT, WIDTH), 4.0))


@cache
def scene():
    loaded = motorcycle.load()
    model = ims.fit(
        loaded.detections, loaded.depth, loaded.priors, noise=loaded.noise, camera=loaded.camera
    )
    return loaded, model


def bar_of(ax, index=-1):
    """Ends of a drawn bar, in pixels of the photo."""
    bars = [line for line in ax.lines if line.get_marker() == "|"]
    return np.asarray(bars[index].get_xdata()) + 0.5


def length_px(ax):
    return float(np.ptp(bar_of(ax)))


# --- round lengths -------------------------------------------------------------------------------


@given(st.floats(-9, 9), st.sampled_from([1, 2, 5]))
def test_round_lengths_are_one_two_or_five_times_a_power_of_ten(exponent, lead):
    length = 10.0**exponent
    rounded = round_length(length)
    digits = re.sub(r"[.0]|e.*", "", f"{rounded:.12e}")
    assert digits in {"1", "2", "5"}
    # neighbours are a factor 2 or 2.5 apart
    assert math.sqrt(0.4) - 1e-9 <= rounded / length <= math.sqrt(2.5) + 1e-9
    exact = float(f"{lead}e{math.floor(exponent)}")
    assert round_length(exact) == exact


@pytest.mark.parametrize(
    ("length_m", "text"),
    [(0.0005, "0.5 mm"), (0.002, "2 mm"), (0.01, "1 cm"), (0.5, "50 cm"), (1.0, "1 m"),
     (500.0, "500 m"), (2000.0, "2 km")],
)  # fmt: skip
def test_lengths_are_written_in_the_unit_that_reads(length_m, text):
    assert length_text(length_m) == text


def test_lengths_are_written_in_the_unit_asked_for():
    assert length_text(0.3048, "ft") == "1 ft"
    assert length_text(2.0, "mm") == "2000 mm"


# --- the scale bar -------------------------------------------------------------------------------


@pytest.mark.parametrize("length_m", [0.1, 0.5, 1.0, 3.3])
def test_a_bar_is_its_length_times_focal_length_over_depth_long(length_m):
    model, depth = wall()
    ax = draw_scale_bar(model, depth, (320, 200), length_m=length_m)
    assert length_px(ax) == pytest.approx(length_m * FOCAL / 4.0, rel=1e-12)


@pytest.mark.parametrize("distance", [0.02, 0.3, 4.0, 70.0, 9000.0])
def test_a_bar_takes_a_seventh_to_a_third_of_the_width(distance):
    model, depth = metric(np.full((HEIGHT, WIDTH), distance))
    ax = draw_scale_bar(model, depth, (320, 240))
    assert 0.12 * WIDTH < length_px(ax) < 0.32 * WIDTH
    x1, x2 = bar_of(ax)
    assert 0 < x1 < x2 < WIDTH


def test_the_label_says_length_error_and_distance():
    model, depth = wall()
    ax = draw_scale_bar(model, depth, (320, 200))
    # 2 % of the focal length, and of the depth, of whose error nobody told, some 5 %
    first, second = ax.texts[0].get_text().split("\n")
    assert re.fullmatch(r"1 m \+- (5\.[2-9]|6\.\d) %", first)
    assert second == "only at 4 m"


def test_the_error_of_a_bar_holds_that_of_a_told_depth():
    depth = ims.DepthMap(np.full((HEIGHT, WIDTH), 4.0), kind="metric")
    noise = ims.Noise(depth_rel=0.03, box_px=4.0, box_rel=0.1)
    model = ims.fit([], depth, camera=CAMERA, noise=noise)
    text = draw_scale_bar(model, depth, (320, 200)).texts[0].get_text()
    # the error of boxes is none of the bar's
    assert text.startswith(f"1 m +- {100 * math.hypot(0.02, 0.03):.2g} %")


def test_without_a_focal_length_the_label_names_the_object_or_this_distance():
    depth = ims.DepthMap(np.full((HEIGHT, WIDTH), 4.0), kind="relative")
    model = ims.fit([DOOR], depth, TABLE)
    at_object = draw_scale_bar(model, depth, DOOR).texts[0].get_text()
    assert at_object.split("\n")[1] == "only at the door"
    at_pixel = draw_scale_bar(model, depth, (320, 200)).texts[0].get_text()
    assert at_pixel.split("\n")[1] == "only at this distance"


def test_at_an_object_the_bar_has_the_scale_that_predict_gives():
    loaded, model = scene()
    bottle = loaded.detections[3]
    (estimate,) = ims.predict(model, [bottle], loaded.depth)
    ax = draw_scale_bar(model, loaded.depth, bottle, image=loaded.image, length_m=0.5)
    assert length_px(ax) == pytest.approx(0.5 / estimate.metres_per_pixel, rel=1e-9)
    assert f"only at the bottle, at {estimate.distance_m:.1f} m" in ax.texts[0].get_text()


def test_object_depths_serve_for_an_object_and_not_for_a_pixel():
    depth = ims.ObjectDepths([4.0], kind="relative", image_size=(WIDTH, HEIGHT))
    model = ims.fit([DOOR], depth, TABLE)
    ax = draw_scale_bar(model, depth, DOOR, length_m=1.0)
    # the door spans 200 px, and the median of its log-normal size is 2 m over sqrt(1 + 0.02^2)
    assert length_px(ax) == pytest.approx(100.0 * math.sqrt(1 + 0.02**2), rel=1e-9)
    with pytest.raises(TypeError, match=r"`at` must be a Detection unless `depth` is a map; got"):
        draw_scale_bar(model, depth, (320, 200))


def test_a_pixel_takes_the_surface_about_it_and_not_a_stray_value():
    values = np.full((HEIGHT, WIDTH), 4.0)
    values[200, 320] = 40.0
    model, depth = metric(values)
    ax = draw_scale_bar(model, depth, (320.5, 200.5), length_m=1.0)
    assert length_px(ax) == pytest.approx(FOCAL / 4.0)


def test_a_pixel_of_the_image_is_found_in_a_map_of_another_size():
    values = np.full((24, 32), 4.0)
    values[:, 16:] = 8.0
    model, depth = metric(values, image_size=(WIDTH, HEIGHT))
    for x, distance in ((100, 4.0), (500, 8.0)):
        ax = draw_scale_bar(model, depth, (x, 200), length_m=1.0)
        assert length_px(ax) == pytest.approx(FOCAL / distance, rel=1e-12)


def test_a_pixel_without_depth_is_refused_with_the_nearest_that_has_one():
    values = np.full((HEIGHT, WIDTH), np.nan)
    values[100, 50] = 4.0
    model, depth = metric(values)
    law = r"`at` must be a pixel with depth nearby; got \(320\.0, 200\.0\)\. The nearest one is at"
    with pytest.raises(ValueError, match=law + r" \(50, 100\)"):
        draw_scale_bar(model, depth, (320, 200))


def test_an_object_without_depth_is_refused():
    values = np.full((HEIGHT, WIDTH), 4.0)
    values[:, :300] = np.nan
    model, depth = metric(values)
    with pytest.raises(ValueError, match=r"finite distance; got 'door' .* flagged NO_DEPTH"):
        draw_scale_bar(model, depth, DOOR)


@pytest.mark.parametrize("at", [(700, 100), (-1, 5), (np.nan, 5), (1, 2, 3), "ab", None])
def test_what_is_no_pixel_of_the_picture_is_refused(at):
    model, depth = wall()
    with pytest.raises(
        ValueError, match=r"`at` must be a pixel \(x, y\) inside the picture, 640 x"
    ):
        draw_scale_bar(model, depth, at)


def test_a_bar_longer_than_the_picture_is_refused():
    model, depth = wall()
    with pytest.raises(ValueError, match=r"5\.12 m wide at this depth; got 50\.0"):
        draw_scale_bar(model, depth, (320, 200), length_m=50.0)


def test_depth_of_another_picture_is_refused_unless_vouched_for():
    loaded, model = scene()
    other = ims.DepthMap(2 * loaded.depth.values, kind="inverse")
    with pytest.raises(ims.DepthMismatchError, match="the map that the model was fitted to"):
        draw_scale_bar(model, other, (300, 250))
    with pytest.raises(ims.DepthMismatchError, match='kind, "inverse"; got "metric"'):
        draw_scale_map(model, wall()[1])
    ax = draw_scale_bar(model, other, (300, 250), same_scale=True, length_m=0.2)
    first = draw_scale_bar(model, loaded.depth, (300, 250), length_m=0.2)
    assert length_px(ax) == pytest.approx(2 * length_px(first))
    draw_scale_map(model, other, same_scale=True)


def test_on_a_ground_plane_a_pixel_is_a_place_on_the_ground():
    ground = ims.GroundPlane(
        image_size=(WIDTH, HEIGHT), horizon_px=200.0, horizon_std_px=2.0, camera_height_m=1.5,
        camera_height_std_m=0.03, roll_deg=0.0, roll_std_deg=0.001,
    )  # fmt: skip
    model = ims.fit([], ground)
    ax = draw_scale_bar(model, None, (320, 350), length_m=1.0)
    # 150 rows below the horizon are the camera's height
    assert length_px(ax) == pytest.approx(150 / 1.5, rel=1e-3)
    # height, horizon over the rows below it, and 3 % of kerbs and dips
    percent = 100 * math.hypot(0.03 / 1.5, 2.0 / 150, 0.03)
    found = float(ax.texts[0].get_text().split()[3])
    assert found == pytest.approx(percent, rel=0.05)
    with pytest.raises(ValueError, match=r"below the horizon at row 200; got \(320\.0, 150\.0\)"):
        draw_scale_bar(model, None, (320, 150))


@pytest.mark.parametrize("where", ["pixel", "box"])
def test_two_surfaces_at_the_place_are_told(where):
    values = np.full((HEIGHT, WIDTH), 4.0)
    values[:, 140:] = 8.0
    model, depth = metric(values)
    at = (140, 200) if where == "pixel" else DOOR
    words = {"pixel": "two surfaces meet here", "box": "two surfaces in the box"}
    assert draw_scale_bar(model, depth, at).texts[0].get_text().split("\n")[2:] == [words[where]]


@pytest.mark.parametrize("at", [(2, 2), (638, 2), (2, 478), (638, 478), (320, 470)], ids=str)
def test_bar_and_label_stay_inside_the_picture(at):
    model, depth = wall()
    ax = draw_scale_bar(model, depth, at)
    ax.figure.canvas.draw()
    frame = ax.get_window_extent()
    for artist in (*ax.texts, *(line for line in ax.lines if line.get_marker() == "|")):
        box = artist.get_window_extent()
        assert frame.x0 <= box.x0 < box.x1 <= frame.x1
        assert frame.y0 <= box.y0 < box.y1 <= frame.y1
    label, bar = ax.texts[0].get_window_extent(), ax.lines[1].get_window_extent()
    assert not label.overlaps(bar)


# --- the scale map -------------------------------------------------------------------------------


def test_colours_are_metres_per_pixel_where_the_photo_has_them():
    values = np.linspace(2.0, 6.0, 24)[:, None] * np.ones(32)
    model, depth = metric(values, image_size=(WIDTH, HEIGHT))
    ax = draw_scale_map(model, depth, image=np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    photo, colours = ax.images
    np.testing.assert_allclose(colours.get_array(), values / FOCAL, rtol=1e-12)
    assert tuple(colours.get_extent()) == tuple(photo.get_extent())
    assert colours.get_interpolation() == "nearest"


def sloping(width=800, height=600):
    """Metres per pixel that rise by straight lines: 2 mm at the left, 10 mm at the right."""
    x = (np.arange(width) + 0.5) / width
    return metric(FOCAL * (0.002 + 0.008 * x) * np.ones((height, 1)))


def contours_of(ax):
    (found,) = (item for item in ax.collections if isinstance(item, ContourSet))
    return found


def test_contours_of_a_sloping_plane_are_where_its_scale_is():
    model, depth = sloping()
    found = contours_of(draw_scale_map(model, depth))
    assert len(found.levels) >= 4
    for level, path in zip(found.levels, found.get_paths(), strict=True):
        x = path.vertices[:, 0] + 0.5
        np.testing.assert_allclose(x, 800 * (level - 0.002) / 0.008, atol=0.05)


def test_contours_carry_their_values_in_a_unit_that_reads():
    model, depth = sloping()
    ax = draw_scale_map(model, depth)
    texts = {text.get_text() for text in ax.texts}
    assert texts == {f"{1000 * level:g} mm/px" for level in contours_of(ax).levels}
    assert {text.get_text() for text in draw_scale_map(model, depth, unit="in").texts} == {
        f"{inch:g} in/px" for inch in (0.1, 0.15, 0.2, 0.25, 0.3, 0.35)
    }


@given(st.floats(-6, 3), st.floats(1.05, 1e5))
def test_contour_levels_are_round_and_inside(exponent, ratio):
    low = 10.0**exponent
    levels = contour_levels(low, low * ratio)
    assert all(low < level < low * ratio for level in levels)
    assert levels == sorted(set(levels))
    assert 1 <= len(levels) <= 12
    steps = [b - a for a, b in pairwise(levels)]
    one_two_five = all(round_length(level) == pytest.approx(level) for level in levels)
    even = steps and max(steps) == pytest.approx(min(steps), rel=1e-6)
    assert one_two_five or even


def test_missing_pixels_stay_missing_hatched_and_without_contours():
    model, depth = sloping()
    values = depth.values.copy()
    values[100:500, 300:500] = np.nan
    model, depth = metric(values)
    ax = draw_scale_map(model, depth)
    colours, hatch = ax.images
    np.testing.assert_array_equal(np.ma.getmaskarray(colours.get_array()), np.isnan(values))
    np.testing.assert_array_equal(hatch.get_array()[..., 3] > 0, np.isnan(values))
    assert ax.get_legend().get_texts()[0].get_text() == "no depth (17 %)"
    for path in contours_of(ax).get_paths():
        x, y = path.vertices.T + 0.5
        assert not ((x > 302) & (x < 498) & (y > 102) & (y < 498)).any()


def test_no_contour_runs_along_the_edge_between_two_surfaces():
    values = np.full((HEIGHT, WIDTH), 2.0)
    values[:, 320:] = 6.0
    model, depth = metric(values)
    assert all(
        not len(path.vertices) for path in contours_of(draw_scale_map(model, depth)).get_paths()
    )


@pytest.mark.parametrize("pattern", ["scattered", "whole rows"])
def test_sparse_maps_are_points_and_nothing_in_between(pattern):
    rng = np.random.default_rng(1)
    values = rng.uniform(3.0, 30.0, (120, 160))
    hidden = rng.random(values.shape) > 0.04
    if pattern == "whole rows":
        hidden = np.arange(120)[:, None] % 6 + 0 * hidden > 0
    values[hidden] = np.nan
    model, depth = metric(values, image_size=(WIDTH, HEIGHT))
    ax = draw_scale_map(model, depth)
    assert not ax.images
    (points,) = ax.collections
    rows, columns = np.nonzero(~np.isnan(values))
    centres = np.column_stack([4 * columns + 1.5, 4 * rows + 1.5])
    np.testing.assert_allclose(points.get_offsets(), centres)
    np.testing.assert_allclose(points.get_array(), values[rows, columns] / FOCAL)
    assert "depth at these points; none at" in ax.get_legend().get_texts()[0].get_text()


def shifted(values):
    """Affine inverse depth on which 1 / (value + 0.1) is the distance, with known doors on it."""
    rows = [(20, 0.9), (140, 0.4), (260, 0.15)]
    doors = []
    for x, value in rows:
        tall = FOCAL * 2.0 * (value + 0.1) / 10
        doors.append(ims.Detection("door", (x, 100, x + 40, 100 + tall)))
        values[90 : 110 + int(tall), x - 10 : x + 50] = value
    depth = ims.DepthMap(values, kind="affine_inverse")
    table = ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.01)])
    return ims.fit(doors, depth, table, noise=ims.Noise(box_px=0.1, depth_rel=0.005)), depth


def hatched(ax):
    """Where thin lines or stripes lie, widened to the gaps between them."""
    shades = [image.get_array()[..., 3] > 0 for image in ax.images[1:]]
    return [ski.morphology.closing(shade, np.ones((31, 31))) for shade in shades]


def test_lines_lie_where_predict_flags_extrapolated():
    values = np.full((HEIGHT, WIDTH), 0.5) + 1e-6 * np.arange(WIDTH)
    sides = np.geomspace(0.02, 3.0, 12) - 0.01
    for index, value in enumerate(sides):
        x, y = 330 + 75 * (index % 4), 20 + 150 * (index // 4)
        values[y : y + 120, x : x + 70] = value + 1e-6 * np.arange(70)  # no plateau
    model, depth = shifted(values)
    places = [(330 + 75 * (i % 4) + 2, 20 + 150 * (i // 4) + 2) for i in range(12)]
    things = [ims.Detection("thing", (x, y, x + 66, y + 116)) for x, y in places]
    flagged = [ims.Flag.EXTRAPOLATED in each.flags for each in ims.predict(model, things, depth)]
    ax = draw_scale_map(model, depth)
    (lines,) = hatched(ax)
    assert [bool(lines[y + 60, x + 33]) for x, y in places] == flagged
    assert 2 < sum(flagged) < 10
    (entry,) = ax.get_legend().get_texts()
    assert entry.get_text().startswith("far from the references (")


def test_the_least_value_of_many_pixels_is_said_to_be_a_bound():
    values = np.full((HEIGHT, WIDTH), 0.5) + 1e-6 * np.arange(WIDTH)
    values[:80] = 0.0
    model, depth = shifted(values)
    ax = draw_scale_map(model, depth)
    assert ax.get_legend().get_texts()[0].get_text() == (
        "the map's least value: so far or farther (17 %)"
    )
    (lines,) = hatched(ax)
    assert lines[10:70, 10:-10].all()
    assert not lines[82:].any()
    assert ax.images[0].norm.vmax < float(model.metres_per_pixel(0.0))


@pytest.mark.parametrize("kind", ["inverse", "metric", "relative"])
def test_of_other_kinds_the_least_value_is_a_depth(kind):
    values = np.full((HEIGHT, WIDTH), 4.0)
    values[:80] = 2.0
    depth = ims.DepthMap(values, kind=kind)
    model = ims.fit([DOOR], depth, TABLE)
    ax = draw_scale_map(model, depth)
    assert len(ax.images) == 1
    assert ax.get_legend() is None


def test_labels_of_contours_stay_inside_and_apart():
    values = FOCAL * np.geomspace(0.05, 0.002, 300)[:, None] * np.ones(900)
    values[150:] += 0.3 * np.sin(np.arange(900) / 40)
    ax = draw_scale_map(*metric(values))
    seen = [text.get_window_extent() for text in ax.texts if text.get_visible()]
    frame = ax.get_window_extent()
    assert len(seen) > 2
    assert all(frame.x0 <= extent.x0 and extent.x1 <= frame.x1 for extent in seen)
    assert not any(one.overlaps(other) for one, other in combinations(seen, 2))


def test_colours_go_with_the_logarithm_where_the_range_is_wide():
    wide = np.geomspace(2.0, 60.0, HEIGHT)[:, None] * np.ones(WIDTH)
    near = np.linspace(2.0, 3.0, HEIGHT)[:, None] * np.ones(WIDTH)
    assert isinstance(draw_scale_map(*metric(wide)).images[0].norm, LogNorm)
    assert not isinstance(draw_scale_map(*metric(near)).images[0].norm, LogNorm)


def test_a_flat_wall_has_one_scale():
    ax = draw_scale_map(*wall())
    assert not ax.texts
    np.testing.assert_allclose(ax.images[0].get_array(), 4.0 / FOCAL, rtol=1e-12)


def test_on_a_ground_plane_the_scale_ends_at_the_horizon():
    ground = ims.GroundPlane(
        image_size=(WIDTH, HEIGHT), horizon_px=200.0, horizon_std_px=1e-3, camera_height_m=1.5,
        camera_height_std_m=1e-3, roll_deg=0.0, roll_std_deg=1e-4,
    )  # fmt: skip
    model = ims.fit([], ground)
    ax = draw_scale_map(model)
    drawn = ax.images[0].get_array()
    rows = np.arange(HEIGHT) + 0.5
    expected = np.where(rows > 200, 1.5 / np.where(rows > 200, rows - 200, 1.0), np.nan)
    np.testing.assert_allclose(drawn[40:, 5].filled(np.nan)[170:], expected[210:], rtol=1e-3)
    assert np.ma.getmaskarray(drawn)[:199].all()
    with pytest.raises(ims.DepthMismatchError):
        draw_scale_map(model, wall()[1])


@pytest.mark.parametrize(
    ("depth", "error", "law"),
    [
        (None, TypeError, "`depth` must be a DepthMap; got NoneType. The scale between objects"),
        (ims.ObjectDepths([4.0], kind="metric"), TypeError, "must be a DepthMap; got ObjectDepths"),
    ],
)
def test_a_scale_map_needs_a_map(depth, error, law):
    with pytest.raises(error, match=law):
        draw_scale_map(wall()[0], depth)


def test_a_photo_of_another_size_is_refused():
    with pytest.raises(ValueError, match="640 x 480; got 20 x 10"):
        draw_scale_map(*wall(), image=np.zeros((10, 20, 3), np.uint8))


@pytest.mark.parametrize("draw", [draw_scale_map, draw_scale_bar])
def test_units_are_checked(draw):
    with pytest.raises(ValueError, match='`unit` must be one of "m", "cm", "mm", "in", "ft"'):
        draw(*wall(), *([(5, 5)] if draw is draw_scale_bar else []), unit="yd")


# --- residuals -----------------------------------------------------------------------------------

PLAIN = ims.PriorTable([ims.ObjectPrior("pole", 1.0, 0.05), ims.ObjectPrior("box", 0.5, 0.05)])


def poles(heights, depths, labels=None, **options):
    labels = labels or ["pole"] * len(heights)
    detections = [
        ims.Detection(label, (60 * i + 10, 20, 60 * i + 40, 20 + height))
        for i, (label, height) in enumerate(zip(labels, heights, strict=True))
    ]
    return ims.fit(
        detections,
        ims.ObjectDepths(depths, kind="metric", image_size=(4000, 480), rel_std=0.01),
        PLAIN,
        noise=ims.Noise(box_px=0.5),
        **options,
    )


def row_names(ax):
    return [label.get_text() for label in ax.get_yticklabels()]


def test_each_reference_has_its_own_k_against_that_of_the_model():
    model = poles([100, 104, 50, 210], [5, 5, 10, 2.4])
    ax = draw_residuals(model)
    order = sorted(range(4), key=lambda i: -model.references[i].k)
    assert row_names(ax) == [f"pole {i + 1}" for i in order]
    marks = [item.get_offsets()[0] for item in ax.collections if len(item.get_offsets())]
    expected = [math.log(model.references[i].k / model.k) for i in order]
    marks = [mark for mark in marks if mark[1] == int(mark[1])]
    np.testing.assert_allclose([mark[0] for mark in marks[-4:]], expected, rtol=1e-9)


def test_bars_hold_prior_box_and_depth_and_the_band_is_that_of_k():
    model = poles([100, 104, 50, 210], [5, 5, 10, 2.4])
    ax = draw_residuals(model, level=0.9)
    bars = [line for line in ax.lines if line.get_ydata()[0] == line.get_ydata()[1] == 0]
    first = max(model.references, key=lambda ref: ref.k)
    half = np.ptp(bars[0].get_xdata()) / 2
    assert half == pytest.approx(1.6448536 * math.hypot(0.05, 0.5 / first.pixels, 0.01), rel=1e-6)
    band = ax.collections[0].get_paths()[0].vertices[:, 0]
    assert band.max() == pytest.approx(1.6448536 * model.k_std / model.k, rel=1e-6)


def test_a_rejected_reference_is_told_by_words_and_mark():
    model = poles([100, 104, 50, 210, 30], [5, 5, 10, 2.4, 5])
    assert model.references[4].reason == "outlier"
    ax = draw_residuals(model)
    words = dict(zip(row_names(ax), [text.get_text() for text in ax.texts], strict=False))
    assert words["pole 5"].startswith("outlier: wrong with ")
    assert f"z {model.references[4].z_score:+.1f}" in words["pole 5"]
    first = model.references[0]
    assert words["pole 1"] == f"weight {100 * first.weight:.0f} %, z {first.z_score:+.1f}"


def test_what_has_no_k_is_listed_below():
    model = poles([100, 50, 80, 90], [5, 10, np.nan, 4], ["pole", "pole", "pole", "thing $1$"])
    ax = draw_residuals(model)
    assert len(row_names(ax)) == 2
    texts = [text.get_text() for text in ax.texts]
    assert texts[2:] == ["no depth: pole 3", "no prior: thing $1$"]
    assert texts[0].startswith("weight ")


@pytest.mark.parametrize("method", ["robust", "mean_ratio", "least_squares"])
def test_every_method_has_residuals(method):
    model = poles([100, 104, 50, 30], [5, 5, 10, np.nan], method=method)
    assert len(row_names(draw_residuals(model))) == 3


def test_a_camera_height_given_is_a_row():
    size = (1280, 720)
    ground = ims.GroundPlane(image_size=size, horizon_px=300.0, camera_height_m=1.6)
    model = ims.fit([], ground)
    ax = draw_residuals(model)
    assert row_names(ax) == ["camera height"]
    # given without its error, a height has one of 2 %
    (bar,) = (line for line in ax.lines if line.get_ydata()[0] == line.get_ydata()[1])
    assert np.ptp(bar.get_xdata()) / 2 == pytest.approx(1.6448536 * 0.02, rel=1e-6)


def test_a_camera_that_took_part_is_a_row():
    model = poles([100, 50], [5, 10], camera=ims.Camera(520.0, focal_rel_std=0.02))
    ax = draw_residuals(model)
    assert "focal length" in row_names(ax)
    place = row_names(ax).index("focal length")
    share = 1 - sum(ref.weight for ref in model.references)
    assert ax.texts[place].get_text() == f"weight {100 * share:.0f} %"


@pytest.mark.parametrize("count", [0, 1, 60])
def test_none_to_sixty_references_are_drawn(tmp_path, count):
    rng = np.random.default_rng(2)
    depths = rng.uniform(3, 30, count)
    heights = 500 / depths * np.exp(rng.normal(0, 0.05, count))
    model = poles(heights, depths, camera=ims.Camera(500.0, focal_rel_std=0.05))
    ax = draw_residuals(model)
    ax.figure.savefig(tmp_path / "a.png")
    assert len(row_names(ax)) == count + 1
    ax.figure.canvas.draw()
    extents = [label.get_window_extent() for label in ax.get_yticklabels()]
    for one, other in pairwise(extents):
        assert not one.overlaps(other)


def test_a_title_of_ones_own_replaces_the_heading():
    ax = draw_residuals(poles([100, 104], [5, 5]))
    assert ax.get_title().startswith("k = ")
    ax.set_title("mine")
    assert [ax.get_title(loc) for loc in ("left", "center", "right")] == ["", "mine", ""]


@pytest.mark.parametrize("inches", [(12, 4), (9, 3), (20, 6)], ids=str)
def test_two_panels_side_by_side_keep_their_words(inches):
    model = poles([100, 104, 50, 210, 30], [5, 5, 10, 2.4, 5])
    figure = Figure(figsize=inches, layout="constrained")
    for ax in figure.subplots(1, 2):
        draw_residuals(model, ax=ax)
    figure.draw_without_rendering()
    for ax in figure.axes:
        frame, seen = ax.get_window_extent(), figure.bbox
        assert all(text.get_window_extent().x1 <= frame.x1 for text in ax.texts)
        heads = [ax.title, ax.xaxis.label, *ax.get_yticklabels()]
        for head in heads:
            extent = head.get_window_extent()
            assert seen.x0 <= extent.x0
            assert extent.x1 <= seen.x1
        ticks = [label.get_window_extent() for label in ax.get_xticklabels()]
        assert len(ticks) >= 3
        assert not any(one.overlaps(other) for one, other in pairwise(ticks))


def test_labels_in_any_script_and_of_any_length_are_written(tmp_path):
    label = "\u231a " + "word " * 30  # of matplotlib's own fonts, STIX holds the watch
    depth = ims.DepthMap(np.full((HEIGHT, WIDTH), 4.0), kind="relative")
    watch = ims.Detection(label, DOOR.xyxy)
    known = ims.fit([watch], depth, ims.PriorTable([ims.ObjectPrior(label.strip(), 2.0, 0.04)]))
    for ax in (
        draw_residuals(known),
        draw_residuals(ims.fit([DOOR, watch], depth, TABLE)),
        draw_scale_bar(known, depth, watch),
    ):
        ax.figure.savefig(tmp_path / "a.png")  # a missing glyph would be a warning, an error here


def test_the_level_is_checked():
    with pytest.raises(ValueError, match=r"`level` must be above 0 and below 1; got 2\.0"):
        draw_residuals(poles([100], [5]), level=2.0)


# --- all -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "draw",
    [
        lambda ax: draw_scale_bar(*wall(), (100, 100), ax=ax),
        lambda ax: draw_scale_map(*wall(), ax=ax),
        lambda ax: draw_residuals(wall()[0], ax=ax),
    ],
    ids=["bar", "map", "residuals"],
)
def test_axes_given_are_drawn_on_and_their_neighbours_left_alone(draw):
    figure = Figure(figsize=(9, 4))
    left, right = figure.subplots(1, 2)
    places = [axes.get_position(original=True).bounds for axes in (left, right)]
    assert draw(left) is left
    assert figure.axes == [left, right]
    assert [axes.get_position(original=True).bounds for axes in (left, right)] == places
    assert not right.has_data()


def test_a_bar_is_added_to_what_is_on_the_axes():
    model, depth = wall()
    ax = draw_scale_map(model, depth)
    images, limits = len(ax.images), (ax.get_xlim(), ax.get_ylim())
    draw_scale_bar(model, depth, (100, 100), ax=ax)
    draw_scale_bar(model, depth, (400, 300), ax=ax)
    assert (len(ax.images), ax.get_xlim(), ax.get_ylim()) == (images, *limits)
    assert len([line for line in ax.lines if line.get_marker() == "|"]) == 2


@pytest.mark.slow
@pytest.mark.parametrize("size", [(300, 200), (3840, 2160)], ids=str)
def test_small_and_large_pictures_are_drawn(tmp_path, size):
    values = np.linspace(9.0, 2.0, size[1])[:, None] * np.ones(size[0])
    model, depth = metric(values.astype(np.float32))
    image = np.full((size[1], size[0], 3), 128, dtype=np.uint8)
    ax = draw_scale_map(model, depth, image=image)
    draw_scale_bar(model, depth, (0.4 * size[0], 0.7 * size[1]), ax=ax)
    ax.figure.savefig(tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 1000


@pytest.mark.parametrize("draw", [draw_residuals, draw_scale_map])
def test_what_is_no_model_is_refused(draw):
    with pytest.raises(TypeError, match="`model` must be a ScaleModel; got int"):
        draw(3)
