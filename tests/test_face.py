"""The face cascade: real faces, pictures without, and what the box stands for in metres."""

import math
import pickle
from pathlib import Path

import numpy as np
import pytest
import skimage as ski
from PIL import Image

import imgscale as ims
from imgscale.depth_sources.assumed import OneDistance
from imgscale.detectors import face
from imgscale.detectors.face import FaceDetector
from imgscale.protocols import Detector

# Marked by hand on enlargements, to about 0.3 px each.
ASTRONAUT_PUPILS = ((203.8, 101.1), (246.7, 103.3))
HOPPER_PUPILS = ((222.2, 190.3), (305.2, 186.7))
# ANSUR II, women: distance of the pupils, in metres.
PUPILS_M, PUPILS_STD_M = 0.0617, 0.0036
WITHOUT_FACES = (
    *("brick", "camera", "cell", "chelsea", "clock", "coffee", "coins", "colorwheel", "grass"),
    *("gravel", "hubble_deep_field", "immunohistochemistry", "moon", "page", "retina", "rocket"),
    "text",
)


def astronaut():
    return ski.data.astronaut()


def hopper():
    matplotlib = pytest.importorskip("matplotlib")
    path = Path(matplotlib.get_data_path()) / "sample_data" / "grace_hopper.jpg"
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB"))


def resized(image, factor):
    height, width = image.shape[:2]
    size = (round(width * factor), round(height * factor))
    return np.asarray(Image.fromarray(image).resize(size, Image.Resampling.BICUBIC))


def small_pictures():
    """The 25 px cut-outs of scikit-image, 100 faces and 100 without, framed and enlarged."""
    for cutout in ski.data.lfw_subset():
        framed = np.pad(np.uint8(255 * cutout), 12, mode="edge")
        yield resized(framed, 6)


# --- what is found ---


@pytest.mark.parametrize(
    ("picture", "pupils"), [(astronaut, ASTRONAUT_PUPILS), (hopper, HOPPER_PUPILS)]
)
def test_a_portrait_has_one_face_around_its_eyes(picture, pupils):
    [found] = FaceDetector()(picture())
    x1, y1, x2, y2 = found.xyxy
    (left_x, left_y), (right_x, right_y) = pupils
    assert found.label == "lbp frontal face"
    assert found.score == 1.0
    assert (left_x + right_x) / 2 == pytest.approx((x1 + x2) / 2, abs=0.05 * found.width_px)
    assert 0.25 < ((left_y + right_y) / 2 - y1) / (y2 - y1) < 0.45
    assert 2.2 < found.width_px / math.dist(*pupils) < 2.75


def test_the_box_is_where_scikit_images_own_merging_puts_it():
    cascade = ski.feature.Cascade(ski.data.lbp_frontal_face_cascade_filename())
    [merged] = cascade.detect_multi_scale(
        img=astronaut(), scale_factor=1.2, step_ratio=1.5, min_size=(24, 24), max_size=(400, 400)
    )
    [found] = FaceDetector()(astronaut())
    x1, y1, x2, y2 = found.xyxy
    assert (x1 + x2) / 2 == pytest.approx(merged["c"] + merged["width"] / 2, abs=5)
    assert (y1 + y2) / 2 == pytest.approx(merged["r"] + merged["height"] / 2, abs=5)
    assert x2 - x1 == pytest.approx(merged["width"], rel=0.1)


@pytest.mark.parametrize("name", WITHOUT_FACES)
def test_pictures_without_a_face_give_none(name):
    assert FaceDetector()(getattr(ski.data, name)()) == []


def test_the_motorcycle_has_no_face_in_either_picture():
    assert [FaceDetector()(image) for image in ski.data.stereo_motorcycle()[:2]] == [[], []]


@pytest.mark.slow
def test_most_small_faces_are_found_and_no_texture_is_one():
    found = [len(FaceDetector(min_share=0.2)(picture)) for picture in small_pictures()]
    assert sum(count == 1 for count in found[:100]) >= 80
    assert max(found[:100]) == 1
    assert not any(found[100:])


# --- the box does not hang on the search ---


def test_the_same_picture_gives_the_same_box():
    assert FaceDetector()(astronaut()) == FaceDetector()(astronaut())


def test_the_order_in_which_threads_find_windows_changes_nothing(monkeypatch):
    class Shuffled:
        def detect_multi_scale(self, **options):
            rows = face_cascade.detect_multi_scale(**options)
            return [rows[place] for place in np.random.default_rng(3).permutation(len(rows))]

    expected = FaceDetector()(astronaut())
    face_cascade = face._cascade()
    monkeypatch.setattr(face, "_cascade", Shuffled)
    assert FaceDetector()(astronaut()) == expected


@pytest.mark.parametrize("factor", [0.35, 0.6, 1.5, 4.0])
@pytest.mark.parametrize(
    ("picture", "pupils"), [(astronaut, ASTRONAUT_PUPILS), (hopper, HOPPER_PUPILS)]
)
def test_the_box_grows_with_the_picture(picture, pupils, factor):
    [found] = FaceDetector()(resized(picture(), factor))
    [original] = FaceDetector()(picture())
    centres = [
        ((d.xyxy[0] + d.xyxy[2]) / 2 / scale, (d.xyxy[1] + d.xyxy[3]) / 2 / scale)
        for d, scale in ((found, factor), (original, 1.0))
    ]
    # the jitter is 2 %, of which a difference shows 1.4 times
    assert found.width_px / factor == pytest.approx(original.width_px, rel=0.08)
    assert math.dist(*centres) < 0.15 * math.dist(*pupils)


def test_the_box_moves_with_the_face_and_varies_by_little():
    boxes = []
    for dx, dy in ((0, 0), (3, 8), (7, 1), (10, 10), (5, 4), (1, 9)):
        [found] = FaceDetector()(astronaut()[dy:, dx:])
        boxes.append((found.xyxy[0] + dx, found.xyxy[1] + dy, found.width_px))
    left, top, width = np.transpose(boxes)
    assert np.std(width) < 0.03 * np.mean(width)
    assert max(np.std(left), np.std(top)) < 0.03 * np.mean(width)


def test_a_mirrored_picture_has_the_mirrored_box():
    [found] = FaceDetector()(astronaut())
    [mirrored] = FaceDetector()(astronaut()[:, ::-1])
    left, right = 512 - mirrored.xyxy[2], 512 - mirrored.xyxy[0]
    assert (left, right) == pytest.approx((found.xyxy[0], found.xyxy[2]), abs=6)


def test_a_face_in_the_far_corner_of_a_large_picture_keeps_its_box():
    # sums over 12 million pixels in single precision have lost the last digits there
    canvas = np.full((3000, 4000, 3), 150, dtype=np.uint8)
    canvas[-512:, -512:] = astronaut()
    [expected] = FaceDetector()(astronaut())
    [found] = FaceDetector(min_share=0.03)(canvas)
    shift = np.array([3488, 2488, 3488, 2488])
    assert np.array(found.xyxy) - shift == pytest.approx(expected.xyxy, abs=6)


def test_two_faces_are_told_apart():
    both = np.hstack([astronaut(), astronaut()[:, ::-1]])
    first, second = sorted(FaceDetector()(both), key=lambda d: d.xyxy[0])
    assert first.xyxy[2] < 512 < second.xyxy[0]
    assert first.width_px == pytest.approx(second.width_px, rel=0.08)


# --- pictures and settings ---


def test_a_grey_picture_does_as_well():
    colour = astronaut()
    grey = np.asarray(Image.fromarray(colour).convert("L"))
    assert FaceDetector()(grey) == FaceDetector()(colour)


@pytest.mark.parametrize(
    "shape", [(1, 1, 3), (10, 10), (23, 500, 3), (24, 24, 3), (2000, 25, 3), (300, 200, 3)]
)
def test_tiny_and_uniform_pictures_give_no_face(shape):
    assert FaceDetector()(np.full(shape, 128, dtype=np.uint8)) == []


def test_the_picture_is_not_written_to():
    picture = astronaut()
    before = picture.copy()
    picture.flags.writeable = False
    FaceDetector()(picture)
    assert np.array_equal(picture, before)


def test_shares_bound_the_size_of_faces():
    # the face is 100 px of 512: a share of 0.195
    assert len(FaceDetector(min_share=0.15, max_share=0.25)(astronaut())) == 1
    assert FaceDetector(min_share=0.25)(astronaut()) == []
    assert FaceDetector(max_share=0.15)(astronaut()) == []


@pytest.mark.parametrize(
    ("shares", "message"),
    [
        ({"min_share": 0.0}, "`min_share` must be above 0 and at most 1; got 0.0."),
        ({"max_share": 1.5}, "`max_share` must be above 0 and at most 1; got 1.5."),
        ({"min_share": 0.5, "max_share": 0.4}, "`min_share` must be at most `max_share`, 0.4;"),
    ],
)
def test_unlawful_shares_are_refused(shares, message):
    with pytest.raises(ValueError, match=message):
        FaceDetector(**shares)


@pytest.mark.parametrize(
    ("picture", "message"),
    [
        (np.zeros((40, 40, 4), dtype=np.uint8), r"got \(40, 40, 4\) uint8. Convert it first."),
        (np.zeros((40, 40, 3)), r"got \(40, 40, 3\) float64. Convert it first."),
        (np.zeros(40, dtype=np.uint8), r"got \(40,\) uint8. Convert it first."),
        (np.zeros((0, 40, 3), dtype=np.uint8), r"got \(0, 40, 3\) uint8"),
    ],
)
def test_what_is_no_picture_is_refused(picture, message):
    with pytest.raises(ValueError, match=message):
        FaceDetector()(picture)


def test_it_is_a_detector_that_can_be_sent_to_another_process():
    detector = FaceDetector(min_share=0.1)
    assert isinstance(detector, Detector)
    assert pickle.loads(pickle.dumps(detector)) == detector  # noqa: S301 - our own bytes


# --- the scale ---


def test_the_shipped_table_knows_the_label_by_height_and_width():
    rows = ims.PriorTable.default().priors
    assert {row.axis for row in rows if row.label == face.LABEL} >= {"height", "width"}


@pytest.mark.parametrize(
    ("picture", "pupils"), [(astronaut, ASTRONAUT_PUPILS), (hopper, HOPPER_PUPILS)]
)
def test_the_face_puts_the_pupils_as_far_apart_as_women_have_them(picture, pupils):
    image = picture()
    (left_x, left_y), (right_x, right_y) = pupils
    middle = (left_y + right_y) / 2
    eyes = ims.Detection("pupils", (left_x, middle - 5, right_x, middle + 5))
    detections = [*FaceDetector()(image), eyes]
    depth = OneDistance()(image)
    noise = ims.Noise(box_px=1.0, box_rel=0.02, depth_rel=0.02)
    model = ims.fit(detections, depth, noise=noise)
    apart = ims.predict(model, detections, depth, axis="width")[1]
    error = math.hypot(apart.std_m, PUPILS_STD_M)
    assert apart.size_m == pytest.approx(PUPILS_M, abs=1.645 * error)
    assert 0.05 < error / PUPILS_M < 0.2  # an interval that says something, and not too much


def test_the_whole_chain_sizes_a_portrait_without_any_download():
    result = ims.measure(astronaut(), detector=FaceDetector(), depth_source=OneDistance())
    [size] = result.estimates
    assert ims.Flag.SINGLE_REFERENCE in result.model.flags
    assert size.label == face.LABEL
    low, high = size.interval(0.9)
    assert low < 0.1435 < high  # 2.33 times the mean pupil distance of women
