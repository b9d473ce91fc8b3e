"""A measurement fused with the object's own prior: never worse than either, and exact."""

import math

import numpy as np
import pytest
from scipy import optimize, special

import imgscale as ims
from imgscale import Flag

METHODS = ["posterior", "robust"]
TRUE_K = 1e-3
ONE_SIGMA = (0.15865525393145707, 0.8413447460685429)
# Rows (share, mean, spread) and the relative error of the mean, of labels that no table knows.
LABELS = {
    "idol": ([(1.0, 2.0, 0.05)], 0.03),
    "jar": ([(1.0, 1.2, 0.08)], 0.0),
    "chest": ([(1.0, 0.7, 0.06)], 0.05),
    "visitor": ([(0.7, 1.7, 0.05), (0.3, 1.2, 0.1)], 0.02),
}


def table():
    return ims.PriorTable([
        ims.ObjectPrior(label, mean, spread * mean, mean_std_m=tau * mean, share=share)
        for label, (rows, tau) in LABELS.items()
        for share, mean, spread in rows
    ])  # fmt: skip


def moments(label):
    """Share, mean and variance of the log size of each kind, and of all together."""
    share, mean, spread = np.array(LABELS[label][0]).T
    variance = np.log1p(spread**2)
    total = share @ mean
    of_all = math.log1p((share @ (mean**2 * (1 + spread**2)) - total**2) / total**2)
    return share, np.log(mean) - variance / 2, variance, math.log(total) - of_all / 2, of_all


def offset_std(label):
    """Relative to the mean of all kinds, as the table's rows declare it."""
    return LABELS[label][1]


def detections(labels, pixels, **options):
    return [
        ims.Detection(label, (10.0, 5.0, 30.0, 5.0 + height), **options)
        for label, height in zip(labels, pixels, strict=True)
    ]


def sized(labels, sizes, method="posterior", noise=0.05, *, target, reference_target=False):
    """The target's estimates without and with its prior; sizes as seen at the true k."""
    told = ims.Noise(box_px=0.0, depth_rel=noise)
    seen = detections(labels, np.asarray(sizes) / (TRUE_K * 5))
    depth = ims.ObjectDepths(np.full(len(labels), 5.0), kind="relative")
    model = ims.fit(seen, depth, table(), noise=told, method=method)
    # somewhere else in the image, so that it is none of the references
    height = target[1] / (TRUE_K * 5)
    what = [ims.Detection(target[0], (50.0, 5.0, 70.0, 5.0 + height))]
    if reference_target:
        what = seen[-1:]
    where = ims.ObjectDepths([5.0], kind="relative")
    plain = ims.predict(model, what, where)[0]
    return model, plain, ims.predict(model, what, where, use_prior=True)[0]


def log_width(estimate, level):
    low, high = np.log(estimate.interval(level))
    return high - low


def normal(residual, variance):
    return np.exp(-0.5 * residual**2 / variance) / np.sqrt(2 * math.pi * variance)


def laplace(residual, variance):
    scale = np.sqrt(variance / 2)
    return np.exp(-np.abs(residual) / scale) / (2 * scale)


# --- the model, written a second time ----------------------------------------------------------


class Quadrature:
    """Sums over log k and the offset of every label; the target's size in closed form for each."""

    def __init__(self, labels, sizes, noise, target):
        y = {label: [] for label in [target[0], *labels]}
        for label, size in zip(labels, sizes, strict=True):
            y[label].append(math.log(size))
        own = [
            moments(label)[1] - math.log(size) for label, size in zip(labels, sizes, strict=True)
        ]
        least = math.sqrt(min(moments(label)[2].min() for label in labels) + noise**2)
        low, high = np.concatenate(own).min() - 2, np.concatenate(own).max() + 2
        x = np.arange(low, high, least / math.sqrt(len(labels)) / 3)  # log k - log(true k)
        others = np.ones_like(x)
        for label, seen in y.items():
            tau = offset_std(label)
            u = np.linspace(
                -6 * tau, 6 * tau, max(41, math.ceil(12 * tau / least * 4)) if tau else 1
            )
            joint = np.broadcast_to(np.exp(-0.5 * (u / (tau or 1)) ** 2), (x.size, u.size))
            joint = joint / joint[0].sum()
            for log_size in seen:
                joint = joint * self.likelihood(label, log_size, x[:, None] + u, noise)
            if label == target[0]:
                of_target, offset = joint, u
            else:
                others = others * joint.sum(axis=1)
        weight = of_target * others[:, None]
        measured = x[:, None] + math.log(target[1]) + 0 * offset
        share, mean, variance, _, _ = moments(target[0])
        parts = []
        for j in range(share.size):
            prior = mean[j] - offset + 0 * x[:, None]  # the offset is that of log k
            total = variance[j] + noise**2
            part = share[j] * weight * normal(measured - prior, total)
            middle = (prior * noise**2 + measured * variance[j]) / total
            parts.append((part.ravel(), middle.ravel(), variance[j] * noise**2 / total))
        self.weight = np.concatenate([part[0] for part in parts])
        self.mean = np.concatenate([part[1] for part in parts])
        self.std = np.sqrt(np.concatenate([np.full(part[0].size, part[2]) for part in parts]))
        heavy = self.weight > 1e-10 * self.weight.max()
        self.weight, self.mean, self.std = self.weight[heavy], self.mean[heavy], self.std[heavy]
        self.weight = self.weight / self.weight.sum()

    @staticmethod
    def likelihood(label, log_size, v, noise):
        share, mean, variance, of_all, all_var = moments(label)
        sound = sum(
            0.95 * share[j] * normal(mean[j] - log_size - v, variance[j] + noise**2)
            for j in range(share.size)
        )
        residual, wide = of_all - log_size - v, all_var + noise**2
        return (
            sound
            + 0.02 * laplace(residual, wide + 0.25)
            + 0.03 * normal(residual - 0.4, wide + 0.0625)
        )

    def quantile(self, probability):
        def excess(log_size):
            return self.weight @ special.ndtr((log_size - self.mean) / self.std) - probability

        return optimize.brentq(excess, -5, 5, xtol=1e-9)


SCENES = {
    "one of the same label": (["idol"], [2.1]),
    "one of another label": (["jar"], [1.15]),
    "two labels": (["idol", "jar"], [2.05, 1.1]),
    "three": (["idol", "jar", "idol"], [1.9, 1.25, 2.1]),
    "three, one cut": (["idol", "jar", "jar"], [2.0, 1.2, 0.75]),
    "two that conflict": (["idol", "jar"], [2.0, 0.8]),
    "with a label of two kinds": (["visitor", "idol", "visitor"], [1.72, 1.9, 1.15]),
}
TARGETS = {
    "as its prior says": ("idol", 2.0),
    "small": ("idol", 1.8),
    "far too large": ("idol", 2.9),
    "of a label without references": ("chest", 0.75),
    "of two kinds": ("visitor", 1.5),
    "a jar": ("jar", 1.3),
}


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS.keys())
@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES.keys())
def test_the_fused_size_is_that_of_the_written_model(scene, target):
    labels, sizes = scene
    _, _, fused = sized(labels, sizes, target=target)
    truth = Quadrature(labels, sizes, 0.05, target)
    low, high = truth.quantile(special.ndtr(-1)), truth.quantile(special.ndtr(1))
    alone = prior_quantiles(target[0])
    if (high - low) / 2 >= (alone[1] - alone[0]) / 2:
        expected = (alone[1] - alone[0]) / 2  # then the prior alone is told
        assert fused.std_m / fused.size_m == pytest.approx(expected, rel=1e-2)
        return
    std = (high - low) / 2
    assert fused.std_m / fused.size_m == pytest.approx(std, rel=5e-3)
    assert math.log(fused.size_m) == pytest.approx(truth.quantile(0.5), abs=5e-3 * std)
    ends = [truth.quantile(0.05), truth.quantile(0.95)]
    # read off between quantiles that are kept at every quarter of a standard score: straight for
    # one kind, curved between two
    allowed = 0.1 if target[0] == "visitor" else 1e-2
    np.testing.assert_allclose(np.log(fused.interval(0.9)), ends, atol=allowed * std)


def prior_quantiles(label, probabilities=ONE_SIGMA):
    """Of the log size of the prior alone, the offset of its mean included."""
    share, mean, variance, _, _ = moments(label)
    std = np.sqrt(variance + offset_std(label) ** 2)
    return [
        optimize.brentq(lambda h, p=p: share @ special.ndtr((h - mean) / std) - p, -3, 3)
        for p in probabilities
    ]


def test_gaussians_alone_fuse_in_closed_form():
    # a camera is the only witness, so that all is Gaussian
    depth = ims.ObjectDepths([8.0], kind="metric", image_size=(4000, 3000))
    for tau, focal, noise in [
        (0.03, 0.02, 0.05),
        (0.05, 0.02, 0.1),
        (0.1, 0.01, 0.1),
        (0.1, 0, 0.2),
    ]:
        priors = ims.PriorTable([ims.ObjectPrior("chest", 0.7, 0.035, mean_std_m=0.7 * tau)])
        camera = ims.Camera(2000.0, focal_rel_std=focal)
        chest = ims.Detection("chest", (500.0, 500.0, 600.0, 500.0 + 0.8 * 2000 / 8))
        told = ims.Noise(box_px=0.0, depth_rel=noise)
        stranger = [ims.Detection("statue", (100.0, 100.0, 200.0, 300.0))]
        model = ims.fit(stranger, depth, priors, camera=camera, noise=told)
        fused = ims.predict(model, [chest], depth, use_prior=True)[0]
        variance = math.log1p(0.05**2)
        mean = math.log(0.7) - variance / 2
        precision = np.array([1 / (variance + tau**2), 1 / (focal**2 + noise**2)])
        expected = precision @ [mean, math.log(0.8)] / precision.sum()
        std = precision.sum() ** -0.5
        assert (math.log(fused.size_m) - expected) / std == pytest.approx(0, abs=2e-2)
        assert fused.std_m / fused.size_m == pytest.approx(std, rel=2e-2)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("count", [0, 1], ids=["no detection", "a stranger"])
def test_a_camera_alone_is_enough(count, method):
    depth = ims.ObjectDepths([5.0] * count, kind="metric", image_size=(4000, 3000))
    stranger = [ims.Detection("statue", (100.0, 100.0, 200.0, 300.0))] * count
    camera = ims.Camera(2000.0, focal_rel_std=0.02)
    model = ims.fit(stranger, depth, table(), camera=camera, method=method)
    assert model.k == pytest.approx(1 / 2000, rel=1e-9)
    assert model.k_std / model.k == pytest.approx(0.02, rel=5e-3)


# --- never worse -------------------------------------------------------------------------------


def random_scene(rng, count, noise, wild):
    labels = list(rng.choice(list(LABELS), count + 1))
    sizes = []
    offset = {label: offset_std(label) * rng.normal() for label in LABELS}
    true = 1.0
    for label in labels:
        share, mean, variance, _, _ = moments(label)
        kind = rng.choice(share.size, p=share)
        true = math.exp(mean[kind] + offset[label] + math.sqrt(variance[kind]) * rng.normal())
        sizes.append(true * math.exp(noise * rng.normal()))
    if wild:
        sizes = list(np.array(sizes) * np.exp(0.4 * rng.normal(size=count + 1)))
    return labels, sizes, true


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("wild", [False, True], ids=["honest", "conflicting"])
def test_a_fused_size_is_never_wider_than_its_prior_alone(wild, method):
    rng = np.random.default_rng(31)
    wider = []
    for number in range(120):
        noise = float(rng.choice([0.01, 0.05, 0.2]))
        labels, sizes, _ = random_scene(rng, int(rng.integers(1, 6)), noise, wild)
        target = (labels[-1], sizes[-1])
        _, _, fused = sized(labels[:-1], sizes[:-1], method, noise, target=target)
        low, high = prior_quantiles(target[0])
        if fused.std_m / fused.size_m > (high - low) / 2 * (1 + 1e-3):
            wider.append((number, 0.68, fused.std_m / fused.size_m / ((high - low) / 2)))
        low, high = prior_quantiles(target[0], (0.05, 0.95))
        if log_width(fused, 0.9) > (high - low) * (1 + 5e-3):
            wider.append((number, 0.9, log_width(fused, 0.9) / (high - low)))
    assert not wider, f"{len(wider)}: {wider}"


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("noise", [0.02, 0.05, 0.15])
def test_fusing_errs_less_than_the_prior_and_than_the_measurement(noise, method):
    rng = np.random.default_rng(17)
    errors, covered = [], []
    for _ in range(120):
        labels, sizes, true = random_scene(rng, int(rng.integers(1, 5)), noise, wild=False)
        _, plain, fused = sized(
            labels[:-1], sizes[:-1], method, noise, target=(labels[-1], sizes[-1])
        )
        errors.append([
            math.log(fused.size_m / true),
            math.log(plain.size_m / true),
            prior_quantiles(labels[-1], [0.5])[0] - math.log(true),
        ])  # fmt: skip
        low, high = fused.interval(0.9)
        covered.append(low <= true <= high)
    squared = np.mean(np.square(errors), axis=0)
    assert squared[0] <= squared[1]
    assert squared[0] <= squared[2]
    # 120 images: 2.7 points; all references are sound, though the model allows for wrong ones
    assert 0.83 <= np.mean(covered) <= 0.98


# --- which rows are fused ----------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_a_reference_counts_its_prior_once(method):
    labels, sizes = ["idol", "jar", "jar", "chest"], [2.05, 1.15, 1.25, 0.74]
    model, plain, fused = sized(
        labels, sizes, method, target=("chest", 0.74), reference_target=True
    )
    assert Flag.REFERENCE in fused.flags
    assert Flag.PRIOR_USED in fused.flags
    assert model.references[-1].posterior_m == pytest.approx(fused.size_m, rel=1e-6)
    assert model.references[-1].posterior_std_m == pytest.approx(fused.std_m, rel=1e-6)
    # the same from the others alone, to which it is new
    _, _, new = sized(labels[:-1], sizes[:-1], method, target=("chest", 0.74))
    assert Flag.REFERENCE not in new.flags
    tolerance = 5e-3 if method == "posterior" else 2e-2
    assert fused.size_m == pytest.approx(new.size_m, rel=tolerance)
    assert fused.std_m == pytest.approx(new.std_m, rel=2e-2 if method == "posterior" else 6e-2)
    assert plain.flags == Flag.REFERENCE


@pytest.mark.parametrize("method", METHODS)
def test_a_reference_that_was_rejected_keeps_its_measurement(method):
    labels, sizes = ["idol", "jar", "jar", "jar", "idol", "jar"], [2.0, 1.2, 1.2, 1.2, 2.0, 0.55]
    model, plain, fused = sized(labels, sizes, method, target=("jar", 0.55), reference_target=True)
    assert model.references[-1].reason == "outlier"
    assert Flag.PRIOR_USED not in fused.flags
    assert fused == plain
    assert fused.size_m == pytest.approx(0.55, rel=0.05)


@pytest.mark.parametrize("method", METHODS)
def test_a_partial_object_is_measured_as_it_is_seen(method):
    labels, sizes = ["idol", "jar", "jar"], [2.0, 1.2, 1.25]
    told = ims.Noise(box_px=0.0, depth_rel=0.05)
    seen = detections(labels, np.array(sizes) / (TRUE_K * 5))
    model = ims.fit(
        seen, ims.ObjectDepths(np.full(3, 5.0), kind="relative"), table(), noise=told, method=method
    )
    cut = detections(["idol"], [1.0 / (TRUE_K * 5)], partial=True)
    where = ims.ObjectDepths([5.0], kind="relative")
    fused = ims.predict(model, cut, where, use_prior=True)[0]
    assert fused == ims.predict(model, cut, where)[0]
    assert fused.flags == Flag.PARTIAL


@pytest.mark.parametrize("method", METHODS)
def test_without_a_depth_the_prior_is_told_with_what_its_label_showed(method):
    # two chests among exact jars showed 10 % more than the table; its error of the mean is 5 %
    labels, sizes = ["jar"] * 6 + ["chest"] * 2, [1.2] * 6 + [0.77] * 2
    told = ims.Noise(box_px=0.0, depth_rel=0.02)
    seen = detections(labels, np.array(sizes) / (TRUE_K * 5))
    model = ims.fit(
        seen, ims.ObjectDepths(np.full(8, 5.0), kind="relative"), table(), noise=told, method=method
    )
    what = detections(["chest", "idol", "statue"], [100.0, 100.0, 100.0])
    where = ims.ObjectDepths([math.nan] * 3, kind="relative")
    chest, idol, statue = ims.predict(model, what, where, use_prior=True)
    for size in (chest, idol):
        assert size.flags == Flag.NO_DEPTH | Flag.PRIOR_USED
        assert math.isnan(size.metres_per_pixel)
    assert 0.7 < chest.size_m < 0.77
    low, high = prior_quantiles("chest")
    assert chest.std_m / chest.size_m < (high - low) / 2
    low, high = prior_quantiles("idol")
    assert idol.size_m == pytest.approx(math.exp((low + high) / 2), rel=1e-3)
    assert idol.std_m / idol.size_m == pytest.approx((high - low) / 2, rel=1e-2)
    assert math.isnan(statue.size_m)
    assert statue.flags == Flag.NO_DEPTH
    assert all(math.isnan(size.size_m) for size in ims.predict(model, what, where))


@pytest.mark.parametrize("method", ["mean_ratio", "least_squares"])
def test_the_papers_methods_have_no_joint_fit(method):
    labels, sizes = ["idol", "jar"], [2.0, 1.2]
    with pytest.raises(ValueError, match="`use_prior` must be False"):
        sized(labels, sizes, method, target=("idol", 2.0))


@pytest.mark.parametrize("method", METHODS)
def test_leaving_one_out_fuses_as_prediction_does(method):
    labels, sizes = ["idol", "jar", "jar", "chest"], [2.05, 1.15, 1.25, 0.74]
    told = ims.Noise(box_px=0.0, depth_rel=0.05)
    seen = detections(labels, np.array(sizes) / (TRUE_K * 5))
    depth = ims.ObjectDepths(np.full(4, 5.0), kind="relative")
    found = ims.leave_one_out(seen, depth, table(), use_prior=True, noise=told, method=method)
    for row in range(4):
        others = [i for i in range(4) if i != row]
        _, _, new = sized(
            [labels[i] for i in others],
            [sizes[i] for i in others],
            method,
            target=(labels[row], sizes[row]),
        )
        assert Flag.PRIOR_USED in found[row].flags
        assert found[row].size_m == pytest.approx(new.size_m, rel=1e-3)
        assert found[row].std_m == pytest.approx(new.std_m, rel=1e-2)
