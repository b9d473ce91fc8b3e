"""Extents of regions: closed forms, predict, scikit-image, slanted and polluted surfaces."""

import math

import attrs
import numpy as np
import pytest
import skimage as ski
from hypothesis import given, settings
from hypothesis import strategies as st

import imgscale as ims
from imgscale import Flag
from imgscale.datasets import motorcycle
from imgscale.measuring import Extent, Quantity, extent, regionprops_table

SIZE = (640, 480)
WIDTH, HEIGHT = SIZE
FOCAL, BASELINE, UNIT = 800.0, 0.3, 3.7
EXACT = ims.Noise(box_px=0.0, box_rel=0.0, depth_rel=0.0)
TOLD = ims.Noise(box_px=1.0, depth_rel=0.02)
CAMERA = ims.Camera(FOCAL, focal_rel_std=0.0, image_size=SIZE)
TO_KIND = {
    "metric": lambda z: z,
    "relative": lambda z: UNIT * z,
    "inverse": lambda z: FOCAL * BASELINE / z,
    "affine_inverse": lambda z: FOCAL * BASELINE / z - 17.0,
}
SLACK = 1e-6  # pixels, what is lost in floating point
BOARDS = [("door", 4.0, 2.0, 20.0), ("hatch", 8.0, 1.0, 300.0)]


def fitted(kind="relative", *, noise=EXACT, std=0.0, camera=CAMERA, method="posterior"):
    detections = [
        ims.Detection(label, (left, 50.0, left + 40, 50 + FOCAL * size / z))
        for label, z, size, left in BOARDS
    ]
    values = TO_KIND[kind](np.array([z for _, z, _, _ in BOARDS]))
    priors = ims.PriorTable([ims.ObjectPrior(label, size, std) for label, _, size, _ in BOARDS])
    depths = ims.ObjectDepths(values, kind=kind, image_size=SIZE)
    return ims.fit(detections, depths, priors, noise=noise, camera=camera, method=method)


def flat(kind, z=5.0):
    return ims.DepthMap(TO_KIND[kind](np.full((HEIGHT, WIDTH), z)), kind=kind)


def grid():
    rows, columns = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    return columns, rows


def disc(x, y, diameter):
    columns, rows = grid()
    return (columns - x) ** 2 + (rows - y) ** 2 < (diameter / 2) ** 2


def corners(x, y, length, breadth, angle):
    """A rectangle about (x, y)."""
    along = np.array([math.cos(angle), math.sin(angle)])
    across = np.array([-along[1], along[0]])
    signs = [(1, 1), (-1, 1), (-1, -1), (1, -1)]
    return np.array([
        (x, y) + a * length / 2 * along + b * breadth / 2 * across for a, b in signs
    ])  # fmt: skip


def filled(polygon):
    return ski.draw.polygon2mask((HEIGHT, WIDTH), np.asarray(polygon)[:, ::-1] - 0.5)


# --- closed forms ------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["posterior", "robust"])
@pytest.mark.parametrize("kind", TO_KIND)
def test_a_rotated_rectangle_has_its_closed_forms(kind, method):
    length, breadth, angle, scale = 200.0, 80.0, 0.4, 5.0 / FOCAL
    found = extent(
        fitted(kind, method=method), corners(320.3, 200.7, length, breadth, angle), flat(kind)
    )
    cos, sin = math.cos(angle), math.sin(angle)
    expected = {
        "height": length * sin + breadth * cos,
        "width": length * cos + breadth * sin,
        "longest": math.hypot(length, breadth),
    }
    for name, pixels in expected.items():
        assert getattr(found, name).value == pytest.approx(pixels * scale, rel=1e-9)
        assert getattr(found, name).unit == "m"
    assert found.area.value == pytest.approx(length * breadth * scale**2, rel=1e-9)
    assert found.area.unit == "m2"
    assert found.metres_per_pixel == pytest.approx(scale, rel=1e-9)
    assert found.distance_m == pytest.approx(5.0, rel=1e-9)
    assert found.flags == Flag(0) or found.flags == Flag.EXTRAPOLATED


def test_a_rectangle_of_pixels_has_its_closed_forms():
    mask = np.zeros((HEIGHT, WIDTH), dtype=np.bool_)
    mask[100:140, 200:230] = True
    found, scale = extent(fitted(), mask, flat("relative")), 5.0 / FOCAL
    assert found.height.value == pytest.approx(40 * scale, rel=1e-9)
    assert found.width.value == pytest.approx(30 * scale, rel=1e-9)
    assert found.longest.value == pytest.approx(50 * scale, rel=1e-9)
    assert found.area.value == pytest.approx(1200 * scale**2, rel=1e-9)


@pytest.mark.parametrize("diameter", [10.0, 40.0, 160.0])
def test_a_disc_has_its_diameter_and_area_within_its_pixels(diameter):
    scale = 5.0 / FOCAL
    for shift in (0.0, 0.3, 0.5):
        mask = disc(300 + shift, 200 - shift, diameter)
        found = extent(fitted(), mask, flat("relative"))
        longest_px = found.longest.value / scale
        assert 0.0 < longest_px - diameter < 1.5
        assert found.area.value == pytest.approx(mask.sum() * scale**2, rel=1e-9)
        assert found.area.value / scale**2 == pytest.approx(
            math.pi * diameter**2 / 4, abs=2 * math.sqrt(math.pi * diameter)
        )


@pytest.mark.parametrize("seed", range(5))
def test_the_longest_extent_is_scikit_images_feret_diameter_to_its_pixels(seed):
    rng = np.random.default_rng(seed)
    mask = np.zeros((HEIGHT, WIDTH), dtype=np.bool_)
    mask[100:300, 100:300] = ski.morphology.dilation(
        rng.random((200, 200)) < 0.0003, ski.morphology.disk(12)
    )
    props = ski.measure.regionprops(mask.astype(np.uint8))[0]
    found, scale = extent(fitted(), mask, flat("relative")), 5.0 / FOCAL
    assert found.longest.value / scale == pytest.approx(props.feret_diameter_max, abs=1.5)
    assert found.area.value / scale**2 == pytest.approx(props.area, rel=1e-9)
    points = np.argwhere(mask)
    brute = max(
        math.dist(a, b)
        for a in points[:: max(1, len(points) // 150)]
        for b in points[:: max(1, len(points) // 150)]
    )
    assert brute <= found.longest.value / scale


@settings(max_examples=25, deadline=None)
@given(
    st.floats(120, 500), st.floats(120, 360), st.floats(30, 180), st.floats(20, 60),
    st.floats(0, 3.14),
)  # fmt: skip
def test_a_polygon_and_its_pixels_measure_alike(x, y, length, breadth, angle):
    polygon, model, depth = corners(x, y, length, breadth, angle), fitted(), flat("relative")
    outlined, counted = (extent(model, region, depth) for region in (polygon, filled(polygon)))
    pixel = 5.0 / FOCAL

    def excess(name, power=1):
        return (getattr(counted, name).value - getattr(outlined, name).value) / pixel**power

    # Rows and columns that cut a right-angled corner farther than 1 / 2 px behind its tip cut it in
    # more than 1 px: the last centre is 0 to 3 / 2 px behind, the end of its pixel 1 / 2 px beyond.
    for name in ("height", "width"):
        assert -2 - SLACK <= excess(name) <= 1 + SLACK
    # A disc of radius sqrt(1 / 2) holds a centre, also that which touches a corner's sides, 1 px
    # behind the tip: a centre is 0 to 1 + sqrt(1 / 2) px behind, and its pixel reaches 1 / 2 to
    # sqrt(1 / 2) px beyond it. Twice, for there are two ends.
    assert -1 - math.sqrt(2) - SLACK <= excess("longest") <= math.sqrt(2) + SLACK
    # Nosarzewska's law: lattice points in a convex set against its area and half its perimeter.
    assert -SLACK <= excess("area", 2) + length + breadth <= 2 * (length + breadth) + 1 + SLACK
    # the order of the corners and where they begin do not matter
    again = extent(model, np.roll(polygon[::-1], 1, axis=0), depth)
    assert again.area.value == pytest.approx(outlined.area.value, rel=1e-9)
    assert again.longest.value == pytest.approx(outlined.longest.value, rel=1e-9)


def test_a_hole_is_no_area_and_parts_add_up():
    ring = disc(300, 200, 120) & ~disc(300, 200, 60)
    model, depth = fitted(), flat("relative")
    whole, hole = (extent(model, mask, depth) for mask in (ring, disc(300, 200, 60)))
    filled_area = extent(model, disc(300, 200, 120), depth).area.value
    assert whole.area.value + hole.area.value == pytest.approx(filled_area, rel=1e-9)


# --- beside predict ----------------------------------------------------------------------------


def same(quantity, estimate):
    assert quantity.value == pytest.approx(estimate.size_m, rel=1e-12)
    assert quantity.std == pytest.approx(estimate.std_m, rel=1e-9)
    assert quantity.interval(0.9) == pytest.approx(estimate.interval(0.9), rel=1e-9)
    assert quantity.flags == estimate.flags


@pytest.mark.parametrize("noise", [TOLD, ims.Noise()], ids=["told", "unknown"])
@pytest.mark.parametrize("kind", TO_KIND)
def test_height_and_width_are_those_of_predict(kind, noise):
    rng = np.random.default_rng(2)
    values = TO_KIND[kind](5.0 * np.exp(0.02 * rng.normal(size=(HEIGHT, WIDTH))))
    depth, model = ims.DepthMap(values, kind=kind), fitted(kind, noise=noise, std=0.05)
    mask = disc(320, 200, 90) | disc(350, 260, 50)
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    box = (columns[0], rows[0], columns[-1] + 1, rows[-1] + 1)
    detection = ims.Detection("thing", box, mask=mask)
    found = extent(model, mask, depth)
    for axis in ("height", "width"):
        same(getattr(found, axis), ims.predict(model, [detection], depth, axis=axis)[0])
    size = ims.predict(model, [detection], depth)[0]
    assert found.metres_per_pixel == pytest.approx(size.metres_per_pixel, rel=1e-12)
    assert (found.depth, found.distance_m) == (size.depth, pytest.approx(size.distance_m))


@pytest.mark.parametrize("pitch_deg", [-10.0, 25.0])
def test_a_tilt_is_corrected_as_by_predict_and_the_area_with_it(pitch_deg):
    model = fitted(camera=attrs.evolve(CAMERA, pitch_deg=pitch_deg), noise=TOLD, std=0.02)
    mask = np.zeros((HEIGHT, WIDTH), dtype=np.bool_)
    mask[300:400, 200:260] = True
    detection = ims.Detection("thing", (200, 300, 260, 400), mask=mask)
    found = extent(model, mask, flat("relative"))
    for axis in ("height", "width"):
        same(getattr(found, axis), ims.predict(model, [detection], flat("relative"), axis=axis)[0])
    assert found.area.value == pytest.approx(found.height.value * found.width.value, rel=1e-9)
    assert found.longest.value == pytest.approx(
        math.hypot(found.height.value, found.width.value), rel=1e-9
    )


def test_on_a_ground_plane_the_lowest_row_is_the_foot():
    boxes = {
        "door": (100, 180, 160, 420),
        "hatch": (300, 220, 360, 300),
        "gate": (500, 60, 540, 300),
    }
    detections = [ims.Detection(label, box) for label, box in boxes.items()]
    priors = ims.PriorTable(
        [ims.ObjectPrior("door", 2.0, 0.05), ims.ObjectPrior("hatch", 1.0, 0.05)]
    )
    model = ims.fit(detections, ims.GroundPlane(image_size=SIZE), priors, camera=CAMERA)
    mask = np.zeros((HEIGHT, WIDTH), dtype=np.bool_)
    mask[100:350, 400:450] = True
    detection = ims.Detection("thing", (400, 100, 450, 350), mask=mask)
    found = extent(model, mask)
    for axis in ("height", "width"):
        same(getattr(found, axis), ims.predict(model, [detection], axis=axis)[0])
    assert found.area.value == pytest.approx(found.height.value * found.width.value, rel=1e-9)


def test_a_second_witness_of_distance_is_heard_as_by_predict():
    depth, ground = flat("relative"), ims.GroundPlane(image_size=SIZE)
    detections = [
        ims.Detection("door", (20, 50, 60, 450)), ims.Detection("hatch", (300, 250, 340, 350))
    ]  # fmt: skip
    priors = ims.PriorTable(
        [ims.ObjectPrior("door", 2.0, 0.1), ims.ObjectPrior("hatch", 0.6, 0.05)]
    )
    model = ims.fit(detections, depth, priors, ground=ground)
    mask = np.zeros((HEIGHT, WIDTH), dtype=np.bool_)
    mask[300:400, 200:260] = True
    detection = ims.Detection("thing", (200, 300, 260, 400), mask=mask)
    same(extent(model, mask, depth).height, ims.predict(model, [detection], depth)[0])


# --- which depth -------------------------------------------------------------------------------


def slanted_board(kind, angle_deg):
    """A board of 3 x 1.6 m turned about the vertical: its mask, its map and its silhouette."""
    columns, rows = grid()
    tangent = math.tan(math.radians(angle_deg))
    u, v = (columns - WIDTH / 2) / FOCAL, (rows - HEIGHT / 2) / FOCAL
    z = 6.0 / (1 - u * tangent)
    mask = (np.abs(u * z) < 1.5 * math.cos(math.radians(angle_deg))) & (np.abs(v * z) < 0.8)
    values = np.where(mask, z, 15.0)
    return mask, ims.DepthMap(TO_KIND[kind](values), kind=kind)


@pytest.mark.parametrize("kind", TO_KIND)
@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 60.0])
def test_the_area_of_a_slanted_board_is_that_of_its_silhouette(angle_deg, kind):
    mask, depth = slanted_board(kind, angle_deg)
    found = extent(fitted(kind), mask, depth)
    silhouette = 3.0 * 1.6 * math.cos(math.radians(angle_deg))
    # the integral of (Z / f)^2 over the picture is that of Z0 / Z over the silhouette
    depth_share = 1.5 * math.sin(math.radians(angle_deg)) / 6.0
    turned = math.atanh(depth_share) / depth_share if angle_deg else 1.0
    # up to half a pixel along an outline of 900 px, around 60 000 of them
    assert found.area.value == pytest.approx(silhouette * turned, rel=0.008)
    in_one_plane = found.height.value * found.width.value
    if angle_deg == 60.0:
        assert abs(in_one_plane / silhouette - 1) > 0.05


@pytest.mark.parametrize("kind", TO_KIND)
@pytest.mark.parametrize("share", [0.05, 0.2])
def test_background_in_the_mask_does_not_blow_the_area_up(share, kind):
    rng = np.random.default_rng(1)
    mask, depth = slanted_board(kind, 30.0)
    truth = extent(fitted(kind), mask, depth).area.value
    values = depth.values.copy()
    edge = mask & (grid()[0] > np.quantile(grid()[0][mask], 1 - share))
    values[edge] = TO_KIND[kind](15.0)
    scattered = mask & (rng.random(mask.shape) < 0.02)
    values[scattered] = TO_KIND[kind](40.0)
    found = extent(fitted(kind), mask, ims.DepthMap(values, kind=kind)).area.value
    assert found == pytest.approx(truth, rel=0.06 if share > 0.1 else 0.02)
    as_they_are = float(((ims.ScaleModel.metres_per_pixel(fitted(kind), values)[mask]) ** 2).sum())
    assert as_they_are > 1.15 * truth


@pytest.mark.parametrize("missing", [0.1, 0.6])
def test_pixels_without_depth_count_with_their_neighbours(missing):
    rng = np.random.default_rng(4)
    mask, depth = slanted_board("metric", 45.0)
    truth = extent(fitted("metric"), mask, depth).area.value
    values = depth.values.copy()
    values[rng.random(mask.shape) < missing] = np.nan
    holed = extent(fitted("metric"), mask, ims.DepthMap(values, kind="metric")).area.value
    assert holed == pytest.approx(truth, rel=0.002)


def test_a_map_of_a_quarter_of_the_size_measures_alike():
    model = fitted("metric")
    small = ims.DepthMap(np.full((120, 160), 5.0), kind="metric", image_size=SIZE)
    large = flat("metric")
    mask = disc(320, 200, 91)
    for name in ("height", "width", "longest", "area"):
        a, b = (getattr(extent(model, mask, depth), name).value for depth in (small, large))
        assert a == pytest.approx(b, rel=1e-9)


def test_one_depth_of_an_object_serves():
    depths = ims.ObjectDepths([5.0 * UNIT], kind="relative")
    found = extent(fitted(), corners(320, 200, 200, 80, 0.4), depths)
    assert found.area.value == pytest.approx(200 * 80 * (5 / FOCAL) ** 2, rel=1e-9)


def test_reservations_are_flagged():
    cut, bare = (np.zeros((HEIGHT, WIDTH), dtype=np.bool_) for _ in range(2))
    cut[0:50, 200:260] = True
    values = np.full((HEIGHT, WIDTH), 5.0 * UNIT)
    values[:, 400:] = np.nan
    values[200:300, 100:150] = 20.0 * UNIT
    bare[100:150, 450:500] = True
    depth, model = ims.DepthMap(values, kind="relative"), fitted()
    assert Flag.PARTIAL in extent(model, cut, depth).flags
    mixed = np.zeros_like(cut)
    mixed[200:300, 100:200] = True
    assert Flag.MIXED_DEPTH in extent(model, mixed, depth).flags
    nothing = extent(model, bare, depth)
    assert Flag.NO_DEPTH in nothing.flags
    assert math.isnan(nothing.area.value)
    assert math.isnan(nothing.longest.value)
    assert math.isnan(nothing.metres_per_pixel)
    assert str(nothing).startswith("height unknown, width unknown")


# --- intervals ---------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["relative", "affine_inverse"])
def test_the_90_percent_intervals_hold_nine_truths_of_ten(kind):
    rng, count = np.random.default_rng(6), 250
    hits = dict.fromkeys(("height", "width", "longest", "area"), 0)
    noise = ims.Noise(box_px=1.5, depth_rel=0.02)
    boards = [*BOARDS, ("board", 6.0, 1.5, 400.0)]
    priors = ims.PriorTable([ims.ObjectPrior(label, s, 0.03 * s) for label, _, s, _ in boards])
    for _ in range(count):
        errors = 0.02 * rng.normal(size=4)
        sizes = [s * math.exp(0.03 * rng.normal()) for _, _, s, _ in boards]
        detections = [
            ims.Detection(label, (left, 10, left + 40, 10 + FOCAL * s / z + 1.5 * rng.normal()))
            for (label, z, _, left), s in zip(boards, sizes, strict=True)
        ]
        seen = TO_KIND[kind](np.array([4.0, 8.0, 6.0, 5.0]) * np.exp(errors))
        depths = ims.ObjectDepths(seen[:3], kind=kind, image_size=SIZE)
        model = ims.fit(detections, depths, priors, noise=noise)
        # an outline whose four edges err by their half of the box's error
        half = np.array([60.0, 40.0])
        low, high = (1.5 / math.sqrt(2) * rng.normal(size=2) for _ in range(2))
        (x1, y1), (x2, y2) = 300 - half + low, 300 + half + high
        polygon = [(x1, y1), (x2, y1), (x2, y2), (x1, y2)]
        depth = ims.DepthMap(np.full((HEIGHT, WIDTH), seen[3]), kind=kind)
        found, scale = extent(model, polygon, depth), 5.0 / FOCAL
        truth = {
            "height": 80 * scale,
            "width": 120 * scale,
            "longest": math.hypot(80, 120) * scale,
            "area": 80 * 120 * scale**2,
        }
        for name, size in truth.items():
            low_end, high_end = getattr(found, name).interval(0.9)
            hits[name] += low_end <= size <= high_end
    for name, hit in hits.items():
        assert 0.86 <= hit / count <= 0.97, name


def test_the_interval_of_an_area_is_that_of_a_length_squared_plus_its_outline():
    noise = ims.Noise(box_px=0.0, depth_rel=0.02)
    found = extent(fitted(noise=noise, std=0.05), disc(320, 200, 90), flat("relative"))
    height, area = found.height, found.area
    for end, side in zip(area.interval(0.9), height.interval(0.9), strict=True):
        assert end / area.value == pytest.approx((side / height.value) ** 2, rel=1e-6)
    outlined = ims.Noise(box_px=2.0, depth_rel=0.0)
    sharp = extent(fitted(noise=outlined), corners(320, 200, 200, 80, 0.0), flat("relative")).area
    # with k fitted by boards of 400 and 100 px
    own = 2.0 * 560 / (2 * 200 * 80)
    assert own < sharp.std / sharp.value < math.hypot(own, 2 * 2.0 / 100)


# --- the motorcycle ----------------------------------------------------------------------------


def test_the_front_rims_disc_has_the_area_of_its_diameter():
    scene = motorcycle.load()
    model = ims.fit(scene.detections, scene.depth, scene.priors, noise=scene.noise)
    rim = next(d for d in scene.detections if d.label == "front rim")
    x1, y1, x2, y2 = rim.xyxy
    turns = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    ellipse = np.column_stack([
        (x1 + x2) / 2 + (x2 - x1) / 2 * np.cos(turns), (y1 + y2) / 2 + (y2 - y1) / 2 * np.sin(turns)
    ])  # fmt: skip
    found = extent(model, ellipse, scene.depth)
    # 18 inch at the lip, 0.485 m; the steered wheel shows it narrowed, cos A = width / height
    low, high = found.height.interval(0.9)
    assert low < 0.485 < high
    silhouette = math.pi * 0.485**2 / 4 * rim.width_px / rim.height_px
    low, high = found.area.interval(0.9)
    assert low < silhouette < high


# --- tables ------------------------------------------------------------------------------------


def labelled():
    labels = np.zeros((HEIGHT, WIDTH), dtype=np.int32)
    labels[100:140, 200:230] = 3
    labels[disc(400, 300, 80)] = 7
    labels[0:20, 10:40] = 12
    return labels


def test_every_region_is_a_row_with_its_extents():
    model, depth, labels = fitted(noise=TOLD, std=0.05), flat("relative"), labelled()
    table = regionprops_table(model, labels, depth, unit="cm", level=0.8)
    assert table["label"].tolist() == [3, 7, 12]
    pixels = ski.measure.regionprops_table(labels, properties=("label", "bbox", "centroid"))
    for name, column in pixels.items():
        np.testing.assert_array_equal(table[name], column)
    for row, label in enumerate(table["label"]):
        found = extent(model, labels == label, depth)
        for name, power in (("height", 1), ("width", 1), ("longest", 1), ("area", 2)):
            quantity, suffix = getattr(found, name), "cm" if power == 1 else "cm2"
            low, high = quantity.interval(0.8)
            expected = (quantity.value, low, high)
            keys = (f"{name}_{suffix}", f"{name}_low_{suffix}", f"{name}_high_{suffix}")
            for key, number in zip(keys, expected, strict=True):
                assert table[key][row] == pytest.approx(number * 100**power, rel=1e-9)
        assert table["distance_m"][row] == pytest.approx(found.distance_m)
    assert table["flags"].tolist() == ["", "", "PARTIAL"]
    assert {len(column) for column in table.values()} == {3}


def test_further_properties_are_scikit_images():
    table = regionprops_table(
        fitted(), labelled(), flat("relative"), properties=("label", "area", "solidity")
    )
    expected = ski.measure.regionprops_table(labelled(), properties=("area", "solidity"))
    np.testing.assert_array_equal(table["area"], expected["area"])
    np.testing.assert_array_equal(table["solidity"], expected["solidity"])


def test_an_image_without_regions_gives_an_empty_table():
    table = regionprops_table(fitted(), np.zeros((HEIGHT, WIDTH), dtype=int), flat("relative"))
    assert {len(column) for column in table.values()} == {0}
    assert "area_m2" in table


def test_each_region_may_have_its_own_depth():
    depths = ims.ObjectDepths([5.0 * UNIT, 10.0 * UNIT, math.nan], kind="relative")
    table = regionprops_table(fitted(), labelled(), depths)
    assert table["height_m"][:2] == pytest.approx([40 * 5 / FOCAL, 80 * 10 / FOCAL])
    assert math.isnan(table["height_m"][2])
    with pytest.raises(ValueError, match="one value per region, 3; got 2"):
        regionprops_table(fitted(), labelled(), ims.ObjectDepths([1.0, 2.0], kind="relative"))


# --- results -----------------------------------------------------------------------------------


def test_quantities_print_and_compare():
    length = Quantity(value=1.234, std=0.04, unit="m", flags=Flag.MIXED_DEPTH | Flag.PARTIAL)
    assert str(length) == "1.23 +- 0.04 m (MIXED_DEPTH, PARTIAL)"
    unknown = Quantity(value=math.nan, std=math.nan, unit="m2")
    assert unknown == Quantity(value=math.nan, std=math.nan, unit="m2")
    assert all(math.isnan(end) for end in unknown.interval())
    assert str(Quantity(value=2.0, std=math.inf, unit="m")) == "2 +- inf m"
    with pytest.raises(attrs.exceptions.FrozenInstanceError):
        length.value = 2.0
    with pytest.raises(ValueError, match="`level` must be above 0 and below 1"):
        length.interval(1.0)


def test_an_extent_prints_its_four_quantities():
    found = extent(fitted(noise=TOLD), corners(320, 200, 200, 80, 0.0), flat("relative"))
    assert isinstance(found, Extent)
    assert str(found).count("+-") == 4


# --- refusals ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("region", "error", "text"),
    [
        pytest.param(np.zeros((HEIGHT, WIDTH), dtype=bool), ValueError, "empty mask", id="empty"),
        pytest.param(np.ones((20, 30), dtype=bool), ValueError, "shape of the image", id="shape"),
        pytest.param(np.ones((HEIGHT, WIDTH)), TypeError, "mask > 0", id="numbers"),
        pytest.param([(1, 1), (2, 2)], ValueError, "three corners", id="two corners"),
        pytest.param(
            [(1, 1), (20, 1), (math.nan, 9)], ValueError, "all finite", id="not finite"
        ),
        pytest.param([(1, 1), (20, 20), (40, 40)], ValueError, "enclose an area", id="a line"),
        pytest.param(
            [(10, 10), (200, 200), (200, 10), (10, 180)], ValueError, "cross itself", id="bow tie"
        ),
        pytest.param([(10, 10), (700, 10), (10, 90)], ValueError, "in the image", id="outside"),
        pytest.param(
            [[1, 2], [3]], ValueError, "rows of unequal length", id="ragged"
        ),
    ],
)  # fmt: skip
def test_what_is_no_region_is_refused(region, error, text):
    with pytest.raises(error, match=text):
        extent(fitted(), region, flat("relative"))


@pytest.mark.parametrize(
    ("labels", "error", "text"),
    [
        (np.ones((HEIGHT, WIDTH), dtype=bool), TypeError, r"skimage\.measure\.label"),
        (np.ones((10, 10), dtype=int), ValueError, "shape of the image"),
        (np.full((HEIGHT, WIDTH), -1), ValueError, "no negative label"),
    ],
)
def test_what_is_no_label_image_is_refused(labels, error, text):
    with pytest.raises(error, match=text):
        regionprops_table(fitted(), labels, flat("relative"))


def test_unknown_properties_and_units_are_refused():
    with pytest.raises(ValueError, match="`properties` must name properties of skimage"):
        regionprops_table(fitted(), labelled(), flat("relative"), properties=("label", "colour"))
    with pytest.raises(ValueError, match="`properties` must name properties of skimage"):
        regionprops_table(fitted(), labelled(), flat("relative"), properties=("intensity_mean",))
    with pytest.raises(ValueError, match="`unit` must be"):
        regionprops_table(fitted(), labelled(), flat("relative"), unit="yard")


def test_a_missing_depth_is_named():
    with pytest.raises(ValueError, match="`depth` is missing"):
        extent(fitted(), disc(300, 200, 40))


# --- what is refused or read with care ----------------------------------------------------------


def star(points=5, turns=2):
    angles = 2 * math.pi * turns * np.arange(points) / points
    return np.column_stack([200 + 100 * np.sin(angles), 200 - 100 * np.cos(angles)])


@pytest.mark.parametrize("knows_size", [True, False])
@pytest.mark.parametrize(
    "polygon",
    [
        [(10, 10), (100, 10), (100, 100), (10, 100)] * 2,
        star(),
        [(10, 10), (300, 300), (300, 200), (10, 60)],
        [(100, 100), (300, 100), (300, 100.002), (100, 100.002)],
    ],
    ids=["twice round", "pentagram", "bow tie", "sliver"],
)
def test_polygons_that_enclose_no_area_once_are_refused(polygon, knows_size):
    depth = flat("relative")
    model = fitted()
    if not knows_size:
        depth = ims.ObjectDepths([UNIT * 5.0], kind="relative")
        model = ims.fit([ims.Detection("door", (20, 50, 60, 450))], depth)
    with pytest.raises(ValueError, match="`mask_or_polygon` must enclose an area, a pixel high"):
        extent(model, polygon, depth)


@pytest.mark.parametrize("reach", [(-5.0, 10.0), (1e200, 10.0), (645.0, 10.0)])
def test_a_polygon_beyond_the_picture_is_named(reach):
    with pytest.raises(ValueError, match="`mask_or_polygon` must lie in the image, 640 x 480 px"):
        extent(fitted(), [reach, (50, 10), (50, 200)], flat("relative"))


def test_a_polygon_along_the_whole_border_is_measured():
    whole = extent(fitted(), [(0, 0), (WIDTH, 0), (WIDTH, HEIGHT), (0, HEIGHT)], flat("relative"))
    assert whole.width.value == pytest.approx(WIDTH * 5.0 / FOCAL, rel=1e-9)
    assert Flag.PARTIAL in whole.flags


def test_a_region_of_one_pixel_in_the_first_corner_is_one_of_the_table():
    labels = np.zeros((HEIGHT, WIDTH), dtype=int)
    labels[100:150, 300:320], labels[0, 0] = 1, 2
    table = regionprops_table(fitted(), labels, flat("relative"))
    np.testing.assert_allclose(table["height_m"], np.array([50, 1]) * 5.0 / FOCAL)


def test_labels_of_any_size_are_kept_and_take_no_memory():
    labels = np.zeros((HEIGHT, WIDTH), dtype=np.uint64)
    labels[100:150, 300:320], labels[200:240, 50:90] = 7, 2**63 + 5
    table = regionprops_table(fitted(), labels, flat("relative"))
    assert table["label"].tolist() == [7, 2**63 + 5]
    labels[labels == 0] = 3
    everything = regionprops_table(fitted(), labels, flat("relative"))
    assert everything["label"].tolist() == [3, 7, 2**63 + 5]


@pytest.mark.parametrize("properties", [None, "area", 3])
def test_properties_are_names(properties):
    labels = np.zeros((HEIGHT, WIDTH), dtype=int)
    with pytest.raises(
        TypeError, match=r"`properties` must be a sequence of (names|str objects); got"
    ):
        regionprops_table(fitted(), labels, flat("relative"), properties=properties)


@pytest.mark.parametrize(
    ("value", "std", "ends"),
    [(0.0, 0.0, (0.0, 0.0)), (2.0, 0.0, (2.0, 2.0)), (1e-3, 10.0, (0.0, math.inf))],
)
def test_intervals_of_extreme_quantities_are_no_errors(value, std, ends):
    assert Quantity(value=value, std=std, unit="m").interval() == ends


@pytest.mark.parametrize("share", [0.1, 0.2, 0.3, 0.35, 0.45])
def test_a_mask_on_two_surfaces_says_so_from_a_quarter_on(share):
    values = np.full((HEIGHT, WIDTH), UNIT * 5.0)
    values[:, 300:] = UNIT * 10.0
    mask = np.zeros((HEIGHT, WIDTH), dtype=np.bool_)
    mask[200:240, 300 - round(100 * (1 - share)) : 300 + round(100 * share)] = True
    found = extent(fitted(), mask, ims.DepthMap(values, kind="relative"))
    for quantity in (found.height, found.width, found.longest, found.area):
        assert (Flag.MIXED_DEPTH in quantity.flags) == (share > 0.25)


@pytest.mark.parametrize("angle_deg", [0.0, 20.0, 45.0, 60.0])
def test_a_slanted_surface_is_mixed_only_where_predict_says_so(angle_deg):
    mask, depth = slanted_board("relative", angle_deg)
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    box = (columns[0], rows[0], columns[-1] + 1, rows[-1] + 1)
    [size] = ims.predict(fitted(), [ims.Detection("board", box, mask=mask)], depth)
    found = extent(fitted(), mask, depth)
    assert (Flag.MIXED_DEPTH in found.flags) == (Flag.MIXED_DEPTH in size.flags)


@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_an_outline_that_errs_outward_moves_the_diagonal_as_it_is(angle):
    # half a pixel outward on every side of a rectangle of 200 x 80 px, k known exactly
    longest_px = math.hypot(200, 80)
    grown = math.hypot(200.001, 80.001) - longest_px
    depth, noise = flat("metric"), ims.Noise(box_px=2.0, box_rel=0.0, depth_rel=0.0)
    known = ims.Camera(FOCAL, focal_rel_std=1e-9, image_size=SIZE)
    found = extent(
        fitted("metric", noise=noise, camera=known), corners(320, 200, 200, 80, angle), depth
    )
    error = found.longest.std / found.longest.value
    assert error == pytest.approx(2.0 * grown / 0.001 / longest_px, rel=1e-3)


def test_a_disc_errs_in_its_longest_extent_by_no_less_than_its_width():
    found = extent(fitted(noise=TOLD), disc(320, 200, 90), flat("relative"))
    assert found.width.std <= found.longest.std <= 1.6 * found.width.std


def test_several_depths_of_one_region_are_refused():
    with pytest.raises(ValueError, match="`depth` must hold one value, that of the region; got 2"):
        extent(fitted(), disc(320, 200, 90), ims.ObjectDepths([1.0, 2.0], kind="relative"))


def test_a_contour_of_opencv_is_told_its_remedy():
    contour = corners(320, 200, 200, 80, 0.0).astype(np.int32)[:, None]
    with pytest.raises(TypeError, match=r"Take the middle axis out .* contour\[:, 0\]"):
        extent(fitted(), contour, flat("relative"))
    assert extent(fitted(), contour[:, 0], flat("relative")).area.value > 0


def test_what_lies_under_a_mask_of_numpy_is_not_measured():
    hidden = np.ma.array(disc(320, 200, 90), mask=disc(320, 200, 20))
    with pytest.raises(ValueError, match=r"`mask_or_polygon` must be .* no masked entry"):
        extent(fitted(), hidden, flat("relative"))
    labels = np.ma.array(labelled(), mask=labelled() == 7)
    with pytest.raises(ValueError, match=r"`label_image` must be .* no masked entry"):
        regionprops_table(fitted(), labels, flat("relative"))
