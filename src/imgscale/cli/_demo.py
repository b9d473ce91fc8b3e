"""The command line: ``imgscale`` and ``python -m imgscale``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from imgscale._format import text_table
from imgscale.datasets import motorcycle
from imgscale.errors import ImgscaleError
from imgscale.estimate import SizeEstimate
from imgscale.fitting import fit
from imgscale.flags import Flag
from imgscale.plotting import draw_sizes
from imgscale.prediction import predict

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """
    Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        The words after the program's name; those of the process where omitted.

    Returns
    -------
    int
        Exit code: 0 where all went well, 1 where something could not be done.
    """
    parser = argparse.ArgumentParser(
        prog="imgscale", description="How big is the thing in this photo?"
    )
    parser.add_argument("--version", action="version", version=f"imgscale {version('imgscale')}")
    commands = parser.add_subparsers(dest="command", required=True)
    demo = commands.add_parser(
        "demo",
        help="size the things in a real stereo photo",
        description="Size the things in a real stereo photo from the one object whose size is "
        "known, its rear tyre; print a table and write an annotated picture.",
    )
    demo.add_argument(
        "--out", type=Path, default=Path("imgscale_demo.png"), help="the picture to write"
    )
    options = parser.parse_args(arguments)
    try:
        run_demo(options.out if options.out.suffix else options.out.with_suffix(".png"))
    except (ImgscaleError, OSError, ValueError) as error:
        print(f"imgscale: {error}", file=sys.stderr)
        return 1
    return 0


def run_demo(out: Path) -> None:
    """
    Size the things in scikit-image's motorcycle scene.

    Parameters
    ----------
    out : Path
        The picture to write.
    """
    scene = motorcycle.load()
    depth = scene.depth
    model = fit(scene.detections, depth, scene.priors, camera=scene.camera, noise=scene.noise)
    sizes = predict(model, scene.detections, depth)
    print(model)
    print(f"The published baseline is {motorcycle.PUBLISHED_BASELINE_M:.3f} m: sizes from it would")
    print(f"be {model.k / motorcycle.PUBLISHED_BASELINE_M:.2f} times too small.\n")
    print(sizes_table(sizes))
    figure: Any = draw_sizes(scene.image, scene.detections, sizes).figure
    figure.savefig(out)
    print(f"\nwrote {out}")


def sizes_table(sizes: Sequence[SizeEstimate]) -> str:
    """
    Lay out estimates as a table.

    Parameters
    ----------
    sizes : sequence of SizeEstimate
        The estimates.

    Returns
    -------
    str
        Object, pixels, distance, size with its 90 % interval, and scale.
    """
    header = ("object", "pixels", "distance m", "size m", "90 % interval", "m per pixel", "")
    rows: list[tuple[str, ...]] = []
    for size in sizes:
        low, high = size.interval(0.9)
        rows.append(
            (
                size.label,
                f"{size.size_m / size.metres_per_pixel:.0f}",
                "-" if size.distance_m is None else f"{size.distance_m:.2f}",
                f"{size.size_m:.3f}",
                f"{low:.3f} to {high:.3f}",
                f"{size.metres_per_pixel:.5f}",
                "reference" if Flag.REFERENCE in size.flags else "",
            )
        )
    return text_table(header, rows)
