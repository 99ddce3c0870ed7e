# SPDX-License-Identifier: Apache-2.0
"""Read a bag as a recording of a cable: positions of markers, and forces on the hand that holds its start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cloth_sim_ros.identify.taken import LONGEST, Taken, points_of, taken
from cloth_sim_ros.identify.transforms import Transforms
from cloth_sim_ros.options import missing
from cloth_sim_ros.record.topics import CLOUD, WRENCH, Topics

_GAP = 1.5  # longest gap without lost messages, in median intervals of the topic
_THERE = 0.05  # share of that interval around a message within which its value is taken as known


def _place(position: Any) -> np.ndarray:
    return np.array([[position.x, position.y, position.z]])


_MARKERS = {
    CLOUD: points_of,
    "geometry_msgs/msg/PoseArray": lambda message, topic: np.concatenate(
        [np.zeros((0, 3)), *(_place(pose.position) for pose in message.poses)]
    ),
    "geometry_msgs/msg/PoseStamped": lambda message, topic: _place(message.pose.position),
    "geometry_msgs/msg/PointStamped": lambda message, topic: _place(message.point),
}
_FORCES = {WRENCH: lambda message, topic: _place(message.wrench.force)}


@dataclass(frozen=True)
class CableTopics:
    """Topics of a bag that show a cable.

    markers: in their order along it; a message holds one or several. wrenches: forces on the hand at the start, which
    are added. frame: a frame whose z is up; "" is the frame of the first markers.
    """

    markers: Sequence[str] = ()
    wrenches: Sequence[str] = ()
    frame: str = ""

    def read(self, path: Path) -> tuple[np.ndarray, float, np.ndarray | None]:
        """Return markers (F, M, 3) [m], frames a second, and forces (F, 3) [N] or None.

        Frames are even in time, from the latest first message to the earliest last message of the topics. Their
        interval is near the median one of the first topic. Values between messages are interpolated linearly; markers
        are NaN where messages were lost. Raises ValueError in one sentence if the bag cannot be read so.
        """
        if lack := missing("rosbags"):
            raise ValueError(lack)
        if not self.markers:
            raise ValueError(f"{path} is a bag; allowed are bags with --markers /TOPIC, of markers in their order")
        bag = Topics(path)
        frames = Transforms(bag)
        first = taken(bag, frames, self.frame, self.markers[0], _MARKERS)
        ours = self.frame or first.frame
        seen = [first, *(taken(bag, frames, ours, topic, _MARKERS) for topic in self.markers[1:])]
        felt = [taken(bag, frames, ours, topic, _FORCES) for topic in self.wrenches]
        times = _even([each.place.times for each in [*seen, *felt]], path)
        markers = []
        for each in seen:
            stamps, rows = each.place.times, _moved(each, path) + each.place.positions[:, None]
            markers.append(np.where(_lost(times, stamps)[:, None, None], np.nan, _at(times, stamps, rows)))
        forces = sum(_at(times, each.place.times, _moved(each, path))[:, 0] for each in felt) if felt else None
        return np.concatenate(markers, axis=1), 1e9 / (times[1] - times[0]), forces


def _even(stamps: list[np.ndarray], path: Path) -> np.ndarray:
    """Return even times (F,) [ns] of the span in which all topics have messages."""
    begin, end = max(each[0] for each in stamps), min(each[-1] for each in stamps)
    first = stamps[0][(stamps[0] >= begin) & (stamps[0] <= end)]
    if len(first) < 2:
        raise ValueError(f"the topics in {path} have no time in common; allowed are stamps of one clock")
    span = first[-1] - first[0]
    if 1e-9 * span > LONGEST:
        raise ValueError(f"stamps in {path} are {1e-9 * span:.0f} s apart; allowed are at most {LONGEST:g} s")
    return np.linspace(first[0], first[-1], 1 + round(span / np.median(np.diff(first))))


def _moved(each: Taken, path: Path) -> np.ndarray:
    """Return the rows (F, M, 3) of all messages, turned into our axes.

    Raises ValueError if messages have different numbers of markers.
    """
    counts = sorted({len(rows) for rows in each.rows.values()})
    if len(counts) > 1:
        raise ValueError(
            f"{each.topic} has messages of {counts[0]} to {counts[-1]} markers in {path}; allowed are as many in each"
        )
    return np.einsum("fij,fmj->fmi", each.place.turns.as_matrix(), np.stack(list(each.rows.values())))


def _at(times: np.ndarray, stamps: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Interpolate rows (F, M, 3) of `stamps` linearly at other times."""
    columns = [np.interp(times, stamps, column) for column in rows.reshape(len(rows), -1).T]
    return np.transpose(columns).reshape(len(times), -1, 3)


def _lost(times: np.ndarray, stamps: np.ndarray) -> np.ndarray:
    """Return True (F,) for each time around which messages were lost."""
    behind = np.clip(np.searchsorted(stamps, times), 1, len(stamps) - 1)
    gaps, usual = stamps[behind] - stamps[behind - 1], np.median(np.diff(stamps))
    away = np.minimum(np.abs(times - stamps[behind - 1]), np.abs(times - stamps[behind]))
    return (gaps > _GAP * usual) & (away > _THERE * usual)
