# SPDX-License-Identifier: Apache-2.0
"""Nothing is computed or copied for what nobody subscribes to: counted in a node in this process."""

from collections import Counter

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker

from cloth_sim_ros.sim import Readback, Simulation

PARAMETERS = {
    "objects": ["cloth"],
    "cloth.type": "cloth",
    "cloth.resolution": [6, 5],
    "cloth.position": [0.0, 0.0, 2.0],
    "publish.velocities": True,
}


@pytest.fixture
def counted(monkeypatch):
    """How often each was called since the last clear()."""
    counts = Counter()

    def count(owner, name, key):
        method = getattr(owner, name)

        def counting(self, *arguments, **named):
            counts[key(self)] += 1
            return method(self, *arguments, **named)

        monkeypatch.setattr(owner, name, counting)

    count(Simulation, "step", lambda sim: "frames")
    count(Simulation, "report", lambda sim: "reports")
    count(Readback, "request", lambda readback: f"copies of {readback._particles.view.shape[1]} columns")
    return counts


@pytest.fixture
def node(ros, counted, client):
    """A node that simulates, spun by the client's executor."""
    from rclpy.parameter import Parameter

    from cloth_sim_ros.ros.node import ClothSimNode

    overrides = [Parameter(name, value=value) for name, value in PARAMETERS.items()]
    made = ClothSimNode(parameter_overrides=overrides)
    executor = SingleThreadedExecutor()
    executor.add_node(made)
    yield lambda: executor.spin_once(timeout_sec=0.0)
    assert made.stop()
    executor.shutdown()
    made.destroy_node()


def frames(client, node, counted, count, but=()):
    """What is counted in about `count` frames, once what follows from the change before has settled."""
    for _ in range(2):
        counted.clear()
        client.until(lambda: counted["frames"] >= count, timeout=90.0, meanwhile=node)
    return dict(counted)


@pytest.mark.long
def test_nobody_listens_and_frames_alone_are_computed(client, node, counted):
    alone = frames(client, node, counted, 60)
    assert set(alone) <= {"frames", "reports"} and alone.get("reports", 0) <= 1, alone

    mesh = client.node.create_subscription(Marker, "/cloth_sim/cloth/mesh", lambda message: None, 1)
    bare = frames(client, node, counted, 60)
    assert bare["copies of 3 columns"] == pytest.approx(bare["frames"], abs=2), "positions, without velocities"
    assert set(bare) <= {"frames", "reports", "copies of 3 columns"}

    client.listen(PointCloud2, "/cloth_sim/cloth/particles", 1)
    both = frames(client, node, counted, 60)
    assert both["copies of 6 columns"] == pytest.approx(both["frames"], abs=2), "one copy for both"
    assert set(both) <= {"frames", "reports", "copies of 6 columns"}

    client.node.destroy_subscription(mesh)
    client.listen(DiagnosticArray, "/diagnostics")
    judged = frames(client, node, counted, 120)
    assert judged["reports"] >= 1
