"""Optional packages are imported where they are used, through `require`."""

from __future__ import annotations

import importlib
from types import ModuleType

from imgscale.errors import MissingDependencyError


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
        If the package is not installed. A package that is installed but broken raises its own
        error instead, so that it is not reported as absent.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if not f"{module}.".startswith(f"{error.name}."):
            raise  # the package is there, and something that it needs is not
        msg = (
            f"{purpose} needs the optional package '{error.name}'; "
            f"install it with `pip install 'imgscale[{extra}]'`."
        )
        raise MissingDependencyError(msg) from error
