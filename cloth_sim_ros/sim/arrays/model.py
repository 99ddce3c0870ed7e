# SPDX-License-Identifier: Apache-2.0
"""Constant arrays of a batch, as kernels see them: bodies that share a kernel, one after another in flat arrays.

Particle indices in elements count from the body's first particle, so a body's block needs no offset. `Body` holds where
its part of every array begins. model_arrays.py builds the arrays; state.py describes those that vary.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import warp as wp

from cloth_sim_ros.sim.colliders import curved_of
from cloth_sim_ros.sim.topology import Topology
from cloth_sim_ros.sim.topology.line_layout import slots_a_thread


@dataclass(frozen=True)
class Features:
    """Features of a batch's kernels; absent features are not compiled."""

    lines: bool  # springs that are solved line by line
    chain: bool  # a direct solve along a rope
    panels: str  # "" without wind, else "triangles" or "segments"
    shapes: tuple[str, ...]  # collider shapes
    order: int
    method: str
    segments: bool = False  # its facets are segments, not triangles
    worlds: bool = False  # True for several worlds, each with its own state
    beam: bool = False  # a chain that resists bending
    winch: bool = False  # a chain that a winch feeds
    twist: bool = False  # a beam that resists twist between two clamps
    plate: bool = False  # a sheet that resists bending by its curvature
    curved: bool = False  # a plate that is curved at rest
    surface: bool = False  # colliders can reach between particles (see colliders/collider.py)
    listed: bool = False  # colliders are so many that those near a body are listed (see broad_phase.py)
    handles: bool = False  # the scene has handles
    pinches: bool = False  # colliders pinch what is between them (see features/collider_contact/pinch.py)
    redoes: bool = False  # compute only bodies whose frame is repeated
    coupled: bool = False  # self or object contact
    sewn: bool = False  # seams hold it
    tears: bool = False  # springs can fail
    membrane: bool = False  # the elongations of springs change the rest lengths of others
    forces: tuple[str, ...] = ()  # names in forces.FORCES, in the order of Arrays.numbers
    constraints: tuple[str, ...] = ()  # names in constraints.CONSTRAINTS, of a body that has any
    line_slots: int = 1  # particles of a line that a thread of a warp holds

    def key(self) -> str:
        """Name of kernels with these features, equal in every process, so that caches on disk are found."""
        return hashlib.sha256(repr(self).encode()).hexdigest()[:12]

    @property
    def facet_shapes(self) -> tuple[str, ...]:
        """Shapes against which facets are tested."""
        return curved_of(self.shapes)

    @property
    def in_step(self) -> bool:
        """True if bodies end each substep together, as they touch one another or are sewn."""
        return self.coupled or self.sewn

    @property
    def looks_back(self) -> bool:
        """True if a substep depends on whether the one before it was smooth."""
        return self.order == 2 or self.method == "verlet"

    @property
    def measured(self) -> bool:
        """True if the error of frames is measured; explicit steps cannot take fewer substeps for it."""
        return self.method == "xpbd" and not self.redoes

    @property
    def audited(self) -> bool:
        """True if the energy of frames is judged (substeps/energy.py): nothing acts whose work is not known."""
        unknown = self.in_step or self.forces or self.constraints or self.winch
        return self.measured and (self.lines or self.chain) and not unknown

    @property
    def leans(self) -> bool:
        """True if colliders touch a rope within its solve, see features/collider_contact/lean.py."""
        return self.chain and self.shapes != ()

    @staticmethod
    def of(
        topology: Topology,
        wind: bool,
        shapes: tuple[str, ...],
        order: int = 1,
        method: str = "xpbd",
        worlds: bool = False,
    ) -> Features:
        """The features of a body with `topology` in a scene with or without wind and with colliders of `shapes`."""
        panels = "triangles" if len(topology.triangles) else "segments"
        beam = topology.chain is not None and topology.bends is not None
        return Features(
            lines=bool(topology.springs) and method == "xpbd",
            chain=topology.chain is not None,
            panels=panels if wind else "",
            shapes=shapes,
            order=order,
            method=method,
            segments=not len(topology.triangles),
            worlds=worlds,
            beam=beam,
            winch=topology.winch is not None,
            twist=beam and topology.twists,
            plate=topology.plate is not None,
            curved=topology.plate is not None and topology.plate.stencil is not None,
            line_slots=slots_a_thread(topology.families),
            tears=topology.tear_strain > 0.0,
            membrane=topology.coupling is not None,
        )


@dataclass(frozen=True)
class Counts:
    """Numbers of elements of a batch in one world.

    slots: slots of lines. longest_row: slots in the longest row. curves: triangles that are curved at rest. model: name
    of an array in Model -> its size.
    """

    particles: int
    bodies: int
    colliders: int
    slots: int
    longest_row: int
    segments: int
    joints: int
    panels: int
    curves: int
    stitches: int
    on_cpu: bool
    model: Mapping[str, int]


@wp.struct
class Body:
    """Offsets of a body's parts in the arrays, and its constants."""

    index: int
    spacing: float  # mean rest length of its springs [m]
    particles: int
    count: int
    groups: int  # rounds of families of lines
    groups_end: int
    lines: int  # slots of its lines
    lines_end: int
    line_damping: float  # factor of the time of the dashpots of its lines
    line_rate: float  # omega^2 of the fastest mode of a membrane's springs at a compliance of 1 m/N [1/s^2]
    segments: int
    segments_end: int
    panels: int
    panels_end: int
    constraints: int
    constraints_end: int
    incident_springs: int
    incident_width: int
    plate: int
    plate_width: int
    plate_rate: float  # omega^2 of the stiffest bending mode at a rigidity of 1 N m [1/s^2]
    curves: int  # triangles that are curved at rest
    curves_end: int
    yielding: float  # the inverse of its mass [1/kg] where Material.largest_inverse_mass is 1
    is_rope: bool
    pinned: bool  # True if any particle is pinned
    gap: float  # largest distance of a point of its panels from the nearest of their corners, at rest [m]


@wp.struct
class TearOffsets:
    """Offsets of the line slots of a body that tears: of bending springs, of all others, and their end."""

    bends: int
    others: int
    end: int
    needs: int  # offset in Model.line_needs
    needs_width: int
    strain: float  # strain beyond which springs fail


@wp.struct
class Model:
    """Constant arrays of a batch.

    groups: first and end of the rows of lines of a round, and the number a warp takes in a row. A scale is element
    compliance / material compliance. topology/line_layout.py describes the slots of lines.
    """

    bodies: wp.array(dtype=Body)
    groups: wp.array(dtype=wp.vec3i)
    line_rows: wp.array(dtype=wp.vec4i)  # (R,) first slot, slots, lines and material kind of a row
    line_nodes: wp.array(dtype=int)  # (S,) particle in each lane of each slot, -1 for none
    line_others: wp.array(dtype=int)  # (S,) the particle behind it in its line, -1 for none
    line_rests: wp.array(dtype=float)  # (S,) rest length of the spring between them [m], -1 where there is none
    line_scales: wp.array(dtype=float)  # (S,) scale of that spring
    # (S,) of membranes, see topology/membrane.py: particles across that spring, shares of the lengths to them, and base
    # [m] and share of its own length
    line_across: wp.array(dtype=wp.vec2i)
    line_shares: wp.array(dtype=wp.vec4)
    line_bases: wp.array(dtype=wp.vec2)
    segment_length: wp.array(dtype=float)  # (C,) rest length [m] of chain segments
    particle_masses: wp.array(dtype=float)  # (N,) [kg] off the drum, of bodies that a winch feeds, by world
    rest: wp.array(dtype=wp.vec3)  # (N,) positions at rest [m]
    # (C,) joint behind each segment of a chain that bends: rest turn [-], span [m], and the inverse lengths [1/m] of
    # the segments before and behind it; the last segment has none
    joints: wp.array(dtype=wp.vec4)
    incident_springs: wp.array(dtype=wp.vec2i)  # other particle and type of the springs around each particle: the first
    # spring of all particles of a body, then the second of all, padded with type 0 up to the body's incident_width
    spring_types: wp.array(dtype=wp.vec4)  # (T, 4) rest length [m], 1/scale, kind, and the relative rounding error of
    # the rest length in float32; type 0 has no force
    plate_strides: wp.vec2i  # strides from a neighbour to the next, and from a particle to the next; 0: the number of
    # particles, and the number of neighbours of each
    plate_neighbours: wp.array(dtype=int)  # (N W,) neighbours of Topology.plate
    plate_weights: wp.array(dtype=float)  # (N W,) [1/m^2]
    curve_width: int  # particles of the stencil of a triangle that is curved at rest
    curve_corners: wp.array(dtype=wp.vec3i)  # (C,) corners of these triangles
    curve_stencil: wp.array(dtype=int)  # (C S,) particles
    curve_stencil_gradients: wp.array(dtype=float)  # (C S,) [1/m]
    curve_start: wp.array(dtype=int)  # (N + 1,) offsets into curve_entries
    curve_entries: wp.array(dtype=wp.vec2i)  # triangle of the batch, and the particle's corner in it, 3 for none
    curve_gradients: wp.array(dtype=float)  # gradient of the particle in that triangle [1/m]
    constraint_ends: wp.array(dtype=wp.vec2i)  # (E,) particles of the body
    constraint_of: wp.array(dtype=wp.vec2i)  # (E,) row of Arrays.numbers, and index in Features.constraints
    constraint_rests: wp.array(dtype=float)  # (E,) distance at rest [m]
    constraint_start: wp.array(dtype=int)  # (N + 1,) offsets into constraint_entries
    constraint_entries: wp.array(dtype=int)  # (2 E,) 1 + the constraint, negative for its second particle
    panels: wp.array(dtype=wp.vec3i)  # (P, 3) particles, -1 for none
    panel_parts: wp.array(
        dtype=wp.vec2i
    )  # (P,) body, and bits of the corners, then the sides behind them, that the panel owns.
    # Each particle and each edge belongs to one panel.
    panel_start: wp.array(dtype=int)  # (N + 1,) offsets into particle_panels
    particle_panels: wp.array(dtype=int)  # panels around each particle, counted in the batch
    # All arrays from here on are for objects that tear.
    tear_offsets: wp.array(dtype=TearOffsets)  # (B,)
    line_needs: wp.array(dtype=int)  # slots of the springs that each bending spring lies over, -1 for none
    panel_sides: wp.array(dtype=wp.vec3i)  # (P,) slots of the springs along the sides of panels, -1 for none
    panel_needs: wp.array(dtype=int)  # (13 P,) panels without which a panel does not bend
    plate_sums: wp.array(dtype=int)  # (N W,) index in plate_starts of the parts of a weight, -1 for none
    plate_starts: wp.array(dtype=int)
    plate_part_panels: wp.array(dtype=int)  # the panel of each part of a weight
    plate_parts: wp.array(dtype=float)  # [1/m^2]
    curve_panels: wp.array(dtype=int)  # (C,) panels that are curved at rest
