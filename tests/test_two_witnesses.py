"""Depth and foot as two witnesses of distance: exact scenes, laws, intervals."""

import json
import math

import attrs
import numpy as np
import pytest

import imgscale as ims
from imgscale import Flag

METHODS = ["posterior", "robust"]
SIZE = (1280, 960)
WIDTH, HEIGHT = SIZE
FOCAL, BASELINE, UNIT, SHIFT = 1000.0, 0.3, 3.7, 4.0
HORIZON, CAMERA_HEIGHT = 430.0, 1.6
EXACT = ims.Noise(box_px=0.0, box_rel=0.0, depth_rel=0.0)
GROUND = ims.GroundPlane(image_size=SIZE)
RELIEF, SLOPE_PX = 0.03, 0.0015 * WIDTH  # what the library says of feet
NAN = math.nan

TO_KIND = {
    "metric": (lambda z: z, 1 / FOCAL),
    "relative": (lambda z: UNIT * z, 1 / (UNIT * FOCAL)),
    "inverse": (lambda z: FOCAL * BASELINE / z, BASELINE),
    "affine_inverse": (lambda z: FOCAL * BASELINE / z - SHIFT, BASELINE),
}


@attrs.frozen
class Scene:
    """Upright things on the ground before a level camera, and what they are."""

    x: np.ndarray
    foot: np.ndarray
    size_m: np.ndarray
    z_m: np.ndarray

    @classmethod
    def drawn(cls, seed, count, *, height_m=CAMERA_HEIGHT, cross_fall=0.0):
        """Feet at 40 to 500 rows below the horizon, whose row falls by `cross_fall` a column."""
        rng = np.random.default_rng(seed)
        x, below = rng.uniform(20, WIDTH - 20, count), np.geomspace(40, 460, count)
        below *= rng.uniform(0.9, 1.1, count)
        size_m = height_m * rng.uniform(0.3, 0.8, count)
        order = rng.permutation(count)
        below = below[order]
        foot = HORIZON + cross_fall * (x - WIDTH / 2) + below
        return cls(x, foot, size_m, FOCAL * height_m / below)

    @property
    def pixels(self):
        return FOCAL * self.size_m / self.z_m

    def seen(self, labels=None):
        labels = labels or [f"pole {i}" for i in range(self.x.size)]
        return [
            ims.Detection(label, (x - 5, foot - pixels, x + 5, foot))
            for label, x, foot, pixels in zip(labels, self.x, self.foot, self.pixels, strict=True)
        ]

    def table(self, count, std=0.0, mean_std=0.0):
        """Sizes of the first ones."""
        return ims.PriorTable([
            ims.ObjectPrior(f"pole {i}", size, std * size, mean_std_m=mean_std * size)
            for i, size in enumerate(self.size_m[:count])
        ])  # fmt: skip


def relative(values, rel_std=None):
    return ims.ObjectDepths(values, kind="relative", image_size=SIZE, rel_std=rel_std)


def log_std(estimate):
    return estimate.std_m / estimate.size_m


def log_width(estimate, level=0.9):
    low, high = estimate.interval(level)
    return math.log(high / low)


# --- exact scenes ------------------------------------------------------------------------------

# The exact solver's medians are quantiles of a posterior no narrower than 1e-6, the least error;
# the prior of the shift draws by as little.
TOLERANCE = {
    ("robust", False): 1e-9, ("robust", True): 1e-6,
    ("posterior", False): 2e-6, ("posterior", True): 1e-5,
}  # fmt: skip


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", TO_KIND)
def test_witnesses_that_agree_give_scale_plane_and_sizes(kind, method):
    to_depth, k = TO_KIND[kind]
    tolerance = TOLERANCE[method, kind == "affine_inverse"]
    misses, count = [], 6 if method == "robust" else 2
    for seed in range(count):
        rng = np.random.default_rng(seed + 100)
        height, cross_fall = math.exp(rng.uniform(-1, 2.3)), 0.035 * rng.uniform(-1, 1)
        scene = Scene.drawn(seed, 6, height_m=height, cross_fall=cross_fall)
        depth = ims.ObjectDepths(to_depth(scene.z_m), kind=kind)
        options = {"ground": GROUND, "noise": EXACT, "method": method}
        model = ims.fit(scene.seen(), depth, scene.table(5), **options)
        sizes = ims.predict(model, scene.seen(), depth)
        errors = [model.k / k - 1]
        errors += [size.size_m / m - 1 for size, m in zip(sizes, scene.size_m, strict=True)]
        # feet err by 3 % and by a slope, whatever the depths do; exact ones are well within
        plane = model.plane
        scores = [
            math.log(plane.camera_height_m / height) * height / plane.camera_height_std_m,
            (plane.horizon_px - HORIZON) / plane.horizon_std_px,
            (plane.roll_deg - math.degrees(math.atan(cross_fall))) / plane.roll_std_deg,
        ]
        if not (np.abs(errors).max() < tolerance and np.abs(scores).max() < 1):
            misses.append((seed, np.abs(errors).max(), scores))
    assert not misses, f"{len(misses)} of {count}: {misses}"


@pytest.mark.parametrize("method", METHODS)
def test_an_object_without_a_depth_is_sized_by_its_foot(method):
    scene = Scene.drawn(3, 7)
    values = UNIT * scene.z_m
    values[[1, 6]] = NAN  # of a known one and the unknown one
    depth = relative(values, 0.01)
    told = ims.GroundPlane(image_size=SIZE, horizon_px=HORIZON, horizon_std_px=0.0)
    model = ims.fit(scene.seen(), depth, scene.table(6, 0.02), ground=told, method=method)
    assert model.references[1].reason == "no depth"  # beside depth, a reference has one
    sizes = ims.predict(model, scene.seen(), depth)
    for i in (1, 6):
        assert sizes[i].size_m == pytest.approx(scene.size_m[i], rel=0.03)
        assert sizes[i].flags == Flag.NO_DEPTH
        # its error is at least that of the foot: relief and slope
        below = FOCAL * CAMERA_HEIGHT / scene.z_m[i]
        foot = math.sqrt(RELIEF**2 + (0.5 + SLOPE_PX**2) / below**2)
        assert foot < log_std(sizes[i]) < 2 * foot


def test_without_a_plane_an_object_without_a_depth_has_no_size():
    scene = Scene.drawn(3, 3)
    depth = relative([*(UNIT * scene.z_m[:2]), NAN], 0.01)
    model = ims.fit(scene.seen(), depth, scene.table(2, 0.02), method="robust")
    size = ims.predict(model, scene.seen(), depth)[-1]
    assert math.isnan(size.size_m)
    assert model.plane is None


# --- feet correct depths -----------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_feet_correct_noisy_depths(method):
    errors = {True: [], False: []}
    for seed in range(14):
        rng = np.random.default_rng(seed + 50)
        scene = Scene.drawn(seed, 7, cross_fall=0.03 * rng.uniform(-1, 1))
        depth = relative(UNIT * scene.z_m * np.exp(0.2 * rng.normal(size=7)), 0.2)
        for has_ground, found in errors.items():
            ground = GROUND if has_ground else None
            priors = scene.table(5, 0.05)
            model = ims.fit(scene.seen(), depth, priors, ground=ground, method=method)
            sizes = ims.predict(model, scene.seen(), depth)[5:]
            found += [
                abs(math.log(size.size_m / m))
                for size, m in zip(sizes, scene.size_m[5:], strict=True)
            ]
    # depths err by 20 % each, feet not at all: 15 and 2 % where this was written
    assert np.median(errors[False]) > 0.08
    assert np.median(errors[True]) < 0.05


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("row", "depth_rel"), [(500.0, 0.03), (530.0, 0.1)])
def test_an_object_in_the_air_falls_back_to_its_depth(row, depth_rel, method):
    scene = Scene.drawn(7, 7)
    # a drone 0.5 m high, at 9 m, in the air; on the ground its foot would lie 180 rows down
    pixels, z = FOCAL * 0.5 / 9.0, 9.0
    drone = ims.Detection("drone", (600.0, row - pixels, 660.0, row))
    detections = [*scene.seen(), drone]
    depth = relative(UNIT * np.append(scene.z_m, z), depth_rel)
    sizes = {}
    for name, ground in (("both", GROUND), ("depth", None)):
        model = ims.fit(detections, depth, scene.table(6, 0.02), ground=ground, method=method)
        sizes[name] = ims.predict(model, detections, depth)[-1]
    # six errors apart or more: one object in ten is off the plane
    assert pixels * CAMERA_HEIGHT / (row - HORIZON) > 1.7 * 0.5
    # k hardly differs without the feet
    assert sizes["both"].size_m == pytest.approx(sizes["depth"].size_m, rel=0.01)
    assert sizes["both"].size_m == pytest.approx(0.5, rel=0.02)
    assert log_std(sizes["both"]) == pytest.approx(log_std(sizes["depth"]), rel=0.1)


@pytest.mark.parametrize("method", METHODS)
def test_a_reference_in_the_air_tells_the_scale_and_does_not_lift_the_plane(method):
    scene = Scene.drawn(8, 7)
    pixels, z = FOCAL * 0.5 / 9.0, 9.0
    drone = ims.Detection("drone", (600.0, 500 - pixels, 660.0, 500.0))
    depth = relative(UNIT * np.append(scene.z_m, z), 0.03)
    priors = scene.table(6, 0.02).with_prior(ims.ObjectPrior("drone", 0.5, 0.01))
    model = ims.fit([*scene.seen(), drone], depth, priors, ground=GROUND, method=method)
    assert model.references[-1].used
    assert model.references[-1].weight > 0.05
    assert model.k == pytest.approx(1 / (UNIT * FOCAL), rel=0.01)
    assert model.horizon_px == pytest.approx(HORIZON, abs=2 * model.plane.horizon_std_px)
    assert model.camera_height_m == pytest.approx(
        CAMERA_HEIGHT, abs=2 * model.plane.camera_height_std_m
    )


def test_what_is_told_to_hang_shows_no_foot():
    scene = Scene.drawn(8, 5)
    priors = scene.table(4, 0.02).with_prior(ims.ObjectPrior("lamp", 0.5, 0.01, on_ground=False))
    lamp = ims.Detection("lamp", (600.0, 440.0, 660.0, 500.0))
    depth = relative(UNIT * np.append(scene.z_m, FOCAL * 0.5 / 60), 0.03)
    model = ims.fit([*scene.seen(), lamp], depth, priors, ground=GROUND, method="robust")
    assert np.isnan(model.references[-1].foot_xy).all()
    assert model.references[-1].used
    assert model.references[-1].weight > 0.05


@pytest.mark.parametrize("method", METHODS)
def test_bystanders_fix_the_plane(method):
    widths = []
    scene, below = Scene.drawn(9, 19), 700 - HORIZON
    thing = ims.Detection("thing", (630.0, 600.0, 650.0, 700.0))
    priors = scene.table(3, 0.03)
    for others in (0, 16):
        detections = [thing, *scene.seen()[: 3 + others]]
        z = np.append(FOCAL * CAMERA_HEIGHT / below, scene.z_m[: 3 + others])
        depth = relative(UNIT * z, 0.2)
        model = ims.fit(detections, depth, priors, ground=GROUND, method=method)
        size = ims.predict(model, detections, depth)[0]
        assert size.size_m == pytest.approx(100 * CAMERA_HEIGHT / below, rel=0.05)
        widths.append(log_width(size))
    # the plane averages the depths of all feet, whatever stands on them
    assert widths[1] < 0.95 * widths[0]


@pytest.mark.parametrize("method", METHODS)
def test_bystanders_without_depth_or_foot_say_nothing(method):
    scene = Scene.drawn(9, 5)
    cut = ims.Detection("thing", (630.0, 600.0, 650.0, 960.0))
    depth = UNIT * scene.z_m
    options = {"ground": GROUND, "method": method}
    model = ims.fit(scene.seen(), relative(depth, 0.1), scene.table(4, 0.03), **options)
    again = ims.fit(
        [*scene.seen(), cut, ims.Detection("thing", (300.0, 600.0, 320.0, 700.0))],
        relative([*depth, 9.0, NAN], 0.1), scene.table(4, 0.03), **options,
    )  # fmt: skip
    assert again.k == pytest.approx(model.k, rel=1e-6)
    assert again.plane.camera_height_m == pytest.approx(model.plane.camera_height_m, rel=1e-6)
    # the median foot, from which the horizon is counted, is another
    assert again.k_std == pytest.approx(model.k_std, rel=0.05)


# --- new and known objects ---------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", range(3))
def test_an_object_that_was_in_the_fit_is_not_told_twice(seed, method):
    # given all the others, its size is that of the joint posterior with its own depth and foot,
    # whether they were told to `fit` or to `predict`: up to the cases of the plane, some dozens
    rng = np.random.default_rng(seed)
    scene = Scene.drawn(seed, 7)
    noise = np.exp(0.15 * rng.normal(size=7))
    depth = relative(UNIT * scene.z_m * noise, 0.15)
    detections, priors = scene.seen(), scene.table(4, 0.05)
    options = {"ground": GROUND, "method": method}
    known = ims.fit(detections, depth, priors, **options)
    [as_known] = ims.predict(known, detections[-1:], relative(depth.values[-1:], 0.15))
    fresh = ims.fit(detections[:-1], relative(depth.values[:-1], 0.15), priors, **options)
    [as_new] = ims.predict(fresh, detections[-1:], relative(depth.values[-1:], 0.15))
    gap = math.log(as_known.size_m / as_new.size_m)
    assert abs(gap) < 0.15 * log_std(as_new)
    assert log_width(as_known) == pytest.approx(log_width(as_new), rel=0.1)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("has_depth", [True, False], ids=["beside depth", "alone"])
def test_leaving_one_out_takes_its_size_and_leaves_its_foot(has_depth, method):
    # fit and predict by hand: the one left out stands there all the same, under another name
    rng = np.random.default_rng(2)
    scene = Scene.drawn(2, 5)
    detections, priors = scene.seen(), scene.table(4, 0.05, 0.03)
    noise = np.exp(0.1 * rng.normal(size=5))
    depth = relative(UNIT * scene.z_m * noise, 0.1) if has_depth else GROUND
    options = {"ground": GROUND if has_depth else None, "method": method}
    estimates = ims.leave_one_out(detections, depth, priors, **options)
    # the search stops at 1e-4 of the errors, and images that are solved together share the number
    # of points of their grids
    tolerance = 2e-4
    for i, estimate in enumerate(estimates):
        renamed = list(detections)
        renamed[i] = attrs.evolve(detections[i], label="somebody")
        model = ims.fit(renamed, depth, priors, **options)
        expected = ims.predict(model, renamed, depth)[i]
        assert estimate.label == f"pole {i}"
        assert estimate.size_m == pytest.approx(expected.size_m, rel=tolerance)
        assert estimate.std_m == pytest.approx(expected.std_m, rel=10 * tolerance)
        assert estimate.interval(0.95) == pytest.approx(expected.interval(0.95), rel=tolerance)
        assert Flag.REFERENCE not in estimate.flags


@pytest.mark.parametrize("method", METHODS)
def test_the_order_of_the_detections_does_not_matter(method):
    rng = np.random.default_rng(4)
    scene, order = Scene.drawn(4, 6, cross_fall=0.02), [3, 5, 0, 2, 4, 1]
    values = UNIT * scene.z_m * np.exp(0.1 * rng.normal(size=6))
    detections, priors = scene.seen(), scene.table(4, 0.05)
    mixed = [detections[i] for i in order]
    options = {"ground": GROUND, "method": method}
    model = ims.fit(detections, relative(values, 0.1), priors, **options)
    again = ims.fit(mixed, relative(values[order], 0.1), priors, **options)
    assert again.k == pytest.approx(model.k, rel=1e-9)
    expected = ims.predict(model, detections, relative(values, 0.1))
    for i, size in zip(order, ims.predict(again, mixed, relative(values[order], 0.1)), strict=True):
        assert size.size_m == pytest.approx(expected[i].size_m, rel=1e-7)
        assert size.std_m == pytest.approx(expected[i].std_m, rel=1e-6)


@pytest.mark.parametrize("kind", TO_KIND)
def test_a_model_of_two_witnesses_survives_json(kind):
    scene = Scene.drawn(5, 5)
    depth = ims.ObjectDepths(TO_KIND[kind][0](scene.z_m), kind=kind, rel_std=0.05)
    told = ims.GroundPlane(image_size=SIZE, camera_height_m=1.6, camera_height_std_m=0.1)
    camera = ims.Camera(FOCAL, focal_rel_std=0.02)
    model = ims.fit(
        scene.seen(), depth, scene.table(4, 0.05), ground=told, camera=camera, method="robust"
    )
    again = ims.ScaleModel.from_dict(json.loads(json.dumps(model.to_dict())))
    assert again == model
    assert again.ground == told
    assert ims.predict(again, scene.seen(), depth) == ims.predict(model, scene.seen(), depth)


# --- intervals ---------------------------------------------------------------------------------

KNOWN = {"post": (1.2, 0.08, 0.04), "rail": (0.9, 0.05, 0.03), "gate": (2.1, 0.15, 0.08)}
KNOWN_TABLE = ims.PriorTable([
    ims.ObjectPrior(label, mean, std, mean_std_m=mean_std)
    for label, (mean, std, mean_std) in KNOWN.items()
])  # fmt: skip


def log_prior_of(label):
    """Mean, standard deviation and that of the label's offset, of the log size."""
    mean, std, mean_std = KNOWN[label]
    variance = math.log1p((std / mean) ** 2)
    return math.log(mean) - variance / 2, math.sqrt(variance), mean_std / mean


def drawn_scene(rng, depth_rel, n_things=3):
    """
    A scene from the library's own assumptions: boxes, depths, sizes of the last ones.

    One object in ten is off the plane. Scenes that do not fit into the picture are drawn anew as a
    whole: what is left out depends on what is seen alone, so that intervals of it stay right.
    """
    while True:
        horizon = HEIGHT / 2 + 0.12 * WIDTH * rng.standard_t(3)
        slope = math.tan(math.radians(2.0)) * rng.normal()
        height = 1.7 * 2 ** rng.normal()
        labels = [*rng.choice(list(KNOWN), int(rng.integers(2, 5))), *["thing"] * n_things]
        count = len(labels)
        offset = {label: log_prior_of(label)[2] * rng.normal() for label in KNOWN}
        x, distance = rng.uniform(30, WIDTH - 30, count), np.exp(rng.uniform(1.2, 3.5, count))
        below = FOCAL * height * np.exp(RELIEF * rng.normal(size=count)) / distance
        row = horizon + slope * (x - WIDTH / 2) + below + SLOPE_PX * rng.normal(size=count)
        in_air = rng.random(count) < 0.1
        row = np.where(in_air, rng.uniform(0, HEIGHT, count), row)
        size = np.exp([
            log_prior_of(label)[0] + offset[label] + log_prior_of(label)[1] * rng.normal()
            if label in KNOWN
            else 0.8 * rng.normal()
            for label in labels
        ])  # fmt: skip
        pixels = FOCAL * size / distance
        top, low = np.array([row - pixels, row]) + rng.normal(size=(2, count)) / math.sqrt(2)
        if top.min() > 2 and low.max() < HEIGHT - 2 and (low - top).min() > 8:
            boxes = np.stack([x - 5, top, x + 5, low], axis=1)
            detections = [ims.Detection(*pair) for pair in zip(labels, boxes, strict=True)]
            values = UNIT * distance * np.exp(depth_rel * rng.normal(size=count))
            return detections, values, size[-n_things:], in_air[-n_things:], height


def coverage(method, count, seed=0, depth_rel=0.1):
    """Rates at which 90 % intervals hold the sizes of unknown objects and the camera's height."""
    rng = np.random.default_rng(seed)
    sizes, airs, heights = [], [], []
    for _ in range(count):
        detections, values, truth, in_air, height = drawn_scene(rng, depth_rel)
        depth = relative(values, depth_rel)
        model = ims.fit(detections, depth, KNOWN_TABLE, ground=GROUND, method=method)
        estimates = ims.predict(model, detections, depth)[-truth.size :]
        ends = np.array([estimate.interval(0.9) for estimate in estimates])
        sizes.append((ends[:, 0] <= truth) & (truth <= ends[:, 1]))
        airs.append(in_air)
        of_height = model.plane.camera_height_std_m / model.camera_height_m
        heights.append(abs(math.log(model.camera_height_m / height)) < 1.645 * of_height)
    return np.mean(sizes), np.mean(heights)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "count"), [("robust", 60), ("posterior", 40)])
def test_intervals_cover_nine_in_ten(method, count):
    of_sizes, of_heights = coverage(method, count)
    # three binomial errors; the things of one scene share some of theirs, a third of it at most
    margin = 3 * math.sqrt(0.09 / count)
    assert abs(of_heights - 0.9) < margin
    assert abs(of_sizes - 0.9) < margin * math.sqrt(0.6)


@pytest.mark.parametrize("method", METHODS)
def test_a_told_height_gives_relative_depths_their_scale(method):
    # nothing of known size: k is the told height over what the feet say it is in depth units
    scene = Scene.drawn(6, 8)
    told = ims.GroundPlane(image_size=SIZE, camera_height_m=CAMERA_HEIGHT, camera_height_std_m=0.05)
    labels = ["thing"] * 8
    depth = relative(UNIT * scene.z_m, 0.02)
    model = ims.fit(scene.seen(labels), depth, scene.table(0), ground=told, method=method)
    assert model.k == pytest.approx(1 / (UNIT * FOCAL), rel=0.02)
    assert 0.05 / CAMERA_HEIGHT < model.k_std / model.k < 0.05
    for size, size_m in zip(
        ims.predict(model, scene.seen(labels), depth), scene.size_m, strict=True
    ):
        assert size.size_m == pytest.approx(size_m, rel=0.03)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("factor", [0.7, 1.0, 1.4])
def test_a_wrong_focal_length_is_noticed_beside_a_plane(factor, method):
    scene = Scene.drawn(6, 6)
    depth = ims.ObjectDepths(scene.z_m, kind="metric", rel_std=0.02)
    camera = ims.Camera(factor * FOCAL, focal_rel_std=0.01, image_size=SIZE)
    model = ims.fit(
        scene.seen(), depth, scene.table(5, 0.02), ground=GROUND, camera=camera, method=method
    )
    assert (Flag.CAMERA_CONFLICT in model.flags) == (factor != 1.0)
