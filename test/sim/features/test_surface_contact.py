# SPDX-License-Identifier: Apache-2.0
"""Contact of surfaces: sharp, thin and small colliders meet a sheet or a rope between its particles too."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from fixed_settings import fixed
from surfaces import outside_box, points_of

from cloth_sim_ros.sim import (
    Box,
    Capsule,
    Cloth,
    Cylinder,
    Handle,
    Mesh,
    Plane,
    Rope,
    Scene,
    Settings,
    Simulation,
    Sphere,
)
from cloth_sim_ros.study.throws import drawn, is_above, throw

SMOOTH = {"static_friction": 0.0, "kinetic_friction": 0.0}
HALF, THICKNESS, SPACING = np.array([0.3, 0.5, 0.2]), 0.02, 0.1  # a box whose corner is five times finer than the mesh


def deepest(sim, middle):
    """How deep any point lies in the thickened box [m]."""
    return max(0.0, THICKNESS - outside_box(points_of(sim), HALF, middle).min())


def dragged_over_the_edge(device, rope=False, executor=None, **settings):
    """The deepest that the box ever is in what lies over its edge while it is pulled to and fro below."""
    friction = {"static_friction": 0.3, "kinetic_friction": 0.2}
    if rope:
        shape = {"start": (-0.2, 0, 0.25), "end": (1, 0, 0.25), "segments": 12}
        it = Rope(**shape, radius=THICKNESS, pins=None)
    else:
        it = Cloth(
            resolution=(15, 15),
            size=(1.4, 1.4),
            position=(0.35, 0.02, 0.25),
            pins=None,
            thickness=THICKNESS,
            **friction,
        )
    sim = Simulation(
        Scene({"it": it}, {"box": Box(half_extents=HALF, **friction)}), fixed(**settings), device, executor=executor
    )
    worst = 0.0
    for frame in range(45):
        middle = np.array([-0.15 * (1.0 - np.cos(np.pi * frame / 30)), 0.0, 0.0])
        sim.set_collider_pose("box", middle)
        sim.step()
        if frame > 12:
            worst = max(worst, deepest(sim, middle))
    assert sim.report()["it"]["max_penetration"] < 0.005 * THICKNESS, "particles stay outside too"
    return worst


@pytest.mark.parametrize(
    "settings",
    [
        {},
        *[
            pytest.param(some, marks=pytest.mark.long)
            for some in ({"order": 2}, {"iterations": 3}, {"executor": "graph"})
        ],
        pytest.param({"method": "verlet", "substeps": 60}, marks=pytest.mark.long),
    ],
)
def test_a_sharp_edge_does_not_poke_between_the_particles(device, settings):
    assert dragged_over_the_edge(device, **settings) < 0.01 * SPACING


@pytest.mark.parametrize("settings", [{}, pytest.param({"executor": "graph", "iterations": 2}, marks=pytest.mark.long)])
def test_a_rope_lies_over_the_edge_with_its_segments(device, settings):
    assert dragged_over_the_edge(device, rope=True, **settings) < 0.01 * SPACING


@pytest.mark.long
def test_a_thin_fast_pole_takes_the_sheet_along(device):
    """At 20 m/s it crosses a sheet that is 30 times as wide as itself between two rows, within a frame."""
    sheet = Cloth(resolution=(6, 6), size=(0.5, 0.5), pins=None, thickness=0.002)
    pole = Capsule(
        radius=0.002, half_length=0.5, position=(0.0, 0, -0.1), orientation=(np.sqrt(0.5), 0, 0, np.sqrt(0.5))
    )
    sim = Simulation(Scene({"sheet": sheet}, {"pole": pole}, gravity=(0, 0, 0)), device=device)
    for height in (0.233, 0.567):
        sim.set_collider_pose("pole", (0, 0, height), pole.orientation)
        sim.step()
    rows = sim.positions("sheet")[:, 2].reshape(6, 6)
    beside = rows[:, 2:4].mean(axis=1)  # of the two rows that the pole came up between
    assert np.median(beside) > 0.55 and beside.min() > 0.45


def test_an_edge_is_pushed_as_by_a_force_at_the_point_of_contact(device):
    """Both ends share it so that nothing turns about that point."""
    points = [[0.0, 0, 0.1], [1.0, 0, 0.1]]
    rope = Rope(points=points, radius=0.05, pins=None, particle_masses=[1.0, 3.0])
    knife = Box(half_extents=(1e-3, 1, 0.04), position=(0.3, 0, 0))
    sim = Simulation(Scene({"it": rope}, {"knife": knife}, gravity=(0, 0, 0)), fixed(substeps=1), device)
    sim.set_collider_pose("knife", (0.3, 0, 0.03))
    sim.step()
    momentum = np.array([1.0, 3.0]) * sim.velocities("it")[:, 2]
    assert momentum.sum() > 1.0 and abs(momentum @ [-0.3, 0.7]) < 5e-3 * momentum.sum()
    x = sim.positions("it")
    assert 0.7 * x[0, 2] + 0.3 * x[1, 2] == pytest.approx(0.12, abs=1e-4)


@pytest.mark.parametrize(("radius", "speed"), [(0.02, 1.0), (0.03, 5.0), (0.05, 20.0)])
def test_a_small_fast_ball_does_not_pass(device, radius, speed):
    """Particles are 4.3 cm apart, and nothing is said of the solver."""
    sheet, beside = Cloth(resolution=(24, 24)), np.array([0.013, 0.017])
    ball = Sphere(radius=radius, position=(*beside, -0.3))
    sim = Simulation(Scene({"it": sheet}, {"ball": ball}, gravity=(0, 0, 0)), device=device)
    height = -0.3
    while height < 0.2:
        height = min(height + speed / 60, 0.2)
        sim.set_collider_pose("ball", (*beside, height))
        sim.step()
        assert sim.report()["it"]["max_penetration"] < sheet.thickness
        assert np.linalg.norm(points_of(sim, steps=8) - (*beside, height), axis=1).min() > radius
    above = points_of(sim)
    column = np.linalg.norm(above[:, :2] - beside, axis=1) < 0.01
    assert column.any() and above[column, 2].min() > height, "the sheet is above the ball everywhere"


@pytest.mark.parametrize(
    ("resolution", "constant", "settings"),
    [
        (12, 1e3, {}),
        (12, 1e5, {"method": "xpbd", "substeps": 5}),
        (24, 1e3, {"substeps": 20, "iterations": 4}),
        pytest.param(24, 1e5, {}, marks=pytest.mark.long),
        pytest.param(24, 1e3, {"method": "xpbd", "order": 1, "substeps": 5}, marks=pytest.mark.long),
    ],
)
@pytest.mark.parametrize(("radius", "speed"), [(0.02, 1.0), (0.03, 10.0), (0.05, 20.0)])
def test_no_ball_passes_a_clamped_sheet_that_it_stretches_by_half(
    device, resolution, constant, settings, radius, speed
):
    """However springs pull, no point of the sheet is deeper than its thickness at the end of a frame."""
    springs = {"stretch_compliance": 1.0 / constant, "shear_compliance": 3.0 / constant}
    sheet, beside = Cloth(resolution=(resolution, resolution), pins="edges", **springs), np.array([0.013, 0.017])
    ball, height = Sphere(radius=radius, position=(*beside, -0.1 - radius)), -0.1 - radius
    sim = Simulation(Scene({"it": sheet}, {"ball": ball}), Settings(**settings), device)
    while height < 0.45:
        height = min(height + speed / 60, 0.45)
        sim.set_collider_pose("ball", (*beside, height))
        sim.step()
        assert np.linalg.norm(points_of(sim, steps=8) - (*beside, height), axis=1).min() > radius
    above = points_of(sim)
    column = np.linalg.norm(above[:, :2] - beside, axis=1) < 0.01
    assert column.any() and above[column, 2].min() > height
    assert sim.report()["it"]["max_strain"] > 0.3


SMALL = {"ball": Sphere(radius=0.02), "capsule": Capsule(radius=0.01, half_length=0.05)}


@pytest.mark.long
@pytest.mark.parametrize(
    ("shape", "constant", "speed", "settings"),
    [
        ("ball", 1e5, 10.0, {}),
        ("capsule", 1e3, 5.0, {}),
        ("ball", 1e3, 20.0, {}),
        ("capsule", 1e5, 20.0, {"substeps": 60}),  # by the choice 3 of 150 places are deeper, up to 13 mm
        ("ball", 1e5, 5.0, {"substeps": 80, "iterations": 1}),
        ("capsule", 1e5, 10.0, {"substeps": 20, "iterations": 4}),
        ("ball", 1e3, 10.0, {"substeps": 5, "iterations": 1}),
    ],
)
def test_a_fine_sheet_that_a_small_thing_stretches_manifold_lets_nothing_through(
    device, shape, constant, speed, settings
):
    """Particles are 1 cm apart, too near for the collider unless it stretches the sheet by far more than half."""
    springs = {"stretch_compliance": 1.0 / constant, "shear_compliance": 3.0 / constant}
    sheet = Cloth(resolution=(64, 64), size=(0.6, 0.6), thickness=0.005, pins="edges", **springs)
    lying = (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))
    place, height = np.array([0.013, 0.021, 0.0]), -0.07
    thing = replace(SMALL[shape], position=(*place[:2], height), orientation=lying)
    sim = Simulation(Scene({"it": sheet}, {"thing": thing}, gravity=(0, 0, 0)), Settings(**settings), device)
    for _ in range(max(6, int(np.ceil(0.32 / speed * 60)) + 3)):
        height = min(height + speed / 60, 0.25)
        sim.set_collider_pose("thing", (*place[:2], height), lying)
        sim.step()
        assert sim.report()["it"]["max_penetration"] < sheet.thickness
    assert is_above(sim, "it", (*place[:2], height))
    assert sim.report()["it"]["max_strain"] > 0.5


def test_what_turns_while_it_moves_does_not_come_through(device):
    """In a substep it turns by a fifth of a right angle, and moves by more than its thickness."""
    sheet = Cloth(resolution=(32, 32), size=(0.6, 0.6), thickness=0.005, pins="edges")
    turned = [(0.0, np.sin(angle), 0.0, np.cos(angle)) for angle in np.linspace(0.25 * np.pi, 0.0, 6)]
    pole = Capsule(radius=0.01, half_length=0.05, position=(0.013, 0.021, -0.06), orientation=turned[0])
    settings = Settings(substeps=1, iterations=1, frame_dt=1 / 300)
    sim = Simulation(Scene({"it": sheet}, {"pole": pole}, gravity=(0, 0, 0)), settings, device)
    for k in range(1, 9):
        place = (0.013, 0.021, -0.06 + 5 / 300 * k)
        sim.set_collider_pose("pole", place, turned[min(k, 5)])
        sim.step()
        assert sim.report()["it"]["max_penetration"] < sheet.thickness
    assert is_above(sim, "it", place)


@pytest.mark.parametrize("number", [3119, 3858])
def test_the_edge_of_a_fast_thin_box_does_not_cut_into_a_triangle(device, number):
    """A triangle touches it at one point and comes on to it at another, within one substep."""
    random = np.random.default_rng((6, number))
    each = drawn(random)
    assert each.thing == "thin box" and each.speed == 20.0
    assert throw(each, random, device).depth < each.thickness


@pytest.mark.parametrize("order", [pytest.param(1, marks=pytest.mark.long), 2])
def test_what_sticks_between_particles_does_not_creep(device, order):
    sheet = Cloth(resolution=(14, 14), size=(0.6, 0.6), pins=None, position=(0.01, 0, 0.11), damping=2e-3)
    scene = Scene({"it": sheet}, {"ball": Sphere(radius=0.1, static_friction=1.0, kinetic_friction=1.0)})
    sim = Simulation(scene, Settings(method="xpbd", order=order, substeps=20, global_damping=1.0), device=device)
    sim.step(180)
    first = sim.positions("it").astype(float)
    top = np.argmin(np.linalg.norm(first - (0, 0, 0.105), axis=1))
    sim.step(300)
    assert np.linalg.norm(sim.positions("it")[top] - first[top]) < 1e-4
    assert sim.report()["it"]["max_penetration"] < 5e-4, "a tenth of the thickness"


@pytest.mark.parametrize(
    ("material", "order"), [("cotton", 2), *(pytest.param("denim", order, marks=pytest.mark.long) for order in (1, 2))]
)
def test_a_towel_that_hangs_over_the_edge_of_a_table_comes_to_rest(device, material, order):
    """The edge presses lines across triangles. At one point of each, they rocked at 1 to 4 cm/s for ever."""
    towel = Cloth.of(material, resolution=(20, 20), size=(0.5, 0.5), position=(-0.1, 0, 0.01), pins=None)
    table = Box(half_extents=(0.5, 0.5, 0.2), position=(-0.5, 0, -0.2))
    settings = Settings(order=order, substeps=40, global_damping=3.0)
    sim = Simulation(Scene({"it": towel}, {"table": table}), settings, device)
    sim.step(200)
    speeds = []
    for _ in range(20):
        sim.step()
        speeds.append(np.linalg.norm(sim.velocities("it"), axis=1).max())
    assert sim.positions("it")[:, 2].min() < -0.1, "it hangs"
    assert max(speeds) < 3e-3


def test_a_towel_that_slides_over_a_box_takes_the_substeps_that_it_takes_on_a_plane(device):
    """One plane bounds the whole way of each triangle. Searched, they would leave 6 of 10 substeps in the budget."""
    cloth = Cloth.of("cotton", resolution=(20, 20), size=(0.5, 0.5), position=(0, 0, 0.004), pins="none")
    taken = []
    for floor in Plane(), Box(half_extents=(1, 1, 0.2), position=(0, 0, -0.2)):
        sim = Simulation(Scene({"it": cloth}, {"floor": floor}), Settings(), device)
        substeps = []
        for k in range(60):
            if k % 3 == 0:
                v = sim.velocities("it")
                v[:, 0] += 0.5 * np.cos(k / 4)
                sim.set_velocities("it", v)
            sim.step()
            substeps.append(sim.report()["it"]["substeps"])
        taken.append(np.median(substeps[20:]))
    assert taken[1] >= 0.9 * taken[0]


def in_two_parts(**friction):
    """The table below as a mesh with a box beside it, so that it is not convex."""
    table, beside = trimesh.creation.box(extents=(1, 1, 0.1)), trimesh.creation.box(extents=(0.1, 0.1, 0.1))
    both = trimesh.util.concatenate([table, beside.apply_translation((0.8, 0, 0))]).subdivide()
    return Mesh(both.vertices, both.faces, position=(0, 0, -0.05), **friction)


def slid_over(table, speed, substeps, frames, device):
    """How far a towel without friction slides [m], which begins at the edge of a table, at this speed [m/s]."""
    cloth = Cloth.of("cotton", resolution=(10, 10), size=(0.3, 0.3), position=(0, 0.33, 0.001), pins=None, **SMOOTH)
    sim = Simulation(Scene({"it": cloth}, {"table": table}), Settings(substeps=substeps, sleep=False), device)
    sim.set_velocities("it", np.tile(np.float32([0.0, speed, 0.0]), (100, 1)))
    start = sim.positions("it")[:, 1].mean()
    sim.step(frames)
    return sim.positions("it")[:, 1].mean() - start


@pytest.mark.parametrize("substeps", [0, 20])
@pytest.mark.parametrize("speed", [0.3, 1.0])
def test_a_towel_slides_over_the_edge_of_a_table_as_friction_lets_it(device, speed, substeps):
    """The way along the table had been given up with the way into its side: the edge stopped what had no friction."""
    frames = round(0.06 / speed * 60)  # two of ten rows come beyond the edge
    table = Box(half_extents=(0.5, 0.5, 0.05), position=(0, 0, -0.05), **SMOOTH)
    assert slid_over(table, speed, substeps, frames, device) == pytest.approx(speed * frames / 60, rel=0.02)


@pytest.mark.parametrize(("substeps", "more"), [(0, 0.05), (80, 0.03)])
def test_a_towel_slides_over_the_edge_of_a_mesh_as_over_that_of_a_box(device, substeps, more):
    """In few substeps it goes 3 to 4 % less far over that of a box, and as far over both in many."""
    table = Box(half_extents=(0.5, 0.5, 0.05), position=(0, 0, -0.05), **SMOOTH)
    ways = [slid_over(each, 1.0, substeps, 28, device) for each in (table, in_two_parts(**SMOOTH))]
    assert 0.97 * ways[0] < ways[1] < (1.0 + more) * ways[0]


@pytest.mark.parametrize("count", [53, 57])
def test_a_strip_that_a_hand_draws_over_a_thin_bar_has_the_friction_of_the_capstan(device, count):
    """Where three facets share a particle, friction had acted as a part of Coulomb's: 13 and 11 % were missing."""
    mu, radius, thickness, length, load = 0.4, 0.01, 0.002, 0.4, 0.2
    along = np.linspace(-0.5 * length, 0.5 * length, count)
    down = np.maximum(along, 0.0)
    points = [(x, min(y, thickness), thickness - z) for y, z in zip(along, down, strict=True) for x in (-0.02, 0, 0.02)]
    masses = np.full(3 * count, 1e-5)
    masses[-3:] += load / 3
    friction = {"static_friction": mu, "kinetic_friction": mu}
    strip = Cloth(
        resolution=(3, count), size=(0.04, length), pins=None, particle_masses=masses, thickness=thickness,
        stretch_compliance=1e-4, damping=0.02, **friction,
    )  # fmt: skip
    lying = {"position": (0.0, 0.0, -radius), "orientation": (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))}
    hand = Handle(position=(0.0, -0.5 * length, thickness), reach=0.03)
    scene = Scene({"it": strip}, {"bar": Cylinder(radius, 0.5, **lying, **friction)}, handles={"hand": hand})
    sim = Simulation(scene, Settings(substeps=100, sleep=False), device)
    sim.set_positions("it", np.array(points))
    sim.attach("hand")
    pulls = []
    for frame in range(160):
        sim.set_handle_pose("hand", (0.0, -0.5 * length - 0.02 * max(0, frame - 20) / 60, thickness))
        sim.step()
        pulls.append(np.linalg.norm(sim.handle_wrench("hand")[0]))
    assert np.mean(pulls[80:]) == pytest.approx(9.81 * load * np.exp(0.5 * np.pi * mu), rel=0.08)


def test_a_sheet_that_bounces_on_a_ball_gains_no_energy(device):
    """What presses facets is no force that BDF2 may carry on: they would leave the ball faster than they came."""
    sheet = Cloth(resolution=(8, 8), pins="none", position=(0, 0, 0.3))
    ball = Sphere(0.3, position=(0, 0, -0.05))
    sim = Simulation(Scene({"it": sheet}, {"ball": ball}), fixed(substeps=80), device)
    most = []
    for _ in range(40):
        sim.step()
        v, z = sim.velocities("it"), sim.positions("it")[:, 2]
        most.append(9.81 * z.mean() + 0.5 * np.square(v).sum(axis=1).mean())
    assert z.mean() > 0.08, "it bounced"
    assert max(most) < 9.81 * 0.3
    assert max(most[25:]) < 0.7 * 9.81 * 0.3


@pytest.mark.parametrize("radius", [0.012, 0.024, 0.05])
@pytest.mark.parametrize("method", ["auto", "xpbd"])
@pytest.mark.long
def test_a_cloth_over_a_rail_comes_to_rest(device, radius, method):
    """Its own tension presses it on a rail that lies between its particles: nothing of that may shake it."""
    sheet = Cloth(resolution=(24, 24), pins="none")
    along_x = (0, np.sqrt(0.5), 0, np.sqrt(0.5))
    rail = Capsule(radius=radius, half_length=0.8, position=(0, 0.03, -radius - 0.005), orientation=along_x)
    sim = Simulation(Scene({"it": sheet}, {"rail": rail}), Settings(method=method, global_damping=2.0), device=device)
    sim.set_positions("it", sim.positions("it") - sim.positions("it").mean(axis=0))
    sim.step(480)
    energies = []
    for _ in range(10):
        sim.step(4)
        energies.append(0.5 * np.mean(np.sum(sim.velocities("it").astype(float) ** 2, axis=1)))
    assert abs(sim.positions("it")[:, 1].mean()) < 0.1, "it slid off"
    assert np.median(energies) < 3e-6  # [J/kg]


@pytest.mark.parametrize("segments", [40, 100])
@pytest.mark.long
def test_a_hand_pulls_a_rope_around_a_peg(device, segments):
    """The peg is 15 mm thick or less than a segment. The rope is long enough, so it neither stretches nor passes."""
    peg = np.array([0.0, 0.03])
    rope = Rope.of("cotton rope", segments=segments, start=(-0.5, 0, 0.02), end=(0.5, 0, 0.02), pins="start")
    hand, frames = Handle(position=(0.5, 0, 0.02), reach=0.05), 72
    colliders = {"peg": Capsule(radius=0.015, half_length=0.3, position=(*peg, 0.1)), "floor": Plane()}
    sim = Simulation(Scene({"it": rope}, colliders, handles={"hand": hand}), device=device)
    assert sim.attach("hand") > 0
    most = 0.0
    for frame in range(1, frames + 31):
        share = min(frame / frames, 1.0)
        angle, radius = 0.9 * np.pi * share, 0.5 - 0.25 * share
        sim.set_handle_pose("hand", (radius * np.cos(angle), radius * np.sin(angle), 0.02))
        sim.step()
        x = sim.positions("it").astype(np.float64)
        most = max(most, np.abs(np.linalg.norm(np.diff(x, axis=0), axis=1) * segments - 1.0).max())
    around = np.unwrap(np.arctan2(x[:, 1] - peg[1], x[:, 0] - peg[0]))
    assert around[-1] - around[0] == pytest.approx(1.9 * np.pi, abs=0.2), "it came through"
    assert most < 0.05


@pytest.mark.parametrize(("segments", "load"), [(40, 0.2), (40, 1.0), (100, 1.0), (100, 5.0)])
@pytest.mark.long
def test_a_weight_hangs_over_a_bar(device, segments, load):
    """On a bar without friction the rope pulls alike on both sides, and it stretches by next to nothing."""
    radius = 0.03 + 0.004
    along = np.linspace(0.0, 1.0, segments + 1) - 0.3
    angle = np.clip(along / radius, 0.0, np.pi)
    points = np.stack([-radius * np.cos(angle), 0.0 * angle, radius * np.sin(angle)], axis=1)
    points[:, 2] += np.minimum(along, 0.0) - np.maximum(along - np.pi * radius, 0.0)
    rope = Rope.of("cotton rope", points=points, pins="start", end_mass=load)
    bar = Capsule(radius=0.03, half_length=0.3, orientation=(0.5**0.5, 0, 0, 0.5**0.5), **SMOOTH)
    sim = Simulation(Scene({"it": rope}, {"bar": bar}), Settings(global_damping=2.0), device)
    sim.step(180)
    lifts, most = [], 0.0
    for _ in range(60):
        sim.step()
        lifts.append(-sim.wrench("bar")[0][2])
        lengths = np.linalg.norm(np.diff(sim.positions("it").astype(np.float64), axis=0), axis=1)
        most = max(most, np.abs(lengths * segments - 1.0).max())
    hangs = load + rope.mass * (1.0 - np.pi * radius - 0.3)  # beyond the bar, and as much pulls on this side
    assert np.mean(lifts) == pytest.approx(9.81 * (2.0 * hangs + rope.mass * np.pi * radius), rel=0.03)
    assert most < 0.1


def test_facets_are_tested_against_those_colliders_alone_that_come_between_particles(device):
    """A small ball does, a hill never: what lies on it touches it with its particles first."""
    colliders = {"ball": Sphere(radius=0.05, position=(0, 0, 0.2)), "hill": Sphere(radius=50.0)}
    sim = Simulation(Scene({"it": Cloth(resolution=(9, 9), position=(0, 0, 0.4))}, colliders), device=device)
    sim.step()
    tested = sim.device_arrays("it")[0].colliders.numpy()["facets"]
    assert dict(zip(colliders, tested.tolist(), strict=True)) == {"ball": 1, "hill": 0}
    sim.set("ball.radius", 5.0)
    sim.step()
    assert not sim.device_arrays("it")[0].colliders.numpy()["facets"].any()
