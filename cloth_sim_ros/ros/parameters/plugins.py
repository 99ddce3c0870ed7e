# SPDX-License-Identifier: Apache-2.0
"""Modules of other packages that add entries to the tables SHAPES, FORCES, CONSTRAINTS and OUTPUTS."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Iterable

from cloth_sim_ros.parameters import shown


def add_plugins_option(parser: argparse.ArgumentParser) -> None:
    """Add --plugins to a program that reads bags.

    Such programs do not import the `plugins` that a bag names, as a bag may come from anybody.
    """
    parser.add_argument("--plugins", nargs="+", default=[], metavar="MODULE", help="modules of the recorded node")


def require_plugins(modules: Iterable[str]) -> None:
    """Import the modules. Raises ValueError if one cannot be imported."""
    for problem in load_plugins(modules):
        raise ValueError(problem)


def load_plugins(modules: Iterable[str]) -> list[str]:
    """Import the modules; return a sentence for each that cannot be imported."""
    problems = []
    for module in modules:
        try:
            importlib.import_module(module)
        except Exception as error:  # whatever a foreign module raises
            problems.append(f"plugins holds {shown(module)}, left out: {type(error).__name__}: {error}")
    return problems
