# SPDX-License-Identifier: Apache-2.0
"""Peers run the same springs: at the same substeps and converged, first-order methods leave the same error."""

import dataclasses

import numpy as np
import pytest

from cloth_sim_ros.sim import Settings
from cloth_sim_ros.study import norms
from cloth_sim_ros.study.cases import BODY, CASES
from cloth_sim_ros.study.contenders import CONTENDERS, Run
from cloth_sim_ros.study.exact import reference
from cloth_sim_ros.study.other_models import OTHER_MODELS, limit
from cloth_sim_ros.study.peers import PEERS, Peer, colours

CASE, RESOLUTION, SUBSTEPS = CASES["clamped_sheet"], 8, 40


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer.label)
def test_a_peer_leaves_the_error_of_implicit_euler(peer):
    pytest.importorskip(peer.package)
    exact = reference(CASE, RESOLUTION, CASE.constant)
    frames, times = peer.simulate(Run(CASE, RESOLUTION, CASE.constant, "cpu", SUBSTEPS, 10))
    sim = CASE.simulation(
        RESOLUTION, CASE.constant, Settings(method="xpbd", order=1, substeps=SUBSTEPS, iterations=10), "cpu"
    )
    own = [sim.positions(BODY)]
    for _ in range(CASE.frames):
        sim.step()
        own.append(sim.positions(BODY))
    theirs = norms.error(exact.system, frames, exact.frames).position
    assert theirs == pytest.approx(norms.error(exact.system, np.array(own), exact.frames).position, rel=0.1)
    assert len(times) == CASE.frames
    assert (times > 0.0).all()


def test_a_peer_that_cannot_stand_in_the_figure_is_named():
    missing = Peer("Nobody", "no_such_package", PEERS[0].simulate, on_gpu=True)
    assert "Nobody is left out" in missing.why_not("cpu")
    assert "no_such_package" in missing.why_not("cpu")
    there = Peer("CPU only", "numpy", PEERS[0].simulate, on_gpu=False)
    assert there.why_not("cpu") == ""
    assert "CPU alone" in there.why_not("cuda:0")
    gpu = Peer("GPU only", "numpy", PEERS[0].simulate, on_gpu=True, on_cpu=False, worlds=False)
    assert "made for GPUs" in gpu.why_not("cpu")
    assert gpu.why_not("cuda:0") == ""
    assert "one world at a time" in gpu.why_not("cuda:0", 2)


@pytest.mark.long
@pytest.mark.parametrize("runs", [*PEERS, *OTHER_MODELS, *CONTENDERS], ids=lambda runs: runs.label)
def test_the_first_of_many_worlds_moves_as_one_alone(runs):
    if isinstance(runs, Peer):
        pytest.importorskip(runs.package)
        if runs.why_not("cpu", 3):
            pytest.skip(runs.why_not("cpu", 3))
    elif not runs.takes(CASE, 3):
        assert runs.numpy, "only what is written in NumPy knows one world alone"
        return
    run = Run(CASE.lasting(5 / 60), RESOLUTION, CASE.constant, "cpu", SUBSTEPS, 2)
    alone, many = (runs.simulate(dataclasses.replace(run, worlds=worlds))[0] for worlds in (1, 3))
    assert np.isfinite(alone).all() and np.abs(alone[-1] - alone[0]).max() > 1e-3
    assert np.abs(many - alone).max() < 1e-6


def test_no_spring_joins_particles_of_one_colour():
    system, _ = CASES["clamped_sheet"].system(9, 1e3)
    groups = colours(system)
    colour = np.empty(len(system.masses), dtype=int)
    for k, group in enumerate(groups):
        colour[group] = k
    assert sorted(np.concatenate(groups)) == list(range(len(colour)))
    assert (colour[system.pairs[:, 0]] != colour[system.pairs[:, 1]]).all()
    assert len(groups) <= 1 + np.bincount(system.pairs.ravel()).max()


def test_a_limit_is_where_runs_draw_no_nearer():
    """A method of first order that blows up below 20 substeps and whose rounding grows with their number."""
    start, way = np.zeros((4, 3)), np.ones((4, 3))

    def simulate(run):
        error = (
            1e9 if run.substeps < 20 else 1.0 / run.substeps + (-1.0) ** run.substeps.bit_length() * 3e-5 * run.substeps
        )
        return np.stack([start, (1.0 + error) * way]), np.ones(1)

    found = limit(simulate, Run(CASE, RESOLUTION, CASE.constant, "cpu", 1, 2), 5000)
    assert (found.substeps, found.iterations) == (160, 2)
    assert 1e-3 < found.known < 2e-2
    assert found.judges(80, 2) and found.judges(160, 1) and not found.judges(160, 2) and not found.judges(320, 1)
    assert limit(simulate, Run(CASE, RESOLUTION, CASE.constant, "cpu", 1, 2), 100).substeps == 40


@pytest.mark.parametrize("peer", OTHER_MODELS, ids=lambda peer: peer.label)
def test_another_model_converges_and_hangs_as_low_as_springs(peer):
    pytest.importorskip(peer.package)
    if not peer.on_cpu:
        pytest.skip(peer.why_not("cpu"))
    first = 6 if peer.iterates else 20  # Style3D's rounding takes over beyond 24, flex blows up below 20
    runs = [Run(CASE, RESOLUTION, CASE.constant, "cpu", substeps, 4) for substeps in (first, 2 * first, 4 * first)]
    coarse, middle, fine = (peer.simulate(run)[0] for run in runs)
    assert norms.rms(fine - middle) < 0.7 * norms.rms(middle - coarse)
    exact = reference(CASE, RESOLUTION, CASE.constant)
    assert fine[:, :, 2].min() == pytest.approx(exact.frames[:, :, 2].min(), rel=0.4)
