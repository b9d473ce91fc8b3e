"""The verb `regionprops_table`: the regions of a label image in real units."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from imgscale._checks import check_choice, check_iterable
from imgscale._format import PER_METRE
from imgscale._typing import ImageSize
from imgscale.depth import Depth, ObjectDepths
from imgscale.estimate import central_scores
from imgscale.flags import flag_names
from imgscale.lookup import look_up, solved
from imgscale.measuring._given import given_array
from imgscale.measuring.extents import extent_of, region_of_pixels
from imgscale.model import ScaleModel
from imgscale.quantity import Extent, Quantity

__all__ = ["regionprops_table"]


def regionprops_table(
    model: ScaleModel,
    label_image: ArrayLike,
    depth: Depth | None = None,
    *,
    properties: Sequence[str] = ("label", "bbox", "centroid"),
    unit: str = "m",
    level: float = 0.9,
    same_scale: bool = False,
) -> dict[str, NDArray[Any]]:
    """
    Tabulate the regions of a label image in real units, beside scikit-image's own properties.

    Parameters
    ----------
    model : ScaleModel
        The scale of the image.
    label_image : (H, W) array_like of int
        0 for the background, another number for each region, in the shape of the image.
    depth : DepthMap, ObjectDepths or GroundPlane, optional
        As for `extent`; `ObjectDepths` hold one value per region, in the order of their labels.
    properties : sequence of str
        Properties in pixels, as `skimage.measure.regionprops_table` names and computes them.
    unit : str
        Unit of the sizes: "m", "cm", "mm", "in" or "ft"; areas are in its square.
    level : float
        Probability that each interval holds its quantity, above 0 and below 1.
    same_scale : bool
        Vouch that another map than the fitted one has the same scale.

    Returns
    -------
    dict of str to (R,) ndarray
        One entry for each of R regions, in the order of their labels, ready for a data frame:
        the columns of `properties`; ``height_<unit>``, ``height_low_<unit>`` and
        ``height_high_<unit>``, likewise for width, longest and area (``area_<unit>2``);
        ``metres_per_pixel``; ``distance_m``, the z-depth; ``flags``, words with spaces between.
        NaN where a number is not known.

    Raises
    ------
    ValueError
        If the label image is not of the image's shape, a property or the unit is unknown, or
        `depth` is missing.
    TypeError
        If an argument is of the wrong type.
    DepthMismatchError
        As for `extent`.

    Examples
    --------
    >>> import numpy as np
    >>> import imgscale as ims
    >>> from imgscale.measuring import regionprops_table
    >>> depth = ims.DepthMap(np.full((480, 640), 4.0), kind="relative")
    >>> door = ims.Detection("door", (100, 50, 180, 250))
    >>> table = ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.02)])
    >>> model = ims.fit([door], depth, table, noise=ims.Noise(depth_rel=0.01))
    >>> labels = np.zeros((480, 640), dtype=int)
    >>> labels[100:150, 300:320], labels[300:400, 50:90] = 1, 2
    >>> regions = regionprops_table(model, labels, depth, unit="cm")
    >>> regions["height_cm"].round(1).tolist()
    [50.0, 100.0]
    """
    import skimage as ski  # noqa: PLC0415 - loads its parts on use

    check_choice("unit", unit, tuple(PER_METRE))
    central_scores(level)  # without regions nobody else would look at it
    lookup = look_up(model, depth, same_scale=same_scale)
    lookup.check_plane()
    labels = _labels(label_image, lookup.depth.image_size)
    measure: Any = ski.measure  # untyped there
    numbers, labels = _compact(labels)
    props = measure.regionprops(labels)
    table: dict[str, NDArray[Any]] = _pixel_columns(measure, labels, properties)
    if "label" in table:
        table["label"] = numbers
    solutions = solved(model)
    depths = _one_by_one(lookup.depth, len(props))
    found = [
        extent_of(lookup, solutions, region_of_pixels(part, labels.shape), own)
        for part, own in zip(props, depths, strict=True)
    ]
    return table | _metre_columns(found, unit, level)


def _labels(value: ArrayLike, size: ImageSize | None) -> NDArray[Any]:
    """Check a label image."""
    array = given_array("label_image", "an array of shape (H, W)", value)
    if array.dtype.kind not in "iu":
        msg = (
            f"`label_image` must hold integers, 0 for the background; got dtype {array.dtype}. "
            "Label a mask first: skimage.measure.label(mask)."
        )
        raise TypeError(msg)
    if array.ndim != 2 or (size and array.shape != size[::-1]):
        shape = size[::-1] if size else "(H, W)"
        msg = f"`label_image` must have the shape of the image, {shape}; got {array.shape}."
        raise ValueError(msg)
    if array.size and array.min() < 0:
        msg = f"`label_image` must hold no negative label; got {array.min()}."
        raise ValueError(msg)
    return array


def _compact(labels: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Give regions small numbers: scikit-image takes memory for all up to the largest."""
    numbers, places = np.unique(labels, return_inverse=True)
    has_background = bool((numbers == 0).any())
    compact = places.reshape(labels.shape) + (0 if has_background else 1)
    return numbers[numbers > 0], compact.astype(np.intp)


def _pixel_columns(
    measure: Any, labels: NDArray[Any], properties: Sequence[str]
) -> dict[str, NDArray[Any]]:
    """Ask scikit-image for properties in pixels."""
    check_iterable("properties", properties, "str")
    if isinstance(properties, str):
        msg = f"`properties` must be a sequence of names; got {properties!r}. Put one in a list."
        raise TypeError(msg)
    try:
        return dict(measure.regionprops_table(labels, properties=tuple(properties)))
    except (AttributeError, KeyError, TypeError) as error:
        msg = (
            "`properties` must name properties of skimage.measure.regionprops that need no "
            f"intensity image; got {list(properties)}."
        )
        raise ValueError(msg) from error


def _one_by_one(depth: Depth, count: int) -> list[Depth]:
    """Give each region its depth."""
    if not isinstance(depth, ObjectDepths):
        return [depth] * count
    if len(depth) != count:
        msg = f"`depth` must hold one value per region, {count}; got {len(depth)}."
        raise ValueError(msg)
    return [attrs.evolve(depth, values=depth.values[row : row + 1]) for row in range(count)]


def _metre_columns(found: Sequence[Extent], unit: str, level: float) -> dict[str, NDArray[Any]]:
    """Columns of what was measured."""
    columns: dict[str, list[Any]] = {}
    dimensions = {"height": 1, "width": 1, "longest": 1, "area": 2}
    for name, power in dimensions.items():
        quantities: list[Quantity] = [getattr(item, name) for item in found]
        ends = [quantity.interval(level) for quantity in quantities]
        suffix = unit if power == 1 else f"{unit}2"
        per_metre = PER_METRE[unit] ** power
        columns[f"{name}_{suffix}"] = [quantity.value * per_metre for quantity in quantities]
        columns[f"{name}_low_{suffix}"] = [low * per_metre for low, _ in ends]
        columns[f"{name}_high_{suffix}"] = [high * per_metre for _, high in ends]
    columns["metres_per_pixel"] = [item.metres_per_pixel for item in found]
    columns["distance_m"] = [
        math.nan if item.distance_m is None else item.distance_m for item in found
    ]
    table: dict[str, NDArray[Any]] = {
        name: np.array(column, dtype=np.float64) for name, column in columns.items()
    }
    words = [" ".join(flag_names(item.flags)) for item in found]
    return table | {"flags": np.array(words, dtype=np.str_)}
