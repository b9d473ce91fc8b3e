"""Depth that another program has written to a file: PNG, NumPy, PFM or TIFF."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from imgscale._checks import positive_number, within
from imgscale._depth_values import METRIC_SCALES
from imgscale._typing import DepthKind, FloatArray
from imgscale.depth_map import DepthMap

__all__ = ["read_depth", "read_values"]


def read_depth(
    path: str | PathLike[str],
    *,
    kind: DepthKind,
    scale: float | None = None,
    key: str | None = None,
    image_size: Sequence[int] | None = None,
    scale_rel_std: float = 0.0,
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

    Returns
    -------
    DepthMap
        The map.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file cannot be a depth map, or an argument breaks its law.

    See Also
    --------
    read_values : The numbers alone.

    Examples
    --------
    A map beside a picture is a depth source for `measure`:

    >>> from imgscale.depth_sources.files import read_depth
    >>> source = lambda image: read_depth("depth.png", kind="metric", scale=1000)
    """
    if scale is None and kind != "metric":
        scale = 1.0
    values = read_values(path, scale=scale, key=key)
    with within(path):
        return DepthMap(values, kind=kind, image_size=image_size, scale_rel_std=scale_rel_std)


def read_values(
    path: str | PathLike[str], *, scale: float | None = None, key: str | None = None
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

    Returns
    -------
    (H, W) ndarray of float64
        The values. NaN means missing: integers that are 0 or negative, and floats that are not
        finite.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the ending is another, the file is broken or of another format than it says, or does not
        hold one channel of more than 8 bits, or integers come without `scale`.

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
    stored = _decode(path, ending, key)
    _check_is_one_channel(path, stored)
    return _scaled(path, stored, divisor)


def _decode(path: str | PathLike[str], ending: str, key: str | None) -> NDArray[Any]:
    """Read a file; whatever a library says of a broken one, say which file it is."""
    with Path(path).open("rb") as file:
        try:
            return _READERS[ending](file, key)
        except Exception as error:
            msg = f"{path} cannot be read as {ending[1:].upper()}: {error}"
            raise ValueError(msg) from error


def _check_is_one_channel(path: str | PathLike[str], stored: NDArray[Any]) -> None:
    if stored.dtype.kind not in "fiu":
        msg = f"{path} must hold real numbers; got dtype {stored.dtype}."
        raise ValueError(msg)
    if stored.ndim != 2 or stored.size == 0:
        msg = (
            f"{path} must hold one channel, (H, W); got shape {stored.shape}. A picture in colour "
            "is for looking at; decode one that packs depth into colours by its own rule, and "
            "pass the values to DepthMap."
        )
        raise ValueError(msg)
    if stored.dtype.itemsize == 1:
        msg = (
            f"{path} must hold more than 8 bits per pixel; got dtype {stored.dtype}, a picture for "
            "looking at. Use the file with the values themselves."
        )
        raise ValueError(msg)


def _scaled(path: str | PathLike[str], stored: NDArray[Any], divisor: float | None) -> FloatArray:
    """Divide by the scale and mark what is missing."""
    is_float = stored.dtype.kind == "f"
    if divisor is None and not is_float:
        msg = (
            f"`scale` must be given, as {path} holds integers ({stored.dtype}): the stored number "
            f"that stands for 1 metre or pixel. Usual ones: {METRIC_SCALES}."
        )
        raise ValueError(msg)
    values = stored.astype(np.float64)
    values[~np.isfinite(values) if is_float else stored <= 0] = np.nan
    return values / (divisor or 1.0)


def _read_png(file: BinaryIO, _: str | None) -> NDArray[Any]:
    """Decode a PNG; a palette gives its 8-bit indices, which are refused as such."""
    from PIL import Image  # noqa: PLC0415 - 20 ms that most users do not need

    with Image.open(file, formats=("PNG",)) as image:
        return np.asarray(image)


def _read_numpy(file: BinaryIO, key: str | None) -> NDArray[Any]:
    """Decode an array, or that of an archive which has the name or no neighbour."""
    loaded: Any = np.load(file, allow_pickle=False)
    if not hasattr(loaded, "files"):
        return np.asarray(loaded)
    names: list[str] = loaded.files
    name = names[0] if key is None and len(names) == 1 else key
    if name not in names:
        msg = (
            f"`key` must be one of its arrays, {', '.join(sorted(names)) or '(none)'}; got {key!r}."
        )
        raise ValueError(msg)
    return np.asarray(loaded[name])


# one white space ends the header; some writers end lines in two characters
_PFM_HEADER = re.compile(rb"(P[Ff])\s+(\d+)\s+(\d+)\s+(\S+)(?:\r\n|\s)")


def _read_pfm(file: BinaryIO, _: str | None) -> NDArray[Any]:
    """Decode a portable float map; a negative scale says that the lowest byte comes first."""
    content = file.read()
    header = _PFM_HEADER.match(content)
    if header is None:
        msg = "it must begin with Pf, width, height and scale."
        raise ValueError(msg)
    magic, width, height, scale = header.groups()
    if not abs(float(scale)) > 0:
        msg = f"its scale, whose sign tells the byte order, must not be 0; got {float(scale)}."
        raise ValueError(msg)
    shape = (int(height), int(width), 1 if magic == b"Pf" else 3)
    dtype = np.dtype("<f4" if float(scale) < 0 else ">f4")
    needed, held = int(np.prod(shape)) * dtype.itemsize, len(content) - header.end()
    if needed != held:
        msg = f"{shape[1]} x {shape[0]} values must take {needed} bytes; got {held}."
        raise ValueError(msg)
    rows = np.frombuffer(content, dtype, offset=header.end()).reshape(shape)[::-1]
    return rows[:, :, 0] if magic == b"Pf" else rows


def _read_tiff(file: BinaryIO, _: str | None) -> NDArray[Any]:
    import tifffile  # noqa: PLC0415 - comes with scikit-image; few users need it

    imread: Any = tifffile.imread  # half typed there
    return np.asarray(imread(file))


_READERS: dict[str, Callable[[BinaryIO, str | None], NDArray[Any]]] = {
    ".npy": _read_numpy,
    ".npz": _read_numpy,
    ".pfm": _read_pfm,
    ".png": _read_png,
    ".tif": _read_tiff,
    ".tiff": _read_tiff,
}
