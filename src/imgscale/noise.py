"""How much boxes and depths err: the part of the error model that a caller may know."""

from __future__ import annotations

import attrs

from imgscale._checks import as_float, as_optional_float, non_negative

__all__ = ["Noise"]


@attrs.frozen
class Noise:
    """
    Standard errors of what a detector and a depth source report.

    Detector boxes err by about 2 px plus 4 to 6 % of the object's height, hand-drawn boxes by
    1 to 2 px.

    Attributes
    ----------
    box_px : float
        Standard error of a box's height or width, in pixels, >= 0.
    box_rel : float
        The part of that error that grows with the object, relative, >= 0.
    depth_rel : float or None
        Relative standard error of one object's depth, >= 0. The spread of the surface that a map
        shows, or the `rel_std` of an `ObjectDepths`, adds to it in quadrature. None says that it is
        not known: it is then learned from how far the image's references disagree, about 5 % within
        a factor of 2.2, or taken as 0 beside such a `rel_std`. On a ground plane without depth it
        is how far feet lie off the plane (kerbs, dips), relative to the camera's height, in the
        place of the usual 3 % and slopes of 0.1 degrees: 0.005 suits a level floor.

    Raises
    ------
    ValueError
        If a value is negative or not finite.

    Examples
    --------
    >>> from imgscale import Noise
    >>> Noise(box_px=2.0, box_rel=0.04)
    Noise(box_px=2.0, box_rel=0.04, depth_rel=None)
    >>> Noise(depth_rel=-0.1)
    Traceback (most recent call last):
        ...
    ValueError: `depth_rel` must be finite and not negative; got -0.1.
    """

    box_px: float = attrs.field(default=1.0, converter=as_float, validator=non_negative)
    box_rel: float = attrs.field(default=0.0, converter=as_float, validator=non_negative)
    depth_rel: float | None = attrs.field(
        default=None, converter=as_optional_float, validator=attrs.validators.optional(non_negative)
    )
