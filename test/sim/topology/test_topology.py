# SPDX-License-Identifier: Apache-2.0
"""Particles and elements of grids, meshes and ropes."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Cloth, Rope
from cloth_sim_ros.sim.topology import build


def grid(**fields):
    return build(Cloth(**{"resolution": (7, 5), "size": (3.0, 2.0), "bend_compliance": 0.1, **fields}), "cloth", True)


def test_grid_counts():
    springs = grid().springs
    assert {kind: len(e.particles) for kind, e in springs.items()} == {"structural": 58, "shear": 48, "bending": 46}


def test_grid_borders_carry_half_the_constant_and_half_the_mass():
    topology = grid()
    structural = topology.springs["structural"]
    on_border = {
        tuple(sorted(p)) for p, s in zip(structural.particles.tolist(), structural.scale, strict=True) if s == 2
    }
    assert (0, 1) in on_border and (0, 7) in on_border and (8, 9) not in on_border and (1, 8) not in on_border
    assert len(on_border) == 2 * 6 + 2 * 4
    assert topology.masses.sum() == pytest.approx(0.2)
    assert topology.masses[[0, 6]] == pytest.approx(topology.masses[8] / 4)
    assert topology.masses[1] == pytest.approx(topology.masses[8] / 2)
    in_air = build(Cloth(resolution=(7, 5), mass=0.2), "it", False, in_air=True).masses
    assert in_air[[0, 6]] == pytest.approx(in_air[8] / np.array([3.0, 6.0])), "corners of two triangles and of one"


@pytest.mark.parametrize(("pins", "count"), [("corners", 2), ("top", 7), ("edges", 20), ("none", 0), ((3, 4), 2)])
def test_pins(pins, count):
    pinned = grid(pins=pins).pinned
    assert pinned.sum() == count
    if pins == "corners":
        assert pinned[[28, 34]].all()


def test_a_grid_given_as_a_mesh_has_the_constants_of_the_grid():
    topology = grid(bend_compliance=None)
    mesh = build(Cloth.from_mesh(topology.rest, topology.triangles, mass=0.2), "mesh", True)
    constants = {tuple(sorted(p)): 1 / s for p, s in zip(mesh.springs["structural"].particles.tolist(),
                                                         mesh.springs["structural"].scale, strict=True)}  # fmt: skip
    # A square cell would give exactly 1 and 1/2; here cells are 0.5 x 0.5.
    structural = topology.springs["structural"]
    for pair, scale in zip(structural.particles.tolist(), structural.scale, strict=True):
        assert constants[tuple(sorted(pair))] == pytest.approx(1 / scale)
    assert mesh.masses.sum() == pytest.approx(0.2)


def test_the_widest_gap_is_where_a_point_is_farthest_from_all_corners():
    """Half the diagonal of a cell; half a segment; the circumcircle of an equilateral triangle."""
    assert grid().widest_gap == pytest.approx(0.5 * np.hypot(0.5, 0.5))
    assert build(Rope(points=[[0, 0, 0], [1, 0, 0], [3, 0, 0]]), "rope", True).widest_gap == pytest.approx(1.0)
    corners = [[0, 0, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0]]
    mesh = build(Cloth.from_mesh(corners, [[0, 1, 2]]), "mesh", True)
    assert mesh.widest_gap == pytest.approx(1.0 / np.sqrt(3.0))


def test_rope_masses_lump_by_length_and_bends_span_uneven_segments():
    rope = build(Rope(points=[[0, 0, 0], [1, 0, 0], [3, 0, 0]], mass=3.0, bend_compliance=1.0), "rope", True)
    assert rope.masses.tolist() == pytest.approx([0.5, 1.5, 1.0])
    assert rope.bends.scale.tolist() == pytest.approx([1.5])
    assert rope.bend_weights.tolist() == [pytest.approx([1.0, 0.5])]
    assert rope.bends.rest.tolist() == pytest.approx([0.0])
