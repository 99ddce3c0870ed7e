# SPDX-License-Identifier: Apache-2.0
"""The handlers of simulation_interfaces in a real node. Without the package: messages are objects with its fields."""

import importlib.util
import inspect
import sys
from functools import partial
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import Accel, Pose, PoseStamped, Twist, Vector3
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from std_msgs.msg import Header

from cloth_sim_ros.ros.node import ClothSimNode
from cloth_sim_ros.ros.standard import offer, replies, running, spawning
from cloth_sim_ros.ros.standard.entities import BOX, OBJECT, ROBOT, SPHERE, STATIC_OBJECT, _matching

SCENE = {
    "device": "cpu",
    "objects": ["cloth"],
    "colliders": ["ground"],
    "handles": ["hand"],
    "spare_colliders": 2,
    "cloth.resolution": [6, 5],
    "cloth.position": [0.0, 0.0, 2.0],
    "ground.shape": "plane",
    "hand.position": [3.0, 0.0, 0.0],
}
SHEET = "{type: cloth, resolution: [6, 5], size: [0.2, 0.4], pins: none}"
LINE = "{type: rope, start: [0, 0, 0], end: [0.5, 0, 0], segments: 7, pins: none}"
CRATE = "{shape: box, dimensions: [0.2, 0.4, 0.6]}"
TURNED = Pose()
TURNED.position.x, TURNED.position.y, TURNED.position.z = 0.5, -0.25, 1.0
TURNED.orientation.x, TURNED.orientation.y, TURNED.orientation.z, TURNED.orientation.w = 0.1, -0.5, 0.7, 0.5
EMPTY = SimpleNamespace(type=0, points=[])


def result():
    return SimpleNamespace(result=99, error_message="")


def response(**fields):
    return SimpleNamespace(result=result(), **fields)


def state(pose=None, twist=None):
    return SimpleNamespace(header=Header(), pose=pose or Pose(), twist=twist or Twist(), acceleration=Accel())


class Caller:
    """Calls handlers of a node as its executor does."""

    def __init__(self, **changes):
        overrides = [Parameter(name, value=value) for name, value in {**SCENE, **changes}.items()]
        self.node = ClothSimNode(parameter_overrides=overrides)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.running, self.entities = self.node.standard.running, self.node.standard.entities
        self.spawner, self.loop = self.node.standard.spawner, self.node._loop
        self.run(self.node.standard.running._ask.at_length, lambda: None)  # it is built
        self.loop.paused = True
        self.calls(self.running.reset, scope=0)

    def run(self, coroutine, *arguments):
        task = self.executor.create_task(coroutine, *arguments)
        self.executor.spin_until_future_complete(task, timeout_sec=120.0)
        assert task.done(), "waited in vain"
        return task.result()

    def call(self, handler, answer=None, **request):
        """The response of a handler."""
        return self.run(replies.replying(handler), SimpleNamespace(**request), answer or response())

    def calls(self, handler, answer=None, code=replies.OK, **request):
        """The same, where the result is known."""
        found = self.call(handler, answer, **request)
        assert found.result.result == code, found.result.error_message
        assert found.result.error_message or code == replies.OK
        return found

    def spawn(self, text, name="thing", code=replies.OK, old=False, uri="", **more):
        """SpawnEntity, with fields of 2.x or of an old version."""
        text = {"uri": uri, "resource_string": text}
        resource = text if old else {"entity_resource": SimpleNamespace(**text)}
        fields = {"allow_renaming": False, "entity_namespace": "", "initial_pose": PoseStamped(), **more}
        return self.calls(self.spawner.spawn, response(entity_name=""), code, name=name, **fields, **resource)

    def names(self, **filters):
        """GetEntities."""
        filters = {
            "filter": "",
            "categories": [],
            "tags": SimpleNamespace(tags=[], filter_mode=0),
            "bounds": EMPTY,
        } | filters
        found = response(entities=[])
        return self.calls(self.entities.get_all, found, filters=SimpleNamespace(**filters)).entities

    def state(self, name):
        """GetEntityState."""
        return self.calls(self.entities.get_state, response(state=state()), entity=name).state

    @property
    def number(self):
        answer = SimpleNamespace(result=result(), state=SimpleNamespace(state=99))
        return self.calls(self.running.get_state, answer).state.state

    @property
    def simulated(self):
        return round(60 * self.loop.world.simulated)


@pytest.fixture(scope="module")
def shared(ros):
    caller = Caller()
    yield caller
    caller.node.stop()
    caller.executor.shutdown()
    caller.node.destroy_node()


@pytest.fixture
def caller(shared):
    """Paused at the start, and nothing spawned."""
    shared.loop.paused = True
    shared.calls(shared.running.reset, scope=0)
    return shared


def numbers(message):
    """A pose, or a vector, as an array."""
    parts = (message.position, message.orientation) if isinstance(message, Pose) else (message,)
    return np.array([getattr(part, axis) for part in parts for axis in "xyzw" if hasattr(part, axis)])


@pytest.mark.skipif(importlib.util.find_spec("simulation_interfaces") is not None, reason="the package is there")
def test_without_the_package_the_node_offers_nothing_of_it(caller):
    services = {name for name, _ in caller.node.get_service_names_and_types()}
    assert "/cloth_sim/reset" in services and "/cloth_sim/reset_simulation" not in services


def test_services_are_those_that_a_version_has(caller, monkeypatch):
    services, actions = {}, []
    package = ModuleType("simulation_interfaces")
    package.msg = package.action = SimpleNamespace(SimulateSteps=None)
    package.srv = SimpleNamespace(GetSimulatorFeatures=object, GetEntityState=object, SpawnEntity=object)
    monkeypatch.setitem(sys.modules, "simulation_interfaces", package)
    monkeypatch.setattr(offer, "ActionServer", lambda *arguments, **named: actions.append(arguments))
    serve = lambda kind, name, callback, callback_group: services.update({name: callback})  # noqa: E731
    offer.offer(SimpleNamespace(create_service=serve), caller.node.standard)
    assert set(services) == {"~/get_simulator_features", "~/get_entity_state", "~/spawn_entity"}
    _, _, name, execute = actions[0]
    assert name == "~/simulate_steps"
    for callback in (execute, *services.values()):
        assert inspect.iscoroutinefunction(callback), "rclpy would not await it"


def test_features_are_those_that_a_version_knows(caller):
    features = SimpleNamespace(SPAWNING=0, SIMULATION_RESET_STATE=22, SIMULATION_RESET_TIME=21, features=[])
    caller.run(caller.running.get_features, None, SimpleNamespace(features=features))
    assert features.features == [0, 22] and features.spawn_formats == ["yaml"]


def test_states_and_transitions(caller):
    def wish(wanted, code=replies.OK):
        caller.calls(caller.running.set_state, code=code, state=SimpleNamespace(state=wanted))
        return caller.number

    assert caller.number == running.STOPPED
    assert wish(running.PAUSED, running.INCORRECT_TRANSITION) == running.STOPPED
    assert wish(running.PLAYING) == running.PLAYING
    assert wish(running.PLAYING, running.ALREADY) == running.PLAYING
    caller.run(caller.running._ask.at_length, lambda: None)
    caller.run(caller.running._ask.at_length, lambda: None)  # a frame lies between
    assert wish(running.PAUSED) == running.PAUSED and caller.loop.paused
    assert wish(3, replies.UNSUPPORTED) == running.PAUSED
    assert wish(running.STOPPED) == running.STOPPED
    assert np.ptp(caller.loop.world.sim.positions("cloth")[:, 2]) < 1e-6, "back at the start"


@pytest.mark.parametrize("count", [0, 1, 7, 150])
def test_steps_are_counted_exactly(caller, count):
    before = caller.simulated
    caller.calls(caller.running.step, steps=count)
    assert caller.simulated - before == count


@pytest.mark.parametrize("wanted", [running.PLAYING, running.STOPPED])
def test_steps_are_refused_while_it_runs_and_end_where_another_state_is_set(caller, wanted):
    caller.loop.paused = False
    refused = caller.calls(caller.running.step, code=replies.FAILED, steps=1)
    assert "pause it first" in refused.result.error_message
    caller.loop.paused = True
    long = caller.executor.create_task(
        replies.replying(caller.running.step), SimpleNamespace(steps=1 << 60), response()
    )
    while caller.loop.world.is_at_start:
        caller.executor.spin_once(timeout_sec=0.1)
    caller.calls(caller.running.set_state, state=SimpleNamespace(state=wanted))
    caller.executor.spin_until_future_complete(long, timeout_sec=60.0)
    assert long.result().result.result == replies.FAILED and "set to run or reset" in long.result().result.error_message


def test_the_action_tells_of_each_step_and_can_be_canceled(caller):
    class Goal:
        request, is_cancel_requested, ended, most = SimpleNamespace(steps=40), False, "", 1000

        def __init__(self):
            self.told = []

        def publish_feedback(self, feedback):
            self.told.append((feedback.completed_steps, feedback.remaining_steps))
            self.is_cancel_requested = len(self.told) >= self.most

    before, goal = caller.simulated, Goal()
    for how in ("succeed", "abort", "canceled"):
        setattr(goal, how, partial(setattr, goal, "ended", how))
    found = caller.run(caller.running.simulate_steps, goal, SimpleNamespace(), response())
    assert goal.ended == "succeed" and found.result.result == replies.OK
    assert goal.told == [(k, 40 - k) for k in range(1, 41)] and caller.simulated - before == 40
    goal.most, goal.request = 41, SimpleNamespace(steps=1 << 60)
    found = caller.run(caller.running.simulate_steps, goal, SimpleNamespace(), response())
    assert goal.ended == "canceled" and "canceled after" in found.result.error_message


def test_resets_by_scope(caller):
    caller.spawn(SHEET)
    caller.spawn(CRATE, "crate")
    caller.calls(caller.running.step, steps=5)
    time = caller.simulated
    for scope in (running.SCOPE_TIME, 3, 8):
        caller.calls(caller.running.reset, code=replies.UNSUPPORTED, scope=scope)
    assert caller.number == running.PAUSED
    caller.calls(caller.running.reset, scope=running.SCOPE_STATE)
    assert caller.number == running.STOPPED and {"thing", "crate"} <= {*caller.names()}
    caller.calls(caller.running.reset, scope=running.SCOPE_SPAWNED)
    assert caller.names() == ["cloth", "ground", "hand"] and caller.simulated == time


@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize("text", [SHEET, pytest.param(LINE, marks=pytest.mark.long), CRATE])
def test_what_is_spawned_is_where_it_was_wanted_and_goes(caller, text, old):
    wanted = PoseStamped(pose=TURNED)
    wanted.header.stamp.sec = -7  # the standard has it ignored
    assert caller.spawn(text, initial_pose=wanted, old=old).entity_name == "thing"
    assert numbers(caller.state("thing").pose) == pytest.approx(numbers(TURNED), abs=1e-5)
    caller.calls(caller.spawner.delete, entity="thing")
    caller.calls(caller.spawner.delete, code=replies.NOT_FOUND, entity="thing")
    assert caller.names() == ["cloth", "ground", "hand"]


def test_a_spawned_cloth_has_parameters_and_topics_and_the_others_go_on(caller):
    caller.calls(caller.running.step, steps=10)
    before = caller.loop.world.sim.positions("cloth")
    caller.spawn(SHEET)
    assert np.array_equal(caller.loop.world.sim.positions("cloth"), before)
    assert list(caller.node.get_parameter("thing.size").value) == [0.2, 0.4]
    assert caller.node.set_parameters([Parameter("thing.mass", value=0.5)])[0].successful
    fixed = caller.node.set_parameters([Parameter("thing.type", value="rope")])[0]
    assert not fixed.successful and "fixed" in fixed.reason
    topics = {name for name, _ in caller.node.get_topic_names_and_types()}
    assert {"/cloth_sim/thing/particles", "/cloth_sim/thing/mesh", "/cloth_sim/thing/topology"} <= topics
    caller.calls(caller.spawner.delete, entity="thing")
    assert not caller.node.has_parameter("thing.size")
    own = {publisher.topic_name for publisher in caller.node.publishers}
    assert not any("/thing/" in name for name in own) and np.array_equal(
        caller.loop.world.sim.positions("cloth"), before
    )


def test_names_and_resources_are_refused_with_the_codes_of_the_standard(caller):
    caller.spawn(SHEET)
    for text, name, code in (
        (SHEET, "thing", spawning.NAME_NOT_UNIQUE),
        (SHEET, "cloth", spawning.NAME_NOT_UNIQUE),
        (SHEET, "", spawning.NAME_INVALID),
        (SHEET, "a b", spawning.NAME_INVALID),
        (SHEET, "solver", spawning.NAME_INVALID),
        ("", "new", spawning.NO_RESOURCE),
        ("<sdf/>", "new", spawning.UNSUPPORTED_FORMAT),
        ("{type: [", "new", spawning.PARSE_ERROR),
        ("[1, 2]", "new", spawning.PARSE_ERROR),
        ("{type: &a {x: 1}, mass: *a}", "new", spawning.PARSE_ERROR),
        ("{type: tetrahedra}", "new", spawning.PARSE_ERROR),
        ("{type: cloth, mas: 1}", "new", spawning.PARSE_ERROR),
        ("{type: cloth, mass: -1}", "new", spawning.PARSE_ERROR),
        ("{type: cloth, mesh: /nowhere.obj}", "new", spawning.MISSING_ASSETS),
        ("{shape: box, dimensions: [1]}", "new", spawning.PARSE_ERROR),
        ("{shape: capsule, dimensions: [1, 1]}", "new", replies.FAILED),
    ):
        caller.spawn(text, name, code)
    caller.spawn("", "new", spawning.UNSUPPORTED_FORMAT, uri="file:///towel.yaml")
    caller.spawn(SHEET, "new", replies.UNSUPPORTED, entity_namespace="robot")
    lost = PoseStamped()
    lost.pose.orientation.w = 0.0
    caller.spawn(SHEET, "new", spawning.INVALID_POSE, initial_pose=lost)
    assert caller.spawn(SHEET, "thing", allow_renaming=True).entity_name == "thing_1"
    assert caller.spawn(f"towel: {SHEET}", "").entity_name == "towel"
    assert caller.names() == ["cloth", "thing", "thing_1", "towel", "ground", "hand"]
    caller.calls(caller.spawner.delete, code=replies.FAILED, entity="cloth")
    caller.spawn(CRATE, "one"), caller.spawn(CRATE, "two")
    assert "spare_colliders" in caller.spawn(CRATE, "three", replies.FAILED).result.error_message


def test_several_are_spawned_in_one_build_with_a_result_each(caller, monkeypatch):
    builds, build = [], caller.loop.world.build
    monkeypatch.setattr(caller.loop.world, "build", lambda values: builds.append(values) or build(values))
    asked = [
        SimpleNamespace(
            name=name,
            allow_renaming=False,
            entity_namespace="",
            initial_pose=PoseStamped(),
            entity_resource=SimpleNamespace(uri="", resource_string=text),
        )
        for name, text in (("one", SHEET), ("cloth", SHEET), ("two", LINE), ("crate", CRATE))
    ]
    make = partial(response, entity_name="")
    found = caller.calls(
        partial(caller.spawner.spawn_all, make), response(results=[]), spawning.SPAWN_FAILED, spawn_requests=asked
    )
    codes = [replies.OK, spawning.NAME_NOT_UNIQUE, replies.OK, replies.OK]
    assert [each.result.result for each in found.results] == codes and len(builds) == 1
    assert caller.names() == ["cloth", "one", "two", "ground", "crate", "hand"]


def test_what_the_simulation_cannot_have_is_taken_away_again(caller, monkeypatch):
    monkeypatch.setattr(caller.loop.world, "build", lambda values: False)
    before = dict(caller.node._bridge.values)
    caller.spawn(SHEET, code=replies.FAILED)
    assert caller.node._bridge.values == before and not caller.node.has_parameter("thing.size")
    assert caller.names() == ["cloth", "ground", "hand"]


def test_twenty_cloths_come_and_go(caller):
    before = len(list(caller.node.publishers)), len(caller.node._bridge.rows)
    for k in range(20):
        caller.spawn(yaml.safe_dump({"type": "cloth", "resolution": [4, 4], "position": [0.0, 0.0, 0.1 * k]}), f"c{k}")
    assert len(caller.names(filter="^c[0-9]+$")) == 20
    caller.calls(caller.running.step, steps=3)
    for k in range(20):
        caller.calls(caller.spawner.delete, entity=f"c{k}")
    assert caller.names(filter="^c[0-9]") == []
    assert (len(list(caller.node.publishers)), len(caller.node._bridge.rows)) == before


@pytest.mark.parametrize("flags", [{}, {"set_pose": True, "set_twist": True, "set_acceleration": False}])
def test_the_state_that_is_set_is_the_state_that_is_there(caller, flags):
    caller.spawn(SHEET)
    twist = Twist(linear=Vector3(x=0.1, y=-0.2, z=0.3), angular=Vector3(x=1.0, y=2.0, z=-0.5))
    caller.calls(caller.entities.set_state, entity="thing", state=state(TURNED, twist), **flags)
    found = caller.state("thing")
    assert numbers(found.pose) == pytest.approx(numbers(TURNED), abs=1e-5)
    assert numbers(found.twist.linear) == pytest.approx([0.1, -0.2, 0.3], abs=1e-4)
    assert numbers(found.twist.angular) == pytest.approx([1.0, 2.0, -0.5], abs=1e-3)
    assert found.header.frame_id == "world"
    lengths = caller.loop.world.sim.report()["thing"]["max_strain"]
    assert abs(lengths) < 1e-4, "it went as a whole"


def test_what_flags_leave_out_stays(caller):
    before = numbers(caller.state("cloth").pose)
    flags = {"set_pose": False, "set_twist": True, "set_acceleration": False}
    caller.calls(caller.entities.set_state, entity="cloth", state=state(TURNED), **flags)
    assert np.array_equal(numbers(caller.state("cloth").pose), before)
    flags["set_acceleration"] = True
    caller.calls(caller.entities.set_state, code=replies.UNSUPPORTED, entity="cloth", state=state(TURNED), **flags)


def test_colliders_and_empty_hands_are_placed_at_once(caller):
    caller.spawn(CRATE, "crate")
    for name in ("crate", "ground", "hand"):
        before = caller.state(name).pose
        caller.calls(caller.entities.set_state, entity=name, state=state(TURNED))
        assert numbers(caller.state(name).pose) == pytest.approx(numbers(TURNED), abs=1e-6)
        caller.calls(caller.running.step, steps=2)
        assert numbers(caller.state(name).pose) == pytest.approx(numbers(TURNED), abs=1e-6)
        caller.calls(caller.entities.set_state, entity=name, state=state(before))
    moving = state(twist=Twist(linear=Vector3(x=1.0)))
    caller.calls(caller.entities.set_state, code=replies.FAILED, entity="crate", state=moving)
    caller.calls(caller.entities.set_state, code=replies.NOT_FOUND, entity="nobody", state=state())
    bad = Pose()
    bad.position.x = float("nan")
    caller.calls(caller.entities.set_state, code=101, entity="crate", state=state(bad))
    spun = state(twist=Twist(angular=Vector3(z=float("inf"))))
    found = caller.calls(caller.entities.set_state, code=replies.FAILED, entity="cloth", state=spun)
    assert "the twist [[0.0, 0.0, 0.0], [0.0, 0.0, inf]] is not finite" in found.result.error_message


def test_infos_bounds_and_filters(caller):
    caller.spawn(CRATE, "crate", initial_pose=PoseStamped(pose=TURNED))
    caller.spawn(LINE, "line")

    def info(name):
        empty = SimpleNamespace(category=SimpleNamespace(category=9), tags=[], description="")
        found = caller.calls(caller.entities.get_info, response(info=empty), entity=name).info
        return found.category.category, found.tags

    def bounds(name):
        found = caller.calls(caller.entities.get_bounds, response(bounds=SimpleNamespace()), entity=name).bounds
        return found.type, [numbers(point).tolist() for point in found.points]

    assert info("cloth") == (OBJECT, ["cloth"]) and info("line") == (OBJECT, ["rope", "spawned"])
    assert info("crate") == (STATIC_OBJECT, ["collider", "box", "spawned"]) and info("hand") == (ROBOT, ["handle"])
    assert bounds("ground") == (0, [])
    assert bounds("crate") == (BOX, [pytest.approx([0.1, 0.2, 0.3]), pytest.approx([-0.1, -0.2, -0.3])])
    assert bounds("cloth") == (
        BOX,
        [pytest.approx([0.5, 0.5, 0.0], abs=1e-5), pytest.approx([-0.5, -0.5, 0.0], abs=1e-5)],
    )
    tags = partial(SimpleNamespace, tags=["rope", "spawned"])
    assert caller.names(tags=tags(filter_mode=0)) == ["line", "crate"]
    assert caller.names(tags=tags(filter_mode=1)) == ["line"]
    assert caller.names(categories=[SimpleNamespace(category=ROBOT)]) == ["hand"]
    ball = [Vector3(x=0.0, y=0.0, z=3.0), Vector3(x=0.99)]
    assert caller.names(bounds=SimpleNamespace(type=SPHERE, points=ball)) == ["ground"]
    ball[1].x = 1.01
    assert caller.names(bounds=SimpleNamespace(type=SPHERE, points=ball)) == ["cloth", "ground"]
    box = [Vector3(x=1.0, y=1.0, z=1.0), Vector3(x=0.4, y=-1.0, z=-0.1)]
    assert caller.names(bounds=SimpleNamespace(type=BOX, points=box)) == ["line", "ground", "crate"]
    nan, minus, none = Vector3(x=float("nan")), Vector3(x=-1.0), Vector3()
    for kind, points, code in (
        (2, [none] * 3, replies.UNSUPPORTED),
        (BOX, [none], replies.FAILED),
        (BOX, [none, nan], replies.FAILED),
        (SPHERE, [nan, none], replies.FAILED),
        (SPHERE, [none, minus], replies.FAILED),
    ):
        filters = {"categories": [], "tags": tags(filter_mode=0), "filter": ""}
        filters = SimpleNamespace(bounds=SimpleNamespace(type=kind, points=points), **filters)
        caller.calls(caller.entities.get_all, code=code, filters=filters)


def test_regular_expressions_are_of_posix_and_end():
    names = ["robot/arm/0", "towel", "towel_1"]
    assert _matching("", names) == names and _matching("^towel(_[[:digit:]])?$", names) == names[1:]
    assert _matching("arm|_1", names) == ["robot/arm/0", "towel_1"]
    with pytest.raises(replies.Refusal, match="no POSIX"):
        _matching("(", names)
    assert _matching("(a+)+$", ["a" * 90 + "b"]) == []  # 2^90 ways for one that goes back
