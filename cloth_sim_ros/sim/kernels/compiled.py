# SPDX-License-Identifier: Apache-2.0
"""Compiler options of this package's kernels, and a watch on compilation."""

import functools
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import warp as wp

# Without fused multiply-adds a frame on a CPU takes a tenth longer. On a GPU it is at most a twentieth, and with them
# one line of code may round differently in the kernels of one world and of many. All kernels have the same options:
# for others, a process that compiles would read Warp's headers once more, which takes 1.7 s of a core.
OPTIONS = {
    "enable_backward": False,
    "fuse_fp": False,
    "cpu_compiler_flags": f"{wp.config.cpu_compiler_flags} -ffp-contract=fast",
}


def compiled(function: Callable | None = None, **options: Any) -> wp.Kernel | Callable:
    """A Warp kernel of a function, as `wp.kernel` makes it with these options and OPTIONS."""
    if function is None:
        return functools.partial(compiled, **options)
    if options.get("module") == "unique":
        return wp.kernel(function, module_options=OPTIONS, **options)
    wp.set_module_options(OPTIONS, options.get("module") or wp.get_module(function.__module__))
    return wp.kernel(function, **options)


@contextmanager
def loading(kernels: Mapping[wp.Kernel, int], device: wp.Device) -> Iterator[None]:
    """Load the modules of kernels in a thread, beside what is done in the context; each has threads a block.

    So two cores compile at a time.
    """
    with ThreadPoolExecutor(1) as thread:
        loads = [thread.submit(kernel.module.load, device, block) for kernel, block in kernels.items()]
        yield
        for load in loads:
            load.result()


class Compiler:
    """Counts and times Warp's compilations in this process, in any thread.

    modules: number of kernel modules compiled so far, without those from Warp's cache.
    """

    def __init__(self) -> None:
        self.modules = 0
        self._lock = threading.Lock()
        self._at_work = 0  # threads that compile
        self._since = 0.0  # when the first of them began [s]
        self._spent = 0.0  # [s] before

    @property
    def at_work(self) -> bool:
        """True while something is being compiled."""
        return self._at_work > 0

    @property
    def seconds(self) -> float:
        """Total time spent compiling [s]."""
        with self._lock:
            return self._spent + (time.monotonic() - self._since if self._at_work else 0.0)

    def compile(self, make: Callable[[], bool]) -> bool:
        """Call `make`, which compiles a module or finds it in the cache; it returns True if it compiled."""
        with self._lock:
            if self._at_work == 0:
                self._since = time.monotonic()
            self._at_work += 1
        found = False
        try:
            found = make()
        finally:
            with self._lock:
                self.modules += found
                self._at_work -= 1
                if self._at_work == 0:
                    self._spent += time.monotonic() - self._since
        return found


@functools.cache
def watched_compiler() -> Compiler:
    """The compiler of this process, watched from the first call on.

    Warp tells of a module only when it is compiled, as a line of its log. No public function is called before. So
    `Module._compile` is wrapped, which Warp calls for each module that it is about to load.
    """
    compiler, make = Compiler(), wp.Module._compile

    @functools.wraps(make)
    def watched(*given: Any, **options: Any) -> bool:
        return compiler.compile(functools.partial(make, *given, **options))

    wp.Module._compile = watched
    return compiler
