# SPDX-License-Identifier: Apache-2.0
"""The thread that simulates: it survives trouble, and its clock keeps deadlines without running after lost time."""

import threading
import time

import pytest
from patience import patience, tries
from scene_values import values

from cloth_sim_ros.ros.time.frame_clock import FrameClock
from cloth_sim_ros.ros.time.loop import SimulationLoop
from cloth_sim_ros.ros.world import World


class Log:
    def __init__(self):
        self.lines = []
        self.info = self.warning = self.error = self.lines.append


def wait_for(condition):
    assert any(condition() for _ in tries(60.0, pause=0.01))


@pytest.fixture
def loop():
    """A running loop over the default scene without colliders, and as loop.sent the simulated time at each sending; as
    loop.paces what it tells each second."""
    log, sent, paces = Log(), [], []
    given = values(device="cpu", colliders=())
    loop = SimulationLoop(
        World(given, log),
        lambda: given,
        lambda *_: None,
        lambda world: sent.append(world.simulated) or 0.0,
        lambda _, pace: paces.append(pace),
        log,
    )
    loop.sent, loop.log, loop.paces = sent, log, paces
    loop.start()
    wait_for(lambda: sent)
    yield loop
    wait_for(lambda: not loop.world.compiling.is_running)
    assert loop.stop()


def test_a_device_error_is_said_and_a_rebuild_mends_it(loop, monkeypatch):
    def broken(self):
        raise RuntimeError("the device is gone")

    with monkeypatch.context() as patch:
        patch.setattr(World, "advance", broken)
        wait_for(lambda: loop.world.sim is None)
    assert any("the device is gone; waiting for a parameter change" in line for line in loop.log.lines)
    assert "the device is gone" in loop.world.trouble
    sent = len(loop.sent)
    loop.rebuild()
    wait_for(lambda: len(loop.sent) > sent + 3)


def test_a_frame_that_waits_for_the_compiler_is_not_told_as_slow(loop, monkeypatch):
    advance, compiler = World.advance, loop.world.compiling.compiler
    monkeypatch.setattr(compiler, "modules", compiler.modules)

    def compiles(self):
        monkeypatch.setattr(World, "advance", advance)
        time.sleep(1.5 * loop.TELL_PERIOD)
        compiler.modules += 1
        return advance(self)

    monkeypatch.setattr(World, "advance", compiles)
    loop.rebuild()
    wait_for(lambda: World.advance is advance)
    loop.paces.clear()
    wait_for(lambda: loop.paces)
    assert loop.paces[0].frames > 1


def test_commands_run_between_frames_and_report_back(loop):
    assert loop.submit(lambda: loop.world.sim.device).result(timeout=patience(10.0)) == "cpu"
    with pytest.raises(ValueError):
        loop.submit(lambda: loop.world.sim.positions("nothing")).result(timeout=patience(10.0))
    loop.paused = True
    loop.submit(lambda: None).result(timeout=patience(10.0))
    before = loop.world.simulated
    loop.submit(loop.step_once).result(timeout=patience(10.0))
    assert loop.world.simulated == pytest.approx(before + 1 / 60)


def test_lateness_is_made_up_for_but_lost_time_is_not():
    clock, stop = FrameClock(0.02), threading.Event()
    begin = time.monotonic()
    for _ in range(10):
        clock.wait(stop)
        time.sleep(0.005)
    assert time.monotonic() - begin >= 10 * 0.02
    time.sleep(0.5)  # 25 periods late, about half of which are lost
    begin, frames = time.monotonic(), 0
    while time.monotonic() - begin < 0.2:
        clock.wait(stop)
        frames += 1
    assert 15 <= frames <= 10 + 13 + 1, "a quarter of a second is caught up with, and no more"


def test_pace_counts_since_the_last_call():
    clock = FrameClock(0.1)
    for work, wait in ((0.001, 0.0005), (0.002, 0.0008), (0.03, 0.02)):
        clock.worked(work, wait, 0.1)
    pace = clock.pace()
    assert pace.frames == 3 and pace.real_time_factor > 1.0
    assert (pace.ms_per_frame, pace.ms_waiting) == pytest.approx((2.0, 0.8))
    assert clock.pace().frames == 0
