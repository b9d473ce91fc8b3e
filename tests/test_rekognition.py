"""Amazon Rekognition: real responses by hand arithmetic, its naming, a real boto3 client."""

import ast
import copy
import io
import json
import os
import re
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import attrs
import numpy as np
import pytest
from PIL import Image

import imgscale as ims
from imgscale.detectors import rekognition
from imgscale.detectors.rekognition import RekognitionDetector, from_rekognition

DATA = Path(
    os.environ.get("IMGSCALE_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data"
)
RESPONSE = DATA / "detector_outputs" / "rekognition" / "awscli_detect-labels.json"
needs_response = pytest.mark.skipif(
    not RESPONSE.is_file(), reason=f"no Rekognition response in {RESPONSE.parent}"
)

SIZE = (1000, 500)
BOX = {"Left": 0.25, "Top": 0.5, "Width": 0.125, "Height": 0.25}
OTHER_BOX = {"Left": 0.5, "Top": 0.5, "Width": 0.125, "Height": 0.25}
PIXELS = (250.0, 250.0, 375.0, 375.0)


def a_label(name, *boxes, parents=(), aliases=(), confidence=90.0):
    return {
        "Name": name,
        "Confidence": confidence,
        "Instances": [{"BoundingBox": dict(box), "Confidence": confidence} for box in boxes],
        "Parents": [{"Name": parent} for parent in parents],
        "Aliases": [{"Name": alias} for alias in aliases],
    }


def read(*labels, size=SIZE):
    return from_rekognition({"Labels": list(labels)}, image_size=size)


def prior_of(detection):
    table = ims.PriorTable.default()
    known = [name for name in detection.names if name in table]
    return table.lookup(known[0])[0].label if known else None


# --- a real response, label model 2.0 ---


@pytest.fixture
def response():
    return json.loads(RESPONSE.read_text())


@needs_response
def test_the_real_response_gives_one_detection_for_each_of_its_instances(response):
    found = Counter(detection.label for detection in from_rekognition(response, image_size=SIZE))
    assert found == {"Car": 14, "Person": 2, "Wheel": 10, "Skateboard": 1}


@needs_response
def test_boxes_of_the_real_response_are_its_ratios_times_the_size(response):
    car = from_rekognition(response, image_size=(1920, 1080))[0]
    left, top = 0.0037978808395564556 * 1920, 0.5039216876029968 * 1080
    width, height = 0.10616336017847061 * 1920, 0.18528179824352264 * 1080
    assert car.xyxy == pytest.approx((left, top, left + width, top + height), rel=1e-12)
    assert (round(car.width_px, 2), round(car.height_px, 2)) == (203.83, 200.10)
    assert car.score == pytest.approx(0.9915271759033203, rel=1e-15)


@needs_response
def test_every_instance_of_the_real_response_keeps_its_place_and_score(response):
    boxes, scores = [], []
    for label in response["Labels"]:
        for instance in label["Instances"]:
            box = instance["BoundingBox"]
            x1, y1 = box["Left"] * 800, box["Top"] * 600
            boxes.append((x1, y1, x1 + box["Width"] * 800, y1 + box["Height"] * 600))
            scores.append(instance["Confidence"] / 100)
    found = from_rekognition(response, image_size=(800, 600))
    got = np.array([detection.xyxy for detection in found])
    np.testing.assert_allclose(got, np.clip(boxes, 0, (800, 600, 800, 600)), rtol=1e-12)
    np.testing.assert_allclose([detection.score for detection in found], scores, rtol=1e-15)


@needs_response
def test_the_real_skateboard_is_not_sized_as_its_parent_person(response):
    found = from_rekognition(response, image_size=SIZE)
    (board,) = [detection for detection in found if detection.label == "Skateboard"]
    assert board.aliases == ()
    assert prior_of(board) is None


@needs_response
def test_the_real_response_can_be_fitted_and_measured(response):
    found = from_rekognition(response, image_size=(1920, 1080))
    depth = ims.ObjectDepths([10.0] * len(found), kind="relative", image_size=(1920, 1080))
    model = ims.fit(found, depth)
    used = {reference.label for reference in model.references if reference.used}
    assert used
    assert used <= {"Car", "Person", "Wheel"}
    assert len(ims.predict(model, found, depth)) == 27


@needs_response
def test_a_response_is_left_as_it_was(response):
    before = copy.deepcopy(response)
    from_rekognition(response, image_size=SIZE)
    assert response == before


# --- names; parents as responses of the label models 2.0 and 3.0 give them ---


@pytest.mark.parametrize(
    ("name", "parents", "prior"),
    [
        ("Face", ["Head", "Person"], "face"),
        ("Head", ["Person"], "head"),
        ("Hair", ["Person"], None),
        ("Neck", ["Body Part", "Face", "Head", "Person"], None),
        ("Teeth", ["Body Part", "Mouth", "Person"], None),
        ("Skateboard", ["Person", "Sport"], None),
        ("Portrait", ["Face", "Head", "Person", "Photography"], None),
        ("Coat", ["Clothing"], None),
        ("Wheel", ["Machine"], "wheel"),
        ("Car Wheel", ["Car", "Machine", "Tire", "Transportation", "Vehicle", "Wheel"], "car tire"),
        ("Alloy Wheel", ["Car", "Car Wheel", "Machine", "Spoke", "Tire", "Wheel"], "wheel"),
        ("License Plate", ["Transportation", "Vehicle"], "licence plate"),
        ("Bumper", ["Transportation", "Vehicle"], None),
        ("Parking Lot", ["Car", "Vehicle", "Transportation"], None),
        ("Sports Car", ["Transportation", "Car", "Vehicle"], "car"),
        ("Race Car", ["Vehicle", "Transportation", "Sports Car", "Car"], "car"),
        ("Formula One", ["Transportation", "Car", "Vehicle"], None),
        ("Puppy", ["Animal", "Canine", "Dog", "Mammal", "Pet"], None),
        ("Baby", ["Person"], None),
        ("Mobile Phone", ["Electronics", "Phone"], "cell phone"),
    ],
)
def test_only_a_parent_that_ends_the_name_lends_its_prior(name, parents, prior):
    (found,) = read(a_label(name, BOX, parents=parents))
    assert found.label == name
    assert prior_of(found) == prior


def test_a_part_keeps_clear_of_its_whole_whatever_the_table_lacks():
    table = ims.PriorTable([ims.ObjectPrior("person", 1.7, 0.1), ims.ObjectPrior("car", 1.5, 0.1)])
    for name, parents in (("Face", ["Head", "Person"]), ("Car Wheel", ["Car", "Wheel"])):
        (found,) = read(a_label(name, BOX, parents=parents))
        assert not any(known in table for known in found.names)


def test_the_longest_of_the_parents_that_end_a_name_comes_first():
    (found,) = read(a_label("Old Sports Car", BOX, parents=["Car", "Sports Car", "Vehicle"]))
    assert found.aliases == ("Sports Car", "Car")


def test_the_aliases_of_a_label_come_before_its_parents():
    label = a_label("Sports Car", BOX, parents=["Car"], aliases=["Roadster"])
    assert read(label)[0].aliases == ("Roadster", "Car")


def test_an_alias_finds_the_prior_that_the_name_does_not():
    (found,) = read(a_label("Motorbike Thing", BOX, aliases=["Motorbike"]))
    assert prior_of(found) == "motorcycle"


def test_names_are_read_bare_too_and_categories_not_at_all():
    label = {
        "Name": "Cup",
        "Instances": [{"BoundingBox": BOX}],
        "Aliases": ["Mug"],
        "Parents": ("Tableware",),
        "Categories": ["Kitchen", {"Name": "Home"}, None],
    }
    assert read(label)[0].names == ("Cup", "Mug")


# --- one object under several labels ---

PEOPLE = (
    a_label("Adult", BOX, OTHER_BOX, parents=["Person"]),
    a_label("Female", OTHER_BOX, parents=["Person"]),
    a_label("Male", BOX, parents=["Person"]),
    a_label("Man", BOX, parents=["Adult", "Male", "Person"], confidence=80.0),
    a_label("Person", BOX, OTHER_BOX, aliases=["Human"]),
    a_label("Woman", OTHER_BOX, parents=["Adult", "Female", "Person"]),
)


def test_labels_with_the_very_same_box_are_one_detection_under_the_most_specific_name():
    man, woman = read(*PEOPLE)
    assert man.names == ("Man", "Adult", "Male", "Person", "Human")
    assert woman.names == ("Woman", "Adult", "Female", "Person", "Human")
    assert (prior_of(man), prior_of(woman)) == ("man", "woman")
    assert man.xyxy == PIXELS


def test_the_score_of_a_merged_detection_is_that_of_its_own_name():
    assert [found.score for found in read(*PEOPLE)] == [0.8, 0.9]


def test_merging_does_not_hang_on_the_order_of_labels():
    names = {found.xyxy: set(found.names) for found in read(*PEOPLE)}
    back = read(*reversed(PEOPLE))
    assert {found.xyxy: set(found.names) for found in back} == names
    assert {found.label for found in back} == {"Man", "Woman"}


def test_an_adult_of_no_told_sex_has_the_prior_of_a_person():
    (found,) = read(
        a_label("Adult", BOX, parents=["Person"]), a_label("Person", BOX, aliases=["Human"])
    )
    assert found.label == "Adult"
    assert prior_of(found) == "person"


@pytest.mark.parametrize(
    ("names", "label", "prior"),
    [
        pytest.param(["Teen", "Girl", "Female", "Person"], "Teen", "teenager", id="teen"),
        pytest.param(["Person", "Girl", "Female"], "Girl", "child", id="girl"),
        pytest.param(["Child", "Male", "Boy", "Person"], "Boy", "child", id="boy"),
        pytest.param(["Baby", "Person"], "Baby", None, id="baby"),
        pytest.param(["Child", "Boy", "Baby", "Male", "Person"], "Baby", None, id="baby boy"),
        pytest.param(["Newborn", "Baby", "Person"], "Newborn", None, id="newborn"),
        pytest.param(["Dog", "Puppy", "Pet"], "Puppy", None, id="puppy"),
    ],
)
def test_the_young_are_never_sized_as_their_elders(names, label, prior):
    parents = {
        "Girl": ["Female", "Person"],
        "Boy": ["Child", "Male", "Person"],
        "Newborn": ["Baby", "Person"],
        "Puppy": ["Dog", "Pet"],
    }
    (found,) = read(*(a_label(name, BOX, parents=parents.get(name, ["Person"])) for name in names))
    assert found.label == label
    assert prior_of(found) == prior


def test_the_prior_of_a_person_stays_away_from_a_child_that_the_table_does_not_know():
    table = ims.PriorTable([ims.ObjectPrior("person", 1.7, 0.1)])
    (found,) = read(a_label("Child", BOX, parents=["Person"]), a_label("Person", BOX))
    assert not any(name in table for name in found.names)


def test_boxes_that_differ_at_all_stay_apart():
    nearly = {**BOX, "Height": float(np.nextafter(np.float32(0.25), np.float32(1)))}
    found = read(a_label("Person", BOX), a_label("Suit", nearly))
    assert [detection.label for detection in found] == ["Person", "Suit"]


# --- what may be missing ---


@pytest.mark.parametrize(
    "labels",
    [
        pytest.param([], id="no labels"),
        pytest.param([{"Name": "Urban"}], id="no instances key"),
        pytest.param([{"Name": "Urban", "Instances": []}], id="empty instances"),
        pytest.param([{"Name": "Urban", "Instances": None}], id="null instances"),
    ],
)
def test_labels_without_a_box_give_no_detection(labels):
    assert read(*labels) == []


def test_the_confidence_of_the_label_stands_in_for_the_instances_and_one_for_both():
    instances = [{"BoundingBox": BOX}]
    (of_label,) = read({"Name": "Car", "Confidence": 75.0, "Instances": instances})
    (of_none,) = read({"Name": "Car", "Instances": instances})
    assert (of_label.score, of_none.score) == (0.75, 1.0)


def test_a_confidence_of_zero_is_a_score_of_zero():
    label = a_label("Car", BOX)
    label["Instances"][0]["Confidence"] = 0
    assert read(label)[0].score == 0.0


def test_a_box_that_runs_beyond_the_picture_is_cut_at_its_border():
    box = {"Left": -0.01, "Top": 0.75, "Width": 0.5, "Height": 0.26}
    assert read(a_label("Car", box))[0].xyxy == (0.0, 375.0, 490.0, 500.0)


# --- wrong input ---

VIDEO = {"Timestamp": 0, "Label": a_label("Person", BOX)}


def with_box(**changes):
    return {"Labels": [a_label("Sky"), a_label("Car", {**BOX, **changes})]}


@pytest.mark.parametrize(
    ("response", "error", "message"),
    [
        pytest.param(None, TypeError, "`response` must be the dict .* got NoneType", id="none"),
        pytest.param("{}", TypeError, r"got str\. Read it with json\.loads", id="text"),
        pytest.param([], TypeError, "got list", id="list"),
        pytest.param(
            {"FaceDetails": []}, ValueError, "got the keys FaceDetails.*GENERAL_LABELS", id="faces"
        ),
        pytest.param({}, ValueError, "got the keys none", id="empty"),
        pytest.param({"Labels": {}}, TypeError, r"response\.Labels must be a list", id="dict"),
        pytest.param({"Labels": [3]}, TypeError, r"Labels\[0\] must be a dict; got int", id="int"),
        pytest.param(
            {"Labels": [VIDEO]}, ValueError, r"Labels\[0\] .*GetLabelDetection.*moment", id="video"
        ),
        pytest.param(
            {"Labels": [{"Name": "Car", "Instances": {}}]},
            TypeError,
            r"Labels\[0\]\.Instances must be a list; got dict",
            id="instances",
        ),
        pytest.param(
            {"Labels": [{"Name": "Car", "Instances": [None]}]},
            TypeError,
            r"Labels\[0\]\.Instances\[0\] must be a dict",
            id="instance",
        ),
        pytest.param(
            {"Labels": [{"Name": "Car", "Instances": [{}]}]},
            TypeError,
            r"Labels\[0\]\.Instances\[0\]\.BoundingBox must be a dict; got NoneType",
            id="no box",
        ),
        pytest.param(
            {"Labels": [{"Name": "Car", "Instances": [{"BoundingBox": {"Left": 0.1}}]}]},
            ValueError,
            "must hold Left, Top, Width and Height; it lacks Top, Width, Height",
            id="box keys",
        ),
        pytest.param(
            {"Labels": [{"Instances": [{"BoundingBox": BOX}]}]},
            TypeError,
            r"Labels\[0\]\.Name must be a string .* got None",
            id="no name",
        ),
        pytest.param(
            {"Labels": [{**a_label("Car", BOX), "Parents": [5]}]},
            TypeError,
            r"Labels\[0\]\.Parents\[0\] must be a name .* got 5",
            id="parent",
        ),
        pytest.param(
            with_box(Left=120),
            ValueError,
            r"Labels\[1\]\.Instances\[0\]\.BoundingBox\.Left` must be a ratio.*got 120.*pixels",
            id="pixels",
        ),
        pytest.param(
            with_box(Top=float("nan")), ValueError, r"BoundingBox\.Top` must be a ratio", id="nan"
        ),
        pytest.param(
            with_box(Width="0.5"), TypeError, r"BoundingBox\.Width` must be a ratio", id="text side"
        ),
        pytest.param(with_box(Height=0), ValueError, "positive Width and Height", id="flat"),
        pytest.param(
            with_box(Left=1.04), ValueError, r"Labels\[1\]\.Instances\[0\].*overlap", id="outside"
        ),
        pytest.param(
            {"Labels": [a_label("Car", BOX, confidence=150.0)]},
            ValueError,
            r"Labels\[0\]\.Instances\[0\]\.Confidence` must be between 0 and 100; got 150",
            id="confidence",
        ),
        pytest.param(
            {"Labels": [a_label("Car", BOX, confidence="99")]},
            TypeError,
            "Confidence` must be between 0 and 100; got '99'",
            id="text confidence",
        ),
    ],
)
def test_wrong_input_is_refused_by_its_place(response, error, message):
    with pytest.raises(error, match=message):
        from_rekognition(response, image_size=SIZE)


def test_the_size_of_the_image_must_be_one():
    with pytest.raises(ValueError, match="`image_size` must be"):
        from_rekognition({"Labels": []}, image_size=(0, 5))


# --- the runner ---


class Recorder:
    def __init__(self, *labels):
        self.answer = {"Labels": list(labels)}
        self.requests = []

    def detect_labels(self, **request):
        self.requests.append(request)
        return self.answer


def sent_picture(recorder):
    return Image.open(io.BytesIO(recorder.requests[-1]["Image"]["Bytes"]))


def noise(width, height):
    return np.random.default_rng(7).integers(0, 256, (height, width, 3), dtype=np.uint8)


@pytest.fixture
def client():
    boto3 = pytest.importorskip("boto3", reason="boto3 is not installed")
    return boto3.client(
        "rekognition",
        region_name="eu-west-1",
        aws_access_key_id="none",
        aws_secret_access_key="none",  # noqa: S106 - nothing is ever sent
    )


def stub(client):
    return pytest.importorskip("botocore.stub", reason="botocore is not installed").Stubber(client)


def test_a_real_client_takes_the_request_and_its_answer_is_read(client):
    stubber = stub(client)
    stubber.add_response(
        "detect_labels",
        {"Labels": list(PEOPLE), "LabelModelVersion": "3.0"},
        {
            "Image": {"Bytes": pytest.importorskip("botocore.stub").ANY},
            "MaxLabels": 20,
            "MinConfidence": 70.0,
            "Features": ["GENERAL_LABELS"],
        },
    )
    options = {"MaxLabels": 20, "MinConfidence": 70.0, "Features": ["GENERAL_LABELS"]}
    detector = RekognitionDetector(client, options=options)
    with stubber:
        man, woman = detector(noise(1000, 500))
    stubber.assert_no_pending_responses()
    assert (man.label, man.xyxy) == ("Man", PIXELS)
    assert woman.label == "Woman"


@needs_response
def test_a_real_response_passes_through_a_real_client(client, response):
    stubber = stub(client)
    stubber.add_response("detect_labels", response)
    with stubber:
        found = RekognitionDetector(client)(noise(640, 480))
    assert found == from_rekognition(response, image_size=(640, 480))


def test_errors_of_a_real_client_come_through(client):
    exceptions = pytest.importorskip("botocore.exceptions")
    stubber = stub(client)
    stubber.add_client_error("detect_labels", "AccessDeniedException")
    with stubber, pytest.raises(exceptions.ClientError, match="AccessDenied"):
        RekognitionDetector(client)(noise(64, 48))


def test_nothing_but_the_picture_is_sent_unless_asked_for():
    recorder = Recorder()
    assert RekognitionDetector(recorder)(noise(64, 48)) == []
    assert list(recorder.requests[0]) == ["Image"]


def test_options_are_copied_when_the_detector_is_made():
    recorder, options = Recorder(), {"MaxLabels": 5, "Settings": {}}
    detector = RekognitionDetector(recorder, options=options)
    options["MaxLabels"] = 50
    options["Settings"]["GeneralLabels"] = {}
    detector(noise(64, 48))
    del recorder.requests[0]["Image"]
    assert recorder.requests[0] == {"MaxLabels": 5, "Settings": {}}
    assert attrs.evolve(detector, client=Recorder()).options == detector.options


def test_options_cannot_be_changed_afterwards():
    detector = RekognitionDetector(Recorder(), options={"MaxLabels": 5})
    with pytest.raises(TypeError, match="does not support item assignment"):
        detector.options["Image"] = {}


def test_the_picture_sent_is_a_jpeg_of_the_same_size_and_colours():
    image = np.zeros((48, 64, 3), dtype=np.uint8)
    image[:, :32] = (200, 30, 60)
    image.flags.writeable = False
    recorder = Recorder()
    RekognitionDetector(recorder)(image)
    sent = sent_picture(recorder)
    assert (sent.format, sent.size) == ("JPEG", (64, 48))
    assert np.abs(np.asarray(sent, dtype=int)[:, :24] - (200, 30, 60)).max() <= 4


def test_a_picture_too_large_for_the_service_is_sent_in_fewer_bytes():
    recorder = Recorder()
    RekognitionDetector(recorder)(noise(2600, 2400))  # 7.3 MB at quality 95, 4.7 at 85
    assert len(recorder.requests[0]["Image"]["Bytes"]) <= 5_242_880
    assert sent_picture(recorder).size == (2600, 2400)


def test_a_smaller_copy_is_sent_where_quality_is_not_enough_and_boxes_fit_the_original(monkeypatch):
    monkeypatch.setattr(rekognition, "_MOST_BYTES", 60_000)
    recorder = Recorder(a_label("Car", BOX))
    (car,) = RekognitionDetector(recorder)(noise(1000, 500))
    assert len(recorder.requests[0]["Image"]["Bytes"]) <= 60_000
    assert sent_picture(recorder).size == (500, 250)
    assert car.xyxy == PIXELS


def test_a_box_wholly_outside_the_picture_is_dropped():
    outside = {**BOX, "Left": 1.04}
    recorder = Recorder(a_label("Bus", outside), a_label("Car", BOX))
    assert [found.label for found in RekognitionDetector(recorder)(noise(100, 50))] == ["Car"]


def test_the_detector_is_a_detector():
    assert isinstance(RekognitionDetector(Recorder()), ims.Detector)


@pytest.mark.parametrize(
    ("client", "options", "error", "message"),
    [
        (SimpleNamespace(), {}, TypeError, "`client` must have a method detect_labels"),
        (Recorder(), {"Image": {}}, ValueError, "`options` must leave Image"),
        (Recorder(), 5, TypeError, "`options` must be a dict; got int"),
        (Recorder(), (5,), TypeError, "`options` must be a dict; got tuple"),
    ],
)
def test_a_detector_that_cannot_work_is_not_made(client, options, error, message):
    with pytest.raises(error, match=message):
        RekognitionDetector(client, options=options)


def test_an_image_of_another_type_is_refused_before_anything_is_sent():
    recorder = Recorder()
    with pytest.raises(ValueError, match=r"`image` must be \(H, W, 3\) uint8"):
        RekognitionDetector(recorder)(np.zeros((4, 4)))
    assert recorder.requests == []


# --- responses as documentation prints them, their grammar mended ---


def mended(text):
    if "EXAMPLE_INFERENCE_OUTPUT" in text:  # a Python program that holds one
        (literal,) = re.findall(r"EXAMPLE_INFERENCE_OUTPUT = (\{.*?\n\})", text, re.DOTALL)
        return ast.literal_eval(literal)
    if re.match(r"\{\s*\{", text):
        text = text.strip()[1:-1]
    text = re.sub(r",(\s*[}\]])", r"\1", text)
    return json.loads(re.sub(r'([}\]])(\s*["{])', r"\1,\2", text))


@needs_response
@pytest.mark.parametrize(
    ("name", "count", "labels"),
    [
        ("images-s3_3", 16, {"Car": 14, "Person": 2}),
        ("labels-detect-labels-image_0", 1, {"Mobile Phone": 1}),
        ("labels-detect-labels-image_1", 1, {"Mobile Phone": 1}),
    ],
)
def test_printed_responses_are_read_once_their_grammar_is_mended(name, count, labels):
    text = (RESPONSE.parent / f"{name}.invalid.txt").read_text()
    found = from_rekognition(mended(text), image_size=SIZE)
    assert len(found) == count
    assert Counter(detection.label for detection in found) == labels
