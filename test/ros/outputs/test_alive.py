# SPDX-License-Identifier: Apache-2.0
"""A node that is paused is told from one that is dead, by the deadline of /diagnostics."""

import signal

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from node_process import SMALL
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile
from std_srvs.srv import SetBool


@pytest.mark.long
def test_a_paused_node_keeps_the_deadline_and_a_dead_one_misses_it(start, client):
    node = start(SMALL).wait_for("all kernels are compiled")
    said, missed = [], []
    client.node.create_subscription(
        DiagnosticArray,
        "/diagnostics",
        said.append,
        QoSProfile(depth=10, deadline=Duration(seconds=10.0)),  # more than what is offered, for a busy machine
        event_callbacks=SubscriptionEventCallbacks(deadline=missed.append),
    )
    assert client.call(SetBool, "/cloth_sim/pause", SetBool.Request(data=True)).success
    client.until(lambda: sum(each.status[0].message == "paused" for each in said) > 3)
    assert not missed
    node.process.send_signal(signal.SIGSTOP)  # it still holds the topic, but does nothing
    client.until(lambda: missed)
    node.process.send_signal(signal.SIGCONT)
    count = len(said)
    client.until(lambda: len(said) > count)
    node.process.kill()
    count = len(missed)
    client.until(lambda: len(missed) > count)
