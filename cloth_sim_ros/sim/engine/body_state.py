# SPDX-License-Identifier: Apache-2.0
"""The state that a body keeps when the device arrays are rebuilt around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cloth_sim_ros.sim.engine.batch import Batch
from cloth_sim_ros.sim.engine.state_arrays import rows_by_array

_PAST = ("last_displacements", "last_velocities")
# Array -> kind of its rows: "particle", "count" (a number a body), "body" (a struct a body), "segment" or "stitch".
_KEPT = {
    **dict.fromkeys(("positions", "position_lo", "good_positions", "velocities", *_PAST), "particle"),
    **dict.fromkeys(("recoveries", "history"), "count"),
    **rows_by_array("KEPT"),
}


@dataclass(frozen=True)
class BodyState:
    """One body in all worlds.

    order: of its history. particles: rows (worlds, N, 4). counts: (worlds, 1). live: rows (worlds,) of the live arrays.
    kg: mass and end mass (worlds, 2). bodies: rows (worlds, 1) of WinchState and Twist, if it has any. parts: rows
    (worlds, S) of a rope's segments, and (worlds, Z) of stitches of the seams that it is first in. torn: see
    Torn.read; None if it does not tear.
    """

    order: int
    particles: dict[str, np.ndarray]
    counts: dict[str, np.ndarray]
    live: list[np.ndarray]
    kg: np.ndarray
    bodies: dict[str, np.ndarray]
    parts: dict[str, np.ndarray]
    torn: dict[str, np.ndarray] | None


def take(batch: Batch, name: str) -> BodyState:
    """Copy all state of a body that outlives its arrays."""
    span, b = batch.span(name), batch.index[name]
    rows = ("particle", "count", "body", "segment", "stitch")
    has = {row: [a for a in _KEPT if _KEPT[a] == row and batch.states[a].size] for row in rows}
    particles = {array: batch.part(array, span, None).numpy() for array in has["particle"]}
    counts = {array: batch.part(array, slice(b, b + 1), None).numpy() for array in has["count"]}
    live = [rows.read(b, None) for rows in batch.live]
    bodies = {array: batch.read_body(array, name, None) for array in has["body"]}
    spans = _spans(batch, name)
    parts = {a: batch.part(a, spans[row], None).numpy() for row in spans for a in has[row]}
    kg, torn = batch.masses.read(b, None), batch.torn and batch.torn.read(b)
    return BodyState(batch.features.order, particles, counts, live, kg, bodies, parts, torn)


def give(batch: Batch, name: str, kept: BodyState) -> None:
    """Write the state that another batch had of a body, whose pins may have changed.

    Multipliers start from zero. History is dropped if the order changed.
    """
    span, b = batch.span(name), batch.index[name]
    follows, pinned = kept.order == batch.features.order, batch.masses.of_pinned(b)
    batch.masses.write(b, None, kept.kg)
    inverse_mass = batch.masses.inverse[:, span].numpy()
    for array, rows in kept.particles.items():
        if array in _PAST and not follows:
            continue
        if not batch.features.winch:  # a winch itself pins the particles on its drum
            rows = rows.copy()
            if array in ("positions", "good_positions"):
                rows[..., 3] = inverse_mass
            elif array in ("velocities", *_PAST):
                rows[:, pinned] = 0.0
        batch.part(array, span, None).assign(rows)
    for array, rows in kept.counts.items():
        if array != "history" or follows:
            batch.part(array, slice(b, b + 1), None).assign(rows)
    for rows, held in zip(batch.live, kept.live, strict=True):
        rows.edit()[:, b] = held
    for array, held in kept.bodies.items():
        batch.write_body(array, name, held)
    spans = _spans(batch, name)
    for array, rows in kept.parts.items():
        batch.part(array, spans[_KEPT[array]], None).assign(rows)
    if batch.torn is not None:
        batch.torn.write(b, kept.torn)


def _spans(batch: Batch, name: str) -> dict[str, slice]:
    """Kind of rows -> where those of a body are, but for kinds that it has none of."""
    spans = {"segment": batch.segments(name), "stitch": batch.stitches(name)}
    return {row: span for row, span in spans.items() if span.stop > span.start}
