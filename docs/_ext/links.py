"""
Names in prose link to their page of the reference.

A literal that is a public name (``fit``, ``ims.Camera``, ``DepthMap.from_disparity(...)``) or a
flag becomes a link, in pages and docstrings alike, and so do the types that docstrings name. A name
that two modules share is linked where it is written with its module.
"""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from sphinx.addnodes import desc_signature
from sphinx.application import Sphinx
from sphinx.util.nodes import make_refnode

from imgscale import Flag

_CALL = re.compile(r"\(.*\)$", re.DOTALL)
_WORD = re.compile(r"[A-Za-z_]\w*")
_NO_LINKS = (nodes.reference, nodes.title, nodes.rubric, desc_signature)
Targets = dict[str, tuple[str, str]]


def _targets(app: Sphinx) -> Targets:
    """Page and anchor of every name, by all the ways to write it that are unambiguous."""
    found: dict[str, set[tuple[str, str]]] = {}
    for full, entry in app.env.domains.python_domain.objects.items():
        parts = full.split(".")
        for start in range(len(parts)):
            found.setdefault(".".join(parts[start:]), set()).add((entry.docname, entry.node_id))
    members = _member_names(app)
    names = {
        name: next(iter(places))
        for name, places in found.items()
        if len(places) == 1 and name not in members
    }
    names |= dict.fromkeys(Flag.__members__, names["Flag"])
    return names | {f"ims.{name}": place for name, place in names.items() if "." not in name}


def _member_names(app: Sphinx) -> set[str]:
    """Names of methods and attributes: by themselves they are words of many meanings."""
    objects = app.env.domains.python_domain.objects
    return {
        full.rpartition(".")[2]
        for full, entry in objects.items()
        if entry.objtype in {"method", "attribute", "property"}
    }


def _is_linked(node: nodes.Node) -> bool:
    """Tell whether a node is inside something that is a link already or should be none."""
    parent = node.parent
    while parent is not None:
        if isinstance(parent, _NO_LINKS):
            return True
        parent = parent.parent
    return False


def _link(app: Sphinx, page: str, place: tuple[str, str], shown: nodes.Node) -> nodes.reference:
    docname, anchor = place
    return make_refnode(app.builder, page, docname, anchor, shown)


def _link_names(app: Sphinx, doctree: nodes.document, page: str) -> None:
    """Link the literals of one page."""
    targets = _targets(app)
    for node in list(doctree.findall(nodes.literal)):
        place = targets.get(_CALL.sub("", node.astext()))
        if place and place[0] != page and not _is_linked(node):
            node.replace_self(_link(app, page, place, node.deepcopy()))
    for kind in (nodes.classifier, nodes.term):  # the type of an argument, and of a result
        for node in list(doctree.findall(kind)):
            _link_types(app, page, node, targets)


def _link_types(app: Sphinx, page: str, typed: nodes.Element, targets: Targets) -> None:
    """Link the capitalised names in a type."""
    for text in list(typed.findall(nodes.Text)):
        if _is_linked(text) or isinstance(text.parent, nodes.strong | nodes.literal):
            continue
        parts: list[nodes.Node] = []
        end = 0
        for word in _WORD.finditer(text):
            place = targets.get(word.group()) if word.group()[0].isupper() else None
            if place and place[0] != page:
                parts.append(nodes.Text(text[end : word.start()]))
                parts.append(_link(app, page, place, nodes.Text(word.group())))
                end = word.end()
        if parts:
            text.parent.replace(text, [*parts, nodes.Text(text[end:])])


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect to resolved pages."""
    app.connect("doctree-resolved", _link_names)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
