# SPDX-License-Identifier: Apache-2.0
"""Garment files as people have them: seams, slivers, polygons and units come out as what they are meant to be."""

import logging

import numpy as np
import pytest

from cloth_sim_ros.sim import Cloth, Mesh, Scene, Seam, Simulation
from cloth_sim_ros.sim.colliders.mesh import what_is_open
from cloth_sim_ros.sim.input.mesh_repair import cut, repair
from cloth_sim_ros.sim.mesh_file import load_mesh
from cloth_sim_ros.sim.scene.materials import FABRICS, triangles_area
from cloth_sim_ros.sim.topology import build

trimesh = pytest.importorskip("trimesh")

SEAM = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 1 0 0\nf 1 2 3\nf 1 3 4\nf 2 5 3\n"  # vertices 2 and 5 are one point
NOTCH = [(0, 0, 0), (2, 0, 0), (2, 2, 0), (1, 0.3, 0), (0, 2, 0)]


def load(folder, text, name="it.obj"):
    (folder / name).write_text(text)
    return load_mesh(str(folder / name), "towel.mesh")


def obj(points, polygons):
    lines = [f"v {x} {y} {z}" for x, y, z in points]
    return "\n".join([*lines, *("f " + " ".join(str(k + 1) for k in each) for each in polygons), ""])


def box(at=(0.0, 0.0, 0.0), size=1.0):
    """Corners (8, 3) and triangles (12, 3) of a box, closed."""
    made = trimesh.creation.box((size, 1.0, 1.0))
    return np.asarray(made.vertices) + at, np.asarray(made.faces)


def areas(points, triangles):
    a, b, c = (np.asarray(points)[triangles[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def test_triangles_without_an_area_are_left_out_and_counted(tmp_path, caplog):
    vertices, triangles = load(tmp_path, SEAM)
    assert triangles.tolist() == [[0, 1, 2], [0, 2, 3]] and len(vertices) == 4
    path = tmp_path / "it.obj"
    assert caplog.messages == [
        f"towel.mesh is {str(path)!r}, which has 1 of 3 triangles without an area, which are left out"
    ]
    load_mesh(str(path), "towel.mesh")
    assert len(caplog.messages) == 1, "it is told once"
    Simulation(Scene({"it": Cloth.from_mesh(vertices, triangles, "cotton")}), device="cpu").step()
    assert len(caplog.messages) == 1


def test_from_mesh_does_the_same_and_keeps_pins_and_masses_where_they_were(caplog):
    points = np.array([[5, 5, 5], [0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [1, 0, 0]], float)
    triangles = [[1, 2, 3], [1, 3, 4], [2, 5, 3]]
    cloth = Cloth.from_mesh(points, triangles, pins=[1, 5, 4], particle_masses=[9.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    assert cloth.vertices.tolist() == points[1:5].tolist() and cloth.pins == (0, 1, 3)
    assert cloth.particle_masses.tolist() == [1.0, 7.0, 3.0, 4.0] and cloth.mass == 15.0
    first = "Cloth.from_mesh has 1 of 3 triangles without an area, which are left out; it has 2 vertices that no"
    assert [message.startswith(first) for message in caplog.messages] == [True]
    with pytest.raises(ValueError, match="Cloth.pins names vertex 0; allowed are those of triangles with an area"):
        Cloth.from_mesh(points, triangles, pins=[0])
    with pytest.raises(ValueError, match="Cloth.from_mesh has no triangle with an area"):
        Cloth.from_mesh(points, [[2, 5, 3]])


def test_an_edge_of_no_length_between_two_triangles_does_not_part_them():
    """The middle triangle joins vertices 1 and 4, which are one point; nobody else says that they are."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [1, 0, 0]], float)
    mesh = repair(points, np.array([[0, 1, 2], [1, 4, 2], [4, 3, 2]]))
    assert mesh.triangles.tolist() == [[0, 1, 2], [1, 3, 2]] and mesh.place.tolist() == [0, 1, 2, 3, 1]


def test_three_corners_in_a_line_stay_only_where_they_hold_two_sides_together(tmp_path):
    points, faces = box()
    faces = faces.tolist()
    a, b, c = faces.pop(0)  # cut in two from the middle of its first side, whose other side is not
    points = np.vstack([points, (points[a] + points[b]) / 2])
    faces += [[a, 8, c], [8, b, c], [a, b, 8]]
    vertices, triangles = load(tmp_path, obj(points, faces))
    assert len(vertices) == 9 and len(triangles) == 14 and what_is_open(vertices, triangles) == ""
    assert triangles_area(vertices, triangles) == pytest.approx(6.0)
    square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0, 0]]
    vertices, triangles = load(tmp_path, obj(square, [[0, 1, 2], [0, 2, 3], [0, 4, 1]]))
    assert len(vertices) == 4 and len(triangles) == 2, "it has a corner of its own"


@pytest.mark.parametrize("at", [(1.0, 0.0, 0.0), (1.0, 1.0, 1.0)], ids=["side", "corner"])
def test_a_surface_that_is_closed_by_its_numbers_stays_closed(tmp_path, at):
    """Two boxes that meet at a side, where welding would put four triangles at an edge, or at a corner."""
    (first, faces), (second, _) = box(), box(at)
    points, triangles = np.vstack([first, second]), np.concatenate([faces, faces + 8])
    text = obj(points, triangles)
    textured = text.replace("f ", "vt 0 0\nvt 1 1\nf ", 1)
    lines = [
        "f " + " ".join(f"{number}/{1 + (k + j) % 2}" for j, number in enumerate(line.split()[1:]))
        if line.startswith("f ")
        else line
        for k, line in enumerate(textured.splitlines())
    ]
    for content in (text, "\n".join(lines)):
        (tmp_path / "boxes.obj").write_text(content)
        body = Mesh.from_file(tmp_path / "boxes.obj")
        assert len(body.vertices) == 16 and len(body.triangles) == 24
    trimesh.Trimesh(first, faces).export(tmp_path / "box.stl")
    assert len(Mesh.from_file(tmp_path / "box.stl").vertices) == 8, (
        "places say what belongs together, where numbers do not"
    )


def test_too_many_triangles_at_an_edge_are_not_welded(tmp_path, caplog):
    """Three panels of two triangles each meet at a seam, in vertices of their own; two of them meet at another."""
    panels = [[(0, 0, 0), (0, 1, 0), (x, 1, z), (x, 0, z)] for x, z in ((1, 0), (-1, 0), (0, 1))]
    more = [(1, 0, 0), (1, 1, 0), (2, 1, 0), (2, 0, 0)]
    points = [corner for panel in (*panels, more) for corner in panel]
    polygons = [[4 * k, 4 * k + 1, 4 * k + 2, 4 * k + 3] for k in range(4)]
    vertices, triangles = load(tmp_path, obj(points, polygons))
    assert len(vertices) == 14, "the seam of two is welded"
    assert "has 1 edges at which vertices in one place stay apart, as too many triangles meet there" in caplog.text
    build(Cloth.from_mesh(vertices, triangles), "it", True)
    soup = [[points[k] for k in (a, b, c)] for a, b, c, _ in polygons[:3]]
    trimesh.Trimesh(np.reshape(soup, (-1, 3)), np.arange(9).reshape(-1, 3), process=False).export(tmp_path / "it.stl")
    with pytest.raises(ValueError, match="it has 3 triangles at edge"):
        build(Cloth.from_mesh(*load_mesh(str(tmp_path / "it.stl"), "it")), "it", True)


PLY = """ply
format ascii 1.0
element vertex {points}
property float x
property float y
property float z
element face 1
property list uchar int {name}
end_header
{rows}
{corners} {polygon}
"""


@pytest.mark.parametrize("turned", [False, True])
def test_a_polygon_is_cut_into_what_it_covers(tmp_path, turned):
    corners = [*NOTCH[:2], (2, 1, 0), *NOTCH[2:], (0, 1, 0)]  # with corners along straight sides
    corners = corners[::-1] if turned else corners
    rows, count = "\n".join(" ".join(map(str, each)) for each in corners), len(corners)
    polygon = " ".join(map(str, range(count)))
    ply = [
        PLY.format(points=count, name=name, rows=rows, corners=count, polygon=polygon)
        for name in ("vertex_indices", "vertex_index")
    ]
    for name, text in (
        ("it.obj", obj(corners, [range(count)])),
        ("it.off", f"OFF\n# a comment\n{count} 1 0\n{rows}\n{count} {polygon} 0.5 0.5 0.5\n"),
        ("flat.off", f"OFF {count} 1 0\n{rows}\n{count} {polygon}\n"),
        ("it.ply", ply[0]),
        ("index.ply", ply[1]),
    ):
        vertices, triangles = load(tmp_path, text, name)
        assert len(vertices) == count and len(triangles) == count - 2
        assert areas(vertices, triangles).sum() == pytest.approx(2.3, rel=1e-6), name
        a, b, c = (vertices[triangles[:, k]] for k in range(3))
        assert (np.cross(b - a, c - a)[:, 2] > 0).all() != turned, "they turn as the polygon does"


def test_polygons_of_any_shape_have_their_area():
    rng = np.random.default_rng(7)
    for _ in range(50):
        count = rng.integers(4, 30)
        angles = np.sort(rng.uniform(0, 2 * np.pi, count))
        flat = rng.uniform(0.1, 1.0, count)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        x, y = flat.T
        want = abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2
        across = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        points = np.column_stack([flat, np.zeros(count)]) @ across + rng.normal(size=3)
        triangles = cut(points, [range(count)])
        assert len(triangles) == count - 2
        assert areas(points, triangles).sum() == pytest.approx(want, rel=1e-6) or np.diff(angles).max() > np.pi


def test_other_faces_stay_as_they_are(tmp_path):
    square = [(0, 0, 0), (1, 0, 0), (1, 1, 0.5), (0, 1, 0)]  # not flat
    _, triangles = load(tmp_path, obj(square, [range(4)]))
    assert triangles.tolist() == [[0, 1, 2], [0, 2, 3]]
    text = "v 0 0 0 0.5 0.5 0.5\nv 1 0 0\nvn 0 0 1\nv 1 1 0\nv 0 1 0\nl 1 2\nf -4//1 -3//1 \\\n -2//1 -1//1 # a quad\n"
    vertices, triangles = load(tmp_path, text.replace(" 0.5 0.5 0.5", ""))
    assert vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    assert triangles.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert load(tmp_path, text)[0].tolist() == vertices.tolist(), "colours are no places"


def test_a_cloth_of_a_mesh_has_a_unit_and_a_room_is_told(tmp_path, caplog):
    text = obj([(0, 0, 0), (900, 0, 0), (900, 900, 0), (0, 900, 0)], [range(4)])
    vertices, triangles = load(tmp_path, text)
    cloth = Cloth.from_mesh(vertices, triangles, "cotton", scale=1e-3)
    assert cloth.mass == pytest.approx(FABRICS["cotton"].areal_mass * 0.81) and cloth.vertices.max() == 0.9
    Simulation(Scene({"towel": cloth}), device="cpu")
    assert not caplog.messages
    points, faces = box(size=30.0)
    scene = Scene({"towel": Cloth.from_mesh(vertices, triangles)}, {"hall": Mesh(points, faces)})
    with caplog.at_level(logging.WARNING):
        Simulation(scene, device="cpu")
    assert caplog.messages == [
        "towel is 900 m across; a mesh in millimetres takes a scale of 0.001",
        "hall is 30 m across; a mesh in millimetres takes a scale of 0.001",
    ]
    with pytest.raises(ValueError, match=r"Cloth.from_mesh scale is 0; allowed is a finite number from 1e-06"):
        Cloth.from_mesh(vertices, triangles, scale=0)
    far = text.replace("900", "90000")
    with pytest.raises(ValueError, match=r"which has vertex 1 at \[90000.0, 0.0, 0.0\]; allowed is up to 10000$"):
        load(tmp_path, far)
    load_mesh(str(tmp_path / "it.obj"), "towel.mesh", 1e-3)


def test_loose_parts_and_vertices_on_open_edges_are_told(caplog):
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    far = Cloth.from_mesh(np.concatenate([square, square + 2.0]), [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    beside = np.concatenate([square, [[2, 0, 0], [2, 1, 0], [1, 0.5, 0]]])
    faces = [[0, 1, 2], [0, 2, 3], [1, 4, 6], [4, 5, 6], [5, 2, 6]]
    with caplog.at_level("WARNING"):
        Simulation(Scene({"far": far, "near": Cloth.from_mesh(beside, faces)}), device="cpu")
    assert "far has 2 parts that no triangle joins" in caplog.text
    assert "near has 1 open edges with a vertex between their ends" in caplog.text
    assert "near has 2" not in caplog.text and "far has 1" not in caplog.text
    caplog.clear()
    seam = Seam("far", "far", (1,), (4,), closing_speed=1.0)
    Simulation(Scene({"far": far}, seams={"seam": seam}), device="cpu")
    assert "parts" not in caplog.text
