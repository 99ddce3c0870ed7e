# SPDX-License-Identifier: Apache-2.0
"""Topics of a bag and their messages, read without ROS."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from cloth_sim_ros.record.integrity import DIGEST, Digest, is_cut_short, mend

CLOUD, WRENCH = "sensor_msgs/msg/PointCloud2", "geometry_msgs/msg/WrenchStamped"


class _Damaged(ValueError):
    """Damage that we found ourselves, in our words."""


class Topics:
    """A bag as topics. Raises ValueError in one sentence if it is no bag or is damaged.

    types: topic -> the type of its messages. cut_short: True if its recorder was killed, so that only the messages
    written by then are there.
    """

    def __init__(self, path: Path):
        from rosbags.typesys import Stores, get_typestore

        self.path, self._known = path, get_typestore(Stores.ROS2_JAZZY)
        self._file, self.cut_short = path, is_cut_short(path)
        if self.cut_short:
            self._folder = TemporaryDirectory()  # it goes with this object
            self._file = mend(path, Path(self._folder.name))
        with self._read() as reader:
            self.types = {each.topic: each.msgtype for each in reader.connections}
            self._check(reader)

    def messages(self, topic: str) -> Iterator[Any]:
        """Yield the messages of a topic, in the order of the bag; none if it has no such topic."""
        with self._read() as reader:
            # All topics are asked for, as the digest was: rosbags skips parts of a file by an index without a checksum.
            for connection, _, data in reader.messages(reader.connections) if topic in self.types else ():
                if connection.topic == topic:
                    yield self._known.deserialize_cdr(data, connection.msgtype)

    def _check(self, reader: Any) -> None:
        """Raise ValueError if these are not the messages that were recorded."""
        custom = reader.storage.metadata.custom or {}
        if DIGEST not in custom:
            return  # of another recorder
        digest = Digest()
        for connection, stamp, data in reader.messages(reader.connections):
            digest.add(connection.topic, stamp, data)
        if str(digest) != custom[DIGEST]:
            raise _Damaged(f"{self.path} is damaged: its messages are not those that were recorded")

    @contextmanager
    def _read(self) -> Iterator[Any]:
        from rosbags.rosbag2 import Reader

        if not self.path.exists():
            raise ValueError(f"{self.path} is not there; allowed is the folder of a bag")
        try:
            with Reader(self._file) as reader:
                yield reader
        except (_Damaged, GeneratorExit):
            raise
        except Exception as error:  # whatever rosbags raises for some damage, the user gets one sentence
            words = " ".join(str(error).split()) or type(error).__name__
            raise ValueError(f"{self.path} is no bag, or is damaged or cut short: {words}") from None
