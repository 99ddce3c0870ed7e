# SPDX-License-Identifier: Apache-2.0
"""Compare the cost of a node without listeners with the simulation alone: `python -m cloth_sim_ros.demo.node_cost`.

Two processes run the same scene side by side, both at the pace of the scene: the node, and `Simulation.step` in a plain
loop. Linux tells the processor time of each thread. So a busy machine changes little, and no query makes the node work
more.
"""

from __future__ import annotations

import argparse
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from cloth_sim_ros.demo.__main__ import end, start, start_node
from cloth_sim_ros.options import duration
from cloth_sim_ros.shared_files import shared

WARM = 5.0  # [s] both run before they count


def main(arguments: list[str] | None = None) -> int:
    """Measure --rounds windows of --seconds and print the ratio with its spread; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--config", type=Path, default=shared("config/curtain.yaml"), help="parameter file of the node")
    parser.add_argument("--seconds", type=duration, default=4.0, help="length of a window")
    parser.add_argument("--rounds", type=int, default=15, help="number of windows")
    parser.add_argument("--alone", action="store_true", help="runs Simulation.step alone, until it is ended")
    options = parser.parse_args(arguments)
    if options.alone:
        return run_alone(options.config)
    if not Path("/proc/self/task").is_dir():
        print("node_cost reads /proc of Linux, which is not here", file=sys.stderr)
        return 1
    node = start_node(options.config)
    alone = start("cloth_sim_ros.demo.node_cost", "--alone", "--config", str(options.config))
    try:
        wait_until_steady(lambda: (thread_times(node.pid), thread_times(alone.pid)))
        print(table(measured(node.pid, alone.pid, options.seconds, options.rounds)))
    finally:
        end(node)
        end(alone)
    return 0


def run_alone(config: Path) -> int:
    """Step the scene of `config` at its own pace, as a node does, and do nothing else."""
    from cloth_sim_ros.ros.time.frame_clock import FrameClock
    from cloth_sim_ros.sim import Simulation
    from cloth_sim_ros.study.scene_file import read_plan

    plan = read_plan(config)
    sim, never = Simulation(plan.scene, plan.settings, plan.device), threading.Event()
    sim.step()
    clock = FrameClock(plan.settings.frame_dt)
    while True:
        sim.step()
        clock.wait(never)


def thread_times(process: int) -> dict[str, float]:
    """Return thread -> its processor time so far [s]."""
    files = Path(f"/proc/{process}/task").glob("*/schedstat")
    return {file.parent.name: 1e-9 * int(file.read_text().split()[0]) for file in files}


def wait_until_steady(look: Callable[[], tuple[dict[str, float], ...]]) -> None:
    """Wait until no process takes more than half of a core, as one that compiles does, for WARM seconds."""
    calm = time.monotonic()
    before = look()
    while time.monotonic() < calm + WARM:
        time.sleep(0.5)
        now = look()
        if any(sum(b.values()) - sum(a.values()) > 0.25 for a, b in zip(before, now, strict=True)):
            calm = time.monotonic()
        before = now


def measured(node: int, alone: int, seconds: float, rounds: int) -> np.ndarray:
    """Return the processor seconds (rounds, 3) in each window.

    The columns are the node's thread that simulates, the whole node, and the loop alone.
    """
    rows = []
    for _ in range(rounds):
        before = thread_times(node), thread_times(alone)
        time.sleep(seconds)
        after = thread_times(node), thread_times(alone)
        grown, bare = (
            [now.get(thread, then) - then for thread, then in was.items()]
            for was, now in zip(before, after, strict=True)
        )
        rows.append((max(grown), sum(grown), sum(bare)))
    return np.array(rows)


def table(rows: np.ndarray) -> str:
    """Return the ratios to the loop alone, with quartiles."""
    lines = [f"Simulation.step in a loop takes {1e3 * np.median(rows[:, 2]):.0f} ms of a core in a window"]
    for words, column in (("the node's thread that simulates", 0), ("the whole node, middleware included", 1)):
        low, middle, high = np.percentile(rows[:, column] / rows[:, 2], (25, 50, 75))
        lines.append(f"{words}: {middle:.3f} times that, quartiles {low:.3f} and {high:.3f}, {len(rows)} windows")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
