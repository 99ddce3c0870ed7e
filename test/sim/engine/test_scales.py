# SPDX-License-Identifier: Apache-2.0
"""Objects whose rest shapes differ between worlds by a scale: each world is what it would be built of that size."""

import dataclasses

import numpy as np
import pytest
import warp as wp
from fixed_settings import fixed

from cloth_sim_ros.sim import (
    Box,
    Cloth,
    Handle,
    Plane,
    Rope,
    Scene,
    Settings,
    Simulation,
    Sphere,
    Variation,
    Winch,
    Wind,
)
from cloth_sim_ros.sim.arrays.model import Model
from cloth_sim_ros.sim.engine import scaled as scaled_rows

SCALES = np.array([2.0, 0.5, 1.7])
THIN = {"thickness": 1e-3, "damping": 1e-3}  # so that all sizes are so coarse that contact looks between particles
PLATE = {"bending": "dihedral", "bend_compliance": 1e3}


def bowl(scale):
    """Vertices and triangles of an irregular mesh that is curved at rest."""
    side = np.linspace(-0.4, 0.4, 6)
    x, y = (a.ravel() for a in np.meshgrid(side, side))
    shifts = 0.02 * np.random.default_rng(4).standard_normal((2, 36))
    x, y = x + shifts[0], y + shifts[1]
    corners = np.arange(36).reshape(6, 6)
    lower = np.stack([corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:]], axis=-1)
    upper = np.stack([corners[:-1, :-1], corners[1:, 1:], corners[1:, :-1]], axis=-1)
    return scale * np.column_stack([x, y, 0.3 * x * x]), np.concatenate([lower.reshape(-1, 3), upper.reshape(-1, 3)])


def scene(scale=1.0, explicit=False):
    """Sheets that bend by springs, as a grid, and by curvature, as a mesh; ropes that bend, and by springs; all in wind
    above balls."""
    reach, turned = scale * np.array([0.75, 0.0, 0.25]), (0.1, 0.2, 0.3, 0.9)
    rope = {"stretch_compliance": 1e-3} if explicit else {"bend_compliance": 1e2}
    rope |= {"start": (1, 6, 1), "end": (1 + reach[0], 6, 1 + reach[2]), "radius": 1e-3, "segments": 8}
    springs = {"bending": "springs", "bend_compliance": 0.1}
    objects = {
        "grid": Cloth((7, 6), (0.8 * scale, 0.6 * scale), pins="top", position=(0, 0, 1), **springs, **THIN),
        "mesh": Cloth.from_mesh(*bowl(scale), pins=(0, 35), position=(0, 3, 1), orientation=turned, **PLATE, **THIN),
        "rope": Rope(pins=(0, 1), end_mass=0.1, damping=1e-3, **rope),
    }
    balls = {f"ball {y}": Sphere(0.3, position=(0, y, 0.6)) for y in (0, 3)}
    return Scene(objects, balls, Wind((1, 2, 0)))


def states(sim, world=0):
    return [read(name, world) for name in sim.scene.objects for read in (sim.positions, sim.velocities)]


def equal(a, b):
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def built(scale, settings, device, explicit=False):
    """A simulation of as many worlds, whose scene has this size; by the executor that scaled worlds have."""
    return Simulation(scene(scale, explicit), settings, device, worlds=len(SCALES), executor="block")


def scaled(settings, device, explicit=False):
    sim = Simulation(scene(1.0, explicit), settings, device, worlds=len(SCALES))
    for name in sim.scene.objects:
        sim.set(f"{name}.scale", SCALES)
    return sim


@pytest.mark.long
@pytest.mark.parametrize(
    "settings",
    [{"order": 2}, {"order": 1, "iterations": 2}, {"method": "verlet", "substeps": 200}],
    ids=["order 2", "order 1", "verlet"],
)
def test_each_world_moves_as_a_scene_of_its_size(device, settings):
    """Explicit steps until they touch a ball: from then on they make a thousand times as much of the last bit."""
    explicit = settings.get("method") == "verlet"
    frames = 8 if explicit else 12
    many = scaled(fixed(**settings), device, explicit)
    for w, scale in enumerate(SCALES):
        alone = built(scale, fixed(**settings), device, explicit)
        alone.step(frames)
        if w == 0:
            many.step(frames)
        touches = [many.report(w)[name]["contacts"] > 0 for name in ("grid", "mesh")]
        assert touches == [not explicit, scale == 0.5 and not explicit]
        for name in alone.scene.objects:  # contact makes up to 4e-5 m of a last bit, in a scene of this size too
            rounds = scale == 1.7 and name == "grid" and touches[0]
            assert np.abs(many.positions(name, w) - alone.positions(name)).max() < (1e-4 if rounds else 1e-6)
        if not explicit and scale != 1.7:  # a power of 2 rounds nothing, but in how a mesh is found to be curved
            assert all(np.array_equal(many.velocities(name, w), alone.velocities(name)) for name in ("grid", "rope"))
        for name in alone.scene.objects:
            assert np.allclose(many.rest_positions(name, w), alone.rest_positions(name), rtol=1e-6, atol=1e-12)
            for kind, (pairs, rest, constant) in alone.springs(name).items():
                found = many.springs(name, w)[kind]
                assert np.array_equal(found[0], pairs)
                assert np.allclose(found[1], rest, rtol=1e-12) and np.allclose(found[2], constant, rtol=1e-12)
            for what, value in alone.report()[name].items():
                if what in ("max_strain", "kinetic_energy", "max_tension", "end_tension"):
                    assert many.report(w)[name][what] == pytest.approx(value, rel=1e-3, abs=1e-6)
        assert many.get("mesh.scale", w) == scale


@pytest.mark.parametrize("settings", [{"order": 2}, {"method": "verlet", "substeps": 200}], ids=["xpbd", "verlet"])
@pytest.mark.long
def test_each_world_has_the_arrays_of_a_scene_of_its_size(device, settings):
    """All of them, those too that only a fault or contact with itself reads."""
    explicit = settings.get("method") == "verlet"
    many = scaled(fixed(**settings), device, explicit)
    for w, scale in enumerate(SCALES):
        alone = built(scale, fixed(**settings), device, explicit)
        for name in many.scene.objects:
            found, wanted = (sim.device_arrays(name, w)[0].model for sim in (many, alone))
            for array in Model.vars:
                rows, expected = (getattr(model, array) for model in (found, wanted))
                if not isinstance(rows, wp.array):
                    assert rows == expected, array
                elif array == "bodies":
                    assert [*map(list, rows.numpy())] == [pytest.approx(list(row), 1e-6) for row in expected.numpy()]
                elif rows.size and array != "seams":
                    least = 0.0 if array == "line_rests" else -np.inf  # below 0 where there is no spring
                    rows, expected = (np.maximum(each.numpy(), least) for each in (rows, expected))
                    assert np.allclose(rows, expected, rtol=1e-6, atol=1e-10), (array, name, scale)


def test_it_compiles_for_cuda(tmp_path):
    wp.compile_aot_module(wp.get_module(scaled_rows.__name__), arch=90, module_dir=tmp_path, use_ptx=True)


@pytest.mark.long
def test_scales_are_live_by_mask_outlive_a_reset_and_are_saved(device, tmp_path):
    settings = fixed(order=2)
    many, alone = scaled(settings, device), built(0.5, settings, device)
    for sim in (many, alone):
        sim.step(5)
    before = states(many, 0), states(many, 2)
    mask = np.array([False, True, False])
    for name in many.scene.objects:
        many.set(f"{name}.scale", 1 / SCALES, mask)
    assert equal(states(many, 0), before[0]) and equal(states(many, 2), before[1]), "nothing happens to other worlds"
    assert np.array_equal(many.positions("mesh", 1), many.rest_positions("mesh", 1)), "and this one starts anew"
    assert not many.velocities("mesh", 1).any()
    for name in many.scene.objects:
        many.set(f"{name}.scale", 0.5, 1)
    many.reset(mask)
    many.save(tmp_path / "state.npz")
    other = Simulation(scene(), settings, device, worlds=3)
    other.load(tmp_path / "state.npz")
    assert [other.get("rope.scale", w) for w in range(3)] == SCALES.tolist()
    alone.reset()
    for sim in (many, other, alone):
        sim.step(5)
    assert equal(states(many, 1), states(alone)) and not equal(states(many, 1), states(many, 2))
    assert all(equal(states(many, w), states(other, w)) for w in range(3))
    many.load(tmp_path / "state.npz")
    many.set("grid.pins", "corners")  # for which all is built anew
    for sim in (other, alone):
        sim.reset()
        sim.set("grid.pins", "corners")
    many.reset()
    for sim in (many, other, alone):
        sim.step(5)
    assert equal(states(many, 1), states(alone)) and equal(states(other, 1), states(alone))


def test_what_is_alike_but_in_its_scale_is_kept_apart(device):
    sheet = Cloth((5, 5), pins="top", **THIN)
    sims = [
        Simulation(Scene({"a": sheet, "b": dataclasses.replace(sheet, position=(0, 2, 0))}), fixed(), device, 2)
        for _ in "12"
    ]
    sims[0].set("a.scale", 2.0)
    for other, scale in (("b", 0.5), ("b", 1.0)):
        sims[0].set(f"{other}.scale", scale, 1)
        assert np.array_equal(sims[0].positions("b", 0), sims[1].positions("b", 0))
        assert np.ptp(sims[0].positions("b", 1), axis=0) == pytest.approx([scale, scale, 0], rel=1e-6)
        assert np.ptp(sims[0].positions("a", 1), axis=0) == pytest.approx([2, 2, 0], rel=1e-6)


@pytest.mark.long
def test_a_file_is_loaded_where_the_object_was_moved_out_of_a_collider(device, tmp_path):
    """It is then larger about its place there."""
    scenes = [
        Scene({"it": Cloth((4, 4), (0.2, 0.2), pins="none", position=(0, 0, 0.5))}, {"box": Box(position=place)})
        for place in ((0, 0, -1), (0, 0, 0.44))
    ]
    above, inside = (Simulation(scene, fixed(), device, 2) for scene in scenes)
    up = inside.rest_positions("it") - above.rest_positions("it")
    above.set("it.scale", 3.0, 1)
    above.save(tmp_path / "state.npz")
    inside.load(tmp_path / "state.npz")
    assert list(inside.moved) == ["it"] and up[:, 2].min() > 0.03
    for world in range(2):
        assert np.allclose(inside.rest_positions("it", world), above.rest_positions("it", world) + up, atol=1e-6)


@pytest.mark.long
def test_a_pose_is_that_of_a_body_of_its_size(device):
    many, pose = scaled(fixed(order=2), device), np.array([0.3, -0.2, 2.0, *(0.5 * np.array([1.0, 1.0, -1.0, 1.0]))])
    for name in many.scene.objects:
        many.write(name, "pose", np.tile(pose, (3, 1)))
        for w, scale in enumerate(SCALES):
            alone = dataclasses.replace(scene(scale).objects[name], position=pose[:3], orientation=pose[3:])
            expected = Simulation(Scene({"it": alone}), fixed(order=2), device).rest_positions("it")
            assert np.allclose(many.positions(name, w), expected, atol=2e-7)


@pytest.mark.parametrize("kind", [*(pytest.param(kind, marks=pytest.mark.long) for kind in ("mesh", "grid")), "rope"])
def test_the_choice_is_that_of_the_smallest_world(device, kind):
    """The smaller it is, the stiffer a mesh or a grid bends, and the stiffer the segments of a rope are."""

    def thing(scale):
        if kind == "rope":
            return Rope(segments=8, end=(scale, 0, 1), stretch_compliance=1e-3)
        if kind == "mesh":
            return Cloth.from_mesh(*bowl(scale), **PLATE)
        return Cloth((8, 8), (scale, scale), bending="dihedral", bend_compliance=10.0)

    settings = Settings(method={"rope": "verlet", "mesh": "auto", "grid": "xpbd"}[kind])
    # As many worlds: prices on a GPU depend on how many there are.
    small, sim = (Simulation(Scene({"it": thing(scale)}), settings, device, worlds=8) for scale in (0.02, 1.0))
    wanted, whole = small.choices["it"], sim.choices["it"]
    sim.set("it.scale", 0.02, 5)
    found = sim.choices["it"]
    assert (found.method, found.substeps, found.safe_substeps) == (wanted.method, wanted.substeps, wanted.safe_substeps)
    assert found.bending_share == pytest.approx(wanted.bending_share, rel=1e-5)
    assert found.substeps > whole.substeps and found.reason == f"{wanted.reason}; its scale may differ between worlds"
    sim.set("it.scale", 1.0)
    assert (sim.choices["it"].method, sim.choices["it"].substeps) == (whole.method, whole.substeps)


def test_the_largest_world_decides_what_rounding_heats(device):
    """Long springs that are stiff are no longer for explicit steps."""
    small, large = (Cloth((8, 8), (size, size), stretch_compliance=1e-5) for size in (1.0, 900.0))
    sim = Simulation(Scene({"it": small}), Settings(method="verlet"), device, 2)
    with pytest.raises(ValueError, match="too stiff for explicit steps"):
        Simulation(Scene({"it": large}), Settings(method="verlet"), device, 2)
    with pytest.raises(ValueError, match="too stiff for explicit steps"):
        sim.set("it.scale", 900.0, 1)


@pytest.mark.long
def test_the_largest_world_decides_whether_colliders_come_between_particles(device):
    sim = Simulation(
        Scene({"it": Cloth((9, 9), (0.2, 0.2))}, {"ball": Sphere(0.5, position=(0, 0, -3))}), fixed(), device, 2
    )
    assert not sim.choices["it"].surface
    sim.set("it.scale", 10.0, 1)
    assert sim.choices["it"].surface
    sim.set("it.scale", 1.0, 1)
    assert not sim.choices["it"].surface


def test_positions_strain_only_worlds_of_another_size(device):
    """What is strained by more than half is taken with a nudge; what is at rest in its world, as it is given."""
    sim = Simulation(Scene({"it": Cloth.from_mesh(*bowl(1.0))}), None, device, 2)
    sim.set("it.scale", 3.0, 1)
    for world, nudged in ((1, False), (0, True)):
        given = sim.rest_positions("it", 1)
        sim.set_positions("it", given, world)
        assert (np.abs(sim.positions("it", world) - given).max() > 0.0) == nudged
    sim.set("it.scale", 0.01, 1)
    sim.set_positions("it", sim.rest_positions("it", 0), 1)
    moved = np.abs(sim.positions("it", 1) - sim.rest_positions("it", 0)).max()
    assert 0.0 < moved < 3e-8, "by a hundred-thousandth of a spring of that world"


@pytest.mark.long
def test_scales_are_drawn_and_hands_grasp_what_is_there_then(device):
    corner = Handle(position=(0.5, 0.5, 0), reach=0.05, attached=True)
    objects = {"it": Cloth((2, 2), pins="none"), "line": Rope(segments=6, start=(0, 3, 0), end=(1, 3, 0))}
    sim = Simulation(Scene(objects, handles={"hand": corner}), fixed(), device, worlds=4)
    vary = {"it.scale": {"uniform": [1.2, 2]}, "line.scale": {"log_uniform": [0.5, 2]}}
    drawn = Variation(vary, 3).apply(sim)
    assert [sim.held("hand", w) for w in range(4)] == [0, 0, 0, 0], "the corner is elsewhere"
    for w in range(4):
        line = sim.positions("line", w)
        assert np.allclose(line[[0, -1]], [[0, 3, 0], [drawn["line.scale"][w], 3, 0]], atol=1e-6)
        assert np.ptp(sim.positions("it", w)[:, 0]) == pytest.approx(drawn["it.scale"][w], rel=1e-6)
    size = drawn["it.scale"][:, None] * [0.5, 0.5]
    sim.write("hand", "pose", np.column_stack([size, np.tile([0, 0, 0, 0, 1], (4, 1))]), sweep=False)
    Variation(vary, 3).apply(sim)
    assert [sim.held("hand", w) for w in range(4)] == [1, 1, 1, 1]


@pytest.mark.long
def test_bad_scales_are_refused_and_change_nothing(device):
    objects = {
        "it": Cloth((4, 4), position=(0, -2, 1), **PLATE),
        "line": Rope(segments=4, start=(0, 2, 1), end=(1, 2, 1)),
        "deep": Cloth((4, 4), (0.2, 0.2), pins="none", position=(0, 0, -0.1)),
    }
    sim = Simulation(Scene(objects, {"floor": Plane()}), fixed(method="verlet", substeps=40), device, worlds=2)
    assert "deep" in sim.moved
    sim.set("it.scale", np.array([1.0, 1.5]))
    before = states(sim, 1)
    bad = {
        "it.scale": (0.0, "it.scale is 0.0; allowed is a finite number from 0.001 to 1000"),
        "line.scale": (np.array([1.0, np.nan]), r"line.scale has shape \(2,\) with values .* each is a finite number"),
        "floor.scale": (2.0, "floor.scale is fixed when a Simulation is built"),
        "deep.scale": (2.0, "deep.scale is set but deep started inside of a collider and was moved out; allowed is"),
    }
    for name, (value, words) in bad.items():
        with pytest.raises(ValueError, match=words):
            sim.set(name, value)
    with pytest.raises(ValueError, match="substeps is 40 with method 'verlet'; allowed is at least .* of line"):
        sim.set("line.scale", np.array([1.0, 0.001]))
    with pytest.raises(ValueError, match="substeps is 40 with method 'verlet'; allowed is at least .* of it"):
        sim.set("it.scale", 0.001)
    for bad_world in (-1, 2):
        for read in (sim.springs, sim.rest_positions):
            with pytest.raises(ValueError, match="allowed is a whole number from 0 to 1"):
                read("it", bad_world)
    assert [sim.get("it.scale", w) for w in range(2)] == [1.0, 1.5] and sim.get("line.scale", 1) == 1.0
    assert equal(states(sim, 1), before)
    sim.set("it.scale", 1.2, 0)
    assert [sim.get("it.scale", w) for w in range(2)] == [1.2, 1.5]
    one_size = {"hangs on a winch": Rope(segments=4, winch=Winch(0.5)), "tears": Cloth((4, 4), tear_strain=0.5)}
    for words, thing in one_size.items():
        sim = Simulation(Scene({"it": thing}), fixed(), device, worlds=2)
        with pytest.raises(ValueError, match=f"it.scale is set but it {words}; allowed is"):
            sim.set("it.scale", 2.0)


def test_a_scale_leaves_the_mass_which_may_be_set_to_follow(device):
    sim = Simulation(Scene({"sheet": Cloth((5, 5), (0.4, 0.4), mass=0.2)}), fixed(substeps=10), device, 3)
    sim.set("sheet.scale", SCALES)
    assert [sim.masses("sheet", w).sum() for w in range(3)] == pytest.approx([0.2, 0.2, 0.2])
    sim.set("sheet.mass", 0.2 * SCALES**2)
    assert [sim.masses("sheet", w).sum() for w in range(3)] == pytest.approx(0.2 * SCALES**2)
