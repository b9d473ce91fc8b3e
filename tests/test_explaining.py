"""What a scale rests on, what limits it and what would help, against hand computations."""

import json
import math

import attrs
import numpy as np
import pytest

import imgscale as ims
from imgscale import Flag
from imgscale.budget import scale_budget, size_budget
from imgscale.explaining import Explanation, explain
from imgscale.next_references import next_references

# Labels that no shipped table knows: mean, spread and error of the mean, relative.
LABELS = {"idol": (2.0, 0.05, 0.02), "jar": (1.2, 0.08, 0.03), "chest": (0.7, 0.06, 0.0)}
SIZE = (1200, 800)
FOCAL = 900.0
TOLD = ims.Noise(box_px=2.0, box_rel=0.01, depth_rel=0.05)
CAMERA = ims.Camera(FOCAL, focal_rel_std=0.02)
NAMES = ["idol", "jar", "idol", "statue"]
DISTANCE = np.array([4.0, 6.0, 9.0, 13.0])
TRUE = {**{label: mean for label, (mean, _, _) in LABELS.items()}, "statue": 3.0}


def table():
    return ims.PriorTable([
        ims.ObjectPrior(label, mean, spread * mean, mean_std_m=tau * mean)
        for label, (mean, spread, tau) in LABELS.items()
    ])  # fmt: skip


def detections(labels=NAMES, distance=DISTANCE):
    return [
        ims.Detection(label, (500.0, 100.0, 520.0, 100.0 + FOCAL * TRUE[label] / z))
        for label, z in zip(labels, distance, strict=True)
    ]


def depths(values=DISTANCE, kind="metric"):
    return ims.ObjectDepths(values, kind=kind, image_size=SIZE)


def fitted(boxes=None, depth=None, noise=TOLD, method="robust", **options):
    boxes, depth = boxes or detections(), depth or depths()
    return ims.fit(boxes, depth, table(), noise=noise, method=method, **options)


def log_var(label):
    return math.log1p(LABELS[label][1] ** 2)


def box_var(pixels):
    return (2.0 / pixels) ** 2 + 0.01**2


def pixels_of(label, z):
    return FOCAL * TRUE[label] / z


def by_hand(camera_share=0.0):
    """Variances of individuals, mean sizes, boxes, depths, camera; shares from information."""
    own = {0: "idol", 1: "jar", 2: "idol"}
    noise = [log_var(own[i]) + box_var(pixels_of(own[i], DISTANCE[i])) + 0.05**2 for i in range(3)]
    idols = 1 / noise[0] + 1 / noise[2]
    information = {"idol": 1 / (1 / idols + 0.02**2), "jar": 1 / (noise[1] + 0.03**2)}
    total = sum(information.values()) + camera_share
    shares = [
        information["idol"] / total / noise[0] / idols,
        information["jar"] / total,
        information["idol"] / total / noise[2] / idols,
    ]
    squares = [share**2 for share in shares]
    parts = [
        sum(s * log_var(own[i]) for i, s in enumerate(squares)),
        ((shares[0] + shares[2]) * 0.02) ** 2 + (shares[1] * 0.03) ** 2,
        sum(s * box_var(pixels_of(own[i], DISTANCE[i])) for i, s in enumerate(squares)),
        sum(squares) * 0.05**2,
        (camera_share / total) ** 2 / camera_share if camera_share else 0.0,
    ]
    return np.sqrt(parts), 1 / total


def parts(budget):
    return np.array([
        budget.individuals, budget.mean_sizes, budget.boxes, budget.depths, budget.camera
    ])  # fmt: skip


def test_the_budget_of_k_is_the_propagation_of_the_declared_errors():
    model = fitted(depth=depths(kind="relative"))
    budget = scale_budget(model)
    wanted, variance = by_hand()
    assert parts(budget) == pytest.approx(wanted, rel=1e-4)  # trust is all but 1
    assert budget.rest == pytest.approx(0.0, abs=1e-6)
    assert budget.rel_std == pytest.approx(math.sqrt(variance), rel=1e-4)
    assert budget.rel_std == pytest.approx(model.k_std / model.k, rel=1e-9)
    assert sum(budget.shares.values()) == pytest.approx(1.0)
    assert budget.shares["depths"] == pytest.approx(wanted[3] ** 2 / variance, rel=1e-4)


def test_a_camera_that_is_a_witness_has_its_part():
    budget = scale_budget(fitted(camera=CAMERA))
    wanted, _ = by_hand(camera_share=1 / 0.02**2)
    assert wanted[4] > 0.01
    assert parts(budget) == pytest.approx(wanted, rel=1e-3)


def test_what_the_declared_errors_do_not_explain_is_the_rest():
    boxes = detections(["idol", "jar", "idol"], [4.0, 6.0, 9.0])
    apart = fitted(boxes, depths([4.0, 9.0, 5.0], kind="relative"))
    budget = scale_budget(apart)
    assert Flag.INCONSISTENT in apart.flags
    assert budget.rest > 0.5 * budget.rel_std
    assert budget.rel_std == pytest.approx(apart.k_std / apart.k)
    declared = np.linalg.norm(parts(budget))
    assert budget.rest == pytest.approx(math.sqrt(budget.rel_std**2 - declared**2))


def test_where_k_is_known_better_than_the_parts_say_they_shrink_alike():
    model = fitted(depth=depths(kind="relative"))
    sure = attrs.evolve(model, k_std=model.k_std / 2)
    assert parts(scale_budget(sure)) == pytest.approx(parts(scale_budget(model)) / 2)
    assert scale_budget(sure).rest == 0.0


def test_learned_noise_of_the_depths_counts_as_theirs():
    model = fitted(noise=ims.Noise(box_px=2.0, box_rel=0.01), method="posterior")
    assert model.depth_rel > 0.03
    budget = scale_budget(model)
    shares = [ref.weight for ref in model.references]
    own = math.sqrt(sum(share**2 for share in shares)) * model.depth_rel
    scaled = math.sqrt(1 - budget.shares["rest"]) * budget.rel_std / np.linalg.norm(parts(budget))
    assert scaled == pytest.approx(1.0)
    assert budget.depths <= own * (1 + 1e-9)
    assert budget.depths > 0.5 * own


def test_the_budget_of_a_size_is_scale_box_and_depth():
    model = fitted(depth=depths(kind="relative"))
    estimate = ims.predict(model, detections(), depths(kind="relative"))[3]
    budget = size_budget(model, estimate)
    assert budget.scale.rel_std == pytest.approx(model.k_std / model.k)
    assert budget.box == pytest.approx(math.sqrt(box_var(pixels_of("statue", 13.0))))
    assert budget.depth == pytest.approx(0.05)
    assert budget.rest == pytest.approx(0.0, abs=1e-4)
    assert budget.rel_std == pytest.approx(estimate.std_m / estimate.size_m)
    assert budget.shares["scale"] == pytest.approx(
        (model.k_std / model.k * estimate.size_m / estimate.std_m) ** 2
    )
    assert sum(budget.shares.values()) == pytest.approx(1.0)


def test_the_error_of_a_depth_that_came_with_it_is_known_from_fit():
    depth = ims.ObjectDepths(DISTANCE, kind="relative", image_size=SIZE, rel_std=0.03)
    noise = ims.Noise(box_px=2.0, box_rel=0.01)
    model = fitted(depth=depth, noise=noise)
    estimate = ims.predict(model, detections(), depth)[3]
    assert size_budget(model, estimate).depth == pytest.approx(0.03)


def test_a_prior_that_narrows_a_size_shrinks_its_parts():
    model = fitted(depth=depths(kind="relative"))
    estimate = ims.predict(model, detections(), depths(kind="relative"), use_prior=True)[0]
    budget = size_budget(model, estimate)
    assert budget.rel_std == pytest.approx(estimate.std_m / estimate.size_m)
    assert budget.rest == 0.0
    assert budget.depth < 0.05


def test_the_shift_counts_at_the_place_of_the_object():
    labels, distance = ["idol", "jar", "chest", "idol", "jar", "statue"], np.geomspace(4, 30, 6)
    boxes = detections(labels, distance)
    depth = depths(1 / distance - 0.02, kind="affine_inverse")
    model = fitted(boxes, depth, method="posterior")
    estimates = ims.predict(model, boxes, depth)
    near, far = (size_budget(model, estimates[row]) for row in (2, 5))
    of_k = model.k_std / model.k
    d = 1 / (1 / distance[5] - 0.02 + model.shift)
    of_shift = model.shift_std * d
    wanted = of_k**2 + of_shift**2 - 2 * model.correlation * of_k * of_shift
    # the parts may have been scaled, all alike
    assert far.scale.rel_std / far.depth == pytest.approx(math.sqrt(wanted) / 0.05, rel=1e-6)
    assert near.scale.rel_std / near.depth < far.scale.rel_std / far.depth


def test_a_size_that_is_not_known_has_no_budget():
    depth = depths([4.0, 6.0, 9.0, math.nan], kind="relative")
    model = fitted(depth=depth)
    estimates = ims.predict(model, detections(), depth)
    assert math.isnan(size_budget(model, estimates[3]).rel_std)
    assert "statue: its height is not known." in str(explain(model, estimates))


def test_carrying_references_are_sorted_by_weight():
    model = fitted(depth=depths(kind="relative"))
    carried = explain(model).carried
    assert {reference.name for reference in carried} == {"idol 1", "idol 2", "jar"}
    weights = [reference.weight for reference in carried]
    assert weights == sorted(weights, reverse=True)
    assert sum(weights) == pytest.approx(1.0)
    by_name = {reference.name: reference for reference in carried}
    assert by_name["jar"].k_ratio == pytest.approx(model.references[1].k / model.k)


def test_every_reason_is_put_into_words():
    labels = ["idol", "idol", "idol", "idol", "idol", "jar", "jar", "statue"]
    distance = np.array([4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0])
    boxes = detections(labels, distance)
    x1, y1, x2, y2 = boxes[4].xyxy
    boxes[4] = ims.Detection("idol", (x1, y1, x2, y1 + 0.4 * (y2 - y1)))
    boxes[5] = ims.Detection("jar", boxes[5].xyxy, partial=True)
    values = distance.copy()
    values[6] = math.nan
    model = fitted(boxes, depths(values, kind="relative"), method="posterior")
    explanation = explain(model)
    why = {reference.name: reference.why for reference in explanation.rejected}
    assert set(why) == {"idol 5", "jar 1", "jar 2"}
    assert why["jar 1"].startswith("partial: its box is cut")
    assert why["jar 2"].startswith("no depth: ")
    ref = model.references[4]
    assert ref.k / model.k > 2
    assert why["idol 5"] == (
        f"outlier: it says k {ref.k / model.k:.2g} times as large, "
        f"{abs(ref.z_score):.1f} standard errors from the others; wrong with over 99 %"
    )
    assert explanation.without_prior == ("statue",)


def test_a_conflict_with_the_camera_is_told_in_numbers():
    stale = ims.Camera(1.5 * FOCAL, focal_rel_std=0.02)
    model = fitted(camera=stale)
    explanation = explain(model)
    (conflict,) = explanation.conflicts
    assert conflict.what == "focal length"
    assert conflict.told == pytest.approx(1.5 * FOCAL, rel=1e-12)
    assert conflict.implied == pytest.approx(FOCAL, rel=0.03)
    assert conflict.z_score < -3
    assert explanation.focal.given_px == 1.5 * FOCAL
    assert explanation.focal.implied_px == pytest.approx(FOCAL, rel=0.03)
    assert explanation.focal.z_score < -3
    text = str(explanation)
    assert "Suspicion: stale focal length" in text
    assert "Conflict: the focal length was told as 1350 +- 27 px" in text
    assert f"{abs(conflict.z_score):.1f} standard errors apart" in text


def test_a_camera_height_that_the_picture_contradicts_is_told_in_numbers():
    # level, 1.5 m up, the horizon at row 360: people of 1.675 m and doors of 2.03 m stand on it
    rows = [(1.675, "person", 700.0), (1.675, "person", 520.0), (2.03, "door", 610.0)] * 2
    detections = [
        ims.Detection(label, (100.0 * i, foot - size / 1.5 * (foot - 360), 100.0 * i + 60, foot))
        for i, (size, label, foot) in enumerate(rows, start=1)
    ]
    told = {"horizon_px": 360.0, "horizon_std_px": 2.0, "camera_height_std_m": 0.02}
    plane = ims.GroundPlane(image_size=(1280, 720), camera_height_m=3.0, **told)
    model = ims.fit(detections, plane)
    assert ims.Flag.CAMERA_CONFLICT in model.flags
    (conflict,) = explain(model).conflicts
    assert conflict.what == "camera height"
    assert conflict.told == 3.0
    assert conflict.implied == pytest.approx(1.5, rel=0.08)
    sound = ims.GroundPlane(image_size=(1280, 720), camera_height_m=1.5, **told)
    assert ims.Flag.CAMERA_CONFLICT not in ims.fit(detections, sound).flags


def test_the_gain_of_one_more_of_a_label_follows_its_information():
    model = fitted(depth=depths(kind="relative"))
    found = {item.what: item.k_rel_std_after for item in next_references(model)}
    scale = float(np.median(DISTANCE)) / FOCAL * (model.k * FOCAL)
    noise = {
        label: log_var(label) + box_var(LABELS[label][0] / scale) + 0.05**2 for label in LABELS
    }
    own = [
        log_var(n) + box_var(pixels_of(n, z)) + 0.05**2
        for n, z in zip(NAMES[:3], DISTANCE[:3], strict=True)
    ]
    idols, jars = 1 / own[0] + 1 / own[2], 1 / own[1]
    of_idols, of_jars = 1 / (1 / idols + 0.02**2), 1 / (1 / jars + 0.03**2)
    now = of_idols + of_jars
    assert model.k_std / model.k == pytest.approx(1 / math.sqrt(now), rel=1e-4)
    more_idols = 1 / (1 / (idols + 1 / noise["idol"]) + 0.02**2)
    assert found["another idol"] == pytest.approx(1 / math.sqrt(more_idols + of_jars), rel=1e-4)
    chest = 1 / noise["chest"]
    assert found["a chest (the first)"] == pytest.approx(1 / math.sqrt(now + chest), rel=1e-4)
    measured = 1 / (0.005**2 + box_var(pixels_of("statue", 13.0)) + 0.05**2)
    assert found["the statue, measured on site to 0.5 %"] == pytest.approx(
        1 / math.sqrt(now + measured), rel=1e-4
    )


def test_next_references_are_ranked_and_at_most_three_labels_are_new():
    model = ims.fit(
        [ims.Detection("car", (100, 50, 260, 150)), ims.Detection("statue", (500, 80, 600, 230))],
        depths([4.0, 5.0], kind="relative"),
        noise=TOLD,
    )
    found = next_references(model)
    after = [item.k_rel_std_after for item in found]
    assert after == sorted(after)
    assert all(value <= model.k_std / model.k * (1 + 1e-9) for value in after)
    assert sum("(the first)" in item.what for item in found) == 3
    assert {"another car", "the statue, measured on site to 0.5 %"} <= {i.what for i in found}
    assert not any(item.label == "car" and "first" in item.what for item in found)


def test_where_the_camera_knows_k_nothing_helps():
    sure = ims.Camera(FOCAL, focal_rel_std=0.001)
    assert "No further reference would narrow k by much." in str(explain(fitted(camera=sure)))


def test_one_more_reference_narrows_a_fit_as_it_was_told():
    boxes = detections(["idol", "jar"], [6.0, 6.0])
    model = fitted(boxes, depths([6.0, 6.0], kind="relative"))
    promised = {item.what: item.k_rel_std_after for item in next_references(model)}
    more = detections(["idol", "jar", "chest"], [6.0, 6.0, 6.0])
    wider = fitted(more, depths([6.0] * 3, kind="relative"))
    assert wider.k_std / wider.k == pytest.approx(promised["a chest (the first)"], rel=1e-3)


def test_an_explanation_is_short_plain_text_and_goes_through_json():
    model = fitted(method="posterior", camera=CAMERA)
    estimates = ims.predict(model, detections(), depths())
    explanation = explain(model, estimates)
    text = str(explanation)
    assert text.startswith(str(model))
    assert len(text.splitlines()) <= 15
    assert "nan" not in text
    record = json.loads(json.dumps(explanation.to_dict(), allow_nan=False))
    assert set(record) == set(Explanation.__annotations__)
    assert len(record["budgets"]) == 4
    assert record["k_budget"]["depths"] == pytest.approx(explanation.k_budget.depths)


def test_many_sizes_are_counted_not_listed():
    model = fitted(depth=depths(kind="relative"))
    estimates = ims.predict(model, detections(), depths(kind="relative")) * 2
    text = str(explain(model, estimates))
    assert "And 4 more sizes." in text
    assert text.count("its height has a standard error") == 4


def test_a_camera_alone_can_be_explained():
    depth = depths([5.0])
    thing = [ims.Detection("thing", (10.0, 10.0, 60.0, 60.0))]
    model = ims.fit(thing, depth, table(), camera=CAMERA)
    explanation = explain(model, ims.predict(model, thing, depth))
    assert explanation.carried == ()
    assert explanation.focal is None
    assert explanation.k_budget.shares["camera"] == pytest.approx(1.0, abs=0.01)
    assert "thing" in str(explanation)


@pytest.mark.parametrize("method", ["mean_ratio", "least_squares", "robust", "posterior"])
def test_every_method_and_kind_can_be_explained(method):
    kinds = ["metric", "relative", "inverse"]
    kinds += ["affine_inverse"] if method in {"robust", "posterior"} else []
    for kind in kinds:
        values = 1 / DISTANCE if "inverse" in kind else DISTANCE
        model = fitted(depth=depths(values, kind), method=method)
        explanation = explain(model, ims.predict(model, detections(), depths(values, kind)))
        assert explanation.k_budget.rel_std == pytest.approx(model.k_std / model.k)
        assert str(explanation)


def test_arguments_of_the_wrong_type_are_refused():
    model = fitted()
    with pytest.raises(TypeError, match="`model` must be a ScaleModel"):
        explain("model")
    with pytest.raises(TypeError, match="`estimates` must be a SizeEstimate"):
        explain(model, ["1.5 m"])
    with pytest.raises(TypeError, match="sequence of SizeEstimate"):
        explain(model, 3)
