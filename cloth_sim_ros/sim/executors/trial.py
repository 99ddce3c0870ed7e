# SPDX-License-Identifier: Apache-2.0
"""A frame of explicit steps is a trial: its result is checked, and a bad body repeats the frame.

Explicit steps that are stable at rest may blow up if springs are strained far beyond it. At the end of a frame a body
is rejected if fault recovery put it back, or if a spring is or was strained beyond TOO_STRAINED. Above STRAINED it
is rejected if the strain changed by half since the frame before. It is also rejected there while a collider moves,
which might pass between the particles. The body then goes back to the start of the frame and repeats it by first-order
XPBD, which is stable at any strain. All of this stays on the device; `redone` of ControlState counts the frames.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

import warp as wp

from cloth_sim_ros.sim.arrays.state import Arrays, State
from cloth_sim_ros.sim.features.collider_contact.strain import TOO_STRAINED
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.kernels.device import call_all
from cloth_sim_ros.sim.kernels.intrinsics import load_row, store_row, xyz

STRAINED = wp.constant(0.5)
GROWTH = wp.constant(1.5)  # largest ratio of the largest strains of two frames in a row, either way


@wp.struct
class Start:
    """State of a world when a frame began: positions, what float32 lost of them, velocities (N,), recoveries (B,)."""

    positions: wp.array(dtype=wp.vec4)
    position_lo: wp.array(dtype=wp.vec4)
    velocities: wp.array(dtype=wp.vec4)
    recoveries: wp.array(dtype=int)


@compiled
def keep_start(given: wp.array(dtype=Arrays), starts: wp.array(dtype=Start), particles: int):
    i = wp.tid()
    s, start = given[i / particles].state, starts[i / particles]
    g = i % particles
    store_row(start.positions, g, load_row(s.positions, g))
    store_row(start.position_lo, g, load_row(s.position_lo, g))
    store_row(start.velocities, g, load_row(s.velocities, g))
    if g < s.recoveries.shape[0]:
        start.recoveries[g] = s.recoveries[g]


@compiled
def find_strain(given: wp.array(dtype=Arrays), b: int, first: int, slots: int):
    i = wp.tid()
    m, s = given[i / slots].model, given[i / slots].state
    k = first + i % slots
    if m.line_others[k] < 0:
        return
    p, q = m.bodies[b].particles + m.line_nodes[k], m.bodies[b].particles + m.line_others[k]
    e = xyz(load_row(s.positions, q) - load_row(s.positions, p))
    strain = wp.abs(wp.length(e) / m.line_rests[k] - 1.0)
    if strain > STRAINED:
        wp.atomic_max(s.trial.strains, 2 * b + 1, strain)


@compiled
def judge(given: wp.array(dtype=Arrays), starts: wp.array(dtype=Start), any_rejected: wp.array(dtype=int)):
    i = wp.tid()
    bodies = given[0].model.bodies.shape[0]
    s, start = given[i / bodies].state, starts[i / bodies]
    b = i % bodies
    recovered = s.recoveries[b] != start.recoveries[b]
    last, now = s.trial.strains[2 * b], s.trial.strains[2 * b + 1]
    most, least = wp.max(now, last), wp.min(now, last)
    moves = bool(False)
    for k in range(given[0].colliders.shape[0]):
        c = given[i / bodies].colliders[k]
        turned = wp.length_sq(c.end_orientation - c.start_orientation)
        moves = moves or turned + wp.length_sq(c.end_position - c.start_position) > 0.0
    bad = recovered or most > TOO_STRAINED or (most > STRAINED and (most > GROWTH * least or moves))
    s.trial.rejected[b] = wp.where(bad, 1, 0)
    s.trial.strains[2 * b] = s.trial.strains[2 * b + 1]
    s.trial.strains[2 * b + 1] = 0.0
    if bad:
        s.recoveries[b] = start.recoveries[b]
        s.control.redone[b] += 1
        any_rejected[0] = 1


@compiled
def restore_start(given: wp.array(dtype=Arrays), starts: wp.array(dtype=Start), b: int, particles: int):
    i = wp.tid()
    s, start = given[i / particles].state, starts[i / particles]
    if s.trial.rejected[b] == 0:
        return
    g = given[i / particles].model.bodies[b].particles + i % particles
    store_row(s.positions, g, load_row(start.positions, g))
    store_row(s.position_lo, g, load_row(start.position_lo, g))
    store_row(s.velocities, g, load_row(start.velocities, g))
    if i % particles == 0:
        s.history[b] = 0


@compiled
def remember_strain(given: wp.array(dtype=Arrays)):
    i = wp.tid()
    bodies = given[0].model.bodies.shape[0]
    s = given[i / bodies].state
    b = i % bodies
    if s.trial.rejected[b] == 1:
        s.trial.strains[2 * b] = s.trial.strains[2 * b + 1]
    s.trial.strains[2 * b + 1] = 0.0


class Trial:
    """An executor of explicit steps, with one of XPBD that repeats rejected frames.

    explicit: simulates a frame by explicit steps. make_safe: builds the executor of XPBD, which changes rejected bodies
    alone. worlds: arrays of each world. counts: number of particles of each body. lines: (kind, first, end) of slots
    of every body.
    """

    def __init__(
        self, explicit: Callable[[], None], make_safe: Callable, worlds: list[Arrays], counts: list[int], lines: list
    ) -> None:
        self.explicit, self._make_safe = explicit, make_safe
        self._device = worlds[0].state.positions.device
        self._given = wp.array(worlds, dtype=Arrays, device=self._device)
        self._worlds = len(worlds)
        self._any = wp.zeros(1, dtype=int, device=self._device)
        self._safe = None  # on a CPU it is compiled when it is needed, or earlier by `make_ready`
        self._lock = threading.Lock()
        if not self._device.is_cpu:
            self.make_ready()
        self._starts = [_start_of(world.state) for world in worlds]  # their arrays live as long
        starts = wp.array(self._starts, dtype=Start, device=self._device)
        self._before = [self._launch(keep_start, sum(counts), starts, sum(counts))]
        self._measure = [
            self._launch(find_strain, end - first, b, first, end - first)
            for b, spans in enumerate(lines)
            for _, first, end in spans
        ]
        self._judge = self._launch(judge, len(counts), starts, self._any)
        self._remember = self._launch(remember_strain, len(counts))
        self._restore = [self._launch(restore_start, count, starts, b, count) for b, count in enumerate(counts)]

    def _launch(self, kernel: wp.Kernel, size: int, *more) -> Callable[[], None]:
        inputs = [self._given, *more]
        return wp.launch(kernel, dim=self._worlds * size, inputs=inputs, device=self._device, record_cmd=True).launch

    def make_ready(self) -> None:
        """Build and compile the executor of XPBD, in any thread, if that is not done yet."""
        with self._lock:
            self._safe = self._safe or self._make_safe()

    def advance(self) -> None:
        """Simulate one frame, and repeat it where it is rejected."""
        call_all(self._before)
        self.explicit()
        call_all([*self._measure, self._judge])
        wp.capture_if(self._any, on_true=self._redo)

    def _redo(self) -> None:
        self._any.zero_()
        self.make_ready()
        call_all(self._restore)
        self._safe.advance()
        call_all([*self._measure, self._remember])


def _start_of(state: State) -> Start:
    """Arrays of the size of a world's state."""
    start = Start()
    for name in Start.vars:
        setattr(start, name, wp.empty_like(getattr(state, name)))
    return start
