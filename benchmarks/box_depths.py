"""
Time quantiles of the depths in boxes beside what one would use instead, and print one table.

30 boxes on maps of 375 x 1242 and 2160 x 3840 float32 numbers, without gaps and with a tenth of
the pixels missing (NaN where a peer skips it, for both sides). Peers that need labels instead of
boxes lose all but one of boxes that overlap, so they have less to do. The last rows put a map in
metres per pixel beside copying it. Calls take turns in one process, by the processor's clock;
milliseconds are medians. "Times as fast" is the median of the ratios of all rounds, and their
range; "extra memory" the most that a call held beyond its inputs, its result included. Peers that
are not installed are left out.
"""

from __future__ import annotations

import statistics
import time
import tracemalloc
from collections.abc import Callable, Mapping
from functools import partial
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import imgscale as ims
from imgscale.order_statistics import box_quantiles

Map = NDArray[np.float32]
Boxes = NDArray[np.int64]
Call = Callable[[], object]

SHAPES = ((375, 1242), (2160, 3840))
QUARTILES = (0.25, 0.5, 0.75)
_N_BOXES = 30
_MISSING = 0.1
_ROUNDS = 9
_SHORTEST_S = 0.02


class _Pair(NamedTuple):
    """One line: ours beside a peer, seconds per round and bytes of each."""

    what: str
    size: str
    peer: str
    seconds: tuple[list[float], list[float]]
    peaks: tuple[int, int]


def rows(rounds: int = _ROUNDS) -> list[tuple[str, str, float, str, float]]:
    """
    Time everything.

    Parameters
    ----------
    rounds : int
        How often each call has its turn.

    Returns
    -------
    list of tuple
        What, size, our median in milliseconds, the peer, and its median in milliseconds.
    """
    return [
        (p.what, p.size, _median_ms(p.seconds[0]), p.peer, _median_ms(p.seconds[1]))
        for p in _pairs(rounds)
    ]


def _pairs(rounds: int) -> list[_Pair]:
    found: list[_Pair] = []
    for shape in SHAPES:
        for missing in (0.0, _MISSING):
            found += _box_pairs(shape, missing, rounds)
        found += _map_pairs(shape, rounds)
    return found


# --- what is timed ---


def drawn(shape: tuple[int, int], missing: float) -> tuple[Map, Boxes]:
    """Draw a noisy plane with gaps, and boxes of 5 to 50 % of its sides."""
    rng = np.random.default_rng(7)
    slope: Map = np.linspace(40, 5, shape[0], dtype=np.float32)[:, np.newaxis]
    values: Map = slope * rng.lognormal(0, 0.1, shape).astype(np.float32)
    values[rng.random(shape) < missing] = np.nan
    sizes = rng.uniform(0.05, 0.5, (_N_BOXES, 2)) * shape
    corners = rng.uniform(0, 1, (_N_BOXES, 2)) * (shape - sizes)
    boxes = np.hstack([corners[:, ::-1], (corners + sizes)[:, ::-1]]).round().astype(np.int64)
    return values, boxes


def _slices(values: Map, boxes: Boxes) -> list[Map]:
    return [values[y1:y2, x1:x2] for x1, y1, x2, y2 in boxes.tolist()]


def _box_pairs(shape: tuple[int, int], missing: float, rounds: int) -> list[_Pair]:
    values, boxes = drawn(shape, missing)
    depth = ims.DepthMap(values, kind="metric")
    slices = _slices(values, boxes)
    note = "with gaps" if missing else "no gaps"
    median, quartiles = f"30 medians, {note}", f"30 x 3 quartiles, {note}"
    ours: dict[str, Call] = {
        median: partial(box_quantiles, depth, boxes),
        quartiles: partial(box_quantiles, depth, boxes, QUARTILES),
    }
    peers: dict[str, dict[str, Call]] = {
        median: {"np.nanmedian": lambda: [np.nanmedian(part) for part in slices]},
        quartiles: {
            "np.nanpercentile": lambda: [np.nanpercentile(part, (25, 50, 75)) for part in slices]
        },
    }
    np.testing.assert_array_equal(
        ours[median](), [np.nanmedian(part.astype(np.float64)) for part in slices]
    )
    peers[median] |= _label_peers(values, boxes)
    size = f"{shape[0]} x {shape[1]}"
    return [
        pair
        for what, call in ours.items()
        for pair in _timed(what, size, call, peers[what], rounds)
    ]


def _label_peers(values: Map, boxes: Boxes) -> dict[str, Call]:
    """Give what takes an image of labels: of boxes that overlap, the last one has the pixels."""
    labels = np.zeros(values.shape, dtype=np.int32)
    for index, (x1, y1, x2, y2) in enumerate(boxes.tolist(), start=1):
        labels[y1:y2, x1:x2] = index
    labels[np.isnan(values)] = 0  # neither of them skips NaN
    peers: dict[str, Call] = {}
    if find_spec("skimage"):
        import skimage as ski  # noqa: PLC0415 - where it is installed

        peers["regionprops, np.median"] = lambda: [
            np.median(region.image_intensity[region.image])
            for region in ski.measure.regionprops(labels, values)
        ]
    if find_spec("scipy"):
        from scipy import ndimage  # noqa: PLC0415 - where it is installed

        numbers = np.unique(labels[labels > 0])
        peers["scipy.ndimage.median"] = partial(ndimage.median, values, labels, numbers)
    return peers


def _map_pairs(shape: tuple[int, int], rounds: int) -> list[_Pair]:
    values, _ = drawn(shape, _MISSING)
    zeros: Map = np.where(np.isnan(values), 0, values)
    maps = {
        "scale map": ("relative", values),
        "scale map, 0 for gaps": ("relative", zeros),
        "scale map, inverse": ("inverse", 1 / values),
        "scale map, unknown shift": ("affine_inverse", 1 / values),
    }
    room: Map = np.empty(shape, dtype=np.float32)
    found: list[_Pair] = []
    for what, (kind, numbers) in maps.items():
        depth = ims.DepthMap(numbers, kind=kind)
        model = _model(depth)
        copy = {"np.copyto": partial(np.copyto, room, numbers)}
        size = f"{shape[0]} x {shape[1]}"
        found += _timed(what, size, partial(model.scale_map, depth), copy, rounds)
    return found


def _model(depth: ims.DepthMap) -> ims.ScaleModel:
    """Fit three doors that stand far and near, each 4 px wide."""
    width, height = depth.image_size
    priors = ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.02)])
    boxes = [(width / 2, y, width / 2 + 20, y + 40) for y in (20, height / 2, height - 70)]
    return ims.fit([ims.Detection("door", box) for box in boxes], depth, priors, method="robust")


# --- the table ---


def _timed(what: str, size: str, ours: Call, peers: Mapping[str, Call], rounds: int) -> list[_Pair]:
    """Let ours and its peers take turns."""
    calls = {"": ours, **peers}
    repeats = {name: _repeats(call) for name, call in calls.items()}
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            start = time.process_time()
            for _ in range(repeats[name]):
                call()
            seconds[name].append((time.process_time() - start) / repeats[name])
    peaks = {name: _peak(call) for name, call in calls.items()}
    return [
        _Pair(what, size, peer, (seconds[""], seconds[peer]), (peaks[""], peaks[peer]))
        for peer in peers
    ]


def _repeats(call: Call) -> int:
    """Warm up, and tell how often to call in one round."""
    call()
    start = time.process_time()
    call()
    return max(1, round(_SHORTEST_S / max(time.process_time() - start, 1e-6)))


def _peak(call: Call) -> int:
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        tracemalloc.reset_peak()
        call()
        return tracemalloc.get_traced_memory()[1] - before
    finally:
        tracemalloc.stop()


def _median_ms(seconds: list[float]) -> float:
    return 1e3 * statistics.median(seconds)


def main() -> None:
    """Measure and print."""
    print(
        f"{'what':30}{'size':13}{'ours, ms':>9}  {'peer':24}{'peer, ms':>9}"
        f"{'times as fast':>25}{'extra memory, MB':>20}"
    )
    for pair in _pairs(_ROUNDS):
        mine, theirs = (_median_ms(seconds) for seconds in pair.seconds)
        ratios = [b / a for a, b in zip(*pair.seconds, strict=True)]
        times = f"{statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"
        memory = " / ".join(f"{peak / 1e6:.1f}" for peak in pair.peaks)
        print(
            f"{pair.what:30}{pair.size:13}{mine:9.3f}  {pair.peer:24}{theirs:9.3f}{times:>25}"
            f"{memory:>20}"
        )


if __name__ == "__main__":
    main()
