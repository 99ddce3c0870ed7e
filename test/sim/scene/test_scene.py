# SPDX-License-Identifier: Apache-2.0
"""Descriptions are checked where they are made: one sentence that names the thing, the value and what is allowed."""

import dataclasses

import numpy as np
import pytest

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim import (
    Box,
    Capsule,
    Cloth,
    Plane,
    Rope,
    Scene,
    Settings,
    SignedDistance,
    Simulation,
    Sphere,
    Winch,
    Wind,
)
from cloth_sim_ros.sim.physics.quaternion import rotate

SHEET = Scene({"sheet": Cloth(resolution=(2, 2))})
BAD = {
    "resolution 1x1": (lambda: Cloth(resolution=(1, 1)), "Cloth.resolution"),
    "resolution too large": (lambda: Cloth(resolution=(100000, 100000)), "100000"),
    "NaN mass": (lambda: Cloth(mass=float("nan")), "Cloth.mass"),
    "negative compliance": (lambda: Cloth(stretch_compliance=-1.0), "Cloth.stretch_compliance"),
    "text for a number": (lambda: Cloth(thickness="thin"), "thin"),
    "zero quaternion": (lambda: Cloth(orientation=(0, 0, 0, 0)), "quaternion"),
    "unknown bending": (lambda: Cloth(bending="stiff"), "dihedral"),
    "mesh with resolution": (lambda: Cloth.from_mesh(np.eye(3), [[0, 1, 2]], resolution=(4, 4)), "resolution"),
    "mesh rigid in shear": (lambda: Cloth.from_mesh(np.eye(3), [[0, 1, 2]], shear_compliance=0.0), "compliance of 0"),
    "unstable Poisson": (
        lambda: Cloth.from_mesh(np.eye(3), [[0, 1, 2]], shear_compliance=1.0, poisson=1.0),
        "Cloth.poisson is 1; with these compliances allowed is at most 0.95",
    ),
    "Poisson of a grid": (lambda: Cloth(poisson=0.2), "poisson or warp on a grid"),
    "weft of edges": (lambda: Cloth.from_mesh(np.eye(3), [[0, 1, 2]], weft_compliance=1.0), "Cloth.weft_compliance"),
    "rigid weft": (lambda: Cloth(weft_compliance=0.0), "Cloth.weft_compliance is 0"),
    "warp nowhere": (
        lambda: Cloth.from_mesh(np.eye(3), [[0, 1, 2]], shear_compliance=1.0, warp=(0, 0, 0)),
        "without a direction",
    ),
    "warps of other triangles": (
        lambda: Cloth.from_mesh(np.eye(3), [[0, 1, 2]], shear_compliance=1.0, warp=np.ones((2, 3))),
        r"shape (2, 3)",
    ),
    "diagonal stiffer than both": (
        lambda: Cloth(bending="dihedral", bend_compliance=4.0, diagonal_bend_compliance=1.0),
        "diagonal_bend_compliance is 1; allowed is more than a quarter",
    ),
    "mesh beyond its vertices": (lambda: Cloth.from_mesh(np.eye(3), [[0, 1, 3]]), "vertex 3"),
    "mesh of NaN": (lambda: Cloth.from_mesh(np.full((3, 3), np.nan), [[0, 1, 2]]), "finite"),
    "rope of NaN": (lambda: Rope(points=[[0, 0, 0], [0, 0, np.nan]]), "Rope.points holds nan in row 1"),
    "rope without length": (lambda: Rope(points=[[0, 0, 0], [0, 0, 0]]), "points 0 and 1 both at"),
    "cloth masses": (lambda: Cloth(resolution=(3, 3), particle_masses=[1.0] * 8), "9 finite masses"),
    "rope masses": (lambda: Rope(segments=2, particle_masses=[1.0, 1.0]), "3 finite masses"),
    "turn without twist": (lambda: Rope(end_turn=1.0), "Rope.end_turn is 1 without twist; allowed"),
    "twist on a winch": (
        lambda: Rope(winch=Winch(), bend_compliance=1.0, twist_compliance=1.0),
        "Rope.twist_compliance is set for a rope on a winch",
    ),
    "plane in two places": (
        lambda: Plane(point=(0, 0, 1), position=(0, 0, 2)),
        "is [0, 0, 2] beside the point [0, 0, 1]",
    ),
    "plane turned twice": (lambda: Plane(normal=(0, 0, 1), orientation=(1, 0, 0, 0)), "Plane.orientation"),
    "rope pins": (lambda: Rope(pins="middle"), "Rope.pins"),
    "cloth pins": (lambda: Cloth(resolution=(3, 3), pins=[9]), "particle 9"),
    "mesh pins": (lambda: Cloth.from_mesh(np.eye(3), [[0, 1, 2]], pins="top"), "Cloth.pins"),
    "sphere radius": (lambda: Sphere(radius=0.0), "Sphere.radius"),
    "capsule length": (lambda: Capsule(half_length=-1.0), "Capsule.half_length"),
    "box extents": (lambda: Box(half_extents=(1, 1)), "Box.half_extents is [1, 1]; allowed"),
    "plane normal": (lambda: Plane(normal=(0, 0, 0)), "Plane.normal is [0, 0, 0]; allowed"),
    "normal of an array": (lambda: Plane(normal=np.zeros(3)), "Plane.normal is [0.0, 0.0, 0.0]; allowed"),
    "method": (lambda: Settings(method="magic"), "Settings.method"),
    "third order": (lambda: Settings(order=3), "Settings.order"),
    "no error at all": (lambda: Settings(error=0.0), "Settings.error"),
    "no budget": (lambda: Settings(budget=0.0), "Settings.budget"),
    "substeps": (lambda: Settings(substeps=-1), "Settings.substeps"),
    "half an iteration": (lambda: Settings(iterations=1.5), "Settings.iterations"),
    "huge wind": (lambda: Wind(velocity=(0, 0, 1e9)), "Wind.velocity"),
    "shared name": (lambda: Scene({"a": Rope()}, {"a": Sphere()}), "'a'"),
    "dotted name": (lambda: Scene({"a.b": Rope()}), "'a.b'"),
    "reserved name": (lambda: Scene({"wind": Rope()}), "'wind'"),
    "not an object": (lambda: Scene({"a": Sphere()}), "Cloth or a Rope"),
    "device": (lambda: Simulation(Scene(), device="cuda:99"), "cuda:99"),
    "no such handle": (lambda: Simulation(SHEET, device="cpu").attach("hand"), "none, as the scene has none"),
    "no scene": (lambda: Simulation({}), "a Scene"),
    "no settings": (lambda: Simulation(Scene(), {"error": 1e-3}), "a Settings"),
    "vertex before the first": (lambda: Cloth.from_mesh(np.eye(3), [[0, 1, -1]]), "vertex -1"),
    "half a vertex": (lambda: Cloth.from_mesh(np.eye(3), [[0, 1, 1.5]]), "vertex 1.5"),
    "volume of text": (lambda: SignedDistance.from_mesh("peg.stl"), "'peg.stl'"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_descriptions_are_refused_in_one_sentence(case):
    make, named = BAD[case]
    with pytest.raises(ValueError) as caught:
        make()
    text = str(caught.value)
    assert named in text and "allowed" in text and "\n" not in text


@pytest.mark.parametrize(
    "kind, rows",
    [
        (Cloth, table.CLOTH),
        (Rope, (*table.ROPE, *table.TWIST)),
        (Winch, table.WINCH),
        (Sphere, table.COLLIDER),
        (Wind, table.WIND),
        (Settings, (*table.SOLVER, table.FRAME_DT)),
        (Scene, (table.GRAVITY,)),
    ],
)
def test_defaults_are_those_of_the_table(kind, rows):
    """But for what is absent unless a description has it; `bending` is the word for that in the table."""
    wanted = {row.name: row.default for row in rows if row.name != "bending"}
    found = {field.name: field.default for field in dataclasses.fields(kind) if field.default is not None}
    both = wanted.keys() & found.keys()
    assert both and {name: found[name] for name in both} == {name: wanted[name] for name in both}


def test_three_triangles_at_an_edge_are_refused():
    mesh = Cloth.from_mesh(np.vstack([np.eye(3), [[1, 1, 1]], [[2, 2, 2]]]), [[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    with pytest.raises(ValueError, match="3 triangles at edge 0-1"):
        Simulation(Scene({"m": mesh}), device="cpu")


def test_quaternions_are_normalised_and_rotate():
    cloth = Cloth(orientation=(0, 0, 2, 2))
    assert np.linalg.norm(cloth.orientation) == pytest.approx(1.0)
    assert rotate(cloth.orientation, np.array([[1.0, 0.0, 0.0]])) == pytest.approx(np.array([[0.0, 1.0, 0.0]]))


@pytest.mark.parametrize("normal", [(0, 0, 1), (0, 0, -1), (1, 2, 3), (-1, 0, 0)])
def test_a_plane_knows_its_normal(normal):
    plane = Plane(point=(1, 2, 3), normal=normal)
    assert plane.position == (1.0, 2.0, 3.0)
    assert plane.normal == pytest.approx(np.asarray(normal) / np.linalg.norm(normal))


def test_an_empty_scene_steps():
    sim = Simulation(Scene(), device="cpu")
    sim.step(3)
    assert sim.report() == {} and sim.time == pytest.approx(0.05)
