"""Cases of the study as data: what to simulate, for how long, and what its exact springs are.

To add a case, add its row in CASES, and a function that builds its body if none of those here does.
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
    """`body`(resolution, constant [N/m]) -> a cloth or rope with pins as indices; `frames` of 1/60 s; target error [m].

    resolution: usual particles along each side of a sheet, segments of a chain; constant [N/m]: usual, of a spring.
    """

    name: str
    text: str
    body: Callable[[int, float], Cloth | Rope]
    frames: int
    tolerance: float
    resolution: int
    constant: float

    @property
    def is_rope(self) -> bool:
        """Whether the body is a rope."""
        return isinstance(self.body(2, self.constant), Rope)

    def title(self, resolution: int, constant: float) -> str:
        """One line for tables and figures."""
        count = f"{resolution} segments" if self.is_rope else f"{resolution} x {resolution}"
        return f"{self.text}, {count}, {constant:g} N/m"

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
    return _sheet(resolution, constant, edges)


def swinging_sheet(resolution: int, constant: float) -> Cloth:
    """A square sheet of 1 m and 0.2 kg that hangs by its upper edge and is let go at 45 degrees."""
    upper = np.arange(resolution * (resolution - 1), resolution**2)
    return _sheet(resolution, constant, upper, (np.sin(np.pi / 8), 0.0, 0.0, np.cos(np.pi / 8)))


def _sheet(resolution: int, constant: float, pins: np.ndarray, orientation: tuple = (0.0, 0.0, 0.0, 1.0)) -> Cloth:
    return Cloth(
        resolution=(resolution, resolution),
        size=(1.0, 1.0),
        mass=0.2,
        orientation=orientation,
        pins=tuple(pins.tolist()),
        stretch_compliance=1.0 / constant,
        shear_compliance=1.0 / constant,
    )


def loaded_chain(load: float) -> Callable[[int, float], Rope]:
    """A chain of 1 m and 0.2 kg with a mass of `load` times its own at its end, let go at 45 degrees."""

    def body(resolution: int, constant: float) -> Rope:
        masses = np.full(resolution + 1, 0.2 / resolution)
        masses[[0, -1]] *= 0.5
        masses[-1] += load * 0.2
        return Rope(
            start=(0.0, 0.0, 0.0),
            end=(np.sqrt(0.5), 0.0, -np.sqrt(0.5)),
            segments=resolution,
            particle_masses=masses,
            pins=(0,),
            stretch_compliance=resolution / constant,  # 1/EA of segments of 1 m / resolution
        )

    return body


CASES = {
    case.name: case
    for case in (
        Case("clamped_sheet", "sheet of 1 m, 0.2 kg, four edges fixed, 0.5 s", clamped_sheet, 30, 1e-3, 32, 1e3),
        Case("swinging_sheet", "sheet of 1 m, 0.2 kg, let go at 45 degrees, 0.5 s", swinging_sheet, 30, 1e-3, 16, 1e3),
        # The load stretches every chain by half to one percent at rest.
        Case("chain_1", "chain of 1 m, 0.2 kg, load of 0.2 kg, 0.5 s", loaded_chain(1.0), 30, 1e-3, 64, 2.5e4),
        Case("chain_100", "chain of 1 m, 0.2 kg, load of 20 kg, 0.5 s", loaded_chain(1e2), 30, 1e-3, 64, 1.25e6),
        Case("chain_10000", "chain of 1 m, 0.2 kg, load of 2000 kg, 0.5 s", loaded_chain(1e4), 30, 1e-3, 64, 1.25e8),
    )
}
