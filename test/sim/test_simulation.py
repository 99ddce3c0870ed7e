# SPDX-License-Identifier: Apache-2.0
"""The public face: what is set is read back, what is live takes effect, what is bad changes nothing."""

import numpy as np
import pytest
from fixed_settings import fixed

from cloth_sim_ros.sim import (
    Box,
    Capsule,
    Cloth,
    Handle,
    Plane,
    Readback,
    Rope,
    Scene,
    Simulation,
    Sphere,
    Wind,
)  # fmt: skip


def sheet_sim(device, colliders=None, wind=None, **fields):
    cloth = Cloth(**{"resolution": (9, 9), "pins": "top", "orientation": (0.70710678, 0, 0, 0.70710678), **fields})
    return Simulation(Scene({"cloth": cloth}, colliders or {}, wind), fixed(), device)


def test_particles_lie_where_the_scene_says(device):
    sim = Simulation(Scene({"c": Cloth(resolution=(4, 3), size=(3, 2), position=(1, 2, 3))}), device=device)
    x = sim.positions("c")
    assert x.shape == (12, 3) and x.dtype == np.float32
    assert x[0].tolist() == [-0.5, 1.0, 3.0] and x[11].tolist() == [2.5, 3.0, 3.0] and x[1].tolist() == [0.5, 1.0, 3.0]


def test_reset_returns_to_the_first_bit(device):
    sim = sheet_sim(device, {"ball": Sphere(radius=0.2, position=(0, 0.5, 0))})
    runs = []
    for _ in range(2):
        for frame in range(10):
            sim.set_collider_pose("ball", (0, 0.5 - 0.05 * frame, 0))
            sim.step()
        runs.append(sim.positions("cloth"))
        assert sim.time == pytest.approx(10 / 60)
        sim.reset()
        assert sim.time == 0.0
    assert np.array_equal(*runs)


def test_what_may_be_in_millimetres_is_told_once_and_again_after_it_was_mended(caplog):
    square = [[0, 0, 0], [0.5, 0, 0], [0, 0.5, 0]]
    objects = {
        "flat": Cloth(resolution=(3, 3), size=(0.5, 0.2), thickness=0.06),
        "thin": Cloth(resolution=(3, 3), size=(0.5, 0.2), thickness=0.05),
        "mesh": Cloth.from_mesh(square, [[0, 1, 2]], thickness=1.0),
        "cord": Rope(points=[[0, 0, 1], [1, 0, 1], [0, 0.1, 1]], radius=0.3),
    }
    sim, ends = Simulation(Scene(objects), fixed(), "cpu"), "and 1 mm is 0.001"
    assert caplog.messages == [
        f"flat.thickness is 0.06 m for a cloth of 0.5 m; usual is up to 0.05 m, {ends}",
        f"mesh.thickness is 1 m for a cloth of 0.5 m; usual is up to 0.05 m, {ends}",
        f"cord.radius is 0.3 m for a rope of 2 m; usual is up to 0.2 m, {ends}",
    ]
    caplog.clear()
    for thickness in (0.5, 0.6, 0.001, 0.7):
        sim.set("thin.thickness", thickness)
    assert [message.partition(" m ")[0] for message in caplog.messages] == [
        "thin.thickness is 0.5", "thin.thickness is 0.7"
    ]  # fmt: skip


def test_more_kinetic_than_static_friction_is_told_once_and_again_after_it_was_mended(caplog):
    colliders = {
        "floor": Plane(static_friction=0.2, kinetic_friction=0.7),
        "wall": Plane(position=(0, 0, -1), static_friction=0.2, kinetic_friction=0.7),
        "ball": Sphere(position=(0, 0, -3), static_friction=0.7, kinetic_friction=0.7),
    }
    scene = Scene({"cord": Rope(segments=2, kinetic_friction=0.6)}, colliders, spare_colliders=1)
    sim, usual = Simulation(scene, fixed(), "cpu", worlds=2), "usual is at most that"
    assert caplog.messages == [
        f"kinetic_friction of cord is 0.6, above its static_friction, 0.5; {usual}",
        f"kinetic_friction of floor and 1 more is 0.7, above its static_friction, 0.2; {usual}",
    ]
    caplog.clear()
    for static, kinetic in ((0.3, 0.3), (0.1, 0.1), (0.1, [0.1, 0.3]), (0.05, 0.2), (0.7, 0.7), (0.1, 0.4)):
        sim.set("ball.static_friction", static)
        sim.set("ball.kinetic_friction", np.array(kinetic) if np.ndim(kinetic) else kinetic)
        sim.step()
    sim.add_collider("box", Box(static_friction=0.3))
    sim.step()
    sim.add_collider("box", Box(static_friction=0.2))
    sim.remove_collider("box")
    sim.step()
    assert caplog.messages == [
        f"kinetic_friction of ball is 0.3, above its static_friction, 0.1; {usual}",
        f"kinetic_friction of ball is 0.4, above its static_friction, 0.1; {usual}",
        f"kinetic_friction of box is 0.4, above its static_friction, 0.3; {usual}",
    ]


def test_set_state_and_read_it_back(device):
    sim = sheet_sim(device)
    x = sim.positions("cloth") + np.float32(0.25)
    v = np.ones_like(x)
    sim.set_positions("cloth", x)
    sim.set_velocities("cloth", v)
    assert np.array_equal(sim.positions("cloth"), x)
    pinned = np.zeros(81, dtype=bool)
    pinned[72:] = True
    assert (sim.velocities("cloth")[pinned] == 0).all() and (sim.velocities("cloth")[~pinned] == 1).all()
    sim.step()
    assert np.array_equal(sim.positions("cloth")[pinned], x[pinned])


@pytest.mark.parametrize(
    "action",
    [
        lambda sim: sim.set_positions("cloth", np.full((81, 3), np.nan)),
        lambda sim: sim.set_positions("cloth", np.zeros((80, 3))),
        lambda sim: sim.set_velocities("cloth", np.full((81, 3), 1e9)),
        lambda sim: sim.set_positions("curtain", np.zeros((81, 3))),
        lambda sim: sim.set_collider_pose("ball", (np.inf, 0, 0)),
        lambda sim: sim.set_collider_pose("ball", (0, 0, 1e9)),
        lambda sim: sim.set_collider_pose("ball", (0, 0, 0), (0, 0, 0, 0)),
        lambda sim: sim.set_collider_pose("cube", (0, 0, 0)),
        lambda sim: sim.set_wind((1, 0, 0)),
        lambda sim: sim.set("cloth.resolution", (3, 3)),
        lambda sim: sim.set("cloth.colour", 3),
        lambda sim: sim.set("cloth.bend_compliance", 1.0),
        lambda sim: sim.set("cloth.stretch_compliance", "soft"),
        lambda sim: sim.set("solver.substeps", 2.5),
        lambda sim: sim.set("solver.order", 2),
        lambda sim: sim.set("gravity", (0, 0)),
        lambda sim: sim.set("nobody.mass", 1.0),
        lambda sim: sim.set("ball.dimensions", 1.0),
        lambda sim: sim.set(None, 1.0),
        lambda sim: sim.step(-1),
        lambda sim: sim.step(True),
        lambda sim: sim.step(1.5),
        lambda sim: sim.save(3),
        lambda sim: sim.load(None),
    ],
)
def test_bad_values_are_refused_and_change_nothing(action):
    sims = [sheet_sim("cpu", {"ball": Sphere(radius=0.2, position=(0, 0.1, 0))}) for _ in range(2)]
    with pytest.raises(ValueError) as caught:
        action(sims[0])
    assert "allowed" in str(caught.value) and "\n" not in str(caught.value)
    for sim in sims:
        sim.step(5)
    assert np.array_equal(sims[0].positions("cloth"), sims[1].positions("cloth"))


def test_live_compliance_changes_the_sag_and_springs(device):
    sim = sheet_sim(device)
    before = sim.springs("cloth")["structural"][2]
    sim.set("cloth.stretch_compliance", 1e-2)
    after = sim.springs("cloth")["structural"][2]
    assert after == pytest.approx(before / 10, rel=1e-6)
    stiff = sheet_sim(device)
    for one in (sim, stiff):
        one.set("solver.global_damping", 8.0)
        one.step(90)
    assert sim.positions("cloth")[:, 2].min() < stiff.positions("cloth")[:, 2].min() - 2e-3


def test_a_rigid_spring_has_an_infinite_constant():
    sim = sheet_sim("cpu", stretch_compliance=0.0)
    assert np.isinf(sim.springs("cloth")["structural"][2]).all()


@pytest.mark.parametrize(
    "collider",
    [
        Sphere(radius=0.2, position=(0.0, -0.3, -0.1)),
        Capsule(radius=0.15, half_length=0.2, position=(0.0, -0.3, -0.1)),
        Box(half_extents=(0.15, 0.2, 0.1), position=(0.0, -0.3, -0.1)),
        Plane(normal=(0, 1, 0), point=(0.0, -0.3, -0.1)),
    ],
)
@pytest.mark.long
def test_a_moving_collider_pushes_the_cloth_and_none_stays_inside(device, collider):
    start = collider.position
    sim = sheet_sim(device, {"it": collider})
    for frame in range(45):
        sim.set_collider_pose("it", (0.0, start[1] + 0.01 * frame, start[2]), collider.orientation)
        sim.step()
    assert sim.positions("cloth")[:72, 1].max() > 0.1
    assert sim.report()["cloth"]["particle_penetration"] < 1e-4


def test_a_placed_collider_was_never_in_between(device):
    sim = sheet_sim(device, {"ball": Sphere(radius=0.2, position=(0, -0.5, 0))})
    sim.set("gravity", (0, 0, 0))
    before = sim.positions("cloth")
    sim.set_collider_pose("ball", (0, 0.5, 0), sweep=False)
    sim.step(3)
    assert np.array_equal(sim.positions("cloth"), before)


@pytest.mark.long
def test_a_fast_thin_collider_does_not_pass_through(device):
    """A plate thinner than its motion in a substep sweeps 0.8 m in two frames."""
    sim = sheet_sim(device, {"plate": Box(half_extents=(0.3, 0.001, 0.3), position=(0, -0.4, 0))}, pins=None)
    sim.set("gravity", (0, 0, 0))
    x = sim.positions("cloth")
    in_the_way = (np.abs(x[:, 0]) < 0.27) & (np.abs(x[:, 2]) < 0.27)
    assert in_the_way.sum() == 25
    for y in (0.0, 0.4):
        sim.set_collider_pose("plate", (0, y, 0))
        sim.step()
    assert sim.positions("cloth")[in_the_way, 1].min() > 0.4


def test_wind_lifts_and_stops(device):
    sim = sheet_sim(device, wind=Wind((0, 0, 0)))
    sim.set_wind((0, 8, 0))
    sim.step(30)
    assert sim.positions("cloth")[:9, 1].mean() > 0.1


def test_readback_writes_what_messages_hold(device):
    sim = sheet_sim(device)
    sim.step(5)
    readback = Readback(sim, "cloth", normals=True, velocities=True, mesh=True)
    readback.request()
    rows = readback.particles().copy()
    assert np.array_equal(rows[:, :3], sim.positions("cloth"))
    assert np.array_equal(rows[:, 6:], sim.velocities("cloth"))
    assert np.array_equal(readback.mesh().reshape(-1, 3, 3), rows[sim.triangles("cloth"), :3].astype(np.float64))
    assert np.linalg.norm(rows[:, 3:6], axis=1) == pytest.approx(np.ones(81), abs=1e-5)
    assert rows[40, 4] < -0.9  # local z of a sheet turned to hang in x and z
    sim.step(5)
    assert np.array_equal(readback.particles(), rows), "views hold until the next request"
    readback.request()
    assert not np.array_equal(readback.particles(), rows)


def test_readback_of_a_rope_is_its_line(device):
    sim = Simulation(Scene({"rope": Rope(segments=5)}), device=device)
    readback = Readback(sim, "rope", mesh=True)
    readback.request()
    assert np.array_equal(readback.mesh(), sim.positions("rope").astype(np.float64))


def test_report_measures_strain_energy_and_penetration(device):
    sim = sheet_sim(device, {"ball": Sphere(radius=0.2, position=(0, 0, -5))}, pins=None, shear_compliance=None)
    sim.set_collider_pose("ball", (0, 0, 0), sweep=False)
    x = sim.positions("cloth")
    sim.set_positions("cloth", x * 1.1)
    sim.set_velocities("cloth", np.tile([3.0, 0, 0], (81, 1)))
    report = sim.report()["cloth"]
    assert report["max_strain"] == pytest.approx(0.1, rel=1e-4)
    assert report["kinetic_energy"] == pytest.approx(0.5 * 0.2 * 9, rel=1e-5)
    assert report["max_penetration"] == report["particle_penetration"] == pytest.approx(0.205, rel=1e-4)


@pytest.mark.long
def test_penetration_is_of_the_surface(device):
    sheet = Cloth(resolution=(3, 3), pins=None, thickness=0.001)
    rope = Rope(segments=2, start=(-0.5, 0.25, 0), end=(0.5, 0.25, 0), pins=None, radius=0.001)
    colliders = {"in a triangle": Sphere(radius=0.03, position=(0, 0, -5))}
    sim = Simulation(Scene({"sheet": sheet, "rope": rope}, colliders), device=device)
    sim.set_collider_pose("in a triangle", (-0.25 / 3 * 2, -0.25 / 3 * 4, 0.01), sweep=False)
    report = sim.report()
    assert report["sheet"]["particle_penetration"] == report["rope"]["max_penetration"] == 0.0
    assert report["sheet"]["max_penetration"] == pytest.approx(0.021, abs=0.004)
    sim = Simulation(Scene({"rope": rope}, {"ball": Sphere(radius=0.05, position=(0, 0, -5))}), device=device)
    sim.set_collider_pose("ball", (0.25, 0.25, 0.02), sweep=False)
    assert sim.report()["rope"]["max_penetration"] == pytest.approx(0.031, abs=1e-4)


BALL = {"ball": Sphere(radius=0.2, position=(0, 0, -0.25))}
HAND = {"hand": Handle(position=(0.5, 0.5, 0), reach=0.1, attached=True, break_force=4.0)}
STEPPED = {  # scene, settings, worlds
    "bare sheet": (Scene({"it": Cloth(resolution=(7, 7))}), {"order": 2}, 1),
    "ball and wind": (Scene({"it": Cloth(resolution=(7, 7), pins="none")}, BALL, Wind((1, 0, 0))), {}, 1),
    "explicit, worlds": (Scene({"it": Cloth(resolution=(7, 7))}, BALL), {"method": "verlet", "substeps": 120}, 3),
    "done again": (Scene({"it": Cloth(resolution=(7, 7), pins="top")}), {"method": "verlet", "substeps": 120}, 2),
    "hand that lets go": (Scene({"it": Cloth(resolution=(7, 7), pins=(0,))}, handles=HAND), {}, 2),
    "ropes": (Scene({"it": Rope(segments=9), "other": Rope(segments=5, bend_compliance=5.0)}, BALL), {}, 1),
    "itself": (Scene({"it": Cloth(resolution=(7, 7), pins=(0, 1), self_contact=True)}, BALL), {}, 1),
}


def run_in_calls(case, device, whole, captured=False):
    """What several calls of step leave, each `whole` or frame by frame: positions, velocities, times and counts."""
    scene, settings, worlds = STEPPED[case]
    sim = Simulation(scene, fixed(**settings), device, worlds)
    sim._bodies.frames.captures |= captured  # Warp captures on a CPU too
    if case == "done again":
        sim.set_positions("it", sim.rest_positions("it") * (3.0, 3.0, 1.0), world=1)
    found = []
    for call, frames in enumerate((1, 4, 13, 4, 4, 13)):
        if scene.colliders:
            sim.set_collider_pose("ball", (0, 0.01 * call, -0.25 + 0.05 * call), (0, 0, 0.1 * call, 1))
        if scene.handles:
            sim.set_handle_pose("hand", (0.5, 0.5, 0.05 * call))
        if call == 4:
            sim.set("solver.substeps", 2 * sim.settings.substeps)
        for _ in range(1 if whole else frames):
            sim.step(frames if whole else 1)
        for name in scene.objects:
            found += [sim.positions(name, None).copy(), sim.velocities(name, None).copy()]
        found.append(np.array([sim.time, *(sim.broken(hand) for hand in scene.handles)]))
    return found, sim


@pytest.mark.parametrize("case", STEPPED)
@pytest.mark.long
def test_many_frames_of_a_call_are_those_of_as_many_calls(device, case):
    one_by_one, sim = run_in_calls(case, device, whole=False)
    assert sim.time == pytest.approx(39 / 60)
    if case == "done again":
        assert sim.report(1)["it"]["redone"] > sim.report(0)["it"]["redone"] == 0
    if sim.scene.handles:
        assert sim.broken("hand") == 1
    for captured in (False, True):
        found, _ = run_in_calls(case, device, whole=True, captured=captured)
        assert all(np.array_equal(a, b) for a, b in zip(found, one_by_one, strict=True)), captured
    assert not np.array_equal(found[0], found[-1 - 2 * len(sim.scene.objects)]), "something moves"
