"""The exceptions of imgscale: what cannot be answered is raised, reservations are flags."""

from __future__ import annotations

__all__ = [
    "DepthMismatchError",
    "FileError",
    "FitError",
    "ImgscaleError",
    "MissingDependencyError",
]


class ImgscaleError(Exception):
    """
    Base class of the package's own exceptions.

    An argument that breaks its documented law raises a plain `ValueError` or `TypeError`;
    the subclasses below are for lawful input that still cannot give an answer.
    """


class FitError(ImgscaleError, ValueError):
    """
    The data are lawful but do not determine what was asked for.

    Examples are a picture without any reference object, or the paper's mean depth from a
    single object.
    """


class DepthMismatchError(ImgscaleError, ValueError):
    """
    A model was used with depth that it was not fitted to.

    Raised for depth of another kind and, where the depth has no absolute scale, for another map.
    """


class FileError(ImgscaleError, ValueError):
    """
    A file is broken, not what it says it is, or beyond a limit.

    The message names the file and the cause. A file that is missing or may not be read raises the
    system's own `OSError`.
    """


class MissingDependencyError(ImgscaleError, ImportError):
    """
    An optional package is not installed.

    The message carries the command that installs it.
    """
