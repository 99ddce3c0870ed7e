"""Scene -> constant device arrays of one batch: bodies that share a kernel and live behind one another in flat arrays.

Particle indices inside elements count from the body's first particle, so that a body's block needs no offset.
`Body` says where a body's part of every array begins. Nothing here varies after construction (see state.py).
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
import warp as wp

from cloth_sim_ros.sim import cells
from cloth_sim_ros.sim.topology import KINDS, Elements, Topology

CONSTRAINTS = ("spring", "cell", "hinge", "bend", "edge")


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
        kinds = ()
        if topology.springs and method == "xpbd":
            kinds = ("spring",) if topology.grid is None else ("cell",)
        panels = "triangles" if len(topology.triangles) else "segments"
        others = tuple(name for name, _, _ in topology.others())
        if topology.edges() and set(shapes) - {"plane"}:  # before a plane, an end of every edge comes first
            others += ("edge",)
        chain = topology.chain is not None
        beam = chain and topology.bends is not None
        winch = topology.reel is not None
        return Features(
            kinds + others,
            chain,
            panels if wind else "",
            shapes,
            order,
            method,
            worlds,
            beam,
            winch,
            beam and topology.twists,
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
    lightness: wp.vec3  # the most inverse mass at a spring of each kind, over its share of the compliance [1/kg]


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
    tuples: wp.array(dtype=wp.vec4i)  # (E, 4) particles, the last repeated where there are three
    tuple_rest: wp.array(dtype=wp.vec4)  # (E, 4) rest, scale and two more
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


def colour_sorted(elements: Elements) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """Order that puts colours behind one another, by particle within a colour; and (first, end) of each colour."""
    order = np.lexsort((elements.particles[:, 0], elements.colour))
    edges = np.concatenate([[0], np.cumsum(np.bincount(elements.colour))])
    return order, [(int(a), int(b)) for a, b in zip(edges[:-1], edges[1:], strict=True) if b > a]


class ModelArrays:
    """Collects the NumPy parts of a batch, body by body, and uploads them once.

    spring_groups[b]: "spring" or "cell", and the groups of these in body b. spring_order[b][kind] is (first, order),
    for springs that lie in no cell: element `order[i]` of that kind lies at first + i;
    tuple_order[b][constraint] the same of the tuples. Of cells, at most `width` are projected at a time.
    """

    def __init__(self, spokes: bool, width: int) -> None:
        self._with_spokes, self._width = spokes, width
        self.rows: dict[str, list[np.ndarray]] = {name: [] for name in _TYPES}
        self.bodies: list[tuple] = []
        self.particles = 0
        self.groups: list[tuple[int, int, int, int]] = []
        self.size = dict.fromkeys(_TYPES, 0)
        self.spring_groups: list[tuple[str, list[tuple[int, int, int, int]]]] = []
        self.spring_order: list[dict[str, tuple[int, np.ndarray]]] = []
        self.tuple_order: list[dict[str, tuple[int, np.ndarray]]] = []

    def _append(self, name: str, rows: np.ndarray) -> int:
        start = self.size[name]
        self.rows[name].append(rows.astype(_TYPES[name][1]))
        self.size[name] += len(rows)
        return start

    def _append_groups(self, constraint: str, kind: int, first: int, spans: list[tuple[int, int]]) -> None:
        self.groups += [(CONSTRAINTS.index(constraint), kind, first + a, first + b) for a, b in spans]

    def add(self, topology: Topology) -> None:
        """Append one body."""
        first = self.particles
        self.particles += len(topology.masses)
        self._append("rest", topology.rest)
        groups, first_cell = len(self.groups), self.size["cells"]
        self.spring_order.append({})
        self.tuple_order.append({})
        width = 0
        if topology.grid is None:
            self._add_springs(topology)
        else:
            width = self._add_cells(topology)
        tuple_groups = len(self.groups)
        self.spring_groups.append(("spring" if topology.grid is None else "cell", self.groups[groups:]))
        for constraint, elements, extra in topology.others():
            order, spans = colour_sorted(elements)
            start = self._append(
                "tuples", np.pad(elements.particles, ((0, 0), (0, 4 - elements.particles.shape[1])), "edge")[order]
            )
            self.tuple_order[-1][constraint] = (start, order)
            self._append("tuple_rest", np.column_stack([elements.rest, elements.scale, extra])[order])
            self._append_groups(constraint, KINDS.index("bending"), start, spans)
        groups_end = len(self.groups)
        for elements in topology.edges():
            order, spans = colour_sorted(elements)
            start = self._append("edges", elements.particles[order])
            self._append_groups("edge", 0, start, spans)
        chain = topology.chain.rest if topology.chain is not None else np.zeros(0)
        segments = self._append("segment_length", chain)
        if topology.chain is not None and topology.bends is not None:
            bends = topology.bends
            joints = np.column_stack([bends.rest, bends.scale, topology.bend_weights])
            self._append("joints", np.concatenate([joints, np.zeros((1, 4))]))
        if topology.reel is not None:
            self._append("particle_masses", topology.masses)
        panels = self._add_panels(topology)
        spokes, spoke_width = self._add_spokes(topology) if self._with_spokes else (0, 0)
        rests = [e.rest for e in topology.springs.values()] + ([chain] if len(chain) else [])
        spacing = float(np.concatenate(rests).mean()) if rests else 1.0
        spans = (
            groups,
            tuple_groups,
            groups_end,
            len(self.groups),
            first_cell,
            self.size["cells"],
            width,
            segments,
            segments + len(chain),
            panels,
            panels + len(topology.panels),
            spokes,
            spoke_width,
        )
        cell = (0.0, 0.0, 0.0) if topology.grid is None else cells.lengths(topology)
        yielding = 1.0 / float(topology.masses.sum())
        self.bodies.append(
            (len(self.bodies), spacing, first, len(topology.masses), *spans, cell, yielding, _lightness(topology))
        )

    def _add_springs(self, topology: Topology) -> None:
        for kind, elements in topology.springs.items():
            order, spans = colour_sorted(elements)
            indices = bits(elements.particles[order])
            numbers = np.stack([elements.rest, elements.scale], 1)[order].astype(np.float32)
            start = self._append("springs", np.concatenate([indices, numbers], 1))
            self.spring_order[-1][kind] = (start, order)
            self._append_groups("spring", KINDS.index(kind), start, spans)

    def _add_cells(self, topology: Topology) -> int:
        sweep = cells.passes(topology)
        width = cells.width_of(sweep, self._width)
        for n, one in enumerate(sweep):
            records = one.records(n % 2 == 1, width)
            start = self._append("cells", records)
            self.groups.append((one.holds, KINDS.index(one.kind), start, start + len(records)))
        return width

    def _add_panels(self, topology: Topology) -> int:
        start = self._append("panels", topology.panels)
        corner = topology.panels.ravel()
        panel = np.repeat(np.arange(len(topology.panels)), 3) + start
        order = np.argsort(corner, kind="stable")
        order = order[corner[order] >= 0]
        counts = np.bincount(corner[order], minlength=len(topology.masses))
        offset = self._append("particle_panels", panel[order])
        self._append("panel_start", offset + np.concatenate([[0], np.cumsum(counts)[:-1]]))
        return start

    def _add_spokes(self, topology: Topology) -> tuple[int, int]:
        """Spokes of one body: where they begin, and the most springs around one particle of it."""
        count, springs = len(topology.masses), topology.springs
        pairs = np.concatenate([e.particles for e in springs.values()])
        # Rest lengths that differ by rounding are one type, so that the few types of a grid stay in the nearest cache.
        kinds = [
            (np.round(e.rest, 12), np.round(1.0 / e.scale, 9), np.full(len(e.rest), KINDS.index(k)))
            for k, e in springs.items()
        ]
        table, types = np.unique(np.concatenate([np.stack(k, 1) for k in kinds]), axis=0, return_inverse=True)
        lost = 1.0 - table[:, 0].astype(np.float32) / table[:, 0]
        start = self._append("spoke_types", np.concatenate([np.zeros((1, 4)), np.column_stack([table, lost])]))
        hub, rim = pairs.ravel(), pairs[:, ::-1].ravel()
        types = np.repeat(types.ravel() + start + 1, 2)
        order = np.argsort(hub, kind="stable")
        hub, rim, types = hub[order], rim[order], types[order]
        degree = np.bincount(hub, minlength=count)
        slot = np.arange(len(hub)) - np.repeat(np.cumsum(degree) - degree, degree)
        spokes = np.full((degree.max(), count, 2), start)
        spokes[:, :, 0] = np.arange(count)
        spokes[slot, hub] = np.stack([rim, types], 1)
        return self._append("spokes", spokes.reshape(-1, 2)), int(degree.max())

    def upload(self, device: wp.Device) -> Model:
        """The arrays on `device`. An absent kind is an array of no element."""
        model = Model()
        self._append("panel_start", np.array([self.size["particle_panels"]]))
        for name, (dtype, kind) in _TYPES.items():
            width = dtype._length_ if hasattr(dtype, "_length_") else 0
            shape = (0, width) if width else (0,)
            rows = np.concatenate([np.zeros(shape, dtype=kind), *self.rows[name]])
            setattr(model, name, wp.array(rows, dtype=dtype, device=device))
        model.groups = wp.array(np.array(self.groups, np.int32).reshape(-1, 4), dtype=wp.vec4i, device=device)
        model.bodies = wp.array(np.array(self.bodies, dtype=Body.numpy_dtype()), dtype=Body, device=device)
        return model


def _lightness(topology: Topology) -> tuple[float, ...]:
    """Of structural, shear and bending springs: the largest w_i + w_j over scale [1/kg], 0 where there are none."""
    w, found = np.where(topology.pinned, 0.0, 1.0 / topology.masses), []
    for kind in KINDS:
        e = topology.springs.get(kind)
        found.append(0.0 if e is None else float((w[e.particles].sum(1) / e.scale).max()))
    return tuple(found)


def bits(indices: np.ndarray) -> np.ndarray:
    """Indices as float32 of the same bits, to pack them beside numbers; never computed with, only moved."""
    return np.ascontiguousarray(indices, dtype=np.int32).view(np.float32)


_TYPES = {
    "springs": (wp.vec4, np.float32),
    "cells": (wp.vec4i, np.int32),
    "tuples": (wp.vec4i, np.int32),
    "tuple_rest": (wp.vec4, np.float32),
    "edges": (wp.vec2i, np.int32),
    "segment_length": (float, np.float32),
    "particle_masses": (float, np.float32),
    "rest": (wp.vec3, np.float32),
    "joints": (wp.vec4, np.float32),
    "spokes": (wp.vec2i, np.int32),
    "spoke_types": (wp.vec4, np.float32),
    "panels": (wp.vec3i, np.int32),
    "panel_start": (int, np.int32),
    "particle_panels": (int, np.int32),
}
