"""How big things are: sourced sizes with their spread, and the table that finds them by label."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator
from os import PathLike
from typing import Any

import attrs

from imgscale._checks import (
    as_float,
    as_optional_float,
    check_choice,
    is_between,
    non_negative,
    number_error,
    positive,
    text,
)
from imgscale._tables import Table, read_table, shipped_table, write_table
from imgscale._typing import Region, SizeAxis

__all__ = ["ObjectPrior", "PriorTable", "normal_label"]

SIZE_AXES: tuple[SizeAxis, ...] = ("height", "width", "diameter")
REGIONS: tuple[Region, ...] = ("world", "eu", "us")
_SHIPPED = "priors_2026_11.csv"
_PAPER = "paper_table_3_2.csv"
_COLUMNS = (
    "label", "aliases", "axis", "mean_m", "std_m", "mean_std_m", "on_ground", "depth_extent_m",
    "share", "region", "source", "year", "n", "spans",
)  # fmt: skip
# A factor that no population of one kind of thing spans, and that every mistaken unit exceeds.
_UNIT_FACTOR = 5.0


def normal_label(label: str) -> str:
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
    """
    return " ".join(label.casefold().replace("_", " ").replace("-", " ").split())


def _as_aliases(value: Iterable[str]) -> tuple[str, ...]:
    return (value,) if isinstance(value, str) else tuple(value)


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
        "height", "width" or "diameter" (the longer side of a round object's box).
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
    on_ground: bool = attrs.field(default=True, kw_only=True, converter=bool)
    depth_extent_m: float | None = attrs.field(
        default=None, kw_only=True, converter=as_optional_float, validator=positive
    )
    share: float = attrs.field(
        default=1.0, kw_only=True, converter=as_float, validator=_check_share
    )
    aliases: tuple[str, ...] = attrs.field(default=(), kw_only=True, converter=_as_aliases)
    source: str = attrs.field(default="", kw_only=True)
    region: Region = attrs.field(default="world", kw_only=True, validator=_check_region)
    year: int | None = attrs.field(default=None, kw_only=True)
    n: int | None = attrs.field(default=None, kw_only=True)
    spans: str = attrs.field(default="", kw_only=True)

    def __attrs_post_init__(self) -> None:
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


@functools.cache
def _shipped_ranges() -> dict[tuple[str, str], tuple[float, float]]:
    """Smallest and largest shipped mean of every (label or alias, axis)."""
    ranges: dict[tuple[str, str], tuple[float, float]] = {}
    for _, row in shipped_table(_SHIPPED).records:
        mean_m = float(row["mean_m"])
        for name in (row["label"], *row["aliases"].split(";")):
            key = (normal_label(name), row["axis"])
            low, high = ranges.get(key, (mean_m, mean_m))
            ranges[key] = (min(low, mean_m), max(high, mean_m))
    return ranges


def _as_priors(value: Iterable[ObjectPrior]) -> tuple[ObjectPrior, ...]:
    return tuple(value)


def _check_priors(_: object, __: attrs.Attribute[Any], value: tuple[object, ...]) -> None:
    for index, item in enumerate(value):
        if not isinstance(item, ObjectPrior):
            msg = f"`priors` must hold ObjectPrior objects; got {item!r} at index {index}."
            raise TypeError(msg)


@attrs.frozen
class PriorTable:
    """
    Sizes by label.

    Labels are compared after casefolding and with ``_`` and ``-`` as spaces, exactly, aliases
    included. Several rows of one label and axis are a mixture.

    Attributes
    ----------
    priors : tuple of ObjectPrior
        The rows.

    Raises
    ------
    ValueError
        If a name belongs to two labels.

    Examples
    --------
    >>> from imgscale import ObjectPrior, PriorTable
    >>> table = PriorTable([ObjectPrior("survey pole", 1.0, 0.002, aliases=("pole",))])
    >>> table.lookup("Survey_Pole")[0].mean_m
    1.0
    >>> "giraffe" in table
    False
    """

    priors: tuple[ObjectPrior, ...] = attrs.field(converter=_as_priors, validator=_check_priors)

    def __attrs_post_init__(self) -> None:
        _ = self._rows  # raises where a name belongs to two labels

    @functools.cached_property
    def _rows(self) -> dict[str, tuple[ObjectPrior, ...]]:
        """The rows of every label and alias."""
        by_label: dict[str, list[ObjectPrior]] = {}
        owner: dict[str, str] = {}
        for prior in self.priors:
            label = normal_label(prior.label)
            by_label.setdefault(label, []).append(prior)
            for name in prior.names:
                if owner.setdefault(name, label) != label:
                    msg = (
                        f'`priors` must give each name to one label; got "{name}" for '
                        f'"{owner[name]}" and for "{label}".'
                    )
                    raise ValueError(msg)
        return {name: tuple(by_label[label]) for name, label in owner.items()}

    def __len__(self) -> int:
        return len(self.priors)

    def __iter__(self) -> Iterator[ObjectPrior]:
        return iter(self.priors)

    def __contains__(self, label: object) -> bool:
        return isinstance(label, str) and normal_label(label) in self._rows

    @property
    def labels(self) -> tuple[str, ...]:
        """The distinct labels, in the order of the rows, without aliases."""
        return tuple(dict.fromkeys(prior.label for prior in self.priors))

    def lookup(self, label: str) -> tuple[ObjectPrior, ...]:
        """
        Find the rows of a label or alias.

        Parameters
        ----------
        label : str
            The label, as a detector spells it.

        Returns
        -------
        tuple of ObjectPrior
            Its rows on every axis, empty where the table does not know it.
        """
        return self._rows.get(normal_label(label), ())

    def with_prior(self, prior: ObjectPrior) -> PriorTable:
        """
        Put one row in, in place of all rows of its label.

        Parameters
        ----------
        prior : ObjectPrior
            The new row. Names that it shares with other labels become its own.

        Returns
        -------
        PriorTable
            A new table.

        Examples
        --------
        >>> from imgscale import ObjectPrior, PriorTable
        >>> mine = PriorTable.default().with_prior(ObjectPrior("door", 2.031, 0.002))
        >>> [row.mean_m for row in mine.lookup("door")]
        [2.031]
        """
        taken = set(prior.names)
        kept = [
            attrs.evolve(
                row, aliases=[name for name in row.aliases if normal_label(name) not in taken]
            )
            for row in self.priors
            if normal_label(row.label) not in taken
        ]
        return PriorTable([*kept, prior])

    @classmethod
    def default(cls, region: Region = "world") -> PriorTable:
        """
        Load the shipped table.

        Parameters
        ----------
        region : str
            "world", "eu" or "us". Where a region has rows of its own for a label and axis, they
            replace the world's.

        Returns
        -------
        PriorTable
            Sizes of people, vehicles, furniture, animals and standards, each with its source.

        Raises
        ------
        ValueError
            If the region is unknown.

        Examples
        --------
        >>> from imgscale import PriorTable
        >>> {row.axis: row.mean_m for row in PriorTable.default().lookup("Id_Card")}
        {'height': 0.05398, 'width': 0.0856}
        """
        check_choice("region", region, REGIONS)
        return _shipped_table(region)

    @classmethod
    def paper(cls) -> PriorTable:
        """
        Load Table 3.2 of Singh and Shrivastava (2023).

        Returns
        -------
        PriorTable
            The six mean heights as printed. The paper states no spread; 10 % is assumed here, and
            matters only to ``method="robust"``.

        Examples
        --------
        >>> from imgscale import PriorTable
        >>> [(row.label, row.mean_m) for row in PriorTable.paper()]
        [('train', 4.02), ('car', 1.7), ('person', 1.72), ('traffic signal', 2.1),
         ('truck', 2.8), ('wheel', 0.83)]
        """
        return cls(_read_rows(shipped_table(_PAPER), "world"))

    @classmethod
    def from_csv(cls, path: str | PathLike[str], *, region: Region = "world") -> PriorTable:
        """
        Read a table from a file.

        Parameters
        ----------
        path : str or path-like
            A CSV file, UTF-8, with a header. The columns label, mean_m and std_m are required;
            aliases (separated by ``;``), axis, mean_std_m, on_ground, depth_extent_m, share,
            region, source, year, n and spans are optional. Lengths are metres.
        region : str
            Where rows of this region exist for a label and axis, they replace the world's.

        Returns
        -------
        PriorTable
            The rows of that region.

        Raises
        ------
        ValueError
            If a column is missing or unknown, or a row breaks a law; all bad rows are named.
        """
        check_choice("region", region, REGIONS)
        return cls(_read_rows(read_table(path), region))

    def to_csv(self, path: str | PathLike[str]) -> None:
        """
        Write the table to a file that `from_csv` reads back.

        Parameters
        ----------
        path : str or path-like
            The file to write.
        """
        write_table(path, _COLUMNS, [[_cell(row, c) for c in _COLUMNS] for row in self.priors])


def _cell(prior: ObjectPrior, column: str) -> str:
    value = getattr(prior, column)
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return "; ".join(prior.aliases) if column == "aliases" else str(value)


@functools.cache
def _shipped_table(region: Region) -> PriorTable:
    return PriorTable(_read_rows(shipped_table(_SHIPPED), region))


def _read_rows(table: Table, region: Region) -> list[ObjectPrior]:
    """Read the rows that hold in a region, naming every bad row at once."""
    columns = set(table.columns)
    wrong = [
        f"{word} {', '.join(sorted(found))}"
        for word, found in (
            ("no", {"label", "mean_m", "std_m"} - columns),
            ("unknown", columns - set(_COLUMNS)),
        )
        if found
    ]
    if wrong:
        msg = f"{table.name} must have the columns of a prior table; got {'; '.join(wrong)}."
        raise ValueError(msg)
    rows: list[ObjectPrior] = []
    problems: list[str] = []
    for line, record in table.records:
        try:
            rows.append(_parse_row(record))
        except (ValueError, TypeError) as error:
            problems.append(f"line {line}: {error}")
    if problems:
        msg = f"{table.name} must hold lawful rows; got {len(problems)} bad: {' | '.join(problems)}"
        raise ValueError(msg)
    return _rows_of_region(rows, region, table.name)


def _rows_of_region(rows: list[ObjectPrior], region: Region, name: str) -> list[ObjectPrior]:
    """Keep a region's own rows and, where it has none, the world's."""
    regions: dict[tuple[str, SizeAxis], set[str]] = {}
    for row in rows:
        regions.setdefault((row.label, row.axis), set()).add(row.region)
    lost = sorted(key[0] for key, found in regions.items() if not found & {"world", region})
    if lost:
        msg = (
            f'{name} must have a row for region "world" or "{region}" of every label; '
            f"got none for {', '.join(lost)}."
        )
        raise ValueError(msg)
    return [
        row
        for row in rows
        if row.region == (region if region in regions[row.label, row.axis] else "world")
    ]


def _parse_row(record: dict[str, Any]) -> ObjectPrior:
    """Turn the cells of one line into a prior; empty cells take the defaults."""
    if record.get("") is not None or None in record.values():
        msg = "a row must have as many cells as the header."
        raise ValueError(msg)
    cells = {column: cell.strip() for column, cell in record.items() if cell.strip()}
    for column in ("mean_m", "std_m", "mean_std_m", "depth_extent_m", "share"):
        if column in cells:
            cells[column] = float(cells[column])
    for column in ("year", "n"):
        if column in cells:
            cells[column] = int(cells[column])
    if "aliases" in cells:
        cells["aliases"] = [part.strip() for part in cells["aliases"].split(";") if part.strip()]
    if "on_ground" in cells:
        words = {"true": True, "false": False}
        if cells["on_ground"].lower() not in words:
            msg = f"`on_ground` must be true or false; got {cells['on_ground']!r}."
            raise ValueError(msg)
        cells["on_ground"] = words[cells["on_ground"].lower()]
    missing = sorted({"label", "mean_m", "std_m"} - cells.keys())
    if missing:
        msg = f"a row must give {', '.join(missing)}."
        raise ValueError(msg)
    return ObjectPrior(**cells)
