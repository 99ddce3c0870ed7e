# SPDX-License-Identifier: Apache-2.0
"""Colliders that are meshes are drawn as they are, by a file or by their triangles, and where they are."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from visualization_msgs.msg import MarkerArray

from cloth_sim_ros.ros.inputs.pose_track import Pose
from cloth_sim_ros.ros.outputs.colliders import markers_of
from cloth_sim_ros.sim import Mesh, SignedDistance, Sphere
from cloth_sim_ros.viewer.drawing import Drawing
from cloth_sim_ros.viewer.live.scene import MOST_MOVED, LiveScene

HALF = np.array([0.03, 0.02, 0.05])  # [m] of a link
TURN = Rotation.from_rotvec([0.3, -0.4, 0.5])
POSE = Pose((0.4, -0.1, 0.7), tuple(TURN.as_quat().tolist()))


@pytest.fixture
def scene(server):
    """The drawing of a node without handles."""
    found = LiveScene(server, Drawing(server, "/page"), SimpleNamespace(names=lambda kind: []))
    yield found
    found.close()


@pytest.fixture
def file(tmp_path):
    """An STL file of a link, in millimetres."""
    trimesh.creation.box(2000 * HALF).export(tmp_path / "the link.stl")
    return tmp_path / "the link.stl"


def show(scene, collider, pose=POSE):
    """What is drawn of a collider, and its vertices (V, 3) [m] in the axes of the collider."""
    scene.markers(MarkerArray(markers=markers_of("link", collider, pose)))
    (body,) = scene.bodies.values()
    vertices, turn, place = body.vertices, TURN, np.array(pose.position)
    if np.linalg.norm(body.position) > 0.0:
        x, y, z = np.roll(body.wxyz, -1)[:3]
        assert (body.position, (x, y, z)) == (pytest.approx(place), pytest.approx(pose.orientation[:3]))
        return body, vertices
    return body, turn.inv().apply(vertices - place)


def extent(vertices):
    return pytest.approx(np.concatenate([vertices.min(axis=0), vertices.max(axis=0)]), abs=1e-6)


def test_a_mesh_of_a_file_is_as_large_as_its_unit_says(scene, file):
    body, vertices = show(scene, Mesh.from_file(str(file), 0.001))
    assert [*-HALF, *HALF] == extent(vertices) and len(body.faces) == 12
    moved = Pose((0.5, -0.1, 0.7), POSE.orientation)
    again, vertices = show(scene, Mesh.from_file(str(file), 0.001), moved)
    assert again is body and [*-HALF, *HALF] == extent(vertices)


def test_a_mesh_without_a_file_has_its_triangles_and_new_ones_where_they_change(scene):
    unit = trimesh.creation.box(2 * HALF)
    _, vertices = show(scene, Mesh(vertices=unit.vertices, triangles=unit.faces))
    assert [*-HALF, *HALF] == extent(vertices)
    _, vertices = show(scene, Mesh(vertices=2.0 * unit.vertices, triangles=unit.faces))
    assert [*(-2 * HALF), *(2 * HALF)] == extent(vertices)


def test_large_meshes_and_cells_are_moved_by_their_pose(scene):
    ball = trimesh.creation.icosphere(4, 0.1)
    _, vertices = show(scene, Mesh(vertices=ball.vertices, triangles=ball.faces))
    assert len(vertices) > MOST_MOVED and np.linalg.norm(vertices, axis=1) == pytest.approx(0.1, abs=1e-3)
    volume = SignedDistance.from_mesh(Mesh(vertices=ball.vertices, triangles=ball.faces), 24)
    _, vertices = show(scene, volume)
    assert np.abs(np.linalg.norm(vertices, axis=1) - 0.1).max() < 4 * max(volume.spacing)


def test_a_file_that_cannot_be_read_is_told_and_the_rest_is_drawn(scene, file, caplog):
    (marker,) = markers_of("link", Mesh.from_file(str(file), 0.001), POSE)
    file.unlink()
    scene.markers(MarkerArray(markers=[marker, *markers_of("ball", Sphere(radius=0.1), POSE)]))
    assert "a collider is not drawn: the mesh of link is 'file://" in caplog.text
    assert "no such file is in" in caplog.text and len(scene.bodies["link/0"].faces) == 0
    assert len(scene.bodies["ball/0"].faces) > 0
