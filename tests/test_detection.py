"""What a detection accepts, how every box order reaches the same pixels, and what it refuses."""

import copy
import math
import pickle
import re

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imgscale import Detection

# Corners on a grid of 1/8 px: sums and differences of such numbers are exact in floating point.
EIGHTHS = st.integers(-40_000, 40_000).map(lambda number: number / 8)


@st.composite
def boxes(draw):
    x1, y1 = draw(EIGHTHS), draw(EIGHTHS)
    width, height = (draw(st.integers(1, 40_000)) / 8 for _ in range(2))
    return (x1, y1, x1 + width, y1 + height)


def rectangle_mask(shape, rows, columns):
    mask = np.zeros(shape, dtype=np.bool_)
    mask[rows, columns] = True
    return mask


def through_pickle(value):
    return pickle.loads(pickle.dumps(value))  # noqa: S301 - our own bytes


# --- the box and its orders ---


def test_xyxy_is_kept_in_its_order():
    detection = Detection("car", (10, 20, 110, 70))
    assert detection.xyxy == (10.0, 20.0, 110.0, 70.0)
    assert detection.label == "car"


def test_width_runs_along_x_and_height_along_y():
    detection = Detection("car", (10, 20, 110, 70))
    assert (detection.width_px, detection.height_px) == (100.0, 50.0)


def test_xywh_adds_the_size_to_the_left_upper_corner():
    assert Detection.from_xywh("car", (10, 20, 100, 50)).xyxy == (10.0, 20.0, 110.0, 70.0)


def test_min_max_rc_puts_the_row_before_the_column():
    assert Detection.from_min_max_rc("car", (20, 10, 70, 110)).xyxy == (10.0, 20.0, 110.0, 70.0)


def test_ratios_multiply_left_and_width_by_the_image_width_and_the_others_by_its_height():
    detection = Detection.from_ratios(
        "car", left=0.25, top=0.5, width=0.5, height=0.125, image_size=(1200, 400)
    )
    assert detection.xyxy == (300.0, 200.0, 900.0, 250.0)


def test_ratios_give_the_pixel_heights_printed_in_the_papers_figure_3_12():
    for ratio, pixels in ((0.1181, 44.2875), (0.214, 80.25), (0.0273, 10.2375)):
        detection = Detection.from_ratios(
            "car", left=0.1, top=0.2, width=0.1, height=ratio, image_size=(1242, 375)
        )
        assert detection.height_px == pytest.approx(pixels, rel=1e-12)


def test_regionprops_of_scikit_image_give_the_box_they_outline():
    ski = pytest.importorskip("skimage")
    labels = np.zeros((40, 60), dtype=np.intp)
    labels[5:9, 30:50] = 1
    (region,) = ski.measure.regionprops(labels)
    detection = Detection.from_min_max_rc("blob", region.bbox)
    assert detection.xyxy == (30.0, 5.0, 50.0, 9.0)
    assert detection.width_px * detection.height_px == region.area


@given(box=boxes())
def test_every_order_of_one_box_gives_the_same_detection(box):
    x1, y1, x2, y2 = box
    straight = Detection("a", box)
    assert Detection.from_xywh("a", (x1, y1, x2 - x1, y2 - y1)) == straight
    assert Detection.from_min_max_rc("a", (y1, x1, y2, x2)) == straight


@given(
    left=st.floats(0, 0.9), top=st.floats(0, 0.9), width=st.floats(0.01, 0.1), size=st.booleans()
)
def test_ratios_scale_with_the_image(left, top, width, size):
    small, large = (640, 480), (1920, 480) if size else (640, 1440)
    ratios = {"left": left, "top": top, "width": width, "height": width}
    one = Detection.from_ratios("a", **ratios, image_size=small)
    other = Detection.from_ratios("a", **ratios, image_size=large)
    factors = (3.0, 1.0) if size else (1.0, 3.0)
    assert other.width_px == pytest.approx(factors[0] * one.width_px, rel=1e-9)
    assert other.height_px == pytest.approx(factors[1] * one.height_px, rel=1e-9)
    assert other.xyxy[0] == pytest.approx(factors[0] * one.xyxy[0], rel=1e-12)
    assert other.xyxy[1] == pytest.approx(factors[1] * one.xyxy[1], rel=1e-12)


@pytest.mark.parametrize(
    ("build", "box"),
    [
        pytest.param(Detection, (1, 2, 5, 8), id="xyxy"),
        pytest.param(Detection.from_xywh, (1, 2, 4, 6), id="xywh"),
        pytest.param(Detection.from_min_max_rc, (2, 1, 8, 5), id="min_max_rc"),
        pytest.param(
            lambda label, _, **options: Detection.from_ratios(
                label, left=0.1, top=0.2, width=0.4, height=0.6, image_size=(10, 10), **options
            ),
            None,
            id="ratios",
        ),
    ],
)
def test_every_constructor_carries_score_mask_partial_and_track(build, box):
    mask = rectangle_mask((10, 10), slice(3, 6), slice(2, 4))
    detection = build("cat", box, score=0.25, mask=mask, partial=True, track_id="t7")
    assert detection.xyxy == pytest.approx((1.0, 2.0, 5.0, 8.0), abs=1e-12)
    assert detection.label == "cat"
    assert detection.score == 0.25
    assert detection.partial is True
    assert detection.track_id == "t7"
    assert np.array_equal(detection.mask, mask)


def test_defaults_are_full_score_no_mask_whole_object_no_track():
    detection = Detection("car", (0, 0, 1, 1))
    assert (detection.score, detection.mask) == (1.0, None)
    assert (detection.partial, detection.track_id) == (False, None)


@pytest.mark.parametrize("build", [Detection.from_xywh, Detection.from_min_max_rc])
def test_every_constructor_has_the_same_defaults(build):
    assert build("car", (1, 2, 5, 8)) == build(
        "car", (1, 2, 5, 8), score=1.0, mask=None, partial=False, track_id=None
    )
    from_ratios = Detection.from_ratios(
        "car", left=0.0, top=0.0, width=0.5, height=0.5, image_size=(8, 8)
    )
    assert from_ratios == Detection("car", (0, 0, 4, 4))


def test_only_label_and_box_may_be_given_by_position():
    with pytest.raises(TypeError, match="positional"):
        Detection("car", (0, 0, 1, 1), 0.9)


@pytest.mark.parametrize(
    "box",
    [
        pytest.param([10, 20, 110, 70], id="list"),
        pytest.param(np.array([10, 20, 110, 70]), id="int array"),
        pytest.param(np.array([10, 20, 110, 70], dtype=np.float32), id="float32 array"),
        pytest.param(np.array([10, 20, 110, 70], dtype=np.uint8), id="uint8 array"),
        pytest.param((np.int64(10), np.float32(20), 110, 70.0), id="mixed scalars"),
    ],
)
def test_numpy_boxes_become_tuples_of_python_floats(box):
    detection = Detection("car", box)
    assert detection.xyxy == (10.0, 20.0, 110.0, 70.0)
    assert type(detection.xyxy) is tuple
    assert {type(number) for number in detection.xyxy} == {float}


def test_small_integer_types_do_not_overflow_when_width_is_added():
    detection = Detection.from_xywh("car", np.array([200, 100, 100, 250], dtype=np.uint8))
    assert detection.xyxy == (200.0, 100.0, 300.0, 350.0)


@pytest.mark.parametrize("number", [np.float16, np.float32, np.float64])
def test_ratios_of_low_precision_are_multiplied_in_full_precision(number):
    ratio = number(0.3)
    detection = Detection.from_ratios(
        "car", left=ratio, top=ratio, width=ratio, height=ratio, image_size=(5000, 4000)
    )
    exact = float(ratio)
    expected = (exact * 5000, exact * 4000, exact * 10000, exact * 8000)
    assert detection.xyxy == pytest.approx(expected, rel=1e-12)


def test_numpy_scores_become_python_floats():
    detection = Detection("car", (0, 0, 1, 1), score=np.float32(0.5), partial=np.True_)
    assert type(detection.score) is float
    assert detection.score == 0.5
    assert detection.partial is True


def test_integer_score_becomes_a_float():
    assert type(Detection("car", (0, 0, 1, 1), score=1).score) is float


def test_boxes_beyond_the_border_are_lawful_until_an_image_is_known():
    assert Detection("car", (-5, -3, 2000, 9)).xyxy == (-5.0, -3.0, 2000.0, 9.0)


# --- ownership, equality ---


def test_later_edits_of_the_callers_box_do_not_show():
    box = np.array([10.0, 20.0, 110.0, 70.0])
    detection = Detection("car", box)
    box[:] = 0
    assert detection.xyxy == (10.0, 20.0, 110.0, 70.0)


def test_later_edits_of_the_callers_mask_do_not_show():
    mask = rectangle_mask((10, 10), slice(0, 5), slice(0, 5))
    detection = Detection("car", (0, 0, 5, 5), mask=mask)
    mask[:] = False
    assert detection.mask.sum() == 25


def test_mask_is_read_only_and_leaves_the_callers_writable():
    mask = rectangle_mask((10, 10), slice(0, 5), slice(0, 5))
    detection = Detection("car", (0, 0, 5, 5), mask=mask)
    with pytest.raises(ValueError, match="read-only"):
        detection.mask[0, 0] = False
    mask[0, 0] = False  # the caller's own array stays the caller's


@pytest.mark.parametrize("name", ["label", "xyxy", "score", "mask", "partial", "track_id"])
def test_fields_cannot_be_set(name):
    detection = Detection("car", (0, 0, 1, 1))
    with pytest.raises(attrs.exceptions.FrozenInstanceError):
        setattr(detection, name, None)


def test_unknown_attributes_cannot_be_added():
    detection = Detection("car", (0, 0, 1, 1))
    with pytest.raises(AttributeError):
        detection.lable = "cat"


def test_equal_detections_are_equal_and_hash_alike():
    one, other = Detection("car", (0, 0, 1, 1)), Detection("car", np.array([0, 0, 1, 1]))
    assert one == other
    assert hash(one) == hash(other)
    assert len({one, other}) == 1


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(Detection("van", (0, 0, 4, 4)), id="label"),
        pytest.param(Detection("car", (0, 0, 4, 5)), id="box"),
        pytest.param(Detection("car", (0, 0, 4, 4), score=0.5), id="score"),
        pytest.param(Detection("car", (0, 0, 4, 4), partial=True), id="partial"),
        pytest.param(Detection("car", (0, 0, 4, 4), track_id=1), id="track"),
        pytest.param(Detection("car", (0, 0, 4, 4), mask=np.ones((4, 4), np.bool_)), id="mask"),
    ],
)
def test_a_difference_in_any_field_makes_detections_unequal(other):
    assert Detection("car", (0, 0, 4, 4)) != other


def test_masked_detections_compare_their_masks_and_can_be_hashed():
    mask = np.ones((4, 4), np.bool_)
    one = Detection("car", (0, 0, 4, 4), mask=mask)
    same = Detection("car", (0, 0, 4, 4), mask=mask.tolist())
    mask[0, 0] = False
    other = Detection("car", (0, 0, 4, 4), mask=mask)
    larger = Detection("car", (0, 0, 4, 4), mask=np.ones((5, 4), np.bool_))
    assert one == same
    assert one != other
    assert one != larger
    assert hash(one) == hash(same)
    assert len({one, same, other, larger}) == 3


@pytest.mark.parametrize("clone", [copy.copy, copy.deepcopy, through_pickle])
def test_copies_and_pickles_are_equal(clone):
    detection = Detection("car", (0, 0, 4, 4), mask=np.ones((4, 4), np.bool_), track_id=3)
    assert clone(detection) == detection


def test_repr_shows_a_mask_as_its_shape_not_its_pixels():
    detection = Detection("car", (0, 0, 4, 4), mask=np.ones((480, 640), np.bool_))
    assert "(480, 640) bool" in repr(detection)
    assert len(repr(detection)) < 200


# --- refusals ---


@pytest.mark.parametrize(
    ("box", "seen"),
    [
        pytest.param((110, 20, 10, 70), "(110.0, 20.0, 10.0, 70.0)", id="x inverted"),
        pytest.param((10, 70, 110, 20), "(10.0, 70.0, 110.0, 20.0)", id="y inverted"),
        pytest.param((10, 20, 10, 70), "(10.0, 20.0, 10.0, 70.0)", id="no width"),
        pytest.param((10, 20, 110, 20), "(10.0, 20.0, 110.0, 20.0)", id="no height"),
        pytest.param((200, 100, 50, 80), "(200.0, 100.0, 50.0, 80.0)", id="xywh given as xyxy"),
    ],
)
def test_inverted_or_empty_box_is_refused_and_points_to_from_xywh(box, seen):
    law = f"`xyxy` must have x1 < x2 and y1 < y2; got {seen}. Boxes given as x, y, width, height"
    with pytest.raises(ValueError, match=re.escape(law)) as caught:
        Detection("car", box)
    assert "Detection.from_xywh()" in str(caught.value)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(4))
def test_box_that_is_not_finite_is_refused(bad, place):
    box = [0.0, 0.0, 10.0, 10.0]
    box[place] = bad
    with pytest.raises(ValueError, match=rf"`xyxy` must be finite; got \(.*{bad}.*\)"):
        Detection("car", box)


@pytest.mark.parametrize(
    "box",
    [
        pytest.param((), id="empty"),
        pytest.param((0, 0, 1), id="three"),
        pytest.param((0, 0, 1, 1, 0.9), id="five"),
        pytest.param(((0, 0), (1, 1)), id="two corners"),
        pytest.param(("0", "0", "1", "1"), id="strings"),
        pytest.param("0011", id="one string"),
        pytest.param((True, False, True, True), id="bools"),
        pytest.param((0, None, 1, 1), id="none"),
        pytest.param((0, 0, 1, 1j), id="complex"),
        pytest.param(None, id="nothing"),
        pytest.param(7.0, id="a number"),
        pytest.param([0, 0, [1], 1], id="ragged"),
        pytest.param({"x1": 0}, id="a dict"),
    ],
)
def test_box_that_is_not_four_numbers_is_refused(box):
    with pytest.raises(ValueError, match=r"`xyxy` must be four numbers \(x1, y1, x2, y2\); got"):
        Detection("car", box)


def test_a_table_of_boxes_given_as_one_box_is_not_dumped_into_the_message():
    table = np.arange(800.0).reshape(200, 4)
    with pytest.raises(ValueError, match="`xyxy` must be four numbers") as caught:
        Detection("car", table)
    assert "(200, 4)" in str(caught.value)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    "xywh",
    [
        pytest.param((0, 0, 1), id="three"),
        pytest.param((0, 0, "1", "1"), id="strings"),
        pytest.param(None, id="nothing"),
    ],
)
def test_xywh_that_is_not_four_numbers_is_refused_under_its_own_name(xywh):
    law = r"`xywh` must be four numbers \(left, top, width, height\); got"
    with pytest.raises(ValueError, match=law):
        Detection.from_xywh("car", xywh)


@pytest.mark.parametrize(
    ("xywh", "seen"),
    [
        pytest.param((10, 20, 0, 50), "(10.0, 20.0, 0.0, 50.0)", id="zero width"),
        pytest.param((10, 20, 100, -50), "(10.0, 20.0, 100.0, -50.0)", id="negative height"),
        pytest.param((10, 20, math.nan, 50), "(10.0, 20.0, nan, 50.0)", id="nan width"),
    ],
)
def test_xywh_without_a_positive_size_is_refused(xywh, seen):
    law = f"`xywh` must have a positive width and height; got {seen}"
    with pytest.raises(ValueError, match=re.escape(law)):
        Detection.from_xywh("car", xywh)


@pytest.mark.parametrize("place", [0, 1, 2, 3])
def test_infinite_xywh_is_refused(place):
    xywh = [10.0, 20.0, 100.0, 50.0]
    xywh[place] = math.inf
    with pytest.raises(ValueError, match=r"must be finite; got .*inf"):
        Detection.from_xywh("car", xywh)


def test_min_max_rc_of_another_length_is_refused_naming_its_order():
    law = r"`bbox` must be .*\(min_row, min_col, max_row, max_col\); got \(1, 2, 3\)"
    with pytest.raises(ValueError, match=law):
        Detection.from_min_max_rc("car", (1, 2, 3))


@pytest.mark.parametrize(
    "bbox",
    [
        pytest.param((70, 10, 20, 110), id="rows inverted"),
        pytest.param((20, 110, 70, 10), id="columns inverted"),
    ],
)
def test_inverted_min_max_rc_is_refused(bbox):
    with pytest.raises(ValueError, match="must have x1 < x2 and y1 < y2"):
        Detection.from_min_max_rc("car", bbox)


@pytest.mark.parametrize("name", ["left", "top", "width", "height"])
@pytest.mark.parametrize(
    "value", [pytest.param(310.0, id="pixels"), -0.06, 1.06, math.nan, math.inf, -math.inf]
)
def test_ratio_outside_zero_to_one_is_refused_by_name_and_points_to_pixel_boxes(name, value):
    ratios = {"left": 0.1, "top": 0.1, "width": 0.5, "height": 0.5, name: value}
    law = rf"`{name}` must be a ratio between 0 and 1; got {value}\. Boxes in pixels go through"
    with pytest.raises(ValueError, match=law):
        Detection.from_ratios("car", **ratios, image_size=(640, 480))


@pytest.mark.parametrize("value", [pytest.param("0.5", id="string"), None, True])
def test_ratio_that_is_no_number_is_a_type_error(value):
    law = rf"`top` must be a ratio between 0 and 1; got {value!r}"
    with pytest.raises(TypeError, match=law):
        Detection.from_ratios(
            "car", left=0.1, top=value, width=0.5, height=0.5, image_size=(640, 480)
        )


def test_ratios_slightly_beyond_the_border_are_lawful():
    detection = Detection.from_ratios(
        "car", left=-0.03, top=0.0, width=1.04, height=0.5, image_size=(100, 100)
    )
    assert detection.xyxy == pytest.approx((-3.0, 0.0, 101.0, 50.0))


@pytest.mark.parametrize("name", ["width", "height"])
@pytest.mark.parametrize("value", [0.0, -0.01])
def test_ratio_size_that_is_not_positive_is_refused(name, value):
    ratios = {"left": 0.1, "top": 0.1, "width": 0.5, "height": 0.5, name: value}
    with pytest.raises(ValueError, match="must have a positive width and height"):
        Detection.from_ratios("car", **ratios, image_size=(640, 480))


@pytest.mark.parametrize(
    "size",
    [
        pytest.param(None, id="nothing"),
        pytest.param((0, 480), id="zero"),
        pytest.param((640, -480), id="negative"),
        pytest.param((480, 640, 3), id="array shape"),
        pytest.param(640, id="one number"),
    ],
)
def test_ratios_need_a_lawful_image_size(size):
    with pytest.raises((TypeError, ValueError), match=r"`image_size` must be \(width, height\)"):
        Detection.from_ratios("car", left=0.1, top=0.1, width=0.5, height=0.5, image_size=size)


@pytest.mark.parametrize("score", [-0.01, 1.01, 87.5, math.nan, math.inf])
def test_score_outside_zero_to_one_is_refused_and_speaks_of_percentages(score):
    law = rf"`score` must be between 0 and 1; got {score}\. Divide percentages by 100\."
    with pytest.raises(ValueError, match=law):
        Detection("car", (0, 0, 1, 1), score=score)


@pytest.mark.parametrize("score", [pytest.param("0.9", id="string"), None, True, [0.9]])
def test_score_that_is_no_number_is_a_type_error(score):
    law = re.escape(f"`score` must be between 0 and 1; got {score!r}")
    with pytest.raises(TypeError, match=law):
        Detection("car", (0, 0, 1, 1), score=score)


@pytest.mark.parametrize("score", [0, 0.0, 1, 1.0])
def test_both_ends_of_the_score_are_lawful(score):
    assert Detection("car", (0, 0, 1, 1), score=score).score == score


@pytest.mark.parametrize("label", [None, 3, b"car", ("car",)])
def test_label_that_is_no_string_is_a_type_error(label):
    with pytest.raises(TypeError, match=re.escape(f"`label` must be a string; got {label!r}")):
        Detection(label, (0, 0, 1, 1))


@pytest.mark.parametrize("label", ["", " ", "\t\n"])
def test_blank_label_is_refused(label):
    with pytest.raises(ValueError, match="`label` must not be blank; got"):
        Detection(label, (0, 0, 1, 1))


@pytest.mark.parametrize("dtype", [np.uint8, np.float32, np.intp])
def test_mask_of_another_dtype_is_a_type_error(dtype):
    law = f"`mask` must be boolean, True on the object; got dtype {np.dtype(dtype)}"
    with pytest.raises(TypeError, match=law):
        Detection("car", (0, 0, 2, 2), mask=np.ones((4, 4), dtype))


@pytest.mark.parametrize(
    "shape", [pytest.param((4,), id="flat"), pytest.param((1, 4, 4), id="batch of one")]
)
def test_mask_of_another_dimension_is_refused(shape):
    law = re.escape(f"`mask` must have the image's shape (H, W); got {shape}")
    with pytest.raises(ValueError, match=law):
        Detection("car", (0, 0, 2, 2), mask=np.ones(shape, np.bool_))


@pytest.mark.parametrize(
    "mask",
    [
        pytest.param(np.zeros((20, 20), np.bool_), id="false everywhere"),
        pytest.param(rectangle_mask((20, 20), slice(10, 15), slice(10, 15)), id="outside the box"),
        pytest.param(np.ones((2, 2), np.bool_), id="a crop, not the image"),
        pytest.param(np.zeros((0, 0), np.bool_), id="of no size"),
    ],
)
def test_mask_that_is_empty_inside_the_box_is_refused(mask):
    law = r"`mask` must be True somewhere inside the box \(4\.0, 4\.0, 9\.0, 9\.0\); it is empty"
    with pytest.raises(ValueError, match=law):
        Detection("car", (4, 4, 9, 9), mask=mask)


def test_mask_rows_are_y_and_columns_are_x():
    mask = rectangle_mask((10, 30), slice(2, 4), slice(20, 25))
    assert Detection("car", (20, 2, 25, 4), mask=mask).mask is not None
    with pytest.raises(ValueError, match="it is empty there"):
        Detection("car", (2, 20, 4, 25), mask=mask)


def test_mask_under_a_box_that_begins_before_the_image_is_found():
    mask = rectangle_mask((10, 10), slice(0, 1), slice(0, 1))
    assert Detection("car", (-3, -2, 1, 1), mask=mask).mask.sum() == 1


@pytest.mark.parametrize("box", [(0, -4, 4, -1), (-4, 0, -1, 4)])
def test_mask_under_a_box_outside_the_image_is_empty_there(box):
    with pytest.raises(ValueError, match="it is empty there"):
        Detection("car", box, mask=np.ones((10, 10), np.bool_))


def test_half_covered_pixels_of_the_box_count_for_the_mask():
    mask = rectangle_mask((10, 10), slice(5, 6), slice(5, 6))
    assert Detection("car", (5.4, 5.4, 5.6, 5.6), mask=mask).mask.sum() == 1


@pytest.mark.parametrize("partial", ["false", "no"])
def test_partial_given_as_a_word_is_refused_not_taken_as_true(partial):
    with pytest.raises((TypeError, ValueError), match="`partial` must be"):
        Detection("car", (0, 0, 1, 1), partial=partial)


@settings(max_examples=50)
@given(number=st.floats(allow_nan=True, allow_infinity=True), place=st.integers(0, 3))
def test_any_four_numbers_make_a_lawful_box_or_a_value_error(number, place):
    box = [0.0, 0.0, 10.0, 10.0]
    box[place] = number
    try:
        x1, y1, x2, y2 = Detection("car", box).xyxy
    except ValueError:
        assert not (math.isfinite(number) and (number < 10 if place < 2 else number > 0))
    else:
        assert x1 < x2
        assert y1 < y2


# --- further names ---


def test_aliases_are_kept_as_a_tuple():
    sedan = Detection("Sedan", (0, 0, 9, 9), aliases=["Car", "Vehicle"])
    assert sedan.aliases == ("Car", "Vehicle")
    assert sedan.names == ("Sedan", "Car", "Vehicle")
    assert Detection("Sedan", (0, 0, 9, 9), aliases="Car").aliases == ("Car",)


@pytest.mark.parametrize("aliases", [7, [7], [" "], [None]])
def test_aliases_must_be_strings(aliases):
    with pytest.raises((TypeError, ValueError), match="`aliases` must"):
        Detection("Sedan", (0, 0, 9, 9), aliases=aliases)


def test_another_box_leaves_the_rest_as_it_is():
    car = Detection("car", (0, 0, 9, 9), score=0.5, track_id=3, aliases=("auto",))
    assert car.with_box((1, 1, 5, 6)) == attrs.evolve(car, xyxy=(1.0, 1.0, 5.0, 6.0))


def test_every_constructor_takes_further_names():
    names = {"aliases": ("car",)}
    built = [
        Detection.from_xywh("suv", (0, 0, 9, 9), **names),
        Detection.from_min_max_rc("suv", (0, 0, 9, 9), **names),
        Detection.from_ratios(
            "suv", left=0, top=0, width=0.5, height=0.5, image_size=(18, 18), **names
        ),
    ]
    assert built == [Detection("suv", (0, 0, 9, 9), **names)] * 3
