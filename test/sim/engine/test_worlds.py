# SPDX-License-Identifier: Apache-2.0
"""Worlds side by side: each is what a simulation of it alone would be, to the bit, whatever happens in the others."""

import dataclasses

import numpy as np
import pytest
import warp as wp
from fixed_settings import fixed

from cloth_sim_ros.sim import Cloth, Plane, Readback, Rope, Scene, Settings, Simulation, Sphere, Wind

SETTINGS = [
    (None, {"order": 2, "iterations": 2}),
    (None, {"method": "verlet", "substeps": 80}),
    pytest.param("graph", {"order": 2, "iterations": 2}, marks=pytest.mark.long),
]


def scene():
    return Scene(
        {
            "sheet": Cloth(resolution=(6, 6), pins="top", bend_compliance=0.1),
            "other": Cloth(resolution=(5, 7), position=(0, 2, 0), damping=1e-4),
            "rope": Rope(segments=9, start=(0, 0, 0.6)),
        },
        {"ball": Sphere(radius=0.2, position=(0, 0, -0.3)), "floor": Plane(position=(0, 0, -0.8))},
        Wind((1, 0, 0)),
    )


def drive(sim, number, world, frames=6):
    """What differs between worlds, and then a ball in motion; `world` is who gets it of `sim`."""
    sim.set("sheet.stretch_compliance", 1e-3 * (1 + number), world)
    sim.set("other.kinetic_friction", 0.1 * number, world)
    sim.set("ball.static_friction", 0.2 * number, world)
    sim.set("gravity", (0, number, -9), world)
    sim.set_wind((number, 1, 0), world)
    sim.set_positions("rope", sim.rest_positions("rope") + 0.1 * number, world)
    sim.set_velocities("other", np.full((35, 3), 0.1 * number), world)
    sim.set_collider_pose("floor", (0, 0, -0.5 - 0.1 * number), sweep=False, world=world)
    for frame in range(frames):
        yield lambda frame=frame: sim.set_collider_pose(
            "ball", (0, 0, -0.3 + 0.02 * number * frame), (0, 0, 0.1 * frame, 1), world=world
        )


def states(sim, world=0):
    return [read(name, world) for name in sim.scene.objects for read in (sim.positions, sim.velocities)]


@pytest.mark.long
@pytest.mark.parametrize(("executor", "settings"), SETTINGS)
def test_each_world_is_what_it_would_be_alone(device, executor, settings):
    many = Simulation(scene(), fixed(**settings), device, worlds=4, executor=executor)
    alone = [Simulation(scene(), fixed(**settings), device, executor=executor) for _ in range(4)]
    for poses in zip(
        *(drive(many, w, w) for w in range(4)), *(drive(alone[w], w, None) for w in range(4)), strict=True
    ):
        for pose in poses:
            pose()
        for sim in (many, *alone):
            sim.step()
    first = states(many, 0)
    for w in range(4):
        assert all(np.array_equal(a, b) for a, b in zip(states(many, w), states(alone[w]), strict=True)), w
        for name, told in alone[w].report().items():
            found = many.report(w)[name]
            assert found.pop("expected_error") >= told.pop("expected_error"), name  # one choice for all worlds
            assert found == told, name
        if w:
            assert all(not np.array_equal(a, b) for a, b in zip(states(many, w), first, strict=True)), "inputs differ"


@pytest.mark.long
def test_writing_without_a_world_writes_to_all(device):
    plenty = Settings(budget=100.0)  # three worlds share a budget
    many, one = (Simulation(scene(), plenty, device, worlds) for worlds in (3, 1))
    for poses in zip(drive(many, 2, None), drive(one, 2, None), strict=True):
        for pose in poses:
            pose()
        many.step()
        one.step()
    for w in range(3):
        assert all(np.array_equal(a, b) for a, b in zip(states(many, w), states(one), strict=True))


@pytest.mark.long
@pytest.mark.parametrize("executor", ["block", "graph"])
def test_a_bad_world_leaves_63_others_as_they_were(device, executor):
    """NaN forced into the state of one of 64 worlds: it alone is put back and counted."""
    sims = [
        Simulation(scene(), Settings(method="xpbd", order=2, substeps=4), device, worlds=64, executor=executor)
        for _ in range(2)
    ]
    for sim in sims:
        for w in range(64):
            sim.set_wind((0.1 * w, 1, 0), w)
        sim.step(3)
    arrays, span, _ = sims[0].device_arrays("sheet", 21)
    last_good = sims[0].positions("sheet", 21)
    rows = arrays.state.positions[span].numpy()
    rows[7, 2] = np.nan
    arrays.state.positions[span].assign(rows)
    for sim in sims:
        sim.step()
    assert np.array_equal(sims[0].positions("sheet", 21), last_good)
    assert sims[0].report(21)["sheet"]["recoveries"] == 1
    assert [sims[0].report(21)[name]["recoveries"] for name in ("other", "rope")] == [0, 0]
    for sim in sims:
        sim.step(3)
    for w in range(64):
        same = [np.array_equal(a, b) for a, b in zip(states(sims[0], w), states(sims[1], w), strict=True)]
        if w == 21:
            assert same == [False, False, True, True, True, True] and np.isfinite(sims[0].positions("sheet", w)).all()
        else:
            assert all(same) and sims[0].report(w)["sheet"]["recoveries"] == 0


@pytest.mark.long
def test_a_world_does_a_frame_again_alone(device):
    """One of four worlds is torn: its sheet alone is done again by XPBD, the others do not change by a bit."""
    one = Scene({"sheet": Cloth(resolution=(6, 6), pins="top")})
    sims = [Simulation(one, Settings(method="verlet"), device, worlds=4) for _ in range(2)]
    torn = sims[0].rest_positions("sheet") * (3.0, 3.0, 1.0)
    sims[0].set_positions("sheet", torn, world=2)
    for sim in sims:
        sim.step(10)
    assert [sims[0].report(w)["sheet"]["redone"] > 0 for w in range(4)] == [False, False, True, False]
    for w in (0, 1, 3):
        assert all(np.array_equal(a, b) for a, b in zip(states(sims[0], w), states(sims[1], w), strict=True))
    assert np.isfinite(sims[0].positions("sheet", 2)).all() and sims[0].report(2)["sheet"]["recoveries"] == 0
    sims[0].reset(2)
    assert sims[0].report(2)["sheet"]["redone"] == 0


@pytest.mark.long
def test_one_world_is_reset_alone(device):
    many = Simulation(scene(), Settings(method="xpbd", substeps=20, order=2), device, worlds=3)
    start = states(many)
    for pose in drive(many, 1, None):
        pose()
        many.step()
    last = states(many)
    many.reset(1)
    for w in range(3):
        expected = start if w == 1 else last
        assert all(np.array_equal(a, b) for a, b in zip(states(many, w), expected, strict=True))
    assert many.time > 0
    many.reset()
    assert all(np.array_equal(a, b) for w in range(3) for a, b in zip(states(many, w), start, strict=True))
    assert many.time == 0


@pytest.mark.long
def test_readback_and_springs_are_of_the_world_they_are_asked_for(device):
    many = Simulation(scene(), device=device, worlds=2)
    many.set("sheet.stretch_compliance", 1e-2, 1)
    many.step(3)
    readback = Readback(many, "sheet", normals=True, mesh=True, world=1)
    readback.request()
    assert np.array_equal(readback.particles()[:, :3], many.positions("sheet", 1))
    corners = many.positions("sheet", 1)[many.triangles("sheet")].reshape(-1, 3)
    assert np.array_equal(readback.mesh(), corners.astype(np.float64))
    constants = [many.springs("sheet", w)["structural"][2].max() for w in range(2)]
    assert constants == pytest.approx([1e3, 1e2], rel=1e-6)


@pytest.mark.parametrize(
    ("action", "words"),
    [
        (lambda sim: sim.positions("sheet", 2), "world is 2; allowed is a whole number from 0 to 1"),
        (lambda sim: sim.set_positions("sheet", sim.positions("sheet"), -1), "world is -1; allowed"),
        (lambda sim: sim.set("gravity", (0, 0, 0), 7), "world is 7; allowed"),
        (lambda sim: sim.set("solver.substeps", 7, 1), "world 1 alone; allowed"),
        (lambda sim: sim.set_collider_pose("ball", (0, 0, 0), world="1"), "world is '1'; allowed"),
        (lambda sim: sim.reset(True), "world is True; allowed"),
        (lambda sim: sim.report(2), "world is 2; allowed"),
        (lambda sim: sim.thinnest(2), "world is 2; allowed"),
        (lambda sim: sim.is_squeezing("ball", "x"), "world is 'x'; allowed"),
    ],
)
def test_worlds_that_do_not_exist_are_refused(action, words):
    alone = dataclasses.replace(scene(), objects={"sheet": scene().objects["sheet"]})
    sims = [Simulation(alone, device="cpu", worlds=2) for _ in range(2)]
    with pytest.raises(ValueError, match=words):
        action(sims[0])
    for sim in sims:
        sim.step(2)
    assert all(
        np.array_equal(a, b) for w in range(2) for a, b in zip(states(sims[0], w), states(sims[1], w), strict=True)
    )


@pytest.mark.parametrize("worlds", [0, -3, 1.5, None, True, 70000])
def test_a_number_of_worlds_is_whole_and_positive(worlds):
    with pytest.raises(ValueError, match="worlds is .*; allowed is a whole number from 1 to 65536"):
        Simulation(scene(), device="cpu", worlds=worlds)


def test_more_worlds_than_memory_are_refused():
    sheet = Scene({"sheet": Cloth(resolution=(300, 300))})
    with pytest.raises(ValueError, match=r"worlds is 65536 of .* MB each, more than the .* MB .*; allowed are up to"):
        Simulation(sheet, device="cpu", worlds=65536)


@pytest.mark.long
def test_a_tensor_shows_all_worlds_without_a_copy(device):
    sim = Simulation(scene(), fixed(), device, worlds=3)
    views = {name: sim.tensor(name, "positions") for name in sim.scene.objects}
    speeds = sim.tensor("rope", "velocities")
    sim.set("gravity", (0, 0, -5.0), world=1)
    sim.step(3)
    for name, view in views.items():
        assert view.shape == (3, len(sim.masses(name)), 3) and view.device == wp.get_device(device)
        assert np.array_equal(view.numpy(), sim.positions(name, None))
        for world in range(3):
            assert np.array_equal(view.numpy()[world], sim.positions(name, world))
    assert np.array_equal(speeds.numpy(), sim.velocities("rope", None)) and not np.array_equal(*speeds.numpy()[:2])
    if device == "cpu":
        assert np.shares_memory(np.from_dlpack(speeds), speeds.numpy())
    allowed = "positions or velocities or contact_forces or recoveries or tensions"
    with pytest.raises(ValueError, match=f"what is 'forces'; allowed of rope is {allowed}"):
        sim.tensor("rope", "forces")
    with pytest.raises(ValueError, match="there is no object 'flag'"):
        sim.tensor("flag", "positions")
