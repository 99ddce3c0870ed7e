# SPDX-License-Identifier: Apache-2.0
"""Types of options of programs. Imports the standard library only."""

from __future__ import annotations

import argparse
import math


def duration(text: str) -> float:
    """Seconds of an option. Raises ArgumentTypeError where `text` is no number above 0; inf is without end."""
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not seconds > 0.0:
        raise argparse.ArgumentTypeError(f"{text!r} is no time; allowed is a number of seconds above 0")
    return seconds
