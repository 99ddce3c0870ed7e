# SPDX-License-Identifier: Apache-2.0
"""Current values of live numbers, by the names and in the units of live.py."""

from __future__ import annotations

from typing import Any

import numpy as np

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.arrays.masses import MASSES
from cloth_sim_ros.sim.engine.bodies import Bodies
from cloth_sim_ros.sim.input.numbers import places
from cloth_sim_ros.sim.scene.objects import Cloth, Rope

# Index of each compliance in Material.compliance. An object has shear or twist, never both.
COMPLIANCES = {"stretch_compliance": 0, "shear_compliance": 1, "twist_compliance": 1, "bend_compliance": 2}
# Parameter -> its name in Frame, if that differs.
OF_FRAME = {"velocity": "wind", "drag_coefficient": "drag", "lift_coefficient": "lift"}


def live_value(bodies: Bodies, name: str, world: int) -> Any:
    """Return the value of a live parameter in one world.

    The `position` or `orientation` of a collider or handle is that at the end of the last frame. A number is the
    shortest decimal that rounds to the same float32, so 0.1 set is 0.1 returned. Raises ValueError if the scene has no
    parameter of that name.
    """
    owner, _, field = name.rpartition(".") if isinstance(name, str) else ("", "", "")
    scene, world, found = bodies.scene, bodies.one(world), None
    rope = scene.objects.get(owner.removesuffix(".winch"))
    if name == "gravity":
        found = _decimal(bodies.frame.read(0, world)["gravity"][0])
    elif owner == "wind" and scene.wind is not None and _is_live(table.WIND, field):
        found = _decimal(bodies.frame.read(0, world)[OF_FRAME.get(field, field)][0])
    elif owner == "solver" and _is_live(table.SOLVER, field):
        found = getattr(bodies.settings, field)
    elif owner.endswith(".winch") and getattr(rope, "winch", None) is not None and _is_live(table.WINCH, field):
        batch = bodies.batch[owner.removesuffix(".winch")]
        found = _decimal(batch.drives.read(batch.index[owner.removesuffix(".winch")], world)[field][0])
    elif field in ("position", "orientation") and owner in {*scene.colliders, *scene.handles}:
        rows, row = (
            (bodies.colliders, bodies.collider_row) if owner in scene.colliders else (bodies.handles, bodies.handle_row)
        )
        found = _decimal(rows.read(row[owner], world)[f"end_{field}"][0])
    elif owner in scene.handles and _is_live(table.HANDLE, field):
        found = _of_handle(bodies, owner, field, world)
    elif owner in scene.colliders and _is_live(table.COLLIDER, field):
        found = _decimal(bodies.colliders.read(bodies.collider_row[owner], world)[field][0])
    elif owner in scene.colliders and _is_live(scene.colliders[owner].dimensions, field):
        size = bodies.colliders.read(bodies.collider_row[owner], world)["size"][0]
        found = _decimal(size[places(scene.colliders[owner].dimensions)[field]])
    elif owner in scene.numbered and _is_live(scene.numbered[owner].rows, field):
        numbers = bodies.numbers.read(bodies.numbers_row[owner], world)["values"][0]
        found = _decimal(numbers[places(scene.numbered[owner].rows)[field]])
    elif owner in scene.objects:
        found = _of_object(bodies, owner, field, world)
    if found is None:
        raise ValueError(f"there is no live parameter {name!r} in this scene; allowed are those that can be set")
    return found


def _of_handle(bodies: Bodies, name: str, field: str, world: int) -> Any:
    if field == "attached":
        return bool(bodies.handle_counts.numpy()[world, bodies.handle_row[name]] > 0)
    if field == "object":
        return bodies.grasps[name]
    row = bodies.handles.read(bodies.handle_row[name], world)
    if field != "reach":
        return _decimal(row[field][0])
    x, y, z, radius = row["reach"][0]
    return _decimal(row["reach"][0][:1]) if x == y == z == radius else _decimal(2.0 * row["reach"][0][:3])


def _of_object(bodies: Bodies, name: str, field: str, world: int) -> Any:
    thing, batch = bodies.scene.objects[name], bodies.batch[name]
    if field == "pins":
        return thing.pins or "none"
    if field == "scale":
        return bodies.topology(name).scales_in(world).item()
    if not _is_live(table.CLOTH if isinstance(thing, Cloth) else (*table.ROPE, *table.TWIST), field):
        return None
    if getattr(thing, "twist_compliance" if field == "end_turn" else field) is None:
        return None
    if field == "end_turn":
        return _decimal(batch.ends.read(batch.index[name], world)["turn"][0])
    if field in MASSES:
        return float(batch.masses.read(batch.index[name], world)[0, MASSES[field]])
    row = batch.materials.read(batch.index[name], world)
    if field in COMPLIANCES:
        return _decimal(row["compliance"][0][COMPLIANCES[field]])
    return _decimal(row["thickness" if isinstance(thing, Rope) and field == "radius" else field][0])


def _is_live(group: tuple[table.Parameter, ...], field: str) -> bool:
    return any(row.name == field and row.live for row in group)


def _decimal(value: Any) -> float | tuple[float, ...]:
    """Convert float32 to the shortest decimal that rounds to it."""
    return tuple(map(_decimal, value)) if np.ndim(value) else float(str(value))
