# SPDX-License-Identifier: Apache-2.0
"""Additional forces of a scene on particles, as functions of position and velocity.

A force is a frozen class with `numbers()`, and a Warp function of a particle. `FORCES` connects them; other packages
may add to it (docs/how-to/extending.md).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

import warp as wp


class Force(Protocol):
    """Description of a force in a scene."""

    def numbers(self) -> tuple[float, float, float, float]:
        """The numbers that its Warp function gets."""


# name -> (class, Warp function). The function takes position (vec3) [m], velocity (vec3) [m/s], mass [kg] and the
# numbers (vec4). It returns the force [N] and its drag rate [N s/m], by which it falls with the velocity, or 0.
FORCES: dict[str, tuple[type, wp.Function]] = {}


def name_of(force: Force) -> str:
    """The name in FORCES of a force of the scene. Raises ValueError if its class is not registered."""
    for name, (kind, _) in FORCES.items():
        if type(force) is kind:
            return name
    raise ValueError(f"Scene.forces has {force!r}; allowed are {', '.join(FORCES) or 'none'}, see forces.FORCES")


def make_pull(names: Iterable[str]):
    """Make a Warp function that sums the forces `names` on a particle; an array holds their numbers in this order."""
    pull = _nothing
    for place, name in enumerate(names):
        pull = _and(pull, place, name)
    return pull


@wp.func
def _nothing(x: wp.vec3, v: wp.vec3, mass: float, numbers: wp.array(dtype=wp.vec4)) -> wp.vec4:
    return wp.vec4(0.0)


def _and(others, place: int, name: str):
    force = FORCES[name][1]

    def pull(x: wp.vec3, v: wp.vec3, mass: float, numbers: wp.array(dtype=wp.vec4)) -> wp.vec4:
        return others(x, v, mass, numbers) + force(x, v, mass, numbers[wp.static(place)])

    return wp.func(pull, name=f"pull_{place}_{name}")
