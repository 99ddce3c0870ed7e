# SPDX-License-Identifier: Apache-2.0
"""SpawnEntity and DeleteEntity: colliders, cloths and ropes, described by the parameters of a file."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Mapping
from typing import Any

import yaml
from builtin_interfaces.msg import Time
from rclpy.node import Node

from cloth_sim_ros.ros.inputs.frames import Frames, Refused
from cloth_sim_ros.ros.inputs.grippers import finger_names
from cloth_sim_ros.ros.inputs.messages import read_pose
from cloth_sim_ros.ros.inputs.pose_track import Pose, composed
from cloth_sim_ros.ros.outputs.objects import ObjectOutput
from cloth_sim_ros.ros.outputs.output import Output
from cloth_sim_ros.ros.outputs.wrenches import RopeEnds
from cloth_sim_ros.ros.parameters import names
from cloth_sim_ros.ros.parameters.bridge import ParameterBridge, filled
from cloth_sim_ros.ros.parameters.plan import make_collider, placed
from cloth_sim_ros.ros.standard.replies import FAILED, NOT_FOUND, UNSUPPORTED, Asking, Refusal, outcome
from cloth_sim_ros.ros.time.loop import SimulationLoop

NAME_NOT_UNIQUE, NAME_INVALID, UNSUPPORTED_FORMAT, NO_RESOURCE = 101, 102, 103, 104  # of SpawnEntity.srv
PARSE_ERROR, MISSING_ASSETS, UNSUPPORTED_ASSETS, INVALID_POSE = 106, 107, 108, 109
SPAWN_FAILED = 150  # of SpawnEntities.srv
LONGEST = 65536  # letters of a resource_string
EXAMPLE = "allowed is {type: cloth, ...}, {type: rope, ...} or {shape: box, ...}, with a name before it or none"
LOST = "the simulation cannot be built with it; the log says why"


class Spawner:
    """Handlers, each (request, response), for the executor's thread, one after the other.

    show(come, go) adds and removes outputs of objects, in the loop's thread.
    """

    def __init__(
        self,
        node: Node,
        loop: SimulationLoop,
        bridge: ParameterBridge,
        frames: Frames,
        ask: Asking,
        show: Callable[[Collection[Output], Collection[Output]], None],
    ):
        self._node, self._loop, self._bridge, self._frames = node, loop, bridge, frames
        self._ask, self._show = ask, show
        self._outputs: dict[str, list[Output]] = {}  # of each object that was spawned

    def is_spawned(self, name: str) -> bool:
        """Return True if an entity was added while the node ran."""
        return name in self._outputs or name in self._loop.world.added.colliders

    async def spawn(self, request: Any, response: Any) -> None:
        """Answer SpawnEntity."""
        await self._prepare(request, response)
        if await self._lost([response.entity_name]):
            raise Refusal(FAILED, LOST)

    async def spawn_all(self, make_result: Callable[[], Any], request: Any, response: Any) -> None:
        """Answer SpawnEntities, with a result for each; the simulation is built once."""
        for each in request.spawn_requests:
            result = make_result()
            result.result.result, result.result.error_message = await outcome(self._prepare(each, result))
            response.results.append(result)
        lost = await self._lost([each.entity_name for each in response.results])
        for each in response.results:
            if each.entity_name in lost:
                each.result.result, each.result.error_message = FAILED, LOST
        failed = sum(bool(each.result.error_message) for each in response.results)
        if failed:
            raise Refusal(SPAWN_FAILED, f"{failed} of {len(response.results)} were refused; their results say why")

    async def _prepare(self, request: Any, response: Any) -> None:
        """Add a collider, or prepare an object for the next build. Raises Refusal."""
        if request.entity_namespace:
            raise Refusal(UNSUPPORTED, "entity_namespace is not offered; allowed is none, as topics are below the node")
        inside, fields = _read(getattr(request, "entity_resource", request))  # since 2.0 a message of its own
        pose = read_placed(request.initial_pose, self._frames, INVALID_POSE)
        name = await self._ask.at_length(self._free_name, request.name or inside, request.allow_renaming)
        given = {f"{name}.{field}": value for field, value in fields.items()}
        try:
            if "shape" in fields:
                await self._ask.at_length(self._put, name, given, pose)
            else:
                values = await self._ask.at_length(self._bridge.checked_object, name, given)
                moved = _at(pose, values, name)
                self._bridge.add_object(name, {**values, **moved}, {**given, **moved})
                only = {**self._bridge.values, "objects": (name,)}
                self._outputs[name] = [*ObjectOutput.each(self._node, only), *RopeEnds.each(self._node, only)]
        except ValueError as error:
            code = PARSE_ERROR
            if str(error).startswith(f"{name}.mesh "):
                code = MISSING_ASSETS if "no such file" in str(error) else UNSUPPORTED_ASSETS
            raise Refusal(code, str(error)) from None
        response.entity_name = name

    async def delete(self, request: Any, response: Any) -> None:
        """Answer DeleteEntity."""
        name = request.entity
        if not self.is_spawned(name):
            sim = await self._ask(lambda: self._ask.sim)
            if name in {**sim.scene.objects, **sim.scene.colliders, **sim.scene.handles}:
                raise Refusal(FAILED, f"{name} is one of the parameters; allowed are entities that were spawned")
            raise Refusal(NOT_FOUND, f"there is no entity {name!r:.80}")
        await self._remove([name])

    async def remove_all(self) -> None:
        """Remove all entities that were added while the node ran."""
        await self._remove([*self._outputs, *await self._ask.at_length(lambda: list(self._loop.world.added.colliders))])

    def _free_name(self, wanted: str, renames: bool) -> str:
        """Return the name, or a free one like it, in the loop's thread. Raises Refusal."""
        values, world = self._bridge.values, self._loop.world
        named = {name for what in names.NAMED for name in values[what]} | {*finger_names(values["grippers"])}
        taken = named | {*world.added.colliders, *names.fixed_rows(), *names.GROUPS}
        trouble = names.unusable(wanted, taken)
        if not trouble or not renames:
            if trouble:
                is_taken = wanted in named or wanted in world.added.colliders
                raise Refusal(NAME_NOT_UNIQUE if is_taken else NAME_INVALID, f"{wanted!r:.80} cannot be: {trouble}")
            return wanted
        stem = wanted if wanted in taken else "entity"
        return next(name for k in itertools.count(1) if not names.unusable(name := f"{stem}_{k}", taken))

    def _put(self, name: str, given: Mapping[str, Any], pose: Pose) -> None:
        """Add a collider, in the loop's thread. Raises ValueError, and Refusal if there is no room for it."""
        rows = names.prefixed(name, names.collider_rows())
        values = filled(rows, given)
        collider = make_collider({**values, **_at(pose, values, name)}, name)
        self._ask.sim  # noqa: B018  it refuses where there is none
        done, why = self._loop.world.put(name, collider)
        if not done:
            raise Refusal(FAILED, why)

    async def _lost(self, names: Collection[str]) -> list[str]:
        """Build the simulation with the prepared objects; remove those that it cannot have and return their names."""
        new = [name for name in names if name in self._outputs]
        if not new:
            return []
        await self._ask.at_length(self._build, [output for name in new for output in self._outputs[name]], ())
        sim = self._loop.world.sim
        lost = [name for name in new if sim is None or name not in sim.scene.objects]
        await self._remove(lost)
        return lost

    async def _remove(self, gone: Collection[str]) -> None:
        objects = [name for name in gone if name in self._outputs]
        outputs = [output for name in objects for output in self._outputs.pop(name)]
        if objects:
            self._bridge.remove_objects(objects)
            await self._ask.at_length(self._build, (), outputs)
            for publisher in [each for output in outputs for each in output.owned]:
                self._node.destroy_publisher(publisher)
        for name in [each for each in gone if each not in objects]:
            await self._ask.at_length(self._loop.world.take_away, name)

    def _build(self, come: Collection[Output], go: Collection[Output]) -> None:
        """Build the simulation with other objects, in the loop's thread."""
        self._show(come, go)
        self._loop.build()


def read_placed(message: Any, frames: Frames, code: int) -> Pose:
    """Return the pose of a message with a header, ignoring its stamp as the standard does. Raises Refusal with
    `code`."""
    message.header.stamp = Time()
    try:
        return read_pose(message, frames)
    except Refused as reason:
        raise Refusal(code, f"the pose is refused: {reason}") from None


def _at(pose: Pose, values: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return the pose parameters of `name`, whose pose in `values` is given in the axes of `pose`."""
    return {f"{name}.{field}": value for field, value in placed(composed(pose, Pose.of(values, name))).items()}


def _read(resource: Any) -> tuple[str, dict[str, Any]]:
    """Return the name, or "", and the fields of one entity in YAML. Raises Refusal."""
    if resource.uri:
        raise Refusal(UNSUPPORTED_FORMAT, "a uri is not offered; allowed is YAML of one object in resource_string")
    text = resource.resource_string
    if not text.strip():
        raise Refusal(NO_RESOURCE, f"the resource is empty; {EXAMPLE}")
    if text.lstrip().startswith("<"):
        raise Refusal(UNSUPPORTED_FORMAT, f"the resource is XML; {EXAMPLE}")
    try:
        if len(text) > LONGEST:
            raise ValueError(f"it has {len(text)} letters; allowed are {LONGEST}")
        if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, yaml.SafeLoader)):
            raise ValueError("it has an alias, which is not allowed")  # a few of them can unfold to any size
        found = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise Refusal(PARSE_ERROR, f"the resource is no YAML: {' '.join(str(error).split())}") from None
    name, fields = "", found
    if isinstance(found, dict) and len(found) == 1 and isinstance(*found.values(), dict):
        ((name, fields),) = found.items()
    if not isinstance(fields, dict) or not {"type", "shape"} & fields.keys():
        raise Refusal(PARSE_ERROR, f"the resource has no type and no shape; {EXAMPLE}")
    flat = {}
    for field, value in fields.items():
        inner = value if isinstance(value, dict) else {None: value}
        flat |= {str(field) if part is None else f"{field}.{part}": each for part, each in inner.items()}
    return str(name), flat
