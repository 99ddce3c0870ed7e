# SPDX-License-Identifier: Apache-2.0
"""Notes of a node in a saved state: commands of topics, the parameters they suspend; and parameters after a load."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from cloth_sim_ros import parameters as table
from cloth_sim_ros.ros.inputs.grippers import ASKED
from cloth_sim_ros.ros.inputs.pose_track import Vector
from cloth_sim_ros.sim import Simulation

Rates = dict[str, tuple[float, float]]  # as Winches has them

_WIND, _PAY_OUT = table.row(table.WIND, "velocity"), table.row(table.WINCH, "pay_out")
_AGE = replace(_PAY_OUT, low=0.0, high=1e9)  # [s]


def notes_of(wind: Vector | None, rates: Rates, now: float, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the notes at `now` [s]: wind [m/s] and rates by topic, and the parameters that these suspend."""
    waiting = [f"{rope}.winch.pay_out" for rope in rates] + (["wind.velocity"] if wind is not None else [])
    ages = {rope: (rate, now - since) for rope, (rate, since) in rates.items()}
    return {"node": {"wind": wind, "rates": ages, "waiting": {name: values[name] for name in waiting}}}


def read_notes(notes: Any, now: float, values: Mapping[str, Any]) -> tuple[Vector | None, Rates, dict, dict]:
    """Return wind, rates, parameters and gripper commands from the notes of a file that is loaded at `now` [s].

    Notes that no node of a scene with the parameters `values` has written give nothing: a program may note anything.
    """
    try:
        node = notes["node"]
        wind = None if node["wind"] is None else table.check(_WIND, node["wind"])
        rates = {
            rope: (table.check(_PAY_OUT, rate), now - table.check(_AGE, age))
            for rope, (rate, age) in node["rates"].items()
            if f"{rope}.winch.pay_out" in values
        }
        rows = {"wind.velocity": _WIND, **{f"{rope}.winch.pay_out": _PAY_OUT for rope in rates}}
        waiting = {name: table.check(rows[name], each) for name, each in node["waiting"].items()}
        asked = {
            name: (what, table.check(table.row(table.GRIPPER, what), value))
            for name, (what, value) in notes.get("grippers", {}).items()
            if what in ASKED
        }
    except (LookupError, TypeError, ValueError, AttributeError):
        return None, {}, {}, {}
    return wind, rates, waiting, asked


def live_values(sim: Simulation, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the live parameters of `values` whose numbers differ in the simulation, with its numbers.

    Numbers that are equal in float32, in which they are computed, do not differ.
    """
    found = {}
    for name, before in values.items():
        if name.endswith(".scale"):  # a parameter says the unit of a file, a simulation how large its worlds are
            continue
        try:
            now = sim.get(name)
        except ValueError:  # it has no part in this simulation
            continue
        numbers = not isinstance(now, (str, bool)) and not isinstance(before, (str, bool))
        if now != before and not (numbers and np.array_equal(np.float32(now), np.float32(before))):
            found[name] = now
    return found
