"""Where labels go: near their boxes, on nobody else's label, inside the picture. Numbers alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import attrs
import numpy as np

from imgscale._typing import BoolArray, Box, FloatArray, IntArray

Leader: TypeAlias = tuple[tuple[float, float], tuple[float, float]]

# Least distance of two labels, and of a label from its box, in points.
_GAP = 2.0
# A label so far from its box needs a line to it, in points.
_NEAR = 3 * _GAP
# Prices: to be short of words, to hide another object or the own one wholly, to need a leader, a
# leader of the picture's diagonal, a line across a label.
_SHORTER = (0.0, 0.5, 1.5)
_HIDDEN, _OWN_HIDDEN, _LEADER, _FAR, _CROSSED = 1.5, 0.6, 0.15, 4.0, 1.0
# Places in the order in which they are liked: an epsilon that decides between equals.
_LIKED = 1e-3
_MOST_GRID, _SWEEPS = 14, 2
# A place so cheap is kept; of the others, so many of the cheapest are looked at for crossing lines.
_GOOD, _MOST_CHECKED = 0.05, 48
# Distance of a panel from the picture's edge, in points.
_MARGIN = 5.0


@attrs.frozen
class Place:
    """
    Where one label stands, in points.

    Attributes
    ----------
    wording : int
        Which of its wordings has room, 0 the fullest; -1 where none has.
    rect : tuple of float
        What it covers: x0, y0, x1, y1.
    leader : pair of points or None
        From the label to its box, where they stand apart.
    cost : float
        What is bad about it.
    """

    wording: int
    rect: Box
    leader: Leader | None
    cost: float


_NOWHERE = Place(-1, (0.0, 0.0, 0.0, 0.0), None, math.inf)


def place_labels(
    size: tuple[float, float], boxes: FloatArray, wordings: FloatArray, taken: Sequence[Box] = ()
) -> list[Place]:
    """
    Find places for labels: the best for one after the other, then again among all others.

    No label overlaps another or leaves the picture. What is asked of a place beyond that is that it
    is near the box, hides no object, needs no line across other labels and has room for words.

    Parameters
    ----------
    size : (width, height)
        Size of the picture.
    boxes : (N, 4) ndarray of float
        The objects: x0, y0, x1, y1 from the lower left corner, in the same unit.
    wordings : (N, L, 2) ndarray of float
        Width and height of each label in each of its wordings, the fullest first; at most three.
    taken : sequence of (x0, y0, x1, y1)
        Where no label may stand.

    Returns
    -------
    list of Place
        One per object. The same for the same numbers.
    """
    places: list[Place] = [_NOWHERE for _ in boxes]
    areas = (boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])
    # Small objects first: large ones have room inside.
    order: list[int] = np.argsort(areas, kind="stable").tolist()
    for _ in range(_SWEEPS):
        before = list(places)
        for index in order:
            if places[index].cost <= _GOOD:
                continue
            others = [p for i, p in enumerate(places) if i != index and p.wording >= 0]
            board = _Board(size, boxes, index, taken, others)
            places[index] = board.best(wordings[index])
        if places == before:
            break
    return places


def place_panel(
    size: tuple[float, float], panel: tuple[float, float], boxes: FloatArray
) -> Box | None:
    """
    Find the corner or edge where a panel hides least of the objects.

    Parameters
    ----------
    size, panel : (width, height)
        Size of the picture, and of the panel.
    boxes : (N, 4) ndarray of float
        The objects: x0, y0, x1, y1 from the lower left corner, in the same unit.

    Returns
    -------
    (x0, y0, x1, y1) or None
        What it covers; None where it does not fit.
    """
    room = (size[0] - panel[0] - 2 * _MARGIN, size[1] - panel[1] - 2 * _MARGIN)
    if min(room) < 0:
        return None
    shares = [(0, 0), (1, 0), (0, 1), (1, 1), (0.5, 0), (0.5, 1), (0, 0.5), (1, 0.5)]
    corners = _MARGIN + np.array(shares) * room
    rects = np.concatenate([corners, corners + panel], axis=1)
    areas = np.maximum((boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1]), 1.0)
    hidden = (_overlaps(rects, boxes) / areas).sum(axis=1)
    x0, y0, x1, y1 = rects[int(np.argmin(hidden))].tolist()
    return (x0, y0, x1, y1)


@attrs.frozen
class _Board:
    """The picture as one label finds it."""

    size: tuple[float, float]
    boxes: FloatArray
    index: int
    taken: Sequence[Box]
    others: Sequence[Place]

    def best(self, wordings: FloatArray) -> Place:
        """Find the cheapest place, with fewer words where more would cost more."""
        found = _NOWHERE
        for wording, (width, height) in enumerate(wordings.tolist()):
            if _SHORTER[wording] >= found.cost:
                break
            place = self._best_of(wording, width, height)
            found = place if place.cost < found.cost else found
        return found

    def _best_of(self, wording: int, width: float, height: float) -> Place:
        """Find the cheapest place for one wording."""
        rects = self._candidates(width, height)
        blocked = np.array([*self.taken, *(p.rect for p in self.others)]).reshape(-1, 4)
        blocked += np.array([-_GAP, -_GAP, _GAP, _GAP])
        free = ~(_overlaps(rects, blocked) > 0).any(axis=1)
        liked = np.minimum(_LIKED * np.flatnonzero(free), _LEADER / 2)
        costs = _SHORTER[wording] + liked + self._hidden(rects[free])
        starts, ends = _links(rects[free], self.boxes[self.index])
        lengths = np.hypot(*(ends - starts).T)
        costs += np.where(lengths > _NEAR, _LEADER + _FAR * lengths / np.hypot(*self.size), 0.0)
        top = np.argsort(costs, kind="stable")[:_MOST_CHECKED]
        if not len(top):
            return _NOWHERE
        rects, starts, ends, far = rects[free][top], starts[top], ends[top], lengths[top] > _NEAR
        costs = costs[top] + _CROSSED * self._crossings(rects, starts, ends, far)
        at = int(np.argmin(costs))
        x0, y0, x1, y1 = rects[at].tolist()
        (ax, ay), (bx, by) = starts[at].tolist(), ends[at].tolist()
        leader = ((ax, ay), (bx, by)) if far[at] else None
        return Place(wording, (x0, y0, x1, y1), leader, float(costs[at]))

    def _candidates(self, width: float, height: float) -> FloatArray:
        """Lower left corners beside the box, inside it, and all over the picture."""
        room = (self.size[0] - width, self.size[1] - height)
        if min(room) < 0:
            return np.empty((0, 4))
        x0, y0, x1, y1 = self.boxes[self.index].tolist()
        left, right, centre = x0, x1 - width, (x0 + x1 - width) / 2
        low, high, middle = y0, y1 - height, (y0 + y1 - height) / 2
        above, below, before, after = y1 + _GAP, y0 - _GAP - height, x0 - _GAP - width, x1 + _GAP
        corners = [
            (left, above), (right, above), (centre, above), (left, below), (right, below),
            (centre, below), (after, high), (before, high), (after, low), (before, low),
            (after, middle), (before, middle), (after, above), (before, above), (after, below),
            (before, below), (left + _GAP, high - _GAP), (right - _GAP, high - _GAP),
            (left + _GAP, low + _GAP), (right - _GAP, low + _GAP), (centre, middle),
        ]  # fmt: skip
        xs = np.linspace(0, room[0], 2 + min(_MOST_GRID, int(3 * room[0] / width)))
        ys = np.linspace(0, room[1], 2 + min(_MOST_GRID, int(room[1] / height)))
        grid = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
        found = np.clip(np.concatenate([np.array(corners), grid]), 0, room)
        return np.concatenate([found, found + np.array([width, height])], axis=1)

    def _hidden(self, rects: FloatArray) -> FloatArray:
        """Price what of the objects lies under each candidate, as shares of the objects."""
        boxes = self.boxes
        areas = np.maximum((boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1]), 1.0)
        prices = np.full(len(boxes), _HIDDEN)
        prices[self.index] = _OWN_HIDDEN
        found: FloatArray = (_overlaps(rects, boxes) / areas * prices).sum(axis=1)
        return found

    def _crossings(
        self, rects: FloatArray, starts: FloatArray, ends: FloatArray, far: BoolArray
    ) -> IntArray:
        """Count labels under each candidate's leader, and leaders of others under its label."""
        labels = np.array([place.rect for place in self.others]).reshape(-1, 4)
        lines = np.array([place.leader for place in self.others if place.leader]).reshape(-1, 2, 2)
        own: IntArray = _cross(starts[:, None], ends[:, None], labels).sum(axis=1)
        under: IntArray = _cross(lines[:, 0], lines[:, 1], rects[:, None]).sum(axis=1)
        return under + own * far


def _overlaps(a: FloatArray, b: FloatArray) -> FloatArray:
    """Areas that (K, 4) and (M, 4) rectangles share, (K, M)."""
    sides = [
        np.minimum(a[:, i + 2, None], b[:, i + 2]) - np.maximum(a[:, i, None], b[:, i])
        for i in (0, 1)
    ]
    found: FloatArray = np.maximum(sides[0], 0.0) * np.maximum(sides[1], 0.0)
    return found


def _links(rects: FloatArray, box: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Draw the shortest line from each (K, 4) rectangle to the box: (K, 2) starts and ends."""
    centres = (rects[:, :2] + rects[:, 2:]) / 2
    ends = np.clip(centres, box[:2], box[2:])
    starts = np.clip(ends, rects[:, :2], rects[:, 2:])
    return starts, np.clip(starts, box[:2], box[2:])


def _cross(starts: FloatArray, ends: FloatArray, rects: FloatArray) -> BoolArray:
    """Tell where lines pass through rectangles (Liang and Barsky); both broadcast, (..., 2 | 4)."""
    steps = ends - starts
    steps = np.where(np.abs(steps) < 1e-9, 1e-9, steps)
    one = (rects[..., :2] - starts) / steps
    two = (rects[..., 2:] - starts) / steps
    enter = np.minimum(one, two).max(axis=-1)
    leave = np.maximum(one, two).min(axis=-1)
    found: BoolArray = (enter < leave) & (leave > 0) & (enter < 1)
    return found
