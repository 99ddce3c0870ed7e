# SPDX-License-Identifier: Apache-2.0
"""Poses in foreign frames, and what follows a frame, through the interface of tf2_ros.Buffer.

tf2_ros comes with ROS and not from the Python registry, so that the real buffer is not part of these tests.
"""

import logging
import time

import numpy as np
import pytest
from geometry_msgs.msg import TransformStamped
from rclpy.time import Time
from scene_values import small
from scipy.spatial.transform import Rotation, Slerp
from test_inputs import pose, wind

from cloth_sim_ros.ros.inputs.frames import Frames, Refused
from cloth_sim_ros.ros.inputs.messages import read_pose, read_wind
from cloth_sim_ros.ros.inputs.pose_track import Pose
from cloth_sim_ros.ros.world import World

RATE = 200.0  # Hz, of transforms


class Buffer:
    """world <- arm <- wrist <- gripper: each turns and moves; known from 0 s to `newest`, linear in between."""

    def __init__(self, newest=10.0):
        self.newest = newest

    def exact(self, t):
        place, turn = np.zeros(3), Rotation.identity()
        for k in range(3):
            place = place + turn.apply([0.1 * np.sin(t), 0.2, 0.1 * k * t])
            turn = turn * Rotation.from_rotvec([0.3 * t, 0.1 * k, 0.2 * np.sin(t)])
        return place, turn

    def lookup_transform(self, target, source, at):
        if (target, source) != ("world", "gripper"):
            raise LookupError(f'"{source}" passed to lookupTransform argument source_frame does not exist.')
        t = at.nanoseconds * 1e-9 or self.newest
        if t > self.newest:
            raise ValueError(f"Lookup would require extrapolation into the future. Requested time {t:.6f}")
        low = np.floor(t * RATE) / RATE
        ends = [self.exact(low), self.exact(low + 1 / RATE)]
        share = (t - low) * RATE
        place = (1 - share) * ends[0][0] + share * ends[1][0]
        turn = Slerp([0, 1], Rotation.concatenate([ends[0][1], ends[1][1]]))(share)
        message = TransformStamped()
        message.header.stamp = Time(nanoseconds=round(t * 1e9)).to_msg()
        p, q = message.transform.translation, message.transform.rotation
        p.x, p.y, p.z = place.tolist()
        q.x, q.y, q.z, q.w = turn.as_quat().tolist()
        return message


def test_a_pose_in_a_foreign_frame_is_where_the_buffer_has_it_at_its_stamp():
    frames = Frames("world", buffer=Buffer())
    inner = Rotation.from_rotvec([0.4, -0.5, 0.6])
    for t in np.random.default_rng(3).uniform(0.1, 9.9, 50):
        message = pose((0.3, -0.2, 0.1), inner.as_quat(), "gripper", t)
        stamp = Time.from_msg(message.header.stamp).nanoseconds * 1e-9
        found = read_pose(message, frames)
        buffer = Buffer().lookup_transform("world", "gripper", Time(nanoseconds=round(stamp * 1e9))).transform
        turn = Rotation.from_quat([getattr(buffer.rotation, axis) for axis in "xyzw"])
        place = np.array([getattr(buffer.translation, axis) for axis in "xyz"])
        np.testing.assert_allclose(found.position, place + turn.apply([0.3, -0.2, 0.1]), atol=1e-9)
        assert (Rotation.from_quat(found.orientation).inv() * turn * inner).magnitude() < 1e-6
        exact_place, exact_turn = Buffer().exact(t)
        np.testing.assert_allclose(found.position, exact_place + exact_turn.apply([0.3, -0.2, 0.1]), atol=1e-5)


def test_a_wind_is_turned_but_not_moved():
    found = read_wind(wind((1, 2, 3), "gripper"), Frames("world", buffer=Buffer(newest=2.0)))
    np.testing.assert_allclose(found, Buffer().exact(2.0)[1].apply([1, 2, 3]), atol=1e-9)


@pytest.mark.parametrize(
    ("frame", "stamp", "words"), [("moon", 1.0, "does not exist"), ("gripper", 10.5, "extrapolation into the future")]
)
def test_what_the_buffer_cannot_tell_is_refused_with_its_reason(frame, stamp, words):
    with pytest.raises(Refused, match=f"frame '{frame}' cannot be told in 'world': .*{words}"):
        read_pose(pose(frame_id=frame, stamp=stamp), Frames("world", buffer=Buffer()))


@pytest.mark.long
def test_a_collider_goes_with_its_frame_and_what_is_late_is_told(caplog):
    caplog.set_level(logging.INFO)
    buffer = Buffer(newest=1.0)
    world = World(small(pose_timeout=0.05), logging.getLogger("test"), Frames("world", buffer=buffer))
    assert world.build(world.values)
    world.set_live("ball.follow_frame", "gripper", world.values)
    for _ in range(60):
        world.advance()
        buffer.newest += 1 / 60
        there = world.tracks["ball"].pose
    world.advance()
    now = world.tracks["ball"].pose
    at = buffer.newest - np.arange(0, 0.1, 1 / 6000)
    off = [np.linalg.norm(buffer.exact(t)[0] - now.position) for t in at]
    assert min(off) < 1e-4 and at[int(np.argmin(off))] > buffer.newest - 2.5 / 60, "two frames behind at most"
    assert now != there
    for _ in range(20):
        world.advance()
    newest = buffer.lookup_transform("world", "gripper", Time()).transform.translation
    np.testing.assert_allclose(world.tracks["ball"].pose.position, (newest.x, newest.y, newest.z), atol=1e-6)
    time.sleep(0.1)
    world.advance()
    assert "ball stays where it is: of frame 'gripper', nothing newer has come for 0.05 s" in caplog.text
    world.set_live("ball.follow_frame", "moon", world.values)
    for _ in range(3):
        world.advance()
    assert caplog.text.count("ball stays where it is: frame 'moon' cannot be told in 'world'") == 1


@pytest.mark.parametrize(
    ("place", "turn", "words"),
    [
        ((1.0e5, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), "its position (100000, 0, 0) is beyond 10000 m"),
        ((float("nan"), 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), "its position (nan, 0, 0) is not finite"),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), "its orientation (0, 0, 0, 0) has norm 0, but must be of unit norm"),
    ],
)
def test_a_frame_that_is_nowhere_leaves_things_where_they_are(caplog, place, turn, words):
    frames = Frames("world")
    world = World(small(), logging.getLogger("test"), frames)
    assert world.build(world.values)
    world.set_live("ball.follow_frame", "hand", world.values)
    before = world.sim.get("ball.position")
    for k in range(3):
        frames.links = {"hand": (1.0 + k / 60, Pose(place, turn))}
        world.advance()
    assert caplog.text.count(f"ball stays where it is: {words}") == 1 and world.sim.get("ball.position") == before
    frames.links = {"hand": (2.0, Pose((3.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)))}
    world.advance()
    assert world.sim.get("ball.position") == (3.0, 0.0, 1.0)


def test_without_tf_a_foreign_frame_is_refused():
    with pytest.raises(Refused, match="only knows 'world' as tf2_ros is not installed"):
        read_pose(pose(frame_id="map"), Frames("world"))
