# SPDX-License-Identifier: Apache-2.0
"""Memory layout of families of lines, in rows for a vector register or a warp (NumPy)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cloth_sim_ros.sim.kernels.native import LANES
from cloth_sim_ros.sim.topology.lines import Family
from cloth_sim_ros.sim.topology.springs import Elements

WARP = 32  # threads that share a row of lines on a GPU
# Minimum particles per thread when bodies share multiprocessors, as a particle then takes fewer instructions.
CROWDED = 4


@dataclass(frozen=True)
class Rows:
    """Rows of one family: particles (and what lies between each and the next) in slots of LANES or of WARP lanes.

    table (R, 3): the first slot of a row, its number of slots, its lines. nodes, others (S, lanes): a particle and the
    next in its line, -1 where there is none. rests [m], -1 without a spring, and scales (S, lanes). numbers (S, lanes)
    of the springs in Topology.springs, -1 for none.
    """

    table: np.ndarray
    nodes: np.ndarray
    others: np.ndarray
    rests: np.ndarray
    scales: np.ndarray
    numbers: np.ndarray


def slots_a_thread(families: list[Family]) -> int:
    """Particles that each thread of a warp holds: the least power of 2 by which the longest line fits a warp."""
    longest = max((family.particles.shape[1] for family in families), default=1)
    return 1 << max(0, (-(-longest // WARP) - 1).bit_length())


def in_lanes(family: Family, springs: Elements) -> Rows:
    """A line a lane, longest first; a slot holds the particles of all lines that are equally far along."""
    lengths = (family.particles >= 0).sum(1)
    order = np.argsort(-lengths, kind="stable")
    table, parts, first = [], [], 0
    for begin in range(0, len(order), LANES):
        lines = order[begin : begin + LANES]
        slots = int(lengths[lines[0]])
        # A lane without a line reads the first one's particles; behind a line's end stands its last particle.
        shown = np.concatenate([lines, np.repeat(lines[:1], LANES - len(lines))])
        end = np.minimum(np.arange(slots)[:, None], lengths[shown] - 1)
        number = np.pad(family.springs[shown], ((0, 0), (0, 1)), constant_values=-1)[:, :slots].T.copy()
        number[:, len(lines) :] = -1
        parts.append((family.particles[shown, end], number))
        table.append((first, slots, len(lines)))
        first += slots
    return _rows(springs, table, parts)


def in_warps(family: Family, springs: Elements, slots: int, rows: list[list[int]]) -> Rows:
    """The lines of each row one behind the other along the threads of a warp, `slots` particles each."""
    room, table, parts = WARP * slots, [], []
    lengths = (family.particles >= 0).sum(1)
    for lines in rows:
        nodes, numbers = np.full(room, -1), np.full(room, -1)
        at = 0
        for line in lines:
            n = int(lengths[line])
            nodes[at : at + n] = family.particles[line, :n]
            numbers[at : at + n - 1] = family.springs[line, : n - 1]
            at += n
        table.append((len(table) * slots, slots, len(lines)))
        parts.append((nodes.reshape(WARP, slots).T, numbers.reshape(WARP, slots).T))
    return _rows(springs, table, parts)


def packed(family: Family, slots: int) -> list[list[int]]:
    """The lines of each row of a family, if each thread of a warp holds `slots` particles.

    Each goes into the first row that has room, longest first.
    """
    lengths, room = (family.particles >= 0).sum(1), WARP * slots
    rows: list[list[int]] = []
    left: list[int] = []
    opened = 0  # rows before it are full
    for line in np.argsort(-lengths, kind="stable").tolist():
        n = int(lengths[line])
        while opened < len(left) and left[opened] < 2:
            opened += 1
        for r in range(opened, min(len(left), opened + 64)):
            if left[r] >= n:
                break
        else:
            r = len(left)
            rows.append([])
            left.append(room)
        rows[r].append(line)
        left[r] -= n
    return rows


def _rows(springs: Elements, table: list, parts: list) -> Rows:
    nodes, numbers = (np.concatenate([part[k] for part in parts]) for k in range(2))
    there = numbers >= 0
    pairs = springs.particles[np.where(there, numbers, 0)]
    others = np.where(there, pairs.sum(-1) - nodes, -1)
    rests = np.where(there, springs.rest[numbers], -1.0)
    return Rows(np.array(table), nodes, others, rests, np.where(there, springs.scale[numbers], 0.0), numbers)
