"""A thing that stands in a drawn scene."""

from __future__ import annotations

from typing import Any, cast

import attrs
from numpy.typing import ArrayLike

from imgscale._checks import (
    as_array,
    as_float,
    as_optional_float,
    check_choice,
    finite,
    positive,
    text,
    true_or_false,
)
from imgscale.datasets.drawn._silhouettes import SHAPES, SILHOUETTES, Colour

__all__ = ["Thing"]


def _check_colour(_: object, __: attrs.Attribute[Any], value: object) -> None:
    if value is None:
        return
    parts = as_array("colour", "three numbers from 0 to 1", cast("ArrayLike", value))
    lawful = parts.shape == (3,) and parts.dtype.kind in "fiu"
    if not (lawful and parts.min() >= 0 and parts.max() <= 1):
        msg = f"`colour` must be red, green and blue, three numbers from 0 to 1; got {value!r}."
        raise ValueError(msg)


@attrs.frozen
class Thing:
    """
    A flat, upright silhouette that faces along the ground towards the camera's side.

    Attributes
    ----------
    label : str
        What it is; the label of its detection.
    right_m, ahead_m : float
        Where the middle of its foot is, in metres from the point below the camera.
    height_m : float
        Its height in metres, positive.
    width_m : float or None
        Its width in metres, positive; what is usual for its shape where None.
    up_m : float
        How far its foot is above the ground, in metres; 0 stands on it.
    shape : str or None
        One of `SHAPES`; the label where None.
    colour : tuple of float or None
        Red, green and blue of its main part, 0 to 1; what is usual for its shape where None.
    mirrored : bool
        True to face the other way.

    Raises
    ------
    ValueError
        If a number breaks its law or the shape is unknown.

    Examples
    --------
    >>> from imgscale.datasets.drawn import Thing
    >>> round(Thing("car", 0.0, 12.0, 1.5).drawn_width_m, 2)
    4.32
    >>> Thing("unicorn", 0.0, 12.0, 1.5, shape="roe deer").shape
    'roe deer'
    """

    label: str = attrs.field(validator=text)
    right_m: float = attrs.field(converter=as_float, validator=finite)
    ahead_m: float = attrs.field(converter=as_float, validator=finite)
    height_m: float = attrs.field(converter=as_float, validator=positive)
    width_m: float | None = attrs.field(
        default=None,
        kw_only=True,
        converter=as_optional_float,
        validator=attrs.validators.optional(positive),
    )
    up_m: float = attrs.field(default=0.0, kw_only=True, converter=as_float, validator=finite)
    shape: str | None = attrs.field(default=None, kw_only=True)
    colour: Colour | None = attrs.field(default=None, kw_only=True, validator=_check_colour)
    mirrored: bool = attrs.field(default=False, kw_only=True, validator=true_or_false)

    def __attrs_post_init__(self) -> None:
        check_choice("shape", self.drawn_as, SHAPES)

    @property
    def drawn_as(self) -> str:
        """The name of the shape that is drawn."""
        return self.label if self.shape is None else self.shape

    @property
    def drawn_width_m(self) -> float:
        """Width in metres, as drawn."""
        return self.width_m or self.height_m * SILHOUETTES[self.drawn_as].aspect
