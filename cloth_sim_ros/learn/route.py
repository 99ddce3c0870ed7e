# SPDX-License-Identifier: Apache-2.0
"""A cable on a table, fixed at one end and held at the other: lay it around pegs."""

from __future__ import annotations

from functools import cache

import numpy as np

from cloth_sim_ros.learn.task import Setup, Task
from cloth_sim_ros.sim import Capsule, Handle, Plane, Rope, Scene

LENGTH, SEGMENTS, RADIUS = 0.9, 36, 0.005  # [m], of the cable
PEGS = {"first": (0.2, 1), "second": (0.4, -1), "third": (0.6, 1)}  # x [m], and on which side along y the cable goes
HAND = (0.0, LENGTH, RADIUS)  # [m] where it begins; the fixed end is at the origin
STEP = 0.06  # [m] largest move of a hand in a step, along each axis
FRAMES, HORIZON = 3, 50  # of a step; steps of an episode
LAID = 0.05  # [m] mean distance from the route, below which it is done
VARY = {
    "cable.stretch_compliance": {"log_uniform": [1e-5, 1e-3]},
    "cable.bend_compliance": {"log_uniform": [5e1, 1e3]},
    "cable.kinetic_friction": {"uniform": [0.2, 0.4]},
    "cable.static_friction": {"uniform": [0.4, 0.6]},
    "gravity": {"normal": [[0, 0, -9.81], [0.1, 0.1, 0.0]]},
}
_PEG, _BESIDE = 0.02, 0.025  # [m] radius of a peg; from its middle to the cable


class RouteCable(Task):
    """`num_envs` cables, each in a world of its own, see Task; `vary` is as for a Variation.

    Actions are (num_envs, 3): the hand at the cable's free end. Observations are (num_envs, 33): the hand and every
    fourth particle. The distance is the mean one of particles from their places along the route. A world is done if
    that is small and the cable passes the pegs one after the other, each on its side.
    """

    @staticmethod
    def make() -> Setup:
        """See Task."""
        cable = Rope(
            segments=SEGMENTS,
            start=(0.0, 0.0, RADIUS),
            end=HAND,
            mass=0.05,
            radius=RADIUS,
            pins="start",
            stretch_compliance=1e-4,
            bend_compliance=2e2,
            damping=2e-3,
        )
        peg = {"radius": _PEG, "half_length": 0.05, "static_friction": 0.3, "kinetic_friction": 0.2}
        pegs = {name: Capsule(position=(x, 0.0, 0.03), **peg) for name, (x, _) in PEGS.items()}
        hand = Handle(position=HAND, reach=0.01, attached=True, compliance=2e-2)
        table = Plane(static_friction=0.5, kinetic_friction=0.3)
        return Setup(
            scene=Scene({"cable": cable}, {"table": table, **pegs}, handles={"hand": hand}),
            thing="cable",
            hands={"hand": HAND},
            low=(-0.2, -0.5, RADIUS),
            high=(0.9, 1.0, 0.1),
            step=STEP,
            frames=FRAMES,
            horizon=HORIZON,
            seen=np.arange(0, SEGMENTS + 1, 4),
            size=LENGTH,
            lets_go=False,
            vary=VARY,
        )

    def judge(self, places: np.ndarray, opened: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See Task."""
        distance = np.linalg.norm(places - route(), axis=2).mean(axis=1)
        return distance, (distance < LAID) & passes(places)


def passes(places: np.ndarray) -> np.ndarray:
    """Return True (worlds,) for cables (worlds, N, 3) that pass each peg once, in their order and on their side."""
    found, last = np.ones(len(places), dtype=bool), np.full(len(places), -1)
    rows = np.arange(len(places))
    for x, side in PEGS.values():
        beyond = places[:, :, 0] > x
        crossed = beyond[:, 1:] != beyond[:, :-1]
        first = crossed.argmax(axis=1)
        a, b = places[rows, first], places[rows, first + 1]
        share = (x - a[:, 0]) / np.where(b[:, 0] == a[:, 0], 1.0, b[:, 0] - a[:, 0])
        y = a[:, 1] + share * (b[:, 1] - a[:, 1])
        found &= (crossed.sum(axis=1) == 1) & (first >= last) & (side * y > 0.0)
        last = first
    return found


@cache
def route() -> np.ndarray:
    """Return the positions (N, 3) [m] of the particles of a cable laid around the pegs, and straight after them."""
    corners = [(0.0, 0.0), *((x, side * _BESIDE) for x, side in PEGS.values()), (2.0, 0.0)]
    corners = np.column_stack([corners, np.full(len(corners), RADIUS)])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    at = np.linspace(0.0, LENGTH, SEGMENTS + 1)
    return np.column_stack([np.interp(at, along, column) for column in corners.T])
