# SPDX-License-Identifier: Apache-2.0
"""Signals end the node with status 0, soon and without a traceback, whatever it is doing."""

import signal
import time

import pytest
from node_process import SMALL
from patience import patience


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("when", ["cloth_sim]: building", "cloth_sim]: simulating"])
@pytest.mark.long
def test_signals_end_it(start, number, when):
    node = start(SMALL).wait_for(when)
    begin = time.monotonic()
    assert node.end(number) == 0, node.log
    assert time.monotonic() - begin < patience(5.0)
    assert "Traceback" not in node.log


@pytest.mark.parametrize("when", ["cloth_sim]: building", "cloth_sim]: simulating"])
def test_who_presses_twice_or_more_ends_it_as_well(start, when):
    node = start(SMALL).wait_for(when)
    while node.alive():
        node.process.send_signal(signal.SIGINT)
        time.sleep(0.005)
    assert node.process.returncode == 0, node.log
    assert "Traceback" not in node.log and "KeyboardInterrupt" not in node.log
