# SPDX-License-Identifier: Apache-2.0
"""Record a running cloth_sim node into an MCAP bag: `cloth_sim_record BAG`, until Ctrl-C or --seconds."""

from __future__ import annotations

import argparse
import importlib
import sys
import time
from functools import partial
from pathlib import Path

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from cloth_sim_ros.options import duration, missing
from cloth_sim_ros.record.integrity import DIGEST, Digest
from cloth_sim_ros.record.topics import CLOUD, WRENCH
from cloth_sim_ros.ros.outputs.journal import ACTS
from cloth_sim_ros.ros.surroundings import set_up
from cloth_sim_ros.signals import Stop

LOOK = 0.2  # [s] between searches for new topics
FLUSH = 1.0  # [s] of a recording that are lost at most if the recorder is killed
JOURNAL_TYPE = "std_msgs/msg/String"
INPUTS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)  # takes what any sender sends
OUTPUTS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)


class Recorder(Node):
    """Writes the topics that a node subscribes to, its particle clouds, wrenches and journal, as messages arrive."""

    def __init__(self, node: str, bag: Path):
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

        super().__init__("cloth_sim_record")
        name = self.resolve_service_name(node)
        self.recorded, (self._namespace, _, self._name) = name, name.rpartition("/")
        self.messages, self.has_start = 0, False
        self._types = get_typestore(Stores.ROS2_JAZZY)
        self._writer = Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP)
        self._writer.open()
        self._topics: set[str] = set()
        self._digest = Digest()
        self.create_timer(LOOK, self._look)
        self.create_timer(FLUSH, self._flush)

    def close(self) -> None:
        """Finish the bag."""
        self._writer.set_custom_data(DIGEST, str(self._digest))
        self._writer.close()

    def _flush(self) -> None:
        """Write everything received so far to disk, in case of a kill. Raises OSError if the disk is full."""
        storage = self._writer.storage
        if storage.chunk.msgs:
            storage.close_chunk()
            storage.bio.flush()

    def _look(self) -> None:
        """Subscribe to new topics. ~/journal comes last, so that everything after its start is recorded."""
        node = (self._name, self._namespace or "/")
        if node not in self.get_node_names_and_namespaces():
            return
        given = dict(self.get_publisher_names_and_types_by_node(*node))
        taken = dict(self.get_subscriber_names_and_types_by_node(*node))
        for topic, types in taken.items():
            self._subscribe(topic, types[0], INPUTS)
        for topic, types in given.items():
            if types[0] in (CLOUD, WRENCH):
                self._subscribe(topic, types[0], OUTPUTS)
        for topic in (f"{self.recorded}/journal/acts", f"{self.recorded}/journal"):
            if topic in given:
                self._subscribe(topic, JOURNAL_TYPE, ACTS)

    def _subscribe(self, topic: str, kind: str, qos: QoSProfile) -> None:
        if topic in self._topics:
            return
        self._topics.add(topic)
        package, _, name = kind.partition("/msg/")
        if kind not in self._types.types:
            self.get_logger().warning(f"{topic} is left out, as rosbags does not know its type {kind}")
            return
        message = getattr(importlib.import_module(f"{package}.msg"), name)
        connection = self._writer.add_connection(topic, kind, typestore=self._types)
        self.create_subscription(message, topic, partial(self._write, connection), qos, raw=True)

    def _write(self, connection, message: bytes) -> None:
        self.has_start = self.has_start or connection.topic == f"{self.recorded}/journal"
        now = time.time_ns()
        self._writer.write(connection, now, message)
        self._digest.add(connection.topic, now, message)
        self.messages += 1


def main(arguments: list[str] | None = None) -> int:
    """Record until a signal comes; return the exit status, 1 if the bag is of no use."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bag", type=Path, help="folder to be made for the bag")
    parser.add_argument("--node", default="cloth_sim", help="name of the node to record")
    parser.add_argument("--seconds", type=duration, default=float("inf"), help="how long to record once it has begun")
    given = sys.argv if arguments is None else ["cloth_sim_record", *arguments]
    options = parser.parse_args(remove_ros_args(given)[1:])
    if lack := missing("rosbags"):
        return _failed(lack)
    stop = Stop()
    set_up()
    rclpy.init(args=given, signal_handler_options=SignalHandlerOptions.NO)
    try:
        return record(options.node, options.bag, options.seconds, stop)
    except Exception as error:  # of rosbags or of the file system
        return _failed(f"{options.bag} cannot be written: {error}")
    finally:
        rclpy.try_shutdown()


def record(node: str, bag: Path, seconds: float, stop: Stop) -> int:
    """Record until `stop` is set, or for `seconds` from the journal's start on; return the exit status."""
    recorder = Recorder(node, bag)
    executor = SingleThreadedExecutor()
    executor.add_node(recorder)
    print(f"Waiting for {recorder.recorded} ...", flush=True)
    end = float("inf")
    while not stop.is_set() and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)
        if recorder.has_start and end == float("inf"):
            print(f"Recording into {bag}; Ctrl-C ends it.", flush=True)
            end = min(time.monotonic() + seconds, 1e18)
    executor.shutdown()
    recorder.close()
    recorder.destroy_node()
    if not recorder.has_start:
        return _failed(f"{bag} has no start, as no simulation ran in {recorder.recorded}; it cannot be replayed")
    print(f"{recorder.messages} messages are in {bag}", flush=True)
    return 0


def _failed(sentence: str) -> int:
    print(f"cloth_sim_record: {sentence}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
