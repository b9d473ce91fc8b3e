"""The tape measure between two pixels: exact scenes, laws, intervals, refusals."""

import math

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import imgscale as ims
from imgscale import Flag
from imgscale.datasets import motorcycle
from imgscale.measuring import distance, extent, regionprops_table

SIZE = (640, 480)
WIDTH, HEIGHT = SIZE
FOCAL, BASELINE, UNIT = 800.0, 0.3, 3.7
CX, CY = 300.0, 250.0
EXACT = ims.Noise(box_px=0.0, box_rel=0.0, depth_rel=0.0)
CAMERA = ims.Camera(FOCAL, focal_rel_std=0.0, cx=CX, cy=CY)
DOORS = ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.0), ims.ObjectPrior("hatch", 1.0, 0.0)])
TO_KIND = {
    "metric": lambda z: z,
    "relative": lambda z: UNIT * z,
    "inverse": lambda z: FOCAL * BASELINE / z,
    "affine_inverse": lambda z: FOCAL * BASELINE / z - 17.0,
}


def slanted_wall():
    """The z-depth of a plane that recedes to the right and downward, at pixel centres."""
    columns, rows = np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5
    return 1 / (0.25 - 1e-4 * (columns - CX)[None, :] - 1.5e-4 * (rows - CY)[:, None])


WALL = slanted_wall()


def references(kind):
    """Two boards at 4 and 8 m, seen exactly, whose depths are told one by one."""
    boxes = [("door", 4.0, 2.0, 20.0), ("hatch", 8.0, 1.0, 300.0)]
    detections = [
        ims.Detection(label, (left, 50.0, left + 40, 50 + FOCAL * size / z))
        for label, z, size, left in boxes
    ]
    values = TO_KIND[kind](np.array([z for _, z, _, _ in boxes]))
    return detections, ims.ObjectDepths(values, kind=kind, image_size=SIZE)


def fitted(kind, *, camera=CAMERA, noise=EXACT, method="posterior", priors=DOORS):
    return ims.fit(*references(kind), priors, noise=noise, camera=camera, method=method)


def wall(kind):
    return ims.DepthMap(TO_KIND[kind](WALL), kind=kind)


def in_space(point, z=None):
    column, row = (math.floor(number) for number in point)
    z = WALL[row, column] if z is None else z
    return np.array([(point[0] - CX) * z / FOCAL, (point[1] - CY) * z / FOCAL, z])


def true_length(p1, p2):
    return math.dist(in_space(p1), in_space(p2))


PIXELS = st.tuples(
    st.integers(0, WIDTH - 1).map(lambda column: column + 0.5),
    st.integers(0, HEIGHT - 1).map(lambda row: row + 0.5),
)


# --- exact scenes ------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["posterior", "robust"])
@pytest.mark.parametrize("kind", TO_KIND)
def test_any_two_points_of_an_exact_scene_are_as_far_apart_as_they_are(kind, method):
    model, depth = fitted(kind, method=method), wall(kind)
    rng = np.random.default_rng(1)
    for _ in range(5):
        p1, p2 = np.floor(rng.uniform(0, SIZE, (2, 2))) + 0.5
        length = distance(model, p1, p2, depth)
        assert length.value == pytest.approx(true_length(p1, p2), rel=1e-9)


@pytest.mark.parametrize("kind", sorted(TO_KIND.keys() - {"metric"}))
def test_a_camera_that_comes_later_is_as_good_as_one_of_the_fit(kind):
    model, depth = fitted(kind, camera=None), wall(kind)
    p1, p2 = (100.5, 80.5), (500.5, 400.5)
    assert distance(model, p1, p2, depth, camera=CAMERA).value == pytest.approx(
        true_length(p1, p2), rel=1e-9
    )


@pytest.mark.parametrize(
    ("kind", "changes", "why"),
    [
        ("metric", {"focal_px": 1.2 * FOCAL}, "with metric depth, where its focal length tells k"),
        ("relative", {"pitch_deg": 20.0, "pitch_std_deg": 1.0}, "where it is tilted, as the fit"),
    ],
)
def test_a_camera_that_the_fit_needed_to_know_is_refused_later(kind, changes, why):
    late = attrs.evolve(CAMERA, **changes)
    for first in (None, CAMERA):
        model = fitted(kind, camera=first)
        with pytest.raises(ValueError, match=f"`camera` must be the model's {why}.*to `fit`"):
            distance(model, (100.5, 80.5), (500.5, 400.5), wall(kind), camera=late)


@pytest.mark.parametrize("column", [318.9, 319.5, 320.0, 320.6])
def test_a_click_within_a_pixel_of_an_edge_says_that_two_surfaces_meet(column):
    step = np.full((HEIGHT, WIDTH), 8.0)
    step[:, :320] = 4.0
    depth = ims.DepthMap(step, kind="metric")
    model = fitted("metric")
    beside = distance(model, (column, 100), (column, 200), depth)
    assert (Flag.MIXED_DEPTH in beside.flags) == (319 <= column < 321)
    assert Flag.MIXED_DEPTH not in distance(model, (100, 100), (200, 200), depth).flags


def test_a_pole_of_one_pixel_says_that_two_surfaces_meet():
    pole = np.full((HEIGHT, WIDTH), 8.0)
    pole[:, 320] = 4.0
    length = distance(fitted("metric"), (320.5, 50), (320.5, 90), ims.DepthMap(pole, kind="metric"))
    assert Flag.MIXED_DEPTH in length.flags


def test_metric_depth_needs_no_camera_but_takes_the_middle_for_the_principal_point():
    middle = attrs.evolve(CAMERA, cx=None, cy=None)
    model, depth = fitted("metric", camera=None), wall("metric")
    p1, p2 = (100.5, 80.5), (500.5, 400.5)
    expected = distance(fitted("metric", camera=middle), p1, p2, depth).value
    assert distance(model, p1, p2, depth).value == pytest.approx(expected, rel=1e-9)


def test_distances_along_the_ray_serve_once_they_are_z_depths():
    columns, rows = np.arange(WIDTH) + 0.5 - CX, np.arange(HEIGHT) + 0.5 - CY
    ray = WALL * np.sqrt(1 + (columns[None] ** 2 + rows[:, None] ** 2) / FOCAL**2)
    depth = ims.DepthMap.from_ray_distance(ray, attrs.evolve(CAMERA, image_size=SIZE))
    p1, p2 = (5.5, 470.5), (630.5, 30.5)
    length = distance(fitted("metric"), p1, p2, depth, same_scale=True)
    assert length.value == pytest.approx(true_length(p1, p2), rel=1e-9)


@pytest.mark.parametrize("pitch_deg", [0.0, 20.0])
def test_the_pitch_does_not_matter_to_z_depth(pitch_deg):
    # boards that face a tilted camera's picture plane have one z-depth: k is exact for widths
    camera = attrs.evolve(CAMERA, pitch_deg=pitch_deg, image_size=SIZE)
    board = ims.Detection("board", (100, 50, 100 + FOCAL * 1.5 / 4, 90))
    priors = ims.PriorTable([ims.ObjectPrior("board", 1.5, 0.0, axis="width")])
    depths = ims.ObjectDepths([4.0 * UNIT], kind="relative", image_size=SIZE)
    model = ims.fit([board], depths, priors, camera=camera, noise=EXACT)
    p1, p2 = (100.5, 80.5), (500.5, 400.5)
    assert distance(model, p1, p2, wall("relative")).value == pytest.approx(
        true_length(p1, p2), rel=1e-9
    )


def test_points_of_one_depth_need_no_focal_length():
    depth = ims.DepthMap(np.full((HEIGHT, WIDTH), 5.0 * UNIT), kind="relative")
    length = distance(fitted("relative", camera=None), (100.5, 100.5), (220.5, 260.5), depth)
    assert length.value == pytest.approx(200 * 5 / FOCAL, rel=1e-9)


def ground_scene(pitch_deg, cross_fall, height_m=3.0):
    """A camera over a plane: poles of known size and the pixel of any point of the ground."""
    pitch = math.radians(pitch_deg)
    cos, sin = math.cos(pitch), math.sin(pitch)

    def pixel(forward, lateral, up=0.0):
        up = up - height_m - cross_fall * lateral
        z = forward * cos - up * sin
        return CX + FOCAL * lateral / z, CY - FOCAL * (forward * sin + up * cos) / z

    def pole(label, forward, lateral, size):
        (x, foot), (_, top) = pixel(forward, lateral), pixel(forward, lateral, size)
        return ims.Detection(label, (x - 2, top, x + 2, foot))

    detections = [
        pole("door", 12.0, 1.0, 2.0),
        pole("hatch", 14.0, -3.0, 1.0),
        pole("door", 20.0, 3.0, 2.0),
        pole("hatch", 16.0, 4.0, 1.0),
    ]
    return detections, pixel


@pytest.mark.parametrize("cross_fall", [0.0, 0.03], ids=["level", "falls to the right"])
@pytest.mark.parametrize("pitch_deg", [0.0, 5.0, 12.0])
def test_two_feet_on_a_ground_plane_are_as_far_apart_as_they_are(pitch_deg, cross_fall):
    detections, pixel = ground_scene(pitch_deg, cross_fall)
    camera = attrs.evolve(CAMERA, image_size=SIZE)
    plane = ims.GroundPlane(image_size=SIZE)
    model = ims.fit(detections, plane, DOORS, camera=camera, noise=EXACT)
    assert model.camera_height_m == pytest.approx(3.0, rel=1e-6)
    for first, second in [((12, 1), (18, -3)), ((13, -2), (13, 2)), ((30, 5), (12, 0))]:
        length = distance(model, pixel(*first), pixel(*second))
        (forward, lateral), (forward2, lateral2) = first, second
        drop = cross_fall * (lateral - lateral2)
        expected = math.hypot(forward - forward2, lateral - lateral2, drop)
        assert length.value == pytest.approx(expected, rel=1e-6)


def test_across_the_view_a_ground_plane_needs_no_focal_length():
    detections, pixel = ground_scene(0.0, 0.0)
    plane = ims.GroundPlane(image_size=SIZE, horizon_px=CY, horizon_std_px=0.0, roll_deg=0.0)
    model = ims.fit(detections, plane, DOORS, noise=EXACT)
    across = distance(model, pixel(13, -2), pixel(13, 2))
    assert across.value == pytest.approx(4.0, rel=1e-6)
    with pytest.raises(ValueError, match="`camera` must be known to measure along the view"):
        distance(model, pixel(13, -2), pixel(18, 2))


# --- the motorcycle ----------------------------------------------------------------------------


def test_the_motorcycles_points_keep_the_ratios_of_the_published_calibration():
    scene = motorcycle.load()
    model = ims.fit(
        scene.detections, scene.depth, scene.priors, noise=scene.noise, camera=scene.camera
    )
    focal, baseline = scene.camera.focal_px, motorcycle.PUBLISHED_BASELINE_M
    rng, compared = np.random.default_rng(3), 0
    for _ in range(20):
        ends = np.floor(rng.uniform(0, (741, 500), (2, 2)))
        places = ends.astype(int)
        windows = [scene.shifted_disparity[y - 1 : y + 2, x - 1 : x + 2] for x, y in places]
        if any(w.size < 9 or not np.ptp(w) < 0.03 * w.mean() for w in windows):
            continue  # edges and holes, where the pixel's own value may not stand
        disparity = [scene.shifted_disparity[y, x] for x, y in places]
        published = [
            focal * baseline / d * np.array([*(end + 0.5 - (370.5, 250)) / focal, 1.0])
            for end, d in zip(ends, disparity, strict=True)
        ]
        length = distance(model, ends[0] + 0.5, ends[1] + 0.5, scene.depth)
        ratio = length.value / math.dist(*published)
        assert ratio == pytest.approx(model.k / baseline, rel=1e-9)
        compared += 1
    assert compared >= 8


def test_the_rear_tyre_is_as_high_by_tape_as_its_code_says():
    scene = motorcycle.load()
    model = ims.fit(
        scene.detections, scene.depth, scene.priors, noise=scene.noise, camera=scene.camera
    )
    # top and bottom of the tread, by eye
    low, high = distance(model, (199, 239), (201, 399), scene.depth, same_object=True).interval()
    assert low < 0.622 < high


# --- laws --------------------------------------------------------------------------------------

NOISY = fitted("relative", noise=ims.Noise(box_px=1.0, depth_rel=0.02))


@settings(max_examples=40, deadline=None)
@given(PIXELS, PIXELS)
def test_there_and_back_are_equally_far(p1, p2):
    depth = wall("relative")
    there, back = distance(NOISY, p1, p2, depth), distance(NOISY, p2, p1, depth)
    assert there.value == pytest.approx(back.value, rel=1e-12)
    assert there.interval() == pytest.approx(back.interval(), rel=0.01)


@settings(max_examples=25, deadline=None)
@given(PIXELS, PIXELS, PIXELS)
def test_a_detour_is_no_shorter(p1, p2, p3):
    model, depth = fitted("relative"), wall("relative")
    direct, first, second = (
        distance(model, a, b, depth).value for a, b in ((p1, p3), (p1, p2), (p2, p3))
    )
    assert direct <= (first + second) * (1 + 1e-9)


@settings(max_examples=25, deadline=None)
@given(PIXELS)
def test_a_point_is_at_no_distance_from_itself(point):
    length = distance(NOISY, point, point, wall("relative"))
    assert (length.value, length.std, length.interval()) == (0.0, 0.0, (0.0, 0.0))


@pytest.mark.parametrize("scale", [0.3, 3.0])
def test_sizes_that_are_told_larger_make_everything_larger(scale):
    priors = ims.PriorTable([
        ims.ObjectPrior("door", 2.0 * scale, 0.0),
        ims.ObjectPrior("hatch", 1.0 * scale, 0.0),
    ])  # fmt: skip
    larger = fitted("relative", priors=priors)
    ends = (100.5, 80.5), (500.5, 400.5)
    length = distance(larger, *ends, wall("relative")).value
    assert length == pytest.approx(scale * true_length(*ends), rel=1e-9)


def test_the_value_lies_in_every_interval():
    length = distance(NOISY, (100.5, 80.5), (104.5, 82.5), wall("relative"))
    for level in (0.01, 0.5, 0.9, 0.999):
        low, high = length.interval(level)
        assert 0 <= low <= length.value <= high


def test_top_and_bottom_of_one_object_are_as_far_apart_as_predict_says():
    depth = ims.DepthMap(np.full((HEIGHT, WIDTH), 5.0 * UNIT), kind="relative")
    board = ims.Detection("board", (200, 100.5, 260, 300.5))
    size = ims.predict(NOISY, [board], depth)[0]
    tape = distance(NOISY, (230.5, 100.5), (230.5, 300.5), depth, same_object=True)
    assert tape.value == pytest.approx(size.size_m, rel=1e-9)
    assert tape.interval(0.9) == pytest.approx(size.interval(0.9), rel=0.003)


# --- what a click on the map gets --------------------------------------------------------------


def step(column=320, near=4.0, far=8.0):
    values = np.full((HEIGHT, WIDTH), far)
    values[:, :column] = near
    return values


@pytest.mark.parametrize(
    ("x", "z"), [(319.5, 4.0), (320.5, 8.0), (318.5, 4.0)], ids=["last", "first", "inner"]
)
def test_a_click_beside_an_edge_gets_its_own_surface(x, z):
    depth = ims.DepthMap(step(), kind="metric")
    length = distance(fitted("metric"), (x, 100.5), (x, 200.5), depth, same_scale=True)
    assert length.value == pytest.approx(100 * z / FOCAL, rel=1e-9)


def test_a_click_on_the_corner_of_a_box_gets_the_box():
    values = np.full((HEIGHT, WIDTH), 8.0)
    values[100:201, 300:401] = 4.0
    depth = ims.DepthMap(values, kind="metric")
    length = distance(fitted("metric"), (300.5, 100.5), (400.5, 200.5), depth)
    assert length.value == pytest.approx(100 * math.sqrt(2) * 4 / FOCAL, rel=1e-9)
    assert Flag.MIXED_DEPTH in length.flags


def test_a_pixel_between_two_surfaces_gets_one_of_them():
    values = step()
    values[:, 320] = 5.7  # what networks put on an edge
    depth = ims.DepthMap(values, kind="metric")
    length = distance(fitted("metric"), (320.5, 100.5), (320.5, 200.5), depth)
    assert min(abs(length.value - 100 * z / FOCAL) for z in (4.0, 8.0)) < 1e-9


def test_a_hole_in_the_map_takes_the_depth_around_it():
    values = np.full((HEIGHT, WIDTH), 4.0)
    values[98:104, 98:104] = np.nan
    depth = ims.DepthMap(values, kind="metric")
    length = distance(fitted("metric"), (100.5, 100.5), (300.5, 100.5), depth)
    assert length.value == pytest.approx(200 * 4 / FOCAL, rel=1e-9)


def test_without_depth_near_a_point_nothing_is_known():
    values = np.full((HEIGHT, WIDTH), 4.0)
    values[:, :200] = np.nan
    length = distance(
        fitted("metric"), (100.5, 100.5), (300.5, 100.5), ims.DepthMap(values, kind="metric")
    )
    assert math.isnan(length.value)
    assert all(math.isnan(end) for end in length.interval())
    assert Flag.NO_DEPTH in length.flags
    assert str(length) == "unknown (NO_DEPTH)"


def test_a_map_of_another_size_is_looked_up_where_the_point_lies():
    depth = ims.DepthMap(WALL[::4, ::4] * 0 + 4.0, kind="metric", image_size=SIZE)
    length = distance(fitted("metric"), (100.5, 100.5), (300.5, 100.5), depth)
    assert length.value == pytest.approx(1.0, rel=1e-9)


# --- intervals ---------------------------------------------------------------------------------


def covered(kind, gap_px, apart_m, depth_rel, *, count=250, camera_rel=0.0, same_object=False):
    """Share of the 90 % intervals that hold the truth, over scenes drawn from the errors told."""
    rng, hits = np.random.default_rng(5), 0
    noise = ims.Noise(box_px=1.0, depth_rel=depth_rel)
    priors = ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.04)])
    z = np.array([4.0, 4.0 + apart_m, 5.0])
    for _ in range(count):
        errors = depth_rel * rng.normal(size=3)
        errors[1] = errors[0] if same_object else errors[1]
        values = TO_KIND[kind](z * np.exp(errors))
        angle, centre = rng.uniform(0, 2 * np.pi), rng.uniform(150, 300, 2)
        half = gap_px / 2 * np.array([np.cos(angle), np.sin(angle)])
        ends = [centre - half, centre + half]
        truth = math.dist(*(in_space(end, depth) for end, depth in zip(ends, z, strict=False)))
        clicks = [end + rng.normal(size=2) / math.sqrt(2) for end in ends]
        cells = [tuple(np.floor(click).astype(int)) for click in clicks]
        field = np.full((HEIGHT, WIDTH), np.nan)
        for (x, y), value in zip(cells, values, strict=False):
            field[y, x] = value
        if cells[0] == cells[1]:
            hits += 0.9  # one pixel of the map cannot have both depths: not part of the game
            continue
        door = 2.0 * math.exp(0.02 * rng.normal()) * FOCAL / 5.0 + rng.normal()
        focal = ims.Camera(
            FOCAL * math.exp(camera_rel * rng.normal()), focal_rel_std=camera_rel, cx=CX, cy=CY
        )
        model = ims.fit(
            [ims.Detection("door", (20, 50, 60, 50 + door))],
            ims.ObjectDepths(values[2:], kind=kind, image_size=SIZE),
            priors,
            noise=noise,
            # with metric depth a witness of k, here one that tells the principal point alone
            camera=attrs.evolve(focal, focal_rel_std=0.5) if kind == "metric" else focal,
        )
        length = distance(model, *clicks, ims.DepthMap(field, kind=kind), same_object=same_object)
        low, high = length.interval(0.9)
        hits += low <= truth <= high
    return hits / count


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["metric", "relative"])
@pytest.mark.parametrize(
    ("gap_px", "apart_m", "depth_rel"),
    [
        pytest.param(100.0, 0.0, 0.02, id="across the view"),
        pytest.param(100.0, 0.5, 0.02, id="oblique"),
        pytest.param(200.0, 2.0, 0.1, id="far apart, noisy"),
        pytest.param(10.0, 0.0, 0.05, id="a gap below the noise of depth"),
        pytest.param(10.0, 0.2, 0.05, id="a gap like the noise of depth"),
        pytest.param(5.0, 0.6, 0.05, id="along the view"),
        pytest.param(3.0, 0.0, 0.05, id="nearly the same pixel"),
        pytest.param(3.0, 0.0, 0.0, id="nearly the same pixel, exact depth"),
    ],
)
def test_the_90_percent_interval_holds_nine_truths_of_ten(kind, gap_px, apart_m, depth_rel):
    share = covered(kind, gap_px, apart_m, depth_rel)
    # 250 scenes: two standard errors are 3.8 %. Above, what may be 0 is told with care.
    assert 0.86 <= share <= 0.995


@pytest.mark.slow
def test_the_interval_takes_the_error_of_the_focal_length():
    assert 0.86 <= covered("relative", 60.0, 2.0, 0.01, camera_rel=0.08) <= 0.97


@pytest.mark.slow
def test_the_interval_of_one_object_takes_an_error_that_both_ends_share():
    assert 0.86 <= covered("relative", 100.0, 0.3, 0.05, same_object=True) <= 0.98


@pytest.mark.slow
@pytest.mark.parametrize("method", ["posterior", "robust"])
def test_the_interval_on_a_ground_plane_holds_nine_truths_of_ten(method):
    rng, hits, count = np.random.default_rng(7), 0, 80
    camera = attrs.evolve(CAMERA, image_size=SIZE)
    priors = ims.PriorTable([
        ims.ObjectPrior("door", 2.0, 0.08), ims.ObjectPrior("hatch", 1.0, 0.04)
    ])  # fmt: skip
    noise = ims.Noise(box_px=1.0, depth_rel=0.01)
    for _ in range(count):
        detections, pixel = ground_scene(rng.uniform(0, 10), math.tan(rng.normal() * 0.03))
        detections = [
            d.with_box(np.array(d.xyxy) + np.array([0, 1, 0, 1]) * rng.normal(size=4) / 2**0.5)
            for d in detections
        ]
        jitter = [math.exp(0.04 * rng.normal()) for _ in detections]
        grown = [
            d.with_box((d.xyxy[0], d.xyxy[3] - d.height_px * factor, d.xyxy[2], d.xyxy[3]))
            for d, factor in zip(detections, jitter, strict=True)
        ]
        model = ims.fit(
            grown, ims.GroundPlane(image_size=SIZE), priors, camera=camera, noise=noise,
            method=method,
        )  # fmt: skip
        ends = [np.array([rng.uniform(11, 20), rng.uniform(-3, 3)]) for _ in range(2)]
        clicks = [np.array(pixel(*end)) + rng.normal(size=2) / 2**0.5 for end in ends]
        low, high = distance(model, *clicks).interval(0.9)
        hits += low <= math.dist(*ends) * 1.0005 and math.dist(*ends) <= high * 1.0005
    assert 0.83 <= hits / count <= 1.0


def test_a_network_that_errs_in_its_scale_errs_in_depth_as_much():
    depth = ims.DepthMap(step(), kind="metric", scale_rel_std=0.15)
    detections = [
        ims.Detection("door", (20, 50, 60, 450)), ims.Detection("hatch", (400, 50, 440, 150))
    ]  # fmt: skip
    noise = ims.Noise(box_px=0.5, depth_rel=0.001)
    model = ims.fit(detections, depth, DOORS, noise=noise)
    across = distance(model, (100.5, 100.5), (200.5, 100.5), depth)
    along = distance(model, (318.5, 240.5), (321.5, 240.5), depth)
    assert across.std / across.value < 0.01
    assert along.value == pytest.approx(4.0, rel=1e-3)
    assert along.std / along.value == pytest.approx(0.15, rel=0.02)
    # the focal length, where it is known, and sizes tell the map's scale
    told = ims.fit(detections, depth, DOORS, noise=noise, camera=CAMERA)
    again = distance(told, (318.5, 240.5), (321.5, 240.5), depth)
    assert again.std / again.value < 0.01


# --- refusals ----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["relative", "inverse", "affine_inverse"])
def test_lengths_along_the_view_need_a_focal_length(kind):
    model = fitted(kind, camera=None)
    with pytest.raises(ValueError, match=r"`camera` must be given .* Camera\.from_exif\(photo\)"):
        distance(model, (100.5, 80.5), (500.5, 400.5), wall(kind))


@pytest.mark.parametrize(
    ("p1", "text"),
    [
        ((700, 10), r"`p1` must lie in the image, 640 x 480 px; got \(700\.0, 10\.0\)"),
        ((math.nan, 10), r"`p1` must be finite"),
        ((1, 2, 3), r"`p1` must be two numbers"),
        (("a", "b"), r"`p1` must be two numbers"),
    ],
)
def test_what_is_no_pixel_is_refused(p1, text):
    with pytest.raises(ValueError, match=text):
        distance(fitted("metric"), p1, (10, 10), wall("metric"))


def test_a_missing_depth_is_named():
    with pytest.raises(ValueError, match="`depth` is missing"):
        distance(fitted("metric"), (1, 1), (2, 2))


def test_depths_of_objects_cannot_be_looked_up():
    with pytest.raises(TypeError, match="got ObjectDepths, one value per object"):
        distance(fitted("metric"), (1, 1), (2, 2), references("metric")[1])


def test_a_map_of_another_kind_is_refused():
    with pytest.raises(ims.DepthMismatchError, match="must be of the model's kind"):
        distance(fitted("metric"), (1, 1), (2, 2), wall("relative"))


def test_a_camera_of_another_picture_is_refused():
    with pytest.raises(ValueError, match=r"`camera\.image_size`"):
        distance(
            fitted("relative"), (1, 1), (20, 20), wall("relative"),
            camera=attrs.evolve(CAMERA, image_size=(320, 240)),
        )  # fmt: skip


def test_a_ground_plane_takes_no_other_camera_than_the_models():
    detections, _ = ground_scene(5.0, 0.0)
    model = ims.fit(detections, ims.GroundPlane(image_size=SIZE), DOORS, noise=EXACT)
    with pytest.raises(ValueError, match="`camera` must be the model's on a ground plane"):
        distance(model, (300, 400), (310, 420), camera=CAMERA)


def test_a_point_above_the_horizon_is_nowhere_on_the_ground():
    detections, _ = ground_scene(5.0, 0.0)
    camera = attrs.evolve(CAMERA, image_size=SIZE)
    model = ims.fit(detections, ims.GroundPlane(image_size=SIZE), DOORS, camera=camera)
    length = distance(model, (300, 5), (310, 420))
    assert math.isnan(length.value)
    assert Flag.BEYOND_HORIZON in length.flags


# --- frames fitted together, other planes, what looks like a point -------------------------------


def shared_ground(n_frames=3):
    detections, pixel = ground_scene(5.0, 0.0)
    camera = attrs.evolve(CAMERA, image_size=SIZE)
    frame = ims.Frame(detections, ims.GroundPlane(image_size=SIZE), camera=camera)
    return ims.fit_shared([frame] * n_frames, DOORS), pixel


def test_a_frame_of_many_says_what_is_farther_than_its_references():
    # references from 12 to 20 m
    models, pixel = shared_ground()
    near, far = [pixel(14, 0), pixel(16, 2)], [pixel(60, 0), pixel(16, 2)]
    for model in models:
        assert Flag.EXTRAPOLATED not in distance(model, *near).flags
        assert Flag.EXTRAPOLATED in distance(model, *far).flags


def test_predict_and_extent_say_so_too():
    model = shared_ground()[0][0]
    pixel = ground_scene(5.0, 0.0)[1]
    for forward, told in ((16.0, False), (60.0, True)):
        (x, foot), (_, top) = pixel(forward, 0.0), pixel(forward, 0.0, 2.0)
        box = (x - 5, top, x + 5, foot)
        flags = ims.predict(model, [ims.Detection("statue", box)])[0].flags
        assert (Flag.EXTRAPOLATED in flags) == told
        corners = [(box[0], top), (box[2], top), (box[2], foot), (box[0], foot)]
        assert (Flag.EXTRAPOLATED in extent(model, corners).flags) == told


@pytest.mark.parametrize("verb", ["distance", "extent", "regionprops_table"])
def test_another_ground_plane_is_refused_by_name(verb):
    detections, pixel = ground_scene(5.0, 0.0)
    camera = attrs.evolve(CAMERA, image_size=SIZE)
    plane = ims.GroundPlane(image_size=SIZE)
    model = ims.fit(detections, plane, DOORS, camera=camera)
    corners = [(300, 300), (350, 300), (350, 400)]
    labels = np.zeros((HEIGHT, WIDTH), dtype=int)
    labels[300:400, 300:350] = 1
    measure = {
        "distance": lambda depth: distance(model, pixel(12, 1), pixel(18, -3), depth),
        "extent": lambda depth: extent(model, corners, depth).height,
        "regionprops_table": lambda depth: regionprops_table(model, labels, depth)["height_m"][0],
    }[verb]
    assert measure(plane) == measure(None)
    other = ims.GroundPlane(image_size=SIZE, camera_height_m=1.0)
    with pytest.raises(ims.DepthMismatchError, match="`depth` must be the model's ground plane"):
        measure(other)


def test_a_masked_point_is_refused():
    masked = np.ma.array([100.5, 80.5], mask=[True, False])
    with pytest.raises(ValueError, match=r"`p1` must be two numbers .* no masked entry"):
        distance(fitted("metric"), masked, (10, 10), wall("metric"))
    bare = np.ma.array([100.5, 80.5])
    assert distance(fitted("metric"), bare, (10.5, 10.5), wall("metric")).value > 0


def test_numpys_truth_values_are_truth_values():
    depth, ends = wall("relative"), ((100.5, 80.5), (500.5, 400.5))
    told = distance(NOISY, *ends, depth, same_object=np.True_, same_scale=np.False_)
    assert told == distance(NOISY, *ends, depth, same_object=True)
    with pytest.raises(TypeError, match="`same_object` must be a bool; got int"):
        distance(NOISY, *ends, depth, same_object=1)


def test_feet_in_one_row_are_equally_far_only_without_roll():
    detections, _ = ground_scene(0.0, 0.03)
    model = ims.fit(detections, ims.GroundPlane(image_size=SIZE), DOORS, noise=EXACT)
    with pytest.raises(
        ValueError, match=r"nor in one row, unless roll_deg=0\.0, roll_std_deg=0\.0"
    ):
        distance(model, (300, 400), (400, 400))
    level = ims.GroundPlane(image_size=SIZE, roll_deg=0.0, roll_std_deg=0.0)
    assert distance(ims.fit(detections, level, DOORS), (300, 400), (400, 400)).value > 0


def test_a_frame_without_references_of_its_own_cannot_say_how_far_they_were():
    detections, pixel = ground_scene(5.0, 0.0)
    camera = attrs.evolve(CAMERA, image_size=SIZE)
    plane = ims.GroundPlane(image_size=SIZE)
    empty = ims.Frame([], plane, camera=camera)
    full = ims.Frame(detections, plane, camera=camera)
    model = ims.fit_shared([full, empty, full], DOORS)[1]
    length = distance(model, pixel(60, 0), pixel(16, 2))
    low, high = length.interval(0.9)
    assert low < math.hypot(44, 2) < high
    assert Flag.EXTRAPOLATED not in length.flags
