"""Names of the array and literal types that the signatures use."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

AnyFloatArray: TypeAlias = NDArray[np.floating[Any]]
FloatArray: TypeAlias = NDArray[np.float64]
BoolArray: TypeAlias = NDArray[np.bool_]
IntArray: TypeAlias = NDArray[np.intp]
ImageArray: TypeAlias = NDArray[np.uint8]

Box: TypeAlias = tuple[float, float, float, float]
ImageSize: TypeAlias = tuple[int, int]
DepthKind: TypeAlias = Literal["metric", "relative", "inverse", "affine_inverse", "ground_plane"]
SizeAxis: TypeAlias = Literal["height", "width", "diameter"]
FitMethod: TypeAlias = Literal["mean_ratio", "least_squares", "robust", "posterior"]
Region: TypeAlias = Literal["world", "eu", "us"]
