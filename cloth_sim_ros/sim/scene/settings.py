# SPDX-License-Identifier: Apache-2.0
"""The settings of the solver, as a plain frozen description."""

from __future__ import annotations

from dataclasses import dataclass

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.input.checks import check_fields


@dataclass(frozen=True)
class Settings:
    """The solver's settings: see the rows of `parameters.SOLVER`. frame_dt [s], global_damping [1/s].

    For order, substeps and iterations of 0, substeps/choose.py chooses a value for each object.
    """

    method: str = "auto"
    order: int = 0
    frame_dt: float = 1 / 60
    substeps: int = 0
    iterations: int = 0
    error: float = 1e-2
    budget: float = 0.5
    speed: float = 0.0
    sleep: bool = True
    global_damping: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self, (*table.SOLVER, table.FRAME_DT))
