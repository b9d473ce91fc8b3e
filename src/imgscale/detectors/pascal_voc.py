"""
Detections from Pascal VOC's XML: the annotations of one picture.

The format counts pixels from 1 and includes the last: `xmin` 1 is the first column, `xmax` the
width the last. Half-open that is ``(xmin - 1, ymin - 1, xmax, ymax)``. See
http://host.robots.ox.ac.uk/pascal/VOC/voc2012/devkit_doc.pdf.
"""

from __future__ import annotations

from os import PathLike
from xml.etree import ElementTree as ET

from imgscale._checks import within
from imgscale._reading import MAX_BYTES, in_file, read_bytes
from imgscale._typing import Box, ImageSize
from imgscale.detection import Detection
from imgscale.detectors._convert import make_detection
from imgscale.detectors._xml import image_size, number_in, parse_annotation, text_in

__all__ = ["from_pascal_voc", "read_pascal_voc"]


def read_pascal_voc(
    path: str | PathLike[str], *, one_based: bool = True, max_bytes: int = MAX_BYTES
) -> list[Detection]:
    """
    Read a Pascal VOC annotation file.

    Parameters
    ----------
    path : str or path-like
        The XML file.
    one_based : bool
        As for `from_pascal_voc`.
    max_bytes : int
        Greatest length of the file.

    Returns
    -------
    list of Detection
        As `from_pascal_voc` gives it.

    Raises
    ------
    FileError
        If the file is longer than `max_bytes` or holds what `from_pascal_voc` refuses; the message
        names the file.
    OSError
        If the file cannot be opened.
    """
    with in_file(path):
        return from_pascal_voc(read_bytes(path, max_bytes), one_based=one_based)


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
    annotation = parse_annotation(xml)
    size = image_size(annotation)
    return [
        _detection(f"object[{index}]", entry, size, one_based=one_based)
        for index, entry in enumerate(annotation.findall("object"))
    ]


def _detection(
    place: str, entry: ET.Element, size: ImageSize | None, *, one_based: bool
) -> Detection:
    with within(place):
        label = text_in(entry, "name")
        box = _corners(entry, one_based=one_based)
        partial = _is_set(entry, "truncated") or _is_set(entry, "occluded")
    return make_detection(place, label, box, image_size=size, partial=partial)


def _corners(entry: ET.Element, *, one_based: bool) -> Box:
    bounds = entry.find("bndbox")
    if bounds is None:
        msg = "an object must have a <bndbox>; got none."
        raise ValueError(msg)
    x1, y1, x2, y2 = (number_in(bounds, name) for name in ("xmin", "ymin", "xmax", "ymax"))
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
    return entry.find(name) is not None and number_in(entry, name) > 0
