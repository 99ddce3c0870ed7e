# SPDX-License-Identifier: Apache-2.0
"""What a node keeps with a saved state: what topics ask for, over parameters that wait; and parameters after a load."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from cloth_sim_ros.ros.pose_track import Vector
from cloth_sim_ros.sim import Simulation

Rates = dict[str, tuple[float, float]]  # as Winches has them


def notes_of(wind: Vector | None, rates: Rates, now: float, values: Mapping[str, Any]) -> dict[str, Any]:
    """The notes at `now` [s]: wind [m/s] and rates by topic, and the parameters that act again when these end."""
    waiting = [f"{rope}.winch.pay_out" for rope in rates] + (["wind.velocity"] if wind is not None else [])
    ages = {rope: (rate, now - since) for rope, (rate, since) in rates.items()}
    return {"node": {"wind": wind, "rates": ages, "waiting": {name: values[name] for name in waiting}}}


def read_notes(notes: Any, now: float) -> tuple[Vector | None, Rates, dict[str, Any]]:
    """Wind, rates and parameters of the notes of a file that is loaded at `now` [s]; none of one that no node saved."""
    node = notes["node"] if isinstance(notes, dict) and "node" in notes else {"wind": None, "rates": {}, "waiting": {}}
    rates = {rope: (rate, now - age) for rope, (rate, age) in node["rates"].items()}
    waiting = {name: tuple(each) if isinstance(each, list) else each for name, each in node["waiting"].items()}
    return node["wind"] and tuple(node["wind"]), rates, waiting


def live_values(sim: Simulation, values: Mapping[str, Any]) -> dict[str, Any]:
    """What the parameters of `values` that are live numbers of a simulation are in it now, where they differ.

    A value stays as it is where float32, in which it is computed, holds it as the same.
    """
    found = {}
    for name, before in values.items():
        try:
            now = sim.get(name)
        except ValueError:  # it has no part in this simulation
            continue
        numbers = not isinstance(now, (str, bool)) and not isinstance(before, (str, bool))
        if now != before and not (numbers and np.array_equal(np.float32(now), np.float32(before))):
            found[name] = now
    return found
