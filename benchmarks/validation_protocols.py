"""The protocols: how one image is put to the library, object by object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from validation_scenes import Thing
from validation_views import View

import imgscale as ims

_JITTER_PX = 5.0


class Setting(NamedTuple):
    """What is the same for all runs."""

    priors: ims.PriorTable
    method: str | None
    """None leaves the library its default."""

    def fit_options(self, view: View) -> dict[str, Any]:
        """Collect the options of `fit`."""
        options: dict[str, Any] = {"noise": view.noise}
        if view.run.foot:
            options["ground"] = view.ground
        if view.run.paper:
            options["method"] = "mean_ratio"
        elif self.method is not None:
            options["method"] = self.method
        return options


class Answer(NamedTuple):
    """What the library said of one object, and the depth that it was given for it."""

    thing: Thing
    references: int
    estimate: ims.SizeEstimate
    depth: float


def fit_model(view: View, references: Sequence[Thing], setting: Setting) -> ims.ScaleModel:
    """Fit the image's scale to some of its objects."""
    return ims.fit(
        view.reference_detections(references),
        view.depth(references),
        setting.priors,
        **setting.fit_options(view),
    )


def fit_frames(views: Sequence[View], setting: Setting) -> list[ims.ScaleModel]:
    """Fit the scale of many images of one camera together."""
    frames = [
        ims.Frame(
            view.reference_detections(view.references),
            view.depth(view.references),
            name=view.scene.name,
        )
        for view in views
    ]
    return ims.fit_shared(frames, setting.priors, **setting.fit_options(views[0]))


def size_objects(view: View, setting: Setting) -> list[Answer]:
    """Size the targets of one image by the run's protocol."""
    if view.run.protocol == "U":
        return _from_references(view, setting)
    if view.run.damage is None:
        return _leave_one_out(view, setting)
    return _from_the_others(view, setting)


def size_with(
    view: View, model: ims.ScaleModel, targets: Sequence[Thing], references: int
) -> list[Answer]:
    """Size some targets with a model that was fitted to so many references."""
    estimates = ims.predict(
        model,
        view.target_detections(targets),
        view.depth(targets),
        use_prior=view.run.uses_prior,
    )
    return _answers(view, targets, estimates, references)


def size_on_plane(view: View, model: ims.ScaleModel, setting: Setting) -> list[Answer]:
    """
    Leave each object out of its image, whose plane is known from others of the drive.

    A car pitches and rolls from image to image: by 5 pixels and a degree is taken.
    """
    if model.plane is None:
        msg = "the model has no plane"
        raise ValueError(msg)
    plane = model.plane.as_prior(view.scene.image_size, jitter_px=_JITTER_PX, jitter_deg=1.0)
    estimates = ims.leave_one_out(
        view.target_detections(view.targets),
        plane,
        setting.priors,
        use_prior=view.run.uses_prior,
        **setting.fit_options(view),
    )
    return _answers(view, view.targets, estimates, len(view.targets) - 1)


def _leave_one_out(view: View, setting: Setting) -> list[Answer]:
    estimates = ims.leave_one_out(
        view.target_detections(view.targets),
        view.depth(view.targets),
        setting.priors,
        use_prior=view.run.uses_prior,
        **setting.fit_options(view),
    )
    return _answers(view, view.targets, estimates, len(view.targets) - 1)


def _from_the_others(view: View, setting: Setting) -> list[Answer]:
    """Leave one out by hand: the others may be damaged, the target is whole."""
    answers = []
    for target in view.targets:
        others = [thing for thing in view.references if thing is not target]
        model = fit_model(view, others, setting)
        answers += size_with(view, model, [target], len(others))
    return answers


def _from_references(view: View, setting: Setting) -> list[Answer]:
    model = fit_model(view, view.references, setting)
    return size_with(view, model, view.targets, len(view.references))


def _answers(
    view: View, targets: Sequence[Thing], estimates: Sequence[ims.SizeEstimate], references: int
) -> list[Answer]:
    depths = [estimate.depth for estimate in estimates]  # what it saw in a map or of the ground
    if view.run.depth != "map" and view.run.kind != "ground_plane":
        depths = view.depth_values(targets).tolist()
    rows = zip(targets, estimates, depths, strict=True)
    return [Answer(thing, references, estimate, depth) for thing, estimate, depth in rows]
