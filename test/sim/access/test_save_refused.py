# SPDX-License-Identifier: Apache-2.0
"""What is no saved state of the scene is refused in one sentence, and a file is written as a whole or not at all."""

import json
import random
import resource
from dataclasses import replace

import numpy as np
import pytest
from driven_scenes import BALL, cloth_scene, contents, drive, make, saved

from cloth_sim_ros.sim import Settings, Simulation


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
    assert "a folder is there" in refusal(sim, tmp_path, tmp_path)
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
    for version in (0, 1, 2, 3, 4, 5, 6, 7, 8, None, "9"):
        told = refusal(sim, changed(path, tmp_path / "v.npz", format=version, package="9.9"), tmp_path)
        assert f"has format version {version!r}, of package 9.9; allowed is version 22" in told
    bad = {
        "batches": [["else"]],
        "settings": {"substeps": -1},
        "choices": {},
        "pins": {"cloth": [999]},
        "scales": {"cloth": [0.0]},
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
        ("object cloth is a Cloth of 56 particles", lambda: cloth_scene(particle_masses=np.full(56, 0.1)), {}, 1),
        ("object cloth is a Cloth of 56 particles", lambda: cloth_scene(orientation=(0, 0, 1, 0)), {}, 1),
        ("solver.frame_dt is 0.016666666666666666 in it and 0.01 here", cloth_scene, {"frame_dt": 0.01}, 1),
        ("solver.method is 'auto' in it and 'xpbd' here", cloth_scene, {"method": "xpbd"}, 1),
        ("worlds is 1 in it and 2 here", cloth_scene, {}, 2),
        ("handle hand is there in it and not there here", lambda: replace(cloth_scene(), handles={}), {}, 1),
    ],
)
@pytest.mark.long
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
    for place in ("not there/x.npz", "state.npz/x.npz", "a\0b", "/"):
        with pytest.raises(ValueError, match="cannot be written"):
            sim.save(tmp_path / place)
    with pytest.raises(ValueError, match="cannot be written: a folder is there"):
        sim.save(tmp_path)
    with pytest.raises(ValueError, match="notes .* cannot be kept"):
        sim.save(path, {"x": object()})
    assert path.read_bytes() == before
