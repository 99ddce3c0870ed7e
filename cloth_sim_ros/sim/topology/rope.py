# SPDX-License-Identifier: Apache-2.0
"""A rope: a chain of segments with lumped masses, joints, and the part on a winch's drum."""

from __future__ import annotations

import numpy as np

from cloth_sim_ros.sim.physics.quaternion import rotate
from cloth_sim_ros.sim.scene.objects import Rope
from cloth_sim_ros.sim.topology.elements import Topology, pinned_particles
from cloth_sim_ros.sim.topology.springs import Elements

STRAIGHT = 1e-6  # angle [rad] below which a joint is straight, as its turn may be rounding of the points


def of_rope(rope: Rope, direct: bool) -> Topology:
    """Build a rope whose segments are a chain for a direct solve if `direct`, else springs."""
    points = rope.points
    count = len(points)
    length = np.linalg.norm(np.diff(points, axis=0), axis=1)
    halves = 0.5 * (np.append(length, 0.0) + np.insert(length, 0, 0.0))
    masses = rope.mass * halves / halves.sum() if rope.particle_masses is None else rope.particle_masses
    masses = masses + np.where(np.arange(count) == count - 1, rope.end_mass, 0.0)
    named = {"start": np.array([0]), "end": np.array([count - 1]), "both": np.array([0, count - 1])}
    winch = _winch(rope, length)
    if winch is not None:
        points = _paid_out(points, length, winch)
    index = np.arange(count)
    pairs = np.stack([index[:-1], index[1:]], axis=1)
    stretch = Elements(pairs, length, length)
    pinned = pinned_particles(rope.pins, named, count)
    bends, weights = _bends(rope, points, length, pinned)
    rest = rotate(rope.orientation, points) + np.asarray(rope.position)
    return Topology(
        rest=rest,
        masses=masses,
        pinned=pinned,
        springs={} if direct else {"structural": stretch},
        triangles=np.zeros((0, 3), dtype=np.int32),
        panels=np.concatenate([pairs, np.full((count - 1, 1), -1)], axis=1),
        layout=points,
        winch=winch,
        twists=rope.twist_compliance is not None,
        bends=bends,
        bend_weights=weights,
        rest_turns=rest_turns(rest) if rope.twist_compliance is not None else np.zeros((0, 2)),
        chain=stretch if direct else None,
        load=rope.end_mass,
        origin=rest[0],
    )


def _winch(rope: Rope, length: np.ndarray) -> tuple[int, float] | None:
    """The particle at the drum of a rope of segments `length` (S,) [m] and how much of its segment is out [m]."""
    if rope.winch is None:
        return None
    ends = np.cumsum(length)
    hidden = max(float(ends[-1]) - rope.winch.length, 0.0)
    index = min(int(np.searchsorted(ends, hidden, side="right")), len(length) - 1)
    out = float(ends[index]) - hidden
    if out < 0.5 * length[index] and index + 1 < len(length):  # part of the next, as after being hauled in
        index, out = index + 1, out + float(length[index + 1])
    return index, max(out, 0.5 * float(length[index]))


def _paid_out(points: np.ndarray, length: np.ndarray, winch: tuple[int, float]) -> np.ndarray:
    """Positions of particles when the part off the drum begins at the start of the path through `points` (N, 3)."""
    index, out = winch
    along = np.concatenate([[0.0], np.cumsum(length)])
    place = np.maximum(along - along[index + 1] + out, 0.0)
    place[: index + 1] = 0.0
    return np.stack([np.interp(place, along, points[:, axis]) for axis in range(3)], axis=1)


def _bends(
    rope: Rope, points: np.ndarray, length: np.ndarray, pinned: np.ndarray
) -> tuple[Elements | None, np.ndarray]:
    """Joints between segments. Half of each segment bends at a joint. A segment held at both ends does not bend. So a
    clamp of two pinned particles is twice as stiff as a joint (Hencky 1920)."""
    if rope.bend_compliance is None or len(points) < 3:
        return None, np.zeros((0, 2))
    index = np.arange(1, len(points) - 1)
    tangents = np.diff(points, axis=0) / length[:, None]
    turn = np.linalg.norm(np.diff(tangents, axis=0), axis=1)
    turn[turn < STRAIGHT] = 0.0
    if rope.winch is not None:
        turn[:] = 0.0  # a rope from a drum is straight at rest
    if rope.twist_compliance is not None:
        turn[:] = 0.0  # see Topology.rest_turns, which turn with the material
    bending = np.where(pinned[:-1] & pinned[1:], 0.0, length)
    span = 0.5 * np.where(bending[:-1] + bending[1:] > 0.0, bending[:-1] + bending[1:], length[:-1] + length[1:])
    particles = np.stack([index - 1, index, index + 1], axis=1)
    return Elements(particles, turn, span), np.stack([1.0 / length[:-1], 1.0 / length[1:]], axis=1)


def directors(tangents: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Unit vectors `first` (..., 3) across the first of `tangents` (..., S, 3), carried to all without twist."""
    found = np.empty_like(tangents)
    found[..., 0, :] = u = first
    before, after = tangents[..., :-1, :], tangents[..., 1:, :]
    # What is across one tangent turns as little as takes that to the next by losing a share of their sum.
    sums = (before + after) / np.maximum(1.0 + (before * after).sum(axis=-1, keepdims=True), 1e-2)
    for k in range(1, tangents.shape[-2]):
        found[..., k, :] = u = u - (u * tangents[..., k, :]).sum(axis=-1, keepdims=True) * sums[..., k - 1, :]
    return found


def across(tangent: np.ndarray) -> np.ndarray:
    """The unit vector (3,) across a unit tangent from the coordinate axis that is least aligned with it."""
    axis = np.eye(3)[np.argmin(np.abs(tangent))]
    found = axis - (axis @ tangent) * tangent
    return found / np.linalg.norm(found)


def rest_turns(points: np.ndarray) -> np.ndarray:
    """Turns (N - 2, 2) [-] of the joints of a rope through points (N, 3), along two directors at each.

    The first director is `across` the first segment, carried along without twist. It and the tangent make the second.
    """
    edges = np.diff(points, axis=0)
    tangents = edges / np.linalg.norm(edges, axis=1)[:, None]
    carried = directors(tangents, across(tangents[0]))
    one, along = carried[:-1] + carried[1:], tangents[:-1] + tangents[1:]
    one, along = (rows / np.linalg.norm(rows, axis=1)[:, None] for rows in (one, along))
    turn = np.diff(tangents, axis=0)
    return np.stack([(turn * one).sum(axis=1), (turn * np.cross(along, one)).sum(axis=1)], axis=1)
