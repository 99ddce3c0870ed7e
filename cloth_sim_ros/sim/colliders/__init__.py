"""Collider shapes. A new shape: a file with `signed_distance`, `size`, `reach`, a scene class, its line in SHAPES."""

import warp as wp

from cloth_sim_ros.sim import scene
from cloth_sim_ros.sim.colliders import box, capsule, plane, sphere

SHAPES = {
    "plane": (scene.Plane, plane),
    "sphere": (scene.Sphere, sphere),
    "capsule": (scene.Capsule, capsule),
    "box": (scene.Box, box),
}
NAMES = tuple(SHAPES)


def shape_of(collider) -> str:
    """The name in SHAPES of a collider of the scene."""
    return next(name for name, (kind, _) in SHAPES.items() if type(collider) is kind)


@wp.func
def _nothing(shape: int, p: wp.vec3, size: wp.vec3) -> wp.vec4:
    return wp.vec4(0.0, 0.0, 1.0, 1.0e30)


def make_signed_distance(present: tuple[str, ...]):
    """A Warp function (shape, p, size) -> normal and distance that holds the shapes in `present` and no others."""
    chosen = _nothing
    for name in present:
        chosen = _or(chosen, name)
    return chosen


def _or(others, name: str):
    index, of_shape = NAMES.index(name), SHAPES[name][1].signed_distance

    def signed_distance(shape: int, p: wp.vec3, size: wp.vec3) -> wp.vec4:
        if shape == wp.static(index):
            return of_shape(p, size)
        return others(shape, p, size)

    return wp.func(signed_distance, name=f"signed_distance_{name}")
