"""The command line: ``imgscale`` and ``python -m imgscale``."""

from __future__ import annotations

from imgscale.cli._demo import main

__all__ = ["main"]
