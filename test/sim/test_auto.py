"""Method auto: the right method for each object, said why; live changes carry the state over; nothing flies apart."""

import logging

import numpy as np
import pytest

from cloth_sim_ros.sim import Cloth, Readback, Rope, Scene, Settings, Simulation, Sphere
from cloth_sim_ros.sim.limits import explicit_substeps
from cloth_sim_ros.sim.topology import build

SOFT = Cloth(resolution=(9, 9), pins="edges", stretch_compliance=1e-3, shear_compliance=1e-3)
NEEDED = int(explicit_substeps(build(SOFT, "it", False), (1e-3, 1e-3, 0.0), 0.0, 1 / 60, False))


def auto(things, substeps=NEEDED, iterations=1, **more):
    things = things if isinstance(things, dict) else {"it": things}
    return Simulation(Scene(things, **more), Settings(method="auto", substeps=substeps, iterations=iterations), "cpu")


def test_each_object_gets_its_own_method_and_a_reason():
    sim = auto(
        {
            "soft": SOFT,
            "stiff": Cloth(resolution=(9, 9), stretch_compliance=1e-6, position=(0, 2, 0)),
            "rigid": Cloth(resolution=(4, 4), stretch_compliance=0.0, position=(0, 4, 0)),
            "folded": Cloth(resolution=(4, 4), bending="dihedral", bend_compliance=10.0, position=(0, 6, 0)),
            "rope": Rope(segments=5, stretch_compliance=1e-4, start=(2, 0, 0), end=(3, 0, 0)),
        }
    )
    words = {name: choice.words for name, choice in sim.choices.items()}
    assert words == {name: "xpbd order 2" for name in words} | {"soft": "verlet"}
    assert f"{NEEDED} substeps are at least the {NEEDED}" in sim.choices["soft"].reason
    assert f"would need inf substeps and there are {NEEDED}" in sim.choices["rigid"].reason
    assert "bends by angles" in sim.choices["folded"].reason
    assert sim.method.startswith("auto: ") and "verlet" in sim.method and "xpbd order 2" in sim.method
    assert len(sim.springs("rope")["structural"][1]) == 5


@pytest.mark.parametrize(("substeps", "alone"), [(NEEDED, {"method": "verlet"}), (NEEDED - 1, {"order": 2})])
def test_it_computes_what_the_chosen_method_computes(substeps, alone):
    chosen = auto(SOFT, substeps)
    single = Simulation(Scene({"it": SOFT}), Settings(substeps=substeps, **alone), "cpu")
    chosen.step(20), single.step(20)
    assert np.array_equal(chosen.positions("it"), single.positions("it"))


@pytest.mark.parametrize(
    ("name", "value"), [("it.stretch_compliance", 1e-5), ("it.damping", 0.1), ("solver.substeps", NEEDED - 1)]
)
def test_a_live_change_beyond_the_limit_goes_on_implicitly_and_says_so(name, value, caplog):
    sim = auto(SOFT)
    sim.set("it.static_friction", 0.25)
    sim.step(20)
    x, v = sim.positions("it"), sim.velocities("it")
    with caplog.at_level(logging.INFO):
        sim.set(name, value)
    assert [record.message for record in caplog.records] == [f"it now {sim.choices['it'].reason}"]
    assert sim.choices["it"].words == "xpbd order 2"
    assert np.array_equal(sim.positions("it"), x) and np.array_equal(sim.velocities("it"), v)
    batch = sim._bodies.batch["it"]
    assert batch.materials.read(0, 0)["static_friction"] == 0.25
    sim.step(60)
    assert 1e-3 < np.abs(sim.positions("it") - x).max() < 1.0
    back = {"it.stretch_compliance": 1e-3, "it.damping": 0.0, "solver.substeps": NEEDED}[name]
    sim.set(name, back)
    assert sim.choices["it"].words == "verlet"


def test_one_method_serves_an_object_in_all_worlds():
    sim = Simulation(Scene({"it": SOFT}), Settings(method="auto", substeps=NEEDED), "cpu", worlds=3)
    sim.set("gravity", (0, 0, -5), world=1)
    sim.step(10)
    x = [sim.positions("it", world) for world in range(3)]
    assert np.array_equal(x[0], x[2]) and not np.array_equal(x[0], x[1])
    sim.set("it.stretch_compliance", 1e-6, world=2)
    assert sim.choices["it"].words == "xpbd order 2" and "3 worlds" in sim.method
    assert all(np.array_equal(x[world], sim.positions("it", world)) for world in range(3))
    sim.step(10)
    assert not np.array_equal(sim.positions("it", 0), sim.positions("it", 2))


def test_a_rebuilt_object_is_still_read_back():
    sim = auto({"it": SOFT, "other": Cloth(resolution=(5, 5), stretch_compliance=1e-6, position=(0, 3, 0))})
    readback = Readback(sim, "it", mesh=True)
    sim.step(5)
    sim.set("it.stretch_compliance", 1e-6)
    sim.step(5)
    readback.request()
    assert np.array_equal(readback.particles(), sim.positions("it"))
    assert np.allclose(readback.mesh(), sim.positions("it")[sim.triangles("it").ravel()])


def test_an_object_strained_beyond_all_rest_is_left_to_the_implicit_method_until_the_reset():
    sim = auto(SOFT)
    x = sim.rest_positions("it")
    sim.set_positions("it", 1.1 * x)
    assert sim.choices["it"].words == "verlet"
    free = np.random.default_rng(5).uniform(-0.5, 0.5, x.shape)
    sim.set_positions("it", free)
    assert sim.choices["it"].words == "xpbd order 2" and "strained" in sim.choices["it"].reason
    sim.step(120)
    assert sim.report()["it"]["kinetic_energy"] < 1e3  # springs held 20 kJ at the start
    sim.reset()
    assert sim.choices["it"].words == "verlet"
    assert np.array_equal(sim.positions("it"), x)


def test_an_object_that_had_to_be_put_back_is_left_to_the_implicit_method():
    sim = auto(SOFT)
    sim.step()
    arrays, span, _ = sim.device_arrays("it")
    rows = arrays.state.velocities[span].numpy()
    rows[40, 2] = np.nan
    arrays.state.velocities[span].assign(rows)
    sim.step()
    assert sim.report()["it"]["recoveries"] == 1
    assert sim.choices["it"].words == "xpbd order 2" and sim.report()["it"]["recoveries"] == 1


def test_a_blow_that_explicit_steps_would_heat_up_is_left_to_the_implicit_method():
    sheet = Cloth(resolution=(20, 20), pins="edges", shear_compliance=1e-3)
    sim = auto(sheet, 49, colliders={"ball": Sphere(radius=0.15, position=(0, 0, -1.0))})
    energies = []
    for frame in range(120):
        sim.set_collider_pose("ball", (0, 0, min(-1.0 + frame * 20 / 60, 1.0)))
        sim.step()
        energies.append(sim.report()["it"]["kinetic_energy"])
    assert sim.choices["it"].words == "xpbd order 2" and "strained" in sim.choices["it"].reason
    assert max(energies) < 1e3 and energies[-1] < 30.0  # verlet alone: above 1e6 J
    assert np.isfinite(energies).all()


@pytest.mark.parametrize("iterations", [1, 10])
@pytest.mark.parametrize("substeps", [1, 5, 20, 80])
def test_no_stiffness_and_mass_ratio_flies_apart(substeps, iterations):
    """Sheets that fall from level and hang by two corners, ropes with a heavy end: bounded by their size.

    A single sweep a frame is far from the solution under 1e5 times the mass, and the rope much too long, but no more.
    """
    slack = 1.5 if substeps * iterations > 1 else 15.0
    things, reach = {}, {}
    for k, compliance in enumerate([0.0, *np.logspace(-7, -1, 7)]):
        for r, ratio in enumerate([1.0, 1e2, 1e5]):
            masses = np.full(9, 0.01)
            masses[-1] *= ratio
            rope = Rope(segments=8, stretch_compliance=compliance, particle_masses=masses, position=(4 * k, 4 * r, 0))
            things[f"rope{k}_{r}"] = rope
            reach[f"rope{k}_{r}"] = 1.0 + 2.5 * masses.sum() * 9.81 * compliance
        things[f"sheet{k}"] = Cloth(
            resolution=(7, 7), pins="corners", stretch_compliance=compliance, shear_compliance=compliance,
            position=(4 * k, -4, 0),
        )  # fmt: skip
        reach[f"sheet{k}"] = 1.6 + 2.5 * 0.2 * 9.81 * compliance * 7
    sim = auto(things, substeps, iterations)
    sim.step(90)
    report = sim.report()
    for name in things:
        x = sim.positions(name) - sim.rest_positions(name)[0]
        assert report[name]["recoveries"] == 0, (name, sim.choices[name].reason)
        assert np.linalg.norm(x, axis=1).max() < slack * reach[name], (name, sim.choices[name].reason)


def test_positions_that_are_refused_do_not_change_the_method():
    sim = Simulation(Scene({"cloth": Cloth(resolution=(8, 8))}), Settings(method="auto", substeps=200), "cpu")
    chosen = sim.choices["cloth"]
    assert chosen.method == "verlet"
    with pytest.raises(ValueError, match="world"):
        sim.set_positions("cloth", 10.0 * sim.rest_positions("cloth"), world=7)
    assert sim.choices["cloth"] == chosen
