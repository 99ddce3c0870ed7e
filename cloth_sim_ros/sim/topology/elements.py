# SPDX-License-Identifier: Apache-2.0
"""Particles at rest and elements of an object, in NumPy.

Rest shapes are float64. A material compliance times an element's `scale` is the element's own compliance, so that a
live change of the material never touches these arrays. Nothing here knows of a device.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from cloth_sim_ros.sim.input.mesh_repair import areas_of, edges_of
from cloth_sim_ros.sim.topology.frequencies import Frequencies
from cloth_sim_ros.sim.topology.lines import Family, families, rounds
from cloth_sim_ros.sim.topology.membrane import Coupling
from cloth_sim_ros.sim.topology.springs import Elements

_MOST_POWERS = 300
_SETTLED = 1e-5  # change of a Rayleigh quotient by one more power at which it is taken as found


@dataclass(frozen=True)
class PlateParts:
    """The triangles that contribute to the weights of a Plate, for sheets that tear.

    sums (N, W): where in start (S + 1,) the parts of a weight begin, -1 for places that are not used. triangles,
    weights (E,): a part and the triangle that it is of. needs (T, n): the triangles without which a triangle does not
    bend. curves (C,): the triangles that are curved at rest.
    """

    sums: np.ndarray
    start: np.ndarray
    triangles: np.ndarray
    weights: np.ndarray
    needs: np.ndarray
    curves: np.ndarray


@dataclass(frozen=True)
class Plate:
    """The bending operator of a sheet of rigidity 1 N m on the positions x, from `plate.of_triangles`.

    The force on particle i is -B sum_j weights[i, j] (x[neighbours[i, j]] - x_i), with the rigidity B [N m].
    neighbours: (N, W). weights: (N, W) [1/m^2], 0 for unused places.

    In a sheet that is curved at rest, each such triangle adds the energy -B n . s. Here
    s = sum_j gradients[t, j] x[stencil[t, j]], and n is the triangle's unit normal. stencil: (C, S), first the
    triangle's own three particles. gradients: (C, S) [1/m]. Both are None for a sheet that is flat at rest. parts: None
    for a sheet that does not tear.
    """

    neighbours: np.ndarray
    weights: np.ndarray
    stencil: np.ndarray | None = None
    gradients: np.ndarray | None = None
    parts: PlateParts | None = None


@dataclass(frozen=True)
class Constraints:
    """Pairs of particles (E, 2), and of (E, 2) the row of the live numbers and the index of the law."""

    particles: np.ndarray
    of: np.ndarray


@dataclass(frozen=True)
class Stitches:
    """Stitches of one seam, from points of an object to points of `other`.

    particles (E, 4): two of the object, then two of the other. shares (E, 2): of the second of each two; the point lies
    between them. row: of the live numbers. slides: True if points of the other move along it.
    """

    seam: str
    other: str
    particles: np.ndarray
    shares: np.ndarray
    row: int
    slides: bool


@dataclass(frozen=True)
class Topology:
    """One object: rest positions (N, 3) [m] in the world, masses (N,) [kg], pinned (N,), elements, triangles, segments.

    springs: kind of KINDS -> Elements of pairs, rest [m]. chain: the same of a rope's segments where they are solved in
    one, which then has no springs. bends: (B, 3), whose rest is the turn [-]. bend_weights (B, 2): the inverse lengths
    [1/m] of the two segments of a bend. rest_turns (B, 2): of a rope that resists twist, the turn at rest along the
    directors of each joint, see `rest_turns` in rope.py. triangles: (T, 3). panels: (P, 3) particles that the wind acts
    on, -1 as the third of a rope's segment. layout: (N, 3) rest positions [m] in local axes. grid: particles along x
    and y, None for what is no grid. winch: of a rope on a winch, the last particle at the drum and the rest length [m]
    of the segment that begins there. plate: what a sheet resists bending with. coupling: of the structural springs of a
    membrane. twists: whether a rope resists twist. tear_strain: beyond which its springs fail, 0 for never. stitches:
    of the seams that it is first in. load: what of the last mass is no part of the object [kg]. world_scales: (worlds,)
    by how much it is larger than all this says in each world, about `origin` (3,) [m] in the world; None where no world
    ever had another size.
    """

    rest: np.ndarray
    masses: np.ndarray
    pinned: np.ndarray
    springs: dict[str, Elements]
    triangles: np.ndarray
    panels: np.ndarray
    layout: np.ndarray
    winch: tuple[int, float] | None = None
    twists: bool = False
    plate: Plate | None = None
    coupling: Coupling | None = None
    bends: Elements | None = None
    bend_weights: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    rest_turns: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    chain: Elements | None = None
    grid: tuple[int, int] | None = None
    tear_strain: float = 0.0
    load: float = 0.0
    constraints: Constraints | None = None
    stitches: tuple[Stitches, ...] = ()
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    world_scales: np.ndarray | None = None

    def scales_in(self, worlds: Any = ...) -> np.ndarray:
        """Scales (k,) relative to `rest` in worlds of an index, or 1 for all."""
        return np.ones(1) if self.world_scales is None else self.world_scales[worlds]

    def rest_in(self, world: int) -> np.ndarray:
        """Rest positions (N, 3) [m] in one world."""
        if self.world_scales is None:
            return self.rest
        return self.origin + self.world_scales[world] * (self.rest - self.origin)

    def at(self, world_scales: np.ndarray | None) -> Topology:
        """Copy with other scales; cached properties of its shape are kept."""
        found = copy.copy(self)
        object.__setattr__(found, "world_scales", world_scales)
        return found

    @cached_property
    def families(self) -> list[Family]:
        """All springs in lines, in families of lines that share no particle."""
        return families(self.springs, self.layout, self.grid)

    @cached_property
    def rounds(self) -> list[list[tuple[int, np.ndarray | None]]]:
        """The families in the order in which they are solved, see topology/lines.py."""
        return rounds(self.families, len(self.masses))

    @cached_property
    def spacing(self) -> float:
        """Mean rest length of all springs and segments [m], 1 where there are none."""
        kinds = [*self.springs.values(), *([] if self.chain is None else [self.chain])]
        return float(np.concatenate([elements.rest for elements in kinds]).mean()) if kinds else 1.0

    @cached_property
    def widest_gap(self) -> float:
        """Largest distance of a point of a triangle or segment from the nearest of its corners, at rest [m]."""
        segment = self.panels[:, 2] < 0
        ends = np.where(segment[:, None], self.panels[:, [0, 1, 1]], self.panels)
        corners = self.layout[ends]
        sides = np.sort(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), axis=1)
        # In an acute triangle this is the circumcentre; else it is on the longest side, no farther than half of it.
        acute = sides[:, 0] ** 2 + sides[:, 1] ** 2 > sides[:, 2] ** 2
        circle = sides.prod(axis=1) / np.maximum(4.0 * areas_of(self.layout, ends), 1e-300)
        return float(np.where(acute & ~segment, circle, 0.5 * sides[:, 2]).max())

    def frequencies(self, crumples: bool) -> Frequencies:
        """Frequencies of its springs, at rest or, if it `crumples`, in any shape; it must have springs."""
        if crumples not in self._frequencies:
            self._frequencies[crumples] = Frequencies(self.springs, self.rest, self.masses, self.pinned, crumples)
        return self._frequencies[crumples]

    @cached_property
    def _frequencies(self) -> dict[bool, Frequencies]:
        return {}

    @cached_property
    def fold_gap(self) -> float:
        """Lower bound of the distance at rest of parts of a sheet without common particles [m]: least triangle height.

        It is 0 if the rest shape is not a flat convex piece, or may tear into one that is not.
        """
        if not len(self.triangles) or self.tear_strain > 0.0:
            return 0.0
        middle = self.layout.mean(axis=0)
        _, spread, axes = np.linalg.svd(self.layout - middle, full_matrices=False)
        if spread[2] > 1e-6 * spread[0]:
            return 0.0
        flat = (self.layout - middle) @ axes[:2].T
        found, times, _ = edges_of(self.triangles, len(flat))
        starts, ways = flat[found[times == 1, 0]], np.diff(flat[found[times == 1]], axis=1)[:, 0]
        normals = np.column_stack([-ways[:, 1], ways[:, 0]]) / np.linalg.norm(ways, axis=1, keepdims=True)
        off = flat @ normals.T - (starts * normals).sum(axis=1)  # of each particle, from each edge of the outline
        if (np.minimum(off.max(axis=0), -off.min(axis=0)) > 1e-6 * spread[0]).any():
            return 0.0
        sides = np.diff(flat[self.triangles[:, [0, 1, 2, 0]]], axis=1)
        doubled = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
        return float((doubled / np.linalg.norm(sides, axis=2).max(axis=1)).min())

    @property
    def far_ends(self) -> list[int]:
        """Two particles far from one another, and two more on both sides of the line between these."""
        out = self.layout - self.layout.mean(axis=0)
        first = np.linalg.norm(out, axis=1).argmax()
        second = np.linalg.norm(out - out[first], axis=1).argmax()
        axis = (out[second] - out[first]) / np.linalg.norm(out[second] - out[first])
        beside = out - np.outer(out @ axis, axis)
        along = beside @ beside[np.linalg.norm(beside, axis=1).argmax()]
        return [int(k) for k in (first, second, along.argmin(), along.argmax())]

    @property
    def bends_by_angles(self) -> bool:
        """True if the joints of a rope resist bending."""
        return self.bends is not None

    @cached_property
    def coupled_rate(self) -> float:
        """omega^2 [1/s^2] of the fastest mode of the springs of a membrane at a compliance of 1 m/N."""
        springs = {"structural": self.springs["structural"]}
        return Frequencies(springs, self.rest, self.masses, self.pinned, crumples=False).exact((1.0,))

    @cached_property
    def plate_rate(self) -> float:
        """omega^2 [1/s^2] of the fastest bending mode of a sheet of rigidity 1 N m, 0 where nothing bends.

        By power iteration from a fixed start with Rayleigh's quotient, a lower bound by next to nothing.
        """
        if self.plate is None:
            return 0.0
        inverse_mass = np.where(self.pinned, 0.0, 1.0 / self.masses)
        diagonal = self.plate.weights.sum(axis=1)
        x = np.random.default_rng(3).standard_normal(len(inverse_mass)) * (inverse_mass > 0.0)
        rate = 0.0
        for _ in range(_MOST_POWERS):
            force = (self.plate.weights * x[self.plate.neighbours]).sum(axis=1) - diagonal * x
            last, rate = rate, float(x @ force) / max(float((self.masses * x * x).sum()), 1e-300)
            x = force * inverse_mass
            x /= max(float(np.linalg.norm(x)), 1e-300)
            if abs(rate - last) <= _SETTLED * rate:
                break
        return rate


def pinned_particles(pins: Any, named: dict[str, np.ndarray], count: int) -> np.ndarray:
    """(N,) bool: True for fixed particles among `count`; `pins` is a name in `named` or indices, already checked."""
    fixed = np.zeros(count, dtype=bool)
    if pins is not None and pins != "none":
        fixed[named[pins] if isinstance(pins, str) else list(pins)] = True
    return fixed
