# SPDX-License-Identifier: Apache-2.0
"""What must not matter, to the bit: running twice, the order of objects; and what masses and layout must be."""

import numpy as np
import pytest
import warp as wp
from fixed_settings import fixed

from cloth_sim_ros.sim import Cloth, Plane, Rope, Scene, Simulation, Sphere, Wind

SHEET = {"resolution": (12, 12), "position": (0.0, 0.0, 1.0), "pins": None, "damping": 1e-3}


def scene(names):
    """Two sheets and two ropes in a breeze above a ball and a floor, named in the order of `names`."""
    objects = {
        "left": Cloth(**{**SHEET, "position": (-0.6, 0.0, 1.0)}),
        "right": Cloth(**{**SHEET, "position": (0.7, 0.1, 1.1), "stretch_compliance": 2e-3}),
        "long": Rope(start=(-1, 0, 1.5), end=(1, 0, 1.5), segments=24),
        "short": Rope(start=(0, 1, 1), end=(0.5, 1, 1), segments=9, pins=None),
    }
    colliders = {"ball": Sphere(radius=0.3, position=(0, 0, 0.5)), "floor": Plane(normal=(0, 0, 1))}
    return Scene(objects={name: objects[name] for name in names}, colliders=colliders, wind=Wind(velocity=(2, 0, 0)))


def run(names, device, executor=None, **settings):
    sim = Simulation(scene(names), fixed(**settings), device=device, executor=executor)
    for frame in range(40):
        sim.set_collider_pose("ball", (0.02 * frame, 0.0, 0.5))
        sim.step()
    return {name: (sim.positions(name), sim.velocities(name)) for name in names}


NAMES = ("left", "right", "long", "short")


def same(first, second):
    return all(np.array_equal(a, b) for name in first for a, b in zip(first[name], second[name], strict=True))


@pytest.mark.parametrize(("executor", "order"), [("block", 1), ("block", 2), ("graph", 2)])
@pytest.mark.long
def test_same_inputs_give_the_same_bits(device, executor, order):
    assert same(*(run(NAMES, device, executor=executor, order=order, substeps=5) for _ in range(2)))


@pytest.mark.long
def test_order_of_objects_does_not_matter_to_the_bit(device):
    assert same(run(NAMES, device), run(NAMES[::-1], device))


@pytest.mark.long
def test_an_object_alone_moves_as_among_others(device):
    assert same(run(("right",), device), run(NAMES, device))


@pytest.mark.parametrize("settings", [{}, {"order": 2, "substeps": 5}])
@pytest.mark.long
def test_reset_returns_to_the_first_bit(device, settings):
    sim = Simulation(scene(NAMES), fixed(**settings), device=device)
    found = []
    for _ in range(2):
        sim.step(frames=30)
        found.append({name: (sim.positions(name), sim.velocities(name)) for name in NAMES})
        sim.reset()
        assert sim.time == 0.0 and np.array_equal(sim.positions("left"), sim.rest_positions("left"))
    assert same(*found)


@pytest.mark.long
def test_both_executors_give_the_same_motion(device):
    """Within what 800 substeps of float32 add up to: 1.01e-5 m on an H200, less on a CPU."""
    one, other = (run(NAMES, device, executor=executor) for executor in ("block", "graph"))
    assert max(np.abs(one[name][0] - other[name][0]).max() for name in NAMES) < 2e-5


def test_turned_scene_gives_the_turned_motion(device):
    """A quarter turn about z of sheet and rope: what falls along x then falls along y."""
    quarter = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))
    pins = (0, 11)
    found = []
    for orientation in ((0.0, 0.0, 0.0, 1.0), quarter):
        sheet = Cloth(**{**SHEET, "position": (0.0, 0.0, 0.0), "pins": pins, "orientation": orientation})
        sim = Simulation(Scene(objects={"it": sheet}), fixed(), device=device)
        sim.step(frames=20)
        found.append(sim.positions("it"))
    x, y, z = found[0].T
    assert np.abs(found[1] - np.stack([-y, x, z], axis=1)).max() < 1e-4


def test_grid_layout_and_masses():
    nx, ny, width, height, mass = 5, 4, 0.8, 0.6, 0.3
    cloth = Cloth(resolution=(nx, ny), size=(width, height), mass=mass, position=(1.0, 2.0, 3.0))
    sim = Simulation(Scene(objects={"it": cloth}), device="cpu")
    for iy in range(ny):
        for ix in range(nx):
            local = (ix * width / (nx - 1) - width / 2, iy * height / (ny - 1) - height / 2, 0.0)
            assert sim.positions("it")[iy * nx + ix] == pytest.approx(np.add(local, (1.0, 2.0, 3.0)), abs=1e-6)
    masses = sim.masses("it").reshape(ny, nx)
    cell = mass / ((nx - 1) * (ny - 1))
    assert masses.dtype == np.float64 and masses.sum() == pytest.approx(mass, rel=1e-12)
    assert masses[1:-1, 1:-1] == pytest.approx(np.full((ny - 2, nx - 2), cell))
    assert masses[0, 1:-1] == pytest.approx(np.full(nx - 2, cell / 2)) and masses[0, 0] == pytest.approx(cell / 4)


def test_named_pins_hold_and_others_fall(device):
    pinned = {"corners": [12, 15], "top": range(12, 16), "edges": set(range(16)) - {5, 6, 9, 10}, None: []}
    for pins, held in pinned.items():
        sim = Simulation(Scene(objects={"it": Cloth(resolution=(4, 4), pins=pins)}), device=device)
        sim.step(frames=6)
        fell = sim.rest_positions("it")[:, 2] - sim.positions("it")[:, 2]
        assert set(np.flatnonzero(fell == 0.0)) == set(held) and (np.delete(fell, list(held)) > 1e-3).all()


def test_springs_are_the_material_and_borders_half_of_it():
    sim = Simulation(Scene(objects={"it": Cloth(resolution=(4, 4), bend_compliance=0.5)}), device="cpu")
    springs = sim.springs("it")
    x = sim.rest_positions("it")
    for pairs, rest, _ in springs.values():
        assert np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1) == pytest.approx(rest, rel=1e-5)
    assert {kind: len(rest) for kind, (_, rest, _) in springs.items()} == {"structural": 24, "shear": 18, "bending": 16}
    pairs, _, constant = springs["structural"]
    both_below = (pairs < 4).all(axis=1)
    assert constant[both_below] == pytest.approx(np.full(3, 500.0))
    assert np.unique(constant.round(2)).tolist() == [500.0, 1000.0]
    assert springs["shear"][2] == pytest.approx(np.full(18, 1 / 3e-3), rel=1e-6)


def test_rope_masses_are_lumped_by_length():
    rope = Rope(points=[(0, 0, 0), (1, 0, 0), (1, 0, 3), (1, 2, 3)], mass=0.6)
    assert Simulation(Scene(objects={"it": rope}), device="cpu").masses("it") == pytest.approx([0.05, 0.2, 0.25, 0.1])


def test_mesh_masses_are_lumped_by_area():
    cloth = Cloth.from_mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0), (3, 1, 0)], [(0, 1, 2), (1, 3, 2)], mass=2.0)
    masses = Simulation(Scene(objects={"it": cloth}), device="cpu").masses("it")
    assert masses == pytest.approx(np.array([0.5, 2.0, 2.0, 1.5]) / 3.0)


@pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device to compare with the CPU")
@pytest.mark.parametrize("executor", ["block", "graph"])
def test_both_devices_agree_on_the_curtain(executor):
    curtain = Cloth(pins="top", orientation=(np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)), position=(0.0, 0.0, 1.0))
    ball = Sphere(radius=0.2, position=(0.0, -0.5, 0.9))
    scene = Scene(objects={"it": curtain}, colliders={"ball": ball}, wind=Wind(velocity=(0.5, 1.0, 0.0)))
    found = []
    for device in ("cpu", "cuda:0"):
        sim = Simulation(scene, device=device, executor=executor)
        for frame in range(12):
            sim.set_collider_pose("ball", (0.0, -0.5 + 0.03 * frame, 0.9))
            sim.step()
        found.append(sim.positions("it"))
    assert np.abs(found[0] - found[1]).max() < 1e-4
    assert np.abs(found[0] - Simulation(scene, device="cpu").positions("it")).max() > 0.05
