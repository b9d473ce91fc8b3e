"""References by width and diameter: a plate, a card, a coin give k, and with it all the rest."""

import math

import numpy as np
import pytest

import imgscale as ims
from imgscale.datasets import motorcycle
from imgscale.measuring import distance, extent

SIZE = (640, 480)
FOCAL = 800.0
CAMERA = ims.Camera(FOCAL, focal_rel_std=0.0, image_size=SIZE)
EXACT = ims.Noise(box_px=0.0, box_rel=0.0, depth_rel=0.0)
Z = 1.5
# Label, what it measures in the shipped table, and a box of it at 1.5 m: height, width in metres.
SHIPPED = [
    pytest.param("licence plate", "eu", 0.11, 0.52, id="a plate by its width"),
    pytest.param("credit card", "world", 0.054, 0.0856, id="a card by its longer side"),
    pytest.param("credit card", "world", 0.0856, 0.054, id="a card on end"),
    pytest.param("us quarter", "world", 0.02426, 0.02426, id="a coin"),
    pytest.param("1 euro coin", "world", 0.02325, 0.011, id="a coin seen from the side"),
]


def boxed(label, height_m, width_m, left=20.0, top=20.0):
    scale = FOCAL / Z
    return ims.Detection(label, (left, top, left + width_m * scale, top + height_m * scale))


def depth_map(kind):
    values = {"relative": 3.7 * Z, "inverse": 1 / Z, "metric": Z}[kind]
    return ims.DepthMap(np.full((SIZE[1], SIZE[0]), values), kind=kind)


@pytest.mark.parametrize("kind", ["relative", "inverse", "metric"])
@pytest.mark.parametrize(("label", "region", "height_m", "width_m"), SHIPPED)
def test_a_shipped_reference_carries_through_to_every_measurement(
    label, region, height_m, width_m, kind
):
    priors, depth = ims.PriorTable.default(region=region), depth_map(kind)
    model = ims.fit([boxed(label, height_m, width_m)], depth, priors, noise=EXACT)
    assert model.references[0].axis in {"width", "diameter"}
    prior = max(priors.lookup(label), key=lambda row: row.share)
    # the median of a log-normal lies below its mean by half its variance
    median = 1 / math.sqrt(1 + (prior.std_m / prior.mean_m) ** 2)
    scale = Z / FOCAL * median
    box = ims.Detection("box", (300, 200, 400, 280))
    for axis, pixels in (("height", 80), ("width", 100), ("diameter", 100)):
        size = ims.predict(model, [box], depth, axis=axis)[0]
        assert size.size_m == pytest.approx(pixels * scale, rel=1e-6)
    assert distance(model, (300.5, 200.5), (420.5, 360.5), depth).value == pytest.approx(
        200 * scale, rel=1e-6
    )
    found = extent(model, [(300, 200), (400, 200), (400, 280), (300, 280)], depth)
    assert found.area.value == pytest.approx(8000 * scale**2, rel=1e-6)


@pytest.mark.parametrize("axis", ["width", "diameter"])
def test_the_error_of_such_a_reference_is_that_of_everything_else(axis):
    priors = ims.PriorTable([ims.ObjectPrior("token", 0.1, 0.004, mean_std_m=0.003, axis=axis)])
    depth = depth_map("relative")
    # the exact posterior adds that the reference may be wrong
    token = boxed("token", 0.05, 0.1)
    model = ims.fit([token], depth, priors, noise=EXACT, method="robust")
    log_std = math.sqrt(math.log1p(0.04**2) + 0.03**2)
    tape = distance(model, (300.5, 200.5), (420.5, 360.5), depth)
    found = extent(model, [(300, 200), (400, 200), (400, 280), (300, 280)], depth)
    for quantity, power in ((tape, 1), (found.longest, 1), (found.area, 2)):
        low, high = quantity.interval(0.9)
        factor = math.exp(1.6449 * log_std * power)
        assert high / quantity.value == pytest.approx(factor, rel=2e-3)
        assert quantity.value / low == pytest.approx(factor, rel=2e-3)


@pytest.mark.slow
def test_a_coin_measures_nine_lengths_and_areas_of_ten():
    rng, count, hits = np.random.default_rng(8), 250, {"length": 0, "area": 0}
    noise, coin = ims.Noise(box_px=1.0, depth_rel=0.01), 0.02426
    priors = ims.PriorTable.default()
    for _ in range(count):
        values = np.full((SIZE[1], SIZE[0]), 3.7 * 0.4 * math.exp(0.01 * rng.normal()))
        scale = FOCAL / 0.4
        side = scale * coin + rng.normal()
        model = ims.fit(
            [ims.Detection("us quarter", (20, 20, 20 + side - 1, 20 + side))],
            ims.ObjectDepths([3.7 * 0.4 * math.exp(0.01 * rng.normal())], kind="relative"),
            priors,
            noise=noise,
            camera=CAMERA,
        )
        depth = ims.DepthMap(values, kind="relative")
        low, high = rng.normal(size=(2, 2)) / math.sqrt(2)
        (x1, y1), (x2, y2) = np.array([200.0, 200.0]) + low, np.array([300.0, 280.0]) + high
        tape = distance(model, (x1, 240), (x2, 240), depth, same_object=True)
        area = extent(model, [(x1, y1), (x2, y1), (x2, y2), (x1, y2)], depth).area
        for name, quantity, truth in (
            ("length", tape, 100 / scale),
            ("area", area, 8000 / scale**2),
        ):
            left, right = quantity.interval(0.9)
            hits[name] += left <= truth <= right
    assert 0.86 <= hits["length"] / count <= 0.97
    # here the errors of the four edges are independent, where the library takes outlines that err
    # outward as a whole
    assert 0.86 <= hits["area"] / count <= 0.985


@pytest.mark.parametrize("axis", ["width", "diameter"])
def test_the_motorcycles_tyre_by_width_or_diameter_measures_its_rim(axis):
    # the rear wheel stands nearly square to the view: 158 px wide and 165 px high
    scene = motorcycle.load()
    tyre = ims.ObjectPrior("rear tyre", 0.622, 0.012, axis=axis)
    priors = ims.PriorTable([tyre])
    model = ims.fit(scene.detections, scene.depth, priors, noise=scene.noise, camera=scene.camera)
    assert model.references[0].axis == axis
    rim = next(d for d in scene.detections if d.label == "front rim")
    x1, y1, x2, y2 = rim.xyxy
    found = extent(model, [(x1, y1), (x2, y1), (x2, y2), (x1, y2)], scene.depth)
    low, high = found.height.interval(0.95)
    assert low < 0.485 < high
