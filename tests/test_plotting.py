"""Pictures of sizes: what is drawn where, measured on what the renderer draws."""

import io
import pickle
import re
import subprocess
import sys
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import skimage as ski
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

import imgscale as ims
from imgscale import Flag
from imgscale.datasets import motorcycle
from imgscale.flags import flag_words

pytest.importorskip("matplotlib", reason="matplotlib is not installed")

from matplotlib import font_manager
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from imgscale.plotting import draw_sizes
from imgscale.plotting._labels import place_labels, place_panel

NAN = float("nan")
NO_FLAGS = Flag(0)


def results(width, height, label="thing"):
    detections = [
        ims.Detection("pole", (0.1 * width, 0.1 * height, 0.2 * width, 0.8 * height)),
        ims.Detection(label, (0.5 * width, 0.4 * height, 0.7 * width, 0.6 * height)),
        ims.Detection("far", (0.8 * width, 0.4 * height, 0.9 * width, 0.6 * height)),
    ]
    depth = ims.ObjectDepths([4.0, 4.0, np.nan], kind="relative", rel_std=0.0)
    table = ims.PriorTable([ims.ObjectPrior("pole", 0.7, 0.01)])
    model = ims.fit(detections, depth, table, method="robust", noise=ims.Noise(box_px=0.0))
    image = np.zeros((height, width, 3), dtype=np.uint8)
    return image, detections, ims.predict(model, detections, depth)


def estimate(label="thing", size=1.5, std=0.06, flags=NO_FLAGS, axis="height", **fields):
    return ims.SizeEstimate(
        label=label, axis=axis, size_m=size, std_m=std, metres_per_pixel=0.01,
        distance_m=None, flags=flags, **{"depth": 5.0} | fields,
    )  # fmt: skip


def one(label="thing", *, unit="m", level=0.9, **fields):
    """Draw one estimate on black."""
    image, detection = np.zeros((480, 640)), ims.Detection(label, (100, 100, 200, 200))
    return draw_sizes(image, [detection], [estimate(label, **fields)], unit=unit, level=level)


def crowd(count, size, seed, *, spread=1.0):
    """Boxes of many sizes, over the picture or crowded into its middle."""
    rng = np.random.default_rng(seed)
    width, height = size
    kinds = [Flag.REFERENCE, Flag(0), Flag.OUTLIERS, Flag.MIXED_DEPTH, Flag.PARTIAL]
    detections, estimates = [], []
    for index in range(count):
        w, h = rng.uniform(0.01, 0.15, 2) * size
        x = (0.5 + spread * (rng.random() - 0.5)) * (width - w)
        y = (0.5 + spread * (rng.random() - 0.5)) * (height - h)
        label = ("car", "person", "bicycle")[index % 3]
        detections.append(ims.Detection(label, (x, y, x + w, y + h)))
        flags = kinds[index % len(kinds)]
        estimates.append(estimate(label, rng.uniform(0.5, 3), rng.uniform(0.02, 0.3), flags))
    image = np.full((height, width, 3), 128, dtype=np.uint8)
    return image, detections, estimates


def rendered(ax, **options):
    """Draw the figure as a file would be; return its pixels."""
    buffer = io.BytesIO()
    ax.figure.savefig(buffer, format="png", **options)
    with Image.open(buffer) as picture:
        return np.asarray(picture.convert("RGB"))


def plates(ax):
    """What is covered by the labels and the legend that are seen, in pixels of the figure."""
    found = [t.get_bbox_patch().get_window_extent() for t in ax.texts if t.get_visible()]
    legend = ax.get_legend()
    if legend is not None and legend.get_visible():
        found.append(legend.get_window_extent())
    return found


def check_layout(ax):
    """No label on another, and all within the photo."""
    found = plates(ax)
    frame = ax.get_window_extent()
    for extent in found:
        assert extent.x0 >= frame.x0 - 0.5
        assert extent.y0 >= frame.y0 - 0.5
        assert extent.x1 <= frame.x1 + 0.5
        assert extent.y1 <= frame.y1 + 0.5
    assert not any(a.overlaps(b) for a, b in combinations(found, 2))
    return found


# --- the file ------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "size", [(300, 200), (3840, 2160), (300, 1200), (1242, 375), (5000, 1), (1, 1)], ids=str
)
def test_the_file_has_at_least_the_photos_pixels_and_its_shape(size):
    height, width = rendered(draw_sizes(np.zeros((size[1], size[0]), np.uint8), [], [])).shape[:2]
    assert (width >= size[0], height >= size[1], max(width, height) >= 1000) == (True, True, True)
    assert width * size[1] == pytest.approx(height * size[0], abs=max(size))


def test_a_crowd_keeps_the_photos_shape():
    height, width = rendered(draw_sizes(*crowd(60, (600, 400), 0))).shape[:2]
    assert width / height == pytest.approx(1.5, rel=2e-3)


@pytest.mark.parametrize("ending", ["svg", "pdf"])
def test_vector_pictures_and_dollar_signs_in_labels_work(tmp_path, ending):
    draw_sizes(*results(640, 480, label="5 $ or 6 $")).figure.savefig(tmp_path / f"a.{ending}")
    assert (tmp_path / f"a.{ending}").stat().st_size > 1000


def test_the_box_surrounds_the_pixels_of_the_object():
    image = np.zeros((200, 300, 3), dtype=np.uint8)
    image[50:80, 100:150] = 255
    ax = draw_sizes(image, [ims.Detection("thing", (100, 50, 150, 80))], [estimate()])
    ax.patches[0].set_visible(False)
    for artist in (*ax.texts, ax.get_legend()):
        artist.set_visible(False)
    rows, columns = np.nonzero(rendered(ax).min(axis=2) > 128)
    (x0, y0), (x1, y1) = ax.transData.transform(ax.patches[0].get_bbox())
    height = rendered(ax).shape[0]
    assert (columns.min(), columns.max() + 1) == pytest.approx((x0, x1), abs=1)
    assert (rows.min(), rows.max() + 1) == pytest.approx((height - y0, height - y1), abs=1)


def test_figures_are_pickled():
    ax = draw_sizes(*results(300, 200))
    again = pickle.loads(pickle.dumps(ax.figure))  # noqa: S301 - our own
    assert (rendered(again.axes[0]) == rendered(ax)).all()


def test_nothing_is_drawn_through_pyplot_and_no_setting_changes(tmp_path):
    code = (
        "import sys, numpy as np; from matplotlib import rcParams;"
        "names = set(rcParams) - {'backend'};"  # reading it imports pyplot
        "before = {name: rcParams[name] for name in names};"
        "from imgscale.plotting import draw_sizes;"
        "import imgscale as ims;"
        "d = [ims.Detection('a', (1, 1, 5, 5))];"
        "e = [ims.SizeEstimate(label='a', axis='height', size_m=1.0, std_m=.1, depth=1.0,"
        "metres_per_pixel=.1, distance_m=None, flags=ims.Flag(0))];"
        "draw_sizes(np.zeros((9, 9)), d, e).figure.savefig(sys.argv[1]);"
        "assert {name: rcParams[name] for name in names} == before;"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "a.png")], check=True)


# --- the words -----------------------------------------------------------------------------------


def test_each_box_is_labelled_with_its_size_and_interval():
    texts = [text.get_text() for text in draw_sizes(*results(640, 480)).texts]
    # the thing is 0.2 of the height, the pole of 0.7 m is 0.7 of it; 1.4 % is 90 % of 1 / 70
    assert texts[1].startswith("thing\n0.2000 m (0.19")
    assert texts[2] == "far\nno depth"
    low, high = map(float, re.findall(r"\((.*) to (.*)\)", texts[1])[0])
    assert (low, high) == (pytest.approx(0.1953, abs=2e-4), pytest.approx(0.2048, abs=2e-4))


@pytest.mark.parametrize(
    ("unit", "text"),
    [
        ("m", "1.50 m (1.40 to 1.60)"),
        ("cm", "150 cm (140 to 160)"),
        ("mm", "1500 mm (1404 to 1602)"),
        ("in", "59.1 in (55.3 to 63.1)"),
        ("ft", "4.92 ft (4.61 to 5.26)"),
    ],
)
def test_sizes_are_written_in_the_unit_wanted(unit, text):
    # exp(1.6449 * 0.06 / 1.5) = 1.068; an inch is 0.0254 m, a foot 0.3048 m
    assert one(unit=unit).texts[0].get_text() == f"thing\n{text}"


def test_the_legend_tells_axis_and_level():
    assert one(axis="width").get_legend().get_title().get_text() == "width (90\u00a0% interval)"
    assert one(level=0.995).get_legend().get_title().get_text() == "height (99.5\u00a0% interval)"
    assert one(size=NAN, std=NAN).get_legend().get_title().get_text() == ""


def test_sizes_along_several_axes_say_which():
    detections = [ims.Detection("a", (10, 10, 90, 90)), ims.Detection("b", (200, 10, 290, 90))]
    estimates = [estimate("a", axis="width"), estimate("b", axis="diameter")]
    ax = draw_sizes(np.zeros((400, 600)), detections, estimates)
    assert [text.get_text() for text in ax.texts] == [
        "a\n1.50 m wide (1.40 to 1.60)", "b\n1.50 m across (1.40 to 1.60)",
    ]  # fmt: skip
    assert ax.get_legend().get_title().get_text() == "size (90\u00a0% interval)"


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"std": 0.0}, "1.5 m"),
        ({"std": NAN}, "1.5 m"),
        ({"std": float("inf")}, "1.5 m (above 0)"),
        ({"size": NAN, "std": NAN, "flags": Flag.NO_DEPTH, "depth": NAN}, "no depth"),
        ({"size": NAN, "std": NAN, "flags": Flag.BEYOND_HORIZON}, "at the horizon"),
        ({"size": NAN, "std": NAN}, "unknown"),
        ({"flags": Flag.PARTIAL}, "1.50 m (1.40 to 1.60)\npartly visible"),
        ({"flags": Flag.MIXED_DEPTH}, "1.50 m (1.40 to 1.60)\ntwo surfaces in the box"),
        ({"flags": Flag.EXTRAPOLATED}, "1.50 m (1.40 to 1.60)\nfar from the references"),
        ({"flags": Flag.MEAN_DEPTH}, "1.50 m (1.40 to 1.60)\nmean distance"),
        ({"flags": Flag.PRIOR_USED}, "1.50 m (1.40 to 1.60)\nwith its usual size"),
        ({"flags": Flag.OUTLIERS}, "1.50 m (1.40 to 1.60)\nnot used: outlier"),
    ],
)
def test_what_is_odd_about_a_size_is_said_in_words(fields, text):
    assert one(**fields).texts[0].get_text() == f"thing\n{text}"


@pytest.mark.parametrize("flag", [Flag.PARTIAL, Flag.MIXED_DEPTH, Flag.EXTRAPOLATED,
                                  Flag.MEAN_DEPTH, Flag.PRIOR_USED])  # fmt: skip
def test_flags_have_the_words_of_the_tables(flag):
    assert one(flags=flag).texts[0].get_text().split("\n")[2:] == flag_words(flag)


def test_a_low_end_keeps_one_digit_that_is_not_zero():
    text = one(size=0.5, std=1.0).texts[0].get_text()
    # 0.5 m over and times exp(1.6449 * 2) = 26.8
    assert text == "thing\n0.5 m (0.02 to 13.4)"


def test_an_interval_without_an_upper_end_says_so():
    quantiles = (0.5, *np.linspace(0.5, 3, 27).tolist(), float("inf"))
    text = one(quantiles_m=quantiles, flags=Flag.BEYOND_HORIZON, level=0.9995).texts[0].get_text()
    assert text == "thing\n1.50 m (above 0.50)\nat the horizon"


def known_and_rejected():
    boxes = [(100, 100, 140, 300), (200, 100, 240, 302), (300, 100, 340, 299), (400, 50, 440, 400),
             (0, 100, 20, 300), (500, 100, 540, 300), (560, 200, 600, 300)]  # fmt: skip
    labels = ["pole"] * 6 + ["thing"]
    detections = [ims.Detection(*pair) for pair in zip(labels, boxes, strict=True)]
    depth = ims.ObjectDepths(
        [4.0] * 5 + [NAN, 4.0], kind="relative", rel_std=0.01, image_size=(640, 480)
    )
    table = ims.PriorTable([ims.ObjectPrior("pole", 2.0, 0.02)])
    model = ims.fit(detections, depth, table)
    return detections, ims.predict(model, detections, depth), model


def test_rejected_references_say_why_in_the_words_of_the_model():
    detections, sizes, model = known_and_rejected()
    ax = draw_sizes(np.zeros((480, 640)), detections, sizes, model=model)
    texts = [text.get_text() for text in ax.texts]
    listed = re.findall(r"(pole \d) \(([a-z ]+)\)", str(model))
    assert listed == [("pole 4", "outlier"), ("pole 5", "partial"), ("pole 6", "no depth")]
    for name, reason in listed:
        (text,) = [text for text in texts if text.startswith(f"{name}\n")]
        assert text.endswith(f"not used: {reason}" if reason != "no depth" else "\nno depth")
    assert not any("not used" in text for text in [*texts[:3], texts[6]])
    styles = [box.get_linestyle() for box in ax.patches]
    assert len(set(styles[3:6])) == 1
    assert len({styles[0], styles[3], styles[6]}) == 3


def test_without_the_model_only_outliers_are_told():
    detections, sizes, _ = known_and_rejected()
    texts = [text.get_text() for text in draw_sizes(np.zeros((480, 640)), detections, sizes).texts]
    assert [text.startswith("pole 4") for text in texts if "not used" in text] == [True]


def test_some_of_the_objects_keep_the_numbers_of_the_model():
    detections, sizes, model = known_and_rejected()
    ax = draw_sizes(np.zeros((480, 640)), detections[3:5], sizes[3:5], model=model)
    assert [text.get_text().split("\n")[0] for text in ax.texts] == ["pole 4", "pole 5"]


@pytest.mark.parametrize(
    ("label", "name"),
    [
        ("a\nb\tc", "a b c"),
        ("$x^2$ <b> & %", "$x^2$ <b> & %"),
        ("word " * 40, "word word word word word word\nword word word word … word"),
        ("x" * 200, f"{'x' * 30}\n{'x' * 20}…{'x' * 5}"),
    ],
)
def test_odd_labels_are_written_out(label, name):
    ax = one(label)
    assert ax.texts[0].get_text().rpartition("\n")[0] == name
    rendered(ax)


def test_letters_that_no_font_holds_are_spelt(monkeypatch):
    monkeypatch.setattr(font_manager.fontManager, "ttflist", [])
    ax = one("人\x00é")
    assert ax.texts[0].get_text().startswith("\\u4eba\\x00é\n")
    rendered(ax)  # a missing glyph would be a warning, an error here


def test_letters_that_another_font_holds_are_written_in_that():
    # of matplotlib's own fonts, STIX holds the watch and DejaVu Sans does not
    ax = one("\u231a")
    rendered(ax)
    assert ax.texts[0].get_text().startswith("\u231a\n")


# --- the look ------------------------------------------------------------------------------------


def test_standings_differ_in_colour_and_line_and_the_legend_lists_those_that_occur():
    ax = draw_sizes(*results(640, 480))
    pole, thing, far = ax.patches
    assert len({box.get_linestyle() for box in (pole, thing, far)}) == 3
    assert pole.get_edgecolor() != thing.get_edgecolor()
    assert [line.get_text() for line in ax.get_legend().get_texts()] == [
        "known size (reference)", "measured", "no size",
    ]  # fmt: skip


# Machado, Oliveira and Fernandes, "A Physiologically-based Model for Simulation of Color Vision
# Deficiency", IEEE TVCG 15(6), 2009, severity 1; they act on linear RGB.
MACHADO = {
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
                   [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                     [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
                   [0.004733, 0.691367, 0.303900]],
    "normal": np.eye(3).tolist(),
}  # fmt: skip


def linear(rgb):
    rgb = np.asarray(rgb, dtype=float)
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def seen(rgb, vision):
    light = np.clip(np.asarray(MACHADO[vision]) @ linear(rgb), 0, 1)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def contrast(one, two):
    """Contrast ratio of two sRGB colours (WCAG 2.2, relative luminance)."""
    bright, dark = sorted((linear(c) @ [0.2126, 0.7152, 0.0722] for c in (one, two)), reverse=True)
    return (bright + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("vision", MACHADO)
def test_colours_of_the_standings_are_far_apart_for_every_kind_of_sight(vision):
    detections, sizes, model = known_and_rejected()
    ax = draw_sizes(np.zeros((480, 640)), detections, sizes, model=model)
    colours = {to_rgb(box.get_edgecolor()) for box in ax.patches}
    assert len(colours) == 3
    labs = [ski.color.rgb2lab(seen(colour, vision)) for colour in colours]
    # 2.3 is just noticeable; these are ten times that
    assert min(ski.color.deltaE_ciede2000(a, b) for a, b in combinations(labs, 2)) > 23


@pytest.mark.parametrize("grey", [0, 90, 128, 200, 255])
def test_letters_keep_contrast_on_light_and_dark_photos(grey):
    image = np.full((480, 640, 3), grey, dtype=np.uint8)
    ax = draw_sizes(image, [ims.Detection("WWW", (100, 100, 200, 200))], [estimate("WWW")])
    pixels = rendered(ax)
    extent = ax.texts[0].get_window_extent()
    rows = slice(pixels.shape[0] - int(extent.y1), pixels.shape[0] - int(extent.y0))
    part = pixels[rows, int(extent.x0) : int(extent.x1)].reshape(-1, 3) / 255
    paper = np.median(part, axis=0)
    assert contrast(part.max(axis=0), paper) >= 4.5


@pytest.mark.parametrize("grey", [0, 128, 255])
@pytest.mark.parametrize("flags", [Flag.REFERENCE, Flag(0), Flag.OUTLIERS])
def test_boxes_stand_out_from_light_and_dark_photos(grey, flags):
    image = np.full((480, 640, 3), grey, dtype=np.uint8)
    ax = draw_sizes(image, [ims.Detection("a", (300, 200, 400, 300))], [estimate("a", flags=flags)])
    for text in ax.texts:
        text.set_visible(False)
    pixels = rendered(ax)
    (x, y), _ = ax.transData.transform([(300, 250), (0, 0)]).round().astype(int)
    across = pixels[pixels.shape[0] - y, x - 6 : x + 7] / 255
    assert max(contrast(pixel, [grey / 255] * 3) for pixel in across) >= 3  # WCAG for graphics


def test_lettering_and_lines_keep_their_share_of_small_and_large_photos():
    shares = []
    for size in [(300, 200), (3840, 2560)]:
        ax = draw_sizes(*results(*size))
        frame = ax.get_window_extent()
        shares.append(
            (
                ax.texts[0].get_window_extent().height / frame.height,
                ax.patches[0].get_linewidth() * ax.figure.dpi / frame.height,
            )
        )
    assert shares[0] == pytest.approx(shares[1], rel=0.05)


# --- the places ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("count", "size", "spread"),
    [
        (1, (300, 300), 1.0), (12, (1242, 375), 1.0), (30, (300, 200), 1.0), (25, (400, 1600), 1.0),
        (60, (1600, 1200), 1.0), (40, (640, 480), 0.3),
    ],
    ids=str,
)  # fmt: skip
def test_labels_do_not_overlap_nor_leave_the_picture(count, size, spread):
    ax = draw_sizes(*crowd(count, size, count, spread=spread))
    rendered(ax)
    found = check_layout(ax)
    assert len(found) >= count  # and a legend where there is room
    words = [text.get_text() for text in ax.texts]
    assert sum("(" in word for word in words) >= 0.8 * count  # in full


@pytest.mark.parametrize("inches", [(8, 5), (3, 2), (1.2, 4), (0.2, 0.2)], ids=str)
def test_axes_of_any_size_have_room_for_what_fits(inches):
    figure = Figure(figsize=inches)
    before = tuple(figure.get_size_inches()), figure.dpi
    ax = figure.add_subplot()
    assert draw_sizes(*crowd(20, (600, 400), 3), ax=ax) is ax
    rendered(ax)
    check_layout(ax)
    assert (tuple(figure.get_size_inches()), figure.dpi) == before
    assert len(ax.patches) == 20


def test_labels_without_room_for_words_are_places_in_the_list():
    ax = Figure(figsize=(2, 1.5)).add_axes((0, 0, 1, 1))
    draw_sizes(*crowd(20, (600, 400), 3), ax=ax)
    numbers = [(i, t.get_text()) for i, t in enumerate(ax.texts, 1) if t.get_text()[0] == "#"]
    assert len(numbers) > 3
    assert all(text == f"#{number}" for number, text in numbers)


def test_labels_are_arranged_anew_in_another_size_and_resolution():
    figure = Figure(figsize=(9, 5), layout="constrained")
    left, right = figure.subplots(1, 2)
    for ax in (left, right):
        draw_sizes(*crowd(15, (800, 600), 5), ax=ax)
    for inches in [(9, 5), (4, 3), (14, 8)]:
        figure.set_size_inches(*inches)
        for dpi in (60, 200):
            rendered(left, dpi=dpi)
            figure.draw_without_rendering()
            check_layout(left)
            check_layout(right)


def test_the_same_input_gives_the_same_picture():
    first, second = (rendered(draw_sizes(*crowd(25, (500, 400), 7))) for _ in range(2))
    assert (first == second).all()


def test_labels_far_from_their_boxes_have_a_line_to_them():
    image, detections, estimates = crowd(30, (600, 400), 1, spread=0.1)
    ax = draw_sizes(image, detections, estimates)
    rendered(ax)
    frame = ax.get_window_extent()
    pairs = zip(ax.texts, ax.patches, ax.lines, strict=True)
    for text, box, line in pairs:
        plate = text.get_bbox_patch().get_window_extent().padded(1)
        corners = ax.transData.transform(box.get_bbox())
        outline = Bbox([corners.min(axis=0), corners.max(axis=0)]).padded(1)
        if not line.get_visible():
            gap = 8 * ax.figure.dpi / 72
            assert plate.padded(gap).overlaps(outline)
            continue
        ends = frame.p0 + np.array(line.get_data()).T * frame.size
        assert plate.contains(*ends[0])
        assert outline.contains(*ends[1])
    assert any(line.get_visible() for line in ax.lines)


def test_the_legend_goes_where_no_object_is():
    image = np.zeros((480, 640, 3), dtype=np.uint8)
    detections = [ims.Detection("a", (0, 200, 300, 480)), ims.Detection("b", (0, 0, 300, 180))]
    ax = draw_sizes(image, detections, [estimate("a"), estimate("b")])
    rendered(ax)
    legend = ax.get_legend().get_window_extent()
    boxes = [box.get_window_extent() for box in ax.patches]
    assert not any(legend.overlaps(box) for box in boxes)


rectangles = st.tuples(st.floats(0, 390), st.floats(0, 290), st.floats(1e-3, 400)).map(
    lambda t: (t[0], t[1], min(t[0] + t[2], 400.0), min(t[1] + t[2] / 2, 300.0))
)


@settings(max_examples=60, deadline=None)
@given(st.lists(rectangles, max_size=12), st.floats(5, 250), st.floats(5, 80))
def test_places_never_overlap_nor_leave_the_picture(boxes, width, height):
    array = np.array(boxes, dtype=float).reshape(-1, 4)
    wordings = np.array([[(width, height), (width / 2, height / 2), (5, 5)]] * len(boxes))
    panel = place_panel((400, 300), (80, 50), array)
    places = place_labels((400, 300), array, wordings.reshape(-1, 3, 2), [panel])
    assert places == place_labels((400, 300), array, wordings.reshape(-1, 3, 2), [panel])
    rects = [place.rect for place in places if place.wording >= 0] + [panel]
    assert len(rects) == len(boxes) + 1  # 12 labels of 5 x 5 always find room
    for x0, y0, x1, y1 in rects:
        assert -1e-9 <= x0 < x1 <= 400 + 1e-9
        assert -1e-9 <= y0 < y1 <= 300 + 1e-9
    for a, b in combinations(rects, 2):
        assert a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1]


def test_a_panel_larger_than_the_picture_has_no_place():
    assert place_panel((100, 100), (95, 20), np.empty((0, 4))) is None


# --- the photo -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "image",
    [
        pytest.param(np.full((40, 60), 255, dtype=np.uint8), id="grey bytes"),
        pytest.param(np.ones((40, 60)), id="grey floats"),
        pytest.param(np.ones((40, 60, 3), dtype=np.float32), id="RGB floats"),
        pytest.param(np.full((40, 60, 3), 255, dtype=np.uint8), id="RGB bytes"),
        pytest.param(np.full((40, 60, 4), 255, dtype=np.uint8), id="RGBA bytes"),
        pytest.param(np.ones((40, 60, 4)), id="RGBA floats"),
    ],
)
def test_photos_of_every_usual_form_are_shown_as_they_are(image):
    assert rendered(draw_sizes(image, [], [])).min() == 255


def test_a_dark_grey_photo_stays_dark():
    pixels = rendered(draw_sizes(np.full((40, 60), 30, dtype=np.uint8), [], []))
    assert set(np.unique(pixels)) == {30}


@pytest.mark.parametrize(
    ("image", "error", "message"),
    [
        (np.full((4, 6), 2.0), ValueError, "got values from 2 to 2"),
        (np.full((4, 6), NAN), ValueError, "got values from nan to nan"),
        (np.full((4, 6), -0.1), ValueError, "from -0.1 to -0.1"),
        (np.zeros((4, 6), dtype=np.uint16), ValueError, r"\(4, 6\) uint16"),
        (np.zeros((4, 6), dtype=bool), ValueError, "bool"),
        (np.zeros((4, 6, 2), dtype=np.uint8), ValueError, r"got shape \(4, 6, 2\)"),
        (np.zeros((0, 6, 3), dtype=np.uint8), ValueError, r"got shape \(0, 6, 3\)"),
        (np.zeros(6, dtype=np.uint8), ValueError, r"got shape \(6,\)"),
        ([[0, 0]], TypeError, "a path, an array or a PIL image; got list"),
    ],
)
def test_what_is_no_photo_is_refused(image, error, message):
    with pytest.raises(error, match=f"^`image` must be .*{message}"):
        draw_sizes(image, [], [])


def turned_file(folder):
    """A file of 40 x 20 pixels that is to be seen upright: white above, black below."""
    lying = np.zeros((20, 40, 3), dtype=np.uint8)
    lying[:, :20] = 255
    exif = Image.Exif()
    exif[0x0112] = 6  # turn it clockwise
    Image.fromarray(lying).save(folder / "a.png", exif=exif)
    return folder / "a.png"


@pytest.mark.parametrize("form", [str, Path, Image.open])
def test_files_and_pil_images_are_turned_upright(tmp_path, form):
    ax = draw_sizes(form(turned_file(tmp_path)), [], [])
    shown = np.asarray(ax.images[0].get_array())
    assert shown.shape == (40, 20, 3)
    assert shown[:20].min() == 255
    assert shown[20:].max() == 0


def test_a_missing_file_is_named():
    with pytest.raises(FileNotFoundError, match=r"no_such\.png"):
        draw_sizes("no_such.png", [], [])


def test_a_photo_of_another_size_than_the_models_is_refused():
    detections, sizes, model = known_and_rejected()
    with pytest.raises(ValueError, match="size of the fitted image, 640 x 480; got 1280 x 960"):
        draw_sizes(np.zeros((960, 1280)), detections, sizes, model=model)


def test_estimates_of_other_detections_are_refused():
    image, detections, estimates = results(640, 480)
    with pytest.raises(ValueError, match="one per detection, 3; got 2"):
        draw_sizes(image, detections, estimates[:2])
    with pytest.raises(ValueError, match="got 'far' at index 0, where the detection is 'pole'"):
        draw_sizes(image, detections, estimates[::-1])


def test_boxes_of_another_photo_are_refused():
    image, detections, estimates = results(640, 480)
    with pytest.raises(ValueError, match=r"in the image, 320 x 240 px; got \(64.0, .* index 0"):
        draw_sizes(image[:240, :320], detections, estimates)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"unit": "km"}, ValueError, '`unit` must be one of "m", "cm".*got \'km\''),
        ({"level": 1.0}, ValueError, "`level` must be above 0 and below 1; got 1.0"),
        ({"model": "model"}, TypeError, "`model` must be a ScaleModel; got str"),
        ({"ax": [1, 2]}, TypeError, "`ax` must be a Axes; got list. Of `subplots`, pass one"),
    ],
)
def test_options_against_their_law_are_refused(options, error, message):
    with pytest.raises(error, match=message):
        draw_sizes(*results(64, 48), **options)


def test_things_that_are_no_estimates_are_refused():
    image, detections, _ = results(64, 48)
    with pytest.raises(TypeError, match="`estimates` must be a SizeEstimate; got float"):
        draw_sizes(image, detections, [1.0, 2.0, 3.0])
    with pytest.raises(TypeError, match="`estimates` must be a sequence"):
        draw_sizes(image, detections, 3)


def test_the_motorcycle_carries_its_sizes():
    scene = motorcycle.load()
    model = ims.fit(scene.detections, scene.depth, scene.priors, noise=scene.noise)
    sizes = ims.predict(model, scene.detections, scene.depth)
    ax = draw_sizes(scene.image, scene.detections, sizes, model=model)
    rendered(ax)
    check_layout(ax)
    for text, size in zip(ax.texts, sizes, strict=True):
        assert text.get_text().startswith(f"{size.label}\n{size.size_m:.3f} m (")
