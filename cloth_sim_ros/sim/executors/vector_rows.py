# SPDX-License-Identifier: Apache-2.0
"""Method verlet for grids on a CPU: one launch a frame like the block executor, with the springs of many particles
at a time (see vector_rows_simd.py). What air and colliders do is done particle by particle, as elsewhere.
"""

from functools import lru_cache

import numpy as np
import warp as wp

from cloth_sim_ros.sim.compiled import compiled
from cloth_sim_ros.sim.executors import vector_rows_simd as row_lanes
from cloth_sim_ros.sim.executors.vector_rows_simd import finish_lanes, predict_lanes, read3, read4, write3, write4
from cloth_sim_ros.sim.intrinsics import array_address, number_address
from cloth_sim_ros.sim.methods.program import make_begin, make_enter, make_program
from cloth_sim_ros.sim.methods.stage import in_turn
from cloth_sim_ros.sim.model import Features
from cloth_sim_ros.sim.physics.integrate import outer_weight
from cloth_sim_ros.sim.stages.grasp import feel, hold
from cloth_sim_ros.sim.stages.here import Here
from cloth_sim_ros.sim.stages.motion import first_share, spring_constants
from cloth_sim_ros.sim.state import Arrays, gathered, given_type
from cloth_sim_ros.sim.topology import KINDS, Topology


@wp.struct
class Grid:
    """Where one body lies in the planes (see vector_rows_simd.py)."""

    size: int  # places of a plane
    first: int  # the first particle's first number
    weights: int  # the weight of its first spring
    incident_springs: int
    incident_count: int


@wp.struct
class Planes:
    """The grids of a batch; numbers of all worlds behind one another.

    IncidentSprings are springs around every particle, as far as it has them.
    """

    grids: wp.array(dtype=Grid)  # (B,)
    size: int  # of a world's numbers
    numbers: wp.array(dtype=float)
    incident_springs: wp.array(dtype=wp.vec2i)  # places to the other end, and kind in KINDS
    rests: wp.array(dtype=wp.vec2)  # rest length [m], and what float32 lost of it, over it
    weights: wp.array(dtype=float)  # a plane of each spring: 1/scale, 0 where a particle has none


class VectorRows:
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
    """Whether a body can be computed in vector rows."""
    is_grid = topology.grid is not None and topology.world_scales is None  # of one rest shape in all worlds
    return device.is_cpu and features.method == "verlet" and is_grid


def incident_springs_of(topology: Topology) -> list[tuple[int, int, float, np.ndarray]]:
    """Springs in the order of Model.incident_springs: (places to the other, kind, rest length [m], weights (N,))."""
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
    """The planes of all bodies of a batch, with room around each for the longest springs and the last lanes.

    An odd number of cache lines is a plane, or equal places of all would fall into the same few places of the cache,
    which takes twice as long.
    """
    grids, incident_springs, rests, weights, size, weighed = [], [], [], [], 0, 0
    for topology in topologies:
        around, count = incident_springs_of(topology), len(topology.masses)
        margin = max(abs(step) for step, *_ in around)
        places = 16 * (-(-(count + row_lanes.MOST + 2 * margin) // 16) | 1)
        grids.append((places, size + margin, weighed + margin, len(incident_springs), len(around)))
        for step, kind, rest, each in around:
            incident_springs.append((step, kind))
            rests.append((rest, 1.0 - float(np.float32(rest)) / rest))
            weights.append(np.pad(each, (margin, places - margin - count)))
        size += row_lanes.PLANES * places
        weighed += len(around) * places
    planes = Planes()
    planes.size = size
    planes.grids = wp.array(np.array(grids, dtype=Grid.numpy_dtype()), dtype=Grid, device=device)
    planes.numbers = wp.zeros(worlds * size, dtype=float, device=device)
    planes.incident_springs = wp.array(np.array(incident_springs, dtype=np.int32), dtype=wp.vec2i, device=device)
    planes.rests = wp.array(np.array(rests, dtype=np.float32), dtype=wp.vec2, device=device)
    planes.weights = wp.array(np.concatenate(weights).astype(np.float32), dtype=float, device=device)
    return planes


@lru_cache
def make_frame(features: Features):
    """The kernel of a whole frame for `features`: the program of explicit steps, moved by vector_rows_simd.py."""
    program = make_program(features, True)
    begin, enter = make_begin(features), make_enter(features)
    called = bool(features.shapes)
    outer, end = in_turn(program.outer, "outer", called), in_turn(program.ending, "ending", called)
    before = in_turn([stage for stage in program.before if stage.name != "predict"], "before", called)
    iterated, kept = in_turn(program.touched, "iterated", called), in_turn(program.kept, "kept", called)
    argument = given_type(features)

    @wp.func
    def store(planes: wp.uint64, size: int, here: Here):
        write4(planes, size, wp.static(row_lanes.X), here.body.count, here.x)
        write3(planes, size, wp.static(row_lanes.LOW), here.body.count, here.low)
        write3(planes, size, wp.static(row_lanes.V), here.body.count, velocities_of(here))

    @wp.func
    def kick_slowly(planes: wp.uint64, size: int, here: Here):
        store(planes, size, here)
        outer(0, 1, here)
        read3(planes, size, wp.static(row_lanes.V), here.body.count, velocities_of(here))

    @wp.func
    def touch(planes: wp.uint64, size: int, given: Here):
        here = given
        store(planes, size, here)
        write4(planes, size, wp.static(row_lanes.D), here.body.count, here.d)
        if wp.static(features.handles):
            for i in range(here.body.count):
                hold(i, here)
        if wp.static(iterated is not None):
            here.step.repeats = here.frame.iterations > 1
            for iteration in range(here.frame.iterations):
                here.step.first = iteration == 0
                iterated(0, 1, here)
        if wp.static(kept is not None):
            kept(0, 1, here)
        if wp.static(features.handles):
            for i in range(here.body.count):
                feel(i, here)
        read3(planes, size, wp.static(row_lanes.D), here.body.count, here.d)

    @wp.func
    def touches(here: Here) -> bool:
        if wp.static(features.handles and iterated is None):
            return here.state.held[here.body.index] > 0
        return wp.static(iterated is not None)

    @compiled(module="unique")
    def simulate_rows(given: argument, planes: Planes):
        w = wp.tid() / planes.grids.shape[0]
        b = wp.tid() - w * planes.grids.shape[0]
        if wp.static(features.worlds):
            here = begin(given[w], b)
        else:
            here = begin(given, b)
        grid = planes.grids[b]
        size, count = grid.size, here.body.count
        numbers = number_address(planes.numbers, w, planes.size, grid.first)
        weights = number_address(planes.weights, 0, 0, grid.weights)
        read4(numbers, size, wp.static(row_lanes.X), count, here.x)
        read3(numbers, size, wp.static(row_lanes.LOW), count, here.low)
        read3(numbers, size, wp.static(row_lanes.V), count, velocities_of(here))
        constants = spring_constants(here.material)
        frame = here.frame
        for substep in range(frame.substeps):
            here = enter(here, substep)
            if wp.static(outer is not None):
                if outer_weight(substep, frame.substeps, frame.outer) > 0.0:
                    kick_slowly(numbers, size, here)
            predict_lanes(
                numbers,
                size,
                count,
                planes.incident_springs,
                planes.rests,
                weights,
                grid.incident_springs,
                grid.incident_count,
                constants,
                here.material.damping,
                frame.gravity,
                frame.global_damping,
                here.step.eased,
                first_share(here.step),
                here.step.effective,
            )
            if wp.static(before is not None):
                before(0, 1, here)
            if touches(here):
                touch(numbers, size, here)
            finish_lanes(numbers, size, count, here.step.effective)
        here.substep = frame.substeps
        if wp.static(outer is not None):
            kick_slowly(numbers, size, here)
        store(numbers, size, here)
        end(0, 1, here)

    return simulate_rows


@wp.func
def velocities_of(here: Here) -> wp.uint64:
    """Where the velocities of a body lie."""
    return array_address(here.state.velocities, here.body.particles)
