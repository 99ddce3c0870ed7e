# SPDX-License-Identifier: Apache-2.0
"""Air: a flat sheet and a rope fall in it as their closed forms say; drag never reverses the relative wind."""

import numpy as np
import pytest
import warp as wp
from fixed_settings import fixed

from cloth_sim_ros.sim import Cloth, Rope, Scene, Simulation, Wind
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.physics.aerodynamics import segment_force, triangle_force
from cloth_sim_ros.study.closed_forms import sheets

G, RHO, CD = 9.81, 1.225, 1.2


def falling(thing, device, frames, wind=(0.0, 0.0, 0.0), **settings):
    scene = Scene(objects={"it": thing}, wind=Wind(velocity=wind, air_density=RHO, drag_coefficient=CD))
    sim = Simulation(scene, fixed(**settings), device=device)
    sim.step(frames=frames)
    return sim


def fall_speed(sim):
    masses = sim.masses("it")
    return -(masses @ sim.velocities("it"))[2] / masses.sum()


def flat_mesh(count=7, size=0.5, mass=0.05):
    """A sheet whose masses and drag are both lumped by the same triangles, so that it stays flat."""
    axis = np.linspace(-0.5 * size, 0.5 * size, count)
    points = np.stack([np.tile(axis, count), np.repeat(axis, count), np.zeros(count * count)], axis=1)
    i = np.arange(count * count).reshape(count, count)
    lower = np.stack([i[:-1, :-1], i[:-1, 1:], i[1:, 1:]], axis=-1).reshape(-1, 3)
    upper = np.stack([i[:-1, :-1], i[1:, 1:], i[1:, :-1]], axis=-1).reshape(-1, 3)
    return Cloth.from_mesh(points, np.concatenate([lower, upper]), mass=mass)


@pytest.mark.parametrize("frames", [6, 15, 60])
def test_flat_sheet_falls_at_the_closed_form_speed(device, frames):
    sim = falling(flat_mesh(), device, frames, substeps=40)
    terminal = sheets.terminal_speed(0.05 / 0.25, G, RHO, CD)
    assert fall_speed(sim) == pytest.approx(sheets.falling_speed(frames / 60, terminal, G), rel=1e-3)
    z = sim.positions("it")[:, 2]
    assert np.ptp(z) < 1e-4
    assert -z.mean() == pytest.approx(sheets.fallen_distance(frames / 60, terminal, G), rel=1e-2)


@pytest.mark.parametrize("lift", [0.0, 1.0])
def test_a_free_grid_falls_flat_at_the_closed_form_speed(device, lift):
    cloth = Cloth.of("cotton", resolution=(12, 9), size=(0.55, 0.4), pins=None)
    scene = Scene({"it": cloth}, wind=Wind(air_density=RHO, drag_coefficient=CD, lift_coefficient=lift))
    sim = Simulation(scene, device=device)
    sim.step(120)
    terminal = sheets.terminal_speed(cloth.mass / 0.22, G, RHO, CD)
    assert fall_speed(sim) == pytest.approx(sheets.falling_speed(2.0, terminal, G), rel=1e-3)
    assert np.ptp(sim.positions("it")[:, 2]) < 1e-4


def test_rope_across_the_flow_falls_at_its_terminal_speed(device):
    """A cylinder: 1/2 rho Cd 2 r v^2 per length balances the weight; its ends carry half of both."""
    mass, radius, length = 0.01, 0.01, 1.0
    rope = Rope(start=(0, 0, 0), end=(length, 0, 0), segments=10, mass=mass, radius=radius, pins=None)
    terminal = sheets.terminal_speed(mass / (2.0 * radius * length), G, RHO, CD)
    assert fall_speed(falling(rope, device, 20)) == pytest.approx(sheets.falling_speed(1 / 3, terminal, G), rel=1e-3)


@pytest.mark.parametrize("substeps", [1, 20])
def test_light_sheet_takes_the_speed_of_a_gale_and_no_more(device, substeps):
    cloth = Cloth(resolution=(6, 6), mass=1e-3, pins=None)
    scene = Scene(objects={"it": cloth}, wind=Wind(velocity=(0.0, 0.0, 100.0)), gravity=(0.0, 0.0, 0.0))
    sim = Simulation(scene, fixed(substeps=substeps), device=device)
    fastest = 0.0
    for _ in range(10):
        sim.step()
        fastest = max(fastest, fall_speed(sim) * -1.0)
    assert 50.0 < fastest < 100.0 * (1.0 + 1e-4)


def plate_force(x, triangles, relative, drag, lift):
    """Force (T, 3) [N] and drag rate (T,) [N s/m] of separated flow past triangles, from C_D and C_L in float64."""
    doubled = np.cross(x[triangles[:, 1]] - x[triangles[:, 0]], x[triangles[:, 2]] - x[triangles[:, 0]])
    area = 0.5 * np.linalg.norm(doubled, axis=1)
    n = doubled / np.maximum(2.0 * area, 1e-30)[:, None]
    speed = np.linalg.norm(relative, axis=1)
    wind = relative / speed[:, None]
    sine = (wind * n).sum(1)
    n = np.sign(sine)[:, None] * n
    up = n - np.abs(sine)[:, None] * wind  # across the wind, of length cos alpha
    alpha = np.arcsin(np.minimum(np.abs(sine), 1.0))
    c_d, c_l = drag * np.sin(alpha) ** 3, lift * np.sin(alpha) * np.sin(2.0 * alpha)
    up = up / np.maximum(np.cos(alpha), 1e-30)[:, None]
    pressure = 0.5 * RHO * speed**2 * area
    rate = 0.5 * RHO * area * speed * np.sin(alpha) * max(drag, 2.0 * lift)
    return pressure[:, None] * (c_d[:, None] * wind + c_l[:, None] * up), rate


def one_triangle(angle, speed=3.0):
    """A triangle of half a square metre in the plane z = 0, and wind at `angle` [rad] of incidence."""
    corners = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
    return corners, speed * np.array((np.cos(angle), 0.0, np.sin(angle)))


@compiled
def triangle_kernel(corners: wp.array(dtype=wp.mat33), wind: wp.array(dtype=wp.vec3), drag: float, lift: float,
                    force: wp.array(dtype=wp.vec4)):  # fmt: skip
    i = wp.tid()
    p = corners[i]
    force[i] = triangle_force(p[0], p[1], p[2], wind[i], 1.225, drag, lift)


@compiled
def segment_kernel(wind: wp.array(dtype=wp.vec3), force: wp.array(dtype=wp.vec4)):
    i = wp.tid()
    force[i] = segment_force(wp.vec3(0.0), wp.vec3(2.0, 0.0, 0.0), 0.01, wind[i], 1.225, 1.2)


def triangle_forces(corners, winds, device, drag=CD, lift=0.6):
    """Force and rate (T, 4) on triangles (T, 3, 3) in `winds` (T, 3), by the function of the core."""
    force = wp.zeros(len(winds), dtype=wp.vec4, device=device)
    inputs = [wp.array(corners, dtype=wp.mat33, device=device), wp.array(winds, dtype=wp.vec3, device=device)]
    wp.launch(triangle_kernel, len(winds), [*inputs, drag, lift, force], device=device)
    return force.numpy().astype(float)


def segment_forces(winds, device):
    """Force and rate (T, 4) on a cylinder of 2 m along x, of radius 1 cm, in `winds` (T, 3)."""
    force = wp.zeros(len(winds), dtype=wp.vec4, device=device)
    wp.launch(segment_kernel, len(winds), [wp.array(winds, dtype=wp.vec3, device=device), force], device=device)
    return force.numpy().astype(float)


@pytest.mark.parametrize("lift", [0.6, 0.2])
def test_coefficients_at_an_incidence_are_those_of_the_formula(device, lift):
    angles = np.radians([5.0, 20.0, 45.0, 70.0, 90.0, -30.0])
    corners, winds = zip(*(one_triangle(angle) for angle in angles), strict=True)
    force = triangle_forces(corners, winds, device, lift=lift)[:, :3] / (0.5 * RHO * 9.0 * 0.5)
    along = np.stack([np.cos(angles), 0.0 * angles, np.sin(angles)], axis=1)
    across = np.stack([-np.sin(angles), 0.0 * angles, np.cos(angles)], axis=1)
    assert np.allclose((force * along).sum(1), CD * np.abs(np.sin(angles)) ** 3, rtol=1e-4, atol=1e-6)
    expected = lift * np.abs(np.sin(angles)) * np.sin(2.0 * angles)
    assert np.allclose((force * across).sum(1), expected, rtol=1e-4, atol=1e-6)
    assert np.allclose(force[:, 1], 0.0, atol=1e-6)


def test_force_and_slope_are_continuous_across_edge_on(device):
    """Within a thousandth of a degree of edge-on, and no jump of more than a Lipschitz constant allows elsewhere."""
    angles = np.radians([-1e-3, 0.0, 1e-3])
    corners, winds = zip(*(one_triangle(angle) for angle in angles), strict=True)
    pressure = 0.5 * RHO * 9.0 * 0.5
    assert np.abs(np.diff(triangle_forces(corners, winds, device)[:, :3], axis=0)).max() < 1e-6 * pressure
    angles = np.linspace(-np.pi, np.pi, 3601)
    corners, winds = zip(*(one_triangle(angle) for angle in angles), strict=True)
    steps = np.diff(triangle_forces(corners, winds, device)[:, :3] / pressure, axis=0)
    assert np.linalg.norm(steps, axis=1).max() < 2.0 * CD * (angles[1] - angles[0])
    winds = np.stack([np.cos(angles), 0.0 * angles, np.sin(angles)], axis=1)
    steps = np.diff(segment_forces(winds, device)[:, :3] / (0.5 * RHO * 2.0 * 0.02), axis=0)
    assert np.linalg.norm(steps, axis=1).max() < 2.0 * CD * (angles[1] - angles[0])


def test_air_takes_power_from_motion_through_it(device):
    """F.v >= 0 for air of velocity v seen from the panel; an implicit step, however long, leaves it no faster."""
    rng = np.random.default_rng(3)
    corners, winds = rng.normal(size=(4000, 3, 3)), rng.normal(size=(4000, 3)) * 10.0
    for lift in (0.0, 0.6, 1.2):
        found = triangle_forces(corners, winds, device, lift=lift)
        power = (found[:, :3] * winds).sum(1)
        assert power.min() >= -1e-5 * np.abs(power).max() and power.max() > 0.0
        moved = found[:, :3] / np.maximum(found[:, 3:], 1e-30)
        assert (np.linalg.norm(winds - moved, axis=1) <= np.linalg.norm(winds, axis=1) * (1.0 + 1e-4)).all()
    found = segment_forces(winds, device)
    assert (found[:, :3] * winds).sum(1).min() >= 0.0


def test_sheet_hung_along_the_wind_stays(device):
    """Edge-on to 1 m/s, with ripples of 0.1 mm to begin with, for 3 s; soft ones would buckle as they bounce."""
    upright = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))
    cloth = Cloth((16, 16), pins="top", orientation=upright, stretch_compliance=1e-5, shear_compliance=3e-5)
    sim = Simulation(Scene({"it": cloth}, wind=Wind((1.0, 0.0, 0.0))), fixed(), device=device)
    x = sim.positions("it")
    x[:, 1] += 1e-4 * np.random.default_rng(5).uniform(-1.0, 1.0, len(x))
    sim.set_positions("it", x)
    for _ in range(18):
        sim.step(frames=10)
        assert np.abs(sim.positions("it")[:, 1]).max() < 1e-3


@pytest.mark.parametrize("executor", ["block", "graph"])
def test_forces_on_crumpled_triangles_are_those_of_the_formula(device, executor):
    """In float64; 60 triangles, which eight at a time do not divide, one of no area."""
    rng = np.random.default_rng(7)
    wind, lift = np.array((3.0, -1.0, 2.0)), 0.7
    scene = Scene({"it": Cloth(resolution=(7, 6))}, wind=Wind(tuple(wind), RHO, CD, lift))
    sim = Simulation(scene, fixed(substeps=1, frame_dt=1e-4), device, executor=executor)
    triangles = sim.triangles("it")
    x, v = rng.normal(size=(42, 3)).astype(np.float32), rng.normal(size=(42, 3)).astype(np.float32)
    x[triangles[11][1]] = x[triangles[11][0]]
    sim.set_positions("it", x)
    sim.set_velocities("it", v)
    x, v = sim.positions("it").astype(float), sim.velocities("it").astype(float)  # nudged, and pins rest
    sim.step()
    force, rate = plate_force(x, triangles, wind - v[triangles].mean(1), CD, lift)
    found = sim.device_arrays("it")[0].state.air.panel_forces.numpy()
    assert np.allclose(found[:, :3], force / 3.0, rtol=1e-4, atol=1e-5 * np.abs(force).max())
    assert np.allclose(found[:, 3], rate / 3.0, rtol=1e-4, atol=1e-5 * rate.max())
