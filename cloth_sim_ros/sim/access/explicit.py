# SPDX-License-Identifier: Apache-2.0
"""What method verlet cannot hold is refused where it is asked for."""

from __future__ import annotations

from typing import Any

import numpy as np

from cloth_sim_ros.sim.engine.bodies import Bodies
from cloth_sim_ros.sim.substeps import limits
from cloth_sim_ros.sim.substeps.choose import distinct


def check_rows(bodies: Bodies, name: str, rows: np.ndarray, substeps: int) -> None:
    """`check_explicit` for each of an object's rows of Material that differs from the others, as light as they are."""
    for compliance, damping in distinct(rows):
        check_explicit(bodies, name, compliance, damping, substeps)


def check_explicit(bodies: Bodies, name: str, compliance: Any, damping: float, substeps: int) -> None:
    """Raise ValueError where method verlet cannot hold an object, saying what it would need."""
    topo = bodies.elastic[name]
    if topo.bends_by_angles:
        raise ValueError(f"{name} bends by angles, which method 'verlet' lacks; allowed is 'xpbd', or springs")
    if bodies.scene.objects[name].self_contact:
        raise ValueError(f"{name} has self_contact, which method 'verlet' lacks; allowed is 'xpbd' or 'auto'")
    if bodies.scene.object_contact:
        raise ValueError("the scene has object_contact, which method 'verlet' lacks; allowed is 'xpbd' or 'auto'")
    if topo.tear_strain > 0.0:
        raise ValueError(f"{name} has tear_strain, which method 'verlet' lacks; allowed is 'xpbd' or 'auto'")
    windy = bodies.scene.wind is not None
    limits.check_explicit(name, topo, (compliance, damping), substeps, bodies.settings.frame_dt, windy)
