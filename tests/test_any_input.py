import warnings
from importlib import import_module
from importlib.resources import files
from importlib.util import find_spec

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import imgscale as ims
from imgscale import batch, measuring, plotting
from imgscale.order_statistics import box_quantiles

BOXES = ((10.0, 10.0, 30.0, 50.0), (50.0, 20.0, 90.0, 60.0), (20.0, 60.0, 40.0, 80.0))
VALUES = np.linspace(2.0, 9.0, 80 * 100).reshape(80, 100)
MAP = ims.DepthMap(VALUES, kind="metric")
TABLE = ims.PriorTable([ims.ObjectPrior("person", 1.7, 0.1), ims.ObjectPrior("car", 1.5, 0.1)])
NAMES = ("person", "car", "box")
DETECTIONS = [ims.Detection(name, box) for name, box in zip(NAMES, BOXES, strict=True)]
DEPTHS = ims.ObjectDepths([5.0, 7.0, 6.0], kind="metric", image_size=(100, 80))
CAMERA = ims.Camera(100.0, focal_rel_std=0.02, image_size=(100, 80))
PLANE = ims.GroundPlane(image_size=(100, 80), horizon_px=5.0, camera_height_m=1.5)
MODEL = ims.fit(DETECTIONS, MAP, TABLE)
ESTIMATES = tuple(ims.predict(MODEL, DETECTIONS, MAP))
FIT = {"priors": TABLE, "ground": None, "camera": None, "method": "posterior", "noise": ims.Noise()}
MASK = np.zeros((80, 100), dtype=bool)
MASK[20:60, 30:60] = True
GROUND = ims.fit(DETECTIONS, PLANE, TABLE)
PHOTO = np.zeros((80, 100, 3), np.uint8)
PRIORS = str(files(ims).joinpath("tables", "priors_2026_11.csv"))
COLUMNS = {
    "image_id": np.array([1, 1, 2, 2]),
    "label": np.array(["person", "car", "person", "box"]),
    "pixels": np.array([40.0, 30.0, 50.0, 60.0]),
    "depth": np.array([5.0, 6.0, 4.0, 5.0]),
}

# Every public call with arguments that it takes. One at a time is put in something hostile's place.
CALLS = {
    "Camera": (
        ims.Camera,
        {
            "focal_px": 100.0,
            "focal_rel_std": 0.1,
            "cx": 50.0,
            "cy": 40.0,
            "image_size": (100, 80),
            "pitch_deg": 1.0,
            "pitch_std_deg": 0.5,
        },
    ),
    "Camera.from_matrix": (
        ims.Camera.from_matrix,
        {
            "matrix": [[100.0, 0.0, 50.0], [0.0, 100.0, 40.0], [0.0, 0.0, 1.0]],
            "focal_rel_std": 0.1,
            "image_size": (100, 80),
            "of_size": (100, 80),
        },
    ),
    "DepthMap": (
        ims.DepthMap,
        {"values": VALUES, "kind": "metric", "image_size": (100, 80), "scale_rel_std": 0.1},
    ),
    "DepthMap.from_disparity": (
        ims.DepthMap.from_disparity,
        {
            "disparity": VALUES,
            "focal_px": 100.0,
            "baseline_m": 0.1,
            "doffs_px": 0.0,
            "image_size": (100, 80),
            "scale_rel_std": 0.0,
        },
    ),
    "DepthMap.from_ray_distance": (
        ims.DepthMap.from_ray_distance,
        {"values": VALUES, "camera": CAMERA, "kind": "metric", "scale_rel_std": 0.0},
    ),
    "Detection": (
        ims.Detection,
        {
            "label": "car",
            "xyxy": (30.0, 20.0, 60.0, 60.0),
            "score": 0.5,
            "mask": MASK,
            "partial": False,
            "track_id": 1,
            "aliases": ("van",),
        },
    ),
    "Detection.with_box": (DETECTIONS[0].with_box, {"xyxy": BOXES[0]}),
    "Detection.from_xywh": (
        ims.Detection.from_xywh,
        {"label": "car", "xywh": (30.0, 20.0, 30.0, 40.0), "score": 0.5, "aliases": ()},
    ),
    "Detection.from_min_max_rc": (
        ims.Detection.from_min_max_rc,
        {"label": "car", "bbox": (20.0, 30.0, 60.0, 60.0), "score": 0.5, "aliases": ()},
    ),
    "Detection.from_ratios": (
        ims.Detection.from_ratios,
        {
            "label": "car",
            "left": 0.1,
            "top": 0.1,
            "width": 0.2,
            "height": 0.3,
            "image_size": (100, 80),
        },
    ),
    "Frame": (
        ims.Frame,
        {"detections": DETECTIONS, "depth": MAP, "camera": CAMERA, "name": "a"},
    ),
    "GroundPlane": (
        ims.GroundPlane,
        {
            "image_size": (100, 80),
            "horizon_px": 5.0,
            "horizon_std_px": 1.0,
            "camera_height_m": 1.5,
            "camera_height_std_m": 0.1,
            "roll_deg": 1.0,
            "roll_std_deg": 0.1,
        },
    ),
    "Noise": (ims.Noise, {"box_px": 1.0, "box_rel": 0.1, "depth_rel": 0.1}),
    "ObjectDepths": (
        ims.ObjectDepths,
        {
            "values": np.array([5.0, 7.0, 6.0]),
            "kind": "metric",
            "image_size": (100, 80),
            "rel_std": 0.1,
            "depth_at": "surface",
        },
    ),
    "ObjectPrior": (
        ims.ObjectPrior,
        {
            "label": "crate",
            "mean_m": 1.0,
            "std_m": 0.1,
            "mean_std_m": 0.1,
            "axis": "height",
            "on_ground": True,
            "depth_extent_m": 1.0,
            "share": 1.0,
            "aliases": (),
            "source": "",
            "region": "world",
            "year": 2020,
            "n": 10,
            "spans": "",
        },
    ),
    "PriorTable": (ims.PriorTable, {"priors": list(TABLE.priors)}),
    "PriorTable.lookup": (TABLE.lookup, {"label": "car"}),
    "PriorTable.sizes": (TABLE.sizes, {"label": "car"}),
    "PriorTable.with_prior": (TABLE.with_prior, {"prior": ims.ObjectPrior("crate", 1.0, 0.1)}),
    "PriorTable.default": (ims.PriorTable.default, {"region": "eu"}),
    "PriorTable.from_csv": (
        ims.PriorTable.from_csv,
        {"path": PRIORS, "region": "eu", "max_bytes": 10_000_000},
    ),
    "FittedPlane.as_prior": (
        GROUND.plane.as_prior,
        {"image_size": (100, 80), "jitter_px": 1.0, "jitter_deg": 0.1},
    ),
    "Measurement.table": (
        ims.measure(PHOTO, detector=DETECTIONS, depth_source=MAP, priors=TABLE).table,
        {"unit": "m", "level": 0.9},
    ),
    "box_quantiles": (
        box_quantiles,
        {"depth": MAP, "boxes": DETECTIONS, "q": (0.25, 0.5)},
    ),
    "ScaleModel.check_depth": (
        lambda **given: MODEL.check_depth(**given) or True,
        {"depth": MAP, "same_scale": False},
    ),
    "ScaleModel.metres_per_pixel": (MODEL.metres_per_pixel, {"depth": np.array([5.0, 6.0])}),
    "ScaleModel.scale_map": (MODEL.scale_map, {"depth": MAP}),
    "ScaleModel.to_metric": (MODEL.to_metric, {"depth": MAP, "camera": CAMERA}),
    "ScaleModel.from_dict": (ims.ScaleModel.from_dict, {"record": MODEL.to_dict()}),
    "SizeEstimate.interval": (ESTIMATES[2].interval, {"level": 0.9}),
    "explain": (ims.explain, {"model": MODEL, "estimates": ESTIMATES}),
    "fit": (ims.fit, {"detections": DETECTIONS, "depth": MAP, **FIT}),
    "fit_shared": (
        ims.fit_shared,
        {
            "frames": [ims.Frame(DETECTIONS, MAP), ims.Frame(DETECTIONS, MAP)],
            "priors": TABLE,
            "ground": None,
            "method": "robust",
            "noise": ims.Noise(),
        },
    ),
    "leave_one_out": (
        ims.leave_one_out,
        {"detections": DETECTIONS, "depth": MAP, "use_prior": False, **FIT},
    ),
    "measure": (
        ims.measure,
        {
            "image": PHOTO,
            "detector": DETECTIONS,
            "depth_source": MAP,
            "axis": "height",
            "use_prior": False,
            **FIT,
        },
    ),
    "predict": (
        ims.predict,
        {
            "model": MODEL,
            "detections": DETECTIONS,
            "depth": MAP,
            "axis": "height",
            "use_prior": False,
            "same_scale": False,
        },
    ),
    "suspect": (ims.suspect, {"model": MODEL}),
    "batch.fit_columns": (
        batch.fit_columns,
        {
            **COLUMNS,
            "priors": TABLE,
            "kind": "metric",
            "axis": "height",
            "image_size": (100, 80),
            "partial": np.zeros(4, dtype=bool),
            "depth_rel_std": 0.1,
            "noise": ims.Noise(),
            "method": "robust",
            "level": 0.9,
        },
    ),
    "measuring.distance": (
        measuring.distance,
        {
            "model": MODEL,
            "p1": (10.0, 10.0),
            "p2": (60.0, 50.0),
            "depth": MAP,
            "camera": None,
            "same_object": False,
            "same_scale": False,
        },
    ),
    "measuring.extent": (
        measuring.extent,
        {"model": MODEL, "mask_or_polygon": MASK, "depth": MAP, "same_scale": False},
    ),
    "measuring.regionprops_table": (
        measuring.regionprops_table,
        {
            "model": MODEL,
            "label_image": MASK.astype(np.int64),
            "depth": MAP,
            "properties": ("label",),
            "unit": "m",
            "level": 0.9,
            "same_scale": False,
        },
    ),
}

# Calls that need an extra, where it is there.
OF_BATCH = {
    "label": "label",
    "pixels": "pixels",
    "depth": "depth",
    "priors": TABLE,
    "kind": "metric",
    "partial": None,
    "axis": "height",
    "image_size": (100, 80),
    "noise": ims.Noise(),
    "method": "robust",
    "level": 0.9,
}
if find_spec("pandas"):
    frame = import_module("pandas").DataFrame(COLUMNS)
    CALLS["batch.fit_table"] = (
        batch.fit_table,
        {"frame": frame, "image_id": "image_id", **OF_BATCH},
    )
if find_spec("pyarrow"):
    halves = (slice(0, 2), slice(2, 4))
    lists = {name: [column[part].tolist() for part in halves] for name, column in COLUMNS.items()}
    CALLS["batch.fit_arrow"] = (
        batch.fit_arrow,
        {"table": import_module("pyarrow").table(lists), **OF_BATCH},
    )
if find_spec("matplotlib"):
    axes = import_module("matplotlib.figure").Figure(figsize=(2, 2)).subplots()
    DRAWN = {
        "plotting.draw_sizes": {
            "image": PHOTO,
            "detections": DETECTIONS,
            "estimates": ESTIMATES,
            "model": MODEL,
            "unit": "m",
            "level": 0.9,
            "ax": axes,
        },
        "plotting.draw_scale_bar": {
            "model": MODEL,
            "depth": MAP,
            "at": (20.0, 30.0),
            "image": PHOTO,
            "length_m": 1.0,
            "unit": "m",
            "same_scale": False,
            "ax": axes,
        },
        "plotting.draw_scale_map": {
            "model": MODEL,
            "depth": MAP,
            "image": PHOTO,
            "unit": "m",
            "same_scale": False,
            "ax": axes,
        },
        "plotting.draw_residuals": {"model": MODEL, "level": 0.9, "ax": axes},
        "plotting.draw_ground_plane": {
            "model": GROUND,
            "image": PHOTO,
            "camera": CAMERA,
            "extent_m": 10.0,
            "level": 0.9,
            "ax": axes,
        },
    }
    CALLS |= {
        name: (getattr(plotting, name.partition(".")[2]), valid) for name, valid in DRAWN.items()
    }

# Public names that are no calls of a user's, or whose hostile input other files hold.
ELSEWHERE = {
    "Depth": "a union of types",
    "Detector": "a protocol",
    "DepthSource": "a protocol",
    "DepthMismatchError": "an exception",
    "FileError": "an exception",
    "FitError": "an exception",
    "ImgscaleError": "an exception",
    "MissingDependencyError": "an exception",
    "Explanation": "a result",
    "FittedPlane": "a result",
    "Flag": "an enumeration",
    "Measurement": "a result",
    "Outcome": "a result",
    "Reference": "a result",
    "ScaleModel": "a result",
    "SharedScale": "a result",
    "SizeEstimate": "a result",
    "Suspicion": "a result",
    "measure_many": "test_many.py",
    "read_record": "test_hostile_files.py",
    "batch.REASONS": "a tuple of words",
    "batch.BatchResult": "a result",
    "batch.ImageColumns": "a result",
    "batch.RowColumns": "a result",
    "measuring.Extent": "a result",
    "measuring.Quantity": "a result",
}

ARGUMENTS = [(name, argument) for name, (_, valid) in CALLS.items() for argument in valid]
IDS = [f"{name}-{argument}" for name, argument in ARGUMENTS]
NAN, INF = float("nan"), float("inf")

HOSTILE_NUMBERS = st.one_of(
    st.floats(),
    st.sampled_from([NAN, INF, -INF, -0.0, 0.0, 5e-324, -1.0, 1e300, 10**400, -(10**400)]),
    st.sampled_from([np.float16(2), np.float32(NAN), np.int8(-1), np.uint64(2**64 - 1)]),
    st.sampled_from([1j, 2 + 0j, np.complex128(1), True, np.True_, None, np.ma.masked]),
)
HOSTILE_LABELS = st.one_of(
    st.text(max_size=20),
    st.sampled_from(["", " ", "x" * 100_000, "\ud800", "a\nb", "a\0b", "\U0001f600", b"car"]),
)


def arrays_of(numbers):
    shapes = st.sampled_from([(), (0,), (1,), (2,), (3,), (4,), (3, 3), (0, 2), (5, 4), (2, 2, 2)])
    dtypes = st.sampled_from(
        ["f2", "f4", ">f8", "f8", "g", "c16", ">i4", "u1", "i8", "?", "O", "U3", "S3", "M8[s]"]
    )

    def laid_out(shape, dtype, number, layout):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            array = np.full(shape, number).astype(dtype)
        if layout == "F":
            array = np.asfortranarray(array)
        elif layout == "reversed":
            array = array[::-1] if array.ndim else array
        elif layout == "masked":
            return np.ma.masked_array(array, mask=True)
        array.flags.writeable = layout != "read-only"
        return array

    layouts = st.sampled_from(["C", "F", "reversed", "masked", "read-only"])
    return st.builds(laid_out, shapes, dtypes, numbers, layouts)


HOSTILE = st.one_of(
    HOSTILE_NUMBERS,
    HOSTILE_LABELS,
    st.lists(HOSTILE_NUMBERS, max_size=4),
    st.lists(HOSTILE_LABELS, max_size=3),
    arrays_of(st.sampled_from([0, 1, 7, 100])),
    arrays_of(st.sampled_from([0.0, -1.0, 1.5, NAN, INF])).filter(lambda a: a.dtype.kind in "fcO"),
    st.sampled_from([{}, {"k": NAN}, object(), [object()], MODEL, MAP, CAMERA, PLANE, TABLE]),
)


def bytes_of(value):
    if isinstance(value, np.ma.MaskedArray):
        return (value.data.tobytes(), np.ma.getmaskarray(value).tobytes())
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if isinstance(value, ims.DepthMap | ims.ObjectDepths):
        return value.values.tobytes()
    return repr(value)


def outcome(name, argument, value):
    call, valid = CALLS[name]
    arguments = {**valid, argument: value}
    inputs = {key: given for key, given in arguments.items() if key != "ax"}  # is drawn on
    before = {key: bytes_of(given) for key, given in inputs.items()}
    try:
        result = call(**arguments)
    except FileNotFoundError:
        assert argument in {"image", "path"}  # a string is the path of a file
        result = None
    except (ValueError, TypeError, ims.ImgscaleError) as error:
        check_own(error, value)
        result = None
    assert {key: bytes_of(given) for key, given in inputs.items()} == before
    return result


def check_own(error, value):
    assert str(error), repr(error)
    assert "imgscale" in innermost_module(error), (repr(value), repr(error))


def innermost_module(error):
    trace = error.__traceback__
    while trace.tb_next:
        trace = trace.tb_next
    return trace.tb_frame.f_globals["__name__"]


def test_the_table_names_every_public_callable():
    public = {
        prefix + name
        for module, prefix in (
            (ims, ""),
            (batch, "batch."),
            (measuring, "measuring."),
            (plotting, "plotting."),
        )
        for name in module.__all__
    }
    extras = {"plotting": "matplotlib", "batch.fit_table": "pandas", "batch.fit_arrow": "pyarrow"}
    absent = tuple(name for name, package in extras.items() if not find_spec(package))
    missing = public - {*CALLS, *ELSEWHERE}
    assert not {name for name in missing if not absent or not name.startswith(absent)}
    assert not set(CALLS) & set(ELSEWHERE)


@pytest.mark.parametrize("name", CALLS)
def test_every_call_of_the_table_takes_its_valid_arguments(name):
    call, valid = CALLS[name]
    assert call(**valid) is not None


NO_NUMBERS = {
    "complex": lambda values: np.asarray(values) + 1j,
    "strings": lambda values: np.asarray(values).astype(str),
    "objects": lambda values: np.asarray(values).astype(object),
    "booleans": lambda values: np.asarray(values) > 0,
}
NUMBERS = [
    ("Camera.from_matrix", "matrix"),
    ("DepthMap", "values"),
    ("DepthMap.from_disparity", "disparity"),
    ("DepthMap.from_ray_distance", "values"),
    ("Detection", "xyxy"),
    ("Detection.with_box", "xyxy"),
    ("Detection.from_xywh", "xywh"),
    ("Detection.from_min_max_rc", "bbox"),
    ("ObjectDepths", "values"),
    ("ScaleModel.metres_per_pixel", "depth"),
    ("batch.fit_columns", "pixels"),
    ("batch.fit_columns", "depth"),
    ("measuring.distance", "p1"),
    ("measuring.distance", "p2"),
]


@pytest.mark.parametrize("kind", NO_NUMBERS)
@pytest.mark.parametrize(("name", "argument"), NUMBERS)
def test_what_holds_no_real_numbers_is_refused_by_its_name(name, argument, kind):
    call, valid = CALLS[name]
    with pytest.raises((ValueError, TypeError), match=f"`{argument}`"):
        call(**{**valid, argument: NO_NUMBERS[kind](valid[argument])})


@pytest.mark.parametrize(("name", "argument"), NUMBERS)
def test_what_lies_under_a_mask_is_never_taken_for_a_number(name, argument):
    call, valid = CALLS[name]
    hidden = np.ma.masked_array(np.asarray(valid[argument]), mask=False)
    hidden[(0,) * hidden.ndim] = np.ma.masked
    if (name.startswith(("DepthMap", "ObjectDepths")), argument) in {
        (True, "values"),
        (True, "disparity"),
    }:
        assert hidden.data[(0,) * hidden.ndim] > 0
        values = call(**{**valid, argument: hidden}).values
        assert not values[(0,) * values.ndim] > 0
    elif (name, argument) == ("batch.fit_columns", "depth"):
        assert np.isnan(call(**{**valid, argument: hidden}).rows.size_m[0])
    else:
        with pytest.raises(ValueError, match=f"`{argument}`"):
            call(**{**valid, argument: hidden})


def mapped(array, folder):
    np.save(folder / "array.npy", array)
    return np.load(folder / "array.npy", mmap_mode="r")


LAYOUTS = {
    "big-endian": lambda a, _: a.astype(">f8"),
    "Fortran": lambda a, _: np.asfortranarray(a),
    "negative strides": lambda a, _: a[::-1].copy()[::-1],
    "every other": lambda a, _: np.repeat(a, 2, axis=0)[::2],
    "memory-mapped": mapped,
}


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize(("name", "argument"), NUMBERS)
def test_how_numbers_lie_in_memory_changes_nothing(name, argument, layout, tmp_path):
    call, valid = CALLS[name]
    plain = np.asarray(valid[argument], dtype=np.float64)
    given_so = LAYOUTS[layout](plain, tmp_path)
    before = given_so.tobytes()
    expected, found = (call(**{**valid, argument: array}) for array in (plain, given_so))
    assert plain_of(found) == plain_of(expected)
    assert given_so.tobytes() == before


def plain_of(result):
    if isinstance(result, ims.DepthMap | ims.ObjectDepths):
        return result.values.astype(np.float64).tolist()
    if isinstance(result, batch.BatchResult):
        return [column.tolist() for column in (*result.images[1:4], *result.rows[1:6])]
    return result.tolist() if isinstance(result, np.ndarray) else result


@pytest.mark.slow
@pytest.mark.parametrize(("name", "argument"), ARGUMENTS, ids=IDS)
@settings(derandomize=True, max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_hostile_argument_gives_a_result_or_the_packages_own_error(name, argument, data):
    outcome(name, argument, data.draw(HOSTILE))


@pytest.mark.parametrize("jitter", ["jitter_px", "jitter_deg"])
def test_how_far_a_camera_moves_is_not_negative(jitter):
    with pytest.raises(ValueError, match=f"`{jitter}` must be finite and not negative; got -4.0"):
        GROUND.plane.as_prior((100, 80), **{jitter: -4})


@pytest.mark.parametrize("name", [name for name in CALLS if name.startswith("batch.fit_table")])
@pytest.mark.parametrize("argument", ["image_id", "label", "pixels", "depth"])
def test_a_column_that_is_needed_has_a_name(name, argument):
    call, valid = CALLS[name]
    with pytest.raises(TypeError, match=f"`{argument}` must be the name of a column; got None"):
        call(**{**valid, argument: None})
