# SPDX-License-Identifier: Apache-2.0
"""What the node says about itself once a second."""

from __future__ import annotations

from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from cloth_sim_ros.ros.frame_clock import Pace
from cloth_sim_ros.ros.world import World

SLOW = 0.95  # a real-time factor below this is worth a warning
OVER_ALL = ("max_strain", "max_penetration", "residual")


def busy(node_name: str, what: str) -> DiagnosticArray:
    """The array to publish while the simulation cannot be asked for more; its header is left to the sender."""
    return DiagnosticArray(
        status=[DiagnosticStatus(name=f"{node_name}: simulation", level=DiagnosticStatus.WARN, message=what)]
    )


def diagnostics(
    node_name: str, world: World, pace: Pace, paused: bool, refused: int, by_clock: str | None = None
) -> DiagnosticArray:
    """The array to publish on /diagnostics; its header is left to the sender.

    node_name: fully qualified, so that nodes can be told apart. by_clock: where frames are due by /clock, why the
    simulation is not where the clock is, or "".
    """
    values: dict[str, Any] = {
        "real_time_factor": pace.real_time_factor,
        "ms_per_frame": pace.ms_per_frame,
        "ms_waiting": pace.ms_waiting,
        "frames": pace.frames,
        "resets": world.resets,
        "inputs_refused": refused,
        "paused": paused,
    }
    report: dict[str, dict[str, float]] = {}
    if world.sim is not None:
        report = world.report()
        values |= {"method": world.sim.method, "device": world.sim.device, "simulated_time": world.sim.time}
        values |= {key: max((each[key] for each in report.values()), default=0.0) for key in OVER_ALL}
        if world.sim.settings.method == "auto":
            values |= {f"{name}.method": f"{name} {choice.reason}" for name, choice in world.sim.choices.items()}
        values |= {f"{name}.error_per_frame": error for name, error in world.estimates.items()}
        values |= {f"{name}.held": world.sim.held(name) for name in world.sim.scene.handles}
        values |= {f"{name}.{key}": value for name, each in report.items() for key, value in each.items()}
    status = DiagnosticStatus(name=f"{node_name}: simulation", hardware_id=str(values.get("device", "")))
    status.level, status.message = _verdict(world, pace, paused, report, by_clock)
    status.values = [KeyValue(key=key, value=_text(value)) for key, value in values.items()]
    return DiagnosticArray(status=[status])


def _verdict(
    world: World, pace: Pace, paused: bool, report: dict[str, dict[str, float]], by_clock: str | None
) -> tuple[bytes, str]:
    if world.sim is None:
        return DiagnosticStatus.ERROR, f"no simulation: {world.trouble}"
    put_back = [f"{name} ({each['recoveries']} times)" for name, each in report.items() if each["recoveries"]]
    if put_back:
        return DiagnosticStatus.WARN, f"put back after it was not finite or ran away: {', '.join(put_back)}"
    if paused:
        return DiagnosticStatus.OK, "paused"
    if by_clock is not None:
        return (DiagnosticStatus.WARN, by_clock) if by_clock else (DiagnosticStatus.OK, "follows /clock")
    if pace.real_time_factor < SLOW:
        return DiagnosticStatus.WARN, f"slower than real time by a factor of {pace.real_time_factor:.2f}"
    return DiagnosticStatus.OK, "running"


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
