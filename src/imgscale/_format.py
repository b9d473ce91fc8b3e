"""Numbers and tables as people read them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

# Units of lengths at the edge; inside, all are metres.
PER_METRE: Mapping[str, float] = MappingProxyType(
    {"m": 1.0, "cm": 100.0, "mm": 1000.0, "in": 1 / 0.0254, "ft": 1 / 0.3048}
)


def digits_for(std: float) -> int:
    """
    Count the decimals that a standard error justifies.

    The rule of the Particle Data Group: keep two digits of the error where its three leading
    digits are at most 354 or at least 950, one digit in between.

    Parameters
    ----------
    std : float
        The standard error, positive and finite.

    Returns
    -------
    int
        Number of decimals, at least 0.
    """
    exponent = math.floor(math.log10(std))
    leading = round(std / 10.0 ** (exponent - 2))
    if leading >= 950:
        exponent += 1
    two_digits = leading <= 354 or leading >= 950
    return max(0, -exponent + (1 if two_digits else 0))


def with_error(value: float, std: float) -> str:
    """
    Write a value with its standard error, both to the digits that the error justifies.

    Parameters
    ----------
    value : float
        The value.
    std : float
        Its standard error; NaN, inf and 0 give the value alone.

    Returns
    -------
    str
        For example "0.281 +- 0.008".
    """
    if not (math.isfinite(value) and math.isfinite(std) and std > 0):
        return f"{value:.4g}"
    decimals = digits_for(std)
    return f"{value:.{decimals}f} +- {std:.{decimals}f}"


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """
    Lay out rows under a header, the first column to the left and the others to the right.

    Parameters
    ----------
    header : sequence of str
        The column titles.
    rows : sequence of sequence of str
        The cells, one sequence per row, each as long as `header`.

    Returns
    -------
    str
        Lines without trailing blanks.
    """
    widths = [max(len(row[i]) for row in (header, *rows)) for i in range(len(header))]
    lines = [
        "  ".join(
            cell.ljust(width) if i == 0 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in (header, tuple("-" * width for width in widths), *rows)
    ]
    return "\n".join(lines)
