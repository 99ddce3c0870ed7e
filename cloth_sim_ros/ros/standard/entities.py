# SPDX-License-Identifier: Apache-2.0
"""Entities: names, poses and motion of objects, colliders and handles."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Quaternion, Vector3

from cloth_sim_ros.ros.inputs.frames import Frames
from cloth_sim_ros.ros.inputs.grippers import finger_names
from cloth_sim_ros.ros.standard import shapes
from cloth_sim_ros.ros.standard.replies import FAILED, NOT_FOUND, UNSUPPORTED, Asking, Refusal
from cloth_sim_ros.ros.standard.spawning import Spawner, read_placed
from cloth_sim_ros.ros.world import World
from cloth_sim_ros.sim import Rope

OBJECT, ROBOT, STATIC_OBJECT = 0, 1, 5  # CATEGORY_... of EntityCategory.msg
EMPTY, BOX, CONVEX_HULL, SPHERE = range(4)  # TYPE_... of Bounds.msg
ALL_TAGS = 1  # FILTER_MODE_ALL of TagsFilter.msg
SET_INVALID_POSE = 101  # of SetEntityState.srv
LONGEST, PATIENCE = 200, 0.5  # letters of a regular expression, and [s] that it may take


class Entities:
    """Handlers, each (request, response), for the executor's thread. now(world) returns nanoseconds of a stamp."""

    def __init__(self, world: World, frames: Frames, ask: Asking, spawner: Spawner, now: Callable[[World], int]):
        self._world, self._frames, self._ask, self._spawner, self._now = world, frames, ask, spawner, now

    async def get_all(self, request: Any, response: Any) -> None:
        """Answer GetEntities."""
        response.entities = _matching(request.filters.filter, await self._ask(self._filtered, request.filters))

    async def get_states(self, make_state: Callable[[], Any], request: Any, response: Any) -> None:
        """Answer GetEntitiesStates."""
        await self.get_all(request, response)
        for name in response.entities:
            response.states.append(make_state())
            await self._ask(self._tell_state, name, response.states[-1])

    async def get_state(self, request: Any, response: Any) -> None:
        """Answer GetEntityState."""
        await self._ask(self._tell_state, request.entity, response.state)

    async def set_state(self, request: Any, response: Any) -> None:
        """Answer SetEntityState. The flags exist since 2.1; without them the whole state is set."""
        pose = twist = None
        if getattr(request, "set_pose", True):
            pose = read_placed(request.state, self._frames, SET_INVALID_POSE)
        if getattr(request, "set_twist", True):
            given = request.state.twist
            twist = np.array([[each.x, each.y, each.z] for each in (given.linear, given.angular)])
            if not np.isfinite(twist).all():
                raise Refusal(FAILED, f"the twist {twist.round(9).tolist()} is not finite; allowed are finite numbers")
            if request.state.header.frame_id not in ("", self._frames.ours) and twist.any():
                raise Refusal(UNSUPPORTED, f"a twist is in {request.state.header.frame_id!r:.80}; allowed is our frame")
        if getattr(request, "set_acceleration", False):
            raise Refusal(UNSUPPORTED, "an acceleration cannot be set; allowed are pose and twist")
        await self._ask(self._place, request.entity, pose, twist)

    async def get_info(self, request: Any, response: Any) -> None:
        """Answer GetEntityInfo."""
        category, tags = await self._ask(lambda: self._info(self._known(request.entity)))
        response.info.category.category, response.info.tags = category, tags
        response.info.description = f"{' '.join(tags)} of cloth_sim_ros"

    async def get_bounds(self, request: Any, response: Any) -> None:
        """Answer GetEntityBounds: a box in the entity's axes, or none if it is unbounded."""
        box = await self._ask(lambda: self._box(self._known(request.entity))[0])
        response.bounds.type = EMPTY if box is None else BOX
        response.bounds.points = [] if box is None else [Vector3(**_xyz(corner)) for corner in reversed(box)]

    # -- in the loop's thread ------------------------------------------------------------------------------------

    def _known(self, name: str) -> str:
        if name not in self._names():
            raise Refusal(NOT_FOUND, f"there is no entity {name!r:.80}")
        return name

    def _names(self) -> list[str]:
        scene = self._ask.sim.scene
        return [*scene.objects, *scene.colliders, *scene.handles]

    def _is_robots(self, name: str) -> bool:
        return name in self._world.mounts or name in finger_names(self._world.in_effect["grippers"])

    def _info(self, name: str) -> tuple[int, list[str]]:
        scene = self._ask.sim.scene
        spawned = ["spawned"] if self._spawner.is_spawned(name) else []
        if name in scene.objects:
            return OBJECT, ["rope" if isinstance(scene.objects[name], Rope) else "cloth", *spawned]
        if name in scene.handles:
            return ROBOT, ["handle"]
        shape = type(scene.colliders[name]).__name__.lower()
        return ROBOT if self._is_robots(name) else STATIC_OBJECT, ["collider", shape, *spawned]

    def _box(self, name: str) -> tuple[shapes.Box | None, shapes.Box | None]:
        """Return the bounding boxes in the entity's own axes, and along those of the world."""
        pose = shapes.state_of(self._ask.sim, name).pose
        box = shapes.box_of(self._ask.sim, name, pose)
        return box, None if box is None else shapes.in_world(box, pose)

    def _filtered(self, filters: Any) -> list[str]:
        """Return all names that pass the filters, without the filter by name."""
        wanted = {each.category for each in filters.categories}
        tags, needs = set(filters.tags.tags), all if filters.tags.filter_mode == ALL_TAGS else any
        bounds = _read_bounds(filters.bounds)
        found = []
        for name in self._names():
            category, own = self._info(name)
            if (not wanted or category in wanted) and (not tags or needs(tag in own for tag in tags)):
                if bounds is None or _overlap(self._box(name)[1], *bounds):
                    found.append(name)
        return found

    def _tell_state(self, name: str, message: Any) -> None:
        state = shapes.state_of(self._ask.sim, self._known(name))
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(self._now(self._world), 1_000_000_000)
        message.header.frame_id = self._frames.ours
        message.pose.position = Point(**_xyz(state.pose.position))
        message.pose.orientation = Quaternion(**dict(zip("xyzw", map(float, state.pose.orientation), strict=True)))
        message.twist.linear, message.twist.angular = Vector3(**_xyz(state.velocity)), Vector3(**_xyz(state.turning))

    def _place(self, name: str, pose: Any, twist: np.ndarray | None) -> None:
        """Move an entity at once, as a whole. Raises Refusal or ValueError."""
        sim = self._ask.sim
        before = shapes.state_of(sim, self._known(name)).pose
        if name in sim.scene.objects:
            now, speeds = sim.positions(name).astype(np.float64), None
            points = now if pose is None else shapes.carried(now, before, pose)
            if twist is not None:
                speeds = twist[0] + np.cross(twist[1], points - np.asarray((pose or before).position))
            self._world.place_object(name, None if pose is None else points, speeds)
            return
        if twist is not None and twist.any():
            raise Refusal(FAILED, f"{name} has no twist of its own; allowed are poses, or topics that move it")
        if pose is not None and self._is_robots(name):
            raise Refusal(FAILED, f"{name} goes with its robot or gripper; allowed are things that stand alone")
        if pose is not None and name in sim.scene.handles and sim.held(name):
            raise Refusal(FAILED, f"{name} holds something, which a jump would tear; allowed is an empty handle")
        if pose is not None:
            self._world.place(name, pose)


def _matching(pattern: str, names: Sequence[str]) -> list[str]:
    """Return the names in which a POSIX extended regular expression is found. Raises Refusal.

    grep is ended if it takes long. The `re` of Python has no such limit, and some patterns take it years.
    """
    if not pattern or not names:
        return list(names)
    if len(pattern) > LONGEST:
        raise Refusal(FAILED, f"the filter has {len(pattern)} letters; allowed are {LONGEST}")
    command, text = ["grep", "-zE", "-e", pattern], "\0".join(names).encode(errors="replace")
    try:
        done = subprocess.run(command, input=text, capture_output=True, timeout=PATIENCE, check=False)
    except subprocess.TimeoutExpired:
        raise Refusal(FAILED, f"the filter took more than {PATIENCE} s; allowed are simpler ones") from None
    if done.returncode > 1:
        raise Refusal(FAILED, f"the filter {pattern!r:.80} is no POSIX extended regular expression")
    kept = set(done.stdout.decode(errors="replace").split("\0"))
    return [name for name in names if name in kept]


def _read_bounds(bounds: Any) -> tuple[shapes.Box, float] | None:
    """Return a box, and the distance [m] within which an entity is inside; None without bounds. Raises Refusal."""
    if bounds.type == EMPTY:
        return None
    if bounds.type not in (BOX, SPHERE):
        raise Refusal(UNSUPPORTED, f"bounds of type {bounds.type} are not offered; allowed are 0 none, 1 box, 3 sphere")
    if len(bounds.points) != 2:
        raise Refusal(FAILED, f"bounds have {len(bounds.points)} points; allowed are 2")
    first, second = (np.array([p.x, p.y, p.z]) for p in bounds.points)
    if not np.isfinite([first, second]).all() or bounds.type == SPHERE and second[0] < 0.0:
        given = f"{first.tolist()} and {second.tolist()}"
        raise Refusal(FAILED, f"the points of the bounds are {given}; allowed are finite ones, and no radius below 0")
    if bounds.type == SPHERE:
        return (first, first), float(second[0])
    return (np.minimum(first, second), np.maximum(first, second)), 0.0


def _overlap(box: shapes.Box | None, around: shapes.Box, near: float) -> bool:
    """Return True if the box of an entity comes within `near` [m] of another box; None is an unbounded one."""
    if box is None:
        return True
    gaps = np.maximum(0.0, np.maximum(box[0] - around[1], around[0] - box[1]))
    return bool(np.linalg.norm(gaps) <= near)


def _xyz(vector: Sequence[float]) -> dict[str, float]:
    return dict(zip("xyz", map(float, vector), strict=True))
