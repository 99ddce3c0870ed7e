# SPDX-License-Identifier: Apache-2.0
"""The kernels themselves: executors agree to the bit, an absent feature leaves no trace, everything compiles for
CUDA."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from fixed_settings import fixed
from warp._src.context import ModuleBuilder  # the only way to see a source without compiling it

import cloth_sim_ros
from cloth_sim_ros.sim import Box, Capsule, Cloth, Plane, Rope, Scene, Settings, Simulation, Sphere, Wind, topology
from cloth_sim_ros.sim.access import report, tension, wrench
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.executors import block, graph

PLATE = {"bending": "dihedral", "bend_compliance": 1e2}
ROPE = {"order 1": Rope(segments=20, start=(0, 0, 1.0), bend_compliance=1e2), "order 2": Rope(start=(0, 1, 1))}


def busy_scene(order=1, plate=False):
    """Everything at once: a cloth and a rope, of the first order one that bends, in wind among all shapes, one of them
    moving."""
    bending = PLATE if plate else {"bending": "springs", "bend_compliance": 0.1}
    return Scene(
        objects={
            "cloth": Cloth(resolution=(12, 9), pins="top", damping=1e-3, **bending),
            "rope": ROPE[f"order {order}"],
        },
        colliders={
            "ball": Sphere(radius=0.2, position=(0, 0, -0.3)),
            "floor": Plane(position=(0, 0, -1)),
            "box": Box(position=(0.3, 0.3, -0.3)),
            "pill": Capsule(position=(0.6, -0.3, -0.4)),
        },
        wind=Wind((1, 0.5, 0)),
    )


def states(device, frames=8, executor=None, order=2, plate=False, **settings):
    sim = Simulation(busy_scene(order, plate), fixed(order=order, **settings), device=device, executor=executor)
    for frame in range(frames):
        sim.set_collider_pose("ball", (0, 0.02 * frame, -0.2), (0, 0, 0.05 * frame, 1))
        sim.step()
    return {name: (sim.positions(name), sim.velocities(name)) for name in sim.scene.objects}


@pytest.mark.long
@pytest.mark.parametrize(("order", "iterations"), [(2, 1), (1, 3)])
def test_both_executors_give_the_same_state(device, order, iterations):
    kinds = {"block": None, "graph": None}
    for executor in kinds:
        kinds[executor] = states(device, order=order, iterations=iterations, substeps=7, executor=executor)
    for name, (x, v) in kinds["block"].items():
        assert np.abs(x - kinds["graph"][name][0]).max() < 2e-6
        assert np.abs(v - kinds["graph"][name][1]).max() < 2e-3


@pytest.mark.long
def test_bending_of_plates_agrees_between_executors(device):
    found = [states(device, plate=True, executor=executor)["cloth"][0] for executor in ("block", "graph")]
    assert np.abs(found[0] - found[1]).max() < 2e-6


def drawn_scene(seed):
    """A scene of a sheet and a rope, what each has and what is around them drawn from `seed`."""
    rng = np.random.default_rng(seed)
    colliders = {
        "sphere": Sphere(radius=0.2, position=(0.3, 0.2, -0.3)),
        "capsule": Capsule(position=(0, 0, -0.3)),
        "none": None,
    }
    collider = colliders[rng.choice(list(colliders))]
    bending = rng.choice(["none", "springs", "dihedral"])
    sheet = Cloth(
        resolution=tuple(int(n) for n in rng.integers(5, 12, 2)),
        bending=str(bending),
        bend_compliance=float(10 ** rng.uniform(1, 3)) if bending == "dihedral" else float(10 ** rng.uniform(-2, 0)),
        stretch_compliance=float(10 ** rng.uniform(-4, -2)),
        damping=float(rng.choice([0.0, 1e-3])),
        pins=str(rng.choice(["corners", "top"])),
    )
    rope = Rope(segments=int(rng.integers(6, 20)), start=(0, 1, 0.5), damping=float(rng.choice([0.0, 1e-3])))
    wind = Wind(velocity=tuple(rng.uniform(-4, 4, 3))) if rng.random() < 0.7 else Wind()
    return Scene(objects={"sheet": sheet, "rope": rope}, colliders={"it": collider} if collider else {}, wind=wind)


@pytest.mark.parametrize("seed", [0, *[pytest.param(seed, marks=pytest.mark.long) for seed in (2, 3)]])
@pytest.mark.parametrize("method", ["xpbd", pytest.param("verlet", marks=pytest.mark.long)])
def test_drawn_scenes_move_the_same_by_every_executor(device, method, seed):
    scene = drawn_scene(seed)
    order = 2 - seed % 2
    chosen = {"method": "verlet"} if method == "verlet" else {"method": "xpbd", "order": order, "substeps": 8}
    found = []
    for executor in (None, "block", "graph"):
        sim = Simulation(scene, Settings(**chosen), device=device, executor=executor)
        sim.step(10)
        found.append({name: sim.positions(name) for name in scene.objects})
    for other in found[1:]:
        for name, x in found[0].items():
            assert np.abs(x - other[name]).max() < 1e-5


@pytest.mark.long
def test_the_same_inputs_give_the_same_bits(device):
    first, second = states(device), states(device)
    for name in first:
        assert np.array_equal(first[name][0], second[name][0])
        assert np.array_equal(first[name][1], second[name][1])


@pytest.mark.long
def test_every_device_agrees_with_the_cpu(device):
    here, there = states(device, frames=12), states("cpu", frames=12, executor="graph")
    for name in here:
        assert np.abs(here[name][0] - there[name][0]).max() < 3e-5  # roundings of 240 substeps


def functions_in_kernel(features):
    """Names of all functions in the CUDA source generated for `features`, without compiling it."""
    if features.coupled:  # it never runs in a block
        module = graph.make_kernels.__wrapped__(features, 64)["solved"].module
    else:
        module = block.make_frame.__wrapped__(features, 256, 128).module
    source = ModuleBuilder(module, {**module.options, "output_arch": 90}).codegen("cuda")
    return set(re.findall(r"(\w+?)_\d+\(", source.split("cuda_kernel_forward")[0]))


FUNCTIONS = {
    "wind on cloth": "triangle_force",
    "wind on ropes": "segment_force",
    "colliders": "sweep_collider friction_correction",
    "box": "signed_distance_box",
    "capsule": "signed_distance_capsule",
    "plane": "signed_distance_plane",
    "sphere": "signed_distance_sphere",
    "lines": "solve_line_row solve_row",
    "springs": "spring_force force_of_spring",
    "plate": "plate_sum",
    "curved": "curve_triangle rest_curvature",
    "chain": "prepare assemble eliminate judge",
    "leans": "augmented settled",
    "surface": "search press give_way",
    "many colliders": "measure_extent list_colliders",
    "meeting": "keep_apart",  # in no stage: it has launches of its own
    "winch": "next_rate mass_beyond",
    "handles": "hold feel way_of",
    "twist": "carried_across half_binormal push_by_couples",
}
SHEET_AND_BALL = Features(True, False, "triangles", ("sphere",), 2, "xpbd", plate=True, curved=True, surface=True)
ROPE_AND_ROOM = Features(False, True, "segments", ("plane", "box"), 1, "xpbd", surface=True)
HOSE = Features(False, True, "", (), 2, "xpbd", beam=True, twist=True)


@pytest.mark.parametrize(
    ("features", "present"),
    [
        (Features(True, False, "", (), 1, "xpbd"), {"lines"}),
        (Features(True, False, "", (), 1, "xpbd", worlds=True, redoes=True), {"lines"}),
        (Features(True, False, "", (), 2, "xpbd", plate=True), {"lines", "plate"}),
        (Features(True, False, "triangles", (), 1, "xpbd"), {"lines", "wind on cloth"}),
        (Features(False, False, "", (), 1, "verlet"), {"springs"}),
        (Features(False, False, "triangles", ("capsule",), 1, "verlet", plate=True),
         {"springs", "plate", "wind on cloth", "colliders", "capsule"}),
        (Features(False, True, "", (), 2, "xpbd", winch=True), {"chain", "winch"}),
        (Features(True, False, "", ("plane",), 2, "xpbd", coupled=True),
         {"lines", "colliders", "plane"}),
        (Features(True, False, "", ("sphere",), 2, "xpbd", listed=True),
         {"lines", "colliders", "sphere", "many colliders"}),
        (HOSE, {"chain", "twist"}),
        (SHEET_AND_BALL, {"lines", "plate", "curved", "wind on cloth", "colliders", "sphere", "surface"}),
        (Features(False, True, "", ("box",), 2, "xpbd", handles=True),
         {"chain", "leans", "colliders", "box", "handles"}),
        (ROPE_AND_ROOM, {"chain", "leans", "wind on ropes", "colliders", "plane", "box", "surface"}),
    ],
)  # fmt: skip
@pytest.mark.long
def test_a_kernel_holds_what_its_scene_needs_and_nothing_else(features, present):
    found = functions_in_kernel(features)
    for feature, names in FUNCTIONS.items():
        for name in names.split():
            assert any(name in function for function in found) == (feature in present), name


@pytest.mark.long
@pytest.mark.parametrize("features", [SHEET_AND_BALL, HOSE], ids=["sheet", "hose"])
def test_a_frame_of_a_block_compiles_for_cuda(features, tmp_path):
    kernel = block.make_frame.__wrapped__(features, 256, 128)
    wp.compile_aot_module(kernel.module, arch=90, module_dir=tmp_path, use_ptx=True)


@pytest.mark.long
def test_a_frame_of_several_blocks_compiles_for_cuda(tmp_path):
    module = block.make_spread_frame.__wrapped__(SHEET_AND_BALL, 64).module
    wp.compile_aot_module(module, arch=90, module_dir=tmp_path, use_ptx=True)


@pytest.mark.long
def test_the_parts_of_a_winch_that_meets_compile_for_cuda(tmp_path):
    features = Features(False, True, "segments", (), 2, "xpbd", True, winch=True, coupled=True)
    module = graph.make_kernels.__wrapped__(features, 64)["solved"].module
    wp.compile_aot_module(module, arch=90, module_dir=tmp_path, use_ptx=True)
    source = next(tmp_path.glob("*.cu")).read_text()
    assert "next_rate" in source and "half_binormal" not in source


@pytest.mark.parametrize("module", [tension, wrench, report])
def test_what_reads_ropes_compiles_for_cuda(module, tmp_path):
    wp.compile_aot_module(wp.get_module(module.__name__), arch=90, module_dir=tmp_path, use_ptx=True)


def test_two_scenes_without_a_feature_share_one_kernel():
    small, large = (topology.build(Cloth(resolution=(n, n)), "cloth", True) for n in (4, 9))
    without = Features.of(small, False, ())
    assert without != Features.of(small, True, ())
    make_frame = block.make_frame
    assert make_frame(without, 0, 1) is make_frame(Features.of(large, False, ()), 0, 1)


@pytest.mark.long
def test_changing_live_numbers_compiles_nothing(device):
    sim = Simulation(busy_scene(), Settings(method="xpbd", order=2, substeps=20), device=device)
    sim.step()
    before = block.make_frame.cache_info().misses
    for name, value in {
        "cloth.stretch_compliance": 1e-4,
        "cloth.damping": 0.0,
        "rope.bend_compliance": 10.0,
        "ball.static_friction": 0.9,
        "solver.substeps": 11,
        "solver.iterations": 2,
        "gravity": (0, 0, 0),
        "wind.velocity": (0, 0, 0),
    }.items():
        sim.set(name, value)
    sim.step()
    assert block.make_frame.cache_info().misses == before


def test_all_kernels_are_compiled_alike():
    """With other options a process that compiles would read Warp's headers once more, 1.7 s of a core."""
    package = Path(cloth_sim_ros.__file__).parent
    own = [path.name for path in package.rglob("*.py") if "wp.kernel(" in path.read_text()]
    assert own == ["compiled.py"]


def test_the_solver_needs_no_ros():
    code = (
        "import sys; sys.modules['rclpy'] = None; sys.modules['std_msgs'] = None\n"
        "from cloth_sim_ros.sim import *\n"
        "sim = Simulation(Scene(objects={'r': Rope(segments=4)}), device='cpu'); sim.step(); print(sim.time)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip().endswith("0.016666666666666666")
