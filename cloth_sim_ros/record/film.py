# SPDX-License-Identifier: Apache-2.0
"""What a bag shows, frame by frame, as meshes: objects that change their shape, and colliders that move."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cloth_sim_ros.record.bag import Bag
from cloth_sim_ros.record.solids import mesh_of
from cloth_sim_ros.ros.scene_plan import make_plan
from cloth_sim_ros.sim import Plane, Rope
from cloth_sim_ros.sim.topology import build
from cloth_sim_ros.viewer.tube import tube_faces, tube_vertices


@dataclass(frozen=True)
class Shape:
    """An object: triangles (F, 3), and its vertices (T, V, 3) [m] in every frame."""

    triangles: np.ndarray
    vertices: np.ndarray


@dataclass(frozen=True)
class Body:
    """A collider: triangles (F, 3) of vertices (V, 3) [m] in its axes, positions (T, 3) [m], orientations (T, 4)."""

    triangles: np.ndarray
    vertices: np.ndarray
    positions: np.ndarray
    orientations: np.ndarray
    is_plane: bool


@dataclass(frozen=True)
class Film:
    """Frames at `times` (T,) [s] from the first one; left_out says in sentences what is not in it."""

    times: np.ndarray
    objects: dict[str, Shape]
    colliders: dict[str, Body]
    left_out: list[str] = field(default_factory=list)


def film_of(bag: Bag, rate: float) -> Film:
    """The first run of a bag at `rate` frames a second: until it begins anew or ends.

    Raises ValueError, in one sentence, where nothing can be shown.
    """
    start, acts, left_out = _first_run(bag)
    values = {name: tuple(value) if isinstance(value, list) else value for name, value in start["parameters"].items()}
    scene = make_plan(values).scene
    clouds = {name: _clouds(bag, name) for name in bag.objects if name in scene.objects}
    counts = {name: len(build(scene.objects[name], name, True).rest) for name in clouds}
    clouds = {name: [each for each in cloud if len(each[1]) == counts[name]] for name, cloud in clouds.items()}
    if not clouds or not all(clouds.values()):
        raise ValueError("the bag has no particles of the scene that it begins with")
    begin = max(cloud[0][0] for cloud in clouds.values())
    end = min(cloud[-1][0] for cloud in clouds.values())
    times = np.arange(begin, end + 1e-9, 1.0 / rate)
    if len(times) < 2:
        shown = f"the bag shows {end - begin:.3f} s of a run"
        raise ValueError(f"{shown}; allowed is at least two frames of {rate:g} a second")
    objects = {name: _shape(scene.objects[name], name, clouds[name], times) for name in clouds}
    colliders = {}
    for name, collider in scene.colliders.items():
        mesh = mesh_of(collider)
        if mesh is None:
            left_out.append(f"{name} is left out, as a {type(collider).__name__} has no triangles")
            continue
        poses = _poses(name, start["poses"].get(name, (collider.position, collider.orientation)), acts, times)
        colliders[name] = Body(mesh.faces, mesh.vertices, *poses, is_plane=isinstance(collider, Plane))
    return Film(times - begin, objects, colliders, left_out)


def _first_run(bag: Bag) -> tuple[dict, list[tuple[float, list]], list[str]]:
    """The start of the first run, its acts with their times [s], and what cannot be shown."""
    acts, left_out = [], []
    for entry in bag.journal[1:]:
        if "start" in entry or "end" in entry:
            break
        acts += [(_seconds(entry["stamp"]), act) for act in entry["acts"]]
    if any(act[0] == "put" for _, act in acts):
        left_out.append("colliders that came on ~/scene are left out")
    return bag.journal[0]["start"], acts, left_out


def _clouds(bag: Bag, name: str) -> list[tuple[float, np.ndarray]]:
    """Time [s] and positions (N, 3) [m] of each cloud until the first run ends."""
    ends = [entry["stamp"] for entry in bag.journal[1:] if "start" in entry or "end" in entry]
    found = []
    for stamp, cloud in bag.clouds(name):
        if ends and stamp >= ends[0]:
            break
        if stamp >= bag.journal[0]["stamp"]:
            points = np.frombuffer(bytes(cloud.data), "<f4").reshape(-1, len(cloud.fields))[:, :3]
            found.append((_seconds(stamp), points.astype(np.float64)))
    return found


def _shape(thing, name: str, clouds: list[tuple[float, np.ndarray]], times: np.ndarray) -> Shape:
    """An object at `times`, each by the newest cloud that there was."""
    stamps = np.array([time for time, _ in clouds])
    chosen = [clouds[k][1] for k in np.searchsorted(stamps, times + 1e-6, side="right") - 1]
    if isinstance(thing, Rope):
        chosen = [tube_vertices(points, thing.radius) for points in chosen]
        return Shape(tube_faces(len(clouds[0][1])), np.stack(chosen))
    return Shape(build(thing, name, True).triangles, np.stack(chosen))


def _poses(name: str, first, acts: list[tuple[float, list]], times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions (T, 3) and orientations (T, 4) of a collider at `times`, by what moved it."""
    moves = [(-np.inf, *first), *((time, *act[2:]) for time, act in acts if act[0] == "move" and act[1] == name)]
    at = np.searchsorted([move[0] for move in moves], times + 1e-6, side="right") - 1
    return tuple(np.array([moves[k][which] for k in at], float) for which in (1, 2))


def _seconds(stamp: tuple[int, int]) -> float:
    return stamp[0] + 1e-9 * stamp[1]
