"""Optional packages are imported where they are used, through `require`."""

from __future__ import annotations

import importlib
import re
from functools import cache
from importlib.metadata import PackageNotFoundError, requires
from types import ModuleType

from imgscale.errors import MissingDependencyError

_DISTRIBUTIONS = {"cv2": "opencv-python-headless"}  # where a package is called otherwise


def require(module: str, *, extra: str, purpose: str) -> ModuleType:
    """
    Import an optional module or say which extra brings it.

    Parameters
    ----------
    module : str
        Dotted name of the module.
    extra : str
        The extra of imgscale that installs it.
    purpose : str
        What needs it, to begin the message with.

    Returns
    -------
    module
        The imported module.

    Raises
    ------
    MissingDependencyError
        If the package is not installed, cannot be imported, or is older than the extra asks for.
        The message tells these apart.
    """
    package = module.partition(".")[0]
    needs = f"{purpose} needs the optional package '{package}'"
    line = f"'imgscale[{extra}]'`."
    try:
        top = importlib.import_module(package)
        if top.__spec__ and top.__spec__.origin is None:  # a mere folder of that name
            raise ModuleNotFoundError(name=package)  # noqa: TRY301 - one message for both
        found = importlib.import_module(module)
    except Exception as error:  # half-installed packages raise anything: OSError, AttributeError
        if isinstance(error, ModuleNotFoundError) and error.name == package:
            msg = f"{needs}; install it with `pip install {line}"
        else:
            msg = (
                f"{needs}, which is there but cannot be imported ({type(error).__name__}: {error})"
                f"; install it anew with `pip install --force-reinstall {line}"
            )
        raise MissingDependencyError(msg) from error
    least, here = _least_version(package, extra), getattr(top, "__version__", "")
    if _numbers(here) and _numbers(here) < _numbers(least):
        msg = f"{needs} from version {least}; got {here}. Upgrade it with `pip install {line}"
        raise MissingDependencyError(msg)
    return found


@cache
def _least_version(package: str, extra: str) -> str:
    """Look up the version that an extra asks for; "" where none is stated."""
    name = re.escape(_DISTRIBUTIONS.get(package, package))
    law = re.compile(rf"{name}(?:\[.*\])?>=([\d.]+);\s*extra\s*==\s*['\"]{re.escape(extra)}['\"]")
    try:
        stated = requires("imgscale") or []
    except PackageNotFoundError:  # frozen into a program, without its metadata
        return ""
    return next((found[1] for need in stated if (found := law.fullmatch(need))), "")


def _numbers(version: object) -> tuple[int, ...]:
    """Read the leading numbers of a version: (2, 4, 1) of "2.4.1rc1+cpu"."""
    leading = re.match(r"\d+(\.\d+)*", version) if isinstance(version, str) else None
    return tuple(map(int, leading[0].split("."))) if leading else ()
