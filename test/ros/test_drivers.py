# SPDX-License-Identifier: Apache-2.0
"""Drivers of scenes go by the simulation's time, so that bodies move alike on a slow machine."""

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from cloth_sim_ros.demo import winch
from cloth_sim_ros.demo.curtain import Driver, ball_pose
from cloth_sim_ros.demo.driver import LONGEST

CURTAIN = """
/**:
  ros__parameters:
    objects: [cloth]
    colliders: [ball]
    cloth: {type: cloth, resolution: [4, 4], position: [0, 5, 0]}
    ball: {shape: sphere, position: [0, -0.6, 1]}
    publish_clock: true
"""


def test_a_driver_that_waits_or_is_held_up_goes_on_where_it_was(start, client):
    start(CURTAIN).ready()
    all_of_them = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
    sent = client.listen(PoseStamped, "/cloth_sim/colliders/ball/pose", all_of_them)
    clocks = client.listen(Clock, "/clock")
    driver = Driver()
    driver.set_parameters([Parameter("use_sim_time", value=True)])
    turn = lambda: rclpy.spin_once(driver, timeout_sec=0.002)  # noqa: E731
    try:
        client.until(lambda: len(sent) > 20, meanwhile=turn)
        client.call(SetBool, "/cloth_sim/pause", SetBool.Request(data=True))
        client.spin(0.3, meanwhile=turn)
        sent.clear()
        client.spin(0.3, meanwhile=turn)
        assert not sent, "time stands"
        client.call(SetBool, "/cloth_sim/pause", SetBool.Request(data=False))
        client.until(lambda: len(sent) > 20, meanwhile=turn)
        before = len(clocks)
        client.until(lambda: len(clocks) > before + 60)  # a second in which something holds the driver up
        client.until(lambda: len(sent) > 40, meanwhile=turn)
    finally:
        driver.destroy_node()
    assert len(clocks) > 40
    stamps = np.array([each.header.stamp.sec + 1e-9 * each.header.stamp.nanosec for each in sent])
    assert np.diff(stamps).max() > 0.5
    ages = np.append(0.0, np.cumsum(np.minimum(np.diff(stamps), LONGEST)))  # no leap by what it waited
    heights = [each.pose.position.y for each in sent]
    begin = np.arccos(-heights[0] / 0.6) / (2.0 * np.pi) * 6.0  # [s] of its swing
    assert heights == pytest.approx([ball_pose(begin + t)[1] for t in ages], abs=1e-3)


def test_the_winch_of_the_scene_goes_down_and_up_as_far():
    ways = np.array([winch.rate(t) for t in np.arange(0.0, 12.0, 0.01)])
    assert ways.sum() == pytest.approx(0.0) and ways.max() == -ways.min() == winch.RATE
    assert 1.0 + winch.RATE * winch.MOVE < 3.5
