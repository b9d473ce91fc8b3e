"""The verb `fit`: exact recovery, laws, robustness, the camera as witness, hostile input."""

import math
import pickle
import threading

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import imgscale as ims
from imgscale import Flag

FOCAL = 800.0
SIZE = (2000, 1500)
BASELINE = 0.54
UNIT = 3.7  # of the relative depths, per metre
METHODS = ["mean_ratio", "least_squares", "robust", "posterior"]
FITTED = ["robust", "posterior"]  # the paper's two reject nothing and take no camera
Z90 = 1.6448536269514722
NAN = math.nan

TO_KIND = {
    "metric": (lambda z: z, 1 / FOCAL),
    "relative": (lambda z: UNIT * z, 1 / (UNIT * FOCAL)),
    "inverse": (lambda z: FOCAL * BASELINE / z, BASELINE),
}


def box(label, height, width=40.0, *, left=50.0, top=20.0, **options):
    return ims.Detection(label, (left, top, left + width, top + height), **options)


def exact_priors(heights, std_m=0.0):
    return ims.PriorTable([ims.ObjectPrior(f"pole {i}", h, std_m) for i, h in enumerate(heights)])


def poles(heights, z, focal=FOCAL):
    """One detection per height and depth, each of a label of its own."""
    return [
        box(f"pole {i}", focal * h / d) for i, (h, d) in enumerate(zip(heights, z, strict=True))
    ]


def relative(values, **options):
    return ims.ObjectDepths(values, kind="relative", **options)


HEIGHTS = np.array([1.7, 0.4, 3.1, 2.0])
Z = np.array([6.0, 3.0, 17.0, 9.0])


def log_std(model):
    return model.k_std / model.k


def half_width(below):
    """Half the width of the central 68.3 % of a distribution, by bisection."""

    def quantile(probability):
        low, high = -20.0, 20.0
        for _ in range(100):
            middle = (low + high) / 2
            low, high = (middle, high) if below(middle) < probability else (low, middle)
        return low

    one = math.erf(1 / math.sqrt(2)) / 2
    return (quantile(0.5 + one) - quantile(0.5 - one)) / 2


def normal_below(x, mean, variance):
    return (1 + math.erf((x - mean) / math.sqrt(2 * variance))) / 2


def laplace_below(x, variance):
    tail = math.exp(-abs(x) / math.sqrt(variance / 2)) / 2
    return tail if x < 0 else 1 - tail


def k_log_std_of_one(method, variances, weights=(1.0,)):
    """What one reference tells of log k whose noise is known, or is one of several."""

    def below(x, variance):
        if method == "robust":
            return normal_below(x, 0.0, variance)
        # sound; wrong either way, by half its size or so; or showing less than its prior says
        return (
            0.95 * normal_below(x, 0.0, variance)
            + 0.02 * laplace_below(x, variance + 0.5**2)
            + 0.03 * normal_below(x, -0.4, variance + 0.25**2)
        )

    pairs = list(zip(weights, variances, strict=True))
    return half_width(lambda x: sum(w * below(x, v) for w, v in pairs))


# standard errors: closed forms of the one, quantiles on a grid of the other
STD_TOLERANCE = {"robust": 1e-9, "posterior": 1e-3}


# --- exact recovery ----------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", TO_KIND)
def test_consistent_data_give_k_exactly(kind, method):
    convert, k = TO_KIND[kind]
    model = ims.fit(
        poles(HEIGHTS, Z), ims.ObjectDepths(convert(Z), kind=kind), exact_priors(HEIGHTS),
        method=method,
    )  # fmt: skip
    assert model.k == pytest.approx(k, rel=1e-12)
    assert model.flags == Flag(0)
    assert sum(ref.weight for ref in model.references) == pytest.approx(1, rel=1e-12)


@pytest.mark.parametrize("method", FITTED)
@pytest.mark.parametrize("kind", TO_KIND)
def test_the_median_of_a_spread_prior_is_its_centre(kind, method):
    # log-normal with an arithmetic mean: the median is mean * exp(-s^2 / 2)
    convert, k = TO_KIND[kind]
    std = 0.2 * HEIGHTS
    medians = HEIGHTS * np.exp(-np.log1p((std / HEIGHTS) ** 2) / 2)
    priors = ims.PriorTable(
        [
            ims.ObjectPrior(f"pole {i}", h, s)
            for i, (h, s) in enumerate(zip(HEIGHTS, std, strict=True))
        ]
    )
    depth = ims.ObjectDepths(convert(Z), kind=kind)
    model = ims.fit(poles(medians, Z), depth, priors, method=method)
    assert model.k == pytest.approx(k, rel=1e-12)


@pytest.mark.parametrize("method", ["mean_ratio", "least_squares"])
def test_the_papers_methods_take_the_mean_for_its_centre(method):
    model = ims.fit(
        poles(HEIGHTS, Z), relative(UNIT * Z), exact_priors(HEIGHTS, std_m=0.3), method=method
    )
    assert model.k == pytest.approx(1 / (UNIT * FOCAL), rel=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_disparity_with_doffs_as_inverse_depth_gives_the_baseline(method):
    doffs = 31.0
    disparity = FOCAL * BASELINE / Z - doffs
    model = ims.fit(
        poles(HEIGHTS, Z), ims.ObjectDepths(disparity + doffs, kind="inverse"),
        exact_priors(HEIGHTS), method=method,
    )  # fmt: skip
    assert model.k == pytest.approx(BASELINE, rel=1e-12)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", TO_KIND)
def test_a_constant_map_and_one_object_give_k(kind, method):
    convert, k = TO_KIND[kind]
    depth = ims.DepthMap(np.full((300, 400), convert(6.0)), kind=kind, image_size=SIZE)
    model = ims.fit(poles([1.7], [6.0]), depth, exact_priors([1.7]), method=method)
    assert model.k == pytest.approx(k, rel=1e-12)
    assert model.flags == Flag.SINGLE_REFERENCE


@given(
    heights=st.lists(st.floats(0.05, 30), min_size=1, max_size=6),
    focal=st.floats(50, 1e4),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=40, deadline=None)
def test_any_consistent_scene_gives_one_over_the_focal_length(heights, focal, seed):
    z = np.random.default_rng(seed).uniform(0.5, 80, len(heights))
    for method in METHODS:
        model = ims.fit(
            poles(heights, z, focal), ims.ObjectDepths(z, kind="metric"), exact_priors(heights),
            method=method,
        )  # fmt: skip
        assert model.k == pytest.approx(1 / focal, rel=1e-11)


# --- laws --------------------------------------------------------------------------------------


def noisy_scene(seed, count=5):
    """Poles of three labels, 10 % off in depth and size; boxes away from the border."""
    rng = np.random.default_rng(seed)
    labels = [f"pole {i}" for i in rng.integers(0, 3, count)]
    heights = np.exp(rng.normal(0.3, 0.1, count))
    z = rng.uniform(4, 30, count)
    detections = [
        box(label, FOCAL * h / d, left=60.0 * i + 10)
        for i, (label, h, d) in enumerate(zip(labels, heights, z, strict=True))
    ]
    return detections, z * np.exp(rng.normal(0, 0.05, count))


def spread_priors(c=1.0):
    return ims.PriorTable(
        [
            ims.ObjectPrior(f"pole {i}", c * m, c * s, mean_std_m=c * t)
            for i, (m, s, t) in enumerate([(1.3, 0.1, 0.05), (1.35, 0.15, 0.0), (1.4, 0.08, 0.1)])
        ]
    )


@given(seed=st.integers(0, 2**32 - 1), c=st.floats(1e-3, 1e3), method=st.sampled_from(METHODS))
@settings(max_examples=40, deadline=None)
def test_scaling_all_priors_scales_k(seed, c, method):
    detections, z = noisy_scene(seed)
    a = ims.fit(detections, relative(z), spread_priors(), method=method)
    b = ims.fit(detections, relative(z), spread_priors(c), method=method)
    assert b.k == pytest.approx(c * a.k, rel=1e-9)
    assert b.k_std == pytest.approx(c * a.k_std, rel=1e-7)
    assert [ref.reason for ref in a.references] == [ref.reason for ref in b.references]


@given(seed=st.integers(0, 2**32 - 1), s=st.floats(1e-3, 1e3), method=st.sampled_from(METHODS))
@settings(max_examples=40, deadline=None)
def test_scaling_relative_depth_divides_k(seed, s, method):
    detections, z = noisy_scene(seed)
    a = ims.fit(detections, relative(z), spread_priors(), method=method)
    b = ims.fit(detections, relative(s * z), spread_priors(), method=method)
    assert b.k == pytest.approx(a.k / s, rel=1e-9)
    assert log_std(b) == pytest.approx(log_std(a), rel=1e-7)


@given(seed=st.integers(0, 2**32 - 1), method=st.sampled_from(METHODS))
@settings(max_examples=40, deadline=None)
def test_the_order_of_detections_does_not_matter(seed, method):
    detections, z = noisy_scene(seed)
    order = np.random.default_rng(seed + 1).permutation(len(detections))
    a = ims.fit(detections, relative(z), spread_priors(), method=method)
    b = ims.fit([detections[i] for i in order], relative(z[order]), spread_priors(), method=method)
    assert b.k == pytest.approx(a.k, rel=1e-9)
    assert b.k_std == pytest.approx(a.k_std, rel=1e-7)
    assert b.flags == a.flags
    for place, i in enumerate(order):
        assert b.references[place].k == a.references[i].k
        assert b.references[place].weight == pytest.approx(a.references[i].weight, abs=1e-7)


@given(seed=st.integers(0, 2**32 - 1), r=st.floats(0.1, 10), method=st.sampled_from(METHODS))
@settings(max_examples=30, deadline=None)
def test_resizing_the_image_divides_k_and_keeps_sizes(seed, r, method):
    detections, z = noisy_scene(seed)
    values = np.full((150, 200), NAN)
    for i, d in enumerate(z):  # a column of the map for every object
        values[:, 6 * i + 1 : 6 * i + 5] = d
    noise = ims.Noise(box_px=0.0, box_rel=0.02)

    def fitted(scale):
        size = (round(2000 * scale), round(1500 * scale))
        factor = (size[0] / 2000, size[1] / 1500)
        boxes = [
            ims.Detection(d.label, np.array(d.xyxy) * np.array([*factor, *factor]))
            for d in detections
        ]
        depth = ims.DepthMap(values, kind="relative", image_size=size)
        model = ims.fit(boxes, depth, spread_priors(), method=method, noise=noise)
        return model, [e.size_m for e in ims.predict(model, boxes, depth)], factor[1]

    a, sizes_a, _ = fitted(1.0)
    b, sizes_b, factor = fitted(r)
    used = [d for d, ref in zip(detections, a.references, strict=True) if ref.used]
    assert used
    if [ref.reason for ref in a.references] == [ref.reason for ref in b.references]:
        assert b.k == pytest.approx(a.k / factor, rel=1e-9)
        np.testing.assert_allclose(sizes_b, sizes_a, rtol=1e-9)


@given(
    seed=st.integers(0, 2**32 - 1), unit=st.floats(1e-3, 1e3), method=st.sampled_from(FITTED)
)  # fmt: skip
@settings(max_examples=40, deadline=None)
def test_metric_relative_and_inverse_versions_of_one_map_give_equal_sizes(seed, unit, method):
    rng = np.random.default_rng(seed)
    z = np.exp(rng.normal(2, 0.5, (60, 80)).cumsum(axis=1) / 20) + rng.uniform(0, 1, (60, 80))
    z[rng.uniform(size=z.shape) < 0.2] = NAN
    corners = rng.uniform(15, 700, (8, 2))
    spans = rng.uniform(5, 80, (8, 2))
    detections = [
        ims.Detection(f"pole {i % 4}", (x, y / 2, x + w, y / 2 + h))
        for i, ((x, y), (w, h)) in enumerate(zip(corners, spans, strict=True))
    ]
    versions = {"metric": z, "relative": unit * z, "inverse": unit / z}
    sizes, widths = [], []
    for kind, values in versions.items():
        depth = ims.DepthMap(values, kind=kind, image_size=(800, 600))
        model = ims.fit(detections, depth, spread_priors(), method=method)
        estimates = ims.predict(model, detections, depth)
        sizes.append([e.size_m for e in estimates])
        widths.append([e.std_m for e in estimates])
    np.testing.assert_allclose(sizes[1:], [sizes[0]] * 2, rtol=1e-9)
    np.testing.assert_allclose(widths[1:], [widths[0]] * 2, rtol=1e-6)


TOLD = ims.Noise(box_px=1.0, depth_rel=0.05)


def test_two_identical_references_with_a_certain_mean_are_two_witnesses():
    priors = ims.PriorTable([ims.ObjectPrior("pole 0", 1.7, 0.1)])
    options = {"method": "robust", "noise": TOLD}
    one = ims.fit(poles([1.7], [6.0]), relative([6.0]), priors, **options)
    two = ims.fit(poles([1.7], [6.0]) * 2, relative([6.0, 6.0]), priors, **options)
    assert two.k_std == pytest.approx(one.k_std / math.sqrt(2), rel=1e-12)
    assert two.flags == Flag.SINGLE_LABEL


@pytest.mark.parametrize("method", FITTED)
def test_two_identical_references_do_not_improve_an_uncertain_mean(method):
    priors = ims.PriorTable([ims.ObjectPrior("pole 0", 1.7, 0.0, mean_std_m=0.1)])
    options = {"noise": ims.Noise(box_px=0.0, depth_rel=0.0), "method": method}
    one = ims.fit(poles([1.7], [6.0]), relative([6.0]), priors, **options)
    two = ims.fit(poles([1.7], [6.0]) * 2, relative([6.0, 6.0]), priors, **options)
    if method == "robust":
        assert two.k_std == pytest.approx(one.k_std, rel=1e-6)
        assert log_std(two) == pytest.approx(0.1 / 1.7, rel=1e-6)
    else:  # two that agree are less probably wrong, but no better than their mean
        assert 0.1 / 1.7 * (1 - 1e-3) <= log_std(two) <= log_std(one)


@pytest.mark.parametrize("method", FITTED)
def test_ten_references_of_one_label_are_not_ten_witnesses(method):
    prior = ims.ObjectPrior("pole 0", 1.7, 0.15, mean_std_m=0.12)
    noise = ims.Noise(box_px=0.0, box_rel=0.03, depth_rel=0.04)
    model = ims.fit(
        poles([1.7], [6.0]) * 10, relative([6.0] * 10), ims.PriorTable([prior]), noise=noise,
        method=method,
    )  # fmt: skip
    spread = math.log(1 + (0.15 / 1.7) ** 2)
    total_weight = 10 / (spread + 0.03**2 + 0.04**2)
    assert log_std(model) == pytest.approx(
        math.sqrt(1 / total_weight + (0.12 / 1.7) ** 2), rel=STD_TOLERANCE[method]
    )


@pytest.mark.parametrize("method", ["robust", "posterior"])
def test_an_object_known_by_an_alias_is_fitted_as_though_that_were_its_label(method):
    table = ims.PriorTable([ims.ObjectPrior("car", 1.5, 0.1, mean_std_m=0.05)])
    depths = ims.ObjectDepths([9.0, 11.0, 8.0, 9.5], kind="relative", rel_std=0.02)

    def models(labels):
        boxes = [(0, 0, 50, 40), (60, 0, 120, 31), (0, 50, 30, 95), (200, 10, 260, 52)]
        objects = [
            ims.Detection(label, box, aliases=aliases)
            for (label, *aliases), box in zip(labels, boxes, strict=True)
        ]
        model = ims.fit(objects, depths, table, method=method)
        return model, ims.predict(model, objects, depths, use_prior=True)

    plain, plain_sizes = models([("car",), ("car",), ("statue",), ("car",)])
    named, sizes = models([("Sedan", "Car", "Vehicle"), ("car",), ("statue",), ("SUV", "Car")])
    assert named.k == plain.k
    assert named.k_std == plain.k_std
    assert [ref.prior_label for ref in named.references] == ["Car", "car", "statue", "Car"]
    assert [ref.label for ref in named.references] == ["Sedan", "car", "statue", "SUV"]
    for size, plain_size in zip(sizes, plain_sizes, strict=True):
        assert (size.size_m, size.std_m) == (plain_size.size_m, plain_size.std_m)
    assert ims.ScaleModel.from_dict(named.to_dict()) == named


def test_the_label_itself_comes_before_its_aliases():
    table = ims.PriorTable([ims.ObjectPrior("van", 2.2, 0.2), ims.ObjectPrior("car", 1.5, 0.1)])
    van = ims.Detection("van", (0, 0, 50, 40), aliases=("car",))
    (ref,) = ims.fit([van], ims.ObjectDepths([9.0], kind="relative"), table).references
    assert (ref.prior_label, ref.prior_m) == ("van", 2.2)


@pytest.mark.parametrize("method", FITTED)
def test_aliases_of_one_label_share_its_uncertain_mean(method):
    prior = ims.ObjectPrior("pole 0", 1.7, 0.0, mean_std_m=0.1, aliases=("post",))
    height = FOCAL * 1.7 / 6.0
    models = [
        ims.fit(
            [box(label, height) for label in labels], relative([6.0, 6.0]),
            ims.PriorTable([prior]), noise=ims.Noise(box_px=0.0, depth_rel=0.0), method=method,
        )
        for labels in (["pole 0", "POST"], ["pole 0", "pole 0"])
    ]  # fmt: skip
    assert (models[0].k, models[0].k_std) == (models[1].k, models[1].k_std)
    assert log_std(models[0]) >= 0.1 / 1.7 * (1 - STD_TOLERANCE[method])
    if method == "robust":
        assert log_std(models[0]) == pytest.approx(0.1 / 1.7, rel=1e-6)
    assert Flag.SINGLE_LABEL in models[0].flags


def test_a_mixture_of_rows_is_one_prior_with_its_moments():
    rows = [
        ims.ObjectPrior("pole 0", 1.7, 0.1, share=0.8),
        ims.ObjectPrior("pole 0", 1.2, 0.2, share=0.2),
    ]
    model = ims.fit(poles([1.7], [6.0]), relative([6.0]), ims.PriorTable(rows))
    draws = np.random.default_rng(0)
    sizes = np.r_[draws.normal(1.7, 0.1, 800_000), draws.normal(1.2, 0.2, 200_000)]
    assert model.references[0].prior_m == pytest.approx(sizes.mean(), rel=1e-3)
    assert model.references[0].prior_std_m == pytest.approx(sizes.std(), rel=3e-3)


@pytest.mark.parametrize("method", FITTED)
def test_a_single_reference_carries_its_prior_box_and_depth_errors(method):
    model = ims.fit(
        poles([1.7], [6.0]), relative([6.0], rel_std=0.03), exact_priors([1.7], std_m=0.2),
        noise=ims.Noise(box_px=2.0, box_rel=0.01), method=method,
    )  # fmt: skip
    pixels = FOCAL * 1.7 / 6.0
    variance = math.log(1 + (0.2 / 1.7) ** 2) + (2 / pixels) ** 2 + 0.01**2 + 0.03**2
    expected = k_log_std_of_one(method, [variance])
    assert log_std(model) == pytest.approx(expected, rel=STD_TOLERANCE[method])
    assert model.depth_rel is None


@pytest.mark.parametrize("method", FITTED)
@pytest.mark.parametrize(
    ("depth_rel", "rel_std", "told"),
    [
        pytest.param(0.2, None, 0.2, id="noise"),
        pytest.param(None, 0.1, 0.1, id="depths"),
        pytest.param(None, 0.0, 0.0, id="depths without error"),
        pytest.param(0.06, 0.08, 0.1, id="both"),
    ],
)
def test_told_depth_noise_counts_as_told(depth_rel, rel_std, told, method):
    def fitted(depth_rel, rel_std, box_rel):
        return ims.fit(
            poles([1.7], [6.0]), relative([6.0], rel_std=rel_std), exact_priors([1.7], std_m=0.1),
            noise=ims.Noise(box_px=0.0, box_rel=box_rel, depth_rel=depth_rel), method=method,
        )  # fmt: skip

    model = fitted(depth_rel, rel_std, 0.0)
    assert log_std(model) == pytest.approx(log_std(fitted(0.0, 0.0, told)), rel=1e-9)
    assert model.depth_rel is None
    if method == "robust":
        variance = told**2 + math.log(1 + (0.1 / 1.7) ** 2)
        assert log_std(model) == pytest.approx(math.sqrt(variance), rel=1e-9)


@pytest.mark.parametrize("method", FITTED)
def test_unknown_depth_noise_is_five_percent_within_a_factor_of_2_2(method):
    model = ims.fit(
        poles([1.7], [6.0]), relative([6.0]), exact_priors([1.7]), noise=ims.Noise(box_px=0.0),
        method=method,
    )  # fmt: skip
    score = np.linspace(-2, 3, 9)  # one object says nothing of its noise: the prior stays
    weights = np.exp(-(score**2) / 2) / np.exp(-(score**2) / 2).sum()
    expected = k_log_std_of_one(method, (0.05 * 2.2**score) ** 2, weights)
    # the robust solver weighs the cases by an approximate evidence
    assert log_std(model) == pytest.approx(expected, rel=0.01 if method == "robust" else 2e-3)
    assert model.depth_rel == pytest.approx(0.05 * 2.2 ** (weights @ score), rel=0.01)


@pytest.mark.parametrize("method", FITTED)
@pytest.mark.parametrize("noise", [0.02, 0.1, 0.25])
def test_unknown_depth_noise_is_learned_from_the_scatter_of_many(noise, method):
    rng = np.random.default_rng(1)
    heights, z = rng.uniform(1, 3, 40), rng.uniform(5, 30, 40)
    seen = z * np.exp(noise * rng.normal(size=40))
    model = ims.fit(poles(heights, z), relative(seen), exact_priors(heights), method=method)
    assert model.depth_rel == pytest.approx(noise, rel=0.4)
    assert log_std(model) == pytest.approx(noise / math.sqrt(40), rel=0.5)


# --- z-scores and joint sizes against dense algebra ----------------------------------------------


def test_z_scores_are_leave_one_out_residuals_of_the_dense_gaussian():
    # residuals of a thousandth of a standard deviation: robust weights are 1 to 1e-7
    rng = np.random.default_rng(2)
    labels = [0, 0, 0, 1, 1, 2]
    means, stds, taus = [1.7, 0.9, 2.4], [0.1, 0.06, 0.2], [0.05, 0.04, 0.1]
    priors = ims.PriorTable(
        [
            ims.ObjectPrior(f"pole {i}", m, s, mean_std_m=t)
            for i, (m, s, t) in enumerate(zip(means, stds, taus, strict=True))
        ]
    )
    mean, std, tau = (np.array(column)[labels] for column in (means, stds, taus))
    spread = np.log1p((std / mean) ** 2)
    residual = 1e-3 * rng.normal(size=6) * 0.08
    z = rng.uniform(5, 20, 6)
    pixels = FOCAL * mean * np.exp(-spread / 2 - residual) / z
    model = ims.fit(
        [box(f"pole {i}", p) for i, p in zip(labels, pixels, strict=True)],
        relative(z, rel_std=0.04), priors, noise=ims.Noise(box_px=1.5), method="robust",
    )  # fmt: skip
    y = residual - math.log(FOCAL)
    same = np.equal.outer(labels, labels)
    covariance = np.diag(spread + (1.5 / pixels) ** 2 + 0.04**2)
    covariance += same * np.outer(tau / mean, tau / mean)
    expected = []
    for i in range(6):
        others = np.arange(6) != i
        inverse = np.linalg.inv(covariance[np.ix_(others, others)])
        log_k_var = 1 / inverse.sum()
        log_k = log_k_var * inverse.sum(axis=0) @ y[others]
        to_i = covariance[i, others] @ inverse  # universal kriging of y_i
        predicted = log_k + to_i @ (y[others] - log_k)
        variance = covariance[i, i] - to_i @ covariance[i, others]
        variance += (1 - to_i.sum()) ** 2 * log_k_var
        expected.append((y[i] - predicted) / math.sqrt(variance))
    z_scores = [ref.z_score for ref in model.references]
    np.testing.assert_allclose(z_scores, expected, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_a_single_reference_has_no_z_score(method):
    model = ims.fit(poles([1.7], [6.0]), relative([6.0]), exact_priors([1.7]), method=method)
    assert math.isnan(model.references[0].z_score)


# --- robustness --------------------------------------------------------------------------------


def with_outlier(factor, count, seed=0, **options):
    rng = np.random.default_rng(seed)
    heights, z = rng.uniform(1, 3, count), rng.uniform(5, 20, count)
    priors = exact_priors(heights, std_m=0.05)
    seen = heights * np.exp(rng.normal(0, 0.01, count))
    clean = ims.fit(poles(seen, z)[1:], relative(z[1:]), priors, **options)
    seen[0] *= factor
    return ims.fit(poles(seen, z), relative(z), priors, **options), clean


@pytest.mark.parametrize("method", FITTED)
@pytest.mark.parametrize(
    ("noise", "count"),
    [
        pytest.param(TOLD, 3, id="told, 3"),
        pytest.param(TOLD, 5, id="told, 5"),
        pytest.param(TOLD, 8, id="told, 8"),
        pytest.param(ims.Noise(), 5, id="unknown, 5"),
        pytest.param(ims.Noise(), 8, id="unknown, 8"),
    ],
)
@pytest.mark.parametrize("factor", [0.02, 0.4, 2.5, 40.0])
def test_a_gross_outlier_among_three_or_more_is_rejected(factor, noise, count, method):
    model, clean = with_outlier(factor, count, noise=noise, method=method)
    assert model.k == pytest.approx(clean.k, rel=0.01)
    assert [ref.reason for ref in model.references] == ["outlier"] + [""] * (count - 1)
    assert Flag.OUTLIERS in model.flags
    assert Flag.OUTLIERS not in clean.flags
    assert model.references[0].weight < 0.01
    if method == "robust" and noise == TOLD:
        assert model.references[0].weight == 0
    assert abs(model.references[0].z_score) > 4


@pytest.mark.parametrize("method", FITTED)
@pytest.mark.parametrize("factor", [0.02, 40.0])
def test_a_very_gross_outlier_among_three_of_unknown_noise_is_rejected(factor, method):
    model, clean = with_outlier(factor, 3, method=method)
    assert model.k == pytest.approx(clean.k, rel=0.01)
    assert [ref.reason for ref in model.references] == ["outlier", "", ""]
    assert Flag.OUTLIERS in model.flags


@pytest.mark.parametrize("method", FITTED)
@pytest.mark.parametrize("noise", [TOLD, ims.Noise()], ids=["told", "unknown"])
def test_two_bad_references_of_five_are_rejected(noise, method):
    heights, z = [1.7, 1.2, 2.2, 3.0, 0.8], [6.0, 9.0, 12.0, 15.0, 5.0]
    seen = [1.7, 1.2, 2.2, 3.0 * 0.4, 0.8 * 2.2]
    model = ims.fit(
        poles(seen, z), relative(z), exact_priors(heights, std_m=0.05), method=method, noise=noise
    )
    assert model.k == pytest.approx(1 / FOCAL, rel=0.01)
    assert [ref.used for ref in model.references] == [True, True, True, False, False]


@pytest.mark.parametrize("method", FITTED)
@pytest.mark.parametrize("factor", [1.5, 2.0, 5.0])
@pytest.mark.parametrize("stds", [(0.05, 0.05), (0.02, 0.05), (0.03, 0.1)], ids=str)
def test_two_references_that_contradict_each_other_give_an_interval_that_holds_both(
    factor, stds, method
):
    priors = ims.PriorTable([ims.ObjectPrior(f"pole {i}", 1.0, s) for i, s in enumerate(stds)])
    detections = poles([1.0, factor], [6.0, 6.0])
    noise = ims.Noise(box_px=0.0)
    model = ims.fit(
        detections, relative([6.0, 6.0], rel_std=0.0), priors, noise=noise, method=method
    )
    assert Flag.INCONSISTENT in model.flags
    # an object of 1 px at depth 1, both exact, is as large as k
    [size] = ims.predict(model, [box("thing", 1.0)], relative([1.0], rel_std=0.0))
    low, high = size.interval(0.9)
    assert size.size_m == pytest.approx(model.k, rel=1e-12)
    for ref in model.references:
        assert low <= ref.k <= high
        if method == "robust":  # log-normal
            assert abs(math.log(ref.k / model.k)) <= Z90 * log_std(model)


@pytest.mark.parametrize("method", FITTED)
def test_two_contradicting_references_are_treated_alike(method):
    priors = exact_priors([1.0, 1.0], std_m=0.05)
    a, b = poles([1.0, 2.0], [6.0, 6.0])
    model = ims.fit([a, b], relative([6.0, 6.0]), priors, method=method)
    swapped = ims.fit([b, a], relative([6.0, 6.0]), priors, method=method)
    assert swapped.k == pytest.approx(model.k, rel=1e-12)
    assert swapped.k_std == pytest.approx(model.k_std, rel=1e-12)
    assert swapped.flags == model.flags
    assert [ref.used for ref in model.references] == [True, True]


@pytest.mark.parametrize("method", ["mean_ratio", "least_squares"])
def test_the_papers_methods_reject_nothing(method):
    heights, z = [1.7, 1.2, 2.2], [6.0, 9.0, 12.0]
    model = ims.fit(poles([1.7, 1.2, 22.0], z), relative(z), exact_priors(heights), method=method)
    x = np.array([FOCAL * 1.7, FOCAL * 1.2, FOCAL * 22.0])
    expected = {
        "mean_ratio": np.mean(np.array(heights) / x),
        "least_squares": x @ heights / (x @ x),
    }
    assert model.k == pytest.approx(expected[method], rel=1e-12)
    assert all(ref.used for ref in model.references)
    assert Flag.OUTLIERS not in model.flags
    assert Flag.INCONSISTENT in model.flags


# --- who is a reference --------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "xyxy",
    [
        pytest.param((0, 100, 60, 300), id="left border"),
        pytest.param((300, 0, 360, 200), id="top border"),
        pytest.param((1940, 100, 2000, 300), id="right border"),
        pytest.param((300, 1300, 360, 1500), id="bottom border"),
        pytest.param((1940, 100, 1999, 300), id="right border, last pixel inclusive"),
    ],
)
def test_boxes_cut_by_the_border_are_never_references(xyxy, method):
    detections = [*poles([1.7], [6.0]), ims.Detection("pole 1", xyxy)]
    model = ims.fit(
        detections, relative([6.0, 6.0], image_size=SIZE), exact_priors([1.7, 9.0]), method=method
    )
    assert [ref.reason for ref in model.references] == ["", "partial"]
    assert model.k == pytest.approx(1 / FOCAL, rel=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_detections_marked_partial_are_never_references(method):
    detections = [*poles([1.7], [6.0]), box("pole 1", 100.0, partial=True)]
    model = ims.fit(detections, relative([6.0, 6.0]), exact_priors([1.7, 9.0]), method=method)
    assert [ref.reason for ref in model.references] == ["", "partial"]
    assert model.k == pytest.approx(1 / FOCAL, rel=1e-12)


def test_without_an_image_size_borders_are_not_tested():
    model = ims.fit(
        [ims.Detection("pole 0", (0, 0, 60, 200))], relative([6.0]), exact_priors([1.7])
    )
    assert model.references[0].used


def test_every_detection_has_one_reference_with_its_reason():
    detections = [
        *poles([1.7, 1.0], [6.0, 6.0]),
        box("thing", 30.0),
        box("pole 0", 50.0, partial=True),
    ]
    model = ims.fit(detections, relative([6.0, NAN, 6.0, 6.0]), exact_priors([1.7, 1.0]))
    assert [ref.label for ref in model.references] == [d.label for d in detections]
    assert [ref.reason for ref in model.references] == ["", "no depth", "no prior", "partial"]
    assert [ref.used for ref in model.references] == [True, False, False, False]
    assert math.isnan(model.references[1].k)
    assert math.isnan(model.references[2].prior_m)


@pytest.mark.parametrize("method", METHODS)
def test_an_object_without_prior_or_depth_changes_nothing(method):
    alone = ims.fit(poles([1.7], [6.0]), relative([6.0]), exact_priors([1.7]), method=method)
    more = ims.fit(
        [*poles([1.7], [6.0]), box("thing", 30.0), box("pole 0", 700.0)],
        relative([6.0, 4.0, NAN]), exact_priors([1.7]), method=method,
    )  # fmt: skip
    assert (more.k, more.k_std) == (alone.k, alone.k_std)


def test_a_box_of_two_pixels_is_used_with_little_weight():
    z = [6.0, 600.0]
    model = ims.fit(
        poles([1.7, 1.5], z), relative(z), exact_priors([1.7, 1.5]), method="robust", noise=TOLD
    )
    tall, tiny = model.references
    assert tiny.pixels == pytest.approx(2.0)
    assert tiny.used
    variance = [(1 / 226.6666666666667) ** 2 + 0.05**2, (1 / 2.0) ** 2 + 0.05**2]
    assert tiny.weight / tall.weight == pytest.approx(variance[0] / variance[1], rel=1e-6)
    assert tiny.weight < 0.02


@pytest.mark.parametrize("method", METHODS)
def test_duplicate_detections_are_lawful(method):
    priors = exact_priors([1.7], 0.1)
    model = ims.fit(poles([1.7], [6.0]) * 2, relative([6.0, 6.0]), priors, method=method)
    assert model.k == pytest.approx(1 / FOCAL, rel=0.01)
    assert model.references[0] == model.references[1]


# --- one detection, one witness ------------------------------------------------------------------


def sign(height_std, width_std):
    return ims.PriorTable(
        [
            ims.ObjectPrior("board x", 1.0, height_std),
            ims.ObjectPrior("board x", 10.0, width_std, axis="width"),
        ]
    )


@pytest.mark.parametrize(
    ("height_std", "width_std", "axis"),
    [
        pytest.param(0.01, 1.0, "height", id="height known better"),
        pytest.param(0.2, 0.1, "width", id="width known better"),
        # 5 % prior and 5 % box add up to 7.1 %, 9 % prior and 0.5 % box to 9.01 %
        pytest.param(0.05, 0.9, "height", id="errors add in quadrature"),
    ],
)
def test_a_detection_is_a_witness_through_its_axis_of_smaller_error(height_std, width_std, axis):
    model = ims.fit([box("board x", 20.0, 200.0)], relative([6.0]), sign(height_std, width_std))
    assert model.references[0].axis == axis
    assert len(model.references) == 1
    size, pixels = (1.0, 20.0) if axis == "height" else (10.0, 200.0)
    assert model.k == pytest.approx(size / (pixels * 6.0), rel=0.03)


def test_a_diameter_is_the_longer_side_of_the_box():
    priors = ims.PriorTable([ims.ObjectPrior("disc x", 0.6, 0.0, axis="diameter")])
    for height, width in ((60.0, 25.0), (25.0, 60.0)):
        model = ims.fit([box("disc x", height, width)], relative([4.0]), priors)
        assert model.k == pytest.approx(0.6 / (60 * 4), rel=1e-12)


# --- plausibility --------------------------------------------------------------------------------

INDOORS = np.array([1.5, 2.0, 3.0, 4.0])


@pytest.mark.parametrize(
    "depth",
    [
        pytest.param(1000 * INDOORS, id="millimetres"),
        pytest.param(100 * INDOORS, id="centimetres"),
        pytest.param(256 * INDOORS, id="raw uint16 of KITTI"),
        pytest.param(1200 * 0.2 / INDOORS, id="disparity of a small stereo rig"),
    ],
)
def test_metric_depth_of_a_wrong_unit_is_flagged(depth):
    model = ims.fit(
        poles([0.5, 0.7, 0.9, 1.1], INDOORS, focal=1200.0),
        ims.ObjectDepths(depth, kind="metric", image_size=SIZE),
        exact_priors([0.5, 0.7, 0.9, 1.1], std_m=0.05),
    )
    assert Flag.IMPLAUSIBLE_FOCAL in model.flags


def test_priors_in_centimetres_are_flagged():
    model = ims.fit(
        poles([0.5, 0.7], [2.0, 3.0]),
        ims.ObjectDepths([2.0, 3.0], kind="metric", image_size=SIZE),
        exact_priors([50.0, 70.0], std_m=5.0),
    )
    assert Flag.IMPLAUSIBLE_FOCAL in model.flags


@pytest.mark.parametrize("seed", range(5))
def test_kitti_like_disparity_taken_as_metric_depth_is_flagged(seed):
    # at 20 m the disparity is about 20 px: the focal length alone cannot give it away
    rng = np.random.default_rng(seed)
    z = rng.uniform(6, 40, 10)
    heights = rng.uniform(1.4, 1.9, 10)
    model = ims.fit(
        poles(heights, z, focal=721.5),
        ims.ObjectDepths(721.5 * 0.54 / z, kind="metric", image_size=SIZE),
        exact_priors(heights, std_m=0.1),
    )
    assert model.flags & (Flag.IMPLAUSIBLE_FOCAL | Flag.INCONSISTENT)


@pytest.mark.parametrize(
    ("focal", "implausible"),
    [(0.25, True), (0.35, False), (1.0, False), (5.5, False), (6.5, True)],
)
def test_plausible_focal_lengths_are_a_third_to_six_image_sides(focal, implausible):
    model = ims.fit(
        poles([0.2, 0.3], [2.0, 3.0], focal=focal * max(SIZE)),
        ims.ObjectDepths([2.0, 3.0], kind="metric", image_size=(2000, 1500)),
        exact_priors([0.2, 0.3]),
    )
    assert (Flag.IMPLAUSIBLE_FOCAL in model.flags) is implausible


def test_without_metric_depth_no_focal_length_is_judged():
    heights, z = [0.5, 0.7], np.array([2000.0, 3000.0])
    detections, priors = poles(heights, z / 1000), exact_priors(heights)
    for depth in (
        relative(z, image_size=SIZE),
        ims.ObjectDepths(1 / z, kind="inverse", image_size=SIZE),
    ):
        assert ims.fit(detections, depth, priors).flags == Flag(0)


# --- the camera as a witness ---------------------------------------------------------------------


def camera(focal=FOCAL, rel_std=0.0, **options):
    return ims.Camera(focal, focal_rel_std=rel_std, **options)


def metric_map(z, **options):
    return ims.DepthMap(np.full((30, 40), z), kind="metric", image_size=SIZE, **options)


@pytest.mark.parametrize("scale_rel_std", [0.0, 0.15])
def test_camera_and_references_meet_at_their_precision_weighted_mean(scale_rel_std):
    # a discrepancy of 1e-5: robust weights are 1 to 1e-8
    discrepancy, focal_rel_std, spread = 1e-5, 0.02, 0.1
    model = ims.fit(
        poles([1.7], [6.0]), metric_map(6.0, scale_rel_std=scale_rel_std),
        ims.PriorTable([ims.ObjectPrior("pole 0", 1.7, 0.0, mean_std_m=1.7 * spread)]),
        camera=camera(FOCAL * math.exp(-discrepancy), focal_rel_std),
        noise=ims.Noise(box_px=0.0, depth_rel=0.0), method="robust",
    )  # fmt: skip
    of_camera = 1 / (focal_rel_std**2 + scale_rel_std**2)
    of_pole = 1 / spread**2
    expected = discrepancy * of_camera / (of_camera + of_pole)
    assert math.log(model.k * FOCAL) == pytest.approx(expected, rel=1e-4)
    assert log_std(model) ** -2 == pytest.approx(of_camera + of_pole, rel=1e-6)
    assert model.references[0].weight == pytest.approx(of_pole / (of_camera + of_pole), rel=1e-6)


@pytest.mark.parametrize("method", FITTED)
@pytest.mark.parametrize(("focal_std", "scale_std"), [(0.0, 0.0), (0.04, 0.0), (0.04, 0.15)])
def test_a_camera_alone_gives_k_with_its_own_and_the_maps_scale_error(focal_std, scale_std, method):
    model = ims.fit(
        [box("thing", 80.0)], metric_map(6.0, scale_rel_std=scale_std), exact_priors([1.7]),
        camera=camera(FOCAL, focal_std), method=method,
    )  # fmt: skip
    assert model.k == pytest.approx(1 / FOCAL, rel=1e-12)
    assert log_std(model) == pytest.approx(
        math.hypot(focal_std, scale_std), rel=STD_TOLERANCE[method], abs=2e-6
    )
    assert math.isnan(model.mean_depth)
    assert model.flags == Flag(0)


@pytest.mark.parametrize("method", FITTED)
def test_a_camera_alone_needs_no_detection(method):
    model = ims.fit([], metric_map(6.0), camera=camera(), method=method)
    assert model.k == pytest.approx(1 / FOCAL, rel=1e-12)
    assert model.references == ()


@pytest.mark.parametrize("method", FITTED)
@pytest.mark.parametrize("kind", ["relative", "inverse"])
def test_a_camera_says_nothing_of_k_where_depth_has_no_scale(kind, method):
    depth = ims.ObjectDepths([6.0], kind=kind)
    told, untold = (
        ims.fit(poles([1.7], [6.0]), depth, exact_priors([1.7]), camera=given, method=method)
        for given in (camera(5.0), None)
    )
    assert (told.k, told.k_std) == (untold.k, untold.k_std)
    assert not told.camera_is_witness
    with pytest.raises(ims.FitError, match="at least one reference"):
        ims.fit([], ims.ObjectDepths([], kind=kind), camera=camera(), method=method)


@pytest.mark.parametrize("method", ["mean_ratio", "least_squares"])
def test_the_papers_methods_take_no_camera_as_witness(method):
    depth = ims.ObjectDepths([6.0], kind="metric")
    model = ims.fit(
        poles([1.7], [6.0]), depth, exact_priors([1.7]), camera=camera(5.0), method=method
    )
    assert model.k == pytest.approx(1 / FOCAL, rel=1e-12)
    assert not model.camera_is_witness


@pytest.mark.parametrize("method", FITTED)
@pytest.mark.parametrize("rel_std", [0.0, 0.01, 0.02, 0.04])
@pytest.mark.parametrize("factor", [0.7, 1.3, 1.5, 3.0])
def test_a_stale_focal_length_contradicting_five_references_is_flagged(rel_std, factor, method):
    # five labels, each within 6 %: together 2.6 %, so that 1.3 is 5 to 10 standard errors away
    heights, z = [1.7, 1.6, 1.8, 1.5, 2.0], [8.0, 10.0, 12.0, 15.0, 20.0]
    model = ims.fit(
        poles(heights, z), ims.ObjectDepths(z, kind="metric"), exact_priors(heights, std_m=0.05),
        camera=camera(factor * FOCAL, rel_std), method=method,
    )  # fmt: skip
    assert Flag.CAMERA_CONFLICT in model.flags


@pytest.mark.parametrize("method", FITTED)
@pytest.mark.parametrize("rel_std", [0.0, 0.02, 0.04])
def test_an_agreeing_focal_length_raises_no_conflict(rel_std, method):
    heights, z = [1.7, 1.6, 1.8], [8.0, 10.0, 12.0]
    model = ims.fit(
        poles(heights, z), ims.ObjectDepths(z, kind="metric"), exact_priors(heights, std_m=0.05),
        camera=camera(1.02 * FOCAL, rel_std), method=method,
    )  # fmt: skip
    assert model.flags == Flag(0)
    assert model.camera_is_witness


# --- hostile input -------------------------------------------------------------------------------

ONE = poles([1.7], [6.0])
ONE_DEPTH = relative([6.0])
ONE_PRIOR = exact_priors([1.7])


@pytest.mark.parametrize(
    ("detections", "depth", "seen"),
    [
        pytest.param([], relative([]), r"got no detection\.$", id="empty list"),
        pytest.param(
            [box("thing", 50.0)], ONE_DEPTH,
            r"got thing \(no prior\)\. Add sizes with PriorTable\.default\(\)\.with_prior\(",
            id="no prior at all",
        ),
        pytest.param(
            [box("pole 0", 50.0, partial=True)] * 2, relative([6.0, 6.0]),
            r"got pole 0 1 \(partial\), pole 0 2 \(partial\)\. Partial objects", id="all partial",
        ),
        pytest.param(
            ONE, relative([NAN]), r"got pole 0 \(no depth\)\. Check.*valid depth",
            id="all depths NaN",
        ),
        pytest.param(
            [box("thing", 50.0)] * 7, relative([6.0] * 7), "and 2 more", id="long list is cut"
        ),
    ],
)  # fmt: skip
@pytest.mark.parametrize("method", METHODS)
def test_without_a_reference_the_error_says_what_was_seen(detections, depth, seen, method):
    with pytest.raises(ims.FitError, match=seen):
        ims.fit(detections, depth, ONE_PRIOR, method=method)


def test_a_map_without_depth_on_any_object_gives_no_reference():
    values = np.full((30, 40), NAN)
    values[-1, -1] = 5.0
    depth = ims.DepthMap(values, kind="relative", image_size=SIZE)
    with pytest.raises(ims.FitError, match=r"pole 0 \(no depth\)"):
        ims.fit(ONE, depth, ONE_PRIOR)


@pytest.mark.parametrize(
    "raw", [[6.0], (6.0,), np.array([6.0]), None], ids=["list", "tuple", "array", "None"]
)
def test_raw_depth_is_refused_with_the_remedy(raw):
    with pytest.raises(TypeError, match=r"ObjectDepths\(values, kind=\.\.\.\)"):
        ims.fit(ONE, raw, ONE_PRIOR)


@pytest.mark.parametrize(
    ("depth", "message"),
    [
        pytest.param(relative([6.0, 7.0]), "one value per detection, 1; got 2", id="too many"),
        pytest.param(relative([]), "one value per detection, 1; got 0", id="too few"),
    ],
)  # fmt: skip
def test_depth_that_cannot_be_fitted_is_refused(depth, message):
    with pytest.raises(ValueError, match=message):
        ims.fit(ONE, depth, ONE_PRIOR)


def affine(values, **options):
    return ims.ObjectDepths(values, kind="affine_inverse", **options)


@pytest.mark.parametrize("method", FITTED)
@pytest.mark.parametrize(
    ("detections", "depth", "count"),
    [
        pytest.param(
            ONE, ims.DepthMap(np.full((30, 40), 6.0), kind="affine_inverse", image_size=SIZE), 1,
            id="one on a map",
        ),
        pytest.param(ONE, affine([6.0]), 1, id="one object"),
        pytest.param(ONE * 2, affine([6.0, 6.0]), 2, id="two at one depth"),
        pytest.param([*ONE, box("thing", 9.0)], affine([6.0, 3.0]), 1, id="the other unknown"),
    ],
)  # fmt: skip
def test_a_shift_is_not_fitted_to_references_at_one_depth(detections, depth, count, method):
    with pytest.raises(ims.FitError, match=f"at different depths.*got {count} at 6"):
        ims.fit(detections, depth, ONE_PRIOR, method=method)


@pytest.mark.parametrize("method", ["mean_ratio", "least_squares"])
@pytest.mark.parametrize(
    ("depth", "kind"),
    [(affine([6.0, 3.0]), "affine_inverse"), (ims.GroundPlane(image_size=SIZE), "ground_plane")],
    ids=["affine", "ground plane"],
)
def test_the_papers_methods_fit_no_shift(depth, kind, method):
    message = f'`method` must be "posterior" or "robust".*"{kind}".*got "{method}"'
    with pytest.raises(ValueError, match=message):
        ims.fit(ONE * 2, depth, ONE_PRIOR, method=method)


@pytest.mark.parametrize("method", FITTED)
def test_a_ground_plane_is_depth_like_any_other(method):
    detection = box("pole 0", 400.0, top=700.0)
    model = ims.fit([detection], ims.GroundPlane(image_size=SIZE), ONE_PRIOR, method=method)
    assert model.kind == "ground_plane"
    assert model.references[0].used
    # p / H = (y - y0) / k, but for what the priors of height and horizon draw: 1e-3 or so
    assert (1100 - model.horizon_px) / model.k == pytest.approx(400 / 1.7, rel=5e-3)


@pytest.mark.parametrize(
    "depth",
    [
        pytest.param(relative([6.0, 6.0], image_size=(100, 100)), id="ObjectDepths"),
        pytest.param(ims.DepthMap(np.full((100, 100), 6.0), kind="relative"), id="DepthMap"),
    ],
)
def test_a_box_outside_the_image_names_the_remedy(depth):
    detections = [box("pole 0", 40.0), box("pole 0", 400.0)]
    with pytest.raises(ValueError, match=r"100 x 100 px.*at index 1.*image_size=\(width, height\)"):
        ims.fit(detections, depth, ONE_PRIOR)


def test_a_mask_of_another_shape_is_refused():
    detection = box("pole 0", 40.0, mask=np.ones((90, 100), dtype=bool))
    depth = ims.DepthMap(np.full((100, 100), 6.0), kind="relative")
    with pytest.raises(ValueError, match=r"`mask`.*\(100, 100\); got \(90, 100\) at index 0"):
        ims.fit([detection], depth, ONE_PRIOR)


@pytest.mark.parametrize("method", ["ransac", "exact", "", None, 3], ids=repr)
def test_an_unknown_method_is_refused_with_the_choices(method):
    choices = '"mean_ratio", "least_squares", "robust", "posterior"'
    with pytest.raises(ValueError, match=f"`method`.*{choices}"):
        ims.fit(ONE, ONE_DEPTH, ONE_PRIOR, method=method)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"priors": [ims.ObjectPrior("pole 0", 1.7, 0.1)]}, "`priors` must be a PriorTable; got l"),
        ({"camera": 800.0}, "`camera` must be a Camera; got float"),
        ({"noise": None}, "`noise` must be a Noise; got NoneType"),
        ({"noise": 0.1}, "`noise` must be a Noise; got float"),
        ({"ground": SIZE}, "`ground` must be a GroundPlane; got tuple"),
        ({"ground": True}, "`ground` must be a GroundPlane; got bool"),
        ({"ground": ONE_DEPTH}, "`ground` must be a GroundPlane; got ObjectDepths"),
    ],
    ids=[
        "priors as a list",
        "camera as a number",
        "noise None",
        "noise as a number",
        "ground as a size",
        "ground as a switch",
        "ground as depth",
    ],
)
def test_options_of_a_wrong_type_are_refused(options, message):
    with pytest.raises(TypeError, match=message):
        ims.fit(ONE, ONE_DEPTH, **({"priors": ONE_PRIOR} | options))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"ground": ims.GroundPlane(image_size=(640, 480))},
            r"`ground\.image_size`.*\(2000, 1500\); got \(640, 480\)",
        ),
        (
            {"ground": ims.GroundPlane(image_size=SIZE), "method": "mean_ratio"},
            '`ground` must be None for method "mean_ratio"',
        ),
        (
            {"ground": ims.GroundPlane(image_size=SIZE), "method": "least_squares"},
            '`ground` must be None for method "least_squares"',
        ),
        (
            {"camera": camera(image_size=(640, 480))},
            r"`camera\.image_size`.*\(2000, 1500\); got \(640, 480\)",
        ),
    ],
    ids=["ground of another picture", "mean ratio", "least squares", "camera of another picture"],
)
def test_options_that_break_their_law_are_refused(options, message):
    depth = relative([6.0], image_size=SIZE)
    with pytest.raises(ValueError, match=message):
        ims.fit(ONE, depth, ONE_PRIOR, **options)


def test_camera_and_ground_of_two_pictures_are_refused():
    options = {
        "camera": camera(image_size=(640, 480)),
        "ground": ims.GroundPlane(image_size=SIZE),
    }
    with pytest.raises(ValueError, match=r"`camera\.image_size`.*\(2000, 1500\); got \(640, 480\)"):
        ims.fit(ONE, ONE_DEPTH, ONE_PRIOR, **options)


def test_a_ground_plane_is_depth_or_second_witness_but_not_both():
    plane = ims.GroundPlane(image_size=SIZE)
    with pytest.raises(ValueError, match="`ground` must be None where `depth` is the GroundPlane"):
        ims.fit(ONE, plane, ONE_PRIOR, ground=plane)


@pytest.mark.parametrize("item", [("pole 0", (1, 2, 3, 4)), None, "pole 0"], ids=repr)
def test_something_that_is_no_detection_is_named_with_its_place(item):
    with pytest.raises(TypeError, match=r"`detections` must hold Detection objects.*at index 1"):
        ims.fit([*ONE, item], relative([6.0, 6.0]), ONE_PRIOR)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("magnitude", [1e-9, 1e-3, 1e6, 1e12])
def test_extreme_units_of_depth_do_no_harm(magnitude, method):
    priors = exact_priors(HEIGHTS, std_m=0.02)
    model = ims.fit(poles(HEIGHTS, Z), relative(magnitude * Z), priors, method=method)
    assert model.k == pytest.approx(1 / (magnitude * FOCAL), rel=1e-2)
    assert 0 < log_std(model) < 0.1


def test_the_default_table_is_the_shipped_one():
    model = ims.fit([box("Credit_Card", 54.0, 85.0)], relative([1.0]))
    assert model.priors == ims.PriorTable.default()
    assert model.references[0].used


def renamed(objects, label):
    """Call some objects by a name that no table knows, with their own as an alias."""
    return [
        attrs.evolve(d, label="thing", aliases=(label,)) if d.label == label else d for d in objects
    ]


def test_aliases_serve_in_frames_on_the_ground_and_at_centres_as_labels_do():
    lamp = ims.ObjectPrior("lamp", 0.4, 0.02, on_ground=False)
    car = ims.ObjectPrior("car", 1.5, 0.1, mean_std_m=0.05, depth_extent_m=4.0)
    table = ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.02), lamp, car])
    objects = [
        ims.Detection("door", (310, 244, 388, 476)),
        ims.Detection("door", (840, 252, 880, 380)),
        ims.Detection("car", (520, 269, 700, 407)),
        ims.Detection("lamp", (930, 209, 960, 240)),
    ]
    centres = ims.ObjectDepths([9.0, 16.0, 13.0, 20.0], kind="metric", depth_at="centre")
    plane = ims.GroundPlane(image_size=(1280, 720))
    for label in ("car", "lamp", "door"):
        others = renamed(objects, label)
        for depth in (centres, plane):
            one, other = (ims.fit(seen, depth, table) for seen in (objects, others))
            assert (other.k, other.k_std) == (one.k, one.k_std)
            assert [r.reason for r in other.references] == [r.reason for r in one.references]
        frames = [[ims.Frame(seen, centres)] * 3 for seen in (objects, others)]
        one, other = (ims.fit_shared(group, table)[0] for group in frames)
        assert (other.k, other.k_std) == pytest.approx((one.k, one.k_std), rel=1e-12)
    assert one.k_std > 0


# --- what comes back ---


def test_what_a_detection_said_cannot_be_changed():
    reference = ims.fit(poles(HEIGHTS, Z), relative(Z), exact_priors(HEIGHTS)).references[0]
    for name in ("k", "reason", "remark"):
        with pytest.raises(attrs.exceptions.FrozenInstanceError):
            setattr(reference, name, 0.0)
    with pytest.raises(attrs.exceptions.FrozenInstanceError):
        del reference.k


def test_what_a_detection_said_survives_a_pickle():
    detections = [*poles(HEIGHTS, Z), box("statue", 50.0)]
    model = ims.fit(detections, relative([*Z, NAN]), exact_priors(HEIGHTS, 0.1))
    clone = pickle.loads(pickle.dumps(model))  # noqa: S301 - our own bytes
    assert clone == model
    assert [hash(ref) for ref in clone.references] == [hash(ref) for ref in model.references]


@pytest.mark.parametrize("method", METHODS)
def test_threads_that_fit_at_once_with_a_new_table_find_the_same(method):
    detections, depth = poles(HEIGHTS, Z), relative(Z)
    table, told = exact_priors(HEIGHTS, 0.1), exact_priors(HEIGHTS, 0.1)
    expected = ims.fit(detections, depth, told, method=method)
    start, found = threading.Barrier(8), []

    def run():
        start.wait()
        found.append(ims.fit(detections, depth, table, method=method))

    threads = [threading.Thread(target=run) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [expected] * 8
