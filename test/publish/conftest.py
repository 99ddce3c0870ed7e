# SPDX-License-Identifier: Apache-2.0
"""A copy of the sources, in which something may be built and released."""

import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MADE = (".git", ".venv", "build", "dist", "install", "log", "study", "*.egg-info", "__pycache__", ".*_cache", "_build")


@pytest.fixture
def sources(tmp_path):
    """The folder of the copy, without what is made from it."""
    copy = tmp_path / "cloth_sim_ros"
    shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(*MADE))
    return copy
