# SPDX-License-Identifier: Apache-2.0
"""Tension along ropes, from the results of their solver on the device.

A rigid segment has a tension without a strain, so a direct solve's multipliers say little about it. They are a small
difference of displacements divided by almost no compliance, and their rounding may be as large as the tension. The
displacement of each particle by the solve is accurate, and gives the force of the chain on it. Sums of these forces
from a free end are the forces of the segments. Between two held ends one force is unknown. A fit finds it so that
forces lie along their segments.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from cloth_sim_ros.sim.arrays.state import Arrays
from cloth_sim_ros.sim.engine.batch import Batch
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.kernels.intrinsics import xyz
from cloth_sim_ros.sim.physics.distance import SHORTEST

# Weight, in the fit between two held ends, of the solver's tension along a segment against the force across it. It
# decides the tension of a straight rope.
ALONG = wp.constant(wp.float64(1.0e-3))


@wp.func
def edge_at(arrays: Arrays, i: int) -> wp.vec3:
    """Vector from particle i of the batch to the next [m]."""
    e = xyz(arrays.state.positions[i + 1] - arrays.state.positions[i])
    return e + xyz(arrays.state.position_lo[i + 1] - arrays.state.position_lo[i])


@wp.func
def is_held(arrays: Arrays, i: int) -> bool:
    return arrays.state.positions[i][3] == 0.0


@wp.func
def fitted(
    arrays: Arrays, b: int, begin: int, end: int, free_start: bool, free_end: bool, forces: wp.array(dtype=wp.vec3)
):
    """Add the unknown constant to the forces of segments `begin` to `end`, which were summed from 0."""
    body = arrays.model.bodies[b]
    lacks = wp.vec3d()
    if free_start:
        lacks = wp.vec3d(arrays.state.rope.chain_forces[body.particles + begin])
    elif free_end:
        lacks = -wp.vec3d(arrays.state.rope.chain_forces[body.particles + end]) - wp.vec3d(forces[end - 1])
    else:
        matrix = wp.mat33d()
        right = wp.vec3d()
        for k in range(begin, end):
            n = wp.normalize(wp.vec3d(edge_at(arrays, body.particles + k)))
            share = wp.identity(n=3, dtype=wp.float64) - (wp.float64(1.0) - ALONG) * wp.outer(n, n)
            matrix += share
            right += ALONG * wp.float64(arrays.state.rope.tensions[body.segments + k]) * n
            right -= share * wp.vec3d(forces[k])
        lacks = wp.inverse(matrix) * right
    for k in range(begin, end):
        forces[k] += wp.vec3(lacks)


@compiled
def balance(given: wp.array(dtype=Arrays), b: int, forces: wp.array2d(dtype=wp.vec3)):
    """Compute the force [N] with which each segment of a directly solved rope pulls its first particle."""
    w = wp.tid()
    arrays = given[w]
    pulls = forces[w]
    body = arrays.model.bodies[b]
    segments = body.segments_end - body.segments
    begin = int(0)
    total = wp.vec3d()
    for k in range(segments):
        i = body.particles + k
        if k > begin:
            total += wp.vec3d(arrays.state.rope.chain_forces[i])
        pulls[k] = wp.vec3(total)
        held = is_held(arrays, i + 1)
        if held or k + 1 == segments:
            free_start = begin == 0 and not is_held(arrays, body.particles)
            fitted(arrays, b, begin, k + 1, free_start, not held, pulls)
            begin = k + 1
            total = wp.vec3d()


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
        segments, worlds = batch.counts[b] - 1, batch.worlds if world is None else [batch.worlds[world]]
        self._given = wp.array(worlds, dtype=Arrays, device=device)
        self.forces = wp.zeros((len(worlds), segments), dtype=wp.vec3, device=device)
        if batch.features.chain:
            kernel, dim, inputs = balance, len(worlds), [self._given, b, self.forces]
        else:
            springs = wp.array(_springs_of(batch, b, segments), dtype=int, device=device)
            kernel, dim, inputs = pull_of_springs, self.forces.shape, [self._given, b, springs, self.forces]
        self._commands = [wp.launch(kernel, dim=dim, inputs=inputs, device=device, record_cmd=True)]
        if out is not None:
            inputs, dim = [self._given, b, self.forces, column, out], (len(worlds), segments + 1)
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


def read_tensions(batch: Batch, name: str, world: int) -> np.ndarray:
    """Tensions (S,) float32 [N] of the segments of a rope in one world."""
    out = wp.zeros((1, batch.counts[batch.index[name]], 1), dtype=float, device=batch.device)
    Tensions(batch, name, world, out, 0).launch()
    return out.numpy()[0, :-1, 0].copy()
