# SPDX-License-Identifier: Apache-2.0
"""Parameter values of a scene, for tests without a node."""

from cloth_sim_ros.ros.parameters import names

COLLIDERS = ("ball", "rod", "crate", "ground")
NAMED = {"objects": ("sheet", "line"), "colliders": COLLIDERS, "sheet.type": "cloth", "line.type": "rope"}


def values(**changes):
    """The defaults of two objects and four colliders, with `changes` (dots written as two underscores)."""
    rows = {**names.fixed_rows(), **names.scene_rows(NAMED)}
    found = {name: row.default for name, row in rows.items()}
    found |= NAMED
    shapes = {"ball": "sphere", "rod": "capsule", "crate": "box", "ground": "plane"}
    dimensions = {"ball": (0.3,), "rod": (0.8, 0.1), "crate": (0.2, 0.4, 0.6), "ground": ()}
    for name in COLLIDERS:
        found |= {f"{name}.shape": shapes[name], f"{name}.dimensions": dimensions[name]}
    return found | {name.replace("__", "."): value for name, value in changes.items()}


def small(**changes):
    """Few segments and one small ball, on the CPU, so that kernels are those of SMALL; with `changes`."""
    few = {"colliders": ("ball",), "ball.dimensions": (0.1,), "line.segments": 7}
    return values(**{"device": "cpu", **few, **changes})
