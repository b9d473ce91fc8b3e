"""Tilted cameras: upright objects corrected by a pitch that is told or seen."""

import json
import math

import attrs
import numpy as np
import pytest

import imgscale as ims

METHODS = ["posterior", "robust"]
SIZE = (1280, 960)
WIDTH, HEIGHT = SIZE
FOCAL, BASELINE, UNIT = 1000.0, 0.3, 3.7
EXACT = ims.Noise(box_px=0.0, box_rel=0.0, depth_rel=0.0)
TOLD = ims.Noise(box_px=1.0, depth_rel=0.02)

TO_KIND = {
    "metric": (lambda z: z, 1 / FOCAL),
    "relative": (lambda z: UNIT * z, 1 / (UNIT * FOCAL)),
    "inverse": (lambda z: FOCAL * BASELINE / z, BASELINE),
}


def camera(pitch_deg=0.0, pitch_std_deg=0.0, **options):
    return ims.Camera(
        FOCAL, focal_rel_std=0.0, pitch_deg=pitch_deg, pitch_std_deg=pitch_std_deg, **options
    )


@attrs.frozen
class Thing:
    """An upright board that faces the camera: its box, its sides, z-depth of its middle."""

    xyxy: tuple
    height_m: float
    width_m: float
    z_m: float


def things(seed, count, pitch_deg, *, height_m=3.0, cy=HEIGHT / 2):
    """Boards on level ground, projected by a camera that looks down by the pitch."""
    rng, pitch = np.random.default_rng(seed), math.radians(pitch_deg)
    cos, sin = math.cos(pitch), math.sin(pitch)
    found = []
    for _ in range(100_000):
        forward, lateral = height_m * rng.uniform(1.5, 8), height_m * rng.uniform(-3, 3)
        tall, wide = height_m * rng.uniform(0.15, 0.5), height_m * rng.uniform(0.1, 0.4)
        ends = []
        for up in (-height_m, -height_m + tall):
            z = forward * cos - up * sin
            ends.append((cy - FOCAL * (forward * sin + up * cos) / z, z))
        (foot, foot_z), (top, top_z) = ends
        z = (foot_z + top_z) / 2
        if min(foot_z, top_z) <= 0.5 or not (3 < top < foot - 20 < HEIGHT - 23):
            continue
        middle, half = WIDTH / 2 + FOCAL * lateral / z, FOCAL * wide / z / 2
        if middle - half > 3 and middle + half < WIDTH - 3:
            found.append(Thing((middle - half, top, middle + half, foot), tall, wide, z))
        if len(found) == count:
            return found
    raise AssertionError("no such scene")


def seen(objects):
    return [ims.Detection(f"board {i}", thing.xyxy) for i, thing in enumerate(objects)]


def table(objects, std=0.0, axis="height"):
    sizes = [getattr(thing, f"{axis}_m") for thing in objects]
    return ims.PriorTable([
        ims.ObjectPrior(f"board {i}", size, std * size, axis=axis) for i, size in enumerate(sizes)
    ])  # fmt: skip


def depths(objects, kind="relative", **options):
    values = TO_KIND[kind][0](np.array([thing.z_m for thing in objects]))
    return ims.ObjectDepths(values, kind=kind, **({"image_size": SIZE} | options))


def log_std(estimate):
    return estimate.std_m / estimate.size_m


# --- a pitch that is told ----------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", TO_KIND)
@pytest.mark.parametrize("pitch_deg", [-10.0, 20.0, 40.0])
def test_a_told_pitch_makes_the_law_exact(pitch_deg, kind, method):
    objects = things(1, 6, pitch_deg)
    depth, priors = depths(objects, kind), table(objects[:5])
    options = {"noise": EXACT, "method": method}
    tilted = ims.fit(seen(objects), depth, priors, camera=camera(pitch_deg), **options)
    assert tilted.k == pytest.approx(TO_KIND[kind][1], rel=1e-9)
    for size, thing in zip(ims.predict(tilted, seen(objects), depth), objects, strict=True):
        assert size.size_m == pytest.approx(thing.height_m, rel=1e-9)
        assert size.distance_m == pytest.approx(thing.z_m, rel=1e-9)
    # k does not absorb it
    level = ims.fit(seen(objects), depth, priors, **options)
    errors = [
        size.size_m / thing.height_m - 1
        for size, thing in zip(ims.predict(level, seen(objects), depth), objects, strict=True)
    ]
    assert np.abs(errors).max() > 0.01


@pytest.mark.parametrize("method", METHODS)
def test_a_principal_point_off_the_middle_is_where_the_pitch_turns(method):
    objects = things(2, 6, 25.0, cy=560.0)
    depth = depths(objects)
    options = {"noise": EXACT, "method": method}
    model = ims.fit(
        seen(objects), depth, table(objects[:5]), camera=camera(25.0, cy=560.0), **options
    )
    for size, thing in zip(ims.predict(model, seen(objects), depth), objects, strict=True):
        assert size.size_m == pytest.approx(thing.height_m, rel=1e-9)
    middle = ims.fit(seen(objects), depth, table(objects[:5]), camera=camera(25.0), **options)
    wrong = [
        size.size_m / thing.height_m - 1
        for size, thing in zip(ims.predict(middle, seen(objects), depth), objects, strict=True)
    ]
    assert np.abs(wrong).max() > 1e-3


def test_no_pitch_is_as_good_as_no_camera():
    objects = things(3, 5, 0.0)
    depth, priors = depths(objects), table(objects[:4], 0.05)
    with_camera = ims.fit(seen(objects), depth, priors, camera=camera())
    without = ims.fit(seen(objects), depth, priors)
    assert attrs.evolve(with_camera, camera=None) == without


@pytest.mark.parametrize("method", METHODS)
def test_widths_are_not_corrected_by_z_depth(method):
    # a horizontal line across the view spans f W / Z, however the camera looks down
    objects = things(4, 5, 30.0)
    depth, priors = depths(objects), table(objects[:4], axis="width")
    options = {"noise": EXACT, "method": method, "camera": camera(30.0)}
    model = ims.fit(seen(objects), depth, priors, **options)
    assert [ref.axis for ref in model.references[:4]] == ["width"] * 4
    assert model.k == pytest.approx(1 / (UNIT * FOCAL), rel=1e-9)
    for axis in ("width", "height"):
        for size, thing in zip(
            ims.predict(model, seen(objects), depth, axis=axis), objects, strict=True
        ):
            assert size.size_m == pytest.approx(getattr(thing, f"{axis}_m"), rel=1e-9)


def test_metres_per_pixel_are_those_of_the_corrected_extent():
    objects = things(5, 5, 30.0)
    depth = depths(objects)
    model = ims.fit(
        seen(objects), depth, table(objects[:4]), noise=EXACT, camera=camera(30.0), method="robust"
    )
    for size, thing in zip(ims.predict(model, seen(objects), depth), objects, strict=True):
        pixels = thing.xyxy[3] - thing.xyxy[1]
        assert size.metres_per_pixel == pytest.approx(thing.height_m / pixels, rel=1e-9)
    for ref in model.references[:4]:
        assert ref.k == pytest.approx(model.k, rel=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_a_tilted_model_survives_json(method):
    objects = things(6, 5, 20.0)
    depth = depths(objects)
    model = ims.fit(
        seen(objects), depth, table(objects[:4], 0.05), camera=camera(20.0, 2.0), method=method
    )
    again = ims.ScaleModel.from_dict(json.loads(json.dumps(model.to_dict())))
    assert again == model
    assert ims.predict(again, seen(objects), depth) == ims.predict(model, seen(objects), depth)


@pytest.mark.parametrize("method", METHODS)
def test_leaving_one_out_is_fit_without_and_predict(method):
    objects = things(7, 4, 20.0)
    options = {"noise": TOLD, "camera": camera(20.0, 2.0), "method": method}
    priors = table(objects, 0.05)
    estimates = ims.leave_one_out(seen(objects), depths(objects), priors, **options)
    # images that are solved together share the number of points of their grids
    tolerance = 1e-9 if method == "robust" else 1e-4
    for i, estimate in enumerate(estimates):
        others = [j for j in range(4) if j != i]
        model = ims.fit(
            [seen(objects)[j] for j in others], depths([objects[j] for j in others]), priors,
            **options,
        )  # fmt: skip
        [expected] = ims.predict(model, [seen(objects)[i]], depths([objects[i]]))
        assert estimate.size_m == pytest.approx(expected.size_m, rel=tolerance)
        assert estimate.interval(0.95) == pytest.approx(expected.interval(0.95), rel=tolerance)


# --- what is not known of it -------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("pitch_std_deg", "depth_rel"), [(0.5, 0.005), (1.0, 0.005), (3.0, 0.005), (3.0, 0.02)]
)
def test_an_uncertain_pitch_adds_its_part_to_the_interval(pitch_std_deg, depth_rel, method):
    # one reference, far down in the picture, says nothing of the pitch; the other is far up
    post, thing = (ims.Detection(*args) for args in (
        ("post", (600.0, 700.0, 620.0, 900.0)), ("thing", (600.0, 60.0, 620.0, 160.0)),
    ))  # fmt: skip
    priors = ims.PriorTable([ims.ObjectPrior("post", 1.0, 0.005)])
    options = {"noise": ims.Noise(box_px=0.5, depth_rel=depth_rel), "method": method}

    def size(**tilt):
        depth = ims.ObjectDepths([5.0, 12.0], kind="relative", image_size=SIZE)
        model = ims.fit([post, thing], depth, priors, camera=camera(**tilt), **options)
        return ims.predict(model, [post, thing], depth)[1]

    step = 0.2
    below, above = (size(pitch_deg=25.0 + sign * step).size_m for sign in (-1, 1))
    slope = math.log(above / below) / (2 * step)
    # (y - y_reference) / f / cos^2, about 0.8 a radian
    assert abs(slope) == pytest.approx(
        math.radians(0.69 / math.cos(math.radians(25)) ** 2), rel=0.1
    )
    exact = log_std(size(pitch_deg=25.0))
    widened = log_std(size(pitch_deg=25.0, pitch_std_deg=pitch_std_deg))
    expected = math.hypot(exact, slope * pitch_std_deg)
    assert expected > 1.1 * exact
    assert widened == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("pitch_std_deg", [0.0, 1.0])
@pytest.mark.parametrize(("focal_rel_std", "depth_rel"), [(0.03, 0.002), (0.08, 0.01)])
def test_an_uncertain_focal_length_adds_its_part_to_the_interval(
    focal_rel_std, depth_rel, pitch_std_deg, method
):
    # as above: the pixels of a post far down and a thing far up are corrected by both
    post, thing = (ims.Detection(*args) for args in (
        ("post", (600.0, 700.0, 620.0, 900.0)), ("thing", (600.0, 60.0, 620.0, 160.0)),
    ))  # fmt: skip
    priors = ims.PriorTable([ims.ObjectPrior("post", 1.0, 0.002)])
    options = {"noise": ims.Noise(box_px=0.2, depth_rel=depth_rel), "method": method}

    def size(*, focal_px=FOCAL, focal_rel_std=0.0, pitch_deg=25.0, pitch_std_deg=0.0):
        depth = ims.ObjectDepths([5.0, 12.0], kind="relative", image_size=SIZE)
        looking = ims.Camera(
            focal_px, focal_rel_std=focal_rel_std, pitch_deg=pitch_deg, pitch_std_deg=pitch_std_deg
        )
        model = ims.fit([post, thing], depth, priors, camera=looking, **options)
        return ims.predict(model, [post, thing], depth)[1]

    by_focal = math.log(size(focal_px=1.01 * FOCAL).size_m / size(focal_px=0.99 * FOCAL).size_m)
    by_pitch = math.log(size(pitch_deg=25.2).size_m / size(pitch_deg=24.8).size_m)
    # u / (1 - u) at u = tan T y / f, 0.15 below the middle and -0.17 above it
    assert by_focal / 0.02 == pytest.approx(0.149 / 0.851 + 0.172 / 1.172, rel=0.01)
    exact = log_std(size())
    parts = (by_focal / 0.02 * focal_rel_std, by_pitch / 0.4 * pitch_std_deg)
    expected = math.hypot(exact, *parts)
    assert expected > 1.1 * math.hypot(exact, parts[1])
    widened = log_std(size(focal_rel_std=focal_rel_std, pitch_std_deg=pitch_std_deg))
    assert widened == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("method", METHODS)
def test_what_the_pitch_alone_changes_errs_by_the_pitch_alone(method):
    # a width is not corrected, a height in the middle row by 1 / cos T, whatever the focal length
    sill, post = (ims.Detection(*args) for args in (
        ("sill", (540.0, 700.0, 740.0, 720.0)), ("thing", (600.0, 380.0, 620.0, 580.0)),
    ))  # fmt: skip
    priors = ims.PriorTable([ims.ObjectPrior("sill", 1.0, 0.002, axis="width")])
    depth = ims.ObjectDepths([5.0, 12.0], kind="relative", image_size=SIZE)
    noise = ims.Noise(box_px=0.2, depth_rel=0.002)
    widths = []
    for rel in (0.0, 0.03, 0.08):
        looking = ims.Camera(FOCAL, focal_rel_std=rel, pitch_deg=25.0, pitch_std_deg=2.0)
        model = ims.fit([sill, post], depth, priors, camera=looking, noise=noise, method=method)
        low, high = ims.predict(model, [sill, post], depth)[1].interval(0.9)
        widths.append(math.log(high / low))
    by_pitch = 2 * 1.645 * math.tan(math.radians(25.0)) * math.radians(2.0)
    assert widths[0] > by_pitch
    # a pair of cases tells its variance, and the ends of the interval to some per cent
    assert widths[1:] == pytest.approx([widths[0]] * 2, rel=0.08)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", ["relative", "inverse"])
def test_the_focal_length_of_a_level_camera_widens_nothing(kind, method):
    objects = things(3, 5, 0.0)
    depth, priors = depths(objects, kind), table(objects[:4], 0.05)
    found = []
    for rel in (0.0, 0.08):
        level = ims.Camera(FOCAL, focal_rel_std=rel)
        model = ims.fit(seen(objects), depth, priors, camera=level, noise=TOLD, method=method)
        found.append(ims.predict(model, seen(objects), depth))
    assert found[0] == found[1]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("on_ground", [True, False])
@pytest.mark.parametrize("focal_rel_std", [1e-300, 1e-9, 1e-5, 3.0, 1e6])
def test_a_focal_length_known_exactly_or_not_at_all_still_gives_sizes(
    focal_rel_std, on_ground, method
):
    objects = things(14, 6, 25.0)
    looking = ims.Camera(FOCAL, focal_rel_std=focal_rel_std, pitch_deg=25.0, pitch_std_deg=1.0)
    options = {"camera": looking, "noise": TOLD, "method": method}
    if on_ground:
        options["ground"] = ims.GroundPlane(image_size=SIZE)
    depth, priors = depths(objects), table(objects[:5], 0.02)
    model = ims.fit(seen(objects), depth, priors, **options)
    for size, thing in zip(ims.predict(model, seen(objects), depth), objects, strict=True):
        low, high = size.interval(0.99)
        assert 0 < low < thing.height_m < high


def test_an_uncertain_pitch_is_weighed_by_how_well_the_references_agree():
    # told 15 +- 5 degrees, while the references fit 25 only
    objects = things(9, 8, 25.0)
    options = {"noise": ims.Noise(box_px=0.1, depth_rel=0.003), "method": "posterior"}
    depth, priors = depths(objects), table(objects[:7])
    errors = {}
    for std in (0.0, 5.0):
        model = ims.fit(seen(objects), depth, priors, camera=camera(15.0, std), **options)
        low, high = ims.predict(model, seen(objects), depth)[-1].interval(0.9)
        errors[std] = math.log(math.sqrt(low * high) / objects[-1].height_m)
    assert abs(errors[5.0]) < 0.5 * abs(errors[0.0])


# --- the image it belongs to -------------------------------------------------------------------


@pytest.mark.parametrize("tilt", [{"pitch_deg": 10.0}, {"pitch_std_deg": 1.0}], ids=str)
def test_a_tilt_without_any_image_size_is_refused(tilt):
    objects = things(10, 3, 10.0)
    depth = depths(objects, image_size=None)
    with pytest.raises(ValueError, match=r"`camera\.image_size` must be given with a pitch.*None"):
        ims.fit(seen(objects), depth, table(objects), camera=camera(**tilt))
    with pytest.raises(ValueError, match=r"`camera\.image_size` must be given with a pitch"):
        ims.leave_one_out(seen(objects), depth, table(objects), camera=camera(**tilt))


def test_the_image_size_may_come_from_camera_depth_map_or_ground():
    objects = things(10, 3, 10.0)
    values = np.full((HEIGHT // 10, WIDTH // 10), np.nan)
    for thing in objects:
        x1, y1, x2, y2 = (round(v / 10) for v in thing.xyxy)
        values[y1 : max(y2, y1 + 1), x1 : max(x2, x1 + 1)] = UNIT * thing.z_m
    told, bare = camera(10.0, image_size=SIZE), depths(objects, image_size=None)
    options = {"method": "robust", "noise": TOLD}
    by_camera = ims.fit(seen(objects), bare, table(objects), camera=told, **options)
    by_depth = ims.fit(seen(objects), depths(objects), table(objects), camera=told, **options)
    assert by_camera == by_depth
    on_map = ims.DepthMap(values, kind="relative", image_size=SIZE)
    by_map = ims.fit(seen(objects), on_map, table(objects), camera=camera(10.0), **options)
    assert by_map.k == pytest.approx(by_depth.k, rel=1e-3)
    ground = ims.GroundPlane(image_size=SIZE)
    by_ground = ims.fit(
        seen(objects), bare, table(objects), camera=camera(10.0), ground=ground, **options
    )
    assert by_ground.k == pytest.approx(by_depth.k, rel=0.02)


# --- a pitch that is seen ----------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("pitch_deg", [0.0, 10.0, 30.0])
def test_the_horizon_tells_a_pitch_that_nobody_told(pitch_deg, method):
    objects = things(11, 8, pitch_deg)
    depth, ground = depths(objects), ims.GroundPlane(image_size=SIZE)
    # sizes known to 1 %, depths told to 2 %, both exact
    options = {"noise": TOLD, "method": method, "camera": camera(), "ground": ground}
    model = ims.fit(seen(objects), depth, table(objects[:7], 0.01), **options)
    plane = model.plane
    horizon = HEIGHT / 2 - FOCAL * math.tan(math.radians(pitch_deg))
    assert abs(model.horizon_px - horizon) < plane.horizon_std_px
    assert plane.horizon_std_px < 60
    assert abs(model.camera_height_m - 3.0) < plane.camera_height_std_m
    # z-depth needs the correction for the pitch, feet the other one
    size = ims.predict(model, seen(objects), depth)[-1]
    assert size.size_m == pytest.approx(objects[-1].height_m, rel=0.02)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("pitch_deg", [10.0, 30.0])
def test_two_exact_witnesses_and_a_told_pitch_give_exact_sizes(pitch_deg, method):
    objects = things(12, 6, pitch_deg)
    depth, ground = depths(objects), ims.GroundPlane(image_size=SIZE)
    options = {"noise": EXACT, "camera": camera(pitch_deg), "ground": ground, "method": method}
    model = ims.fit(seen(objects), depth, table(objects[:5]), **options)
    # errors count as 1e-6 at least, and the horizon of a told pitch as 1e-6 of the longer side
    for size, thing in zip(ims.predict(model, seen(objects), depth), objects, strict=True):
        assert size.size_m == pytest.approx(thing.height_m, rel=5e-6)
    horizon = HEIGHT / 2 - FOCAL * math.tan(math.radians(pitch_deg))
    assert model.horizon_px == pytest.approx(horizon, abs=0.01)


@pytest.mark.parametrize("method", METHODS)
def test_a_told_pitch_is_a_told_horizon_on_the_ground_plane(method):
    objects, pitch = things(13, 5, 20.0), math.radians(20.0)
    options = {"method": method, "noise": TOLD}
    by_pitch = ims.fit(
        seen(objects), ims.GroundPlane(image_size=SIZE), table(objects[:3], 0.05),
        camera=camera(20.0, 1.0), **options,
    )  # fmt: skip
    told = ims.GroundPlane(
        image_size=SIZE,
        horizon_px=HEIGHT / 2 - FOCAL * math.tan(pitch),
        horizon_std_px=FOCAL * math.radians(1.0) / math.cos(pitch) ** 2,
    )
    by_horizon = ims.fit(seen(objects), told, table(objects[:3], 0.05), camera=camera(), **options)
    assert by_pitch.k == pytest.approx(by_horizon.k, rel=1e-9)
    assert by_pitch.k_std == pytest.approx(by_horizon.k_std, rel=1e-9)
    assert by_pitch.plane == by_horizon.plane


@pytest.mark.parametrize("method", METHODS)
def test_a_told_horizon_and_a_told_pitch_are_averaged_by_their_precisions(method):
    # one reference leaves the horizon open: 400 +- 10 by one, 430 +- 20 by the other
    pitch = math.atan((HEIGHT / 2 - 430.0) / FOCAL)
    std = math.degrees(20.0 / FOCAL * math.cos(pitch) ** 2)
    ground = ims.GroundPlane(image_size=SIZE, horizon_px=400.0, horizon_std_px=10.0)
    post = ims.Detection("post", (630.0, 560.0, 650.0, 700.0))
    model = ims.fit(
        [post], ground, ims.PriorTable([ims.ObjectPrior("post", 1.0, 0.01)]),
        camera=camera(math.degrees(pitch), std), method=method,
    )  # fmt: skip
    precision = np.array([10.0**-2, 20.0**-2])
    assert model.horizon_px == pytest.approx([400, 430] @ precision / precision.sum(), abs=0.5)
    # some dozens of cases tell it to some per cent
    assert model.plane.horizon_std_px == pytest.approx(precision.sum() ** -0.5, rel=0.08)


@pytest.mark.parametrize("method", ["mean_ratio", "least_squares"])
def test_the_papers_methods_refuse_a_tilt_that_they_cannot_correct(method):
    objects = things(1, 6, 20.0)
    with pytest.raises(ValueError, match=r"`camera\.pitch_deg` must be 0 for method"):
        ims.fit(
            seen(objects),
            depths(objects),
            table(objects[:5]),
            noise=EXACT,
            method=method,
            camera=camera(20.0),
        )


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("pitch_deg", [-10.0, 20.0])
def test_a_told_pitch_and_an_unknown_shift_go_together(pitch_deg, method):
    objects = things(1, 6, pitch_deg)
    z = np.array([thing.z_m for thing in objects])
    depth = ims.ObjectDepths(FOCAL * BASELINE / z - 4.0, kind="affine_inverse", image_size=SIZE)
    model = ims.fit(
        seen(objects), depth, table(objects[:5]), noise=EXACT, method=method,
        camera=camera(pitch_deg),
    )  # fmt: skip
    assert model.k == pytest.approx(BASELINE, rel=1e-5)
    for size, thing in zip(ims.predict(model, seen(objects), depth), objects, strict=True):
        assert size.size_m == pytest.approx(thing.height_m, rel=1e-5)
