"""The detections of each photo, out of files of every format, and boxes drawn by hand."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path, PureWindowsPath
from typing import Any, NamedTuple, TypeAlias

from imgscale._checks import within
from imgscale._reading import read_bytes, read_json, read_text
from imgscale._typing import ImageSize
from imgscale.cli._messages import WrongUsageError, in_words
from imgscale.cli._photos import by_name, by_stem, read_header
from imgscale.detection import Detection
from imgscale.detectors import (
    from_megadetector,
    from_rekognition,
    from_transformers,
    read_coco,
    read_kitti,
    read_pascal_voc,
    read_yolo,
)
from imgscale.detectors._files import as_table, identity, members, told_size
from imgscale.detectors._xml import image_size, parse_annotation
from imgscale.errors import FileError
from imgscale.object_prior import normal_label

DetectionSource: TypeAlias = Callable[[Path], list[Detection]]
"""Gives the detections of a photo."""


# What lines of YAML and JSON begin or end with: "0: door", "names:", "{0: door}", "- door".
_OTHER_FORM = re.compile(r"[\[{]|-\s|\d+\s*:|.*:$")


class _Asked(NamedTuple):
    """What the options say of how files are to be read."""

    class_names: Sequence[str] | None
    masks: bool
    zero_based: bool


class _Format(NamedTuple):
    """Files of one photo each: their ending, and how one is read."""

    ending: str
    read: Callable[[Path, ImageSize, _Asked], list[Detection]]


def detection_source(options: Any, photos: Sequence[Path]) -> DetectionSource:
    """Open what the options name; what concerns one photo is raised when that is asked for."""
    from_files = None if options.detections is None else _from_files(options, photos)
    by_hand: list[Detection] = options.box

    def detections_of(photo: Path) -> list[Detection]:
        found = [] if from_files is None else from_files(photo)
        return [*(d for d in found if d.score >= options.min_score), *by_hand]

    return detections_of


def _from_files(options: Any, photos: Sequence[Path]) -> DetectionSource:
    if options.format in WHOLE:
        if not options.detections.is_file():
            msg = (
                f"--detections must be a file for --format {options.format}; there is no file "
                f"{options.detections}."
            )
            raise WrongUsageError(msg)
        try:
            return WHOLE[options.format](options, photos)
        except (OSError, TypeError, ValueError) as error:
            raise WrongUsageError(in_words(error)) from error
    return _from_single_files(SINGLE[options.format], options, photos)


def _from_single_files(form: _Format, options: Any, photos: Sequence[Path]) -> DetectionSource:
    """Read a file for each photo, of the same name."""
    names = None if options.class_names is None else _class_names(options.class_names)
    asked = _Asked(names, options.masks, options.zero_based)
    files = by_stem("--detections", options.detections, photos, (form.ending,))
    return lambda photo: form.read(files[photo], read_header(photo).size, asked)


def _class_names(path: Path) -> list[str]:
    """Read the name of each class, one a line."""
    try:
        lines = read_text(path).splitlines()
    except (OSError, FileError) as error:
        msg = f"--class-names must be a text file in UTF-8, a name a line; got {in_words(error)}"
        raise WrongUsageError(msg) from error
    names = [line.strip() for line in lines]
    while names and not names[-1]:
        names.pop()
    if not all(names) or any(map(_OTHER_FORM.match, names)):
        msg = f"--class-names must hold a name a line, in the order of their numbers; got {path}."
        raise WrongUsageError(msg)
    return names


# --- one file for all photos ---


def _coco(options: Any, photos: Sequence[Path]) -> DetectionSource:
    annotations, results = options.detections, None
    if options.coco_images is not None:
        annotations, results = options.coco_images, options.detections
    named = read_coco(annotations, results, masks=options.masks)
    found = by_name("--detections", options.detections, photos, named)
    entries: Sequence[Mapping[str, Any]] = read_json(annotations)["images"]
    sizes = by_name(
        "--detections", annotations, photos, {str(e["file_name"]): told_size(e) for e in entries}
    )

    def read(photo: Path) -> list[Detection]:
        detections = found[photo]
        _check_size(annotations, sizes[photo], read_header(photo).size)
        return detections

    return read


def _megadetector(options: Any, photos: Sequence[Path]) -> DetectionSource:
    data = read_json(options.detections)
    with within(options.detections):
        entries = members(as_table("results", data), "images")
        files = [_file_of(index, entry) for index, entry in enumerate(entries)]
        found = by_name(
            "--detections", options.detections, photos, dict(zip(files, files, strict=True))
        )
        images, sizes = _of_photos(entries, files, {file: photo for photo, file in found.items()})
        named = from_megadetector({**data, "images": images}, image_sizes=sizes)
    failures = {f: e["failure"] for f, e in zip(files, images, strict=True) if f not in named}

    def read(photo: Path) -> list[Detection]:
        file = found[photo]
        if file in failures:
            msg = f"MegaDetector could not read it: {failures[file]}."
            raise LookupError(msg)
        return named[file]

    return read


def _file_of(index: int, entry: Any) -> str:
    """Take the name of an entry, as `from_megadetector` writes it."""
    with within(f"images[{index}]"):
        return PureWindowsPath(str(identity(entry, "file"))).as_posix()


def _of_photos(
    entries: Sequence[Any], files: Sequence[str], photos: Mapping[str, Path]
) -> tuple[list[Any], dict[str, ImageSize]]:
    """Empty the entries of other photos, and read the sizes that the results do not tell."""
    images: list[Any] = []
    sizes: dict[str, ImageSize] = {}
    for index, (entry, file) in enumerate(zip(entries, files, strict=True)):
        photo = photos.get(file)
        with within(f"images[{index}]"):
            if photo and entry.get("detections") and not told_size(entry):
                try:
                    sizes[file] = _size_as_seen(photo)
                except OSError:  # which is told when its turn comes
                    photo = None
        images.append(entry if photo else {"file": file, "detections": []})
    return images, sizes


def _size_as_seen(photo: Path) -> ImageSize:
    """Read the size of a photo as MegaDetector saw it."""
    header = read_header(photo)
    if not header.turns_alike:
        msg = (
            f"{photo} must be a photo that MegaDetector turns upright; it leaves the EXIF "
            "orientation of mirrored and of grey ones, and its boxes lie otherwise. Turn the file "
            "itself and detect again."
        )
        raise ValueError(msg)
    return header.size


# --- a file for each photo ---


def _rekognition(path: Path, size: ImageSize, _: _Asked) -> list[Detection]:
    response = read_json(path)
    with within(path):
        return from_rekognition(response, image_size=size)


def _transformers(path: Path, size: ImageSize, asked: _Asked) -> list[Detection]:
    results = read_json(path)
    names = None if asked.class_names is None else dict(enumerate(asked.class_names))
    with within(path):
        return from_transformers(results, id2label=names, image_size=size)


def _pascal_voc(path: Path, size: ImageSize, asked: _Asked) -> list[Detection]:
    found = read_pascal_voc(path, one_based=not asked.zero_based)
    _check_size(path, image_size(parse_annotation(read_bytes(path))), size)
    return found


def _yolo(path: Path, size: ImageSize, asked: _Asked) -> list[Detection]:
    names = asked.class_names or ()
    return read_yolo(path, image_size=size, class_names=names, polygons=asked.masks)


def _kitti(path: Path, size: ImageSize, _: _Asked) -> list[Detection]:
    return read_kitti(path, image_size=size)


def _check_size(source: Path, told: ImageSize | None, size: ImageSize) -> None:
    if told is not None and told != size:
        msg = (
            f"{source} must tell the photo's size, {size[0]} x {size[1]} px; it says "
            f"{told[0]} x {told[1]}. Its boxes are of another copy of the photo: measure that one."
        )
        raise ValueError(msg)


WHOLE: Mapping[str, Callable[[Any, Sequence[Path]], DetectionSource]] = {
    "coco": _coco,
    "megadetector": _megadetector,
}
SINGLE: Mapping[str, _Format] = {
    "kitti": _Format(".txt", _kitti),
    "pascal_voc": _Format(".xml", _pascal_voc),
    "rekognition": _Format(".json", _rekognition),
    "transformers": _Format(".json", _transformers),
    "yolo": _Format(".txt", _yolo),
}


def labels_of(source: DetectionSource, photos: Sequence[Path]) -> list[str]:
    """List the names of all that was detected; photos that cannot be read have none."""
    names: dict[str, None] = {}
    for photo in photos:
        try:
            found = source(photo)
        except Exception:  # noqa: BLE001, S112 - it is told when the photo's turn comes
            continue
        names |= dict.fromkeys(name for detection in found for name in detection.names)
    return list(names)


def check_labels(source: DetectionSource, photos: Sequence[Path], wanted: Sequence[str]) -> None:
    """Raise where a reference was detected nowhere."""
    if not wanted:
        return
    found = labels_of(source, photos)
    known = {normal_label(name) for name in found}
    for label in wanted:
        if normal_label(label) not in known:
            some = ", ".join(sorted(found)[:8]) or "nothing"
            msg = f'--reference "{label}" must be something that was detected; there is {some}.'
            raise WrongUsageError(msg)
