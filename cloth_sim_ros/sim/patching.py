"""A grid cut into rectangles, each with the margin that one sweep over its cells reaches: NumPy, nothing of the device.

A pass moves a particle by what lies within one cell of it. A patch that holds its own particles and as many rows and
columns around them as all passes reach together can make a whole substep without a word from its neighbours: what goes
wrong at its border gets no farther than its margin (Demmel et al. 2008).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cloth_sim_ros.sim.cells import Pass, in_pairs


@dataclass(frozen=True)
class Patch:
    """Particles (M,) of a rectangle, row by row, which of them are its own (M,), and its cells of every pass, whose
    particles are places in the patch."""

    members: np.ndarray
    own: np.ndarray
    passes: list[Pass]


def margin(passes: list[Pass]) -> int:
    """How many rows and columns one sweep reaches."""
    return sum(one.stride for one in passes)


def cut(grid: tuple[int, int], passes: list[Pass], size: int) -> list[Patch]:
    """Patches that own at most `size` particles along x and y each, as even as may be."""
    along_x, along_y = _spans(grid, size)
    return [_patch(grid, passes, x, y) for y in along_y for x in along_x]


def largest(grid: tuple[int, int], passes: list[Pass], size: int) -> tuple[Patch, int]:
    """The one of these patches that has most particles, and how many patches there are."""
    around, spans = margin(passes), _spans(grid, size)
    x, y = (
        max(along, key=lambda span, count=count: min(span[1] + around, count) - max(span[0] - around, 0))
        for along, count in zip(spans, grid, strict=True)
    )
    return _patch(grid, passes, x, y), len(spans[0]) * len(spans[1])


def _spans(grid: tuple[int, int], size: int) -> list[list[tuple[int, int]]]:
    """First and end of what patches own along x and along y."""
    ends = [np.linspace(0, count, -(-count // size) + 1).round().astype(int).tolist() for count in grid]
    return [list(zip(each[:-1], each[1:], strict=True)) for each in ends]


def _patch(grid: tuple[int, int], passes: list[Pass], along_x: tuple[int, int], along_y: tuple[int, int]) -> Patch:
    nx, ny = grid
    around = margin(passes)
    x = np.arange(max(along_x[0] - around, 0), min(along_x[1] + around, nx))
    y = np.arange(max(along_y[0] - around, 0), min(along_y[1] + around, ny))
    members = (y[:, None] * nx + x).ravel()
    own = ((y >= along_y[0]) & (y < along_y[1]))[:, None] & ((x >= along_x[0]) & (x < along_x[1]))

    def place(particles: np.ndarray) -> np.ndarray:
        row, column = particles // nx - y[0], particles % nx - x[0]
        inside = (row >= 0) & (row < len(y)) & (column >= 0) & (column < len(x))
        return np.where(inside, row * len(x) + column, -1)

    rows = (members[0], members[-1])
    return Patch(members, own.ravel(), [_within(one, rows, place) for one in passes])


def _within(one: Pass, rows: tuple[int, int], place: Callable[[np.ndarray], np.ndarray]) -> Pass:
    """The cells of a pass whose particles, from the first to the last of `rows`, all have a place, -1 for none; lone
    springs are paired anew. Cells with all their springs go row by row, so that few are looked at."""
    first, end = np.searchsorted(one.particles[: one.whole, 0], (rows[0], rows[1] + 1))
    places = place(np.concatenate([one.particles[first:end], one.particles[one.whole :]]))
    doubles = np.concatenate([one.doubled[first:end], one.doubled[one.whole :]])
    count, across_all = end - first, one.turned[one.whole :]
    whole = (places[:count] >= 0).all(axis=1)
    particles, doubled = [places[:count][whole]], [doubles[:count][whole]]
    turned = [np.zeros(whole.sum(), bool)]
    for across in (False, True):
        mine = across_all == across
        # A spring alone is there twice; as pairs are cut apart it must be taken once.
        springs, first = np.unique(places[count:][mine].reshape(-1, 2), axis=0, return_index=True)
        twice = doubles[count:][mine][:, :2].reshape(-1)[first]
        inside = (springs >= 0).all(axis=1)
        pairs = in_pairs(springs[inside])
        particles.append(pairs)
        twice = in_pairs(np.repeat(twice[inside][:, None], 2, axis=1))[:, [0, 2]]
        doubled.append(np.pad(twice, ((0, 0), (0, 2))))
        turned.append(np.full(len(pairs), across))
    return Pass(
        one.kind,
        one.stride,
        one.holds,
        np.concatenate(particles),
        int(whole.sum()),
        np.concatenate(doubled),
        np.concatenate(turned),
    )
