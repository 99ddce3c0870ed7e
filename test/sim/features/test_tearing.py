# SPDX-License-Identifier: Apache-2.0
"""Sheets that tear: they fail at their strain, gain no energy, and their parts have nothing to do with one another."""

import numpy as np
import pytest
from fixed_settings import fixed
from warp._src.context import ModuleBuilder  # the only way to see a source without compiling it

from cloth_sim_ros.sim import Cloth, Handle, Readback, Rope, Scene, Settings, Simulation, Sphere, Wind
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.executors.block import make_frame
from cloth_sim_ros.sim.physics.quaternion import rotate

SIZE = (1.1, 0.9)  # [m]
KNIFE = [(0.01, -2, -2), (0.01, 2, -2), (0.01, 2, 2), (0.01, -2, 2)]  # between two columns of particles
NOTHING = (0.0, 0.0, 0.0)


def sheet(**fields):
    defaults = {"resolution": (12, 10), "size": SIZE, "pins": None, "tear_strain": 0.1}
    return Cloth(**{**defaults, **fields})


def simulated(cloth, device, order=2, executor=None, worlds=1, **scene):
    return Simulation(
        Scene(objects={"sheet": cloth}, **{"gravity": NOTHING, **scene}),
        fixed(order=order),
        device=device,
        worlds=worlds,
        executor=executor,
    )


def energy(sim):
    """Kinetic energy and that of the springs that are left [J]."""
    x = sim.positions("sheet").astype(float)
    found = sim.report()["sheet"]["kinetic_energy"]
    for kind, (pairs, rest, constant) in sim.springs("sheet").items():
        strain = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1) - rest
        found += float((0.5 * constant * strain**2)[~sim.torn("sheet")[kind]].sum())
    return found


def parts(sim):
    """The least number of those that springs hold together with each particle (N,)."""
    count = len(sim.masses("sheet"))
    pairs = [pairs[~sim.torn("sheet")[kind]] for kind, (pairs, *_) in sim.springs("sheet").items()]
    part = np.arange(count)
    for _ in range(count):
        before = part.copy()
        for a, b in (each.T for each in pairs):
            least = np.minimum(part[a], part[b])
            np.minimum.at(part, a, least)
            np.minimum.at(part, b, least)
        if (part == before).all():
            break
    return part


def pieces(sim):
    """How many particles each connected piece has, the largest first."""
    return sorted(np.unique(parts(sim), return_counts=True)[1].tolist(), reverse=True)


def pulled(device, begin, notched=False, **fields):
    """A sheet between two hands of which the right one pulls, slowly beyond the strain `begin` until a spring fails: it
    yields the simulation, the strain by the hands, and the largest strain and the energy of the frame before."""
    ends = {
        "left": Handle(position=(-0.55, 0, 0), reach=(0.01, 2, 2)),
        "right": Handle(position=(0.55, 0, 0), reach=(0.01, 2, 2)),
    }
    sim = simulated(sheet(damping=1e-3, **fields), device, handles=ends)
    assert sim.attach("left") == sim.attach("right") == 10
    for side in (-1, 1) if notched else ():  # from both borders to 0.22 m from the middle
        sim.cut("sheet", [(0.01, side * y, z) for y, z in ((0.22, -1), (1, -1), (1, 1), (0.22, 1))])
    whole, strain, most, before = sim.report()["sheet"]["torn"], 0.0, 0.0, 0.0
    while sim.report()["sheet"]["torn"] == whole:
        most, before = sim.report()["sheet"]["max_strain"], energy(sim)
        strain += 1.5e-3 if strain < begin else 1.5e-4
        assert strain < 0.2
        sim.set_handle_pose("right", (0.55 + 1.1 * strain, 0, 0))
        sim.step()
    return sim, strain, most, before


def goes_on_without_a_gain(sim, before):
    """Whether energy falls from `before` [J] on while the hands rest, but for a thousandth of it."""
    energies = [before]
    for _ in range(60):
        sim.step()
        energies.append(energy(sim))
    return (np.diff(energies) < 1e-3 * before).all()


def test_an_even_pull_breaks_lines_of_springs_at_their_strain(device):
    """Without shear springs all springs along the pull are strained by what the hands went."""
    sim, strain, most, before = pulled(device, 0.095, shear_compliance=None)
    assert strain == pytest.approx(0.1, rel=0.02) and most == pytest.approx(strain, rel=0.005)
    assert energy(sim) < before
    assert goes_on_without_a_gain(sim, before)
    assert len(pieces(sim)) == 2


def test_a_notched_sheet_breaks_in_two_and_both_parts_go_on(device):
    sim, _, most, before = pulled(device, 0.055, notched=True)
    assert most == pytest.approx(0.1, rel=0.02)
    assert energy(sim) < before
    assert goes_on_without_a_gain(sim, before)
    for k in range(1, 40):
        sim.set_handle_pose("right", (0.62 + 0.02 * k, 0, 0))
        sim.step()
    sim.step(300)
    part, corners = parts(sim), sim.triangles("sheet")
    assert len(pieces(sim)) == 2 and min(pieces(sim)) >= 56, "it breaks between its notches"
    assert (part[corners] == part[corners[:, :1]]).all(), "the mesh goes nowhere from one part to the other"
    assert 172 <= len(corners) <= 180, "and is whole elsewhere"
    x = sim.positions("sheet").reshape(10, 12, 3)
    rest = sim.rest_positions("sheet").reshape(10, 12, 3)
    assert np.abs(x[:, :5] - rest[:, :5]).max() < 1e-3  # what is torn off at its corners hangs loose
    assert np.abs(x[:, 7:] - (rest[:, 7:] + (0.62 + 0.78 - 0.55, 0, 0))).max() < 1e-3


def bumpy():
    """A jittered mesh that is curved at rest, of 10 x 10 particles."""
    x, y = (each.ravel() for each in np.meshgrid(np.linspace(-0.5, 0.5, 10), np.linspace(-0.5, 0.5, 10)))
    jitter = 0.02 * np.random.default_rng(1).standard_normal(100)
    i = np.arange(100).reshape(10, 10)
    lower = np.stack([i[:-1, :-1], i[:-1, 1:], i[1:, 1:]], -1).reshape(-1, 3)
    upper = np.stack([i[:-1, :-1], i[1:, 1:], i[1:, :-1]], -1).reshape(-1, 3)
    return np.stack([x, y, 0.3 * np.cos(2 * x) + jitter], 1), np.concatenate([lower, upper])


PLATE, SPRINGS = {"bending": "dihedral", "bend_compliance": 1e2}, {"bending": "springs", "bend_compliance": 0.1}
BALL = Sphere(position=(0, 0, 9), radius=0.05)
AMONG = {"wind": Wind(NOTHING), "colliders": {"ball": BALL}, "handles": {"hand": Handle(position=(0, 0, 9))}}


@pytest.mark.parametrize(
    ("cloth", "way"),
    [
        (sheet(**SPRINGS), {}),
        (sheet(**SPRINGS), AMONG | {"order": 1}),
        (sheet(**PLATE), {}),
        (sheet(**PLATE), {"executor": "graph"}),
        (sheet(**SPRINGS, self_contact=True), {}),
        (Cloth.from_mesh(*bumpy(), tear_strain=0.1, **PLATE), {}),
        (Cloth.from_mesh(*bumpy(), tear_strain=0.1, **SPRINGS), {}),
    ],
    ids=["springs", "among things", "plate", "graph", "self-contact", "curved mesh", "mesh"],
)
@pytest.mark.long
def test_parts_that_are_cut_have_nothing_to_do_with_one_another(device, cloth, way):
    """One part is put down elsewhere, turned. Each keeps its shape there, to rounding, and both stay at rest."""
    sim = simulated(cloth, device, **way)
    x = sim.rest_positions("sheet").astype(float)
    right = x[:, 0] > 0.01
    count = sim.cut("sheet", KNIFE)
    pairs = np.concatenate([pairs for kind, (pairs, *_) in sim.springs("sheet").items() if kind != "bending"])
    assert count == (right[pairs[:, 0]] != right[pairs[:, 1]]).sum() == sim.report()["sheet"]["torn"]
    assert pieces(sim) == sorted([right.sum(), (~right).sum()], reverse=True)
    x[right] = rotate((0.3, 0.5, 0.1, np.sqrt(0.65)), x[right]) + (0.5, 1.0, 2.0)
    sim.set_positions("sheet", x)
    sim.step(10)
    assert np.abs(sim.positions("sheet") - x).max() < 1e-6
    assert sim.report()["sheet"]["kinetic_energy"] < 1e-10
    triangles, all_of_them = sim.triangles("sheet"), cloth.triangles
    if all_of_them is None:
        all_of_them = simulated(sheet(tear_strain=0.0), device).triangles("sheet")
    kept = all_of_them[right[all_of_them].all(axis=1) | ~right[all_of_them].any(axis=1)]
    assert np.array_equal(triangles, kept)


@pytest.mark.long
def test_the_mesh_holds_the_triangles_that_are_left_and_the_air_pushes_no_others(device):
    sim = simulated(sheet(), device, **{**AMONG, "wind": Wind((0.0, 0.0, 0.02))})
    readback = Readback(sim, "sheet", normals=True, mesh=True)
    sim.cut("sheet", KNIFE)
    readback.request()
    x, triangles = sim.positions("sheet"), sim.triangles("sheet")
    assert len(triangles) == 2 * 10 * 9
    assert np.array_equal(readback.mesh(), x[triangles].reshape(-1, 3))
    assert np.allclose(readback.particles()[:, 3:6], (0, 0, 1))
    sim.step()
    moved = (sim.masses("sheet")[:, None] * sim.velocities("sheet")).sum(axis=0)
    whole = simulated(sheet(), device, **{**AMONG, "wind": Wind((0.0, 0.0, 0.02))})
    whole.step()
    asked = (whole.masses("sheet")[:, None] * whole.velocities("sheet")).sum(axis=0)
    assert moved[2] == pytest.approx(asked[2] * 10 / 11, rel=5e-3)  # one of eleven columns of cells is gone


def test_a_ball_passes_through_a_hole(device):
    """Triangles that were cut out of a taut sheet do not hold what falls through them, and those that are left do."""
    ball = Sphere(position=(0.0, 0.0, 0.3), radius=0.06)
    cloth = sheet(resolution=(8, 8), size=(1, 1), pins="edges", thickness=0.01, tear_strain=1e3)
    lowest = []
    for is_cut in (True, False):
        sim = simulated(cloth, device, **{**AMONG, "colliders": {"ball": ball}})
        for side in (1, -1) if is_cut else ():  # along both diagonals of the middle cell, and a little further
            corners = [(k, side * k, z) for k, z in ((-0.1, -1), (0.1, -1), (0.1, 1), (-0.1, 1))]
            sim.cut("sheet", corners)
        for z in np.linspace(0.3, -0.3, 40):
            sim.set_collider_pose("ball", (0.0, 0.0, z))
            sim.step()
        lowest.append(sim.positions("sheet")[:, 2].min())
    assert lowest[0] > -0.3 and lowest[1] < -0.35


@pytest.mark.long
def test_worlds_tear_alone_reset_mends_and_a_file_keeps_what_tore(device, tmp_path):
    sim = simulated(sheet(), device, worlds=2)
    with pytest.raises(ValueError, match="there is no object"):
        sim.cut("other", KNIFE)
    assert sim.cut("sheet", KNIFE, world=1) == 28
    assert [sim.report(w)["sheet"]["torn"] for w in range(2)] == [0, 28]
    assert [len(sim.triangles("sheet", w)) for w in range(2)] == [198, 180]
    sim.save(tmp_path / "state.npz")
    sim.reset(1)
    assert sim.report(1)["sheet"]["torn"] == 0 and len(sim.triangles("sheet", 1)) == 198
    sim.load(tmp_path / "state.npz")
    assert sim.report(1)["sheet"]["torn"] == 28 and len(sim.triangles("sheet", 1)) == 180
    sim.set("sheet.pins", (0, 11))  # all is built anew around it
    assert [sim.report(w)["sheet"]["torn"] for w in range(2)] == [0, 28]
    assert len(sim.triangles("sheet", 1)) == 180
    other = simulated(sheet(), device)
    other.cut("sheet", KNIFE)
    whole = simulated(sheet(), device)
    whole.take_over("sheet", other)
    assert whole.report()["sheet"]["torn"] == 28


def test_a_runaway_that_is_put_back_has_torn_nothing(device):
    sim = simulated(sheet(), device)
    sim.step()
    speed = np.zeros((120, 3))
    speed[5, 2] = 9.9e5
    sim.set_velocities("sheet", speed)
    sim.step()
    assert sim.report()["sheet"]["recoveries"] == 1 and sim.report()["sheet"]["torn"] == 0
    sim.step(5)
    assert sim.report()["sheet"]["max_strain"] < 1e-4


@pytest.mark.parametrize(
    ("polygon", "why"),
    [
        (KNIFE[:2], "allowed are N rows of 3 finite numbers, N at least 3"),
        ([(0, 0, 0), (1, 0, 0), (2, 0, 0)], "has an area of 0"),
        ([(0, 0, 0), (1, 0, 0), (1, 1, 0.3), (0, 1, 0)], "off its plane; allowed is a flat polygon"),
        ([(0, 0, np.nan)] * 3, "polygon of a cut"),
    ],
)
def test_what_is_no_polygon_cuts_nothing(device, polygon, why):
    sim = simulated(sheet(), device)
    with pytest.raises(ValueError, match=why):
        sim.cut("sheet", polygon)
    assert sim.report()["sheet"]["torn"] == 0


def test_a_cut_ends_where_its_polygon_ends(device):
    """An L of six corners in the plane x = 0.01: its notch, of y above 0 and z above 0, is left whole."""
    sim = simulated(sheet(), device)
    outline = [(-2, -1), (0.002, -1), (0.002, -0.1), (2, -0.1), (2, -2), (-2, -2)]
    assert sim.cut("sheet", [(0.01, y, z) for y, z in outline]) == 0  # it lies below the sheet
    outline = [(-2, -1), (2, -1), (2, -0.5), (0.02, -0.5), (0.02, 1), (-2, 1)]
    sim.cut("sheet", [(0.01, y, z) for y, z in outline])
    pairs, _, _ = sim.springs("sheet")["structural"]
    y = sim.rest_positions("sheet")[pairs[sim.torn("sheet")["structural"]]][:, :, 1]
    assert len(y) == 5 and y.max() < 0.0


def test_what_does_not_tear_says_so(device):
    sim = Simulation(Scene(objects={"sheet": sheet(tear_strain=0.0), "rope": Rope()}), Settings(), device=device)
    with pytest.raises(ValueError, match="sheet cannot be cut; allowed is a sheet that is built with a tear_strain"):
        sim.cut("sheet", KNIFE)
    with pytest.raises(ValueError, match="rope is a rope, which cannot be cut"):
        sim.cut("rope", KNIFE)
    with pytest.raises(ValueError, match="method is 'verlet' with tear_strain of sheet; allowed is 'auto' or 'xpbd'"):
        Simulation(Scene(objects={"sheet": sheet()}), Settings(method="verlet", substeps=200), device=device)
    with pytest.raises(ValueError, match="Cloth.tear_strain is -1; allowed is"):
        sheet(tear_strain=-1)
    chosen = Simulation(Scene(objects={"sheet": sheet()}), Settings(), device=device).choices["sheet"]
    assert chosen.method == "xpbd"


def test_a_kernel_of_what_does_not_tear_has_nothing_of_it():
    for tears in (True, False):
        features = Features(True, False, "", (), 2, "xpbd", plate=True, tears=tears)
        module = make_frame.__wrapped__(features, 256, 128).module
        source = ModuleBuilder(module, {**module.options, "output_arch": 90}).codegen("cuda")
        for name in ("make_tear__locals__tear", "strength", "settle_springs", "drop_over", "weigh_again"):
            assert (f"{name}_" in source.split("cuda_kernel_forward")[0]) == tears, name
