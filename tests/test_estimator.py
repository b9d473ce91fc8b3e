"""The robust estimator of log k against dense Gaussian algebra, its laws and its breakdown."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imgscale.core.estimator import disagree, fit_robust, log_k_std, view_from_others
from imgscale.core.predictive import fused
from imgscale.core.segments import MIN_VARIANCE, LogObservations, Parts, Subjects
from imgscale.core.solving import Problem, solve
from imgscale.core.witnesses import Sized

TUKEY_C = 4.685
Z90 = 1.6448536269514722


def observations(y, variance, tau, group, image=None, firm=None):
    return LogObservations(
        y=np.asarray(y, dtype=np.float64),
        variance=np.asarray(variance, dtype=np.float64),
        tau=np.asarray(tau, dtype=np.float64),
        image=np.zeros(len(y), dtype=np.intp) if image is None else np.asarray(image),
        group=np.asarray(group, dtype=np.intp),
        firm=np.zeros(len(y), dtype=np.bool_) if firm is None else np.asarray(firm),
    )


def random_image(rng, labels=(3, 2, 1), residual=1.0):
    """References of several labels about log k = -6, off by `residual` standard deviations."""
    group = np.repeat(np.arange(len(labels)), labels)
    tau = rng.uniform(0.0, 0.1, len(labels))[group]
    variance = rng.uniform(0.02, 0.2, group.size) ** 2
    offset = rng.normal(size=len(labels))[group] * tau
    noise = offset + rng.normal(size=group.size) * np.sqrt(variance)
    return observations(-6.0 + residual * noise, variance, tau, group)


def dense_covariance(obs, variance):
    """Covariance of y about log k: own noise, and the offset that a label's references share."""
    same_label = obs.group[:, None] == obs.group[None, :]
    return np.diag(variance) + same_label * np.outer(obs.tau, obs.tau)


def generalised_least_squares(y, covariance):
    ones = np.ones(y.size)
    inverse = np.linalg.inv(covariance)
    precision = ones @ inverse @ ones
    return ones @ inverse @ y / precision, 1 / precision, inverse @ ones / precision


def dense_posterior(obs, weight, keep, label_tau, label):
    """
    Posterior of (log k, u of one label) from the kept references by whitened least squares.

    Unknowns: log k (flat) and the offset u of every label, N(0, tau^2); `label` may be new.
    """
    taus = dict(zip(obs.group.tolist(), obs.tau, strict=True)) | {label: label_tau}
    columns = {group: 1 + place for place, group in enumerate(taus)}
    rows, right = [], []
    for group, tau in taus.items():
        row = np.zeros(1 + len(taus))
        row[columns[group]] = 1 / tau
        rows.append(row)
        right.append(0.0)
    for i in np.flatnonzero(keep):
        row = np.zeros(1 + len(taus))
        row[0] = row[columns[int(obs.group[i])]] = math.sqrt(weight[i])
        rows.append(row)
        right.append(obs.y[i] * math.sqrt(weight[i]))
    design = np.array(rows)
    covariance = np.linalg.inv(design.T @ design)
    mean = covariance @ design.T @ np.array(right)
    pick = [0, columns[label]]
    return mean[pick], covariance[np.ix_(pick, pick)]


# --- consistent and noisy data -----------------------------------------------------------------


def test_consistent_references_give_their_common_log_k():
    obs = observations([-6.25] * 4, [0.01, 0.02, 0.5, 0.003], [0.1, 0.1, 0, 0.2], [0, 0, 1, 2])
    assert fit_robust(obs).log_k[0] == pytest.approx(-6.25, abs=1e-14)


@pytest.mark.parametrize("seed", range(6))
def test_small_residuals_reproduce_generalised_least_squares(seed):
    # residuals of 1e-4 standard deviations: Tukey's weights differ from 1 by 1e-9
    obs = random_image(np.random.default_rng(seed), residual=1e-4)
    fitted = fit_robust(obs)
    mean, variance, share = generalised_least_squares(obs.y, dense_covariance(obs, obs.variance))
    assert fitted.log_k[0] == pytest.approx(mean, abs=1e-11)
    assert fitted.log_std[0] == pytest.approx(math.sqrt(variance), rel=1e-7)
    np.testing.assert_allclose(fitted.share, share, rtol=1e-6)
    assert not disagree(obs)[0]


@pytest.mark.parametrize("labels", [(4, 3, 1), (1, 1), (1, 1, 1), (6,)], ids=str)
@pytest.mark.parametrize("residual", [1.0, 4.0], ids=["honest", "contradicting"])
@pytest.mark.parametrize("seed", range(3))
def test_log_k_is_the_dense_solution_of_tukeys_weights(seed, residual, labels):
    obs = random_image(np.random.default_rng(seed), labels=labels, residual=residual)
    fitted = fit_robust(obs)
    # the variance that each reference was given: declared, and an excess common to all
    variance = np.divide(
        fitted.trust, fitted.weight, out=obs.variance.copy(), where=fitted.weight > 0
    )
    excess = (variance - obs.variance)[fitted.weight > 0]
    assert np.ptp(excess) <= 1e-12
    assert excess.min() >= -1e-15
    variance = obs.variance + max(0.0, excess[0])

    r = (obs.y - fitted.log_k[0]) / (TUKEY_C * np.sqrt(variance + obs.tau**2))
    biweight = np.where(np.abs(r) < 1, (1 - r**2) ** 2, 0.0)
    np.testing.assert_allclose(fitted.trust, biweight, atol=1e-9)

    kept = fitted.weight > 0
    small = observations(obs.y[kept], variance[kept], obs.tau[kept], obs.group[kept])
    mean, _, share = generalised_least_squares(
        small.y, dense_covariance(small, 1 / fitted.weight[kept])
    )
    assert fitted.log_k[0] == pytest.approx(mean, abs=1e-10)
    np.testing.assert_allclose(fitted.share[kept], share, rtol=1e-8, atol=1e-12)
    assert np.all(fitted.share[~kept] == 0)

    propagated = share @ dense_covariance(small, variance[kept]) @ share
    assert fitted.log_std[0] == pytest.approx(math.sqrt(propagated), rel=1e-9)


def test_log_k_std_takes_any_shares():
    obs = random_image(np.random.default_rng(7))
    share = np.full(6, 1 / 6)
    variance = share @ dense_covariance(obs, obs.variance) @ share
    assert log_k_std(obs, share)[0] == pytest.approx(math.sqrt(variance), rel=1e-12)


# --- the label's shared offset -----------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 2, 10, 1000])
def test_references_of_one_label_weigh_no_more_than_its_mean_is_known(count):
    spread, tau = 0.08, 0.05
    obs = observations([-6.0] * count, [spread**2] * count, [tau] * count, [0] * count)
    total_weight = count / spread**2
    assert fit_robust(obs).log_std[0] ** -2 == pytest.approx(
        1 / (1 / total_weight + tau**2), rel=1e-12
    )


def test_ten_cars_and_one_door_weigh_as_two_labels():
    spread, tau, door = 0.08, 0.05, 0.06
    obs = observations(
        [-6.0] * 11, [spread**2] * 10 + [door**2], [tau] * 10 + [0.0], [0] * 10 + [1]
    )
    car_information = 1 / (spread**2 / 10 + tau**2)
    fitted = fit_robust(obs)
    assert fitted.log_std[0] ** -2 == pytest.approx(car_information + door**-2, rel=1e-12)
    assert fitted.share[-1] == pytest.approx(door**-2 / (door**-2 + car_information), rel=1e-12)


def test_more_references_of_a_label_never_widen_the_result():
    widths = [
        fit_robust(observations([-6.0] * n, [0.01] * n, [0.05] * n, [0] * n)).log_std[0]
        for n in range(1, 20)
    ]
    assert np.all(np.diff(widths) < 0)
    assert widths[-1] > 0.05


# --- laws --------------------------------------------------------------------------------------


@given(seed=st.integers(0, 2**32 - 1), shift=st.floats(-20, 20))
@settings(max_examples=40, deadline=None)
def test_shifting_every_y_shifts_log_k(seed, shift):
    obs = random_image(np.random.default_rng(seed))
    moved = observations(obs.y + shift, obs.variance, obs.tau, obs.group)
    a, b = fit_robust(obs), fit_robust(moved)
    assert b.log_k[0] - a.log_k[0] == pytest.approx(shift, abs=1e-9)
    assert b.log_std[0] == pytest.approx(a.log_std[0], rel=1e-8)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_the_order_of_references_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    obs = random_image(rng)
    order = rng.permutation(obs.y.size)
    fitted = fit_robust(obs)
    again = fit_robust(
        observations(obs.y[order], obs.variance[order], obs.tau[order], obs.group[order])
    )
    assert again.log_k[0] == pytest.approx(fitted.log_k[0], abs=1e-9)
    assert again.log_std[0] == pytest.approx(fitted.log_std[0], rel=1e-8)
    np.testing.assert_allclose(again.share, fitted.share[order], atol=1e-8)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_mirrored_residuals_mirror_the_estimate(seed):
    obs = random_image(np.random.default_rng(seed))
    mirrored = observations(-12.0 - obs.y, obs.variance, obs.tau, obs.group)
    a, b = fit_robust(obs), fit_robust(mirrored)
    assert b.log_k[0] == pytest.approx(-12.0 - a.log_k[0], abs=1e-9)
    assert b.log_std[0] == pytest.approx(a.log_std[0], rel=1e-8)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_many_images_at_once_equal_each_image_alone(seed):
    rng = np.random.default_rng(seed)
    shapes = [tuple(rng.integers(1, 5, rng.integers(1, 4))) for _ in range(7)]
    images = [random_image(rng, labels=shape, residual=1.5) for shape in shapes]
    first_group = np.cumsum([0] + [len(shape) for shape in shapes])
    rows = rng.permutation(sum(obs.y.size for obs in images))  # images interleave
    together = observations(
        np.concatenate([obs.y for obs in images])[rows],
        np.concatenate([obs.variance for obs in images])[rows],
        np.concatenate([obs.tau for obs in images])[rows],
        np.concatenate([obs.group + first_group[i] for i, obs in enumerate(images)])[rows],
        np.concatenate([np.full(obs.y.size, i) for i, obs in enumerate(images)])[rows],
    )
    fitted = fit_robust(together)
    alone = [fit_robust(obs) for obs in images]
    np.testing.assert_allclose(fitted.log_k, [one.log_k[0] for one in alone], atol=1e-9)
    np.testing.assert_allclose(fitted.log_std, [one.log_std[0] for one in alone], rtol=1e-7)
    np.testing.assert_allclose(np.bincount(together.image, fitted.share), 1.0, rtol=1e-12)


def test_a_reference_of_the_smallest_error_is_believed_and_stays_finite():
    fitted = fit_robust(observations([-6.0, -5.9], [MIN_VARIANCE, 0.1**2], [0.0, 0.0], [0, 1]))
    assert fitted.log_k[0] == pytest.approx(-6.0, abs=1e-9)
    assert 0 < fitted.log_std[0] <= 1e-6
    assert np.all(np.isfinite(fitted.weight))


# --- outliers and contradictions ---------------------------------------------------------------


@pytest.mark.parametrize("count", [3, 4, 5, 9])
@pytest.mark.parametrize("gross", [-4.0, -0.9, 0.9, 4.0])
def test_one_gross_outlier_among_three_or_more_changes_k_by_less_than_a_percent(count, gross):
    good = -6.0 + 0.02 * np.linspace(-1, 1, count - 1)
    variance, group = np.full(count, 0.06**2), np.arange(count)
    clean = fit_robust(observations(good, variance[1:], np.zeros(count - 1), group[1:]))
    dirty = fit_robust(observations([-6.0 + gross, *good], variance, np.zeros(count), group))
    assert dirty.weight[0] == 0
    assert np.all(dirty.weight[1:] > 0)
    assert dirty.log_k[0] == pytest.approx(clean.log_k[0], abs=0.01)


@pytest.mark.parametrize("bad", [(0.8, 0.9), (-3.0, 2.0), (1.0, 1.0)], ids=str)
def test_two_bad_references_of_five_are_rejected(bad):
    y = -6.0 + np.array([-0.03, 0.0, 0.03, *bad])
    fitted = fit_robust(observations(y, np.full(5, 0.06**2), np.zeros(5), np.arange(5)))
    assert fitted.log_k[0] == pytest.approx(-6.0, abs=0.01)
    assert fitted.weight[3:].tolist() == [0, 0]


@pytest.mark.parametrize("gap", [0.5, 1.0, 2.5])
@pytest.mark.parametrize(
    "stds",
    [
        pytest.param((0.06, 0.06), id="equal errors"),
        pytest.param((0.05, 0.07), id="nearly equal errors"),
        pytest.param((0.03, 0.09), id="errors 1 to 3"),
    ],
)
def test_the_interval_of_two_contradicting_references_holds_both(gap, stds):
    y = np.array([-6.0, -6.0 + gap])
    obs = observations(y, np.square(stds), [0, 0], [0, 1])
    fitted = fit_robust(obs)
    half_width = Z90 * fitted.log_std[0]
    assert np.all(np.abs(y - fitted.log_k[0]) <= half_width)
    assert disagree(obs)[0]


def test_contradicting_references_of_equal_errors_meet_in_the_middle():
    fitted = fit_robust(observations([-6.0, -4.0], [0.01, 0.01], [0, 0], [0, 1]))
    assert fitted.log_k[0] == pytest.approx(-5.0, abs=1e-12)


def test_honest_scatter_of_many_references_does_not_widen_the_result():
    rng = np.random.default_rng(11)
    for _ in range(20):
        obs = random_image(rng, labels=(5, 5, 5))
        fitted = fit_robust(obs)
        np.testing.assert_allclose(fitted.weight, fitted.trust / obs.variance, rtol=1e-12)
        assert not disagree(obs)[0]


def test_ninety_percent_intervals_of_k_cover_ninety_percent():
    rng = np.random.default_rng(20261122)
    images = 4000
    sizes = rng.integers(1, 7, images)
    image = np.repeat(np.arange(images), sizes)
    label = rng.integers(0, 3, image.size)
    group = np.unique(image * 3 + label, return_inverse=True)[1]
    tau = np.array([0.02, 0.05, 0.08])[label]
    std = np.array([0.04, 0.08, 0.12])[label]
    offset = rng.normal(size=group.max() + 1)[group] * tau
    obs = observations(offset + rng.normal(size=image.size) * std, std**2, tau, group, image)
    fitted = fit_robust(obs)
    covered = np.mean(np.abs(fitted.log_k) <= Z90 * fitted.log_std)
    assert 0.87 <= covered <= 0.93  # 0.5 % is the binomial standard error


# --- what the others say -----------------------------------------------------------------------


def weighted(obs, weight):
    """The fit of `obs` whose references kept the precisions `weight`."""
    return fit_robust(obs)._replace(weight=weight)


def one_subject(*, group, tau, own=-1):
    return Subjects(
        image=np.zeros(1, dtype=np.intp),
        group=np.array([group], dtype=np.intp),
        tau=np.array([tau]),
        own=np.array([own], dtype=np.intp),
    )


def assert_view_equals(view, mean, covariance):
    assert all(column.shape == (1, 1) for column in view)
    assert view.log_k[0, 0] == pytest.approx(mean[0], abs=1e-9)
    assert view.offset[0, 0] == pytest.approx(mean[1], abs=1e-9)
    assert view.log_k_var[0, 0] == pytest.approx(covariance[0, 0], rel=1e-8)
    assert view.offset_var[0, 0] == pytest.approx(covariance[1, 1], rel=1e-8)
    assert view.covariance[0, 0] == pytest.approx(covariance[0, 1], rel=1e-8, abs=1e-14)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("reference", range(6))
def test_a_reference_sees_the_posterior_of_all_others(seed, reference):
    obs = random_image(np.random.default_rng(seed))
    weight = np.random.default_rng(seed + 100).uniform(0.2, 1.0, 6) / obs.variance
    group, tau = int(obs.group[reference]), float(obs.tau[reference])
    view = view_from_others(
        obs, weighted(obs, weight), one_subject(group=group, tau=tau, own=reference)
    )
    keep = np.arange(6) != reference
    assert_view_equals(view, *dense_posterior(obs, weight, keep, tau, group))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("group", [0, 1, 2, -1], ids=["label 0", "label 1", "label 2", "new label"])
def test_a_new_object_sees_the_posterior_of_all_references(seed, group):
    obs = random_image(np.random.default_rng(seed))
    weight = 1 / obs.variance
    tau = 0.07 if group < 0 else float(obs.tau[obs.group == group][0])
    view = view_from_others(obs, weighted(obs, weight), one_subject(group=group, tau=tau))
    assert_view_equals(view, *dense_posterior(obs, weight, np.ones(6, dtype=bool), tau, group))


def test_without_another_reference_nothing_is_known_of_k_and_the_prior_of_the_offset():
    obs = observations([-6.0], [0.01], [0.05], [0])
    subject = one_subject(group=0, tau=0.05, own=0)
    view = view_from_others(obs, weighted(obs, 1 / obs.variance), subject)
    assert math.isnan(view.log_k[0, 0])
    found = (view.offset[0, 0], view.offset_var[0, 0], view.covariance[0, 0])
    assert found == (0, 0.05**2, 0)


def test_subjects_of_several_images_are_seen_from_their_own():
    rng = np.random.default_rng(5)
    a, b = random_image(rng), random_image(rng, labels=(2, 2))
    both = observations(
        np.r_[a.y, b.y], np.r_[a.variance, b.variance], np.r_[a.tau, b.tau],
        np.r_[a.group, b.group + 3], np.r_[np.zeros(6, int), np.ones(4, int)],
    )  # fmt: skip
    subjects = Subjects(
        image=np.array([1, 0]), group=np.array([4, -1]), tau=np.array([b.tau[2], 0.03]),
        own=np.array([-1, -1]),
    )  # fmt: skip
    view = view_from_others(both, weighted(both, 1 / both.variance), subjects)
    in_b, _ = dense_posterior(b, 1 / b.variance, np.ones(4, dtype=bool), float(b.tau[2]), 1)
    in_a, _ = dense_posterior(a, 1 / a.variance, np.ones(6, dtype=bool), 0.03, -1)
    np.testing.assert_allclose(view.log_k[:, 0], [in_b[0], in_a[0]], rtol=1e-9)
    np.testing.assert_allclose(view.offset[:, 0], [in_b[1], in_a[1]], atol=1e-9)


# --- fusing with the own prior -----------------------------------------------------------------


def objects(prior_log, prior_var, log_size, noise_var, tau, group):
    """Objects of one image with a told noise and one kind for each label."""
    prior_log, prior_var, log_size, noise_var, tau = (
        np.asarray(column, dtype=np.float64)
        for column in (prior_log, prior_var, log_size, noise_var, tau)
    )
    count = prior_log.size
    return Sized(
        inverse_depth=np.exp(-log_size), log_pixels=np.zeros(count), noise_var=noise_var,
        prior=Parts(np.ones((count, 1)), prior_log[:, None], prior_var[:, None]),
        prior_log=prior_log, prior_var=prior_var, tau=tau, image=np.zeros(count, dtype=np.intp),
        group=np.asarray(group, dtype=np.intp), told=np.ones(count, dtype=np.bool_),
        firm=np.zeros(count, dtype=np.bool_),
    )  # fmt: skip


def solved(witnesses):
    """Solve an image by the robust method: one case."""
    problem = Problem(witnesses, n_images=1, has_shift=False, unknown_noise=False, exact=False)
    return solve(problem)


def random_objects(rng, residual=1.0):
    """References as `random_image` makes them, their variance shared by prior and noise."""
    obs = random_image(rng, residual=residual)
    share, log_size = rng.uniform(0.1, 0.9, obs.y.size), rng.uniform(5.0, 8.0, obs.y.size)
    return objects(
        obs.y + log_size, share * obs.variance, log_size, (1 - share) * obs.variance, obs.tau,
        obs.group,
    )  # fmt: skip


def fused_one(cases, subject, own=-1):
    """Mean and variance of the one Gaussian that `fused` gives of an object."""
    mixture = fused(cases, subject, np.array([own], dtype=np.intp))
    assert mixture.weight.tolist() == [[1.0]]
    return mixture.mean[0, 0], mixture.variance[0, 0]


def joint_gaussian(subject, mean, cov):
    """Condition log H on the measurement, given mean and covariance of (log k, u)."""
    log_k, u = mean
    prior_log, prior_var = subject.prior_log[0], subject.prior_var[0]
    log_size, noise_var = -np.log(subject.inverse_depth[0]), subject.noise_var[0]
    # joint Gaussian of (log H, d), H the size and d = log H - log k - log_size the misclosure of
    # the measurement, observed to be 0: log H = prior_log - u + individual deviation
    to_h, to_d = np.array([0.0, -1.0]), np.array([-1.0, -1.0])
    var_h = to_h @ cov @ to_h + prior_var
    var_d = to_d @ cov @ to_d + prior_var + noise_var
    cov_hd = to_h @ cov @ to_d + prior_var
    mean_h, mean_d = prior_log - u, prior_log - u - log_k - log_size
    return mean_h - cov_hd / var_d * mean_d, var_h - cov_hd**2 / var_d


@pytest.mark.parametrize("residual", [1e-3, 1.0, 4.0], ids=["exact", "honest", "contradicting"])
@pytest.mark.parametrize("group", [0, 1, 2, -1], ids=["label 0", "label 1", "label 2", "new label"])
@pytest.mark.parametrize("seed", range(5))
def test_fusing_equals_the_conditional_of_the_joint_gaussian(seed, group, residual):
    rng = np.random.default_rng(seed)
    cases = solved(random_objects(rng, residual))
    obs, weight = cases.obs, cases.fit.weight
    tau = 0.07 if group < 0 else float(obs.tau[obs.group == group][0])
    subject = objects([0.5], [0.08**2], [6.45], [0.05**2], [tau], [group])
    found = fused_one(cases, subject)
    expected = joint_gaussian(
        subject, *dense_posterior(obs, weight, np.ones(6, dtype=bool), tau, group)
    )
    assert found[0] == pytest.approx(expected[0], abs=1e-9)
    assert found[1] == pytest.approx(expected[1], rel=1e-8)


@pytest.mark.parametrize("reference", range(6))
@pytest.mark.parametrize("seed", range(3))
def test_fusing_a_reference_takes_its_prior_from_all_others(seed, reference):
    witnesses = random_objects(np.random.default_rng(seed))
    cases = solved(witnesses)
    group, tau = int(witnesses.group[reference]), float(witnesses.tau[reference])
    subject = witnesses.rows(np.array([reference]))
    found = fused_one(cases, subject, own=reference)
    keep = np.arange(6) != reference
    expected = joint_gaussian(
        subject, *dense_posterior(cases.obs, cases.fit.weight, keep, tau, group)
    )
    assert found[0] == pytest.approx(expected[0], abs=1e-9)
    assert found[1] == pytest.approx(expected[1], rel=1e-8)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_fusing_is_never_wider_than_prior_or_measurement_alone(seed):
    rng = np.random.default_rng(seed)
    cases = solved(random_objects(rng))
    obs, group = cases.obs, int(rng.integers(-1, 3))
    tau = 0.06 if group < 0 else float(obs.tau[obs.group == group][0])
    prior_var, noise_var = rng.uniform(0.0, 0.2, 2) ** 2
    mean, variance = fused_one(
        cases, objects([0.0], [prior_var], [6.0], [noise_var], [tau], [group])
    )
    view = view_from_others(obs, cases.fit, one_subject(group=group, tau=tau))
    assert math.isfinite(mean)
    assert -1e-15 <= variance <= (prior_var + tau**2) * (1 + 1e-9) + 1e-15
    assert variance <= (view.log_k_var[0, 0] + noise_var) * (1 + 1e-9)


@pytest.mark.parametrize(
    ("others", "log_size"),
    [
        pytest.param(False, 6.0, id="no other reference"),
        pytest.param(True, math.nan, id="no depth"),
    ],
)
def test_fusing_nothing_leaves_the_prior_alone(others, log_size):
    labels = [0, 0, 1] if others else [0]
    witnesses = objects(
        0.4 + 0.05 * np.arange(len(labels)), np.full(len(labels), 0.1**2), [6.4] * len(labels),
        [0.05**2] * len(labels), [0.03] * len(labels), labels,
    )  # fmt: skip
    cases = solved(witnesses)
    subject = objects([0.4], [0.1**2], [log_size], [0.05**2], [0.03], [0])
    mean, variance = fused_one(cases, subject, own=-1 if others else 0)
    keep = np.full(len(labels), others)
    (_, u), covariance = (
        dense_posterior(cases.obs, cases.fit.weight, keep, 0.03, 0)
        if others
        else ((0.0, 0.0), np.diag([math.inf, 0.03**2]))
    )
    assert mean == pytest.approx(0.4 - u, abs=1e-12)
    assert variance == pytest.approx(0.1**2 + covariance[1, 1], rel=1e-9)
