"""The page of results: one file, valid, safe, readable, and enough to repeat everything."""

import gc
import io
import json
import re
import subprocess
import sys
import weakref
from base64 import b64decode
from html.parser import HTMLParser

import attrs
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import imgscale as ims
from imgscale import Flag
from imgscale.datasets import motorcycle
from imgscale.flags import flag_meanings

pytest.importorskip("matplotlib", reason="matplotlib is not installed")

from PIL import Image

from imgscale import report
from imgscale.plotting import draw_sizes
from imgscale.report import html_page

NAN = float("nan")
VOID = {"img", "meta"}
NASTY = (
    "</title></h2><script>alert('x')</script><img src=x onerror=y> & \"co\" \x1b\u202egpj \udc80"
)
TABLE = ims.PriorTable(
    [
        ims.ObjectPrior("pole", 1.0, 0.02, source="measured, see https://example.org/<b>"),
        ims.ObjectPrior("gate", 0.8, 0.01, source="nominal", spans="ground to top bar"),
    ]
)


class Parsed(HTMLParser):
    """Elements and attributes in order, texts by element, cells row by row; end tags must match."""

    def __init__(self, page):
        super().__init__()
        self.open, self.elements, self.rows, self.texts, self.declared = [], [], [], {}, []
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        assert len(dict(attrs)) == len(attrs)
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)
        self.texts.setdefault(tag, []).append("")
        if tag == "tr":
            self.rows.append([])
        if tag in {"td", "th"}:
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        for tag in set(self.open):
            self.texts[tag][-1] += data
        if {"td", "th"} & set(self.open):
            self.rows[-1][-1] += data

    def handle_decl(self, decl):
        self.declared.append(decl)

    def handle_comment(self, data):
        raise AssertionError(data)

    handle_pi = unknown_decl = handle_comment

    @property
    def tags(self):
        return [tag for tag, _ in self.elements]

    def attributes(self, name):
        return [attributes[name] for _, attributes in self.elements if name in attributes]

    def sizes(self):
        """Rows of the table of sizes of the first picture."""
        start = next(i for i, row in enumerate(self.rows) if row[0] == "object")
        rows = self.rows[start + 1 :]
        end = next((i for i, row in enumerate(rows) if row[0] == "object"), len(rows))
        return rows[:end]

    def record(self):
        return json.loads(self.texts["pre"][-1])


BOXES = [
    ("pole", (20, 40, 50, 140)),
    ("pole", (80, 40, 110, 300)),
    ("gate", (140, 60, 200, 140)),
    ("thing", (240, 60, 280, 110)),
    ("cloud", (300, 20, 350, 60)),
    ("thing", (360, 30, 399, 90)),
]


def measured(name="", boxes=BOXES, **options):
    """Two references, an outlier, two things, one of them cut, and one without a depth."""
    image = np.full((320, 400, 3), 120, dtype=np.uint8)
    detections = [ims.Detection(label, box) for label, box in boxes]
    depths = [NAN if label == "cloud" else 5.0 for label, _ in boxes]
    options = {"priors": TABLE, "camera": ims.Camera(500.0, focal_rel_std=0.3)} | options
    result = ims.measure(
        image,
        detector=lambda _: detections,
        depth_source=lambda _: ims.ObjectDepths(depths, kind="metric", image_size=(400, 320)),
        noise=ims.Noise(box_px=1.0, depth_rel=0.02),
        **options,
    )
    return attrs.evolve(result, name=name), image


@pytest.fixture(scope="module")
def result():
    return measured("street.jpg")


@pytest.fixture(scope="module")
def page(result):
    return html_page([result])


@pytest.fixture
def undrawn(monkeypatch):
    """Leave the drawing out where it does not matter."""
    monkeypatch.setattr(report, "_figure", lambda *_: (report.element("figure"), False))


# --- the page as a document ----------------------------------------------------------------------


def test_a_document_with_language_encoding_viewport_and_title(page):
    parsed = Parsed(page)
    assert parsed.declared == ["DOCTYPE html"]
    assert parsed.elements[0] == ("html", {"lang": "en"})
    assert parsed.elements[2] == ("meta", {"charset": "utf-8"})
    assert "width=device-width, initial-scale=1" in parsed.attributes("content")
    assert parsed.texts["title"] == ["imgscale"]
    assert page.isascii() or page.encode()


def test_nothing_runs_and_nothing_is_fetched(page):
    parsed = Parsed(page)
    assert not {"script", "link", "iframe", "object", "form", "base"} & set(parsed.tags)
    names = {name for _, attributes in parsed.elements for name in attributes}
    assert not [name for name in names if name.startswith("on")]
    assert all(value.startswith("data:image/jpeg;base64,") for value in parsed.attributes("src"))
    assert all(value.startswith("#") for value in parsed.attributes("href"))
    assert not re.search(r"url\(|@import|http", "".join(parsed.texts["style"]))
    assert "default-src 'none'; img-src data:; style-src 'unsafe-inline'" in (
        parsed.attributes("content")
    )


def test_headings_stand_in_order_and_cells_have_their_headers(page):
    parsed = Parsed(page)
    levels = [int(tag[1]) for tag in parsed.tags if re.fullmatch("h[1-6]", tag)]
    assert levels == [1, 2, 3, 3]
    scopes = [attributes["scope"] for tag, attributes in parsed.elements if tag == "th"]
    assert set(scopes) == {"col", "row"}
    assert all(role for role in parsed.attributes("role"))


def contrast(one, other):
    """The ratio of WCAG 2.1."""

    def luminance(colour):
        parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
        return np.dot([0.2126, 0.7152, 0.0722], linear)

    low, high = sorted([luminance(one), luminance(other)])
    return (high + 0.05) / (low + 0.05)


def test_text_is_large_enough_and_has_contrast_in_light_dark_and_print(page):
    style = "".join(Parsed(page).texts["style"])
    schemes = [dict(re.findall(r"--(\w+): (#\w{6})", block)) for block in style.split(":root")[1:]]
    assert len(schemes) == 3
    for scheme in schemes:
        papers = [scheme["paper"], scheme.get("card", scheme["paper"])]
        assert all(contrast(scheme["ink"], paper) >= 7 for paper in papers)
        assert all(contrast(scheme[name], scheme["paper"]) >= 4.5 for name in ("soft", "link"))
    sizes = re.findall(r"font(?:-size)?: ([\d.]+)(\w+)", style)
    assert all(unit == "rem" and float(size) >= 1 for size, unit in sizes)
    assert len(sizes) >= 5


def test_the_same_results_give_the_same_page(result, page):
    assert html_page([result]) == page


def test_a_page_is_small(page):
    assert len(page) < 120_000
    scene = motorcycle.load()
    big = ims.measure(
        scene.image, detector=lambda _: scene.detections, depth_source=lambda _: scene.depth,
        priors=PRIORS, noise=scene.noise,
    )  # fmt: skip
    assert len(html_page([(big, scene.image)])) < 600_000


PRIORS = ims.PriorTable.default().with_prior(ims.ObjectPrior("rear tyre", 0.622, 0.012))


# --- what it says --------------------------------------------------------------------------------


@pytest.mark.parametrize(("unit", "level"), [("m", 0.9), ("cm", 0.683), ("ft", 0.99)])
@pytest.mark.usefixtures("undrawn")
def test_numbers_are_those_of_the_table(result, unit, level):
    measurement, _ = result
    rows = Parsed(html_page([result], unit=unit, level=level)).sizes()
    for row, known in zip(rows, measurement.table(unit=unit, level=level), strict=True):
        if known[f"size_{unit}"] is None:
            assert row[1:3] == ["unknown", ""]
            continue
        assert row[1].endswith(f" {unit}")
        numbers = [number for cell in row[1:3] for number in re.findall(r"[\d.]+", cell)]
        half = 0.501 * 10.0 ** -len(numbers[0].partition(".")[2])
        for number, name in zip((numbers[0], *numbers[2:]), ("size", "low", "high"), strict=True):
            assert abs(float(number) - known[f"{name}_{unit}"]) <= half
        assert float(row[3].split()[0]) == pytest.approx(known["distance_m"], rel=0.01)


def test_objects_are_numbered_in_their_order_with_flags_in_words(page):
    rows = Parsed(page).sizes()
    assert [row[0] for row in rows] == ["pole 1", "pole 2", "gate", "thing 1", "cloud", "thing 2"]
    assert [row[-1] for row in rows] == ["known size", "outlier", "known size", "", "no depth",
                                         "partly visible"]  # fmt: skip


def test_a_layman_reads_what_the_scale_comes_from(page):
    paragraphs = Parsed(page).texts["p"]
    assert (
        "The scale comes from 2 of 3 known objects (pole 1, gate) and the camera's focal length. "
        "Not used: pole 2 (contradicts the others)."
    ) in paragraphs
    assert any("with a probability of 90\u00a0%" in paragraph for paragraph in paragraphs)


def test_reservations_say_what_they_mean_and_whom_they_concern(page):
    items = Parsed(page).texts["li"]
    [outlier, no_depth, partial] = [flag_meanings(flag)[0] for flag in
                                    (Flag.OUTLIERS, Flag.NO_DEPTH, Flag.PARTIAL)]  # fmt: skip
    assert items == [
        f"outlier (pole 2): {outlier}",
        f"no depth (cloud): {no_depth}",
        f"partly visible (thing 2): {partial}",
    ]


def test_sources_of_the_known_sizes_are_told(page):
    rows = Parsed(page).rows
    assert [row for row in rows if row[0] == "gate"][-1] == [
        "gate", "height 0.800 ± 0.010 m", "ground to top bar", "nominal",
    ]  # fmt: skip
    assert any("see https://example.org/<b>" in row[-1] for row in rows)


def test_the_picture_shows_the_boxes_and_says_so(result, page):
    parsed = Parsed(page)
    [picture] = [attributes for tag, attributes in parsed.elements if tag == "img"]
    assert picture["alt"].startswith("The picture with 6 objects in boxes: pole 1 1.0")
    image = Image.open(io.BytesIO(b64decode(picture["src"].partition(",")[2])))
    assert image.size == (int(picture["width"]), int(picture["height"]))
    assert image.size[0] / image.size[1] == pytest.approx(400 / 320, rel=0.01)
    # the plain grey picture with nothing drawn would have no other colour
    assert np.ptp(np.asarray(image).astype(int), axis=2).max() > 60
    assert result[1].min() == result[1].max() == 120


@pytest.mark.parametrize("shape", [(3000, 4000), (2400, 800)])
def test_large_pictures_are_reduced_and_boxes_stay_on_their_objects(shape):
    height, width = shape
    image = np.zeros((height, width, 3), dtype=np.uint8)
    box = (width // 4, height // 4, width // 2, height // 2)
    image[box[1] : box[3], box[0] : box[2]] = (0, 200, 0)
    measurement = ims.measure(
        image, detector=lambda _: [ims.Detection("pole", box)],
        depth_source=lambda _: ims.ObjectDepths([5.0], kind="relative"), priors=TABLE,
    )  # fmt: skip
    parsed = Parsed(html_page([(measurement, image)]))
    data = b64decode(parsed.attributes("src")[0].partition(",")[2])
    assert len(data) < 200_000
    drawn = np.asarray(Image.open(io.BytesIO(data))).astype(int)
    assert max(drawn.shape) < max(shape)
    scale = max(drawn.shape) / max(shape)
    green = (drawn[..., 1] > 150) & (drawn[..., 0] < 50) & (drawn[..., 2] < 50)
    rows, columns = (np.flatnonzero(green.sum(axis) > 20) for axis in (1, 0))
    found = [columns[0], rows[0], columns[-1], rows[-1]]
    # the line around it, and the label, take some
    np.testing.assert_allclose(found, np.multiply(box, scale), atol=8)


def test_where_a_label_has_only_room_for_its_number_the_table_has_numbers(result, monkeypatch):
    def crowded(*arguments, **options):
        axes = draw_sizes(*arguments, **options)
        axes.texts[0].set_text("#1")
        return axes

    monkeypatch.setattr(report, "draw_sizes", crowded)
    rows = Parsed(html_page([result])).sizes()
    assert [row[0] for row in rows[:3]] == ["#1 pole 1", "#2 pole 2", "#3 gate"]


@pytest.mark.usefixtures("undrawn")
def test_without_objects_the_page_says_so():
    parsed = Parsed(html_page([measured(boxes=[])]))
    assert "No object was found in this picture." in parsed.texts["p"]
    assert "The scale comes from the camera's focal length." in parsed.texts["p"]
    assert "None." in parsed.texts["p"]


# --- several pictures ----------------------------------------------------------------------------


def test_several_pictures_have_an_overview_whose_links_lead_to_them():
    parsed = Parsed(
        html_page([measured("a.jpg"), measured(), measured("b/c.jpg", boxes=BOXES[:1])])
    )
    assert parsed.rows[0] == ["picture", "scale from", "objects", "reservations"]
    assert [row[0] for row in parsed.rows[1:4]] == ["a.jpg", "Picture 2", "b/c.jpg"]
    assert parsed.rows[3][1:3] == ["1 known object and the camera's focal length", "1"]
    assert parsed.rows[1][1:] == [
        "2 of 3 known objects and the camera's focal length", "6", "outlier",
    ]  # fmt: skip
    identifiers = parsed.attributes("id")
    assert len(set(identifiers)) == len(identifiers)
    assert parsed.attributes("href") == [f"#{identifier}" for identifier in identifiers]
    assert parsed.texts["h2"] == ["3 pictures", "a.jpg", "Picture 2", "b/c.jpg"]


def test_one_picture_has_no_overview(page):
    assert "nav" not in Parsed(page).tags


@pytest.mark.usefixtures("undrawn")
def test_a_table_of_sizes_is_recorded_once():
    shared = [measured(f"{i}.jpg", priors=PRIORS.with_prior(TABLE.priors[0])) for i in range(20)]
    record = Parsed(html_page([*shared, measured()])).record()
    assert len(record["priors"]) == 2
    assert [picture["priors"] for picture in record["pictures"]] == [0] * 20 + [1]
    assert len(html_page(shared)) - len(html_page(shared[:1])) < 19 * 25_000


def test_pictures_are_let_go_one_after_the_other():
    seen = []

    def results():
        for _ in range(4):
            gc.collect()  # figures refer to themselves
            assert sum(image() is not None for image in seen) <= 1
            measurement, image = measured()
            seen.append(weakref.ref(image))
            yield measurement, image
            del image

    assert len(Parsed(html_page(results())).attributes("src")) == 4


def test_a_path_is_read_upright(tmp_path, result):
    measurement, image = result
    exif = Image.Exif()
    exif[0x0112] = 6  # the camera was turned
    Image.fromarray(np.rot90(image)).save(tmp_path / "a.png", exif=exif)
    turned = html_page([(measurement, tmp_path / "a.png")])
    assert Parsed(turned).attributes("src")[0].startswith("data:image/jpeg")


# --- the record ----------------------------------------------------------------------------------


def test_the_record_rebuilds_equal_models_and_holds_the_table(result, page):
    record = Parsed(page).record()
    [picture] = record["pictures"]
    priors = record["priors"][picture["priors"]]
    measurement, _ = result
    assert ims.ScaleModel.from_dict(picture["model"] | {"priors": priors}) == measurement.model
    assert picture["objects"] == measurement.table()
    assert (picture["name"], picture["image_size"]) == ("street.jpg", [400, 320])
    assert record["imgscale"] == ims.__version__
    assert record["options"] == {"unit": "m", "level": 0.9}
    assert [row["source"] for row in priors] == [row.source for row in TABLE]


# --- hostile texts -------------------------------------------------------------------------------


def test_hostile_names_labels_and_titles_are_shown_as_they_are():
    boxes = [("pole", BOXES[0][1]), (NASTY, BOXES[2][1])]
    page = html_page([measured(NASTY, boxes=boxes)], title=NASTY)
    page.encode()
    parsed = Parsed(page)
    plain = Parsed(html_page([measured("a", boxes=[boxes[0], ("b", BOXES[2][1])])], title="c"))
    assert parsed.tags == plain.tags
    shown = NASTY.replace("\x1b", r"\x1b").replace("\u202e", r"\u202e").replace("\udc80", r"\udc80")
    assert parsed.texts["h1"] == parsed.texts["h2"] == [shown]
    assert parsed.sizes()[1][0] == shown
    assert shown in parsed.attributes("alt")[0]
    assert not re.search("[\x00-\x09\x0b-\x1f\x7f-\x9f\u202a-\u202e]", page)
    assert parsed.record()["pictures"][0]["name"] == NASTY


@settings(deadline=None)
@given(label=st.text(min_size=1).filter(str.strip), name=st.text())
@example(label="]]>--><!--", name="&amp;<")
def test_no_label_or_name_changes_the_structure(label, name):
    def tags(label, name):
        boxes = [(label, BOXES[0][1]), ("other", BOXES[2][1])]
        priors = ims.PriorTable([ims.ObjectPrior(label, 1.0, 0.02, source=name, spans=name)])
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(report, "_figure", lambda *_: (report.element("figure"), False))
            page = html_page([measured(name, boxes=boxes, priors=priors, method="robust")])
        page.encode()
        parsed = Parsed(page)
        assert parsed.record()["pictures"][0]["objects"][0]["label"] == label
        return parsed.tags

    assert tags(label, name) == tags("plain", "x" if name else "")


# --- errors --------------------------------------------------------------------------------------


def test_no_result_is_an_error():
    with pytest.raises(ValueError, match="at least one pair of a Measurement and its picture"):
        html_page([])


@pytest.mark.parametrize("wrong", [(1,), ("a", "b"), None, "ab"])
def test_what_is_no_pair_is_named_by_its_place(result, wrong):
    with pytest.raises(TypeError, match=r"`results\[1\]` must be a pair of a Measurement and its"):
        html_page([result, wrong])


def test_a_pair_alone_is_told_to_go_into_a_list(result):
    with pytest.raises(TypeError, match=r"`results\[0\]`.*got Measurement. Put a single pair in a"):
        html_page(result)
    with pytest.raises(TypeError, match="`results` must be a sequence"):
        html_page(result[0])


def test_a_picture_of_another_size_is_an_error(result):
    measurement, image = result
    law = r"`results\[0\]` must have the picture that was measured, 400 x 320 px and upright; got "
    with pytest.raises(ValueError, match=law + "one of 320 x 400 px"):
        html_page([(measurement, image.transpose(1, 0, 2))])


def test_what_is_no_picture_is_named_by_its_place(result):
    with pytest.raises(ValueError, match=r"results\[0\]: `image` must be \(H, W, 3\) uint8 RGB"):
        html_page([(result[0], np.zeros((320, 400)))])
    with pytest.raises(TypeError, match=r"results\[0\]: `image` must be a path, an array"):
        html_page([(result[0], 3)])


@pytest.mark.parametrize(
    ("options", "law"),
    [
        ({"title": " "}, "`title` must not be blank"),
        ({"unit": "km"}, '`unit` must be one of "m", "cm"'),
        ({"level": 90}, "`level` must be above 0 and below 1; got 90"),
    ],
)
def test_options_that_break_their_law_are_errors(result, options, law):
    with pytest.raises(ValueError, match=law):
        html_page([result], **options)
    with pytest.raises(TypeError, match="`title` must be a str"):
        html_page([result], title=3)


# --- imports -------------------------------------------------------------------------------------


def test_pyplot_is_not_loaded_and_matplotlib_only_to_draw():
    code = (
        "import sys, numpy as np, imgscale as ims\n"
        "from imgscale.report import html_page\n"
        "assert not {'matplotlib', 'PIL', 'skimage'} & set(sys.modules)\n"
        "image = np.zeros((300, 300, 3), dtype=np.uint8)\n"
        "r = ims.measure(image, detector=lambda i: [ims.Detection('door', (10, 10, 90, 210))],\n"
        "    depth_source=lambda i: ims.ObjectDepths([4.0], kind='relative'))\n"
        "html_page([(r, image)])\n"
        "assert 'matplotlib' in sys.modules and 'matplotlib.pyplot' not in sys.modules\n"
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
