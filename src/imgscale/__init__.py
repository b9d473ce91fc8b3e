"""How big is the thing in this photo? Sizes from known objects and any depth, with an interval."""

from __future__ import annotations

from importlib import import_module as _import_module
from typing import TYPE_CHECKING

from imgscale.camera import Camera
from imgscale.depth import Depth, DepthMap, GroundPlane, ObjectDepths
from imgscale.detection import Detection
from imgscale.errors import (
    DepthMismatchError,
    FileError,
    FitError,
    ImgscaleError,
    MissingDependencyError,
)
from imgscale.object_prior import ObjectPrior
from imgscale.priors import PriorTable

if TYPE_CHECKING:
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
    from imgscale.pipeline import measure
    from imgscale.prediction import predict
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
    "FileError",
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

# What every user builds is loaded with the package, the rest when it is first asked for (PEP 562):
# a fit does not wait for what explains it. Type checkers read the imports above instead.
_HOMES = {
    "DepthSource": "protocols",
    "Detector": "protocols",
    "Explanation": "explaining",
    "FittedPlane": "fitted_plane",
    "Flag": "flags",
    "Frame": "frame",
    "Measurement": "measurement",
    "Noise": "noise",
    "Outcome": "many",
    "Reference": "reference",
    "ScaleModel": "model",
    "SharedScale": "shared_scale",
    "SizeEstimate": "estimate",
    "Suspicion": "suspicion",
    "explain": "explaining",
    "fit": "fitting",
    "fit_shared": "sharing",
    "leave_one_out": "validation",
    "measure": "pipeline",
    "measure_many": "many",
    "predict": "prediction",
    "read_record": "record",
    "suspect": "suspicion",
}

if not TYPE_CHECKING:  # for a type checker every misspelt name would be there

    def __getattr__(name: str) -> object:
        if name in _HOMES:
            value = getattr(_import_module(f"imgscale.{_HOMES[name]}"), name)
        elif name == "__version__":
            value = _import_module("importlib.metadata").version("imgscale")
        else:
            msg = f"module 'imgscale' has no attribute {name!r}"
            raise AttributeError(msg)
        globals()[name] = value  # the next look-up finds it without this function
        return value

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__, "__version__"})


del TYPE_CHECKING
