# SPDX-License-Identifier: Apache-2.0
"""Parts of one file as objects of their own, and the warp along the texture of a file."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Cloth, Mesh, Scene, Simulation
from cloth_sim_ros.sim.mesh_file import load_mesh
from cloth_sim_ros.sim.topology import build

trimesh = pytest.importorskip("trimesh")

SHIRT = """o Left Sleeve
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
f 1 2 3 4
o Front
g panel upper
v 3 0 0
v 5 0 0
v 5 1 0
f 5 6 7
g panel lower
v 3 1 0
f 5 7 8
"""
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)


def area(mesh):
    points, triangles = mesh
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


@pytest.mark.parametrize(
    ("part", "count", "wanted"),
    [("", 8, 3.0), ("#Left Sleeve", 4, 1.0), ("#Front", 4, 2.0), ("#panel", 4, 2.0), ("#upper", 3, 1.0)],
)
def test_a_part_of_a_file_has_its_name(tmp_path, part, count, wanted):
    (tmp_path / "shirt.obj").write_text(SHIRT)
    found = load_mesh(f"{tmp_path / 'shirt.obj'}{part}", "it")
    assert len(found[0]) == count and area(found) == pytest.approx(wanted)


def test_a_part_or_scale_that_cannot_be_is_refused_with_what_can(tmp_path):
    file = tmp_path / "shirt.obj"
    file.write_text(SHIRT)
    with pytest.raises(ValueError, match=r"which has no part 'Back'; allowed are 'Left Sleeve, Front, panel, upper, l"):
        load_mesh(f"{file}#Back", "it")
    with pytest.raises(ValueError, match="no such file is in"):
        load_mesh(f"{tmp_path}/skirt.obj#Back", "it")
    for scale in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match=r"^it scale is .*; allowed is a finite number from 1e-06"):
            load_mesh(str(file), "it", scale)
    (tmp_path / "odd#Front").mkdir()
    odd = tmp_path / "odd#Front" / "shirt#2.obj"
    odd.write_text(SHIRT)
    assert len(load_mesh(str(odd), "it")[0]) == 8 and len(load_mesh(f"{odd}#Front", "it")[0]) == 4


def test_parts_without_names_have_numbers(tmp_path):
    points, faces = np.concatenate([SQUARE, 2.0 * SQUARE + 3.0]), np.array([[0, 1, 2], [0, 2, 3]])
    trimesh.Trimesh(points, np.concatenate([faces, faces + 4]), process=False).export(tmp_path / "two.stl")
    for number, wanted in enumerate((1.0, 4.0)):
        assert area(load_mesh(f"{tmp_path / 'two.stl'}#{number}", "it")) == pytest.approx(wanted)
    for part in ("2", "Front"):
        with pytest.raises(ValueError, match=f"has no part '{part}'; allowed is a number from 0 to 1, as no part has"):
            load_mesh(f"{tmp_path / 'two.stl'}#{part}", "it")


def test_nodes_of_a_scene_are_parts_where_they_stand(tmp_path):
    scene = trimesh.Scene()
    for k, name in enumerate(("sleeve", "front")):
        panel = trimesh.Trimesh((k + 1.0) * SQUARE, [[0, 1, 2], [0, 2, 3]], process=False)
        scene.add_geometry(panel, node_name=name, transform=trimesh.transformations.translation_matrix((5.0 * k, 0, 0)))
    scene.export(tmp_path / "shirt.glb")
    points, triangles = load_mesh(f"{tmp_path / 'shirt.glb'}#front", "it")
    assert area((points, triangles)) == pytest.approx(4.0)
    assert points[:, 0].min() == pytest.approx(5.0)
    assert area(load_mesh(str(tmp_path / "shirt.glb"), "it")) == pytest.approx(5.0)


def test_parts_are_objects_and_colliders(tmp_path):
    (tmp_path / "shirt.obj").write_text(SHIRT)
    parts = {name: Cloth.from_file(f"{tmp_path / 'shirt.obj'}#{name}", "cotton") for name in ("Front", "upper")}
    Simulation(Scene(parts), device="cpu").step()
    assert parts["Front"].mass == pytest.approx(2.0 * parts["upper"].mass)
    boxes = trimesh.Scene([trimesh.creation.box((1, 1, 1)), trimesh.creation.box((2, 2, 2))])
    boxes.export(tmp_path / "boxes.glb")
    assert Mesh.from_file(f"{tmp_path / 'boxes.glb'}#geometry_1").vertices.max() == pytest.approx(1.0)


TURNED = """v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 1 0 -1
v 1 1 -1
vt 0 0
vt 0 2
vt -2 2
vt -2 0
vt 0.5 0
vt 0.5 1
vt 1.5 1
f 1/1 2/2 3/3 4/4
f 2/5 5/7 6/6
f 2/1 6/1 3/1
"""


def test_the_warp_runs_along_the_texture_in_each_triangle(tmp_path):
    """u grows along -y of a flat square, v along x; beyond an edge a triangle of its own, then one without an area."""
    file = tmp_path / "it.obj"
    file.write_text(TURNED)
    along_u, along_v = (Cloth.from_file(file, "cotton", uv=True, warp=way) for way in ((1, 0, 0), (0, 1, 0)))
    flat = (along_u.triangles < 4).all(axis=1)  # the polygons of three corners come first
    for cloth, wanted in ((along_u, [0, -1, 0]), (along_v, [1, 0, 0])):
        assert flat.sum() == 2 and cloth.warp[flat] == pytest.approx(0.5 * np.array([wanted] * 2), abs=1e-9)
    assert along_v.warp[0] == pytest.approx([0, 1, -1], abs=1e-9)
    assert along_v.warp[1].tolist() in along_v.warp[[0, 2, 3]].tolist(), "as of its neighbour"
    given = Cloth.from_mesh(along_u.vertices, along_u.triangles, "cotton", warp=along_u.warp)
    springs = [build(each, "it", True).springs["structural"].scale for each in (along_u, given, along_v)]
    assert springs[0] == pytest.approx(springs[1]) and springs[0] != pytest.approx(springs[2])


@pytest.mark.parametrize(
    "text", [TURNED.replace("1/1 2/2", "1 2"), TURNED.replace("vt", "vn"), TURNED.replace("2/2", "2/20")]
)
def test_a_file_without_a_texture_is_taken_and_has_no_warp(tmp_path, text):
    (tmp_path / "it.obj").write_text(text)
    assert len(load_mesh(str(tmp_path / "it.obj"), "it")[1]) == 4
    with pytest.raises(ValueError, match="which has no texture with an area; allowed are files with u and v"):
        Cloth.from_file(tmp_path / "it.obj", uv=True)


def test_a_scene_of_trimesh_has_a_texture(tmp_path):
    visual = trimesh.visual.TextureVisuals(uv=SQUARE[:, [1, 0]])
    trimesh.Trimesh(SQUARE, [[0, 1, 2], [0, 2, 3]], visual=visual, process=False).export(tmp_path / "it.glb")
    warp = Cloth.from_file(tmp_path / "it.glb", "silk", uv=True).warp
    assert np.abs(warp / np.linalg.norm(warp, axis=1, keepdims=True)) == pytest.approx(np.array([[0, 1, 0]] * 2))


def test_triangles_that_are_left_out_take_their_warp_along():
    points = np.concatenate([SQUARE, SQUARE[1:2]])
    cloth = Cloth.from_mesh(points, [[1, 4, 2], [0, 1, 2], [0, 2, 3]], "cotton", warp=[[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    assert cloth.warp.tolist() == [[1, 0, 0], [0, 1, 0]]
