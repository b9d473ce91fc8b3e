"""Inverse depth with an unknown shift (MiDaS, Depth Anything): k and b fitted together."""

import json
import math

import numpy as np
import pytest
from scipy import optimize, special

import imgscale as ims
from imgscale import Flag

METHODS = ["posterior", "robust"]
EXACT = ims.Noise(box_px=0.0, depth_rel=1e-6)
# Labels that no shipped table knows; their sizes are exact unless said.
SIZES = {"door": 2.0, "pole": 1.2, "crate": 0.6}


def table(spread=0.0, mean_spread=0.0, sizes=SIZES):
    return ims.PriorTable([
        ims.ObjectPrior(label, size, spread * size, mean_std_m=mean_spread * size)
        for label, size in sizes.items()
    ])  # fmt: skip


def boxes(labels, pixels):
    """Boxes of given heights; their widths do not matter."""
    return [
        ims.Detection(label, (10.0, 5.0, 30.0, 5.0 + height))
        for label, height in zip(labels, pixels, strict=True)
    ]


def depths(values):
    return ims.ObjectDepths(np.asarray(values, dtype=np.float64), kind="affine_inverse")


def consistent(seed, count=None):
    """A scene that obeys p / H = (D + b) / k exactly, with an unknown statue at its end."""
    rng = np.random.default_rng(seed)
    count = count or int(rng.integers(2, 7))
    nearness = rng.uniform(1.0, 8.0, count + 1)
    nearness[:2] = rng.uniform(1.0, 2.0), rng.uniform(4.0, 8.0)  # two well apart
    k, shift = math.exp(rng.uniform(-8, 2)), rng.uniform(-6, 6)
    labels = [*rng.choice(list(SIZES), count), "statue"]
    size = np.array([SIZES.get(label, 1.5) for label in labels])
    return labels, size * nearness / k, nearness - shift, k, shift


def fit_and_size(labels, pixels, values, *, noise=EXACT, priors=None, method="posterior"):
    priors = priors or table()
    detections, depth = boxes(labels, pixels), depths(values)
    model = ims.fit(detections, depth, priors, noise=noise, method=method)
    return model, ims.predict(model, detections, depth)


# --- exact data --------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("depth_rel", [1e-3, 1e-6])
@pytest.mark.parametrize("count", [2, 4, 7], ids="{} references".format)
def test_consistent_references_give_the_true_constants(count, depth_rel, method):
    noise = ims.Noise(box_px=0.0, depth_rel=depth_rel)
    # the prior of the shift draws by the square of the noise
    tolerance = max(5e-6, 100 * depth_rel**2)
    misses = []
    for seed in range(3):
        labels, pixels, values, k, shift = consistent(seed, count)
        model, sizes = fit_and_size(labels, pixels, values, noise=noise, method=method)
        error = (
            model.k / k - 1,
            (model.shift - shift) / (values + shift).min(),
            sizes[-1].size_m / 1.5 - 1,
        )
        if np.abs(error).max() > tolerance:
            misses.append((seed, *(f"{number:.1e}" for number in error)))
    assert not misses, f"{len(misses)} of 3: {misses}"


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("factor", [1e-6, 7.0, 1e6])
@pytest.mark.parametrize("seed", range(2))
def test_scaling_the_values_scales_both_constants_and_no_size(seed, factor, method):
    rng = np.random.default_rng(seed)
    labels, pixels, values, _, _ = consistent(seed, count=4)
    pixels = pixels * np.exp(0.05 * rng.normal(size=pixels.size))
    options = {"noise": ims.Noise(box_px=0.0, depth_rel=0.05), "method": method}
    model, sizes = fit_and_size(labels, pixels, values, **options)
    scaled, again = fit_and_size(labels, pixels, factor * values, **options)
    assert scaled.k == pytest.approx(factor * model.k, rel=1e-9)
    assert scaled.k_std == pytest.approx(factor * model.k_std, rel=1e-7)
    assert scaled.shift == pytest.approx(factor * model.shift, rel=1e-8, abs=1e-9 * factor)
    assert scaled.shift_std == pytest.approx(factor * model.shift_std, rel=1e-7)
    assert scaled.correlation == pytest.approx(model.correlation, abs=1e-7)
    for one, other in zip(again, sizes, strict=True):
        assert one.size_m == pytest.approx(other.size_m, rel=1e-9)
        np.testing.assert_allclose(one.interval(), other.interval(), rtol=1e-7)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("offset", [-1e6, -1e3, -3.0, 10.0, 1e3, 1e6])
def test_an_offset_of_the_values_moves_the_shift_and_no_size(offset, method):
    # exact references leave the prior of the shift nothing to say; 1e6 spreads cost six digits
    labels, pixels, values, k, shift = consistent(3, count=4)
    spread = np.ptp(values[:-1])
    moved = values + offset * spread
    noise = ims.Noise(box_px=0.0, depth_rel=1e-3)
    model, sizes = fit_and_size(labels, pixels, moved, noise=noise, method=method)
    assert model.k == pytest.approx(k, rel=1e-4)
    assert model.shift + offset * spread == pytest.approx(shift, abs=1e-4 * spread)
    assert sizes[-1].size_m == pytest.approx(1.5, rel=1e-4)
    assert Flag.BEYOND_HORIZON not in sizes[-1].flags


@pytest.mark.parametrize("method", METHODS)
def test_negative_values_are_depths_like_any_other(method):
    labels, pixels, values, k, shift = consistent(5, count=4)
    lowered = values - values.max() - 1.0
    assert (lowered < 0).all()
    model, sizes = fit_and_size(labels, pixels, lowered, method=method)
    assert model.k == pytest.approx(k, rel=1e-6)
    assert model.shift - values.max() - 1 == pytest.approx(shift, abs=1e-5)
    assert all(reference.used for reference in model.references[:-1])
    assert sizes[-1].size_m == pytest.approx(1.5, rel=1e-6)


def test_the_order_of_the_references_does_not_matter():
    labels, pixels, values, _, _ = consistent(8, count=5)
    pixels = pixels * np.exp(0.05 * np.random.default_rng(1).normal(size=6))
    noise = ims.Noise(box_px=0.0, depth_rel=0.05)
    model, sizes = fit_and_size(labels, pixels, values, noise=noise)
    again, sizes_again = fit_and_size(labels[::-1], pixels[::-1], values[::-1], noise=noise)
    assert again.k == pytest.approx(model.k, rel=1e-9)
    assert again.shift == pytest.approx(model.shift, rel=1e-8)
    assert sizes_again[0].interval() == pytest.approx(sizes[-1].interval(), rel=1e-8)


# --- against quadrature over (log k, b) --------------------------------------------------------


class Quadrature:
    """
    Sums over (log k, b): Gaussian references, log k flat, b ~ N(0, max(|median D|, std D)^2).

    Offsets of labels are integrated out in closed form, as a covariance of the residuals.
    """

    def __init__(self, labels, pixels, values, noise, spread, mean_spread):
        known = np.array([label in SIZES for label in labels])
        d, p = np.asarray(values)[known], np.asarray(pixels)[known]
        names = np.array(labels)[known]
        log_var = math.log1p(spread**2)
        prior = np.log([SIZES[name] for name in names]) - log_var / 2
        covariance = (noise**2 + log_var) * np.eye(d.size)
        covariance += mean_spread**2 * (names[:, None] == names)
        precision = np.linalg.inv(covariance)
        ones = precision.sum(axis=0)
        width = max(abs(np.median(d)), d.std())
        # c = min(D) + b > 0; dense in log c, which runs over the whole line
        spread = np.ptp(d)
        log_c = np.linspace(math.log(1e-4 * spread), math.log(1e3 * max(width, spread)), 40001)
        self.b = np.exp(log_c) - d.min()
        y = prior + np.log(d + self.b[:, None]) - np.log(p)
        mean = y @ ones / ones.sum()
        residual = y - mean[:, None]
        chi2 = np.einsum("bi,ij,bj->b", residual, precision, residual)
        log_weight = -chi2 / 2 - (self.b / width) ** 2 / 2 + log_c
        weight = np.exp(log_weight - log_weight.max())
        self.weight = weight / weight.sum()
        self.log_k, self.var = mean, 1 / ones.sum()

    def average(self, column):
        return self.weight @ column

    @property
    def shift_std(self):
        return math.sqrt(self.average(self.b**2) - self.average(self.b) ** 2)

    @property
    def log_k_std(self):
        second = self.average(self.log_k**2) - self.average(self.log_k) ** 2
        return math.sqrt(self.var + second)

    @property
    def correlation(self):
        product = self.average(self.b * self.log_k) - self.average(self.b) * self.average(
            self.log_k
        )
        return product / (self.shift_std * self.log_k_std)

    def log_size_moments(self, pixels, value, noise):
        log_size = self.log_k + math.log(pixels) - np.log(value + self.b)
        mean = self.average(log_size)
        return mean, math.sqrt(self.average((log_size - mean) ** 2) + self.var + noise**2)


def noisy(seed, count, noise, spread, mean_spread):
    """References over a factor 6 of distance, off by their declared errors but no more."""
    rng = np.random.default_rng(seed)
    nearness = np.append(np.geomspace(1.0, 6.0, count), 2.5)
    shift, k = rng.uniform(-0.5, 2.0), 3e-3
    labels = [*np.resize(list(SIZES), count), "statue"]
    offset = {label: mean_spread * np.clip(rng.normal(), -1, 1) for label in labels}
    own = np.clip(rng.normal(size=count + 1), -1.5, 1.5) * math.hypot(noise, spread)
    own -= own[:-1].mean()
    log_size = np.log([SIZES.get(label, 1.5) for label in labels])
    log_pixels = log_size + np.log(nearness / k) + own + [offset[label] for label in labels]
    return labels, np.exp(log_pixels), nearness - shift, k, shift


SCENES = [(4, 0.01, 0.0, 0.0), (6, 0.02, 0.02, 0.01), (10, 0.03, 0.03, 0.0), (8, 0.02, 0.0, 0.02)]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("scene", SCENES, ids=str)
def test_errors_and_correlation_of_k_and_shift_are_those_of_the_joint_posterior(
    scene, seed, method
):
    count, noise, spread, mean_spread = scene
    labels, pixels, values, _, _ = noisy(seed, count, noise, spread, mean_spread)
    model, sizes = fit_and_size(
        labels,
        pixels,
        values,
        noise=ims.Noise(box_px=0.0, depth_rel=noise),
        priors=table(spread, mean_spread),
        method=method,
    )
    truth = Quadrature(labels, pixels, values, noise, spread, mean_spread)
    # outliers, of which the quadrature knows none, cost the sound references some per cent
    tolerance = 0.06 if method == "posterior" else 0.08
    assert model.k_std / model.k == pytest.approx(truth.log_k_std, rel=tolerance)
    assert model.shift_std == pytest.approx(truth.shift_std, rel=tolerance)
    assert model.correlation == pytest.approx(truth.correlation, abs=0.02)
    assert truth.correlation > 0.5
    mean, std = truth.log_size_moments(pixels[-1], values[-1], noise)
    assert sizes[-1].std_m / sizes[-1].size_m == pytest.approx(std, rel=tolerance)
    assert math.log(sizes[-1].size_m) == pytest.approx(mean, abs=0.25 * std)


class WholeModel:
    """Sums over (log k, b) with references of which some are wrong, and no offsets."""

    def __init__(self, labels, pixels, values, noise, spread):
        known = np.array([label in SIZES for label in labels])
        d, p = np.asarray(values)[known], np.asarray(pixels)[known]
        log_var = math.log1p(spread**2)
        prior = np.log([SIZES[label] for label in labels if label in SIZES]) - log_var / 2
        variance = noise**2 + log_var
        width = max(abs(np.median(d)), d.std())
        low, high = math.log(1e-3 * np.ptp(d)), math.log(1e2 * max(width, np.ptp(d)))
        log_c = np.linspace(low, high, math.ceil((high - low) / (math.sqrt(variance) / 3)))
        self.b = np.exp(log_c) - d.min()
        y = prior + np.log(d + self.b[:, None]) - np.log(p)
        step = math.sqrt(variance / d.size) / 2
        self.x = np.arange(y.min() - 1.5, y.max() + 1.5, step)
        log_weight = np.repeat((log_c - (self.b / width) ** 2 / 2)[:, None], self.x.size, axis=1)
        for column in y.T:
            log_weight += np.log(self.likelihood(column[:, None] - self.x, variance))
        self.weight = np.exp(log_weight - log_weight.max())
        self.weight /= self.weight.sum()

    @staticmethod
    def likelihood(residual, variance):
        def normal(r, v):
            return np.exp(-0.5 * r**2 / v) / np.sqrt(2 * math.pi * v)

        scale = math.sqrt((variance + 0.5**2) / 2)
        outliers = 0.02 * np.exp(-np.abs(residual) / scale) / (2 * scale)
        outliers += 0.03 * normal(residual - 0.4, variance + 0.25**2)
        return 0.95 * normal(residual, variance) + outliers

    def log_size(self, probability, pixels, value, noise):
        """Quantile of the log size of an object of unknown label."""
        place = self.x + math.log(pixels) - np.log(np.maximum(value + self.b, 1e-300))[:, None]
        heavy = self.weight > 1e-9 * self.weight.max()
        place, weight = place[heavy], self.weight[heavy] / self.weight[heavy].sum()

        def excess(log_size):
            return weight @ special.ndtr((log_size - place) / noise) - probability

        middle = weight @ np.clip(place, -20, 20)
        return optimize.brentq(excess, middle - 9, middle + 9, xtol=1e-6)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("wrong", [False, True], ids=["sound", "one wrong"])
@pytest.mark.parametrize(("count", "noise"), [(2, 0.03), (3, 0.03), (5, 0.03), (2, 0.1), (3, 0.1)])
def test_the_posterior_of_a_new_object_is_that_of_the_whole_model(count, noise, wrong, seed):
    spread = 0.03
    labels, pixels, values, _, _ = noisy(seed, count, noise, spread, 0.0)
    if wrong:
        pixels[seed % count] *= 0.6
    options = {"noise": ims.Noise(box_px=0.0, depth_rel=noise), "priors": table(spread)}
    _, sizes = fit_and_size(labels, pixels, values, **options)
    truth = WholeModel(labels, pixels, values, noise, spread)
    low, high = (
        truth.log_size(probability, pixels[-1], values[-1], noise) for probability in (0.05, 0.95)
    )
    found = np.log(sizes[-1].interval(0.9))
    # a few dozen cases of the shift resolve the middle of the posterior, and its tails roughly
    width = high - low
    np.testing.assert_allclose((found - [low, high]) / width, 0, atol=0.1)
    # the size is k d p with the most probable shift, not the median over all shifts
    assert low < math.log(sizes[-1].size_m) < high


@pytest.mark.parametrize("method", METHODS)
def test_the_prior_draws_the_shift_to_zero_where_references_hardly_separate(method):
    noise = ims.Noise(box_px=0.0, depth_rel=0.05)
    nearness = np.array([4.00, 4.02, 4.04, 4.01])  # half a per cent, beside errors of 5 %
    labels = ["door", "pole", "crate", "statue"]
    size = np.array([2.0, 1.2, 0.6, 1.5])
    for shift in (-2.0, 2.0):
        model, _ = fit_and_size(
            labels, size * nearness / 3e-3, nearness - shift, noise=noise, method=method
        )
        width = np.median(nearness[:-1] - shift)
        assert abs(model.shift) < 0.35 * width
        assert 0.5 * width < model.shift_std < 1.1 * width


@pytest.mark.parametrize("method", METHODS)
def test_references_that_separate_beat_the_prior_of_the_shift(method):
    # the same shift is found from the same objects, once they stand apart
    noise = ims.Noise(box_px=0.0, depth_rel=0.01)
    labels, pixels, values, k, shift = consistent(11, count=6)
    model, _ = fit_and_size(labels, pixels, values, noise=noise, method=method)
    assert abs(model.shift - shift) < model.shift_std
    assert abs(math.log(model.k / k)) < model.k_std / model.k


# --- references that are wrong -----------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("worst", range(8))
def test_one_outlier_among_eight_does_not_move_the_fit(worst, method):
    noise = ims.Noise(box_px=0.0, depth_rel=0.03)
    labels, pixels, values, _, _ = noisy(4, 8, 0.03, 0.0, 0.0)
    keep = np.arange(9) != worst
    clean, clean_sizes = fit_and_size(
        [label for label, kept in zip(labels, keep, strict=True) if kept],
        pixels[keep],
        values[keep],
        noise=noise,
        method=method,
    )
    cut = np.where(keep, pixels, 0.6 * pixels)
    model, sizes = fit_and_size(labels, cut, values, noise=noise, method=method)
    assert model.references[worst].reason == "outlier"
    assert Flag.OUTLIERS in model.flags
    assert [ref.used for ref in model.references[:-1]].count(False) == 1
    assert abs(model.k - clean.k) < 0.4 * clean.k_std
    assert abs(model.shift - clean.shift) < 0.4 * clean.shift_std
    error = clean_sizes[-1].std_m
    assert abs(sizes[-1].size_m - clean_sizes[-1].size_m) < 0.4 * error


# --- impossible and doubtful -------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_one_reference_cannot_fix_two_unknowns(method):
    with pytest.raises(ims.FitError, match=r"at least two references at different depths"):
        fit_and_size(["door", "statue"], [200.0, 100.0], [2.0, 3.0], method=method)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("value", [-3.0, 0.0, 2.0])
def test_references_at_one_depth_cannot_fix_two_unknowns(value, method):
    with pytest.raises(ims.FitError, match=r"at least two references at different depths"):
        fit_and_size(
            ["door", "pole", "crate", "statue"],
            [200.0, 120.0, 60.0, 100.0],
            [value, value, value, value + 1],
            method=method,
        )


@pytest.mark.parametrize("method", ["mean_ratio", "least_squares"])
def test_the_papers_closed_forms_are_refused(method):
    labels, pixels, values, _, _ = consistent(0, count=3)
    with pytest.raises(ValueError, match=r"whose shift is unknown"):
        fit_and_size(labels, pixels, values, method=method)


def sized_at(nearness, method="posterior", noise=0.02):
    """The statue at a nearness, beside references at 1 to 6."""
    labels, pixels, values, k, shift = noisy(2, 6, noise, 0.0, 0.0)
    pixels[-1], values[-1] = 1.5 * max(nearness, 0.1) / k, nearness - shift
    return fit_and_size(
        labels,
        pixels,
        values,
        noise=ims.Noise(box_px=0.0, depth_rel=noise),
        priors=table(),
        method=method,
    )


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("nearness", "far_off"), [(0.35, True), (0.8, False), (3.0, False), (9.0, False), (16.0, True)]
)
def test_twice_as_near_or_far_as_any_reference_is_flagged(nearness, far_off, method):
    _, sizes = sized_at(nearness, method)
    assert (Flag.EXTRAPOLATED in sizes[-1].flags) is far_off
    assert not any(Flag.EXTRAPOLATED in size.flags for size in sizes[:-1])


@pytest.mark.parametrize("method", METHODS)
def test_beyond_the_horizon_no_size_is_told(method):
    model, sizes = sized_at(-1.0, method)
    far = sizes[-1]
    assert math.isnan(far.size_m)
    assert all(math.isnan(end) for end in far.interval())
    assert math.isnan(far.std_m)
    assert math.isnan(far.metres_per_pixel)
    assert Flag.BEYOND_HORIZON in far.flags
    assert np.isnan(model.metres_per_pixel(far.depth))
    assert not any(Flag.BEYOND_HORIZON in size.flags for size in sizes[:-1])


@pytest.mark.parametrize("method", METHODS)
def test_what_may_lie_beyond_the_horizon_has_no_upper_end(method):
    # the shift is known within 0.06 or so: at a nearness of 0.05 all is possible
    model, sizes = sized_at(0.05, method, noise=0.05)
    far = sizes[-1]
    assert model.shift_std > 0.05
    if math.isnan(far.size_m):
        pytest.fail("the shift's estimate itself lies beyond; choose another seed")
    low, high = far.interval(0.95)
    assert 0 < low < far.size_m
    assert high == math.inf
    assert Flag.BEYOND_HORIZON in far.flags
    assert Flag.EXTRAPOLATED in far.flags


# --- the verbs ---------------------------------------------------------------------------------


def test_leaving_one_out_needs_three_references():
    labels, pixels, values, _, _ = consistent(1, count=2)
    with pytest.raises(ims.FitError, match=r"at least two references at different depths"):
        ims.leave_one_out(boxes(labels, pixels), depths(values), table(), noise=EXACT)


@pytest.mark.parametrize("method", METHODS)
def test_leaving_one_out_is_fitting_the_others(method):
    labels, pixels, values, _, _ = noisy(3, 4, 0.04, 0.0, 0.0)
    noise = ims.Noise(box_px=0.0, depth_rel=0.04)
    options = {"noise": noise, "method": method}
    found = ims.leave_one_out(boxes(labels, pixels), depths(values), table(), **options)
    for row in range(4):
        others = np.arange(5) != row
        model = ims.fit(
            boxes(np.array(labels)[others], pixels[others]),
            depths(values[others]),
            table(),
            **options,
        )
        one = np.array([row])
        expected = ims.predict(
            model, boxes(np.array(labels)[one], pixels[one]), depths(values[one])
        )[0]
        assert found[row].size_m == pytest.approx(expected.size_m, rel=1e-6)
        assert found[row].interval() == pytest.approx(expected.interval(), rel=2e-3)


def test_leaving_one_out_of_exact_data_gives_every_size():
    labels, pixels, values, _, _ = consistent(6, count=5)
    noise = ims.Noise(box_px=0.0, depth_rel=1e-3)
    found = ims.leave_one_out(boxes(labels, pixels), depths(values), table(), noise=noise)
    expected = [SIZES.get(label, 1.5) for label in labels]
    assert [size.size_m for size in found] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("method", METHODS)
def test_an_own_prior_narrows_the_measurement_and_is_narrowed_by_it(method):
    labels, pixels, values, _, _ = noisy(5, 5, 0.05, 0.05, 0.0)
    labels[-1] = "pole"
    pixels[-1] *= 1.2 / 1.5 * 1.03
    detections, depth = boxes(labels, pixels), depths(values)
    noise = ims.Noise(box_px=0.0, depth_rel=0.05)
    # the pole is new to the model
    model = ims.fit(detections[:-1], depths(values[:-1]), table(0.05), noise=noise, method=method)
    target, where = detections[-1:], depths(values[-1:])
    plain = ims.predict(model, target, where)[0]
    fused = ims.predict(model, target, where, use_prior=True)[0]
    assert Flag.PRIOR_USED in fused.flags
    assert fused.std_m < 0.9 * plain.std_m
    assert fused.std_m < 0.99 * 0.05 * 1.2
    assert min(1.195, plain.size_m) < fused.size_m < max(1.2, plain.size_m)
    assert depth.kind == "affine_inverse"


@pytest.mark.parametrize("noise", [ims.Noise(box_px=0.0, depth_rel=0.05), ims.Noise()], ids=str)
def test_a_model_survives_json_and_predicts_the_same(noise):
    labels, pixels, values, _, _ = noisy(6, 5, 0.03, 0.02, 0.01)
    model, sizes = fit_and_size(labels, pixels, values, noise=noise, priors=table(0.02, 0.01))
    again = ims.ScaleModel.from_dict(json.loads(json.dumps(model.to_dict())))
    assert again == model
    assert ims.predict(again, boxes(labels, pixels), depths(values)) == sizes


def maps(labels, pixels, values):
    """Every object in its column of a map of one value per column."""
    columns = np.repeat(np.asarray(values), 40)
    detections = [
        ims.Detection(label, (40.0 * i + 5, 20.0, 40.0 * i + 35, 20.0 + height))
        for i, (label, height) in enumerate(zip(labels, pixels, strict=True))
    ]
    values = np.tile(columns, (900, 1))
    return detections, ims.DepthMap(values, kind="affine_inverse")


@pytest.mark.parametrize("method", METHODS)
def test_a_map_gives_what_its_values_give(method):
    labels, pixels, values, k, shift = noisy(7, 4, 0.0, 0.0, 0.0)
    pixels = pixels / pixels.max() * 800
    detections, depth = maps(labels, pixels, values)
    model = ims.fit(detections, depth, table(), noise=EXACT, method=method)
    assert model.shift == pytest.approx(shift, abs=1e-5)
    assert ims.predict(model, detections, depth)[-1].size_m == pytest.approx(1.5, rel=1e-5)
    # every pixel's scale, by the law
    row = model.scale_map(depth)[0, ::40]
    np.testing.assert_allclose(row, model.k / (values + shift), rtol=1e-5)
    metric = model.to_metric(depth, ims.Camera(1000.0, focal_rel_std=0.0))
    assert metric.kind == "metric"
    np.testing.assert_allclose(metric.values[0, ::40], 1000 * row, rtol=1e-5)
    assert k > 0


def test_another_map_is_refused_unless_its_scale_is_vouched_for():
    labels, pixels, values, _, _ = noisy(7, 4, 0.02, 0.0, 0.0)
    pixels = pixels / pixels.max() * 800
    detections, depth = maps(labels, pixels, values)
    model = ims.fit(detections, depth, table(), noise=ims.Noise(depth_rel=0.02))
    _, other = maps(labels, pixels, values + 0.01)
    with pytest.raises(ims.DepthMismatchError, match="another"):
        ims.predict(model, detections, other)
    vouched = ims.predict(model, detections, other, same_scale=True)
    sizes = ims.predict(model, detections, depth)
    assert vouched[-1].size_m < sizes[-1].size_m  # larger values are nearer
    _, inverse = maps(labels, pixels, values + 1)
    inverse = ims.DepthMap(inverse.values, kind="inverse")
    with pytest.raises(ims.DepthMismatchError, match="kind"):
        ims.predict(model, detections, inverse, same_scale=True)


# --- simulation --------------------------------------------------------------------------------


def simulated(rng, count, noise=0.05, spread=0.06, mean_spread=0.02):
    """
    One image from the model: 4 to 25 m, any scale and shift of the inverse depth.

    The last two objects are unknown; they stand among the references.
    """
    distance = np.exp(rng.uniform(math.log(4), math.log(25), count + 2))
    distance[-2:] = np.clip(distance[-2:], distance[:-2].min(), distance[:-2].max())
    labels = [*rng.choice(list(SIZES), count), "statue", "rock"]
    offset = {label: mean_spread * rng.normal() for label in labels}
    size = np.array([SIZES.get(label, 1.5) for label in labels])
    known = np.array([label in SIZES for label in labels])
    size = size * np.exp(
        known * (spread * rng.normal(size=size.size) + [offset[label] for label in labels])
    )
    pixels = 1200 * size / distance
    nearness = np.exp(noise * rng.normal(size=size.size)) / distance
    scale, shift = math.exp(rng.uniform(-1, 5)), rng.normal(0, 0.1)
    return labels, pixels, scale * (nearness - shift), size


@pytest.mark.slow
@pytest.mark.parametrize(("method", "images"), [("posterior", 60), ("robust", 160)])
def test_intervals_of_unknown_objects_cover_what_they_say(method, images):
    # 60 x 2 objects: the binomial error is 2.7 points, a little more as both share an image
    rng = np.random.default_rng(2026)
    covered, errors = [], []
    for _ in range(images):
        labels, pixels, values, size = simulated(rng, int(rng.integers(4, 9)))
        _, sizes = fit_and_size(
            labels,
            pixels,
            values,
            noise=ims.Noise(box_px=0.0, depth_rel=0.05),
            priors=table(0.06, 0.02),
            method=method,
        )
        for estimate, true in zip(sizes[-2:], size[-2:], strict=True):
            low, high = estimate.interval(0.9)
            covered.append(low <= true <= high)
            errors.append(abs(math.log(estimate.size_m / true)))
    assert 0.85 <= np.mean(covered) <= 0.95
    assert np.median(errors) < 0.07


def test_the_wrong_kind_is_much_worse():
    # a shift of half the median inverse depth that "inverse" knows nothing of
    rng = np.random.default_rng(7)
    wrong, right = [], []
    for _ in range(40):
        labels, pixels, values, size = simulated(rng, 6)
        inverse = values - values.min()
        inverse = inverse + 0.4 * np.median(inverse)
        detections = boxes(labels, pixels)
        noise = ims.Noise(box_px=0.0, depth_rel=0.05)
        for kind, errors in (("inverse", wrong), ("affine_inverse", right)):
            depth = ims.ObjectDepths(inverse, kind=kind)
            model = ims.fit(detections, depth, table(0.06, 0.02), noise=noise, method="robust")
            sizes = ims.predict(model, detections, depth)
            errors.extend(
                abs(math.log(estimate.size_m / true))
                for estimate, true in zip(sizes[-2:], size[-2:], strict=True)
            )
    assert np.median(wrong) > 2.5 * np.median(right)
