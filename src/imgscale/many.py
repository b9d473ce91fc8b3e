"""The whole chain on many pictures: as a stream, past bad files, and to be resumed."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Sized
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from os import PathLike, fsdecode
from pathlib import PurePath
from typing import Any, Generic, Never, TypedDict, TypeVar, Unpack, cast

import attrs

from imgscale import record as records
from imgscale._checks import check_choice, check_iterable, check_type
from imgscale._typing import FitMethod, ImageArray, SizeAxis
from imgscale.camera import Camera
from imgscale.depth import Depth, GroundPlane
from imgscale.detection import Detection
from imgscale.fitting import check_options
from imgscale.measurement import Measurement
from imgscale.noise import Noise
from imgscale.object_prior import SIZE_AXES
from imgscale.pipeline import measure
from imgscale.priors import PriorTable
from imgscale.protocols import DepthSource, Detector

__all__ = ["Outcome", "measure_many"]

T = TypeVar("T")


class MeasureOptions(TypedDict, total=False):
    """The keyword arguments of `measure` that `measure_many` passes on."""

    priors: PriorTable | None
    ground: GroundPlane | None
    camera: Camera | None
    method: FitMethod
    noise: Noise
    axis: SizeAxis
    use_prior: bool


@attrs.frozen(kw_only=True)
class Outcome:
    """
    What became of one picture: a measurement, or the error that prevented it.

    Attributes
    ----------
    path : str
        The picture.
    measurement : Measurement or None
        What was measured; None where it failed.
    error : Exception or None
        Why it failed; None where it did not.

    Raises
    ------
    ValueError
        If both or none is given.
    """

    path: str
    measurement: Measurement | None = None
    error: Exception | None = attrs.field(default=None, eq=False)

    def __attrs_post_init__(self) -> None:
        if (self.measurement is None) == (self.error is None):
            msg = "`measurement` or `error` must be given, and not both."
            raise ValueError(msg)

    def to_dict(self) -> dict[str, Any]:
        """
        Turn the outcome into built-in types that `json` writes.

        Returns
        -------
        dict
            ``path``, and either ``error`` (``type`` and ``message``) or ``k``, ``k_std``,
            ``shift``, ``kind``, ``flags`` and ``objects`` (what `Measurement.table` gives).
        """
        if self.measurement is None:
            error = {"type": type(self.error).__name__, "message": _message(self.error)}
            return {"path": self.path, "error": error}
        model = self.measurement.model.to_dict()
        kept = {name: model[name] for name in ("k", "k_std", "shift", "kind", "flags")}
        return {"path": self.path, **kept, "objects": self.measurement.table()}


def measure_many(
    paths: Iterable[str | PathLike[str]],
    *,
    detector: Detector | Mapping[str, Sequence[Detection]],
    depth_source: DepthSource | Mapping[str, Depth],
    record: str | PathLike[str] | None = None,
    progress: bool = True,
    **options: Unpack[MeasureOptions],
) -> Iterator[Outcome]:
    """
    Size everything in many pictures, one after the other.

    Parameters
    ----------
    paths : iterable of path
        The pictures.
    detector : Detector or mapping of str to sequence of Detection
        Gives the detections of an RGB array; or detections made before, by picture, as
        `imgscale.detectors.read_coco` and its like give them. A picture is looked up under its
        path, then under ever shorter ends of it, down to the file's name; an entry that would
        serve two pictures is an error of the second.
    depth_source : DepthSource or mapping of str to depth
        Gives the depth of an RGB array; or depths by picture, looked up in the same way.
    record : path, optional
        A file to which the results are appended as JSON lines, one per picture as soon as it is
        done, after a first line with the options, and with the detector and depth source where
        these are objects of this package; your own functions cannot be written down, so keep them
        the same. Where the file exists, pictures that it holds, by their paths as given, are
        skipped. Those that failed are tried again, but for a `FitError`, which would come again:
        too few objects of known size. `read_record` reads the file.
    progress : bool
        Show a progress bar on standard error where `tqdm` is installed and that is a terminal.
    **options
        As for `measure`: ``priors``, ``ground``, ``camera``, ``method``, ``noise``, ``axis``,
        ``use_prior``.

    Returns
    -------
    iterator of Outcome
        One per picture that is not in the record yet, in the order of the paths. A picture that
        fails gives an outcome with its error, and the next one follows.

    Raises
    ------
    TypeError
        If an argument is of the wrong type.
    ValueError
        If an option breaks its law, or the record was made with other options or is no record.
    OSError
        If the record cannot be read or written.

    Examples
    --------
    >>> import imgscale as ims
    >>> for outcome in ims.measure_many(
    ...     ["missing.jpg"],
    ...     detector=lambda image: [],
    ...     depth_source=lambda image: ims.GroundPlane(image_size=image.shape[1::-1]),
    ... ):
    ...     print(outcome.path, type(outcome.error).__name__)
    missing.jpg FileNotFoundError
    """
    if isinstance(paths, (str, bytes, PathLike)):
        msg = f"`paths` must be a sequence of paths; got {paths!r} alone. Put it in a list."
        raise TypeError(msg)
    check_iterable("paths", paths, "path")
    check_type("progress", progress, bool)
    _check(detector, depth_source, options)
    done: frozenset[str] = frozenset()
    if record is not None:
        done = records.resume(record, _plain(detector, depth_source, options))
    return _outcomes(paths, done, detector, depth_source, record, options, progress=progress)


def _outcomes(
    paths: Iterable[Any],
    done: frozenset[str],
    detector: Detector | Mapping[str, Sequence[Detection]],
    depth_source: DepthSource | Mapping[str, Depth],
    record: str | PathLike[str] | None,
    options: MeasureOptions,
    *,
    progress: bool,
) -> Iterator[Outcome]:
    detections, depths = _Made("detector", detector), _Made("depth_source", depth_source)
    for path in _with_progress(paths) if progress else paths:
        is_path = isinstance(path, (str, PathLike))
        name = fsdecode(cast("str | PathLike[str]", path)) if is_path else repr(path)
        if name in done:
            with suppress(LookupError):  # what served it may not serve another
                _ = detections(name), depths(name)
            continue
        try:
            if not is_path:
                _refuse(name)
            found = measure(path, detector=detections(name), depth_source=depths(name), **options)
            outcome = Outcome(path=name, measurement=found)
        except Exception as error:  # noqa: BLE001 - whatever one picture raises, the next follows
            _let_go(error)
            outcome = Outcome(path=name, error=error)
        if record is not None:
            records.append(record, outcome.to_dict())
        yield outcome


def _message(error: Exception | None) -> str:
    """Write what an error says, if it says anything; whoever made it may have made it badly."""
    try:
        return str(error)
    except Exception:  # noqa: BLE001 - the next picture follows
        return ""


def _refuse(item: str) -> Never:
    msg = f"`paths` must hold paths, strings or path-like objects; got {item}."
    raise TypeError(msg)


def _let_go(error: BaseException | None) -> None:
    """Free what the frames of an error hold: pictures, which outcomes would keep in memory."""
    while error:
        traceback.clear_frames(error.__traceback__)
        error = error.__cause__ or error.__context__


def _check(detector: object, depth_source: object, options: MeasureOptions) -> None:
    """Raise what every picture would raise before the first is read."""
    for name, source in (("detector", detector), ("depth_source", depth_source)):
        if isinstance(source, Mapping):
            key: object = next(iter(cast("Mapping[object, object]", source)), "")
            if not isinstance(key, str):
                msg = f"`{name}` must have paths for keys, as strings; got {key!r}."
                raise TypeError(msg)
        elif not callable(source):
            msg = (
                f"`{name}` must be a function of the picture, or a mapping from pictures' paths; "
                f"got {type(source).__name__}."
            )
            raise TypeError(msg)
    unknown = options.keys() - MeasureOptions.__annotations__.keys()
    if unknown:
        msg = f"`options` must be those of `measure`; got {', '.join(sorted(unknown))}."
        raise TypeError(msg)
    check_options(
        options.get("priors"),
        options.get("ground"),
        options.get("camera"),
        options.get("method", "posterior"),
        options.get("noise", Noise()),
    )
    check_choice("axis", options.get("axis", "height"), SIZE_AXES)
    check_type("use_prior", options.get("use_prior", False), bool)


def _plain(detector: object, depth_source: object, options: MeasureOptions) -> dict[str, Any]:
    """Write the options down so that another run can be compared with them."""
    values: dict[str, Any] = {"method": "posterior", "axis": "height", "use_prior": False}
    values |= options
    table: PriorTable | None = values.pop("priors", None)
    rows = PriorTable.default() if table is None else table
    values["priors"] = [attrs.asdict(row) for row in rows]
    for name in ("camera", "ground", "noise"):
        value = values.get(name, Noise() if name == "noise" else None)
        values[name] = None if value is None else attrs.asdict(value)
    for name, source in (("detector", detector), ("depth_source", depth_source)):
        values[name] = repr(source) if attrs.has(type(source)) else None
    return values


class _Made(Generic[T]):
    """A function of the picture, or what was made for each picture before."""

    def __init__(self, name: str, source: Callable[[ImageArray], T] | Mapping[str, T]) -> None:
        self._name = name
        self._source = source
        self._asked: dict[str, str] = {}  # which picture each key served

    def __call__(self, path: str) -> Callable[[ImageArray], T]:
        """Give the function for one picture, or one that returns what was made for it."""
        if callable(self._source):
            return self._source
        found = self._source[self._key(path, self._source)]

        def known(_: ImageArray) -> T:
            return found

        return known

    def _key(self, path: str, source: Mapping[str, T]) -> str:
        """Find the key of a picture: its path, or the longest end of it that is there."""
        parts = PurePath(path).parts
        ends = ("/".join(parts[start:]) for start in range(len(parts)))
        key = next((key for key in (path, *ends) if key in source), None)
        if key is None:
            some = ", ".join(f'"{key}"' for key in list(source)[:3]) or "nothing"
            msg = f"`{self._name}` must hold the picture {path}, or its file name; got {some}..."
            raise LookupError(msg)
        other = self._asked.setdefault(key, path)
        if other != path:
            msg = (
                f'`{self._name}` must tell {path} from {other}; got one entry for both, "{key}". '
                "Give it keys with the pictures' folders."
            )
            raise LookupError(msg)
        return key


def _with_progress(paths: Iterable[T]) -> Iterable[T]:
    """Show how far it is, where there is something to show it with."""
    if not find_spec("tqdm"):
        return paths
    total = len(paths) if isinstance(paths, Sized) else None
    tqdm: Any = import_module("tqdm")
    bar: Iterable[T] = tqdm.tqdm(paths, total=total, unit="picture", disable=None)
    return bar
