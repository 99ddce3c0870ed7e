# SPDX-License-Identifier: Apache-2.0
"""PBD does what its paper says, on a small hanging net."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Cloth, Scene, Simulation
from cloth_sim_ros.study.colouring import colour
from cloth_sim_ros.study.implicit import implicit_step
from cloth_sim_ros.study.relaxation import position_based
from cloth_sim_ros.study.springs import SpringSystem

STEP = 1.0 / 600.0


@pytest.fixture(scope="module")
def net():
    """5 x 5 particles hung by two corners, moving."""
    sim = Simulation(Scene(objects={"it": Cloth(resolution=(5, 5))}), device="cpu")
    system = SpringSystem.from_springs(sim.masses("it"), [20, 24], sim.springs("it"))
    x = sim.rest_positions("it").astype(np.float64)
    v = np.where(system.fixed[:, None], 0.0, np.random.default_rng(3).standard_normal(x.shape) * 0.3)
    for _ in range(20):
        x, v = implicit_step(system, x, v, STEP)
    return system, x, v


def test_position_based_stiffness_depends_on_iterations(net):
    system, x, v = net
    steps = (position_based(system, n) for n in (1, 8, 50, 200))
    strains = [np.abs(system.strains(step(system, x, v, 10 * STEP)[0])).max() for step in steps]
    assert (np.diff(strains) < 0.0).all() and strains[-1] < 0.5 * strains[0]


def test_pins_stay(net):
    system, x, v = net
    new = position_based(system, 3)(system, x, v, STEP)[0]
    assert (new[system.fixed] == x[system.fixed]).all() and (new[~system.fixed] != x[~system.fixed]).any()


def test_damping_is_refused(net):
    system = net[0]
    damped = SpringSystem(system.masses, system.fixed, system.pairs, system.rest_length, system.constant, damping=0.1)
    with pytest.raises(ValueError, match="damped"):
        position_based(damped, 1)


def test_random_elements_are_coloured_independently_and_always_alike():
    rng = np.random.default_rng(0)
    particles = np.stack([rng.choice(60, 4, replace=False) for _ in range(200)])
    colours = colour(particles, 60)
    assert colours.min() == 0 and np.array_equal(colours, colour(particles, 60))
    for c in range(colours.max() + 1):
        assert len(np.unique(particles[colours == c])) == particles[colours == c].size
