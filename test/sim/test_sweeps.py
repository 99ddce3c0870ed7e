"""Sweeps over colours that are far from the solution must not feed a cloth energy."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Cloth, Scene, Settings, Simulation

MASS, SIDE = 0.2, 10


@pytest.mark.parametrize(
    ("substeps", "iterations", "stiffness"),
    [
        (80, 2, 16.0),
        (80, 3, 32.0),
        (160, 3, 1e9),
        (320, 1, 1e9),
        (320, 2, 8.0),
        (320, 4, 32.0),
        (320, 2, 64.0),
        (320, 4, 1e9),
    ],
)
def test_a_stiff_sheet_that_flies_freely_gains_no_energy(substeps, iterations, stiffness):
    """From random velocities without gravity, order 2; BDF2 alone gains up to 150 times what is there.

    stiffness: of a spring over the inertia of its particles in a substep.
    """
    dt = 1.0 / 60.0 / substeps
    compliance = 2.0 * SIDE**2 / MASS * dt**2 / stiffness
    sheet = Cloth(
        resolution=(SIDE, SIDE),
        size=(0.9, 0.9),
        mass=MASS,
        pins=None,
        stretch_compliance=compliance,
        shear_compliance=2.0 * compliance,
    )
    settings = Settings(order=2, substeps=substeps, iterations=iterations)
    sim = Simulation(Scene({"it": sheet}, gravity=(0, 0, 0)), settings, device="cpu")
    velocities = np.random.default_rng(0).standard_normal((SIDE**2, 3))
    sim.set_velocities("it", velocities)
    start = 0.5 * float(sim.masses("it") @ (velocities**2).sum(1))
    kinetic = []
    for _ in range(60):
        sim.step()
        kinetic.append(sim.report()["it"]["kinetic_energy"])
    assert max(kinetic) < 1.01 * start
