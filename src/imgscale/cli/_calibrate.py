"""The command ``imgscale calibrate``."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from imgscale._format import with_error
from imgscale._typing import ImageSize
from imgscale.camera import Camera
from imgscale.cli import _options
from imgscale.cli._inputs import DetectionSource, check_labels, detection_source
from imgscale.cli._messages import (
    OK,
    FailedError,
    WrongUsageError,
    complain,
    in_words,
    shown,
)
from imgscale.cli._outputs import check_is_no_input, check_out, write_text
from imgscale.cli._photos import find_photos, read_header
from imgscale.cli._sources import CameraOf, Known, camera_source, known_sizes, on_ground
from imgscale.cli._tables import noted_table, scale_text
from imgscale.depth import GroundPlane
from imgscale.detection import Detection
from imgscale.errors import FitError
from imgscale.estimate import SizeEstimate
from imgscale.fitting import fit
from imgscale.flags import Flag
from imgscale.model import ScaleModel
from imgscale.object_prior import normal_label
from imgscale.validation import leave_one_out

# EXIF focal lengths are whole millimetres: more than that is another lens or zoom.
_SAME_FOCAL = 0.02


class _Setup(NamedTuple):
    """
    What the set-up photos show together.

    Attributes
    ----------
    photos : tuple of Path
        The photo of each detection.
    detections : tuple of Detection
        All of them.
    ground : GroundPlane
        The one that they stand on, with what was told of it.
    camera : Camera or None
        What is known of the lens.
    """

    photos: tuple[Path, ...]
    detections: tuple[Detection, ...]
    ground: GroundPlane
    camera: Camera | None


def run(options: Any) -> int:
    """Fit one ground plane to all set-up photos, tell what was found and keep it."""
    others = [options.detections, options.priors, options.class_names, options.coco_images]
    given = [path for path in others if path is not None]
    _options.check_references(options)
    _options.check_camera(options, on_ground=True)
    check_out(options.out, (".json",))
    photos = find_photos(options.photos, given)
    _options.check_detections(options, len(photos))
    check_is_no_input([options.out], [*photos, *given])
    known, source = known_sizes(options), detection_source(options, photos)
    check_labels(source, photos, [prior.label for prior in options.reference])
    setup = _gather(options, photos, source)
    try:
        model = _fit(setup, known)
    except (FitError, ValueError) as error:
        raise FailedError(in_words(error)) from error
    text = _found(model, setup, known)
    # before the text: whoever reads that may have gone
    write_text(options.out, json.dumps(model.to_dict(), allow_nan=False) + "\n")
    print(f"{text}\n\nwrote {shown(str(options.out))}")
    return OK


def _gather(options: Any, photos: Sequence[Path], source: DetectionSource) -> _Setup:
    """Read all photos; each that cannot be is named, and then nothing is fitted."""
    wanted = {normal_label(prior.label) for prior in options.reference}
    sizes: dict[Path, ImageSize] = {}
    found: dict[Path, list[Detection]] = {}
    for photo in photos:
        try:
            sizes[photo] = read_header(photo).size
            found[photo] = [one for one in source(photo) if _counts(one, wanted)]
        except Exception as error:  # noqa: BLE001 - whatever one photo raises
            complain(f"{photo}: {in_words(error)}")
    if len(found) < len(photos):
        msg = (
            f"{len(photos) - len(found)} of {len(photos)} set-up photos could not be read; no "
            "model was written."
        )
        raise FailedError(msg)
    size = _one_size(sizes)
    return _Setup(
        tuple(photo for photo, detections in found.items() for _ in detections),
        tuple(one for detections in found.values() for one in detections),
        on_ground(options)(size),
        _one_camera(camera_source(options), sizes),
    )


def _counts(detection: Detection, wanted: set[str]) -> bool:
    """Tell whether a detection counts: a reference, where those are told."""
    return not wanted or any(normal_label(name) in wanted for name in detection.names)


def _one_size(sizes: dict[Path, ImageSize]) -> ImageSize:
    """Raise unless all photos are of one size."""
    first, *others = sizes.items()
    for photo, size in others:
        if size != first[1]:
            msg = (
                f"PHOTO must all be of one size, as one camera takes them; {first[0]} has "
                f"{first[1][0]} x {first[1][1]} px and {photo} {size[0]} x {size[1]}."
            )
            raise WrongUsageError(msg)
    return first[1]


def _one_camera(camera_of: CameraOf, sizes: dict[Path, ImageSize]) -> Camera | None:
    """Take the camera that all photos tell; None where one of them tells none."""
    cameras = {photo: camera_of(photo, size) for photo, size in sizes.items()}
    told = {photo: camera for photo, camera in cameras.items() if camera is not None}
    if not told:
        return None
    first, *others = told.items()
    for photo, camera in others:
        if abs(math.log(camera.focal_px / first[1].focal_px)) > _SAME_FOCAL:
            msg = (
                f"PHOTO must all be taken with one focal length; by their EXIF records {first[0]} "
                f"has {first[1].focal_px:.0f} px and {photo} {camera.focal_px:.0f}. Leave out "
                "those of another zoom, or say --no-exif."
            )
            raise WrongUsageError(msg)
    return first[1]


def _fit(setup: _Setup, known: Known) -> ScaleModel:
    """
    Fit all photos as though they were one.

    A camera that does not move sees one plane, so that every object of every photo tells of the
    same three numbers. A model per photo, as `fit_shared` gives them for a camera that moves, would
    hold the same plane again and again.
    """
    return fit(setup.detections, setup.ground, known.priors, camera=setup.camera, noise=known.noise)


def _found(model: ScaleModel, setup: _Setup, known: Known) -> str:
    """Tell what was found, and how each reference fits the others."""
    lines = [scale_text(model), ""]
    if plane := model.plane:
        height = with_error(plane.camera_height_m, plane.camera_height_std_m)
        horizon = with_error(plane.horizon_px, plane.horizon_std_px)
        roll = with_error(plane.roll_deg, plane.roll_std_deg)
        lines += [
            f"camera height  {height} m",
            f"horizon        row {horizon} of {setup.ground.image_size[1]}",
            f"roll           {roll} degrees",
            "",
        ]
    if Flag.ASSUMED_HORIZON in model.flags:
        lines += ["the photos hardly tell the horizon: show a reference near and far", ""]
    if model.camera is None:
        lines += ["no focal length (--focal-px, or EXIF): sizes will come without distances", ""]
    return "\n".join([*lines, _check(model, setup, known)])


def _check(model: ScaleModel, setup: _Setup, known: Known) -> str:
    """Lay out each reference as it is sized from all others."""
    alone: Sequence[SizeEstimate | None] = [None] * len(setup.detections)
    if sum(ref.candidate for ref in model.references) > 1:
        alone = leave_one_out(
            setup.detections, setup.ground, known.priors, camera=setup.camera, noise=known.noise
        )
    header = ("photo", "object", "known m", "from the others m", "90 % interval")
    rows: list[tuple[str, ...]] = []
    for photo, ref, estimate in zip(setup.photos, model.references, alone, strict=True):
        size, interval = "-", "-"
        if estimate and ref.candidate and not math.isnan(estimate.size_m):
            low, high = estimate.interval(0.9)
            size, interval = f"{estimate.size_m:.3f}", f"{low:.3f} to {high:.3f}"
        known_m = "-" if math.isnan(ref.prior_m) else f"{ref.prior_m:.3f}"
        reason = "" if ref.used else f"not used: {ref.reason}"
        rows.append((shown(photo.name), shown(ref.label), known_m, size, interval, reason))
    return noted_table(header, rows)
