# SPDX-License-Identifier: Apache-2.0
"""The direct solve along chains: spans join to what the ladder finds, and wild starts recover under any load."""

import itertools

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from cloth_sim_ros.sim import Rope, Scene, Settings, Simulation
from cloth_sim_ros.sim.physics.chain import (
    Span,
    edge_frame,
    join,
    particle_compliance,
    series_admittance,
    span_of,
    turn_frame,
    turned_end,
)
from cloth_sim_ros.sim.ropes.arrays import Segment
from cloth_sim_ros.sim.ropes.segments import forward

SEGMENTS = 16
LENGTH = 1.0 / SEGMENTS


@wp.kernel(enable_backward=False)
def walk(segments: wp.array(dtype=Segment), w0: float, found: wp.array(dtype=wp.mat33), moved: wp.array(dtype=wp.vec3)):
    """One thread along the ladder."""
    y = wp.identity(n=3, dtype=float) * w0
    q = wp.vec3(0.0)
    old = segments[0].frame
    for k in range(segments.shape[0]):
        y = turn_frame(y, old, segments[k].frame)
        segment, y, q, pull = forward(segments[k], y, q)
        old = segments[k].frame
    found[0] = y
    moved[0] = old * q


@wp.kernel(enable_backward=False)
def fold(segments: wp.array(dtype=Segment), w0: float, spans: wp.array(dtype=Span)):
    """The same, joining neighbours pairwise until one span is left."""
    for k in range(segments.shape[0]):
        s = segments[k]
        spans[k] = span_of(s.far, s.along, s.across, s.tension, s.gap, s.missing)
    start = Span()
    start.compliance = wp.identity(n=3, dtype=float) * w0
    spans[0] = join(start, spans[0])
    width = int(1)  # noqa: UP018 - a variable of the kernel
    while width < segments.shape[0]:
        for i in range(0, segments.shape[0], 2 * width):
            turn = segments[i + width].frame * wp.transpose(segments[i + width - 1].frame)
            spans[i] = join(turned_end(spans[i], turn), spans[i + width])
        width *= 2


@wp.kernel(enable_backward=False)
def frames_along(normals: wp.array(dtype=wp.vec3), frames: wp.array(dtype=wp.mat33)):
    frames[wp.tid()] = edge_frame(normals[wp.tid()])


@wp.kernel(enable_backward=False)
def invert(
    y: wp.array(dtype=wp.mat33),
    numbers: wp.array(dtype=wp.vec3),
    edges: wp.array(dtype=wp.mat33),
    particles: wp.array(dtype=wp.mat33),
):
    i = wp.tid()
    edges[i] = series_admittance(y[i], numbers[i][0], numbers[i][1])
    particles[i] = particle_compliance(numbers[i][2], edges[i])


def inverses(matrices):
    """In float64, of unit diagonals."""
    scale = 1.0 / np.sqrt(np.einsum("nii->ni", matrices))
    both = scale[:, :, None] * scale[:, None, :]
    return np.linalg.inv(matrices * both) * both


@pytest.mark.parametrize(("along", "angle"), [(1e-7, 1e-6), (1e-3, 1e-3), (1.0, 3.0)])
def test_inverses_keep_their_digits_over_ten_orders_of_magnitude(along, angle):
    """Error against float64, of each entry beside the diagonal ones in its row and column."""
    random, count = np.random.default_rng(2), 2000
    directions = random.standard_normal((count, 3))
    frames = Rotation.from_rotvec(angle * directions / np.linalg.norm(directions, axis=1, keepdims=True)).as_matrix()
    yields = np.column_stack([along * 10.0 ** random.uniform(0, 2, count), 10.0 ** random.uniform(-1, 2, (count, 2))])
    y = (np.einsum("nij,nj,nkj->nik", frames, yields, frames)).astype(np.float32)
    stiff = 10.0 ** random.uniform(-9, 2, count)
    stiff[::10] = 0.0
    numbers = np.column_stack([np.full(count, along), stiff, 10.0 ** random.uniform(-4, 2.5, count)]).astype(np.float32)
    edges, particles = (wp.zeros(count, dtype=wp.mat33, device="cpu") for _ in range(2))
    given = [wp.array(y, dtype=wp.mat33, device="cpu"), wp.array(numbers, dtype=wp.vec3, device="cpu")]
    wp.launch(invert, count, [*given, edges, particles], device="cpu")
    numbers = numbers.astype(float)
    across = 1.0 / np.maximum(numbers[:, 1], 1e-30)
    springs = np.column_stack([numbers[:, 0], across, across])[:, :, None] * np.eye(3)
    found = edges.numpy().astype(float)
    masses = np.eye(3) / numbers[:, 2, None, None]
    for result, expected in (
        (found, inverses(y.astype(float) + springs)),
        (particles.numpy().astype(float), inverses(found + masses)),
    ):
        size = np.sqrt(np.einsum("nii->ni", expected))
        error = np.abs(result - expected) / (size[:, :, None] * size[:, None, :])
        assert np.median(error.max((1, 2))) < 2e-7
        assert error.max() < 1e-5 * (1.0 if along < 1.0 else 10.0)


@pytest.mark.parametrize("load", [1.0, 1e5])
@pytest.mark.parametrize("along", [1e-7, 1.0])
@pytest.mark.parametrize("pinned", [True, False])
def test_joined_spans_are_the_ladder(load, along, pinned):
    random = np.random.default_rng(3)
    normals = np.array([1.0, 0.0, 0.0]) + 0.3 * random.standard_normal((SEGMENTS, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    frames = wp.zeros(SEGMENTS, dtype=wp.mat33, device="cpu")
    wp.launch(frames_along, SEGMENTS, inputs=[wp.array(normals, dtype=wp.vec3, device="cpu"), frames], device="cpu")
    rows = np.zeros(SEGMENTS, dtype=Segment.numpy_dtype())
    rows["frame"] = frames.numpy()
    rows["near"], rows["far"], rows["along"] = 160.0, 160.0, along
    rows["far"][-1] = 160.0 / load
    rows["across"] = random.uniform(0.0, 1e-2, SEGMENTS) * np.sqrt(load)
    rows["tension"] = random.uniform(0.0, 1e-4, SEGMENTS) * load
    rows["gap"] = 1e-3 * random.standard_normal(SEGMENTS)
    rows["missing"] = 1e-4 * random.standard_normal((SEGMENTS, 3))
    w0 = 0.0 if pinned else 160.0
    rows["near"][0] = w0
    segments = wp.array(rows, dtype=Segment, device="cpu")
    compliance, moved = wp.zeros(1, dtype=wp.mat33, device="cpu"), wp.zeros(1, dtype=wp.vec3, device="cpu")
    spans = wp.zeros(SEGMENTS, dtype=Span, device="cpu")
    wp.launch(walk, 1, inputs=[segments, w0, compliance, moved], device="cpu")
    wp.launch(fold, 1, inputs=[segments, w0, spans], device="cpu")
    result = spans.numpy()[0]
    size = np.abs(compliance.numpy()[0]).max()
    assert result["compliance"] == pytest.approx(compliance.numpy()[0], rel=2e-3, abs=2e-3 * float(size))
    assert result["free"] == pytest.approx(moved.numpy()[0], rel=2e-3, abs=2e-3 * float(np.abs(moved.numpy()).max()))


def heavy_rope(load, compliance):
    """A rope of 1 m and 0.2 kg with `load` times its mass at its end."""
    masses = np.full(SEGMENTS + 1, 0.2 / SEGMENTS)
    masses[[0, -1]] *= 0.5
    masses[-1] += 0.2 * load
    return Rope(
        start=(0, 0, 0), end=(1, 0, 0), segments=SEGMENTS, particle_masses=masses, stretch_compliance=compliance
    )


def wild(name, rest, seed):
    """A start that no rope has."""
    random = np.random.default_rng(seed)
    starts = {
        "let go": rest,
        "random": random.uniform(-0.5, 0.5, rest.shape),
        "stretched": 10.0 * rest,
        "collapsed": 1e-6 * rest,
        "point": 0.0 * rest,
        "mirrored": -rest,
    }
    start = starts[name].copy()
    start[0] = 0.0
    return start


@pytest.mark.parametrize("name", ["let go", "random", "stretched", "collapsed", "point", "mirrored"])
@pytest.mark.parametrize("load", [1.0, 1e2, 1e5])
def test_rigid_ropes_recover_from_any_start(device, load, name):
    for order, (substeps, iterations) in itertools.product((1, 2), ((8, 1), (20, 1), (40, 2))):
        settings = Settings(method="xpbd", order=order, substeps=substeps, iterations=iterations)
        sim = Simulation(Scene(objects={"it": heavy_rope(load, 0.0)}), settings, device=device)
        sim.set_positions("it", wild(name, sim.rest_positions("it").astype(float), seed=int(load)))
        sim.step(120)
        lengths = np.linalg.norm(np.diff(sim.positions("it").astype(float), axis=0), axis=1)
        assert lengths == pytest.approx(np.full(SEGMENTS, LENGTH), rel=0.02), (order, substeps)
        assert sim.report()["it"]["recoveries"] == 0


@pytest.mark.parametrize("name", ["random", "stretched", "collapsed", "mirrored"])
@pytest.mark.parametrize("load", [1.0, 1e2, 1e5])
def test_wild_starts_never_gain_energy(device, load, name):
    compliance = 1e-4
    for order in (1, 2):
        rope = heavy_rope(load, compliance)
        sim = Simulation(Scene(objects={"it": rope}), Settings(method="xpbd", order=order, substeps=20), device=device)
        masses = sim.masses("it")

        def energy(positions, speeds, masses=masses):
            lengths = np.linalg.norm(np.diff(positions, axis=0), axis=1)
            stored = 0.5 / compliance * ((lengths - LENGTH) ** 2 / LENGTH).sum()
            return 0.5 * (masses * (speeds**2).sum(1)).sum() + 9.81 * (masses * positions[:, 2]).sum() + stored

        start = wild(name, sim.rest_positions("it").astype(float), seed=5)
        sim.set_positions("it", start)
        at_start = energy(start, np.zeros_like(start))
        allowed = at_start + 0.01 * (abs(at_start) + 9.81 * masses.sum())
        for _ in range(60):
            sim.step()
            assert energy(sim.positions("it").astype(float), sim.velocities("it").astype(float)) < allowed


@pytest.mark.parametrize(("substeps", "load"), [(1, 1.0), (1, 10.0), (5, 1e3), (20, 1e5), (80, 1e5)])
def test_a_load_on_a_rigid_rope_swings_without_gain_in_one_iteration(device, substeps, load):
    """The light particles turn far under it in a substep: what a linear solve leaves of that must not jerk the load.

    Nor must a micrometre by which the start is not straight, beside which the rounding of any device is small.
    """
    segments = 24
    masses = np.full(segments + 1, 0.2 / segments)
    masses[-1] += 0.2 * load
    rope = Rope(
        start=(0, 0, 0), end=(0.7, 0, -0.7), segments=segments, particle_masses=masses, pins=(0,), stretch_compliance=0
    )
    for order in (1, 2):
        sim = Simulation(
            Scene(objects={"it": rope}), Settings(method="xpbd", order=order, substeps=substeps), device=device
        )
        crooked = np.random.default_rng(1).normal(0.0, 1e-6, (segments + 1, 3)) * (np.arange(segments + 1) > 0)[:, None]
        sim.set_positions("it", sim.positions("it") + crooked)
        start = (masses * sim.positions("it")[:, 2]).sum()
        for _ in range(60):
            sim.step()
            speeds, heights = sim.velocities("it").astype(float), sim.positions("it")[:, 2]
            energy = 0.5 * (masses * (speeds**2).sum(1)).sum() + 9.81 * ((masses * heights).sum() - start)
            assert energy < 1e-3 * 9.81 * masses.sum(), order
            lengths = np.linalg.norm(np.diff(sim.positions("it"), axis=0), axis=1)
            assert lengths == pytest.approx(np.full(segments, 0.7 * 2**0.5 / segments), rel=0.05), order
