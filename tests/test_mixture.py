"""Quantiles of mixtures of Gaussians against root finding on their cumulative distribution."""

import math

import numpy as np
import pytest
from scipy import optimize, special

from imgscale.core.mixture import MEDIAN, SCORES, Mixture, half_width


def mixture(*components):
    """One row of (weight, mean, std)."""
    weight, mean, std = np.array(components, dtype=np.float64).T
    return Mixture(weight[None], mean[None], std[None] ** 2)


def below(row, x):
    """Cumulative distribution by definition; what lies at infinity never counts."""
    weight, mean, variance = (column[row.index] for column in row.mixture)
    return float(weight @ special.ndtr((x - mean) / np.sqrt(variance)))


class Row:
    """One quantity of a mixture."""

    def __init__(self, whole, index=0):
        self.mixture, self.index = whole, index

    def quantile(self, score):
        probability = special.ndtr(score)
        weight, mean, variance = (column[self.index] for column in self.mixture)
        if probability >= weight.sum():
            return math.inf
        std = np.sqrt(variance)
        low, high = (mean - 9 * std).min(), (mean + 9 * std).max()
        return optimize.brentq(lambda x: below(self, x) - probability, low, high, xtol=1e-14)


def errors(whole, index=0, scores=SCORES):
    """
    How far the quantiles are off, as a fraction of the half width or in standard scores.

    The lesser of the two: where nothing lies, between two modes, a quantile means little, and where
    much lies, at the foot of a narrow core, a score does.
    """
    row, found = Row(whole, index), whole.quantiles()[index]
    expected = np.array([row.quantile(score) for score in SCORES])
    assert (np.isinf(found) == np.isinf(expected)).all()
    finite = np.isfinite(expected) & np.isin(SCORES, scores)
    width = half_width(expected[None])[0]
    width = width if np.isfinite(width) else expected[MEDIAN] - expected[10]
    in_width = np.abs(found - expected)[finite] / width
    probability = np.array([below(row, x) for x in found[finite]])
    in_score = np.abs(special.ndtri(np.clip(probability, 1e-12, 1 - 1e-12)) - SCORES[finite])
    return np.minimum(in_width, in_score)


NAMED = {
    "two alike": mixture((0.5, 0.0, 1.0), (0.5, 0.0, 1.0)),
    "two apart": mixture((0.6, -2.0, 0.3), (0.4, 2.0, 0.5)),
    "two far apart": mixture((0.3, -2.0, 0.02), (0.7, 2.0, 0.02)),
    "one in a hundred far away": mixture((0.99, 0.0, 0.1), (0.01, 3.0, 0.1)),
    "a core in a tail": mixture((0.95, 0.0, 0.02), (0.05, 0.3, 0.5)),
    "a narrow core in a tail": mixture((0.9, 0.0, 1e-3), (0.1, 0.0, 0.5)),
    **{
        f"a core of {core} among outliers": mixture(
            (0.95, 0.0, core), (0.02, 0.0, 0.5), (0.03, 0.4, 0.25)
        )
        for core in (0.01, 0.005, 0.002)
    },
    "a needle in a wide tail": mixture((0.5, 0.2, 1e-7), (0.5, 0.0, 1.0)),
    "three kinds": mixture((0.7, 0.5, 0.05), (0.2, 0.1, 0.1), (0.1, -0.1, 0.06)),
    "a staircase": mixture(*((0.1, float(place), 0.05) for place in range(10))),
    "points of a grid": mixture(
        *((math.exp(-0.5 * (0.5 * i) ** 2) * 0.1995, 0.5 * i, 0.25) for i in range(-12, 13))
    ),
    "many scales": mixture(*((1 / 4, 0.0, 10.0**-power) for power in range(4))),
}


@pytest.mark.parametrize("name", NAMED)
def test_quantiles_are_those_of_the_cumulative_distribution(name):
    whole = NAMED[name]
    whole = whole._replace(weight=whole.weight / whole.weight.sum())
    assert errors(whole, scores=SCORES[np.abs(SCORES) <= 2]).max() < 0.02
    assert errors(whole).max() < 0.05


def random_mixtures(seed, count=40):
    rng = np.random.default_rng(seed)
    components = int(rng.integers(2, 40))
    weight = rng.dirichlet(np.full(components, 0.5), count)
    mean = rng.normal(size=(count, components)) * np.exp(rng.normal(0, 0.5, (count, 1)))
    std = np.exp(rng.normal(-1, 0.8, (count, components)))
    return Mixture(weight, mean, std**2)


@pytest.mark.parametrize("seed", range(4))
def test_random_mixtures_too(seed):
    whole = random_mixtures(seed)
    worst = np.array([errors(whole, index).max() for index in range(len(whole.weight))])
    inner = np.array([
        errors(whole, index, SCORES[np.abs(SCORES) <= 2]).max()
        for index in range(len(whole.weight))
    ])  # fmt: skip
    assert inner.max() < 0.02
    assert worst.max() < 0.05


@pytest.mark.parametrize("seed", range(4))
def test_quantiles_never_decrease(seed):
    assert (np.diff(random_mixtures(seed).quantiles(), axis=1) >= 0).all()
    for whole in NAMED.values():
        assert (np.diff(whole.quantiles()) >= 0).all()


@pytest.mark.parametrize("copies", [1, 2, 7])
@pytest.mark.parametrize("std", [1e-9, 0.03, 40.0])
@pytest.mark.parametrize("mean", [-6.25, 0.0, 13.0])
def test_one_gaussian_is_exact(mean, std, copies):
    whole = mixture(*[(1 / copies, mean, std)] * copies)
    np.testing.assert_allclose(
        (whole.quantiles()[0] - mean) / std, SCORES, atol=1e-6 + 1e-14 * (abs(mean) + 1) / std
    )
    assert half_width(whole.quantiles())[0] == pytest.approx(std, rel=1e-5)


def test_scores_are_symmetric_about_the_median_and_hold_one():
    np.testing.assert_allclose(SCORES, -SCORES[::-1])
    assert SCORES[MEDIAN] == 0
    assert (SCORES == 1).sum() == 1


@pytest.mark.parametrize("name", NAMED)
def test_the_half_width_is_half_the_central_683_per_mille(name):
    row, whole = Row(NAMED[name]), NAMED[name]
    total = whole.weight.sum()
    whole = whole._replace(weight=whole.weight / total)
    row = Row(whole)
    expected = (row.quantile(1.0) - row.quantile(-1.0)) / 2
    assert half_width(whole.quantiles())[0] == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("missing", [0.002, 0.01, 0.2, 0.6, 0.97])
def test_mass_at_infinity_takes_the_upper_quantiles(missing):
    whole = mixture((0.7 * (1 - missing), 0.0, 1.0), (0.3 * (1 - missing), 4.0, 0.5))
    found = whole.quantiles()[0]
    assert (np.isinf(found) == (special.ndtr(SCORES) > 1 - missing)).all()
    finite = np.isfinite(found)
    row = Row(whole)
    for score, value in zip(SCORES[finite], found[finite], strict=True):
        assert below(row, value) == pytest.approx(special.ndtr(score), abs=2e-3)


def test_less_mass_than_is_worth_telling_does_not_count():
    whole = mixture((0.9995, 0.0, 1.0), (0.0, 9.0, 1.0))
    assert np.isfinite(whole.quantiles()).all()
    np.testing.assert_allclose(whole.quantiles()[0][MEDIAN], 0, atol=2e-3)


def test_what_is_not_known_is_nan_and_leaves_the_others_alone():
    known = random_mixtures(9, count=3)
    mean = known.mean.copy()
    mean[1] = np.nan
    found = known._replace(mean=mean).quantiles()
    assert np.isnan(found[1]).all()
    np.testing.assert_array_equal(found[[0, 2]], known.quantiles()[[0, 2]])
    assert np.isnan(Mixture(*np.full((3, 2, 1), np.nan)).quantiles()).all()


def test_no_rows_give_no_quantiles():
    assert Mixture(*np.empty((3, 0, 5))).quantiles().shape == (0, SCORES.size)
    assert Mixture(*np.empty((3, 0, 1))).quantiles().shape == (0, SCORES.size)


@pytest.mark.parametrize(("shift", "scale"), [(13.0, 1.0), (0.0, 1e-3), (-6.0, 20.0)])
def test_shifting_and_scaling_commute_with_quantiles(shift, scale):
    whole = random_mixtures(5)
    moved = Mixture(whole.weight, shift + scale * whole.mean, scale**2 * whole.variance)
    expected = shift + scale * whole.quantiles()
    width = scale * half_width(whole.quantiles())[:, None]
    np.testing.assert_allclose((moved.quantiles() - expected) / width, 0, atol=1e-6)


def test_components_of_no_variance_are_points():
    whole = mixture((0.5, 0.0, 0.0), (0.5, 1.0, 0.0))
    found = whole.quantiles()[0]
    assert found[0] == pytest.approx(0, abs=1e-3)
    assert found[-1] <= 1 + 1e-3
    assert (np.diff(found) >= 0).all()


WIDE = {
    "as good as one": mixture((1 - 1e-12, 0.4, 0.1), (1e-12, 0.0, 1.0)),
    "needles on either side": mixture((0.5, -1.0, 1e-6), (0.3, 1.0, 1e-6), (0.2, 0.0, 3.0)),
    "far apart": mixture((0.2, -1e4, 1.0), (0.8, 1e4, 1.0)),
    "nearly the same": mixture((0.3, 1.0, 0.1), (0.7, 1.0 + 1e-9, 0.1 + 1e-9)),
}


def left_out(whole, otherwise):
    """Above 8 components the lightest, 3e-6 together, do not count: 1 % of the farthest tail."""
    return 5e-3 if whole.weight.shape[1] > 8 else otherwise


@pytest.mark.parametrize("name", NAMED | WIDE)
def test_quantiles_have_their_scores_to_five_digits(name):
    whole = (NAMED | WIDE)[name]
    whole = whole._replace(weight=whole.weight / whole.weight.sum())
    assert errors(whole).max() < left_out(whole, 1e-5)


@pytest.mark.parametrize("seed", range(4))
def test_so_have_those_of_random_mixtures(seed):
    many = random_mixtures(seed)
    weight = many.weight[:, :8] / many.weight[:, :8].sum(axis=1, keepdims=True)
    few = Mixture(weight, many.mean[:, :8], many.variance[:, :8])
    for whole in (few, many):
        worst = [errors(whole, index).max() for index in range(len(whole.weight))]
        assert max(worst) < left_out(whole, 1e-4)


@pytest.mark.parametrize("components", [2, 3, 8, 9, 40])
def test_a_row_is_the_same_alone_and_among_thousands(components):
    rng = np.random.default_rng(components)
    count = 3000
    weight = rng.dirichlet(np.full(components, 0.3), count)
    weight[::7, 1:] = 0
    weight[::7, 0] = 1
    weight[::5] *= 0.9
    std = np.exp(rng.normal(-1, 1, weight.shape))
    whole = Mixture(weight, rng.normal(size=weight.shape), std**2)
    found = whole.quantiles()
    for rows in ([0], [1], [2], [3], [5], [7, 2999], [1234], range(17, 400)):
        some = Mixture(*(part[list(rows)] for part in whole)).quantiles()
        np.testing.assert_allclose(found[list(rows)], some, rtol=1e-12, atol=1e-12)


def test_one_component_of_all_the_weight_is_a_gaussian_in_closed_form():
    whole = mixture((0.0, 3.0, 0.2), (1.0, 1.25, 0.5), (0.0, 3.0, 0.2))
    np.testing.assert_array_equal(whole.quantiles()[0], 1.25 + 0.5 * SCORES)


def test_where_all_mass_is_at_infinity_nothing_is_known():
    whole = Mixture(np.zeros((1, 2)), np.zeros((1, 2)), np.ones((1, 2)))
    assert np.isnan(whole.quantiles()).all()
