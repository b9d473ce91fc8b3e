"""Arrow tables with an image per row: the numbers of a frame, whatever the lists are made of."""

import pickle
import subprocess
import sys
from functools import partial

import numpy as np
import pytest

import imgscale as ims
from imgscale.batch import fit_arrow, fit_columns, fit_table

pa = pytest.importorskip("pyarrow", reason="pyarrow is not installed")

PER_IMAGE = ["k", "k_std", "flags", "n_used"]
PER_OBJECT = ["size_m", "low_m", "high_m", "weight", "reason"]
LISTS = ["label", "pixels", "depth", "cut"]
NOISE = ims.Noise(box_px=2.0, depth_rel=0.05)


def some_images(n_images=60, seed=1):
    """Images of 0 to 8 objects; every seventh has null for lists."""
    rng = np.random.default_rng(seed)
    rows = []
    for image in range(n_images):
        count = int(rng.integers(0, 9))
        label = rng.choice(["person", "car", "door", "statue"], count)
        true_m = np.select([label == "person", label == "car", label == "door"], [1.7, 1.5, 2], 2.6)
        depth = rng.uniform(4, 40, count)
        pixels = 700 * true_m / depth * np.exp(rng.normal(0, 0.06, count))
        pixels[rng.random(count) < 0.08] *= 0.4
        lists = {
            "label": [None if rng.random() < 0.05 else str(name) for name in label],
            "pixels": pixels.tolist(),
            "depth": [None if rng.random() < 0.1 else float(one) for one in depth],
            "cut": (rng.random(count) < 0.1).tolist(),
        }
        if image % 7 == 3:
            lists = dict.fromkeys(LISTS)
        rows.append({"file": f"{image}.jpg", **lists})
    return pa.Table.from_pylist(rows)


def fitted(table, **options):
    return fit_arrow(table, **{"kind": "relative", "partial": "cut", "noise": NOISE, **options})


def as_type(table, lists, children=None):
    """The same lists in other types."""
    children = children or {}
    for name in LISTS:
        child = children.get(name, table.schema.field(name).type.value_type)
        column = pa.chunked_array([pa.array(table[name].to_pylist(), lists(child))])
        table = table.set_column(table.column_names.index(name), name, column)
    return table


def results(table):
    """The new columns as built-in types, NaN as None so that they compare."""
    return [
        {name: without_nan(row[name]) for name in (*PER_IMAGE, *PER_OBJECT)}
        for row in table.to_pylist()
    ]


def assert_same(found, wanted):
    """Compare results to the last digits, which hang on the order of labels."""
    assert [row["reason"] for row in found] == [row["reason"] for row in wanted]
    for got, row in zip(found, wanted, strict=True):
        for name in (*PER_IMAGE, *PER_OBJECT[:-1]):
            numbers = (np.array(values[name], dtype=np.float64) for values in (got, row))
            np.testing.assert_allclose(*numbers, rtol=1e-12)


def without_nan(value):
    if isinstance(value, list):
        return [without_nan(one) for one in value]
    return None if value != value else value  # noqa: PLR0124 - NaN


# --- the numbers ---


@pytest.mark.parametrize("method", ["robust", "posterior"])
def test_every_image_has_the_numbers_of_fit_and_predict(method):
    table = some_images()
    priors = ims.PriorTable([row for row in ims.PriorTable.default() if row.axis == "height"])
    seen = 0
    for row in fitted(table, method=method, level=0.8).to_pylist():
        labels = row["label"] or []
        detections = [
            ims.Detection(label or "unnamed", (50, 50, 60, 50 + pixels), partial=cut)
            for label, pixels, cut in zip(
                labels, row["pixels"] or [], row["cut"] or [], strict=True
            )
        ]
        values = [np.nan if one is None else one for one in row["depth"] or []]
        depth = ims.ObjectDepths(values, kind="relative")
        try:
            model = ims.fit(detections, depth, priors, method=method, noise=NOISE)
        except ims.FitError:
            assert np.isnan(row["k"])
            assert row["n_used"] == 0
            assert all(np.isnan(row["size_m"] or []))
            continue
        sizes = ims.predict(model, detections, depth)
        seen += 1
        assert row["k"] == pytest.approx(model.k, rel=1e-9)
        assert row["k_std"] == pytest.approx(model.k_std, rel=1e-9)
        assert row["flags"] == model.flags.value
        assert row["n_used"] == sum(reference.used for reference in model.references)
        assert row["reason"] == [reference.reason for reference in model.references]
        weights = [reference.weight for reference in model.references]
        assert row["weight"] == pytest.approx(weights, rel=1e-9, abs=1e-12)
        ends = [(size.size_m, *size.interval(0.8)) for size in sizes]
        got = list(zip(row["size_m"], row["low_m"], row["high_m"], strict=True))
        np.testing.assert_allclose(got, ends, rtol=1e-9)
    assert seen > 30


def test_lists_have_the_numbers_of_the_same_objects_in_rows():
    pytest.importorskip("narwhals", reason="narwhals is not installed")
    table = some_images()
    flat = pa.Table.from_pylist(
        [
            {"image_id": number, **dict(zip(LISTS, values, strict=True))}
            for number, row in enumerate(table.to_pylist())
            for values in zip(*(row[name] or [] for name in LISTS), strict=True)
        ]
    )
    rows = fit_table(flat, kind="relative", partial="cut", noise=NOISE)
    nested = fitted(table)
    for name in PER_OBJECT:
        entries = pa.chunked_array(nested[name]).combine_chunks().flatten()
        assert without_nan(entries.to_pylist()) == without_nan(rows[name].to_pylist())


# --- the table ---


def test_rows_and_columns_stay_and_the_new_ones_follow():
    table = some_images().replace_schema_metadata({"made by": "a camera"})
    sized = fitted(table)
    assert sized.column_names == [*table.column_names, *PER_IMAGE, *PER_OBJECT]
    assert sized.select(table.column_names).equals(table, check_metadata=True)
    assert sized.schema.metadata == table.schema.metadata
    sized.validate(full=True)


def test_new_columns_have_the_types_that_are_promised():
    schema = fitted(some_images()).schema
    assert [schema.field(name).type for name in PER_IMAGE] == [
        pa.float64(),
        pa.float64(),
        pa.int64(),
        pa.int64(),
    ]
    numbers = {schema.field(name).type for name in PER_OBJECT[:-1]}
    assert numbers == {pa.list_(pa.float64())}
    assert schema.field("reason").type == pa.list_(pa.string())
    assert fitted(some_images().slice(0, 0)).schema == schema
    assert fitted(some_images().slice(3, 1)).schema == schema


def test_lists_are_null_or_empty_where_those_of_the_pixels_are():
    sized = fitted(some_images()).to_pylist()
    assert {len(row["pixels"] or []) for row in sized} == set(range(9))
    assert sum(row["pixels"] is None for row in sized) == 9
    for row in sized:
        for name in PER_OBJECT:
            lengths = None if row["pixels"] is None else len(row["pixels"])
            assert (None if row[name] is None else len(row[name])) == lengths


@pytest.mark.parametrize(
    "cut",
    [
        pytest.param([(5, 20)], id="a slice"),
        pytest.param([(0, 1), (1, 0), (1, 30), (31, 29)], id="chunks"),
        pytest.param([(50, 10), (0, 50)], id="slices in another order"),
        pytest.param([(3, 1)], id="null alone"),
        pytest.param([(0, 0)], id="nothing"),
    ],
)
def test_slices_and_chunks_have_the_results_of_their_rows(cut):
    table = some_images()
    whole = results(fitted(table))
    parts = pa.concat_tables([table.slice(start, length) for start, length in cut])
    wanted = [row for start, length in cut for row in whole[start : start + length]]
    assert_same(results(fitted(parts)), wanted)


@pytest.mark.parametrize(
    ("lists", "children"),
    [
        pytest.param(pa.large_list, {"label": pa.large_string()}, id="large lists"),
        pytest.param(pa.list_view, {"label": pa.string_view()}, id="views"),
        pytest.param(pa.large_list_view, {}, id="large views"),
        pytest.param(pa.list_, {"label": pa.dictionary(pa.uint8(), pa.string())}, id="dictionary"),
    ],
)
def test_other_types_of_lists_and_labels_have_the_same_results(lists, children):
    table = some_images()
    other = as_type(table, lists, children)
    assert other.schema != table.schema
    sized = fitted(other)
    assert_same(results(sized), results(fitted(table)))
    is_large = lists in {pa.large_list, pa.large_list_view}
    assert pa.types.is_large_list(sized.schema.field("reason").type) == is_large
    sized.validate(full=True)


def test_lists_of_one_length_may_have_a_fixed_one():
    rows = [row for row in some_images(300).to_pylist() if len(row["pixels"] or []) == 3]
    table = pa.Table.from_pylist([*rows, {"file": "none", **dict.fromkeys(LISTS)}])
    fixed = as_type(table, lambda child: pa.list_(child, 3))
    assert_same(results(fitted(fixed)), results(fitted(table)))
    assert_same(results(fitted(fixed.slice(4, 5))), results(fitted(table))[4:9])


def test_numbers_of_other_types_are_read_as_numbers():
    table = some_images()
    cents = table["pixels"].cast(pa.list_(pa.decimal128(12, 4)), safe=False)
    other = as_type(table, pa.list_, {"depth": pa.float32()}).set_column(2, "pixels", cents)
    compared = zip(results(fitted(other)), results(fitted(table)), strict=True)
    for got, wanted in compared:
        if wanted["k"] is not None:
            assert got["k"] == pytest.approx(wanted["k"], rel=1e-5)


def test_every_chunk_may_have_a_dictionary_of_its_own():
    table = some_images()
    labels = [table["label"].slice(start, 20).combine_chunks().to_pylist() for start in (0, 20, 40)]
    kind = pa.list_(pa.dictionary(pa.int8(), pa.string()))
    chunks = pa.chunked_array([pa.array(part[::-1], kind)[::-1] for part in labels])
    other = table.set_column(1, "label", chunks)
    assert_same(results(fitted(other)), results(fitted(table)))


def test_null_in_a_dictionary_is_no_label():
    names = pa.DictionaryArray.from_arrays(pa.array([0, 1, None, 0]), pa.array(["door", None]))
    table = pa.table(
        {
            "label": pa.ListArray.from_arrays(pa.array([0, 4]), names),
            "pixels": [[200.0, 90.0, 80.0, 190.0]],
            "depth": [[4.0, 5.0, 6.0, 4.0]],
        }
    )
    sized = fit_arrow(table, kind="relative")
    assert sized["reason"].to_pylist() == [["", "no prior", "no prior", ""]]


def test_columns_of_null_alone_are_unknown_labels_and_depths():
    table = pa.table({"label": [[None] * 2], "pixels": [[90.0, 80.0]], "depth": [[None] * 2]})
    sized = fit_arrow(table, kind="metric")
    assert sized["reason"].to_pylist() == [["no prior", "no prior"]]
    assert np.isnan(sized["k"][0].as_py())


def test_references_at_one_depth_do_not_tell_a_shift():
    one = {"label": ["door", "car", "statue"], "pixels": [90.0, 70.0, 50.0], "depth": [2.0] * 3}
    sized = fit_arrow(pa.Table.from_pylist([one]), kind="affine_inverse")
    assert sized["reason"].to_pylist() == [["one depth", "one depth", "no prior"]]
    assert np.isnan(sized["k"].to_pylist() + sized["size_m"].to_pylist()[0]).all()


def test_it_is_a_pure_function_that_can_be_sent_elsewhere():
    table = some_images()
    before = table.to_pylist()
    job = partial(fit_arrow, priors=ims.PriorTable.default(), kind="relative", partial="cut")
    sent = pickle.loads(pickle.dumps(job))  # noqa: S301 - our own bytes
    assert results(sent(table)) == results(job(table))
    assert table.to_pylist() == before


# --- what is refused ---


@pytest.mark.parametrize("other", [None, {"label": []}, np.zeros(3), some_images().to_batches()[0]])
def test_what_is_no_table_is_refused(other):
    with pytest.raises(TypeError, match=r"must be a pyarrow\.Table; got .*from_batches"):
        fitted(other)


@pytest.mark.parametrize("name", LISTS)
def test_a_column_without_lists_is_refused(name):
    table = some_images()
    flat = table.set_column(table.column_names.index(name), name, pa.array(["x"] * 60))
    argument = "partial" if name == "cut" else name
    with pytest.raises(TypeError, match=rf"`{argument}` must.*lists.*got string.*fit_table"):
        fitted(flat)


@pytest.mark.parametrize("argument", ["label", "pixels", "depth", "partial"])
def test_a_missing_column_is_named_beside_those_that_are_there(argument):
    with pytest.raises(ValueError, match=rf'`{argument}` must.*"nowhere" and "file", "label"'):
        fitted(some_images(), **{argument: "nowhere"})


@pytest.mark.parametrize("name", [*PER_IMAGE, *PER_OBJECT])
def test_a_column_that_the_result_adds_must_not_be_there(name):
    table = some_images().append_column(name, pa.nulls(60))
    with pytest.raises(ValueError, match=rf'got "{name}"\. Rename or drop'):
        fitted(table)


def test_a_result_is_not_fitted_twice():
    with pytest.raises(ValueError, match=r'got "k", "k_std", "flags", "n_used", "size_m"'):
        fitted(fitted(some_images()))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        pytest.param({"pixels": None}, r"positive; got NaN or null .*row 2, entry 1", id="null"),
        pytest.param({"pixels": -4.0}, r"positive; got -4\.0 .*row 2, entry 1", id="negative"),
        pytest.param({"depth": 0.0}, r"`depth`.*got 0\.0 .*row 2, entry 1", id="no depth"),
        pytest.param({"depth": float("inf")}, r"`depth`.*got inf.*row 2, entry 1", id="infinite"),
        pytest.param({"cut": None}, r"`partial`.*got null.*row 2, entry 1", id="partial"),
    ],
)
@pytest.mark.parametrize("slab", [pytest.param(0, id="whole"), pytest.param(1, id="sliced")])
def test_an_unlawful_entry_is_refused_by_its_place(change, message, slab):
    one = {"label": ["door"], "pixels": [100.0], "depth": [4.0], "cut": [False]}
    bad = {name: [values[0], change.get(name, values[0])] for name, values in one.items()}
    table = pa.Table.from_pylist([one] * slab + [one, dict.fromkeys(LISTS), bad, one])
    with pytest.raises(ValueError, match=message):
        fitted(table.slice(slab))


@pytest.mark.parametrize("name", ["label", "depth", "cut"])
def test_lists_of_unequal_length_are_refused_by_their_row(name):
    one = {"label": ["door"], "pixels": [100.0], "depth": [4.0], "cut": [False]}
    table = pa.Table.from_pylist([one, {**one, name: []}, {**one, name: None}])
    argument = "partial" if name == "cut" else name
    with pytest.raises(
        ValueError, match=rf'`{argument}`.*got 0 in column "{name}" and 1 in.*row 1'
    ):
        fitted(table)


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        pytest.param("label", [3], "`label` must hold strings; got lists of int64", id="label"),
        pytest.param("depth", ["far"], "`depth` must hold numbers; got lists of str", id="depth"),
        pytest.param("cut", [1], "`partial` must hold truth values; got int64", id="partial"),
    ],
)
def test_entries_of_another_type_are_refused(name, values, message):
    one = {"label": ["door"], "pixels": [100.0], "depth": [4.0], "cut": [False], name: values}
    with pytest.raises(TypeError, match=message):
        fitted(pa.Table.from_pylist([one]))


@pytest.mark.parametrize("depth", [pytest.param([400, 500], id="all"), [400, None]])
def test_metres_as_a_file_stores_them_are_refused(depth):
    table = pa.table({"label": [["door"] * 2], "pixels": [[90, 80]], "depth": [depth]})
    with pytest.raises(ValueError, match=r"floating point; got dtype int64.*KITTI 256"):
        fit_arrow(table, kind="metric")
    assert fit_arrow(table, kind="inverse")["n_used"].to_pylist() == [2 - depth.count(None)]


def test_without_pyarrow_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ims.MissingDependencyError, match=r"imgscale\[arrow\]"):
        fit_arrow(None, kind="relative")


# --- what it costs ---


@pytest.mark.slow
def test_no_object_is_touched_by_python():
    code = """
import sys, numpy as np, pyarrow as pa
from imgscale.batch import fit_arrow
import imgscale as ims
counts = []
for n in (2_000, 20_000):
    offsets = pa.array(np.arange(0, 5 * n + 1, 5), pa.int32())
    nest = lambda values: pa.ListArray.from_arrays(offsets, values)
    table = pa.table({
        "label": nest(pa.array(["door", "car", "person", "tree", "car"] * n)),
        "pixels": nest(pa.array(np.full(5 * n, 100.0))),
        "depth": nest(pa.array(np.full(5 * n, 9.0))),
    })
    lines = 0
    def count(frame, event, _):
        global lines
        lines += event == "line"
        return count
    sys.settrace(count)
    fit_arrow(table, kind="relative", noise=ims.Noise(depth_rel=0.05))
    sys.settrace(None)
    counts.append(lines)
print(*counts)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    few, many = map(int, done.stdout.split())
    assert many < 2 * few  # ten times the objects, no more lines but for a further slab


def test_the_columns_are_those_of_fit_columns():
    table = some_images()
    rows = [row for row in table.to_pylist() if row["pixels"]]
    joined = {name: [one for row in rows for one in row[name]] for name in LISTS}
    codes = {"person": 0, "car": 1, "door": 2, "statue": 3, None: -1}
    found = fit_columns(
        np.repeat(np.arange(len(rows)), [len(row["pixels"]) for row in rows]),
        [codes[name] for name in joined["label"]],
        joined["pixels"],
        np.array(joined["depth"], dtype=np.float64),
        kind="relative",
        labels=["person", "car", "door", "statue"],
        partial=joined["cut"],
        noise=NOISE,
    )
    sized = fitted(table)
    entries = sized["size_m"].combine_chunks().flatten().to_numpy()
    np.testing.assert_allclose(entries, found.rows.size_m, rtol=1e-12)
