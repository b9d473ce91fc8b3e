"""Depth that another program has written to a file: PNG, NumPy, PFM or TIFF."""

from __future__ import annotations

import lzma
import math
import re
import zipfile
import zlib
from collections.abc import Callable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from imgscale._checks import as_image_size, check_choice, positive_number
from imgscale._depth_values import METRIC_SCALES, VALUE_KINDS
from imgscale._reading import check_limit, cut, decoding, in_file, number_of, open_file
from imgscale._typing import DepthKind, FloatArray
from imgscale.depth_map import DepthMap
from imgscale.errors import FileError

__all__ = ["read_depth", "read_values"]

_MAX_PIXELS = 200_000_000


def read_depth(
    path: str | PathLike[str],
    *,
    kind: DepthKind,
    scale: float | None = None,
    key: str | None = None,
    image_size: Sequence[int] | None = None,
    scale_rel_std: float = 0.0,
    max_pixels: int = _MAX_PIXELS,
) -> DepthMap:
    """
    Read a depth map from a file.

    Parameters
    ----------
    path : str or path-like
        The file, see `read_values`.
    kind : str
        What its values are, as in `DepthMap`. Disparity and distances along the ray need more:
        pass what `read_values` gives to `DepthMap.from_disparity` or `.from_ray_distance`.
    scale : float, optional
        Stored number that stands for 1 (metre), positive; needed where the file holds integers and
        the kind is "metric". Other kinds are known up to a factor anyway, which k takes up.
    key : str, optional
        Name of the array in an NPZ file of several.
    image_size : (width, height), optional
        Size of the image that boxes refer to, in pixels; the map's own size where omitted.
    scale_rel_std : float
        Relative standard error of the map's scale as a whole, >= 0.
    max_pixels : int
        As for `read_values`.

    Returns
    -------
    DepthMap
        The map.

    Raises
    ------
    FileError
        If the file cannot be a depth map; the message names it.
    OSError
        If there is no such file, or it may not be read.
    ValueError, TypeError
        If an argument breaks its law.

    See Also
    --------
    read_values : The numbers alone.

    Examples
    --------
    A map beside a picture is a depth source for `measure`:

    >>> from imgscale.depth_sources.files import read_depth
    >>> source = lambda image: read_depth("depth.png", kind="metric", scale=1000)
    """
    check_choice("kind", kind, VALUE_KINDS)
    as_image_size(image_size)
    if scale is None and kind != "metric":
        scale = 1.0
    values = read_values(path, scale=scale, key=key, max_pixels=max_pixels)
    with in_file(path):
        return DepthMap(values, kind=kind, image_size=image_size, scale_rel_std=scale_rel_std)


def read_values(
    path: str | PathLike[str],
    *,
    scale: float | None = None,
    key: str | None = None,
    max_pixels: int = _MAX_PIXELS,
) -> FloatArray:
    """
    Read the numbers of a depth or disparity file.

    ==========  ==================================================================
    ending      what is read
    ==========  ==================================================================
    .png        16-bit grey
    .npy        one array, never pickled objects
    .npz        the only array, or that named `key`
    .pfm        "Pf", either byte order; its rows, stored from the bottom up, are
                turned. The magnitude of its scale is ignored, as most readers do
    .tif .tiff  one grey page of floats or integers; LZW and other rare codecs need
                the package imagecodecs
    ==========  ==================================================================

    Parameters
    ----------
    path : str or path-like
        The file.
    scale : float, optional
        Stored number that stands for 1, positive, by which all are divided: KITTI 256,
        millimetres 1000, TUM 5000. Floats are taken as they are where omitted; integers need it.
    key : str, optional
        Name of the array in an NPZ file of several.
    max_pixels : int
        Most values that are read, above 0. A file that says that it has more is refused before
        memory is taken. The default takes 1.6 GB.

    Returns
    -------
    (H, W) ndarray of float64
        The values. NaN means missing: integers that are 0 or negative, and floats that are not
        finite.

    Raises
    ------
    FileError
        If the file is broken, of another format than its ending says, larger than `max_pixels`, a
        folder or pipe, or does not hold one channel of more than 8 bits. The message names it.
    OSError
        If there is no such file, or it may not be read.
    ValueError, TypeError
        If the ending is another, an argument breaks its law, or integers come without `scale`.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from imgscale import DepthMap
    >>> from imgscale.depth_sources.files import read_values
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "disparity.npy"
    ...     np.save(path, np.array([[5120, 0]], dtype=np.uint16))
    ...     disparity = read_values(path, scale=256)
    >>> disparity
    array([[20., nan]])
    >>> DepthMap.from_disparity(disparity, focal_px=700.0, baseline_m=0.5).values
    array([[17.5,  nan]])
    >>> read_values("depth.jpg")
    Traceback (most recent call last):
        ...
    ValueError: depth.jpg must end in .npy, .npz, .pfm, .png, .tif or .tiff; got '.jpg'.
    """
    ending = Path(path).suffix.lower()
    if ending not in _READERS:
        *most, last = sorted(_READERS)
        msg = f"{path} must end in {', '.join(most)} or {last}; got '{ending}'."
        raise ValueError(msg)
    if key is not None and ending != ".npz":
        msg = f"`key` must be omitted but for .npz files; got {key!r} for {path}."
        raise ValueError(msg)
    divisor = None if scale is None else positive_number("scale", scale)
    check_limit("max_pixels", max_pixels)
    stored = _decode(path, ending, _Asked(path, key, max_pixels))
    return _scaled(path, stored, divisor)


def _decode(path: str | PathLike[str], ending: str, asked: _Asked) -> NDArray[Any]:
    """Read a file; whatever a library says of a broken one, say which file it is."""
    with open_file(path) as file, decoding(path, ending[1:].upper()):
        return _READERS[ending](file, asked)


class _Asked(NamedTuple):
    """What is wanted of a file: the name of the file for messages, of an array, and a limit."""

    path: str | PathLike[str]
    key: str | None
    max_pixels: int

    def check(self, shape: Sequence[int], dtype: np.dtype[Any]) -> None:
        """
        Raise, before memory is taken, for what is no map of one channel or a huge one.

        Parameters
        ----------
        shape : sequence of int
            What the file says of its values.
        dtype : dtype
            Their type.

        Raises
        ------
        FileError
            If they are no such map.
        """
        if dtype.kind not in "fiu":
            msg = f"{self.path} must hold real numbers; got dtype {dtype}."
            raise FileError(msg)
        if len(shape) != 2 or 0 in shape:
            msg = (
                f"{self.path} must hold one channel, (H, W); got shape {tuple(shape)}. A picture "
                "in colour is for looking at; decode one that packs depth into colours by its own "
                "rule, and pass the values to DepthMap."
            )
            raise FileError(cut(msg))
        if dtype.itemsize == 1:
            msg = (
                f"{self.path} must hold more than 8 bits per pixel; got dtype {dtype}, a picture "
                "for looking at. Use the file with the values themselves."
            )
            raise FileError(msg)
        if math.prod(shape) > self.max_pixels:
            msg = (
                f"{self.path} must hold at most {self.max_pixels} values; got {shape[1]} x "
                f"{shape[0]}. Give a larger `max_pixels` where you trust it."
            )
            raise FileError(cut(msg))


def _scaled(path: str | PathLike[str], stored: NDArray[Any], divisor: float | None) -> FloatArray:
    """Divide by the scale and mark what is missing."""
    is_float = stored.dtype.kind == "f"
    if divisor is None and not is_float:
        msg = (
            f"`scale` must be given, as {path} holds integers ({stored.dtype}): the stored number "
            f"that stands for 1 metre or pixel. Usual ones: {METRIC_SCALES}."
        )
        raise ValueError(msg)
    with np.errstate(invalid="ignore"):  # of NaNs that signal
        values = stored.astype(np.float64)
    values[~np.isfinite(values) if is_float else stored <= 0] = np.nan
    return values / (divisor or 1.0)


def _read_png(file: BinaryIO, asked: _Asked) -> NDArray[Any]:
    """Decode a PNG; a palette gives its 8-bit indices, which are refused as such."""
    from PIL.PngImagePlugin import PngImageFile  # noqa: PLC0415 - 20 ms that few users need

    # not Image.open(), which has a limit of its own for all pictures of a program
    with PngImageFile(file) as image:
        grey = image.mode[0] in "1LPI" and len(image.getbands()) == 1
        shape = image.size[::-1] if grey else (*image.size[::-1], len(image.getbands()))
        asked.check(shape, _PNG_TYPES.get(image.mode, _PNG_TYPES["L"]))
        return np.asarray(image)


_PNG_TYPES = {
    "1": np.dtype(bool), "L": np.dtype(np.uint8), "P": np.dtype(np.uint8),
    "I": np.dtype(np.int32), "I;16": np.dtype(np.uint16),
}  # fmt: skip


def _read_npy(file: BinaryIO, asked: _Asked) -> NDArray[Any]:
    """Decode one array of numbers; pickled objects are not."""
    shape, dtype, by_columns = _npy_header(file)
    asked.check(shape, dtype)
    return _values(file, dtype, shape, order="F" if by_columns else "C")


# numpy writes one line; the parts are looked up one by one, as others write other spaces
_NPY_TYPE = re.compile(rb"""['"]descr['"]\s*:\s*['"]([^'"]{1,20})['"]""")
_NPY_ORDER = re.compile(rb"""['"]fortran_order['"]\s*:\s*(True|False)""")
_NPY_SHAPE = re.compile(rb"""['"]shape['"]\s*:\s*\(([\dL,\s]*)\)""")
_LONGEST_HEADER = 10_000  # as numpy's own


def _npy_header(file: BinaryIO) -> tuple[tuple[int, ...], np.dtype[Any], bool]:
    """Read the shape, type and order; numpy's own way is to evaluate a Python expression."""
    begin = file.read(8)
    wide = begin[6:7] != b"\x01"
    length = int.from_bytes(file.read(4 if wide else 2), "little")
    if begin[:6] != b"\x93NUMPY" or begin[6:] not in _NPY_VERSIONS:
        msg = "it must begin as numpy's files do, with a version from 1.0 to 3.0."
        raise ValueError(msg)
    if length > _LONGEST_HEADER:
        msg = f"its header must have at most {_LONGEST_HEADER} bytes; got {length}."
        raise ValueError(msg)
    header = file.read(length)
    found = [part.search(header) for part in (_NPY_TYPE, _NPY_ORDER, _NPY_SHAPE)]
    if len(header) < length or not all(found):
        msg = f"its header must tell a type of numbers, an order and a shape; got {header[:200]!r}."
        raise ValueError(msg)
    dtype, order, shape = (part[1].decode("ascii") for part in found if part)
    lengths = tuple(int(word) for word in shape.replace("L", "").split(",") if word.strip())
    return lengths, _numpy_type(dtype), order == "True"


_NPY_VERSIONS = (b"\x01\x00", b"\x02\x00", b"\x03\x00")


def _numpy_type(code: str) -> np.dtype[Any]:
    """Tell a type by its code; other codes than of one number each could mean anything."""
    if not re.fullmatch(r"[<>|=]?([?bO]|[biufcmMOSUV]\d*)", code):
        msg = f"it must hold real numbers; got dtype {code!r}."
        raise ValueError(msg)
    return np.dtype(code)


def _read_npz(file: BinaryIO, asked: _Asked) -> NDArray[Any]:
    """Decode the array of an archive which has the name or no neighbour."""
    with zipfile.ZipFile(file) as archive:
        members = [member.removesuffix(".npy") for member in archive.namelist()]
        key = members[0] if asked.key is None and len(members) == 1 else asked.key
        if key is None or members.count(key) != 1:
            listed = ", ".join(sorted(members)) or "(none)"
            msg = f"`key` must be one of its arrays, {listed}; got {asked.key!r}."
            raise ValueError(msg)
        with archive.open(archive.infolist()[members.index(key)]) as member:
            return _read_npy(cast("BinaryIO", member), asked)


def _values(
    file: BinaryIO, dtype: np.dtype[Any], shape: Sequence[int], order: Literal["C", "F"] = "C"
) -> NDArray[Any]:
    """Read exactly what is left of a file."""
    needed = math.prod(shape) * dtype.itemsize
    content = file.read(needed + 1)  # the end tells an archive's check sum
    if len(content) != needed:
        held = f"more than {needed}" if len(content) > needed else len(content)
        msg = f"{shape[1]} x {shape[0]} values must take {needed} bytes; got {held}."
        raise ValueError(msg)
    return np.frombuffer(content, dtype).reshape(shape, order=order)


# one white space ends the header; some writers end lines in two characters
_PFM_HEADER = re.compile(rb"(P[Ff])\s+(\d+)\s+(\d+)\s+(\S+)(?:\r\n|\s)")
_LONGEST_PFM_HEADER = 1000


def _read_pfm(file: BinaryIO, asked: _Asked) -> NDArray[Any]:
    """Decode a portable float map; a negative scale says that the lowest byte comes first."""
    header = _PFM_HEADER.match(file.read(_LONGEST_PFM_HEADER))
    if header is None:
        msg = "it must begin with Pf, width, height and scale."
        raise ValueError(msg)
    magic, width, height, word = header.groups()
    scale = number_of(word.decode("latin-1"))
    if not 0 < abs(scale) < math.inf:
        msg = (
            "its scale, whose sign tells the byte order, must be a number and must not be 0; got "
            f"{word[:100].decode('latin-1')}."
        )
        raise ValueError(msg)
    colours = () if magic == b"Pf" else (3,)
    shape = (int(height), int(width), *colours)
    dtype = np.dtype("<f4" if scale < 0 else ">f4")
    asked.check(shape, dtype)
    file.seek(header.end())
    return _values(file, dtype, shape)[::-1]


def _read_tiff(file: BinaryIO, asked: _Asked) -> NDArray[Any]:
    """Decode a page; the shape of all is checked before any is."""
    import tifffile  # noqa: PLC0415 - comes with scikit-image; few users need it

    library: Any = tifffile  # half typed
    with library.TiffFile(file) as tiff:
        series = tiff.series[0]
        asked.check(series.shape, series.dtype)
        page = series.keyframe
        told = (len(page.dataoffsets), len(page.databytecounts))
        is_cut = not page.is_contiguous and told != (math.prod(page.chunked),) * 2
        if is_cut or 0 in page.databytecounts or 0 in page.dataoffsets:
            msg = "parts of its values are missing."
            raise ValueError(msg)
        _check_swelling(file, page)
        return np.asarray(series.asarray())


_SWELLING: dict[int, Any] = {
    8: zlib.decompressobj, 32946: zlib.decompressobj, 34925: lzma.LZMADecompressor,
}  # fmt: skip


def _check_swelling(file: BinaryIO, page: Any) -> None:
    """Raise where a part swells to more than its share of the page; tifffile would let it."""
    if page.compression not in _SWELLING:
        return
    most = math.prod(page.chunks) * page.dtype.itemsize
    for offset, length in zip(page.dataoffsets, page.databytecounts, strict=True):
        file.seek(offset)
        swollen = _SWELLING[page.compression]().decompress(file.read(length), most + 1)
        if len(swollen) > most:
            msg = f"a part of it must hold at most {most} bytes; got more."
            raise ValueError(msg)


_READERS: dict[str, Callable[[BinaryIO, _Asked], NDArray[Any]]] = {
    ".npy": _read_npy,
    ".npz": _read_npz,
    ".pfm": _read_pfm,
    ".png": _read_png,
    ".tif": _read_tiff,
    ".tiff": _read_tiff,
}
