# SPDX-License-Identifier: Apache-2.0
"""Masses that are set while a simulation runs, and differ between worlds."""

import dataclasses

import numpy as np
import pytest
from fixed_settings import fixed

from cloth_sim_ros.sim import Cloth, Handle, Plane, Rope, Scene, Simulation, Sphere, Variation, Winch, Wind

G = 9.81
MASSES = {"sheet": [0.1, 0.25, 0.7], "rope": [0.2, 0.05, 1.0], "winched": [0.4, 0.2, 0.1]}
LOADS = {"rope": [0.5, 0.0, 0.2], "winched": [0.3, 1.0, 0.05]}
WORLDS = 3


def scene(world=None, explicit=False, bend=1.0, damping=1e-4):
    """Everything that weighs something: a sheet that bends, in wind and a hand, and ropes, one of them on a winch."""
    own = {name: {} for name in MASSES}
    for field, values in (("mass", MASSES), ("end_mass", LOADS)):
        for name in values if world is not None else ():
            own[name][field] = values[name][world]
    plate = {"bending": "dihedral", "bend_compliance": bend, "damping": damping}
    objects = {
        "sheet": Cloth(resolution=(6, 6), pins=(0, 1), **plate, **own["sheet"]),
        "rope": Rope(segments=9, start=(0, 3, 0), end=(1, 3, 0), **own["rope"]),
    }
    if not explicit:
        bends = {"bend_compliance": 10.0, "stretch_compliance": 0.0}
        objects["winched"] = Rope(
            segments=9, start=(0, 6, 0), end=(1, 6, 0), winch=Winch(0.55, pay_out=0.3), **bends, **own["winched"]
        )
    hand = Handle(position=(0.5, 0.5, 0), reach=0.1, attached=True, object="sheet")
    return Scene(objects, {"ball": Sphere(0.2, position=(0, 0, -0.25))}, Wind((1, 2, 0)), handles={"hand": hand})


def weigh(sim, worlds, own=None):
    """All masses of some worlds, in those of a mask."""
    for name in sim.scene.objects:
        sim.set(f"{name}.mass", worlds(MASSES[name]), own)
        if name in LOADS:
            sim.set(f"{name}.end_mass", worlds(LOADS[name]), own)


def states(sim, world=0):
    return [read(name, world) for name in sim.scene.objects for read in (sim.positions, sim.velocities)]


def equal(a, b):
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


@pytest.mark.long
@pytest.mark.parametrize(
    ("settings", "plate"),
    [
        ({"order": 2, "substeps": 20}, (1e-2, 1e-4)),  # so stiff that a part of its rigidity acts alone
        ({"order": 1, "iterations": 2}, (0.1, 1e-2)),  # so damped that dashpots give way
        ({"method": "verlet", "substeps": 200}, (1.0, 1e-4)),
    ],
)
def test_a_mass_that_is_set_is_that_of_a_scene_built_with_it(device, settings, plate):
    """To the bit, which says that nothing on the way from a mass to a motion was left out; but the limits of a sheet's
    bending are rounded elsewhere."""
    explicit = settings.get("method") == "verlet"
    built = Simulation(scene(2, explicit, *plate), fixed(**settings), device)
    told = Simulation(scene(None, explicit, *plate), fixed(**settings), device)
    weigh(told, lambda values: values[2])
    for name in told.scene.objects:
        assert (
            np.allclose(told.masses(name), built.masses(name), rtol=1e-14)
            and told.get(f"{name}.mass") == MASSES[name][2]
        )
    for sim in (built, told):
        sim.step(15)
    sheets = zip(states(told)[:2], states(built)[:2], strict=True)
    assert all(np.abs(a - b).max() <= (0.0 if explicit else 1e-4) for a, b in sheets)
    assert equal(states(told)[2:], states(built)[2:])
    for name, found in built.report().items():
        assert told.report()[name]["kinetic_energy"] == pytest.approx(found["kinetic_energy"], rel=1e-4)
    assert told.choices.keys() == built.choices.keys()
    for name, choice in built.choices.items():
        assert told.choices[name].bending_share == pytest.approx(choice.bending_share, rel=1e-5)
    if not explicit:
        assert np.array_equal(told.end_wrenches("winched"), built.end_wrenches("winched"))


@pytest.mark.long
def test_each_world_is_what_it_would_be_alone_and_others_keep_theirs(device, tmp_path):
    settings = fixed(order=2)
    many = Simulation(scene(), settings, device, WORLDS)
    alone = [Simulation(scene(), settings, device) for _ in range(WORLDS)]
    weigh(many, np.array)
    for w, sim in enumerate(alone):
        weigh(sim, lambda values, w=w: values[w])
    for sim in (many, *alone):
        sim.step(6)
    before = states(many, 0), states(many, 2)
    mask = np.array([False, True, False])
    weigh(many, lambda values: np.array(values[::-1]), mask)
    assert equal(states(many, 0), before[0]) and equal(states(many, 2), before[1])
    weigh(alone[1], lambda values: values[1])
    weigh(many, np.array)
    many.save(tmp_path / "state.npz")
    for sim in (many, *alone):
        sim.step(6)
    after = [states(many, w) for w in range(WORLDS)]
    assert all(equal(after[w], states(alone[w])) for w in range(WORLDS))
    assert not equal(after[0], after[1])
    other = Simulation(scene(), settings, device, WORLDS)
    other.load(tmp_path / "state.npz")
    other.step(6)
    assert all(equal(after[w], states(other, w)) for w in range(WORLDS)), "masses are part of what is saved"
    many.reset(mask)
    alone[1].reset()
    other.reset()
    for sim in (many, alone[1], other):
        sim.step(6)
    assert equal(states(many, 1), states(alone[1])) and equal(states(other, 1), states(alone[1])), "and outlive a reset"


@pytest.mark.parametrize("settings", [{"order": 2, "substeps": 50}, {"method": "verlet", "substeps": 50}])
def test_a_mass_on_a_spring_swings_at_the_frequency_of_its_mass(device, settings):
    """A load m on one segment: omega^2 = k / (m + half of the rope's)."""
    loads, ropes = np.array([0.1, 0.45, 0.1, 0.7]), np.array([0.2, 0.1, 0.6, 0.2])
    line = Rope(start=(0, 0, 1), end=(0, 0, 0), segments=1, mass=0.3, end_mass=0.2, stretch_compliance=1e-2)
    sim = Simulation(Scene({"it": line}, gravity=(0, 0, 0)), fixed(**settings), device, worlds=4)
    sim.set("it.end_mass", loads)
    sim.set("it.mass", ropes)
    start = sim.rest_positions("it")
    start[1, 2] -= 0.05
    sim.set_positions("it", start)
    times, heights = [], []
    for _ in range(180):
        sim.step()
        times.append(sim.time)
        heights.append(sim.positions("it", None)[:, 1, 2])
    expected = np.sqrt(100.0 / (loads + 0.5 * ropes)) / (2.0 * np.pi)
    for w, z in enumerate(np.array(heights).T):
        down = np.flatnonzero((z[:-1] > 0.0) & (z[1:] <= 0.0))
        crossings = [times[k] + (times[k + 1] - times[k]) * z[k] / (z[k] - z[k + 1]) for k in down]
        assert (len(crossings) - 1) / (crossings[-1] - crossings[0]) == pytest.approx(expected[w], rel=4e-3)
    assert expected[0] == pytest.approx(2.0 * expected[3], rel=1e-12), "four times the mass, half the frequency"


@pytest.mark.long
def test_what_hangs_or_lies_is_felt_with_the_weight_that_it_has_in_its_world(device):
    sheets = {
        "held": Cloth(resolution=(5, 5), size=(0.2, 0.2), pins="none", damping=1e-2),
        "lies": Cloth(resolution=(5, 5), size=(0.2, 0.2), pins="none", position=(3, 0, 0.005), damping=1e-2),
        "line": Rope(segments=6, start=(0, 3, 1.6), end=(0, 3, 1), damping=1e-2, end_mass=0.1),
    }
    hand = Handle(reach=0.5, attached=True, object="held", position=(0, 0, 1))
    sheets["held"] = dataclasses.replace(sheets["held"], position=(0, 0, 1))
    floor = Plane(compliance=1e-4)
    sim = Simulation(Scene(sheets, {"floor": floor}, handles={"hand": hand}), fixed(order=1), device, WORLDS)
    masses, loads = np.array([0.05, 0.3, 1.2]), np.array([0.0, 0.2, 1.0])
    for name in sheets:
        sim.set(f"{name}.mass", masses)
    sim.set("line.end_mass", loads)
    sim.step(120)
    for w in range(WORLDS):
        assert sim.handle_wrench("hand", w)[0][2] == pytest.approx(-G * masses[w], rel=1e-3)
        assert sim.wrench("floor", w)[0][2] == pytest.approx(-G * masses[w], rel=1e-3)
        assert sim.end_wrenches("line", w)[0][2] == pytest.approx(-G * (masses[w] + loads[w]), rel=1e-3)
        assert sim.tensions("line", w)[-1] == pytest.approx(G * (masses[w] / 12 + loads[w]), rel=1e-3)
    sim.release("hand")
    before = sim.velocities("held", None)
    sim.step()
    fallen = (sim.velocities("held", None) - before)[..., 2]
    assert fallen == pytest.approx(np.full(fallen.shape, -G / 60), abs=2e-3), "what falls does so alike"


def test_the_choice_is_that_of_the_lightest_world(device):
    """As many substeps as a scene needs whose sheet is as light as the lightest, however few worlds have it."""
    sheet, rope = Cloth(resolution=(8, 8), mass=0.4, pins="top"), Rope(segments=8, mass=0.4, position=(0, 3, 0))
    for thing in (sheet, rope):
        # As many worlds: prices on a GPU depend on how many there are.
        light = Simulation(Scene({"it": dataclasses.replace(thing, mass=0.004)}), device=device, worlds=8).choices["it"]
        sim = Simulation(Scene({"it": thing}), device=device, worlds=8)
        whole = sim.choices["it"]
        sim.set("it.mass", 0.004, 5)
        for field in ("method", "substeps", "safe_substeps"):
            assert getattr(sim.choices["it"], field) == getattr(light, field)
        sim.set("it.mass", 0.4)
        assert sim.choices["it"] == whole
    sim.set("it.end_mass", 5.0, 3)
    assert sim.choices["it"].substeps == whole.substeps, "what is heavier needs no more"


def test_a_particle_that_is_let_go_has_the_mass_of_its_world(device):
    sim = Simulation(Scene({"it": Cloth(resolution=(3, 3), pins="top")}), fixed(), device, worlds=2)
    sim.set("it.mass", np.array([0.2, 0.8]))
    sim.step(3)
    assert sim.report(1)["it"]["kinetic_energy"] > 0
    sim.set("it.pins", "none")
    sim.set_velocities("it", np.full((9, 3), 1.0))
    energies = [sim.report(w)["it"]["kinetic_energy"] for w in range(2)]
    assert energies == pytest.approx([0.3, 1.2], rel=1e-6)
    sim.set("it.mass", 0.4)
    assert sim.report(0)["it"]["kinetic_energy"] == pytest.approx(0.6, rel=1e-6)
    arrays, span, _ = sim.device_arrays("it", 1)
    rows = arrays.state.positions[span].numpy()
    rows[7, 2] = np.nan
    arrays.state.positions[span].assign(rows)
    sim.step()
    assert sim.report(1)["it"]["recoveries"] == 1
    sim.set_velocities("it", np.full((9, 3), 1.0))
    assert sim.report(1)["it"]["kinetic_energy"] == pytest.approx(0.6, rel=1e-6), "also of what was put back"
    sim.set("it.mass", 0.2)
    assert np.array_equal(sim.masses("it"), Simulation(Scene({"it": Cloth(resolution=(3, 3))}), fixed()).masses("it"))


def test_masses_are_drawn_and_bad_ones_refused(device):
    line = Rope(segments=4, position=(0, 3, 0))
    described = Scene({"it": Cloth(resolution=(4, 4)), "line": line})
    sim = Simulation(described, fixed(method="verlet", substeps=40), device, worlds=4)
    drawn = Variation({"it.mass": {"log_uniform": [0.2, 0.4]}, "line.end_mass": {"uniform": [0.1, 1]}}, 2).apply(sim)
    for w in range(4):
        assert sim.masses("it", w).sum() == pytest.approx(drawn["it.mass"][w], rel=1e-12)
        assert sim.masses("line", w).sum() == pytest.approx(0.2 + drawn["line.end_mass"][w], rel=1e-12)
    known = [sim.get("it.mass", w) for w in range(4)]
    bad = {
        "it.mass": (-1.0, "it.mass is -1.0; allowed is a finite number from 1e-09 to 1e"),
        "line.end_mass": (-0.1, "line.end_mass is -0.1; allowed is a finite number from 0"),
        "it.end_mass": (0.1, "no parameter 'it.end_mass'; allowed is one of .*mass"),
    }
    for name, (value, words) in bad.items():
        with pytest.raises(ValueError, match=words):
            sim.set(name, value)
    with pytest.raises(ValueError, match="substeps is 40 with method 'verlet'; allowed is at least .* of it"):
        sim.set("it.mass", np.array([0.2, 0.2, 1e-3, 0.2]))
    with pytest.raises(ValueError, match=r"it.mass has shape \(4,\) with values from 0 to 0; allowed are"):
        Variation({"it.mass": {"normal": [0, 0]}}).apply(sim)
    assert [sim.get("it.mass", w) for w in range(4)] == known
