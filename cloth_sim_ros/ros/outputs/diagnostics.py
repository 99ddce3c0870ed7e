# SPDX-License-Identifier: Apache-2.0
"""Report of the node on itself, once a second."""

from __future__ import annotations

import time
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from cloth_sim_ros.ros.time.frame_clock import Pace
from cloth_sim_ros.ros.world import World

SLOW = 0.95  # a real-time factor below this is worth a warning
BEYOND = 1.25  # ratio of a frame's time to its budget, beyond which it is reported
LOOK = 10  # [s] between reports of a world to the log while nobody listens
# While it is paused, builds or waits it says so each second: whoever asks for a deadline hears of one that is dead.
ALIVE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE, deadline=Duration(seconds=3.0))
OVER_ALL = ("max_strain", "max_penetration", "residual")


class DiagnosticsOutput:
    """The topic /diagnostics. Costly values are computed only while somebody listens."""

    def __init__(self, node: Node):
        self._clock = node.get_clock()
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", ALIVE)
        self._unheard = 0  # seconds

    def is_wanted(self, world: World) -> bool:
        """Return True if somebody listens; call it once a second.

        Otherwise the world is looked at now and then, for what the log should warn of.
        """
        is_heard = self._publisher.get_subscription_count() > 0
        self._unheard = 0 if is_heard else self._unheard + 1
        if self._unheard % LOOK == LOOK - 1 and world.sim is not None:
            world.report()
        return is_heard

    def publish(self, array: DiagnosticArray) -> None:
        """Send `array`, stamped."""
        stamp = self._clock.now().nanoseconds or time.time_ns()  # 0 where a clock is waited for
        array.header.stamp = Time(sec=stamp // 1_000_000_000, nanosec=stamp % 1_000_000_000)
        self._publisher.publish(array)


def busy(node_name: str, what: str) -> DiagnosticArray:
    """Return the array to publish while the simulation cannot be queried, without its header."""
    return DiagnosticArray(
        status=[DiagnosticStatus(name=f"{node_name}: simulation", level=DiagnosticStatus.WARN, message=what)]
    )


def diagnostics(
    node_name: str, world: World, pace: Pace, paused: bool, refused: int, by_clock: str | None = None
) -> DiagnosticArray:
    """Return the array to publish on /diagnostics, without its header.

    node_name: fully qualified, so that nodes can be told apart. by_clock: None if frames are due by the wall clock;
    else why the simulation is not where /clock is, or "".
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
        if world.sim.scene.wind is not None:
            values["wind.velocity"] = list(world.sim.get("wind.velocity"))  # by topic or parameter, who spoke last
        values |= {f"{name}.held": world.sim.held(name) for name in world.sim.scene.handles}
        values |= {f"{seam}.broken": count for seam, count in world.broken_stitches().items()}
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
    beyond = _beyond_budget(world, pace)
    if pace.real_time_factor < SLOW:
        return DiagnosticStatus.WARN, f"slower than real time, at {pace.real_time_factor:.2f} of it{beyond}"
    return DiagnosticStatus.OK, f"running{beyond}"


def _beyond_budget(world: World, pace: Pace) -> str:
    """Return by how much a frame exceeds its budget, and what helps; "" where substeps are set."""
    settings = world.sim.settings
    budget = 1e3 * settings.budget * settings.frame_dt
    if settings.substeps or not world.sim.choices or pace.ms_per_frame <= BEYOND * budget:
        return ""
    times = pace.ms_per_frame / budget
    return f"; a frame takes {times:.1f} times solver.budget: a larger solver.error or coarser objects help"


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
