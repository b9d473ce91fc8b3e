"""
Faces, out of the box: the cascade of local binary patterns that scikit-image carries.

Nothing is downloaded and no extra is needed. The cascade knows upright faces that look at the
camera. It says yes or no to square windows, and windows of different sizes agree on one face: their
mean is its box, about 2.5 times as wide as its pupils are apart. For that box, and no other, the
shipped table of sizes has the label "lbp frontal face".
"""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple, cast

import attrs
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from imgscale._checks import as_float, is_between, number_error
from imgscale._typing import BoolArray, Box, FloatArray, ImageArray
from imgscale.detection import Detection
from imgscale.detectors._convert import make_detection
from imgscale.picture import upright_rgb

__all__ = ["LABEL", "FaceDetector"]

LABEL = "lbp frontal face"

# The box depends on all of these by some per cent, and the prior holds for them: no options.
_WINDOW_PX = 24  # the cascade was trained on windows of this size
_SEARCHED_PX = 32  # the smallest faces in the picture that is searched: windows start at 3/4
_MEASURED_PX = 72  # every face in the crop on which it is measured
_MARGIN = 1.25  # half a crop, in faces
_SMALLEST, _LARGEST = 0.6, 1.8  # windows on a crop, in faces
_SEARCH_STEP, _MEASURE_STEP = 1.1, 1.05  # from one window's size to the next
_SEARCH_STRIDE, _MEASURE_STRIDE = 1.5, 1.0  # of windows, in pixels of the trained window
# Two faces in 72 views had 4 to 16 windows in the search and 30 to 50 on the crop. Other places had
# up to 25 there in these views, and in 70 pictures without a face 29 and 35 in two, else up to 15.
_SEARCH_WINDOWS, _MEASURE_WINDOWS = 3, 27
_NEAR, _ALIKE = 0.3, 1.5  # windows of one face: distance of centres in windows, ratio of sizes
_APART = 0.6  # faces: distance of centres in faces


class _Square(NamedTuple):
    """What windows agree on: centre and size in pixels, and how many they are."""

    x: float
    y: float
    size: float
    windows: int


def _check_share(_: object, attribute: attrs.Attribute[Any], value: float) -> None:
    if not (is_between(value, 0, 1) and value):
        raise number_error(attribute.name, "above 0 and at most 1", value)


@attrs.frozen(kw_only=True)
class FaceDetector:
    """
    Find frontal faces with the cascade that scikit-image carries.

    Attributes
    ----------
    min_share : float
        The smallest faces to find, as a share of the picture's shorter side, above 0 to 1. The time
        grows as 1 / `min_share` squared, whatever the size of the picture. Faces of less than about
        32 px are not found.
    max_share : float
        The largest faces to find, as a share of the shorter side, above 0 to 1.

    Raises
    ------
    ValueError
        If a share breaks its law, or the smallest is above the largest.

    Notes
    -----
    The picture is searched coarsely. Every place found is then measured on a crop in which the face
    has a fixed size: the box is the mean of the windows there, of their centres and of the
    logarithms of their sizes. The size of the box varies by 2 % over shifts and rescalings of one
    picture, where scikit-image's own merging of windows, which also depends on their order, varies
    by 4 to 10 %. Faces turned aside or tilted are not found, or not measured well: look at the
    detections before you trust the scale.

    Examples
    --------
    >>> import skimage as ski
    >>> from imgscale.detectors.face import FaceDetector
    >>> detect = FaceDetector()
    >>> [face] = detect(ski.data.astronaut())
    >>> face.label, [round(number) for number in face.xyxy]
    ('lbp frontal face', [175, 67, 274, 167])
    >>> detect(ski.data.chelsea())  # a cat
    []
    """

    min_share: float = attrs.field(default=0.08, converter=as_float, validator=_check_share)
    max_share: float = attrs.field(default=1.0, converter=as_float, validator=_check_share)

    def __attrs_post_init__(self) -> None:
        if self.min_share > self.max_share:
            law = f"at most `max_share`, {self.max_share}"
            raise number_error("min_share", law, self.min_share)  # noqa: EM101 - a name

    def __call__(self, image: ImageArray, /) -> list[Detection]:
        """
        Detect faces.

        Parameters
        ----------
        image : (H, W, 3) or (H, W) ndarray of uint8
            The picture, RGB or grey, with its orientation applied.

        Returns
        -------
        list of Detection
            Labelled "lbp frontal face", the surest first, all within the picture. The cascade tells
            no score: it is 1.

        Raises
        ------
        TypeError, ValueError
            If `image` is no such picture.
        """
        picture = _grey(image)
        shorter = min(picture.size)
        measured = [_measured(picture, seed) for seed in _searched(picture, self.min_share)]
        found: list[tuple[_Square, Box]] = []
        for face, box in sorted(filter(None, measured), key=lambda pair: -pair[0].windows):
            wanted = self.min_share <= face.size / shorter <= self.max_share
            if wanted and not any(_is_one_face(face, other) for other, _ in found):
                found.append((face, box))
        return [
            make_detection(f"faces[{index}]", LABEL, box, image_size=picture.size)
            for index, (_, box) in enumerate(found)
        ]


def _is_one_face(one: _Square, other: _Square) -> bool:
    apart = math.hypot(one.x - other.x, one.y - other.y)
    return apart < _APART * max(one.size, other.size)


def _grey(image: object) -> Image.Image:
    """Turn a picture into one of float brightness."""
    if isinstance(image, np.ndarray):
        array = cast("NDArray[Any]", image)
        image = np.stack([array] * 3, axis=-1) if array.ndim == 2 else array
    return Image.fromarray(upright_rgb(image)).convert("L").convert("F")


def _searched(picture: Image.Image, min_share: float) -> list[_Square]:
    """Find where faces may be, on a picture no larger than the smallest face needs."""
    width, height = picture.size
    zoom = min(1.0, _SEARCHED_PX / (min_share * min(width, height)))
    size = (max(1, round(width * zoom)), max(1, round(height * zoom)))
    small = picture.resize(size, Image.Resampling.BILINEAR)
    windows = _windows(small, _WINDOW_PX, min(size), _SEARCH_STEP, _SEARCH_STRIDE)
    across, down = width / size[0], height / size[1]
    return [
        _Square(seed.x * across, seed.y * down, seed.size * across, seed.windows)
        for seed in _agreed(windows, _SEARCH_WINDOWS)
    ]


def _measured(picture: Image.Image, seed: _Square) -> tuple[_Square, Box] | None:
    """Look closely at a place; None where there is no face after all."""
    width, height = picture.size
    reach = _MARGIN * seed.size
    left, top = max(0.0, seed.x - reach), max(0.0, seed.y - reach)
    right, bottom = min(float(width), seed.x + reach), min(float(height), seed.y + reach)
    zoom = _MEASURED_PX / seed.size
    size = (max(1, round((right - left) * zoom)), max(1, round((bottom - top) * zoom)))
    crop = picture.resize(size, Image.Resampling.BILINEAR, box=(left, top, right, bottom))
    smallest, largest = int(_SMALLEST * _MEASURED_PX), int(_LARGEST * _MEASURED_PX)
    windows = _windows(crop, smallest, largest, _MEASURE_STEP, _MEASURE_STRIDE)
    across, down = (right - left) / size[0], (bottom - top) / size[1]
    for face in _agreed(windows, _MEASURE_WINDOWS):
        x, y, half = left + face.x * across, top + face.y * down, face.size / 2
        box = (x - half * across, y - half * down, x + half * across, y + half * down)
        return _Square(x, y, face.size * across, face.windows), box
    return None


@functools.cache
def _cascade() -> Any:
    """Load the cascade once; scikit-image is untyped."""
    import skimage as ski  # noqa: PLC0415 - loads its parts on use

    data: Any = ski.data
    feature: Any = ski.feature
    return feature.Cascade(data.lbp_frontal_face_cascade_filename())


def _windows(
    picture: Image.Image, smallest: int, largest: int, step: float, stride: float
) -> FloatArray:
    """Ask the cascade: (N, 3) centres x, y and sizes of the windows that it takes for a face."""
    brightness = np.asarray(picture, dtype=np.float64)
    rows: list[dict[str, int]] = _cascade().detect_multi_scale(
        # its sums over the picture are float32: without the mean they keep more digits
        img=brightness - brightness.mean(),
        scale_factor=step,
        step_ratio=stride,
        min_size=(smallest, smallest),
        max_size=(largest, largest),
        min_neighbor_number=1,
        intersection_score_threshold=1.0,  # no window is merged with another
    )
    corners = np.array([(row["c"], row["r"], row["width"]) for row in rows], dtype=np.float64)
    windows = corners.reshape(-1, 3)
    windows[:, :2] += windows[:, 2:] / 2
    return windows[np.lexsort(windows.T)]  # threads may have found them in any order


def _agreed(windows: FloatArray, least: int) -> list[_Square]:
    """Take the window with the most like it and their mean, then the same of those elsewhere."""
    found: list[_Square] = []
    while windows.size:
        x, y, size = windows.T
        apart = np.hypot(x[:, np.newaxis] - x, y[:, np.newaxis] - y)
        apart /= np.sqrt(size[:, np.newaxis] * size)
        ratio = np.maximum(size[:, np.newaxis] / size, size / size[:, np.newaxis])
        alike: BoolArray = (apart < _NEAR) & (ratio < _ALIKE)
        best = int(alike.sum(axis=1).argmax())
        own = windows[alike[best]]
        if len(own) < least:
            break
        mean_size = math.exp(float(np.log(own[:, 2]).mean()))
        found.append(_Square(float(own[:, 0].mean()), float(own[:, 1].mean()), mean_size, len(own)))
        windows = windows[apart[best] > _APART]
    return found
