# SPDX-License-Identifier: Apache-2.0
"""What a body takes along where everything on the device is built anew around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cloth_sim_ros.sim.engine.batch import Batch
from cloth_sim_ros.sim.engine.state_arrays import rows_by_array

_PAST = ("last_displacements", "last_velocities")
# Array -> what it has a row of: a particle, a count of the body, or a struct of the body.
_KEPT = {
    **dict.fromkeys(("positions", "position_lo", "good_positions", "velocities", *_PAST), "particle"),
    **dict.fromkeys(("recoveries", "history"), "count"),
    **rows_by_array("KEPT"),
}


@dataclass(frozen=True)
class BodyState:
    """One body in all worlds: rows of its particles (worlds, N, 4), counts (worlds, 1) and its rows of the live arrays
    (worlds,). kg: mass and end mass (worlds, 2). Where it has them, also rows of WinchState and Twist (worlds, 1).
    past: order and substeps a frame, which its history is of. torn: see Torn.read; None where it does not tear."""

    past: tuple[int, int]
    particles: dict[str, np.ndarray]
    counts: dict[str, np.ndarray]
    live: list[np.ndarray]
    kg: np.ndarray
    bodies: dict[str, np.ndarray]
    torn: dict[str, np.ndarray] | None


def take(batch: Batch, name: str) -> BodyState:
    """Everything of a body that outlives its arrays."""
    span, b = batch.span(name), batch.index[name]
    has = {row: [a for a in _KEPT if _KEPT[a] == row and batch.states[a].size] for row in ("particle", "count", "body")}
    particles = {array: batch.part(array, span, None).numpy() for array in has["particle"]}
    counts = {array: batch.part(array, slice(b, b + 1), None).numpy() for array in has["count"]}
    live = [rows.read(b, None) for rows in batch.live]
    bodies = {array: batch.read_body(array, name, None) for array in has["body"]}
    kg = batch.masses.read(b, None)
    return BodyState(_past(batch), particles, counts, live, kg, bodies, batch.torn and batch.torn.read(b))


def give(batch: Batch, name: str, kept: BodyState) -> None:
    """What another batch had of a body, whose pins may be others now; multipliers start anew, and so does history
    where order or substeps changed."""
    span, b = batch.span(name), batch.index[name]
    follows, pinned = kept.past == _past(batch), batch.masses.of_pinned(b)
    batch.masses.write(b, None, kept.kg)
    inverse_mass = batch.masses.inverse[:, span].numpy()
    for array, rows in kept.particles.items():
        if array in _PAST and not follows:
            continue
        if not batch.features.winch:  # which pins what is on its drum
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
    if batch.torn is not None:
        batch.torn.write(b, kept.torn)


def _past(batch: Batch) -> tuple[int, int]:
    return batch.features.order, batch.frame.substeps
