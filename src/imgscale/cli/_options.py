"""The options that commands share, in groups, and the laws of which go together."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, get_args

from imgscale._format import PER_METRE
from imgscale._typing import DepthKind, FitMethod
from imgscale.cli import _grammar
from imgscale.cli._messages import WrongUsageError
from imgscale.object_prior import REGIONS, SIZE_AXES

KINDS = tuple(kind for kind in get_args(DepthKind) if kind != "ground_plane")
FORMATS = (
    *("coco", "kitti", "megadetector", "pascal_voc", "rekognition", "transformers"),
    "yolo",
)


# Without what Python reads besides: 7_00, digits of other scripts, nan.
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)(e[+-]?\d+)?", re.ASCII | re.IGNORECASE)


def number(law: str, is_lawful: Callable[[float], bool]) -> Callable[[str], float]:
    """Make a reader of numbers for argparse."""

    def read(text: str) -> float:
        value = float(text) if _NUMBER.fullmatch(text) else math.nan
        if not (math.isfinite(value) and is_lawful(value)):
            msg = f"must be {law}; got {text!r}"
            raise argparse.ArgumentTypeError(msg)
        return value

    return read


# The ends are far beyond what cameras and scenes have; further out, sums would overflow.
POSITIVE = number("a number from 1e-6 to 1e10", lambda value: 1e-6 <= value <= 1e10)
FOCAL = number("a number of pixels from 1 to 1e7", lambda value: 1 <= value <= 1e7)
ROW = number("a row from -1e6 to 1e6", lambda value: abs(value) <= 1e6)
ERROR = number("a number from 0 to 1e6", lambda value: 0 <= value <= 1e6)
REL_ERROR = number("a share from 0 to 10, as 0.02", lambda value: 0 <= value <= 10)
SHARE = number("a number from 0 to 1", lambda value: 0 <= value <= 1)
LEVEL = number("a probability from 0.000001 to 0.999999", lambda p: 1e-6 <= p <= 1 - 1e-6)
TILT = number("an angle above -90 and below 90", lambda value: abs(value) < 90)


def add_photos(parser: argparse.ArgumentParser, what: str) -> None:
    """Add the photos themselves."""
    parser.add_argument(
        "photos", nargs="+", type=Path, metavar="PHOTO",
        help=f"{what}, or a folder with them, its subfolders included; turned upright by EXIF",
    )  # fmt: skip


def add_detections(parser: argparse.ArgumentParser) -> None:
    """Add where boxes come from."""
    group = parser.add_argument_group("what is in the photos (boxes)")
    group.add_argument(
        "--detections", type=Path, metavar="FILE_OR_FOLDER",
        help="what a detector found, or what was annotated. coco and megadetector: one file for "
        "all photos. Other formats: a file for one photo, or a folder with a file of each photo's "
        "name",
    )  # fmt: skip
    group.add_argument(
        "--format", choices=FORMATS, metavar="FORMAT",
        help=f"of --detections: {', '.join(FORMATS)} (what its pipeline gave, saved as JSON)",
    )  # fmt: skip
    group.add_argument(
        "--box", action="append", default=[], type=_grammar.box, metavar="LABEL=X1,Y1,X2,Y2",
        help="a box drawn by hand, in pixels of the upright photo: left, top, right, bottom; for "
        "one photo, again for further boxes",
    )  # fmt: skip
    group.add_argument(
        "--min-score", type=SHARE, default=0.0, metavar="SHARE",
        help="leave out detections below it, 0 to 1 (default 0: none; megadetector wants 0.2)",
    )  # fmt: skip
    group.add_argument(
        "--class-names", type=Path, metavar="FILE",
        help="yolo, and transformers where it gave numbers: a text file, a class a line",
    )  # fmt: skip
    group.add_argument(
        "--coco-images", type=Path, metavar="FILE",
        help="coco: where --detections is a list of results, the file with images and categories",
    )  # fmt: skip
    group.add_argument(
        "--masks", action="store_true",
        help="coco, yolo: read outlines too; depth is then read on the object alone",
    )  # fmt: skip
    group.add_argument(
        "--zero-based", action="store_true",
        help="pascal_voc: the tool counted pixels from 0 and not, as the format does, from 1",
    )  # fmt: skip


def add_depth(parser: argparse.ArgumentParser) -> None:
    """Add where distances come from, for `measure`."""
    group = parser.add_argument_group("how far things are (one of the first four)")
    one = group.add_mutually_exclusive_group(required=True)
    one.add_argument(
        "--depth", type=Path, metavar="FILE_OR_FOLDER",
        help="depth maps: PNG (16 bit), NPY, NPZ, PFM or TIFF, of each photo's name; with --kind",
    )  # fmt: skip
    one.add_argument(
        "--ground-plane", action="store_true",
        help="no depth: things stand on one plane, a floor or a road seen from the side",
    )  # fmt: skip
    one.add_argument(
        "--one-distance", action="store_true",
        help="no depth: all is equally far, as a plate from above, a wall, a belt",
    )  # fmt: skip
    one.add_argument(
        "--model", type=Path, metavar="FILE",
        help="what `imgscale calibrate` wrote for this camera; nothing of known size is needed",
    )  # fmt: skip
    group.add_argument(
        "--kind", choices=KINDS, metavar="KIND",
        help="what --depth holds. metric: metres along the optical axis. relative: up to a factor. "
        "inverse: inverse depth up to a factor, as disparity + doffs. affine_inverse: up to a "
        "factor and a shift, as MiDaS and Depth Anything give it",
    )  # fmt: skip
    group.add_argument(
        "--scale", type=POSITIVE, metavar="NUMBER",
        help="stored number that stands for 1 (metre), where --depth holds integers: KITTI 256, "
        "millimetres 1000",
    )  # fmt: skip
    group.add_argument(
        "--depth-key", metavar="NAME", help="name of the array in an .npz file of several"
    )
    group.add_argument(
        "--scale-rel-std", type=REL_ERROR, metavar="SHARE",
        help="metric: error of the map's scale as a whole; networks 0.15 (default 0: LiDAR)",
    )  # fmt: skip


def add_camera(parser: argparse.ArgumentParser, when: str) -> None:
    """Add what is known of the camera."""
    group = parser.add_argument_group("what is known of the camera")
    group.add_argument(
        "--focal-px", type=FOCAL, metavar="PX",
        help="focal length, in pixels of the photos (default: by each photo's EXIF record, where "
        "it has one; distances need it)",
    )  # fmt: skip
    group.add_argument(
        "--focal-rel-std", type=REL_ERROR, metavar="SHARE",
        help="its error (default 0.02; 0 for a calibration; by EXIF it is 0.04)",
    )  # fmt: skip
    group.add_argument("--no-exif", action="store_true", help="leave the EXIF focal length alone")
    group.add_argument(
        "--pitch-deg", type=TILT, metavar="DEGREES",
        help="tilt of the camera, downwards positive; needs --focal-px",
    )  # fmt: skip
    group.add_argument(
        "--pitch-std-deg", type=ERROR, metavar="DEGREES", help="its error (default 0)"
    )
    group.add_argument(
        "--camera-height", type=POSITIVE, metavar="METRES",
        help=f"{when}height of the lens above the ground",
    )  # fmt: skip
    group.add_argument(
        "--camera-height-std", type=ERROR, metavar="METRES",
        help="its error (default 2 %% of it)",
    )  # fmt: skip
    group.add_argument(
        "--horizon", type=ROW, metavar="ROW",
        help=f"{when}row of the horizon, in pixels from the top; it may lie outside",
    )  # fmt: skip
    group.add_argument(
        "--horizon-std", type=ERROR, metavar="PX",
        help="its error (default 0.5 %% of the longer side)",
    )  # fmt: skip


def add_sizes(parser: argparse.ArgumentParser, alone: str) -> None:
    """Add which sizes are known, and how well boxes and depths are."""
    group = parser.add_argument_group("what sizes are known")
    group.add_argument(
        "--reference", action="append", default=[], type=_grammar.reference,
        metavar="LABEL=SIZE",
        help="something that you measured: pole=1.0, pole=100cm+-5mm, door=6ft 8in+-0.5%%, "
        "'plate=52cm width', 'coin=23.25mm diameter'. Metres without a unit; the error (default "
        f"0.5 %%) is common to all boxes of that label. {alone}Again for further labels",
    )  # fmt: skip
    group.add_argument(
        "--priors", type=Path, metavar="FILE",
        help="a table of sizes in the place of the shipped one; `imgscale priors --csv` writes one",
    )  # fmt: skip
    group.add_argument(
        "--region", choices=REGIONS, default="world", metavar="REGION",
        help=f"whose rows of the table: {', '.join(REGIONS)} (default world)",
    )  # fmt: skip


def add_errors(parser: argparse.ArgumentParser) -> Any:
    """Add how well boxes and depths are known."""
    errors = parser.add_argument_group("how it is computed")
    errors.add_argument(
        "--box-std-px", type=ERROR, default=1.0, metavar="PX",
        help="error of a box's height (default 1: drawn by hand; detectors 2)",
    )  # fmt: skip
    errors.add_argument(
        "--box-rel-std", type=REL_ERROR, default=0.0, metavar="SHARE",
        help="what that error has besides of the height (default 0; detectors 0.05)",
    )  # fmt: skip
    errors.add_argument(
        "--depth-rel-std", type=REL_ERROR, metavar="SHARE",
        help="error of one thing's depth, or of the ground's flatness (default: learned)",
    )  # fmt: skip
    return errors


def add_method(group: Any) -> None:
    """Add the estimator."""
    group.add_argument(
        "--method", choices=get_args(FitMethod), default="posterior", metavar="METHOD",
        help=f"{', '.join(get_args(FitMethod))} (default posterior)",
    )  # fmt: skip


def add_results(parser: argparse.ArgumentParser) -> None:
    """Add what of the sizes is told, and where."""
    group = parser.add_argument_group("results")
    group.add_argument(
        "--out", action="append", default=[], type=Path, metavar="FILE",
        help="write .csv, .json, .png (the photo with its sizes; of several photos one each, their "
        "names behind FILE's) or .html (one page); again for further files. Without it a table is "
        "printed",
    )  # fmt: skip
    group.add_argument(
        "--unit", choices=tuple(PER_METRE), default="m", metavar="UNIT",
        help=f"of sizes: {', '.join(PER_METRE)} (default m); distances stay in metres",
    )  # fmt: skip
    group.add_argument(
        "--level", type=LEVEL, default=0.9, metavar="PROBABILITY",
        help="that an interval holds the size (default 0.9)",
    )  # fmt: skip
    group.add_argument(
        "--axis", choices=SIZE_AXES, default="height", metavar="AXIS",
        help=f"what is measured: {', '.join(SIZE_AXES)} (default height)",
    )  # fmt: skip
    group.add_argument(
        "--use-prior", action="store_true",
        help="join each measurement with what the table says of such a thing",
    )  # fmt: skip


# --- which go together ---


def check_detections(options: Any, n_photos: int) -> None:
    """Raise unless boxes come from somewhere, and their options belong to the format."""
    form = options.format
    _need(
        options.detections is not None or options.box,
        "--detections or --box must say what is in the photos; got neither.",
    )
    _need(
        (options.detections is None) == (form is None),
        "--detections and --format must be given together.",
    )
    _need(
        not options.box or n_photos == 1,
        f"--box must be for one photo; got {n_photos}. Give --detections for several.",
    )
    _need(form != "yolo" or options.class_names, "--class-names must be given with --format yolo.")
    belongs = {
        "class_names": ("yolo", "transformers"),
        "coco_images": ("coco",),
        "masks": ("coco", "yolo"),
        "zero_based": ("pascal_voc",),
    }
    for name, formats in belongs.items():
        _need(
            not getattr(options, name) or form in formats,
            f"{flag(name)} must go with --format {' or '.join(formats)}; got {form}.",
        )


def check_depth(options: Any) -> None:
    """Raise unless the options of depth and plane belong to where distances come from."""
    has_file = options.depth is not None
    _need(
        has_file == (options.kind is not None),
        "--depth and --kind must be given together: the numbers do not tell what they are.",
    )
    for name in ("scale", "depth_key", "scale_rel_std"):
        _need(has_file or getattr(options, name) is None, f"{flag(name)} must go with --depth.")
    _need(
        options.scale_rel_std is None or options.kind == "metric",
        "--scale-rel-std must go with --kind metric; the scale of other depth is found.",
    )


def check_method(options: Any) -> None:
    """Raise unless the estimator can do what is asked of it."""
    is_plain = options.method in {"mean_ratio", "least_squares"}
    for has_more, what in (
        (options.ground_plane, "--ground-plane"),
        (options.kind == "affine_inverse", "--kind affine_inverse"),
        (options.pitch_deg, "--pitch-deg"),
    ):
        _need(
            not (is_plain and has_more),
            f"--method must be posterior or robust with {what}; got {options.method}.",
        )


def check_camera(options: Any, *, on_ground: bool) -> None:
    """Raise unless what is told of the camera is of use."""
    for value, stds in (
        ("focal_px", ("focal_rel_std", "pitch_deg")),
        ("pitch_deg", ("pitch_std_deg",)),
        ("camera_height", ("camera_height_std",)),
        ("horizon", ("horizon_std",)),
    ):
        for std in stds:
            _need(
                getattr(options, std) is None or getattr(options, value) is not None,
                f"{flag(std)} must come with {flag(value)}.",
            )
    for name in ("camera_height", "horizon"):
        _need(
            on_ground or getattr(options, name) is None,
            f"{flag(name)} must go with --ground-plane, which alone uses it.",
        )


def check_references(options: Any) -> None:
    """Raise where a label is told twice."""
    labels = [prior.names[0] for prior in options.reference]
    for label in labels:
        _need(labels.count(label) == 1, f'--reference must name "{label}" once; got it twice.')


def check_defaults(options: Any, parser_defaults: Any, names: Sequence[str], why: str) -> None:
    """Raise where options were given that something else has decided."""
    for name in names:
        _need(
            getattr(options, name) == getattr(parser_defaults, name),
            f"{flag(name)} must be left out with --model: {why}",
        )


def flag(name: str) -> str:
    """Write the option of a name."""
    return f"--{name.replace('_', '-')}"


def _need(law_holds: object, message: str) -> None:
    if not law_holds:
        raise WrongUsageError(message)
