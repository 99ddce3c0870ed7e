# SPDX-License-Identifier: Apache-2.0
"""Dependencies of the package point one way: no import runs back to a higher layer, and none goes in a circle."""

import ast
from pathlib import Path

import cloth_sim_ros

ROOT = Path(cloth_sim_ros.__file__).parent
# From the lowest to the highest. A folder may import those before it, and itself.
PACKAGE = (
    "parameters signals options shared_files status_line programs "
    "sim drawing ros study record viewer identify learn cosim demo"
).split()
SIM = (
    "kernels physics input mesh_file colliders scene topology arrays features lines ropes substeps program executors "
    "engine access simulation clients __init__"
).split()


def modules():
    """Name of each module -> its file."""
    found = {}
    for file in ROOT.rglob("*.py"):
        parts = file.relative_to(ROOT.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return found


def imports(file, known):
    """Modules of `known` that a file imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {each.name for each in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            inside = {f"{node.module}.{each.name}" for each in node.names} & known.keys()
            found |= inside if len(inside) == len(node.names) else inside | {node.module}
    return found & known.keys()


def layer(module):
    """Place among the layers: of the package, then within sim."""
    parts = module.split(".")[1:]
    if not parts:
        return (-1,)
    place = (PACKAGE.index(parts[0]),)
    if parts[0] != "sim":
        return place
    # The file arrays.py of a feature is part of the layer `arrays`: its struct is part of State.
    inside = "arrays" if parts[-1] == "arrays" else parts[1] if len(parts) > 1 else "__init__"
    return (*place, SIM.index(inside))


def test_no_import_runs_back():
    known = modules()
    back = [
        f"{module} imports {other}"
        for module, file in known.items()
        for other in imports(file, known)
        if layer(other) > layer(module) and other != "cloth_sim_ros"
    ]
    assert not back


def test_no_import_goes_in_a_circle():
    known = modules()
    left = {module: imports(file, known) - {module} for module, file in known.items()}
    while free := [module for module, others in left.items() if not others & left.keys()]:
        for module in free:
            del left[module]
    assert not left, "each of these imports another of them"


def test_a_layer_is_seen():
    """What the two tests above stand on: imports are found, and layers differ."""
    known = modules()
    assert "cloth_sim_ros.sim.engine.bodies" in imports(known["cloth_sim_ros.sim.simulation"], known)
    assert (
        layer("cloth_sim_ros.sim.simulation")
        > layer("cloth_sim_ros.sim.engine.bodies")
        > layer("cloth_sim_ros.parameters")
    )
    assert len([each for each in (ROOT / "sim").iterdir() if each.name != "__pycache__"]) <= 20
