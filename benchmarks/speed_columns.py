"""Draw the references of many images: 2 to 30 in each, 8 on average, some of them wrong."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import imgscale as ims
from imgscale.prior_choice import log_moments, moments_of, rows_along

LABELS = ("car", "person", "truck", "bus", "bicycle", "chair")
DEPTH_REL = 0.06
NOISE = ims.Noise(box_px=2.0, depth_rel=DEPTH_REL)
_SEED = 20261123
_FEWEST, _MOST, _MEAN = 2, 30, 8
_WRONG = 0.1
# Images that are drawn at once: temporary arrays stay small beside the columns.
_BLOCK = 500_000


class Columns(NamedTuple):
    """
    References of many images.

    Attributes
    ----------
    image_id : (N,) ndarray of int64
        Which image each belongs to.
    label : (N,) ndarray of int16
        Place of its label in `LABELS`.
    pixels, depth : (N,) ndarray of float64
        Its height, and its metric depth.
    """

    image_id: NDArray[np.int64]
    label: NDArray[np.int16]
    pixels: NDArray[np.float64]
    depth: NDArray[np.float64]

    @property
    def nbytes(self) -> int:
        """Memory that the columns take."""
        return sum(column.nbytes for column in self)

    def rows(self, rows: NDArray[np.intp] | slice) -> Columns:
        """Take some rows."""
        return Columns(*(column[rows] for column in self))


class Sizes(NamedTuple):
    """Prior of each label's height: its mean, and log mean, log variance, offset of the log."""

    mean_m: NDArray[np.float64]
    log_mean: NDArray[np.float64]
    log_var: NDArray[np.float64]
    tau: NDArray[np.float64]


def sizes() -> Sizes:
    """Look the labels up in the default table."""
    priors = ims.PriorTable.default()
    choices = [moments_of(rows_along(label, "height", priors), "height") for label in LABELS]
    mean, std, mean_std = (
        np.array(column)
        for column in zip(*((c.mean_m, c.std_m, c.mean_std_m) for c in choices), strict=True)
    )
    return Sizes(mean, *log_moments(mean, std), mean_std / mean)


def draw(n_images: int, per_image: int | None = None) -> Columns:
    """
    Draw images.

    Parameters
    ----------
    n_images : int
        How many.
    per_image : int, optional
        References in each; 2 to 30, 8 on average, where omitted.

    Returns
    -------
    Columns
        Image by image; one reference in ten is wrong by half its size or so.
    """
    rng = np.random.default_rng(_SEED)
    blocks = [
        _block(rng, start, min(_BLOCK, n_images - start), per_image)
        for start in range(0, n_images, _BLOCK)
    ]
    columns: list[NDArray[np.generic]] = []
    for place in range(len(Columns._fields)):
        columns.append(np.concatenate([block[place] for block in blocks]))
        blocks = [(*block[:place], None, *block[place + 1 :]) for block in blocks]  # let go of it
    return Columns(*columns)  # type: ignore[arg-type]


def shuffled(columns: Columns) -> Columns:
    """Bring the rows out of order."""
    return columns.rows(np.random.default_rng(_SEED).permutation(columns.image_id.size))


def _block(
    rng: np.random.Generator, start: int, n_images: int, per_image: int | None
) -> tuple[NDArray[np.generic] | None, ...]:
    if per_image is None:
        more = rng.geometric(1 / (1 + _MEAN - _FEWEST), n_images) - 1
        counts = np.minimum(_FEWEST + more, _MOST)
    else:
        counts = np.full(n_images, per_image)
    image = np.repeat(np.arange(n_images), counts)
    label = rng.integers(0, len(LABELS), image.size, dtype=np.int16)
    prior = sizes()
    depth = rng.uniform(4.0, 40.0, image.size)
    log_size = prior.log_mean[label] + np.sqrt(prior.log_var[label]) * rng.standard_normal(
        image.size
    )
    log_size += np.where(rng.random(image.size) < _WRONG, 0.5, 0.0) * rng.standard_normal(
        image.size
    )
    focal_px = 720.0 * np.exp(0.1 * rng.standard_normal(n_images))
    pixels = focal_px[image] * np.exp(log_size) / depth + rng.standard_normal(image.size)
    depth *= np.exp(DEPTH_REL * rng.standard_normal(image.size))
    return image + start, label, np.maximum(pixels, 4.0), depth
