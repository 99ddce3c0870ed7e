# SPDX-License-Identifier: Apache-2.0
"""Names of all ROS parameters for a scene of given objects and colliders: full name -> row of the table."""

from __future__ import annotations

import re
from collections.abc import Container, Iterable, Mapping
from dataclasses import replace
from typing import Any

from cloth_sim_ros import parameters as table
from cloth_sim_ros.parameters import Parameter
from cloth_sim_ros.sim.colliders import SHAPES
from cloth_sim_ros.sim.scene.constraints import CONSTRAINTS
from cloth_sim_ros.sim.scene.forces import FORCES
from cloth_sim_ros.sim.scene.seams import Seam

GROUPS = {
    "solver": table.SOLVER,
    "wind": table.WIND,
    "publish": table.PUBLISH,
    "view": table.VIEW,
    "robot": table.ROBOT,
}
LONGEST = 100  # letters of a name: the middleware bounds those of topics
_NAME = re.compile(r"[a-zA-Z][a-zA-Z0-9_]*")


# The lists of names in parameters.NODE.
NAMED = ("objects", "colliders", "handles", "grippers", "forces", "constraints", "seams")

# Topics move colliders and handles while the node runs, so their parameters may as well.
COLLIDER, HANDLE, GRIPPER = (
    tuple(
        replace(row, live=True, anew=False) if row.name in ("position", "orientation") else row
        for row in (*rows, table.FOLLOW_FRAME)
    )
    for rows in (table.COLLIDER, table.HANDLE, (*table.GRIPPER, *table.GRIPPER_JOINT))
)


def collider_rows() -> tuple[Parameter, ...]:
    """Return the rows under the prefix of a collider, of one of SHAPES."""
    return tuple(replace(row, choices=tuple(SHAPES)) if row.name == "shape" else row for row in COLLIDER)


WINCH = tuple(replace(row, name=f"winch.{row.name}") for row in (*table.WINCH, *table.WINCH_TOPIC))


def object_rows(kind: str) -> tuple[Parameter, ...]:
    """Return the rows under the prefix of an object of `kind` "cloth" or "rope"."""
    return (*table.OBJECT, *((*table.ROPE, *table.TWIST, *WINCH) if kind == "rope" else (*table.SHEET, *table.CLOTH)))


def prefixed(prefix: str, rows: Iterable[Parameter]) -> dict[str, Parameter]:
    """Return full name -> row of `rows` under `prefix`."""
    return {f"{prefix}.{row.name}": row for row in rows}


def fixed_rows() -> dict[str, Parameter]:
    """Return the parameters that exist in every scene."""
    rows = {row.name: row for row in table.NODE}
    for prefix, group in GROUPS.items():
        rows.update(prefixed(prefix, group))
    return rows


def type_rows(values: Mapping[str, Any]) -> dict[str, Parameter]:
    """Return the rows `<name>.type` of everything that comes in several types, for the lists of names in `values`."""
    groups = {"objects": table.OBJECT, "forces": table.FORCE, "constraints": table.CONSTRAINT}
    return {f"{name}.type": rows[0] for group, rows in groups.items() for name in values.get(group, ())}


def scene_rows(values: Mapping[str, Any]) -> dict[str, Parameter]:
    """Return the parameters of all names in the lists of NAMED, by `values`, which include those of `type_rows`."""

    def rows_of(group: str, name: str) -> tuple[Parameter, ...]:
        kind = values.get(f"{name}.type")
        if group == "objects":
            return object_rows(kind)
        if group == "colliders":
            return collider_rows()
        if group == "forces":
            return (*table.FORCE, *getattr(FORCES.get(kind), "rows", ()))
        if group == "constraints":
            return (*table.CONSTRAINT, *getattr(CONSTRAINTS.get(kind), "rows", ()))
        if group == "seams":
            return (*table.SEAM_PLACE, *Seam.rows)
        return HANDLE if group == "handles" else GRIPPER

    found: dict[str, Parameter] = {}
    for group in NAMED:
        for name in values.get(group, ()):
            found |= prefixed(name, rows_of(group, name))
    return found


def idle(name: str, values: Mapping[str, object]) -> str:
    """Return why the parameter `name` has no effect with these values, in one sentence; "" if it has."""
    owner, _, field = name.rpartition(".")
    switches = {
        "bend_compliance": ("bending", "none"),
        "shear_compliance": ("shear", False),
        "twist_compliance": ("twist", False),
        "end_turn": ("twist", False),
    }
    if field in ("dimensions", "scale", "mesh") and f"{owner}.shape" in values:
        shape = values[f"{owner}.shape"]
        if hasattr(SHAPES.get(shape), "from_file") == (field == "dimensions"):
            return f"{name} has no effect on a {shape}"
        return ""
    for place, replaced in (("path", ("start", "end")), ("mesh", ("resolution", "size"))):
        if field in replaced and values.get(f"{owner}.{place}"):
            return f"{name} acts only where {owner}.{place} is empty"
    if field == "scale" and not values[f"{owner}.mesh"]:
        return f"{name} acts only where {owner}.mesh names a file"
    switch, off = switches.get(field, ("enabled", False))
    switch = f"{owner}.{switch}"
    if switch == name or switch not in values or values[switch] != off:
        return ""
    return f"{name} acts only where {switch} is not {str(off).lower()}"


def usable(names: Iterable[str], taken: set[str], what: str) -> tuple[list[str], list[str]]:
    """Return the `names` that can prefix topics and parameters, and a sentence for each other one. Adds to `taken`."""
    good, complaints = [], []
    for name in names:
        trouble = unusable(name, taken)
        if trouble:
            complaints.append(f"{what} holds {table.shown(name)}, left out: {trouble}")
        else:
            taken.add(name)
            good.append(name)
    return good, complaints


def unusable(name: str, taken: Container[str]) -> str:
    """Return why a name cannot prefix topics and parameters beside those `taken`; "" if it can."""
    if not _NAME.fullmatch(name):
        return "a name is letters, digits and _, a letter first"
    if len(name) > LONGEST:
        return f"a name has at most {LONGEST} letters"
    return "the name is already taken" if name in taken else ""
