# SPDX-License-Identifier: Apache-2.0
"""What a start needs before it is simulated that is far from rest, or inside of a collider."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping

import numpy as np
import warp as wp

from cloth_sim_ros.sim.access.report import PARTICLES, make_measure_contacts
from cloth_sim_ros.sim.arrays.state import Arrays, State
from cloth_sim_ros.sim.engine.batch import Batch
from cloth_sim_ros.sim.physics.quaternion import Motion, moved, rotate
from cloth_sim_ros.sim.topology import Topology

STRAINED = 0.5  # strain of a spring beyond which a start is far from rest
_STEPS = 100  # along a way out, at most
_LITTLE = 1e-3  # of the size of an object: the shortest of these steps, and how thin it is where it lies in a plane
_FARTHEST = 3.0  # depths: the longest way out of an object that lies in no plane
_SHORTER = 0.95  # of the way found so far: the length below which another one is better
_NUDGE = 1e-5  # of the mean rest length of the springs
_TURNS = np.array([[1.93, -0.71, 0.37], [0.53, 2.11, -0.83], [-0.61, 0.47, 1.79]])  # even in no direction


def is_strained(topology: Topology, positions: np.ndarray, torn: Mapping[str, np.ndarray]) -> bool:
    """Whether positions (N, 3) [m] strain any spring by more than STRAINED but those of a kind that are `torn` (S,)."""
    for kind, elements in topology.springs.items():
        length = np.linalg.norm(positions[elements.particles[:, 1]] - positions[elements.particles[:, 0]], axis=1)
        if ((np.abs(length - elements.rest) > STRAINED * elements.rest) & ~torn.get(kind, np.False_)).any():
            return True
    return False


def off_symmetry(topology: Topology, positions: np.ndarray, scale: float) -> np.ndarray:
    """Positions (N, 3) [m], what is not pinned moved by at most a hundred-thousandth of a spring's length at a scale.

    A start may be a mirror image of itself, as a grid that is stretched or put inside out about its middle. It stays
    one to the bit, and may come to rest where nothing but the symmetry holds it. A cell in its middle is inside out
    then, its springs strained by half. The way is a smooth function of the place, so that what is in one place stays
    so.
    """
    spacing = scale * np.concatenate([elements.rest for elements in topology.springs.values()]).mean()
    way = np.sin(positions / spacing @ _TURNS.T + [0.3, 1.1, 2.3])
    return np.where(topology.pinned[:, None], positions, positions + _NUDGE * spacing * way)


class Depth:
    """How deep the surface of a body would lie in `colliders`, rows of ColliderMotion, with its particles elsewhere.

    fixed (N,): the particles that a pin, a drum or a handle holds.
    """

    def __init__(self, batch: Batch, name: str, colliders: wp.array) -> None:
        batch.upload()
        given, self._arrays, self._body = batch.worlds[0], Arrays(), batch.index[name]
        self._arrays.model, self._arrays.materials, self._arrays.colliders = given.model, given.materials, colliders
        self._arrays.state = State()
        self._arrays.state.positions = wp.clone(given.state.positions)
        self._rows = self._arrays.state.positions[batch.span(name)]
        self._result = wp.zeros(4, dtype=float, device=batch.device)
        self._kernel, self._panels = make_measure_contacts(batch.features.shapes), batch.panels(name)
        self._inverse = self._rows.numpy()[:, 3]
        if batch.features.handles:
            self._inverse = np.where(batch.read_rows("grips", name, 0)[0, :, 3] > 0.0, 0.0, self._inverse)
        self.fixed = self._inverse == 0.0

    def at(self, positions: np.ndarray) -> float:
        """What `report` would call max_penetration [m], with particles at `positions` (N, 3)."""
        self._rows.assign(np.column_stack([positions, self._inverse]).astype(np.float32))
        self._result.zero_()
        inputs, dim = [self._arrays, self._body, self._result], self._panels.stop - self._panels.start
        wp.launch(self._kernel, dim=dim, inputs=inputs, device=self._result.device)
        return float(self._result.numpy()[PARTICLES:].max())


def way_out(positions: np.ndarray, depth: Depth, up: np.ndarray) -> tuple[Motion, float] | None:
    """A short rigid motion that brings a body from `positions` (N, 3) out of all colliders, and how far it moves the
    farthest particle [m].

    Rigid, as that strains nothing. It is the best of motions along, or towards, the main axes of the body and of the
    world. Of motions of about the same length it is the one that leads most `up` (3,). None where fixed particles allow
    none or it would be too long: what is wrapped around a collider shall not be pulled off it.
    """
    values, axes = np.linalg.eigh(np.cov(positions.T))
    ways = sorted((*axes.T, *-axes.T, *np.eye(3), *-np.eye(3)), key=lambda way: -round(float(way @ up), 6))
    size = float(np.linalg.norm(np.ptp(positions, axis=0)))
    limit = size if values[0] <= _LITTLE**2 * values[2] else _FARTHEST * depth.at(positions)
    best = None
    for path in _paths(positions, depth.fixed, ways):
        length = 0.0
        for _ in range(_STEPS):
            if length >= limit:
                break
            deep = depth.at(moved(positions, path(length)))
            if deep == 0.0:
                best, limit = (path(length), length), _SHORTER * length
                break
            length += max(deep, _LITTLE * size)  # no particle goes farther, so the deepest is not out before
    return best


def _paths(x: np.ndarray, fixed: np.ndarray, ways: list[np.ndarray]) -> Iterator[Callable[[float], Motion]]:
    """Functions of the way of the farthest particle [m]: rigid motions of particles at `x` (N, 3) along `ways`.

    Where some are fixed they are turns about the point or line in which all of these lie.
    """
    if not fixed.any():
        for way in ways:
            yield lambda length, way=way: ((0.0, 0.0, 0.0, 1.0), length * way)
        return
    middle = x[fixed].mean(axis=0)
    values, axes = np.linalg.eigh((x[fixed] - middle).T @ (x[fixed] - middle))
    tiny = (1e-6 * np.ptp(x, axis=0).max()) ** 2
    if values[1] > tiny:
        return
    turns = [np.cross(x.mean(axis=0) - middle, way) for way in ways]
    if values[2] > tiny:
        line = math.copysign(1.0, axes[:, 2] @ turns[0]) * axes[:, 2]
        turns = [line, -line]
    for turn in turns:
        axis = turn / max(float(np.linalg.norm(turn)), 1e-30)
        radius = float(np.linalg.norm(np.cross(axis, x - middle), axis=1).max())
        if radius**2 > tiny:
            yield lambda length, axis=axis, radius=radius: _turn(axis, length / radius, middle)


def _turn(axis: np.ndarray, angle: float, about: np.ndarray) -> Motion:
    turn = (*(math.sin(0.5 * angle) * axis).tolist(), math.cos(0.5 * angle))
    return turn, about - rotate(turn, about)
