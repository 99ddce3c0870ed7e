"""What was thrown together opens; a soft cloth, however long it is pulled, is never eased."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Cloth, Scene, Settings, Simulation

HELD = (90, 99)


def sheet(device, **settings):
    """A rigid one, dashpots of a hundredth of a second."""
    cloth = Cloth(
        resolution=(10, 10), size=(0.9, 0.9), stretch_compliance=0.0, shear_compliance=0.0, damping=1e-2, pins=HELD
    )
    return Simulation(Scene({"it": cloth}), Settings(global_damping=2.0, **settings), device)


def thrown_together(sim, seed):
    x = sim.rest_positions("it").astype(np.float64)
    start = np.random.default_rng(seed).uniform(-0.5, 0.5, x.shape)
    start[list(HELD)] = x[list(HELD)]
    sim.set_positions("it", start)


def strain(sim):
    stretch = [sim.springs("it")[kind] for kind in ("structural", "shear")]
    pairs, rest, _ = (np.concatenate([kind[k] for kind in stretch]) for k in range(3))
    x = sim.positions("it")[pairs]
    return np.sqrt(((np.linalg.norm(x[:, 1] - x[:, 0], axis=1) / rest - 1.0) ** 2).mean())


def late_strain(sim):
    """The most in the second half of the second second."""
    sim.step(90)
    found = []
    for _ in range(30):
        sim.step()
        found.append(strain(sim))
    return max(found)


def frames_tangled(sim):
    found = int(sim.device_arrays("it")[0].state.tangled.numpy()[0])
    return found if found >= 0 else -1 - found


@pytest.mark.parametrize("order", [1, 2])
def test_what_was_thrown_together_opens(device, order):
    """Of these starts half stay strained by 2 to 6 % on a CPU unless they are eased."""
    found, longest = [], 0
    for seed in (0, 4, 8, 9):
        sim = sheet(device, substeps=20, order=order)
        thrown_together(sim, seed)
        for _ in range(120):
            sim.step()
            longest = max(longest, frames_tangled(sim))
        found.append(strain(sim))
    assert longest > 5
    assert np.median(found) < 0.012
    assert max(found) < 0.04


@pytest.mark.parametrize(("substeps", "iterations", "order"), [(1, 1, 1), (1, 10, 2), (5, 1, 1)])
def test_few_sweeps_a_frame_bring_it_back_as_well(device, substeps, iterations, order):
    """At 18, 4 to 6 and 2 to 4 % of strain they stay otherwise."""
    for seed in (0, 1, 3):
        sim = sheet(device, substeps=substeps, iterations=iterations, order=order)
        thrown_together(sim, seed)
        assert late_strain(sim) < 0.02


def test_what_was_a_tangle_does_not_become_one_again(device):
    """Dashpots of twelve substeps under one sweep: let go at a tenth, most of these are off by 2 to 3 % once more."""
    found = []
    for seed in (0, 2, 4, 7):
        sim = sheet(device, substeps=20)
        thrown_together(sim, seed)
        found.append(late_strain(sim))
    assert np.median(found) < 0.016


def test_what_few_sweeps_let_sag_is_left_to_them(device):
    """Nobody threw it together: it hangs as far as the sweeps that were asked for let it, and gains nothing."""
    sagging, fine = (sheet(device, substeps=substeps) for substeps in (1, 20))
    sagging.step(120)
    fine.step(120)
    assert frames_tangled(sagging) > 100
    assert strain(sagging) > 5.0 * strain(fine)


@pytest.mark.parametrize(("substeps", "iterations"), [(1, 1), (1, 10), (5, 4)])
def test_a_former_tangle_is_computed_and_told_of_as_by_default(device, substeps, iterations):
    """As it begins to fall: the same motion, residual and estimate as in substeps of that size."""
    found = []
    for settings in ((substeps, iterations), (20, 1)):
        sim = sheet(device, substeps=settings[0], iterations=settings[1])
        for name in ("stretch", "shear"):
            sim.set(f"it.{name}_compliance", 1e-4)
        assert sim.report()["it"]["substeps"] == settings[0]
        state = sim.device_arrays("it")[0].state
        state.tangled.fill_(-1)
        state.thrown.fill_(1)
        sim.step(4)
        assert sim.report()["it"]["substeps"] == 20
        found.append((sim.positions("it"), sim.report()["it"]["residual"], sim.step_and_estimate()["it"]))
    assert np.abs(found[0][0] - found[1][0]).max() < 1e-5
    assert found[0][1:] == pytest.approx(found[1][1:], rel=1e-2)


@pytest.mark.parametrize("schedule", ["coloured", "tiled"])
def test_a_tangle_is_the_same_in_every_schedule(device, schedule):
    """Until rounding is told apart by the chaos of it: the first eased frame is the sixth."""
    found = []
    for each in ("resident", schedule):
        sim = sheet(device, substeps=20, schedule=each)
        sim.set_positions("it", (sim.rest_positions("it") - sim.rest_positions("it")[99]) * [1.5, 1.0, 1.0])
        counts = []
        for _ in range(8):
            sim.step()
            counts.append(frames_tangled(sim))
        found.append((counts, sim.positions("it")))
    assert found[0][0] == found[1][0] == [1, 2, 3, 4, 5, 6, 7, 8]
    assert np.abs(found[0][1] - found[1][1]).max() < 1e-4


@pytest.mark.parametrize("substeps", [1, 20])
def test_soft_springs_are_left_as_they_are(device, substeps):
    """A load stretches them by more than a tenth for good, damped and in motion: to the bit as if nobody had looked."""
    mass = np.full(100, 2e-3)
    mass[:10] = 0.1
    cloth = Cloth(
        resolution=(10, 10),
        size=(0.9, 0.9),
        particle_masses=mass,
        orientation=(np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)),
        stretch_compliance=0.05,
        shear_compliance=0.1,
        damping=1e-2,
        pins="top",
    )
    looked, blind = (Simulation(Scene({"it": cloth}), Settings(substeps=substeps), device) for _ in range(2))
    for sim in (looked, blind):
        sim.set_positions("it", sim.rest_positions("it") * [1.0, 1.0, 1.6])
    for _ in range(30):
        looked.step()
        blind.step()
        blind.device_arrays("it")[0].state.tangled.zero_()
    assert frames_tangled(looked) > 10
    assert np.array_equal(looked.positions("it"), blind.positions("it"))


def test_new_positions_begin_anew(device):
    sim = sheet(device, substeps=20)
    thrown_together(sim, 0)
    sim.step(10)
    assert frames_tangled(sim) > 0
    sim.reset()
    assert frames_tangled(sim) == 0


def test_dashpots_do_not_hold_what_was_thrown_together(device):
    """Springs too soft for so short a substep to matter, with dashpots that are not: they held it strained by 2.8 %."""
    soft = {"stretch_compliance": 1e-4, "shear_compliance": 2e-4, "bend_compliance": 0.1, "damping": 1e-2}
    cloth = Cloth(resolution=(10, 10), size=(0.9, 0.9), mass=0.2, pins="corners", **soft)
    sim = Simulation(Scene({"it": cloth}), Settings(substeps=80, global_damping=2.0), device)
    start = sim.rest_positions("it") * [-1.0, 1.0, 1.0]
    start[list(HELD)] = sim.rest_positions("it")[list(HELD)]
    sim.set_positions("it", start)
    sim.step(120)
    assert strain(sim) < 0.02
