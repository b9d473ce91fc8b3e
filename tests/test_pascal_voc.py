"""Pascal VOC's annotations: how pixels are counted, what is partial, and what is refused."""

import os
import re
from pathlib import Path

import numpy as np
import pytest

from imgscale.detectors.pascal_voc import from_pascal_voc, read_pascal_voc

DATA = Path(
    os.environ.get("IMGSCALE_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data"
)
FOOD = DATA / "ecustfd" / "Annotations"

needs_food = pytest.mark.skipif(not FOOD.is_dir(), reason=f"no VOC annotations in {FOOD}")

BOX = (48, 240, 195, 371)


def bndbox(xmin, ymin, xmax, ymax):
    # VOC 2012 writes xmax before xmin, others the other way round.
    return (
        f"<bndbox><xmax>{xmax}</xmax><xmin>{xmin}</xmin>"
        f"<ymax>{ymax}</ymax><ymin>{ymin}</ymin></bndbox>"
    )


def thing(inside="", *, box=BOX, name="dog"):
    return f"<object><name>{name}</name>{inside}{bndbox(*box)}</object>"


def annotation(*objects, size="<size><width>353</width><height>500</height></size>"):
    return f"<annotation><filename>a.jpg</filename>{size}{''.join(objects)}</annotation>"


def only(xml, **options):
    (found,) = from_pascal_voc(xml, **options)
    return found


# --- boxes ---


def test_pixels_are_counted_from_1_and_the_last_is_included():
    assert only(annotation(thing())).xyxy == (47, 239, 195, 371)
    assert only(annotation(thing(box=(1, 1, 353, 500)))).xyxy == (0, 0, 353, 500)
    assert only(annotation(thing(box=(7, 9, 7, 9)))).xyxy == (6, 8, 7, 9)


def test_an_outline_from_0_is_taken_as_it_is_on_request():
    assert only(annotation(thing()), one_based=False).xyxy == (48, 240, 195, 371)
    assert only(annotation(thing(box=(0, 0, 353, 500))), one_based=False).xyxy == (0, 0, 353, 500)


def test_a_pixel_before_the_first_says_that_a_tool_counted_from_0():
    with pytest.raises(ValueError, match=r"^object\[1\]: .*xmin 0 and ymin 240.*one_based=False"):
        from_pascal_voc(annotation(thing(), thing(box=(0, 240, 195, 371))))


def test_fractions_of_pixels_are_kept():
    box = ("45.7", "240", "195.25", "371")
    assert only(annotation(thing(box=box))).xyxy == pytest.approx((44.7, 239, 195.25, 371))


def test_objects_come_in_order_and_a_picture_without_any_is_empty():
    found = from_pascal_voc(annotation(thing(name="dog"), thing(name="person")))
    assert [d.label for d in found] == ["dog", "person"]
    assert [d.score for d in found] == [1.0, 1.0]
    assert from_pascal_voc(annotation()) == []


def test_parts_of_an_object_are_no_objects():
    head = f"<part><name>head</name>{bndbox(60, 250, 80, 270)}</part>"
    assert only(annotation(thing(head))).xyxy == (47, 239, 195, 371)


def test_boxes_are_cut_at_the_border_where_the_size_is_known():
    reaching = thing(box=(300, 1, 360, 500))
    assert only(annotation(reaching)).xyxy == (299, 0, 353, 500)
    for unknown in ("", "<size><width>0</width><height>0</height></size>"):
        assert only(annotation(reaching, size=unknown)).xyxy == (299, 0, 360, 500)


@pytest.mark.parametrize(
    ("inside", "partial"),
    [
        ("", False),
        ("<truncated>0</truncated><occluded>0</occluded>", False),
        ("<truncated>1</truncated>", True),
        ("<occluded>1</occluded>", True),
        ("<truncated>0.4</truncated>", True),
        ("<difficult>1</difficult>", False),
    ],
)
def test_what_is_cut_or_hidden_is_partial(inside, partial):
    assert only(annotation(thing(inside))).partial is partial


def test_bytes_are_read_in_the_encoding_that_they_declare():
    xml = '<?xml version="1.0" encoding="ISO-8859-1"?>' + annotation(thing(name="tür"))
    assert only(xml.encode("latin-1")).label == "tür"
    assert only(xml).label == "tür"


@needs_food
def test_every_box_of_real_annotations_is_their_numbers_with_the_first_pixel_taken_in():
    count = 0
    for path in sorted(FOOD.glob("*.xml")):
        text = path.read_text()
        numbers = re.findall(r"<(xmin|ymin|xmax|ymax)>(\d+)<", text)
        written = np.array([int(number) for _, number in numbers], dtype=float).reshape(-1, 4)
        width, height = (int(re.search(rf"<{n}>(\d+)<", text)[1]) for n in ("width", "height"))
        found = np.array([d.xyxy for d in read_pascal_voc(path)])
        inside = np.minimum(written - [1, 1, 0, 0], [width, height, width, height])
        np.testing.assert_array_equal(found, inside)
        count += len(found)
    assert count == 2583


@needs_food
def test_real_annotations_never_start_before_pixel_1():
    texts = [path.read_text() for path in FOOD.glob("*.xml")]
    starts = [int(n) for text in texts for n in re.findall(r"<[xy]min>(\d+)<", text)]
    assert min(starts) >= 1


def test_supervision_takes_the_same_boxes_from_an_annotation():
    tools = pytest.importorskip("supervision.dataset.formats.pascal_voc")
    xml = annotation(thing(), thing(box=(1, 1, 353, 500), name="person"))
    etree = pytest.importorskip("defusedxml.ElementTree")
    theirs, _ = tools.detections_from_xml_obj(etree.fromstring(xml), [], (353, 500))
    np.testing.assert_array_equal(theirs.xyxy, [d.xyxy for d in from_pascal_voc(xml)])


# --- what is refused ---


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        (f"<object>{bndbox(*BOX)}</object>", r"<object> must have <name>; got <bndbox>"),
        (f"<object><name/>{bndbox(*BOX)}</object>", r"`label` must not be blank"),
        ("<object><name>dog</name></object>", r"must have a <bndbox>"),
        (
            "<object><name>dog</name><bndbox><xmin>1</xmin></bndbox></object>",
            r"<bndbox> must have <ymin>; got <xmin>",
        ),
        (thing(box=("left", 1, 2, 3)), r"<xmin> must be a finite number; got 'left'"),
        (thing(box=(1, 1, 2, "nan")), r"<ymax> must be a finite number; got 'nan'"),
        (thing(box=(195, 240, 48, 371)), r"x1 < x2 and y1 < y2"),
        (thing(box=(400, 240, 420, 371)), r"overlap the picture, 353 x 500"),
        (thing("<truncated>Unspecified</truncated>"), r"<truncated> must be a finite number"),
    ],
)
def test_a_broken_object_is_named_by_its_index(broken, message):
    with pytest.raises((TypeError, ValueError), match=r"^object\[1\]: .*" + message):
        from_pascal_voc(annotation(thing(), broken))


@pytest.mark.parametrize(
    ("xml", "message"),
    [
        ("", "well-formed XML"),
        ("<annotation>", "well-formed XML"),
        (b"\xff\xfe\xff", "well-formed XML"),
        (b'<?xml version="1.0" encoding="nope"?><annotation/>', "well-formed XML"),
        ('<annotation a="\ud800"/>', "well-formed XML"),
        ("<annotations/>", "must be an <annotation>; got <annotations>"),
        ("<annotation><size><width>3</width></size></annotation>", "<size> must have <height>"),
        (annotation(size="<size><width>3.5</width><height>3</height></size>"), "whole numbers"),
    ],
)
def test_what_is_no_annotation_is_refused(xml, message):
    with pytest.raises(ValueError, match=message):
        from_pascal_voc(xml)


def test_something_else_than_text_is_refused():
    with pytest.raises(TypeError, match="`xml` must be text or bytes; got list"):
        from_pascal_voc([annotation()])


@pytest.mark.parametrize("encode", [str, str.encode, lambda xml: xml.encode("utf-16")])
def test_entities_that_expand_without_bound_are_refused_before_they_do(encode):
    entities = '<!ENTITY a0 "ha">' + "".join(
        f'<!ENTITY a{n} "{f"&a{n - 1};" * 100}">' for n in range(1, 12)
    )
    bomb = f"<!DOCTYPE annotation [{entities}]>" + annotation(thing(name="&a11;"))
    with pytest.raises(ValueError, match="must have no DOCTYPE"):
        from_pascal_voc(encode(bomb))


def test_errors_of_a_file_name_it(tmp_path):
    path = tmp_path / "a.xml"
    path.write_text(annotation(thing(box=(9, 9, 1, 1))))
    with pytest.raises(ValueError, match=r"a\.xml: object\[0\]: "):
        read_pascal_voc(path)
    path.write_bytes(b"\x00")
    with pytest.raises(ValueError, match=r"a\.xml: .*well-formed XML"):
        read_pascal_voc(path)
