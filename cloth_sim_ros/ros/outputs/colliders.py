# SPDX-License-Identifier: Apache-2.0
"""Colliders and handles as markers, for ~/colliders."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

from geometry_msgs.msg import Point, Quaternion, Vector3
from rclpy.node import Node
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from cloth_sim_ros.ros.inputs.pose_track import Pose
from cloth_sim_ros.ros.outputs.output import LATCHED, Output, Stamp
from cloth_sim_ros.ros.world import World
from cloth_sim_ros.sim import Handle
from cloth_sim_ros.sim.colliders.collider import Collider, Solid
from cloth_sim_ros.sim.input.mesh_reading import PART
from cloth_sim_ros.sim.physics.quaternion import rotate

_STEEL = ColorRGBA(r=0.6, g=0.62, b=0.68, a=1.0)
_FREE, _HOLDING = ColorRGBA(r=0.2, g=0.5, b=0.9, a=0.4), ColorRGBA(r=0.9, g=0.5, b=0.1, a=0.4)


_KINDS = {
    "box": Marker.CUBE,
    "ball": Marker.SPHERE,
    "cylinder": Marker.CYLINDER,
    "triangles": Marker.TRIANGLE_LIST,
    "cells": Marker.CUBE_LIST,
}


def markers_of(name: str, collider: Collider, pose: Pose) -> list[Marker]:
    """Return the markers of a collider at `pose`, one for each of its solids."""
    return [_of_solid(name, number, solid, pose) for number, solid in enumerate(collider.solids())]


def _of_solid(name: str, number: int, solid: Solid, pose: Pose) -> Marker:
    """Return the marker of a solid. A mesh is given by its file, which viewers read themselves."""
    middle = rotate(pose.orientation, [solid.middle])[0]
    pose = Pose(tuple(p + q for p, q in zip(pose.position, middle, strict=True)), pose.orientation)
    if solid.file and PART not in solid.file:
        marker = _marker(name, Marker.MESH_RESOURCE, pose, (solid.unit,) * 3, number)
        marker.mesh_resource = solid.file
        if "://" not in solid.file:
            marker.mesh_resource = "file://" + quote(str(Path(solid.file).expanduser().absolute()))
        return marker
    marker = _marker(name, _KINDS[solid.kind], pose, solid.scale, number)
    if solid.points is not None:
        marker.points = [Point(x=x, y=y, z=z) for x, y, z in solid.points.tolist()]
    return marker


def _marker(name: str, kind: int, pose: Pose, scale, number: int = 0, color: ColorRGBA = _STEEL) -> Marker:
    x, y, z = pose.position
    marker = Marker(ns=name, id=number, type=kind, action=Marker.ADD, color=color)
    marker.pose.position = Point(x=float(x), y=float(y), z=float(z))
    marker.pose.orientation = Quaternion(**dict(zip("xyzw", map(float, pose.orientation), strict=True)))
    marker.scale = Vector3(**dict(zip("xyz", map(float, scale), strict=True)))
    return marker


class CollidersOutput(Output):
    """All colliders and handles, on ~/colliders, latched: sent when one of them moves, appears or disappears."""

    def __init__(self, node: Node, values: Mapping[str, Any]):
        self._publisher = node.create_publisher(MarkerArray, "~/colliders", LATCHED)
        self.publishers = [self._publisher]
        self._header = Header(frame_id=values["frame_id"])
        self._sent: tuple = ()
        self._listeners = -1

    @property
    def is_heard(self) -> bool:
        """True if there is a subscriber, or was one at the last sending."""
        return self._listeners > 0 or super().is_heard

    def read(self, world: World, stamp: Stamp) -> None:
        """Send the markers if any has changed, or the number of subscribers has."""
        sim, listeners = world.sim, self._publisher.get_subscription_count()
        if sim is None or listeners == self._listeners == 0:
            return
        poses = world.poses()
        holds = {name: sim.held(name) > 0 for name in sim.scene.handles}
        things = {**sim.scene.colliders, **sim.scene.handles}
        now = (things, {name: poses.get(name, thing) for name, thing in things.items()}, holds)
        if now == self._sent and listeners == self._listeners:
            return
        self._sent, self._listeners = now, listeners
        self._header.stamp.sec, self._header.stamp.nanosec = stamp
        array = MarkerArray(markers=[Marker(action=Marker.DELETEALL)])
        for name, thing in things.items():
            pose = Pose(tuple(now[1][name].position), tuple(now[1][name].orientation))
            array.markers += _of_handle(name, thing, pose, holds) if name in holds else markers_of(name, thing, pose)
        for marker in array.markers:
            marker.header = self._header
        self._publisher.publish(array)


def _of_handle(name: str, handle: Handle, pose: Pose, holds: Mapping[str, bool]) -> list[Marker]:
    """Return the marker of a handle's reach."""
    ball = len(handle.reach) == 1
    scale = (2 * handle.reach[0],) * 3 if ball else handle.reach
    return [
        _marker(name, Marker.SPHERE if ball else Marker.CUBE, pose, scale, color=_HOLDING if holds[name] else _FREE)
    ]
