# SPDX-License-Identifier: Apache-2.0
"""Candidates on a cluster: the same bits as in one process, also where a worker is killed in the middle."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest
from test_identify import FIT, GUESS, SETTINGS, drawn, record, scene

from cloth_sim_ros.identify.candidates import Candidates
from cloth_sim_ros.identify.fit import identify

ray = pytest.importorskip("ray")
from cloth_sim_ros.identify.cluster import Spread, _join  # noqa: E402 (only where there is ray)

WORLDS = 4
WORKERS = 2


@pytest.fixture
def cluster(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))
    ray.init(address="local", num_cpus=WORKERS, num_gpus=0, include_dashboard=False, log_to_driver=False)
    yield
    ray.shutdown()


def own_workers():
    """The ids of processes that compute, which this one has started."""
    parents, names = {}, {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            names[int(folder.name)] = (folder / "cmdline").read_bytes()
            parents[int(folder.name)] = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
        except OSError:
            continue
    found = []
    for process, name in names.items():
        above = process
        while above in parents and above != os.getpid():
            above = parents[above]
        if name.startswith(b"ray::_run") and above == os.getpid():
            found.append(process)
    return found


@pytest.mark.long
@pytest.mark.usefixtures("cluster")
def test_workers_find_the_same_as_one_process_also_when_one_is_killed():
    recording = record(drawn(15), "cpu", noise=0.002, seen="shuffled", frames=20)
    given = (scene(GUESS), SETTINGS, recording, FIT[:2], WORLDS, "cpu")
    alone = identify(Candidates(*given))[1]
    spread, killed = Spread("local", *given), []

    def kill_one(frames):
        if frames > 4 * spread.length and not killed:
            for process in own_workers()[:1]:  # none between two batches
                os.kill(process, signal.SIGKILL)
                killed.append(process)

    spread.told = kill_one
    found = identify(spread)[1]
    assert killed, "one of two workers was at work, and was killed"
    for field in ("units", "values", "low", "high", "felt", "alike"):
        assert np.array_equal(getattr(found, field), getattr(alone, field)), field


def test_a_cluster_that_is_not_there_is_one_sentence():
    with pytest.raises(ValueError, match="there is no cluster at '127.0.0.1:1': .*; allowed is 'local' or HOST:PORT"):
        _join("127.0.0.1:1")
