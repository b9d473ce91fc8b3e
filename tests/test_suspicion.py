"""Wrong maps, units and focal lengths are found out; right ones are left alone."""

import math

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import imgscale as ims
from imgscale.claims import claims_of, with_focal
from imgscale.implied_focal import check_focal
from imgscale.readings import chi_square, evidence, log_k_of, log_slant, score_against, shifted
from imgscale.suspicion import suspect

# Labels that no shipped table knows: mean, spread and error of the mean, relative.
LABELS = {"idol": (2.0, 0.05, 0.02), "jar": (1.2, 0.08, 0.03), "chest": (0.7, 0.06, 0.0)}
SIZE = (1200, 800)
FOCAL = 900.0
TOLD = ims.Noise(box_px=1.0, depth_rel=0.05)
CAMERA = ims.Camera(FOCAL, focal_rel_std=0.01)
SPREAD_OUT = np.array([4.0, 6.0, 9.0, 13.0, 20.0])
NAMES = ["idol", "jar", "idol", "chest", "jar"]


def table():
    return ims.PriorTable([
        ims.ObjectPrior(label, mean, spread * mean, mean_std_m=tau * mean)
        for label, (mean, spread, tau) in LABELS.items()
    ])  # fmt: skip


def detections(labels, distance, errors=None, column=500.0):
    """Boxes of objects at true distances, of the mean size times exp(error)."""
    errors = np.zeros(len(labels)) if errors is None else errors
    columns = np.broadcast_to(column, len(labels))
    return [
        ims.Detection(
            label, (x, 100.0, x + 20.0, 100.0 + FOCAL * LABELS[label][0] * math.exp(e) / z)
        )
        for label, z, e, x in zip(labels, distance, errors, columns, strict=True)
    ]


def fitted(boxes, values, kind="relative", noise=TOLD, **options):
    depth = ims.ObjectDepths(values, kind=kind, image_size=SIZE)
    return ims.fit(boxes, depth, table(), noise=noise, **options)


def causes(model):
    return [suspicion.cause for suspicion in suspect(model)]


def dense(model, values):
    """Columns by hand: residual y - log d, and its covariance with labels' offsets."""
    refs = model.references
    var = [math.log1p((r.prior_std_m / r.prior_m) ** 2) for r in refs]
    y = [math.log(r.prior_m) - v / 2 - math.log(r.pixels) for r, v in zip(refs, var, strict=True)]
    cov = np.diag([v + (1 / r.pixels) ** 2 + 0.05**2 for r, v in zip(refs, var, strict=True)])
    for i, one in enumerate(refs):
        for j, other in enumerate(refs):
            if one.label == other.label:
                cov[i, j] += LABELS[one.label][2] ** 2
    return np.array(y) - np.log(values), cov


def projector(cov):
    """Inverse covariance without the direction of log k."""
    inverse = np.linalg.inv(cov)
    rows = inverse.sum(axis=1)
    return inverse - np.outer(rows, rows) / rows.sum()


def test_chi_square_is_the_quadratic_form_of_dense_algebra():
    errors = np.array([0.1, -0.2, 0.05, 0.0, 0.3])
    model = fitted(detections(NAMES, SPREAD_OUT, errors), SPREAD_OUT)
    residual, cov = dense(model, SPREAD_OUT)
    claims = claims_of(model)
    found = chi_square(claims, claims.log_distance, np.ones((5, 1)))
    assert found == pytest.approx([residual @ projector(cov) @ residual], rel=1e-9)


def test_the_score_is_the_standardised_likelihood_ratio():
    errors = np.array([0.1, -0.2, 0.05, 0.0, 0.3])
    model = fitted(detections(NAMES, SPREAD_OUT, errors), SPREAD_OUT)
    residual, cov = dense(model, SPREAD_OUT)
    other, _ = dense(model, 1 / SPREAD_OUT)
    p = projector(cov)
    apart = residual - other
    variance = apart @ p @ apart
    log_ratio = (residual @ p @ residual - other @ p @ other) / 2
    claims = claims_of(model)
    found = score_against(claims, -claims.log_distance)
    assert found == pytest.approx([(log_ratio + variance / 2) / math.sqrt(variance)], rel=1e-9)


def test_readings_that_are_the_same_up_to_k_cannot_be_told_apart():
    model = fitted(detections(NAMES, SPREAD_OUT), SPREAD_OUT)
    claims = claims_of(model)
    assert score_against(claims, claims.log_distance + 3.0)[0] == -math.inf


def test_evidence_is_the_gaussian_one_where_nothing_is_far_off():
    model = fitted(detections(NAMES, SPREAD_OUT, [0.05, -0.06, 0.03, 0.0, 0.07]), SPREAD_OUT)
    claims = claims_of(model)
    readings = np.stack([claims.log_distance, claims.log_distance + np.linspace(0, 0.1, 5)])
    found = evidence(claims, readings)
    values = np.exp(readings)
    gauss = []
    for row in values:
        residual, cov = dense(model, row)
        gauss.append(-0.5 * residual @ projector(cov) @ residual)
    # outliers of one in twenty blunt the ratio by little
    assert found[1] - found[0] == pytest.approx(gauss[1] - gauss[0], abs=0.1)
    assert evidence(claims, readings - 2.0) == pytest.approx(found, abs=1e-3)


def test_log_k_without_the_camera_is_that_of_a_model_without_one():
    boxes = detections(NAMES, SPREAD_OUT, [0.1, -0.1, 0.05, 0.0, 0.1])
    plain = fitted(boxes, SPREAD_OUT, kind="metric")
    seen = fitted(boxes, SPREAD_OUT, kind="metric", camera=CAMERA)
    log_k = log_k_of(claims_of(seen))
    assert log_k.mean == pytest.approx(math.log(plain.k), abs=0.01)
    assert log_k.std == pytest.approx(plain.k_std / plain.k, rel=0.1)


def test_a_camera_is_one_more_firm_claim():
    model = fitted(detections(NAMES, SPREAD_OUT), SPREAD_OUT, kind="metric", camera=CAMERA)
    joined = with_focal(claims_of(model), FOCAL, 0.01)
    assert joined.firm.tolist() == [False] * 5 + [True]
    assert joined.group[-1] not in joined.group[:-1]
    log_k = log_k_of(joined)
    assert log_k.mean == pytest.approx(-math.log(FOCAL), abs=0.005)
    assert log_k.std < 0.01


def test_a_tilt_is_taken_out_of_the_pixels():
    model = fitted(detections(NAMES, SPREAD_OUT), SPREAD_OUT, camera=CAMERA)
    pitch = math.radians(20)
    tilted = []
    for ref in model.references:
        y = (ref.xyxy[1] + ref.xyxy[3]) / 2 - SIZE[1] / 2
        seen = math.cos(pitch) * (1 - math.tan(pitch) * y / FOCAL)
        tilted.append(attrs.evolve(ref, pixels=ref.pixels * seen))
    camera = ims.Camera(FOCAL, focal_rel_std=0.01, pitch_deg=20.0)
    looking_down = attrs.evolve(model, references=tuple(tilted), camera=camera)
    level = claims_of(model)
    found = claims_of(looking_down)
    assert found.log_scale == pytest.approx(level.log_scale)
    assert found.kinds.mean == pytest.approx(level.kinds.mean)


def test_a_shift_that_is_among_those_tried_leaves_no_residual():
    inverse = 1 / SPREAD_OUT
    distances, slopes = shifted(inverse - 0.03)
    best = np.abs(distances - np.log(SPREAD_OUT)).max(axis=1).argmin()
    off = distances[best] - np.log(SPREAD_OUT)
    moved = off - slopes[best] * (off @ slopes[best]) / (slopes[best] @ slopes[best])
    assert np.abs(moved).max() < 0.02


@pytest.mark.parametrize("kind", ["metric", "relative", "inverse", "affine_inverse"])
@pytest.mark.parametrize("method", ["posterior", "robust"])
@pytest.mark.parametrize("noise", [TOLD, ims.Noise()])
def test_a_right_map_is_not_suspected(kind, method, noise):
    boxes = detections(NAMES, SPREAD_OUT, [0.05, -0.06, 0.03, 0.05, -0.07])
    values = 1 / SPREAD_OUT if "inverse" in kind else SPREAD_OUT
    camera = CAMERA if kind == "metric" else None
    assert suspect(fitted(boxes, values, kind, noise, method=method, camera=camera)) == ()


@pytest.mark.parametrize("noise", [TOLD, ims.Noise()])
@pytest.mark.parametrize("kind", ["metric", "relative"])
def test_inverse_depth_given_as_depth_is_found_out(kind, noise):
    [suspicion] = suspect(fitted(detections(NAMES, SPREAD_OUT), 30 / SPREAD_OUT, kind, noise))
    assert suspicion.cause == "inverse given as depth"
    assert suspicion.evidence > math.log(100)
    assert suspicion.p_value < 1e-3
    assert 'kind="inverse"' in suspicion.detail


def test_depth_given_as_inverse_is_found_out():
    assert causes(fitted(detections(NAMES, SPREAD_OUT), SPREAD_OUT, "inverse")) == [
        "depth given as inverse"
    ]


def test_a_swap_is_not_seen_where_all_depths_are_alike():
    same = np.full(5, 8.0)
    assert causes(fitted(detections(NAMES, same), 1 / same)) == []


def test_the_depths_of_another_picture_are_found_out():
    values = SPREAD_OUT[[2, 4, 0, 3, 1]]
    [suspicion] = suspect(fitted(detections(NAMES, SPREAD_OUT), values))
    assert suspicion.cause == "depth of another picture"
    assert suspicion.evidence > 0
    assert "the 5 references disagree" in suspicion.detail


def test_the_depths_of_another_picture_are_found_out_with_a_free_shift():
    labels, distance = NAMES * 2, np.geomspace(4, 30, 10)
    order = [5, 2, 8, 0, 9, 3, 7, 1, 6, 4]
    right = 1 / distance - 0.02
    boxes = detections(labels, distance)
    assert causes(fitted(boxes, right, "affine_inverse", method="robust")) == []
    wrong = fitted(boxes, right[order], "affine_inverse", method="robust")
    assert causes(wrong) == ["depth of another picture"]


def test_two_references_that_disagree_say_nothing_of_the_map():
    boxes = detections(["idol", "jar"], [5.0, 5.2])
    assert suspect(fitted(boxes, [5.0, 15.0])) == ()


def test_one_wrong_reference_of_many_is_no_wrong_map():
    labels, distance = NAMES * 2, np.geomspace(4, 30, 10)
    errors = np.zeros(10)
    errors[3] = -0.8
    assert suspect(fitted(detections(labels, distance, errors), distance)) == ()


def test_one_wrong_reference_of_three_is_named():
    distance = [8.0, 8.2, 8.4]
    boxes = detections(["idol", "jar", "idol"], distance, [0.0, -1.0, 0.0])
    [suspicion] = suspect(fitted(boxes, distance))
    assert suspicion.cause == "depth of another picture"
    assert "look for what is wrong with jar, without which the others agree" in suspicion.detail


def test_slants_are_those_of_the_pinhole():
    boxes = detections(["idol", "jar"], [5.0, 5.0], column=[590.0, 40.0])
    model = fitted(boxes, [5.0, 5.0], camera=CAMERA)
    wanted = []
    for box in boxes:
        x = (box.xyxy[0] + box.xyxy[2]) / 2 - SIZE[0] / 2
        y = (box.xyxy[1] + box.xyxy[3]) / 2 - SIZE[1] / 2
        wanted.append(math.log(math.hypot(x, y, FOCAL) / FOCAL))
    assert log_slant(model) == pytest.approx(wanted)
    away = ims.Camera(FOCAL, focal_rel_std=0.0, cx=0.0, cy=0.0)
    assert log_slant(fitted(boxes, [5.0, 5.0], camera=away)) == pytest.approx(
        [
            math.log(math.hypot(600, 280, FOCAL) / FOCAL),
            math.log(math.hypot(50, 208, FOCAL) / FOCAL),
        ]
    )
    assert log_slant(fitted(boxes, [5.0, 5.0])) is None


def test_distances_along_the_ray_are_found_out_by_many_precise_references():
    rng = np.random.default_rng(0)
    table_ = ims.PriorTable([ims.ObjectPrior("pole", 2.0, 0.02)])
    distance, columns = rng.uniform(4, 12, 12), np.linspace(10, 1150, 12)
    boxes = [
        ims.Detection("pole", (x, 380.0 - 900 / z, x + 20, 380.0 + 900 / z))
        for x, z in zip(columns, distance, strict=True)
    ]
    noise = ims.Noise(box_px=0.5, depth_rel=0.01)
    ray = distance * np.hypot(1, (columns + 10 - 600) / FOCAL)
    for kind in ("metric", "relative"):
        for values, wanted in ((distance, []), (ray, ["ray distance given as z-depth"])):
            depth = ims.ObjectDepths(values, kind=kind, image_size=SIZE)
            model = ims.fit(boxes, depth, table_, camera=CAMERA, noise=noise)
            assert causes(model) == wanted


@pytest.mark.parametrize(
    ("cause", "factor"),
    [
        ("millimetres", 1000.0),
        ("centimetres", 100.0),
        ("KITTI's 16-bit scale", 256.0),
        ("TUM's scale", 5000.0),
    ],
)
@pytest.mark.parametrize("noise", [TOLD, ims.Noise()])
def test_units_are_named(cause, factor, noise):
    boxes = detections(NAMES, SPREAD_OUT)
    seen = suspect(fitted(boxes, factor * SPREAD_OUT, "metric", noise, camera=CAMERA))
    assert [suspicion.cause for suspicion in seen] == [cause]
    assert f"divided by {factor:g}" in seen[0].detail
    assert seen[0].evidence > 100
    [without] = suspect(fitted(boxes, factor * SPREAD_OUT, "metric", noise))
    # without a camera the units that a photo may have are listed
    assert f"{factor:g}" in without.detail
    assert without.p_value < 0.01


def test_millimetres_are_named_without_a_camera():
    assert causes(fitted(detections(NAMES, SPREAD_OUT), 1000 * SPREAD_OUT, "metric")) == [
        "millimetres"
    ]


def test_sizes_in_centimetres_are_found_out():
    rows = [
        ims.ObjectPrior(label, 100 * mean, 100 * mean * spread)
        for label, (mean, spread, _) in LABELS.items()
    ]
    depth = ims.ObjectDepths(SPREAD_OUT, kind="metric", image_size=SIZE)
    model = ims.fit(detections(NAMES, SPREAD_OUT), depth, ims.PriorTable(rows), noise=TOLD)
    assert causes(model) == ["sizes in centimetres"]


def test_a_scale_that_is_no_unit_stays_unknown():
    [suspicion] = suspect(
        fitted(detections(NAMES, SPREAD_OUT), 30 * SPREAD_OUT, "metric", camera=CAMERA)
    )
    assert suspicion.cause == "unknown unit"


def test_millimetres_are_found_beside_a_wrong_reference():
    distance = np.array([8.0, 8.2, 8.4])
    boxes = detections(["idol", "jar", "idol"], distance, [0.0, -1.0, 0.0])
    assert causes(fitted(boxes, 1000 * distance, "metric")) == [
        "depth of another picture",
        "millimetres",
    ]


def test_a_stale_focal_length_is_found_out_with_its_factor():
    stale = ims.Camera(1.3 * FOCAL, focal_rel_std=0.01)
    [suspicion] = suspect(fitted(detections(NAMES, SPREAD_OUT), SPREAD_OUT, "metric", camera=stale))
    assert suspicion.cause == "stale focal length or resized picture"
    assert "0.77 times as long" in suspicion.detail
    # a map whose scale is not known says nothing of the focal length
    depth = ims.DepthMap(np.full((800, 1200), 8.0), kind="metric", scale_rel_std=0.15)
    boxes = detections(NAMES, np.full(5, 8.0))
    assert suspect(ims.fit(boxes, depth, table(), camera=stale, noise=TOLD)) == ()


def test_a_focal_length_in_millimetres_is_found_out_for_every_kind():
    camera = ims.Camera(35.0, focal_rel_std=0.01)
    boxes = detections(NAMES, SPREAD_OUT)
    for kind in ("metric", "relative"):
        assert causes(fitted(boxes, SPREAD_OUT, kind, camera=camera)) == [
            "focal length not in pixels"
        ]


def test_the_focal_length_implied_is_one_over_k():
    boxes = detections(NAMES, SPREAD_OUT, [0.1, -0.1, 0.05, 0.0, 0.1])
    model = fitted(boxes, SPREAD_OUT, "metric", camera=CAMERA)
    check = check_focal(model, claims_of(model))
    plain = fitted(boxes, SPREAD_OUT, "metric")
    assert check.implied_px == pytest.approx(1 / plain.k, rel=0.01)
    assert (check.low_px, check.high_px) == (360.0, 7200.0)
    score = math.log(check.implied_px / FOCAL) / math.hypot(check.implied_rel_std, 0.01)
    assert check.z_score == pytest.approx(score)
    assert check.p_value == pytest.approx(math.erfc(abs(score) / math.sqrt(2)), rel=0.2)
    alone = check_focal(plain, claims_of(plain))
    assert math.isnan(alone.z_score)
    assert alone.p_value > 0.99
    assert check_focal(fitted(boxes, SPREAD_OUT), claims_of(plain)) is None


def test_a_camera_alone_is_not_suspected():
    depth = ims.ObjectDepths([5.0], kind="metric", image_size=SIZE)
    thing = ims.Detection("thing", (10.0, 10.0, 60.0, 60.0))
    assert suspect(ims.fit([thing], depth, table(), camera=CAMERA)) == ()


def test_priors_without_any_spread_are_no_trouble():
    rows = [ims.ObjectPrior(label, mean, 0.0) for label, (mean, _, _) in LABELS.items()]
    exact = ims.Noise(box_px=0.0, depth_rel=0.0)
    depth = ims.ObjectDepths(SPREAD_OUT, kind="relative")
    boxes = detections(NAMES, SPREAD_OUT)
    assert suspect(ims.fit(boxes, depth, ims.PriorTable(rows), noise=exact)) == ()


def test_what_is_no_model_is_refused():
    with pytest.raises(TypeError, match="`model` must be a ScaleModel"):
        suspect("model")


def test_false_alarms_are_as_rare_as_stated_and_wrong_references_do_not_swap_the_kind():
    rng = np.random.default_rng(7)
    alarms, swaps = 0, 0
    for number in range(300):
        count = int(rng.integers(3, 9))
        labels = [str(label) for label in rng.choice(list(LABELS), count)]
        offset = {label: LABELS[label][2] * rng.normal() for label in LABELS}
        spread = np.array([LABELS[label][1] for label in labels])
        errors = np.array([offset[label] for label in labels]) + spread * rng.normal(size=count)
        distance = np.exp(rng.uniform(2.0, 4.0, count))
        depths = distance * np.exp(0.05 * rng.normal(size=count))
        alarms += bool(
            suspect(fitted(detections(labels, distance, errors), depths, method="robust"))
        )
        if number < 100:
            damaged = errors + np.where(rng.random(count) < 0.2, rng.uniform(-0.9, 0.9, count), 0.0)
            found = causes(fitted(detections(labels, distance, damaged), depths, method="robust"))
            swaps += "inverse given as depth" in found
    assert alarms <= 8  # two tests of 1 % each, mostly of the same images: 3 to 6
    assert swaps <= 3


@settings(max_examples=25, deadline=None)
@given(factor=st.floats(1e-3, 1e3), order=st.permutations(range(5)))
def test_neither_the_unit_of_relative_depth_nor_the_order_matters(factor, order):
    boxes = detections(NAMES, SPREAD_OUT)
    wrong = SPREAD_OUT[[2, 4, 0, 3, 1]]
    [one] = suspect(fitted(boxes, wrong, method="robust"))
    shuffled = [boxes[i] for i in order]
    [other] = suspect(fitted(shuffled, factor * wrong[list(order)], method="robust"))
    assert other.cause == one.cause
    assert other.p_value == pytest.approx(one.p_value, rel=1e-6)
    assert other.evidence == pytest.approx(one.evidence, abs=0.01)
