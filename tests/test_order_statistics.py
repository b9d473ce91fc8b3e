"""Quantiles of the depths in boxes, against numpy's own on hostile maps."""

import math
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imgscale import DepthMap, Detection
from imgscale.order_statistics import box_quantiles

NAN, INF = math.nan, math.inf
KINDS = ("metric", "relative", "inverse", "affine_inverse")
SHARES = (0.5, 0.0, 1.0, 0.25, 0.75, 0.1, 1 / 3, 0.999)
DTYPES = ("float32", "float64", "float16", ">f4", ">f8", ">f2", "longdouble")
ODD = (NAN, -NAN, INF, -INF, 0.0, -0.0, -1.5, -7.0, 6e-8, 1e-45, 5e-324, 60000.0, 2.0, 2.0)


def by_numpy(pixels, kind, q):
    """Set the depths apart as the table of `DepthMap` says, and ask numpy."""
    pixels = pixels.astype(np.float64).ravel()
    law = np.isfinite(pixels) & ((pixels > 0) | (kind == "affine_inverse"))
    apart = np.where(law, pixels, NAN)
    if not law.any():
        return np.full(np.shape(q), NAN)
    return np.nanquantile(apart, q)


def hostile(seed, shape=(13, 17), dtype="float32"):
    """Draw values of which a good part is odd, and one corner that is lawful for all kinds."""
    rng = np.random.default_rng(seed)
    values = rng.lognormal(1, 1, shape)
    odd = rng.random(shape) < rng.random()
    values[odd] = rng.choice(ODD, np.count_nonzero(odd))
    values[-1, -1] = 3.0
    return values.astype(dtype)


def boxes_on(shape):
    rng = np.random.default_rng(1)
    height, width = shape
    boxes = [(0, 0, width, height), (0, 0, 1, 1), (width - 1, height - 1, width, height)]
    for _ in range(12):
        x1, y1 = rng.integers(0, (width, height))
        boxes.append((x1, y1, rng.integers(x1, width) + 1, rng.integers(y1, height) + 1))
    return boxes


def check(depth, kind, boxes):
    found = box_quantiles(depth, boxes, SHARES)
    expected = [by_numpy(depth.values[y1:y2, x1:x2], kind, SHARES) for x1, y1, x2, y2 in boxes]
    # the last unit: of an even number numpy.median halves a sum, numpy.quantile a difference
    np.testing.assert_allclose(found, expected, rtol=4e-16, atol=5e-324)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("seed", range(6))
def test_quantiles_are_numpys_of_the_pixels_that_are_depths(seed, dtype, kind):
    values = hostile(seed, dtype=dtype)
    check(DepthMap(values, kind=kind), kind, boxes_on(values.shape))


@settings(deadline=None, max_examples=200)
@given(
    pixels=st.lists(
        st.one_of(st.sampled_from(ODD), st.floats(width=32, allow_subnormal=True)), max_size=30
    ),
    kind=st.sampled_from(KINDS),
    dtype=st.sampled_from(("float32", "float64")),
    q=st.floats(0, 1),
)
def test_any_pixels_and_any_share_give_numpys_quantile(pixels, kind, dtype, q):
    values = np.array([*pixels, 3.0], dtype=dtype)[np.newaxis]
    found = box_quantiles(DepthMap(values, kind=kind), [(0, 0, values.size, 1)], q)
    expected = by_numpy(values, kind, q)
    largest = float(np.abs(values[np.isfinite(values)]).max())
    # numpy's own rounding, where far larger numbers cancel
    np.testing.assert_allclose(found[0], expected, rtol=1e-15, atol=1e-15 * largest)


@pytest.mark.parametrize("count", range(1, 9))
@pytest.mark.parametrize("dtype", DTYPES)
def test_the_median_is_nanmedian_of_even_and_odd_counts(count, dtype):
    values = np.full((1, 12), NAN)
    values[0, 2 : 2 + count] = np.random.default_rng(count).lognormal(1, 1, count)
    depth = DepthMap(values.astype(dtype), kind="metric")
    expected = np.nanmedian(depth.values.astype(np.float64))
    assert box_quantiles(depth, [(0, 0, 12, 1)]).tolist() == [expected]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("missing", [NAN, 0.0, -2.0, INF])
def test_large_boxes_with_gaps_are_exact(kind, missing):
    rng = np.random.default_rng(4)
    values = rng.lognormal(1, 0.5, (300, 401)).astype(np.float32)
    values[rng.random(values.shape) < 0.2] = missing
    check(DepthMap(values, kind=kind), kind, boxes_on(values.shape))


@pytest.mark.parametrize(
    "given",
    [
        pytest.param(np.asfortranarray, id="Fortran order"),
        pytest.param(lambda values: np.repeat(values, 2, axis=1)[:, ::2], id="not contiguous"),
        pytest.param(lambda values: values[::-1, ::-1][::-1, ::-1], id="reversed twice"),
        pytest.param(np.ma.masked_invalid, id="masked"),
    ],
)
def test_the_order_in_memory_does_not_matter(given):
    values = hostile(3)
    plain = DepthMap(values, kind="inverse")
    boxes = boxes_on(values.shape)
    np.testing.assert_array_equal(
        box_quantiles(DepthMap(given(values), kind="inverse"), boxes, SHARES),
        box_quantiles(plain, boxes, SHARES),
    )


def test_a_map_on_disk_that_is_read_only_serves(tmp_path):
    values = hostile(5)
    np.save(tmp_path / "map.npy", values)
    on_disk = np.load(tmp_path / "map.npy", mmap_mode="r")
    check(DepthMap(on_disk, kind="metric"), "metric", boxes_on(values.shape))


@pytest.mark.parametrize("kind", ["metric", "affine_inverse"])
def test_neither_map_nor_boxes_nor_masks_change(kind):
    values = hostile(6)
    depth = DepthMap(values, kind=kind)
    before, boxes = depth.values.tobytes(), np.array(boxes_on(values.shape), dtype=np.float64)
    given = boxes.copy()
    masked = Detection("car", boxes[0], mask=values > 1)
    box_quantiles(depth, [masked], (0.25, 0.75))
    box_quantiles(depth, boxes, (0.25, 0.75))
    assert depth.values.tobytes() == before
    np.testing.assert_array_equal(boxes, given)


def test_boxes_that_overlap_each_count_all_their_pixels():
    depth = DepthMap(np.arange(1.0, 17.0).reshape(4, 4), kind="metric")
    found = box_quantiles(depth, [(0, 0, 4, 4), (0, 0, 4, 2), (0, 0, 4, 4)])
    assert found.tolist() == [8.5, 4.5, 8.5]


def test_a_box_without_depth_is_nan_beside_others():
    values = np.full((4, 4), NAN)
    values[2:] = 5.0
    depth = DepthMap(values, kind="metric")
    found = box_quantiles(depth, [(0, 0, 4, 2), (0, 2, 4, 4)], (0.1, 0.9))
    np.testing.assert_array_equal(found, [[NAN, NAN], [5.0, 5.0]])


def test_a_mask_chooses_the_pixels_and_a_box_without_one_takes_all():
    values = np.array([[1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 8.0]])
    depth = DepthMap(values, kind="relative")
    mask = np.array([[True, False, True, True], [False, False, True, False]])
    detections = [Detection("cup", (0, 0, 4, 2), mask=mask), Detection("cup", (0, 0, 4, 2))]
    assert box_quantiles(depth, detections).tolist() == [3.5, 4.5]
    cut = Detection("cup", (0, 0, 3, 2), mask=mask)  # by its box
    assert box_quantiles(depth, [cut]).tolist() == [3.0]


@pytest.mark.parametrize("factor", [1, 2, 4])
def test_boxes_and_masks_are_scaled_from_the_image_to_the_map(factor):
    values = np.full((10, 20), 9.0)
    values[2:6, 4:12] = 3.0
    size = (20 * factor, 10 * factor)
    depth = DepthMap(values, kind="metric", image_size=size)
    box = tuple(factor * edge for edge in (4, 2, 12, 6))
    mask = np.zeros(size[::-1], np.bool_)
    mask[2 * factor : 6 * factor, 4 * factor : 12 * factor] = True
    whole = Detection("car", (0, 0, *size), mask=mask)
    assert box_quantiles(depth, [box], (0, 1)).tolist() == [[3.0, 3.0]]
    assert box_quantiles(depth, [whole], (0, 1)).tolist() == [[3.0, 3.0]]


def test_a_box_smaller_than_a_pixel_takes_the_one_that_holds_its_centre():
    depth = DepthMap(np.arange(1.0, 17.0).reshape(4, 4), kind="metric", image_size=(400, 400))
    assert box_quantiles(depth, [(110, 210, 120, 220)]).tolist() == [10.0]


def test_a_mask_between_the_centres_of_a_map_has_no_depth():
    mask = np.zeros((40, 40), np.bool_)
    mask[10:12, 10:12] = True
    depth = DepthMap(np.full((4, 4), 2.0), kind="metric", image_size=(40, 40))
    assert math.isnan(box_quantiles(depth, [Detection("pin", (9, 9, 13, 13), mask=mask)])[0])


@pytest.mark.parametrize(
    ("q", "shape"), [(0.5, (2,)), (1, (2,)), ([0.5], (2, 1)), ((0.1, 0.9, 0.5), (2, 3))]
)
def test_the_result_has_a_row_per_box_and_a_column_per_share(q, shape):
    depth = DepthMap(np.full((4, 4), 2.0, dtype=np.float32), kind="metric")
    found = box_quantiles(depth, [(0, 0, 2, 2), (1, 1, 4, 4)], q)
    assert (found.shape, found.dtype) == (shape, np.float64)
    assert box_quantiles(depth, [], q).shape == (0, *shape[1:])
    assert box_quantiles(depth, np.empty((0, 4)), q).shape == (0, *shape[1:])


@pytest.mark.parametrize(
    ("boxes", "error", "law"),
    [
        pytest.param([(2, 0, 1, 2)], ValueError, r"x1 < x2 .* at index 0", id="inverted"),
        pytest.param([(0, 0, 2, 2), (0, 0, NAN, 2)], ValueError, "finite.* at index 1", id="NaN"),
        pytest.param([(0, 0, 9, 2)], ValueError, r"image, 4 x 4 px; got \(0\.0", id="beyond"),
        pytest.param((0, 0, 2, 2), ValueError, r"shape \(N, 4\).*got shape \(4,\)", id="one box"),
        pytest.param([(0, 0, 2, 2), (0, 0)], ValueError, "rows of unequal length", id="ragged"),
        pytest.param("box", TypeError, "got dtype", id="text"),
        pytest.param([["a", "b", "c", "d"]], TypeError, "got dtype", id="words"),
        pytest.param([Detection("a", (0, 0, 1, 1)), 3], TypeError, "got 3 at index 1", id="mixed"),
    ],
)  # fmt: skip
def test_unlawful_boxes_are_refused(boxes, error, law):
    depth = DepthMap(np.full((4, 4), 2.0), kind="metric")
    with pytest.raises(error, match=law):
        box_quantiles(depth, boxes)


@pytest.mark.parametrize(
    ("q", "error"),
    [(1.01, ValueError), (-0.1, ValueError), (NAN, ValueError), ([[0.5]], ValueError),
     ("0.5", TypeError), (None, TypeError), (50, ValueError)],
)  # fmt: skip
def test_unlawful_shares_are_refused(q, error):
    depth = DepthMap(np.full((4, 4), 2.0), kind="metric")
    with pytest.raises(error, match="`q` must be a number from 0 to 1"):
        box_quantiles(depth, [(0, 0, 2, 2)], q)


def test_what_is_no_map_is_refused():
    with pytest.raises(TypeError, match=r"`depth` must be a DepthMap; got ndarray"):
        box_quantiles(np.ones((4, 4)), [(0, 0, 2, 2)])


def test_a_mask_of_another_image_is_refused():
    depth = DepthMap(np.full((4, 4), 2.0), kind="metric")
    other = Detection("car", (0, 0, 2, 2), mask=np.ones((5, 5), np.bool_))
    with pytest.raises(ValueError, match=r"`mask` must have the shape of the image, \(4, 4\)"):
        box_quantiles(depth, [other])


# --- what a map keeps of itself ---


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(5))
def test_a_maps_range_is_that_of_its_depths(kind, seed):
    depth = DepthMap(hostile(seed), kind=kind)
    expected = by_numpy(depth.values, kind, (0, 1))
    assert depth.valid_range == tuple(expected)
    gaps = ~np.isin(depth.values, depth.values[np.isfinite(depth.values)])
    if kind != "affine_inverse":
        gaps |= depth.values <= 0
    assert depth.gaps_are_nan == bool(np.isnan(depth.values[gaps]).all())


def test_a_map_read_back_stays_frozen_and_says_the_same():
    depth = DepthMap(hostile(2), kind="metric")
    said = (depth.fingerprint, depth.valid_range, depth.gaps_are_nan)
    back = pickle.loads(pickle.dumps(depth))  # noqa: S301 - our own
    assert (back.fingerprint, back.valid_range, back.gaps_are_nan) == said
    assert not back.values.flags.writeable
