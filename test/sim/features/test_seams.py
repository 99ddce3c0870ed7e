# SPDX-License-Identifier: Apache-2.0
"""Seams: loads, gaps, breaking and momentum of stitches between sheets, ropes and a sheet with itself."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Cloth, Handle, Rope, Scene, Seam, Settings, Simulation

GRAVITY = 9.81
UPRIGHT = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))  # a sheet hangs by its top


def hung(device, compliance, fine=9, **settings):
    """A sheet of 9 x 9 sewn below another one of `fine` particles a side, and the height of both is 0.2 m."""
    top = Cloth(resolution=(9, 9), size=(0.2, 0.2), orientation=UPRIGHT, position=(0.0, 0.0, 1.0), pins="top")
    low = Cloth(resolution=(fine, fine), size=(0.2, 0.2), orientation=UPRIGHT, position=(0.0, 0.0, 0.8), pins=None)
    seam = Seam("top", "low", (0, 8), (fine * (fine - 1), fine * fine - 1), compliance=compliance)
    scene = Scene({"top": top, "low": low}, seams={"seam": seam})
    return Simulation(scene, Settings(global_damping=8.0, **settings), device)


@pytest.mark.parametrize("compliance", [0.0, 1e-5, 1e-3])
@pytest.mark.parametrize("fine", [9, 14])
def test_a_hung_sheet_loads_its_seam_by_its_weight(device, compliance, fine):
    sim = hung(device, compliance, fine)
    sim.step(150)
    gaps, forces, broken = sim.stitches("seam")
    assert len(gaps) == fine and not broken.any()
    weight = GRAVITY * sim.masses("low").sum()
    np.testing.assert_allclose(forces.sum(axis=0), (0.0, 0.0, -weight), atol=0.01 * weight)
    if compliance == 0.0:
        assert np.linalg.norm(gaps, axis=1).max() < 1e-4
        return
    stiffness = 1.0 / compliance
    np.testing.assert_allclose(gaps.sum(axis=0)[2], weight / stiffness, rtol=0.02)


def pulled(objects, seams, device, settings):
    """Upright sheets of 0.1 m x 0.2 m in all, pulled by two hands until they are 5 % longer, and the force [N]."""
    hands = {
        name: Handle(position=(0.0, 0.0, height), reach=(0.12, 0.01, 0.01), attached=True)
        for name, height in (("top", 0.1), ("bottom", -0.1))
    }
    scene = Scene(objects, handles=hands, seams=seams, gravity=(0.0, 0.0, 0.0))
    sim = Simulation(scene, Settings(**settings), device)
    for frame in range(60):
        sim.set_handle_pose("bottom", (0.0, 0.0, -0.1 - 0.01 * (frame + 1) / 60))
        sim.step()
    sim.step(60)
    return sim, np.linalg.norm(sim.handle_wrench("bottom")[0])


@pytest.mark.parametrize("settings", [{}, pytest.param({"order": 1, "substeps": 100}, marks=pytest.mark.long)])
@pytest.mark.parametrize(("material", "compliance"), [("cotton", 0.0), ("silk", 1e-5)])
def test_a_sheet_is_strained_beside_a_seam_as_elsewhere(device, material, compliance, settings):
    side = 11
    upright = {"orientation": UPRIGHT, "pins": "none"}
    half = {"resolution": (side, side), "size": (0.1, 0.1), **upright}
    halves = {name: Cloth.of(material, position=(0.0, 0.0, z), **half) for name, z in (("a", 0.05), ("b", -0.05))}
    seam = Seam("a", "b", (0, side - 1), (side * (side - 1), side * side - 1), compliance=compliance)
    sewn, force = pulled(halves, {"seam": seam}, device, settings)
    whole = Cloth.of(material, resolution=(side, 2 * side - 1), size=(0.1, 0.2), **upright)
    assert force == pytest.approx(pulled({"whole": whole}, {}, device, {})[1], rel=0.01)
    for name, nearest in (("a", 0), ("b", -1)):
        heights = sewn.positions(name).reshape(side, side, 3)[:, side // 2, 2]
        strains = np.diff(heights) / 0.01 - 1.0
        assert strains[nearest] == pytest.approx(strains.mean(), rel=0.03)


def test_sewn_sheets_without_damping_gain_no_energy(device):
    half = {"resolution": (11, 11), "size": (0.1, 0.1), "orientation": UPRIGHT, "damping": 0.0}
    top = Cloth.of("cotton", position=(0.0, 0.0, 0.05), pins="top", **half)
    low = Cloth.of("cotton", position=(0.0, 0.0, -0.05), pins="none", **half)
    seam = Seam("top", "low", (0, 10), (110, 120))
    hands = {"hand": Handle()}  # idle; with one the kernels are those of the test above
    scene = Scene({"top": top, "low": low}, handles=hands, seams={"seam": seam}, gravity=(0.0, 0.0, 0.0))
    sim = Simulation(scene, Settings(), device)
    for name in ("top", "low"):
        heights, speeds = sim.positions(name)[:, 2], np.zeros((121, 3))
        speeds[:, 2] = 0.3 * np.sin(np.pi * (0.1 - heights) / 0.4)
        sim.set_velocities(name, speeds)

    def energy():
        return sum(sim.report()[name]["kinetic_energy"] for name in ("top", "low"))

    start = energy()
    for _ in range(30):
        sim.step()
        assert energy() < 1.005 * start


def test_a_hem_of_rope_hangs_by_its_compliance(device):
    sheet = Cloth.of("cotton", resolution=(13, 7), size=(0.3, 0.2), orientation=UPRIGHT, position=(0.0, 0.0, 1.0))
    rope = Rope.of("cotton rope", start=(-0.15, 0.0, 0.9), end=(0.15, 0.0, 0.9), segments=24, pins=None)
    compliance = 1e-5
    seam = Seam("sheet", "rope", (0, 12), (0, 24), compliance=compliance)
    sim = Simulation(Scene({"sheet": sheet, "rope": rope}, seams={"seam": seam}), Settings(global_damping=8.0), device)
    sim.step(120)
    gaps, forces, _ = sim.stitches("seam")
    weight = GRAVITY * sim.masses("rope").sum()
    assert forces[:, 2].sum() == pytest.approx(-weight, rel=0.002)
    assert gaps[:, 2].sum() == pytest.approx(weight * compliance, rel=0.02)


@pytest.mark.parametrize("above", ["sheet", "rope"])
def test_a_stitch_feels_the_load_of_its_rope_while_the_substeps_change(device, above):
    """A light rope with a heavy end, whose weight grows. It was flung where its solve did not know of the stitch."""
    if above == "sheet":
        holder = Cloth(resolution=(2, 2), size=(0.02, 0.02), position=(0.01, 0.01, 0.9), pins=(0, 1, 2, 3))
    else:
        holder = Rope(start=(0.0, 0.0, 1.0), end=(0.0, 0.0, 0.9), segments=4, pins="start", mass=0.01)
    rope = Rope(start=(0.0, 0.0, 0.9), end=(0.0, 0.0, 0.7), segments=6, pins=None, mass=0.02, end_mass=0.3)
    seam = Seam("holder", "rope", (0 if above == "sheet" else 4,), (0,))
    scene = Scene({"holder": holder, "rope": rope}, seams={"seam": seam}, gravity=(0.0, 0.0, 0.0))
    sim = Simulation(scene, Settings(global_damping=20.0), device)
    kilograms, loads = sim.masses("rope").sum(), np.linspace(0.1, 5.0, 120)
    counts, forces = [], []
    for load in loads:
        sim.set("gravity", (0.0, 0.0, -load / kilograms))
        sim.step()
        counts.append(sim.report()["rope"]["substeps"])
        forces.append(np.linalg.norm(sim.stitches("seam")[1]))
    assert len(set(counts)) > 1
    np.testing.assert_allclose(forces[5:], loads[5:], atol=0.03 * loads[-1])


@pytest.mark.parametrize("substeps", [0, 10])
def test_a_seam_that_closes_elsewhere_changes_no_load(device, substeps):
    upper = Rope.of("nylon rope", start=(0.5, 0.0, 1.0), end=(0.5, 0.0, 0.9), segments=4, pins="start")
    lower = Rope.of("nylon rope", start=(0.5, 0.0, 0.9), end=(0.5, 0.0, 0.7), segments=6, pins=None, end_mass=0.3)
    sheet = {"resolution": (7, 7), "size": (0.2, 0.2), "orientation": UPRIGHT}
    over = Cloth.of("cotton", position=(0.0, 0.0, 1.0), pins="top", **sheet)
    under = Cloth.of("cotton", position=(0.0, 0.0, 0.6), pins="none", **sheet)
    seams = {"knot": Seam("upper", "lower", (4,), (0,)), "closes": Seam("over", "under", (0, 6), (42, 48))}
    objects = {"upper": upper, "lower": lower, "over": over, "under": under}
    sim = Simulation(Scene(objects, seams=seams), Settings(substeps=substeps), device)
    weight = GRAVITY * sim.masses("lower").sum()
    for _ in range(60):
        sim.step()
        assert np.linalg.norm(sim.stitches("knot")[1]) == pytest.approx(weight, rel=0.03)
    assert np.linalg.norm(sim.stitches("closes")[0], axis=1).max() < 1e-4


def test_a_stitch_breaks_at_its_strength_and_heals_by_a_reset(device):
    strength, kilograms = 5.0, 0.51
    upper = Rope(start=(0.0, 0.0, 1.0), end=(0.0, 0.0, 0.8), segments=8, pins="start", mass=0.01)
    lower = Rope(start=(0.0, 0.0, 0.8), end=(0.0, 0.0, 0.6), segments=8, pins=None, mass=0.01, end_mass=0.5)
    seam = Seam("upper", "lower", (8,), (0,), strength=strength)
    scene = Scene({"upper": upper, "lower": lower}, seams={"seam": seam}, gravity=(0.0, 0.0, 0.0))
    sim = Simulation(scene, Settings(global_damping=10.0, substeps=40), device)
    load = 0.0
    while not sim.stitches("seam")[2][0] and load < 2.0 * strength:
        load += 0.04
        sim.set("gravity", (0.0, 0.0, -load / kilograms))
        sim.step()
    assert load == pytest.approx(strength, rel=0.02)
    assert not sim.stitches("seam")[1].any()
    sim.reset()
    assert not sim.stitches("seam")[2].any()


@pytest.mark.parametrize(
    "settings", [{}, pytest.param({"order": 1, "substeps": 10, "iterations": 2}, marks=pytest.mark.long)]
)
def test_seams_keep_momentum(device, settings):
    sheet = {"resolution": (8, 8), "size": (0.2, 0.2), "pins": None}
    objects = {
        "a": Cloth(**sheet),
        "b": Cloth(**sheet, position=(0.2, 0.0, 0.0), mass=0.5),
        "cord": Rope(start=(0.1, -0.1, 0.0), end=(0.1, 0.1, 0.0), segments=11, pins=None),
    }
    right, left = tuple(range(7, 64, 8)), tuple(range(0, 64, 8))
    seams = {
        "side": Seam("a", "b", right, left, points=True, compliance=1e-4),
        "hem": Seam("cord", "b", (0, 11), (0, 56)),
    }
    sim = Simulation(Scene(objects, gravity=(0.0, 0.0, 0.0), seams=seams), Settings(**settings), device)
    rng, masses = np.random.default_rng(4), {name: sim.masses(name)[:, None] for name in objects}
    for name in objects:
        count = len(masses[name])
        sim.set_velocities(name, np.array([1.0, 0.0, 0.0]) * (name == "a") + 0.3 * rng.standard_normal((count, 3)))

    def momentum():
        return sum((masses[name] * sim.velocities(name)).sum(axis=0) for name in objects)

    def speeds():
        return sum((masses[name] * np.abs(sim.velocities(name))).sum() for name in objects)

    start, scale = momentum(), speeds()
    for _ in range(60):
        sim.step()
        assert np.abs(momentum() - start).max() < 1e-5 * scale
    assert np.linalg.norm(sim.stitches("hem")[0], axis=1).max() < 1e-4


@pytest.mark.long
def test_panels_close_at_their_speed_and_stay_closed_where_they_keep_apart(device):
    sheet = {"resolution": (8, 8), "size": (0.2, 0.2), "pins": None, "thickness": 0.002, "self_contact": True}
    objects = {"front": Cloth(**sheet), "back": Cloth(**sheet, position=(0.0, 0.0, 0.05))}
    seam = Seam("front", "back", (0, 7, 63), (0, 7, 63), closing_speed=0.2)
    scene = Scene(objects, seams={"seam": seam}, gravity=(0.0, 0.0, 0.0), object_contact=True)
    sim = Simulation(scene, Settings(global_damping=5.0), device)
    sim.step(6)
    gaps = np.linalg.norm(sim.stitches("seam")[0], axis=1)
    np.testing.assert_allclose(gaps, 0.05 - 0.2 * 0.1, atol=6e-3)  # inertia adds to it
    sim.step(54)
    assert np.linalg.norm(sim.stitches("seam")[0], axis=1).max() < 1e-4
    apart = np.linalg.norm(sim.positions("front")[24] - sim.positions("back")[24])  # far from the seam
    assert apart > 0.0035 and sim.report()["front"]["crossings"] == 0
    assert max(sim.report()[name]["kinetic_energy"] for name in objects) < 1e-5


def test_a_tube_of_one_sheet_holds_together(device):
    strip = Cloth(resolution=(6, 24), size=(0.1, 0.4), pins=None)
    seam = Seam("strip", "strip", (0, 5), (138, 143))
    sim = Simulation(Scene({"strip": strip}, seams={"seam": seam}, gravity=(0.0, 0.0, 0.0)), Settings(), device)
    sim.step(120)
    assert np.linalg.norm(sim.stitches("seam")[0], axis=1).max() < 1e-4


def test_an_eyelet_slides_along_its_rope_as_a_bead_on_a_wire(device):
    wire = Rope(start=(0.0, 0.0, 0.0), end=(1.0, 0.0, 0.0), segments=30, pins=tuple(range(31)))
    patch = Cloth(resolution=(2, 2), size=(0.01, 0.01), position=(0.055, 0.005, 0.0), pins=None)
    seam = Seam("patch", "wire", (0, 1), (1, 2), slides=True)
    pull = 2.0
    scene = Scene({"wire": wire, "patch": patch}, seams={"seam": seam}, gravity=(pull, 0.0, 0.0))
    sim = Simulation(scene, Settings(), device)
    start = sim.positions("patch")[:, 0].mean()
    sim.step(42)
    gone = sim.positions("patch")[:, 0].mean() - start
    assert gone == pytest.approx(0.5 * pull * 0.7**2, rel=0.02)
    assert np.linalg.norm(sim.stitches("seam")[0], axis=1).max() < 1e-4


def test_what_cannot_be_sewn_is_told(device):
    sheet, cord = Cloth(resolution=(4, 4)), Rope(segments=4)
    objects = {"sheet": sheet, "cord": cord}
    for arguments, sentence in (
        (("sheet", "cord", (16,), (0,)), "seam.first_particles has 16; allowed is 0 to 15, those of sheet"),
        (("sheet", "sheet", (3,), (3,)), "seam sews a particle of sheet to itself"),
        (("cord", "sheet", (0, 4), (0, 3), False, True), "seam.slides is True along sheet, a sheet"),
        (("sheet", "cord", (2, 2), (0, 1)), "seam.first_particles has 2, then 2"),
    ):
        with pytest.raises(ValueError, match=sentence):
            Simulation(Scene(objects, seams={"seam": Seam(*arguments)}), device=device)
    with pytest.raises(ValueError, match="Seam 'seam' is of 'hat'; allowed is sheet, cord"):
        Scene(objects, seams={"seam": Seam("hat", "cord", (0,), (0,))})
    with pytest.raises(ValueError, match="Seam.points is True for 2 and 1 particles"):
        Seam("sheet", "cord", (0, 1), (0,), points=True)
    for which, given, slides in (("first", ((2,), (0, 4)), False), ("second", ((0, 3), (2,)), True)):
        with pytest.raises(ValueError, match=rf"Seam.{which}_particles is \[2\], into which a whole line would gather"):
            Seam("sheet", "cord", *given, slides=slides)
    Seam("sheet", "cord", (2,), (0, 4), slides=True)  # a ring on a rope
    with pytest.raises(ValueError, match="Seam.strength is -1"):
        Seam("sheet", "cord", (0,), (0,), strength=-1)


def test_explicit_steps_sew_nothing(device):
    """Each object takes as many as it needs, and stitches would give their two points different momentum."""
    objects = {"sheet": Cloth(resolution=(4, 4)), "cord": Rope(segments=3)}
    scene = Scene(objects, seams={"hem": Seam("sheet", "cord", (0, 3), (0, 3))})
    with pytest.raises(
        ValueError, match=r"^solver\.method is 'verlet' with a seam of sheet; allowed is 'auto' or 'xpbd'$"
    ):
        Simulation(scene, Settings(method="verlet"), device)
