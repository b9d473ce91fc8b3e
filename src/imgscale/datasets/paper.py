"""
The tables of Singh and Shrivastava (2023), as printed.

"Determining Image Scale in Real-World Units Using Natural Objects Present in Image", EasyChair
preprint, January 2023, on images of KITTI Scene Flow 2015 (1242 x 375 pixels). Lengths are
centimetres there; the unit of the depths is not stated. Table 3.2 is `PriorTable.paper`.
"""

from __future__ import annotations

from collections.abc import Mapping

import attrs

from imgscale._tables import shipped_table
from imgscale.depth import ObjectDepths
from imgscale.detection import Detection
from imgscale.frame import Frame
from imgscale.object_prior import ObjectPrior
from imgscale.priors import PriorTable

__all__ = [
    "IMAGE_SIZE",
    "PUBLISHED",
    "HeightRow",
    "ImageSummary",
    "ScaleRow",
    "actual_heights",
    "figure_3_12",
    "figure_3_14",
    "frame",
]

IMAGE_SIZE = (1242, 375)


@attrs.frozen
class HeightRow:
    """
    One object of figures 3.12 (pixel heights) and 3.13 (height per pixel).

    Attributes
    ----------
    image : str
        Name of the image.
    object : str
        Name of the object in it, "Car 1".
    label : str
        Its class in Table 3.2.
    height_ratio : float
        Height of its box over the image's height.
    pixels_px : float
        Height of its box in pixels.
    hpp_cm_per_px : float
        Mean height of its class over pixels, in cm/px; the paper cuts off
        after four decimals, once after three.
    """

    image: str
    object: str
    label: str
    height_ratio: float = attrs.field(converter=float)
    pixels_px: float = attrs.field(converter=float)
    hpp_cm_per_px: float = attrs.field(converter=float)


@attrs.frozen
class ScaleRow:
    """
    One object of figures 3.14 to 3.16 and 3.19 (k, depth, pixel and predicted height).

    Attributes
    ----------
    image : str
        Name of the image.
    object : str
        Name of the object in it, "Car 1".
    label : str
        Its class in Table 3.2.
    actual_cm : float
        Its height as the paper takes it, in cm.
    depth : float
        Its depth, in the paper's unit.
    pixels_px : float
        Its pixel height in figure 3.16, which is not that of figure 3.12.
    k : float
        Its own k, cm per pixel and unit of depth, as printed.
    predicted_cm : float
        Its predicted height in cm, as printed.
    """

    image: str
    object: str
    label: str
    actual_cm: float = attrs.field(converter=float)
    depth: float = attrs.field(converter=float)
    pixels_px: float = attrs.field(converter=float)
    k: float = attrs.field(converter=float)
    predicted_cm: float = attrs.field(converter=float)


@attrs.frozen
class ImageSummary:
    """
    What figures 3.14, 3.17 and 3.18 print for one image.

    Attributes
    ----------
    k_mean : float
        Mean of the objects' k, as printed; it is not the mean of the printed k's.
    mean_depth : float
        Mean depth of the objects, in the paper's unit.
    mse_cm2 : float
        Mean squared error in cm^2, as printed.
    """

    k_mean: float
    mean_depth: float
    mse_cm2: float


PUBLISHED: Mapping[str, ImageSummary] = {
    "000003_10": ImageSummary(k_mean=0.026966, mean_depth=363.5, mse_cm2=0.0),
    "000003_11": ImageSummary(k_mean=0.005826, mean_depth=476.2857143, mse_cm2=0.0),
}


def figure_3_12() -> tuple[HeightRow, ...]:
    """
    Load figures 3.12 and 3.13: 23 objects in four images.

    Returns
    -------
    tuple of HeightRow
        The rows, in the order of print.

    Examples
    --------
    >>> from imgscale.datasets import paper
    >>> paper.figure_3_12()[0].pixels_px
    44.2875
    """
    return tuple(HeightRow(**row) for row in _read("paper_fig_3_12.csv"))


def figure_3_14() -> tuple[ScaleRow, ...]:
    """
    Load figures 3.14 to 3.16 and 3.19: 15 objects in two images.

    Returns
    -------
    tuple of ScaleRow
        The rows, in the order of print.

    Examples
    --------
    >>> from imgscale.datasets import paper
    >>> len(paper.figure_3_14())
    15
    """
    return tuple(ScaleRow(**row) for row in _read("paper_fig_3_14.csv"))


def frame(image: str) -> Frame:
    """
    Give one image of figure 3.14 as detections with depths.

    Parameters
    ----------
    image : str
        "000003_10" or "000003_11".

    Returns
    -------
    Frame
        One detection per object, labelled by its name. The figure prints heights only: boxes are
        squares at the origin.

    Raises
    ------
    ValueError
        If the figure has no such image.

    Examples
    --------
    >>> import imgscale as ims
    >>> from imgscale.datasets import paper
    >>> image, sizes = paper.frame("000003_10"), paper.actual_heights("000003_10")
    >>> model = ims.fit(image.detections, image.depth, sizes, method="mean_ratio")
    >>> round(model.mse_m2 * 1e4, 2)  # cm^2, where the paper prints 0
    5734.2
    """
    rows = _rows_of(image)
    return Frame(
        [Detection(row.object, (0, 0, row.pixels_px, row.pixels_px)) for row in rows],
        ObjectDepths([row.depth for row in rows], kind="relative"),
        name=image,
    )


def actual_heights(image: str) -> PriorTable:
    """
    Give the heights that figure 3.14 takes for the objects of one image.

    Parameters
    ----------
    image : str
        "000003_10" or "000003_11".

    Returns
    -------
    PriorTable
        One exact height per object, labelled by its name, in metres.

    Raises
    ------
    ValueError
        If the figure has no such image.
    """
    return PriorTable(
        [
            ObjectPrior(row.object, row.actual_cm / 100, 0.0, source="figure 3.14")
            for row in _rows_of(image)
        ]
    )


def _rows_of(image: str) -> list[ScaleRow]:
    rows = [row for row in figure_3_14() if row.image == image]
    if not rows:
        known = ", ".join(PUBLISHED)
        msg = f"`image` must be one of {known}; got {image!r}."
        raise ValueError(msg)
    return rows


def _read(name: str) -> list[dict[str, str]]:
    return [record for _, record in shipped_table(name).records]
