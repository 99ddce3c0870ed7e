"""Cells of a grid: every spring once, no particle twice in a pass, records that say so."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Cloth, Scene, Settings, Simulation
from cloth_sim_ros.sim.batch import forced_schedule
from cloth_sim_ros.sim.cells import (
    ALONE,
    BANKS,
    DIAGONALS,
    DOUBLED,
    EMPTY,
    FAR,
    HAS_DIAGONALS,
    HAS_SIDES,
    INDEX,
    ODD,
    PAIRS,
    SIDES,
    TURNED,
    Pass,
    lengths,
    passes,
)
from cloth_sim_ros.sim.schedules import coloured, coloured_kernels
from cloth_sim_ros.sim.topology import build

SHAPES = [(2, 2), (2, 9), (3, 2), (3, 3), (5, 5), (6, 5), (8, 8), (31, 17)]


def springs_of(one: Pass, grid_lengths) -> dict[tuple[str, int, int], tuple[float, float]]:
    """What the device makes of a pass: (kind, i, j) -> rest length and scale, from its records alone."""
    found = {}
    for record in one.records(odd=False, width=4):
        if record[3] == EMPTY:  # there to fill up
            continue
        assert [record[1] >> flag & 1 for flag in (HAS_SIDES, HAS_DIAGONALS, FAR)] == [
            bool(one.holds & SIDES),
            bool(one.holds & DIAGONALS),
            one.kind == "bending",
        ]
        particles = [*(record[:2] & ((1 << INDEX) - 1)), *record[2:]]
        has = {flag: record[0] >> flag & 1 for flag in (ALONE, TURNED, *range(DOUBLED, DOUBLED + 4))}
        for q, (a, b) in enumerate(PAIRS):
            absent = (q > 1 and has[ALONE]) or (q == 1 and particles[0] == particles[2])
            if absent or not one.holds & (SIDES if q < 4 else DIAGONALS):
                continue
            rest = grid_lengths[1 if q < 2 and has[TURNED] else q // 2] * (2.0 if one.kind == "bending" else 1.0)
            key = (one.kind if q < 4 else "shear", *sorted((int(particles[a]), int(particles[b]))))
            assert key not in found
            found[key] = (rest, 1.0 + (q < 4 and has[DOUBLED + q]))
    return found


@pytest.mark.parametrize("shear", [1e-3, None])
@pytest.mark.parametrize("resolution", SHAPES)
def test_cells_hold_every_spring_once(resolution, shear):
    cloth = Cloth(resolution=resolution, size=(1.0, 1.5), shear_compliance=shear, bend_compliance=1.0)
    topology = build(cloth, "cloth", True)
    found = {}
    for one in passes(topology):
        mine = springs_of(one, lengths(topology))
        assert not found.keys() & mine.keys()
        found |= mine
    wanted = {
        (kind, *sorted(pair)): (rest, scale)
        for kind, e in topology.springs.items()
        for pair, rest, scale in zip(e.particles.tolist(), e.rest, e.scale, strict=True)
    }
    assert found.keys() == wanted.keys()
    for key, numbers in found.items():
        assert numbers == pytest.approx(wanted[key], rel=1e-12)


@pytest.mark.parametrize("resolution", SHAPES)
def test_cells_of_a_pass_share_no_particle(resolution):
    for one in passes(build(Cloth(resolution=resolution, bend_compliance=1.0), "cloth", True)):
        twice = one.particles[:, 0] == one.particles[:, 2]
        used = np.concatenate([one.particles[~twice].ravel(), one.particles[twice, :2].ravel()])
        assert len(np.unique(used)) == len(used)


@pytest.mark.parametrize("width", [1, 64])
def test_a_block_sees_the_end_of_a_pass(width):
    """Whole rounds of a block, and the mark of each in another pass than the one before."""
    found = passes(build(Cloth(resolution=(9, 7), bend_compliance=1.0), "cloth", True))
    for n, one in enumerate(found):
        records = one.records(n % 2 == 1, width)
        assert len(records) % width == 0
        assert (records[:, 1] >> ODD & 1 == n % 2).all()


@pytest.mark.parametrize("side", [16, 22])
def test_cells_beside_one_another_rarely_meet_in_a_bank(side):
    """Each eight threads read each of their corners in one turn, or in as many as most of them meet in."""
    turns, fewest = 0, 0
    for one in passes(build(Cloth(resolution=(side, side), bend_compliance=1.0), "cloth", True)):
        records = one.records(False, 8).reshape(-1, 8, 4)
        for eight in records:
            there = eight[eight[:, 3] != EMPTY] & ((1 << INDEX) - 1)
            turns += sum(np.bincount(np.unique(corner) % BANKS).max() for corner in there.T)
            fewest += 4
    assert turns < 1.4 * fewest


def test_a_grid_takes_six_passes():
    sizes = [len(one.particles) for one in passes(build(Cloth(resolution=(64, 64), bend_compliance=1.0), "c", True))]
    assert len(sizes) == 6
    assert max(sizes) <= 1024


@pytest.mark.parametrize("resolution", SHAPES)
def test_cells_side_by_side_move_like_one_by_one(resolution, device):
    """Any dashpot, however weak, takes the way of every case, a cell at a time."""
    found = []
    for damping in (0.0, 1e-15):
        cloth = Cloth(resolution=resolution, size=(1.0, 1.5), bend_compliance=1.0, pins="top", damping=damping)
        sim = Simulation(Scene(objects={"it": cloth}), Settings(substeps=10), device=device)
        x = sim.positions("it")
        sim.set_positions("it", x + np.random.default_rng(4).normal(0.0, 0.01, x.shape))
        sim.step()
        found.append(sim.positions("it"))
    assert np.abs(found[0] - x).max() > 1e-3
    assert np.abs(found[0] - found[1]).max() < 2e-6


@pytest.mark.parametrize(
    "settings", [{"iterations": 1, "order": 1}, {"iterations": 3, "order": 1}, {"iterations": 2, "order": 2}]
)
@pytest.mark.parametrize("damping", [0.0, 0.002])
def test_eight_at_a_time_are_projected_as_one_by_one(settings, damping, monkeypatch):
    cloth = Cloth(resolution=(9, 8), pins="corners", shear_compliance=3e-3, bend_compliance=0.1, damping=damping)

    def run():
        with forced_schedule("coloured"):
            sim = Simulation(Scene({"it": cloth}), Settings(**settings, substeps=5), "cpu")
        sim.set_velocities("it", np.random.default_rng(3).normal(size=(72, 3)))
        sim.step(3)
        return sim.positions("it"), sim.report()["it"]["residual"]

    together, left = run()
    monkeypatch.setattr(coloured, "LANES", 1)
    monkeypatch.setattr(
        coloured, "make_kernels", lambda features, lanes: coloured_kernels.make_kernels(features, False)
    )
    alone, left_alone = run()
    assert not np.array_equal(together, alone)  # other arithmetic, or nothing is compared
    assert np.abs(together - alone).max() < 3e-6
    assert left == pytest.approx(left_alone, rel=1e-2)
