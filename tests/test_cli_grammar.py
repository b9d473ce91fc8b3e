"""The small grammars of the command line: what is read, what is refused."""

from argparse import ArgumentTypeError
from fractions import Fraction

import pytest

from imgscale.cli._grammar import box, reference

# --- references ---


@pytest.mark.parametrize(
    ("text", "label", "size_m", "error_m", "axis"),
    [
        ("pole=1.0", "pole", 1.0, 0.005, "height"),
        ("pole = 1", "pole", 1.0, 0.005, "height"),
        ("pole=.5", "pole", 0.5, 0.0025, "height"),
        ("pole=1.0+-0.01", "pole", 1.0, 0.01, "height"),
        ("pole=1.0 ± 0.01", "pole", 1.0, 0.01, "height"),
        ("pole=1.0+/-0.01", "pole", 1.0, 0.01, "height"),
        ("pole=1.0+-0", "pole", 1.0, 0.0, "height"),
        ("pole=100cm", "pole", 1.0, 0.005, "height"),
        ("pole=100 cm +- 5 mm", "pole", 1.0, 0.005, "height"),
        ("pole=1m+-1cm", "pole", 1.0, 0.01, "height"),
        ("door=2.03+-0.5%", "door", 2.03, 0.01015, "height"),
        ("man=6ft 2in", "man", Fraction("1.8796"), Fraction("0.009398"), "height"),
        ("man=6ft2in+-1in", "man", Fraction("1.8796"), Fraction("0.0254"), "height"),
        ("plank=6ft", "plank", Fraction("1.8288"), Fraction("0.009144"), "height"),
        ("plate=0.52 width", "plate", 0.52, 0.0026, "width"),
        ("plate=52cm+-1mm width", "plate", 0.52, 0.001, "width"),
        ("coin=23.25mm diameter", "coin", 0.02325, 0.00011625, "diameter"),
        ("EU=plate=0.52 width", "EU=plate", 0.52, 0.0026, "width"),
        ("mast=30m", "mast", 30.0, 0.15, "height"),
        ("bus stop sign=2.5", "bus stop sign", 2.5, 0.0125, "height"),
    ],
)
def test_a_reference_is_read(text, label, size_m, error_m, axis):
    prior = reference(text)
    assert prior.label == label
    assert prior.mean_m == pytest.approx(float(size_m), rel=1e-12)
    assert prior.mean_std_m == pytest.approx(float(error_m), rel=1e-9)
    assert prior.std_m == 0
    assert prior.axis == axis
    assert prior.source == f"--reference {text}"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("pole", "must be LABEL=SIZE, as in pole=1.0; got 'pole'"),
        ("=1.0", "must be LABEL=SIZE"),
        ("pole=", "must be LABEL=SIZE"),
        ("pole=1,0", "must have a point for decimals"),
        ("pole=1,000.5", "must have a point for decimals"),
        ("pole=1.0+-0,01", "must have a point for decimals"),
        ("pole=100", "must say the unit of 100, which would be metres: pole=100cm, or pole=100m"),
        ("pole=100+-1cm", "must say the unit of 100"),
        ("pole=1.0+-1cm", "must have a unit on size and error, or on none"),
        ("pole=1.0m+-0.01", "must have a unit on size and error, or on none"),
        ("pole=1.0+-0.01+-0.02", "must have one error"),
        ("pole=1.0+-1.0", "must have an error below the size"),
        ("pole=1.0+-100%", "must have an error below the size"),
        ("pole=1.0+-", "must be LABEL=SIZE[UNIT]"),
        ("pole=-1.0", "must be LABEL=SIZE[UNIT]"),
        ("pole=1e0", "must be LABEL=SIZE[UNIT]"),
        ("pole=nan", "must be LABEL=SIZE[UNIT]"),
        ("pole=1.0x width", "must be LABEL=SIZE[UNIT]"),
        ("pole=1.0width", "must be LABEL=SIZE[UNIT]"),
        ("pole=1.0 length", "an axis of height, width, diameter"),
        ("pole=6'2\"", "must be LABEL=SIZE[UNIT]"),
        ("pole=6ft 2cm", "must be LABEL=SIZE[UNIT]"),
        ("pole=1.0 yd", "a unit of m, cm, mm, in, ft"),
        ("pole=1.0 M", "must be LABEL=SIZE[UNIT]"),
        ("pole=0", "the size must be finite and positive"),
        ("car=15", 'the size of "car" must be in metres'),
    ],
)  # fmt: skip
def test_what_is_no_reference_or_could_be_two_is_refused(text, message):
    with pytest.raises(ArgumentTypeError) as caught:
        reference(text)
    assert message in str(caught.value)


# --- boxes ---


@pytest.mark.parametrize(
    ("text", "label", "xyxy"),
    [
        ("gate=10,20,110,70", "gate", (10, 20, 110, 70)),
        ("gate = 10.5, 20, 110.25, 70", "gate", (10.5, 20, 110.25, 70)),
        ("gate=-3,20,110,70", "gate", (-3, 20, 110, 70)),
        ("a=b=1,2,3,4", "a=b", (1, 2, 3, 4)),
    ],
)
def test_a_box_is_read(text, label, xyxy):
    detection = box(text)
    assert (detection.label, detection.xyxy) == (label, xyxy)
    assert detection.score == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("10,20,110,70", "must be LABEL=X1,Y1,X2,Y2, as in"),
        ("gate=10,20,110", "four numbers of pixels"),
        ("gate=10,20,110,70,1", "four numbers of pixels"),
        ("gate=10,20,110,x", "four numbers of pixels"),
        ("gate=10,20,110,nan", "four numbers of pixels"),
        ("gate=110,20,10,70", "two corners, no width and height"),
        ("=1,2,3,4", "must be LABEL=X1,Y1,X2,Y2, as in"),
    ],
)
def test_what_is_no_box_is_refused(text, message):
    with pytest.raises(ArgumentTypeError) as caught:
        box(text)
    assert message in str(caught.value)
