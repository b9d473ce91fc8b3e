"""The photos that were asked for, what lies beside them, and the size of each."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

from imgscale._reading import decoding
from imgscale._typing import ImageSize
from imgscale.cli._messages import WrongUsageError
from imgscale.picture import opened_picture

T = TypeVar("T")
K = TypeVar("K")

PHOTO_ENDINGS = (".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp")

# EXIF orientations that turn by a quarter, that turn at all, that mirror.
_QUARTER_TURNED, _TURNED, _MIRRORED = (5, 6, 7, 8), (3, 6, 8), (2, 4, 5, 7)


def find_photos(given: Sequence[Path], others: Collection[Path]) -> list[Path]:
    """
    List photos, a folder's and its subfolders' in the order of their paths.

    Hidden files, and `others` (files or folders of depths and the like), are no photos of a folder.
    """
    elsewhere = [other.resolve() for other in others]
    photos: list[Path] = []
    for path in given:
        found = list(_in_folder(path, elsewhere)) if path.is_dir() else [path]
        if not found:
            msg = f"{path} holds no photos ({', '.join(PHOTO_ENDINGS)})."
            raise WrongUsageError(msg)
        photos += found
    once: dict[Path, Path] = {}
    for photo in photos:
        once.setdefault(full_path(photo), photo)
    return list(once.values())


def _in_folder(folder: Path, elsewhere: Sequence[Path]) -> Iterator[Path]:
    top = folder.resolve()
    inside = [other for other in elsewhere if top in other.parents]
    for path in sorted(folder.rglob("*")):
        relative = path.relative_to(folder)
        hidden = any(part.startswith(".") for part in relative.parts)
        if hidden or path.suffix.lower() not in PHOTO_ENDINGS or not path.is_file():
            continue
        real = path.resolve()
        if not any(real == other or other in real.parents for other in inside):
            yield path


class Header(NamedTuple):
    """
    What a photo's first bytes tell.

    Attributes
    ----------
    size : (width, height)
        Size of the upright photo in pixels.
    turns_alike : bool
        False where MegaDetector leaves the photo's EXIF orientation, mirrored or grey and turned.
    """

    size: ImageSize
    turns_alike: bool


def read_header(photo: Path) -> Header:
    """Read what a photo tells before its pixels."""
    from PIL import ExifTags  # noqa: PLC0415 - 20 ms that --help does not need

    with opened_picture(photo) as image, decoding(photo, "a picture"):
        width, height = image.size
        orientation = image.getexif().get(ExifTags.Base.Orientation, 1)
        odd = orientation in _MIRRORED or (orientation in _TURNED and image.mode != "RGB")
    size = (height, width) if orientation in _QUARTER_TURNED else (width, height)
    return Header(size, not odd)


def full_path(path: Path) -> Path:
    """Write a path in full; a link keeps its own name, which is the one that people gave."""
    return Path(os.path.abspath(path))  # noqa: PTH100 - Path.absolute() leaves ".." standing


def ends_of(photo: Path) -> list[str]:
    """List the ends of a photo's full path, the longest first, with forward slashes."""
    full = full_path(photo)
    return [full.as_posix(), *("/".join(full.parts[start:]) for start in range(1, len(full.parts)))]


class Beside(Mapping[Path, T]):
    """
    What belongs to each photo; a photo without raises what there is instead.

    Parameters
    ----------
    option : str
        The option that named it, for messages.
    found : mapping of Path to T
        What was found.
    why_not : mapping of Path to str
        Why nothing was found for other photos.
    """

    def __init__(self, option: str, found: Mapping[Path, T], why_not: Mapping[Path, str]) -> None:
        if not found and why_not:
            first, *more = why_not.values()
            others = f" So it is for {len(more)} more photos." if more else ""
            msg = f"{option} holds none of the photos: {first}{others}"
            raise WrongUsageError(msg)
        self._found = found
        self._why_not = why_not

    def __getitem__(self, photo: Path) -> T:
        if photo in self._why_not:
            raise LookupError(self._why_not[photo])
        return self._found[photo]

    def __iter__(self) -> Iterator[Path]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)


def by_name(option: str, source: Path, photos: Sequence[Path], names: Mapping[str, T]) -> Beside[T]:
    """Look up each photo under its path, then under ever shorter ends of it."""
    keys: dict[Path, str] = {}
    why_not: dict[Path, str] = {}
    for photo in photos:
        key = next((end for end in ends_of(photo) if end in names), None)
        if key is None:
            some = ", ".join(list(names)[:3]) or "nothing"
            why_not[photo] = f"{source} does not name it; it names {some}{_more(len(names) - 3)}."
        else:
            keys[photo] = key
    why_not |= _shared(keys, lambda key: f'{source}, "{key}",')
    found = {photo: names[key] for photo, key in keys.items() if photo not in why_not}
    return Beside(option, found, why_not)


def by_stem(
    option: str, source: Path, photos: Sequence[Path], endings: Sequence[str]
) -> Beside[Path]:
    """Find the file of each photo: `source` itself for one photo, else by its name in a folder."""
    if source.is_file():
        if len(photos) > 1:
            msg = (
                f"{option} must be a folder, with a file for each of the {len(photos)} photos; got "
                f"the file {source}."
            )
            raise WrongUsageError(msg)
        return Beside(option, dict.fromkeys(photos, source), {})
    if not source.is_dir():
        msg = f"{option} must be a file or folder; there is no {source}."
        raise WrongUsageError(msg)
    found: dict[Path, Path] = {}
    why_not: dict[Path, str] = {}
    for photo in photos:
        there = _files_of(photo, source, endings)
        if not there:
            wanted = " or ".join(f"{photo.stem}{ending}" for ending in endings)
            why_not[photo] = f"{source} has no {wanted} for it."
        elif len(there) > 1:
            why_not[photo] = f"{source} has {', '.join(map(str, there))}; leave one for each photo."
        else:
            found[photo] = there[0]
    shared = _shared(found, str)
    found = {photo: file for photo, file in found.items() if photo not in shared}
    return Beside(option, found, why_not | shared)


def _files_of(photo: Path, folder: Path, endings: Sequence[str]) -> list[Path]:
    """Find a photo's files under the longest end of its path that is there."""
    for end in ends_of(photo)[1:]:
        beside = [folder / Path(end).with_suffix(ending) for ending in endings]
        there = [path for path in beside if path.is_file() and not _is_same(path, photo)]
        if there:
            return there
    return []


def _is_same(path: Path, photo: Path) -> bool:
    return photo.exists() and path.samefile(photo)


def _shared(keys: Mapping[Path, K], told: Callable[[K], str]) -> dict[Path, str]:
    """Tell of photos that have one key that nobody knows whose it is."""
    owners: dict[K, list[Path]] = {}
    for photo, key in keys.items():
        owners.setdefault(key, []).append(photo)
    why_not: dict[Path, str] = {}
    for key, sharing in owners.items():
        for photo, other in zip(sharing, [*sharing[1:], sharing[0]], strict=True):
            if photo != other:
                what = f"{told(key)} would serve {other} too"
                why_not[photo] = f"{what}; give them in folders as the photos are."
    return why_not


def _more(count: int) -> str:
    return f" and {count} more" if count > 0 else ""
