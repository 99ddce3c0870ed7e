"""The springs of a grid in cells: four particles and up to six springs among them, which one thread projects in turn.

A spring by itself moves four rows of memory in and two out; the six of a cell share theirs, and the springs of a grid
need six passes instead of twelve colours. NumPy on the grid; nothing here knows of a device.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cloth_sim_ros.sim.topology import Elements, Topology

# The springs of a cell, as places among its four particles: sides along x, sides along y, diagonals.
PAIRS = np.array([(0, 1), (2, 3), (0, 2), (1, 3), (0, 3), (1, 2)])
SIDES, DIAGONALS = 1, 2  # what the cells of a pass hold, as flags
# Flags of a record, above the bits of its first two indices; a grid has at most 2^22 particles (parameters.py).
INDEX = 24  # bits of an index
DOUBLED, ALONE, TURNED = INDEX, INDEX + 4, INDEX + 5  # of its first number; DOUBLED of side 0, then the others
HAS_SIDES, HAS_DIAGONALS, FAR, ODD = range(INDEX, INDEX + 4)  # of its second
BANKS = 8  # places of 16 bytes of its shared memory that a GPU reads or writes at a time
EMPTY = -1  # the last number of a record without a cell


@dataclass(frozen=True)
class Pass:
    """Cells that share no particle: particles (C, 4), the first `whole` with all their springs, the others with the two
    of PAIRS[:2] alone, or with one that is there twice.

    kind: of the sides, in KINDS; diagonals are shear springs. stride: steps of the grid along a side. holds: SIDES,
    DIAGONALS or both. doubled (C, 4): which sides are twice as compliant. turned (C,): where the two springs alone lie
    along y.
    """

    kind: str
    stride: int
    holds: int
    particles: np.ndarray
    whole: int
    doubled: np.ndarray
    turned: np.ndarray

    def records(self, odd: bool, width: int) -> np.ndarray:
        """(C, 4) int32 for the device: indices and flags, filled up with empty records to a multiple of `width`.

        A block of `width` threads takes so many at a time; ODD says of every record whether its pass has an odd number.
        FAR: sides are bending springs.

        Neighbours would meet in the same BANKS of a GPU's shared memory: cells are taken, and turned, so that few do.
        """
        corner = self.particles[:, 0] % BANKS
        half = corner[: self.whole] % (BANKS // 2)
        whole, mirrored = _spread(corner[: self.whole], half, half % 2 if self.stride == 2 else half // 2)
        none = np.zeros(len(corner) - self.whole, int)
        alone, turned = _spread(corner[self.whole :], none, none)
        order = np.concatenate([whole, self.whole + alone])
        records, doubled = self.particles[order], self.doubled[order]
        for rows, corners, sides in (
            (np.flatnonzero(mirrored), [1, 0, 3, 2], [0, 1, 3, 2]),
            (self.whole + np.flatnonzero(turned), [3, 2, 1, 0], [1, 0, 2, 3]),
        ):
            records[rows], doubled[rows] = records[rows][:, corners], doubled[rows][:, sides]
        flags = doubled @ (1 << DOUBLED + np.arange(4)) + ((order >= self.whole) << ALONE)
        flags += self.turned[order] << TURNED
        records[:, 0] += flags
        records[:, 1] += bool(self.holds & SIDES) << HAS_SIDES
        records[:, 1] += bool(self.holds & DIAGONALS) << HAS_DIAGONALS
        records[:, 1] += (self.kind == "bending") << FAR
        records = np.concatenate([records, np.tile([0, 0, 0, EMPTY], (-len(records) % width, 1))])
        records[:, 1] += odd << ODD
        return records.astype(np.int32)


def lengths(topology: Topology) -> tuple[float, float, float]:
    """Rest lengths [m] along x, along y and of diagonals of a grid; all its springs have these or their doubles."""
    along_x, along_y = (float(np.linalg.norm(topology.layout[k] - topology.layout[0])) for k in (1, topology.grid[0]))
    return along_x, along_y, float(np.hypot(along_x, along_y))


def passes(topology: Topology) -> list[Pass]:
    """All springs of a grid, each in one cell of one pass."""
    found = []
    for kind, stride in (("structural", 1), ("bending", 2)):
        if kind in topology.springs:
            found += _lattice(topology, kind, stride)
    return found


def _lattice(topology: Topology, kind: str, stride: int) -> list[Pass]:
    """The passes of the springs over `stride` steps of the grid, and of its diagonals where stride is 1.

    Cells whose corner has even numbers in both directions meet every side but those that cells with odd numbers meet;
    where the numbers differ in parity only diagonals are left. Sides at the grid's border that no cell of their parity
    reaches touch none of these cells either, and join their pass two by two.
    """
    nx, ny = topology.grid
    index = np.arange(nx * ny).reshape(ny, nx)
    corner = index[: max(ny - stride, 0), : max(nx - stride, 0)].ravel()
    cells = corner[:, None] + stride * np.array([0, 1, nx, nx + 1])
    u, v = corner % nx // stride % 2, corner // nx // stride % 2
    sides = _Lookup(topology.springs[kind], nx * ny)
    diagonals = _Lookup(topology.springs["shear"], nx * ny) if stride == 1 and "shear" in topology.springs else None
    found = []
    for parity in (0, 1):
        chosen = cells[(u == parity) & (v == parity)]
        first = sides.elements.particles[:, 0]
        along = np.where(sides.spans == stride, first % nx, first // nx) // stride % 2
        lone = (along == parity) & ~np.isin(sides.keys, sides.key(chosen[:, PAIRS[:4]]))
        pairs = [in_pairs(sides.elements.particles[lone & (sides.spans == span)]) for span in (stride, stride * nx)]
        whole = len(chosen)
        one = _pass(kind, stride, np.concatenate([chosen, *pairs]), whole, sides, diagonals)
        one.turned[whole + len(pairs[0]) :] = True
        found.append(one)
    if diagonals is not None:
        for parity in (0, 1):
            chosen = cells[(u == parity) & (v != parity)]
            found.append(_pass(kind, stride, chosen, len(chosen), None, diagonals))
    return [one for one in found if len(one.particles)]


def in_pairs(springs: np.ndarray) -> np.ndarray:
    """Springs (S, 2) two by two as cells (C, 4), each with one of the other half; one that is left is there twice."""
    half = (len(springs) + 1) // 2
    return np.column_stack([springs[:half], np.concatenate([springs[half:], springs[half - 1 : half]])[:half]])


def _spread(places: np.ndarray, half: np.ndarray, side: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """An order of cells whose first corners lie in `places` among BANKS, and which of them to turn.

    Of each place two in turn, the second of them turned, which puts its first corner `stride` places on. Beside two of
    the place that is half of BANKS away, of the same `half`, they are four cells of which no corner meets another of
    its kind. Four of one `side`, 0 or 1, and four of the other follow one another: nor do those meet.
    """
    rank = _ranks(places, np.argsort(places, kind="stable"))
    order = np.lexsort((places, rank % 2, rank // 2, half))
    fours = _ranks(side, order[np.argsort(side[order], kind="stable")])
    order = np.lexsort((fours % 4, side, fours // 4))
    return order, rank[order] % 2 == 1


def _ranks(kinds: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Which one of its kind each is, in an `order` by kinds."""
    counts = np.bincount(kinds, minlength=BANKS)
    ranks = np.empty(len(kinds), int)
    ranks[order] = np.arange(len(kinds)) - np.repeat(np.cumsum(counts) - counts, counts)
    return ranks


def springs_of(records: np.ndarray) -> np.ndarray:
    """(6, C, 2) the particles of the springs PAIRS of `records` (C, 4), -1 for what is not there or there again."""
    first, second = records[:, 0], records[:, 1]
    corners = np.column_stack([first & ((1 << INDEX) - 1), second & ((1 << INDEX) - 1), records[:, 2], records[:, 3]])
    sides, diagonals = second >> HAS_SIDES & 1 == 1, second >> HAS_DIAGONALS & 1 == 1
    whole, there = first >> ALONE & 1 == 0, records[:, 3] != EMPTY
    again = corners[:, 2] == corners[:, 0]
    held = np.array([sides, sides & ~again, *[sides & whole] * 2, *[diagonals & whole] * 2]) & there
    return np.where(held[..., None], corners[:, PAIRS].swapaxes(0, 1), -1)


def width_of(sweep: list[Pass], most: int) -> int:
    """How many cells a block projects at a time: whole warps for its largest pass, and `most` at most."""
    return min(most, -(-max((len(one.particles) for one in sweep), default=0) // 32) * 32)


class _Lookup:
    """Finds springs by their particles."""

    def __init__(self, elements: Elements, count: int) -> None:
        self.elements, self._count = elements, count
        self.keys = self.key(elements.particles)
        self.spans = np.diff(np.sort(elements.particles, axis=1), axis=1)[:, 0]
        self._order = np.argsort(self.keys)

    def key(self, pairs: np.ndarray) -> np.ndarray:
        """(...,) one number a pair (..., 2) of particles, in whatever order."""
        return pairs.min(-1) * self._count + pairs.max(-1)

    def scale(self, pairs: np.ndarray) -> np.ndarray:
        """Scale of the springs between `pairs` (..., 2)."""
        return self.elements.scale[self._order[np.searchsorted(self.keys, self.key(pairs), sorter=self._order)]]


def _pass(
    kind: str, stride: int, particles: np.ndarray, whole: int, sides: _Lookup | None, diagonals: _Lookup | None
) -> Pass:
    """The pass of these cells, of which the first `whole` have all their springs."""
    scale = np.ones((len(particles), 4))
    if sides is not None:
        scale[:whole] = sides.scale(particles[:whole, PAIRS[:4]])
        scale[whole:, :2] = sides.scale(particles[whole:, PAIRS[:2]])
    holds = (SIDES if sides is not None else 0) | (DIAGONALS if diagonals is not None else 0)
    return Pass(kind, stride, holds, particles, whole, scale == 2.0, np.zeros(len(particles), bool))
