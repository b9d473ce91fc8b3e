"""
Fuzz the readers of PFM and JSON, guided by the code that each input reaches.

Any file must give a result or an `ImgscaleError`; everything else ends the run with the input that
caused it. Needs atheris, which is in no extra, as it is built for few Python versions:

    python -m venv .fuzz && .fuzz/bin/pip install atheris .
    .fuzz/bin/python benchmarks/fuzz.py pfm --runs 200000

Seeds are small files made here, and real ones where IMGSCALE_DATA names a folder of them.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["imgscale", "json"]):
    import json.decoder
    import json.scanner

    import imgscale as ims
    from imgscale import _reading, record
    from imgscale.depth_sources import files
    from imgscale.detectors import coco, megadetector, rekognition

LARGEST = 4096  # bytes of a seed and of an input
SIZE = (640, 480)
# What formats are made of, escaped as libFuzzer reads it.
WORDS = (
    *(
        "NaN",
        "Infinity",
        "1e999",
        "true",
        "null",
        "[[",
        "{}",
        '\\"',
        "\\\\ud800",
        "\\xef\\xbb\\xbf",
    ),
    *('\\"images\\":', '\\"annotations\\":', '\\"bbox\\":', '\\"counts\\":', '\\"detections\\":'),
    *(
        '\\"file\\":\\"../',
        '\\"width\\":99999999,',
        '\\"Labels\\":',
        '\\"path\\":',
        '\\"imgscale\\": 1',
    ),
    *("Pf\\x0a", "PF", "-1.0", "1e-999", "4294967296", "\\x0d\\x0a"),
)


def main() -> None:
    """Fuzz one reader until the runs are done or something breaks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("reader", choices=sorted(READERS))
    parser.add_argument("--runs", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    seeds, read = READERS[options.reader]
    with tempfile.TemporaryDirectory() as folder:
        corpus = Path(folder) / "corpus"
        corpus.mkdir()
        for number, content in enumerate(seeds()):
            (corpus / str(number)).write_bytes(content)
        words = Path(folder) / "words"
        words.write_text("".join(f'"{word}"\n' for word in WORDS), encoding="ascii")
        flags = [
            f"-runs={options.runs}",
            f"-seed={options.seed}",
            f"-max_len={LARGEST}",
            f"-dict={words}",
        ]
        file = Path(folder) / f"file.{options.reader.partition('_')[0]}"
        atheris.Setup([sys.argv[0], *flags, str(corpus)], one_input(file, read))
        atheris.Fuzz()


def one_input(file: Path, read: Callable[[Path], object]) -> Callable[[bytes], None]:
    """Read a file of the input; only an `ImgscaleError` that names the file may come of it."""

    def run(content: bytes) -> None:
        file.write_bytes(content)
        try:
            read(file)
        except ims.ImgscaleError as error:
            if file.name not in str(error):
                raise

    return run


def read_json(file: Path) -> None:
    """Read a file as each format of JSON."""
    data = _reading.read_json(file)
    for read in (
        lambda: coco.read_coco(file, masks=True, max_mask_bytes=1_000_000),
        lambda: megadetector.read_megadetector(file, image_folder=file.parent),
        lambda: record.read_record(file),
    ):
        try:
            read()
        except ims.ImgscaleError as error:
            if file.name not in str(error):
                raise
    for convert in (  # what they are given is no file: an argument that breaks its law
        lambda: rekognition.from_rekognition(data, image_size=SIZE),
        lambda: ims.ScaleModel.from_dict(data),
    ):
        with suppress(TypeError, ValueError):
            convert()


def read_pfm(file: Path) -> None:
    """Read a file as values and as a depth map."""
    files.read_values(file, max_pixels=10_000)
    files.read_depth(file, kind="affine_inverse", max_pixels=10_000)


def pfm_seeds() -> Iterator[bytes]:
    """Make small maps of each kind, and cut the beginnings of real ones."""
    for magic, scale, colours in (("Pf", "-1.0", 1), ("Pf", "1", 1), ("PF", "-0.5e-2", 3)):
        yield f"{magic}\n3 2\n{scale}\n".encode() + bytes(range(24)) * colours
    yield b"Pf 1 1 -1 \0\0\x80\x3f"
    yield from real("pfm")


def json_seeds() -> Iterator[bytes]:
    """Make a small file of each format, and take real ones that are short."""
    box = {"Left": 0.5, "Top": 0.25, "Width": 0.125, "Height": 0.5}
    entry = {"category": "1", "conf": 0.9, "bbox": [0.1, 0.2, 0.3, 0.4]}
    runs = {"size": [8, 8], "counts": "0@"}
    spot = {"image_id": 1, "category_id": 2, "bbox": [1, 2, 3, 4], "iscrowd": 1}
    frame = {"id": 1, "file_name": "a.jpg", "width": 8, "height": 8}
    yield from map(
        as_json,
        (
            {"Labels": [{"Name": "Car", "Instances": [{"BoundingBox": box, "Confidence": 9.5}]}]},
            {"detection_categories": {"1": "animal"}, "images": [
                {"file": "a.jpg", "width": 8, "height": 8,
                 "detections": [entry | {"classifications": [["1", 0.5]]}]}]},
            {"images": [frame], "categories": [{"id": 2, "name": "car"}],
             "annotations": [spot | {"segmentation": runs},
                             spot | {"segmentation": [[1, 2, 3, 4, 5, 6]]}]},
            model().to_dict() | {"priors": []},
        ),
    )  # fmt: skip
    yield b'{"imgscale": 1, "options": {}}\n{"path": "a.jpg", "error": {"type": "FitError"}}\n'
    yield b"\xef\xbb\xbf" + as_json([1e5, -0.25, "\u00e9\ud83d\ude00", None, True])
    yield from real("json")


def as_json(value: object) -> bytes:
    """Write a value as JSON."""
    return json.dumps(value).encode()


def model() -> ims.ScaleModel:
    """Fit the smallest model."""
    return ims.fit([ims.Detection("car", (1, 2, 30, 40))], ims.ObjectDepths([5.0], kind="metric"))


def real(ending: str) -> Iterator[bytes]:
    """Take the files of the data folder with an ending, cut where they are long."""
    folder = os.environ.get("IMGSCALE_DATA")
    for path in sorted(Path(folder).rglob(f"*.{ending}")) if folder else ():
        yield path.read_bytes()[:LARGEST]


READERS = {"json": (json_seeds, read_json), "pfm": (pfm_seeds, read_pfm)}

if __name__ == "__main__":
    main()
