# SPDX-License-Identifier: Apache-2.0
"""Objects that touch one another: cloth on cloth, a rope on cloth, a rope over a rope."""

import numpy as np
import pytest
from crossings import crossings, edges_and_triangles

from cloth_sim_ros.sim import Box, Cloth, Plane, Rope, Scene, Settings, Simulation

GRAVITY = 9.81
WAYS = [{}, pytest.param({"order": 1, "substeps": 20, "iterations": 2}, marks=pytest.mark.long)]
FLOOR = {"floor": Plane(position=(0, 0, -9))}  # out of reach; with it the kernels are those of test_self_contact.py


def crossed(sim):
    """How many edges of objects go through a triangle of another."""
    parts = [edges_and_triangles(sim, name) for name in sim.scene.objects]
    return sum(crossings(x, edges, y, faces, False) for x, edges, _ in parts for y, _, faces in parts if x is not y)


def sheets(device, mu=0.5, tear_strain=0.0, **settings):
    """A sheet that falls on a fixed one: thicknesses of 2 and 4 mm, frictions of which mu is the geometric mean."""
    lower = Cloth(
        resolution=(8, 8),
        size=(0.2, 0.2),
        pins=tuple(range(64)),
        thickness=0.004,
        static_friction=2.0 * mu,
        kinetic_friction=2.0 * mu,
    )
    upper = Cloth(
        resolution=(6, 6),
        size=(0.13, 0.13),
        position=(0.004, 0.003, 0.012),
        pins=None,
        thickness=0.002,
        mass=0.05,
        static_friction=0.5 * mu,
        kinetic_friction=0.5 * mu,
        tear_strain=tear_strain,
    )
    return Simulation(Scene({"lower": lower, "upper": upper}, FLOOR, object_contact=True), Settings(**settings), device)


@pytest.mark.parametrize("settings", WAYS)
def test_a_sheet_rests_on_another_at_both_thicknesses(device, settings):
    sim = sheets(device, **settings)
    sim.step(60)
    assert np.allclose(sim.positions("upper")[:, 2], 0.006, atol=2e-4)
    assert np.linalg.norm(sim.velocities("upper"), axis=1).max() < 2e-3
    assert crossed(sim) == 0 and sim.report()["upper"]["crossings"] == 0


@pytest.mark.parametrize("settings", WAYS)
def test_sheets_rub_by_the_geometric_mean_of_their_friction(device, settings):
    mu, time = 0.5, 0.2
    for angle, slides in ((0.7 * np.arctan(mu), False), (1.4 * np.arctan(mu), True)):
        sim = sheets(device, mu, **settings)
        sim.step(20)
        before = sim.positions("upper").mean(axis=0)
        sim.set("gravity", (GRAVITY * np.sin(angle), 0.0, -GRAVITY * np.cos(angle)))
        sim.step(round(60 * time))
        moved = (sim.positions("upper").mean(axis=0) - before)[0]
        wanted = 0.5 * GRAVITY * (np.sin(angle) - mu * np.cos(angle)) * time**2 if slides else 0.0
        assert moved == pytest.approx(wanted, rel=0.1, abs=2e-4)


@pytest.mark.parametrize("substeps", [10, 20])
@pytest.mark.parametrize(("count", "mu"), [(9, 0.0), (2, 0.0), (9, 0.2)])
def test_a_sheet_slides_down_another_as_down_a_plane(device, count, mu, substeps):
    """Each triangle beside its way had held a particle back: 3 to 20 % of the speed was lost."""
    angle, way = 0.3, np.float32([0.0, -np.cos(0.3), -np.sin(0.3)])
    turn, up = (np.sin(0.5 * angle), 0, 0, np.cos(0.5 * angle)), np.array([0.0, -np.sin(angle), np.cos(angle)])
    rubs = {"orientation": turn, "thickness": 0.002, "static_friction": mu, "kinetic_friction": mu}
    slope = Cloth(resolution=(17, 17), size=(1, 1), pins=tuple(range(289)), **rubs)
    towel = Cloth(
        resolution=(count, count), size=(0.25, 0.25), pins=None, position=tuple(0.004 * up), damping=0.01, **rubs
    )
    scene = Scene({"slope": slope, "towel": towel}, object_contact=True)
    sim = Simulation(scene, Settings(substeps=substeps, sleep=False), device)
    sim.step(30)
    speed = (sim.velocities("towel") @ way).mean()
    assert speed == pytest.approx(0.5 * GRAVITY * (np.sin(angle) - mu * np.cos(angle)), rel=0.01)


@pytest.mark.parametrize(("seed", "substeps"), [(3, 10), (15, 10), (18, 0), (34, 0)])
def test_towels_that_are_thrown_on_a_hung_one_never_cross(device, seed, substeps):
    """Edges 2 micrometres apart had crossed, and what began to move while trial frames had other substeps."""
    random, fabrics = np.random.default_rng(seed), ("cotton", "silk", "denim")

    def named(k, count, side, **more):
        return Cloth.of(fabrics[k % 3], resolution=(count, count), size=(side, side), self_contact=True, **more)

    objects = {"hung": named(seed, 16, 0.5, position=(0, 0, 0.5), pins=(0, 15, 240, 255))}
    for k in range(2):
        place = (random.uniform(-0.1, 0.1), random.uniform(-0.1, 0.1), 0.8 + 0.35 * k)
        turn = random.normal(size=4)
        turn = tuple(turn / np.linalg.norm(turn))
        objects[f"thrown{k}"] = named(seed + k + 1, 12, 0.3, position=place, orientation=turn, pins=None)
    scene = Scene(objects, object_contact=True)
    sim = Simulation(scene, Settings(substeps=substeps, sleep=False), device)
    for k in range(2):
        speed = random.normal(size=3) * (1.0, 1.0, 0.5) - (0.0, 0.0, 2.0)
        sim.set_velocities(f"thrown{k}", np.tile(np.float32(speed), (144, 1)))
    for _ in range(15):
        sim.step(4)
        assert not any(each["crossings"] for each in sim.report().values())


@pytest.mark.long
def test_the_parts_of_a_cut_sheet_slide_apart_on_another(device):
    """Without friction, at the velocity that each was given, and as high above what they lie on as before."""
    sim = sheets(device, 0.0, tear_strain=0.5)
    sim.step(60)
    cut = np.array([(0.004, -1.0, -1.0), (0.004, 1.0, -1.0), (0.004, 1.0, 1.0), (0.004, -1.0, 1.0)])
    assert sim.cut("upper", cut) == 6 + 2 * 5
    x = sim.positions("upper").astype(float)
    way = np.where(x[:, :1] > 0.004, 1.0, -1.0) * (0.03, 0.0, 0.0)
    sim.set_velocities("upper", way)
    sim.step(60)
    moved = sim.positions("upper") - x
    assert np.allclose(moved[:, :2], way[:, :2], atol=1e-3)
    assert np.allclose(sim.positions("upper")[:, 2], 0.006, atol=2e-4)
    assert crossed(sim) == 0 and sim.report()["upper"]["recoveries"] == 0


def test_a_hit_keeps_momentum_in_any_order_of_objects(device):
    """A sheet at 3 m/s hits another that is free and three times as heavy."""
    found = []
    for order in (("fast", "slow"), ("slow", "fast")):
        each = {
            "fast": Cloth(
                resolution=(7, 7),
                size=(0.2, 0.2),
                position=(0.01, 0.02, 0.05),
                orientation=(0, 0, np.sin(0.2), np.cos(0.2)),
                pins=None,
                mass=0.1,
            ),
            "slow": Cloth(resolution=(9, 9), size=(0.3, 0.3), pins=None, mass=0.3),
        }
        scene = Scene({name: each[name] for name in order}, FLOOR, object_contact=True, gravity=(0, 0, 0))
        sim = Simulation(scene, device=device)
        sim.set_velocities("fast", np.tile([0.5, 0.0, -3.0], (49, 1)))
        for frame in range(20):
            sim.step()
            assert crossed(sim) == 0
            if frame == 3:  # later, rounding has grown
                found.append({name: sim.positions(name) for name in each})
        momentum = sum((sim.masses(name)[:, None] * sim.velocities(name)).sum(0) for name in each)
        assert np.allclose(momentum, [0.05, 0.0, -0.3], atol=1e-6)
        assert sim.velocities("slow")[:, 2].mean() < -0.5, "they met"
    assert all(np.abs(found[0][name] - found[1][name]).max() < 1e-4 for name in each)


def test_a_rope_lies_on_a_sheet(device):
    """It comes to rest on it, above all of it."""
    sheet = Cloth(resolution=(12, 12), pins="edges", mass=0.1, thickness=0.004)
    rope = Rope(start=(-0.3, 0.02, 0.03), end=(0.3, -0.05, 0.03), segments=30, pins=None, radius=0.006, mass=0.1)
    scene = Scene({"sheet": sheet, "rope": rope}, FLOOR, object_contact=True)
    sim = Simulation(scene, Settings(global_damping=3.0), device)
    for _ in range(30):
        sim.step(3)
        assert crossed(sim) == 0 and sim.report()["rope"]["crossings"] == 0
    assert sim.positions("rope")[:, 2].max() < 0.02
    assert np.linalg.norm(sim.velocities("rope"), axis=1).max() < 0.2
    x, faces = sim.positions("sheet"), sim.triangles("sheet")
    middles = x[faces].mean(1)
    off = sim.positions("rope")[:, None] - middles[None]
    nearest = np.linalg.norm(off, axis=-1).argmin(1)
    over = off[np.arange(31), nearest][:, 2]
    assert over.min() > 0.0, "it lies above"


def test_a_rope_hangs_over_a_rope(device):
    """One is stretched along x; the other falls across it and hangs over it, as far away as both are thick."""
    taut = Rope(start=(-0.3, 0, 0), end=(0.3, 0, 0), segments=20, pins="both", radius=0.008, mass=0.05)
    over = Rope(start=(0.013, -0.2, 0.04), end=(0.013, 0.2, 0.04), segments=21, pins=None, radius=0.006, mass=0.05)
    scene = Scene({"taut": taut, "over": over}, FLOOR, object_contact=True)
    sim = Simulation(scene, Settings(global_damping=2.0), device)
    apart = []
    for _ in range(30):
        sim.step(3)
        lines = [np.linspace(x[:-1], x[1:], 21).reshape(-1, 3) for x in map(sim.positions, ("taut", "over"))]
        apart.append(np.linalg.norm(lines[0][:, None] - lines[1][None], axis=-1).min())
    assert min(apart) > 0.9 * 0.014
    assert apart[-1] == pytest.approx(0.014, rel=0.05)
    assert sim.positions("over")[[0, -1], 2].max() < -0.1, "its ends hang"


def test_contacts_with_colliders_are_counted(device):
    """A sheet lies on a floor, and nothing lies on a floor far below."""
    sheet = Cloth(resolution=(6, 6), position=(0, 0, 0.006), pins=None)
    for height, count in ((0.0, 36), (-5.0, 0)):
        sim = Simulation(Scene({"it": sheet}, {"floor": Plane(position=(0, 0, height))}), device=device)
        sim.step(20)
        assert sim.report()["it"]["contacts"] == count


@pytest.mark.long
def test_the_same_bits_again_and_in_many_worlds(device):
    sims = [sheets(device), sheets(device)]
    many = Simulation(sims[0].scene, device=device, worlds=3)
    for sim in (*sims, many):
        sim.step(20)
    for name in ("lower", "upper"):
        first = sims[0].positions(name)
        assert np.array_equal(first, sims[1].positions(name))
        assert all(np.array_equal(first, many.positions(name, w)) for w in range(3))


def test_explicit_steps_refuse_it():
    both = {"a": Cloth(resolution=(4, 4)), "b": Cloth(resolution=(4, 4), position=(0, 0, 1))}
    scene = Scene(both, FLOOR, object_contact=True)
    with pytest.raises(ValueError, match="method is 'verlet' with object_contact of"):
        Simulation(scene, Settings(method="verlet"), "cpu")
    assert Simulation(scene, device="cpu").choices["a"].method == "xpbd"


@pytest.mark.parametrize(("substeps", "order", "tray"), [(6, 2, 0.0), (10, 1, 0.0), (10, 2, 3.0)])
def test_layers_that_stop_one_another_are_not_pushed_into_a_collider(device, substeps, order, tray):
    """Two towels fall at 3 m/s, faster than they lie apart in a substep, on a tray that rises after half a second."""
    tilted = {"orientation": (np.sin(0.15), 0.0, 0.0, np.cos(0.15)), "pins": "none", "thickness": 0.001}
    layers = {
        name: Cloth(resolution=(12, 12), size=(0.3, 0.3), position=(0.0, 0.0, height), **tilted)
        for name, height in (("low", 0.1), ("high", 0.103))
    }
    floor = Box(half_extents=(1.0, 1.0, 0.05), position=(0.0, 0.0, -0.05))
    settings = Settings(substeps=substeps, order=order)
    sim = Simulation(Scene(layers, {"floor": floor}, object_contact=True), settings, device)
    for name in layers:
        sim.set_velocities(name, np.tile((0.0, 0.0, -3.0), (144, 1)))
    for frame in range(60):
        sim.set_collider_pose("floor", (0.0, 0.0, -0.05 + tray * max(0, frame - 29) / 60))
        sim.step()
        for each in sim.report().values():
            assert each["particle_penetration"] < 1e-4 and each["crossings"] == 0
