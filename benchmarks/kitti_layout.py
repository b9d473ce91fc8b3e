"""Where a folder in the native layout of KITTI's object benchmark has its parts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

_WITHIN = (".", "training", "object/training")


class LayoutError(Exception):
    """A folder or file is not what KITTI's layout has there."""


@dataclass(frozen=True)
class Folders:
    """The parts; None where there is no such part."""

    labels: Path
    calib: Path
    images: Path
    frames: Path | None
    lidar: Path | None
    detections: Path | None


def find_folders(root: Path) -> Folders:
    """Find the parts in and around a folder."""
    root = root.resolve()
    places = [Path(inner) / "label_2" for inner in _WITHIN]
    labels = _first(root / place for place in places)
    if labels is None or not labels.is_dir():
        msg = f"no labels: {root} has no folder {', '.join(map(str, places))}."
        raise LayoutError(msg)
    training = labels.parent
    return Folders(
        labels=labels,
        calib=training / "calib",
        images=training / "image_2",
        frames=_first(path / "frames.csv" for path in (root, root.parent, training.parent)),
        lidar=_first([training / "lidar_depth"]),
        detections=_first(path / "detections" for path in (root, *list(labels.parents)[:3])),
    )


def read_lines(path: Path) -> list[str]:
    """Read the lines of a text file."""
    try:
        return path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        msg = f"{path} cannot be read: {error}."
        raise LayoutError(msg) from error


def _first(paths: Iterable[Path]) -> Path | None:
    """Return the first path that exists."""
    return next((path for path in paths if path.exists()), None)
