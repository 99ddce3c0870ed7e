# SPDX-License-Identifier: Apache-2.0
"""Worlds that differ: live parameters and poses drawn from distributions, the same for the same seed."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from numbers import Integral
from typing import Any

import numpy as np

from cloth_sim_ros.parameters import shown
from cloth_sim_ros.sim.simulation import Simulation

_POSE = ("position", "orientation")


def _normal(first: np.ndarray, second: np.ndarray, u: np.ndarray) -> np.ndarray:
    """By Box and Muller (1958), which takes the same number of draws for every value."""
    return first + second * np.sqrt(-2.0 * np.log1p(-u[..., 0])) * np.cos(2.0 * np.pi * u[..., 1])


# Name -> values from two numbers or vectors and two uniform draws in [0, 1) each.
DISTRIBUTIONS: dict[str, Callable] = {
    "uniform": lambda low, high, u: low + (high - low) * u[..., 0],  # low, high
    "log_uniform": lambda low, high, u: low * (high / low) ** u[..., 0],  # low, high
    "normal": _normal,  # mean, standard deviation
    "log_normal": lambda median, spread, u: median * np.exp(_normal(0.0, spread, u)),  # median, deviation of the log
}


class Variation:
    """Distributions by name of a live parameter, or of the "position" or "orientation" of anything in the scene.

    vary: such as {"cloth.stretch_compliance": {"log_uniform": [1e-4, 1e-2]}, "wind.velocity": {"normal": [[1, 0, 0],
    0.5]}}; a name of DISTRIBUTIONS with its two numbers, or vectors as long as the parameter. Orientations are scaled
    to length 1, so a normal distribution of mean 0 gives any orientation. An object with a "scale" is restarted.
    Raises ValueError for a name or a distribution that is not allowed.
    """

    def __init__(self, vary: Mapping[str, Mapping[str, Any]], seed: int = 0) -> None:
        if not isinstance(vary, Mapping):
            raise ValueError(f"vary is {vary!r}; allowed is a mapping of name to distribution")
        if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
            raise ValueError(f"seed is {seed!r}; allowed is a whole number of at least 0")
        self.seed, self._vary = seed, {name: _checked(name, spec) for name, spec in vary.items()}

    def draw(self, lengths: Mapping[str, int], worlds: int, episode: int = 0) -> dict[str, np.ndarray]:
        """Draw name -> values (worlds, length) float64.

        The values of a world depend only on the seed, the name, the episode and the number of the world. They do not
        depend on other variations or on the number of worlds.
        """
        found = {}
        for name, (kind, first, second) in self._vary.items():
            seed = np.random.SeedSequence([self.seed, episode, zlib.crc32(name.encode())])
            u = np.random.default_rng(seed).random((worlds, lengths[name], 2))
            if any(part.ndim and part.shape != (lengths[name],) for part in (first, second)):
                raise ValueError(f"vary.{name} has vectors of another length; allowed are {lengths[name]} numbers")
            found[name] = DISTRIBUTIONS[kind](first, second, u)
        return found

    def apply(self, sim: Simulation, mask: Any = None, episode: int = 0) -> dict[str, np.ndarray]:
        """Draw for all worlds, and set the values in those of a mask (worlds,) of bool, or in all for None.

        Returns name -> (worlds,) or (worlds, length). Call it after a reset, as colliders, handles and objects are at
        their poses at once. If handles or objects moved or changed scale, initially attached handles grasp again.

        Raises ValueError for a name that the scene does not have, or a value that is not allowed.
        """
        if not isinstance(episode, Integral) or episode < 0:
            raise ValueError(f"episode is {episode!r}; allowed is a whole number, 0 or more")
        now = {name: _now(sim, name) for name in self._vary}
        drawn = self.draw({name: np.size(value) for name, value in now.items()}, sim.worlds, episode)
        values = {name: rows if np.ndim(now[name]) else rows[:, 0] for name, rows in drawn.items()}
        placed = _placed(sim)
        moved = dict.fromkeys(_owner(name, placed) for name in values if _owner(name, placed))
        for name, rows in values.items():
            if not _owner(name, placed):
                sim.set(name, rows, mask)
        for owner in moved:
            parts = [values.get(f"{owner}.{part}", getattr(placed[owner], part)) for part in _POSE]
            pose = np.column_stack([np.broadcast_to(part, (sim.worlds, np.shape(part)[-1])) for part in parts])
            sim.write(owner, "pose", pose, mask, sweep=False)
        resized = {name.removesuffix(".scale") for name in values if name.endswith(".scale")}  # they start anew
        if {*moved, *resized} & {*sim.scene.objects, *sim.scene.handles}:
            holding = [name for name, handle in sim.scene.handles.items() if handle.attached]
            for on in (False, True):  # as a reset does: what one has let go, another may grasp
                for name in holding:
                    sim.set(f"{name}.attached", on, mask)
        return values


def _placed(sim: Simulation) -> dict[str, Any]:
    """Name -> object, collider or handle with a position and an orientation."""
    return {**sim.scene.objects, **sim.scene.colliders, **sim.scene.handles}


def _owner(name: str, placed: Mapping[str, Any]) -> str:
    """Owner of the pose that `name` is part of, or "" if it is none."""
    owner, _, part = name.rpartition(".")
    return owner if part in _POSE and owner in placed else ""


def _now(sim: Simulation, name: str) -> Any:
    """The value of what varies in world 0, or where the scene puts it; only how long it is counts."""
    placed = _placed(sim)
    owner = _owner(name, placed)
    return getattr(placed[owner], name.rpartition(".")[2]) if owner else sim.get(name)


def _checked(name: str, spec: Any) -> tuple[str, np.ndarray, np.ndarray]:
    """The distribution of a parameter and its two numbers or vectors; YAML takes 1e-3 for text."""
    try:
        ((kind, parts),) = spec.items()
        first, second = (np.asarray(part, dtype=np.float64) for part in parts)
        logs = kind.startswith("log")
        fits = kind in DISTRIBUTIONS and max(first.ndim, second.ndim) < 2
        fits = fits and bool(np.isfinite(first).all() and np.isfinite(second).all())
        if kind.endswith("uniform"):
            fits = fits and bool((first <= second).all())
        else:
            fits = fits and bool((second >= 0.0).all())
        if not fits or (logs and not (first > 0.0).all()):
            raise ValueError
    except (AttributeError, TypeError, ValueError):
        raise ValueError(
            f"vary.{name} is {shown(spec)}; allowed is one of {', '.join(DISTRIBUTIONS)} with [low, high] or [middle, "
            f"spread], above 0 for logarithms"
        ) from None
    return kind, first, second
