# SPDX-License-Identifier: Apache-2.0
"""Presets: what they weigh, the moduli that their springs have, limits that no cloth or rope is beyond, and rest."""

from dataclasses import replace

import numpy as np
import pytest
from fixed_settings import fixed

from cloth_sim_ros.sim import Cloth, Rope, Scene, Simulation, Winch, Wind
from cloth_sim_ros.sim.scene.materials import CORDS, FABRICS, Fabric, spring_constants

G = 9.81


def springs_of(cloth):
    """Rest positions (N, 3), pairs (S, 2), rest lengths (S,) and constants (S,) of a cloth, float64."""
    sim = Simulation(Scene({"it": cloth}), fixed(), device="cpu")
    parts = [part for kind, part in sim.springs("it").items() if kind != "bending"]
    return (sim.rest_positions("it").astype(float), *(np.concatenate([part[k] for part in parts]) for k in range(3)))


def strained_energy(cloth, strain):
    """Energy [J] of the springs under a small uniform `strain` (2, 2), at most linear in it."""
    x, pairs, _, constant = springs_of(cloth)
    edge = (x[pairs[:, 1]] - x[pairs[:, 0]])[:, :2]
    stretch = np.einsum("si,ij,sj->s", edge, strain, edge) / np.linalg.norm(edge, axis=1)
    return 0.5 * float((constant * stretch**2).sum())


def pulled_modulus(cloth, width, length):
    """Force a width and strain [N/m] of a strip that is pulled along x, its ends free to narrow: linear statics."""
    x, pairs, _, constant = springs_of(cloth)
    n = (x[pairs[:, 1]] - x[pairs[:, 0]])[:, :2]
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    count = len(x)
    stretch = np.zeros((len(pairs), 2 * count))
    for axis in range(2):
        stretch[np.arange(len(pairs)), 2 * pairs[:, 0] + axis] = -n[:, axis]
        stretch[np.arange(len(pairs)), 2 * pairs[:, 1] + axis] = n[:, axis]
    stiffness = stretch.T @ (constant[:, None] * stretch)
    left, right = (np.flatnonzero(np.isclose(x[:, 0], end)) for end in (x[:, 0].min(), x[:, 0].max()))
    held = np.concatenate([2 * left, 2 * right, [2 * left[0] + 1]])
    free = np.setdiff1d(np.arange(2 * count), held)
    u = np.zeros(2 * count)
    u[2 * right] = 1.0
    u[free] = np.linalg.solve(stiffness[np.ix_(free, free)], -stiffness[np.ix_(free, held)] @ u[held])
    return float((stiffness @ u)[2 * right].sum()) * length / width


def equilateral(count=6, edge=0.1):
    """Vertices and triangles of a rhombus of equilateral triangles."""
    i, j = (a.ravel() for a in np.meshgrid(np.arange(count), np.arange(count)))
    points = np.stack([edge * (i + 0.5 * j), edge * np.sqrt(0.75) * j, 0.0 * i], axis=1)
    k = np.arange(count * count).reshape(count, count)
    first = np.stack([k[:-1, :-1], k[:-1, 1:], k[1:, :-1]], axis=-1).reshape(-1, 3)
    second = np.stack([k[:-1, 1:], k[1:, 1:], k[1:, :-1]], axis=-1).reshape(-1, 3)
    return points, np.concatenate([first, second])


@pytest.mark.parametrize("resolution", [(17, 9), (13, 9), (21, 9)])
@pytest.mark.parametrize("name", FABRICS)
def test_a_sheet_weighs_and_stretches_as_its_fabric(name, resolution):
    """In square cells and in long ones."""
    fabric = FABRICS[name]
    cloth = Cloth.of(name, size=(0.8, 0.4), resolution=resolution, pins=None)
    assert cloth.mass == pytest.approx(fabric.areal_mass * 0.32, rel=1e-9)
    assert pulled_modulus(cloth, 0.4, 0.8) == pytest.approx(fabric.warp, rel=1e-3)
    turned = Fabric(0.1, fabric.weft, fabric.warp, fabric.shear, 0.0, *3 * [1e-5])
    across = Cloth.of(turned, size=(0.8, 0.4), resolution=resolution)
    assert pulled_modulus(across, 0.4, 0.8) == pytest.approx(fabric.weft, rel=1e-3)
    shear = 2.0 * strained_energy(cloth, np.array([(0.0, 0.5), (0.5, 0.0)])) / 0.32
    assert shear == pytest.approx(fabric.shear, rel=1e-5)
    rigidities = (fabric.bend_warp, fabric.bend_weft, fabric.bend_diagonal)
    bends = (cloth.bend_compliance, cloth.weft_bend_compliance, cloth.diagonal_bend_compliance)
    assert cloth.bending == "dihedral" and bends == pytest.approx([1.0 / each for each in rigidities])
    assert cloth.damping == fabric.damping and cloth.thickness == 0.5 * fabric.thickness
    assert (cloth.static_friction, cloth.kinetic_friction) == (fabric.static_friction, fabric.kinetic_friction)


def test_a_grid_of_cells_too_long_for_the_shear_tells_what_it_has(caplog):
    cloth = Cloth.of("jersey", size=(0.8, 0.2), resolution=(17, 9), pins=None)
    shear = 2.0 * strained_energy(cloth, np.array([(0.0, 0.5), (0.5, 0.0)])) / 0.16
    assert shear == pytest.approx(0.9 * FABRICS["jersey"].warp / 4.0)
    assert pulled_modulus(cloth, 0.2, 0.8) == pytest.approx(FABRICS["jersey"].warp, rel=1e-3)
    (told,) = caplog.messages
    assert "jersey" in told and "50 x 25 mm" in told and "18 N/m for 37" in told


@pytest.mark.parametrize("name", FABRICS)
def test_a_mesh_has_the_moduli_of_its_fabric(name):
    fabric = FABRICS[name]
    cloth = Cloth.from_mesh(*equilateral(), name)
    assert cloth.mass == pytest.approx(fabric.areal_mass * 25 * 0.1**2 * np.sqrt(0.75), rel=1e-9)
    found = (cloth.stretch_compliance, cloth.weft_compliance, cloth.shear_compliance)
    assert found == pytest.approx([1.0 / each for each in (fabric.warp, fabric.weft, fabric.shear)])
    assert cloth.poisson == fabric.poisson


@pytest.mark.parametrize("name", FABRICS)
def test_fabrics_are_physical(name):
    """Density of the felt, bending length of Peirce, a diagonal that twists, and springs of positive constants."""
    fabric = FABRICS[name]
    assert 50.0 < fabric.areal_mass / fabric.thickness < 1500.0
    for bending in (fabric.bend_warp, fabric.bend_weft, fabric.bend_diagonal):
        assert 5e-3 < (bending / (fabric.areal_mass * G)) ** (1.0 / 3.0) < 0.1
    assert 0.2 < 0.25 * fabric.bend_diagonal * (1.0 / fabric.bend_warp + 1.0 / fabric.bend_weft) < 0.8
    along, across, diagonal = spring_constants(fabric.warp, fabric.weft, fabric.shear)
    assert min(along, across) > 0.0 and 0.0 < diagonal / (across + diagonal) < 0.51
    assert abs(fabric.poisson) < 0.95 * np.sqrt(fabric.warp / fabric.weft)
    assert 0.0 < fabric.damping < 0.05 and 0.0 < fabric.kinetic_friction <= fabric.static_friction <= 1.0


@pytest.mark.parametrize("name", CORDS)
def test_a_rope_weighs_and_stretches_as_its_cord(name):
    cord = CORDS[name]
    rope = Rope.of(name, start=(0, 0, 0), end=(0, 1.5, 2.0), segments=10)
    assert (rope.mass, rope.radius) == (pytest.approx(cord.linear_mass * 2.5), cord.radius)
    _, _, rest, constant = springs_of(rope)
    assert 1.0 / (1.0 / constant).sum() * rest.sum() == pytest.approx(cord.stretch, rel=1e-5)
    assert rope.bend_compliance == pytest.approx(1.0 / cord.bending)


@pytest.mark.parametrize("name", CORDS)
def test_cords_are_physical(name):
    """Density over the whole section, and bending below that of one solid rod of the same EA."""
    cord = CORDS[name]
    assert 500.0 < cord.linear_mass / (np.pi * cord.radius**2) < 7850.0
    assert cord.bending < 0.25 * cord.stretch * cord.radius**2
    assert 0.0 < cord.damping < 0.05 and 0.0 < cord.kinetic_friction <= cord.static_friction <= 1.0


def test_a_thicker_rope_is_the_same_rope_enlarged():
    cord, rope = CORDS["steel cable"], Rope.of("steel cable", radius=6e-3)
    assert rope.mass == pytest.approx(4.0 * cord.linear_mass)
    assert rope.stretch_compliance == pytest.approx(0.25 / cord.stretch)
    assert rope.bend_compliance == pytest.approx(1.0 / (16.0 * cord.bending))


def test_what_is_given_wins_over_the_material():
    cloth = Cloth.of("denim", mass=1.0, bending="springs", bend_compliance=0.1, damping=0.0)
    assert (cloth.mass, cloth.bending, cloth.bend_compliance, cloth.damping) == (1.0, "springs", 0.1, 0.0)
    assert Cloth.of("denim", bending="none").bend_compliance is None
    soft, denim = Cloth.of("denim", stretch_compliance=0.1, bend_compliance=1e6), Cloth.of("denim")
    assert soft.weft_over_warp == pytest.approx(denim.weft_over_warp)  # what is not given keeps its ratio
    assert soft.weft_bend_compliance / 1e6 == pytest.approx(denim.weft_bend_compliance / denim.bend_compliance)
    assert Cloth.from_mesh(*equilateral(), "denim", shear_compliance=None).weft_compliance is None
    assert Rope.of("nylon rope", winch=Winch()).bend_compliance == Rope.of("nylon rope").bend_compliance


@pytest.mark.parametrize(
    ("make", "names"),
    [
        (lambda: Cloth.of("steel cable"), FABRICS),
        (lambda: Cloth.from_mesh(*equilateral(), "tweed"), FABRICS),
        (lambda: Rope.of("cotton"), CORDS),
    ],
)
def test_an_unknown_material_is_refused_with_those_that_there_are(make, names):
    with pytest.raises(ValueError, match=f"^material is '[a-z ]+'; allowed is one of {', '.join(names)}$"):
        make()


@pytest.mark.long
def test_a_cloth_let_go_comes_to_rest_by_the_air_and_not_by_the_steps(device):
    """Kinetic energy [J] 2 to 3 s after a level cloth is let go by its edge: alike at three times the substeps."""

    def left(wind, substeps):
        cloth = Cloth.of("cotton", size=(0.5, 0.5), resolution=(12, 12), pins="top")
        sim = Simulation(Scene({"it": cloth}, wind=wind), fixed(substeps=substeps), device=device)
        energies = []
        for _ in range(180):
            sim.step()
            energies.append(sim.report()["it"]["kinetic_energy"])
        assert max(energies[:60]) > 0.02
        return max(energies[120:])

    calm = [left(Wind(), substeps) for substeps in (20, 60)]
    assert calm[0] < 5e-4 and calm[0] == pytest.approx(calm[1], rel=0.15)
    assert left(None, 20) > 30.0 * calm[0]


def test_a_fabric_that_is_made_rigid_is_so_along_warp_and_weft(device):
    cloth = Cloth.of("cotton", size=(0.4, 0.4), resolution=(9, 9), stretch_compliance=0, pins="top")
    assert cloth.stretch_compliance == 0.0 and cloth.weft_compliance is None
    sim = Simulation(Scene({"it": cloth}), device=device)
    sim.step(30)
    report = sim.report()["it"]
    assert report["residual"] < 5e-4
    assert report["elastic_energy"] < 0.1 * cloth.mass * 9.81 * 0.4, "what is rigid stores none"


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: replace(FABRICS["silk"], shear=0.0), "Fabric.shear is 0.0; allowed is a finite number above 0"),
        (lambda: replace(FABRICS["silk"], areal_mass="70"), "Fabric.areal_mass is '70'; allowed is a finite number"),
        (lambda: replace(FABRICS["silk"], damping="slow"), "Fabric.damping is 'slow'; allowed is a number"),
        (lambda: Rope.of("steel cable", radius="6 mm"), "Rope.radius is '6 mm'; allowed is"),
        (lambda: Cloth.of("silk", bend_compliance="soft"), "Cloth.bend_compliance is 'soft'; allowed is"),
        (lambda: Cloth.of(["silk"]), r"material is \['silk'\]; allowed is one of cotton"),
    ],
)
def test_numbers_of_a_material_that_cannot_be_are_refused(make, sentence):
    with pytest.raises(ValueError, match=sentence):
        make()
