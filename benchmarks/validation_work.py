"""The work of a run: images one by one, or whole drives."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from validation_outcomes import Outcome, Part, scale_outcomes, size_outcome
from validation_protocols import (
    Setting,
    fit_frames,
    fit_model,
    size_objects,
    size_on_plane,
    size_with,
)
from validation_runs import Run
from validation_scenes import Scene
from validation_views import View, frame_of, view_of

import imgscale as ims

# Numbers of the scenes that are worked on together.
Unit: TypeAlias = tuple[int, ...]

_FEWEST_FRAMES = 10
_BLOCKS = 5


def units_of(scenes: Sequence[Scene], run: Run) -> list[Unit]:
    """Split the work of a run: by image or by drive, in the order in which it was driven."""
    if not (run.pooled or run.learned):
        return [(number,) for number in range(len(scenes))]
    drives: defaultdict[str, list[int]] = defaultdict(list)
    for number in sorted(range(len(scenes)), key=lambda number: scenes[number].time):
        drives[scenes[number].drive].append(number)
    fewest = _FEWEST_FRAMES if run.pooled else 1
    return [tuple(drives[name]) for name in sorted(drives) if len(drives[name]) >= fewest]


def work(scenes: Sequence[Scene], setting: Setting, run: Run, unit: Unit) -> Part:
    """Put one unit of a run to the library."""
    if not run.pooled:
        return _image_by_image(scenes, setting, run, unit)
    if run.protocol == "k":
        return _scale_of_drive(scenes, setting, run, unit)
    return _heights_of_drive(scenes, setting, run, unit)


def _image_by_image(scenes: Sequence[Scene], setting: Setting, run: Run, unit: Unit) -> Part:
    learned = _depth_noise(scenes, setting, run, unit) if run.learned else None
    outcomes: list[Outcome] = []
    refused_images = refused = 0
    for number in unit:
        view = view_of(scenes[number], run)
        if view is None:
            continue
        try:
            outcomes += _of_image(number, replace(view, learned=learned), setting)
        except ims.FitError:
            refused_images += 1
            refused += len(view.targets)
    return Part(outcomes, refused_images, refused)


def _of_image(number: int, view: View, setting: Setting) -> list[Outcome]:
    if view.run.protocol == "k":
        model = fit_model(view, view.references, setting)
        return scale_outcomes(number, view, model, len(view.references))
    answers = size_objects(view, setting)
    return [size_outcome(number, view, answer, setting) for answer in answers]


def _depth_noise(scenes: Sequence[Scene], setting: Setting, run: Run, unit: Unit) -> float | None:
    """Learn how much the depths of a drive err; None where that cannot be known."""
    model = _fitted(_frames(scenes, run, unit), setting)
    return None if model is None else model.depth_rel


def _scale_of_drive(scenes: Sequence[Scene], setting: Setting, run: Run, unit: Unit) -> Part:
    views = _frames(scenes, run, unit)
    model = _fitted(views, setting)
    if model is None:
        return Part([], len(views), 0)
    number = next(iter(views))
    return Part(scale_outcomes(number, views[number], model, _count(views)))


def _heights_of_drive(scenes: Sequence[Scene], setting: Setting, run: Run, unit: Unit) -> Part:
    """Size the known objects of each part of a drive with a model of the other parts."""
    outcomes: list[Outcome] = []
    refused_images = refused = 0
    for block in np.array_split(unit, _BLOCKS):
        inside = _frames(scenes, run, block.tolist())
        outside = _frames(scenes, run, [number for number in unit if number not in block])
        model = _fitted(outside, setting)
        if model is None:
            refused_images += len(inside)
            refused += _count(inside)
            continue
        for number, view in inside.items():
            if (
                model.plane and len(view.targets) > 1
            ):  # the car has pitched since: so does its image
                answers = size_on_plane(view, model, setting)
            else:
                answers = size_with(view, model, view.targets, _count(outside))
            outcomes += [size_outcome(number, view, answer, setting) for answer in answers]
    return Part(outcomes, refused_images, refused)


def _fitted(views: Mapping[int, View], setting: Setting) -> ims.ScaleModel | None:
    """Fit images of one drive together, all to one scale; None where that is refused."""
    if not views:
        return None
    try:
        return fit_frames(list(views.values()), setting)[0]
    except ims.FitError:
        return None


def _frames(scenes: Sequence[Scene], run: Run, numbers: Sequence[int]) -> dict[int, View]:
    """Choose the images of a drive that show known objects."""
    views = {number: frame_of(scenes[number], run) for number in numbers}
    return {number: view for number, view in views.items() if view is not None}


def _count(views: Mapping[int, View]) -> int:
    return sum(len(view.references) for view in views.values())
