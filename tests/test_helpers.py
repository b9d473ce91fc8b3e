"""Validators, rounding, optional imports, exceptions and protocols."""

import math
import pickle
import re
import sys
from decimal import Decimal
from fractions import Fraction

import attrs
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import imgscale
from imgscale import DepthMap, DepthSource, Detection, Detector, errors
from imgscale._checks import (
    array_summary,
    as_float,
    as_image_size,
    as_optional_float,
    check_choice,
    finite,
    four_numbers,
    is_between,
    non_negative,
    number_error,
    own_floats,
    positive,
    text,
)
from imgscale._format import digits_for, text_table, with_error
from imgscale._optional import require

EXCEPTIONS = [getattr(errors, name) for name in errors.__all__]


# --- converters and validators ---


@pytest.mark.parametrize(
    "value",
    [
        2,
        2.0,
        np.float16(2),
        np.float32(2),
        np.float64(2),
        np.longdouble(2),
        np.int8(2),
        np.uint64(2),
    ],
    ids=lambda value: type(value).__name__,
)
def test_real_numbers_become_python_floats(value):
    assert type(as_float(value)) is float
    assert as_float(value) == 2.0


@pytest.mark.parametrize(
    "value",
    ["2", None, True, False, np.True_, 2j, [2.0], Decimal(2), Fraction(2), b"2"],
    ids=lambda value: type(value).__name__,
)
def test_everything_else_passes_unchanged_for_the_validator_to_name(value):
    assert as_float(value) is value
    assert not is_between(as_float(value), -10.0, 10.0)


def test_none_stays_none_where_it_may():
    assert as_optional_float(None) is None
    assert type(as_optional_float(np.int64(3))) is float


@pytest.mark.parametrize("value", [math.nan, math.inf, 0.0])
def test_nan_and_inf_are_numbers_that_break_a_law_not_a_type(value):
    assert isinstance(number_error("x", "small", value), ValueError)


@pytest.mark.parametrize(
    ("value", "inside"),
    [
        (1.0, True),
        (2.0, True),
        (0.999, False),
        (2.001, False),
        (math.nan, False),
        (math.inf, False),
    ],
)
def test_between_takes_both_ends_and_no_nan(value, inside):
    assert is_between(value, 1.0, 2.0) is inside


@pytest.mark.parametrize("values", [[1, 2.5, 3, 4], np.array([1, 2.5, 3, 4], np.float32)])
def test_four_numbers_become_a_tuple_of_floats(values):
    found = four_numbers("x", "four numbers", values)
    assert found == (1.0, 2.5, 3.0, 4.0)
    assert {type(number) for number in found} == {float}


@pytest.mark.parametrize(
    ("values", "seen"),
    [
        pytest.param([1, 2, 3], "[1, 2, 3]", id="short: shown"),
        pytest.param(np.ones((9, 4)), "shape (9, 4)", id="long: its shape"),
        pytest.param([1, [2], 3, 4], "", id="ragged"),
    ],
)
def test_what_is_not_four_numbers_is_shown_or_summarised(values, seen):
    with pytest.raises(ValueError, match=re.escape("`x` must be four numbers; got ")) as caught:
        four_numbers("x", "four numbers", values)
    assert seen in str(caught.value)


def test_number_error_states_law_value_and_remedy():
    assert str(number_error("x", "small", 9.0)) == "`x` must be small; got 9.0."
    error = number_error("x", "small", "9", "Shrink it.")
    assert isinstance(error, TypeError)
    assert str(error) == "`x` must be small; got '9'. Shrink it."


@attrs.frozen
class Numbers:
    """One field under each law."""

    size: float = attrs.field(default=1.0, converter=as_float, validator=positive)
    spread: float = attrs.field(default=1.0, converter=as_float, validator=non_negative)
    place: float = attrs.field(default=1.0, converter=as_float, validator=finite)
    name: str = attrs.field(default="a", validator=text)


@pytest.mark.parametrize(
    ("name", "lawful"),
    [
        ("size", lambda value: 1e-100 <= value <= 1e100),
        ("spread", lambda value: 0 <= value <= 1e100),
        ("place", lambda value: abs(value) <= 1e100),
    ],
)
@given(value=st.floats())
def test_validators_hold_exactly_their_law(name, lawful, value):
    if lawful(value):
        assert getattr(Numbers(**{name: value}), name) == value
    else:
        with pytest.raises(ValueError, match=rf"`{name}` must be .*; got {re.escape(repr(value))}"):
            Numbers(**{name: value})


@pytest.mark.parametrize("value", [1e-100, 1e100])
def test_extremes_of_magnitude_are_lawful(value):
    assert Numbers(size=value).size == value


@pytest.mark.parametrize("name", ["size", "spread", "place"])
@pytest.mark.parametrize("value", ["1", True, np.True_, 1j])
def test_values_that_are_no_real_numbers_are_type_errors(name, value):
    with pytest.raises(TypeError, match=rf"`{name}` must be .*; got {re.escape(repr(value))}"):
        Numbers(**{name: value})


@pytest.mark.parametrize("allowed", [("a", "b"), ["a", "b"]])
def test_choice_is_one_of_the_allowed_words(allowed):
    check_choice("axis", "b", allowed)
    with pytest.raises(ValueError, match=re.escape('`axis` must be one of "a", "b"; got \'c\'.')):
        check_choice("axis", "c", allowed)


@pytest.mark.parametrize("value", ["", "A", "ab", None, 3, ["a"], np.array(["a", "b"])])
def test_choice_refuses_everything_else_without_failing_itself(value):
    with pytest.raises(ValueError, match=r'`axis` must be one of "a", "b"; got '):
        check_choice("axis", value, ("a", "b"))


@pytest.mark.parametrize(
    "value", [(640, 480), [640, 480], (640.0, 480.0), np.array([640, 480]), np.array([640.0, 480])]
)
def test_image_size_becomes_two_ints(value):
    size = as_image_size(value)
    assert size == (640, 480)
    assert [type(number) for number in size] == [int, int]


def test_image_size_may_be_unknown():
    assert as_image_size(None) is None


@pytest.mark.parametrize(
    "value",
    [
        pytest.param(np.ones((2, 2)), id="table"),
        pytest.param(np.ones((480, 640, 3)), id="an image"),
        pytest.param(object(), id="object"),
        pytest.param((10**400, -1), id="huge and negative"),
    ],
)
def test_strange_image_sizes_are_refused_as_such(value):
    with pytest.raises(ValueError, match=r"`image_size` must be \(width, height\)"):
        as_image_size(value)


def test_owned_floats_are_a_read_only_copy():
    values = np.ones((2, 3), np.float32)
    owned = own_floats("x", values, 2, "(H, W)")
    values[:] = 9
    assert owned.dtype == np.float32
    assert (owned == 1).all()
    assert not owned.flags.writeable


def test_owned_views_do_not_keep_the_callers_memory():
    values = np.ones((100, 100))
    assert own_floats("x", values[::2, ::2], 2, "(H, W)").base is None


def test_array_summary_shows_shape_and_dtype():
    assert array_summary(None) == "None"
    assert array_summary(np.zeros((4, 5), np.bool_)) == "<(4, 5) bool>"


# --- values with their errors ---


@pytest.mark.parametrize(
    ("value", "std", "expected"),
    [
        # the three examples of the PDG's Review, Introduction 5.3
        pytest.param(0.827, 0.119, "0.83 +- 0.12", id="119: two digits"),
        pytest.param(0.827, 0.367, "0.8 +- 0.4", id="367: one digit"),
        pytest.param(14.674, 0.964, "14.7 +- 1.0", id="964: 1000, two digits"),
        # its limits, 100-354, 355-949, 950-999
        pytest.param(1.0, 0.354, "1.00 +- 0.35", id="354"),
        pytest.param(1.0, 0.355, "1.0 +- 0.4", id="355"),
        pytest.param(1.0, 0.949, "1.0 +- 0.9", id="949"),
        pytest.param(1.0, 0.951, "1.0 +- 1.0", id="951"),
        pytest.param(2.5, 0.100, "2.50 +- 0.10", id="100"),
        pytest.param(0.281, 0.008, "0.281 +- 0.008", id="design's example"),
        pytest.param(0.00138595, 0.0000227, "0.001386 +- 0.000023", id="small"),
        pytest.param(-0.827, 0.119, "-0.83 +- 0.12", id="negative"),
        pytest.param(1234.5, 36.7, "1234 +- 37", id="no decimals before the point"),
    ],
)
def test_values_are_rounded_as_the_particle_data_group_does(value, std, expected):
    assert with_error(value, std) == expected


@pytest.mark.parametrize("std", [0.0, math.nan, math.inf, -0.1])
def test_value_without_a_usable_error_stands_alone(std):
    assert with_error(0.28123456, std) == "0.2812"


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_value_that_is_not_finite_stands_alone(value):
    assert with_error(value, 0.1) == str(value)


@given(exponent=st.integers(-12, 12), mantissa=st.floats(1.0, 9.4))
def test_the_printed_error_is_within_a_fifth_of_the_error(exponent, mantissa):
    std = mantissa * 10.0**exponent
    printed = float(with_error(0.0, std).partition(" +- ")[2])
    if std >= 1:  # decimals only: large errors keep their whole digits
        assert printed == pytest.approx(std, abs=0.5)
    else:
        assert printed == pytest.approx(std, rel=0.15)


@given(exponent=st.integers(-12, 0), mantissa=st.floats(1.0, 9.99))
def test_an_error_ten_times_smaller_justifies_one_more_decimal(exponent, mantissa):
    std = mantissa * 10.0**exponent
    for edge in (354.5, 949.5):
        assume(abs(mantissa * 100 - edge) > 0.01)
    assert digits_for(std / 10) == digits_for(std) + 1


@pytest.mark.parametrize("exponent", range(-9, 1))
def test_powers_of_ten_keep_two_digits(exponent):
    assert digits_for(float(f"1e{exponent}")) == 1 - exponent


def test_table_aligns_the_first_column_left_and_the_others_right():
    rows = [("car", "1.6"), ("traffic light", "11.07")]
    assert text_table(("label", "size"), rows).splitlines() == [
        "label           size",
        "-------------  -----",
        "car              1.6",
        "traffic light  11.07",
    ]


def test_table_without_rows_is_its_header():
    assert text_table(("label", "size"), []).splitlines() == ["label  size", "-----  ----"]


def test_table_has_no_trailing_blanks():
    table = text_table(("a", "b"), [("x", ""), ("longer", "1")])
    assert all(line == line.rstrip() for line in table.splitlines())


# --- optional packages ---


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Write an importable package of one module and forget it afterwards."""
    monkeypatch.syspath_prepend(tmp_path)

    def make(name, code):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(code, encoding="utf-8")
        return name

    yield make
    for name in [name for name in sys.modules if name.partition(".")[0].endswith("_zq")]:
        del sys.modules[name]


def test_require_returns_the_module():
    assert require("json", extra="plot", purpose="A test") is sys.modules["json"]


def test_require_returns_the_submodule_not_its_package():
    found = require("xml.dom.minidom", extra="plot", purpose="A test")
    assert found.__name__ == "xml.dom.minidom"


@pytest.mark.parametrize("module", ["no_such_package_zq", "no_such_package_zq.deep.part"])
def test_absent_package_is_named_with_the_pip_command(module):
    law = re.escape(
        "plotting needs the optional package 'no_such_package_zq'; "
        "install it with `pip install 'imgscale[plot]'`."
    )
    with pytest.raises(imgscale.MissingDependencyError, match=law) as caught:
        require(module, extra="plot", purpose="plotting")
    assert isinstance(caught.value.__cause__, ModuleNotFoundError)


def test_hidden_package_counts_as_absent(monkeypatch):
    monkeypatch.setitem(sys.modules, "json", None)
    with pytest.raises(imgscale.MissingDependencyError, match="'json'"):
        require("json", extra="plot", purpose="A test")


@pytest.mark.parametrize(
    ("name", "code", "cause"),
    [
        ("half_installed_zq", "import another_absent_zq", "ModuleNotFoundError.*another_absent_zq"),
        ("broken_zq", "from broken_zq import _native", "ImportError.*_native"),
        ("torn_zq", "import torn_zq._compiled", r"ModuleNotFoundError.*torn_zq\._compiled"),
        ("failing_zq", "raise OSError('no shared object file')", "OSError: no shared object file"),
    ],
)
def test_a_package_that_is_there_but_broken_is_not_called_absent(package, name, code, cause):
    law = rf"'{name}', which is there but cannot be imported \({cause}.*--force-reinstall 'imgscale"
    with pytest.raises(imgscale.MissingDependencyError, match=law) as caught:
        require(package(name, code), extra="plot", purpose="A test")
    assert caught.value.__cause__ is not None


# --- exceptions ---


@pytest.mark.parametrize("error", EXCEPTIONS)
def test_exceptions_are_the_packages_own_and_at_its_face(error):
    assert issubclass(error, imgscale.ImgscaleError)
    assert getattr(imgscale, error.__name__) is error


@pytest.mark.parametrize(
    ("error", "builtin"),
    [
        (errors.FitError, ValueError),
        (errors.DepthMismatchError, ValueError),
        (errors.MissingDependencyError, ImportError),
    ],
)
def test_exceptions_are_caught_as_the_builtin_a_caller_expects(error, builtin):
    with pytest.raises(builtin, match="why"):
        raise error("why")


def test_every_exception_of_the_module_is_listed():
    defined = {
        name
        for name, value in vars(errors).items()
        if isinstance(value, type) and issubclass(value, Exception)
    }
    assert defined == set(errors.__all__)


@pytest.mark.parametrize("error", EXCEPTIONS)
@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_every_exception_survives_pickling(error, protocol):
    original = error("`k` must be; got nothing.")
    clone = pickle.loads(pickle.dumps(original, protocol))  # noqa: S301 - our own bytes
    assert type(clone) is error
    assert str(clone) == str(original)
    assert clone.args == original.args


@pytest.mark.parametrize(
    "provoke",
    [
        pytest.param(
            lambda: imgscale.fit([], imgscale.ObjectDepths([], kind="metric")), id="FitError"
        ),
        pytest.param(
            lambda: require("no_such_package_zq", extra="plot", purpose="A"),
            id="MissingDependencyError",
        ),
    ],
)
def test_exceptions_as_raised_survive_pickling(provoke):
    with pytest.raises(imgscale.ImgscaleError) as caught:
        provoke()
    clone = pickle.loads(pickle.dumps(caught.value))  # noqa: S301 - our own bytes
    assert (type(clone), str(clone)) == (type(caught.value), str(caught.value))


# --- protocols ---


class Callable:
    """An object that serves as a detector or depth source."""

    def __call__(self, image):
        return [Detection("car", (0, 0, *image.shape[1::-1]))]


@pytest.mark.parametrize(
    "candidate",
    [
        pytest.param(lambda image: [], id="lambda"),  # noqa: ARG005 - the shape is the point
        pytest.param(Callable(), id="object"),
        pytest.param(Callable().__call__, id="method"),
    ],
)
@pytest.mark.parametrize("protocol", [Detector, DepthSource])
def test_any_function_of_an_image_is_a_detector_or_a_depth_source(protocol, candidate):
    assert isinstance(candidate, protocol)


@pytest.mark.parametrize("candidate", [None, "yolo", [Detection("car", (0, 0, 1, 1))]])
@pytest.mark.parametrize("protocol", [Detector, DepthSource])
def test_what_cannot_be_called_is_neither(protocol, candidate):
    assert not isinstance(candidate, protocol)


def test_a_depth_map_is_not_a_depth_source():
    assert not isinstance(DepthMap([[1.0]], kind="relative"), DepthSource)
