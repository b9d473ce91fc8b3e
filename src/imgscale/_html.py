"""HTML in which every text is escaped unless it was built here."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable, Sequence
from typing import NamedTuple

# Elements without content, hence without an end tag.
_VOID = {"img", "meta"}
# A label that turns the direction of what follows could make a number read otherwise.
_TURNS = {"LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI"}

# Colours and fonts are left to the page around. A long name is broken, a word is not.
_NUMBER = "text-align:right;white-space:nowrap"
_NAME = "text-align:left;min-width:7em;overflow-wrap:anywhere"
_TEXT = "text-align:left;min-width:7em"


class Markup(str):
    """Text that is HTML already: made by `element`, or written in the source."""

    __slots__ = ()


class Column(NamedTuple):
    """
    One column of a table.

    Attributes
    ----------
    title : str
        Its heading.
    numeric : bool
        True where its cells are numbers, which stand to the right and are not broken.
    """

    title: str
    numeric: bool = False


def escaped(text: str) -> Markup:
    """
    Turn any text into HTML that shows it.

    Parameters
    ----------
    text : str
        The text; `Markup` is returned as it is.

    Returns
    -------
    Markup
        The `plain` text with ``& < > " '`` escaped.
    """
    import html  # noqa: PLC0415 - 3 ms of import that few need

    return text if isinstance(text, Markup) else Markup(html.escape(plain(text)))


def plain(text: str) -> str:
    r"""
    Make every character of a text visible.

    Parameters
    ----------
    text : str
        The text, as some file has it.

    Returns
    -------
    str
        The text with spaces for line breaks and tabs. Other control characters, lone surrogates
        and those that turn the direction of writing are shown as Python writes them, ``\x1b``.
    """
    return "".join(char if char.isprintable() else _shown(char) for char in text)


def _shown(char: str) -> str:
    """Give a character that does not print; joiners and the like belong to the word they are in."""
    if char in "\t\n\r\v\f":
        return " "
    unseen = unicodedata.category(char) in {"Cc", "Cs"}
    if unseen or unicodedata.bidirectional(char) in _TURNS:
        return repr(char)[1:-1]
    return char


def element(tag: str, *children: str, **attributes: str) -> Markup:
    """
    Build one element.

    Parameters
    ----------
    tag : str
        Its name.
    *children : str
        Its content; what is not `Markup` is escaped.
    **attributes : str
        Its attributes, escaped. Underscores in their names stand for hyphens, but for a last one,
        which keeps ``class_`` from being a keyword.

    Returns
    -------
    Markup
        The element.

    Examples
    --------
    >>> from imgscale._html import element
    >>> element("p", "1 < 2 ", element("b", "so"), class_="note")
    '<p class="note">1 &lt; 2 <b>so</b></p>'
    """
    words = "".join(
        f' {name.removesuffix("_").replace("_", "-")}="{escaped(value)}"'
        for name, value in attributes.items()
    )
    if tag in _VOID:
        return Markup(f"<{tag}{words}>")
    return Markup(f"<{tag}{words}>{joined(children)}</{tag}>")


def joined(parts: Iterable[str], separator: str = "") -> Markup:
    """Put parts one after the other; what is not `Markup` is escaped."""
    return Markup(escaped(separator).join(escaped(part) for part in parts))


def name_of(text: str) -> Markup:
    """Isolate a name that comes from a file, so that one from right to left turns nothing else."""
    return element("bdi", text)


def table(
    columns: Sequence[Column], rows: Sequence[Sequence[str]], *, most: int | None = None
) -> Markup:
    """
    Build a table that scrolls in a box of its own where it is too wide.

    Parameters
    ----------
    columns : sequence of Column
        The columns; the first one heads its row.
    rows : sequence of sequence of str
        The cells, one sequence per row, each as long as `columns`.
    most : int, optional
        Rows to be shown; a line under the table tells how many more there are.

    Returns
    -------
    Markup
        The table. Columns without any text are left out.
    """
    kept = [i for i in range(len(columns)) if i == 0 or any(row[i] for row in rows)]
    columns = [columns[i] for i in kept]
    head = [
        _cell("th", column, column.title, scope="col", role="columnheader") for column in columns
    ]
    body = [_row(columns, [row[i] for i in kept]) for row in rows[:most]]
    hidden = len(rows) - len(body)
    # Where a style lays the rows out as cards, only the roles keep them a table for readers.
    built = element(
        "table",
        element("thead", element("tr", *head, role="row"), role="rowgroup"),
        element("tbody", *body, role="rowgroup"),
        role="table",
        style="border-collapse:collapse",
    )
    more = [element("p", f"and {hidden} more")] if hidden else []
    return element("div", built, *more, style="overflow-x:auto;max-width:100%")


def _row(columns: Sequence[Column], cells: Sequence[str]) -> Markup:
    first, *others = zip(columns, cells, strict=True)
    return element(
        "tr",
        _cell("th", *first, scope="row", role="rowheader", style=_NAME),
        *(_cell("td", *pair, role="cell", data_title=pair[0].title) for pair in others),
        role="row",
    )


def _cell(tag: str, column: Column, content: str, **attributes: str) -> Markup:
    style = {"style": _NUMBER if column.numeric else _TEXT}
    return element(tag, content, **(style | attributes))
