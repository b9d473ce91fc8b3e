"""
Detections from Pascal VOC's XML: the annotations of one picture.

The format counts pixels from 1 and includes the last: `xmin` 1 is the first column, `xmax` the
width the last. Half-open that is ``(xmin - 1, ymin - 1, xmax, ymax)``. See
http://host.robots.ox.ac.uk/pascal/VOC/voc2012/devkit_doc.pdf.
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from xml.etree import ElementTree as ET

from imgscale._checks import within
from imgscale._typing import Box, ImageSize
from imgscale.detection import Detection
from imgscale.detectors._convert import make_detection
from imgscale.detectors._files import finite_word, told_size

__all__ = ["from_pascal_voc", "read_pascal_voc"]


def read_pascal_voc(path: str | PathLike[str], *, one_based: bool = True) -> list[Detection]:
    """
    Read a Pascal VOC annotation file.

    Parameters
    ----------
    path : str or path-like
        The XML file.
    one_based : bool
        As for `from_pascal_voc`.

    Returns
    -------
    list of Detection
        As `from_pascal_voc` gives it.

    Raises
    ------
    ValueError, TypeError
        As `from_pascal_voc` does; the message names the file.
    OSError
        If the file cannot be opened.
    """
    with within(path):
        return from_pascal_voc(Path(path).read_bytes(), one_based=one_based)


def from_pascal_voc(xml: str | bytes, *, one_based: bool = True) -> list[Detection]:
    """
    Convert a Pascal VOC annotation.

    Parameters
    ----------
    xml : str or bytes
        The annotation's XML; bytes in the encoding that they declare.
    one_based : bool
        True for pixels counted from 1, as the format does. False for tools that write the outline
        itself, from 0 to the picture's width and height.

    Returns
    -------
    list of Detection
        One per `object`, in order, without its `part` objects. `truncated` or `occluded` ones are
        partial. `difficult` says how hard it is to tell what the object is and nothing of its
        outline: it changes nothing. Boxes are cut at the picture's border where `size` tells it.

    Raises
    ------
    ValueError
        If the XML is broken, has a document type (which can hold entities that expand without
        bound), is no annotation, lacks an element, or a box is inverted, wholly outside the
        picture or starts before pixel 1. The message names the object.
    TypeError
        If it is neither text nor bytes.

    Examples
    --------
    >>> from imgscale.detectors.pascal_voc import from_pascal_voc
    >>> [dog] = from_pascal_voc(
    ...     "<annotation><object><name>dog</name><truncated>1</truncated><bndbox><xmin>1</xmin>"
    ...     "<ymin>11</ymin><xmax>40</xmax><ymax>50</ymax></bndbox></object></annotation>"
    ... )
    >>> dog.xyxy, dog.partial
    ((0.0, 10.0, 40.0, 50.0), True)
    """
    annotation = _parse(xml)
    with within("size"):
        size = _image_size(annotation)
    return [
        _detection(f"object[{index}]", entry, size, one_based=one_based)
        for index, entry in enumerate(annotation.findall("object"))
    ]


class _NoDocumentType(ET.TreeBuilder):
    """Builds a tree of elements, and refuses a document type before its entities count."""

    def doctype(self, *_: object) -> None:
        msg = "the XML must have no DOCTYPE; annotations need none. Take it out."
        raise ValueError(msg)


def _parse(xml: object) -> ET.Element:
    if not isinstance(xml, (str, bytes)):
        msg = f"`xml` must be text or bytes; got {type(xml).__name__}."
        raise TypeError(msg)
    parser = ET.XMLParser(target=_NoDocumentType())  # noqa: S314 - entities need a document type
    try:
        parser.feed(xml)
        root: ET.Element = parser.close()
    except (ET.ParseError, LookupError, UnicodeError) as error:  # the last two of encodings
        msg = f"the annotation must be well-formed XML; got: {error}."
        raise ValueError(msg) from error
    if root.tag != "annotation":
        msg = f"the XML must be an <annotation>; got <{root.tag}>."
        raise ValueError(msg)
    return root


def _image_size(annotation: ET.Element) -> ImageSize | None:
    size = annotation.find("size")
    if size is None:
        return None
    return told_size({name: _number(size, name) for name in ("width", "height")})


def _detection(
    place: str, entry: ET.Element, size: ImageSize | None, *, one_based: bool
) -> Detection:
    with within(place):
        label = _text(entry, "name")
        box = _corners(entry, one_based=one_based)
        partial = _is_set(entry, "truncated") or _is_set(entry, "occluded")
    return make_detection(place, label, box, image_size=size, partial=partial)


def _corners(entry: ET.Element, *, one_based: bool) -> Box:
    bounds = entry.find("bndbox")
    if bounds is None:
        msg = "an object must have a <bndbox>; got none."
        raise ValueError(msg)
    x1, y1, x2, y2 = (_number(bounds, name) for name in ("xmin", "ymin", "xmax", "ymax"))
    if not one_based:
        return (x1, y1, x2, y2)
    if min(x1, y1) < 1:
        msg = (
            f"<bndbox> must start at pixel 1 or later; got xmin {x1:g} and ymin {y1:g}. A tool "
            "that counts from 0 wrote it: give one_based=False."
        )
        raise ValueError(msg)
    return (x1 - 1, y1 - 1, x2, y2)


def _is_set(entry: ET.Element, name: str) -> bool:
    return entry.find(name) is not None and _number(entry, name) > 0


def _number(parent: ET.Element, name: str) -> float:
    return finite_word(f"<{name}>", _text(parent, name))


def _text(parent: ET.Element, name: str) -> str:
    child = parent.find(name)
    if child is None:
        listed = ", ".join(f"<{element.tag}>" for element in parent) or "nothing"
        msg = f"<{parent.tag}> must have <{name}>; got {listed}."
        raise ValueError(msg)
    return (child.text or "").strip()
