# SPDX-License-Identifier: Apache-2.0
"""Ropes that resist twist between two clamps: even twist, Michell's ring, Greenhill's rod, balance and energy."""

import numpy as np
import pytest
from fixed_settings import fixed
from scipy.integrate import solve_bvp
from scipy.spatial.transform import Rotation

from cloth_sim_ros.sim import Handle, Rope, Scene, Settings, Simulation, Winch
from cloth_sim_ros.sim.topology.rope import across
from cloth_sim_ros.sim.topology.rope import directors as rest_directors
from cloth_sim_ros.study.closed_forms.bending import greenhill_moment, michell_twist

ORDERS = [pytest.param(1, marks=pytest.mark.long), 2]


def clamped(segments, length, bending, torsion, **rope):
    """A straight rope along x whose first and last segments are held."""
    return Rope(
        start=(0, 0, 0),
        end=(length, 0, 0),
        segments=segments,
        pins=(0, 1, segments - 1, segments),
        mass=0.05,
        bend_compliance=1.0 / bending,
        twist_compliance=1.0 / torsion,
        **rope,
    )


def simulation(rope, device, worlds=1, executor=None, **settings):
    return Simulation(Scene({"it": rope}, gravity=(0, 0, 0)), fixed(**settings), device, worlds, executor)


def free_length(segments, length):
    return length * (segments - 2) / segments


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("turn", [np.pi / 2, -12.0])
@pytest.mark.long
def test_the_turn_of_the_end_is_spread_evenly(device, turn, order):
    segments, length, torsion = 20, 1.0, 0.05
    sim = simulation(clamped(segments, length, 10.0, torsion), device, order=order)
    sim.set("it.end_turn", turn)
    sim.step(10)
    across = sim.directors("it")
    assert np.abs(across[:, 0]).max() < 1e-6 and np.linalg.norm(across, axis=1) == pytest.approx(1.0, rel=1e-6)
    angles = np.unwrap(np.arctan2(across[:, 2], across[:, 1]))
    middle = np.clip((np.arange(segments) - 0.5) / (segments - 2), 0.0, 1.0)
    assert angles - angles[0] == pytest.approx(turn * middle, abs=1e-3 * abs(turn))
    report = sim.report()["it"]
    assert report["twist"] == pytest.approx(turn, rel=1e-5)
    assert report["torsion"] == pytest.approx(torsion * turn / free_length(segments, length), rel=1e-5)
    # What is turned forward turns its clamp back, and the other along.
    wrenches = sim.end_wrenches("it")
    assert wrenches[:, 3] == pytest.approx([report["torsion"], -report["torsion"]], rel=1e-4)


def helix(sim, stretch, wave, size):
    """A small helix on the stretched rope, gone at its clamps."""
    x = sim.rest_positions("it").astype(float) * (stretch, 1.0, 1.0)
    s = x[:, 0] / x[-1, 0]
    bow = size * np.sin(np.pi * s) ** 2
    x[:, 1], x[:, 2] = bow * np.cos(wave * x[:, 0]), bow * np.sin(wave * x[:, 0])
    x[[0, 1, -2, -1], 1:] = 0.0
    return x


@pytest.mark.parametrize(("order", "substeps"), [(1, 40), (2, 10)])
@pytest.mark.parametrize(("share", "coils"), [(0.97, False), (-0.97, False), (1.05, True), (-1.05, True)])
@pytest.mark.long
def test_a_long_rope_in_tension_coils_at_greenhills_moment(device, share, coils, order, substeps):
    """M = 2 sqrt(EI T) (Greenhill 1883); between clamps it is some 1 % more."""
    segments, length, bending, torsion, tension, axial = 128, 1.0, 1e-3, 1e-3, 1.6, 100.0
    rope = clamped(segments, length, bending, torsion, stretch_compliance=1.0 / axial)
    sim = simulation(rope, device, order=order, substeps=substeps)
    sim.set_positions("it", helix(sim, 1.0 + tension / axial, np.sqrt(tension / bending), 1e-5))
    moment = share * greenhill_moment(bending, tension)
    sim.set("it.end_turn", moment * free_length(segments, length) / torsion)
    largest = 0.0
    for _ in range(12):
        sim.step(10)
        largest = max(largest, np.abs(sim.positions("it")[:, 1:]).max())
    assert (largest > 2e-4) == coils
    assert largest < 2e-5 or coils
    assert sim.report()["it"]["torsion"] == pytest.approx(moment, rel=0.01)


RING = 64


def ring(device, share, torsion=0.03, bending=0.02, radius=0.3, bend_damping=0.0, **settings):
    """A straight rope bent to a closed ring, its end turned by a share of Michell's 2 pi sqrt(3) EI / GJ."""
    edge = 2.0 * radius * np.sin(np.pi / RING)
    rope = clamped(RING + 1, (RING + 1) * edge, bending, torsion, stretch_compliance=1e-5, bend_damping=bend_damping)
    sim = simulation(rope, device, **settings)
    angle = 2.0 * np.pi * (np.arange(RING + 2) - 0.5) / RING
    sim.set_positions("it", np.stack([radius * np.cos(angle), radius * np.sin(angle), 0.0 * angle], axis=1))
    critical = michell_twist(bending, torsion)
    sim.set("it.end_turn", share * critical)
    return sim, critical


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(("share", "folds"), [pytest.param(0.95, False, marks=pytest.mark.long), (1.05, True)])
def test_a_twisted_ring_folds_at_michells_twist(device, share, folds, order):
    """Folded to an eight it takes a turn of the twist as writhe (Michell 1889)."""
    sim, critical = ring(device, share, order=order, global_damping=10.0)
    sim.step(300)
    twist = sim.report()["it"]["twist"]
    assert twist == pytest.approx(share * critical - (4.0 * np.pi if folds else 0.0), abs=0.05 * critical)


@pytest.mark.parametrize("order", ORDERS)
def test_forces_and_moments_of_both_clamps_balance_in_a_coiled_rope(device, order):
    sim, _ = ring(device, 0.9, order=order, global_damping=10.0)
    sim.step(400)
    (start, end), x = sim.end_wrenches("it").astype(float), sim.positions("it").astype(float)
    # Without loads, what the rope does to one clamp it does to the other in reverse.
    size = np.linalg.norm(start[3:])
    assert np.linalg.norm(start[:3]) > 0.1 and size > 0.01
    assert start[:3] + end[:3] == pytest.approx(np.zeros(3), abs=5e-3 * np.linalg.norm(start[:3]))
    assert start[3:] + end[3:] + np.cross(x[-1] - x[0], end[:3]) == pytest.approx(np.zeros(3), abs=5e-3 * size)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("bend_damping", [0.0, 0.01])
def test_a_rope_that_folds_gains_no_energy(device, bend_damping, order):
    torsion, bending, axial = 0.03, 0.02, 1e5
    sim, critical = ring(device, 1.1, torsion, bending, bend_damping=bend_damping, order=order)
    masses, edge = sim.masses("it"), 2.0 * 0.3 * np.sin(np.pi / RING)
    span = np.full(RING, edge)
    span[[0, -1]] *= 0.5  # a held segment does not bend

    def energy(angle):
        x, v = sim.positions("it").astype(float), sim.velocities("it").astype(float)
        lengths = np.linalg.norm(np.diff(x, axis=0), axis=1)
        turns = np.diff(np.diff(x, axis=0) / edge, axis=0)
        stored = 0.5 * axial * ((lengths - edge) ** 2 / edge).sum() + 0.5 * (bending / span * (turns**2).sum(1)).sum()
        return 0.5 * (masses * (v**2).sum(1)).sum() + stored + 0.5 * torsion * angle**2 / (edge * (RING - 1))

    at_start = energy(1.1 * critical)
    for _ in range(60):
        sim.step(3)
        assert energy(sim.report()["it"]["twist"]) < 1.01 * at_start
    assert sim.report()["it"]["twist"] < 0.9 * critical and sim.report()["it"]["recoveries"] == 0


@pytest.mark.long
@pytest.mark.parametrize("order", ORDERS)
def test_both_executors_and_many_worlds_give_the_same_state(device, order):
    found = {}
    for executor, worlds in (("block", 1), ("graph", 1), ("block", 2)):
        sim, _ = ring(device, 0.8, bend_damping=0.01, order=order, worlds=worlds, executor=executor)
        if worlds > 1:
            sim.set("it.end_turn", 0.0, 1)
        sim.step(20)
        found[executor, worlds] = sim.positions("it")
        assert worlds == 1 or sim.report(1)["it"]["torsion"] == pytest.approx(0.0, abs=1e-5)
    for key in (("graph", 1), ("block", 2)):
        assert np.abs(found["block", 1] - found[key]).max() < 2e-5


def test_reset_goes_back_to_the_first_bit(device):
    sim = simulation(clamped(24, 0.5, 1e-3, 1e-3, stretch_compliance=1e-4), device, order=2)
    sim.set("it.end_turn", 60.0)
    runs = []
    for _ in range(2):
        sim.set_velocities("it", 0.1 * np.sin(np.arange(75.0)).reshape(25, 3))
        sim.step(30)
        runs.append((sim.positions("it"), sim.velocities("it"), sim.directors("it")))
        sim.reset()
    assert all(np.array_equal(a, b) for a, b in zip(*runs, strict=True))
    assert np.abs(runs[0][0][:, 1]).max() > 1e-4


def test_a_rope_that_goes_bad_is_put_back_with_its_twist(device):
    sim = simulation(clamped(12, 0.5, 1e-2, 1e-2), device)
    sim.set("it.end_turn", 9.0)
    sim.step(5)
    arrays, _, _ = sim.device_arrays("it")
    spoilt = arrays.state.velocities.numpy()
    spoilt[5] = np.nan
    arrays.state.velocities.assign(spoilt)
    sim.step()
    assert sim.report()["it"]["recoveries"] == 1 and np.isfinite(sim.end_wrenches("it")).all()
    sim.step(5)
    assert sim.report()["it"]["twist"] == pytest.approx(9.0, rel=1e-4) and sim.report()["it"]["recoveries"] == 1


def test_a_simulation_takes_over_from_another(device):
    one, critical = ring(device, 1.05, global_damping=10.0)
    one.step(300)
    other, _ = ring(device, 1.05, global_damping=10.0)
    other.take_over("it", one)
    other.step()
    assert other.report()["it"]["twist"] == pytest.approx(one.report()["it"]["twist"], abs=1e-2 * critical)


def test_live_numbers_of_twist(device):
    sim = simulation(clamped(12, 0.5, 1e-2, 1e-2), device)
    sim.set("it.end_turn", 2.0)
    sim.set("it.twist_compliance", 1e3)
    sim.step()
    assert sim.report()["it"]["torsion"] == pytest.approx(1e-3 * 2.0 / free_length(12, 0.5), rel=1e-5)


def held(device, turn, order=2, compliance=0.0, executor=None):
    """A rope clamped at its start, whose end a handle holds, and turns by `turn` about its axis in 20 frames."""
    segments, length, torsion = 20, 1.0, 0.05
    rope = Rope(start=(0, 0, 0), end=(length, 0, 0), segments=segments, pins=(0, 1), mass=0.05, bend_compliance=0.1,
                twist_compliance=1.0 / torsion)  # fmt: skip
    hand = Handle(position=(length, 0, 0), reach=1.2 * length / segments, compliance=compliance)
    scene = Scene({"it": rope}, handles={"hand": hand}, gravity=(0, 0, 0))
    sim = Simulation(scene, fixed(order=order), device=device, executor=executor)
    sim.step(5)
    assert sim.report()["it"]["torsion"] == 0.0
    assert sim.attach("hand") == 2
    turn_hand(sim, 0.0, turn)
    return sim, torsion / free_length(segments, length)


def turn_hand(sim, begin, end):
    for angle in np.linspace(begin, end, 21)[1:]:
        sim.set_handle_pose("hand", (1.0, 0.0, 0.0), (np.sin(0.5 * angle), 0.0, 0.0, np.cos(0.5 * angle)))
        sim.step()


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("turn", [2.0, -8.0])
@pytest.mark.long
def test_a_hand_that_turns_the_end_twists_the_rope_and_feels_its_torsion(device, turn, order):
    sim, stiffness = held(device, turn, order)
    assert sim.report()["it"]["torsion"] == pytest.approx(stiffness * turn, rel=1e-3)
    assert sim.handle_wrench("hand")[1] == pytest.approx([-stiffness * turn, 0.0, 0.0], rel=1e-3, abs=1e-4)
    assert sim.end_wrenches("it")[0, 3] == pytest.approx(stiffness * turn, rel=1e-3)


def test_what_a_hand_lets_go_has_no_twist_and_begins_anew_when_it_is_held_again(device):
    sim, stiffness = held(device, 5.0)
    sim.release("hand")
    sim.step(5)
    assert sim.report()["it"]["twist"] == sim.report()["it"]["torsion"] == 0.0
    assert np.abs(sim.handle_wrench("hand")[1]).max() == 0.0
    assert sim.attach("hand") == 2
    sim.step(5)
    assert sim.report()["it"]["twist"] == pytest.approx(0.0, abs=1e-3)
    turn_hand(sim, 5.0, 4.0)
    assert sim.report()["it"]["torsion"] == pytest.approx(-stiffness, rel=2e-3)


@pytest.mark.long
def test_both_executors_twist_by_hand_alike(device):
    found = []
    for executor in ("block", "graph"):
        found.append(held(device, 3.0, executor=executor)[0])
    assert found[0].report()["it"]["twist"] == pytest.approx(found[1].report()["it"]["twist"], rel=1e-5)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"bend_compliance": None}, "Rope has twist without bending; allowed is bending alone, or both"),
        ({"segments": 2, "pins": ()}, "Rope has twist and 2 segments; allowed are at least 3"),
        ({"twist_compliance": 0.0}, "Rope.twist_compliance is 0.0; allowed is a finite number from 1e-06"),
        ({"winch": Winch()}, "with a winch"),
    ],
)
def test_what_twist_cannot_have_is_said(change, sentence):
    with pytest.raises(ValueError, match=sentence):
        Rope(**{"segments": 6, "pins": (0, 1, 5, 6), "bend_compliance": 1.0, "twist_compliance": 1.0, **change})


def test_solvers_and_ropes_without_twist_refuse_it(device):
    with pytest.raises(ValueError, match="with twist in it; allowed is 'auto' or 'xpbd'"):
        simulation(clamped(12, 0.5, 1e-2, 1e-2), device, method="verlet")
    sim = simulation(Rope(segments=4), device)
    with pytest.raises(
        ValueError, match="it.end_turn is set but it was built without; allowed is an object built with"
    ):
        sim.set("it.end_turn", 1.0)
    with pytest.raises(ValueError, match="it does not resist twist; allowed is a rope with twist_compliance"):
        sim.directors("it")


def arc(segments, length, curvature):
    """Points of an arc in the plane of x and y that begins along x."""
    angle = curvature * length * (np.arange(segments) + 0.5) / segments
    edges = length / segments * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    return np.concatenate([np.zeros((1, 3)), np.cumsum(edges, axis=0)])


@pytest.mark.parametrize("order", ORDERS)
def test_an_arc_at_rest_turns_with_its_clamps(device, order):
    """About any axis, without load: its bends at rest are in its material."""
    points = arc(24, 1.0, 2.0)
    held = [0, 1, 23, 24]
    handles = {f"h{i}": Handle(position=tuple(points[i]), reach=1e-3, attached=True) for i in held}
    rope = Rope(points=points, mass=0.05, pins=None, bend_compliance=10.0, twist_compliance=15.0)
    scene = Scene({"it": rope}, handles=handles, gravity=(0, 0, 0))
    sim = Simulation(scene, fixed(order=order, substeps=10, global_damping=5.0), device)
    for frame in range(150):
        turn = Rotation.from_rotvec(min(frame + 1, 60) / 60 * np.array([1.5, 0.4, -0.8]))
        for i in held:
            sim.set_handle_pose(f"h{i}", turn.apply(points[i]), turn.as_quat())
        sim.step()
    assert sim.positions("it") == pytest.approx(turn.apply(points), abs=1e-3)
    assert np.abs(sim.end_wrenches("it")).max() < 2e-3


def test_a_rope_held_straight_pulls_at_its_clamps_with_its_bend_at_rest(device):
    """EI kappa at both ends, and at the end in a direction that its turn turns along."""
    bending, curvature, segments = 0.1, 2.0, 40
    rope = clamped(segments, 1.0, bending, 0.05, stretch_compliance=1e-6)
    sim = simulation(rope, device, substeps=10, global_damping=20.0)
    turns = np.zeros((1, segments - 1, 2))
    turns[..., 0] = curvature / segments
    turns[:, [0, -1]] *= 0.5  # a held segment does not bend
    sim.write("it", "rest_turns", turns)
    sim.set("it.end_turn", 0.5)
    sim.set_positions("it", sim.rest_positions("it"))
    sim.step(200)
    across = sim.directors("it").astype(float)
    (start, end), x = sim.end_wrenches("it").astype(float), sim.positions("it")
    assert np.abs(x[:, 1:]).max() < 0.02
    for torque, u, sign in ((start, across[0], -1.0), (end, across[-1], 1.0)):
        axis = np.cross([1.0, 0.0, 0.0], u)
        assert torque[3:] @ axis == pytest.approx(sign * bending * curvature, rel=0.05)


def test_a_ring_turns_within_itself_to_where_it_is_bent_at_rest(device):
    """GJ theta'' = EI kappa kappa_0 sin theta (Kirchhoff 1859), of a rope that is held on a circle everywhere."""
    bending, torsion, kappa, rest, first = 0.1, 0.07, 4.0, 1.5, 2.0
    points = arc(60, 1.0, kappa)
    rope = Rope(points=points, mass=0.05, pins=range(61), bend_compliance=1.0 / bending, twist_compliance=1.0 / torsion)
    sim = simulation(rope, device, substeps=10)
    u, inwards = across(np.diff(points, axis=0)[0]), np.cross([0.0, 0.0, 1.0], np.diff(points, axis=0)[0])
    offset = np.arctan2(np.cross(u, inwards)[0], u @ inwards)
    angle = offset + first
    turns = np.tile(rest / 60 * np.array([np.cos(angle), np.sin(angle)]), (1, 59, 1))
    sim.write("it", "rest_turns", turns)
    sim.step(5)
    t = np.diff(points, axis=0) * 60
    found = sim.directors("it").astype(float)
    carried = rest_directors(t, u)
    turned = np.arctan2((np.cross(carried, found) * t).sum(1), (carried * found).sum(1))
    middle = np.clip((np.arange(60) - 0.5) / 58, 0.0, 1.0)
    share = bending * kappa * rest / torsion * (58 / 60) ** 2
    exact = solve_bvp(
        lambda s, y: np.stack([y[1], share * np.sin(first + y[0])]),
        lambda a, b: np.array([a[0], b[0]]),
        np.linspace(0, 1, 50),
        np.zeros((2, 50)),
    )
    assert np.abs(turned).max() > 0.3
    assert turned == pytest.approx(exact.sol(middle)[0], abs=0.01)


@pytest.mark.parametrize("count", [2, 3, 5])
def test_a_hand_that_holds_several_particles_twists_what_is_free(device, count):
    """The torque is GJ theta over the length between both clamps; of five particles it was 17 % too little."""
    length, segments, rigidity, angle = 1.0, 20, 0.05, 1.0
    spacing = length / segments
    cable = Rope(
        start=(0, 0, 0),
        end=(length, 0, 0),
        segments=segments,
        mass=0.1,
        radius=0.003,
        pins=[0, 1],
        stretch_compliance=1e-6,
        bend_compliance=10.0,
        twist_compliance=1.0 / rigidity,
        bend_damping=0.01,
    )
    place = (length - 0.5 * (count - 1) * spacing, 0, 0)
    hand = Handle(position=place, reach=(0.5 * (count - 1) + 0.2) * spacing)
    sim = Simulation(Scene({"it": cable}, handles={"hand": hand}, gravity=(0, 0, 0)), Settings(), device=device)
    assert sim.attach("hand") == count
    for frame in range(1, 61):
        half = 0.5 * angle * frame / 60
        sim.set_handle_pose("hand", place, (np.sin(half), 0, 0, np.cos(half)))
        sim.step()
    sim.step(60)
    free = length - count * spacing  # a segment at the pins, and those of the hand
    assert sim.handle_wrench("hand")[1][0] == pytest.approx(-rigidity * angle / free, rel=2e-3)
