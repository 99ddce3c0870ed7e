# SPDX-License-Identifier: Apache-2.0
"""What the threads of a scan do along a chain from both its ends: each part alone, on the CPU, and whole ropes."""

import numpy as np
import pytest
import warp as wp

from cloth_sim_ros.sim import Rope, Scene, Settings, Simulation
from cloth_sim_ros.sim.kernels.intrinsics import array_address
from cloth_sim_ros.sim.physics.chain import Span, close, edge_frame, join, turn_frame
from cloth_sim_ros.sim.ropes.arrays import Segment
from cloth_sim_ros.sim.ropes.partition import Reach, Share, reach_of
from cloth_sim_ros.sim.ropes.scan import make_scans, scan_size
from cloth_sim_ros.sim.ropes.segments import change_of, forward

SEGMENTS = 16
HALF = SEGMENTS // 2

_, meet, _ = make_scans(2, False)


@wp.kernel(enable_backward=False)
def join_both_ways(spans: wp.array(dtype=Span), start: wp.mat33, free: wp.vec3, found: wp.array(dtype=Span)):
    """Behind an end of a chain, a span as one that others might still join, and as one that nothing moves."""
    first = Span()
    first.compliance = start
    first.free = free
    found[0] = join(first, spans[0])
    found[1] = close(first, spans[0])


@wp.kernel(enable_backward=False)
def frames_along(normals: wp.array(dtype=wp.vec3), frames: wp.array(dtype=wp.mat33)):
    frames[wp.tid()] = edge_frame(normals[wp.tid()])


@wp.kernel(enable_backward=False)
def meet_halfway(
    segments: wp.array2d(dtype=Segment),
    w: wp.vec2,
    starts: wp.array(dtype=wp.vec3),
    shared: wp.array(dtype=wp.vec4),
    moved: wp.array(dtype=wp.vec3),
):
    """Two threads one after the other, each from its end of the chain; the second finds what both have shown."""
    for side in range(2):
        y = wp.identity(n=3, dtype=float) * w[side]
        q = starts[side]
        segment = segments[side, 0]
        pull = wp.vec3(0.0)
        for k in range(segments.shape[1]):
            y = turn_frame(y, segment.frame, segments[side, k].frame)
            segment, y, q, pull = forward(segments[side, k], y, q)
        share = Share()
        share.way = 1 - 2 * side
        share.lanes = 1
        share.coupled = True
        moved[0] = meet(share, segment, pull, array_address(shared, 0))


@wp.kernel(enable_backward=False)
def hand_back(segments: wp.array(dtype=Segment), pulls: wp.array(dtype=wp.vec3), tensions: wp.array(dtype=float)):
    """From a pinned start to a free end, and what reaches back from there, joined before it is told from what."""
    y = wp.mat33(0.0)
    q = wp.vec3(0.0)
    count = segments.shape[0]
    for k in range(count):
        y = turn_frame(y, segments[wp.max(k - 1, 0)].frame, segments[k].frame)
        segment, y, q, pull = forward(segments[k], y, q)
        segments[k] = segment
        pulls[k] = pull
    last = segments[count - 1]
    force = wp.transpose(last.frame) * (change_of(last, q) + wp.vec3(last.tension, 0.0, 0.0))
    tensions[count - 1] = wp.dot(last.frame[0], force)
    reach = Reach()
    reach.passed = wp.identity(n=3, dtype=float)
    for r in range(1, count):
        k = count - 1 - r
        one = reach_of(segments[k], pulls[k])
        reach.force = one.passed * reach.force + one.force
        reach.passed = one.passed * reach.passed
        tensions[k] = wp.dot(segments[k].frame[0], reach.passed * force + reach.force)


def frames_of(normals):
    frames = wp.zeros(len(normals), dtype=wp.mat33, device="cpu")
    wp.launch(frames_along, len(normals), [wp.array(normals, dtype=wp.vec3, device="cpu"), frames], device="cpu")
    return frames.numpy()


def dense(rows, w, missing):
    """The displacements (N, 3) [m] that one Newton step finds, in float64."""
    matrix, right = np.zeros(2 * (3 * len(w),)), np.zeros(3 * len(w))
    for k in range(len(w)):
        here = slice(3 * k, 3 * k + 3)
        mass = 1.0 / w[k] if w[k] > 0.0 else 1e30
        matrix[here, here] += mass * np.eye(3)
        right[here] += (mass * missing[k]) * (w[k] > 0.0)
    for k, row in enumerate(rows):
        frame = row["frame"].astype(float)
        stiffness = frame.T @ np.diag([1.0 / float(row["along"]), row["across"], row["across"]]) @ frame
        pull = frame[0] * (row["gap"] / float(row["along"]) + row["tension"])
        i, j = slice(3 * k, 3 * k + 3), slice(3 * k + 3, 3 * k + 6)
        matrix[i, i] += stiffness
        matrix[j, j] += stiffness
        matrix[i, j] -= stiffness
        matrix[j, i] -= stiffness
        right[i] += pull
        right[j] -= pull
    return np.linalg.solve(matrix, right).reshape(-1, 3)


@pytest.mark.parametrize(
    ("load", "along", "allowed"), [(1.0, 1e-7, 1e-5), (1.0, 1.0, 1e-5), (1e5, 1.0, 1e-5), (1e5, 1e-7, 0.05)]
)
@pytest.mark.parametrize("pinned", [True, False])
def test_two_sides_meet_where_the_particle_between_them_moves(load, along, allowed, pinned):
    random = np.random.default_rng(4)
    normals = np.array([1.0, 0.0, 0.0]) + 0.3 * random.standard_normal((SEGMENTS, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    w = np.full(SEGMENTS + 1, 160.0)
    w[0] *= not pinned
    w[-1] /= load
    missing = 1e-4 * random.standard_normal((SEGMENTS + 1, 3))
    rows = np.zeros(SEGMENTS, dtype=Segment.numpy_dtype())
    rows["frame"], rows["along"] = frames_of(normals), along
    rows["near"], rows["far"] = w[:-1], w[1:]
    rows["across"] = random.uniform(0.0, 1e-2, SEGMENTS) * np.sqrt(load)
    rows["tension"] = random.uniform(0.0, 1e-4, SEGMENTS) * load
    rows["gap"] = 1e-3 * random.standard_normal(SEGMENTS)
    rows["missing"] = np.einsum("kij,kj->ki", rows["frame"], missing[1:])
    back = rows[::-1][:HALF].copy()
    back["frame"] = frames_of(-normals[::-1][:HALF])
    back["near"], back["far"] = rows["far"][::-1][:HALF], rows["near"][::-1][:HALF]
    back["missing"] = np.einsum("kij,kj->ki", back["frame"], missing[:-1][::-1][:HALF])
    back["missing"][-1] = 0.0  # of the particle that is the other side's
    both = wp.array(np.stack((rows[:HALF], back)), dtype=Segment, device="cpu")
    starts = wp.array(missing[[0, -1]] * (w[[0, -1]] > 0.0)[:, None], dtype=wp.vec3, device="cpu")
    shared = wp.zeros(scan_size(2), dtype=wp.vec4, device="cpu")
    moved = wp.zeros(1, dtype=wp.vec3, device="cpu")
    wp.launch(meet_halfway, 1, [both, wp.vec2(w[0], w[-1]), starts, shared, moved], device="cpu")
    expected = dense(rows, w, missing)[HALF]
    assert moved.numpy()[0] == pytest.approx(expected, rel=allowed, abs=allowed * np.abs(expected).max())


@pytest.mark.parametrize(("load", "along"), [(1.0, 1.0), (1e5, 1.0), (1e5, 1e-7)])
@pytest.mark.parametrize("held", [0, 5])
def test_what_reaches_back_is_the_tension(load, along, held):
    """Nearly straight and rigid, what a segment yields along itself is 1e-8 of what it yields across."""
    random = np.random.default_rng(6)
    normals = np.array([1.0, 0.0, 0.0]) + 3e-3 * random.standard_normal((SEGMENTS, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    w = np.full(SEGMENTS + 1, 160.0)
    w[[0, held]] = 0.0
    w[-1] = 160.0 / load
    missing = 1e-5 * random.standard_normal((SEGMENTS + 1, 3)) * (w > 0.0)[:, None]
    rows = np.zeros(SEGMENTS, dtype=Segment.numpy_dtype())
    rows["frame"], rows["along"] = frames_of(normals), along
    rows["near"], rows["far"] = w[:-1], w[1:]
    rows["tension"] = 1e-8 * load * random.uniform(0.9, 1.1, SEGMENTS)
    rows["across"] = rows["tension"] * SEGMENTS
    rows["gap"] = 1e-7 * random.standard_normal(SEGMENTS)
    rows["missing"] = np.einsum("kij,kj->ki", rows["frame"], missing[1:])
    u = dense(rows, w, missing)
    stretch = np.einsum("ki,ki->k", rows["frame"][:, 0].astype(float), np.diff(u, axis=0)) + rows["gap"]
    expected = rows["tension"] + stretch / rows["along"].astype(float)
    segments = wp.array(rows, dtype=Segment, device="cpu")
    pulls, found = wp.zeros(SEGMENTS, dtype=wp.vec3, device="cpu"), wp.zeros(SEGMENTS, dtype=float, device="cpu")
    wp.launch(hand_back, 1, [segments, pulls, found], device="cpu")
    assert found.numpy() == pytest.approx(expected, rel=0.0, abs=3e-4 * np.abs(expected).max())


def test_what_nothing_moves_is_joined_in_less():
    random = np.random.default_rng(5)
    a, c, j, y = random.standard_normal((4, 3, 3))
    span = np.zeros(1, dtype=Span.numpy_dtype())
    span["passed"], span["compliance"], span["inertia"] = a, c @ c.T, j @ j.T
    span["free"], span["pull"] = random.standard_normal((2, 1, 3))
    found = wp.zeros(2, dtype=Span, device="cpu")
    spans = wp.array(span, dtype=Span, device="cpu")
    start = wp.mat33(*(y @ y.T).astype(np.float32).ravel().tolist())
    free = random.standard_normal(3)
    wp.launch(join_both_ways, 1, [spans, start, wp.vec3(*free.tolist()), found], device="cpu")
    # Where the first span moves by d and the second pulls it, (1 + Y J) d = b + Y eta.
    d = np.linalg.solve(np.eye(3) + y @ y.T @ j @ j.T, free + y @ y.T @ span["pull"][0])
    held = np.linalg.solve(np.linalg.inv(y @ y.T) + j @ j.T, a.T)
    for result in found.numpy():
        assert result["free"] == pytest.approx(span["free"][0] + a @ d, rel=1e-4, abs=1e-4)
        assert result["compliance"] == pytest.approx(c @ c.T + a @ held, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("order", [1, 2])
def test_rigid_segments_between_held_particles_stay(device, order):
    pins = (0, 1, 5, 6)
    rope = Rope(start=(0, 0, 0), end=(1, 0, 0), segments=6, pins=pins, stretch_compliance=0.0)
    sim = Simulation(Scene(objects={"it": rope}), Settings(method="xpbd", order=order, substeps=8), device=device)
    start = sim.positions("it")
    sim.step(60)
    end = sim.positions("it")
    assert np.array_equal(end[list(pins)], start[list(pins)])
    lengths = np.linalg.norm(np.diff(end.astype(float), axis=0), axis=1)
    assert lengths == pytest.approx(np.full(6, 1 / 6), rel=1e-3)
