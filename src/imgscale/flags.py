"""Reservations about a result: success with a "but"."""

from __future__ import annotations

import enum
from collections.abc import Iterable, Mapping
from types import MappingProxyType

__all__ = ["Flag", "flag_meanings", "flag_names", "flag_words", "flags_of", "flags_where"]


class Flag(enum.Flag):
    """
    Reservations about a model or an estimate; test with ``Flag.OUTLIERS in model.flags``.

    Attributes
    ----------
    SINGLE_REFERENCE : Flag
        One object alone fixed the scale; nothing checks it.
    SINGLE_LABEL : Flag
        Several references, all of one label: they share the error of its mean size.
    OUTLIERS : Flag
        At least one reference was rejected; of an estimate: this object was one.
    INCONSISTENT : Flag
        The references disagree by much more than their errors; the interval was widened.
    CAMERA_CONFLICT : Flag
        The focal length or the camera height given disagrees with references and depth by more than
        3 standard errors; `explain` tells the numbers.
    ASSUMED_HORIZON : Flag
        Nobody told the horizon or the camera's pitch, and the picture hardly does: it rests on what
        photos at large have, which a camera that looks steeply down is far from.
    IMPLAUSIBLE_FOCAL : Flag
        The focal length implied by metric depth is outside 0.3 to 6 times the longer image side, or
        the camera's is below: a unit is wrong.
    REFERENCE : Flag
        The object was itself a reference; its prior is in k and is not counted twice.
    PRIOR_USED : Flag
        The object's own prior was fused with the measurement.
    MEAN_DEPTH : Flag
        The object's depth was replaced by the references' mean depth.
    NO_DEPTH : Flag
        The depth map has no valid value on the object.
    MIXED_DEPTH : Flag
        Two surfaces share the object's box; the depth may be that of the other. On a model: of at
        least one reference used.
    PARTIAL : Flag
        The box is cut by the border or marked partial: the size is that of the visible part.
    EXTRAPOLATED : Flag
        The object is more than twice as near or as far as any reference, where the shift of the
        depth was fitted too.
    BEYOND_HORIZON : Flag
        The object lies where the fitted law has no finite distance: its size is NaN, or where that
        is only possible (with 2.5 % or more), its interval has no upper end.
    """

    SINGLE_REFERENCE = enum.auto()
    SINGLE_LABEL = enum.auto()
    OUTLIERS = enum.auto()
    INCONSISTENT = enum.auto()
    CAMERA_CONFLICT = enum.auto()
    IMPLAUSIBLE_FOCAL = enum.auto()
    REFERENCE = enum.auto()
    PRIOR_USED = enum.auto()
    MEAN_DEPTH = enum.auto()
    NO_DEPTH = enum.auto()
    MIXED_DEPTH = enum.auto()
    PARTIAL = enum.auto()
    EXTRAPOLATED = enum.auto()
    BEYOND_HORIZON = enum.auto()
    ASSUMED_HORIZON = enum.auto()


# Short words, and what they mean; both must read well of a model and of an estimate.
_WORDS: Mapping[Flag, tuple[str, str]] = MappingProxyType(
    {
        Flag.SINGLE_REFERENCE: (
            "one reference alone",
            "A single object of known size fixed the scale, and nothing checks it.",
        ),
        Flag.SINGLE_LABEL: (
            "references of one kind",
            "All objects of known size are of one kind, and share the error of its usual size.",
        ),
        Flag.OUTLIERS: (
            "outlier",
            "An object of known size contradicts the others and was left out: check what it is.",
        ),
        Flag.INCONSISTENT: (
            "references disagree",
            "The objects of known size disagree by more than their errors: intervals were widened.",
        ),
        Flag.CAMERA_CONFLICT: (
            "conflict with the camera",
            "What was told of the camera disagrees with the objects of known size and the depth.",
        ),
        Flag.IMPLAUSIBLE_FOCAL: (
            "implausible focal length",
            "No usual camera has the focal length that follows: a unit may be wrong.",
        ),
        Flag.REFERENCE: (
            "known size",
            "The object's usual size was known and helped to fix the scale.",
        ),
        Flag.PRIOR_USED: (
            "with its usual size",
            "The measurement was combined with the usual size of such objects.",
        ),
        Flag.MEAN_DEPTH: (
            "mean distance",
            "The object was taken to be as far away as the objects of known size are on average.",
        ),
        Flag.NO_DEPTH: ("no depth", "There is no depth on the object, so its size is unknown."),
        Flag.MIXED_DEPTH: (
            "two surfaces in the box",
            "Two surfaces share the object's box; the depth may be that of the wrong one.",
        ),
        Flag.PARTIAL: (
            "partly visible",
            "The object is cut or hidden in part: the size is that of what is seen.",
        ),
        Flag.EXTRAPOLATED: (
            "far from the references",
            "The object is more than twice as near or as far as any object of known size.",
        ),
        Flag.BEYOND_HORIZON: (
            "at the horizon",
            "The object is, or may be, where no distance can be told: its size has no upper limit.",
        ),
        Flag.ASSUMED_HORIZON: (
            "assumed horizon",
            "Nobody told where the horizon is: it was taken as in photos at large.",
        ),
    }
)


def flag_words(flags: Flag) -> list[str]:
    """
    Put the flags that are set into a few plain words each.

    Parameters
    ----------
    flags : Flag
        The flags.

    Returns
    -------
    list of str
        Words in the order of `flag_names`.

    Examples
    --------
    >>> from imgscale import Flag
    >>> from imgscale.flags import flag_words
    >>> flag_words(Flag.PARTIAL | Flag.REFERENCE)
    ['known size', 'partly visible']
    """
    return [_WORDS[Flag[name]][0] for name in flag_names(flags)]


def flag_meanings(flags: Flag) -> list[str]:
    """
    Say what the flags that are set mean, to one who does not know the method.

    Parameters
    ----------
    flags : Flag
        The flags.

    Returns
    -------
    list of str
        Sentences in the order of `flag_names`.

    Examples
    --------
    >>> from imgscale import Flag
    >>> from imgscale.flags import flag_meanings
    >>> flag_meanings(Flag.PARTIAL)
    ['The object is cut or hidden in part: the size is that of what is seen.']
    """
    return [_WORDS[Flag[name]][1] for name in flag_names(flags)]


def flag_names(flags: Flag) -> list[str]:
    """
    List the names of the flags that are set.

    Parameters
    ----------
    flags : Flag
        The flags.

    Returns
    -------
    list of str
        Names in the order of their definition.
    """
    return [flag.name for flag in Flag if flag in flags and flag.name is not None]


def flags_of(names: Iterable[str]) -> Flag:
    """
    Set flags by their names.

    Parameters
    ----------
    names : iterable of str
        What `flag_names` listed.

    Returns
    -------
    Flag
        The flags.
    """
    return flags_where({Flag[name]: True for name in names})


def flags_where(raised: Mapping[Flag, bool]) -> Flag:
    """
    Set the flags whose condition holds.

    Parameters
    ----------
    raised : mapping of Flag to bool
        The conditions.

    Returns
    -------
    Flag
        The flags.
    """
    return Flag(sum([flag.value for flag, is_raised in raised.items() if is_raised]))
