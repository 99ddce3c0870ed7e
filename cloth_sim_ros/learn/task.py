# SPDX-License-Identifier: Apache-2.0
"""Base of all tasks: one object in many worlds, hands that move and may let go, episodes, rewards and pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from cloth_sim_ros.sim import Scene, Settings, Simulation, Variation

_UPRIGHT = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Setup:
    """A scene with an object called `thing` and `hands`: handle -> its first position, x y z [m].

    low, high (3,): range of the hands [m]; step: largest move along each axis in one step [m]; frames: those of a step;
    horizon: steps of an episode. seen: particles that are observed; size [m]: divisor of distances in rewards. lets_go:
    True if hands can let go, which they do once in an episode. vary: as for a Variation.
    """

    scene: Scene
    thing: str
    hands: dict[str, tuple[float, float, float]]
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    step: float
    frames: int
    horizon: int
    seen: np.ndarray
    size: float
    lets_go: bool
    vary: Mapping[str, Any]
    settings: Settings = Settings(method="xpbd", order=1, substeps=12, iterations=1)


class Task(VectorEnv):
    """`num_envs` worlds of a setup. A subclass makes the setup, and judges the distance of each world from its goal.

    Actions (num_envs, A) in -1 to 1 move each hand along x, y, z; if hands can let go, a fourth number below -0.5 does
    so. Observations are the positions of the hands [m], 1 or 0 for their hold if they can let go, and the positions of
    the seen particles [m]. The reward of a step is minus the distance over the size, and 1 more if the task is done.
    infos has "distance" [m] and "success" (num_envs,).

    An episode is truncated at the horizon, and terminated if a world was put back. The step after that restarts it with
    other varied numbers. `vary` replaces the setup's. With render_mode "rgb_array", `render` paints each world (480,
    640, 3). Raises ValueError for another render_mode.
    """

    metadata = {"render_modes": ["rgb_array"], "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(
        self,
        num_envs: int = 1,
        device: str = "auto",
        vary: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode is {render_mode!r}; allowed is None or 'rgb_array'")
        setup = self.make()
        self.setup, self.num_envs, self.render_mode = setup, num_envs, render_mode
        hands, each = len(setup.hands), 3 + setup.lets_go
        self.single_action_space = spaces.Box(-1.0, 1.0, (hands * each,), np.float32)
        count = hands * each + 3 * len(setup.seen)
        self.single_observation_space = spaces.Box(-np.inf, np.inf, (count,), np.float32)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._vary = dict(setup.vary if vary is None else vary)
        self.sim = Simulation(setup.scene, setup.settings, device, num_envs)
        self._start = np.array(list(setup.hands.values()))
        self._hands = np.tile(self._start, (num_envs, 1, 1))
        self._open = np.zeros((num_envs, hands), dtype=int)  # steps since a hand let go
        self._steps = np.zeros(num_envs, dtype=int)
        self._done = np.zeros(num_envs, dtype=bool)
        self._episodes = np.zeros(num_envs, dtype=int)
        self._variation = Variation(self._vary)

    @staticmethod
    def make() -> Setup:
        """Return the scene, and the abilities of its hands."""
        raise NotImplementedError

    def judge(self, places: np.ndarray, opened: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the distance (num_envs,) [m] of each world from its goal, and True (num_envs,) if it is done.

        places (num_envs, N, 3) [m]: positions of the particles. opened (num_envs, H): steps since each hand let go, or
        0.
        """
        raise NotImplementedError

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Restart all worlds, with varied numbers drawn from `seed`; None keeps the last seed."""
        if seed is not None:
            self._variation, self._episodes[:] = Variation(self._vary, seed), 0
        self._begin(np.ones(self.num_envs, dtype=bool))
        self._done[:] = False
        places = self._places()
        return self._observation(places), self._info(places)

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """See gymnasium.vector.VectorEnv."""
        actions = np.clip(np.asarray(actions, dtype=np.float64), -1.0, 1.0).reshape(self.num_envs, len(self._start), -1)
        anew = self._done
        goal = np.clip(self._hands + self.setup.step * actions[..., :3], self.setup.low, self.setup.high)
        if anew.any():
            self._begin(anew)
        goal[anew] = self._start
        if self.setup.lets_go:
            self._let_go((actions[..., 3] < -0.5) & ~anew[:, None])
        bad = self._move(goal)
        self._steps = np.where(anew, 0, self._steps + 1)
        places = self._places()
        info = self._info(places)
        rewards = np.where(anew, 0.0, info["success"] - np.float64(info["distance"]) / self.setup.size)
        truncated = self._steps >= self.setup.horizon
        self._done = bad | truncated
        return self._observation(places), rewards, bad, truncated & ~bad, info

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return a picture (480, 640, 3) uint8 of each world; None without render_mode."""
        if self.render_mode is None:
            return None
        from cloth_sim_ros.learn.picture import pictures  # matplotlib is slow to import

        return pictures(self.sim, self._hands)

    def _let_go(self, wanted: np.ndarray) -> None:
        for k, name in enumerate(self.setup.hands):
            leaves = wanted[:, k] & (self._open[:, k] == 0)
            if leaves.any():
                self.sim.release(name, leaves)
        self._open += wanted | (self._open > 0)

    def _move(self, goal: np.ndarray) -> np.ndarray:
        """Move hands to `goal` (num_envs, H, 3) in a step; return True (num_envs,) for worlds that were put back."""
        bad = np.zeros(self.num_envs, dtype=bool)
        upright = np.tile(_UPRIGHT, (self.num_envs, 1))
        for frame in range(self.setup.frames):
            places = self._hands + (frame + 1) / self.setup.frames * (goal - self._hands)
            for k, name in enumerate(self.setup.hands):
                self.sim.write(name, "pose", np.concatenate([places[:, k], upright], axis=1))
            self.sim.step()
            bad |= self.sim.recovered()
        self._hands = goal
        return bad

    def _begin(self, mask: np.ndarray) -> None:
        """Begin another episode in the worlds of a mask."""
        self.sim.reset(mask)
        for episode in np.unique(self._episodes[mask]):  # of each world, whenever others begin theirs
            self._variation.apply(self.sim, mask & (self._episodes == episode), int(episode))
        self._episodes[mask] += 1
        self._hands[mask], self._steps[mask], self._open[mask] = self._start, 0, 0

    def _places(self) -> np.ndarray:
        return self.sim.tensor(self.setup.thing, "positions").numpy()

    def _observation(self, places: np.ndarray) -> np.ndarray:
        rows = [self._hands, (self._open == 0)[:, :, None]] if self.setup.lets_go else [self._hands]
        hands = np.concatenate(rows, axis=2).reshape(self.num_envs, -1)
        seen = places[:, self.setup.seen].reshape(self.num_envs, -1)
        return np.concatenate([hands, seen], axis=1).astype(np.float32)

    def _info(self, places: np.ndarray) -> dict[str, np.ndarray]:
        distance, success = self.judge(places, self._open)
        return {"distance": distance, "success": success}
