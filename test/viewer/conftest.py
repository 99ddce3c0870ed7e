# SPDX-License-Identifier: Apache-2.0
"""A real node in a process of its own and the viewer here, on a ROS domain that no other session uses."""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Callable
from pathlib import Path

os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["PYTHONUNBUFFERED"] = "1"
sys.path.append(str(Path(__file__).parents[1] / "ros"))  # the client and the node of those tests

import pytest
import viser
from patience import tries

if importlib.util.find_spec("rclpy") is None:
    collect_ignore_glob = ["test_live*.py"]


@pytest.fixture(scope="session")
def server():
    """One server for all pages that need no ROS."""
    found = viser.ViserServer(host="127.0.0.1", port=18080, verbose=False)
    from cloth_sim_ros.viewer.look import furnish

    furnish(found)
    yield found
    found.stop()


@pytest.fixture
def open_page(server):
    """open_page(kind) -> the page, which is closed at the end."""
    pages = []

    def make(kind: type):
        pages.append(kind(server))
        return pages[-1]

    yield make
    for page in pages:
        page.close()
        page.remove()


class Viewer:
    """The viewer of the node `target` as `cloth_sim_viewer` runs it, in this process."""

    def __init__(self, target: str):
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node

        from cloth_sim_ros.viewer.live.page import LivePage
        from cloth_sim_ros.viewer.live.remote import Remote
        from cloth_sim_ros.viewer.window import Window

        self.node = Node("cloth_sim_viewer")
        remote = Remote(self.node, target)
        self.window = Window("127.0.0.1", 18090, {LivePage.title: lambda server: LivePage(server, remote)})
        self.node.create_timer(1 / 60, self.window.advance)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)

    @property
    def page(self):
        return self.window.page

    def until(self, condition: Callable[[], bool], timeout: float = 90.0) -> None:
        """Spins until `condition` holds; fails after `patience(timeout)`."""
        for _ in tries(timeout):
            if condition():
                return
            self.spin_once()
        assert condition(), f"waited in vain; the page says: {self.page and self.page.status}"

    def spin_once(self) -> None:
        """One callback, or none within 20 ms."""
        self._executor.spin_once(timeout_sec=0.02)

    def shows(self, *names: str) -> None:
        """Waits until these objects are drawn."""
        self.until(lambda: self.page is not None and set(names) <= set(self.page.drawing.handles))

    def close(self) -> None:
        self.window.close()
        self._executor.shutdown()
        self.node.destroy_node()


@pytest.fixture
def browser_of():
    """browser_of(viewer) -> a Browser that has its page open."""
    from browser import Browser

    browsers = []

    def make(viewer: Viewer):
        browsers.append(Browser(viewer.window.server.get_port()))
        return browsers[-1]

    yield make
    for each in browsers:
        each.close()


@pytest.fixture
def viewer_of(ros):
    """viewer_of(name of a node) -> its viewer; it waits for the node."""
    viewers = []

    def make(target: str) -> Viewer:
        viewers.append(Viewer(target))
        return viewers[-1]

    yield make
    for each in viewers:
        each.close()


@pytest.fixture
def viewer(viewer_of):
    """The viewer of the node under test."""
    return viewer_of("cloth_sim")
