# SPDX-License-Identifier: Apache-2.0
"""Recorders that are killed while they write, and those whose disk is full: what is there is replayed to the same bits.

A server forks recorders with all modules loaded, so that a hundred of them take no hundred starts of Python.
"""

import multiprocessing
import os
import random
import resource
import struct

import pytest
from node_process import SMALL
from patience import tries

pytest.importorskip("rosbags")
from cloth_sim_ros.record import recorder  # noqa: E402
from cloth_sim_ros.record.bag import Bag  # noqa: E402
from cloth_sim_ros.record.replay import SAME, compared  # noqa: E402

AT_ONCE = 5
MAGIC, HEAD = b"\x89MCAP0\r\n", struct.Struct("<BQ")  # of a file of MCAP, and of each of its records


def record(bag, most):
    """A recorder, in a process whose files have at most so many bytes."""
    os.dup2(os.open(bag.with_suffix(".txt"), os.O_CREAT | os.O_WRONLY), 2)
    begin = recorder.Recorder.__init__

    def limited(self, *given):
        begin(self, *given)  # which needs shared memory, and that counts as files
        if most:
            resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    recorder.Recorder.__init__ = limited
    raise SystemExit(recorder.main([str(bag)]))


@pytest.fixture(scope="module", autouse=True)
def without_shared_memory():
    """Fast DDS shares memory with locks and ports in it, which a killed process leaves to the next one as they are."""
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
        yield


@pytest.fixture(scope="module")
def started(without_shared_memory):
    """started(bag, most=0) -> the process of a recorder."""
    server = multiprocessing.get_context("forkserver")
    server.set_forkserver_preload(["cloth_sim_ros.record.recorder", "rosbags.rosbag2", "test_killed_recordings"])
    processes = []

    def start(bag, most=0):
        processes.append(server.Process(target=record, args=(bag, most)))
        processes[-1].start()
        return processes[-1]

    yield start
    for process in processes:
        process.kill()
        process.join()


def beyond(bag):
    """Bytes of a bag on the disk beyond its first chunk, of a second or so; below 0 while that is not whole."""
    files = list(bag.glob("*.mcap"))
    data, end = files[0].read_bytes() if files else b"", len(MAGIC)
    for _ in ("header", "chunk"):
        if len(data) < end + HEAD.size:
            return -1
        end += HEAD.size + HEAD.unpack_from(data, end)[1]
    return len(data) - end


def same_bits(bag):
    """The number of clouds of an unfinished bag that a replay gives to the same bits; fails where any differ.

    What came last on one topic may lack what another had before it, as the start that a new listener gets: it is told
    as lost, or as no cloud.
    """
    read = Bag(bag)
    assert read.cut_short
    sentences = [sentence for *_, sentence in compared(read)]
    assert not any("differ" in sentence for sentence in sentences), sentences
    return sentences.count(SAME)


@pytest.mark.parametrize(
    ("kills", "seed"), [(AT_ONCE, 0), *(pytest.param(25, seed, marks=pytest.mark.long) for seed in range(1, 5))]
)
def test_a_killed_one_is_replayed_up_to_there(kills, seed, start, started, tmp_path):
    start(SMALL).wait_for("all kernels are compiled")
    chance, replayed = random.Random(seed), 0
    for first in range(0, kills, AT_ONCE):
        bags = [tmp_path / f"bag{first + k}" for k in range(AT_ONCE)]
        running = {bag: (started(bag), chance.choice((-1, 0, 1, 60_000, 150_000))) for bag in bags}
        for _ in tries(60.0, pause=0.002):
            for bag in [bag for bag, (_, enough) in running.items() if beyond(bag) >= enough and any(bag.glob("*"))]:
                running.pop(bag)[0].kill()  # at once, as it writes just now
            if not running:
                break
        assert not running, "they write"
        for bag in bags:
            try:
                replayed += same_bits(bag) > 0
            except ValueError as why:  # no chunk is whole, or only one from before the journal's start
                assert str(why).startswith(f"{bag} ") and beyond(bag) < 100_000, why
    assert replayed > kills // 2


@pytest.mark.long
@pytest.mark.parametrize("most", [800_000, 1_000_001])
def test_one_whose_disk_is_full_is_replayed_up_to_there(most, start, started, tmp_path):
    start(SMALL).wait_for("all kernels are compiled")
    bag = tmp_path / "bag"
    process = started(bag, most)
    process.join(60.0)
    assert process.exitcode == 1 and f"{bag} cannot be written: " in bag.with_suffix(".txt").read_text()
    assert same_bits(bag) > 0
