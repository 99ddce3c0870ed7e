# SPDX-License-Identifier: Apache-2.0
"""The node on config/curtain.yaml, seen from another process: rate, values, ball, wind and compliance."""

import numpy as np
import pytest
from client import LATCHED, Client, fields, seconds
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from visualization_msgs.msg import Marker

SIDE = 1.2  # [m] of the curtain
MIDDLE = (0.0, 0.0, 1.2)  # [m]
COLUMNS = 32


@pytest.fixture
def curtain(start, client) -> Client:
    """The running node and, as client.clouds, its particles."""
    start("config/curtain.yaml").ready()
    client.clouds = client.listen(PointCloud2, "/cloth_sim/cloth/particles", 1)
    client.until(lambda: client.clouds, timeout=60.0)
    return client


def newest(client: Client) -> np.ndarray:
    """Positions (N, 3) of the next cloud that comes."""
    client.clouds.clear()
    client.until(lambda: client.clouds, timeout=60.0)
    return fields(client.clouds[-1])[:, :3]


def settle(client: Client, component: int, timeout: float = 20.0) -> np.ndarray:
    """Positions once the mean of a component moves less than 0.1 mm in half a second."""
    before, found = np.inf, []

    def still() -> bool:
        nonlocal before
        client.spin(0.5)
        found[:] = [newest(client)]
        mean = found[0][:, component].mean()
        settled, before = abs(mean - before) < 1e-4, mean
        return settled

    client.until(still, timeout)
    return found[0]


@pytest.mark.long
def test_sends_60_clouds_a_second(curtain):
    def rate() -> float:
        curtain.clouds.clear()
        curtain.spin(3.0)
        stamps = [seconds(cloud.header.stamp) for cloud in curtain.clouds]
        assert np.diff(stamps).min() > 0.0
        return (len(stamps) - 1) / (stamps[-1] - stamps[0])

    curtain.spin(1.0)
    rates = [rate() for _ in range(3)]  # the median, since the machine may be busy with something else for a moment
    assert 58.0 < np.median(rates) < 62.0, rates


def test_particles_mesh_and_topology_agree(curtain):
    markers = curtain.listen(Marker, "/cloth_sim/cloth/mesh", 1)
    topologies = curtain.listen(Mesh, "/cloth_sim/cloth/topology", LATCHED)
    curtain.until(lambda: markers and topologies)
    triangles = np.array([t.vertex_indices for t in topologies[0].triangles])
    rest = np.array([(v.x, v.y, v.z) for v in topologies[0].vertices])
    grid = np.linspace(-SIDE / 2, SIDE / 2, COLUMNS)
    assert rest == pytest.approx(
        np.array([(x, 0.0, MIDDLE[2] + z) for z in grid for x in grid]), abs=1e-5
    )  # particle (ix, iy) is index iy*nx + ix, local y points up
    assert len(triangles) == 2 * (COLUMNS - 1) ** 2 and triangles.max() == len(rest) - 1

    def same_frame():
        stamps = {seconds(cloud.header.stamp): cloud for cloud in curtain.clouds}
        return next((m, stamps[seconds(m.header.stamp)]) for m in markers if seconds(m.header.stamp) in stamps)

    curtain.until(
        lambda: {seconds(m.header.stamp) for m in markers} & {seconds(c.header.stamp) for c in curtain.clouds}
    )
    marker, cloud = same_frame()
    corners = np.array([(p.x, p.y, p.z) for p in marker.points]).reshape(-1, 3, 3)
    particles = fields(cloud)
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "normal_x", "normal_y", "normal_z"]
    assert (marker.type, marker.ns, marker.header.frame_id) == (Marker.TRIANGLE_LIST, "cloth", "world")
    assert np.array_equal(corners.astype(np.float32), particles[:, :3][triangles])
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    vertex = np.zeros((len(rest), 3))
    for corner in range(3):
        np.add.at(vertex, triangles[:, corner], face)
    vertex /= np.linalg.norm(vertex, axis=1, keepdims=True)
    assert particles[:, 3:] == pytest.approx(vertex, abs=1e-3)
    top = particles[-COLUMNS:, :3]
    assert top == pytest.approx(rest[-COLUMNS:], abs=1e-5)  # the upper edge is pinned


def test_the_ball_pushes_the_curtain(curtain):
    before = settle(curtain, 1)
    assert abs(before[:, 1].mean()) < 0.02
    y = -0.6

    def push():
        nonlocal y
        y = min(y + 0.005, 0.15)
        curtain.move("ball", (0.0, y, 1.0))

    curtain.until(lambda: y >= 0.15, meanwhile=push)
    curtain.spin(1.0, meanwhile=push)
    after = newest(curtain)
    assert after[:, 1].mean() > before[:, 1].mean() + 0.05
    gaps = np.linalg.norm(after - np.array((0.0, 0.15, 1.0)), axis=1) - 0.2
    assert gaps.min() == pytest.approx(0.01, abs=5e-3)  # touches, at the cloth's thickness


@pytest.mark.long
def test_the_wind_lifts_the_curtain(curtain):
    calm = settle(curtain, 1)
    curtain.blow((0.0, 6.0, 0.0))
    curtain.spin(3.0, meanwhile=lambda: curtain.blow((0.0, 6.0, 0.0)))
    windy = newest(curtain)
    lower = slice(0, COLUMNS)  # its free edge
    assert windy[lower, 1].mean() > calm[lower, 1].mean() + 0.1
    assert windy[lower, 2].mean() > calm[lower, 2].mean() + 0.02


@pytest.mark.long
def test_compliance_changes_the_sag(curtain):
    lower = slice(0, COLUMNS)
    stiff = settle(curtain, 2)[lower, 2].mean()
    for kind in ("stretch", "shear"):
        assert curtain.set(f"cloth.{kind}_compliance", 0.3).successful
    # Another method may act now, and its kernels may have to be compiled first: the curtain stands still meanwhile.
    curtain.until(lambda: newest(curtain)[lower, 2].mean() < stiff - 0.01, timeout=60.0)
    for kind, value in (("stretch", "1e-3"), ("shear", "3e-3")):
        assert curtain.set(f"cloth.{kind}_compliance", value).successful
    curtain.until(lambda: abs(newest(curtain)[lower, 2].mean() - stiff) < 0.003, timeout=60.0)
    assert settle(curtain, 2)[lower, 2].mean() == pytest.approx(stiff, abs=0.003)
