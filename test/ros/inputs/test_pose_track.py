# SPDX-License-Identifier: Apache-2.0
"""Stamped poses become smooth motion at the speed of their stamps."""

import math

import numpy as np
import pytest

from cloth_sim_ros.ros.inputs.pose_track import Pose, PoseTrack, between

FRAME = 1 / 60
LEVEL = (0.0, 0.0, 0.0, 1.0)


def at(x):
    return Pose((float(x), 0.0, 0.0), LEVEL)


def follow(send_period, jitter, frame_cost=FRAME, speed=2.0, duration=3.0, clock_offset=1e6):
    """x after each frame of a track fed with x = speed * t every send_period [s], arriving up to jitter [s] late."""
    random = np.random.default_rng(3)
    sent = np.arange(0.0, duration, send_period)
    arrivals = np.maximum.accumulate(sent + jitter * random.random(len(sent)))
    track, xs, k = PoseTrack(at(0), timeout=0.5), [], 0
    for frame_start in np.arange(0.0, duration, frame_cost):
        while k < len(sent) and arrivals[k] <= frame_start:
            track.push(clock_offset + sent[k], at(speed * sent[k]), arrivals[k])
            k += 1
        track.advance(FRAME)
        xs.append(track.pose.position[0])
    return np.array(xs)


@pytest.mark.parametrize("send_period", [0.1, 1 / 30, 1 / 60, 1 / 250])
def test_moves_at_the_speed_of_the_stamps(send_period):
    velocity = np.diff(follow(send_period, jitter=0.0))[60:] / FRAME
    assert np.median(velocity) == pytest.approx(2.0, rel=1e-6)
    assert velocity.min() > 0.0 and velocity.max() < 4.1


@pytest.mark.parametrize("send_period", [0.1, 1 / 60])
def test_jitter_of_arrival_does_not_jerk_the_collider(send_period):
    velocity = np.diff(follow(send_period, jitter=0.5 * send_period))[60:] / FRAME
    assert np.mean(np.abs(velocity - 2.0) < 1e-6) > 0.9


def test_follows_within_two_periods_and_two_frames():
    xs = follow(0.1, jitter=0.0)
    lag = 2.0 * np.arange(0.0, 3.0, FRAME) - xs
    assert lag[60:].max() < 2.0 * (2 * 0.1 + 2 * FRAME)


def test_a_slow_simulation_does_not_fall_behind():
    xs = follow(1 / 60, jitter=0.0, frame_cost=3 * FRAME)
    lag = 2.0 * np.arange(0.0, 3.0, 3 * FRAME) - xs
    assert lag[20:].max() < 2.0 * 5 * FRAME


def test_stays_where_the_last_pose_was():
    track = PoseTrack(at(0), timeout=0.5)
    track.push(10.0, at(1), arrival=0.0)
    assert track.advance(FRAME) == at(1)
    track.push(10.1, at(2), arrival=0.1)
    for _ in range(10):
        track.advance(FRAME)
    assert track.pose == at(2) and track.advance(FRAME) is None


def test_a_gap_beyond_the_timeout_is_crossed_in_one_frame():
    track = PoseTrack(at(0), timeout=0.5)
    assert track.push(10.0, at(1), arrival=0.0) == 1.0, "and it says how far that is"
    track.advance(FRAME)
    assert track.push(10.1, at(2), arrival=0.1) == 0.0
    assert track.push(20.0, at(5), arrival=0.1) == 4.0
    assert track.advance(FRAME) == at(5)


def test_stamps_must_grow_until_the_sender_was_silent():
    track = PoseTrack(at(0), timeout=0.5)
    track.push(10.0, at(1), arrival=0.0)
    for stamp in (10.0, 9.0):
        with pytest.raises(ValueError, match="stamp"):
            track.push(stamp, at(2), arrival=0.1)
    assert track.advance(FRAME) == at(1)
    track.push(3.0, at(4), arrival=0.7)
    assert track.advance(FRAME) == at(4)
    track.push(3.05, at(5), arrival=0.75)
    assert at(4).position < track.advance(FRAME).position < at(5).position


def test_a_sender_with_stamps_goes_before_one_without():
    track = PoseTrack(at(0), timeout=0.5)
    track.push(None, at(-1), arrival=100.0)
    assert track.advance(FRAME) == at(-1)
    for k in range(20):
        track.push(1e9 + 0.02 * k, at(k), arrival=100.01 + 0.02 * k)
        with pytest.raises(ValueError, match="it has no stamp, while another sender's poses have"):
            track.push(None, at(-9), arrival=100.02 + 0.02 * k)
        track.advance(0.02)
        assert track.pose.position[0] >= 0.0
    track.push(None, at(-2), arrival=101.0)
    assert track.advance(FRAME) == at(-2), "the one with stamps fell silent"


def test_after_a_restart_any_stamp_is_taken():
    track = PoseTrack(at(0), timeout=0.5)
    track.push(10.0, at(1), arrival=0.0)
    track.advance(FRAME)
    track.restart()
    assert track.advance(FRAME) is None and track.pose == at(1)
    track.push(2.0, at(3), arrival=0.1)
    assert track.advance(FRAME) == at(3)


def test_placed_by_parameter_and_moved_on_by_messages():
    track = PoseTrack(at(0), timeout=0.5)
    track.push(10.0, at(1), arrival=0.0)
    track.advance(FRAME)
    track.place(at(7))
    assert track.advance(FRAME) == at(7) and track.advance(FRAME) is None
    track.push(10.1, at(8), arrival=0.1)
    assert at(7).position < track.advance(FRAME).position < at(8).position


def test_turns_the_shorter_way_at_constant_speed():
    def turned(angle, sign=1.0):
        return Pose((0.0, 0.0, 0.0), (0.0, 0.0, sign * math.sin(angle / 2), sign * math.cos(angle / 2)))

    for sign in (1.0, -1.0):
        middle = between(turned(0.2), turned(1.0, sign), 0.25)
        assert 2 * math.atan2(middle.orientation[2], middle.orientation[3]) == pytest.approx(0.4)
    assert between(turned(0.3), turned(0.3, -1.0), 0.5).orientation == pytest.approx(turned(0.3).orientation)
