"""The tree of an annotation in XML, which anyone may have written, and what stands in it."""

from __future__ import annotations

from xml.etree import ElementTree as ET

from imgscale._checks import within
from imgscale._reading import cut
from imgscale._typing import ImageSize
from imgscale.detectors._files import finite_word, told_size


class _NoDocumentType(ET.TreeBuilder):
    """Builds a tree of elements, and refuses a document type before its entities count."""

    def doctype(self, *_: object) -> None:
        msg = "the XML must have no DOCTYPE; annotations need none. Take it out."
        raise ValueError(msg)


def parse_annotation(xml: object) -> ET.Element:
    """
    Parse an annotation.

    Parameters
    ----------
    xml : str or bytes
        The annotation's XML; bytes in the encoding that they declare.

    Returns
    -------
    Element
        Its root.

    Raises
    ------
    ValueError, TypeError
        If it is broken, has a document type or is no annotation.
    """
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
        msg = cut(f"the XML must be an <annotation>; got <{root.tag}>.")
        raise ValueError(msg)
    return root


def image_size(annotation: ET.Element) -> ImageSize | None:
    """
    Tell the size of the picture that an annotation is about.

    Parameters
    ----------
    annotation : Element
        As `parse_annotation` gives it.

    Returns
    -------
    (width, height) or None
        Its size in pixels; None where the annotation does not tell it.

    Raises
    ------
    ValueError
        If a length is no positive integer.
    """
    size = annotation.find("size")
    if size is None:
        return None
    with within("size"):
        return told_size({name: number_in(size, name) for name in ("width", "height")})


def number_in(parent: ET.Element, name: str) -> float:
    """Read the number in a child."""
    return finite_word(f"<{name}>", text_in(parent, name))


def text_in(parent: ET.Element, name: str) -> str:
    """Read the text in a child, which must be there."""
    child = parent.find(name)
    if child is None:
        listed = ", ".join(f"<{element.tag}>" for element in parent) or "nothing"
        msg = cut(f"<{parent.tag}> must have <{name}>; got {listed}.")
        raise ValueError(msg)
    return (child.text or "").strip()
