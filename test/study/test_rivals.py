# SPDX-License-Identifier: Apache-2.0
"""The classic methods do what their papers say: on a small hanging net, against converged implicit Euler."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Cloth, Scene, Simulation
from cloth_sim_ros.study import rivals
from cloth_sim_ros.study.colouring import colour
from cloth_sim_ros.study.implicit import implicit_step
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


def test_jacobi_converges_to_implicit_euler(net):
    system, x, v = net
    exact = implicit_step(system, x, v, STEP)[0]
    few, many = (np.abs(rivals.jacobi_xpbd(system, n)(system, x, v, STEP)[0] - exact).max() for n in (1, 300))
    assert many < 1e-7 < 1e-5 < few


def test_conjugate_gradients_take_the_linearised_step(net):
    """What is left against converged implicit Euler is the linearisation: of third order in the step."""
    system, x, v = net

    def left(h):
        new = rivals.implicit_conjugate_gradients(system, 200)(system, x, v, h)[0]
        return np.abs(new - implicit_step(system, x, v, h)[0]).max()

    assert left(STEP) < 2e-5
    assert left(STEP / 4.0) < left(STEP) / 16.0
    one, two = (rivals.implicit_conjugate_gradients(system, n)(system, x, v, 10 * STEP)[0] for n in (1, 200))
    assert np.abs(one - two).max() > 1e-5


def test_position_based_stiffness_depends_on_iterations(net):
    system, x, v = net
    steps = (rivals.position_based(system, n) for n in (1, 8, 50, 200))
    strains = [np.abs(system.strains(step(system, x, v, 10 * STEP)[0])).max() for step in steps]
    assert (np.diff(strains) < 0.0).all() and strains[-1] < 0.5 * strains[0]


def test_pins_stay(net):
    system, x, v = net
    for make in (rivals.position_based, rivals.jacobi_xpbd, rivals.implicit_conjugate_gradients):
        new = make(system, 3)(system, x, v, STEP)[0]
        assert (new[system.fixed] == x[system.fixed]).all() and (new[~system.fixed] != x[~system.fixed]).any()


def test_damping_is_refused(net):
    system = net[0]
    damped = SpringSystem(system.masses, system.fixed, system.pairs, system.rest_length, system.constant, damping=0.1)
    for make in (rivals.position_based, rivals.jacobi_xpbd, rivals.implicit_conjugate_gradients):
        with pytest.raises(ValueError, match="damped"):
            make(damped, 1)


def test_random_elements_are_coloured_independently_and_always_alike():
    rng = np.random.default_rng(0)
    particles = np.stack([rng.choice(60, 4, replace=False) for _ in range(200)])
    colours = colour(particles, 60)
    assert colours.min() == 0 and np.array_equal(colours, colour(particles, 60))
    for c in range(colours.max() + 1):
        assert len(np.unique(particles[colours == c])) == particles[colours == c].size
