"""What method="auto" takes for each object, and why: by what the study measured (docs/study.md)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from cloth_sim_ros.sim import limits
from cloth_sim_ros.sim.settings import Settings
from cloth_sim_ros.sim.topology import Topology

STRAINED = 0.5  # Strain of a spring beyond which explicit steps may heat an object, however small they are at rest


@dataclass(frozen=True)
class Choice:
    """How one object is computed; `reason` says why, in words that follow its name."""

    method: str
    order: int
    reason: str

    @property
    def words(self) -> str:
        """The method and its order."""
        return self.method if self.method == "verlet" else f"{self.method} order {self.order}"


def choose(
    settings: Settings,
    topology: Topology,
    materials: Iterable[tuple[Sequence[float], float]],
    crumples: bool,
    strained: bool,
) -> Choice:
    """The method for an object of `topology` with its springs and these pairs of compliances and damping, one or more
    of all its worlds, which wind `crumples`; see Simulation.choices.

    Explicit steps where the substeps suffice, as they are nearest by far at that price; else BDF2, which
    nowhere was behind implicit Euler by more than its price. An object that is or was `strained` beyond all rest is
    left to it.
    """
    if settings.method != "auto":
        order = settings.order if settings.method == "xpbd" else 1
        return Choice(settings.method, order, f"is computed by {settings.method}, as set")
    implicit = "is computed by xpbd order 2, since"
    if topology.reel is not None:
        return Choice("xpbd", 2, f"{implicit} a winch feeds it, which explicit steps lack")
    if topology.bends_by_angles:
        return Choice("xpbd", 2, f"{implicit} it bends by angles, which explicit steps lack")
    if strained:
        return Choice(
            "xpbd", 2, f"{implicit} it is or was strained by more than {STRAINED:g} and explicit steps heat it"
        )
    needed = max(limits.explicit_substeps(topology, *material, settings.frame_dt, crumples) for material in materials)
    if settings.substeps < needed:
        return Choice(
            "xpbd", 2, f"{implicit} explicit steps would need {needed:g} substeps and there are {settings.substeps}"
        )
    return Choice(
        "verlet", 1, f"is computed by verlet, since {settings.substeps} substeps are at least the {needed:g} it needs"
    )


def is_strained(topology: Topology, positions: np.ndarray) -> bool:
    """Whether positions (N, 3) [m] strain any spring by more than STRAINED."""
    for elements in topology.springs.values():
        length = np.linalg.norm(positions[elements.particles[:, 1]] - positions[elements.particles[:, 0]], axis=1)
        if (np.abs(length - elements.rest) > STRAINED * elements.rest).any():
            return True
    return False
