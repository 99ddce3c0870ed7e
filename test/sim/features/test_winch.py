# SPDX-License-Identifier: Apache-2.0
"""Winches: what is paid out hangs, swings and weighs as a rope of that length does, and nothing jumps."""

import itertools

import numpy as np
import pytest
from fixed_settings import fixed
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

from cloth_sim_ros.sim import Readback, Rope, Scene, Simulation, Winch
from cloth_sim_ros.sim.executors import block

G = 9.81
SEGMENTS, LENGTH, MASS = 64, 4.0, 0.4
SPACING = LENGTH / SEGMENTS


def on_a_winch(load, segments=SEGMENTS, axis=(0.0, 0.0, -1.0), winch=None, length=LENGTH, mass=MASS, **rope):
    """A rope of `length` along `axis` with a `load` at its end and 1 m paid out."""
    masses = np.full(segments + 1, mass / segments)
    masses[[0, -1]] *= 0.5
    masses[-1] += load
    return Rope(
        start=(0, 0, 0),
        end=tuple(length * np.asarray(axis)),
        segments=segments,
        particle_masses=masses,
        winch=winch or Winch(length=1.0, acceleration=0.25),
        **rope,
    )


def simulation(rope, device, worlds=1, executor=None, **settings):
    return Simulation(Scene({"it": rope}), fixed(**settings), device, worlds, executor)


def settle(sim):
    sim.set("solver.global_damping", 20.0)
    sim.step(200)
    sim.set("solver.global_damping", 0.0)


def out_of(sim):
    """Tensions [N] of what is out, and the rest length [m] of the segment at the drum."""
    tensions, paid_out = sim.tensions("it").astype(float), sim.report()["it"]["paid_out"]
    shown = Readback(sim, "it")
    shown.request()
    wound = int((np.linalg.norm(shown.particles()[:, :3], axis=1) == 0.0).sum()) - 1  # at the drum, in the origin
    return tensions[wound:], paid_out - (SEGMENTS - wound - 1) * SPACING


LOADS = [(5.0, 0.0, 0.0, 0.5), (5.0, 1e-5, 2e-3, 0.15), (0.5, 1e-4, 5e-3, 0.15), (0.0, 0.0, 0.0, 0.5)]


@pytest.mark.parametrize(
    ("load", "compliance", "damping", "ramp", "order", "executor"),
    [
        (*LOADS[2], 2, "block"),
        pytest.param(*LOADS[3], 2, "block", marks=pytest.mark.long),
        pytest.param(*LOADS[0], 1, "block", marks=pytest.mark.long),
        pytest.param(*LOADS[1], 2, "block", marks=pytest.mark.long),
        pytest.param(*LOADS[1], 2, "graph", marks=pytest.mark.long),
    ],
)
def test_two_metres_out_and_in_with_the_tension_of_the_closed_form(
    device, load, compliance, damping, ramp, order, executor
):
    """T(s) = (w (L - s) + W) (1 - a / g), whatever is out, born or swallowed; the load goes at the rate of the winch.

    Where the rope stretches, the winch speeds up so slowly that the bounce of its load stays within the 2 %.
    """
    winch = Winch(length=1.0, acceleration=ramp)
    rope = on_a_winch(load, winch=winch, stretch_compliance=compliance, damping=damping)
    sim = simulation(rope, device, substeps=8, order=order, executor=executor)
    settle(sim)
    rate, pull, born = 0.0, None, None
    lengths = []
    for wanted, frames in ((0.5, 240), (0.0, 210), (-0.5, 240), (0.0, 210)):
        sim.set("it.winch.pay_out", wanted)
        for _ in range(frames):
            sim.step()
            report = sim.report()["it"]
            acceleration, rate = 60 * (report["pay_out"] - rate), report["pay_out"]
            found, first = out_of(sim)
            assert 0.4 * SPACING < first < 1.6 * SPACING
            below = np.append(np.cumsum(np.full(len(found) - 1, SPACING))[::-1], 0.0)  # the segments' lower ends
            middle = below + 0.5 * np.append(first, np.full(len(found) - 1, SPACING))
            expected = (MASS / LENGTH * middle + load) * (G - acceleration)
            assert found == pytest.approx(expected, rel=0.02)
            drum = -sim.end_wrenches("it")[0, 2]
            assert drum == pytest.approx((MASS / LENGTH * report["paid_out"] + load) * (G - acceleration), rel=0.02)
            if pull is not None and born != len(found) and acceleration == 0.0:
                assert found[0] == pytest.approx(pull, rel=0.05)
            pull, born = found[0], len(found)
            lengths.append(report["paid_out"])
    assert max(lengths) == pytest.approx(3.0, abs=2e-3) and lengths[-1] == pytest.approx(1.0, abs=2e-3)
    weight = compliance * (MASS / LENGTH * G * 0.5 * lengths[-1] ** 2 + load * G * lengths[-1])
    assert -sim.positions("it")[-1, 2] == pytest.approx(lengths[-1] + weight, abs=1e-3)


@pytest.mark.parametrize(("order", "error"), [pytest.param(1, 6e-3, marks=pytest.mark.long), (2, 6e-4)])
def test_a_load_swings_as_a_pendulum_of_changing_length(device, order, error):
    """l theta'' + 2 l' theta' + g sin theta = 0: births and swallows neither stop nor push what swings past them."""
    at_start = 0.6
    axis = (np.sin(at_start), 0.0, -np.cos(at_start))
    rope = on_a_winch(1.0, 32, axis, Winch(length=1.0), length=2.0, mass=1e-3, stretch_compliance=1e-5, damping=1e-3)
    sim = simulation(rope, device, substeps=40, order=order)

    def rate(t):
        return min(t, 0.3) if t < 2.0 else max(0.3 - (t - 2.0), -0.3)

    def motion(t, y):
        length, angle, spin = y
        return [rate(t), spin, (-G * np.sin(angle) - 2.0 * rate(t) * spin) / length]

    exact = solve_ivp(motion, (0, 4.5), [1.0, at_start, 0.0], rtol=1e-9, atol=1e-11, max_step=0.02, dense_output=True)
    for frame in range(270):
        sim.set("it.winch.pay_out", 0.3 if frame < 120 else -0.3)
        sim.step()
        length, angle, _ = exact.sol((frame + 1) / 60)
        there = sim.positions("it")[-1, [0, 2]] - (length * np.sin(angle), -length * np.cos(angle))
        assert np.linalg.norm(there) < error


@pytest.mark.parametrize("compliance", [0.0, 1e-5])
def test_a_bend_that_reaches_the_drum_jerks_nothing(device, compliance):
    """A load hangs in the middle of a slack rope; taken up, it leaves half a segment less than lay around it."""
    masses = np.full(33, 0.2 / 32)
    masses[20] += 0.2
    down, up = np.linspace([0, 0, 0], [0.5, 0, -1.5], 21), np.linspace([0.5, 0, -1.5], [2, 0, 0], 13)
    rope = Rope(
        points=np.concatenate([down[:-1], up]),
        particle_masses=masses,
        pins="both",
        stretch_compliance=compliance,
        winch=Winch(acceleration=0.5),
    )
    sim = simulation(rope, device, substeps=10, order=2)
    settle(sim)
    sim.set("it.winch.pay_out", -0.4)
    largest = 0.0
    for _ in range(270):
        sim.step()
        largest = max(largest, np.abs(sim.tensions("it")).max())
    assert largest < 2.0 * G * 0.4


@pytest.mark.parametrize("start", ["rest", "random", "collapsed", "stretched"])
@pytest.mark.parametrize(("load", "compliance"), [(0.1, 0.0), (0.1, 1e-4), (1e5, 0.0)])
@pytest.mark.parametrize("order", [pytest.param(1, marks=pytest.mark.long), 2])
def test_wild_starts_are_paid_out_and_hauled_in(device, load, compliance, start, order):
    """It ends at the limit, whole and as long as it should be."""
    random = np.random.default_rng(2)
    for rate, substeps in itertools.product((2.0, -2.0), (8, 20)):
        winch = Winch(length=1.5, acceleration=20.0, max_rate=5.0, pay_out=rate)
        rope = on_a_winch(load * MASS, 32, winch=winch, stretch_compliance=compliance)
        sim = simulation(rope, device, order=order, substeps=substeps, global_damping=1.0)
        x = sim.positions("it").astype(float)
        wound = np.linalg.norm(x, axis=1) == 0.0
        free = {"random": random.uniform(-0.5, 0.5, x.shape), "collapsed": 1e-6 * x, "stretched": 10.0 * x}
        if start != "rest":
            sim.set_positions("it", np.where(wound[:, None], x, free[start]))
        sim.step(150)
        report, x = sim.report()["it"], sim.positions("it").astype(float)
        assert report["recoveries"] == 0
        assert report["paid_out"] == pytest.approx(LENGTH if rate > 0.0 else LENGTH / 64, abs=2e-3)
        assert np.linalg.norm(np.diff(x, axis=0), axis=1).sum() == pytest.approx(report["paid_out"], rel=0.02)


def test_what_is_out_has_its_mass(device):
    """All that is out but the half of the first segment that goes with the drum."""
    sim = simulation(on_a_winch(0.0, stretch_compliance=1e-4), device)
    sim.set("it.winch.pay_out", 0.4)
    for _ in range(40):
        sim.step(7)
        arrays, span, _ = sim.device_arrays("it")
        inverse = arrays.state.positions[span].numpy()[:, 3].astype(float)
        paid_out, free = sim.report()["it"]["paid_out"], inverse > 0.0
        first = paid_out - (free.sum() - 1) * SPACING
        assert (1.0 / inverse[free]).sum() == pytest.approx(MASS / LENGTH * (paid_out - 0.5 * first), rel=1e-4)


def test_it_starts_brakes_and_stops_within_its_limits(device):
    winch = Winch(length=1.0, max_rate=0.4, acceleration=0.5, shortest=0.6, longest=1.5)
    sim = simulation(on_a_winch(2.0, winch=winch, stretch_compliance=0.0), device, substeps=8)
    settle(sim)
    for wanted, limit in ((9.0, 1.5), (-9.0, 0.6)):
        sim.set("it.winch.pay_out", wanted)
        rates = []
        for _ in range(260):
            sim.step()
            rates.append(sim.report()["it"]["pay_out"])
        assert max(np.abs(rates)) == pytest.approx(0.4, rel=1e-5)
        assert np.abs(np.diff(rates)).max() < 1.1 * 0.5 / 60
        report = sim.report()["it"]
        assert report["paid_out"] == pytest.approx(limit, abs=1e-4) and abs(report["pay_out"]) < 1e-3
        assert report["winch_stopped"] == 1
        assert sim.positions("it")[-1, 2] == pytest.approx(-limit, abs=1e-3)
    sim.set("it.winch.pay_out", 0.0)
    sim.step()
    assert sim.report()["it"]["winch_stopped"] == 0


@pytest.mark.parametrize("rate", [100.0, -100.0])
def test_the_rope_itself_ends_what_can_be_paid_out_or_hauled_in(device, rate):
    winch = Winch(length=1.0, max_rate=100.0, acceleration=1e4, pay_out=rate)
    sim = simulation(on_a_winch(1.0, winch=winch, stretch_compliance=0.0), device, substeps=20)
    sim.step(120)
    report = sim.report()["it"]
    assert report["paid_out"] == pytest.approx(LENGTH if rate > 0.0 else 0.5 * SPACING, abs=1e-3)
    assert report["recoveries"] == 0 and np.isfinite(sim.positions("it")).all()


@pytest.mark.long
@pytest.mark.parametrize("order", [1, 2])
def test_both_executors_and_many_worlds_give_the_same_state(device, order):
    axis = (0.6, 0.0, -0.8)
    found = {}
    for executor, worlds in (("block", 1), ("graph", 1), ("block", 2)):
        rope = on_a_winch(0.5, axis=axis, winch=Winch(length=1.0))
        sim = simulation(rope, device, order=order, worlds=worlds, executor=executor)
        sim.set("it.winch.pay_out", -0.7, 0 if worlds > 1 else None)
        sim.step(40)
        found[executor, worlds] = sim.positions("it"), sim.velocities("it")
        if worlds > 1:
            assert sim.report(0)["it"]["paid_out"] < 0.9 and sim.report(1)["it"]["paid_out"] == pytest.approx(1.0)
    for key in (("graph", 1), ("block", 2)):
        assert np.abs(found["block", 1][0] - found[key][0]).max() < 2e-6
        assert np.abs(found["block", 1][1] - found[key][1]).max() < 2e-3


def test_reset_goes_back_to_the_first_bit(device):
    sim = simulation(on_a_winch(0.5, axis=(0.6, 0.0, -0.8)), device, order=2)
    sim.set("it.winch.pay_out", 0.7)
    runs = []
    for _ in range(2):
        sim.step(30)
        runs.append((sim.positions("it"), sim.velocities("it"), sim.tensions("it"), sim.report()["it"]["paid_out"]))
        sim.reset()
        assert sim.report()["it"]["paid_out"] == pytest.approx(1.0, rel=1e-6)
        assert np.array_equal(sim.positions("it"), sim.rest_positions("it"))
    assert all(np.array_equal(a, b) for a, b in zip(*runs, strict=True))
    assert runs[0][3] > 1.02


def test_a_rope_that_goes_bad_is_put_back_with_its_winch(device):
    sim = simulation(on_a_winch(0.5), device)
    sim.set("it.winch.pay_out", 1.0)
    sim.step(60)
    before = sim.positions("it"), sim.report()["it"]["paid_out"]
    arrays, span, _ = sim.device_arrays("it")
    spoilt = arrays.state.velocities.numpy()
    spoilt[-1] = np.nan
    arrays.state.velocities.assign(spoilt)
    sim.step()
    report = sim.report()["it"]
    assert report["recoveries"] == 1 and report["paid_out"] == before[1]
    assert np.array_equal(sim.positions("it"), before[0])
    sim.step(60)
    assert sim.report()["it"]["recoveries"] == 1 and sim.report()["it"]["paid_out"] > before[1] + 0.2


def test_positions_that_are_set_leave_what_is_wound_on_the_drum(device):
    sim = simulation(on_a_winch(0.5), device)
    moved = sim.positions("it") + (0.5, 0.0, 0.0)
    moved[10] += 3.0
    sim.set_positions("it", moved)
    assert np.array_equal(sim.positions("it")[:40], np.tile(moved[0], (40, 1)))
    sim.set("it.winch.pay_out", 1.0)
    sim.step(30)
    assert np.abs(sim.positions("it")[:, :2] - (0.5, 0.0)).max() < 1e-4


def test_a_simulation_takes_over_from_another(device):
    one = simulation(on_a_winch(0.5), device)
    one.set("it.winch.pay_out", 0.8)
    one.step(60)
    other = simulation(on_a_winch(0.5), device)
    other.take_over("it", one)
    assert other.report()["it"]["paid_out"] == one.report()["it"]["paid_out"]
    assert np.array_equal(other.positions("it"), one.positions("it"))


def test_live_numbers_compile_nothing(device):
    sim = simulation(on_a_winch(0.5), device)
    sim.step()
    before = block.make_frame.cache_info().misses
    for field, value in {"pay_out": 0.1, "max_rate": 2, "acceleration": 3, "shortest": 0.1, "longest": 2}.items():
        sim.set(f"it.winch.{field}", value)
    sim.step()
    assert block.make_frame.cache_info().misses == before


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"pins": "end"}, "Rope.pins is 'end' with a winch at the start; allowed is 'start' or 'both'"),
        ({"pins": (0, 3)}, r"Rope.pins is \[0, 3\] with a winch at the start"),
        ({"pins": None}, "Rope.pins is None with a winch at the start"),
        ({"winch": 3}, "Rope.winch is 3; allowed is a Winch or None"),
    ],
)
def test_what_a_winch_cannot_have_is_said(change, sentence):
    with pytest.raises(ValueError, match=sentence):
        Rope(**{"winch": Winch(), **change})


@pytest.mark.parametrize(("order", "executor"), [(1, "block"), (2, "block"), (1, "graph")])
@pytest.mark.long
def test_what_bends_is_fed_between_two_hinges_as_the_elastica(device, order, executor):
    """Rise and thrust of Euler's elastica, out and in. A rope of length l over a span s has the modulus k of
    2 E(k) / K(k) - 1 = s / l, rises by k l / K(k) and thrusts with EI (2 K(k) / l)^2."""
    rope = Rope(start=(0, 0, 0), end=(2, 0, 0), segments=64, mass=0.1, pins="both", bend_compliance=10.0,
                stretch_compliance=0.0, winch=Winch(length=1.0))  # fmt: skip
    sim = Simulation(
        Scene({"it": rope}, gravity=(0, 0, -0.1)), fixed(order=order, substeps=20), device=device, executor=executor
    )
    sim.set("solver.global_damping", 5.0)
    sim.step(5)
    for pay_out, frames in ((0.2, 60), (0.5, 60), (-0.3, 100)):
        sim.set("it.winch.pay_out", pay_out)
        sim.step(frames)
        sim.set("it.winch.pay_out", 0.0)
        sim.step(150)
        length = sim.report()["it"]["paid_out"]
        m = brentq(lambda m, over=1.0 / length: 2.0 * ellipe(m) / ellipk(m) - 1.0 - over, 1e-9, 0.9)
        thrust = 0.1 * (2.0 * ellipk(m) / length) ** 2
        assert np.abs(sim.positions("it")[:, 2]).max() == pytest.approx(np.sqrt(m) / ellipk(m) * length, rel=5e-3)
        assert sim.end_wrenches("it")[:, 0] == pytest.approx([-thrust, thrust], rel=1e-2)


def test_limits_and_solvers_that_cannot_be_are_refused(device):
    with pytest.raises(ValueError, match="Winch.shortest is 2 with a longest of 1; allowed is at most that"):
        Winch(shortest=2.0, longest=1.0)
    with pytest.raises(ValueError, match="Winch.pay_out is nan; allowed is a finite number"):
        Winch(pay_out=np.nan)
    with pytest.raises(ValueError, match="with a winch on it; allowed is 'auto' or 'xpbd'"):
        simulation(on_a_winch(0.5), device, method="verlet")
    sim = simulation(on_a_winch(0.5), device, method="auto")
    with pytest.raises(ValueError, match="it.winch.pay_out is inf"):
        sim.set("it.winch.pay_out", np.inf)
    with pytest.raises(ValueError, match="it.winch.shortest is 2 with a longest of 1"):
        sim.set("it.winch.longest", 1.0)
        sim.set("it.winch.shortest", 2.0)
    with pytest.raises(ValueError, match="is fixed when a Simulation is built"):
        sim.set("it.winch.length", 2.0)
    bare = Simulation(Scene({"it": Rope(segments=3)}), device=device)
    with pytest.raises(ValueError, match="it.winch.pay_out is set but it was built without"):
        bare.set("it.winch.pay_out", 1.0)
