"""The commands and what their --help says."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeAlias

from imgscale.cli import _options
from imgscale.object_prior import REGIONS

_CODES = """\
exit codes
  0    all was measured
  1    some or all could not be; each is named on standard error
  2    the command, or a file for all photos, is wrong; nothing was begun
  130  stopped by Ctrl-C; what was finished is kept
  141  the reader of the output has gone

Standard output has results only.
"""

_MEASURE = """\
examples
  Boxes by hand, and one thing that you measured; both stand on the ground:
    imgscale measure yard.jpg --ground-plane --reference "pole=1.0" \\
        --box pole=310,344,330,576 --box statue=640,300,760,590

  A detector's boxes and a network's depth map; a page to look at and a table:
    imgscale measure street.jpg --detections street.json --format transformers \\
        --depth street.npy --kind affine_inverse --out sizes.html --out sizes.csv

  All photos of a camera that was calibrated:
    imgscale measure photos --model model.json --detections found.json \\
        --format megadetector --min-score 0.2 --out animals.csv
"""

_CALIBRATE = """\
All photos are fitted together as though they were one: a camera that does not move sees one
ground, and things carried through the scene tell where it is. The model has the camera's height,
the horizon and the roll; with a focal length (--focal-px, or the photos' EXIF record) sizes come
with distances. It holds for photos of that size by that camera as long as nobody moves it.

examples
  A pole of 1 m, carried through the scene and boxed in an annotation tool:
    imgscale calibrate setup --detections setup.json --format coco \\
        --reference "pole=1.0" --focal-px 1420 --out model.json

  Every later photo, sizes and distances:
    imgscale measure photos --model model.json --detections found.json \\
        --format megadetector --min-score 0.2 --out animals.csv
"""

_PRIORS = """\
examples
  imgscale priors                        all rows
  imgscale priors licence plate          the rows of one label, with their source
  imgscale priors --csv > mine.csv       a table to edit, for --priors mine.csv
"""

_DEMO = """\
examples
  imgscale demo
  imgscale demo --out demo.html
"""


_AddParser: TypeAlias = Callable[..., argparse.ArgumentParser]


class _Parser(argparse.ArgumentParser):
    """Says where help is, and takes no shortened options: scripts outlive them."""

    def __init__(self, **options: Any) -> None:
        super().__init__(
            allow_abbrev=False, formatter_class=argparse.RawDescriptionHelpFormatter, **options
        )

    def error(self, message: str) -> NoReturn:
        self.print_usage(sys.stderr)
        self.exit(2, f"imgscale: {message.rstrip('.')}. See `{self.prog} --help`.\n")


class _Version(argparse.Action):
    """Looks the version up when it is asked for: 50 ms."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from importlib.metadata import version  # noqa: PLC0415 - see above

        print(f"imgscale {version('imgscale')}")
        parser.exit()


def parse(words: Sequence[str] | None) -> argparse.Namespace:
    """Read the words of a command; an unknown option is told with the nearest known one."""
    options, unknown = make_parser().parse_known_args(words)
    if unknown:
        from difflib import get_close_matches  # noqa: PLC0415 - for mistakes alone

        command: argparse.ArgumentParser = options.parser
        known = re.findall(r"--[a-z-]+", command.format_help())
        near = get_close_matches(unknown[0], known, n=1)
        hint = f"; did you mean {near[0]}" if near else ""
        command.error(f"unrecognized arguments: {' '.join(unknown)}{hint}")
    return options


def make_parser() -> argparse.ArgumentParser:
    """Build the parser of all commands."""
    parser = _Parser(
        prog="imgscale",
        description="How big is the thing in this photo? Sizes from things of known size and any\n"
        "depth, or none, with an interval.",
        epilog="`imgscale measure --help` has examples to copy.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(
        dest="command", required=True, metavar="COMMAND", title="commands", parser_class=_Parser
    )
    for add in (_add_measure, _add_calibrate, _add_priors, _add_demo):
        command = add(commands.add_parser)
        command.set_defaults(parser=command)
    return parser


def measure_defaults() -> argparse.Namespace:
    """Give the options of `measure` as they are where none is given."""
    return make_parser().parse_args(["measure", "photo", "--ground-plane"])


def _add_measure(add_parser: _AddParser) -> argparse.ArgumentParser:
    parser = add_parser(
        "measure",
        help="size the things in photos",
        usage="imgscale measure PHOTO... (--detections FILE --format FORMAT | --box LABEL=X1,Y1,X2,"
        "Y2 ...)\n           (--depth FILE --kind KIND | --ground-plane | --one-distance | --model "
        "FILE) [options]",
        description="Size everything that is boxed in photos, from those things whose size is\n"
        "known: people, cars, doors and some 200 more (`imgscale priors`), or a --reference.",
        epilog=f"{_MEASURE}\n{_CODES}",
    )
    _options.add_photos(parser, "a photo")
    _options.add_detections(parser)
    _options.add_depth(parser)
    _options.add_sizes(parser, "It counts beside the table's. ")
    _options.add_camera(parser, "--ground-plane: ")
    _options.add_method(_options.add_errors(parser))
    _options.add_results(parser)
    return parser


def _add_calibrate(add_parser: _AddParser) -> argparse.ArgumentParser:
    parser = add_parser(
        "calibrate",
        help="find where a fixed camera is",
        usage="imgscale calibrate PHOTO... (--detections FILE --format FORMAT | --box LABEL=X1,Y1,"
        "X2,Y2 ...)\n           [--reference LABEL=SIZE] [options] --out MODEL.json",
        description="Find the height and the tilt of a fixed camera from photos of things of\n"
        "known size that stand on the ground; keep that for `imgscale measure --model`.",
        epilog=f"{_CALIBRATE}\n{_CODES}",
    )
    _options.add_photos(parser, "a set-up photo")
    _options.add_detections(parser)
    _options.add_sizes(parser, "Where it is given, only such things count. ")
    _options.add_camera(parser, "")
    _options.add_errors(parser)
    parser.add_argument(
        "--out", type=Path, required=True, metavar="MODEL.json", help="the model file to write"
    )
    return parser


def _add_priors(add_parser: _AddParser) -> argparse.ArgumentParser:
    parser = add_parser(
        "priors",
        help="list the known sizes of things",
        usage="imgscale priors [LABEL] [--region REGION] [--csv]",
        description="List the table of sizes, or the rows of one label: mean, spread between\n"
        "individuals, error of the mean, and the source of each.",
        epilog=f"{_PRIORS}\nexit codes\n  0  listed\n  1  no such label; the nearest are named",
    )
    parser.add_argument("label", nargs="*", metavar="LABEL", help="a label, as detectors say it")
    parser.add_argument(
        "--region", choices=REGIONS, default="world", metavar="REGION",
        help=f"whose rows: {', '.join(REGIONS)} (default world)",
    )  # fmt: skip
    parser.add_argument(
        "--csv", action="store_true", help="print a table that --priors reads, in metres"
    )
    return parser


def _add_demo(add_parser: _AddParser) -> argparse.ArgumentParser:
    parser = add_parser(
        "demo",
        help="size the things in a real photo that is shipped along",
        usage="imgscale demo [--out FILE]",
        description="Size the things in a real stereo photo from the one object whose size is\n"
        "known, its rear tyre; print a table, write the photo with the sizes, or a page.",
        epilog=_DEMO,
    )
    parser.add_argument(
        "--out", type=Path, default=Path("imgscale_demo.png"), metavar="FILE",
        help="the .png or .html to write (default imgscale_demo.png)",
    )  # fmt: skip
    return parser
