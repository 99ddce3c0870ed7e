# SPDX-License-Identifier: Apache-2.0
"""A towel on a table, held at two corners: fold it in half."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from cloth_sim_ros.learn.task import Setup, Task
from cloth_sim_ros.sim import Cloth, Handle, Plane, Scene

SIDE, PARTICLES = 0.4, 10  # [m], along an edge
HANDS = {"left": (-0.5 * SIDE, 0.5 * SIDE), "right": (0.5 * SIDE, 0.5 * SIDE)}  # first x, y [m]
STEP = 0.025  # [m] largest move of a hand in a step, along each axis
FRAMES = 2  # of a step
HORIZON = 32  # steps of an episode
FOLDED = 0.1 * SIDE  # [m] mean distance from the wanted fold, below which it is done
VARY = {
    "towel.stretch_compliance": {"log_uniform": [5e-4, 5e-3]},
    "towel.bend_compliance": {"log_uniform": [5e2, 2e4]},
    "towel.kinetic_friction": {"uniform": [0.3, 0.7]},
    "towel.static_friction": {"uniform": [0.7, 0.9]},
    "gravity": {"normal": [[0, 0, -9.81], [0.1, 0.1, 0.0]]},  # a table that is not quite level
}
_REST = 0.006  # [m] height of the towel on the table
_SEEN = 3  # every so many particles along an edge are observed


class FoldTowel(Task):
    """`num_envs` towels, each in a world of its own, see Task; `vary` is as for a Variation.

    Actions are (num_envs, 6): the left and the right hand. Observations are (num_envs, 54): both hands and a grid of 4
    x 4 particles. The distance is the mean one of particles from the wanted fold.
    """

    @staticmethod
    def make() -> Setup:
        """See Task."""
        return Setup(
            scene=_scene(),
            thing="towel",
            hands={name: (*place, _REST) for name, place in HANDS.items()},
            low=(-0.4, -0.4, _REST),
            high=(0.4, 0.4, 0.4),
            step=STEP,
            frames=FRAMES,
            horizon=HORIZON,
            seen=np.arange(PARTICLES**2).reshape(PARTICLES, PARTICLES)[::_SEEN, ::_SEEN].ravel(),
            size=SIDE,
            lets_go=False,
            vary=VARY,
        )

    @cached_property
    def _wanted(self) -> np.ndarray:
        """Positions (N, 3) [m] of the particles of a folded towel."""
        rest = self.sim.rest_positions("towel").reshape(PARTICLES, PARTICLES, 3)
        lower = np.minimum(np.arange(PARTICLES), PARTICLES - 1 - np.arange(PARTICLES))
        return rest[lower].reshape(-1, 3)

    def judge(self, places: np.ndarray, opened: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See Task."""
        distance = np.linalg.norm(places - self._wanted, axis=2).mean(axis=1)
        return distance, distance < FOLDED


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
