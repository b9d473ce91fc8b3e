"""What one would write for many images without the library, packages of one's choice at hand."""

from __future__ import annotations

import importlib.util

import numpy as np
from numpy.typing import NDArray
from speed_columns import LABELS, NOISE, Columns, Sizes

import imgscale as ims

_SPREAD = 0.1


def has(package: str) -> bool:
    """Tell whether a package is installed."""
    return importlib.util.find_spec(package) is not None


def pandas_least_squares(columns: Columns, prior: Sizes) -> NDArray[np.float64]:
    """Least squares of H on d p: two sums per image."""
    import pandas as pd  # noqa: PLC0415 - a peer that may be missing

    x = columns.depth * columns.pixels
    products = {"xy": x * prior.mean_m[columns.label], "xx": x * x}
    frame = pd.DataFrame({"image": columns.image_id, **products})
    sums = frame.groupby("image", sort=False).agg("sum")
    k: NDArray[np.float64] = (sums["xy"] / sums["xx"]).to_numpy()
    return k


def pandas_mean_ratio(columns: Columns, prior: Sizes) -> NDArray[np.float64]:
    """Mean of the objects' own k."""
    import pandas as pd  # noqa: PLC0415 - a peer that may be missing

    own_k = prior.mean_m[columns.label] / (columns.depth * columns.pixels)
    frame = pd.DataFrame({"image": columns.image_id, "k": own_k})
    k: NDArray[np.float64] = frame.groupby("image", sort=False)["k"].agg("mean").to_numpy()
    return k


def pandas_sizes(columns: Columns, prior: Sizes) -> NDArray[np.float64]:
    """Least squares, and then every object's size, k d p, without an interval."""
    import pandas as pd  # noqa: PLC0415 - a peer that may be missing

    x = columns.depth * columns.pixels
    products = {"xy": x * prior.mean_m[columns.label], "xx": x * x}
    frame = pd.DataFrame({"image": columns.image_id, **products})
    sums = frame.groupby("image", sort=False).agg("sum")
    size_m: NDArray[np.float64] = frame["image"].map(sums["xy"] / sums["xx"]).to_numpy() * x
    return size_m


def polars_least_squares(columns: Columns, prior: Sizes) -> NDArray[np.float64]:
    """Least squares of H on d p: two sums per image."""
    import polars as pl  # noqa: PLC0415 - a peer that may be missing

    x = columns.depth * columns.pixels
    products = {"xy": x * prior.mean_m[columns.label], "xx": x * x}
    frame = pl.DataFrame({"image": columns.image_id, **products})
    k = pl.col("xy").sum() / pl.col("xx").sum()
    return frame.group_by("image").agg(k.alias("k"))["k"].to_numpy()


def pandas_apply(columns: Columns, prior: Sizes) -> NDArray[np.float64]:
    """One call of scipy's least squares with Huber's loss for every image."""
    import pandas as pd  # noqa: PLC0415 - a peer that may be missing
    from scipy.optimize import least_squares  # noqa: PLC0415 - half a second of import

    log_k = prior.log_mean[columns.label] - np.log(columns.depth * columns.pixels)
    frame = pd.DataFrame({"image": columns.image_id, "log_k": log_k})

    def of_image(own: pd.Series[float]) -> float:
        own_log_k = own.to_numpy()
        start = [np.median(own_log_k)]
        found = least_squares(lambda x: (x[0] - own_log_k) / _SPREAD, start, loss="huber")
        return float(np.exp(found.x[0]))

    k: NDArray[np.float64] = frame.groupby("image", sort=False)["log_k"].apply(of_image).to_numpy()
    return k


def one_by_one(columns: Columns, priors: ims.PriorTable) -> list[list[ims.SizeEstimate]]:
    """Call `fit` and `predict` for every image."""
    places = np.split(
        np.arange(columns.image_id.size), np.flatnonzero(np.diff(columns.image_id)) + 1
    )
    answers: list[list[ims.SizeEstimate]] = []
    for rows in places:
        detections = [
            ims.Detection(
                LABELS[columns.label[row]], (0, 0, columns.pixels[row], columns.pixels[row])
            )
            for row in rows
        ]
        depth = ims.ObjectDepths(columns.depth[rows], kind="metric")
        model = ims.fit(detections, depth, priors, method="robust", noise=NOISE)
        answers.append(ims.predict(model, detections, depth))
    return answers
