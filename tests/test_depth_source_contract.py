"""What every reader and converter of depth obeys, whatever the depth comes from."""

import inspect
import math
import re
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

import imgscale as ims
from imgscale import depth_sources
from imgscale.depth_sources import (
    depth_from_points,
    from_supervision,
    from_transformers,
    read_depth,
)


@dataclass(frozen=True)
class Source:
    """How one source tells of a map, and the function that reads it."""

    give: Callable[[Any, Path], Any]  # (a map with gaps, a folder) -> what the source gives
    read: Callable[..., ims.DepthMap]  # of that and options
    argument: str  # the reader's name for what the source gives
    kind: str = "metric"
    error: float = 0.0  # of a value of 1 to 16
    cannot: Mapping[str, str] = field(default_factory=dict)  # which law, and why


# --- the sources ---


def is_depth(values):
    with np.errstate(invalid="ignore"):
        return np.isfinite(values) & (values > 0)


def saved(name, write):
    def give(values, folder):
        write(folder / name, values)
        return folder / name

    return give


def write_npz(path, values):
    np.savez(path, depth=values)


def write_png(path, values):
    stored = np.where(is_depth(values), values * 256, 0)
    Image.fromarray(np.rint(stored).astype(np.uint16)).save(path)


def write_pfm(path, values):
    height, width = values.shape
    stored = values[::-1].astype("<f4")
    path.write_bytes(f"Pf\n{width} {height}\n-1.0\n".encode() + stored.tobytes())


def write_tiff(path, values):
    Image.fromarray(values.astype(np.float32)).save(path)


def read_metric(path, **options):
    return read_depth(path, kind="metric", **options)


def read_png(path, **options):
    return read_depth(path, kind="metric", scale=256, **options)


def predicted(values, _):
    return {"predicted_depth": values}


def reader_of(kind):
    return lambda result, **options: from_transformers(result, kind=kind, **options)


def of_supervision(kind, values, camera=None):
    """Stand in for a supervision.DepthMap: float32, NaN where it has no depth."""
    shown = np.where(is_depth(values), values, np.nan).astype(np.float32)
    return SimpleNamespace(kind=kind, camera=camera, to_float=lambda: shown)


def disparity(values, _):
    """Invert z = fx_px baseline_m / (disparity + doffs_px)."""
    camera = SimpleNamespace(fx_px=700.0, baseline_m=0.5, doffs_px=20.0)
    with np.errstate(divide="ignore"):
        return of_supervision("disparity_px", 350.0 / values.astype(np.float64) - 20.0, camera)


def scan(values, _):
    """Put a point in the middle of every pixel that has a depth."""
    rows, columns = np.nonzero(is_depth(values))
    z = values[rows, columns].astype(np.float64)
    return SimpleNamespace(xyz=np.stack([columns * z, rows * z, z], axis=1), shape=values.shape)


def read_scan(given):
    height, width = given.shape
    return depth_from_points(given.xyz, np.eye(3, 4), (width, height))


IN_FLOAT64 = {"float32": "it computes its depths, in float64"}
IN_A_FILE = IN_FLOAT64 | {"arrays": "it reads a file, which is not in memory"}
MEASURED = {
    "image size": "its map is of the picture's own size",
    "scale error": "a scanner is calibrated",
}

SOURCES = {
    "npy": Source(saved("a.npy", np.save), read_metric, "path", cannot=IN_A_FILE),
    "npz": Source(saved("a.npz", write_npz), read_metric, "path", cannot=IN_A_FILE),
    "pfm": Source(saved("a.pfm", write_pfm), read_metric, "path", cannot=IN_A_FILE),
    "tiff": Source(saved("a.tif", write_tiff), read_metric, "path", cannot=IN_A_FILE),
    "png": Source(saved("a.png", write_png), read_png, "path", error=0.5 / 256, cannot=IN_A_FILE),
    "network": Source(predicted, reader_of("metric"), "result"),
    "relative network": Source(predicted, reader_of("relative"), "result", kind="relative"),
    "inverse network": Source(
        predicted, reader_of("affine_inverse"), "result", kind="affine_inverse"
    ),
    "supervision": Source(
        lambda values, _: of_supervision("depth_m", values), from_supervision, "depth_map"
    ),
    "inverse of supervision": Source(
        lambda values, _: of_supervision("relative_inverse", values),
        from_supervision,
        "depth_map",
        kind="affine_inverse",
    ),
    "disparity of supervision": Source(
        disparity, from_supervision, "depth_map", error=1e-4, cannot=IN_FLOAT64
    ),
    "scan": Source(scan, read_scan, "points", error=1e-14, cannot=IN_FLOAT64 | MEASURED),
}
LAWS = ("float32", "arrays", "image size", "scale error")


def every(law=None):
    """Go through the sources that can carry what a law is about."""
    assert law is None or law in LAWS
    return pytest.mark.parametrize(
        "source",
        [
            pytest.param(source, id=name)
            for name, source in SOURCES.items()
            if law not in source.cannot
        ],
    )


DEPTHS = np.array([[1.5, 2.25, 3.0, 1.0], [16.0, 12.5, 8.0, 4.0]], dtype=np.float32)
WITH_GAPS = np.array([[1.5, np.nan, 3.0, 0.0], [np.inf, 12.5, -1.0, 4.0]], dtype=np.float32)


def test_every_reader_of_the_package_is_here():
    readers = {
        name for name in depth_sources.__all__ if name.startswith(("from_", "read_", "depth"))
    }
    assert readers - {"read_values"} == {
        "from_supervision",
        "from_transformers",
        "read_depth",
        "depth_from_points",
    }


def test_what_a_source_cannot_carry_is_a_law_with_a_reason():
    for source in SOURCES.values():
        assert set(source.cannot) <= set(LAWS)
        assert all(len(reason.split()) > 3 for reason in source.cannot.values())


# --- what comes back ---


@every()
def test_a_map_comes_back_with_its_kind_and_size(source, tmp_path):
    depth = source.read(source.give(DEPTHS, tmp_path))
    assert type(depth) is ims.DepthMap
    assert (depth.kind, depth.image_size) == (source.kind, (4, 2))
    assert np.abs(depth.values - DEPTHS).max() <= source.error


@every()
def test_what_is_missing_is_no_depth(source, tmp_path):
    depth = source.read(source.give(WITH_GAPS, tmp_path))
    valid = np.isfinite(depth.values)
    if source.kind != "affine_inverse":  # of which every finite value is one
        valid &= depth.values > 0
    assert np.array_equal(valid, is_depth(WITH_GAPS))
    assert np.abs(depth.values[valid] - WITH_GAPS[valid]).max() <= source.error


@st.composite
def maps(draw):
    """Maps of float32, some of their pixels missing."""
    shape = draw(hnp.array_shapes(min_dims=2, max_dims=2, max_side=6))
    number = st.floats(1, 16, width=32) | st.sampled_from([math.nan, math.inf, 0.0, -1.0])
    return draw(hnp.arrays(np.float32, shape, elements=number))


@every()
@settings(max_examples=25, deadline=None)
@given(values=maps())
def test_whatever_a_map_holds_comes_back(source, values):
    assume(is_depth(values).any())
    with tempfile.TemporaryDirectory() as folder:
        depth = source.read(source.give(values, Path(folder)))
    known = is_depth(values)
    assert depth.values.shape == values.shape
    assert np.abs(depth.values[known] - values[known]).max() <= source.error
    assert not is_depth(depth.values)[~known].any()


@every("float32")
def test_float32_stays_as_it_is(source, tmp_path):
    assert source.read(source.give(WITH_GAPS, tmp_path)).values.dtype == np.float32


@every()
def test_fit_takes_what_comes_back(source, tmp_path):
    values = np.repeat(np.linspace(2, 8, 40, dtype=np.float32)[np.newaxis], 20, axis=0)
    depth = source.read(source.give(values, tmp_path))
    seen = [ims.Detection("a", (2, 2, 8, 12)), ims.Detection("b", (30, 2, 36, 9))]
    priors = ims.PriorTable([ims.ObjectPrior("a", 1.0, 0.01), ims.ObjectPrior("b", 1.5, 0.01)])
    model = ims.fit(seen, depth, priors, method="robust")
    assert model.kind == source.kind
    assert [reference.label for reference in model.references] == ["a", "b"]


@every("image size")
def test_the_size_of_a_picture_larger_than_its_map_is_kept(source, tmp_path):
    depth = source.read(source.give(DEPTHS, tmp_path), image_size=(400, 200))
    assert depth.image_size == (400, 200)
    assert depth.values.shape == (2, 4)


@every("image size")
@pytest.mark.parametrize("size", [(2, 4), (200, 400), (0, 2), (4.5, 2), 7, "4x2"], ids=repr)
def test_a_size_that_is_not_the_pictures_is_refused_by_name(source, size, tmp_path):
    with pytest.raises(ValueError, match="`image_size` "):
        source.read(source.give(DEPTHS, tmp_path), image_size=size)


@every("scale error")
def test_the_error_of_the_scale_is_kept(source, tmp_path):
    depth = source.read(source.give(DEPTHS, tmp_path), scale_rel_std=0.07)
    assert depth.scale_rel_std == 0.07


@every("scale error")
@pytest.mark.parametrize("error", [-0.1, math.nan, math.inf, "0.1"])
def test_an_error_of_the_scale_that_is_none_is_refused_by_name(source, error, tmp_path):
    with pytest.raises((ValueError, TypeError), match="`scale_rel_std` must be"):
        source.read(source.give(DEPTHS, tmp_path), scale_rel_std=error)


# --- what goes in is left alone ---


def arrays(given):
    if isinstance(given, dict):
        return list(given.values())
    return [given.to_float()] if hasattr(given, "to_float") else [given.xyz]


@every("arrays")
def test_arrays_that_are_read_only_are_read_and_left_as_they_were(source, tmp_path):
    given = source.give(WITH_GAPS, tmp_path)
    before = [array.copy() for array in arrays(given)]
    for array in arrays(given):
        array.flags.writeable = False
    source.read(MappingProxyType(given) if isinstance(given, dict) else given)
    for array, old in zip(arrays(given), before, strict=True):
        assert np.array_equal(array, old, equal_nan=True)


@every()
def test_a_map_is_a_copy_and_read_only(source, tmp_path):
    given = source.give(DEPTHS.copy(), tmp_path)
    depth = source.read(given)
    assert not depth.values.flags.writeable
    if "arrays" not in source.cannot:
        for array in arrays(given):
            array[...] = 99
    assert np.abs(depth.values - DEPTHS).max() <= source.error


# --- what is no depth at all ---


def refused(source, given, match=None):
    with pytest.raises((ValueError, TypeError), match=match) as caught:
        source.read(given)
    assert type(caught.value) in {ValueError, TypeError, ims.FileError}
    assert re.search(r"`\w|^/", str(caught.value)), f"names nothing: {caught.value!r}"


@every()
def test_a_map_without_any_depth_is_refused(source, tmp_path):
    for value in (math.nan, math.inf, 0.0, -1.0):
        refused(source, source.give(np.full((2, 4), value, dtype=np.float32), tmp_path))


@pytest.mark.parametrize("name", ["network", "supervision"])
@pytest.mark.parametrize("garbage", [None, 7, [], {}, b"\xff"], ids=repr)
def test_what_is_no_result_is_refused_by_the_arguments_name(name, garbage):
    refused(SOURCES[name], garbage, f"`{SOURCES[name].argument}`")


NO_NUMBERS = {
    "truth values": np.array([[True, False]]),
    "text": np.array([["near", "far"]]),
    "complex numbers": np.array([[1 + 1j, 2.0]]),
    "objects": np.array([[None, 1.0]], dtype=object),
    "None": None,
    "a number": 7.0,
    "a row": np.array([1.0, 2.0]),
    "colours": np.ones((2, 4, 3)),
    "nothing": np.ones((0, 4)),
}


@pytest.mark.parametrize("name", [name for name, it in SOURCES.items() if "network" in name])
@pytest.mark.parametrize("values", NO_NUMBERS.values(), ids=NO_NUMBERS)
def test_a_prediction_that_holds_no_depth_is_refused_by_name(name, values):
    refused(SOURCES[name], {"predicted_depth": values})


@pytest.mark.parametrize("name", [name for name, it in SOURCES.items() if "supervision" in name])
@pytest.mark.parametrize("values", NO_NUMBERS.values(), ids=NO_NUMBERS)
def test_a_map_of_supervision_that_holds_no_depth_is_refused_by_name(name, values, tmp_path):
    given = SOURCES[name].give(DEPTHS, tmp_path)
    given.to_float = lambda: values
    refused(SOURCES[name], given)


@pytest.mark.parametrize("name", ["network", "supervision", "disparity of supervision"])
def test_whole_numbers_are_not_taken_for_metres(name, tmp_path):
    given = SOURCES[name].give(DEPTHS, tmp_path)
    stored = np.array([[1500, 0]], dtype=np.uint16)
    if isinstance(given, dict):
        given = {"predicted_depth": stored}
    else:
        given.to_float = lambda: stored
    refused(SOURCES[name], given, "must be floating point; got dtype uint16")


@pytest.mark.parametrize("wrong", [None, 7, "metres", ("depth_m",), ["depth_m"], {}], ids=repr)
def test_a_kind_that_supervision_does_not_have_is_refused_by_name(wrong, tmp_path):
    source = SOURCES["supervision"]
    given = source.give(DEPTHS, tmp_path)
    given.kind = wrong
    refused(source, given, "`depth_map.kind` must be one of")


@pytest.mark.parametrize("wrong", [7, "camera", {}, SimpleNamespace(fx_px=700.0)], ids=repr)
def test_a_camera_that_is_none_is_refused_by_name(wrong, tmp_path):
    source = SOURCES["disparity of supervision"]
    given = source.give(DEPTHS, tmp_path)
    given.camera = wrong
    refused(source, given, "camera")


@pytest.mark.parametrize("kind", [None, "metre", "ground_plane", 7, ["metric"]], ids=repr)
def test_a_kind_that_is_none_is_refused_by_name(kind, tmp_path):
    np.save(tmp_path / "a.npy", DEPTHS)
    with pytest.raises(ValueError, match="`kind` must be one of"):
        from_transformers({"predicted_depth": DEPTHS}, kind=kind)
    with pytest.raises(ValueError, match="`kind` must be one of"):
        read_depth(tmp_path / "a.npy", kind=kind)


@pytest.mark.parametrize(
    "wrong", [None, 7, "text", [], [[1.0, 2.0]], np.full((2, 3), "a")], ids=str
)
def test_points_and_projections_that_are_none_are_refused_by_name(wrong):
    with pytest.raises((ValueError, TypeError), match="`points` must"):
        depth_from_points(wrong, np.eye(3, 4), (4, 2))
    with pytest.raises((ValueError, TypeError), match="`projection` must"):
        depth_from_points([[0, 0, 1.0]], wrong, (4, 2))


def test_all_options_are_told_by_name():
    for reader in (read_depth, depth_sources.read_values, from_transformers, from_supervision):
        _, *options = inspect.signature(reader).parameters.values()
        assert {option.kind for option in options} == {inspect.Parameter.KEYWORD_ONLY}
