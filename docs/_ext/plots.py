"""Fences of ``plot`` in Markdown: matplotlib's directive, which by itself knows reST alone."""

from __future__ import annotations

import itertools
import re
from textwrap import indent
from typing import Any

from sphinx.application import Sphinx

_FENCE = re.compile(r"^```\{plot\}\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def _rewrite(_app: Sphinx, page: str, source: list[str]) -> None:
    """Write the fences of one page as reST, each with a name of its own for its picture."""
    numbers = itertools.count(1)

    def as_rst(fence: re.Match[str]) -> str:
        lines = indent(f":filename-prefix: {page}-{next(numbers)}\n{fence[1]}", "   ")
        return f"```{{eval-rst}}\n.. plot::\n{lines}```"

    source[0] = _FENCE.sub(as_rst, source[0])


def setup(app: Sphinx) -> dict[str, Any]:
    """Load matplotlib's directive, and read pages for it."""
    app.setup_extension("matplotlib.sphinxext.plot_directive")
    app.connect("source-read", _rewrite)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
