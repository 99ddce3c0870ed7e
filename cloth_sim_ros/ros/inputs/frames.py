# SPDX-License-Identifier: Apache-2.0
"""Poses in other frames than ours, by tf2 where it is installed; elsewhere they are refused."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.time import Time

from cloth_sim_ros.parameters import shown
from cloth_sim_ros.ros.inputs.pose_track import Pose, PoseTrack, Quaternion, Vector
from cloth_sim_ros.sim.physics.quaternion import rotate


class Refused(ValueError):
    """A message cannot be used; `kind` names the sort of trouble, the text is one sentence about the message."""

    def __init__(self, kind: str, sentence: str):
        super().__init__(sentence)
        self.kind = kind


class Frames:
    """What is in frame `ours`, and what can be brought there.

    buffer: a tf2_ros.Buffer or what has its `lookup_transform`; with None, one that listens through `node` is made when
    it is needed first. An empty frame, as typed by hand, is ours.
    """

    def __init__(self, ours: str, node: Node | None = None, buffer: Any = None):
        self.ours = ours
        self._node, self._buffer = node, buffer

    def pose(self, pose: Pose, frame: str, stamp: Time) -> Pose:
        """A pose in `frame` at `stamp`, in ours. Raises Refused."""
        if frame in ("", self.ours):
            return pose
        return _composed(self._lookup(frame, stamp)[1], pose)

    def vector(self, vector: Vector, frame: str, stamp: Time) -> Vector:
        """A free vector in `frame`, in ours. Raises Refused."""
        if frame in ("", self.ours):
            return vector
        return tuple(rotate(self._lookup(frame, stamp)[1].orientation, np.array([vector]))[0].tolist())

    def place(self, frame: str) -> tuple[float, Pose]:
        """The newest stamp [s] for which it is known where `frame` is, and where. Raises Refused."""
        return self._lookup(frame, Time())

    def _lookup(self, frame: str, stamp: Time) -> tuple[float, Pose]:
        if self._buffer is None:
            self._buffer = self._listen(frame)
        try:
            found = self._buffer.lookup_transform(self.ours, frame, stamp)
        except Exception as error:  # tf2 has one for each reason
            raise Refused("tf", f"frame {shown(frame)} cannot be told in '{self.ours}': {error}") from None
        p, q = found.transform.translation, found.transform.rotation
        at = found.header.stamp.sec + 1e-9 * found.header.stamp.nanosec
        return at, Pose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))

    def _listen(self, frame: str) -> Any:
        try:
            from tf2_ros import Buffer, TransformListener
        except ImportError:
            raise Refused(
                "frame",
                f"its frame_id is {shown(frame)}, but this node only knows '{self.ours}' as tf2_ros is not installed",
            ) from None
        buffer = Buffer()
        self._listener = TransformListener(buffer, self._node)
        return buffer


class Followers:
    """Colliders and handles that go where a frame of tf is."""

    def __init__(self, frames: Frames, log: Any):
        self._frames, self._log = frames, log
        self._stamps: dict[str, float] = {}
        self._since: dict[str, float] = {}
        self._told: dict[str, str] = {}

    def advance(self, tracks: Mapping[str, PoseTrack], values: Mapping[str, Any]) -> None:
        """Puts the newest place of every followed frame into its track; what is late or unknown is told once."""
        now = time.monotonic()
        for name, track in tracks.items():
            frame = values.get(f"{name}.follow_frame")  # a gripper's fingers have none
            if not frame:
                self._told.pop(name, None)
                continue
            try:
                stamp, pose = self._frames.place(frame)
            except Refused as reason:
                self._tell(name, f"{name} stays where it is: {reason}")
                continue
            if stamp != self._stamps.get(name):
                self._stamps[name], self._since[name] = stamp, now
                self._told.pop(name, None)
                try:
                    track.push(stamp or None, pose, now)
                except ValueError as error:
                    self._tell(name, f"{name} stays where it is: of frame {shown(frame)}, {error}")
            elif stamp and now - self._since[name] > values["pose_timeout"]:
                late = f"nothing newer has come for {values['pose_timeout']:g} s"
                self._tell(name, f"{name} stays where it is: of frame {shown(frame)}, {late}")

    def _tell(self, name: str, sentence: str) -> None:
        if self._told.get(name) != sentence:
            self._told[name] = sentence
            self._log.warning(sentence)


def _composed(outer: Pose, inner: Pose) -> Pose:
    """The pose `inner`, given in the axes of `outer`."""
    offset = rotate(outer.orientation, np.array([inner.position]))[0]
    position = tuple((np.array(outer.position) + offset).tolist())
    return Pose(position, _product(outer.orientation, inner.orientation))


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    u, v = np.array(a[:3]), np.array(b[:3])
    w = a[3] * b[3] - u @ v
    return (*(a[3] * v + b[3] * u + np.cross(u, v)).tolist(), float(w))
