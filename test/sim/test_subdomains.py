# SPDX-License-Identifier: Apache-2.0
"""The subdomains executor: subdomains and halos are what they should be, and no way of cutting a body changes a bit."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from scipy.spatial import Delaunay

from cloth_sim_ros.sim import Box, Cloth, Plane, Rope, Scene, Settings, Simulation, Sphere, Wind
from cloth_sim_ros.sim.colliders.collider import Collider
from cloth_sim_ros.sim.executors import subdomain_kernels, subdomain_substep, subdomains
from cloth_sim_ros.sim.executors.choose import forced_executor
from cloth_sim_ros.sim.executors.subdomain_forces import InSubdomain, Widths
from cloth_sim_ros.sim.executors.subdomain_kernels import make_kernels
from cloth_sim_ros.sim.model import Features
from cloth_sim_ros.sim.physics.integrate import next_outer, outer_weight
from cloth_sim_ros.sim.topology.subdomains import BANKS, cut, surround

SPRINGS = {"stretch_compliance": 1e-3, "shear_compliance": 1e-3}


def busy_scene():
    return Scene(
        {
            "sheet": Cloth(resolution=(15, 12), pins="top", damping=1e-4, bending="springs", thickness=0.02, **SPRINGS),
            "small": Cloth(
                resolution=(6, 7), size=(0.4, 0.4), pins="corners", position=(0, 1.5, 0), thickness=0.02, **SPRINGS
            ),
        },
        {"ball": Sphere(radius=0.22, position=(0, 0, -0.24)), "floor": Plane(position=(0, 0, -0.3))},
    )


def forced(executor, scene, settings, device, worlds=1):
    with forced_executor(executor):
        return Simulation(scene, settings, device, worlds)


def simulation(device, size=None, depth=None, scene=None, substeps=45, waits=None, **settings):
    """A simulation whose subdomains hold `size` particles and `depth` rings and wait for one another, or what the
    product chooses."""
    chosen = Settings(method="verlet", substeps=substeps, **settings)
    sim = forced("subdomains", scene or busy_scene(), chosen, device)
    for batch in sim._bodies.batches:
        layouts = [sim._bodies.topologies[name].layout for name in batch.index]
        batch.executor = subdomains.Subdomains(batch.features, batch.worlds, layouts, batch.device, size, depth, waits)
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
    subdomain = cut(grid, 64)
    for one in range(64):
        points = grid[subdomain == one]
        assert len(points) == 64 and (np.ptp(points, axis=0)[:2] == 7).all()


@pytest.mark.parametrize("size", [7, 50, 1000])
def test_subdomains_share_the_particles_evenly(size):
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
    subdomain = cut(np.stack([*np.divmod(np.arange(n * n), n), np.zeros(n * n)], 1).astype(float), 25)
    partition = surround(subdomain, neighbours, depth)
    starts = np.concatenate([[0], np.cumsum(partition.ends[:, -1])])
    incident_springs = np.full((len(partition.members), 4), -1)
    incident_springs[partition.inner] = partition.incident_springs
    row, column = np.divmod(np.arange(n * n), n)
    for one in range(subdomain.max() + 1):
        members = partition.members[starts[one] : starts[one + 1]]
        own = subdomain == one
        distance = (np.abs(row[:, None] - row[own]) + np.abs(column[:, None] - column[own])).min(1)
        for ring in range(depth + 1):
            assert set(members[: partition.ends[one, ring]]) == set(np.flatnonzero(distance <= ring))
        inner = members[: partition.ends[one, depth - 1]]
        found = incident_springs[starts[one] : starts[one] + len(inner)]
        assert np.array_equal(members[found], neighbours[inner])


@pytest.mark.parametrize(("size", "depth"), [(32, 4), (32, 6), (64, 4), (128, 4)])
def test_eight_threads_read_neighbours_from_eight_banks(size, depth):
    n = 64
    row, column = np.divmod(np.arange(n * n), n)
    moves = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b]
    beside = [np.clip(row + a, 0, n - 1) * n + np.clip(column + b, 0, n - 1) for a, b in moves]
    subdomain = cut(np.stack([column, row, 0 * row], 1).astype(float), size)
    partition = surround(subdomain, np.stack(beside, 1), depth)
    starts = np.concatenate([[0], np.cumsum(partition.ends[:, -1])])
    incident_springs = np.full((len(partition.members), 8), -1)
    incident_springs[partition.inner] = partition.incident_springs
    waits, least = 0, 0
    for one, (first, end) in enumerate(zip(starts[:-1], starts[1:], strict=True)):
        places = partition.places[first:end]
        assert len(np.unique(places)) == end - first and places.max() < 1.25 * (end - first)
        turns = partition.turns[first:end]
        assert np.array_equal(np.sort(turns), np.arange(first, end))
        for ring in range(depth):
            mine = turns[: partition.ends[one, ring]]
            assert set(mine) == set(range(first, first + len(mine)))
            for group in np.split(mine, range(8, len(mine), 8)):
                banks = partition.places[first + incident_springs[group]] % BANKS
                waits += sum(np.bincount(each).max() for each in banks.T)
                least += 8
    assert waits < 1.25 * least


@pytest.mark.parametrize("iterations", [1, 2])
@pytest.mark.long
def test_no_way_of_cutting_changes_a_bit(device, iterations):
    whole = states(simulation(device, 200, 1, iterations=iterations))
    for size, depth in ((16, 1), (16, 4), (50, 3), (None, None)):
        assert np.array_equal(whole, states(simulation(device, size, depth, iterations=iterations)))


@pytest.mark.skipif(not wp.is_cuda_available(), reason="subdomains wait for one another on a GPU")
@pytest.mark.parametrize("iterations", [1, 2])
def test_subdomains_that_wait_for_one_another_get_what_launches_give(iterations):
    for size, depth in ((16, 2), (16, 4), (50, 4), (60, 6)):
        found = [simulation("cuda:0", size, depth, waits=waits, iterations=iterations) for waits in (False, None)]
        assert [sim._bodies.batches[0].executor.waits for sim in found] == [False, True]
        apart, together = (states(sim) for sim in found)
        assert np.array_equal(apart, together)


@pytest.mark.skipif(not wp.is_cuda_available(), reason="subdomains wait for one another on a GPU")
def test_a_subdomain_that_is_never_heard_of_is_a_fault_and_not_a_hang():
    sim = simulation("cuda:0", 16, 4, Scene({"it": Cloth(resolution=(12, 12), pins="top", **SPRINGS)}))
    sim.step(3)
    good, executor = sim.positions("it"), sim._bodies.batches[0].executor
    executor._count -= 1
    sim.set("solver.substeps", 47)  # a new graph, of all subdomains but the last
    sim.step()
    assert sim.report()["it"]["recoveries"] == 1
    assert np.array_equal(sim.positions("it"), good)
    executor._count += 1
    sim.set("solver.substeps", 49)
    sim.step(3)
    assert sim.report()["it"]["recoveries"] == 1 and np.abs(sim.positions("it") - good).max() > 1e-4


def test_it_agrees_with_the_block_executor(device):
    block = forced("block", busy_scene(), Settings(method="verlet", substeps=45), device)
    found, wanted = states(simulation(device, 40, 4), 5), states(block, 5)
    assert np.abs(found - wanted)[:, :3].max() < 2e-6  # what compilers round differently has not yet grown
    assert np.abs(wanted[:, 2]).max() > 0.02


@pytest.mark.long
def test_worlds_have_their_own_subdomains(device):
    single = {gravity: simulation(device, 40, 4) for gravity in (-9.81, -3.0)}
    many = forced("subdomains", busy_scene(), Settings(method="verlet", substeps=45), device, worlds=3)
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


def test_implicit_steps_in_subdomains_are_refused():
    with pytest.raises(ValueError, match="'subdomains' is forced with method 'xpbd'; allowed is method 'verlet'"):
        forced("subdomains", Scene({"it": Rope(segments=4)}), Settings(method="xpbd", order=1, substeps=20), "cpu")


def test_too_many_springs_at_a_particle_are_refused():
    hub = np.array([[0.0, 0, 0], *[(np.cos(a), np.sin(a), 0) for a in np.linspace(0, 6, 40)]])
    fan = [(0, i, i + 1) for i in range(1, 40)]
    sheet = Cloth.from_mesh(hub, fan, mass=1.0)
    with pytest.raises(ValueError, match="more than 32 springs"):
        simulation("cpu", scene=Scene({"it": sheet}))


@pytest.mark.long
@pytest.mark.parametrize("kind", ["sheet", "rope"])
def test_wind_blows_through_subdomains(device, kind):
    sheet = Cloth(resolution=(12, 11), pins="top", stretch_compliance=1e-3, shear_compliance=3e-3)
    rope = Rope(segments=60, stretch_compliance=1e-2, pins="both")
    scene = Scene({"it": sheet if kind == "sheet" else rope}, wind=Wind((3, 5, 1)))
    whole = states(simulation(device, 200, 2, scene), 20)
    for size, depth in ((16, 3), (7, 2), (None, None)):
        assert np.array_equal(whole, states(simulation(device, size, depth, scene), 20))
    block = forced("block", scene, Settings(method="verlet", substeps=45), device)
    early = states(simulation(device, 16, 3, scene), 4)
    # In the fifth frame the sheet buckles, and what compilers round differently grows a hundredfold.
    assert np.abs(states(block, 4) - early)[:, :3].max() < 1e-6
    still = Simulation(Scene(scene.objects), Settings(method="verlet", substeps=45), device=device)
    assert np.abs(states(still, 4) - early)[:, :3].max() > 5e-4


def test_a_rope_is_a_row_of_subdomains(device):
    rope = Rope(segments=100, stretch_compliance=1e-2, pins="both")
    whole = states(simulation(device, scene=Scene({"it": rope}), substeps=100), 20)
    assert np.array_equal(whole, states(simulation(device, 20, 4, Scene({"it": rope}), 100), 20))


@pytest.mark.long
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


SHEET = Cloth(resolution=(14, 13), pins="top", orientation=(0.7071068, 0, 0, 0.7071068), thickness=0.02, **SPRINGS)
BENDS = {"bending": "dihedral", "bend_compliance": 1e4}
LARGE = {"near": Sphere(radius=2.0, position=(0.03, -0.28, -2.02))}
BALL = {"near": Sphere(radius=0.22, position=(0.03, -0.28, -0.24)), "floor": Plane(position=(0, 0, -0.45))}


def irregular():
    """A mesh of a square metre with up to a dozen edges at a vertex."""
    rng = np.random.default_rng(4)
    border = np.linspace(-0.5, 0.5, 9)
    sides = [(x, y) for x in border for y in border if max(abs(x), abs(y)) == 0.5]
    points = np.concatenate([sides, rng.uniform(-0.47, 0.47, (110, 2))])
    points = np.c_[points, np.zeros(len(points))]
    pins = np.flatnonzero(points[:, 1] == 0.5).tolist()
    triangles = Delaunay(points[:, :2]).simplices
    assert np.bincount(triangles.ravel()).max() >= 9
    return Cloth.from_mesh(points, triangles, mass=0.3, pins=pins, stretch_compliance=5e-3, **BENDS)


WIND = Wind((1, 2, 0.5))
REAL = {
    "bends": Scene({"it": dataclasses.replace(SHEET, orientation=(0, 0, 0, 1), **BENDS)}),
    "bends and is damped in wind": Scene({"it": dataclasses.replace(SHEET, damping=1e-4, **BENDS)}, wind=WIND),
    "curtain": Scene({"it": dataclasses.replace(SHEET, damping=1e-4, **BENDS)}, BALL, WIND),
    "mesh": Scene({"it": dataclasses.replace(irregular(), thickness=0.02)}, LARGE, WIND),
    "no diagonals": Scene({"it": dataclasses.replace(SHEET, shear_compliance=None, **BENDS)}, wind=WIND),
}


def pushed(sim):
    """Five frames in which a ball, if there is one, comes against the sheet and pushes it."""
    for frame in range(1, 6):
        if sim.scene.colliders:
            height = sim.scene.colliders["near"].position[2]
            sim.set_collider_pose("near", (0.03, 0.04 * frame - 0.28, height))
        sim.step()
    return np.hstack([sim.positions("it"), sim.velocities("it")])


@pytest.mark.long
@pytest.mark.parametrize("kind", REAL)
def test_real_scenes_move_in_subdomains_as_in_one_block(device, kind):
    substeps = 150 if kind == "mesh" else 60
    block = forced("block", REAL[kind], Settings(method="verlet", substeps=substeps), device)
    wanted = pushed(block)
    whole = pushed(simulation(device, scene=REAL[kind], substeps=substeps))
    assert np.abs(whole - wanted)[:, :3].max() < 2e-5  # what compilers round differently
    for size, depth in ((40, 4), (25, 6)):
        assert np.array_equal(whole, pushed(simulation(device, size, depth, REAL[kind], substeps)))
    assert np.abs(wanted[:, :3] - block.rest_positions("it")).max() > 0.01


@pytest.mark.long
def test_worlds_of_a_real_scene_have_their_own_wind(device):
    settings = Settings(method="verlet", substeps=60)
    many = forced("subdomains", REAL["curtain"], settings, device, worlds=2)
    many.set_wind((0, -3, 0), world=1)
    many.set("it.bend_compliance", 2e4, world=1)
    alone = forced("subdomains", REAL["curtain"], settings, device)
    alone.set_wind((0, -3, 0))
    alone.set("it.bend_compliance", 2e4)
    first = forced("subdomains", REAL["curtain"], settings, device)
    for sim in (many, alone, first):
        sim.step(5)
    assert np.array_equal(many.positions("it", 1), alone.positions("it"))
    assert np.array_equal(many.positions("it", 0), first.positions("it"))


@pytest.mark.long
@pytest.mark.parametrize("shape", ["ball", "box"])
def test_skipping_colliders_decides_nothing(device, monkeypatch, shape):
    """A ball at 20 m/s, and a long box that turns by 45 degrees a frame: the same bits as testing every substep."""
    collider = Sphere(radius=0.2, position=(0, 0, -0.5)) if shape == "ball" else Box(half_extents=(0.6, 0.02, 0.1))
    collider = dataclasses.replace(collider, position=(0, -0.5, 0.2))
    monkeypatch.setattr(Collider, "enters", lambda *_: False)  # a box would come between particles
    scene = Scene({"it": SHEET}, {"it's": collider})

    def run():
        sim, found = simulation(device, 40, 4, scene, 60), []
        for frame in range(1, 6):
            angle = 0.5 * np.pi * frame / 2 if shape == "box" else 0.0
            travel = 20.0 * frame / 60 if shape == "ball" else 0.12 * frame
            pose = (0, -0.5 + travel, 0.2), (0, 0, np.sin(angle), np.cos(angle))
            sim.set_collider_pose("it's", *pose)
            sim.step()
            found.append(np.hstack([sim.positions("it"), sim.velocities("it")]))
        return np.array(found)

    skipping = run()

    def always(features):
        @wp.func
        def clearance(x: wp.vec3, before: float, after: float, here: InSubdomain) -> float:
            return -1.0

        return clearance

    monkeypatch.setattr(subdomain_substep, "make_clearance", always)
    subdomain_kernels.make_kernels.cache_clear()
    testing = run()
    subdomain_kernels.make_kernels.cache_clear()
    assert np.array_equal(skipping, testing)
    free = simulation(device, 40, 4, Scene({"it": SHEET}), 60)
    free.step(5)
    assert np.abs(free.positions("it") - skipping[-1, :, :3]).max() > 0.05  # it was hit


def test_momentum_is_kept_by_bending_and_springs(device):
    loose = Cloth(resolution=(12, 12), pins="none", damping=1e-4, **SPRINGS, **BENDS)
    sim = simulation(device, 30, 6, Scene({"it": loose}, gravity=(0, 0, 0)), 60)
    rng = np.random.default_rng(2)
    masses = sim.masses("it")[:, None]
    kick = rng.standard_normal((144, 3)) * 0.3
    sim.set_velocities("it", kick)
    start = (masses * sim.velocities("it")).sum(0)
    sim.step(30)
    size = (masses * np.abs(kick)).sum()
    assert np.abs((masses * sim.velocities("it")).sum(0) - start).max() < 1e-5 * size
    assert np.abs(sim.velocities("it") - kick).max() > 0.1


@pytest.mark.long
def test_bending_at_outer_steps_keeps_energy_for_ten_seconds():
    """Longer outer steps would be in resonance with in-plane modes and heat this very sheet (see outer_steps)."""
    thing = Cloth(
        resolution=(20, 20),
        pins="edges",
        stretch_compliance=1e-3,
        shear_compliance=3e-3,
        **BENDS | {"bend_compliance": 1e3},
    )
    sim = simulation("cpu", 100, 6, Scene({"it": thing}, gravity=(0, 0, 0)), 100)
    topology = sim._bodies.topologies["it"]
    x = sim.positions("it").astype(np.float64)
    bump = 0.03 * np.cos(np.pi * x[:, 0]) * np.cos(np.pi * x[:, 1]) * (1 + np.sin(3 * x[:, 0]))
    x[~topology.pinned, 2] += bump[~topology.pinned]
    sim.set_positions("it", x)
    plate = topology.plate

    def energy():
        x, v = (each("it").astype(np.float64) for each in (sim.positions, sim.velocities))
        total = 0.5 * (topology.masses[~topology.pinned, None] * v[~topology.pinned] ** 2).sum()
        for kind, elements in topology.springs.items():
            compliance = {"structural": 1e-3, "shear": 3e-3}[kind] * elements.scale
            length = np.linalg.norm(x[elements.particles[:, 1]] - x[elements.particles[:, 0]], axis=1)
            total += (0.5 / compliance * (length - elements.rest) ** 2).sum()
        moved = x - topology.rest
        force = -1e-3 * (plate.weights[:, :, None] * (moved[plate.neighbours] - moved[:, None])).sum(1)
        return total - 0.5 * (moved * force).sum()

    found = []
    for _ in range(120):
        sim.step(5)
        found.append(energy())
    assert np.mean(found[-20:]) == pytest.approx(np.mean(found[:20]), rel=1e-2)


@pytest.mark.parametrize(("substeps", "outer"), [(60, 10), (61, 10), (7, 3), (10, 10), (5, 1)])
def test_impulses_of_slow_forces_add_up_to_the_frame(substeps, outer):
    """Half of the first and of the last step at the ends, and between them half of each step beside."""

    @wp.kernel(enable_backward=False)
    def ask(substeps: int, outer: int, weights: wp.array(dtype=float), following: wp.array(dtype=int)):
        k = wp.tid()
        weights[k] = outer_weight(k, substeps, outer)
        following[k] = next_outer(k, substeps, outer)

    weights, following = (
        wp.zeros(substeps + 1, dtype=float, device="cpu"),
        wp.zeros(substeps + 1, dtype=int, device="cpu"),
    )
    wp.launch(ask, dim=substeps + 1, inputs=[substeps, outer, weights, following], device="cpu")
    at = np.flatnonzero(weights.numpy())
    assert at[0] == 0 and at[-1] == substeps and len(at) == outer + 1
    steps = np.diff(at)
    assert weights.numpy().sum() == substeps and np.ptp(steps) <= 1
    assert np.array_equal(2 * weights.numpy()[at], np.r_[steps, 0] + np.r_[0, steps])
    assert [following.numpy()[k] for k in range(substeps)] == [at[at > k][0] for k in range(substeps)]
    for depth, reach in ((4, 1), (5, 2), (1 << 30, 2)):
        made = subdomains.launches(substeps, outer, depth, reach)
        assert sum(count for _, count in made) == substeps
        for first, count in made:
            kicks = [k for k in at if first <= k < first + count]
            assert len(kicks) * reach + count <= depth


def test_a_sheet_that_is_curved_at_rest_is_refused():
    x, y = (each.ravel() for each in np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1, 5)))
    points = np.c_[x, y, 0.3 * x * (1 - x)]
    bent = Cloth.from_mesh(points, Delaunay(points[:, :2]).simplices, mass=1.0, **BENDS)
    with pytest.raises(ValueError, match="curved at rest"):
        simulation("cpu", scene=Scene({"it": bent}), substeps=500)


@pytest.mark.long
@pytest.mark.parametrize("waits", [False, True])
def test_all_that_a_sheet_may_have_compiles_for_cuda(waits, tmp_path):
    features = Features((), False, "triangles", ("box", "sphere"), 1, "verlet", worlds=True, plate=True)
    kernels = make_kernels.__wrapped__(features, 576, 576, Widths(20, 12, 25, 3), waits)
    wp.compile_aot_module(kernels["advance"].module, arch=90, module_dir=tmp_path, use_ptx=True)
    source = next(tmp_path.glob("*.cu")).read_text()
    for name in ("clearance", "bending", "triangle_force", "friction_correction", "kicked"):
        assert name in source
    depots = re.findall(r"__local_depot\d+\[(\d+)\]", next(tmp_path.glob("*.ptx")).read_text())
    assert sum(map(int, depots)) <= 64  # what the sine of a turning collider takes
