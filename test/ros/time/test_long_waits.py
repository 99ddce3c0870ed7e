# SPDX-License-Identifier: Apache-2.0
"""What the simulation's thread is at for long has its sentence; compiling has another one than computing."""

import re

import pytest
from rclpy.logging import get_logger

from cloth_sim_ros.ros.time.long_waits import LongWaits


class Watched:
    """What LongWaits looks at, at any time that a test likes: the loop and the compiler."""

    def __init__(self, capfd):
        self._capfd, self._log = capfd, ""
        self.busy = None
        self.at_work, self.seconds, self.modules = False, 0.0, 0
        self.said = []
        self.waits = LongWaits(self, self, get_logger("waits"), self.said.append)

    @property
    def logged(self) -> list[tuple[str, str]]:
        """Level and sentence of each line of the log."""
        self._log += self._capfd.readouterr().err
        return re.findall(r"\[(INFO|WARN)\] \[.*\] \[waits\]: (.*)", self._log)

    def work(self, what: str, seconds: int, compiling: bool):
        """The loop is at `what` from now on for so long, and is looked at each second."""
        for second in range(seconds):
            self.busy, self.at_work = (what, float(second)), compiling
            self.waits.look()
            self.seconds += compiling
        self.busy, self.at_work = None, False


@pytest.fixture
def watched(ros, capfd):
    return Watched(capfd)


def test_a_build_that_compiles_says_so_and_gives_no_advice(watched):
    watched.modules = 1
    watched.work("building", 200, compiling=True)
    assert watched.said[0] == "compiling kernels, which later starts find ready: 1 module done, 2 s so far"
    assert len(watched.said) == 198 and not any("fewer" in sentence for sentence in watched.said)
    assert [(level, sentence.split(", ")[-1]) for level, sentence in watched.logged] == [
        ("INFO", f"{seconds} s so far") for seconds in (5, 10, 20, 40, 80, 160)
    ]


def test_a_build_that_computes_for_a_minute_is_given_advice(watched):
    watched.work("building", 62, compiling=False)
    assert watched.said[0] == "building the simulation, for 2 s so far"
    assert watched.logged == [
        ("WARN", "building has taken 60 s so far; fewer substeps or iterations, or coarser objects, take less")
    ]


def test_time_of_the_compiler_does_not_count_for_advice(watched):
    watched.work("building", 50, compiling=True)
    watched.busy = ("building", 100.0)  # it has computed since
    watched.waits.look()
    assert watched.said[-1] == "building the simulation, for 100 s so far"
    watched.busy = ("building", 111.0)
    watched.waits.look()
    assert "building has taken 61 s so far; fewer substeps" in watched.said[-1]


def test_each_wait_counts_for_itself(watched):
    for compiling in (True, False, True):
        watched.work("frame", 7, compiling)
        watched.work("", 1, compiling=False)
    told = [(level, sentence.split(",")[0]) for level, sentence in watched.logged]
    compiles = ("INFO", "compiling kernels")
    assert told == [compiles, ("WARN", "frame has taken 5 s so far; fewer substeps or iterations"), compiles]
