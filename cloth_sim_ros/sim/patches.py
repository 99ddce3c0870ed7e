"""A grid cut into rectangles, each with the margin that one sweep over its cells reaches: NumPy, nothing of the device.

A pass moves a particle by what lies within one cell of it. A patch that holds its own particles and as many rows and
columns around them as all passes reach together can make a whole substep without a word from its neighbours: what goes
wrong at its border gets no farther than its margin (Demmel et al. 2008).
"""

from __future__ import annotations

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
    around = margin(passes)
    spans = [np.linspace(0, count, -(-count // size) + 1).round().astype(int) for count in grid]
    return [
        _patch(grid, passes, around, (left, right), (low, high))
        for low, high in zip(spans[1][:-1], spans[1][1:], strict=True)
        for left, right in zip(spans[0][:-1], spans[0][1:], strict=True)
    ]


def _patch(
    grid: tuple[int, int], passes: list[Pass], around: int, along_x: tuple[int, int], along_y: tuple[int, int]
) -> Patch:
    nx, ny = grid
    x = np.arange(max(along_x[0] - around, 0), min(along_x[1] + around, nx))
    y = np.arange(max(along_y[0] - around, 0), min(along_y[1] + around, ny))
    members = (y[:, None] * nx + x).ravel()
    own = ((y >= along_y[0]) & (y < along_y[1]))[:, None] & ((x >= along_x[0]) & (x < along_x[1]))
    place = np.full(nx * ny, -1)
    place[members] = np.arange(len(members))
    return Patch(members, own.ravel(), [_within(one, place) for one in passes])


def _within(one: Pass, place: np.ndarray) -> Pass:
    """The cells of a pass whose particles all have a place (N,), -1 for none; lone springs are paired anew."""
    places = place[one.particles]
    whole = (places[: one.whole] >= 0).all(axis=1)
    particles, doubled = [places[: one.whole][whole]], [one.doubled[: one.whole][whole]]
    turned = [np.zeros(whole.sum(), bool)]
    for across in (False, True):
        mine = one.turned[one.whole :] == across
        # A spring alone is there twice; as pairs are cut apart it must be taken once.
        springs, first = np.unique(places[one.whole :][mine].reshape(-1, 2), axis=0, return_index=True)
        twice = one.doubled[one.whole :][mine][:, :2].reshape(-1)[first]
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
