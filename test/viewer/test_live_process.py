# SPDX-License-Identifier: Apache-2.0
"""The commands: cloth_sim_viewer and the demonstration that starts it, each in processes of their own."""

import os
import re
import signal
import subprocess
import sys
import urllib.error
import urllib.request

import pytest
import viser
from client import NEWEST_ONLY
from geometry_msgs.msg import Vector3Stamped
from node_process import ROOT, SMALL
from patience import tries
from websockets.sync.client import connect

ADDRESS = re.compile(r"The page is at http://localhost:(\d+)")


class Command:
    """A command whose output is read while it runs."""

    def __init__(self, tmp_path, *arguments: str):
        self.log = tmp_path / "log.txt"
        with self.log.open("w") as log:
            command = [sys.executable, "-m", *arguments]
            self.process = subprocess.Popen(command, cwd=ROOT, stdout=log, stderr=subprocess.STDOUT, env=os.environ)

    def wait_for(self, pattern: re.Pattern, timeout: float = 60.0) -> re.Match:
        """The first match in what it has printed."""
        for _ in tries(timeout, pause=0.05):
            if found := pattern.search(self.log.read_text()):
                return found
            assert self.process.poll() is None, self.log.read_text()
        raise AssertionError(f"it never said {pattern.pattern}:\n{self.log.read_text()}")

    def end(self) -> int:
        """Its exit status after SIGTERM, which it hands on to what it has started."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        return self.process.wait(20.0)


@pytest.fixture
def command(tmp_path):
    """command(*arguments) -> Command, ended at the end."""
    commands = []

    def run(*arguments: str) -> Command:
        commands.append(Command(tmp_path, *arguments))
        return commands[-1]

    yield run
    for each in commands:
        each.end()


def served(port: str, count: int) -> None:
    """Loads the page, connects as a browser does, and waits for `count` messages."""
    with urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=10.0) as page:
        assert page.status == 200 and b"viser" in page.read().lower()
    with connect(f"ws://127.0.0.1:{port}", subprotocols=[f"viser-v{viser.__version__}"], max_size=None) as socket:
        for _ in range(count):
            assert isinstance(socket.recv(timeout=20.0), bytes)


@pytest.mark.long
def test_the_viewer_serves_its_page_and_ends_with_0(command, start):
    start(SMALL).ready()
    viewer = command("cloth_sim_ros.viewer", "--ros-args", "-p", "port:=18200")
    port = viewer.wait_for(ADDRESS).group(1)
    served(port, 100)
    assert viewer.end() == 0
    assert "Traceback" not in viewer.log.read_text()


def test_two_viewers_have_a_port_each(command):
    first = command("cloth_sim_ros.viewer", "--ros-args", "-p", "port:=18210").wait_for(ADDRESS).group(1)
    second = command("cloth_sim_ros.viewer", "--ros-args", "-p", "port:=18210").wait_for(ADDRESS).group(1)
    assert first != second


def test_the_page_is_served_under_its_allowed_hosts_and_under_no_other_name(command):
    viewer = command("cloth_sim_ros.viewer", "--ros-args", "-p", "port:=18220", "-p", "allowed_hosts:=[robot.example]")
    address = f"http://127.0.0.1:{viewer.wait_for(ADDRESS).group(1)}"
    for host, status in (("robot.example", 200), ("evil.example", 403)):
        try:
            answer = urllib.request.urlopen(urllib.request.Request(address, headers={"Host": host}), timeout=10.0)
        except urllib.error.HTTPError as refused:
            answer = refused
        assert answer.status == status


@pytest.mark.long
@pytest.mark.parametrize(
    ("given", "sentence"),
    [("port:=no", "port"), ("port:=0", "1 to 65535"), ("host:=300.1.1.1", "300.1.1.1"), ("node:='a b'", "is 'a b'")],
)
def test_what_cannot_be_is_told_in_one_sentence(command, given, sentence):
    viewer = command("cloth_sim_ros.viewer", "--ros-args", "-p", given)
    assert viewer.process.wait(30.0) == 1
    printed = viewer.log.read_text().strip()
    assert printed.startswith("cloth_sim_viewer: ") and sentence in printed and "Traceback" not in printed


@pytest.mark.long
def test_the_demonstration_tells_the_page_and_without_is_headless(command):
    demo = command("cloth_sim_ros.demo", "towel", "--seconds", "12")
    served(demo.wait_for(ADDRESS).group(1), 10)
    assert demo.process.wait(90.0) == 0
    headless = command("cloth_sim_ros.demo", "towel", "--seconds", "1", "--headless")
    assert headless.process.wait(90.0) == 0
    assert "The page is at" not in headless.log.read_text()


def test_the_breeze_of_the_demonstration_gives_way_to_a_slider(command, client):
    command("cloth_sim_ros.demo", "curtain", "--headless")
    winds = client.listen(Vector3Stamped, "/cloth_sim/wind", NEWEST_ONLY)
    client.until(lambda: len(winds) > 5, timeout=60.0)
    assert client.set("wind.velocity", [0.0, -5.0, 0.0]).successful
    client.spin(1.0)
    winds.clear()
    client.spin(1.0)
    assert not winds
