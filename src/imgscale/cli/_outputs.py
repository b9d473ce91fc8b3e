"""The files that results go into: written beside their place, and put there when they are whole."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Protocol

import attrs

from imgscale._typing import ImageArray
from imgscale.cli._messages import WrongUsageError
from imgscale.depth import GroundPlane
from imgscale.measurement import Measurement

_BEGIN_FORMULA = ("=", "+", "-", "@", "\t", "\r")


class Result(NamedTuple):
    """A photo that was measured."""

    photo: Path
    measurement: Measurement
    image: ImageArray


class Style(NamedTuple):
    """How sizes are told."""

    unit: str
    level: float


# --- where results may go ---


def check_out(out: Path, endings: Sequence[str]) -> None:
    """Raise unless something of a known kind can be written there."""
    if out.suffix.lower() not in endings:
        msg = f"--out must end in {' or '.join(endings)}; got {out}."
        raise WrongUsageError(msg)
    if out.is_dir():
        msg = f"--out must be a file; {out} is a folder."
        raise WrongUsageError(msg)
    if not out.parent.is_dir():
        msg = f"--out must be in a folder that exists; there is no {out.parent}."
        raise WrongUsageError(msg)
    if not os.access(out.parent, os.W_OK):
        msg = f"--out must be in a folder that can be written to; {out.parent} cannot."
        raise WrongUsageError(msg)


def check_is_no_input(outs: Iterable[Path], inputs: Iterable[Path | None]) -> None:
    """Raise where a result would take the place of what it is made from, or of another."""
    known = {_identity(path): path for path in inputs if path is not None and path.exists()}
    taken: set[Path] = set()
    for out in outs:
        if out.resolve() in taken:
            msg = f"--out must name each file once; got {out} twice."
            raise WrongUsageError(msg)
        taken.add(out.resolve())
        if out.exists() and _identity(out) in known:
            same = known[_identity(out)]
            msg = f"--out must not be an input; {out} is {'one' if same == out else same}."
            raise WrongUsageError(msg)


def _identity(path: Path) -> tuple[int, int]:
    """Tell a file whatever it is called by."""
    status = path.stat()
    return (status.st_dev, status.st_ino)


def pictures_for(out: Path, photos: Sequence[Path], folders: Sequence[Path]) -> dict[Path, Path]:
    """
    Name the picture of each photo: `out` for one, ``out_<photo>.png`` for several.

    A photo in a folder's subfolder has that in its name.
    """
    if len(photos) == 1:
        return {photos[0]: out}
    for folder in folders:
        if folder.is_dir() and folder.resolve() in (out.resolve(), *out.resolve().parents):
            msg = (
                f"--out must not put pictures into {folder}, whose photos are measured: {out} "
                "would be one of them next time."
            )
            raise WrongUsageError(msg)
    common = Path(os.path.commonpath([photo.resolve().parent for photo in photos]))
    named: dict[Path, Path] = {}
    for photo in photos:
        name = "_".join(photo.resolve().relative_to(common).with_suffix("").parts)
        picture = out.with_name(f"{out.stem}_{name}{out.suffix}")
        if picture in named.values():
            other = next(photo for photo, path in named.items() if path == picture)
            msg = f"--out must tell {other} from {photo}; both would be {picture}."
            raise WrongUsageError(msg)
        named[photo] = picture
    return named


# --- writing ---


class PartFile:
    """A file under another name, until it is whole."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.part = path.with_name(f".{path.name}.{os.getpid()}.part")

    def put(self) -> None:
        """Give it its name."""
        self.part.replace(self.path)

    def drop(self) -> None:
        """Leave nothing behind."""
        self.part.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a whole file, or none."""
    file = PartFile(path)
    try:
        file.part.write_text(text, encoding="utf-8")
        file.put()
    finally:
        file.drop()


class Writer(Protocol):
    """Takes results as they come."""

    def add(self, result: Result) -> None:
        """Take one more."""
        ...

    def finish(self) -> None:
        """Put the file in its place."""
        ...

    def drop(self) -> None:
        """Remove what is not finished."""
        ...


class CsvWriter:
    """One row per object."""

    def __init__(self, out: Path, style: Style) -> None:
        self._style = style
        self._file = PartFile(out)
        self._opened = self._file.part.open("w", encoding="utf-8", newline="")
        self._rows = csv.DictWriter(self._opened, columns(style.unit), lineterminator="\n")
        self._rows.writeheader()

    def add(self, result: Result) -> None:
        table = result.measurement.table(unit=self._style.unit, level=self._style.level)
        for row in table:
            cells = {"photo": str(result.photo), **row}
            self._rows.writerow({name: _cell(value) for name, value in cells.items()})

    def finish(self) -> None:
        self._opened.close()
        self._file.put()

    def drop(self) -> None:
        self._opened.close()
        self._file.drop()


def columns(unit: str) -> tuple[str, ...]:
    """Name the columns of a table of sizes: the photo, and what `Measurement.table` has."""
    sizes = (f"{name}_{unit}" for name in ("size", "low", "high"))
    return (
        *("photo", "label", "axis", *sizes, "distance_m", "x1", "y1", "x2", "y2"),
        *("score", "track_id", "flags", "model_flags"),
    )


def _cell(value: object) -> object:
    """Keep a spreadsheet from taking a text for a formula."""
    is_formula = isinstance(value, str) and value.startswith(_BEGIN_FORMULA)
    return f"'{value}" if is_formula else value


class JsonWriter:
    """One array, a record per photo."""

    def __init__(self, out: Path, style: Style) -> None:
        self._style = style
        self._file = PartFile(out)
        self._opened = self._file.part.open("w", encoding="utf-8")
        self._opened.write("[")
        self._next = "\n"

    def add(self, result: Result) -> None:
        unit, level = self._style
        objects = {"level": level, "objects": result.measurement.table(unit=unit, level=level)}
        text = json.dumps(result.measurement.to_dict() | objects, allow_nan=False)
        self._opened.write(f"{self._next}{text}")
        self._next = ",\n"

    def finish(self) -> None:
        self._opened.write("\n]\n")
        self._opened.close()
        self._file.put()

    def drop(self) -> None:
        self._opened.close()
        self._file.drop()


class PictureWriter:
    """One picture per photo, there as soon as it is drawn."""

    def __init__(self, pictures: Mapping[Path, Path], style: Style) -> None:
        self._pictures = pictures
        self._style = style

    def add(self, result: Result) -> None:
        from imgscale.plotting import draw_sizes  # noqa: PLC0415 - matplotlib takes its time

        found = result.measurement
        axes = draw_sizes(
            result.image,
            found.detections,
            found.estimates,
            model=found.model,
            unit=self._style.unit,
            level=self._style.level,
        )
        figure: Any = axes.figure
        file = PartFile(self._pictures[result.photo])
        try:
            figure.savefig(file.part, format="png")
            file.put()
        finally:
            file.drop()

    def finish(self) -> None:
        """Every picture is in its place already."""

    def drop(self) -> None:
        """Nothing is left half done."""


class PageWriter:
    """One page of all photos."""

    def __init__(self, out: Path, style: Style, title: str = "How big is it?") -> None:
        self._out, self._style, self._title = out, style, title
        self._results: list[tuple[Measurement, Path | ImageArray]] = []

    def add(self, result: Result) -> None:
        # neither depth maps nor pixels of a thousand photos are kept; the page needs no depth
        plane = GroundPlane(image_size=result.measurement.image_size)
        light = attrs.evolve(
            result.measurement,
            depth=plane,
            detections=tuple(attrs.evolve(one, mask=None) for one in result.measurement.detections),
        )
        on_disk = result.photo.is_file()
        self._results.append((light, result.photo if on_disk else result.image))

    def finish(self) -> None:
        from imgscale.report import html_page  # noqa: PLC0415 - matplotlib takes its time

        unit, level = self._style
        write_text(self._out, html_page(self._results, title=self._title, unit=unit, level=level))

    def drop(self) -> None:
        """Nothing is written before the end."""


ENDINGS = (".csv", ".json", ".png", ".html")


class Writers(AbstractContextManager["Writers"]):
    """All files of a run; what is not finished at the end of the block is removed."""

    def __init__(self) -> None:
        self._writers: list[Writer] = []
        self._count = 0

    def take(self, writer: Writer) -> None:
        """Take one more file."""
        self._writers.append(writer)

    def add(self, result: Result) -> None:
        """Hand a result to all."""
        for writer in self._writers:
            writer.add(result)
        self._count += 1

    def finish(self) -> None:
        """Put the files in their places; where nothing was measured, old ones stay."""
        for writer in self._writers if self._count else ():
            writer.finish()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
        /,
    ) -> None:
        for writer in self._writers:
            writer.drop()
