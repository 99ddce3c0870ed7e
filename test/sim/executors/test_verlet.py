# SPDX-License-Identifier: Apache-2.0
"""Method verlet: explicit, of second order, refused where it would be unstable."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Cloth, Plane, Rope, Scene, Settings, Simulation, Sphere, Wind
from cloth_sim_ros.sim.executors.trial import Trial
from cloth_sim_ros.sim.substeps.limits import explicit_substeps
from cloth_sim_ros.sim.topology import build
from cloth_sim_ros.study.implicit import equilibrium
from cloth_sim_ros.study.springs import SpringSystem

SHEET = Cloth(resolution=(9, 9), pins="edges", stretch_compliance=1e-3, shear_compliance=1e-3)


@pytest.fixture
def unlimited(monkeypatch):
    """Call it to let explicit steps take any number of substeps, and to leave what they do as it is."""

    def lift():
        monkeypatch.setattr("cloth_sim_ros.sim.substeps.limits.explicit_substeps", lambda *_, **__: 1)
        monkeypatch.setattr(Trial, "advance", lambda trial: trial.explicit())

    return lift


def final(device, substeps, thing=SHEET, frames=30, **scene):
    sim = Simulation(Scene({"it": thing}, **scene), Settings(method="verlet", substeps=substeps), device=device)
    sim.step(frames)
    return sim.positions("it").astype(np.float64)


def test_the_error_falls_with_the_square_of_the_step(device):
    exact = final(device, 640)
    errors = [np.abs(final(device, n) - exact).max() for n in (20, 40, 80)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders == pytest.approx([2.0, 2.0], abs=0.2)


def test_it_agrees_with_the_implicit_method_in_the_limit(device):
    sim = Simulation(Scene({"it": SHEET}), Settings(method="xpbd", order=2, substeps=160, iterations=6), device=device)
    sim.step(30)
    assert np.abs(sim.positions("it") - final(device, 320)).max() < 3e-5


@pytest.mark.long
def test_executors_agree_with_wind_and_colliders(device):
    scene = Scene(
        {"it": Cloth(resolution=(9, 9), pins="top", damping=1e-4)},
        {"ball": Sphere(radius=0.2, position=(0, 0, -0.3)), "floor": Plane(position=(0, 0, -0.6))},
        Wind((1, 0, 0)),
    )
    found = []
    for executor in ("block", "graph"):
        sim = Simulation(scene, Settings(method="verlet", substeps=60), device=device, executor=executor)
        sim.step(15)  # the sheet has met the ball; what compilers round differently has not yet grown
        found.append(sim.positions("it"))
    assert np.abs(found[0] - found[1]).max() < 1e-5


def test_a_mass_on_a_spring_needs_the_known_step():
    rope = Rope(start=(0, 0, 1), end=(0, 0, 0), segments=1, stretch_compliance=1e-4, particle_masses=[1.0, 4.0])
    omega = np.sqrt(1e4 / 4.0)
    needed = explicit_substeps(build(rope, "rope", False), (1e-4, 0.0, 0.0), 0.0, 1 / 60, False)
    assert needed == np.ceil(omega / 60 / 2 / 0.5)


def test_a_whipping_rope_keeps_its_energy_at_its_limit_and_not_at_that_of_small_motions(unlimited):
    """Six seconds of a rope of 1.96 N that hangs longer by a quarter: springs turn while they stretch."""
    rope = Rope(start=(-0.5, 0, 0), end=(0.5, 0, 0), segments=24, mass=0.2, pins="start", stretch_compliance=0.24)
    needed = int(explicit_substeps(build(rope, "it", False), (0.24, 0.0, 0.0), 0.0, 0.1, False))

    def most_kinetic(substeps):
        sim = Simulation(Scene({"it": rope}), Settings(method="verlet", substeps=substeps, frame_dt=0.1), "cpu")
        found = []
        for _ in range(60):
            sim.step()
            found.append(sim.report()["it"]["kinetic_energy"])
        return max(found)

    assert 0.5 < most_kinetic(needed) < 1.5
    unlimited()
    assert most_kinetic(int(needed * 0.5 / 0.9) + 1) > 3.0


@pytest.mark.parametrize("damping", [1e-4, 1e-3, 1e-2])
def test_dashpots_count_in_the_limit(damping):
    """Just above the limit a stretched sheet comes to rest; far below it a dashpot would drive it."""
    sheet = Cloth(resolution=(6, 6), pins="edges", shear_compliance=1e-3, damping=damping)
    needed = explicit_substeps(build(sheet, "it", False), (1e-3, 1e-3, 0.0), damping, 1 / 60, False)
    sim = Simulation(Scene({"it": sheet}), Settings(method="verlet", substeps=int(needed)), device="cpu")
    x = sim.positions("it")
    sim.set_positions("it", x * 1.05)
    sim.step(40)
    assert np.isfinite(sim.positions("it")).all() and np.abs(sim.velocities("it")).max() < 1.0
    assert needed >= explicit_substeps(build(sheet, "it", False), (1e-3, 1e-3, 0.0), 0.0, 1 / 60, False)


def test_below_its_limit_it_flies_apart_which_is_why_it_is_refused(unlimited):
    needed = explicit_substeps(build(SHEET, "it", False), (1e-3, 1e-3, 0.0), 0.0, 1 / 60, False)
    with pytest.raises(ValueError, match=f"at least {needed:g}"):
        final("cpu", int(needed) - 1)
    assert np.abs(final("cpu", int(needed), frames=120)).max() < 1.0
    unlimited()
    sim = Simulation(Scene({"it": SHEET}), Settings(method="verlet", substeps=int(0.5 * needed)), "cpu")
    sim.step(120)
    assert sim.report()["it"]["recoveries"] > 0


@pytest.mark.long
def test_in_wind_it_needs_the_step_of_any_shape(unlimited):
    """Gusts of 100 m/s: what small motions at rest allow heats the crumpled sheet, at its own limit it stays cool."""
    sheet = Cloth(resolution=(10, 10), pins="corners", shear_compliance=1e-3)
    (still, crumpled), (_, in_air) = (
        [explicit_substeps(build(sheet, "it", False, air), (1e-3, 1e-3, 0.0), 0.0, 1.0, how) for how in (False, True)]
        for air in (False, True)
    )
    assert crumpled / still == pytest.approx(np.sqrt(12.0 / 8.0), rel=0.06)  # of a grid with diagonals
    still, crumpled = int(0.7 * still / 60), int(np.ceil(in_air / 60))  # of it what is linearly stable at rest

    def fastest(substeps):
        settings = Settings(method="verlet", substeps=substeps)
        sim, speeds = Simulation(Scene({"it": sheet}, wind=Wind((0, 0, 0))), settings, "cpu"), []
        for frame in range(60):
            sim.set_wind((60.0 * (-1.0) ** frame, 0.0, 80.0 * (-1.0) ** frame))
            sim.step()
            speeds.append(np.linalg.norm(sim.velocities("it"), axis=1).max())
        return max(speeds)

    assert fastest(crumpled) < 250.0
    with pytest.raises(ValueError, match=f"at least {crumpled} "):
        fastest(crumpled - 1)
    unlimited()
    assert fastest(still) > 1000.0


@pytest.mark.parametrize(
    ("thing", "words"),
    [
        (Cloth(resolution=(4, 4), stretch_compliance=0.0), "too stiff for explicit steps"),
        (Cloth(resolution=(4, 4), bending="dihedral", bend_compliance=0.0), "too stiff for explicit steps"),
        (Rope(segments=4, bend_compliance=1.0), "bending by angles"),
    ],
)
def test_what_it_lacks_is_refused(thing, words):
    with pytest.raises(ValueError, match=words):
        final("cpu", 10000, thing)


def test_live_changes_beyond_the_limit_are_refused_and_change_nothing():
    sim = Simulation(Scene({"it": SHEET}), Settings(method="verlet", substeps=40), device="cpu")
    for name, value in (("it.stretch_compliance", 1e-6), ("solver.substeps", 4), ("it.damping", 0.1)):
        with pytest.raises(ValueError, match="allowed is at least"):
            sim.set(name, value)
    sim.step(30)
    assert np.array_equal(sim.positions("it").astype(np.float64), final("cpu", 40))


def test_springs_too_stiff_for_float32_are_refused_and_why(unlimited):
    """Rounding alone heats a hanging rope of 1e9 N/m a spring; a tenth of it is allowed and rests."""

    def heat(compliance):
        rope = Rope(start=(0, 0, 0), end=(0, 0, -1), segments=24, stretch_compliance=24 * compliance)
        sim = Simulation(Scene({"it": rope}), Settings(method="verlet", substeps=9000), "cpu")
        sim.step(20)
        return sim.report()["it"]["kinetic_energy"]

    assert heat(1e-8) < 2e-4
    with pytest.raises(ValueError, match="too stiff for explicit steps"):
        heat(1e-9)
    unlimited()
    assert heat(1e-9) > 1e-3


@pytest.mark.parametrize("kind", ["rope", "strip"])
def test_what_float32_loses_of_rest_lengths_does_not_slacken_what_is_taut(kind, device):
    """Strained by 3e-5 only: springs of 1 m / 15, which float32 makes 5e-8 longer, would sag 5e-4 further."""
    thing = Rope(start=(-0.5, 0, 0), end=(0.5, 0, 0), segments=15, mass=0.2, pins="both", stretch_compliance=5e-7)
    if kind == "strip":  # two such ropes beside one another
        strip = {"resolution": (16, 2), "size": (1.0, 0.1), "pins": (0, 15, 16, 31)}
        thing = Cloth(mass=0.4, stretch_compliance=0.5 / 3e7, shear_compliance=None, **strip)
    settings = Settings(method="verlet", substeps=1600, global_damping=20.0)
    sim = Simulation(Scene({"it": thing}), settings, device=device)
    pins = (0, 15, 16, 31)[: 2 if kind == "rope" else 4]
    system = SpringSystem.from_springs(sim.masses("it"), pins, sim.springs("it"))
    start = sim.rest_positions("it").astype(np.float64)
    wanted = equilibrium(system, start - 3e-3 * np.outer(1.0 - 4.0 * start[:, 0] ** 2, (0, 0, 1)))
    sim.step(70)
    sags = []
    for _ in range(20):
        sim.step()
        sags.append(-sim.positions("it")[:, 2].min())
    assert np.mean(sags) == pytest.approx(-wanted[:, 2].min(), rel=2e-4)


STIFF = {"bending": "dihedral", "bend_compliance": 1e4, "damping": 1e-4}
CURTAIN = Cloth(resolution=(12, 12), pins="top", orientation=(0.7071068, 0, 0, 0.7071068), **STIFF)
HAMMOCK = Cloth(resolution=(12, 12), pins="corners", **STIFF)


@pytest.mark.parametrize(
    "scene",
    [Scene({"it": CURTAIN}, wind=Wind((0.5, 3, 0))), pytest.param(Scene({"it": HAMMOCK}), marks=pytest.mark.long)],
)
def test_air_and_bending_are_right_too(scene):
    """Over a sixth of a second, beside twenty times the substeps. Air is of first order."""

    def moved(substeps):
        sim = Simulation(scene, Settings(method="verlet", substeps=substeps), "cpu")
        start = sim.positions("it").astype(np.float64)
        sim.step(10)
        return sim.positions("it") - start

    exact, found = moved(1600), moved(80)
    assert np.abs(exact).max() > 0.1
    assert np.linalg.norm(found - exact) < 5e-4 * np.linalg.norm(exact)
