# SPDX-License-Identifier: Apache-2.0
"""Read a bag of a node as a Recording: the particles that the node sent, and the poses that moved them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cloth_sim_ros.identify.recording import Recording
from cloth_sim_ros.record.bag import Bag, Stamp
from cloth_sim_ros.record.run import Acts, clouds_of, first_run
from cloth_sim_ros.sim import Scene

Poses = dict[str, tuple]  # collider or handle -> position [m] and orientation


def recording_of(path: Path, scene: Scene, frame_dt: float) -> Recording:
    """Return the recording of `scene` in the first run of a bag, from its last ~/reset on, when all objects start from
    rest.

    frame_dt [s] is that of the scene. Times count frames, so a node that was late changes nothing. Raises ValueError in
    one sentence if the bag does not fit the scene or has no such run.
    """
    bag = Bag(path)
    start, entries = first_run(bag)
    rate = start["parameters"]["rate"]
    if abs(rate * frame_dt - 1.0) > 1e-6:
        raise ValueError(f"{path} has {rate:g} frames a second; allowed are the {1.0 / frame_dt:g} of the scene")
    owners = {**scene.colliders, **scene.handles}
    poses = {name: (each.position, each.orientation) for name, each in owners.items()} | start["poses"]
    frames = frames_of(path, entries, poses)
    pose = {}
    for name, owner in owners.items():
        rows = np.array([np.concatenate(where[name]) for _, _, where in frames], dtype=np.float64)
        if not np.allclose(rows, np.concatenate([owner.position, owner.orientation]), atol=1e-9):
            pose[name] = rows
    stamps = [stamp for stamp, _, _ in frames]
    seen = {name: _rows(clouds_of(bag, name), stamps) for name in bag.objects if name in scene.objects}
    return Recording(frame_dt * np.array([count for _, count, _ in frames]), positions=seen, pose=pose)


def frames_of(path: Path, entries: Acts, poses: Poses) -> list[tuple[Stamp | None, int, Poses]]:
    """Return stamp, number, and poses of colliders and handles at the end, for each frame since the last reset.

    The first entry is the start, with stamp None. poses: those at the beginning of the run. Raises ValueError for
    inputs other than poses, and if no frame follows a reset.
    """
    found: list[tuple[Stamp | None, int, Poses]] = []
    was_reset, count = False, 0
    for stamp, acts in entries:
        for act, *arguments in acts:
            if act == "reset":
                found, was_reset, count = [(None, 0, dict(poses))], True, 0
            elif act == "move":
                poses[arguments[0]] = tuple(arguments[1:])
            elif act == "advance":
                count += 1
            else:
                raise ValueError(f"{path} has the input {act}; allowed are bags in which nothing but poses changes")
        if was_reset and count > found[-1][1]:
            found.append((stamp, count, dict(poses)))
    if len(found) < 2:
        raise ValueError(f"{path} has no frame after a reset; call ~/reset while it is recorded, to start from rest")
    return found


def _rows(clouds: list[tuple[Stamp, np.ndarray]], stamps: list[Stamp | None]) -> np.ndarray:
    """Return particles (F, N, 3) at `stamps`, NaN where the node sent none."""
    sent = dict(clouds)
    nothing = np.full_like(clouds[0][1], np.nan) if clouds else np.full((1, 3), np.nan)
    return np.stack([sent.get(stamp, nothing) for stamp in stamps])
