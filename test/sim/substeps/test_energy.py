# SPDX-License-Identifier: Apache-2.0
"""A frame that gains energy is computed again: whatever a body starts from, its energy never exceeds that."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial import Delaunay

from cloth_sim_ros.sim import Cloth, Handle, Rope, Scene, Settings, Simulation, Wind

SIZE = 12
WAYS = [{"substeps": 1}, {"substeps": 5}, pytest.param({"substeps": 5, "order": 1}, marks=pytest.mark.long), {}]


def of(name, pins="corners"):
    grid = {"resolution": (SIZE, SIZE), "size": (1.0, 1.0), "pins": pins}
    if name == "springs":
        return Cloth(mass=0.2, stretch_compliance=1e-3, **grid)
    if name == "mesh":
        points = np.stack(np.meshgrid(*[np.linspace(0, 1, SIZE)] * 2), -1).reshape(-1, 2)
        inner = ((points > 0.01) & (points < 0.99)).all(axis=1)
        points[inner] += np.random.default_rng(3).uniform(-0.02, 0.02, (inner.sum(), 2))
        triangles = Delaunay(points).simplices
        return Cloth.from_mesh(
            np.c_[points, 0 * points[:, 0]], triangles, material="silk", pins=None if pins is None else [0, SIZE - 1]
        )
    return Cloth.of(name, **grid)


def energy_of(sim):
    """Kinetic energy, that of the springs and that of the weight, by NumPy; springs of a membrane are not coupled."""
    x, v, mass = (read("it").astype(np.float64) for read in (sim.positions, sim.velocities, sim.masses))
    elastic = 0.0
    for pairs, rest, constant in sim.springs("it").values():
        longer = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1) - rest
        elastic += 0.5 * float((constant * longer**2).sum())
    return 0.5 * float(mass @ (v**2).sum(1)), elastic, 9.81 * float(mass @ x[:, 2])


def start(sim, shape):
    rest, random = sim.positions("it").astype(np.float64), np.random.default_rng(1)
    middle = rest.mean(axis=0)
    shapes = {
        "ten times": middle + 10.0 * (rest - middle),
        "three times": middle + 3.0 * (rest - middle),
        "mirrored": middle + (rest - middle) * [-1, 1, 1],
        "in a box": middle + random.uniform(-0.5, 0.5, rest.shape),
    }
    thing, held = sim.scene.objects["it"], np.zeros((len(rest), 1), dtype=bool)
    if thing.pins is not None:
        held[[len(rest) - SIZE, len(rest) - 1] if thing.pins == "corners" else list(thing.pins)] = True
    sim.set_positions("it", np.where(held, rest, shapes[shape]))


@pytest.mark.parametrize("shape", ["ten times", "three times", "mirrored", "in a box"])
@pytest.mark.parametrize("settings", WAYS, ids=str)
@pytest.mark.parametrize("name", ["springs", "mesh"])
def test_energy_never_exceeds_that_of_the_start(name, settings, shape):
    sim = Simulation(Scene({"it": of(name)}), Settings(**settings), "cpu")
    start(sim, shape)
    kinetic, elastic, weight = energy_of(sim)
    first, fallen = kinetic + elastic + weight, 0.0
    for _ in range(30):
        sim.step(1)
        now = energy_of(sim)
        fallen = max(fallen, weight - now[2])
        assert sum(now) <= first + 0.05 * max(elastic, fallen)


@pytest.mark.parametrize("pins", [None, "corners"])
def test_what_is_hung_and_let_go_is_not_computed_again(pins):
    for name in ("springs", "cotton"):
        sim = Simulation(Scene({"it": of(name, pins)}, wind=Wind(velocity=(0.0, 3.0, 0.0))), Settings(), "cpu")
        sim.step(60)
        assert sim.report()["it"]["redone"] <= 1


def test_what_comes_to_rest_is_not_computed_again():
    """A load of 100 g pulls an irregular mesh down. In so few substeps it is too soft, and rests lower than in more."""
    points = 0.2 * np.stack(np.meshgrid(*[np.linspace(0, 1, SIZE)] * 2), -1).reshape(-1, 2)
    inner = ((points > 0.002) & (points < 0.198)).all(axis=1)
    points[inner] += np.random.default_rng(3).uniform(-0.004, 0.004, (inner.sum(), 2))
    masses = np.where(points[:, 1] < 0.001, 0.1 / SIZE, 3e-5)
    hung = Cloth.from_mesh(
        np.insert(points, 1, 0.0, axis=1),
        Delaunay(points).simplices,
        material="cotton",
        particle_masses=masses,
        pins=np.flatnonzero(points[:, 1] > 0.199).tolist(),
        bending="none",
    )
    sim = Simulation(Scene({"it": hung}), Settings(substeps=20, global_damping=8.0), "cpu")
    sim.step(90)
    before = sim.report()["it"]["redone"]
    sim.step(30)
    assert before <= 30 and sim.report()["it"]["redone"] == before


def test_work_of_hands_is_no_gain():
    handles = {"a": Handle(position=(-0.5, 0.5, 0.0), reach=0.02, attached=True)}
    sim = Simulation(Scene({"it": of("cotton", None)}, handles=handles, gravity=(0, 0, 0)), Settings(), "cpu")
    for frame in range(60):
        sim.set_handle_pose("a", (-0.5 + 0.02 * frame, 0.5, 0.0), (0.0, 0.0, 0.0, 1.0))
        sim.step(1)
    report = sim.report()["it"]
    assert report["kinetic_energy"] > 0.01 and report["redone"] <= 1


@pytest.mark.parametrize("bending", ["springs", "none"])
def test_elastic_energy_is_that_of_the_springs(bending):
    sim = Simulation(Scene({"it": Cloth(resolution=(SIZE, SIZE), bending=bending, pins="corners")}), Settings(), "cpu")
    start(sim, "three times") if bending == "none" else None
    sim.step(3)
    assert sim.report()["it"]["elastic_energy"] == pytest.approx(energy_of(sim)[1], rel=1e-4)


def test_elastic_energy_is_right_between_frames():
    """It was what the last frame left, less the kinetic energy of now."""
    sim = Simulation(Scene({"it": Cloth(resolution=(SIZE, SIZE), bending="none", pins="corners")}), Settings(), "cpu")
    sim.step(3)
    elastic = sim.report()["it"]["elastic_energy"]
    sim.set_velocities("it", np.full((SIZE * SIZE, 3), 2.0))
    assert sim.report()["it"]["elastic_energy"] == pytest.approx(elastic, rel=1e-3)
    start(sim, "three times")
    assert sim.report()["it"]["elastic_energy"] == pytest.approx(energy_of(sim)[1], rel=1e-4)


def bow(segments=20, length=1.0, chord=0.7):
    """Points of an arc that hangs between two points `chord` apart [m]."""
    half = brentq(lambda a: length * np.sin(a) / a - chord, 1e-3, 3.0)
    angles = np.linspace(-half, half, segments + 1)
    radius = length / (2.0 * half)
    return np.stack([radius * np.sin(angles), 0.0 * angles, radius * (np.cos(half) - np.cos(angles))], axis=1)


@pytest.mark.parametrize("material", ["rubber hose", "power cable"])
def test_elastic_energy_of_a_rope_is_that_of_its_stretch_and_bend(material):
    rope = Rope.of(material, points=bow(), pins=[0, 20])
    sim = Simulation(Scene({"it": rope}), Settings(), "cpu")
    sim.step(60)
    rest = np.linalg.norm(np.diff(bow(), axis=0), axis=1)
    stretched = 0.5 * (sim.tensions("it").astype(np.float64) ** 2 * rest).sum() * rope.stretch_compliance

    def turns(points):
        return np.linalg.norm(np.diff(np.diff(points, axis=0) / rest[:, None], axis=0), axis=1)

    bend = turns(sim.positions("it").astype(np.float64)) - turns(bow())
    spans = 0.5 * (rest[1:] + rest[:-1])
    bent = 0.5 * (bend**2 / spans).sum() / rope.bend_compliance
    assert sim.report()["it"]["elastic_energy"] == pytest.approx(stretched + bent, rel=0.02)


def test_elastic_energy_of_a_twisted_rope_is_that_of_its_twist():
    held = {"start": (0.0, 0.0, 0.0), "end": (1.0, 0.0, 0.0), "pins": [0, 1, 19, 20]}
    rope = Rope.of("power cable", segments=20, twist_compliance=20.0, end_turn=2.0, **held)
    sim = Simulation(Scene({"it": rope}, gravity=(0, 0, 0)), Settings(), "cpu")
    sim.step(2)
    # The segments in the clamps do not twist.
    assert sim.report()["it"]["elastic_energy"] == pytest.approx(0.5 * 2.0**2 / (rope.twist_compliance * 0.9), rel=0.01)


@pytest.mark.parametrize("material", ["nylon rope", "steel cable", "rubber hose"])
def test_hands_that_move_and_turn_a_rope_do_work_that_is_no_gain(material):
    points = bow()
    hands = {name: Handle(position=tuple(points[i]), reach=0.12, attached=True) for name, i in (("a", 0), ("b", -1))}
    rope = Rope.of(material, points=points, pins=None)
    sim = Simulation(Scene({"it": rope}, handles=hands), Settings(), "cpu")
    for frame in range(60):
        turn, way = 3.0 * frame / 60, 0.1 * np.sin(6.0 * frame / 60)
        sim.set_handle_pose("a", points[0] + (0.0, way, 0.0), (np.sin(turn), 0.0, 0.0, np.cos(turn)))
        sim.set_handle_pose("b", points[-1] + (0.0, 0.0, way), (0.0, 0.0, 0.0, 1.0))
        sim.step()
    report = sim.report()["it"]
    assert report["elastic_energy"] > 1e-3 and report["redone"] == 0


def tube(share):
    """Elastic energy of a tube without gravity and nearly without springs that is squashed by a share of its width."""
    around, along = np.linspace(0, 2 * np.pi, 24, endpoint=False), np.linspace(0.0, 0.3, 10)
    angle, z = (each.ravel() for each in np.meshgrid(around, along, indexing="ij"))
    points = np.stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), z], axis=1)
    i = np.arange(240).reshape(24, 10)
    a, b, c, d = (each.ravel() for each in (i[:, :-1], np.roll(i, -1, 0)[:, :-1], np.roll(i, -1, 0)[:, 1:], i[:, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    thing = Cloth.from_mesh(
        points, triangles, stretch_compliance=1e3, bending="dihedral", bend_compliance=1.0, mass=0.1
    )
    sim = Simulation(Scene({"it": thing}, gravity=(0, 0, 0)), Settings(frame_dt=1e-4), "cpu")
    sim.set_positions("it", points * [1.0 + share, 1.0 / (1.0 + share), 1.0])
    sim.step(1)
    return sim.report()["it"]["elastic_energy"]


def test_a_curved_sheet_has_least_elastic_energy_at_rest():
    out, rest, into = tube(0.1), tube(0.0), tube(-0.1)
    assert out - rest == pytest.approx(into - rest, rel=0.4) and min(out, into) > rest
    assert (tube(0.2) - rest) / (out - rest) == pytest.approx(4.0, rel=0.4)


def test_a_body_that_is_computed_again_leaves_others_and_itself_the_same_bits():
    def run(*names):
        sim = Simulation(Scene({name: of("springs") for name in names}), Settings(substeps=5), "cpu")
        if "it" in names:
            start(sim, "ten times")
        sim.step(10)
        return sim

    both, again, alone = run("it", "calm"), run("it", "calm"), run("calm")
    assert both.report()["it"]["redone"] > both.report()["calm"]["redone"] == alone.report()["calm"]["redone"]
    assert np.array_equal(both.positions("it"), again.positions("it"))
    assert np.array_equal(both.positions("calm"), alone.positions("calm"))
