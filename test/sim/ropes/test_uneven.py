# SPDX-License-Identifier: Apache-2.0
"""Ropes whose segments differ a lot in length, as files of splines and finite elements have them."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Rope, Scene, Settings, Simulation

GRAVITY = 9.81


TWIST_COMPLIANCE = 20.0


def bent(ratio, seed, **twist):
    """A cable bent in its plane over 1 m, both ends clamped, with segments drawn between 1 and `ratio`."""
    random = np.random.default_rng(seed)
    lengths = ratio ** random.uniform(0.0, 1.0, random.integers(12, 40))
    along = np.r_[0.0, np.cumsum(lengths)] / lengths.sum()
    aside = 0.15 * random.uniform() * np.sin(np.pi * along)
    points = np.column_stack([along, aside, 0.0 * along])
    pins = [0, 1, len(points) - 2, len(points) - 1]
    return Rope.of("steel cable", points=points, pins=pins, damping=0.0, bend_damping=0.0, **twist)


def most_gained(sim):
    """Largest excess in a second of the kinetic energy over what the weight has done, over its work over 1 m."""
    mass, before, most = sim.masses("it"), sim.positions("it"), 0.0
    for _ in range(60):
        sim.step()
        speed, fallen = sim.velocities("it"), before[:, 2] - sim.positions("it")[:, 2]
        most = max(most, 0.5 * (mass @ (speed**2).sum(1)) - GRAVITY * (mass @ fallen))
    return most / (GRAVITY * mass.sum())


UNEVEN = [(100.0, 20, 3), (1000.0, 5, 12), (1000.0, 10, 11), (1000.0, 20, 2)]


@pytest.mark.parametrize(("ratio", "substeps", "seed"), UNEVEN)
@pytest.mark.parametrize("order", [1, 2])
def test_what_is_let_go_at_rest_gains_no_energy(device, ratio, substeps, seed, order):
    """It fails with eight Newton steps, without half steps, or with order 2 where only the mean segment is smooth."""
    settings = Settings(substeps=substeps, order=order, sleep=False)
    assert most_gained(Simulation(Scene({"it": bent(ratio, seed)}), settings, device)) < 1e-3


@pytest.mark.parametrize(("ratio", "substeps", "seed"), [(100.0, 10, 12), (1000.0, 20, 11)])
@pytest.mark.parametrize("order", [1, 2])
def test_one_that_is_twisted_gains_no_more_than_its_twist(device, ratio, substeps, seed, order):
    """The couples of the twist move light particles by many segments, so no Newton step may begin behind them."""
    cable = bent(ratio, seed, twist_compliance=TWIST_COMPLIANCE, end_turn=0.5)
    sim = Simulation(Scene({"it": cable}), Settings(substeps=substeps, order=order, sleep=False), device)
    stored = 0.5 * 0.5**2 / TWIST_COMPLIANCE / (GRAVITY * sim.masses("it").sum())
    assert most_gained(sim) < stored + 1e-3
