# SPDX-License-Identifier: Apache-2.0
"""Trials of a body and colliders: fast, placed anew, closing, sharp, or around a particle."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from cloth_sim_ros.sim import Box, Capsule, Cylinder, Ellipsoid, Mesh, Plane, Scene, SignedDistance, Simulation, Sphere
from cloth_sim_ros.sim.colliders.baking import CELLS
from cloth_sim_ros.study.hard.bodies import BODY, SEGMENTS, is_rope, make_body
from cloth_sim_ros.study.hard.trial import WHIP, Options, Trial, fine

SEPARATION = 3.0  # [m/s] at which the solver lets overlaps come apart; nothing may leave a resting collider faster
LYING = math.sqrt(0.5)


def meshed_ball(radius: float, **place) -> Mesh:
    """A ball as a mesh: an octahedron whose triangles are split into four each three times, its corners on a ball."""
    corners = np.concatenate([np.eye(3), -np.eye(3)])
    faces = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
    for _ in range(3):
        triangles = corners[faces]
        a, b, c = triangles.swapaxes(0, 1)
        ab, bc, ca = a + b, b + c, c + a
        soup = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
        soup /= np.linalg.norm(soup, axis=1, keepdims=True)
        corners, faces = np.unique(soup.round(9), axis=0, return_inverse=True)
        faces = faces.reshape(-1, 3)
    return Mesh(corners, faces, scale=radius, **place)


def ball_of_distances(radius: float, **place) -> SignedDistance:
    """A ball as signed distances on a grid with as many steps across as a mesh is baked in."""
    step = 2 * radius / CELLS
    ends = (-radius - 2 * step,) * 3
    values = np.linalg.norm(np.indices((CELLS + 5,) * 3) - (CELLS + 4) / 2, axis=0) * step - radius
    return SignedDistance(values, ends, step, **place)


SHAPES: dict[str, Callable[..., Any]] = {
    "plane": lambda **place: Plane(**place),
    "sphere": lambda **place: Sphere(radius=0.15, **place),
    "capsule": lambda **place: Capsule(radius=0.05, half_length=0.3, orientation=(LYING, 0, 0, LYING), **place),
    "box": lambda **place: Box(half_extents=(0.3, 0.3, 0.002), **place),
    "cylinder": lambda **place: Cylinder(radius=0.05, half_length=0.3, orientation=(LYING, 0, 0, LYING), **place),
    "ellipsoid": lambda **place: Ellipsoid(radii=(0.3, 0.15, 0.05), **place),
    "mesh": lambda **place: meshed_ball(0.15, **place),
    "signed_distance": lambda **place: ball_of_distances(0.15, **place),
}
# [m] above the middle
TOP = {
    **{"plane": 0.0, "sphere": 0.15, "capsule": 0.05, "box": 0.002, "cylinder": 0.05, "ellipsoid": 0.05},
    **{"mesh": 0.15, "signed_distance": 0.15},
}


def fast_collider(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """A collider that moves straight up through a free body within a few frames, then stands still.

    The work on the body is the collider's speed times the body's momentum, and nothing is launched. In few substeps
    contact stretches springs before they can pull. Their return added 6 % to that once, so a tenth is allowed.
    """
    shape, speed, radius = options["shape"], options["speed"], 0.005
    middle = 0.0 if is_rope(kind) else 0.05  # where a particle is
    collider = SHAPES[shape](position=(middle, middle, -0.2 - TOP[shape]))
    body = make_body(kind, pins="none", thickness=radius, damping=5e-3)
    scene = Scene({BODY: body}, {"it": collider}, gravity=(0, 0, 0))
    path, strokes = speed / 60.0, 3 if speed < 10.0 else 2
    left = [False]

    def drive(sim: Simulation, frame: int) -> None:
        z = collider.position[2] + path * min(frame + 1, strokes)
        if frame < strokes:
            sim.set_collider_pose("it", (middle, middle, z), collider.orientation)
        elif frame == strokes:  # later it may rightly slide off
            way = np.linalg.norm(sim.rest_positions(BODY) - [middle, middle, 0.0], axis=1) < 0.02
            left[0] = sim.positions(BODY)[way, 2].min() < z

    def velocity(frame: int) -> float:
        return speed if frame < strokes else 0.0

    def ahead(sim: Simulation) -> str:
        return "the particle in its way was left behind" if left[0] else ""

    promises = {"conserves": True, "slack": 0.1, "velocity": velocity, "outside": True, "finally_": ahead}
    return Trial(scene, frames=8, drive=drive, fastest=WHIP * speed, **promises)


def teleport(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """A collider placed, without speed, into the body, past it, or away from below it."""
    shape, where = options["shape"], options["where"]
    height = {"into": -0.3 * TOP[shape], "through": 0.05 if shape == "plane" else 0.5, "away": -0.01 - TOP[shape]}[
        where
    ]
    start = (0.0, 0.0, height if where == "away" else -1.0)
    scene = Scene({BODY: make_body(kind, pins="both", damping=2e-3)}, {"it": SHAPES[shape](position=start)})
    orientation = scene.colliders["it"].orientation

    def drive(sim: Simulation, frame: int) -> None:
        if frame == 10:
            goal = (0.0, 0.0, -5.0) if where == "away" else (0.0, 0.0, height)
            sim.set_collider_pose("it", goal, orientation, sweep=False)

    # A plane above it leaves the body below: it has to come out, and does so at the speed of separation.
    finally_ = fine if where == "through" and shape == "plane" else out
    return Trial(scene, frames=60, drive=drive, fastest=WHIP * SEPARATION, finally_=finally_)


def out(sim: Simulation) -> str:
    """Return "" if no particle is left in or behind a collider."""
    depth = sim.report()[BODY]["particle_penetration"]
    return f"still {depth:.3g} m deep" if depth > 1e-4 else ""


def squeeze(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """Two faces close on the body until half of its thickness is left between them, hold and open again."""
    shape, radius = options["shape"], 0.01
    body = make_body(kind, pins="none", thickness=radius, damping=2e-3)
    above = SHAPES[shape](position=(0.0, 0.0, 0.1 + TOP[shape]))
    if shape == "plane":
        above = Plane(normal=(0, 0, -1), point=(0.0, 0.0, 0.1))
    scene = Scene({BODY: body}, {"below": Plane(position=(0.0, 0.0, -0.02)), "above": above})
    closed, opened = -0.02 + radius + above.position[2] - 0.1, above.position[2]

    def drive(sim: Simulation, frame: int) -> None:
        share = np.clip(min(frame, 100 - frame) / 20.0, 0.0, 1.0)
        sim.set_collider_pose("above", (0.0, 0.0, opened + share * (closed - opened)), above.orientation)

    return Trial(scene, drive=drive, fastest=WHIP * SEPARATION, rest=0.02)


def sharp_edge(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """A body across the edge of a box that moves to and fro; its thickness is less than half of a spring's length."""
    half, radius, spacing = np.array([0.2, 0.6, 0.2]), 0.02 if not is_rope(kind) else 0.4 / SEGMENTS, 0.1
    body = make_body(kind, pins="none", thickness=radius, position=(0.25, 0.0, 0.2 + 1.1 * radius))
    scene = Scene({BODY: body}, {"it": Box(half_extents=tuple(half))})
    deepest = [0.0]

    def drive(sim: Simulation, frame: int) -> None:
        middle = np.array([-0.1 * (1.0 - math.cos(math.pi * frame / 20.0)), 0.0, 0.0])
        sim.set_collider_pose("it", middle)
        if frame:
            deepest[0] = max(deepest[0], _depth(sim, sim_middle[0], half, radius))
        sim_middle[0] = middle

    sim_middle = [np.zeros(3)]

    def shallow(sim: Simulation) -> str:
        return f"the edge lies {deepest[0]:.3g} m deep" if deepest[0] > 0.1 * spacing else ""

    return Trial(scene, frames=60, drive=drive, outside=True, finally_=shallow)


def _depth(sim: Simulation, middle: np.ndarray, half: np.ndarray, radius: float) -> float:
    """Return how deep [m] the body's edges lie within `radius` of a box, at 21 points of each edge."""
    x, t = sim.positions(BODY) - middle, np.linspace(0.0, 1.0, 21)[:, None, None]
    kinds = sim.springs(BODY)
    pairs = np.concatenate([kind[0] for name, kind in kinds.items() if name != "bending"])
    q = np.abs(x[pairs[:, 0]] * (1.0 - t) + x[pairs[:, 1]] * t) - half
    return radius - float((np.linalg.norm(np.maximum(q, 0.0), axis=-1) + np.minimum(q.max(-1), 0.0)).min())


def centre(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """A particle at the centre of a collider, where the nearest surface has no direction."""
    middle = (0.05, 0.05, 0.0) if not is_rope(kind) else (0.0, 0.0, 0.0)
    shape = {
        "sphere": Sphere(radius=0.04, position=middle),
        "capsule": Capsule(radius=0.03, half_length=0.05, position=middle),
        "box": Box(half_extents=(0.03, 0.03, 0.03), position=middle),
        "cylinder": Cylinder(radius=0.03, half_length=0.05, position=middle),
        "ellipsoid": Ellipsoid(radii=(0.04, 0.03, 0.02), position=middle),
        "mesh": meshed_ball(0.04, position=middle),
        "signed_distance": ball_of_distances(0.04, position=middle),
    }[options["shape"]]
    scene = Scene({BODY: make_body(kind, pins="both", damping=2e-3, compliance=1e-3)}, {"it": shape})

    return Trial(scene, frames=60, fastest=WHIP * SEPARATION, finally_=out)
