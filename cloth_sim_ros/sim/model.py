"""What is constant, as kernels see it: bodies that share a kernel and live behind one another in flat arrays, a batch.

Particle indices inside elements count from the body's first particle, so that a body's block needs no offset.
`Body` says where a body's part of every array begins. The arrays are made in model_arrays.py; state.py is what varies.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import warp as wp

from cloth_sim_ros.sim.topology import Topology

CONSTRAINTS = ("spring", "cell", "hinge", "edge")


@dataclass(frozen=True)
class Features:
    """What the kernels of a batch hold; anything absent here is not compiled."""

    constraints: tuple[str, ...]  # of CONSTRAINTS, projected colour by colour; edges are contacts, after all others
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

    def key(self) -> str:
        """A name for kernels with these features, the same in every process, so that caches on disk are found."""
        return hashlib.sha256(repr(self).encode()).hexdigest()[:12]

    @property
    def looks_back(self) -> bool:
        """Whether a substep needs to know if the one before it was smooth."""
        return self.order == 2 or self.method == "verlet"

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
        springs = "spring" if topology.grid is None else "cell"
        constraints = [springs] if topology.springs and method == "xpbd" else []
        constraints += ["hinge"] if topology.hinges is not None else []
        if topology.edges() and set(shapes) - {"plane"}:  # before a plane, an end of every edge comes first
            constraints.append("edge")
        panels = "triangles" if len(topology.triangles) else "segments"
        beam = topology.chain is not None and topology.bends is not None
        return Features(
            constraints=tuple(constraints),
            chain=topology.chain is not None,
            panels=panels if wind else "",
            shapes=shapes,
            order=order,
            method=method,
            worlds=worlds,
            beam=beam,
            winch=topology.reel is not None,
            twist=beam and topology.twists,
            bent=beam and bool(topology.bends.rest.any()),
        )


@wp.struct
class Body:
    """Where a body's parts begin: particles, colour groups of springs, tuples and edges, chain segments, panels."""

    index: int
    spacing: float  # mean rest length of its springs [m]
    particles: int
    count: int
    groups: int  # springs or cells
    tuple_groups: int
    groups_end: int
    edge_groups_end: int
    cells: int
    cells_end: int
    cell_width: int  # of which passes hold multiples
    segments: int
    segments_end: int
    panels: int
    panels_end: int
    spokes: int
    spoke_width: int
    cell: wp.vec3  # rest lengths [m] along x, along y and of diagonals of a grid
    yielding: float  # the inverse of its mass [1/kg]


@wp.struct
class Model:
    """Constant arrays. groups: (constraint, material kind, first, end) of one colour; of cells (what they hold, kind of
    their sides, first, end) of one pass.

    scale: element compliance / material compliance. A spring is one packed record of 16 bytes, because every substep
    streams all of them; all other constraints share `tuples`, whose four numbers each constraint defines.
    """

    bodies: wp.array(dtype=Body)
    groups: wp.array(dtype=wp.vec4i)
    springs: wp.array(dtype=wp.vec4)  # (S, 4) both particles as the bits of their indices, rest length [m], scale
    cells: wp.array(dtype=wp.vec4i)  # (Q,) records of the cells of grids, pass by pass (sim/cells.py)
    tuples: wp.array(dtype=wp.vec4i)  # (E, 4) particles
    tuple_rest: wp.array(dtype=wp.vec2)  # (E, 2) rest, scale
    edges: wp.array(dtype=wp.vec2i)  # (D,) particles of edges that touch colliders
    segment_length: wp.array(dtype=float)  # (C,) rest length [m] of chain segments
    particle_masses: wp.array(dtype=float)  # (N,) [kg] when they are out whole, of bodies that a winch feeds
    rest: wp.array(dtype=wp.vec3)  # (N,) positions at rest [m]
    joints: wp.array(dtype=wp.vec4)  # (C,) behind each segment of a chain that bends: rest turn [-], span [m], and the
    # inverse lengths [1/m] of the segments before and behind it; nothing behind the last
    spokes: wp.array(dtype=wp.vec2i)  # springs around each particle, for method verlet: other particle and type, the
    # first spring of all particles of a body, then the second of all, padded with type 0 up to the body's spoke_width
    spoke_types: wp.array(dtype=wp.vec4)  # (T, 4) rest length [m], 1/scale, kind, and what float32 lost of the rest
    # length, over it; type 0 pulls nothing
    panels: wp.array(dtype=wp.vec3i)  # (P, 3) particles, -1 for none
    panel_start: wp.array(dtype=int)  # (N + 1,) into particle_panels
    particle_panels: wp.array(dtype=int)  # panels around each particle, counted in the batch
