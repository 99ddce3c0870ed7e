# SPDX-License-Identifier: Apache-2.0
"""Collider shapes.

A new shape is a file with its class, and a line in SHAPES. Other packages may add shapes (docs/how-to/extending.md).
"""

from collections.abc import Callable, Iterable

import warp as wp

from cloth_sim_ros.sim.colliders.box import Box
from cloth_sim_ros.sim.colliders.capsule import Capsule
from cloth_sim_ros.sim.colliders.collider import Collider
from cloth_sim_ros.sim.colliders.cylinder import Cylinder
from cloth_sim_ros.sim.colliders.ellipsoid import Ellipsoid
from cloth_sim_ros.sim.colliders.mesh import Mesh
from cloth_sim_ros.sim.colliders.plane import Plane
from cloth_sim_ros.sim.colliders.sphere import Sphere
from cloth_sim_ros.sim.colliders.volume import SignedDistance

SHAPES: dict[str, type[Collider]] = {
    "plane": Plane,
    "sphere": Sphere,
    "capsule": Capsule,
    "box": Box,
    "cylinder": Cylinder,
    "ellipsoid": Ellipsoid,
    "mesh": Mesh,
    "signed_distance": SignedDistance,
}

SPARE_SHAPES = ("box", "cylinder", "sphere")  # shapes of colliders that can be added while a simulation runs


def shape_of(collider: Collider) -> str:
    """The name in SHAPES of a collider of the scene."""
    return next(name for name, kind in SHAPES.items() if type(collider) is kind)


def number_of(name: str) -> int:
    """The number by which kernels know a shape."""
    return list(SHAPES).index(name)


def shapes_of(colliders: Iterable[Collider], spare: bool = False) -> tuple[str, ...]:
    """The sorted names in SHAPES of colliders, with SPARE_SHAPES if `spare`; kernels are made for these."""
    return tuple(sorted({*map(shape_of, colliders), *(SPARE_SHAPES if spare else ())}))


def curved_of(present: tuple[str, ...]) -> tuple[str, ...]:
    """Those of the shapes in `present` that can come between particles, so that facets are tested against them."""
    return tuple(name for name in present if not SHAPES[name].flat)


@wp.func
def _nothing(shape: int, p: wp.vec3, size: wp.vec3, data: wp.uint64) -> wp.vec4:
    return wp.vec4(0.0, 0.0, 1.0, 1.0e30)


def make_signed_distance(present: tuple[str, ...]):
    """Make a Warp function (shape, p, size, data) -> normal and distance for the shapes in `present` only.

    size and data: as in ColliderMotion.
    """
    chosen = _nothing
    for name in present:
        chosen = _or(chosen, name)
    return chosen


def _of_those_with(attribute: str, present: tuple[str, ...], add: Callable) -> wp.Function | None:
    """A Warp function that `add(others, name)` builds up from the shapes that have an attribute; None if none has."""
    chosen = None
    for name in present:
        if getattr(SHAPES[name], attribute) is not None:
            chosen = add(chosen, name)
    return chosen


def make_is_beyond(present: tuple[str, ...]):
    """Make a Warp function (shape, p, distance, data): True if a quick bound shows p farther than `distance` [m].

    Returns None if no shape in `present` is slow to compute.
    """
    return _of_those_with("at_least", present, _or_beyond)


def _or_beyond(others, name: str):
    index, of_shape = number_of(name), SHAPES[name].at_least

    def is_beyond(shape: int, p: wp.vec3, distance: float, data: wp.uint64) -> bool:
        if shape == wp.static(index):
            return of_shape(p, data) > distance
        if wp.static(others is not None):
            return others(shape, p, distance, data)
        else:
            return False

    return wp.func(is_beyond, name=f"is_beyond_{name}")


def make_width(present: tuple[str, ...]):
    """Make a Warp function (shape, data) -> width [m] of what a collider is made of; 0 if it is convex.

    Returns None if all shapes in `present` are convex.
    """
    return _of_those_with("width", present, _or_wide)


def _or_wide(others, name: str):
    index, of_shape = number_of(name), SHAPES[name].width

    def width(shape: int, data: wp.uint64) -> float:
        if shape == wp.static(index):
            return of_shape(data)
        if wp.static(others is not None):
            return others(shape, data)
        else:
            return 0.0

    return wp.func(width, name=f"width_{name}")


def make_has_edges(present: tuple[str, ...]):
    """Make a Warp function (shape, data): True if a collider is convex and may have sharp edges.

    Returns None if no shape in `present` may have some.
    """
    edged = sum(1 << number_of(name) for name in present if SHAPES[name].edged)
    width = make_width(present)

    @wp.func
    def has_edges(shape: int, data: wp.uint64) -> bool:
        if (wp.static(edged) >> shape) & 1 == 0:
            return False
        if wp.static(width is not None):
            return width(shape, data) == 0.0
        return True

    return has_edges if edged else None


def make_formula(present: tuple[str, ...]):
    """Make a Warp function (shape, a, b, c): weights of the deepest point of a triangle, or 0 if it has to be searched.

    Returns None if no shape in `present` has a formula.
    """
    return _of_those_with("deepest", present, _or_formula)


def _or_formula(others, name: str):
    index, of_shape = number_of(name), SHAPES[name].deepest

    def formula(shape: int, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
        if shape == wp.static(index):
            return of_shape(a, b, c)
        if wp.static(others is not None):
            return others(shape, a, b, c)
        else:
            return wp.vec3(0.0)

    return wp.func(formula, name=f"formula_{name}")


def _or(others, name: str):
    index, of_shape = number_of(name), SHAPES[name].distance
    has_data = len(of_shape.input_types) == 3

    def signed_distance(shape: int, p: wp.vec3, size: wp.vec3, data: wp.uint64) -> wp.vec4:
        if shape == wp.static(index):
            if wp.static(has_data):
                return of_shape(p, size, data)
            else:
                return of_shape(p, size)
        return others(shape, p, size, data)

    return wp.func(signed_distance, name=f"signed_distance_{name}")
