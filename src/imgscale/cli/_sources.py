"""Depth, camera, sizes and errors, as the options tell them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import attrs

from imgscale._typing import ImageArray, ImageSize
from imgscale.camera import Camera
from imgscale.cli._messages import WrongUsageError, in_words
from imgscale.cli._photos import by_stem
from imgscale.depth import Depth, GroundPlane
from imgscale.depth_sources import OneDistance, read_depth
from imgscale.noise import Noise
from imgscale.priors import PriorTable

DEPTH_ENDINGS = (".npy", ".npz", ".pfm", ".png", ".tif", ".tiff")
FOCAL_REL_STD = 0.02  # what makers tell

DepthOf: TypeAlias = Callable[[Path, ImageArray], Depth]
CameraOf: TypeAlias = Callable[[Path, ImageSize], Camera | None]


class Known(NamedTuple):
    """
    What the options tell of sizes and errors.

    Attributes
    ----------
    priors : PriorTable
        Sizes by label.
    noise : Noise
        Errors of boxes and depths.
    """

    priors: PriorTable
    noise: Noise


def known_sizes(options: Any) -> Known:
    """Read the table of sizes, put the references in, and take the errors."""
    try:
        table = (
            PriorTable.default(options.region)
            if options.priors is None
            else PriorTable.from_csv(options.priors, region=options.region)
        )
        for prior in options.reference:
            table = table.with_prior(prior)
        noise = Noise(options.box_std_px, options.box_rel_std, options.depth_rel_std)
    except (OSError, TypeError, ValueError) as error:
        raise WrongUsageError(in_words(error)) from error
    return Known(table, noise)


def depth_source(options: Any, photos: Sequence[Path]) -> DepthOf:
    """Give what tells the depth of a photo."""
    if options.depth is not None:
        return _depth_files(options, photos)
    if options.one_distance:
        together = OneDistance()
        return lambda _, image: together(image)
    ground = on_ground(options)
    return lambda _, image: ground((image.shape[1], image.shape[0]))


def on_ground(options: Any) -> Callable[[ImageSize], GroundPlane]:
    """Give the ground plane of photos of a size, with what is told of it."""
    told = {
        "horizon_px": options.horizon,
        "horizon_std_px": options.horizon_std,
        "camera_height_m": options.camera_height,
        "camera_height_std_m": options.camera_height_std,
    }
    return lambda size: GroundPlane(image_size=size, **told)


def _depth_files(options: Any, photos: Sequence[Path]) -> DepthOf:
    files = by_stem("--depth", options.depth, photos, DEPTH_ENDINGS)
    if options.depth.is_file() and options.depth.suffix.lower() not in DEPTH_ENDINGS:
        msg = f"--depth must end in {' or '.join(DEPTH_ENDINGS)}; got {options.depth}."
        raise WrongUsageError(msg)

    def read(photo: Path, image: ImageArray) -> Depth:
        return read_depth(
            files[photo],
            kind=options.kind,
            scale=options.scale,
            key=options.depth_key,
            image_size=(image.shape[1], image.shape[0]),
            scale_rel_std=options.scale_rel_std or 0.0,
        )

    return read


def camera_source(options: Any) -> CameraOf:
    """Give what tells the camera of a photo: the options, else its EXIF record where it has one."""
    if options.focal_px is None:
        return _no_camera if options.no_exif else _exif_camera
    rel_std = FOCAL_REL_STD if options.focal_rel_std is None else options.focal_rel_std
    try:
        camera = Camera(
            options.focal_px,
            focal_rel_std=rel_std,
            pitch_deg=options.pitch_deg or 0.0,
            pitch_std_deg=options.pitch_std_deg or 0.0,
        )
    except ValueError as error:
        raise WrongUsageError(in_words(error)) from error
    return lambda _, size: attrs.evolve(camera, image_size=size)


def _no_camera(_: Path, __: ImageSize) -> None:
    return None


def _exif_camera(photo: Path, _: ImageSize) -> Camera | None:
    """Take the focal length of the EXIF record; None where there is none, or it was cropped."""
    try:
        return Camera.from_exif(photo)
    except (SyntaxError, TypeError, ValueError):  # the latter two of records that are broken
        return None
