"""YOLO's text files: boxes, polygons, and lines that could be something else."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgscale.detectors.yolo import from_yolo, read_yolo

NAMES = ["person", "car", "dog"]
SIZE = (640, 480)
TRIANGLE = "2 0.25 0.25 0.5 0.25 0.5 0.5"


def read(text, *, image_size=SIZE, class_names=NAMES, **options):
    return from_yolo(text, image_size=image_size, class_names=class_names, **options)


def test_a_line_is_class_centre_and_size_as_ratios():
    (car,) = read("1 0.5 0.25 0.25 0.125")
    assert (car.label, car.score, car.partial, car.mask) == ("car", 1.0, False, None)
    assert car.xyxy == (240, 90, 400, 150)


def test_a_sixth_number_is_the_confidence():
    assert [d.score for d in read("1 0.5 0.5 0.25 0.25 0.875\n1 0.5 0.5 0.25 0.25")] == [0.875, 1]


def test_lines_keep_their_order_and_empty_ones_are_passed_over():
    text = "\n2 0.5 0.5 0.1 0.1\n\n  0\t0.5 0.5 0.1 0.1  \r\n"
    assert [d.label for d in read(text)] == ["dog", "person"]
    assert read("") == read("\n \n") == []


@given(
    left=st.integers(0, 600),
    top=st.integers(0, 400),
    width=st.integers(1, 40),
    height=st.integers(1, 80),
)
def test_a_box_written_by_the_formats_definition_comes_back(left, top, width, height):
    x, y = (left + width / 2) / 640, (top + height / 2) / 480
    (found,) = read(f"1 {x!r} {y!r} {width / 640!r} {height / 480!r}")
    assert found.xyxy == pytest.approx((left, top, left + width, top + height), abs=1e-9)


def test_names_may_be_a_mapping_and_classes_whole_floats():
    (dog,) = read("17.0 0.5 0.5 0.1 0.1", class_names={17: "dog"})
    assert dog.label == "dog"


def test_a_box_a_little_beyond_the_border_is_cut():
    assert read("1 0.01 0.5 0.04 0.5")[0].xyxy == pytest.approx((0, 120, 19.2, 360))


# --- polygons ---


def test_a_polygon_is_its_box_and_the_pixels_in_it():
    (dog,) = read(TRIANGLE, polygons=True)
    assert dog.xyxy == (160, 120, 320, 240)
    assert dog.mask.shape == (480, 640)
    assert dog.mask.sum() == pytest.approx(160 * 120 / 2, rel=0.01)
    assert dog.mask[130, 310]
    assert not dog.mask[230, 170]


def test_a_number_over_is_the_confidence_of_the_polygon():
    (dog,) = read(f"{TRIANGLE} 0.75", polygons=True)
    assert dog.score == 0.75
    assert dog.xyxy == (160, 120, 320, 240)


def test_an_oriented_box_is_a_polygon_of_four_corners():
    (car,) = read("1 0.5 0.25 0.75 0.5 0.5 0.75 0.25 0.5", polygons=True)
    assert car.xyxy == (160, 120, 480, 360)
    assert car.mask.sum() == pytest.approx(320 * 240 / 2, rel=0.01)


def test_boxes_stay_boxes_among_polygons():
    box, polygon = read(f"1 0.5 0.5 0.25 0.25 0.5\n{TRIANGLE}", polygons=True)
    assert (box.mask is None, polygon.mask is None) == (True, False)


def test_a_polygon_without_a_pixel_has_no_mask():
    (speck,) = read("0 0.5001 0.5001 0.5005 0.5001 0.5005 0.5005", polygons=True)
    assert speck.mask is None


def test_a_line_that_could_be_keypoints_or_a_tracked_box_is_not_taken_for_a_polygon():
    pose = "0 0.5 0.5 0.2 0.4 " + " ".join(["0.5 0.45 0.9"] * 17)
    for line, count in ((pose, 56), ("1 0.5 0.5 0.25 0.25 0.9 1", 7), (TRIANGLE, 7)):
        with pytest.raises(ValueError, match=rf"^line 1: .*got {count}\. .*polygons=True"):
            read(line)


def test_supervision_takes_the_same_boxes_from_the_lines():
    tools = pytest.importorskip("supervision.dataset.formats.yolo")
    lines = ["1 0.5 0.25 0.25 0.125", "2 0.3 0.4 0.05 0.2"]
    theirs = tools.yolo_annotations_to_detections(lines, SIZE, with_masks=False)
    np.testing.assert_allclose(theirs.xyxy, [d.xyxy for d in read("\n".join(lines))], atol=1e-4)


def test_supervision_takes_the_same_box_and_nearly_the_same_pixels_from_a_polygon():
    tools = pytest.importorskip("supervision.dataset.formats.yolo")
    theirs = tools.yolo_annotations_to_detections([TRIANGLE], SIZE, with_masks=True)
    (ours,) = read(TRIANGLE, polygons=True)
    np.testing.assert_allclose(theirs.xyxy[0], ours.xyxy, atol=1e-4)
    # It draws with OpenCV, which fills the pixels of the outline too: 160 + 120 + 160 of them.
    assert (theirs.mask[0] ^ ours.mask).sum() <= 440


# --- what is refused ---


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            "3 0.5 0.5 0.1 0.1",
            r"a number with a name in `class_names`; got '3' and names for 0, 1, 2\.",
        ),
        ("-1 0.5 0.5 0.1 0.1", r"got '-1'"),
        ("0.5 0.5 0.5 0.1 0.1", r"got '0.5'"),
        ("car 0.5 0.5 0.1 0.1", r"got 'car'"),
        ("inf 0.5 0.5 0.1 0.1", r"got 'inf'"),
        ("1 0.5 0.5 0.1", r"must have 5 numbers, or 6 with the confidence; got 4"),
        ("1 0.5 0.5 wide 0.1", r"must hold numbers; got '0.5 0.5 wide 0.1'"),
        ("1 320 240 64 48", r"ratios of the picture's size .*got 320\. Divide pixels"),
        ("1 0.5 nan 0.1 0.1", r"must hold numbers; got .*nan"),
        ("1 0.5 0.5 0.1 0.1 5", r"got 5\. .*leave out track ids"),
        ("1 0.5 0.5 0.1 0.1 1.04", r"`score` must be between 0 and 1; got 1.04"),
        ("1 0.5 0.5 0 0.1", r"positive width and height; got 0 and 0.1"),
        ("1 0.5 0.5 0.1 -0.01", r"positive width and height"),
        ("1 1.04 0.5 0.02 0.1", r"overlap the picture"),
    ],
)
def test_a_broken_line_is_named_by_its_number(line, message):
    with pytest.raises((TypeError, ValueError), match="^line 3: .*" + message):
        read(f"1 0.5 0.5 0.1 0.1\n\n{line}\n")


def test_the_count_of_a_polygons_numbers_is_checked_too():
    with pytest.raises(ValueError, match=r"^line 1: .*got 4\.$"):
        read("1 0.5 0.5 0.1", polygons=True)
    with pytest.raises(ValueError, match=r"^line 1: .*x1 < x2"):
        read("1 0.5 0.1 0.5 0.2 0.5 0.3", polygons=True)


@pytest.mark.parametrize(
    ("argument", "value", "message"),
    [
        ("image_size", (640, 0), "`image_size` must be"),
        ("image_size", None, "`image_size` must be"),
        ("class_names", "car", "`class_names` must be a list of names; got the string 'car'"),
        ("class_names", 3, "`class_names` must be a sequence of str objects; got int"),
        ("class_names", {1: None}, "line 1: `label` must be a string; got None"),
    ],
)
def test_broken_arguments_are_named(argument, value, message):
    with pytest.raises((TypeError, ValueError), match=re.escape(message)):
        read("1 0.5 0.5 0.1 0.1", **{argument: value})


def test_of_many_names_only_the_first_numbers_are_listed():
    names = dict.fromkeys(range(80), "thing")
    with pytest.raises(ValueError, match=r"got '80' and names for 0, 1, 2, 3, 4, \.\.\.\.$"):
        read("80 0.5 0.5 0.1 0.1", class_names=names)


def test_a_path_in_the_place_of_text_is_refused(tmp_path):
    with pytest.raises(TypeError, match=r"`text` must be a str; got .*read_yolo"):
        read(tmp_path)


# --- files ---


def test_a_file_is_read_with_or_without_a_byte_order_mark(tmp_path):
    path = tmp_path / "a.txt"
    for mark in (b"", b"\xef\xbb\xbf"):
        path.write_bytes(mark + f"{TRIANGLE}\r\n".encode())
        (dog,) = read_yolo(path, image_size=SIZE, class_names=NAMES, polygons=True)
        assert dog.label == "dog"


@pytest.mark.parametrize("content", [b"1 0.5 0.5 0.1", b"\xff\xfe1 0.5"])
def test_errors_of_a_file_name_it(tmp_path, content):
    path = tmp_path / "a.txt"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"a\.txt"):
        read_yolo(path, image_size=SIZE, class_names=NAMES)
