# SPDX-License-Identifier: Apache-2.0
"""Dashpots of a sheet: they slow motion down as c = damping x k says, and do nothing to what is at rest."""

import numpy as np
import pytest
import scipy.sparse as sparse
from scipy.optimize import curve_fit

from cloth_sim_ros.sim import Cloth, Handle, Rope, Scene, Settings, Simulation

G = np.array([5.0, -8.0, 0.0])  # along the plane of a sheet


def held(damping, device):
    """The pull [N] on the hand that has drawn a sheet of neoprene 5 % longer and as far aside."""
    cloth = Cloth.of("neoprene", resolution=(16, 16), size=(0.3, 0.3), pins=None, damping=damping)
    ends = {
        name: Handle(position=(0, y, 0), reach=(0.35, 0.004, 0.01), attached=True)
        for name, y in (("near", -0.15), ("far", 0.15))
    }
    sim = Simulation(Scene({"it": cloth}, handles=ends, gravity=(0, 0, 0)), Settings(method="xpbd"), device)
    for share in np.linspace(0.0, 0.015, 31)[1:]:
        sim.set_handle_pose("far", (share, 0.15 + share, 0))
        sim.step()
    sim.step(200)
    return sim.handle_wrench("far")[0]


@pytest.mark.parametrize("damping", [0.01, 1.0])
def test_a_sheet_at_rest_does_not_feel_them(device, damping):
    """A line must not resist what later lines of the sweep undo, or the pull falls short by 6 and 64 %."""
    pull, without = held(damping, device), held(0.0, device)
    assert np.linalg.norm(without) > 5.0
    assert np.abs(pull - without).max() < 0.005 * np.abs(without).max()


def swung(cloth, device, **settings):
    """Where the particles of a sheet hung by its upper row are, frame by frame (30, N, 3)."""
    sim, rows = Simulation(Scene({"it": cloth}, gravity=tuple(G)), Settings(**settings), device), []
    for _ in range(30):
        sim.step()
        rows.append(sim.positions("it"))
    return np.array(rows, dtype=np.float64)


def by_midpoints(cloth, damping):
    """The same in float64 by the explicit midpoint rule, of the springs that the product reports."""
    sim = Simulation(Scene({"it": cloth}), device="cpu")
    x, mass = sim.positions("it").astype(np.float64), sim.masses("it")
    inverse = np.where(x[:, 1] > x[:, 1].max() - 1e-6, 0.0, 1.0 / mass)[:, None]
    springs = list(sim.springs("it").values())
    ends, rest, constant = (np.concatenate([np.asarray(each[k], np.float64) for each in springs]) for k in range(3))
    ends, row = ends.astype(int), np.arange(len(rest))
    apart = sparse.csr_matrix(
        (np.r_[np.ones(len(row)), -np.ones(len(row))], (np.r_[row, row], np.r_[ends[:, 1], ends[:, 0]]))
    )

    def acceleration(x, v):
        edge = apart @ x
        length = np.linalg.norm(edge, axis=1)
        unit = edge / length[:, None]
        pull = constant * (length - rest + damping * ((apart @ v) * unit).sum(axis=1))
        return G * (inverse > 0) - inverse * (apart.T @ (pull[:, None] * unit))

    fastest = 12.0 * constant.max() * inverse.max()
    steps = int(np.ceil(1.0 / 60.0 / min(0.5 / np.sqrt(fastest), 1.0 / (damping * fastest))))
    h, v, rows = 1.0 / 60.0 / steps, np.zeros_like(x), []
    for _ in range(30):
        for _ in range(steps):
            half = v + 0.5 * h * acceleration(x, v)
            x, v = x + h * half, v + h * acceleration(x + 0.5 * h * v, half)
        rows.append(x)
    return np.array(rows)


@pytest.mark.long
def test_the_error_of_a_damped_sheet_falls_with_the_square_of_the_substeps(device):
    """It would be 13 % of the motion at 13 substeps, and fall by half only, were slips those of a line's own solve."""
    damping = 0.02
    cloth = Cloth(
        resolution=(8, 8), mass=0.2, pins="top", stretch_compliance=1e-3, shear_compliance=1 / 300, damping=damping
    )
    exact = by_midpoints(cloth, damping)
    motion = np.sqrt(((exact - Simulation(Scene({"it": cloth}), device="cpu").positions("it")) ** 2).mean())
    errors = []
    for substeps in (13, 26, 52):
        found = swung(cloth, device, method="xpbd", order=2, substeps=substeps, iterations=1)
        errors.append(np.sqrt(((found - exact) ** 2).mean()) / motion)
    assert errors[0] < 0.02, errors
    assert errors[0] / errors[1] > 3.0 and errors[1] / errors[2] > 3.0, errors


@pytest.mark.parametrize("substeps", [0, 5, 20])
def test_a_rope_that_spins_is_strained_by_the_centrifugal_force_alone(device, substeps):
    """Segments that only turn do not pull: T(s) = mu w^2 (l^2 - s^2) / 2 of a rope of mu = 1 kg/m.

    Dashpots of second order had taken a rotation for a change of length. A rope that springs open had gained up to 60
    times its energy, and one of its segments was strained by 6 %.
    """
    half = 0.15
    rope = Rope(segments=12, start=(-half, 0, 0), end=(half, 0, 0), pins=None, mass=0.3, stretch_compliance=1e-4,
                bend_compliance=2e3, damping=0.02, bend_damping=0.02)  # fmt: skip
    sim = Simulation(Scene({"it": rope}, gravity=(0, 0, 0)), Settings(order=2, substeps=substeps), device)
    sim.set_velocities("it", np.cross((0, 0, 30.0), sim.positions("it")))
    sim.step(40)
    x = sim.positions("it").astype(float)
    spin = np.linalg.norm(sim.velocities("it")[0]) / np.linalg.norm(x[0])  # the first substep loses some
    strain = np.linalg.norm(np.diff(x, axis=0), axis=1) / (half / 6.0) - 1.0
    s = half * (np.arange(12) - 5.5) / 6.0
    assert strain == pytest.approx(1e-4 * spin**2 * 0.5 * (half**2 - s**2), rel=0.06, abs=3e-5)


RADIUS = 0.05


def sleeve(damping, settings, device):
    """A simulation of a tube of neoprene that is round at rest, and where its particles are (N, 3)."""
    around, along = 24, 8
    angle = np.tile(2.0 * np.pi * np.arange(around) / around, along + 1)
    height = np.repeat(np.linspace(-0.08, 0.08, along + 1), around)
    points = np.column_stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), height])
    corner = np.arange(around * along)
    after = corner // around * around + (corner + 1) % around
    triangles = np.concatenate(
        [np.stack([corner, after, after + around], 1), np.stack([corner, after + around, corner + around], 1)]
    )
    cloth = Cloth.from_mesh(points, triangles, "neoprene", damping=damping, shear_compliance=None)
    return Simulation(Scene({"it": cloth}, gravity=(0, 0, 0)), settings, device), points


@pytest.mark.parametrize(("method", "substeps", "frame_dt"), [("xpbd", 40, 1 / 60), ("verlet", 600, 1e-3)])
@pytest.mark.parametrize("axis", [(0, 0, 5.0), (4.0, 0, 0)])
def test_a_sleeve_turns_freely(device, axis, method, substeps, frame_dt):
    """Dashpots of bending had taken a rotation for a change of the bend, and 40 % of the momentum in a second."""
    sim, points = sleeve(0.01, Settings(method=method, substeps=substeps, frame_dt=frame_dt), device)
    sim.set_velocities("it", np.cross(axis, points))
    mass = sim.masses("it")[:, None]
    before = (mass * np.cross(points, np.cross(axis, points))).sum(axis=0)
    sim.step(30)
    now = (mass * np.cross(sim.positions("it").astype(float), sim.velocities("it"))).sum(axis=0)
    assert np.abs(now - before).max() < 3e-3 * np.linalg.norm(before)


def test_a_sleeve_that_turns_oval_swings_as_its_dashpots_say(device):
    """Rayleigh's mode of a ring, which stretches nothing, decays at tau omega^2 / 2. It had decayed 19 % too fast."""
    damping, found = 2e-3, {}
    for tau in (0.0, damping):
        sim, points = sleeve(tau, Settings(method="xpbd", substeps=40, frame_dt=1 / 240), device)
        x, y, _ = (points / RADIUS).T
        oval = np.column_stack([(x * x - y * y) * x + x * y * y, (x * x - y * y) * y - x * x * y, 0.0 * x])
        sim.set_velocities("it", 0.05 * oval)
        swing = []
        for _ in range(60):
            sim.step()
            swing.append(((sim.positions("it") - points) * oval).sum())
        (_, *found[tau]), _ = curve_fit(
            lambda t, size, decay, rate: size * np.exp(-decay * t) * np.sin(rate * t),
            np.arange(1, 61) / 240,
            swing / np.abs(swing).max(),
            (1.0, 1.0, 47.0),
        )
    (nothing, rate), (decay, _) = found[0.0], found[damping]
    assert decay - nothing == pytest.approx(0.5 * damping * rate**2, rel=0.03)
