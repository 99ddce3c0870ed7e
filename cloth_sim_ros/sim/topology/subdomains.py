# SPDX-License-Identifier: Apache-2.0
"""A body cut into subdomains, each with a halo of the particles around it: NumPy on the topology, nothing of the
device.

The distance between particles is the number of springs on the shortest way. A subdomain that holds every particle
within distance r of its own can advance its own by r substeps without a word from its neighbours (Demmel et al. 2008).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

BANKS = 8  # of 16 bytes: as many threads of a GPU read shared memory at once if each reads from another


@dataclass(frozen=True)
class Partition:
    """Subdomains of one body, and the places of a particle's springs within its subdomain.

    members (M,): particles of all subdomains behind one another, in each subdomain its own first, then ring after ring.
    ends (T, depth + 1): how many members of a subdomain lie within distance r of its own. inner (M,): whether a member
    lies within distance depth - 1. incident_springs (inner members, W): which members of its subdomain the W neighbours
    of a member are. places (M,): where a member lies in the memory of its subdomain. turns (M,): all members once more,
    in each subdomain in the order in which threads take them.
    """

    members: np.ndarray
    ends: np.ndarray
    inner: np.ndarray
    incident_springs: np.ndarray
    places: np.ndarray
    turns: np.ndarray


def cut(layout: np.ndarray, size: int) -> np.ndarray:
    """The subdomain (N,) of every particle: at most `size` in each, halved along the longest side again and again.

    layout: (N, 3) [m]. Recursive coordinate bisection (Berger and Bokhari 1987); ties go by the other coordinates, so
    that a grid falls into rectangles.
    """
    subdomain = np.zeros(len(layout), dtype=np.int64)
    pending = [(np.arange(len(layout)), -(-len(layout) // size))]
    done = 0
    while pending:
        particles, parts = pending.pop()
        if parts == 1:
            subdomain[particles] = done
            done += 1
            continue
        points = layout[particles]
        axis = int(np.argmax(np.round(np.ptp(points, axis=0), 9)))
        order = np.lexsort((points[:, (axis + 2) % 3], points[:, (axis + 1) % 3], points[:, axis]))
        half = parts // 2
        middle = len(particles) * half // parts
        pending += [(particles[order[middle:]], parts - half), (particles[order[:middle]], half)]
    return subdomain


def surround(subdomain: np.ndarray, neighbours: np.ndarray, depth: int) -> Partition:
    """Every subdomain (N,) of `cut` with its halo of `depth` rings; neighbours (N, W) by springs, itself where it has
    fewer."""
    count, subdomains = len(subdomain), int(subdomain.max()) + 1
    rings = [np.sort(subdomain * count + np.arange(count))]
    seen = rings[0]
    for _ in range(depth):
        home, particle = np.divmod(rings[-1], count)
        reached = np.unique(home[:, None] * count + neighbours[particle])
        rings.append(np.setdiff1d(reached, seen, assume_unique=True))
        seen = np.sort(np.concatenate([seen, rings[-1]]))
    key = np.concatenate(rings)
    ring = np.repeat(np.arange(depth + 1), [len(r) for r in rings])
    order = np.lexsort((key, ring, key // count))
    key, ring = key[order], ring[order]
    home, members = np.divmod(key, count)
    sizes = np.stack([np.bincount(home[ring == r], minlength=subdomains) for r in range(depth + 1)], axis=1)
    ends = np.cumsum(sizes, axis=1)
    place = np.arange(len(key)) - (np.cumsum(ends[:, -1]) - ends[:, -1])[home]
    inner = ring < depth
    by_key = np.argsort(key)
    wanted = home[inner, None] * count + neighbours[members[inner]]
    incident_springs = place[by_key[np.searchsorted(key[by_key], wanted)]]
    places = _places(members, home)
    return Partition(members, ends, inner, incident_springs, places, _turns(places, ring, home))


def _places(members: np.ndarray, home: np.ndarray) -> np.ndarray:
    """Places (M,) by the order of particles, so that a neighbour in a grid is equally far from all. Rows begin an odd
    number of places from one another, so that particles of a column lie in different banks."""
    order = np.lexsort((members, home))
    begins = np.r_[True, (np.diff(members[order]) != 1) | (np.diff(home[order]) != 0)]
    row = np.cumsum(begins) - 1
    length = np.bincount(row)
    gap = (length % 2 == 0) & (length > 2)
    place = np.arange(len(members)) + (np.cumsum(gap) - gap)[row]
    first = np.searchsorted(home[order], home[order])
    places = np.empty_like(place)
    places[order] = place - place[first]
    return places


def _turns(places: np.ndarray, ring: np.ndarray, home: np.ndarray) -> np.ndarray:
    """Members (M,) ring after ring, in each one of every bank after the other: their neighbours then lie in different
    banks as well."""
    bank = places % BANKS
    order = np.lexsort((places, bank, ring, home))
    alike = (home[order] * (ring.max() + 1) + ring[order]) * BANKS + bank[order]
    nth = np.empty_like(places)
    nth[order] = np.arange(len(order)) - np.searchsorted(alike, alike)
    return np.lexsort((bank, nth, ring, home))
