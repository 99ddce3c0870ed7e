# SPDX-License-Identifier: Apache-2.0
"""The references judge the solver, so they are judged here: orders, invariants, each other and closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cloth_sim_ros.sim import Cloth, Plane, Scene, Settings, Simulation, Sphere
from cloth_sim_ros.study import contact_cases, exact, implicit, motion, norms
from cloth_sim_ros.study.case import BODY, FRAME_DT
from cloth_sim_ros.study.cases import CASES
from cloth_sim_ros.study.closed_forms import bending, contact, oscillator, ropes
from cloth_sim_ros.study.contact import SLOW, obstacle, projected_leapfrog
from cloth_sim_ros.study.springs import SpringSystem


def grid(count=5, size=1.0, mass=0.2, constant=200.0, pins=None, **more):
    """A square sheet of equal springs along its lines and diagonals, fixed along its borders unless told otherwise."""
    index = np.arange(count * count).reshape(count, count)
    axis = np.linspace(0.0, size, count)
    x = np.stack([np.tile(axis, count), np.repeat(axis, count), np.zeros(count * count)], axis=1)
    lines = ((index[:, :-1], index[:, 1:]), (index[:-1], index[1:]))
    diagonals = ((index[:-1, :-1], index[1:, 1:]), (index[:-1, 1:], index[1:, :-1]))
    pairs = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in lines + diagonals])
    rest = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1)
    if pins is None:
        pins = np.unique(np.concatenate([index[0], index[-1], index[:, 0], index[:, -1]]))
    springs = {"all": (pairs, rest, np.full(len(pairs), constant))}
    return SpringSystem.from_springs(np.full(len(x), mass / len(x)), pins, springs, **more), x


def oscillator_system(frequency=10.0, mass=0.3, damping=0.0):
    """One mass on one spring along x, pulled 0.1 m from rest, without gravity."""
    springs = {"all": (np.array([[0, 1]]), np.array([1.0]), np.array([mass * frequency**2]))}
    system = SpringSystem.from_springs(np.full(2, mass), [0], springs, damping=damping, gravity=(0.0, 0.0, 0.0))
    return system, np.array([[0.0, 0.0, 0.0], [1.1, 0.0, 0.0]])


def orders(step, system, x, counts, exact):
    v = np.zeros_like(x)
    errors = [norms.rms(motion.frames_by(step, system, x, v, 0.05, 4, n)[0][1:] - exact[1:]) for n in counts]
    return np.log2(np.array(errors[:-1]) / errors[1:])


@pytest.mark.parametrize(
    "step, order, counts",
    [
        (motion.forward_euler, 1.0, (400, 800)),
        (motion.leapfrog, 2.0, (40, 80, 160)),
        (motion.runge_kutta_4, 4.0, (8, 16, 32)),
        (implicit.implicit_step, 1.0, (40, 80)),
    ],
)
def test_fitted_order(step, order, counts):
    system, x = grid(4)
    exact = motion.exact_frames(system, x, np.zeros_like(x), 0.05, 4, 1e-9)[0]
    assert orders(step, system, x, counts, exact) == pytest.approx(order, abs=0.12)


@pytest.mark.parametrize("damping, drag", [(0.0, 0.0), (2e-3, 1.5)])
def test_exact_motion_agrees_with_an_independent_integrator(damping, drag):
    system, x = grid(4, damping=damping, global_damping=drag)

    def slope(t, y):
        position, velocity = y.reshape(2, -1, 3)
        return np.concatenate([velocity, system.accelerations(position, velocity)]).ravel()

    start = np.stack([x, np.zeros_like(x)]).ravel()
    found = solve_ivp(slope, (0.0, 0.2), start, method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1].reshape(2, -1, 3)
    exact = motion.exact_frames(system, x, np.zeros_like(x), 0.05, 4, 1e-7)
    assert np.abs(exact[0][-1] - found[0]).max() < 1e-9
    assert np.abs(exact[1][-1] - found[1]).max() < 1e-6


def test_exact_motion_keeps_energy_and_momentum():
    system, x = grid(4, pins=[], gravity=(0.0, 0.0, 0.0))
    v = np.cross([0.0, 0.0, 3.0], x) + np.random.default_rng(0).standard_normal(x.shape) * 0.05
    positions, velocities = motion.frames_by(motion.runge_kutta_4, system, x, v, 0.05, 6, 200)
    assert norms.energy_drift(system, positions, velocities) < 1e-6
    momentum = np.einsum("i,fij->fj", system.masses, velocities)
    spin = np.einsum("i,fij->fj", system.masses, np.cross(positions, velocities))
    assert np.allclose(momentum, momentum[0], atol=1e-12) and np.allclose(spin, spin[0], atol=1e-8)


@pytest.mark.parametrize("damping", [0.0, 0.01])
def test_implicit_euler_is_its_closed_form_on_one_spring(damping):
    system, x = oscillator_system(damping=damping)
    h = 0.02
    q = motion.frames_by(implicit.implicit_step, system, x, np.zeros_like(x), h, 30, 1)[0][:, 1, 0] - 1.0
    z = oscillator.implicit_euler(10.0 * h, 0.5 * damping * 10.0)
    assert q[2:] == pytest.approx(2.0 * z.real * q[1:-1] - abs(z) ** 2 * q[:-2], abs=1e-12)


def test_exact_motion_is_the_damped_oscillation():
    system, x = oscillator_system(damping=0.01)
    frames = motion.exact_frames(system, x, np.zeros_like(x), 0.02, 30, 1e-8)[0]
    expected = 0.1 * oscillator.damped_oscillation(0.02 * np.arange(31), 10.0, 0.05)
    assert np.abs(frames[:, 1, 0] - 1.0 - expected).max() < 1e-9


def test_stiffness_is_the_derivative_of_the_pull():
    system, x = grid(3)
    rng = np.random.default_rng(3)
    x = x + 0.1 * rng.standard_normal(x.shape)
    direction = rng.standard_normal(x.shape)

    def tension(at):
        return system.constant * (system.lengths(at)[0] - system.rest_length)

    def pull(t):
        at = x + t * direction
        return system.pull(system.lengths(at)[1], tension(at))

    numeric = (pull(1e-6) - pull(-1e-6)) / 2e-6
    exact = -(system.stiffness(x, tension(x), system.constant, False) @ direction.ravel()).reshape(x.shape)
    assert np.abs(numeric - exact).max() < 1e-6 * np.abs(exact).max()
    clamped = system.stiffness(x, tension(x), system.constant, True).toarray()
    assert np.linalg.eigvalsh(clamped).min() > -1e-9 * np.abs(clamped).max()


def test_implicit_dashpots_and_drag_tend_to_the_exact_motion():
    system, x = grid(4, damping=2e-3, global_damping=1.5)
    exact = motion.exact_frames(system, x, np.zeros_like(x), 0.05, 4, 1e-7)[0]
    assert orders(implicit.implicit_step, system, x, (40, 80), exact) == pytest.approx(1.0, abs=0.12)


def test_equilibrium_is_the_chain_and_the_catenary():
    segments, k = 12, 300.0
    masses = np.full(segments + 1, 0.02)
    pairs = np.stack([np.arange(segments), np.arange(1, segments + 1)], axis=1)
    springs = {"all": (pairs, np.full(segments, 0.1), np.full(segments, k))}
    hung = SpringSystem.from_springs(masses, [0], springs)
    x = np.zeros((segments + 1, 3))
    x[:, 0] = 0.1 * np.arange(segments + 1)
    found = implicit.equilibrium(hung, x)
    extensions = ropes.hanging_extensions(masses, np.full(segments, k), 9.81)
    assert -np.diff(found[:, 2]) - 0.1 == pytest.approx(extensions, rel=1e-9)
    both = SpringSystem.from_springs(masses, [0, segments], springs)
    x[:, 0] *= 1.0 / 1.2
    expected = ropes.catenary_chain(1.0, np.full(segments, 0.1), masses, k, 9.81)
    assert np.abs(implicit.equilibrium(both, x)[:, [0, 2]] - expected).max() < 1e-9


def test_norms():
    system, x = oscillator_system()
    reference = np.stack([x, x + [0.0, 0.3, 0.0]])
    run = reference + [[[0.0, 0.0, 0.0]], [[0.0, 0.03, 0.0]]]
    found = norms.error(system, run, reference)
    assert found.position == pytest.approx(0.03) and found.relative == pytest.approx(0.1)
    assert found.strain_max == pytest.approx(0.0, abs=1e-15)
    run = np.stack([x, x * 1.1])
    found = norms.error(system, run, np.stack([x, x]) + [[[0.0]], [[1e-9]]])
    assert found.strain_rms == pytest.approx(0.11, rel=1e-6) and found.strain_max == pytest.approx(0.11, rel=1e-6)
    assert norms.error(system, np.full_like(run, np.nan), reference).position == np.inf


def test_chaos_guard_trusts_a_sheet_and_stops_a_double_pendulum():
    sheet, x = grid(4)
    beside = x + norms.perturbation(x.shape)
    still = np.zeros_like(x)
    frames = [motion.exact_frames(sheet, start, still, 0.05, 6, 1e-6)[0] for start in (x, beside)]
    assert norms.trusted_frames(*frames, tolerance=1e-3) == 7
    pair = {"all": (np.array([[0, 1], [1, 2]]), np.ones(2) * 0.2, np.full(2, 2e3))}
    pendulum = SpringSystem.from_springs(np.full(3, 0.5), [0], pair)
    x = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.2], [1e-3, 0.0, 0.4]])
    runs = [
        motion.frames_by(
            motion.runge_kutta_4, pendulum, x + size * norms.perturbation(x.shape, 1.0), 0.0 * x, 0.1, 80, 60
        )
        for size in (0.0, 1e-6)
    ]
    trusted = norms.trusted_frames(runs[0][0], runs[1][0], tolerance=1e-3)
    assert 3 < trusted < 60


@pytest.mark.parametrize("slope", [0.3, 0.6])
def test_contact_follows_coulomb_down_a_slope(slope):
    down, normal = np.array([np.cos(slope), 0.0, -np.sin(slope)]), np.array([np.sin(slope), 0.0, np.cos(slope)])
    floor = Plane(normal=tuple(normal), static_friction=0.4, kinetic_friction=0.3)
    body = Cloth(static_friction=0.4, kinetic_friction=0.3, thickness=0.01)
    springs = {"all": (np.array([[0, 1]]), np.array([0.5]), np.array([10.0]))}
    system = SpringSystem.from_springs(np.ones(2), (), springs)
    x = np.array([[0.0, 0.0, 0.0], [0.0, 0.5, 0.0]]) + 0.01 * normal
    step = projected_leapfrog([obstacle(floor, body)])
    frames = motion.frames_by(step, system, x, np.zeros_like(x), 0.05, 10, 200)[0]
    way = contact.incline_distance(0.5, slope, 0.4, 0.3, SLOW, 9.81)
    assert (way > 0.0) == (slope == 0.6)
    assert frames[-1] == pytest.approx(x + way * down, abs=1e-3)


def test_contact_stops_what_falls_on_a_ball():
    ball = Sphere(radius=0.2, position=(0.0, 0.0, -0.3))
    springs = {"all": (np.array([[0, 1]]), np.array([1.0]), np.array([1e-6]))}
    system = SpringSystem.from_springs(np.ones(2), (), springs)
    x = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    step = projected_leapfrog([obstacle(ball, Cloth(thickness=0.01))])
    frames, speeds = motion.frames_by(step, system, x, np.zeros_like(x), 0.05, 6, 100)
    assert frames[-1, 0] == pytest.approx([0.0, 0.0, -0.09], abs=1e-6) and np.abs(speeds[-1, 0]).max() < 1e-3
    assert frames[-1, 1, 2] == pytest.approx(-0.5 * 9.81 * 0.3**2, rel=1e-2)


def test_bending_of_the_reference_is_the_beams():
    system, x = CASES["cantilever"].system(64, 1e5)
    free = np.flatnonzero(~system.fixed)
    down = np.zeros(len(x))
    down[free] = np.linalg.solve(system.bending.toarray()[np.ix_(free, free)], -9.81 * system.masses[free])
    loads = 9.81 * system.masses[2:]
    chain = bending.cantilever_chain_tip(np.arange(1, 64) / 64, loads, 1 / 64, 2.0)
    assert -down[-1] == pytest.approx(chain, rel=1e-9)


def test_a_sheet_slides_as_coulomb_says_where_friction_does_not_fall():
    body, alike = contact_cases.sliding_sheet(8, 1e3), {"static_friction": 0.3, "kinetic_friction": 0.3}
    scene = Scene({BODY: replace(body, **alike)}, {"slope": replace(contact_cases.SLOPE["slope"], **alike)})
    sim = Simulation(scene, Settings(frame_dt=FRAME_DT, method="xpbd", order=2, substeps=40), "cpu")
    start, slope = sim.positions(BODY).astype(float), np.radians(35.0)
    sim.step(30)
    way = 0.5 * contact.incline_acceleration(slope, 0.3, 0.3, 9.81) * (30 * FRAME_DT) ** 2
    down = np.array([np.cos(slope), 0.0, -np.sin(slope)])
    assert norms.rms(sim.positions(BODY) - start - way * down) < 2e-6


@pytest.mark.long
@pytest.mark.parametrize("case, settings, error", [
    ("incline", {"order": 2, "substeps": 40}, 2e-4),  # of first order while friction falls with the slip
    ("incline", {"order": 2, "substeps": 160}, 5e-5),
    ("cantilever", {"order": 2, "substeps": 40, "iterations": 4}, 3e-5),
    ("ball", {"order": 2, "substeps": 40, "iterations": 4}, 2e-5),
    ("capstan", {"order": 2, "substeps": 160}, 6e-3),
])  # fmt: skip
def test_the_solver_moves_as_the_references_of_contact_and_bending(case, settings, error, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(exact, "CONTACT_SUBSTEPS", 300)
    case = CASES[case]
    resolution = min(case.resolution, 40)
    known = exact.reference(case, resolution, case.constant)
    assert known.trusted > 5
    sim = case.simulation(
        resolution, case.constant, Settings(frame_dt=FRAME_DT, **{"method": "xpbd", "order": 1, **settings}), "cpu"
    )
    found = [sim.positions(BODY)]
    for _ in range(known.trusted - 1):
        sim.step()
        found.append(sim.positions(BODY))
    assert norms.error(known.system, np.array(found), known.frames[: known.trusted]).position < error
