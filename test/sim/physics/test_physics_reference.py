# SPDX-License-Identifier: Apache-2.0
"""Motion: clamped sheets and swinging ropes against the float64 references; orders, and no loss at small substeps."""

import numpy as np
import pytest
from fixed_settings import fixed

from cloth_sim_ros.sim import Cloth, Rope, Scene, Simulation
from cloth_sim_ros.study import implicit, motion, norms
from cloth_sim_ros.study.springs import SpringSystem

DT = 1 / 60


def clamped_sheet(count, offset=(0.0, 0.0, 0.0)):
    """A sheet of 1 m, 0.2 kg, 1000 N/m with all four edges fixed."""
    springs = {"stretch_compliance": 1e-3, "shear_compliance": 1e-3}
    return Cloth(resolution=(count, count), mass=0.2, position=offset, pins="edges", **springs)


def tilted_rope(segments, end_mass, stretch=1e-4):
    """A rope of 1 m and 0.2 kg at 45 degrees, fixed above, with a heavy end."""
    masses = np.full(segments + 1, 0.2 / segments)
    masses[[0, -1]] *= 0.5
    masses[-1] += end_mass
    side = np.sqrt(0.5)
    return Rope(
        start=(0, 0, 0), end=(side, 0, -side), segments=segments, stretch_compliance=stretch, particle_masses=masses
    )


def edges_of(count):
    index = np.arange(count * count).reshape(count, count)
    return np.unique(np.concatenate([index[0], index[-1], index[:, 0], index[:, -1]]))


def system_of(thing, pins):
    """The springs of `thing` in float64, and where they start."""
    sim = Simulation(Scene(objects={"it": thing}), device="cpu")
    system = SpringSystem.from_springs(sim.masses("it"), pins, sim.springs("it"))
    return system, sim.rest_positions("it").astype(np.float64)


def frames_of(thing, device, frames, **settings):
    sim = Simulation(Scene(objects={"it": thing}), fixed(**settings), device=device)
    positions = [sim.positions("it")]
    for _ in range(frames):
        sim.step()
        positions.append(sim.positions("it"))
    return np.array(positions, dtype=np.float64)


@pytest.fixture(scope="module")
def sheet():
    """The 16 x 16 clamped sheet, its exact motion over 0.5 s."""
    system, start = system_of(clamped_sheet(16), edges_of(16))
    return system, motion.exact_frames(system, start, 0.0 * start, DT, 30, 1e-5)[0]


def test_exact_motion_of_the_sheet_can_be_trusted(sheet):
    system, exact = sheet
    beside = exact[0] + np.where(system.fixed[:, None], 0.0, norms.perturbation(exact[0].shape))
    substeps = 2 * motion.stable_substeps(system, DT)
    perturbed = motion.frames_by(motion.runge_kutta_4, system, beside, 0.0 * beside, DT, 30, substeps)[0]
    assert norms.trusted_frames(exact, perturbed, tolerance=1e-4) == 31


@pytest.mark.parametrize("order, counts, iterations", [(1, (160, 320, 640), 4), (2, (20, 40, 80), 10)])
def test_fitted_order_of_the_sheet(device, sheet, order, counts, iterations):
    system, exact = sheet
    settings = {"order": order, "iterations": iterations}
    errors = [
        norms.error(system, frames_of(clamped_sheet(16), device, 30, substeps=n, **settings), exact).position
        for n in counts
    ]
    slope = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.15 if order == 1 else 0.2)


@pytest.mark.parametrize("order", [1, 2])
def test_error_does_not_grow_again_at_small_substeps(device, sheet, order):
    system, exact = sheet
    found = {
        n: norms.error(system, frames_of(clamped_sheet(16), device, 30, order=order, substeps=n), exact).relative
        for n in (256, 512)
    }
    assert found[512] <= found[256] < 0.05


def test_error_ten_metres_from_the_origin_is_at_most_twice_that_at_it(device, sheet):
    system, exact = sheet
    offset = np.array([6.0, 6.0, -6.0])
    near = frames_of(clamped_sheet(16), device, 30, order=2, substeps=80, iterations=4)
    far = frames_of(clamped_sheet(16, tuple(offset)), device, 30, order=2, substeps=80, iterations=4) - offset
    assert norms.error(system, far, exact).position < 2.0 * norms.error(system, near, exact).position


@pytest.mark.parametrize("substeps, tolerance", [(10, 2.5e-3), (40, 3e-4)])
def test_converged_sheet_tends_to_implicit_euler(device, substeps, tolerance):
    """Not to rounding: XPBD corrects along the directions of its iterates, which turn within a substep."""
    system, start = system_of(clamped_sheet(10), edges_of(10))
    exact = motion.frames_by(implicit.implicit_step, system, start, 0.0 * start, DT, 12, substeps)[0]
    run = frames_of(clamped_sheet(10), device, 12, order=1, substeps=substeps, iterations=30)
    assert norms.error(system, run, exact).relative < tolerance


@pytest.mark.parametrize("end_mass", [0.0, 0.2, 20.0])
def test_rope_is_implicit_euler_in_few_solves(device, end_mass):
    rope = tilted_rope(24, end_mass)
    system, start = system_of(rope, [0])
    exact = motion.frames_by(implicit.implicit_step, system, start, 0.0 * start, DT, 15, 8)[0]
    found = {}
    for iterations in (1, 2):
        run = frames_of(rope, device, 15, order=1, substeps=8, iterations=iterations)
        found[iterations] = norms.error(system, run, exact).relative
    assert found[1] < 1e-4 and found[2] < 5e-6


@pytest.mark.parametrize("end_mass", [0.2, 20.0])
def test_second_order_rope_is_near_the_exact_motion(device, end_mass):
    rope = tilted_rope(24, end_mass, stretch=1e-3)
    system, start = system_of(rope, [0])
    exact = motion.exact_frames(system, start, 0.0 * start, DT, 30, 1e-4)[0]
    error = norms.error(system, frames_of(rope, device, 30, order=2, substeps=40, iterations=2), exact)
    assert error.relative < 1e-3
