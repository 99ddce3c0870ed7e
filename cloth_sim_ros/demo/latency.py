# SPDX-License-Identifier: Apache-2.0
"""Measure how old particles and meshes are when they arrive in another process, and how many are lost.

`python -m cloth_sim_ros.demo.latency --config FILE --seconds 60` starts the node, subscribes to all its topics, without
decoding, and counts. The node's messages on /diagnostics tell how many frames there were. The first message is late if
kernels have to be compiled before it.
"""

from __future__ import annotations

import argparse
import struct
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cloth_sim_ros.demo.__main__ import start_node
from cloth_sim_ros.options import duration
from cloth_sim_ros.shared_files import shared

DEPTH = 1000  # messages that may wait while this process looks for new topics
SETTLING = 2.0  # [s] after the first message, which are not counted


@dataclass(frozen=True)
class Told:
    """One message on /diagnostics: its stamp [s] and the frames since the one before.

    ms_per_frame, ms_waiting: medians [ms] of the time spent on a frame and of the time waited for the device.
    real_time_factor: simulated per real time.
    """

    stamp: float
    frames: int
    ms_per_frame: float
    ms_waiting: float
    real_time_factor: float


def main(arguments: list[str] | None = None) -> int:
    """Measure for --seconds and print a line for each topic; return 1 if nothing came."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--config", type=Path, default=shared("config/curtain.yaml"), help="parameter file of the node")
    parser.add_argument("--seconds", type=duration, default=60.0, help="how long to count")
    parser.add_argument("--set", action="append", default=[], metavar="NAME:=VALUE", help="a parameter to override")
    options = parser.parse_args(arguments)
    node = start_node(options.config, *(word for pair in options.set for word in ("-p", pair)))
    try:
        return listen(node, options.seconds)
    finally:
        node.terminate()
        node.wait(timeout=10.0)


def listen(node: subprocess.Popen, seconds: float) -> int:
    """Find the node's topics, count their messages, and print; return the exit status."""
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import PointCloud2
    from visualization_msgs.msg import Marker

    from cloth_sim_ros.ros.outputs.cdr import STAMP_AT

    kinds = {"sensor_msgs/msg/PointCloud2": PointCloud2, "visualization_msgs/msg/Marker": Marker}
    arrived: dict[str, list[tuple[float, float]]] = {}
    told: list[Told] = []
    rclpy.init()
    listener = rclpy.create_node("cloth_latency")
    executor = SingleThreadedExecutor()
    executor.add_node(listener)

    def hear(topic: str):
        def callback(message: bytes) -> None:
            now = time.time()
            seconds, nanoseconds = struct.unpack_from("<iI", message, STAMP_AT)
            arrived[topic].append((seconds + 1e-9 * nanoseconds, now))

        return callback

    def note(array: DiagnosticArray) -> None:
        values = {item.key: item.value for item in array.status[0].values}
        if not values:  # nothing is simulated at this time
            return
        stamp = array.header.stamp.sec + 1e-9 * array.header.stamp.nanosec
        numbers = (float(values[key]) for key in ("ms_per_frame", "ms_waiting", "real_time_factor"))
        told.append(Told(stamp, int(values["frames"]), *numbers))

    listener.create_subscription(DiagnosticArray, "/diagnostics", note, 10)
    begun, start = time.time(), None
    while node.poll() is None and (start is None or time.time() < start + SETTLING + seconds):
        for name, types in listener.get_topic_names_and_types():
            if name.startswith("/cloth_sim/") and name not in arrived and types[0] in kinds:
                arrived[name] = []
                listener.create_subscription(kinds[types[0]], name, hear(name), QoSProfile(depth=DEPTH), raw=True)
        until = time.time() + (0.1 if start is None else 1.0)  # once the node has started it makes no new topics
        while time.time() < until:
            executor.spin_once(timeout_sec=0.1)
        if start is None and any(arrived.values()):
            start = time.time()
    executor.shutdown()
    listener.destroy_node()
    rclpy.try_shutdown()
    told = [each for each in told if start is not None and each.stamp > start + SETTLING]
    if len(told) < 2:
        print("nothing came from the node", file=sys.stderr)
        return 1
    print(f"first message {start - begun:.1f} s after the start of the node")
    print(table(arrived, told))
    return 0


def table(arrived: dict[str, list[tuple[float, float]]], told: list[Told]) -> str:
    """Return a line for each topic: its messages between the first and the last of `told`, lost ones, and ages.

    arrived: topic -> (stamp, arrival) [s].
    """
    first, last = told[0], told[-1]
    longest = max(map(len, arrived))
    keys = ("ms_per_frame", "ms_waiting", "real_time_factor")
    work, waiting, factor = (np.median([getattr(each, key) for each in told]) for key in keys)
    lines = [
        f"{last.stamp - first.stamp:.0f} s at real-time factor {factor:.2f}, {work:.2f} ms a frame in the thread "
        f"that simulates, of which it waits {waiting:.2f} for the device"
    ]
    lines.append(f"{'topic':<{longest}}  {'messages':>8}  {'lost':>5}  {'ms old: median':>14}  {'p95':>6}  {'most':>6}")
    counted = {
        topic: [(stamp, at) for stamp, at in rows if first.stamp < stamp <= last.stamp]
        for topic, rows in arrived.items()
    }
    frames = sum(each.frames for each in told[1:])
    for topic, rows in counted.items():
        if rows:
            ages = 1e3 * np.array([at - stamp for stamp, at in rows])
            numbers = f"{np.median(ages):>14.2f}  {np.percentile(ages, 95):>6.2f}  {ages.max():>6.2f}"
            lines.append(f"{topic:<{longest}}  {len(rows):>8}  {frames - len(rows):>5}  {numbers}")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
