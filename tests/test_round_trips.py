"""What is written is read again, and what is copied is equal, by every public type."""

import copy
import functools
import json
import math
import pickle
from pathlib import Path

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import imgscale as ims
from imgscale import Flag, batch
from imgscale.datasets import drawn
from imgscale.depth_sources import OnGround
from imgscale.quantity import Quantity

STORED = Path(__file__).parent / "stored"
MODELS = sorted(path.name for path in STORED.glob("model_*.json"))

TABLE = ims.PriorTable([
    ims.ObjectPrior("door", 2.0, 0.02, mean_std_m=0.01, aliases=("gate",)),
    ims.ObjectPrior("man", 1.7, 0.1, share=0.8),
    ims.ObjectPrior("man", 1.1, 0.1, share=0.2),
])  # fmt: skip
DETECTIONS = (
    ims.Detection("door", (100, 50, 180, 250)),
    ims.Detection("man", (300, 80, 400, 230), score=0.5, track_id=3),
    ims.Detection("statue", (300, 80, 400, 230), aliases=("bust",)),
    ims.Detection("man", (200, 80, 250, 230), partial=True),
    ims.Detection("man", (500, 80, 550, 230)),
)
SIZE = (640, 480)
MASK = np.zeros((480, 640), dtype=bool)
MASK[50:250, 100:180] = True
MAP = ims.DepthMap(np.linspace(3, 5, 48 * 64).reshape(48, 64), kind="metric", image_size=SIZE)
DEPTHS = ims.ObjectDepths([4, 4.5, 5, 4, math.nan], kind="relative", image_size=SIZE)
CAMERA = ims.Camera(700.0, focal_rel_std=0.1, image_size=SIZE)
GROUND = ims.GroundPlane(image_size=SIZE, horizon_px=40, horizon_std_px=5)
FRAMES = [ims.Frame(DETECTIONS, MAP, name=str(number)) for number in range(3)]
SHIFTED = ims.ObjectDepths([0.25, 0.2, 0.1, 0.3, math.nan], kind="affine_inverse")


MODEL_KINDS = (
    "relative", "robust", "of the paper", "affine", "with camera", "camera alone", "plane",
    "two witnesses", "shared",
)  # fmt: skip
WITH_VALUES = (
    "camera", "detection", "detection with mask", "explanation", "fitted plane", "flag",
    "ground plane", "measurement", "noise", "prior", "prior table", "shipped table", "reference",
    "reference without depth", "outcome", "failed outcome", "shared scale", "size",
    "size without depth", "suspicion", "quantity of nothing",
)  # fmt: skip


@functools.cache
def models():
    return {
        "relative": ims.fit(DETECTIONS, DEPTHS, TABLE),
        "robust": ims.fit(DETECTIONS, DEPTHS, TABLE, method="robust"),
        "of the paper": ims.fit(DETECTIONS, DEPTHS, TABLE, method="mean_ratio"),
        "affine": ims.fit(DETECTIONS, SHIFTED, TABLE),
        "with camera": ims.fit(DETECTIONS, MAP, TABLE, camera=CAMERA),
        "camera alone": ims.fit([], MAP, TABLE, camera=CAMERA),
        "plane": ims.fit(DETECTIONS, GROUND, TABLE),
        "two witnesses": ims.fit(DETECTIONS, MAP, TABLE, ground=GROUND, method="robust"),
        "shared": ims.fit_shared(FRAMES, TABLE)[1],
    }


@functools.cache
def equal_by_value():
    """One or more of every public type that has values."""
    model, plane = ims.fit(DETECTIONS, DEPTHS, TABLE), ims.fit(DETECTIONS, GROUND, TABLE)
    sizes = ims.predict(model, DETECTIONS, DEPTHS)
    found = ims.measure(
        np.zeros((480, 640, 3), dtype=np.uint8),
        detector=DETECTIONS,
        depth_source=lambda _: MAP,
        priors=TABLE,
    )
    millimetres = ims.ObjectDepths(1000 * np.array([4, 4.5, 5, 4, math.nan]), kind="metric")
    return {
        "camera": CAMERA,
        "detection": DETECTIONS[1],
        "detection with mask": ims.Detection("door", (100, 50, 180, 250), mask=MASK),
        "explanation": ims.explain(model, sizes),
        "fitted plane": plane.plane,
        "flag": Flag.OUTLIERS | Flag.PARTIAL,
        "ground plane": GROUND,
        "measurement": found,
        "noise": ims.Noise(box_rel=0.02),
        "prior": TABLE.priors[0],
        "prior table": TABLE,
        "shipped table": ims.PriorTable.default(),
        "reference": model.references[0],
        "reference without depth": model.references[4],
        "outcome": ims.Outcome(path="a.jpg", measurement=found),
        "failed outcome": ims.Outcome(path="a.jpg", error=ValueError("torn")),
        "shared scale": ims.fit_shared(FRAMES, TABLE)[0].shared,
        "size": sizes[0],
        "size without depth": sizes[4],
        "suspicion": ims.suspect(ims.fit(DETECTIONS, millimetres, TABLE))[0],
        "quantity of nothing": Quantity(
            value=math.nan, std=math.nan, unit="m", quantiles=(float("nan"),) * 3
        ),
        **models(),
    }


RESULT = batch.fit_columns(
    [7, 7, 8], ["door", "x", "x"], [200.0, 150, 90], [4.0, 4, 6], TABLE, kind="relative"
)
EQUAL_TO_THEMSELVES = {
    "depth map": MAP,
    "object depths": DEPTHS,
    "frame": FRAMES[0],
    "batch": RESULT,
    "images of a batch": RESULT.images,
    "rows of a batch": RESULT.rows,
}
ERRORS = [ims.ImgscaleError, ims.FitError, ims.FileError, ims.DepthMismatchError]


def copies(one):
    protocols = range(2, pickle.HIGHEST_PROTOCOL + 1)
    return [
        *(pickle.loads(pickle.dumps(one, protocol)) for protocol in protocols),  # noqa: S301 - ours
        copy.copy(one),
        copy.deepcopy(one),
    ]


@pytest.mark.parametrize("name", [*WITH_VALUES, *MODEL_KINDS])
def test_pickles_and_copies_are_equal_and_have_the_same_hash(name):
    one = equal_by_value()[name]
    for other in copies(one):
        assert type(other) is type(one)
        assert other == one
        assert not other != one  # noqa: SIM202 - both operators
        assert hash(other) == hash(one)
        assert repr(other) == repr(one)


def test_every_public_class_was_tried():
    tried = {type(one) for one in [*equal_by_value().values(), *EQUAL_TO_THEMSELVES.values()]}
    assert list(equal_by_value()) == [*WITH_VALUES, *MODEL_KINDS]
    public = [getattr(module, name) for module in (ims, batch) for name in module.__all__]
    classes = {one for one in public if isinstance(one, type)}
    protocols = {ims.Detector, ims.DepthSource}
    assert classes - tried - protocols == {*ERRORS, ims.MissingDependencyError}


def contents(one):
    """Arrays and values of what is equal to itself alone."""
    if isinstance(one, np.ndarray):
        return one.tolist()
    if isinstance(one, tuple) and not isinstance(one, (str, bytes)):
        return [contents(item) for item in one]
    if attrs.has(type(one)):
        return [contents(getattr(one, field.name)) for field in attrs.fields(type(one))]
    return one


@pytest.mark.parametrize("name", EQUAL_TO_THEMSELVES)
def test_what_holds_arrays_is_equal_to_itself_alone_and_its_copies_hold_the_same(name):
    one = EQUAL_TO_THEMSELVES[name]
    assert one == one  # noqa: PLR0124 - that is the question
    assert len({one, one}) == 1
    for other in copies(one):
        assert other != one
        assert not other == one  # noqa: SIM201 - both operators
        assert repr(contents(other)) == repr(contents(one))


@pytest.mark.parametrize(
    ("one", "name"),
    [
        (MAP, "values"),
        (DEPTHS, "values"),
        (ims.Detection("door", (100, 50, 180, 250), mask=MASK), "mask"),
    ],
    ids=["depth map", "object depths", "detection"],
)
def test_arrays_of_copies_are_read_only_too(one, name):
    for other in copies(one):
        with pytest.raises(ValueError, match="read-only"):
            getattr(other, name)[...] = 0


@pytest.mark.parametrize("kind", [*ERRORS, ims.MissingDependencyError])
def test_errors_keep_type_and_words(kind):
    for other in copies(kind("what, and the remedy")):
        assert type(other) is kind
        assert str(other) == "what, and the remedy"


def test_another_mask_makes_another_detection():
    one = ims.Detection("door", (100, 50, 180, 250), mask=MASK)
    other = ims.Detection("door", (100, 50, 180, 250), mask=~MASK | MASK)
    assert one != other
    assert one != ims.Detection("door", (100, 50, 180, 250))
    assert len({one, other, one}) == 2


def test_two_fits_of_the_same_are_equal_though_some_numbers_are_not_known():
    one, other = (ims.fit(DETECTIONS, DEPTHS, TABLE) for _ in range(2))
    assert one == other
    assert len({one, other}) == 1
    assert ims.predict(one, DETECTIONS, DEPTHS) == ims.predict(other, DETECTIONS, DEPTHS)


# ------------------------------------------------------------------ to_dict and from_dict


@pytest.mark.parametrize("name", MODEL_KINDS)
def test_a_model_is_read_from_its_record_and_predicts_the_same(name):
    model = models()[name]
    text = json.dumps(model.to_dict(), allow_nan=False)
    again = ims.ScaleModel.from_dict(json.loads(text))
    assert again == model
    assert ims.ScaleModel.from_dict(model.to_dict()) == model
    assert json.dumps(again.to_dict()) == text
    depth = {"ground_plane": None, "metric": MAP, "relative": DEPTHS, "affine_inverse": SHIFTED}
    sizes = [ims.predict(one, DETECTIONS, depth[model.kind]) for one in (model, again)]
    assert sizes[0] == sizes[1]


@settings(max_examples=25, deadline=None)
@given(
    tall=st.lists(st.floats(1e-3, 1e5), min_size=5, max_size=5),
    z=st.lists(st.floats(1e-6, 1e6), min_size=5, max_size=5),
    method=st.sampled_from(["robust", "posterior", "mean_ratio", "least_squares"]),
)
def test_models_of_any_magnitude_are_read_from_their_records(tall, z, method):
    detections = [
        ims.Detection(label, (0, 0, 10, pixels))
        for label, pixels in zip(["door", "man", "statue", "man", "door"], tall, strict=True)
    ]
    model = ims.fit(detections, ims.ObjectDepths(z, kind="relative"), TABLE, method=method)
    assert ims.ScaleModel.from_dict(json.loads(json.dumps(model.to_dict()))) == model


# ------------------------------------------------------------------ stored files


def stored(name):
    return json.loads((STORED / name).read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", MODELS)
def test_a_stored_model_is_read_and_written_as_it_was(name):
    record = stored(name)
    model = ims.ScaleModel.from_dict(record)
    assert json.loads(json.dumps(model.to_dict())) == record
    assert model.k == record["k"]


def test_models_of_four_kinds_are_stored():
    assert {ims.ScaleModel.from_dict(stored(name)).kind for name in MODELS} == {
        "metric",
        "affine_inverse",
        "ground_plane",
    }
    assert ims.ScaleModel.from_dict(stored("model_shared.json")).shared is not None


def test_a_stored_measurement_gives_its_sizes_again():
    record = stored("measurement.json")
    model = ims.ScaleModel.from_dict(record["model"])
    rows = record["objects"]
    seen = [
        ims.Detection(row["label"], [row[side] for side in ("x1", "y1", "x2", "y2")])
        for row in rows
    ]
    for size, row in zip(ims.predict(model, seen), rows, strict=True):
        low, high = size.interval(0.9)
        # to what the plane's grid moves by rounding
        assert (size.size_m, low, high) == pytest.approx(
            (row["size_m"], row["low_m"], row["high_m"]), rel=1e-6
        )


def test_a_stored_record_gives_its_rows_and_is_resumed(tmp_path):
    done, failed = ims.read_record(STORED / "record.jsonl")
    measured = stored("measurement.json")
    assert done["path"] == "street.png"
    assert done["k"] == pytest.approx(measured["model"]["k"], rel=1e-6)
    for mine, theirs in zip(done["objects"], measured["objects"], strict=True):
        assert mine["size_m"] == pytest.approx(theirs["size_m"], rel=1e-6)
    assert failed["error"]["type"] == "FileNotFoundError"
    record = tmp_path / "record.jsonl"
    record.write_bytes((STORED / "record.jsonl").read_bytes())
    priors = ims.ScaleModel.from_dict(measured["model"]).priors
    outcomes = ims.measure_many(
        ["street.png", "missing.png"],
        detector={"street.png": drawn.street().detections, "missing.png": []},
        depth_source=OnGround(),
        priors=priors,
        record=record,
        progress=False,
    )
    assert [outcome.path for outcome in outcomes] == ["missing.png"]
