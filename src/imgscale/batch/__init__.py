"""
Millions of images: what `fit` and `predict` say, for columns, data frames and Arrow tables.

`fit_columns` takes numpy columns with an object per row, `fit_table` the same as a frame of pandas,
polars or pyarrow, `fit_arrow` an Arrow table with an image per row, a function for Ray, Spark and
Dask to map. All take what detector and depth source gave before: of each object its extent in
pixels and its depth.
"""

from __future__ import annotations

from imgscale.batch.arrow import fit_arrow
from imgscale.batch.columns import REASONS, BatchResult, ImageColumns, RowColumns, fit_columns
from imgscale.batch.frames import fit_table

__all__ = [
    "REASONS",
    "BatchResult",
    "ImageColumns",
    "RowColumns",
    "fit_arrow",
    "fit_columns",
    "fit_table",
]
