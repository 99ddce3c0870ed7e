# SPDX-License-Identifier: Apache-2.0
"""What a message must be to become a command."""

import logging
import math

import pytest
from geometry_msgs.msg import PoseStamped, Vector3Stamped

from cloth_sim_ros.ros.inputs.frames import Frames, Refused
from cloth_sim_ros.ros.inputs.messages import Complaints, follow, read_pose, read_wind
from cloth_sim_ros.ros.inputs.pose_track import Pose, PoseTrack

NAN, INF = math.nan, math.inf
WORLD = Frames("world")


def pose(position=(1.0, 2.0, 3.0), orientation=(0.0, 0.0, 0.0, 1.0), frame_id="world", stamp=0.0):
    message = PoseStamped()
    message.header.frame_id = frame_id
    message.header.stamp.sec, message.header.stamp.nanosec = int(stamp), round(stamp % 1 * 1e9)
    p, q = message.pose.position, message.pose.orientation
    p.x, p.y, p.z = map(float, position)
    q.x, q.y, q.z, q.w = map(float, orientation)
    return message


def wind(velocity, frame_id="world"):
    message = Vector3Stamped()
    message.header.frame_id = frame_id
    message.vector.x, message.vector.y, message.vector.z = map(float, velocity)
    return message


@pytest.mark.parametrize("value", [NAN, INF, -INF, 1e300, -1e12])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_bad_numbers_are_refused(value, axis):
    vector = [0.0, 0.0, 0.0]
    vector[axis] = value
    with pytest.raises(Refused, match="position"):
        read_pose(pose(vector), WORLD)
    with pytest.raises(Refused, match="velocity"):
        read_wind(wind(vector), WORLD)


@pytest.mark.parametrize(
    "orientation", [(0, 0, 0, 0), (NAN, 0, 0, 1), (0, INF, 0, 0), (0, 0, 0, 1.1), (1, 1, 1, 1), (0, 0, 0, 1e-200)]
)
def test_no_rotation_is_refused(orientation):
    with pytest.raises(Refused, match="orientation"):
        read_pose(pose(orientation=orientation), WORLD)


def test_good_messages():
    assert read_pose(pose(), WORLD) == Pose((1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))
    assert read_pose(pose(orientation=(0, 0, 0, -1.004), frame_id=""), WORLD).orientation == (0.0, 0.0, 0.0, -1.0)
    assert read_wind(wind((1, 2, 3)), WORLD) == (1.0, 2.0, 3.0)


def test_stamps_before_0_are_refused():
    message = pose()
    message.header.stamp.sec = -5
    with pytest.raises(Refused, match="its stamp is -5 s; allowed are stamps from 0 on"):
        read_pose(message, WORLD)


@pytest.mark.parametrize("message", [pose(frame_id="map"), pose(frame_id="/world")])
def test_foreign_frames_are_refused(message):
    with pytest.raises(Refused, match="frame_id"):
        read_pose(message, WORLD)


def test_a_stamp_of_zero_means_now():
    track = PoseTrack(Pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)), timeout=0.5)
    follow(track, pose((1, 0, 0)), WORLD)
    follow(track, pose((2, 0, 0)), WORLD)
    while track.advance(1.0) is not None:
        pass
    assert track.pose.position == (2.0, 0.0, 0.0)


def test_stamps_backwards_are_refused():
    track = PoseTrack(Pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)), timeout=60.0)
    follow(track, pose(stamp=5.5), WORLD)
    with pytest.raises(Refused, match="its stamp is 0.500000 s behind"):
        follow(track, pose(stamp=5.0), WORLD)
    with pytest.raises(Refused, match="its stamp repeats"):
        follow(track, pose(stamp=5.5), WORLD)


def test_complaints_are_throttled_by_topic_and_kind(caplog):
    caplog.set_level(logging.INFO)
    complaints = Complaints(logging.getLogger("test"), period=60.0)
    for topic in ("a", "b"):
        for kind in ("frame", "size", "frame", "size"):
            complaints.refuse(topic, Refused(kind, f"wrong {kind}"))
    assert len(caplog.records) == 4 and complaints.refused == 8
    assert caplog.messages[0] == "a message on a is refused: wrong frame"
    for way in (0.05, 0.2, 0.3):
        complaints.jump("hand", way)
    complaints.jump("other", 0.2, is_empty=lambda: True)
    why = "its pose is the first, or came after a pause of more than pose_timeout; poses at 30 Hz go smoothly"
    assert caplog.messages[4:] == [
        f"hand goes 0.2 m in one frame: {why}",
        "other goes 0.2 m in one frame: it holds nothing, so nothing goes with it",
    ]
    assert [record.levelno for record in caplog.records] == 4 * [logging.WARNING] + 2 * [logging.INFO]
