"""Drawn scenes: their boxes, depths and masks against independent geometry."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import imgscale as ims
from imgscale.datasets import drawn
from imgscale.datasets.drawn import DrawnCamera, Thing, draw

TILTED = DrawnCamera(
    image_size=(320, 240), focal_px=260.0, height_m=2.2, pitch_deg=17.0, roll_deg=-3.0
)
LEVEL = DrawnCamera(image_size=(320, 240), focal_px=250.0, height_m=1.5)
SCENES = ["street", "camera_trap_poles", "camera_trap", "hallway", "table_top"]


def seen_by(camera, places):
    """Project places by a rotation matrix that scipy makes."""
    right, up, ahead = np.transpose(places)
    world = np.column_stack([right, camera.height_m - up, ahead])
    turn = Rotation.from_euler("xz", [camera.pitch_deg, camera.roll_deg], degrees=True)
    x, y, z = turn.apply(world).T
    width, height = camera.image_size
    return np.column_stack(
        [width / 2 + camera.focal_px * x / z, height / 2 + camera.focal_px * y / z]
    ), z


# --- the camera ---


def test_projects_as_a_pinhole_with_pitch_and_roll():
    places = np.random.default_rng(0).uniform((-3, 0, 2), (3, 2.5, 30), (50, 3))
    pixels, z = seen_by(TILTED, places)
    assert TILTED.project(places) == pytest.approx(pixels, abs=1e-9)
    assert TILTED.in_camera(places)[:, 2] == pytest.approx(z, abs=1e-12)


def test_projects_as_opencv_does():
    cv2 = pytest.importorskip("cv2")
    places = np.random.default_rng(1).uniform((-3, 0, 4), (3, 2.5, 30), (20, 3))
    world = places * (1, -1, 1) + (0, TILTED.height_m, 0)
    matrix = np.array([[260.0, 0, 160.0], [0, 260.0, 120.0], [0, 0, 1]])
    turn, _ = cv2.Rodrigues(TILTED.axes)
    pixels, _ = cv2.projectPoints(world, turn, np.zeros(3), matrix, None)
    assert TILTED.project(places) == pytest.approx(pixels[:, 0], abs=1e-6)


def test_the_horizon_is_where_the_ground_goes():
    far = TILTED.project([(0.0, 0.0, 1e9), (1e9, 0.0, 1e9)])
    # the middle column is met where the line through two far points crosses it
    slope = (far[1, 1] - far[0, 1]) / (far[1, 0] - far[0, 0])
    assert far[0, 1] + slope * (160 - far[0, 0]) == pytest.approx(TILTED.horizon_px, abs=1e-5)
    assert math.degrees(math.atan(slope)) == pytest.approx(-3.0, abs=1e-6)


def test_what_is_behind_the_camera_is_an_error():
    with pytest.raises(ValueError, match=r"more than 0\.05 m before the camera; got .* -1 m"):
        LEVEL.project([(0.0, 0.0, -1.0)])


@pytest.mark.parametrize(
    ("name", "value"), [("focal_px", 0.0), ("height_m", -1.0), ("pitch_deg", math.nan)]
)
def test_a_camera_of_bad_numbers_is_an_error(name, value):
    good = {"image_size": (320, 240), "focal_px": 250.0, "height_m": 1.5}
    with pytest.raises(ValueError, match=f"`{name}` must be finite"):
        DrawnCamera(**(good | {name: value}))


# --- things ---


@pytest.mark.parametrize("shape", drawn.SHAPES)
def test_every_shape_fills_its_box_and_obeys_the_pinhole_law(shape):
    thing = Thing("it", 0.1, 8.0, 2.0, shape=shape)
    scene = draw(LEVEL, [thing])
    (found,), (mask,) = scene.detections, scene.masks
    assert found.height_px == pytest.approx(250.0 * 2.0 / 8.0, abs=1e-9)
    assert found.width_px == pytest.approx(250.0 * thing.drawn_width_m / 8.0, abs=1e-9)
    rows, columns = np.nonzero(mask)
    outline = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
    assert outline == pytest.approx(found.xyxy, abs=2.0)  # tips are narrower than a pixel
    assert scene.sizes_m == (2.0,)
    assert scene.depth.values[mask] == pytest.approx(8.0, abs=1e-9)


def test_a_mirrored_thing_is_the_mirror_image():
    one = draw(LEVEL, [Thing("fox", 0.0, 4.0, 1.0)])
    other = draw(LEVEL, [Thing("fox", 0.0, 4.0, 1.0, mirrored=True)])
    assert np.mean(one.masks[0][:, ::-1] != other.masks[0]) < 0.001
    assert np.any(one.masks[0] != other.masks[0])


def test_the_nearer_hides_the_farther_whatever_their_order():
    near, far = Thing("door", 0.0, 4.0, 2.0), Thing("door", 0.2, 6.0, 2.4)
    for things in ([near, far], [far, near]):
        scene = draw(LEVEL, things)
        masks = dict(zip([thing.ahead_m for thing in things], scene.masks, strict=True))
        assert not np.any(masks[4.0] & masks[6.0])
        assert scene.depth.values[masks[4.0]] == pytest.approx(4.0, abs=1e-9)
        assert masks[4.0].sum() == pytest.approx(125 * 0.9 * 250 / 4 / 2.03 * 2, rel=0.02)


def test_a_backdrop_is_seen_and_not_detected():
    backdrop = [Thing("tree", 2.0, 9.0, 3.0), Thing("tree", 50.0, 9.0, 3.0)]
    scene = draw(LEVEL, [Thing("person", 0.0, 5.0, 1.7)], backdrop=backdrop)
    assert len(scene.detections) == len(scene.masks) == 1
    assert np.nanmax(np.isclose(scene.depth.values, 9.0))


def test_an_empty_scene_is_ground_and_sky():
    scene = draw(LEVEL, [])
    assert scene.detections == scene.sizes_m == ()
    assert np.isnan(scene.depth.values[:120]).all()


def test_a_thing_cut_by_the_border_is_partial_and_its_box_in_the_picture():
    scene = draw(LEVEL, [Thing("person", -2.5, 4.0, 1.7)])
    (cut,) = scene.detections
    assert cut.partial
    assert cut.xyxy[0] == 0.0


@pytest.mark.parametrize(
    ("things", "options", "message"),
    [
        ([Thing("door", 50.0, 5.0, 2.0)], {}, "`things` must be in view; the door would be"),
        ([Thing("door", 0.0, -5.0, 2.0)], {}, "before the camera"),
        ([], {"ground": "moon"}, '`ground` must be one of "plain", "street", "meadow", "hall"'),
    ],
    ids=["out of view", "behind", "unknown ground"],
)
def test_an_impossible_scene_is_an_error(things, options, message):
    with pytest.raises(ValueError, match=message):
        draw(LEVEL, things, **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"label": "unicorn"}, "`shape` must be one of \"person\", .*; got 'unicorn'"),
        ({"height_m": 0.0}, "`height_m` must be finite and positive; got 0"),
        ({"width_m": -1.0}, "`width_m` must be finite and positive; got -1"),
        ({"ahead_m": math.inf}, "`ahead_m` must be finite; got inf"),
        ({"colour": (255, 0, 0)}, "`colour` must be red, green and blue, .* got .255, 0, 0."),
        ({"colour": "red"}, "`colour` must be red, green and blue, .* got 'red'"),
    ],
    ids=["shape", "height", "width", "place", "bytes", "name"],
)
def test_an_impossible_thing_is_an_error(options, message):
    good = {"label": "door", "right_m": 0.0, "ahead_m": 5.0, "height_m": 2.0}
    with pytest.raises(ValueError, match=message):
        Thing(**(good | options))


# --- depth ---


def places_of(scene):
    """Put every pixel back into the world by its depth: right, up, ahead."""
    camera = scene.viewpoint
    width, height = camera.image_size
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    z = scene.depth.values
    seen = np.stack(
        [(x - width / 2) / camera.focal_px * z, (y - height / 2) / camera.focal_px * z, z], axis=-1
    )
    turn = Rotation.from_euler("xz", [camera.pitch_deg, camera.roll_deg], degrees=True)
    world = turn.inv().apply(seen.reshape(-1, 3)).reshape(seen.shape)
    return world[..., 0], camera.height_m - world[..., 1], world[..., 2]


def test_every_pixel_lies_on_the_ground_or_on_a_thing():
    things = [Thing("person", -0.8, 5.0, 1.7), Thing("door", 0.9, 7.0, 2.0)]
    scene = draw(TILTED, things)
    right, up, ahead = places_of(scene)
    for thing, mask in zip(things, scene.masks, strict=True):
        assert ahead[mask] == pytest.approx(thing.ahead_m, abs=1e-9)
        assert up[mask].min() > -0.02  # half a pixel
        assert up[mask].max() < thing.height_m + 0.02
        assert np.abs(right[mask] - thing.right_m).max() < thing.drawn_width_m / 2 + 0.02
    ground = ~(scene.masks[0] | scene.masks[1]) & np.isfinite(scene.depth.values)
    assert_allclose(up[ground], 0.0, atol=1e-7)
    assert ground.mean() > 0.5


def test_a_hall_has_walls_a_floor_and_a_ceiling():
    scene = drawn.hallway()
    right, up, ahead = places_of(scene)
    assert np.abs(right).max() < 2.2 + 1e-9
    assert ahead.max() < 6.02 + 1e-9
    assert -0.006 < up.min() < up.max() < 2.9 + 1e-9  # one door stands 5 mm too low
    on_wall = np.isclose(np.abs(right), 2.2) | np.isclose(ahead, 6.02)
    flat = on_wall | np.isclose(up, 0.0, atol=1e-9) | np.isclose(up, 2.9)
    assert (flat | np.any(scene.masks, axis=0)).all()


@pytest.mark.parametrize("kind", ["relative", "inverse", "affine_inverse"])
def test_other_kinds_of_depth_give_the_same_sizes(kind):
    scene = drawn.street()
    table = ims.PriorTable(
        [
            ims.ObjectPrior(f"known {index}", size, 0.001)
            for index, size in enumerate(scene.sizes_m[:5])
        ]
    )
    things = [
        ims.Detection(f"known {index}", seen.xyxy)
        for index, seen in enumerate(scene.detections[:5])
    ]
    depth = scene.depth_as(kind)
    noise = ims.Noise(box_px=0.2, depth_rel=0.002)
    model = ims.fit(things, depth, table, camera=scene.camera, noise=noise)
    statue = ims.predict(model, scene.detections, depth)[-1]
    assert statue.size_m == pytest.approx(2.6, rel=0.005)
    expected = {"relative": 1 / (8.0 * 820.0), "inverse": 8.0 / 820.0, "affine_inverse": 8.0 / 820}
    assert model.k == pytest.approx(expected[kind], rel=0.01)
    assert model.shift == pytest.approx(0.4 if kind == "affine_inverse" else 0.0, abs=0.01)


def test_a_network_gives_nought_in_the_sky_and_never_less():
    values = drawn.street().depth_as("affine_inverse").values
    assert values[0, 480] == 0.0
    assert values.min() == 0.0
    assert values.dtype == np.float32


def test_noise_of_depth_is_as_large_as_asked_for_and_needs_an_rng():
    scene = drawn.hallway()
    exact = scene.depth_as("relative", factor=3.0).values / 3.0
    assert_allclose(exact, scene.depth.values, rtol=1e-6)
    noisy = scene.depth_as("relative", rel_std=0.05, rng=np.random.default_rng(0)).values / 8.0
    assert np.std(np.log(noisy / exact)) == pytest.approx(0.05, rel=0.01)
    still = scene.depth_as("relative", rel_std=0.05).values / 8.0
    assert_allclose(still, exact, rtol=1e-6)


def test_an_unknown_kind_of_depth_is_an_error():
    with pytest.raises(ValueError, match=r'`kind` must be one of "relative", "inverse"'):
        drawn.street().depth_as("metric")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"factor": 0.0}, "`factor` must be finite and positive; got 0"),
        ({"shift": math.nan}, "`shift` must be finite; got nan"),
        ({"rel_std": -0.1}, "`rel_std` must be finite and not negative; got -0.1"),
    ],
)
def test_depth_by_bad_numbers_is_an_error(options, message):
    with pytest.raises(ValueError, match=message):
        drawn.street().depth_as("affine_inverse", **options)


# --- boxes ---


def test_boxes_err_as_the_noise_says():
    small = DrawnCamera(image_size=(64, 48), focal_px=60.0, height_m=1.5)
    rng, noise = np.random.default_rng(3), ims.Noise(box_px=1.0, box_rel=0.05)
    scenes = [draw(small, [Thing("door", 0, 4, 2)], rng=rng, noise=noise) for _ in range(600)]
    heights = [scene.detections[0].height_px for scene in scenes]
    assert np.mean(heights) == pytest.approx(30.0, abs=0.2)
    assert np.std(heights) == pytest.approx(math.hypot(1.0, 0.05 * 30), rel=0.1)
    assert scenes[0].noise == noise
    assert draw(small, [Thing("door", 0, 4, 2)]).noise == ims.Noise(box_px=0.0)


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_is_the_same_by_the_same_seed_and_whole(name):
    make = getattr(drawn, name)
    one, again, other = (make(rng=np.random.default_rng(seed)) for seed in (5, 5, 6))
    assert one.detections == again.detections != other.detections
    assert np.array_equal(one.image, again.image)
    exact = make()
    assert exact.image.dtype == np.uint8
    assert exact.image.shape == (*exact.depth.values.shape, 3)
    lengths = {
        len(part)
        for part in (exact.detections, exact.sizes_m, exact.distances_m, exact.masks)
    }  # fmt: skip
    assert len(lengths) == 1
    for seen, mask in zip(exact.detections, exact.masks, strict=True):
        assert not seen.partial
        assert mask.any()


@pytest.mark.parametrize("name", ["street", "camera_trap_poles", "camera_trap", "hallway"])
def test_distances_are_those_of_the_feet(name):
    scene = getattr(drawn, name)()
    for seen, mask, distance in zip(
        scene.detections, scene.masks, scene.distances_m, strict=True
    ):  # fmt: skip
        lowest = np.nonzero(mask)[0].max()
        at_foot = scene.depth.values[lowest][mask[lowest]].mean()
        assert at_foot == pytest.approx(distance, rel=0.005), seen.label


# --- the ready scenes ---


def test_poles_find_the_camera():
    scene = drawn.camera_trap_poles()
    given = (scene.detections, ims.GroundPlane(image_size=(960, 540)), scene.priors)
    camera = ims.Camera(700.0, focal_rel_std=0.0)
    model = ims.fit(*given, camera=camera, noise=ims.Noise(box_px=0.1, depth_rel=0.001))
    assert model.camera_height_m == pytest.approx(scene.viewpoint.height_m, rel=0.002)
    assert model.horizon_px == pytest.approx(scene.viewpoint.horizon_px, abs=0.5)
    assert model.plane.roll_deg == pytest.approx(scene.viewpoint.roll_deg, abs=0.05)


def test_animals_are_drawn_apart_and_of_their_species():
    rng = np.random.default_rng(0)
    animals = [
        (seen, size)
        for _ in range(30)
        for scene in [drawn.camera_trap(rng=rng, noise=ims.Noise(box_px=0.0))]
        for seen, size in zip(scene.detections, scene.sizes_m, strict=True)
    ]
    foxes = [size for seen, size in animals if seen.label == "fox"]
    assert 30 < len(animals) < 90
    assert np.mean(foxes) == pytest.approx(0.44, abs=0.02)
    assert not any(seen.partial for seen, _ in animals)


def test_a_ball_is_boxed_and_as_deep_as_its_surface():
    scene = drawn.table_top()
    camera, rng = scene.viewpoint, np.random.default_rng(0)
    for index, place in ((2, (-0.115, 0.055)), (3, (0.105, 0.045)), (4, (-0.10, -0.075))):
        radius = scene.sizes_m[index] / 2
        normals = rng.normal(size=(200_000, 3))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        middle = np.array([place[0], radius, place[1]])
        pixels, z = seen_by(camera, middle + radius * normals)
        box = (*pixels.min(axis=0), *pixels.max(axis=0))
        assert scene.detections[index].xyxy == pytest.approx(box, abs=0.1)
        assert scene.depth.values[scene.masks[index]].min() == pytest.approx(z.min(), abs=1e-4)
        assert scene.distances_m[index] == pytest.approx(0.55 - radius, abs=1e-12)


def test_flat_things_on_the_table_obey_the_pinhole_law():
    scene = drawn.table_top()
    for index in (0, 1):
        seen, z = scene.detections[index], scene.distances_m[index]
        assert seen.width_px * z / 1100.0 == pytest.approx(scene.sizes_m[index], rel=1e-9)
        area = scene.masks[index].sum() * (z / 1100.0) ** 2
        assert area == pytest.approx(math.pi / 4 * scene.sizes_m[index] ** 2, rel=0.01)


def test_the_camera_tells_its_pitch_unless_it_looks_straight_down():
    assert drawn.hallway().camera.pitch_deg == 25.0
    assert drawn.table_top().camera == ims.Camera(
        1100.0, focal_rel_std=0.0, image_size=(900, 675)
    )  # fmt: skip
