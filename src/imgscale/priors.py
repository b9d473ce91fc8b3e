"""The table of sizes: finds the priors of a label."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from os import PathLike
from types import MappingProxyType
from typing import NamedTuple, TypeAlias

import attrs
import numpy as np

from imgscale._checks import check_choice, check_iterable
from imgscale._reading import MAX_BYTES, in_file
from imgscale._tables import read_table, shipped_table, write_table
from imgscale._typing import FloatArray, Region, SizeAxis
from imgscale.object_prior import REGIONS, SHIPPED, SIZE_AXES, ObjectPrior, normal_label
from imgscale.prior_rows import COLUMNS, read_rows, write_row

__all__ = ["PriorTable"]

MeanKey: TypeAlias = tuple[str, SizeAxis]
LogKind: TypeAlias = tuple[float, float, float]

_PAPER = "paper_table_3_2.csv"
_NOTHING_KNOWN = (math.nan,) * 6


class SizePrior(NamedTuple):
    """
    What a table knows of one label along one axis.

    Attributes
    ----------
    axis : str
        The axis.
    rows : tuple of ObjectPrior
        The rows of the table, one for each kind of thing that the label may be; empty without.
    mean_m, std_m, mean_std_m : float
        Moments of the mixture, in metres; NaN without a prior.
    log_mean, log_var : float
        Mean and variance of the log size, all kinds together.
    tau : float
        Relative error of the mean.
    kinds : tuple of tuple of float
        Share, log mean and log variance of each kind; the shares sum to 1.
    key : tuple of str or None
        The table's label and the axis, whose mean size it is; None without a prior.
    """

    axis: SizeAxis
    rows: tuple[ObjectPrior, ...]
    mean_m: float
    std_m: float
    mean_std_m: float
    log_mean: float
    log_var: float
    tau: float
    kinds: tuple[LogKind, ...]
    key: MeanKey | None

    @property
    def on_ground(self) -> bool:
        """True where the lower edge of the box is where the object stands, as far as is known."""
        return all(row.on_ground for row in self.rows)


def moments_of(rows: Sequence[ObjectPrior], axis: SizeAxis) -> SizePrior:
    """
    Compute mean, spread and error of the mean of a mixture of sizes.

    Parameters
    ----------
    rows : sequence of ObjectPrior
        The kinds of thing that one label stands for.
    axis : str
        Their axis.

    Returns
    -------
    SizePrior
        The spread holds the distance between the parts: ``sum w (std^2 + mean^2) - mean^2``.
    """
    if not rows:
        return SizePrior(axis, (), *_NOTHING_KNOWN, kinds=(), key=None)
    kinds, first = _log_kinds(rows), rows[0]
    mean_m, std_m, mean_std_m = first.mean_m, first.std_m, first.mean_std_m
    if len(rows) > 1:
        parts = [(kind[0], row) for kind, row in zip(kinds, rows, strict=True)]
        mean_m = sum(share * row.mean_m for share, row in parts)
        variance = sum(share * (row.std_m**2 + (row.mean_m - mean_m) ** 2) for share, row in parts)
        std_m = math.sqrt(variance)
        mean_std_m = sum(share * row.mean_std_m for share, row in parts)
    log_mean, log_var = log_moments(mean_m, std_m)
    return SizePrior(
        axis=axis,
        rows=tuple(rows),
        mean_m=mean_m,
        std_m=std_m,
        mean_std_m=mean_std_m,
        log_mean=float(log_mean),
        log_var=float(log_var),
        tau=mean_std_m / mean_m,
        kinds=kinds,
        key=(normal_label(first.label), axis),
    )


def _log_kinds(rows: Sequence[ObjectPrior]) -> tuple[LogKind, ...]:
    """Turn the rows of one label into log-normal sizes."""
    total = sum(row.share for row in rows)
    kinds: list[LogKind] = []
    for row in rows:
        log_mean, log_var = log_moments(row.mean_m, row.std_m)
        kinds.append((row.share / total, float(log_mean), float(log_var)))
    return tuple(kinds)


def log_moments(
    mean_m: FloatArray | float, std_m: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """
    Turn a mean and a standard deviation into those of the logarithm of a log-normal size.

    Parameters
    ----------
    mean_m, std_m : float or ndarray of float
        Arithmetic mean and standard deviation, in metres.

    Returns
    -------
    log_mean, log_var : float64 or ndarray of float64
        ``log(mean) - s^2 / 2`` and ``s^2 = log(1 + (std / mean)^2)``.
    """
    log_var: FloatArray = np.log1p((np.asarray(std_m, dtype=np.float64) / mean_m) ** 2)
    return np.log(mean_m) - log_var / 2, log_var


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


_NO_SIZES: Mapping[SizeAxis, SizePrior] = MappingProxyType({})


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
        rows = {label: tuple(found) for label, found in by_label.items()}
        return {name: rows[label] for name, label in owner.items()}

    @functools.cached_property
    def _sizes(self) -> dict[str, Mapping[SizeAxis, SizePrior]]:
        """What was asked of labels so far; threads that ask at once find the same."""
        return {}

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

    def sizes(self, label: str) -> Mapping[SizeAxis, SizePrior]:
        """
        Find what is known of a label or alias along each axis, all its rows together.

        Parameters
        ----------
        label : str
            The label, as a detector spells it.

        Returns
        -------
        mapping of str to SizePrior
            The axes of its rows, in the order height, width, diameter, each with the rows and the
            mean, spread and error of the mean of their mixture; empty where the table does not
            know the label.

        Examples
        --------
        >>> from imgscale import PriorTable
        >>> car = PriorTable.default().sizes("car")["height"]
        >>> (car.mean_m, car.rows[0].source == "")
        (1.6, False)
        """
        name = normal_label(label)
        known = self._sizes.get(name)
        if known is None and name in self._rows:
            known = self._sizes[name] = _along_axes(self._rows[name])
        return known or _NO_SIZES

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
    def from_csv(
        cls, path: str | PathLike[str], *, region: Region = "world", max_bytes: int = MAX_BYTES
    ) -> PriorTable:
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
        max_bytes : int
            Greatest length of the file.

        Returns
        -------
        PriorTable
            The rows of that region.

        Raises
        ------
        FileError
            If the file is no table in UTF-8 or longer than `max_bytes`, a column is missing or
            unknown, or a row breaks a law; up to 100 bad rows are named by line.
        ValueError
            If the region is unknown.
        OSError
            If the file cannot be opened.
        """
        check_choice("region", region, REGIONS)
        rows = read_rows(read_table(path, max_bytes), region)
        with in_file(path):
            return cls(rows)

    def to_csv(self, path: str | PathLike[str]) -> None:
        """
        Write the table to a file that `from_csv` reads back, with the region it was made for.

        A text that a spreadsheet would take for a formula is written behind an apostrophe, which
        `from_csv` takes away.

        Parameters
        ----------
        path : str or path-like
            The file to write.
        """
        write_table(path, COLUMNS, [write_row(row) for row in self.priors])


def _along_axes(rows: Sequence[ObjectPrior]) -> Mapping[SizeAxis, SizePrior]:
    along: dict[SizeAxis, SizePrior] = {}
    for axis in SIZE_AXES:
        if own := [row for row in rows if row.axis == axis]:
            along[axis] = moments_of(own, axis)
    return MappingProxyType(along)


@functools.cache
def _shipped_table(region: Region) -> PriorTable:
    return PriorTable(read_rows(shipped_table(SHIPPED), region))
