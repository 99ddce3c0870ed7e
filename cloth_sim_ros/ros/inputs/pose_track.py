# SPDX-License-Identifier: Apache-2.0
"""A stream of stamped poses, played back on the simulation's own clock.

Messages arrive with jitter and at any rate; a collider that jumped to each as it came would hit the cloth at the wrong
speed. So the track moves between the received poses at the pace of their stamps: position linearly, orientation
spherically. It never extrapolates: when nothing newer has come, the collider stays at the last pose. The delay is what
it takes for the next message to arrive, about one period of the sender. A sender at or above the frame rate is followed
within a frame or two.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


@dataclass(frozen=True)
class Pose:
    """position [m], orientation as unit quaternion x y z w."""

    position: Vector
    orientation: Quaternion

    @classmethod
    def of(cls, values: Mapping[str, Any], name: str) -> Pose:
        """Return the pose in the parameters of `name`."""
        return cls(values[f"{name}.position"], values[f"{name}.orientation"])


def composed(outer: Pose, inner: Pose) -> Pose:
    """Return the pose `inner`, given in the axes of `outer`.

    It uses plain numbers, as it runs for each link in each frame.
    """
    a, b, c, w = outer.orientation
    x, y, z = inner.position
    p, q, r = 2.0 * (b * z - c * y), 2.0 * (c * x - a * z), 2.0 * (a * y - b * x)
    i, j, k = outer.position
    place = i + (x + w * p + b * r - c * q), j + (y + w * q + c * p - a * r), k + (z + w * r + a * q - b * p)
    d, e, f, v = inner.orientation
    turn = (
        w * d + v * a + b * f - c * e,
        w * e + v * b + c * d - a * f,
        w * f + v * c + a * e - b * d,
        w * v - a * d - b * e - c * f,
    )
    return Pose(place, turn)


class PoseTrack:
    """A track of poses: `push` from the thread that receives, `advance` once a frame from the thread that simulates.

    timeout [s]: a longer gap between two stamps is a jump, reached within one frame. After as long a silence any stamp
    starts the track anew (a sender restarted, a recording looped).
    """

    def __init__(self, start: Pose, timeout: float):
        self.pose = start
        self.timeout = timeout
        self._lock = threading.Lock()
        self._ahead: deque[tuple[float, Pose]] = deque(maxlen=1024)
        self._now: float | None = None  # on the sender's clock
        self._newest: float | None = None
        self._newest_arrival = -math.inf
        self._stamped = False

    def push(self, stamp: float | None, pose: Pose, arrival: float) -> float:
        """Add a pose sent at `stamp` [s], or without a stamp (None), that came at `arrival` [s].

        Returns how far [m] the next frame moves to it, if it begins the track or comes after a gap; else 0. Raises
        ValueError if it is not newer, or has no stamp while another sender's poses have.
        """
        with self._lock:
            restarted = arrival - self._newest_arrival > self.timeout
            stamped = stamp is not None
            if not stamped and self._stamped and not restarted:
                raise ValueError("it has no stamp, while another sender's poses have")
            if stamped != self._stamped:
                self._newest = None
            self._stamped = stamped
            stamp = stamp if stamped else arrival
            if self._newest is not None and stamp <= self._newest and not restarted:
                back = self._newest - stamp
                raise ValueError(f"its stamp is {back:.6f} s behind the one before" if back else "its stamp repeats")
            jump = 0.0
            if self._newest is None or not 0 < stamp - self._newest <= self.timeout:
                self._ahead.clear()
                self._now = None
                jump = math.dist(self.pose.position, pose.position)
            self._ahead.append((stamp, pose))
            self._newest, self._newest_arrival = stamp, arrival
            return jump

    def restart(self) -> None:
        """Stay at the current pose; the next pose may have any stamp, as clocks have gone back."""
        with self._lock:
            self._ahead.clear()
            self._now = self._newest = None

    def rest(self, pose: Pose) -> None:
        """Set the current pose, without a motion; the next pose may have any stamp."""
        with self._lock:
            self._ahead.clear()
            self._now = self._newest = None
            self.pose = pose

    def place(self, pose: Pose) -> None:
        """Move to `pose` within the next frame; later messages move on from there."""
        with self._lock:
            self._ahead.clear()
            self._ahead.append((self._newest or 0.0, pose))
            self._now = None

    def advance(self, frame_dt: float) -> Pose | None:
        """Return the pose at the end of the coming frame of `frame_dt` [s], or None if it does not move."""
        with self._lock:
            if not self._ahead:
                return None
            if self._now is None:
                self._now, self.pose = self._ahead[-1]
                self._ahead.clear()
                return self.pose
            self._play(self._pace(frame_dt))
            return self.pose

    def _pace(self, frame_dt: float) -> float:
        """Return the seconds of the sender's clock to play in this frame: `frame_dt`, or more to lag by at most two
        periods.

        The lag is larger if frames take longer than they last, and after a pause.
        """
        newest = self._ahead[-1][0]
        period = newest - (self._ahead[-2][0] if len(self._ahead) > 1 else self._now)
        return max(frame_dt, newest - self._now - 2 * max(period, frame_dt))

    def _play(self, seconds: float) -> None:
        now = self._now + seconds
        while self._ahead and self._ahead[0][0] <= now:
            self._now, self.pose = self._ahead.popleft()
        if not self._ahead:  # everything played: wait here, so that the next interval starts at this pose
            return
        stamp, target = self._ahead[0]
        self.pose = between(self.pose, target, (now - self._now) / (stamp - self._now))
        self._now = now


def between(a: Pose, b: Pose, fraction: float) -> Pose:
    """Return the pose `fraction` of the way from a to b, turning the shorter way. In plain numbers, as `composed`."""
    if a == b:
        return a  # to the bit, so that who stands still is seen to
    (x, y, z), (p, q, r) = a.position, b.position
    position = x + fraction * (p - x), y + fraction * (q - y), z + fraction * (r - z)
    (c, d, e, v), (f, g, h, w) = a.orientation, b.orientation
    cosine = c * f + d * g + e * h + v * w
    sign = math.copysign(1.0, cosine)
    angle = math.acos(min(1.0, abs(cosine)))
    if angle < 1e-6:
        begin, end = 1.0 - fraction, sign * fraction
    else:
        begin = math.sin((1.0 - fraction) * angle) / math.sin(angle)
        end = sign * math.sin(fraction * angle) / math.sin(angle)
    c, d, e, v = begin * c + end * f, begin * d + end * g, begin * e + end * h, begin * v + end * w
    norm = math.sqrt(c * c + d * d + e * e + v * v)
    return Pose(position, (c / norm, d / norm, e / norm, v / norm))
