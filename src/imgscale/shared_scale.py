"""What the frames of one camera say together, as each frame's model carries it."""

from __future__ import annotations

from collections.abc import Sequence

import attrs

from imgscale._typing import SizeAxis

__all__ = ["SharedReference", "SharedScale"]


def _pair(values: Sequence[float]) -> tuple[float, float]:
    return (float(values[0]), float(values[1]))


def _triple(values: Sequence[float]) -> tuple[float, float, float]:
    return (float(values[0]), float(values[1]), float(values[2]))


@attrs.frozen(kw_only=True)
class SharedReference:
    """
    What one reference, or all references of a label in other frames, say of log k.

    Attributes
    ----------
    label, axis : str
        Whose mean size it rests on.
    log_k : float
        Log k as they give it, the label's mean taken as the table has it.
    precision : float
        Its inverse variance; 0 for a rejected reference.
    lean : tuple of float
        How log k changes with the horizon's row (1/px) and with the plane's slope; 0 without plane.
    trust : float
        How far it was believed over all frames, 0 (an outlier) to 1.
    kind : int
        Which row of its label it was taken for.
    kind_probability : float
        Probability that it is sound and of that kind.
    """

    label: str
    axis: SizeAxis
    log_k: float
    precision: float
    lean: tuple[float, float] = attrs.field(converter=_pair)
    trust: float = 1.0
    kind: int = 0
    kind_probability: float = 1.0


@attrs.frozen(kw_only=True)
class SharedScale:
    """
    What the frames of one camera say together.

    Attributes
    ----------
    n_frames : int
        Number of frames.
    own : tuple of SharedReference
        The frame's own references, in their order, with the weight that they have among all.
    others : tuple of SharedReference
        The references of the other frames, one row for each label.
    horizon, slope : float
        What the other frames say of the horizon's row, counted from the principal point, and of the
        plane's slope.
    plane_precision : tuple of float
        The precision matrix of these two: (horizon, horizon and slope, slope).
    jitter_px : float
        How far the horizon moves from frame to frame, and what else the feet's rows miss, in
        pixels.
    inconsistent : bool
        True where the references of all frames disagree by much more than their errors.
    """

    n_frames: int
    own: tuple[SharedReference, ...]
    others: tuple[SharedReference, ...]
    horizon: float = 0.0
    slope: float = 0.0
    plane_precision: tuple[float, float, float] = attrs.field(
        default=(0.0, 0.0, 0.0), converter=_triple
    )
    jitter_px: float = 0.0
    inconsistent: bool = False
