# SPDX-License-Identifier: Apache-2.0
"""Read-back of the state: kernels write the data of a message, and one copy brings it to pinned host memory."""

from __future__ import annotations

import numpy as np
import warp as wp

from cloth_sim_ros.sim.arrays.state import Arrays
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.kernels.intrinsics import xyz
from cloth_sim_ros.sim.simulation import Simulation


@wp.func
def vertex_normal(arrays: Arrays, first: int, g: int) -> wp.vec3:
    """Unit normal of particle g by area, gathered from its triangles; 0 where it has none."""
    m = arrays.model
    n = wp.vec3(0.0)
    for k in range(m.panel_start[g], m.panel_start[g + 1]):
        p = m.panels[m.particle_panels[k]]
        if p[2] >= 0:
            a = xyz(arrays.state.positions[first + p[0]])
            n += wp.cross(xyz(arrays.state.positions[first + p[1]]) - a, xyz(arrays.state.positions[first + p[2]]) - a)
    return wp.normalize(n)


@compiled
def write_particles(arrays: Arrays, first: int, normals: bool, velocities: bool, out: wp.array2d(dtype=float)):
    i = wp.tid()
    g = first + i
    position = arrays.state.positions[g]
    column = int(3)
    for c in range(3):
        out[i, c] = position[c]
    if normals:
        n = vertex_normal(arrays, first, g)
        for c in range(3):
            out[i, column + c] = n[c]
        column += 3
    if velocities:
        v = arrays.state.velocities[g]
        for c in range(3):
            out[i, column + c] = v[c]


class Readback:
    """One object's particles in a world, and with `mesh` its triangle list or line strip, as messages want them.

    A particle has six corners in a list, which the host makes of the one copy of the particles.

    With `tensions`, which a rope alone has, a particle carries that of the segment behind it, from it to the next one;
    the last particle that of the last segment.

    `request()` launches the writing and the copies and allocates nothing; `particles()` and `mesh()` wait for them and
    return views that hold until the next request. After `wait()` any thread may ask for them.
    """

    def __init__(
        self,
        sim: Simulation,
        name: str,
        normals: bool = False,
        velocities: bool = False,
        mesh: bool = False,
        world: int = 0,
        tensions: bool = False,
    ) -> None:
        _, span, device = sim.device_arrays(name, world, writes=False)
        count = span.stop - span.start
        self._sim, self._object, self._columns, self._tensions = sim, (name, world), (normals, velocities), tensions
        self._particles = _Buffer((count, 3 + 3 * normals + 3 * velocities + tensions), wp.float32, device)
        self._mesh = None
        if mesh:
            self._surface = Surface(sim, name, world)
            self._mesh = np.zeros((0, 3))
        self._record()
        self._done = wp.Event(device) if device.is_cuda else None
        self._under_way = False

    def _record(self) -> None:
        """The launches, for the arrays that hold the object now."""
        arrays, span, device = self._sim.device_arrays(*self._object, writes=False)
        count = span.stop - span.start
        inputs = [arrays, span.start, *self._columns, self._particles.device_array]
        self._commands = [wp.launch(write_particles, dim=count, inputs=inputs, device=device, record_cmd=True)]
        if self._tensions:
            out = self._particles.device_array
            self._commands.append(self._sim.tensions_into(out, out.shape[1] - 1, *self._object))
        self._build = self._sim.builds

    def request(self) -> None:
        """Start writing and copying the state as it will be when all launched frames are done."""
        if self._build != self._sim.builds:
            self._record()
        for command in self._commands:
            command.launch()
        self._particles.copy()
        if self._mesh is not None:
            self._surface.request()
        if self._done is not None:
            wp.record_event(self._done)
            self._under_way = True

    def wait(self) -> None:
        """Wait for what was requested, in the thread that requested it."""
        if self._under_way:
            wp.synchronize_event(self._done)
            self._under_way = False

    def particles(self) -> np.ndarray:
        """(N, 3 to 10) float32: x y z [m], then normals, velocities [m/s] and the tension [N], as asked for."""
        self.wait()
        return self._particles.view

    def mesh(self) -> np.ndarray:
        """(3T, 3) float64 corners of the triangles [m] of a cloth that are left, (N, 3) points of a rope."""
        if self._mesh is None:
            raise ValueError("this Readback was made without a mesh; allowed is Readback(..., mesh=True)")
        particles = self.particles()
        triangles = self._surface.triangles()
        order = triangles.ravel() if len(triangles) else np.arange(0 if self._surface.tears else len(particles))
        if len(order) != len(self._mesh):
            self._mesh = np.zeros((len(order), 3))
        self._mesh[:] = particles[order, :3]
        return self._mesh


class Surface:
    """An object's triangles in a world, as tearing leaves them: `request()` copies them, `triangles()` waits."""

    def __init__(self, sim: Simulation, name: str, world: int = 0) -> None:
        self._sim, self._object = sim, (name, world)
        self._all, self.tears = sim.triangles(name), sim.tears(name)
        self._left, self._done = None, None
        device = sim.device_arrays(name, world, writes=False)[2]
        if self.tears:
            count = sim.panels_left(name, world).shape[0]
            self._left = wp.empty(count, dtype=wp.vec3i, device="cpu", pinned=device.is_cuda)
            self._done = wp.Event(device) if device.is_cuda else None

    def request(self) -> None:
        """Start copying the triangles as they will be when all launched frames are done."""
        if self._left is not None:
            wp.copy(self._left, self._sim.panels_left(*self._object))
            if self._done is not None:
                wp.record_event(self._done)

    def triangles(self) -> np.ndarray:
        """(T, 3) int32; of what tears, those that are left."""
        if self._left is None:
            return self._all
        if self._done is not None:
            wp.synchronize_event(self._done)
        rows = self._left.numpy()
        return rows[rows[:, 0] != rows[:, 1]]


class EndReadback:
    """A rope's loads on the supports of its ends, in one world: `request()` as for a Readback, then `wrenches()`."""

    def __init__(self, sim: Simulation, name: str, world: int = 0) -> None:
        device = sim.device_arrays(name, world, writes=False)[2]
        self._sim, self._object = sim, (name, world)
        self._buffer = _Buffer((2, 6), wp.float32, device)
        self._record()
        self._done = wp.Event(device) if device.is_cuda else None

    def _record(self) -> None:
        self._command = self._sim.end_wrenches_into(self._buffer.device_array, *self._object)
        self._build = self._sim.builds

    def request(self) -> None:
        """Start computing and copying the wrenches as they will be when all launched frames are done."""
        if self._build != self._sim.builds:
            self._record()
        self._command.launch()
        self._buffer.copy()
        if self._done is not None:
            wp.record_event(self._done)

    def wrenches(self) -> np.ndarray:
        """(2, 6) float32, see Simulation.end_wrenches; holds until the next request."""
        if self._done is not None:
            wp.synchronize_event(self._done)
        return self._buffer.view


class _Buffer:
    """A device array and its host copy: pinned beside a GPU, the same memory on the CPU."""

    def __init__(self, shape: tuple[int, int], dtype: type, device: wp.Device) -> None:
        self.device_array = wp.zeros(shape, dtype=dtype, device=device)
        self._host = self.device_array
        if device.is_cuda:
            self._host = wp.zeros(shape, dtype=dtype, device="cpu", pinned=True)
        self.view = self._host.numpy()

    def copy(self) -> None:
        if self._host is not self.device_array:
            wp.copy(self._host, self.device_array)
