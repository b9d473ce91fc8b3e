"""A measured length or area with its interval, and the extents of one object."""

from __future__ import annotations

import math
from typing import Literal

import attrs

from imgscale._checks import nan_as_none, nans_as_none
from imgscale._format import with_error
from imgscale.estimate import interval_of
from imgscale.flags import Flag, flag_names

__all__ = ["Extent", "Quantity"]


@attrs.frozen(kw_only=True)
class Quantity:
    """
    A length or an area.

    Attributes
    ----------
    value : float
        In metres or square metres; NaN where it cannot be said.
    std : float
        Its standard error, in the same unit: half the width of its central 68.3 %, of a distance
        itself and, as for a `SizeEstimate`, of the logarithm of an extent times its value.
    unit : str
        "m" or "m2".
    flags : Flag
        Reservations.
    quantiles : tuple of float or None
        Values at the standard scores -3.5, -3.25, ..., 3.5 (the normal quantiles of their
        probabilities): the shape of the distribution. None where the logarithm is normal.
    """

    value: float = attrs.field(eq=nan_as_none)
    std: float = attrs.field(eq=nan_as_none)
    unit: Literal["m", "m2"]
    flags: Flag = attrs.field(default=Flag(0))
    quantiles: tuple[float, ...] | None = attrs.field(default=None, repr=False, eq=nans_as_none)

    def interval(self, level: float = 0.9) -> tuple[float, float]:
        """
        Compute the interval that holds the quantity with a given probability.

        Parameters
        ----------
        level : float
            The probability, above 0 and below 1.

        Returns
        -------
        tuple of float
            Lower and upper end, in the unit of the value, which lies between them; NaN where that
            is.

        Raises
        ------
        ValueError
            If the level is no probability.

        Examples
        --------
        >>> from imgscale.measuring import Quantity
        >>> table = Quantity(value=1.5, std=0.06, unit="m")
        >>> print(table)
        1.50 +- 0.06 m
        >>> [round(end, 2) for end in table.interval(0.9)]
        [1.4, 1.6]
        """
        return interval_of(self.value, self.std, self.quantiles, level)

    def __str__(self) -> str:
        words = ", ".join(flag_names(self.flags))
        text = "unknown" if math.isnan(self.value) else f"{self._number()} {self.unit}"
        return f"{text}{f' ({words})' if words else ''}"

    def _number(self) -> str:
        """Write the value with its error."""
        if math.isinf(self.std):
            return f"{self.value:.2g} +- inf"
        return with_error(self.value, self.std)


@attrs.frozen(kw_only=True)
class Extent:
    """
    How large one region of the picture is, as a silhouette that faces the camera.

    Attributes
    ----------
    height, width : Quantity
        Sides of its bounding box, in metres.
    longest : Quantity
        Its greatest extent in any direction (maximum Feret diameter), in metres.
    area : Quantity
        Its area, in square metres.
    metres_per_pixel : float
        Scale at its distance, in m/px; NaN without a depth.
    depth : float
        Its depth, in the unit of the depth given; NaN without one.
    distance_m : float or None
        Its z-depth in metres; None where no focal length is known, NaN without a depth.
    """

    height: Quantity
    width: Quantity
    longest: Quantity
    area: Quantity
    metres_per_pixel: float = attrs.field(eq=nan_as_none)
    depth: float = attrs.field(eq=nan_as_none)
    distance_m: float | None = attrs.field(eq=nan_as_none)

    @property
    def flags(self) -> Flag:
        """Gather the reservations about all its quantities."""
        return self.height.flags | self.width.flags | self.longest.flags | self.area.flags

    def __str__(self) -> str:
        parts = {name: attrs.evolve(getattr(self, name), flags=Flag(0)) for name in _QUANTITIES}
        words = ", ".join(flag_names(self.flags))
        text = ", ".join(f"{name} {quantity}" for name, quantity in parts.items())
        return f"{text}{f' ({words})' if words else ''}"


_QUANTITIES = ("height", "width", "longest", "area")
