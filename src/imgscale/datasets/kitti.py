"""
Folders of KITTI as frames: the object benchmark, and Scene Flow / Stereo 2015.

The folders are the user's own, as unpacked; nothing is downloaded, and a file that is needed and
not there is named. KITTI: (c) Karlsruhe Institute of Technology and TTI Chicago, CC BY-NC-SA 3.0;
Geiger, Lenz and Urtasun, CVPR 2012; Menze and Geiger, CVPR 2015.

The camera is camera 2, the left one in colour. KITTI counts pixels from the centre of the first
one, the package from its left edge: half a pixel is added to the principal point and to both
corners of the boxes of labels. Their sizes stay.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import attrs
import numpy as np

from imgscale._checks import as_known_image_size, check_choice, positive_number, within
from imgscale._reading import decoding, number_of, quoted, read_bytes, read_text
from imgscale._typing import BoolArray, FloatArray, ImageArray, ImageSize
from imgscale.camera import Camera
from imgscale.depth import Depth, DepthMap, ObjectDepths
from imgscale.depth_sources.files import read_values
from imgscale.depth_sources.lidar import depth_from_points
from imgscale.depth_sources.stereo import StereoDepth
from imgscale.detection import Detection
from imgscale.detectors.kitti import KittiObject, objects_from_kitti
from imgscale.errors import FileError
from imgscale.frame import Frame
from imgscale.picture import opened_picture

__all__ = ["KittiFrame", "object_frames", "scene_flow_frame"]

# Judged: before rectification fx and fy of a camera differ by 0.2 % in the published calibration.
_FOCAL_REL_STD = 0.002
_DISPARITY_UNITS = 256.0
_FIRST_CENTRE = 0.5  # the centre of the first pixel, where KITTI's coordinates are 0


@attrs.frozen(eq=False)
class KittiFrame(Frame):
    """
    One image of KITTI: a `Frame` with what is true of it.

    Attributes
    ----------
    detections : tuple of Detection
        The objects in it.
    depth : DepthMap or ObjectDepths
        Metric depth.
    camera : Camera
        Camera 2.
    name : str
        The image's name, "000001" or "000046_10".
    objects : tuple of KittiObject
        What the labels tell of each detection, in their order, with the detection as it is here;
        empty for Scene Flow.
    image_path : Path or None
        The picture, None where it is not there.
    """

    objects: tuple[KittiObject, ...] = attrs.field(default=(), kw_only=True)
    image_path: Path | None = attrs.field(default=None, kw_only=True)


def object_frames(
    root: str | PathLike[str],
    names: Iterable[str] | None = None,
    *,
    depth: Literal["lidar", "labels"] = "lidar",
    image_size: Sequence[int] | None = None,
) -> Iterator[KittiFrame]:
    """
    Go through a folder of the object benchmark, one frame at a time.

    Parameters
    ----------
    root : path-like
        The folder that holds `label_2` and `calib` and, where needed, `velodyne` and `image_2`; or
        one that holds it as `training`.
    names : iterable of str, optional
        The frames, as "000001"; all that have a scan ("lidar") or a label file ("labels") where
        omitted.
    depth : str
        "lidar": the scan in `velodyne`, projected into the picture. "labels": for each object the
        depth of the nearest corner of its 3-D box; without error, as its 2-D box was computed from
        the same.
    image_size : (width, height), optional
        Size of pictures that `image_2` does not hold. LiDAR depth needs it there; with the depths
        of labels, boxes that end at the picture's border go unnoticed without it.

    Returns
    -------
    iterator of KittiFrame
        Detections, depth and camera as `fit` and `fit_shared` take them. A frame is read when its
        turn comes.

    Raises
    ------
    FileNotFoundError
        If a folder or file that is needed is not there, naming it.
    ValueError
        If a file does not hold what KITTI has there, naming it.

    Examples
    --------
    >>> import imgscale as ims
    >>> from imgscale.datasets import kitti
    >>> def focal_lengths(root):
    ...     for frame in kitti.object_frames(root):
    ...         yield 1 / ims.fit(frame.detections, frame.depth).k, frame.camera.focal_px
    """
    check_choice("depth", depth, ("lidar", "labels"))
    size = None if image_size is None else as_known_image_size(image_size)
    folder = _training_folder(root, "label_2")
    if isinstance(names, str):
        msg = f"`names` must be a sequence of names; got {names!r}. Put a single one in a list."
        raise TypeError(msg)
    if names is None:
        scans, labels = folder / "velodyne", folder / "label_2"
        names = _stems(scans, ".bin") if depth == "lidar" else _stems(labels, ".txt")
    return (_object_frame(folder, name, depth, size) for name in names)


def scene_flow_frame(
    root: str | PathLike[str],
    name: str,
    detections: Iterable[Detection] | None = None,
    *,
    depth: Literal["disparity", "stereo"] = "disparity",
    focal_px: float | None = None,
    baseline_m: float | None = None,
) -> KittiFrame:
    """
    Read one image of Scene Flow / Stereo 2015.

    Parameters
    ----------
    root : path-like
        The folder that holds `disp_occ_0`, `image_2`, `image_3`, `calib_cam_to_cam` and `obj_map`,
        as far as they are needed; or one that holds it as `training`.
    name : str
        The image, as "000046_10".
    detections : iterable of Detection, optional
        What is in the picture, with half a pixel added to boxes of KITTI's labels. Where omitted,
        the masks of `obj_map`, all as "car": they are moving vehicles, vans too, and of hidden ones
        only what is seen, which is too small.
    depth : str
        "disparity": the true one, `disp_occ_0`. "stereo": `image_2` matched with `image_3` by
        `StereoDepth`, which needs the extra "stereo".
    focal_px, baseline_m : float, optional
        Focal length in pixels and distance of the cameras in metres, both; those of
        `calib_cam_to_cam` where omitted.

    Returns
    -------
    KittiFrame
        Detections, depth and camera as `fit` takes them.

    Raises
    ------
    FileNotFoundError
        If a folder or file that is needed is not there, naming it.
    ValueError
        If a file does not hold what KITTI has there, or only one of `focal_px` and `baseline_m` is
        given.
    MissingDependencyError
        If "stereo" is asked for and OpenCV is not installed.

    Examples
    --------
    >>> import imgscale as ims
    >>> from imgscale.datasets import kitti
    >>> def sizes(root, name, detections):
    ...     frame = kitti.scene_flow_frame(root, name, detections)
    ...     model = ims.fit(frame.detections, frame.depth, camera=frame.camera)
    ...     return ims.predict(model, frame.detections, frame.depth)
    """
    check_choice("depth", depth, ("disparity", "stereo"))
    folder = _training_folder(root, "disp_occ_0" if depth == "disparity" else "image_3")
    left, right, true = (
        folder / part / f"{name}.png" for part in ("image_2", "image_3", "disp_occ_0")
    )
    size = _picture_size(true, "true disparity") if depth == "disparity" else _picture_size(left)
    camera, baseline = _stereo_camera(folder, name, focal_px, baseline_m, size)
    if depth == "disparity":
        disparity = read_values(true, scale=_DISPARITY_UNITS)
        with within(true):
            found = DepthMap.from_disparity(
                disparity, focal_px=camera.focal_px, baseline_m=baseline
            )
    else:
        found = StereoDepth(camera.focal_px, baseline)(_rgb(left), _rgb(right, "right picture"))
    if detections is None:
        detections = _masked_cars(folder / "obj_map" / f"{name}.png")
    image_path = left if left.is_file() else None
    return KittiFrame(detections, found, camera=camera, name=name, image_path=image_path)


# --- the object benchmark ---


def _object_frame(folder: Path, name: str, depth: str, size: ImageSize | None) -> KittiFrame:
    objects = _objects(folder / "label_2" / f"{name}.txt")
    calibration = folder / "calib" / f"{name}.txt"
    matrices = _matrices(calibration)
    projection = _matrix(calibration, matrices, "P2", (3, 4))
    picture = folder / "image_2" / f"{name}.png"
    has_picture = picture.is_file()
    size = _picture_size(picture) if has_picture else size
    found: Depth
    if depth == "lidar":
        size = _known(size, picture)
        from_scanner = projection @ _scanner_to_camera(calibration, matrices)
        found = _scan_depth(folder / "velodyne" / f"{name}.bin", from_scanner, size)
    else:
        nearest = [one.surface_depth_m(float(projection[2, 3])) for one in objects]
        found = ObjectDepths(nearest, kind="metric", image_size=size, rel_std=0.0)
    return KittiFrame(
        [one.detection for one in objects],
        found,
        camera=_camera(projection, size),
        name=name,
        objects=tuple(objects),
        image_path=picture if has_picture else None,
    )


def _objects(path: Path) -> list[KittiObject]:
    """Read labels, their boxes from the left edge of the first pixel."""
    with within(path):
        text = _text(path, "labels, which only training pictures have")
        return [
            attrs.evolve(one, detection=_from_edge(one.detection))
            for one in objects_from_kitti(text)
        ]


def _from_edge(detection: Detection) -> Detection:
    x1, y1, x2, y2 = (edge + _FIRST_CENTRE for edge in detection.xyxy)
    return detection.with_box((x1, y1, x2, y2))


def _known(size: ImageSize | None, picture: Path) -> ImageSize:
    if size is None:
        msg = (
            f"{picture} is missing: LiDAR depth takes the picture's size from it. Pass "
            "image_size=(width, height) instead."
        )
        raise FileNotFoundError(msg)
    return size


def _scan_depth(path: Path, projection: FloatArray, size: ImageSize) -> DepthMap:
    content = read_bytes(_needed(path, "LiDAR scan"))
    if not content or len(content) % 16:
        msg = f"{path} must hold four float32 for each point; got {len(content)} bytes."
        raise FileError(msg)
    points = np.frombuffer(content, dtype="<f4").reshape(-1, 4)
    with within(path):
        return depth_from_points(points[:, :3], projection, size)


def _scanner_to_camera(path: Path, matrices: dict[str, str]) -> FloatArray:
    """R0_rect @ Tr_velo_to_cam: from the scanner to the rectified camera 0."""
    rectify, transform = np.eye(4), np.eye(4)
    rectify[:3, :3] = _matrix(path, matrices, "R0_rect", (3, 3))
    transform[:3] = _matrix(path, matrices, "Tr_velo_to_cam", (3, 4))
    product: FloatArray = rectify @ transform
    return product


# --- Scene Flow ---


def _stereo_camera(
    folder: Path, name: str, focal_px: float | None, baseline_m: float | None, size: ImageSize
) -> tuple[Camera, float]:
    """Tell the camera and the baseline: as given, or those of the calibration."""
    if focal_px is not None and baseline_m is not None:
        given = Camera(focal_px, focal_rel_std=_FOCAL_REL_STD, image_size=size)
        return given, positive_number("baseline_m", baseline_m)
    if focal_px is not None or baseline_m is not None:
        msg = (
            f"`focal_px` and `baseline_m` must come together; got {focal_px} and {baseline_m}. "
            "Without either, the calibration tells both."
        )
        raise ValueError(msg)
    path = folder / "calib_cam_to_cam" / f"{name.partition('_')[0]}.txt"
    matrices = _matrices(path, "; without it, pass `focal_px` and `baseline_m`")
    left, right = (_matrix(path, matrices, f"P_rect_0{i}", (3, 4)) for i in (2, 3))
    # P[0, 3] is minus the focal length times the camera's place on the x axis
    return _camera(left, size), float((left[0, 3] - right[0, 3]) / left[0, 0])


def _masked_cars(path: Path) -> list[Detection]:
    with _picture(path, "map of objects; without it, pass `detections`") as picture:
        numbers = np.asarray(picture)
    if numbers.ndim != 2:
        msg = f"{path} must hold one channel, the objects' numbers; got shape {numbers.shape}."
        raise ValueError(msg)
    return [_masked_car(numbers == number) for number in np.unique(numbers[numbers > 0])]


def _masked_car(mask: BoolArray) -> Detection:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return Detection("car", (columns[0], rows[0], columns[-1] + 1, rows[-1] + 1), mask=mask)


# --- files ---


def _training_folder(root: str | PathLike[str], part: str) -> Path:
    """Find the folder that holds a part: the one given, or its `training`."""
    for place in (Path(root), Path(root) / "training"):
        if (place / part).is_dir():
            return place
    msg = f"{root} must hold KITTI's folder {part} or training/{part}; it has neither."
    raise FileNotFoundError(msg)


def _stems(folder: Path, suffix: str) -> list[str]:
    names = sorted(path.stem for path in folder.glob(f"*{suffix}"))
    if not names:
        msg = f"{folder} must hold frames, *{suffix}; there is none."
        raise FileNotFoundError(msg)
    return names


def _needed(path: Path, what: str) -> Path:
    if not path.is_file():
        msg = f"{path} is missing: the {what}."
        raise FileNotFoundError(msg)
    return path


def _text(path: Path, what: str) -> str:
    return read_text(_needed(path, what))


def _matrices(path: Path, remedy: str = "") -> dict[str, str]:
    """Split a calibration into names and what stands behind them."""
    with within(path):  # bytes that are no text
        lines = _text(path, f"calibration{remedy}").splitlines()
    parts = (line.partition(":") for line in lines)
    return {key.strip(): numbers for key, _, numbers in parts}


def _matrix(path: Path, matrices: dict[str, str], key: str, shape: tuple[int, int]) -> FloatArray:
    words = matrices.get(key, "").split()
    try:
        matrix = np.array([number_of(word) for word in words]).reshape(shape)
    except ValueError:
        matrix = np.full(shape, np.nan)
    if not np.isfinite(matrix).all():
        msg = f"{path}: {key} must be {shape[0] * shape[1]} numbers; got {quoted(' '.join(words))}."
        raise ValueError(msg)
    return matrix


def _camera(projection: FloatArray, size: ImageSize | None) -> Camera:
    return Camera(
        float(projection[0, 0]),
        focal_rel_std=_FOCAL_REL_STD,
        cx=float(projection[0, 2]) + _FIRST_CENTRE,
        cy=float(projection[1, 2]) + _FIRST_CENTRE,
        image_size=size,
    )


@contextmanager
def _picture(path: Path, what: str) -> Generator[Any]:
    with opened_picture(_needed(path, what)) as picture, decoding(path, "a picture"):
        yield picture


def _picture_size(path: Path, what: str = "left picture") -> ImageSize:
    with _picture(path, what) as picture:
        width, height = picture.size
    return width, height


def _rgb(path: Path, what: str = "left picture") -> ImageArray:
    with _picture(path, what) as picture:
        return np.asarray(picture.convert("RGB"))
