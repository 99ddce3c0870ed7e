# SPDX-License-Identifier: Apache-2.0
"""The cost of a substep of XPBD [ms] by device and scene, measured once on a CPU core and an H200.

It determines how many substeps fit a budget.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from cloth_sim_ros.sim.features.collider_contact.broad_phase import FEW
from cloth_sim_ros.sim.topology import Topology

_NS = 1e-6  # a nanosecond [ms]
# Cost on a CPU per particle [ms]: motion, air, a neighbour in the plate operator, rest curvature, a collider and as
# much for each unit of its cost, facets. Then the cost of a spring of a line, and the extra costs of its dashpot and of
# its coupling in a membrane.
_MOTION, _AIR, _PLATE, _CURVED, _COLLIDER, _FACETS = (n * _NS for n in (7.0, 25.0, 1.2, 54.0, 10.0, 40.0))
_SPRING, _DASHPOT, _COUPLING = 5.0 * _NS, 3.5 * _NS, 8.0 * _NS
# Cost of a particle of a rope, more if it resists bending, and more where there are colliders, once for particles and
# once for segments [ms].
_SEGMENT, _BEND, _LEAN = 85.0 * _NS, 60.0 * _NS, 80.0 * _NS
_TEST = 90.0 * _NS  # cost of a test whether a box can touch a facet [ms]
_LAYERS = 500.0 * _NS  # cost of self and object contact per particle of an object that lies in layers [ms]
# Cost on an H200 [ms]. A stage of several blocks, and its cost per particle of all worlds. A rope in a block, and its
# cost in each further world. Then six stages in one block, their cost per particle of the object, and per particle of
# all worlds, and what contact of facets adds. Last, self and object contact, and its cost per particle of all worlds.
_STAGE, _STAGE_PARTICLE, _ROPE, _ROPES = 5.5e-3, 8.0e-8, 4.0e-2, 6.5e-5
_BLOCK, _BLOCK_OWN, _BLOCK_PARTICLE, _TOUCHING = 7.5e-3, 1.5e-5, 2.4e-7, 2.0e-2
_LAYERS_LAUNCHED, _LAYERS_PARTICLE = 0.14, 1.2e-5


@dataclass(frozen=True)
class Surroundings:
    """Properties of a scene that determine the cost of a substep.

    device: "cpu" or "cuda". wind: True with air. colliders: the cost of each. worlds: number of them. surface: True if
    colliders are also kept out between particles. coupled: True with self or object contact. gravity: [m/s^2]. speed:
    that of the device, see speed.py. share: share of the budget that is the object's own. sewn: True with seams.
    """

    device: str
    wind: bool
    colliders: Sequence[int]
    worlds: int = 1
    surface: bool = False
    coupled: bool = False
    gravity: float = 9.81
    speed: float = 1.0
    share: float = 1.0
    sewn: bool = False


def xpbd(topology: Topology, materials: Collection[tuple[Sequence[float], float]], around: Surroundings) -> float:
    """Cost of a substep of XPBD with one iteration [ms]."""
    return _alone(topology, materials, around) + _meeting(topology, around) * around.coupled


def test(around: Surroundings) -> float:
    """Cost of a test of a facet for contact, in all worlds [ms]; 0 on a GPU, whose threads share them.

    How many there are depends on the motion, so they are counted as it runs, and searches as several.
    """
    return around.worlds * _TEST if around.device == "cpu" and around.surface else 0.0


def _meeting(topology: Topology, around: Surroundings) -> float:
    """Cost of self and object contact for an object that lies in layers [ms]."""
    count = len(topology.masses) * around.worlds
    return _LAYERS_LAUNCHED + _LAYERS_PARTICLE * count if around.device == "cuda" else _LAYERS * count


def _alone(topology: Topology, materials: Collection[tuple[Sequence[float], float]], around: Surroundings) -> float:
    """Cost of an object without self and object contact [ms]."""
    count, plate, coupled = len(topology.masses), topology.plate is not None, topology.coupling is not None
    bends = topology.bends is not None
    if not len(topology.triangles):
        each = _SEGMENT + _BEND * bends + _LEAN * (len(around.colliders) > 0) * (1 + around.surface) + _touching(around)
        return _ROPE + _ROPES * around.worlds if around.device == "cuda" else around.worlds * count * each
    if around.device == "cuda":
        stages = 2 + len(topology.families) + coupled + around.wind + plate + 2 * around.surface
        return _in_blocks(topology, stages, around) + _TOUCHING * around.surface
    springs = sum(len(elements.rest) for elements in topology.springs.values())
    damped = any(damping > 0.0 for _, damping in materials)
    each = _MOTION + _AIR * around.wind + _touching(around)
    if plate:
        each += _PLATE * topology.plate.neighbours.shape[1] + _CURVED * (topology.plate.stencil is not None)
    spring = _SPRING + _DASHPOT * damped + _COUPLING * coupled
    return around.worlds * (springs * spring + count * each)


def _touching(around: Surroundings) -> float:
    """Cost of colliders on a CPU per particle, with the facets around it [ms]; of many, those out of reach are free."""
    costs = sorted(around.colliders)[-FEW:]
    return _COLLIDER * sum(costs) + (_COLLIDER + _FACETS * around.surface) * len(costs)


def _in_blocks(topology: Topology, stages: int, around: Surroundings) -> float:
    """Cost on a GPU [ms], with one block per body or several, whichever is cheaper."""
    count, particles = len(topology.masses), len(topology.masses) * around.worlds
    alone = stages / 6 * (_BLOCK + _BLOCK_OWN * count + _BLOCK_PARTICLE * particles)
    return min(alone, stages * (_STAGE + _STAGE_PARTICLE * particles))
