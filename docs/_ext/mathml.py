"""Formulas as MathML, which browsers show by themselves: no script, no font, no request."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging

_LOGGER = logging.getLogger(__name__)
# The converter sets "log k" as one word, and the index of an accented letter right below it.
_REPAIRS = (
    (
        re.compile(r"<mo>&ApplyFunction;</mo>(?!\s*(?:<mrow>\s*)?<mo[^>]*>\()"),
        '<mspace width="0.167em"/>',
    ),
    (
        re.compile(
            r"<munderover>\s*(<mi>\w</mi>)\s*(<mi>\w</mi>)\s*(<mo[^>]*>[ˉˆ]</mo>)\s*</munderover>"
        ),
        r'<msub><mover accent="true">\1\3</mover>\2</msub>',
    ),
)


def _markup(node: nodes.math | nodes.math_block) -> str:
    """Turn the LaTeX of a node into MathML; what cannot be turned is a warning."""
    latex = node.astext().strip()
    try:
        mathml = tex2mathml(latex, as_block=isinstance(node, nodes.math_block))
    except MathError as error:
        _LOGGER.warning("formula %r: %s", latex, error, location=node)
        return ""
    for wrong, right in _REPAIRS:
        mathml = wrong.sub(right, mathml)
    return mathml


def _visit_inline(translator: Any, node: nodes.math) -> None:
    translator.body.append(_markup(node))
    raise nodes.SkipNode


def _visit_block(translator: Any, node: nodes.math_block) -> None:
    translator.body.append(f'<div class="formula">{_markup(node)}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer "mathml"."""
    app.add_html_math_renderer("mathml", (_visit_inline, None), (_visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
