# SPDX-License-Identifier: Apache-2.0
"""What all tasks share: one object in many worlds, hands that move and may let go, episodes, rewards and pictures."""

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
    """A scene with an object called `thing` and `hands`: handle -> where it begins, x y z [m].

    low, high (3,): where hands may go [m]; step: how far along each axis in one step at most [m]; frames of a step;
    horizon: steps of an episode. seen: particles that are observed; size [m], by which distances are divided in
    rewards. lets_go: whether hands can let go, which they do once in an episode. vary: as for a Variation.
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
    """`num_envs` worlds of the setup that a subclass makes, which also judges how far each is from what is wanted.

    Actions (num_envs, A) in -1 to 1 move each hand along x, y, z; where hands can let go, a fourth number below -0.5
    does so. Observations are where the hands are [m], whether they hold where they can let go, and where the particles
    seen are [m]. The reward of a step is minus the distance over the size, and 1 more where it is done. infos has
    "distance" [m] and "success" (num_envs,). An episode is truncated at the horizon, and terminated where a world was
    put back. The step after that starts it anew, with other numbers of what varies; `vary` takes the place of the
    setup's. With render_mode "rgb_array",
    `render` paints each world (480, 640, 3).
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
        """What there is, and what hands can do."""
        raise NotImplementedError

    def judge(self, places: np.ndarray, opened: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """From particles (num_envs, N, 3) [m] and for how many steps each hand has been open (num_envs, H): the
        distance (num_envs,) [m] from what is wanted, and whether it is done (num_envs,)."""
        raise NotImplementedError

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """All worlds anew, with what varies drawn from a seed; without one, from that of last time."""
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
        """A picture (480, 640, 3) uint8 of each world; None without render_mode."""
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
        """Hands go to `goal` (num_envs, H, 3) in a step; which worlds were put back (num_envs,)."""
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
        """Another episode in the worlds of a mask."""
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
