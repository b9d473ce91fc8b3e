"""How big is the thing in this photo? Sizes from known objects and any depth, with an interval."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imgscale.camera import Camera
from imgscale.depth import Depth, DepthMap, GroundPlane, ObjectDepths
from imgscale.detection import Detection
from imgscale.errors import DepthMismatchError, FitError, ImgscaleError, MissingDependencyError
from imgscale.estimate import SizeEstimate
from imgscale.explaining import Explanation, explain
from imgscale.fitted_plane import FittedPlane
from imgscale.fitting import fit
from imgscale.flags import Flag
from imgscale.frame import Frame
from imgscale.many import Outcome, measure_many
from imgscale.measurement import Measurement
from imgscale.model import ScaleModel
from imgscale.noise import Noise
from imgscale.object_prior import ObjectPrior
from imgscale.pipeline import measure
from imgscale.prediction import predict
from imgscale.priors import PriorTable
from imgscale.protocols import DepthSource, Detector
from imgscale.record import read_record
from imgscale.reference import Reference
from imgscale.shared_scale import SharedScale
from imgscale.sharing import fit_shared
from imgscale.suspicion import Suspicion, suspect
from imgscale.validation import leave_one_out

__all__ = [
    "Camera",
    "Depth",
    "DepthMap",
    "DepthMismatchError",
    "DepthSource",
    "Detection",
    "Detector",
    "Explanation",
    "FitError",
    "FittedPlane",
    "Flag",
    "Frame",
    "GroundPlane",
    "ImgscaleError",
    "Measurement",
    "MissingDependencyError",
    "Noise",
    "ObjectDepths",
    "ObjectPrior",
    "Outcome",
    "PriorTable",
    "Reference",
    "ScaleModel",
    "SharedScale",
    "SizeEstimate",
    "Suspicion",
    "explain",
    "fit",
    "fit_shared",
    "leave_one_out",
    "measure",
    "measure_many",
    "predict",
    "read_record",
    "suspect",
]


__version__: str

if not TYPE_CHECKING:  # for a type checker every misspelt name would be there

    def __getattr__(name: str) -> str:
        if name == "__version__":
            from importlib.metadata import version  # noqa: PLC0415 - 50 ms that few need

            return version("imgscale")
        msg = f"module 'imgscale' has no attribute {name!r}"
        raise AttributeError(msg)


del TYPE_CHECKING
