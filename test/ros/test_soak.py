# SPDX-License-Identifier: Apache-2.0
"""Listeners of every topic, and whole participants, come and go for a while: the node's memory stays as it is.

SOAK_MINUTES says for how long; 60 is the length that a release is tried with.
"""

import itertools
import os
import re
import time
from pathlib import Path

import pytest
import rclpy
from node_process import SMALL
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import Trigger
from test_garbage import made

MINUTES = float(os.environ.get("SOAK_MINUTES", "2"))
SETTLED = 1 / 6  # of the time, after which memory may grow no more
GROWTH = 1.01  # at most, from then on


def memory(process):
    """Resident memory of a process [MB]: all of it, and what is neither of files nor shared."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    return tuple(int(re.search(rf"{what}:\s+(\d+)", status)[1]) / 1e3 for what in ("VmRSS", "RssAnon"))


@pytest.mark.long
def test_memory_stays_while_listeners_come_and_go(start, client, capsys):
    node = start(SMALL).wait_for("all kernels are compiled")
    client.until(
        lambda: "cloth_sim" in client.node.get_node_names() and client.node.count_publishers("/cloth_sim/journal")
    )
    given = dict(client.node.get_publisher_names_and_types_by_node("cloth_sim", "/"))
    topics = {
        topic: type(made(kinds[0].replace("/msg/", "/")))
        for topic, kinds in given.items()
        if topic.startswith("/cloth_sim/")
    }
    assert len(topics) > 5
    begin, told, figures = time.monotonic(), -1, []
    for turn in itertools.count():
        minutes = (time.monotonic() - begin) / 60
        if int(minutes) > told or minutes >= MINUTES:
            told = int(minutes)
            resident, own = memory(node.process)
            figures.append((minutes, resident))
            with capsys.disabled():
                print(f"\n{minutes:.1f} min: {resident:.2f} MB, {own:.2f} of its own", flush=True)
        if minutes >= MINUTES:
            break
        heard = []
        for topic, kind in topics.items():
            listener = client.node.create_subscription(kind, topic, heard.append, 1)
            client.spin(0.2)
            client.node.destroy_subscription(listener)
        assert heard
        client.move("ball", (0.0, 0.0, -5.0 - 0.1 * (turn % 2)))
        assert client.call(Trigger, "/cloth_sim/reset").success and node.alive()
        foreign(topics)
    settled = max(1.5, SETTLED * MINUTES)
    sizes = [[size for minutes, size in figures if (minutes <= settled) == early] for early in (True, False)]
    assert max(sizes[1]) < GROWTH * max(sizes[0]), figures
    assert "Traceback" not in node.log


def foreign(topics):
    """A participant of its own comes, listens to all topics until something is heard on one, and goes."""
    context, heard = rclpy.Context(), []
    context.init()
    try:
        node, executor = rclpy.create_node("visitor", context=context), SingleThreadedExecutor(context=context)
        executor.add_node(node)
        for topic, kind in topics.items():
            node.create_subscription(kind, topic, heard.append, 10)
        end = time.monotonic() + 60.0
        while not heard:
            assert time.monotonic() < end, "it hears nothing"
            executor.spin_once(timeout_sec=0.1)
        executor.shutdown()
        node.destroy_node()
    finally:
        context.try_shutdown()
