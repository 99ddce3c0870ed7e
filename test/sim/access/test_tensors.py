# SPDX-License-Identifier: Apache-2.0
"""All worlds at once: what is read, written, set and reset by arrays and masks is what simulations alone would have."""

import numpy as np
import pytest
import warp as wp
from fixed_settings import fixed

from cloth_sim_ros.sim import Cloth, Handle, Plane, Rope, Scene, Simulation, Sphere, Surface, Wind

WORLDS = 4
MASK = np.array([False, True, False, True])


def scene():
    return Scene(
        {
            "sheet": Cloth(resolution=(6, 6), pins="top", bend_compliance=0.1),
            "rope": Rope(segments=9, start=(0, 0, 0.6), end=(1, 0, 0.6)),
        },
        {"ball": Sphere(radius=0.2, position=(0, 0, -0.3))},
        Wind((1, 0, 0)),
        handles={"hand": Handle(position=(1, 0, 0.6), reach=0.15, attached=True, object="rope")},
    )


def states(sim, world=0):
    return [read(name, world) for name in sim.scene.objects for read in (sim.positions, sim.velocities)]


def make(device, **settings):
    settings = settings or {"order": 2, "iterations": 2}
    return Simulation(scene(), fixed(**settings), device, worlds=WORLDS), [
        Simulation(scene(), fixed(**settings), device) for _ in range(WORLDS)
    ]


def same(many, alone, worlds=range(WORLDS)):
    return all(np.array_equal(a, b) for w in worlds for a, b in zip(states(many, w), states(alone[w]), strict=True))


def numbers(seed):
    """What differs between worlds: live parameter -> array of all worlds."""
    random = np.random.default_rng(seed)
    return {
        "sheet.stretch_compliance": 10.0 ** random.uniform(-3, -2, WORLDS),
        "sheet.damping": random.uniform(0, 1e-3, WORLDS),
        "sheet.kinetic_friction": random.uniform(0, 1, WORLDS),
        "ball.static_friction": random.uniform(0, 1, WORLDS),
        "hand.compliance": random.uniform(0, 1e-2, WORLDS),
        "wind.velocity": random.normal(size=(WORLDS, 3)),
        "wind.air_density": random.uniform(1, 2, WORLDS),
        "gravity": random.normal([0, 0, -9], 1, (WORLDS, 3)),
    }


def poses(seed, height):
    random = np.random.default_rng(seed)
    turned = random.normal(size=(WORLDS, 4))
    return np.column_stack([random.uniform(-0.02, 0.02, (WORLDS, 2)), np.full(WORLDS, height), turned])


@pytest.mark.long
def test_arrays_and_masks_write_what_single_worlds_would(device):
    many, alone = make(device)
    for name, values in numbers(1).items():
        many.set(name, values)
        for w, sim in enumerate(alone):
            sim.set(name, values[w])
    random = np.random.default_rng(2)
    places = many.rest_positions("rope") + random.uniform(0, 0.05, (WORLDS, 10, 3))
    speeds = random.normal(size=(WORLDS, 36, 3)).astype(np.float32)
    many.write("rope", "positions", places, MASK)
    many.write("sheet", "velocities", wp.array(speeds, dtype=float, device=device))
    ball, hand = poses(3, -0.3), poses(4, 0.6) + [1, 0, 0, 0, 0, 0, 0]
    many.write("ball", "pose", ball, MASK, sweep=False)
    many.write("hand", "pose", hand)
    for w, sim in enumerate(alone):
        sim.set_velocities("sheet", speeds[w])
        sim.set_handle_pose("hand", hand[w, :3], hand[w, 3:])
        if MASK[w]:
            sim.set_positions("rope", places[w])
            sim.set_collider_pose("ball", ball[w, :3], ball[w, 3:], sweep=False)
    for sim in (many, *alone):
        sim.step(4)
    assert same(many, alone)
    assert np.array_equal(many.tensor("hand", "pose").numpy()[:, :3], np.float32(hand[:, :3]))
    for name in ("ball", "hand"):
        told = many.tensor(name, "wrench").numpy()
        for w, sim in enumerate(alone):
            load = sim.wrench(name) if name == "ball" else sim.handle_wrench(name)
            assert np.array_equal(told[w], np.concatenate(load)), name
    assert np.abs(many.tensor("hand", "wrench").numpy()).min() > 0


@pytest.mark.long
@pytest.mark.parametrize("settings", [{}, {"method": "verlet", "substeps": 80}])
def test_a_masked_reset_is_that_of_a_lone_simulation_and_touches_nothing_else(device, settings):
    many, alone = make(device, **settings)
    fresh = make(device, **settings)[1]
    for sim in (many, *alone):
        sim.set_collider_pose("ball", (0, 0.1, -0.1))
        sim.set_handle_pose("hand", (1, 0, 0.8))
        sim.step(8)
    before = states(many, 0)
    many.reset(MASK)
    for w in np.flatnonzero(MASK):
        alone[w].reset()
    assert all(np.array_equal(a, b) for a, b in zip(states(many, 0), before, strict=True)) and many.time > 0
    for sim in (many, *alone, *fresh):
        sim.step(5)
    assert same(many, alone)
    assert same(many, fresh, np.flatnonzero(MASK).tolist()), "nothing is left of what was before"
    assert not same(many, fresh, np.flatnonzero(~MASK).tolist())
    assert list(many.held("hand")) == [alone[0].held("hand")] * WORLDS


@pytest.mark.long
def test_masks_come_from_any_library(device):
    many, _ = make(device)
    many.step(2)
    for mask in (MASK, list(MASK), wp.array(MASK, dtype=bool, device=device)):
        many.set("gravity", (0, 0, 5.0), MASK)
        many.reset(mask)
    many.set("sheet.damping", 1e-3, ~MASK)
    assert [many.get("gravity", w)[2] for w in range(WORLDS)] == [-9.81, 5.0, -9.81, 5.0]
    assert [many.get("sheet.damping", w) for w in range(WORLDS)] == [1e-3, 0.0, 1e-3, 0.0]
    rest = many.rest_positions("rope")
    assert [np.array_equal(many.positions("rope", w), rest) for w in range(WORLDS)] == list(MASK)
    assert many.positions("rope", MASK).shape == (2, 10, 3)
    many.release("hand", MASK)
    assert [count > 0 for count in many.held("hand")] == list(~MASK) and list(many.held("hand", MASK)) == [0, 0]


@pytest.mark.long
def test_a_mask_tells_which_worlds_were_put_back(device):
    many, _ = make(device)
    many.step()
    arrays, span, _ = many.device_arrays("rope", 2)
    rows = arrays.state.positions[span].numpy()
    rows[7, 2] = np.nan
    arrays.state.positions[span].assign(rows)
    assert not many.recovered().any()
    many.step()
    assert list(many.recovered()) == [False, False, True, False]
    assert list(many.tensor("rope", "recoveries").numpy()) == [0, 0, 1, 0]
    assert not many.tensor("sheet", "recoveries").numpy().any()
    many.reset(many.recovered())
    assert not many.recovered().any() and not many.tensor("rope", "recoveries").numpy().any()


@pytest.mark.parametrize("settings", [{}, {"method": "verlet", "substeps": 300}], ids=["chain", "springs"])
def test_tensions_of_ropes_that_hang_are_the_weight_below(device, settings):
    """In each world by its own gravity; the tensor shows the state when it was asked for."""
    rope = Rope(segments=8, mass=0.9, start=(0, 0, 0), end=(0, 0, -1), damping=0.05, stretch_compliance=1e-3)
    sim = Simulation(Scene({"rope": rope}), fixed(**settings), device, worlds=3)
    gravity = np.array([4.0, 8.0, 12.0])
    sim.set("gravity", np.column_stack([0 * gravity, 0 * gravity, -gravity]))
    sim.step(240)
    below = np.cumsum(sim.masses("rope")[::-1])[::-1][1:]
    pulls = sim.tensor("rope", "tensions")
    assert pulls.shape == (3, 8) and np.allclose(pulls.numpy(), gravity[:, None] * below, rtol=5e-3)
    assert all(np.array_equal(pulls.numpy()[w], sim.tensions("rope", w)) for w in range(3))
    with pytest.raises(ValueError, match="allowed of rope is .* tensions"):
        sim.tensor("rope", "wrench")


@pytest.mark.parametrize("others", [0, 2])
@pytest.mark.long
def test_contact_forces_of_what_lies_carry_its_weight(device, others):
    """Those of one collider are a view, those of several are added up; a particle in the air feels none."""
    sheet = Cloth(resolution=(5, 5), pins="none", position=(0, 0, 0.004), thickness=0.004, mass=0.2)
    balls = {f"ball{k}": Sphere(radius=0.1, position=(0.3 * k, 0, -0.1)) for k in range(others)}
    rope = Rope(segments=4, start=(0, 0, 3), end=(1, 0, 3))
    objects = {"rope": rope, "sheet": sheet}
    sim = Simulation(Scene(objects, {"table": Plane(), **balls}), fixed(), device, worlds=2)
    sim.set("gravity", np.array([[0, 0, -5.0], [0, 0, -10.0]]))
    sim.step(30)
    pushes = sim.tensor("sheet", "contact_forces")
    sim.step(30)
    if others:
        sim.tensor("sheet", "contact_forces")
    assert pushes.shape == (2, 25, 3)
    assert np.allclose(pushes.numpy().sum(axis=1), [[0, 0, 1.0], [0, 0, 2.0]], atol=0.01)
    assert not sim.tensor("rope", "contact_forces").numpy().any()
    wrench = sum(sim.tensor(name, "wrench").numpy()[:, :3] for name in sim.scene.colliders)
    assert np.allclose(pushes.numpy().sum(axis=1), -wrench, atol=1e-5)


@pytest.mark.long
@pytest.mark.parametrize(
    ("action", "words"),
    [
        (lambda sim: sim.reset(MASK[:3]), r"mask of worlds has shape \(3,\) of bool; allowed is \(4,\) of bool"),
        (lambda sim: sim.reset(np.arange(4)), r"mask of worlds has shape \(4,\) of int64; allowed is \(4,\) of bool"),
        (lambda sim: sim.set("gravity", np.zeros((3, 3))), r"gravity has shape \(3, 3\) .* allowed are \(4, 3\)"),
        (lambda sim: sim.set("sheet.damping", [0, 1, -1, 0]), r"sheet.damping has shape \(4,\) with values from -1 to"),
        (lambda sim: sim.set("sheet.damping", [0, 1, np.nan, 0]), "sheet.damping has shape"),
        (lambda sim: sim.set("sheet.damping", [0, 1, 1, 0], 1), "sheet.damping is an array of all worlds for world 1"),
        (lambda sim: sim.set("wind.velocity", [0, 1, 1, 0]), "wind.velocity is .*; allowed is 3 finite numbers"),
        (lambda sim: sim.write("sheet", "positions", np.zeros((4, 35, 3))), r"have shape \(4, 35, 3\); allowed is"),
        (lambda sim: sim.write("sheet", "positions", np.full((4, 36, 3), np.nan)), "not finite or too large; allowed"),
        (
            lambda sim: sim.write("sheet", "positions", "far"),
            r"sheet positions are 'far'; allowed is an array of numbers",
        ),
        (lambda sim: sim.write("ball", "pose", {"x": 1}), "ball pose are .* allowed is an array of numbers"),
        (lambda sim: Surface(sim, "sheet", world=7), "world is 7; allowed"),
        (lambda sim: sim.write("sheet", "wrench", np.zeros((4, 7))), "what is 'wrench'; allowed of sheet is positions"),
        (lambda sim: sim.write("sheet", "pose", np.zeros((4, 7))), "sheet.orientation is .* in row 0; allowed"),
        (lambda sim: sim.write("sheet", "pose", np.full((4, 7), np.nan)), "sheet.position has shape .* allowed are"),
        (lambda sim: sim.write("ball", "pose", np.zeros((4, 7))), "ball.orientation is .* in row 0; allowed"),
        (lambda sim: sim.write("ball", "pose", np.full((4, 7), 1e9)), r"ball.position has shape .* allowed are \(4, 3"),
        (lambda sim: sim.write("flag", "pose", np.zeros((4, 7))), "no object 'flag', nor a collider .* hand"),
        (lambda sim: sim.tensor("hand", "positions"), "what is 'positions'; allowed of hand is pose or wrench"),
    ],
)
def test_arrays_and_masks_that_cannot_be_are_refused(action, words):
    sim, _ = make("cpu")
    before = [states(sim, w) for w in range(WORLDS)]
    with pytest.raises(ValueError, match=words):
        action(sim)
    after = [states(sim, w) for w in range(WORLDS)]
    assert all(np.array_equal(a, b) for x, y in zip(before, after, strict=True) for a, b in zip(x, y, strict=True))


def test_sixteen_worlds_of_16x16_differ_in_one_call(device):
    """Each sheet hangs at rest as its own gravity and compliance say: by the sum of loads along its threads."""
    sheet = Cloth(resolution=(16, 16), size=(1, 1), mass=0.1, pins="top", shear_compliance=None, damping=0.01)
    sim = Simulation(Scene({"sheet": sheet}), fixed(), device, worlds=16)
    compliance, pull = np.geomspace(1e-3, 1e-2, 16), np.linspace(5, 10, 16)
    sim.set("sheet.stretch_compliance", compliance)
    sim.set("gravity", np.column_stack([np.zeros(16), pull, np.zeros(16)]) * [1, -1, 1])
    sim.set("solver.global_damping", 5.0)
    sim.step(240)
    hem = sim.tensor("sheet", "positions").numpy()[:, :, 1].min(axis=1)
    scale = sim.springs("sheet", 0)["structural"][2].max() * compliance[0]  # of a thread inside the sheet
    fall = 0.1 / 15**2 * pull * (np.arange(15) + 0.5).sum() * compliance / scale  # a spring carries all that is below
    assert np.allclose(-0.5 - hem, fall, rtol=0.01), (-0.5 - hem) / fall
