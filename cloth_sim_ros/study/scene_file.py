# SPDX-License-Identifier: Apache-2.0
"""Read the node's YAML file as a scene, and write the same file with other solver settings.

It uses only modules of cloth_sim_ros.ros that import no ROS, so that the node and the study build the same scene.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from cloth_sim_ros import parameters as table
from cloth_sim_ros.ros.parameters import names  # noqa: TID251 (free of rclpy, which a test proves)
from cloth_sim_ros.ros.parameters.plan import Plan, make_plan, material_values  # noqa: TID251 (as above)
from cloth_sim_ros.ros.parameters.plugins import require_plugins  # noqa: TID251 (as above)

PARAMETERS = "ros__parameters"


def read_plan(path: Path) -> Plan:
    """Return the scene, settings and device that the node makes of a file.

    Raises ValueError for anything that the node would leave out.
    """
    given = dict(_flat(_document(path), path))
    rows = names.fixed_rows()
    values = {name: _value(row, name, given) for name, row in rows.items()}
    if not values["objects"]:
        raise ValueError(f"{path} describes no object; allowed is a scene with at least one")
    require_plugins(values["plugins"])
    values |= {name: _value(row, name, given) for name, row in names.type_rows(values).items()}
    rows |= names.scene_rows(values)
    for name, row in rows.items():
        values[name] = _value(row, name, given)
    unknown = sorted(set(given) - set(rows))
    if unknown:
        raise ValueError(f"{path} has {table.shown(unknown[0])}, which is no parameter")
    plan = make_plan(values | material_values(values, given))
    for problem in plan.problems.values():
        raise ValueError(f"{path}: {problem}")
    return plan


def with_values(path: Path, values: Mapping[str, Any]) -> str:
    """Return the text of the file with these parameters in place; comments and everything else stay."""
    text = _text(path)
    for name, value in values.items():
        text = _replaced(text, name, str(value), path)
    return text


def _text(path: Path) -> str:
    try:
        return Path(path).read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} cannot be read: {error}") from None


def _document(path: Path) -> Any:
    try:
        return yaml.safe_load(_text(path))
    except (yaml.YAMLError, RecursionError) as error:
        raise ValueError(f"{path} is not valid YAML: {' '.join(str(error).split())}") from None


def _flat(document: Any, path: Path) -> Iterator[tuple[str, Any]]:
    """Yield (full name, value) of every parameter of the one node in `document`."""
    blocks = [node[PARAMETERS] for node in _mappings(document) if isinstance(node.get(PARAMETERS), Mapping)]
    if len(blocks) != 1:
        raise ValueError(f"{path} has {len(blocks)} nodes with {PARAMETERS}; allowed is one")

    def walk(prefix: str, mapping: Mapping) -> Iterator[tuple[str, Any]]:
        for key, value in mapping.items():
            if isinstance(value, Mapping):
                yield from walk(f"{prefix}{key}.", value)
            else:
                yield f"{prefix}{key}", value

    return walk("", blocks[0])


def _mappings(document: Any) -> list[Mapping]:
    values = document.values() if isinstance(document, Mapping) else ()
    return [value for value in values if isinstance(value, Mapping)]


def _value(row: table.Parameter, name: str, given: Mapping[str, Any]) -> Any:
    """Return the checked value of a parameter: as given, with 1e-3, which YAML takes for text, as a number."""
    if name not in given:
        mesh = row.name == "pins" and given.get(name.replace(".pins", ".mesh"))
        return "none" if mesh else row.default  # a mesh has no corners
    value = given[name]
    if row.kind in ("double", "integer") and isinstance(value, str):
        try:
            value = float(value)
        except ValueError:
            pass  # check() says what is allowed
    return table.check(row, tuple(value) if isinstance(value, list) else value, name)


def _replaced(text: str, name: str, value: str, path: Path) -> str:
    """Return `text` with the parameter called `name` set to `value`, in its place or before the first of its group."""
    root = yaml.compose(text)
    blocks = [_child(node, PARAMETERS) for _, node in root.value if isinstance(node, yaml.MappingNode)]
    (block,) = [node for node in blocks if isinstance(node, yaml.MappingNode)]
    found, left = _locate(block, name)
    if found is not None and left == "":
        return text[: found.start_mark.index] + value + text[found.end_mark.index :]
    group = found if found is not None else block
    first = group.value[0][0].start_mark
    between = ", " if group.flow_style else "\n" + " " * first.column
    return text[: first.index] + f"{left}: {value}" + between + text[first.index :]


def _child(mapping: yaml.MappingNode, key: str) -> yaml.Node | None:
    return next((value for name, value in mapping.value if name.value == key), None)


def _locate(mapping: yaml.MappingNode, name: str) -> tuple[yaml.Node | None, str]:
    """Return the node of parameter `name` and "", or the innermost group that it belongs into and its name in there."""
    direct = _child(mapping, name)
    if direct is not None:
        return direct, ""
    for key, value in mapping.value:
        if name.startswith(key.value + ".") and isinstance(value, yaml.MappingNode) and value.value:
            inner, left = _locate(value, name[len(key.value) + 1 :])
            return (inner, left) if inner is not None else (value, left)
    return None, name
