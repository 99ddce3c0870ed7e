"""Peers run the same springs: at the same substeps and converged, first-order methods leave the same error."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Settings
from cloth_sim_ros.study import norms
from cloth_sim_ros.study.cases import BODY, CASES
from cloth_sim_ros.study.contenders import Run
from cloth_sim_ros.study.exact import reference
from cloth_sim_ros.study.peers import PEERS, Peer, colours

CASE, RESOLUTION, SUBSTEPS = CASES["clamped_sheet"], 8, 40


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer.label)
def test_a_peer_leaves_the_error_of_implicit_euler(peer):
    pytest.importorskip(peer.package)
    exact = reference(CASE, RESOLUTION, CASE.constant)
    frames, times = peer.simulate(Run(CASE, RESOLUTION, CASE.constant, "cpu", SUBSTEPS, 10))
    sim = CASE.simulation(RESOLUTION, CASE.constant, Settings(substeps=SUBSTEPS, iterations=10), "cpu")
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


def test_no_spring_joins_particles_of_one_colour():
    system, _ = CASES["clamped_sheet"].system(9, 1e3)
    groups = colours(system)
    colour = np.empty(len(system.masses), dtype=int)
    for k, group in enumerate(groups):
        colour[group] = k
    assert sorted(np.concatenate(groups)) == list(range(len(colour)))
    assert (colour[system.pairs[:, 0]] != colour[system.pairs[:, 1]]).all()
    assert len(groups) <= 1 + np.bincount(system.pairs.ravel()).max()
