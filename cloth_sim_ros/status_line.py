# SPDX-License-Identifier: Apache-2.0
"""The line of a terminal that says how far a program is. Imports the standard library only."""

from __future__ import annotations

import sys

_ERASE = "\33[2K"


def show(text: str) -> None:
    """Shows `text` in place of what was shown before; "" takes it away. A log gets nothing of it."""
    if sys.stderr.isatty():
        print(f"{_ERASE}{text}", end="\r", file=sys.stderr, flush=True)
