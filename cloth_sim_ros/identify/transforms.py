# SPDX-License-Identifier: Apache-2.0
"""Poses over time, and the tree of a bag's frames from /tf_static and /tf."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from cloth_sim_ros.record.topics import Topics
from cloth_sim_ros.sim.physics.quaternion import unit_quaternions

_TOPICS = ("/tf_static", "/tf")
_ALWAYS = 1 << 62  # a time [ns] after all stamps, and negated before them
_MOST_TOLD = 12  # most transforms that a sentence names


@dataclass(frozen=True)
class Track:
    """Poses at `times` (T,) [ns], which rise: positions (T, 3) [m], and as many rotations."""

    times: np.ndarray
    positions: np.ndarray
    turns: Rotation

    @staticmethod
    def of(rows: dict[int, Sequence[float]], name: str) -> Track:
        """Return a track from stamps [ns] -> x y z [m], x y z w. Raises ValueError, which names `name`, for an invalid
        pose."""
        times = np.array(sorted(rows), dtype=np.int64)
        poses = np.array([rows[time] for time in times.tolist()], dtype=np.float64)
        if not np.isfinite(poses[:, :3]).all():
            raise ValueError(f"the position of {name} is not finite everywhere; allowed are numbers [m]")
        quaternions = unit_quaternions(poses[:, 3:], f"the orientation of {name}", len(poses))
        return Track(times, poses[:, :3], Rotation.from_quat(quaternions))

    def at(self, times: np.ndarray) -> Track:
        """Return the track at other times: linear and slerp between its poses, constant beyond its ends."""
        if len(self.times) == 1:
            here = np.zeros(len(times), dtype=int)
            return Track(times, self.positions[here], self.turns[here])
        within = np.clip(times, self.times[0], self.times[-1])
        positions = np.column_stack([np.interp(within, self.times, column) for column in self.positions.T])
        return Track(times, positions, Slerp(self.times, self.turns)(within))

    def after(self, inner: Track) -> Track:
        """Return poses `inner`, given in the axes of this track at the same times, in this track's parent."""
        return Track(self.times, self.positions + self.turns.apply(inner.positions), self.turns * inner.turns)

    def inverse(self) -> Track:
        """Return the inverse poses: those of the parent in these axes."""
        turns = self.turns.inv()
        return Track(self.times, -turns.apply(self.positions), turns)


class Transforms:
    """The tree of frames of a bag. Raises ValueError for an invalid transform."""

    def __init__(self, bag: Topics):
        rows: dict[str, dict[int, Sequence[float]]] = {}
        self._path, self._parents = bag.path, dict[str, str]()
        for topic in _TOPICS:
            for message in bag.messages(topic):
                for each in message.transforms:
                    self._parents[each.child_frame_id] = each.header.frame_id
                    pose = numbers(each.transform.translation, each.transform.rotation)
                    stamps = (-_ALWAYS, _ALWAYS) if topic == "/tf_static" else (nanoseconds(each.header),)
                    rows.setdefault(each.child_frame_id, {}).update(dict.fromkeys(stamps, pose))
        self._tracks = {child: Track.of(found, f"transform '{child}'") for child, found in rows.items()}

    def place(self, frame: str, ours: str, times: np.ndarray) -> tuple[np.ndarray, Track]:
        """Return a mask (T,) of the `times` [ns] at which the pose of `frame` in `ours` is known, and its track at
        these.

        An empty frame is ours. Raises ValueError if no transforms connect the two.
        """
        up, down = self._chain(frame or ours), self._chain(ours)
        shared = next((each for each in up if each in down), None)
        if shared is None:
            raise ValueError(
                f"{self._path} has no transform between '{frame}' of its messages and '{ours}' of the scene; "
                f"it has {self._told()}"
            )
        up, down = up[: up.index(shared)], down[: down.index(shared)]
        tracks = [self._tracks[child] for child in up + down]
        first = max((track.times[0] for track in tracks), default=-_ALWAYS)
        last = min((track.times[-1] for track in tracks), default=_ALWAYS)
        known = (times >= first) & (times <= last)
        return known, self._climbed(down, times[known]).inverse().after(self._climbed(up, times[known]))

    def _chain(self, frame: str) -> list[str]:
        """Return a frame and its ancestors, up to the root."""
        found = [frame]
        while self._parents.get(found[-1], frame) not in found:
            found.append(self._parents[found[-1]])
        return found

    def _climbed(self, children: list[str], times: np.ndarray) -> Track:
        """Return the poses of the first of these frames in the parent of the last."""
        found = Track(times, np.zeros((len(times), 3)), Rotation.identity(len(times)))
        for child in children:
            found = self._tracks[child].at(times).after(found)
        return found

    def _told(self) -> str:
        pairs = [f"'{child}' in '{parent}'" for child, parent in sorted(self._parents.items())]
        more = [f"{len(pairs) - _MOST_TOLD} more"] if len(pairs) > _MOST_TOLD else []
        return ", ".join(pairs[:_MOST_TOLD] + more) or "none at all"


def nanoseconds(header: Any) -> int:
    """Return the stamp of a std_msgs/Header [ns]."""
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


def numbers(position: Any, orientation: Any) -> tuple[float, ...]:
    """Return the fields x y z and x y z w of messages."""
    p, q = position, orientation
    return p.x, p.y, p.z, q.x, q.y, q.z, q.w
