"""The ground plane as depth: feet tell distances, against projections and brute force."""

import itertools
import json
import math
from typing import NamedTuple

import attrs
import numpy as np
import pytest

import imgscale as ims
from imgscale import Flag
from imgscale.core.predictive import scale_of
from imgscale.posing import problem_of_model, solve_by, view_of
from imgscale.standing import stance_of

METHODS = ["posterior", "robust"]
SIZE = (1280, 960)
WIDTH, HEIGHT = SIZE
FOCAL = 1000.0
EXACT = ims.Noise(box_px=0.0, box_rel=0.0, depth_rel=0.0)
CAMERA = ims.Camera(FOCAL, focal_rel_std=0.0)
GROUND = ims.GroundPlane(image_size=SIZE)
RELIEF, SLOPE_PX = 0.03, 0.0015 * WIDTH  # what the library says of feet


class Pole(NamedTuple):
    """A vertical pole on the ground, as it is and as it is seen."""

    size_m: float
    xyxy: tuple[float, float, float, float]
    foot_z_m: float
    middle_z_m: float


def project(forward, lateral, up, pitch):
    """Pixel and z-depth of a point: metres before, to the right of and above the camera."""
    cos, sin = math.cos(pitch), math.sin(pitch)
    z = forward * cos - up * sin
    y = -(forward * sin + up * cos)
    return WIDTH / 2 + FOCAL * lateral / z, HEIGHT / 2 + FOCAL * y / z, z


def poles(rng, count, *, pitch_deg=0.0, cross_fall=0.0, height_m=1.7):
    """Poles that are in view as a whole, on ground that falls by `cross_fall` to the right."""
    pitch, found = math.radians(pitch_deg), []
    for _ in range(100_000):
        forward = height_m * rng.uniform(1.5, 14)
        lateral = forward * rng.uniform(-0.6, 0.6)
        size_m = height_m * rng.uniform(0.2, 0.7)
        ground = -height_m - cross_fall * lateral
        x, foot, foot_z = project(forward, lateral, ground, pitch)
        _, top, top_z = project(forward, lateral, ground + size_m, pitch)
        if min(foot_z, top_z) > 0 and 5 < top < foot - 8 < HEIGHT - 13 and 5 < x < WIDTH - 5:
            middle_z = (foot_z + top_z) / 2
            found.append(Pole(size_m, (x - 3, top, x + 3, foot), foot_z, middle_z))
        if len(found) == count:
            return found
    raise AssertionError("no such scene")


def exact_scene(seed, *, level):
    """A camera at 0.3 to 12 m, ground within 2 degrees across, pitch 0 or up to 40 degrees."""
    rng = np.random.default_rng(seed)
    truth = {
        "pitch_deg": 0.0 if level else rng.uniform(0, 40),
        "cross_fall": math.tan(math.radians(rng.uniform(-2, 2))),
        "height_m": math.exp(rng.uniform(math.log(0.3), math.log(12))),
    }
    return poles(rng, int(rng.integers(5, 9)), **truth), truth


def foot_variance(pixels, below):
    """
    Variance of the log size by the foot: boxes err by 1 px, their edges by 1 / sqrt(2) each.

    The lower edge e is the foot too: it adds e / pixels to the extent and e / below to the row.
    """
    edges = 0.5 / pixels**2 + 0.5 * (1 / pixels - 1 / below) ** 2
    return edges + (SLOPE_PX / below) ** 2 + RELIEF**2


def seen(objects):
    return [ims.Detection(f"pole {i}", pole.xyxy) for i, pole in enumerate(objects)]


def table(objects, std=0.0, mean_std=0.0):
    return ims.PriorTable([
        ims.ObjectPrior(f"pole {i}", size, std * size, mean_std_m=mean_std * size)
        for i, size in enumerate(pole.size_m for pole in objects)
    ])  # fmt: skip


# --- exact scenes ------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("level", [True, False], ids=["level", "pitched"])
def test_exact_scenes_give_camera_and_sizes(level, method):
    # the grid of the posterior is as fine as exact references: fewer scenes, for time
    misses, count = [], 30 if method == "robust" else 6
    for seed in range(count):
        objects, truth = exact_scene(seed, level=level)
        camera = None if level else CAMERA
        options = {"camera": camera, "noise": EXACT, "method": method}
        model = ims.fit(seen(objects), GROUND, table(objects[:-1]), **options)
        sizes = ims.predict(model, seen(objects))
        pitch = math.radians(truth["pitch_deg"])
        horizon = HEIGHT / 2 - FOCAL * math.tan(pitch)
        # a tilted camera sees a cross-fall 1 / cos(pitch) times as steep
        cross_fall = math.tan(math.radians(model.plane.roll_deg)) * math.cos(pitch)
        errors = [
            model.k / truth["height_m"] - 1,
            model.camera_height_m / truth["height_m"] - 1,
            (model.horizon_px - horizon) / HEIGHT,
            cross_fall - truth["cross_fall"],
            *(one.size_m / pole.size_m - 1 for one, pole in zip(sizes, objects, strict=True)),
        ]
        if not np.abs(errors).max() < 1e-9:
            misses.append((seed, truth, np.abs(errors).max()))
    assert not misses, f"{len(misses)} of {count}: {misses}"


@pytest.mark.parametrize("level", [True, False], ids=["level", "pitched"])
def test_distances_are_the_z_depths_of_the_feet(level):
    for seed in range(8):
        objects, _ = exact_scene(seed, level=level)
        camera = CAMERA  # its focal length gives the distance, also where there is no tilt
        options = {"camera": camera, "noise": EXACT, "method": "robust"}
        model = ims.fit(seen(objects), GROUND, table(objects[:-1]), **options)
        for size, pole in zip(ims.predict(model, seen(objects)), objects, strict=True):
            assert size.distance_m == pytest.approx(pole.foot_z_m, rel=1e-9)


def test_without_a_focal_length_there_is_no_distance():
    objects, _ = exact_scene(1, level=True)
    model = ims.fit(seen(objects), GROUND, table(objects), noise=EXACT)
    assert model.focal_px is None
    assert {size.distance_m for size in ims.predict(model, seen(objects))} == {None}


# --- the correction of tilts -------------------------------------------------------------------


def stance(detections, camera=CAMERA, *, upright=True):
    """Where the boxes lie, as the core sees them."""
    model = ims.fit(
        [ims.Detection("post", (600.0, 500.0, 610.0, 700.0))], GROUND,
        ims.PriorTable([ims.ObjectPrior("post", 1.0, 0.0)]), camera=camera, method="robust",
    )  # fmt: skip
    boxes = np.array([detection.xyxy for detection in detections])
    feet = np.stack([boxes[:, [0, 2]].mean(axis=1), boxes[:, 3]], axis=1)
    rows = np.full(len(boxes), upright)
    return stance_of(view_of(model), boxes, feet, rows, np.zeros(len(boxes)))


@pytest.mark.parametrize("pitch_deg", [-15.0, 0.0, 3.0, 20.0, 45.0])
def test_the_correction_from_the_foot_is_exact(pitch_deg):
    pitch, height, cross_fall = math.radians(pitch_deg), 3.0, 0.02
    objects = poles(
        np.random.default_rng(0), 8, pitch_deg=pitch_deg, cross_fall=cross_fall, height_m=height
    )
    horizon = np.full((1, 8), -FOCAL * math.tan(pitch))
    here = stance(seen(objects))
    below = here.below_horizon(horizon, np.full((1, 8), cross_fall / math.cos(pitch)))
    x1, top, x2, foot = np.array([pole.xyxy for pole in objects]).T
    found = height * (foot - top) * np.exp(here.tilts(horizon).by_foot) / below
    np.testing.assert_allclose(found[0], [pole.size_m for pole in objects], rtol=1e-12)
    if pitch:  # the same by the vertical vanishing point
        y0, yv = HEIGHT / 2 - FOCAL * math.tan(pitch), HEIGHT / 2 + FOCAL / math.tan(pitch)
        fallen = cross_fall / math.cos(pitch) * ((x1 + x2) / 2 - WIDTH / 2)
        size = height * (foot - top) * (yv - y0) / ((yv - top) * (foot - y0 - fallen))
        np.testing.assert_allclose(found[0], size, rtol=1e-12)


@pytest.mark.parametrize("pitch_deg", [-15.0, 0.0, 3.0, 20.0, 45.0])
def test_the_correction_from_z_depth_is_that_of_the_middle_row(pitch_deg):
    pitch = math.radians(pitch_deg)
    detections = seen(poles(np.random.default_rng(1), 8, pitch_deg=pitch_deg))
    y0, middle = -FOCAL * math.tan(pitch), np.array([sum(d.xyxy[1::2]) / 2 for d in detections])
    factor = math.cos(pitch) * (1 + y0 * (middle - HEIGHT / 2) / FOCAL**2)
    found = stance(detections).tilts(np.full((1, 8), y0)).by_depth
    np.testing.assert_allclose(np.exp(found[0]), 1 / factor, rtol=1e-12)


@pytest.mark.parametrize("pitch_deg", [-15.0, 0.0, 3.0, 20.0, 45.0])
def test_with_the_z_depth_of_its_middle_an_upright_object_is_sized_exactly(pitch_deg):
    objects = poles(np.random.default_rng(2), 8, pitch_deg=pitch_deg)
    horizon = np.full((1, 8), -FOCAL * math.tan(math.radians(pitch_deg)))
    factor = np.exp(stance(seen(objects)).tilts(horizon).by_depth[0])
    sizes = [(p.xyxy[3] - p.xyxy[1]) * p.middle_z_m / FOCAL for p in objects] * factor
    np.testing.assert_allclose(sizes, [pole.size_m for pole in objects], rtol=1e-12)


@pytest.mark.parametrize("pitch_deg", [5.0, 20.0, 40.0])
def test_with_the_z_depth_of_its_middle_row_it_errs_by_the_square_of_its_extent(pitch_deg):
    pitch, forward, middle = math.radians(pitch_deg), 6.0, -2.5
    errors = []
    for size in (0.8, 0.4, 0.2):
        (x, foot, _), (_, top, _) = (
            project(forward, 0.0, middle + up, pitch) for up in (-size / 2, size / 2)
        )
        detection = ims.Detection("pole", (x - 3, top, x + 3, foot))
        tilt = stance([detection]).tilts(np.full((1, 1), -FOCAL * math.tan(pitch))).by_depth[0, 0]
        # the ray of the middle row meets the pole here
        angle = pitch + math.atan(((top + foot) / 2 - HEIGHT / 2) / FOCAL)
        _, _, z = project(forward, 0.0, -forward * math.tan(angle), pitch)
        errors.append(abs(math.log((foot - top) * z / FOCAL / size) + tilt))
    assert 1e-6 < errors[0] < 5e-3
    for larger, smaller in itertools.pairwise(errors):
        assert larger / smaller == pytest.approx(4, rel=0.05)


def test_across_the_view_only_the_distance_is_corrected():
    # a horizontal bar across, at the foot of the camera's plane: p = f W / Z
    pitch, height, width, forward = math.radians(25.0), 4.0, 0.8, 9.0
    x1, foot, z = project(forward, -width / 2, -height, pitch)
    x2, _, _ = project(forward, width / 2, -height, pitch)
    detection = ims.Detection("bar", (x1, foot - 30, x2, foot))
    here = stance([detection], upright=False)
    horizon = np.full((1, 1), -FOCAL * math.tan(pitch))
    tilts, below = here.tilts(horizon), foot - HEIGHT / 2 - horizon[0, 0]
    assert tilts.by_depth[0, 0] == 0.0
    assert height * (x2 - x1) * math.exp(tilts.by_foot[0, 0]) / below == pytest.approx(
        width, rel=1e-12
    )
    assert (x2 - x1) * z / FOCAL == pytest.approx(width, rel=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_a_told_height_and_horizon_size_objects_by_the_closed_form(method):
    pitch, height = math.radians(20.0), 3.0
    objects = poles(np.random.default_rng(4), 6, pitch_deg=20.0, height_m=height)
    told = ims.GroundPlane(
        image_size=SIZE, horizon_px=HEIGHT / 2 - FOCAL * math.tan(pitch), horizon_std_px=0.0,
        camera_height_m=height, camera_height_std_m=0.0,
    )  # fmt: skip
    model = ims.fit(seen(objects), told, table([]), camera=CAMERA, noise=EXACT, method=method)
    for size, pole in zip(ims.predict(model, seen(objects)), objects, strict=True):
        # a horizon without an error counts as known to 1e-6 of the longer side
        assert size.size_m == pytest.approx(pole.size_m, rel=1e-7)


# --- what counts -------------------------------------------------------------------------------


def column(size_m, foot, *, horizon=480.0, height_m=1.6, x=640.0, label="post", **options):
    """A thing before a level camera, by p / H = (y - y0) / h."""
    pixels = size_m * (foot - horizon) / height_m
    return ims.Detection(label, (x - 10, foot - pixels, x + 10, foot), **options)


POST = ims.PriorTable([
    ims.ObjectPrior("post", 1.2, 0.02),
    ims.ObjectPrior("lamp", 0.4, 0.02, on_ground=False),
])  # fmt: skip
POSTS = [column(1.2, foot, x=x) for foot, x in ((560, 300), (640, 900), (800, 500), (700, 700))]


@pytest.mark.parametrize("method", METHODS)
def test_what_hangs_is_no_reference_and_has_no_size(method):
    lamp = ims.Detection("lamp", (400, 200, 420, 260))
    model = ims.fit([*POSTS, lamp], GROUND, POST, method=method)
    *others, hangs = model.references
    assert [ref.reason for ref in others] == [""] * 4
    assert (hangs.reason, hangs.weight) == ("not on the ground", 0.0)
    assert np.isnan(hangs.foot_xy).all()
    alone = ims.fit(POSTS, GROUND, POST, method=method)
    assert (model.k, model.k_std, model.plane) == (alone.k, alone.k_std, alone.plane)
    [size] = ims.predict(model, [lamp])
    assert math.isnan(size.size_m)
    assert size.flags == Flag.NO_DEPTH
    assert "lamp (not on the ground)" in str(model)


def test_a_partial_object_is_no_reference_and_shows_no_foot():
    cut = column(1.2, 600, x=1000.0, partial=True)
    model = ims.fit([*POSTS, cut], GROUND, POST, method="robust")
    assert model.references[-1].reason == "partial"
    assert np.isnan(model.references[-1].foot_xy).all()
    [size] = ims.predict(model, [cut])
    assert math.isnan(size.size_m)
    assert size.flags == Flag.PARTIAL | Flag.NO_DEPTH


@pytest.mark.parametrize(("foot", "is_in_view"), [(960, False), (959, False), (958, True)])
def test_a_box_that_ends_at_the_lower_border_has_no_foot(foot, is_in_view):
    thing = ims.Detection("post", (630, 700, 650, foot))
    model = ims.fit([*POSTS, thing], GROUND, POST, method="robust")
    assert (model.references[-1].foot_xy == (640, foot)) == is_in_view
    assert (model.references[-1].reason != "partial") == is_in_view
    [size] = ims.predict(model, [thing])
    assert math.isfinite(size.size_m) == is_in_view
    assert (Flag.PARTIAL in size.flags) != is_in_view


def test_an_object_cut_at_the_side_is_no_reference_but_stands_where_its_foot_is():
    cut = ims.Detection("post", (0, 500, 20, 700))
    model = ims.fit([*POSTS, cut], GROUND, POST, method="robust")
    assert model.references[-1].reason == "partial"
    [size] = ims.predict(model, [cut])
    assert size.flags == Flag.PARTIAL
    across = math.tan(math.radians(model.plane.roll_deg)) * (10 - WIDTH / 2)
    below = 700 - model.horizon_px - across
    assert size.size_m == pytest.approx(model.k * 200 / below, rel=1e-12)


def test_the_lowest_pixels_of_a_mask_are_the_foot():
    told = ims.GroundPlane(image_size=SIZE, horizon_px=480.0, horizon_std_px=0.0)
    mask = np.zeros((HEIGHT, WIDTH), dtype=bool)
    mask[500:700, 300:400] = True
    mask[700:720, 360:371] = True  # one leg, whose last row is 719
    masked, plain = (
        ims.Detection("thing", (300.0, 500.0, 400.0, 740.0), mask=m) for m in (mask, None)
    )
    model = ims.fit([*POSTS, masked, plain], told, POST, method="robust")
    assert [ref.foot_xy for ref in model.references[-2:]] == [(365.5, 720.0), (350.0, 740.0)]
    slope = math.tan(math.radians(model.plane.roll_deg))
    for size, (x, y) in zip(
        ims.predict(model, [masked, plain]), [(365.5, 720.0), (350.0, 740.0)], strict=True
    ):
        below = y - model.horizon_px - slope * (x - WIDTH / 2)
        assert size.size_m == pytest.approx(model.k * 240 / below, rel=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_an_object_above_the_horizon_has_no_size(method):
    bird = ims.Detection("bird", (600, 300, 640, 330))
    model = ims.fit([*POSTS, bird], GROUND, POST, method=method)
    [size] = ims.predict(model, [bird])
    assert math.isnan(size.size_m)
    assert size.flags == Flag.BEYOND_HORIZON
    # nobody knows its size, and no horizon above it is in question
    alone = ims.fit(POSTS, GROUND, POST, method=method)
    assert model.k == pytest.approx(alone.k, rel=1e-9)
    assert model.k_std == pytest.approx(alone.k_std, rel=0.01)


@pytest.mark.parametrize("method", METHODS)
def test_far_beyond_the_references_is_flagged(method):
    told = ims.GroundPlane(image_size=SIZE, horizon_px=480.0, horizon_std_px=1.0)
    # the references are 80 to 320 rows below the horizon
    feet = [480 + 80 / 2.2, 480 + 80 / 1.8, 720.0, 480 + 320 * 1.45]
    things = [column(1.0, foot, label="thing") for foot in feet]
    references = [column(1.2, foot) for foot in (560, 640, 800)]
    model = ims.fit([*references, *things], told, POST, method=method)
    flags = [size.flags for size in ims.predict(model, things)]
    assert flags == [Flag.EXTRAPOLATED, Flag(0), Flag(0), Flag(0)]
    near = [column(1.2, 560), column(1.2, 600)]
    [close] = ims.predict(ims.fit(near, told, POST, method=method), [column(1.0, 800)])
    assert close.flags == Flag.EXTRAPOLATED


def test_nothing_of_known_size_is_an_error_that_says_so():
    with pytest.raises(ims.FitError, match=r"at least one reference.*thing \(no prior\)"):
        ims.fit([column(1.0, 700, label="thing")], GROUND, POST)
    lamp = ims.Detection("lamp", (400, 200, 420, 260))
    message = r"lamp \(not on the ground\).*only objects that stand on it are references"
    with pytest.raises(ims.FitError, match=message):
        ims.fit([lamp], GROUND, POST)
    with pytest.raises(ims.FitError, match="got no detection"):
        ims.fit([], GROUND, POST)


@pytest.mark.parametrize("method", METHODS)
def test_the_cameras_height_alone_sizes_objects(method):
    told = ims.GroundPlane(
        image_size=SIZE, horizon_px=480.0, horizon_std_px=0.0,
        camera_height_m=1.6, camera_height_std_m=0.08,
    )  # fmt: skip
    thing = column(1.0, 700, label="thing")  # in the middle column, where no slope counts
    model = ims.fit([thing], told, POST, method=method)
    [size] = ims.predict(model, [thing])
    assert size.size_m == pytest.approx(1.0, rel=1e-6)
    variance = 0.05**2 + foot_variance(thing.height_px, 220.0)
    # the points of a grid and their blending keep widths to 1e-3 or so
    assert size.std_m / size.size_m == pytest.approx(math.sqrt(variance), rel=2e-3)
    assert model.k_std / model.k == pytest.approx(0.05, rel=2e-3)
    assert model.camera_height_m == pytest.approx(1.6, rel=1e-6)
    assert math.isnan(model.mean_depth)


@pytest.mark.parametrize("height_m", [0.3, 1.0, 1.6, 3.0])
def test_an_error_of_the_lower_edge_is_one_of_extent_and_distance(height_m):
    # boxes err by 4 px here, and no plane does; both edges are drawn by hand in the simulation
    told = ims.GroundPlane(
        image_size=SIZE, horizon_px=480.0, horizon_std_px=0.0,
        camera_height_m=1.6, camera_height_std_m=0.0,
    )  # fmt: skip
    thing = column(height_m, 700, label="thing")
    noise = ims.Noise(box_px=4.0, depth_rel=0.0)
    model = ims.fit([thing], told, POST, method="robust", noise=noise)
    [size] = ims.predict(model, [thing])
    top, low = np.random.default_rng(0).normal(size=(2, 100_000)) * 4 / math.sqrt(2)
    drawn = np.log(1.6 * (thing.height_px + low - top) / (220 + low))
    # 0.2 % by the number of draws; the law is that of small errors
    assert size.std_m / size.size_m == pytest.approx(drawn.std(), rel=0.02)


@pytest.mark.parametrize(
    ("told", "log_std"), [(0.08, 0.05), (None, 0.02)], ids=["with its error", "without"]
)
def test_the_cameras_height_is_a_witness_like_the_references(told, log_std):
    ground = ims.GroundPlane(
        image_size=SIZE, horizon_px=480.0, horizon_std_px=0.0,
        camera_height_m=1.6, camera_height_std_m=told,
    )  # fmt: skip
    # 1 % higher by three references in the middle column
    detections = [column(1.2, foot, height_m=1.616) for foot in (560, 640, 800)]
    model = ims.fit(detections, ground, POST, method="robust")
    pixels = np.array([d.height_px for d in detections])
    below = np.array([80.0, 160.0, 320.0])
    prior_var = math.log1p((0.02 / 1.2) ** 2)
    own = math.log(1.2) - prior_var / 2 + np.log(below / pixels)
    own_var = prior_var + foot_variance(pixels, below)
    precision = np.append(1 / own_var, log_std**-2)
    expected = np.append(own, math.log(1.6)) @ precision / precision.sum()
    # redescending weights differ from 1 by 1 % where references are 0.3 errors off
    assert math.log(model.k) == pytest.approx(expected, abs=1e-4)
    assert model.k_std / model.k == pytest.approx(precision.sum() ** -0.5, rel=0.01)


@pytest.mark.parametrize("method", METHODS)
def test_a_told_horizon_is_kept_and_narrows_the_height(method):
    stds = []
    for told in (None, 20.0, 2.0, 0.0):
        ground = GROUND
        if told is not None:
            ground = ims.GroundPlane(image_size=SIZE, horizon_px=480.0, horizon_std_px=told)
        model = ims.fit(POSTS[:2], ground, POST, method=method)
        stds.append(model.k_std / model.k)
        if told is not None:
            assert abs(model.horizon_px - 480) < 0.2 * told + 1e-2
            assert model.plane.horizon_std_px < 1.1 * told + 1e-2
    assert stds == sorted(stds, reverse=True)
    assert stds[-1] < 0.5 * stds[0]


@pytest.mark.parametrize("method", METHODS)
def test_a_wrong_horizon_told_as_exact_moves_the_height_by_the_law(method):
    # one reference 200 rows below the true horizon, 160 below the told one
    ground = ims.GroundPlane(image_size=SIZE, horizon_px=520.0, horizon_std_px=0.0)
    model = ims.fit([column(1.2, 680)], ground, POST, method=method)
    assert model.horizon_px == pytest.approx(520, abs=1e-2)
    # the prior of the height, a factor of 2 wide, draws by a thousandth
    assert model.k == pytest.approx(1.6 * 160 / 200, rel=3e-3)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_a_cross_fall_that_is_told_gives_exact_sizes(method):
    cross_fall = math.tan(math.radians(6.0))
    objects = poles(np.random.default_rng(6), 7, cross_fall=cross_fall)
    errors = {}
    for told in ({}, {"roll_deg": 6.0, "roll_std_deg": 0.0}):
        ground = ims.GroundPlane(image_size=SIZE, horizon_px=480.0, horizon_std_px=0.0, **told)
        model = ims.fit(seen(objects), ground, table(objects[:1]), noise=EXACT, method=method)
        sizes = ims.predict(model, seen(objects))
        errors[bool(told)] = max(
            abs(one.size_m / pole.size_m - 1) for one, pole in zip(sizes, objects, strict=True)
        )
    # a roll without an error counts as known to 1e-6
    assert errors[True] < 1e-5
    assert errors[False] > 0.05


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("told", "expected"), [(None, 0.5), (0.2, 0.2), (1.0, 1.0)])
def test_the_error_of_a_told_roll_is_kept_where_nothing_else_tells_it(told, expected, method):
    # one reference in the middle column
    ground = ims.GroundPlane(image_size=SIZE, roll_deg=3.0, roll_std_deg=told)
    model = ims.fit([column(1.2, 680)], ground, POST, method=method)
    assert model.plane.roll_deg == pytest.approx(3.0, abs=0.1 * expected)
    # some dozens of cases tell it to some per cent
    assert model.plane.roll_std_deg == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("roll_deg", [-46.0, 45.1, 90.0])
def test_a_roll_beyond_45_degrees_is_refused(roll_deg):
    with pytest.raises(ValueError, match=rf"`roll_deg` must be between -45 and 45; got {roll_deg}"):
        ims.GroundPlane(image_size=SIZE, roll_deg=roll_deg)
    for lawful in (-45.0, 45.0):
        assert ims.GroundPlane(image_size=SIZE, roll_deg=lawful).roll_deg == lawful


def test_the_error_of_a_roll_that_is_not_told_is_refused():
    with pytest.raises(ValueError, match=r"`roll_deg` must be given with its.*None \+- 0\.5"):
        ims.GroundPlane(image_size=SIZE, roll_std_deg=0.5)


@pytest.mark.parametrize("method", METHODS)
def test_a_fitted_plane_is_what_is_known_of_the_next_picture(method):
    plane = ims.fit(POSTS, GROUND, POST, method=method).plane
    again = ims.fit([], plane.as_prior(SIZE), POST, method=method).plane
    assert again.camera_height_m == pytest.approx(plane.camera_height_m, rel=1e-3)
    assert again.horizon_px == pytest.approx(plane.horizon_px, abs=0.1 * plane.horizon_std_px)
    assert again.roll_deg == pytest.approx(plane.roll_deg, abs=0.1 * plane.roll_std_deg)
    # some dozens of cases tell them to some per cent
    for name in ("camera_height_std_m", "horizon_std_px", "roll_std_deg"):
        assert getattr(again, name) == pytest.approx(getattr(plane, name), rel=0.1)


def test_what_moves_between_pictures_adds_to_the_errors_of_a_fitted_plane():
    plane = ims.fit(POSTS, GROUND, POST, method="robust").plane
    still, moving = plane.as_prior(SIZE), plane.as_prior(SIZE, jitter_px=4.0, jitter_deg=1.0)
    assert attrs.asdict(still) == {"image_size": SIZE, **attrs.asdict(plane)}
    assert moving.horizon_std_px**2 - plane.horizon_std_px**2 == pytest.approx(16)
    assert moving.roll_std_deg**2 - plane.roll_std_deg**2 == pytest.approx(1)
    told = {"horizon_std_px": plane.horizon_std_px, "roll_std_deg": plane.roll_std_deg}
    assert attrs.evolve(moving, **told) == still


# --- a horizon that nobody told -----------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_a_horizon_that_rests_on_photos_at_large_is_flagged(method):
    one = ims.fit([column(1.2, 680)], GROUND, POST, method=method)
    assert Flag.ASSUMED_HORIZON in one.flags
    # HORIZON_STD is 154 px
    assert one.plane.horizon_std_px > 77
    height = ims.GroundPlane(image_size=SIZE, camera_height_m=1.6)
    side_by_side = [column(1.2, 680, x=x) for x in (300.0, 900.0)]
    model = ims.fit(side_by_side, GROUND, POST, method=method)
    assert Flag.ASSUMED_HORIZON in model.flags
    # the height and one size tell the horizon together
    assert Flag.ASSUMED_HORIZON not in ims.fit(side_by_side, height, POST, method=method).flags


@pytest.mark.parametrize("method", METHODS)
def test_a_horizon_that_somebody_or_the_picture_told_is_not_flagged(method):
    thing = [column(1.2, 680)]
    horizon = ims.GroundPlane(image_size=SIZE, horizon_px=480.0, horizon_std_px=200.0)
    pitch = ims.Camera(FOCAL, focal_rel_std=0.0, pitch_std_deg=10.0)
    depth = ims.ObjectDepths([8.0], kind="relative", image_size=SIZE)
    models = {
        "horizon": ims.fit(thing, horizon, POST, method=method),
        "pitch": ims.fit(thing, GROUND, POST, camera=pitch, method=method),
        "picture": ims.fit(POSTS, GROUND, POST, method=method),
        "depth": ims.fit(thing, depth, POST, ground=GROUND, method=method),
    }
    flagged = [name for name, model in models.items() if Flag.ASSUMED_HORIZON in model.flags]
    assert flagged == []


# --- a focal length that errs --------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("focal_rel_std", [0.03, 0.08])
def test_the_error_of_the_focal_length_widens_sizes_below_a_tilted_camera(focal_rel_std, method):
    # p h (1 + tan^2 T) / (1 - tan T y / f) / (foot - y0) with tan T = -y0 / f, 25 degrees down
    y0, height, top, foot = -FOCAL * math.tan(math.radians(25.0)), 2.6, 50.0, 360.0
    told = ims.GroundPlane(
        image_size=SIZE, horizon_px=HEIGHT / 2 + y0, horizon_std_px=0.0,
        camera_height_m=height, camera_height_std_m=0.0,
    )  # fmt: skip
    person = ims.Detection("thing", (630, HEIGHT / 2 + top, 650, HEIGHT / 2 + foot))

    def size(focal_px, rel=0.0):
        looking = ims.Camera(focal_px, focal_rel_std=rel)
        noise = ims.Noise(box_px=0.5, depth_rel=0.002)
        model = ims.fit([person], told, table([]), camera=looking, noise=noise, method=method)
        return ims.predict(model, [person])[0]

    def by_hand(focal):
        tangent = -y0 / focal
        return height * (foot - top) * (1 + tangent**2) / (1 - tangent * top / focal) / (foot - y0)

    assert size(FOCAL).size_m == pytest.approx(by_hand(FOCAL), rel=1e-6)
    slope = math.log(by_hand(1.01 * FOCAL) / by_hand(0.99 * FOCAL)) / 0.02
    assert slope < -0.3
    exact, widened = (one.std_m / one.size_m for one in (size(FOCAL), size(FOCAL, focal_rel_std)))
    # some dozens of cases tell it to some per cent
    assert widened == pytest.approx(math.hypot(exact, slope * focal_rel_std), rel=0.05)


@pytest.mark.slow
def test_two_doors_tell_how_far_a_focal_length_can_be_trusted_near_the_camera():
    # a person at 2.6 m, under a camera whose focal length errs by 8 %; the errors of 60 drawings
    rng, scores = np.random.default_rng(7), []
    priors = ims.PriorTable([ims.ObjectPrior("door", 2.04, 0.003)])
    ground = ims.GroundPlane(image_size=SIZE, camera_height_m=2.6, camera_height_std_m=0.03)
    noise = ims.Noise(box_px=1.5, depth_rel=0.005)
    for _ in range(60):
        pitch, height = math.radians(rng.uniform(20, 30)), rng.normal(2.6, 0.03)
        truth = rng.normal(1.78, 0.08)
        detections = []
        for label, size, forward, lateral in (
            ("door", rng.normal(2.04, 0.003), 6.0, -0.7),
            ("door", rng.normal(2.04, 0.003), 6.0, 0.7),
            ("person", truth, 2.6, 0.1),
        ):
            low = -height + rng.normal(0, 0.013)
            x, foot, _ = project(forward, lateral, low, pitch)
            _, top, _ = project(forward, lateral, low + size, pitch)
            top, foot = np.array([top, foot]) + rng.normal(0, 1.5 / math.sqrt(2), 2)
            detections.append(ims.Detection(label, (x - 9, top, x + 9, foot)))
        told = ims.Camera(FOCAL * math.exp(0.08 * rng.normal()), focal_rel_std=0.08)
        model = ims.fit(detections, ground, priors, camera=told, noise=noise, method="robust")
        person = ims.predict(model, detections)[-1]
        scores.append(math.log(person.size_m / truth) / (person.std_m / person.size_m))
    # 1 within three standard errors of such a root mean square
    assert math.sqrt(np.mean(np.square(scores))) == pytest.approx(1.0, abs=3 / math.sqrt(120))


def test_the_plane_need_not_be_given_again():
    model = ims.fit(POSTS, GROUND, POST)
    thing = [column(1.0, 600, label="thing")]
    assert ims.predict(model, thing) == ims.predict(model, thing, GROUND)


def test_the_plane_of_another_picture_is_refused():
    model = ims.fit(POSTS, GROUND, POST, method="robust")
    with pytest.raises(ims.DepthMismatchError, match=r"image_size.*\(1280, 960\).*\(640, 480\)"):
        ims.predict(model, POSTS, ims.GroundPlane(image_size=(640, 480)))
    with pytest.raises(ims.DepthMismatchError, match='"ground_plane"; got "relative"'):
        ims.predict(model, POSTS, ims.ObjectDepths([1.0] * 4, kind="relative"))


def test_the_papers_mean_depth_is_refused():
    model = ims.fit(POSTS, GROUND, POST, method="robust")
    with pytest.raises(ValueError, match="must be left out for a ground-plane model"):
        ims.predict(model, POSTS, depth="mean")


def test_a_box_beyond_the_image_is_refused():
    outside = ims.Detection("post", (600, 500, 620, 1000))
    with pytest.raises(ValueError, match="1280 x 960 px"):
        ims.fit([outside], GROUND, POST)


# --- the model ---------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_a_model_with_a_plane_survives_json(method):
    told = ims.GroundPlane(image_size=SIZE, horizon_px=470.0, camera_height_m=1.7)
    lamp = ims.Detection("lamp", (400, 200, 420, 260))
    model = ims.fit([*POSTS, lamp], told, POST, camera=CAMERA, method=method)
    again = ims.ScaleModel.from_dict(json.loads(json.dumps(model.to_dict())))
    assert again == model
    assert again == ims.ScaleModel.from_dict(model.to_dict())
    assert (again.plane, again.ground) == (model.plane, told)
    thing = [column(1.0, 600, label="thing")]
    assert ims.predict(again, thing) == ims.predict(model, thing)


@pytest.mark.parametrize("method", METHODS)
def test_the_numbers_of_the_model_are_those_of_its_plane(method):
    model = ims.fit(POSTS, GROUND, POST, method=method)
    plane = model.plane
    assert model.camera_height_m == plane.camera_height_m == pytest.approx(model.k, rel=1e-12)
    assert plane.camera_height_std_m == pytest.approx(model.k_std, rel=0.1)  # moments, quantiles
    assert model.horizon_px == plane.horizon_px == -model.shift
    assert model.shift_std == plane.horizon_std_px
    assert model.ground == GROUND
    # a higher horizon makes the camera higher: the shift is minus the horizon
    assert model.correlation > 0.5
    scale = model.metres_per_pixel([model.horizon_px + 100, model.horizon_px - 1])
    np.testing.assert_allclose(scale, [model.k / 100, math.nan])


def test_a_model_without_a_plane_has_none():
    depth = ims.ObjectDepths([5.0], kind="relative")
    model = ims.fit([POSTS[0]], depth, POST)
    assert (model.plane, model.ground, model.camera_height_m, model.horizon_px) == (None,) * 4


def test_the_model_prints_the_height_and_what_it_rests_on():
    thing, cut = column(1.0, 600, label="thing"), column(1.2, 620, partial=True)
    text = str(ims.fit([*POSTS, thing, cut], GROUND, POST))
    assert text.startswith("k = 1.6")
    assert " m (camera height), horizon at row 480 +- " in text
    assert "from 4 of 5 references; not used: post 5 (partial); without a prior: thing" in text


# --- laws --------------------------------------------------------------------------------------


def noisy(seed=3, *, scale=1.0, mirrored=False):
    """Boxes of a crooked scene with errors, and the sizes of all but the last two."""
    rng = np.random.default_rng(seed)
    objects = poles(rng, 6, cross_fall=0.03, height_m=1.6)
    boxes = np.array([pole.xyxy for pole in objects])
    boxes[:, [1, 3]] += rng.normal(size=(6, 2))
    if mirrored:
        boxes[:, [0, 2]] = WIDTH - boxes[:, [2, 0]]
    detections = [ims.Detection(f"pole {i}", scale * row) for i, row in enumerate(boxes)]
    return detections, table(objects[:4], 0.02, 0.01)


@pytest.mark.parametrize("method", METHODS)
def test_the_resolution_of_the_picture_does_not_matter(method):
    detections, priors = noisy()
    doubled, _ = noisy(scale=2.0)
    model = ims.fit(detections, GROUND, priors, method=method, noise=ims.Noise(box_px=1.5))
    large = ims.GroundPlane(image_size=(2 * WIDTH, 2 * HEIGHT))
    again = ims.fit(doubled, large, priors, method=method, noise=ims.Noise(box_px=3.0))
    assert again.k == pytest.approx(model.k, rel=1e-9)
    assert again.k_std == pytest.approx(model.k_std, rel=1e-9)
    assert again.horizon_px == pytest.approx(2 * model.horizon_px, rel=1e-9)
    assert again.plane.roll_deg == pytest.approx(model.plane.roll_deg, rel=1e-9)
    for one, other in zip(ims.predict(again, doubled), ims.predict(model, detections), strict=True):
        assert one.size_m == pytest.approx(other.size_m, rel=1e-9)
        np.testing.assert_allclose(one.interval(), other.interval(), rtol=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_a_mirror_turns_the_roll_and_no_size(method):
    detections, priors = noisy()
    mirrored, _ = noisy(mirrored=True)
    model = ims.fit(detections, GROUND, priors, method=method)
    again = ims.fit(mirrored, GROUND, priors, method=method)
    assert again.plane.roll_deg == pytest.approx(-model.plane.roll_deg, rel=1e-9)
    assert abs(model.plane.roll_deg) > 0.3
    assert again.horizon_px == pytest.approx(model.horizon_px, rel=1e-9)
    for one, other in zip(
        ims.predict(again, mirrored), ims.predict(model, detections), strict=True
    ):
        assert one.size_m == pytest.approx(other.size_m, rel=1e-9)
        # the cases of the plane are not mirrored: a few dozen of them tell widths to some per cent
        assert one.std_m == pytest.approx(other.std_m, rel=0.08)


@pytest.mark.parametrize("method", METHODS)
def test_the_order_of_the_detections_does_not_matter(method):
    detections, priors = noisy()
    order = [4, 2, 0, 5, 3, 1]
    model = ims.fit(detections, GROUND, priors, method=method)
    again = ims.fit([detections[i] for i in order], GROUND, priors, method=method)
    assert again.k == pytest.approx(model.k, rel=1e-9)
    expected = ims.predict(model, detections)
    for i, size in zip(order, ims.predict(again, [detections[i] for i in order]), strict=True):
        assert size.size_m == pytest.approx(expected[i].size_m, rel=1e-9)
        assert size.std_m == pytest.approx(expected[i].std_m, rel=1e-7)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("wrong", [0.5, 2.0])
def test_a_wrong_reference_is_rejected(wrong, method):
    objects = poles(np.random.default_rng(5), 7, height_m=1.6)
    detections = seen(objects)
    sizes = [pole.size_m for pole in objects]
    sizes[2] /= wrong
    priors = ims.PriorTable([
        ims.ObjectPrior(f"pole {i}", size, 0.03 * size) for i, size in enumerate(sizes[:-1])
    ])  # fmt: skip
    model = ims.fit(detections, GROUND, priors, method=method)
    assert [ref.reason for ref in model.references] == ["", "", "outlier", "", "", "", "no prior"]
    assert Flag.OUTLIERS in model.flags
    for size, pole in zip(ims.predict(model, detections), objects, strict=True):
        assert size.size_m == pytest.approx(pole.size_m, rel=0.05)


# --- intervals ---------------------------------------------------------------------------------

KNOWN = {"post": (1.2, 0.08, 0.04), "rail": (0.9, 0.05, 0.03), "gate": (2.1, 0.15, 0.08)}
KNOWN_TABLE = ims.PriorTable([
    ims.ObjectPrior(label, mean, std, mean_std_m=mean_std)
    for label, (mean, std, mean_std) in KNOWN.items()
])  # fmt: skip
SLOPE_STD = math.tan(math.radians(2.0))
HORIZON_STD = 0.12 * WIDTH


def log_prior_of(label):
    """Mean, standard deviation and that of the label's offset, of the log size."""
    mean, std, mean_std = KNOWN[label]
    variance = math.log1p((std / mean) ** 2)
    return math.log(mean) - variance / 2, math.sqrt(variance), mean_std / mean


def drawn_scene(rng, n_things):
    """
    A scene from the library's own assumptions: boxes, sizes, the camera's height, its references.

    Scenes that do not fit into the picture are drawn anew as a whole: what is left out depends on
    what is seen alone, so that intervals of what is seen stay right.
    """
    while True:
        horizon = HEIGHT / 2 + HORIZON_STD * rng.standard_t(3)
        height, slope = 1.7 * 2 ** rng.normal(), SLOPE_STD * rng.normal()
        labels = [*rng.choice(list(KNOWN), int(rng.integers(3, 7))), *["thing"] * n_things]
        offset = {label: log_prior_of(label)[2] * rng.normal() for label in KNOWN}
        x = rng.uniform(30, WIDTH - 30, len(labels))
        foot = rng.uniform(0.3 * HEIGHT, HEIGHT - 15, len(labels))
        below = foot - horizon - slope * (x - WIDTH / 2)
        size = np.exp([
            log_prior_of(label)[0] + offset[label] + log_prior_of(label)[1] * rng.normal()
            if label in KNOWN
            else 0.8 * rng.normal()
            for label in labels
        ])  # fmt: skip
        # bumps are so much nearer to the camera's height; slopes shift the row of the foot
        pixels = size * below / (height * np.exp(RELIEF * rng.normal(size=x.size)))
        row = foot + SLOPE_PX * rng.normal(size=x.size)
        top, low = np.array([row - pixels, row]) + rng.normal(size=(2, x.size)) / math.sqrt(2)
        if below.min() > 3 and top.min() > 2 and low.max() < HEIGHT - 2 and (low - top).min() > 8:
            boxes = np.stack([x - 5, top, x + 5, low], axis=1)
            detections = [ims.Detection(*pair) for pair in zip(labels, boxes, strict=True)]
            return detections, size[-n_things:], height


def coverage(method, count, seed=0, n_things=5):
    """Rates at which 90 % intervals hold the sizes of unknown objects and the camera's height."""
    rng = np.random.default_rng(seed)
    sizes, heights = [], []
    for _ in range(count):
        detections, truth, height = drawn_scene(rng, n_things)
        model = ims.fit(detections, GROUND, KNOWN_TABLE, method=method)
        ends = np.array([e.interval(0.9) for e in ims.predict(model, detections[-n_things:])])
        sizes.append((ends[:, 0] <= truth) & (truth <= ends[:, 1]))
        log_std = model.plane.camera_height_std_m / model.camera_height_m
        heights.append(abs(math.log(model.camera_height_m / height)) < 1.645 * log_std)
    return np.mean(sizes), np.mean(heights)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "count"), [("robust", 90), ("posterior", 50)])
def test_intervals_cover_nine_in_ten(method, count):
    of_sizes, of_heights = coverage(method, count)
    # three binomial errors; the things of one scene share most of theirs, half of it at least
    margin = 3 * math.sqrt(0.09 / count)
    assert abs(of_heights - 0.9) < margin
    assert abs(of_sizes - 0.9) < margin * math.sqrt(0.6)


def normal(residual, variance):
    return np.exp(-(residual**2) / (2 * variance)) / np.sqrt(2 * math.pi * variance)


class BruteForce:
    """Sums over (log k, horizon, slope) for two references, of which any may be wrong."""

    def __init__(self, references):
        self.log_k = np.linspace(math.log(1.7 / 8), math.log(1.7 * 8), 241)[:, None, None]
        self.horizon = np.linspace(HEIGHT / 2 - 1500, HEIGHT / 2 + 450, 401)[:, None]
        self.slope = SLOPE_STD * np.linspace(-3.5, 3.5, 15)
        log_weight = -(((self.log_k - math.log(1.7)) / math.log(2)) ** 2) / 2
        log_weight = log_weight - 2 * np.log1p(((self.horizon - HEIGHT / 2) / HORIZON_STD) ** 2 / 3)
        log_weight = log_weight - (self.slope / SLOPE_STD) ** 2 / 2
        for mean, std, mean_std, x, foot, pixels in references:
            prior_var = math.log1p((std / mean) ** 2)
            below, noise_var = self.seen(x, foot, pixels)
            is_below = below > 0
            total = prior_var + noise_var + (mean_std / mean) ** 2
            residual = math.log(mean) - prior_var / 2 + np.log(np.where(is_below, below, 1.0))
            residual = residual - math.log(pixels) - self.log_k
            scale = np.sqrt((total + 0.5**2) / 2)
            density = 0.95 * normal(residual, total) + 0.03 * normal(residual - 0.4, total + 0.0625)
            density += 0.02 * np.exp(-np.abs(residual) / scale) / (2 * scale)
            lost = 0.05 * normal(self.log_k - math.log(1.7), 1.0 + prior_var)
            log_weight = log_weight + np.log(np.where(is_below, density, lost))
        weight = np.exp(log_weight - log_weight.max())
        self.weight = weight / weight.sum()

    def seen(self, x, foot, pixels):
        """Rows below the horizon, and the variance of the log size from box and foot."""
        below = foot - self.horizon - self.slope * (x - WIDTH / 2)
        return below, foot_variance(pixels, np.where(below > 0, below, 1.0))

    def log_k_quantiles(self, probabilities):
        marginal = self.weight.sum(axis=(1, 2))
        place = np.cumsum(marginal) - marginal / 2
        return np.interp(probabilities, place, self.log_k.ravel())

    def log_size_quantiles(self, probabilities, x, foot, pixels):
        below, variance = self.seen(x, foot, pixels)
        bins = np.linspace(math.log(0.02), math.log(50), 3001)
        middle = self.log_k + math.log(pixels) - np.log(np.maximum(below, 1e-3))
        # each point is a normal; five of its quantiles are fine enough beside the whole width
        total = np.zeros(bins.size - 1)
        for score, share in zip(*np.polynomial.hermite_e.hermegauss(5), strict=True):
            place = np.clip(middle + score * np.sqrt(variance), bins[0], bins[-1])
            total += share * np.histogram(place, bins, weights=self.weight)[0]
        return np.interp(probabilities, np.cumsum(total) / total.sum(), bins[1:])


# mean, spread and uncertain mean of the size, column and row of the foot, pixels
PAIRS = {
    "near and far": [(1.2, 0.05, 0.03, 400, 620, 90.0), (1.7, 0.1, 0.03, 900, 850, 380.0)],
    "side by side": [(1.2, 0.05, 0.03, 400, 620, 90.0), (1.7, 0.1, 0.03, 900, 650, 180.0)],
    "horizon far up": [(1.2, 0.02, 0.01, 400, 620, 137.0), (1.7, 0.03, 0.01, 900, 850, 303.0)],
    "from below": [(1.2, 0.05, 0.03, 400, 620, 190.0), (1.7, 0.1, 0.03, 900, 850, 600.0)],
}


@pytest.mark.parametrize("pair", PAIRS)
def test_the_posterior_is_that_of_brute_force(pair):
    references, (x, foot, pixels) = PAIRS[pair], (640, 720, 150.0)
    truth = BruteForce(references)
    priors = ims.PriorTable([
        ims.ObjectPrior(f"pole {i}", mean, std, mean_std_m=mean_std)
        for i, (mean, std, mean_std, *_) in enumerate(references)
    ])  # fmt: skip
    detections = [
        ims.Detection(f"pole {i}", (x - 5, foot - pixels, x + 5, foot))
        for i, (*_, x, foot, pixels) in enumerate(references)
    ]
    thing = ims.Detection("thing", (x - 5, foot - pixels, x + 5, foot))
    half = truth.log_k_quantiles([0.1587, 0.8413])
    low, middle, high = truth.log_k_quantiles([0.05, 0.5, 0.95])
    ends = truth.log_size_quantiles([0.05, 0.95], x, foot, pixels)
    # some dozens of cases of the plane tell the middle to 3 % of the width and its ends to 10 %;
    # the robust solver, to which the horizon is normal, does worse in the tails
    for method, of_width in (("posterior", 0.1), ("robust", 0.2)):
        model = ims.fit([*detections, thing], GROUND, priors, method=method)
        problem, _ = problem_of_model(model)
        [found] = scale_of(solve_by(method, problem)).quantiles()
        assert found[found.size // 2] == pytest.approx(middle, abs=0.03 * (high - low))
        assert model.k_std / model.k == pytest.approx(np.ptp(half) / 2, rel=of_width)
        [size] = ims.predict(model, [thing])
        np.testing.assert_allclose(
            np.log(size.interval(0.9)), ends, atol=of_width * (ends[1] - ends[0])
        )


@pytest.mark.parametrize("method", METHODS)
def test_some_pictures_look_far_down(method):
    # three standard errors of the horizon, which Student's distribution allows; a normal prior
    # would have the camera 13 % lower
    pair = [(1.2, 0.02, 0.01, 400, 620, 150.0), (1.7, 0.03, 0.01, 900, 850, 290.0)]
    priors = ims.PriorTable([
        ims.ObjectPrior(f"pole {i}", mean, std, mean_std_m=mean_std)
        for i, (mean, std, mean_std, *_) in enumerate(pair)
    ])  # fmt: skip
    detections = [
        ims.Detection(f"pole {i}", (x - 5, foot - pixels, x + 5, foot))
        for i, (*_, x, foot, pixels) in enumerate(pair)
    ]
    problem, _ = problem_of_model(ims.fit(detections, GROUND, priors, method=method))
    [found] = scale_of(solve_by(method, problem)).quantiles()
    low, middle, high = BruteForce(pair).log_k_quantiles([0.05, 0.5, 0.95])
    assert found[found.size // 2] == pytest.approx(middle, abs=0.05 * (high - low))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("horizon", [300.0, 480.0, 600.0])
def test_without_any_foot_the_told_horizon_stands(horizon, method):
    told = ims.GroundPlane(
        image_size=SIZE, horizon_px=horizon, horizon_std_px=1.0, camera_height_m=1.6
    )
    model = ims.fit([], told, POST, method=method)
    assert model.horizon_px == pytest.approx(horizon, abs=0.1)


def test_an_object_near_the_horizon_has_a_finite_positive_lower_end():
    told = ims.GroundPlane(image_size=SIZE, horizon_px=480.0, horizon_std_px=20.0)
    model = ims.fit([column(1.2, 800)], told, POST, method="robust")
    for foot in (484.3, 488.45, 490.0):
        thing = ims.Detection("thing", (630.0, foot - 40, 650.0, foot))
        [size] = ims.predict(model, [thing])
        # a size is the smaller the farther the horizon: at 5 sigma 40 px of it span 0.6 m
        assert size.interval(0.99)[0] > 0.1


@pytest.mark.parametrize("method", ["robust", "posterior"])
def test_things_that_hang_above_the_horizon_do_not_fix_it(method):
    door = ims.Detection("door", (20, 48, 70, 240))
    signs = [ims.Detection("thing", (300 + 20 * i, 38, 310 + 20 * i, 50)) for i in range(3)]
    plane = ims.GroundPlane(image_size=(640, 480))
    alone = ims.fit([door], plane, method=method)
    among = ims.fit([door, *signs], plane, method=method)
    assert ims.Flag.ASSUMED_HORIZON in among.flags
    assert among.plane.horizon_std_px > 0.5 * alone.plane.horizon_std_px
    assert among.plane.horizon_px == pytest.approx(alone.plane.horizon_px, abs=5)
