"""The verb `leave_one_out`: every known object from the others, against dense algebra."""

import math

import numpy as np
import pytest

import imgscale as ims
from imgscale import Flag

FOCAL = 800.0
NAN = math.nan
FITTED = ["robust", "posterior"]


def box(label, height, width=40.0, *, left=50.0, top=20.0, **options):
    return ims.Detection(label, (left, top, left + width, top + height), **options)


def relative(values, **options):
    return ims.ObjectDepths(values, kind="relative", **options)


def log_std(estimate):
    return estimate.std_m / estimate.size_m


PRIORS = {"pole a": (1.7, 0.12, 0.06), "pole b": (0.9, 0.05, 0.05), "pole c": (2.4, 0.2, 0.08)}
TABLE = ims.PriorTable(
    [
        ims.ObjectPrior(label, mean, std, mean_std_m=tau)
        for label, (mean, std, tau) in PRIORS.items()
    ]
)
LABELS = ["pole a", "pole a", "pole b", "pole c"]
NOISE = ims.Noise(box_px=1.5, depth_rel=0.04)


def prior_of(label):
    mean, std, tau = PRIORS[label]
    variance = math.log(1 + (std / mean) ** 2)
    return math.log(mean) - variance / 2, variance, tau / mean


def scene(seed, residual=1e-3, labels=LABELS):
    """References `residual` standard deviations off; 1e-3 leaves robust weights at 1."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(5, 20, len(labels))
    heights = [math.exp(prior_of(label)[0] + residual * 0.1 * rng.normal()) for label in labels]
    detections = [
        box(label, FOCAL * h / d, left=60.0 * i + 20)
        for i, (label, h, d) in enumerate(zip(labels, heights, z, strict=True))
    ]
    return detections, z


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("left_out", range(len(LABELS)))
def test_the_estimate_is_k_of_the_others_times_depth_and_pixels(left_out, seed):
    detections, z = scene(seed)
    estimate = ims.leave_one_out(detections, relative(z), TABLE, noise=NOISE, method="robust")[
        left_out
    ]
    spread, tau = (np.array([prior_of(label)[i] for label in LABELS]) for i in (1, 2))
    pixels = np.array([d.height_px for d in detections])
    noise = (1.5 / pixels) ** 2 + 0.04**2
    y = np.array([prior_of(label)[0] for label in LABELS]) - np.log(z * pixels)
    others = np.arange(len(LABELS)) != left_out
    same = np.equal.outer(LABELS, LABELS)
    covariance = (np.diag(spread + noise) + same * np.outer(tau, tau))[np.ix_(others, others)]
    inverse = np.linalg.inv(covariance)
    log_k = inverse.sum(axis=0) @ y[others] / inverse.sum()
    expected = log_k + math.log(z[left_out] * pixels[left_out])
    assert math.log(estimate.size_m) == pytest.approx(expected, abs=1e-7)
    variance = 1 / inverse.sum() + noise[left_out]
    assert log_std(estimate) == pytest.approx(math.sqrt(variance), rel=1e-5)
    assert estimate.flags == Flag(0)


@pytest.mark.parametrize(
    ("method", "use_prior"),
    [
        ("mean_ratio", False),
        ("least_squares", False),
        ("robust", False),
        ("robust", True),
        ("posterior", False),
        ("posterior", True),
    ],
)
@pytest.mark.parametrize("noise", [NOISE, ims.Noise(box_px=1.5)], ids=["told", "unknown"])
def test_it_is_fit_without_the_object_and_predict_of_it(noise, method, use_prior):
    detections, z = scene(5, residual=1.0)
    estimates = ims.leave_one_out(
        detections, relative(z), TABLE, use_prior=use_prior, method=method, noise=noise
    )
    # images that are solved together share the number of points of their grids
    on_grid = 1e-5 if method == "posterior" else 1e-9
    for i, estimate in enumerate(estimates):
        others = np.delete(np.arange(len(z)), i)
        model = ims.fit(
            [detections[j] for j in others], relative(z[others]), TABLE, method=method, noise=noise
        )
        [expected] = ims.predict(model, [detections[i]], relative([z[i]]), use_prior=use_prior)
        assert estimate.size_m == pytest.approx(expected.size_m, rel=on_grid)
        assert estimate.std_m == pytest.approx(expected.std_m, rel=on_grid)
        tails = pytest.approx(expected.interval(0.95), rel=10 * on_grid)
        assert estimate.interval(0.95) == tails
        assert estimate.flags == expected.flags


@pytest.mark.parametrize("method", FITTED)
def test_consistent_objects_come_out_at_their_median_size(method):
    detections, z = scene(1, residual=0.0)
    for estimate in ims.leave_one_out(detections, relative(z), TABLE, method=method):
        assert math.log(estimate.size_m) == pytest.approx(prior_of(estimate.label)[0], abs=1e-12)


def test_residuals_agree_with_the_models_z_scores_where_labels_differ():
    detections, z = scene(2, labels=["pole a", "pole b", "pole c"])
    options = {"noise": NOISE, "method": "robust"}
    model = ims.fit(detections, relative(z), TABLE, **options)
    estimates = ims.leave_one_out(detections, relative(z), TABLE, **options)
    for estimate, ref in zip(estimates, model.references, strict=True):
        mean, variance, tau = prior_of(estimate.label)
        residual = mean - math.log(estimate.size_m)
        std = math.sqrt(log_std(estimate) ** 2 + variance + tau**2)
        assert ref.z_score == pytest.approx(residual / std, rel=1e-4, abs=1e-9)


def test_length_and_order_are_those_of_the_detections():
    detections, z = scene(3)
    more = [box("thing", 33.0), *detections, box("pole a", 70.0, partial=True), box("pole b", 9.0)]
    depths = relative([4.0, *z, 5.0, NAN])
    estimates = ims.leave_one_out(more, depths, TABLE)
    assert [e.label for e in estimates] == [d.label for d in more]


@pytest.mark.parametrize("method", FITTED)
def test_objects_that_are_no_references_are_sized_from_all(method):
    detections, z = scene(3, residual=1.0)
    more = [*detections, box("thing", 33.0), box("pole a", 70.0, partial=True), box("pole b", 9.0)]
    depths = relative([*z, 4.0, 5.0, NAN])
    model = ims.fit(more, depths, TABLE, method=method)
    expected = ims.predict(model, more, depths)[len(z) :]
    estimates = ims.leave_one_out(more, depths, TABLE, method=method)[len(z) :]
    assert [(e.label, e.flags) for e in estimates] == [(e.label, e.flags) for e in expected]
    assert [e.flags for e in estimates] == [Flag(0), Flag.PARTIAL, Flag.NO_DEPTH]
    for estimate, wanted in zip(estimates[:2], expected, strict=False):
        assert estimate.size_m == pytest.approx(wanted.size_m, rel=1e-12)
        assert estimate.std_m == pytest.approx(wanted.std_m, rel=1e-12)
    assert math.isnan(estimates[2].size_m)


@pytest.mark.parametrize("method", FITTED)
def test_an_outlier_is_sized_from_the_others(method):
    labels = ["pole a", "pole b", "pole c", "pole b"]
    detections, z = scene(4, residual=0.2, labels=labels)
    detections[1] = box("pole b", 5 * detections[1].height_px)
    estimate = ims.leave_one_out(detections, relative(z), TABLE, method=method)[1]
    assert estimate.size_m == pytest.approx(5 * 0.9, rel=0.1)
    assert Flag.REFERENCE not in estimate.flags


def test_an_object_known_by_its_width_is_measured_along_it():
    table = ims.PriorTable(
        [
            ims.ObjectPrior("board x", 3.0, 0.05, axis="width"),
            ims.ObjectPrior("pole", 1.7, 0.05),
        ]
    )
    detections = [box("board x", 50.0, 3.0 * FOCAL / 9), box("pole", 1.7 * FOCAL / 6)]
    board, pole = ims.leave_one_out(detections, relative([9.0, 6.0]), table)
    assert (board.axis, pole.axis) == ("width", "height")
    assert board.size_m == pytest.approx(3.0, rel=1e-3)
    assert pole.size_m == pytest.approx(1.7, rel=1e-3)


@pytest.mark.parametrize("method", FITTED)
def test_a_camera_sizes_a_single_reference(method):
    depth = ims.ObjectDepths([6.0], kind="metric")
    camera = ims.Camera(FOCAL, focal_rel_std=0.02)
    [estimate] = ims.leave_one_out(
        [box("pole a", 200.0)], depth, TABLE, camera=camera, method=method,
        noise=ims.Noise(depth_rel=0.05),
    )  # fmt: skip
    assert estimate.size_m == pytest.approx(200 * 6 / FOCAL, rel=1e-12)
    tolerance = 1e-9 if method == "robust" else 1e-3
    assert log_std(estimate) == pytest.approx(math.hypot(0.02, 1 / 200, 0.05), rel=tolerance)


@pytest.mark.parametrize("method", FITTED)
def test_duplicates_are_treated_alike(method):
    # the twin that stays is no reason to take the one left out for a reference
    detections, z = scene(6, labels=["pole b", "pole a"])
    a, b, _ = ims.leave_one_out(
        [detections[0], *detections], relative([z[0], *z]), TABLE, noise=NOISE, method=method
    )
    assert a.flags == b.flags == Flag(0)
    assert a.std_m == pytest.approx(b.std_m, rel=1e-9)
    assert a.size_m == pytest.approx(b.size_m, rel=1e-9)


def coverage(method, draws):
    """Rates at which 90 % intervals, measured and fused, hold sizes drawn without outliers."""
    rng = np.random.default_rng(4)
    hits = []
    for _ in range(draws):
        offset = {label: prior_of(label)[2] * rng.normal() for label in PRIORS}
        heights = np.array(
            [
                math.exp(
                    prior_of(label)[0]
                    + offset[label]
                    + math.sqrt(prior_of(label)[1]) * rng.normal()
                )
                for label in LABELS
            ]
        )
        z = rng.uniform(5, 25, len(LABELS))
        pixels = FOCAL * heights / z + 1.5 * rng.normal(size=len(LABELS))
        detections = [box(label, p) for label, p in zip(LABELS, pixels, strict=True)]
        depths = relative(z * np.exp(0.04 * rng.normal(size=len(LABELS))))
        for use_prior in (False, True):
            estimates = ims.leave_one_out(
                detections, depths, TABLE, use_prior=use_prior, noise=NOISE, method=method
            )
            ends = np.array([estimate.interval(0.9) for estimate in estimates])
            hits.append((ends[:, 0] <= heights) & (heights <= ends[:, 1]))
    return np.mean(hits[::2]), np.mean(hits[1::2])


@pytest.mark.slow
@pytest.mark.parametrize(("method", "draws"), [("robust", 700), ("posterior", 350)])
def test_intervals_cover_ninety_percent(method, draws):
    measured, fused = coverage(method, draws)
    assert 0.87 <= measured <= 0.93
    assert 0.87 <= fused <= 0.93


def test_the_only_reference_cannot_be_left_out():
    with pytest.raises(ims.FitError, match="at least two references to leave one out; got pole a"):
        ims.leave_one_out([box("pole a", 50.0), box("thing", 9.0)], relative([6.0, 6.0]), TABLE)


def test_without_any_reference_the_error_is_that_of_fit():
    with pytest.raises(ims.FitError, match=r"at least one reference.*thing \(no prior\)"):
        ims.leave_one_out([box("thing", 9.0)], relative([6.0]), TABLE)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"method": "best"}, ValueError, "`method` must be one of"),
        ({"camera": 800.0}, TypeError, "`camera` must be a Camera"),
        ({"noise": 0.1}, TypeError, "`noise` must be a Noise"),
        ({"ground": (2000, 1500)}, TypeError, "`ground` must be a GroundPlane; got tuple"),
        (
            {"ground": ims.GroundPlane(image_size=(2000, 1500)), "method": "mean_ratio"},
            ValueError,
            "`ground` must be None for method",
        ),
        ({"use_prior": True, "method": "mean_ratio"}, ValueError, "`use_prior` must be False"),
    ],
    ids=["method", "camera", "noise", "ground", "ground and method", "use_prior"],
)
def test_options_are_checked_as_by_fit(options, error, message):
    detections, z = scene(0)
    with pytest.raises(error, match=message):
        ims.leave_one_out(detections, relative(z), TABLE, **options)


def test_an_unknown_option_is_refused():
    detections, z = scene(0)
    with pytest.raises(TypeError, match="colour"):
        ims.leave_one_out(detections, relative(z), TABLE, colour="red")


def test_raw_depth_is_refused_with_the_remedy():
    detections, z = scene(0)
    with pytest.raises(TypeError, match=r"ObjectDepths\(values, kind=\.\.\.\)"):
        ims.leave_one_out(detections, list(z), TABLE)
