"""Entry point of ``python -m imgscale``."""

from __future__ import annotations

import sys

from imgscale.cli import main

if __name__ == "__main__":
    sys.exit(main())
