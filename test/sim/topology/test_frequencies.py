# SPDX-License-Identifier: Apache-2.0
"""The fastest mode of springs: what is read off a table for random stiffnesses gives the same substeps as a power
iteration of its own, and NumPy's eigenvalues."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Cloth
from cloth_sim_ros.sim.engine.bodies import distinct
from cloth_sim_ros.sim.substeps.limits import explicit_substeps
from cloth_sim_ros.sim.topology import KINDS, build

SHEETS = {
    "hung": Cloth(resolution=(12, 9), pins="top"),
    "edges": Cloth(resolution=(9, 9), pins="edges"),
    "springs": Cloth(resolution=(8, 8), bend_compliance=1e-2, bending="springs"),
    "plate": Cloth(resolution=(8, 8), bend_compliance=1e2, bending="dihedral"),
    "heavy": Cloth(resolution=(7, 8), pins=None, particle_masses=np.random.default_rng(1).uniform(1e-3, 1e-2, 56)),
}


def stiffness(topology, constants):
    """K (3N, 3N) of springs of these constants at rest."""
    count = len(topology.masses)
    found = np.zeros((count, 3, count, 3))
    for constant, elements in zip(constants, topology.springs.values(), strict=True):
        for (i, j), scale in zip(elements.particles, elements.scale * np.ones(len(elements.rest)), strict=True):
            n = topology.rest[j] - topology.rest[i]
            block = constant / scale * np.outer(n, n) / (n @ n)
            for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
                found[a, :, b] += sign * block
    return found.reshape(3 * count, 3 * count)


@pytest.mark.parametrize("name", SHEETS)
@pytest.mark.parametrize("crumples", [False, True], ids=["rest", "wind"])
def test_random_materials_take_the_substeps_of_a_power_iteration_of_their_own(name, crumples):
    """A topology that has just been built iterates for its first material, one that has seen many interpolates."""
    random, old = np.random.default_rng(2), build(SHEETS[name], "it", False)
    for _ in range(60):
        compliance, damping = np.exp(random.uniform(np.log(1e-5), 0.0, 3)), random.uniform(0.0, 2e-3)
        alone = build(SHEETS[name], "it", False)
        assert explicit_substeps(old, compliance, damping, 1 / 60, crumples) == explicit_substeps(
            alone, compliance, damping, 1 / 60, crumples
        )


@pytest.mark.parametrize("name", ["hung", "edges", "heavy"])
def test_the_table_is_as_exact_as_it_says(name):
    random, topology = np.random.default_rng(3), build(SHEETS[name], "it", False)
    found = topology.frequencies(False)
    inverse = np.repeat(np.where(topology.pinned, 0.0, 1.0 / topology.masses), 3)
    for k in range(40):
        constants = tuple(np.exp(random.uniform(0.0, 8.0, len(topology.springs))))
        value, margin = found.near(constants)
        assert abs(value / found.exact(constants) - 1.0) <= margin
        if k % 4:
            continue  # the next takes long
        largest = np.linalg.eigvalsh(np.sqrt(inverse)[:, None] * stiffness(topology, constants) * np.sqrt(inverse))[-1]
        assert 0.8 * largest < value < 1.2 * largest, "a power iteration of 60 steps is near the largest eigenvalue"
    assert len(KINDS) >= len(topology.springs) == 2


@pytest.mark.parametrize("kinds", [1, 5, 16, 17, 400])
def test_distinct_materials_are_those_of_a_set_or_the_stiffest(kinds):
    random = np.random.default_rng(4)
    rows = np.zeros(400, dtype=[("compliance", np.float32, 3), ("damping", np.float32)])
    chosen = np.arange(400) % kinds
    rows["compliance"] = random.uniform(1, 2, (kinds, 3))[chosen]
    rows["damping"] = random.integers(0, 3, kinds)[chosen]
    pairs = {(tuple(c), d) for c, d in zip(rows["compliance"].tolist(), rows["damping"].tolist(), strict=True)}
    if kinds > 16:
        pairs = {(tuple(rows["compliance"].min(axis=0).tolist()), float(rows["damping"].max()))}
    assert distinct(rows) == pairs


@pytest.mark.parametrize("compliance", [(1e-300, 1e-3, 1e-2), (1e-3, 1e-310, 1e-2), (1e-101, 1e-101, 1e-101)])
def test_springs_of_any_stiffness_have_their_substeps_without_a_warning(compliance, recwarn):
    """Their squares are no float64, and no explicit step is short enough for them."""
    assert explicit_substeps(build(SHEETS["springs"], "it", False), compliance, 0.0, 1 / 60, False) == np.inf
    assert not recwarn.list
