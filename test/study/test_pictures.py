# SPDX-License-Identifier: Apache-2.0
"""The pictures are drawn from what the product computes."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cloth_sim_ros.drawing import camera
from cloth_sim_ros.sim import Cloth
from cloth_sim_ros.sim.topology import build
from cloth_sim_ros.study.figures import save_png

FOLDER = Path(__file__).parents[2] / "docs/pictures"


def module(name):
    """A module of docs/pictures, which has no package."""
    if str(FOLDER) not in sys.path:
        sys.path.append(str(FOLDER))
    spec = importlib.util.spec_from_file_location(name.strip("_"), FOLDER / f"{name}.py")
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


command, curtain, oscillator, rope, springs = map(module, ("__main__", "curtain", "oscillator", "rope", "springs"))


def test_camera_sees_in_perspective():
    seen, distance = camera.Camera((0.0, -2.0, 0.0), (0.0, 0.0, 0.0)).see(np.array([[0.5, 0.0, 0.0], [0.5, 2.0, 1.0]]))
    assert distance == pytest.approx([2.0, 4.0])
    np.testing.assert_allclose(seen, [[0.25, 0.0], [0.125, 0.25]], atol=1e-12)


@pytest.mark.long
def test_curtain_is_pushed_by_the_ball_and_stays_out_of_it():
    cloths, balls, _ = curtain.shots(24, "cpu")
    assert len(cloths) == len(curtain.SHOTS)
    assert cloths[2][:, 1].max() > cloths[0][:, 1].max() + 0.3
    for points, centre in zip(cloths, balls, strict=True):
        assert np.linalg.norm(points - centre, axis=1).min() > curtain.RADIUS


def test_gathered_curtain_keeps_its_length():
    rest = np.stack([np.linspace(-0.95, 0.95, 500), np.zeros(500), np.zeros(500)], axis=1)
    length = np.linalg.norm(np.diff(curtain.gathered(rest), axis=0), axis=1).sum()
    assert length == pytest.approx(curtain.SIZE[0], rel=0.06)


@pytest.mark.long
def test_saved_picture_is_small_and_not_blank(tmp_path):
    path = tmp_path / "curtain.png"
    save_png(curtain.draw("cpu", resolution=16), path)
    assert path.stat().st_size < 200_000
    assert np.asarray(Image.open(path).convert("L")).std() > 10.0


def test_forward_euler_grows_by_its_formula():
    found = {label: oscillator.growth(q) for label, q in oscillator.motions("cpu").items()}
    theta = oscillator.FREQUENCY * oscillator.STEP
    assert found["forward Euler"] == pytest.approx(np.sqrt(1.0 + theta**2), rel=1e-9)
    for label, (z, _) in oscillator.METHODS.items():
        assert found[label] == pytest.approx(abs(z(theta)), rel=1e-5), label


def test_rope_is_as_stiff_as_its_material_under_xpbd_and_as_its_iterations_under_pbd():
    converged = rope.stretch(rope.CONVERGED(0, "cpu"))
    found = {label: [rope.stretch(run(n, "cpu")) for n in (1, 64)] for label, (run, _) in rope.METHODS.items()}
    assert found["XPBD"] == pytest.approx([converged] * 2, rel=0.05)
    few, many = found["PBD, stiffness 1"]
    assert few > 5.0 * converged and many < 0.3 * converged


def test_families_of_a_grid_are_drawn_with_each_spring_once():
    topology = build(Cloth(resolution=(5, 5), bending="springs", bend_compliance=1.0), "grid", True)
    drawn = np.concatenate([np.sort(springs.springs_of(topology, one)[0], axis=1) for one in topology.families])
    there = np.concatenate([np.sort(elements.particles, axis=1) for elements in topology.springs.values()])
    assert sorted(map(tuple, drawn.tolist())) == sorted(map(tuple, there.tolist()))


def test_disk_is_one_sheet_without_holes():
    points, triangles = springs.disk()
    a, b, c = (points[triangles[:, k]] for k in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert np.abs(area).sum() == pytest.approx(0.5 * 42 * np.sin(2.0 * np.pi / 42), rel=1e-6)


@pytest.mark.parametrize("name", ["topology", "mesh_lines", "oscillator"])
def test_pictures_are_written(tmp_path, name):
    path = tmp_path / f"{name}.png"
    save_png(command.PICTURES[name]("cpu"), path)
    assert 10_000 < path.stat().st_size < 200_000
