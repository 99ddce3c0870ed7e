# SPDX-License-Identifier: Apache-2.0
"""A process that is killed while it saves leaves a whole state, the old one or the new one."""

import multiprocessing
import random
import time

import pytest
from mutation import PATIENCE

from cloth_sim_ros.sim import Cloth, Scene, Simulation


def save(sim, file, saved):
    """Saves in each frame, and tells when it has done so once."""
    while True:
        sim.step()
        sim.save(file)
        saved.set()


@pytest.mark.parametrize("kills", [3, pytest.param(100, marks=pytest.mark.long)])
def test_what_is_there_is_whole(kills, tmp_path):
    fork = multiprocessing.get_context("fork")  # so that no process loads and compiles anything
    sim = Simulation(Scene({"cloth": Cloth(resolution=(40, 40))}), device="cpu")
    sim.step()
    file, rng = tmp_path / "state.npz", random.Random(kills)
    for _ in range(kills):
        saved = fork.Event()
        process = fork.Process(target=save, args=(sim, file, saved))
        process.start()
        assert saved.wait(PATIENCE)
        time.sleep(rng.uniform(0.0, 0.05))
        process.kill()
        process.join()
        sim.load(file)
        assert sim.time > 0.0
        sim.step()
    assert all(each.name == "state.npz" or each.name.endswith(".tmp") for each in tmp_path.iterdir())
