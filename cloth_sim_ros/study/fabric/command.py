# SPDX-License-Identifier: Apache-2.0
"""`fabric`: drape, stretch, shear and bending of presets by laboratory tests, beside their expected values."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cloth_sim_ros.sim import Fabric, Settings
from cloth_sim_ros.sim.scene.materials import FABRICS
from cloth_sim_ros.status_line import show
from cloth_sim_ros.study.fabric.laboratory import RADIUS, SUPPORT, Drape, drape, modulus, overhung, pulled, sheared
from cloth_sim_ros.study.fabric.meshes import KINDS, circle
from cloth_sim_ros.study.figures import save_png

ANGLES = (0.0, 45.0, 90.0)
TESTS = ("drape", "tension", "shear", "bending")
# Cusick's drape coefficients [%] and where they are from.
BANDS = {
    "silk": (20, 40, "light woven silk: Matsudaira and Yang 2003, Hu et al. 2020"),
    "flag": (20, 40, "limp woven synthetics: ISO 9073-9, light template"),
    "cotton": (60, 76, "plain weave: Gan, Ly and Steven 1991, 68.4 measured"),
    "wool": (40, 70, "worsted suiting, middle of the drape studies"),
    "leather": (47, 70, "garment sheep leather: Memon et al. 2021"),
    "denim": (70, 90, "heavy twill, the stiffest class"),
}
_STRIP_KINDS = ("one way", "hexagonal", "delaunay")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `python -m cloth_sim_ros.study fabric`."""
    parser.add_argument("--fabric", nargs="+", choices=tuple(FABRICS), default=list(BANDS), metavar="NAME")
    parser.add_argument(
        "--own", help='numbers of a fabric of your own, as JSON: \'{"areal_mass": 0.2, "warp": 900, ...}\''
    )
    parser.add_argument("--test", nargs="+", choices=TESTS, default=list(TESTS))
    parser.add_argument("--mesh", nargs="+", choices=KINDS, default=list(KINDS), help="kinds of meshes of the disc")
    parser.add_argument("--spacing", type=float, default=0.01, help="spacing of the vertices [m]")
    parser.add_argument("--starts", type=int, default=1, help="drapes of each, the warp turned by 7 degrees more each")
    parser.add_argument("--seconds", type=float, default=4.0, help="simulated time of a drape [s]")
    parser.add_argument("--error", type=float, default=1e-3, help="solver.error")
    parser.add_argument(
        "--budget", type=float, default=0.5, help="solver.budget, which small stiff meshes need more of"
    )
    parser.add_argument("--output", type=Path, default=Path("study"), help="folder of the JSON and PNG")


def run(arguments: argparse.Namespace) -> int:
    """Measure, print a table, and store it with a picture of the drapes from above."""
    fabrics = {name: FABRICS[name] for name in arguments.fabric}
    if arguments.own:
        fabrics = {"own": _own(arguments.own)}
    settings, rows, drapes = Settings(error=arguments.error, budget=arguments.budget), [], {}
    for name, fabric in fabrics.items():
        if "drape" in arguments.test:
            for kind in arguments.mesh:
                show(f"drape of {name}, {kind}")
                found = [
                    drape(fabric, kind, arguments.spacing, np.radians(7.0 * k), arguments.seconds, settings)
                    for k in range(arguments.starts)
                ]
                drapes[name, kind] = found[0]
                rows.append(_drape_row(name, kind, found))
        if "tension" in arguments.test:
            for kind in _STRIP_KINDS:
                show(f"tension of {name}, {kind}")
                rows += [
                    _row(name, "E [N/m]", kind, angle, pulled(fabric, kind, arguments.spacing, angle, settings),
                         modulus(fabric, angle))
                    for angle in ANGLES
                ]  # fmt: skip
        if "shear" in arguments.test:
            for kind in _STRIP_KINDS:
                show(f"shear of {name}, {kind}")
                rows.append(
                    _row(name, "G [N/m]", kind, 0.0, sheared(fabric, kind, arguments.spacing, settings), fabric.shear)
                )
        if "bending" in arguments.test:
            wanted = (fabric.bend_warp, fabric.bend_diagonal, fabric.bend_weft)
            for kind in _STRIP_KINDS:
                show(f"bending of {name}, {kind}")
                rows += [
                    _row(name, "B [N m]", kind, angle, overhung(fabric, kind, angle, 12, settings), value)
                    for angle, value in zip(ANGLES, wanted, strict=True)
                ]
    print(table(rows))
    arguments.output.mkdir(parents=True, exist_ok=True)
    stored = {"fabrics": {name: asdict(fabric) for name, fabric in fabrics.items()}, "rows": rows}
    (arguments.output / "fabric.json").write_text(json.dumps(stored, indent=1))
    if drapes:
        _draw(drapes, arguments.output / "fabric.png")
    print(f"written: {arguments.output / 'fabric.json'}", file=sys.stderr)
    return 0


def table(rows: list[dict]) -> str:
    """Return a line for each row: the measured and the expected value."""
    lines = [f"{'fabric':10} {'test':24} {'mesh':10} {'measured':>10}  should be"]
    return "\n".join(
        lines
        + [
            f"{row['fabric']:10} {row['test']:24} {row['mesh']:10} {row['found']:10.4g}  {row['wanted']}"
            for row in rows
        ]
    )


def _own(text: str) -> Fabric:
    """Return a fabric from JSON. Raises ValueError if the text is none."""
    try:
        return Fabric(**{name: float(value) for name, value in json.loads(text).items()})
    except (TypeError, ValueError, AttributeError) as error:
        names = ", ".join(name for name in Fabric.__dataclass_fields__ if name != "source")
        raise ValueError(f"--own is {text!r}: {error}; allowed is a JSON object with numbers of {names}") from None


def _row(name: str, test: str, kind: str, angle: float, found: float, wanted: float) -> dict:
    return {
        "fabric": name, "test": f"{test} at {angle:g}", "mesh": kind, "found": found, "ratio": found / wanted,
        "wanted": f"{wanted:.3g}, {100.0 * (found / wanted - 1.0):+.1f} %",
    }  # fmt: skip


def _drape_row(name: str, kind: str, found: list[Drape]) -> dict:
    coefficient = float(np.mean([each.coefficient for each in found]))
    low, high, source = BANDS.get(name, (0, 100, "no published band"))
    folds = sorted(each.folds for each in found)
    return {
        "fabric": name, "test": "drape coefficient [%]", "mesh": kind, "found": coefficient, "folds": folds,
        "inside": low <= coefficient <= high, "wanted": f"{low} to {high}, {source}; folds {folds}",
    }  # fmt: skip


def _draw(drapes: dict[tuple[str, str], Drape], path: Path) -> None:
    """Draw the drapes from above, darker the lower, with the circle of the support and that of the flat sample."""
    columns = len(KINDS) * 2
    lines = -(-len(drapes) // columns)
    figure = Figure(figsize=(2.1 * columns, 2.4 * lines), layout="constrained")
    for k, ((name, kind), found) in enumerate(drapes.items()):
        axes = figure.add_subplot(lines, columns, k + 1, aspect="equal")
        x, y, z = found.points.T
        heights = z[found.triangles].mean(axis=1)
        order = np.argsort(heights)
        axes.tripcolor(x, y, found.triangles[order], facecolors=heights[order], cmap="bone")
        for radius in (SUPPORT, RADIUS):
            axes.plot(*np.vstack([circle(radius, 90), [(radius, 0.0)]]).T, color="0.5", linewidth=0.6)
        axes.set_title(f"{name}, {kind}: {found.coefficient:.0f} %", fontsize=8)
        axes.set_axis_off()
    save_png(figure, path)
