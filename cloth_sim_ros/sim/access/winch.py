# SPDX-License-Identifier: Apache-2.0
"""Winches, from the host: their live numbers, and the length they have paid out."""

from __future__ import annotations

from typing import Any

import numpy as np

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.engine.batch import Batch
from cloth_sim_ros.sim.input.checks import WorldSelection
from cloth_sim_ros.sim.scene.objects import Winch, check_lengths

LIVE = tuple(row.name for row in table.WINCH if row.live)


def write_winch(batch: Batch, name: str, winch: Winch) -> None:
    """Write the scene's live numbers of the winch of rope `name` in all worlds."""
    batch.drives.write(batch.index[name], None, **{field: getattr(winch, field) for field in LIVE})


def set_winch(batch: Batch, name: str, row: table.Parameter, value: Any, world: WorldSelection) -> None:
    """Set one live number in some worlds to a checked value, or one per world. Raises ValueError."""
    b = batch.index[name]
    lengths = batch.drives.read(b, world)
    if row.name in ("shortest", "longest"):
        lengths[row.name] = value
        for k in np.flatnonzero(lengths["shortest"] > lengths["longest"])[:1]:
            check_lengths(float(lengths["shortest"][k]), float(lengths["longest"][k]), f"{name}.winch.shortest")
    batch.drives.write(b, world, **{row.name: value})


def measure_winch(batch: Batch, name: str, world: int) -> dict[str, float]:
    """paid_out [m], unstretched; pay_out [m/s], the current rate; winch_stopped, 1 if a length limit stopped it."""
    winch = batch.read_body("winches", name, world)[0, 0]
    return {
        "paid_out": float(winch["behind"] + winch["length"] + winch["backlog"]),
        "pay_out": float(winch["rate"]),
        "winch_stopped": int(winch["stopped"]),
    }
