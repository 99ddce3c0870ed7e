# SPDX-License-Identifier: Apache-2.0
"""Scale of an object relative to its scene, which may differ between worlds."""

from __future__ import annotations

from typing import Any

import numpy as np

from cloth_sim_ros.sim.arrays import writing
from cloth_sim_ros.sim.engine.bodies import Bodies
from cloth_sim_ros.sim.input.checks import WorldSelection, worlds_of
from cloth_sim_ros.sim.substeps.choose import distinct
from cloth_sim_ros.sim.substeps.limits import check_explicit


def set_scale(bodies: Bodies, owner: str, value: Any, world: WorldSelection) -> None:
    """Set an object's scale to a checked value, or one per world, and restart it there.

    Raises ValueError if the object cannot be scaled, or if explicit steps would be unstable.
    """
    topology = bodies.elastic[owner]
    for what, is_so in (
        ("hangs on a winch", topology.winch is not None),
        ("tears", topology.tear_strain > 0.0),
        ("started inside of a collider and was moved out", owner in bodies.moves),
    ):
        if is_so:
            raise ValueError(f"{owner}.scale is set but {owner} {what}; allowed is a scene with another size of it")
    scales = np.broadcast_to(topology.scales_in(), bodies.worlds).copy()
    scales[worlds_of(world)] = value
    if bodies.settings.method == "verlet":
        scaled = topology.at(scales)
        rows = bodies.effective_materials(owner, bodies.materials_of(owner, None), None, topology=scaled)
        check_explicit(bodies.scene, bodies.settings, owner, scaled, distinct(rows))
    bodies.give_scales(owner, scales, world)
    batch, chosen = bodies.batch[owner], bodies.chosen(world)
    batch.write_positions(owner, batch.rest[owner], chosen)
    writing.clear(batch.states["velocities"], batch.span(owner), chosen)
