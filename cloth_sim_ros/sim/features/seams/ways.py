# SPDX-License-Identifier: Apache-2.0
"""Ways of springs from sewn particles into their sheets, which stitches are solved with (NumPy).

A way follows a line of structural springs away from a sewn particle. No particle is on two ways, and none on a way is
sewn, so that each way is a chain with only one end that others move.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cloth_sim_ros.sim.topology import Topology

LONGEST = 64  # springs of a way at most


def ways_of(topology: Topology, sewn: Sequence[int]) -> list[list[list[int]]]:
    """Return the ways from each of the particles `sewn` of an object: the particles of each, from near to far.

    All grow spring by spring, so that none takes what is nearer to another.
    """
    open_ways = [(k, way, []) for k, particle in enumerate(sewn) for way in _lines_from(topology, particle)]
    taken, found = set(sewn), [[] for _ in sewn]
    for _ in range(LONGEST):
        growing = []
        for k, ahead, way in open_ways:
            particle = next(ahead, None)
            if particle is None or particle in taken:
                continue
            if not way:
                found[k].append(way)
            taken.add(particle)
            way.append(particle)
            growing.append((k, ahead, way))
        open_ways = growing
    return found


def _lines_from(topology: Topology, particle: int):
    """Iterators over the particles of each line of structural springs from a particle on, one to each side of it."""
    for family in topology.families:
        if family.kind != "structural":
            continue
        for line, at in np.argwhere(family.particles == particle):
            row, springs = family.particles[line], family.springs[line]
            ahead, behind = np.append(springs[at:] < 0, True), np.append(springs[:at][::-1] < 0, True)
            yield iter(row[at + 1 : at + 1 + int(np.argmax(ahead))].tolist())
            yield iter(row[:at][::-1][: int(np.argmax(behind))].tolist())
