"""What goes to standard error: one line each, in the words of the command line."""

from __future__ import annotations

import re
import sys
from typing import Any

from imgscale.errors import ImgscaleError

OK, FAILED, WRONG_USAGE, INTERRUPTED, CLOSED_PIPE = 0, 1, 2, 130, 141

# The library speaks to Python: its words for what has an option here, and for what only Python
# can do; longest first.
OPTIONS = {
    "; clip boxes that a detector drew beyond the border: Detection.with_box().": ".",
    "pass its image_size=(width, height) to the depth, or scale": "scale",
    "PriorTable.default().with_prior(ObjectPrior(label, mean_m, std_m))": (
        '--reference "LABEL=SIZE" or --priors FILE'
    ),
    "one_based=False": "--zero-based",
    "polygons=True": "--masks",
    "`detections` must hold": "--detections or --box must hold",
    "`image` must": "the photo must",
    "`values` must": "a depth map must",
    "`xyxy` must": "a box must",
    "`camera.pitch_deg` must": "--pitch-deg must",
    "`class_names`": "--class-names",
    "`key` must": "--depth-key must",
    "`method` must": "--method must",
    "`scale` must": "--scale must",
    "`use_prior` must": "--use-prior must",
}
_OPEN_FILE = re.compile(r"<_io\.\w+ name=('[^']*')>")
_WORDS = re.compile("|".join(map(re.escape, OPTIONS)))


class WrongUsageError(Exception):
    """What was asked for cannot be done as it was asked; nothing was begun."""


class FailedError(Exception):
    """It was begun, and came to nothing."""


def in_words(error: BaseException) -> str:
    """Tell an error in one line."""
    if isinstance(error, OSError) and error.strerror and error.filename is not None:
        return shown(f"{error.filename}: {error.strerror}")
    text = _WORDS.sub(lambda found: OPTIONS[found[0]], _OPEN_FILE.sub(r"\1", str(error)))
    expected = (ImgscaleError, ValueError, TypeError, OSError, LookupError, WrongUsageError)
    if isinstance(error, KeyError) or not isinstance(error, (*expected, FailedError)) or not text:
        text = ": ".join(filter(None, (type(error).__name__, text)))
    return shown(text)


def shown(text: str) -> str:
    """Put text into one line; what would steer the terminal is written as Python writes it."""
    joined = " ".join(text.split())
    return "".join(char if char.isprintable() else ascii(char)[1:-1] for char in joined)


def complain(text: str) -> None:
    """Write one line to standard error, past a progress bar where there is one."""
    line = f"imgscale: {shown(text)}"
    bars: Any = sys.modules.get("tqdm")
    if bars is None:
        print(line, file=sys.stderr, flush=True)
    else:
        bars.tqdm.write(line, file=sys.stderr)
