"""Results: round trips, texts, scale maps."""

import json
import math
import re

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import imgscale as ims
from imgscale import Flag

FOCAL = 800.0
SIZE = (2000, 1500)
NAN = math.nan


def box(label, height, width=40.0, *, left=50.0, top=20.0, **options):
    return ims.Detection(label, (left, top, left + width, top + height), **options)


def table(*rows):
    return ims.PriorTable(
        [ims.ObjectPrior(label, mean, std, mean_std_m=tau) for label, mean, std, tau in rows]
    )


TABLE = table(("pole", 1.7, 0.1, 0.05), ("gate", 1.1, 0.03, 0.0))


def busy_model(kind="metric", **options):
    """Used, partial, unknown, depthless and outlying detections, camera and noise."""
    heights = {"pole": 1.7, "gate": 1.1, "thing": 0.7}
    labels = ["pole", "gate", "pole", "pole", "gate", "pole", "thing"]
    z = np.array([6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0])
    detections = [
        box(label, FOCAL * heights[label] / d, left=60.0 * i + 20, partial=i == 3)
        for i, (label, d) in enumerate(zip(labels, z, strict=True))
    ]
    detections[4] = box("gate", 5 * detections[4].height_px, left=260.0)
    values = np.where(np.arange(7) == 5, NAN, 100 / z if "inverse" in kind else z)
    return ims.fit(
        detections, ims.ObjectDepths(values, kind=kind, image_size=SIZE), TABLE,
        camera=ims.Camera(FOCAL, focal_rel_std=0.03, cx=900.0, image_size=SIZE),
        noise=ims.Noise(box_px=1.5, box_rel=0.01, depth_rel=0.02), **options,
    )  # fmt: skip


# --- round trip ----------------------------------------------------------------------------------


def through_json(model):
    return ims.ScaleModel.from_dict(json.loads(json.dumps(model.to_dict(), allow_nan=False)))


def assert_same(a, b):
    """Compare field by field and type by type; NaN equals NaN."""
    assert type(a) is type(b)
    if isinstance(a, float) and math.isnan(a):
        assert math.isnan(b)
    elif attrs.has(type(a)) and not isinstance(a, ims.PriorTable):
        for field in attrs.fields(type(a)):
            assert_same(getattr(a, field.name), getattr(b, field.name))
    elif isinstance(a, tuple):
        assert len(a) == len(b)
        for one, other in zip(a, b, strict=True):
            assert_same(one, other)
    else:
        assert a == b


MODELS = {
    "camera, outlier, NaN": busy_model,
    "relative": lambda: busy_model("relative"),
    "inverse": lambda: busy_model("inverse"),
    "affine_inverse": lambda: busy_model("affine_inverse"),
    "robust": lambda: busy_model(method="robust"),
    "mean_ratio": lambda: busy_model(method="mean_ratio"),
    "least_squares": lambda: busy_model(method="least_squares"),
    "one reference": lambda: ims.fit(
        [box("pole", 200.0)], ims.ObjectDepths([6.0], kind="relative"), TABLE
    ),
    "camera alone": lambda: ims.fit(
        [], ims.ObjectDepths([], kind="metric"), TABLE, camera=ims.Camera(9.0, focal_rel_std=0.0)
    ),
    "map": lambda: ims.fit(
        [box("pole", 200.0)],
        ims.DepthMap(np.full((30, 40), 6.0), kind="metric", image_size=SIZE, scale_rel_std=0.15),
        TABLE,
    ),
    "shipped priors": lambda: ims.fit(
        [box("Door", 200.0)], ims.ObjectDepths([6.0], kind="relative")
    ),
}


@pytest.mark.parametrize("name", MODELS)
def test_every_field_survives_json(name):
    model = MODELS[name]()
    assert_same(through_json(model), model)
    assert through_json(model).to_dict() == model.to_dict()


@pytest.mark.parametrize("name", ["camera, outlier, NaN", "one reference", "camera alone"])
def test_the_rebuilt_model_is_equal(name):
    model = MODELS[name]()
    assert through_json(model) == model


@given(
    pixels=st.lists(st.floats(0.5, 5000), min_size=1, max_size=5),
    magnitude=st.floats(1e-12, 1e12),
    seed=st.integers(0, 2**32 - 1),
    method=st.sampled_from(["posterior", "robust"]),
)
@settings(max_examples=40, deadline=None)
def test_any_model_survives_json(pixels, magnitude, seed, method):
    z = magnitude * np.random.default_rng(seed).uniform(1, 10, len(pixels))
    detections = [box("pole", p) for p in pixels]
    model = ims.fit(detections, ims.ObjectDepths(z, kind="relative"), TABLE, method=method)
    assert_same(through_json(model), model)


@pytest.mark.parametrize("method", ["posterior", "robust"])
@pytest.mark.parametrize("kind", ["metric", "affine_inverse"])
def test_a_rebuilt_model_predicts_the_same(kind, method):
    model = busy_model(kind, method=method)
    detections = [box("thing", 55.0), box("pole", 99.0)]
    depth = ims.ObjectDepths([6.5, NAN], kind=kind, image_size=SIZE)
    for use_prior in (False, True):
        a, b = (
            ims.predict(m, detections, depth, use_prior=use_prior)
            for m in (model, through_json(model))
        )
        for one, other in zip(a, b, strict=True):
            assert_same(one, other)


def test_the_record_names_its_schema_and_its_flags():
    record = busy_model().to_dict()
    assert record["schema"] == 4
    assert record["flags"] == ["OUTLIERS"]
    assert record["references"][5]["depth"] is None
    assert record["camera"]["focal_px"] == FOCAL


@pytest.mark.parametrize("schema", [0, 1, 2, 3, "4", None])
def test_a_record_of_another_schema_is_refused(schema):
    record = busy_model().to_dict() | {"schema": schema}
    with pytest.raises(ValueError, match=f"`record` must have schema 4; got {schema!r}"):
        ims.ScaleModel.from_dict(record)


@pytest.mark.parametrize(
    "change",
    [
        {"k": math.nan},
        {"k": -1.0},
        {"k": None},
        {"k_std": -1.0},
        {"shift": "0"},
        {"method": 0},
        {"kind": "depth"},
        {"image_size": []},
        {"image_size": [math.inf, 540]},
        {"references": [{}]},
        {"references": 3},
        {"priors": [{"label": "pole"}]},
        {"camera": {"f": 1}},
        {"flags": ["GREEN"]},
    ],
    ids=str,
)
def test_a_record_that_holds_what_no_model_holds_is_refused(change):
    with pytest.raises(ValueError, match="`record` must hold what `to_dict` writes; it is broken"):
        ims.ScaleModel.from_dict(busy_model().to_dict() | change)


def test_a_record_that_is_no_mapping_is_refused():
    with pytest.raises(TypeError, match="`record` must be a mapping, as `to_dict` writes it; got"):
        ims.ScaleModel.from_dict([1, 2])


def test_from_dict_leaves_its_record_alone():
    record = busy_model().to_dict()
    before = json.dumps(record)
    ims.ScaleModel.from_dict(record)
    assert json.dumps(record) == before


def test_results_are_frozen():
    model = busy_model()
    [estimate] = ims.predict(
        model, [box("thing", 9.0)], ims.ObjectDepths([6.0], kind="metric", image_size=SIZE)
    )
    for result, name in ((model, "k"), (model.references[0], "weight"), (estimate, "size_m")):
        with pytest.raises(attrs.exceptions.FrozenInstanceError):
            setattr(result, name, 1.0)


# --- texts ---------------------------------------------------------------------------------------


def test_a_model_reads_as_one_sentence():
    text = str(busy_model())
    assert text.startswith("k = 0.00125")
    assert text.endswith(
        " 1/px (1 / focal length) from 3 of 6 references and the camera's focal length; "
        "not used: pole 3 (partial), gate 2 (outlier), pole 4 (no depth); without a prior: thing"
    )


@pytest.mark.parametrize(
    ("kind", "unit"),
    [
        ("metric", "1/px (1 / focal length)"),
        ("relative", "m per px and depth unit (depth unit / focal length)"),
        ("inverse", "m (stereo baseline)"),
    ],
)
def test_the_unit_and_meaning_of_k_are_those_of_the_kind(kind, unit):
    model = ims.fit([box("pole", 200.0)], ims.ObjectDepths([6.0], kind=kind), TABLE)
    assert unit in str(model)
    assert str(model).endswith(" from 1 of 1 reference")


def test_numbers_tell_objects_of_one_label_apart():
    detections = [
        box("pole", 200.0), box("gate", 130.0), box("pole", 90.0, partial=True),
        box("gate", 90.0, partial=True), box("tree x", 5.0),
    ]  # fmt: skip
    text = str(ims.fit(detections, ims.ObjectDepths([6.0] * 5, kind="relative"), TABLE))
    assert "from 2 of 4 references" in text
    assert "not used: pole 2 (partial), gate 2 (partial)" in text
    assert "without a prior: tree x" in text


@pytest.mark.parametrize("exponent", [-9, -4, -1, 3, 8])
def test_k_is_written_with_digits_that_its_error_justifies(exponent):
    # 10 % of 1.25: two digits of the error, the value to the same decimal
    depth = ims.ObjectDepths([1.7 / (200 * 1.25 * 10.0**exponent)], kind="relative", rel_std=0.0)
    model = ims.fit(
        [box("pole", 200.0)], depth, table(("pole", 1.7, 0.0, 0.17)), noise=ims.Noise(box_px=0.0)
    )
    text = str(model)
    number = float(text.partition(" +-")[0].replace("k = ", "").strip("("))
    power = re.match(r"k = \(.*?\)(e-?\d+) ", text)
    assert number * float(f"1{power[1]}" if power else 1) == pytest.approx(
        1.25 * 10.0**exponent, rel=0.01
    )


def test_an_estimate_reads_as_label_axis_size_and_flags():
    model = ims.fit(
        [box("pole", 200.0)], ims.ObjectDepths([6.0], kind="relative"), TABLE, method="robust",
        noise=ims.Noise(depth_rel=0.05),
    )  # fmt: skip
    depth = ims.ObjectDepths([6.0, NAN], kind="relative")
    known, unknown = ims.predict(model, [box("pole", 200.0), box("thing", 9.0)], depth)
    assert str(known) == "pole: height 1.70 +- 0.11 m (REFERENCE)"
    assert str(unknown) == "thing: height unknown (NO_DEPTH)"


# --- properties ----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["metric", "relative", "inverse"])
def test_metres_per_pixel_is_k_over_inverse_depth_and_nan_where_there_is_none(kind):
    model = busy_model(kind)
    values = np.array([[5.0, 20.0], [NAN, 0.0], [-3.0, math.inf]])
    scale = model.metres_per_pixel(values)
    distance = 1 / values[0] if kind == "inverse" else values[0]
    np.testing.assert_allclose(scale[0], model.k * distance, rtol=1e-14)
    assert np.isnan(scale[1:]).all()
    assert model.metres_per_pixel(5.0) == pytest.approx(scale[0, 0])


def map_model(kind):
    z = np.linspace(3, 12, 30 * 40).reshape(30, 40)
    z[0, 0] = NAN
    values = 100 / z if kind == "inverse" else z
    depth = ims.DepthMap(values, kind=kind, image_size=SIZE)
    return ims.fit([box("pole", 200.0, left=900, top=600)], depth, TABLE), depth, z


@pytest.mark.parametrize("kind", ["metric", "relative", "inverse"])
def test_the_scale_map_is_k_times_distance_at_every_pixel(kind):
    model, depth, z = map_model(kind)
    expected = model.k * (z / 100 if kind == "inverse" else z)
    np.testing.assert_allclose(model.scale_map(depth), expected, rtol=1e-14)


def fitted_to(values, kind, **changes):
    """Give a model of a map, with the k and shift wanted."""
    depth = ims.DepthMap(values, kind=kind)
    model = attrs.evolve(
        busy_model("metric"), kind=kind, fingerprint=depth.fingerprint, image_size=None,
        camera=None, **changes,
    )  # fmt: skip
    return model, depth


@pytest.mark.parametrize("gap", [NAN, 0.0, -0.0, -2.0, math.inf, -math.inf])
@pytest.mark.parametrize("kind", ["metric", "relative", "inverse", "affine_inverse"])
@pytest.mark.parametrize("dtype", ["float32", "float16", ">f4", "float64"])
def test_a_narrow_map_gives_a_narrow_scale_map_to_its_last_digit(dtype, kind, gap):
    values = np.linspace(0.5, 40, 260 * 140).reshape(260, 140)  # more than one part
    values[3:7, 5:90:3] = gap
    values = values.astype(dtype)
    shift = -7.0 if kind == "affine_inverse" else 0.0  # half of it beyond the horizon
    for ordered in (values, np.asfortranarray(values)):
        model, depth = fitted_to(ordered, kind, k=0.0123, shift=shift)
        found = model.scale_map(depth)
        assert found.dtype == (np.float64 if dtype == "float64" else np.float32)
        expected = model.metres_per_pixel(values)
        wide = values.astype(np.float64)
        law = np.isfinite(wide) & ((wide + shift >= 0) if shift else (wide > 0))
        np.testing.assert_array_equal(np.isnan(expected), ~law)
        np.testing.assert_allclose(found, expected, rtol=2.0**-23, atol=0)


@pytest.mark.parametrize("k", [1e-42, 1e41])
@pytest.mark.parametrize("kind", ["relative", "inverse"])
def test_a_scale_that_float32_does_not_hold_comes_in_double_precision(kind, k):
    model, depth = fitted_to(np.linspace(1, 9, 12, dtype=np.float32).reshape(3, 4), kind, k=k)
    found = model.scale_map(depth)
    assert found.dtype == np.float64
    np.testing.assert_allclose(found, model.metres_per_pixel(depth.values), rtol=1e-15)


@pytest.mark.parametrize("kind", ["metric", "relative", "inverse"])
def test_to_metric_is_focal_length_times_scale(kind):
    model, depth, z = map_model(kind)
    metric = model.to_metric(depth, ims.Camera(640.0, focal_rel_std=0.03, image_size=SIZE))
    expected = 640.0 * model.k * (z / 100 if kind == "inverse" else z)
    np.testing.assert_allclose(metric.values, expected, rtol=1e-14)
    assert (metric.kind, metric.image_size) == ("metric", SIZE)
    assert metric.scale_rel_std == pytest.approx(math.hypot(0.03, model.k_std / model.k))


def test_to_metric_of_a_consistent_scene_is_the_true_depth():
    z = np.full((30, 40), 7.0)
    depth = ims.DepthMap(3.3 * z, kind="relative", image_size=SIZE)
    priors = table(("pole", 1.7, 0.0, 0.0))
    model = ims.fit([box("pole", FOCAL * 1.7 / 7.0)], depth, priors)
    metric = model.to_metric(depth, ims.Camera(FOCAL, focal_rel_std=0.0))
    np.testing.assert_allclose(metric.values, z, rtol=1e-12)


@pytest.mark.parametrize("kind", ["relative", "inverse"])
def test_scale_map_and_to_metric_refuse_another_map(kind):
    model, depth, _ = map_model(kind)
    other = ims.DepthMap(2 * depth.values, kind=kind, image_size=SIZE)
    camera = ims.Camera(FOCAL, focal_rel_std=0.0)
    for call in (model.scale_map, lambda d: model.to_metric(d, camera)):
        with pytest.raises(ims.DepthMismatchError, match="another"):
            call(other)
        with pytest.raises(ims.DepthMismatchError, match='got "metric"'):
            call(ims.DepthMap(depth.values, kind="metric", image_size=SIZE))


def test_to_metric_refuses_the_camera_of_another_picture():
    model, depth, _ = map_model("relative")
    with pytest.raises(ValueError, match=r"`camera\.image_size`"):
        model.to_metric(depth, ims.Camera(FOCAL, focal_rel_std=0.0, image_size=(640, 480)))


def test_the_focal_length_is_the_cameras_or_one_over_k_or_unknown():
    depth = ims.ObjectDepths([6.0], kind="metric")
    model = ims.fit([box("pole", 200.0)], depth, TABLE)
    assert model.focal_px == pytest.approx(1 / model.k)
    assert busy_model("relative").focal_px == FOCAL
    relative = ims.ObjectDepths([6.0], kind="relative")
    assert ims.fit([box("pole", 200.0)], relative, TABLE).focal_px is None
    assert model.camera_height_m is None
    assert model.horizon_px is None
    assert (model.shift, model.shift_std) == (0, 0)


def test_mse_compares_the_used_references_with_their_prior_means():
    model = busy_model()
    squares = [
        (ref.prior_m - model.k * ref.depth * ref.pixels) ** 2
        for ref in model.references
        if not ref.reason
    ]
    assert len(squares) == 3
    assert model.mse_m2 == pytest.approx(sum(squares) / 3, rel=1e-12)
    assert math.isnan(MODELS["camera alone"]().mse_m2)


def test_every_reference_keeps_what_its_detection_said():
    model = busy_model()
    assert [ref.reason for ref in model.references] == [
        "", "", "", "partial", "outlier", "no depth", "no prior",
    ]  # fmt: skip
    for ref in model.references:
        x1, y1, x2, y2 = ref.xyxy
        assert ref.pixels == y2 - y1
        assert ref.axis == "height"
        if ref.reason in {"", "outlier", "partial"}:
            assert ref.metres_per_pixel == pytest.approx(ref.prior_m / ref.pixels)
            assert ref.k == pytest.approx(ref.prior_m / (ref.pixels * ref.depth))
            noise = (1.5 / ref.pixels) ** 2 + 0.01**2 + 0.02**2
            assert ref.noise_rel == pytest.approx(math.sqrt(noise))
        assert x2 - x1 == pytest.approx(40)


def test_flags_are_named_in_the_order_of_the_class():
    model = ims.fit(
        [box("pole", 200.0), box("pole", 300.0)],
        ims.ObjectDepths([6.0, 6.0], kind="metric", image_size=SIZE),
        table(("pole", 100.0, 0.1, 0.0)),
    )
    assert model.flags == Flag.SINGLE_LABEL | Flag.INCONSISTENT | Flag.IMPLAUSIBLE_FOCAL
    assert model.to_dict()["flags"] == ["SINGLE_LABEL", "INCONSISTENT", "IMPLAUSIBLE_FOCAL"]
