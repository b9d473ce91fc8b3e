"""The grid on the ground: where its lines are, against a pinhole camera of our own."""

import math
import subprocess
import sys
from functools import cache

import attrs
import numpy as np
import pytest

import imgscale as ims

pytest.importorskip("matplotlib", reason="matplotlib is not installed")

from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from imgscale.plotting._plane import PlaneView
from imgscale.plotting.ground import draw_ground_plane, grid_lines, transversal

SIZE = (1280, 720)
FOCAL = 900.0
CAMERA = ims.Camera(FOCAL, focal_rel_std=0.0, cx=655.0, cy=341.0, image_size=SIZE)
STREET = [
    ims.Detection("person", (310, 344, 388, 576)),
    ims.Detection("person", (840, 352, 880, 480)),
    ims.Detection("car", (520, 369, 700, 507)),
]


def turned(pitch_deg, roll_deg):
    """Axes of the camera in the world (right, down, ahead): first the pitch, then the roll."""
    pitch, roll = np.radians([pitch_deg, roll_deg])
    about_x = [
        [1, 0, 0],
        [0, np.cos(pitch), -np.sin(pitch)],
        [0, np.sin(pitch), np.cos(pitch)],
    ]
    about_z = [[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]]
    return np.array(about_z) @ np.array(about_x)


def pinhole(places, height_m, pitch_deg, roll_deg):
    """Pixels of places given as metres to the right, up from the ground, and ahead."""
    right, up, ahead = np.moveaxis(np.asarray(places, dtype=float), -1, 0)
    seen = np.stack([right, height_m - up, ahead], axis=-1) @ turned(pitch_deg, roll_deg).T
    return FOCAL * seen[..., :2] / seen[..., 2:] + [CAMERA.cx, CAMERA.cy]


def horizon_of(pitch_deg, roll_deg):
    """Row of the horizon in the middle column: that of places very far away."""
    far = turned(pitch_deg, roll_deg) @ np.array([[1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]]).T
    (x1, x2), (y1, y2) = FOCAL * far[:2] / far[2] + np.array([[CAMERA.cx], [CAMERA.cy]])
    return float(y1 + (SIZE[0] / 2 - x1) * (y2 - y1) / (x2 - x1))


@cache
def fitted(camera):
    return ims.fit(STREET, ims.GroundPlane(image_size=SIZE), camera=camera)


def model_of(height_m=1.6, pitch_deg=4.0, roll_deg=0.0, camera=CAMERA, std_px=4.0):
    plane = ims.FittedPlane(
        camera_height_m=height_m,
        camera_height_std_m=0.05,
        horizon_px=horizon_of(pitch_deg, roll_deg),
        horizon_std_px=std_px,
        roll_deg=roll_deg,
        roll_std_deg=0.5,
    )
    return attrs.evolve(fitted(camera), plane=plane)


POSES = [(1.6, 4.0, 0.0), (1.6, -3.0, 2.0), (6.0, 35.0, -5.0), (0.4, 0.0, 12.0)]


@pytest.mark.parametrize("pose", POSES, ids=str)
def test_places_on_the_ground_are_seen_where_a_pinhole_camera_sees_them(pose):
    view = PlaneView.of(model_of(*pose))
    rng = np.random.default_rng(0)
    right, ahead = rng.uniform(-20, 20, 50), rng.uniform(5, 60, 50)
    expected = pinhole(np.stack([right, 0 * right, ahead], axis=-1), *pose)
    np.testing.assert_allclose(view.project(right, ahead), expected, atol=1e-6)
    found = view.ground_at(*expected.T)
    np.testing.assert_allclose(found, np.stack([right, ahead], axis=-1), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("pose", POSES, ids=str)
def test_grid_lines_lie_on_whole_metres_of_a_pinhole_camera(pose):
    lines = grid_lines(PlaneView.of(model_of(*pose)), 0.6, None)
    down = turned(*pose[1:]) @ [0, 1, 0]
    assert len(lines) > 20
    for line in lines:
        rays = np.column_stack([line.ends - [CAMERA.cx, CAMERA.cy], [FOCAL, FOCAL]])
        world = rays * (pose[0] / (rays @ down))[:, None] @ turned(*pose[1:])
        right, ahead = world[:, 0] / line.side, world[:, 2] / line.side
        on_right = np.abs(right - np.round(right[0])).max()
        on_ahead = np.abs(ahead - np.round(ahead[0])).max()
        assert min(on_right, on_ahead) < 1e-7
        assert (line.ends > -1e-6).all()
        assert (line.ends < np.array(SIZE) + 1e-6).all()


def test_the_same_lines_are_drawn_half_a_pixel_up_as_pictures_are():
    model = model_of()
    ax = draw_ground_plane(model)
    grids = [item for item in ax.collections if isinstance(item, LineCollection)]
    expected = transversal(PlaneView.of(model), 10) - 0.5
    marked = [segment for grid in grids for segment in grid.get_segments()]
    assert min(np.abs(segment - expected).max() for segment in marked) < 1e-9


def poles(height_m, pitch_deg, roll_deg, length=1.0, places=((0.0, 6.0), (1.5, 9.0), (-3.0, 14.0))):
    boxes = []
    for right, ahead in places:
        thing = [(right + side, up, ahead) for side in (-0.2, 0.2) for up in (0.0, length)]
        seen = pinhole(thing, height_m, pitch_deg, roll_deg)
        boxes.append((*seen.min(axis=0), *seen.max(axis=0)))
    return [ims.Detection("pole", box) for box in boxes]


@pytest.mark.parametrize("pitch_deg", [0.0, 4.0, 15.0])
def test_predict_gives_one_metre_to_a_pole_of_a_metre_on_a_grid_line(pitch_deg):
    table = ims.PriorTable([ims.ObjectPrior("pole", 1.0, 1e-4)])
    ground = ims.GroundPlane(
        image_size=SIZE, horizon_px=horizon_of(pitch_deg, 0.0), horizon_std_px=1e-3, roll_deg=0.0,
        roll_std_deg=1e-4,
    )  # fmt: skip
    known = poles(2.0, pitch_deg, 0.0)
    model = ims.fit(known, ground, table, camera=CAMERA, noise=ims.Noise(box_px=0.0))
    view = PlaneView.of(model)
    # stood on the model's own grid, with the same independent pinhole for its top
    new = poles(view.height_m, pitch_deg, 0.0, places=[(2.0, 7.0)])
    foot = view.project(2.0, 7.0)
    assert new[0].xyxy[3] == pytest.approx(foot[1], abs=0.05)
    (estimate,) = ims.predict(model, [attrs.evolve(new[0], label="thing")])
    assert estimate.size_m == pytest.approx(1.0, rel=2e-3)
    z_depth = 7.0 * math.cos(math.radians(pitch_deg)) + 2.0 * math.sin(math.radians(pitch_deg))
    assert estimate.distance_m == pytest.approx(z_depth, rel=2e-3)


def test_the_scale_on_the_ground_is_that_of_predict_along_the_width():
    ground = ims.GroundPlane(image_size=SIZE, horizon_px=270.0, horizon_std_px=3.0, roll_deg=0.0,
                             roll_std_deg=1e-4)  # fmt: skip
    model = ims.fit(STREET, ground, camera=CAMERA)
    (estimate,) = ims.predict(model, [ims.Detection("thing", (600, 500, 680, 560))], axis="width")
    scale = float(PlaneView.of(model).metres_per_pixel(640, 560))
    assert scale == pytest.approx(estimate.metres_per_pixel, rel=1e-6)


def test_the_horizon_is_drawn_with_its_interval():
    model = model_of(roll_deg=3.0)
    ax = draw_ground_plane(model, level=0.9)
    (line,) = (item for item in ax.lines if item.get_label().startswith("horizon"))
    x, y = np.asarray(line.get_data())
    slope = math.tan(math.radians(3.0))
    np.testing.assert_allclose(
        y + 0.5, model.horizon_px + slope * (x + 0.5 - SIZE[0] / 2), atol=1e-9
    )
    band = ax.collections[0].get_paths()[0].vertices
    middle = band[np.abs(band[:, 0] - (SIZE[0] / 2 - 0.5)) < 1e-6]
    assert np.ptp(middle[:, 1]) == pytest.approx(2 * 1.6448536 * 4.0, rel=1e-6)  # normal 95 %


def test_without_a_focal_length_poles_of_a_metre_stand_on_the_ground():
    model = model_of(camera=None)
    ax = draw_ground_plane(model)
    stood = [line for line in ax.lines if line.get_marker() == "_"]
    assert len(stood) > 2
    for line in stood:
        foot, top = np.asarray(line.get_ydata()) + 0.5
        # the camera is 1.6 m up, and so is the horizon at the pole
        assert (foot - model.horizon_px) / (foot - top) == pytest.approx(1.6, rel=1e-9)
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert "poles of 1 m; squares on the ground need camera=" in texts


def test_a_camera_given_serves_where_the_model_has_none():
    ax = draw_ground_plane(model_of(camera=None), camera=CAMERA)
    assert {text.get_text() for text in ax.texts} >= {"5 m", "10 m"}


def test_the_grid_ends_at_the_extent_given():
    ax = draw_ground_plane(model_of(), extent_m=12.0)
    assert {text.get_text() for text in ax.texts} >= {"10 m"}
    assert not {"20 m", "50 m"} & {text.get_text() for text in ax.texts}


def test_lines_that_would_crowd_are_left_to_larger_squares():
    lines = grid_lines(PlaneView.of(model_of()), 0.6, None)
    reach = {}
    for line in lines:
        ahead = PlaneView.of(model_of()).ground_at(*line.ends.T)[:, 1]
        reach[line.side] = max(reach.get(line.side, 0.0), float(ahead.max()))
    sides = sorted(reach)
    assert sides[:3] == [1, 5, 20]
    assert reach[1] < reach[5] < reach[20] < 2000
    # 1 m is 5 points deep there: f h / z^2 for a level camera
    level = PlaneView.of(model_of(pitch_deg=0.0))
    ends = [line.ends for line in grid_lines(level, 0.6, None) if line.side == 1]
    farthest = max(float(level.ground_at(*pair.T)[:, 1].max()) for pair in ends)
    assert farthest == pytest.approx(math.sqrt(FOCAL * 1.6 * 0.6 / 5.0), rel=0.1)


def test_a_horizon_outside_the_picture_is_told():
    ax = draw_ground_plane(model_of(height_m=5.0, pitch_deg=40.0))
    assert "above the picture" in ax.get_legend().get_texts()[0].get_text()
    assert ax.get_ylim() == (719.5, -0.5)


def test_axes_and_figure_given_keep_their_place():
    figure = Figure(figsize=(8, 3))
    left, right = figure.subplots(1, 2)
    places = [axes.get_position().bounds for axes in (left, right)]
    assert draw_ground_plane(model_of(), ax=left) is left
    assert figure.axes == [left, right]
    assert [axes.get_position(original=True).bounds for axes in (left, right)] == places


@pytest.mark.parametrize("size", [(300, 200), (3840, 2160)], ids=str)
def test_small_and_large_pictures_are_drawn(tmp_path, size):
    height = size[1] * 0.45
    ground = ims.GroundPlane(image_size=size, horizon_px=height, camera_height_m=1.6)
    camera = ims.Camera(0.8 * size[0], focal_rel_std=0.01)
    model = ims.fit([], ground, camera=camera)
    image = np.full((size[1], size[0], 3), 90, dtype=np.uint8)
    ax = draw_ground_plane(model, image=image)
    ax.figure.savefig(tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 1000


def test_a_model_without_a_plane_is_refused():
    depth = ims.ObjectDepths([5.0], kind="metric", image_size=SIZE)
    model = ims.fit(STREET[:1], depth)
    with pytest.raises(
        ValueError, match=r'ground plane; got a "metric" model without one\. Fit it'
    ):
        draw_ground_plane(model)


@pytest.mark.parametrize(
    ("options", "error", "law"),
    [
        ({"extent_m": -1.0}, ValueError, "`extent_m` must be finite and positive; got -1.0"),
        ({"level": 1.5}, ValueError, "`level` must be above 0 and below 1; got 1.5"),
        ({"camera": 900.0}, TypeError, "`camera` must be a Camera; got float"),
        ({"image": np.zeros((10, 20, 3), np.uint8)}, ValueError, "1280 x 720; got 20 x 10"),
        (
            {"camera": ims.Camera(9.0, focal_rel_std=0.0, image_size=(640, 360))},
            ValueError,
            "`camera.image_size` must be that of the image",
        ),
    ],
)
def test_bad_arguments_are_named(options, error, law):
    with pytest.raises(error, match=law):
        draw_ground_plane(model_of(), **options)


def test_what_is_no_model_is_refused():
    with pytest.raises(TypeError, match="`model` must be a ScaleModel; got str"):
        draw_ground_plane("model")


def test_pyplot_is_not_loaded():
    code = (
        "import sys, imgscale as ims\n"
        "from imgscale.plotting.ground import draw_ground_plane\n"
        "from imgscale.plotting.residuals import draw_residuals\n"
        "from imgscale.plotting.scale_bar import draw_scale_bar\n"
        "from imgscale.plotting.scale_map import draw_scale_map\n"
        "assert 'matplotlib' not in sys.modules\n"
        "ground = ims.GroundPlane(image_size=(640, 480), horizon_px=200., camera_height_m=1.6)\n"
        "model = ims.fit([], ground, camera=ims.Camera(600., focal_rel_std=0.0))\n"
        "draw_ground_plane(model); draw_scale_map(model); draw_residuals(model)\n"
        "draw_scale_bar(model, None, (300, 400))\n"
        "assert 'matplotlib.figure' in sys.modules\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
