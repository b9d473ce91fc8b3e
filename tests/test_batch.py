"""Batches give the numbers of single images, in any order, and bad rows are named."""

import re
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import imgscale as ims
from imgscale.batch import REASONS, fit_columns

HEIGHTS = {"car": 1.5, "person": 1.72, "bus": 3.1, "door": 2.0, "statue": 1.3, "bicycle": 1.05}
NAMES = list(HEIGHTS)
UPRIGHT = ims.PriorTable([row for row in ims.PriorTable.default() if row.axis == "height"])
TOLD, UNTOLD = ims.Noise(depth_rel=0.06), ims.Noise()
KINDS = {
    "metric": lambda z: z,
    "relative": lambda z: z / 3,
    "inverse": lambda z: 50 / z,
    "affine_inverse": lambda z: 50 / z + 3,
}


def scene(rng, n_images, *, most=11):
    """Columns of a batch: ids, codes, pixels, z-depths and partial boxes."""
    counts = rng.integers(1, most + 1, n_images)
    image = np.repeat(np.arange(n_images), counts)
    code = rng.integers(0, len(NAMES), image.size)
    z = rng.uniform(3, 40, image.size)
    pixels = np.array(list(HEIGHTS.values()))[code] * 1000 / z * rng.lognormal(0, 0.08, z.size)
    wrong = rng.random(z.size) < 0.1
    pixels[wrong] *= rng.lognormal(0, 0.7, int(wrong.sum()))
    depth = z * rng.lognormal(0, 0.05, z.size)
    depth[rng.random(z.size) < 0.05] = np.nan
    return image, code, pixels, depth, rng.random(z.size) < 0.05


def one_image(code, pixels, depth, partial, *, kind, **options):
    """What `fit` and `predict` say of one image, as `fit_columns` gives it."""
    detections = [
        ims.Detection(NAMES[label], (0.0, 0.0, height / 2, height), partial=bool(cut))
        for label, height, cut in zip(code, pixels, partial, strict=True)
    ]
    depths = ims.ObjectDepths(depth, kind=kind)
    try:
        model = ims.fit(detections, depths, UPRIGHT, **options)
    except ims.FitError:
        return None
    sizes = ims.predict(model, detections, depths)
    ends = [size.interval(0.9) for size in sizes]
    rows = {
        "size_m": [size.size_m for size in sizes],
        "std_m": [size.std_m for size in sizes],
        "low_m": [low for low, _ in ends],
        "high_m": [high for _, high in ends],
        "weight": [ref.weight for ref in model.references],
        "flags": [size.flags.value for size in sizes],
        "reason": [REASONS.index(ref.reason) for ref in model.references],
    }
    images = {
        "k": model.k,
        "k_std": model.k_std,
        "shift": model.shift,
        "flags": model.flags.value,
        "n_objects": len(detections),
        "n_candidates": sum(ref.candidate for ref in model.references),
        "n_used": sum(ref.used for ref in model.references),
    }
    return images, rows


def assert_same_as_alone(found, columns, **options):
    image, code, pixels, depth, partial = columns
    for place, number in enumerate(found.images.image_id):
        here = image == number
        alone = one_image(code[here], pixels[here], depth[here], partial[here], **options)
        if alone is None:
            assert np.isnan(found.images.k[place])
            assert np.isnan(found.rows.size_m[here]).all()
            assert found.images.n_used[place] == 0
            continue
        for name, value in alone[0].items():
            mine = getattr(found.images, name)[place]
            np.testing.assert_allclose(mine, value, rtol=1e-9, err_msg=name)
        # towards the horizon the upper end runs away, and rounding with it
        runs_away = np.array(alone[1]["high_m"]) > 3 * np.array(alone[1]["size_m"])
        for name, values in alone[1].items():
            mine, wanted = getattr(found.rows, name)[here], np.array(values)
            close = {"rtol": 1e-9, "atol": 1e-12, "err_msg": name}
            np.testing.assert_allclose(mine[~runs_away], wanted[~runs_away], **close)
            np.testing.assert_allclose(mine[runs_away], wanted[runs_away], **close | {"rtol": 1e-6})


@pytest.mark.parametrize("noise", [TOLD, UNTOLD], ids=["told", "untold"])
@pytest.mark.parametrize("method", ["robust", "posterior", "mean_ratio", "least_squares"])
@pytest.mark.parametrize("kind", ["metric", "relative", "inverse"])
@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_a_batch_gives_what_each_image_gives_alone(kind, method, noise, seed):
    image, code, pixels, z, partial = scene(np.random.default_rng(seed), 12)
    columns = image, code, pixels, KINDS[kind](z), partial
    options = {"kind": kind, "noise": noise, "method": method}

    found = fit_columns(*columns[:4], UPRIGHT, labels=NAMES, partial=partial, **options)

    assert_same_as_alone(found, columns, **options)


@pytest.mark.parametrize("noise", [TOLD, UNTOLD], ids=["told", "untold"])
@pytest.mark.parametrize("method", ["robust", "posterior"])
@settings(max_examples=2, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_shifts_are_those_of_each_image_alone(method, noise, seed):
    image, code, pixels, z, partial = scene(np.random.default_rng(seed), 5)
    columns = image, code, pixels, KINDS["affine_inverse"](z), partial
    options = {"kind": "affine_inverse", "noise": noise, "method": method}

    found = fit_columns(*columns[:4], UPRIGHT, labels=NAMES, partial=partial, **options)

    assert_same_as_alone(found, columns, **options)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), step=st.integers(1, 1000))
def test_order_and_names_of_images_do_not_matter(seed, step):
    rng = np.random.default_rng(seed)
    image, code, pixels, depth, partial = scene(rng, 30)
    order = rng.permutation(image.size)
    sort = fit_columns(
        image, code, pixels, depth, UPRIGHT,
        labels=NAMES, partial=partial, kind="metric", noise=TOLD,
    )  # fmt: skip
    mixed = fit_columns(
        (image * step - 7)[order], code[order], pixels[order], depth[order], UPRIGHT,
        labels=NAMES, partial=partial[order], kind="metric", noise=TOLD,
    )  # fmt: skip

    np.testing.assert_array_equal(mixed.images.image_id, sort.images.image_id * step - 7)
    for name in ("k", "k_std", "flags", "n_used", "n_candidates"):
        mine, wanted = getattr(mixed.images, name), getattr(sort.images, name)
        np.testing.assert_allclose(mine, wanted, rtol=1e-11, err_msg=name)
    for name in sort.rows._fields:
        mine, wanted = getattr(mixed.rows, name), getattr(sort.rows, name)[order]
        np.testing.assert_allclose(mine, wanted, rtol=1e-9, atol=1e-12, err_msg=name)


def test_an_image_does_not_depend_on_its_neighbours_nor_on_how_often_it_comes():
    rng = np.random.default_rng(5)
    image, code, pixels, depth, _ = scene(rng, 1, most=6)
    alone = fit_columns(image, code, pixels, depth, UPRIGHT, labels=NAMES, kind="metric",
                        noise=TOLD)  # fmt: skip
    many = fit_columns(
        np.repeat(np.arange(3000), image.size), np.tile(code, 3000), np.tile(pixels, 3000),
        np.tile(depth, 3000), UPRIGHT, labels=NAMES, kind="metric", noise=TOLD,
    )  # fmt: skip

    np.testing.assert_allclose(many.images.k, alone.images.k[0], rtol=1e-12)
    assert (many.images.k == many.images.k[0]).all()
    np.testing.assert_allclose(many.rows.size_m, np.tile(alone.rows.size_m, 3000), rtol=1e-12)


def test_inputs_stay_as_they_were_and_twice_gives_the_same():
    image, code, pixels, depth, partial = scene(np.random.default_rng(6), 200)
    before = [column.copy() for column in (image, code, pixels, depth, partial)]
    for column in (image, code, pixels, depth, partial):
        column.flags.writeable = False
    options = {"labels": NAMES, "partial": partial, "kind": "metric", "noise": TOLD}

    first = fit_columns(image, code, pixels, depth, UPRIGHT, **options)
    second = fit_columns(image, code, pixels, depth, UPRIGHT, **options)

    for column, old in zip((image, code, pixels, depth, partial), before, strict=True):
        np.testing.assert_array_equal(column, old)
    for one, other in zip(
        (*first.images, *first.rows), (*second.images, *second.rows), strict=True
    ):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("dtype", ["f4", ">f8", "f2", "i8"])
def test_columns_of_other_types_are_read_as_they_are(dtype):
    pixels = np.array([200, 150, 90]).astype(dtype)
    depth = np.array([4, 4, 6]).astype(dtype)
    wanted = fit_columns([1, 1, 1], ["door"] * 3, [200.0, 150.0, 90.0], [4.0, 4.0, 6.0],
                         kind="relative")  # fmt: skip

    found = fit_columns([1, 1, 1], ["door"] * 3, pixels[::1], depth, kind="relative")

    np.testing.assert_array_equal(found.images.k, wanted.images.k)


def test_strings_and_codes_of_labels_are_the_same_and_aliases_share_a_mean():
    table = ims.PriorTable([ims.ObjectPrior("car", 1.5, 0.1, mean_std_m=0.1, aliases=("auto",))])
    words = ["car", "auto", "car", "AUTO"]
    pixels, depth = [150.0, 160.0, 140.0, 155.0], [10.0] * 4

    by_word = fit_columns([0] * 4, words, pixels, depth, table, kind="metric", noise=TOLD)
    by_code = fit_columns(
        [0] * 4, [1, 0, 1, 0], pixels, depth, table, labels=["auto", "car"], kind="metric",
        noise=TOLD,
    )  # fmt: skip
    model = ims.fit(
        [ims.Detection(word, (0, 0, 50, p)) for word, p in zip(words, pixels, strict=True)],
        ims.ObjectDepths(depth, kind="metric"), table, method="robust", noise=TOLD,
    )  # fmt: skip

    assert by_word.images.k == by_code.images.k
    assert by_word.images.k_std == pytest.approx(model.k_std, rel=1e-12)
    assert ims.Flag.SINGLE_LABEL in ims.Flag(int(by_word.images.flags[0]))


def test_an_object_without_label_has_no_prior_and_is_sized():
    found = fit_columns([0, 0], [0, -1], [200.0, 150.0], [4.0, 4.0], labels=["door"],
                        kind="relative", noise=TOLD)  # fmt: skip

    assert [REASONS[code] for code in found.rows.reason] == ["", "no prior"]
    assert found.rows.size_m[1] == pytest.approx(found.rows.size_m[0] * 0.75, rel=1e-12)


def test_references_at_one_depth_cannot_tell_a_shift_and_say_so():
    found = fit_columns([0, 0, 1, 1], ["door"] * 4, [200.0, 190.0, 200.0, 100.0],
                        [5.0, 5.0, 5.0, 2.0], kind="affine_inverse", noise=TOLD)  # fmt: skip

    assert np.isnan(found.images.k[0])
    assert found.images.k[1] > 0
    assert [REASONS[code] for code in found.rows.reason[:2]] == ["one depth", "one depth"]


@pytest.mark.parametrize("method", ["robust", "posterior", "mean_ratio"])
def test_nothing_gives_nothing(method):
    found = fit_columns([], [], [], [], kind="metric", method=method)

    assert all(column.shape == (0,) for column in (*found.images, *found.rows))


@pytest.mark.parametrize("method", ["robust", "posterior", "mean_ratio"])
def test_no_reference_anywhere_gives_no_scale(method):
    found = fit_columns([1, 2], ["zyx", "door"], [10.0, 20.0], [3.0, np.nan], kind="metric",
                        method=method)  # fmt: skip

    assert np.isnan(found.images.k).all()
    assert np.isnan(found.rows.size_m).all()
    assert [REASONS[code] for code in found.rows.reason] == ["no prior", "no depth"]


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"pixels": [10.0, 0.0]}, ValueError, "`pixels` must be finite and positive; got 0.0 at"),
        ({"pixels": [np.nan, 1.0]}, ValueError, "got nan at index 0"),
        ({"pixels": [np.inf, 1.0]}, ValueError, "got inf at index 0"),
        ({"depth": [1.0, -2.0]}, ValueError, "or NaN where unknown; got -2.0 at index 1"),
        ({"depth": [1.0, np.inf]}, ValueError, "got inf at index 1"),
        ({"depth": [1.0]}, ValueError, "(2,) as `image_id`; got the shape (1,)"),
        ({"depth": ["a", "b"]}, TypeError, "`depth` must be real numbers"),
        ({"depth": np.array([4, 5])}, ValueError, "floating point; got dtype int64"),
        ({"label": [0, 1]}, TypeError, "`labels` must name what the codes"),
        ({"label": [0, 2], "labels": ["car", "door"]}, ValueError, "got 2 at index 1"),
        ({"label": [0, -2], "labels": ["car", "door"]}, ValueError, "got -2 at index 1"),
        ({"label": [0.0, 1.0], "labels": ["car", "door"]}, TypeError, "integer codes"),
        ({"label": ["car", None]}, TypeError, "got None"),
        ({"partial": [0, 1]}, TypeError, "`partial` must be booleans"),
        ({"kind": "ground_plane"}, ValueError, "`kind`"),
        ({"kind": "affine_inverse", "method": "mean_ratio"}, ValueError, "whose shift is unknown"),
        ({"axis": "length"}, ValueError, "`axis`"),
        ({"level": 1.0}, ValueError, "`level`"),
        ({"noise": 0.1}, TypeError, "`noise`"),
        ({"depth_rel_std": -0.1}, ValueError, "`depth_rel_std` must be finite and not negative"),
        ({"depth_rel_std": 1 + 0j}, TypeError, "`depth_rel_std` must be finite and not negative"),
        ({"depth_rel_std": 1e200}, ValueError, "`depth_rel_std` must be at most 1e100"),
        ({"image_id": [0j, 1j]}, TypeError, "`image_id` must be integers or strings; got dtype"),
        ({"priors": [("car", 1.5)]}, TypeError, "PriorTable"),
    ],
)  # fmt: skip
def test_what_breaks_a_law_is_named(change, error, text):
    given_ = {
        "image_id": [0, 0], "label": ["car", "door"], "pixels": [10.0, 20.0],
        "depth": [4.0, 5.0], "kind": "metric",
    } | change  # fmt: skip

    with pytest.raises(error, match=re.escape(text)):
        fit_columns(**given_)


def test_a_bad_row_of_a_shuffled_batch_is_named_by_its_own_place():
    depth = np.array([4.0, 5.0, -6.0, 7.0])

    with pytest.raises(ValueError, match=r"got -6\.0 at index 2"):
        fit_columns([3, 1, 2, 0], ["door"] * 4, [10.0] * 4, depth, kind="metric")


def test_working_memory_does_not_grow_with_the_batch():
    extra = []
    for n_images in (100_000, 400_000):
        image = np.repeat(np.arange(n_images), 5)
        code = np.tile(np.arange(5, dtype=np.int16), n_images)
        rng = np.random.default_rng(0)
        depth = rng.uniform(3, 40, image.size)
        pixels = 1500 / depth * rng.lognormal(0, 0.1, image.size)
        tracemalloc.start()
        found = fit_columns(image, code, pixels, depth, UPRIGHT, labels=NAMES, kind="metric",
                            noise=TOLD)  # fmt: skip
        kept = sum(column.nbytes for column in (*found.images, *found.rows))
        extra.append(tracemalloc.get_traced_memory()[1] - kept)
        tracemalloc.stop()

    inputs = 26 * 5 * 400_000
    assert extra[1] < 0.6 * inputs + 60e6
    assert extra[1] - extra[0] < 0.3 * 26 * 5 * 300_000
