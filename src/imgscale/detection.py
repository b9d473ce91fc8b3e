"""What a detector saw: a label and a box, in half-open pixels."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import attrs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgscale._checks import (
    array_summary,
    as_array,
    as_flag,
    as_float,
    as_known_image_size,
    check_iterable,
    four_numbers,
    is_between,
    number_error,
    restore,
    text,
    true_or_false,
)
from imgscale._reading import quoted
from imgscale._typing import BoolArray, Box

__all__ = ["Detection", "check_detections"]


def _as_box(value: Sequence[float] | NDArray[Any]) -> Box:
    x1, y1, x2, y2 = four_numbers("xyxy", "four numbers (x1, y1, x2, y2)", value)
    if not all(math.isfinite(number) for number in (x1, y1, x2, y2)):
        msg = f"`xyxy` must be finite; got {(x1, y1, x2, y2)}."
        raise ValueError(msg)
    if not (x1 < x2 and y1 < y2):
        msg = (
            f"`xyxy` must have x1 < x2 and y1 < y2; got {(x1, y1, x2, y2)}. Boxes given as "
            "x, y, width, height go through Detection.from_xywh()."
        )
        raise ValueError(msg)
    return (x1, y1, x2, y2)


def _as_names(value: Iterable[str]) -> tuple[str, ...]:
    if isinstance(value, str):
        return (value,)
    check_iterable("aliases", value, "str")
    return tuple(value)


def _as_mask(value: ArrayLike | None) -> BoolArray | None:
    if value is None:
        return None
    array = as_array("mask", "an array of shape (H, W)", value)
    if array.dtype != np.bool_:
        msg = (
            f"`mask` must be boolean, True on the object; got dtype {array.dtype}. Compare it "
            "first: mask > 0."
        )
        raise TypeError(msg)
    if array.ndim != 2:
        msg = f"`mask` must have the image's shape (H, W); got {array.shape}."
        raise ValueError(msg)
    owned = array.astype(np.bool_)
    owned.flags.writeable = False
    return owned


def _check_score(_: object, __: attrs.Attribute[Any], value: float) -> None:
    if not is_between(value, 0, 1):
        raise number_error("score", "between 0 and 1", value, "Divide percentages by 100.")  # noqa: EM101 - a name


def _check_track_id(_: object, __: attrs.Attribute[Any], value: object) -> None:
    if not isinstance(value, (int, str)):
        msg = f"`track_id` must be a whole number or a string; got {quoted(value)}."
        raise TypeError(msg)


@attrs.frozen
class Detection:
    """
    One object that a detector, an annotator or a user outlined in an image.

    Coordinates are pixels of the upright image, x to the right, y down, and half-open: pixel
    ``i`` spans ``[i, i + 1)``, so a box is ``x2 - x1`` wide and ``y2 - y1`` high.

    Attributes
    ----------
    label : str
        What the object is, as the detector spells it.
    xyxy : tuple of float
        The box (x1, y1, x2, y2), in pixels, finite, x1 < x2 and y1 < y2.
    score : float
        The detector's confidence, 0 to 1. It is carried, not used by `fit`.
    mask : (H, W) ndarray of bool or None
        True on the object's pixels, in the shape of the image. Depth is then read on the mask.
    partial : bool
        True where the object is known to be cut or hidden: it is never a reference.
    track_id : int, str or None
        Identity of the physical object across images.
    aliases : tuple of str
        Further names of the object, the most telling first. Where the table of priors does not
        know the label, the first of these that it knows serves.

    Raises
    ------
    ValueError
        If the box is inverted or not finite, the score outside 0 to 1, or the mask empty inside
        its box.
    TypeError
        If the label is no string or the mask not boolean.

    Examples
    --------
    >>> from imgscale import Detection
    >>> Detection("car", (10, 20, 110, 70)).height_px
    50.0
    >>> Detection.from_xywh("car", (10, 20, 100, 50)).xyxy
    (10.0, 20.0, 110.0, 70.0)
    >>> Detection("car", (110, 20, 10, 70))
    Traceback (most recent call last):
        ...
    ValueError: `xyxy` must have x1 < x2 and y1 < y2; got (110.0, 20.0, 10.0, 70.0). Boxes given
    as x, y, width, height go through Detection.from_xywh().
    """

    label: str = attrs.field(validator=text)
    xyxy: Box = attrs.field(converter=_as_box)
    score: float = attrs.field(
        default=1.0, kw_only=True, converter=as_float, validator=_check_score
    )
    mask: BoolArray | None = attrs.field(
        default=None,
        kw_only=True,
        converter=_as_mask,
        repr=array_summary,
        eq=attrs.cmp_using(eq=np.array_equal),
        hash=False,
    )
    partial: bool = attrs.field(
        default=False, kw_only=True, converter=as_flag, validator=true_or_false
    )
    track_id: int | str | None = attrs.field(
        default=None,
        kw_only=True,
        validator=attrs.validators.optional(_check_track_id),
    )
    aliases: tuple[str, ...] = attrs.field(
        default=(),
        kw_only=True,
        converter=_as_names,
        validator=attrs.validators.deep_iterable(text),
    )

    def __attrs_post_init__(self) -> None:
        if self.mask is None:
            return
        x1, y1, x2, y2 = self.xyxy
        rows = slice(max(0, math.floor(y1)), max(0, math.ceil(y2)))
        columns = slice(max(0, math.floor(x1)), max(0, math.ceil(x2)))
        if not self.mask[rows, columns].any():
            msg = (
                f"`mask` must be True somewhere inside the box {self.xyxy}; it is empty there. "
                "Masks have the shape of the whole image."
            )
            raise ValueError(msg)

    def __setstate__(self, state: tuple[None, dict[str, Any]]) -> None:
        restore(self, state)

    @property
    def names(self) -> tuple[str, ...]:
        """The label, then the aliases."""
        return (self.label, *self.aliases)

    @property
    def width_px(self) -> float:
        """Width of the box, in pixels."""
        return self.xyxy[2] - self.xyxy[0]

    @property
    def height_px(self) -> float:
        """Height of the box, in pixels."""
        return self.xyxy[3] - self.xyxy[1]

    def with_box(self, xyxy: Sequence[float] | NDArray[Any]) -> Detection:
        """
        Put another box in the place of this one.

        Parameters
        ----------
        xyxy : (4,) sequence of float
            The new box (x1, y1, x2, y2), in pixels.

        Returns
        -------
        Detection
            The same object otherwise.

        Raises
        ------
        ValueError
            If the four numbers do not make a box, or the mask is empty in it.
        """
        return attrs.evolve(self, xyxy=xyxy)

    @classmethod
    def from_xywh(
        cls,
        label: str,
        xywh: Sequence[float] | NDArray[Any],
        *,
        score: float = 1.0,
        mask: ArrayLike | None = None,
        partial: bool = False,
        track_id: int | str | None = None,
        aliases: Iterable[str] = (),
    ) -> Detection:
        """
        Build a detection from the left upper corner, width and height (COCO's order).

        Parameters
        ----------
        label : str
            What the object is.
        xywh : (4,) sequence of float
            Left, top, width and height, in pixels; width and height positive.
        score : float
            The detector's confidence, 0 to 1.
        mask : (H, W) array_like of bool, optional
            True on the object's pixels.
        partial : bool
            True where the object is cut or hidden.
        track_id : int or str, optional
            Identity of the physical object across images.
        aliases : iterable of str
            Further names of the object, the most telling first.

        Returns
        -------
        Detection
            The detection.

        Raises
        ------
        ValueError
            If the four numbers do not make a box.
        """
        x, y, width, height = four_numbers("xywh", "four numbers (left, top, width, height)", xywh)
        if not (width > 0 and height > 0):
            msg = f"`xywh` must have a positive width and height; got {(x, y, width, height)}."
            raise ValueError(msg)
        box = (x, y, x + width, y + height)
        return cls(
            label,
            box,
            score=score,
            mask=mask,
            partial=partial,
            track_id=track_id,
            aliases=aliases,
        )

    @classmethod
    def from_min_max_rc(
        cls,
        label: str,
        bbox: Sequence[float] | NDArray[Any],
        *,
        score: float = 1.0,
        mask: ArrayLike | None = None,
        partial: bool = False,
        track_id: int | str | None = None,
        aliases: Iterable[str] = (),
    ) -> Detection:
        """
        Build a detection from rows and columns, the order of scikit-image's `regionprops`.

        Parameters
        ----------
        label : str
            What the object is.
        bbox : (4,) sequence of float
            Minimal row, minimal column, maximal row, maximal column, half-open, in pixels.
        score : float
            The detector's confidence, 0 to 1.
        mask : (H, W) array_like of bool, optional
            True on the object's pixels.
        partial : bool
            True where the object is cut or hidden.
        track_id : int or str, optional
            Identity of the physical object across images.
        aliases : iterable of str
            Further names of the object, the most telling first.

        Returns
        -------
        Detection
            The detection.

        Raises
        ------
        ValueError
            If the four numbers do not make a box.
        """
        top, left, bottom, right = four_numbers(
            "bbox", "four numbers (min_row, min_col, max_row, max_col)", bbox
        )
        box = (left, top, right, bottom)
        return cls(
            label,
            box,
            score=score,
            mask=mask,
            partial=partial,
            track_id=track_id,
            aliases=aliases,
        )

    @classmethod
    def from_ratios(
        cls,
        label: str,
        *,
        left: float,
        top: float,
        width: float,
        height: float,
        image_size: Sequence[int],
        score: float = 1.0,
        mask: ArrayLike | None = None,
        partial: bool = False,
        track_id: int | str | None = None,
        aliases: Iterable[str] = (),
    ) -> Detection:
        """
        Build a detection from ratios of the image's size, as Amazon Rekognition gives them.

        Parameters
        ----------
        label : str
            What the object is.
        left, top : float
            Left upper corner as ratios of the image's width and height.
        width, height : float
            Size of the box as ratios of the image's width and height, positive.
        image_size : (width, height)
            The image's size in pixels.
        score : float
            The detector's confidence, 0 to 1.
        mask : (H, W) array_like of bool, optional
            True on the object's pixels.
        partial : bool
            True where the object is cut or hidden.
        track_id : int or str, optional
            Identity of the physical object across images.
        aliases : iterable of str
            Further names of the object, the most telling first.

        Returns
        -------
        Detection
            The detection, in pixels.

        Raises
        ------
        ValueError
            If a number is no ratio (more than 5 % outside 0 to 1), or a size not positive.

        Examples
        --------
        >>> from imgscale import Detection
        >>> car = Detection.from_ratios("car", left=0.5, top=0.5, width=0.1, height=0.1181,
        ...                             image_size=(1242, 375))
        >>> round(car.height_px, 6)
        44.2875
        """
        ratios = {"left": left, "top": top, "width": width, "height": height}
        for name, value in ratios.items():
            number = as_float(value)
            if not is_between(number, -0.05, 1.05):
                remedy = "Boxes in pixels go through Detection() or Detection.from_xywh()."
                raise number_error(name, "a ratio between 0 and 1", number, remedy)
        size = as_known_image_size(image_size)
        xywh = (
            float(left) * size[0],
            float(top) * size[1],
            float(width) * size[0],
            float(height) * size[1],
        )
        return cls.from_xywh(
            label,
            xywh,
            score=score,
            mask=mask,
            partial=partial,
            track_id=track_id,
            aliases=aliases,
        )


def check_detections(value: Iterable[object]) -> tuple[Detection, ...]:
    """
    Raise unless a value is a sequence of `Detection`.

    Parameters
    ----------
    value : iterable
        What was given as detections.

    Returns
    -------
    tuple of Detection
        The same.

    Raises
    ------
    TypeError
        If it is no sequence, or an item is something else.
    """
    check_iterable("detections", value, "Detection")
    known: list[Detection] = []
    for index, item in enumerate(value):
        if not isinstance(item, Detection):
            msg = f"`detections` must hold Detection objects; got {item!r} at index {index}."
            raise TypeError(msg)
        known.append(item)
    return tuple(known)
