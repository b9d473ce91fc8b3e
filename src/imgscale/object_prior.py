"""The size of one kind of object, with its spread and its source."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from typing import Any

import attrs

from imgscale._checks import (
    as_flag,
    as_float,
    as_optional_float,
    check_choice,
    is_between,
    non_negative,
    number_error,
    positive,
    text,
    true_or_false,
)
from imgscale._tables import shipped_table
from imgscale._typing import Region, SizeAxis

__all__ = ["ObjectPrior", "normal_label"]

SIZE_AXES: tuple[SizeAxis, ...] = ("height", "width", "diameter")
REGIONS: tuple[Region, ...] = ("world", "eu", "us")
SHIPPED = "priors_2026_11.csv"
# A factor that no population of one kind of thing spans, and that centimetres, millimetres and
# inches exceed; feet (3.3) do not.
_UNIT_FACTOR = 5.0


@functools.lru_cache(maxsize=4096)  # a detector has few labels, and each image asks for them all
def normal_label(label: object) -> str:
    """
    Bring a label to the form in which labels are compared.

    Parameters
    ----------
    label : str
        A label as a detector spells it.

    Returns
    -------
    str
        Casefolded, with ``_`` and ``-`` as spaces and runs of spaces as one.

    Raises
    ------
    TypeError
        If the label is no string.
    """
    if not isinstance(label, str):
        msg = f"`label` must be a string; got {label!r}."
        raise TypeError(msg)
    return " ".join(label.casefold().replace("_", " ").replace("-", " ").split())


def _as_aliases(value: Iterable[str]) -> tuple[str, ...]:
    return (value,) if isinstance(value, str) else tuple(value)


def _check_aliases(_: object, __: object, value: tuple[object, ...]) -> None:
    for alias in value:
        if not isinstance(alias, str):
            msg = f"`aliases` must be strings; got {alias!r}."
            raise TypeError(msg)
        if not alias.strip() or ";" in alias:
            msg = f"`aliases` must not be blank or hold a semicolon; got {alias!r}."
            raise ValueError(msg)


def _check_axis(_: object, __: attrs.Attribute[Any], value: str) -> None:
    check_choice("axis", value, SIZE_AXES)


def _check_region(_: object, __: attrs.Attribute[Any], value: str) -> None:
    check_choice("region", value, REGIONS)


def _check_share(_: object, __: attrs.Attribute[Any], value: float) -> None:
    if not (is_between(value, 0, 1) and value):
        raise number_error("share", "above 0 and at most 1", value)  # noqa: EM101 - a name


@attrs.frozen
class ObjectPrior:
    """
    The size of one kind of object along one axis, as a detector boxes it.

    A size is taken as log-normal: ``mu = log(mean) - s^2 / 2`` with
    ``s^2 = log(1 + (std / mean)^2)``, so that `mean_m` and `std_m` are the arithmetic mean and
    the standard deviation that sources print.

    Attributes
    ----------
    label : str
        The object, as a detector or a user calls it.
    mean_m : float
        Mean size in metres, positive.
    std_m : float
        Standard deviation between individuals, in metres, >= 0; 0 for an object measured exactly.
    mean_std_m : float
        Standard error of the mean itself, in metres, >= 0: which country, which population. All
        references of one label share this deviation.
    axis : str
        "height", "width" or "diameter": the longer side of the box, of a round object or of a flat
        one that lies either way up.
    on_ground : bool
        True where the lower edge of the box is where the object meets the ground.
    depth_extent_m : float or None
        Extent along the view, in metres, positive; None where it is not known.
    share : float
        Weight of this row among the rows of its label and axis, above 0 to 1. Several rows of one
        label are a mixture; their shares count relative to each other.
    aliases : tuple of str
        Other labels of the same object.
    source : str
        Where the numbers were read. "nominal" says that they were recalled, their spread doubled.
    region : str
        "world", "eu" or "us".
    year : int or None
        Year of the source.
    n : int or None
        Number of individuals behind the numbers.
    spans : str
        What the box reaches from and to: with shoes, without mirrors.

    Raises
    ------
    ValueError
        If a number breaks its law, or the mean is more than 5 times off every shipped row of that
        label: then the unit is wrong.

    Examples
    --------
    >>> from imgscale import ObjectPrior
    >>> ObjectPrior("survey pole", 1.0, 0.002).mean_m
    1.0
    >>> ObjectPrior("car", 151.0, 12.0)
    Traceback (most recent call last):
        ...
    ValueError: `mean_m` of "car" must be in metres; got 151.0, where the shipped rows say 1.53 to
    1.735. Divide centimetres by 100, or use another label for another thing.
    """

    label: str = attrs.field(validator=text)
    mean_m: float = attrs.field(converter=as_float, validator=positive)
    std_m: float = attrs.field(converter=as_float, validator=non_negative)
    mean_std_m: float = attrs.field(
        default=0.0, kw_only=True, converter=as_float, validator=non_negative
    )
    axis: SizeAxis = attrs.field(default="height", kw_only=True, validator=_check_axis)
    on_ground: bool = attrs.field(
        default=True, kw_only=True, converter=as_flag, validator=true_or_false
    )
    depth_extent_m: float | None = attrs.field(
        default=None,
        kw_only=True,
        converter=as_optional_float,
        validator=attrs.validators.optional(positive),
    )
    share: float = attrs.field(
        default=1.0, kw_only=True, converter=as_float, validator=_check_share
    )
    aliases: tuple[str, ...] = attrs.field(
        default=(), kw_only=True, converter=_as_aliases, validator=_check_aliases
    )
    source: str = attrs.field(default="", kw_only=True)
    region: Region = attrs.field(default="world", kw_only=True, validator=_check_region)
    year: int | None = attrs.field(default=None, kw_only=True)
    n: int | None = attrs.field(default=None, kw_only=True)
    spans: str = attrs.field(default="", kw_only=True)

    def __attrs_post_init__(self) -> None:
        for name, error in (("std_m", self.std_m), ("mean_std_m", self.mean_std_m)):
            if error > _LARGEST_SPREAD * self.mean_m:
                msg = f"`{name}` must be at most 1e6 times the mean, {self.mean_m}; got {error}."
                raise ValueError(msg)
        shipped = _shipped_ranges().get((normal_label(self.label), self.axis))
        if shipped is None:
            return
        low, high = shipped
        if not low / _UNIT_FACTOR <= self.mean_m <= high * _UNIT_FACTOR:
            rows = f"{low:g}" if low == high else f"{low:g} to {high:g}"
            msg = (
                f'`mean_m` of "{self.label}" must be in metres; got {self.mean_m}, where the '
                f"shipped rows say {rows}. Divide centimetres by 100, or use another label for "
                "another thing."
            )
            raise ValueError(msg)

    @property
    def names(self) -> tuple[str, ...]:
        """The label and its aliases, in the form in which labels are compared."""
        return tuple(dict.fromkeys(normal_label(name) for name in (self.label, *self.aliases)))


_LARGEST_SPREAD = 1e6  # so many times its mean, a size is not known at all


@functools.cache
def _shipped_ranges() -> dict[tuple[str, str], tuple[float, float]]:
    """Smallest and largest shipped mean of every (label or alias, axis)."""
    ranges: dict[tuple[str, str], tuple[float, float]] = {}
    for _, row in shipped_table(SHIPPED).records:
        mean_m = float(row["mean_m"])
        for name in (row["label"], *row["aliases"].split(";")):
            key = (normal_label(name), row["axis"])
            low, high = ranges.get(key, (mean_m, mean_m))
            ranges[key] = (min(low, mean_m), max(high, mean_m))
    return ranges
