# SPDX-License-Identifier: Apache-2.0
"""A state that was saved goes on to the bits of a run that never stopped; what is no such state is refused."""

import json
import random
import resource
from dataclasses import replace

import numpy as np
import pytest

from cloth_sim_ros.sim import Box, Cloth, Handle, Rope, Scene, Settings, Simulation, Sphere, Winch, Wind
from cloth_sim_ros.sim.batch import forced_schedule

FRAMES = 30
BALL = Sphere(position=(0.0, 0.1, 0.9), radius=0.15)


def cloth_scene(**more):
    """A sheet that bends, in wind, over a ball, with a hand at a free corner and room for another collider."""
    cloth = Cloth(
        resolution=(8, 7),
        size=(0.7, 0.6),
        position=(0, 0, 1.1),
        damping=1e-3,
        **{"bending": "dihedral", "bend_compliance": 1e3, **more},
    )
    hand = Handle(position=(-0.35, -0.3, 1.1), reach=0.12, compliance=1e-4, break_force=50.0)
    return Scene({"cloth": cloth}, {"ball": BALL}, Wind((0.0, 2.0, 0.5)), handles={"hand": hand}, spare_colliders=1)


def scene_without_hand():
    """The same without a hand, which tiles lack."""
    return replace(cloth_scene(), handles={})


def ropes_scene():
    """A rope on a winch and one under twist, both over a ball, in wind."""
    winch = Winch(length=0.5, pay_out=0.3, max_rate=2.0, acceleration=3.0)
    cable = Rope(segments=10, start=(0, 0.1, 1.6), end=(0, 0.1, 0.6), end_mass=0.1, damping=1e-3, winch=winch)
    hose = Rope(
        segments=8,
        start=(-0.4, 0, 1.1),
        end=(0.4, 0, 1.1),
        pins=(0, 1, 7, 8),
        bend_compliance=50.0,
        twist_compliance=20.0,
        stretch_compliance=1e-3,
        edge_contact=True,
    )
    return Scene({"cable": cable, "hose": hose}, {"ball": BALL}, Wind((0.0, 2.0, 0.5)))


def drive(sim, k):
    """What happens before frame k: everything that may be told to a simulation while it runs."""
    world = sim.worlds - 1
    sim.set_collider_pose("ball", (0.02 * np.sin(k), 0.1, 0.9 + 0.01 * k), (0, 0, np.sin(0.1 * k), np.cos(0.1 * k)))
    if k == 3:
        sim.set_wind((0.5, 4.0, 0.0), world)
        sim.set("gravity", (0.1, 0.0, -9.7), world)
    if k == 16:
        sim.set("solver.global_damping", 0.3)
    if "cloth" in sim.scene.objects:
        drive_cloth(sim, k, world)
    else:
        drive_ropes(sim, k)


def drive_cloth(sim, k, world):
    if "hand" in sim.scene.handles:
        drive_hand(sim, k, world)
    if k == 4:
        sim.set("cloth.stretch_compliance", 3e-3, world)
    if k == 6:
        sim.add_collider("box", Box(position=(0.2, -0.2, 1.0), half_extents=(0.1, 0.1, 0.05), static_friction=0.9))
    if k == 9:
        sim.set("cloth.pins", [0, 7, 49])
    if k == 13 and sim.settings.method == "auto":  # beyond what explicit steps are for
        sim.set_positions("cloth", 1.7 * sim.positions("cloth"))
    if k == 20:
        fast = np.zeros((56, 3))
        fast[10] = 5e5  # runs away, and is put back
        sim.set_velocities("cloth", fast, world)
    if k == 24:
        sim.remove_collider("box")


def drive_hand(sim, k, world):
    sim.set_handle_pose("hand", (-0.35, -0.3, 1.1 + 0.005 * k), world=world)
    if k == 4:
        sim.attach("hand")
    if k == 24:
        sim.set("hand.break_force", 0.01)


def drive_ropes(sim, k):
    sim.set("hose.end_turn", 0.1 * k)
    if k == 12:
        sim.set("cable.winch.pay_out", -1.5)
    if k == 18:
        sim.set("hose.bend_compliance", 20.0)


CASES = {
    "auto": (cloth_scene, {}, 1, None),
    "order 1, two worlds": (cloth_scene, {"method": "xpbd", "order": 1, "substeps": 8}, 2, None),
    "order 2, a launch a stage": (cloth_scene, {"method": "xpbd", "order": 2, "substeps": 8}, 1, "coloured"),
    "verlet in rows": (cloth_scene, {"method": "verlet"}, 1, None),
    "verlet in tiles, two worlds": (scene_without_hand, {"method": "verlet"}, 2, "tiled"),
    "ropes": (ropes_scene, {}, 1, None),
    "ropes, a launch a stage, order 1": (ropes_scene, {"method": "xpbd", "order": 1, "substeps": 8}, 1, "coloured"),
}


def make(case, device):
    scene, settings, worlds, schedule = CASES[case]
    with forced_schedule(schedule):
        return Simulation(scene(), Settings(**settings), device, worlds)


def run(sim, first, schedule, after=lambda k: None):
    """Frames from `first` to the last; after(k) is called when frame k has been told all, before it is computed."""
    with forced_schedule(schedule):  # as a change of pins builds anew
        for k in range(first, FRAMES):
            drive(sim, k)
            after(k)
            sim.step()


def contents(path):
    """Name -> type, shape and bytes of each array of a file."""
    with np.load(path, allow_pickle=False) as file:
        return {name: (file[name].dtype, file[name].shape, file[name].tobytes()) for name in file.files}


def saved(sim, path):
    sim.save(path)
    return contents(path)


def gap(sim):
    """How far the nearest particle is from touching the ball [m]; all are 5 mm thick."""
    apart = [np.linalg.norm(sim.positions(name) - sim.get("ball.position"), axis=1) for name in sim.scene.objects]
    return min(each.min() for each in apart) - BALL.radius - 0.005


@pytest.mark.parametrize("case", CASES)
def test_it_goes_on_to_the_same_bits(case, device, tmp_path):
    seed = random.randrange(1 << 30)
    print(f"seed {seed}")
    moments, schedule = sorted(random.Random(seed).sample(range(FRAMES), 5)), CASES[case][3]
    never, gaps = make(case, device), []
    run(never, 0, schedule, lambda k: gaps.append(gap(never)))
    assert sum(each < 1e-3 for each in gaps) > 3, "objects touch the ball"
    end = saved(never, tmp_path / "end.npz")
    goes_on = make(case, device)
    run(goes_on, 0, schedule, lambda k: k in moments and goes_on.save(tmp_path / f"{k}.npz", {"k": k}))
    assert saved(goes_on, tmp_path / "again.npz") == end, "saving changes nothing"
    for k in moments:
        fresh = make(case, device)
        for sim in (fresh, goes_on):
            with forced_schedule(schedule):
                assert sim.load(tmp_path / f"{k}.npz") == {"k": k}
            assert sim.time == pytest.approx(k / 60)
            assert saved(sim, tmp_path / "at.npz").keys() == contents(tmp_path / f"{k}.npz").keys()
            with forced_schedule(schedule):
                sim.step()
            run(sim, k + 1, schedule)
            assert saved(sim, tmp_path / "other.npz") == end, (k, sim is fresh)


def test_live_values_are_those_of_the_file(device, tmp_path):
    a, b = make("auto", device), make("auto", device)
    told = {
        "gravity": (0.1, 0.0, -9.7),
        "wind.velocity": (0.3, 0.0, 1.1),
        "wind.drag_coefficient": 0.7,
        "solver.substeps": 9,
        "solver.error": 2e-3,
        "cloth.stretch_compliance": 1.23e-3,
        "cloth.bend_compliance": 333.0,
        "cloth.damping": 0.002,
        "cloth.thickness": 0.007,
        "cloth.pins": (0, 3),
        "ball.static_friction": 0.11,
        "hand.reach": (0.1, 0.2, 0.3),
        "hand.break_force": 1.7,
        "hand.object": "cloth",
    }
    for name, value in told.items():
        a.set(name, value)
    a.save(tmp_path / "a.npz")
    b.load(tmp_path / "a.npz")
    assert {name: a.get(name) for name in told} == told == {name: b.get(name) for name in told}
    assert (b.get("ball.position"), b.get("hand.orientation")) == (BALL.position, (0.0, 0.0, 0.0, 1.0))
    for name in ("cloth.resolution", "solver.method", "rope.pins", "cloth.segments"):
        with pytest.raises(ValueError, match="no live parameter"):
            a.get(name)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A simulation in the midst of contact, and the file of its state."""
    sim, path = make("auto", "cpu"), tmp_path_factory.mktemp("whole") / "whole.npz"
    for k in range(8):
        drive(sim, k)
        sim.step()
    sim.save(path)
    return sim, path


def refusal(sim, path, tmp_path):
    """The sentence with which a file is refused; nothing may change."""
    before = saved(sim, tmp_path / "before.npz")
    with pytest.raises(ValueError) as error:
        sim.load(path)
    sentence = str(error.value)
    assert "\n" not in sentence and str(path) in sentence and "; allowed " in sentence, sentence
    assert saved(sim, tmp_path / "after.npz") == before
    return sentence


def test_what_is_no_saved_state_is_refused(whole, tmp_path):
    sim, path = whole
    for name, content in {"empty": b"", "text": b"a: 1\n", "zip": b"PK\x03\x04 and nothing more"}.items():
        (tmp_path / name).write_bytes(content)
        assert "no saved state" in (told := refusal(sim, tmp_path / name, tmp_path)) or "damaged" in told
    np.savez(tmp_path / "other.npz", positions=np.zeros((3, 3)))
    assert "no saved state" in refusal(sim, tmp_path / "other.npz", tmp_path)
    np.savez(tmp_path / "header.npz", header=np.zeros(3), positions=np.zeros((3, 3)))
    assert "no saved state" in refusal(sim, tmp_path / "header.npz", tmp_path)
    np.savez(tmp_path / "pickle.npz", header=np.array([{"kind": 1}], dtype=object))
    assert "damaged" in refusal(sim, tmp_path / "pickle.npz", tmp_path)
    assert "No such file" in refusal(sim, tmp_path / "none.npz", tmp_path)
    assert "Is a directory" in refusal(sim, tmp_path, tmp_path)
    assert "Not a directory" in refusal(sim, path / "below", tmp_path)
    refusal(sim, tmp_path / "a\0b", tmp_path)


def changed(path, to, **header):
    """A copy of a file with entries of its header changed, or arrays left out that are None."""
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    described = json.loads(arrays["header"].tobytes())
    for name, value in header.items():
        if name in described:
            described[name] = value
        else:
            arrays[name.replace("__", "/")] = value
    arrays["header"] = np.frombuffer(json.dumps(described).encode(), np.uint8)
    np.savez(to, **{name: rows for name, rows in arrays.items() if rows is not None})
    return to


def test_another_version_or_content_is_refused(whole, tmp_path):
    sim, path = whole
    for version in (0, 2, None, "1"):
        told = refusal(sim, changed(path, tmp_path / "v.npz", format=version, package="9.9"), tmp_path)
        assert f"has format version {version!r}, of package 9.9; allowed is version 1" in told
    bad = {
        "batches": [["else"]],
        "settings": {"substeps": -1},
        "choices": {},
        "pins": {"cloth": [999]},
        "added": {"box": [1, "torus", {}]},
        "frames": None,
        "batch0__positions": None,
        "batch0__low": np.zeros((1, 3, 4), np.float32),
        "batch0__velocities": np.zeros((1, 56, 4)),
        "more": np.zeros(3),
    }
    for name, value in bad.items():
        assert "cannot be used" in refusal(sim, changed(path, tmp_path / "c.npz", **{name: value}), tmp_path), name


def test_a_damaged_file_is_refused_or_harmless(whole, tmp_path):
    sim, path = whole
    seed, damaged = random.randrange(1 << 30), tmp_path / "damaged.npz"
    print(f"seed {seed}")
    rng, content, before = random.Random(seed), path.read_bytes(), contents(path)
    for length in (1, 100, len(content) // 2, len(content) - 1, *(rng.randrange(len(content)) for _ in range(10))):
        damaged.write_bytes(content[:length])
        refusal(sim, damaged, tmp_path)
    for _ in range(200):
        place = rng.choice((rng.randrange(len(content)), len(content) - 1 - rng.randrange(3000)))
        broken = bytearray(content)
        broken[place] ^= 1 << rng.randrange(8)
        damaged.write_bytes(broken)
        try:
            sim.load(damaged)
        except ValueError as error:
            assert "\n" not in str(error) and str(damaged) in str(error), error
        assert saved(sim, tmp_path / "after.npz") == before, place


@pytest.mark.parametrize(
    ("what", "scene", "settings", "worlds"),
    [
        ("object cloth is a Cloth of 56 particles", lambda: cloth_scene(mass=0.3), {}, 1),
        ("object cloth is a Cloth of 56 particles", lambda: cloth_scene(orientation=(0, 0, 1, 0)), {}, 1),
        ("solver.frame_dt is 0.016666666666666666 in it and 0.01 here", cloth_scene, {"frame_dt": 0.01}, 1),
        ("solver.method is 'auto' in it and 'xpbd' here", cloth_scene, {"method": "xpbd"}, 1),
        ("worlds is 1 in it and 2 here", cloth_scene, {}, 2),
        ("handle hand is there in it and not there here", scene_without_hand, {}, 1),
    ],
)
def test_another_scene_is_refused(whole, tmp_path, what, scene, settings, worlds):
    other = Simulation(scene(), Settings(**settings), "cpu", worlds)
    told = refusal(other, whole[1], tmp_path)
    assert "is of another scene: " in told and what in told


def test_the_order_of_a_scene_counts_and_its_poses_do_not(whole, tmp_path):
    sim, path = whole
    scene = cloth_scene()
    cloth = scene.objects["cloth"]
    there, here = (
        Simulation(replace(scene, objects=dict.fromkeys(names, cloth)), device="cpu") for names in ("ab", "ba")
    )
    there.save(tmp_path / "ab.npz")
    assert "object b, object a" in refusal(here, tmp_path / "ab.npz", tmp_path)
    moved = Simulation(replace(scene, colliders={"ball": replace(BALL, position=(0, 0, 0))}), device="cpu")
    moved.load(path)
    assert saved(moved, tmp_path / "moved.npz") == contents(path)


def test_a_file_is_replaced_as_a_whole_or_not_at_all(whole, tmp_path):
    sim, path = whole[0], tmp_path / "state.npz"
    sim.save(path)
    before = path.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) // 2, limits[1]))  # as a full disk
    try:
        with pytest.raises(ValueError, match="cannot be written: File too large; allowed is"):
            sim.save(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == before and [each.name for each in tmp_path.iterdir()] == ["state.npz"]
    for place in ("not there/x.npz", "state.npz/x.npz", "a\0b"):
        with pytest.raises(ValueError, match="cannot be written"):
            sim.save(tmp_path / place)
    with pytest.raises(ValueError, match="cannot be written: Is a directory"):
        sim.save(tmp_path)
    with pytest.raises(ValueError, match="notes .* cannot be kept"):
        sim.save(path, {"x": object()})
    assert path.read_bytes() == before
