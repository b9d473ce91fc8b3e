"""Medians and orders of short columns, compared with numpy and with the definition."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgscale.core.ordering import column_medians, column_order, weighted_column_medians

SIZES = [*range(1, 18), 29, 30, 64, 100, 127, 128, 129, 200]
WIDTHS = [1, 63, 64, 200]


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("size", SIZES)
def test_medians_are_numpys(size, width):
    values = np.random.default_rng(size).normal(size=(size, width))

    np.testing.assert_array_equal(column_medians(values), np.median(values, axis=0))


def by_definition(values, weights):
    """The middle of where half of the weight lies on either side."""
    order = np.argsort(values)
    ordered, total = values[order], np.cumsum(weights[order])
    at_least = ordered[total >= total[-1] / 2 * (1 - 1e-9)][0]
    more = ordered[total > total[-1] / 2 * (1 + 1e-9)][0]
    return (at_least + more) / 2


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("size", SIZES)
def test_weighted_medians_are_those_of_the_definition(size, width):
    rng = np.random.default_rng(size)
    values, weights = rng.normal(size=(size, width)), rng.uniform(0.1, 2.0, (size, width))

    wanted = [by_definition(*column) for column in zip(values.T, weights.T, strict=True)]

    np.testing.assert_array_equal(weighted_column_medians(values, weights), wanted)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("size", [2, 3, 8, 9, 30])
def test_equal_weights_give_the_median_also_of_ties(size, width):
    values = np.random.default_rng(size).integers(0, 4, (size, width)).astype(np.float64)

    medians = weighted_column_medians(values, np.ones_like(values))

    np.testing.assert_array_equal(medians, np.median(values, axis=0))


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("scale", [1e-300, 1e-8, 1.0, 700.0, 1e300])
def test_values_of_any_magnitude_and_sign_are_ordered(scale, width):
    rng = np.random.default_rng(3)
    values = scale * rng.normal(size=(8, width))
    values[0] = 0.0

    medians = weighted_column_medians(values, np.ones_like(values))

    np.testing.assert_allclose(medians, np.median(values, axis=0), rtol=1e-13)


def test_inputs_are_left_as_they_are():
    rng = np.random.default_rng(0)
    values, weights = rng.normal(size=(9, 80)), rng.uniform(0.1, 2.0, (9, 80))
    before = values.copy(), weights.copy()

    weighted_column_medians(values, weights)
    column_medians(values)

    np.testing.assert_array_equal(values, before[0])
    np.testing.assert_array_equal(weights, before[1])


@given(
    st.integers(1, 40), st.sampled_from([1, 5, 64, 90]), st.integers(1, 50), st.integers(0, 10**6)
)
def test_an_order_sorts_its_keys_and_takes_each_row_once(size, width, n_keys, seed):
    keys = np.random.default_rng(seed).integers(0, n_keys, (size, width))

    order = column_order(keys)

    np.testing.assert_array_equal(np.sort(order, axis=0), np.arange(size)[:, None].repeat(width, 1))
    assert (np.diff(np.take_along_axis(keys, order, axis=0), axis=0) >= 0).all()
