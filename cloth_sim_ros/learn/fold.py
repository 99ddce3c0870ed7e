# SPDX-License-Identifier: Apache-2.0
"""A towel on a table, held at two corners: fold it in half."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from cloth_sim_ros.sim import Cloth, Handle, Plane, Scene, Settings, Simulation, Variation

SIDE, PARTICLES = 0.4, 10  # [m], along an edge
HANDS = {"left": (-0.5 * SIDE, 0.5 * SIDE), "right": (0.5 * SIDE, 0.5 * SIDE)}  # x, y [m] where they begin
STEP = 0.025  # [m] that a hand moves in a step at most, along each axis
FRAMES = 2  # of a step
HORIZON = 32  # steps of an episode
FOLDED = 0.1 * SIDE  # [m] mean distance from the fold that is wanted, below which it is there
VARY = {
    "towel.stretch_compliance": {"log_uniform": [5e-4, 5e-3]},
    "towel.bend_compliance": {"log_uniform": [5e2, 2e4]},
    "towel.kinetic_friction": {"uniform": [0.3, 0.7]},
    "towel.static_friction": {"uniform": [0.7, 0.9]},
    "gravity": {"normal": [[0, 0, -9.81], [0.1, 0.1, 0.0]]},  # a table that is not quite level
}
_REST = 0.006  # [m] height of the towel on the table
_LOW, _HIGH = np.array([-0.4, -0.4, _REST]), np.array([0.4, 0.4, 0.4])  # [m] where hands may go
_SEEN = 3  # every so many particles along an edge are observed


class FoldTowel(VectorEnv):
    """`num_envs` towels, each in a world of its own.

    Actions (num_envs, 6) in -1 to 1 move the left and the right hand along x, y, z by up to STEP. Observations
    (num_envs, 54) are where both hands and a grid of 4 x 4 particles are [m]. The reward of a step is minus the mean
    distance of particles from the fold that is wanted, over the side of the towel, and 1 more where it is folded. infos
    has "distance" [m] and "success" (num_envs,). An episode is truncated after HORIZON steps, and terminated where a
    world was put back. The step after that starts it anew, with other numbers of what varies; `vary` is as for a
    Variation.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(self, num_envs: int = 1, device: str = "auto", vary: Mapping[str, Any] | None = None) -> None:
        self.num_envs = num_envs
        self.single_action_space = spaces.Box(-1.0, 1.0, (6,), np.float32)
        self.single_observation_space = spaces.Box(-np.inf, np.inf, (54,), np.float32)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._vary = dict(VARY if vary is None else vary)
        self.sim = Simulation(_scene(), Settings(method="xpbd", order=1, substeps=12, iterations=1), device, num_envs)
        rest = self.sim.rest_positions("towel").reshape(PARTICLES, PARTICLES, 3)
        lower = np.minimum(np.arange(PARTICLES), PARTICLES - 1 - np.arange(PARTICLES))
        self._wanted = rest[lower].reshape(-1, 3)
        self._seen = np.arange(PARTICLES**2).reshape(PARTICLES, PARTICLES)[::_SEEN, ::_SEEN].ravel()
        self._start = np.array([[*place, _REST] for place in HANDS.values()])
        self._hands = np.tile(self._start, (num_envs, 1, 1))
        self._steps = np.zeros(num_envs, dtype=int)
        self._done = np.zeros(num_envs, dtype=bool)
        self._episodes = np.zeros(num_envs, dtype=int)
        self._variation = Variation(self._vary)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """All towels anew, with what varies drawn from a seed; without one, from that of last time."""
        if seed is not None:
            self._variation, self._episodes[:] = Variation(self._vary, seed), 0
        self._begin(np.ones(self.num_envs, dtype=bool))
        self._done[:] = False
        return self._observation(), self._info()[1]

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """See gymnasium.vector.VectorEnv."""
        moves = np.clip(np.asarray(actions, dtype=np.float64), -1.0, 1.0).reshape(self.num_envs, 2, 3)
        anew = self._done
        goal = np.clip(self._hands + STEP * moves, _LOW, _HIGH)
        bad = np.zeros(self.num_envs, dtype=bool)
        if anew.any():
            self._begin(anew)
        goal[anew] = self._start
        for frame in range(FRAMES):
            places = self._hands + (frame + 1) / FRAMES * (goal - self._hands)
            for k, name in enumerate(HANDS):
                upright = np.tile([0.0, 0.0, 0.0, 1.0], (self.num_envs, 1))
                self.sim.write(name, "pose", np.concatenate([places[:, k], upright], axis=1))
            self.sim.step()
            bad |= self.sim.recovered()
        self._hands = goal
        self._steps = np.where(anew, 0, self._steps + 1)
        distance, info = self._info()
        rewards = np.where(anew, 0.0, info["success"] - np.float64(distance) / SIDE)
        truncated = self._steps >= HORIZON
        self._done = bad | truncated
        return self._observation(), rewards, bad, truncated & ~bad, info

    def _begin(self, mask: np.ndarray) -> None:
        """Another episode in the worlds of a mask."""
        self.sim.reset(mask)
        for episode in np.unique(self._episodes[mask]):  # of each world, whenever others begin theirs
            self._variation.apply(self.sim, mask & (self._episodes == episode), int(episode))
        self._episodes[mask] += 1
        self._hands[mask], self._steps[mask] = self._start, 0

    def _observation(self) -> np.ndarray:
        places = self.sim.tensor("towel", "positions").numpy()[:, self._seen]
        rows = [self._hands.reshape(self.num_envs, -1), places.reshape(self.num_envs, -1)]
        return np.concatenate(rows, axis=1).astype(np.float32)

    def _info(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        off = self.sim.tensor("towel", "positions").numpy() - self._wanted
        distance = np.linalg.norm(off, axis=2).mean(axis=1)
        return distance, {"distance": distance, "success": distance < FOLDED}


def _scene() -> Scene:
    towel = Cloth(
        resolution=(PARTICLES, PARTICLES),
        size=(SIDE, SIDE),
        mass=0.05,
        pins=None,
        position=(0, 0, _REST),
        bending="dihedral",
        stretch_compliance=2e-3,
        shear_compliance=1e-2,
        bend_compliance=3e3,
        damping=2e-3,
        thickness=0.005,
    )
    hands = {
        name: Handle(position=(*place, _REST), reach=0.02, attached=True, compliance=1e-3)
        for name, place in HANDS.items()
    }
    return Scene({"towel": towel}, {"table": Plane(static_friction=0.8, kinetic_friction=0.6)}, handles=hands)
