# SPDX-License-Identifier: Apache-2.0
"""Bags that are damaged, whole or cut short, and journals of other words, are refused in a sentence or replayed."""

import random
import shutil
import time

import pytest
from mutation import damaged, guarded, reworded, sentence

pytest.importorskip("rclpy")
rosbag2 = pytest.importorskip("rosbags.rosbag2")
from cloth_sim_ros.record.bag import Bag  # noqa: E402
from cloth_sim_ros.record.replay import compared  # noqa: E402

SCENE = """
/**:
  ros__parameters:
    objects: [cloth]
    colliders: [ball]
    cloth: {type: cloth, resolution: [4, 4], pins: corners, position: [0, 0, 1]}
    ball: {shape: sphere, dimensions: [0.1], position: [0, 0, -3]}
"""


MANY, PART = 10_000, 2_500


@pytest.fixture(scope="module")
def bag(ros, tmp_path_factory):
    """Some frames of a small scene."""
    from node_process import NodeProcess
    from recorder_process import Recording

    folder = tmp_path_factory.mktemp("mutated")
    node = NodeProcess(SCENE, (), folder / "node").ready()
    try:
        recording = Recording(folder / "bag")
        recording.wait_for("Recording into ")
        time.sleep(0.3)
        recording.end()
    finally:
        node.end()
    return folder / "bag"


@pytest.mark.parametrize(
    "seeds",
    [range(200), *(pytest.param(range(k, k + PART), marks=pytest.mark.long) for k in range(0, MANY, PART))],
    ids=str,
)
def test_bags(bag, seeds, tmp_path):
    from test_record import copied

    bad, took = tmp_path / "bad", 0
    for seed in seeds:
        rng = random.Random(seed)
        shutil.rmtree(bad, ignore_errors=True)
        if seed % 10 == 0:
            copied(bag, bad, lambda topic, data: reworded_journal(rng, topic, data))  # noqa: B023
        else:
            shutil.copytree(bag, bad)
            file = rng.choice(sorted(bad.iterdir()))
            file.write_bytes(damaged(rng, file.read_bytes()))
            if seed % 3 == 0:
                (bad / "metadata.yaml").unlink()  # as of a recorder that was killed
        with guarded(f"seed {seed}"):
            try:
                read = Bag(bad)
                if seed % 10 == 0:
                    list(compared(read))
                took += 1
            except ValueError as error:
                assert sentence(error), f"seed {seed}: {error!r}"
            except Exception as error:
                raise AssertionError(f"seed {seed}: {type(error).__name__}: {error}") from error
    assert took > 0


def reworded_journal(rng, topic, data):
    """The same message; now and then one of the journal has other words."""
    if "/journal" not in topic or rng.random() < 0.7:
        return data
    text = reworded(rng, data[8:].rstrip(b"\0").decode("utf-8", "replace")).encode("utf-8", "replace") + b"\0"
    return data[:4] + len(text).to_bytes(4, "little") + text
