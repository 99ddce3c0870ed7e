# SPDX-License-Identifier: Apache-2.0
"""`python -m cloth_sim_ros.identify.recordings FOLDER`: cables fitted to recordings, and judged by others of them."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

from cloth_sim_ros.identify import fit_cable
from cloth_sim_ros.identify.cable import mean_error
from cloth_sim_ros.identify.cable_bag import CableTopics
from cloth_sim_ros.identify.markers import Markers
from cloth_sim_ros.identify.terminal import exit_status


def main() -> int:
    """Parse the command line, fit and judge; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m cloth_sim_ros.identify.recordings", description=__doc__)
    parser.add_argument("folder", type=Path, help="with recordings of cables, see docs/how-to/cables.md")
    fit_cable.add_options(parser)
    parser.add_argument("--output", type=Path, default=Path("study"), help="folder of scenes and pictures (study)")
    return exit_status(run, parser.parse_args())


def run(arguments: argparse.Namespace) -> None:
    """Fit and judge every cable of a folder, and print a table at the end. Raises ValueError in one sentence."""
    rows = []
    topics = CableTopics(arguments.markers, arguments.wrench, arguments.frame)
    for name, files in cables(arguments.folder, topics):
        print(f"{name}:")
        how = {**vars(arguments), "recordings": files, "judge": None, "output": arguments.output / f"{name}.yaml"}
        off = fit_cable.run(argparse.Namespace(**how))
        rows.append((name, {model: mean_error(each) for model, each in off.items()}))
        for model, each in off.items():
            markers = [mean_error(each[:, :, m]) for m in range(each.shape[2])]
            print(f"{model:8}by marker [mm] " + " ".join(f"{1e3 * error:.1f}" for error in markers))
    print(f"{'mean error [mm]':16}" + "".join(f"{model:>8}" for model in rows[0][1]))
    for name, errors in rows:
        print(f"{name:16}" + "".join(f"{1e3 * error:8.2f}" for error in errors.values()))


def cables(folder: Path, topics: CableTopics) -> Iterator[tuple[str, list[Path]]]:
    """Yield name and files of each cable: a file of several runs, or all others of a folder together. Bags count as
    files.

    Raises ValueError for a folder without recordings.
    """
    files = sorted(
        path for path in folder.rglob("*") if path.suffix in (".npz", ".csv") or (path / "metadata.yaml").is_file()
    )
    if not files:
        raise ValueError(f"{folder} has no recordings; allowed is a folder of .npz or .csv files, or of bags")
    together: dict[Path, list[Path]] = {}
    for path in files:
        if len(Markers.read([path], topics).runs) > 1:
            yield path.stem, [path]
        else:
            together.setdefault(path.parent, []).append(path)
    for parent, those in together.items():
        yield parent.name, those


if __name__ == "__main__":
    sys.exit(main())
