# SPDX-License-Identifier: Apache-2.0
"""A case of the study: a body, its duration, its tolerance, and its exact springs."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from cloth_sim_ros.sim import Cloth, Rope, Scene, Settings, Simulation
from cloth_sim_ros.sim.colliders.collider import Collider
from cloth_sim_ros.study.springs import SpringSystem

BODY = "body"
FRAME_DT = 1 / 60


@dataclass(frozen=True)
class Case:
    """A body to simulate for `frames` of 1/60 s, and the error [m] to reach.

    body: a function of resolution and spring constant [N/m] that makes a cloth or rope, with pins as indices.
    resolution: the default number of particles along each side of a sheet, or of segments of a chain. constant [N/m]:
    the default constant of a spring.
    """

    name: str
    text: str
    body: Callable[[int, float], Cloth | Rope]
    frames: int
    tolerance: float
    resolution: int
    constant: float
    colliders: Mapping[str, Collider] = field(default_factory=dict)
    closed: Callable[[int, float], np.ndarray] | None = None  # the exact frames (F + 1, N, 3) [m], where they are known

    @property
    def springs_alone(self) -> bool:
        """True if only springs and weight act, which is all that the classic methods in NumPy can do."""
        return not self.colliders and not self.bends

    @property
    def bends(self) -> bool:
        """True if the body resists bending."""
        return self.body(2, self.constant).bend_compliance is not None

    @property
    def is_rope(self) -> bool:
        """True if the body is a rope."""
        return isinstance(self.body(2, self.constant), Rope)

    def title(self, resolution: int, constant: float) -> str:
        """Return one line for tables and figures."""
        count = f"{resolution} segments" if self.is_rope else f"{resolution} x {resolution}"
        return f"{self.text}, {self.frames * FRAME_DT:g} s, {count}, {constant:g} N/m"

    def lasting(self, seconds: float) -> Case:
        """Return the case with another duration [s].

        Raises ValueError if it is shorter than a frame, or differs from that of a closed form.
        """
        frames = round(seconds / FRAME_DT)
        if frames < 1:
            raise ValueError(f"--seconds is {seconds:g}; allowed is at least a frame, {FRAME_DT:.4f} s")
        if self.closed is not None and frames != self.frames:
            known = f"{self.frames * FRAME_DT:g} s, as long as its closed form"
            raise ValueError(f"--seconds is {seconds:g} with case {self.name}; allowed is {known}")
        return dataclasses.replace(self, frames=frames)

    def simulation(
        self, resolution: int, constant: float, settings: Settings, device: str, worlds: int = 1
    ) -> Simulation:
        """Return the product's simulation of the case at its start."""
        scene = Scene(objects={BODY: self.body(resolution, constant)}, colliders=self.colliders)
        return Simulation(scene, settings, device=device, worlds=worlds)

    def system(self, resolution: int, constant: float) -> tuple[SpringSystem, np.ndarray]:
        """Return the same masses and springs in float64, and their first positions (N, 3) [m], at rest."""
        body = self.body(resolution, constant)
        sim = Simulation(Scene(objects={BODY: body}), Settings(method="xpbd", order=1, substeps=20), device="cpu")
        more = {"damping": body.damping, "bending": _bending(body) if isinstance(body, Rope) else None}
        system = SpringSystem.from_springs(sim.masses(BODY), body.pins, sim.springs(BODY), **more)
        return system, sim.rest_positions(BODY).astype(np.float64)


def _bending(rope: Rope) -> sparse.csr_array | None:
    """Return the stiffness (N, N) [N/m] of E = sum EI / (2 a_i) |t_i+1 - t_i|^2, Hencky's chain (1920).

    t are the segments over their rest lengths. a_i [m] is half of both segments at particle i, without those fixed at
    both ends.
    """
    if rope.bend_compliance is None:
        return None
    length = np.linalg.norm(np.diff(rope.points, axis=0), axis=1)
    tangents = sparse.diags_array([-1.0 / length, 1.0 / length], offsets=[0, 1], shape=(len(length), len(length) + 1))
    turns = sparse.diags_array([-1.0, 1.0], offsets=[0, 1], shape=(len(length) - 1, len(length))) @ tangents
    held = np.isin(np.arange(len(length)), rope.pins) & np.isin(np.arange(1, len(length) + 1), rope.pins)
    bending = np.where(held, 0.0, length)
    return (turns.T @ sparse.diags_array(2.0 / (rope.bend_compliance * (bending[:-1] + bending[1:]))) @ turns).tocsr()
