# SPDX-License-Identifier: Apache-2.0
"""Garment files as people have them: seams, slivers, polygons and units come out as what they are meant to be."""

import logging

import numpy as np
import pytest

from cloth_sim_ros.sim import Cloth, Mesh, Scene, Seam, Simulation
from cloth_sim_ros.sim.colliders.mesh import what_is_open
from cloth_sim_ros.sim.input.mesh_repair import count_t_junctions, count_turns, cut, edges_of, repair
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


def grid(side):
    """Points (side^2, 3) of a square, and triangles that turn alike."""
    x, y = (each.ravel() for each in np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side)))
    first = [k for k in range(side * (side - 1)) if k % side < side - 1]
    triangles = [each for k in first for each in ((k, k + 1, k + side + 1), (k, k + side + 1, k + side))]
    return np.column_stack([x, y, np.zeros(side * side)]), np.array(triangles)


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
    assert "has 1 edge at which vertices in one place stay apart, as too many triangles meet there" in caplog.text
    build(Cloth.from_mesh(vertices, triangles), "it", True)
    soup = [[points[k] for k in (a, b, c)] for a, b, c, _ in polygons[:3]]
    trimesh.Trimesh(np.reshape(soup, (-1, 3)), np.arange(9).reshape(-1, 3), process=False).export(tmp_path / "it.stl")
    with pytest.raises(ValueError, match="it has 3 triangles at edge"):
        build(Cloth.from_mesh(*load_mesh(str(tmp_path / "it.stl"), "it")), "it", True)


@pytest.mark.parametrize("fineness", [0, 2], ids=["an_edge", "a_chain_of_edges"])
def test_boxes_that_touch_along_an_edge_stay_apart_without_numbers(tmp_path, caplog, fineness):
    """Four triangles meet at each edge of a soup there, two of either box. The OBJ file is taken, too."""
    one = trimesh.creation.box((1.0, 1.0, 1.0))
    for _ in range(fineness):
        one = one.subdivide()
    other = one.copy().apply_translation((1.0, 1.0, 0.0))
    trimesh.util.concatenate([one, other]).export(tmp_path / "boxes.stl")
    body = Mesh.from_file(tmp_path / "boxes.stl")
    assert len(body.vertices) == 2 * len(one.vertices) and len(body.triangles) == 2 * len(one.faces)
    cloth = Cloth.from_file(tmp_path / "boxes.stl", named="towel.mesh")
    assert areas(cloth.vertices, cloth.triangles).sum() == pytest.approx(12.0, rel=1e-6)
    build(cloth, "it", True)
    edges = "1 edge" if fineness == 0 else "4 edges"
    assert f"boxes.stl', which has {edges} at which vertices in one place stay apart" in caplog.text


def test_a_soup_that_would_fall_apart_is_refused(tmp_path):
    """Two sheets in one place: four triangles meet at each edge within, and no place says which two are neighbours."""
    points, faces = grid(4)
    soup = np.concatenate([points[faces], points[faces[:, ::-1]]]).reshape(-1, 3)
    trimesh.Trimesh(soup, np.arange(len(soup)).reshape(-1, 3), process=False).export(tmp_path / "it.stl")
    with pytest.raises(
        ValueError, match=r"^it has 4 triangles at edge \d+-\d+; allowed are meshes with at most 2 an edge$"
    ):
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


def ring(middle, size, *, turned=False):
    """A square of corners (4, 2), counterclockwise unless turned."""
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * size / 2 + middle
    return corners[::-1] if turned else corners


@pytest.mark.parametrize("own", [False, True], ids=["numbers_twice", "numbers_of_their_own"])
def test_a_polygon_that_goes_to_its_holes_and_back_has_them(tmp_path, own):
    outer, holes = ring((3, 1.5), 6.0), [ring((2, 1.5), 1.0, turned=True), ring((4.5, 1.5), 1.5, turned=True)]
    flat = np.concatenate([[outer[0], *hole, hole[0]] for hole in holes] + [outer])
    across = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    places, number = (flat, np.arange(len(flat))) if own else np.unique(flat, axis=0, return_inverse=True)
    points = np.column_stack([places, np.zeros(len(places))]) @ across
    vertices, triangles = load(tmp_path, obj(points, [np.ravel(number)]))
    assert len(vertices) == 12 and len(triangles) == 14
    assert areas(vertices, triangles).sum() == pytest.approx(36.0 - 1.0 - 2.25, rel=1e-9)
    middles = (vertices @ across.T)[triangles].mean(axis=1)[:, :2]
    for middle, size in (((2, 1.5), 1.0), ((4.5, 1.5), 1.5)):
        assert (np.abs(middles - middle).max(axis=1) > size / 2).all(), "a hole stays a hole"


@pytest.mark.parametrize(
    "flat",
    [
        [(0, 0), (2, 1), (2, 0), (0, 1), (1, -1)],
        [*ring((0, 0), 3.0), (-1.5, -1.5), *ring((0, 0), 1.0), (-0.5, -0.5)],  # the hole turns as its outside
    ],
    ids=["crosses", "overlaps"],
)
def test_a_polygon_without_an_inside_is_refused(tmp_path, flat):
    told = f"has a polygon of {len(flat)} corners that crosses or overlaps itself; allowed are those that do not$"
    with pytest.raises(ValueError, match=told):
        load(tmp_path, obj([(x, y, 0) for x, y in flat], [range(len(flat))]))


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
    assert "near has 1 open edge with a vertex between its ends, where it comes apart" in caplog.text
    assert "near has 2" not in caplog.text and "far has 1" not in caplog.text
    caplog.clear()
    seam = Seam("far", "far", (1,), (4,), closing_speed=1.0)
    Simulation(Scene({"far": far}, seams={"seam": seam}), device="cpu")
    assert "parts" not in caplog.text


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_vertex_on_an_open_edge_is_told_for_a_border_of_any_length(axis):
    """An edge of one triangle beside a strip: the strip's vertices along it lie between its ends."""
    count = 2100
    along = np.linspace(0, 10, count + 1)
    points = np.zeros((2 * count + 5, 3))
    points[: count + 1, axis] = points[count + 1 : -3, axis] = along
    points[count + 1 : -3, (axis + 1) % 3] = 0.1
    points[-3:, axis], points[-3:, (axis + 1) % 3] = (0, 10, 5), (-1e-5, -1e-5, -10)
    k = np.arange(count)
    strip = np.concatenate(
        [np.stack(each, axis=1) for each in ((k, k + 1, k + count + 1), (k + 1, k + count + 2, k + count + 1))]
    )
    edges = edges_of(strip, len(points))[1]
    assert np.count_nonzero(edges == 1) > 4000
    assert count_t_junctions(points, strip) == 0
    assert count_t_junctions(points, np.vstack([strip, [2 * count + 3, 2 * count + 2, 2 * count + 4]])) == 1


def test_triangles_that_turn_opposite_ways_are_told_and_move_alike(caplog):
    points, alike = grid(5)
    mixed, ways = alike.copy(), {}
    mixed[12] = mixed[12][::-1]  # amid others
    assert count_turns(alike, 25) == 0 and count_turns(alike[:, ::-1], 25) == 0
    for name, triangles in (("alike", alike), ("mixed", mixed)):
        caplog.clear()
        sim = Simulation(Scene({"it": Cloth.from_mesh(points, triangles, "cotton", pins=[0])}), device="cpu")
        sim.step(5)
        ways[name] = sim.positions("it")
        told = "it has 3 edges between triangles that turn opposite ways; it moves as if they turned alike"
        assert caplog.messages == ([told] if name == "mixed" else [])
    np.testing.assert_allclose(ways["mixed"], ways["alike"], atol=1e-6)
