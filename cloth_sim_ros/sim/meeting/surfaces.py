# SPDX-License-Identifier: Apache-2.0
"""What contact between objects knows of them: the panels of all batches in one list, and the arrays behind them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from cloth_sim_ros.sim.intrinsics import load_row, xyz
from cloth_sim_ros.sim.model import Body
from cloth_sim_ros.sim.state import Arrays, Frame, Material
from cloth_sim_ros.sim.topology import Topology


@wp.struct
class Surface:
    """Of the arrays of a batch in a world, those that contact between objects needs; all are thousands of bytes."""

    bodies: wp.array(dtype=Body)
    panels: wp.array(dtype=wp.vec3i)
    panel_parts: wp.array(dtype=wp.vec2i)
    rest: wp.array(dtype=wp.vec3)
    frames: wp.array(dtype=Frame)
    materials: wp.array(dtype=Material)
    positions: wp.array(dtype=wp.vec4)
    low: wp.array(dtype=wp.vec4)
    displacements: wp.array(dtype=wp.vec4)
    velocities: wp.array(dtype=wp.vec4)
    last_displacements: wp.array(dtype=wp.vec3)
    seen: wp.array(dtype=wp.vec4)
    going: wp.array(dtype=wp.vec3)
    asked: wp.array(dtype=wp.int64)
    shortened: wp.array(dtype=float)


@wp.struct
class Members:
    """Who may meet whom. Panels and bodies are counted through all batches.

    surfaces: (batches x worlds,), all worlds of the first batch first. panels: (P,) batch and number there. bodies:
    (B,) batch, number there, and whether it is kept apart from itself. owners: (P,) the body of a panel. among: whether
    bodies meet one another. flattens: whether all are sheets that may lie so flat that nothing meets, see flat.py.
    gaps, ends: (B,) Topology.fold_gap and far_ends.
    """

    surfaces: wp.array(dtype=Surface)
    panels: wp.array(dtype=wp.vec2i)
    bodies: wp.array(dtype=wp.vec3i)
    owners: wp.array(dtype=int)
    gaps: wp.array(dtype=float)
    ends: wp.array(dtype=wp.vec4i)
    worlds: int
    batches: int
    among: bool
    flattens: bool


@wp.struct
class Panel:
    """One panel in one world: its body, where its batch's arrays are in Members.surfaces, and its particles there. A
    segment has its second one twice. own: the bits of Model.panel_parts."""

    body: int
    surface: int
    own: int
    corners: wp.vec3i


@wp.func
def panel_of(members: Members, k: int, w: int) -> Panel:
    """Panel k in world w."""
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
def surface_of(members: Members, batch: int, w: int) -> Surface:
    """The arrays of a batch in world w."""
    return members.surfaces[batch * members.worlds + w]


@wp.func
def place(surface: Surface, i: int) -> wp.vec3:
    """Where particle i of a batch was when the substep began [m]."""
    return xyz(load_row(surface.positions, i))


@wp.func
def velocity(surface: Surface, i: int) -> wp.vec3:
    """Its velocity then [m/s]."""
    return xyz(load_row(surface.velocities, i))


@wp.func
def may_touch(members: Members, a: int, b: int) -> bool:
    """Whether two bodies are kept apart."""
    if a == b:
        return members.bodies[a][2] > 0
    return members.among


def members_of(
    batches: Sequence[Sequence[Arrays]],
    topologies: Sequence[Topology],
    itself: Sequence[bool],
    among: bool,
    device: wp.Device,
) -> Members:
    """The Members of batches, of each its arrays in all worlds.

    topologies, itself: of each body, and whether it is kept apart from itself. among: whether bodies are kept apart
    from one another.
    """
    members = Members()
    surfaces, panels, bodies, owners = [], [], [], []
    for number, worlds in enumerate(batches):
        surfaces += [_surface_of(arrays) for arrays in worlds]
        own = np.arange(worlds[0].model.panels.shape[0])
        panels.append(np.column_stack([np.full_like(own, number), own]))
        owners.append(len(bodies) + worlds[0].model.panel_parts.numpy()[:, 0])
        bodies += [(number, b, int(itself[len(bodies) + b])) for b in range(worlds[0].model.bodies.shape[0])]
    members.surfaces = wp.array(surfaces, dtype=Surface, device=device)
    members.panels = wp.array(np.concatenate(panels).astype(np.int32), dtype=wp.vec2i, device=device)
    members.bodies = wp.array(np.array(bodies, np.int32), dtype=wp.vec3i, device=device)
    members.owners = wp.array(np.concatenate(owners).astype(np.int32), dtype=int, device=device)
    members.gaps = wp.array([topology.fold_gap for topology in topologies], dtype=float, device=device)
    ends = [topology.far_ends for topology in topologies]
    members.ends = wp.array(np.array(ends, np.int32), dtype=wp.vec4i, device=device)
    members.worlds, members.batches, members.among = len(batches[0]), len(batches), among
    members.flattens = not among and all(topology.fold_gap for topology in topologies)
    return members


def _surface_of(arrays: Arrays) -> Surface:
    surface = Surface()
    model, state = arrays.model, arrays.state
    surface.bodies, surface.panels, surface.panel_parts = model.bodies, model.panels, model.panel_parts
    surface.rest, surface.frames, surface.materials = model.rest, arrays.frames, arrays.materials
    moving = ("positions", "low", "displacements", "velocities", "last_displacements")
    for name in (*moving, "seen", "going", "asked", "shortened"):
        setattr(surface, name, getattr(state, name))
    return surface
