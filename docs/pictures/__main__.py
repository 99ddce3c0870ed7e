# SPDX-License-Identifier: Apache-2.0
"""`python docs/pictures`: draws the pictures of the documentation anew. To add one, add its line in PICTURES."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import curtain
import oscillator
import rope
import springs
from matplotlib.figure import Figure

from cloth_sim_ros.study.figures import save_png

PICTURES: dict[str, Callable[[str], Figure]] = {  # file name -> figure, drawn on a device
    "curtain": curtain.draw,
    "topology": springs.draw_topology,
    "mesh_lines": springs.draw_mesh_lines,
    "oscillator": oscillator.draw,
    "rope": rope.draw,
}


def main() -> None:
    """Draw and save."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "images", help="folder of the PNGs")
    parser.add_argument("--device", default="cpu", help="cpu, cuda:0 or auto")
    parser.add_argument("--only", nargs="+", choices=sorted(PICTURES), default=list(PICTURES))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in arguments.only:
        path = arguments.out / f"{name}.png"
        save_png(PICTURES[name](arguments.device), path)
        print(f"written: {path}, {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
