# SPDX-License-Identifier: Apache-2.0
"""The demonstration's measure of how old messages are."""

import subprocess
import sys

import pytest
from node_process import ROOT, SMALL
from patience import patience

from cloth_sim_ros.demo import latency


@pytest.mark.long
def test_latency_counts_every_topic_and_what_is_lost(tmp_path):
    config = tmp_path / "small.yaml"
    config.write_text(SMALL)
    command = [sys.executable, "-m", "cloth_sim_ros.demo.latency", "--config", str(config)]
    command += ["--seconds", "3", "--set", "rate:=30.0"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=patience(120))
    assert done.returncode == 0, done.stderr
    assert 0.0 < float(done.stdout.removeprefix("first message ").split()[0]) < 120.0
    for topic in ("cloth/particles", "cloth/mesh", "rope/particles", "rope/mesh"):
        row = next(line for line in done.stdout.splitlines() if topic in line).split()
        assert 20 < int(row[1]) < 130 and 0.0 < float(row[3]) <= float(row[4]) <= float(row[5])


def test_what_lacks_is_lost():
    told = [latency.Told(10.0, 9, 1.0, 0.5, 1.0), latency.Told(12.0, 20, 1.0, 0.5, 1.0)]
    stamps = [10.0 + (k + 1) / 10 for k in range(20)]
    arrived = {"whole": [(s, s + 0.002) for s in stamps], "torn": [(s, s + 0.004) for s in stamps if round(10 * s) % 5]}
    rows = [line.split() for line in latency.table(arrived, told).splitlines()[2:]]
    assert rows == [["whole", "20", "0", "2.00", "2.00", "2.00"], ["torn", "16", "4", "4.00", "4.00", "4.00"]]
