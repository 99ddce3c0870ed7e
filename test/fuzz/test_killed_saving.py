# SPDX-License-Identifier: Apache-2.0
"""A process that is killed while it saves leaves a whole state, the old one or the new one."""

import random
import signal
import subprocess
import sys
import time

import pytest
from mutation import PATIENCE

from cloth_sim_ros.sim import Cloth, Scene, Simulation

SAVE = """
import sys
from cloth_sim_ros.sim import Cloth, Scene, Simulation
sim = Simulation(Scene({"cloth": Cloth(resolution=(40, 40))}), device="cpu")
while True:
    sim.step()
    sim.save(sys.argv[1])
    print(1, flush=True)
"""


@pytest.mark.parametrize("kills", [3, pytest.param(25, marks=pytest.mark.long)])
def test_what_is_there_is_whole(kills, tmp_path):
    file, rng = tmp_path / "state.npz", random.Random(kills)
    sim = Simulation(Scene({"cloth": Cloth(resolution=(40, 40))}), device="cpu")
    for _ in range(kills):
        with subprocess.Popen([sys.executable, "-c", SAVE, str(file)], stdout=subprocess.PIPE, text=True) as process:
            for line in process.stdout:
                if line.strip().isdigit():  # it has saved once, and goes on
                    break
            time.sleep(rng.uniform(0.0, 0.05))
            process.send_signal(signal.SIGKILL)
            process.wait(PATIENCE)
        sim.load(file)
        assert sim.time > 0.0
        sim.step()
    assert all(each.name == "state.npz" or each.name.endswith(".tmp") for each in tmp_path.iterdir())
