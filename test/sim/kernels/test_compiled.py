# SPDX-License-Identifier: Apache-2.0
"""What Warp compiles is seen while it does, in any thread."""

import threading
import time

import pytest
import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.kernels.compiled import Compiler, compiled, watched_compiler


@pytest.fixture
def empty_cache(tmp_path):
    """Warp has compiled nothing so far."""
    before, wp.config.kernel_cache_dir = wp.config.kernel_cache_dir, str(tmp_path)
    yield
    wp.config.kernel_cache_dir = before


def fill(number: float) -> wp.Kernel:
    """A kernel in a module of its own."""

    @compiled(module="unique")
    def fill_rows(rows: wp.array(dtype=float)):
        rows[wp.tid()] = wp.static(number)

    return fill_rows


def test_a_module_counts_where_it_is_compiled_and_not_where_it_was(empty_cache):
    compiler, rows = watched_compiler(), wp.zeros(3, dtype=float, device="cpu")
    assert watched_compiler() is compiler
    modules, seconds = compiler.modules, compiler.seconds
    wp.launch(fill(1.25), dim=3, inputs=[rows], device="cpu")
    assert rows.numpy().tolist() == [1.25] * 3
    assert compiler.modules == modules + 1 and compiler.seconds > seconds and not compiler.at_work
    again = fill(1.25)
    again.module.unload()
    wp.launch(again, dim=3, inputs=[rows], device="cpu")
    assert compiler.modules == modules + 1


def test_it_is_at_work_while_another_thread_compiles(empty_cache):
    compiler, rows = watched_compiler(), wp.zeros(3, dtype=float, device="cpu")
    seen, launch = [], threading.Thread(target=wp.launch, args=(fill(2.5), 3, [rows]), kwargs={"device": "cpu"})
    launch.start()
    while launch.is_alive():
        seen.append(compiler.at_work)
    assert any(seen) and not compiler.at_work


def test_two_threads_at_once_are_counted_as_one():
    compiler, ends = Compiler(), [threading.Event(), threading.Event()]
    threads = [threading.Thread(target=compiler.compile, args=(end.wait,)) for end in ends]
    begin = time.monotonic()
    for thread in threads:
        thread.start()
    for end, thread in zip(ends, threads, strict=True):
        assert compiler.at_work
        end.set()
        thread.join()
    assert not compiler.at_work and compiler.modules == 2
    assert 0.0 < compiler.seconds <= time.monotonic() - begin


def test_what_cannot_be_compiled_is_not_counted():
    compiler = Compiler()

    def fail():
        raise RuntimeError("no compiler")

    with pytest.raises(RuntimeError, match="no compiler"):
        compiler.compile(fail)
    assert not compiler.at_work and compiler.modules == 0


def test_what_stages_are_given_compiles_fast_on_a_gpu():
    """Beyond 8192 bytes of arguments NVRTC takes minutes for a kernel instead of seconds."""
    assert wp.types.type_size_in_bytes(Context) <= 8192
