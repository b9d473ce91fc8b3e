"""The command ``imgscale measure``."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeAlias, cast

import attrs

from imgscale._optional import require
from imgscale._reading import read_json
from imgscale._typing import ImageArray
from imgscale.cli import _options
from imgscale.cli._inputs import DetectionSource, check_labels, detection_source
from imgscale.cli._messages import (
    FAILED,
    INTERRUPTED,
    OK,
    WrongUsageError,
    complain,
    in_words,
    shown,
)
from imgscale.cli._outputs import (
    ENDINGS,
    CsvWriter,
    JsonWriter,
    PageWriter,
    PictureWriter,
    Put,
    Result,
    Style,
    Writer,
    Writers,
    check_is_no_input,
    check_out,
    pictures_for,
)
from imgscale.cli._parser import measure_defaults
from imgscale.cli._photos import find_photos
from imgscale.cli._sources import camera_source, depth_source, known_sizes
from imgscale.cli._tables import scale_text, sizes_table
from imgscale.measurement import Measurement
from imgscale.model import ScaleModel
from imgscale.picture import upright_rgb
from imgscale.pipeline import measure
from imgscale.prediction import predict

Measure: TypeAlias = Callable[[Path, ImageArray], Measurement]

# What a model has decided.
_OF_THE_MODEL = (
    *("reference", "priors", "region", "method", "box_std_px", "box_rel_std", "depth_rel_std"),
    *("focal_px", "focal_rel_std", "no_exif", "pitch_deg", "pitch_std_deg"),
    *("camera_height", "camera_height_std", "horizon", "horizon_std"),
)


def run(options: Any) -> int:
    """Measure photos, and tell or write what came out."""
    style = Style(options.unit, options.level)
    _check(options)
    photos = find_photos(options.photos, _other_inputs(options))
    _options.check_detections(options, len(photos))
    pictures = _check_outs(options, photos)
    detections = detection_source(options, photos)
    measure_one = _with_model(options, detections) or _with_fit(options, photos, detections)
    with Writers() as files:
        if not options.out:
            files.take(_Printer(style, same_scale=options.model is not None))
        for out in options.out:
            files.take(_writer(out, style, pictures))
        has_bar = options.out and len(photos) > 1
        return _run_all(_with_progress(photos) if has_bar else photos, measure_one, files)


def _check(options: Any) -> None:
    """Raise what the words alone tell."""
    if options.model is not None:
        why = "`imgscale calibrate` has put into it what was known."
        _options.check_defaults(options, measure_defaults(), _OF_THE_MODEL, why)
    _options.check_references(options)
    _options.check_depth(options)
    _options.check_method(options)
    _options.check_camera(options, on_ground=options.ground_plane)


def _other_inputs(options: Any) -> list[Path]:
    """List all files and folders that are read besides the photos."""
    names = ("detections", "depth", "priors", "model", "class_names", "coco_images")
    return [path for name in names if (path := getattr(options, name)) is not None]


def _check_outs(options: Any, photos: Sequence[Path]) -> dict[Path, dict[Path, Path]]:
    """Raise where results cannot go; name the pictures of each ``--out x.png``."""
    pictures: dict[Path, dict[Path, Path]] = {}
    for out in options.out:
        check_out(out, ENDINGS)
        if out.suffix.lower() in {".html", ".png"}:
            require("matplotlib", extra="plot", purpose=f"--out {out}")
        if out.suffix.lower() == ".png":
            pictures[out] = pictures_for(out, photos, options.photos)
    others = [out for out in options.out if out not in pictures]
    inputs = [*photos, *_files_of(_other_inputs(options), {photo.stem for photo in photos})]
    check_is_no_input(
        [*others, *(p for named in pictures.values() for p in named.values())], inputs
    )
    return pictures


def _files_of(paths: Iterable[Path], stems: Container[str]) -> Iterator[Path]:
    """List files, and those in folders that belong to photos by their names."""
    for path in paths:
        inside = path.rglob("*") if path.is_dir() else ()
        yield from (path, *(file for file in inside if file.stem in stems))


def _writer(out: Path, style: Style, pictures: dict[Path, dict[Path, Path]]) -> Writer:
    ending = out.suffix.lower()
    if ending == ".png":
        return PictureWriter(out, pictures[out], style)
    kinds: dict[str, Callable[[Path, Style], Writer]]
    kinds = {".csv": CsvWriter, ".json": JsonWriter, ".html": PageWriter}
    return kinds[ending](out, style)


# --- one photo ---


def _with_fit(options: Any, photos: Sequence[Path], detections: DetectionSource) -> Measure:
    """Fit every photo by itself."""
    known = known_sizes(options)
    depth, camera = depth_source(options, photos), camera_source(options)
    check_labels(detections, photos, [prior.label for prior in options.reference])

    def measure_one(photo: Path, image: ImageArray) -> Measurement:
        size = (image.shape[1], image.shape[0])
        found = measure(
            image,
            detector=lambda _: detections(photo),
            depth_source=lambda pixels: (depth(photo, pixels), camera(photo, size)),
            priors=known.priors,
            method=options.method,
            noise=known.noise,
            axis=options.axis,
            use_prior=options.use_prior,
        )
        return attrs.evolve(found, name=str(photo))

    return measure_one


def _with_model(options: Any, detections: DetectionSource) -> Measure | None:
    """Take the scale of a fixed camera; None without a model."""
    if options.model is None:
        return None
    model = read_model(options.model)
    if model.ground is None or model.image_size is None or model.kind != "ground_plane":
        msg = (
            f"--model must be of a ground plane, as `imgscale calibrate` writes it; {options.model}"
            f' is of depth of kind "{model.kind}". Use predict() in Python.'
        )
        raise WrongUsageError(msg)
    ground, wanted = model.ground, model.image_size

    def measure_one(photo: Path, image: ImageArray) -> Measurement:
        size = (image.shape[1], image.shape[0])
        if size != wanted:
            msg = (
                f"a photo must be as large as those the camera was calibrated with, {wanted[0]} x "
                f"{wanted[1]} px; got {size[0]} x {size[1]}."
            )
            raise ValueError(msg)
        found = tuple(detections(photo))
        sizes = predict(model, found, axis=options.axis, use_prior=options.use_prior)
        return Measurement(
            model=model,
            estimates=tuple(sizes),
            detections=found,
            depth=ground,
            image_size=size,
            name=str(photo),
        )

    return measure_one


def read_model(path: Path) -> ScaleModel:
    """Read a model file."""
    law = "--model must be a file of `imgscale calibrate`"
    try:
        record = read_json(path)
    except (OSError, ValueError) as error:
        msg = f"{law}: {in_words(error)}"
        raise WrongUsageError(msg) from error
    if not isinstance(record, dict):
        msg = f"{law}; {path} is none."
        raise WrongUsageError(msg)
    try:
        return ScaleModel.from_dict(cast("dict[str, Any]", record))
    except Exception as error:  # whatever a broken record leads to
        msg = f"{law}; {path} is none: {in_words(error)}"
        raise WrongUsageError(msg) from error


# --- all of them ---


def _run_all(photos: Iterable[Path], measure_one: Measure, files: Writers) -> int:
    """Go through the photos; one that fails is named, and the next follows."""
    code = OK
    try:
        for photo in photos:
            try:
                image = upright_rgb(photo)
                put = files.prepare(Result(photo, measure_one(photo, image), image))
            except Exception as error:  # noqa: BLE001 - whatever one photo raises
                complain(_about(photo, error))
                code = FAILED
                continue
            put()
    except KeyboardInterrupt:
        code = INTERRUPTED
    return code if files.finish() or code == INTERRUPTED else FAILED


def _about(photo: Path, error: Exception) -> str:
    """Name the photo, once."""
    words = in_words(error)
    return words if words.startswith(f"{photo}: ") else f"{photo}: {words}"


def _with_progress(photos: Sequence[Path]) -> Iterable[Path]:
    """Show how far it is on a terminal, where there is something to show it with."""
    if not find_spec("tqdm"):
        return photos
    tqdm: Any = import_module("tqdm")
    bar: Iterable[Path] = tqdm.tqdm(photos, unit="photo", disable=None)
    return bar


class _Printer:
    """Prints results as they come, in the place of a file."""

    out = Path("standard output")

    def __init__(self, style: Style, *, same_scale: bool) -> None:
        self._style = style
        self._same_scale = same_scale
        self._is_first = True

    def prepare(self, result: Result) -> Put:
        measurement = result.measurement
        scale = scale_text(measurement.model)
        lines = [] if self._is_first else [""]
        if self._same_scale and self._is_first:
            lines += [scale, ""]
        lines.append(shown(str(result.photo)))
        lines += [] if self._same_scale else [scale]
        has_objects = bool(measurement.estimates)
        lines.append(sizes_table(measurement.estimates, self._style) if has_objects else "nothing")
        return lambda: self._put("\n".join(lines))

    def _put(self, text: str) -> None:
        print(text, flush=True)
        self._is_first = False

    def finish(self) -> None:
        """All is told already."""

    def drop(self) -> None:
        """Nothing is left half done."""
