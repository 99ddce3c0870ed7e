"""Air: a flat sheet and a rope fall in it as their closed forms say; drag never reverses the relative wind."""

import numpy as np
import pytest
from fixed_settings import fixed

from cloth_sim_ros.sim import Cloth, Rope, Scene, Settings, Simulation, Wind
from cloth_sim_ros.sim.batch import forced_schedule
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


def test_grid_falls_at_the_closed_form_speed(device):
    cloth = Cloth(resolution=(12, 12), size=(0.5, 0.5), mass=0.05, pins=None)
    terminal = sheets.terminal_speed(0.05 / 0.25, G, RHO, CD)
    assert fall_speed(falling(cloth, device, 12)) == pytest.approx(sheets.falling_speed(0.2, terminal, G), rel=1e-3)


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
    sim = Simulation(scene, Settings(method="xpbd", order=1, substeps=substeps), device=device)
    fastest = 0.0
    for _ in range(10):
        sim.step()
        fastest = max(fastest, fall_speed(sim) * -1.0)
    assert 50.0 < fastest < 100.0 * (1.0 + 1e-4)


@pytest.mark.parametrize("schedule", ["resident", "coloured"])
def test_forces_on_crumpled_triangles_are_those_of_the_formula(device, schedule):
    """Ling 2000; Wilson et al. 2014, in float64; 60 triangles, which eight at a time do not divide, one of no area."""
    rng = np.random.default_rng(7)
    wind, lift = np.array((3.0, -1.0, 2.0)), 0.7
    scene = Scene({"it": Cloth(resolution=(7, 6))}, wind=Wind(tuple(wind), RHO, CD, lift))
    with forced_schedule(schedule):
        sim = Simulation(
            scene, Settings(method="xpbd", order=1, substeps=1, iterations=1, frame_dt=1e-4), device=device
        )
    triangles = sim.triangles("it")
    x, v = rng.normal(size=(42, 3)).astype(np.float32), rng.normal(size=(42, 3)).astype(np.float32)
    x[triangles[11][1]] = x[triangles[11][0]]
    sim.set_positions("it", x)
    sim.set_velocities("it", v)
    x, v = sim.positions("it").astype(float), sim.velocities("it").astype(float)  # nudged, and pins rest
    sim.step()
    doubled = np.cross(x[triangles[:, 1]] - x[triangles[:, 0]], x[triangles[:, 2]] - x[triangles[:, 0]])
    size = np.linalg.norm(doubled, axis=1, keepdims=True)
    n, relative = doubled / np.maximum(size, 1e-30), wind - v[triangles].mean(1)
    speed, across = np.linalg.norm(relative, axis=1, keepdims=True), (relative * n).sum(1, keepdims=True)
    factor = 0.25 * RHO * size / 3.0
    force = factor * ((CD - lift) * np.abs(across) * relative + lift * speed**2 * np.sign(across) * n)
    found = sim.device_arrays("it")[0].state.panel_forces.numpy()
    assert np.allclose(found[:, :3], force, rtol=1e-4, atol=1e-5 * np.abs(force).max())
    assert np.allclose(found[:, 3:], factor * CD * speed, rtol=1e-5, atol=1e-6)
