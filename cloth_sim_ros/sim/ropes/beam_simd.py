# SPDX-License-Identifier: Apache-2.0
"""Bending of a rope by one CPU thread (see beam_two_sided.py): joints and rows in fours, elimination in pairs."""

from collections.abc import Callable

import warp as wp

from cloth_sim_ros.sim.kernels.native import on_cpu, source
from cloth_sim_ros.sim.ropes.arrays import NUMBERS


def _code(file: str, bent: bool, otherwise: str = "") -> str:
    """Return C++ for a CPU, for a rope that is bent at rest or straight."""
    return on_cpu(source(__file__, "beam_planes", file, BENT=int(bent), NUMBERS=NUMBERS), otherwise)


def make_lanes(bent: bool) -> tuple[Callable, ...]:
    """Return four Warp functions: prepare, eliminate, add_up and move. They do nothing on a GPU."""

    @wp.func_native(_code("beam_prepare", bent))
    def prepare(
        particles: int,
        segments: int,
        count: int,
        x: wp.uint64,
        d: wp.uint64,
        joints: wp.array(dtype=wp.vec4),
        moments: wp.array(dtype=wp.vec3),
        moves: wp.array(dtype=wp.vec3),
        ladder: wp.array(dtype=wp.float64),
        compliance: float,
        effective: float,
        stiffest: float,
    ):
        """Compute the planes of joints and rows of `count` particles."""
        ...

    @wp.func_native(_code("beam_elimination", bent))
    def eliminate(particles: int, count: int, x: wp.uint64, d: wp.uint64, ladder: wp.array(dtype=wp.float64)):
        """Compute the displacements of particles."""
        ...

    @wp.func_native(_code("beam_sum", bent, "return wp::mat_t<6, 3, float>();"))
    def add_up(
        particles: int, count: int, x: wp.uint64, d: wp.uint64, ladder: wp.array(dtype=wp.float64)
    ) -> wp.types.matrix((6, 3), float):
        """Return the inertia and the lag of beam_rotation.py, if rest is bent."""
        ...

    @wp.func_native(_code("beam_move", bent))
    def move(
        particles: int,
        segments: int,
        count: int,
        x: wp.uint64,
        d: wp.uint64,
        moments: wp.array(dtype=wp.vec3),
        moves: wp.array(dtype=wp.vec3),
        ladder: wp.array(dtype=wp.float64),
        inverse_square: float,
        rotation: wp.mat33,
    ):
        """Move particles, turn the rest shape by `rotation` + 1, and update moments."""
        ...

    return prepare, eliminate, add_up, move
