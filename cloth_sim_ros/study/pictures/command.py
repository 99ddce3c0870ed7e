# SPDX-License-Identifier: Apache-2.0
"""`pictures`: draws every picture of the documentation anew. To add one, add its line in PICTURES."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from matplotlib.figure import Figure

from cloth_sim_ros.study.figures import save_png
from cloth_sim_ros.study.pictures import curtain, oscillator, rope, springs

PICTURES: dict[str, Callable[[str], Figure]] = {  # file name -> figure, drawn on a device
    "curtain": curtain.draw,
    "topology": springs.draw_topology,
    "mesh_lines": springs.draw_mesh_lines,
    "oscillator": oscillator.draw,
    "rope": rope.draw,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `python -m cloth_sim_ros.study pictures`."""
    parser.add_argument("--out", type=Path, default=Path("docs/images"), help="folder of the PNGs")
    parser.add_argument("--device", default="cpu", help="cpu, cuda:0 or auto")
    parser.add_argument("--only", nargs="+", choices=sorted(PICTURES), default=list(PICTURES))


def run(arguments: argparse.Namespace) -> int:
    """Draw and save."""
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in arguments.only:
        path = arguments.out / f"{name}.png"
        save_png(PICTURES[name](arguments.device), path)
        print(f"written: {path}, {path.stat().st_size / 1000:.0f} kB")
    return 0
