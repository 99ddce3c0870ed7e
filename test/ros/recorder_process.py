# SPDX-License-Identifier: Apache-2.0
"""The recorder in a process of its own."""

import signal
import subprocess
import sys
import time

from node_process import ROOT


class Recording:
    """cloth_sim_record in a process of its own."""

    def __init__(self, bag):
        self._bag, self._said = bag, bag.with_suffix(".txt")
        command = [sys.executable, "-m", "cloth_sim_ros.record.recorder", str(bag)]
        with self._said.open("w") as said:
            self.process = subprocess.Popen(command, cwd=ROOT, stdout=said)

    def wait_for(self, text):
        end = time.monotonic() + 60.0
        while text not in self._said.read_text():
            assert time.monotonic() < end, f"it never said {text!r}"
            time.sleep(0.02)

    def end(self):
        self.process.send_signal(signal.SIGINT)
        assert self.process.wait(20.0) == 0
        self.wait_for(f" messages are in {self._bag}")
