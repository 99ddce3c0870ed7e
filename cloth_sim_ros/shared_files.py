# SPDX-License-Identifier: Apache-2.0
"""Files that come with the package, such as config/curtain.yaml. Imports the standard library only."""

from __future__ import annotations

import os
import sys
from pathlib import Path

PACKAGE = "cloth_sim_ros"


def shared(path: str) -> Path:
    """Return a file that comes with the package: in a source tree, or installed by colcon or pip."""
    roots = [Path(__file__).parents[1]]
    roots += [Path(root) / "share" / PACKAGE for root in os.environ.get("AMENT_PREFIX_PATH", "").split(":") if root]
    roots.append(Path(sys.prefix) / "share" / PACKAGE)
    return next((root / path for root in roots if (root / path).is_file()), roots[0] / path)
