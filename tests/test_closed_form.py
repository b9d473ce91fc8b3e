"""The paper's two estimators against fractions, numpy's solver and finite differences."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import imgscale as ims
from imgscale.core.closed_form import least_squares, mean_ratio

ESTIMATORS = [mean_ratio, least_squares]
X = [44, 153, 27, 310]
Y = [2, 5, 1, 7]

positive = st.floats(1e-3, 1e3)
pairs = st.lists(st.tuples(positive, positive), min_size=1, max_size=12)


def exact_mean_ratio(x, y):
    return sum(Fraction(b) / Fraction(a) for a, b in zip(x, y, strict=True)) / len(x)


def exact_least_squares(x, y):
    products = sum(Fraction(a) * Fraction(b) for a, b in zip(x, y, strict=True))
    return products / sum(Fraction(a) ** 2 for a in x)


@pytest.mark.parametrize("estimate", ESTIMATORS)
def test_consistent_objects_give_their_common_k(estimate):
    x = np.array([3.0, 70.0, 1e4])
    assert estimate(x, 0.0125 * x)[0] == pytest.approx(0.0125, rel=1e-14)


@pytest.mark.parametrize(
    ("estimate", "exact"),
    [(mean_ratio, exact_mean_ratio), (least_squares, exact_least_squares)],
    ids=["mean_ratio", "least_squares"],
)
def test_integers_give_the_exact_fraction(estimate, exact):
    assert estimate(X, Y)[0] == pytest.approx(float(exact(X, Y)), rel=1e-15)


@given(pairs)
def test_mean_ratio_is_the_mean_of_the_quotients(rows):
    x, y = zip(*rows, strict=True)
    assert mean_ratio(x, y)[0] == pytest.approx(float(exact_mean_ratio(x, y)), rel=1e-12)


@given(pairs)
def test_least_squares_is_sum_xy_over_sum_xx(rows):
    x, y = zip(*rows, strict=True)
    assert least_squares(x, y)[0] == pytest.approx(float(exact_least_squares(x, y)), rel=1e-12)


@given(pairs)
def test_least_squares_is_numpys_solution(rows):
    x, y = (np.array(column) for column in zip(*rows, strict=True))
    solution = np.linalg.lstsq(x[:, np.newaxis], y)[0][0]
    assert least_squares(x, y)[0] == pytest.approx(solution, rel=1e-9)


@pytest.mark.parametrize("estimate", ESTIMATORS)
def test_shares_are_the_derivatives_of_log_k(estimate):
    k, shares = estimate(X, Y)
    step = 1e-6
    for i, share in enumerate(shares):
        moved = np.array(Y, dtype=np.float64)
        moved[i] *= math.exp(step)
        assert (math.log(estimate(X, moved)[0]) - math.log(k)) / step == pytest.approx(
            share, rel=1e-5
        )


@pytest.mark.parametrize("estimate", ESTIMATORS)
@given(rows=pairs)
def test_shares_are_positive_and_sum_to_one(estimate, rows):
    x, y = zip(*rows, strict=True)
    _, shares = estimate(x, y)
    assert np.all(shares > 0)
    assert shares.sum() == pytest.approx(1, rel=1e-12)


@pytest.mark.parametrize("estimate", ESTIMATORS)
@given(rows=pairs, c=positive)
def test_k_scales_with_sizes_and_against_depths(estimate, rows, c):
    x, y = (np.array(column) for column in zip(*rows, strict=True))
    k = estimate(x, y)[0]
    assert estimate(x, c * y)[0] == pytest.approx(c * k, rel=1e-12)
    assert estimate(c * x, y)[0] == pytest.approx(k / c, rel=1e-12)


@pytest.mark.parametrize("estimate", ESTIMATORS)
@given(rows=pairs)
def test_k_lies_between_the_smallest_and_the_largest_own_k(estimate, rows):
    x, y = (np.array(column) for column in zip(*rows, strict=True))
    assert (y / x).min() * (1 - 1e-12) <= estimate(x, y)[0] <= (y / x).max() * (1 + 1e-12)


@pytest.mark.parametrize(
    ("method", "exact"),
    [("mean_ratio", exact_mean_ratio), ("least_squares", exact_least_squares)],
    ids=["mean_ratio", "least_squares"],
)
def test_fit_applies_the_formula_to_depth_times_pixels(method, exact):
    depths, pixels, heights = (
        [3, 5, 8, 13],
        [40, 90, 31, 22],
        [Fraction(3, 2), 4, Fraction(7, 4), 2],
    )
    model = ims.fit(
        [ims.Detection(f"object {i}", (0, 0, 9, p)) for i, p in enumerate(pixels)],
        ims.ObjectDepths(depths, kind="relative"),
        ims.PriorTable(
            [ims.ObjectPrior(f"object {i}", float(h), 0.3) for i, h in enumerate(heights)]
        ),
        method=method,
    )
    x = [d * p for d, p in zip(depths, pixels, strict=True)]
    assert model.k == pytest.approx(float(exact(x, heights)), rel=1e-14)


def test_closed_form_errors_grow_with_the_scatter_of_the_own_k():
    def k_rel_std(second):
        model = ims.fit(
            [ims.Detection("pole a", (0, 0, 9, 100)), ims.Detection("pole b", (0, 0, 9, second))],
            ims.ObjectDepths([5.0, 5.0], kind="relative", rel_std=0.0),
            ims.PriorTable([ims.ObjectPrior("pole a", 1, 0.1), ims.ObjectPrior("pole b", 1, 0.1)]),
            method="mean_ratio",
            noise=ims.Noise(box_px=0.0),
        )
        return model.k_std / model.k

    spread = math.sqrt(math.log(1 + 0.1**2))
    assert k_rel_std(100) == pytest.approx(spread / math.sqrt(2), rel=1e-9)
    assert k_rel_std(200) > 2 * k_rel_std(100)


@pytest.mark.parametrize("estimate", ESTIMATORS)
def test_several_images_are_solved_column_by_column(estimate):
    x = np.random.default_rng(0).uniform(1, 9, (4, 3, 2))
    y = np.random.default_rng(1).uniform(1, 9, (4, 3, 2))
    k, shares = estimate(x, y)
    assert (k.shape, shares.shape) == ((3, 2), x.shape)
    for place in np.ndindex(3, 2):
        one_k, one_shares = estimate(x[:, *place], y[:, *place])
        assert k[place] == pytest.approx(one_k, rel=1e-14)
        np.testing.assert_allclose(shares[:, *place], one_shares, rtol=1e-14)
