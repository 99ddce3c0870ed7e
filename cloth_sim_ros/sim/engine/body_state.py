# SPDX-License-Identifier: Apache-2.0
"""The state that a body keeps when the device arrays are rebuilt around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cloth_sim_ros.sim.engine.batch import Batch
from cloth_sim_ros.sim.engine.state_arrays import rows_by_array

_PAST = ("last_displacements", "last_velocities")
# Array -> kind of its rows, see `rows_by_array`.
_KEPT = {
    **dict.fromkeys(("positions", "position_lo", "good_positions", "velocities", *_PAST), "particle"),
    **dict.fromkeys(("recoveries", "history"), "count"),
    **rows_by_array("KEPT"),
}


@dataclass(frozen=True)
class BodyState:
    """One body in all worlds.

    order: of its history. rows: array -> its rows (worlds, n). live: rows (worlds,) of the live arrays. kg: mass and
    end mass (worlds, 2). torn: see Torn.read; None if it does not tear.
    """

    order: int
    rows: dict[str, np.ndarray]
    live: list[np.ndarray]
    kg: np.ndarray
    torn: dict[str, np.ndarray] | None


def take(batch: Batch, name: str) -> BodyState:
    """Copy all state of a body that outlives its arrays."""
    b, spans = batch.index[name], batch.spans(name)
    places = {array: spans[row][0] for array, row in _KEPT.items() if batch.states[array].size}
    rows = {a: batch.part(a, span, None).numpy() for a, span in places.items() if span.stop > span.start}
    live = [rows.read(b, None) for rows in batch.live]
    kg, torn = batch.masses.read(b, None), batch.torn and batch.torn.read(b)
    return BodyState(batch.features.order, rows, live, kg, torn)


def give(batch: Batch, name: str, kept: BodyState) -> None:
    """Write the state that another batch had of a body, whose pins may have changed.

    Multipliers start from zero. History is dropped if the order changed.
    """
    b, spans = batch.index[name], batch.spans(name)
    follows, pinned = kept.order == batch.features.order, batch.masses.of_pinned(b)
    batch.masses.write(b, None, kept.kg)
    inverse_mass = batch.masses.inverse[:, batch.span(name)].numpy()
    for array, rows in kept.rows.items():
        if array in (*_PAST, "history") and not follows:
            continue
        if _KEPT[array] == "body":
            batch.write_body(array, name, rows)
            continue
        if not batch.features.winch:  # a winch itself pins the particles on its drum
            rows = rows.copy()
            if array in ("positions", "good_positions"):
                rows[..., 3] = inverse_mass
            elif array in ("velocities", *_PAST):
                rows[:, pinned] = 0.0
        batch.part(array, spans[_KEPT[array]][0], None).assign(rows)
    for rows, held in zip(batch.live, kept.live, strict=True):
        rows.edit()[:, b] = held
    if batch.torn is not None:
        batch.torn.write(b, kept.torn)
