"""The robust estimator of many images, one after another with dense matrices."""

import math

import numpy as np
import pytest

from imgscale.core.blocks import Block, _middle, _next_step, fit_block, share_out
from imgscale.core.estimator import disagree, fit_robust, log_k_std, view_from_others
from imgscale.core.segments import LogObservations, Subjects

TUKEY_C = 4.685
MAD_TO_STD = 1 / 0.6744897501960817  # of normal numbers


def observations(y, variance, tau, group, *, image=None, firm=None):
    n = len(y)
    return LogObservations(
        y=np.asarray(y, dtype=np.float64),
        variance=np.asarray(variance, dtype=np.float64),
        tau=np.asarray(tau, dtype=np.float64),
        image=np.zeros(n, dtype=np.intp) if image is None else np.asarray(image),
        group=np.asarray(group, dtype=np.intp),
        firm=np.zeros(n, dtype=np.bool_) if firm is None else np.asarray(firm),
    )


def many_images(seed, count, residual, n_firm=0):
    """Images of five references with one to five labels each, in any order."""
    rng = np.random.default_rng(seed)
    label = np.sort(rng.integers(0, 1 + np.arange(count) % 5, (5, count)), axis=0)
    group = np.unique(label + 5 * np.arange(count), return_inverse=True)[1].reshape(5, count)
    tau = rng.uniform(0.0, 0.1, group.max() + 1)
    offset = rng.normal(size=tau.size) * tau
    variance = rng.uniform(0.02, 0.2, group.shape) ** 2
    noise = offset[group] + rng.normal(size=group.shape) * np.sqrt(variance)
    firm = rng.permuted(np.arange(5)[:, None] < np.full(count, n_firm), axis=0)
    image = np.broadcast_to(np.arange(count), group.shape)
    order = rng.permutation(group.size)
    columns = (-6 + residual * noise, variance, tau[group], group, image, firm)
    y, variance, tau, group, image, firm = (column.ravel()[order] for column in columns)
    return observations(y, variance, tau, group, image=image, firm=firm)


def assert_solved(y, variance, tau, group, firm, log_k, log_std, trust, weight, share):
    """Check one image: Tukey's weights, and generalised least squares with these."""
    kept = weight > 0
    given = np.divide(trust, weight, out=variance.copy(), where=kept)
    more = (given - variance)[kept & ~firm]
    excess = more[0] if more.size else 0.0
    assert more == pytest.approx(excess, abs=1e-12)
    assert excess >= -1e-15
    assert given[firm] == pytest.approx(variance[firm], rel=1e-12)
    given = variance + np.where(firm, 0.0, max(excess, 0.0))
    total = variance + tau**2 + max(excess, 0.0)
    ratio = (y - log_k) ** 2 / (TUKEY_C**2 * total)
    biweight = np.where(firm, 1.0, np.maximum(1 - ratio, 0) ** 2)
    assert trust == pytest.approx(biweight, abs=1e-8)
    same = group[kept][:, None] == group[kept]
    labels = same * np.outer(tau[kept], tau[kept])
    inverse = np.linalg.inv(np.diag(1 / weight[kept]) + labels)
    expected = inverse.sum(axis=0) / inverse.sum()
    assert log_k == pytest.approx(expected @ y[kept], abs=1e-8)
    assert share[kept] == pytest.approx(expected, abs=1e-7)
    assert np.all(share[~kept] == 0)
    propagated = expected @ (np.diag(given[kept]) + labels) @ expected
    assert log_std == pytest.approx(math.sqrt(propagated), rel=1e-7)


@pytest.mark.parametrize("count", [2, 70])
@pytest.mark.parametrize("residual", [0.7, 1.5, 4.0])
@pytest.mark.parametrize("n_firm", [0, 1, 2])
def test_every_image_of_a_batch_is_its_own_dense_solution(count, residual, n_firm):
    obs = many_images(round(10 * residual), count, residual, n_firm)
    fit = fit_robust(obs)
    for image in range(count):
        rows = np.flatnonzero(obs.image == image)
        assert_solved(
            obs.y[rows],
            obs.variance[rows],
            obs.tau[rows],
            obs.group[rows],
            obs.firm[rows],
            fit.log_k[image],
            fit.log_std[image],
            fit.trust[rows],
            fit.weight[rows],
            fit.share[rows],
        )


def test_an_image_of_a_wide_batch_is_solved_as_alone():
    obs = many_images(8, 70, 3.0)
    fit = fit_robust(obs)
    apart = disagree(obs)
    for image in range(70):
        rows = np.flatnonzero(obs.image == image)
        group = np.unique(obs.group[rows], return_inverse=True)[1]
        one = observations(obs.y[rows], obs.variance[rows], obs.tau[rows], group)
        alone = fit_robust(one)
        assert fit.log_k[image] == pytest.approx(alone.log_k[0], abs=1e-9)
        assert fit.log_std[image] == pytest.approx(alone.log_std[0], rel=1e-8)
        assert fit.disagree[image] == apart[image] == alone.disagree[0] == disagree(one)[0]


@pytest.mark.parametrize("deviation", [0.5, 1.9, 2.1, 2.4, 2.6, 5.0])
def test_the_excess_variance_is_that_of_the_notes(deviation):
    std, steps = 0.1, np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    spread = deviation / MAD_TO_STD * std  # the median absolute deviation
    obs = observations(-6 + spread * steps, [std**2] * 5, [0.0] * 5, np.arange(5))
    fit = fit_robust(obs)
    raw = MAD_TO_STD * spread
    excess = raw**2 * (1 - (2 / deviation) ** 2) if deviation > 2 else 0.0
    assert fit.trust[2] / fit.weight[2] == pytest.approx(std**2 + excess, rel=1e-3)
    assert fit.log_k[0] == pytest.approx(-6, abs=1e-12)
    assert fit.disagree[0] == disagree(obs)[0] == (deviation > 2.5)


@pytest.mark.parametrize("count", [2, 80])
def test_an_estimate_in_closed_form_gets_its_declared_error_or_its_scatter(count):
    rng = np.random.default_rng(3)
    y, variance = rng.normal(-6, 0.2, (4, count)), rng.uniform(0.05, 0.2, (4, count)) ** 2
    tau, group = np.array([[0.1], [0.1], [0.0], [0.2]]) + np.zeros(count), np.array([0, 0, 1, 2])
    share = rng.dirichlet(np.ones(4), count).T
    log_k = (share * y).sum(axis=0)
    found = share_out(Block(y, variance, tau, np.tile(group[:, None], count)), log_k, share)
    widened = 0
    for at in range(count):
        same = group[:, None] == group
        covariance = np.diag(variance[:, at]) + same * np.outer(tau[:, at], tau[:, at])
        scatter = ((y[:, at] - log_k[at]) ** 2 / np.diag(covariance)).sum() / 3
        error = share[:, at] @ covariance @ share[:, at] * max(scatter, 1.0)
        assert found.log_std[at] == pytest.approx(math.sqrt(error), rel=1e-12)
        assert found.disagree[at] == (scatter > 4)
        widened += scatter > 1
    assert found.weight == pytest.approx(1 / variance)
    assert np.all(found.trust == 1)
    assert widened > 0
    assert found.share == pytest.approx(share)


def test_one_reference_in_closed_form_has_its_declared_error():
    one = np.ones((1, 1))
    found = share_out(
        Block(-6 * one, 0.01 * one, 0.1 * one, one.astype(int)), np.array([-6.0]), one
    )
    assert found.log_std[0] == pytest.approx(math.sqrt(0.02), rel=1e-14)


def test_a_block_takes_columns_with_their_firm_witnesses():
    y = np.arange(6.0).reshape(2, 3)
    firm = np.array([[True, False, False], [False, False, True]])
    block = Block(y, y + 1, y + 2, y.astype(int), firm)
    some = block.columns(np.array([2, 0]))
    assert some.y.tolist() == [[2, 0], [5, 3]]
    assert some.firm is not None
    assert some.firm.tolist() == [[False, True], [True, False]]
    assert fit_block(some).trust[some.firm].tolist() == [1, 1]


def test_errors_of_several_images_are_propagated_image_by_image():
    obs = many_images(5, 40, 1.0)
    share = np.random.default_rng(0).uniform(0, 1, obs.y.size)
    found = log_k_std(obs, share)
    for image in range(40):
        rows = np.flatnonzero(obs.image == image)
        same = obs.group[rows][:, None] == obs.group[rows]
        covariance = np.diag(obs.variance[rows]) + same * np.outer(obs.tau[rows], obs.tau[rows])
        assert found[image] == pytest.approx(
            math.sqrt(share[rows] @ covariance @ share[rows]), rel=1e-12
        )


def test_an_image_without_references_knows_nothing_of_its_scale():
    obs = observations([-6.0, -6.1], [0.01, 0.01], [0.05, 0.05], [0, 0])
    subjects = Subjects(np.array([3]), np.array([-1]), np.array([0.07]), np.array([-1]))
    view = view_from_others(obs, fit_robust(obs), subjects)
    assert math.isnan(view.log_k[0, 0])
    assert math.isnan(view.log_k_var[0, 0])
    assert view.offset[0, 0] == 0
    assert view.offset_var[0, 0] == pytest.approx(0.07**2)
    assert view.covariance[0, 0] == 0


@pytest.mark.parametrize("labels", [[0], [0, 0], [0, 1], [0, 0, 1, 2, 2]], ids=str)
@pytest.mark.parametrize("std", [0.1, 3.0], ids=["sharp", "weak"])
def test_a_new_object_is_seen_from_references_of_any_weight_and_of_one_label(labels, std):
    n, tau = len(labels), 0.3
    y = -6 + std * np.linspace(-1, 1, n)
    obs = observations(y, np.full(n, std**2), np.full(n, tau), labels)
    fit = fit_robust(obs)
    # the Gaussian of log k, flat, and of every label's offset, by its precision matrix
    design = np.column_stack([np.ones(n), *(obs.group == c for c in range(max(labels) + 1))])
    prior = np.diag([0.0] + [tau**-2] * (max(labels) + 1))
    covariance = np.linalg.inv(prior + design.T @ (fit.weight[:, None] * design))
    mean = covariance @ design.T @ (fit.weight * y)
    for label in range(max(labels) + 1):
        ask = Subjects(np.array([0]), np.array([label]), np.array([tau]), np.array([-1]))
        view = view_from_others(obs, fit, ask)
        assert view.log_weight.tolist() == [[0.0]]  # the one case is certain
        assert view.log_k[0, 0] == pytest.approx(mean[0], abs=1e-9)
        assert view.log_k_var[0, 0] == pytest.approx(covariance[0, 0], rel=1e-9)
        assert view.offset[0, 0] == pytest.approx(mean[1 + label], abs=1e-9)
        assert view.offset_var[0, 0] == pytest.approx(covariance[1 + label, 1 + label], rel=1e-9)
        assert view.covariance[0, 0] == pytest.approx(covariance[0, 1 + label], rel=1e-9)


def test_the_search_goes_on_in_the_middle_of_its_bounds_where_both_are_known():
    lower, upper = np.array([1.0, -np.inf, 2.0, -5.0]), np.array([4.0, 3.0, np.inf, -1.0])
    assert _middle(lower, upper, np.full(4, 9.0)).tolist() == [2.5, 9, 9, -3]


def test_the_secant_step_of_a_straight_gradient_ends_at_its_root():
    root, slope, at, step = 3.0, 2.0, np.array([1.0, 7.0]), np.array([0.5, -1.5])
    before, gradient = slope * (root - at), slope * (root - at - step)
    new, is_last = _next_step(step, before, gradient, np.full(2, slope), 0.2, 3.0)
    assert at + step + new == pytest.approx(root)
    assert not is_last.any()


def test_where_the_gradient_does_not_fall_the_step_is_that_of_reweighting():
    step, gradient, curvature = np.array([0.5, -0.5]), np.array([4.0, -6.0]), np.array([2.0, 2.0])
    new, _ = _next_step(step, gradient, gradient, curvature, 0.2, 3.0)
    assert new.tolist() == [6, -9]


@pytest.mark.parametrize(("falls", "last"), [(True, True), (False, False)])
def test_a_tiny_step_is_the_last_only_by_the_secant(falls, last):
    step, gradient = np.array([1e-4]), np.array([1e-9])
    before = gradient + (step if falls else 0.0)
    _, is_last = _next_step(step, before, gradient, np.ones(1), 0.2, 3.0)
    assert is_last.tolist() == [last]


def test_where_no_reference_counts_half_of_the_way_is_taken_back_and_others_go_on():
    step, before = np.array([0.5, 0.5, -3.0]), np.array([3.0, 1.0, 0.0])
    gradient, curvature = np.array([0.0, 4.0, 0.0]), np.array([0.0, 2.0, 0.0])
    new, is_last = _next_step(step, before, gradient, curvature, 0.2, 3.0)
    assert new.tolist() == [-0.25, 6, 1.5]
    assert not is_last.any()
    # a step that is tiny and the last stays so beside one that is not
    tiny, curvature = np.array([1e-4, 0.5]), np.array([1.0, 0.0])
    _, is_last = _next_step(tiny, tiny + 1e-9, np.array([1e-9, 0.0]), curvature, 0.2, 3.0)
    assert is_last.tolist() == [True, False]


@pytest.mark.parametrize(("step", "last"), [(0.9e-8, True), (1.1e-8, False)])
def test_steps_are_the_last_by_the_error_of_log_k(step, last):
    # its curvature is 100: the error is a tenth, and a step of 1e-7 of that is the last
    new, is_last = _next_step(
        np.array([1e-4]), np.array([100 * (1e-4 + step)]), np.array([100 * step]),
        np.array([100.0]), 0.2, 3.0,
    )  # fmt: skip
    assert new == pytest.approx(step)
    assert is_last.tolist() == [last]
