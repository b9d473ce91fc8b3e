"""Data frames of pandas, polars and pyarrow in, the same frames with sizes back."""

import subprocess
import sys

import numpy as np
import pytest

import imgscale as ims
from imgscale.batch import fit_columns, fit_table

pytest.importorskip("narwhals", reason="narwhals is not installed")

NEW = [
    "k",
    "k_std",
    "size_m",
    "std_m",
    "low_m",
    "high_m",
    "weight",
    "reason",
    "flags",
    "model_flags",
]
REASONS = {"", "no prior", "partial", "no depth", "outlier"}


def some_objects(n_images=40, seed=0):
    """Objects of many images, shuffled; every reason but one depth occurs."""
    rng = np.random.default_rng(seed)
    image = np.repeat(np.arange(n_images) * 7 + 3, rng.integers(1, 9, n_images))
    rng.shuffle(image)
    count = image.size
    label = rng.choice(["person", "car", "door", "statue"], count)
    true_m = np.select([label == "person", label == "car", label == "door"], [1.7, 1.5, 2.0], 2.6)
    depth = rng.uniform(4, 40, count)
    pixels = 700 * true_m / depth * np.exp(rng.normal(0, 0.05, count))
    pixels[rng.random(count) < 0.08] *= 0.4
    return {
        "photo": image.tolist(),
        "label": [None if rng.random() < 0.05 else str(name) for name in label],
        "pixels": pixels.tolist(),
        "depth": [None if rng.random() < 0.1 else float(one) for one in depth],
        "cut": (rng.random(count) < 0.1).tolist(),
        "note": [f"row {row}" for row in range(count)],
    }


def pandas_frame(data):
    pd = pytest.importorskip("pandas", reason="pandas is not installed")
    frame = pd.DataFrame(data)
    frame.index = frame.index[::-1] // 2  # neither sorted nor unique
    return frame


def pandas_extension_types(data):
    pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    return pandas_frame(data).astype(
        {
            "photo": "Int64",
            "label": "string[pyarrow]",
            "pixels": "Float64",
            "depth": "double[pyarrow]",
            "cut": "boolean",
        }
    )


def pandas_categories(data):
    return pandas_frame(data).astype({"label": "category", "photo": "category"})


def pandas_objects(data):
    return pandas_frame(data).astype({"label": object, "note": object})


def polars_frame(data):
    pl = pytest.importorskip("polars", reason="polars is not installed")
    return pl.DataFrame(data)


def polars_categories(data):
    pl = pytest.importorskip("polars", reason="polars is not installed")
    return polars_frame(data).with_columns(pl.col("label").cast(pl.Categorical))


def polars_enum(data):
    pl = pytest.importorskip("polars", reason="polars is not installed")
    kinds = pl.Enum(["statue", "door", "bus", "car", "person"])
    return polars_frame(data).with_columns(pl.col("label").cast(kinds))


def pyarrow_table(data):
    pa = pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    return pa.table(data)


def pyarrow_chunks(data):
    table = pyarrow_table(data)
    pa = pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    return pa.concat_tables([table.slice(0, 5), table.slice(5, 0), table.slice(5)])


def pyarrow_dictionaries(data):
    """Chunks of which each has a dictionary of its own."""
    pa = pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    table = pyarrow_table(data)
    chunks = [
        table["label"].slice(start, length).combine_chunks().dictionary_encode()
        for start, length in ((0, 4), (4, 9), (13, None))
    ]
    place = table.column_names.index("label")
    return table.set_column(place, "label", pa.chunked_array(chunks))


FRAMES = [
    pandas_frame,
    pandas_extension_types,
    pandas_categories,
    pandas_objects,
    polars_frame,
    polars_categories,
    polars_enum,
    pyarrow_table,
    pyarrow_chunks,
    pyarrow_dictionaries,
]
PLAIN = [pandas_frame, polars_frame, pyarrow_table]
NAMES = {"image_id": "photo", "partial": "cut"}


def column(frame, name):
    """The values of a column as built-in types, null as None."""
    values = frame[name]
    values = values.to_pylist() if hasattr(values, "to_pylist") else list(values)
    return [None if one is None or one != one else one for one in values]  # noqa: PLR0124 - NaN


def names_of(frame):
    return list(getattr(frame, "column_names", getattr(frame, "columns", ())))


def with_column(make, name, values, data=None):
    """A frame in which one column has other values."""
    return make({**(data or some_objects()), name: values})


def one_by_one(data, **options):
    """What `fit` and `predict` say of each object, image by image."""
    table = ims.PriorTable([row for row in ims.PriorTable.default() if row.axis == "height"])
    found = [{} for _ in data["photo"]]
    for photo in sorted(set(data["photo"])):
        rows = [row for row, other in enumerate(data["photo"]) if other == photo]
        detections = [
            ims.Detection(
                data["label"][row] or "a thing without a name",
                (50, 50, 60, 50 + data["pixels"][row]),
                partial=data["cut"][row],
            )
            for row in rows
        ]
        values = [np.nan if data["depth"][row] is None else data["depth"][row] for row in rows]
        depth = ims.ObjectDepths(values, kind=options["kind"])
        try:
            model = ims.fit(
                detections,
                depth,
                table,
                method=options.get("method", "robust"),
                noise=options.get("noise", ims.Noise()),
            )
        except ims.FitError:
            continue
        sizes = ims.predict(model, detections, depth)
        for row, reference, size in zip(rows, model.references, sizes, strict=True):
            low, high = size.interval(options.get("level", 0.9))
            found[row] = {
                "k": model.k,
                "k_std": model.k_std,
                "size_m": size.size_m,
                "std_m": size.std_m,
                "low_m": low,
                "high_m": high,
                "weight": reference.weight,
                "reason": reference.reason,
                "flags": size.flags.value,
                "model_flags": model.flags.value,
            }
    return found


# --- the numbers ---


@pytest.mark.parametrize("make", FRAMES)
def test_every_frame_has_the_numbers_of_fit_and_predict(make):
    data = some_objects()
    noise = ims.Noise(box_px=2.0, depth_rel=0.05)
    sized = fit_table(make(data), kind="relative", noise=noise, level=0.8, **NAMES)
    wanted = one_by_one(data, kind="relative", noise=noise, level=0.8)
    assert sum(map(bool, wanted)) > 100
    found = {name: column(sized, name) for name in NEW}
    assert set(found["reason"]) == REASONS
    for row, truth in enumerate(wanted):
        for name, value in truth.items():
            got = found[name][row]
            if isinstance(value, float) and not np.isnan(value):
                assert got == pytest.approx(value, rel=1e-9, abs=1e-12), (row, name)
            else:
                assert got == (None if value != value else value), (row, name)  # noqa: PLR0124
        if not truth:
            assert found["k"][row] is None
            assert found["size_m"][row] is None


@pytest.mark.parametrize("make", PLAIN)
def test_the_papers_mean_is_that_of_a_group_by(make):
    pd = pytest.importorskip("pandas", reason="pandas is not installed")
    data = some_objects()
    sized = fit_table(make(data), kind="metric", method="mean_ratio", **NAMES)
    rows = pd.DataFrame(data)
    heights = {
        prior.label: prior.mean_m
        for prior in ims.PriorTable.default()
        if prior.label == "door" and prior.axis == "height"
    }
    rows["alone"] = rows.label.map(heights) / rows.pixels / rows.depth
    rows["usable"] = rows.label.eq("door") & rows.depth.notna() & ~rows.cut
    doors = rows[rows.photo.isin(only_doors(rows))]
    mean = doors[doors.usable].groupby("photo").alone.mean()
    k = dict(zip(data["photo"], column(sized, "k"), strict=True))
    assert len(mean) > 0
    for photo, value in mean.items():
        assert k[photo] == pytest.approx(value, rel=1e-12)


def only_doors(rows):
    """Photos in which doors alone are known."""
    known = rows[rows.label.isin(["person", "car"]) & rows.depth.notna() & ~rows.cut]
    return set(rows.photo) - set(known.photo)


# --- the frame ---


@pytest.mark.parametrize("make", FRAMES)
def test_rows_and_columns_stay_as_they_were_and_the_new_ones_follow(make):
    frame, untouched = make(some_objects()), make(some_objects())
    sized = fit_table(frame, kind="relative", **NAMES)
    assert type(sized) is type(frame)
    assert names_of(sized) == [*names_of(frame), *NEW]
    assert len(sized) == len(frame)
    old = names_of(frame)
    if type(frame).__module__.startswith("pandas"):
        assert sized[old].equals(untouched)
        assert (sized[old].dtypes == untouched.dtypes).all()
        assert sized.index.equals(untouched.index)
        assert frame.equals(untouched)
    else:
        assert sized.select(old).equals(untouched)
        assert sized.select(old).schema == untouched.schema
        assert frame.equals(untouched)


def test_new_columns_have_plain_types():
    pa = pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    sized = fit_table(pyarrow_table(some_objects()), kind="relative", **NAMES)
    for name in ("k", "k_std", "size_m", "std_m", "low_m", "high_m", "weight"):
        assert sized.schema.field(name).type == pa.float64()
    assert sized.schema.field("reason").type == pa.string()
    assert pa.types.is_integer(sized.schema.field("flags").type)
    assert pa.types.is_integer(sized.schema.field("model_flags").type)


def test_an_index_of_several_levels_is_kept():
    frame = pandas_frame(some_objects()).set_index(["note", "cut"])
    assert fit_table(frame, kind="relative", image_id="photo").index.equals(frame.index)


@pytest.mark.parametrize("make", PLAIN)
def test_ids_may_be_strings(make):
    data = some_objects()
    strings = {**data, "photo": [f"folder/{number:05d}.jpg" for number in data["photo"]]}
    by_number = fit_table(make(data), kind="relative", **NAMES)
    by_string = fit_table(make(strings), kind="relative", **NAMES)
    for name in NEW:
        pairs = zip(column(by_string, name), column(by_number, name), strict=True)
        for got, wanted in pairs:
            is_number = name != "reason" and wanted is not None
            assert got == (pytest.approx(wanted, rel=1e-12) if is_number else wanted)


@pytest.mark.parametrize("make", PLAIN)
def test_the_order_of_the_rows_does_not_matter(make):
    data = some_objects()
    order = np.argsort(data["photo"], kind="stable").tolist()
    in_order = {name: [values[row] for row in order] for name, values in data.items()}
    options = {"kind": "relative", "noise": ims.Noise(depth_rel=0.05), **NAMES}
    mixed, sorted_ = fit_table(make(data), **options), fit_table(make(in_order), **options)
    sizes = column(mixed, "size_m")
    for got, row in zip(column(sorted_, "size_m"), order, strict=True):
        assert got == (None if sizes[row] is None else pytest.approx(sizes[row], rel=1e-9))


@pytest.mark.parametrize("make", PLAIN)
def test_a_frame_without_rows_stays_one(make):
    frame = make(some_objects())
    empty = frame.iloc[:0] if hasattr(frame, "iloc") else frame.slice(0, 0)
    sized = fit_table(empty, kind="relative", **NAMES)
    assert len(sized) == 0
    assert names_of(sized) == [*names_of(frame), *NEW]


def test_a_frame_of_pandas_without_any_type_stays_empty():
    pd = pytest.importorskip("pandas", reason="pandas is not installed")
    for dtype in (object, float):
        empty = pd.DataFrame({name: pd.Series([], dtype=dtype) for name in some_objects()})
        assert fit_table(empty, kind="relative", **NAMES).shape == (0, 16)


@pytest.mark.parametrize("make", PLAIN)
def test_columns_of_nothing_but_null_are_unknown_labels_and_depths(make):
    nothing = [None] * len(some_objects()["photo"])
    without = fit_table(with_column(make, "label", nothing), kind="relative", **NAMES)
    assert set(column(without, "reason")) == {"no prior"}
    without = fit_table(with_column(make, "depth", nothing), kind="relative", **NAMES)
    assert set(column(without, "reason")) == {"no prior", "partial", "no depth"}
    assert set(column(without, "size_m")) == {None}


@pytest.mark.parametrize("make", PLAIN)
def test_whole_numbers_will_do_where_they_are_no_stored_metres(make):
    data = some_objects()
    data["pixels"] = [round(one) for one in data["pixels"]]
    data["depth"] = [100 * row + 100 for row in range(len(data["photo"]))]
    floats = {**data, "depth": [float(one) for one in data["depth"]]}
    whole = fit_table(make(data), kind="inverse", **NAMES)
    assert column(whole, "size_m") == column(
        fit_table(make(floats), kind="inverse", **NAMES), "size_m"
    )
    with pytest.raises(ValueError, match=r"floating point; got dtype int64.*KITTI 256"):
        fit_table(make(data), kind="metric", **NAMES)
    data["depth"][3] = None  # pandas turns such a column into floats, the others do not
    if make is not pandas_frame:
        with pytest.raises(ValueError, match=r"floating point; got dtype int64.*KITTI 256"):
            fit_table(make(data), kind="metric", **NAMES)


def test_decimals_are_numbers():
    pl = pytest.importorskip("polars", reason="polars is not installed")
    frame = polars_frame({**some_objects(), "pixels": [100.0] * len(some_objects()["photo"])})
    decimal = frame.with_columns(pl.col("pixels").cast(pl.Decimal(9, 2)))
    assert fit_table(decimal, kind="relative", **NAMES)["size_m"].equals(
        fit_table(frame, kind="relative", **NAMES)["size_m"], null_equal=True
    )


# --- what is refused ---


def test_a_lazy_frame_is_refused_with_the_remedy():
    lazy = polars_frame(some_objects()).lazy()
    with pytest.raises(TypeError, match=r"LazyFrame of polars.*frame\.collect\(\)"):
        fit_table(lazy, kind="relative", **NAMES)


@pytest.mark.parametrize("other", [{"photo": [1]}, [1, 2], None, np.zeros((2, 3))])
def test_what_is_no_frame_is_refused(other):
    with pytest.raises(TypeError, match=r"must be a data frame.*fit_columns"):
        fit_table(other, kind="relative")


def test_a_single_column_is_no_frame():
    for make in (pandas_frame, polars_frame):
        with pytest.raises(TypeError, match=r"got Series"):
            fit_table(make(some_objects())["label"], kind="relative")


@pytest.mark.parametrize("make", PLAIN)
@pytest.mark.parametrize("argument", ["image_id", "label", "pixels", "depth", "partial"])
def test_a_missing_column_is_named_beside_those_that_are_there(make, argument):
    options = {**NAMES, argument: "nowhere"}
    with pytest.raises(ValueError, match=rf'`{argument}` must.*"nowhere" and "photo", "label"'):
        fit_table(make(some_objects()), kind="relative", **options)


def test_the_name_of_a_column_is_a_string():
    with pytest.raises(TypeError, match=r"`depth` must be the name of a column; got 3"):
        fit_table(pandas_frame(some_objects()), kind="relative", image_id="photo", depth=3)


@pytest.mark.parametrize("make", PLAIN)
@pytest.mark.parametrize("name", NEW)
def test_a_column_that_the_result_adds_must_not_be_there(make, name):
    nothing = [None] * len(some_objects()["photo"])
    with pytest.raises(ValueError, match=rf'got "{name}"\. Rename or drop'):
        fit_table(with_column(make, name, nothing), kind="relative", **NAMES)


def test_two_columns_of_one_name_are_refused():
    pd = pytest.importorskip("pandas", reason="pandas is not installed")
    frame = pandas_frame(some_objects())
    twice = pd.concat([frame, frame["label"]], axis=1)
    with pytest.raises(ValueError, match=r"two columns of one name; got .*'label'"):
        fit_table(twice, kind="relative", **NAMES)


@pytest.mark.parametrize("make", FRAMES)
@pytest.mark.parametrize(
    ("name", "message"),
    [
        pytest.param("photo", r'`image_id` must .*null in column "photo", row 4\.', id="id"),
        pytest.param("pixels", r'`pixels` must .*null in column "pixels", row 4\.', id="pixels"),
    ],
)
def test_null_is_refused_by_its_row(make, name, message):
    data = some_objects()
    data[name][4] = None
    with pytest.raises(ValueError, match=message):
        fit_table(make(data), kind="relative", **NAMES)


@pytest.mark.parametrize("make", [pandas_extension_types, polars_frame, pyarrow_table])
def test_null_beside_truth_values_is_refused_by_its_row(make):
    data = some_objects()
    data["cut"][4] = None
    with pytest.raises(ValueError, match=r'`partial` must .*null in column "cut", row 4\.'):
        fit_table(make(data), kind="relative", **NAMES)


@pytest.mark.parametrize("make", PLAIN)
@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        pytest.param("pixels", 0.0, r"positive; got 0\.0 in column.*row 9", id="no pixels"),
        pytest.param("pixels", -3.0, r"positive; got -3\.0 in column.*row 9", id="negative"),
        pytest.param("pixels", float("inf"), r"got inf in column.*row 9", id="infinite pixels"),
        pytest.param("depth", 0.0, r"`depth`.*positive.*got 0\.0.*row 9", id="no depth"),
        pytest.param("depth", float("inf"), r"`depth`.*got inf.*row 9", id="infinite depth"),
    ],
)
def test_an_unlawful_number_is_refused_by_its_row(make, name, value, message):
    data = some_objects()
    data[name][9] = value
    with pytest.raises(ValueError, match=message):
        fit_table(make(data), kind="relative", **NAMES)


@pytest.mark.parametrize("make", PLAIN)
@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        pytest.param("photo", 1.5, r"`image_id`.*integers or strings; got Float64", id="id"),
        pytest.param("label", 3, r"`label` must name a column of strings; got Int64", id="label"),
        pytest.param("depth", "far", r"`depth`.*column of numbers; got String", id="depth"),
        pytest.param("pixels", True, r"`pixels`.*column of numbers; got Boolean", id="pixels"),
        pytest.param("cut", 1, r"`partial`.*truth values; got Int64", id="partial"),
    ],
)
def test_a_column_of_another_type_is_refused(make, name, value, message):
    frame = with_column(make, name, [value] * len(some_objects()["photo"]))
    with pytest.raises(TypeError, match=message):
        fit_table(frame, kind="relative", **NAMES)


def test_categories_that_are_no_strings_are_no_labels():
    pd = pytest.importorskip("pandas", reason="pandas is not installed")
    count = len(some_objects()["photo"])
    frame = pandas_frame(some_objects()).assign(label=pd.Categorical([1] * count))
    with pytest.raises(TypeError, match=r"`label` must name a column of strings; got Categorical"):
        fit_table(frame, kind="relative", **NAMES)


@pytest.mark.parametrize("make", PLAIN)
def test_an_unknown_kind_is_refused(make):
    with pytest.raises(ValueError, match=r"`kind` must be one of"):
        fit_table(make(some_objects()), kind="stereo", **NAMES)


def test_without_narwhals_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "narwhals", None)
    with pytest.raises(ims.MissingDependencyError, match=r"imgscale\[frames\]"):
        fit_table(None, kind="relative")


def test_importing_the_batch_loads_no_library_of_frames():
    code = (
        "import sys, imgscale.batch;"
        "print({'narwhals', 'pandas', 'polars', 'pyarrow', 'ray'} & sys.modules.keys())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


# --- the frame and the columns ---


def test_a_frame_says_what_its_columns_say():
    data = some_objects()
    codes = {"person": 0, "car": 1, "door": 2, "statue": 3, None: -1}
    found = fit_columns(
        data["photo"],
        [codes[name] for name in data["label"]],
        data["pixels"],
        np.array(data["depth"], dtype=np.float64),
        kind="inverse",
        labels=["person", "car", "door", "statue"],
        partial=data["cut"],
    )
    sized = fit_table(polars_frame(data), kind="inverse", **NAMES)
    of_image = found.images.k[found.rows.image]
    np.testing.assert_allclose(sized["size_m"].to_numpy(), found.rows.size_m, rtol=1e-12)
    np.testing.assert_allclose(sized["k"].to_numpy(), of_image, rtol=1e-12)
