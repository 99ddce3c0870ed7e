# SPDX-License-Identifier: Apache-2.0
"""The node `cloth_sim`: it connects parameters, inputs, the simulation loop and outputs."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Collection
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeoutError
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock as SteadyClock
from rclpy.clock import ClockType
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker, MarkerArray

from cloth_sim_ros.parameters import Parameter
from cloth_sim_ros.ros.inputs import messages as inputs
from cloth_sim_ros.ros.inputs.commands import NEWEST_ONLY, Commands
from cloth_sim_ros.ros.inputs.frames import Frames, Refused
from cloth_sim_ros.ros.inputs.gripper_joints import GripperJoints
from cloth_sim_ros.ros.inputs.robot_topics import RobotTopics
from cloth_sim_ros.ros.outputs.clock import ClockOutput
from cloth_sim_ros.ros.outputs.diagnostics import DiagnosticsOutput, busy, diagnostics
from cloth_sim_ros.ros.outputs.log import Forwarded
from cloth_sim_ros.ros.outputs.output import Audience, Output
from cloth_sim_ros.ros.outputs.table import OUTPUTS
from cloth_sim_ros.ros.parameters.bridge import ParameterBridge
from cloth_sim_ros.ros.parameters.services import ParameterServices, settled
from cloth_sim_ros.ros.standard.offer import Standard, offer
from cloth_sim_ros.ros.state_services import StateServices
from cloth_sim_ros.ros.time.clock_follower import ClockFollower
from cloth_sim_ros.ros.time.frame_clock import Pace
from cloth_sim_ros.ros.time.long_waits import LongWaits
from cloth_sim_ros.ros.time.loop import PATIENCE, SimulationLoop
from cloth_sim_ros.ros.world import World
from cloth_sim_ros.shared_files import PACKAGE
from cloth_sim_ros.sim.mesh_file import stop_reading

WORTH_ANOTHER_THREAD = 100_000  # bytes of a frame's messages: fewer are sent sooner than handed over


class ClothSimNode(Node):
    """The node. Callbacks run in the executor's thread and only check and pass on; the loop's thread simulates.

    A third thread sends large messages of a frame during the next.
    """

    def __init__(self, **node_arguments: Any):
        # Undeclared parameters pass rclpy, which would not name them, and are refused by the bridge.
        super().__init__(
            "cloth_sim", allow_undeclared_parameters=True, start_parameter_services=False, **node_arguments
        )
        log = self.get_logger()
        self._forwarded = Forwarded(log)
        logging.getLogger(PACKAGE).addHandler(self._forwarded)
        self._bridge = ParameterBridge(self, self._parameter_changed)
        self._parameter_services = ParameterServices(self, self._bridge)
        values = self._bridge.values
        self._frames = Frames(values["frame_id"], self)
        self._complaints = inputs.Complaints(log)
        self._outputs = [output for kind in OUTPUTS for output in kind.each(self, values)]
        self._audience = Audience(self._outputs)
        self._makes_time = any(isinstance(output, ClockOutput) for output in self._outputs)
        self._diagnostics = DiagnosticsOutput(self)
        self._sender = ThreadPoolExecutor(max_workers=1, thread_name_prefix="sending")
        self._sending: Future | None = None
        world = World(values, log, self._frames)
        self._follower = ClockFollower(self.get_clock(), world.forget_stamps, log)
        self._loop = SimulationLoop(
            world, lambda: self._bridge.values, self._built, self._send, self._tell, log, self._follower
        )
        for kind in ("colliders", "handles", "grippers"):
            for name in values[kind]:
                topic = f"{kind}/{name}/pose"
                self.create_subscription(PoseStamped, f"~/{topic}", partial(self._on_pose, name, topic), NEWEST_ONLY)
        waiting = MutuallyExclusiveCallbackGroup()  # topics go on meanwhile
        for name in values["handles"]:
            attach = partial(self._on_attach, name)
            self.create_service(SetBool, f"~/handles/{name}/attach", attach, callback_group=waiting)
        if values["spare_colliders"]:
            self.create_subscription(MarkerArray, "~/scene", self._on_scene, 10)
        world.grasps.told = self._tell_attached
        Commands(self, self._loop, self._bridge, self._frames, self._complaints)
        GripperJoints(self, self._loop, self._bridge, self._complaints, self._now)
        RobotTopics(self, self._bridge, self._frames, self._complaints)
        self.create_service(Trigger, "~/reset", self._on_reset, callback_group=waiting)
        self.create_service(Trigger, "~/step", self._on_step, callback_group=waiting)
        self.create_service(SetBool, "~/pause", self._on_pause)
        StateServices(self, self._loop, self._bridge, self._answer, waiting)
        self.standard = Standard(self, self._loop, self._bridge, self._frames, self._show, self._now)
        offer(self, self.standard)
        waits = LongWaits(self._loop, world.compiling.compiler, log, self._tell_busy)
        steady = SteadyClock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, waits.look, clock=steady)
        self._alone = True
        self.create_timer(1.0, self._look_for_namesakes, clock=steady)
        self._loop.start()

    def stop(self) -> bool:
        """End the simulation; return False if a thread is still busy after 2 s."""
        stop_reading()
        logging.getLogger(PACKAGE).removeHandler(self._forwarded)
        ended = self._loop.stop()
        decided = self._parameter_services.stop()
        self._sender.shutdown()
        return ended and decided

    # -- in the executor's thread --------------------------------------------------------------------------------

    def _parameter_changed(self, name: str, row: Parameter, value: Any) -> None:
        values = self._bridge.values
        if name.startswith("publish."):
            self._loop.submit(lambda: self._attach(self._loop.world))
        elif row.live:
            self._loop.submit(lambda: self._set_live(name, value, values))
        else:
            self._loop.rebuild()

    def _on_pose(self, name: str, topic: str, message: PoseStamped) -> None:
        try:
            way = inputs.follow(self._loop.world.tracks[name], message, self._frames)
        except Refused as reason:
            self._complaints.refuse(topic, reason)
            return
        if way > 0.0:
            is_empty = partial(self._loop.world.is_empty, name)
            self._loop.submit(lambda: self._complaints.jump(topic, way, is_empty))

    def _on_scene(self, message: MarkerArray) -> None:
        world = self._loop.world
        for marker in message.markers:
            try:
                if marker.action == Marker.DELETEALL:
                    self._loop.submit(lambda: [world.take_away(name) for name in list(world.added.colliders)])
                elif marker.action == Marker.DELETE:
                    self._loop.submit(partial(world.take_away, inputs.name_of(marker)))
                elif marker.action == Marker.ADD:
                    collider = inputs.read_marker(marker, self._frames)
                    if marker.lifetime.sec or marker.lifetime.nanosec:
                        sentence = f"{inputs.name_of(marker)} has a lifetime, and stays until a marker deletes it"
                        self._complaints.cut("scene", sentence)
                    self._loop.submit(partial(self._put, inputs.name_of(marker), collider))
                else:
                    allowed = "allowed are ADD 0, DELETE 2 and DELETEALL 3"
                    raise Refused("action", f"{inputs.name_of(marker)} has the action {marker.action}; {allowed}")
            except Refused as reason:
                self._complaints.refuse("scene", reason)

    def _put(self, name: str, collider: Any) -> None:
        done, why = self._loop.world.put(name, collider)
        if not done:
            self._complaints.refuse("scene", Refused("room", why))

    async def _on_attach(self, handle: str, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        await self._answer(response, partial(self._loop.world.attach, handle, request.data))
        self._bridge.follow({f"{handle}.attached": request.data and response.success})
        return response

    async def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return await self._answer(response, self._loop.world.reset, "objects are back at the start")

    async def _on_step(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if not self._loop.paused:
            response.message = "the simulation is running; pause it first"
            return response
        return await self._answer(response, self._loop.step_once, "one frame done")

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self._loop.paused = request.data
        response.success, response.message = True, "paused" if request.data else "running"
        return response

    def _look_for_namesakes(self) -> None:
        """Warn if another node has this one's name, as messages to one reach both."""
        ours = (self.get_name(), self.get_namespace())
        alone = self.get_node_names_and_namespaces().count(ours) == 1
        if self._alone and not alone:
            name = self.get_fully_qualified_name()
            remedy = "end it, or start this one with -r __ns:=/other or another ROS_DOMAIN_ID"
            self.get_logger().warning(f"another node is named {name} too, and messages reach both; {remedy}")
        self._alone = alone

    def _tell_busy(self, sentence: str) -> None:
        self._diagnostics.publish(busy(self.get_fully_qualified_name(), sentence))

    async def _answer(self, response: Any, command: Callable, message: str = "") -> Any:
        """Run `command` in the loop's thread and answer with its result, success and a sentence.

        If it returns nothing, the answer is `message`.
        """
        try:
            found = await settled(self, self._loop.submit(command), PATIENCE)
            response.success, response.message = found or (True, message)
        except FutureTimeoutError:
            response.message = (
                f"the simulation is busy; this takes effect when it is not, after more than {PATIENCE:g} s"
            )
        except Exception as error:
            response.message = f"that failed: {error}"
        return response

    # -- in the loop's thread ------------------------------------------------------------------------------------

    def _built(self, world: World, ok: bool) -> None:
        if ok:
            self._attach(world)
        elif world.sim is not None and self.executor is not None:
            built = world.values
            self.executor.create_task(lambda: self._bridge.restore(built))

    def _set_live(self, name: str, value: Any, values: dict[str, Any]) -> None:
        world = self._loop.world
        if not world.set_live(name, value, values) and self.executor is not None:
            held = world.in_effect[name]
            self.executor.create_task(lambda: self._bridge.put_back(name, value, held))

    def _tell_attached(self, handle: str, attached: bool) -> None:
        if self.executor is not None:
            self.executor.create_task(lambda: self._bridge.follow({f"{handle}.attached": attached}))

    def _attach(self, world: World) -> None:
        self._end_sending()
        for output in self._outputs:
            output.attach(world.sim, self._bridge.values)

    def _show(self, come: Collection[Output], go: Collection[Output]) -> None:
        """Add and remove outputs of single objects; they are attached as the simulation is built anew."""
        self._end_sending()
        self._outputs[:] = [output for output in self._outputs if output not in go] + [*come]

    def _send(self, world: World) -> float:
        if not self._audience.is_there:
            begin = time.monotonic()
            world.finish()
            return time.monotonic() - begin
        self._end_sending()
        stamp = divmod(self._now(world), 1_000_000_000)
        for output in self._outputs:
            output.request(world, stamp)
        begin = time.monotonic()
        for output in self._outputs:
            output.read(world, stamp)
        world.finish()  # here, as the other thread may hold the interpreter from now on
        waited = time.monotonic() - begin
        if sum(output.size for output in self._outputs) < WORTH_ANOTHER_THREAD:
            self._publish()
        else:
            self._sending = self._sender.submit(self._publish)
        return waited

    def _end_sending(self) -> None:
        """Wait for the sending thread, before anything that it reads is overwritten."""
        if self._sending is not None:
            sending, self._sending = self._sending, None
            sending.result()

    def _publish(self) -> None:
        for output in self._outputs:
            output.publish()

    def _tell(self, world: World, pace: Pace) -> None:
        if not self._diagnostics.is_wanted(world):
            return
        name, by_clock = self.get_fully_qualified_name(), self._follower.trouble if self._follower.active else None
        refused = self._complaints.refused
        self._diagnostics.publish(diagnostics(name, world, pace, self._loop.paused, refused, by_clock))

    def _now(self, world: World) -> int:
        """Return the time of stamps [ns].

        It is the simulated time, which never runs backwards, if this node is the source of time. If the node follows a
        clock, it is that at the end of the frame. Otherwise it is the time of the node's clock.
        """
        if self._makes_time:
            return round(1e9 * world.simulated)
        return self._follower.time if self._follower.active else self.get_clock().now().nanoseconds
