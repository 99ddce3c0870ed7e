# SPDX-License-Identifier: Apache-2.0
"""The thread that simulates: it runs commands as a frame starts, advances, sends, and sleeps until the next is due."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from cloth_sim_ros.ros.time.clock_follower import ClockFollower
from cloth_sim_ros.ros.time.frame_clock import FrameClock
from cloth_sim_ros.ros.world import World

PATIENCE = 5.0  # [s] a service waits for the simulation, which may be compiling


class SimulationLoop:
    """Runs `world` in a thread of its own.

    send(world) is called after every frame, also while paused. It waits until the device is done, so that frames never
    pile up there, and returns the time waited [s]. tell(world, pace) is called once a second, and built(world, ok)
    after each attempt to build. values() returns the parameter values to build from. All are called in this thread.
    While `follower` is active, frames are due by /clock and not by the wall clock.
    """

    TELL_PERIOD = 1.0  # [s]

    def __init__(
        self,
        world: World,
        values: Callable[[], dict[str, Any]],
        built: Callable[[World, bool], None],
        send: Callable[[World], float],
        tell: Callable[..., None],
        log: Any,
        follower: ClockFollower | None = None,
    ):
        self.world = world
        self.paused = False
        self._values, self._built, self._send, self._tell, self._log = values, built, send, tell, log
        self._commands: queue.SimpleQueue[tuple[Callable[[], Any], Future]] = queue.SimpleQueue()
        self._rebuild = threading.Event()
        self._stop = threading.Event()
        self._rebuild.set()
        self._clock, self._follower = FrameClock(self._period()), follower
        self._busy: tuple[str, float] | None = None
        self._next_tell = time.monotonic() + self.TELL_PERIOD
        self._thread = threading.Thread(target=self._run, name="simulation", daemon=True)

    def start(self) -> None:
        """Start the thread, which builds the simulation first."""
        self._thread.start()

    def stop(self, timeout: float = 2.0) -> bool:
        """End the thread after the current frame.

        Returns False if that takes longer than `timeout` [s] or kernels are being compiled.
        """
        self._stop.set()
        self._thread.join(timeout)
        return not self._thread.is_alive() and not self.world.compiling.is_running

    def submit(self, command: Callable[[], Any]) -> Future:
        """Run `command` at the start of the next frame; the future holds its result."""
        future: Future = Future()
        self._commands.put((command, future))
        return future

    def rebuild(self) -> None:
        """Build the simulation anew at the start of the next frame, once for any number of calls."""
        self._rebuild.set()

    @property
    def busy(self) -> tuple[str, float] | None:
        """Current work, "building" or "frame", and its duration so far [s]; None between frames."""
        busy = self._busy
        return busy and (busy[0], time.monotonic() - busy[1])

    def step_once(self) -> None:
        """Simulate one frame while paused; to be submitted."""
        if self.world.sim is not None:
            self.world.advance()

    def build(self) -> None:
        """Build the simulation anew at once; to be submitted."""
        self._rebuild.clear()
        self._busy = "building", time.monotonic()
        self._built(self.world, self.world.build(self._values()))
        self._count_anew()

    def _count_anew(self) -> None:
        self._clock.restart(self._period())
        self._next_tell = time.monotonic() + self.TELL_PERIOD

    def _period(self) -> float:
        sim = self.world.sim
        return sim.settings.frame_dt if sim is not None else 1.0 / self._values()["rate"]

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self._frame()
                if time.monotonic() >= self._next_tell:
                    self._next_tell = time.monotonic() + self.TELL_PERIOD
                    self._tell(self.world, self._clock.pace())
            except Exception as error:  # a device error must not silence the node: say so and wait to be mended
                self.world.fail(f"the simulation stopped: {type(error).__name__}: {error}")
            self._busy = None
            if self._by_clock():
                self._follower.wait()
            else:
                self._clock.wait(self._stop)

    def _by_clock(self) -> bool:
        return self._follower is not None and self._follower.active

    def _frame(self) -> None:
        if self._rebuild.is_set():
            self.build()
        self._run_commands()
        if self.world.sim is None or self._by_clock() and not self._follower.due(self._period()):
            return
        begin, compiled = time.monotonic(), self.world.compiling.compiler.modules
        self._busy = "frame", begin
        simulated = 0.0 if self.paused else self.world.advance()
        waited = self._send(self.world)
        self._clock.worked(time.monotonic() - begin, waited, simulated)
        if self.world.compiling.compiler.modules > compiled and time.monotonic() - begin > FrameClock.MOST_BEHIND:
            self._count_anew()  # a wait for the compiler says nothing of the scene's pace

    def _run_commands(self) -> None:
        while not self._commands.empty():
            command, future = self._commands.get()
            try:
                future.set_result(command())
            except Exception as error:
                future.set_exception(error)
                self._log.error(f"a command failed: {error}")
