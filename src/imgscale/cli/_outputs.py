"""The files that results go into: written beside their place, and put there when they are whole."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from io import BytesIO, StringIO
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Protocol, TextIO, TypeAlias

import attrs

from imgscale._tables import as_cell
from imgscale._typing import ImageArray
from imgscale.cli._messages import WrongUsageError, complain, in_words
from imgscale.cli._photos import full_path
from imgscale.depth import GroundPlane
from imgscale.measurement import Measurement


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
    for folder in folders:
        if folder.is_dir() and folder.resolve() in (out.resolve(), *out.resolve().parents):
            msg = (
                f"--out must not put pictures into {folder}, whose photos are measured: {out} "
                "would be one of them next time."
            )
            raise WrongUsageError(msg)
    if len(photos) == 1:
        return {photos[0]: out}
    common = Path(os.path.commonpath([full_path(photo).parent for photo in photos]))
    named: dict[Path, Path] = {}
    for photo in photos:
        name = "_".join(full_path(photo).relative_to(common).with_suffix("").parts)
        picture = out.with_name(f"{out.stem}_{name}{out.suffix}")
        if picture in named.values():
            other = next(photo for photo, path in named.items() if path == picture)
            msg = f"--out must tell {other} from {photo}; both would be {picture}."
            raise WrongUsageError(msg)
        named[photo] = picture
    return named


# --- writing ---


# Names of files and labels may hold what UTF-8 has no letters for.
_TEXT: dict[str, Any] = {"encoding": "utf-8", "errors": "backslashreplace"}


class PartFile:
    """A file under another name, until it is whole; a link stays, and what it leads to changes."""

    def __init__(self, path: Path) -> None:
        self.path = path.resolve()
        self.part = self.path.with_name(f".{self.path.name}.{os.getpid()}.part")

    def put(self) -> None:
        """Give it its name."""
        self.part.replace(self.path)

    def drop(self) -> None:
        """Leave nothing behind."""
        self.part.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a whole file, or none."""
    _write(path, text.encode(**_TEXT))


def _write(path: Path, content: bytes) -> None:
    file = PartFile(path)
    try:
        file.part.write_bytes(content)
        file.put()
    finally:
        file.drop()


Put: TypeAlias = Callable[[], object]
"""Puts what is ready into its file."""


class Writer(Protocol):
    """Takes results as they come."""

    @property
    def out(self) -> Path:
        """What is written, for messages."""
        ...

    def prepare(self, result: Result) -> Put:
        """Make all of one more result; nothing is written before `Put` is called."""
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
        self.out = out
        self._style = style
        self._file = PartFile(out)
        self._opened = self._file.part.open("w", newline="", **_TEXT)
        self._rows(self._opened).writeheader()

    def prepare(self, result: Result) -> Put:
        text = StringIO()
        rows = self._rows(text)
        for row in result.measurement.table(unit=self._style.unit, level=self._style.level):
            cells = {"photo": str(result.photo), **row}
            rows.writerow({name: _cell(value) for name, value in cells.items()})
        return lambda: self._opened.write(text.getvalue())

    def _rows(self, file: TextIO) -> csv.DictWriter[str]:
        return csv.DictWriter(file, columns(self._style.unit), lineterminator="\n")

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
    return as_cell(value) if isinstance(value, str) else value


class JsonWriter:
    """One array, a record per photo."""

    def __init__(self, out: Path, style: Style) -> None:
        self.out = out
        self._style = style
        self._file = PartFile(out)
        self._opened = self._file.part.open("w", **_TEXT)
        self._opened.write("[")
        self._next = "\n"

    def prepare(self, result: Result) -> Put:
        unit, level = self._style
        objects = {"level": level, "objects": result.measurement.table(unit=unit, level=level)}
        text = json.dumps(result.measurement.to_dict() | objects, allow_nan=False)
        return lambda: self._put(text)

    def _put(self, text: str) -> None:
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

    def __init__(self, out: Path, pictures: Mapping[Path, Path], style: Style) -> None:
        self.out = out
        self._pictures = pictures
        self._style = style

    def prepare(self, result: Result) -> Put:
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
        drawn = BytesIO()
        figure.savefig(drawn, format="png")
        return lambda: _write(self._pictures[result.photo], drawn.getvalue())

    def finish(self) -> None:
        """Every picture is in its place already."""

    def drop(self) -> None:
        """Nothing is left half done."""


class PageWriter:
    """One page of all photos."""

    def __init__(self, out: Path, style: Style, title: str = "How big is it?") -> None:
        self.out, self._style, self._title = out, style, title
        self._results: list[tuple[Measurement, Path | ImageArray]] = []

    def prepare(self, result: Result) -> Put:
        # neither depth maps nor pixels of a thousand photos are kept; the page needs no depth
        plane = GroundPlane(image_size=result.measurement.image_size)
        light = attrs.evolve(
            result.measurement,
            depth=plane,
            detections=tuple(attrs.evolve(one, mask=None) for one in result.measurement.detections),
        )
        on_disk = result.photo.is_file()
        picture = result.photo if on_disk else result.image
        return lambda: self._results.append((light, picture))

    def finish(self) -> None:
        from imgscale.report import html_page  # noqa: PLC0415 - matplotlib takes its time

        unit, level = self._style
        write_text(self.out, html_page(self._results, title=self._title, unit=unit, level=level))

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

    def prepare(self, result: Result) -> Put:
        """Make what all will write of a result; what goes wrong in that concerns it alone."""
        ready = [(writer.out, writer.prepare(result)) for writer in self._writers]
        return lambda: self._put(ready)

    def _put(self, ready: Iterable[tuple[Path, Put]]) -> None:
        for out, put in ready:
            with _named(out):
                put()
        self._count += 1

    def finish(self) -> bool:
        """
        Put the files in their places; where nothing was measured, old ones stay.

        One that fails is named, and the others follow, pages last: they are made only now.
        """
        is_done = True
        for writer in sorted(self._writers, key=_is_page) if self._count else ():
            try:
                with _named(writer.out):
                    writer.finish()
            except BrokenPipeError:
                raise
            except Exception as error:  # noqa: BLE001 - whatever it is, the others are whole
                complain(in_words(error))
                is_done = False
        return is_done

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
        /,
    ) -> None:
        for writer in self._writers:
            with suppress(OSError):  # what could not be written cannot be flushed
                writer.drop()


def _is_page(writer: Writer) -> bool:
    return isinstance(writer, PageWriter)


@contextmanager
def _named(out: Path) -> Generator[None]:
    """Name the file in an error of the disk."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(out)) from error
