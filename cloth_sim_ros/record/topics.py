# SPDX-License-Identifier: Apache-2.0
"""The topics of a bag and their messages. Nothing here needs ROS."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

CLOUD = "sensor_msgs/msg/PointCloud2"


class Topics:
    """A bag as topics. Raises ValueError, in one sentence, for what is none or is damaged.

    types: topic -> the type of its messages.
    """

    def __init__(self, path: Path):
        from rosbags.typesys import Stores, get_typestore

        self.path, self._known = path, get_typestore(Stores.ROS2_JAZZY)
        with self._read() as reader:
            self.types = {each.topic: each.msgtype for each in reader.connections}

    def messages(self, topic: str) -> Iterator[Any]:
        """The messages of a topic, in the order of the bag; none where it has no such topic."""
        with self._read() as reader:
            chosen = [each for each in reader.connections if each.topic == topic]
            for connection, _, data in reader.messages(chosen) if chosen else ():
                yield self._known.deserialize_cdr(data, connection.msgtype)

    @contextmanager
    def _read(self) -> Iterator[Any]:
        from rosbags.rosbag2 import Reader

        if not self.path.exists():
            raise ValueError(f"{self.path} is not there; allowed is the folder of a bag")
        try:
            with Reader(self.path) as reader:
                yield reader
        except (ValueError, GeneratorExit):
            raise
        except Exception as error:  # whatever rosbags raises for some damage, the user gets one sentence
            words = " ".join(str(error).split()) or type(error).__name__
            raise ValueError(f"{self.path} is no bag, or is damaged or cut short: {words}") from None
