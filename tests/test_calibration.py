"""Truths that are drawn from the model's own priors lie evenly in the distributions it gives."""

import functools
import importlib.util
import math
from pathlib import Path

import attrs
import numpy as np
import pytest
from scipy import stats

import imgscale as ims
from imgscale.batch import fit_columns

ROOT = Path(__file__).parents[1]
SPEC = importlib.util.spec_from_file_location("calibration", ROOT / "benchmarks" / "calibration.py")
calibration = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(calibration)
World = calibration.World

IN_COLUMNS, IN_PICTURES = calibration.ranks_in_columns, calibration.ranks_in_pictures
# Of 16 tests of ranks, each fails once in a thousand seeds without any error: 1.6 % of all seeds.
# The seed is fixed; a failure is a change of the intervals. Of one world alone a test of 400 ranks
# finds intervals that are 15 % too narrow with 65 % of seeds, and a shift by half a standard
# deviation always; of 50 ranks with 6 % and 42 %. All worlds together find either.
POSTERIOR = {
    "metric": (IN_COLUMNS, World("metric"), 400),
    "relative": (IN_COLUMNS, World("relative"), 400),
    "inverse": (IN_COLUMNS, World("inverse"), 400),
    "noise not told": (IN_COLUMNS, World("relative", told=False), 60),
    "with a camera": (IN_PICTURES, World("metric", camera=True), 120),
    "by fit": (IN_PICTURES, World("relative"), 120),
    "affine inverse": (IN_PICTURES, World("affine_inverse"), 50),
    "ground plane": (IN_PICTURES, World("ground_plane", (2, 3, 4, 5, 6)), 50),
}


@functools.cache
def ranks_of(name):
    rank, world, n_images = POSTERIOR[name]
    return rank(world, "posterior", n_images, seed=10 + list(POSTERIOR).index(name))


def known(ranks):
    return ranks[~np.isnan(ranks)]


def within(ranks, level):
    return np.mean(abs(ranks - 0.5) <= level / 2)


# --- the test of uniformity ----------------------------------------------------------------------


def test_uniformity_is_the_smooth_test_of_four_legendre_polynomials():
    ranks = np.random.default_rng(0).beta(1.2, 1.0, size=50)
    sums = np.polynomial.legendre.legvander(2 * ranks - 1, 4)[:, 1:].sum(axis=0)
    statistic = ((2 * np.arange(1, 5) + 1) * sums**2).sum() / ranks.size
    assert calibration.uniformity(ranks) == pytest.approx(stats.chi2.sf(statistic, 4), rel=1e-9)


@pytest.mark.parametrize("n_images", [70, 600])
def test_false_alarms_are_as_frequent_as_stated(n_images):
    rng = np.random.default_rng(1)
    p_values = [calibration.uniformity(rng.uniform(size=n_images)) for _ in range(4000)]
    # four binomial errors
    assert np.mean(np.array(p_values) < 0.01) == pytest.approx(0.01, abs=0.0063)
    assert np.mean(np.array(p_values) < calibration.FALSE_ALARM) <= 0.003


def test_the_power_is_as_stated():
    assert calibration.power(100) > 0.05
    assert calibration.power(400, in_bins=True) > 0.55
    assert calibration.power(700, in_bins=True) > 0.9
    assert calibration.power(2000) > 0.99
    assert calibration.power(100, narrower=1.0, beside=0.5) > 0.75
    assert calibration.power(400, narrower=1.0, beside=0.25) > 0.75
    assert calibration.power(400, narrower=1.0) < 0.01


def test_a_rank_is_the_probability_below_the_truth():
    ends = {"label": "thing", "axis": "height", "metres_per_pixel": 1.0, "depth": 1.0}
    normal = ims.SizeEstimate(size_m=2.0, std_m=0.2, distance_m=None, flags=ims.Flag(0), **ends)
    for level in (0.1, 0.5, 0.9, 0.99):
        low, high = normal.interval(level)
        assert calibration.rank(normal, low) == pytest.approx((1 - level) / 2, rel=1e-9)
        assert calibration.rank(normal, high) == pytest.approx((1 + level) / 2, rel=1e-9)
    scores = np.linspace(-3.5, 3.5, 29)
    skewed = attrs.evolve(normal, quantiles_m=tuple(2 * np.exp(0.1 * scores + 0.01 * scores**2)))
    for level in (0.5, 0.9, 0.99):
        low, high = skewed.interval(level)
        assert calibration.rank(skewed, low) == pytest.approx((1 - level) / 2, rel=1e-9)
        assert calibration.rank(skewed, high) == pytest.approx((1 + level) / 2, rel=1e-9)


def test_an_interval_without_an_upper_end_has_ranks_too():
    scores = np.linspace(-3.5, 3.5, 29)
    quantiles = np.where(scores > 1.9, np.inf, 2 * np.exp(0.1 * scores))
    estimate = ims.SizeEstimate(
        label="thing",
        axis="height",
        size_m=2.0,
        std_m=0.2,
        metres_per_pixel=1.0,
        depth=1.0,
        distance_m=None,
        flags=ims.Flag(0),
        quantiles_m=tuple(quantiles),
    )
    assert calibration.rank(estimate, 2.0) == pytest.approx(0.5)
    assert stats.norm.cdf(1.75) <= calibration.rank(estimate, 50.0) <= stats.norm.cdf(2.0)


# --- ranks ---------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", POSTERIOR)
def test_the_posterior_ranks_unknown_sizes_evenly(name):
    assert calibration.uniformity(known(ranks_of(name).size)) > calibration.FALSE_ALARM


@pytest.mark.slow
@pytest.mark.parametrize("name", ["with a camera", "by fit", "affine inverse"])
def test_the_posterior_ranks_k_evenly(name):
    assert calibration.uniformity(ranks_of(name).k) > calibration.FALSE_ALARM


@pytest.mark.slow
def test_k_of_a_ground_plane_is_held_less_often_than_its_error_says():
    # the page tells why; measured with 250 images 0.86, the binomial error of 50 is 0.05
    assert 0.7 < within(ranks_of("ground plane").k, 0.9) < 0.98


@pytest.mark.slow
def test_the_posteriors_of_all_kinds_together_rank_sizes_evenly():
    together = np.concatenate([known(ranks_of(name).size) for name in POSTERIOR])
    assert together.size > 1500
    assert calibration.uniformity(together) > calibration.FALSE_ALARM


@pytest.mark.parametrize("kind", ["metric", "relative", "inverse"])
def test_the_robust_fit_ranks_sizes_evenly_where_no_reference_is_wrong(kind):
    ranks = IN_COLUMNS(World(kind, wrong=0.0), "robust", 20_000, seed=3).size
    assert calibration.uniformity(ranks) > calibration.FALSE_ALARM


@pytest.mark.slow
def test_the_robust_fit_ranks_sizes_evenly_where_the_shift_is_unknown():
    ranks = IN_COLUMNS(World("affine_inverse", wrong=0.0), "robust", 300, seed=4).size
    assert calibration.uniformity(ranks) > calibration.FALSE_ALARM


def test_kinds_without_a_shift_are_one_law():
    by_kind = [
        IN_COLUMNS(World(kind), "posterior", 60, seed=5).size
        for kind in ("metric", "relative", "inverse")
    ]
    np.testing.assert_array_equal(by_kind[0], by_kind[1])
    np.testing.assert_array_equal(by_kind[0], by_kind[2])


# --- what the gate finds -------------------------------------------------------------------------


def changed(*, narrower=1.0, beside=0.0):
    """fit_columns with intervals too narrow, or off by some standard errors."""

    def changed_fit(*arguments, **options):
        found = fit_columns(*arguments, **options)
        size = found.rows.size_m
        off = np.exp(beside * found.rows.std_m / size)
        ends = (found.rows.low_m, found.rows.high_m)
        low, high = (off * size * (end / size) ** narrower for end in ends)
        return found._replace(rows=found.rows._replace(low_m=low, high_m=high))

    return changed_fit


@pytest.mark.parametrize(
    "error", [{"narrower": 0.85}, {"narrower": 1.15}, {"beside": 0.5}, {"beside": -0.5}]
)
def test_the_gate_finds_wrong_intervals_of_the_robust_fit(error, monkeypatch):
    monkeypatch.setattr(calibration, "fit_columns", changed(**error))
    ranks = IN_COLUMNS(World("relative", wrong=0.0), "robust", 20_000, seed=3).size
    assert calibration.uniformity(ranks) < calibration.FALSE_ALARM


@pytest.mark.slow
def test_the_gate_finds_intervals_of_the_posterior_that_are_15_percent_too_narrow(monkeypatch):
    monkeypatch.setattr(calibration, "fit_columns", changed(narrower=0.85))
    ranks = IN_COLUMNS(World("relative"), "posterior", 700, seed=6).size
    assert calibration.uniformity(ranks) < calibration.FALSE_ALARM


def half_a_std_larger(estimate):
    factor = math.exp(0.5 * estimate.std_m / estimate.size_m)
    quantiles = estimate.quantiles_m and tuple(factor * size for size in estimate.quantiles_m)
    return attrs.evolve(estimate, size_m=factor * estimate.size_m, quantiles_m=quantiles)


@pytest.mark.slow
def test_the_gate_finds_k_that_is_half_a_standard_deviation_off():
    ranks = IN_PICTURES(World("relative"), "posterior", 120, 15, change=half_a_std_larger)
    assert calibration.uniformity(ranks.k) < calibration.FALSE_ALARM
    assert calibration.uniformity(ranks.size) < calibration.FALSE_ALARM


def test_the_gate_finds_depth_noise_that_is_half_as_large_as_told(monkeypatch):
    world = World("relative")
    monkeypatch.setattr(calibration, "_noise", lambda _: ims.Noise(depth_rel=0.1))
    ranks = IN_COLUMNS(world, "robust", 20_000, seed=7).size
    assert calibration.uniformity(ranks) < calibration.FALSE_ALARM
    assert within(ranks, 0.9) > 0.95


# --- coverage ------------------------------------------------------------------------------------


@functools.cache
def printed():
    """The page's coverage of the robust fit, in %: (what is worse, number of references)."""
    page = (ROOT / "docs" / "calibration.md").read_text(encoding="utf-8")
    section = page.partition("<!-- calibration: one-law -->")[2].partition("<!-- end")[0]
    rows = [[cell.strip() for cell in row.split("|")[1:-1]] for row in section.splitlines()]
    table = {}
    for method, name, *cells in filter(None, rows):
        if method == "robust":
            for count, cell in zip(calibration.COUNTS, cells, strict=True):
                table[name, count] = [int(part) for part in cell.split("/")]
    return table


@pytest.mark.parametrize("name", calibration.WORSE)
def test_the_page_says_how_often_the_robust_fit_holds_the_truth(name):
    for count in calibration.COUNTS:
        world = World("relative", (count,))._replace(**calibration.WORSE[name])
        found = calibration.coverage(world, "robust", 4000, seed=100 + count)
        for share, text in zip(found, printed()[name, count], strict=True):
            # both are of 4000 images, and the page is rounded
            error = 4 * math.sqrt(2 * share * (1 - share) / 4000)
            assert share == pytest.approx(text / 100, abs=0.005 + error)


def test_with_one_reference_the_posterior_leaves_room_for_its_being_wrong():
    world = World("relative", (1,))
    posterior, robust = (
        calibration.coverage(world, method, 600, seed=8) for method in ("posterior", "robust")
    )
    # measured with 6000: k 0.88 and 0.86, sizes 0.90 and 0.87; the binomial error is 0.013, of the
    # difference, on the same images, a third of that
    assert posterior.k > robust.k
    assert posterior.size > robust.size
    assert posterior.k > 0.84
    assert posterior.size > 0.86


def test_a_page_keeps_its_text_when_a_table_is_replaced():
    begin, end = "Before.\n<!-- calibration: ranks -->\n", "\n<!-- end of ranks -->\nAfter.\n"
    again = calibration.filled(f"{begin}old{end}", "ranks", ["| new |"])
    assert again == f"{begin}\n| new |\n{end}"
    with pytest.raises(ValueError, match="The page must hold"):
        calibration.filled("Nothing.", "ranks", [])


def test_the_page_has_every_table():
    page = (ROOT / "docs" / "calibration.md").read_text(encoding="utf-8")
    for section in ("ranks", *calibration.COVERED):
        table = page.partition(f"<!-- calibration: {section} -->")[2].partition("<!-- end")[0]
        assert table.count("\n|") >= 4
