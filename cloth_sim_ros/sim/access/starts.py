# SPDX-License-Identifier: Apache-2.0
"""Preparation of starts that are far from rest, or inside a collider."""

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
_STEPS = 100  # largest number of steps along a way out
_LITTLE = 1e-3  # fraction of an object's size: the shortest step, and the thickness below which it is planar
_FARTHEST = 3.0  # longest way out of an object that is not planar, in multiples of its depth
_SHORTER = 0.95  # fraction of the shortest way so far; a better way must be shorter than this
_NUDGE = 1e-5  # largest nudge as a fraction of the mean rest length of the springs
_TURNS = np.array([[1.93, -0.71, 0.37], [0.53, 2.11, -0.83], [-0.61, 0.47, 1.79]])  # wave vectors without symmetry


def is_strained(topology: Topology, positions: np.ndarray, torn: Mapping[str, np.ndarray]) -> bool:
    """True if positions (N, 3) [m] strain a spring that is not torn by more than STRAINED. torn: kind -> (S,) bool."""
    for kind, elements in topology.springs.items():
        length = np.linalg.norm(positions[elements.particles[:, 1]] - positions[elements.particles[:, 0]], axis=1)
        if ((np.abs(length - elements.rest) > STRAINED * elements.rest) & ~torn.get(kind, np.False_)).any():
            return True
    return False


def off_symmetry(topology: Topology, positions: np.ndarray, scale: float) -> np.ndarray:
    """Return positions (N, 3) [m] with free particles nudged by about a hundred-thousandth of a spring's length.

    A start may be a mirror image of itself, such as a grid that is stretched or inverted about its middle. The motion
    keeps that symmetry exactly, and may come to rest where only the symmetry holds it. Then a cell in the middle is
    inverted, with springs strained by half. The nudge is a smooth function of position, so coincident particles stay
    coincident.
    """
    spacing = scale * np.concatenate([elements.rest for elements in topology.springs.values()]).mean()
    way = np.sin(positions / spacing @ _TURNS.T + [0.3, 1.1, 2.3])
    return np.where(topology.pinned[:, None], positions, positions + _NUDGE * spacing * way)


class Depth:
    """Depth of a body's surface in `colliders`, rows of ColliderMotion, for any positions of its particles.

    fixed (N,) bool: True for particles that a pin, a drum or a handle holds.
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
        """The max_penetration [m] of `report` with particles at `positions` (N, 3)."""
        self._rows.assign(np.column_stack([positions, self._inverse]).astype(np.float32))
        self._result.zero_()
        inputs, dim = [self._arrays, self._body, self._result], self._panels.stop - self._panels.start
        wp.launch(self._kernel, dim=dim, inputs=inputs, device=self._result.device)
        return float(self._result.numpy()[PARTICLES:].max())


def way_out(positions: np.ndarray, depth: Depth, up: np.ndarray) -> tuple[Motion, float] | None:
    """Find a short rigid motion of a body from `positions` (N, 3) out of all colliders.

    Returns the motion and the largest distance that a particle moves [m]. A rigid motion strains nothing. The search
    tries motions along, or towards, the main axes of the body and of the world. Among motions of about the same length
    it prefers the one most along `up` (3,). Returns None if fixed particles allow no motion, or if it would be too
    long. So an object wrapped around a collider is not pulled off it.
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
            length += max(deep, _LITTLE * size)  # no particle moves farther, so the deepest cannot be out before
    return best


def _paths(x: np.ndarray, fixed: np.ndarray, ways: list[np.ndarray]) -> Iterator[Callable[[float], Motion]]:
    """Yield functions from the distance of the farthest particle [m] to rigid motions of `x` (N, 3) along `ways`.

    With fixed particles, the motions are rotations about the point or line that holds all fixed particles.
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
