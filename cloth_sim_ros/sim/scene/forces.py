# SPDX-License-Identifier: Apache-2.0
"""Additional forces of a scene on particles, as functions of position and velocity.

A force is a class of named numbers with a Warp function of a particle. Other packages add theirs to `FORCES`
(docs/how-to/extending.md).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

import warp as wp

from cloth_sim_ros.sim.input.numbers import Described, NumbersRow


class Force(Described):
    """A force on every particle.

    function: takes position (vec3) [m], velocity (vec3) [m/s], mass [kg] and its Numbers. It returns the force [N] and
    its drag rate [N s/m] (vec4), by which the force falls with the velocity, or 0.
    """

    function: ClassVar[wp.Function]


FORCES: dict[str, type[Force]] = {}


def make_pull(names: Iterable[str]):
    """Make a Warp function that sums the forces `names` on a particle; an array holds their numbers in this order."""
    pull = _nothing
    for place, name in enumerate(names):
        pull = _and(pull, place, name)
    return pull


@wp.func
def _nothing(x: wp.vec3, v: wp.vec3, mass: float, numbers: wp.array(dtype=NumbersRow)) -> wp.vec4:
    return wp.vec4(0.0)


def _and(others, place: int, name: str):
    force = FORCES[name].function

    def pull(x: wp.vec3, v: wp.vec3, mass: float, numbers: wp.array(dtype=NumbersRow)) -> wp.vec4:
        return others(x, v, mass, numbers) + force(x, v, mass, numbers[wp.static(place)].values)

    return wp.func(pull, name=f"pull_{place}_{name}")
