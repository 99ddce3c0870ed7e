# SPDX-License-Identifier: Apache-2.0
"""The direct solve of ropes: elimination is a solve of the matrix, and wild starts recover under any load."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from cloth_sim_ros.sim import Rope, Scene, Settings, Simulation, ropes
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.ropes.arrays import NUMBERS
from cloth_sim_ros.sim.ropes.newton import eliminate

SEGMENTS = 16
LENGTH = 1.0 / SEGMENTS
PLACES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # of the six numbers of a symmetric matrix


@compiled
def solve_rows(first: int, count: int, bends: bool, scratch: wp.array(dtype=wp.float64)):
    eliminate(wp.tid(), 0, 0, first, count, bends, scratch)


def columns():
    """Where the blocks of a row begin, from the layout in rows.h."""
    text = (Path(ropes.__file__).parent / "rows.h").read_text()
    names = re.search(r"enum \{(.*?)\};", re.sub(r"//.*", "", text), re.S)[1]
    found, last = {}, -1
    for name, value in re.findall(r"(\w+)(?: = ([^,]+))?,", names):
        last = last + 1 if not value else sum(int(found.get(part.strip(), part)) for part in value.split("+"))
        found[name] = last
    return found


def symmetric(m):
    return [m[place] for place in PLACES]


@pytest.mark.parametrize("bends", [True, False])
@pytest.mark.parametrize(("first", "count"), [(0, 2), (0, 3), (0, 4), (0, 5), (2, 9), (0, 64), (1, 200)])
def test_the_elimination_solves_the_matrix(device, first, count, bends):
    """Random symmetric blocks, positive as those of masses and springs a million times stiffer."""
    random, at, n = np.random.default_rng(count), columns(), count - first
    rows, matrix, right = np.zeros((count + 3, NUMBERS)), np.eye(3 * n), random.standard_normal((n, 3))
    rows[:, at["DIAGONAL"] : at["DIAGONAL"] + 3] = 1.0
    for reach in (1, 2) if bends else (1,):
        for i in range(reach, n):
            half = random.standard_normal((3, 3))
            block = 1e6 * half @ half.T
            for a, b, sign in ((i, i, 1), (i - reach, i - reach, 1), (i, i - reach, -1), (i - reach, i, -1)):
                matrix[3 * a : 3 * a + 3, 3 * b : 3 * b + 3] += sign * block
            name = "FIRST" if reach == 1 else "SECOND"
            rows[first + i, at[name] : at[name] + 6] = symmetric(-block)
    for i in range(n):
        block = matrix[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        rows[first + i, at["DIAGONAL"] : at["DIAGONAL"] + 6] = symmetric(block)
        rows[first + i, at["RIGHT"] : at["RIGHT"] + 3] = right[i]
    scratch = wp.array(rows.ravel(), dtype=wp.float64, device=device)
    wp.launch(solve_rows, 1 if device == "cpu" else 32, [first, count, bends, scratch], device=device, block_dim=32)
    found = scratch.numpy().reshape(rows.shape)[first:count, at["MOVE"] : at["MOVE"] + 3]
    assert found == pytest.approx(np.linalg.solve(matrix, right.ravel()).reshape(n, 3), rel=1e-6, abs=1e-8)


def heavy_rope(load, compliance):
    """A rope of 1 m and 0.2 kg with `load` times its mass at its end."""
    masses = np.full(SEGMENTS + 1, 0.2 / SEGMENTS)
    masses[[0, -1]] *= 0.5
    masses[-1] += 0.2 * load
    return Rope(
        start=(0, 0, 0), end=(1, 0, 0), segments=SEGMENTS, particle_masses=masses, stretch_compliance=compliance
    )


def wild(name, rest, seed):
    """A start that no rope has."""
    random = np.random.default_rng(seed)
    starts = {
        "let go": rest,
        "random": random.uniform(-0.5, 0.5, rest.shape),
        "stretched": 10.0 * rest,
        "collapsed": 1e-6 * rest,
        "point": 0.0 * rest,
        "mirrored": -rest,
    }
    start = starts[name].copy()
    start[0] = 0.0
    return start


@pytest.mark.parametrize("name", ["let go", "random", "stretched", "collapsed", "point", "mirrored"])
@pytest.mark.parametrize("load", [1.0, 1e2, 1e5])
def test_rigid_ropes_recover_from_any_start(device, load, name):
    for order, (substeps, iterations) in itertools.product((1, 2), ((8, 1), (20, 1), (40, 2))):
        settings = Settings(method="xpbd", order=order, substeps=substeps, iterations=iterations)
        sim = Simulation(Scene(objects={"it": heavy_rope(load, 0.0)}), settings, device=device)
        sim.set_positions("it", wild(name, sim.rest_positions("it").astype(float), seed=int(load)))
        sim.step(120)
        lengths = np.linalg.norm(np.diff(sim.positions("it").astype(float), axis=0), axis=1)
        assert lengths == pytest.approx(np.full(SEGMENTS, LENGTH), rel=0.02), (order, substeps)
        assert sim.report()["it"]["recoveries"] == 0


@pytest.mark.parametrize("name", ["random", "stretched", "collapsed", "mirrored"])
@pytest.mark.parametrize("load", [1.0, 1e2, 1e5])
def test_wild_starts_never_gain_energy(device, load, name):
    compliance = 1e-4
    for order in (1, 2):
        rope = heavy_rope(load, compliance)
        sim = Simulation(Scene(objects={"it": rope}), Settings(method="xpbd", order=order, substeps=20), device=device)
        masses = sim.masses("it")

        def energy(positions, speeds, masses=masses):
            lengths = np.linalg.norm(np.diff(positions, axis=0), axis=1)
            stored = 0.5 / compliance * ((lengths - LENGTH) ** 2 / LENGTH).sum()
            return 0.5 * (masses * (speeds**2).sum(1)).sum() + 9.81 * (masses * positions[:, 2]).sum() + stored

        start = wild(name, sim.rest_positions("it").astype(float), seed=5)
        sim.set_positions("it", start)
        at_start = energy(start, np.zeros_like(start))
        allowed = at_start + 0.01 * (abs(at_start) + 9.81 * masses.sum())
        for _ in range(60):
            sim.step()
            assert energy(sim.positions("it").astype(float), sim.velocities("it").astype(float)) < allowed


@pytest.mark.parametrize(("substeps", "load"), [(1, 1.0), (1, 10.0), (5, 1e3), (20, 1e5), (80, 1e5)])
def test_a_load_on_a_rigid_rope_swings_without_gain_in_one_iteration(device, substeps, load):
    """The light particles turn far under it in a substep: what a linear solve leaves of that must not jerk the load.

    Nor must a micrometre by which the start is not straight, beside which the rounding of any device is small.
    """
    segments = 24
    masses = np.full(segments + 1, 0.2 / segments)
    masses[-1] += 0.2 * load
    rope = Rope(
        start=(0, 0, 0), end=(0.7, 0, -0.7), segments=segments, particle_masses=masses, pins=(0,), stretch_compliance=0
    )
    for order in (1, 2):
        sim = Simulation(
            Scene(objects={"it": rope}), Settings(method="xpbd", order=order, substeps=substeps), device=device
        )
        crooked = np.random.default_rng(1).normal(0.0, 1e-6, (segments + 1, 3)) * (np.arange(segments + 1) > 0)[:, None]
        sim.set_positions("it", sim.positions("it") + crooked)
        start = (masses * sim.positions("it")[:, 2]).sum()
        for _ in range(60):
            sim.step()
            speeds, heights = sim.velocities("it").astype(float), sim.positions("it")[:, 2]
            energy = 0.5 * (masses * (speeds**2).sum(1)).sum() + 9.81 * ((masses * heights).sum() - start)
            assert energy < 1e-3 * 9.81 * masses.sum(), order
            lengths = np.linalg.norm(np.diff(sim.positions("it"), axis=0), axis=1)
            assert lengths == pytest.approx(np.full(segments, 0.7 * 2**0.5 / segments), rel=0.05), order
