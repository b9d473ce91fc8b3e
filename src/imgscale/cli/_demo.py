"""The command ``imgscale demo``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from imgscale._format import text_table
from imgscale.cli._messages import OK
from imgscale.cli._outputs import PageWriter, PictureWriter, Result, Style, Writer, check_out
from imgscale.datasets import motorcycle
from imgscale.estimate import SizeEstimate
from imgscale.flags import Flag
from imgscale.measurement import Measurement
from imgscale.pipeline import measure

_STYLE = Style("m", 0.9)
_NAME = Path("motorcycle of Middlebury 2014")


def run(options: Any) -> int:
    """Size the things in scikit-image's motorcycle scene."""
    check_out(options.out, (".png", ".html"))
    scene = motorcycle.load()
    found = measure(
        scene.image,
        detector=lambda _: scene.detections,
        depth_source=lambda _: scene.depth,
        priors=scene.priors,
        camera=scene.camera,
        noise=scene.noise,
    )
    try:  # before the text, whose reader may have gone; the text needs no matplotlib
        writer = _writer(options.out)
        writer.prepare(Result(_NAME, found, scene.image))()
        writer.finish()
    finally:
        _tell(found)
    print(f"\nwrote {options.out}")
    return OK


def _tell(found: Measurement) -> None:
    """Print what was found, and what it is to be compared with."""
    print(found.model)
    print(f"The published baseline is {motorcycle.PUBLISHED_BASELINE_M:.3f} m: sizes from it would")
    too_small = found.model.k / motorcycle.PUBLISHED_BASELINE_M
    print(f"be {too_small:.2f} times too small.\n")
    print(sizes_table(found.estimates))


def _writer(out: Path) -> Writer:
    if out.suffix.lower() == ".html":
        return PageWriter(out, _STYLE, "The demo of imgscale")
    return PictureWriter(out, {_NAME: out}, _STYLE)


def sizes_table(sizes: Sequence[SizeEstimate]) -> str:
    """Lay out object, pixels, distance, size with its 90 % interval, and scale."""
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
