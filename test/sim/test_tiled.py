"""The tiled schedule: tiles and halos are what they should be, and no way of cutting a body changes a bit."""

import re
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from cloth_sim_ros.sim import Cloth, Plane, Rope, Scene, Settings, Simulation, Sphere, Wind
from cloth_sim_ros.sim.batch import forced_schedule
from cloth_sim_ros.sim.executors import subdomains as tiled
from cloth_sim_ros.sim.executors.subdomain_forces import Widths
from cloth_sim_ros.sim.executors.subdomain_kernels import make_kernels
from cloth_sim_ros.sim.model import Features
from cloth_sim_ros.sim.topology.subdomains import BANKS, cut, surround

SPRINGS = {"stretch_compliance": 1e-3, "shear_compliance": 1e-3}


def busy_scene():
    return Scene(
        {
            "sheet": Cloth(resolution=(15, 12), pins="top", damping=1e-4, bending="springs", **SPRINGS),
            "small": Cloth(resolution=(6, 7), pins="corners", position=(0, 1.5, 0), **SPRINGS),
        },
        {"ball": Sphere(radius=0.2, position=(0, 0, -0.22)), "floor": Plane(position=(0, 0, -0.3))},
    )


def forced(schedule, scene, settings, device, worlds=1):
    with forced_schedule(schedule):
        return Simulation(scene, settings, device, worlds)


def simulation(device, size=None, depth=None, scene=None, substeps=45, waits=None, **settings):
    """A simulation whose tiles hold `size` particles and `depth` rings and wait for one another, or what the product
    chooses."""
    chosen = Settings(method="verlet", substeps=substeps, **settings)
    sim = forced("tiled", scene or busy_scene(), chosen, device)
    for batch in sim._bodies.batches:
        layouts = [sim._bodies.topologies[name].layout for name in batch.index]
        batch.schedule = tiled.Tiled(batch.features, batch.worlds, layouts, batch.device, size, depth, waits)
        batch._trial = None
    return sim


def states(sim, frames=10):
    for frame in range(frames):
        if "ball" in sim.scene.colliders:
            sim.set_collider_pose("ball", (0, 0.02 * frame, -0.2), (0, 0, 0.05 * frame, 1))
        sim.step()
    return np.concatenate([np.hstack([sim.positions(name), sim.velocities(name)]) for name in sim.scene.objects])


def test_a_grid_falls_into_squares():
    grid = np.stack(np.meshgrid(np.arange(64.0), np.arange(64.0), [0.0], indexing="ij"), -1).reshape(-1, 3)
    tile = cut(grid, 64)
    for one in range(64):
        points = grid[tile == one]
        assert len(points) == 64 and (np.ptp(points, axis=0)[:2] == 7).all()


@pytest.mark.parametrize("size", [7, 50, 1000])
def test_tiles_share_the_particles_evenly(size):
    points = np.random.default_rng(1).random((333, 3))
    counts = np.bincount(cut(points, size))
    assert counts.sum() == 333 and counts.max() <= size and np.ptp(counts) <= 1


def test_a_halo_holds_what_is_within_so_many_springs_and_knows_its_neighbours():
    n, depth = 20, 3
    index = np.arange(n * n).reshape(n, n)
    around = np.stack(
        [np.roll(np.pad(index, 1, "edge"), s, (0, 1))[1:-1, 1:-1] for s in ((1, 0), (-1, 0), (0, 1), (0, -1))]
    )
    neighbours = around.reshape(4, -1).T  # a particle on the border is its own neighbour beyond it
    tile = cut(np.stack([*np.divmod(np.arange(n * n), n), np.zeros(n * n)], 1).astype(float), 25)
    tiling = surround(tile, neighbours, depth)
    starts = np.concatenate([[0], np.cumsum(tiling.ends[:, -1])])
    spokes = np.full((len(tiling.members), 4), -1)
    spokes[tiling.inner] = tiling.spokes
    row, column = np.divmod(np.arange(n * n), n)
    for one in range(tile.max() + 1):
        members = tiling.members[starts[one] : starts[one + 1]]
        own = tile == one
        distance = (np.abs(row[:, None] - row[own]) + np.abs(column[:, None] - column[own])).min(1)
        for ring in range(depth + 1):
            assert set(members[: tiling.ends[one, ring]]) == set(np.flatnonzero(distance <= ring))
        inner = members[: tiling.ends[one, depth - 1]]
        found = spokes[starts[one] : starts[one] + len(inner)]
        assert np.array_equal(members[found], neighbours[inner])


@pytest.mark.parametrize(("size", "depth"), [(32, 4), (32, 6), (64, 4), (128, 4)])
def test_eight_threads_read_neighbours_from_eight_banks(size, depth):
    n = 64
    row, column = np.divmod(np.arange(n * n), n)
    moves = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b]
    beside = [np.clip(row + a, 0, n - 1) * n + np.clip(column + b, 0, n - 1) for a, b in moves]
    tile = cut(np.stack([column, row, 0 * row], 1).astype(float), size)
    tiling = surround(tile, np.stack(beside, 1), depth)
    starts = np.concatenate([[0], np.cumsum(tiling.ends[:, -1])])
    spokes = np.full((len(tiling.members), 8), -1)
    spokes[tiling.inner] = tiling.spokes
    waits, least = 0, 0
    for one, (first, end) in enumerate(zip(starts[:-1], starts[1:], strict=True)):
        places = tiling.places[first:end]
        assert len(np.unique(places)) == end - first and places.max() < 1.25 * (end - first)
        turns = tiling.turns[first:end]
        assert np.array_equal(np.sort(turns), np.arange(first, end))
        for ring in range(depth):
            mine = turns[: tiling.ends[one, ring]]
            assert set(mine) == set(range(first, first + len(mine)))
            for group in np.split(mine, range(8, len(mine), 8)):
                banks = tiling.places[first + spokes[group]] % BANKS
                waits += sum(np.bincount(each).max() for each in banks.T)
                least += 8
    assert waits < 1.25 * least


@pytest.mark.parametrize("iterations", [1, 2])
def test_no_way_of_cutting_changes_a_bit(device, iterations):
    whole = states(simulation(device, 200, 1, iterations=iterations))
    for size, depth in ((16, 1), (16, 4), (50, 3), (None, None)):
        assert np.array_equal(whole, states(simulation(device, size, depth, iterations=iterations)))


@pytest.mark.skipif(not wp.is_cuda_available(), reason="tiles wait for one another on a GPU")
@pytest.mark.parametrize("iterations", [1, 2])
def test_tiles_that_wait_for_one_another_get_what_launches_give(iterations):
    for size, depth in ((16, 2), (16, 4), (50, 4), (60, 6)):
        found = [simulation("cuda:0", size, depth, waits=waits, iterations=iterations) for waits in (False, None)]
        assert [sim._bodies.batches[0].schedule.waits for sim in found] == [False, True]
        apart, together = (states(sim) for sim in found)
        assert np.array_equal(apart, together)


@pytest.mark.skipif(not wp.is_cuda_available(), reason="tiles wait for one another on a GPU")
def test_a_tile_that_is_never_heard_of_is_a_fault_and_not_a_hang():
    sim = simulation("cuda:0", 16, 4, Scene({"it": Cloth(resolution=(12, 12), pins="top", **SPRINGS)}))
    sim.step(3)
    good, schedule = sim.positions("it"), sim._bodies.batches[0].schedule
    schedule._count -= 1
    sim.set("solver.substeps", 47)  # a new graph, of all tiles but the last
    sim.step()
    assert sim.report()["it"]["recoveries"] == 1
    assert np.array_equal(sim.positions("it"), good)
    schedule._count += 1
    sim.set("solver.substeps", 49)
    sim.step(3)
    assert sim.report()["it"]["recoveries"] == 1 and np.abs(sim.positions("it") - good).max() > 1e-4


def test_it_agrees_with_the_resident_schedule(device):
    resident = forced("resident", busy_scene(), Settings(method="verlet", substeps=45), device)
    found, wanted = states(simulation(device, 40, 4), 5), states(resident, 5)
    assert np.abs(found - wanted)[:, :3].max() < 2e-6  # what compilers round differently has not yet grown
    assert np.abs(wanted[:, 2]).max() > 0.02


def test_worlds_have_their_own_tiles(device):
    single = {gravity: simulation(device, 40, 4) for gravity in (-9.81, -3.0)}
    many = forced("tiled", busy_scene(), Settings(method="verlet", substeps=45), device, worlds=3)
    many.set("gravity", (0, 0, -3.0), world=1)
    single[-3.0].set("gravity", (0, 0, -3.0))
    for sim in (*single.values(), many):
        sim.step(8)
    for world, gravity in enumerate((-9.81, -3.0, -9.81)):
        for name in many.scene.objects:
            assert np.array_equal(many.positions(name, world), single[gravity].positions(name))
    many.set_velocities("small", np.full((42, 3), 5e5), world=2)
    many.step()
    assert [many.report(world)["small"]["recoveries"] for world in range(3)] == [0, 0, 1]


def test_a_change_of_substeps_and_a_reset_are_followed(device):
    sim = simulation(device, 40, 4)
    states(sim, 3)
    sim.set("solver.substeps", 50)
    states(sim, 3)
    sim.reset()
    assert np.array_equal(states(sim, 4), states(simulation(device, 16, 3, substeps=50), 4))


def test_a_body_gone_bad_is_put_back_alone(device):
    sim, beside = simulation(device, 16, 3), simulation(device, 16, 3)
    states(sim, 3), states(beside, 3)
    good = sim.positions("small")
    x = sim.positions("small")
    batch = sim._bodies.batch["small"]
    span = batch.span("small")
    spoiled = batch.worlds[0].state.positions[span].numpy()
    spoiled[20, 0] = np.nan
    batch.worlds[0].state.positions[span].assign(spoiled)
    sim.step(), beside.step()
    assert np.array_equal(sim.positions("small"), good) and not sim.velocities("small").any()
    assert sim.report()["small"]["recoveries"] == 1 and sim.report()["sheet"]["recoveries"] == 0
    assert np.array_equal(sim.positions("sheet"), beside.positions("sheet"))
    sim.step(3)
    assert sim.report()["small"]["recoveries"] == 1 and np.abs(sim.positions("small") - x).max() > 1e-3


def test_implicit_steps_in_tiles_are_refused():
    with pytest.raises(ValueError, match="'tiled' is forced with method 'xpbd'; allowed is method 'verlet'"):
        forced("tiled", Scene({"it": Rope(segments=4)}), Settings(method="xpbd", order=1, substeps=20), "cpu")


def test_too_many_springs_at_a_particle_are_refused():
    hub = np.array([[0.0, 0, 0], *[(np.cos(a), np.sin(a), 0) for a in np.linspace(0, 6, 40)]])
    fan = [(0, i, i + 1) for i in range(1, 40)]
    sheet = Cloth.from_mesh(hub, fan, mass=1.0)
    with pytest.raises(ValueError, match="more than 32 springs"):
        simulation("cpu", scene=Scene({"it": sheet}))


@pytest.mark.parametrize("kind", ["sheet", "rope"])
def test_wind_blows_through_tiles(device, kind):
    sheet = Cloth(resolution=(12, 11), pins="top", stretch_compliance=1e-3, shear_compliance=3e-3)
    rope = Rope(segments=60, stretch_compliance=1e-2, pins="both")
    scene = Scene({"it": sheet if kind == "sheet" else rope}, wind=Wind((3, 5, 1)))
    whole = states(simulation(device, 200, 1, scene), 20)
    for size, depth in ((16, 3), (7, 1), (None, None)):
        assert np.array_equal(whole, states(simulation(device, size, depth, scene), 20))
    resident = forced("resident", scene, Settings(method="verlet", substeps=45), device)
    early = states(simulation(device, 16, 3, scene), 4)
    # In the fifth frame the sheet buckles, and what compilers round differently grows a hundredfold.
    assert np.abs(states(resident, 4) - early)[:, :3].max() < 1e-6
    still = Simulation(Scene(scene.objects), Settings(method="verlet", substeps=45), device=device)
    assert np.abs(states(still, 4) - early)[:, :3].max() > 5e-4


def test_a_rope_is_a_row_of_tiles(device):
    rope = Rope(segments=100, stretch_compliance=1e-2, pins="both")
    whole = states(simulation(device, scene=Scene({"it": rope}), substeps=100), 20)
    assert np.array_equal(whole, states(simulation(device, 20, 4, Scene({"it": rope}), 100), 20))


@pytest.mark.parametrize(("shapes", "waits"), [((), False), ((), True), (("sphere", "box"), True)])
def test_it_compiles_for_cuda_with_its_springs_in_registers(shapes, waits, tmp_path):
    features = Features((), False, "", shapes, 1, "verlet")
    for name, kernel in make_kernels.__wrapped__(features, 576, 576, Widths(8, 0, 0, 0), waits).items():
        wp.compile_aot_module(kernel.module, arch=90, module_dir=tmp_path / name, use_ptx=True)
    code = next((tmp_path / "advance").glob("*.ptx")).read_text()
    assert len(re.findall(r"ld\.shared\.v4", code)) >= 16  # both parts of eight neighbours, 16 bytes at a time
    assert ("ld.relaxed.gpu.global.b128" in code) == waits
    if not shapes:
        assert ".local" not in code
        source = next(Path(tmp_path / "advance").glob("*.cu")).read_text()
        assert "sweep_collider" not in source and "contact" not in source.split("cuda_kernel_forward")[1]
