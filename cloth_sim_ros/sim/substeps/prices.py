# SPDX-License-Identifier: Apache-2.0
"""The cost of a substep of XPBD [ms], by device and by what a scene holds: measured once, on a CPU core and an H200.

It decides how many substeps a budget buys.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from cloth_sim_ros.sim.features.collider_contact.broad_phase import FEW
from cloth_sim_ros.sim.topology import Topology

_NS = 1e-6  # [ms]
# Of a CPU, for each particle: motion, air, the plate operator, a collider, facets. For each spring of a line: without
# and with dashpots.
_MOTION, _AIR, _PLATE, _COLLIDER, _FACETS = (n * _NS for n in (5.0, 18.0, 10.0, 9.0, 20.0))
_SPRING, _DASHPOT = 4.0 * _NS, 2.0 * _NS
_SEGMENT = 45.0 * _NS  # of a rope
_LAYERS = 900.0 * _NS  # of what is kept apart from itself or others, where it lies in layers
# Of an H200: a stage of several blocks, and for each particle of all worlds. A rope in a block. Six stages of a block,
# for each of its particles, and for each of all worlds.
_STAGE, _STAGE_PARTICLE, _ROPE = 3.0e-3, 8.0e-8, 5.0e-3
_BLOCK, _BLOCK_OWN, _BLOCK_PARTICLE = 4.0e-3, 8.0e-6, 2.4e-7
_LAYERS_LAUNCHED, _LAYERS_PARTICLE = 0.14, 1.2e-5


@dataclass(frozen=True)
class Surroundings:
    """What of a scene decides what a substep costs: the `device`, "cpu" or "cuda", wind, colliders and worlds.

    surface: whether colliders are kept out between particles too. meets: whether the object is kept apart
    from itself or others. tears: whether its springs fail. gravity [m/s^2].
    """

    device: str
    wind: bool
    colliders: int
    worlds: int = 1
    surface: bool = False
    coupled: bool = False
    tears: bool = False
    gravity: float = 9.81

    @property
    def near(self) -> int:
        """Colliders that cost: of many, those that are out of reach cost nothing."""
        return min(self.colliders, FEW)


def xpbd(topology: Topology, materials: Collection[tuple[Sequence[float], float]], around: Surroundings) -> float:
    """Of XPBD, by one iteration."""
    return _alone(topology, materials, around) + _meeting(topology, around) * around.coupled


def _meeting(topology: Topology, around: Surroundings) -> float:
    """What keeps an object that lies in layers apart from itself and others."""
    count = len(topology.masses) * around.worlds
    return _LAYERS_LAUNCHED + _LAYERS_PARTICLE * count if around.device == "cuda" else _LAYERS * count


def _alone(topology: Topology, materials: Collection[tuple[Sequence[float], float]], around: Surroundings) -> float:
    """The same of an object that meets no other."""
    count, plate = len(topology.masses), topology.plate is not None
    if not len(topology.triangles):
        return _ROPE if around.device == "cuda" else around.worlds * count * _SEGMENT
    if around.device == "cuda":
        return _in_blocks(topology, 2 + len(topology.families) + around.wind + plate + 2 * around.surface, around)
    springs = sum(len(elements.rest) for elements in topology.springs.values())
    damped = any(damping > 0.0 for _, damping in materials)
    each = _MOTION + _AIR * around.wind + _touching(around) + _PLATE * plate
    return around.worlds * (springs * (_SPRING + _DASHPOT * damped) + count * each)


def _touching(around: Surroundings) -> float:
    """Of a CPU, what colliders cost a particle, with the facets around it."""
    return around.near * (_COLLIDER + _FACETS * around.surface)


def _in_blocks(topology: Topology, stages: int, around: Surroundings) -> float:
    """Of a GPU, by one block a body or by several, whichever is cheaper."""
    count, particles = len(topology.masses), len(topology.masses) * around.worlds
    alone = stages / 6 * (_BLOCK + _BLOCK_OWN * count + _BLOCK_PARTICLE * particles)
    return min(alone, stages * (_STAGE + _STAGE_PARTICLE * particles))
