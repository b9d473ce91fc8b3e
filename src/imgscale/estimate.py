"""The size of one object, with its interval."""

from __future__ import annotations

import math
from collections.abc import Sequence

import attrs
import numpy as np

from imgscale._checks import as_float, is_between, nan_as_none, nans_as_none, number_error
from imgscale._format import PER_METRE, digits_for, with_error
from imgscale._html import Column, Markup, name_of, table
from imgscale._typing import FloatArray, SizeAxis
from imgscale.core.mixture import LARGEST_SCORE
from imgscale.flags import Flag, flag_names, flag_words

__all__ = ["SizeEstimate"]

# Beyond it exp() is no number.
_LARGEST_LOG = 700.0


@attrs.frozen(kw_only=True)
class SizeEstimate:
    """
    The size of one object.

    Attributes
    ----------
    label : str
        Its label.
    axis : str
        "height", "width" or "diameter".
    size_m : float
        Median of its size, in metres; NaN where it cannot be said.
    std_m : float
        Standard error in metres: size times half the width of the central 68.3 % of its logarithm
        (for a normal one its standard deviation).
    metres_per_pixel : float
        Scale at its distance, in m/px; NaN without a depth.
    depth : float
        Its depth, in the unit of the depth given; NaN without one.
    distance_m : float or None
        Its z-depth in metres; None where no focal length is known, NaN without a depth.
    flags : Flag
        Reservations.
    quantiles_m : tuple of float or None
        Sizes at the standard scores -3.5, -3.25, ..., 3.5 (the normal quantiles of their
        probabilities), in metres: the shape of the distribution, its tails and its modes. None
        where the logarithm of the size is normal.
    """

    label: str
    axis: SizeAxis
    size_m: float = attrs.field(eq=nan_as_none)
    std_m: float = attrs.field(eq=nan_as_none)
    metres_per_pixel: float = attrs.field(eq=nan_as_none)
    depth: float = attrs.field(eq=nan_as_none)
    distance_m: float | None = attrs.field(eq=nan_as_none)
    flags: Flag
    quantiles_m: tuple[float, ...] | None = attrs.field(default=None, repr=False, eq=nans_as_none)

    def interval(self, level: float = 0.9) -> tuple[float, float]:
        """
        Compute the interval that holds the size with a given probability.

        Parameters
        ----------
        level : float
            The probability, above 0 and below 1.

        Returns
        -------
        tuple of float
            Lower and upper end, in metres; NaN where `size_m` is.

        Raises
        ------
        ValueError
            If the level is no probability.

        Examples
        --------
        >>> from imgscale import Flag, SizeEstimate
        >>> estimate = SizeEstimate(label="car", axis="height", size_m=1.5, std_m=0.06,
        ...                         metres_per_pixel=0.01, depth=7.0, distance_m=None,
        ...                         flags=Flag(0))
        >>> [round(end, 2) for end in estimate.interval(0.9)]
        [1.4, 1.6]
        """
        return interval_of(self.size_m, self.std_m, self.quantiles_m, level)

    def __str__(self) -> str:
        words = ", ".join(flag_names(self.flags))
        size = "unknown" if math.isnan(self.size_m) else f"{with_error(self.size_m, self.std_m)} m"
        if math.isinf(self.std_m):
            size = f"{self.size_m:.2g} +- inf m"
        return f"{self.label}: {self.axis} {size}{f' ({words})' if words else ''}"

    def _repr_html_(self) -> str:
        return sizes_table([self.label], [self])


def sizes_table(
    names: Sequence[str],
    estimates: Sequence[SizeEstimate],
    *,
    unit: str = "m",
    level: float = 0.9,
    most: int | None = None,
) -> Markup:
    """
    Lay out estimates as an HTML table.

    Parameters
    ----------
    names : sequence of str
        The objects' names, by which those of one label are told apart.
    estimates : sequence of SizeEstimate
        Their sizes, in the same order.
    unit : str
        Unit of the sizes: "m", "cm", "mm", "in" or "ft".
    level : float
        Probability of the intervals, above 0 and below 1.
    most : int, optional
        Rows to be shown.

    Returns
    -------
    Markup
        Object, size with its standard error, interval, distance where one is known, and flags in
        words, in the order given.
    """
    axes = {estimate.axis for estimate in estimates}
    mixed = len(axes) > 1
    columns = (
        Column("object"),
        Column("size" if mixed else "".join(axes), numeric=True),
        Column(f"{percent(level)} interval", numeric=True),
        Column("distance", numeric=True),
        Column("notes"),
    )
    rows = [
        (
            name_of(name),
            f"{estimate.axis} {size}" if mixed else size,
            interval,
            _distance_text(estimate.distance_m),
            ", ".join(flag_words(estimate.flags)),
        )
        for name, estimate in zip(names, estimates, strict=True)
        for size, interval in [size_texts(estimate, unit, level)]
    ]
    return table(columns, rows, most=most)


def size_texts(estimate: SizeEstimate, unit: str, level: float) -> tuple[str, str]:
    """
    Write a size with its standard error, and its interval, to the digits that the error justifies.

    Parameters
    ----------
    estimate : SizeEstimate
        The estimate.
    unit : str
        "m", "cm", "mm", "in" or "ft".
    level : float
        Probability of the interval, above 0 and below 1.

    Returns
    -------
    tuple of str
        "0.467 ± 0.017 m" and "0.440 to 0.496 m"; "unknown" and nothing where the size is NaN.
    """
    low, high = (end * PER_METRE[unit] for end in estimate.interval(level))
    size, std = estimate.size_m * PER_METRE[unit], estimate.std_m * PER_METRE[unit]
    if math.isnan(size):
        return ("unknown", "")
    # Without a standard error of its own, a size is known no better than its lower end.
    error = size - low if math.isinf(std) else std
    digits = f".{digits_for(error)}f" if error > 0 else ".4g"
    value = f"about {size:{digits}}" if math.isinf(std) else f"{size:{digits}}"
    value += f" ± {std:{digits}}" if 0 < std < math.inf else ""
    ends = f"above {low:{digits}}" if math.isinf(high) else f"{low:{digits}} to {high:{digits}}"
    return (f"{value} {unit}", f"{ends} {unit}")


def percent(level: float) -> str:
    """
    Write a probability.

    Parameters
    ----------
    level : float
        The probability, 0 to 1.

    Returns
    -------
    str
        For example "90 %", with a space that is not broken.
    """
    return f"{100 * level:.10g}\u00a0%"


def _distance_text(distance_m: float | None) -> str:
    known = distance_m is not None and math.isfinite(distance_m)
    return f"{distance_m:.3g} m" if known else ""


def central_scores(level: float) -> tuple[float, float]:
    """
    Compute the standard scores between which a normal quantity lies with a probability.

    Parameters
    ----------
    level : float
        The probability, above 0 and below 1.

    Returns
    -------
    tuple of float
        Minus and plus the score.

    Raises
    ------
    ValueError
        If the level is no probability.
    """
    if not is_between(as_float(level), 1e-12, 1 - 1e-12):
        raise number_error("level", "above 0 and below 1", as_float(level))  # noqa: EM101 - a name
    from statistics import NormalDist  # noqa: PLC0415 - 20 ms of import that few calls need

    score = NormalDist().inv_cdf((1 + level) / 2)
    return (-score, score)


def quantile(quantiles_m: Sequence[float], score: float) -> float:
    """
    Read a quantile off a table, straight in the logarithm between its entries and beyond them.

    Parameters
    ----------
    quantiles_m : sequence of float
        Sizes at equally spaced standard scores, symmetric about 0, in metres.
    score : float
        The score wanted.

    Returns
    -------
    float
        The size there, in metres.
    """
    last = len(quantiles_m) - 1
    place = (score / LARGEST_SCORE + 1) / 2 * last
    index = min(max(math.floor(place), 0), last - 1)
    low, high = quantiles_m[index], quantiles_m[index + 1]
    if math.isinf(high):
        return low if place == index else high
    if low == 0:  # below all numbers
        return high if place == index + 1 else low
    return float(low * (high / low) ** (place - index))


def quantile_columns(quantiles_m: FloatArray, score: float) -> tuple[FloatArray, FloatArray]:
    """
    Read the ends of central intervals off many tables, as `quantile` does off one.

    Parameters
    ----------
    quantiles_m : (N, S) ndarray of float
        One table in each row, in metres.
    score : float
        Standard score of the upper end, positive.

    Returns
    -------
    low, high : (N,) ndarray of float64
        The ends, in metres; NaN where the table is.
    """
    last = quantiles_m.shape[1] - 1
    ends: list[FloatArray] = []
    for wanted in (-score, score):
        place = (wanted / LARGEST_SCORE + 1) / 2 * last
        index = min(max(math.floor(place), 0), last - 1)
        low, high = quantiles_m[:, index], quantiles_m[:, index + 1]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            between = low * (high / low) ** (place - index)
        between = np.where(low == 0, high if place == index + 1 else low, between)
        ends.append(np.where(np.isposinf(high), low if place == index else high, between))
    return ends[0], ends[1]


def interval_of(
    value: float, std: float, quantiles: Sequence[float] | None, level: float
) -> tuple[float, float]:
    """
    Compute the central interval of a quantity.

    Parameters
    ----------
    value : float
        Its value, which the interval holds.
    std : float
        Its standard error.
    quantiles : sequence of float or None
        Its quantiles at equally spaced standard scores; None where its logarithm is normal.
    level : float
        Probability that the interval holds the truth, above 0 and below 1.

    Returns
    -------
    tuple of float
        Lower and upper end; NaN where the value is NaN.

    Raises
    ------
    ValueError
        If the level is no probability.
    """
    if quantiles is None:
        return log_interval(value, std, level)
    scores = central_scores(level)
    if math.isnan(value):
        return (math.nan, math.nan)
    low, high = (quantile(quantiles, score) for score in scores)
    return (min(low, value), max(high, value))


def log_interval(value: float, std: float, level: float) -> tuple[float, float]:
    """
    Compute the central interval of a log-normal quantity.

    Parameters
    ----------
    value : float
        Its median.
    std : float
        Its standard error, ``value`` times the standard deviation of its logarithm.
    level : float
        Probability that the interval holds the truth, above 0 and below 1.

    Returns
    -------
    tuple of float
        Lower and upper end; NaN where the value is NaN.

    Raises
    ------
    ValueError
        If the level is no probability.
    """
    _, score = central_scores(level)
    if math.isnan(value) or math.isnan(std):
        return (math.nan, math.nan)
    if std == 0:
        return (value, value)
    log_factor = score * std / value if value else math.inf
    factor = math.exp(log_factor) if log_factor < _LARGEST_LOG else math.inf
    return (value / factor, value * factor if value else math.inf)
