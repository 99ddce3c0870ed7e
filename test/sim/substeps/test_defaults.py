# SPDX-License-Identifier: Apache-2.0
"""What a user gets who says nothing of the solver, against equilibria in float64 and closed forms."""

import numpy as np
import pytest
from minimum import minimum, system_of
from scipy.spatial import Delaunay

from cloth_sim_ros.sim import Cloth, Rope, Scene, Settings, Simulation
from cloth_sim_ros.study.closed_forms import bending, ropes, sheets

G, DT = 9.81, 1 / 60
UPRIGHT = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))  # local y up
SIZE, MASS = 1.0, 0.2


def sheet(kind, side, compliance, hem=0.0):
    """A sheet of 1 m and 0.2 kg hung by its upper corners; `hem`: weight of its lowest row over its own."""
    fields = {"stretch_compliance": compliance, "orientation": UPRIGHT, "mass": MASS}
    if kind == "grid":
        index = np.arange(side * side).reshape(side, side)
        fields |= {"resolution": (side, side), "shear_compliance": 3.0 * compliance}
        bare = Cloth(**fields)
        pins, low = index[-1, [0, -1]], index[0]
    else:
        points = crooked(side)
        triangles = Delaunay(points).simplices
        bare = Cloth.from_mesh(np.c_[points, np.zeros(len(points))], triangles, **fields)
        fields |= {"vertices": bare.vertices, "triangles": bare.triangles, "shear_compliance": None}
        top, low = points[:, 1] == points[:, 1].max(), np.flatnonzero(points[:, 1] == points[:, 1].min())
        pins = np.flatnonzero(top)[[np.argmin(points[top, 0]), np.argmax(points[top, 0])]]
    masses = Simulation(Scene({"it": bare}), device="cpu").masses("it")
    masses[low] += hem * MASS / len(low)
    return Cloth(**{**fields, "pins": tuple(pins.tolist()), "particle_masses": masses})


def crooked(side):
    """Points (N, 2) of a square whose inside is moved by a fifth of the spacing."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, side), np.linspace(-0.5, 0.5, side))
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    inside = np.abs(points).max(axis=1) < 0.499
    moved = np.random.default_rng(side).uniform(-0.2, 0.2, points.shape) / (side - 1)
    return points + moved * inside[:, None]


def at_rest(thing, device, frames=480, damping=3.0, error=1e-2):
    sim = Simulation(Scene({"it": thing}), Settings(global_damping=damping, budget=10.0, error=error), device)
    sim.step(frames)
    return sim, sim.positions("it").astype(np.float64)


@pytest.mark.parametrize(
    ("kind", "side", "constant", "hem", "error"),
    [
        ("grid", 8, 1e6, 0.0, 1e-3),
        ("grid", 16, 1e4, 5.0, 1e-2),
        ("mesh", 8, 1e5, 5.0, 1e-2),
        ("mesh", 16, 1e2, 0.0, 1e-3),
        pytest.param("grid", 8, 1e2, 5.0, 1e-2, marks=pytest.mark.long),
        pytest.param("grid", 16, 1e2, 0.0, 1e-2, marks=pytest.mark.long),
        pytest.param("grid", 32, 1e3, 5.0, 1e-3, marks=pytest.mark.long),
        pytest.param("mesh", 8, 1e2, 0.0, 1e-2, marks=pytest.mark.long),
        pytest.param("mesh", 16, 1e4, 5.0, 1e-3, marks=pytest.mark.long),
        pytest.param("mesh", 32, 1e2, 5.0, 1e-2, marks=pytest.mark.long),
        pytest.param("mesh", 32, 1e4, 0.0, 1e-3, marks=pytest.mark.long),
    ],
)
def test_hung_and_loaded_sheets_are_strained_as_their_springs_are(device, kind, side, constant, hem, error):
    """Within 25 times the wanted error, or strains of ten millionths, which nobody sees."""
    sim, x = at_rest(sheet(kind, side, 1.0 / constant, hem), device, error=error)
    system = system_of(sim)
    exact = minimum(system, x)
    found, wanted = (np.abs(system.strains(at)).mean() for at in (x, exact))
    assert np.sqrt(((x - exact) ** 2).sum(axis=1).mean()) < 1e-3 * SIZE
    assert found == pytest.approx(wanted, rel=25 * error, abs=max(2.5e-3 * error, 1e-5)), sim.choices["it"].reason


@pytest.mark.long
@pytest.mark.parametrize(("kind", "side"), [("grid", 8), ("grid", 24), ("mesh", 8), ("mesh", 16)])
def test_rigid_sheets_are_not_strained(device, kind, side):
    sim, x = at_rest(sheet(kind, side, 0.0, 5.0), device)
    pairs, rest, _ = sim.springs("it")["structural"]
    strain = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1) / rest - 1.0
    assert np.abs(strain).mean() < 1e-4 and np.abs(strain).max() < 1e-2


def frequency(amplitude):
    """Angular frequency [rad/s] of the recurrence q_n+2 = 2 Re z q_n+1 - |z|^2 q_n that fits samples at 60 Hz."""
    q = np.asarray(amplitude, dtype=np.float64)
    twice, square = np.linalg.lstsq(np.stack([q[1:-1], -q[:-2]], axis=1), q[2:], rcond=None)[0]
    return np.arccos(0.5 * twice / np.sqrt(square)) / DT


def ring(sim, shape, masses, axis, frames=50):
    """Amplitudes of the mode `shape` (N,) along an axis after each frame."""
    found = []
    for _ in range(frames):
        sim.step()
        found.append((masses * shape) @ sim.positions("it")[:, axis].astype(np.float64))
    return found


@pytest.mark.parametrize("mode", [1, 2, 3])
def test_a_taut_string_rings_at_its_frequency(device, mode):
    segments, span, ea = 32, 1.05, 100.0
    rope = Rope(start=(0, 0, 0), end=(1, 0, 0), segments=segments, mass=0.2, pins="both", stretch_compliance=1.0 / ea)
    sim = Simulation(Scene({"it": rope}, gravity=(0, 0, 0)), device=device)
    s = np.linspace(0.0, 1.0, segments + 1)
    shape = np.sin(mode * np.pi * s)
    sim.set_positions("it", np.stack([span * s, 2e-3 * shape, 0.0 * s], axis=1))
    wanted = ropes.beaded_string_frequency(mode, ea * (span - 1.0), 0.2 / segments, span / segments, segments - 1)
    amplitudes = ring(sim, shape, sim.masses("it"), 1)
    assert frequency(amplitudes) == pytest.approx(wanted, rel=0.01)
    assert np.abs(amplitudes[-25:]).max() > 0.7 * np.abs(amplitudes[:25]).max(), "waves last"


@pytest.mark.parametrize("mode", [(1, 1), (2, 1)])
@pytest.mark.parametrize("side", [17, 33])
def test_a_membrane_rings_at_its_frequencies(device, side, mode):
    """Stretched by 1 % on both axes: omega^2 = (T / sigma) (kx^2 + ky^2), T = (C11 + C12) strain, of the grid."""
    ks, kd, strain = 1e3, 400.0, 0.01
    cloth = Cloth(resolution=(side, side), mass=MASS, pins="edges", stretch_compliance=1 / ks, shear_compliance=1 / kd)
    sim = Simulation(Scene({"it": cloth}, gravity=(0, 0, 0)), device=device)
    x = sim.rest_positions("it").astype(np.float64)
    shape = np.prod([np.sin(m * np.pi * (x[:, axis] + 0.5)) for axis, m in enumerate(mode)], axis=0)
    start = (1.0 + strain) * x
    start[:, 2] = 1e-3 * shape
    sim.set_positions("it", start)
    amplitudes = ring(sim, shape, sim.masses("it"), 2)
    a = 1.0 / (side - 1)
    stiffness = 0.0  # of the springs' tension across, along each direction in which they lie
    for dx, dy, k in ((1, 0, ks), (0, 1, ks), (1, 1, kd), (1, -1, kd)):
        tension_over_length = k * (1.0 - 1.0 / (1.0 + strain))
        phase_x, phase_y = (m * np.pi * a * step for m, step in zip(mode, (dx, dy), strict=True))
        stiffness += 2.0 * tension_over_length * (1.0 - np.cos(phase_x) * np.cos(phase_y))
    wanted = np.sqrt(stiffness / (MASS * a * a))
    c11, c12, *_ = sheets.grid_elasticity(ks, kd)
    smooth = np.pi * np.hypot(*mode) * np.sqrt((c11 + c12) * strain / (MASS * 1.01**2))
    assert wanted == pytest.approx(smooth, rel=0.03)
    assert frequency(amplitudes) == pytest.approx(wanted, rel=0.01)


@pytest.mark.long
@pytest.mark.parametrize("gamma", [0.5, 5.0, 50.0])
@pytest.mark.parametrize("kind", ["grid", "mesh"])
def test_a_cantilever_hangs_as_the_heavy_elastica(device, kind, gamma):
    """gamma = w L^3 / B of a strip: tip below and ahead of its clamp (Romero et al. 2021)."""
    length, width, segments, columns = 0.5, 0.1, 25, 6
    sigma = 0.3
    rigidity = sigma * G * length**3 / gamma
    x, y = np.meshgrid(np.arange(-1, segments + 1) * length / segments, np.linspace(-width / 2, width / 2, columns))
    points = np.stack([x.ravel(), y.ravel(), 0.0 * x.ravel()], axis=1)
    if kind == "mesh":
        inside = (points[:, 0] > 1e-6) & (points[:, 0] < length - 1e-6) & (np.abs(points[:, 1]) < width / 2 - 1e-6)
        points[inside, :2] += np.random.default_rng(5).uniform(-3e-3, 3e-3, (inside.sum(), 2))
    triangles = Delaunay(points[:, :2]).simplices
    pins = tuple(np.flatnonzero(points[:, 0] < 1e-9).tolist())
    strip = Cloth.from_mesh(
        points, triangles, mass=sigma * width * length * (segments + 1) / segments, pins=pins, stretch_compliance=1e-4,
        bending="dihedral", bend_compliance=1.0 / rigidity,
    )  # fmt: skip
    sim, at = at_rest(strip, device)
    tip = at[np.abs(points[:, 0] - length) < 1e-9].mean(axis=0)
    curve = bending.heavy_elastica(length, rigidity, sigma * G)
    wanted = curve[-1]
    assert -tip[2] == pytest.approx(wanted[1], rel=0.03)
    assert tip[0] == pytest.approx(wanted[0], rel=0.03)
