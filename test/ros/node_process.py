# SPDX-License-Identifier: Apache-2.0
"""The node in a process of its own."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

from patience import patience, tries

ROOT = Path(__file__).parents[2]

SMALL = """
/**:
  ros__parameters:
    objects: [cloth, rope]
    colliders: [ball]
    gravity: [0, 0, -9.81]
    cloth: {type: cloth, resolution: [6, 5], pins: corners, position: [0, 0, 2]}
    rope: {type: rope, segments: 7, pins: start}
    ball: {shape: sphere, dimensions: [0.1], position: [0, 0, -5]}
"""


class NodeProcess:
    """One at a time: all have the same name, and a request would reach any of them.

    `parameters` is YAML text, the path of a file under the repository's root, or None for no file.
    """

    def __init__(self, parameters: str | None, arguments: tuple[str, ...], directory: Path):
        directory.mkdir(parents=True)
        files = []
        if parameters is not None:
            files = ["--params-file", str(ROOT / parameters)]
            if "\n" in parameters:
                files[1] = str(directory / "parameters.yaml")
                Path(files[1]).write_text(parameters)
        self._log = directory / "log.txt"
        command = [sys.executable, "-m", "cloth_sim_ros.ros", "--ros-args", *files, *arguments]
        with self._log.open("w") as log:
            self.process = subprocess.Popen(command, cwd=ROOT, stdout=log, stderr=subprocess.STDOUT)

    @property
    def log(self) -> str:
        """All that it has printed so far."""
        return self._log.read_text()

    def wait_for(self, text: str, timeout: float = 90.0) -> NodeProcess:
        """Waits until it has printed `text`; a first compilation takes a while."""
        for _ in tries(timeout, pause=0.02):
            if text in self.log:
                return self
            assert self.process.poll() is None, f"the node ended with {self.process.returncode}:\n{self.log}"
        raise AssertionError(f"the node never said {text!r}:\n{self.log}")

    def ready(self) -> NodeProcess:
        """Waits until it simulates."""
        return self.wait_for("simulating ")

    def alive(self) -> bool:
        """Whether the process runs."""
        return self.process.poll() is None

    def end(self, number: int = signal.SIGTERM, timeout: float = 15.0) -> int:
        """Ends it with a signal and returns the exit status."""
        if self.alive():
            self.process.send_signal(number)
        try:
            return self.process.wait(patience(timeout))
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise
