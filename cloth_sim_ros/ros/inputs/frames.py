# SPDX-License-Identifier: Apache-2.0
"""Poses in other frames than ours, by tf2 if it is installed; otherwise they are refused."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.time import Time

from cloth_sim_ros import parameters
from cloth_sim_ros.parameters import shown
from cloth_sim_ros.ros.inputs.pose_track import Pose, PoseTrack, Vector, composed
from cloth_sim_ros.sim.physics.quaternion import rotate

FARTHEST = parameters.row(parameters.COLLIDER, "position").high  # [m]
UNIT_TOLERANCE = 1e-2  # largest deviation of a quaternion's norm from 1: rounding and integration drift, not mistakes

Mounts = Mapping[str, tuple[str, Pose]]  # collider of the robot -> its link, and its pose in the axes of that


class Refused(ValueError):
    """A message cannot be used; `kind` names the sort of trouble, the text is one sentence about the message."""

    def __init__(self, kind: str, sentence: str):
        super().__init__(sentence)
        self.kind = kind


def bounded(vector: Vector, limit: float, what: str, unit: str) -> Vector:
    """Return the vector. Raises Refused if it is not finite or beyond `limit`."""
    if not all(map(math.isfinite, vector)):
        raise Refused("finite", f"its {what} {_numbers(vector)} is not finite")
    if max(map(abs, vector)) > limit:
        raise Refused("size", f"its {what} {_numbers(vector)} is beyond {limit:g} {unit}")
    return vector


def checked(pose: Pose) -> Pose:
    """Return the pose with an orientation of unit norm.

    Raises Refused if it is not finite, too far away, or no rotation.
    """
    bounded(pose.position, FARTHEST, "position", "m")
    x, y, z, w = pose.orientation
    norm = math.hypot(x, y, z, w)
    if not abs(norm - 1.0) <= UNIT_TOLERANCE:
        given = _numbers(pose.orientation)
        raise Refused("orientation", f"its orientation {given} has norm {norm:.4g}, but must be of unit norm")
    return Pose(pose.position, (x / norm, y / norm, z / norm, w / norm))


def _numbers(values: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{value:.6g}" for value in values) + ")"


class Frames:
    """Transforms of poses and vectors into the frame `ours`.

    An empty frame, as typed by hand, is ours. buffer: a tf2_ros.Buffer or an object with its `lookup_transform`; with
    None, one that listens through `node` is made at the first use. links: those of the robot that follow the positions
    of its joints -> stamp [s] and pose; replaced as a whole, from any thread. waits: the topic of these positions, or
    "".
    """

    def __init__(self, ours: str, node: Node | None = None, buffer: Any = None):
        self.ours = ours
        self._node, self._buffer = node, buffer
        self.links: Mapping[str, tuple[float, Pose]] = {}
        self.waits = ""

    def pose(self, pose: Pose, frame: str, stamp: Time) -> Pose:
        """Return a pose, given in `frame` at `stamp`, in our frame. Raises Refused."""
        if frame in ("", self.ours):
            return pose
        return composed(self._lookup(frame, stamp)[1], pose)

    def vector(self, vector: Vector, frame: str, stamp: Time) -> Vector:
        """Return a free vector, given in `frame`, in our frame. Raises Refused."""
        if frame in ("", self.ours):
            return vector
        return tuple(rotate(self._lookup(frame, stamp)[1].orientation, np.array([vector]))[0].tolist())

    def place(self, frame: str) -> tuple[float, Pose]:
        """Return the newest stamp [s] at which the pose of `frame` is known, and that pose. Raises Refused."""
        if self.waits and not self.links:
            raise Refused("joints", f"nothing has come on {self.waits} yet")
        return self.links.get(frame) or self._lookup(frame, Time())

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
    """Colliders, handles and grippers that follow a frame of tf, or a link of the robot."""

    def __init__(self, frames: Frames, log: Any):
        self._frames, self._log = frames, log
        self._stamps: dict[str, float] = {}
        self._since: dict[str, float] = {}
        self._told: dict[str, str] = {}

    def advance(self, tracks: Mapping[str, PoseTrack], values: Mapping[str, Any], mounts: Mounts) -> list[str]:
        """Push the newest pose of every followed frame to its track; warn once of frames that are late or unknown.

        mounts: the parts of the robot. Returns the parts that are located for the first time; they rest at their pose
        already.
        """
        troubles: dict[str, str] = {}
        located = []
        for name, track in tracks.items():
            frame, offset = mounts.get(name) or (values.get(f"{name}.follow_frame"), None)  # fingers have none
            if not frame:
                continue
            try:
                if self._follow(name, track, frame, offset, values["pose_timeout"]):
                    located.append(name)
            except ValueError as reason:
                whose, what = ("robot", f"the robot's link {frame}") if offset is not None else (name, name)
                troubles.setdefault(whose, f"{what} stays where it is: {reason}")
        for whose, sentence in troubles.items():
            if self._told.get(whose) != sentence:
                self._log.warning(sentence)
        self._told = troubles
        return located

    def _follow(self, name: str, track: PoseTrack, frame: str, offset: Pose | None, timeout: float) -> bool:
        """Push the newest pose of a frame; return True if it locates a part of the robot for the first time.

        Raises ValueError, in words that follow "stays where it is: ".
        """
        now = time.monotonic()
        stamp, pose = self._frames.place(frame)
        pose = checked(pose if offset is None else composed(pose, offset))
        if stamp != self._stamps.get(name):
            is_first = name not in self._stamps
            self._stamps[name], self._since[name] = stamp, now
            if is_first and offset is not None:
                track.rest(pose)
                return True
            try:
                track.push(stamp or None, pose, now)
            except ValueError as error:
                raise ValueError(f"of frame {shown(frame)}, {error}") from None
        elif stamp and now - self._since[name] > timeout:
            raise ValueError(f"of frame {shown(frame)}, nothing newer has come for {timeout:g} s")
        return False
