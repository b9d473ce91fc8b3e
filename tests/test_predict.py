"""The verb `predict`: closed forms, the dense joint Gaussian, calibration, flags and errors."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import imgscale as ims
from imgscale import Flag

FOCAL = 800.0
SIZE = (2000, 1500)
NAN = math.nan
FITTED = ["robust", "posterior"]


def box(label, height, width=40.0, *, left=50.0, top=20.0, **options):
    return ims.Detection(label, (left, top, left + width, top + height), **options)


def relative(values, **options):
    return ims.ObjectDepths(values, kind="relative", **options)


def table(*rows):
    return ims.PriorTable(
        [ims.ObjectPrior(label, mean, std, mean_std_m=tau) for label, mean, std, tau in rows]
    )


POLE = table(("pole", 1.7, 0.1, 0.05))
ONE = [box("pole", FOCAL * 1.7 / 6.0)]
ONE_DEPTH = relative([6.0])


def log_std(estimate):
    return estimate.std_m / estimate.size_m


def model_log_std(model):
    return model.k_std / model.k


# --- closed forms --------------------------------------------------------------------------------


@given(
    height=st.floats(1, 1000), depth=st.floats(0.01, 1e4), reference=st.floats(10, 1000),
    kind=st.sampled_from(["metric", "relative", "inverse"]),
    method=st.sampled_from(["mean_ratio", "least_squares", *FITTED]),
)  # fmt: skip
@settings(max_examples=80, deadline=None)
def test_an_unknown_object_has_size_k_times_d_times_p(height, depth, reference, kind, method):
    detections = [box("pole", reference), box("thing", height)]
    depths = ims.ObjectDepths([3.0, depth], kind=kind)
    model = ims.fit(detections, depths, POLE, method=method)
    estimate = ims.predict(model, detections, depths)[1]
    distance = 1 / depth if kind == "inverse" else depth
    assert estimate.size_m == pytest.approx(model.k * distance * height, rel=1e-12)
    assert estimate.metres_per_pixel == pytest.approx(model.k * distance, rel=1e-12)
    assert estimate.depth == depth
    assert estimate.flags == Flag(0)


@pytest.mark.parametrize("method", FITTED)
@pytest.mark.parametrize("use_prior", [False, True])
def test_an_affine_object_has_the_size_of_its_shifted_inverse_depth(use_prior, method):
    z, heights = np.array([4.0, 6.0, 9.0, 15.0, 7.0]), np.array([1.7, 1.7, 1.7, 1.7, 0.9])
    detections = [
        box("pole" if i < 4 else "thing", FOCAL * h / d)
        for i, (h, d) in enumerate(zip(heights, z, strict=True))
    ]
    depths = ims.ObjectDepths(60 / z - 2.0, kind="affine_inverse", rel_std=0.01)
    model = ims.fit(detections, depths, POLE, method=method)
    estimate = ims.predict(model, detections, depths, use_prior=use_prior)[-1]
    distance = 1 / (60 / 7.0 - 2.0 + model.shift)
    assert estimate.size_m == pytest.approx(
        model.k * distance * detections[-1].height_px, rel=1e-12
    )
    assert model.shift == pytest.approx(2.0, abs=3 * model.shift_std)
    low, high = estimate.interval(0.95)
    assert low < 0.9 < high
    assert estimate.flags == Flag(0)


def test_an_unknown_objects_error_adds_k_box_and_depth():
    noise = ims.Noise(box_px=2.0, box_rel=0.03, depth_rel=0.04)
    model = ims.fit(ONE, ONE_DEPTH, POLE, noise=noise, method="robust")
    [estimate] = ims.predict(model, [box("thing", 50.0)], relative([9.0], rel_std=0.05))
    variance = model_log_std(model) ** 2 + (2 / 50) ** 2 + 0.03**2 + 0.04**2 + 0.05**2
    assert log_std(estimate) == pytest.approx(math.sqrt(variance), rel=1e-12)


@pytest.mark.parametrize("level", [0.5, 0.9, 0.99])
def test_the_interval_is_the_log_normal_one(level):
    noise = ims.Noise(depth_rel=0.05)
    model = ims.fit(ONE, ONE_DEPTH, POLE, method="robust", noise=noise)
    [estimate] = ims.predict(model, [box("thing", 50.0)], relative([9.0]))
    low, high = estimate.interval(level)
    quantile = math.log(high / estimate.size_m) / log_std(estimate)
    assert math.erf(quantile / math.sqrt(2)) == pytest.approx(level, rel=1e-9)
    assert low * high == pytest.approx(estimate.size_m**2, rel=1e-12)
    assert estimate.quantiles_m is None


@pytest.mark.parametrize("method", FITTED)
def test_intervals_are_those_of_the_quantiles_where_the_size_is_not_log_normal(method):
    model = ims.fit(ONE, ONE_DEPTH, POLE, method=method)
    [estimate] = ims.predict(model, [box("thing", 50.0)], relative([9.0]))
    scores = np.linspace(-3.5, 3.5, 29)
    assert len(estimate.quantiles_m) == 29
    assert np.all(np.diff(estimate.quantiles_m) > 0)
    for score, i in ((1.0, 18), (2.0, 22), (3.5, 28)):
        assert scores[i] == score
        ends = estimate.interval(math.erf(score / math.sqrt(2)))
        wanted = estimate.quantiles_m[28 - i], estimate.quantiles_m[i]
        assert ends == pytest.approx(wanted, rel=1e-9)
    one = math.log(estimate.quantiles_m[18] / estimate.quantiles_m[10]) / 2
    assert log_std(estimate) == pytest.approx(one, rel=1e-12)


@pytest.mark.parametrize("axis", ["height", "width", "diameter"])
def test_each_axis_measures_its_side_of_the_box(axis):
    model = ims.fit(ONE, ONE_DEPTH, POLE)
    pixels = {"height": (30.0, 70.0), "width": (80.0, 20.0), "diameter": (80.0, 70.0)}[axis]
    detections = [box("thing", 30.0, 80.0), box("thing", 70.0, 20.0)]
    for estimate, p in zip(
        ims.predict(model, detections, relative([9.0, 9.0]), axis=axis), pixels, strict=True
    ):
        assert estimate.size_m == pytest.approx(model.k * 9.0 * p, rel=1e-12)
        assert estimate.axis == axis


def test_estimates_keep_length_order_and_labels():
    detections = [box("b", 30.0), *ONE, box("a", 10.0), box("b", 50.0)]
    depth = relative([1.0, 6.0, NAN, 2.0])
    model = ims.fit(detections, depth, POLE)
    estimates = ims.predict(model, detections, depth)
    assert [e.label for e in estimates] == ["b", "pole", "a", "b"]
    assert ims.predict(model, [], relative([])) == []


def test_a_row_without_depth_is_nan_and_flagged():
    detections = [*ONE, box("thing", 30.0)]
    depth = ims.ObjectDepths([6.0, NAN], kind="metric")
    model = ims.fit(detections, depth, POLE)
    known, unknown = ims.predict(model, detections, depth)
    assert unknown.flags == Flag.NO_DEPTH
    values = [
        unknown.size_m, unknown.std_m, unknown.metres_per_pixel, unknown.depth,
        unknown.distance_m, *unknown.interval(),
    ]  # fmt: skip
    assert np.isnan(values).all()
    assert math.isfinite(known.size_m)


# --- distance ------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["relative", "inverse"])
def test_without_a_focal_length_there_is_no_distance(kind):
    depth = ims.ObjectDepths([6.0], kind=kind)
    model = ims.fit(ONE, depth, POLE)
    assert ims.predict(model, ONE, depth)[0].distance_m is None


def test_metric_depth_is_its_own_distance():
    depth = ims.ObjectDepths([6.0, 11.0], kind="metric")
    detections = [*ONE, box("thing", 30.0)]
    model = ims.fit(detections, depth, POLE)
    distances = [e.distance_m for e in ims.predict(model, detections, depth)]
    assert distances == pytest.approx([6.0, 11.0], rel=1e-12)


@pytest.mark.parametrize("kind", ["relative", "inverse"])
def test_with_a_camera_the_distance_is_focal_length_times_scale(kind):
    depth = ims.ObjectDepths([6.0, 11.0], kind=kind)
    detections = [*ONE, box("thing", 30.0)]
    model = ims.fit(detections, depth, POLE, camera=ims.Camera(640.0, focal_rel_std=0.1))
    for e in ims.predict(model, detections, depth):
        assert e.distance_m == pytest.approx(640.0 * e.metres_per_pixel, rel=1e-12)
        assert e.distance_m == pytest.approx(640.0 * e.size_m / (e.size_m / e.metres_per_pixel))


@pytest.mark.parametrize(
    ("scale_rel_std", "focal_rel_std", "map_takes"),
    [(0.0, 0.06, 0.0), (0.15, 0.0, 1.0), (0.15, 0.15, 0.5), (0.0, 0.0, 0.0)],
)
def test_metric_distances_are_corrected_by_what_the_map_itself_may_err(
    scale_rel_std, focal_rel_std, map_takes
):
    # f k = scale error of the map / error of the focal length: each takes its share of the log
    depth = ims.DepthMap(
        np.full((150, 200), 6.0), kind="metric", image_size=SIZE, scale_rel_std=scale_rel_std
    )
    camera = ims.Camera(640.0, focal_rel_std=focal_rel_std)
    model = ims.fit(ONE, depth, POLE, camera=camera)
    [estimate] = ims.predict(model, [box("thing", 30.0)], depth)
    assert estimate.distance_m == pytest.approx(6.0 * (640.0 * model.k) ** map_takes, rel=1e-12)


# --- references ----------------------------------------------------------------------------------


@pytest.mark.parametrize("depth_rel", [0.05, 0.2, None], ids=["5 %", "20 %", "unknown"])
@pytest.mark.parametrize("method", FITTED)
@pytest.mark.parametrize("use_prior", [False, True], ids=["measured", "fused"])
def test_a_single_reference_is_its_prior_neither_wider_nor_narrower(use_prior, method, depth_rel):
    noise = ims.Noise(box_px=3.0, box_rel=0.02, depth_rel=depth_rel)
    model = ims.fit(ONE, ONE_DEPTH, POLE, noise=noise, method=method)
    [estimate] = ims.predict(model, ONE, ONE_DEPTH, use_prior=use_prior)
    spread = math.log(1 + (0.1 / 1.7) ** 2)
    exact = method == "robust" or not use_prior
    assert estimate.size_m == pytest.approx(
        1.7 * math.exp(-spread / 2), rel=1e-12 if exact else 1e-7
    )
    # a posterior holds also that the one reference may be wrong, with 5 %
    tolerance = 1e-9 if method == "robust" else 1e-3 if use_prior else 0.06
    assert log_std(estimate) == pytest.approx(
        math.hypot(math.sqrt(spread), 0.05 / 1.7), rel=tolerance
    )
    assert Flag.REFERENCE in estimate.flags


def test_a_reference_is_recognised_by_label_box_and_depth_only():
    detections = [*ONE, box("thing", 30.0)]
    model = ims.fit(detections, relative([6.0, 5.0]), POLE)
    same_but = {
        "itself": (ONE[0], 6.0, True),
        "another depth": (ONE[0], 6.1, False),
        "another box": (box("pole", 100.0), 6.0, False),
        "another label": (box("thing", FOCAL * 1.7 / 6.0), 6.0, False),
        "no reference": (detections[1], 5.0, False),
    }
    for detection, depth, is_reference in same_but.values():
        [estimate] = ims.predict(model, [detection], relative([depth]))
        assert (Flag.REFERENCE in estimate.flags) is is_reference


@pytest.mark.parametrize("method", FITTED)
def test_duplicate_detections_are_both_references_with_equal_rows(method):
    depth = relative([6.0, 6.0])
    model = ims.fit(ONE * 2, depth, POLE, method=method)
    a, b = ims.predict(model, ONE * 2, depth)
    assert a == b
    assert Flag.REFERENCE in a.flags


def test_the_other_side_of_a_reference_shares_its_depth_error_with_k():
    # k rests on the width of this board; in its height the error of its depth cancels
    priors = ims.PriorTable([ims.ObjectPrior("board x", 3.0, 0.06, axis="width")])
    board, depth = [box("board x", 100.0, 300.0)], relative([5.0], rel_std=0.1)
    noise = ims.Noise(box_px=1.5)
    model = ims.fit(board, depth, priors, noise=noise, method="robust")
    [height] = ims.predict(model, board, depth, axis="height")
    variance = math.log(1 + 0.02**2) + (1.5 / 300) ** 2 + (1.5 / 100) ** 2
    assert height.size_m == pytest.approx(1.0, rel=1e-3)
    assert log_std(height) == pytest.approx(math.sqrt(variance), rel=1e-9)
    assert Flag.REFERENCE in height.flags


def test_partial_objects_are_measured_and_flagged():
    detections = [
        *ONE,
        box("pole", 100.0, partial=True),
        box("thing", 100.0, left=0.0),
        box("thing", 100.0, left=9.0),
    ]
    depth = relative([6.0] * 4, image_size=SIZE)
    model = ims.fit(detections, depth, POLE)
    flags = [e.flags for e in ims.predict(model, detections, depth)]
    assert flags == [Flag.REFERENCE, Flag.PARTIAL, Flag.PARTIAL, Flag(0)]
    told_by_model = ims.predict(model, detections, relative([6.0] * 4))
    assert [e.flags for e in told_by_model] == flags
    unframed = ims.fit(detections, relative([6.0] * 4), POLE)
    estimates = ims.predict(unframed, detections, relative([6.0] * 4))
    assert [Flag.PARTIAL in e.flags for e in estimates] == [False, True, False, False]


def test_two_surfaces_in_one_box_are_flagged():
    values = np.full((150, 200), 6.0)
    values[:, 100:] = 12.0
    depth = ims.DepthMap(values, kind="relative", image_size=SIZE)
    detections = [*ONE, box("thing", 100.0, 200.0, left=900.0)]
    model = ims.fit(detections, depth, POLE)
    assert [e.flags for e in ims.predict(model, detections, depth)] == [
        Flag.REFERENCE,
        Flag.MIXED_DEPTH,
    ]


# --- the dense joint Gaussian --------------------------------------------------------------------

LABELS = ["pole a", "pole a", "pole a", "pole b", "pole b", "pole c"]
PRIORS = {
    "pole a": (1.7, 0.12, 0.06),
    "pole b": (0.9, 0.05, 0.05),
    "pole c": (2.4, 0.2, 0.08),
    "pole d": (1.3, 0.1, 0.07),
}
DENSE_TABLE = table(*((label, *row) for label, row in PRIORS.items()))
NOISE = ims.Noise(box_px=1.5, box_rel=0.01, depth_rel=0.04)


def prior_of(label):
    mean, std, tau = PRIORS[label]
    variance = math.log(1 + (std / mean) ** 2)
    return math.log(mean) - variance / 2, variance, tau / mean


def noise_variance(pixels):
    return (1.5 / pixels) ** 2 + 0.01**2 + 0.04**2


def dense_scene(seed, residual):
    """References `residual` standard deviations off, in the order of LABELS."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(5, 20, len(LABELS))
    log_heights = [prior_of(label)[0] + residual * 0.1 * rng.normal() for label in LABELS]
    pixels = FOCAL * np.exp(log_heights) / z
    detections = [
        box(label, p, left=60.0 * i + 20)
        for i, (label, p) in enumerate(zip(LABELS, pixels, strict=True))
    ]
    return detections, z


def dense_log_size(objects, target, weights=None, *, with_prior=True):
    """
    Mean and variance of log size of objects[target], from the whole joint Gaussian at once.

    Unknowns: log k (flat), one deviation per label, one log height per object. Factors: labels'
    deviations, heights about their label's mean, measurements log h = log k + log(d p) + noise.
    The first len(LABELS) objects are references; `weights` replaces their precision.
    """
    labels = sorted({label for label, _, _ in objects if label in PRIORS})
    count = 1 + len(labels) + len(objects)
    rows, right = [], []

    def factor(entries, value, std):
        row = np.zeros(count)
        for column, coefficient in entries:
            row[column] = coefficient / std
        rows.append(row)
        right.append(value / std)

    for place, label in enumerate(labels):
        factor([(1 + place, 1.0)], 0.0, prior_of(label)[2])
    for i, (label, d, p) in enumerate(objects):
        height = 1 + len(labels) + i
        spread, noise = (prior_of(label)[1] if label in PRIORS else 0.0), noise_variance(p)
        if weights is not None and i < len(LABELS) and i != target:
            widen = 1 / (weights[i] * (spread + noise))
            spread, noise = widen * spread, widen * noise
        if label in PRIORS and (i != target or with_prior):
            own = [(height, 1.0), (1 + labels.index(label), -1.0)]
            factor(own, prior_of(label)[0], math.sqrt(spread))
        factor([(height, 1.0), (0, -1.0)], math.log(d * p), math.sqrt(noise))
    design = np.array(rows)
    mean = np.linalg.lstsq(design, np.array(right), rcond=None)[0]
    covariance = np.linalg.inv(design.T @ design)
    height = 1 + len(labels) + target
    return mean[height], covariance[height, height]


def as_objects(detections, z):
    return [(d.label, depth, d.height_px) for d, depth in zip(detections, z, strict=True)]


TARGETS = {
    "unknown label": box("thing", 77.0, left=1500.0),
    "known label, not among the references": box("pole d", 77.0, left=1500.0),
    "label among the references": box("pole a", 130.0, left=1500.0),
    "label of a single reference": box("pole c", 130.0, left=1500.0),
}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", TARGETS)
@pytest.mark.parametrize("use_prior", [True, False], ids=["fused", "measured"])
def test_a_new_object_is_the_posterior_of_the_joint_gaussian(name, use_prior, seed):
    # residuals of a thousandth: robust weights are 1 to 1e-6
    detections, z = dense_scene(seed, residual=1e-3)
    target = TARGETS[name]
    model = ims.fit(detections, relative(z), DENSE_TABLE, noise=NOISE, method="robust")
    [estimate] = ims.predict(model, [target], relative([9.0]), use_prior=use_prior)
    objects = [*as_objects(detections, z), (target.label, 9.0, target.height_px)]
    mean, variance = dense_log_size(objects, len(detections), with_prior=use_prior)
    assert math.log(estimate.size_m) == pytest.approx(mean, abs=1e-7)
    assert log_std(estimate) == pytest.approx(math.sqrt(variance), rel=1e-5)
    fused = use_prior and target.label in PRIORS
    assert estimate.flags == (Flag.PRIOR_USED if fused else Flag(0))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("reference", range(len(LABELS)))
def test_a_reference_is_its_row_of_the_joint_gaussian(reference, seed):
    detections, z = dense_scene(seed, residual=1e-3)
    model = ims.fit(detections, relative(z), DENSE_TABLE, noise=NOISE, method="robust")
    estimates = ims.predict(model, detections, relative(z), use_prior=True)
    mean, variance = dense_log_size(as_objects(detections, z), reference)
    assert math.log(estimates[reference].size_m) == pytest.approx(mean, abs=1e-7)
    assert log_std(estimates[reference]) == pytest.approx(math.sqrt(variance), rel=1e-5)
    assert estimates[reference].flags == Flag.REFERENCE | Flag.PRIOR_USED
    assert model.references[reference].posterior_m == pytest.approx(
        estimates[reference].size_m, rel=1e-9
    )


@pytest.mark.parametrize("method", FITTED)
@pytest.mark.parametrize("noise", [NOISE, ims.Noise(box_px=1.5)], ids=["told", "unknown"])
@pytest.mark.parametrize("residual", [1e-3, 1.0, 4.0])
def test_the_fused_size_of_a_reference_is_the_models_posterior(residual, noise, method):
    detections, z = dense_scene(2, residual=residual)
    model = ims.fit(detections, relative(z), DENSE_TABLE, noise=noise, method=method)
    estimates = ims.predict(model, detections, relative(z), use_prior=True)
    used = [pair for pair in zip(estimates, model.references, strict=True) if pair[1].used]
    assert len(used) >= 4
    for estimate, ref in used:
        assert estimate.size_m == pytest.approx(ref.posterior_m, rel=1e-9)
        assert estimate.std_m == pytest.approx(ref.posterior_std_m, rel=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_noisy_references_act_with_the_precision_that_they_kept(seed):
    detections, z = dense_scene(seed, residual=1.0)
    model = ims.fit(detections, relative(z), DENSE_TABLE, noise=NOISE, method="robust")
    weights = tukeys_precisions(model)
    for target in TARGETS.values():
        objects = [*as_objects(detections, z), (target.label, 9.0, target.height_px)]
        mean, variance = dense_log_size(objects, len(detections), weights)
        [estimate] = ims.predict(model, [target], relative([9.0]), use_prior=True)
        assert math.log(estimate.size_m) == pytest.approx(mean, abs=1e-9)
        if target.label in PRIORS:
            assert log_std(estimate) == pytest.approx(math.sqrt(variance), rel=1e-8)


def tukeys_precisions(model):
    """The biweight of each reference about the model's k over its variance; none is widened."""
    precisions = []
    for ref in model.references:
        log_mean, spread, tau = prior_of(ref.label)
        variance = spread + noise_variance(ref.pixels)
        residual = log_mean - math.log(ref.depth * ref.pixels) - math.log(model.k)
        r = residual / (4.685 * math.sqrt(variance + tau**2))
        assert abs(r) < 1
        precisions.append((1 - r**2) ** 2 / variance)
    return precisions


def test_the_measured_size_of_a_reference_shares_its_noise_with_k():
    # error of log k + log(d p): every reference's own deviation and noise, times its share
    detections, z = dense_scene(0, residual=1e-3)
    model = ims.fit(detections, relative(z), DENSE_TABLE, noise=NOISE, method="robust")
    estimates = ims.predict(model, detections, relative(z))
    spread, tau = (np.array([prior_of(label)[i] for label in LABELS]) for i in (1, 2))
    noise = np.array([noise_variance(d.height_px) for d in detections])
    shared = np.equal.outer(LABELS, LABELS) * np.outer(tau, tau)
    inverse = np.linalg.inv(np.diag(spread + noise) + shared)
    share = inverse.sum(axis=1) / inverse.sum()
    for i, estimate in enumerate(estimates):
        of_noise = share - np.eye(len(LABELS))[i]
        variance = share @ (np.diag(spread) + shared) @ share + of_noise**2 @ noise
        assert log_std(estimate) == pytest.approx(math.sqrt(variance), rel=1e-5)
        assert estimate.flags == Flag.REFERENCE


@pytest.mark.parametrize("method", FITTED)
def test_a_known_object_without_depth_is_its_prior_in_the_light_of_its_kind(method):
    detections, z = dense_scene(1, residual=1e-3)
    model = ims.fit(detections, relative(z), DENSE_TABLE, noise=NOISE, method=method)
    [estimate] = ims.predict(model, [box("pole d", 50.0)], relative([NAN]), use_prior=True)
    mean, variance, tau = prior_of("pole d")
    exact = method == "robust"
    assert math.log(estimate.size_m) == pytest.approx(mean, abs=1e-12 if exact else 1e-3)
    assert log_std(estimate) == pytest.approx(
        math.sqrt(variance + tau**2), rel=1e-12 if exact else 1e-3
    )
    assert estimate.flags == Flag.NO_DEPTH | Flag.PRIOR_USED


@pytest.mark.parametrize("method", FITTED)
def test_aliases_share_the_offset_of_their_label(method):
    priors = ims.PriorTable(
        [
            ims.ObjectPrior("pole a", 1.7, 0.05, mean_std_m=0.15, aliases=("post",)),
            ims.ObjectPrior("pole b", 0.9, 0.05, mean_std_m=0.02),
        ]
    )
    detections = [box("pole a", 300.0), box("pole b", 130.0)]
    model = ims.fit(detections, relative([6.0, 6.0]), priors, method=method)
    target = (100.0, 17.0)
    sizes = {
        (round(e.size_m, 12), round(e.std_m, 12))
        for label in ("pole a", "post", "Post", "POLE_A", "pole-a")
        for e in ims.predict(model, [box(label, target[0])], relative([target[1]]), use_prior=True)
    }
    assert len(sizes) == 1


@given(seed=st.integers(0, 2**32 - 1), method=st.sampled_from(FITTED))
@settings(max_examples=60, deadline=None)
def test_fusing_is_never_wider_than_the_prior_alone(seed, method):
    detections, z = dense_scene(seed, residual=1.5)
    model = ims.fit(detections, relative(z), DENSE_TABLE, noise=NOISE, method=method)
    rng = np.random.default_rng(seed)
    targets = [*detections, *(box(label, rng.uniform(3, 900)) for label in PRIORS)]
    depth = relative([*z, *rng.uniform(1, 50, len(PRIORS))])
    for estimate in ims.predict(model, targets, depth, use_prior=True):
        _, variance, tau = prior_of(estimate.label)
        if Flag.PRIOR_USED in estimate.flags:
            assert log_std(estimate) <= math.sqrt(variance + tau**2) * (1 + 1e-9)


@pytest.mark.parametrize("method", FITTED)
def test_an_outliers_prior_is_not_believed(method):
    detections, z = dense_scene(0, residual=0.1)
    odd = box("pole b", detections[3].height_px * 4, left=420.0)
    detections[3] = odd
    model = ims.fit(detections, relative(z), DENSE_TABLE, noise=NOISE, method=method)
    assert model.references[3].reason == "outlier"
    fused = ims.predict(model, detections, relative(z), use_prior=True)[3]
    assert Flag.PRIOR_USED not in fused.flags
    assert fused.size_m == pytest.approx(model.k * z[3] * odd.height_px, rel=1e-12)
    assert fused.size_m == pytest.approx(4 * 0.9, rel=0.15)


# --- calibration ---------------------------------------------------------------------------------


def shows_less(rng):
    """How much less an object shows than its size, as a log: one in twenty is wrong."""
    kind = rng.uniform()
    if kind < 0.02:
        return 0.5 * rng.normal()
    return 0.4 + 0.25 * rng.normal() if kind < 0.05 else 0.0


def simulate(rng, references, targets, noise, *, count, method):
    """
    Yield (model, heights, estimates, fused estimates) of pictures drawn from a method's model.

    For the robust one all references are right, for the posterior one in twenty is wrong.
    """
    labels = [*references, *targets]
    for _ in range(count):
        offset = {label: prior_of(label)[2] * rng.normal() for label in PRIORS}
        heights = np.array(
            [
                rng.uniform(0.5, 3.0)
                if label not in PRIORS
                else math.exp(
                    prior_of(label)[0]
                    + offset[label]
                    + math.sqrt(prior_of(label)[1]) * rng.normal()
                )
                for label in labels
            ]
        )
        z = rng.uniform(5, 25, len(labels))
        pixels = FOCAL * heights / z
        pixels += rng.normal(size=len(labels)) * np.hypot(noise.box_px, noise.box_rel * pixels)
        if method == "posterior":
            pixels[: len(references)] *= np.exp([-shows_less(rng) for _ in references])
        seen = z * np.exp(noise.depth_rel * rng.normal(size=len(labels)))
        detections = [
            box(label, p, left=45.0 * i)
            for i, (label, p) in enumerate(zip(labels, pixels, strict=True))
        ]
        known = len(references)
        model = ims.fit(
            detections[:known], relative(seen[:known]), DENSE_TABLE, noise=noise, method=method
        )
        measured, fused = (
            ims.predict(model, detections, relative(seen), use_prior=use_prior)
            for use_prior in (False, True)
        )
        yield model, heights, measured, fused


def covered(heights, estimates):
    intervals = np.array([estimate.interval(0.9) for estimate in estimates])
    return (intervals[:, 0] <= heights) & (heights <= intervals[:, 1])


@pytest.mark.slow
@pytest.mark.parametrize(
    "references",
    [
        pytest.param(["pole a"], id="one reference"),
        pytest.param(["pole a", "pole b"], id="two labels"),
        pytest.param(["pole a"] * 3 + ["pole b"] * 2 + ["pole c"], id="three labels"),
    ],
)
@pytest.mark.parametrize("method", FITTED)
def test_ninety_percent_intervals_cover_ninety_percent(references, method):
    rng = np.random.default_rng(20261122)
    targets = ["thing", "pole a", "pole d"]
    noise = ims.Noise(box_px=1.5, box_rel=0.02, depth_rel=0.05)
    count = 1200  # the binomial standard error is 0.9 %
    hits = np.array(
        [
            np.r_[covered(heights, measured), covered(heights, fused)]
            for _, heights, measured, fused in simulate(
                rng, references, targets, noise, count=count, method=method
            )
        ]
    ).mean(axis=0)
    measured, fused = hits.reshape(2, -1)
    known = len(references)
    rates = {
        "unknown, measured": measured[known],
        "known label, measured": measured[known + 1],
        "known label, fused": fused[known + 1],
        "other known label, fused": fused[known + 2],
    }
    if method == "robust":  # what a wrong reference's size is, the model does not say
        rates["references, measured"] = measured[:known].mean()
        rates["references, fused"] = fused[:known].mean()
    assert {name: rate for name, rate in rates.items() if not 0.87 <= rate <= 0.93} == {}


@pytest.mark.parametrize("method", FITTED)
def test_fusing_the_prior_lowers_the_error_of_known_objects(method):
    rng = np.random.default_rng(3)
    noise = ims.Noise(box_px=1.5, depth_rel=0.1)
    errors = np.array(
        [
            np.abs(np.log([measured[-1].size_m, fused[-1].size_m]) - math.log(heights[-1]))
            for _, heights, measured, fused in simulate(
                rng, ["pole a", "pole b"], ["pole d"], noise, count=300, method=method
            )
        ]
    )
    prior_median = 0.6745 * math.hypot(math.sqrt(prior_of("pole d")[1]), prior_of("pole d")[2])
    assert np.median(errors[:, 1]) < np.median(errors[:, 0])
    assert np.median(errors[:, 1]) < prior_median


# --- the paper's mean depth ----------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["metric", "relative", "inverse"])
def test_mean_depth_is_the_mean_distance_of_the_references_used(kind):
    z = np.array([4.0, 6.0, 11.0])
    values = 60 / z if kind == "inverse" else z
    detections = [box("pole", FOCAL * 1.7 / d) for d in z]
    model = ims.fit(
        [*detections, box("thing", 9.0)], ims.ObjectDepths([*values, 1.0], kind=kind), POLE
    )
    estimates = ims.predict(model, [box("thing", 30.0), box("thing", 60.0)], "mean")
    for estimate, pixels in zip(estimates, (30.0, 60.0), strict=True):
        distance = 60 / estimate.depth if kind == "inverse" else estimate.depth
        assert distance == pytest.approx(7.0, rel=1e-12)
        assert estimate.size_m == pytest.approx(pixels * 7.0 / FOCAL, rel=0.01)
        assert estimate.flags == Flag.MEAN_DEPTH


def test_mean_depth_is_less_certain_than_a_depth():
    z = [4.0, 6.0, 11.0]
    model = ims.fit([box("pole", FOCAL * 1.7 / d) for d in z], relative(z), POLE)
    [guessed] = ims.predict(model, [box("thing", 30.0)], "mean")
    [read] = ims.predict(model, [box("thing", 30.0)], relative([7.0]))
    assert guessed.size_m == pytest.approx(read.size_m, rel=1e-12)
    assert log_std(guessed) > np.std(np.log(z), ddof=1) > 2 * log_std(read)


@pytest.mark.slow
def test_mean_depth_intervals_cover_ninety_percent():
    # depths of one log-normal scatter, five references: their scatter is known to 35 % only
    rng = np.random.default_rng(9)
    hits = []
    for _ in range(1200):
        z = 10 * np.exp(0.3 * rng.normal(size=6))
        offset = prior_of("pole b")[2] * rng.normal()
        log_heights = prior_of("pole b")[0] + offset
        log_heights += math.sqrt(prior_of("pole b")[1]) * rng.normal(size=6)
        pixels = FOCAL * np.exp(log_heights) / z
        detections = [box("pole b", p) for p in pixels[:5]]
        noise = ims.Noise(box_px=0.0, depth_rel=0.0)
        model = ims.fit(detections, relative(z[:5]), DENSE_TABLE, noise=noise, method="robust")
        estimates = ims.predict(model, [box("thing", pixels[5])], "mean")
        hits.append(covered(np.exp(log_heights[5:]), estimates)[0])
    assert 0.87 <= np.mean(hits) <= 0.93


@pytest.mark.parametrize("count", [0, 1])
def test_mean_depth_of_fewer_than_two_references_is_refused(count):
    camera = ims.Camera(FOCAL, focal_rel_std=0.01)
    model = ims.fit(
        ONE * count, ims.ObjectDepths([6.0] * count, kind="metric"), POLE, camera=camera
    )
    with pytest.raises(ims.FitError, match=f"at least two references.*got {count}"):
        ims.predict(model, [box("thing", 30.0)], "mean")


# --- depth that does not belong to the model -----------------------------------------------------


def constant_map(value, kind):
    return ims.DepthMap(np.full((150, 200), value), kind=kind, image_size=SIZE)


def test_missing_depth_is_refused_naming_both_ways_out():
    model = ims.fit(ONE, ONE_DEPTH, POLE)
    with pytest.raises(ValueError, match="missing") as caught:
        ims.predict(model, ONE)
    assert str(caught.value) == (
        '`depth` is missing; pass the map, or depth="mean" for the paper\'s rule.'
    )


@pytest.mark.parametrize("word", ["median", "", "Mean"])
def test_another_word_than_mean_is_refused(word):
    model = ims.fit(ONE, ONE_DEPTH, POLE)
    with pytest.raises(ValueError, match=f'ObjectDepths or "mean"; got {word!r}'):
        ims.predict(model, ONE, word)


@pytest.mark.parametrize("kind", ["metric", "inverse", "affine_inverse"])
def test_depth_of_another_kind_is_refused(kind):
    model = ims.fit(ONE, ONE_DEPTH, POLE)
    with pytest.raises(ims.DepthMismatchError, match=f'"relative"; got "{kind}"'):
        ims.predict(model, ONE, ims.ObjectDepths([6.0], kind=kind))
    with pytest.raises(ims.DepthMismatchError, match=f'"relative"; got "{kind}"'):
        ims.predict(model, ONE, constant_map(6.0, kind), same_scale=True)


def test_a_ground_plane_is_refused_as_depth_of_another_kind():
    model = ims.fit(ONE, ONE_DEPTH, POLE)
    with pytest.raises(ims.DepthMismatchError, match="ground_plane"):
        ims.predict(model, ONE, ims.GroundPlane(image_size=SIZE))


@pytest.mark.parametrize("raw", [[6.0], np.array([6.0]), 6.0], ids=["list", "array", "number"])
def test_raw_depth_is_refused_with_the_remedy(raw):
    model = ims.fit(ONE, ONE_DEPTH, POLE)
    with pytest.raises(TypeError, match=r"ObjectDepths\(values, kind=\.\.\.\)"):
        ims.predict(model, ONE, raw)


@pytest.mark.parametrize("kind", ["relative", "inverse"])
def test_another_map_without_scale_is_refused_unless_vouched_for(kind):
    model = ims.fit(ONE, constant_map(6.0, kind), POLE)
    other = constant_map(7.0, kind)
    with pytest.raises(ims.DepthMismatchError, match="same_scale=True"):
        ims.predict(model, ONE, other)
    [estimate] = ims.predict(model, ONE, other, same_scale=True)
    factor = 7 / 6 if kind == "relative" else 6 / 7
    [fitted] = ims.predict(model, ONE, constant_map(6.0, kind))
    assert estimate.size_m == pytest.approx(factor * fitted.size_m, rel=1e-12)


def test_another_metric_map_has_the_same_camera():
    model = ims.fit(ONE, constant_map(6.0, "metric"), POLE)
    [estimate] = ims.predict(model, [box("thing", 30.0)], constant_map(7.0, "metric"))
    assert estimate.size_m == pytest.approx(model.k * 7 * 30, rel=1e-12)


def test_another_metric_map_brings_a_scale_error_of_its_own():
    # two maps of a network, each off by 15 % as a whole: k holds the error of the first only
    first = ims.DepthMap(
        np.full((150, 200), 6.0), kind="metric", image_size=SIZE, scale_rel_std=0.15
    )
    second = ims.DepthMap(
        np.full((150, 200), 7.0), kind="metric", image_size=SIZE, scale_rel_std=0.15
    )
    model = ims.fit(ONE, first, POLE)
    [same] = ims.predict(model, [box("thing", 30.0)], first)
    [other] = ims.predict(model, [box("thing", 30.0)], second)
    assert log_std(same) < 0.15 < log_std(other)


def test_object_depths_carry_no_fingerprint_and_pass():
    model = ims.fit(ONE, constant_map(6.0, "relative"), POLE)
    [estimate] = ims.predict(model, [box("thing", 30.0)], relative([7.0]))
    assert estimate.size_m == pytest.approx(model.k * 7 * 30, rel=1e-12)


# --- hostile input -------------------------------------------------------------------------------


@pytest.mark.parametrize("axis", ["length", "depth", "", None], ids=repr)
def test_an_unknown_axis_is_refused_with_the_choices(axis):
    model = ims.fit(ONE, ONE_DEPTH, POLE)
    with pytest.raises(ValueError, match='`axis` must be one of "height", "width", "diameter"'):
        ims.predict(model, ONE, ONE_DEPTH, axis=axis)


@pytest.mark.parametrize("level", [0, 1, -0.1, 1.5, 90, NAN])
def test_a_level_that_is_no_probability_is_refused(level):
    model = ims.fit(ONE, ONE_DEPTH, POLE)
    [estimate] = ims.predict(model, ONE, ONE_DEPTH)
    with pytest.raises(ValueError, match="`level` must be above 0 and below 1"):
        estimate.interval(level)


def test_the_wrong_number_of_depths_is_refused():
    model = ims.fit(ONE, ONE_DEPTH, POLE)
    with pytest.raises(ValueError, match="one value per detection, 2; got 1"):
        ims.predict(model, ONE * 2, ONE_DEPTH)


def test_a_box_outside_the_image_is_refused():
    model = ims.fit(ONE, ONE_DEPTH, POLE)
    with pytest.raises(ValueError, match=r"`xyxy` must lie in the image, 100 x 100 px"):
        ims.predict(model, ONE, relative([6.0], image_size=(100, 100)))


def test_a_mask_of_another_shape_is_refused():
    depth = ims.DepthMap(np.full((100, 100), 6.0), kind="metric")
    model = ims.fit([box("pole", 50.0)], depth, POLE)
    masked = box("thing", 40.0, mask=np.ones((90, 100), dtype=bool))
    with pytest.raises(ValueError, match=r"`mask`.*\(100, 100\); got \(90, 100\)"):
        ims.predict(model, [masked], depth)


@pytest.mark.parametrize("method", ["mean_ratio", "least_squares"])
def test_the_papers_methods_cannot_fuse_priors(method):
    model = ims.fit(ONE, ONE_DEPTH, POLE, method=method)
    with pytest.raises(ValueError, match=f'`use_prior` must be False for method "{method}"'):
        ims.predict(model, ONE, ONE_DEPTH, use_prior=True)


# --- sizes whose solutions contradict each other ---


def test_the_size_lies_in_the_middle_of_its_own_distribution():
    plane = ims.GroundPlane(image_size=(1920, 1080))
    chair = ims.Detection("Chair", (1458, 728, 1801, 998))
    pillow = ims.Detection("Pillow", (839, 551, 1012, 624))
    for method in ("posterior", "robust"):
        options = {"noise": ims.Noise(box_px=2, box_rel=0.05), "method": method}
        model = ims.fit([chair, pillow], plane, **options)
        for size in ims.predict(model, [chair, pillow], plane):
            below = sum(quantile <= size.size_m for quantile in size.quantiles_m)
            assert 0 < below < len(size.quantiles_m)
            low, high = size.interval(0.95)
            assert low < size.size_m < high


def test_a_rejected_reference_is_flagged_as_one():
    cars = [ims.Detection("car", (100 * i, 0, 100 * i + 90, 160)) for i in range(4)]
    small = ims.Detection("car", (500, 0, 590, 40))
    depths = ims.ObjectDepths([7.0] * 5, kind="metric")
    model = ims.fit([*cars, small], depths)
    assert not model.references[-1].used
    *good, bad = ims.predict(model, [*cars, small], depths)
    assert ims.Flag.OUTLIERS in bad.flags
    assert ims.Flag.REFERENCE not in bad.flags
    for size in good:
        assert ims.Flag.REFERENCE in size.flags
        assert ims.Flag.OUTLIERS not in size.flags
