# SPDX-License-Identifier: Apache-2.0
"""Colliders from a robot's description: what collides of a link, in the axes of the link."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Mesh

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("yourdfpy")

ROBOT = """
<robot name="hand">
  <link name="palm"/>
  <link name="finger">
    <collision>
      <origin xyz="0 0 0.1" rpy="0 1.5707963267948966 0"/><geometry><box size="0.06 0.04 0.02"/></geometry>
    </collision>
    <collision><origin xyz="0 0.3 0"/><geometry><sphere radius="0.01"/></geometry></collision>
    <collision><origin xyz="0.3 0 0"/><geometry><cylinder radius="0.02" length="0.1"/></geometry></collision>
    <collision><geometry><mesh filename="tip.stl" scale="0.001 0.001 0.001"/></geometry></collision>
  </link>
  <joint name="j" type="fixed"><parent link="palm"/><child link="finger"/><origin xyz="5 5 5"/></joint>
</robot>
"""


@pytest.fixture
def robot(tmp_path):
    (tmp_path / "hand.urdf").write_text(ROBOT)
    trimesh.creation.box((8, 8, 8)).export(tmp_path / "tip.stl")
    return tmp_path / "hand.urdf"


def test_all_that_collides_of_a_link_lies_in_its_axes(robot):
    finger = Mesh.from_file(f"{robot}#finger")
    parts = trimesh.Trimesh(finger.vertices, finger.triangles, process=False).split()
    boxes = {tuple(np.round(part.bounds.mean(axis=0), 3)): np.ptp(part.bounds, axis=0) for part in parts}
    wanted = {
        (0.0, 0.0, 0.1): (0.02, 0.04, 0.06),  # turned by a quarter about y
        (0.0, 0.3, 0.0): (0.02, 0.02, 0.02),
        (0.3, 0.0, 0.0): (0.04, 0.04, 0.1),
        (0.0, 0.0, 0.0): (0.008, 0.008, 0.008),
    }
    assert boxes.keys() == wanted.keys()
    for place, size in wanted.items():
        assert boxes[place] == pytest.approx(size, rel=0.02)


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("hand.urdf#palm", "which has nothing that collides in link 'palm'"),
        ("hand.urdf#thumb", "which has no link 'thumb'; allowed are 'palm, finger'"),
        ("none.urdf#finger", "no such file is in"),
    ],
)
def test_a_link_that_cannot_be_is_refused_in_a_sentence(robot, name, sentence):
    with pytest.raises(ValueError, match=sentence):
        Mesh.from_file(str(robot.parent / name))


def test_a_tip_that_is_not_there_is_named(robot):
    (robot.parent / "tip.stl").unlink()
    with pytest.raises(ValueError, match="the mesh of finger is .*tip.stl'; no such file is in '.*'; allowed"):
        Mesh.from_file(f"{robot}#finger")
