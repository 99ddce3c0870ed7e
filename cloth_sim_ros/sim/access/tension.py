# SPDX-License-Identifier: Apache-2.0
"""Tension along ropes, from the results of their solver on the device.

A solve finds the pulls of all segments together in double precision, so those of neighbours are in balance, also where
they are rigid.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from cloth_sim_ros.sim.arrays.state import Arrays
from cloth_sim_ros.sim.engine.batch import Batch
from cloth_sim_ros.sim.input.checks import worlds_of
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.kernels.intrinsics import xyz
from cloth_sim_ros.sim.physics.distance import SHORTEST


@wp.func
def edge_at(arrays: Arrays, i: int) -> wp.vec3:
    """Vector from particle i of the batch to the next [m]."""
    e = xyz(arrays.state.positions[i + 1] - arrays.state.positions[i])
    return e + xyz(arrays.state.position_lo[i + 1] - arrays.state.position_lo[i])


@wp.func
def is_held(arrays: Arrays, i: int) -> bool:
    return arrays.state.positions[i][3] == 0.0


@compiled
def pull_of_chain(given: wp.array(dtype=Arrays), b: int, forces: wp.array2d(dtype=wp.vec3)):
    """Compute the force [N] with which each segment of a directly solved rope pulls its first particle."""
    w, k = wp.tid()
    arrays = given[w]
    body = arrays.model.bodies[b]
    n = wp.normalize(edge_at(arrays, body.particles + k))
    forces[w, k] = arrays.state.rope.tensions[body.segments + k] * n


@compiled
def pull_of_springs(
    given: wp.array(dtype=Arrays), b: int, springs: wp.array(dtype=int), forces: wp.array2d(dtype=wp.vec3)
):
    """The same for segments that are springs of explicit steps, from their length and its rate."""
    w, k = wp.tid()
    arrays = given[w]
    i = arrays.model.bodies[b].particles + k
    e = edge_at(arrays, i)
    length = wp.max(wp.length(e), SHORTEST)
    n = e / length
    rest, scale = arrays.model.line_rests[springs[k]], arrays.model.line_scales[springs[k]]
    rate = wp.dot(n, xyz(arrays.state.velocities[i + 1] - arrays.state.velocities[i]))
    stretch = length - rest + arrays.materials[b].damping * rate
    forces[w, k] = stretch / (arrays.materials[b].compliance[0] * scale) * n


@compiled
def write_tensions(
    given: wp.array(dtype=Arrays), b: int, forces: wp.array2d(dtype=wp.vec3), column: int, out: wp.array3d(dtype=float)
):
    """Write the tension of the segment that begins at each particle; the last particle gets the last segment's."""
    w, i = wp.tid()
    arrays = given[w]
    k = wp.min(i, forces.shape[1] - 1)
    out[w, i, column] = wp.dot(wp.normalize(edge_at(arrays, arrays.model.bodies[b].particles + k)), forces[w, k])


class Tensions:
    """Forces (worlds, S) vec3 [N] with which a rope's segments pull their first particles, in one world or all (None).

    `launch()` computes `forces` from the current state, without allocation. With `out` (worlds, N, columns) float, it
    also writes the tensions into a column: each at its segment's first particle, the last also at the last particle.
    Tensions are below 0 for compressed segments, and include the dashpots' share.
    """

    def __init__(
        self, batch: Batch, name: str, world: int | None, out: wp.array | None = None, column: int = 0
    ) -> None:
        b, device = batch.index[name], batch.device
        segments, self._given = batch.counts[b] - 1, batch.given[worlds_of(world)]
        self.forces = wp.zeros((len(self._given), segments), dtype=wp.vec3, device=device)
        if batch.features.chain:
            kernel, dim, inputs = pull_of_chain, self.forces.shape, [self._given, b, self.forces]
        else:
            springs = wp.array(_springs_of(batch, b, segments), dtype=int, device=device)
            kernel, dim, inputs = pull_of_springs, self.forces.shape, [self._given, b, springs, self.forces]
        self._commands = [wp.launch(kernel, dim=dim, inputs=inputs, device=device, record_cmd=True)]
        if out is not None:
            inputs, dim = [self._given, b, self.forces, column, out], (len(self._given), segments + 1)
            self._commands.append(wp.launch(write_tensions, dim=dim, inputs=inputs, device=device, record_cmd=True))

    def launch(self) -> None:
        """Compute the forces from the current state."""
        for command in self._commands:
            command.launch()


def _springs_of(batch: Batch, b: int, segments: int) -> np.ndarray:
    """Slots in the line arrays of the springs of a rope's segments."""
    model = batch.worlds[0].model
    _, first, end = batch.lines[b][0]
    nodes, others = (array[first:end].numpy() for array in (model.line_nodes, model.line_others))
    there = np.flatnonzero(others >= 0)
    rows = np.zeros(segments, dtype=np.int32)
    rows[np.minimum(nodes, others)[there]] = first + there
    return rows
