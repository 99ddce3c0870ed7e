# SPDX-License-Identifier: Apache-2.0
"""A shape, a force and a constraint from outside the package, as docs/how-to/extending.md writes them."""

import importlib
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from fixed_settings import fixed
from probed import signed_distances

from cloth_sim_ros.parameters import number
from cloth_sim_ros.sim import Cloth, Rope, Scene, Simulation
from cloth_sim_ros.sim.input.numbers import Numbers
from cloth_sim_ros.sim.scene.constraints import CONSTRAINTS, Constraint
from cloth_sim_ros.sim.scene.forces import FORCES, Force

PAGE = Path(__file__).parents[2] / "docs/how-to/extending.md"
FILES = dict(re.findall(r"^```python\n# (\w+\.py)\n(.*?)^```", PAGE.read_text(), flags=re.DOTALL | re.MULTILINE))


@pytest.fixture(scope="module")
def plugin(tmp_path_factory):
    """plugin(name): the module that the page writes. Others may import it by its name."""
    folder = tmp_path_factory.mktemp("plugins")
    for name, text in FILES.items():
        (folder / name).write_text(text)
    sys.path.insert(0, str(folder))
    yield importlib.import_module
    sys.path.remove(str(folder))


@wp.func
def height_force(x: wp.vec3, v: wp.vec3, mass: float, numbers: Numbers) -> wp.vec4:
    return wp.vec4(0.0, 0.0, -mass * (numbers[0] * x[2] + numbers[1] * v[2]), mass * numbers[1])


class Heights(Force):
    """A spring and a dashpot a kilogram from every particle to height 0."""

    rows = (number("constant", 0.0, "Of the spring.", "1/s^2", 0, 100), number("rate", 1.0, "Damping.", "1/s", 0, 10))
    function = height_force


@wp.func
def strut_law(distance: float, rest: float, numbers: Numbers) -> wp.vec2:
    return wp.vec2(rest, numbers[0])


class Strut(Constraint):
    """A spring between two particles."""

    rows = (number("compliance", 0.0, "Of the spring.", "m/N", 0, 1),)
    law = strut_law


def test_the_distance_of_the_cone_is_that_to_its_drawing(plugin):
    trimesh = pytest.importorskip("trimesh")
    cone = plugin("cone").Cone(0.3, 0.4)
    rng = np.random.default_rng(0)
    points = rng.uniform((-0.6, -0.6, -0.4), (0.6, 0.6, 0.8), (3000, 3))
    normals, found = signed_distances(cone, points)
    (solid,) = cone.solids()
    drawn = trimesh.Trimesh(solid.points, np.arange(len(solid.points)).reshape(-1, 3))
    drawn.merge_vertices()
    samples = trimesh.sample.sample_surface_even(drawn, 60000, seed=1)[0]
    from scipy.spatial import cKDTree

    nearest = cKDTree(samples).query(points)[0]
    inside = (points[:, 2] > 0) & (np.hypot(points[:, 0], points[:, 1]) / 0.3 + points[:, 2] / 0.4 < 1)
    np.testing.assert_allclose(found, np.where(inside, -nearest, nearest), atol=6e-3)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)


def test_a_cone_lifts_the_middle_of_a_towel(plugin, device):
    cone = plugin("cone").Cone(radius=0.2, height=0.3, position=(0.0, 0.0, -0.15))
    towel = Cloth(resolution=(9, 9), size=(0.4, 0.4), position=(0.0, 0.0, 0.16), pins="edges", thickness=0.005)
    sim = Simulation(Scene({"towel": towel}, {"tip": cone}), device=device)
    sim.set_collider_pose("tip", (0.0, 0.0, -0.09))
    sim.step(30)
    assert sim.positions("towel")[40] == pytest.approx((0.0, 0.0, 0.215), abs=2e-3)
    assert sim.report()["towel"]["max_penetration"] < 3e-3


@pytest.mark.parametrize(
    "settings",
    [{}, *(pytest.param(way, marks=pytest.mark.long) for way in ({"order": 1}, {"method": "verlet", "substeps": 100}))],
)
@pytest.mark.parametrize("executor", ["block", pytest.param("graph", marks=pytest.mark.long)])
def test_a_spring_to_a_height_swings_a_sheet_as_the_closed_form(monkeypatch, device, settings, executor):
    """Mean height of a free sheet: z + g/k (cos(omega t) - 1) with damping, from rest, with another k in each world."""
    monkeypatch.setitem(FORCES, "heights", Heights)
    scene = Scene({"sheet": Cloth(resolution=(9, 9), pins="none")}, forces={"up": Heights(constant=40.0)})
    sim = Simulation(scene, fixed(**{"substeps": 60, **settings}), device=device, executor=executor, worlds=2)
    sim.set("up.constant", 80.0, world=1)
    frames = 30
    sim.step(frames)
    for world, omega2 in enumerate((40.0, 80.0)):
        t, decay = frames / 60, 0.5
        omega = np.sqrt(omega2 - decay**2)
        swing = np.exp(-decay * t) * (np.cos(omega * t) + decay / omega * np.sin(omega * t))
        masses = sim.masses("sheet")
        height = (sim.positions("sheet", world)[:, 2] * masses).sum() / masses.sum()
        exact = 9.81 / omega2 * (swing - 1.0)
        assert height == pytest.approx(exact, rel=1e-2 if settings.get("order") != 1 else 4e-2)


@pytest.mark.parametrize("executor", ["block", pytest.param("graph", marks=pytest.mark.long)])
def test_a_tether_bounds_the_stretch_of_a_soft_sheet_in_one_world(plugin, device, executor, tmp_path):
    tether = plugin("tether").Tether("sheet", [(0, 72), (80, 8)], strain=0.02)
    soft = Cloth(resolution=(9, 9), pins="top", stretch_compliance=0.1, shear_compliance=0.1)
    scene = Scene({"sheet": soft}, constraints={"leash": tether})
    sim = Simulation(scene, fixed(global_damping=3.0), device=device, executor=executor, worlds=2)
    sim.set("leash.strain", 10.0, world=1)
    sim.step(200)

    def longest(simulation, world):
        x = simulation.positions("sheet", world)
        return max(np.linalg.norm(x[a] - x[b]) for a, b in tether.between)

    assert longest(sim, 0) == pytest.approx(1.02, abs=1e-3) and longest(sim, 1) > 1.05
    sim.save(tmp_path / "state.npz")
    other = Simulation(scene, fixed(global_damping=3.0), device=device, executor=executor, worlds=2)
    other.load(tmp_path / "state.npz")
    assert other.get("leash.strain", 1) == 10.0
    for each in (sim, other):
        each.step(5)
    assert all(np.array_equal(sim.positions("sheet", w), other.positions("sheet", w)) for w in (0, 1))


def test_a_compliant_constraint_is_a_spring(monkeypatch, device):
    """A particle of 0.1 kg that hangs by a constraint of compliance c alone sinks by c m g."""
    monkeypatch.setitem(CONSTRAINTS, "strut", Strut)
    rope = Rope(segments=1, start=(0, 0, 0), end=(0, 0, -1), stretch_compliance=1e3, mass=0.2)
    scene = Scene({"rope": rope}, constraints={"it": Strut("rope", (0, 1), compliance=0.05)})
    sim = Simulation(scene, fixed(global_damping=10.0), device=device)
    sim.step(300)
    assert sim.positions("rope")[1, 2] == pytest.approx(-1.0 - 0.05 * 0.1 * 9.81, abs=1e-4)


def test_what_is_wrong_is_said(plugin):
    tether, sheet = plugin("tether").Tether, Cloth(resolution=(4, 4))

    class Odd(Force):
        """Nobody has registered it."""

    for make, sentence in (
        (lambda: Scene({"sheet": sheet}, forces={"odd": Odd()}), "Scene.forces has Odd.*; allowed are"),
        (lambda: plugin("magnet").Magnet(power=1.0), "Magnet is given power; allowed is centre, strength"),
        (lambda: plugin("magnet").Magnet(strength=11.0), "Magnet.strength is 11.0; allowed is .* -10 to 10"),
        (lambda: tether("sheet", (0, 0)), r"Tether.between is \[0, 0\]; allowed are pairs of two particles"),
        (lambda: tether("sheet", (0, 1, 2)), "Tether.between is .*; allowed are pairs of two particles"),
        (lambda: Scene({"sheet": sheet}, constraints={"it": tether("shed", (0, 1))}), "is of 'shed'; allowed is sheet"),
        (
            lambda: Simulation(Scene({"sheet": sheet}, constraints={"it": tether("sheet", (0, 16))}), device="cpu"),
            "it joins particle 16; allowed is 0 to 15",
        ),
    ):
        with pytest.raises(ValueError, match=sentence):
            make()
