# SPDX-License-Identifier: Apache-2.0
"""Nothing comes through itself or another, by a count in float64 of what the solver leaves in every frame."""

import numpy as np
import pytest
from crossings import crossings, edges_and_triangles

from cloth_sim_ros.sim import Cloth, Handle, Plane, Scene, Settings, Simulation, Sphere

FLAT = {"pins": None, "thickness": 0.003, "self_contact": True}


def counted(sim):
    """Edges that go through a triangle of their own object or another."""
    parts = [edges_and_triangles(sim, name) for name in sim.scene.objects]
    return sum(crossings(x, edges, y, faces, x is y) for x, edges, _ in parts for y, _, faces in parts)


def over_a_ball(device):
    sheet = Cloth.of("cotton", resolution=(20, 20), size=(0.8, 0.8), position=(0.03, 0.02, 0.5), **FLAT)
    scene = Scene({"sheet": sheet}, {"floor": Plane(), "ball": Sphere(radius=0.15, position=(0, 0, 0.3))})
    return Simulation(scene, device=device), 150, None


def two_sheets(device):
    each = {
        f"sheet {k}": Cloth.of(
            "cotton",
            resolution=(14, 14),
            size=(0.4, 0.4),
            position=(0.03 * k, -0.02 * k, 0.2 + 0.1 * k),
            orientation=(0, 0, np.sin(0.2 * k), np.cos(0.2 * k)),
            **FLAT,
        )
        for k in range(2)
    }
    scene = Scene(each, {"floor": Plane(), "ball": Sphere(radius=0.07, position=(0, 0, 0.07))}, object_contact=True)
    return Simulation(scene, device=device), 120, None


def twisted(device):
    """Three turns within three seconds, between hands that hold two opposite edges and come nearer."""
    sheet = Cloth(resolution=(36, 8), size=(0.6, 0.12), damping=1e-3, **FLAT)
    hands = {name: Handle(position=(x, 0, 0), reach=(0.01, 0.2, 0.01)) for name, x in (("left", -0.3), ("right", 0.3))}
    sim = Simulation(Scene({"sheet": sheet}, handles=hands), Settings(global_damping=1.0), device)
    assert sim.attach("left") == sim.attach("right") == 8

    def drive(frame):
        turn, near = 3.0 * np.pi * frame / 180.0, 0.06 * frame / 180.0
        for name, x, side in (("left", -0.3 + near, 0.5), ("right", 0.3 - near, -0.5)):
            sim.set_handle_pose(name, (x, 0, 0), (np.sin(side * turn), 0, 0, np.cos(side * turn)))

    return sim, 180, drive


def wrung(device):
    """As twisted, but as wide as long and limp: it stretches threefold, and lies pressed on itself all over."""
    sheet = Cloth(resolution=(18, 18), size=(0.4, 0.4), damping=1e-3, **FLAT)
    hands = {name: Handle(position=(x, 0, 0), reach=(0.01, 0.5, 0.01)) for name, x in (("left", -0.2), ("right", 0.2))}
    sim = Simulation(Scene({"sheet": sheet}, handles=hands), Settings(global_damping=1.0), device)
    assert sim.attach("left") == sim.attach("right") == 18

    def drive(frame):
        for name, x, side in (("left", -0.2, 0.5), ("right", 0.2, -0.5)):
            turn = 3.0 * np.pi * frame / 120.0
            sim.set_handle_pose(name, (x, 0, 0), (np.sin(side * turn), 0, 0, np.cos(side * turn)))

    return sim, 120, drive


def folded_twice(device):
    """A hand takes a corner over to the opposite one, then another hand does it with what is left."""
    sheet = Cloth.of("cotton", resolution=(16, 16), size=(0.4, 0.4), position=(0, 0, 0.004), **FLAT)
    hands = {
        "first": Handle(position=(-0.2, -0.2, 0.004), reach=0.03),
        "second": Handle(position=(0.2, -0.2, 0.004), reach=0.1),
    }
    sim = Simulation(Scene({"sheet": sheet}, {"floor": Plane()}, handles=hands), device=device)

    def drive(frame):
        for name, start, sign in (("first", 10, 1.0), ("second", 100, -1.0)):
            if frame == start:
                assert sim.attach(name)
            if start <= frame <= start + 60:
                s = (frame - start) / 60.0
                x = sign * (-0.2 + 0.36 * s)
                sim.set_handle_pose(name, (x, -0.2 + 0.36 * s, 0.01 + 0.2 * np.sin(np.pi * s)))
            if frame == start + 62:
                sim.release(name)

    return sim, 190, drive


@pytest.mark.long
@pytest.mark.parametrize("case", [over_a_ball, two_sheets, twisted, wrung, folded_twice])
def test_nothing_comes_through(device, case):
    sim, frames, drive = case(device)
    for frame in range(frames):
        if drive is not None:
            drive(frame)
        sim.step()
        assert counted(sim) == 0, f"in frame {frame}"
        told = sim.report().values()
        assert all(each["crossings"] == each["pairs_lost"] == each["recoveries"] == 0 for each in told)
