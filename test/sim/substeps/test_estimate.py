# SPDX-License-Identifier: Apache-2.0
"""The measured error: measuring changes nothing, and tells the size and the order of a frame's error."""

import dataclasses

import numpy as np
import pytest
import warp as wp
from fixed_settings import fixed

from cloth_sim_ros.sim import Cloth, Plane, Rope, Scene, Settings, Simulation, Sphere
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.substeps.control import chosen

SHEET = Cloth(resolution=(9, 9), pins="top", thickness=0.045, stretch_compliance=1e-3, shear_compliance=1e-3)
METHODS = {
    "order 1": {"order": 1, "iterations": 4},
    "order 2": {"order": 2, "iterations": 4},
    "graph": {"order": 2, "executor": "graph"},
}


BALL = {"ball": Sphere(radius=0.22, position=(0, 0.2, -0.24))}


def rms(vectors):
    return np.sqrt((vectors**2).sum(axis=-1).mean())


def simulation(device, substeps=40, colliders=None, executor=None, thing=SHEET, **settings):
    return Simulation(
        Scene({"it": thing}, colliders or {}), fixed(substeps=substeps, **settings), device=device, executor=executor
    )


@pytest.mark.parametrize(
    "method", ["order 2", *(pytest.param(method, marks=pytest.mark.long) for method in ("order 1", "graph"))]
)
def test_it_changes_no_bit_while_the_substeps_are_set(device, method):
    plain, watched = (simulation(device, colliders=BALL, **METHODS[method]) for _ in range(2))
    for frame in range(12):
        for sim in (plain, watched):
            sim.set_collider_pose("ball", (0, 0.2, -0.22 + 0.01 * frame))
        plain.step()
        watched.step_and_estimate() if frame % 3 == 1 else watched.step()
    for name in ("positions", "velocities"):
        assert np.array_equal(getattr(plain, name)("it"), getattr(watched, name)("it"))
    assert plain.time == watched.time


@pytest.mark.parametrize(("method", "order"), [("order 1", 1.0), ("order 2", 2.0)])
def test_it_falls_with_the_order_of_the_method(device, method, order):
    found = []
    for substeps in (10, 20, 40, 80):
        sim = simulation(device, substeps, **METHODS[method])
        sim.step(2)
        found.append(sim.step_and_estimate()["it"])
    assert np.log2(found[0] / found[3]) / 3.0 == pytest.approx(order, abs=0.35)


@pytest.mark.parametrize("method", ["order 1", "order 2"])
def test_it_is_of_the_size_of_the_error(device, method):
    """The error of ten frames, against a run of 16 times the substeps, is within a factor of 2.5 of their sum."""
    frames = 10
    sims = [simulation(device, n, **METHODS[method]) for n in (20, 320)]  # far above the rounding of positions
    estimates = [sims[0].step_and_estimate()["it"] for _ in range(frames)]
    sims[1].step(frames)
    true = np.sqrt(((sims[0].positions("it") - sims[1].positions("it")) ** 2).sum(1).mean())
    assert true / 2.5 < sum(estimates) < 2.5 * true


@pytest.mark.long
def test_a_frame_of_a_chaotic_motion_is_as_right_as_asked(device, tmp_path):
    """A towel buckles on a ball. A frame from the same state in 16 times the substeps ends close by."""
    towel = Cloth.of("cotton", resolution=(32, 32), size=(0.5, 0.5), position=(0, 0, 0.5), pins=None)
    scene = Scene({"it": towel}, {"ball": Sphere(radius=0.12, position=(0, 0, 0.25)), "floor": Plane()})
    sim, fine = (Simulation(scene, Settings(), device) for _ in range(2))
    path, shares = [sim.positions("it")], []
    for frame in range(72):
        is_compared = frame > 9 and frame % 3 == 0
        if is_compared:
            sim.save(tmp_path / f"{frame}.npz")
        before = sim.report()["it"]["substeps"]
        sim.step()
        path.append(sim.positions("it"))
        if is_compared:
            fine.load(tmp_path / f"{frame}.npz")
            fine.set("solver.substeps", int(16 * max(before, sim.report()["it"]["substeps"])))
            fine.step()
            motion = max(rms(path[-1] - path[max(0, len(path) - 31)]), 0.1 * 0.5)
            shares.append(rms(path[-1] - fine.positions("it")) / motion)
    assert np.quantile(shares, 0.95) < sim.settings.error


@pytest.mark.parametrize("thing", [SHEET, Rope(segments=20)], ids=["sheet", "rope"])
@pytest.mark.parametrize("executor", ["block", pytest.param("graph", marks=pytest.mark.long)])
def test_other_substeps_in_midair_carry_the_motion_on(device, thing, executor):
    """The history of order 2 is read off for the new length of a substep, so its error stays of second order."""
    sims = [simulation(device, n, thing=thing, order=2, iterations=2, executor=executor) for n in (40, 640)]
    for sim in sims:
        sim.step(5)
    sims[0].set("solver.substeps", 60)
    sims[0].step()
    sims[1].step()
    true = np.abs(sims[0].positions("it") - sims[1].positions("it")).max()
    before = np.abs(sims[1].velocities("it")).max() / 60
    assert true < 1e-3 * before


def test_worlds_that_move_more_take_more_substeps(device):
    sim = Simulation(Scene({"it": SHEET}), Settings(), device, worlds=3)
    sim.set_velocities("it", np.random.default_rng(1).normal(size=(81, 3)), world=1)
    sim.step(20)
    substeps = [sim.report(w)["it"]["substeps"] for w in range(3)]
    assert substeps[1] > substeps[0] == substeps[2]
    assert np.array_equal(sim.positions("it", 0), sim.positions("it", 2))


@pytest.mark.parametrize("case", ["start", "placed"])
def test_a_first_frame_is_computed_again_until_it_is_right(device, case):
    # A rope that is straight at rest is bent sharply in its middle, and springs open within milliseconds.
    turned = 3.0 * np.tanh(np.arange(60) - 29.5)
    steps = 0.02 * np.stack([np.cos(turned), np.sin(turned), 0.0 * turned], axis=1)
    bent = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    ends = {"start": (0, 0, 0), "end": (1.2, 0, 0), "segments": 60, "pins": None}
    rope = Rope(**ends, mass=0.02, stretch_compliance=1e-4, bend_compliance=1e3)
    places = []
    for settings in (Settings(), Settings(substeps=2000)):
        sim = Simulation(Scene({"it": rope}, gravity=(0, 0, 0)), settings, device=device)
        if case == "placed":
            sim.step(12)  # the next is measured
        sim.set_positions("it", bent)
        sim.step()
        places.append(sim.positions("it"))
    error, motion = (np.sqrt(((each - places[1]) ** 2).sum(axis=1).mean()) for each in (places[0], bent))
    assert error < 0.03 * motion


@pytest.mark.parametrize("frames", [3, 10])
def test_a_second_frame_is_computed_again_too(device, frames):
    """A straight rope falls freely at first; then its stretch jerks. It was off by 4 % of its way after ten frames."""
    rope = Rope(start=(0, 0, 0), end=(0.3, 0, 0), segments=24, mass=0.03, pins="both", stretch_compliance=1e-4)
    places = []
    for settings in (Settings(), Settings(substeps=2000)):
        sim = Simulation(Scene({"it": rope}), settings, device=device)
        sim.step(frames)
        places.append(sim.positions("it"))
    error, way = (np.sqrt(((each - places[1]) ** 2).sum(1).mean()) for each in (places[0], sim.rest_positions("it")))
    assert error < 0.015 * way


def test_a_body_that_is_not_finite_leaves_an_error_that_is(device):
    sim = Simulation(Scene({"it": SHEET}), Settings(), device)
    sim.step(3)
    arrays, span, _ = sim.device_arrays("it")
    rows = arrays.state.velocities[span].numpy()
    rows[40, 2] = np.nan
    arrays.state.velocities[span].assign(rows)
    sim.step(10)
    report = sim.report()["it"]
    assert report["recoveries"] == 1 and np.isfinite([report["expected_error"], report["error_per_frame"]]).all()


@pytest.mark.long
@pytest.mark.parametrize("worlds", [None, np.array([True, False])], ids=["all", "one"])
def test_coupled_bodies_start_anew_as_at_first(device, worlds):
    """Their substeps had grown; a frame stays as long as it is, whoever is reset."""
    sheet = dataclasses.replace(SHEET, self_contact=True)
    sim = Simulation(Scene({"it": sheet}), Settings(error=1e-4, budget=50.0), device, worlds=2)
    sim.step(35)
    assert sim.choices["it"].substeps > 1.5 * sim.choices["it"].least
    sim.reset(worlds)
    sim.step(6)
    fallen = sim.rest_positions("it")[0, 2] - sim.positions("it", 0)[:, 2].min()
    assert fallen == pytest.approx(0.5 * 9.81 * (6 / 60) ** 2, rel=0.1)


@compiled
def choose_each(rows: wp.array(dtype=wp.vec4), growth: float, found: wp.array(dtype=int)):
    n, share, order, error = int(rows[wp.tid()][0]), rows[wp.tid()][1], rows[wp.tid()][2], rows[wp.tid()][3]
    found[wp.tid()] = chosen(n, share, order, growth, 4, 2000, error)


def choices_of(rows, device, growth=1.0):
    """What follows from rows of substeps, share, order and wanted error."""
    given, found = wp.array(rows, dtype=wp.vec4, device=device), wp.zeros(len(rows), dtype=int, device=device)
    wp.launch(choose_each, len(rows), inputs=[given, growth, found], device=device)
    return found.numpy().tolist()


def test_substeps_grow_by_what_they_buy(device):
    """The error is 100 times what is wanted. Below 16 substeps trials cannot tell the order."""
    cases = [(100, 2.0), (100, 1.0), (100, 0.5), (100, 0.0), (8, 0.0)]
    assert choices_of([(n, 1.0, order, 0.01) for n, order in cases], device) == [300, 300, 174, 125, 24]


def test_substeps_shrink_by_the_root_of_what_the_error_asks(device):
    """A quarter of the error asks for half of the substeps in second order, and for a quarter in first."""
    cases = [(100, 0.5, 2.0), (100, 0.25, 2.0), (100, 0.25, 1.0), (100, 0.9, 2.0), (5, 0.25, 1.0)]
    rows = [(n, share, order, 1.0) for n, share, order in cases]
    assert choices_of(rows, device) == [85, 71, 65, 100, 4]
    assert choices_of(rows, device, growth=1.5) == [85, 80, 80, 100, 4]
