# SPDX-License-Identifier: Apache-2.0
"""One world of a task as an ordinary `gymnasium.Env`, for `gymnasium.make`."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from cloth_sim_ros.learn.task import Task


class Single(gymnasium.Env):
    """The only world of `task` with its `options`, which steps like the first world of many.

    After an episode has ended, `reset` begins the next one. infos has "distance" [m] and "success" as numbers.
    """

    metadata = {"render_modes": Task.metadata["render_modes"]}

    def __init__(self, task: type[Task], **options: Any) -> None:
        self._task = task(1, **options)
        self.render_mode = self._task.render_mode
        setup, frame_dt = self._task.setup, self._task.setup.settings.frame_dt
        self.metadata = {**self.metadata, "render_fps": round(1.0 / (setup.frames * frame_dt))}
        self.action_space = self._task.single_action_space
        self.observation_space = self._task.single_observation_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """See gymnasium.Env."""
        super().reset(seed=seed)
        observations, infos = self._task.reset(seed=seed, options=options)
        return observations[0], _first(infos)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """See gymnasium.Env."""
        observations, rewards, terminated, truncated, infos = self._task.step(np.asarray(action)[None])
        return observations[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), _first(infos)

    def render(self) -> np.ndarray | None:
        """Return a picture (480, 640, 3) uint8; None without render_mode."""
        pictures = self._task.render()
        return None if pictures is None else pictures[0]

    def close(self) -> None:
        """See gymnasium.Env."""
        self._task.close()


def _first(infos: dict[str, np.ndarray]) -> dict[str, Any]:
    return {name: values[0].item() for name, values in infos.items()}
