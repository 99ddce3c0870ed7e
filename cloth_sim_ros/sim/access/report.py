# SPDX-License-Identifier: Apache-2.0
"""Measures of a body: energy, strain, penetration and the solver's residual, reduced on the device."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import warp as wp

from cloth_sim_ros.sim.arrays.state import Arrays
from cloth_sim_ros.sim.colliders import make_is_beyond, make_signed_distance
from cloth_sim_ros.sim.engine.batch import Batch
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.kernels.intrinsics import load_row, xyz
from cloth_sim_ros.sim.physics.integrate import effective_step

# Rows of the result. Maxima do not depend on the order of atomics; the energy is summed on the host in one order.
STRAIN, RESIDUAL, PARTICLES, SURFACE = 0, 1, 2, 3
SPREAD = 6  # steps along each edge of the grid of points at which penetration is sampled


@compiled
def measure_lines(
    arrays: Arrays, b: int, first: int, kind: int, second: bool, implicit: bool, result: wp.array(dtype=float)
):
    k = first + wp.tid()
    m = arrays.model
    if m.line_rests[k] < 0.0:
        return
    body = m.bodies[b]
    h = effective_step(arrays.frames[0].length / float(wp.max(1, arrays.state.control.taken[b])), second)
    force = arrays.state.lines.line_multipliers[k] / (h * h)
    i, j = body.particles + m.line_nodes[k], body.particles + m.line_others[k]
    held = m.line_scales[k] * arrays.materials[b].compliance[kind] * force
    if arrays.state.lines.line_lengths.shape[0] > 0:
        held += m.line_rests[k] - arrays.state.lines.line_lengths[k]
    _measure(arrays, b, wp.vec2i(i, j), m.line_rests[k], 0.0, held, implicit, result)


@compiled
def measure_chain(arrays: Arrays, b: int, result: wp.array(dtype=float)):
    body = arrays.model.bodies[b]
    k = body.segments + wp.tid()
    i = body.particles + wp.tid()
    rest = arrays.model.segment_length[k]
    feed = float(0.0)
    if arrays.state.winch.winches.shape[0] > 0:
        winch = arrays.state.winch.winches[b]
        if wp.tid() < winch.index:
            return
        if wp.tid() == winch.index:
            rest = winch.length
            feed = winch.rate
    sag = -rest * arrays.materials[b].compliance[0] * arrays.state.rope.tensions[k]
    _measure(arrays, b, wp.vec2i(i, i + 1), rest, feed, sag, True, result)


@wp.func
def _measure(
    arrays: Arrays,
    b: int,
    ends: wp.vec2i,
    rest: float,
    feed: float,
    held: float,
    implicit: bool,
    result: wp.array(dtype=float),
):
    """Measure strain, and the violation of C + gamma slip + compliance x multiplier = 0 with `held` as last term [m].

    A segment fed at the rate `feed` [m/s] lengthens at that rate without strain.
    """
    i, j = ends[0], ends[1]
    high = arrays.state.positions[j] - arrays.state.positions[i]
    e = xyz(high) + xyz(arrays.state.position_lo[j] - arrays.state.position_lo[i])
    length = wp.length(e)
    n = e / wp.max(length, 1.0e-12)
    rate = wp.dot(n, xyz(arrays.state.velocities[j] - arrays.state.velocities[i]))
    rate -= feed * length / wp.max(rest, 1.0e-12)
    wp.atomic_max(result, STRAIN, wp.abs(length - rest) / wp.max(rest, 1.0e-12))
    if implicit:
        damping = arrays.materials[b].damping * arrays.model.bodies[b].line_damping
        wp.atomic_max(result, RESIDUAL, wp.abs(length - rest + damping * rate + held))


@lru_cache
def make_measure_contacts(shapes: tuple[str, ...]):
    """Make the kernel that finds the deepest penetration into colliders of `shapes` at the end of the frame.

    It measures particles, and points spread evenly over every triangle or rope segment without a pinned particle.
    """
    signed_distance, is_beyond = make_signed_distance(shapes), make_is_beyond(shapes)

    @wp.func
    def depth(point: wp.vec3, arrays: Arrays, b: int) -> float:
        deepest = float(0.0)
        for c in range(arrays.colliders.shape[0]):
            collider = arrays.colliders[c]
            p = wp.quat_rotate_inv(collider.end_orientation, point - collider.end_position)
            if wp.static(is_beyond is not None):
                if is_beyond(collider.shape, p, arrays.materials[b].thickness, collider.data):
                    continue
            gap = signed_distance(collider.shape, p, collider.size, collider.data)[3] - arrays.materials[b].thickness
            deepest = wp.max(deepest, -gap)
        return deepest

    @compiled(module="unique")
    def measure_contacts(arrays: Arrays, b: int, result: wp.array(dtype=float)):
        body = arrays.model.bodies[b]
        corners = arrays.model.panels[body.panels + wp.tid()]
        is_segment = corners[2] < 0
        if is_segment:
            corners[2] = corners[1]
        pinned = bool(False)
        for k in range(3):
            row = load_row(arrays.state.positions, body.particles + corners[k])
            pinned = pinned or row[3] == 0.0
            if row[3] > 0.0:
                wp.atomic_max(result, PARTICLES, depth(xyz(row), arrays, b))
        if pinned:
            return
        first = xyz(load_row(arrays.state.positions, body.particles + corners[0]))
        second = xyz(load_row(arrays.state.positions, body.particles + corners[1]))
        third = xyz(load_row(arrays.state.positions, body.particles + corners[2]))
        for u in range(wp.where(is_segment, 1, wp.static(SPREAD + 1))):
            for v in range(wp.static(SPREAD + 1) - u):
                s, t = float(v) / wp.static(float(SPREAD)), float(u) / wp.static(float(SPREAD))
                point = (1.0 - s - t) * first + s * second + t * third
                wp.atomic_max(result, SURFACE, depth(point, arrays, b))

    return measure_contacts


def measure_object(batch: Batch, name: str, world: int) -> dict[str, float]:
    """Return the part of Simulation.report that every object has, for one object."""
    b, span, arrays = batch.index[name], batch.span(name), batch.worlds[world]
    result = wp.zeros(4, dtype=float, device=batch.device)
    second, implicit = batch.features.order == 2, batch.features.method == "xpbd"
    for kind, first, end in batch.lines[b]:
        inputs = [arrays, b, first, kind, second, implicit, result]
        wp.launch(measure_lines, dim=end - first, inputs=inputs, device=batch.device)
    if batch.features.chain:
        segments = span.stop - span.start - 1
        wp.launch(measure_chain, dim=segments, inputs=[arrays, b, result], device=batch.device)
    if batch.features.shapes:
        kernel, panels = make_measure_contacts(batch.features.shapes), batch.panels(name)
        wp.launch(kernel, dim=panels.stop - panels.start, inputs=[arrays, b, result], device=batch.device)
    velocities = arrays.state.velocities[span].numpy()[:, :3].astype(np.float64)
    inverse = arrays.state.positions[span].numpy()[:, 3].astype(np.float64)
    moving = inverse > 0.0
    energy = 0.5 * float(((velocities[moving] ** 2).sum(1) / inverse[moving]).sum())
    found = result.numpy()
    recoveries = int(arrays.state.recoveries[b : b + 1].numpy()[0])
    return {
        "kinetic_energy": energy,
        **_elastic(batch, b, world, energy),
        "max_strain": float(found[STRAIN]),
        "max_penetration": float(max(found[PARTICLES], found[SURFACE])),
        "particle_penetration": float(found[PARTICLES]),
        "contacts": _contacts(arrays, span),
        "residual": float(found[RESIDUAL]),
        **({"torn": batch.torn.count(b, world)} if batch.torn is not None else {}),
        "recoveries": recoveries,
        "redone": int(arrays.state.control.redone[b : b + 1].numpy()[0]),
        "substeps": batch.substeps(b, world),
        **_errors(batch, b, world),
        "iterations": batch.frame.iterations,
    }


def _elastic(batch: Batch, b: int, world: int, kinetic: float) -> dict[str, float]:
    """Return the elastic energy of body b, if it is found."""
    if batch.ledger is None:
        return {}
    batch.ledger.open()  # what was written since the last frame changes it
    _, _, whole, weight = batch.states["ledgers"].numpy()[world, b]
    return {"elastic_energy": float(whole - weight) - kinetic}


def _errors(batch: Batch, b: int, world: int) -> dict[str, float]:
    """Return the measured errors of body b, if they are measured."""
    if batch.measurement is None:
        return {}
    frame, share = batch.error(b, world)
    return {"error_per_frame": frame, "expected_error": share}


def _contacts(arrays: Arrays, span: slice) -> int:
    """Number of contacts in the last frame: each particle counts once per collider that pushed it."""
    colliders = arrays.colliders.shape[0]
    if not colliders:
        return 0
    forces = arrays.state.contact.contact_forces[span.start * colliders : span.stop * colliders].numpy()
    return int(np.count_nonzero(forces[:, :3].any(axis=1)))
