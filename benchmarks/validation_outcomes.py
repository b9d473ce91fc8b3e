"""Run the library over scenes and collect, object by object, how far off it was."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from validation_priors import class_mean
from validation_protocols import Answer, Setting, fit_model, size_objects
from validation_runs import Run
from validation_scenes import FloatArray, Scene
from validation_views import View, view_of

import imgscale as ims

LEVELS = (0.5, 0.9, 0.95)


class Outcome(NamedTuple):
    """One answer beside the truth; relative errors, NaN where there is no such answer."""

    scene: int
    thing: int
    drive: str
    label: str
    references: int
    error: float
    covered: tuple[bool, ...]
    """By the intervals of each level."""
    class_error: float
    """Of the mean of its class."""
    focal_error: float
    """Of its pixels and depth with the true focal length."""


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


class Validation:
    """Scenes, a table of sizes and a method; remembers what it has run."""

    def __init__(self, scenes: Sequence[Scene], setting: Setting) -> None:
        self.scenes = scenes
        self.setting = setting
        self._done: dict[Run, Outcomes] = {}

    def outcomes(self, run: Run) -> Outcomes:
        """Run it, once."""
        if run not in self._done:
            start = time.perf_counter()
            self._done[run] = self._run(run)
            seconds = time.perf_counter() - start
            print(f"{seconds:7.1f} s  {run.summary}", file=sys.stderr, flush=True)
        return self._done[run]

    def _run(self, run: Run) -> Outcomes:
        found: list[Outcome] = []
        refused_images = refused = unanswered = 0
        for number, scene in enumerate(self.scenes):
            view = view_of(scene, run)
            if view is None:
                continue
            try:
                outcomes = self._outcomes_of(number, view)
            except ims.FitError:
                refused_images += 1
                refused += len(view.targets)
                continue
            answered = [outcome for outcome in outcomes if math.isfinite(outcome.error)]
            unanswered += len(outcomes) - len(answered)
            found += answered
        return _columns(found, refused_images, refused, unanswered)

    def _outcomes_of(self, number: int, view: View) -> list[Outcome]:
        if view.run.protocol == "k":
            return [_scale_outcome(number, view, self.setting)]
        answers = size_objects(view, self.setting)
        return [self._size_outcome(number, view, answer) for answer in answers]

    def _size_outcome(self, number: int, view: View, answer: Answer) -> Outcome:
        thing, true = answer.thing, answer.thing.height_m
        known = view.run.protocol == "L"
        mean = class_mean(self.setting.priors, thing.label) if known else math.nan
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


def _scale_outcome(number: int, view: View, setting: Setting) -> Outcome:
    """Compare k with 1 / focal length, in log."""
    model = fit_model(view, view.references, setting)
    error = math.log(model.k * view.scene.focal_px)
    scores = [NormalDist().inv_cdf((1 + level) / 2) for level in LEVELS]
    return Outcome(
        scene=number,
        thing=-1,
        drive=view.scene.drive,
        label="",
        references=len(view.references),
        error=error,
        covered=tuple(abs(error) <= score * model.k_std / model.k for score in scores),
        class_error=math.nan,
        focal_error=math.nan,
    )


def _columns(
    found: Sequence[Outcome], refused_images: int, refused: int, unanswered: int
) -> Outcomes:
    return Outcomes(
        key=np.array([(o.scene, o.thing) for o in found], dtype=np.int64).reshape(-1, 2),
        drive=np.array([o.drive for o in found], dtype=np.str_),
        label=np.array([o.label for o in found], dtype=np.str_),
        references=np.array([o.references for o in found], dtype=np.int64),
        error=np.array([o.error for o in found], dtype=np.float64),
        covered=np.array([o.covered for o in found], dtype=np.bool_).reshape(-1, len(LEVELS)),
        class_error=np.array([o.class_error for o in found], dtype=np.float64),
        focal_error=np.array([o.focal_error for o in found], dtype=np.float64),
        refused_images=refused_images,
        refused=refused,
        unanswered=unanswered,
    )
