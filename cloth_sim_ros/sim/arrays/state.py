# SPDX-License-Identifier: Apache-2.0
"""Varying arrays, as kernels see them: the structs of a batch's state and of the live numbers of every frame.

The arrays of a feature are in its file arrays.py. engine/state_arrays.py builds the state arrays. Live numbers are
arrays with one row per object (live_array.py).
"""

from __future__ import annotations

import warp as wp

from cloth_sim_ros.sim.arrays.model import Features, Model
from cloth_sim_ros.sim.executors.arrays import TrialState
from cloth_sim_ros.sim.features.air.arrays import AirState
from cloth_sim_ros.sim.features.collider_contact.arrays import ContactState
from cloth_sim_ros.sim.features.constraints.arrays import ConstraintState
from cloth_sim_ros.sim.features.grasp.arrays import GraspState
from cloth_sim_ros.sim.features.plate.arrays import PlateState
from cloth_sim_ros.sim.features.seams.arrays import SeamState
from cloth_sim_ros.sim.features.self_contact.arrays import SelfContactState
from cloth_sim_ros.sim.features.tearing.arrays import TearingState
from cloth_sim_ros.sim.features.twist.arrays import EndTurn, TwistState
from cloth_sim_ros.sim.features.winch.arrays import Drive, WinchArrays
from cloth_sim_ros.sim.input.numbers import NumbersRow
from cloth_sim_ros.sim.lines.arrays import LineState
from cloth_sim_ros.sim.ropes.arrays import RopeState
from cloth_sim_ros.sim.substeps.arrays import ControlState, StepLimits


@wp.struct
class Material:
    """Material of one body.

    compliance: structural, shear (in a rope: twist) and bending, in units of the scene. damping, bend_damping: times of
    the dashpots [s]. thickness: [m].
    largest_inverse_mass: the body's mass in Model over its mass in this world.
    """

    compliance: wp.vec3
    damping: float
    bend_damping: float
    thickness: float
    static_friction: float
    kinetic_friction: float
    largest_inverse_mass: float


@wp.func
def compliance_of(material: Material, kind: int) -> float:
    """The compliance of a kind in topology.KINDS; selected, as an index would put the struct into local memory."""
    return wp.where(
        kind == 0, material.compliance[0], wp.where(kind == 1, material.compliance[1], material.compliance[2])
    )


@wp.struct
class Frame:
    """Frame of one batch. gravity [m/s^2], length [s], global_damping [1/s], wind [m/s], air_density [kg/m^3].

    moves: 1 while a collider or handle moves. squeezes: 1 while colliders squeeze what is between them. wakes: 1 if
    anything else changed before this frame.

    Each body sets `substeps`, and the length dt of a substep [s], itself.
    """

    gravity: wp.vec3
    length: float
    dt: float
    substeps: int
    iterations: int
    global_damping: float
    wind: wp.vec3
    air_density: float
    drag: float
    lift: float
    moves: int
    wakes: int
    squeezes: int


@wp.struct
class PathBends:
    """How a path through a frame differs from the straight way, see physics/path.py; all 0 if it does not.

    start, end [m], start_turn, end_turn [rad].
    """

    start: wp.vec3
    end: wp.vec3
    start_turn: wp.vec3
    end_turn: wp.vec3


@wp.struct
class ColliderMotion:
    """One collider: shape, size, reach around its origin [m], friction, and poses at both ends of the frame.

    data: address of a shape's data beside its size; 0 for shapes that need none. compliance: of each point of contact
    [m/N]. opposite: 1 + the number of the
    collider with which it pinches, 0 if there is none. squeeze: load on each point that both touch
    [N]. half_gap: half the distance of their surfaces [m].
    """

    shape: int
    size: wp.vec3
    data: wp.uint64
    reach: float
    compliance: float
    static_friction: float
    kinetic_friction: float
    start_position: wp.vec3
    start_orientation: wp.quat
    end_position: wp.vec3
    end_orientation: wp.quat
    bends: PathBends
    facets: int  # its `cost` if it can come between particles, so that facets are tested against it, else 0
    opposite: int
    squeeze: float
    half_gap: float


@wp.struct
class HandleMotion:
    """One handle: its reach, how it holds, and poses at both ends of the frame.

    reach: half the edges of a box and the radius of a ball around its origin [m]; grasped particles lie in both.
    """

    reach: wp.vec4
    compliance: float  # of the whole hold [m/N]
    break_force: float  # [N], 0 is never
    start_position: wp.vec3
    start_orientation: wp.quat
    end_position: wp.vec3
    end_orientation: wp.quat
    bends: PathBends


@wp.struct
class State:
    """State arrays of one batch. The arrays of a feature lie in a struct of its own, see its file arrays.py.

    N particles, S slots of lines, C segments, P panels, K colliders, B bodies.
    """

    positions: wp.array(dtype=wp.vec4)  # (N,) x y z [m] and inverse mass [1/kg], 0 is pinned
    # (N,) rounding error of the float32 positions [m], and the sum of the magnitudes of line forces [N]
    position_lo: wp.array(dtype=wp.vec4)
    displacements: wp.array(dtype=wp.vec4)  # (N,) in the substep [m], and the effective inverse mass [1/kg]
    velocities: wp.array(dtype=wp.vec4)  # (N,) [m/s]
    last_velocities: wp.array(dtype=wp.vec3)  # (N,) [m/s] one substep ago, order 2 alone
    last_displacements: wp.array(dtype=wp.vec3)  # (N,) of the last substep [m], order 2 alone
    good_positions: wp.array(dtype=wp.vec4)  # (N,) positions when the body was last good, see fault_recovery.py
    faulty: wp.array(dtype=int)  # (B,) nonzero if a particle was found bad at the end of this frame
    recoveries: wp.array(dtype=int)  # (B,) number of times the body was put back
    relapses: wp.array(dtype=int)  # (B,) number of frames in a row that ended so
    history: wp.array(dtype=int)  # (B,) nonzero if smooth substeps lie behind this one, order 2 and verlet
    events: wp.array(dtype=int)  # (2 B,) 1 + the last even and odd substep that was not smooth, as a graph
    lines: LineState
    plate: PlateState
    rope: RopeState
    twist: TwistState
    air: AirState
    contact: ContactState
    self_contact: SelfContactState
    constraints: ConstraintState
    seams: SeamState
    grasp: GraspState
    tearing: TearingState
    winch: WinchArrays
    trial: TrialState
    control: ControlState


@wp.struct
class Arrays:
    """Everything a kernel reads or writes in one world: the one argument that every executor passes.

    Many worlds are an array of these. They share the model, and each has its own state.
    """

    model: Model
    state: State
    frames: wp.array(dtype=Frame)  # (1,)
    limits: wp.array(dtype=StepLimits)  # (B,)
    materials: wp.array(dtype=Material)  # (B,)
    colliders: wp.array(dtype=ColliderMotion)  # (K,)
    handles: wp.array(dtype=HandleMotion)  # (H,)
    handle_counts: wp.array(dtype=int)  # (H,) particles that each holds
    drives: wp.array(dtype=Drive)  # (B,) of ropes that a winch feeds
    numbers: wp.array(dtype=NumbersRow)  # of the scene's own forces, then of its constraints and seams
    ends: wp.array(dtype=EndTurn)  # (B,) of ropes that resist twist


@wp.func
def substeps_of(control: ControlState, limits: StepLimits, b: int) -> int:
    """Substeps of body b in this frame, which may be a trial, or be computed again."""
    chosen = wp.where(control.substeps[b] > 0, control.substeps[b], limits.start)
    return wp.max(1, chosen * wp.max(1, control.factors[b]) / wp.max(1, control.divisors[b]))


@wp.func
def rests(control: ControlState, frame: Frame, b: int) -> bool:
    """True if body b is not computed in this frame: it is at rest, and nothing around it moves or was changed."""
    return control.asleep[b] > 0 and frame.moves == 0 and frame.wakes == 0


@wp.func
def substep_length(frame: Frame, control: ControlState, limits: StepLimits, b: int) -> float:
    """Length of a substep of body b in this frame [s]."""
    return frame.length / float(substeps_of(control, limits, b))


@wp.func
def was_smooth(events: wp.array(dtype=int), history: wp.array(dtype=int), b: int, substep: int) -> bool:
    """True if the substep before this one of body b was smooth, so that BDF2 may look back."""
    if substep == 0:
        return history[b] > 0
    return events[2 * b + (substep + 1) % 2] != substep  # two slots alternate, so none is read while it is written


def given_type(features: Features) -> type:
    """The type of a kernel's argument: the Arrays of one world, or an array of them for several worlds."""
    return wp.array(dtype=Arrays) if features.worlds else Arrays


def gathered(worlds: list[Arrays], device: wp.Device) -> Arrays | wp.array:
    """The argument for kernels that run `worlds` (see `given_type`)."""
    return worlds[0] if len(worlds) == 1 else wp.array(worlds, dtype=Arrays, device=device)
