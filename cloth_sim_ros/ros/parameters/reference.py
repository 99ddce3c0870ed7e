# SPDX-License-Identifier: Apache-2.0
"""Print docs/reference/parameters.md from the table: `make docs`."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

from cloth_sim_ros import parameters as table
from cloth_sim_ros.parameters import Parameter
from cloth_sim_ros.ros.parameters import names
from cloth_sim_ros.sim.scene.materials import CORDS, FABRICS

HEAD = """# Parameters

Printed from `cloth_sim_ros/parameters.py` by `make docs`; do not edit.

`<cloth>`, `<rope>`, `<collider>`, `<handle>`, `<gripper>`, `<force>`, `<constraint>` and `<seam>` stand for the names
listed in `objects`, `colliders`, `handles`, `grippers`, `forces`, `constraints` and `seams`. A force or constraint also
has the numbers of its type, all live.
**live**: takes effect at the next frame. **rebuild**: the simulation is built anew at the next frame, and every object
goes on from where it is. **anew**: so too, but this object starts from the beginning. **start**: fixed while the node
runs. Whole numbers and text such as `1e-6` are accepted for decimals.
"""

MATERIALS = """`material` sets what is not set otherwise: mass, compliances, bending (`dihedral`, of a rope `angle`),
damping, friction, and of a cloth half of its thickness. It then has the Young's moduli E of warp and weft and the shear
modulus; the log tells where a grid's cells are too long for that. A mesh has Poisson's ratio too; of a grid it is about
shear / E of the weft. B are the flexural rigidities of strips along warp, weft and at 45 degrees. A compliance that is
set scales those of weft and diagonal that are not. A rope of another `radius` has mass and EA by its square, EI by its
fourth power.
"""


def reference() -> str:
    """Return the whole document."""
    sections = [
        ("Node", "", table.NODE),
        ("Solver", "solver.", table.SOLVER),
        ("Wind", "wind.", table.WIND),
        ("What is sent", "publish.", table.PUBLISH),
        ("The page's camera", "view.", table.VIEW),
        ("A robot", "robot.", table.ROBOT),
        ("Objects of type cloth", "<cloth>.", names.object_rows("cloth")),
        ("Objects of type rope", "<rope>.", names.object_rows("rope")),
        ("Colliders", "<collider>.", names.collider_rows()),
        ("Handles", "<handle>.", names.HANDLE),
        ("Grippers", "<gripper>.", names.GRIPPER),
        ("Forces", "<force>.", table.FORCE),
        ("Constraints", "<constraint>.", table.CONSTRAINT),
        ("Seams", "<seam>.", (*table.SEAM_PLACE, *table.SEAM)),
    ]
    return HEAD + "".join(_section(*section) for section in sections) + _materials()


def _section(title: str, prefix: str, rows: Iterable[Parameter]) -> str:
    lines = [f"\n## {title}\n", "| parameter | default | allowed | change | meaning |", "|---|---|---|---|---|"]
    lines += [_line(prefix, row) for row in rows]
    return "\n".join(lines) + "\n"


def _materials() -> str:
    """Return the presets of sheets and of ropes."""
    sheets = ["material", "mass [kg/m^2]", "E warp [N/m]", "E weft [N/m]", "shear [N/m]", "Poisson"]
    sheets += ["B warp [N m]", "B weft [N m]", "B diagonal [N m]", "damping [s]", "thick [m]"]
    ropes = ["material", "radius [m]", "mass [kg/m]", "EA [N]", "EI [N m^2]", "damping [s]", "in bending [s]"]
    lines = ["\n## Materials\n", MATERIALS]
    for head, presets in ((sheets, FABRICS), (ropes, CORDS)):
        head = [*head, "friction", "source"]
        lines += [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
        for name, preset in presets.items():
            *numbers, static, kinetic, source = dataclasses.astuple(preset)
            cells = [f"`{name}`", *(f"{number:g}" for number in numbers), f"{static:g}, {kinetic:g}", source]
            lines.append(f"| {' | '.join(cells)} |")
        lines.append("")
    return "\n".join(lines)


def _line(prefix: str, row: Parameter) -> str:
    change = "start" if row.fixed else "live" if row.live else "anew" if row.anew else "rebuild"
    return f"| `{prefix}{row.name}` | {_shown(row.default)} | {table.allowed(row)} | {change} | {row.text} |"


def _shown(default: object) -> str:
    if isinstance(default, tuple):
        return "[" + ", ".join(_shown(item) for item in default) + "]"
    if isinstance(default, bool):
        return str(default).lower()
    if isinstance(default, float):
        return f"{default:g}"
    return str(default) or "(empty)"


if __name__ == "__main__":
    print(reference(), end="")
