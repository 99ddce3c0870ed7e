# SPDX-License-Identifier: Apache-2.0
"""Modules of other packages, which add their own to the tables SHAPES, FORCES, CONSTRAINTS and OUTPUTS."""

from __future__ import annotations

import importlib
from collections.abc import Iterable

from cloth_sim_ros.parameters import shown


def load_plugins(modules: Iterable[str]) -> list[str]:
    """Imports the modules; a sentence for each that cannot be."""
    problems = []
    for module in modules:
        try:
            importlib.import_module(module)
        except Exception as error:  # whatever a foreign module raises
            problems.append(f"plugins holds {shown(module)}, left out: {type(error).__name__}: {error}")
    return problems
