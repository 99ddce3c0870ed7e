# SPDX-License-Identifier: Apache-2.0
"""`python -m cloth_sim_ros.study COMMAND`: each command is a module with add_arguments(parser) and run(arguments)."""

from __future__ import annotations

import argparse
import importlib
import sys

import warp as wp

from cloth_sim_ros.options import missing

COMMANDS = {
    "scenes": ("scenes", "what a frame of real scenes costs by the defaults and by set numbers, and its error"),
    "error": ("error", "error against time for a case over orders, substeps and iterations"),
    "tune": ("tune", "the cheapest settings of a scene file that keep a wanted error"),
    "stability": ("stability", "every hard case by every method: what stays finite, bounded, and comes back"),
    "fabric": (
        "fabric.command",
        "drape, stretch and bending of fabrics by the tests of a laboratory, beside published values",
    ),
}


def main() -> int:
    """Parse the command line and run its command; return the exit status."""
    try:
        modules = {name: importlib.import_module(f"cloth_sim_ros.study.{file}") for name, (file, _) in COMMANDS.items()}
    except ModuleNotFoundError as error:
        if not (lack := missing(error.name.partition(".")[0])):
            raise
        print(f"error: {lack}", file=sys.stderr)
        return 2
    parser = argparse.ArgumentParser(prog="python -m cloth_sim_ros.study", description=__doc__.split(":")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    for name, (_, text) in COMMANDS.items():
        modules[name].add_arguments(commands.add_parser(name, help=text))
    arguments = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    try:
        return modules[arguments.command].run(arguments)
    except ValueError as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
