# SPDX-License-Identifier: Apache-2.0
"""What lies around each particle of a body, by which it is cut into subdomains (see subdomain_plan.py)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cloth_sim_ros.sim.model import Body, Features, Model


@dataclass(frozen=True)
class Around:
    """What lies around the N particles of a body: W springs, padded with type 0, and P panels, padded with corner 3.

    others (N, W + 2 P): the particles at the other ends of the springs, then the other two corners of every panel.
    types (N, W): of the springs. corners (N, P): which corner of the panel the particle is. plate, weights (N, Q): the
    neighbours in the operator of bending, of a sheet that has it. reach: how many rings the slow forces look at.
    """

    others: np.ndarray
    types: np.ndarray
    corners: np.ndarray
    plate: np.ndarray
    weights: np.ndarray
    reach: int


def all_around(model: Model, features: Features) -> list[Around]:
    """What lies around the particles of every body, padded alike."""
    found = []
    bodies = [dict(zip(Body.vars, body, strict=True)) for body in model.bodies.numpy().tolist()]
    incident_springs, starts = model.incident_springs.numpy(), model.panel_start.numpy()
    most = int(np.diff(starts).max(initial=0)) if features.panels else 0
    width = max(body["incident_width"] for body in bodies)
    wide = max(body["plate_width"] for body in bodies)
    for body in bodies:
        count, first = body["count"], body["incident_springs"]
        mine = incident_springs[first : first + count * body["incident_width"]].reshape(-1, count, 2).swapaxes(0, 1)
        lacking = width - body["incident_width"]
        others, types = (np.pad(mine[:, :, k], ((0, 0), (0, lacking))) for k in range(2))
        others[:, width - lacking :] = np.arange(count)[:, None]
        corners, ends = _panels_around(model, starts[body["particles"] : body["particles"] + count + 1], most)
        others = np.concatenate([others, ends], axis=1)
        plate, weights = _plate_around(model, body, wide)
        reach = max(1 if most else 0, _rings_to(plate, others))
        found.append(Around(others, types, corners, plate, weights, reach))
    return found


def _plate_around(model: Model, body: dict, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Neighbours (N, width) of a body's particles in the operator of bending, themselves where there are fewer, and
    weights."""
    count, own, first = body["count"], body["plate_width"], body["plate"]
    plate = np.repeat(np.arange(count)[:, None], width, axis=1)
    weights = np.zeros((count, width))
    if own:
        shape = (count, own) if model.plate_strides[1] == 0 else (own, count)
        rows = [each.numpy()[first : first + count * own] for each in (model.plate_neighbours, model.plate_weights)]
        rows = [each.reshape(shape) if shape[0] == count else each.reshape(shape).T for each in rows]
        plate[:, :own], weights[:, :own] = np.where(rows[1] == 0.0, plate[:, :own], rows[0]), rows[1]
    return plate, weights


def _rings_to(plate: np.ndarray, others: np.ndarray) -> int:
    """How many steps to neighbours `others` (N, W) it takes at most from a particle to those in `plate` (N, Q)."""
    count, rings = len(others), 0
    hubs = np.arange(count)
    wanted = np.unique(hubs[:, None] * count + plate)
    reached = hubs * count + hubs
    while len(wanted := np.setdiff1d(wanted, reached, assume_unique=True)):
        home, particle = np.divmod(reached, count)
        reached = np.unique(home[:, None] * count + others[particle])
        rings += 1
    return rings


def _panels_around(model: Model, starts: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Which corner (N, most) a particle is of every panel around it, and the other two corners (N, 2 most)."""
    count = len(starts) - 1
    corners = np.full((count, most), 3)
    ends = np.repeat(np.arange(count)[:, None], 2 * most, axis=1)
    if most:
        degree = np.diff(starts)
        hub = np.repeat(np.arange(count), degree)
        slot = np.arange(len(hub)) - np.repeat(starts[:-1] - starts[0], degree)
        panel = model.panels.numpy()[model.particle_panels.numpy()[starts[0] : starts[-1]]]
        panel = np.where(panel < 0, hub[:, None], panel)  # a rope's segment has no third corner
        corner = np.argmax(panel == hub[:, None], axis=1)
        corners[hub, slot] = corner
        ends[hub, 2 * slot] = panel[np.arange(len(hub)), np.where(corner == 0, 1, 0)]
        ends[hub, 2 * slot + 1] = panel[np.arange(len(hub)), np.where(corner == 2, 1, 2)]
    return corners, ends
