# SPDX-License-Identifier: Apache-2.0
"""Files that are damaged or reworded, of each kind that is read, are refused in a sentence or are of use."""

import io
import json
import random
from pathlib import Path

import numpy as np
import pytest
from driven_scenes import drive, make, torn_scene
from mutation import damaged, guarded, reworded, sentence

from cloth_sim_ros.ros.inputs.robot import read_robot
from cloth_sim_ros.ros.parameters.file import readable_arguments
from cloth_sim_ros.sim import Simulation
from cloth_sim_ros.sim.input.mesh_reading import read
from cloth_sim_ros.sim.mesh_file import load_mesh
from cloth_sim_ros.study.scene_file import read_plan

ROOT = Path(__file__).parents[2]
PARTS = [range(begin, begin + 2_500) for begin in range(0, 10_000, 2_500)]
seeds_of = pytest.mark.parametrize(
    "seeds", [range(200), *(pytest.param(part, marks=pytest.mark.long) for part in PARTS)], ids=str
)


def refused(act, what):
    """Whether `act` refuses; fails where it raises anything but ValueError in a sentence, or hangs."""
    with guarded(what):
        try:
            act()
        except ValueError as error:
            assert sentence(error), f"{what}: {error!r}"
            return True
        except Exception as error:
            raise AssertionError(f"{what}: {type(error).__name__}: {error}") from error
    return False


@pytest.mark.parametrize(
    ("case", "seeds"),
    [
        *((case, range(200)) for case in ("auto", "torn")),
        *(pytest.param(case, seeds, marks=pytest.mark.long) for case in ("auto", "ropes") for seeds in PARTS),
    ],
    ids=str,
)
def test_states(case, seeds, tmp_path):
    sim = Simulation(torn_scene(), device="cpu") if case == "torn" else make(case, "cpu")
    good, bad = tmp_path / "good.npz", tmp_path / "bad.npz"
    for k in range(8):
        if case != "torn":
            drive(sim, k)
        sim.step()
    sim.save(good)
    content = good.read_bytes()
    with np.load(good) as file:
        arrays = {name: file[name] for name in file.files}
    took = 0
    for seed in seeds[::2] if case == "auto" else seeds[1::2]:
        rng = random.Random(seed)
        bad.write_bytes(changed_inside(rng, arrays) if rng.random() < 0.5 else damaged(rng, content))
        if not refused(lambda: sim.load(bad), f"seed {seed}"):
            took += 1
            with guarded(f"seed {seed}"):
                sim.step()
                sim.report()
            sim.load(good)
    assert took > 0, "some hold other numbers, and are whole"


def changed_inside(rng, arrays):
    """The bytes of a file with right checksums, of which one array or the header is another."""
    name = rng.choice(["header", rng.choice(list(arrays))])
    raw = arrays[name].tobytes()
    if name == "header":
        text = raw.decode()
        if rng.random() < 0.5:
            entries = json.loads(text)
            entries[rng.choice(list(entries))] = rng.choice([None, -1, 1e300, "x", [], {}, [1], {"a": 1}, True])
            text = json.dumps(entries)
        else:
            text = reworded(rng, text)
        other = np.frombuffer(text.encode(), np.uint8)
    else:
        noise = bytearray(raw)
        for _ in range(rng.choice((1, 4)) if raw else 0):
            noise[rng.randrange(len(noise))] ^= 1 << rng.randrange(8)
        other = np.frombuffer(bytes(noise), arrays[name].dtype).reshape(arrays[name].shape)
    out = io.BytesIO()
    np.savez(out, **{**arrays, name: other})
    return out.getvalue()


def meshes():
    """Name of a file -> its content and the link of a robot in it."""
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(subdivisions=1)
    robot = (
        '<robot name="r"><link name="arm"><collision><origin xyz="0 0 1" rpy="0 1 0"/><geometry><box size="1 2 3"/>'
        '</geometry></collision><collision><geometry><cylinder radius="1" length="2"/></geometry></collision></link>'
        '<link name="tip"/><joint name="j" type="revolute"><parent link="arm"/><child link="tip"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    binary = {kind: (ball.export(file_type=kind), "") for kind in ("stl", "ply", "off", "obj", "stl_ascii")}
    binary["skirt"] = ((ROOT / "config/bag.obj").read_bytes()[:4000], "")
    endings = {"stl_ascii": "stl", "skirt": "obj"}
    found = {f"{name}.{endings.get(name, name)}": each for name, each in binary.items()}
    return {**found, "robot.urdf": (robot, "arm")}


@seeds_of
def test_meshes_and_robots(seeds, tmp_path):
    pytest.importorskip("yourdfpy")
    files, took = list(meshes().items()), 0
    for seed in seeds:
        rng = random.Random(seed)
        (name, (content, link)) = rng.choice(files)
        content = content if isinstance(content, bytes) else content.encode()
        content = damaged(rng, content) if seed % 2 else reworded(rng, content.decode("latin-1")).encode()
        bad = tmp_path / f"bad_{name}"
        bad.write_bytes(content)
        with guarded(f"seed {seed}"):
            found = read(str(bad), link, 1.0, load_mesh)
        if isinstance(found, str):
            assert sentence(ValueError(found)), f"seed {seed}: {found!r}"
        else:
            points, triangles, *_ = found
            took += 1
            assert (
                np.isfinite(points).all() and len(triangles) and 0 <= triangles.min() <= triangles.max() < len(points)
            )
        if link:
            refused(lambda: read_robot(content.decode("latin-1")), f"robot of seed {seed}")  # noqa: B023
    assert took > len(seeds) // 20


@seeds_of
def test_parameter_files(seeds, tmp_path):
    texts, bad, took = [each.read_text() for each in sorted(ROOT.glob("config/*.yaml"))], tmp_path / "bad.yaml", 0
    for seed in seeds:
        rng = random.Random(seed)
        text = rng.choice(texts)
        content = damaged(rng, text.encode()) if seed % 2 else reworded(rng, text).encode("utf-8", "replace")
        bad.write_bytes(content)
        words, complaints = ["--ros-args", "--params-file", str(bad)], []
        refused(lambda: readable_arguments(words, tmp_path, complaints.append), f"node, seed {seed}")  # noqa: B023
        assert all(sentence(ValueError(each)) for each in complaints), f"seed {seed}: {complaints}"
        took += not refused(lambda: read_plan(bad), f"plan, seed {seed}")
    assert took > len(seeds) // 20
