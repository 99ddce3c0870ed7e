# SPDX-License-Identifier: Apache-2.0
"""Films of a bag, frame by frame, as meshes: objects that change their shape, and colliders that move."""

from __future__ import annotations

import base64
import io
import zipfile
from dataclasses import dataclass, field

import numpy as np

from cloth_sim_ros.drawing.tube import tube_faces, tube_vertices
from cloth_sim_ros.record.bag import Bag, Stamp
from cloth_sim_ros.record.run import clouds_of, first_run, poses_at, seconds
from cloth_sim_ros.record.solids import mesh_of
from cloth_sim_ros.ros.parameters.plan import make_plan
from cloth_sim_ros.sim import Plane, Rope
from cloth_sim_ros.sim.access.saved_file import header_of
from cloth_sim_ros.sim.topology import build


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
    """Frames at `times` (T,) [s] from the first one; left_out: sentences on what is not in it."""

    times: np.ndarray
    objects: dict[str, Shape]
    colliders: dict[str, Body]
    left_out: list[str] = field(default_factory=list)


def film_of(bag: Bag, rate: float) -> Film:
    """Return the first run of a bag at `rate` frames a second, until the node restarts or the bag ends.

    Raises ValueError in one sentence if the bag shows fewer than two frames of the scene.
    """
    start, acts = first_run(bag)
    added = _added(start["state"]) | {act[1] for _, done in acts for act in done if act[0] == "put"}
    left_out = [f"colliders that came on ~/scene are left out: {', '.join(sorted(added))}"] if added else []
    values = {name: tuple(value) if isinstance(value, list) else value for name, value in start["parameters"].items()}
    scene = make_plan(values).scene
    clouds = {name: _with_seconds(clouds_of(bag, name)) for name in bag.objects if name in scene.objects}
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
        poses = poses_at(name, start["poses"].get(name, (collider.position, collider.orientation)), acts, times)
        colliders[name] = Body(mesh.faces, mesh.vertices, *poses, is_plane=isinstance(collider, Plane))
    return Film(times - begin, objects, colliders, left_out)


def _added(state: str) -> set[str]:
    """Return the names of the colliders that had come on ~/scene before a start with this `state` in base64."""
    with zipfile.ZipFile(io.BytesIO(base64.b64decode(state))) as box:
        return set((header_of(box) or {}).get("added", ()))


def _with_seconds(clouds: list[tuple[Stamp, np.ndarray]]) -> list[tuple[float, np.ndarray]]:
    return [(seconds(stamp), points) for stamp, points in clouds]


def _shape(thing, name: str, clouds: list[tuple[float, np.ndarray]], times: np.ndarray) -> Shape:
    """Return an object at `times`, each by the newest cloud before."""
    stamps = np.array([time for time, _ in clouds])
    chosen = [clouds[k][1] for k in np.searchsorted(stamps, times + 1e-6, side="right") - 1]
    if isinstance(thing, Rope):
        chosen = [tube_vertices(points, thing.radius) for points in chosen]
        return Shape(tube_faces(len(clouds[0][1])), np.stack(chosen))
    return Shape(build(thing, name, True).triangles, np.stack(chosen))
