# SPDX-License-Identifier: Apache-2.0
"""Status line of a terminal. Imports the standard library only."""

from __future__ import annotations

import sys

_ERASE = "\33[2K"


def show(text: str) -> None:
    """Show `text` in place of the text before; "" removes it. Nothing goes into a log."""
    if sys.stderr.isatty():
        print(f"{_ERASE}{text}", end="\r", file=sys.stderr, flush=True)
