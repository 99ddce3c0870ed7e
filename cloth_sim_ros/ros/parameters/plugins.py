# SPDX-License-Identifier: Apache-2.0
"""Modules of other packages, which add their own to the tables SHAPES, FORCES, CONSTRAINTS and OUTPUTS."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Iterable

from cloth_sim_ros.parameters import shown


def add_plugins_option(parser: argparse.ArgumentParser) -> None:
    """For programs that read bags, whose `plugins` they do not import: a bag may come from anybody."""
    parser.add_argument("--plugins", nargs="+", default=[], metavar="MODULE", help="modules of the recorded node")


def require_plugins(modules: Iterable[str]) -> None:
    """Imports the modules. Raises ValueError where one cannot be."""
    for problem in load_plugins(modules):
        raise ValueError(problem)


def load_plugins(modules: Iterable[str]) -> list[str]:
    """Imports the modules; a sentence for each that cannot be."""
    problems = []
    for module in modules:
        try:
            importlib.import_module(module)
        except Exception as error:  # whatever a foreign module raises
            problems.append(f"plugins holds {shown(module)}, left out: {type(error).__name__}: {error}")
    return problems
