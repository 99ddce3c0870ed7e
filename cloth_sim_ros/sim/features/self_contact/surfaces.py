# SPDX-License-Identifier: Apache-2.0
"""Data for contact between objects: the panels of all batches in one list, and the arrays behind them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from cloth_sim_ros.sim.arrays.model import Body, Model
from cloth_sim_ros.sim.arrays.state import Arrays, Frame, Material, substep_length
from cloth_sim_ros.sim.features.seams.arrays import BROKEN
from cloth_sim_ros.sim.features.self_contact.arrays import SelfContactState
from cloth_sim_ros.sim.kernels.intrinsics import load_row, xyz
from cloth_sim_ros.sim.substeps.arrays import ControlState, StepLimits
from cloth_sim_ros.sim.topology import Topology


@wp.struct
class Surface:
    """The arrays of a batch in one world that contact between objects needs; all of Arrays is thousands of bytes."""

    bodies: wp.array(dtype=Body)
    panels: wp.array(dtype=wp.vec3i)
    panel_parts: wp.array(dtype=wp.vec2i)
    rest: wp.array(dtype=wp.vec3)
    frames: wp.array(dtype=Frame)
    limits: wp.array(dtype=StepLimits)
    control: ControlState
    materials: wp.array(dtype=Material)
    positions: wp.array(dtype=wp.vec4)
    position_lo: wp.array(dtype=wp.vec4)
    displacements: wp.array(dtype=wp.vec4)
    velocities: wp.array(dtype=wp.vec4)
    last_displacements: wp.array(dtype=wp.vec3)
    path_starts: wp.array(dtype=wp.vec3)
    path_velocities: wp.array(dtype=wp.vec3)
    pair_corrections: wp.array(dtype=wp.int64)
    off_path: wp.array(dtype=float)
    grounds: wp.array(dtype=wp.vec4)
    ways_given_up: wp.array(dtype=float)
    stitches: wp.array(dtype=wp.vec3)


@wp.func
def dt_of(surface: Surface) -> float:
    """Length of a substep [s]; bodies that touch one another take equally many."""
    return substep_length(surface.frames[0], surface.control, surface.limits[0], 0)


@wp.struct
class Members:
    """All panels and bodies that may touch, counted through all batches. Consecutive panels lie side by side.

    surfaces: (batches x worlds,), all worlds of the first batch first. panels: (P,) batch, and number there.
    bodies: (B,) batch, number there, and 1 if the body is kept apart from itself. owners: (P,) the body of a panel.
    among: True if bodies are kept apart from one another. flattens: True if all bodies are sheets that may lie so flat
    that nothing touches, see early_out.py. gaps, ends: (B,) Topology.fold_gap and far_ends. firsts: (batches,) the
    place of the first particle of a batch among all. sewn_start: (N + 1,) offsets into `sewn` for each of all
    particles, empty without seams. sewn: the place of a particle that a stitch ties it to, or -1 - the number of a body
    that it slides along; then the batch of that stitch, and its number in SeamState.
    """

    surfaces: wp.array(dtype=Surface)
    panels: wp.array(dtype=wp.vec2i)
    bodies: wp.array(dtype=wp.vec3i)
    owners: wp.array(dtype=int)
    gaps: wp.array(dtype=float)
    ends: wp.array(dtype=wp.vec4i)
    firsts: wp.array(dtype=int)
    sewn_start: wp.array(dtype=int)
    sewn: wp.array(dtype=wp.vec3i)
    worlds: int
    batches: int
    among: bool
    flattens: bool


@wp.struct
class Panel:
    """One panel in one world: its body, the index of its batch's arrays in Members.surfaces, and its particles there.

    A segment has its second corner twice. own: the bits of Model.panel_parts.
    """

    body: int
    surface: int
    own: int
    corners: wp.vec3i


@wp.func
def panel_of(members: Members, k: int, w: int) -> Panel:
    """Return panel k in world w."""
    home = members.panels[k]
    panel = Panel()
    panel.surface = home[0] * members.worlds + w
    surface = members.surfaces[panel.surface]
    parts = surface.panel_parts[home[1]]
    panel.body = members.owners[k]
    panel.own = parts[1]
    corners = surface.panels[home[1]]
    first = surface.bodies[parts[0]].particles
    panel.corners = wp.vec3i(
        first + corners[0], first + corners[1], first + wp.where(corners[2] < 0, corners[1], corners[2])
    )
    return panel


@wp.func
def number_of_body(members: Members, k: int) -> int:
    """Return the number of the body of panel k in its batch."""
    return members.bodies[members.owners[k]][1]


@wp.func
def surface_of(members: Members, batch: int, w: int) -> Surface:
    """Return the arrays of a batch in world w."""
    return members.surfaces[batch * members.worlds + w]


@wp.func
def place(surface: Surface, i: int) -> wp.vec3:
    """Return the position of particle i of a batch when the substep began [m]."""
    return xyz(load_row(surface.positions, i))


@wp.func
def velocity(surface: Surface, i: int) -> wp.vec3:
    """Return the velocity of particle i when the substep began [m/s]."""
    return xyz(load_row(surface.velocities, i))


@wp.func
def may_touch(members: Members, a: int, b: int) -> bool:
    """Return True if two bodies are kept apart."""
    if a == b:
        return members.bodies[a][2] > 0
    return members.among


@wp.func
def _is_sewn(members: Members, w: int, a: Panel, i: int, b: Panel, j: int) -> bool:
    """Return True if an intact stitch ties particle i of panel a in world w to particle j of panel b."""
    number = members.firsts[a.surface / members.worlds] + i
    for k in range(members.sewn_start[number], members.sewn_start[number + 1]):
        entry = members.sewn[k]
        if entry[0] == members.firsts[b.surface / members.worlds] + j or entry[0] == -1 - b.body:
            if members.surfaces[entry[1] * members.worlds + w].stitches[entry[2]][1] != BROKEN:
                return True
    return False


@wp.func
def are_sewn(members: Members, w: int, a: Panel, i: int, b: Panel, j: int) -> bool:
    """Return True if particle i of panel a in world w and particle j of panel b are sewn together."""
    if members.sewn_start.shape[0] == 0:
        return False
    return _is_sewn(members, w, a, i, b, j) or _is_sewn(members, w, b, j, a, i)


def members_of(
    batches: Sequence[Sequence[Arrays]],
    topologies: dict[str, Topology],
    itself: Sequence[bool],
    among: bool,
    device: wp.Device,
) -> Members:
    """Build the Members of batches.

    batches: the arrays of each batch in all worlds. topologies: by name, body by body. itself: True for each body
    that is kept apart from itself. among: True if bodies are kept apart from one another. device: where arrays are
    allocated.
    """
    members = Members()
    surfaces, panels, bodies, owners = [], [], [], []
    sizes = [worlds[0].state.positions.shape[0] for worlds in batches]
    for number, worlds in enumerate(batches):
        surfaces += [_surface_of(arrays) for arrays in worlds]
        own = _side_by_side(worlds[0].model)
        panels.append(np.column_stack([np.full_like(own, number), own]))
        owners.append(len(bodies) + worlds[0].model.panel_parts.numpy()[own, 0])
        bodies += [(number, b, int(itself[len(bodies) + b])) for b in range(worlds[0].model.bodies.shape[0])]
    members.surfaces = wp.array(surfaces, dtype=Surface, device=device)
    members.panels = wp.array(np.concatenate(panels).astype(np.int32), dtype=wp.vec2i, device=device)
    members.bodies = wp.array(np.array(bodies, np.int32), dtype=wp.vec3i, device=device)
    members.owners = wp.array(np.concatenate(owners).astype(np.int32), dtype=int, device=device)
    members.gaps = wp.array([topology.fold_gap for topology in topologies.values()], dtype=float, device=device)
    firsts = np.cumsum([0, *sizes])
    members.firsts = wp.array(firsts[:-1], dtype=int, device=device)
    starts = [batches[batch][0].model.bodies.numpy()["particles"][b] for batch, b, _ in bodies]
    batch_of = [batch for batch, _, _ in bodies]
    begins = {name: firsts[batch] + start for name, batch, start in zip(topologies, batch_of, starts, strict=True)}
    members.sewn_start, members.sewn = _sewn(topologies, batch_of, begins, firsts[-1], device)
    ends = [topology.far_ends for topology in topologies.values()]
    members.ends = wp.array(np.array(ends, np.int32), dtype=wp.vec4i, device=device)
    members.worlds, members.batches, members.among = len(batches[0]), len(batches), among
    members.flattens = not among and all(topology.fold_gap for topology in topologies.values())
    return members


def _sewn(
    topologies: dict[str, Topology], batch_of: list[int], begins: dict[str, int], count: int, device: wp.Device
) -> tuple[wp.array, wp.array]:
    """Members.sewn_start of `count` particles, and Members.sewn.

    batch_of: of each body. begins: name -> the place of its first particle among all.
    """
    numbers, found = dict.fromkeys(batch_of, 0), [np.zeros((0, 4), int)]
    for (name, topology), batch in zip(topologies.items(), batch_of, strict=True):
        for each in topology.stitches:
            number = numbers[batch] + np.arange(len(each.shares))
            numbers[batch] += len(number)
            if each.other not in begins:
                continue
            weights = np.stack([1.0 - each.shares, each.shares], axis=-1).reshape(-1, 4)
            for k, j in ((0, 2), (0, 3), (1, 2), (1, 3)):
                used = (weights[:, k] > 0.0) & (each.slides | (weights[:, j] > 0.0))
                tied = begins[each.other] + each.particles[used, j]
                if each.slides:
                    tied[:] = -1 - list(topologies).index(each.other)
                who = begins[name] + each.particles[used, k]
                found.append(np.column_stack([who, tied, np.full(len(who), batch), number[used]]))
    rows = np.concatenate(found)
    if not len(rows):
        return wp.zeros(0, dtype=int, device=device), wp.zeros(0, dtype=wp.vec3i, device=device)
    rows = rows[np.argsort(rows[:, 0], kind="stable")].astype(np.int32)
    start = np.searchsorted(rows[:, 0], np.arange(count + 1)).astype(np.int32)
    return wp.array(start, dtype=int, device=device), wp.array(rows[:, 1:], dtype=wp.vec3i, device=device)


def _surface_of(arrays: Arrays) -> Surface:
    surface = Surface()
    model, state = arrays.model, arrays.state
    surface.bodies, surface.panels, surface.panel_parts = model.bodies, model.panels, model.panel_parts
    surface.rest, surface.frames, surface.materials = model.rest, arrays.frames, arrays.materials
    surface.limits, surface.control, surface.stitches = arrays.limits, state.control, state.seams.stitches
    moving = ("positions", "position_lo", "displacements", "velocities", "last_displacements")
    own = SelfContactState.vars
    for name in (*moving, *own):
        setattr(surface, name, getattr(state.self_contact if name in own else state, name))
    return surface


def _side_by_side(model: Model) -> np.ndarray:
    """Return the panels of a batch, body by body, ordered along a space-filling curve at rest (Morton 1966)."""
    body = model.panel_parts.numpy()[:, 0]
    corners, rest = model.panels.numpy(), model.rest.numpy()
    corners = model.bodies.numpy()["particles"][body][:, None] + np.where(corners < 0, corners[:, 1:2], corners)
    middles = rest[corners].mean(axis=1)
    spread = np.maximum((middles.max(axis=0) - middles.min(axis=0)).max(), 1e-30)
    cells = ((middles - middles.min(axis=0)) / spread * 1023.0).astype(np.int64)
    along = sum(((cells[:, axis] >> bit) & 1) << (3 * bit + axis) for bit in range(10) for axis in range(3))
    return np.lexsort((along, body))
