# SPDX-License-Identifier: Apache-2.0
"""Export a recording: `cloth_sim_export BAG OUT.glb`, or OUT.mp4, OUT.gif, or a folder of PNGs."""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

from cloth_sim_ros.options import missing
from cloth_sim_ros.ros.parameters.plugins import add_plugins_option, require_plugins

NEEDED = {".glb": ("rosbags", "pygltflib", "trimesh"), "": ("rosbags", "matplotlib", "trimesh", "tqdm")}
KINDS = (".glb", ".mp4", ".gif", "")


def main(arguments: list[str] | None = None) -> int:
    """Write the first run of a bag; return the exit status, 1 with one sentence if that fails."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bag", type=Path, help="folder of a bag")
    parser.add_argument("out", type=Path, help="a file .glb, .mp4 or .gif; without a suffix a folder of PNGs")
    parser.add_argument("--rate", type=float, default=30.0, help="frames a second, from 1 to 1000 (default 30)")
    add_plugins_option(parser)
    options = parser.parse_args(arguments)
    try:
        require_plugins(options.plugins)
        frames = export(options.bag, options.out, options.rate)
    except (ValueError, OSError) as error:
        print(f"cloth_sim_export: {error}", file=sys.stderr)
        return 1
    print(f"{options.out} has {frames} frames")
    return 0


def export(bag: Path, out: Path, rate: float) -> int:
    """Write the film, print what is left out, and return the number of frames. Raises ValueError in one sentence."""
    if out.suffix not in KINDS:
        raise ValueError(f"{out} ends in {out.suffix}; allowed are .glb, .mp4, .gif and a folder without a suffix")
    if not 1.0 <= rate <= 1000.0:
        raise ValueError(f"--rate is {rate:g}; allowed is a number from 1 to 1000")
    if lack := missing(*NEEDED.get(out.suffix, NEEDED[""])):
        raise ValueError(lack)
    from cloth_sim_ros.record.bag import Bag
    from cloth_sim_ros.record.film import film_of

    film = film_of(Bag(bag), rate)
    for sentence in film.left_out:
        print(sentence)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        if out.suffix == ".glb":
            from cloth_sim_ros.record.gltf import write_glb

            write_glb(film, out)
        else:
            from cloth_sim_ros.record.movie import write_movie

            write_movie(film, out, rate)
    except (OSError, subprocess.CalledProcessError) as error:  # the second is of ffmpeg
        why = error.strerror if isinstance(error, OSError) else f"ffmpeg ends with status {error.returncode}"
        raise ValueError(f"{out} cannot be written: {why}") from None
    return len(film.times)


if __name__ == "__main__":
    sys.exit(main())
