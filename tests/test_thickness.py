"""Depths of centres: half the extent along the view, against random rectangles and perspective."""

import math

import numpy as np
import pytest

import imgscale as ims
from imgscale.thickness import surface_depth, view_extent

METHODS = ["posterior", "robust"]
FOCAL = 1200.0
IMAGE = (4000, 2400)
TOLD = ims.Noise(box_px=0.5, depth_rel=0.01)


# --- extents of random ground plans ------------------------------------------------------------


def random_plans(seed, count=400_000):
    """Rectangles of a longer side 1, turned any way: visible width and reach along the view."""
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0, math.pi / 2, count)
    slim = np.exp(rng.uniform(math.log(0.2), 0, count))
    corners = np.stack([
        np.array([x * np.ones(count), y * slim]) for x in (-0.5, 0.5) for y in (-0.5, 0.5)
    ])  # fmt: skip
    # the plan's long side lies along the view at turn 0
    across = corners[:, 0] * np.sin(turn) + corners[:, 1] * np.cos(turn)
    along = corners[:, 0] * np.cos(turn) - corners[:, 1] * np.sin(turn)
    return np.ptp(across, axis=0), np.ptp(along, axis=0)


@pytest.mark.parametrize("long_m", [0.5, 4.5, 12.0])
@pytest.mark.parametrize("share", [0.3, 0.45, 0.6, 0.8, 1.0, 1.15])
def test_the_extent_is_the_mean_over_the_plans_that_look_as_wide(share, long_m):
    visible, reach = random_plans(1)
    # the visible width is known within 12 %
    weight = np.exp(-0.5 * (np.log(share / visible) / 0.12) ** 2)
    weight /= weight.sum()
    mean = weight @ reach
    std = math.sqrt(weight @ (reach - mean) ** 2)
    found, found_std = view_extent(np.array([share * long_m]), np.array([long_m]))
    # 15 x 31 plans stand for all
    assert found[0] / long_m == pytest.approx(mean, abs=0.02)
    assert found_std[0] / long_m == pytest.approx(std, abs=0.02)


@pytest.mark.parametrize("visible_m", [0.3, 2.0, 9.0])
def test_without_a_length_the_extent_is_the_width_times_that_of_any_plan(visible_m):
    visible, reach = random_plans(2)
    ratio = reach / visible
    found, found_std = view_extent(np.array([visible_m]), np.array([np.nan]))
    # the ends of the turns weigh full in the sum over 31 of them
    assert found[0] / visible_m == pytest.approx(ratio.mean(), rel=0.08)
    assert found_std[0] / visible_m == pytest.approx(ratio.std(), rel=0.12)


def test_rows_do_not_mix_and_what_is_not_known_stays_unknown():
    visible = np.array([1.8, 0.5, np.nan, 3.0])
    long_m = np.array([4.5, np.nan, 4.5, 4.5])
    mean, std = view_extent(visible, long_m)
    for row in (0, 1, 3):
        alone = view_extent(visible[[row]], long_m[[row]])
        assert mean[row] == pytest.approx(alone[0][0], rel=1e-12)
        assert std[row] == pytest.approx(alone[1][0], rel=1e-9)
    assert np.isfinite(mean[[0, 1, 3]]).all()


def test_seen_from_the_side_a_thing_is_shallower_than_seen_end_on():
    mean, std = view_extent(np.array([1.4, 2.5, 4.4]), np.full(3, 4.5))
    assert mean[0] > 4.2
    assert mean[1] > 4.2
    assert mean[2] < 4.0
    assert std[2] > std[0]  # a long side across may be a slim thing or a square one


@pytest.mark.parametrize(
    ("centre", "extent", "expected"), [(20.0, 4.0, 18.0), (5.0, 1.0, 4.5), (2.0, 4.5, 1.0)]
)
def test_half_the_extent_lies_between_centre_and_surface(centre, extent, expected):
    depth, rel_std = surface_depth(np.array([centre]), np.array([extent]), np.array([0.6]))
    assert depth[0] == pytest.approx(expected)
    assert rel_std[0] == pytest.approx(0.3 / expected)


def test_an_unknown_centre_stays_unknown():
    depth, _ = surface_depth(np.array([np.nan, 9.0]), np.array([1.0, 1.0]), np.array([0.1, 0.1]))
    assert np.isnan(depth[0])
    assert depth[1] == 8.5


# --- exact perspective of boxes ----------------------------------------------------------------


class Box:
    """A box on the ground before a level camera, and its outline in the picture."""

    def __init__(self, label, size, distance, turn, aside=0.0, eye=None):
        length, width, height = size
        eye = height / 2 if eye is None else eye
        x, y, z = np.meshgrid([-0.5, 0.5], [0.0, 1.0], [-0.5, 0.5], indexing="ij")
        along, across = z.ravel() * length, x.ravel() * width
        world_z = distance + along * math.cos(turn) - across * math.sin(turn)
        world_x = aside + along * math.sin(turn) + across * math.cos(turn)
        world_y = eye - y.ravel() * height
        column = IMAGE[0] / 2 + FOCAL * world_x / world_z
        row = IMAGE[1] / 2 + FOCAL * world_y / world_z
        self.detection = ims.Detection(label, (column.min(), row.min(), column.max(), row.max()))
        self.centre, self.surface, self.height = distance, world_z.min(), height


CAR, BUS = (4.4, 1.8, 1.5), (11.0, 2.5, 3.0)


def table(spread=0.01):
    # labels that no shipped table knows
    return ims.PriorTable([
        ims.ObjectPrior("wagon", 1.5, 1.5 * spread, depth_extent_m=4.4),
        ims.ObjectPrior("coach", 3.0, 3.0 * spread, depth_extent_m=11.0),
        ims.ObjectPrior("panel", 2.0, 2.0 * spread, depth_extent_m=0.04),
        ims.ObjectPrior("walker", 1.7, 1.7 * spread, depth_extent_m=0.3),
    ])  # fmt: skip


def fitted(boxes, depth_at, values="centre", method="posterior"):
    depth = ims.ObjectDepths(
        [getattr(box, values) for box in boxes],
        kind="metric",
        image_size=IMAGE,
        depth_at=depth_at,
    )
    detections = [box.detection for box in boxes]
    model = ims.fit(detections, depth, table(), noise=TOLD, method=method)
    return model, ims.predict(model, detections, depth)


def traffic(seed, count=6):
    rng = np.random.default_rng(seed)
    boxes = []
    for _ in range(count):
        label, size = [("wagon", CAR), ("coach", BUS)][int(rng.random() < 0.25)]
        distance = math.exp(rng.uniform(math.log(9), math.log(25)))
        aside = distance * rng.uniform(-0.3, 0.3)
        # as turned towards the ray, which is what a level street shows
        boxes.append(Box(label, size, distance, rng.uniform(-math.pi / 2, math.pi / 2), aside))
    return boxes


def test_the_outline_is_that_of_the_near_edge():
    for box in traffic(0, 20):
        x1, y1, x2, y2 = box.detection.xyxy
        assert (y2 - y1) * box.surface / FOCAL == pytest.approx(box.height, rel=1e-12)
        assert x2 > x1


@pytest.mark.parametrize("method", METHODS)
def test_depths_of_centres_give_the_focal_length_as_those_of_surfaces_do(method):
    corrected, taken_as_given, exact = [], [], []
    for seed in range(25):
        boxes = traffic(seed)
        for found, depth_at, values in [
            (corrected, "centre", "centre"),
            (taken_as_given, "surface", "centre"),
            (exact, "surface", "surface"),
        ]:
            model, _ = fitted(boxes, depth_at, values, method)
            found.append(math.log(model.k * FOCAL))
    assert np.abs(exact).max() < 1e-3
    # k is the ratio of size to depth times pixels: too far away is too small a k
    assert np.mean(taken_as_given) < -0.08
    assert abs(np.mean(corrected)) < 0.2 * abs(np.mean(taken_as_given))
    assert np.median(np.abs(corrected)) < 0.3 * np.median(np.abs(taken_as_given))


@pytest.mark.parametrize("method", METHODS)
def test_sizes_of_the_known_come_out_right_from_their_centres(method):
    corrected, as_given = [], []
    for seed in range(15):
        boxes = traffic(100 + seed, 5)
        camera = ims.Camera(FOCAL, focal_rel_std=1e-3, image_size=IMAGE)
        for found, depth_at in [(corrected, "centre"), (as_given, "surface")]:
            depth = ims.ObjectDepths(
                [box.centre for box in boxes], kind="metric", image_size=IMAGE, depth_at=depth_at
            )
            detections = [box.detection for box in boxes]
            model = ims.fit(detections, depth, table(0.1), camera=camera, noise=TOLD, method=method)
            sizes = ims.predict(model, detections, depth)
            found.extend(
                math.log(size.size_m / box.height) for size, box in zip(sizes, boxes, strict=True)
            )
    assert np.mean(as_given) > 0.08
    assert abs(np.mean(corrected)) < 0.25 * np.mean(as_given)
    assert np.median(np.abs(corrected)) < 0.35 * np.median(np.abs(as_given))


@pytest.mark.parametrize("method", METHODS)
def test_a_stranger_is_moved_to_its_surface_by_its_own_width(method):
    errors = {"centre": [], "surface": []}
    for seed in range(15):
        rng = np.random.default_rng(seed)
        boxes = traffic(seed, 5)
        side = rng.uniform(1.0, 2.5)
        size = (side, side * rng.uniform(0.4, 1.0), 1.3)
        boxes.append(Box("kiosk", size, rng.uniform(6, 12), rng.uniform(0, math.pi / 2)))
        for depth_at, found in errors.items():
            _, sizes = fitted(
                boxes, depth_at, "centre" if depth_at == "centre" else "surface", method
            )
            if depth_at == "centre":
                found.append(math.log(sizes[-1].size_m / 1.3))
        # the same from true surfaces of the references, but its own centre
        depth = [box.surface for box in boxes[:-1]] + [boxes[-1].centre]
        values = ims.ObjectDepths(depth, kind="metric", image_size=IMAGE)
        detections = [box.detection for box in boxes]
        model = ims.fit(detections, values, table(), noise=TOLD, method=method)
        errors["surface"].append(math.log(ims.predict(model, detections, values)[-1].size_m / 1.3))
    assert np.mean(errors["surface"]) > 0.06
    assert np.median(np.abs(errors["centre"])) < 0.5 * np.median(np.abs(errors["surface"]))


@pytest.mark.parametrize("method", METHODS)
def test_the_intervals_hold_the_truth_though_the_turns_are_unknown(method):
    covered = []
    for seed in range(60):
        boxes = traffic(300 + seed, 4)
        model, _ = fitted(boxes, "centre", method=method)
        error = math.log(model.k * FOCAL)
        covered.append(abs(error) < 1.645 * model.k_std / model.k)
    # 60 images: 3.9 points; uniform turns and slimness are broader than cars and coaches are
    assert np.mean(covered) >= 0.8


# --- who is concerned --------------------------------------------------------------------------


@pytest.mark.parametrize("distance", [3.0, 5.0, 20.0])
def test_flat_things_stay_where_they_are(distance):
    box = Box("panel", (0.9, 0.04, 2.0), distance, math.pi / 2)
    model, _ = fitted([box], "centre")
    given, _ = fitted([box], "surface")
    assert model.k == pytest.approx(given.k, rel=0.01)
    assert model.references[0].depth == pytest.approx(distance, abs=0.03)


@pytest.mark.parametrize("distance", [8.0, 15.0, 30.0])
def test_people_hardly_change(distance):
    walker = Box("walker", (0.5, 0.3, 1.7), distance, 0.7)
    model, _ = fitted([walker], "centre")
    moved = distance - model.references[0].depth
    assert 0.05 < moved < 0.3
    assert model.k * FOCAL == pytest.approx(1, abs=0.2 / distance)


def test_cars_move_by_metres_and_say_how_sure_they_are():
    wagon = Box("wagon", CAR, 10.0, 0.0)  # seen end on: 4.4 m deep
    model, sizes = fitted([wagon], "centre")
    assert model.references[0].depth == pytest.approx(wagon.surface, abs=0.35)
    given, _ = fitted([wagon], "surface")
    assert given.references[0].depth == 10.0
    # not knowing the turn adds to the noise that was told
    assert model.references[0].noise_rel > given.references[0].noise_rel
    assert sizes[0].depth == model.references[0].depth


def test_an_unknown_depth_stays_unknown():
    wagon, coach = Box("wagon", CAR, 12.0, 0.3), Box("coach", BUS, 20.0, 0.3)
    depth = ims.ObjectDepths([12.0, math.nan], kind="metric", image_size=IMAGE, depth_at="centre")
    model = ims.fit([wagon.detection, coach.detection], depth, table(), noise=TOLD)
    assert model.references[1].reason == "no depth"
    sizes = ims.predict(model, [wagon.detection, coach.detection], depth)
    assert math.isnan(sizes[1].size_m)
    assert ims.Flag.NO_DEPTH in sizes[1].flags


@pytest.mark.parametrize("kind", ["relative", "inverse", "affine_inverse"])
def test_only_metres_can_be_taken_off_metres(kind):
    with pytest.raises(ValueError, match='"surface" unless the kind is "metric"'):
        ims.ObjectDepths([5.0], kind=kind, depth_at="centre")


def test_depths_lie_at_the_surface_or_the_centre():
    with pytest.raises(ValueError, match="`depth_at`"):
        ims.ObjectDepths([5.0], kind="metric", depth_at="middle")


@pytest.mark.parametrize("unit", [1.0, 2.0])
def test_sizes_do_not_depend_on_the_picture_resolution(unit):
    boxes = traffic(5)
    detections = [
        ims.Detection(box.detection.label, tuple(unit * value for value in box.detection.xyxy))
        for box in boxes
    ]
    size = (int(unit * IMAGE[0]), int(unit * IMAGE[1]))
    depth = ims.ObjectDepths(
        [box.centre for box in boxes], kind="metric", image_size=size, depth_at="centre"
    )
    noise = ims.Noise(box_px=0.0, depth_rel=0.01)
    model = ims.fit(detections, depth, table(), noise=noise)
    assert model.k * unit * FOCAL == pytest.approx(1, abs=0.05)
    reference, _ = fitted(boxes, "centre")
    found = [ref.depth for ref in model.references]
    assert found == pytest.approx([ref.depth for ref in reference.references], rel=1e-9)
