# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's arm and the node push one another by topic."""

import numpy as np
import pytest
import rclpy
from client import finite
from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2

pytest.importorskip("mujoco")
from cloth_sim_ros.demo import arm  # noqa: E402


@pytest.mark.parametrize("rate", [60.0, pytest.param(240.0, marks=pytest.mark.long)])
def test_the_arm_feels_the_weight_of_its_towel_by_topic(start, client, rate):
    """By /clock at 60 Hz, where a slow machine changes nothing, and by the wall at 240 Hz."""
    start("config/arm.yaml", "-p", f"publish_clock:={str(rate == 60.0).lower()}").ready()
    clouds, felt = client.listen(PointCloud2, "/cloth_sim/towel/particles", 1), []
    driver = arm.Driver()
    driver.set_parameters([Parameter("use_sim_time", value=rate == 60.0)])
    driver.go_at(rate)
    hand, take = driver.arm, driver.arm.feel

    def feel(name, wrench):
        take(name, wrench)
        if name == "hand":
            felt.append(hand.wrench("hand"))

    driver.arm.feel = feel
    try:
        spin = lambda: rclpy.spin_once(driver, timeout_sec=0.002)  # noqa: E731
        client.until(lambda: len(felt) > 480 and clouds, timeout=60.0, meanwhile=spin)
    finally:
        driver.destroy_node()
    weights = -np.array(felt)[240:, 2]
    assert weights.mean() == pytest.approx(arm.LOAD * 9.81, rel=0.1), "it swings"
    assert weights.max() < 2.0 * arm.LOAD * 9.81 and finite(clouds[-1])
    assert np.ptp(hand.data.qpos) > 0.3, "the arm has moved"
