# SPDX-License-Identifier: Apache-2.0
"""What varies, as kernels see it: the structs of a batch's state and of the live numbers that are read every frame.

What ropes have besides is in rope_state.py. State arrays are made in state_arrays.py. Live numbers lie in arrays of one
row a thing (live_array.py).
"""

from __future__ import annotations

import warp as wp

from cloth_sim_ros.sim.arrays.model import Features, Model
from cloth_sim_ros.sim.arrays.rope_state import BeamRow, Drive, EndTurn, Segment, Twist, WinchState


@wp.struct
class Material:
    """One body. compliance: structural, shear (a rope's: twist), bending in units of the scene; lengths [m], damping
    [s]. largest_inverse_mass: its mass in Model over what it weighs here."""

    compliance: wp.vec3
    damping: float
    thickness: float
    static_friction: float
    kinetic_friction: float
    largest_inverse_mass: float


@wp.func
def compliance_of(material: Material, kind: int) -> float:
    """The compliance of a kind of topology.KINDS, by selection: an index would put the struct into local memory."""
    return wp.where(
        kind == 0, material.compliance[0], wp.where(kind == 1, material.compliance[1], material.compliance[2])
    )


@wp.struct
class Frame:
    """One batch. gravity [m/s^2], dt of a substep [s], global_damping [1/s], wind [m/s],
    air_density [kg/m^3]. moves: 1 while a collider or handle moves."""

    gravity: wp.vec3
    dt: float
    substeps: int
    iterations: int
    global_damping: float
    wind: wp.vec3
    air_density: float
    drag: float
    lift: float
    moves: int


@wp.struct
class ColliderMotion:
    """One collider: shape, size, reach [m] of it around its origin, friction, and poses at both ends of the frame.

    data: the address of what a shape has beside its size, of one that three numbers do not describe; 0 for others.
    roundness: the smallest radius of curvature of its surface, as far as is known [m]. compliance: of each point of
    contact [m/N].
    """

    shape: int
    size: wp.vec3
    data: wp.uint64
    reach: float
    roundness: float
    compliance: float
    static_friction: float
    kinetic_friction: float
    start_position: wp.vec3
    start_orientation: wp.quat
    end_position: wp.vec3
    end_orientation: wp.quat
    filler: int  # the struct is of whole words of eight bytes, so that equal colliders are equal bytes in a file


@wp.struct
class HandleMotion:
    """One handle: its reach as a box and a ball around its origin [m], how it holds, and poses at both ends of the
    frame.

    reach: half the edges of the box, and the radius of the ball; what is grasped lies in both.
    """

    reach: wp.vec4
    compliance: float  # of the whole hold [m/N]
    break_force: float  # [N], 0 is never
    start_position: wp.vec3
    start_orientation: wp.quat
    end_position: wp.vec3
    end_orientation: wp.quat


@wp.struct
class Sweep:
    """One collider within one substep: R^T at its end, R^T_end - R^T_start and a bound of it, position, motion [m]."""

    to_local: wp.mat33
    turn: wp.mat33
    spin: float
    position: wp.vec3
    motion: wp.vec3


@wp.struct
class Press:
    """What one collider asks of one facet, a triangle or segment, in substep `when`; in any other it asks for nothing.

    when: -1 for the last substep of the frame before. push [kg m], at the point of these weights of the corners, and
    rub, of friction, at that of weights `rubbed`. normal: out of the collider. so_far: friction and normal correction
    in this substep [kg m]. While the facet sticks, the point of weights `stuck` is held at `anchor` [m], in the
    collider's axes; all 0 where it slides. stops: the shares of their ways that its corners give up in substep
    `stopped`.
    """

    when: int
    weights: wp.vec3
    push: wp.vec3
    rubbed: wp.vec3
    rub: wp.vec3
    normal: wp.vec3
    so_far: wp.vec4
    stuck: wp.vec3
    anchor: wp.vec3
    stopped: int
    stops: wp.vec3


@wp.struct
class Look:
    """What was found when the deepest point of a facet in a collider was last looked for in this frame.

    Where its corners were then [m], in the collider's axes, the weights of that point, and the signed distance there
    [m]; known: 1 where there was such a time (a bool would leave bytes that nobody sets in what is saved).
    """

    a: wp.vec3
    b: wp.vec3
    c: wp.vec3
    weights: wp.vec3
    value: float
    known: int


@wp.struct
class State:
    """Arrays of one batch; N particles, S slots of lines, C segments, P panels, K colliders, B bodies."""

    positions: wp.array(dtype=wp.vec4)  # (N,) x y z [m] and inverse mass [1/kg], 0 is pinned
    position_lo: wp.array(
        dtype=wp.vec4
    )  # (N,) what float32 lost of the positions [m]; the sum of the sizes of line forces [N]
    displacements: wp.array(dtype=wp.vec4)  # (N,) of the substep, and the effective inverse mass [1/kg]
    velocities: wp.array(dtype=wp.vec4)  # (N,) [m/s]
    last_velocities: wp.array(dtype=wp.vec3)  # (N,) one substep ago, order 2 alone
    last_displacements: wp.array(dtype=wp.vec3)  # (N,) of the last substep [m], order 2 alone
    line_multipliers: wp.array(dtype=float)  # (S,) h_e^2 x force [kg m] of the springs in the slots of lines
    line_slips: wp.array(dtype=float)  # (S,) rate at which they got longer behind their solve [m/s], order 2 alone
    tautness: wp.array(dtype=float)  # (N,) the largest tension of a line through a particle [N]
    line_scratch: wp.array(dtype=float)  # what a line is eliminated in, on a CPU
    predicted: wp.array(dtype=wp.vec4)  # (N,) displacements before a sheet's bending moves particles
    curve_normals: wp.array(dtype=wp.vec3)  # (C,) unit normals of triangles that are curved at rest
    curve_pulls: wp.array(dtype=wp.vec3)  # (C,) how these push their corners along it [1/m]
    tensions: wp.array(dtype=float)  # (C,) [N]
    targets: wp.array(dtype=wp.vec3)  # (N,) where particles of a chain would be without it [m], chains alone
    solved: wp.array(dtype=wp.vec3)  # (N,) where its last solve put them [m], chains alone
    chain_forces: wp.array(dtype=wp.vec3)  # (N,) of a chain on its particles in the last substep [N], chains alone
    segments: wp.array(dtype=Segment)  # (C,)
    ladder: wp.array(dtype=wp.float64)  # scratch of the same on a CPU (see ropes/elimination.py)
    moments: wp.array(dtype=wp.vec3)  # (C,) bending moment [N m] behind each segment of a chain that bends
    beam: wp.array(dtype=BeamRow)  # (N,)
    bend_moves: wp.array(dtype=wp.vec3)  # (N,) [m] by bending so far in this substep, of ropes that are bent at rest
    couples: wp.array(dtype=wp.vec3)  # (C,) torsional moment x half the curvature binormal [N m] at each such joint
    twists: wp.array(dtype=Twist)  # (B,) of ropes that resist twist, and when the body was last good
    good_twists: wp.array(dtype=Twist)  # (B,)
    ahead_positions: wp.array(dtype=wp.vec4)  # (N,) after one more substep as smooth as the last, order 2 in wind alone
    ahead_velocities: wp.array(dtype=wp.vec4)  # (N,)
    panel_forces: wp.array(dtype=wp.vec4)  # (P,) force [N], drag rate [N s/m]
    contacts: wp.array(dtype=wp.vec4)  # (K N,) how a collider moved a particle so far in a substep, in its axes [m]
    contact_forces: wp.array(dtype=wp.vec4)  # (K N,) of each collider on each particle, mean over the frame [N]
    supports: wp.array(dtype=wp.vec4)  # (N,) by a collider in the last substep [m/s^2], and 1 + its number, of chains
    presses: wp.array(dtype=Press)  # (P K,) of surfaces that are tested between particles, as the next three
    looks: wp.array(dtype=Look)  # (P K,)
    close: wp.array(dtype=int)  # (N,) whether facets around a particle may touch a collider in this substep
    facets_moved_in: wp.array(dtype=int)  # (B,) one more than the last substep in which facets moved a particle
    pressed: wp.array(dtype=int)  # (N,) and bits of what they did to it, see stages/stop.py
    path_starts: wp.array(dtype=wp.vec3)  # (N,) where their ways start [m], see meeting/search.py,
    path_velocities: wp.array(dtype=wp.vec3)  # (N,) how fast they go along these [m/s],
    off_path: wp.array(dtype=float)  # (N,) and how far they are off them, or will be when the substep ends [m]
    pair_corrections: wp.array(dtype=wp.int64)  # (7 N,) what pairs ask of a particle, see meeting/apart.py
    ways_given_up: wp.array(dtype=float)  # (N,) and what share of its way it gives up, or it came through something
    sweeps: wp.array(dtype=Sweep)  # (SWEPT B K,)
    near: wp.array(dtype=wp.uint64)  # (B K/64,) bits of the colliders that a body may meet in this frame, see near.py
    extents: wp.array(dtype=float)  # (8 B,)
    boxes: wp.array(dtype=wp.vec4)  # (2 B,)
    grips: wp.array(dtype=wp.vec4)  # (N,) place in the axes of the handle that holds a particle [m], and 1 + its number
    grip_pulls: wp.array(dtype=wp.vec4)  # (N,) of the handle on the particle in the last substep [N]
    grip_forces: wp.array(dtype=wp.vec4)  # (N,) of the handle on the particle, mean over the frame [N]
    held: wp.array(dtype=int)  # (B,) particles that handles hold
    # What of Model's arrays of these names is left of objects that tear. The rest length of a spring that failed is
    # below 0: less itself in the frame in which it failed. The corners of a triangle that failed are its first one.
    line_rests: wp.array(dtype=float)
    panels: wp.array(dtype=wp.vec3i)
    panel_parts: wp.array(dtype=wp.vec2i)
    plate_weights: wp.array(dtype=float)
    curve_stencil_gradients: wp.array(dtype=float)
    curve_gradients: wp.array(dtype=float)
    tearing: wp.array(dtype=int)  # (B,) whether a spring failed in this frame
    winches: wp.array(dtype=WinchState)  # (B,) of ropes that a winch feeds, and when the body was last good
    good_winches: wp.array(dtype=WinchState)  # (B,)
    good_positions: wp.array(dtype=wp.vec4)  # (N,) positions when the body was last good, see watch.py
    start_positions: wp.array(dtype=wp.vec4)  # (N,) where this frame began, explicit methods, see trial.py
    start_position_lo: wp.array(dtype=wp.vec4)  # (N,)
    start_velocities: wp.array(dtype=wp.vec4)  # (N,)
    start_recoveries: wp.array(dtype=int)  # (B,)
    strain_found: wp.array(dtype=float)  # (B,) largest strain above 0.5 at the end of this frame, else 0
    strain: wp.array(dtype=float)  # (B,) the same of the frame before
    rejected: wp.array(dtype=int)  # (B,) whether the frame is done again
    redone: wp.array(dtype=int)  # (B,) how many frames were
    faulty: wp.array(dtype=int)  # (B,) whether a particle was found bad at the end of this frame
    recoveries: wp.array(dtype=int)  # (B,) how often the body was put back
    relapses: wp.array(dtype=int)  # (B,) how many frames in a row ended so
    overstretched: wp.array(dtype=int)  # (B,) whether a chain is in this substep, as a graph
    history: wp.array(dtype=int)  # (B,) whether smooth substeps lie behind this one, order 2 and verlet
    events: wp.array(dtype=int)  # (2 B,) 1 + the last even and odd substep that was not smooth, as a graph


@wp.struct
class Arrays:
    """Everything a kernel reads or writes in one world: the one argument that every executor passes.

    Many worlds are an array of these: they share the model, and each has its own part of everything that varies.
    """

    model: Model
    state: State
    frames: wp.array(dtype=Frame)  # (1,)
    materials: wp.array(dtype=Material)  # (B,)
    colliders: wp.array(dtype=ColliderMotion)  # (K,)
    handles: wp.array(dtype=HandleMotion)  # (H,)
    handle_counts: wp.array(dtype=int)  # (H,) particles that each holds
    drives: wp.array(dtype=Drive)  # (B,) of ropes that a winch feeds
    forces: wp.array(dtype=wp.vec4)  # (F,) numbers of the scene's own forces
    ends: wp.array(dtype=EndTurn)  # (B,) of ropes that resist twist


def given_type(features: Features) -> type:
    """The type of the argument that a kernel gets: the Arrays of its world, or of many an array of them."""
    return wp.array(dtype=Arrays) if features.worlds else Arrays


def gathered(worlds: list[Arrays], device: wp.Device) -> Arrays | wp.array:
    """The argument for kernels that run `worlds` (see `given_type`)."""
    return worlds[0] if len(worlds) == 1 else wp.array(worlds, dtype=Arrays, device=device)
