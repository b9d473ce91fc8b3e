"""
A slab: as many images of a batch as are worked on at once, and where their results go.

Slabs bound the memory that is needed beside input and output.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from imgscale._typing import BoolArray, FloatArray, ImageSize, IntArray
from imgscale.batch._labels import Labels
from imgscale.flags import Flag
from imgscale.laws import Law
from imgscale.noise import Noise

# Codes into `imgscale.batch.REASONS`.
NO_PRIOR, PARTIAL, NO_DEPTH, OUTLIER, ONE_DEPTH = range(1, 6)


CodeArray: TypeAlias = NDArray[np.int8]
WholeArray: TypeAlias = NDArray[np.signedinteger[Any]]


class Options(NamedTuple):
    """
    What holds for all images of a batch.

    Attributes
    ----------
    law : Law
        Of the kind of depth.
    labels : Labels
        The priors.
    noise : Noise
        Errors of boxes and depths.
    depth_var : float
        Variance of the log depths, as far as it was told.
    unknown_noise : bool
        True where nobody told the noise of the depths.
    method : str
        The estimator.
    image_size : (width, height) or None
        Size of all images in pixels.
    score : float
        Standard score of the upper end of the intervals.
    """

    law: Law
    labels: Labels
    noise: Noise
    depth_var: float
    unknown_noise: bool
    method: str
    image_size: ImageSize | None
    score: float


class Slab(NamedTuple):
    """
    The objects of M images, image by image.

    Attributes
    ----------
    code : (N,) ndarray of int
        Code of each label.
    pixels, depth : (N,) ndarray of float
        Extent and depth, checked; NaN depths are unknown.
    partial : (N,) ndarray of bool or None
        Objects that are cut or hidden.
    first, counts : (M,) ndarray of int
        First object of each image, and how many it has.
    """

    code: IntArray
    pixels: FloatArray
    depth: FloatArray
    partial: BoolArray | None
    first: IntArray
    counts: IntArray

    def reasons(self, labels: Labels) -> CodeArray:
        """
        Tell why objects cannot be references.

        Parameters
        ----------
        labels : Labels
            The priors.

        Returns
        -------
        (N,) ndarray of int8
            Codes, 0 where they can.
        """
        reason: CodeArray = np.zeros(self.code.size, dtype=np.int8)
        reason[np.isnan(self.depth)] = NO_DEPTH
        if self.partial is not None:
            reason[self.partial] = PARTIAL
        unknown = labels.group < 0
        if unknown[:-1].any() or (self.code.size and int(self.code.min()) < 0):
            reason[unknown[self.code]] = NO_PRIOR
        return reason


class ImageResults(NamedTuple):
    """
    Where the results of M images go; the fields are those of `ImageColumns`.

    Attributes
    ----------
    k, k_std, shift : (M,) ndarray of float64
        The model.
    flags : (M,) ndarray of int32
        Its reservations.
    n_candidates, n_used : (M,) ndarray of int32
        Counts.
    """

    k: FloatArray
    k_std: FloatArray
    shift: FloatArray
    flags: WholeArray
    n_candidates: WholeArray
    n_used: WholeArray

    def part(self, images: slice) -> ImageResults:
        """
        Take some images, so that what is written to them is written here.

        Parameters
        ----------
        images : slice
            Which.

        Returns
        -------
        ImageResults
            Views.
        """
        columns: list[Any] = [column[images] for column in self]
        return ImageResults(*columns)


class RowResults(NamedTuple):
    """
    Where the results of N objects go; the fields are those of `RowColumns`.

    Attributes
    ----------
    size_m, std_m, low_m, high_m, weight : (N,) ndarray of float64
        Sizes and shares in k.
    reason : (N,) ndarray of int8
        Why an object was not used.
    flags : (N,) ndarray of int32
        Reservations.
    """

    size_m: FloatArray
    std_m: FloatArray
    low_m: FloatArray
    high_m: FloatArray
    weight: FloatArray
    reason: CodeArray
    flags: WholeArray

    def part(self, rows: slice) -> RowResults:
        """
        Take some objects, so that what is written to them is written here.

        Parameters
        ----------
        rows : slice
            Which.

        Returns
        -------
        RowResults
            Views.
        """
        columns: list[Any] = [column[rows] for column in self]
        return RowResults(*columns)

    def put(self, rows: IntArray, log_size: FloatArray, var: FloatArray, score: float) -> None:
        """
        Write sizes whose logarithms are normal.

        Parameters
        ----------
        rows : ndarray of int
            Of which objects.
        log_size, var : ndarray of float64
            Means and variances of the logs, of the same shape.
        score : float
            Standard score of the upper end.
        """
        std = np.sqrt(var)
        size, factor = np.exp(log_size), np.exp(score * std)
        self.size_m[rows] = size
        self.std_m[rows] = size * std
        self.low_m[rows] = size / factor
        self.high_m[rows] = size * factor


def log_extent(slab: Slab, rows: IntArray, law: Law) -> tuple[FloatArray, FloatArray]:
    """
    Compute the log of d p, the size for k = 1.

    Parameters
    ----------
    slab : Slab
        The objects.
    rows : ndarray of int
        Which.
    law : Law
        Of the kind of depth, one without a shift.

    Returns
    -------
    log_size : ndarray of float64
        Of the rows' shape; NaN without a depth.
    pixels : ndarray of float64
        Their extents.
    """
    pixels = slab.pixels[rows]
    depth = np.log(slab.depth[rows])
    log_pixels = np.log(pixels)
    return (log_pixels - depth if law.inverse else log_pixels + depth), pixels


def noise_var(pixels: FloatArray, options: Options) -> FloatArray:
    """
    Compute the variance of log(d p), as far as it was told.

    Parameters
    ----------
    pixels : ndarray of float
        Extents in pixels.
    options : Options
        The errors.

    Returns
    -------
    ndarray of float64
        Of the same shape.
    """
    noise = options.noise
    result: FloatArray = (noise.box_px / pixels) ** 2 + (noise.box_rel**2 + options.depth_var)
    return result


def image_flags(
    results: ImageResults, images: IntArray, n_used: WholeArray, *,
    single_label: BoolArray, disagree: BoolArray,
) -> None:  # fmt: skip
    """
    Write the reservations of models, but for the implied focal length.

    Parameters
    ----------
    results : ImageResults
        Where they go.
    images : (m,) ndarray of int
        Of which images.
    n_used : (m,) ndarray of int
        References used.
    single_label : (m,) ndarray of bool
        True where these are all of one label.
    disagree : (m,) ndarray of bool
        True where references disagree by much more than their errors.
    """
    candidates = results.n_candidates[images]
    results.n_used[images] = n_used
    results.flags[images] = (
        (n_used == 1) * Flag.SINGLE_REFERENCE.value
        + ((n_used > 1) & single_label) * Flag.SINGLE_LABEL.value
        + (n_used < candidates) * Flag.OUTLIERS.value
        + disagree * Flag.INCONSISTENT.value
    )
