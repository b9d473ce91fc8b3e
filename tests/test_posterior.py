"""The posterior on a grid against brute-force quadrature of the model as it is written down."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy import interpolate, optimize, special

from imgscale.core.posterior import believe, fit_grid, log_evidence, view_on_grid
from imgscale.core.predictive import scale_of
from imgscale.core.segments import LogObservations, Parts, Subjects
from imgscale.core.solving import Problem, solve
from imgscale.core.witnesses import Sized

ONE_SIGMA = (0.15865525393145707, 0.8413447460685429)


# --- the model, written a second time ----------------------------------------------------------


def normal(residual, variance):
    return np.exp(-0.5 * residual**2 / variance) / np.sqrt(2 * math.pi * variance)


def laplace(residual, variance):
    scale = np.sqrt(variance / 2)
    return np.exp(-np.abs(residual) / scale) / (2 * scale)


def likelihoods(obs, row, v):
    """Likelihood of one reference as a function of v = log k + u: of each kind, and if wrong."""
    part = obs.kinds
    share = part.share[row] * (1.0 if obs.firm[row] else 0.95)
    kinds = [
        share[j] * normal(part.mean[row, j] - v, part.variance[row, j]) for j in range(share.size)
    ]
    residual, variance = obs.y[row] - v, obs.variance[row]
    wrong = 0.02 * laplace(residual, variance + 0.5**2)
    wrong = wrong + 0.03 * normal(residual - 0.4, variance + 0.25**2)
    return np.array(kinds), np.zeros_like(v) if obs.firm[row] else wrong


class Quadrature:
    """Sums over dense grids of log k and of every label's offset, for one image."""

    def __init__(self, obs, rows=None, x=None):
        rows = range(obs.y.size) if rows is None else rows
        used = obs.kinds.share > 0
        finest = math.sqrt(obs.kinds.variance[used].min() / obs.y.size)
        means = obs.kinds.mean[used]
        low, high = means.min() - 4, means.max() + 4
        if obs.firm.any():  # nothing is possible elsewhere
            std = math.sqrt(obs.variance[obs.firm].min())
            middle = obs.y[obs.firm].mean()
            low, high = max(low, middle - 12 * std), min(high, middle + 12 * std)
        # sums over smooth functions need few points, quantiles and the eye more
        self.x = np.linspace(low, high, math.ceil((high - low) / (finest / 6)) + 1)
        self.x = self.x if x is None else x
        self.dx = self.x[1] - self.x[0]
        self.u, self.prior, self.joint, self.terms = {}, {}, {}, {}
        for group in np.unique(obs.group):
            tau = obs.tau[obs.group == group][0]
            count = 1 if tau == 0 else max(61, math.ceil(14 * tau / (finest / 3)))
            u = np.linspace(-7 * tau, 7 * tau, count)
            prior = np.exp(-0.5 * (u / max(tau, 1e-300)) ** 2)
            self.u[group], self.prior[group] = u, prior / prior.sum()
            v = self.x[:, None] + u
            joint = np.broadcast_to(self.prior[group], v.shape)
            for row in np.flatnonzero(obs.group == group):
                kinds, wrong = likelihoods(obs, row, v)
                self.terms[row] = kinds / np.maximum(kinds.sum(axis=0) + wrong, 1e-300)
                if row in rows:
                    joint = joint * (kinds.sum(axis=0) + wrong)
            self.joint[group] = joint
        self.group = obs.group
        self.density = np.prod([joint.sum(axis=1) for joint in self.joint.values()], axis=0)
        self.evidence = self.density.sum() * self.dx

    def mean(self, group, function):
        """Expectation of a function of log k and of the offset of one label."""
        others = [j.sum(axis=1) for g, j in self.joint.items() if g != group]
        weight = self.joint[group] * np.prod(others, axis=0)[..., None]
        return (weight * function).sum() / weight.sum()

    def moments(self, group):
        """Means, variances and covariance of log k and of the offset of one label."""
        x, u = self.x[:, None], self.u[group]
        mean_x, mean_u = self.mean(group, x + 0 * u), self.mean(group, 0 * x + u)
        return np.array([
            mean_x,
            self.mean(group, (x - mean_x) ** 2 + 0 * u),
            mean_u,
            self.mean(group, (u - mean_u) ** 2 + 0 * x),
            self.mean(group, (x - mean_x) * (u - mean_u)),
        ])  # fmt: skip

    def kinds(self, row):
        """Probability that a reference is sound and of each kind."""
        return np.array([self.mean(self.group[row], term) for term in self.terms[row]])

    @property
    def log_k(self):
        return (self.density * self.x).sum() / self.density.sum()

    @property
    def std(self):
        squares = self.density * (self.x - self.log_k) ** 2
        return math.sqrt(squares.sum() / self.density.sum())

    def below(self, value):
        """Probability that log k is less than a value."""
        below = interpolate.CubicSpline(self.x, self.density).antiderivative()
        return float(below(value) / below(self.x[-1]))

    def quantile(self, probability):
        below = interpolate.CubicSpline(self.x, self.density).antiderivative()
        total = float(below(self.x[-1]))
        return optimize.brentq(lambda x: below(x) / total - probability, self.x[0], self.x[-1])

    @property
    def half_width(self):
        low, high = (self.quantile(probability) for probability in ONE_SIGMA)
        return (high - low) / 2


# --- cases -------------------------------------------------------------------------------------


def observations(parts, tau, group, *, image=None, firm=None):
    """Columns from lists of kinds (share, mean, std), one list for each reference."""
    width = max(len(kinds) for kinds in parts)
    columns = np.zeros((3, len(parts), width))
    y, variance = np.zeros(len(parts)), np.zeros(len(parts))
    for row, kinds in enumerate(parts):
        share, mean, std = np.array(kinds, dtype=np.float64).T
        columns[:, row, : len(kinds)] = share, mean, std**2
        y[row] = share @ mean
        variance[row] = share @ (std**2 + (mean - y[row]) ** 2)
    columns[1:, columns[0] == 0] = np.array([[7.0], [1e-3]])  # fills, that must not be looked at
    n = len(parts)
    return LogObservations(
        y=y,
        variance=variance,
        tau=np.asarray(tau, dtype=np.float64)[np.asarray(group)],
        image=np.zeros(n, dtype=np.intp) if image is None else np.asarray(image, dtype=np.intp),
        group=np.asarray(group, dtype=np.intp),
        firm=np.zeros(n, dtype=np.bool_) if firm is None else np.asarray(firm, dtype=np.bool_),
        mixture=Parts(*columns),
    )


def random_image(seed, labels, n_kinds, tau, outlier):
    """References about log k = -6; the last one is off by 0.8 where there is an outlier."""
    rng = np.random.default_rng(seed)
    group = np.repeat(np.arange(len(labels)), labels)
    taus = np.full(len(labels), tau) * rng.uniform(0.7, 1.4, len(labels))
    offset = rng.normal(size=len(labels)) * taus
    parts = []
    for row in range(group.size):
        shares = rng.dirichlet(np.full(n_kinds, 4.0))
        places = np.array([0.0, -0.35, 0.2])[:n_kinds]
        places = places - places[rng.choice(n_kinds, p=shares)]
        std = rng.uniform(0.04, 0.2)
        seen = -6 + offset[group[row]] + std * rng.normal() + places
        if outlier and row == group.size - 1:
            seen = seen + 0.8
        parts.append([(s, m, std) for s, m in zip(shares, seen, strict=True)])
    return observations(parts, taus, group)


CASES = {
    f"{'+'.join(map(str, labels))} of {kinds} kinds, tau {tau}{', an outlier' * outlier}": (
        labels,
        kinds,
        tau,
        outlier,
    )
    for labels, kinds, tau, outlier in [
        ((1,), 1, 0.0, False),
        ((1,), 3, 0.05, False),
        ((2,), 1, 0.03, False),
        ((1, 1), 1, 0.002, False),
        ((1, 1), 2, 0.3, False),
        ((2, 1), 1, 0.05, True),
        ((2, 1), 3, 0.05, False),
        ((1, 2), 2, 0.0, True),
        ((2, 2), 1, 0.0, False),
        ((2, 2), 2, 0.002, True),
        ((3, 1), 1, 0.3, True),
        ((3, 1), 3, 0.1, False),
        ((4,), 1, 0.02, True),
        ((4,), 2, 0.1, False),
    ]
}


def named_cases():
    cases = {
        name: random_image(seed, *options) for seed, (name, options) in enumerate(CASES.items())
    }
    conflict = [[(1, -6.0, 0.05)], [(1, -5.2, 0.07)]]
    cases["two that conflict"] = observations(conflict, [0.02, 0.04], [0, 1])
    cases["two of one label that conflict"] = observations(conflict, [0.04], [0, 0])
    camera = [[(1, -6.0, 0.1)], [(0.7, -5.9, 0.1), (0.3, -6.3, 0.08)], [(1, -6.05, 0.05)]]
    cases["a camera and two"] = observations(
        camera, [0.03, 0.0], [0, 0, 1], firm=[False, False, True]
    )
    far = [[(1, -6.0, 0.1)], [(1, -5.0, 0.1)], [(1, -5.5, 0.15)]]
    cases["a camera far from both"] = observations(
        far, [0.05, 0.05, 0.0], [0, 1, 2], firm=[False, False, True]
    )
    cases["a camera alone"] = observations([[(1, -7.0, 0.03)]], [0.0], [0], firm=[True])
    return cases


GAP = "two of one label that conflict"
IMAGES = named_cases()


@pytest.fixture(scope="module", params=IMAGES.values(), ids=IMAGES.keys())
def image(request):
    obs = request.param
    return obs, fit_grid(obs), Quadrature(obs)


def grid_weight(grid):
    _, log_density = grid.on_grid(0)
    weight = np.exp(log_density - log_density.max())
    return weight / weight.sum()


def subjects(group, tau, own):
    """Rows of image 0."""
    group, own = np.atleast_1d(group), np.atleast_1d(own)
    tau = np.broadcast_to(np.asarray(tau, dtype=np.float64), group.shape)
    return Subjects(np.zeros(group.size, dtype=np.intp), group, tau, own)


def view_moments(view, row=0):
    """Means, variances and covariance of log k and u of one row's mixture."""
    columns = [column[row] for column in view]
    weight = np.exp(columns[0] - columns[0].max())
    weight /= weight.sum()
    x, u = weight @ columns[1], weight @ columns[3]
    return np.array([
        x,
        weight @ (columns[2] + (columns[1] - x) ** 2),
        u,
        weight @ (columns[4] + (columns[3] - u) ** 2),
        weight @ (columns[5] + (columns[1] - x) * (columns[3] - u)),
    ])  # fmt: skip


def assert_moments_agree(found, expected, tolerance=5e-3):
    """Means to a fraction of the standard deviations, the covariance matrix likewise."""
    std_x = math.sqrt(expected[1])
    # an offset that is much less than the error of log k need be known no better than that
    std_u = max(math.sqrt(expected[3]), 0.3 * std_x)
    units = np.array([std_x, std_x**2, std_u, std_u**2, std_x * std_u])
    np.testing.assert_allclose((found - expected) / units, 0, atol=tolerance)


def as_witnesses(obs):
    """The same references as `imgscale.core.solving` takes them, with d p = 1."""
    n = obs.y.size
    return Sized(
        inverse_depth=np.ones(n),
        log_pixels=np.zeros(n),
        noise_var=np.zeros(n),
        prior=obs.kinds,
        prior_log=obs.y,
        prior_var=obs.variance,
        tau=obs.tau,
        image=obs.image,
        group=obs.group,
        told=np.ones(n, dtype=np.bool_),
        firm=obs.firm,
    )


def scale_quantiles(obs):
    problem = Problem(as_witnesses(obs), obs.n_images, False, False, True)  # noqa: FBT003
    return scale_of(solve(problem)).quantiles()


# --- density and its summaries -----------------------------------------------------------------


def test_the_density_of_log_k_is_that_of_the_written_model(image):
    obs, grid, truth = image
    x, _ = grid.on_grid(0)
    expected = Quadrature(obs, x=x).density / truth.evidence
    found = grid_weight(grid) / (x[1] - x[0])
    np.testing.assert_allclose(found / expected.max(), expected / expected.max(), atol=2e-3)


def test_the_evidence_is_the_integral_of_the_written_model(image):
    obs, grid, truth = image
    # the library leaves the factor 1 / sqrt(2 pi) of every reference out
    found = log_evidence(grid)[0] - obs.y.size * math.log(2 * math.pi) / 2
    assert found == pytest.approx(math.log(truth.evidence), abs=1e-3)


def test_mean_and_standard_deviation_of_log_k_are_those_of_the_written_model(image):
    obs, grid, truth = image
    weight = grid_weight(grid)
    x, _ = grid.on_grid(0)
    mean = weight @ x
    std = math.sqrt(weight @ (x - mean) ** 2)
    assert (mean - truth.log_k) / truth.std == pytest.approx(0, abs=1e-3)
    assert std == pytest.approx(truth.std, rel=2e-3)
    assert believe(obs, grid)[0].log_std[0] == pytest.approx(truth.std, rel=2e-3)


def test_the_reported_quantiles_of_log_k_are_those_of_the_written_model(image):
    obs, _, truth = image
    found = scale_quantiles(obs)[0]
    # compared as probabilities: between two modes a quantile hangs on next to nothing
    for place, score in ((10, -1), (14, 0), (18, 1)):
        assert truth.below(found[place]) == pytest.approx(special.ndtr(score), abs=3e-3)


@pytest.mark.parametrize("name", [name for name in IMAGES if name != GAP])
def test_the_standard_error_of_log_k_is_that_of_the_written_model(name):
    # between the two modes of the one left out it hangs on next to nothing
    obs = IMAGES[name]
    found = scale_quantiles(obs)[0]
    assert (found[18] - found[10]) / 2 == pytest.approx(Quadrature(obs).half_width, rel=1e-3)


def test_the_probability_of_every_kind_is_that_of_the_written_model(image):
    obs, grid, truth = image
    summary, kinds = believe(obs, grid)
    expected = np.array([truth.kinds(row) for row in range(obs.y.size)])
    np.testing.assert_allclose(kinds, expected, atol=1e-3)
    np.testing.assert_allclose(summary.trust, expected.sum(axis=1), atol=1e-3)


def test_a_new_object_of_a_known_label_sees_log_k_and_offset_as_the_written_model(image):
    obs, grid, truth = image
    groups = np.unique(obs.group)
    tau = obs.of_groups()[1][groups]
    view = view_on_grid(grid, subjects(groups, tau, np.full(groups.size, -1)))
    for row, group in enumerate(groups):
        assert_moments_agree(view_moments(view, row), truth.moments(group))
        total = np.exp(view.log_weight[row] - log_evidence(grid)[0]).sum()
        assert total == pytest.approx(1, abs=1e-3)  # the weights hold the evidence


@pytest.mark.parametrize("tau", [0.0, 0.03, 0.1])
def test_a_new_label_sees_log_k_with_an_offset_of_its_own(image, tau):
    _, grid, truth = image
    view = view_on_grid(grid, subjects(-1, tau, -1))
    expected = np.array([truth.log_k, truth.std**2, 0.0, tau**2, 0.0])
    assert_moments_agree(view_moments(view), expected)


def test_a_reference_is_seen_from_all_others(image):
    obs, grid, _ = image
    if obs.y.size == 1:
        pytest.skip("there is no other")
    for row in range(obs.y.size):
        rest = Quadrature(obs, rows=[other for other in range(obs.y.size) if other != row])
        if obs.firm.any() and obs.firm[row]:
            continue  # the grid was placed by the camera
        view = view_on_grid(grid, subjects(obs.group[row], obs.tau[row], row))
        # the grid was laid for all: where one alone is left it may cut its farthest tail off
        assert_moments_agree(view_moments(view), rest.moments(obs.group[row]), tolerance=0.1)


# --- laws --------------------------------------------------------------------------------------


def joined(*images):
    """Several images as segments of one array."""
    width = max(obs.kinds.share.shape[1] for obs in images)
    columns, image, group = [], [], []
    for number, obs in enumerate(images):
        fill = [(0, 0), (0, width - obs.kinds.share.shape[1])]
        columns.append([
            np.pad(column, fill, constant_values=value)
            for column, value in zip(obs.kinds, (0.0, 0.0, 1.0), strict=True)
        ])  # fmt: skip
        image.append(np.full(obs.y.size, number))
        group.append(obs.group + (0 if not group else group[-1].max() + 1))
    return LogObservations(
        *(np.concatenate([getattr(o, name) for o in images]) for name in ("y", "variance", "tau")),
        np.concatenate(image),
        np.concatenate(group),
        np.concatenate([obs.firm for obs in images]),
        Parts(*(np.concatenate(column) for column in zip(*columns, strict=True))),
    )


def test_many_images_at_once_equal_each_alone():
    alone = [believe(obs, fit_grid(obs)) for obs in IMAGES.values()]
    together = joined(*IMAGES.values())
    grid = fit_grid(together)
    summary, kinds = believe(together, grid)
    evidence = [log_evidence(fit_grid(obs))[0] for obs in IMAGES.values()]
    np.testing.assert_allclose(log_evidence(grid), evidence, atol=1e-3)
    # the grids differ, so each agrees within its quadrature
    std = np.array([one.log_std[0] for one, _ in alone])
    log_k = np.array([one.log_k[0] for one, _ in alone])
    np.testing.assert_allclose((summary.log_k - log_k) / std, 0, atol=1e-3)
    np.testing.assert_allclose(summary.log_std, std, rtol=2e-3)
    trust = np.concatenate([one.trust for one, _ in alone])
    np.testing.assert_allclose(summary.trust, trust, atol=1e-3)
    np.testing.assert_allclose(kinds.sum(axis=1), trust, atol=1e-3)


def test_a_new_label_beside_another_image_sees_its_own_image_alone():
    first, second = IMAGES["two that conflict"], IMAGES["3+1 of 1 kinds, tau 0.3, an outlier"]
    both = fit_grid(joined(first, second))
    where = Subjects(np.array([1, 0]), np.array([-1, -1]), np.array([0.0, 0.05]), np.full(2, -1))
    view = view_on_grid(both, where)
    truth = Quadrature(second)
    expected = np.array([truth.log_k, truth.std**2, 0.0, 0.0, 0.0])
    assert_moments_agree(view_moments(view, 0), expected)
    truth = Quadrature(first)
    expected = np.array([truth.log_k, truth.std**2, 0.0, 0.05**2, 0.0])
    assert_moments_agree(view_moments(view, 1), expected)


@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_the_references_does_not_matter(seed):
    together = joined(*IMAGES.values())
    order = np.random.default_rng(seed).permutation(together.y.size)
    shuffled = LogObservations(
        *(column[order] for column in together[:-1]),
        Parts(*(column[order] for column in together.mixture)),
    )
    summary, kinds = believe(together, fit_grid(together))
    again, kinds_again = believe(shuffled, fit_grid(shuffled))
    np.testing.assert_allclose(again.log_k, summary.log_k, rtol=1e-12)
    np.testing.assert_allclose(again.log_std, summary.log_std, rtol=1e-9)
    np.testing.assert_allclose(again.share, summary.share[order], rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(kinds_again, kinds[order], rtol=1e-9, atol=1e-15)


def test_a_common_factor_of_all_sizes_moves_log_k_and_nothing_else():
    obs = IMAGES["3+1 of 3 kinds, tau 0.1"]
    moved = obs._replace(y=obs.y + 13, mixture=obs.mixture._replace(mean=obs.mixture.mean + 13))
    summary, kinds = believe(obs, fit_grid(obs))
    again, kinds_again = believe(moved, fit_grid(moved))
    assert again.log_k[0] == pytest.approx(summary.log_k[0] + 13, abs=1e-9)
    assert again.log_std[0] == pytest.approx(summary.log_std[0], rel=1e-9)
    np.testing.assert_allclose(kinds_again, kinds, atol=1e-9)


def test_references_that_conflict_leave_two_modes():
    obs = IMAGES["two that conflict"]
    grid = fit_grid(obs)
    weight, (x, _) = grid_weight(grid), grid.on_grid(0)
    truth = Quadrature(obs)
    for low, high in [(-7, -5.6), (-5.6, -4)]:
        inside = (x >= low) & (x < high)
        expected = truth.density[(truth.x >= low) & (truth.x < high)].sum() / truth.density.sum()
        assert expected > 0.1
        assert weight[inside].sum() == pytest.approx(expected, abs=5e-3)


def test_a_single_sound_reference_gives_its_gaussian_and_the_outliers_tails():
    std, tau = 0.05, 0.03
    obs = observations([[(1, -6.0, std)]], [tau], [0])
    grid = fit_grid(obs)
    x, log_density = grid.on_grid(0)
    residual, shared = -6 - x, std**2 + tau**2
    expected = 0.95 * normal(residual, shared) + 0.03 * normal(residual - 0.4, shared + 0.0625)
    # closed form: the offset widens every part; that of a Laplace density is known by erfc
    scale = math.sqrt((std**2 + 0.25) / 2)
    for sign in (-1, 1):
        expected += (
            0.02
            / (4 * scale)
            * np.exp(tau**2 / (2 * scale**2) + sign * residual / scale)
            * special.erfc((tau / scale + sign * residual / tau) / math.sqrt(2))
        )
    np.testing.assert_allclose(
        np.exp(log_density) / math.sqrt(2 * math.pi), expected, atol=2e-3 * expected.max()
    )


def test_without_outliers_the_camera_and_references_multiply_as_gaussians():
    # all firm: no mixture, so precisions add
    obs = observations(
        [[(1, -6.0, 0.1)], [(1, -5.9, 0.2)], [(1, -6.1, 0.05)]],
        [0.0, 0.0, 0.0],
        [0, 1, 2],
        firm=[True] * 3,
    )
    precision = np.array([0.1, 0.2, 0.05]) ** -2.0
    mean = precision @ obs.y / precision.sum()
    summary, kinds = believe(obs, fit_grid(obs))
    assert summary.log_k[0] == pytest.approx(mean, abs=1e-9)
    assert summary.log_std[0] == pytest.approx(precision.sum() ** -0.5, rel=1e-6)
    np.testing.assert_allclose(kinds[:, 0], 1, atol=1e-12)
    np.testing.assert_allclose(summary.share, precision / precision.sum(), rtol=1e-9)


def test_sixty_references_are_as_exact_as_three():
    rng = np.random.default_rng(60)
    labels = np.arange(60) % 2
    std = rng.uniform(0.05, 0.15, 60)
    y = -6 + np.array([0.02, -0.03])[labels] + std * rng.normal(size=60)
    y[:5] += 0.5
    obs = observations([[(1, m, s)] for m, s in zip(y, std, strict=True)], [0.04, 0.03], labels)
    grid, truth = fit_grid(obs), Quadrature(obs, x=np.linspace(-6.4, -5.6, 801))
    summary, kinds = believe(obs, grid)
    assert log_evidence(grid)[0] - 30 * math.log(2 * math.pi) == pytest.approx(
        math.log(truth.evidence), abs=2e-3
    )
    assert summary.log_std[0] == pytest.approx(truth.std, rel=2e-3)
    assert scale_quantiles(obs)[0, 14] == pytest.approx(truth.quantile(0.5), abs=2e-3 * truth.std)
    expected = [truth.kinds(row)[0] for row in range(60)]
    np.testing.assert_allclose(kinds[:, 0], expected, atol=2e-3)


# --- precise references ------------------------------------------------------------------------


@pytest.mark.parametrize("std", [1e-3, 1e-6])
@pytest.mark.parametrize("count", [1, 2, 4])
def test_exact_data_give_the_exact_log_k_at_any_precision(count, std):
    obs = observations([[(1, -6.25, std)]] * count, [0.0], [0] * count)
    summary, _ = believe(obs, fit_grid(obs))
    assert summary.log_k[0] == pytest.approx(-6.25, abs=1e-12)
    assert scale_quantiles(obs)[0, 14] == pytest.approx(-6.25, abs=1e-3)
    # never claims more than it was told
    assert summary.log_std[0] >= std / math.sqrt(count) * 0.999


@pytest.mark.parametrize("std", [0.02, 0.01, 0.005, 0.003])
@pytest.mark.parametrize("count", [1, 2, 5])
def test_precise_references_that_agree_keep_their_precision(count, std):
    obs = observations([[(1, -6.25, std)]] * count, [0.0], [0] * count)
    found = scale_quantiles(obs)[0]
    expected = Quadrature(obs).half_width
    assert (found[18] - found[10]) / 2 == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize("gap", [1.0, 5.0, 30.0])
@pytest.mark.parametrize("std", [1e-2, 1e-4, 1e-6])
def test_a_grid_that_hits_its_limit_stays_proper(gap, std):
    obs = observations(
        [[(1, -6.0, std)], [(1, -6.0 + gap, std)], [(1, -6.0 + gap, std)]],
        [0.01, 0.01],
        [0, 1, 1],
    )
    grid = fit_grid(obs)
    summary, kinds = believe(obs, grid)
    for column in (
        *grid.on_grid(0),
        *summary[:5],
        kinds,
        log_evidence(grid),
        *scale_quantiles(obs),
    ):
        assert np.isfinite(column).all()
    assert grid.on_grid(0)[0].size <= 8192
    assert grid_weight(grid).sum() == pytest.approx(1)
    assert ((kinds >= 0) & (kinds <= 1 + 1e-9)).all()
    # two against one of another label
    assert -6 - 0.1 < summary.log_k[0] < -6 + gap + 0.1
    assert (np.diff(scale_quantiles(obs)[0]) >= 0).all()


def test_the_grid_is_shared_by_images_of_very_different_precision():
    precise = observations([[(1, -6.0, 0.01)]] * 3, [0.005], [0, 0, 0])
    vague = observations([[(1, -3.0, 0.4)], [(1, -2.6, 0.5)]], [0.1, 0.1], [0, 1])
    both = joined(precise, vague)
    summary, _ = believe(both, fit_grid(both))
    for row, obs in enumerate((precise, vague)):
        assert summary.log_std[row] == pytest.approx(Quadrature(obs).std, rel=5e-3)


# --- many images, and firm witnesses ------------------------------------------------------------


def hostile_images():
    """One to sixty references, narrow and wide offsets, two modes, firm witnesses, huge grids."""
    images = [
        random_image(seed, labels, kinds, tau, outlier)
        for seed, (labels, kinds, tau, outlier) in enumerate(
            [
                ((1,), 3, 0.05, False),
                ((2, 2, 1), 2, 0.03, True),
                ((3, 1), 1, 0.3, True),
                ((1,) * 8, 2, 0.02, True),
                ((30, 30), 1, 0.04, True),
                ((4, 3), 3, 0.002, False),
            ]
        )
    ]
    precise = [[(1, -6.0, 1e-4)], [(1, -5.0, 1e-3)], [(1, -5.9, 0.1)]]
    images.append(observations(precise, [0.01, 0.03], [0, 0, 1]))
    images += [beside_camera(std) for std in (0.05, 5e-3, 1e-4)]
    return [*images, *IMAGES.values()]


def beside_camera(std):
    """A firm witness at -6.05, and three references of two labels."""
    parts = [[(1, -6.0, 0.1)], [(0.7, -5.9, 0.1), (0.3, -6.3, 0.08)], [(1, -5.95, 0.12)]]
    firm = [False, False, False, True]
    return observations([*parts, [(1, -6.05, std)]], [0.03, 0.05, 0.0], [0, 0, 1, 2], firm=firm)


def looked_at(obs):
    """Everything that the posteriors say, one row for each image, reference or label."""
    grid = fit_grid(obs)
    summary, kinds = believe(obs, grid)
    image, tau = obs.of_groups()
    new = np.full(image.size, -1)
    others = np.flatnonzero(np.bincount(obs.image)[obs.image] > 1)
    view = [
        view_on_grid(grid, Subjects(image, np.arange(image.size), tau, new)),
        view_on_grid(grid, Subjects(image, new, tau, new)),
        view_on_grid(
            grid,
            Subjects(obs.image[others], obs.group[others], obs.tau[others], others),
        ),
    ]
    seen = [
        np.reshape([view_moments(part, row) for row in range(len(part.offset))], (-1, 5))
        for part in view
    ]
    return summary, kinds, log_evidence(grid), seen


def test_an_image_is_solved_alike_alone_and_among_any_others():
    images = hostile_images()
    together = joined(*images)
    summary, kinds, evidence, seen = looked_at(together)
    row = group = other = 0
    for number, obs in enumerate(images):
        alone, own_kinds, own_evidence, own_seen = looked_at(obs)
        rows = slice(row, row + obs.y.size)
        np.testing.assert_allclose(summary.log_k[number], alone.log_k[0], rtol=1e-9)
        np.testing.assert_allclose(summary.log_std[number], alone.log_std[0], rtol=1e-9)
        np.testing.assert_allclose(evidence[number], own_evidence[0], atol=1e-9)
        np.testing.assert_allclose(summary.share[rows], alone.share, rtol=1e-9, atol=1e-15)
        n_kinds = own_kinds.shape[1]
        np.testing.assert_allclose(kinds[rows, :n_kinds], own_kinds, rtol=1e-9, atol=1e-15)
        groups = slice(group, group + obs.n_groups)
        others = slice(other, other + len(own_seen[2]))
        for found, expected, part in zip(seen, own_seen, (groups, groups, others), strict=True):
            np.testing.assert_allclose(found[part], expected, rtol=1e-9, atol=1e-9)
        row, group, other = rows.stop, groups.stop, others.stop


@pytest.mark.parametrize("std", [1e-2, 3e-3, 1e-3, 1e-4])
def test_a_sharp_firm_witness_leaves_the_written_model_beside_it(std):
    obs = beside_camera(std)
    grid = fit_grid(obs)
    summary, kinds = believe(obs, grid)
    truth = Quadrature(obs, x=np.linspace(-6.05 - 10 * std, -6.05 + 10 * std, 401))
    assert summary.log_std[0] == pytest.approx(truth.std, rel=1e-5)
    expected = np.array([truth.kinds(row) for row in range(4)])
    np.testing.assert_allclose(kinds, expected, atol=5e-5)
    view = view_on_grid(grid, subjects([0, 1], [0.03, 0.05], [-1, -1]))
    for row in (0, 1):
        assert_moments_agree(view_moments(view, row), truth.moments(row), tolerance=1e-4)


def test_a_firm_witness_that_cannot_err_is_the_limit_of_sharper_ones():
    limit, kinds = believe(beside_camera(1e-6), fit_grid(beside_camera(1e-6)))
    for std in (1e-4, 1e-3):  # the others pull by less than 30 of its variances
        obs = beside_camera(std)
        summary, own_kinds = believe(obs, fit_grid(obs))
        assert summary.log_k[0] == pytest.approx(limit.log_k[0], abs=30 * std**2)
        np.testing.assert_allclose(own_kinds, kinds, atol=0.1 * std)
    assert limit.log_k[0] == pytest.approx(-6.05, abs=1e-9)
    assert limit.log_std[0] == pytest.approx(1e-6, rel=1e-6)


@pytest.mark.parametrize("std", [1e-6, 1e-3])
def test_a_sharp_firm_witness_needs_no_more_points_than_a_vague_one(std):
    assert fit_grid(beside_camera(std)).on_grid(0)[0].size <= 64


def test_a_firm_witness_stands_against_any_number_of_references():
    # all that a label says of another place is that its references must be wrong
    parts = [[(1, -4.0, 0.05)]] * 40
    obs = observations(
        [*parts, [(1, -6.0, 1e-3)]], [0.03, 0.0], [0] * 40 + [1], firm=[False] * 40 + [True]
    )
    summary, kinds = believe(obs, fit_grid(obs))
    assert summary.log_k[0] == pytest.approx(-6, abs=1e-5)
    assert kinds[40, 0] == pytest.approx(1)
    np.testing.assert_allclose(kinds[:40, 0], 0, atol=1e-9)


def test_two_firm_witnesses_that_contradict_each_other_are_averaged():
    obs = observations([[(1, -6.0, 1e-3)], [(1, -5.97, 1e-3)]], [0, 0], [0, 1], firm=[True] * 2)
    summary, _ = believe(obs, fit_grid(obs))
    assert summary.log_k[0] == pytest.approx(-5.985, abs=1e-9)
    assert summary.log_std[0] == pytest.approx(1e-3 / math.sqrt(2), rel=1e-6)


# --- where the points are ----------------------------------------------------------------------

# Labels, their offsets (one spread for all), and the error of every reference.
SCENES = [
    ([1], 0.0, 0.1),
    ([2], 0.0, 0.1),
    ([4], 0.3, 0.1),
    ([3, 1], 0.02, 0.1),
    ([1, 1, 1], 0.1, 0.1),
    ([2, 5], 0.1, 0.03),
    ([1] * 20, 0.02, 0.1),
    ([30], 0.02, 0.15),
]


def agreeing(labels, tau, std, place=-6.0):
    """References of some labels that all see the same."""
    group = np.repeat(np.arange(len(labels)), labels)
    return observations([[(1, place, std)]] * group.size, [tau] * len(labels), group)


def firm_beside(obs, place, std):
    """The same references beside a firm witness."""
    parts = [[(1, mean, math.sqrt(var))] for mean, var in zip(obs.y, obs.variance, strict=True)]
    tau = [*obs.of_groups()[1], 0.0]
    group = [*obs.group, len(tau) - 1]
    firm = [False] * obs.y.size + [True]
    return observations([*parts, [(1, place, std)]], tau, group, firm=firm)


@pytest.mark.parametrize(("labels", "tau", "std"), SCENES)
def test_points_are_as_close_as_the_sharpest_label_and_log_k_need_and_no_closer(labels, tau, std):
    points, _ = fit_grid(agreeing(labels, tau, std)).on_grid(0)
    counts = np.array(labels)
    of_label = std / math.sqrt(counts.max())
    of_k = 1 / math.sqrt((1 / (std**2 / counts + tau**2)).sum())
    most = min(0.4 * of_label, 0.8 * of_k)
    wanted = math.ceil((points[-1] - points[0]) / most - 1e-9) + 1
    unit = max(
        8, 2 ** (math.floor(math.log2(wanted)) - 3)
    )  # few sizes, that many are solved at once
    assert points.size == math.ceil(wanted / unit) * unit
    assert points[1] - points[0] <= most * (1 + 1e-9)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_points_reach_five_standard_errors_and_what_outliers_need(count):
    points, _ = fit_grid(agreeing([count], 0.0, 0.3)).on_grid(0)
    reach = 5 * 0.3 + 3 / count
    np.testing.assert_allclose(points[[0, -1]], [-6 - reach, -6 + reach], rtol=1e-12)


def test_points_reach_as_far_as_the_offset_of_a_label_does():
    obs = observations([[(1, -6.0, 0.3)], [(1, -5.0, 0.4)]], [0.4, 0.9], [0, 1])
    points, _ = fit_grid(obs).on_grid(0)
    reach = 5 * math.hypot(0.3, 0.4) + 3 / 2
    np.testing.assert_allclose(points[[0, -1]], [-6 - reach, -5 + reach], rtol=1e-12)


def test_a_firm_witness_alone_needs_no_points_for_outliers():
    obs = observations([[(1, -6.0, 0.1)]], [0.0], [0], firm=[True])
    points, _ = fit_grid(obs).on_grid(0)
    np.testing.assert_allclose(points[[0, -1]], [-6.5, -5.5], rtol=1e-12)


@pytest.mark.parametrize("place", [-9.0, -3.0])
def test_a_firm_witness_that_no_other_reaches_keeps_its_own_place(place):
    # the reference must be wrong; what its outliers say is nearly the same all along
    obs = firm_beside(agreeing([1], 0.0, 0.02, -6.0), place, 0.005)
    fit = fit_grid(obs)
    summary, kinds = believe(obs, fit)
    assert summary.log_k[0] == pytest.approx(place, abs=1e-4)
    assert summary.log_std[0] == pytest.approx(0.005, rel=1e-3)
    assert kinds[:, 0] == pytest.approx([0, 1], abs=1e-9)
    points, log_density = fit.on_grid(0)
    truth = Quadrature(obs, x=points)
    np.testing.assert_allclose(
        np.exp(log_density - log_density.max()), truth.density / truth.density.max(), atol=1e-9
    )


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("labels", [(30, 30), (60,), (1,) * 40, (20, 1, 1)])
@pytest.mark.parametrize("tau", [0.0, 0.02, 0.2])
def test_points_that_are_laid_after_a_first_look_hold_all_mass_and_little_else(seed, labels, tau):
    fit = fit_grid(random_image(seed, labels, 1, tau, outlier=True))
    _, log_density = fit.on_grid(0)
    below = log_density.max() - log_density
    # one reference left out moves an end by up to 9
    assert min(below[0], below[-1]) > 18
    assert (below < 27).mean() > 0.15


def test_images_of_one_size_are_solved_together_in_pieces_of_limited_size():
    obs = agreeing([3], 0.05, 0.1)
    many = fit_grid(joined(*[obs] * 400))
    numbers = [grid.size[0] * block.rows.y.size for _, block, grid in many.laid]
    one = 3 * many.laid[0][2].size[0]  # an image is never divided
    assert all(number <= 60_000 + one for number in numbers)
    assert all(sum(pair) > 60_000 - one for pair in pairwise(numbers))
    together = np.concatenate([which for which, _, _ in many.laid])
    np.testing.assert_array_equal(together, np.arange(400))


def test_an_image_of_more_numbers_than_a_piece_holds_is_a_piece():
    obs = agreeing([3000], 0.0, 0.5)
    sizes = [which.size for which, _, _ in fit_grid(joined(obs, obs)).laid]
    assert sizes == [1, 1]


def test_the_only_piece_is_kept_and_one_of_several_is_evaluated_anew():
    obs = agreeing([3], 0.05, 0.1)
    one, several = fit_grid(obs), fit_grid(joined(*[obs] * 400))
    assert one.piece(0) is one.piece(0)
    assert several.piece(0) is not several.piece(0)
    kept = several.keeping()
    assert kept.piece(1) is kept.piece(1)
    np.testing.assert_array_equal(kept.piece(1).log_density, several.piece(1).log_density)


# --- firm witnesses that are sharper than labels --------------------------------------------------


def apart_labels(tau, std=0.05):
    """Two labels, one of three references, beside a camera a thousand times sharper."""
    group = [0, 0, 0, 1]
    parts = [[(1, -6.0, std)], [(1, -5.95, std)], [(1, -6.02, std)], [(1, -6.1, 2 * std)]]
    return firm_beside(observations(parts, tau, group), -6.01, 1e-4)


@pytest.mark.parametrize("tau", [(0.03, 0.1), (0.3, 0.1), (0.2, 0.01)])
def test_labels_beside_a_sharp_firm_witness_have_points_as_close_as_they_need(tau):
    fit = fit_grid(apart_labels(tau))
    (_, _, grid), piece = fit.laid[0], fit.piece(0)
    assert grid.apart.all()
    assert not piece.is_same
    information = np.array([3, 1 / 4]) / 0.05**2 + 1 / np.square(tau)
    reach = 7 * np.array(tau)
    np.testing.assert_allclose(piece.label.step[:2], 2 * reach / (piece.label.size - 1))
    assert piece.label.step[:2].max() <= 0.5 / math.sqrt(information.max()) * (1 + 1e-9)
    needed = 2 * reach.max() / (0.5 / math.sqrt(information.max()))
    own = 2 * 10 * 1e-4 / grid.step[0]
    assert piece.label.size <= 1.13 * max(needed, own) + 9


def test_log_k_beside_vague_labels_has_points_as_close_as_its_firm_witness_needs():
    obs = firm_beside(agreeing([1], 0.05, 0.5), -6.0, 1e-3)
    fit = fit_grid(obs)
    assert fit.laid[0][2].apart.all()
    points, _ = fit.on_grid(0)
    assert 0.3e-3 < points[1] - points[0] <= 0.4e-3 * (1 + 1e-6)


def test_objects_see_no_more_points_than_hold_the_mass():
    fit = fit_grid(agreeing([4], 0.0, 0.3))
    points, log_density = fit.on_grid(0)
    heavy = np.flatnonzero(log_density > log_density.max() - 21)
    view = view_on_grid(fit, subjects([-1], 0.0, [-1]))
    assert view.log_k.shape[1] == heavy[-1] - heavy[0] + 1 < points.size
    np.testing.assert_array_equal(view.log_k[0], points[heavy[0] : heavy[-1] + 1])


def test_points_of_a_firm_witness_apart_reach_ten_of_its_errors():
    points, _ = fit_grid(apart_labels((0.03, 0.1))).on_grid(0)
    np.testing.assert_allclose(points[[0, -1]], [-6.01 - 1e-3, -6.01 + 1e-3], rtol=1e-9)


def test_a_firm_witness_without_offsets_beside_it_stands_on_common_points():
    obs = firm_beside(agreeing([2, 1], 0.0, 0.1), -6.0, 0.001)
    assert not fit_grid(obs).laid[0][2].apart.any()


def test_images_apart_and_coarse_ones_of_one_size_are_not_confused():
    apart, coarse = apart_labels((0.05, 0.05)), agreeing([1] * 20, 0.0, 0.3)
    grids = [fit_grid(obs).laid[0][2] for obs in (apart, coarse)]
    assert [bool(grid.apart[0]) for grid in grids] == [True, False]
    assert [bool(grid.coarse[0]) for grid in grids] == [False, True]
    assert grids[0].size == grids[1].size
    for images in ((apart, coarse), (coarse, apart)):
        both = joined(*images)
        alone = [believe(obs, fit_grid(obs))[0].log_std[0] for obs in images]
        np.testing.assert_allclose(believe(both, fit_grid(both))[0].log_std, alone, rtol=1e-12)


# --- what is told of them -------------------------------------------------------------------------


def test_log_k_is_the_mean_of_the_kinds_of_all_references_by_the_precisions_they_kept():
    parts = [
        [(0.6, -6.0, 0.1), (0.4, -6.4, 0.2)],
        [(0.5, -5.9, 0.15), (0.5, -6.3, 0.1)],
        [(1, -5.2, 0.1)],
    ]
    obs = observations(parts, [0.0] * 3, [0, 1, 2])
    truth = Quadrature(obs)
    weight = np.array([np.pad(truth.kinds(row), (0, 2))[:2] for row in range(3)])
    weight /= obs.kinds.variance[:, :2]
    summary, _ = believe(obs, fit_grid(obs))
    expected = (weight * obs.kinds.mean[:, :2]).sum() / weight.sum()
    assert summary.log_k[0] == pytest.approx(expected, abs=1e-4)
    np.testing.assert_allclose(summary.weight, weight.sum(axis=1), rtol=2e-3)


def test_an_image_whose_only_reference_is_the_object_says_nothing_of_k():
    obs = joined(agreeing([1], 0.2, 0.1), agreeing([1, 1], 0.2, 0.1))
    view = view_on_grid(fit_grid(obs), subjects([0], 0.2, [0]))
    assert np.isnan(view.log_k).all()
    assert np.isnan(view.log_k_var).all()
    np.testing.assert_array_equal(view.offset, 0)
    np.testing.assert_array_equal(view.covariance, 0)
    np.testing.assert_allclose(view.offset_var, 0.2**2)


@pytest.mark.parametrize("std", [0.01, 3.0])
def test_hundreds_of_references_neither_overflow_nor_underflow(std):
    # their likelihoods multiply to e^700 or e^-500
    obs = agreeing([200, 200], 0.05, std)
    fit = fit_grid(obs)
    _, kinds = believe(obs, fit)
    # v is known 14 times as well as one reference tells it
    sound = 0.95 / math.sqrt(2 * math.pi * std**2)
    wrong = 0.02 / math.sqrt(2 * (std**2 + 0.25))
    wrong += 0.03 * math.exp(-0.08 / (std**2 + 0.0625)) / math.sqrt(2 * math.pi * (std**2 + 0.0625))
    np.testing.assert_allclose(kinds[:, 0], sound / (sound + wrong), rtol=0.05)
    assert np.isfinite(log_evidence(fit)).all()
    view = view_on_grid(fit, subjects([0, 1], 0.05, [-1, -1]))
    moments = view_moments(view)
    assert_moments_agree(moments, view_moments(view, 1), 1e-6)
    assert moments[0] == pytest.approx(-6, abs=0.1 * math.sqrt(moments[1]))
