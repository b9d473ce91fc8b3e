"""The table of sizes: finds the priors of a label."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator
from os import PathLike

import attrs

from imgscale._checks import check_choice, check_iterable
from imgscale._tables import read_table, shipped_table, write_table
from imgscale._typing import Region
from imgscale.object_prior import REGIONS, SHIPPED, ObjectPrior, normal_label
from imgscale.prior_rows import COLUMNS, read_rows, write_row

__all__ = ["PriorTable"]

_PAPER = "paper_table_3_2.csv"


def _as_priors(value: Iterable[ObjectPrior]) -> tuple[ObjectPrior, ...]:
    check_iterable("priors", value, "ObjectPrior")
    return tuple(value)


def _count(rows: tuple[ObjectPrior, ...]) -> str:
    return f"<{len(rows)} rows>"


def _check_priors(_: object, __: object, value: tuple[object, ...]) -> None:
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

    priors: tuple[ObjectPrior, ...] = attrs.field(
        converter=_as_priors, validator=_check_priors, repr=_count
    )

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
        Put one row in, in place of all rows of its label, on every axis.

        Parameters
        ----------
        prior : ObjectPrior
            The new row. Aliases of other labels that it claims become its own.

        Returns
        -------
        PriorTable
            A new table.

        Raises
        ------
        ValueError
            If one of its aliases is another label.
        TypeError
            If it is no prior.

        Examples
        --------
        >>> from imgscale import ObjectPrior, PriorTable
        >>> mine = PriorTable.default().with_prior(ObjectPrior("door", 2.031, 0.002))
        >>> [row.mean_m for row in mine.lookup("door")]
        [2.031]
        """
        _check_priors(None, None, (prior,))
        kept = [
            attrs.evolve(
                row,
                aliases=[name for name in row.aliases if normal_label(name) not in prior.names],
            )
            for row in self.priors
            if normal_label(row.label) != normal_label(prior.label)
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
        >>> [(row.axis, row.mean_m) for row in PriorTable.default().lookup("Id_Card")]
        [('diameter', 0.0856)]
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
        return cls(read_rows(shipped_table(_PAPER), "world"))

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
        return cls(read_rows(read_table(path), region))

    def to_csv(self, path: str | PathLike[str]) -> None:
        """
        Write the table to a file that `from_csv` reads back, with the region it was made for.

        Parameters
        ----------
        path : str or path-like
            The file to write.
        """
        write_table(path, COLUMNS, [write_row(row) for row in self.priors])


@functools.cache
def _shipped_table(region: Region) -> PriorTable:
    return PriorTable(read_rows(shipped_table(SHIPPED), region))
