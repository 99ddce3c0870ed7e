# SPDX-License-Identifier: Apache-2.0
"""A state is saved, the node is killed, and another goes on from it to the bits of one that was never stopped."""

import os
import signal

import all_inputs
import pytest
from client import LATCHED, Client
from geometry_msgs.msg import Vector3Stamped
from node_process import SMALL
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker, MarkerArray

SCENE = f"""{all_inputs.SCENE}    publish_clock: true
    hand: {{position: [-0.3, -0.25, 1.0], reach: [0.06]}}
"""
CHANGED = {
    "cloth.stretch_compliance": 2e-3,
    "cloth.mass": 0.3,
    "cable.end_mass": 0.2,
    "cloth.pins": [35, 39],
    "gravity": [0.1, 0.0, -9.7],
    "solver.global_damping": 0.3,
    "ball.position": [0.02, 0.0, 0.86],
    "ball.static_friction": 0.9,
    "cable.winch.longest": 0.9,
}
OBJECTS = ("cloth", "cable")


class Paused:
    """A node on SCENE that simulates frames when it is told to, and a client that has never met another."""

    def __init__(self, start):
        self.node, self.client = start(SCENE).ready(), Client()
        self._clouds = {name: self.client.listen(PointCloud2, f"/cloth_sim/{name}/particles", 1) for name in OBJECTS}
        self._shown = self.client.listen(MarkerArray, "/cloth_sim/colliders", LATCHED)
        self._scene = self.client.node.create_publisher(MarkerArray, "/cloth_sim/scene", 10)
        self.client.until(lambda: self._scene.get_subscription_count() > 0)
        assert self.client.call(SetBool, "/cloth_sim/pause", SetBool.Request(data=True)).success

    def kill(self):
        self.node.end(signal.SIGKILL)
        self.client.destroy()

    def ask(self, service):
        answer = self.client.call(Trigger, f"/cloth_sim/{service}")
        assert "\n" not in answer.message
        return answer

    def done(self, service):
        answer = self.ask(service)
        assert answer.success, answer.message
        return answer.message

    def step(self, frames):
        for _ in range(frames):
            self.done("step")

    def clouds(self):
        """The bytes of every object, sent after all that was asked for is done."""
        for each in self._clouds.values():
            each.clear()
        self.client.until(lambda: all(len(each) > 2 for each in self._clouds.values()))
        return {name: bytes(each[-1].data) for name, each in self._clouds.items()}

    def box(self, action):
        """Adds a collider by topic, or takes it away, and waits until that is done."""
        self._scene.publish(all_inputs.box(action))
        self.client.until(lambda: ("box/3" in {each.ns for each in self._shown[-1].markers}) == (action == Marker.ADD))


def say(client, topic, message):
    client.publish(f"/cloth_sim/{topic}", message)
    client.spin(0.3)


def tell(paused):
    """All inputs there are, some frames apart."""
    client = paused.client
    paused.done("reset")
    paused.step(5)
    for name, value in CHANGED.items():
        assert client.set(name, value).successful
    assert client.call(SetBool, "/cloth_sim/handles/hand/attach", SetBool.Request(data=True)).success
    paused.box(Marker.ADD)
    wind = Vector3Stamped()
    wind.header.frame_id, wind.vector.y = "world", 3.0
    say(client, "wind", wind)
    paused.step(4)
    say(client, "cable/winch", Float64(data=0.8))
    paused.step(6)


def go_on(paused):
    """What comes after the state was saved."""
    assert paused.client.set("ball.position", [0.0, 0.03, 0.9]).successful
    paused.step(5)
    paused.box(Marker.DELETE)
    paused.step(10)  # the winch has no command any longer
    return paused.clouds()


@pytest.fixture
def home(tmp_path, monkeypatch):
    """The folder in which the node keeps its file."""
    monkeypatch.setenv("ROS_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


@pytest.mark.long
def test_a_killed_node_goes_on_where_it_was_saved(start, ros, home):
    first = Paused(start)
    tell(first)
    file = home / "cloth_sim_state.npz"
    assert first.done("save") == f"the state at 0.25 s is saved in {file}"
    at_save = first.clouds()
    never_stopped = go_on(first)
    assert at_save["cloth"] != never_stopped["cloth"] and at_save["cable"] != never_stopped["cable"]
    first.kill()

    second = Paused(start)
    client = second.client
    second.step(3)
    assert second.done("load") == f"the simulation goes on at 0.25 s from {file}"
    assert second.clouds() == at_save
    for name, value in CHANGED.items():
        assert client.get(name) == pytest.approx(value) if name != "cloth.pins" else list(client.get(name)) == value
    assert client.get("hand.attached") is True
    assert list(client.get("wind.velocity")) == [0, 0, 0] and client.get("cable.winch.pay_out") == 0.0
    assert go_on(second) == never_stopped
    refuse_what_is_no_state(second, file)
    second.done("load")
    assert second.clouds() == at_save, "the same node goes back too"
    assert go_on(second) == never_stopped
    for word in ("put back", "accepted but not applied", "cannot follow", "a command failed", "Traceback"):
        assert word not in second.node.log, word
    client.destroy()


def refuse_what_is_no_state(paused, file):
    """A refused file changes nothing, and the answer says what is wrong with it."""
    client = paused.client
    before, content = paused.clouds(), file.read_bytes()
    bad = file.with_name("bad.npz")
    assert client.set("state_file", "bad.npz").successful
    assert f"{bad} cannot be read: No such file or directory; allowed is" in refused(paused)
    bad.write_bytes(content[: len(content) // 2])
    assert f"{bad} is damaged or cut short: " in refused(paused)
    bad.write_text("objects: [cloth]\n")
    assert f"{bad} is no saved state of cloth_sim_ros; allowed is" in refused(paused)
    bad.unlink()
    os.mkfifo(bad)
    assert f"{bad} cannot be read: a FIFO is there, and no regular file; allowed is" in refused(paused)
    assert paused.clouds() == before
    assert client.set("state_file", str(file)).successful
    set_radius(paused, 0.3)
    assert "collider ball is a Sphere" in refused(paused)
    set_radius(paused, 0.15)
    assert client.set("state_file", "/proc/x.npz").successful
    answer = paused.ask("save")
    assert not answer.success and "/proc/x.npz cannot be written" in answer.message
    assert client.set("state_file", str(file)).successful


def set_radius(paused, radius):
    built = paused.node.log.count("simulating ")
    assert paused.client.set("ball.dimensions", [radius]).successful
    paused.client.until(lambda: paused.node.log.count("simulating ") > built)
    paused.clouds()  # it is no longer busy


def refused(paused):
    answer = paused.ask("load")
    assert not answer.success and "; allowed" in answer.message
    return answer.message


def test_only_saved_states_are_replaced_and_only_the_home_is_made(start, client, tmp_path, monkeypatch):
    home = tmp_path / "home"
    monkeypatch.setenv("ROS_HOME", str(home))
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    start(SMALL).ready()
    assert not home.exists()

    def save(path):
        assert client.set("state_file", str(path)).successful
        answer = client.call(Trigger, "/cloth_sim/save")
        assert "\n" not in answer.message
        return answer

    assert save("state.npz").success and save("state.npz").success
    thesis = home / "thesis.odt"
    thesis.write_text("ten years of work")
    answer = save("thesis.odt")
    assert (
        not answer.success and f"{thesis} cannot be written: a file that is no saved state is there" in answer.message
    )
    assert thesis.read_text() == "ten years of work"
    for place in ("below/x.npz", tmp_path / "elsewhere/x.npz"):
        assert "cannot be written: No such file or directory" in save(place).message
    assert not (home / "below").exists() and not (tmp_path / "elsewhere").exists()


def test_a_home_that_is_not_known_is_told(start, client, tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_HOME", "~nobody-of-this-name")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    start(SMALL).ready()
    for service in ("save", "load"):
        answer = client.call(Trigger, f"/cloth_sim/{service}")
        assert not answer.success and "~nobody-of-this-name is in a home that nobody has; allowed are" in answer.message
