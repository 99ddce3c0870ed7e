# SPDX-License-Identifier: Apache-2.0
"""Types of options, and checks of packages, for all programs. Imports the standard library only."""

from __future__ import annotations

import argparse
import importlib.util
import math


def duration(text: str) -> float:
    """Return the seconds of an option; inf has no end. Raises ArgumentTypeError if `text` is no number above 0."""
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not seconds > 0.0:
        raise argparse.ArgumentTypeError(f"{text!r} is no time; allowed is a number of seconds above 0")
    return seconds


def missing(*packages: str) -> str:
    """Return a sentence about the first package that is not installed; "" if all are."""
    for each in packages:
        if importlib.util.find_spec(each) is None:
            return f"{each} is not installed; make extras adds it, and so does pip install {each}"
    return ""
