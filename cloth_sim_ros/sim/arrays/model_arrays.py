# SPDX-License-Identifier: Apache-2.0
"""Build the constant arrays of a batch from topologies, in NumPy body by body, and upload them once.

model.py describes the arrays.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from cloth_sim_ros.sim.arrays.model import Body, Model, TearOffsets
from cloth_sim_ros.sim.topology import KINDS, Topology
from cloth_sim_ros.sim.topology.elements import Plate
from cloth_sim_ros.sim.topology.line_layout import Rows, in_lanes, in_warps, packed
from cloth_sim_ros.sim.topology.membrane import Coupling
from cloth_sim_ros.sim.topology.springs import Elements
from cloth_sim_ros.sim.topology.tears import at_triangles, under_bends

_NOT_ROWS = ("bodies", "groups", "plate_strides", "curve_width", "tear_offsets")
# Field of Body, where a body's part of this array begins; FIELD_end is where it ends.
_PARTS = {
    "lines": "line_nodes", "segments": "segment_length", "panels": "panels", "constraints": "constraint_ends",
    "curves": "curve_corners",
}  # fmt: skip


class ModelArrays:
    """Collects the NumPy parts of a batch, body by body, and uploads them once.

    bodies[b]: the fields of Body; groups: the rows of Model.groups; size: name of an array in Model -> rows so far;
    particles: of all bodies so far. lines[b]: (kind, first, end) of the slots of every family of body b. stitches[b]:
    where those of the seams lie that body b is first in.
    With `incident_springs` every particle knows its springs. Lines lie as a CPU's `lanes` take them, or a GPU's warps,
    of which each thread holds `slots` particles.
    spring_slots[b]: kind -> (S,) the slots of the springs of body b.
    """

    def __init__(self, incident_springs: bool, lanes: bool, slots: int) -> None:
        self._with_incident_springs, self._lanes, self._slots = incident_springs, lanes, slots
        self.bodies: list[dict[str, Any]] = []
        self.groups: list[tuple[int, int, int]] = []
        self._rows: dict[str, list[np.ndarray]] = {name: [] for name in Model.vars if name not in _NOT_ROWS}
        self.particles, self.size = 0, dict.fromkeys(self._rows, 0)
        self.stitches: list[slice] = []
        self.lines: list[list[tuple[int, int, int]]] = []
        self.spring_slots: list[dict[str, np.ndarray]] = []
        self._tear_offsets: list[tuple] = []
        self.longest_row = 0  # slots
        self.curve_width = 0

    def _append(self, name: str, rows: np.ndarray) -> int:
        start = self.size[name]
        self._rows[name].append(rows)
        self.size[name] += len(rows)
        return start

    def add(self, topology: Topology) -> None:
        """Append one body."""
        begin, groups, first = dict(self.size), len(self.groups), self.particles
        self.particles += len(topology.masses)
        self._append("rest", topology.rest)
        self._add_lines(topology)
        self._add_chain(topology)
        self._add_panels(topology)
        incident_width = self._add_incident_springs(topology) if self._with_incident_springs else 0
        if topology.plate is not None:
            self._add_plate(topology.plate, first, len(topology.masses))
        self._add_constraints(topology)
        if topology.tear_strain > 0.0:
            self._add_tear_offsets(topology, begin["panels"])
        body = {
            "index": len(self.bodies),
            "spacing": topology.spacing,
            "particles": first,
            "count": len(topology.masses),
            "groups": groups,
            "groups_end": len(self.groups),
            "line_damping": 1.0 if topology.coupling is None else topology.coupling.softness,
            "line_rate": 0.0 if topology.coupling is None else topology.coupled_rate,
            "incident_springs": begin["incident_springs"],
            "incident_width": incident_width,
            "plate": begin["plate_weights"],
            "plate_width": 0 if topology.plate is None else topology.plate.neighbours.shape[1],
            "plate_rate": topology.plate_rate,
            "yielding": 1.0 / float(topology.masses.sum()),
            "is_rope": not len(topology.triangles),
            "pinned": bool(topology.pinned.any()),
            "gap": topology.widest_gap,
        }
        for name, array in _PARTS.items():
            body |= {name: begin[array], f"{name}_end": self.size[array]}
        stitched = self.stitches[-1].stop if self.stitches else 0
        self.stitches.append(slice(stitched, stitched + sum(len(each.shares) for each in topology.stitches)))
        self.bodies.append(body)

    def _add_lines(self, topology: Topology) -> None:
        """The springs of a sheet, and of a rope that is not solved as a whole, family by family."""
        self.lines.append([])
        self.spring_slots.append({kind: np.full(len(e.rest), -1) for kind, e in topology.springs.items()})
        tables: list[np.ndarray] = []
        for family, rows in zip(topology.families, self._rows_of(topology), strict=True):
            kind, first, numbers = KINDS.index(family.kind), self.size["line_nodes"], rows.numbers.ravel()
            self.spring_slots[-1][family.kind][numbers[numbers >= 0]] = first + np.flatnonzero(numbers >= 0)
            for name in ("nodes", "others", "rests", "scales"):
                self._append(f"line_{name}", getattr(rows, name).ravel())
            table = rows.table + [first // rows.nodes.shape[1], 0, 0]
            tables.append(np.column_stack([table, np.full(len(table), kind)]))
            self.longest_row = max(self.longest_row, int(rows.table[:, 1].max()))
            self.lines[-1].append((kind, first, self.size["line_nodes"]))
        for some in topology.rounds:
            parts = [tables[number] for number, _ in some]
            # A warp takes the rows of a round that belong together one after the other; a core takes all in order.
            joined = np.concatenate(parts) if self._lanes else np.stack(parts, axis=1).reshape(-1, 4)
            start = self._append("line_rows", joined)
            self.groups.append((start, start + len(joined), 1 if self._lanes else len(parts)))

        if topology.coupling is not None:
            self._add_coupling(topology.coupling, topology.springs["structural"])

    def _add_coupling(self, coupling: Coupling, springs: Elements) -> None:
        """The coupling of the structural springs of a body, in the slots of its lines."""
        slots_of, first, end = self.spring_slots[-1]["structural"], self.lines[-1][0][1], self.lines[-1][-1][2]
        slots = slots_of - first
        across, shares, bases = (np.zeros((end - first, size)) for size in (2, 4, 2))
        bases[:, 0] = self.joined("line_rests")[first:]  # of springs that bend, which nothing is coupled to
        across[slots] = np.where(coupling.across < 0, springs.particles[:, :1], coupling.across)
        back = self.joined("line_nodes")[slots_of] != springs.particles[:, 0]  # lines run from its end to its start
        shares[slots] = np.where(back[:, None], coupling.shares[:, [1, 0, 3, 2]], coupling.shares)
        bases[slots] = np.stack([coupling.bases, coupling.own], axis=1)
        for name, rows in (("across", across), ("shares", shares), ("bases", bases)):
            self._append(f"line_{name}", rows)

    def _rows_of(self, topology: Topology) -> list[Rows]:
        """Rows of each family; in warps, lines within a line share the row number of that line."""
        families, found = topology.families, {}
        if self._lanes:
            return [in_lanes(family, topology.springs[family.kind]) for family in families]
        for some in topology.rounds:
            last = packed(families[some[-1][0]], self._slots)
            for number, around in some:
                family = families[number]
                lines = last if around is None else [np.flatnonzero(np.isin(around, row)).tolist() for row in last]
                found[number] = in_warps(family, topology.springs[family.kind], self._slots, lines)
        return [found[number] for number in range(len(families))]

    def _add_tear_offsets(self, topology: Topology, first_panel: int) -> None:
        """Add the elements that fail with a spring, for a body whose panels begin at `first_panel`."""
        slots_of, lines = self.spring_slots[-1], self.lines[-1]
        bending = KINDS.index("bending")
        others = next(first for kind, first, _ in lines if kind != bending)
        bends = lines[0][1]
        under = under_bends(topology)
        needs = np.full((others - bends, under.shape[1]), -1)
        if len(under):
            needs[slots_of["bending"] - bends] = np.where(under >= 0, slots_of["structural"][under], -1)
        start = self._append("line_needs", needs.ravel())
        self._tear_offsets.append((bends, others, lines[-1][2], start, under.shape[1], topology.tear_strain))
        structural, shear = at_triangles(topology)
        sides = np.where(structural >= 0, slots_of["structural"][structural], -1)
        if "shear" in slots_of:
            sides = np.where(shear >= 0, slots_of["shear"][shear], sides)
        self._append("panel_sides", sides)
        if topology.plate is not None:
            parts, rows = topology.plate.parts, self.size["plate_parts"]
            sums = parts.sums if self._lanes else parts.sums.T
            self._append("plate_sums", np.where(sums >= 0, sums + self.size["plate_starts"], -1).ravel())
            self._append("plate_starts", parts.start + rows)
            self._append("plate_part_panels", parts.triangles + first_panel)
            self._append("plate_parts", parts.weights)
            self._append("panel_needs", (parts.needs + first_panel).ravel())
            self._append("curve_panels", parts.curves + first_panel)

    def _add_plate(self, plate: Plate, first: int, count: int) -> None:
        """Add the plate operator of a body of `count` particles, the first of which is `first`."""
        for name, rows in (("plate_neighbours", plate.neighbours), ("plate_weights", plate.weights)):
            self._append(name, (rows if self._lanes else rows.T).ravel())
        if plate.stencil is not None:
            self._add_curves(plate, first, count)

    def _add_curves(self, plate: Plate, first: int, count: int) -> None:
        """Add a body's triangles that are curved at rest, and the list of those around each particle."""
        triangle = self._append("curve_corners", plate.stencil[:, :3])
        self.curve_width = plate.stencil.shape[1]
        self._append("curve_stencil", plate.stencil.ravel())
        self._append("curve_stencil_gradients", plate.gradients.ravel())
        corner = np.where(np.arange(self.curve_width) < 3, np.arange(self.curve_width), 3)
        entries = np.stack(
            [
                np.repeat(triangle + np.arange(len(plate.stencil)), self.curve_width),
                np.tile(corner, len(plate.stencil)),
            ],
            axis=1,
        )
        particles = plate.stencil.ravel()
        self._append("curve_gradients", plate.gradients.ravel()[np.argsort(particles, kind="stable")])
        self._append("curve_start", np.full(first - self.size["curve_start"], self.size["curve_entries"]))
        self._append_around("curve_start", "curve_entries", particles, entries, count)

    def _add_chain(self, topology: Topology) -> None:
        """Add the segments and joints of a directly solved rope."""
        if topology.chain is not None:
            self._append("segment_length", topology.chain.rest)
            if topology.bends is not None:
                bends = topology.bends
                joints = np.column_stack([bends.rest, bends.scale, topology.bend_weights])
                self._append("joints", np.concatenate([joints, np.zeros((1, 4))]))

    def _add_panels(self, topology: Topology) -> None:
        start = self._append("panels", topology.panels)
        parts = np.full((len(topology.panels), 2), len(self.bodies))
        parts[:, 1] = _own_parts(topology.panels)
        self._append("panel_parts", parts)
        panel = np.repeat(np.arange(len(topology.panels)), 3) + start
        self._append_around("panel_start", "particle_panels", topology.panels.ravel(), panel, len(topology.masses))

    def _append_around(self, starts: str, entries: str, particles: np.ndarray, values: np.ndarray, count: int) -> None:
        """Append the `values` around each of `count` particles; particle -1 is none."""
        order = np.argsort(particles, kind="stable")
        order = order[particles[order] >= 0]
        counts = np.bincount(particles[order], minlength=count)
        offset = self._append(entries, values[order])
        self._append(starts, offset + np.cumsum(counts) - counts)

    def _add_constraints(self, topology: Topology) -> None:
        """Add the constraints between two particles of a body."""
        start, given = self.size["constraint_ends"], topology.constraints
        if given is not None:
            self._append("constraint_ends", given.particles)
            self._append("constraint_of", given.of)
            ends = topology.layout[given.particles]
            self._append("constraint_rests", np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1))
            signed = np.outer(1 + start + np.arange(len(ends)), (1, -1)).ravel()
            around = given.particles.ravel()
            self._append_around("constraint_start", "constraint_entries", around, signed, len(topology.masses))

    def _add_incident_springs(self, topology: Topology) -> int:
        """Add a body's incident springs; return the most springs around one particle."""
        count, springs = len(topology.masses), topology.springs
        pairs = np.concatenate([e.particles for e in springs.values()])
        # Rest lengths that differ by rounding are one type, so that the few types of a grid stay in the nearest cache.
        kinds = [
            (np.round(e.rest, 12), np.round(1.0 / e.scale, 9), np.full(len(e.rest), KINDS.index(k)))
            for k, e in springs.items()
        ]
        table, types = np.unique(np.concatenate([np.stack(k, 1) for k in kinds]), axis=0, return_inverse=True)
        lost = 1.0 - table[:, 0].astype(np.float32) / table[:, 0]
        start = self._append("spring_types", np.concatenate([np.zeros((1, 4)), np.column_stack([table, lost])]))
        hub, rim = pairs.ravel(), pairs[:, ::-1].ravel()
        types = np.repeat(types.ravel() + start + 1, 2)
        order = np.argsort(hub, kind="stable")
        hub, rim, types = hub[order], rim[order], types[order]
        degree = np.bincount(hub, minlength=count)
        slot = np.arange(len(hub)) - np.repeat(np.cumsum(degree) - degree, degree)
        incident_springs = np.full((degree.max(), count, 2), start)
        incident_springs[:, :, 0] = np.arange(count)
        incident_springs[slot, hub] = np.stack([rim, types], 1)
        self._append("incident_springs", incident_springs.reshape(-1, 2))
        return int(degree.max())

    def joined(self, name: str) -> np.ndarray:
        """The rows of an array in Model of all bodies, in NumPy."""
        return np.concatenate(self._rows[name]) if self._rows[name] else np.zeros(0)

    def upload(self, device: wp.Device) -> Model:
        """Upload the arrays to `device`. An absent kind is an empty array."""
        model = Model()
        self._append("panel_start", np.array([self.size["particle_panels"]]))
        if self.size["constraint_ends"]:
            self._append("constraint_start", np.array([self.size["constraint_entries"]]))
        if self.curve_width:
            self._append("curve_start", np.array([self.size["curve_entries"]]))
        for name in self._rows:
            setattr(model, name, wp.array(self.joined(name), dtype=Model.vars[name].type.dtype, device=device))
        model.plate_strides = wp.vec2i(1, 0) if self._lanes else wp.vec2i(0, 1)
        model.curve_width = self.curve_width
        offsets = np.array(self._tear_offsets, dtype=TearOffsets.numpy_dtype())
        model.tear_offsets = wp.array(offsets, dtype=TearOffsets, device=device)
        bodies = [tuple(body[name] for name in Body.vars) for body in self.bodies]
        model.bodies = wp.array(np.array(bodies, dtype=Body.numpy_dtype()), dtype=Body, device=device)
        model.groups = wp.array(np.array(self.groups, np.int32).reshape(-1, 3), dtype=wp.vec3i, device=device)
        return model


def _own_parts(panels: np.ndarray) -> np.ndarray:
    """Bits (P,) of the corners and sides of each panel that no panel before it has; see Model.panel_parts."""
    bits = np.zeros((len(panels), 6), dtype=bool)
    sides = np.sort(np.stack([panels, np.roll(panels, -1, axis=1)], axis=-1), axis=-1)
    for parts, columns in ((panels[..., None], slice(0, 3)), (sides, slice(3, 6))):
        rows = parts.reshape(-1, parts.shape[-1])
        first = np.zeros(len(rows), dtype=bool)
        first[np.unique(rows, axis=0, return_index=True)[1]] = True
        bits[:, columns] = (first & (rows[:, 0] >= 0)).reshape(-1, 3)  # -1 is no particle
    return bits @ (1 << np.arange(6))
