"""The paper's figures 3.12 to 3.19, recomputed through public names and compared as printed."""

from fractions import Fraction

import pytest

import imgscale as ims
from imgscale.datasets import paper

IMAGES = ["000003_10", "000003_11"]
HEIGHT_ROWS = paper.figure_3_12()
SCALE_ROWS = paper.figure_3_14()


def row_id(row):
    return f"{row.image} {row.object}"


def decimals(number):
    return len(repr(number).partition(".")[2]) if number != int(number) else 0


def cut_off(value, places):
    return int(value * 10**places) / 10**places


@pytest.fixture(scope="module")
def hpp_references():
    """All 23 boxes of figure 3.12 as detections, with the paper's Table 3.2."""
    width, height = paper.IMAGE_SIZE
    detections = [
        ims.Detection.from_ratios(
            row.label, left=0.4, top=0.3, width=0.1, height=row.height_ratio,
            image_size=(width, height),
        )
        for row in HEIGHT_ROWS
    ]  # fmt: skip
    depth = ims.ObjectDepths([1.0] * len(detections), kind="relative")
    model = ims.fit(detections, depth, ims.PriorTable.paper(), method="mean_ratio")
    return dict(zip(map(row_id, HEIGHT_ROWS), model.references, strict=True))


def fitted(image, **options):
    frame = paper.frame(image)
    return ims.fit(frame.detections, frame.depth, paper.actual_heights(image), **options)


def mse_cm2(image, method):
    frame, sizes = paper.frame(image), paper.actual_heights(image)
    left_out = ims.leave_one_out(frame.detections, frame.depth, sizes, method=method)
    squares = [
        (100 * (estimate.size_m - sizes.lookup(estimate.label)[0].mean_m)) ** 2
        for estimate in left_out
    ]
    return sum(squares) / len(squares)


def test_the_tables_have_the_papers_rows():
    assert len(HEIGHT_ROWS) == 23
    assert len(SCALE_ROWS) == 15
    assert [row.image for row in HEIGHT_ROWS] == (
        ["000000_10"] * 3 + ["000000_11"] * 5 + ["000003_10"] * 8 + ["000003_11"] * 7
    )
    assert [row.image for row in SCALE_ROWS] == ["000003_10"] * 8 + ["000003_11"] * 7


def test_table_3_2_holds_the_six_mean_heights():
    assert {prior.label: prior.mean_m for prior in ims.PriorTable.paper()} == {
        "train": 4.02,
        "car": 1.70,
        "person": 1.72,
        "traffic signal": 2.10,
        "truck": 2.80,
        "wheel": 0.83,
    }


# --- figures 3.12 and 3.13 -----------------------------------------------------------------------


@pytest.mark.parametrize("row", HEIGHT_ROWS, ids=row_id)
def test_ratio_times_375_is_the_printed_pixel_height(row, hpp_references):
    assert hpp_references[row_id(row)].pixels == pytest.approx(row.pixels_px, abs=1e-10)
    assert Fraction(repr(row.height_ratio)) * 375 == Fraction(repr(row.pixels_px))


@pytest.mark.parametrize("row", HEIGHT_ROWS, ids=row_id)
def test_height_per_pixel_agrees_to_the_printed_digits(row, hpp_references):
    # the paper cuts off; trailing zeros are not printed
    hpp_cm = 100 * hpp_references[row_id(row)].metres_per_pixel
    assert cut_off(hpp_cm, decimals(row.hpp_cm_per_px)) == row.hpp_cm_per_px


def test_the_paper_cuts_off_after_four_decimals_and_once_after_three():
    exact = [
        Fraction(round(100 * ims.PriorTable.paper().lookup(row.label)[0].mean_m))
        / Fraction(repr(row.pixels_px))
        for row in HEIGHT_ROWS
    ]
    printed = [Fraction(repr(row.hpp_cm_per_px)) for row in HEIGHT_ROWS]
    four = [Fraction(int(value * 10**4), 10**4) for value in exact]
    other = [
        (row_id(row), float(cut), float(digits))
        for row, cut, digits in zip(HEIGHT_ROWS, four, printed, strict=True)
        if cut != digits
    ]
    assert other == [("000000_11 Car 1", 3.2015, 3.201)]
    rounded = [round(value, 4) for value in exact]
    assert sum(a != b for a, b in zip(rounded, printed, strict=True)) > 5


# --- figures 3.14 to 3.16 ------------------------------------------------------------------------


@pytest.mark.parametrize("image", IMAGES)
def test_own_ks_agree_to_the_printed_digits(image):
    model = fitted(image, method="mean_ratio")
    rows = [row for row in SCALE_ROWS if row.image == image]
    assert [ref.label for ref in model.references] == [row.object for row in rows]
    for ref, row in zip(model.references, rows, strict=True):
        # sizes are metres here, centimetres there; the depth's unit is the paper's
        assert round(100 * ref.k, decimals(row.k)) == row.k
        assert abs(100 * ref.k - row.k) <= 0.5e-9


@pytest.mark.parametrize("image", IMAGES)
def test_every_object_predicts_its_own_height_from_its_own_k(image):
    # figure 3.19's predictions are this circle, which is why the paper's error is 0
    model = fitted(image, method="mean_ratio")
    for ref, row in zip(
        model.references, [row for row in SCALE_ROWS if row.image == image], strict=True
    ):
        assert 100 * ref.k * row.depth * row.pixels_px == pytest.approx(row.predicted_cm, rel=1e-12)


@pytest.mark.parametrize(("image", "mean_depth"), [(IMAGES[0], 363.5), (IMAGES[1], 476.2857143)])
@pytest.mark.parametrize("method", ["mean_ratio", "least_squares"])
def test_mean_depths_are_the_printed_ones(image, mean_depth, method):
    model = fitted(image, method=method)
    assert round(model.mean_depth, 7) == mean_depth == paper.PUBLISHED[image].mean_depth


@pytest.mark.parametrize(
    ("image", "recomputed", "published"),
    [(IMAGES[0], 0.0266116, 0.026966), (IMAGES[1], 0.0162310, 0.005826)],
    ids=IMAGES,
)
def test_the_published_mean_ks_are_not_the_means_of_the_published_ks(image, recomputed, published):
    k_cm = 100 * fitted(image, method="mean_ratio").k
    assert round(k_cm, 7) == recomputed
    assert paper.PUBLISHED[image].k_mean == published
    assert abs(k_cm - published) > 3e-4


@pytest.mark.parametrize("image", IMAGES)
def test_the_pixel_heights_of_figure_3_16_are_not_those_of_figure_3_12(image):
    earlier = [row.pixels_px for row in HEIGHT_ROWS if row.image == image]
    later = [row.pixels_px for row in SCALE_ROWS if row.image == image]
    assert len(earlier) == len(later)
    assert all(a != b for a, b in zip(earlier, later, strict=True))


@pytest.mark.parametrize(
    ("image", "k_cm"), [(IMAGES[0], 0.0265987), (IMAGES[1], 0.0056138)], ids=IMAGES
)
def test_least_squares_of_height_on_depth_times_pixels(image, k_cm):
    assert round(100 * fitted(image, method="least_squares").k, 7) == k_cm


# --- figure 3.18: the error with one k per image -------------------------------------------------


@pytest.mark.parametrize(
    ("image", "cm2"), [(IMAGES[0], 5734.20), (IMAGES[1], 77160.85)], ids=IMAGES
)
def test_the_mean_squared_error_of_one_k_per_image_is_not_zero(image, cm2):
    model = fitted(image, method="mean_ratio")
    assert round(1e4 * model.mse_m2, 2) == cm2
    assert paper.PUBLISHED[image].mse_cm2 == 0


@pytest.mark.parametrize(
    ("image", "cm2"), [(IMAGES[0], 7489.57), (IMAGES[1], 105024.50)], ids=IMAGES
)
def test_the_mean_squared_error_with_each_object_left_out_of_its_own_k(image, cm2):
    rows = [row for row in SCALE_ROWS if row.image == image]
    own_k = [Fraction(row.actual_cm) / Fraction(row.depth * row.pixels_px) for row in rows]
    squares = [
        (
            Fraction(row.actual_cm)
            - (sum(own_k) - k) / (len(rows) - 1) * Fraction(row.depth * row.pixels_px)
        )
        ** 2
        for row, k in zip(rows, own_k, strict=True)
    ]
    left_out = mse_cm2(image, "mean_ratio")
    assert left_out == pytest.approx(float(sum(squares) / len(rows)), rel=1e-12)
    assert left_out == pytest.approx(cm2, abs=0.01)


@pytest.mark.parametrize("image", IMAGES)
def test_predictions_are_k_times_depth_times_pixels(image):
    model = fitted(image, method="mean_ratio")
    frame = paper.frame(image)
    rows = [row for row in SCALE_ROWS if row.image == image]
    for estimate, row in zip(ims.predict(model, frame.detections, frame.depth), rows, strict=True):
        assert estimate.size_m == pytest.approx(model.k * row.depth * row.pixels_px, rel=1e-12)


@pytest.mark.parametrize("image", IMAGES)
def test_objects_without_depth_are_predicted_at_the_mean_depth(image):
    # figure 3.17
    model = fitted(image, method="mean_ratio")
    [estimate] = ims.predict(model, [ims.Detection("thing", (0, 0, 9, 60))], "mean")
    mean_depth = paper.PUBLISHED[image].mean_depth
    assert estimate.size_m == pytest.approx(model.k * mean_depth * 60, rel=1e-9)


@pytest.mark.parametrize("method", ["robust", "posterior"])
@pytest.mark.parametrize("depth_rel", [0.05, None], ids=["told", "unknown"])
def test_the_fitted_methods_say_that_the_second_image_is_inconsistent(depth_rel, method):
    # the k's of 000003_11 span a factor of 14: no depth of one camera does that
    noise = ims.Noise(depth_rel=depth_rel)
    assert ims.Flag.INCONSISTENT in fitted("000003_11", noise=noise, method=method).flags


@pytest.mark.parametrize("lookup", [paper.frame, paper.actual_heights])
def test_an_image_that_the_paper_does_not_show_is_refused(lookup):
    with pytest.raises(ValueError, match="must be one of 000003_10, 000003_11; got '000001_10'"):
        lookup("000001_10")
