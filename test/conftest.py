# SPDX-License-Identifier: Apache-2.0
"""What tests of several folders share."""

import os
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest
import warp as wp

os.environ.setdefault("CLOTH_SIM_SPEED", "1")  # else what a budget pays would differ by machine


def pytest_generate_tests(metafunc):
    """Tests that take a device run on every one that there is."""
    if "device" in metafunc.fixturenames:
        wp.init()
        metafunc.parametrize("device", ["cpu", *(["cuda:0"] if wp.is_cuda_available() else [])], scope="session")


@pytest.hookimpl(tryfirst=True)
def pytest_pycollect_makemodule(module_path, parent):
    """A module of tests is one, and no launch test.

    launch_testing of ROS imports each file to find that out. The first one that skips itself would end the collection.
    """
    return pytest.Module.from_parent(parent, path=module_path)


@pytest.hookimpl(trylast=True)
def pytest_sessionstart(session):
    """Tells every half minute how many kernel modules were compiled since, as no test ends meanwhile."""
    reporter, begin = session.config.pluginmanager.get_plugin("terminalreporter"), time.time()
    if reporter is None or hasattr(session.config, "workerinput"):
        return

    def tell() -> None:
        told = done = 0
        while not ended.wait(30.0):
            cache = Path(wp.config.kernel_cache_dir or "")
            with suppress(FileNotFoundError):  # who compiles renames a folder when it is done
                done = sum(each.stat().st_mtime > begin for each in cache.iterdir())
            if done > told:
                told = done
                reporter.write_line(f"\ncompiling: {done} kernel modules so far, which later runs find ready")

    wp.config.log_level = wp.LOG_WARNING
    wp.init()
    ended = threading.Event()
    session.config.add_cleanup(ended.set)
    threading.Thread(target=tell, daemon=True).start()


def pytest_collection_modifyitems(items):
    """What waits for real processes runs once more where it fails, as a busy machine may starve one; the summary names
    it."""
    for item in items:
        if item.path.relative_to(Path(__file__).parent).parts[0] in ("ros", "viewer"):
            item.add_marker(pytest.mark.flaky(reruns=1))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup():
    """TESTS_END, in seconds since 1970, is when no test starts any more; the summary of `-rs` counts those left out."""
    if time.time() > float(os.environ.get("TESTS_END", "inf")):
        pytest.skip("no time is left before TESTS_END")


@pytest.fixture(scope="session", autouse=True)
def quiet():
    """Warp reports every kernel that it compiles; a test's output is for what fails."""
    wp.config.log_level = wp.LOG_WARNING


@pytest.fixture(scope="session")
def ros():
    """An initialised rclpy, once in a process: tests of the node and of the viewer may share one."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    yield
    rclpy.shutdown()


@pytest.fixture
def client(ros):
    """A node to publish, subscribe and call services with."""
    from client import Client

    node = Client()
    yield node
    node.destroy()


@pytest.fixture
def start(tmp_path):
    """Starts nodes on YAML text or files, and ends them: start(yaml_or_path, *arguments) -> NodeProcess."""
    from node_process import NodeProcess

    processes = []

    def launch(parameters: str | None, *arguments: str) -> NodeProcess:
        processes.append(NodeProcess(parameters, arguments, tmp_path / f"node{len(processes)}"))
        return processes[-1]

    yield launch
    for process in processes:
        process.end()
