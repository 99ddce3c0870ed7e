# SPDX-License-Identifier: Apache-2.0
"""Springs solved line by line: each line is what a dense matrix in float64 finds. Lines hold every spring once, and a
hung sheet comes near its equilibrium in few sweeps."""

import numpy as np
import pytest
from fixed_settings import fixed
from minimum import minimum, system_of
from scipy.spatial import Delaunay

from cloth_sim_ros.sim import Cloth, Scene, Simulation
from cloth_sim_ros.sim.topology import build

H = 1e-3
GRAVITY = np.array((0.0, 0.0, -9.81))
UPRIGHT = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))


def mesh(count=60, seed=1, **fields):
    """A sheet of random triangles in the unit square."""
    random = np.random.default_rng(seed)
    points = np.concatenate([random.uniform(0.0, 1.0, (count, 2)), [(0, 0), (1, 0), (0, 1), (1, 1)]])
    triangles = Delaunay(points).simplices
    used = np.unique(triangles)
    place = np.full(len(points), -1)
    place[used] = np.arange(len(used))
    heights = 0.1 * np.sin(5.0 * points[used, :1])
    return Cloth.from_mesh(np.hstack([points[used], heights]), place[triangles], **fields)


def tube(around=12, along=7):
    """A grid rolled into a tube, whose lines around it would close."""
    turn, z = np.meshgrid(np.arange(around), np.arange(along))
    points = np.stack([np.cos(2 * np.pi * turn / around), np.sin(2 * np.pi * turn / around), 0.4 * z], axis=2)
    index = np.arange(around * along).reshape(along, around)
    a, b = index[:-1].ravel(), np.roll(index, -1, axis=1)[:-1].ravel()
    c, d = np.roll(index, -1, axis=1)[1:].ravel(), index[1:].ravel()
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return Cloth.from_mesh(points.reshape(-1, 3), triangles, bending="springs", bend_compliance=1.0)


SHEETS = {
    "grid": Cloth(resolution=(7, 5), bending="springs", bend_compliance=0.1),
    "row": Cloth(resolution=(2, 9), bending="springs", bend_compliance=0.1),
    "threads": Cloth(resolution=(6, 6), shear_compliance=None),
    "mesh": mesh(bending="springs", bend_compliance=0.1),
    "tube": tube(),
}


@pytest.mark.parametrize("kind", SHEETS)
def test_lines_hold_every_spring_once_and_share_no_particle_in_a_family(kind):
    topology = build(SHEETS[kind], "it", True)
    found = {name: np.zeros(len(elements.rest), int) for name, elements in topology.springs.items()}
    for family in topology.families:
        particles, springs = family.particles, family.springs
        held = particles[particles >= 0]
        assert len(np.unique(held)) == len(held)
        assert ((particles[:, 1:] >= 0) <= (particles[:, :-1] >= 0)).all(), "lines have no gaps"
        there = springs >= 0
        np.add.at(found[family.kind], springs[there], 1)
        ends = np.sort(np.stack([particles[:, :-1][there], particles[:, 1:][there]], axis=1), axis=1)
        assert np.array_equal(ends, np.sort(topology.springs[family.kind].particles[springs[there]], axis=1))
    assert all((count == 1).all() for count in found.values())


def test_lines_of_a_grid_are_its_rows_columns_and_diagonals():
    """Seven solves a sweep, with springs over two edges in every second particle."""
    families = build(SHEETS["grid"], "it", True).families
    assert [(f.kind, len(f.particles)) for f in families] == [
        ("bending", 2 * 5), ("bending", 2 * 7), ("shear", 9), ("shear", 9), ("structural", 5), ("structural", 7)
    ]  # fmt: skip


def test_bending_springs_of_a_grid_are_solved_with_the_rows_and_columns_that_they_lie_in():
    """So a substep of a grid has four barriers, and a row finds its own bending springs solved."""
    topology = build(SHEETS["grid"], "it", True)
    assert [[number for number, _ in some] for some in topology.rounds] == [[2], [3], [0, 4], [1, 5]]
    for inner, outer in ((0, 4), (1, 5)):
        rows, lines = topology.families[outer].particles, topology.families[inner].particles
        around = dict(some[0] for some in topology.rounds[2:])[inner]
        for line, row in zip(lines, rows[around], strict=True):
            assert set(line[line >= 0]) <= set(row)
    mesh = build(SHEETS["mesh"], "it", True)
    assert [number for some in mesh.rounds for number, _ in some] == list(range(len(mesh.families)))


def test_a_line_of_a_mesh_goes_straight_on():
    """A grid given as triangles has rows and columns as lines, whatever the order of its springs."""
    grid = build(Cloth(resolution=(6, 6)), "it", True)
    families = build(Cloth.from_mesh(grid.rest, grid.triangles), "it", True).families
    longest = [line[line >= 0] for family in families for line in family.particles if (line >= 0).sum() == 6]
    ways = {tuple(np.unique(np.abs(np.diff(line)))) for line in longest}
    assert ways == {(1,), (6,), (7,)} and len(longest) == 6 + 6 + 1


def dense_substep(topology, x, v, constants, damping, iterations):
    """Velocities (N, 3) after one substep of first-order XPBD. In each family it finds the multipliers of all springs
    at once, by the dense matrix of Macklin, Mueller and Chentanez (2016, eq. 26)."""
    w = np.where(topology.pinned, 0.0, 1.0 / topology.masses)
    d = np.where(topology.pinned[:, None], 0.0, H * v + H * H * GRAVITY)
    gamma = damping / H
    multipliers = {kind: np.zeros(len(elements.rest)) for kind, elements in topology.springs.items()}
    for _ in range(iterations):
        for family in (topology.families[number] for some in topology.rounds for number, _ in some):
            springs = family.springs[family.springs >= 0]
            pairs, rest = topology.springs[family.kind].particles[springs], topology.springs[family.kind].rest[springs]
            alpha = 1.0 / constants[family.kind][springs] / H**2
            e = np.diff((x + d)[pairs], axis=1)[:, 0]
            length, before = np.linalg.norm(e, axis=1), np.linalg.norm(np.diff(x[pairs], axis=1)[:, 0], axis=1)
            jacobian = np.zeros((len(springs), *x.shape))
            rows = np.arange(len(springs))
            jacobian[rows, pairs[:, 1]] = e / length[:, None]
            jacobian[rows, pairs[:, 0]] = -e / length[:, None]
            j = jacobian.reshape(len(springs), -1)
            matrix = (1.0 + gamma) * (j * np.repeat(w, 3)) @ j.T + np.diag(alpha + 1e-5 * w[pairs].sum(axis=1) + 1e-30)
            kept = multipliers[family.kind][springs]
            change = np.linalg.solve(matrix, -(length - rest + alpha * kept + gamma * (length - before)))
            multipliers[family.kind][springs] += change
            d += w[:, None] * (j.T @ change).reshape(-1, 3)
    return d / H


@pytest.mark.parametrize("kind", ["grid", "mesh", "tube"])
@pytest.mark.parametrize(
    ("compliance", "damping", "iterations"), [(1e-3, 0.0, 1), (1e-3, 2e-3, 2), (1e-6, 0.0, 3), (0.0, 0.0, 1)]
)
def test_a_substep_is_what_dense_matrices_find(device, kind, compliance, damping, iterations):
    sheet = SHEETS[kind]
    fields = {"stretch_compliance": compliance, "damping": damping, "pins": (0, 6, 11)}
    if sheet.shear_compliance is not None:
        fields["shear_compliance"] = 3.0 * compliance
    sheet = type(sheet)(**{**vars(sheet), **fields})
    sim = Simulation(Scene({"it": sheet}), fixed(substeps=1, iterations=iterations, frame_dt=H), device=device)
    topology, random = build(sheet, "it", True), np.random.default_rng(3)
    x = topology.rest + 0.01 * random.standard_normal(topology.rest.shape) * (1 if compliance else 0.1)
    v = np.where(topology.pinned[:, None], 0.0, random.standard_normal(x.shape)).astype(np.float32).astype(float)
    sim.set_positions("it", x)
    sim.set_velocities("it", v)
    constants = {name: springs[2] for name, springs in sim.springs("it").items()}
    sim.step()
    wanted = dense_substep(topology, x, v, constants, damping, iterations)
    # Cyclic reduction in float32 loses five digits of a rigid line, to whose diagonal a share of 1e-5 is added.
    within = 3e-4 if compliance or sim.device == "cpu" else 2e-2
    assert np.abs(sim.velocities("it") - wanted).max() < within * np.abs(wanted).max()
    assert np.abs(wanted - v - H * GRAVITY)[~topology.pinned].max() > 0.1 * np.abs(wanted).max(), "springs acted"


@pytest.mark.long
@pytest.mark.parametrize("side", [16, 32, 64])
@pytest.mark.parametrize(("iterations", "within"), [(1, 0.1), (4, 0.03)])
def test_a_hung_sheet_is_as_long_as_its_springs_make_it(device, side, iterations, within):
    """Mean strain along the fall at rest against the float64 minimum nearby: hung sheets buckle, each in its way.

    Beside the corners of 64 x 64, families move particles by more than the spacing. They shook there at 2.8 m/s.
    """
    sheet = Cloth(resolution=(side, side), orientation=UPRIGHT)
    sim = Simulation(Scene({"it": sheet}), fixed(iterations=iterations, global_damping=5.0), device=device)
    sim.step(240)
    assert np.linalg.norm(sim.velocities("it"), axis=1).max() < 0.1
    x = sim.positions("it").astype(float)
    system = system_of(sim)
    exact = minimum(system, x)
    pairs = sim.springs("it")["structural"][0]
    falls = np.flatnonzero(pairs[:, 1] - pairs[:, 0] == side)
    found, wanted = (system.strains(at)[falls].mean() for at in (x, exact))
    assert wanted > 5e-4 and found == pytest.approx(wanted, rel=within)
