# SPDX-License-Identifier: Apache-2.0
"""Rates that topics set on the winches of the running simulation, for a while; then their parameters act again."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from cloth_sim_ros.sim import Simulation

_ROUNDING = 1e-6  # [s]


class Winches:
    """Owned by the thread that simulates.

    rates: rope -> (rate by topic [m/s], simulated time when it came [s]), until it is released.
    """

    def __init__(self, log: Any):
        self.rates: dict[str, tuple[float, float]] = {}
        self._cut: set[str] = set()  # ropes whose parameter exceeds their largest rate
        self._log = log

    def command(self, sim: Simulation | None, rope: str, rate: float, now: float) -> None:
        """Set the rate of a winch [m/s] from a message that came at `now` [s]."""
        self.rates[rope] = rate, now
        _drive(sim, rope, rate)

    def drive(self, sim: Simulation) -> None:
        """Apply the rates of messages to a new simulation."""
        for rope, (rate, _) in self.rates.items():
            _drive(sim, rope, rate)

    def release(self, sim: Simulation | None, ropes: Iterable[str], values: Mapping[str, Any]) -> None:
        """Set winches back to their parameters."""
        for rope in ropes:
            del self.rates[rope]
            _drive(sim, rope, values[f"{rope}.winch.pay_out"])

    def end_old_commands(self, sim: Simulation, values: Mapping[str, Any], now: float) -> None:
        """Release winches whose sender has fallen silent, and warn of it once."""
        if not self.rates:
            return
        # A timeout of whole frames is over at the same frame however the two times were rounded.
        ends = {rope: since + values[f"{rope}.winch.timeout"] + _ROUNDING for rope, (_, since) in self.rates.items()}
        old = [rope for rope, end in ends.items() if now > end]
        for rope in old:
            rate, held = self.rates[rope][0], values[f"{rope}.winch.pay_out"]
            if rate != held:
                silence = f"no rate came for {values[f'{rope}.winch.timeout']:g} s"
                self._log.warning(f"{rope}/winch: {silence}; back to {rope}.winch.pay_out, {held:g} m/s")
        self.release(sim, old, values)

    def set_parameter(self, rope: str, rate: float, values: Mapping[str, Any]) -> None:
        """Let the parameter act again, and warn if it exceeds the winch's largest rate."""
        self.rates.pop(rope, None)
        most = values[f"{rope}.winch.max_rate"]
        if abs(rate) <= most:
            self._cut.discard(rope)
        elif rope not in self._cut:  # once, as a slider asks for many
            self._cut.add(rope)
            self._log.warning(f"{rope}.winch.pay_out is {rate:g} m/s and is cut to {rope}.winch.max_rate, {most:g} m/s")


def _drive(sim: Simulation | None, rope: str, rate: float) -> None:
    thing = sim.scene.objects.get(rope) if sim is not None else None
    if thing is not None and thing.winch is not None:
        sim.set(f"{rope}.winch.pay_out", rate)
