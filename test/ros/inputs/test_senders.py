# SPDX-License-Identifier: Apache-2.0
"""Who is who: two nodes in /diagnostics, two senders of poses on one topic."""

from builtin_interfaces.msg import Time
from client import fields
from diagnostic_msgs.msg import DiagnosticArray
from node_process import SMALL
from sensor_msgs.msg import PointCloud2

HANGING = """
/**:
  ros__parameters:
    objects: [rope]
    colliders: [ball]
    rope: {type: rope, segments: 10, start: [0, 0, 1], end: [0, 0, 0]}
    ball: {dimensions: [0.1], position: [-1, 0, 0.2]}
    solver: {global_damping: 5.0}
"""


def test_two_nodes_have_two_names_in_diagnostics(start, client):
    start(SMALL).ready()
    start(SMALL, "-r", "__ns:=/robot").ready()
    told = client.listen(DiagnosticArray, "/diagnostics", 10)
    both = {"/cloth_sim: simulation", "/robot/cloth_sim: simulation"}
    client.until(lambda: {status.name for array in told for status in array.status} == both)


def test_a_pose_without_a_stamp_does_not_disturb_a_sender_with_stamps(start, client):
    """The ball holds the rope's lower half aside; somebody types a pose that would take the ball away."""
    node = start(HANGING).ready()
    clouds = client.listen(PointCloud2, "/cloth_sim/rope/particles", 1)
    client.until(lambda: clouds)
    x = -1.0

    def push():
        nonlocal x
        x = min(x + 0.02, 0.2)
        client.move("ball", (x, 0.0, 0.2))

    client.until(lambda: x == 0.2, meanwhile=push)
    client.spin(0.5, meanwhile=push)
    aside = []

    def both():  # by turns: of two messages at once, the node may take the newer alone
        if len(aside) % 2:
            push()
        else:
            client.move("ball", (-1.0, 0.0, 0.2), stamp=Time())
        aside.append(fields(clouds[-1])[8, 0])

    client.spin(2.0, meanwhile=both)
    assert min(aside) > 0.2, "the rope was let go"
    refusals = [line for line in node.log.splitlines() if "is refused" in line]
    assert len(refusals) == 1 and "it has no stamp, while another sender's poses have" in refusals[0]
    client.until(
        lambda: abs(fields(clouds[-1])[8, 0]) < 0.02,
        meanwhile=lambda: client.move("ball", (-1.0, 0.0, 0.2), stamp=Time()),
    )  # alone, it is followed after pose_timeout
