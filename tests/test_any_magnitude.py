import itertools
import math

import numpy as np
import pytest

import imgscale as ims
from imgscale import batch

BOXES = ((10, 10, 30, 50), (50, 20, 90, 60), (20, 60, 40, 80))
NAMES = ("pole", "crate", "box")
POWERS = (-300, -200, -150, -100, -20, 20, 100, 150, 200, 300)
METHODS = ("posterior", "robust", "mean_ratio", "least_squares")


def detections_of(scale=1.0):
    boxes = [[edge * scale for edge in box] for box in BOXES]
    return [ims.Detection(name, box) for name, box in zip(NAMES, boxes, strict=True)]


def priors_of(scale=1.0):
    pole = ims.ObjectPrior("pole", 1.7 * scale, 0.1 * scale, mean_std_m=0.03 * scale)
    return ims.PriorTable([pole, ims.ObjectPrior("crate", 1.5 * scale, 0.1 * scale)])


def logs_of(kind, method, *, depth=1.0, prior=1.0, pixels=1.0):
    detections = detections_of(pixels)
    depths = ims.ObjectDepths(np.array([5.0, 7.0, 6.0]) * depth, kind=kind)
    noise = ims.Noise(box_px=pixels)
    model = ims.fit(detections, depths, priors_of(prior), method=method, noise=noise)
    size = ims.predict(model, detections, depths)[2]
    numbers = (model.k, model.k_std, size.size_m, size.std_m, *size.interval())
    return np.array([math.log10(number) for number in (*numbers, size.metres_per_pixel)])


@pytest.mark.parametrize("power", POWERS)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("kind", "sign"), [("metric", -1), ("relative", -1), ("inverse", 1)])
def test_depth_times_a_power_of_ten_moves_k_by_it_and_leaves_sizes(kind, sign, method, power):
    moved = logs_of(kind, method, depth=10.0**power)
    expected = logs_of(kind, method) + power * np.array([sign, sign, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(moved, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("power", [-90, -20, 20, 90])
@pytest.mark.parametrize("method", METHODS)
def test_priors_times_a_power_of_ten_move_k_and_sizes_by_it(method, power):
    moved = logs_of("relative", method, prior=10.0**power)
    np.testing.assert_allclose(moved, logs_of("relative", method) + power, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("power", [5, 20, 90])
@pytest.mark.parametrize("method", METHODS)
def test_boxes_times_a_power_of_ten_move_the_scale_against_it(method, power):
    moved = logs_of("relative", method, pixels=10.0**power)
    expected = logs_of("relative", method) - power * np.array([1, 1, 0, 0, 0, 0, 1])
    np.testing.assert_allclose(moved, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", ["metric", "relative", "inverse"])
def test_numbers_that_no_float_can_hold_together_are_refused_or_right(kind, method):
    sign = 1 if kind == "inverse" else -1
    plain = logs_of(kind, method)
    for depth, prior, pixels in itertools.product((-300, 0, 300), (-99, 0, 99), (0, 99)):
        of_k = sign * depth + prior - pixels
        moves = np.array([of_k, of_k, prior, prior, prior, prior, prior - pixels])
        try:
            found = logs_of(kind, method, depth=10.0**depth, prior=10.0**prior, pixels=10.0**pixels)
        except ims.FitError:
            assert abs(of_k) > 290 or abs(depth) + pixels > 290
        else:
            np.testing.assert_allclose(found, plain + moves, rtol=1e-12, atol=1e-11)


@pytest.mark.parametrize("scale", [1e-90, 1e-20, 1e20, 1e90])
def test_inverse_depth_with_a_shift_times_a_factor_moves_k_and_shift_by_it(scale):
    def fitted(factor):
        values = np.array([5.0, 7.0, 6.0]) * factor
        depths = ims.ObjectDepths(values, kind="affine_inverse")
        model = ims.fit(detections_of(), depths, priors_of())
        return np.array([model.k, model.k_std, model.shift]) / factor

    np.testing.assert_allclose(fitted(scale), fitted(1.0), rtol=1e-9)


@pytest.mark.parametrize("scale", [1e-300, 1e300])
def test_inverse_depth_with_a_shift_beyond_its_limits_is_refused(scale):
    depths = ims.ObjectDepths(np.array([5.0, 7.0, 6.0]) * scale, kind="affine_inverse")
    with pytest.raises(ims.FitError, match=r"`depth` .* between 1e-100 and 1e100; got 7e"):
        ims.fit(detections_of(), depths, priors_of())


ENDLESS = {
    "box_px": lambda number: ims.Noise(box_px=number),
    "box_rel": lambda number: ims.Noise(box_rel=number),
    "depth_rel": lambda number: ims.Noise(depth_rel=number),
    "rel_std": lambda number: ims.ObjectDepths([1.0], kind="metric", rel_std=number),
    "scale_rel_std": lambda number: ims.DepthMap(
        np.ones((2, 2)), kind="metric", scale_rel_std=number
    ),
    "focal_px": lambda number: ims.Camera(number, focal_rel_std=0.1),
    "focal_rel_std": lambda number: ims.Camera(100.0, focal_rel_std=number),
    "mean_m": lambda number: ims.ObjectPrior("pole", number, 0.0),
    "std_m": lambda number: ims.ObjectPrior("pole", 1.0, number),
    "mean_std_m": lambda number: ims.ObjectPrior("pole", 1.0, 0.1, mean_std_m=number),
    "horizon_px": lambda number: ims.GroundPlane(image_size=(9, 9), horizon_px=number),
    "camera_height_m": lambda number: ims.GroundPlane(image_size=(9, 9), camera_height_m=number),
}


@pytest.mark.parametrize("argument", ENDLESS)
def test_a_number_whose_square_overflows_is_refused_by_its_name(argument):
    ENDLESS[argument](1.0)
    with pytest.raises(ValueError, match=f"`{argument}` must be .*1e100; got 1e\\+300"):
        ENDLESS[argument](1e300)


@pytest.mark.parametrize("argument", ["focal_px", "mean_m", "camera_height_m"])
def test_a_number_whose_square_underflows_is_refused_by_its_name(argument):
    with pytest.raises(ValueError, match=f"`{argument}` must be between 1e-100 and 1e100"):
        ENDLESS[argument](1e-300)


@pytest.mark.parametrize("argument", ["std_m", "mean_std_m"])
def test_a_spread_beyond_any_size_is_refused_by_its_name(argument):
    numbers = {"mean_m": 1e-90, "std_m": 1e-91, argument: 1e90}
    with pytest.raises(ValueError, match=f"`{argument}` must be at most 1e6 times the mean"):
        ims.ObjectPrior("pole", **numbers)


def test_an_all_but_exact_mean_is_as_good_as_an_exact_one():
    def fitted(mean_std_m):
        table = ims.PriorTable([ims.ObjectPrior("pole", 1.7, 0.1, mean_std_m=mean_std_m)])
        depths = ims.ObjectDepths([5.0, 7.0, 6.0], kind="inverse")
        return ims.fit(detections_of(), depths, table).k

    assert math.isclose(fitted(1e-300), fitted(0.0), rel_tol=1e-3)


@pytest.mark.parametrize("scale", [1e-90, 1e-20, 1e20, 1e90])
def test_columns_of_any_lawful_magnitude_are_fitted_alike(scale):
    def k_of(factor):
        depth = np.array([5.0, 6.0]) * factor
        return batch.fit_columns(
            [1, 1], ["pole", "crate"], [40.0, 30.0], depth, priors_of(), kind="relative"
        ).images.k

    np.testing.assert_allclose(k_of(scale) * scale, k_of(1.0), rtol=1e-12)


@pytest.mark.parametrize("number", [1e-300, 1e300])
@pytest.mark.parametrize("argument", ["pixels", "depth"])
def test_columns_beyond_all_magnitudes_are_refused_by_name_and_row(argument, number):
    columns = {"pixels": np.array([40.0, 30.0]), "depth": np.array([5.0, 6.0])}
    columns[argument] = np.array([40.0, number])
    with pytest.raises(ValueError, match=f"`{argument}` must be from 1e-100 to 1e100.* at index 1"):
        batch.fit_columns([1, 1], ["pole", "crate"], priors=priors_of(), kind="relative", **columns)


@pytest.mark.parametrize("value", [1e-320, 1e-308])
def test_a_scale_that_no_float_holds_is_infinite_and_a_size_of_it_refused(value):
    depths = ims.ObjectDepths([5.0, 7.0, 6.0], kind="inverse")
    model = ims.fit(detections_of(), depths, priors_of())
    scale = model.metres_per_pixel([value, 7.0])
    assert np.isinf(scale[0]) or math.isclose(scale[0] * value, model.k, rel_tol=1e-9)
    far = ims.ObjectDepths([value, 7.0, 6.0], kind="inverse")
    with pytest.raises(ims.FitError, match=r"`detections`\[0\]"):
        ims.predict(model, detections_of(), far, same_scale=True)
