"""What a notebook shows: escaped, sorted, numbered, with flags in words and honest digits."""

import math
import re
from html.parser import HTMLParser

import attrs
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import imgscale as ims
from imgscale import Flag
from imgscale._html import Column, Markup, element, escaped, joined, name_of, table
from imgscale.flags import flag_meanings, flag_names, flag_words

VOID = {"img", "meta"}
NASTY = "<script>alert('x')</script> & \"co\"</td></table>"


class Parsed(HTMLParser):
    """Elements, attributes, and the texts of cells row by row; end tags must match."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.attributes, self.rows, self.text = [], [], [], [], ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        assert len(dict(attrs)) == len(attrs)
        self.tags.append(tag)
        self.attributes += attrs
        if tag not in VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in {"td", "th"}:
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data
        if {"td", "th"} & set(self.open):
            self.rows[-1][-1] += data

    def handle_comment(self, data):
        raise AssertionError(data)

    handle_decl = handle_pi = unknown_decl = handle_comment


def estimate(label="car", size_m=1.5, std_m=0.06, **options):
    return ims.SizeEstimate(
        **{
            "label": label, "axis": "height", "size_m": size_m, "std_m": std_m,
            "metres_per_pixel": 0.01, "depth": 7.0, "distance_m": None, "flags": Flag(0), **options,
        }
    )  # fmt: skip


def box(label, height, left=50.0, **options):
    return ims.Detection(label, (left, 20.0, left + 40.0, 20.0 + height), **options)


TABLE = ims.PriorTable([ims.ObjectPrior("pole", 1.7, 0.05), ims.ObjectPrior("gate", 1.1, 0.2)])


def measured(labels=("gate", "pole", "thing", "pole", "pole", "pole"), **options):
    """A heavy pole, a light gate, a thing without a prior, an outlier, a part, no depth."""
    heights = [110.0, 170.0, 60.0, 900.0, 150.0, 170.0]
    detections = [
        box(label, height, left=60.0 * i + 10, partial=i == 4)
        for i, (label, height) in enumerate(zip(labels, heights, strict=False))
    ]
    values = [6.0, 6.0, 6.0, 6.0, 6.0, math.nan]
    return ims.measure(
        np.zeros((1000, 640, 3), dtype=np.uint8),
        detector=lambda _: detections,
        depth_source=lambda _: ims.ObjectDepths(values[: len(labels)], kind="relative"),
        priors=options.pop("priors", TABLE),
        noise=ims.Noise(box_px=1.0, depth_rel=0.02),
        **options,
    )


def named(result, name):
    return ims.Measurement(
        model=result.model, estimates=result.estimates, detections=result.detections,
        depth=result.depth, image_size=result.image_size, name=name,
    )  # fmt: skip


# --- the builder ---------------------------------------------------------------------------------


def test_children_and_attributes_are_escaped_once():
    built = element("p", "a < b & 'c'", element("b", "<i>"), title='"<&>"')
    assert built == (
        '<p title="&quot;&lt;&amp;&gt;&quot;">a &lt; b &amp; &#x27;c&#x27;<b>&lt;i&gt;</b></p>'
    )
    assert joined(["<", built], " & ") == f"&lt; &amp; {built}"


def test_void_elements_have_no_end_and_names_of_attributes_their_hyphens():
    assert element("meta", http_equiv="x", class_="y") == '<meta http-equiv="x" class="y">'


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("line\nbreak\ttab", "line break tab"),
        ("\x00\x1b[31m\x7f\x85", r"\x00\x1b[31m\x7f\x85"),
        ("evil\u202egpj", r"evil\u202egpj"),
        ("\u2066in\u2069", r"\u2066in\u2069"),
        ("lone \udc80", r"lone \udc80"),
        ("\u0645\u06cc\u200c\u062e", "\u0645\u06cc\u200c\u062e"),  # Persian needs its joiner
        ("👩\u200d🚒 \u00a0Ü", "👩\u200d🚒 \u00a0Ü"),
    ],
)
def test_what_cannot_be_seen_or_turns_the_text_is_shown(text, shown):
    assert Parsed(escaped(text)).text == shown


PRINTED = st.text(st.characters(codec="utf-8", categories=("L", "M", "N", "P", "S")))


@given(PRINTED)
def test_printed_text_comes_back_from_the_parser_as_it_was(text):
    assert Parsed(element("p", text, title=text)).text == text
    assert dict(Parsed(element("p", title=text)).attributes)["title"] == text


@given(st.text(st.characters(categories=("L", "M", "N", "P", "S", "Z", "C"))))
@example(NASTY)
def test_any_text_makes_one_element_that_can_be_written(text):
    built = name_of(text)
    assert Parsed(built).tags == ["bdi"]
    assert not re.search("[\x00-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]", built)
    built.encode()


def test_a_table_leaves_out_empty_columns_and_counts_hidden_rows():
    columns = [Column("name"), Column("size", numeric=True), Column("notes")]
    parsed = Parsed(table(columns, [["a", "1", ""], ["b", "2", ""], ["c", "3", ""]], most=2))
    assert parsed.rows == [["name", "size"], ["a", "1"], ["b", "2"]]
    assert parsed.text.endswith("and 1 more")
    assert "more" not in table(columns, [["a", "1", ""]], most=1)


# --- flags ---------------------------------------------------------------------------------------


def test_every_flag_has_words_and_a_meaning_of_its_own():
    everything = ~Flag(0)
    words, meanings = flag_words(everything), flag_meanings(everything)
    assert len(set(words)) == len(set(meanings)) == len(words) == len(Flag)
    assert all(len(word) <= 25 and "_" not in word for word in words)
    assert all(meaning.endswith(".") and len(meaning) < 110 for meaning in meanings)
    assert not set(flag_names(everything)) & set(" ".join(words + meanings).split())


def test_flag_words_stand_in_the_order_of_the_names():
    flags = Flag.ASSUMED_HORIZON | Flag.PARTIAL | Flag.OUTLIERS
    assert flag_names(flags) == ["OUTLIERS", "PARTIAL", "ASSUMED_HORIZON"]
    assert flag_words(flags) == ["outlier", "partly visible", "assumed horizon"]
    assert flag_words(Flag(0)) == flag_meanings(Flag(0)) == []


# --- estimates -----------------------------------------------------------------------------------


def test_an_estimate_shows_size_interval_distance_and_words():
    flags = Flag.PARTIAL | Flag.MIXED_DEPTH
    parsed = Parsed(estimate("a <b>", distance_m=7.25, flags=flags)._repr_html_())
    # 1.5 times exp(+-1.645 * 0.04)
    assert parsed.rows == [
        ["object", "height", "90\u00a0% interval", "distance", "notes"],
        ["a <b>", "1.50 ± 0.06 m", "1.40 to 1.60 m", "7.25 m",
         "two surfaces in the box, partly visible"],
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("size", "std", "shown"),
    [
        # the examples of the Particle Data Group's rule: 0.827 +- 0.119, 0.367 become these
        (0.827, 0.119, "0.83 ± 0.12 m"),
        (0.827, 0.367, "0.8 ± 0.4 m"),
        (14.674, 0.964, "14.7 ± 1.0 m"),
        (1234.5, 12.0, "1234 ± 12 m"),
        (2.0, 0.0, "2 m"),
    ],
)
def test_sizes_have_the_digits_that_their_error_justifies(size, std, shown):
    assert Parsed(estimate(size_m=size, std_m=std)._repr_html_()).rows[1][1] == shown


def test_an_unknown_size_says_why_and_has_no_interval():
    parsed = Parsed(estimate(size_m=math.nan, std_m=math.nan, flags=Flag.NO_DEPTH)._repr_html_())
    assert parsed.rows == [["object", "height", "notes"], ["car", "unknown", "no depth"]]


@pytest.mark.parametrize(("std", "shown"), [(math.inf, "about 2.0 m"), (0.5, "2.0 ± 0.5 m")])
def test_a_size_without_an_upper_end_says_what_it_is_above(std, shown):
    quantiles = tuple([1.0] * 14 + [2.0] * 6 + [math.inf] * 9)
    html = estimate(size_m=2.0, std_m=std, quantiles_m=quantiles)._repr_html_()
    assert Parsed(html).rows[1][1:] == [shown, "above 1.0 m"]


# --- models --------------------------------------------------------------------------------------


def test_references_stand_by_weight_then_the_rejected_then_those_without_a_prior():
    result = measured()
    rows = Parsed(result.model._repr_html_()).rows
    weights = {ref.label: ref.weight for ref in result.model.references if ref.used}
    assert weights["pole"] > weights["gate"]
    assert [(row[0], row[-1]) for row in rows[1:]] == [
        ("pole 1", "used"), ("gate", "used"), ("pole 2", "not used: outlier"),
        ("pole 3", "not used: partial"), ("pole 4", "not used: no depth"),
        ("thing", "no known size"),
    ]  # fmt: skip


def test_the_rows_of_a_model_hold_its_numbers():
    model = measured().model
    header, pole, *_ = Parsed(model._repr_html_()).rows
    found = dict(zip(header, pole, strict=True))
    reference = model.references[1]
    assert found["known size"] == "1.70 ± 0.05 m"
    assert (found["pixels"], found["depth"]) == ("170", "6")
    assert found["share in k"] == f"{100 * reference.weight:.0f} %"
    assert float(found["z-score"]) == pytest.approx(reference.z_score, abs=0.05)


def test_a_model_begins_like_its_text_with_reservations_in_words():
    model = measured().model
    text = Parsed(model._repr_html_()).text
    assert text.startswith(str(model).split(";")[0].replace("+-", "±"))
    assert "Reservations: outlier" in text


def test_foot_rows_are_not_called_depths():
    street = [box("pole", 200.0), box("pole", 100.0, left=200), box("gate", 90.0, left=400)]
    model = ims.fit(street, ims.GroundPlane(image_size=(640, 480)), TABLE)
    header = Parsed(model._repr_html_()).rows[0]
    assert "foot row" in header
    assert "depth" not in header


def test_five_hundred_references_show_the_heaviest_thirty():
    detections = [box("pole", 100.0 + i) for i in range(500)]
    depth = ims.ObjectDepths([600 / (100 + i) for i in range(500)], kind="relative")
    model = ims.fit(detections, depth, TABLE, method="robust", noise=ims.Noise(depth_rel=0.02))
    html = model._repr_html_()
    parsed = Parsed(html)
    assert len(parsed.rows) == 1 + 30
    assert parsed.text.endswith("and 470 more")
    assert parsed.rows[1][0] == "pole 500"  # the largest box errs least
    assert len(html) < 40_000


KNOWN = Flag.REFERENCE | Flag.OUTLIERS

# --- measurements --------------------------------------------------------------------------------


def test_a_measurement_lists_what_was_asked_for_first_with_the_numbers_of_its_table():
    result = named(measured(), "street.jpg")
    parsed = Parsed(result._repr_html_())
    assert parsed.text.startswith("street.jpg")
    header, *rows = parsed.rows
    assert header[:3] == ["object", "height", "90\u00a0% interval"]
    names = ("gate", "pole 1", "thing", "pole 2", "pole 3", "pole 4")
    order = sorted(range(6), key=lambda row: bool(result.estimates[row].flags & KNOWN))
    assert [row[0] for row in rows] == [names[row] for row in order]
    assert names[order[0]] == "thing"
    known_rows = [result.table()[row] for row in order]
    for row, known in zip(rows, known_rows, strict=True):
        if known["size_m"] is None:
            assert row[1:3] == ["unknown", ""]
            continue
        shown = [number for cell in row[1:3] for number in re.findall(r"[\d.]+", cell)]
        decimals = {len(number.partition(".")[2]) for number in shown}
        assert len(decimals) == 1
        size, _, low, high = map(float, shown)
        half = 0.501 * 10.0 ** -decimals.pop()
        assert abs(size - known["size_m"]) <= half
        assert abs(low - known["low_m"]) <= half
        assert abs(high - known["high_m"]) <= half


def test_an_interval_without_an_upper_end_is_printed_as_one():
    result = measured(labels=("pole",))
    quantiles = tuple([1.0] * 14 + [2.0] * 6 + [math.inf] * 9)
    open_end = attrs.evolve(result.estimates[0], size_m=2.0, quantiles_m=quantiles)
    row = str(attrs.evolve(result, estimates=(open_end,))).splitlines()[-1]
    assert "above 1.0" in row


def test_nothing_found_is_an_empty_table():
    result = measured(labels=("pole",))
    empty = ims.Measurement(
        model=result.model, estimates=(), detections=(), depth=result.depth, image_size=(9, 9)
    )
    assert Parsed(empty._repr_html_()).rows == [["object"]]


def views(result):
    return [result, result.model, result.estimates[0]]


def test_views_have_no_script_no_colour_no_address_and_scroll_in_their_own_box():
    for view in views(named(measured(), NASTY)):
        html = view._repr_html_()
        parsed = Parsed(html)
        assert not {"script", "style", "link", "img", "a"} & set(parsed.tags)
        names = {name for name, _ in parsed.attributes}
        assert names <= {"style", "scope", "role", "data-title"}
        styles = " ".join(value for name, value in parsed.attributes if name == "style")
        assert not re.search(r"color|background|font|url|#", styles)
        assert "overflow-x:auto" in html
        assert type(html) in {str, Markup}


@given(label=st.text(min_size=1).filter(str.strip), name=st.text())
@example(label=NASTY, name=NASTY)
@example(label="מכונית", name="lone \udc80\u202e")
def test_no_label_or_name_changes_the_structure(label, name):
    def tags(label, name):
        priors = ims.PriorTable([ims.ObjectPrior(label, 1.0, 0.1)])
        result = measured(labels=(label, "another thing"), priors=priors, method="robust")
        pages = [view._repr_html_() for view in views(named(result, name))]
        for page in pages:
            page.encode()
        return [Parsed(page).tags for page in pages]

    assert tags(label, name) == tags("plain", "x" if name else "")
