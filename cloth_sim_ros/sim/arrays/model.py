# SPDX-License-Identifier: Apache-2.0
"""What is constant, as kernels see it: bodies that share a kernel and live behind one another in flat arrays, a batch.

Particle indices inside elements count from the body's first particle, so that a body's block needs no offset.
`Body` says where a body's part of every array begins. The arrays are made in model_arrays.py; state.py is what varies.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import warp as wp

from cloth_sim_ros.sim.topology import Topology
from cloth_sim_ros.sim.topology.line_layout import slots_a_thread


@dataclass(frozen=True)
class Features:
    """What the kernels of a batch hold; anything absent here is not compiled."""

    lines: bool  # springs that are solved line by line
    chain: bool  # a direct solve along a rope
    panels: str  # "" without wind, else "triangles" or "segments"
    shapes: tuple[str, ...]  # collider shapes
    order: int
    method: str
    worlds: bool = False  # whether there are many, each with a state of its own
    beam: bool = False  # a chain that resists bending
    winch: bool = False  # a chain that a winch feeds
    twist: bool = False  # a beam that resists twist between two clamps
    bent: bool = False  # a beam that is bent at rest
    plate: bool = False  # a sheet that resists bending by its curvature
    curved: bool = False  # and is curved at rest
    surface: bool = False  # whether colliders can reach between particles (see colliders/collider.py)
    listed: bool = False  # whether there are so many that those near a body are listed (see broad_phase.py)
    handles: bool = False  # whether there are any
    redoes: bool = False  # whether only bodies are computed whose frame is done again
    coupled: bool = False  # whether it is kept apart from itself or from other objects
    tears: bool = False  # whether its springs fail
    forces: tuple[str, ...] = ()  # of forces.FORCES, in the order of Arrays.forces
    line_slots: int = 1  # particles of a line that a thread of a warp holds

    def key(self) -> str:
        """A name for kernels with these features, the same in every process, so that caches on disk are found."""
        return hashlib.sha256(repr(self).encode()).hexdigest()[:12]

    @property
    def looks_back(self) -> bool:
        """Whether a substep needs to know if the one before it was smooth."""
        return self.order == 2 or self.method == "verlet"

    @property
    def supported(self) -> bool:
        """Whether the push of a collider carries over to the next substep.

        Then it is one of first order. What meets other objects stays in step with them: in a substep of another order
        the same move is another force.
        """
        return self.chain and self.shapes != () and not self.coupled

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
            worlds=worlds,
            beam=beam,
            winch=topology.winch is not None,
            twist=beam and topology.twists,
            bent=beam and bool(topology.bends.rest.any()),
            plate=topology.plate is not None,
            curved=topology.plate is not None and topology.plate.stencil is not None,
            line_slots=slots_a_thread(topology.families),
            tears=topology.tear_strain > 0.0,
        )


@dataclass(frozen=True)
class Counts:
    """How much there is of a batch in one world. slots: of lines, longest_row of them in a row; curves: triangles that
    are curved at rest; model: name of an array in Model -> its elements."""

    particles: int
    bodies: int
    colliders: int
    slots: int
    longest_row: int
    segments: int
    joints: int
    panels: int
    curves: int
    on_cpu: bool
    model: Mapping[str, int]


@wp.struct
class Body:
    """Where a body's parts begin: particles, rounds of lines, chain segments, panels."""

    index: int
    spacing: float  # mean rest length of its springs [m]
    particles: int
    count: int
    groups: int  # rounds of families of lines
    groups_end: int
    segments: int
    segments_end: int
    panels: int
    panels_end: int
    incident_springs: int
    incident_width: int
    plate: int
    plate_width: int
    plate_rate: float  # of the stiffest mode at a rigidity of 1 N m [1/s^2], likewise
    curves: int  # triangles that are curved at rest
    curves_end: int
    yielding: float  # the inverse of its mass [1/kg] where Material.largest_inverse_mass is 1
    is_rope: bool
    pinned: bool  # whether any of its particles is
    gap: float  # how far a point of its panels lies from the nearest of their corners at most, at rest [m]


@wp.struct
class Seams:
    """Where the slots of lines of a body that tears begin: of bending springs, of all others, and where these end."""

    bends: int
    others: int
    end: int
    needs: int  # in Model.line_needs
    needs_width: int
    strain: float  # beyond which springs fail


@wp.struct
class Model:
    """Constant arrays. groups: (first, end) of the rows of lines of a round, and how many a warp takes in a row.

    scale: element compliance / material compliance. What lies in slots of lines is told in lines/layout.py.
    """

    bodies: wp.array(dtype=Body)
    groups: wp.array(dtype=wp.vec3i)
    line_rows: wp.array(dtype=wp.vec4i)  # (R,) first slot, slots, lines and material kind of a row
    line_nodes: wp.array(dtype=int)  # (S,) particle in each lane of each slot, -1 for none
    line_others: wp.array(dtype=int)  # (S,) the particle behind it in its line, -1 for none
    line_rests: wp.array(dtype=float)  # (S,) rest length of the spring between them [m], -1 where there is none
    line_scales: wp.array(dtype=float)  # (S,) and its scale
    segment_length: wp.array(dtype=float)  # (C,) rest length [m] of chain segments
    particle_masses: wp.array(dtype=float)  # (N,) [kg] when they are out whole, of bodies that a winch feeds, by world
    rest: wp.array(dtype=wp.vec3)  # (N,) positions at rest [m]
    joints: wp.array(dtype=wp.vec4)  # (C,) behind each segment of a chain that bends: rest turn [-], span [m], and the
    # inverse lengths [1/m] of the segments before and behind it; nothing behind the last
    incident_springs: wp.array(dtype=wp.vec2i)  # around each particle: the other one and the type, the first of
    # all particles of a body, then the second of all, padded with type 0 up to the body's incident_width
    spring_types: wp.array(dtype=wp.vec4)  # (T, 4) rest length [m], 1/scale, kind, and what float32 lost of the rest
    # length, over it; type 0 pulls nothing
    plate_strides: wp.vec2i  # places from a neighbour to the next, and from a particle to the next; 0: as many as there
    # are particles, and as many as each has neighbours
    plate_neighbours: wp.array(dtype=int)  # (N W,) of Topology.plate
    plate_weights: wp.array(dtype=float)  # (N W,) [1/m^2]
    curve_width: int  # particles of the stencil of a triangle that is curved at rest
    curve_corners: wp.array(dtype=wp.vec3i)  # (C,) corners of these triangles
    curve_stencil: wp.array(dtype=int)  # (C S,) particles
    curve_stencil_gradients: wp.array(dtype=float)  # (C S,) [1/m]
    curve_start: wp.array(dtype=int)  # (N + 1,) into curve_entries
    curve_entries: wp.array(dtype=wp.vec2i)  # triangle of the batch, and which of its corners a particle is, else 3
    curve_gradients: wp.array(dtype=float)  # of the particle in that triangle [1/m]
    panels: wp.array(dtype=wp.vec3i)  # (P, 3) particles, -1 for none
    panel_parts: wp.array(
        dtype=wp.vec2i
    )  # (P,) body, and bits of what is a panel's own: its three corners, then the sides
    # behind them. Each particle and each edge belongs to one panel.
    panel_start: wp.array(dtype=int)  # (N + 1,) into particle_panels
    particle_panels: wp.array(dtype=int)  # panels around each particle, counted in the batch
    seams: wp.array(dtype=Seams)  # (B,) of objects that tear, as all that follows
    line_needs: wp.array(dtype=int)  # slots of the springs that each bending spring lies over, -1 for none
    panel_sides: wp.array(dtype=wp.vec3i)  # (P,) slots of the springs along the sides of panels, -1 for none
    panel_needs: wp.array(dtype=int)  # (13 P,) panels without which a panel does not bend
    plate_sums: wp.array(dtype=int)  # (N W,) where the parts of a weight begin in plate_starts, -1 for none
    plate_starts: wp.array(dtype=int)
    plate_part_panels: wp.array(dtype=int)  # the panel that a part of a weight is of
    plate_parts: wp.array(dtype=float)  # [1/m^2]
    curve_panels: wp.array(dtype=int)  # (C,) of triangles that are curved at rest
