# SPDX-License-Identifier: Apache-2.0
"""Signed distances of meshes and of volumes against closed forms, and files that are none."""

import numpy as np
import pytest
import warp as wp
from probed import of_a_mesh, signed_distances

from cloth_sim_ros.sim import Box, Mesh, SignedDistance, Sphere
from cloth_sim_ros.sim.colliders import baking
from cloth_sim_ros.sim.colliders.collider import least_roundness
from cloth_sim_ros.sim.colliders.mesh import is_convex, what_is_open

trimesh = pytest.importorskip("trimesh")

HALF = np.array((0.1, 0.2, 0.3))
RADIUS = 0.3
rng = np.random.default_rng(11)


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def of(surface, **fields):
    return Mesh(surface.vertices, surface.faces, **fields)


def ball(subdivisions=3):
    return trimesh.creation.icosphere(subdivisions=subdivisions, radius=RADIUS)


def sagitta(surface):
    """By how much the middles of the triangles of a ball lie inside of it [m]."""
    return RADIUS - np.linalg.norm(surface.triangles_center, axis=1).min()


def of_cells(cells):
    """The closed surface around unit cubes at integer places (N, 3)."""
    there, corners, faces = {tuple(cell) for cell in cells}, {}, []
    for cell in there:
        for axis in range(3):
            for side in (0, 1):
                way = np.eye(3, dtype=int)[axis] * (2 * side - 1)
                if tuple(np.add(cell, way)) in there:
                    continue
                u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
                base = np.add(cell, side * np.eye(3, dtype=int)[axis])
                square = [tuple(base), tuple(base + u), tuple(base + u + v), tuple(base + v)]
                a, b, c, d = (corners.setdefault(corner, len(corners)) for corner in square)
                faces += [[a, b, c], [a, c, d]] if side else [[a, c, b], [a, d, c]]
    return np.array(list(corners), float), np.array(faces)


def test_a_meshed_ball_is_within_its_sagitta_of_the_ball():
    surface = ball()
    points = rng.uniform(-2 * RADIUS, 2 * RADIUS, (4000, 3))
    exact = np.linalg.norm(points, axis=1) - RADIUS
    near = exact < RADIUS
    normals, found = signed_distances(of(surface), points)
    deeper = (found - exact)[near]
    assert -1e-6 < deeper.min() and deeper.max() < sagitta(surface) + 1e-6
    assert deeper.max() > 0.7 * sagitta(surface), "the points lie densely enough to see it"
    sure = near & (np.abs(exact) > 2 * sagitta(surface))
    assert np.array_equal(found[sure] < 0.0, exact[sure] < 0.0)
    out = (exact > 0.02) & near
    outward = points / np.linalg.norm(points, axis=1, keepdims=True)
    turned = np.arccos(np.clip((normals * outward)[out].sum(axis=1), -1, 1))
    facet = np.arccos((surface.face_normals[surface.face_adjacency].prod(axis=1)).sum(axis=1)).max()
    assert turned.max() < facet


def test_a_meshed_box_is_the_box():
    points = rng.uniform(-1.2, 1.2, (4000, 3)) * HALF
    normals, found = signed_distances(of(trimesh.creation.box(2 * HALF)), points)
    wanted_normals, wanted = signed_distances(Box(HALF), points)
    np.testing.assert_allclose(found, wanted, atol=1e-6)
    gaps = np.sort(HALF - np.abs(points), axis=1)
    one_way = (wanted > 0.0) | (gaps[:, 1] - gaps[:, 0] > 1e-4)
    np.testing.assert_allclose(normals[one_way], wanted_normals[one_way], atol=1e-3)


def test_at_the_surface_the_normal_is_that_of_the_face_and_beside_an_edge_between_its_faces():
    surface = ball(2)
    at = surface.triangles_center
    for off in (-1e-7, 0.0, 1e-7):
        normals, found = signed_distances(of(surface), at + off * surface.face_normals)
        np.testing.assert_allclose(normals, surface.face_normals, atol=1e-4)
        np.testing.assert_allclose(found, off, atol=1e-7)
    normals, _ = signed_distances(of(surface), surface.vertices)
    assert ((normals * surface.vertices).sum(axis=1) / RADIUS).min() > 0.999


def test_between_two_fingers_is_outside_and_in_a_cavity_too():
    """Where faces on both sides are equally near, and where a shell lies in another."""
    fingers = of_cells([(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 0, 1), (2, 0, 1)])
    points = np.array([[1.5, 0.5, 1.8], [1.5, 0.5, 1.5], [1.5, 0.4, 1.25], [1.5, 0.5, 0.5], [0.5, 0.5, 1.5]])
    _, found = signed_distances(Mesh(*fingers), points)
    np.testing.assert_allclose(found, [0.5, 0.5, 0.25, -0.5, -0.5], atol=1e-6)
    hollow = of_cells([(x, y, z) for x in range(3) for y in range(3) for z in range(3) if (x, y, z) != (1, 1, 1)])
    _, found = signed_distances(Mesh(*hollow), [[1.5, 1.5, 1.5], [1.5, 1.5, 1.25], [0.5, 1.5, 1.5], [-0.25, 1.0, 1.0]])
    np.testing.assert_allclose(found, [0.5, 0.25, -0.5, 0.25], atol=1e-6)


def test_spikes_and_hollows_have_the_sides_that_solid_angles_tell():
    """A ball with long thorns and deep dents; a point is inside where the triangles fill all directions around it."""
    surface = ball(2)
    vertices = surface.vertices * rng.uniform(0.3, 1.7, (len(surface.vertices), 1))
    points = rng.uniform(-1.5 * RADIUS, 1.5 * RADIUS, (3000, 3))
    _, found = signed_distances(Mesh(vertices, surface.faces), points)
    a, b, c = (vertices[surface.faces[:, k]][None] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    ab, bc, ca = ((u * v).sum(axis=2) for u, v in ((a, b), (b, c), (c, a)))
    angle = 2 * np.arctan2((a * np.cross(b, c)).sum(axis=2), la * lb * lc + ab * lc + bc * la + ca * lb).sum(axis=1)
    sure = np.abs(found) > 1e-6
    assert np.array_equal(found[sure] < 0.0, angle[sure] > 2 * np.pi) and (angle > 2 * np.pi).sum() > 100
    _, nearest, _ = trimesh.proximity.closest_point_naive(trimesh.Trimesh(vertices, surface.faces), points[:300])
    np.testing.assert_allclose(np.abs(found[:300]), nearest, atol=1e-6)


def test_far_away_the_distance_is_none_too_large_and_the_way_leads_out():
    points = rng.normal(size=(500, 3))
    points *= rng.uniform(1, 100, (500, 1)) / np.linalg.norm(points, axis=1, keepdims=True)
    mesh = of(trimesh.creation.box(2 * HALF))
    normals, found = signed_distances(mesh, points)
    _, exact = signed_distances(Box(HALF), points)
    assert (found <= exact + 1e-5).all() and (found > 0.99 * (exact - mesh.reach())).all()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)
    assert ((normals * points).sum(axis=1) > 0.0).all()


def surfaces():
    """Name -> surface: round, with edges, with a hole and concave, and of slivers."""
    cells = [cell for cell in np.ndindex(3, 3, 2) if cell[:2] != (1, 1)]
    slivers = trimesh.creation.cylinder(radius=0.1, height=0.6, sections=200)
    ring = trimesh.Trimesh(*of_cells(cells))
    ring.apply_scale(0.1)
    box = trimesh.creation.box(2 * HALF)
    return {
        "ball": ball(4),
        "box": box,
        "fine box": box.subdivide().subdivide().subdivide(),
        "ring": ring,
        "slivers": slivers,
    }


@pytest.mark.parametrize("name", ["ball", "box", "fine box", "ring", "slivers"])
def test_the_grid_of_a_mesh_promises_no_more_than_is_true(name):
    """The bound is never above the distance. Outside it is below it by two diagonals of a cell at most."""
    mesh = of(surfaces()[name])
    low, high = mesh.points().min(axis=0), mesh.points().max(axis=0)
    points = low + rng.uniform(-0.5, 1.5, (6000, 3)) * (high - low)
    on = mesh.points()[mesh.triangles[rng.integers(len(mesh.triangles), size=6000)]]
    on = (on * rng.dirichlet((1, 1, 1), 6000)[:, :, None]).sum(axis=1) + rng.normal(scale=0.02, size=(6000, 3))
    grid = mesh.data(wp.get_device("cpu")).grid
    # Between cells too, where rounding tells in which of them a point is.
    between = grid.origin + grid.spacing * rng.integers(0, grid.shape, size=(6000, 3))
    points, spacing = np.concatenate([points, on, between]), grid.spacing
    normals, found = signed_distances(mesh, points)
    least, exact = of_a_mesh(mesh, points)
    near = exact[:, 3] < mesh.reach() * 0.99  # farther, a mesh tells less than the distance by itself
    assert (least <= exact[:, 3] + 1e-6)[near].all()
    told = ((points > low - spacing) & (points < high + spacing)).all(axis=1) & (exact[:, 3] > 0.0)
    assert told.sum() > 100 and (exact[:, 3] - least)[told].max() < 2.0 * np.sqrt(3.0) * spacing
    # Its lists leave no triangle out that is the nearest of a point.
    np.testing.assert_allclose(found, exact[:, 3], atol=1e-6)
    clear = np.abs(found) > 1e-3
    assert np.quantile(np.abs(normals - exact[:, :3])[clear].max(axis=1), 0.98) < 1e-2


def test_the_grid_of_a_mesh_promises_no_more_than_a_closed_form():
    points = rng.uniform(-2, 2, (6000, 3)) * HALF
    _, exact = signed_distances(Box(HALF), points)
    least, _ = of_a_mesh(of(trimesh.creation.box(2 * HALF)), points)
    assert (least <= exact + 1e-6).all() and (exact - least)[exact > 0.0].max() < 0.2


@pytest.mark.long
def test_a_mesh_is_round_where_its_shape_is():
    """A ball comes between particles just where a sphere does, within the quarter of the thickness that is kept."""
    fine, thickness = of(ball(5)), 0.005
    for needed in (0.2 * RADIUS, 0.9 * RADIUS):
        assert not fine.enters(needed, thickness) and not Sphere(RADIUS).enters(needed, thickness)
    for needed in (1.01 * RADIUS, 3.0 * RADIUS):
        assert fine.enters(needed, thickness) and Sphere(RADIUS).enters(needed, thickness)
    for surface in (trimesh.creation.box(2 * HALF), trimesh.creation.icosahedron(), surfaces()["ring"]):
        assert of(surface).enters(0.9 * RADIUS, thickness)
    plate = trimesh.creation.box((1.0, 1.0, 0.002))
    assert of(plate).enters(0.9 * RADIUS, thickness) and of(plate.subdivide()).enters(0.9 * RADIUS, thickness)


@pytest.mark.parametrize("thickness", [1e-3, 0.02])
def test_the_curvature_that_particles_alone_need_keeps_the_middle_between_them_out(thickness):
    """Particles on the corners of a square, at their thickness on a ball: the middle is as deep as is allowed."""
    gap, depth = 0.02, max(thickness, 0.002)
    radius = least_roundness(gap, 0.0, depth, thickness)
    middle = np.sqrt((radius + thickness) ** 2 - gap**2)
    assert middle == pytest.approx(radius + thickness - depth, rel=1e-9)
    assert least_roundness(gap, 0.5, depth, thickness) == 0.5 - thickness


def test_convex_meshes_are_known():
    box, beside = trimesh.creation.box(), trimesh.creation.box()
    beside.apply_translation((3, 0, 0))
    bumpy = trimesh.creation.icosphere(3)
    bumpy.vertices[7] *= 0.99
    convex = [box, trimesh.creation.icosphere(3), trimesh.creation.cylinder(1, 2), trimesh.creation.cone(1, 2)]
    others = [box + beside, bumpy, trimesh.creation.torus(1, 0.3), trimesh.creation.annulus(0.5, 1, 1)]
    for surface in convex:
        assert is_convex(np.array(surface.vertices), np.array(surface.faces))
    for surface in others:
        assert not is_convex(np.array(surface.vertices), np.array(surface.faces))


def test_a_volume_is_its_mesh_within_the_spacing():
    surface = trimesh.creation.box(2 * HALF)
    baked = SignedDistance.from_mesh(of(surface), cells=40)
    h = baked.spacing[0]
    assert h == pytest.approx(0.6 / 40)
    points = rng.uniform(-1.1, 1.1, (4000, 3)) * HALF
    normals, found = signed_distances(baked, points)
    _, exact = signed_distances(Box(HALF), points)
    # A creased function is wrong by at most a cell; between creases trilinear interpolation of it is exact.
    assert np.abs(found - exact).max() < 0.5 * h
    q = np.abs(points) - HALF
    second, most = np.sort(q, axis=1)[:, 1:].T
    plain = (most - second > 3 * h) & (second < -3 * h) & (most > 2 * h - HALF[0])
    assert plain.sum() > 300
    np.testing.assert_allclose(found[plain], exact[plain], atol=1e-6)
    flat = np.eye(3)[np.argmax(q, axis=1)] * np.sign(points)
    np.testing.assert_allclose(normals[plain], flat[plain], atol=1e-4)


def test_a_ball_on_a_grid_has_the_error_of_its_curvature():
    """Trilinear interpolation errs by h^2/8 times the second derivatives, whose sum is 2/r of a distance."""
    h, n = 0.02, 41
    grid = np.stack(np.meshgrid(*[np.arange(n) * h - 0.4] * 3, indexing="ij"), axis=-1)
    volume = SignedDistance(np.linalg.norm(grid, axis=-1) - RADIUS, (-0.4, -0.4, -0.4), h)
    points = rng.uniform(-0.4, 0.4, (4000, 3))
    away = np.linalg.norm(points, axis=1)
    normals, found = signed_distances(volume, points)
    off, some = found - (away - RADIUS), away > 0.2
    assert -1e-6 < off[some].min() and 0.5 < off[some].max() / (h * h / 8 * 2 / 0.2) < 1.0
    assert np.degrees(np.arccos(np.clip((normals * points).sum(axis=1) / away, -1, 1)))[some].max() < 4.0
    assert RADIUS <= volume.reach() < RADIUS + 2 * h
    # Beyond the bounds it is that of the nearest point of the bounds, on the way there, and none too large.
    points = rng.uniform(-1, 1, (2000, 3))
    points = points[np.abs(points).max(axis=1) > 0.4]
    q = np.clip(points, -0.4, 0.4)
    wanted = np.sqrt(((points - q) ** 2).sum(axis=1) + (np.linalg.norm(q, axis=1) - RADIUS) ** 2)
    normals, found = signed_distances(volume, points)
    np.testing.assert_allclose(found, wanted, atol=2e-3)
    assert (found <= np.linalg.norm(points, axis=1) - RADIUS + 1e-3).all()
    assert ((normals * points).sum(axis=1) > 0.0).all()


def test_a_volume_is_baked_once(monkeypatch, capsys):
    mesh = of(ball(2))
    first = SignedDistance.from_mesh(mesh, cells=16)
    capsys.readouterr()
    with monkeypatch.context() as without:
        without.setattr(baking, "_compute", None)
        second = SignedDistance.from_mesh(mesh, cells=16)
    assert np.array_equal(first.values, second.values) and capsys.readouterr() == ("", "")
    (kept,) = baking.cache().iterdir()
    kept.write_bytes(b"damaged")
    assert np.array_equal(SignedDistance.from_mesh(mesh, cells=16).values, first.values)


def test_a_file_of_either_is_read_in_its_units(tmp_path):
    surface, path = ball(), tmp_path / "a ball.stl"
    surface.export(path)
    for name in (str(path), f"file://{str(path).replace(' ', '%20')}"):
        mesh = Mesh.from_file(name, scale=1e-3, static_friction=0.9)
        assert mesh.reach() == pytest.approx(1e-3 * RADIUS, rel=1e-3) and mesh.static_friction == 0.9
        assert len(mesh.vertices) == len(surface.vertices)
    grid = np.linalg.norm(np.indices((9, 9, 9)) - 4.0, axis=0) - 2.0
    np.savez(tmp_path / "ball.npz", values=grid, origin=(-4, -4, -4), spacing=1.0)
    volume = SignedDistance.from_file(str(tmp_path / "ball.npz"), scale=0.1)
    _, found = signed_distances(volume, [[0.4, 0, 0], [0, 0, 0], [0, -0.3, 0]])
    np.testing.assert_allclose(found, [0.2, -0.2, 0.1], atol=1e-6)
    baked = SignedDistance.from_file(str(path), scale=1e-3)
    assert RADIUS * 1e-3 < baked.reach() < RADIUS * 1.1e-3 and baked.file == str(path)


OPEN = (np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float), [[0, 2, 1], [0, 1, 3], [1, 2, 3]])
CLOSED = [*OPEN[1], [0, 3, 2]]
NOT_OPENED = {
    "nowhere.stl": "; no such file is in '/.*'; allowed are .obj, ",
    "package://no_such_package/a.stl": "and no package 'no_such_package' is installed|which needs ament_index_python",
    "words.stl": "cannot be read as a triangle mesh|holds no triangles",
}


def test_what_has_no_inside_is_told():
    assert what_is_open(OPEN[0], np.array(CLOSED)) == ""
    for triangles, sentence in (
        (OPEN[1], r"^Mesh is open at 3 edges, such as \d-\d; allowed is a closed surface"),
        ([*CLOSED[:3], CLOSED[3][::-1]], "^Mesh is open at 3 edges"),
        ([*CLOSED, CLOSED[0]], "^Mesh is open at 3 edges"),
        ([face[::-1] for face in CLOSED], "^Mesh turns its inside out; allowed are triangles that turn counter"),
        ([*CLOSED[:3], [0, 3, 4]], "^Mesh.triangles name vertex 4; allowed are 0 to 3"),
    ):
        with pytest.raises(ValueError, match=sentence):
            Mesh(OPEN[0], triangles)
    with pytest.raises(ValueError, match=r"^Mesh.vertices has shape \(0,\); allowed are N rows of 3 finite numbers"):
        Mesh()
    with pytest.raises(ValueError, match="^Mesh.scale is 0; allowed is a finite number from 1e-06"):
        Mesh(OPEN[0], CLOSED, scale=0)


def test_files_that_cannot_be_are_told(tmp_path):
    (tmp_path / "words.stl").write_text("words")
    (tmp_path / "words.npz").write_text("words")
    np.savez(tmp_path / "other.npz", values=np.zeros(3))
    for name, sentence in NOT_OPENED.items():
        with pytest.raises(ValueError, match=f"^Mesh.from_file is .*({sentence})"):
            Mesh.from_file(name if "://" in name else str(tmp_path / name))
    trimesh.Trimesh(*OPEN).export(tmp_path / "open.stl")
    with pytest.raises(ValueError, match="^Mesh of '.* is open at 3 edges"):
        SignedDistance.from_file(str(tmp_path / "open.stl"))
    for name, sentence in {
        "words.npz": "which cannot be read: it is no .npz file of numbers",
        "nowhere.npz": "no such file is in '/.*'; allowed are .npz, .obj, ",
        "other.npz": r"which has \['values'\]; allowed is one with \['values', 'origin', 'spacing'\]",
    }.items():
        with pytest.raises(ValueError, match=f"^SignedDistance.from_file is '.*{name}'[,;] {sentence}"):
            SignedDistance.from_file(str(tmp_path / name))


def test_values_that_are_no_distances_are_told():
    grid = np.indices((4, 4, 4))[2] - 1.5
    SignedDistance(grid, spacing=1.0)
    for values, sentence in (
        (2 * grid, "change by 2 m a metre along axis 2; allowed is 1, as of distances"),
        (grid + 2, "are at least 0.5; allowed are some below 0, inside"),
        (grid[0], r"has shape \(4, 4\); allowed are finite numbers, at least 2 along each of 3 axes"),
        (np.full((4, 4, 4), np.nan), "allowed are finite numbers"),
        ("words", "allowed are finite numbers"),
    ):
        with pytest.raises(ValueError, match=f"^SignedDistance.values .*{sentence}"):
            SignedDistance(values, spacing=1.0)
    with pytest.raises(ValueError, match="^SignedDistance.spacing is .*; allowed is 3 finite numbers"):
        SignedDistance(grid, spacing=(1.0, 1.0))
    with pytest.raises(ValueError, match="^cells is 1; allowed is a whole number from 2 to 400"):
        SignedDistance.from_mesh(Mesh(OPEN[0], CLOSED), cells=1)
