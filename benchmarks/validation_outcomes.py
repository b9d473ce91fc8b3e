"""What the library answered, object by object, beside the truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from validation_priors import class_mean
from validation_protocols import Answer, Setting
from validation_scenes import FloatArray
from validation_views import View

import imgscale as ims

LEVELS = (0.5, 0.9, 0.95)
# What protocol "k" says of the ground plane goes by these labels.
CAMERA_HEIGHT = "camera height"
HORIZON = "horizon"


class Outcome(NamedTuple):
    """One answer beside the truth; relative errors, NaN where there is no such answer."""

    scene: int
    thing: int
    drive: str
    label: str
    references: int
    error: float
    """Relative; in log for a focal length or a camera's height, in pixels for a horizon."""
    covered: tuple[bool, ...]
    """By the intervals of each level."""
    class_error: float = math.nan
    """Of the mean of its class."""
    focal_error: float = math.nan
    """Of its pixels and depth with the true focal length."""


class Part(NamedTuple):
    """What came of a part of a run."""

    outcomes: list[Outcome]
    refused_images: int = 0
    refused: int = 0


class Outcomes(NamedTuple):
    """All answers of one run, in columns, and how many there are not."""

    key: NDArray[np.int64]
    """Scene and object: names the object in every run."""
    drive: NDArray[np.str_]
    label: NDArray[np.str_]
    references: NDArray[np.int64]
    error: FloatArray
    covered: NDArray[np.bool_]
    class_error: FloatArray
    focal_error: FloatArray
    refused_images: int
    """Images that the library declined to fit."""
    refused: int
    """Objects in them."""
    unanswered: int
    """Objects in the other images without a depth or a size."""


def size_outcome(number: int, view: View, answer: Answer, setting: Setting) -> Outcome:
    """Compare a height with the true one."""
    thing, true = answer.thing, answer.thing.height_m
    known = view.run.protocol == "L"
    mean = class_mean(setting.priors, thing.label) if known else math.nan
    focal = math.nan
    if view.run.kind == "metric":
        focal = thing.pixels * answer.depth / view.scene.focal_px
    intervals = [answer.estimate.interval(level) for level in LEVELS]
    return Outcome(
        scene=number,
        thing=thing.index,
        drive=view.scene.drive,
        label=thing.label,
        references=answer.references,
        error=answer.estimate.size_m / true - 1,
        covered=tuple(low <= true <= high for low, high in intervals),
        class_error=mean / true - 1,
        focal_error=focal / true - 1,
    )


def scale_outcomes(
    number: int, view: View, model: ims.ScaleModel, references: int
) -> list[Outcome]:
    """Compare k with 1 / focal length, or the ground plane with the true one."""
    scene, k_std = view.scene, model.k_std / model.k
    if view.run.kind != "ground_plane":
        errors = [("", math.log(model.k * scene.focal_px), k_std)]
    else:
        errors = [
            (CAMERA_HEIGHT, math.log(model.k / scene.camera_height_m), k_std),
            (HORIZON, -model.shift - scene.horizon_px, model.shift_std),
        ]
    return [
        Outcome(
            scene=number,
            thing=-1,
            drive=scene.drive,
            label=label,
            references=references,
            error=error,
            covered=_covered(error, std),
        )
        for label, error, std in errors
    ]


def gather(parts: Sequence[Part]) -> Outcomes:
    """Put the parts of a run together, without the objects that got no answer."""
    everything = [outcome for part in parts for outcome in part.outcomes]
    found = [outcome for outcome in everything if math.isfinite(outcome.error)]
    return Outcomes(
        key=np.array([(o.scene, o.thing) for o in found], dtype=np.int64).reshape(-1, 2),
        drive=np.array([o.drive for o in found], dtype=np.str_),
        label=np.array([o.label for o in found], dtype=np.str_),
        references=np.array([o.references for o in found], dtype=np.int64),
        error=np.array([o.error for o in found], dtype=np.float64),
        covered=np.array([o.covered for o in found], dtype=np.bool_).reshape(-1, len(LEVELS)),
        class_error=np.array([o.class_error for o in found], dtype=np.float64),
        focal_error=np.array([o.focal_error for o in found], dtype=np.float64),
        refused_images=sum(part.refused_images for part in parts),
        refused=sum(part.refused for part in parts),
        unanswered=len(everything) - len(found),
    )


def _covered(error: float, std: float) -> tuple[bool, ...]:
    """Tell which normal intervals hold the truth."""
    scores = [NormalDist().inv_cdf((1 + level) / 2) for level in LEVELS]
    return tuple(abs(error) <= score * std for score in scores)
