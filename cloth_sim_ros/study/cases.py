"""Cases of the study as data: what to simulate, for how long, and what its exact springs are.

To add a case, add a function that builds its body and its line in CASES.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cloth_sim_ros.sim import Cloth, Rope, Scene, Settings, Simulation
from cloth_sim_ros.study.springs import SpringSystem

BODY = "body"
FRAME_DT = 1 / 60


@dataclass(frozen=True)
class Case:
    """`body`(resolution, constant [N/m]) -> a cloth or rope with pins as indices; `frames` of 1/60 s; target error
    [m]."""

    name: str
    text: str
    body: Callable[[int, float], Cloth | Rope]
    frames: int
    tolerance: float

    def simulation(self, resolution: int, constant: float, settings: Settings, device: str) -> Simulation:
        """The product's simulation of the case at its start."""
        scene = Scene(objects={BODY: self.body(resolution, constant)})
        return Simulation(scene, settings, device=device)

    def system(self, resolution: int, constant: float) -> tuple[SpringSystem, np.ndarray]:
        """The same masses and springs in float64, and the positions (N, 3) [m] that they start from, at rest."""
        body = self.body(resolution, constant)
        sim = Simulation(Scene(objects={BODY: body}), Settings(), device="cpu")
        system = SpringSystem.from_springs(sim.masses(BODY), body.pins, sim.springs(BODY), damping=body.damping)
        return system, sim.rest_positions(BODY).astype(np.float64)


def clamped_sheet(resolution: int, constant: float) -> Cloth:
    """A square sheet of 1 m and 0.2 kg, all four edges fixed, that falls from flat into its sag."""
    index = np.arange(resolution**2).reshape(resolution, resolution)
    edges = np.unique(np.concatenate([index[0], index[-1], index[:, 0], index[:, -1]]))
    return Cloth(
        resolution=(resolution, resolution),
        size=(1.0, 1.0),
        mass=0.2,
        pins=tuple(edges.tolist()),
        stretch_compliance=1.0 / constant,
        shear_compliance=1.0 / constant,
    )


CASES = {
    case.name: case
    for case in (Case("clamped_sheet", "sheet of 1 m, 0.2 kg, four edges fixed, 0.5 s", clamped_sheet, 30, 1e-3),)
}
