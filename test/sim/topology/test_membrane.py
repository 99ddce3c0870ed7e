# SPDX-License-Identifier: Apache-2.0
"""The membrane of a mesh: its energy under constant strains, its matrices, and sheets that are pulled and sheared."""

import numpy as np
import pytest
from scipy.spatial import Delaunay

from cloth_sim_ros.sim import Cloth, Scene, Settings, Simulation
from cloth_sim_ros.sim.topology import build

G = 9.81
WARP, WEFT, SHEAR, POISSON = 1500.0, 900.0, 50.0, 0.2
MODULI = {
    "stretch_compliance": 1.0 / WARP, "weft_compliance": 1.0 / WEFT, "shear_compliance": 1.0 / SHEAR,
    "poisson": POISSON,
}  # fmt: skip


def compliance(angle):
    """1/E [m/N] of an orthotropic sheet at `angle` [rad] from the warp."""
    c, s = np.cos(angle), np.sin(angle)
    return c**4 / WARP + s**4 / WEFT + (1.0 / SHEAR - 2.0 * POISSON / WARP) * (c * s) ** 2


def sheet(kind, width, height, spacing):
    """Points (N, 2) and triangles of a rectangle: cut one way, or jittered and triangulated anew."""
    nx, ny = round(width / spacing) + 1, round(height / spacing) + 1
    x, y = np.meshgrid(np.linspace(0.0, width, nx), np.linspace(0.0, height, ny))
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    if kind == "delaunay":
        inside = (points > 1e-9).all(axis=1) & (points < np.array([width, height]) - 1e-9).all(axis=1)
        points[inside] += np.random.default_rng(1).uniform(-0.3, 0.3, (inside.sum(), 2)) * spacing
        return points, Delaunay(points).simplices
    k = np.arange(nx * ny).reshape(ny, nx)
    a, b, c, d = (each.ravel() for each in (k[:-1, :-1], k[:-1, 1:], k[1:, 1:], k[1:, :-1]))
    return points, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def lengths(x, pairs):
    return np.linalg.norm(x[pairs[..., 1]] - x[pairs[..., 0]], axis=-1)


@pytest.mark.parametrize("kind", ["one way", "delaunay"])
@pytest.mark.parametrize("angle", [0.0, 0.6])
def test_constant_strains_have_the_energy_of_the_moduli(kind, angle):
    points, triangles = sheet(kind, 0.3, 0.2, 0.02)
    flat = np.column_stack([points, np.zeros(len(points))])
    warp = np.array([np.cos(angle), np.sin(angle), 0.0])
    cloth = Cloth.from_mesh(flat, triangles, warp=tuple(warp), **MODULI)
    topology = build(cloth, "it", True)
    springs, coupling = topology.springs["structural"], topology.coupling
    constant = WARP / springs.scale
    pairs = springs.particles
    i, j = pairs.T
    p, q = np.where(coupling.across < 0, i[:, None], coupling.across).T
    around = np.stack([np.stack(ends, axis=1) for ends in ((i, p), (j, p), (i, q), (j, q))], axis=1)
    n11, n12 = 1.0 / WARP, -POISSON / WARP
    stiff = np.linalg.inv([[n11, n12, 0.0], [n12, 1.0 / WEFT, 0.0], [0.0, 0.0, 1.0 / SHEAR]])
    turn = np.array([[warp[0], warp[1]], [-warp[1], warp[0]]])
    for strain in np.random.default_rng(0).uniform(-1e-6, 1e-6, (4, 2, 2)):
        strain = 0.5 * (strain + strain.T)
        x = flat.copy()
        x[:, :2] += points @ strain
        length = lengths(x, pairs)
        rest = coupling.bases + coupling.own * length + (coupling.shares * lengths(x, around)).sum(axis=1)
        energy = 0.5 * (constant * (length - springs.rest) * (length - rest)).sum()
        own = turn @ strain @ turn.T
        e = np.array([own[0, 0], own[1, 1], 2.0 * own[0, 1]])
        assert energy == pytest.approx(0.5 * 0.06 * e @ stiff @ e, rel=1e-4)


@pytest.mark.parametrize("kind", ["one way", "delaunay"])
def test_springs_are_stiffer_than_the_membrane_in_every_motion(kind):
    """The springs bound its energy from above, and it has none below 0."""
    points, triangles = sheet(kind, 0.1, 0.1, 0.02)
    cloth = Cloth.from_mesh(np.column_stack([points, np.zeros(len(points))]), triangles, warp=(1, 2, 0), **MODULI)
    topology = build(cloth, "it", True)
    springs, coupling = topology.springs["structural"], topology.coupling
    number = {tuple(pair): k for k, pair in enumerate(np.sort(springs.particles, axis=1).tolist())}
    left = np.diag(coupling.own)
    for k, pair in enumerate(springs.particles):
        for q, share in enumerate(coupling.shares[k]):
            if share:
                left[k, number[tuple(sorted((pair[q % 2], coupling.across[k, q // 2])))]] += share
    left *= (WARP / springs.scale)[:, None]
    assert np.abs(left - left.T).max() < 1e-9 * np.abs(left).max()
    assert np.linalg.eigvalsh(left).min() > -1e-9 * np.abs(left).max()
    assert np.linalg.eigvalsh(np.diag(WARP / springs.scale) - left).min() > 0.0


@pytest.mark.parametrize("kind", ["delaunay", pytest.param("one way", marks=pytest.mark.long)])
@pytest.mark.parametrize("degrees", [0, 45, 90])
def test_a_strip_is_as_stiff_as_its_direction(kind, degrees, device):
    """A strip of 4 x 20 cm that hangs with a load along its lower edge, at the defaults."""
    width, height, angle = 0.04, 0.2, np.radians(degrees)
    points, triangles = sheet(kind, width, height, 0.01)
    upright = np.column_stack([points[:, 0], np.zeros(len(points)), points[:, 1]])
    low, top = (np.flatnonzero(np.abs(points[:, 1] - edge) < 1e-9) for edge in (0.0, height))
    force = 2e-3 / compliance(angle) * width
    masses = np.full(len(points), 0.13 * width * height / len(points))
    share = np.where((points[low, 0] < 1e-9) | (points[low, 0] > width - 1e-9), 0.5, 1.0)
    masses[low] += force / G * share / share.sum()
    cloth = Cloth.from_mesh(
        upright, triangles, particle_masses=masses, pins=top.tolist(), damping=5e-3,
        warp=(-np.sin(angle), 0.0, np.cos(angle)), **MODULI,
    )  # fmt: skip
    sim = Simulation(Scene({"it": cloth}), Settings(global_damping=8.0), device)
    for _ in range(90):
        sim.step()
    z = sim.positions("it")[:, 2].astype(float)
    middle = (points[:, 1] > 0.25 * height) & (points[:, 1] < 0.75 * height)
    strain = np.polyfit(points[middle, 1], z[middle], 1)[0] - 1.0
    pull = force + 0.5 * 0.13 * width * height * G
    assert strain * width / pull == pytest.approx(compliance(angle), rel=0.03)


@pytest.mark.parametrize("bending", ["none", "springs", "dihedral"])
def test_a_mesh_that_falls_turning_stays_as_it_is(bending, device):
    """Nothing acts inside a sheet at rest, whichever way it lies."""
    points, triangles = sheet("delaunay", 0.1, 0.1, 0.02)
    flat = np.column_stack([points, np.zeros(len(points))])
    bends = {"bending": bending, "bend_compliance": 1e4}
    cloth = Cloth.from_mesh(flat, triangles, orientation=(0.5, 0.5, 0.1, 0.7), **bends, **MODULI)
    sim = Simulation(Scene({"it": cloth}, gravity=(0, 0, 0)), Settings(), device)
    x = sim.rest_positions("it")
    for _ in range(30):
        sim.step()
    assert np.abs(sim.positions("it") - x).max() < 1e-6


def test_live_stretch_scales_the_membrane_and_live_shear_is_refused():
    points, triangles = sheet("one way", 0.1, 0.1, 0.05)
    cloth = Cloth.from_mesh(np.column_stack([points, np.zeros(len(points))]), triangles, **MODULI)
    sim = Simulation(Scene({"it": cloth}), Settings(), "cpu")
    before = sim.springs("it")["structural"][2]
    sim.set("it.stretch_compliance", 2.0 / WARP)
    assert sim.springs("it")["structural"][2] == pytest.approx(0.5 * before)
    with pytest.raises(ValueError, match="stretch_compliance, which scales both"):
        sim.set("it.shear_compliance", 0.1)
