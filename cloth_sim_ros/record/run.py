# SPDX-License-Identifier: Apache-2.0
"""The first run in a bag: from its start until the node restarts or the bag ends."""

from __future__ import annotations

from typing import Any

import numpy as np

from cloth_sim_ros.record.bag import Bag, Stamp

Acts = list[tuple[Stamp, list]]  # the stamp of a frame, and what acted before, as cloth_sim_ros/ros/journal.py says


def first_run(bag: Bag) -> tuple[dict, Acts]:
    """Return the start of the first run, and its acts."""
    acts: Acts = []
    for entry in bag.journal[1:]:
        if "start" in entry or "end" in entry:
            break
        acts.append((entry["stamp"], entry["acts"]))
    return bag.journal[0]["start"], acts


def clouds_of(bag: Bag, name: str) -> list[tuple[Stamp, np.ndarray]]:
    """Return stamp and positions (N, 3) [m] of each cloud until the first run ends."""
    ends = [entry["stamp"] for entry in bag.journal[1:] if "start" in entry or "end" in entry]
    found = []
    for stamp, cloud in bag.clouds(name):
        if ends and stamp >= ends[0]:
            break
        if stamp >= bag.journal[0]["stamp"]:
            points = np.frombuffer(bytes(cloud.data), "<f4").reshape(-1, len(cloud.fields))[:, :3]
            found.append((stamp, points.astype(np.float64)))
    return found


def poses_at(name: str, first: Any, acts: Acts, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (T, 3) and orientations (T, 4) of a collider or handle at `times`.

    It moves from the pose `first` by its acts "move".
    """
    moves = [(-np.inf, *first)]
    for stamp, done in acts:
        moves += [(seconds(stamp), *act[2:]) for act in done if act[0] == "move" and act[1] == name]
    at = np.searchsorted([move[0] for move in moves], times + 1e-6, side="right") - 1
    return tuple(np.array([moves[k][which] for k in at], float) for which in (1, 2))


def seconds(stamp: Stamp) -> float:
    """Return a stamp as a number [s]."""
    return stamp[0] + 1e-9 * stamp[1]
