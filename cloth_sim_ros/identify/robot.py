# SPDX-License-Identifier: Apache-2.0
"""Read a bag of a robot as a Recording: clouds of its depth camera, and poses of its hands and of what it moves."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cloth_sim_ros.identify.recording import Recording
from cloth_sim_ros.identify.taken import LONGEST, Taken, points_of, taken
from cloth_sim_ros.identify.transforms import Track, Transforms, numbers
from cloth_sim_ros.record.topics import CLOUD, Topics
from cloth_sim_ros.ros.parameters.plan import Plan  # noqa: TID251 (free of rclpy)

POSE = "geometry_msgs/msg/PoseStamped"
_MOST_POINTS = 2000  # most points of a cloud, as each is compared with every particle


def robot_recording(
    path: Path, plan: Plan, points: Mapping[str, str], poses: Mapping[str, str], begin: float
) -> tuple[Recording, list[str]]:
    """Return the recording of a scene in a bag, and a sentence on each topic.

    Args:
        path: The bag.
        plan: The scene and its frame.
        points: Object -> topic of clouds.
        poses: Collider or handle -> topic of poses.
        begin: Time 0 of the scene [s], after the first stamp that is used.

    Raises ValueError in one sentence if the bag does not fit the scene.
    """
    _check("--points", points, plan.scene.objects)
    _check("--poses", poses, {**plan.scene.colliders, **plan.scene.handles})
    if not np.isfinite(begin):
        raise ValueError(f"--begin is {begin}; allowed is a number of seconds")
    bag = Topics(path)
    frames = Transforms(bag)
    clouds = {name: taken(bag, frames, plan.frame_id, topic, {CLOUD: _points}) for name, topic in points.items()}
    moves = {name: taken(bag, frames, plan.frame_id, topic, {POSE: _pose}) for name, topic in poses.items()}
    zero = min(int(each.place.times[0]) for each in [*clouds.values(), *moves.values()]) + round(1e9 * begin)
    stamps = np.unique(np.concatenate([each.place.times for each in clouds.values()]))
    stamps = stamps[stamps >= zero]
    if not len(stamps):
        raise ValueError(f"--begin is {begin:g}, and {path} has no cloud after that; allowed is an earlier time [s]")
    tracks = {name: each.place.after(Track.of(each.rows, each.topic)) for name, each in moves.items()}
    end = max(int(each[-1]) for each in [stamps, *(track.times for track in tracks.values())])
    if 1e-9 * (end - zero) > LONGEST:
        topics = ", ".join([*points.values(), *poses.values()])
        raise ValueError(
            f"stamps of {topics} are {1e-9 * (end - zero):.0f} s apart in {path}; "
            f"allowed are those of one clock, and at most {LONGEST:g} s"
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


def _check(option: str, topics: Iterable[str], known: Iterable[str]) -> None:
    for name in topics:
        if name not in known:
            raise ValueError(f"{option} names {name}; allowed of this scene is {', '.join(known) or 'none'}")


def _seen(cloud: Taken, stamps: np.ndarray) -> np.ndarray:
    """Return points (F, M, 3) in our frame at `stamps`, padded with NaN."""
    found = np.full((len(stamps), max(1, *map(len, cloud.rows.values())), 3), np.nan)
    for k, (stamp, rows) in enumerate(cloud.rows.items()):
        if stamp >= stamps[0] and len(rows):
            f = np.searchsorted(stamps, stamp)
            found[f, : len(rows)] = cloud.place.turns[k].apply(rows) + cloud.place.positions[k]
    return found


def _pose(message: Any, topic: str) -> np.ndarray:
    return np.array(numbers(message.pose.position, message.pose.orientation))


def _points(cloud: Any, topic: str) -> np.ndarray:
    """Return the finite points (N, 3) of a cloud, evenly thinned."""
    points = points_of(cloud, topic)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) <= _MOST_POINTS:
        return points
    return points[np.linspace(0, len(points) - 1, _MOST_POINTS).astype(int)]
