# SPDX-License-Identifier: Apache-2.0
"""Convert messages to plain commands that are finite, in our frame and of a sensible size. Raises Refused otherwise."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import PolygonStamped, PoseStamped, Vector3Stamped
from rclpy.time import Time
from std_msgs.msg import Float64
from visualization_msgs.msg import Marker

from cloth_sim_ros import parameters
from cloth_sim_ros.ros.inputs.frames import FARTHEST, Frames, Refused, bounded, checked
from cloth_sim_ros.ros.inputs.pose_track import Pose, PoseTrack, Vector
from cloth_sim_ros.ros.parameters.plan import placed
from cloth_sim_ros.sim import Box, Cylinder, Sphere
from cloth_sim_ros.sim.access.cuts import plane_of
from cloth_sim_ros.sim.colliders.collider import Collider

STRONGEST_WIND = parameters.row(parameters.WIND, "velocity").high  # [m/s]
FAR = 0.1  # [m] moved in one frame, beyond which a collider may fling what it meets
ROUND = 1e-3  # largest relative difference of the diameters of a sphere or a cylinder


def read_pose(message: PoseStamped | Marker, frames: Frames) -> Pose:
    """Return the message's pose in our frame. Raises Refused."""
    p, q = message.pose.position, message.pose.orientation
    pose = checked(Pose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w)))
    return checked(frames.pose(pose, message.header.frame_id, _stamp(message)))


def name_of(marker: Marker) -> str:
    """Return the name of a marker's collider."""
    return f"{marker.ns}/{marker.id}"


def read_marker(marker: Marker, frames: Frames) -> Collider:
    """Return the collider that a marker describes. Raises Refused."""
    place = placed(read_pose(marker, frames))
    x, y, z = marker.scale.x, marker.scale.y, marker.scale.z
    try:
        if marker.type == Marker.CUBE:
            return Box(half_extents=(x / 2, y / 2, z / 2), **place)
        if marker.type == Marker.SPHERE and max(x, y, z) - min(x, y, z) <= ROUND * max(x, y, z):
            return Sphere(radius=x / 2, **place)
        if marker.type == Marker.CYLINDER and abs(x - y) <= ROUND * max(x, y):
            return Cylinder(radius=x / 2, half_length=z / 2, **place)
    except ValueError as error:
        raise Refused("size", f"{name_of(marker)} has the scale {x:g} {y:g} {z:g}: {error}") from None
    raise Refused(
        "shape",
        f"{name_of(marker)} is of type {marker.type} and scale {x:g} {y:g} {z:g}; allowed are cubes, and spheres and "
        "cylinders that are round",
    )


def read_wind(message: Vector3Stamped, frames: Frames) -> Vector:
    """Return the message's wind velocity [m/s] in our frame. Raises Refused."""
    v = message.vector
    velocity = bounded((v.x, v.y, v.z), STRONGEST_WIND, "velocity", "m/s")
    return frames.vector(velocity, message.header.frame_id, _stamp(message))


def read_number(message: Float64, what: str) -> float:
    """Return the message's number. `what` names it in errors. Raises Refused."""
    if not math.isfinite(message.data):
        raise Refused("finite", f"its {what} {message.data:g} is not finite")
    return message.data


def read_polygon(message: PolygonStamped, frames: Frames) -> list[Vector]:
    """Return the corners of the message's polygon [m] in our frame. Raises Refused."""
    stamp, frame, corners = _stamp(message), message.header.frame_id, []
    if len(message.polygon.points) < 3:
        raise Refused("corners", f"its polygon has {len(message.polygon.points)} corners; allowed are 3 or more")
    for p in message.polygon.points:
        corner = Pose(bounded((p.x, p.y, p.z), FARTHEST, "corner", "m"), (0.0, 0.0, 0.0, 1.0))
        corners.append(bounded(frames.pose(corner, frame, stamp).position, FARTHEST, "corner", "m"))
    try:
        plane_of(corners)
    except ValueError as error:
        raise Refused("polygon", str(error)) from None
    return corners


def follow(track: PoseTrack, message: PoseStamped, frames: Frames) -> float:
    """Push the message's pose to `track`; return how far [m] it jumps, see PoseTrack.push. Raises Refused.

    A stamp of zero, as hand-typed messages have, means now.
    """
    pose, arrival = read_pose(message, frames), time.monotonic()
    stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
    try:
        return track.push(stamp or None, pose, arrival)
    except ValueError as error:
        raise Refused("stamp", str(error)) from None


def _stamp(message: PoseStamped | Marker | Vector3Stamped | PolygonStamped) -> Time:
    """Return the message's stamp. Raises Refused if it is negative."""
    if message.header.stamp.sec < 0:
        raise Refused("stamp", f"its stamp is {message.header.stamp.sec} s; allowed are stamps from 0 on")
    return Time.from_msg(message.header.stamp)


class Complaints:
    """Log of refused messages, at most one sentence in `period` [s] for each topic and kind of trouble.

    log: any object with info() and warning(). refused: number of refused messages.
    """

    def __init__(self, log: Any, period: float = 5.0):
        self.refused = 0
        self._log = log
        self._period = period
        self._last: dict[tuple[str, str], float] = {}

    def refuse(self, topic: str, reason: Refused) -> None:
        """Count a refused message on `topic` and log the reason."""
        self.refused += 1
        self._warn(topic, reason.kind, f"a message on {topic} is refused: {reason}")

    def cut(self, topic: str, sentence: str) -> None:
        """Log that a value of a message on `topic` is clipped to a limit."""
        self._warn(topic, "cut", f"a message on {topic} is cut: {sentence}")

    def ignore(self, topic: str, sentence: str) -> None:
        """Log why a message on `topic` has no effect, which may be intended."""
        self._warn(topic, "ignore", f"a message on {topic} has no effect: {sentence}")

    def jump(self, topic: str, way: float, is_empty: Callable[[], bool] = lambda: False) -> None:
        """Log that a message on `topic` moves its target by `way` [m] in one frame, if that is far.

        is_empty: True for a hand that holds nothing; it is asked only then, as it waits for the device. It is no
        warning: a user who drags by hand pauses, and goes on as fast.
        """
        if way > FAR and self._is_due(topic, "jump"):
            why = "its pose is the first, or came after a pause of more than pose_timeout; poses at 30 Hz go smoothly"
            why = "it holds nothing, so nothing goes with it" if is_empty() else why
            self._log.info(f"{topic} goes {way:.3g} m in one frame: {why}")

    def _warn(self, topic: str, kind: str, sentence: str) -> None:
        if self._is_due(topic, kind):
            self._log.warning(sentence)

    def _is_due(self, topic: str, kind: str) -> bool:
        now = time.monotonic()
        is_due = now - self._last.get((topic, kind), -math.inf) >= self._period
        if is_due:
            self._last[topic, kind] = now
        return is_due
