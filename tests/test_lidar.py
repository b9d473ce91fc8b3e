"""Points of a laser scanner in the picture: which pixel, which depth, what is left out."""

import os
import re
from pathlib import Path

import attrs
import numpy as np
import pytest

import imgscale as ims
from imgscale.depth_sources import lidar
from imgscale.depth_sources.lidar import LidarDepth, depth_from_points

DATA = Path(
    os.environ.get("IMGSCALE_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data"
)
KITTI = DATA / "kitti" / "object" / "training"
SCANS = sorted((KITTI / "velodyne").glob("*.bin"))

# 8 px focal length, the axis through the middle of a picture of 41 x 21 px
CAMERA = np.array([[8.0, 0, 20, 0], [0, 8.0, 10, 0], [0, 0, 1, 0]])
SIZE = (41, 21)


def filled(depth):
    """Pixels with a depth, as {(column, row): metres}."""
    rows, columns = np.nonzero(np.isfinite(depth.values))
    return {
        (int(column), int(row)): float(depth.values[row, column])
        for row, column in zip(rows, columns, strict=True)
    }


# --- which pixel, which depth ---


def test_a_point_on_the_axis_falls_on_the_principal_point_with_its_z():
    assert filled(depth_from_points([[0, 0, 5]], CAMERA, SIZE)) == {(20, 10): 5.0}


def test_a_point_aside_keeps_its_z_and_not_its_distance():
    # 3-4-5: 4 m ahead and 3 m to the right lie 5 m away
    assert filled(depth_from_points([[3, 0, 4]], CAMERA, SIZE)) == {(26, 10): 4.0}


@pytest.mark.parametrize(
    ("right_m", "column"), [(0.0624, 20), (0.0626, 21), (-0.0624, 20), (-0.0626, 19)]
)
def test_the_pixel_is_the_one_whose_centre_is_nearest(right_m, column):
    assert list(filled(depth_from_points([[right_m, 0, 1]], CAMERA, SIZE))) == [(column, 10)]


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 0, 2)], ids=str)
def test_the_nearest_of_a_pixel_holds_in_any_order(order):
    points = np.array([[0, 0, 9.0], [0, 0, 4.0], [0, 0, 6.0]])[list(order)]
    assert filled(depth_from_points(points, CAMERA, SIZE)) == {(20, 10): 4.0}


def test_the_projection_moves_turns_and_shifts_z():
    # a scanner with x ahead, y to the left and z up, 0.5 m behind the camera
    turn = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, -0.5], [0, 0, 0, 1.0]])
    depth = depth_from_points([[8.5, -1, 1]], CAMERA @ turn, SIZE)
    assert filled(depth) == {(21, 9): 8.0}


def test_what_is_behind_beside_or_not_finite_is_left_out():
    points = [
        [0, 0, 5],
        *([0, 0, -5], [0, 0, 0], [30, 0, 5], [-30, 0, 5], [0, 9, 5], [0, -9, 5]),
        *([np.nan, 0, 5], [0, np.inf, 5], [0, 0, np.inf], [0, 0, -np.inf], [1e308, 0, 1e-300]),
    ]
    assert filled(depth_from_points(points, CAMERA, SIZE)) == {(20, 10): 5.0}


def test_corner_pixels_belong_to_the_picture():
    corners = [(0, 0), (40, 0), (0, 20), (40, 20)]
    points = [[(column - 20) / 8, (row - 10) / 8, 1] for column, row in corners]
    assert set(filled(depth_from_points(points, CAMERA, SIZE))) == set(corners)


def test_agrees_with_a_loop_over_points():
    rng = np.random.default_rng(5)
    points = rng.uniform((-20, -10, -5), (20, 10, 30), size=(3000, 3))
    expected = {}
    for x, y, z in points:
        if z <= 0:
            continue
        pixel = (round(20 + 8 * x / z), round(10 + 8 * y / z))
        if 0 <= pixel[0] < 41 and 0 <= pixel[1] < 21:
            expected[pixel] = min(z, expected.get(pixel, np.inf))
    assert filled(depth_from_points(points, CAMERA, SIZE)) == pytest.approx(expected)


def test_the_map_is_metric_and_of_the_pictures_size_and_the_scan_stays_untouched():
    points = np.array([[0, 0, 5.0]], dtype=np.float32)
    points.flags.writeable = False
    depth = depth_from_points(points, CAMERA, SIZE)
    assert (depth.kind, depth.image_size, depth.scale_rel_std) == ("metric", SIZE, 0.0)
    assert depth.values.shape == (21, 41)


# --- as a depth source ---


def test_a_scan_is_a_depth_source_for_the_picture_taken_with_it():
    source = LidarDepth([[0, 0, 5]], CAMERA)
    assert isinstance(source, ims.DepthSource)
    result = ims.measure(
        np.zeros((21, 41, 3), dtype=np.uint8),
        detector=lambda _: [ims.Detection("door", (15, 5, 25, 15))],
        depth_source=source,
        priors=ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.0)]),
    )
    assert result.model.k == pytest.approx(2.0 / (10 * 5))


def test_a_scan_cannot_be_changed():
    points = np.array([[0, 0, 5.0]])
    source = LidarDepth(points, CAMERA)
    points[0, 2] = 7
    assert filled(source(np.zeros((21, 41, 3), dtype=np.uint8))) == {(20, 10): 5.0}
    with pytest.raises(attrs.exceptions.FrozenInstanceError):
        source.points = points


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int16])
def test_the_arrays_of_a_scan_are_read_only_copies(dtype):
    points, projection = np.array([[0, 0, 5]], dtype=dtype), CAMERA.astype(dtype)
    source = LidarDepth(points, projection)
    for ours, given in ((source.points, points), (source.projection, projection)):
        assert not np.shares_memory(ours, given)
        with pytest.raises(ValueError, match="read-only"):
            ours[0, 2] = 7


def test_a_scan_is_checked_once(monkeypatch):
    source = LidarDepth([[0, 0, 5]], CAMERA)
    monkeypatch.setattr(lidar, "own_floats", None)
    assert filled(source(np.zeros((21, 41, 3), dtype=np.uint8))) == {(20, 10): 5.0}


# --- what is refused ---


@pytest.mark.parametrize(
    ("points", "message"),
    [
        pytest.param(np.ones((5, 4)), "(5, 4). Leave out what is not x, y, z", id="reflectance"),
        pytest.param(np.ones((5, 2)), "shape (N, 3); got (5, 2)", id="two columns"),
        pytest.param(np.ones(3), "shape (N, 3) and hold something; got (3,)", id="one point"),
        pytest.param(np.empty((0, 3)), "hold something; got (0, 3)", id="none"),
        pytest.param([[1, 2, 3], [1, 2]], "rows of unequal length", id="ragged"),
        pytest.param([[0, 0, -5]], "of 1 points 0 are ahead of the camera", id="behind"),
        pytest.param([[50, 0, 5]], "of 1 points 1 are ahead of the camera", id="beside"),
        pytest.param(np.full((2, 3), np.nan), "of 2 points 0 are ahead", id="not finite"),
    ],
)
def test_points_that_give_no_depth_are_refused(points, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        depth_from_points(points, CAMERA, SIZE)


@pytest.mark.parametrize(
    ("projection", "message"),
    [
        pytest.param(np.eye(4), "shape (3, 4) and finite numbers; got shape (4, 4)", id="4 x 4"),
        pytest.param(CAMERA[:, :3], "got shape (3, 3)", id="without translation"),
        pytest.param(CAMERA * np.nan, "got a number that is not", id="not finite"),
        pytest.param(CAMERA * 2, "length 1; got 2. Divide the matrix by it", id="scaled"),
        pytest.param(CAMERA * 0, "length 1; got 0", id="zero"),
    ],
)
def test_matrices_that_give_no_metres_are_refused(projection, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        depth_from_points([[0, 0, 5]], projection, SIZE)
    with pytest.raises(ValueError, match=re.escape(message)):
        LidarDepth([[0, 0, 5]], projection)


def test_no_numbers_and_no_picture_are_refused():
    with pytest.raises(TypeError, match="`points` must hold real numbers"):
        depth_from_points([["a", "b", "c"]], CAMERA, SIZE)
    with pytest.raises(ValueError, match="`image_size` must be"):
        depth_from_points([[0, 0, 5]], CAMERA, (0, 21))


# --- KITTI's scans ---


@pytest.mark.skipif(not SCANS, reason=f"no LiDAR scans in {KITTI}")
@pytest.mark.parametrize("path", SCANS, ids=lambda path: path.stem)
def test_projects_kittis_scans_as_the_maps_derived_from_them(path):
    from PIL import Image  # noqa: PLC0415 - only where the data are

    calibration = dict(
        line.split(":", 1)
        for line in (KITTI / "calib" / f"{path.stem}.txt").read_text().splitlines()
        if line
    )
    numbers = {key: np.array(text.split(), dtype=float) for key, text in calibration.items()}
    rectify, transform = np.eye(4), np.eye(4)
    rectify[:3, :3] = numbers["R0_rect"].reshape(3, 3)
    transform[:3] = numbers["Tr_velo_to_cam"].reshape(3, 4)
    projection = numbers["P2"].reshape(3, 4) @ rectify @ transform
    with Image.open(KITTI / "lidar_depth" / f"{path.stem}.png") as image:
        expected = np.asarray(image) / 256.0
    points = np.fromfile(path, dtype=np.float32).reshape(-1, 4)[:, :3]
    depth = depth_from_points(points, projection, expected.shape[::-1]).values
    # the same 18 600 and 17 110 pixels, and no depth off by more than its rounding
    assert np.array_equal(np.isfinite(depth), expected > 0)
    seen = expected > 0
    assert 0.03 < seen.mean() < 0.05
    assert np.abs(depth[seen] - expected[seen]).max() <= 0.5 / 256 + 1e-6
