# SPDX-License-Identifier: Apache-2.0
"""What is placed into a collider comes out of it, and is not flung: an overlap is no motion."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from cloth_sim_ros.sim import Box, Cloth, Cylinder, Mesh, Plane, Rope, Scene, Settings, Simulation

ALONG_Y = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))
THINGS = {
    "cloth": Cloth.of("cotton", resolution=(16, 16), size=(0.3, 0.3), pins=None),
    "terry": Cloth.of("towel", resolution=(12, 12), size=(0.3, 0.3), pins=None, self_contact=True),
    "cable": Rope.of("power cable", segments=20, start=(-0.25, 0.0, 0.0), end=(0.25, 0.0, 0.0), pins=None),
    "hose": Rope.of("rubber hose", segments=16, start=(-0.25, 0.0, 0.0), end=(0.25, 0.0, 0.0), pins=None),
}


def table():
    shape = trimesh.creation.box((1.0, 1.0, 0.2)).subdivide().subdivide()
    return Mesh(shape.vertices, shape.faces, position=(0.0, 0.0, -0.1))


COLLIDERS = {
    "plane": Plane(normal=(0.0, 0.0, 1.0)),
    "box": Box(half_extents=(0.5, 0.5, 0.1), position=(0.0, 0.0, -0.1)),
    "mesh": table(),
    "drum": Cylinder(radius=0.1, half_length=0.4, position=(0.0, 0.0, -0.1), orientation=ALONG_Y),
}
# What ropes meet nowhere, so that boxes and drums share a kernel, with test_touch.py too.
FAR = {
    "box": replace(COLLIDERS["drum"], position=(0.0, 0.0, -9.0)),
    "drum": replace(COLLIDERS["box"], position=(0.0, 0.0, -9.0)),
}


def placed(name, collider, depth, device, settings):
    """A thing whose lower side is `depth` [m] below the highest point of a collider, and that height of its middle."""
    thing = THINGS[name]
    colliders = {"on": COLLIDERS[collider]}
    if isinstance(thing, Rope) and collider in FAR:
        colliders["far"] = FAR[collider]
    sim = Simulation(Scene({"it": thing}, colliders), Settings(**settings), device)
    surface = thing.thickness if isinstance(thing, Cloth) else thing.radius
    x = sim.positions("it").astype(float)
    x -= x.mean(axis=0)
    x[:, 2] += surface - depth
    sim.set_positions("it", x)
    return sim, surface


def highest(sim, surface, frames=30):
    """Largest height [m] over the collider in so many frames, and the largest speed upwards [m/s]."""
    top = fastest = -np.inf
    for _ in range(frames):
        sim.step()
        top = max(top, sim.positions("it")[:, 2].max() - surface)
        fastest = max(fastest, sim.velocities("it")[:, 2].max())
    return top, fastest


# Kernels that take long to compile.
DEAR = {("terry", "box"), ("terry", "mesh"), ("cable", "mesh"), ("hose", "mesh")}
PLACES = [
    pytest.param(name, collider, marks=[pytest.mark.long] if (name, collider) in DEAR else [])
    for name in THINGS
    for collider in ("plane", "box", "mesh")
]


@pytest.mark.parametrize("depth", [1e-3, 4e-3, 3e-2])
@pytest.mark.parametrize(("name", "collider"), PLACES)
def test_what_is_placed_into_a_table_is_not_flung(device, name, collider, depth):
    """It rose by half a metre out of one millimetre."""
    sim, surface = placed(name, collider, depth, device, {})
    top, fastest = highest(sim, surface)
    assert top < 1e-4 and fastest < 0.02
    assert np.abs(sim.positions("it")[:, 2] - surface).max() < 1e-4


@pytest.mark.parametrize(
    "settings",
    [{"substeps": 1}, pytest.param({"substeps": 3, "order": 1}, marks=pytest.mark.long), {"substeps": 200}],
    ids=str,
)
@pytest.mark.parametrize("name", ["cloth", "cable"])
def test_it_is_not_with_any_number_of_substeps(device, name, settings):
    top, fastest = highest(*placed(name, "box", 5e-3, device, settings))
    assert top < 1e-4 and fastest < 0.02


@pytest.mark.parametrize("name", ["cloth", "cable"])
def test_it_is_the_same_in_one_call_as_in_several(device, name):
    once, often = (placed(name, "box", 5e-3, device, {})[0] for _ in range(2))
    once.step(12)
    for _ in range(12):
        often.step()
    assert np.array_equal(once.positions("it"), often.positions("it"))


@pytest.mark.parametrize("name", ["cable", "hose"])
def test_a_rope_whose_middle_is_placed_into_a_drum_is_not_flung(device, name):
    """The way out lifts its middle alone, so that it springs back a little."""
    sim, surface = placed(name, "drum", 1e-2, device, {})
    top, fastest = highest(sim, surface)
    assert top < 0.01 and fastest < 1.0


def test_a_collider_that_is_placed_into_a_cloth_lifts_it_gently(device):
    sim, surface = placed("cloth", "plane", 0.0, device, {})
    sim.step(20)
    sim.set_collider_pose("on", (0.0, 0.0, 0.01), (0.0, 0.0, 0.0, 1.0), sweep=False)
    top, fastest = highest(sim, surface + 0.01)
    assert top < 1e-4 and fastest < 0.02


def test_a_soft_collider_still_pushes_back(device):
    """Its depth is no error, but stores energy, which throws the cable up."""
    soft = {"on": replace(COLLIDERS["plane"], compliance=1e-3)}
    thing = THINGS["cable"]
    sim = Simulation(Scene({"it": thing}, soft), Settings(substeps=100), device)
    x, depth = sim.positions("it").astype(float), 2e-3
    x[:, 2] = thing.radius - depth
    sim.set_positions("it", x)
    assert highest(sim, thing.radius)[0] > 0.02
