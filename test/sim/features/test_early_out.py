# SPDX-License-Identifier: Apache-2.0
"""Sheets that lie flat cannot meet themselves: what counts as flat is apart in float64, and no bit depends on it."""

import numpy as np
import pytest
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from cloth_sim_ros.sim import Cloth, Plane, Scene, Settings, Simulation, Sphere, Wind
from cloth_sim_ros.sim.topology import Topology, build

THICKNESS = 0.002


def grid(nx=9, ny=12, **fields):
    return Cloth(resolution=(nx, ny), size=(0.4, 0.6), thickness=THICKNESS, self_contact=True, pins="none", **fields)


def mesh(outline=lambda x, y: True, bulge=0.0):
    """An irregular mesh over the part of a rectangle that `outline` keeps."""
    x, y = np.meshgrid(np.linspace(-0.2, 0.2, 9), np.linspace(-0.3, 0.3, 12))
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    inner = (np.abs(points[:, 0]) < 0.19) & (np.abs(points[:, 1]) < 0.29)
    points[inner] += np.random.default_rng(3).uniform(-0.008, 0.008, (inner.sum(), 2))
    triangles = Delaunay(points).simplices
    triangles = triangles[[outline(*points[each].mean(axis=0)) for each in triangles]]
    used, corners = np.unique(triangles, return_inverse=True)
    vertices = np.c_[points[used], bulge * (points[used] ** 2).sum(axis=1)]
    return Cloth.from_mesh(vertices, corners.reshape(-1, 3), thickness=THICKNESS, self_contact=True)


def is_folded(sim):
    return bool(sim._bodies.coupled._search.pairs.folded.numpy()[0])


def least_distance(x, y, triangles):
    """Between points of a sheet at rest x and elsewhere y (N, 3), over that at rest: random points of all triangles."""
    weights = np.random.default_rng(4).dirichlet((0.4, 0.4, 0.4), len(triangles))
    points, there = (np.einsum("tk,tkd->td", weights, each[triangles]) for each in (x, y))
    points, there = np.concatenate([x, points]), np.concatenate([y, there])
    at_rest, now = (np.linalg.norm(p[:, None] - p[None], axis=2) for p in (points, there))
    far = at_rest > 1e-6
    return (now[far] / at_rest[far]).min()


@pytest.mark.parametrize("sheet", [grid(), mesh()], ids=["grid", "mesh"])
def test_what_counts_as_flat_is_apart(device, sheet):
    """Rolled by any angle about any axis, stretched and turned: most are flat below a half turn, none beyond."""
    floor = {"floor": Plane(position=(0, 0, -9))}
    sim = Simulation(Scene({"it": sheet}, floor, gravity=(0, 0, 0)), Settings(substeps=40), device)
    rest, triangles = sim.rest_positions("it").astype(float), sim.triangles("it")
    gap = sim._bodies.topologies["it"].fold_gap
    random, found = np.random.default_rng(5), {True: 0, False: 0}
    for _ in range(60):
        turn, about = random.uniform(0.1, 5.0), random.uniform(0.0, np.pi)
        along, across = np.array([np.cos(about), np.sin(about), 0.0]), np.array([-np.sin(about), np.cos(about), 0.0])
        u, v = rest @ along, rest @ across
        angle = turn * u / np.ptp(u)
        radius = np.ptp(u) / turn
        x = np.outer(radius * np.sin(angle), along) + np.outer(v, across) + np.outer(radius * np.cos(angle), [0, 0, 1])
        x = x @ (np.eye(3) + random.uniform(-0.03, 0.03, (3, 3))) @ Rotation.random(random_state=random).as_matrix()
        sim.set_positions("it", x)
        sim.step()
        folded = is_folded(sim)
        found[folded] += 1
        assert folded or turn < np.pi, "a triangle looks back"
        if not folded:
            kept = min(0.8, 2.0 * THICKNESS / gap)
            assert least_distance(rest, sim.positions("it").astype(float), triangles) >= kept
    assert min(found.values()) >= 15, found


@pytest.mark.long
def test_no_bit_depends_on_it(device, monkeypatch):
    """A sheet that swings, is blown over a ball and folds: as if pairs were looked for in every frame."""
    sheet = Cloth(resolution=(12, 12), thickness=THICKNESS, pins="top", self_contact=True)
    scene = Scene({"it": sheet}, {"ball": Sphere(radius=0.1, position=(0, 0.1, -0.5))}, wind=Wind(velocity=(0, 6, 0)))
    with monkeypatch.context() as patch:
        patch.setattr(Topology, "fold_gap", 0.0)
        always = Simulation(scene, Settings(), device, worlds=2)
    sim = Simulation(scene, Settings(), device, worlds=2)
    folded = []
    for _ in range(75):
        for each in (sim, always):
            each.step()
        assert np.array_equal(sim.positions("it"), always.positions("it"))
        assert is_folded(always)
        folded.append(is_folded(sim))
        assert folded[-1] or sim.report()["it"]["pairs"] == 0
    assert 5 < sum(folded) < 50, "it is flat at first, then folded"


def test_what_is_no_flat_convex_piece_always_counts_as_folded():
    pieces = {
        "with a hole": mesh(lambda x, y: np.hypot(x, y) > 0.1),
        "L": mesh(lambda x, y: x < 0.0 or y < 0.0),
        "bulged": mesh(bulge=0.5),
        "that tears": grid(tear_strain=0.5),
    }
    assert {name: build(piece, "it", False).fold_gap for name, piece in pieces.items()} == dict.fromkeys(pieces, 0.0)


def test_the_least_distance_of_parts_at_rest_is_a_triangles_height():
    assert build(grid(), "it", False).fold_gap == pytest.approx(1.0 / np.hypot(8 / 0.4, 11 / 0.6))
    turned = grid(position=(1, 2, 3), orientation=tuple(Rotation.from_rotvec((0.3, 1.0, 2.0)).as_quat()))
    assert build(turned, "it", False).fold_gap == pytest.approx(1.0 / np.hypot(8 / 0.4, 11 / 0.6))
    disc = mesh(lambda x, y: True)
    corners = np.asarray(disc.vertices)[np.asarray(disc.triangles)]
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    assert build(disc, "it", False).fold_gap == pytest.approx((2.0 * areas / longest).min())
