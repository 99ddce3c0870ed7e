# SPDX-License-Identifier: Apache-2.0
"""Dashpots of a rope between two clamps: they resist a change of the bend in the material, and no rigid motion."""

import numpy as np
import pytest
from fixed_settings import fixed
from scipy.spatial.transform import Rotation

from cloth_sim_ros.sim import Handle, Rope, Scene, Simulation

SEGMENTS, LENGTH, TURN = 32, 0.6, 2.0  # an arc that turns by 2 rad
EI, GJ, TIME = 4e-3, 0.1, 0.05
HELD = (0, 1, SEGMENTS - 1, SEGMENTS)
ORDERS = [pytest.param(1, marks=pytest.mark.long), 2]


def arc():
    """An arc (N, 3) about the y axis, from one point of the x axis to another: in balance if clamps hold it."""
    angles, radius = np.linspace(-0.5, 0.5, SEGMENTS + 1) * TURN, LENGTH / TURN
    return radius * np.stack([np.sin(angles), 0.0 * angles, np.cos(angles) - np.cos(0.5 * TURN)], axis=1)


def clamped(device, order, twist=True, **settings):
    """A rope that is straight at rest, held by two hands at each end as an arc. There is no weight."""
    points = arc()
    straight = np.zeros_like(points)
    straight[:, 0] = np.linspace(-0.5, 0.5, SEGMENTS + 1) * LENGTH
    rope = Rope(
        points=straight,
        mass=0.06,
        pins=None,
        stretch_compliance=1e-5,
        bend_compliance=1.0 / EI,
        bend_damping=TIME,
        twist_compliance=1.0 / GJ if twist else None,
    )
    hands = {f"h{k}": Handle(position=tuple(straight[k]), reach=1e-3) for k in HELD}
    scene = Scene({"it": rope}, handles=hands, gravity=(0, 0, 0))
    sim = Simulation(scene, fixed(order=order, substeps=20, **settings), device)
    sim.set_positions("it", points)
    for k in HELD:
        sim.set_handle_pose(f"h{k}", points[k], sweep=False)
        assert sim.attach(f"h{k}") == 1
    return sim, points


def resistances(x):
    """Dashpots of each joint against a turn of all cross-sections about the rope [N m s], of places x (N, 3)."""
    edges = np.diff(x.astype(float), axis=0)
    lengths = np.linalg.norm(edges, axis=1, keepdims=True)
    turns, span = np.diff(edges / lengths, axis=0), 0.5 * (lengths[1:] + lengths[:-1])
    return EI * TIME * (turns**2 / span).sum(axis=1)


@pytest.mark.parametrize("order", ORDERS)
def test_a_bent_rope_that_goes_round_with_its_clamps_is_not_damped(device, order):
    """About the line through its ends, so that each cross-section turns about the rope by another share."""
    sim, points = clamped(device, order)
    speed, axis, torques = 4.0, np.array([1.0, 0.0, 0.0]), []
    sim.set_velocities("it", np.cross(speed * axis, points))
    for frame in range(150):
        turn = Rotation.from_rotvec(speed * (frame + 1) / 60 * axis)
        for k in HELD:
            sim.set_handle_pose(f"h{k}", turn.apply(points[k]), turn.as_quat())
        sim.step()
        ends, x = sim.end_wrenches("it").astype(float), sim.positions("it").astype(float)[[0, -1]]
        torques.append((ends[:, 3:] + np.cross(x, ends[:, :3])).sum(axis=0) @ axis)
    assert abs(np.mean(torques[-30:])) < 0.02 * speed * resistances(sim.positions("it")).sum()


@pytest.mark.parametrize("order", ORDERS)
def test_cross_sections_that_turn_in_a_bent_rope_are_damped(device, order):
    """Clamps turn about the rope where it ends, and its shape stands still."""
    sim, points = clamped(device, order)
    speed, edges = 0.5, np.diff(points, axis=0)
    axes = {k: edges[0 if k < 2 else -1] / np.linalg.norm(edges[0]) for k in HELD}
    for frame in range(90):
        for k in HELD:
            turn = Rotation.from_rotvec(speed * (frame + 1) / 60 * axes[k])
            sim.set_handle_pose(f"h{k}", points[k], turn.as_quat())
        sim.step()
    torque = -sum(sim.end_wrenches("it")[end, 3:] @ axes[k] for end, k in enumerate((0, SEGMENTS)))
    assert torque == pytest.approx(speed * resistances(sim.positions("it")).sum(), rel=0.01)
    assert sim.positions("it") == pytest.approx(points, abs=0.01)


@pytest.mark.parametrize("order", ORDERS)
def test_a_bend_in_a_plane_is_damped_alike_with_and_without_twist(device, order):
    """Without, dashpots act on how much a joint is bent alone."""
    places = []
    for twist in (True, False):
        sim, points = clamped(device, order, twist)
        x = points.copy()
        x[2:-2, 2] += 0.03 * np.sin(2.0 * np.pi * np.arange(SEGMENTS - 3) / (SEGMENTS - 4))
        sim.set_positions("it", x)
        rows = []
        for _ in range(20):
            sim.step()
            rows.append(sim.positions("it") - points)
        places.append(np.array(rows))
    assert np.abs(places[0]).max() > 5e-3
    assert places[0] == pytest.approx(places[1], abs=5e-3 * np.abs(places[0]).max())


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("speed", [0.0, 3.0])
def test_material_that_lags_behind_its_balance_comes_back_in_the_time_of_the_dashpots(device, order, speed):
    """A straight rope moves sideways with its hands. As its twist is damped as it is stiff, every wave decays alike."""
    sim, points = clamped(device, order)
    points[:] = np.linspace(-0.5, 0.5, SEGMENTS + 1)[:, None] * [LENGTH, 0.0, 0.0]
    for k in HELD:
        sim.set_handle_pose(f"h{k}", points[k], sweep=False)
    sim.set_positions("it", points)
    sim.set_velocities("it", np.tile([0.0, speed, 0.0], (len(points), 1)))
    lag = 0.3 * np.sin(np.pi * np.arange(SEGMENTS) / (SEGMENTS - 1))
    sim.write("it", "lags", lag[None])
    turned, frames = [], 6
    for frame in range(frames):
        for k in HELD:
            sim.set_handle_pose(f"h{k}", points[k] + [0.0, speed * (frame + 1) / 60, 0.0])
        sim.step()
        across = sim.directors("it")
        turned.append(np.arctan2(np.cross(across[:1], across) @ [1.0, 0.0, 0.0], across @ across[0]))
    decay = np.exp(-np.arange(1, frames + 1) / (60 * TIME))
    assert np.array(turned) == pytest.approx(decay[:, None] * lag, abs=0.02 * lag.max())
    with pytest.raises(ValueError, match="it lags hold a number that is not finite"):
        sim.write("it", "lags", np.full((1, SEGMENTS), np.nan))


@pytest.mark.parametrize("hands", [False, True])
def test_loads_of_both_clamps_of_a_twisted_arc_balance(device, hands):
    """It is bent at rest, without weight. A clamp feels half of the bend beside it as a torque about the rope."""
    points = arc()
    handles = {f"h{k}": Handle(position=tuple(points[k]), reach=1e-3, attached=True) for k in HELD if hands}
    rope = Rope(
        points=points,
        mass=0.06,
        pins=None if hands else list(HELD),
        stretch_compliance=1e-5,
        bend_compliance=1.0 / EI,
        bend_damping=TIME,
        twist_compliance=1.0 / 3e-3,
    )
    settings = fixed(order=2, substeps=20, global_damping=5.0)
    sim = Simulation(Scene({"it": rope}, handles=handles, gravity=(0, 0, 0)), settings, device)
    sim.set("it.end_turn", 1.2)
    for _ in range(150):
        sim.step()
    if hands:
        loads, at = np.array([np.concatenate(sim.handle_wrench(f"h{k}")) for k in HELD]), points[list(HELD)]
    else:
        loads, at = sim.end_wrenches("it").astype(float), sim.positions("it").astype(float)[[0, -1]]
    torque = loads[:, 3:] + np.cross(at, loads[:, :3])
    assert np.abs(loads[:, 3:]).max() > 5e-3 and np.abs(torque.sum(axis=0)).max() < 5e-5
