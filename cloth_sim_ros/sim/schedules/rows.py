"""Method verlet for grids on a CPU: one launch a frame like the resident schedule, with the springs of eight particles
at a time (see row_lanes.py). What air and colliders do is done particle by particle, as elsewhere.
"""

from functools import lru_cache

import numpy as np
import warp as wp

from cloth_sim_ros.sim.model import Features
from cloth_sim_ros.sim.physics.integrate import make_step, outer_weight
from cloth_sim_ros.sim.schedules import row_lanes
from cloth_sim_ros.sim.schedules.air import make_panels
from cloth_sim_ros.sim.schedules.contact import make_contact
from cloth_sim_ros.sim.schedules.edge_contact import make_edge_contact
from cloth_sim_ros.sim.schedules.native import CPU_FLAGS, array_address, load_row, number_address
from cloth_sim_ros.sim.schedules.plate import curve_triangle
from cloth_sim_ros.sim.schedules.row_lanes import finish_lanes, predict_lanes, read3, read4, write3, write4
from cloth_sim_ros.sim.schedules.simd import LANES
from cloth_sim_ros.sim.schedules.stages import (
    first_share,
    make_kick,
    spring_constants,
    store_velocity,
    sweep_colliders,
)
from cloth_sim_ros.sim.schedules.watch import count_fault, is_good, keep, put_back
from cloth_sim_ros.sim.state import Arrays, gathered, given_type
from cloth_sim_ros.sim.topology import KINDS, Topology


@wp.struct
class Grid:
    """Where one body lies in the planes (see row_lanes.py)."""

    size: int  # places of a plane
    first: int  # the first particle's first number
    weights: int  # the weight of its first spoke
    spokes: int
    spoke_count: int


@wp.struct
class Planes:
    """The grids of a batch; numbers of all worlds behind one another.

    Spokes are springs around every particle, as far as it has them.
    """

    grids: wp.array(dtype=Grid)  # (B,)
    size: int  # of a world's numbers
    numbers: wp.array(dtype=float)
    spokes: wp.array(dtype=wp.vec2i)  # places to the other end, and kind in KINDS
    rests: wp.array(dtype=wp.vec2)  # rest length [m], and what float32 lost of it, over it
    weights: wp.array(dtype=float)  # a plane of each spoke: 1/scale, 0 where a particle has none


class Rows:
    """The launch of one batch of bodies that fit. `advance()` simulates one frame of every body in every world."""

    def __init__(self, features: Features, worlds: list[Arrays], topologies: list[Topology], device: wp.Device):
        planes = lay_out(topologies, len(worlds), device)
        self._launch = wp.launch(
            make_frame(features),
            dim=len(worlds) * len(topologies),
            inputs=[gathered(worlds, device), planes],
            device=device,
            record_cmd=True,
        )

    def advance(self, substeps: int, iterations: int, outer: int) -> None:
        """Launch one frame; the numbers are read from the device's Frame, where they are already."""
        self._launch.launch()


def fits_rows(features: Features, topology: Topology, device: wp.Device) -> bool:
    """Whether a body can be computed in rows."""
    return device.is_cpu and features.method == "verlet" and topology.grid is not None


def spokes_of(topology: Topology) -> list[tuple[int, int, float, np.ndarray]]:
    """Spokes in the order of Model.spokes, each as (places to the other end, kind, rest length [m], weights (N,))."""
    found = []
    for kind, elements in topology.springs.items():
        steps = elements.particles[:, 1] - elements.particles[:, 0]
        for step in dict.fromkeys(steps.tolist()):
            chosen = steps == step
            rest = float(np.round(elements.rest[chosen][0], 12))
            for sign, hub in ((-1, 1), (1, 0)):
                weights = np.zeros(len(topology.masses))
                weights[elements.particles[chosen, hub]] = np.round(1.0 / elements.scale[chosen], 9)
                found.append((sign * step, KINDS.index(kind), rest, weights))
    return found


def lay_out(topologies: list[Topology], worlds: int, device: wp.Device) -> Planes:
    """The planes of all bodies of a batch, with room around each for the farthest spokes and the last lanes.

    An odd number of cache lines is a plane, or equal places of all would fall into the same few places of the cache,
    which takes twice as long.
    """
    grids, spokes, rests, weights, size, weighed = [], [], [], [], 0, 0
    for topology in topologies:
        around, count = spokes_of(topology), len(topology.masses)
        margin = max(abs(step) for step, *_ in around)
        places = 16 * (-(-(count + LANES + 2 * margin) // 16) | 1)
        grids.append((places, size + margin, weighed + margin, len(spokes), len(around)))
        for step, kind, rest, each in around:
            spokes.append((step, kind))
            rests.append((rest, 1.0 - float(np.float32(rest)) / rest))
            weights.append(np.pad(each, (margin, places - margin - count)))
        size += row_lanes.PLANES * places
        weighed += len(around) * places
    planes = Planes()
    planes.size = size
    planes.grids = wp.array(np.array(grids, dtype=Grid.numpy_dtype()), dtype=Grid, device=device)
    planes.numbers = wp.zeros(worlds * size, dtype=float, device=device)
    planes.spokes = wp.array(np.array(spokes, dtype=np.int32), dtype=wp.vec2i, device=device)
    planes.rests = wp.array(np.array(rests, dtype=np.float32), dtype=wp.vec2, device=device)
    planes.weights = wp.array(np.concatenate(weights).astype(np.float32), dtype=float, device=device)
    return planes


@lru_cache
def make_frame(features: Features):
    """The kernel of a whole frame for `features`."""
    panels = make_panels(features) if features.panels else None
    kick = make_kick(features) if features.has_outer else None
    contact = make_contact(features) if features.shapes else None
    edge_contact = make_edge_contact(features.shapes, features.order) if "edge" in features.constraints else None
    argument = given_type(features)

    @wp.kernel(enable_backward=False, module="unique", module_options=CPU_FLAGS)
    def simulate_rows(given: argument, planes: Planes):
        w = wp.tid() / planes.grids.shape[0]
        b = wp.tid() - w * planes.grids.shape[0]
        if wp.static(features.worlds):
            m = given[w].model
            s = given[w].state
            frame = given[w].frames[0]
            material = given[w].materials[b]
            colliders = given[w].colliders
        else:
            m = given.model
            s = given.state
            frame = given.frames[0]
            material = given.materials[b]
            colliders = given.colliders
        body = m.bodies[b]
        grid = planes.grids[b]
        size, count = grid.size, body.count
        x = array_address(s.positions, body.particles)
        low = array_address(s.low, body.particles)
        v = array_address(s.velocities, body.particles)
        d = array_address(s.displacements, body.particles)
        numbers = number_address(planes.numbers, w, planes.size, grid.first)
        weights = number_address(planes.weights, 0, 0, grid.weights)
        read4(numbers, size, wp.static(row_lanes.X), count, x)
        read3(numbers, size, wp.static(row_lanes.LOW), count, low)
        read3(numbers, size, wp.static(row_lanes.V), count, v)
        constants = spring_constants(material)
        step = make_step(frame.dt, s.history[b] > 0, 1, frame.global_damping)
        # Once more after the last substep, for the slow forces at the end of the frame.
        for substep in range(frame.substeps + 1):
            if wp.static(kick is not None):
                weight = outer_weight(substep, frame.substeps, frame.outer)
                if weight > 0.0:
                    write4(numbers, size, wp.static(row_lanes.X), count, x)
                    write3(numbers, size, wp.static(row_lanes.LOW), count, low)
                    write3(numbers, size, wp.static(row_lanes.V), count, v)
                    if wp.static(panels is not None):
                        panels(0, 1, m, s, body, material, frame, False, x)
                    if wp.static(features.curved):
                        for c in range(body.curves, body.curves_end):
                            curve_triangle(c, m, s, body, x, low)
                    for i in range(count):
                        kick(i, weight * frame.dt, m, s, body, material, x, low, d)
                    for i in range(count):
                        store_velocity(i, s, body, d)
                    read3(numbers, size, wp.static(row_lanes.V), count, v)
            if substep == frame.substeps:
                break
            predict_lanes(
                numbers,
                size,
                count,
                planes.spokes,
                planes.rests,
                weights,
                grid.spokes,
                grid.spoke_count,
                constants,
                material.damping,
                frame.gravity,
                frame.global_damping,
                step.eased,
                first_share(step),
                step.effective,
            )
            if wp.static(bool(features.shapes)):
                sweep_colliders(0, 1, b * colliders.shape[0], substep, colliders, frame, s.sweeps)
                write4(numbers, size, wp.static(row_lanes.X), count, x)
                write3(numbers, size, wp.static(row_lanes.LOW), count, low)
                write4(numbers, size, wp.static(row_lanes.D), count, d)
                for iteration in range(frame.iterations):
                    step.first = iteration == 0
                    step.repeats = frame.iterations > 1
                    if wp.static(edge_contact is not None):
                        for g in range(body.groups_end, body.edge_groups_end):
                            for k in range(m.groups[g][2], m.groups[g][3]):
                                edge_contact(k, b, body, material, colliders, m, s, step, x, low, d)
                    for i in range(count):
                        sweep, slot = b * colliders.shape[0], body.particles + i
                        speeds, moves = s.velocities, s.last_displacements
                        contact(
                            i, sweep, slot, material, colliders, s.sweeps, s.contacts, speeds, moves, step, x, low, d
                        )
                read3(numbers, size, wp.static(row_lanes.D), count, d)
            finish_lanes(numbers, size, count, step.effective)
            step.second = True
        write4(numbers, size, wp.static(row_lanes.X), count, x)
        write3(numbers, size, wp.static(row_lanes.LOW), count, low)
        write3(numbers, size, wp.static(row_lanes.V), count, v)
        for g in range(body.particles, body.particles + count):
            if not is_good(load_row(s.positions, g), load_row(s.velocities, g)):
                s.faulty[b] = 1
        for g in range(body.particles, body.particles + count):
            if s.faulty[b] == 1:
                put_back(g, s.relapses[b], m, s)
            else:
                keep(g, load_row(s.positions, g), load_row(s.low, g), s)
        s.history[b] = wp.where(count_fault(b, s), 0, 1)

    return simulate_rows
