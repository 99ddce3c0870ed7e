# SPDX-License-Identifier: Apache-2.0
"""A bag of a robot as a Recording: clouds of its depth camera, and poses of its hands and of what it moves."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cloth_sim_ros.identify.recording import Recording
from cloth_sim_ros.identify.transforms import Track, Transforms, nanoseconds, numbers
from cloth_sim_ros.record.topics import CLOUD, Topics
from cloth_sim_ros.ros.parameters.plan import Plan  # noqa: TID251 (free of rclpy)

POSE = "geometry_msgs/msg/PoseStamped"
_MOST_POINTS = 2000  # of a cloud: each is compared with every particle
_LONGEST = 3600.0  # [s]: stamps further apart are of different clocks
_FORMATS = {7: "f4", 8: "f8"}  # of sensor_msgs/PointField


def robot_recording(
    path: Path, plan: Plan, points: Mapping[str, str], poses: Mapping[str, str], begin: float
) -> tuple[Recording, list[str]]:
    """What a bag shows of a scene, and a sentence on each topic.

    points: object -> topic; poses: collider or handle -> topic. Time 0 is `begin` [s] after the first stamp that is
    used. Raises ValueError, in one sentence, for what cannot be.
    """
    _check("--points", points, plan.scene.objects)
    _check("--poses", poses, {**plan.scene.colliders, **plan.scene.handles})
    if not np.isfinite(begin):
        raise ValueError(f"--begin is {begin}; allowed is a number of seconds")
    bag = Topics(path)
    frames = Transforms(bag)
    clouds = {name: _taken(bag, frames, plan.frame_id, topic, CLOUD) for name, topic in points.items()}
    moves = {name: _taken(bag, frames, plan.frame_id, topic, POSE) for name, topic in poses.items()}
    zero = min(int(each.place.times[0]) for each in [*clouds.values(), *moves.values()]) + round(1e9 * begin)
    stamps = np.unique(np.concatenate([each.place.times for each in clouds.values()]))
    stamps = stamps[stamps >= zero]
    if not len(stamps):
        raise ValueError(f"--begin is {begin:g}, and {path} has no cloud after that; allowed is an earlier time [s]")
    tracks = {name: each.place.after(Track.of(each.rows, each.topic)) for name, each in moves.items()}
    end = max(int(each[-1]) for each in [stamps, *(track.times for track in tracks.values())])
    if 1e-9 * (end - zero) > _LONGEST:
        topics = ", ".join([*points.values(), *poses.values()])
        raise ValueError(
            f"stamps of {topics} are {1e-9 * (end - zero):.0f} s apart in {path}; "
            f"allowed are those of one clock, and at most {_LONGEST:g} s"
        )
    frame_dt = plan.settings.frame_dt
    grid = frame_dt * np.arange(np.ceil(1e-9 * (end - zero) / frame_dt) + 1)
    pose = {name: track.at(zero + np.rint(1e9 * grid).astype(np.int64)) for name, track in tracks.items()}
    recording = Recording(
        1e-9 * (stamps - zero),
        points={name: _seen(each, stamps) for name, each in clouds.items()},
        pose={name: np.column_stack([track.positions, track.turns.as_quat()]) for name, track in pose.items()},
        pose_times=grid,
    )
    said = [
        each.told(f"show {name}, with at most {_MOST_POINTS} points each", zero, zero) for name, each in clouds.items()
    ]
    return recording, said + [
        each.told(f"move {name}, which stays before and after", zero, None) for name, each in moves.items()
    ]


@dataclass(frozen=True)
class _Taken:
    """What was taken of messages: rows by stamp [ns], where their frame is then, and how many messages there are."""

    topic: str
    rows: dict[int, Any]
    place: Track
    count: int

    def told(self, words: str, zero: int, first: int | None) -> str:
        """One sentence on the messages from a stamp on."""
        times = self.place.times if first is None else self.place.times[self.place.times >= first]
        span = f"from {1e-9 * (times[0] - zero):.3g} to {1e-9 * (times[-1] - zero):.3g} s " if len(times) else ""
        return f"{self.topic}: {len(times)} of {self.count} messages, {span}after the start, {words}."


def _check(option: str, topics: Iterable[str], known: Iterable[str]) -> None:
    for name in topics:
        if name not in known:
            raise ValueError(f"{option} names {name}; allowed of this scene is {', '.join(known) or 'none'}")


def _taken(bag: Topics, frames: Transforms, ours: str, topic: str, kind: str) -> _Taken:
    """All messages of a topic for which it is known where they are in our frame. Raises ValueError."""
    if bag.types.get(topic) != kind:
        has = f"is {bag.types[topic]}" if topic in bag.types else "is not there"
        allowed = ", ".join(sorted(name for name, other in bag.types.items() if other == kind))
        raise ValueError(f"{topic} {has} in {bag.path}; allowed is a topic of {kind}: {allowed or 'it has none'}")
    take: Callable[[Any, str], np.ndarray] = _points if kind == CLOUD else _pose
    rows, places, count = {}, set(), 0
    for message in bag.messages(topic):
        rows[nanoseconds(message.header)] = take(message, topic)
        places.add(message.header.frame_id)
        count += 1
    if len(places) != 1:
        has = f"messages in the frames {', '.join(sorted(places))}" if places else "no messages"
        raise ValueError(f"{topic} has {has} in {bag.path}; allowed are messages in one frame")
    if len(rows) < min(count, 2):
        raise ValueError(f"all {count} messages of {topic} have one stamp in {bag.path}; allowed are stamps that rise")
    stamps = np.array(sorted(rows), dtype=np.int64)
    (frame,) = places
    known, place = frames.place(frame, ours, stamps)
    if not known.any():
        raise ValueError(
            f"{bag.path} has transforms between '{frame}' of {topic} and '{ours}' of the scene at other times only; "
            "allowed are messages between the first of them and the last"
        )
    return _Taken(topic, {stamp: rows[stamp] for stamp in stamps[known].tolist()}, place, count)


def _seen(cloud: _Taken, stamps: np.ndarray) -> np.ndarray:
    """(F, M, 3) points in our frame at `stamps`, not a number where there are fewer."""
    found = np.full((len(stamps), max(1, *map(len, cloud.rows.values())), 3), np.nan)
    for k, (stamp, rows) in enumerate(cloud.rows.items()):
        if stamp >= stamps[0] and len(rows):
            f = np.searchsorted(stamps, stamp)
            found[f, : len(rows)] = cloud.place.turns[k].apply(rows) + cloud.place.positions[k]
    return found


def _pose(message: Any, topic: str) -> np.ndarray:
    return np.array(numbers(message.pose.position, message.pose.orientation))


def _points(cloud: Any, topic: str) -> np.ndarray:
    """(N, 3) finite points of a cloud, evenly thinned."""
    fields = {each.name: each for each in cloud.fields}
    if not all(name in fields and fields[name].datatype in _FORMATS for name in "xyz"):
        raise ValueError(f"{topic} has clouds of {', '.join(fields)}; allowed are x, y and z of 32 or 64 bits")
    order = ">" if cloud.is_bigendian else "<"
    formats = [order + _FORMATS[fields[name].datatype] for name in "xyz"]
    try:
        layout = {"names": list("xyz"), "formats": formats, "offsets": [fields[name].offset for name in "xyz"]}
        dtype = np.dtype({**layout, "itemsize": cloud.point_step})
        lines = np.asarray(cloud.data).reshape(cloud.height, cloud.row_step)[:, : cloud.width * cloud.point_step]
        rows = np.ascontiguousarray(lines).reshape(cloud.height * cloud.width, cloud.point_step).view(dtype)
    except ValueError:
        raise ValueError(
            f"{topic} has a cloud of {len(cloud.data)} bytes that are not {cloud.height} rows of {cloud.width} points; "
            f"allowed are {cloud.row_step} bytes a row and {cloud.point_step} a point"
        ) from None
    points = np.column_stack([rows[name].ravel() for name in "xyz"]).astype(np.float64)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) <= _MOST_POINTS:
        return points
    return points[np.linspace(0, len(points) - 1, _MOST_POINTS).astype(int)]
