# SPDX-License-Identifier: Apache-2.0
"""Colliders and hands that move: velocity does not jump from frame to frame, and what lies on them does not slip."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Box, Cloth, Handle, Scene, Settings, Simulation

MU, GRAVITY, MASS = 0.5, 9.81, 0.02
MOST = MU * GRAVITY  # [m/s^2] that friction bears


def on_a_board(device, fps, at=0.0, kinetic=MU):
    """A swatch that lies still on a large board, `at` [m] from its middle; kinetic: coefficient of friction."""
    rubs = {"static_friction": MU, "kinetic_friction": kinetic}
    swatch = Cloth(
        resolution=(5, 5), size=(0.02, 0.02), position=(at, 0.0, 0.0011), mass=MASS, thickness=0.001, pins=None, **rubs
    )
    board = Box(half_extents=(1, 1, 0.05), position=(0, 0, -0.05), **rubs)
    sim = Simulation(Scene({"it": swatch}, {"board": board}), Settings(frame_dt=1.0 / fps), device)
    sim.step(round(0.2 * fps))
    return sim


def slip(sim, fps, seconds, way=lambda t: 0.0, angle=lambda t: 0.0):
    """Distance [m] that the swatch has slipped on the board after each frame; way [m] and angle [rad] of the board."""

    def place(t):
        turn = np.array([[np.cos(angle(t)), np.sin(angle(t))], [-np.sin(angle(t)), np.cos(angle(t))]])
        return turn @ (sim.positions("it")[:, :2].mean(axis=0) - (way(t), 0.0))

    start, slips = place(0.0), []
    for t in np.arange(1, round(seconds * fps) + 1) / fps:
        half = 0.5 * angle(t)
        sim.set_collider_pose("board", (way(t), 0.0, -0.05), (0.0, 0.0, np.sin(half), np.cos(half)))
        sim.step()
        slips.append(np.linalg.norm(place(t) - start))
    return np.array(slips)


# Largest slip [m] at the onset of the acceleration, by frames a second.
ONSETS = {30: 4e-3, 60: 1e-3, 240: 1e-4}


@pytest.mark.parametrize("kinetic", [MU, 0.8 * MU])
@pytest.mark.parametrize("fps", ONSETS)
def test_cloth_on_a_tray_that_speeds_up_does_not_slip(device, fps, kinetic):
    """Where kinetic friction is less than static, it broke loose at the onset, and slid by 0.2 m in 0.8 s."""
    sim = on_a_board(device, fps, kinetic=kinetic)
    slips = slip(sim, fps, 0.4, way=lambda t: 0.5 * 0.95 * MOST * t**2)
    assert slips[3] < ONSETS[fps] and np.abs(np.diff(slips[3:])).max() < 1e-3 / fps
    assert sim.wrench("board")[0][0] == pytest.approx(-0.95 * MOST * MASS, rel=0.02)


@pytest.mark.parametrize("phase", [0.3, 0.8])
@pytest.mark.parametrize("fps", ONSETS)
def test_a_start_within_a_frame_lets_it_slip_little(device, fps, phase):
    slips = slip(on_a_board(device, fps), fps, 0.4, way=lambda t: 0.5 * 0.95 * MOST * max(t - phase / fps, 0.0) ** 2)
    assert slips.max() < ONSETS[fps]


@pytest.mark.parametrize("fps", [30, 60])
def test_cloth_on_a_board_that_swings_does_not_slip(device, fps):
    rate = 3.0
    slips = slip(on_a_board(device, fps), fps, 1.0, way=lambda t: 0.95 * MOST / rate**2 * (1.0 - np.cos(rate * t)))
    assert slips.max() < 2e-4


@pytest.mark.parametrize("fps", [30, 60])
def test_cloth_on_a_turntable_does_not_slip(device, fps):
    radius, rate = 0.3, 6.0
    turn = lambda t: 0.95 * MOST / radius / rate**2 * (1.0 - np.cos(rate * t))  # noqa: E731
    slips = slip(on_a_board(device, fps, at=radius), fps, 0.5, angle=turn)
    assert np.diff(slips[3:]).max() < 1e-3 / fps


def test_a_jump_gives_no_velocity(device):
    """A board that is 2 cm farther in one frame drags the cloth in that frame alone, and rests then."""
    sim = on_a_board(device, 60)
    slip(sim, 60, 0.2, way=lambda t: 0.02)
    before = sim.positions("it")
    for _ in range(5):
        sim.set_collider_pose("board", (0.02, 0.0, -0.05))
        sim.step()
    assert sim.positions("it") == pytest.approx(before, abs=1e-6)
    assert np.abs(sim.wrench("board")[0][:2]).max() < 1e-3 * MASS * GRAVITY


def paths(fps, poses):
    """(frames, 3) displacement of a hand, and velocities at the start and end of a frame, along x [m a frame]."""
    swatch = Cloth(resolution=(2, 2), size=(0.1, 0.1))
    sim = Simulation(Scene({"it": swatch}, handles={"hand": Handle()}), Settings(frame_dt=1.0 / fps), "cpu")
    found = []
    for x in poses:
        sim.set_handle_pose("hand", (x, 0.0, 0.0))
        sim.step()
        row = sim._bodies.handles.read(0, 0)[0]
        way = row["end_position"][0] - row["start_position"][0]
        found.append((way, way + row["bends"]["start"][0], way - row["bends"]["end"][0]))
    return np.array(found)


def test_velocities_are_continuous_and_exact_under_constant_acceleration():
    fps, a = 60, 4.0
    frames = np.arange(1, 10)
    found = paths(fps, 0.5 * a * (frames / fps) ** 2)
    assert found[:, 2] == pytest.approx(a * frames / fps**2, rel=1e-3)
    assert found[1:, 1] == pytest.approx(found[:-1, 2], rel=1e-6)


def test_a_start_at_full_speed_is_straight():
    assert paths(60, 2.0 * np.arange(1, 6) / 60)[:, 1:] == pytest.approx(2.0 / 60, rel=1e-5)


def test_noise_of_poses_does_not_grow():
    x = np.random.default_rng(1).normal(0.0, 1e-3, 400)
    found = paths(60, x)
    assert found[:, 1:].std() < 3.0 * found[:, 0].std()
