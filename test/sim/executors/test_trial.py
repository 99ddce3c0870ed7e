# SPDX-License-Identifier: Apache-2.0
"""A frame of explicit steps is a trial: what comes out strained beyond all rest is done again by XPBD, and it alone."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Cloth, Rope, Scene, Settings, Simulation, Sphere

SPEED, RADIUS, FRAMES = 20.0, 0.15, 60
SHEET = Cloth(resolution=(20, 20), pins="edges", shear_compliance=1e-3)
CALM = Cloth(resolution=(20, 20), pins="edges", shear_compliance=1e-3, position=(5, 0, 0))


def shoot(device, things, ball=True, frames=FRAMES, **settings):
    """A ball of 20 m/s through a sheet held at its edges: the simulation, and (kinetic, of the springs) [J] a frame."""
    scene = Scene(things, {"ball": Sphere(radius=RADIUS, position=(0, 0, -1.0))})
    sim = Simulation(scene, Settings(**{"method": "verlet", **settings}), device)
    energies = []
    for frame in range(frames):
        if ball:
            sim.set_collider_pose("ball", (0, 0, min(-1.0 + frame * SPEED / 60, 1.0)))
        sim.step()
        energies.append((sim.report()["sheet"]["kinetic_energy"], spring_energy(sim)))
    return sim, np.array(energies)


def spring_energy(sim):
    x = sim.positions("sheet").astype(np.float64)
    found = 0.0
    for pairs, rest, constant in sim.springs("sheet").values():
        found += 0.5 * float(constant @ (np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1) - rest) ** 2)
    return found


def most_of_a_ball(sim):
    """More energy [J] than a ball can put in. All springs are strained as a thread from an edge to the ball where it
    stops, 1 m above, and all particles are twice as fast as it."""
    reach = np.hypot(0.5, 1.0) / 0.5 - 1.0
    stretched = sum(0.5 * float(constant @ (reach * rest) ** 2) for _, rest, constant in sim.springs("sheet").values())
    return stretched + 0.5 * float(sim.masses("sheet").sum()) * (2.0 * SPEED) ** 2


@pytest.mark.long
def test_a_fast_ball_puts_in_no_more_than_a_ball_can(device):
    """Explicit steps alone bring the sheet to 1e6 J."""
    sim, energies = shoot(device, {"sheet": SHEET})
    report = sim.report()["sheet"]
    assert sim.choices["sheet"].method == "verlet" and report["redone"] > 0 and report["recoveries"] == 0
    assert np.isfinite(energies).all()
    assert energies.sum(axis=1).max() < most_of_a_ball(sim)


@pytest.mark.long
def test_after_the_ball_is_through_no_energy_comes_from_nowhere(device):
    sim, energies = shoot(device, {"sheet": SHEET}, frames=120)
    gone = energies[60:].sum(axis=1)
    weight = 9.81 * sim.masses("sheet").sum()
    assert (np.maximum.accumulate(gone) <= gone[0] + 0.02 * gone[0] + weight).all()


def test_the_same_blow_gives_the_same_bits(device):
    first, second = (shoot(device, {"sheet": SHEET})[0] for _ in "ab")
    assert first.report()["sheet"]["redone"] == second.report()["sheet"]["redone"] > 0
    assert np.array_equal(first.positions("sheet"), second.positions("sheet"))
    assert np.array_equal(first.velocities("sheet"), second.velocities("sheet"))


def test_a_reset_forgets_the_trials(device):
    sim, _ = shoot(device, {"sheet": SHEET})
    x = sim.positions("sheet")
    sim.reset()
    assert sim.report()["sheet"]["redone"] == 0
    for frame in range(FRAMES):
        sim.set_collider_pose("ball", (0, 0, min(-1.0 + frame * SPEED / 60, 1.0)))
        sim.step()
    assert np.array_equal(sim.positions("sheet"), x)


def test_a_calm_neighbour_does_not_change_by_a_bit(device):
    """Same features, same batch, same launches: only who is hit does a frame again."""
    both = {"sheet": SHEET, "calm": CALM}
    hit, spared = shoot(device, both)[0], shoot(device, both, ball=False)[0]
    assert hit.report()["sheet"]["redone"] > 0 and spared.report()["sheet"]["redone"] == 0
    assert hit.report()["calm"]["redone"] == 0
    assert np.array_equal(hit.positions("calm"), spared.positions("calm"))
    assert np.array_equal(hit.velocities("calm"), spared.velocities("calm"))


def test_a_frame_that_is_good_is_what_explicit_steps_alone_give(device):
    """Up to the frame that is done again nothing differs from a simulation whose ball never comes."""
    sim, _ = shoot(device, {"sheet": SHEET}, frames=20, ball=False)
    alone = Simulation(Scene({"sheet": SHEET}), Settings(method="verlet"), device)
    alone.step(20)
    assert np.abs(sim.positions("sheet") - alone.positions("sheet")).max() < 1e-6
    assert sim.report()["sheet"]["redone"] == 0


def test_a_torn_rope_of_explicit_steps_recovers(device):
    rope = Rope(segments=16, stretch_compliance=0.02, pins="start")
    far = {"ball": Sphere(radius=0.02, position=(0, 0, -9.0))}  # with it the kernels are those of the tests above
    sim = Simulation(Scene({"sheet": rope}, far), Settings(method="verlet"), device)
    x = sim.rest_positions("sheet").astype(np.float64)
    random = np.random.default_rng(2)
    sim.set_positions("sheet", x[0] + 3.0 * (x - x[0]) + 0.1 * random.standard_normal(x.shape) * (x != x[0]))
    stored = spring_energy(sim) + 9.81 * 0.2 * 4.0
    for _ in range(120):
        sim.step()
        assert sim.report()["sheet"]["kinetic_energy"] + spring_energy(sim) < stored
    assert sim.report()["sheet"]["recoveries"] == 0
