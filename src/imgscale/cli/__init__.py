"""
The command line: ``imgscale`` and ``python -m imgscale``.

`main` reads the words, `_parser` and `_options` say which there are; each command has a module,
imported when it is asked for, so that ``--help`` comes at once.
"""

from __future__ import annotations

from imgscale.cli._main import main

__all__ = ["main"]
