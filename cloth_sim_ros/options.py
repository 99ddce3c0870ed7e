# SPDX-License-Identifier: Apache-2.0
"""What programs share: types of options, and packages that they need. Imports the standard library only."""

from __future__ import annotations

import argparse
import importlib.util
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


def missing(*packages: str) -> str:
    """A sentence about the first package that is not installed; "" where all are."""
    for each in packages:
        if importlib.util.find_spec(each) is None:
            return f"{each} is not installed; make extras adds it, and so does pip install {each}"
    return ""
