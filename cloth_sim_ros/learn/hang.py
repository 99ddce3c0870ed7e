# SPDX-License-Identifier: Apache-2.0
"""A towel that hangs from a hand: carry it over a peg and let it go, so that it stays."""

from __future__ import annotations

import numpy as np

from cloth_sim_ros.learn.task import Setup, Task
from cloth_sim_ros.sim import Capsule, Cloth, Handle, Plane, Scene

LENGTH, WIDTH, ALONG, ACROSS = 0.4, 0.2, 11, 6  # [m] of the towel, and its particles
PEG = (0.0, 0.0, 0.5)  # [m] its middle; it points along y
FLOOR = -0.3  # [m] height at which a towel that has fallen lies
HAND = (-0.1, 0.0, 0.5)  # [m] where it begins
STEP = 0.05  # [m] largest move of a hand in a step, along each axis
FRAMES, HORIZON = 3, 40  # of a step; steps of an episode
HANGS = (0.0, 0.0, 0.437)  # [m] the middle of a towel that hangs over the peg by half
NEAR, STAYS = 0.1, 10  # done if this near [m], so many steps after it was let go: else it would have fallen
VARY = {
    "towel.stretch_compliance": {"log_uniform": [5e-4, 5e-3]},
    "towel.bend_compliance": {"log_uniform": [5e2, 2e4]},
    "towel.kinetic_friction": {"uniform": [0.3, 0.6]},
    "towel.static_friction": {"uniform": [0.6, 0.8]},
    "gravity": {"normal": [[0, 0, -9.81], [0.1, 0.1, 0.0]]},
}
_HALF = np.sqrt(0.5)


class HangTowel(Task):
    """`num_envs` towels, each in a world of its own, see Task; `vary` is as for a Variation.

    Actions are (num_envs, 4): the hand, which holds the middle of the towel's upper edge, and the number that lets it
    go. Observations are (num_envs, 40): the hand, 1 or 0 for its hold, and 4 x 3 particles. The distance is that of the
    towel's middle from its place when it hangs over the peg by half.
    """

    @staticmethod
    def make() -> Setup:
        """See Task."""
        towel = Cloth(
            resolution=(ACROSS, ALONG),
            size=(WIDTH, LENGTH),
            mass=0.05,
            pins=None,
            position=(HAND[0], 0.0, HAND[2] - 0.5 * LENGTH),
            orientation=(0.5, 0.5, 0.5, 0.5),  # upright, its upper edge along y
            bending="dihedral",
            stretch_compliance=2e-3,
            shear_compliance=1e-2,
            bend_compliance=3e3,
            damping=2e-3,
            thickness=0.005,
        )
        peg = Capsule(
            radius=0.02,
            half_length=0.2,
            position=PEG,
            orientation=(_HALF, 0.0, 0.0, _HALF),
            static_friction=0.6,
            kinetic_friction=0.5,
        )
        floor = Plane(position=(0.0, 0.0, FLOOR))
        hand = Handle(position=HAND, reach=(0.02, 0.5 * WIDTH, 0.02), attached=True, compliance=1e-3)
        return Setup(
            scene=Scene({"towel": towel}, {"peg": peg, "floor": floor}, handles={"hand": hand}),
            thing="towel",
            hands={"hand": HAND},
            low=(-0.3, -0.3, 0.2),
            high=(0.3, 0.3, 0.9),
            step=STEP,
            frames=FRAMES,
            horizon=HORIZON,
            seen=np.arange(ACROSS * ALONG).reshape(ALONG, ACROSS)[::3, ::2].ravel(),
            size=LENGTH,
            lets_go=True,
            vary=VARY,
        )

    def judge(self, places: np.ndarray, opened: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See Task."""
        distance = np.linalg.norm(places.mean(axis=1) - np.float32(HANGS), axis=1)
        return distance, (distance < NEAR) & (opened[:, 0] >= STAYS)
