# SPDX-License-Identifier: Apache-2.0
"""A body at rest is not computed; whatever changes around it wakes it, and its wrench stays its weight."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Box, Cloth, Handle, Readback, Scene, Settings, Simulation, Sphere, Wind

TOWEL = Cloth.of("cotton", resolution=(10, 10), size=(0.3, 0.3), position=(0, 0, 0.002), pins=None)
TRAY = Box(half_extents=(0.5, 0.5, 0.05), position=(0, 0, -0.05), static_friction=0.4, kinetic_friction=0.3)
FAR = (0.0, 0.0, 5.0)


def laid(device, sleep=True, **scene):
    """A towel that has lain on a tray for two seconds."""
    colliders = {"tray": TRAY, "ball": Sphere(radius=0.1, position=FAR)}
    handles = {"hand": Handle(position=FAR, reach=0.05)}
    scene = Scene({"it": TOWEL}, colliders, handles=handles, wind=Wind(), spare_colliders=1, **scene)
    sim = Simulation(scene, Settings(sleep=sleep), device)
    sim.step(120)
    return sim


def is_asleep(sim):
    return sim._bodies.batch["it"].states["asleep"].numpy().astype(bool)


def test_what_lies_still_sleeps_and_weighs_as_much(device):
    sim = laid(device)
    assert is_asleep(sim).all()
    x = sim.positions("it")
    sim.step(60)
    assert is_asleep(sim).all() and np.array_equal(sim.positions("it"), x)
    assert sim.wrench("tray")[0][2] == pytest.approx(-9.81 * TOWEL.mass, rel=1e-3)


def test_it_sleeps_on_after_a_load_unless_a_change_waited(device, tmp_path):
    sim, other = laid(device), laid(device)
    sim.save(tmp_path / "asleep.npz")
    blow(sim, 40)
    sim.save(tmp_path / "disturbed.npz")
    for file, wakes in (("asleep.npz", False), ("disturbed.npz", True)):
        other.load(tmp_path / file)
        x = Readback(other, "it")  # who only reads wakes nobody
        x.request()
        x = x.particles().copy()
        other.step()
        assert np.array_equal(other.positions("it"), x) != wakes
    sim.step()
    assert np.array_equal(other.positions("it"), sim.positions("it"))


def tilt(sim, frame):
    angle = np.radians(40.0) * min(1.0, frame / 35)
    turned = (np.sin(0.5 * angle), 0.0, 0.0, np.cos(0.5 * angle))
    sim.set_collider_pose("tray", (0, 0.05 * np.sin(angle), -0.05 * np.cos(angle)), turned)


def blow(sim, frame):
    sim.set("wind.velocity", (0.0, 8.0 * min(1.0, frame / 40), 4.0))


def drop(sim, frame):
    sim.set_collider_pose("ball", (0, 0, max(0.12, 0.6 - 0.02 * frame)), (0, 0, 0, 1))


def grasp(sim, frame):
    if frame == 0:
        sim.set_handle_pose("hand", (0.15, 0.15, 0.0), (0, 0, 0, 1), sweep=False)
    if frame == 2:
        assert sim.attach("hand") > 0
    if frame > 2:
        sim.set_handle_pose("hand", (0.15, 0.15, 0.005 * (frame - 2)), (0, 0, 0, 1))


def push(sim, frame):
    if frame == 0:
        sim.set_velocities("it", np.tile([0.0, 2.0, 0.0], (100, 1)))


def lift(sim, frame):
    if frame == 0:
        sim.set("gravity", (0, 3.0, -5.0))


@pytest.mark.parametrize("disturb", [tilt, blow, drop, grasp, push, lift])
def test_it_moves_as_without_sleep(device, disturb):
    sims = [laid(device, sleep) for sleep in (True, False)]
    start = sims[0].positions("it")
    for frame in range(35):
        for sim in sims:
            disturb(sim, frame)
            sim.step()
    ways = [sim.positions("it") - start for sim in sims]
    moved = np.sqrt((ways[1] ** 2).sum(1).mean())
    if disturb is not drop:
        assert moved > 0.002
    assert np.sqrt(((ways[0] - ways[1]) ** 2).sum(1).mean()) < 0.05 * max(moved, 0.01)


@pytest.mark.long
def test_only_worlds_at_rest_sleep(device):
    scene = Scene({"it": TOWEL}, {"tray": TRAY})
    sim = Simulation(scene, Settings(), device, worlds=2)
    for _ in range(60):
        sim.set_velocities("it", np.tile([0.0, 0.5, 0.0], (100, 1)), world=1)
        sim.step(2)
    assert is_asleep(sim)[:, 0].tolist() == [True, False]
    single = Simulation(scene, Settings(), device)
    single.step(120)
    assert np.array_equal(single.positions("it"), sim.positions("it", 0))
